"""Steering: legs from a start to a goal, and geodesics between two points (theory section 11)."""

from .geodesic import Geodesic, geodesic, geodesics
from .goal import Goal, Route
from .loop import Loop, loop
from .reach import reach

__all__ = ["Geodesic", "Goal", "Loop", "Route", "geodesic", "geodesics", "loop", "reach"]
