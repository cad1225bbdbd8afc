r"""The control law of a fingertip, free or on joints: a wrench that makes it move as wanted.

It is the sum, about the tip's origin, of what the wanted motion needs for mass and inertia, the
contact force at the contact point, a spring and dampers that track position and spin, and, as in
the paper, the acceleration lam v_rel for a measured slip v_rel.

Free tips and tips on joints differ in the wanted motion, and in ``hold``. A free tip follows the
object wherever it is measured to be. Along the normal it has only a damper, so that contact decides
how deep it is pressed in: ``hold = 0``. On a hand, nothing would then keep the object in its place.
So tips on joints track a motion in the world, with a spring along the normal too: ``hold = 1``.

In a discrete plant (semi-implicit Euler, step h) the velocity at t_k moved the body from t_{k-1} to
t_k, so the velocity to track is that of half a step ago; the object's, which is measured, is that
already. The tracking error is resolved in a frame that turns with the contact normal at
Omega = n x n'. docs/drake-contact.md says what each term is worth.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
from pydrake.multibody.tree import RigidBody

from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table
from contact_system.theory.symbols import per_structure

from .config import GAINS
from .planner_base import MOTION
from .plant import ScenePlant, gravity_on
from .tables import named, slices

SHARE, STIFF = 0.4, 0.1
"""Greatest d = c h/m of an explicit damper c, and s = k h^2/m of an explicit spring k, for a mass m
and steps h. They are stable where 0 < d and s + 2 d < 4; but the object moves too: one as light as
its fingers turns with them, and a spring of 0.4 shakes both."""

SLIP_SHARE = 0.8
"""The part of slip that feedback may remove in a step: with friction, more would reverse slip."""

TIP = {"X_WF": 12, "V_WF": 6, "contact_force": 3}
"""State of a tip: its pose, row by row, and velocity, the angular part first; and the force that it
is to exert on the object."""
WANTED = {"p_WT": 3, "V_WT": 6, "A_WT": 6, "normal": 3, "turning": 3, "arm": 3}
"""The tip as it should be, T: its position, velocity and acceleration; the contact's normal and its
angular velocity; the contact point, from the tip's origin."""
CONSTANT = {"h": 1, "mass": 1, "inertia": 9, "gravity": 3}
CONSTANT |= dict.fromkeys((*GAINS, "slip_gain", "hold"), 1)
FREE_TIP = {"X_WO": 12, "V_WO": 6, "A_WO": 6, **TIP, "motion": sum(MOTION.values())}
FREE_TIP |= {"sliding": 3, "push": 3, "normal_force": 1}
"""Inputs of the law of a free tip."""
HELD = {**TIP, "slip": 3, **WANTED}
"""Inputs of the law of a tip on joints."""


@per_structure
def driving_law() -> Table:
    """Table of a free tip: `FREE_TIP`, `CONSTANT` -> torque (3), force (3), in the world."""
    point, x = named(FREE_TIP)
    constant, c = named(CONSTANT)
    plan = {name: x.motion[part] for name, part in slices(MOTION).items()}
    x.R_OF, x.p_OF = ca.reshape(plan["pose"][:9], 3, 3), plan["pose"][9:]
    x.w_OF, x.v_OF = ca.vertsplit(plan["twist"], 3)
    x.alpha_OF, x.a_OF = ca.vertsplit(plan["acceleration"], 3)
    # `WANTED` is the plan, carried along by the object; velocities are those of half a step ago.
    cross, h = ca.cross, c.h
    off, v, spin = x.R_WO @ x.p_OF, x.R_WO @ x.v_OF, x.R_WO @ x.w_OF
    swept = cross(x.w_WO, off)
    a = cross(x.w_WO, swept + 2 * v) + x.R_WO @ x.a_OF  # relative to the object
    alpha = cross(x.w_WO, spin) + x.R_WO @ x.alpha_OF
    x.p_WT, x.R_WT = x.p_WO + off, x.R_WO @ x.R_OF
    x.v_WT, x.w_WT = x.v_WO + swept + v - 0.5 * h * a, x.w_WO + spin - 0.5 * h * alpha
    x.a_WT, x.alpha_WT = x.a_WO + cross(x.alpha_WO, off) + a, x.alpha_WO + alpha
    x.normal = x.R_WO @ plan["normal"]
    x.turning = x.R_WO @ cross(plan["normal"], plan["normal_rate"]) + x.w_WO
    x.turning -= ca.dot(x.w_WO, x.normal) * x.normal
    x.arm, x.slip = x.R_WT @ plan["contact_point"][:3], x.R_WO @ x.sliding
    x.contact_force -= x.normal_force * x.normal
    wrench = tip_wrench(x, c) + ca.vertcat(0, 0, 0, x.push)
    return Table(ca.Function("driving", [point, constant], [ca.densify(wrench)]))


@per_structure
def holding_law() -> Table:
    """Table of a tip on joints: `HELD`, `CONSTANT` -> torque (3), force (3), in the world."""
    point, x = named(HELD)
    constant, c = named(CONSTANT)
    return Table(ca.Function("holding", [point, constant], [ca.densify(tip_wrench(x, c))]))


def tip_wrench(x: SimpleNamespace, c: SimpleNamespace) -> ca.SX:
    """Torque and force on a tip about its origin; all vectors are in the world.

    x : `HELD`; slip is v_rel where it is to be rejected, else 0
    c : `CONSTANT`
    """
    inertia, w = x.R_WF @ ca.reshape(c.inertia, 3, 3) @ x.R_WF.T, x.w_WT
    torque = inertia @ x.alpha_WT + ca.cross(w, inertia @ w) + c.spin_gain * (w - x.w_WF)
    torque += ca.cross(x.arm, x.contact_force)
    # The tracking error is resolved in the frame that turns with the normal.
    cross, normal, turning = ca.cross, x.normal, x.turning
    error, error_rate = x.p_WT - x.p_WF, x.v_WT - x.v_WF
    # The velocities are those of half a step ago, so the error is taken then too.
    error_rate -= cross(turning, error - 0.5 * c.h * error_rate)
    a = x.a_WT - 2 * cross(turning, error_rate) - cross(turning, cross(turning, error))
    a += c.slip_gain * x.slip
    approach = ca.dot(error_rate, normal)
    force = c.mass * (a - c.gravity) + x.contact_force + c.normal_damping * approach * normal
    force += c.position_gain * (error - (1 - c.hold) * ca.dot(error, normal) * normal)
    force += c.velocity_gain * (error_rate - approach * normal)
    return ca.vertcat(torque, force)


def tip_constants(body: RigidBody, parts: ScenePlant, hold: float) -> list[float]:
    """`CONSTANT` of a tip, with gains limited to what is stable for its mass or least inertia."""
    config, h, mass = parts.config, parts.plant.time_step(), body.default_mass()
    inertia = body.default_spatial_inertia().CalcRotationalInertia().CopyToFullMatrix3()
    least = float(np.linalg.eigvalsh(inertia)[0])

    # for each of GAINS: the mass or inertia that it acts on, its share, and its power of h
    terms = (mass, STIFF, 2), *[(mass, SHARE, 1)] * 2, (least, SHARE, 1)
    limits = [share * inert / h**order if h else math.inf for inert, share, order in terms]
    gains = [min(getattr(config, name), most) for name, most in zip(GAINS, limits)]
    gains.append(min(config.slip_gain, SLIP_SHARE / h if h else math.inf))
    return [h, mass, *inertia.ravel(), *gravity_on(parts.plant, body), *gains, hold]
