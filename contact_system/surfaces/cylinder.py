"""The circular cylinder, and its chart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..theory import symbols as ca
from .base import OfLengths
from .charts import TURN, Chart, Pair


class RoundCylinderChart(Chart):
    """(r cos u, r sin u, v): the circular cylinder, p = (r,)."""

    orthogonal = True
    periods = (TURN, None)
    lengths = (False, True)
    developable = True
    singular_at = ""

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(self.p[0] * ca.cos(u), self.p[0] * ca.sin(u), v)

    def coordinates(self, x: ca.SX) -> Pair:
        return ca.atan2(x[1], x[0]), x[2]


@dataclass(frozen=True, eq=False, repr=False)
class Cylinder(OfLengths):
    """Circular cylinder about the z axis; chart (r cos u, r sin u, v), v in m.

    Parameters
    ----------
    radius : float
        m.
    inside : bool
        True: a bore; (u, v) is then the chart's f(u, -v).
    """

    chart = RoundCylinderChart
    examples: ClassVar = ((1.0,),)
    radius: float

    def _level(self, p: ca.SX, x: ca.SX) -> ca.SX:
        return ((x[0] ** 2 + x[1] ** 2) / p[0] ** 2 - 1) / 2
