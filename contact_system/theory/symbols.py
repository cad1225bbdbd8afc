"""CasADi, loaded when the first symbol is made, and what makers of symbols share.

Write ``from ..theory import symbols as ca`` and use it as CasADi itself. Planning and asking a
scene of bundled surfaces makes no symbols, and so never loads it.
"""

from __future__ import annotations

import atexit
import dataclasses
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

_LOCK = threading.RLock()  # CasADi keeps constants in a table that two threads may not change
atexit.register(_LOCK.acquire)  # then the table goes: daemon threads wait for ever
if hasattr(os, "register_at_fork"):  # a child finds the table whole; Windows has no forks
    os.register_at_fork(
        before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release
    )


class _CtrlC:
    """Handler of SIGINT that keeps it for later: CasADi may lose what is raised below it."""

    def __init__(self, usual: Callable[..., Any]):
        self.usual, self.came, self.heard = usual, False, False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.came = True
        if self.heard:
            self.usual(number, frame)
            self.came = False


@contextmanager
def making_symbols() -> Iterator[None]:
    """Held while CasADi is loaded, or expressions of symbols are made or dropped.

    By one thread at a time; a fork of the process waits for its end, and so does Ctrl-C.
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
    """Held inside of `making_symbols` while a user's function runs, which may be an endless one."""
    kept = signal.getsignal(signal.SIGINT)
    if not isinstance(kept, _CtrlC):
        yield
        return
    kept.heard = True
    try:
        yield
    finally:
        kept.heard = False


MOST_KEPT = 64  # results of each builder


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # what Python asks of modules, such as __path__
        raise AttributeError(name)
    with making_symbols():
        import casadi

    found = globals()[name] = getattr(casadi, name)
    return found


@dataclasses.dataclass(frozen=True)
class _Alike:
    """A surface in the place of all of its structure and side, which differ in numbers alone."""

    key: tuple[Any, ...]
    surface: Any = dataclasses.field(compare=False)


def per_structure(build: Callable[..., Any]) -> Callable[..., Any]:
    """Keep the latest results of a maker of symbols, by structure and side of surfaces it takes."""

    @functools.lru_cache(maxsize=MOST_KEPT)
    def made(*given: Any) -> Any:
        return build(*(k.surface if isinstance(k, _Alike) else k for k in given))

    @functools.wraps(build)
    def kept(*given: Any) -> Any:
        surfaces = (
            _Alike((a.structure, a.inside), a) if hasattr(a, "structure") else a for a in given
        )
        with making_symbols():
            return made(*surfaces)

    return kept
