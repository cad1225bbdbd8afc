"""Ellipsoids: Jacobi's chart and its limits for equal axes.

Sources: Kumar & Mukherjee (eq. ``ellipsoid`` and text); the inverse chart is that of sphero-conal
coordinates, see `JacobiChart`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from ..caching import cached_property
from ..errors import SurfaceError
from ..theory import symbols as ca
from ..theory.geometry import contact_frame
from .base import OfLengths
from .charts import TINY, TURN, Angle, Chart, Frame, Pair, choose, fold_latitude, wrap_angle
from .sphere import PolarChart

THINNEST = 1e-6
"""Least allowed c/a. The rim then has the radius of curvature c^2/a = 1e-12 a, as small as the
default tolerance. Below c/a = 1e-4 most paths over the rim are refused; at c/a = 1e-12 rounding of
x would make results wrong without notice."""


class JacobiChart(Chart):
    r"""Jacobi's ellipsoidal coordinates, eq. ``ellipsoid``, a > b > c, p = (a, b, c).

    With :math:`k^2 = (b^2-c^2)/(a^2-c^2)` and :math:`k'^2 = (a^2-b^2)/(a^2-c^2) = 1 - k^2`,

    .. math:: f = (a \cos u \sqrt{k'^2 + k^2\cos^2 v},\; b \sin u \cos v,\;
                   c \sin v \sqrt{k^2 + k'^2 \sin^2 u}),

    which is the paper's chart with its differences of squares factored, to avoid cancellation for
    nearly equal axes. Coordinate lines are lines of curvature. The four umbilics are at
    v = +-pi/2, u = 0 and pi; elsewhere v = +-pi/2 is regular. (u, v) and (-u, pi - v) are the same
    point.
    """

    orthogonal = True
    central = True
    periods = (TURN, TURN)
    double_cover = True
    singular_at = "an umbilic (v = +-pi/2 with u = 0 or pi)"

    def __init__(self, p: Any):
        self.a, self.b, self.c = a, b, c = p[0], p[1], p[2]
        whole = (a - c) * (a + c)  # the differences of nearly equal axes are exact
        self.k2, self.l2 = (b - c) * (b + c) / whole, (a - b) * (a + b) / whole

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        sin_u, cos_v = ca.sin(u), ca.cos(v)
        return ca.vertcat(
            self.a * ca.cos(u) * ca.sqrt(self.l2 + self.k2 * cos_v**2),
            self.b * sin_u * cos_v,
            self.c * ca.sin(v) * ca.sqrt(self.k2 + self.l2 * sin_u**2),
        )

    def circular(self, x: ca.SX) -> tuple[ca.SX, ...]:
        r"""Return sin u, cos u, sin v, cos v >= 0, sqrt(k^2 + k'^2 sin^2 u) and
        sqrt(k'^2 + k^2 cos^2 v).

        (X, Y, Z) = (x/a, y/b, z/c) is a point of the unit sphere in sphero-conal coordinates.
        alpha = k'^2 sin^2 u and beta = k^2 cos^2 v have the difference
        D = Z^2 - k^2 + k'^2 Y^2 = k'^2 - X^2 - k^2 Y^2 and the product (k k' Y)^2: the greater
        follows from a sum, the smaller from the product, and neither loses digits. Of the two
        forms of D the one with the smaller terms is exact where D is small: near the umbilics,
        which crowd at the x or the z axis as the ellipsoid nears one of revolution.
        """
        k2, l2 = self.k2, self.l2
        k, l1 = ca.sqrt(k2), ca.sqrt(l2)
        xs, ys, zs = x[0] / self.a, x[1] / self.b, x[2] / self.c
        from_z = (ca.fabs(zs) - k) * (ca.fabs(zs) + k) + l2 * ys**2
        from_x = (l1 - ca.fabs(xs)) * (l1 + ca.fabs(xs)) - k2 * ys**2
        difference = ca.if_else(k2 < l2, from_z, from_x)
        half_product = k * l1 * ca.fabs(ys)
        total = ca.hypot(difference, 2 * half_product)
        greater = ca.sqrt((ca.fabs(difference) + total) / 2)
        # Both vanish at an umbilic. If squares underflow, the minimum keeps the root <= `greater`.
        smaller = ca.fmin(half_product / ca.fmax(greater, TINY), greater)
        alpha_leads = difference >= 0
        root_alpha = ca.if_else(alpha_leads, greater, smaller)
        root_beta = ca.if_else(alpha_leads, smaller, greater)
        root_u, root_v = ca.sqrt(k2 + root_alpha**2), ca.sqrt(l2 + root_beta**2)
        sin_u, cos_u = ca.copysign(root_alpha / l1, ys), xs / root_v
        return sin_u, cos_u, zs / root_u, root_beta / k, root_u, root_v

    def coordinates(self, x: ca.SX) -> Pair:
        sin_u, cos_u, sin_v, cos_v, *_ = self.circular(x)
        return ca.atan2(sin_u, cos_u), ca.atan2(sin_v, cos_v)

    def frame(self, x: ca.SX) -> Frame:
        a, b, c = self.a, self.b, self.c
        sin_u, cos_u, sin_v, cos_v, root_u, root_v = self.circular(x)
        f_u = ca.vertcat(
            -a * sin_u * root_v, b * cos_u * cos_v, c * sin_v * self.l2 * sin_u * cos_u / root_u
        )
        f_v = ca.vertcat(
            -a * cos_u * self.k2 * cos_v * sin_v / root_v, -b * sin_u * sin_v, c * cos_v * root_u
        )
        return contact_frame(f_u, f_v, orthogonal=True)

    @classmethod
    def wrap(cls, u: Angle, v: Angle) -> tuple[Angle, Angle]:
        v, beyond = fold_latitude(v)
        return wrap_angle(choose(beyond, -u, u)), v

    def floor(self, u: float, v: float) -> float:
        # h_u is at least b times this root, h_v at least c times it
        return self.c * math.sqrt(self.l2 * math.sin(u) ** 2 + self.k2 * math.cos(v) ** 2)


class OblateChart(Chart):
    """(a cos u cos v, a sin u cos v, c sin v): Jacobi's chart in the limit a = b, p = (a, c)."""

    orthogonal = True
    central = True
    periods = (TURN, None)
    singular_at = "a pole (v = +-pi/2)"

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        rho = self.p[0] * ca.cos(v)
        return ca.vertcat(rho * ca.cos(u), rho * ca.sin(u), self.p[1] * ca.sin(v))

    def coordinates(self, x: ca.SX) -> Pair:
        a, c = self.p[0], self.p[1]
        return ca.atan2(x[1], x[0]), ca.atan2(x[2] / c, ca.hypot(x[0], x[1]) / a)

    def frame(self, x: ca.SX) -> Frame:
        a, c = self.p[0], self.p[1]
        rho = ca.hypot(x[0], x[1])
        cos_u, sin_u = x[0] / rho, x[1] / rho
        outward, upward = -a * x[2] / c, c * rho / a
        h_v = ca.hypot(outward, upward)
        y_axis = ca.vertcat(outward * cos_u, outward * sin_u, upward) / h_v
        return ca.vertcat(-sin_u, cos_u, 0), y_axis, ca.diag(ca.vertcat(rho, h_v))

    @classmethod
    def wrap(cls, u: Angle, v: Angle) -> tuple[Angle, Angle]:
        v, beyond = fold_latitude(v)
        return wrap_angle(choose(beyond, u + math.pi, u)), v

    def floor(self, u: float, v: float) -> float:
        return self.p[1] * abs(math.cos(v))  # h_u = a |cos v|, h_v >= c


class ProlateChart(PolarChart):
    """(a cos u, b sin u cos v, b sin u sin v): Jacobi's chart in the limit b = c, p = (a, b)."""

    great_circles = False

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        rho = self.p[1] * ca.sin(u)
        return ca.vertcat(self.p[0] * ca.cos(u), rho * ca.cos(v), rho * ca.sin(v))

    def coordinates(self, x: ca.SX) -> Pair:
        a, b = self.p[0], self.p[1]
        return ca.atan2(ca.hypot(x[1], x[2]) / b, x[0] / a), ca.atan2(x[2], x[1])

    def frame(self, x: ca.SX) -> Frame:
        a, b = self.p[0], self.p[1]
        rho = ca.hypot(x[1], x[2])
        cos_v, sin_v = x[1] / rho, x[2] / rho
        axial, radial = -a * rho / b, b * x[0] / a
        h_u = ca.hypot(axial, radial)
        x_axis = ca.vertcat(axial, radial * cos_v, radial * sin_v) / h_u
        return x_axis, ca.vertcat(0, -sin_v, cos_v), ca.diag(ca.vertcat(h_u, rho))

    def floor(self, u: float, v: float) -> float:
        return self.p[1] * abs(math.sin(u))  # h_v = b |sin u|, h_u >= b


@dataclass(frozen=True, eq=False, repr=False)
class Ellipsoid(OfLengths):
    """Ellipsoid with semi-axes a >= b >= c along x, y, z; Jacobi's chart, eq. ``ellipsoid``.

    With equal axes the chart is the regular limit of Jacobi's: `OblateChart` (a = b),
    `ProlateChart` (b = c), or the sphere's `PolarChart`. ``help(surface.chart)`` shows its formula.

    Parameters
    ----------
    a, b, c : float
        Semi-axes, m.
    inside : bool
        True: an ellipsoidal bowl; (u, v) is then the chart's f(u, -v).
    """

    examples: ClassVar = tuple((1.0, b, c) for b, c in ((1, 1), (1, 0.6), (0.8, 0.8), (0.8, 0.6)))
    a: float
    b: float
    c: float

    def __post_init__(self) -> None:
        super().__post_init__()
        axes = (self.a, self.b, self.c)
        ordered = tuple(sorted(axes, reverse=True))
        if axes != ordered:
            raise SurfaceError(
                f"Ellipsoid: semi-axes {axes} must satisfy a >= b >= c; write "
                f"Ellipsoid{ordered}, or Quadric for axes along other directions"
            )
        require_thick("Ellipsoid", self.a, self.c)

    @cached_property
    def chart(self) -> type[Chart]:
        return ellipsoid_chart(self.a, self.b, self.c)[0]

    @cached_property
    def parameters(self) -> tuple[float, ...]:
        return ellipsoid_chart(self.a, self.b, self.c)[1]

    def parameter_names(self, first: int = 0) -> tuple[str, ...]:
        names = {self.c: "c", self.b: "b", self.a: "a"}  # of equal axes the first
        return tuple(names[axis] for axis in self.parameters)

    @property
    def least_radius(self) -> float:
        return least_radius(self.a, self.c)

    @property
    def injectivity(self) -> float:
        # pi over the root of the greatest Gaussian curvature (Klingenberg)
        return math.pi * self.b * self.c / self.a

    def level_geometry(self, p: ca.SX, x: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        axes = (p[self.parameters.index(axis)] for axis in (self.a, self.b, self.c))
        return second_degree(ca.vertcat(*(1 / axis**2 for axis in axes)), self._axes(p), x)


def second_degree(values: ca.SX, axes: ca.SX, x: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """`Surface.level_geometry` of x^T A x = 1, with A = axes diag(values) axes^T.

    Computed along the principal axes: terms of A x would cancel far out on the long ones.
    """
    along = axes.T @ x
    slopes = values * along
    return (ca.dot(along, slopes) - 1) / 2, axes @ slopes, axes @ ca.diag(values) @ axes.T


def least_radius(a: float, c: float) -> float:
    """Return `Surface.least_radius` for the greatest and the least semi-axis."""
    return max(c**2 / a, c / 3)


def require_thick(kind: str, a: float, c: float) -> None:
    """Raise a SurfaceError for an ellipsoid so flat or thin that doubles do not resolve its rim."""
    if c < THINNEST * a:
        raise SurfaceError(
            f"{kind}: the least semi-axis, {c!r} m, is less than {THINNEST:g} of the greatest, "
            f"{a!r} m, and its edge is too sharp; make it thicker, or give a Plane or a Cylinder"
        )


def ellipsoid_chart(a: float, b: float, c: float) -> tuple[type[Chart], tuple[float, ...]]:
    """Return the regular chart for a >= b >= c, and its numbers, which are the distinct axes."""
    charts = (JacobiChart, OblateChart), (ProlateChart, PolarChart)
    return charts[b == c][a == b], tuple(dict.fromkeys((a, b, c)))
