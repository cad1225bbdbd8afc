"""Surfaces as grids of points for pictures and the explorer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import ContactSystemError
from ..plan import Plan
from ..surfaces import Surface

CELLS = 96  # of a surface's mesh in each coordinate
UNBOUNDED = 50  # sizes; an implicit surface with a larger mesh is taken not to be closed


@dataclass
class Mesh:
    """Points and normals, (n, 3), of a surface on a grid of this shape."""

    surface: Surface
    shape: tuple[int, int]
    points: np.ndarray
    normals: np.ndarray
    whole: bool  # whether it is the whole closed surface, not only the part around the curves

    @property
    def grid(self) -> np.ndarray:
        """Indices of the points."""
        return np.arange(len(self.points)).reshape(self.shape)

    @property
    def size(self) -> float:
        """Greatest side of its bounding box, m."""
        return np.ptp(self.points, axis=0).max()

    def triangles(self, every: int = 1) -> np.ndarray:
        """Triangles between every n-th line of the grid: (m, 3)."""
        return _triangles(self.grid[::every, ::every])

    def strips(self, every: int, width: float) -> tuple[np.ndarray, np.ndarray]:
        """Points (m, 3) and triangles (k, 3) of strips along every n-th line; width in m."""
        grids = (x.reshape(*self.shape, 3) for x in (self.points, self.normals))
        points, normals = (np.concatenate([x[::every], x.swapaxes(0, 1)[::every]]) for x in grids)
        return ribbons(points, normals, width / 2)


def ribbons(points: np.ndarray, normals: np.ndarray, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (m, 3) and triangles (k, 3) of strips along lines (..., n, 3) on a surface.

    They face along the surface's normals, in the order of the lines; ``half``: of their width, m.
    """
    side = np.cross(normals, np.gradient(points, axis=-2))
    side *= half / np.maximum(np.linalg.norm(side, axis=-1, keepdims=True), 1e-12)
    edges = np.stack([points - side, points + side], axis=-2)
    return edges.reshape(-1, 3), _triangles(np.arange(edges.size // 3).reshape(edges.shape[:-1]))


def _triangles(grid: np.ndarray) -> np.ndarray:
    """Triangles (k, 3) of grids of indices of points (..., n, m), two for each cell."""
    a, b = grid[..., :-1, :-1], grid[..., 1:, :-1]
    c, d = grid[..., 1:, 1:], grid[..., :-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def mesh_of(plan: Plan, side: int, contacts: Sequence[int], cells: int = CELLS) -> Mesh | None:
    """The finger of some contacts (side 0), or the object (1): the whole surface if it is closed,
    else the part around the curves."""
    surface = plan.scene.object if side else plan.scene.contacts[contacts[0]].finger
    closed = closed_span(surface, 0) is not None and closed_span(surface, 1) is not None
    for whole in (True, False):
        spans = [_span(plan, surface, side, contacts, k, whole) for k in (0, 1)]
        try:
            u, v = np.meshgrid(*(np.linspace(*span, cells + 1) for span in spans), indexing="ij")
            points, frames = surface.point_and_frame(u, v)
        except ContactSystemError:  # an implicit surface that some rays from its centre miss
            continue
        normals = frames[..., 2].reshape(-1, 3)
        mesh = Mesh(surface, u.shape, points.reshape(-1, 3), normals, whole and closed)
        if not whole or mesh.size <= UNBOUNDED * surface.size:
            return mesh
    return None


def closed_span(surface: Surface, k: int) -> tuple[float, float] | None:
    """Range of u or v that covers a closed surface; None if it is not closed along it."""
    period = surface.periods()[k]
    if surface.chart.double_cover:
        return ((-math.pi, math.pi), (-math.pi / 2, math.pi / 2))[k]
    if period is not None:
        return -period / 2, period / 2
    if surface.chart.singular_at:  # closed without a period: the range ends at poles
        return ((0.0, math.pi), (-math.pi / 2, math.pi / 2))[k]
    return None


def _span(
    plan: Plan, surface: Surface, side: int, contacts: Sequence[int], k: int, whole: bool
) -> tuple[float, float]:
    """Range of u or v to draw, slightly shortened, as there is no frame at poles."""
    closed = closed_span(surface, k) if whole or surface.chart.double_cover else None
    if closed is not None:
        start, stop = closed
    else:
        t = plan.regular_times(plan.sample_times())
        results = plan.evaluate(t, "states", "points")
        q = results["states"][:, contacts, 4 * side : 4 * side + 2].reshape(-1, 2)
        extent = np.ptp(results["points"][:, contacts, side].reshape(-1, 3), axis=0).max()
        if extent < 1e-9 * surface.size:  # the contacts rest, but for rounding
            extent = surface.size
        margin = 0.35 * extent / surface.lame(*q[len(q) // 2])[k]
        start, stop = q[:, k].min() - margin, q[:, k].max() + margin
    hair = 1e-6 * (stop - start)
    return start + hair, stop - hair


def edges(mesh: Mesh) -> np.ndarray:
    """Segments (n, 2, 3) of the grid's border that are edges of the surface."""

    def meet(first: np.ndarray, last: np.ndarray) -> bool:
        return np.linalg.norm(first - last, axis=1).max() < 1e-3 * mesh.size

    grid = mesh.points.reshape(*mesh.shape, 3)
    pairs = [np.empty((0, 2, 3))]
    for first, last in ((grid[0], grid[-1]), (grid[:, 0], grid[:, -1])):
        for line in () if meet(first, last) else (first, last):
            if not meet(line, line[::-1]):  # a pole, or a seam closed on itself, is no edge
                pairs.append(np.stack([line[:-1], line[1:]], 1))
    return np.concatenate(pairs)
