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
curvatures, and what counts here is the mean gap at the planned curve. The base meshes of `domains`
are subdivided, where asked for only within a strip about that curve.

SI units, radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contact_system.errors import SurfaceError

from .domains import Array, Domain, Triangles, no_normal

WHOLE = 10_000  # triangles; above, a strip saves time to build (a query takes as long with it)
LARGEST = 200_000  # triangles; Drake needs 60 us for each when it builds and again for a Context
FLAT = 0.9  # least cosine between a triangle's normals, in or out of the strip
MEAN_SAGITTA = 1 / 24  # of the sum of II(e, e) over a triangle's edges


@dataclass(frozen=True)
class SurfaceMesh:
    """Triangles (m, 3), counterclockwise seen from outside, with their vertices (n, 3), m, on a
    surface, and its unit normals (n, 3) there, out of the body."""

    points: Array
    normals: Array
    triangles: Triangles

    @property
    def closed(self) -> bool:
        """Whether every edge has a triangle on both sides."""
        edges, of = edges_of(self.triangles)
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
        return np.sum(edge * (tilt + opposing * edge), axis=-1) / 2


def contact_mesh(
    domain: Domain, curve: Array, opposing: float, gap: float, strip: float
) -> SurfaceMesh:
    """A mesh of a surface for contact along a curve (m, 3).

    opposing : mean curvature there of the body that touches it, 1/m
    gap : that shall open along an edge, m
    strip : distance from the curve within which it is fine, where it would have more than 10 000
        triangles otherwise, m
    """
    size = _parts(domain, curve, opposing, gap)
    levels = max(0, math.floor(math.log2(size / domain.coarsest)))
    q, triangles = _base(domain, size / 2**levels)
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
    """How fine a base mesh would have to be to open ``gap`` along its edges at the curve."""
    q, triangles = _base(domain, domain.coarsest)
    mesh = SurfaceMesh(*domain.place(q), triangles)
    at = cKDTree(mesh.points[triangles].mean(axis=1)).query(curve)[1]
    return domain.coarsest * math.sqrt(abs(mesh.gaps(opposing)[at].mean()) / gap)


def _base(domain: Domain, size: float) -> tuple[Array, Triangles]:
    q, triangles = domain.base(size)
    return q, outward(*domain.place(q), triangles)


def refined(
    domain: Domain, q: Array, triangles: Triangles, chosen: NDArray[np.bool_]
) -> tuple[Array, Triangles]:
    """Split the chosen triangles in four, and what borders on them so that no vertex hangs.

    Red-green refinement: Bank, Sherman, Weiser, Scientific Computing (1983).
    """
    edges, of = edges_of(triangles)
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


def edges_of(triangles: Triangles) -> tuple[Triangles, Triangles]:
    """Edges (n, 2) and the numbers (m, 3) of each triangle's: 01, 12, 20."""
    pairs = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    flat = pairs.reshape(-1, 2)
    code = flat[:, 0] * (flat.max() + 1) + flat[:, 1]
    _, first, number = np.unique(code, return_index=True, return_inverse=True)
    return flat[first], number.reshape(triangles.shape)


def outward(points: Array, normals: Array, triangles: Triangles) -> Triangles:
    """Triangles turned so that they run counterclockwise about the normals."""
    inward = _facing(points, normals, triangles).sum(axis=1) < 0
    return np.where(inward[:, None], triangles[:, ::-1], triangles)


def _facing(points: Array, normals: Array, triangles: Triangles) -> Array:
    """Twice the triangles' areas, projected along their vertices' normals: (m, 3), m^2."""
    a, b, c = (points[w] for w in triangles.T)
    return np.einsum("ti,tki->tk", np.cross(b - a, c - a), normals[triangles])
