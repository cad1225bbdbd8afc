"""Attributes that are worked out when they are first asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class kept(Generic[T]):
    """An attribute computed when it is first asked for; two threads may both compute it.

    ``functools.cached_property`` without its lock, which until Python 3.12 costs 0.6 us and is one
    for all instances: a thread that holds it and waits for another lock may wait forever.
    """

    def __init__(self, find: Callable[[Any], T]):
        self.find, self.name, self.__doc__ = find, find.__name__, find.__doc__

    def __get__(self, instance: Any, owner: type | None = None) -> T:
        if instance is None:
            return self  # type: ignore[return-value]
        known = instance.__dict__
        if self.name not in known:
            known[self.name] = self.find(instance)
        return known[self.name]
