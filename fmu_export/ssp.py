"""A system of FMUs in one file (SSP 1.0): planners, each wired to a block that uses what it says.

The block adds up how far each contact has slid (c/slip_integrator.c); it stands where a user's own
model will. Disturbance inputs of the planners are inputs of the system.
"""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from fmpy.validation import validate_fmu

from contact_system.errors import ContactSystemError
from contact_system.scene import Scene

from . import build
from .description import add_log_categories, add_unit, generation_text, generation_time, xml_text
from .export import export_fmu
from .variables import Table, Unit, unit_name, variable_table

CONSUMER = "slip_integrator"
SLIP, DISTANCE = (1, -1, 0), (1, 0, 0)  # exponents of m, s, rad
_SSD, _SSC = (f"http://ssp-standard.org/SSP1/SystemStructure{x}" for x in ("Description", "Common"))


def export_ssp(
    scenes: Scene | Mapping[str, Scene],
    path: str | os.PathLike,
    platforms: Sequence[str] = ("native",),
) -> Path:
    """Write a system of planners and consumers, FMI 2.0 Co-Simulation, as one .ssp file.

    Outputs of the system are the distances that contacts have slid, ``distance[1]``, ... in m;
    inputs are the planners' disturbances, under their own names. With several scenes, names begin
    with the planner's: ``left.distance[1]``.

    Parameters
    ----------
    scenes : Scene or mapping of name to Scene
    path : path
        The file to write, such as ``planner.ssp``.
    platforms : sequence of str
        As for `export_fmu`.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ContactSystemError
        Something else than scenes, a scene that no importer can step, no compiler, or an FMU that
        fmpy's validation refuses.
    """
    named = {"": scenes} if isinstance(scenes, Scene) else scenes
    if not (isinstance(named, Mapping) and named and all(isinstance(n, str) for n in named)):
        raise ContactSystemError(
            f'scenes = {scenes!r:.80}: give a Scene, or Scenes by name, such as {{"left": scene}}'
        )
    path, moment, platforms = build.target(path), generation_time(), build.chosen(platforms)
    tables = {name: variable_table(scene) for name, scene in named.items()}
    stems = _file_stems(named)
    files = {"SystemStructure.ssd": system_structure(tables).encode()}
    with tempfile.TemporaryDirectory(prefix="contact-system-") as folder:
        for name, scene in named.items():
            planner, consumer = _elements(stems[name])
            own = export_fmu(scene, Path(folder) / "own.fmu", "2.0", ("CoSimulation",), platforms)
            files[f"resources/{planner}.fmu"] = own.read_bytes()
            other = _export_consumer(len(scene.contacts), Path(folder) / "other.fmu", platforms)
            files[f"resources/{consumer}.fmu"] = other.read_bytes()
    build.write_fmu(path, files, moment[:6])
    return path


def _file_stems(names: Iterable[str]) -> dict[str, str]:
    """Name -> what files begin with: nothing that a file name or a URI would need to escape."""
    found: dict[str, str] = {}
    for k, name in enumerate(names):
        stem = re.sub(r"\W", "_", name[:100], flags=re.ASCII)
        while stem.lower() in (known.lower() for known in found.values()):  # as Windows takes them
            stem = f"{stem}_{k + 1}"
        found[name] = stem
    return found


def _elements(name: str) -> tuple[str, str]:
    """Names of a planner and its consumer in the system."""
    prefix = f"{name}_" if name else ""
    return f"{prefix}planner", f"{prefix}{CONSUMER}"


# --- the system ----------------------------------------------------------------------------------


def system_structure(tables: Mapping[str, Table]) -> str:
    """The text of SystemStructure.ssd (SSP 1.0, section 5)."""
    ET.register_namespace("ssd", _SSD)
    ET.register_namespace("ssc", _SSC)
    root = ET.Element(f"{{{_SSD}}}SystemStructureDescription", version="1.0", name="planners")
    system = _add(root, "System", name="planners")
    outside, elements, connections = (
        _add(system, tag) for tag in ("Connectors", "Elements", "Connections")
    )
    units: set[Unit] = {SLIP, DISTANCE}
    stems = _file_stems(tables)
    for name, table in tables.items():
        prefix = f"{name}." if name else ""
        planner, consumer = _elements(name)
        own, other = (
            _component(elements, element, file)
            for element, file in zip((planner, consumer), _elements(stems[name]))
        )
        for v in (v for v in table.scalars() if v.causality == "input"):
            _connect(connections, ("", prefix + v.name), (planner, v.name))
            _connector(outside, prefix + v.name, "input", v.unit)
            _connector(own, v.name, "input", v.unit)
            units |= set() if v.unit is None else {v.unit}
        for i in range(len(table.blocks)):
            for axis in "xy":
                start, end = f"contact[{i + 1}].slip.{axis}", f"slip[{i + 1}].{axis}"
                _connector(own, start, "output", SLIP)
                _connector(other, end, "input", SLIP)
                _connect(connections, (planner, start), (consumer, end))
            slid = f"distance[{i + 1}]"
            _connector(other, slid, "output", DISTANCE)
            _connector(outside, prefix + slid, "output", DISTANCE)
            _connect(connections, (consumer, slid), ("", prefix + slid))
    declared = _add(root, "Units")
    for unit in sorted(units):
        add_unit(declared, unit, f"{{{_SSC}}}")
    stop = max(table.scene.duration for table in tables.values())
    _add(root, "DefaultExperiment", startTime="0", stopTime=repr(stop))
    return xml_text(root)


def _add(parent: ET.Element, tag: str, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, f"{{{_SSD}}}{tag}", attributes)


def _component(elements: ET.Element, name: str, file: str) -> ET.Element:
    """A component, for its connectors."""
    component = _add(
        elements,
        "Component",
        name=name,
        type="application/x-fmu-sharedlibrary",
        source=f"resources/{file}.fmu",
    )
    return _add(component, "Connectors")


def _connector(parent: ET.Element, name: str, kind: str, unit: Unit | None) -> None:
    said = {} if unit is None else {"unit": unit_name(unit)}
    ET.SubElement(_add(parent, "Connector", name=name, kind=kind), f"{{{_SSC}}}Real", said)


def _connect(parent: ET.Element, start: tuple[str, str], end: tuple[str, str]) -> None:
    """From (element, connector) to the same; no element: the system itself."""
    attributes = {}
    for side, (element, connector) in (("start", start), ("end", end)):
        if element:
            attributes[f"{side}Element"] = element
        attributes[f"{side}Connector"] = connector
    _add(parent, "Connection", **attributes)


# --- the consumer --------------------------------------------------------------------------------


def _export_consumer(count: int, path: Path, platforms: Sequence[str]) -> Path:
    """The FMU of c/slip_integrator.c for so many contacts."""
    text = (Path(__file__).parent / "c" / f"{CONSUMER}.c").read_text("utf-8")
    token = "{" + hashlib.sha256(f"{count} {text}".encode()).hexdigest()[:32] + "}"
    header = f'#define N_CONTACTS {count}\n#define TOKEN "{token}"\n'
    texts = {f"{CONSUMER}.c": text, f"{CONSUMER}.h": header}
    files = {f"sources/{name}": source.encode() for name, source in texts.items()}
    texts |= build.headers("2.0")
    files["modelDescription.xml"] = _consumer_description(count, token).encode()
    for platform in platforms:
        place = build.library_place(CONSUMER, platform, "2.0")
        files[place] = build.library(texts, CONSUMER, platform)
    build.write_fmu(path, files, generation_time()[:6], validate_fmu)
    return path


def _consumer_description(count: int, token: str) -> str:
    """The text of its modelDescription.xml."""
    head = {"fmiVersion": "2.0", "modelName": CONSUMER, "guid": token}
    head |= {"description": "Adds up how far contacts have slid"}
    head |= {"variableNamingConvention": "structured", "generationDateAndTime": generation_text()}
    root = ET.Element("fmiModelDescription", head)
    flags = ("canHandleVariableCommunicationStepSize", "canNotUseMemoryManagementFunctions")
    interface = {"modelIdentifier": CONSUMER} | dict.fromkeys(flags, "true")
    files = ET.SubElement(ET.SubElement(root, "CoSimulation", interface), "SourceFiles")
    ET.SubElement(files, "File", name=f"{CONSUMER}.c")
    units = ET.SubElement(root, "UnitDefinitions")
    for unit in (DISTANCE, SLIP):
        add_unit(units, unit)
    add_log_categories(root, ["logStatusError"])
    variables = ET.SubElement(root, "ModelVariables")
    slips = [f"slip[{i + 1}].{axis}" for i in range(count) for axis in "xy"]
    distances = [f"distance[{i + 1}]" for i in range(count)]
    for reference, name in enumerate(slips + distances):
        taken = reference < len(slips)
        common = {"name": name, "valueReference": str(reference), "variability": "continuous"}
        common |= {"causality": "input"} if taken else {"causality": "output", "initial": "exact"}
        variable = ET.SubElement(variables, "ScalarVariable", common)
        ET.SubElement(variable, "Real", start="0", unit=unit_name(SLIP if taken else DISTANCE))
    outputs = ET.SubElement(ET.SubElement(root, "ModelStructure"), "Outputs")
    for i in range(count):  # a state: it does not depend on the inputs of the same moment
        ET.SubElement(outputs, "Unknown", index=str(len(slips) + 1 + i), dependencies="")
    return xml_text(root)
