"""Charts: coordinates (u, v) on the families of surfaces that bodies have.

Surfaces join charts to numbers; a new surface of a known family needs no chart of its own. Every
chart is right-handed, ``f_u x f_v`` along the normal out of the body. SI units, radians.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..theory import symbols as ca
from ..theory.geometry import contact_frame

Array = NDArray[np.float64]
Pair: TypeAlias = "tuple[ca.SX, ca.SX]"
Frame: TypeAlias = "tuple[ca.SX, ca.SX, ca.SX]"
Periods = tuple[float | None, float | None]
Angle = Any  # a float or an array of them

TURN = 2.0 * math.pi
# Keeps 1/0 and 0/0 out of what is not used or has a zero above; far below any real length ratio.
TINY = 1e-300


def hypot(a: ca.SX | float, b: ca.SX | float) -> ca.SX:
    """Return sqrt(a^2 + b^2)."""
    return ca.sqrt(a * a + b * b)


def diagonal(a: ca.SX | float, b: ca.SX | float) -> ca.SX:
    """Return the matrix diag(a, b)."""
    return ca.diag(ca.vertcat(a, b))


def choose(condition: Any, a: Any, b: Any) -> Any:
    """Return a where the condition holds, else b; of one number as of arrays."""
    return np.where(condition, a, b) if isinstance(condition, np.ndarray) else a if condition else b


def wrap_angle(angle: Angle) -> Angle:
    """Return the angle in (-pi, pi], untouched where it is there already."""
    in_range = (angle > -math.pi) & (angle <= math.pi)  # a bool or an array of them
    if in_range is True:  # one number, as contacts mostly have
        return angle
    return choose(in_range, angle, angle - TURN * np.ceil((angle - math.pi) / TURN))


def fold_latitude(v: Angle) -> tuple[Angle, Any]:
    """Return v in [-pi/2, pi/2], the angle with the same sine, and where it had to be folded."""
    v = wrap_angle(v)
    beyond = abs(v) > math.pi / 2
    return choose(beyond, choose(v > 0, math.pi, -math.pi) - v, v), beyond


class Chart:
    """One way to lay coordinates on a family of surfaces; ``p`` are the numbers of one.

    Class attributes: `orthogonal` (``f_u . f_v = 0`` identically), `periods` of u and v in radians
    or None, `double_cover` ((-u, pi - v) is the same point as (u, v), with both frame axes turned
    by pi), `developable` (T = 0 and constant Lame coefficients), `great_circles` (geodesics are
    great circles), `central` (every ray from a centre meets the surface once), `turning` (0 or 1:
    the coordinate that only turns the surface about its axis; such a chart has `lame`), `lengths`
    (whether u and v are lengths, m), `singular_at` (where the frame is lost, for messages; ""
    nowhere, None not known), `ranges` of the principal branch.
    """

    orthogonal: ClassVar[bool] = False
    periods: ClassVar[Periods] = (None, None)
    double_cover: ClassVar[bool] = False
    developable: ClassVar[bool] = False
    great_circles: ClassVar[bool] = False
    central: ClassVar[bool] = False
    turning: ClassVar[int | None] = None
    lengths: ClassVar[tuple[bool, bool]] = (False, False)
    singular_at: ClassVar[str | None] = None
    ranges: ClassVar[str] = "u and v any real number"

    def __init__(self, p: Any):
        self.p = p

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        """Return f(u, v), (3, 1), m."""
        raise NotImplementedError

    def lame(self, u: ca.SX, v: ca.SX) -> Pair:
        """Return |f_u|, |f_v|, m, of a chart that is `turning`, without that angle.

        Beyond a pole the one that vanishes there is negative.
        """
        raise NotImplementedError

    def coordinates(self, x: ca.SX) -> Pair:
        """Return (u, v) of a point x on the surface, principal branch."""
        raise NotImplementedError

    def frame(self, x: ca.SX) -> Frame:
        """Return (x axis, y axis, M) at a point x on the surface.

        By default that of the chart at the point's coordinates; charts of which this takes
        functions of angles say it without them.
        """
        q = ca.SX.sym("q", 2)
        f_u, f_v = ca.horzsplit(ca.jacobian(self.point(q[0], q[1]), q))
        frame = list(contact_frame(f_u, f_v, self.orthogonal))
        x_axis, y_axis, m = ca.substitute(frame, [q], [ca.vertcat(*self.coordinates(x))])
        return x_axis, y_axis, m

    @staticmethod
    def wrap(u: Angle, v: Angle) -> tuple[Angle, Angle]:
        """Return the same point in the principal range; what is in range stays bit for bit."""
        return u, v

    def floor(self, u: float, v: float) -> float:
        """Return what no diagonal entry of the metric root is below, m; 0 where none is known.

        It costs a sine, the entries a table: so most points are told regular.
        """
        return 0.0
