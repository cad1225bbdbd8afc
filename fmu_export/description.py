"""Writes modelDescription.xml (FMI 2.0.4 and 3.0.2) and its companions from a table of variables.

All of it is text for an importer; what the variables mean is in :mod:`.variables`.
"""

from __future__ import annotations

import math
import os
import re
import time
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from html import escape
from importlib import metadata
from pathlib import Path
from string import Template

from contact_system import __version__
from contact_system.scene import Scene

from .build import SOURCES
from .quantities import Unit, Variable, unit_name
from .variables import Table

HERE, VERSIONS = Path(__file__).parent, ("2.0", "3.0")
INTERFACES = ("CoSimulation", "ModelExchange")
LOG_CATEGORIES = {
    "logStatusDiscard": "Requests that were refused; the instance is as it was before",
    "logStatusError": "Calls and values that the standard does not allow, and failed computations",
}
"""Name -> meaning; the names are those of FMI 2.0.4, table in section 2.2.4."""

_BOTH = {
    "2.0": "canNotUseMemoryManagementFunctions canGetAndSetFMUstate canSerializeFMUstate "
    "providesDirectionalDerivative",
    "3.0": "canGetAndSetFMUState canSerializeFMUState providesDirectionalDerivatives "
    "providesAdjointDerivatives",
}
_OWN = {
    ("2.0", "ModelExchange"): "",
    ("2.0", "CoSimulation"): "canHandleVariableCommunicationStepSize",
    ("3.0", "ModelExchange"): "needsCompletedIntegratorStep",
    ("3.0", "CoSimulation"): "canHandleVariableCommunicationStepSize mightReturnEarlyFromDoStep "
    "hasEventMode",
}
"""Flags that are true: those that both interfaces have, and those of one."""


def model_description(
    table: Table,
    token: str,
    fmi_version: str = "2.0",
    interfaces: Sequence[str] = INTERFACES,
) -> str:
    """The text of modelDescription.xml; token: of `data.scene_data`."""
    head = _head(table, fmi_version)
    head["guid" if fmi_version == "2.0" else "instantiationToken"] = token
    root = ET.Element("fmiModelDescription", head)
    # The schemas want Model Exchange first.
    root.extend(_interface(table, fmi_version, i) for i in sorted({*interfaces}, reverse=True))
    root.append(_unit_definitions(table))
    root.append(_type_definitions(table, fmi_version))
    categories = ET.SubElement(root, "LogCategories")
    for name, words in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=words)
    scene, horizon = table.scene, table.scene.duration
    smallest = min(surface.size for surface in scene.surfaces)
    fastest = table["contact[1].path.speed"].nominal or 0.0
    # so that Euler's method moves a contact by less than a tenth of a body's size
    steps = max(500, math.ceil(10 * fastest * horizon / smallest / 100) * 100)
    # Fingers' frames turn again and again: D3 by CVode is 8e-8 off at 1e-11, 1e-8 at 1e-12.
    experiment = {"startTime": "0", "stopTime": _number(horizon), "tolerance": "1e-12"}
    ET.SubElement(root, "DefaultExperiment", experiment, stepSize=_number(horizon / steps))
    variables = ET.SubElement(root, "ModelVariables")
    exchange = "ModelExchange" in interfaces
    variables.extend(_variable(v, fmi_version, exchange) for v in table.listed(fmi_version))
    root.append(_structure(table, fmi_version))
    return xml_text(root)


def model_identifier(scene: Scene) -> str:
    """The scene's name as a C identifier, which names files too."""
    name = re.sub(r"\W", "_", scene.name[:100], flags=re.ASCII)
    return name if re.match("[A-Za-z]", name) else f"scene_{name}".rstrip("_")


# --- head ----------------------------------------------------------------------------------------


def generation_time() -> time.struct_time:
    """Now, or ``$SOURCE_DATE_EPOCH``, in UTC."""
    return time.gmtime(int(os.environ.get("SOURCE_DATE_EPOCH") or time.time()))


def _head(table: Table, fmi_version: str) -> dict[str, str]:
    scene = table.scene
    plain = all(row.name.isascii() for row in table.rows)  # a user's parameter may be called λ
    head = {
        "fmiVersion": fmi_version,
        "modelName": scene.name or "scene",
        "description": scene.description or "Rolling contact curves",
        "version": __version__,
        "generationTool": f"contact-system {__version__}",
        "variableNamingConvention": "structured" if plain else "flat",
        "author": "the contact-system developers",
        "copyright": "Copyright (c) 2026 the contact-system developers",
        "license": "MIT",
        "generationDateAndTime": time.strftime("%Y-%m-%dT%H:%M:%SZ", generation_time()),
    }
    if fmi_version == "2.0":
        head["numberOfEventIndicators"] = "0"
    return head


def _interface(table: Table, fmi_version: str, interface: str) -> ET.Element:
    flags = f"{_BOTH[fmi_version]} {_OWN[fmi_version, interface]}".split()
    attributes = {"modelIdentifier": model_identifier(table.scene)} | dict.fromkeys(flags, "true")
    element = ET.Element(interface, attributes)
    if fmi_version == "2.0":
        files = ET.SubElement(element, "SourceFiles")
        files.extend(ET.Element("File", name=name) for name in SOURCES)
    return element


def _units(unit: Unit) -> dict[str, str]:
    """Attributes of a type, and of its variables too: FMI Library ignores the displayUnit of a type
    if a variable has a unit."""
    name = unit_name(unit)
    return {"unit": name, **({"displayUnit": name.replace("rad", "deg")} if unit[2] == 1 else {})}


def _unit_definitions(table: Table) -> ET.Element:
    element = ET.Element("UnitDefinitions")
    for unit in sorted({row.unit for row in table.rows if row.unit is not None}):
        entry = ET.SubElement(element, "Unit", name=unit_name(unit))
        ET.SubElement(entry, "BaseUnit", {k: str(x) for k, x in zip(("m", "s", "rad"), unit) if x})
        if name := _units(unit).get("displayUnit"):
            ET.SubElement(entry, "DisplayUnit", name=name, factor=_number(math.degrees(1.0)))
    return element


QUANTITIES = {
    (1, 0, 0): "Length",
    (1, -1, 0): "Velocity",
    (1, -2, 0): "Acceleration",
    (0, 0, 1): "Angle",
    (0, -1, 1): "AngularVelocity",
    (0, -2, 1): "AngularAcceleration",
    (0, 1, 0): "Time",
}
"""Exponents of m, s, rad -> name of a type, and its quantity."""


def _type_definitions(table: Table, fmi_version: str) -> ET.Element:
    element = ET.Element("TypeDefinitions")
    used = {v.unit for v in table.rows}
    for unit in sorted(unit for unit in QUANTITIES if unit in used):
        name = QUANTITIES[unit]
        attributes = {"quantity": name, **_units(unit)}
        if fmi_version == "2.0":
            ET.SubElement(ET.SubElement(element, "SimpleType", name=name), "Real", attributes)
        else:
            ET.SubElement(element, "Float64Type", attributes, name=name)
    return element


# --- variables -----------------------------------------------------------------------------------


def _variable(variable: Variable, fmi_version: str, exchange: bool) -> ET.Element:
    common = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.initial:
        common["initial"] = variable.initial
    numeric = {
        "declaredType": QUANTITIES.get(variable.unit) if variable.unit else None,
        **(_units(variable.unit) if variable.unit else {}),
        "min": None if variable.minimum is None else _number(variable.minimum),
        "nominal": None if variable.nominal is None else _number(variable.nominal),
        "start": " ".join(map(_number, variable.start)) or None,
        "reinit": "true" if exchange and variable.jumps else None,
    }
    attributes = {name: value for name, value in numeric.items() if value is not None}
    if fmi_version == "2.0":
        element = ET.Element("ScalarVariable", common)
        real = ET.SubElement(element, "Real", attributes)
    else:
        element = real = ET.Element("Float64", common | attributes)
        for size in variable.shape:
            ET.SubElement(element, "Dimension", start=str(size))
    if variable.derivative is not None:
        real.set("derivative", str(variable.derivative))
    return element


def _number(value: float) -> str:
    return repr(float(value))


# --- structure -----------------------------------------------------------------------------------


def _structure(table: Table, fmi_version: str) -> ET.Element:
    """Outputs, derivatives and initial unknowns, each with its dependencies.

    Those on continuous states are given for Co-Simulation too, as it has directional derivatives.
    After initialization, FMI 2 leaves out those on parameters and FMI 3 gives all of them (FMI
    2.0.4, 2.2.8; FMI 3.0.2, 2.4.8).
    """
    states = set(table.states)
    parameters = {v.reference for v in table.rows if v.causality == "parameter"}
    running = states.union(table.inputs, () if fmi_version == "2.0" else {0, *parameters})
    variables = table.listed(fmi_version)
    # an FMI 3 array is known by the reference of its first element
    owner = {v.reference + i: v.reference for v in variables for i in range(v.size)}
    structure = ET.Element("ModelStructure")
    kinds = {
        "Output": [v for v in variables if v.causality == "output"],
        "ContinuousStateDerivative": [v for v in variables if v.derivative is not None],
        "InitialUnknown": [v for v in variables if v.initial == "calculated"],
    }
    for name, unknowns in kinds.items():
        allowed = running | parameters if name == "InitialUnknown" else running
        parent = structure
        if fmi_version == "2.0":
            name = {"ContinuousStateDerivative": "Derivative"}.get(name, name) + "s"
            parent = ET.SubElement(structure, name)
        for v in unknowns:
            found = sorted({owner[r] for r in allowed.intersection(v.known)})
            attributes = {"dependencies": " ".join(map(str, found))}
            attributes["dependenciesKind"] = " ".join(["dependent"] * len(found))
            if fmi_version == "2.0":
                # The index counts from 1, and leaves out time, reference 0: it is the reference.
                ET.SubElement(parent, "Unknown", attributes, index=str(v.reference))
            else:
                ET.SubElement(parent, name, attributes, valueReference=str(v.reference))
    return structure


# --- companions ----------------------------------------------------------------------------------


def companions(table: Table, fmi_version: str) -> dict[str, bytes]:
    """File name inside the FMU -> bytes."""
    icon = "model.png" if fmi_version == "2.0" else "terminalsAndIcons/icon.png"
    name, text = escape(table.scene.name), escape(table.scene.description)
    page = Template(HERE.joinpath("page.html").read_text("utf-8"))
    page_text = page.substitute(name=name, description=text, version=__version__)
    files = {
        icon: HERE.joinpath("icon.png").read_bytes(),
        "documentation/index.html": page_text.encode(),
    }
    # Python finds a clone's own metadata first, which have no licence
    installed = metadata.distributions(name="contact-system")
    texts = filter(None, (found.read_text("licenses/LICENSE") for found in installed))
    files["documentation/licenses/license.txt"] = next(texts, "MIT").encode()
    if fmi_version == "3.0":
        files["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(table).encode()
    return files


def build_description(table: Table) -> str:
    """The text of sources/buildDescription.xml (FMI 3.0.2, section 2.5.1.6)."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=model_identifier(table.scene))
    files = ET.SubElement(build, "SourceFileSet", language="C11")
    files.extend(ET.Element("SourceFile", name=name) for name in SOURCES)
    ET.SubElement(build, "Library", name="m", external="true")
    return xml_text(root)


def terminals(table: Table) -> str:
    """The text of terminalsAndIcons.xml: terminals of each contact's disturbances and motion.

    FMI 3.0.2, section 2.4.9. Members are matched by name, in any order: a measurement's have the
    names of a motion's, so that another FMU's motion can be connected to it. Terminals have no
    terminalKind, as importers may refuse to connect terminals of different kinds.
    """
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    box = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    picture = ET.SubElement(root, "GraphicalRepresentation")
    ET.SubElement(picture, "CoordinateSystem", box, suggestedScalingFactorTo_mm="0.1")
    ET.SubElement(picture, "Icon", box)
    everything = ET.SubElement(root, "Terminals")
    made: dict[tuple[str, str], ET.Element] = {}
    for v in table.listed("3.0"):
        if v.causality not in ("input", "output"):
            continue
        (i,) = re.findall(r"contact\[(\d+)\]", v.name)
        name = v.name.replace(f"contact[{i}].", "")
        kind = "disturbance" if v.causality == "input" else "motion"
        kind = "measured" if name.startswith("measured.") else kind
        if (i, kind) not in made:
            attributes = {"name": f"contact{i}_{kind}", "matchingRule": "bus"}
            named = table.scene.contacts[int(i) - 1].name or f"Contact {i}"
            attributes["description"] = f"{named}: {kind}"
            made[i, kind] = ET.SubElement(everything, "Terminal", attributes)
        member = re.sub(r"der\((.*)\)", r"\1_rate", name.removeprefix("measured."))
        attributes = {"variableName": v.name, "memberName": member}
        ET.SubElement(made[i, kind], "TerminalMemberVariable", attributes, variableKind="signal")
    return xml_text(root)


def xml_text(root: ET.Element) -> str:
    """An XML document, with U+FFFD for each character that XML does not have."""
    ET.indent(root)
    text = re.sub("[\0-\x08\v\f\x0e-\x1f\ufffe\uffff]", "\ufffd", ET.tostring(root, "unicode"))
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
