"""The circular cylinder, and its chart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..theory import symbols as ca
from .base import OfRadius
from .charts import TURN, Angle, Chart, Frame, Numbers, Pair, diagonal, wrap_angle


class RoundCylinderChart(Chart):
    """(r cos u, r sin u, v): the circular cylinder, p = (r,)."""

    name = "round_cylinder"
    orthogonal = True
    turning = 0
    periods = (TURN, None)
    developable = True
    ranges = "-pi < u <= pi, v any"

    @staticmethod
    def point(p: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(p[0] * ca.cos(u), p[0] * ca.sin(u), v)

    @staticmethod
    def lame(p: ca.SX, u: ca.SX, v: ca.SX) -> Pair:
        return p[0], ca.SX(1)

    @staticmethod
    def coordinates(p: ca.SX, x: ca.SX) -> Pair:
        return ca.atan2(x[1], x[0]), x[2]

    @staticmethod
    def frame(p: ca.SX, x: ca.SX) -> Frame:
        return ca.vertcat(-x[1] / p[0], x[0] / p[0], 0), ca.SX([0, 0, 1]), diagonal(p[0], 1)

    @staticmethod
    def wrap(u: Angle, v: Angle) -> tuple[Angle, Angle]:
        return wrap_angle(u), v

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return min(p[0], 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class Cylinder(OfRadius):
    """Circular cylinder about the z axis; chart (r cos u, r sin u, v), v in m.

    Parameters
    ----------
    radius : float
        m.
    inside : bool
        True: a bore; (u, v) is then the chart's f(u, -v).
    """

    table_name: ClassVar[str] = "cylinder"

    @property
    def chart(self) -> type[Chart]:
        return RoundCylinderChart

    def _level(self, p: ca.SX, x: ca.SX) -> ca.SX:
        return ((x[0] ** 2 + x[1] ** 2) / p[0] ** 2 - 1) / 2
