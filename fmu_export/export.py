"""`export_fmu`: a scene as one file that FMI importers run without Python."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from contact_system.checks import of_kind, one_of, some_of
from contact_system.errors import ContactSystemError
from contact_system.scene import Scene

from . import build, description
from .archive import target, write_fmu
from .data import scene_data
from .description import INTERFACES
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
