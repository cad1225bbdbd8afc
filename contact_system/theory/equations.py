r"""The paper's equations of two bodies in contact, corrected (theory sections 2, 3, 8).

Body 1 is the finger, body 2 the object. In contact frames E_i, or in parallel frames with R_0 in
place of R_psi,

.. math::
    R_\psi = \begin{bmatrix}\cos\psi & -\sin\psi\\ -\sin\psi & -\cos\psi\end{bmatrix}, \qquad
    v_{rel} = R_\psi M_1 \dot q_1 - M_2 \dot q_2 \quad (\text{eq. } netrelvel).

The velocity of the finger's material point relative to the object's is ``-v_rel`` in E2.

State of a contact in charts: u1 v1 u1' v1' u2 v2 u2' v2' psi. With sigma the path profile and lam
the gain,

.. math::
    \ddot q_1^k &= \tfrac{\dot\sigma}{\sigma}\dot q_1^k - \Gamma^k_{ij}\dot q_1^i\dot q_1^j + d_1^k
        && (\text{eq. timegeodesic}) \\
    \ddot q_2^k &= \tfrac{\dot\sigma}{\sigma}\dot q_2^k - \Gamma^k_{ij}\dot q_2^i\dot q_2^j
        + \lambda\,(M_2^{-1} R_\psi M_1 \dot q_1 - \dot q_2)^k + d_2^k && (\text{eq. contrac}) \\
    \dot\psi &= T_1 M_1 \dot q_1 + T_2 M_2 \dot q_2 .

Unlike in the paper the first Christoffel term of v" multiplies u'^2 (eqs. `timegeodesic` and
`contrac` print v'^2), and psi obeys the last line, which the paper uses and does not print.

An object rate offset d moves the contact point (u2' + d) but does not enter the feedback. q2' is
transported along the actual motion, ``-Gamma^k_ij (q2' + d)^i q2'^j``, to keep the slip law exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from . import symbols as ca
from .geometry import ChartGeometry, rotation, symmetric, upper_inverse
from .symbols import making_symbols


def reflection_rows(cos_psi: Any, sin_psi: Any) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
    """Rows of R_psi (eq. ``rotation``), its own inverse, from symbols, numbers or arrays."""
    return (cos_psi, -sin_psi), (-sin_psi, -cos_psi)


def reflection(cos_psi: ca.SX, sin_psi: ca.SX) -> ca.SX:
    """R_psi, 2x2."""
    return ca.vertcat(*(ca.horzcat(*row) for row in reflection_rows(cos_psi, sin_psi)))


def flip() -> ca.SX:
    """R_0, which is R_psi for psi = 0: the map between the moving frames of finger and object."""
    return reflection(ca.SX(1), ca.SX(0))


def relative_velocity(r: ca.SX, a1: ca.SX, a2: ca.SX) -> ca.SX:
    """v_rel of eq. ``netrelvel`` from the contact velocities a_i = M_i q_i', m/s, (2)."""
    return r @ a1 - a2


# --- chart coordinates ---------------------------------------------------------------------------


def chart_rates(
    shapes: Sequence[ChartGeometry], state: ca.SX, growth: ca.SX, lam: ca.SX, w: ca.SX
) -> ca.SX:
    """state' (9) of a contact in charts.

    shapes: geometry of finger and object at the contact; growth: sigma'/sigma; w: d1, d2 and the
    object rate offset, (6).
    """
    _, rate_1, _, rate_2, psi = ca.vertsplit(state, [0, 2, 4, 6, 8, 9])
    d1, d2, offset = ca.vertsplit(w, 2)
    tip, body = shapes
    contact_rate = rate_2 + offset
    a1 = tip.metric_root @ rate_1
    rolled = reflection(ca.cos(psi), ca.sin(psi)) @ a1
    accel_1 = growth * rate_1 + _transport(tip, rate_1, rate_1) + d1
    accel_2 = growth * rate_2 + _transport(body, contact_rate, rate_2) + d2
    accel_2 += lam * (upper_inverse(body.metric_root) @ rolled - rate_2)
    spin = tip.torsion_form @ a1 + body.torsion_form @ (body.metric_root @ contact_rate)
    return ca.vertcat(rate_1, accel_1, contact_rate, accel_2, spin)


def _transport(shape: ChartGeometry, along: ca.SX, vector: ca.SX) -> ca.SX:
    """-Gamma^k_ij along^i vector^j: the rate of a chart vector in parallel transport."""
    return -ca.vertcat(*(ca.bilin(gamma, along, vector) for gamma in shape.christoffel))


# --- in parallel frames ----------------------------------------------------------------------


def starting_slip(w1: ca.SX, w2: ca.SX, velocity: ca.SX) -> ca.SX:
    """V = W_2 minus the path velocity of the object; exactly 0 where it may be rounding."""
    v, rounding = w2 - velocity, 1e-15 * ca.fmax(ca.fmax(ca.fabs(w1[0]), ca.fabs(w1[1])), 1e-300)
    return ca.if_else(ca.fabs(v) <= rounding, 0, v)


def pushed_paths(sigma: ca.SX, r0: ca.SX, pushed_1: ca.SX, pushed_2: ca.SX) -> tuple[ca.SX, ca.SX]:
    """W_1' and V' due to accelerations, without the term -lam V (theory section 7), (2) each.

    pushed_i: Rot(theta)^T M d, the accelerations in the parallel frames, m/s^2.
    """
    w1_rate = pushed_1 / sigma
    return w1_rate, r0 @ w1_rate - pushed_2 / sigma


def slip_acceleration(
    v: ca.SX, sigma: ca.SX, slope: ca.SX, lam: ca.SX, r0: ca.SX, pushed_1: ca.SX, pushed_2: ca.SX
) -> ca.SX:
    """D v_rel/dt along curve 2 of v_rel = sigma V, rate offsets left out (theory section 3), (2).

    slope: sigma'; pushed_i as for :func:`pushed_paths`.
    """
    return v * (slope - lam * sigma) + r0 @ pushed_1 - pushed_2


# --- pose and twist ------------------------------------------------------------------------------


def relative_pose(frame_1: ca.SX, frame_2: ca.SX, r0: ca.SX) -> tuple[ca.SX, ca.SX]:
    """R_21 (3, 3) and the origin (3), m, of the finger's body frame in the object's (section 8).

    frame_i (9): contact point x and tangent axes p, q in the frame of body i. r0 (2, 2): map from
    tangent components along (p_1, q_1) to those along (p_2, q_2).
    """
    (x1, p1, q1), (x2, p2, q2) = (ca.vertsplit(f, [0, 3, 6, 9]) for f in (frame_1, frame_2))
    # [p2 q2 n2] diag(R_0, -1) [p1 q1 n1]^T
    tangent = ca.horzcat(p2, q2) @ r0 @ ca.horzcat(p1, q1).T
    turn = tangent - ca.cross(p2, q2) @ ca.cross(p1, q1).T
    return turn, x2 - turn @ x1


def relative_twist(
    frames: tuple[ca.SX, ca.SX],
    shapes: tuple[ca.SX, ca.SX],
    velocities: tuple[ca.SX, ca.SX],
    r0: ca.SX,
    v_rel: ca.SX,
) -> tuple[ca.SX, ca.SX]:
    """Twist of the finger's frame in the object's frame (theory section 8).

    Returns omega (3), rad/s, and the velocity of the frame's origin (3), m/s.

    frames, r0: as for :func:`relative_pose`; shapes: K_pp, K_pq, K_qq of finger and object;
    velocities (2): a_1 and a_2 of the contact point, along (p_i, q_i), m/s; v_rel (2): slip along
    (p_2, q_2), m/s.
    """
    _, p2, q2 = ca.vertsplit(frames[1], [0, 3, 6, 9])
    k1, k2 = (symmetric(*ca.vertsplit(k)) for k in shapes)
    # Montana's inverse map, (-omega_y, omega_x) in the frame of K_2: Montana, Int. J. Robotics
    # Research 7(3), 1988
    rolling = k2 @ velocities[1] + r0 @ (k1 @ velocities[0])
    omega = rolling[0] * q2 - rolling[1] * p2
    sliding = v_rel[0] * p2 + v_rel[1] * q2
    # from the finger's origin to the contact; x2 less the origin would lose digits far out
    arm = relative_pose(*frames, r0)[0] @ frames[0][:3]
    return omega, -sliding - ca.cross(omega, arm)


def contact_velocities(
    shape_1: ca.SX, shape_2: ca.SX, r: ca.SX, rolling: ca.SX, v_rel: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Montana's forward map from a twist to the contact velocities a_i = M_i q_i' in E_i, m/s.

    shape_i: K_i (2, 2); r: R_psi; rolling: [-omega_y, omega_x] in E1, rad/s, which is equal to
    ``K_1 a_1 + R_psi K_2 a_2``; v_rel: slip in E2, m/s. Not finite where the bodies conform.
    """
    a1 = solve_plane(relative_curvature(shape_1, shape_2, r), rolling + r @ shape_2 @ v_rel)
    return a1, r @ a1 - v_rel


def relative_curvature(shape_1: Any, shape_2: Any, r: Any) -> Any:
    """K_1 + R_psi K_2 R_psi in E1, 1/m; singular where the surfaces conform to each other.

    The arguments are symbols, or arrays (..., 2, 2).
    """
    return shape_1 + r @ shape_2 @ r


def solve_plane(a: ca.SX, b: ca.SX) -> ca.SX:
    """Solve A x = b by Cramer's rule."""
    return ca.adj(a) @ b / ca.det(a)


# --- functions of a contact for the engine -------------------------------------------------------


def contact_functions() -> dict[str, ca.Function]:
    """The functions (point, constants) that do not depend on surfaces, in the engine's order.

    The constants are those of R0, row by row, or none.
    """
    sym = ca.SX.sym
    with making_symbols():
        rows, none = sym("R0", 4), ca.SX(0, 1)
        r0 = ca.reshape(rows, 2, 2).T
        psi, w1, velocity, y = sym("psi"), sym("W1", 2), sym("velocity", 2), sym("y", 2)
        theta, sigma, slope, lam = (sym(name) for name in ("theta", "sigma", "slope", "lam"))
        frames, shapes = (sym("frame1", 9), sym("frame2", 9)), (sym("K1", 3), sym("K2", 3))
        velocities, slip, v = (sym("a1", 2), sym("a2", 2)), sym("v_rel", 2), sym("V", 2)
        pushed = (sym("pushed1", 2), sym("pushed2", 2))
        start_r = reflection(ca.cos(psi), ca.sin(psi))
        turn, origin = relative_pose(*frames, r0)
        twist = relative_twist(frames, shapes, velocities, r0, slip)
        acceleration = slip_acceleration(v, sigma, slope, lam, r0, *pushed)
        made: dict[str, tuple[list[ca.SX], ca.SX, list[ca.SX]]] = {
            "start": (
                [psi, w1, velocity],
                none,
                [ca.vec(start_r.T), starting_slip(w1, start_r @ w1, velocity)],
            ),
            "pose": ([*frames], rows, [ca.vec(turn.T), origin]),
            "twist": ([*frames, *shapes, *velocities, slip], rows, [*twist]),
            "turned": ([theta, y], none, [rotation(theta) @ y]),
            "acceleration": ([sigma, slope, lam, v, *pushed], rows, [acceleration]),
            "pushed": ([sigma, *pushed], rows, [*pushed_paths(sigma, r0, *pushed)]),
        }
        return {
            name: ca.Function(name, [ca.vertcat(*point), constants], [ca.vertcat(*result)])
            for name, (point, constants, result) in made.items()
        }
