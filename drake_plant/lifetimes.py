"""Systems written in Python that can be freed again.

A Diagram with a Python LeafSystem in it lives for ever (Drake 1.51, 40 MB for a station), for three
reasons that the garbage collector does not see through:

* callbacks: C++ keeps a bound method, and with it the system, which keeps C++. :func:`weakly`
  makes a callback that does not hold its system;
* the instance's dictionary: a Python subclass of a pybind11 class has it visited twice, so that the
  collector counts one reference too few and takes the cycle for alive. A class with
  ``__slots__ = NO_DICTIONARY`` has only that of its base, visited once;
* cache entries: the object that DeclareCacheEntry returns holds its system out of the collector's
  sight. A system that needs an entry keeps its index and asks ``get_cache_entry``.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

NO_DICTIONARY: tuple[str, ...] = ()
"""``__slots__`` of a system; its attributes go into its base's dictionary."""


def weakly(method: Callable, *first: Any) -> Callable:
    """The bound method as a callback that does not keep its object; ``first`` are arguments before
    those of the caller."""
    reference = weakref.WeakMethod(method)

    def call(*arguments: Any) -> Any:
        return reference()(*first, *arguments)  # type: ignore[misc]

    return call
