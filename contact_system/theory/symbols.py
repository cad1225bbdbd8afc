"""CasADi, loaded when the first symbol is made, and what makers of symbols share.

Write ``from ..theory import symbols as ca`` and use it as CasADi itself. Planning and asking a
scene of bundled surfaces makes no symbols, and so never loads it.
"""

from __future__ import annotations

import dataclasses
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


@dataclasses.dataclass(frozen=True)
class _Alike:
    """A surface in the place of all of its structure and side, which differ in numbers alone."""

    key: tuple[Any, ...]
    surface: Any = dataclasses.field(compare=False)


def per_structure(build: Callable[..., Any]) -> Callable[..., Any]:
    """Keep the latest results of a maker of symbols, by structure and side of surfaces it takes."""

    @functools.lru_cache(maxsize=MOST_KEPT)
    def made(*given: Any) -> Any:
        with SYMBOLS:
            return build(*(k.surface if isinstance(k, _Alike) else k for k in given))

    @functools.wraps(build)
    def kept(*given: Any) -> Any:
        surfaces = (
            _Alike((a.structure, a.inside), a) if hasattr(a, "structure") else a for a in given
        )
        return made(*surfaces)

    return kept
