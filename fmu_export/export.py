"""`export_fmu`: a scene as one file that FMI importers run without Python; how it is written."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from fmpy.model_description import ValidationError, read_model_description

from contact_system.checks import of_kind, one_of, some_of
from contact_system.errors import ContactSystemError
from contact_system.files import a_path, make_folder, writing
from contact_system.scene import Scene

from . import build, description
from .data import scene_data
from .description import INTERFACES, generation_time
from .reference import reference_files
from .variables import variable_table


def export_fmu(
    scene: Scene,
    path: str | os.PathLike[str],
    fmi_version: str = "2.0",
    interfaces: Sequence[str] = INTERFACES,
    platforms: Sequence[str] = ("native",),
    progress: Callable[[str], None] | None = None,
    arrays: bool = False,
    measured: str = "nothing",
) -> Path:
    """Write a scene as a Functional Mock-up Unit.

    Parameters
    ----------
    scene : Scene
    path : path
        The file to write, such as ``planner.fmu``; its folder is made where it is missing. If
        anything fails, no file is written, and an existing one stays as it is.
    fmi_version : "2.0" or "3.0"
    interfaces : sequence of "CoSimulation" and "ModelExchange"
    platforms : sequence of str
        "native" or, compiled by ziglang, x86_64-linux, aarch64-linux, x86_64-windows,
        x86_64-darwin, aarch64-darwin and (experimental) wasm32; one or more.
    arrays : bool
        FMI 3: vectors and matrices instead of scalars with FMI 2's names.
    measured : "nothing" or "states" or "pose"
        Adds inputs for a measurement, from which a contact goes on: states as from `Plan.states`,
        or the finger's pose and twist relative to the object. Co-Simulation only.
    progress : callable, optional
        Called with the name of each step: one for each platform, and one for the file itself.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ContactSystemError
        A scene that no importer can step, a path that cannot be written to, no ziglang, or an FMU
        that fmpy's validation refuses.
    """
    path, platforms = target(path), some_of(platforms, build.TARGETS, "platforms")
    one_of(fmi_version, description.VERSIONS, "fmi_version")
    interfaces = some_of(interfaces, INTERFACES, "interfaces")
    if measured != "nothing" and "CoSimulation" not in interfaces:
        raise ContactSystemError(
            f"measured = {measured!r}: only Co-Simulation takes measurements; add it to interfaces"
        )
    of_kind((Callable, type(None)), progress, "progress", "a function of a text, or None")
    tell = progress or (lambda step: None)
    table = variable_table(scene, arrays, measured)
    data, token = scene_data(table, fmi_version, *interfaces)
    text = description.model_description(table, token, fmi_version, interfaces)
    name = description.model_identifier(scene)
    # Without FMI's headers: the importer has its own, with a prefix if it wants (FMI 3.0.2, 2.2.2).
    sources = build.c_sources(data, name, fmi_version)
    files = {f"sources/{file}": source.encode() for file, source in sources.items()}
    files["resources/scene.bin"] = data
    files["sources/buildDescription.xml"] = description.build_description(table).encode()
    files["modelDescription.xml"] = text.encode()
    files |= description.companions(table, fmi_version) | reference_files(scene)
    for platform in platforms:
        tell(f"taking the library for {platform}")
        files[build.library_place(name, platform, fmi_version)] = build.library(platform, name)
    tell("packing")
    write_fmu(path, files)
    return path


def target(path: str | os.PathLike[str]) -> Path:
    """The path of a file to write, whose folder is made where it is missing."""
    path = a_path(path)
    make_folder(path.parent, "name a file in a folder that you may write to")
    return path


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
