"""Systems written in Python that can be freed again.

A Diagram with a Python LeafSystem in it lives for ever (Drake 1.51, 40 MB for a station;
github.com/RobotLocomotion/drake/issues/22515), for three reasons that the garbage collector does
not see through:

* callbacks: C++ keeps a bound method, and with it the system, which keeps C++. :func:`weakly`
  makes a callback that does not hold its system;
* the instance's dictionary: a Python subclass of a pybind11 class has it visited twice, so that the
  collector counts one reference too few and takes the cycle for alive. A class with
  ``__slots__ = NO_DICTIONARY`` has only that of its base, visited once;
* cache entries: the object that DeclareCacheEntry returns holds its system out of the collector's
  sight. A system that needs an entry keeps its index and asks ``get_cache_entry``:
  :func:`array_entry` does.
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
"""``__slots__`` of a system; its attributes go into its base's dictionary."""


def weakly(method: Callable, *first: Any) -> Callable:
    """The bound method as a callback that does not keep its object; ``first`` are arguments before
    those of the caller."""
    bound: Any = method
    owner, function = weakref.ref(bound.__self__), bound.__func__
    return lambda *arguments: function(owner(), *first, *arguments)


def array_entry(
    calc: Callable[[Context], Array], shape: tuple[int, ...], needs: Iterable[DependencyTicket]
) -> tuple[DependencyTicket, Callable[[Context], Array]]:
    """Declare a cache entry for the array that a system's method computes from a Context.

    Returns its ticket, and a function that gives a Context's array; what is written there stays
    until it is computed again.

    A vector holds it: Drake copies Contexts without Python's lock when it evaluates batches, and a
    Python object in one would end the process.
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
