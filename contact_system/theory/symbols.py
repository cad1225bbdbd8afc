"""CasADi, loaded when the first symbol is made, and what makers of symbols share.

Write ``from ..theory import symbols as ca`` and use it as CasADi itself. Planning and asking a
scene of bundled surfaces makes no symbols, and so never loads it.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from casadi import *  # noqa: F403

SYMBOLS = threading.RLock()
"""Held while expressions of symbols are made.

CasADi keeps constants in a table that two threads may not change at once."""

MOST_KEPT = 64  # results of each builder


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # what Python asks of modules, such as __path__
        raise AttributeError(name)
    import casadi

    found = globals()[name] = getattr(casadi, name)
    return found


class _Alike:
    """A surface in the place of all of its structure and side, which differ in numbers alone."""

    def __init__(self, surface: Any):
        self.surface, self.key = surface, (surface.structure, surface.inside)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Alike) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


def per_structure(build: Callable[..., Any]) -> Callable[..., Any]:
    """Keep the latest results of a maker of symbols, by structure and side of surfaces it takes."""

    @functools.lru_cache(maxsize=MOST_KEPT)
    def made(*keys: Any) -> Any:
        with SYMBOLS:
            return build(*(k.surface if isinstance(k, _Alike) else k for k in keys))

    @functools.wraps(build)
    def kept(*arguments: Any) -> Any:
        return made(*(_Alike(a) if hasattr(a, "structure") else a for a in arguments))

    return kept
