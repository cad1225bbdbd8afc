"""Gauss collocation in panels, here and in C (c/panels.c).

The length of a panel follows the decay of the solution's Chebyshev series; that series is also the
dense output.
"""

from __future__ import annotations

import ctypes
import functools
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev, legendre

from .errors import ContactSystemError
from .kernels import (
    NODES,
    PRELUDE,
    Kernel,
    address,
    c_source,
    compiled_library,
    contiguous,
    function_address,
    is_built,
    per_structure,
)
from .profile import GainPiece
from .tracks import BRANCH, NODE, PARTS, Drive, TrackData, altered, drive_data

# NODES = 16: on a unit sphere a panel spans about 2 rad at 1e-14 and Picard sweeps still converge.
SWEEPS = 40
COARSE = 1e-6  # tolerance beyond which tails tell nothing of errors; panels are hardly fewer
TAIL = 3.6  # times a series' last coefficient is taken for its error
STEEPEST = 20.0  # fall of ln(decay) in a panel; 30 takes 3 % more sweeps, 16 as many
FALL = 4.5  # the same in a first panel at a tolerance of 1e-12
MANY = 4096  # panels from one look at how many more it will take to the next
MOST = 1e6  # panels of one interval; beyond, a scene is refused
MOST_HERE = 1e5  # without compiled kernels, where a panel takes 0.3 ms
MOST_BYTES = 2e9
ALMOST_RESTS = 1e-5  # of the greatest coefficient of sigma: what is said of an acceleration there


@dataclass(frozen=True)
class Collocation:
    """Matrices of collocation at the Gauss points of [-1, 1].

    project : (N, N), node values -> Chebyshev coefficients of the interpolant
    integral : (N, N), antiderivative of the interpolant at the nodes
    series : (N + 1, N), node values of f -> Chebyshev coefficients of its antiderivative from -1
    end : (2, N), weights of the integral over [-1, 1]; extrapolation of node values to +1
    """

    node: np.ndarray
    project: np.ndarray
    integral: np.ndarray
    series: np.ndarray
    end: np.ndarray


@functools.cache
def collocation() -> Collocation:
    """The matrices, from Chebyshev polynomials at Gauss points.

    Chebyshev's recurrence takes one operation where Legendre's takes three.
    """
    n = NODES
    node, _ = legendre.leggauss(n)
    basis = chebyshev.chebvander(node, n)  # T_0 .. T_n at the nodes
    project = np.linalg.inv(basis[:, :n])
    primitive = chebyshev.chebint(np.eye(n), lbnd=-1)
    series = primitive @ project
    end = np.vstack([primitive.sum(axis=0), np.ones(n)]) @ project
    return Collocation(
        node, project, np.ascontiguousarray(basis @ series), np.ascontiguousarray(series), end
    )


@dataclass(eq=False)  # not frozen: that makes it four times slower to make
class Panels:
    """A motion as Chebyshev series on panels.

    edges : (K + 1,), local time (or arc length) of the panel ends
    coefficients : (K, n_bodies, n_states, N + 1)
    end : (n_bodies, n_states), the state at the last edge
    released : local time at which slip was let go, or None
    at : addresses of edges and coefficients, where they are known
    """

    edges: np.ndarray
    coefficients: np.ndarray
    end: np.ndarray
    released: float | None = None
    at: tuple[int, int] | None = None

    @property
    def count(self) -> int:
        return len(self.edges) - 1

    def evaluate(self, tau: np.ndarray, states: slice = slice(None)) -> np.ndarray:
        """The states at local times in any order: (n_bodies, n_states, n_times)."""
        coefficients = self.coefficients[:, :, states]
        out = np.empty(coefficients.shape[1:3] + (len(tau),))
        which = np.searchsorted(self.edges[1:-1], tau, side="right")
        xi = 2.0 * (tau - self.edges[which]) / np.diff(self.edges)[which] - 1.0
        basis = _basis(xi)
        for k, part in runs(which):
            if isinstance(part, slice):
                np.matmul(coefficients[k], basis[:, part], out=out[:, :, part])
            else:
                out[:, :, part] = coefficients[k] @ basis[:, part]
        return out

    def evaluate_each(self, tau: np.ndarray, bodies: np.ndarray, states: slice) -> np.ndarray:
        """The states of each of some bodies at its own local time: (n, n_states)."""
        which = np.searchsorted(self.edges[1:-1], tau, side="right")
        xi = 2.0 * (tau - self.edges[which]) / np.diff(self.edges)[which] - 1.0
        basis = _basis(xi)
        return np.einsum("nsk,kn->ns", self.coefficients[which, bodies, states], basis)

    def in_parts(self, panels: slice, states: slice) -> np.ndarray:
        """States of some panels where :func:`.tracks.in_parts` says: (n_bodies, n_states, n)."""
        found = self.coefficients[panels, :, states] @ _parts()
        inner = np.moveaxis(found[..., 1 : PARTS + 1], 0, 2).reshape(*found.shape[1:3], -1)
        return np.concatenate([found[0, ..., :1], inner, found[-1, ..., PARTS + 1 :]], axis=2)


def runs(which: np.ndarray) -> Iterator[tuple[int, slice | np.ndarray]]:
    """(value, where it stands), for each value of an integer array; slices where it is one run."""
    if len(which) == 0:
        return
    ends = np.flatnonzero(np.diff(which)) + 1
    starts = [0, *ends.tolist()]
    values = which[starts].tolist()
    if len(set(values)) == len(values):
        yield from zip(values, map(slice, starts, [*ends.tolist(), len(which)]))
    else:
        for value in sorted(set(values)):
            yield value, np.flatnonzero(which == value)


def _basis(xi: np.ndarray) -> np.ndarray:
    """T_0 .. T_N at xi: (N + 1, n)."""
    basis = np.empty((NODES + 1, len(xi)))
    before, now, *rows = basis
    before[:], now[:], twice = 1.0, xi, 2.0 * xi
    for row in rows:
        np.multiply(twice, now, out=row)
        row -= before
        before, now = now, row
    return basis


@functools.cache
def _parts() -> np.ndarray:
    return _basis(np.arange(-1, PARTS + 2) * (2.0 / PARTS) - 1.0)


@dataclass(eq=False)
class Problem:
    """What :func:`integrate` needs to know beside the kernel.

    Attributes
    ----------
    name : str
        Scene and contacts, for messages.
    start : (n_bodies, n_states)
    constants : (n_bodies, n_constant)
    scale : (n_bodies, n_states)
        1 / (size of each state): errors are measured in these units.
    drive : GainPiece
        sigma and decay as functions of local time.
    length : float
        End of the integration in local time.
    first : float
        First panel to try at a tolerance of 1e-12.
    slip : float
        Greatest |V| of the bodies; 0 where there is none (decay is then not evaluated).
    finish : float
        Let slip go once slip * decay is below this many tolerances; 0: never.
    stops : bool
        End the integration there, else go on without slip.
    stiff : int
        How many trailing states carry the term -lam.
    variable : str
        What ``length`` is of, for messages.
    """

    name: str
    start: np.ndarray
    constants: np.ndarray
    scale: np.ndarray
    drive: GainPiece
    length: float
    first: float
    slip: float = 0.0
    finish: float = 0.0
    stops: bool = False
    stiff: int = 0
    variable: str = "local time"

    def moved(self, start: np.ndarray, constants: np.ndarray, **others: Any) -> Problem:
        """This problem from another start with other constants, both contiguous."""
        return altered(self, start=start, constants=constants, **others)

    def limits(self, tolerance: float) -> tuple[float, float, float]:
        """Bound of a series' tail, greatest slip that counts, and where it is let go."""
        finish = self.finish * tolerance
        # Below 4e-16 a series' tail is rounding noise.
        tail = max(0.1 * min(tolerance, COARSE), 4e-16)
        return tail, self.slip if self.slip > finish else 0.0, finish


def integrate(
    kernel: Kernel, problem: Problem, tolerance: float, compiled: bool | None = False
) -> Panels:
    """Integrate all bodies of a problem in lockstep.

    Parameters
    ----------
    kernel : Kernel
    problem : Problem
    tolerance : float
        Ten times the bound of the truncated series tail of a panel, in units of ``1 / scale``;
        COARSE where it is greater.
    compiled : bool or None
        True compiles if need be, False never, None uses what was built before.

    Raises
    ------
    ContactSystemError
        The panels shrink without end (the motion leaves its chart, or the surface is not smooth).
    """
    if usable(kernel, compiled):
        return Motion(kernel, problem, tolerance).panels()
    return _integrate_here(kernel, problem, tolerance)


def _pushed_at_rest(problem: Problem, tau: float) -> str:
    """What to do about an acceleration where the path all but rests; empty elsewhere."""
    sigma = problem.drive.speed(tau)
    if not problem.stiff or sigma > ALMOST_RESTS * max(map(abs, problem.drive.sigma)):
        return ""
    return (
        f"an acceleration acts where the path almost rests, sigma = {sigma:.3g} m/s; add a "
        "constant to the profile, or accelerate before or after"
    )


def _stuck(problem: Problem, tau: float) -> ContactSystemError:
    why = _pushed_at_rest(problem, tau) or (
        "the path reaches a singular point of its chart or its surface, or moves too fast for "
        "double precision; start elsewhere, change the direction or end the scene before"
    )
    return ContactSystemError(
        f"{problem.name}: the motion cannot be continued past {problem.variable} "
        f"{problem.drive.start + tau:.9g}: {why}"
    )


def _endless(problem: Problem, tau: float, count: int, most: float = MOST) -> ContactSystemError:
    why = _pushed_at_rest(problem, tau) or (
        "shorten the scene, lower the speed, the acceleration or the surface's curvature, or give "
        "a surface of your own a greater size; where a disturbance drives the contact into a pole "
        "of its chart, end its window before"
    )
    reached = problem.drive.start + tau
    return ContactSystemError(
        f"{problem.name}: {count} panels reach {problem.variable} {reached:.9g} of "
        f"{problem.drive.start + problem.length:.9g} only, more than {most:g} would be needed; "
        + why
        + (", or plan with compiled=True" if most < MOST else "")
    )


def _integrate_here(kernel: Kernel, problem: Problem, tolerance: float) -> Panels:
    """The panels with the virtual machine and numpy; panels.c has the same steps."""
    m, drive = collocation(), problem.drive
    tolerance, slip, finish = problem.limits(tolerance)
    start = np.array(problem.start)
    n_bodies, n_states = start.shape
    machine = kernel.nodes(problem.constants, NODES)
    x, f = machine.x, machine.y
    scale, n_smooth = problem.scale[:, None, :], n_states - problem.stiff
    released = None
    edges: list[float] = [0.0]
    series: list[np.ndarray] = []
    # what sweeps may start from: a series, its length, and its end (1) or start (-1) at tau
    known: tuple[np.ndarray, float, float] | None = None
    wide = (tolerance / 1e-13) ** (1.0 / NODES)
    first = problem.first * wide
    h = longest_panel(drive, slip, 0.0, min(first, problem.length), min(STEEPEST, FALL * wide))
    tau, tries, mark = 0.0, 0, 0.0
    while tau < problem.length:
        tries += 1
        # a layer at the start may be as thin as it likes
        if tries > 40 * (len(series) + 25) or not h > 1e-15 * tau + 1e-30 * problem.length:
            raise _stuck(problem, tau)
        if len(series) and len(series) % MANY == 0 and tau > mark:
            if MANY * (problem.length - tau) > MOST_HERE * (tau - mark):
                raise _endless(problem, tau, len(series), MOST_HERE)
            mark = tau
        h = longest_panel(drive, slip, tau, min(h, problem.length - tau), STEEPEST)
        after = tau + h
        if after >= problem.length * (1 - 1e-14):
            after = problem.length
        half = 0.5 * (after - tau)
        t = tau + half * (1.0 + m.node)
        sigma = drive.speed(t)
        x[:, :, n_states] = sigma
        x[:, :, n_states + 1] = drive.decay(t, sigma) if slip > 0 else 0.0
        if known and after - tau <= (2.0 if known[2] > 0 else 1.0) * known[1]:
            # Picard sweeps start from the last panel's series (28 % fewer of them), or from that
            # of the longer panel that was refused
            before, length, place = known
            basis = _basis(place + (after - tau) / length * (1.0 + m.node))
            x[:, :, :n_states] = (before @ basis).transpose(0, 2, 1)
        else:
            x[:, :, :n_states] = start[:, None, :]
        if problem.stiff:
            lam = drive.gain(t)[:, None]
            solve = np.linalg.inv(np.eye(NODES) + half * m.integral * lam.T)
        last = np.inf
        with np.errstate(all="ignore"):  # a diverging sweep is caught below
            for k in range(SWEEPS):
                machine.run()
                new = start[:, None, :] + half * (m.integral @ f)
                if problem.stiff:
                    new[:, :, n_smooth:] = solve @ new[:, :, n_smooth:]
                    f[:, :, n_smooth:] -= lam * new[:, :, n_smooth:]
                if n := kernel.nested:
                    own = slice(n_states - 2 * n, n_states - n)
                    f[:, :, own] = new[:, :, n_states - n :]
                    new[:, :, own] = start[:, None, own] + half * (m.integral @ f[:, :, own])
                change = np.abs((new - x[:, :, :n_states]) * scale).max()
                x[:, :, :n_states] = new
                # sweeps converge ever faster: the next changes less than this one by what this did.
                # A first one tells nothing of that where it is large, as a continued series was far
                # off, and of what is stiff, as all that was wrong is gone at one stroke.
                tells = k > 1 or (last < 0.01 and not problem.stiff)
                quick = tells and change < 0.3 * last
                if (change * (change / last) if quick else change) <= 0.01 * tolerance:
                    break
                if change <= 4e-16 or (k > 6 and change <= 1e-13 and change > 0.25 * last):
                    break
                if not change < 1e10 or (k > 3 and change > 4.0 * last):
                    k = SWEEPS
                    break
                top = np.abs(half * (m.series[-1] @ f) * problem.scale).max() if k == 3 else 0.0
                if TAIL * top > 100.0 * tolerance:  # much too long, as its tail tells by now
                    break
                last = change
            else:
                k = SWEEPS
        if k == SWEEPS:
            known = None if known and known[2] < 0 else known
            h = 0.35 * (after - tau)
            continue
        coefficients = half * (m.series @ f)
        coefficients[:, 0] += start
        tail = np.maximum(np.abs(coefficients[:, -1]), 0.1 * np.abs(coefficients[:, -2]))
        end = start + half * (m.end[0] @ f)
        if problem.stiff:
            end[:, n_smooth:] = m.end[1] @ x[:, :, n_smooth:n_states]
        reached = end.copy()
        for restore, row, at in kernel.restores:
            own = slice(row, row + restore.n_result)
            parameters = problem.constants[:, at : at + restore.n_constant]
            end[:, own] = restore.at(end[:, own], parameters)
        # what must be put back tells of the panel's error too
        moved = (np.abs(end - reached) * problem.scale).max()
        error = max(TAIL * (tail * problem.scale).max(), 0.1 * moved if moved > 1e-13 else 0.0)
        # an error below 1e-30 says no more than one of 1e-30, and a quotient must not overflow
        ratio = 0.9 * (tolerance / max(error, 1e-30)) ** (1.0 / NODES)
        if not error <= tolerance:
            known = coefficients.transpose(0, 2, 1), after - tau, -1.0
            h = (after - tau) * min(max(ratio, 0.35), 0.8)
            continue
        series.append(coefficients.transpose(0, 2, 1))
        known = series[-1], after - tau, 1.0
        far = (np.abs(end - start) * problem.scale).max()
        start = end
        grow = min(ratio, 2.0, kernel.reach / max(far, 1e-30))
        h = _shared((after - tau) * grow, problem.length - after)
        tau = after
        edges.append(tau)
        if slip > 0 and finish > 0:
            if slip * drive.decay(tau, drive.speed(tau)) <= finish:
                slip, released = 0.0, tau  # from here on decay is not evaluated, nor resolved
                h = first
                if problem.stops:
                    break
    return Panels(np.array(edges), np.array(series), start, released)


def _shared(h: float, left: float) -> float:
    """A panel's length, or half of what is left: a short last panel costs as much as a long one."""
    if not h < left < 2.0 * h:
        return h
    return left if left < 1.03 * h else 0.5 * left  # 1.03: the tail predicted stays in tolerance


def longest_panel(drive: GainPiece, slip: float, tau: float, h: float, steepest: float) -> float:
    """Shorten a panel: ln(decay) may fall by so much, also if it goes on as at the start, so that
    the first node still sees a layer there. A gain that grows later is seen by the other nodes."""
    if slip <= 0:
        return h
    first, lost = drive.gain(tau), drive.lost(tau)
    for _ in range(60):
        gain = max(first, (drive.lost(tau + h) - lost) / h)
        if gain * h <= steepest or lost > 40.0:
            break
        h = max(0.5 * h, 0.99 * steepest / gain)
    return h


# --- the compiled twin -------------------------------------------------------------------------


class Method(ctypes.Structure):
    """``method_t`` of c/common.h."""

    _fields_ = [(name, ctypes.c_double) for name in (
        "length", "tolerance", "first", "slip", "finish", "released", "reached")]  # fmt: skip
    _fields_ += [(name, ctypes.c_void_p) for name in (
        "node", "integral", "series", "end", "twice")]  # fmt: skip
    _fields_ += [(name, ctypes.c_long) for name in ("n_stiff", "max_panels", "stops")]


def panel_source(kernel: Kernel) -> str:
    """C99 source of ``panels`` for one kernel."""
    n = kernel.n_result
    rows_in = ", ".join(f"{i * NODES}" for i in range(n + 2))
    rows_out = ", ".join(f"{i * NODES}" for i in range(n))
    # Inlined, a loop of 16 is unrolled and then poorly packed: five times slower.
    head = PRELUDE + "static __attribute__((noinline)) " + kernel.loop_source
    head += f"#define RHS {kernel.name}\n#define NX {n}L\n#define NC {kernel.n_constant}L\n"
    head += f"#define SWEEPS {SWEEPS}\n#define STEEPEST {STEEPEST}\n#define FALL {FALL}\n"
    head += f"#define TAIL {TAIL}\n#define NESTED {kernel.nested}\n"
    head += f"#define REACH {kernel.reach}\n" if kernel.reach < np.inf else ""
    head += f"#define MANY {MANY}\n#define MOST_PANELS {MOST:g}\n"
    head += f"#define IN_ROWS {rows_in}\n#define OUT_ROWS {rows_out}\n"
    head += _restore_source(kernel)
    return head + c_source("panels.c")


def _restore_source(kernel: Kernel) -> str:
    """C99: what puts states back on their surfaces, and where it does so; see panels.c."""
    loops, parts = "", ""
    for i, (restore, row, constant) in enumerate(kernel.restores):
        loops += "static " + restore.loop(f"restore_{i}")
        parts += f"{{restore_{i}, {restore.n_result}, {row}, {constant}, {restore.n_constant}}}, "
    return f"{loops}#define RESTORES {parts}{{0}}\n"


@per_structure
def panel_library(kernel: Kernel) -> ctypes.CDLL:
    """The compiled ``panels`` of one kernel (c/panels.c)."""
    library = compiled_library(panel_source(kernel))
    library.panels.restype = ctypes.c_long
    library.panels.argtypes = [ctypes.c_long] + [ctypes.c_void_p] * 9
    return library


@functools.cache
def _built(kernel: Kernel) -> bool:
    """Whether the compiled panels of a kernel lie in the cache (looked up once)."""
    return is_built(panel_source(kernel))


def usable(kernel: Kernel, compiled: bool | None) -> bool:
    """Whether to integrate compiled, as :meth:`Kernel.usable`."""
    return _built(kernel) if compiled is None else compiled


class MotionData(ctypes.Structure):
    """``motion_t`` of c/program.c."""

    _fields_ = [("track", TrackData), ("integrate", ctypes.c_void_p), ("drive", Drive),
                ("method", Method)]  # fmt: skip
    _fields_ += [(name, ctypes.c_long) for name in ("nx", "nc", "room", "done")]
    _fields_ += [("known", ctypes.c_void_p)]
    _fields_ += [(name, ctypes.c_double) for name in ("tolerance", "slip", "share")]
    _fields_ += [(name, ctypes.c_void_p) for name in ("start", "constants", "scale", "block")]


@functools.cache
def program_library() -> ctypes.CDLL:
    """c/program.c: ``move``, ``room_of``, ``fill``, ``states``; ``begin`` and ``fill_begun`` of
    scenes of a kind."""
    library = compiled_library(_program_source())
    pointer, integer = ctypes.c_void_p, ctypes.c_long
    library.move.argtypes = library.room_of.argtypes = [pointer]
    library.fill.argtypes = [pointer, integer, integer, integer, pointer, pointer, pointer]
    library.begin.argtypes = [pointer] * 3
    library.fill_begun.argtypes = library.states.argtypes = [pointer]
    for name in ("move", "room_of", "fill", "begin", "fill_begun", "states"):
        getattr(library, name).restype = integer
    return library


@functools.cache
def program_built() -> bool:
    """Whether it lies in the cache (looked up once)."""
    return is_built(_program_source())


@functools.cache
def _program_source() -> str:
    sizes = f"#define MOST {MOST_AT_ONCE}\n#define MOST_FOUND {MOST_FOUND}\n"
    sizes += f"#define COARSE {COARSE}\n#define STEEPEST {STEEPEST}\n"
    sizes += f"#define NODE {NODE}\n#define BRANCH {BRANCH}\n"
    return PRELUDE + sizes + c_source("program.c")


MOST_AT_ONCE = 8  # contacts of a kind that C takes at once: their numbers stay in the cache
MOST_FOUND = 512  # numbers that a kind works out for a contact
ROOM = 24  # panels there is room for, until one needs more
MOST_ROOM = 400  # that is remembered
_ROOM: dict[Kernel, ctypes.c_long] = {}


def _room(kernel: Kernel) -> ctypes.c_long:
    """Room that motions of this kernel have needed; C reads it too."""
    return _ROOM.setdefault(kernel, ctypes.c_long(ROOM))


class Motion:
    """A problem laid out for C: integrated by :meth:`run`, or by ``fill`` and ``states`` of
    c/program.c on their way.

    Attributes
    ----------
    data : MotionData
    at : int
        Its address.
    lock : threading.Lock
        Hold it during the call that integrates: there is one work space.
    """

    def __init__(
        self, kernel: Kernel, problem: Problem, tolerance: float, track: TrackData | None = None
    ):
        start, constants, scale = map(contiguous, (problem.start, problem.constants, problem.scale))
        self.data = data = MotionData()
        if track is not None:
            data.track = track
        data.track.nb, data.nx = start.shape
        data.nc = constants.shape[1]
        data.integrate = function_address(panel_library(kernel).panels)
        data.drive = drive_data(problem.drive)
        data.start, data.constants, data.scale = address(start), address(constants), address(scale)
        data.method = Method(problem.length, 0.0, problem.first, 0.0, 0.0, -1.0, 0.0,
                             *method_pointers(), problem.stiff, 0, problem.stops)  # fmt: skip
        data.share, data.slip = problem.finish, problem.slip
        data.known = ctypes.addressof(_room(kernel))
        self._kept = kernel, start, constants, scale, problem  # addresses point into them
        self._begin(tolerance)

    def again(self, tolerance: float, problem: Problem | None = None) -> Motion:
        """The same motion for another tolerance; of a problem that was :meth:`Problem.moved`."""
        other = object.__new__(Motion)
        other.data = data = MotionData.from_buffer_copy(self.data)
        other._kept = self._kept
        if problem is not None:
            kernel, _, _, scale, _ = self._kept
            start, constants = problem.start, problem.constants
            data.start, data.constants, data.slip = address(start), address(constants), problem.slip
            if problem.scale is not scale:
                scale = problem.scale
                data.scale = address(scale)
            other._kept = kernel, start, constants, scale, problem
        other._begin(tolerance)
        return other

    @property
    def problem(self) -> Problem:
        return self._kept[4]

    def _begin(self, tolerance: float) -> None:
        data, self.lock, self.at = self.data, threading.Lock(), ctypes.addressof(self.data)
        data.tolerance, data.done = tolerance, 0
        self._block: np.ndarray | None = None

    def ready(self) -> None:
        """Have room to integrate into."""
        if self._block is None:
            self._make_room(_room(self._kept[0]).value)

    def _make_room(self, panels: int) -> None:
        self.data.room = panels
        self._block = block = np.empty(program_library().room_of(self.at))
        self.data.block = address(block)

    def run(self) -> None:
        """Integrate, unless that was done before."""
        with self.lock:
            while not self.data.done:
                self.ready()
                code = program_library().move(self.at)
                if code:
                    self.failed(code)

    def failed(self, code: int) -> None:
        """After a code of ``panels``: make more room, or say what is wrong."""
        method, kernel = self.data.method, self._kept[0]
        if code == -2:
            raise _stuck(self.problem, method.reached)
        panels = 4 * self.data.room
        if code == -3 or 4.0 * self._block.nbytes > MOST_BYTES:  # type: ignore[union-attr]
            raise _endless(self.problem, method.reached, self.data.room)
        self._make_room(panels)
        known = _room(kernel)
        known.value = min(max(panels, known.value), MOST_ROOM)

    def panels(self) -> Panels:
        """The motion as panels."""
        self.run()
        data, block = self.data, self._block
        assert block is not None
        count, shape = data.track.n_panels, (data.track.nb, data.nx)
        size = shape[0] * shape[1]
        at, first = ((a - data.block) // 8 for a in (data.track.edges, data.track.coefficients))
        series = block[first : first + count * size * (NODES + 1)]
        released = data.method.released
        return Panels(
            block[at : at + count + 1],
            series.reshape(count, *shape, NODES + 1), block[:size].reshape(shape),
            released if released >= 0 else None, (data.track.edges, data.track.coefficients),
        )  # fmt: skip


def method_pointers() -> tuple[int, ...]:
    """Addresses of the matrices of :class:`Method`."""
    return _matrices()[0]


@functools.cache
def _matrices() -> tuple[tuple[int, ...], list[np.ndarray]]:
    m = collocation()
    series = np.vstack([m.series[:-1].T, m.series[-1:]])
    twice = (m.integral @ m.integral).T
    kept = [np.ascontiguousarray(a) for a in (m.node, m.integral.T, series, m.end, twice)]
    return tuple(a.ctypes.data for a in kept), kept
