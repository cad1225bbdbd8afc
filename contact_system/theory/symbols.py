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


class _CtrlC:
    """Handler that defers SIGINT: CasADi may lose an exception raised inside it."""

    def __init__(self, usual: Callable[..., Any]):
        self.usual, self.came = usual, False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.came = True


@contextmanager
def making_symbols() -> Iterator[None]:
    """Hold this while CasADi is loaded, or expressions of symbols are made or deleted.

    One thread at a time can hold it; forks of the process and Ctrl-C wait for its end.
    """
    with _LOCK:
        here = threading.current_thread() is threading.main_thread()
        usual = signal.getsignal(signal.SIGINT) if here else None
        if not callable(usual) or isinstance(usual, _CtrlC):
            yield
            return
        kept = _CtrlC(usual)
        signal.signal(signal.SIGINT, kept)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, usual)
            if kept.came:
                usual(signal.SIGINT, None)


@contextmanager
def hearing_ctrl_c() -> Iterator[None]:
    """Inside `making_symbols`, let Ctrl-C stop a user's function, which may never end."""
    kept = signal.getsignal(signal.SIGINT)
    if not isinstance(kept, _CtrlC):
        yield
        return
    signal.signal(signal.SIGINT, kept.usual)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, kept)


MOST_KEPT = 64  # cached results of each function


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # what Python asks of modules, such as __path__
        raise AttributeError(name)
    with making_symbols():
        import casadi

    found = globals()[name] = getattr(casadi, name)
    return found


def per_structure(build: Callable[..., Any]) -> Callable[..., Any]:
    """Cache a function of surfaces that makes symbols, by the surfaces' structures and sides."""
    made: dict[tuple[Any, ...], Any] = {}  # the least recently used first

    @functools.wraps(build)
    def kept(*given: Any) -> Any:
        key = tuple((a.structure, a.inside) if hasattr(a, "structure") else a for a in given)
        with making_symbols():
            made[key] = made.pop(key) if key in made else build(*given)
            if len(made) > MOST_KEPT:
                del made[next(iter(made))]
            return made[key]

    return kept
