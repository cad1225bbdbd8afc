"""What an FMU carries for people: a page of documentation, an icon, terminals."""

from __future__ import annotations

import functools
import struct
import zlib
from html import escape
from importlib import metadata
from pathlib import Path

import numpy as np

from contact_system import __version__

from .description import listed, printable, states_of, terminals
from .quantities import unit_name
from .variables import Table


def companions(table: Table, fmi_version: str) -> dict[str, bytes]:
    """File name inside the FMU -> bytes."""
    icon = "model.png" if fmi_version == "2.0" else "terminalsAndIcons/icon.png"
    files = {icon: icon_png(), "documentation/index.html": page(table, fmi_version).encode()}
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


def page(table: Table, fmi_version: str) -> str:
    """The HTML page: what the block does, and its variables."""
    scene = table.scene
    rows = "".join(
        f"<tr><td><code>{escape(v.name)}</code></td><td>{v.causality}</td>"
        f"<td>{'' if v.unit is None else unit_name(v.unit)}</td>"
        f"<td>{', '.join(f'{x:g}' for x in v.start)}</td><td>{escape(v.description)}</td></tr>\n"
        for v in listed(table, fmi_version)
    )
    windows = "".join(
        f"<li>contact {d.contact + 1}: {d.kind} ({d.value[0]:g}, {d.value[1]:g}) "  # type: ignore
        f"from {d.start:g} s to {d.stop:g} s</li>"
        for d in scene.disturbances
    )
    return printable(
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(scene.name)}</title><style>body{{font-family:sans-serif;max-width:60em;"
        "margin:2em auto}td{padding:.1em .6em;vertical-align:top}</style></head><body>\n"
        f"<h1>{escape(scene.name)}</h1><p>{escape(scene.description)}</p>\n"
        "<p>Plans rolling contact curves: how the contact point of each finger moves over finger "
        "and object while slip is rejected. Set inputs to disturb a contact; read coordinates, "
        "slip, twist and pose. Kumar &amp; Mukherjee, <i>A note on synthesizing geodesic based "
        "contact curves</i>.</p>\n"
        "<p>Communication steps may have any size and may vary; results do not depend on them. "
        f"The continuous {states_of(table)}. Their start values, and all parameters, can be set "
        f"before initialization ends. The scene's own disturbances:</p><ul>"
        f"{windows or '<li>none</li>'}</ul>\n<table>\n<tr><th>name</th>"
        f"<th>causality</th><th>unit</th><th>start</th><th>meaning</th></tr>\n{rows}</table>\n"
        f"<p>contact-system {__version__}</p>"
        "</body></html>\n"
    )


@functools.cache
def icon_png() -> bytes:
    """A small ball on a large one, as a PNG file."""
    side = 96
    y, x = np.mgrid[0:side, 0:side] / side
    pixels = np.full((side, side, 4), 255, dtype=np.uint8)
    pixels[..., 3] = 0
    for (cx, cy), r, colour in (
        ((0.5, 0.78), 0.36, (90, 120, 160)),
        ((0.56, 0.24), 0.17, (220, 140, 60)),
    ):
        distance = np.hypot(x - cx, y - cy)
        light = 1.2 - 0.6 * np.hypot(x - cx + r / 3, y - cy + r / 3) / r
        shade = np.clip(np.array(colour) * light[..., None], 0, 255)
        inside = distance <= r
        pixels[inside, :3], pixels[inside, 3] = shade[inside].astype(np.uint8), 255
    raw = b"".join(b"\0" + row.tobytes() for row in pixels)
    head = struct.pack(">IIBBBBB", side, side, 8, 6, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(raw, 9)), (b"IEND", b""))
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + body
