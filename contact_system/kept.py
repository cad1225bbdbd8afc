"""Attributes computed at their first access."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class kept(Generic[T]):
    """An attribute computed at its first access; threads that compute it at once get the first.

    It is stored under its name, so do not ask ``super()`` for it.
    This is ``functools.cached_property`` without its lock. Until Python 3.12 that lock is shared by
    all instances, so a thread that holds it and waits for another lock may deadlock.
    """

    def __init__(self, find: Callable[[Any], T]):
        self.find, self.name, self.__doc__ = find, find.__name__, find.__doc__

    def __get__(self, instance: Any, owner: type | None = None) -> T:
        if instance is None:
            return self  # type: ignore[return-value]
        return instance.__dict__.setdefault(self.name, self.find(instance))
