"""The plane, and its chart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..theory import symbols as ca
from .base import Surface
from .charts import Chart, Pair


class FlatChart(Chart):
    """(u, v, 0): the plane; the coordinates are lengths, m."""

    orthogonal = True
    developable = True
    lengths = (True, True)
    singular_at = ""

    def point(self, u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.vertcat(u, v, 0)

    def coordinates(self, x: ca.SX) -> Pair:
        return x[0], x[1]


def is_plane(body: Surface) -> bool:
    """Whether a body is flat and unbounded."""
    return issubclass(body.chart, FlatChart)


@dataclass(frozen=True, eq=False, repr=False)
class Plane(Surface):
    """The plane z = 0, body below; chart (u, v, 0), coordinates in m."""

    chart = FlatChart
    size = 1.0
    examples: ClassVar = ((),)

    def _level(self, p: ca.SX, x: ca.SX) -> ca.SX:
        return x[2]
