r"""The law at a fingertip, free or on joints: the wrench that moves it as wanted.

About the tip's origin it is what mass and inertia need for the wanted motion, the contact force at
the contact point, tracking of place and spin, and an acceleration of -lam times the slip that is
really there, which is the paper's own term.

Free tips and tips on joints differ in what is wanted, and in ``hold``. A free tip follows the
object wherever it is measured to be, and along the normal it has a damper alone, so that the
contact decides how far the finger sinks in: ``hold = 0``. If all did so on a hand nothing would
keep the object in its place. Tips on joints hold it: what they want stays in the world, and the
spring acts along the normal too, ``hold = 1``.

In a discrete plant (semi-implicit Euler, step h) a velocity at t_k moved the body from t_{k-1} to
t_k, so the velocity to track is that of half a step ago; the object's, which is measured, is that
already. The error lives in a frame that turns with the contact normal at Omega = n x n'.
docs/drake-contact.md says what each term is worth.
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
from .scratch import named, slices

SHARE, STIFF = 0.4, 0.1
"""Of a velocity what an explicit damper may take in a step h, of an error what an explicit spring
may take over h; a damper's d and a spring's s are stable where 0 < d and s + 2 d < 4. The object
moves, too: one as light as its fingers turns with them, and a spring of 0.4 shakes both."""

SLIP_SHARE = 0.8
"""Of slip what may be taken away in a step: more would turn it over where friction helps."""

TIP = {"X_WF": 12, "V_WF": 6, "contact_force": 3}
"""What is true of a tip: its pose, row by row, its velocity, the angular part first, and the force
that it shall exert on the object."""
WANTED = {"p_WT": 3, "V_WT": 6, "A_WT": 6, "normal": 3, "turning": 3, "arm": 3}
"""The tip as it should be, T: its place, velocity and acceleration, the contact's normal, how fast
that turns, and the contact point from the tip's origin."""
CONSTANT = {"h": 1, "mass": 1, "inertia": 9, "gravity": 3}
CONSTANT |= dict.fromkeys((*GAINS, "slip_gain", "hold"), 1)
POINT = {"X_WO": 12, "V_WO": 6, "A_WO": 6, **TIP, "motion": sum(MOTION.values())}
POINT |= {"sliding": 3, "push": 3, "normal_force": 1}
"""What a step's law is made of."""
HELD = {**TIP, "slip": 3, **WANTED}
"""What the law of a tip on joints is made of."""


@per_structure
def driving_law() -> Table:
    """Table of one finger: `POINT`, `CONSTANT` -> torque (3), force (3), in the world."""
    point, x = named(POINT)
    constant, c = named(CONSTANT)
    plan = {name: x.motion[part] for name, part in slices(MOTION).items()}
    x.R_OF, x.p_OF = ca.reshape(plan["pose"][:9], 3, 3), plan["pose"][9:]
    x.w_OF, x.v_OF = ca.vertsplit(plan["twist"], 3)
    x.alpha_OF, x.a_OF = ca.vertsplit(plan["acceleration"], 3)
    _want(x, plan["normal"], plan["normal_rate"], c.h)
    x.arm, x.slip = x.R_WT @ plan["contact_point"][:3], x.R_WO @ x.sliding
    x.contact_force -= x.normal_force * x.normal
    wrench = tip_wrench(x, c) + ca.vertcat(0, 0, 0, x.push)
    return Table(ca.Function("driving", [point, constant], [ca.densify(wrench)]))


def _want(x: SimpleNamespace, normal: ca.SX, normal_rate: ca.SX, h: ca.SX) -> None:
    """Add the plan carried by the object, in the world, as a discrete plant needs it: `WANTED`."""
    cross = ca.cross
    off, v, spin = x.R_WO @ x.p_OF, x.R_WO @ x.v_OF, x.R_WO @ x.w_OF
    swept = cross(x.w_WO, off)
    bend = cross(x.w_WO, swept + 2 * v) + x.R_WO @ x.a_OF
    turn = cross(x.w_WO, spin) + x.R_WO @ x.alpha_OF
    x.p_WT, x.R_WT = x.p_WO + off, x.R_WO @ x.R_OF
    x.v_WT, x.w_WT = x.v_WO + swept + v - 0.5 * h * bend, x.w_WO + spin - 0.5 * h * turn
    x.a_WT, x.alpha_WT = x.a_WO + cross(x.alpha_WO, off) + bend, x.alpha_WO + turn
    x.normal = x.R_WO @ normal
    x.turning = x.R_WO @ cross(normal, normal_rate) + x.w_WO - ca.dot(x.w_WO, x.normal) * x.normal


@per_structure
def holding_law() -> Table:
    """Table of one tip on joints: `HELD`, `CONSTANT` -> torque (3), force (3), in the world."""
    point, x = named(HELD)
    constant, c = named(CONSTANT)
    return Table(ca.Function("holding", [point, constant], [ca.densify(tip_wrench(x, c))]))


def tip_wrench(x: SimpleNamespace, c: SimpleNamespace) -> ca.SX:
    """Torque and force on a tip about its origin, in the world as all that they are made of.

    x : `HELD`; slip is v_rel (minus the tip's velocity on the object) where it is to be rejected
    c : `CONSTANT`
    """
    return ca.vertcat(_torque(x, c), _force(x, c))


def _force(x: SimpleNamespace, c: SimpleNamespace) -> ca.SX:
    """Feed-forward, contact, slip, tracking in the frame that turns with the contact."""
    cross, normal, turning = ca.cross, x.normal, x.turning
    error, error_rate = x.p_WT - x.p_WF, x.v_WT - x.v_WF
    # The velocities are those of half a step ago, so the error has to be too.
    error_rate -= cross(turning, error - 0.5 * c.h * error_rate)
    a = x.a_WT - 2 * cross(turning, error_rate) - cross(turning, cross(turning, error))
    a += c.slip_gain * x.slip
    approach = ca.dot(error_rate, normal)
    force = c.mass * (a - c.gravity) + x.contact_force + c.normal_damping * approach * normal
    force += c.position_gain * (error - (1 - c.hold) * ca.dot(error, normal) * normal)
    return force + c.velocity_gain * (error_rate - approach * normal)


def _torque(x: SimpleNamespace, c: SimpleNamespace) -> ca.SX:
    """Feed-forward, the contact force through the contact point, damping of spin."""
    inertia, w = x.R_WF @ ca.reshape(c.inertia, 3, 3) @ x.R_WF.T, x.w_WT
    torque = inertia @ x.alpha_WT + ca.cross(w, inertia @ w) + c.spin_gain * (w - x.w_WF)
    return torque + ca.cross(x.arm, x.contact_force)


def tip_constants(body: RigidBody, parts: ScenePlant, hold: float) -> list[float]:
    """`CONSTANT` of a tip; of each gain so much as its mass, or least inertia, bears."""
    config, h, mass = parts.config, parts.plant.time_step(), body.default_mass()
    inertia = body.default_spatial_inertia().CalcRotationalInertia().CopyToFullMatrix3()
    least = float(np.linalg.eigvalsh(inertia)[0])

    # of each gain, what it moves, how much is borne, and to which power the step divides that
    moved = (mass, STIFF, 2), *[(mass, SHARE, 1)] * 2, (least, SHARE, 1)
    borne = [share * inert / h**order if h else math.inf for inert, share, order in moved]
    gains = [min(getattr(config, name), most) for name, most in zip(GAINS, borne)]
    gains.append(min(config.slip_gain, SLIP_SHARE / h if h else math.inf))
    return [h, mass, *inertia.ravel(), *gravity_on(parts.plant, body), *gains, hold]
