"""Checks of what users write, and messages that name the place, the value and the remedy."""

from __future__ import annotations

import difflib
import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from .errors import ContactSystemError, SceneError

FLOAT = np.dtype(float)
LARGEST = 1e100  # beyond this sigma^3 overflows; it is no path speed anyway


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Put the place in front of every error of the package raised inside."""
    try:
        yield
    except ContactSystemError as error:
        raise SceneError(f"{place}: {error}") from None


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """ " (did you mean '...'?)" with the nearest known word, or nothing."""
    by_lower = {k.lower(): k for k in known}
    close = difflib.get_close_matches(str(word).lower(), by_lower, n=1, cutoff=0.5)
    return f" (did you mean '{by_lower[close[0]]}'?)" if close else ""


def known_keys(table: Mapping, known: Iterable[str], place: str = "") -> None:
    """Raise a SceneError for the first key that is not known, with the nearest that is."""
    for key in table:
        if key not in known:
            raise SceneError(
                f"{place}key '{key}' is unknown{did_you_mean(key, known)}; "
                f"the keys here are {', '.join(known)}"
            )


def is_plain(values: Any) -> TypeGuard[tuple[float, ...]]:
    """True for a tuple of finite floats, as kept: nothing to convert and nothing to refuse."""
    if type(values) is not tuple or not values:
        return False
    for x in values:
        if type(x) is not float or not -LARGEST < x < LARGEST:
            return False
    return True


def finite_numbers(values: Iterable[Any], what: str) -> tuple[float, ...]:
    """The values as a tuple of floats.

    Raises
    ------
    SceneError
        If there are none, or one is not a finite number; `what` names them in the message.
    """
    plain = tuple(values) if type(values) is list else values
    if is_plain(plain):
        return plain
    try:
        # float() would take all of these, numpy's complex numbers for their real parts; the
        # numbers of a set have no order, a table gives its keys and bytes their codes
        if isinstance(values, (str, bytes, set, frozenset, Mapping)) or any(
            isinstance(x, (bool, str)) or np.iscomplexobj(x) for x in values
        ):
            raise TypeError
        found = tuple(float(x) for x in values)
    except OverflowError:  # an integer beyond floating point
        found = (math.inf,)
    except (TypeError, ValueError):
        raise SceneError(f"{what} = {values!r}: give a list of numbers") from None
    if not found:
        raise SceneError(f"{what} = {values!r}: give at least one number")
    for k, x in enumerate(found):
        if not abs(x) < LARGEST:
            raise SceneError(f"{what}[{k}] = {x!r}: give a finite number (below 1e100)")
    return found


def finite_number(
    value: Any, what: str, bound: str = "", error: type[ContactSystemError] = SceneError
) -> float:
    """The value as a float.

    Parameters
    ----------
    value : number
    what : str
        Its name, for the message.
    bound : "", "above 0" or "not below 0"
    error : what to raise

    Raises
    ------
    error
        If it is no finite number within the bound.
    """
    if is_plain((value,)):
        number = value
    else:
        try:
            # float() would take all of these, numpy's complex numbers for their real parts
            wrong = isinstance(value, (str, bytes, bool, np.bool_)) or np.iscomplexobj(value)
            number = math.nan if wrong else float(value)
        except OverflowError:  # an integer beyond floating point, perhaps too long to be shown
            value = number = math.inf
        except (TypeError, ValueError):
            number = math.nan
    within = number > 0 or not bound or (number == 0 and bound != "above 0")
    if not (within and abs(number) < LARGEST):
        limit = "(below 1e100)" if abs(number) >= LARGEST else bound
        raise error(f"{what} = {value!r}: give a finite number {limit}".rstrip())
    return number


def real_array(values: Any) -> np.ndarray:
    """The values as an array of floats, itself where it is one.

    Raises
    ------
    TypeError, ValueError, OverflowError
        They are texts, truth values, complex numbers or None, which numpy would take, or no
        numbers.
    """
    given = np.asarray(values)
    if given.dtype is FLOAT:  # what most are costs no more
        return given
    if given.dtype.kind not in "iufO":
        raise TypeError
    if given.dtype.kind == "O" and any(x is None for x in given.flat):  # NaN to numpy
        raise TypeError
    return given.astype(float, copy=False)


def flag(value: Any, what: str, none: bool = False) -> Any:
    """The value as a bool, or None where that has a meaning.

    Raises
    ------
    SceneError
        It is something else, as "no", which counts as true; `what` names it in the message.
    """
    if none and value is None:
        return None
    if not isinstance(value, (bool, np.bool_)):
        raise SceneError(f"{what} = {value!r}: give True or False" + ", or None" * none)
    return bool(value)


def a_path(value: Any, what: str = "path") -> Path:
    """The path, from all that names files in Python.

    Raises
    ------
    SceneError
        It is something else, as a scene where arguments are exchanged.
    """
    try:
        found = os.fsdecode(value)
        if "\0" in found:
            raise TypeError
    except TypeError:
        raise SceneError(f"{what} = {value!r:.80}: give a path") from None
    return Path(found)


def items_of(values: Any) -> tuple:
    """What is in a list, or in an iterator, gone through once; nothing of a text or of another."""
    return tuple(values) if isinstance(values, Iterable) and not isinstance(values, str) else ()


def function_or_none(value: Any, what: str, remedy: str) -> Any:
    """The value, a function or None.

    Raises
    ------
    SceneError
        It is something else; `remedy` says what the function is of.
    """
    if value is not None and not callable(value):
        raise SceneError(f"{what} = {value!r:.80}: give {remedy}, or None")
    return value


def make_folder(path: Path, remedy: str) -> Path:
    """The folder, made if it is not there.

    Raises
    ------
    ContactSystemError
        It cannot be made; the message ends with the remedy.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ContactSystemError(f"no folder '{path}': {error.strerror}; {remedy}") from None
    return path


@contextmanager
def writing(path: Path, place: str = "") -> Iterator[None]:
    """Say in one line why a file cannot be written."""
    try:
        yield
    except OSError as error:
        raise SceneError(
            f"{place}'{path}' cannot be written: {error.strerror or error}; give a path in a "
            "folder that is there and can be written to"
        ) from None


def is_device(name: str) -> bool:
    """Whether Windows takes a file of this name, with any ending, for a device."""
    return re.match(r"(con|prn|aux|nul|(com|lpt)[0-9])(\.|$)", name, re.IGNORECASE) is not None
