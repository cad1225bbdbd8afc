"""Surfaces of second degree: x^T A x = 1."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import numpy as np

from ..checks import real_array
from ..errors import SurfaceError
from ..kept import kept
from ..theory import symbols as ca
from ..theory.geometry import contact_frame
from .base import store
from .charts import TURN, Angle, Array, Chart, Frame, Numbers, Pair, diagonal, hypot
from .cylinder import RoundCylinderChart
from .ellipsoid import SecondDegree, ellipsoid_chart
from .plane import FlatChart


class OneSheetChart(Chart):
    """(a cosh v cos u, b cosh v sin u, c sinh v): hyperboloid of one sheet, p = (a, b, c)."""

    name = "one_sheet"
    periods = (TURN, None)
    ranges = "-pi < u <= pi, v any"
    wrap = RoundCylinderChart.wrap

    @staticmethod
    def point(p: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        swell = ca.cosh(v)
        return ca.vertcat(p[0] * swell * ca.cos(u), p[1] * swell * ca.sin(u), p[2] * ca.sinh(v))

    @staticmethod
    def coordinates(p: ca.SX, x: ca.SX) -> Pair:
        return ca.atan2(x[1] / p[1], x[0] / p[0]), ca.asinh(x[2] / p[2])

    @staticmethod
    def frame(p: ca.SX, x: ca.SX) -> Frame:
        a, b, c = p[0], p[1], p[2]
        slope = x[2] / c
        swell = hypot(1, slope)
        f_u = ca.vertcat(-x[1] * a / b, x[0] * b / a, 0)
        f_v = ca.vertcat(x[0] * slope / swell, x[1] * slope / swell, c * swell)
        return contact_frame(f_u, f_v)


class TwoSheetChart(Chart):
    """(a sqrt(1 + u^2 + v^2), b u, c v): one sheet of two, p = (a, b, c)."""

    name = "two_sheet"

    @staticmethod
    def point(p: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(p[0] * ca.sqrt(1 + u**2 + v**2), p[1] * u, p[2] * v)

    @staticmethod
    def coordinates(p: ca.SX, x: ca.SX) -> Pair:
        return x[1] / p[1], x[2] / p[2]

    @staticmethod
    def frame(p: ca.SX, x: ca.SX) -> Frame:
        u, v = TwoSheetChart.coordinates(p, x)
        swell = ca.sqrt(1 + u**2 + v**2)
        return contact_frame(
            ca.vertcat(p[0] * u / swell, p[1], 0), ca.vertcat(p[0] * v / swell, 0, p[2])
        )


class EllipticCylinderChart(Chart):
    """(a cos u, b sin u, v), p = (a, b)."""

    name = "elliptic_cylinder"
    orthogonal = True
    periods = (TURN, None)
    ranges = RoundCylinderChart.ranges
    wrap = RoundCylinderChart.wrap

    @staticmethod
    def point(p: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(p[0] * ca.cos(u), p[1] * ca.sin(u), v)

    @staticmethod
    def coordinates(p: ca.SX, x: ca.SX) -> Pair:
        return ca.atan2(x[1] / p[1], x[0] / p[0]), x[2]

    @staticmethod
    def frame(p: ca.SX, x: ca.SX) -> Frame:
        f_u = ca.vertcat(-x[1] * p[0] / p[1], x[0] * p[1] / p[0], 0)
        h_u = hypot(f_u[0], f_u[1])
        return f_u / h_u, ca.SX([0, 0, 1]), diagonal(h_u, 1)

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return min(p[1], 1.0)  # h_u >= b, as a >= b


class HyperbolicCylinderChart(Chart):
    """(a sqrt(1 + u^2), b u, v), p = (a, b)."""

    name = "hyperbolic_cylinder"
    orthogonal = True

    @staticmethod
    def point(p: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(p[0] * ca.sqrt(1 + u**2), p[1] * u, v)

    @staticmethod
    def coordinates(p: ca.SX, x: ca.SX) -> Pair:
        return x[1] / p[1], x[2]

    @staticmethod
    def frame(p: ca.SX, x: ca.SX) -> Frame:
        u = x[1] / p[1]
        f_u = ca.vertcat(p[0] * u / hypot(1, u), p[1], 0)
        h_u = hypot(f_u[0], f_u[1])
        return f_u / h_u, ca.SX([0, 0, 1]), diagonal(h_u, 1)

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return min(p[1], 1.0)  # h_u >= b


class OffsetPlaneChart(FlatChart):
    """(a, u, v): the plane at distance a from the origin, p = (a,)."""

    name = "offset_plane"

    @staticmethod
    def point(p: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(p[0], u, v)

    @staticmethod
    def coordinates(p: ca.SX, x: ca.SX) -> Pair:
        return x[1], x[2]

    @staticmethod
    def frame(p: ca.SX, x: ca.SX) -> Frame:
        return ca.SX([0, 1, 0]), ca.SX([0, 0, 1]), ca.SX.eye(2)


@dataclass(frozen=True, eq=False, repr=False)
class Quadric(SecondDegree):
    """x^T A x = 1 for a symmetric A of any signature that gives a smooth surface.

    Coordinates are laid along the principal axes: an ellipsoid in any orientation (charts of
    `Ellipsoid`), hyperboloids of one and two sheets, elliptic and hyperbolic cylinders, a pair of
    planes; ``help(surface.chart)`` shows the chart. The normal is along A x, so the body is where
    x^T A x < 1; ``inside`` turns it.

    Parameters
    ----------
    A : array-like (3, 3)
        Symmetric, 1/m^2; at least one positive eigenvalue.
    sheet : {1, -1}
        Which of two sheets: the one on the positive or the negative side of the first principal
        axis. Only for the two-sheeted hyperboloid, the hyperbolic cylinder and the planes.
    inside : bool
        Body on the side x^T A x > 1; (u, v) is then the chart's f(u, -v).
    """

    A: tuple[tuple[float, float, float], ...]
    sheet: int = field(default=1, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        matrix = _symmetric(self.A)
        store(self, A=tuple(tuple(float(w) for w in row) for row in matrix))
        given = self.sheet
        if not isinstance(given, Real) or isinstance(given, bool) or given not in (1, -1):
            raise SurfaceError(f"Quadric: sheet = {given!r} must be 1 or -1")
        store(self, sheet=int(given))
        chart = self.chart
        if self.sheet == -1 and chart not in (
            TwoSheetChart,
            HyperbolicCylinderChart,
            OffsetPlaneChart,
        ):
            raise SurfaceError(
                "Quadric: sheet = -1, but this surface is in one piece "
                f"({chart.__name__}); leave sheet out"
            )

    @kept
    def _principal(self) -> tuple[type[Chart], tuple[float, ...], Array]:
        """Chart, its numbers, and the rotation from chart axes to the body's, (3, 3)."""
        chart, numbers, rotation = _principal_chart(np.array(self.A))
        if self.sheet == -1:
            # Half a turn about the third axis carries one sheet, chart and normal, to the other.
            rotation = rotation * np.array([-1.0, -1.0, 1.0])
        return chart, numbers, rotation

    @property
    def chart(self) -> type[Chart]:
        return self._principal[0]

    @property
    def table_name(self) -> str:  # type: ignore[override]
        return f"quadric_{self.chart.name}"

    @kept
    def parameters(self) -> tuple[float, ...]:
        """Three chart numbers (padded), nine of the rotation row by row, six of A."""
        _, numbers, rotation = self._principal
        padded = (*numbers, 1.0, 1.0)[:3]
        matrix = np.array(self.A)
        upper = matrix[np.triu_indices(3)]
        return (*padded, *map(float, rotation.ravel()), *map(float, upper))

    @property
    def size(self) -> float:
        return max(self._principal[1])

    @property
    def bend(self) -> float:
        return min(self._principal[1])

    def _rotation(self, p: ca.SX) -> ca.SX:
        return ca.reshape(p[3:12], 3, 3).T

    def _outward_chart(self, p: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        return self._rotation(p) @ self.chart.point(p, u, v)

    def _outward_coordinates(self, p: ca.SX, x: ca.SX) -> Pair:
        return self.chart.coordinates(p, self._rotation(p).T @ x)

    def _outward_frame(self, p: ca.SX, x: ca.SX) -> Frame:
        rotation = self._rotation(p)
        x_axis, y_axis, m = self.chart.frame(p, rotation.T @ x)
        return rotation @ x_axis, rotation @ y_axis, m

    def _matrix(self, p: ca.SX) -> ca.SX:
        a = ca.vertsplit(p[12:18])
        rows = ((a[0], a[1], a[2]), (a[1], a[3], a[4]), (a[2], a[4], a[5]))
        return ca.vertcat(*(ca.horzcat(*row) for row in rows))


def _symmetric(given: Any) -> Array:
    try:
        matrix = real_array(given)
    except (TypeError, ValueError, OverflowError):
        raise SurfaceError(f"Quadric: A = {given!r} must be a 3 by 3 matrix of numbers") from None
    if matrix.shape != (3, 3):
        raise SurfaceError(f"Quadric: A has shape {matrix.shape}; it must be 3 by 3")
    if not np.all(np.isfinite(matrix)):
        raise SurfaceError(f"Quadric: A = {matrix.tolist()} must be finite")
    if np.max(np.abs(matrix - matrix.T)) > 1e-15 * np.max(np.abs(matrix)):
        raise SurfaceError(
            f"Quadric: A = {matrix.tolist()} must be symmetric; use (A + A.T)/2, which gives the "
            "same surface"
        )
    return (matrix + matrix.T) / 2


def _principal_chart(matrix: Array) -> tuple[type[Chart], tuple[float, ...], Array]:
    """Return chart, its numbers and a proper rotation, columns the chart's axes in the body."""
    values, vectors = _eigen(matrix)
    scale = np.max(np.abs(values))
    # eigh is good to a few units in the last place of the greatest eigenvalue.
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
    chart, numbers = _CASES[case](*map(float, _merge_equal(axes, case)))
    if chart.great_circles:  # what eigh finds of a rounded sphere says nothing
        rotation = np.eye(3)
    return chart, numbers, rotation


def _eigen(matrix: Array) -> tuple[Array, Array]:
    """Return eigenvalues and eigenvectors; exact for a diagonal matrix."""
    if np.count_nonzero(matrix - np.diag(np.diag(matrix))) == 0:
        return np.diag(matrix).copy(), np.eye(3)
    return np.linalg.eigh(matrix)


def _merge_equal(axes: Array, case: str) -> Array:
    """Make axes of one sign equal where they differ by rounding alone."""
    merged = axes.copy()
    for i in (1, 2):
        if case[i] == case[i - 1] and merged[i - 1] - merged[i] <= 4e-15 * merged[i - 1]:
            merged[i] = merged[i - 1]
    return merged


_CASES: dict[str, Callable[[float, float, float], tuple[type[Chart], tuple[float, ...]]]] = {
    "+++": ellipsoid_chart,
    "++-": lambda a, b, c: (OneSheetChart, (a, b, c)),
    "+--": lambda a, b, c: (TwoSheetChart, (a, b, c)),
    "++0": lambda a, b, c: (
        (RoundCylinderChart, (a,)) if a == b else (EllipticCylinderChart, (a, b))
    ),
    "+-0": lambda a, b, c: (HyperbolicCylinderChart, (a, b)),
    "+00": lambda a, b, c: (OffsetPlaneChart, (a,)),
}
