"""Attributes computed at their first access."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class cached_property(Generic[T]):
    """An attribute computed at its first access and stored in the instance under its name.

    If several threads compute it at the same time, all get the value that was stored first.
    One that overrides another must not ask ``super()`` for it: that value would be stored. This is
    ``functools.cached_property`` without the lock that all instances share until Python 3.12: a
    thread that holds it and waits for another lock may deadlock.
    """

    def __init__(self, compute: Callable[[Any], T]):
        self.compute, self.name, self.__doc__ = compute, compute.__name__, compute.__doc__

    def __get__(self, instance: Any, owner: type | None = None) -> T:
        if instance is None:
            return self  # type: ignore[return-value]
        return instance.__dict__.setdefault(self.name, self.compute(instance))
