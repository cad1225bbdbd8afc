"""How a path's end moves with its legs: Jacobi fields (theory section 11).

Along a geodesic of length s on a surface of Gaussian curvature K

    J'' = -K J, J(0) = 0, J'(0) = 1        M'' = -K M, M(0) = 1, M'(0) = 0

A turn by dphi at its start moves the end sideways by J dphi, a shift sideways by dy moves it by
M dy, and the carried frame at the end turns by (J' - 1) dphi, or M' dy.
"""

from __future__ import annotations

import numpy as np

from ..engine import binding
from ..engine.binding import address

Array = np.ndarray

NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
NODES = (1.0 + NODES) / 2.0
"""Gauss points of a leg, as parts of its length."""


def _collocation() -> tuple[Array, Array]:
    """Integrals from 0 to the nodes of the Lagrange polynomials on them, and of those to 1."""
    legendre = np.polynomial.legendre
    values = np.linalg.inv(legendre.legvander(2 * NODES - 1, 15)).T
    rises = [legendre.legint(c, lbnd=-1) for c in values]
    to_nodes = np.array([legendre.legval(2 * NODES - 1, c) for c in rises]).T / 2
    return to_nodes, _WEIGHTS / 2


_TO_NODES, _TO_END = _collocation()
_TWICE = _TO_NODES @ _TO_NODES


def fields(curvature: Array, s: Array) -> Array:
    """The fields at the nodes and the end of legs, by collocation.

    curvature (..., 16) at the nodes, s (...), negative where a path runs backwards: returns
    (..., 17, 4), of each place J, J', M, M', m, 1, 1, 1/m.
    """
    s = s[..., None]
    k = -curvature * s**2
    start = np.stack([s * NODES, np.ones_like(k)], axis=-1)  # J and M if K were 0
    rates = np.linalg.solve(np.eye(16) - k[..., None] * _TWICE, k[..., None] * start)
    found = np.empty((*k.shape[:-1], 17, 4))
    found[..., :16, ::2] = start + _TWICE @ rates
    found[..., 16, ::2] = start[..., 0, :] + _TO_END @ (_TO_NODES @ rates)
    found[..., 16, 0] += (s * (1 - NODES[0]))[..., 0]
    slope = np.concatenate([_TO_NODES @ rates, (_TO_END @ rates)[..., None, :]], axis=-2)
    found[..., 1], found[..., 3] = 1.0 + slope[..., 0] / s, slope[..., 1] / s
    return found


def shifts(directions: Array, along: Array) -> Array:
    """How the end of a path moves with each of its legs.

    directions (n,) rad, along (n, 4): J, J', M, M' along each leg; where the path ends on its last
    leg, at that place. Returns (2 n, 3): for a turn of each leg, 1/rad, then for each metre of its
    length, the move along p and q of the carried frame at the end and the turn of that frame.
    """
    n = len(directions)
    ways, fields_along = np.ascontiguousarray(directions), np.ascontiguousarray(along)
    found = np.empty((2 * n, 3))
    binding.shifts(n, address(ways), address(fields_along), address(found))
    return found
