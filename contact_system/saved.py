"""Saved plans read back: everything in the file is checked before it is used."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from .archives import opened
from .checks import finite_number, finite_numbers, known_keys, naming, within
from .engine.binding import run
from .errors import ContactSystemError, SceneError
from .scene import Scene
from .starts import Moment, Start, Starts, require_place
from .surfaces import Surface
from .theory.development import prefers_space

KEYS = ("tolerance", "method", "solver", "start", "starts")
A_RESTORE = 1  # of a surface's tables, as in engine.h
PLAN_FILE = "a plan written by Plan.save"
SIZES = {"angle": (), "finger_at": 3, "object_at": 3, "finger_frame": 6, "object_frame": 6}
"""Sizes of a Moment's fields; all other fields, and those of a Start, hold two numbers."""


def digest(texts: Iterable[str]) -> str:
    """Digest of the texts, by which changes of the file are noticed."""
    import hashlib  # slow to import

    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


def read_plan(path: Path) -> tuple[str, dict[str, Any]]:
    """The scene's TOML text and the header of a saved plan.

    Raises
    ------
    ContactSystemError
        No such file, a damaged one, or one that was changed after it was written.
    """
    with opened(path, PLAN_FILE) as archive:
        texts = []
        for name in ("scene", "plan", "digest"):
            info = archive.getinfo(f"{name}.npy")
            what = f"{info.filename}: bytes when unpacked"
            within("PLAN_BYTES", info.file_size, what, ContactSystemError)
            data = io.BytesIO(archive.read(info))
            texts.append(str(np.lib.format.read_array(data, allow_pickle=False)[()]))
        scene, plan, known = texts
        if known != digest([scene, plan]):
            raise ContactSystemError(
                f"{path}: not {PLAN_FILE}, but changed since: its digest does not match; take "
                "the file as it was written"
            )
        header = json.loads(plan)
    with naming(f"{path}: not {PLAN_FILE}"):
        if not isinstance(header, dict):
            raise SceneError(f"plan = {header!r}: give a table of {', '.join(KEYS)}")
        known_keys(header, KEYS, "plan: ")
        for key in KEYS:
            if key not in header:
                raise SceneError(f"plan: key '{key}' is missing; save the plan again")
    return scene, header


def checked_start(header: dict[str, Any], scene: Scene) -> tuple[float, Starts | None]:
    """The time at which a saved plan begins, s, and the starts of its contacts.

    Raises
    ------
    SceneError
        A time outside the horizon, a point off its surface, or a wrong direction there.
    """
    start = finite_number(header["start"], "start", "not below 0")
    if not start < scene.duration:
        raise SceneError(f"start = {start:g} s: give a time before the end, {scene.duration:g} s")
    starts = header["starts"]
    if starts is None:
        if start > 0:
            raise SceneError(f"starts = None: a plan that starts at {start:g} s needs its contacts")
        return start, None
    count = len(scene.contacts)
    if not isinstance(starts, list) or len(starts) != count:
        raise SceneError(f"starts = {starts!r}: give a list, one for each of {count} contacts")
    moments = isinstance(starts[0], dict) and "slip" in starts[0]
    return start, [_start(scene, i, one, moments) for i, one in enumerate(starts)]


def _start(scene: Scene, index: int, table: Any, moments: bool) -> Start | Moment:
    kind, contact, place = Moment if moments else Start, scene.contacts[index], f"starts[{index}]"
    names = [f.name for f in fields(kind)]
    if not isinstance(table, dict) or sorted(table) != sorted(names):
        raise SceneError(f"{place} = {table!r}: give a table of {', '.join(names)}")
    if contact.follows:
        raise SceneError(f"{place}: imposed rolling has no other starts; leave starts out")
    bodies = {"finger": contact.finger, "object": scene.object}
    read: dict[str, Any] = {}
    for name, value in table.items():
        what, size = f"{place}.{name}", SIZES.get(name, 2) if moments else 2
        if name == "angle":
            read[name] = finite_number(value, what)
            continue
        if name.endswith("frame") and not prefers_space(bodies[name[:6]]):
            size = 0
        if not isinstance(value, list) or len(value) != size:
            raise SceneError(f"{what} = {value!r}: give a list of {size} numbers")
        read[name] = finite_numbers(value, what) if size else ()
    for side, surface in bodies.items():
        if frame := read.get(f"{side}_frame"):
            _require_on(surface, frame, f"{place}.{side}_frame")
        else:
            u, v = read[f"{side}_at"][:2]
            require_place(surface, u, v, f"{place}.{side}_at")
    return kind(**read)


def _require_on(surface: Surface, frame: tuple[float, ...], what: str) -> None:
    """Refuse a frame unless it is a point of the surface and a unit tangent, up to rounding."""
    state = np.array(frame)[:, None]
    moved = run(surface.tables.ambient[A_RESTORE], state, surface.numbers) - state
    moved[:3] /= surface.size
    if not np.abs(moved).max() < 1e-6:
        raise SceneError(
            f"{what} = {frame}: give a point on {surface!r} and a unit vector along it"
        )
