r"""Surfaces of bodies: chart, inverse chart, level function, and all that is metric about them.

A surface is said twice, symbolically for the kernels (``*_expr`` methods, over CasADi SX symbols
for its parameters) and numerically for everybody (vectorised over leading axes). The chart of each
surface is a small class of its own (`Chart`); a surface joins a chart to numbers. Every chart is
right-handed, ``f_u x f_v`` along the normal out of the body. ``inside=True`` puts the body on the
other side: the chart becomes ``f(u, -v)`` and the level function changes sign, so that the same
holds there.

SI units, radians. Charts: Kumar & Mukherjee (eq. ``ellipsoid`` and text); the ellipsoid's inverse
chart is the one of sphero-conal coordinates, see `JacobiChart`.
"""

from __future__ import annotations

import keyword
import math
import warnings
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_system.errors import ChartSingularity, ContactSystemError, SurfaceError
from contact_system.expressions import FUNCTIONS, parse
from contact_system.geometry import (
    ChartGeometry,
    chart_geometry,
    contact_frame,
    tangent_geometry,
)

SX = ca.SX
Array = NDArray[np.float64]
Pair = tuple[SX, SX]
Frame = tuple[SX, SX, SX]
Periods = tuple[float | None, float | None]

TURN = 2.0 * math.pi
# A contact frame whose axes shrink below this fraction of the surface's size is taken as lost.
# A pole typed with 16 digits gives 1e-16, a point 1e-9 rad from one still gives 1e-9.
SINGULAR = 1e-12
# Keeps 0/0 out of expressions whose numerator is zero as well; far below any real length ratio.
TINY = 1e-300

# CasADi functions by (surface structure, what they compute).
_FUNCTIONS: dict[tuple[Hashable, str], ca.Function] = {}


# --------------------------------------------------------------------------- charts


class Chart:
    """One way to lay coordinates on a family of surfaces. Stateless; ``p`` holds its numbers.

    Class attributes: `orthogonal` (``f_u . f_v = 0`` identically), `periods` of u and v in radians
    or None, `double_cover` ((-u, pi - v) is the same point as (u, v), with both frame axes turned
    by pi), `developable` (T = 0 and constant Lame coefficients), `great_circles` (geodesics are
    great circles), `singular_at` (where the frame is lost, for messages), `ranges` of the
    principal branch.
    """

    orthogonal: ClassVar[bool] = False
    periods: ClassVar[Periods] = (None, None)
    double_cover: ClassVar[bool] = False
    developable: ClassVar[bool] = False
    great_circles: ClassVar[bool] = False
    singular_at: ClassVar[str] = ""
    ranges: ClassVar[str] = "u and v any real number"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        """Return f(u, v), (3, 1), m."""
        raise NotImplementedError

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        """Return (u, v) of a point x on the surface, principal branch."""
        raise NotImplementedError

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        """Return (x axis, y axis, M) at a point x on the surface."""
        raise NotImplementedError

    @staticmethod
    def wrap(u: Array, v: Array) -> tuple[Array, Array]:
        """Return the same point in the principal range; what is in range stays bit for bit."""
        return u, v


class FlatChart(Chart):
    """(u, v, 0): the plane; lengths are coordinates."""

    orthogonal = True
    developable = True

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        return ca.vertcat(u, v, 0)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return x[0], x[1]

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        return SX([1, 0, 0]), SX([0, 1, 0]), SX.eye(2)


class PolarChart(Chart):
    """r (sin u cos v, sin u sin v, cos u): the sphere, p = (r,)."""

    orthogonal = True
    periods = (None, TURN)
    great_circles = True
    singular_at = "a pole (u = 0 or pi)"
    ranges = "0 < u < pi, -pi < v <= pi"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        rho = p[0] * ca.sin(u)
        return ca.vertcat(rho * ca.cos(v), rho * ca.sin(v), p[0] * ca.cos(u))

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(_hypot(x[0], x[1]), x[2]), ca.atan2(x[1], x[0])

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        r, rho = p[0], _hypot(x[0], x[1])
        cos_v, sin_v, cos_u = x[0] / rho, x[1] / rho, x[2] / r
        x_axis = ca.vertcat(cos_u * cos_v, cos_u * sin_v, -rho / r)
        return x_axis, ca.vertcat(-sin_v, cos_v, 0), _diag(r, rho)

    @staticmethod
    def wrap(u: Array, v: Array) -> tuple[Array, Array]:
        u = _wrap(u)
        # (-u, v) is the point (u, v + pi), but there f_u x f_v points into the body.
        return np.abs(u), _wrap(np.where(u < 0, v + math.pi, v))


class RoundCylinderChart(Chart):
    """(r cos u, r sin u, v): the circular cylinder, p = (r,)."""

    orthogonal = True
    periods = (TURN, None)
    developable = True
    ranges = "-pi < u <= pi, v any"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        return ca.vertcat(p[0] * ca.cos(u), p[0] * ca.sin(u), v)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(x[1], x[0]), x[2]

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        return ca.vertcat(-x[1] / p[0], x[0] / p[0], 0), SX([0, 0, 1]), _diag(p[0], 1)

    @staticmethod
    def wrap(u: Array, v: Array) -> tuple[Array, Array]:
        return _wrap(u), v


class TorusChart(Chart):
    """((R + r cos v) cos u, (R + r cos v) sin u, r sin v), p = (R, r); regular everywhere."""

    orthogonal = True
    periods = (TURN, TURN)
    ranges = "-pi < u, v <= pi"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        rho = p[0] + p[1] * ca.cos(v)
        return ca.vertcat(rho * ca.cos(u), rho * ca.sin(u), p[1] * ca.sin(v))

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(x[1], x[0]), ca.atan2(x[2], _hypot(x[0], x[1]) - p[0])

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        rho = _hypot(x[0], x[1])
        cos_u, sin_u = x[0] / rho, x[1] / rho
        cos_v, sin_v = (rho - p[0]) / p[1], x[2] / p[1]
        y_axis = ca.vertcat(-sin_v * cos_u, -sin_v * sin_u, cos_v)
        return ca.vertcat(-sin_u, cos_u, 0), y_axis, _diag(rho, p[1])

    @staticmethod
    def wrap(u: Array, v: Array) -> tuple[Array, Array]:
        return _wrap(u), _wrap(v)


class JacobiChart(Chart):
    r"""Jacobi's ellipsoidal coordinates, eq. ``ellipsoid``, a > b > c, p = (a, b, c).

    With :math:`k^2 = (b^2-c^2)/(a^2-c^2)` and :math:`k'^2 = (a^2-b^2)/(a^2-c^2) = 1 - k^2`,

    .. math:: f = (a \cos u \sqrt{k'^2 + k^2\cos^2 v},\; b \sin u \cos v,\;
                   c \sin v \sqrt{k^2 + k'^2 \sin^2 u}),

    which is the paper's chart with its differences of squares factored, so that nothing cancels
    for nearly equal axes. Lines of curvature; four umbilics at v = +-pi/2, u in {0, pi}. The seam
    v = +-pi/2 is regular: (u, v) and (-u, pi - v) are one point.
    """

    orthogonal = True
    periods = (TURN, TURN)
    double_cover = True
    singular_at = "an umbilic (v = +-pi/2 with u = 0 or pi)"
    ranges = "-pi < u <= pi, -pi/2 <= v <= pi/2"

    @staticmethod
    def moduli(p: SX) -> Pair:
        """Return (k^2, k'^2); the differences of nearly equal axes are exact."""
        a, b, c = p[0], p[1], p[2]
        whole = (a - c) * (a + c)
        return (b - c) * (b + c) / whole, (a - b) * (a + b) / whole

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        k2, l2 = JacobiChart.moduli(p)
        sin_u, cos_v = ca.sin(u), ca.cos(v)
        return ca.vertcat(
            p[0] * ca.cos(u) * ca.sqrt(l2 + k2 * cos_v**2),
            p[1] * sin_u * cos_v,
            p[2] * ca.sin(v) * ca.sqrt(k2 + l2 * sin_u**2),
        )

    @staticmethod
    def circular(p: SX, x: SX) -> tuple[SX, SX, SX, SX, SX]:
        r"""Return (sin u, cos u, sin v, cos v, k'^2 sin^2 u + k^2 cos^2 v), cos v >= 0.

        (X, Y, Z) = (x/a, y/b, z/c) is a point of the unit sphere in sphero-conal coordinates.
        alpha = k'^2 sin^2 u and beta = k^2 cos^2 v have the difference
        D = Z^2 - k^2 + k'^2 Y^2 = k'^2 - X^2 - k^2 Y^2 and the product (k k' Y)^2: the greater
        follows from a sum, the smaller from the product, and neither loses digits. Of the two
        forms of D the one with the smaller terms is exact where D is small: near the umbilics,
        which crowd at the x or the z axis as the ellipsoid nears one of revolution.
        """
        k2, l2 = JacobiChart.moduli(p)
        k, l1 = ca.sqrt(k2), ca.sqrt(l2)
        xs, ys, zs = x[0] / p[0], x[1] / p[1], x[2] / p[2]
        from_z = (ca.fabs(zs) - k) * (ca.fabs(zs) + k) + l2 * ys**2
        from_x = (l1 - ca.fabs(xs)) * (l1 + ca.fabs(xs)) - k2 * ys**2
        difference = ca.if_else(k2 < l2, from_z, from_x)
        half_product = k * l1 * ca.fabs(ys)
        total = _hypot(difference, 2 * half_product)
        greater = ca.sqrt((ca.fabs(difference) + total) / 2)
        smaller = half_product / ca.fmax(greater, TINY)
        alpha_leads = difference >= 0
        root_alpha = ca.if_else(alpha_leads, greater, smaller)
        root_beta = ca.if_else(alpha_leads, smaller, greater)
        sin_u = ca.copysign(root_alpha / l1, ys)
        cos_u = xs / ca.sqrt(l2 + root_beta**2)
        sin_v = zs / ca.sqrt(k2 + root_alpha**2)
        return sin_u, cos_u, sin_v, root_beta / k, total

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        sin_u, cos_u, sin_v, cos_v, _ = JacobiChart.circular(p, x)
        return ca.atan2(sin_u, cos_u), ca.atan2(sin_v, cos_v)

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        a, b, c = p[0], p[1], p[2]
        k2, l2 = JacobiChart.moduli(p)
        sin_u, cos_u, sin_v, cos_v, total = JacobiChart.circular(p, x)
        root_u = ca.sqrt(k2 + l2 * sin_u**2)
        root_v = ca.sqrt(l2 + k2 * cos_v**2)
        # h_u^2 = (k'^2 sin^2 u + k^2 cos^2 v)(a^2 sin^2 u + b^2 cos^2 u)/(k^2 + k'^2 sin^2 u).
        h_u = ca.sqrt(total) * _hypot(a * sin_u, b * cos_u) / root_u
        h_v = ca.sqrt(total) * _hypot(b * sin_v, c * cos_v) / root_v
        f_u = ca.vertcat(
            -a * sin_u * root_v, b * cos_u * cos_v, c * sin_v * l2 * sin_u * cos_u / root_u
        )
        f_v = ca.vertcat(
            -a * cos_u * k2 * cos_v * sin_v / root_v, -b * sin_u * sin_v, c * cos_v * root_u
        )
        return f_u / h_u, f_v / h_v, _diag(h_u, h_v)

    @staticmethod
    def wrap(u: Array, v: Array) -> tuple[Array, Array]:
        v = _wrap(v)
        beyond = np.abs(v) > math.pi / 2
        return (
            _wrap(np.where(beyond, -u, u)),
            np.where(beyond, np.copysign(math.pi, v) - v, v),
        )


class OblateChart(Chart):
    """(a cos u cos v, a sin u cos v, c sin v): Jacobi's chart in the limit a = b, p = (a, c)."""

    orthogonal = True
    periods = (TURN, None)
    singular_at = "a pole (v = +-pi/2)"
    ranges = "-pi < u <= pi, -pi/2 < v < pi/2"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        rho = p[0] * ca.cos(v)
        return ca.vertcat(rho * ca.cos(u), rho * ca.sin(u), p[1] * ca.sin(v))

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(x[1], x[0]), ca.atan2(x[2] / p[1], _hypot(x[0], x[1]) / p[0])

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        rho = _hypot(x[0], x[1])
        cos_u, sin_u = x[0] / rho, x[1] / rho
        outward, upward = -p[0] * x[2] / p[1], p[1] * rho / p[0]
        h_v = _hypot(outward, upward)
        y_axis = ca.vertcat(outward * cos_u, outward * sin_u, upward) / h_v
        return ca.vertcat(-sin_u, cos_u, 0), y_axis, _diag(rho, h_v)

    @staticmethod
    def wrap(u: Array, v: Array) -> tuple[Array, Array]:
        v = _wrap(v)
        beyond = np.abs(v) > math.pi / 2
        return (
            _wrap(np.where(beyond, u + math.pi, u)),
            np.where(beyond, np.copysign(math.pi, v) - v, v),
        )


class ProlateChart(Chart):
    """(a cos u, b sin u cos v, b sin u sin v): Jacobi's chart in the limit b = c, p = (a, b)."""

    orthogonal = True
    periods = (None, TURN)
    singular_at = "a pole (u = 0 or pi)"
    ranges = "0 < u < pi, -pi < v <= pi"
    wrap = PolarChart.wrap

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        rho = p[1] * ca.sin(u)
        return ca.vertcat(p[0] * ca.cos(u), rho * ca.cos(v), rho * ca.sin(v))

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(_hypot(x[1], x[2]) / p[1], x[0] / p[0]), ca.atan2(x[2], x[1])

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        rho = _hypot(x[1], x[2])
        cos_v, sin_v = x[1] / rho, x[2] / rho
        axial, radial = -p[0] * rho / p[1], p[1] * x[0] / p[0]
        h_u = _hypot(axial, radial)
        x_axis = ca.vertcat(axial, radial * cos_v, radial * sin_v) / h_u
        return x_axis, ca.vertcat(0, -sin_v, cos_v), _diag(h_u, rho)


class OneSheetChart(Chart):
    """(a cosh v cos u, b cosh v sin u, c sinh v): hyperboloid of one sheet, p = (a, b, c)."""

    periods = (TURN, None)
    ranges = "-pi < u <= pi, v any"
    wrap = RoundCylinderChart.wrap

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        swell = ca.cosh(v)
        return ca.vertcat(p[0] * swell * ca.cos(u), p[1] * swell * ca.sin(u), p[2] * ca.sinh(v))

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(x[1] / p[1], x[0] / p[0]), ca.asinh(x[2] / p[2])

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        a, b, c = p[0], p[1], p[2]
        slope = x[2] / c
        swell = _hypot(1, slope)
        f_u = ca.vertcat(-x[1] * a / b, x[0] * b / a, 0)
        f_v = ca.vertcat(x[0] * slope / swell, x[1] * slope / swell, c * swell)
        return contact_frame(f_u, f_v)


class TwoSheetChart(Chart):
    """(a sqrt(1 + u^2 + v^2), b u, c v): one sheet of two, p = (a, b, c)."""

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        return ca.vertcat(p[0] * ca.sqrt(1 + u**2 + v**2), p[1] * u, p[2] * v)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return x[1] / p[1], x[2] / p[2]

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        u, v = TwoSheetChart.coordinates(p, x)
        swell = ca.sqrt(1 + u**2 + v**2)
        return contact_frame(
            ca.vertcat(p[0] * u / swell, p[1], 0), ca.vertcat(p[0] * v / swell, 0, p[2])
        )


class EllipticCylinderChart(Chart):
    """(a cos u, b sin u, v), p = (a, b)."""

    orthogonal = True
    periods = (TURN, None)
    ranges = RoundCylinderChart.ranges
    wrap = RoundCylinderChart.wrap

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        return ca.vertcat(p[0] * ca.cos(u), p[1] * ca.sin(u), v)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(x[1] / p[1], x[0] / p[0]), x[2]

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        f_u = ca.vertcat(-x[1] * p[0] / p[1], x[0] * p[1] / p[0], 0)
        h_u = _hypot(f_u[0], f_u[1])
        return f_u / h_u, SX([0, 0, 1]), _diag(h_u, 1)


class HyperbolicCylinderChart(Chart):
    """(a sqrt(1 + u^2), b u, v), p = (a, b)."""

    orthogonal = True

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        return ca.vertcat(p[0] * ca.sqrt(1 + u**2), p[1] * u, v)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return x[1] / p[1], x[2]

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        u = x[1] / p[1]
        f_u = ca.vertcat(p[0] * u / _hypot(1, u), p[1], 0)
        h_u = _hypot(f_u[0], f_u[1])
        return f_u / h_u, SX([0, 0, 1]), _diag(h_u, 1)


class OffsetPlaneChart(Chart):
    """(a, u, v): the plane at distance a from the origin, p = (a,)."""

    orthogonal = True
    developable = True

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        return ca.vertcat(p[0], u, v)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return x[1], x[2]

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        return SX([0, 1, 0]), SX([0, 0, 1]), SX.eye(2)


# --------------------------------------------------------------------------- surfaces


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """A smooth surface that bounds a body. Immutable; equal where structure and numbers are equal.

    Subclasses say `parameters`, `chart` and `_level`; `Quadric` also turns its chart in space.
    ``p`` stands for an SX vector of as many symbols as `parameters` has numbers.
    """

    inside: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.inside, (bool, np.bool_)):
            raise SurfaceError(
                f"{self._kind}: inside = {self.inside!r} must be True or False; True puts the "
                "body on the other side, as for a bowl"
            )
        _set(self, inside=bool(self.inside))

    # -- what a surface is

    has_chart: ClassVar[bool] = True
    has_implicit: ClassVar[bool] = True
    ambient: ClassVar[bool] = False

    @property
    def _kind(self) -> str:
        return type(self).__name__

    @property
    def chart(self) -> type[Chart]:
        """The chart of the surface."""
        raise NotImplementedError

    @property
    def parameters(self) -> tuple[float, ...]:
        """Run-time numbers, such as radii in m; the values behind the symbols ``p``."""
        raise NotImplementedError

    @property
    def structure(self) -> Hashable:
        """What kernels are specialised by: equal structures differ in `parameters` alone."""
        return (self._kind, self.inside, self.chart.__name__)

    @property
    def size(self) -> float:
        """Length scale, m: the greatest radius."""
        raise NotImplementedError

    @property
    def developable(self) -> bool:
        """T = 0 exactly and constant Lame coefficients: a straight line stays one, unrolled."""
        return self.chart.developable

    @property
    def great_circles(self) -> bool:
        """The surface is a sphere about the origin of its frame."""
        return self.chart.great_circles

    @property
    def double_cover(self) -> bool:
        """(-u, pi - v) is the same point as (u, v), with both frame axes turned by pi."""
        return self.chart.double_cover

    def periods(self) -> Periods:
        """Return the periods of u and v, rad, None where a coordinate has none."""
        return self.chart.periods

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Surface):
            return NotImplemented
        return self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    def __repr__(self) -> str:
        said = [f"{getattr(self, w.name)!r}" for w in fields(self) if not w.kw_only]
        named = [w for w in fields(self) if w.kw_only and getattr(self, w.name) != w.default]
        said += [f"{w.name}={getattr(self, w.name)!r}" for w in named]
        return f"{self._kind}({', '.join(said)})"

    @property
    def _identity(self) -> Hashable:
        return (self.structure, self.parameters, self.size, self.periods())

    # -- symbolic

    def chart_expr(self, p: SX, u: SX, v: SX) -> SX:
        """Return the chart f(u, v), (3, 1), m.

        Raises
        ------
        SurfaceError
            For an `ImplicitSurface`, which has no explicit chart (`has_chart` is False).
        """
        return self._outward_chart(p, u, -v if self.inside else v)

    def implicit_expr(self, p: SX, x: SX) -> SX | None:
        """Return F(x), zero on the surface, gradient out of the body; None without such a form."""
        return -self._level(p, x) if self.inside else self._level(p, x)

    def coordinates_expr(self, p: SX, x: SX) -> Pair | None:
        """Return (u, v) of a point of the surface, in the ranges that its chart documents.

        None where the inverse chart is numerical only (`ParametricSurface`).
        """
        u, v = self._outward_coordinates(p, x)
        return u, (-v if self.inside else v)

    def frame_expr(self, p: SX, x: SX) -> Frame | None:
        """Return (x axis, y axis, M) of the contact frame as expressions of the point x.

        None where the inverse chart is numerical only (`ParametricSurface`).
        """
        x_axis, y_axis, m = self._outward_frame(p, x)
        if not self.inside:
            return x_axis, y_axis, m
        # v turns, hence f_v and the normal do; y = n x x turns with the normal.
        turned = m if self.chart.orthogonal else ca.vertcat(m[0, :] * SX([[1, -1]]), m[1, :])
        return x_axis, -y_axis, turned

    def geometry_expr(self, p: SX, u: SX, v: SX) -> ChartGeometry:
        """Return every metric quantity at (u, v), symbols; see `ChartGeometry`."""
        return chart_geometry(self.chart_expr(p, u, v), u, v, self.chart.orthogonal)

    def _outward_chart(self, p: SX, u: SX, v: SX) -> SX:
        return self.chart.point(p, u, v)

    def _outward_coordinates(self, p: SX, x: SX) -> Pair:
        return self.chart.coordinates(p, x)

    def _outward_frame(self, p: SX, x: SX) -> Frame:
        return self.chart.frame(p, x)

    def _level(self, p: SX, x: SX) -> SX:
        raise NotImplementedError

    # -- numeric, vectorised over leading axes

    def point(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return f(u, v), shape (..., 3), m."""
        return self._evaluate("point", u, v, (3,))

    def frame(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the contact frame E, columns x, y, n, shape (..., 3, 3)."""
        return self._evaluate("frame", u, v, (3, 3))

    def normal(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the unit normal out of the body, shape (..., 3)."""
        return self.frame(u, v)[..., 2]

    def lame(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the Lame coefficients (h_u, h_v), shape (..., 2)."""
        return self._evaluate("lame", u, v, (2,))

    def metric_root(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return M, shape (..., 2, 2): coordinate rates to velocity in the contact frame."""
        return self._evaluate("metric_root", u, v, (2, 2))

    def christoffel(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return Gamma^k_ij as [..., k, i, j] (eq. ``christoffel``)."""
        return self._evaluate("christoffel", u, v, (2, 2, 2))

    def curvature_form(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return K, shape (..., 2, 2), 1/m; +I/r on a sphere."""
        return self._evaluate("curvature_form", u, v, (2, 2))

    def torsion_form(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return T, shape (..., 2), 1/m: ``y . x' = T M q'``."""
        return self._evaluate("torsion_form", u, v, (2,))

    def coordinates(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return (u, v), each of shape (...), of points (..., 3) on the surface.

        The principal branch; its range is `chart`.ranges, with the sign of v turned inside.
        """
        points = self._points(x)
        uv = self._call("coordinates", points.reshape(-1, 3).T)
        lead = points.shape[:-1]
        # atan2(-0.0, negative) is -pi, the half-open range ends at +pi.
        u, v = (
            np.where(w == -math.pi, math.pi, w) if period else w
            for w, period in zip(uv, self.periods(), strict=True)
        )
        return u.reshape(lead), v.reshape(lead)

    def canonical(self, u: ArrayLike, v: ArrayLike) -> tuple[Any, Any]:
        """Return the same points in the chart's principal range, checked to be regular.

        Points in range stay as they are, bit for bit. Components given along the frame axes refer
        to the frame at the returned coordinates. Floats in, floats out.

        Raises
        ------
        SurfaceError
            A coordinate is NaN or infinite.
        ChartSingularity
            The frame is lost there (pole, umbilic): the metric root is below 1e-12 of the size.
        """
        u, v = self._finite(u, v)
        u, v = self._wrap(u, v)
        self._require_regular(u, v)
        return (float(u), float(v)) if u.ndim == 0 else (u, v)

    def align(
        self, u: ArrayLike, v: ArrayLike, u_ref: ArrayLike, v_ref: ArrayLike
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the coordinates of the same points that lie nearest to reference coordinates.

        Returns
        -------
        u, v : arrays of the broadcast shape
        half_turn : bool array
            Where both frame axes are turned by pi against the coordinates given.
        """
        u, v, u_ref, v_ref = np.broadcast_arrays(
            *(np.asarray(w, dtype=float) for w in (u, v, u_ref, v_ref))
        )
        period_u, period_v = self.periods()
        near_u, near_v = _nearest(u, u_ref, period_u), _nearest(v, v_ref, period_v)
        if not self.double_cover:
            return near_u, near_v, np.zeros(u.shape, dtype=bool)
        other_u = _nearest(-u, u_ref, period_u)
        other_v = _nearest(math.pi - v, v_ref, period_v)
        half_turn = np.hypot(other_u - u_ref, other_v - v_ref) < np.hypot(
            near_u - u_ref, near_v - v_ref
        )
        return (
            np.where(half_turn, other_u, near_u),
            np.where(half_turn, other_v, near_v),
            half_turn,
        )

    def unwind(self, u: ArrayLike, v: ArrayLike) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return coordinates made continuous along axis 0, starting from the first as given.

        The same as `align` of each sample to the one before, for a whole path at once. Samples
        must lie close enough that the nearest representative is the right one.

        Returns
        -------
        u, v : arrays of the given shape
        half_turn : bool array
            Where both frame axes are turned by pi against the coordinates given.
        """
        u, v = np.broadcast_arrays(np.asarray(u, dtype=float), np.asarray(v, dtype=float))
        half_turn = np.zeros(u.shape, dtype=bool)
        if self.double_cover and len(u) > 1:
            # Turning both neighbours leaves their distance: turns against the neighbour add up.
            step = self.align(u[1:], v[1:], u[:-1], v[:-1])[2]
            half_turn[1:] = np.logical_xor.accumulate(step, axis=0)
            u, v = np.where(half_turn, -u, u), np.where(half_turn, math.pi - v, v)
        period_u, period_v = self.periods()
        return _unwrap(u, period_u), _unwrap(v, period_v), half_turn

    def _wrap(self, u: Array, v: Array) -> tuple[Array, Array]:
        return self.chart.wrap(u, v)

    def _require_regular(self, u: Array, v: Array) -> None:
        m = self.metric_root(u, v)
        least = np.minimum(m[..., 0, 0], m[..., 1, 1])
        lost = ~(least > SINGULAR * self.size)
        if np.any(lost):
            at = (float(u[lost][0]), float(v[lost][0]))
            where = self.chart.singular_at or "a point where f_u or f_v vanishes or they align"
            raise ChartSingularity(
                f"{self!r}: no contact frame at (u, v) = {at}, {where}; the metric root is "
                f"{float(least[lost][0]):.3g} against a size of {self.size:.3g}. Move the contact "
                "away from that point, or turn the body's axes so that it lies elsewhere"
            )

    def _finite(self, u: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
        try:
            u, v = np.broadcast_arrays(np.asarray(u, dtype=float), np.asarray(v, dtype=float))
        except (TypeError, ValueError):
            raise SurfaceError(
                f"{self!r}: coordinates (u, v) = ({u!r}, {v!r}) must be numbers of one shape"
            ) from None
        bad = ~(np.isfinite(u) & np.isfinite(v))
        if np.any(bad):
            raise SurfaceError(
                f"{self!r}: coordinates (u, v) = ({u[bad][0]}, {v[bad][0]}) must be finite numbers"
            )
        return u, v

    def _points(self, x: ArrayLike) -> Array:
        points = np.asarray(x, dtype=float)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise SurfaceError(
                f"{self!r}: points have shape {points.shape}; the last axis must hold x, y, z"
            )
        if not np.all(np.isfinite(points)):
            raise SurfaceError(f"{self!r}: points must be finite numbers, got NaN or inf")
        return points

    def _evaluate(self, name: str, u: ArrayLike, v: ArrayLike, shape: tuple[int, ...]) -> Array:
        u, v = np.broadcast_arrays(np.asarray(u, dtype=float), np.asarray(v, dtype=float))
        columns = self._call(name, *self._arguments(u.ravel(), v.ravel()))
        # Functions return each point's entries in one column, first index fastest.
        entries = columns.T.reshape((u.size, *shape[::-1]))
        order = (0, *range(len(shape), 0, -1))
        return np.ascontiguousarray(entries.transpose(order)).reshape(u.shape + shape)

    def _arguments(self, u: Array, v: Array) -> tuple[Array, ...]:
        """Return what the CasADi functions take besides p, one column a point."""
        return u[None, :], v[None, :]

    def _call(self, name: str, *columns: Array) -> Array:
        key = (self.structure, name)
        if key not in _FUNCTIONS:
            _FUNCTIONS[key] = self._build(name)
        if columns[0].shape[1] == 0:
            return np.zeros((_FUNCTIONS[key].size1_out(0), 0))
        return _FUNCTIONS[key](ca.DM(self.parameters), *columns).full()

    def _build(self, name: str) -> ca.Function:
        p = SX.sym("p", len(self.parameters))
        if name == "coordinates":
            x = SX.sym("x", 3)
            return ca.Function(name, [p, x], [ca.vertcat(*(self.coordinates_expr(p, x) or ()))])
        arguments, geometry = self._geometry(p)
        if name == "christoffel":
            # (k, i, j) with k fastest, as the column-major convention of _evaluate wants.
            first, second = geometry.christoffel
            value = ca.horzcat(ca.vec(first), ca.vec(second)).T
        else:
            value = getattr(geometry, name)
        return ca.Function(name, [p, *arguments], [ca.vec(value)])

    def _geometry(self, p: SX) -> tuple[tuple[SX, ...], ChartGeometry]:
        u, v = SX.sym("u"), SX.sym("v")
        return (u, v), self.geometry_expr(p, u, v)


@dataclass(frozen=True, eq=False, repr=False)
class Plane(Surface):
    """The plane z = 0, body below; chart (u, v, 0), coordinates in m."""

    @property
    def chart(self) -> type[Chart]:
        return FlatChart

    @property
    def parameters(self) -> tuple[float, ...]:
        return ()

    @property
    def size(self) -> float:
        return 1.0

    def _level(self, p: SX, x: SX) -> SX:
        return x[2]


@dataclass(frozen=True, eq=False, repr=False)
class Sphere(Surface):
    """Sphere about the origin; chart r (sin u cos v, sin u sin v, cos u), poles at u = 0, pi.

    Parameters
    ----------
    radius : float
        m.
    inside : bool
        True: a spherical bowl.
    """

    ambient: ClassVar[bool] = True
    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        _set(self, radius=_positive(self, "radius", self.radius))

    @property
    def chart(self) -> type[Chart]:
        return PolarChart

    @property
    def parameters(self) -> tuple[float, ...]:
        return (self.radius,)

    @property
    def size(self) -> float:
        return self.radius

    def _level(self, p: SX, x: SX) -> SX:
        return (ca.dot(x, x) / p[0] ** 2 - 1) / 2


@dataclass(frozen=True, eq=False, repr=False)
class Cylinder(Surface):
    """Circular cylinder about the z axis; chart (r cos u, r sin u, v), v in m.

    Parameters
    ----------
    radius : float
        m.
    inside : bool
        True: a bore.
    """

    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        _set(self, radius=_positive(self, "radius", self.radius))

    @property
    def chart(self) -> type[Chart]:
        return RoundCylinderChart

    @property
    def parameters(self) -> tuple[float, ...]:
        return (self.radius,)

    @property
    def size(self) -> float:
        return self.radius

    def _level(self, p: SX, x: SX) -> SX:
        return ((x[0] ** 2 + x[1] ** 2) / p[0] ** 2 - 1) / 2


@dataclass(frozen=True, eq=False, repr=False)
class Torus(Surface):
    """Torus about the z axis; chart ((R + r cos v) cos u, (R + r cos v) sin u, r sin v).

    Parameters
    ----------
    major, minor : float
        R and r, m, 0 < r < R.
    inside : bool
        True: the inside of a tube.
    """

    major: float
    minor: float

    def __post_init__(self) -> None:
        super().__post_init__()
        _set(
            self,
            major=_positive(self, "major", self.major),
            minor=_positive(self, "minor", self.minor),
        )
        if not self.minor < self.major:
            raise SurfaceError(
                f"Torus: minor = {self.minor} must be less than major = {self.major}, or the tube "
                "meets itself; give Torus(major, minor) in that order"
            )

    @property
    def chart(self) -> type[Chart]:
        return TorusChart

    @property
    def parameters(self) -> tuple[float, ...]:
        return (self.major, self.minor)

    @property
    def size(self) -> float:
        return self.major + self.minor

    def _level(self, p: SX, x: SX) -> SX:
        return ((_hypot(x[0], x[1]) - p[0]) ** 2 + x[2] ** 2 - p[1] ** 2) / 2


@dataclass(frozen=True, eq=False, repr=False)
class Ellipsoid(Surface):
    """Ellipsoid with semi-axes a >= b >= c along x, y, z; Jacobi's chart, eq. ``ellipsoid``.

    Equal axes take the regular limit of that chart: `OblateChart` (a = b), `ProlateChart` (b = c),
    and for a = b = c the sphere's `PolarChart`.

    Parameters
    ----------
    a, b, c : float
        Semi-axes, m.
    inside : bool
        True: an ellipsoidal bowl.
    """

    ambient: ClassVar[bool] = True
    a: float
    b: float
    c: float

    def __post_init__(self) -> None:
        super().__post_init__()
        axes = tuple(_positive(self, name, getattr(self, name)) for name in "abc")
        if not axes[0] >= axes[1] >= axes[2]:
            given, sorted_ = (", ".join(map(repr, w)) for w in (axes, sorted(axes, reverse=True)))
            raise SurfaceError(
                f"Ellipsoid: semi-axes ({given}) must satisfy a >= b >= c; write "
                f"Ellipsoid({sorted_}), or Quadric for axes along other directions"
            )
        _set(self, a=axes[0], b=axes[1], c=axes[2])

    @property
    def chart(self) -> type[Chart]:
        return _ellipsoid_chart(self.a, self.b, self.c)[0]

    @property
    def parameters(self) -> tuple[float, ...]:
        return _ellipsoid_chart(self.a, self.b, self.c)[1]

    @property
    def size(self) -> float:
        return self.a

    def _level(self, p: SX, x: SX) -> SX:
        axes = {
            JacobiChart: (0, 1, 2),
            OblateChart: (0, 0, 1),
            ProlateChart: (0, 1, 1),
            PolarChart: (0, 0, 0),
        }[self.chart]
        return (ca.sumsqr(x / ca.vertcat(*(p[k] for k in axes))) - 1) / 2


@dataclass(frozen=True, eq=False, repr=False)
class Quadric(Surface):
    """x^T A x = 1 for a symmetric A of any signature that gives a smooth surface.

    Coordinates are laid along the principal axes: an ellipsoid in any orientation (charts of
    `Ellipsoid`), hyperboloids of one and two sheets, elliptic and hyperbolic cylinders, a pair of
    planes. The normal is along A x, so the body is where x^T A x < 1; ``inside`` turns it.

    Parameters
    ----------
    A : array-like (3, 3)
        Symmetric, 1/m^2; at least one positive eigenvalue.
    sheet : {1, -1}
        Which of two sheets: the one on the positive or the negative side of the first principal
        axis. Only for the two-sheeted hyperboloid, the hyperbolic cylinder and the planes.
    inside : bool
        Body on the side x^T A x > 1.
    """

    ambient: ClassVar[bool] = True
    A: tuple[tuple[float, float, float], ...]
    sheet: int = field(default=1, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        matrix = _symmetric(self.A)
        _set(self, A=tuple(tuple(float(w) for w in row) for row in matrix))
        if self.sheet not in (1, -1):
            raise SurfaceError(f"Quadric: sheet = {self.sheet!r} must be 1 or -1")
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

    @cached_property
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

    def _rotation(self, p: SX) -> SX:
        return ca.reshape(p[3:12], 3, 3).T

    def _outward_chart(self, p: SX, u: SX, v: SX) -> SX:
        return self._rotation(p) @ self.chart.point(p, u, v)

    def _outward_coordinates(self, p: SX, x: SX) -> Pair:
        return self.chart.coordinates(p, self._rotation(p).T @ x)

    def _outward_frame(self, p: SX, x: SX) -> Frame:
        rotation = self._rotation(p)
        x_axis, y_axis, m = self.chart.frame(p, rotation.T @ x)
        return rotation @ x_axis, rotation @ y_axis, m

    def _level(self, p: SX, x: SX) -> SX:
        a = p[12:18]
        pure = a[0] * x[0] ** 2 + a[3] * x[1] ** 2 + a[5] * x[2] ** 2
        mixed = a[1] * x[0] * x[1] + a[2] * x[0] * x[2] + a[4] * x[1] * x[2]
        return (pure + 2 * mixed - 1) / 2


class FreeChart(Chart):
    """A chart written by the user; nothing is known about it in advance."""

    ranges = "as given by u_range and v_range"


class CentralChart(Chart):
    """Polar angle u from +z and azimuth v of the ray from a centre; p starts with the centre."""

    periods = (None, TURN)
    singular_at = "a pole (u = 0 or pi)"
    ranges = PolarChart.ranges
    wrap = PolarChart.wrap

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return PolarChart.coordinates(p, x - p[:3])


@dataclass(frozen=True)
class Formula:
    """A user's function of symbols, kept as data so that surfaces compare, hash and pickle.

    Attributes
    ----------
    code : str
        Serialised CasADi function of (named parameters, *variables).
    names : tuple of str
        Named parameters, sorted.
    values : tuple of float
        Their numbers.
    text : tuple of str, or None
        The formula as written, where it was written as text.
    """

    code: str = field(repr=False)
    names: tuple[str, ...]
    values: tuple[float, ...]
    text: tuple[str, ...] | None

    def __call__(self, p: SX, *variables: SX) -> SX:
        return _restore(self.code)(p, *variables)

    def describe(self) -> str:
        """Return the arguments that make this formula, for messages."""
        said = "<function>" if self.text is None else repr(self.text)
        named = dict(zip(self.names, self.values, strict=True))
        return f"{said}, parameters={named}" if named else said


@cache
def _restore(code: str) -> ca.Function:
    return ca.Function.deserialize(code)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class UserSurface(Surface):
    """What surfaces written by the user share: a formula and a length scale."""

    formula: Formula
    size: float = field(default=1.0, kw_only=True)

    @property
    def named_parameters(self) -> dict[str, float]:
        """The numbers of the formula by name."""
        return dict(zip(self.formula.names, self.formula.values, strict=True))

    @property
    def structure(self) -> Hashable:
        return (self._kind, self.inside, self.formula.code)

    def __repr__(self) -> str:
        return f"{self._kind}({self.formula.describe()}{', inside=True' * self.inside})"


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ParametricSurface(UserSurface):
    """A surface given by its chart f(u, v), orthogonal or not.

    Parameters
    ----------
    f : callable or sequence of three texts
        ``f(u, v)`` or ``f(u, v, **parameters)`` returning x, y, z in m from symbols, with numpy or
        CasADi functions; or texts such as ``"(R + r*cos(v))*cos(u)"``. f_u x f_v points out of
        the body.
    parameters : mapping of str to float, optional
        Named numbers of the formula; changing them needs no new kernel.
    size : float
        Length scale of the surface, m.
    u_range, v_range : pairs of float, optional
        Where the inverse chart looks first; one period about 0, or (-pi, pi).
    u_period, v_period : float, optional
        Period of a coordinate that closes on itself.
    inside : bool
        The body is on the other side.
    """

    has_implicit: ClassVar[bool] = False
    u_range: tuple[float, float]
    v_range: tuple[float, float]
    u_period: float | None
    v_period: float | None

    def __init__(
        self,
        f: Callable[..., Any] | Sequence[str],
        *,
        parameters: Mapping[str, float] | None = None,
        size: float = 1.0,
        u_range: tuple[float, float] | None = None,
        v_range: tuple[float, float] | None = None,
        u_period: float | None = None,
        v_period: float | None = None,
        inside: bool = False,
    ) -> None:
        _set(self, inside=inside)
        self.__post_init__()
        variables = {"u": SX.sym("u"), "v": SX.sym("v")}
        formula = _formula(self._kind, f, variables, list(variables.values()), parameters, 3)
        _set(self, formula=formula, size=_positive(self, "size", size))
        for name, given, period in (("u", u_range, u_period), ("v", v_range, v_period)):
            if period is not None:
                period = _positive(self, f"{name}_period", period)
            reach = math.pi if period is None else period / 2
            span = _range(self._kind, f"{name}_range", (-reach, reach) if given is None else given)
            _set(self, **{f"{name}_range": span, f"{name}_period": period})

    @property
    def chart(self) -> type[Chart]:
        return FreeChart

    @property
    def f(self) -> tuple[str, ...] | None:
        """The three texts of the chart; None where it was given as a function."""
        return self.formula.text

    @property
    def parameters(self) -> tuple[float, ...]:
        return self.formula.values

    def periods(self) -> Periods:
        return (self.u_period, self.v_period)

    def implicit_expr(self, p: SX, x: SX) -> None:
        return None

    def coordinates_expr(self, p: SX, x: SX) -> None:
        return None

    def frame_expr(self, p: SX, x: SX) -> None:
        return None

    def _outward_chart(self, p: SX, u: SX, v: SX) -> SX:
        return self.formula(p, u, v)

    def _wrap(self, u: Array, v: Array) -> tuple[Array, Array]:
        return (
            _into(u, self.u_range, self.u_period),
            _into(v, self.v_range, self.v_period),
        )

    def coordinates(
        self, x: ArrayLike, guess: tuple[ArrayLike, ArrayLike] | None = None
    ) -> tuple[Array, Array]:
        """Return (u, v) of points (..., 3) by Gauss-Newton on the distance to the surface.

        Parameters
        ----------
        x : array-like (..., 3)
            Points on the surface, m.
        guess : pair of array-likes (...), optional
            Where to start; otherwise the nearest of a grid over u_range and v_range.

        Raises
        ------
        SurfaceError
            No point of the surface is found within 1e-9 of the size.
        """
        points = self._points(x)
        flat = points.reshape(-1, 3)
        if guess is None:
            starts = self._grid_starts(flat)
        else:
            given = np.broadcast_arrays(points[..., 0], *map(np.asarray, guess))[1:]
            starts = [tuple(np.array(w, dtype=float).ravel() for w in given)]
        u, v = (w.copy() for w in starts[0])
        miss = np.full(len(flat), np.inf)
        # ~(a <= b) rather than a > b: a descent that ends in NaN has missed as well.
        missed = ~(miss <= 1e-9 * self.size)
        for start_u, start_v in starts:
            u[missed], v[missed], miss[missed] = self._descend(
                flat[missed], start_u[missed], start_v[missed]
            )
            missed = ~(miss <= 1e-9 * np.fmax(self.size, np.linalg.norm(flat, axis=1)))
            if not np.any(missed):
                break
        else:
            i = int(np.argmax(missed))
            raise SurfaceError(
                f"{self!r}: no (u, v) found for the point {flat[i].tolist()}, nearest miss "
                f"{miss[i]:.3g} m; check that it lies on the surface, or give guess=(u, v), or "
                f"u_range (now {self.u_range}) and v_range (now {self.v_range})"
            )
        u, v = self._wrap(u, v)
        return u.reshape(points.shape[:-1]), v.reshape(points.shape[:-1])

    def _grid_starts(self, flat: Array, cells: int = 32, tries: int = 4) -> list[tuple[Any, ...]]:
        """Return the nearest few grid points to each of (n, 3) points, nearest first."""
        # Centres of cells, because the rim of a range is where charts have their poles.
        fraction = (np.arange(cells) + 0.5) / cells
        spans = (self.u_range, self.v_range)
        axes = [lo + (hi - lo) * fraction for lo, hi in spans]
        grid_u, grid_v = (w.ravel() for w in np.meshgrid(*axes, indexing="ij"))
        if self.inside:
            grid_v = -grid_v
        grid = self.point(grid_u, grid_v)
        nearest = np.empty((len(flat), tries), dtype=int)
        for i, target in enumerate(flat):
            distance = np.sum((grid - target) ** 2, axis=1)
            distance[np.isnan(distance)] = np.inf
            nearest[i] = np.argsort(distance)[:tries]
        return [(grid_u[k], grid_v[k]) for k in nearest.T]

    def _descend(self, target: Array, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Gauss-Newton with step halving; returns u, v and the distance left, each (n,)."""
        offset = target - self.point(u, v)
        miss = np.linalg.norm(offset, axis=1)
        pace = np.ones(len(u))
        for _ in range(60):
            tangents = self.frame(u, v)[..., :2]
            ahead = np.einsum("nik,ni->nk", tangents, offset)
            if np.all(np.abs(ahead) <= np.finfo(float).eps * self.size):
                break
            m = self.metric_root(u, v)
            step_v = ahead[:, 1] / m[:, 1, 1]
            step_u = (ahead[:, 0] - m[:, 0, 1] * step_v) / m[:, 0, 0]
            trial_u, trial_v = u + pace * step_u, v + pace * step_v
            trial_offset = target - self.point(trial_u, trial_v)
            trial_miss = np.linalg.norm(trial_offset, axis=1)
            better = trial_miss < miss
            u, v = np.where(better, trial_u, u), np.where(better, trial_v, v)
            offset = np.where(better[:, None], trial_offset, offset)
            miss = np.where(better, trial_miss, miss)
            pace = np.where(better, 1.0, pace / 2)
            if np.all(pace < 1e-6):
                break
        return u, v, miss


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ImplicitSurface(UserSurface):
    """The surface F(x) = 0 of a body F < 0 that is star-shaped about a centre.

    Coordinates are the polar angle u from the z direction and the azimuth v of the ray from the
    centre: the inverse chart is explicit, the chart itself is solved along the ray. Equations
    that need an explicit chart are refused (`has_chart` is False); motion is planned in ambient
    form.

    Parameters
    ----------
    F : callable or text
        ``F(x)`` or ``F(x, **parameters)`` of a symbolic 3-vector, or a text in x, y, z such as
        ``"x**2/a**2 + y**2 + z**4 - 1"``. Negative inside the body.
    center : three floats
        A point inside (with ``inside=True``, inside the hollow) that sees the whole surface, m.
    parameters : mapping of str to float, optional
        Named numbers of the formula; changing them needs no new kernel.
    size : float
        Length scale of the surface, m.
    inside : bool
        The body is where F > 0.
    """

    has_chart: ClassVar[bool] = False
    ambient: ClassVar[bool] = True
    center: tuple[float, float, float]

    def __init__(
        self,
        F: Callable[..., Any] | str,
        *,
        center: Sequence[float] = (0.0, 0.0, 0.0),
        parameters: Mapping[str, float] | None = None,
        size: float = 1.0,
        inside: bool = False,
    ) -> None:
        _set(self, inside=inside)
        self.__post_init__()
        x = SX.sym("x", 3)
        variables = {"x": x[0], "y": x[1], "z": x[2]}
        formula = _formula(self._kind, F, variables, [x], parameters, 1)
        _set(self, formula=formula, size=_positive(self, "size", size))
        _set(self, center=_numbers(self._kind, "center", center, 3))

    @property
    def chart(self) -> type[Chart]:
        return CentralChart

    @property
    def F(self) -> str | None:
        """The text of the level function; None where it was given as a function."""
        return None if self.formula.text is None else self.formula.text[0]

    @property
    def parameters(self) -> tuple[float, ...]:
        """The centre, then the formula's numbers in order of their names."""
        return (*self.center, *self.formula.values)

    def chart_expr(self, p: SX, u: SX, v: SX) -> SX:
        raise SurfaceError(
            f"{self!r} has no explicit chart f(u, v), which was asked for; plan it in ambient form "
            "(the default), or write it as a ParametricSurface"
        )

    def frame_expr(self, p: SX, x: SX) -> Frame:
        return contact_frame(*self._tangents(p, x))

    def _tangents(self, p: SX, x: SX) -> Pair:
        """Return (f_u, f_v) of the central projection as fields of the point x."""
        ray = x - p[:3]
        rho, s = ca.norm_2(ray), _hypot(ray[0], ray[1])
        direction = ray / rho
        d_u = ca.vertcat(ray[0] * ray[2] / s, ray[1] * ray[2] / s, -s) / rho
        d_v = ca.vertcat(-ray[1], ray[0], 0) / rho
        gradient = ca.gradient(self._level(p, x), x)
        along = ca.dot(gradient, direction)

        def tangent(turned: SX) -> SX:
            """rho d turned, plus what keeps the point on the surface: grad F . f_u = 0."""
            return rho * (turned - ca.dot(gradient, turned) / along * direction)

        return tangent(d_u), tangent(-d_v if self.inside else d_v)

    def _level(self, p: SX, x: SX) -> SX:
        return self.formula(p[3:], x)

    def _geometry(self, p: SX) -> tuple[tuple[SX, ...], ChartGeometry]:
        x = SX.sym("x", 3)
        f_u, f_v = self._tangents(p, x)
        along_u = ca.jacobian(f_u, x)
        f_vv = ca.jacobian(f_v, x) @ f_v
        return (x,), tangent_geometry(x, f_u, f_v, along_u @ f_u, along_u @ f_v, f_vv)

    def _arguments(self, u: Array, v: Array) -> tuple[Array, ...]:
        return (self.point(u, v).T,)

    def point(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the point where the ray (u, v) leaves the body, shape (..., 3), m.

        Newton's method along the ray, kept inside a bracket by bisection. A ray that leaves the
        body more than once, from a badly chosen centre, ends at any one of these points.

        Raises
        ------
        SurfaceError
            The centre is not inside, or the ray does not meet the surface.
        """
        u, v = self._finite(u, v)
        turned = -v if self.inside else v
        ray = np.stack(
            [np.sin(u) * np.cos(turned), np.sin(u) * np.sin(turned), np.cos(u)], axis=-1
        ).reshape(-1, 3)
        reach = self._bracket(ray, u.ravel(), v.ravel())
        low, t = np.zeros_like(reach), reach
        for _ in range(100):
            level, slope = self._along(ray, t)
            low, reach = np.where(level < 0, t, low), np.where(level >= 0, t, reach)
            with np.errstate(divide="ignore", invalid="ignore"):
                trial = t - level / slope
            trial = np.where((trial >= low) & (trial <= reach), trial, (low + reach) / 2)
            settled = np.all(np.abs(trial - t) <= 4 * np.finfo(float).eps * t)
            t = trial
            if settled:
                break
        return (np.array(self.center) + t[:, None] * ray).reshape((*u.shape, 3))

    def _bracket(self, ray: Array, u: Array, v: Array) -> Array:
        """Return for each ray a distance beyond the surface."""
        level, _ = self._along(ray, np.zeros(len(ray)))
        if np.any(~(level < 0)):
            raise SurfaceError(
                f"{self!r}: F = {level[0]} at center = {self.center}; F must be negative there: "
                "choose a center inside, or change the sign of F (and inside, if need be)"
            )
        reach = np.full(len(ray), self.size)
        for _ in range(40):
            within = ~(self._along(ray, reach)[0] > 0)
            if not np.any(within):
                return reach
            reach = np.where(within, 2 * reach, reach)
        i = int(np.argmax(within))
        raise SurfaceError(
            f"{self!r}: the ray (u, v) = ({u[i]}, {v[i]}) from center = {self.center} does not "
            f"meet the surface within {reach[i]:.3g} m; choose another center or point"
        )

    def _along(self, ray: Array, t: Array) -> tuple[Array, Array]:
        """Return F and its slope at distances t along the rays, each (n,)."""
        columns = self._call("ray", (np.array(self.center) + t[:, None] * ray).T, ray.T)
        return columns[0], columns[1]

    def _build(self, name: str) -> ca.Function:
        if name != "ray":
            return super()._build(name)
        p, x, ray = SX.sym("p", len(self.parameters)), SX.sym("x", 3), SX.sym("d", 3)
        level = self._level(p, x)
        slope = ca.dot(ca.gradient(level, x), ray)
        return ca.Function(name, [p, x, ray], [ca.vertcat(level, slope)])


# --------------------------------------------------------------------------- helpers


def _hypot(a: SX | float, b: SX | float) -> SX:
    return ca.sqrt(a * a + b * b)


def _diag(a: SX | float, b: SX | float) -> SX:
    return ca.diag(ca.vertcat(a, b))


def _wrap(angle: Array) -> Array:
    """Return the angle in (-pi, pi], untouched where it is there already."""
    turned = angle - TURN * np.ceil((angle - math.pi) / TURN)
    return np.where((angle > -math.pi) & (angle <= math.pi), angle, turned)


def _nearest(angle: Array, reference: Array, period: float | None) -> Array:
    if period is None:
        return angle
    return angle + period * np.round((reference - angle) / period)


def _unwrap(angle: Array, period: float | None) -> Array:
    if period is None or len(angle) < 2:
        return angle
    turns = np.cumsum(np.round(np.diff(angle, axis=0) / period), axis=0)
    return np.concatenate([angle[:1], angle[1:] - period * turns])


def _set(surface: Surface, **values: Any) -> None:
    """Store checked values in a frozen dataclass that is still being made."""
    for name, value in values.items():
        object.__setattr__(surface, name, value)


def _number(kind: str, name: str, value: Any) -> float:
    try:
        if isinstance(value, (str, bool, np.bool_)):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise SurfaceError(f"{kind}: {name} = {value!r} must be a number") from None
    if not math.isfinite(number):
        raise SurfaceError(f"{kind}: {name} = {value!r} must be finite")
    return number


def _positive(surface: Surface, name: str, value: Any) -> float:
    kind = type(surface).__name__
    number = _number(kind, name, value)
    if number <= 0:
        raise SurfaceError(
            f"{kind}: {name} = {value!r} must be a positive length in metres; for a concave "
            "surface give the length positive and inside=True"
        )
    return number


def _ellipsoid_chart(a: float, b: float, c: float) -> tuple[type[Chart], tuple[float, ...]]:
    """Return the chart that is regular for a >= b >= c, and the numbers it takes."""
    if a == b == c:
        return PolarChart, (a,)
    if a == b:
        return OblateChart, (a, c)
    if b == c:
        return ProlateChart, (a, b)
    return JacobiChart, (a, b, c)


def _symmetric(given: Any) -> Array:
    try:
        matrix = np.array(given, dtype=float)
    except (TypeError, ValueError):
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
    "+++": _ellipsoid_chart,
    "++-": lambda a, b, c: (OneSheetChart, (a, b, c)),
    "+--": lambda a, b, c: (TwoSheetChart, (a, b, c)),
    "++0": lambda a, b, c: (
        (RoundCylinderChart, (a,)) if a == b else (EllipticCylinderChart, (a, b))
    ),
    "+-0": lambda a, b, c: (HyperbolicCylinderChart, (a, b)),
    "+00": lambda a, b, c: (OffsetPlaneChart, (a,)),
}


def _into(w: Array, span: tuple[float, float], period: float | None) -> Array:
    """Return a periodic coordinate within one period of its range's start, where it is out."""
    if period is None:
        return w
    inside = (w >= span[0]) & (w <= span[1])
    return np.where(inside, w, w - period * np.floor((w - span[0]) / period))


def _numbers(kind: str, name: str, given: Any, count: int) -> tuple[Any, ...]:
    try:
        values = tuple(given)
    except TypeError:
        values = ()
    if len(values) != count or isinstance(given, str):
        raise SurfaceError(f"{kind}: {name} = {given!r} must be {count} numbers")
    return tuple(_number(kind, f"{name}[{i}]", value) for i, value in enumerate(values))


def _range(kind: str, name: str, given: Any) -> tuple[float, float]:
    low, high = _numbers(kind, name, given, 2)
    if not low < high:
        raise SurfaceError(f"{kind}: {name} = {given!r} must run from a lesser to a greater number")
    return low, high


def _named(kind: str, given: Any, variables: Mapping[str, SX]) -> dict[str, float]:
    """Return named parameters in order of their names."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise SurfaceError(f'{kind}: parameters = {given!r} must be a table such as {{"R": 0.1}}')
    for name in given:
        if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
            raise SurfaceError(f"{kind}: parameter name {name!r} must be a plain word")
        if name in variables or name in FUNCTIONS:
            raise SurfaceError(
                f"{kind}: parameter name {name!r} already has a meaning in formulas; use another"
            )
    return {name: _number(kind, f"parameters[{name!r}]", given[name]) for name in sorted(given)}


def _formula(
    kind: str,
    given: Any,
    variables: Mapping[str, SX],
    arguments: list[SX],
    parameters: Any,
    count: int,
) -> Formula:
    """Turn a user's function or text into a checked `Formula` with ``count`` components."""
    numbers = _named(kind, parameters, variables)
    p = SX.sym("p", len(numbers))
    symbols = {name: p[i] for i, name in enumerate(numbers)}
    text = None
    if callable(given):
        value = _trace(kind, given, arguments, symbols, count)
    else:
        text = _texts(kind, given, count)
        try:
            value = ca.vertcat(*(parse(line, {**variables, **symbols}) for line in text))
        except ContactSystemError as error:
            raise SurfaceError(f"{kind}: {error}") from None
    for argument in arguments:
        if not ca.depends_on(value, argument):
            raise SurfaceError(
                f"{kind}: the formula does not depend on {argument}, as a surface must"
            )
    function = ca.Function("surface", [p, *arguments], [value])
    for i in range(function.n_instructions()):
        is_constant = function.instruction_id(i) == ca.OP_CONST
        if is_constant and not math.isfinite(function.instruction_constant(i)):
            raise SurfaceError(
                f"{kind}: the formula holds a NaN or infinite constant; in a function of symbols "
                "use numpy or casadi functions (np.cos), not those of math"
            )
    return Formula(function.serialize(), tuple(numbers), tuple(numbers.values()), text)


def _texts(kind: str, given: Any, count: int) -> tuple[str, ...]:
    lines = (given,) if isinstance(given, str) else given
    if not isinstance(lines, Sequence) or len(lines) != count:
        raise SurfaceError(
            f"{kind}: {given!r} must be a function of symbols, or {count} text(s), one for each "
            "component"
        )
    return tuple(lines)


def _trace(
    kind: str, function: Callable[..., Any], arguments: list[SX], symbols: dict[str, SX], count: int
) -> SX:
    """Call a user's function on symbols and return its components as one column."""
    try:
        with warnings.catch_warnings():
            # CasADi announces a coming change of what numpy functions of symbols return.
            warnings.simplefilter("ignore", FutureWarning)
            value = function(*arguments, **symbols)
            column = ca.vertcat(*(ca.vec(SX(part)) for part in _parts(value)))
    except Exception as error:  # whatever a user's function may raise
        raise SurfaceError(
            f"{kind}: the function fails on symbols ({type(error).__name__}: {error}); use numpy "
            "or casadi functions, no if and no conversion to float, and take the parameters "
            f"{list(symbols)} by name"
        ) from error
    if column.shape != (count, 1):
        raise SurfaceError(
            f"{kind}: the function returns {column.numel()} component(s); it must return {count}"
        )
    return column


def _parts(value: Any) -> list[Any]:
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    return list(value) if isinstance(value, (list, tuple)) else [value]
