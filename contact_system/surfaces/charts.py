"""Charts: coordinates (u, v) on families of surfaces, in symbols.

A surface has a chart and numbers for it; several surfaces may share a chart. Every chart is
right-handed: ``f_u x f_v`` points out of the body. SI units, radians.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, TypeAlias

import numpy as np

from ..theory import symbols as ca
from ..theory.geometry import contact_frame

Pair: TypeAlias = "tuple[ca.SX, ca.SX]"
Frame: TypeAlias = "tuple[ca.SX, ca.SX, ca.SX]"
Periods = tuple[float | None, float | None]
Angle = Any  # a float or an array of them

TURN = 2.0 * math.pi
TINY = 1e-300  # replaces a zero denominator where the quotient is not used


def choose(condition: Any, a: Any, b: Any) -> Any:
    """Return a where the condition holds, else b, for numbers and arrays."""
    return np.where(condition, a, b) if isinstance(condition, np.ndarray) else a if condition else b


def wrap_angle(angle: Angle) -> Angle:
    """Return the angle in (-pi, pi]; one in that range is not changed."""
    if isinstance(angle, float) and -math.pi < angle <= math.pi:
        return angle
    in_range = (angle > -math.pi) & (angle <= math.pi)
    return choose(in_range, angle, angle - TURN * np.ceil((angle - math.pi) / TURN))


def fold_latitude(v: Angle) -> tuple[Angle, Any]:
    """Return the angle in [-pi/2, pi/2] with the sine of v, and whether cos v is negative."""
    v = wrap_angle(v)
    beyond = abs(v) > math.pi / 2
    return choose(beyond, choose(v > 0, math.pi, -math.pi) - v, v), beyond


class Chart:
    """Coordinates on a family of surfaces; ``p`` are the numbers of one surface.

    Class attributes: `orthogonal` (``f_u . f_v = 0`` everywhere), `periods` of u and v in radians
    or None, `double_cover` ((-u, pi - v) is the same point as (u, v), with both frame axes turned
    by pi), `developable` (T = 0 and constant Lame coefficients), `great_circles` (geodesics are
    great circles), `central` (every ray from a centre meets the surface once), `lengths` (whether u
    and v are lengths, m), `singular_at` (where there is no contact frame, for messages; "" nowhere,
    None unknown).
    """

    orthogonal: ClassVar[bool] = False
    periods: ClassVar[Periods] = (None, None)
    double_cover: ClassVar[bool] = False
    developable: ClassVar[bool] = False
    great_circles: ClassVar[bool] = False
    central: ClassVar[bool] = False
    lengths: ClassVar[tuple[bool, bool]] = (False, False)
    singular_at: ClassVar[str | None] = None

    def __init__(self, p: Any):
        self.p = p

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        """Return f(u, v), (3, 1), m."""
        raise NotImplementedError

    def coordinates(self, x: ca.SX) -> Pair:
        """Return (u, v) of a point x on the surface, principal branch."""
        raise NotImplementedError

    def frame(self, x: ca.SX) -> Frame:
        """Return (x axis, y axis, M) at a point x on the surface.

        By default it differentiates the chart at the point's coordinates. Charts override it to
        avoid trigonometric functions.
        """
        q = ca.SX.sym("q", 2)
        f_u, f_v = ca.horzsplit(ca.jacobian(self.point(q[0], q[1]), q))
        frame = list(contact_frame(f_u, f_v, self.orthogonal))
        x_axis, y_axis, m = ca.substitute(frame, [q], [ca.vertcat(*self.coordinates(x))])
        return x_axis, y_axis, m

    @classmethod
    def wrap(cls, u: Angle, v: Angle) -> tuple[Angle, Angle]:
        """Return the same point in the principal range; coordinates in range are not changed."""
        around_u, around_v = cls.periods
        return wrap_angle(u) if around_u else u, wrap_angle(v) if around_v else v

    def floor(self, u: float, v: float) -> float:
        """Return a lower bound of the diagonal of the metric root, m; 0 if none is known.

        It is cheaper than the metric root, and shows that most points are regular.
        """
        return 0.0
