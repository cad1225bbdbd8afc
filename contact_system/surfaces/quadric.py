"""Surfaces of second degree: x^T A x = 1."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ..caching import cached_property
from ..checks import Array, shaped_array
from ..errors import SurfaceError
from ..theory import symbols as ca
from .base import Surface, store
from .charts import TURN, Chart, Pair
from .cylinder import RoundCylinderChart
from .ellipsoid import ellipsoid_chart, least_radius, require_thick, second_degree
from .plane import FlatChart

Floats = tuple[float, ...]


class OneSheetChart(Chart):
    """(a cosh v cos u, b cosh v sin u, c sinh v): hyperboloid of one sheet, p = (a, b, c)."""

    periods = (TURN, None)
    singular_at = ""

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        a, b, c = self.p[0], self.p[1], self.p[2]
        swell = ca.cosh(v)
        return ca.vertcat(a * swell * ca.cos(u), b * swell * ca.sin(u), c * ca.sinh(v))

    def coordinates(self, x: ca.SX) -> Pair:
        a, b, c = self.p[0], self.p[1], self.p[2]
        return ca.atan2(x[1] / b, x[0] / a), ca.asinh(x[2] / c)


class TwoSheetChart(Chart):
    """(a sqrt(1 + u^2 + v^2), b u, c v): one sheet of two, p = (a, b, c)."""

    singular_at = ""

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(self.p[0] * ca.sqrt(1 + u**2 + v**2), self.p[1] * u, self.p[2] * v)

    def coordinates(self, x: ca.SX) -> Pair:
        return x[1] / self.p[1], x[2] / self.p[2]


class EllipticCylinderChart(RoundCylinderChart):
    """(a cos u, b sin u, v), p = (a, b)."""

    developable = False

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(self.p[0] * ca.cos(u), self.p[1] * ca.sin(u), v)

    def coordinates(self, x: ca.SX) -> Pair:
        return ca.atan2(x[1] / self.p[1], x[0] / self.p[0]), x[2]


class HyperbolicCylinderChart(Chart):
    """(a sqrt(1 + u^2), b u, v), p = (a, b)."""

    orthogonal = True
    lengths = (False, True)
    singular_at = ""

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(self.p[0] * ca.sqrt(1 + u**2), self.p[1] * u, v)

    def coordinates(self, x: ca.SX) -> Pair:
        return x[1] / self.p[1], x[2]


class OffsetPlaneChart(FlatChart):
    """(a, u, v): the plane at distance a from the origin, p = (a,)."""

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(self.p[0], u, v)

    def coordinates(self, x: ca.SX) -> Pair:
        return x[1], x[2]


CHARTS: dict[str, type[Chart]] = {
    "++-": OneSheetChart,
    "+--": TwoSheetChart,
    "++0": EllipticCylinderChart,
    "+-0": HyperbolicCylinderChart,
    "+00": OffsetPlaneChart,
}
"""Charts by the signs of the eigenvalues; ellipsoids and round cylinders have others."""
TWO_PIECES = (TwoSheetChart, HyperbolicCylinderChart, OffsetPlaneChart)
"""Charts of surfaces in two pieces; each covers one of them."""


@dataclass(frozen=True, eq=False, repr=False)
class Quadric(Surface):
    """x^T A x = 1 for a symmetric A of any signature that gives a smooth surface.

    An ellipsoid in any orientation (charts of `Ellipsoid`), hyperboloids of one and two sheets,
    elliptic and hyperbolic cylinders, a pair of planes. The chart, which ``help(surface.chart)``
    shows, uses the principal axes. Each points so that its greatest component, of equal ones the
    first, is positive; the third is reversed if they would be left-handed. Where A is not diagonal,
    rounding chooses the directions of equal axes. The body is where x^T A x < 1.

    Parameters
    ----------
    A : (3, 3)
        Symmetric, 1/m^2; at least one positive eigenvalue. A body with turned axes that is more
        than a hundred times as wide as it is thick needs a greater tolerance of plans.
    sheet : 1 or -1
        The sheet on the positive or the negative side of the first principal axis, of a two-sheeted
        hyperboloid, a hyperbolic cylinder or two planes.
    inside : bool
        Body on the side x^T A x > 1; (u, v) is then the chart's f(u, -v).
    """

    examples: ClassVar = tuple(
        (((x, 0, 0), (0, y, 0), (0, 0, z)),)
        for x, y, z in (
            *((1.0, 1.0, 1.0), (1.0, 1.0, 0.6), (1.0, 0.8, 0.8), (1.0, 0.8, 0.6)),
            *((1.0, 0.8, -0.6), (1.0, -0.8, -0.6)),
            *((1.0, 1.0, 0), (1.0, 0.8, 0), (1.0, -0.8, 0), (1.0, 0, 0)),
        )
    )
    A: Any  # kept as tuples
    sheet: int = field(default=1, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        store(self, A=tuple(map(tuple, _symmetric(self.A).tolist())))
        if self.sheet not in (1, -1):
            raise SurfaceError(f"Quadric: sheet = {self.sheet!r} must be 1 or -1")
        store(self, sheet=int(self.sheet))
        if self.chart not in TWO_PIECES and self.sheet == -1:
            raise SurfaceError(
                "Quadric: sheet = -1, but this surface is in one piece "
                f"({self.chart.__name__}); leave sheet out"
            )

    @cached_property
    def _principal(self) -> tuple[type[Chart], Floats, Floats, Array]:
        """Chart, its numbers, the eigenvalues, and the rotation from chart axes to the body's."""
        chart, numbers, values, rotation = _principal_chart(np.array(self.A))
        if self.sheet == -1:
            # half a turn about the third axis maps one sheet to the other
            rotation = rotation * np.array([-1.0, -1.0, 1.0])
        return chart, numbers, values, rotation

    @property
    def chart(self) -> type[Chart]:
        return self._principal[0]

    @cached_property
    def parameters(self) -> tuple[float, ...]:
        """Three numbers of the chart (padded by 1), nine of the rotation by rows, eigenvalues."""
        _, numbers, values, rotation = self._principal
        return (*(*numbers, 1.0, 1.0)[:3], *rotation.ravel().tolist(), *values)

    @property
    def size(self) -> float:
        return max(self._principal[1])

    @property
    def least_radius(self) -> float:
        _, lengths, values, _ = self._principal
        short = min(lengths)
        return least_radius(max(lengths), short) if min(values) > 0 else short

    @property
    def injectivity(self) -> float:
        a, b, c = self._principal[2]  # 1/axis^2, those of ellipsoids ascending
        return math.pi * math.sqrt(a / (b * c)) if min(a, b, c) > 0 else 0.0  # as of `Ellipsoid`

    def _axes(self, p: ca.SX) -> ca.SX:
        return ca.reshape(p[3:12], 3, 3).T

    def level_geometry(self, p: ca.SX, x: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        return second_degree(p[12:15], self._axes(p), x)


def _symmetric(value: Any) -> Array:
    remedy = "numbers in a 3 by 3 matrix"
    matrix = shaped_array(value, "Quadric: A", (3, 3), SurfaceError, remedy, finite=True)
    if np.max(np.abs(matrix - matrix.T)) > 1e-15 * np.max(np.abs(matrix)):
        raise SurfaceError(
            f"Quadric: A = {matrix.tolist()} must be symmetric; use (A + A.T)/2, which gives the "
            "same surface"
        )
    return (matrix + matrix.T) / 2


def _principal_chart(matrix: Array) -> tuple[type[Chart], Floats, Floats, Array]:
    """Return chart, numbers, eigenvalues and a proper rotation, columns the chart's axes."""
    diagonal = np.diag(matrix)
    is_diagonal = not np.any(matrix - np.diag(diagonal))  # exactly
    values, vectors = (diagonal, np.eye(3)) if is_diagonal else np.linalg.eigh(matrix)
    # rounding decides eigh's signs: make the greatest component, of near equals the first, positive
    greatest = np.abs(vectors).round(6).argmax(axis=0)
    vectors = vectors * np.sign(vectors[greatest, range(3)])
    scale = np.max(np.abs(values))
    # eigh has an error of a few units in the last place of the greatest eigenvalue
    values = np.where(np.abs(values) <= 8 * np.finfo(float).eps * scale, 0.0, values)
    signs = "".join("-0+"[int(np.sign(w)) + 1] for w in values)
    if "+" not in signs:
        raise SurfaceError(
            f"Quadric: A has eigenvalues {values.tolist()}, none positive, so x^T A x = 1 has no "
            "points; at least one must be positive"
        )
    axes = 1 / np.sqrt(np.where(values == 0, 1.0, np.abs(values)))
    # Order: positive (longest first), then negative (longest first), then zero.
    rank = {"+": 0, "-": 1, "0": 2}
    order = sorted(range(3), key=lambda i: (rank[signs[i]], -axes[i]))
    case = "".join(signs[i] for i in order)
    axes, rotation = axes[order], vectors[:, order]
    if np.linalg.det(rotation) < 0:
        rotation = rotation * np.array([1.0, 1.0, -1.0])
    axes = _merge_equal(axes, case)
    lengths = tuple(axes[: len(case.rstrip("0"))].tolist())
    chart: type[Chart]
    if case == "+++":
        require_thick("Quadric", lengths[0], lengths[2])
        chart, lengths = ellipsoid_chart(*lengths)
    elif case == "++0" and lengths[0] == lengths[1]:
        chart, lengths = RoundCylinderChart, lengths[:1]
    else:
        chart = CHARTS[case]
    if chart.great_circles:  # eigenvectors of a sphere are arbitrary
        rotation = np.eye(3)
    return chart, lengths, tuple((np.sign(values[order]) / axes**2).tolist()), rotation


def _merge_equal(axes: Array, case: str) -> Array:
    """Make axes of one sign equal if they differ by rounding alone."""
    merged = axes.copy()
    for i in (1, 2):
        if case[i] == case[i - 1] and merged[i - 1] - merged[i] <= 4e-15 * merged[i - 1]:
            merged[i] = merged[i - 1]
    return merged
