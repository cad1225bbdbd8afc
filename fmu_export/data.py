"""A scene as data for the FMU's binary: resources/scene.bin, whose layout is that of c/model.h."""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from contact_system import __version__
from contact_system.contact_sensor import limits_of
from contact_system.engine.binding import N_TABLES, SURFACES
from contact_system.planning.motion import Buffer
from contact_system.surfaces import Surface
from contact_system.surfaces.base import OfLengths

from .equations import TOLERANCE, equations, frame_size, measured
from .variables import Table

VERSION = 20261210
KINDS = ("calculated", "independent", "constant", "fixed", "tunable", "input", "exact")
_SURFACE, _TABLE = f"{1 + 2 * N_TABLES}q4i2d", "8i3q"


class _Data:
    """Numbers of 8 bytes, with texts and instructions between them, which follow the header; a
    place is an index of these numbers. A table that several contacts share is written once."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0
        self.tables: list[Any] = []

    def put(self, data: bytes) -> int:
        """Add bytes, filled up to whole numbers; returns their place."""
        at, data = self.size, data + bytes(-len(data) % 8)
        self.parts.append(data)
        self.size += len(data) // 8
        return at

    def doubles(self, values: Any) -> int:
        """Add numbers; returns their place."""
        return self.put(np.asarray(values, dtype="<f8").tobytes())

    def rows(self, rows: Sequence[Sequence[Any]], form: str = "") -> tuple[int, int]:
        """Add rows, of integers or of a format of `struct`; returns place and count."""
        form = form or f"{len(rows[0]) if rows else 0}q"
        return self.put(b"".join(struct.pack(f"<{form}", *row) for row in rows)), len(rows)

    def texts(self, *values: str) -> int:
        """Add texts; returns their place."""
        return self.put(b"".join(text.encode() + b"\0" for text in values))

    def table(self, t: Any) -> int:
        """The index of a table of instructions, which is added if it is new; -1 for None."""
        if t is not None and t not in self.tables:
            self.tables.append(t)
        return -1 if t is None else self.tables.index(t)

    def instructions(self, t: Any) -> list[int]:
        """Add a table's instructions and literals; returns its row."""
        code = (self.put(words.astype("<u2").tobytes()) for words in t.words)
        return [*t.sizes, t.twin, *code, self.doubles(t.numbers)]


def scene_data(table: Table, fmi_version: str, *interfaces: str) -> tuple[bytes, str]:
    """The bytes of scene.bin, and the instantiation token (FMI 3) or GUID (FMI 2) inside them, by
    which it is matched with its description."""
    scene, rows, data = table.scene, table.rows, _Data()
    contacts = [_contact(table, i, data) for i in range(len(scene.contacts))]
    orders = _orders(scene.object, table.first["object"])
    corners: set[float] = set()
    for i, contact in enumerate(scene.contacts):
        orders += _orders(contact.finger, table.first[f"finger {i}"])
        corners |= {stretch.start for stretch in scene.way(i)[1:]}
    starts = [group[0] for group in table.groups]
    owners = np.repeat([-1, *range(len(starts))], np.diff([0, *starts, len(rows)]))
    sizes = {v.reference: v.size for v in table.listed(fmi_version)}
    values = [
        (owner, KINDS.index(v.kind), sizes.get(v.reference, 0)) for owner, v in zip(owners, rows)
    ]
    windows = [
        (int(d.contact), d.slot, table.first["windows"] + 4 * k)
        for k, d in enumerate(scene.disturbances)
    ]
    orders += [(at + 1, at) for *_, at in windows]  # stop, start
    engine = Buffer(scene.replace(disturbances=()), TOLERANCE, 0.0, None)
    moved = [t for s in engine.surfaces for t in s.tables.space if t is not None]
    registers = (t.n_regs for t in (*data.tables, *moved))
    surfaces = [_surface(surface, data) for surface in engine.surfaces]
    head = [
        *(max(registers), data.texts(*(v.name for v in rows))),
        data.doubles(table.start_values),
        data.doubles([-np.inf if v.minimum is None else v.minimum for v in rows]),
        *(data.doubles([rows[r].nominal for r in table.states]), data.put(bytes(limits_of(scene)))),
        *(data.put(engine.numbers), len(engine.numbers) // 8),
        *(*data.rows(values), *data.rows(contacts), *data.rows(surfaces, _SURFACE)),
        *data.rows([data.instructions(t) for t in data.tables], _TABLE),
        *data.rows(windows),
        *data.rows([(t,) for t in sorted(corners)], "d"),
        *data.rows(orders),
    ]
    known = repr((__version__, fmi_version, interfaces, head)).encode(), *data.parts
    token = "{" + hashlib.sha256(b"".join(known)).hexdigest()[:32] + "}"
    head += data.texts(token), data.size
    checked = b"".join([struct.pack(f"<{len(head)}q", *head), *data.parts])
    return struct.pack("<2q", VERSION, zlib.adler32(checked)) + checked, token


def _contact(table: Table, i: int, data: _Data) -> list[int]:
    """The row of contact i."""
    scene, contact = table.scene, table.scene.contacts[i]
    pair = contact.finger, scene.object
    system, _ = equations(*table.structure(i))
    sensor = system if table.measured == "nothing" else measured(*pair, table.measured)
    unknowns = [3 if s.has_implicit else 2 for s in pair] if table.measured == "pose" else [0, 0]
    columns, _ = data.rows([table.columns(i)])
    return [
        *(bool(contact.legs), table.first[f"finger {i}"], table.first["object"], *table.groups[i]),
        *(columns, data.table(system), *map(frame_size, pair), data.table(sensor), *unknowns),
    ]


def _orders(surface: Surface, at: int) -> list[tuple[int, int]]:
    """Pairs of references of parameters, of which the first must stay greater than the second: else
    the surface would be of another kind."""
    lengths = list(enumerate(surface.parameters if isinstance(surface, OfLengths) else (), at))
    return [(i, j) for i, greater in lengths for j, less in lengths if greater > less]


def _surface(surface: Surface, data: _Data) -> list[Any]:
    """The row of a surface, by its number in the engine or with its tables."""
    if surface.table_name is not None:
        place = list(SURFACES).index(surface.table_name)
        return [place, *[-1] * (2 * N_TABLES), *surface.traits]
    tables = map(data.table, (*surface.tables.chart, *surface.tables.space))
    return [-1, *tables, *surface.traits]


def as_c(data: bytes) -> str:
    """scene.bin as C, for importers that compile an FMU's sources."""
    words = np.frombuffer(data, dtype="<u8").tolist()
    rows = ("%#x, " * 6 + "\n  ") * (len(words) // 6) + "%#x, " * (len(words) % 6)
    return (
        "/* The scene, see model.h: its numbers as their bits on little-endian machines. */\n"
        f"static const unsigned long long scene_words[] = {{\n  {rows % tuple(words)}}};\n\n"
        "static void *scene_data(const char *resources, size_t *count) {\n"
        "  void *data = malloc(sizeof scene_words);\n"
        "  (void)resources;\n"
        "  *count = sizeof scene_words / sizeof *scene_words;\n"
        "  if (data) memcpy(data, scene_words, sizeof scene_words);\n"
        "  return data;\n"
        "}\n"
    )
