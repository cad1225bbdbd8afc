"""Stress: many cases at the edge of what can be computed; each is right, refused or a failure.

A case (`stress_cases`) plans a scene and judges the plan by exact laws. It runs in a process of its
own under a watchdog, so that a hang or a crash of the whole process is counted and not suffered.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import signal
import time
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection

from . import stress_cases
from .report import ROOT, Bar, Sections
from .verdicts import FAILURES, NAN, Family, Verdict, judged

LIMIT, WALL = 60.0, 120.0
"""s of processor time after which a case hangs, sanitizers being slow; by the clock, for one that
uses no processor, and for a worker to import what it needs."""


@dataclass(frozen=True)
class Record:
    """The verdict of one case of a family."""

    family: str
    index: int
    verdict: Verdict


FAMILIES = {family.name: family for family in stress_cases.FAMILIES}


def rerun(family: str, index: int) -> Verdict:
    """Run one case in this process and print how it ended; errors are raised."""
    verdict = FAMILIES[family].run(index)
    print(verdict)
    return verdict


def _work(link: Connection, todo: list[tuple[str, int]]) -> None:
    """What the worker does: verdicts of cases, one after the other."""
    for name, index in todo:
        _limit(LIMIT)
        try:
            verdict = judged(partial(FAMILIES[name].run, index))
        finally:
            _limit(0.0)
        link.send(verdict)


def _limit(seconds: float) -> None:
    """End this process once it has used so much processor time; 0: never."""
    if hasattr(signal, "ITIMER_PROF"):  # Windows has none: the wall clock stops it
        signal.setitimer(signal.ITIMER_PROF, seconds)


def search(chosen: list[tuple[Family, range]]) -> Iterator[Record]:
    """Run cases: a worker does them, and after one that ends it or hangs another the rest."""
    todo = deque((family.name, index) for family, indices in chosen for index in indices)
    context, lost = multiprocessing.get_context("spawn"), 0
    while todo:
        link, other = context.Pipe()
        process = context.Process(target=_work, args=(other, list(todo)), daemon=True)
        process.start()
        other.close()
        with contextlib.suppress(EOFError, ConnectionError):
            while todo and (heard := link.poll(WALL)):
                verdict = link.recv()
                yield Record(*todo.popleft(), verdict)
        process.join(5 if heard else 0)
        process.kill()
        process.join()
        if todo:
            slow = not heard or process.exitcode == -getattr(signal, "SIGPROF", 27)
            text = f"over {LIMIT:g} s" if slow else f"the process ended with {process.exitcode}"
            verdict = Verdict("hang" if slow else "crash", message=text)
            yield Record(*todo.popleft(), verdict)
            if (lost := lost + 1) > 100:
                raise RuntimeError(f"100 processes have ended; the last: {text}")


def cases(full: bool) -> Iterator[Bar]:
    """All cases; ``full``: ten times as many, and none that was run before."""
    first, more = (1000 * int(time.time()), 10) if full else (0, 1)
    chosen = [(f, range(first, first + more * f.count)) for f in FAMILIES.values()]
    records: list[Record] = []
    for family, group in itertools.groupby(search(chosen), lambda record: record.family):
        records += (found := list(group))
        failures = [record for record in found if record.verdict.outcome in FAILURES]
        for record in failures[:10]:
            print(_failure(record))
        count = Counter(record.verdict.outcome for record in found)
        note = ", ".join(f"{number} {outcome}" for outcome, number in sorted(count.items()))
        name = f"{family}, {len(found)} cases: wrong, crash or hang"
        yield Bar(name, 0, len(failures), note=note)
    count = Counter(record.verdict.outcome for record in records)
    note = f"{count['right']} right, {count['refused']} refused"
    yield Bar("cases in all", 20_000, len(records), least=True, note=note)
    right = [r.verdict for r in records if r.verdict.outcome == "right"]
    worst = max((v.error / v.bound for v in right), default=NAN)
    yield Bar("greatest error over its bound, right cases", 1.0, worst)
    from .figures import outcomes  # which needs matplotlib

    outcomes(records, ROOT / "docs" / "stress.png")


def _failure(record: Record) -> str:
    """How a case failed, and the line of Python that repeats it."""
    v = record.verdict
    again = f"from benchmarks.stress import rerun; rerun({record.family!r}, {record.index})"
    return f"{v.outcome}: error {v.error:.3g}, bound {v.bound:.3g}: {v.message}\n    {again}"


SECTIONS: Sections = {"cases": cases}
