"""Contact simulators against balls whose exact motion is known: error against run time.

`truth_exact` has the exact motions and a check of them; `truth_drake` and `truth_mujoco` simulate.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from . import truth_drake, truth_mujoco
from .figures import Curve, overview
from .report import ROOT, Bar, Sections, markdown_table, surroundings
from .timing import Job, interleaved
from .truth_exact import Ended, Setup, proof, setups

STEPS = (4e-3, 1e-3, 2.5e-4)
ACCURACIES = (1e-2, 1e-4, 1e-6)
LIMIT = 1.5
"""s of processor time after which a run is given up."""
LOST = 10.0
"""Greatest error that is reported, in radii."""
BEGIN = time.perf_counter()
Runs = dict[str, list[Ended]]
FOUND: dict[str, Runs] = {}
"""Runs of this process, by set-up and method, from coarse to fine."""
EXACT: dict[str, tuple[float, float]] = {}
"""By set-up: the error of the exact motion, and the time to compute it, s."""


def methods(setup: Setup) -> Iterator[tuple[str, Any, Any, tuple[float, ...]]]:
    """Methods that can simulate a set-up: name, module, method, and steps, s, or accuracies."""
    for method in truth_drake.METHODS:
        if truth_drake.takes(setup, method):
            knobs = ACCURACIES if method.scheme else STEPS
            knobs = knobs if method.model == "point" else knobs[:2]
            yield f"Drake {method.name}", truth_drake, method, knobs
    for method in truth_mujoco.METHODS:
        yield f"MuJoCo {method.name}", truth_mujoco, method, STEPS


def exact(full: bool) -> Iterator[Bar]:
    """Exact motions against Newton's and Euler's equations, integrated independently, in radii."""
    for name, setup in setups().items():
        end = np.array([setup.end])
        spent = interleaved({name: Job(lambda _, motion=setup.motion, t=end: motion(t))}, 5)[name]
        EXACT[name] = proof(setup), spent
        yield Bar(f"exact, {name}", 1e-12, EXACT[name][0], "radii", note=f"in {1e3 * spent:.2g} ms")


def simulated(name: str, full: bool) -> Iterator[Bar]:
    """One set-up by all methods."""
    runs = FOUND.setdefault(name, {})
    for what, module, method, knobs in methods(setups()[name]):
        # where a wrench drives the ball, it costs some us a step in both simulators
        found = [module.run(name, method, knob, LIMIT) for knob in knobs]
        runs[what] = [run for run in found if run.whole]
        notes = [f"{_error(run):.1e} in {run.seconds:.3f} s" for run in runs[what]]
        notes += [f"given up after {LIMIT:g} s"] * (len(found) - len(notes))
        best = min(map(_error, runs[what]), default=math.nan)
        yield Bar(f"{name}, {what}", None, best, "radii", note=", ".join(notes))


def _error(run: Ended) -> float:
    return float(np.nan_to_num(min(run.error, LOST), nan=LOST))


# --- page and figure ------------------------------------------------------------------------------


def page(full: bool) -> Iterator[Bar]:
    """Write the table in ``docs/truth.md``, and its figure, after a run of all set-ups."""
    known = setups()
    if len(FOUND) == len(known):
        file = ROOT / "docs" / "truth.md"
        head, _, rest = file.read_text("utf-8").partition(HEAD)
        _, _, tail = rest.partition(TAIL)
        file.write_text(f"{head}{HEAD}\n{tables()}{TAIL}{tail}", "utf-8")
        figure(ROOT / "docs" / "truth.png")
    yield Bar("set-ups of this run, for the page in docs", len(known), len(FOUND), least=True)
    yield Bar("this run", 300.0, time.perf_counter() - BEGIN, "s")


HEAD, TAIL = "<!-- written by python -m benchmarks truth -->", "<!-- end -->"


def tables() -> str:
    """Errors at a step of 1 ms or an accuracy of 1e-4, and processor time per simulated second."""
    names = list(dict.fromkeys(what for runs in FOUND.values() for what in runs))
    rows = [
        [what, *(_cell(runs.get(what), setups()[name]) for name, runs in FOUND.items())]
        for what in names
    ]
    about = f"{truth_drake.VERSION}, {truth_mujoco.VERSION}, {surroundings()}"
    return f"{markdown_table(['', *FOUND], rows)}\n{about}\n"


def _cell(runs: list[Ended] | None, setup: Setup) -> str:
    if runs is None:
        return ""
    if len(runs) < 2:
        return "slow"
    return f"{_error(runs[1]):.0e}, {1e3 * runs[1].seconds / setup.end:.0f} ms"


def figure(file: Path) -> None:
    """Error against processor time per simulated second, a panel a set-up."""
    names = list(dict.fromkeys(what for runs in FOUND.values() for what in runs))
    styles: dict[str, dict[str, Any]] = {}
    for k, what in enumerate(names):
        mark = "^" if what.startswith("MuJoCo") else "s" if "hydro" in what else "o"
        styles[what] = {"color": f"C{k % 10}", "marker": mark}
    ours = "exact: closed form or plan"
    styles[ours] = {"color": "crimson", "marker": "*", "markersize": 11, "linestyle": "none"}
    panels: dict[str, dict[str, Curve]] = {}
    for name, runs in FOUND.items():
        end, (error, spent) = setups()[name].end, EXACT[name]
        panels[name] = {
            what: (list(map(_error, found)), [r.seconds / end for r in found])
            for what, found in runs.items()
        }
        panels[name][ours] = [max(error, 1e-16)], [spent / end]
    off = f"how far off the ball ends, in its radii ({truth_drake.VERSION}, {truth_mujoco.VERSION})"
    overview(panels, styles, file, off, "processor time a simulated second [s]", columns=5)


SECTIONS: Sections = {"exact": exact}
SECTIONS |= {name: partial(simulated, name) for name in setups()}
SECTIONS["page"] = page
