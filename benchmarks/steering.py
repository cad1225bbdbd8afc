"""Steering: goals, whether they are reached and how fast; geodesics, whether they are the shortest.

Times are those of the processor.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np

import contact_system as cs
from contact_system.steering.geodesic import Pairs
from contact_system.steering.shooting import Search

from .report import Bar, Sections

SMALL, ROUND = cs.Sphere(0.04), cs.Ellipsoid(0.3, 0.2, 0.1)
PAIRS = {
    "sphere on plane": (SMALL, cs.Plane(), 1.0),
    "sphere on sphere": (SMALL, cs.Sphere(0.1), 1.0),
    "sphere on a large sphere": (SMALL, cs.Sphere(5.0), 1.0),
    "sphere on ellipsoid": (SMALL, ROUND, 10.0),
    "ellipsoid on ellipsoid": (cs.Ellipsoid(0.05, 0.04, 0.03), ROUND, 10.0),
    "sphere in a bowl": (SMALL, cs.Sphere(0.2, inside=True), 1.0),
    "cylinder on sphere": (cs.Cylinder(0.02), cs.Sphere(0.3), 10.0),
    "sphere on torus": (SMALL, cs.Torus(0.3, 0.1), 10.0),
}
"""Finger, object, and the bar of the median time, ms; that of the 99 % quantile is ten times it."""


def _place(rng: np.random.Generator, surface: cs.Surface) -> tuple[float, float]:
    if isinstance(surface, cs.Plane):
        u, v = rng.uniform(-0.3, 0.3, 2)
    else:
        u, v = rng.uniform(0.3, 2.8), rng.uniform(-1.4, 1.4)
    return float(u), float(v)


def drawn(rng: np.random.Generator, finger: cs.Surface, obj: cs.Surface) -> dict:
    """Random places and angle of a start or a goal."""
    places = {"object_at": _place(rng, obj), "finger_at": _place(rng, finger)}
    return {**places, "angle": float(rng.uniform(-3.0, 3.0))}


def goals(full: bool) -> Iterator[Bar]:
    """Random starts and goals on every pair."""
    for name, (finger, obj, limit) in PAIRS.items():
        rng, spent, off, legs, missed = np.random.default_rng(1), [], 0.0, 0, 0
        for _ in range(count := 1000 if full else 100):
            contact = cs.Contact(finger, **drawn(rng, finger, obj))
            scene = cs.Scene(
                object=obj, contacts=[contact], profile=cs.Profile([0.1]), duration=3.0
            )
            goal = cs.Goal(**drawn(rng, finger, obj))
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
        yield Bar(f"{name}, greatest distance from the goal, sizes", 1e-12, off)
        median, most = np.quantile(spent, [0.5, 0.99]).tolist()
        yield Bar(f"{name}, median time", limit, median, "ms")
        yield Bar(f"{name}, 99 %", 10 * limit, most, "ms")


# --- geodesics -----------------------------------------------------------------------------------

DENSE, PARTS = 720, 160
"""Numbers of directions, and of points along each, of the dense search."""
GROUND = cs.ParametricSurface(
    ("u", "v", "h*sin(5*u)*cos(4*v)"), parameters={"h": 0.1}, size=0.2, u_range=(-1, 1)
)
CASES = {
    "ellipsoid": (ROUND, 10000),
    "torus": (PAIRS["sphere on torus"][1], 1000),
    "user's chart": (GROUND, 1000),
}


def _points(rng: np.random.Generator, surface: cs.Surface, n: int) -> np.ndarray:
    """Random points; on ellipsoids, uniform on the sphere that is stretched to them."""
    if isinstance(surface, cs.Ellipsoid):
        x = rng.normal(size=(n, 3))
        return x / np.linalg.norm(x, axis=1, keepdims=True) * [surface.a, surface.b, surface.c]
    reach = math.pi if isinstance(surface, cs.Torus) else 0.8
    return rng.uniform(-reach, reach, (n, 2))


def _shorter(surface: cs.Surface, a: np.ndarray, b: np.ndarray, length: np.ndarray) -> int:
    """How many pairs have a geodesic shorter than their length.

    Newton's method starts at each point of a polar grid around a that is nearer to b than its
    neighbours."""
    found = 0
    for i in range(0, len(length), 8):
        pairs, reach = Pairs(surface, a[i : i + 8], b[i : i + 8]), length[i : i + 8]
        n = len(reach)
        which = np.repeat(np.arange(n), DENSE)
        phi = np.tile(2 * math.pi * np.arange(DENSE) / DENSE, n)
        x = pairs.follow(pairs.start(which, phi), reach[which], 1e-6, PARTS)[:, :3]
        away = np.linalg.norm(x - pairs.b[which].T, axis=1).reshape(PARTS, n, DENSE)
        padded = np.pad(away, ((1, 1), (0, 0), (0, 0)), constant_values=math.inf)
        around = np.minimum(padded[:-2], padded[2:])
        least = np.minimum(away, around)
        least = np.minimum(np.roll(least, 1, axis=2), np.roll(least, -1, axis=2))
        k, pair, ray = np.nonzero((away <= around) & (away <= least))
        s = (k + 1) / PARTS * reach[pair]
        _, s, met, _ = Search(pairs).aim(pair, 2 * math.pi * ray / DENSE, s)
        found += len(set(pair[met & (s < reach[pair] * (1 - 1e-7))]))
    return found


def shortest(full: bool) -> Iterator[Bar]:
    """Random pairs against a dense search of directions."""
    for name, (surface, count) in CASES.items():
        count = count if full else count // 20
        rng = np.random.default_rng(3)
        a, b = _points(rng, surface, count), _points(rng, surface, count)
        lines = cs.geodesic(surface, a, b)
        pairs = Pairs(surface, a, b)
        ends = pairs.follow(pairs.start(np.arange(count), lines.direction), lines.length, 1e-16)
        off = np.linalg.norm(ends[:3].T - pairs.b, axis=1).max() / surface.size
        yield Bar(f"{name}, {count} pairs, end, sizes", 1e-12, off)
        yield Bar(f"{name}, not the shortest", 0, _shorter(surface, a, b, lines.length))


SECTIONS: Sections = {"goals": goals, "shortest": shortest}
