r"""Rolling as the development of a plane curve: moving frames on any surface (theory section 4, 5).

The contact point of body i moves with velocity ``c_1 p + c_2 q``, where ``[p q]`` is a frame
carried by parallel transport and ``c`` is known in advance:

.. math:: c_1 = \sigma W_1, \qquad c_2 = \sigma (W - V e^{-L}), \qquad W = R_0 W_1 .

No sigma'/sigma, no stiffness, and no coupling between the bodies. Two forms of state:

* ambient, (x, p, q) in R^9, for surfaces with an implicit form: no chart, no poles;
* chart, (u, v, theta), for surfaces given by a chart: [p q] is the contact frame turned by theta.

Accelerations that act on a finger or the object make W_1 and V states as well ("forced").
"""

from __future__ import annotations

import casadi as ca

from . import geometry
from .kernels import Kernel, Restoration, made_once, per_structure
from .surfaces import Surface
from .tracks import (
    AXIS,
    chart_to_parallel,
    restoring_axis,
    restoring_kernel,
    rotation,
    standing_size,
    whole_frame,
)

SX = ca.SX


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


def starting_slip(w1: SX, w2: SX, given: SX) -> SX:
    """V = W_2 less the path velocity given; of a rolling start, which is rounded twice, none."""
    v, rounding = w2 - given, 1e-15 * ca.fmax(ca.fmax(ca.fabs(w1[0]), ca.fabs(w1[1])), 1e-300)
    return ca.if_else(ca.fabs(v) <= rounding, 0, v)


@made_once
def contact_start() -> Kernel:
    """point: psi, W_1 in E1, the object's path velocity in E2 -> R_psi by rows (4), W_2, V."""
    point = SX.sym("point", 5)
    psi, w1, given = ca.vertsplit(point, [0, 1, 3, 5])
    r0 = reflection(ca.cos(psi), ca.sin(psi))
    w2 = r0 @ w1
    v = starting_slip(w1, w2, given)
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
    kernel.reach = surface.reach
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
    kernel.reach = min(finger.reach, obj.reach)
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
    kernel = Kernel("rolling", ca.vertcat(state, drive), ca.vertcat(p1, p2, w), rate)
    kernel.reach = min(finger.reach, obj.reach)
    return kernel


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
    made.reach = kernel.reach
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
    made.reach = kernel.reach
    made.restores = tuple(restores)
    return made


@made_once
def slip_displacement() -> Kernel:
    """Kernel of s' = sigma, g' = sigma decay (theory section 4), all that slip costs on a
    developable body."""
    state, drive = SX.sym("state", 2), SX.sym("drive", 2)
    rate = drive[0] * ca.vertcat(1, drive[1])
    return Kernel("displacement", ca.vertcat(state, drive), SX.sym("none", 1), rate)
