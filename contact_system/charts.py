r"""Charts: coordinates (u, v) on the families of surfaces that bodies have.

Each chart is a small stateless class: the point of a pair of coordinates, the coordinates and the
contact frame of a point, and which part of the plane is the principal one. Every chart is
right-handed, ``f_u x f_v`` along the normal out of the body. `contact_system.surfaces` joins charts
to numbers; a new surface of a known family needs none of its own.

SI units, radians. Sources: Kumar & Mukherjee (eq. ``ellipsoid`` and text); the ellipsoid's inverse
chart is the one of sphero-conal coordinates, see `JacobiChart`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .geometry import contact_frame

SX = ca.SX
Array = NDArray[np.float64]
Pair = tuple[SX, SX]
Frame = tuple[SX, SX, SX]
Periods = tuple[float | None, float | None]
Angle = Any  # a float or an array of them
Numbers = Sequence[float]

TURN = 2.0 * math.pi
# Keeps 1/0 and 0/0 out of what is not used or has a zero above; far below any real length ratio.
TINY = 1e-300


def hypot(a: SX | float, b: SX | float) -> SX:
    """Return sqrt(a^2 + b^2)."""
    return ca.sqrt(a * a + b * b)


def diagonal(a: SX | float, b: SX | float) -> SX:
    """Return the matrix diag(a, b)."""
    return ca.diag(ca.vertcat(a, b))


def choose(condition: Any, a: Any, b: Any) -> Any:
    """Return a where the condition holds, else b; of one number as of arrays."""
    return np.where(condition, a, b) if isinstance(condition, np.ndarray) else a if condition else b


def sine(angle: Angle) -> Angle:
    """Return the sine of one number as of arrays; numpy's of one costs ten times as much."""
    return np.sin(angle) if isinstance(angle, np.ndarray) else math.sin(angle)


def cosine(angle: Angle) -> Angle:
    return np.cos(angle) if isinstance(angle, np.ndarray) else math.cos(angle)


def fold_latitude(v: Angle) -> tuple[Angle, Any]:
    """Return v in [-pi/2, pi/2], the angle with the same sine, and where it had to be folded."""
    v = wrap_angle(v)
    beyond = abs(v) > math.pi / 2
    return choose(beyond, choose(v > 0, math.pi, -math.pi) - v, v), beyond


def wrap_angle(angle: Angle) -> Angle:
    """Return the angle in (-pi, pi], untouched where it is there already."""
    in_range = (angle > -math.pi) & (angle <= math.pi)  # a bool or an array of them
    if in_range is True:  # one number, as contacts mostly have
        return angle
    ceil = np.ceil if isinstance(angle, np.ndarray) else math.ceil
    return choose(in_range, angle, angle - TURN * ceil((angle - math.pi) / TURN))


class Chart:
    """One way to lay coordinates on a family of surfaces. Stateless; ``p`` holds its numbers.

    Class attributes: `orthogonal` (``f_u . f_v = 0`` identically), `periods` of u and v in radians
    or None, `double_cover` ((-u, pi - v) is the same point as (u, v), with both frame axes turned
    by pi), `developable` (T = 0 and constant Lame coefficients), `great_circles` (geodesics are
    great circles), `turning` (0 or 1: the coordinate that only turns the surface about its axis;
    such a chart has `lame`), `singular_at` (where the frame is lost, for messages), `ranges` of the
    principal branch.
    """

    orthogonal: ClassVar[bool] = False
    periods: ClassVar[Periods] = (None, None)
    double_cover: ClassVar[bool] = False
    developable: ClassVar[bool] = False
    great_circles: ClassVar[bool] = False
    turning: ClassVar[int | None] = None
    singular_at: ClassVar[str] = ""
    ranges: ClassVar[str] = "u and v any real number"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        """Return f(u, v), (3, 1), m."""
        raise NotImplementedError

    @staticmethod
    def lame(p: SX, u: SX, v: SX) -> Pair:
        """Return |f_u|, |f_v|, m, of a chart that is `turning`, without that angle.

        Beyond a pole the one that vanishes there is negative.
        """
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
    def wrap(u: Angle, v: Angle) -> tuple[Angle, Angle]:
        """Return the same point in the principal range; what is in range stays bit for bit."""
        return u, v

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        """Return what no diagonal entry of the metric root is below, m; 0 where none is known.

        It costs a sine where the entries themselves cost a kernel, and so tells cheaply that a
        point is regular.
        """
        return 0.0


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

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return 1.0


class PolarChart(Chart):
    """r (sin u cos v, sin u sin v, cos u): the sphere, p = (r,)."""

    orthogonal = True
    turning = 1
    periods = (None, TURN)
    great_circles = True
    singular_at = "a pole (u = 0 or pi)"
    ranges = "0 < u < pi, -pi < v <= pi"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        rho = p[0] * ca.sin(u)
        return ca.vertcat(rho * ca.cos(v), rho * ca.sin(v), p[0] * ca.cos(u))

    @staticmethod
    def lame(p: SX, u: SX, v: SX) -> Pair:
        return p[0], p[0] * ca.sin(u)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(hypot(x[0], x[1]), x[2]), ca.atan2(x[1], x[0])

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        r, rho = p[0], hypot(x[0], x[1])
        cos_v, sin_v, cos_u = x[0] / rho, x[1] / rho, x[2] / r
        x_axis = ca.vertcat(cos_u * cos_v, cos_u * sin_v, -rho / r)
        return x_axis, ca.vertcat(-sin_v, cos_v, 0), diagonal(r, rho)

    @staticmethod
    def wrap(u: Angle, v: Angle) -> tuple[Angle, Angle]:
        u = wrap_angle(u)
        # (-u, v) is the point (u, v + pi), but there f_u x f_v points into the body.
        return abs(u), wrap_angle(choose(u < 0, v + math.pi, v))

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return p[0] * abs(sine(u))


class RoundCylinderChart(Chart):
    """(r cos u, r sin u, v): the circular cylinder, p = (r,)."""

    orthogonal = True
    turning = 0
    periods = (TURN, None)
    developable = True
    ranges = "-pi < u <= pi, v any"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        return ca.vertcat(p[0] * ca.cos(u), p[0] * ca.sin(u), v)

    @staticmethod
    def lame(p: SX, u: SX, v: SX) -> Pair:
        return p[0], SX(1)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(x[1], x[0]), x[2]

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        return ca.vertcat(-x[1] / p[0], x[0] / p[0], 0), SX([0, 0, 1]), diagonal(p[0], 1)

    @staticmethod
    def wrap(u: Angle, v: Angle) -> tuple[Angle, Angle]:
        return wrap_angle(u), v

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return min(p[0], 1.0)


class TorusChart(Chart):
    """((R + r cos v) cos u, (R + r cos v) sin u, r sin v), p = (R, r); regular everywhere."""

    orthogonal = True
    turning = 0
    periods = (TURN, TURN)
    ranges = "-pi < u, v <= pi"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        rho = p[0] + p[1] * ca.cos(v)
        return ca.vertcat(rho * ca.cos(u), rho * ca.sin(u), p[1] * ca.sin(v))

    @staticmethod
    def lame(p: SX, u: SX, v: SX) -> Pair:
        return p[0] + p[1] * ca.cos(v), p[1]

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(x[1], x[0]), ca.atan2(x[2], hypot(x[0], x[1]) - p[0])

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        rho = hypot(x[0], x[1])
        cos_u, sin_u = x[0] / rho, x[1] / rho
        cos_v, sin_v = (rho - p[0]) / p[1], x[2] / p[1]
        y_axis = ca.vertcat(-sin_v * cos_u, -sin_v * sin_u, cos_v)
        return ca.vertcat(-sin_u, cos_u, 0), y_axis, diagonal(rho, p[1])

    @staticmethod
    def wrap(u: Angle, v: Angle) -> tuple[Angle, Angle]:
        return wrap_angle(u), wrap_angle(v)

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return min(p[0] - p[1], p[1])


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
    def moduli(p: SX | Numbers) -> tuple[Any, Any]:
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
    def circular(p: SX, x: SX) -> tuple[SX, ...]:
        r"""Return (sin u, cos u, sin v, cos v), cos v >= 0, and k'^2 sin^2 u + k^2 cos^2 v,
        sqrt(k^2 + k'^2 sin^2 u), sqrt(k'^2 + k^2 cos^2 v).

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
        total = hypot(difference, 2 * half_product)
        greater = ca.sqrt((ca.fabs(difference) + total) / 2)
        # At an umbilic both vanish; where their squares underflow the quotient alone would not.
        smaller = ca.fmin(half_product / ca.fmax(greater, TINY), greater)
        alpha_leads = difference >= 0
        root_alpha = ca.if_else(alpha_leads, greater, smaller)
        root_beta = ca.if_else(alpha_leads, smaller, greater)
        root_u, root_v = ca.sqrt(k2 + root_alpha**2), ca.sqrt(l2 + root_beta**2)
        sin_u, cos_u = ca.copysign(root_alpha / l1, ys), xs / root_v
        return sin_u, cos_u, zs / root_u, root_beta / k, total, root_u, root_v

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        sin_u, cos_u, sin_v, cos_v, *_ = JacobiChart.circular(p, x)
        return ca.atan2(sin_u, cos_u), ca.atan2(sin_v, cos_v)

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        a, b, c = p[0], p[1], p[2]
        k2, l2 = JacobiChart.moduli(p)
        sin_u, cos_u, sin_v, cos_v, total, root_u, root_v = JacobiChart.circular(p, x)
        # h_u^2 = (k'^2 sin^2 u + k^2 cos^2 v)(a^2 sin^2 u + b^2 cos^2 u)/(k^2 + k'^2 sin^2 u).
        h_u = ca.sqrt(total * ((a * sin_u) ** 2 + (b * cos_u) ** 2)) / root_u
        h_v = ca.sqrt(total * ((b * sin_v) ** 2 + (c * cos_v) ** 2)) / root_v
        f_u = ca.vertcat(
            -a * sin_u * root_v, b * cos_u * cos_v, c * sin_v * l2 * sin_u * cos_u / root_u
        )
        f_v = ca.vertcat(
            -a * cos_u * k2 * cos_v * sin_v / root_v, -b * sin_u * sin_v, c * cos_v * root_u
        )
        return f_u / h_u, f_v / h_v, diagonal(h_u, h_v)

    @staticmethod
    def wrap(u: Angle, v: Angle) -> tuple[Angle, Angle]:
        v, beyond = fold_latitude(v)
        return wrap_angle(choose(beyond, -u, u)), v

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        # h_u >= b sqrt(total) and h_v >= c sqrt(total), see `frame`.
        k2, l2 = JacobiChart.moduli(p)
        return p[2] * (l2 * sine(u) ** 2 + k2 * cosine(v) ** 2) ** 0.5


class OblateChart(Chart):
    """(a cos u cos v, a sin u cos v, c sin v): Jacobi's chart in the limit a = b, p = (a, c)."""

    orthogonal = True
    turning = 0
    periods = (TURN, None)
    singular_at = "a pole (v = +-pi/2)"
    ranges = "-pi < u <= pi, -pi/2 < v < pi/2"

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        rho = p[0] * ca.cos(v)
        return ca.vertcat(rho * ca.cos(u), rho * ca.sin(u), p[1] * ca.sin(v))

    @staticmethod
    def lame(p: SX, u: SX, v: SX) -> Pair:
        return p[0] * ca.cos(v), hypot(p[0] * ca.sin(v), p[1] * ca.cos(v))

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(x[1], x[0]), ca.atan2(x[2] / p[1], hypot(x[0], x[1]) / p[0])

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        rho = hypot(x[0], x[1])
        cos_u, sin_u = x[0] / rho, x[1] / rho
        outward, upward = -p[0] * x[2] / p[1], p[1] * rho / p[0]
        h_v = hypot(outward, upward)
        y_axis = ca.vertcat(outward * cos_u, outward * sin_u, upward) / h_v
        return ca.vertcat(-sin_u, cos_u, 0), y_axis, diagonal(rho, h_v)

    @staticmethod
    def wrap(u: Angle, v: Angle) -> tuple[Angle, Angle]:
        v, beyond = fold_latitude(v)
        return wrap_angle(choose(beyond, u + math.pi, u)), v

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return p[1] * abs(cosine(v))  # h_u = a |cos v|, h_v >= c


class ProlateChart(Chart):
    """(a cos u, b sin u cos v, b sin u sin v): Jacobi's chart in the limit b = c, p = (a, b)."""

    orthogonal = True
    turning = 1
    periods = (None, TURN)
    singular_at = "a pole (u = 0 or pi)"
    ranges = "0 < u < pi, -pi < v <= pi"
    wrap = PolarChart.wrap

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        rho = p[1] * ca.sin(u)
        return ca.vertcat(p[0] * ca.cos(u), rho * ca.cos(v), rho * ca.sin(v))

    @staticmethod
    def lame(p: SX, u: SX, v: SX) -> Pair:
        return hypot(p[0] * ca.sin(u), p[1] * ca.cos(u)), p[1] * ca.sin(u)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return ca.atan2(hypot(x[1], x[2]) / p[1], x[0] / p[0]), ca.atan2(x[2], x[1])

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        rho = hypot(x[1], x[2])
        cos_v, sin_v = x[1] / rho, x[2] / rho
        axial, radial = -p[0] * rho / p[1], p[1] * x[0] / p[0]
        h_u = hypot(axial, radial)
        x_axis = ca.vertcat(axial, radial * cos_v, radial * sin_v) / h_u
        return x_axis, ca.vertcat(0, -sin_v, cos_v), diagonal(h_u, rho)

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return p[1] * abs(sine(u))  # h_v = b |sin u|, h_u >= b


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
        swell = hypot(1, slope)
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
        h_u = hypot(f_u[0], f_u[1])
        return f_u / h_u, SX([0, 0, 1]), diagonal(h_u, 1)

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return min(p[1], 1.0)  # h_u >= b, as a >= b


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
        f_u = ca.vertcat(p[0] * u / hypot(1, u), p[1], 0)
        h_u = hypot(f_u[0], f_u[1])
        return f_u / h_u, SX([0, 0, 1]), diagonal(h_u, 1)

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return min(p[1], 1.0)  # h_u >= b


class OffsetPlaneChart(FlatChart):
    """(a, u, v): the plane at distance a from the origin, p = (a,)."""

    @staticmethod
    def point(p: SX, u: SX, v: SX) -> SX:
        return ca.vertcat(p[0], u, v)

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return x[1], x[2]

    @staticmethod
    def frame(p: SX, x: SX) -> Frame:
        return SX([0, 1, 0]), SX([0, 0, 1]), SX.eye(2)


class FreeChart(Chart):
    """A chart written by the user; nothing is known about it in advance."""

    ranges = "as given by u_range and v_range"


class CentralChart(Chart):
    """Polar angle u from +z and azimuth v of the ray from a centre; p starts with the centre."""

    periods = (None, TURN)
    singular_at = "a pole (u = 0 or pi), or out of the centre's sight"
    ranges = PolarChart.ranges
    wrap = PolarChart.wrap

    @staticmethod
    def coordinates(p: SX, x: SX) -> Pair:
        return PolarChart.coordinates(p, x - p[:3])
