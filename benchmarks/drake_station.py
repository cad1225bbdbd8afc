"""What contact physics makes of D1 to D3, and how fast: the paper's dynamic scenes in Drake.

Every scene is simulated over its whole horizon, with hydroelastic and with point contact.
"""

from __future__ import annotations

import functools
import itertools
import statistics
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

import contact_system as cs
from drake_plant import StationConfig, simulate
from drake_plant.measures import contact_table

from .report import Bar, Sections

SCENES = ("D1", "D2", "D3")
MODELS = ("hydroelastic", "point")
RECOVERY = {"D1": 0.2, "D2": 0.1, "D3": 1.0}
SPEED_TIME = 0.5  # [s] simulated in a run of the speed comparison


@functools.cache
def worst(name: str, model: str) -> dict[str, float]:
    """The measures of a scene's worst contact over the whole horizon."""
    scene = cs.load_scene(name)
    told = contact_table(simulate(scene, StationConfig.from_scene(scene, contact_model=model)))
    rows = [{**asdict(report), "off": abs(report.normal_mean - 1)} for report in told]
    numbers = [key for key, value in rows[0].items() if isinstance(value, float)]
    return {key: float(np.nanmax([row[key] for row in rows])) for key in numbers}


def forces(full: bool) -> Iterator[Bar]:
    """Normal force outside 0.1 s around edges, and friction against mu times it."""
    for (model, limit), name in itertools.product(zip(MODELS, (0.05, 0.01)), SCENES):
        what, found = f"{name} {model}: ", worst(name, model)
        yield Bar(what + "mean normal force off 1 N by", 0.01, found["off"], "N")
        yield Bar(what + "its standard deviation", limit, found["normal_deviation"], "N")
        note = f"saturated {found['saturated']:.0%} of the disturbance"
        yield Bar(what + "tangential force over mu N", 1.02, found["friction_ratio"], note=note)


def rolling(full: bool) -> Iterator[Bar]:
    """D1 before its disturbance: slip, friction, measured against planned contact points."""
    for model, limit in zip(MODELS, (1e-3, 1e-4)):
        what, found = f"D1 {model}: ", worst("D1", model)
        yield Bar(what + "slip over contact speed", limit, found["rolling_slip"])
        yield Bar(what + "friction spent", 0.1, found["rolling_friction"], "N")
        yield Bar(what + "contact point off the plan", 1e-3, found["distance"], "m")


def recovery(full: bool) -> Iterator[Bar]:
    """Time until slip is rejected, against what the paper reports."""
    for model, (name, limit) in itertools.product(MODELS, RECOVERY.items()):
        found = worst(name, model)
        note = f"to the slip of undisturbed rolling {found['settling']:.3f} s"
        yield Bar(f"{name} {model}: recovery", limit, found["recovery"], "s", note=note)


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
    what, note = "D1 hydroelastic: ", f"{theirs:.3g} times real time with those"
    over = "faster than Drake's spheres at 1.5 mm by"
    yield Bar(what + over, 3.0, ours / theirs, "x", True, note, detail=rates)
    yield Bar(what + "simulated over wall time", 1.0, ours, "x", True, "an aim")
    yield Bar(what + "building the Diagram", 3.0, statistics.median(builds), "s")


SECTIONS: Sections = {
    "forces": forces,
    "rolling": rolling,
    "recovery": recovery,
    "speed": speed,
}
