"""Stress cases of ContactPlanner under Drake's schemes, with equal steps or error control.

What is not refused must be within twice what ContactPlanner promises of contact points (it looks at
every twentieth of a scene), slip within a thousandth of the greatest speed.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any

import numpy as np

import contact_system as cs
from drake_plant import ContactPlanner
from drake_plant.plan_check import TOLERANCE

from .drake_planner import simulator_of
from .stress_cases import grid
from .stress_scenes import Draw
from .verdicts import Meter, Verdict

Run = tuple[str, str, str, float, float | None]
IMPLICIT = ("implicit_euler", "radau1", "velocity_implicit_euler", "radau3")
ESTIMATING = ("bogacki_shampine3", "runge_kutta3", "runge_kutta5")
"""Explicit schemes that estimate their error; to the others Drake gives steps of equal length."""
SCHEMES = ("explicit_euler", "semi_explicit_euler", "runge_kutta2", *IMPLICIT, *ESTIMATING)
STEP_LENGTHS = (1e-3, 1e-2, 3e-2, 0.1)
ACCURACIES = (1e-2, 1e-4, 1e-6)
SIMULATED = 0.4
"""s that is simulated."""


def _driven_scenes() -> Iterator[tuple[str, cs.Scene]]:
    """K1 to K4, with their windows soon after the start; K1 and K4 also with stiff gains."""
    for name in ("K1", "K2", "K3", "K4"):
        scene = cs.load_scene(name)
        early = {"start": 0.1, "stop": 0.2} if name == "K4" else {}
        windows = [dataclasses.replace(d, **early) for d in scene.disturbances]
        yield name, (scene := scene.replace(duration=SIMULATED, disturbances=windows))
        for eta in (1e3, 1e9) if name in ("K1", "K4") else ():
            yield f"{name} with eta {eta:g}", scene.replace(gain=cs.Gain.time(eta))


DRIVEN = dict(_driven_scenes())


@functools.cache
def _driven(name: str, coordinates: str) -> tuple[Any, cs.Plan]:
    """A planner for Drake, and the plan of its scene."""
    return ContactPlanner(DRIVEN[name], coordinates), cs.plan(DRIVEN[name], 1e-13)


def drive(draw: Draw, run: Run) -> Verdict:
    """What a scheme ends with, against the plan."""
    name, coordinates, scheme, step, accuracy = run
    (planner, plan), meter, scene = _driven(name, coordinates), Meter(), DRIVEN[name]
    simulator = simulator_of(planner, scheme, step, accuracy)
    simulator.AdvanceTo(SIMULATED)
    context, port = simulator.get_context(), planner.GetOutputPort
    points = port("contact_point").Eval(context).reshape(-1, 2, 3)
    slip = np.linalg.norm(port("slip").Eval(context).reshape(-1, 2), axis=-1)
    size = max(scene.object.size, *(c.finger.size for c in scene.contacts))
    promised = TOLERANCE * (size + float(scene.profile.arc_length(SIMULATED)))
    away = np.linalg.norm(points - plan.points(SIMULATED)[0], axis=-1)
    meter.see("points", away, 2 * promised)
    most = float(scene.profile(np.linspace(0, SIMULATED, 41)).max())
    meter.see("slip", slip - plan.slip_speed(SIMULATED)[0], 1e-3 * most)
    return meter.verdict()


def _runs() -> list[Run]:
    """Scene, coordinates, scheme, step and accuracy of every run, the longest steps first.

    Left out are schemes that do not estimate their error, under error control; and what takes steps
    of 1 / lam by its nature, up to 4e8 of them: explicit schemes under error control where a gain
    of 1e6 or more is integrated.
    """
    lengths: list[tuple[float, float | None]] = [(0.1, a) for a in ACCURACIES]
    lengths += [(h, None) for h in sorted(STEP_LENGTHS, reverse=True)]
    return [
        (name, coordinates, scheme, step, accuracy)
        for step, accuracy in lengths
        for scheme in SCHEMES
        for name in DRIVEN
        for coordinates in ("chart", "frame")
        if not accuracy
        or scheme in IMPLICIT
        or (scheme in ESTIMATING and not name.endswith("e+09"))
    ]


RUNS = _runs()
FAMILIES = [grid("Drake", 1, drive, run=RUNS)]
