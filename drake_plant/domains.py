"""Coordinates of a mesh's vertices on a surface, and the base meshes that subdivision starts from.

Surfaces that close around a centre start from an icosahedron, others from squares of their chart. A
domain has points and unit normals out of the body of coordinates (``place``), coordinates half way
between others (``midpoints``), and coordinates and triangles of a mesh of so many parts a side
(``base``), of which ``coarsest`` are the fewest and ``patches`` those painted in two shades. SI
units, radians.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from contact_system.engine.binding import run
from contact_system.errors import SurfaceError
from contact_system.surfaces import (
    Cylinder,
    Ellipsoid,
    ImplicitSurface,
    ParametricSurface,
    Quadric,
    Surface,
)
from contact_system.surfaces.base import RAY

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]


class RoundDomain:
    """A surface around a centre; coordinates are unit vectors.

    They are mapped linearly to the ellipsoid x^T A x = 1, which makes II(e, e) the same in all
    directions, and from the sphere along rays to other surfaces.
    """

    def __init__(self, surface: Surface):
        self.surface = surface
        self.coarsest, self.patches = 6.0, 2.0  # parts of an icosahedron's edge
        self._A = np.eye(3) / surface.size**2
        if isinstance(surface, Quadric):
            self._A = np.array(surface.A)
        elif isinstance(surface, Ellipsoid):
            self._A = np.diag(np.power([surface.a, surface.b, surface.c], -2.0))
        values, vectors = np.linalg.eigh(self._A)
        self._root = vectors / np.sqrt(values) @ vectors.T

    def place(self, q: Array) -> tuple[Array, Array]:
        points, surface = q @ self._root, self.surface
        if isinstance(surface, ImplicitSurface):
            points = surface.point(*surface.coordinates(points + surface.center))
            return points, surface.sign * _unit(_gradient(surface, points))
        return points, surface.sign * _unit(points @ self._A)

    def midpoints(self, a: Array, b: Array) -> Array:
        return _unit(a + b)

    def base(self, size: float) -> tuple[Array, Triangles]:
        return icosphere(max(1, round(size)))


class ChartDomain:
    """A rectangle of a chart; coordinates (u, v), closed where the chart is periodic.

    curve : (m, 3), points that the rectangle has to contain, m
    margin : how far it reaches beyond them, m
    opposing : mean curvature of the other body, 1/m; the sides of squares open the same gap
    """

    def __init__(self, surface: Surface, curve: Array, margin: float, opposing: float):
        self.surface, periods = surface, surface.periods()
        u, v = (
            w if period is None else np.unwrap(w, period=period)
            for w, period in zip(surface.coordinates(curve), periods)
        )
        metric = surface.metric_root(u, v)
        form = surface.curvature_form(u, v) + opposing * np.eye(2)
        gap = np.abs(np.nanmean(metric.swapaxes(-1, -2) @ form @ metric, axis=0))
        lame = np.nanmean(surface.lame(u, v), axis=0)
        spans = []
        for w, h, period in zip((u, v), lame, periods):
            lo, hi = np.nanmin(w) - margin / h, np.nanmax(w) + margin / h
            spans.append((lo, hi) if period is None else (0.0, period))
        if isinstance(surface, Cylinder):  # so that its mass centre is the body's origin
            spans[1] = (-max(map(abs, spans[1])), max(map(abs, spans[1])))
        self._first, last = np.transpose(spans)
        self._sides = last - self._first
        length = self._sides * np.sqrt(np.diag(gap))  # root of the gap along each side, sqrt(m)
        self._length = length / max(length)
        self.coarsest = self.patches = 6.0 / min(self._length)  # six to the shorter side
        self._closed = np.array([period is not None for period in periods])
        self._period = np.array([period or 1.0 for period in periods])

    def place(self, q: Array) -> tuple[Array, Array]:
        points, normals = self.surface.point(*q.T), self.surface.normal(*q.T)
        lost = ~np.all(np.isfinite(normals), axis=1)
        if np.any(lost):
            raise no_normal(self.surface, points[lost][0])
        return points, normals

    def midpoints(self, a: Array, b: Array) -> Array:
        turns = self._closed * np.round((b - a) / self._period)  # the short way round
        return a + (b - a - self._period * turns) / 2

    def base(self, size: float) -> tuple[Array, Triangles]:
        """A grid of ``size`` squares to the longer side, halved by diagonals."""
        nu, nv = (max(3, round(size * w)) for w in self._length)
        shape = nv + (not self._closed[1]), nu + (not self._closed[0])
        row, column = np.indices(shape)
        q = np.stack([column / nu, row / nv], axis=-1).reshape(-1, 2)
        i, j = (w.ravel() for w in np.meshgrid(np.arange(nu), np.arange(nv)))
        a, b, c, d = (
            (j + y) % shape[0] * shape[1] + (i + x) % shape[1]
            for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))
        )
        triangles = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
        return self._first + q * self._sides, triangles


Domain = RoundDomain | ChartDomain


def domain_of(surface: Surface, curve: Array, margin: float, opposing: float) -> Domain:
    """The coordinates that suit a surface; see `ChartDomain` for the parameters."""
    if surface.chart.central:
        return RoundDomain(surface)
    return ChartDomain(surface, curve, margin, opposing)


def _unit(x: Array) -> Array:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def _gradient(surface: ImplicitSurface, points: Array) -> Array:
    """Gradient of the level function as it is written: its slopes along the axes, (n, 3)."""
    n = len(points)
    given = np.vstack([np.tile(points.T, 3), np.repeat(np.eye(3), n, axis=1)])
    return run(surface.tables.other[RAY], given, surface.numbers)[1].reshape(3, n).T


def icosphere(parts: int) -> tuple[Array, Triangles]:
    """Points (10 parts^2 + 2, 3) on the unit sphere and triangles (20 parts^2, 3)."""
    golden = (1 + math.sqrt(5)) / 2
    signs = np.array([(-1, 1), (1, 1), (-1, -1), (1, -1)])
    corner = np.zeros((12, 3))
    for k in range(3):  # cyclic permutations of (+-1, +-golden, 0)
        corner[4 * k : 4 * k + 4, [k, (k + 1) % 3]] = signs * (1, golden)
    faces, grid = ConvexHull(corner).simplices, range(parts + 1)
    share = np.array([(i, j, parts - i - j) for i in grid for j in grid if i + j <= parts]) / parts
    points = _unit(np.einsum("pk,fki->fpi", share, corner[faces]).reshape(-1, 3))
    points = _unit(np.unique(points.round(9), axis=0))  # faces share their rims
    return points, ConvexHull(points).simplices.astype(np.int64)


def no_normal(surface: Surface, at: Array) -> SurfaceError:
    remedy = "plan contacts away from it, or write the surface as an ImplicitSurface"
    if isinstance(surface, ParametricSurface):
        remedy += "; if (u, v) in u_range and v_range cover places twice, give ranges that do not"
    return SurfaceError(
        f"{surface!r}: the normal is lost or turns too fast for a mesh about the point "
        f"{at.round(6).tolist()}, a pole of its chart or an edge; contact needs a mesh there: "
        f"{remedy}"
    )
