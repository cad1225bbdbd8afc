r"""Kinematics and dynamics of a hand, and joint velocities at which its fingertips roll.

Where a finger rolls on an object without slip, the material points of both at the contact have the
same velocity. These are three equations for the velocities of the finger's joints:

.. math:: J_i(q)\, \dot q_i = v_O + \omega_O \times (p_i - p_O)

With more than three joints freedom is left: it moves the contact towards the middle of the pad, and
the joints towards the middles of their ranges. The joints thus determine the contact's curves and
the spin about the normal. To choose these, as a route of `cs.reach` does, takes six. SI units.

To compare joints that turn with joints that slide, each has a unit: half of its range, but at most
1 rad or 1 m.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import GeometrySet
from pydrake.math import RigidTransform, VectorToSkewSymmetric
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
    UnitInertia,
)
from pydrake.solvers import SnoptSolver

from contact_system import Scene, SceneError
from contact_system.checks import Array, did_you_mean
from contact_system.contact_sensor import NORMAL, ON_FINGER, ON_OBJECT, probes_of

from .hand import Hand, own_hand

POSTURE, ON_PAD = 0.3, 1.0  # weights of the middles of joints' ranges and of pads
NEAR = 0.02  # near a limit a joint is drawn to the middle more strongly, by up to 1 / NEAR
INSIDE = 0.02  # part of a joint's range that a start keeps from each of its limits
STRAIGHT = 1e-4  # singular value over the greatest, below which fingers count as stretched out
SLIPPING = 1e-3  # slip over the object's speed at which joints are said not to roll a tip
AT_LIMIT = 1e-9  # distance from a limit, in the joint's unit, at which it counts as reached
REACHED = 1e-9  # m or rad, greatest error of a tip
ROUNDED = 1e-6  # m, the same for fingers in planes that a file of few digits puts beside contacts
STARTS, TRIES = 20, 60  # greatest numbers of starts of SNOPT, and of Newton's steps to a pose
UNBOUNDED = 1e3  # rad or m, stands for the limits of joints without limits


def add_hand(plant: MultibodyPlant, hand: Hand, scene: Scene, tips: list[RigidBody]) -> GeometrySet:
    """Load a hand into a plant, weld its root to the world at `base`, and the tips to its frames.

    Returns the model's collision geometries, with those of a floor: they must not collide.
    """
    parser = Parser(plant)
    parser.SetAutoRenaming(True)  # a contact may have the model's name
    parser.package_map().PopulateFromRosPackagePath()
    if hand.model:
        kind = "url" if "://" in str(hand.model) else "file_name"
        try:
            instances = parser.AddModels(**{kind: hand.model})
        except (RuntimeError, ValueError) as error:
            missing = kind == "file_name" and not Path(hand.model).is_file()
            why = f"there is no such file, as seen from '{Path.cwd()}'" if missing else error
            raise SceneError(
                f"hand: model = {hand.model!r}: {why}; give an SDF, URDF or MJCF file, or its "
                "package:// URL in a folder of $ROS_PACKAGE_PATH"
            ) from None
    else:
        points = [scene.object.point(*contact.object_at) for contact in scene.contacts]
        azimuths = [np.arctan2(x[1], x[0]) for x in points]
        instances = parser.AddModelsFromString(own_hand(azimuths, hand.joints), "sdf")
    if len(instances) != 1:
        raise SceneError(f"hand: model = {hand.model!r}: give a file with one model")
    bodies = [plant.get_body(i) for i in plant.GetBodyIndices(instances[0])]
    children = {plant.get_joint(j).child_body().index() for j in plant.GetJointIndices()}
    roots = [body for body in bodies if body.index() not in children]
    if not roots and hand.base != Hand().base:
        raise SceneError(
            f"hand: base = {hand.base!r}: the model's file fixes it to the world; leave base out"
        )
    for root in roots:
        X_MR = plant.GetDefaultFloatingBaseBodyPose(root)  # in the model's frame M
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
    bodies.append(plant.world_body())  # to which an MJCF file may attach a floor, or the palm
    return GeometrySet([g for body in bodies for g in plant.GetCollisionGeometriesForBody(body)])


def moving_joints(plant: MultibodyPlant) -> list[Joint]:
    """The joints of a hand, which have one degree of freedom, in the order of q."""
    joints = map(plant.get_joint, plant.GetJointIndices())
    moving = (joint for joint in joints if joint.num_velocities() == 1)
    return sorted(moving, key=lambda joint: joint.velocity_start())


class Chains:
    """A plant of a hand alone, for its kinematics and inverse dynamics; one thread at a time.

    Attributes
    ----------
    names : list of str
        Names of the joints, in the order of q.
    slides : (nq,)
        Whether a joint is prismatic: then it has m and N, else rad and N m.
    lower, upper, fastest, effort : (nq,)
        Limits of positions, speeds and torques.
    middle, unit : (nq,)
        Middles of the joints' ranges, and the units in which joints are compared.
    joints : list of list of int
        The indices in q of each finger's joints.
    """

    def __init__(self, hand: Hand, scene: Scene, tip_mass: float, gravity: float):
        self.scene, self.hand = scene, hand
        self._made_from = hand, scene, tip_mass, gravity
        self.plant = plant = MultibodyPlant(0.0)
        self.tips = []
        for i, contact in enumerate(scene.contacts):
            unit = UnitInertia.SolidSphere(contact.finger.size)
            inertia = SpatialInertia(tip_mass, np.zeros(3), unit)
            self.tips.append(plant.AddRigidBody(f"tip {i}", inertia))
        add_hand(plant, hand, scene, self.tips)
        plant.mutable_gravity_field().set_gravity_vector([0, 0, -gravity])
        plant.Finalize()
        self.context = plant.CreateDefaultContext()
        self._find_joints()
        self._probes = probes_of(scene)
        self._pads = [c.finger.normal(*c.finger_at) for c in scene.contacts]  # normals, in F

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
                "joints move independently of each other"
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
                f"hand: {where}: it cannot move, or has one limit alone; give it two different "
                "limits, or none, or make it a fixed joint"
            )
        self.fastest, self.effort = plant.GetVelocityUpperLimits(), np.full(len(moving), np.inf)
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
                    f"{self.scene.contact_title(i)}: its tip {what}; every finger needs joints of "
                    "its own"
                )

    # --- kinematics and dynamics of the present state -------------------------------------------

    def set_state(self, q: Array, v: Array | None = None) -> None:
        self.plant.SetPositions(self.context, q)
        if v is not None:
            self.plant.SetVelocities(self.context, v)

    def pose(self, i: int) -> RigidTransform:
        """X_WF of a tip."""
        return self.tips[i].EvalPoseInWorld(self.context)

    def jacobian(self, i: int, p_F: Any = (0.0, 0.0, 0.0)) -> Array:
        """J of a point of a tip, (6, nq): J v is its spatial velocity in the world."""
        world = self.plant.world_frame()
        return self.plant.CalcJacobianSpatialVelocity(
            self.context, JacobianWrtVariable.kV, self.tips[i].body_frame(), p_F, world, world
        )

    def inverse_dynamics(self, a: Array) -> Array:
        """Torques (nq,) at which joints have accelerations a, with gravity, springs and damping."""
        forces = MultibodyForces(self.plant)
        self.plant.CalcForceElementsContribution(self.context, forces)
        return self.plant.CalcInverseDynamics(self.context, a, forces)

    def touch(self, i: int, X_WO: RigidTransform, twist: Any = 0.0) -> Array:
        """Measure the contact of a tip: `Probe.found`, (37,), which the next call overwrites.

        twist : V_OF_O, (6,)
        """
        probe, X_OF = self._probes[i], X_WO.inverse() @ self.pose(i)
        probe.seen[:12] = X_OF.GetAsMatrix34().ravel()
        probe.seen[12:18], probe.seen[18:] = twist, 0.0
        centre, size = X_OF.translation(), self.scene.contacts[i].finger.size
        near = (1 - size / np.linalg.norm(centre)) * centre  # where Newton begins
        return probe.find(near)

    def centring(self, i: int, q: Array, normal: Array) -> Array:
        """Preferred changes of a finger's joints, (joints,): to the middles of their ranges and of
        its pad. normal : out of the object, in the world."""
        own = self.joints[i]
        half, unit = self._half[own], self.unit[own]
        part = (self.middle - q)[own] / half
        inwards = POSTURE * part / (half * np.maximum(1 - part**2, NEAR))  # stronger near limits
        # with np.cross a plan would take a third longer
        turn = VectorToSkewSymmetric(normal) @ (self.pose(i).rotation() @ self._pads[i])
        return unit**2 * (inwards + ON_PAD * self.jacobian(i)[:3, own].T @ turn)

    # --- positions and velocities of joints for motions of the tips ------------------------------

    def reach(self, points: Array, normals: Array) -> Array:
        """Positions (nq,) near middles of ranges and pads at which tips touch points on the object.

        points, normals : (n, 3), in the world; normals point out of the object
        """
        problem = InverseKinematics(self.plant, self.context, with_joint_limits=False)
        q, program, world = problem.q(), problem.get_mutable_prog(), self.plant.world_frame()
        kept = 2 * INSIDE * self._half
        program.AddBoundingBoxConstraint(self.lower + kept, self.upper - kept, q)
        program.AddQuadraticErrorCost(np.diag(POSTURE / self._half**2), self.middle, q)
        centres = points + np.array([[c.finger.size] for c in self.scene.contacts]) * normals
        for tip, pad, centre, normal in zip(self.tips, self._pads, centres, normals):
            frame = tip.body_frame()
            problem.AddPositionConstraint(frame, np.zeros(3), world, centre, centre)
            problem.AddAngleBetweenVectorsCost(world, -normal, frame, pad, ON_PAD)
        program.SetSolverOption(SnoptSolver.id(), "Major feasibility tolerance", REACHED)
        random, tries = np.random.default_rng(0), []
        for k in range(STARTS):  # SNOPT fails from some of them
            guess = self.middle + (k > 0) * self.unit * random.uniform(-1, 1, len(q))
            found = SnoptSolver().Solve(program, guess).GetSolution(q)
            self.set_state(found)
            tips = np.array([self.pose(i).translation() for i in range(len(centres))])
            errors = np.linalg.norm(tips - centres, axis=1)
            if errors.max() < 10 * REACHED:
                return found
            tries.append((found, tips, errors))
        found, tips, errors = min(tries, key=lambda each: each[2].max())
        if errors.max() < ROUNDED:
            return found
        i = int(np.argmax(errors))
        point, tip = (np.round(each[i], 4).tolist() for each in (points, tips))
        raise SceneError(
            f"{self.scene.contact_title(i)} does not reach {point} m: its tip stays "
            f"{errors[i]:.2g} m away, at {tip} m, with {self._limits(self.joints[i], found)}; put "
            "the hand elsewhere, or give tips in the order of the contacts"
        )

    def positions(self, t: float, q: Array, poses: list[RigidTransform]) -> Array:
        """Positions (nq,) at which tips have poses X_WF at time t, by Newton's method from q."""
        for _ in range(TRIES):
            self.set_state(q)
            ways = np.array([way_to(X_WF, self.pose(i)) for i, X_WF in enumerate(poses)])
            errors = np.linalg.norm(ways, axis=1)
            if errors.max() < REACHED:
                return q
            q = q + np.clip(self.velocities(q, ways), -0.3, 0.3)
        i = int(np.argmax(errors))
        why = f"{errors[i]:.2g} m or rad are left, with {self._limits(self.joints[i], q)}"
        raise self.cannot_follow(i, t, why)

    def velocities(self, q: Array, twists: Array) -> Array:
        """Velocities (nq,) at which tips have spatial velocities V_WF, (n, 6)."""
        self.set_state(q)
        found = np.zeros_like(q)
        for i, own in enumerate(self.joints):
            found[own] = self._nearest(i, self.jacobian(i), twists[i], np.zeros(len(own)))
        return found

    def _nearest(self, i: int, J: Array, v: Array, wanted: Array) -> Array:
        """Of a finger's joint velocities with J q' = v those nearest to wanted ones, (joints,).

        In a singular posture, where there are none, those for which J q' is nearest to v.
        """
        own = self.joints[i]
        J, unit = J[:, own], self.unit[own]
        return wanted + unit * (np.linalg.pinv(J * unit, rcond=STRAIGHT) @ (v - J @ wanted))

    def _limits(self, joints: list[int], q: Array) -> str:
        """Joints with their positions and limits, for messages."""
        texts = (
            f"joint {self.names[k]} = {q[k]:.3g} of [{self.lower[k]:.3g}, {self.upper[k]:.3g}] "
            f"{'m' if self.slides[k] else 'rad'}"
            for k in joints
        )
        return ", ".join(texts)

    def room(self, q: Array) -> Array:
        """Distance of each joint from its nearer limit; of the shape of q, (..., nq)."""
        return np.minimum(q - self.lower, self.upper - q)

    def refuse_limits(self, t: Array, q: Array) -> None:
        """Raise a SceneError at the first time at which a joint is at a limit; q (m, nq)."""
        over = self.room(q) < AT_LIMIT * self.unit
        if over.any():
            k, joint = np.argwhere(over)[0]
            i = next(i for i, own in enumerate(self.joints) if joint in own)
            raise self.cannot_follow(i, t[k], self._limits([joint], q[k]))

    def refuse_speeds(self, t: Array, v: Array) -> None:
        """Raise a SceneError at the first time at which a joint is too fast; v (m, nq)."""
        over = np.abs(v) > self.fastest
        if over.any():
            k, joint = np.argwhere(over)[0]
            unit = "m/s" if self.slides[joint] else "rad/s"
            raise SceneError(
                f"joint {self.names[joint]} moves at {v[k, joint]:.3g} {unit} at t = {t[k]:.3g} s, "
                f"its limit is {self.fastest[joint]:.3g}; move more gently, or give a faster hand"
            )

    def cannot_follow(self, i: int, t: float, why: str) -> SceneError:
        name = self.scene.contact_title(i)
        return SceneError(f"{name} does not get as far: at t = {t:.3g} s {why}")

    def rolling(self, q: Array, X_WO: RigidTransform, V_WO: Array) -> Array:
        """Velocities (nq,) at which every tip rolls on the object without slip; V_WO (6,)."""
        self.set_state(q)
        found, w, rotation = np.zeros_like(q), V_WO[:3], X_WO.rotation().matrix()
        pace = np.linalg.norm(w) + np.linalg.norm(V_WO[3:]) / self.scene.object.size
        if not pace:
            return found
        for i, own in enumerate(self.joints):
            at = self.touch(i, X_WO)
            x_F, arm, normal = at[ON_FINGER], rotation @ at[ON_OBJECT], rotation @ at[NORMAL]
            v, J = V_WO[3:] + VectorToSkewSymmetric(w) @ arm, self.jacobian(i, x_F)[3:]
            found[own] = self._nearest(i, J, v, pace * self.centring(i, q, normal))
            if np.linalg.norm(J @ found - v) > SLIPPING * pace * self.scene.object.size:
                raise SceneError(
                    f"{self.scene.contact_title(i)} would slip: it cannot move its tip as the "
                    f"object's surface goes, at {self._limits(own, q)}; fingers that are stretched "
                    "out, or move in a plane, move their tips in two directions only"
                )
        return found


def way_to(goal: RigidTransform, X: RigidTransform) -> Array:
    """The rotation vector and the shift that lead from X to the goal, (6,), in the world."""
    turn = (goal.rotation() @ X.rotation().inverse()).ToAngleAxis()
    return np.append(turn.angle() * turn.axis(), goal.translation() - X.translation())
