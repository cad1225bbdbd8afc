"""Surfaces of bodies: each class and its chart in one file. A new class is imported here."""

# ruff: noqa: F401

from .base import LEAST_LENGTH, SINGULAR, Surface, run_in_space
from .charts import TINY, TURN, Chart
from .cylinder import Cylinder, RoundCylinderChart
from .ellipsoid import Ellipsoid, JacobiChart, OblateChart, ProlateChart
from .plane import FlatChart, Plane
from .quadric import Quadric
from .sphere import PolarChart, Sphere
from .torus import Torus, TorusChart
from .user import CentralChart, Formula, ImplicitSurface, ParametricSurface, UserSurface

KINDS: dict[str, type[Surface]] = {
    name.removesuffix("Surface").lower(): found
    for name, found in tuple(globals().items())
    if isinstance(found, type) and issubclass(found, Surface)
    if found not in (Surface, UserSurface)
}
"""The classes by their names in scene files, such as "sphere"."""

__all__ = ["Surface", *(kind.__name__ for kind in KINDS.values())]
