"""Results of a sweep in a folder: one file for each chunk, named by a digest."""

from __future__ import annotations

import contextlib
import hashlib
import json
import numbers
import os
import pickle
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..errors import ContactSystemError
from ..files import writing
from ..scene import Contact, Scene, scene_text
from ..surfaces import Surface
from ..theory.gain import LAWS, Gain
from ..theory.profile import Profile
from .chunk import Failure, Item, Part, Run


def store(part: Part, path: Path) -> Path:
    """Write a part to a file; returns the path."""
    failures = json.dumps([asdict(failure) for failure in part.failures])
    with writing(path) as file:
        np.savez(file, table=part.table, failures=failures)
    return path


def read(path: Path) -> Part | None:
    """The part in a file; None if the file is missing or damaged."""
    try:
        with np.load(path) as data:
            failures = json.loads(str(data["failures"]))
            return Part(data["table"], [Failure(**fields) for fields in failures])
    except Exception:  # a damaged or foreign file may raise anything
        return None


def digest(run: Run, first: int, items: tuple[Item, ...]) -> str:
    """Digest of everything that determines a chunk's results."""
    evaluate, tolerance, _ = run.args
    result = hashlib.sha256(_identity(evaluate))
    result.update(f"{__version__} {LAWS} {tolerance!r} {first}".encode())
    for item in items:
        result.update(_content(item))
    return result.hexdigest()[:32]


def _identity(function: Callable, *outer: Callable) -> bytes:
    """A function's name, and the numbers, texts, tuples, arrays, parts of scenes and functions in
    its closure and defaults of arguments. Lists and dicts are left out, as it may write to them."""
    name = getattr(function, "__qualname__", "")
    # a lambda has no name, and a method's result depends on its object
    if not name or "<lambda>" in name or hasattr(function, "__self__"):
        return _pickled(function)
    found = [*(getattr(function, "__defaults__", None) or ())]
    found += (getattr(function, "__kwdefaults__", None) or {}).values()
    for cell in getattr(function, "__closure__", None) or ():
        with contextlib.suppress(ValueError):  # a name without a value yet
            found.append(cell.cell_contents)
    kinds = (numbers.Number, str, tuple, np.ndarray, Scene, Surface, Contact, Profile, Gain)
    values: list[Any] = [value for value in found if isinstance(value, kinds)]
    if "<locals>" in name:  # the name of another tells which functions it has
        outer += (function,)  # one that calls itself has itself
        values += [_identity(x, *outer) for x in found if callable(x) and x not in outer]
    module = getattr(function, "__module__", "")  # methods of types in C have none
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):  # arrays in full
        return f"{module}.{name} {values!r}".encode()


def _content(item: Item) -> bytes:
    """What identifies an item; for a file also its present contents."""
    if callable(item):  # its repr is its address
        return _pickled(item)
    text = repr(item)  # pickles of equal scenes may differ
    if isinstance(item, (str, os.PathLike)):
        try:
            text += scene_text(item)[0]
        except ContactSystemError as error:
            text += str(error)
    return text.encode()


def _pickled(function: Callable) -> bytes:
    try:
        return pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ContactSystemError(
            f"{function!r}: a sweep with a folder must recognise it later ({error}); give a "
            "function of a module, or functools.partial of one"
        ) from None
