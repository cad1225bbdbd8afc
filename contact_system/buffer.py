"""A scene as one buffer of numbers, which the engine plans from.

The layout is that of engine/engine.h, which has the names used here; its version and its sizes are
checked when the library is loaded.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from . import limits
from .engine.binding import LAYOUT
from .scene import Disturbance, Leg, Scene, Stretch, refuse_rest
from .starts import Moment, Starts
from .surfaces import Surface
from .theory.gain import LAWS

VERSION = 5
HEADER, BODY, WINDOW, LEG, CONTACT, MOMENT = 15, 5, 5, 5, 35, 23  # so many numbers each
if LAYOUT != (VERSION, HEADER, BODY, WINDOW, LEG, CONTACT, MOMENT):
    raise ImportError(
        f"the engine of contact_system has another layout of scenes, {LAYOUT}, than this Python; "
        "install the package again, or in a checkout: pip install -e ."
    )
_HEAD, _ROW = struct.Struct(f"{HEADER}d").pack, struct.Struct(f"{CONTACT}d").pack
_NO_FRAME = (0.0,) * 6

Numbers = tuple[float, ...]


class Buffer:
    """The numbers of a scene for the engine.

    Attributes
    ----------
    numbers : bytes
        Doubles.
    count : int
        Of contacts.
    surfaces : list of Surface
        The surfaces that the buffer counts.
    """

    def __init__(self, scene: Scene, tolerance: float, begin: float, starts: Starts | None):
        self.count = len(scene.contacts)
        self.surfaces: list[Surface] = []
        self._tail: list[float] = []  # what follows the header
        self._bodies: dict[int, Numbers] = {}
        law, obj = LAWS[scene.gain.law], self._body(scene.object)
        rows = self._rows(scene, begin, starts)
        head = _HEAD(
            *(VERSION, len(scene.contacts), tolerance, limits.PANELS, begin, scene.duration),
            *(scene.gain.value, law.power, law.makes_up, HEADER + len(self._tail), *obj),
        )
        self.numbers = b"".join([head, struct.pack(f"{len(self._tail)}d", *self._tail), *rows])

    def _put(self, numbers: Sequence[float]) -> int:
        """Add numbers; returns where they stand."""
        at = HEADER + len(self._tail)
        self._tail += numbers
        return at

    def _body(self, surface: Surface) -> Numbers:
        known = self._bodies.get(id(surface))
        if known is None:
            self.surfaces.append(surface)
            at = self._put(surface.numbers.tolist())
            known = (len(self.surfaces) - 1, at, surface.size, surface.bend, surface.reach)
            self._bodies[id(surface)] = known
        return known

    def _way(self, way: Sequence[Stretch]) -> tuple[int, int]:
        """Add legs; returns where they stand, and how many."""
        numbers = []
        for leg in way:
            at = self._put(leg.profile.coefficients)
            numbers += [leg.start, at, len(leg.profile.coefficients), *leg.turn]
        return self._put(numbers), len(way)

    def _rows(self, scene: Scene, begin: float, starts: Starts | None) -> list[bytes]:
        """Each contact: its finger, where it starts, what disturbs it."""
        windows, rows = _windows(scene, begin), []
        ways: dict[Sequence[Leg], tuple[int, int]] = {}
        given = [
            start if isinstance(start, Moment) else start.start_numbers()
            for start in (scene.contacts if starts is None else starts)
        ]
        found = _found_frames(scene, given)
        for i, (contact, start) in enumerate(zip(scene.contacts, given)):
            own = windows.get(i, ())
            at = self._put([x for d in own for x in (d.slot, d.start, d.stop, *d.value)])
            if contact.legs not in ways:
                ways[contact.legs] = self._way(contact.way(scene.profile, scene.duration))
            if isinstance(start, Moment):
                goes_on, frame_1, frame_2 = 1, start.finger_frame[:6], start.object_frame[:6]
                numbers: Numbers = (*start.finger_at, *start.object_at, start.angle)
                numbers += (*start.finger_velocity, *start.slip)
            else:
                goes_on, frame_1, frame_2 = 0, found.get((i, 0), ()), found.get((i, 1), ())
                u1, v1, u2, v2, *others = start
                numbers = (u1, v1, 0.0, u2, v2, 0.0, *others)
            which = bool(frame_1) + 2 * bool(frame_2)
            state = (goes_on, contact.follows, which, at, len(own), *ways[contact.legs], *numbers)
            frames = (*(frame_1 or _NO_FRAME), *(frame_2 or _NO_FRAME))
            rows.append(_ROW(*self._body(contact.finger), *state, *frames))
        return rows


def _windows(scene: Scene, begin: float) -> dict[int, list[Disturbance]]:
    """What has not ended before the beginning, by contact."""
    found: dict[int, list[Disturbance]] = {}
    for d in scene.disturbances:
        if d.stop > begin:
            found.setdefault(int(d.contact), []).append(d)
    moves = not (found and scene.profile.zeros(scene.duration))
    for contact, own in found.items():
        if moves and not scene.contacts[contact].legs:
            continue
        for d in own:
            if d.accelerates and any(d.value):
                refuse_rest(scene, contact, max(d.start, begin), d.stop)
    return found


def _found_frames(scene: Scene, given: Sequence[Any]) -> dict[tuple[int, int], Numbers]:
    """(x, p) by contact and side on surfaces without a chart, whose points are found numerically.

    All of a surface are found at once.
    """
    places: dict[int, list[tuple[int, int]]] = {}
    surfaces: dict[int, Surface] = {}
    for i, contact in enumerate(scene.contacts):
        for side, surface in enumerate((contact.finger, scene.object)):
            if not surface.has_chart and not isinstance(given[i], Moment):
                places.setdefault(id(surface), []).append((i, side))
                surfaces[id(surface)] = surface
    found: dict[tuple[int, int], Numbers] = {}
    for key, where in places.items():
        at = np.array([given[i][2 * side : 2 * side + 2] for i, side in where])
        point, frame = surfaces[key].point_and_frame(*at.T)
        found |= zip(where, map(tuple, np.hstack([point, frame[..., 0]]).tolist()))
    return found
