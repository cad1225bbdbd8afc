"""Whole plans in one compiled call (c/program.c): integrate what is not yet, evaluate every track.

Python's own work is then the same for any number of contacts, intervals and bodies.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import struct
import sys
import threading
from collections.abc import Callable, Sequence

import numpy as np

from .closed_form import CircleTrack, FlatTrack
from .groups import SIDES, Group
from .kernels import address, function_address
from .panel_tracks import MovingTrack
from .panels import MOST_AT_ONCE, Motion, collocation, program_built, program_library
from .tracks import Track, evaluator


class _Part(ctypes.Structure):
    """``part_t`` of c/program.c."""

    _fields_ = [("evaluate", ctypes.c_void_p), ("track", ctypes.c_void_p)]
    _fields_ += [(name, ctypes.c_long) for name in (
        "moves", "offset", "stride", "first", "last", "row")]  # fmt: skip
    _fields_ += [(name, ctypes.c_void_p) for name in ("begin", "path", "branch", "anchor")]


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
        self._numbers = ctypes.c_int64 * (2 + len(self.motions))

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
            try:
                for motion in waiting:
                    motion.ready()
                code = self._run(*arguments)
                if code < 0 and at[0] < 0:  # still held: another thread may wait to integrate there
                    motions[at[1]].failed(at[0])
            finally:
                for motion in waiting:
                    motion.lock.release()
            if code >= 0:
                return code
            if at[0] >= 0:
                return None


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
        if group.pair is not None and group.in_a_row:
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


def group_program(group: Group, output: str) -> Program | None:
    """The program of a plan of this group alone.

    It is laid out once for tracks of the same kinds.
    """
    if output not in group.programs:
        known: Program | None = group.layouts.get(output)
        if known is None:
            made = program_of([group], output)
            if made is not None:
                group.layouts[output] = made.blank()
        else:
            made = known.again([group.pair] if group.pair else group.finger + group.object)
        group.programs[output] = made
    return group.programs[output]


# --- side by side ---------------------------------------------------------------------------------

ASKED = struct.Struct("@PPdPlllllPP")  # ``asked_t`` of c/program.c
WORTH = 10_000  # contacts times times for a thread: 0.4 ms of work, ten times its start
SHARES = 8  # of each thread, where another may be late
HEADER = object.__basicsize__  # of every object in CPython, whose id is its address


def _layout_known() -> bool:
    """Whether arrays hold the address of their numbers behind the header, where numpy's C interface
    (PyArray_DATA) has it. C reads it there; to ask Python for two addresses takes 0.9 us."""
    probe, cpython = np.empty(1), sys.implementation.name == "cpython"
    return cpython and ctypes.c_void_p.from_address(id(probe) + HEADER).value == probe.ctypes.data


LAYOUT_KNOWN = _layout_known()


def by_contacts(
    run: Callable[[bytes], int],
    head: tuple[int, int, float, int, int, int],
    count: int,
    t: np.ndarray,
    out: np.ndarray,
) -> int:
    """Have C fill results of all contacts, on every processor.

    C takes the same contacts at once as on one processor: results are the same to the bit.

    Parameters
    ----------
    run : ``states`` or ``fill_begun`` of c/program.c
    head : what it is asked, up to the rows of each body

    Returns
    -------
    int
        What ``run`` returned for the first contacts for which it was not 0; else 0.
    """
    if LAYOUT_KNOWN:
        times = len(t), id(t) + HEADER, id(out) + HEADER
    else:
        held = (ctypes.c_void_p * 2)(address(t), address(out))
        times = len(t), ctypes.addressof(held), ctypes.addressof(held) + ctypes.sizeof(held) // 2
    if count <= MOST_AT_ONCE or count * len(t) < 2 * WORTH or (found := processors()) < 2:
        return run(ASKED.pack(*head, 0, count, *times))
    threads = min(count * len(t) // WORTH, -(-count // MOST_AT_ONCE), found)
    return _side_by_side(run, head, count, times, threads)


def _side_by_side(
    run: Callable[[bytes], int],
    head: tuple[int, int, float, int, int, int],
    count: int,
    times: tuple[int, int, int],
    threads: int,
) -> int:
    """The same in threads, each of which takes a share of the contacts when it is free."""
    step = MOST_AT_ONCE * -(-count // (MOST_AT_ONCE * SHARES * threads))
    left, codes = iter(range(0, count, step)), {}

    def work() -> None:
        for first in left:
            codes[first] = run(ASKED.pack(*head, first, min(first + step, count), *times))

    others = [threading.Thread(target=work) for _ in range(threads - 1)]
    started = []
    try:
        with contextlib.suppress(RuntimeError):  # no more threads: those there are do it all
            for other in others:
                other.start()
                started.append(other)
        work()
    finally:  # after this nobody writes to results
        for other in started:
            other.join()
    return next((code for _, code in sorted(codes.items()) if code), 0)


def processors() -> int:
    """How many threads fill results of many contacts: all processors, or ``OMP_NUM_THREADS``.

    One in processes that multiprocessing started, which share the processors already.
    """
    process = sys.modules.get("multiprocessing.process")
    if process is not None and process.parent_process() is not None:
        return 1
    affinity = getattr(os, "sched_getaffinity", None)
    found = len(affinity(0)) if affinity else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return min(found, int(asked)) if asked.isdecimal() and int(asked) else found


# --- chart states ---------------------------------------------------------------------------------


class _Side(ctypes.Structure):
    """``side_t`` of c/program.c."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("evaluate", "resolve", "anchor", "track")]
    _fields_ += [(name, ctypes.c_long) for name in ("moves", "rows")]
    _fields_ += [("begin", ctypes.c_void_p)]


class _States(ctypes.Structure):
    """``states_t`` of c/program.c."""

    _fields_ = [("side", _Side * 2)]
    _fields_ += [(name, ctypes.c_void_p) for name in ("angle", "node", "project")]


@functools.cache
def _projection() -> np.ndarray:
    return np.ascontiguousarray(collocation().project.T)


class ChartStates:
    """Chart states of a group whose sides are one track each, in one compiled call.

    For many times, great circles beside a side that is integrated, and what is integrated in space,
    are turned into series first: their coordinates are dear at each time.
    """

    def __init__(self, group: Group, sides: Sequence[_Side]):
        node, project = collocation().node, _projection()
        self._data = _States(
            (_Side * 2)(*sides), address(group.angle), address(node), address(project)
        )
        self.at, self._count = ctypes.addressof(self._data), len(group.contacts)
        self._motions = [track.motion for track in group.moving if track.motion]
        self._kept = group.finger, group.object, group.angle, group.begin, node, project
        self._run = program_library().states

    def fill(self, tolerance: float, t: np.ndarray, out: np.ndarray) -> int:
        """Write (n, 9, n_t).

        Returns
        -------
        int
            0; 1 + the index of a time outside the plan; < 0: ask the tracks instead.
        """
        for motion in self._motions:
            motion.run()
        return by_contacts(self._run, (0, 0, tolerance, self.at, 0, 0), self._count, t, out)


def chart_states(group: Group, compiled: bool | None) -> ChartStates | None:
    """For a group of that kind; None for others, and where C is not built."""
    if "states" not in group.programs:
        group.programs["states"] = _chart_states(group, compiled)
    return group.programs["states"]


def _chart_states(group: Group, compiled: bool | None) -> ChartStates | None:
    if len(group.finger) > 1 or len(group.object) > 1 or not (compiled or program_built()):
        return None
    moves = any(isinstance(t, MovingTrack) for t in (group.finger[0], group.object[0]))
    sides = [
        _side(track, begin, moves)
        for track, begin in zip((group.finger[0], group.object[0]), group.begin)
    ]
    known = [side for side in sides if side is not None]
    return ChartStates(group, known) if len(known) == 2 else None


def _side(track: Track, begin: np.ndarray, moves: bool) -> _Side | None:
    """A side of one track, beside one that moves or not; None where C cannot evaluate it."""
    if not isinstance(track, MovingTrack):
        closed = isinstance(track, (CircleTrack, FlatTrack))
        entry = track.entry("coordinates") if closed else None
        if entry is None:
            return None
        if not track.anchored:  # what is shared by all plans of a scene is not written again
            track.anchor(begin)
        own, dear = entry[0], moves and isinstance(track, CircleTrack)
        series = own.pointer if dear else None
        return _Side(own.pointer, series, None, entry[1], False, own.kernel.n_result)
    if track.motion is None or track.problem.stops or track.offset is not None:
        return None
    chart = track.evaluator("coordinates")
    if not chart.usable(track.compiled):
        return None
    found = _Side(chart.pointer, None, None, track.motion.at, True, chart.kernel.n_result)
    if not track.ambient:
        return found
    found.anchor, found.begin = function_address(chart.library.anchor), address(begin)
    apart = chart if track.v is None else evaluator(track.surface, True, "split")
    if apart.usable(track.compiled):
        found.resolve, found.rows = apart.pointer, apart.kernel.n_result
    return found
