r"""The paper's equations in chart coordinates, corrected (theory section 2).

State of a contact: u1 v1 u1' v1' u2 v2 u2' v2' psi. With sigma the path profile and lam the gain,

.. math::
    \ddot q_1^k &= \tfrac{\dot\sigma}{\sigma}\dot q_1^k - \Gamma^k_{ij}\dot q_1^i\dot q_1^j + d_1^k
        && (\text{eq. timegeodesic}) \\
    \ddot q_2^k &= \tfrac{\dot\sigma}{\sigma}\dot q_2^k - \Gamma^k_{ij}\dot q_2^i\dot q_2^j
        + \lambda\,(M_2^{-1} R_\psi M_1 \dot q_1 - \dot q_2)^k + d_2^k && (\text{eq. contrac}) \\
    \dot\psi &= T_1 M_1 \dot q_1 + T_2 M_2 \dot q_2 .

Unlike in the paper the first Christoffel term of v" multiplies u'^2 (eqs. `timegeodesic` and
`contrac` print v'^2), and psi obeys the last line, which the paper uses and does not print.

An object rate offset d moves the contact point (u2' + d) but not the feedback: q2' is carried along
the actual motion, ``-Gamma^k_ij (q2' + d)^i q2'^j``, so that the slip law stays exact.
"""

from __future__ import annotations

import casadi as ca

from .development import reflection
from .errors import SurfaceError
from .geometry import ChartGeometry, upper_inverse
from .kernels import Kernel, per_structure
from .surfaces import Surface

SX = ca.SX


def transport(shape: ChartGeometry, along: SX, vector: SX) -> SX:
    """-Gamma^k_ij along^i vector^j: what keeps a chart vector parallel on the way."""
    return -ca.vertcat(*(ca.bilin(gamma, along, vector) for gamma in shape.christoffel))


@per_structure
def chart_equations(finger: Surface, obj: Surface) -> Kernel:
    """Kernel of one contact's equations of motion in chart coordinates.

    point: state (9), sigma'/sigma, lam, d1 (2), d2 (2), object rate offset (2).
    constant: parameters of finger and object. result: state' (9).

    Raises
    ------
    SurfaceError
        A surface without an explicit chart (ImplicitSurface).
    """
    for surface in (finger, obj):
        if not surface.has_chart:
            raise SurfaceError(
                f"{surface!r} has no explicit chart, so the chart equations cannot be written for "
                "it; use the default method, which works in space, or give a ParametricSurface"
            )
    state, drive = SX.sym("state", 9), SX.sym("drive", 2)
    d1, d2, offset = SX.sym("d1", 2), SX.sym("d2", 2), SX.sym("offset", 2)
    p1, p2 = SX.sym("p1", len(finger.parameters)), SX.sym("p2", len(obj.parameters))
    rate_1, rate_2, psi = state[2:4], state[6:8], state[8]
    tip = finger.geometry_expr(p1, state[0], state[1])
    body = obj.geometry_expr(p2, state[4], state[5])
    moved = rate_2 + offset
    a1 = tip.metric_root @ rate_1
    rolled = reflection(ca.cos(psi), ca.sin(psi)) @ a1
    growth, lam = drive[0], drive[1]
    accel_1 = growth * rate_1 + transport(tip, rate_1, rate_1) + d1
    accel_2 = growth * rate_2 + transport(body, moved, rate_2) + d2
    accel_2 += lam * (upper_inverse(body.metric_root) @ rolled - rate_2)
    spin = tip.torsion_form @ a1 + body.torsion_form @ (body.metric_root @ moved)
    point = ca.vertcat(state, drive, d1, d2, offset)
    result = ca.vertcat(rate_1, accel_1, moved, accel_2, spin)
    return Kernel("chart_equations", point, ca.vertcat(p1, p2), result)
