"""What an FMU carries for people: a page of documentation, an icon, terminals."""

from __future__ import annotations

from html import escape
from importlib import metadata
from pathlib import Path

from contact_system import __version__

from .description import printable, terminals
from .variables import Table

ICON = Path(__file__).with_name("icon.png")


def companions(table: Table, fmi_version: str) -> dict[str, bytes]:
    """File name inside the FMU -> bytes."""
    icon = "model.png" if fmi_version == "2.0" else "terminalsAndIcons/icon.png"
    files = {icon: ICON.read_bytes(), "documentation/index.html": page(table).encode()}
    files["documentation/licenses/license.txt"] = license_text().encode()
    if fmi_version == "3.0":
        files["terminalsAndIcons/terminalsAndIcons.xml"] = terminals(table).encode()
    return files


def license_text() -> str:
    """This package's licence, from its checkout or from where it is installed."""
    beside = Path(__file__).parents[1] / "LICENSE"
    if beside.exists():
        return beside.read_text("utf-8")
    installed = metadata.distribution("contact-system")
    return installed.read_text("licenses/LICENSE") or installed.read_text("LICENSE") or "MIT"


def page(table: Table) -> str:
    """The HTML page: what the block does; its variables are described in its XML."""
    scene = table.scene
    return printable(
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(scene.name)}</title><style>body{{font-family:sans-serif;max-width:60em;"
        "margin:2em auto}</style></head><body>\n"
        f"<h1>{escape(scene.name)}</h1><p>{escape(scene.description)}</p>\n"
        "<p>Plans rolling contact curves: how the contact point of each finger moves over finger "
        "and object while slip is rejected. Set inputs to disturb a contact; read coordinates, "
        "slip, twist and pose. Kumar &amp; Mukherjee, <i>A note on synthesizing geodesic based "
        "contact curves</i>.</p>\n"
        "<p>Communication steps may have any size and may vary; results do not depend on them. "
        "The continuous states are moving frames. Their start values, and all parameters, among "
        "them the scene's own disturbances, can be set before initialization ends.</p>\n"
        f"<p>contact-system {__version__}</p>"
        "</body></html>\n"
    )
