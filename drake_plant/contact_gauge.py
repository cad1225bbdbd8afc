r"""One contact measured: where it is, its slip and its forces, from what Drake says of two bodies.

Slip of a hydroelastic patch is the velocity at one point less its normal part, and the point
decides: a fingertip that spins at 35 rad/s changes its tangential velocity by 0.35 mm/s every 10 um
along the normal. Friction acts on every face along that face. Summed over a patch that follows the
surface of the rigid object, with principal curvatures k and pressure falling off as a paraboloid,
what the drop of the surface takes from the velocity is given back by the tilt of the faces, so that
the mean is the velocity at the object's surface above the middle of the patch (but for
spin times depth/6 times the difference between the two principal directions of k2/(k1 + k2), which
is 0 on spheres).
Measured on a sphere of 0.04 on one of 0.1, 58 faces, 0.2 mm deep, spinning at 35 rad/s, 30 random
orientations: velocity read where the friction on the patch is zero [mm/s], steps of 0.1 ms

==========================================  ===============
at the centroid of area                     -0.90 +- 0.13
at the centre of pressure                   -0.65 +- 0.13
at the object's surface                     +0.09 +- 0.13
mean over faces, each along itself          +0.06 +- 0.13
==========================================  ===============

so the third is what is used: it needs no face, only the poses of the two bodies. The rest is the
facets of the meshes. In a plant of somebody's own the object may be compliant too: then the patch
lies between the two surfaces, by how stiff they are, and slip is taken there.

A discrete step solves for forces that act where its end brings the bodies, in fast rolling further
along the curve than the patch it starts from (1 mm at 1 m/s and 1 ms). The normal is another one
there: 10 mN of a normal force of 1 N would be taken as friction. The torque of the contact force
tells the centre of pressure, and the normal there is the right one. The velocities it solves for
make contacts stick or slide at the poses from which it starts, so that is where slip is read: at
the poses of the step's end the same velocities would give up to 8 mm/s of slip in D3, on an object
that turns, where Drake's own point contact has 1e-4 mm/s.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_system.contact_sensor import Probe
from contact_system.engine.binding import Machine
from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table
from contact_system.theory.symbols import per_structure

Array = NDArray[np.float64]

TINY = np.finfo(float).tiny
COLUMNS = {
    "slip": slice(0, 2),
    "normal_force": slice(2, 3),
    "tangential_force": slice(3, 5),
    "state": slice(5, 14),
    "contact_point": slice(14, 17),
}
"""Of what a gauge measures; the first three where the step that ended now began."""
NUMBERS = 17
NOTHING = np.zeros(3).data


class ContactGauge:
    """Measures one contact, step by step; one thread at a time.

    Parameters
    ----------
    probe : Probe
    step : float
        Of the discrete plant, s; 0 where all is of now.

    Attributes
    ----------
    pressing : float
        The sizes of all forces, 0 without contact.
    """

    def __init__(self, probe: Probe, step: float):
        self._probe = probe
        self._moving, self._splitting = Machine(_motion(), [step]), Machine(_forces(), [step])
        row = self._moving.point
        self._places = row[:12].reshape(3, 4), row[12:18], row[18:30].reshape(3, 4), row[30:36]
        self._contact, self._at = row[36:45], (row[36:39], row[39:42], row[42:45])
        self._result = np.zeros(NUMBERS)
        tables = self._moving.results, self._splitting.point, self._splitting.results
        every = [probe.seen, probe.found, *tables, self._result]
        self._numbers: list[Any] = [numbers.data for numbers in every]
        self.pressing = self._share = self._bends = 0.0

    def look(self, X_WO: Array, V_WO: Array, X_WF: Array, V_WF: Array) -> None:
        """Note where object and finger are, (3, 4), and how they move, (6,); nothing touches."""
        for place, seen in zip(self._places, (X_WO, V_WO, X_WF, V_WF)):
            place[:] = seen
        self._contact[:] = 0.0
        self.pressing = self._share = self._bends = 0.0

    def touch(
        self, share: float, bends: float, p_WC: Array, force: Array, torque: Array | float
    ) -> None:
        """Add one patch or point; C is the mean of all, weighted by the sizes of their forces.

        share : where between the surfaces of object (0) and finger (1) slip is taken
        bends : how much of the contact bends with the finger's
        force, torque : on the finger, about C, in the world
        """
        at, total, turning = self._at
        size = math.hypot(*force.tolist()) + TINY  # two that do not press count alike
        part = size / (self.pressing + size)
        if part == 1.0:
            at[:], total[:], turning[:] = p_WC, force, torque
        else:
            to_C = part * (p_WC - at)
            arms = np.array([-to_C, p_WC - at - to_C])
            turning += np.cross(arms, [total, force]).sum(0) + torque
            at += to_C
            total += force
        self._share += part * (share - self._share)
        self._bends += part * (bends - self._bends)
        self.pressing += size

    def measure(self) -> Array:
        """Slip, normal force, tangential force in E2, state, contact point in O: (17,)."""
        probe = self._probe
        seen, found, moved, given, forces, result = self._numbers
        self._moving.run()
        # slip and forces, where the step that ended now began
        seen[:18] = moved[:18]
        seen[18], seen[19] = self._share, 0.0
        if self.pressing:
            probe.find(moved[21:24], moved[18:21])
        else:
            probe.find(probe.approach())
        given[:24], given[24:45], given[45] = found[16:40], moved[21:42], self._bends
        if not math.isfinite(sum(found[37:40])):  # at a pole it is not known where the contact goes
            given[21:24] = NOTHING
        self._splitting.run()
        result[:2], result[2:5] = found[11:13], forces[:3] if self.pressing else NOTHING
        # where the contact is now, with the slip of the step
        seen[:18] = moved[30:48]
        seen[18], seen[19], seen[20:] = 0.0, 1.0, result[:2]
        probe.find(forces[3:6], forces[6:9])
        result[5:14], result[14:17] = found[2:11], found[16:19]
        return self._result


@per_structure
def _motion() -> Table:
    """X_WO (12, row by row), V_WO (6), X_WF (12), V_WF (6), the point C of the contact, force on
    the finger and its torque about C, (45); a step -> X_OF (12), V_OF_O (6), C in F, C in O, force
    and torque, where the step that ended now began, and X_OF, V_OF_O of now, (48).

    The bodies came from there as a discrete plant moves them, with the velocities they have.
    """
    row, step = ca.SX.sym("row", 45), ca.SX.sym("step")
    found = ca.vertcat(_in_object(row, -step), _in_object(row, ca.SX(0))[:18])
    return Table(ca.Function("motion", [row, step], [ca.densify(found)]))


def _in_object(row: ca.SX, later: ca.SX) -> ca.SX:
    V_WO, V_WF = row[12:18], row[30:36]
    R_WO, p_WO = _moved(row[:12], V_WO, later)
    R_WF, p_WF = _moved(row[18:30], V_WF, later)
    R_OW, p_OF_W = R_WO.T, p_WF - p_WO
    v_OF_W = V_WF[3:] - V_WO[3:] - ca.cross(V_WO[:3], p_OF_W)
    X_OF, V_OF = R_OW @ ca.horzcat(R_WF, p_OF_W), ca.vertcat(V_WF[:3] - V_WO[:3], v_OF_W)
    p_FC = R_WF.T @ (row[36:39] - p_WF)
    vectors = ca.horzcat(V_OF[:3], V_OF[3:], row[36:39] - p_WO, row[39:42], row[42:45])
    V_OF, contact = ca.vertsplit(ca.vec(R_OW @ vectors), [0, 6, 15])
    return ca.vertcat(ca.vec(X_OF.T), V_OF, p_FC, contact)


def _moved(X: ca.SX, V: ca.SX, later: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rotation and position after a step of Drake's, whose quaternions turn by Cayley's map."""
    rows = ca.reshape(X, 4, 3).T
    a = ca.skew(later / 2 * V[:3])
    turn = ca.SX.eye(3) + 2 * (a + a @ a) / (1 + later**2 / 4 * ca.sumsqr(V[:3]))
    return turn @ rows[:, :3], rows[:, 3] + later * V[3:]


@per_structure
def _forces() -> Table:
    """x_2, E2, K_2, K_1 (20), gap, velocity of the contact point, C, force, torque, X_OF of now
    (12), how much of the contact bends with the finger; a step -> normal force and tangential force
    in E2 (3), and where the contact point goes in that step, in O and in F.

    The normal is that at the centre of pressure, to first order.
    """
    row, step = ca.SX.sym("row", 46), ca.SX.sym("step")
    E2, K2, K1 = (ca.reshape(row[a:b], n, n) for a, b, n in ((3, 12, 3), (12, 16, 2), (16, 20, 2)))
    arm, force, torque = (E2.T @ v for v in (row[24:27] - row[:3], row[27:30], row[30:33]))
    curvature = K2 - row[45] * (K2 + K1)
    # a force along n at r from where the torque is taken has the torque r x n
    pressing = ca.fmax(force[2], TINY)
    offset = ca.if_else(force[2] > 0, ca.vertcat(-torque[1], torque[0]) / pressing, 0)
    tilt = curvature @ (arm[:2] + offset)
    normal = force[2] + ca.dot(tilt, force[:2])
    X_OF, ahead = ca.reshape(row[33:45], 4, 3).T, row[:3] + step * row[21:24]
    in_finger = X_OF[:, :3].T @ (ahead - X_OF[:, 3])
    found = ca.vertcat(normal, force[:2] - normal * tilt, ahead, in_finger)
    return Table(ca.Function("forces", [row, step], [ca.densify(found)]))
