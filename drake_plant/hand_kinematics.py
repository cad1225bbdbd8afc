r"""Fingers on joints: where their tips are, how joints move them, and rolling without slip.

A finger that rolls on an object moves its material point at the contact as the object moves its
own, three equations for its joints:

.. math:: J_i(q)\, \dot q_i = v_O + \omega_O \times (p_i - p_O)

With more than three joints some freedom is left, and that goes to the middle of the pad and of the
joints' ranges. The contact's curves on both bodies follow: a finger of four joints cannot choose
them (a route of `cs.reach` needs six), nor its spin about the normal. SI units.

Joints that turn and joints that slide are compared in units of their own: half of the range, but at
most 1 rad or 1 m.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import GeometrySet
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    JacobianWrtVariable,
    Joint,
    MultibodyForces,
    PrismaticJoint,
    RigidBody,
    SpatialInertia,
)
from pydrake.solvers import SnoptSolver

from contact_system import Scene, SceneError
from contact_system.checks import Array, did_you_mean
from contact_system.contact_sensor import NORMAL, ON_FINGER, ON_OBJECT, probes_of

from .hand import Hand, own_hand

POSTURE, ON_PAD = 0.3, 1.0  # how strongly free joints go to the middles of ranges and pads
NEAR = 0.02  # of what grows towards limits, where it ends
INSIDE = 0.02  # of a joint's range, that is kept free at its limits
STRAIGHT = 1e-8  # of a finger's greatest squared singular values, what counts as none
SLIDES = 1e-3  # of the object's speed, from which on a contact is not said to roll
AT_LIMIT = 1e-9  # of a joint's unit
REACHED = 1e-9  # m or rad
STARTS, TRIES = 20, 60  # of solving for positions, and steps towards poses
UNBOUNDED = 1e3  # rad or m, of joints without limits


def add_hand(plant: MultibodyPlant, hand: Hand, scene: Scene, tips: list[RigidBody]) -> GeometrySet:
    """Load a hand that carries fingertips into a plant, with its root where the hand has it.

    Returns what of the model would collide, but must not.
    """
    parser = Parser(plant)
    parser.SetAutoRenaming(True)  # a contact may have the model's name
    parser.package_map().PopulateFromRosPackagePath()
    if hand.model:
        kind = "url" if "://" in str(hand.model) else "file_name"
        try:
            instances = parser.AddModels(**{kind: hand.model})
        except (RuntimeError, ValueError) as error:
            lacks = kind == "file_name" and not Path(hand.model).is_file()
            why = f"there is no such file, as seen from '{Path.cwd()}'" if lacks else error
            raise SceneError(
                f"hand: model = {hand.model!r}: {why}; give an SDF, URDF or MJCF file, or its "
                "package:// URL in a folder of $ROS_PACKAGE_PATH"
            ) from None
    else:
        at = [scene.object.point(*contact.object_at) for contact in scene.contacts]
        instances = parser.AddModelsFromString(
            own_hand([np.arctan2(x[1], x[0]) for x in at], hand.joints), "sdf"
        )
    if len(instances) != 1:
        raise SceneError(f"hand: model = {hand.model!r}: give a file with one model")
    bodies = [plant.get_body(i) for i in plant.GetBodyIndices(instances[0])]
    carried = {plant.get_joint(j).child_body().index() for j in plant.GetJointIndices()}
    roots = [body for body in bodies if body.index() not in carried]
    if not roots and hand.base != Hand().base:
        raise SceneError(
            f"hand: base = {hand.base!r}: the model's file fixes it to the world; leave base out"
        )
    for root in roots:
        X_MR = plant.GetDefaultFloatingBaseBodyPose(root)  # in the model
        plant.WeldFrames(plant.world_frame(), root.body_frame(), RigidTransform(hand.base) @ X_MR)
    for i, tip in enumerate(tips):
        name = hand.tips[i] if hand.tips else f"tip_{i}"
        if not plant.HasFrameNamed(name, instances[0]):
            frames = map(plant.get_frame, plant.GetFrameIndices(instances[0]))
            near = did_you_mean(name, [frame.name() for frame in frames])
            raise SceneError(
                f"hand: tips[{i}] = {name!r}: {hand.model} has no such link or frame{near}"
            )
        plant.WeldFrames(plant.GetFrameByName(name, instances[0]), tip.body_frame())
    bodies.append(plant.world_body())  # where an MJCF file may have a floor, or the palm
    return GeometrySet([g for body in bodies for g in plant.GetCollisionGeometriesForBody(body)])


def moving_joints(plant: MultibodyPlant) -> list[Joint]:
    """The joints of a hand, in the order of q: those with one degree of freedom."""
    joints = map(plant.get_joint, plant.GetJointIndices())
    moving = (joint for joint in joints if joint.num_velocities() == 1)
    return sorted(moving, key=lambda joint: joint.velocity_start())


class Chains:
    """A hand alone, to be asked for tips, Jacobians and torques; one thread at a time.

    Attributes
    ----------
    names : list of str
        Of the joints, in the order of q.
    slides : (nq,)
        Whether a joint is prismatic: m and N then, else rad and N m.
    lower, upper, effort : (nq,)
        Limits.
    middle, unit : (nq,)
        Of the ranges, and in which joints are compared with each other.
    joints : list of list of int
        Of each finger, the places of its joints in q.
    """

    def __init__(self, hand: Hand, scene: Scene, tip_mass: float, gravity: float):
        self.scene, self.hand = scene, hand
        self._made_from = hand, scene, tip_mass, gravity
        self.plant = plant = MultibodyPlant(0.0)
        self.tips = []
        for i, contact in enumerate(scene.contacts):
            inertia = SpatialInertia.Zero()
            if tip_mass:
                inertia = SpatialInertia.SolidSphereWithMass(tip_mass, contact.finger.size)
            self.tips.append(plant.AddRigidBody(f"tip {i}", inertia))
        add_hand(plant, hand, scene, self.tips)
        plant.mutable_gravity_field().set_gravity_vector([0, 0, -gravity])
        plant.Finalize()
        self.context = plant.CreateDefaultContext()
        self._find_joints()
        self._probes = probes_of(scene)
        self._pads = [c.finger.normal(*c.finger_at) for c in scene.contacts]

    def __reduce__(self) -> tuple:
        return Chains, self._made_from

    def _find_joints(self) -> None:
        plant, moving = self.plant, moving_joints(self.plant)
        for joint in map(plant.get_joint, plant.GetJointIndices()):
            if joint.num_velocities() > 1:
                raise SceneError(
                    f"hand: joint {joint.name()} has more than one degree of freedom; give "
                    "revolute or prismatic ones"
                )
        if plant.num_constraints():
            raise SceneError(
                "hand: joints of the model are coupled, as mimic joints are; give a model whose "
                "joints move each by itself"
            )
        self.names = [joint.name() for joint in moving]
        self.slides = np.array([isinstance(joint, PrismaticJoint) for joint in moving])
        limits = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        self.lower, self.upper = np.clip(limits, -UNBOUNDED, UNBOUNDED)
        self._half = (self.upper - self.lower) / 2
        self.middle, self.unit = self.lower + self._half, np.minimum(self._half, 1.0)
        wrong = (self._half == 0) | ((self.lower == -UNBOUNDED) != (self.upper == UNBOUNDED))
        if wrong.any():
            where = self._limits([int(np.argmax(wrong))], self.middle)
            raise SceneError(
                f"hand: {where}: it cannot move, or has one limit alone; give two that leave it "
                "room, none, or a fixed joint"
            )
        self.effort = np.full(len(moving), np.inf)
        for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
            self.effort[actuator.joint().velocity_start()] = actuator.effort_limit()
        moves = [plant.GetBodiesKinematicallyAffectedBy([joint.index()]) for joint in moving]
        self.joints = [
            [k for k, bodies in enumerate(moves) if tip.index() in bodies] for tip in self.tips
        ]
        for i, own in enumerate(self.joints):
            shared = [k for k in own if any(k in other for other in self.joints[:i])]
            if shared or not own:
                names = ", ".join(self.names[k] for k in shared)
                what = f"shares {names} with another" if shared else "is moved by no joint"
                raise SceneError(
                    f"{self.scene.contact_name(i)}: its tip {what}; every finger needs joints of "
                    "its own"
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
        """p_WF, V_WF and A_WF of the tips, (3,), (6,), (6,), at accelerations of the joints."""
        found = self.plant.CalcSpatialAccelerationsFromVdot(self.context, a)
        return [
            (
                tip.EvalPoseInWorld(self.context).translation(),
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
        """What a probe finds of a tip and the object (see :class:`Probe`), (37,), not to be kept.

        twist : V_OF_O, (6,)
        """
        probe, X_OF = self._probes[i], X_WO.inverse() @ self.pose(i)
        probe.seen[:12] = X_OF.GetAsMatrix34().ravel()
        probe.seen[12:18], probe.seen[18:] = twist, 0.0
        centre = X_OF.translation()
        size = self.scene.contacts[i].finger.size
        return probe.find((1 - size / np.linalg.norm(centre)) * centre)

    def away(self, i: int, q: Array, normal: Array) -> Array:
        """Where the free joints of a finger should go, (joints,): to the middles of ranges, and of
        the pad. normal : out of the object, in the world."""
        own = self.joints[i]
        half, unit = self._half[own], self.unit[own]
        part = (self.middle - q)[own] / half
        back = POSTURE * part / (half * np.maximum(1 - part**2, NEAR))  # harder near limits
        turn = cross(normal, self.pose(i).rotation() @ self._pads[i])
        return unit**2 * (back + ON_PAD * self.jacobian(i)[:3, own].T @ turn)

    # --- where to begin, and how to go on ------------------------------------------------------

    def reach(self, points: Array, normals: Array) -> Array:
        """Positions (nq,) at which tips touch points from outside, (n, 3) each, in the world.

        Of all such positions those near the middles of ranges and pads.
        """
        problem = InverseKinematics(self.plant, self.context, with_joint_limits=False)
        q, program, world = problem.q(), problem.get_mutable_prog(), self.plant.world_frame()
        room = 2 * INSIDE * self._half
        program.AddBoundingBoxConstraint(self.lower + room, self.upper - room, q)
        program.AddQuadraticErrorCost(np.diag(POSTURE / self._half**2), self.middle, q)
        centres = points + np.array([[c.finger.size] for c in self.scene.contacts]) * normals
        for tip, pad, centre, normal in zip(self.tips, self._pads, centres, normals):
            frame = tip.body_frame()
            problem.AddPositionConstraint(frame, np.zeros(3), world, centre, centre)
            problem.AddAngleBetweenVectorsCost(world, -normal, frame, pad, ON_PAD)
        program.SetSolverOption(SnoptSolver.id(), "Major feasibility tolerance", REACHED)
        random, tries = np.random.default_rng(0), []
        for k in range(STARTS):  # SNOPT may end on the way
            guess = self.middle + (k > 0) * self.unit * random.uniform(-1, 1, len(q))
            found = SnoptSolver().Solve(program, guess).GetSolution(q)
            self.put(found)
            tips = np.array([self.pose(i).translation() for i in range(len(centres))])
            left = np.linalg.norm(tips - centres, axis=1)
            if left.max() < 10 * REACHED:
                return found
            tries.append((found, left))
        found, left = min(tries, key=lambda each: each[1].max())
        self.put(found)
        i = int(np.argmax(left))
        point, tip = (np.round(x, 4).tolist() for x in (points[i], self.pose(i).translation()))
        raise SceneError(
            f"{self.scene.contact_name(i)} does not reach {point} m: its tip stays {left[i]:.2g} m "
            f"away, at {tip} m, with {self._limits(self.joints[i], found)}; put the hand elsewhere,"
            " or tips in the order of the contacts"
        )

    def placed(self, t: float, q: Array, poses: list[RigidTransform]) -> Array:
        """Positions (nq,), near those given, at which tips have poses in the world at a time."""
        for _ in range(TRIES):
            self.put(q)
            off = np.array([way_to(X_WF, self.pose(i)) for i, X_WF in enumerate(poses)])
            left = np.linalg.norm(off, axis=1)
            if left.max() < REACHED:
                return q
            q = q + np.clip(self.moved(q, off), -0.3, 0.3)
        i = int(np.argmax(left))
        why = f"{left[i]:.2g} m or rad are left, with {self._limits(self.joints[i], q)}"
        raise self.short_of(i, t, why)

    def moved(self, q: Array, twists: Array) -> Array:
        """Velocities (nq,) of joints at which tips have V_WF, (n, 6)."""
        self.put(q)
        found = np.zeros_like(q)
        for i, own in enumerate(self.joints):
            found[own] = self._nearest(i, self.jacobian(i), twists[i], np.zeros(len(own)))
        return found

    def _nearest(self, i: int, J: Array, v: Array, free: Array) -> Array:
        """Of a finger's velocities with J q' = v, or nearly so where it is straight, those nearest
        to others."""
        own = self.joints[i]
        J, unit = J[:, own], self.unit[own] ** 2
        square = (J * unit) @ J.T
        square += STRAIGHT * np.trace(square) * np.eye(len(square))
        for _ in range(2):  # the second makes up for what is left
            free = free + unit * (J.T @ np.linalg.solve(square, v - J @ free))
        return free

    def _limits(self, joints: list[int], q: Array) -> str:
        told = (
            f"joint {self.names[k]} = {q[k]:.3g} of [{self.lower[k]:.3g}, {self.upper[k]:.3g}] "
            f"{'m' if self.slides[k] else 'rad'}"
            for k in joints
        )
        return ", ".join(told)

    def room(self, q: Array) -> Array:
        """How far joints are from their nearer limit, as q, which has them in the last axis."""
        return np.minimum(q - self.lower, self.upper - q)

    def refuse_limits(self, t: Array, q: Array) -> None:
        """Raise a SceneError at the first time at which a joint is at a limit; q (m, nq)."""
        over = self.room(q) < AT_LIMIT * self.unit
        if over.any():
            k, joint = np.argwhere(over)[0]
            i = next(i for i, own in enumerate(self.joints) if joint in own)
            raise self.short_of(i, t[k], self._limits([joint], q[k]))

    def short_of(self, i: int, t: float, why: str) -> SceneError:
        """What to raise where a finger cannot follow."""
        return SceneError(
            f"{self.scene.contact_name(i)} does not get as far: at t = {t:.3g} s {why}"
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
            v, J = V_WO[3:] + cross(w, arm), self.jacobian(i, x_F)[3:]
            found[own] = self._nearest(i, J, v, pace * self.away(i, q, normal))
            if np.linalg.norm(J @ found - v) > SLIDES * pace * self.scene.object.size:
                raise SceneError(
                    f"{self.scene.contact_name(i)} would slip: it cannot move its tip as the "
                    f"object's surface goes, at {self._limits(own, q)}; fingers that stretch out "
                    "or lie in a plane move theirs in two directions"
                )
        return found


def way_to(goal: RigidTransform, X: RigidTransform) -> Array:
    """From a pose to another: the rotation vector and the shift that lead there, (6,)."""
    turn = (goal.rotation() @ X.rotation().inverse()).ToAngleAxis()
    return np.append(turn.angle() * turn.axis(), goal.translation() - X.translation())


def cross(a: Array, b: Array) -> Array:
    """a x b of two vectors, a tenth of numpy's time."""
    (x, y, z), (u, v, w) = a, b
    return np.array((y * w - z * v, z * u - x * w, x * v - y * u))
