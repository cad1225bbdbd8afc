"""A contact as a system of equations in the variables of an FMU, as one table of instructions.

The mathematics is that of `contact_system.contact_equations`, in the variables that an importer
sees. The states of a contact are, of finger and object, the frame that is carried along its path: a
point and a tangent in space (6), or u v theta if the body is moved in its chart (3); then the path
velocity W_1 and V, slip over sigma, in these frames. They exist where sigma is 0 too, have no poles
in space, and are not stiff where the gain is large.

Results are the states' derivatives; the nine numbers of charts, u1 v1 u1' v1' u2 v2 u2' v2' psi;
slip (2), twist (6), the pose of the finger in the object's frame (rotation row by row, 9,
position, 3), the contact point on finger and object (3 + 3); the length of the slip; sigma, 1 where
a disturbance acts, and the time in which slip falls to `REJECTED` at its present rate, `NEVER`
where it does not.
"""

from __future__ import annotations

import math

import numpy as np

from contact_system.contact_equations import Form, contact_function
from contact_system.contact_sensor import measured_contact
from contact_system.measures import REJECTED
from contact_system.scene import SLOTS
from contact_system.surfaces import SINGULAR, TINY, Surface
from contact_system.theory import symbols as ca
from contact_system.theory.development import in_space
from contact_system.theory.gain import Law
from contact_system.theory.geometry import number_symbols
from contact_system.theory.lowering import Table
from contact_system.theory.profile import polynomial
from contact_system.theory.symbols import making_symbols, per_structure

NEVER = 1e6  # s
TOLERANCE = 1e-14
"""Of plans; with 1e-13, K4 ends with an error of 4e-14 of its size."""
WORK_SIZE = 1.0
"""A body's size for `contact_function`, which needs one; no result depends on it."""


def frame_size(surface: Surface) -> int:
    """Number of states of a body's frame, which inputs may disturb: 6 in space, 3 in a chart."""
    return 6 if in_space(surface, True) else 3


@per_structure
def equations(finger: Surface, obj: Surface, law: Law, n_profile: int) -> tuple[Table, np.ndarray]:
    """The table (time, states, disturbances | gain, profile, numbers of both) -> results; and which
    of these each result depends on."""
    with making_symbols():
        forms = in_space(finger, True), in_space(obj, True)
        form = Form("frame", True, forms, law, n_profile, ())
        t, x, w = ca.SX.sym("t"), ca.SX.sym("x", sum(form.sizes)), ca.SX.sym("w", 2 * len(SLOTS))
        gain, profile = ca.SX.sym("gain"), ca.SX.sym("profile", n_profile)
        p1, p2 = (ca.SX.sym("p", len(s.parameters)) for s in (finger, obj))
        # past sigma's end the path rests: a solver may evaluate there within its last step
        ended = polynomial(ca.vertsplit(profile), t) < 0
        law_values = ca.vertcat(gain, ca.if_else(ended, 0, profile))
        numbers = ca.vertcat(p1, WORK_SIZE), ca.vertcat(p2, WORK_SIZE)
        function = contact_function(finger, obj, form)
        values = function(t, x, w, ca.SX(0, 1), law_values, *numbers)
        found = dict(zip(function.name_out(), values))
        pose = found["pose"]
        by_rows = ca.vertcat(ca.vec(ca.reshape(pose[:9], 3, 3).T), pose[9:])
        results = ca.vertcat(
            *(found["derivatives"], found["state"]),
            *(found["slip"], found["twist"], by_rows, found["contact_point"]),
            *_condition(law, t, law_values, found["slip"], w),
        )
        point, constants = ca.vertcat(t, x, w), ca.vertcat(gain, profile, p1, p2)
        made = ca.Function("equations", [point, constants], [ca.densify(ca.cse(results))])
        parts = [ca.DM(made.jac_sparsity(0, k), 1).full() for k in range(2)]
        return Table(made), np.hstack(parts) != 0


def _condition(law: Law, t: ca.SX, law_values: ca.SX, slip: ca.SX, w: ca.SX) -> list[ca.SX]:
    """|slip|, sigma, 1 if a disturbance acts or 0, expected time of recovery."""
    profile = ca.vertsplit(law_values[1:])
    sigma = polynomial(profile, t)
    growth = ca.gradient(sigma, t) / ca.fmax(sigma, TINY)
    # the rate of contraction, lam - growth, without what cancels: at rest rho is lost beside it
    remains = ca.fmin(0, growth) if law.cancels_growth else growth
    rate = law.rate(law_values[0], sigma, 0) - remains
    recovery = ca.fmin(-math.log(REJECTED) / ca.fmax(rate, 1e-9), NEVER)
    return [ca.sqrt(ca.sumsqr(slip) + TINY), sigma, ca.sumsqr(w) > 0, recovery]


@per_structure
def measured(finger: Surface, obj: Surface, what: str) -> Table:
    """The table by which a contact goes on from a measurement; what: "states" or "pose".

    point: the measured states (9); or for a pose, the unknowns of finger and object, V_OF_O (6),
    and X_OF, the rotation row by row (9) and the position (3).
    constants: sign, parameters and size of the finger, and of the object.
    result: the next unknowns, the first numbers of `Probe.found` up to the states, M_1, M_2 (8).
    """
    if what == "states":
        point = ca.SX.sym("states", 9)
        columns, roots = list[ca.SX](), list[ca.SX]()
        for s, uv in ((finger, point[0:2]), (obj, point[4:6])):
            numbers, size = number_symbols(s), ca.SX.sym("size")
            at = s.geometry_expr(numbers, uv)
            columns += [numbers, size]
            valid = ca.fmin(at.metric_root[0, 0], at.metric_root[1, 1]) > SINGULAR * size
            if s.has_implicit and None in s.periods():  # a chart like a sphere's has a range
                k = s.periods().index(None)
                off = s.coordinates_expr(numbers, at.point)[k] - uv[k]
                valid = ca.logic_and(valid, ca.fabs(off) < 1e-9 * (1 + ca.norm_1(uv)))
            roots.append(ca.if_else(valid, ca.vec(at.metric_root), np.nan))
        constants, result = ca.vertcat(*columns), ca.vertcat(0, 1, point, *roots)
    else:
        measurement, constants, *results = measured_contact(finger, obj)
        ends = (measurement.numel() - k for k in (22, 10, 4, 0))
        unknowns, pose, twist, others = ca.vertsplit(measurement, [0, *ends])
        point = ca.vertcat(unknowns, twist, *(pose[k : k + 3] for k in (0, 4, 8)), pose[3::4])
        # slip is at the object's surface, and not known
        result = ca.substitute(ca.vertcat(*results[:4], results[-1]), others, 0)
    return Table(ca.Function("measured", [point, constants], [ca.densify(ca.cse(result))]))
