"""Results of a sweep in a folder: one file a chunk, named and checked by digests."""

from __future__ import annotations

import contextlib
import json
import numbers
import os
import pickle
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..errors import ContactSystemError
from ..scene import scene_text
from ..writing import writing
from .chunk import Failure, Item, Part, Run


def keep(part: Part, path: Path | None) -> Part | Path:
    """The part, or its file."""
    if path is None:
        return part
    failures = json.dumps([asdict(failure) for failure in part.failures])
    with writing(path) as file:
        seal = _seal(path, part.table, failures)
        np.savez(file, table=part.table, failures=failures, seal=seal)
    return path


def read(path: Path) -> Part | None:
    """What is kept; None where the file is not there, is damaged or holds other results."""
    try:
        with np.load(path) as data:
            table, failures = data["table"], str(data["failures"])
            if str(data["seal"]) != _seal(path, table, failures):
                return None
            return Part(table, [Failure(**fields) for fields in json.loads(failures)])
    except Exception:  # whatever a file of another kind, or a damaged one, leads to
        return None


def _seal(path: Path, table: np.ndarray, failures: str) -> str:
    """Digest of what a file holds and, as its name does, of what that was made from."""
    import hashlib  # slow to import, and of no use but with a folder

    said = f"{path.name} {table.dtype.descr} {table.shape} {failures}"
    return hashlib.sha256(said.encode() + table.tobytes()).hexdigest()


def digest(run: Run, first: int, items: tuple[Item, ...]) -> str:
    """Of all that decides a chunk's results."""
    import hashlib

    from .. import __version__

    evaluate, tolerance, _ = run.args
    name = getattr(evaluate, "__qualname__", "")
    # a lambda has no name of its own, and a method's result depends on its object
    if not name or "<lambda>" in name or hasattr(evaluate, "__self__"):
        known = _pickled(evaluate)
    else:
        known = f"{evaluate.__module__}.{name} {_enclosed(evaluate)}".encode()
    found = hashlib.sha256(known + f"{__version__} {tolerance!r} {first}".encode())
    for item in items:
        found.update(_content(item))
    return found.hexdigest()[:32]


def _enclosed(function: Callable) -> str:
    """What a function made inside another one takes from there, as far as it stays what it is."""
    values = []
    for cell in getattr(function, "__closure__", None) or ():
        with contextlib.suppress(ValueError):  # a name that has no value yet
            if isinstance(cell.cell_contents, (numbers.Number, str, tuple, np.ndarray)):
                values.append(cell.cell_contents)
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):  # arrays in full
        return repr(values)


def _content(item: Item) -> bytes:
    """What tells an item from others: of a file also what is in it now."""
    if callable(item):  # its repr is its address
        return _pickled(item)
    said = repr(item)  # pickles of equal scenes may differ
    if isinstance(item, (str, os.PathLike)):
        try:
            said += scene_text(item)[0]
        except ContactSystemError as error:
            said += str(error)
    return said.encode()


def _pickled(function: Callable) -> bytes:
    try:
        return pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ContactSystemError(
            f"{function!r}: a sweep with a folder must know it again ({error}); give a function of "
            "a module, or functools.partial of one"
        ) from None
