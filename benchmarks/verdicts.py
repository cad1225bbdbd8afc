"""Families of cases of the stress bench, and how a case ends: right, refused or a failure."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from contact_system import ContactSystemError

FAILURES = ("silent", "crash", "hang")
NAN = math.nan


@dataclass(frozen=True)
class Verdict:
    """How a case ended.

    "right": every error within its bound; "refused": a clear error of the package; "silent": wrong,
    NaN or infinite; "crash": another exception, or the end of the process; "hang". The error is the
    one nearest to its bound, or furthest beyond it; the message is what was compared, or the text
    of the refusal or exception.
    """

    outcome: str
    error: float = NAN
    bound: float = NAN
    message: str = ""


@dataclass
class Meter:
    """Errors against their bounds; keeps the one that is worst by that measure."""

    law: str = "nothing compared"
    error: float = 0.0
    bound: float = math.inf
    compared: int = 0

    def see(self, law: str, error: Any, bound: Any) -> None:
        """Take note of errors (any shape) and their bounds (of a shape that broadcasts)."""
        error, bound = np.broadcast_arrays(np.abs(error), np.asarray(bound, dtype=float))
        if not error.size:
            return
        self.compared += 1
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = error / np.maximum(bound, 1e-300)
        k = int(np.argmax(np.where(np.isnan(ratio), np.inf, ratio)))
        if not ratio.flat[k] <= self.error / self.bound:
            self.law, self.error = law, float(error.flat[k])
            self.bound = max(float(bound.flat[k]), 1e-300)

    def verdict(self) -> Verdict:
        """Right if everything was within its bound."""
        right = self.compared > 0 and self.error <= self.bound
        return Verdict("right" if right else "silent", self.error, self.bound, self.law)


@dataclass(frozen=True)
class Family:
    """Cases that are alike, each made anew from its index, so in any process and any order."""

    name: str
    count: int  # cases in the quick form: indices 0 to count - 1
    run: Callable[[int], Verdict]  # or raises, see `judged`


def judged(case: Callable[[], Verdict]) -> Verdict:
    """The verdict of a case; what it raises is one too."""
    try:
        return case()
    except ContactSystemError as error:
        return refusal(str(error))
    except Exception as error:
        return Verdict("crash", message=f"{type(error).__name__}: {error}")


# What a refusal must name (a part that is made alone knows its own key only), and words that tell
# what to do about it.
PLACE = re.compile(
    r"scene|contact|gain|profile|disturbance|Sphere|Cylinder|Torus|Ellipsoid|Quadric|Surface|"
    r"^[\w ]+(\[\d\])?( =|:| at )"
)
VALUE = re.compile(r"\d| = |nan|inf")
REMEDY = re.compile(
    r"\b(use|give|move|turn|start|end|restart|shorten|lengthen|lower|raise|make|ask|write|choose|"
    r"must|leave|change|scale|split|keep|set|plan|add|exchange|continue|check|announce|run|pass|accelerate)\b",
    re.IGNORECASE,
)


def refusal(text: str) -> Verdict:
    """ "refused" if a text names place, value and remedy, else "crash" with what it lacks."""
    parts = {"the scene or contact": PLACE, "a value": VALUE, "a remedy": REMEDY}
    missing = [name for name, pattern in parts.items() if not pattern.search(text)]
    if missing:
        return Verdict("crash", message=f"the error names not {', '.join(missing)}: {text}")
    return Verdict("refused", message=text)
