"""Routes to goals: whether they arrive and how fast.

Times are those of the processor.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np

import contact_system as cs

from .report import Bar, Sections

SMALL, ROUND = cs.Sphere(0.04), cs.Ellipsoid(0.3, 0.2, 0.1)
PAIRS = {
    "sphere on plane": (SMALL, cs.Plane(), 1.0),
    "sphere on sphere": (SMALL, cs.Sphere(0.1), 1.0),
    "sphere on ellipsoid": (SMALL, ROUND, 10.0),
    "ellipsoid on ellipsoid": (cs.Ellipsoid(0.05, 0.04, 0.03), ROUND, 10.0),
    "sphere in a bowl": (SMALL, cs.Sphere(0.2, inside=True), 1.0),
    "sphere on torus": (SMALL, cs.Torus(0.3, 0.1), 10.0),
}
"""Finger, object, and the median's bar in ms; that of 99 % is ten times it."""
LIMIT = 1e-12


def _place(rng: np.random.Generator, surface: cs.Surface) -> tuple[float, float]:
    if isinstance(surface, cs.Plane):
        u, v = rng.uniform(-0.3, 0.3, 2)
    else:
        u, v = rng.uniform(0.3, 2.8), rng.uniform(-1.4, 1.4)
    return float(u), float(v)


def _drawn(rng: np.random.Generator, finger: cs.Surface, obj: cs.Surface) -> dict:
    places = {"object_at": _place(rng, obj), "finger_at": _place(rng, finger)}
    return {**places, "angle": float(rng.uniform(-3.0, 3.0))}


def _scene(finger: cs.Surface, obj: cs.Surface, **contact) -> cs.Scene:
    at = {"object_at": (1.0, 0.2), "finger_at": (1.1, 0.4), "angle": 0.3, **contact}
    gain = cs.Gain.time(2 * math.log(1e9) / 3.0)  # slip falls by 1e9 half-way
    made = {"contacts": [cs.Contact(finger, **at)], "duration": 3.0, "gain": gain}
    return cs.Scene(object=obj, profile=cs.Profile([0.1]), **made)


def goals(full: bool) -> Iterator[Bar]:
    """Random starts and goals on every pair; with slip at the start too."""
    for name, (finger, obj, limit) in PAIRS.items():
        yield from _goals(name, finger, obj, 1000 if full else 100, limit)
    for name, (finger, obj, _) in PAIRS.items():
        yield from _goals(f"{name}, slipping", finger, obj, 100 if full else 20, None)


def _goals(
    name: str, finger: cs.Surface, obj: cs.Surface, count: int, limit: float | None
) -> Iterator[Bar]:
    rng, spent, off, legs, missed = np.random.default_rng(1), [], 0.0, 0, 0
    for _ in range(count):
        slips = {} if limit else {"object_velocity": tuple(rng.uniform(-1.0, 1.0, 2))}
        scene = _scene(finger, obj, **_drawn(rng, finger, obj), **slips)
        goal = cs.Goal(**_drawn(rng, finger, obj))
        begin = time.process_time()
        try:
            route = cs.reach(scene, goal)
        except cs.SceneError:
            missed += 1
            continue
        finally:
            spent.append(1e3 * (time.process_time() - begin))
        end = cs.plan(route.scene, 1e-15).points(3.0)[0, 0]
        wanted = finger.point(*goal.finger_at), obj.point(*goal.object_at)
        away = [np.linalg.norm(x - y) / b.size for x, y, b in zip(end, wanted, (finger, obj))]
        off, legs = max(off, *away, route.residual), max(legs, len(route.legs[0]))
    yield Bar(f"{name}, {count} goals, not reached", 0, missed, note=f"{legs} legs at most")
    yield Bar(f"{name}, greatest distance from the goal, sizes", LIMIT, off)
    median, most = np.quantile(spent, [0.5, 0.99]).tolist()
    if limit:
        yield Bar(f"{name}, median time", limit, median, "ms")
        yield Bar(f"{name}, 99 %", 10 * limit, most, "ms")


SECTIONS: Sections = {"goals": goals}
