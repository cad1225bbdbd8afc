"""Two-point geodesics: whether they end where they should, whether they are the shortest, time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import contact_system as cs
from contact_system.steering.shooting import FINE, Search
from contact_system.steering.two_points import Pairs

from .report import Bar, Sections

DENSE, PARTS = 720, 160
"""Directions, and parts of the length, of the dense search."""
GROUND = cs.ParametricSurface(
    ("u", "v", "h*sin(5*u)*cos(4*v)"), parameters={"h": 0.1}, size=0.2, u_range=(-1, 1)
)
CASES = {
    "ellipsoid": (cs.Ellipsoid(0.3, 0.2, 0.1), 10000),
    "torus": (cs.Torus(0.3, 0.1), 1000),
    "user's chart": (GROUND, 1000),
}
FLATTENINGS = {"WGS84": 1 / 298.257223563, "oblate": 0.01, "prolate": -0.01}


def _sphere(rng: np.random.Generator, n: int) -> np.ndarray:
    x = rng.normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def _drawn(rng: np.random.Generator, surface: cs.Surface, n: int) -> np.ndarray:
    """Random points; on ellipsoids even on the sphere that they are stretched from."""
    if isinstance(surface, cs.Ellipsoid):
        return _sphere(rng, n) * [surface.a, surface.b, surface.c]
    reach = math.pi if isinstance(surface, cs.Torus) else 0.8
    return rng.uniform(-reach, reach, (n, 2))


def _spent(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call returns, and its processor time, s: the least of three."""
    times = []
    for _ in range(3):
        begin = time.process_time()
        found = call()
        times.append(time.process_time() - begin)
    return found, min(times)


def _shorter(surface: cs.Surface, a: np.ndarray, b: np.ndarray, length: np.ndarray) -> int:
    """How many pairs have a shorter geodesic, by Newton's method from a grid of polar coordinates.

    From each place of the grid that is nearer to b than its neighbours.
    """
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
        _, s, met, _ = Search(pairs).aim(pair, 2 * math.pi * ray / DENSE, s, FINE)
        found += len(set(pair[met & (s < reach[pair] * (1 - 1e-7))]))
    return found


def shortest(full: bool) -> Iterator[Bar]:
    """Random pairs against a dense search of directions."""
    for name, (surface, count) in CASES.items():
        count = count if full else count // 20
        rng = np.random.default_rng(3)
        a, b = _drawn(rng, surface, count), _drawn(rng, surface, count)
        lines = cs.geodesic(surface, a, b)
        pairs = Pairs(surface, a, b)
        ends = pairs.follow(pairs.start(np.arange(count), lines.direction), lines.length, 1e-16)
        off = np.linalg.norm(ends[:3].T - pairs.b, axis=1).max() / surface.size
        yield Bar(f"{name}, {count} pairs, end, sizes", 1e-12, off)
        yield Bar(f"{name}, not the shortest", 0, _shorter(surface, a, b, lines.length))


def revolution(full: bool) -> Iterator[Bar]:
    """Distances on ellipsoids of revolution against geographiclib's Python."""
    from geographiclib.geodesic import Geodesic

    count = 10000 if full else 2000
    for name, f in FLATTENINGS.items():
        b, rng = 1 - f, np.random.default_rng(2)
        x = _sphere(rng, 2 * count).reshape(2, count, 3)
        lat, lon = (
            np.arctan2(x[..., 2], b * np.hypot(x[..., 0], x[..., 1])),
            np.arctan2(x[..., 1], x[..., 0]),
        )
        points = x * [1, 1, b]
        surface = cs.Ellipsoid(1, 1, b) if f > 0 else cs.Ellipsoid(b, 1, 1)
        points = points if f > 0 else np.roll(points, 1, axis=-1)
        lines, own = _spent(lambda: cs.geodesic(surface, *points))  # noqa: B023
        inverse = Geodesic(1.0, f).Inverse
        places = np.degrees([lat[0], lon[0], lat[1], lon[1]]).T.tolist()
        known, theirs = _spent(
            lambda: [inverse(*w, Geodesic.DISTANCE)["s12"] for w in places]  # noqa: B023
        )
        yield Bar(f"{name}, {count} pairs, distance", 1e-12, np.abs(lines.length - known).max())
        note = f"{1e6 * own / count:.3g} us a pair, geographiclib {1e6 * theirs / count:.3g} us"
        yield Bar(f"{name}, times as fast", 10, theirs / own, least=True, note=note)


SECTIONS: Sections = {"shortest": shortest, "revolution": revolution}
