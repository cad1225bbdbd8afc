"""What contact physics makes of D1 to D3, and how fast: the paper's dynamic scenes in Drake.

Every scene is simulated over its whole horizon, with hydroelastic and with point contact.
"""

from __future__ import annotations

import functools
import math
import statistics
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

import contact_system as cs
from drake_plant import StationConfig, simulate
from drake_plant.measures import ContactReport, contact_table
from drake_plant.station import SimulationResult

from .report import Bar
from .timing import resident

SCENES = ("D1", "D2", "D3")
MODELS = ("hydroelastic", "point")
RECOVERY = {"D1": 0.2, "D2": 0.1, "D3": 1.0}
SPEED_TIME = 0.5  # [s] simulated in a run of the speed comparison


@functools.cache
def run(name: str, model: str) -> SimulationResult:
    """A simulation of the whole horizon, kept for all bars that look at it."""
    scene = cs.load_scene(name)
    return simulate(scene, StationConfig.from_scene(scene, contact_model=model))


@functools.cache
def reports(name: str, model: str) -> list[ContactReport]:
    """Measures of its contacts."""
    return contact_table(run(name, model))


def _bar(
    what: str, name: str, model: str, limit: float, value: Callable[[ContactReport], float],
    unit: str = "", note: str = "",
) -> Bar:  # fmt: skip
    """The worst contact of a scene against a limit."""
    seen = reports(name, model)
    detail = {r.name: asdict(r) for r in seen}
    worst = max(value(r) for r in seen if not math.isnan(value(r)))
    return Bar(f"{name} {model}: {what}", limit, worst, unit, note=note, detail=detail)


def forces(full: bool) -> Iterator[Bar]:
    """Normal force outside 0.1 s around edges, and friction against mu times it."""
    for model, deviation in zip(MODELS, (0.05, 0.01)):
        for name in SCENES:
            yield _bar("mean normal force off 1 N by", name, model, 0.01,
                       lambda r: abs(r.normal_mean - 1), "N")  # fmt: skip
            yield _bar("its standard deviation", name, model, deviation,
                       lambda r: r.normal_deviation, "N")  # fmt: skip
            share = max(r.saturated for r in reports(name, model) if not math.isnan(r.saturated))
            yield _bar("tangential force over mu N", name, model, 1.02,
                       lambda r: r.friction_ratio,
                       note=f"saturated {share:.0%} of the disturbance")  # fmt: skip


def rolling(full: bool) -> Iterator[Bar]:
    """D1 before its disturbance: slip, friction, measured against planned contact points."""
    for model, slip in zip(MODELS, (1e-3, 1e-4)):
        yield _bar("slip over contact speed", "D1", model, slip, lambda r: r.rolling_slip)
        yield _bar("friction spent", "D1", model, 0.1, lambda r: r.rolling_friction, "N")
        yield _bar("contact point off the plan", "D1", model, 1e-3, lambda r: r.distance, "m")


def recovery(full: bool) -> Iterator[Bar]:
    """Time until slip is rejected, against what the paper reports."""
    for model in MODELS:
        for name in SCENES:
            rolling = max(r.settling for r in reports(name, model) if not math.isnan(r.settling))
            yield _bar("recovery", name, model, RECOVERY[name], lambda r: r.recovery, "s",
                       note=f"to the slip of undisturbed rolling {rolling:.3f} s")  # fmt: skip


def speed(full: bool) -> Iterator[Bar]:
    """Simulated over wall time, ours and Drake's own spheres at 1.5 mm, turn by turn."""
    scene = cs.load_scene("D1")
    meshes: dict[str, dict[str, Any]] = {"ours": {}, "Drake's": {"drake_spheres": 0.0015}}
    rates: dict[str, list[float]] = {name: [] for name in meshes}
    builds: list[float] = []
    for _ in range(5 if full else 3):
        for name, changes in meshes.items():
            config = StationConfig.from_scene(scene, **changes)
            result = simulate(scene, config, duration=SPEED_TIME)
            rates[name].append(SPEED_TIME / result.wall_time)
            if name == "ours":
                builds.append(result.build_time)
    ours, theirs = (statistics.median(rates[name]) for name in meshes)
    beside = f"{theirs:.3g} times real time with those"
    yield Bar("D1 hydroelastic: faster than Drake's spheres at 1.5 mm by", 3.0, ours / theirs, "x",
              least=True, note=beside, detail=rates)  # fmt: skip
    yield Bar("D1 hydroelastic: simulated over wall time", 1.0, ours, "x", least=True,
              note="an aim", detail=rates)  # fmt: skip
    yield Bar("D1 hydroelastic: building the Diagram", 3.0, statistics.median(builds), "s",
              detail={"builds": builds})  # fmt: skip


def memory(full: bool) -> Iterator[Bar]:
    """Growth of the process over 90 builds and short runs, after ten."""
    scene = cs.load_scene("D1")
    config = StationConfig.from_scene(scene, contact_model="hydroelastic")
    sizes = []
    for _ in range(100):
        simulate(scene, config, duration=0.005)
        sizes.append(resident())
    yield Bar("100 builds and short runs: growth after the tenth", 20.0, sizes[-1] - sizes[9], "MB",
              detail={"sizes": sizes})  # fmt: skip


SECTIONS = {
    "forces": forces,
    "rolling": rolling,
    "recovery": recovery,
    "speed": speed,
    "memory": memory,
}
