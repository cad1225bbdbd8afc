r"""Triangle meshes of surfaces for hydroelastic contact: right on average at any resolution.

A mesh whose vertices lie on a surface lies inside a convex one and outside a concave one. Over a
triangle with edges e the distance from facet to surface, along the normal, is

.. math:: \bar s = \tfrac1{24} \sum_{e} \mathrm{II}(e, e), \qquad
          \mathrm{II}(e, e) \approx (n_j - n_i) \cdot (x_j - x_i)

on average (the integral of a quadratic form over a triangle), so vertices are moved by that much:
the mean surface is the true one, and a coarse mesh gives the force that a fine one converges to.

How long edges may be depends on both bodies. Pressed together by a depth d, they touch where the
gap ``(K_1 + K_2)(x, x)/2`` at x from the deepest point is less than d. So edges e are chosen by the
gap for x = e: with equal gaps equally many triangles are in a contact patch, whatever the
curvatures. The mean gap at the planned curve counts. A coarse base mesh is subdivided, a large one
only within a strip about that curve.

Surfaces that close around a centre start from an icosahedron, others from squares of their chart. A
domain has its own coordinates of the surface. ``place`` gives their points and unit normals out of
the body, ``midpoints`` the coordinates half way between others, and ``base(size)`` those of a mesh
of so many parts a side, and its triangles. ``coarsest`` is the least, ``patches`` that of shades.

SI units, radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from contact_system.checks import Array
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

Triangles = NDArray[np.int64]

WHOLE = 10_000  # triangles; larger meshes are fine in a strip only, to be built in less time
LARGEST = 200_000  # triangles; Drake needs 60 us for each when it builds and again for a Context
FLAT = 0.9  # least cosine between the normals of a triangle, also outside the strip
MEAN_SAGITTA = 1 / 24  # of the sum of II(e, e) over a triangle's edges


# --- coordinates -------------------------------------------------------------------------------


class RoundDomain:
    """A surface that closes around a centre; its coordinates are unit vectors.

    For quadrics they are mapped linearly to x^T A x = 1, which makes II(e, e) the same in all
    directions; for other surfaces they are mapped to a sphere, and along rays to the surface.
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
        q, triangles = icosphere(max(1, round(size)))
        return q, outward(*self.place(q), triangles)


class ChartDomain:
    """A rectangle of a chart, with coordinates (u, v); periodic coordinates are taken all round.

    curve : (m, 3), points that the rectangle has to contain, m
    margin : how far it reaches beyond them, m
    opposing : mean curvature of the other body, 1/m, so that both sides of squares open one gap
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
        if isinstance(surface, Cylinder):  # symmetric, so that the mass centre is at the origin
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
        missing = ~np.all(np.isfinite(normals), axis=1)
        if np.any(missing):
            raise no_normal(self.surface, points[missing][0])
        return points, normals

    def midpoints(self, a: Array, b: Array) -> Array:
        turns = self._closed * np.round((b - a) / self._period)  # the short way round
        return a + (b - a - self._period * turns) / 2

    def base(self, size: float) -> tuple[Array, Triangles]:
        """A grid of ``size`` squares to the longer side, halved by diagonals."""
        nu, nv = (max(3, round(size * w)) for w in self._length)
        row, column = np.indices(np.array([nv, nu]) + ~self._closed[::-1])
        q = np.stack([column / nu, row / nv], axis=-1).reshape(-1, 2)
        seams = [(0, closed) for closed in self._closed[::-1]]
        grid = np.pad(np.arange(len(q)).reshape(row.shape), seams, mode="wrap")
        a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
        triangles = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
        q = self._first + q * self._sides
        return q, outward(*self.place(q), triangles)


Domain = RoundDomain | ChartDomain


def domain_of(surface: Surface, curve: Array, margin: float, opposing: float) -> Domain:
    """The domain for a surface; see `ChartDomain` for the parameters."""
    if surface.chart.central:
        return RoundDomain(surface)
    return ChartDomain(surface, curve, margin, opposing)


def _unit(x: Array) -> Array:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def _gradient(surface: ImplicitSurface, points: Array) -> Array:
    """Gradient of the equation F, as its slopes along the axes, (n, 3)."""
    n = len(points)
    rays = np.vstack([np.tile(points.T, 3), np.repeat(np.eye(3), n, axis=1)])
    return run(surface.tables.ray, rays, surface.numbers)[1].reshape(3, n).T


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
        f"{surface!r}: the normal does not exist or turns too fast for a mesh about the point "
        f"{at.round(6).tolist()}, a pole of its chart or an edge; contact needs a mesh there: "
        f"{remedy}"
    )


# --- meshes ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SurfaceMesh:
    """Triangles (m, 3), counterclockwise seen from outside, with their vertices (n, 3), m, on a
    surface, and its unit normals (n, 3) there, out of the body."""

    points: Array
    normals: Array
    triangles: Triangles

    @property
    def closed(self) -> bool:
        """Whether every edge belongs to two triangles."""
        edges, sides = edges_of(self.triangles)
        return bool(np.all(np.bincount(sides.ravel(), minlength=len(edges)) == 2))

    def corrected(self) -> Array:
        """Vertices moved along their normals so that the mean surface is the true one, (n, 3), m.

        A vertex moves by the mean sagitta of its triangles, weighted by their areas.
        """
        corner, normal = self.points[self.triangles], self.normals[self.triangles]
        edge = np.roll(corner, -1, axis=1) - corner
        form = np.einsum("tki,tki->t", np.roll(normal, -1, axis=1) - normal, edge)
        area = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1)
        at, count = self.triangles.ravel(), len(self.points)
        moment = np.bincount(at, np.repeat(area * form * MEAN_SAGITTA, 3), count)
        shift = moment / np.bincount(at, np.repeat(area, 3), count)
        return self.points + shift[:, None] * self.normals

    def gaps(self, opposing: float) -> Array:
        """The gap to a body of mean curvature ``opposing``, 1/m, along each edge: (m, 3), m."""
        edge, tilt = (
            np.roll(w[self.triangles], -1, axis=1) - w[self.triangles]
            for w in (self.points, self.normals)
        )
        return np.sum(edge * (tilt + opposing * edge), axis=-1) / 2


def contact_mesh(
    domain: Domain, curve: Array, opposing: float, gap: float, strip: float
) -> SurfaceMesh:
    """A mesh of a surface for contact along a curve (m, 3).

    opposing : mean curvature there of the body that touches it, 1/m
    gap : wanted along edges, m
    strip : distance from the curve, m, up to which the mesh is fine if it would have more than
        10 000 triangles when fine everywhere
    """
    size = _parts(domain, curve, opposing, gap)
    levels = max(0, math.floor(math.log2(size / domain.coarsest)))
    q, triangles = domain.base(size / 2**levels)
    near = cKDTree(curve)
    everywhere = len(triangles) * 4**levels <= WHOLE
    for _ in range(levels):
        chosen = np.ones(len(triangles), dtype=bool)
        if not everywhere:
            # Beyond the strip by one triangle, as refinement splits neighbours only for conformity.
            x, n = (w[triangles] for w in domain.place(q))
            longest = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
            chosen = near.query(x.mean(axis=1))[0] < strip + longest
            chosen |= np.sum(n * np.roll(n, 1, axis=1), axis=2).min(axis=1) < FLAT
        if len(triangles) + 3 * np.count_nonzero(chosen) > LARGEST:
            raise SurfaceError(
                f"{domain.surface!r}: edges that open a gap of {gap:.3g} m within {strip:.3g} m of "
                f"the planned contacts take more than {LARGEST} triangles; give a longer edge, or "
                "a softer contact, whose patch is larger"
            )
        q, triangles = refined(domain, q, triangles, chosen)
    points, normals = domain.place(q)
    folded = ~np.all(_facing(points, normals, triangles) > 0, axis=1)
    if np.any(folded):
        raise no_normal(domain.surface, points[triangles[folded][0, 0]])
    return SurfaceMesh(points, normals, triangles)


def _parts(domain: Domain, curve: Array, opposing: float, gap: float) -> float:
    """Parts a side that a base mesh needs so that ``gap`` opens along its edges at the curve."""
    q, triangles = domain.base(domain.coarsest)
    mesh = SurfaceMesh(*domain.place(q), triangles)
    at = cKDTree(mesh.points[triangles].mean(axis=1)).query(curve)[1]
    return domain.coarsest * math.sqrt(abs(mesh.gaps(opposing)[at].mean()) / gap)


def refined(
    domain: Domain, q: Array, triangles: Triangles, chosen: NDArray[np.bool_]
) -> tuple[Array, Triangles]:
    """Split the chosen triangles in four, and their neighbours so that no vertex hangs.

    Red-green refinement: Bank, Sherman, Weiser, Scientific Computing (1983).
    """
    edges, sides = edges_of(triangles)
    split = np.zeros(len(edges), dtype=bool)
    split[sides[chosen]] = True
    while np.any(twice := np.count_nonzero(split[sides], axis=1) == 2):
        split[sides[twice]] = True
    middle = np.full(len(edges), -1)
    middle[split] = len(q) + np.arange(np.count_nonzero(split))
    q = np.vstack([q, domain.midpoints(q[edges[split, 0]], q[edges[split, 1]])])
    count = np.count_nonzero(split[sides], axis=1)
    (a, b, c), (ab, bc, ca_) = triangles[count == 3].T, middle[sides[count == 3]].T
    four = [(a, ab, ca_), (ab, b, bc), (ca_, bc, c), (ab, bc, ca_)]
    # Turn triangles with one split edge so that it is their first.
    turn = np.argmax(split[sides[count == 1]], axis=1)[:, None]
    a, b, c = np.take_along_axis(triangles[count == 1], (turn + np.arange(3)) % 3, axis=1).T
    m = np.take_along_axis(middle[sides[count == 1]], turn, axis=1)[:, 0]
    parts = [np.column_stack(w) for w in [*four, (a, m, c), (m, b, c)]]
    return q, np.vstack([triangles[count == 0], *parts])


def edges_of(triangles: Triangles) -> tuple[Triangles, Triangles]:
    """Edges (n, 2), and the numbers (m, 3) of each triangle's edges, from corners 01, 12, 20."""
    pairs = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    edges, number = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    return edges, number.reshape(triangles.shape)


def outward(points: Array, normals: Array, triangles: Triangles) -> Triangles:
    """Triangles turned so that they run counterclockwise about the normals."""
    inward = _facing(points, normals, triangles).sum(axis=1) < 0
    return np.where(inward[:, None], triangles[:, ::-1], triangles)


def _facing(points: Array, normals: Array, triangles: Triangles) -> Array:
    """Twice the triangles' areas, projected along their vertices' normals: (m, 3), m^2."""
    a, b, c = (points[w] for w in triangles.T)
    return np.einsum("ti,tki->tk", np.cross(b - a, c - a), normals[triangles])
