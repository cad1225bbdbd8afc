"""What contact physics makes of D1 to D3, and how fast: the paper's dynamic scenes in Drake.

Every scene is simulated over its whole horizon, with hydroelastic and with point contact.
"""

from __future__ import annotations

import functools
import itertools
import statistics
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    GetIntegrationSchemes,
    Simulator,
    SimulatorConfig,
)

import contact_system as cs
from drake_plant import BuildStation, SetInitialState, StationConfig, simulate
from drake_plant.measures import contact_table

from .report import Bar, Sections

SCENES = ("D1", "D2", "D3")
MODELS = ("hydroelastic", "point")
RECOVERY = {"D1": 0.2, "D2": 0.1, "D3": 1.0}
SPEED_TIME = 0.5  # [s] simulated in a run of the speed comparison
SCHEMES_TIME = 0.1  # [s] simulated under every scheme
EULERS = ("explicit_euler", "semi_explicit_euler", "implicit_euler", "radau1", "runge_kutta2")
STEPS: dict[str, tuple[float, float | None]] = {
    **dict.fromkeys(EULERS, (1e-4, None)),
    **dict.fromkeys(("bogacki_shampine3", "runge_kutta3", "runge_kutta5"), (1e-3, 1e-2)),
    "cenic": (5e-4, 1e-4),
}
"""Greatest step, s, and accuracy, None without error control; 1e-3, None for others."""


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


def schemes(full: bool) -> Iterator[Bar]:
    """D1 on a continuous plant under all of Drake's schemes, against the discrete plant's."""
    plant = {"coordinates": "plan", "contact_model": "point"}
    discrete, _ = _points({**plant, "time_step": 1e-3}, "runge_kutta3", (1e-3, None))
    for scheme in GetIntegrationSchemes():
        points, spent = _points(
            {**plant, "time_step": 0.0}, scheme, STEPS.get(scheme, (1e-3, None))
        )
        apart = float(np.linalg.norm(points - discrete, axis=1).max())
        what = f"D1 to {SCHEMES_TIME} s, continuous, {scheme}: contact points apart"
        yield Bar(what, 5e-4, apart, "m", note=f"{spent:.1f} s")


def _points(
    changes: dict[str, Any], scheme: str, how: tuple[float, float | None]
) -> tuple[np.ndarray, float]:
    """Where the contacts of D1 are on the object at the end, and the time that it took, s."""
    scene, (step, accuracy) = cs.load_scene("D1"), how
    station = BuildStation(scene, StationConfig.from_scene(scene, **changes))
    simulator = Simulator(station)
    control = {"use_error_control": accuracy is not None, "accuracy": accuracy or 1e-3}
    config = SimulatorConfig(integration_scheme=scheme, max_step_size=step, **control)
    ApplySimulatorConfig(config, simulator)
    SetInitialState(station, simulator.get_mutable_context())
    begun = time.perf_counter()
    simulator.AdvanceTo(SCHEMES_TIME)
    port = station.GetOutputPort("measured_contact_point")
    points = port.Eval(simulator.get_context()).reshape(-1, 3)
    return points, time.perf_counter() - begun


SECTIONS: Sections = {
    "forces": forces,
    "rolling": rolling,
    "recovery": recovery,
    "speed": speed,
    "schemes": schemes,
}
