"""The motion of a scene's contacts: given to the engine as numbers, planned and evaluated there.

The layout of those numbers is that of engine/engine.h.
"""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Sequence
from ctypes import byref
from typing import Any

import numpy as np

from .. import limits
from ..engine import binding
from ..engine.binding import LAYOUT, address
from ..scene import Disturbance, Leg, Scene, Stretch, refuse_rest
from ..surfaces import Surface
from ..theory.development import in_space
from .explanation import OUTSIDE, SINGULAR_TIME, failed, lines
from .starts import Moment, Starts

VERSION, HEADER, CONTACT, MOMENT = LAYOUT
if VERSION != 8:
    raise ImportError(
        f"the engine of contact_system has another layout of scenes, {VERSION}, than this Python; "
        "install the package again, or in a checkout: pip install -e ."
    )
_HEAD, _ROW = struct.Struct(f"{HEADER}d").pack, struct.Struct(f"{CONTACT}d").pack

_NO_FRAME = (0.0,) * 6

SHAPES: dict[str, tuple[int, ...]] = {
    "states": (9,),
    "points": (2, 3),
    "slip": (2,),
    "slip_speed": (),
    "twist": (6,),
    "pose": (4, 4),
    "acceleration": (2,),
    "carried": (2, 3),
}
"""The results of a plan, in the engine's order, with their shapes for one contact at one time."""
FRAMES = "frames"
"""A result that `Plan` lacks: x, p, q of each body, and its curvature form K_pp, K_pq, K_qq."""
_ALL = {**SHAPES, FRAMES: (2, 12)}
_SIZES = {name: math.prod(shape) for name, shape in _ALL.items()}
_PLACES = {name: place for place, name in enumerate(_ALL)}
_TIMES_FIRST = {name: (len(shape) + 1, *range(len(shape) + 1)) for name, shape in _ALL.items()}


# --- the scene as numbers ------------------------------------------------------------------------


class Buffer:
    """A scene for the engine: `numbers`, doubles in bytes, and `surfaces`, which they index."""

    def __init__(self, scene: Scene, tolerance: float, begin: float, starts: Starts | None):
        self.surfaces: list[Surface] = []
        self._tail: list[float] = []  # the numbers that follow header and contacts
        self._tail_index = HEADER + CONTACT * len(scene.contacts)
        self._bodies: dict[int, tuple[float, ...]] = {}
        law, obj = scene.gain.row, self._body(scene.object)
        rows = self._rows(scene, begin, starts)
        head = _HEAD(
            *(len(scene.contacts), tolerance, limits.PANELS, begin, scene.duration),
            *(scene.gain.value, law.power, law.cancels_growth, *obj),
        )
        self.numbers = b"".join([head, *rows, struct.pack(f"{len(self._tail)}d", *self._tail)])

    def _put(self, numbers: Sequence[float]) -> int:
        """Add numbers to the tail; returns the index of the first in the buffer."""
        index = self._tail_index + len(self._tail)
        self._tail += numbers
        return index

    def _body(self, surface: Surface) -> tuple[float, ...]:
        body = self._bodies.get(id(surface))
        if body is None:
            self.surfaces.append(surface)
            index = self._put((surface.sign, *surface.parameters))
            lengths = surface.size, surface.least_radius, surface.panel_limit
            body = self._bodies[id(surface)] = (len(self.surfaces) - 1, index, *lengths)
        return body

    def _legs(self, way: Sequence[Stretch]) -> tuple[int, int]:
        """Add legs; returns their index and their number."""
        numbers = []
        for leg in way:
            index = self._put(leg.profile.coefficients)
            numbers += [leg.start, index, len(leg.profile.coefficients), *leg.turn]
        return self._put(numbers), len(way)

    def _rows(self, scene: Scene, begin: float, starts: Starts | None) -> list[bytes]:
        """One row for each contact: its finger, start, disturbances and legs."""
        begins: Sequence[Any] = starts or [contact.start() for contact in scene.contacts]
        windows, solved, rows = _windows(scene, begin), _solved_frames(scene, begins), []
        legs: dict[Sequence[Leg], tuple[int, int]] = {}
        for i, (contact, start) in enumerate(zip(scene.contacts, begins, strict=True)):
            acting, index = windows.get(i, ()), 0
            if acting:
                index = self._put([x for d in acting for x in (d.slot, d.start, d.stop, *d.value)])
            if contact.legs not in legs:
                legs[contact.legs] = self._legs(scene.way(i))
            finger_at, object_at, angle, w1, w2_or_v, *frames = start
            theta = () if frames else (0.0,)  # the places of a Moment are u, v, theta
            frame_1, frame_2 = frames or solved.get(i, ((), ()))
            flags = (isinstance(start, Moment), contact.follows, index, len(acting))
            place = (*finger_at, *theta, *object_at, *theta, angle, *w1, *w2_or_v)
            finger = self._body(contact.finger)
            spatial = *(frame_1 or _NO_FRAME), *(frame_2 or _NO_FRAME)
            rows.append(_ROW(*finger, *flags, *legs[contact.legs], *place, *spatial))
        return rows


def _windows(scene: Scene, begin: float) -> dict[int, list[Disturbance]]:
    """Disturbances of each contact that end after ``begin``; refuses acceleration at rest."""
    windows: dict[int, list[Disturbance]] = {}
    for d in scene.disturbances:
        if d.stop > begin:
            windows.setdefault(int(d.contact), []).append(d)
    never_rests = not (windows and scene.profile.zeros(scene.duration))
    for contact, disturbances in windows.items():
        if never_rests and not scene.contacts[contact].legs:
            continue
        for d in disturbances:
            if d.accelerates and any(d.value):
                refuse_rest(scene, contact, max(d.start, begin), d.stop)
    return windows


def _solved_frames(scene: Scene, starts: Sequence[Any]) -> dict[int, list[tuple[float, ...]]]:
    """By contact, x and p of finger and object on surfaces without a chart, () on others.

    Points of such a surface are solutions of F = 0 along rays; all of one surface are found at
    once.
    """
    places: dict[Surface, list[tuple[int, int]]] = {}
    frames: dict[int, list[tuple[float, ...]]] = {}
    if isinstance(starts[0], Moment):
        return frames
    for i, contact in enumerate(scene.contacts):
        for side, surface in enumerate((contact.finger, scene.object)):
            if not surface.has_chart:
                places.setdefault(surface, []).append((i, side))
    for surface, where in places.items():
        uv = np.array([(starts[i].finger_at, starts[i].object_at)[side] for i, side in where])
        point, frame = surface.point_and_frame(*uv.T)
        for (i, side), found in zip(where, np.hstack([point, frame[..., 0]]).tolist()):
            frames.setdefault(i, [(), ()])[side] = tuple(found)
    return frames


# --- the motion ----------------------------------------------------------------------------------


class Motion:
    """Contacts planned by the engine: finger and object, interval by interval.

    begin: when the motion begins, s; starts: how the contacts start then, by default as the scene
    says. Raises a ContactSystemError that tells why the scene cannot be planned.
    """

    _as_parameter_: int | None = None  # the plan's address: ctypes passes it for this object

    def __init__(
        self, scene: Scene, tolerance: float, begin: float = 0.0, starts: Starts | None = None
    ):
        buffer = Buffer(scene, tolerance, begin, starts)
        self.scene, self._count = scene, len(scene.contacts)
        self._surfaces = buffer.surfaces  # kept: the engine points into their tables
        addresses = [ctypes.addressof(surface.engine_data) for surface in self._surfaces]
        self._addresses = (ctypes.c_void_p * len(addresses))(*addresses)
        failure, size = binding.Failure(), len(buffer.numbers) // 8
        plan = binding.plan(buffer.numbers, size, ctypes.addressof(self._addresses), byref(failure))
        self._as_parameter_ = plan
        if not plan:
            raise failed(scene, failure)

    __del__ = binding.drop

    def evaluate(
        self, t: np.ndarray, names: Sequence[str], gaps: bool = False
    ) -> dict[str, np.ndarray] | None:
        """Results, (n_times, n_contacts, ...), in one pass; None if a time is outside the plan.

        gaps: at a pole or an umbilic return what is not finite instead of raising an error.
        """
        t = np.ascontiguousarray(t)
        count, n = self._count, len(t)
        # one block: freed pages of several large arrays would be cleared by the system for reuse
        block, stop = np.empty(count * n * sum(_SIZES[name] for name in names)), 0
        first, outputs, results = address(block), (ctypes.c_void_p * len(_ALL))(), {}
        for name in names:
            start, stop = stop, stop + count * n * _SIZES[name]
            outputs[_PLACES[name]] = first + 8 * start
            values = block[start:stop].reshape(count, *_ALL[name], n)
            results[name] = values.transpose(_TIMES_FIRST[name])
        self._call(binding.anchor, ctypes.addressof(outputs))  # does nothing after the first time
        failure = binding.Failure()
        if n and binding.evaluate(self, n, address(t), ctypes.addressof(outputs), byref(failure)):
            if failure.code == OUTSIDE:
                return None
            if not (gaps and failure.code == SINGULAR_TIME):
                raise failed(self.scene, failure)
        return results

    def _call(self, function: Any, *arguments: Any) -> None:
        """Call a function of the engine on this plan; raises its error."""
        failure = binding.Failure()
        if function(self, *arguments, byref(failure)):
            raise failed(self.scene, failure)

    def moments(self, t: float) -> list[Moment]:
        """The state of every contact's moving frames at time t."""
        rows = np.empty((self._count, MOMENT))
        self._call(binding.moments, t, address(rows))
        found = []
        for contact, row in zip(self.scene.contacts, rows.tolist()):
            places, paths = (tuple(row[:3]), tuple(row[3:6])), (tuple(row[7:9]), tuple(row[9:11]))
            both = (contact.finger, row[11:17]), (self.scene.object, row[17:23])
            frames = [tuple(frame) if in_space(surface) else () for surface, frame in both]
            found.append(Moment(*places, row[6], *paths, *frames))
        return found

    def lines(self) -> list[str]:
        """How each contact and interval was planned, why, and what was skipped."""
        facts: list[Any] = []
        for i in range(self._count):
            facts.append((binding.Fact * binding.facts(self, i, 0, None))())
            binding.facts(self, i, len(facts[i]), facts[i])
        return lines(self.scene, facts)
