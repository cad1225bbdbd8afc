r"""Rolling as the development of a plane curve: moving frames on any surface (theory section 4, 5).

The contact point of body i moves with velocity ``c_1 p + c_2 q``, where ``[p q]`` is a frame
carried by parallel transport and ``c`` is known in advance:

.. math:: c_1 = \sigma W_1, \qquad c_2 = \sigma (W - V e^{-L}), \qquad W = R_0 W_1 .

No sigma'/sigma, no stiffness, and no coupling between the bodies. Two forms of state:

* ambient, (x, p, q) in R^9, for surfaces with an implicit form: no chart, no poles;
* chart, (u, v, theta), for surfaces given by a chart: [p q] is the contact frame turned by theta.

Accelerations that act on a finger or the object make W_1 and V states as well ("forced").
The motion is integrated by Gauss collocation in panels whose length follows the decay of the
solution's Legendre series; that series is also the dense output.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial import legendre

from . import geometry
from .errors import ContactSystemError
from .kernels import (
    NODES,
    PRELUDE,
    Kernel,
    Restoration,
    address,
    c_source,
    compiled_library,
    contiguous,
    find_compiler,
    library_path,
    per_structure,
)
from .profile import GainPiece
from .surfaces import Surface
from .tracks import (
    Track,
    TrackData,
    chart_to_parallel,
    drive_data,
    evaluator,
    restoring_kernel,
    rotation,
    wind,
)

SX = ca.SX

# --- the equations, symbolic -------------------------------------------------------------------


def state_size(ambient: bool) -> int:
    """9 for the ambient state (x, p, q), 3 for the chart state (u, v, theta)."""
    return 9 if ambient else 3


def body_motion(
    surface: Surface, ambient: bool, p: SX, state: SX, c: SX, offset: SX | None = None
) -> SX:
    """Rate of a body's moving frame when its contact point is driven by c (theory 4, 5).

    Parameters
    ----------
    surface : Surface
    ambient : bool
        The form of the state.
    p : SX
        Parameters of the surface.
    state : SX (9) or (3)
    c : SX (2)
        Velocity of the contact point in the parallel frame, m/s.
    offset : SX (2), optional
        Chart rates added to the motion of the point (theory section 7).
    """
    if offset is not None:
        c = c + chart_to_parallel(surface, ambient, p, state, offset)
    if ambient:
        x, frame = state[0:3], ca.reshape(state[3:9], 3, 2)
        velocity = frame @ c
        gradient, hessian = geometry.implicit_geometry(surface.implicit_expr(p, x), x)
        turn = frame.T @ (hessian @ velocity) / ca.dot(gradient, gradient)
        return ca.vertcat(velocity, -turn[0] * gradient, -turn[1] * gradient)
    shape = surface.geometry_expr(p, state[0], state[1])
    velocity = rotation(state[2]) @ c
    rates = geometry.upper_inverse(shape.metric_root) @ velocity
    return ca.vertcat(rates, -shape.torsion_form @ velocity)


def reflection(cos_psi: SX, sin_psi: SX) -> SX:
    """R_psi of theory section 2 from the cosine and sine of psi, 2x2."""
    return ca.vertcat(ca.horzcat(cos_psi, -sin_psi), ca.horzcat(-sin_psi, -cos_psi))


@per_structure
def driven_motion(surface: Surface, ambient: bool, offset: bool = False) -> Kernel:
    """Kernel of one body driven by c = sigma (W - V decay).

    point: state, sigma, decay. constant: surface parameters, W (2), V (2), offset (2).
    """
    state, drive = SX.sym("state", state_size(ambient)), SX.sym("drive", 2)
    p, w, v = SX.sym("p", len(surface.parameters)), SX.sym("W", 2), SX.sym("V", 2)
    d = SX.sym("d", 2)
    c = drive[0] * (w - v * drive[1])
    rate = body_motion(surface, ambient, p, state, c, d if offset else None)
    kernel = Kernel("driven", ca.vertcat(state, drive), ca.vertcat(p, w, v, d), rate)
    if ambient:
        kernel.restores = (Restoration(restoring_kernel(surface), 0, 0),)
    return kernel


@per_structure
def forced_motion(
    finger: Surface, obj: Surface, ambient: tuple[bool, bool], finger_forced: bool
) -> Kernel:
    """Kernel of a contact under accelerations (theory section 7).

    point: [finger state, W1 if the finger is forced], object state, V; sigma, decay (unused).
    constant: finger and object parameters, cos and sin of psi(0), W1(0), accelerations of finger
    and object (chart components, 2 + 2), object rate offset (2).
    The term -lam V of V' is left to the integrator, which treats it implicitly.
    """
    n1 = state_size(ambient[0]) if finger_forced else 0
    n2 = state_size(ambient[1])
    state = SX.sym("state", n1 + (2 if finger_forced else 0) + n2 + 2)
    drive = SX.sym("drive", 2)
    p1, p2 = SX.sym("p1", len(finger.parameters)), SX.sym("p2", len(obj.parameters))
    turn, w_start = SX.sym("turn", 2), SX.sym("W1", 2)
    d1, d2, offset = SX.sym("d1", 2), SX.sym("d2", 2), SX.sym("offset", 2)
    sigma, r0 = drive[0], reflection(turn[0], turn[1])
    own, v = state[state.numel() - 2 - n2 : state.numel() - 2], state[state.numel() - 2 :]
    rates, w1 = [], w_start
    v_rate = -chart_to_parallel(obj, ambient[1], p2, own, d2) / sigma
    if finger_forced:
        tip, w1 = state[:n1], state[n1 : n1 + 2]
        w1_rate = chart_to_parallel(finger, ambient[0], p1, tip, d1) / sigma
        rates += [body_motion(finger, ambient[0], p1, tip, sigma * w1), w1_rate]
        v_rate += r0 @ w1_rate
    rates += [body_motion(obj, ambient[1], p2, own, sigma * (r0 @ w1 - v), offset), v_rate]
    constant = ca.vertcat(p1, p2, turn, w_start, d1, d2, offset)
    kernel = Kernel("forced", ca.vertcat(state, drive), constant, ca.vertcat(*rates))
    if finger_forced and ambient[0]:
        kernel.restores += (Restoration(restoring_kernel(finger), 0, 0),)
    if ambient[1]:
        first = state.numel() - 2 - n2
        kernel.restores += (Restoration(restoring_kernel(obj), first, p1.numel()),)
    return kernel


@per_structure
def rolling_motion(finger: Surface, obj: Surface) -> Kernel:
    """Kernel of imposed rolling (eq. `corollary`): the object's geodesic drags the finger along.

    point: u1, v1, psi, object chart state; sigma, decay (unused). constant: finger and object
    parameters, W (2). M1 q1' = R_psi M2 q2', psi' = T1 M1 q1' + T2 M2 q2' in chart coordinates:
    that the finger's curve is a geodesic too is a result here, not an assumption.
    """
    state, drive = SX.sym("state", 6), SX.sym("drive", 2)
    p1, p2 = SX.sym("p1", len(finger.parameters)), SX.sym("p2", len(obj.parameters))
    w = SX.sym("W", 2)
    own = state[3:6]
    tip = finger.geometry_expr(p1, state[0], state[1])
    body = obj.geometry_expr(p2, own[0], own[1])
    c = drive[0] * w
    a2 = rotation(own[2]) @ c
    a1 = reflection(ca.cos(state[2]), ca.sin(state[2])) @ a2
    rates = geometry.upper_inverse(tip.metric_root) @ a1
    spin = tip.torsion_form @ a1 + body.torsion_form @ a2
    rate = ca.vertcat(rates, spin, body_motion(obj, False, p2, own, c))
    return Kernel("rolling", ca.vertcat(state, drive), ca.vertcat(p1, p2, w), rate)


@functools.cache
def slip_displacement() -> Kernel:
    """Kernel of g' = sigma decay (theory section 4): all that slip costs on a developable body."""
    g, drive = SX.sym("g"), SX.sym("drive", 2)
    return Kernel("displacement", ca.vertcat(g, drive), SX.sym("none", 1), drive[0] * drive[1])


# --- Gauss collocation in panels ---------------------------------------------------------------

# NODES = 16: on a unit sphere a panel spans about 2 rad at 1e-14 and Picard sweeps still converge.
SWEEPS = 40


@dataclass(frozen=True)
class Collocation:
    """Matrices of collocation at the Gauss points of [-1, 1].

    project : (N, N), node values -> Legendre coefficients of the interpolant
    integral : (N, N), antiderivative of the interpolant at the nodes
    series : (N + 1, N), node values of f -> Legendre coefficients of its antiderivative from -1
    end : (2, N), weights of the integral over [-1, 1]; extrapolation of node values to +1
    """

    node: np.ndarray
    project: np.ndarray
    integral: np.ndarray
    series: np.ndarray
    end: np.ndarray


@functools.cache
def collocation(n: int = NODES) -> Collocation:
    """The matrices, from the Legendre polynomials at Gauss points.

    Their inverse rather than discrete orthogonality: numpy's weights are off by 7e-15.
    """
    node, _ = legendre.leggauss(n)
    basis = legendre.legvander(node, n)  # P_0 .. P_n at the nodes
    project = np.linalg.inv(basis[:, :n])
    primitive = np.zeros((n + 1, n))  # int_-1 P_k = (P_{k+1} - P_{k-1}) / (2k + 1)
    primitive[0, 0] = primitive[1, 0] = 1.0
    for k in range(1, n):
        primitive[k + 1, k] += 1.0 / (2 * k + 1)
        primitive[k - 1, k] -= 1.0 / (2 * k + 1)
    series = primitive @ project
    end = np.vstack([2.0 * project[0], project.sum(axis=0)])
    return Collocation(
        node, project, np.ascontiguousarray(basis @ series), np.ascontiguousarray(series), end
    )


@dataclass(eq=False)  # not frozen: that makes it four times slower to make
class Panels:
    """A motion as Legendre series on panels.

    edges : (K + 1,), local time (or arc length) of the panel ends
    coefficients : (K, n_bodies, n_states, N + 1)
    end : (n_bodies, n_states), the state at the last edge
    released : local time at which slip was let go, or None
    """

    edges: np.ndarray
    coefficients: np.ndarray
    end: np.ndarray
    released: float | None = None

    @property
    def count(self) -> int:
        return len(self.edges) - 1

    def evaluate(self, tau: np.ndarray, states: slice = slice(None)) -> np.ndarray:
        """The states at local times in any order: (n_bodies, n_states, n_times)."""
        coefficients = self.coefficients[:, :, states]
        out = np.empty(coefficients.shape[1:3] + (len(tau),))
        which = np.searchsorted(self.edges[1:-1], tau, side="right")
        xi = 2.0 * (tau - self.edges[which]) / np.diff(self.edges)[which] - 1.0
        basis = _legendre_basis(xi)
        for k, part in runs(which):
            if isinstance(part, slice):
                np.matmul(coefficients[k], basis[:, part], out=out[:, :, part])
            else:
                out[:, :, part] = coefficients[k] @ basis[:, part]
        return out


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


def _legendre_basis(xi: np.ndarray) -> np.ndarray:
    """P_0 .. P_N at xi: (N + 1, n)."""
    basis = np.empty((NODES + 1, len(xi)))
    basis[0], basis[1] = 1.0, xi
    for k in range(1, NODES):
        np.multiply(xi, basis[k], out=basis[k + 1])
        basis[k + 1] *= (2 * k + 1) / (k + 1)
        basis[k + 1] -= (k / (k + 1)) * basis[k - 1]
    return basis


@dataclass(eq=False)
class Problem:
    """What :func:`integrate` needs to know beside the kernel.

    Attributes
    ----------
    start : (n_bodies, n_states)
    constants : (n_bodies, n_constant)
    scale : (n_bodies, n_states)
        1 / (size of each state): errors are measured in these units.
    drive : GainPiece
        sigma and decay as functions of local time.
    length : float
        End of the integration in local time.
    tolerance : float
        Bound of the truncated series tail of a panel, in units of ``1 / scale``.
    first : float
        First panel to try.
    slip : float
        Greatest |V| of the bodies; 0 where there is none (decay is then not evaluated).
    finish : float
        Let slip go once slip * decay is below this; 0: never.
    stops : bool
        End the integration there, else go on without slip.
    stiff : int
        How many trailing states carry the term -lam.
    """

    start: np.ndarray
    constants: np.ndarray
    scale: np.ndarray
    drive: GainPiece
    length: float
    tolerance: float
    first: float
    slip: float = 0.0
    finish: float = 0.0
    stops: bool = False
    stiff: int = 0


def integrate(kernel: Kernel, problem: Problem, compiled: bool | None = False) -> Panels:
    """Integrate all bodies of a problem in lockstep.

    ``compiled``: True compiles if need be, False never, None uses what was built before.

    Raises
    ------
    ContactSystemError
        The panels shrink without end (the motion leaves its chart, or the surface is not smooth).
    """
    compiled = panels_built(kernel) if compiled is None else compiled
    run = _integrate_compiled if compiled else _integrate_here
    # Below 4e-16 a series' tail is rounding noise.
    return run(kernel, problem, max(0.1 * problem.tolerance, 4e-16))


def _stuck(problem: Problem, tau: float, h: float) -> ContactSystemError:
    return ContactSystemError(
        f"the motion cannot be continued past local time {problem.drive.start + tau:.9g} "
        f"(panels of {h:.2g}): the path reaches a singular point of its chart or its surface, or "
        "moves too fast for double precision; start elsewhere, change the direction or end the "
        "scene before"
    )


def _integrate_here(kernel: Kernel, problem: Problem, tolerance: float) -> Panels:
    """The panels with the virtual machine and numpy; panels.c has the same steps."""
    m, drive = collocation(), problem.drive
    start = np.array(problem.start)
    n_bodies, n_states = start.shape
    machine = kernel.nodes(problem.constants, NODES)
    x, f = machine.x, machine.y
    scale, n_smooth = problem.scale[:, None, :], n_states - problem.stiff
    slip, released = problem.slip, None
    edges: list[float] = [0.0]
    series: list[np.ndarray] = []
    tau, h, tries = 0.0, min(problem.first, problem.length), 0
    while tau < problem.length:
        tries += 1
        if tries > 40 * (len(series) + 25):
            raise _stuck(problem, tau, h)
        h = longest_panel(drive, slip, tau, min(h, problem.length - tau))
        after = tau + h
        if after >= problem.length * (1 - 1e-14):
            after = problem.length
        half = 0.5 * (after - tau)
        t = tau + half * (1.0 + m.node)
        sigma = drive.speed(t)
        x[:, :, n_states] = sigma
        x[:, :, n_states + 1] = drive.decay(t, sigma) if slip > 0 else 0.0
        if series and after - tau <= 2.0 * (tau - edges[-2]):
            # Picard sweeps start from the last panel's series (28 % fewer of them)
            basis = _legendre_basis(1.0 + (after - tau) / (tau - edges[-2]) * (1.0 + m.node))
            x[:, :, :n_states] = (series[-1] @ basis).transpose(0, 2, 1)
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
                change = np.abs((new - x[:, :, :n_states]) * scale).max()
                x[:, :, :n_states] = new
                if change <= max(tolerance * 0.1, 4e-16):
                    break
                if k > 6 and change <= 1e-13 and change > 0.25 * last:
                    break
                if not change < 1e10:
                    k = SWEEPS
                    break
                last = change
            else:
                k = SWEEPS
        if k == SWEEPS:
            h = 0.35 * (after - tau)
            continue
        coefficients = half * (m.series @ f)
        coefficients[:, 0] += start
        tail = np.maximum(np.abs(coefficients[:, -1]), 0.1 * np.abs(coefficients[:, -2]))
        error = (tail * problem.scale).max()
        # an error below 1e-30 says no more than one of 1e-30, and a quotient must not overflow
        ratio = 0.9 * (tolerance / max(error, 1e-30)) ** (1.0 / NODES)
        if not error <= tolerance:
            h = (after - tau) * min(max(ratio, 0.2), 0.8)
            continue
        series.append(coefficients.transpose(0, 2, 1))
        start = start + half * (m.end[0] @ f)
        if problem.stiff:
            start[:, n_smooth:] = m.end[1] @ x[:, :, n_smooth:n_states]
        for restore, row, first in kernel.restores:
            own = slice(row, row + restore.n_result)
            parameters = problem.constants[:, first : first + restore.n_constant]
            start[:, own] = restore.at(start[:, own], parameters)
        h = (after - tau) * min(ratio, 2.0)
        tau = after
        edges.append(tau)
        if slip > 0 and problem.finish > 0:
            if slip * drive.decay(tau, drive.speed(tau)) <= problem.finish:
                slip, released = 0.0, tau  # from here on decay is not evaluated, nor resolved
                h = problem.first
                if problem.stops:
                    break
    return Panels(np.array(edges), np.array(series), start, released)


def longest_panel(drive: GainPiece, slip: float, tau: float, h: float) -> float:
    """Shorten a panel so that decay falls by exp(-30) at most: its first node still sees it."""
    if slip <= 0:
        return h
    for _ in range(60):
        gain = max(drive.gain(tau), drive.gain(tau + h))
        if gain * h <= 30.0 or drive.lost(tau) > 40.0:
            break
        h = 0.5 * h if 30.0 / gain < 0.5 * h else 30.0 / gain * 0.99
    return h


# --- the compiled twin -------------------------------------------------------------------------


class Method(ctypes.Structure):
    """``method_t`` of c/common.h."""

    _fields_ = [(name, ctypes.c_double) for name in
                ("length", "tolerance", "first", "slip", "finish", "released")]  # fmt: skip
    _fields_ += [(name, ctypes.c_void_p) for name in ("node", "integral", "series", "end")]
    _fields_ += [(name, ctypes.c_long) for name in ("n_stiff", "max_panels", "stops")]


def panel_source(kernel: Kernel) -> str:
    """C99 source of ``panels`` for one kernel."""
    n = kernel.n_result
    rows_in = ", ".join(f"{i * NODES}" for i in range(n + 2))
    rows_out = ", ".join(f"{i * NODES}" for i in range(n))
    # Inlined, a loop of 16 is unrolled and then poorly packed: five times slower.
    head = PRELUDE + "static __attribute__((noinline)) " + kernel.loop_source
    head += f"#define RHS {kernel.name}\n#define NX {n}L\n#define NC {kernel.n_constant}L\n"
    head += f"#define SWEEPS {SWEEPS}\n"
    head += f"#define IN_ROWS {rows_in}\n#define OUT_ROWS {rows_out}\n"
    head += _restore_source(kernel)
    return head + c_source("panels.c")


def _restore_source(kernel: Kernel) -> str:
    """C99: ``restore(state, constants)`` puts one body's state back on its surfaces, in place."""
    loops, calls = "", ""
    for i, (restore, row, constant) in enumerate(kernel.restores):
        n = restore.n_result
        rows = ", ".join(map(str, range(n)))
        loops += "static " + restore.loop(f"restore_{i}")
        calls += (
            f"  {{ static const long rows[] = {{{rows}}}; double to[{n}];\n"
            f"    restore_{i}(1, 1, state + {row}, rows, 0, c + {constant}, to, rows, 0);\n"
            f"    memcpy(state + {row}, to, sizeof to); }}\n"
        )
    head = "#include <string.h>\n" + loops
    return head + f"static void restore(double *state, const double *c) {{\n{calls}}}\n"


@per_structure
def panel_library(kernel: Kernel) -> ctypes.CDLL:
    """The compiled ``panels`` of one kernel (c/panels.c)."""
    library = compiled_library(panel_source(kernel))
    library.panels.restype = ctypes.c_long
    library.panels.argtypes = [ctypes.c_long] + [ctypes.c_void_p] * 9
    return library


def panels_built(kernel: Kernel) -> bool:
    """Whether the compiled panels of a kernel lie in the cache (looked up once)."""
    if kernel not in _BUILT:
        there = find_compiler() is not None and library_path(panel_source(kernel)).exists()
        _BUILT[kernel] = there
    return _BUILT[kernel]


_BUILT: dict[Kernel, bool] = {}


def _integrate_compiled(kernel: Kernel, problem: Problem, tolerance: float) -> Panels:
    run = panel_library(kernel).panels
    n_bodies, n_states = problem.start.shape
    drive = drive_data(problem.drive)
    scale, constants = contiguous(problem.scale), contiguous(problem.constants)
    size, room = n_bodies * n_states, 24
    while True:
        # one block: state, spare, work, edges, coefficients
        cuts = (size, 2 * size, 2 * size + (2 * n_states + 2) * NODES)
        first = cuts[2] + room + 1
        block = np.empty(first + room * size * (NODES + 1))
        block[:size] = problem.start.ravel()
        at = address(block)
        method = Method(problem.length, tolerance, problem.first, problem.slip, problem.finish,
                         -1.0, *method_pointers(), problem.stiff, room, problem.stops)  # fmt: skip
        count = run(n_bodies, at, address(constants), address(scale), ctypes.addressof(drive),
                    ctypes.addressof(method), at + 8 * cuts[2], at + 8 * first, at + 8 * cuts[1],
                    at + 8 * cuts[0])  # fmt: skip
        if count >= 0:
            edges = block[cuts[2] : cuts[2] + count + 1]
            series = block[first : first + count * size * (NODES + 1)]
            shape = (count, n_bodies, n_states, NODES + 1)
            end = block[:size].reshape(n_bodies, n_states)
            released = method.released if method.released >= 0 else None
            return Panels(edges, series.reshape(shape), end, released)
        if count == -2:
            reached = block[cuts[2] : first]
            raise _stuck(problem, float(reached.max(initial=0.0)), 0.0)
        room *= 4


def method_pointers() -> tuple[int, ...]:
    """Addresses of the matrices of :class:`Method`."""
    return _matrices()[0]


@functools.cache
def _matrices() -> tuple[tuple[int, ...], list[np.ndarray]]:
    m = collocation()
    series = np.vstack([m.series[:-1].T, m.series[-1:]])
    kept = [np.ascontiguousarray(a) for a in (m.node, m.integral.T, series, m.end)]
    return tuple(a.ctypes.data for a in kept), kept


# --- tracks ------------------------------------------------------------------------------------


@dataclass(eq=False)
class PanelTrack(Track):
    """Bodies whose states are panels in local time, or in arc length for geodesics.

    Attributes
    ----------
    panels : Panels
    rows : slice
        The rows of the panels that hold these bodies' states.
    piece : GainPiece
        sigma and decay in local time.
    w, v : (n_bodies, 2)
        Drive sigma (w - v decay), unless ``drive_of`` says otherwise.
    by_length : bool
        The panels' variable is the arc length since start.
    drive_of : callable or None
        Local times -> drive (n_bodies, 2, n), where accelerations change it.
    """

    panels: Panels
    rows: slice
    piece: GainPiece
    w: np.ndarray
    v: np.ndarray | None
    by_length: bool = False
    drive_of: Callable[[np.ndarray], np.ndarray] | None = None

    def __post_init__(self) -> None:
        self._anchors: tuple[np.ndarray, np.ndarray] | None = None

    def state(self, t: np.ndarray) -> np.ndarray:
        tau = t - self.start
        if self.by_length:
            tau = self.piece.arc_length(tau)
        # rounding may put a time 1e-16 outside
        return self.panels.evaluate(np.clip(tau, 0.0, self.panels.edges[-1]), self.rows)

    def drive(self, t: np.ndarray) -> np.ndarray:
        tau = t - self.start
        if self.drive_of is not None:
            return self.drive_of(tau)
        sigma = self.piece.speed(tau)
        drive = self.w[:, :, None] * sigma
        if self.v is not None:
            drive -= self.v[:, :, None] * (sigma * self.piece.decay(tau, sigma))
        return drive

    def end(self) -> np.ndarray:
        return self.panels.end[:, self.rows]

    # --- compiled evaluation

    @functools.cached_property
    def _data(self) -> tuple[int, tuple]:
        """Address of the C form of this track, and what it points to."""
        series, piece, edges = self.panels.coefficients, self.piece, self.panels.edges
        period_u, period_v = self.surface.periods()
        first = (self.rows.start or 0) * series.strides[2]
        kept = [
            contiguous(a) for a in (self.parameters, self.w, self.w if self.v is None else self.v)
        ]
        data = TrackData(
            self.start, self.stop, drive_data(piece), self.n_bodies, self.v is not None,
            self.by_length, len(edges) - 1, series.strides[0] // 8, series.strides[1] // 8, 0,
            self.surface.double_cover, period_u or 0.0, period_v or 0.0, address(kept[0]),
            address(piece.arrays[1]), address(kept[1]), address(kept[2]), address(edges),
            address(series) + first, None, None,
        )  # fmt: skip
        return ctypes.addressof(data), (data, kept, series, edges)

    def _entry(self, output: str) -> tuple[Callable[..., int], int] | None:
        if self.drive_of is not None or (output == "coordinates" and self.offset is not None):
            return None
        compiled = evaluator(self.surface, self.ambient, output)
        return (
            (compiled.library.evaluate, self._data[0]) if compiled.usable(self.compiled) else None
        )

    def _coordinates(self, t: np.ndarray) -> np.ndarray:
        values = super()._coordinates(t)
        if self.ambient and self._anchors is not None:
            self._continue(t, values)
        return values

    # --- coordinates continued along the path

    @property
    def anchored(self) -> bool:
        return not self.ambient or self._anchors is not None

    def anchor(self, begin: np.ndarray) -> None:
        if not self.ambient:
            return
        if not self.by_length and self.entry("coordinates") is not None:
            m, n = 4 * self.panels.count + 1, self.n_bodies
            times, anchors, work = np.empty(m), np.empty((n, 3, m)), np.empty((n, 5, m))
            library = evaluator(self.surface, True, "coordinates").library
            library.anchor(
                self._data[0],
                address(contiguous(begin)),
                address(times),
                address(anchors),
                address(work),
            )
        else:
            times = self._anchor_times()
            with np.errstate(all="ignore"):
                raw = super()._coordinates(times)
            u, v, theta = (
                np.vstack([begin[:, k], raw[:, i].T]) for k, i in enumerate((0, 1, 4))
            )  # time first, as unwind wants
            u, v, turned = self.surface.unwind(u, v)
            theta = np.unwrap(theta + np.pi * turned, axis=0)
            anchors = np.ascontiguousarray(np.stack([u, v, theta])[:, 1:].transpose(2, 0, 1))
            if self.entry("coordinates") is not None:
                data = self._data[1][0]
                data.n_anchors = len(times)
                data.anchor_times, data.anchors = address(times), address(anchors)
        self._anchors = (times, anchors)

    def _anchor_times(self) -> np.ndarray:
        """Four times a panel: between them coordinates move by less than half a period."""
        edges = self.panels.edges
        grid = (edges[:-1, None] + (edges[1:] - edges[:-1])[:, None] * _QUARTERS).ravel()
        grid = np.append(grid, edges[-1])
        if self.by_length:
            fine = np.linspace(0.0, self.stop - self.start, 16 * len(grid) + 1)
            grid = np.interp(grid, self.piece.arc_length(fine), fine)
        return np.minimum(self.start + grid, self.stop)

    def _continue(self, t: np.ndarray, values: np.ndarray) -> None:
        """Bring (u, v, theta) to the branch of the nearest anchor, in place."""
        times, anchors = self._anchors  # type: ignore[misc]
        reference = anchors[:, :, np.searchsorted(0.5 * (times[1:] + times[:-1]), t)]
        if self.surface.double_cover:
            u, v, turned = self.surface.align(
                values[:, 0], values[:, 1], reference[:, 0], reference[:, 1]
            )
            values[:, 0], values[:, 1] = u, v
            values[:, 2:4] *= np.where(turned, -1.0, 1.0)[:, None]
            values[:, 4] += np.pi * turned
        else:
            for row, period in enumerate(self.surface.periods()):
                if period is not None:
                    wind(values[:, row], reference[:, row], period)
        wind(values[:, 4], reference[:, 2], 2 * np.pi)


_QUARTERS = np.arange(4) / 4.0


class DrivenTrack(PanelTrack):
    """Bodies developed under slip, integrated when something asks for their motion.

    Attributes
    ----------
    kernel : Kernel
    problem : Problem
    shared : dict
        What follows from the scene alone and is kept with it, for compiled calls.
    """

    def __init__(
        self,
        surface: Surface,
        parameters: np.ndarray,
        stop: float,
        why: str,
        ambient: bool,
        compiled: bool | None,
        offset: np.ndarray | None,
        kernel: Kernel,
        problem: Problem,
        w: np.ndarray,
        v: np.ndarray,
        shared: dict[Any, Any],
    ):
        self.surface, self.parameters, self.ambient = surface, parameters, ambient
        self.start, self.stop, self.compiled, self.offset = (
            problem.drive.start,
            stop,
            compiled,
            offset,
        )
        self.rows, self.piece, self.w, self.v = slice(None), problem.drive, w, v
        self.by_length, self.drive_of = False, None
        self.kernel, self.problem, self.shared, self._why = kernel, problem, shared, why
        self._anchors = None

    @functools.cached_property
    def panels(self) -> Panels:  # type: ignore[override]
        """The motion, integrated once."""
        return integrate(self.kernel, self.problem, self.compiled)

    @property
    def method(self) -> str:  # type: ignore[override]
        place = "space" if self.ambient else "its chart"
        return f"development in {place}, {self.panels.count} panels"

    @property
    def reason(self) -> str:  # type: ignore[override]
        if self.panels.released is None:
            return self._why
        return f"{self._why}, below tolerance from t = {self.start + self.panels.released:.6g} s on"
