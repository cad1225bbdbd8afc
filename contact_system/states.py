"""Chart states of contacts that slip, in one compiled call (c/states.c).

For the commonest plan, fingers on great circles and objects developed with slip over one interval,
``Plan.states`` needs neither the motion nor its conversion at every time: both are turned into
series of chart states once, panel by panel. The object's integration is left to that call too.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable

import numpy as np

from .closed_form import CircleTrack
from .development import (
    DrivenTrack,
    Method,
    collocation,
    method_pointers,
    panel_library,
    panels_built,
)
from .kernels import (
    NODES,
    PRELUDE,
    address,
    c_source,
    compiled_library,
    find_compiler,
    library_path,
)
from .tracks import Track, TrackData, drive_data, evaluator

MOST = 8  # bodies a call
FEW_TIMES = 48  # below this, series are not worth making
PANELS, SERIES = 24, 96  # room a call has; it is not the only way
ROWS = 11  # see c/states.c


class _Program(ctypes.Structure):
    _fields_ = (
        [(name, ctypes.c_void_p) for name in (
            "integrate", "finger", "object", "tip", "body", "aside", "method")]
        + [(name, ctypes.c_long) for name in ("nx", "room")]
        + [("tolerance", ctypes.c_double)]
        + [(name, ctypes.c_void_p) for name in (
            "start", "constants", "scale", "begin", "angle", "project", "state", "spare", "work",
            "edges", "motion", "cuts", "series")]
        + [("n_series", ctypes.c_long)]
    )  # fmt: skip


@functools.cache
def _source() -> str:
    return f"{PRELUDE}#define MOST {MOST}\n{c_source('states.c')}"


@functools.cache
def _library() -> ctypes.CDLL:
    library = compiled_library(_source())
    library.states.argtypes = [ctypes.c_void_p, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    library.states.restype = ctypes.c_long
    return library


@functools.cache
def _built() -> bool:
    return find_compiler() is not None and library_path(_source()).exists()


@functools.cache
def _projection() -> np.ndarray:
    """Node values to Legendre coefficients, transposed: (N, N)."""
    return np.ascontiguousarray(collocation().project.T)


def fits(finger: Track, body: Track, compiled: bool | None) -> bool:
    """Whether the tracks of two sides can be evaluated by :func:`states`, with what is built."""
    if not isinstance(finger, CircleTrack) or not isinstance(body, DrivenTrack):
        return False
    if not body.ambient or body.offset is not None or len(body.parameters) > MOST:
        return False
    if body.problem.stops or finger.entry("coordinates") is None:
        return False
    if compiled is None:
        there = evaluator(body.surface, True, "coordinates").built
        return there and panels_built(body.kernel) and _built()
    return compiled


def states(
    finger: CircleTrack,
    track: DrivenTrack,
    begin: np.ndarray,
    angle: np.ndarray,
    t: np.ndarray,
    out: np.ndarray,
) -> int:
    """Evaluate chart states; the tracks must be such that :func:`fits`.

    Parameters
    ----------
    finger : CircleTrack
        With its branch known.
    track : DrivenTrack
        The objects.
    begin : (n, 3)
        u, v, theta of the objects at the start.
    angle : (n,)
        psi at the start.
    t : (n_times,)
    out : (n, 9, n_times)

    Returns
    -------
    int
        0, or the code of ``states`` in c/states.c.
    """
    problem, shared = track.problem, track.shared
    if "states" not in shared:
        shared["states"] = _Layout(finger, track, begin, angle)
    layout: _Layout = shared["states"]
    block = np.empty(layout.size)
    at = address(block)
    program = _Program.from_buffer_copy(layout.program)
    body, aside = TrackData.from_buffer_copy(layout.body), TrackData()
    tolerance = max(0.1 * problem.tolerance, 4e-16)
    method = Method(
        problem.length, tolerance, problem.first, problem.slip, problem.finish, -1.0,
        *method_pointers(), problem.stiff, PANELS, False,
    )  # fmt: skip
    program.body, program.aside = ctypes.addressof(body), ctypes.addressof(aside)
    program.method, program.tolerance = (
        ctypes.addressof(method),
        max(0.1 * problem.tolerance, 1e-14),
    )
    state, spare, work, edges, motion, cuts, series = layout.offsets
    program.state, program.spare, program.work = at + state, at + spare, at + work
    program.edges, program.motion = at + edges, at + motion
    program.cuts, program.series = at + cuts, at + series
    return layout.run(ctypes.addressof(program), len(t), address(t), address(out))


class _Layout:
    """What :func:`states` needs of two tracks and does not change: laid out for C once a scene."""

    def __init__(
        self, finger: CircleTrack, track: DrivenTrack, begin: np.ndarray, angle: np.ndarray
    ):
        problem = track.problem
        n, nx = problem.start.shape
        sizes = (n * nx, n * nx, (2 * nx + 2) * NODES, PANELS + 1, PANELS * n * nx * (NODES + 1),
                 SERIES + 1, SERIES * n * ROWS * NODES)  # fmt: skip
        self.size = sum(sizes)
        self.offsets = tuple(8 * sum(sizes[:i]) for i in range(len(sizes)))
        piece = problem.drive
        period_u, period_v = track.surface.periods()
        assert track.v is not None
        self.body = TrackData(
            track.start, track.stop, drive_data(piece), n, False, False, 0, n * nx * (NODES + 1),
            nx * (NODES + 1), 0, track.surface.double_cover, period_u or 0.0, period_v or 0.0,
            address(track.parameters), address(piece.arrays[1]), address(track.w),
            address(track.v), None, None, None, None,
        )  # fmt: skip
        own = finger.entry("coordinates")
        assert own is not None
        evaluate = evaluator(track.surface, True, "coordinates").library.evaluate
        arrays = (problem.start, problem.constants, problem.scale, begin, angle, _projection())
        self.program = _Program(
            _pointer(panel_library(track.kernel).panels), _pointer(own[0]), _pointer(evaluate),
            own[1], None, None, None, nx, SERIES, 0.0,
            *map(address, arrays), *[None] * 7, 0,
        )  # fmt: skip
        self.run = _library().states
        # the addresses above stay good as long as these do
        self._kept = (piece, track.parameters, track.w, track.v, finger, arrays)


def _pointer(function: Callable[..., int]) -> int | None:
    return ctypes.cast(function, ctypes.c_void_p).value  # type: ignore[arg-type]
