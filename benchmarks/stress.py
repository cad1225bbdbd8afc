"""Stress: many cases at the edge of what can be computed; each is right, refused or a failure.

A case (`stress_cases`) plans a scene and judges the plan by exact laws. It runs in a process of its
own under a watchdog, so that a hang or a crash of the whole process is counted and not suffered.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from . import stress_cases
from .report import ROOT, Bar, Sections
from .timing import in_new_process
from .verdicts import FAILURES, NAN, OUTCOMES, Family, Verdict, judged

LIMIT, WALL = 30.0, 120.0
"""s of processor time after which a case hangs; by the clock, for one that uses no processor, and
for a worker to import what it needs."""
SHOWN = 10
"""Failures of a family that are printed as they come."""


@dataclass(frozen=True)
class Record:
    """The verdict of one case of a family and the processor time it took, s."""

    family: str
    index: int
    verdict: Verdict
    seconds: float


FAMILIES = {family.name: family for family in stress_cases.FAMILIES}


def rerun(family: str, index: int) -> Verdict:
    """Run one case in this process and print how it ended; errors are raised."""
    case = FAMILIES[family].make(index)
    print(case.name)
    verdict = case.call()
    print(verdict)
    return verdict


def _work(link: Connection, todo: list[tuple[str, int]]) -> None:
    """What the worker does: verdicts of cases, one after the other."""
    for name, index in todo:
        begin = time.process_time()
        _limit(LIMIT)
        try:
            verdict = judged(FAMILIES[name].make(index))
        finally:
            _limit(0.0)
        link.send((verdict, time.process_time() - begin))


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
                told = link.recv()
                yield Record(*todo.popleft(), *told)
        process.join(5 if heard else 0)
        process.kill()
        process.join()
        if todo:
            slow = not heard or process.exitcode == -getattr(signal, "SIGPROF", 27)
            text = f"over {LIMIT:g} s" if slow else f"the process ended with {process.exitcode}"
            verdict = Verdict("hang" if slow else "crash", NAN, NAN, text)
            yield Record(*todo.popleft(), verdict, LIMIT)
            if (lost := lost + 1) > 100:
                raise RuntimeError(f"100 processes have ended; the last: {text}")


def cases(full: bool) -> Iterator[Bar]:
    """All cases; ``full``: ten times as many, and none that was run before."""
    first, more = (1000 * int(time.time()), 10) if full else (0, 1)
    chosen = [(f, range(first, first + more * f.count)) for f in FAMILIES.values()]
    records = yield from _bars(chosen, 20_000)
    from .figures import outcomes  # which needs matplotlib

    outcomes(records, ROOT / "docs" / "stress.png")


def sample(full: bool) -> Iterator[Bar]:
    """Every eleventh case, which no axis of a grid repeats after."""
    yield from _bars([(family, range(0, family.count, 11)) for family in FAMILIES.values()], 1900)


def _bars(chosen: list[tuple[Family, range]], least: int) -> Generator[Bar, None, list[Record]]:
    """Run cases; a table of outcomes; failures with the line that repeats them; the records."""
    begin = time.perf_counter()
    records: list[Record] = []
    shown: Counter = Counter()
    for record in search(chosen):
        records.append(record)
        if record.verdict.outcome in FAILURES:
            shown[record.family] += 1
            if shown[record.family] <= SHOWN:
                print(_failure(record), flush=True)
        if len(records) % 500 == 0 and sys.stderr.isatty():
            told = f"\r{len(records)} cases, {shown.total()} failures"
            print(told, end="", file=sys.stderr, flush=True)
    print(table(records))
    count = Counter(r.verdict.outcome for r in records)
    spent = time.perf_counter() - begin
    note = f"{count['right']} right, {count['refused']} refused, {spent:.0f} s"
    yield Bar("stress: cases", least, len(records), least=True, note=note)
    for outcome in FAILURES:
        kept = [(r.family, r.index) for r in records if r.verdict.outcome == outcome]
        yield Bar(f"stress: {outcome}", 0, len(kept), detail={"cases": kept})
    right = [r.verdict for r in records if r.verdict.outcome == "right"]
    worst = max((v.error / v.bound for v in right), default=NAN)
    yield Bar("stress: greatest error over its bound, right cases", 1.0, worst)
    return records


def table(records: list[Record]) -> str:
    """Cases by family and outcome, and the processor time they took."""
    rows: dict[str, Counter] = {}
    for record in records:
        for name in (record.family, "all"):
            row = rows.setdefault(name, Counter())
            row.update({record.verdict.outcome: 1, "cases": 1, "s": record.seconds})
    rows["all"] = rows.pop("all", Counter())  # last
    names = ("cases", *OUTCOMES)
    lines = [f"{'family':34s}" + "".join(f"{name:>9s}" for name in (*names, "s"))]
    for family, row in rows.items():
        cells = "".join(f"{row[name]:9d}" for name in names)
        lines.append(f"{family:34s}{cells}{row['s']:9.1f}")
    return "\n".join(lines)


def _failure(record: Record) -> str:
    """How a case failed, and the line of Python that repeats it."""
    v = record.verdict
    again = f"from benchmarks.stress import rerun; rerun({record.family!r}, {record.index})"
    return f"{v.outcome}: error {v.error:.3g}, bound {v.bound:.3g}: {v.message}\n    {again}"


SANITIZERS = "-O1 -g -fno-omit-frame-pointer -fsanitize=address,undefined -fno-sanitize-recover=all"
IN_COPY = """
import json
from collections import Counter, deque
from benchmarks import stress, stress_cases

chosen = [(family, range(family.count)) for family in stress_cases.FAMILIES]
print(json.dumps(Counter(record.verdict.outcome for record in stress.search(chosen))))
"""


def sanitized(full: bool) -> Iterator[Bar]:
    """The planner's cases by an engine under sanitizers, in a copy of the checkout; needs gcc."""
    name = "findings of sanitizers in the planner's cases"
    if not shutil.which("gcc"):
        yield Bar(name, 0, None, note="gcc is not installed")
        return
    with tempfile.TemporaryDirectory() as room:
        folder, unwanted = Path(room, "copy"), (".*", "_engine.*", "build", "results")
        shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*unwanted))
        flags = {"CC": "gcc", "CONTACT_SYSTEM_CFLAGS": SANITIZERS}
        build = [sys.executable, "setup.py", "build_ext", "--inplace"]
        subprocess.run(build, cwd=folder, env=os.environ | flags, check=True, capture_output=True)
        asan = subprocess.check_output(["gcc", "-print-file-name=libasan.so"], text=True).strip()
        loaded = {"LD_PRELOAD": asan, "ASAN_OPTIONS": "detect_leaks=0"}
        found = in_new_process(IN_COPY, folder=folder, **loaded)
    note = ", ".join(f"{count} {outcome}" for outcome, count in sorted(found.items()))
    yield Bar(name, 0, sum(found.get(outcome, 0) for outcome in FAILURES), note=note)


SECTIONS: Sections = {"cases": cases, "sanitized": sanitized}
