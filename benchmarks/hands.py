"""A hand holds and turns objects in Drake: H1 to H5, planning, and random reorientations."""

from __future__ import annotations

import functools
import math
import statistics
from collections.abc import Iterator
from time import perf_counter

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation

import contact_system as cs
from drake_plant import (
    HandReport,
    StationConfig,
    hand_report,
    plan_reorientation,
    simulate,
    simulate_hand,
)

from .report import Bar, Sections

MODELS = {"H1": ("point", "hydroelastic"), "H2": ("point", "hydroelastic")}
MODELS |= {"H3": ("hydroelastic",), "H4": ("point", "hydroelastic")}
MODELS |= {"H5": ("point", "hydroelastic")}
RUNS = 20  # of planning
MANY, GREATEST = 50, 30.0  # random reorientations, degrees


@functools.cache
def _report(name: str, model: str) -> HandReport:
    scene = cs.load_scene(name)
    return hand_report(simulate(scene, StationConfig.from_scene(scene, contact_model=model)))


def scenes(full: bool) -> Iterator[Bar]:
    """Where the object ends, or how far it drifts, friction, slip, limits."""
    for name, models in MODELS.items():
        for model in models:
            report, what = _report(name, model), f"{name} {model}: "
            part = slice(None) if name == "H1" else slice(-1, None)  # H1's drift, else the end
            yield Bar(what + "off", 1.0, 1e3 * report.off[part].max(), "mm")
            angle = math.degrees(report.turned_off[part].max())
            yield Bar(what + "angle off", 1.0, angle, "degrees")
            yield Bar(what + "off the object", 0.0, report.time_off.max(), "s")
            yield Bar(what + "friction used, planned", 0.9, report.cones_planned.max())
            yield Bar(what + "friction used, outside pushes", 0.9, report.cones.max())
            limit = 0.5 if name in ("H2", "H5") else None
            yield Bar(what + "slip summed, worst finger", limit, 1e3 * report.slipped.max(), "mm")
            yield Bar(what + "torque over its limit", 1.0, report.torque_share.max())
            room = math.degrees(report.room.min())
            yield Bar(what + "joint nearest to its limit", 0.0, room, "degrees", least=True)


def planning(full: bool) -> Iterator[Bar]:
    """`plan_reorientation` of H2, H3 and H5, contacts, joints and forces, as a user calls it."""
    for name in ("H2", "H3", "H5"):
        scene, times = cs.load_scene(name), []
        hand = StationConfig.from_scene(scene).hand
        for _ in range(RUNS):
            begin = perf_counter()
            plan_reorientation(hand, scene)
            times.append(perf_counter() - begin)
        note = f"the first {times[0]:.3f} s; the aim is 0.1"
        yield Bar(f"{name}: planned within", 0.5, statistics.median(times), "s", note=note)


def random(full: bool) -> Iterator[Bar]:
    """H2's ball turned about random axes by up to 30 degrees, in point contact; one run in ten
    without --full."""
    scene, rng = cs.load_scene("H2"), np.random.default_rng(33)
    scene = scene.replace(duration=3.0)
    config = StationConfig.from_scene(scene, contact_model="point")
    refused, plans = [], []
    for _ in range(MANY):
        axis = rng.normal(size=3)
        turn = math.radians(rng.uniform(1, GREATEST)) * axis / np.linalg.norm(axis)
        goal = RigidTransform(RotationMatrix(Rotation.from_rotvec(turn).as_matrix()))
        try:
            plans.append(plan_reorientation(config.hand, scene, goal, config=config))
        except cs.SceneError as error:
            refused.append(str(error))
    note = "; ".join(refused)
    yield Bar(f"of {MANY} random turns, planned", 0.8, len(plans) / MANY, least=True, note=note)
    tried = plans if full else plans[::10]
    done = []
    for plan in tried:
        report = hand_report(simulate_hand(plan))
        done.append(
            1e3 * report.off[-1] <= 1
            and math.degrees(report.turned_off[-1]) <= 1
            and report.cones.max() <= 0.9
            and report.slipped.max() <= 5e-4
            and not report.time_off.any()
        )
    share, note = float(np.mean(done)), f"{len(tried)} simulated"
    yield Bar("of these, done within the bars of H2", 0.95, share, least=True, note=note)


SECTIONS: Sections = {"scenes": scenes, "planning": planning, "random": random}
