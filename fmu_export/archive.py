"""Writes .fmu and .ssp files, and checks FMUs once they are written."""

from __future__ import annotations

import os
import time
import zipfile
from collections.abc import Mapping
from pathlib import Path

from fmpy.model_description import ValidationError, read_model_description

from contact_system.errors import ContactSystemError
from contact_system.files import a_path, make_folder, writing


def target(path: str | os.PathLike[str]) -> Path:
    """The path of a file to write, whose folder is made where it is missing."""
    path = a_path(path)
    make_folder(path.parent, "name a file in a folder that you may write to")
    return path


def generation_time() -> time.struct_time:
    """Now, or ``$SOURCE_DATE_EPOCH``, in UTC."""
    return time.gmtime(int(os.environ.get("SOURCE_DATE_EPOCH") or time.time()))


def write_fmu(path: Path, files: Mapping[str, bytes]) -> None:
    """Write a zip file whose bytes depend on the files and the `generation_time` only.

    If fmpy's validation finds a problem in an FMU's description, no file is written or replaced.
    Variables' names are not validated, as their grammar would take nearly all of the time.
    """
    stamp = max(generation_time()[:6], (1980, 1, 1, 0, 0, 0))  # zip's first year
    with writing(path) as file:
        with zipfile.ZipFile(file, "w") as archive:
            for name in sorted(files):
                entry = zipfile.ZipInfo(name, stamp)
                entry.create_system, entry.external_attr = 3, 0o100644 << 16  # as on Unix
                # level 6 takes three times as long for 12 % less
                archive.writestr(entry, files[name], zipfile.ZIP_DEFLATED, 1)
        file.flush()
        if "modelDescription.xml" in files:
            try:
                read_model_description(file.name, validate=True, validate_model_structure=True)
            except ValidationError as error:
                problems = "; ".join(error.problems)
                raise ContactSystemError(f"{path}: fmpy's validation says: {problems}") from None
