"""What is in the files of an FMU that FmuSystem can run, or why it cannot."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

import fmpy

from contact_system.checks import require_regular, within
from contact_system.errors import ContactSystemError

from .fmu_variables import size_of


def read_description(fmu: Path, folder: Path) -> Any:
    """Of an FMU that FmuSystem can run; or an error that says why it cannot."""
    try:
        xml = folder / "modelDescription.xml"
        require_regular(xml)
        within("DESCRIPTION_BYTES", xml.stat().st_size, "bytes", ContactSystemError)
        description = fmpy.read_model_description(str(folder), validate=False)
        _require_sane(description)
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


def _require_sane(description: Any) -> None:
    """What is used of a description and fmpy takes as it is."""
    for v in description.modelVariables:
        if not v.name or min(v.shape or (0,)) < 0:
            raise ContactSystemError(f"variable {v.name!r} has shape {v.shape}")
    elements = sum(map(size_of, description.modelVariables))
    within("FMU_ELEMENTS", elements, "elements of all its variables", ContactSystemError)
    if description.coSimulation is not None:
        name = description.coSimulation.modelIdentifier
        if not re.fullmatch(r"[A-Za-z_]\w{0,199}", str(name), re.ASCII):  # it names a file
            raise ContactSystemError(f"modelIdentifier = {name!r} is no plain word, as C has them")


def _require_whole(fmu: Path, library: Path) -> None:
    """Refuse a library of Linux that is cut: to load it would end the process."""
    with open(library, "rb") as file:
        head = file.read(64)
        if len(head) < 64 or head[:6] != b"\x7fELF\2\1":  # what loads it names what it is not
            return
        programs, sections = struct.unpack_from("<QQ", head, 32)
        sizes = struct.unpack_from("<4H", head, 54)  # of an entry of each, how many
        file.seek(min(programs, 1 << 40))
        rows = file.read(sizes[0] * sizes[1])
    ends = [programs + sizes[0] * sizes[1], sections + sizes[2] * sizes[3]]
    for k in range(0, len(rows) - 39, max(sizes[0], 1)):
        ends.append(sum(struct.unpack_from("<Q16xQ", rows, k + 8)))
    if max(ends) > library.stat().st_size:
        raise ContactSystemError(
            f"{fmu}: its library {library.name} is cut, of {library.stat().st_size} bytes where "
            f"{max(ends)} belong; export it again"
        )


def library_of(fmu: Path, folder: Path, description: Any) -> Path:
    """The shared library for this machine."""
    name = description.coSimulation.modelIdentifier + fmpy.sharedLibraryExtension
    places = [fmpy.platform_tuple]
    if description.fmiVersion.startswith("2."):  # has names of its own for the older machines
        places.append(fmpy.platform)
    for place in places:
        path = folder / "binaries" / place / name
        if path.is_file():
            _require_whole(fmu, path)
            return path
    there = ", ".join(sorted(p.parent.name for p in folder.glob("binaries/*/*"))) or "none"
    remedy = "export it again for this machine"
    if any(folder.glob("sources/*.c")):
        remedy += f", or compile its sources here: python -m fmpy compile {fmu}"
    raise ContactSystemError(
        f"{fmu} has no binaries/{' or '.join(places)}/{name}; platforms that it has: {there}; "
        + remedy
    )
