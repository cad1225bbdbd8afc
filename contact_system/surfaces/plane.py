"""The plane, and its chart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..theory import symbols as ca
from .base import Surface
from .charts import Angle, Chart, Frame, Numbers, Pair


class FlatChart(Chart):
    """(u, v, 0): the plane; lengths are coordinates."""

    name = "flat"
    orthogonal = True
    developable = True

    @staticmethod
    def point(p: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(u, v, 0)

    @staticmethod
    def coordinates(p: ca.SX, x: ca.SX) -> Pair:
        return x[0], x[1]

    @staticmethod
    def frame(p: ca.SX, x: ca.SX) -> Frame:
        return ca.SX([1, 0, 0]), ca.SX([0, 1, 0]), ca.SX.eye(2)

    @staticmethod
    def metric_floor(p: Numbers, u: Angle, v: Angle) -> Angle:
        return 1.0


@dataclass(frozen=True, eq=False, repr=False)
class Plane(Surface):
    """The plane z = 0, body below; chart (u, v, 0), coordinates in m."""

    table_name: ClassVar[str] = "plane"

    @property
    def chart(self) -> type[Chart]:
        return FlatChart

    @property
    def parameters(self) -> tuple[float, ...]:
        return ()

    @property
    def size(self) -> float:
        return 1.0

    def _level(self, p: ca.SX, x: ca.SX) -> ca.SX:
        return x[2]
