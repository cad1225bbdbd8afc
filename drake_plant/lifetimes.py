"""How to write systems in Python that are freed when nobody needs them any more.

A Diagram with a Python LeafSystem in it is never freed (Drake 1.51, 40 MB for a station;
github.com/RobotLocomotion/drake/issues/22515), as the garbage collector does not recognize three
kinds of reference cycles:

* callbacks: C++ keeps a bound method, and with it the system, which keeps the C++ object.
  :func:`weakly` makes a callback that does not keep its system;
* the instance's dictionary: of a Python subclass of a pybind11 class it is visited twice, so that
  the collector counts one reference too few and takes the cycle for alive. A class with
  ``__slots__ = NO_DICTIONARY`` has only its base's dictionary, visited once;
* cache entries: the object that DeclareCacheEntry returns keeps its system, and the collector does
  not see it. A system that needs an entry keeps the entry's index and calls ``get_cache_entry``,
  as :func:`array_entry` does.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DependencyTicket, ValueProducer

from contact_system.checks import Array

NO_DICTIONARY: tuple[str, ...] = ()
"""``__slots__`` of a system's class: attributes go into the dictionary of its base."""


def weakly(method: Callable, *first: Any) -> Callable:
    """The bound method as a callback that does not keep its object alive; it passes ``first``
    before the caller's arguments."""
    bound: Any = method
    owner, function = weakref.ref(bound.__self__), bound.__func__
    return lambda *arguments: function(owner(), *first, *arguments)


def array_entry(
    calc: Callable[[Context], Array], shape: tuple[int, ...], needs: Iterable[DependencyTicket]
) -> tuple[DependencyTicket, Callable[[Context], Array]]:
    """Declare a cache entry for the array that a system's method computes from a Context.

    Returns the entry's ticket, and a function that gives a Context's array. The array may be
    written to; changes stay until the entry is computed again.

    The entry is a Drake vector, not a Python object: when Drake evaluates batches it copies
    Contexts without holding Python's lock, and copying a Python object would end the process.
    """
    made, zeros = weakly(calc), BasicVector(np.zeros(math.prod(shape)))
    system: Any = calc.__self__  # type: ignore[attr-defined]

    def fill(context: Context, value: Any) -> None:
        value.get_mutable_value().SetFromVector(made(context).ravel())

    producer = ValueProducer(lambda: AbstractValue.Make(zeros), fill)
    entry = system.DeclareCacheEntry(calc.__name__, producer, set(needs))
    index, owner = entry.cache_index(), weakref.proxy(system)

    def array(context: Context) -> Array:
        return owner.get_cache_entry(index).Eval(context).get_mutable_value().reshape(shape)

    return entry.ticket(), array
