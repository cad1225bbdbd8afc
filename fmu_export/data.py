"""A scene as data for the FMU's binary: resources/scene.bin, whose layout is that of c/model.h."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

from contact_system.contact_sensor import CONFORMAL, MOST_STEPS, ContactSensor
from contact_system.engine.binding import SURFACES, TableData
from contact_system.planning.motion import Buffer
from contact_system.surfaces import Ellipsoid, Surface, Torus

from .model import TOLERANCE, equations, frame_sizes, measured
from .variables import Table

VERSION, HEADER = 20261201.0, 27
KINDS = ("calculated", "independent", "constant", "fixed", "tunable", "input", "exact")


class _Data:
    """Doubles, with texts and instructions between them; places count doubles. What several
    contacts have in common is written once, behind them."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = HEADER
        self.surfaces: dict[Surface, int] = {}
        self.tables: dict[Any, int] = {}

    def put(self, data: bytes) -> int:
        """Add bytes, filled up to whole doubles; returns their place."""
        at, data = self.size, data + bytes(-len(data) % 8)
        self.parts.append(data)
        self.size += len(data) // 8
        return at

    def numbers(self, values: Any) -> int:
        """Add numbers; returns their place."""
        return self.put(np.asarray(values, dtype="<f8").tobytes())

    def texts(self, *values: str) -> int:
        """Add texts; returns their place."""
        return self.put(b"".join(text.encode() + b"\0" for text in values))

    def table(self, t: Any) -> int:
        """The number of a table of instructions; -1 of none."""
        return -1 if t is None else self.tables.setdefault(t, len(self.tables))

    def instructions(self, t: Any) -> list[float]:
        """Add a table's instructions; returns its row."""
        code = (self.put(words.astype("<u2").tobytes()) for words in (t.prologue, t.body))
        return [*t.sizes, *code, self.numbers(t.literals)]


def scene_data(table: Table, token: str) -> bytes:
    """The bytes of scene.bin; token: instantiation token (FMI 3) or GUID (FMI 2)."""
    scene, rows, data = table.scene, table.rows, _Data()
    contacts = [x for i in range(len(scene.contacts)) for x in _contact(table, i, data)]
    orders = _orders(scene.object, table.first["object"])
    corners: set[float] = set()
    for i, contact in enumerate(scene.contacts):
        orders += _orders(contact.finger, table.first[f"finger {i}"])
        corners |= {stretch.start for stretch in scene.way(i)[1:]}
    sensed = ContactSensor(scene) if table.measured == "pose" else None
    limits = (sensed.small, MOST_STEPS, sensed.settled, CONFORMAL) if sensed else 4 * (0.0,)
    bounds = [*(group[0] for group in table.groups), len(rows)]
    least = [-np.inf if v.minimum is None else v.minimum for v in rows]
    nominals = [rows[r].nominal for r in table.states]
    owners = np.repeat([-1, *range(len(table.groups))], np.diff([0, *bounds]))
    shown = table.joined if table.arrays else rows
    sizes = [size for v in shown for size in (v.size, *[0] * (v.size - 1))]
    windows = [
        (d.contact, d.slot, table.first["windows"] + 4 * k)
        for k, d in enumerate(scene.disturbances)
    ]
    orders += [at + k for *_, at in windows for k in (1, 0)]  # stop, start
    tables = [*data.tables, *(t for s in data.surfaces for t in s.tables.ambient if t is not None)]
    registers = max(TableData.from_address(t.address).n_regs for t in tables)
    bodies = [x for surface in data.surfaces for x in _surface(surface, data)]
    head = struct.pack(
        f"<{HEADER - 3}d",
        *(len(table.groups), len(rows), table.first["scale"]),
        *(data.texts(token), data.texts(*(v.name for v in rows)), data.numbers(owners)),
        data.numbers([KINDS.index(v.kind) for v in rows]),
        *(data.numbers(sizes), data.numbers(table.start_values), data.numbers(least)),
        *(data.numbers(nominals), data.numbers(contacts)),
        *(data.numbers(bodies), len(data.surfaces)),
        *(data.numbers([x for t in data.tables for x in data.instructions(t)]), len(data.tables)),
        registers,
        *(data.numbers(np.ravel(windows)), len(windows)),
        *(data.numbers(sorted(corners)), len(corners), data.numbers(limits)),
        *(data.numbers(orders), len(orders) // 2),
    )
    body = b"".join(data.parts)
    return struct.pack("<3d", VERSION, data.size, zlib.adler32(body)) + head + body


def _contact(table: Table, i: int, data: _Data) -> list[float]:
    """The row of contact i."""
    scene, contact = table.scene, table.scene.contacts[i]
    pair = contact.finger, scene.object
    own, _ = equations(*table.structure(i))
    sensor = own if table.measured == "nothing" else measured(*pair, table.measured)
    unknowns = [3 if s.has_implicit else 2 for s in pair] if table.measured == "pose" else [0, 0]
    engine = Buffer(scene.replace(contacts=[contact], disturbances=()), TOLERANCE, 0.0, None)
    return [
        *(data.put(engine.numbers), len(engine.numbers) // 8, bool(contact.legs)),
        *(data.surfaces.setdefault(surface, len(data.surfaces)) for surface in pair),
        *(table.first[f"finger {i}"], table.first["object"], *table.groups[i]),
        *(data.numbers(table.columns(i)), data.table(own), *frame_sizes(*pair)),
        *(data.table(sensor), *unknowns),
    ]


def _orders(surface: Surface, at: int) -> list[int]:
    """Pairs of references of parameters that keep the surface of its kind: the first must stay
    greater than the second."""
    count, numbers = range(len(surface.parameters)), surface.parameters
    if not isinstance(surface, (Ellipsoid, Torus)):
        return []
    return [at + k for i in count for j in count if numbers[i] > numbers[j] for k in (i, j)]


def _surface(surface: Surface, data: _Data) -> list[float]:
    """The row of a surface, by its number in the engine or with its tables."""
    if surface.table_name is not None:
        return [list(SURFACES).index(surface.table_name), *[0.0] * 19]
    own = surface.engine_data
    tables = map(data.table, (*surface.tables.ambient, *surface.tables.chart))
    return [-1, own.n_numbers, own.double_cover, own.flags, own.period_u, own.period_v, *tables]


def as_c(data: bytes) -> str:
    """The same as C, for FMUs of sources."""
    words = np.frombuffer(data, dtype="<u8").tolist()
    rows = ("%#x, " * 6 + "\n  ") * (len(words) // 6) + "%#x, " * (len(words) % 6)
    return (
        "/* The scene, see model.h: doubles as their bits on little-endian machines. */\n"
        f"static const unsigned long long scene_words[] = {{\n  {rows % tuple(words)}}};\n\n"
        "static double *scene_data(const char *resources, size_t *count) {\n"
        "  double *data = malloc(sizeof scene_words);\n"
        "  (void)resources;\n"
        "  *count = sizeof scene_words / sizeof *scene_words;\n"
        "  if (data) memcpy(data, scene_words, sizeof scene_words);\n"
        "  return data;\n"
        "}\n"
    )
