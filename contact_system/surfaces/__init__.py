"""Surfaces of bodies: each class and its chart in one file. A new class is imported here."""

# ruff: noqa: F401

from .base import SINGULAR, Surface, run_in_space
from .charts import TINY, TURN
from .cylinder import Cylinder
from .ellipsoid import Ellipsoid
from .formula import UserSurface
from .implicit import ImplicitSurface
from .parametric import ParametricSurface
from .plane import Plane
from .quadric import Quadric
from .sphere import Sphere
from .torus import Torus

KINDS: dict[str, type[Surface]] = {
    name.removesuffix("Surface").lower(): found
    for name, found in tuple(globals().items())
    if isinstance(found, type) and issubclass(found, Surface)
    if found not in (Surface, UserSurface)
}
"""The classes by their names in scene files, such as "sphere"."""

__all__ = ["Surface", *(kind.__name__ for kind in KINDS.values())]
