r"""The law at a fingertip, free or on joints: the wrench that moves it as wanted.

About the tip's origin it is what mass and inertia need for the wanted motion, the contact force at
the contact point, tracking of place and turn, and an acceleration of -lam times the slip that is
really there, which is the paper's own term.

Free tips and tips on joints differ in what is wanted, and in ``hold``. A free tip follows the
object wherever it is measured to be, and along the normal it has a damper alone, so that the
contact decides how far the finger sinks in: ``hold = 0``. If all did so on a hand nothing would
keep the object in its place. Tips on joints hold it: what they want stays in the world, and the
spring acts along the normal too, ``hold = 1``.
"""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
from pydrake.multibody.tree import RigidBody

from contact_system.theory import symbols as ca

from .config import GAINS
from .plant import ScenePlant, gravity_on

SHARE = 0.4
"""Of a velocity what an explicit damper may take in a step h, of an error what an explicit spring
may take over h; a damper's d and a spring's s are stable where 0 < d and s + 2 d < 4."""

SLIP_SHARE = 0.8
"""Of slip what may be taken away in a step: more would turn it over where friction helps."""

TIP = {"X_WF": 12, "V_WF": 6, "contact_force": 3}
"""What is true of a tip: its pose, row by row, its velocity, the angular part first, and the force
that it shall exert on the object."""
WANTED = {"X_WT": 12, "V_WT": 6, "A_WT": 6, "normal": 3, "turning": 3, "arm": 3}
"""The tip as it should be, T: its pose, velocity and acceleration, the contact's normal, how fast
that turns, and the contact point from the tip's origin."""
CONSTANT = {"h": 1, "mass": 1, "inertia": 9, "gravity": 3}
CONSTANT |= dict.fromkeys((*GAINS, "slip_gain", "hold"), 1)


def tip_wrench(x: SimpleNamespace, wanted: SimpleNamespace, c: SimpleNamespace) -> ca.SX:
    """Torque and force on a tip about its origin, in the world as all that they are made of.

    x : `TIP`, and slip, v_rel (minus the tip's velocity on the object) where it is to be rejected
    wanted : `WANTED`
    c : `CONSTANT`
    """
    return ca.vertcat(_torque(x, wanted, c), _force(x, wanted, c))


def _force(x: SimpleNamespace, wanted: SimpleNamespace, c: SimpleNamespace) -> ca.SX:
    """Feed-forward, contact, slip, tracking in the frame that turns with the contact."""
    cross, normal, turning = ca.cross, wanted.normal, wanted.turning
    error, error_rate = wanted.p_WT - x.p_WF, wanted.v_WT - x.v_WF
    # The velocities are those of half a step ago, so the error has to be too.
    error_rate -= cross(turning, error - 0.5 * c.h * error_rate)
    a = wanted.a_WT - 2 * cross(turning, error_rate) - cross(turning, cross(turning, error))
    a += c.slip_gain * x.slip
    approach = ca.dot(error_rate, normal)
    force = c.mass * (a - c.gravity) + x.contact_force + c.normal_damping * approach * normal
    force += c.position_gain * (error - (1 - c.hold) * ca.dot(error, normal) * normal)
    return force + c.velocity_gain * (error_rate - approach * normal)


def _torque(x: SimpleNamespace, wanted: SimpleNamespace, c: SimpleNamespace) -> ca.SX:
    """Feed-forward, the contact force through the contact point, tracking of turn and spin."""
    inertia, w = x.R_WF @ ca.reshape(c.inertia, 3, 3) @ x.R_WF.T, wanted.w_WT
    off = wanted.R_WT @ x.R_WF.T
    axis = 0.5 * ca.vertcat(off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1])
    torque = inertia @ wanted.alpha_WT + ca.cross(w, inertia @ w)
    torque += c.spin_gain * (w - x.w_WF) + c.rotation_gain * axis
    return torque + ca.cross(wanted.arm, x.contact_force)


def tip_constants(body: RigidBody, parts: ScenePlant, hold: float) -> list[float]:
    """`CONSTANT` of a tip; of each gain so much as its mass, or least inertia, bears."""
    config, h, mass = parts.config, parts.plant.time_step(), body.default_mass()
    inertia = body.default_spatial_inertia().CalcRotationalInertia().CopyToFullMatrix3()
    least = float(np.linalg.eigvalsh(inertia)[0])

    # of each gain, what it moves and to which power the step divides what is borne
    moved = ((mass, 2), (mass, 1), (mass, 1), (least, 2), (least, 1))
    borne = [SHARE * inert / h**order if h else math.inf for inert, order in moved]
    gains = [min(getattr(config, name), most) for name, most in zip(GAINS, borne)]
    gains.append(min(config.slip_gain, SLIP_SHARE / h if h else math.inf))
    return [h, mass, *inertia.ravel(), *gravity_on(parts.plant, body), *gains, hold]
