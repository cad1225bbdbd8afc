"""Surfaces that bound bodies: one class a file, with its chart."""

from .base import LEAST_LENGTH, SINGULAR, Surface, on_seam, positive_length, second_cover, store
from .charts import TINY, TURN, Chart
from .cylinder import Cylinder, RoundCylinderChart
from .ellipsoid import Ellipsoid, JacobiChart, OblateChart, ProlateChart
from .formula import Formula
from .plane import FlatChart, Plane
from .quadric import (
    EllipticCylinderChart,
    HyperbolicCylinderChart,
    OffsetPlaneChart,
    OneSheetChart,
    Quadric,
    TwoSheetChart,
)
from .sphere import PolarChart, Sphere
from .torus import Torus, TorusChart
from .user import CentralChart, FreeChart, ImplicitSurface, ParametricSurface, UserSurface

__all__ = [
    "LEAST_LENGTH",
    "SINGULAR",
    "TINY",
    "TURN",
    "CentralChart",
    "Chart",
    "Cylinder",
    "Ellipsoid",
    "EllipticCylinderChart",
    "FlatChart",
    "Formula",
    "FreeChart",
    "HyperbolicCylinderChart",
    "ImplicitSurface",
    "JacobiChart",
    "OblateChart",
    "OffsetPlaneChart",
    "OneSheetChart",
    "ParametricSurface",
    "Plane",
    "PolarChart",
    "ProlateChart",
    "Quadric",
    "RoundCylinderChart",
    "Sphere",
    "Surface",
    "Torus",
    "TorusChart",
    "TwoSheetChart",
    "UserSurface",
    "on_seam",
    "positive_length",
    "second_cover",
    "store",
]
