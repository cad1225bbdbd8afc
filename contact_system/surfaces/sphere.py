"""The sphere, and its polar chart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from ..theory import symbols as ca
from .base import OfLengths
from .charts import TURN, Angle, Chart, Frame, Pair, choose, wrap_angle


class PolarChart(Chart):
    """r (sin u cos v, sin u sin v, cos u): the sphere, p = (r,)."""

    orthogonal = True
    central = True
    periods = (None, TURN)
    great_circles = True
    singular_at = "a pole (u = 0 or pi)"

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        rho = self.p[0] * ca.sin(u)
        return ca.vertcat(rho * ca.cos(v), rho * ca.sin(v), self.p[0] * ca.cos(u))

    def coordinates(self, x: ca.SX) -> Pair:
        return ca.atan2(ca.hypot(x[0], x[1]), x[2]), ca.atan2(x[1], x[0])

    def frame(self, x: ca.SX) -> Frame:
        r, rho = self.p[0], ca.hypot(x[0], x[1])
        cos_v, sin_v, cos_u = x[0] / rho, x[1] / rho, x[2] / r
        x_axis = ca.vertcat(cos_u * cos_v, cos_u * sin_v, -rho / r)
        return x_axis, ca.vertcat(-sin_v, cos_v, 0), ca.diag(ca.vertcat(r, rho))

    @classmethod
    def wrap(cls, u: Angle, v: Angle) -> tuple[Angle, Angle]:
        u = wrap_angle(u)
        # (-u, v) is the point (u, v + pi), but there f_u x f_v points into the body.
        return abs(u), wrap_angle(choose(u < 0, v + math.pi, v))

    def floor(self, u: float, v: float) -> float:
        return self.p[0] * abs(math.sin(u))


@dataclass(frozen=True, eq=False, repr=False)
class Sphere(OfLengths):
    """Sphere about the origin; chart r (sin u cos v, sin u sin v, cos u), poles at u = 0, pi.

    Parameters
    ----------
    radius : float
        m.
    inside : bool
        True: a spherical bowl; (u, v) is then the chart's f(u, -v).
    """

    chart = PolarChart
    examples: ClassVar = ((1.0,),)
    radius: float

    @property
    def injectivity(self) -> float:
        return math.pi * self.radius

    def _level(self, p: ca.SX, x: ca.SX) -> ca.SX:
        return (ca.dot(x, x) - p[0] ** 2) / 2
