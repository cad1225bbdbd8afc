"""Routes to goals: whether they arrive, how fast, and how long they are.

Times are those of the processor.
"""

from __future__ import annotations

import dataclasses
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
    yield Bar(f"{name}, median time", limit, median, "ms")
    yield Bar(f"{name}, 99 %", 10 * limit if limit else None, most, "ms")


# --- lengths -----------------------------------------------------------------------------------


def lengths(full: bool) -> Iterator[Bar]:
    """A sphere on a plane beside Hammersley's four rolls; routes after the optimiser."""
    finger, obj, _ = PAIRS["sphere on plane"]
    rng, ratios = np.random.default_rng(2), []
    for _ in range(1000 if full else 200):
        scene, given = _scene(finger, obj, **_drawn(rng, finger, obj)), _drawn(rng, finger, obj)
        route = cs.reach(scene, cs.Goal(**given))
        ratios.append(route.length / _four_rolls(scene, given, finger.radius))
    note = f"median {np.median(ratios):.2f}"
    yield Bar("sphere on plane, length over that of four rolls", 1 + 1e-9, max(ratios), note=note)
    for name, (finger, obj, _) in PAIRS.items():
        rng, parts = np.random.default_rng(3), []
        for _ in range(20 if full else 5):
            scene, goal = _scene(finger, obj, **_drawn(rng, finger, obj)), _drawn(rng, finger, obj)
            first = cs.reach(scene, cs.Goal(**goal))
            best = cs.reach(scene, cs.Goal(**goal), seconds=0.2)
            parts.append(best.length / first.length)
        note = f"{min(parts):.2f} to {max(parts):.2f}, in 0.2 s"
        yield Bar(f"{name}, length after over before", 1.0, float(np.median(parts)), note=note)


def _four_rolls(scene: cs.Scene, goal: dict, r: float) -> float:
    """Two rolls that turn the sphere as wanted, two whole revolutions that move it (1983), m."""
    contact = scene.contacts[0]
    after = dataclasses.replace(contact, **goal)
    first, last = (cs.plan(scene.replace(contacts=[c])).pose(0.0)[0, 0] for c in (contact, after))
    move, turn = (last - first)[:2, 3], last[:3, :3] @ first[:3, :3].T
    angle = math.acos(min(1.0, max(-1.0, (np.trace(turn) - 1) / 2)))
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    axis *= math.sin(angle / 2) / (2 * math.sin(angle))
    (x, y, z), w = axis, math.cos(angle / 2)
    best = math.inf
    for h in np.linspace(0.0, math.pi, 360, endpoint=False):
        c, s = math.cos(h), math.sin(h)
        half = math.atan2(z, x * s - y * c)  # the rest of the turn has a level axis, too
        half = math.remainder(half, math.pi)
        p, q = math.cos(half), math.sin(half)
        rest = (
            w * p + q * (x * c + y * s),
            x * p - w * q * c + z * q * s,
            y * p - w * q * s - z * q * c,
        )
        sign = -1.0 if rest[0] < 0 else 1.0
        other = 2 * math.atan2(math.hypot(*rest[1:]), sign * rest[0])
        level = sign * np.array(rest[1:]) / max(math.hypot(*rest[1:]), 1e-300)
        rolled = 2 * half * np.array([s, -c]) + other * np.array([level[1], -level[0]])
        times = max(1, math.ceil(np.linalg.norm(move - r * rolled) / (4 * math.pi * r)))
        best = min(best, r * (abs(2 * half) + other) + 4 * math.pi * r * times)
    return best


def loops(full: bool) -> Iterator[Bar]:
    """Closed paths that turn the finger, and Gauss and Bonnet's law on them."""
    for name, (finger, obj, _) in PAIRS.items():
        worst, off = 0.0, 0.0
        for angle in np.linspace(-3.0, 3.0, 20 if full else 6):
            found = cs.loop(_scene(finger, obj), float(angle))
            worst, off = max(worst, found.gauss_bonnet), max(off, found.residual)
        yield Bar(f"{name}, loops, distance from where they begin", LIMIT, off)
        yield Bar(f"{name}, loops, psi against the curvature enclosed", 1e-9, worst, "rad")


SECTIONS: Sections = {"goals": goals, "lengths": lengths, "loops": loops}
