"""Forces that balance gravity: their programme, and a ball that three free tips hold."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator
from time import perf_counter

import numpy as np

import contact_system as cs
from drake_plant import StationConfig, balancing_forces, object_report, simulate
from drake_plant.balance import friction_used

from .report import Bar, Sections

MODELS = ("point", "hydroelastic")
WEIGHT = np.array([0.0, 0.0, 0.2 * 9.81])
KNOTS, RUNS = 100, 20


def tips(sigma: float = 1e-6, duration: float = 5.0) -> cs.Scene:
    """A ball of 0.2 kg between three free fingertips around its equator."""
    contacts = [
        cs.Contact(
            finger=cs.Sphere(0.02),
            object_at=(math.pi / 2, 2 * math.pi * i / 3),
            finger_at=(math.pi / 2, 0),
            object_velocity="rolling",
        )
        for i in range(3)
    ]
    return cs.Scene(
        object=cs.Sphere(0.05),
        contacts=contacts,
        profile=cs.Profile([sigma]),
        duration=duration,
        name="tips",
        drake={"object_mass": 0.2, "finger_mass": 0.05, "gravity": 9.81},
    )


def programme(full: bool) -> Iterator[Bar]:
    """Three fingers about the equator of a ball, scattered by a tenth of its size."""
    rng, angles = np.random.default_rng(33), 2 * np.pi * np.arange(3) / 3
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
    points = 0.05 * (points + 0.1 * rng.normal(size=(KNOTS, 3, 3)))
    normals = -points / np.linalg.norm(points, axis=-1, keepdims=True)
    force, torque = np.tile(WEIGHT, (KNOTS, 1)), np.zeros((KNOTS, 3))
    for count, limit in ((1, None), (KNOTS, 0.05)):
        times = []
        for _ in range(RUNS):
            begin = perf_counter()
            found = balancing_forces(
                *(x[:count] for x in (points, normals)), 0.5, force[:count], torque[:count]
            )
            times.append(perf_counter() - begin)
        yield Bar(f"forces at {count} times, three contacts", limit, statistics.median(times), "s")
    left = np.abs(found.sum(axis=1) - force).max() / WEIGHT[2]
    yield Bar("force that is left, of the weight", 1e-8, left)
    left = np.abs(np.cross(points, found).sum(axis=1)).max() / (0.05 * WEIGHT[2])
    yield Bar("torque that is left, of weight times radius", 1e-8, left)
    over = friction_used(found, normals, 0.5).max() - 0.8
    yield Bar("part of a cone used beyond 80 %", 1e-6, max(over, 0.0))


def hold(full: bool) -> Iterator[Bar]:
    """Three free tips hold a ball of 0.2 kg against gravity for 5 s, contacts all but at rest."""
    yield from _held(tips(), "held 5 s", slip=None)


def roll(full: bool) -> Iterator[Bar]:
    """They roll on it at 20 mm/s meanwhile, for 1 s."""
    yield from _held(tips(sigma=0.02, duration=1.0), "rolled on", slip=0.5)


def _held(scene: cs.Scene, what: str, slip: float | None) -> Iterator[Bar]:
    for model in MODELS:
        result = simulate(scene, StationConfig.from_scene(scene, contact_model=model))
        found, measured = object_report(result), result.measured
        steps = np.diff(result.t)[:, None]
        slid = (steps * np.linalg.norm(measured["slip"][1:], axis=2)).sum(axis=0).max()
        head = f"{what}, {model}: "
        yield Bar(head + "the ball moved by", 1.0, 1e3 * found.moved, "mm")
        yield Bar(head + "it turned by", 1.0, math.degrees(found.turned), "degrees")
        yield Bar(
            head + "off the object", 0.0, (steps * (measured["normal_force"][1:] <= 0)).sum(), "s"
        )
        planned = result.planned["friction_used"].max()
        yield Bar(head + "friction used, planned", 0.9, planned)
        yield Bar(head + "measured", 0.9, np.nanmax(measured["friction_used"]))
        yield Bar(head + "slip summed, worst finger", slip, 1e3 * slid, "mm")


SECTIONS: Sections = {"programme": programme, "hold": hold, "roll": roll}
