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
import threading
from collections.abc import Iterator
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
    function_address,
    library_path,
    made_once,
    per_structure,
)
from .profile import GainPiece
from .surfaces import Surface
from .tracks import (
    AXIS,
    LOCK,
    Drive,
    Evaluator,
    Track,
    TrackData,
    chart_to_parallel,
    coordinate_kernel,
    drive_data,
    evaluator,
    frame_coordinates,
    frame_kernel,
    kept,
    once,
    restoring_axis,
    restoring_kernel,
    rotation,
    standing_size,
    whole_frame,
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


@made_once
def contact_start() -> Kernel:
    """point: psi, W_1 in E1 (2), the object's path velocity in E2 (2) -> R_psi by rows (4), W_2, V.

    R_psi W_1 of a rolling start is rounded twice; what is left of V then is no slip.
    """
    point = SX.sym("point", 5)
    psi, w1, given = ca.vertsplit(point, [0, 1, 3, 5])
    r0 = reflection(ca.cos(psi), ca.sin(psi))
    w2 = r0 @ w1
    rounding = 1e-15 * ca.fmax(ca.fmax(ca.fabs(w1[0]), ca.fabs(w1[1])), 1e-300)
    v = w2 - given
    v = ca.if_else(ca.fabs(v) <= rounding, 0, v)
    return Kernel("contact_start", point, SX(0, 1), ca.vertcat(ca.vec(r0.T), w2, v))


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


# --- the same of (x, p) alone, as the planner moves bodies in space: a third of the states less ---


def _whole(surface: Surface, ambient: bool, p: SX, state: SX) -> SX:
    return whole_frame(surface).function(state, p) if ambient else state


@per_structure
def axis_motion(surface: Surface, ambient: bool, offset: bool = False) -> Kernel:
    """:func:`driven_motion` of (x, p) in space."""
    kernel, n = driven_motion(surface, ambient, offset), len(surface.parameters)
    if not ambient:
        return kernel
    state, drive = SX.sym("state", AXIS), SX.sym("drive", 2)
    constant = SX.sym("constant", kernel.n_constant)
    frame = _whole(surface, ambient, constant[:n], state)
    rate = kernel.function(ca.vertcat(frame, drive), constant)[:AXIS]
    made = Kernel("driven", ca.vertcat(state, drive), constant, rate)
    made.restores = (Restoration(restoring_axis(surface), 0, 0),)
    return made


@per_structure
def axis_forced_motion(
    finger: Surface, obj: Surface, ambient: tuple[bool, bool], finger_forced: bool
) -> Kernel:
    """:func:`forced_motion` of (x, p) in space."""
    kernel = forced_motion(finger, obj, ambient, finger_forced)
    constant, drive = SX.sym("constant", kernel.n_constant), SX.sym("drive", 2)
    surfaces, counts = (finger, obj), [len(s.parameters) for s in (finger, obj)]
    numbers = ca.vertsplit(constant, [0, counts[0], sum(counts), kernel.n_constant])
    state, whole, taken = SX(0, 1), SX(0, 1), []  # taken: rows of the whole state that are kept
    restores: list[Restoration] = []
    for k in range(0 if finger_forced else 1, 2):
        own, path = SX.sym("own", standing_size(ambient[k])), SX.sym("path", 2)  # W_1, then V
        if ambient[k]:
            at = Restoration(restoring_axis(surfaces[k]), state.numel(), counts[0] * k)
            restores.append(at)
        taken += [whole.numel() + i for i in range(own.numel())]
        whole = ca.vertcat(whole, _whole(surfaces[k], ambient[k], numbers[k], own), path)
        taken += [whole.numel() - 2, whole.numel() - 1]
        state = ca.vertcat(state, own, path)
    rate = kernel.function(ca.vertcat(whole, drive), constant)[taken]
    made = Kernel("forced", ca.vertcat(state, drive), constant, rate)
    made.restores = tuple(restores)
    return made


@made_once
def slip_displacement() -> Kernel:
    """Kernel of s' = sigma, g' = sigma decay (theory section 4), all that slip costs on a
    developable body."""
    state, drive = SX.sym("state", 2), SX.sym("drive", 2)
    rate = drive[0] * ca.vertcat(1, drive[1])
    return Kernel("displacement", ca.vertcat(state, drive), SX.sym("none", 1), rate)


@functools.lru_cache(maxsize=256)
def slip_length(piece: GainPiece, tells: bool, compiled: bool | None) -> Panels:
    """s(t) and g(t) over a piece, right to rounding for all who plan with this profile and gain.

    Where slip ends too soon to tell, g is 0.
    """
    span = piece.stop - piece.start
    problem = Problem(
        name=f"quadrature of slip over [{piece.start:g}, {piece.stop:g}] s",
        start=np.zeros((1, 2)),
        constants=np.zeros((1, 1)),
        scale=np.full((1, 2), 1.0 / max(piece.arc_length(span), 1e-300)),
        drive=piece,
        length=span,
        first=span,
        slip=float(tells),
    )
    kernel = slip_displacement()
    if not tells:
        return integrate(kernel, problem, 1e-15, compiled)
    rough = integrate(kernel, problem, 1e-3, compiled)  # how large g is
    problem.scale[0, 1] = 1.0 / max(rough.end[0, 1], 1e-300)
    return integrate(kernel, problem, 1e-15, compiled)


# --- Gauss collocation in panels ---------------------------------------------------------------

# NODES = 16: on a unit sphere a panel spans about 2 rad at 1e-14 and Picard sweeps still converge.
SWEEPS = 40
MANY = 4096  # panels from one look at how many more it will take to the next
MOST = 1e6  # panels of one interval; beyond, a scene is refused
MOST_HERE = 1e5  # without compiled kernels, where a panel takes 0.3 ms
MOST_BYTES = 2e9


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
        First panel to try.
    slip : float
        Greatest |V| of the bodies; 0 where there is none (decay is then not evaluated).
    finish : float
        Let slip go once slip * decay is below this many tolerances; 0: never.
    stops : bool
        End the integration there, else go on without slip.
    stiff : int
        How many trailing states carry the term -lam.
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

    def moved(self, start: np.ndarray, constants: np.ndarray, **others: Any) -> Problem:
        """This problem from another start with other constants, both contiguous."""
        other = object.__new__(Problem)
        other.__dict__.update(self.__dict__, start=start, constants=constants, **others)
        return other

    def limits(self, tolerance: float) -> tuple[float, float, float]:
        """Bound of a series' tail, greatest slip that counts, and where it is let go."""
        finish = self.finish * tolerance
        # Below 4e-16 a series' tail is rounding noise.
        return max(0.1 * tolerance, 4e-16), self.slip if self.slip > finish else 0.0, finish


def integrate(
    kernel: Kernel, problem: Problem, tolerance: float, compiled: bool | None = False
) -> Panels:
    """Integrate all bodies of a problem in lockstep.

    Parameters
    ----------
    kernel : Kernel
    problem : Problem
    tolerance : float
        Ten times the bound of the truncated series tail of a panel, in units of ``1 / scale``.
    compiled : bool or None
        True compiles if need be, False never, None uses what was built before.

    Raises
    ------
    ContactSystemError
        The panels shrink without end (the motion leaves its chart, or the surface is not smooth).
    """
    if panels_built(kernel) if compiled is None else compiled:
        return Motion(kernel, problem, tolerance).panels()
    return _integrate_here(kernel, problem, tolerance)


def _stuck(problem: Problem, tau: float) -> ContactSystemError:
    return ContactSystemError(
        f"{problem.name}: the motion cannot be continued past local time "
        f"{problem.drive.start + tau:.9g}: the path reaches a singular point of its chart or its "
        "surface, or moves too fast for double precision; start elsewhere, change the direction or "
        "end the scene before"
    )


def _endless(problem: Problem, tau: float, count: int, most: float = MOST) -> ContactSystemError:
    return ContactSystemError(
        f"{problem.name}: {count} panels reach local time {problem.drive.start + tau:.9g} of "
        f"{problem.drive.start + problem.length:.9g} only, more than {most:g} would be needed; "
        "shorten the scene, lower the speed, the acceleration or the surface's curvature; where a "
        "disturbance drives the contact into a pole of its chart, end its window before"
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
    tau, h, tries, mark = 0.0, min(problem.first, problem.length), 0, 0.0
    while tau < problem.length:
        tries += 1
        # a layer at the start may be as thin as it likes
        if tries > 40 * (len(series) + 25) or not h > 1e-15 * tau + 1e-30 * problem.length:
            raise _stuck(problem, tau)
        if len(series) and len(series) % MANY == 0 and tau > mark:
            if MANY * (problem.length - tau) > MOST_HERE * (tau - mark):
                raise _endless(problem, tau, len(series), MOST_HERE)
            mark = tau
        h = longest_panel(drive, slip, tau, min(h, problem.length - tau))
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
            basis = _legendre_basis(place + (after - tau) / length * (1.0 + m.node))
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
                # sweeps converge ever faster: the next changes less than this one by what this did
                quick = k > 0 and change < 0.3 * last
                if (change * (change / last) if quick else change) <= 0.01 * tolerance:
                    break
                if change <= 4e-16 or (k > 6 and change <= 1e-13 and change > 0.25 * last):
                    break
                if not change < 1e10 or (k > 3 and change > 4.0 * last):
                    k = SWEEPS
                    break
                top = np.abs(half * (m.series[-1] @ f) * problem.scale).max() if k == 3 else 0.0
                if top > 100.0 * tolerance:  # much too long, as its tail tells by now
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
        error = max((tail * problem.scale).max(), 0.1 * moved if moved > 1e-13 else 0.0)
        # an error below 1e-30 says no more than one of 1e-30, and a quotient must not overflow
        ratio = 0.9 * (tolerance / max(error, 1e-30)) ** (1.0 / NODES)
        if not error <= tolerance:
            known = coefficients.transpose(0, 2, 1), after - tau, -1.0
            h = (after - tau) * min(max(ratio, 0.35), 0.8)
            continue
        series.append(coefficients.transpose(0, 2, 1))
        known = series[-1], after - tau, 1.0
        start = end
        h = (after - tau) * min(ratio, 2.0)
        tau = after
        edges.append(tau)
        if slip > 0 and finish > 0:
            if slip * drive.decay(tau, drive.speed(tau)) <= finish:
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
        lost = drive.lost(tau)
        mean = (drive.lost(tau + h) - lost) / h  # the gain may be 0 at both ends, where sigma is
        gain = max(drive.gain(tau), drive.gain(tau + h), mean)
        if gain * h <= 30.0 or lost > 40.0:
            break
        h = 0.5 * h if 30.0 / gain < 0.5 * h else 30.0 / gain * 0.99
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
    head += f"#define SWEEPS {SWEEPS}\n#define NESTED {kernel.nested}\n"
    head += f"#define MANY {MANY}\n#define MOST_PANELS {MOST:g}\n"
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
    begun: list[Any] = [pointer, pointer, ctypes.c_double]
    library.fill_begun.argtypes = [*begun, *library.fill.argtypes[:-1]]
    library.states.argtypes = [*begun, pointer, integer, integer, pointer, pointer]
    for name in ("move", "room_of", "fill", "begin", "fill_begun", "states"):
        getattr(library, name).restype = integer
    return library


@functools.cache
def program_built() -> bool:
    """Whether it lies in the cache (looked up once)."""
    return find_compiler() is not None and library_path(_program_source()).exists()


@functools.cache
def _program_source() -> str:
    sizes = f"#define MOST {MOST_AT_ONCE}\n#define MOST_FOUND {MOST_FOUND}\n"
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


# --- tracks ------------------------------------------------------------------------------------


@dataclass(eq=False)
class Forced:
    """Rows of the panels of a contact under accelerations.

    Attributes
    ----------
    w1, v : slice or None
        Of W_1 and V; None where they are constant, or are no part of the body's drive.
    grown : float
        Slip that they can bring about.
    turn : (n_bodies, 2, 2) or None
        The map from W_1 to the body's W; None for the finger's own.
    motion : Motion or None
        That of the contact, where C integrates.
    """

    w1: slice | None
    v: slice | None
    grown: float
    turn: np.ndarray | None
    motion: Motion | None

    def drive(self, track: PanelTrack, tau: np.ndarray) -> np.ndarray:
        """W - V at local times, (n_bodies, 2, n)."""
        at = np.clip(tau, 0.0, track.panels.edges[-1])
        drive = track.w[:, :, None]
        if self.w1 is not None:
            drive = track.panels.evaluate(at, self.w1)
            drive = drive if self.turn is None else self.turn @ drive
        return drive - track.panels.evaluate(at, self.v) if self.v is not None else drive


@dataclass(eq=False)
class PanelTrack(Track):
    """Bodies whose states are panels in local time, or in arc length for geodesics.

    In space the panels hold (x, p) alone.

    Attributes
    ----------
    panels : Panels
    rows : slice
        The rows of the panels that hold these bodies' states.
    piece : GainPiece
        sigma and decay in local time.
    w, v : (n_bodies, 2)
        Drive sigma (w - v decay), unless ``forced`` says otherwise.
    by_length : bool
        The panels' variable is the arc length since start.
    forced : Forced or None
        Where W_1 and V are, if accelerations change them.
    """

    panels: Panels
    rows: slice
    piece: GainPiece
    w: np.ndarray
    v: np.ndarray | None
    by_length: bool = False
    forced: Forced | None = None

    def __post_init__(self) -> None:
        self._anchors: tuple[np.ndarray, np.ndarray] | None = None

    def state(self, t: np.ndarray) -> np.ndarray:
        return self.frames(t) if self.ambient else self._state_at(self._variable(t))

    def _frames(self, t: np.ndarray) -> np.ndarray:
        return self._state_at(self._variable(t)) if self.ambient else super()._frames(t)

    def _variable(self, t: np.ndarray) -> np.ndarray:
        """Where times are on the panels."""
        tau = t - self.start
        return self.piece.arc_length(tau) if self.by_length else tau

    def _state_at(self, at: np.ndarray) -> np.ndarray:
        own = self._own_state(at)
        return self.run(whole_frame(self.surface), own, self.parameters) if self.ambient else own

    def _own_state(self, at: np.ndarray) -> np.ndarray:
        """The rows of the panels; rounding may put a time 1e-16 outside."""
        return self.panels.evaluate(np.clip(at, 0.0, self.panels.edges[-1]), self.rows)

    def drive(self, t: np.ndarray) -> np.ndarray:
        tau = t - self.start
        sigma = self.piece.speed(tau)
        if self.forced is not None:
            return self.forced.drive(self, tau) * sigma
        drive = self.w[:, :, None] * sigma
        if self.v is not None:
            drive -= self.v[:, :, None] * (sigma * self.piece.decay(tau, sigma))
        return drive

    def end(self) -> np.ndarray:
        return self.panels.end[:, self.rows]

    # --- compiled evaluation

    @once
    def _data(self) -> tuple[int, Any, Any]:
        """Address of the C form of this track, that form, and what it points to."""
        data, kept = self._track_data()
        series, edges = self.panels.coefficients, self.panels.edges
        first = (self.rows.start or 0) * series.strides[2]
        at = self.panels.at or (address(edges), address(series))
        data.n_panels, data.edges, data.coefficients = len(edges) - 1, at[0], at[1] + first
        data.panel_stride, data.body_stride = series.strides[0] // 8, series.strides[1] // 8
        return ctypes.addressof(data), data, (kept, series, edges)

    def forced_by(self, motion: Motion, w: np.ndarray, turn: np.ndarray | None) -> PanelTrack:
        """This track for C alone, which integrates another motion under the same accelerations."""
        known = self.forced
        assert known is not None
        other = object.__new__(PanelTrack)
        other.__dict__.update(self.__dict__, panels=None, w=w)
        other.forced = Forced(known.w1, known.v, known.grown, turn, motion)
        other.__dict__.pop("_entries", None)
        data, kept = other._track_data()
        other.__dict__["_data"] = ctypes.addressof(data), data, kept
        return other

    @property
    def motion(self) -> Motion | None:
        """What C integrates; None where it does not."""
        return None if self.forced is None else self.forced.motion

    def _track_data(self) -> tuple[TrackData, Any]:
        """All but the panels, and what it points to."""
        piece, (period_u, period_v) = self.piece, self.surface.periods()
        constants, w, v = map(contiguous, self._numbers())
        data = TrackData(
            start=self.start, stop=self.stop, drive=drive_data(piece), nb=self.n_bodies,
            slips=self.v is not None, by_length=self.by_length,
            double_cover=self.surface.double_cover, period_u=period_u or 0.0,
            period_v=period_v or 0.0, constants=address(constants),
            length=address(piece.arrays[1]), w=address(w), v=address(v),
            n_constants=constants.shape[1], n_drive=2,
        )  # fmt: skip
        turn, offset = None, self.offset
        if offset is not None:
            offset = contiguous(offset)
            data.offset = address(offset)
        if self.forced is not None:
            first, turn = self.rows.start, self.forced.turn
            data.forced = True
            data.w_row = self.forced.w1.start - first if self.forced.w1 else 0
            data.v_row = self.forced.v.start - first if self.forced.v else 0
            data.turn = None if turn is None else address(turn)
        return data, (piece, constants, w, v, turn, offset)

    def _numbers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Constants of the evaluators' kernels, w and v."""
        return self.parameters, self.w, self.w if self.v is None else self.v

    def _entry(self, output: str) -> tuple[Evaluator, int] | None:
        compiled = self.evaluator(output)
        return (compiled, self._data[0]) if compiled.usable(self.compiled) else None

    def data_at(self, output: str) -> int | None:
        return self._data[0]

    def evaluator(self, output: str) -> Evaluator:
        """Of "points", "frames" or "coordinates"."""
        return evaluator(self.surface, self.ambient, output)

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
        with LOCK:
            if not self.anchored:
                self._anchors = self._anchored(contiguous(begin))

    def _anchored(self, begin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places on the panels, and u, v, theta there; C is told of them."""
        entry, n = self.entry("coordinates"), self.n_bodies
        if entry is not None:
            m = 4 * self.panels.count + 1
            at, anchors, work = np.empty(m), np.empty((n, 3, m)), np.empty((n, 5, m))
            entry[0].library.anchor(
                entry[1], address(begin), address(at), address(anchors), address(work)
            )
            return at, anchors
        edges = self.panels.edges
        at = (edges[:-1, None] + (edges[1:] - edges[:-1])[:, None] * _QUARTERS).ravel()
        at = np.append(at, edges[-1])
        points = np.concatenate([self._state_at(at), np.zeros((n, 2, len(at)))], axis=1)
        with np.errstate(all="ignore"):
            raw = self.run(coordinate_kernel(self.surface, True), points, self.parameters)
        u, v, theta = (
            np.vstack([begin[:, k], raw[:, i].T]) for k, i in enumerate((0, 1, 4))
        )  # places first, as unwind wants
        u, v, turned = self.surface.unwind(u, v)
        theta = np.unwrap(theta + np.pi * turned, axis=0)
        return at, np.stack([u, v, theta])[:, 1:].transpose(2, 0, 1)

    def _continue(self, t: np.ndarray, values: np.ndarray) -> None:
        """Bring (u, v, theta) to the branch of the nearest anchor, in place."""
        at, anchors = self._anchors  # type: ignore[misc]
        nearest = np.searchsorted(0.5 * (at[1:] + at[:-1]), self._variable(t))
        reference = anchors[:, :, nearest]
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


class MovingTrack(PanelTrack):
    """Bodies integrated when something asks for their motion.

    Attributes
    ----------
    kernel : Kernel
    problem : Problem
    tolerance : float
    """

    def __init__(
        self,
        surface: Surface,
        parameters: np.ndarray,
        piece: GainPiece,
        why: str,
        ambient: bool,
        compiled: bool | None,
        kernel: Kernel,
        problem: Problem,
        tolerance: float,
        w: np.ndarray,
        v: np.ndarray | None,
        offset: np.ndarray | None = None,
    ):
        self.surface, self.parameters, self.ambient = surface, parameters, ambient
        self.start, self.stop, self.compiled, self.offset = (
            piece.start, piece.stop, compiled, offset,
        )  # fmt: skip
        self.rows, self.piece, self.w, self.v = slice(None), piece, w, v
        self.by_length, self.forced = v is None, None
        self.kernel, self.problem, self.tolerance, self._why = kernel, problem, tolerance, why
        self._anchors = None

    @once
    def motion(self) -> Motion | None:
        """The problem laid out for C; None where it is integrated here."""
        if panels_built(self.kernel) if self.compiled is None else self.compiled:
            data, self._pointed = self._track_data()
            return Motion(self.kernel, self.problem, self.tolerance, data)
        return None

    @kept
    def panels(self) -> Panels:
        """The motion, integrated once."""
        if self.motion:
            return self.motion.panels()
        return _integrate_here(self.kernel, self.problem, self.tolerance)

    @once
    def _data(self) -> tuple[int, Any, Any]:
        if self.motion is None:
            return super()._data
        track = self.motion.data.track
        return self.motion.at, track, None

    def data_at(self, output: str) -> int | None:
        if self.motion is None:
            return super().data_at(output)
        return self.motion.at

    def _evaluate(self, output: str, t: np.ndarray, out: np.ndarray) -> int | None:
        if self.motion is not None:
            self.motion.run()
        return super()._evaluate(output, t, out)

    def again(self, tolerance: float) -> Track | None:
        if self.problem.stops or self.offset is not None:
            return None
        own, other = self.motion, self._copy(tolerance)
        if own is not None:
            other.__dict__["motion"] = own.again(tolerance)
        return other

    def moved(
        self, tolerance: float, problem: Problem, w: np.ndarray, v: np.ndarray | None
    ) -> MovingTrack:
        """This track for a problem that was :meth:`Problem.moved`, with other path velocities."""
        motion, other = self.motion, self._copy(tolerance)
        other.problem, other.w, other.v = problem, w, v
        if motion is not None:
            other.__dict__["motion"] = motion = motion.again(tolerance, problem)
            other._point(motion.data.track)
        return other

    def _point(self, data: TrackData) -> None:
        """Point to the numbers that :meth:`moved` changed."""
        data.w, data.v = address(self.w), address(self.w if self.v is None else self.v)

    def _copy(self, tolerance: float) -> MovingTrack:
        other = object.__new__(type(self))
        known = other.__dict__
        known.update(self.__dict__)
        for name in _OWN:
            known.pop(name, None)
        other.tolerance, other._anchors = tolerance, None
        return other

    @property
    def method(self) -> str:  # type: ignore[override]
        place = "space" if self.ambient else "its chart"
        if self.v is None:
            return f"geodesic in arc length, in {place}, {self.panels.count} panels"
        return f"development in {place}, {self.panels.count} panels"

    @property
    def reason(self) -> str:  # type: ignore[override]
        if self.panels.released is None:
            return self._why
        return f"{self._why}, below tolerance from t = {self.start + self.panels.released:.6g} s on"


_OWN = ("panels", "_data", "_entries")  # what a track for another tolerance must find anew


# --- geodesics with a first integral -----------------------------------------------------------


FLAT = 1e-3


@dataclass(frozen=True, eq=False)
class GeodesicForm:
    """Geodesics whose acceleration depends on the place alone, thanks to a first integral.

    Half the states of a moving frame or fewer, and sweeps that converge twice as fast. All kernels
    take the surface's parameters and then the numbers of a path.

    Attributes
    ----------
    start : Kernel
        point: the body's state, w (2) -> state, numbers of the path, 1 / (size of each rate).
    motion : Kernel
        State, sigma, decay (both unused) -> its rates in arc length.
    body : Kernel
        State -> the body's state, (x, p, q) or (u, v, theta).
    points, frames, coordinates : Evaluator
        State -> x; x, p, q; state, sigma, 0 -> u, v, u', v', theta.
    n_rates : int
        How many of the states are rates: the last ones.
    """

    start: Kernel
    motion: Kernel
    body: Kernel
    points: Evaluator
    frames: Evaluator
    coordinates: Evaluator
    n_rates: int


@per_structure
def geodesic_form(surface: Surface, ambient: bool) -> GeodesicForm | None:
    """The form for a surface, or None where no first integral is known."""
    p = SX.sym("p", len(surface.parameters))
    if ambient:
        x = SX.sym("x", 3)
        _, hessian = geometry.implicit_geometry(surface.implicit_expr(p, x), x)
        return None if ca.depends_on(hessian, x) else _quadric_form(surface)
    uv = SX.sym("uv", 2)
    root = ca.simplify(surface.geometry_expr(p, uv[0], uv[1]).metric_root)
    turns = not ca.depends_on(root, uv[0]) and root[0, 1].is_zero()
    return _clairaut_form(surface) if turns and not ca.depends_on(root[1, 1], uv) else None


def _quadric_form(surface: Surface) -> GeodesicForm:
    r"""Quadrics F = 0, by Joachimsthal's integral: state x, x'; numbers J, \|x'\|, direction of w.

    x'' = -(x'.Hx')/\|g\|^2 g with g = grad F and H = g' constant, and J = (x'.Hx') \|g\|^2 is an
    integral of that, so x'' = -J g/\|g\|^4 (Joachimsthal 1843; Klingenberg, Riemannian Geometry,
    3.5).
    """
    p, numbers = SX.sym("p", len(surface.parameters)), SX.sym("numbers", 4)
    constant = ca.vertcat(p, numbers)
    axis, w = SX.sym("axis", AXIS), SX.sym("w", 2)
    frame = whole_frame(surface).function(axis, p)
    gradient, hessian = geometry.implicit_geometry(surface.implicit_expr(p, frame[0:3]), frame[0:3])
    velocity, pace = w[0] * frame[3:6] + w[1] * frame[6:9], ca.norm_2(w)
    integral = ca.dot(velocity, hessian @ velocity) * ca.dot(gradient, gradient)
    begin = ca.vertcat(frame[0:3], velocity, integral, pace, w / pace, SX.ones(3) / pace)

    state, drive = SX.sym("state", 6), SX.sym("drive", 2)
    x, rate = state[0:3], state[3:6]
    level = surface.implicit_expr(p, x)
    gradient = ca.gradient(level, x)
    square = ca.dot(gradient, gradient)
    bend = -(numbers[0] / square**2) * gradient
    motion = Kernel("geodesic", ca.vertcat(state, drive), constant, ca.vertcat(rate, bend))
    motion.nested = 3
    moved = x - level * gradient / square
    normal = ca.substitute(gradient, x, moved)
    along = rate - ca.dot(rate, normal) / ca.dot(normal, normal) * normal
    back = ca.vertcat(moved, along * (numbers[1] / ca.norm_2(along)))
    motion.restores = (Restoration(Kernel("restore_geodesic", state, constant, back), 0, 0),)

    along = rate / ca.norm_2(rate)
    across, turn = ca.cross(gradient / ca.sqrt(square), along), numbers[2:4]
    first = turn[0] * along - turn[1] * across
    body = ca.vertcat(x, first, turn[1] * along + turn[0] * across)
    chart = frame_coordinates(surface, p, x, first, drive[0] * rate)
    found = Kernel("geodesic_coordinates", ca.vertcat(state, drive), constant, chart)
    frames = Kernel("geodesic_frames", state, constant, body)
    return GeodesicForm(
        Kernel("geodesic_start", ca.vertcat(axis, w), p, begin), motion, frames,
        evaluator(surface, True, "points"), Evaluator(frames, False, 6, False),
        Evaluator(found, False, 6, True), 3,
    )  # fmt: skip


def _clairaut_form(surface: Surface) -> GeodesicForm:
    r"""Charts with h_u(v), h_v constant (torus), by Clairaut's integral L = h_u^2 u'.

    State u, v, v' with v'' = h_u'/(h_u^3 h_v^2) L^2; numbers L, \|w\|, and what the path's angle to
    f_u, which stays on one side of f_v, lacks to theta (do Carmo, Differential Geometry, 4-4).
    """
    p, numbers = SX.sym("p", len(surface.parameters)), SX.sym("numbers", 3)
    constant, place, w = ca.vertcat(p, numbers), SX.sym("place", 3), SX.sym("w", 2)
    state, drive = SX.sym("state", 3), SX.sym("drive", 2)

    def lame(uv: SX) -> SX:
        return surface.geometry_expr(p, uv[0], uv[1]).lame

    def angle(sideways: SX, integral: SX, h: SX) -> SX:
        lean = ca.atan2(sideways, ca.fabs(integral) / h[0])
        return ca.if_else(integral < 0, np.pi - lean, lean)

    c, h = rotation(place[2]) @ w, lame(place)
    integral = h[0] * c[0]
    rest = place[2] - angle(c[1], integral, h)
    pace = ca.norm_2(w)
    begin = ca.vertcat(place[:2], c[1] / h[1], integral, pace, rest, h[1] / pace)

    h = lame(state)
    slope = ca.jacobian(h[0], state[1])
    turn = numbers[0] / h[0] ** 2
    bend = turn**2 * h[0] * slope / h[1] ** 2
    motion = Kernel(
        "geodesic", ca.vertcat(state, drive), constant, ca.vertcat(turn, state[2], bend)
    )
    motion.nested = 1
    # A Newton step along the gradient of the speed's square puts it right; short of where that is
    # flat (equators), since rounding would be divided by its square.
    lean = h[1] * state[2] / numbers[1]
    excess = (numbers[0] / (h[0] * numbers[1])) ** 2 + lean**2 - 1
    slopes = ca.vertcat(ca.jacobian(excess, state[1]), 2 * lean)
    shift = -excess * slopes / (ca.sumsqr(slopes) + FLAT)
    back = ca.vertcat(state[0], state[1] + shift[0], state[2] + shift[1] * numbers[1] / h[1])
    motion.restores = (Restoration(Kernel("restore_geodesic", state, constant, back), 0, 0),)
    theta = angle(h[1] * state[2], numbers[0], h) + numbers[2]
    chart = ca.vertcat(state[:2], drive[0] * turn, drive[0] * state[2], theta)
    found = Kernel("geodesic_coordinates", ca.vertcat(state, drive), constant, chart)
    x, at = surface.chart_expr(p, state[0], state[1]), ca.vertcat(state[:2], theta)
    frames = Kernel("geodesic_frames", state, constant, frame_kernel(surface).function(at, p))
    return GeodesicForm(
        Kernel("geodesic_start", ca.vertcat(place, w), p, begin), motion,
        Kernel("geodesic_places", state, constant, at),
        Evaluator(Kernel("geodesic_points", state, constant, x), False, 3, False),
        Evaluator(frames, False, 3, False), Evaluator(found, False, 3, False), 1,
    )  # fmt: skip


class GeodesicTrack(MovingTrack):
    """Geodesics of a :class:`GeodesicForm`: panels of its states in arc length."""

    @kept
    def form(self) -> GeodesicForm:
        found = geodesic_form(self.surface, self.ambient)
        assert found is not None
        return found

    def _state_at(self, at: np.ndarray) -> np.ndarray:
        return self.run(self.form.body, self._own_state(at), self.problem.constants)

    def end(self) -> np.ndarray:
        return self.form.body.at(self.panels.end, self.problem.constants)[:, :AXIS]

    def _numbers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        unit = np.zeros_like(self.w)
        unit[:, 0] = 1.0
        return self.problem.constants, unit, unit

    def _point(self, data: TrackData) -> None:
        data.constants = address(self.problem.constants)

    def evaluator(self, output: str) -> Evaluator:
        return getattr(self.form, output)
