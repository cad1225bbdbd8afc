r"""Fingers on joints: where their tips are, how joints move them, and rolling without slip.

A finger that rolls on an object moves its material point at the contact as the object moves its
own, three equations for its joints:

.. math:: J_i(q)\, \dot q_i = v_O + \omega_O \times (p_i - p_O)

With more than three joints some freedom is left, and that goes to the middle of the pad and of the
joints' ranges. The contact's curves on both bodies follow: a finger of four joints cannot choose
them (a route of `cs.reach` needs six), nor its spin about the normal. SI units.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometrySet
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    JacobianWrtVariable,
    JointActuatorIndex,
    ModelInstanceIndex,
    MultibodyForces,
    RigidBody,
    SpatialInertia,
)

from contact_system import Scene, SceneError, Sphere
from contact_system.contact_sensor import NORMAL, ON_FINGER, ON_OBJECT, ContactSensor

from .balance import way_to
from .hand import Hand, own_hand

Array = NDArray[np.float64]

POSTURE, ON_PAD = 0.3, 1.0  # how strongly free joints go to the middles of ranges and pads
NEAR = 0.02  # of what grows towards limits, where it ends
INSIDE = 0.02  # of a joint's range, that is kept free at its limits
REACHED = 1e-9  # m
TRIES = 60
UNBOUNDED = 1e3  # rad, of joints without limits


def add_model(plant: MultibodyPlant, hand: Hand, scene: Scene) -> ModelInstanceIndex:
    """Load a hand into a plant, with its root where the hand has it; returns its instance."""
    parser = Parser(plant)
    if hand.model:
        try:
            instances = parser.AddModels(hand.model)
        except RuntimeError as error:
            raise SceneError(f"hand: model = {hand.model!r}: {error}") from None
    else:
        at = [scene.object.point(*contact.object_at) for contact in scene.contacts]
        instances = parser.AddModelsFromString(
            own_hand([np.arctan2(x[1], x[0]) for x in at], hand.joints), "sdf"
        )
    if len(instances) != 1:
        raise SceneError(f"hand: model = {hand.model!r}: give a file with one model")
    carried = {plant.get_joint(j).child_body().index() for j in plant.GetJointIndices()}
    roots = [plant.get_body(i) for i in plant.GetBodyIndices(instances[0]) if i not in carried]
    if not roots and hand.base != Hand().base:
        raise SceneError(
            f"hand: base = {hand.base!r}: the model's file fixes it to the world; leave base out"
        )
    for root in roots:
        X_MR = plant.GetDefaultFloatingBaseBodyPose(root)  # in the model
        plant.WeldFrames(plant.world_frame(), root.body_frame(), RigidTransform(hand.base) @ X_MR)
    return instances[0]


def add_hand(plant: MultibodyPlant, hand: Hand, scene: Scene, tips: list[RigidBody]) -> GeometrySet:
    """Add a hand that carries fingertips; returns what of the model would collide, but must not."""
    instance = add_model(plant, hand, scene)
    weld_tips(plant, hand, instance, tips)
    bodies = map(plant.get_body, plant.GetBodyIndices(instance))
    return GeometrySet([g for body in bodies for g in plant.GetCollisionGeometriesForBody(body)])


def weld_tips(
    plant: MultibodyPlant, hand: Hand, instance: ModelInstanceIndex, tips: list[RigidBody]
) -> None:
    """Weld each fingertip to the model's frame that carries it."""
    for i, tip in enumerate(tips):
        name = hand.tips[i] if hand.tips else f"tip_{i}"
        if not plant.HasFrameNamed(name, instance):
            raise SceneError(f"hand: tips[{i}] = {name!r}: {hand.model} has no such frame")
        plant.WeldFrames(plant.GetFrameByName(name, instance), tip.body_frame())


class Chains:
    """A hand alone, to be asked for tips, Jacobians and torques; one thread at a time.

    Attributes
    ----------
    names : list of str
        Of the joints, in the order of q.
    lower, upper, effort : (nq,)
        Limits, rad and N m.
    joints : list of list of int
        Of each finger, the places of its joints in q.
    """

    def __init__(self, hand: Hand, scene: Scene, tip_mass: float, gravity: float):
        self.scene, self.hand = scene, hand
        self.plant = plant = MultibodyPlant(0.0)
        instance = add_model(plant, hand, scene)
        self.tips = []
        for i, contact in enumerate(scene.contacts):
            if not isinstance(contact.finger, Sphere) or contact.finger.inside:
                raise SceneError(
                    f"{scene.contact_name(i)}: finger = {contact.finger!r}: a fingertip on joints "
                    "is a sphere"
                )
            inertia = SpatialInertia.Zero()
            if tip_mass:
                inertia = SpatialInertia.SolidSphereWithMass(tip_mass, contact.finger.size)
            self.tips.append(plant.AddRigidBody(f"tip {i}", instance, inertia))
        weld_tips(plant, hand, instance, self.tips)
        plant.mutable_gravity_field().set_gravity_vector([0, 0, -gravity])
        plant.Finalize()
        self.context = plant.CreateDefaultContext()
        self._find_joints()
        self._sensor = ContactSensor(scene)
        self._pads = [c.finger.normal(*c.finger_at) for c in scene.contacts]

    def _find_joints(self) -> None:
        plant, size = self.plant, self.plant.num_positions()
        moving = [j for j in map(plant.get_joint, plant.GetJointIndices()) if j.num_velocities()]
        if plant.num_velocities() != size or any(j.num_velocities() != 1 for j in moving):
            raise SceneError(
                "hand: a joint has more than one degree of freedom; give revolute ones"
            )
        if plant.num_constraints():
            raise SceneError(
                "hand: joints of the model are coupled, as mimic joints are; give a model whose "
                "joints move each by itself"
            )
        moving.sort(key=lambda joint: joint.position_start())
        self.names = [joint.name() for joint in moving]
        limits = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        self.lower, self.upper = np.clip(limits, -UNBOUNDED, UNBOUNDED)
        self.effort = np.full(size, np.inf)
        for k in range(plant.num_actuators()):
            actuator = plant.get_joint_actuator(JointActuatorIndex(k))
            self.effort[actuator.joint().velocity_start()] = actuator.effort_limit()
        self.joints: list[list[int]] = [[] for _ in self.tips]
        for k, joint in enumerate(moving):
            moved = plant.GetBodiesKinematicallyAffectedBy([joint.index()])
            for own, tip in zip(self.joints, self.tips):
                if tip.index() in moved:
                    own.append(k)
        for i, own in enumerate(self.joints):
            if len(own) < 3 or any(set(own) & set(others) for others in self.joints[:i]):
                raise SceneError(
                    f"{self.scene.contact_name(i)}: its tip is moved by {len(own)} joints, "
                    f"{', '.join(self.names[k] for k in own)}; a finger needs three or more of its "
                    "own"
                )

    # --- asking --------------------------------------------------------------------------------

    def put(self, q: Array, v: Array | None = None) -> None:
        """Set positions, and velocities, of all joints."""
        self.plant.SetPositions(self.context, q)
        if v is not None:
            self.plant.SetVelocities(self.context, v)

    def pose(self, i: int) -> RigidTransform:
        """X_WF of a tip."""
        return self.tips[i].EvalPoseInWorld(self.context)

    def jacobian(self, i: int, p_F: Any = (0.0, 0.0, 0.0)) -> Array:
        """Of a point of a tip: angular and linear velocity by all joints, (6, nq), in the world."""
        world = self.plant.world_frame()
        return self.plant.CalcJacobianSpatialVelocity(
            self.context, JacobianWrtVariable.kV, self.tips[i].body_frame(), p_F, world, world
        )

    def motions(self, a: Array) -> list[tuple[Array, Array, Array]]:
        """X_WF, V_WF and A_WF of the tips, (3, 4), (6,), (6,), at accelerations of the joints."""
        found = self.plant.CalcSpatialAccelerationsFromVdot(self.context, a)
        return [
            (
                tip.EvalPoseInWorld(self.context).GetAsMatrix34(),
                tip.EvalSpatialVelocityInWorld(self.context).get_coeffs(),
                found[tip.index()].get_coeffs(),
            )
            for tip in self.tips
        ]

    def carrying(self, a: Array) -> Array:
        """Torques (nq,) that accelerate the joints so, against gravity, springs and damping."""
        forces = MultibodyForces(self.plant)
        self.plant.CalcForceElementsContribution(self.context, forces)
        return self.plant.CalcInverseDynamics(self.context, a, forces)

    def touch(self, i: int, X_WO: RigidTransform, twist: Any = 0.0) -> Array:
        """What a probe finds of a tip and the object (see :class:`Probe`), (40,), not to be kept.

        twist : V_OF_O, (6,)
        """
        probe, X_OF = self._sensor.probes[i], X_WO.inverse() @ self.pose(i)
        probe.seen[:12] = X_OF.GetAsMatrix34().ravel()
        probe.seen[12:18], probe.seen[18:] = twist, 0.0
        centre = X_OF.translation()
        size = self.scene.contacts[i].finger.size
        return probe.find((1 - size / np.linalg.norm(centre)) * centre)

    def away(self, i: int, q: Array, normal: Array) -> Array:
        """Where the free joints of a finger should go, (joints,): to the middles of ranges, and of
        the pad. normal : out of the object, in the world."""
        own = self.joints[i]
        middle, half = (self.lower + self.upper)[own] / 2, (self.upper - self.lower)[own] / 2
        part = (middle - q[own]) / half
        back = POSTURE * part / (half * np.maximum(1 - part**2, NEAR))  # harder near limits
        turn = cross(normal, self.pose(i).rotation() @ self._pads[i])
        return back + ON_PAD * self.jacobian(i)[:3, own].T @ turn

    # --- where to begin, and how to go on ------------------------------------------------------

    def reach(self, points: Array, normals: Array) -> Array:
        """Positions (nq,) at which tips touch points from outside, (n, 3) each, in the world.

        Raises
        ------
        SceneError
            A finger that does not come there, with the joints that are at their limits.
        """
        room = INSIDE * (self.upper - self.lower)
        lower, upper = self.lower + room, self.upper - room
        q = (lower + upper) / 2
        centres = points + np.array([[c.finger.size] for c in self.scene.contacts]) * normals
        for _ in range(TRIES):
            self.put(q)
            steps = np.zeros_like(q)
            for i, own in enumerate(self.joints):
                missed = centres[i] - self.pose(i).translation()
                steps[own] = _least(self.jacobian(i)[3:, own], missed, self.away(i, q, normals[i]))
            q = np.clip(q + np.clip(steps, -0.3, 0.3), lower, upper)
            if np.abs(steps).max() < REACHED:
                break
        self.put(q)
        for i, own in enumerate(self.joints):
            left = np.linalg.norm(centres[i] - self.pose(i).translation())
            if left > REACHED:
                at = [k for k in own if q[k] in (lower[k], upper[k])] or own
                raise SceneError(
                    f"{self.scene.contact_name(i)} does not reach {np.round(points[i], 4).tolist()}"
                    f" m: {left:.2g} m are left, with {self._limits(at, q)}; put the hand elsewhere"
                )
        return q

    def placed(self, t: float, q: Array, poses: list[RigidTransform]) -> Array:
        """Positions (nq,), near those given, at which tips have poses in the world at a time."""
        for _ in range(TRIES):
            self.put(q)
            steps, left = np.zeros_like(q), []
            for i, own in enumerate(self.joints):
                off = way_to(poses[i], self.pose(i))
                left.append(float(np.linalg.norm(off)))
                steps[own] = _least(self.jacobian(i)[:, own], off, np.zeros(len(own)))
            if max(left) < REACHED:
                return q
            q = q + np.clip(steps, -0.3, 0.3)
        i = int(np.argmax(left))
        raise SceneError(
            f"{self.scene.contact_name(i)} does not get as far: at t = {t:.3g} s {left[i]:.2g} m "
            f"or rad are left, with {self._limits(self.joints[i], q)}"
        )

    def moved(self, q: Array, twists: Array) -> Array:
        """Velocities (nq,) of joints at which tips have V_WF, (n, 6)."""
        self.put(q)
        found = np.zeros_like(q)
        for i, own in enumerate(self.joints):
            found[own] = _least(self.jacobian(i)[:, own], twists[i], np.zeros(len(own)))
        return found

    def _limits(self, joints: list[int], q: Array) -> str:
        told = (
            f"joint {self.names[k]} = {q[k]:.3g} of [{self.lower[k]:.3g}, {self.upper[k]:.3g}] rad"
            for k in joints
        )
        return ", ".join(told)

    def refuse_limits(self, t: Array, q: Array) -> None:
        """Raise a SceneError at the first time at which a joint is beyond a limit; q (m, nq)."""
        over = (q < self.lower) | (q > self.upper)
        if over.any():
            k = int(np.argmax(over.any(axis=1)))
            joint = int(np.argmax(over[k]))
            i = next(i for i, own in enumerate(self.joints) if joint in own)
            raise SceneError(
                f"{self.scene.contact_name(i)} does not get as far: at t = {t[k]:.3g} s "
                f"{self._limits([joint], q[k])}"
            )

    def rolling(self, q: Array, X_WO: RigidTransform, V_WO: Array) -> Array:
        """Velocities (nq,) of joints at which every tip rolls on the object without slip.

        V_WO : (6,), angular then linear, of the object's origin
        """
        self.put(q)
        found, w, rotation = np.zeros_like(q), V_WO[:3], X_WO.rotation().matrix()
        pace = np.linalg.norm(w) + np.linalg.norm(V_WO[3:]) / self.scene.object.size
        if not pace:
            return found
        for i, own in enumerate(self.joints):
            at = self.touch(i, X_WO)
            x_F, arm, normal = at[ON_FINGER], rotation @ at[ON_OBJECT], rotation @ at[NORMAL]
            v = V_WO[3:] + cross(w, arm)
            found[own] = _least(self.jacobian(i, x_F)[3:, own], v, pace * self.away(i, q, normal))
        return found


def cross(a: Array, b: Array) -> Array:
    """a x b of two vectors, a tenth of numpy's time."""
    (x, y, z), (u, v, w) = a, b
    return np.array((y * w - z * v, z * u - x * w, x * v - y * u))


def _least(J: Array, v: Array, free: Array) -> Array:
    """Of velocities with J q' = v, or nearly so where a finger is straight, those nearest to
    others."""
    square = J @ J.T
    square += 1e-12 * np.trace(square) * np.eye(len(square))
    return free + J.T @ np.linalg.solve(square, v - J @ free)
