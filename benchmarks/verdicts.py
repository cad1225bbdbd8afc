"""Cases of the stress bench, their families, and how a case ends: right, refused or a failure."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from contact_system.errors import ContactSystemError

OUTCOMES = ("right", "refused", "silent", "crash", "hang")
FAILURES = OUTCOMES[2:]


@dataclass(frozen=True)
class Verdict:
    """How a case ended.

    Attributes
    ----------
    outcome : str
        "right": every error within its bound; "refused": a clear error of the package; "silent":
        wrong, NaN or infinite; "crash": another exception, or the end of the process; "hang".
    error, bound : float
        The error nearest to its bound, or furthest beyond it, and that bound; NaN if refused.
    message : str
        What was compared, or the text of the refusal or exception.
    """

    outcome: str
    error: float
    bound: float
    message: str = ""


@dataclass(frozen=True)
class Case:
    """One thing to try.

    Attributes
    ----------
    name : str
        Says everything about it that the family does not.
    family : str
    call : callable
        Returns the verdict. A `ContactSystemError` that it raises is judged as a refusal, anything
        else as a crash (see `judged`).
    """

    name: str
    family: str
    call: Callable[[], Verdict]


@dataclass(frozen=True)
class Family:
    """Cases of one kind, each made anew from its index, so in any process and any order.

    Attributes
    ----------
    name : str
    count : int
        Cases in the quick form: indices 0 to count - 1.
    make : callable
        The case of an index.
    endless : bool
        A random search: any index makes a case, and ``--full`` takes indices that no run had.
    """

    name: str
    count: int
    make: Callable[[int], Case]
    endless: bool = False


def judged(case: Case) -> Verdict:
    """The verdict of a case; what it raises is one too."""
    try:
        return case.call()
    except ContactSystemError as error:
        return refusal(str(error))
    except Exception as error:
        return Verdict("crash", float("nan"), float("nan"), f"{type(error).__name__}: {error}")


# What a refusal must name (a part that is made alone knows its own key only), and words that tell
# what to do about it.
_PLACE = re.compile(
    r"scene|contact|gain|profile|disturbance|Sphere|Cylinder|Torus|Ellipsoid|Quadric|Surface|"
    r"^[\w ]+(\[\d\])?( =|:| at )"
)
_VALUE = re.compile(r"\d| = ")
_REMEDY = re.compile(
    r"\b(use|give|move|turn|start|end|restart|shorten|lengthen|lower|raise|make|ask|write|choose|"
    r"must|leave|change|scale|split|keep|set|plan|add|exchange|continue|check)\b", re.IGNORECASE,
)  # fmt: skip


def refusal(text: str) -> Verdict:
    """ "refused" if a text names place, value and remedy, else "crash" with what it lacks."""
    parts = {"the scene or contact": _PLACE, "a value": _VALUE, "a remedy": _REMEDY}
    missing = [name for name, pattern in parts.items() if not pattern.search(text)]
    nan = float("nan")
    if missing:
        return Verdict("crash", nan, nan, f"the error names not {', '.join(missing)}: {text}")
    return Verdict("refused", nan, nan, text)
