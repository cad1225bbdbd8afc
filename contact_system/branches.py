"""On which branch of its chart a path is: coordinates continued along it, here and in c/common.h.

Coordinates of a point in space are principal values. Where a chart has periods the nearest turn
continues them; where it covers its surface twice (triaxial ellipsoids), the cover changes where the
path crosses the seam cos v = 0, and there alone: which neighbours do not tell beside umbilics.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from .charts import TURN
from .surfaces import Surface, on_seam, second_cover
from .tracks import wind

Principal = Callable[[np.ndarray], np.ndarray]
"""Places on a path, (m,) -> u, v, rates, theta of all bodies in principal values: (n, 5, m)."""


def lay_anchors(
    surface: Surface, principal: Principal, at: np.ndarray, begin: np.ndarray
) -> np.ndarray:
    """u, v, theta at places on a path, (n, 3, m), continued from those where it begins, (n, 3)."""
    raw = principal(at)
    u, v, theta = (
        np.vstack([begin[:, k], raw[:, i].T]) for k, i in enumerate((0, 1, 4))
    )  # (1 + m, n): where it begins, then the places
    if surface.double_cover:
        # the second cover begins where a seam is crossed, which neighbours alone do not tell
        first = surface.align(u[1], v[1], u[0], v[0])[2]
        turned = np.logical_xor.accumulate(
            np.vstack([first, _seams(surface, principal, at, raw)]), axis=0
        )
        u[1:], v[1:] = np.where(turned, -u[1:], u[1:]), np.where(turned, np.pi - v[1:], v[1:])
        theta[1:] += np.pi * turned
    for values, period in zip((u, v, theta), (*surface.periods(), TURN)):
        if period is not None:
            values[:] = np.unwrap(values, axis=0, period=period)
    return np.stack([u, v, theta])[:, 1:].transpose(2, 0, 1)


def follow(
    surface: Surface, principal: Principal, at: np.ndarray, anchors: np.ndarray, x: np.ndarray,
    values: np.ndarray,
) -> None:  # fmt: skip
    """Bring u, v, rates, theta at places x, (n, 5, m), to the branch of anchors beside them."""
    nearest = np.searchsorted(0.5 * (at[1:] + at[:-1]), x)
    before = np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(at) - 2)
    if surface.double_cover:
        # that on the point's side of y = 0, and its cover; where both anchors are on one side,
        # the path has left it between them, and must be followed
        side = second_cover(values[:, 0], values[:, 1])[1]
        covers, sides = second_cover(anchors[:, 0], anchors[:, 1])
        first, last = sides[:, before], sides[:, before + 1]
        known = ~on_seam(values[:, 0], values[:, 1])
        along = on_seam(anchors[:, 0], anchors[:, 1])
        known &= ~along[:, before] & ~along[:, before + 1]
        chosen = np.where((first == last) | ~known, nearest, before + (side != first))
        reference = np.take_along_axis(anchors, chosen[:, None], axis=2)
        alike = covers[:, before] == covers[:, before + 1]
        for b, i in np.argwhere(known & (first == last) & ((side != first) | ~alike)):
            k = before[i]
            reference[b, :, i] = _followed(surface, principal, b, at[k], anchors[b, :, k], x[i])
        u, v, turned = surface.align(values[:, 0], values[:, 1], reference[:, 0], reference[:, 1])
        values[:, 0], values[:, 1] = u, v
        values[:, 2:4] *= np.where(turned, -1.0, 1.0)[:, None]
        values[:, 4] += np.pi * turned
    else:
        # beside a pole, where v and theta swing by half a turn, the anchor that is nearer in theta
        ends = np.stack([anchors[:, 2, before], anchors[:, 2, before + 1]])
        theta = np.stack([values[:, 4]] * 2)
        wind(theta, ends, TURN)
        first, last = np.abs(theta - ends)
        swings = np.abs(ends[1] - ends[0]) > 0.25 * TURN
        chosen = np.where(swings, before + (last < first), nearest)
        reference = np.take_along_axis(anchors, chosen[:, None], axis=2)
        for row, period in enumerate(surface.periods()):
            if period is not None:
                wind(values[:, row], reference[:, row], period)
    wind(values[:, 4], reference[:, 2], TURN)


def _seams(surface: Surface, principal: Principal, at: np.ndarray, raw: np.ndarray) -> np.ndarray:
    """Where the paths cross cos v = 0 between places, (n - 1, n_bodies).

    There, or where sin u = 0, the sign of y = sin u cos v changes; between places on one side
    it may do so twice.
    """
    y, side = np.sin(raw[:, 0]) * np.cos(raw[:, 1]), second_cover(raw[:, 0], raw[:, 1])[1]
    u, v = raw[:, 0].T, raw[:, 1].T
    along = on_seam(u, v)
    along = along[1:] | along[:-1]
    seams = surface.align(u[1:], v[1:], u[:-1], v[:-1])[2] & along  # there the nearest continue it
    b, i = np.nonzero((side[:, 1:] != side[:, :-1]) & ~along.T)
    seams[i, b] = _over_seam(principal, b, side[b, i], at[i], y[b, i], at[i + 1], y[b, i + 1])
    for b, i in _bends(principal, at, y, side):
        there = (
            None
            if along[i, b]
            else _comes_back(principal, b, side[b, i], at[i], y[b, i], at[i + 1], y[b, i + 1])
        )
        if there is not None:
            x = np.insert(at[i : i + 2], 1, there[0])
            ys = np.insert(y[b, i : i + 2], 1, there[1])
            sides = np.array([side[b, i], not side[b, i]])
            both = _over_seam(principal, [b, b], sides, x[:-1], ys[:-1], x[1:], ys[1:])
            seams[i, b] = both[0] != both[1]
    return seams


def _bends(principal: Principal, at: np.ndarray, y: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Bodies, and places up to the next of which they may leave their side of y = 0: (n, 2)."""
    far = np.fmin(np.abs(y[:, 1:]), np.abs(y[:, :-1])) > 0.25  # for less than half a radian
    near = (side[:, 1:] == side[:, :-1]) & ~far
    if not near.any():
        return np.argwhere(near)
    here, sign = principal(0.5 * (at[1:] + at[:-1])), np.where(side[:, 1:], -1.0, 1.0)
    a, c, b = sign * y[:, :-1], sign * y[:, 1:], sign * np.sin(here[:, 0]) * np.cos(here[:, 1])
    with np.errstate(all="ignore"):  # the least value of a parabola, and where that is
        bend, place = a - 2 * b + c, 0.5 * (a - c)
        lowest = np.where(np.abs(place) < np.abs(bend), b - 0.5 * place**2 / bend, np.inf)
    return np.argwhere(near & ((b < 0) | ((bend > 0) & (lowest <= 0.1 * np.fmax(a, c)))))


def _comes_back(
    principal: Principal, body: int, side: bool, a: float, ya: float, c: float, yc: float
) -> tuple[float, float] | None:
    """A place between a and c at which y has another sign than at both, and y; or None.

    By parabolas towards the least |y|.
    """
    sign, b, yb = (-1.0 if side else 1.0), 0.5 * (a + c), math.inf
    ya, yc, at = sign * ya, sign * yc, b
    for k in range(30):
        if not a < at < c:
            return None
        here = principal(np.array([at]))[body, :, 0]
        found = math.sin(here[0]) * math.cos(here[1])
        now = sign * found
        if now < 0.0:
            return at, found
        if k == 0:
            yb = now
        elif now < yb:
            a, ya, c, yc = (a, ya, b, yb) if at < b else (b, yb, c, yc)
            b, yb = at, now
        else:
            a, ya, c, yc = (at, now, c, yc) if at < b else (a, ya, at, now)
        if not a < b < c:
            return None
        first, second = (yb - ya) / (b - a), (yc - yb) / (c - b)
        bend = (second - first) / (c - a)
        if not bend > 0.0:
            return None
        at = 0.5 * (a + b) - 0.5 * first / bend
        if ya + (at - a) * (first + bend * (at - b)) > 0.1 * max(ya, yc):
            return None
    return None


def _over_seam(
    principal: Principal, b: Any, side: Any, x: Any, a: Any, x2: Any, c: Any
) -> np.ndarray:
    """Whether bodies b cross cos v = 0, not sin u = 0, between places x and x2, where y = a and
    y = c have different signs; side: a is negative.

    Told at the crossing, by regula falsi (Illinois), and so right beside an umbilic too.
    """
    seams, kept = np.zeros(len(x), dtype=bool), np.zeros(len(x))
    for _ in range(100 if len(x) else 0):
        with np.errstate(invalid="ignore"):
            middle = x + (x2 - x) * (a / (a - c))
        middle = np.where((x < middle) & (middle < x2), middle, 0.5 * (x + x2))
        here = principal(middle)[b, :, np.arange(len(x))]
        sin, cos = np.sin(here[:, 0]), np.cos(here[:, 1])
        seams = cos < np.abs(sin)
        there = np.fmin(np.abs(sin), cos) <= 1e-15 * np.fmax(np.abs(sin), cos)
        if (there | (middle <= x) | (middle >= x2)).all():
            break  # to rounding: a path may run along a seam and cross it elsewhere
        before = (sin < 0) == side  # an end that is kept twice counts half
        c = np.where(before, np.where(kept > 0, 0.5 * c, c), sin * cos)
        a = np.where(before, sin * cos, np.where(kept < 0, 0.5 * a, a))
        x, x2 = np.where(before, middle, x), np.where(before, x2, middle)
        kept = np.where(before, 1, -1)
    return seams


def _followed(
    surface: Surface, principal: Principal, body: int, at: float, anchor: np.ndarray, x: float
) -> np.ndarray:
    """u, v, theta of one body at a place x, continued from an anchor before it."""
    raw = principal(np.array([at, x]))
    u, v, theta = raw[body, [0, 1, 4], 1]
    if _seams(surface, principal, np.array([at, x]), raw)[0, body] != second_cover(*anchor[:2])[0]:
        u, v, theta = -u, np.pi - v, theta + np.pi
    found = np.array([u, v, theta])
    for k, period in enumerate((*surface.periods(), TURN)):
        if period is not None:
            wind(found[k : k + 1], anchor[k : k + 1], period)
    return found
