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

NODES = (1.0 + np.polynomial.legendre.leggauss(16)[0]) / 2.0
"""Gauss points of a leg, as parts of its length."""


def fields(curvature: Array, s: Array) -> Array:
    """The fields at the nodes and the end of legs, by collocation.

    curvature (..., 16) at the nodes, s (...), negative where a path runs backwards: returns
    (..., 17, 4), of each place J, J', M, M', m, 1, 1, 1/m.
    """
    curvature, s = np.ascontiguousarray(curvature), np.ascontiguousarray(s)
    found = np.empty((*s.shape, 17, 4))
    binding.fields(s.size, address(curvature), address(s), address(found))
    return found


def shifts(directions: Array, along: Array) -> Array:
    """How the ends of paths move with each of their legs.

    directions (m, n) rad, along (m, n, 4): J, J', M, M' along each leg; where a path ends on its
    last leg, at that place. Returns (m, 2 n, 3): for a turn of each leg, 1/rad, then for each metre
    of its length, the move along p and q of the carried frame at the end and the frame's turn.
    """
    m, n = directions.shape
    directions, along = np.ascontiguousarray(directions), np.ascontiguousarray(along)
    found = np.empty((m, 2 * n, 3))
    binding.shifts(m, n, address(directions), address(along), address(found))
    return found
