"""A scene as one buffer of numbers, which the engine plans from.

The layout is that of engine/engine.h, which has the names used here; its version and its sizes are
checked when the library is loaded.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from .engine.binding import LAYOUT
from .scene import Disturbance, Scene, refuse_rest
from .starts import Moment, Start, Starts
from .surfaces import Surface
from .theory.gain import LAWS

VERSION = 2
HEADER, BODY, WINDOW, CONTACT, MOMENT = 18, 5, 5, 33, 23  # so many numbers each
if LAYOUT != (VERSION, HEADER, BODY, WINDOW, CONTACT, MOMENT):
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
    surfaces : list of Surface
        The surfaces that the buffer counts.
    """

    def __init__(self, scene: Scene, tolerance: float, begin: float, starts: Starts | None):
        self.surfaces: list[Surface] = []
        self._tail: list[float] = []  # what follows the header
        self._bodies: dict[int, Numbers] = {}
        law, sigma = LAWS[scene.gain.law], scene.profile.coefficients
        turns = scene.profile.extrema(begin, scene.duration)
        at_sigma, at_turns, obj = self._put(sigma), self._put(turns), self._body(scene.object)
        rows = self._rows(scene, begin, starts)
        head = _HEAD(
            *(VERSION, len(scene.contacts), tolerance, begin, scene.duration),
            *(at_sigma, len(sigma), at_turns, len(turns)),
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

    def _rows(self, scene: Scene, begin: float, starts: Starts | None) -> list[bytes]:
        """Each contact: its finger, where it starts, what disturbs it."""
        windows = _windows(scene, begin)
        rows, charts = [], scene.object.has_chart
        for i, contact in enumerate(scene.contacts):
            own = windows.get(i, ())
            at = self._put([x for d in own for x in (d.slot, d.start, d.stop, *d.value)])
            given = None if starts is None else starts[i]
            if isinstance(given, Moment):
                goes_on, (frames, numbers) = 1, _going_on(given)
            else:
                goes_on, frames = 0, (0, _NO_FRAME, _NO_FRAME)
                numbers = contact.start_numbers() if given is None else _measured(given)
                if not (charts and contact.finger.has_chart):
                    frames = _found_frames(contact.finger, scene.object, numbers)
                u1, v1, u2, v2, *others = numbers
                numbers = (u1, v1, 0.0, u2, v2, 0.0, *others)
            body, (which, frame_1, frame_2) = self._body(contact.finger), frames
            state = (goes_on, contact.follows, which, at, len(own))
            rows.append(_ROW(*body, *state, *numbers, *frame_1, *frame_2))
        return rows


Frames = tuple[int, Numbers, Numbers]
"""Which are given, as bits, and x, p of finger and object."""


def _windows(scene: Scene, begin: float) -> dict[int, list[Disturbance]]:
    """What has not ended before the beginning, by contact."""
    found: dict[int, list[Disturbance]] = {}
    for d in scene.disturbances:
        if d.stop > begin:
            found.setdefault(int(d.contact), []).append(d)
    if found and scene.profile.zeros(scene.duration):
        for d in (d for own in found.values() for d in own):
            if d.accelerates and any(d.value):
                where = f"{scene.title}, contact {d.contact}"
                refuse_rest(scene, where, max(d.start, begin), d.stop)
    return found


def _going_on(m: Moment) -> tuple[Frames, Numbers]:
    given = bool(m.finger_frame) + 2 * bool(m.object_frame)
    frames = (given, m.finger_frame[:6] or _NO_FRAME, m.object_frame[:6] or _NO_FRAME)
    return frames, (*m.finger_at, *m.object_at, m.angle, *m.finger_velocity, *m.slip)


def _measured(start: Start) -> Numbers:
    places = (*start.finger_at, *start.object_at, start.angle)
    return (*places, *start.finger_velocity, *start.object_velocity)


def _found_frames(finger: Surface, obj: Surface, start: Numbers) -> Frames:
    """Of surfaces without a chart, on which the point is found numerically."""
    which, frames = 0, [_NO_FRAME, _NO_FRAME]
    for k, surface in enumerate((finger, obj)):
        if not surface.has_chart:
            at = start[2 * k : 2 * k + 2]
            which += 1 << k
            frames[k] = (*surface.point(*at).tolist(), *surface.frame(*at)[:, 0].tolist())
    return which, frames[0], frames[1]
