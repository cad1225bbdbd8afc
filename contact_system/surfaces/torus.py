"""The torus, and its chart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from ..errors import SurfaceError
from ..theory import symbols as ca
from .base import OfLengths
from .charts import TURN, Chart, Frame, Pair


class TorusChart(Chart):
    """((R + r cos v) cos u, (R + r cos v) sin u, r sin v), p = (R, r); regular everywhere."""

    orthogonal = True
    periods = (TURN, TURN)
    singular_at = ""

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        rho = self.p[0] + self.p[1] * ca.cos(v)
        return ca.vertcat(rho * ca.cos(u), rho * ca.sin(u), self.p[1] * ca.sin(v))

    def coordinates(self, x: ca.SX) -> Pair:
        return ca.atan2(x[1], x[0]), ca.atan2(x[2], ca.hypot(x[0], x[1]) - self.p[0])

    def frame(self, x: ca.SX) -> Frame:
        rho = ca.hypot(x[0], x[1])
        cos_u, sin_u = x[0] / rho, x[1] / rho
        cos_v, sin_v = (rho - self.p[0]) / self.p[1], x[2] / self.p[1]
        y_axis = ca.vertcat(-sin_v * cos_u, -sin_v * sin_u, cos_v)
        return ca.vertcat(-sin_u, cos_u, 0), y_axis, ca.diag(ca.vertcat(rho, self.p[1]))


@dataclass(frozen=True, eq=False, repr=False)
class Torus(OfLengths):
    """Torus about the z axis; chart ((R + r cos v) cos u, (R + r cos v) sin u, r sin v).

    Parameters
    ----------
    major, minor : float
        R and r, m, 0 < r < R.
    inside : bool
        True: the inside of a tube; (u, v) is then the chart's f(u, -v).
    """

    chart = TorusChart
    examples: ClassVar = ((1.0, 0.6),)
    major: float
    minor: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.minor < self.major:
            raise SurfaceError(
                f"Torus: minor = {self.minor} must be less than major = {self.major}, or the tube "
                "meets itself; give Torus(major, minor) in that order"
            )

    @property
    def size(self) -> float:
        return self.major + self.minor

    @property
    def least_radius(self) -> float:
        # at the inner rim 1/sqrt(-K), over which neighbouring geodesics part
        return min(self.minor, math.sqrt(self.minor * (self.major - self.minor)))

    def _level(self, p: ca.SX, x: ca.SX) -> ca.SX:
        return ((ca.hypot(x[0], x[1]) - p[0]) ** 2 + x[2] ** 2 - p[1] ** 2) / 2
