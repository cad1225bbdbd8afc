"""Goals of a place on both bodies and the angle: whether they are reached, how fast, how far."""

from __future__ import annotations

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


def goals(full: bool) -> Iterator[Bar]:
    """Random starts and goals on every pair."""
    count = 1000 if full else 100
    for name, (finger, obj, limit) in PAIRS.items():
        rng, spent, off, legs, missed = np.random.default_rng(1), [], 0.0, 0, 0
        for _ in range(count):
            contact = cs.Contact(finger, **_drawn(rng, finger, obj))
            scene = cs.Scene(
                object=obj, contacts=[contact], profile=cs.Profile([0.1]), duration=3.0
            )
            goal = cs.Goal(**_drawn(rng, finger, obj))
            begin = time.perf_counter()
            try:
                route = cs.reach(scene, goal)
            except cs.SceneError:
                missed += 1
                continue
            finally:
                spent.append(1e3 * (time.perf_counter() - begin))
            end = cs.plan(route.scene, 1e-15).points(3.0)[0, 0]
            wanted = finger.point(*goal.finger_at), obj.point(*goal.object_at)
            sizes = finger.size, obj.size
            away = [np.linalg.norm(x - y) / z for x, y, z in zip(end, wanted, sizes)]
            off, legs = max(off, *away, route.residual), max(legs, len(route.legs[0]))
        yield Bar(f"{name}, {count} goals, not reached", 0, missed, note=f"{legs} legs at most")
        yield Bar(f"{name}, greatest distance from the goal, sizes", LIMIT, off)
        yield Bar(f"{name}, median time", limit, float(np.median(spent)), "ms")
        yield Bar(f"{name}, 99 %", 10 * limit, float(np.quantile(spent, 0.99)), "ms")


SECTIONS: Sections = {"goals": goals}
