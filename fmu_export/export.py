"""`export_fmu`: a scene as one file that FMI importers run without Python."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from fmpy.validation import validate_fmu

from contact_system.checks import function_or_none
from contact_system.scene import Scene

from . import build
from .description import (
    INTERFACES,
    build_description,
    check_choice,
    generation_time,
    instantiation_token,
    model_description,
    model_identifier,
)
from .documentation import companions
from .sources import c_sources
from .variables import variable_table


def export_fmu(
    scene: Scene,
    path: str | os.PathLike,
    fmi_version: str = "2.0",
    interfaces: Sequence[str] = INTERFACES,
    platforms: Sequence[str] = ("native",),
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Write a scene as a Functional Mock-up Unit.

    The same scene gives the same bytes but for the date, which ``$SOURCE_DATE_EPOCH`` fixes.

    Parameters
    ----------
    scene : Scene
    path : path
        The file to write, such as ``planner.fmu``; its folder is made where it is missing. No file
        is written, and what is there stays, unless all goes well.
    fmi_version : "2.0" or "3.0"
    interfaces : sequence of "CoSimulation" and "ModelExchange"
    platforms : sequence of str
        "native", or of x86_64-linux, aarch64-linux, x86_64-windows, x86_64-darwin and
        aarch64-darwin those wanted; all but the host's need the ziglang package.
    progress : callable, optional
        Called with what is begun, once for each platform and for the file itself.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ContactSystemError
        A scene that no importer can step, a path that cannot be written to, no compiler, or an
        FMU that fmpy's validation refuses.
    """
    path, moment = build.target(path), generation_time()
    platforms, interfaces = build.chosen(platforms), check_choice(fmi_version, interfaces)
    tell = function_or_none(progress, "progress", "a function of a text") or (lambda step: None)
    table = variable_table(scene)
    token = instantiation_token(model_description(table, fmi_version, interfaces))
    texts = c_sources(table, token, fmi_version)
    sources = sorted(name for name in texts if name.endswith(".c"))
    description = model_description(table, fmi_version, interfaces, sources)
    name = model_identifier(table)
    # FMI's own headers are the importer's, which may give functions a prefix (FMI 3.0.2, 2.2.2).
    files = {f"sources/{file}": text.encode() for file, text in texts.items()}
    texts |= build.headers(fmi_version)
    files["sources/buildDescription.xml"] = build_description(table, sources).encode()
    files["modelDescription.xml"] = description.encode()
    files |= companions(table, fmi_version)
    for platform in platforms:
        tell(f"compiling for {platform}")
        place = build.library_place(name, platform, fmi_version)
        files[place] = build.library(texts, name, platform)
    tell("packing")
    build.write_fmu(path, files, moment[:6], validate_fmu)
    return path
