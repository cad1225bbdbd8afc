r"""What contact physics makes of a plan: slip, forces and contact coordinates, measured.

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
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import ContactSurface, PenetrationAsPointPair
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from contact_system import Plane, Scene, SceneError, Surface
from contact_system.contact_sensor import ContactSensor
from contact_system.engine.binding import run
from contact_system.scene import require_scene
from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table
from contact_system.theory.symbols import per_structure

from .config import require_config
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plant import ScenePlant

Array = NDArray[np.float64]

# Bodies planned on the radii that they roll on meet there. A plane has no radius: there it is where
# the planned finger's surface is.
AT_FINGER = 1.0
# Of the places of contacts, over the size of the bodies.
TOLERANCE = 1e-7
TINY = np.finfo(float).tiny
SATURATED = 0.95
"""Friction counts as saturated from this part of mu N on: facets let N itself ripple."""

# Columns of what is kept of each contact, of where the step that ended now began, and of now.
SLIP, NORMAL, TANGENTIAL, POINT, VELOCITY = map(slice, (0, 2, 3, 5, 8), (2, 3, 5, 8, 11))
STATE, POINT_NOW = slice(0, 9), slice(9, 12)
SEEN = 48  # of what Drake says


class ContactMonitor(LeafSystem):
    """Contact results and motion of the bodies to what each contact does.

    .. pydrake_system::

        name: ContactMonitor
        input_ports:
        - contact_results
        - body_poses
        - body_spatial_velocities
        - noise (optional)
        output_ports:
        - state
        - slip
        - normal_force
        - tangential_force
        - contact_point
        - sliding

    The first three inputs are the plant's; `noise` (9n) is added to `state`, and so to `sliding`,
    which follows from it. Of a discrete plant slip and forces are those of the step that ended
    now, state and contact point are those now. Without sampled output ports Drake reports the step
    that begins instead: all are those of now, as in a continuous plant. Of the outputs, n contacts
    in the scene's order and SI units,

    * `state` (9n) holds u1 v1 du1 dv1 u2 v2 du2 dv2 psi in principal values, for the planner's
      `measured_state`; its rates fulfil ``R_psi M1 q1' - M2 q2' = v_rel`` with the measured slip;
    * `slip` (2n) is v_rel in E2, minus the velocity of the finger's material point relative to the
      object's (theory section 2);
    * `normal_force` (n) is positive where the bodies press;
    * `tangential_force` (2n) acts on the finger, in E2;
    * `contact_point` (3n) is where the line normal to both surfaces meets the object's, in O;
    * `sliding` (3n) is v_rel of `state` as a vector in O where the contact slides, which shows in
      its friction: at 95 % of mu N or more. Zero elsewhere, so that noise moves no finger that
      rolls. mu is that of the plant's configuration.

    Where a finger touches the object with several patches or pairs of points, forces are those of
    their sum, taken along and across the normal at its centre of pressure.
    Without contact the forces are 0 and the others are those of the points nearest to each other.
    Bodies are taken to move in a step with the velocity at its end, as free ones do. Slip of those
    that swing on joints is off by a step times their centripetal acceleration at most.
    Where there is no contact frame (such as at a pole) what needs one is NaN: a planner that
    restarts then keeps its plan.

    Parameters
    ----------
    scene : Scene
        Its surfaces measure the coordinates. In a closed loop it is the planner's scene, so that
        planner and monitor read the same slip from the same rates.
    scene_plant : ScenePlant
        Finalized; the bodies' frames are their surfaces' own.

    Raises
    ------
    SceneError
        No scene, no ScenePlant, or one with another number of contacts than the other.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, scene: Scene, scene_plant: ScenePlant):
        super().__init__()
        require_scene(scene)
        require_config(scene_plant, ScenePlant, "scene_plant")
        n, fingers = len(scene.contacts), len(scene_plant.finger_bodies)
        if n != fingers:
            raise SceneError(
                f"{scene.title} has {n} contacts and scene_plant, of "
                f"{scene_plant.scene.title}, {fingers}: give the scene that it was made for, or "
                "rolling_scene of it"
            )
        self._sensor = ContactSensor(scene, TOLERANCE)
        self._bodies = _Bodies(scene, scene_plant)
        self._friction = scene_plant.config.friction
        plant = scene_plant.plant
        self._step = plant.time_step() if plant.has_sampled_output_ports() else 0.0
        self._results = self.DeclareAbstractInputPort("contact_results", Value[ContactResults]())
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        self._velocities = self.DeclareAbstractInputPort(
            "body_spatial_velocities", Value[list[SpatialVelocity]]()
        )
        self._noise = self.DeclareVectorInputPort("noise", 9 * n)
        inputs = [port.ticket() for port in (self._results, self._poses, self._velocities)]
        seen, self._seen = array_entry(self._CalcSeen, (n, SEEN), inputs)
        begun, self._begun = array_entry(self._CalcBegun, (n, 11), [seen])
        ended, self._ended = array_entry(self._CalcEnded, (n, 12), [seen, begun])
        measured = {ended, self._noise.ticket()}
        for name, size, entry, table, columns in (
            ("slip", 2, begun, self._begun, SLIP),
            ("normal_force", 1, begun, self._begun, NORMAL),
            ("tangential_force", 2, begun, self._begun, TANGENTIAL),
            ("contact_point", 3, ended, self._ended, POINT_NOW),
        ):
            calc = weakly(self._Copy, table, columns)
            self.DeclareVectorOutputPort(name, size * n, calc, {entry})
        for name, size, calc, needs in (
            ("state", 9, self._CalcState, measured),
            ("sliding", 3, self._CalcSliding, {begun, *measured}),
        ):
            self.DeclareVectorOutputPort(name, size * n, weakly(calc), needs)

    def _Copy(self, table: Callable, columns: slice, context: Context, output: BasicVector) -> None:
        output.SetFromVector(table(context)[:, columns].ravel())

    def _State(self, context: Context) -> Array:
        """What is measured now, with its noise: (n, 9)."""
        state = self._ended(context)[:, STATE]
        if not self._noise.HasValue(context):
            return state
        return state + self._noise.Eval(context).reshape(-1, 9)

    def _CalcState(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._State(context).ravel())

    def _CalcSliding(self, context: Context, output: BasicVector) -> None:
        begun = self._begun(context)
        normal, friction = begun[:, NORMAL.start], np.hypot(*begun[:, TANGENTIAL].T)
        found, scene = np.zeros((len(begun), 3)), self._sensor.scene
        slides = (friction >= SATURATED * self._friction * normal) & (normal > 0)
        for i in np.flatnonzero(slides).tolist():
            found[i] = _slip(scene.contacts[i].finger, scene.object, self._State(context)[i])
        output.SetFromVector(np.nan_to_num(found).ravel())  # no feedback at a pole

    def _CalcSeen(self, context: Context) -> Array:
        X_W, V_W = self._poses.Eval(context), self._velocities.Eval(context)
        return self._bodies.seen(X_W, V_W, self._results.Eval(context)).table

    def _CalcBegun(self, context: Context) -> Array:
        """Slip and forces, where the step that ended now began."""
        seen = _Seen(self._seen(context))
        moved, away = seen.in_object(-self._step), seen.touching == 0
        pose, twist, points = moved[:, :12], moved[:, 12:18], moved[:, 18:21]
        if away.any():
            points[away] = self._sensor.approach(pose, np.flatnonzero(away))
        found = self._sensor.measure(pose, twist, points, seen.between[:, 0])
        force = _split(np.hstack([found.surfaces, moved[:, 18:], seen.between[:, 1:]]))
        force[away] = 0.0  # with no frame either
        return np.hstack([found.slip, force, found.points[:, 1], found.velocity])

    def _CalcEnded(self, context: Context) -> Array:
        """Where the contacts are now, with the slip of the step."""
        begun, moved = self._begun(context), _Seen(self._seen(context)).in_object(0.0)
        # Where to begin to look; at a pole it is not known how fast the contact moves.
        points = begun[:, POINT] + self._step * np.nan_to_num(begun[:, VELOCITY])
        pose, twist, slip = moved[:, :12], moved[:, 12:18], begun[:, SLIP]
        found = self._sensor.measure(pose, twist, points, slip=slip)
        return np.hstack([found.states, found.points[:, 1]])


def _slip(finger: Surface, obj: Surface, state: Array) -> Array:
    """v_rel (eq. `netrelvel`) of the state of a contact (9,) as a vector in O, m/s."""
    u1, v1, *rates_1, u2, v2, du2, dv2, psi = state
    c, s = math.cos(psi), math.sin(psi)
    a1, a2 = finger.metric_root(u1, v1) @ rates_1, obj.metric_root(u2, v2) @ (du2, dv2)
    return obj.frame(u2, v2)[:, :2] @ (np.array([[c, -s], [-s, -c]]) @ a1 - a2)


class _Bodies:
    """The bodies' places in Drake's lists."""

    def __init__(self, scene: Scene, scene_plant: ScenePlant):
        plant, fingers = scene_plant.plant, scene_plant.finger_bodies
        flat = isinstance(scene.object, Plane)
        self.at_finger = [
            flat and rolling.finger != nominal.finger
            for rolling, nominal in zip(scene.contacts, scene_plant.scene.contacts)
        ]
        self.object = int(scene_plant.object_body.index())
        self.fingers = [int(body.index()) for body in fingers]
        self.contact_of_body = {index: i for i, index in enumerate(self.fingers)}
        self.contact_of_geometry = {
            geometry.get_value(): i
            for i, body in enumerate(fingers)
            for geometry in plant.GetCollisionGeometriesForBody(body)
        }
        # A plant of somebody's own may have other bodies that fingers touch.
        geometries = plant.GetCollisionGeometriesForBody(scene_plant.object_body)
        self.object_geometries = {geometry.get_value() for geometry in geometries}

    def seen(
        self, X_W: list[RigidTransform], V_W: list[SpatialVelocity], results: ContactResults
    ) -> _Seen:
        seen = _Seen(np.zeros((len(self.fingers), SEEN)))
        X_WO, row = X_W[self.object], seen.row
        row[:, :12] = X_WO.GetAsMatrix34().ravel()
        row[:, 12:18] = V_W[self.object].get_coeffs()
        for i, body in enumerate(self.fingers):
            row[i, 18:30] = X_W[body].GetAsMatrix34().ravel()
            row[i, 30:36] = V_W[body].get_coeffs()
        for k in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(k)
            patch, F_Ac_W = info.contact_surface(), info.F_Ac_W().get_coeffs()
            M, N = patch.id_M().get_value(), patch.id_N().get_value()
            if M in self.contact_of_geometry and N in self.object_geometries:
                # body A has geometry M
                i, share = self.contact_of_geometry[M], 1.0 - _share_of_M(patch)
                seen.touch(i, (share, share), patch.centroid(), F_Ac_W[3:], F_Ac_W[:3])
            elif N in self.contact_of_geometry and M in self.object_geometries:
                i, share = self.contact_of_geometry[N], _share_of_M(patch)
                seen.touch(i, (share, share), patch.centroid(), -F_Ac_W[3:], -F_Ac_W[:3])
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            A, B = int(info.bodyA_index()), int(info.bodyB_index())
            f_Bc_W, p_WC, pair = info.contact_force(), info.contact_point(), info.point_pair()
            if B in self.contact_of_body and A == self.object:
                i = self.contact_of_body[B]
                seen.touch(i, self.between(i, pair, pair.p_WCa, p_WC), p_WC, f_Bc_W, 0.0)
            elif A in self.contact_of_body and B == self.object:
                i = self.contact_of_body[A]
                seen.touch(i, self.between(i, pair, pair.p_WCb, p_WC), p_WC, -f_Bc_W, 0.0)
        return seen

    def between(
        self, i: int, pair: PenetrationAsPointPair, p_WO: Array, p_WC: Array
    ) -> tuple[float, float]:
        """Where Drake's point contact acts, for :meth:`_Seen.touch`; p_WO is on the object's
        surface. Midway in depth where both are equally stiff, else nearer to the stiffer's surface.
        """
        if self.at_finger[i]:
            return AT_FINGER, 0.0
        # a depth may be 0, or rounding alone
        return min(1.0, math.dist(p_WO, p_WC) / max(pair.depth, TINY)), 0.0


def _share_of_M(patch: ContactSurface) -> float:
    """How much of the depth geometry M gives way, 0 where it is rigid.

    From each surface to the patch pressure grows by that body's gradient, to the same at the patch.
    """
    if not patch.HasGradE_M():
        return 0.0
    if not patch.HasGradE_N():
        return 1.0
    face = patch.num_faces() // 2  # any
    in_M, in_N = (math.hypot(*g(face)) for g in (patch.EvaluateGradE_M_W, patch.EvaluateGradE_N_W))
    return in_N / (in_M + in_N)


class _Seen:
    """What Drake says of n contacts, in the world.

    table (n, 48): a row of 45, where between the surfaces of object (0) and finger (1) slip is
    taken, and how much of the contact bends with the finger's; how much touches: the sizes of all
    forces, 0 without contact. The row: X_WO (12, row by row), V_WO (6), X_WF (12), V_WF (6), the
    point C of the contact, force on the finger and its torque about C.
    """

    def __init__(self, table: Array):
        self.table, self.row = table, table[:, :45]
        self.between, self.touching = table[:, 45:47], table[:, 47]

    def touch(
        self,
        i: int,
        between: tuple[float, float],
        p_WC: Array,
        force: Array,
        torque: Array | float,
    ) -> None:
        """Add one patch or point; C is the mean of all, weighted by the sizes of their forces."""
        row, before = self.row[i], self.touching[i]
        size = math.hypot(*force) + TINY  # two that do not press count alike
        part = size / (before + size)
        to_C = part * (p_WC - row[36:39])
        if before:
            arms = np.array([-to_C, p_WC - row[36:39] - to_C])
            row[42:45] += np.cross(arms, [row[39:42], force]).sum(0)
        row[36:39] += to_C
        row[39:42] += force
        row[42:45] += torque
        self.between[i] += part * (between - self.between[i])
        self.touching[i] += size

    def in_object(self, later: float) -> Array:
        """(n, 27): X_OF (12), V_OF_O (6), C, force and torque, all in O, some seconds later.

        The bodies go there as a discrete plant moves them, with the velocities they have.
        """
        return run(_motion(), self.row.T, [later]).T


def _split(row: Array) -> Array:
    """x_2, E2, K_2, K_1, C, force, torque, how much of the contact bends with the finger (n, 30) to
    normal force and tangential force in E2 (n, 3)."""
    return run(_forces(), row.T, []).T


# --- symbolic ----------------------------------------------------------------------------------


@per_structure
def _motion() -> Table:
    """See :meth:`_Seen.in_object`."""
    row, later = ca.SX.sym("row", 45), ca.SX.sym("later")
    V_WO, V_WF = row[12:18], row[30:36]
    R_WO, p_WO = _moved(row[:12], V_WO, later)
    R_WF, p_WF = _moved(row[18:30], V_WF, later)
    R_OW, p_OF_W = R_WO.T, p_WF - p_WO
    v_OF_W = V_WF[3:] - V_WO[3:] - ca.cross(V_WO[:3], p_OF_W)
    vectors = ca.horzcat(V_WF[:3] - V_WO[:3], v_OF_W, row[36:39] - p_WO, row[39:42], row[42:45])
    X_OF = R_OW @ ca.horzcat(R_WF, p_OF_W)
    found = ca.vertcat(ca.vec(X_OF.T), ca.vec(R_OW @ vectors))
    return Table(ca.Function("motion", [row, later], [ca.densify(found)]))


def _moved(X: ca.SX, V: ca.SX, later: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Rotation and position after a step of Drake's, whose quaternions turn by Cayley's map."""
    rows = ca.reshape(X, 4, 3).T
    a = ca.skew(later / 2 * V[:3])
    turn = ca.SX.eye(3) + 2 * (a + a @ a) / (1 + later**2 / 4 * ca.sumsqr(V[:3]))
    return turn @ rows[:, :3], rows[:, 3] + later * V[3:]


@per_structure
def _forces() -> Table:
    """See :func:`_split`; the normal is that at the centre of pressure, to first order."""
    row = ca.SX.sym("row", 30)
    E2, K2, K1 = (ca.reshape(row[a:b], n, n) for a, b, n in ((3, 12, 3), (12, 16, 2), (16, 20, 2)))
    arm, force, torque = (E2.T @ v for v in (row[20:23] - row[:3], row[23:26], row[26:29]))
    curvature = K2 - row[29] * (K2 + K1)
    # a force along n at r from where the torque is taken has the torque r x n
    pressing = ca.fmax(force[2], TINY)
    offset = ca.if_else(force[2] > 0, ca.vertcat(-torque[1], torque[0]) / pressing, 0)
    tilt = curvature @ (arm[:2] + offset)
    normal = force[2] + ca.dot(tilt, force[:2])
    found = ca.vertcat(normal, force[:2] - normal * tilt)
    return Table(ca.Function("forces", [row, ca.SX(0, 1)], [ca.densify(found)]))
