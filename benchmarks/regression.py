"""Figures kept by version, so that a slower commit shows.

A figure is the time of one of our jobs over that of a fixed job of scipy's in the same run, turn by
turn, which depends little on the machine. ``history.json`` keeps a record for each commit: version,
commit, date, processor, figures. A run is held to the best record of its processor (of all, where
there is none), and fails where it is slower by more than a quarter with a confidence of 95 %.
"""

from __future__ import annotations

import dataclasses
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import contact_system as cs
from contact_system.kernels import find_compiler

from . import scale
from .report import Bar, Sections, markdown_table, surroundings
from .timing import Job, least, sample

HISTORY = Path(__file__).parent / "history.json"
LIMIT = 1.25
ONE_SIDED = 1.645  # standard errors: 95 %
BETWEEN_RUNS = 0.05  # log; what medians of one commit scatter by from run to run, at least
TURNS = 15
BURST = 0.02  # [s]
SHOWN = 4
STEPS = 200  # of a slave; one run fills a sample


# --- measuring -----------------------------------------------------------------------------------


def reference_job() -> Job:
    """A pendulum by scipy's DOP853: Python, numpy and small arrays, as our own jobs are."""

    def pendulum(t: float, y: np.ndarray) -> list[float]:
        return [y[1], -math.sin(y[0])]

    return Job(lambda _: solve_ivp(pendulum, (0.0, 10.0), [1.0, 0.0], "DOP853", rtol=1e-9))


def jobs() -> dict[str, Job]:
    """Our jobs by the name of their figure."""
    engine = bool(find_compiler())
    found = {
        f"plan {name}, new scene, states": _plan_job(name, engine, True)
        for name in ("K1", "K4", "D2")
    }
    found |= {
        "plan K4, points": _plan_job("K4", engine, False),
        "plan K4, points, virtual machine": _plan_job("K4", False, False),
        "load scene K4": Job(lambda _: cs.load_scene("K4")),
        "poses and twists of K4": _outputs_job(engine),
        "sweep of 500 scenes": _sweep_job(engine),
        "import": Job(lambda _: _run("import contact_system")),
    }
    try:
        found["step of an in-process slave, K1"] = _slave_job()
    except ImportError:
        pass  # without fmpy its figure is missing, and compared with nothing
    return found


def _plan_job(name: str, compiled: bool, new: bool) -> Job:
    scene = cs.load_scene(name)
    t = np.linspace(0.0, scene.duration, 101)

    def call(scene: cs.Scene) -> None:
        plan = cs.plan(scene, compiled=compiled)
        plan.states(t) if new else plan.points(t)

    return Job(call, (lambda: dataclasses.replace(scene)) if new else (lambda: scene))


def _outputs_job(compiled: bool) -> Job:
    plan = cs.plan(cs.load_scene("K4"), compiled=compiled)
    t = np.linspace(0.0, plan.scene.duration, 101)
    return Job(lambda _: (plan.pose(t), plan.twist(t)))


def _sweep_job(compiled: bool) -> Job:
    scenes = [scale.scene(k) for k in range(500)]
    return Job(lambda _: cs.sweep(scenes, scale.evaluate, compiled=compiled))


def _slave_job() -> Job:
    from fmu_export import PlannerSlave2

    slave = PlannerSlave2(cs.load_scene("K1"))
    slave.instantiate()

    def make() -> Any:
        slave.reset()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        return slave

    def call(slave: Any) -> None:
        for k in range(STEPS):
            slave.doStep(k * 1e-3, 1e-3)

    return Job(call, make)


def _run(code: str) -> None:
    subprocess.run([sys.executable, "-c", code], check=True)


def measure(turns: int = TURNS) -> dict[str, dict[str, float]]:
    """Each figure's median ratio, the standard error of its logarithm, and its time in s."""
    reference, own = reference_job(), jobs()
    counts = {}
    for name, job in own.items():
        sample(job)
        # the first scenes of a kind are planned in full: a few calls a turn would be cold ones
        counts[name] = max(1, round(BURST / max(least(job), 1e-9)))
    counts |= {name: 1 for name in own if name.startswith("step")}  # the slave is one
    sample(reference)
    per_turn = max(1, round(BURST / sample(reference)))
    ratios: dict[str, list[float]] = {name: [] for name in own}
    times: dict[str, list[float]] = {name: [] for name in own}
    before = sample(reference, per_turn)
    for _ in range(turns):
        for name, job in own.items():
            spent = sample(job, counts[name])
            after = sample(reference, per_turn)
            ratios[name].append(2.0 * spent / (before + after))
            times[name].append(spent)
            before = after
    return {name: figure(ratios[name], statistics.median(times[name])) for name in own}


def figure(ratios: Sequence[float], seconds: float) -> dict[str, float]:
    """What a record keeps: median ratio, standard error of its logarithm, time in s."""
    low, _, high = statistics.quantiles([math.log(ratio) for ratio in ratios], n=4)
    deviation = (high - low) / 1.349  # of a normal distribution with these quartiles
    error = 1.2533 * deviation / math.sqrt(len(ratios))  # of its median
    return {"ratio": statistics.median(ratios), "error": error, "s": seconds}


# --- records -------------------------------------------------------------------------------------


def read_history(path: Path = HISTORY) -> list[dict[str, Any]]:
    """All records, the oldest first; none where there is no file."""
    return json.loads(path.read_text()) if path.exists() else []


def keep(
    history: Sequence[dict[str, Any]], record: dict[str, Any], path: Path = HISTORY
) -> list[dict[str, Any]]:
    """Write the history with a record, which replaces that of its commit on its processor."""
    key = record["commit"], record["processor"]
    others = [old for old in history if (old["commit"], old["processor"]) != key]
    kept = [*others, record]
    path.write_text(json.dumps(kept, indent=1) + "\n")
    return kept


def record_of(figures: dict[str, dict[str, float]]) -> dict[str, Any]:
    """A record of this commit; one with changes in the tree bears a "+"."""
    about = surroundings()
    return {
        "version": cs.__version__, "commit": _commit(), "date": about["date"],
        "processor": about["machine"]["processor"], "figures": figures,
    }  # fmt: skip


def _commit() -> str:
    folder = Path(__file__).parents[1]
    said = []
    for command in ("rev-parse --short HEAD", "status --porcelain -uno -- *.py *.c *.h"):
        try:
            run = subprocess.run(
                ["git", *command.split()], capture_output=True, text=True, check=True, cwd=folder
            )
        except (OSError, subprocess.CalledProcessError):
            return "unknown"
        said.append(run.stdout.strip())
    return said[0] + "+" * bool(said[1])


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A figure against the best record's.

    Attributes
    ----------
    slower : ratio of the medians
    surely : what it is at least, with a confidence of 95 %
    commit : of the best record
    """

    slower: float
    surely: float
    commit: str

    @property
    def confidence(self) -> float:
        """That it is slower by more than `LIMIT`."""
        error = math.log(self.slower / self.surely) / ONE_SIDED
        return 0.5 * (1.0 + math.erf(math.log(self.slower / LIMIT) / error / math.sqrt(2.0)))


def compare(
    history: Sequence[dict[str, Any]], record: dict[str, Any]
) -> dict[str, Comparison | None]:
    """Each figure of a record against the best of the others; None where there is none."""
    others = [old for old in history if old["commit"] != record["commit"]]
    alike = [old for old in others if old["processor"] == record["processor"]]
    found: dict[str, Comparison | None] = {}
    for name, own in record["figures"].items():
        known = [old for old in alike or others if name in old["figures"]]
        if not known:
            found[name] = None
            continue
        best = min(known, key=lambda old: old["figures"][name]["ratio"])
        other = best["figures"][name]
        error = math.hypot(own["error"], other["error"], BETWEEN_RUNS)
        slower = own["ratio"] / other["ratio"]
        found[name] = Comparison(slower, slower * math.exp(-ONE_SIDED * error), best["commit"])
    return found


def figures(full: bool) -> Iterator[Bar]:
    """This commit beside those before it, and against the best of them."""
    begin = time.perf_counter()
    record = record_of(measure(3 * TURNS if full else TURNS))
    history = read_history()
    for name, found in compare(history, record).items():
        what = f"{name}: over the best record, surely"
        own = record["figures"][name]
        if found is None:
            yield Bar(what, LIMIT, None, "x", note=f"the first record, {own['ratio']:.3g}")
            continue
        note = f"{found.slower:.2f} of {found.commit}, {1e3 * own['s']:.3g} ms"
        if found.slower > LIMIT:
            note += f"; slower by more than a quarter: confidence {found.confidence:.0%}"
        yield Bar(what, LIMIT, found.surely, "x", note=note)
    kept = keep(history, record)
    head = ["time over scipy's", *(f"{old['version']} {old['commit']}" for old in kept[-SHOWN:])]
    rows = [
        [name, *(f"{old['figures'][name]['ratio']:.3g}" if name in old["figures"] else ""
                 for old in kept[-SHOWN:])]
        for name in record["figures"]
    ]  # fmt: skip
    print(markdown_table(head, rows), end="")
    print(f"{len(kept)} records in {HISTORY.name}; {time.perf_counter() - begin:.0f} s")


SECTIONS: Sections = {"figures": figures}
