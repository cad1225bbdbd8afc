"""Steering: legs that take contacts from a start to a goal (theory section 11)."""

from .goal import Goal, Route
from .loop import Loop, loop
from .reach import reach

__all__ = ["Goal", "Loop", "Route", "loop", "reach"]
