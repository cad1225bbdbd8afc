"""Closed forms in mpmath, to its working precision; inputs are doubles, SI units and radians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mpmath as mp


def arc_length(coefficients: Sequence[float], t: Any) -> Any:
    """The integral of sigma from 0 to t."""
    powers = enumerate(coefficients)
    return mp.fsum(mp.mpf(c) * mp.mpf(t) ** (k + 1) / (k + 1) for k, c in powers)


def great_circle(radius: Any, at: Any, w: Any, s: Any) -> list[Any]:
    """Point of a sphere at path s, from chart coordinates ``at`` along path velocity w."""
    (u, v), r, w = map(mp.mpf, at), mp.mpf(radius), [mp.mpf(x) for x in w]
    normal = [mp.sin(u) * mp.cos(v), mp.sin(u) * mp.sin(v), mp.cos(u)]
    x_axis = [mp.cos(u) * mp.cos(v), mp.cos(u) * mp.sin(v), -mp.sin(u)]
    y_axis = [-mp.sin(v), mp.cos(v), mp.mpf(0)]
    pace = mp.norm(w)
    phase = pace * mp.mpf(s) / r
    along = [(w[0] * a + w[1] * b) / pace for a, b in zip(x_axis, y_axis)]
    return [r * (mp.cos(phase) * n + mp.sin(phase) * e) for n, e in zip(normal, along)]


def helix(radius: Any, at: Any, w: Any, s: Any) -> list[Any]:
    """The same on the cylinder (r cos u, r sin u, v)."""
    r = mp.mpf(radius)
    u = mp.mpf(at[0]) + mp.mpf(w[0]) * mp.mpf(s) / r
    return [r * mp.cos(u), r * mp.sin(u), mp.mpf(at[1]) + mp.mpf(w[1]) * mp.mpf(s)]
