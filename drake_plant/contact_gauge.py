r"""One contact measured: where it is, its slip and its forces, from what Drake says of two bodies.

Slip depends on the point of a hydroelastic patch at which the velocities of the bodies are
compared: a fingertip that spins at 35 rad/s changes its tangential velocity by 0.35 mm/s every 10
um along the normal. What is zero while a finger rolls is friction, which acts on every face along
that face. The edge of a curved patch lies lower than its middle, which changes the velocity there,
and its faces are tilted, which changes it back. So the mean over the faces, each along itself, is
the velocity at the object's surface above the middle of the patch (exactly on spheres; else it
differs by spin times depth/6 times the difference between the principal directions of k2/(k1 +
k2), where k1 and k2 are the bodies' curvatures). Measured on a sphere of 0.04 on one of 0.1, 58
faces, 0.2 mm deep, spinning at 35 rad/s, 30 random orientations: velocity read where the friction
on the patch is zero [mm/s], steps of 0.1 ms

==========================================  ===============
at the centroid of area                     -0.90 +- 0.13
at the centre of pressure                   -0.65 +- 0.13
at the object's surface                     +0.09 +- 0.13
mean over faces, each along itself          +0.06 +- 0.13
==========================================  ===============

so velocities are compared at the object's surface: that needs no face, only the poses of the two
bodies. The rest is the facets of the meshes. If the object of a user's plant is compliant too, the
patch lies between the two surfaces, by how stiff they are, and slip is taken there.

A discrete step solves for forces that act where its end brings the bodies. In fast rolling that is
further along the curve than the patch from which the step starts (1 mm at 1 m/s and 1 ms), and the
normal is another one: with the patch's own, 10 mN of a normal force of 1 N would be taken as
friction. So the normal is taken at the centre of pressure, which the torque of the contact force
tells. Slip is read at the poses from which the step starts, as the velocities that it solves for
make contacts stick or slide there. At the poses of its end the same velocities would be up to 8
mm/s of slip in D3, whose object turns, where Drake's own point contact has 1e-4 mm/s.
"""

from __future__ import annotations

import math
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_system import Scene
from contact_system.contact_sensor import ON_OBJECT, SLIP, STATES, VELOCITY, ContactSensor
from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table
from contact_system.theory.symbols import per_structure

from .scratch import FingerTables, named

Array = NDArray[np.float64]

TINY = sys.float_info.min
TOLERANCE = 1e-7
"""Of the places of contacts, over the size of the bodies."""
COLUMNS = {
    "slip": slice(0, 2),
    "normal_force": slice(2, 3),
    "tangential_force": slice(3, 5),
    "state": slice(5, 14),
    "contact_point": slice(14, 17),
}
"""Of what is measured; the first three where the step that ended now began."""
NUMBERS = 17
NOTHING = np.zeros(3).data
SEEN = {"X_WO": 12, "V_WO": 6, "X_WF": 12, "V_WF": 6, "point": 3, "force": 3, "torque": 3}
"""What is seen of a contact: bodies, the point C where it acts, the force on the finger, and its
torque about C, in the world."""
PRESSED = {"at": 3, "E2": 9, "K2": 4, "K1": 4, "gap": 1, "velocity": 3}
PRESSED |= {"point": 3, "force": 3, "torque": 3, "X_OF": 12, "bends": 1}
"""What is known of a contact that presses: what a probe finds from the object's point on; the point
C, force and torque about it in O where the step began; the finger's pose now; how much of the
contact bends with the finger."""


class ContactGauges:
    """Measures the contacts of a scene, step by step; one thread at a time.

    Parameters
    ----------
    scene : Scene
    step : float
        Of the discrete plant, s; 0 where all is of now.
    """

    def __init__(self, scene: Scene, step: float):
        self._probes = ContactSensor(scene, TOLERANCE).probes
        steps = [[step]] * len(self._probes)
        self._motions = FingerTables(_motion(), SEEN, steps)
        self._forces = FingerTables(_forces(), PRESSED, steps)
        self._result = np.zeros((len(steps), NUMBERS))
        x = self._motions.x
        self._acting = [*zip(x["point"], x["force"], x["torque"])]
        rows: Any = zip(
            (probe.seen for probe in self._probes),
            (probe.found for probe in self._probes),
            *(self._motions.results, self._forces.points, self._forces.results, self._result),
        )
        self._numbers = [[numbers.data for numbers in row] for row in rows]

    def look(self, X_W: Any, V_W: Any, obj: int, fingers: list[int]) -> None:
        """Note where the bodies are, and how they move, as Drake lists them; nothing touches."""
        self._motions.put(X_W, V_W, obj, fingers)
        # of each contact the sizes of all forces, share, and how much bends
        self._told = [(0.0, 0.0, 0.0)] * len(self._probes)

    def touch(
        self, i: int, share: float, bends: float, p_WC: Array, force: Array, torque: Array | float
    ) -> None:
        """Add a patch or point of a contact; C is the mean of all, weighted by the sizes of their
        forces.

        share : where between the surfaces of object (0) and finger (1) slip is taken
        bends : how much of the contact bends with the finger's
        force, torque : on the finger, about C, in the world
        """
        (at, total, turning), (pressing, taken, bent) = self._acting[i], self._told[i]
        size = math.hypot(*force.tolist()) + TINY  # two that do not press count alike
        part = size / (pressing + size)
        if part == 1.0:
            at[:], total[:], turning[:] = p_WC, force, torque
        else:
            to_C = part * (p_WC - at)
            arms = np.array([-to_C, p_WC - at - to_C])
            turning += np.cross(arms, [total, force]).sum(0) + torque
            at += to_C
            total += force
        shares = taken + part * (share - taken), bent + part * (bends - bent)
        self._told[i] = pressing + size, *shares

    def measure(self) -> Array:
        """Slip, normal force, tangential force in E2, state, contact point in O: (n, 17)."""
        self._motions.run()
        for probe, told, numbers in zip(self._probes, self._told, self._numbers):
            (pressing, share, bends), (seen, found, moved, given, _, result) = told, numbers
            # slip and forces, where the step that ended now began
            seen[:18], seen[18], seen[19] = moved[:18], share, 0.0
            if pressing:
                probe.find(moved[21:24], moved[18:21])
            else:
                probe.find(probe.approach())
            given[:24], given[24:45], given[45] = found[ON_OBJECT.start :], moved[21:42], bends
            if not math.isfinite(sum(found[VELOCITY])):  # at a pole it is not known where it goes
                given[21:24] = NOTHING
            result[:2] = found[SLIP]
        self._forces.run()
        for probe, told, numbers in zip(self._probes, self._told, self._numbers):
            seen, found, moved, _, forces, result = numbers
            result[2:5] = forces[:3] if told[0] else NOTHING
            # where the contact is now, with the slip of the step
            seen[:18], seen[18], seen[19], seen[20:] = moved[30:48], 0.0, 1.0, result[:2]
            probe.find(forces[3:6], forces[6:9])
            result[5:14], result[14:17] = found[STATES], found[ON_OBJECT]
        return self._result


@per_structure
def _motion() -> Table:
    """`SEEN`; a step -> X_OF (12), V_OF_O (6), C in F, C in O, force and torque in O, where the
    step that ended now began, and X_OF, V_OF_O of now, (48).

    The bodies came from there as a discrete plant moves them, with the velocities they have.
    """
    (row, x), step = named(SEEN), ca.SX.sym("step")
    found = ca.vertcat(_in_object(x, -step), _in_object(x, ca.SX(0))[:18])
    return Table(ca.Function("motion", [row, step], [ca.densify(found)]))


def _in_object(x: SimpleNamespace, later: ca.SX) -> ca.SX:
    R_WO, p_WO = _moved(x.R_WO, x.p_WO, x.w_WO, x.v_WO, later)
    R_WF, p_WF = _moved(x.R_WF, x.p_WF, x.w_WF, x.v_WF, later)
    R_OW, p_OF_W, w_OF_W = R_WO.T, p_WF - p_WO, x.w_WF - x.w_WO
    v_OF_W = x.v_WF - x.v_WO - ca.cross(x.w_WO, p_OF_W)
    X_OF, p_FC = R_OW @ ca.horzcat(R_WF, p_OF_W), R_WF.T @ (x.point - p_WF)
    vectors = R_OW @ ca.horzcat(w_OF_W, v_OF_W, x.point - p_WO, x.force, x.torque)
    V_OF, contact = ca.vertsplit(ca.vec(vectors), [0, 6, 15])
    return ca.vertcat(ca.vec(X_OF.T), V_OF, p_FC, contact)


def _moved(R: ca.SX, p: ca.SX, w: ca.SX, v: ca.SX, later: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rotation and position after a step of Drake's, whose quaternions turn by Cayley's map."""
    a = ca.skew(later / 2 * w)
    turn = ca.SX.eye(3) + 2 * (a + a @ a) / (1 + later**2 / 4 * ca.sumsqr(w))
    return turn @ R, p + later * v


@per_structure
def _forces() -> Table:
    """`PRESSED`; a step -> normal force and tangential force in E2 (3), and where the contact point
    goes in that step, in O and in F.

    The normal is that at the centre of pressure, to first order.
    """
    (row, x), step = named(PRESSED), ca.SX.sym("step")
    E2, K2, K1 = ca.reshape(x.E2, 3, 3), ca.reshape(x.K2, 2, 2), ca.reshape(x.K1, 2, 2)
    arm, force, torque = (E2.T @ v for v in (x.point - x.at, x.force, x.torque))
    curvature = K2 - x.bends * (K2 + K1)
    # a force along n at r from where the torque is taken has the torque r x n
    pressing = ca.fmax(force[2], TINY)
    offset = ca.if_else(force[2] > 0, ca.vertcat(-torque[1], torque[0]) / pressing, 0)
    tilt = curvature @ (arm[:2] + offset)
    normal = force[2] + ca.dot(tilt, force[:2])
    ahead = x.at + step * x.velocity
    in_finger = x.R_OF.T @ (ahead - x.p_OF)
    found = ca.vertcat(normal, force[:2] - normal * tilt, ahead, in_finger)
    return Table(ca.Function("forces", [row, step], [ca.densify(found)]))
