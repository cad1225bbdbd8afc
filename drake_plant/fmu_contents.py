"""What is in an FMU that FmuSystem can run, its variables port by port, or why it cannot."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from contact_system.checks import Array, require_regular, within
from contact_system.errors import ContactSystemError


def read_description(fmu: Path, folder: Path) -> Any:
    """Of an FMU that FmuSystem can run; or an error that says why it cannot."""
    try:
        xml = folder / "modelDescription.xml"
        require_regular(xml)
        within("DESCRIPTION_BYTES", xml.stat().st_size, "bytes", ContactSystemError)
        description = fmpy.read_model_description(str(folder), validate=False)
        elements = sum(map(size_of, description.modelVariables))
        within("FMU_ELEMENTS", elements, "elements of all its variables", ContactSystemError)
    except Exception as error:  # fmpy raises bare ones
        raise ContactSystemError(
            f"{fmu}: its modelDescription.xml is not one of FMI 2 or 3: {type(error).__name__}: "
            f"{error}; export it again"
        ) from error
    if not description.fmiVersion.startswith(("2.", "3.")):
        raise ContactSystemError(
            f"{fmu} is of FMI {description.fmiVersion}; FmuSystem runs 2.0 and 3.0: "
            "export it again as one of them"
        )
    if description.coSimulation is None:
        raise ContactSystemError(
            f"{fmu} has no co-simulation interface, and FmuSystem has no solver for others: "
            "export it again with co-simulation"
        )
    return description


def library_of(fmu: Path, folder: Path, description: Any) -> Path:
    """The shared library for this machine."""
    name = description.coSimulation.modelIdentifier + fmpy.sharedLibraryExtension
    places = [fmpy.platform_tuple]
    if description.fmiVersion.startswith("2."):  # has names of its own for the older machines
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
