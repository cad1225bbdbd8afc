"""Surfaces of bodies as grids of points, as pictures and the explorer draw them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import ContactSystemError
from ..measures import regular_times
from ..plan import Plan
from ..surfaces import Surface

CELLS = 96  # of a surface's mesh in each coordinate
UNBOUNDED = 50  # times its size: an implicit surface that large does not close


@dataclass
class Mesh:
    """A surface on a grid of this shape: points and normals, (n, 3)."""

    shape: tuple[int, int]
    points: np.ndarray
    normals: np.ndarray
    inside: bool
    whole: bool  # the surface, which closes on itself; else a part that depends on the curves

    @property
    def grid(self) -> np.ndarray:
        """Numbers of the points."""
        return np.arange(len(self.points)).reshape(self.shape)

    @property
    def size(self) -> float:
        """Of its bounding box, m."""
        return np.ptp(self.points, axis=0).max()

    def triangles(self, every: int = 1) -> np.ndarray:
        """Between some lines of the grid: (m, 3)."""
        return _triangles(self.grid[::every, ::every])

    def strips(self, every: int, width: float) -> tuple[np.ndarray, np.ndarray]:
        """Some lines of the grid as strips of this width, m: points (m, 3), triangles (k, 3)."""
        grid = self.points.reshape(*self.shape, 3)
        both = grid[::-1], grid.swapaxes(0, 1)  # one reversed, so that strips face outwards
        across = np.concatenate([np.gradient(x, axis=0)[::every] for x in both])
        across *= width / 2 / np.linalg.norm(across, axis=-1, keepdims=True)
        lines = np.concatenate([x[::every] for x in both])
        points = np.stack([lines - across, lines + across], axis=2)
        numbers = np.arange(points.size // 3).reshape(points.shape[:3])
        return points.reshape(-1, 3), _triangles(numbers)


def _triangles(grid: np.ndarray) -> np.ndarray:
    """Between the lines of grids of points' numbers (..., n, m): (k, 3)."""
    a, b = grid[..., :-1, :-1], grid[..., 1:, :-1]
    c, d = grid[..., 1:, 1:], grid[..., :-1, 1:]
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)


def mesh_of(
    plan: Plan, surface: Surface, side: int, contacts: Sequence[int], cells: int = CELLS
) -> Mesh | None:
    """The whole surface if it closes on itself, else what lies around the curves."""
    closed = closed_span(surface, 0) is not None and closed_span(surface, 1) is not None
    for whole in (True, False):
        spans = [_span(plan, surface, side, contacts, k, whole) for k in (0, 1)]
        try:
            u, v = np.meshgrid(*(np.linspace(*span, cells + 1) for span in spans), indexing="ij")
            points, frames = surface.point_and_frame(u, v)
        except ContactSystemError:  # an implicit surface that the rays of its chart do not all meet
            continue
        normals = frames[..., 2].reshape(-1, 3)
        mesh = Mesh(u.shape, points.reshape(-1, 3), normals, surface.inside, whole and closed)
        if not whole or mesh.size <= UNBOUNDED * surface.size:
            return mesh
    return None


def closed_span(surface: Surface, k: int) -> tuple[float, float] | None:
    """Range of u or v on which the surface closes on itself; None where it does not."""
    period = surface.periods()[k]
    if surface.double_cover:
        return ((-math.pi, math.pi), (-math.pi / 2, math.pi / 2))[k]
    if period is not None:
        return -period / 2, period / 2
    if surface.chart.singular_at:  # only charts with poles close without a period
        return ((0.0, math.pi), (-math.pi / 2, math.pi / 2))[k]
    return None


def _span(
    plan: Plan, surface: Surface, side: int, contacts: Sequence[int], k: int, whole: bool
) -> tuple[float, float]:
    """Range of u or v to draw, a hair less: charts end at poles, where there is no frame."""
    closed = closed_span(surface, k) if whole or surface.double_cover else None
    if closed is not None:
        start, stop = closed
    else:
        t = regular_times(plan, plan.sample_times())
        found = plan.evaluate(t, "states", "points")
        q = found["states"][:, contacts, 4 * side : 4 * side + 2].reshape(-1, 2)
        reach = np.ptp(found["points"][:, contacts, side].reshape(-1, 3), axis=0).max()
        margin = 0.35 * reach / surface.lame(*q[len(q) // 2])[k]
        start, stop = q[:, k].min() - margin, q[:, k].max() + margin
    hair = 1e-6 * (stop - start)
    return start + hair, stop - hair


def edges(mesh: Mesh) -> np.ndarray:
    """Segments (n, 2, 3) of the grid's border that do not close on another one."""

    def meet(first: np.ndarray, last: np.ndarray) -> bool:
        return np.linalg.norm(first - last, axis=1).max() < 1e-3 * mesh.size

    grid = mesh.points.reshape(*mesh.shape, 3)
    pairs = [np.empty((0, 2, 3))]
    for first, last in ((grid[0], grid[-1]), (grid[:, 0], grid[:, -1])):
        for line in () if meet(first, last) else (first, last):
            if not meet(line, line[::-1]):  # a pole, or a seam folded on itself, is no edge
                pairs.append(np.stack([line[:-1], line[1:]], 1))
    return np.concatenate(pairs)
