"""A system of FMUs in one file (SSP 1.0): planners, and other models that they are wired to."""

from __future__ import annotations

import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import fmpy
from fmpy.model_description import ModelDescription

from contact_system.checks import did_you_mean, items_of, of_kind, some_of
from contact_system.errors import ContactSystemError
from contact_system.scene import Scene

from . import build
from .description import xml_text
from .export import export_fmu, target, write_fmu

_NAMESPACES = {
    "xmlns:ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "xmlns:ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
}


def export_ssp(
    models: Mapping[str, Scene | str | os.PathLike[str]],
    path: str | os.PathLike[str],
    connections: Iterable[tuple[str, str]] = (),
    platforms: Sequence[str] = ("native",),
) -> Path:
    """Write planners and other models, FMI 2.0 Co-Simulation, as one system in an .ssp file.

    Parameters
    ----------
    models : mapping of name to Scene or path
        Scenes become planners; paths are FMUs of others.
    path : path
        The file to write, such as ``hands.ssp``.
    connections : pairs of str
        From an output to an input, ``("wind.push", "left.contact[1].finger.acceleration.u")``. A
        name that does not begin with a model's is an input or an output of the system, as in
        ``("left.contact[1].slip_speed", "slip")``.
    platforms : sequence of str
        As for `export_fmu`.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ContactSystemError
        Models that are neither scenes nor FMUs, variables that they do not have, and what
        `export_fmu` refuses.
    """
    named = isinstance(models, Mapping) and all(isinstance(n, str) and n for n in models)
    if not (named and models):
        raise ContactSystemError(
            f'models = {models!r:.80}: give Scenes or paths of FMUs by name: {{"left": scene}}'
        )
    path, platforms = target(path), some_of(platforms, build.TARGETS, "platforms")
    files, found = {}, {}
    with tempfile.TemporaryDirectory(prefix="contact-system-") as folder:
        for k, (name, model) in enumerate(models.items()):
            if isinstance(model, Scene):
                arguments = ("2.0", ("CoSimulation",), platforms)
                model = export_fmu(model, Path(folder) / "own.fmu", *arguments)
            source = f"resources/{k + 1}.fmu"  # models' names may need escapes in a URI
            found[name] = source, _read(name, model)
            files[source] = Path(model).read_bytes()
    files["SystemStructure.ssd"] = _structure(found, connections).encode()
    write_fmu(path, files)
    return path


def _read(name: str, path: str | os.PathLike[str]) -> ModelDescription:
    try:
        found = fmpy.read_model_description(os.fspath(path))
    except Exception as error:  # of any kind: the file may be anything
        raise ContactSystemError(
            f"models: '{name}' = {path!r:.80}: neither a Scene nor an FMU: {error}"
        ) from None
    if found.fmiVersion != "2.0" or found.coSimulation is None:
        raise ContactSystemError(f"models: '{name}': systems are made of FMI 2.0 Co-Simulation")
    return found


def _structure(
    models: Mapping[str, tuple[str, ModelDescription]], connections: Iterable[tuple[str, str]]
) -> str:
    """The text of SystemStructure.ssd (SSP 1.0, section 5), of models' files and descriptions."""
    pairs = "pairs, of an output and an input"
    of_kind(Iterable, connections, "connections", pairs, ContactSystemError)
    connectors = {name: ET.Element("ssd:Connectors") for name in ("", *models)}
    wires, kinds = ET.Element("ssd:Connections"), dict[tuple[str, str], str]()
    for pair in connections:
        ends = items_of(pair)
        if len(ends) != 2 or not all(isinstance(end, str) for end in ends):
            raise ContactSystemError(f"connections: {pair!r}: give {pairs}")
        places = [_place(models, *end) for end in zip(ends, ("output", "input"))]
        types = [kind for _, _, kind in places if kind]
        if not types:
            raise ContactSystemError(f"connections: {pair!r}: neither is a variable of a model")
        line: dict[str, str] = {}
        for side, (model, variable, declared) in zip(("start", "end"), places):
            # a connection starts at a model's output or at an input of the system
            kind = "output" if (side == "start") == bool(model) else "input"
            before = kinds.get((model, variable))
            if before and (side == "end" or before != kind):
                raise ContactSystemError(
                    f"connections: {pair!r}: {variable!r} is connected already, as an {before}"
                )
            if not before:  # an enumeration would have to be defined again: no type
                attributes = {"name": variable, "kind": kind}
                connector = ET.SubElement(connectors[model], "ssd:Connector", attributes)
                if (of_type := declared or types[0]) != "Enumeration":
                    ET.SubElement(connector, f"ssc:{of_type}")
            kinds[model, variable] = kind
            line |= {f"{side}Element": model} if model else {}
            line[f"{side}Connector"] = variable
        ET.SubElement(wires, "ssd:Connection", line)
    elements = ET.Element("ssd:Elements")
    for name, (source, _) in models.items():
        attributes = {"name": name, "type": "application/x-fmu-sharedlibrary", "source": source}
        ET.SubElement(elements, "ssd:Component", attributes).extend(filter(len, [connectors[name]]))
    attributes = {**_NAMESPACES, "version": "1.0", "name": "planners"}
    root = ET.Element("ssd:SystemStructureDescription", attributes)
    system = ET.SubElement(root, "ssd:System", name="planners")
    system.extend(part for part in (connectors[""], elements, wires) if len(part))  # none empty
    stops = [getattr(d.defaultExperiment, "stopTime", None) for _, d in models.values()]
    stop = max((float(t) for t in stops if t), default=1.0)
    ET.SubElement(root, "ssd:DefaultExperiment", startTime="0", stopTime=repr(stop))
    return xml_text(root)


def _place(
    models: Mapping[str, tuple[str, ModelDescription]], whole: str, kind: str
) -> tuple[str, str, str]:
    """Model, variable and type at one end of a connection; of the system's own "", whole, ""."""
    model = next((m for m in sorted(models, key=len)[::-1] if whole.startswith(f"{m}.")), "")
    if not model:
        return "", whole, ""
    variables = {v.name: v.type for v in models[model][1].modelVariables if v.causality == kind}
    variable = whole[len(model) + 1 :]
    if variable not in variables:
        near = did_you_mean(variable, variables)
        others = "" if near else f", which has {', '.join(variables) or 'none'}"
        raise ContactSystemError(f"connections: '{whole}' is no {kind} of '{model}'{others}{near}")
    return model, variable, variables[variable]
