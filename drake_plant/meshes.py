r"""Triangle meshes of surfaces for hydroelastic contact: right on average at any resolution.

A mesh whose vertices lie ON a surface lies inside a convex one and outside a concave one. Over a
triangle with edges e the surface stands off its facet, along the normal, by

.. math:: \bar s = \tfrac1{24} \sum_{e} \mathrm{II}(e, e), \qquad
          \mathrm{II}(e, e) \approx (n_j - n_i) \cdot (x_j - x_i)

on average (the integral of a quadratic form over a triangle), so vertices are moved by that much:
the mean surface is the true one, and a coarse mesh gives the force that a fine one converges to.

How long edges may be depends on both bodies. Two bodies pressed together by a depth d meet where
the gap ``(K_1 + K_2)(e, e)/2`` between them is less than d, so an edge is measured by the gap that
opens along it: meshes with equal gaps put equally many triangles into a contact patch, whatever the
curvatures, and that is the length by which vertices are evened out here. Surfaces that close around
a centre start from an icosahedron, others from rows of triangles in their chart; both are
subdivided, where asked for only within a strip about the planned curve.

SI units, radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh
from scipy.spatial import cKDTree

from contact_system.engine.binding import run
from contact_system.errors import SurfaceError
from contact_system.surfaces import (
    CentralChart,
    Cylinder,
    Ellipsoid,
    ImplicitSurface,
    JacobiChart,
    OblateChart,
    ParametricSurface,
    PolarChart,
    ProlateChart,
    Quadric,
    Surface,
    Torus,
)
from contact_system.surfaces.base import RAY

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]

WHOLE = 10_000  # triangles; above, a strip saves time to build (a query takes as long with it)
LARGEST = 200_000  # triangles; Drake needs 60 us for each when it builds and again for a Context
FLAT = 0.9  # least cosine between a triangle's normals, in or out of the strip
ROUNDS = 40  # in which the vertices of a base mesh are moved
MEAN_SAGITTA = 1 / 24  # of the sum of II(e, e) over a triangle's edges


@dataclass(frozen=True)
class SurfaceMesh:
    """Triangles with their vertices on a surface.

    Attributes
    ----------
    points : (n, 3)
        Vertices on the surface, m.
    normals : (n, 3)
        Unit normals of the surface there, out of the body.
    triangles : (m, 3)
        Vertex indices, counterclockwise seen from outside.
    """

    points: Array
    normals: Array
    triangles: Triangles

    @property
    def closed(self) -> bool:
        """Whether every edge has a triangle on both sides."""
        edges, of = _edges(self.triangles)
        return bool(np.all(np.bincount(of.ravel(), minlength=len(edges)) == 2))

    def corrected(self) -> Array:
        """Vertices moved along their normals so that the mean surface is the true one, (n, 3), m.

        A vertex takes the mean sagitta of its faces, weighted by their areas.
        """
        corner, normal = self.points[self.triangles], self.normals[self.triangles]
        edge = np.roll(corner, -1, axis=1) - corner
        bend = np.einsum("tki,tki->t", np.roll(normal, -1, axis=1) - normal, edge)
        area = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1)
        at, count = self.triangles.ravel(), len(self.points)
        moment = np.bincount(at, np.repeat(area * bend * MEAN_SAGITTA, 3), count)
        shift = moment / np.bincount(at, np.repeat(area, 3), count)
        return self.points + shift[:, None] * self.normals

    def gaps(self, opposing: float) -> Array:
        """How far a body of mean curvature ``opposing``, 1/m, recedes along edges: (m, 3), m."""
        edge, tilt = (
            np.roll(w[self.triangles], -1, axis=1) - w[self.triangles]
            for w in (self.points, self.normals)
        )
        return _gap(edge, tilt, opposing)


def _gap(edge: Array, tilt: Array, opposing: float) -> Array:
    return (np.sum(edge * tilt, axis=-1) + opposing * np.sum(edge * edge, axis=-1)) / 2


# --- where vertices live -----------------------------------------------------------------------


class Domain(Protocol):
    """Coordinates of vertices, in which midpoints stay on the surface.

    ``coarsest`` is the size of the base mesh that subdivision may start from.
    """

    surface: Surface
    coarsest: float

    def place(self, q: Array) -> tuple[Array, Array]:
        """Points on the surface and unit normals out of the body, each (n, 3)."""
        ...

    def midpoints(self, a: Array, b: Array) -> Array:
        """Coordinates half way between coordinates."""
        ...

    def moved(self, q: Array, points: Array, step: Array) -> Array:
        """Coordinates of their points after a displacement (n, 3) along the surface, m."""
        ...

    def base(self, size: float) -> tuple[Array, Triangles]:
        """Coordinates and triangles of a mesh of ``size`` parts a side."""
        ...

    def patches(self) -> tuple[Array, Triangles, NDArray[np.bool_]]:
        """Coordinates and triangles for a picture, and which of them to paint differently."""
        ...


class RoundDomain:
    """A surface around a centre; coordinates are unit vectors, mapped by ``shape`` and a ray.

    Mapping an ellipsoid's from the unit sphere linearly makes II(e, e) the same in all directions.
    """

    def __init__(self, surface: Surface):
        self.surface = surface
        self.coarsest = 6.0  # parts of an icosahedron's edge
        self.centre, self.shape = np.zeros(3), np.eye(3)
        if isinstance(surface, ImplicitSurface):
            self.centre = np.array(surface.center)
        elif isinstance(surface, Quadric):
            values, vectors = np.linalg.eigh(np.array(surface.A))
            self.shape = vectors / np.sqrt(values) @ vectors.T
        elif isinstance(surface, Ellipsoid):
            self.shape = np.diag([surface.a, surface.b, surface.c])
        else:
            self.shape *= surface.size
        self._back = np.linalg.inv(self.shape)

    def place(self, q: Array) -> tuple[Array, Array]:
        points, surface = self.centre + q @ self.shape, self.surface
        if isinstance(surface, ImplicitSurface):
            points = surface.point(*surface.coordinates(points))
            gradient = _gradient(surface, points)
        else:  # that of |points @ back|^2
            gradient = points @ self._back @ self._back.T
        return points, surface.sign * _unit(gradient)

    def midpoints(self, a: Array, b: Array) -> Array:
        return _unit(a + b)

    def moved(self, q: Array, points: Array, step: Array) -> Array:
        return _unit((points + step - self.centre) @ self._back)

    def base(self, size: float) -> tuple[Array, Triangles]:
        return icosphere(max(1, round(size)))

    def patches(self) -> tuple[Array, Triangles, NDArray[np.bool_]]:
        """Octants, divided by the coordinate planes."""
        share, local = _subdivided(14)
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        q = _unit((signs[:, None] * share).reshape(-1, 3))
        triangles = (len(share) * np.arange(8)[:, None, None] + local).reshape(-1, 3)
        return q, triangles, np.repeat(signs.prod(axis=1) < 0, len(local))


class ChartDomain:
    """A rectangle of a chart; coordinates (u, v), closed where the chart is periodic.

    Parameters
    ----------
    surface : Surface
    curve : (m, 3)
        Points that the rectangle has to contain, m.
    margin : float
        How far it reaches beyond them, m.
    opposing : float
        Mean curvature of the other body, 1/m; triangles are made equilateral in the gap.
    """

    def __init__(self, surface: Surface, curve: Array, margin: float, opposing: float):
        self.surface, self.periods = surface, surface.periods()
        u, v, _ = surface.unwind(*surface.coordinates(curve))
        metric = surface.metric_root(u, v)
        form = surface.curvature_form(u, v) + opposing * np.eye(2)
        gap = np.abs(np.nanmean(metric.swapaxes(-1, -2) @ form @ metric, axis=0))
        self._scale = np.sqrt([gap[0, 0], gap[1, 1]])
        lame = np.nanmean(surface.lame(u, v), axis=0)
        spans = []
        for w, h, period in zip((u, v), lame, self.periods):
            lo, hi = np.nanmin(w) - margin / h, np.nanmax(w) + margin / h
            spans.append((lo, hi) if period is None else (0.0, period))
        if isinstance(surface, Cylinder):  # so that its mass centre is the body's origin
            spans[1] = (-max(map(abs, spans[1])), max(map(abs, spans[1])))
        self._spans = np.array(spans)
        length = self._length()
        self.coarsest = 6.0 * max(length) / min(length)  # at least six to the shorter side

    def _length(self) -> Array:
        """Square root of the gap that opens along each side, sqrt(m)."""
        return (self._spans[:, 1] - self._spans[:, 0]) * self._scale

    def place(self, q: Array) -> tuple[Array, Array]:
        points, normals = self.surface.point(*q.T), self.surface.normal(*q.T)
        lost = ~np.all(np.isfinite(normals), axis=1)
        if np.any(lost):
            raise _no_normal(self.surface, points[lost][0])
        return points, normals

    def midpoints(self, a: Array, b: Array) -> Array:
        return a + self._short(b - a) / 2

    def _short(self, step: Array) -> Array:
        """Differences of coordinates, the short way round."""
        step = step.copy()
        for k, period in enumerate(self.periods):
            if period is not None:
                step[:, k] -= period * np.round(step[:, k] / period)
        return step

    def moved(self, q: Array, points: Array, step: Array) -> Array:
        axes = self.surface.frame(*q.T)[..., :2]
        along = np.einsum("nik,ni->nk", axes, step)
        return q + np.linalg.solve(self.surface.metric_root(*q.T), along[..., None])[..., 0]

    def base(self, size: float) -> tuple[Array, Triangles]:
        """Rows of triangles, ``size`` to the longer side; every other row is shifted by half."""
        length = self._length()
        step = max(length) / size
        nu, nv = (max(3, round(w)) for w in length / step / (1, math.sqrt(3) / 2))
        nv += nv % 2 if self.periods[1] is not None else 0
        around, along = (period is not None for period in self.periods)
        row, column = np.mgrid[0 : nv + (not along), 0 : nu + (not around)]
        q = np.stack([(column + (row % 2) / 2) / nu, row / nv], axis=-1).reshape(-1, 2)
        width, height = row.shape[1], row.shape[0]
        i, j = (w.ravel() for w in np.meshgrid(np.arange(nu), np.arange(nv)))

        def at(column: Array, row: Array) -> Triangles:
            return (row % height) * width + column % width

        # two triangles a square; rows are halved by one diagonal and by the other in turn
        a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
        halves = [np.stack(corners, axis=1) for corners in ((a, b, d, b, c, d), (a, b, c, a, c, d))]
        triangles = np.where((j % 2)[:, None], halves[1], halves[0]).reshape(-1, 3)
        return self._spans[:, 0] + q * (self._spans[:, 1] - self._spans[:, 0]), triangles

    def patches(self) -> tuple[Array, Triangles, NDArray[np.bool_]]:
        """A chequered rectangle."""
        length, fine = self._length(), 6
        squares = np.maximum(1, np.round(8 * length / max(length))).astype(int)
        squares += [n % 2 if w is not None else 0 for n, w in zip(squares, self.periods)]
        nu, nv = squares * fine
        j, i = (w.ravel() for w in np.mgrid[0:nv, 0:nu])
        corner = j * (nu + 1) + i
        across = corner + nu + 2
        triangles = np.stack([corner, corner + 1, across, corner, across, across - 1], axis=1)
        row, column = np.mgrid[0 : nv + 1, 0 : nu + 1]
        q = np.stack([column / nu, row / nv], axis=-1).reshape(-1, 2)
        q = self._spans[:, 0] + q * (self._spans[:, 1] - self._spans[:, 0])
        return q, triangles.reshape(-1, 3), np.repeat((i // fine + j // fine) % 2 == 1, 2)


def domain_of(surface: Surface, curve: Array, margin: float, opposing: float) -> Domain:
    """The coordinates that suit a surface; see `ChartDomain` for the parameters."""
    if is_round(surface):
        return RoundDomain(surface)
    return ChartDomain(surface, curve, margin, opposing)


def is_round(surface: Surface) -> bool:
    """Whether every ray from a centre meets the surface once, so that it closes around it."""
    return surface.chart in (PolarChart, JacobiChart, OblateChart, ProlateChart, CentralChart)


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
    near = np.linalg.norm(corner[:, None] - corner, axis=2) < 2.1
    triples = [(i, j, k) for i in range(12) for j in range(i) for k in range(j)]
    faces = np.array([(i, j, k) for i, j, k in triples if near[i, j] and near[j, k] and near[k, i]])
    share, local = _subdivided(parts)
    points = _unit(np.einsum("pk,fki->fpi", share, corner[faces]).reshape(-1, 3))
    triangles = (len(share) * np.arange(20)[:, None, None] + local).reshape(-1, 3)
    _, first, merged = np.unique(
        np.round(points, 9), axis=0, return_index=True, return_inverse=True
    )
    return points[first], merged.ravel()[triangles]


def _subdivided(parts: int) -> tuple[Array, Triangles]:
    """A triangle in parts^2: barycentric coordinates (n, 3) and triangles (parts^2, 3)."""
    steps = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    at = {w: n for n, w in enumerate(steps)}
    upright = [(at[i, j], at[i + 1, j], at[i, j + 1]) for i, j in steps if i + j < parts]
    inner = [(i, j) for i, j in steps if i + j < parts - 1]
    between = [(at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]) for i, j in inner]
    share = np.array([(parts - i - j, i, j) for i, j in steps]) / parts
    return share, np.array(upright + between)


# --- meshes ------------------------------------------------------------------------------------


def contact_mesh(
    domain: Domain, curve: Array, opposing: float, gap: float, strip: float
) -> SurfaceMesh:
    """A mesh of a surface for contact along a curve.

    Parameters
    ----------
    domain : RoundDomain or ChartDomain
        See `domain_of`.
    curve : (m, 3)
        Where contact is planned, m.
    opposing : float
        Mean curvature there of the body that touches it, 1/m.
    gap : float
        The gap that shall open along an edge, m.
    strip : float
        Where more than 10 000 triangles would be needed, they are fine only within this distance
        of the curve, m.

    Raises
    ------
    SurfaceError
        It takes more than 200 000 triangles, or the chart is singular where it is needed.
    """
    size = _parts(domain, curve, opposing, gap)
    levels = max(0, math.floor(math.log2(size / domain.coarsest)))
    q, triangles = _evened(domain, size / 2**levels, opposing)
    near = cKDTree(curve)
    everywhere = len(triangles) * 4**levels <= WHOLE
    for _ in range(levels):
        chosen = np.ones(len(triangles), dtype=bool)
        if not everywhere:
            # Wider than the strip by what borders on it, which is split for conformity only.
            x, n = (w[triangles] for w in domain.place(q))
            reach = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
            chosen = near.query(x.mean(axis=1))[0] < strip + reach
            chosen |= np.sum(n * np.roll(n, 1, axis=1), axis=2).min(axis=1) < FLAT
        if len(triangles) + 3 * np.count_nonzero(chosen) > LARGEST:
            raise _too_many(domain.surface, gap, strip)
        q, triangles = refined(domain, q, triangles, chosen)
    points, normals = domain.place(q)
    folded = ~np.all(_facing(points, normals, triangles) > 0, axis=1)
    if np.any(folded):
        raise _no_normal(domain.surface, points[triangles[folded][0, 0]])
    return SurfaceMesh(points, normals, triangles)


def _parts(domain: Domain, curve: Array, opposing: float, gap: float) -> float:
    """How fine a base mesh would have to be to open ``gap`` along its edges at the curve."""
    q, triangles = _evened(domain, domain.coarsest, opposing)
    mesh = SurfaceMesh(*domain.place(q), triangles)
    at = cKDTree(mesh.points[triangles].mean(axis=1)).query(curve)[1]
    return domain.coarsest * math.sqrt(abs(mesh.gaps(opposing)[at].mean()) / gap)


def _evened(domain: Domain, size: float, opposing: float) -> tuple[Array, Triangles]:
    """The base mesh, its vertices moved until the gaps along all edges are about equal.

    Every edge is a spring; the rim stays where it is. Sizes on the ellipsoid 0.3/0.2/0.1 lie within
    12 % then, with 1.3 between the longest and the shortest edge of a triangle on average;
    subdividing keeps that.
    """
    q, triangles = domain.base(size)
    triangles = _outward(*domain.place(q), triangles)
    edges, of = _edges(triangles)
    i, j = edges.T
    fixed = np.zeros(len(q), dtype=bool)
    fixed[edges[np.bincount(of.ravel()) < 2]] = True
    start, area = q, _facing(*domain.place(q), triangles).sum()
    for _ in range(ROUNDS):
        points, normals = domain.place(q)
        edge = points[j] - points[i]
        # On a saddle no gap may open along an edge, or a negative one: no contact gets there.
        length = np.sqrt(np.maximum(_gap(edge, normals[j] - normals[i], opposing), 0))
        mean = length.mean()
        pull = (1 - mean / np.maximum(length, mean / 3))[:, None] * edge
        step = np.stack(
            [np.bincount(i, w, len(q)) - np.bincount(j, w, len(q)) for w in pull.T], axis=1
        )
        step[fixed] = 0
        shortest = np.full(len(q), np.inf)
        np.minimum.at(shortest, edges, np.linalg.norm(edge, axis=1)[:, None])
        reach = np.linalg.norm(step, axis=1)
        pace = np.minimum(0.2, 0.2 * shortest / np.maximum(reach, 1e-300))
        q = domain.moved(q, points, pace[:, None] * step)
    facing = _facing(*domain.place(q), triangles)
    # On needles springs may buckle, and cover the surface in folds or more than once.
    sound = np.all(facing > 0) and facing.sum() < 1.1 * area
    return (q if sound else start), triangles


def refined(
    domain: Domain, q: Array, triangles: Triangles, chosen: NDArray[np.bool_]
) -> tuple[Array, Triangles]:
    """Split the chosen triangles in four, and what borders on them so that no vertex hangs.

    Red-green refinement: Bank, Sherman, Weiser, Scientific Computing (1983).
    """
    edges, of = _edges(triangles)
    split = np.zeros(len(edges), dtype=bool)
    split[of[chosen]] = True
    while np.any(twice := np.count_nonzero(split[of], axis=1) == 2):
        split[of[twice]] = True
    middle = np.full(len(edges), -1)
    middle[split] = len(q) + np.arange(np.count_nonzero(split))
    q = np.vstack([q, domain.midpoints(q[edges[split, 0]], q[edges[split, 1]])])
    count = np.count_nonzero(split[of], axis=1)
    (a, b, c), (ab, bc, ca_) = triangles[count == 3].T, middle[of[count == 3]].T
    four = [(a, ab, ca_), (ab, b, bc), (ca_, bc, c), (ab, bc, ca_)]
    # Turn triangles with one split edge so that it is their first.
    turn = np.argmax(split[of[count == 1]], axis=1)[:, None]
    a, b, c = np.take_along_axis(triangles[count == 1], (turn + np.arange(3)) % 3, axis=1).T
    m = np.take_along_axis(middle[of[count == 1]], turn, axis=1)[:, 0]
    parts = [np.column_stack(w) for w in [*four, (a, m, c), (m, b, c)]]
    return q, np.vstack([triangles[count == 0], *parts])


def _edges(triangles: Triangles) -> tuple[Triangles, Triangles]:
    """Edges (n, 2) and the numbers (m, 3) of each triangle's: 01, 12, 20."""
    pairs = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    flat = pairs.reshape(-1, 2)
    code = flat[:, 0] * (flat.max() + 1) + flat[:, 1]
    _, first, number = np.unique(code, return_index=True, return_inverse=True)
    return flat[first], number.reshape(triangles.shape)


def _outward(points: Array, normals: Array, triangles: Triangles) -> Triangles:
    """Triangles turned so that they run counterclockwise about the normals."""
    inward = _facing(points, normals, triangles).sum(axis=1) < 0
    return np.where(inward[:, None], triangles[:, ::-1], triangles)


def _facing(points: Array, normals: Array, triangles: Triangles) -> Array:
    """Twice the triangles' areas, projected along their vertices' normals: (m, 3), m^2."""
    a, b, c = (points[w] for w in triangles.T)
    return np.einsum("ti,tki->tk", np.cross(b - a, c - a), normals[triangles])


def _no_normal(surface: Surface, at: Array) -> SurfaceError:
    remedy = "plan contacts away from it, or write the surface as an ImplicitSurface"
    if isinstance(surface, ParametricSurface):
        remedy += "; if (u, v) in u_range and v_range cover places twice, give ranges that do not"
    return SurfaceError(
        f"{surface!r}: the normal is lost or turns too fast for a mesh about the point "
        f"{at.round(6).tolist()}, a pole of its chart or an edge; contact needs a mesh there: "
        f"{remedy}"
    )


def _too_many(surface: Surface, gap: float, strip: float) -> SurfaceError:
    return SurfaceError(
        f"{surface!r}: edges that open a gap of {gap:.3g} m within {strip:.3g} m of the planned "
        f"contacts take more than {LARGEST} triangles; give a longer edge, "
        "or a softer contact, whose patch is larger"
    )


# --- for Drake ---------------------------------------------------------------------------------


def rigid_mesh(mesh: SurfaceMesh, name: str) -> Mesh:
    """The corrected triangles as a Drake Mesh in memory, for rigid hydroelastic contact."""
    lines = _rows("v %.9g %.9g %.9g", mesh.corrected())
    lines += _rows("f %d %d %d", mesh.triangles + 1)
    return _in_memory(lines, ".obj", name)


def inner_points(surface: Surface) -> Array:
    """Where depth below a fingertip's surface is measured to: its centre, or a ring, (k, 3), m."""
    if isinstance(surface, Torus):
        around = np.linspace(0, 2 * math.pi, 64, endpoint=False)
        circle = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
        return surface.major * circle
    return np.array([surface.center if isinstance(surface, ImplicitSurface) else (0.0, 0.0, 0.0)])


def compliant_mesh(mesh: SurfaceMesh, inner: Array, name: str) -> Mesh:
    """The solid under the corrected triangles as a Drake Mesh, for compliant hydroelastic contact.

    Every triangle is the base of one tetrahedron, whose apex is the nearest inner point. Drake
    makes pressure linear from 0 on the surface to the modulus at the inner points: it is then
    proportional to the depth below the triangle.

    Parameters
    ----------
    mesh : SurfaceMesh
        Closed, or a cylinder's side about the z axis, which is closed by flat ends.
    inner : (k, 3)
        One point, or points around a ring in order, m.
    name : str

    Raises
    ------
    SurfaceError
        A triangle faces away from its inner point.
    """
    points, triangles = _with_ends(mesh)
    cells = _tetrahedra(points, triangles, inner, name)
    points = np.vstack([points, inner])
    lines = ["# vtk DataFile Version 3.0", "fingertip", "ASCII", "DATASET UNSTRUCTURED_GRID"]
    lines += [f"POINTS {len(points)} double"]
    lines += _rows("%.9g %.9g %.9g", points)
    lines += [f"CELLS {len(cells)} {5 * len(cells)}"]
    lines += _rows("4 %d %d %d %d", cells)
    lines += [f"CELL_TYPES {len(cells)}", *["10"] * len(cells)]
    return _in_memory(lines, ".vtk", name)


def _with_ends(mesh: SurfaceMesh) -> tuple[Array, Triangles]:
    """Corrected points and triangles, with a fan over each end of a cylinder's side."""
    points, triangles = mesh.corrected(), mesh.triangles
    pairs = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges, of = _edges(triangles)
    rim = pairs[np.bincount(of.ravel())[of.ravel()] == 1]
    for side in (-1, 1):
        end = rim[np.sign(points[rim[:, 0], 2]) == side]
        if len(end):
            middle = np.full(len(end), len(points))
            points = np.vstack([points, [0, 0, points[end[0, 0], 2]]])
            triangles = np.vstack([triangles, np.column_stack([end[:, ::-1], middle])])
    return points, triangles


def _tetrahedra(points: Array, triangles: Triangles, inner: Array, name: str) -> Triangles:
    """A tetrahedron under each triangle, and what fills the wedges between different apexes."""
    count, apex = len(inner), _apexes(points, triangles, inner)
    cells = [np.column_stack([triangles, len(points) + apex])]
    if count > 1:
        edges, of = _edges(triangles)
        order = np.argsort(of.ravel(), kind="stable")
        first, second = np.repeat(apex, 3)[order].reshape(-1, 2).T
        ahead = (second - first + count // 2) % count - count // 2  # steps around the ring
        for k in range(np.abs(ahead).max()):
            wedge = np.abs(ahead) > k
            a = first[wedge] + k * np.sign(ahead[wedge])
            b = a + np.sign(ahead[wedge])
            ring = len(points) + np.column_stack([a, b]) % count
            cells.append(np.column_stack([edges[wedge], ring]))
    cell = np.vstack(cells)
    corner = np.vstack([points, inner])[cell]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1])
    if np.any(volume[: len(triangles)] >= 0):
        raise SurfaceError(
            f"{name}: a triangle of its mesh faces away from the inner point below it, so that no "
            "solid can be built; put the surface's centre where it sees the whole surface"
        )
    return np.where((volume < 0)[:, None], cell[:, [0, 2, 1, 3]], cell)


def _apexes(points: Array, triangles: Triangles, inner: Array) -> Triangles:
    """The inner point below each triangle: nearest to the edge that runs along the ring most.

    Both triangles of such an edge get the same. Were they different, the wedge between them would
    be flat: the edge is parallel to the ring.
    """
    corner, near = points[triangles], cKDTree(inner)
    edge = np.roll(corner, -1, axis=1) - corner
    below = near.query(corner.mean(axis=1))[1]
    along = np.roll(inner, -1, axis=0)[below] - np.roll(inner, 1, axis=0)[below]
    longest = np.argmax(np.abs(np.einsum("tki,ti->tk", edge, along)), axis=1)
    middle = corner + edge / 2
    return near.query(middle[np.arange(len(triangles)), longest])[1]


def painted_meshes(domain: Domain, name: str) -> tuple[Mesh, Mesh]:
    """The true surface in two sets of patches, to be painted differently: rolling shows."""
    q, triangles, odd = domain.patches()
    points, normals = domain.place(q)
    lines = _rows("v %.5g %.5g %.5g", points)
    lines += _rows("vn %.3f %.3f %.3f", normals)
    facing = np.repeat(_outward(points, normals, triangles) + 1, 2, axis=1)
    light, dark = (
        _in_memory(lines + _rows("f %d//%d %d//%d %d//%d", facing[part]), ".obj", name)
        for part in (~odd, odd)
    )
    return light, dark


def _rows(form: str, table: Array | Triangles) -> list[str]:
    return [form % tuple(row) for row in table.tolist()]


def _in_memory(lines: list[str], extension: str, name: str) -> Mesh:
    content = "\n".join(lines) + "\n"
    hint = " ".join(name.split())  # Drake stops the process where it has two lines
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(content, extension, hint)))
