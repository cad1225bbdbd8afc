"""Checks of arguments; error messages name the place, the value and the remedy."""

from __future__ import annotations

import difflib
import math
import numbers
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import limits
from .errors import ContactSystemError, SceneError

Array = NDArray[np.float64]
FLOAT = np.dtype(float)
ROUNDING = 1e-11  # relative error of a time that is the sum of a hundred thousand time steps
LARGEST = 1e100  # beyond this sigma^3 overflows


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Put the place in front of the text of each of the package's errors raised inside, unless the
    text begins with it."""
    try:
        yield
    except ContactSystemError as error:
        text = str(error)
        raise SceneError(text if text.startswith(place) else f"{place}: {text}") from None


def within(
    limit: str,
    count: float,
    what: str,
    error: type[ContactSystemError] = SceneError,
    remedy: str = "ask for less",
) -> None:
    """Raise the error if a count is above one of `limits`; `what` names what is counted."""
    most = getattr(limits, limit)
    if count > most:
        raise error(
            f"{what}: {min(count, 1e300):.15g}, and the limit is {most:.15g}; {remedy}, or set "
            f"contact_system.limits.{limit} higher"
        )


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """ " (did you mean '...'?)" with the nearest known word; empty if none is near."""
    by_lower = {k.lower(): k for k in known}
    close = difflib.get_close_matches(str(word).lower(), by_lower, n=1)
    return f" (did you mean '{by_lower[close[0]]}'?)" if close else ""


def of_kind(
    kind: Any, value: Any, what: str, remedy: str, error: type[ContactSystemError] = SceneError
) -> Any:
    """The value; raises the error with the remedy if it is no instance of the kind."""
    if not isinstance(value, kind):
        raise error(f"{what} = {value!r:.80}: give {remedy}")
    return value


def one_of(
    word: Any, known: Iterable[str], what: str, error: type[ContactSystemError] = SceneError
) -> str:
    """The word; raises the error for one that is not known, with the nearest that is."""
    if not isinstance(word, str) or word not in known:
        raise error(
            f"{what} = {word!r} is unknown{did_you_mean(word, known)}; "
            f"use one of {', '.join(known)}"
        )
    return word


def known_keys(table: Mapping, known: Iterable[str], place: str = "") -> None:
    """Raise a SceneError for the first unknown key, with the nearest known one."""
    for key in table:
        one_of(key, known, f"{place}key")


def finite_numbers(
    values: Any, what: str, error: type[ContactSystemError] = SceneError
) -> tuple[float, ...]:
    """The values as a tuple of floats; raises the error if there are none or one is not finite."""
    if type(values) is tuple and values:  # a fast way if there is nothing to convert or refuse
        for x in values:
            if type(x) is not float or not -LARGEST < x < LARGEST:
                break
        else:
            return values
    try:
        if isinstance(values, (set, dict)):  # a set has no order, and a dict gives its keys
            raise TypeError
        found = tuple(map(_as_float, values))
    except (TypeError, ValueError):
        raise error(f"{what} = {values!r}: give a list of numbers") from None
    if not found:
        raise error(f"{what} = {values!r}: give at least one number")
    for k, x in enumerate(found):
        if not abs(x) < LARGEST:
            raise error(f"{what}[{k}] = {x!r}: give a finite number (below 1e100)")
    return found


def finite_number(
    value: Any, what: str, bound: str = "", error: type[ContactSystemError] = SceneError
) -> float:
    """The value as a float; raises the error if it is not finite or not within the bound.

    The bound is "above 0", "not below 0" or "".
    """
    try:
        number = _as_float(value)
    except (TypeError, ValueError):
        number = math.nan
    allowed = number > 0 or not bound or (number == 0 and bound != "above 0")
    if not (allowed and abs(number) < LARGEST):
        limit = "(below 1e100)" if abs(number) >= LARGEST else bound
        raise error(f"{what} = {value!r}: give a finite number {limit}".rstrip())
    return number


def pair(value: Any, what: str, words: Sequence[str] = ()) -> tuple[float, float]:
    """The value as two floats; an error names the words that are allowed besides."""
    # tuple first: a check against an abstract class takes longer
    if type(value) is tuple or (isinstance(value, Iterable) and not isinstance(value, str)):
        found = finite_numbers(value, what)
        if len(found) == 2:
            return found
    choice = "".join(f' or "{word}"' for word in words) + did_you_mean(value, words)
    raise SceneError(f"{what} = {value!r}: give two numbers{choice}")


def whole_number(
    value: Any, what: str, error: type[ContactSystemError] = ContactSystemError
) -> int:
    """The value as an int; raises the error if it is no whole number, or below 1."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < 1:
        raise error(f"{what} = {value!r}: give a whole number, at least 1")
    return int(value)


def _as_float(x: Any) -> float:
    """x as a float, inf if it overflows; TypeError or ValueError if it is no number."""
    if type(x) is float:
        return x
    if isinstance(x, (str, bytes, bool, np.bool_, np.complexfloating)):  # float() takes these too
        raise TypeError
    try:
        return float(x)
    except OverflowError:
        return math.inf


def real_array(values: Any) -> np.ndarray:
    """The values as an array of floats; an array of floats is not copied.

    Raises a TypeError, a ValueError or an OverflowError for anything but real numbers, including
    texts, booleans, complex numbers and None, which numpy would convert, and for masked numbers,
    whose mask it would drop.
    """
    if type(values) is np.ndarray and values.dtype is FLOAT:
        return values
    array = np.asarray(values)
    if isinstance(values, np.ndarray) and np.any(getattr(values, "mask", False)):
        raise TypeError
    kind = array.dtype.kind
    if kind not in "iufO" or (kind == "O" and any(x is None for x in array.flat)):
        raise TypeError
    return array.astype(float, copy=False)


def shaped_array(
    values: Any,
    what: str,
    shape: tuple[int, ...] | None = None,
    error: type[ContactSystemError] = SceneError,
    remedy: str = "numbers",
    finite: bool = False,
) -> np.ndarray:
    """The values as an array of floats; raises the error if they are no numbers of this shape."""
    try:
        array = real_array(values)
    except (TypeError, ValueError, OverflowError):
        remedy += f", shape {shape}" if shape else ""
        raise error(f"{what} = {values!r:.80}: give {remedy}") from None
    if shape is not None and array.shape != shape:
        raise error(f"{what} has shape {array.shape}; give {shape}")
    if finite and not np.isfinite(array).all():
        raise error(f"{what} has a NaN or infinity; give finite {remedy}")
    return array


def rigid_motion(
    pose: np.ndarray, what: str, noise: float, error: type[ContactSystemError] = SceneError
) -> np.ndarray:
    """The pose (4, 4); raises the error if it is no rigid motion, such as a transposed matrix."""
    rotation, last = pose[:3, :3], pose[3] - [0, 0, 0, 1]
    off = max(np.abs(rotation @ rotation.T - np.eye(3)).max(), np.abs(last).max())
    if not (off <= noise and np.linalg.det(rotation) > 0 and np.isfinite(pose).all()):
        raise error(
            f"{what} = {pose.tolist()} is no rotation beside a translation, over a last row 0, 0, "
            "0, 1; give X_OF, the finger's frame in the object's"
        )
    return pose


def a_text(value: Any, what: str) -> str:
    return of_kind(str, value, what, "a text in quotes")


def flag(value: Any, what: str) -> bool:
    """The value as a bool; raises a SceneError for any other, as "no" would count as true."""
    return bool(of_kind((bool, np.bool_), value, what, "True or False"))


def all_of(kind: type | tuple[type, ...], values: Any, what: str, names: str) -> tuple:
    """The values as a tuple; raises unless each is of the kind, which errors call ``names``."""
    # list and tuple first: a check against an abstract class takes longer
    if isinstance(values, (kind, str)) or not isinstance(values, (list, tuple, Iterable)):
        raise SceneError(f"{what} = {values!r}: give a list")
    values = tuple(values)
    for k, value in enumerate(values):
        if not isinstance(value, kind):
            raise SceneError(f"{what}[{k}] = {value!r}: give a {names}")
    return values


def some_of(values: Any, known: Iterable[str], what: str) -> tuple[str, ...]:
    """The words as a tuple; raises a ContactSystemError if there are none or one is not known."""
    words, known = items_of(values), list(known)
    if not words or any(word not in known for word in words):
        raise ContactSystemError(
            f"{what} = {values!r:.80}: give a list of one or more of {', '.join(known)}"
        )
    return words


def items_of(values: Any) -> tuple:
    """The items of an iterable, read once; none for a text or anything else."""
    return tuple(values) if isinstance(values, Iterable) and not isinstance(values, str) else ()
