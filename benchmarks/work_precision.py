"""Work-precision diagrams: run time against achieved error, ours beside the peers.

Error: greatest distance of a contact point from a 30-digit reference, of the body's size. Time: one
run with all outputs, kernels warm, peers' solvers and initial states ready, competitors in turns.
Peers end with their states; ours with contact points of both bodies, which the peers are spared.
Times at a given error are interpolated along each method's best runs (log-log), where it has runs
on both sides; else its cheapest run that is good enough counts.
"""

from __future__ import annotations

import functools
import gc
import json
import math
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import integrators, ours
from .curves import Outcome, Ratio, Run, ratio
from .figures import diagram, overview
from .problems import Problem, problems
from .report import RESULTS, Bar, markdown_table, surroundings
from .timing import Job, Timing, interleaved, sample

TARGETS = (1e-6, 1e-9, 1e-12)
SLOW = 0.01  # [s]: what takes longer is sampled while scanning only
EXPORTED = ("sphere-ellipsoid 1e3", "disturbed K4")  # an export compiles for 3 s
KINDS = ("prepared", "quiet", "new")
FLOOR = 2e-15  # tighter tolerances cannot show in double precision
OUTCOMES: dict[str, Outcome] = {}
"""What was measured in this process; the summary's input."""


# --- measuring ---------------------------------------------------------------------------------


@dataclass
class _Candidate:
    name: str
    tolerance: float
    job: Job
    error: float
    seconds: list[float]
    build: float


def measure(problem: Problem, full: bool) -> Outcome:
    """All methods at all their tolerances."""
    outcome = Outcome(problem.name, left_out=dict(integrators.missing()))
    limit = 20.0 if full else 0.1
    found = list(_scan(problem, outcome, full, limit))
    gc.collect()
    gc.freeze()  # collections between samples then cost nothing to speak of
    quick = {f"{c.name} {c.tolerance:g}": c.job for c in found if min(c.seconds) < SLOW}
    times = interleaved(quick, repeats=9 if full else 5, burst=0.002)
    gc.unfreeze()
    for c in found:
        scanned = Timing(statistics.median(c.seconds), min(c.seconds), max(c.seconds))
        timing = times.get(f"{c.name} {c.tolerance:g}", scanned)
        run = Run(c.tolerance, c.error, timing, c.build)
        outcome.curves.setdefault(c.name, []).append(run)
    return outcome


def _scan(problem: Problem, outcome: Outcome, full: bool, limit: float) -> Iterator[_Candidate]:
    """Errors, and times of the slow; a method ends where it fails or is needlessly tight."""
    for peer in integrators.peers(problem, full):
        build = functools.partial(_peer_job, peer, limit)
        error = functools.partial(_error, problem, peer.points)
        yield from _tolerances(peer.name, peer.tolerances, build, error, outcome, limit)
    sources: dict[str, Callable[[Problem], Iterator[ours.Ours]]] = {
        "ours": ours.plans, "ours, method": ours.chart,
        "ours, Drake": functools.partial(ours.drake, limit=limit),
    }  # fmt: skip
    if full or any(word in problem.name for word in EXPORTED):
        sources["ours, FMU"] = ours.fmu
    for name, source in sources.items():
        try:
            for own in source(problem):
                parts = own.name, own.tolerances, own.build, problem.error
                yield from _tolerances(*parts, outcome, limit)
        except ImportError as reason:
            outcome.left_out[name] = str(reason)


def _error(problem: Problem, points: Callable[[Any], np.ndarray], found: Any) -> float:
    return problem.error(points(found))


def _peer_job(peer: integrators.Peer, limit: float, tolerance: float) -> Job:
    solver = peer.build(tolerance, limit)
    return Job(lambda _: solver())


def _tolerances(
    name: str,
    tolerances: Iterable[float],
    build: Callable[[float], Job],
    error_of: Callable[[Any], float],
    outcome: Outcome,
    limit: float,
) -> Iterator[_Candidate]:
    first = True
    for tolerance in tolerances:
        try:
            begin = time.perf_counter()
            job = build(tolerance)
            built = time.perf_counter() - begin
            item = job.make()
            begin = time.perf_counter()
            found = job.call(item)
            seconds = [time.perf_counter() - begin]
            error = error_of(found)
            if not math.isfinite(error):
                raise ArithmeticError("the result is not finite")
            if first or seconds[0] < limit:  # the first run may hold compilation
                seconds = [sample(job) for _ in range(2 if seconds[0] > SLOW else 1)]
            first = False
        except (TimeoutError, ArithmeticError, ValueError, RuntimeError, ImportError) as reason:
            text = str(reason).strip().splitlines() or [type(reason).__name__]
            # an ImportError ends with the file's place on this machine
            outcome.left_out[f"{name} {tolerance:g}"] = text[-1].split(" (/")[0][-120:]
            return
        yield _Candidate(name, tolerance, job, error, seconds, built)
        if not name.startswith("ours") and error < FLOOR or min(seconds) > limit:
            return


# --- comparing ---------------------------------------------------------------------------------


def diagrams(problem: Problem, full: bool) -> Iterator[Bar]:
    """One problem: its figure, a bar for each error, one for the smallest error."""
    outcome = OUTCOMES[problem.name] = measure(problem, full)
    file = RESULTS / f"work_precision-{problem.name.replace(' ', '_')}.png"
    RESULTS.mkdir(parents=True, exist_ok=True)
    diagram(outcome, file)
    for target in TARGETS:
        yield _beside(outcome, target)
    least = min(run.error for run in outcome.own(new=False))
    detail = {
        "curves": {k: [_plain(r) for r in v] for k, v in outcome.curves.items()},
        "left out": outcome.left_out, "versions": integrators.versions(), "figure": file.name,
    }  # fmt: skip
    yield Bar(f"{problem.name}, smallest error, of the size", 1e-13, least, detail=detail)


def _plain(run: Run) -> dict[str, Any]:
    times = {"median": run.time.median, "low": run.time.low, "high": run.time.high}
    return {"tolerance": run.tolerance, "error": run.error, "s": times, "build s": run.build}


def _beside(outcome: Outcome, target: float) -> Bar:
    name = f"{outcome.name}, error {target:.0e}, times faster"
    found = ratio(outcome, target)
    if isinstance(found, str):
        return Bar(name, 1.0, None, "x", True, found)
    mine, other = (1e6 * s for s in found.seconds)
    note = f"{mine:.3g} us beside {other:.3g} us ({found.rival}); least samples {found.quiet:.3g} x"
    note += f"; new scene {found.new:.3g} x"
    return Bar(name, 1.0, found.prepared, "x", True, note)


# --- summary -----------------------------------------------------------------------------------


def summary(full: bool) -> Iterator[Bar]:
    """The table of ratios, the overview figure, the geometric means."""
    if not OUTCOMES:
        yield Bar("summary of the problems", 5.0, None, "x", note="no problem was run")
        return
    rows, ratios = [], []
    for outcome in OUTCOMES.values():
        found = [ratio(outcome, target) for target in TARGETS]
        ratios += [r for r in found if isinstance(r, Ratio)]
        cells = [_cell(r) for r in found]
        least = min(run.error for run in outcome.own(new=False))
        rows.append([outcome.name, *cells, f"{least:.0e}"])
    head = ["problem", *(f"error {target:.0e}" for target in TARGETS), "smallest error"]
    mean = {k: statistics.geometric_mean(getattr(r, k) for r in ratios) for k in KINDS}
    text = markdown_table(head, rows)
    text += "\nTimes faster than the fastest peer; in brackets: by least samples, new scene.\n"
    text += "Geometric means: " + ", ".join(f"{k} {v:.3g}" for k, v in mean.items()) + ".\n"
    (RESULTS / "work_precision.md").write_text(text)
    overview(list(OUTCOMES.values()), RESULTS / "work_precision.png")
    faster = sum(r.prepared >= 1.0 for r in ratios) / len(ratios)
    note = f"least samples {mean['quiet']:.3g} x, new scenes {mean['new']:.3g} x"
    name = "geometric mean over problems and errors, times faster"
    yield Bar(name, 5.0, mean["prepared"], "x", True, note)
    note = f"of {len(ratios)}; least samples {sum(r.quiet >= 1.0 for r in ratios)}, "
    note += f"new scenes {sum(r.new >= 1.0 for r in ratios)} of them"
    yield Bar("share of comparisons in which ours is not slower", 1.0, faster, "", True, note)


def _cell(found: Ratio | str) -> str:
    if isinstance(found, str):
        return found.replace(" this error", "")
    return f"{found.prepared:.3g} ({found.quiet:.3g}, {found.new:.3g}) {found.rival}"


# --- the README ----------------------------------------------------------------------------------

ROOT = Path(__file__).parents[1]
SHORT = ("geodesic ellipsoid", "slip sphere-ellipsoid 1e3", "slip sphere-ellipsoid 1e7",
         "disturbed K4")  # fmt: skip
"""Problems of the README's figure."""
MARKS = (
    "<!-- written by: python -m benchmarks work_precision -->\n",
    "<!-- end of what is written -->\n",
)


def readme(full: bool) -> Iterator[Bar]:
    """Write the README's figure and table; alone, from the results of the last run."""
    outcomes, about = list(OUTCOMES.values()), surroundings()
    if not outcomes:
        last = RESULTS / "work_precision.json"
        if not last.exists():
            note = "there is no run to write of; run python -m benchmarks work_precision"
            yield Bar("problems in the README's table", len(list(problems())), None, note=note)
            return
        outcomes, about = stored(last)
    overview(outcomes, ROOT / "docs" / "work-precision.png")
    short = [outcome for outcome in outcomes if outcome.name in SHORT]
    overview(short, ROOT / "docs" / "work-precision-short.png", columns=2)
    page = ROOT / "README.md"
    page.write_text(between_marks(page.read_text("utf-8"), readme_table(outcomes, about)), "utf-8")
    yield Bar("problems in the README's table", len(list(problems())), len(outcomes), least=True)


def stored(path: Path) -> tuple[list[Outcome], dict[str, Any]]:
    """Outcomes, and date and machine, of a file that a run has written."""
    found = json.loads(path.read_text())
    outcomes = []
    for bar in found["bars"]:
        if curves := bar["detail"].get("curves"):
            outcome = Outcome(bar["name"].split(", smallest")[0])
            outcome.curves = {name: [_run_of(r) for r in runs] for name, runs in curves.items()}
            outcomes.append(outcome)
    return outcomes, found


def _run_of(plain: dict[str, Any]) -> Run:
    return Run(plain["tolerance"], plain["error"], Timing(**plain["s"]), plain["build s"])


def readme_table(outcomes: Iterable[Outcome], about: dict[str, Any]) -> str:
    """Ratios by problem, with their geometric mean, date and machine; slower ones are bold.

    Of scenes planned before, and in brackets of new ones.
    """
    rows, ratios = [], []
    for outcome in outcomes:
        found = [ratio(outcome, target) for target in TARGETS]
        seen = [r for r in found if isinstance(r, Ratio)]
        ratios += seen
        rivals = ", ".join(dict.fromkeys(r.rival for r in seen))
        least = min(run.error for run in outcome.own(new=False))
        rows.append([outcome.name, *map(_short_cell, found), rivals, f"{least:.0e}"])
    head = ["problem", *(f"{target:.0e}" for target in TARGETS), "fastest peer", "smallest error"]
    mean = {k: statistics.geometric_mean(getattr(r, k) for r in ratios) for k in KINDS}
    machine = f"{about['date'][:10]}, {about['machine']['processor']}, one thread"
    return (
        markdown_table(head, rows)
        + f"\nGeometric mean {mean['prepared']:.2g}; in brackets, of scenes never planned before, "
        f"{mean['new']:.2g}. {machine}.\n"
    )


def _short_cell(found: Ratio | str) -> str:
    if isinstance(found, str):
        return "no peer" if found.startswith("no peer") else "-"
    return f"{_times(found.prepared)} ({_times(found.new)})"


def _times(faster: float) -> str:
    text = f"{faster:.2g} x" if faster < 10 else f"{faster:.0f} x"
    return text if faster >= 1.0 else f"**{text}**"


def between_marks(page: str, text: str) -> str:
    """A page with what stands between `MARKS` replaced.

    Raises
    ------
    ValueError
        The page has no such marks.
    """
    before, first, rest = page.partition(MARKS[0])
    _, last, after = rest.partition(MARKS[1])
    if not last:
        raise ValueError(f"the page lacks the lines {MARKS[0].strip()} and {MARKS[1].strip()}")
    return f"{before}{first}\n{text}\n{last}{after}"


SECTIONS: dict[str, Callable[[bool], Iterator[Bar]]] = {
    problem.name: functools.partial(diagrams, problem) for problem in problems()
}
SECTIONS["summary"] = summary
SECTIONS["readme"] = readme
