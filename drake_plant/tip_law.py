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
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import RigidBody

from contact_system.engine.binding import Machine
from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table

from .config import GAINS
from .plant import ScenePlant, gravity_on

Array = NDArray[np.float64]
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


def split(numbers: ca.SX, sizes: dict[str, int]) -> dict[str, ca.SX]:
    """Parts of so many numbers each, by their names."""
    return dict(zip(sizes, ca.vertsplit(numbers, np.cumsum([0, *sizes.values()]).tolist())))


def halves(motion: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Angular and linear part."""
    return motion[:3], motion[3:]


def named(sizes: dict[str, int]) -> tuple[ca.SX, SimpleNamespace]:
    """Symbols by their names; of a pose X R and p, of a velocity V w and v, of A alpha and a."""
    every = ca.SX.sym("x", sum(sizes.values()))
    found = split(every, sizes)
    for name, value in list(found.items()):
        if name[0] == "X":
            rows = ca.reshape(value, 4, 3).T
            found |= {f"R{name[1:]}": rows[:, :3], f"p{name[1:]}": rows[:, 3]}
        elif name[0] in "VA":
            names = ("w", "v") if name[0] == "V" else ("alpha", "a")
            found |= {f"{own}{name[1:]}": half for own, half in zip(names, halves(value))}
    return every, SimpleNamespace(**found)


class TipLaws:
    """A law run for several tips, one after the other, for one thread.

    x : what it takes by name, a row a tip, poses (n, 3, 4)
    results : (n, n_out)
    """

    def __init__(self, table: Table, sizes: dict[str, int], constants: Sequence[list[float]]):
        registers = np.zeros((len(constants), table.n_regs))
        self._machines = [Machine(table, *each) for each in zip(constants, registers)]
        points = registers[:, : table.n_in]
        self.x: dict[str, Array] = {}
        for name, part in zip(sizes, np.split(points, np.cumsum([*sizes.values()])[:-1], axis=1)):
            self.x[name] = part.reshape(-1, 3, 4) if name[0] == "X" else part
        self.results = registers[:, table.first_out :][:, : table.n_out]

    def run(self) -> None:
        for machine in self._machines:
            machine.run()
