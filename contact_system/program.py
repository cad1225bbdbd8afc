"""Whole plans in one compiled call (c/program.c): integrate what is not yet, evaluate every track.

Python's own work is then the same for any number of contacts, intervals and bodies.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev

from .closed_form import CircleTrack
from .development import (
    MOST_AT_ONCE,
    Motion,
    MovingTrack,
    collocation,
    panels_built,
    program_built,
    program_library,
)
from .kernels import address
from .tracks import Track, evaluator

if TYPE_CHECKING:
    from .planner import Group

SIDES = ("finger", "object")


class _Part(ctypes.Structure):
    """``part_t`` of c/program.c."""

    _fields_ = [("evaluate", ctypes.c_void_p), ("track", ctypes.c_void_p)]
    _fields_ += [(name, ctypes.c_long) for name in ("moves", "offset", "stride", "first", "last")]


class Program:
    """One output, "points" or "coordinates", of all tracks of a plan."""

    def __init__(self, output: str, tracks: Sequence[Track], parts: Sequence[_Part]):
        self.output, self.tracks, self.parts = output, tracks, (_Part * len(parts))(*parts)
        self._find_motions()

    def _find_motions(self) -> None:
        """After the tracks are known."""
        self.at = ctypes.addressof(self.parts)
        self._run, self._count = program_library().fill, len(self.parts)
        self.motions: list[Motion] = [
            track.motion for track in self.tracks if isinstance(track, MovingTrack) and track.motion
        ]
        self._numbers = ctypes.c_long * (2 + len(self.motions))

    def blank(self) -> Program:
        """The layout alone, which keeps no track alive."""
        other = object.__new__(Program)
        other.output, other.tracks = self.output, ()
        other.parts = type(self.parts).from_buffer_copy(self.parts)
        return other

    def again(self, tracks: Sequence[Track]) -> Program | None:
        """The same for other tracks of the same kinds; None where one has no compiled form."""
        other = object.__new__(Program)
        other.output, other.tracks = self.output, tracks
        other.parts = type(self.parts).from_buffer_copy(self.parts)
        for part, track in zip(other.parts, tracks):
            at = track.data_at(self.output)
            if at is None:
                return None
            part.track = at
        other._find_motions()
        return other

    def fill(self, count: int, t: np.ndarray, out: np.ndarray) -> int | None:
        """Write ``count`` rows of finger and object of each contact: (n_contacts, 2 count, n_t).

        Returns
        -------
        int or None
            0; 1 + the index of a time outside the plan; None: ask the tracks one by one, which
            also says what is wrong with a contact at a pole.
        """
        motions = self.motions
        at = self._numbers(0, 0, *[motion.at for motion in motions])
        arguments = self.at, self._count, count, len(t), address(t), address(out), at
        while True:
            waiting = [motion for motion in motions if not motion.data.done]
            for motion in waiting:
                motion.lock.acquire()
                motion.ready()
            code = self._run(*arguments)
            for motion in waiting:
                motion.lock.release()
            if code >= 0:
                return code
            if at[0] >= 0:
                return None
            motions[at[1]].failed(at[0])


def program_of(groups: Sequence[Group], output: str) -> Program | None:
    """The program of all groups of a plan; None where some track has no compiled evaluation."""
    tracks: list[Track] = []
    parts: list[_Part] = []
    moved = 0
    for group in groups:
        contacts = group.contacts
        first, step = int(contacts[0]), int(contacts[1] - contacts[0]) if len(contacts) > 1 else 1
        if len(contacts) > 2 and (np.diff(contacts) != step).any():
            return None
        if group.pair is not None and step == 1:
            chains = [([group.pair], 2 * first, 1)]
        else:
            chains = [
                (getattr(group, side), 2 * first + k, 2 * step) for k, side in enumerate(SIDES)
            ]
        for chain, offset, stride in chains:
            for track in chain:
                entry = track.entry(output)
                if entry is None:
                    return None
                moves = 0
                if isinstance(track, MovingTrack) and track.motion is not None:
                    moves = moved = moved + 1
                parts.append(_Part(
                    entry[0].pointer, entry[1], moves, offset, stride, track is chain[0],
                    track is chain[-1],
                ))  # fmt: skip
                tracks.append(track)
    return (
        Program(output, tracks, parts)
        if all(t.compiled or program_built() for t in tracks)
        else None
    )


# --- chart states of contacts that slip ----------------------------------------------------------

FEW_TIMES = 48  # below this, series are not worth making


class _States(ctypes.Structure):
    """``states_t`` of c/program.c."""

    _fields_ = [(name, ctypes.c_void_p) for name in (
        "finger", "object", "tip", "begin", "angle", "project")]  # fmt: skip


@functools.cache
def _projection() -> np.ndarray:
    """Node values to Chebyshev coefficients, transposed: (N, N)."""
    node = collocation().node
    return np.ascontiguousarray(np.linalg.inv(chebyshev.chebvander(node, len(node) - 1)).T)


class SlippingStates:
    """Chart states of the commonest plan as series made once, piece by piece.

    Fingers run on great circles, objects are developed with slip over one interval.
    """

    def __init__(self, group: Group, finger: CircleTrack, body: MovingTrack):
        own, begin, project = finger.entry("coordinates"), group.begin[1], _projection()
        assert own is not None
        self._data = _States(
            own[0].pointer, evaluator(body.surface, True, "split").pointer, own[1], address(begin),
            address(group.angle), address(project),
        )  # fmt: skip
        self.at = ctypes.addressof(self._data)
        self._kept = finger, begin, group.angle, project  # addresses point into them
        self._run = program_library().states

    @classmethod
    def of(cls, group: Group, compiled: bool | None) -> SlippingStates | None:
        """For a group of that kind; None for others, and where C is not built."""
        if len(group.finger) > 1 or len(group.object) > 1:
            return None
        finger, body = group.finger[0], group.object[0]
        if not isinstance(finger, CircleTrack) or not isinstance(body, MovingTrack):
            return None
        if not body.ambient or body.v is None or body.offset is not None or body.problem.stops:
            return None
        if len(body.parameters) > MOST_AT_ONCE or finger.entry("coordinates") is None:
            return None
        there = evaluator(body.surface, True, "split").built if compiled is None else compiled
        built = compiled or (there and panels_built(body.kernel) and program_built())
        return cls(group, finger, body) if built else None

    def fill(self, motion: Motion, t: np.ndarray, out: np.ndarray) -> int:
        """Write (n, 9, n_t) for such a plan, whose object has this motion.

        Returns
        -------
        int
            0; 1 + the index of a time outside the plan; -4: ask the tracks instead.
        """
        times, to = address(t), address(out)
        while True:
            with motion.lock:
                motion.ready()
                code = self._run(self.at, motion.at, len(t), times, to)
            if code not in (-1, -2, -3):
                return code
            motion.failed(code)
