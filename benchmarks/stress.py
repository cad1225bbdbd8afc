"""Stress: many cases at the edge of what can be computed; each is right, refused or a failure.

A case plans or steps something and judges it by exact laws (`stress_cases`, `stress_blocks`). It
runs in a process of its own pool of workers under a watchdog, so that a hang or a crash of the
whole process is counted and not suffered.
"""

from __future__ import annotations

import functools
import importlib
import json
import math
import multiprocessing
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Any

import numpy as np

import contact_system as cs

from .report import RESULTS, Bar, surroundings
from .timing import Job, interleaved
from .verdicts import FAILURES, OUTCOMES, Family, Verdict, judged

LIMIT = 30.0
"""s of processor time; a case that takes longer hangs. The longest path, 780 m on a body of 0.3 m,
is integrated without compiled kernels in 10 s, and in 20 s on a busy machine."""
START_LIMIT = 120.0
"""s for a worker to import and to build the kernels of its first case."""

# --- workers under a watchdog ------------------------------------------------------------------

BATCH = 25
WALL = 60.0
"""s after which a case hangs that uses no processor; it is long, for a machine may be busy."""


@dataclass(frozen=True)
class Record:
    """The verdict of one case of a family and the processor time it took, s."""

    family: str
    index: int
    verdict: Verdict
    seconds: float


def families() -> dict[str, Family]:
    """All families by name; those whose packages are not installed are left out."""
    from . import stress_cases

    found = list(stress_cases.FAMILIES)
    try:
        found += importlib.import_module(".stress_blocks", __package__).FAMILIES
    except ImportError as error:
        print(f"stress of FMU and Drake: left out, {error}")
    return {family.name: family for family in found}


def rerun(family: str, index: int) -> Verdict:
    """Run one case in this process and print how it ended; errors are raised."""
    case = families()[family].make(index)
    print(case.name)
    verdict = case.call()
    print(verdict)
    return verdict


def _work(link: Connection) -> None:
    """What a worker does: batches of (family, indices) in, verdicts out."""
    known = families()
    link.send("ready")
    while (batch := link.recv()) is not None:
        name, indices = batch
        for index in indices:
            begin = time.process_time()
            _limit(LIMIT)
            try:
                verdict = judged(known[name].make(index))
            finally:
                _limit(0.0)
            link.send((verdict, time.process_time() - begin))


def _limit(seconds: float) -> None:
    """End this process once it has used so much processor time; 0: never."""
    if hasattr(signal, "ITIMER_PROF"):  # Windows has none: the wall clock stops it
        signal.setitimer(signal.ITIMER_PROF, seconds)


@dataclass
class Worker:
    """One worker, its open batch, and since when its current case runs."""

    todo: list[tuple[str, int]] = field(default_factory=list)
    since: float = 0.0
    ready: bool = False

    def __post_init__(self) -> None:
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.link, other = context.Pipe()
        self.process = context.Process(target=_work, args=(other,), daemon=True)
        self.process.start()
        other.close()
        self.since, self.ready = time.monotonic(), False

    def give(self, batch: list[tuple[str, int]]) -> None:
        """Start on cases of one family."""
        self.todo, self.since = list(batch), time.monotonic()
        self.link.send((batch[0][0], [index for _, index in batch]))

    def take(self) -> Record | None:
        """What the worker says; None: that it is ready."""
        told = self.link.recv()
        self.since = time.monotonic()
        if told == "ready":
            self.ready = True
            return None
        family, index = self.todo.pop(0)
        return Record(family, index, *told)

    @property
    def stuck(self) -> bool:
        """The current case, or the start, takes too long by the clock."""
        allowed = WALL if self.ready else START_LIMIT
        return bool(self.todo or not self.ready) and time.monotonic() - self.since > allowed

    def lost(self) -> tuple[Record | None, list[tuple[str, int]]]:
        """End the process, start another; the verdict of its case, and the cases left."""
        self.process.kill() if self.stuck else self.process.join(5)
        code, nan = self.process.exitcode, float("nan")
        self.process.join(5)
        self.link.close()
        slow = self.stuck or (hasattr(signal, "SIGPROF") and code == -signal.SIGPROF)
        text = f"over {LIMIT:g} s" if slow else f"the process ended with code {code}"
        verdict = Verdict("hang" if slow else "crash", nan, nan, text)
        todo, self.todo = self.todo, []
        self._start()
        return (Record(*todo[0], verdict, LIMIT) if todo else None), todo[1:]

    def stop(self) -> None:
        """Let the worker end."""
        self.link.send(None)
        self.process.join(5)
        self.process.kill()


def search(chosen: list[tuple[Family, range]], workers: int = 2) -> Iterator[Record]:
    """Run cases in worker processes; records in the order in which they come.

    Parameters
    ----------
    chosen : list of (family, range of indices)
    workers : int
    """
    batches = [
        [(family.name, i) for i in indices[k : k + BATCH]]
        for family, indices in chosen
        for k in range(0, len(indices), BATCH)
    ]
    batches.reverse()
    crew, failures = [Worker() for _ in range(workers)], 0
    while batches or any(w.todo for w in crew):
        heard = wait([w.link for w in crew], timeout=0.5)
        for worker in crew:
            record, gone = None, worker.stuck
            if worker.link in heard:
                try:
                    record, gone = worker.take(), False
                except (EOFError, ConnectionError):
                    gone = True
            if gone:
                record, rest = worker.lost()
                failures += record is None
                if rest:
                    batches.append(rest)
            if failures > 3:
                raise RuntimeError(
                    "workers of the stress test do not start; import benchmarks.stress_cases alone"
                )
            if record is not None:
                yield record
            if worker.ready and not worker.todo and batches:
                worker.give(batches.pop())
    for worker in crew:
        worker.stop()


# --- the table and the bars --------------------------------------------------------------------

SHOWN = 10
"""Failures of a family that are printed as they come; the JSON file has all."""


def cases(full: bool) -> Iterator[Bar]:
    """Every family; a table of outcomes; failures with the line that repeats them."""
    begin = time.perf_counter()
    records: list[Record] = []
    shown: Counter = Counter()
    for record in search(_chosen(full)):
        records.append(record)
        if record.verdict.outcome in FAILURES:
            shown[record.family] += 1
            if shown[record.family] <= SHOWN:
                print(_failure(record), flush=True)
        if len(records) % 500 == 0:
            bad = shown.total()
            print(f"\r{len(records)} cases, {bad} failures", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    spent = time.perf_counter() - begin
    print(table(records))
    _keep(records, spent)
    count = Counter(r.verdict.outcome for r in records)
    note = f"{count['right']} right, {count['refused']} refused, {spent:.0f} s"
    yield Bar("stress: cases", 20_000, len(records), least=True, note=note)
    for outcome in FAILURES:
        yield Bar(f"stress: {outcome}", 0, count[outcome])
    right = [r.verdict for r in records if r.verdict.outcome == "right"]
    worst = max((v.error / v.bound for v in right), default=float("nan"))
    yield Bar("stress: greatest error over its bound, right cases", 1.0, worst)


def _chosen(full: bool) -> list[tuple[Family, range]]:
    """The slow ones first. ``full``: ten times the random cases, and none that was run before."""
    chosen = []
    for family in families().values():
        first, count = 0, family.count
        if full and family.endless:
            first, count = 1000 * int(time.time()), 10 * count
        chosen.append((family, range(first, first + count)))
    return chosen


def table(records: list[Record]) -> str:
    """Cases by family and outcome, and the processor time they took."""
    rows: dict[str, Counter] = {}
    seconds: Counter = Counter()
    for record in records:
        rows.setdefault(record.family, Counter())[record.verdict.outcome] += 1
        seconds[record.family] += record.seconds  # type: ignore[assignment]
    rows["all"] = sum(rows.values(), Counter())
    seconds["all"] = sum(seconds.values())
    head = f"{'family':34s}" + "".join(f"{name:>9s}" for name in ("cases", *OUTCOMES, "s"))
    lines = [
        f"{name:34s}{row.total():9d}"
        + "".join(f"{row[outcome]:9d}" for outcome in OUTCOMES)
        + f"{seconds[name]:9.1f}"
        for name, row in rows.items()
    ]
    return "\n".join([head, *lines])


def _failure(record: Record) -> str:
    """How a case failed, and the line of Python that repeats it."""
    v = record.verdict
    return (
        f"{v.outcome}: error {v.error:.3g}, bound {v.bound:.3g}: {v.message}\n"
        f"    from benchmarks.stress import rerun; rerun({record.family!r}, {record.index})"
    )


def _keep(records: list[Record], spent: float) -> None:
    """Every case that is not right, and counts, as JSON beside the bars."""
    by_family: dict[str, Any] = {}
    for r in records:
        row = by_family.setdefault(r.family, {"seconds": 0.0, "outcomes": Counter(), "kept": []})
        row["seconds"] += r.seconds
        row["outcomes"][r.verdict.outcome] += 1
        if r.verdict.outcome in FAILURES:
            row["kept"].append({"index": r.index, **asdict(r.verdict)})
    RESULTS.mkdir(parents=True, exist_ok=True)
    told = {**surroundings(), "seconds": spent, "families": by_family}
    (RESULTS / "stress-cases.json").write_text(json.dumps(told, indent=1) + "\n")


# --- cost that must not depend on what is hard -------------------------------------------------


def eta(full: bool) -> Iterator[Bar]:
    """The times of ``speed --only eta``, greatest over least instead of last over first."""
    from . import speed

    for bar in speed.eta(full):
        times = list(bar.detail.values())
        name = bar.name.replace("eta 1e10 over 1", "eta 1 to 1e10, most over least")
        yield Bar(name, 2.0, max(times) / min(times), "x", detail=bar.detail)


def pole(full: bool) -> Iterator[Bar]:
    """Time against the distance at which a path passes a pole or an umbilic, 1 to 1e-15 radians.

    Plan and 101 states; the paths are equally long.
    """
    times = np.linspace(0.0, 1.0, 101)
    for kind, obj in (("pole, sphere", cs.Sphere(0.1)), ("umbilic, ellipsoid", ELLIPSOID)):
        for compiled in (False, None):
            jobs = {
                f"{miss:g}": Job(
                    lambda scene, how=compiled: cs.plan(scene, compiled=how).states(times),
                    functools.partial(_passing, obj, miss),
                )
                for miss in (1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15)
            }  # fmt: skip
            found = {name: timing.median for name, timing in interleaved(jobs, 7).items()}
            engine = "virtual machine" if compiled is False else "compiled if built"
            yield Bar(f"distance 1 to 1e-15 from a {kind}, {engine}, most over least", 1.5,
                      max(found.values()) / min(found.values()), "x", detail=found)  # fmt: skip


ELLIPSOID = cs.Ellipsoid(0.3, 0.2, 0.1)


def _passing(obj: cs.Surface, miss: float) -> cs.Scene:
    """A contact whose object's path passes the pole (umbilic) at this angle."""
    at = (1.0, math.pi / 2) if obj is ELLIPSOID else (1.0, 0.3)
    heading = math.pi + miss  # towards falling u
    given = (math.cos(heading), -math.sin(heading))  # psi = 0: R turns y about
    return cs.Scene(
        object=obj, profile=cs.Profile([2 * obj.size]), duration=1.0, name="passing",
        contacts=[cs.Contact(finger=cs.Sphere(0.04), object_at=at, finger_velocity=given)],
    )  # fmt: skip


SECTIONS = {"cases": cases, "eta": eta, "pole": pole}
