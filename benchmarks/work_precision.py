"""Work-precision diagrams: run time against achieved error, ours beside the peers.

Error: greatest distance of a contact point from the truth, over the body's size. Time: processor
time of one run with all outputs, measured in turns. The peers' solvers and initial states are made
before; ours plans a new scene each time, and computes contact points of both bodies, which for the
peers is not timed. Times at a given error are interpolated along each method's best runs (log-log);
if no run has a larger error, the fastest run that is accurate enough counts.
"""

from __future__ import annotations

import functools
import math
import statistics
import time
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from .figures import Curve, overview
from .peers import Peer, decades, peers
from .problems import Problem, problems
from .report import ROOT, Bar, Sections, markdown_table, surroundings
from .timing import Job, interleaved

TARGETS = (1e-6, 1e-9, 1e-12)
OURS = "ours"
FLOOR = 2e-15  # an error that tighter tolerances cannot reduce in double precision


class Run(NamedTuple):
    """A method at one tolerance."""

    error: float
    time: float  # s


Curves = dict[str, list[Run]]
"""Runs of one problem, by method."""
FOUND: dict[str, Curves] = {}
"""Measurements of this process, by problem; the summary's input."""


def measure(
    problem: Problem,
    rivals: Iterable[Peer],
    tolerances: tuple[float, ...] = decades(3, 15),
    limit: float = 0.1,
    repeats: int = 5,
) -> Curves:
    """Runs of ours and of its rivals at all their tolerances.

    A peer's tolerances end where it fails, reaches `FLOOR`, or takes longer than ``limit`` s.
    """
    errors, jobs = {}, {}
    for peer in (*rivals, Peer(OURS, tolerances, None, problem.points)):
        for tolerance in peer.tolerances:
            try:
                job = _job(problem, peer, tolerance)
                item, begin = job.make(), time.process_time()
                found = job.call(item)
                spent, error = time.process_time() - begin, problem.error(peer.points(found))
            except (ArithmeticError, ValueError, RuntimeError):
                break
            if not math.isfinite(error):
                break
            errors[peer.name, tolerance], jobs[peer.name, tolerance] = error, job
            if peer.build and (error < FLOOR or spent > limit):
                break
    times, curves = interleaved(jobs, repeats, burst=0.002), Curves()
    for (name, tolerance), error in errors.items():
        curves.setdefault(name, []).append(Run(error, times[name, tolerance]))
    return curves


def _job(problem: Problem, peer: Peer, tolerance: float) -> Job:
    """One run of a method; ours plans a new scene each time."""
    if peer.build is None:
        return Job(functools.partial(problem.solve, tolerance), problem.make)
    solver = peer.build(tolerance)
    return Job(lambda _: solver())


def best(curve: Iterable[Run]) -> list[Run]:
    """The runs that are better than all faster ones, the fastest first."""
    front: list[Run] = []
    for run in sorted(curve, key=lambda run: run.time):
        if not front or run.error < front[-1].error:
            front.append(run)
    return front


def time_at(curve: Iterable[Run], error: float) -> float | None:
    """Seconds to reach an error; None: not reached."""
    front = best(curve)
    reached = [run for run in front if run.error <= error]
    looser = [run for run in front if run.error > error]
    if not reached:
        return None
    tight = reached[0]
    if not looser or tight.error <= 0.0:
        return tight.time
    loose = looser[-1]
    share = math.log(loose.error / error) / math.log(loose.error / tight.error)
    return loose.time ** (1.0 - share) * tight.time**share


class Ratio(NamedTuple):
    """Times faster than the fastest peer at one error, its name, and seconds of both."""

    faster: float
    rival: str
    own: float
    other: float


def ratio(curves: Curves, error: float) -> Ratio | str:
    """The comparison, or why there is none."""
    times = {name: time_at(runs, error) for name, runs in curves.items()}
    own = times.pop(OURS, None)
    if own is None:
        return "ours does not reach this error"
    reached = {name: t for name, t in times.items() if t is not None}
    if not reached:
        return "no peer reaches this error"
    rival = min(reached, key=lambda name: reached[name])
    return Ratio(reached[rival] / own, rival, own, reached[rival])


def beside(name: str, curves: Curves, target: float, limit: float, **others: Any) -> Bar:
    """How many times faster ours is at an error."""
    name, found = f"{name}, error {target:.0e}, times faster", ratio(curves, target)
    if isinstance(found, str):
        return Bar(name, limit, None, "x", True, found)
    note = f"{1e6 * found.own:.3g} us beside {1e6 * found.other:.3g} us ({found.rival})"
    note += others.pop("note", "")
    return Bar(name, limit, found.faster, "x", True, note, **others)


def diagrams(problem: Problem, full: bool) -> Iterator[Bar]:
    """One problem: a bar for each error, one for the smallest error."""
    limit, repeats = (20.0, 9) if full else (0.1, 5)
    curves = measure(problem, peers(problem, full), limit=limit, repeats=repeats)
    FOUND[problem.name] = curves
    for target in TARGETS:
        yield beside(problem.name, curves, target, 0.9)
    yield Bar(f"{problem.name}, smallest error, of the size", 1e-13, _least(curves))


def _least(curves: Curves) -> float:
    return min((run.error for run in curves.get(OURS, ())), default=math.nan)


def summary(full: bool) -> Iterator[Bar]:
    """How many times faster ours is on the problems of this run: geometric mean and least."""
    found = [ratio(curves, target) for curves in FOUND.values() for target in TARGETS]
    faster = [r.faster for r in found if isinstance(r, Ratio)]
    if faster:
        what = f"work_precision, {len(faster)} comparisons"
        yield Bar(f"{what}, geometric mean", 5.0, statistics.geometric_mean(faster), "x", True)
        yield Bar(f"{what}, least", 0.9, min(faster), "x", True)


PAGE = """# Run time against error

<!-- Written by python -m benchmarks work_precision; do not edit. -->

How many times as fast as the fastest peer a new scene is planned and its contact points computed,
at equal achieved error; what is compared, and how: [benchmarks](../benchmarks/README.md).

{table}
Geometric mean {mean:.2g}. {about}

![Run time against error on all problems](work-precision.png)
"""


def page(full: bool) -> Iterator[Bar]:
    """Write ``docs/work-precision.md`` and its pictures, after a run of all problems."""
    count = len(list(problems()))
    if len(FOUND) == count:
        text = page_text(FOUND, surroundings())
        (ROOT / "docs" / "work-precision.md").write_text(text, "utf-8")
        panels = {name: _best(curves) for name, curves in FOUND.items()}
        named = "greatest distance of a contact point, of the body's size", "run time [s]"
        overview(panels, STYLES, ROOT / "docs" / "work-precision.png", *named, columns=4)
    yield Bar("problems of this run, for the page in docs", count, len(FOUND), least=True)


STYLES = {
    OURS: {"color": "crimson", "linewidth": 1.8},
    "heyoka": {"color": "tab:blue", "marker": "s"},
    "CVODES": {"color": "tab:green", "marker": "v"},
}


def _best(by_method: Curves) -> dict[str, Curve]:
    """The best runs of each library."""
    found: dict[str, list[Run]] = {}
    for name, runs in by_method.items():
        found.setdefault(name.split()[0].rstrip(","), []).extend(runs)
    curves: dict[str, Curve] = {}
    for name in (name for name in STYLES if name in found):
        runs = best(found[name])
        curves[name] = [max(run.error, 1e-17) for run in runs], [run.time for run in runs]
    return curves


def page_text(by_problem: dict[str, Curves], about: str) -> str:
    """The page: ratios by problem, in bold if below 1, their geometric mean, and the machine."""
    rows, ratios = [], []
    for name, curves in by_problem.items():
        found = [ratio(curves, target) for target in TARGETS]
        seen = [r for r in found if isinstance(r, Ratio)]
        ratios += [r.faster for r in seen]
        rivals = ", ".join(dict.fromkeys(r.rival for r in seen))
        rows.append([name, *map(_cell, found), rivals, f"{_least(curves):.0e}"])
    head = ["problem", *(f"{target:.0e}" for target in TARGETS), "fastest peer", "smallest error"]
    mean, table = statistics.geometric_mean(ratios), markdown_table(head, rows)
    return PAGE.format(table=table, mean=mean, about=about)


def _cell(found: Ratio | str) -> str:
    if isinstance(found, str):
        return "no peer" if found.startswith("no peer") else "-"
    text = f"{found.faster:.2g} x" if found.faster < 10 else f"{found.faster:.0f} x"
    return text if found.faster >= 1.0 else f"**{text}**"


SECTIONS: Sections = {problem.name: functools.partial(diagrams, problem) for problem in problems()}
SECTIONS |= {"summary": summary, "page": page}
