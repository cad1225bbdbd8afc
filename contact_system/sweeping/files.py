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
    name = getattr(evaluate, "__qualname__", "")
    # a lambda has no name, and a method's result depends on its object
    if not name or "<lambda>" in name or hasattr(evaluate, "__self__"):
        function = _pickled(evaluate)
    else:
        function = f"{evaluate.__module__}.{name} {_enclosed(evaluate)}".encode()
    result = hashlib.sha256(function + f"{__version__} {LAWS} {tolerance!r} {first}".encode())
    for item in items:
        result.update(_content(item))
    return result.hexdigest()[:32]


def _enclosed(function: Callable) -> str:
    """The numbers, texts, tuples, arrays and parts of scenes in a function's closure and defaults
    of arguments, as text. Lists and dicts are left out, as the function may write to them."""
    found = [*(getattr(function, "__defaults__", None) or ())]
    found += (getattr(function, "__kwdefaults__", None) or {}).values()
    for cell in getattr(function, "__closure__", None) or ():
        with contextlib.suppress(ValueError):  # a name without a value yet
            found.append(cell.cell_contents)
    kinds = (numbers.Number, str, tuple, np.ndarray, Scene, Surface, Contact, Profile, Gain)
    values = [value for value in found if isinstance(value, kinds)]
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):  # arrays in full
        return repr(values)


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
