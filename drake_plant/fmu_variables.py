"""Variables of an FMU, read and written port by port."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

Array = np.ndarray

# FMI type -> numpy's, for what a vector port can carry.
KINDS: dict[str, Any] = {"Real": np.float64, "Integer": np.int32, "Boolean": np.bool_}
KINDS |= {"Float32": np.float32, "Float64": np.float64}
KINDS |= {"Int8": np.int8, "Int16": np.int16, "Int32": np.int32, "Int64": np.int64}
KINDS |= {"UInt8": np.uint8, "UInt16": np.uint16, "UInt32": np.uint32, "UInt64": np.uint64}


class PortVariables:
    """The variables of one port, read or written by one call for each FMI type; ``names`` are those
    of the elements, ``x[2]`` for an element of an array."""

    def __init__(self, variables: Sequence[Any], version: int):
        self.names = tuple(itertools.chain.from_iterable(map(element_names, variables)))
        self._calls: list[tuple[str, list[int], Array]] = []
        first = np.cumsum([0, *(size_of(v) for v in variables)])
        for kind in dict.fromkeys(fmi_kind(v, version) for v in variables):
            some = [i for i, v in enumerate(variables) if fmi_kind(v, version) == kind]
            rows = np.concatenate([np.arange(first[i], first[i + 1]) for i in some])
            self._calls.append((kind, [variables[i].valueReference for i in some], rows))
        self._version = version

    def read(self, fmu: Any) -> Array:
        """Values of all elements: (n,)."""
        values = np.empty(len(self.names))
        for kind, references, rows in self._calls:
            sizes = () if self._version == 2 else (len(rows),)
            values[rows] = getattr(fmu, f"get{kind}")(references, *sizes)
        return values

    def write(self, fmu: Any, values: Array) -> None:
        """Set all elements; values: (n,), as :meth:`check` lets through."""
        for kind, references, rows in self._calls:
            getattr(fmu, f"set{kind}")(references, values[rows].astype(KINDS[kind]).tolist())

    def check(self, values: Array) -> str | None:
        """What the variables cannot take, in words."""
        for kind, _, rows in self._calls:
            given = values[rows]
            with np.errstate(invalid="ignore", over="ignore"):
                cast = given.astype(KINDS[kind])
            fine = cast == given if kind != "Float32" else np.isfinite(cast) | np.isinf(given)
            if not fine.all():
                row = rows[~fine][0]
                what = f"not of type {kind}" if values[row] == values[row] else "not a number"
                return f"element {row}, {self.names[row]} = {values[row]:.17g}, is {what}"
        return None


def fmi_kind(variable: Any, version: int) -> str:
    """The FMI type whose functions get and set a variable."""
    if variable.type == "Enumeration":
        return "Integer" if version == 2 else "Int64"
    return variable.type


def size_of(variable: Any) -> int:
    return math.prod(variable.shape or ())


def element_names(variable: Any) -> list[str]:
    """Names of a variable's elements, row by row, counted from 1 as FMI does."""
    if not variable.shape:
        return [variable.name]
    indices = itertools.product(*(range(1, n + 1) for n in variable.shape))
    return [f"{variable.name}[{','.join(map(str, index))}]" for index in indices]


def carried(variable: Any) -> bool:
    """Whether a vector port can carry a variable."""
    return variable.type == "Enumeration" or variable.type in KINDS
