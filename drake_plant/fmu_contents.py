"""Reads an FMU, and refuses one that FmuSystem cannot run; variables of the system's ports."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from contact_system.checks import Array
from contact_system.errors import ContactSystemError


def read_description(fmu: Path, folder: Path) -> Any:
    """The model description; raises an error that says why FmuSystem cannot run the FMU."""
    try:
        description = fmpy.read_model_description(str(folder), validate=False)
    except Exception as error:  # fmpy raises errors of the class Exception itself
        raise ContactSystemError(
            f"{fmu}: its modelDescription.xml is not one of FMI 2 or 3: {type(error).__name__}: "
            f"{error}; export it again"
        ) from error
    if description.fmiVersion[0] not in "23" or description.coSimulation is None:
        raise ContactSystemError(
            f"{fmu} has no co-simulation interface of FMI 2 or 3, and FmuSystem has no solver for "
            "others: export it again with co-simulation"
        )
    return description


def library_of(fmu: Path, folder: Path, description: Any) -> Path:
    """The shared library for this machine."""
    name = description.coSimulation.modelIdentifier + fmpy.sharedLibraryExtension
    places = [fmpy.platform_tuple]
    if description.fmiVersion.startswith("2."):  # where, for one, x86_64-linux is linux64
        places.append(fmpy.platform)
    for place in places:
        path = folder / "binaries" / place / name
        if path.is_file():
            return path
    there = ", ".join(sorted(p.parent.name for p in folder.glob("binaries/*/*"))) or "none"
    remedy = "export it again for this machine"
    if any(folder.glob("sources/*.c")):
        remedy += f", or compile its sources here: python -m fmpy compile {fmu}"
    raise ContactSystemError(
        f"{fmu} has no binaries/{' or '.join(places)}/{name}; platforms that it has: {there}; "
        + remedy
    )


# --- variables ------------------------------------------------------------------------------------

# FMI type -> numpy type, for the types that a vector port can carry.
KINDS: dict[str, Any] = {"Real": np.float64, "Integer": np.int32, "Boolean": np.bool_}
KINDS |= {"Float32": np.float32, "Float64": np.float64}
KINDS |= {"Int8": np.int8, "Int16": np.int16, "Int32": np.int32, "Int64": np.int64}
KINDS |= {"UInt8": np.uint8, "UInt16": np.uint16, "UInt32": np.uint32, "UInt64": np.uint64}


class PortVariables:
    """The variables of one port, read and written by one call for each FMI type; ``names`` has a
    name for each element, such as ``x[2]`` for an element of an array."""

    def __init__(self, variables: Sequence[Any], version: int):
        self.names = tuple(itertools.chain.from_iterable(map(element_names, variables)))
        self._calls: list[tuple[str, list[int], Array]] = []  # type, references, elements
        first = np.cumsum([0, *map(size_of, variables)])
        enumeration = "Integer" if version == 2 else "Int64"  # the type that gets and sets it
        kinds = [enumeration if v.type == "Enumeration" else v.type for v in variables]
        for kind in dict.fromkeys(kinds):
            some = [i for i, other in enumerate(kinds) if other == kind]
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
        """Set all elements to values, (n,), in which :meth:`check` found no problem."""
        for kind, references, rows in self._calls:
            getattr(fmu, f"set{kind}")(references, values[rows].astype(KINDS[kind]).tolist())

    def check(self, values: Array) -> str | None:
        """The first value that its variable cannot take, in words; None if there is none."""
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


def size_of(variable: Any) -> int:
    """The number of elements: 1, or those of an array."""
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
