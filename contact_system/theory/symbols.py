"""CasADi, loaded when the first symbol is made; its locks and caches.

Write ``from ..theory import symbols as ca`` and use it like CasADi. Plans of bundled surfaces make
no symbols and never load it.
"""

from __future__ import annotations

import atexit
import functools
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from casadi import *  # noqa: F403

_LOCK = threading.RLock()  # CasADi's table of constants is not thread-safe
atexit.register(_LOCK.acquire)  # the table is destroyed at exit: daemon threads must wait
if hasattr(os, "register_at_fork"):  # so that a child's table is consistent; not on Windows
    os.register_at_fork(
        before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release
    )


class _DeferredCtrlC:
    """Handler that notes SIGINT: CasADi may lose an exception that is raised inside it."""

    def __init__(self, usual: Callable[..., Any]):
        self.usual, self.pending, self.immediate = usual, False, False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.pending = True
        if self.immediate:
            self.usual(number, frame)
            self.pending = False  # as it raised nothing


@contextmanager
def making_symbols() -> Iterator[None]:
    """Hold this lock while CasADi is loaded, or expressions of symbols are made or deleted.

    One thread at a time can hold it; forks of the process and Ctrl-C wait until it is released.
    """
    with _LOCK:
        is_main = threading.current_thread() is threading.main_thread()
        usual = signal.getsignal(signal.SIGINT) if is_main else None
        if not callable(usual) or isinstance(usual, _DeferredCtrlC):
            yield
            return
        deferred = _DeferredCtrlC(usual)
        signal.signal(signal.SIGINT, deferred)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, usual)
            if deferred.pending:
                usual(signal.SIGINT, None)


@contextmanager
def immediate_ctrl_c() -> Iterator[None]:
    """Inside `making_symbols`, let Ctrl-C stop a user's function, which may never end."""
    deferred = signal.getsignal(signal.SIGINT)
    if not isinstance(deferred, _DeferredCtrlC):
        yield
        return
    deferred.immediate = True
    try:
        yield
    except KeyboardInterrupt:
        deferred.pending = False
        raise
    finally:
        deferred.immediate = False


MOST_CACHED = 64  # results of each function


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # what Python asks of modules, such as __path__
        raise AttributeError(name)
    with making_symbols():
        import casadi

    found = globals()[name] = getattr(casadi, name)
    return found


def per_structure(build: Callable[..., Any]) -> Callable[..., Any]:
    """Cache a function of surfaces that makes symbols; its keys are their structures and sides."""
    results: dict[tuple[Any, ...], Any] = {}  # the least recently used first

    @functools.wraps(build)
    def cached(*given: Any) -> Any:
        key = tuple((a.structure, a.inside) if hasattr(a, "structure") else a for a in given)
        with making_symbols():
            results[key] = results.pop(key) if key in results else build(*given)
            if len(results) > MOST_CACHED:
                del results[next(iter(results))]
            return results[key]

    return cached
