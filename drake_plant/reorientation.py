"""Plan how a hand turns an object: its path, joint motions that roll the tips on it, and forces."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import BezierCurve, PiecewisePose
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from contact_system import Cylinder, Ellipsoid, Goal, Scene, SceneError, Sphere, reach
from contact_system import plan as make_plan
from contact_system.checks import Array, naming, of_kind
from contact_system.contact_sensor import FOUND, NORMAL, ON_FINGER, ON_OBJECT, SLIP, STATES

from .balance import balancing_forces, friction_used, needed_wrench
from .bodies import solid_inertia
from .config import StationConfig
from .hand import Hand
from .hand_kinematics import Chains
from .plant import AddScenePlant, check_surfaces
from .pressing import REACH, resting, rolling_scene

STEPS = 16  # least number of integration steps from the start of the motion to its end
ACCURATE = 1e-7  # error of a step, in units of the joints
DEEPER = 1e-3  # part by which the mean force may exceed the least before the plan is made again
FREE = 6  # number of joints with which a finger can move its tip to any pose
LEG_NODES = 33  # least number of times in a plan on legs, of which there are at most four
BEGIN, END = 0.1, 0.75  # of the duration, when the object begins to move, and stops


class ShortestPath:
    """A path from the world's origin to a pose, by one axis and one line, at rest at its ends.

    It has those methods of Drake's PiecewisePose that planning calls.
    """

    def __init__(self, X_WO_goal: RigidTransform, start: float, stop: float):
        self._made_from = X_WO_goal, start, stop
        self._way = PiecewisePose.MakeLinear([0.0, 1.0], [RigidTransform(), X_WO_goal])
        self._twist = self._way.GetVelocity(0.5)
        self._part = part = BezierCurve(start, stop, [[0, 0, 0, 1, 1, 1]])  # of the way, a quintic
        self.start_time, self.end_time = part.start_time, part.end_time

    def __reduce__(self) -> tuple:
        return ShortestPath, self._made_from

    def GetPose(self, t: float) -> RigidTransform:
        return self._way.GetPose(self._part.value(t).item())

    def GetVelocity(self, t: float) -> Array:
        return self._part.EvalDerivative(t, 1).item() * self._twist

    def GetAcceleration(self, t: float) -> Array:
        return self._part.EvalDerivative(t, 2).item() * self._twist


@dataclass(frozen=True, eq=False, repr=False)
class Reorientation:
    """How a hand turns an object: made by :func:`plan_reorientation`. m times, n fingers; SI units.

    Attributes
    ----------
    hand, scene, config
        As given, but the scene has the settings as its ``[drake]`` table, and the configuration has
        the hand, and as `normal_force` the planned mean.
    rolling : Scene
        The scene with the surfaces on which pressed bodies roll, and contacts where fingers start.
    route : Scene or None
        `rolling` with the legs of :func:`cs.reach` that fingers of six or more joints follow from
        ``t[0]`` on, if they can, for :func:`cs.plan`.
    path : PiecewisePose or ShortestPath
        X_WO as a function of time.
    t : (m,)
    object_pose : (m, 4, 4)
        X_WO.
    q, v, a : (m, nq)
        Positions, velocities and accelerations of the joints, in the order of `joints`.
    points : (m, n, 2, 3)
        Contact points on finger and object, each in its body's frame.
    normals, forces : (m, n, 3)
        Normals into the object and forces on it, in the world.
    resting : (2, n, 3)
        Forces on the object while it rests, before and after the path.
    states : (m, n, 9)
        As :meth:`contact_system.Plan.states` gives them.
    slip, spin : (m, n)
        Speed of slip, m/s, and of rotation about the normal, rad/s.
    cones : (m, n)
        Part of each friction cone that the forces use.
    torques : (m, nq)
    joints : list of str
    """

    hand: Hand
    scene: Scene
    config: StationConfig
    rolling: Scene
    route: Scene | None
    path: Any
    t: Array
    object_pose: Array
    q: Array
    v: Array
    a: Array
    points: Array
    normals: Array
    forces: Array
    resting: Array
    states: Array
    slip: Array
    spin: Array
    cones: Array
    torques: Array
    joints: list[str]
    chains: Chains

    def wanted(self, time: float) -> RigidTransform:
        """Planned X_WO at any time; before and after its path the object rests."""
        return self.path.GetPose(min(max(time, self.t[0]), self.t[-1]))


def goal_of(config: StationConfig) -> RigidTransform:
    """X_WO after the rotations `turn`, one after another, and the shift `move`."""
    R = Rotation.identity()
    for turn in config.turn:
        R = Rotation.from_rotvec(turn, degrees=True) * R
    return RigidTransform(RotationMatrix(R.as_matrix()), config.move)


def plan_reorientation(
    hand: Hand,
    scene: Scene,
    X_WO_goal: RigidTransform | None = None,
    path: Any = None,
    config: StationConfig | None = None,
) -> Reorientation:
    """Plan how a hand brings an object from the world's origin to a pose while fingers roll on it.

    Every finger keeps its contact and rolls without slip; docs/hands.md tells how that is planned.

    Parameters
    ----------
    hand : Hand
    scene : Scene
        At the start each finger touches the object at the contact's ``object_at``; the middle of
        its pad is at ``finger_at``. The ``[drake]`` table gives masses, friction and gravity.
    X_WO_goal : RigidTransform, optional
        None: the pose that the table's `turn` and `move` give.
    path : PiecewisePose, optional
        X_WO; any object with the same methods will do. None: the shortest path, from rest to rest.
        Before and after its path the object rests.
    config : StationConfig, optional
        None: the scene's table.

    Raises
    ------
    SceneError
        A finger does not reach its contact or a limit of a joint is in its way; a contact leaves
        its pad, or the object's end, or would slip; fingertips overlap; no forces balance the
        wrench; a joint's speed or torque is beyond its limit; a path is not within the scene's
        duration.
    """
    of_kind(Hand, hand, "hand", "a Hand")
    if config is None:
        config = StationConfig.from_scene(scene, hand=hand)
    of_kind(StationConfig, config, "config", "a StationConfig")
    config = dataclasses.replace(config, hand=hand)
    with naming(scene.title):
        config.check(scene)
        if path is None:
            goal = goal_of(config) if X_WO_goal is None else X_WO_goal
            of_kind(RigidTransform, goal, "X_WO_goal", "a RigidTransform")
            path = ShortestPath(goal, BEGIN * scene.duration, END * scene.duration)
        elif X_WO_goal is not None:
            raise SceneError("X_WO_goal: a path ends at its own pose; give one of both")
        elif not hasattr(path, "GetAcceleration"):
            raise SceneError(f"path = {path!r:.80}: give a PiecewisePose")
        elif not 0 <= path.start_time() < path.end_time() <= scene.duration:
            raise SceneError(
                f"path: it lasts from {path.start_time():g} to {path.end_time():g} s, the scene "
                f"from 0 to duration = {scene.duration:g} s; give a path within"
            )
        scene = scene.replace(drake=config.table())
        check_surfaces(scene, config)
        inertia = object_inertia(scene, config)
        plan = _planned(scene, config, path, inertia, config.normal_force)
        mean = float(np.mean(np.einsum("mij,mij->mi", plan.forces, plan.normals)))
        if mean > (1 + DEEPER) * config.normal_force:
            pressed = dataclasses.replace(config, normal_force=mean)
            plan = _planned(scene, pressed, path, inertia, config.normal_force)
        return plan


@np.errstate(under="ignore")  # solve_ivp computes the spacing of doubles at 0, which underflows
def _rolled(chains: Chains, path: Any) -> tuple[Array, Array, Array]:
    """Times, (m,), joint positions and velocities, (m, nq), with which tips roll along the path."""
    scene, X_WO = chains.scene, path.GetPose(path.start_time())
    points = np.array([scene.object.point(*c.object_at) for c in scene.contacts])
    normals = np.array([scene.object.normal(*c.object_at) for c in scene.contacts])
    R = X_WO.rotation().matrix()
    q_start = chains.reach(points @ R.T + X_WO.translation(), normals @ R.T)

    def rates(time: float, q: Array) -> Array:
        with naming(f"t = {time:.3g} s"):
            return chains.rolling(q, path.GetPose(time), path.GetVelocity(time))

    def room(time: float, q: Array) -> float:
        return float(chains.room(q).min())  # at 0, the limit of a joint, the integration ends

    room.terminal = True  # type: ignore[attr-defined]
    span = path.start_time(), path.end_time()
    # without 1.001 rounding may leave a last step of 1e-17 s, and nonsense for its acceleration
    longest, error = 1.001 * (span[1] - span[0]) / STEPS, ACCURATE * chains.unit
    made = solve_ivp(rates, span, q_start, max_step=longest, events=room, rtol=ACCURATE, atol=error)
    t, q = made.t, made.y.T
    chains.refuse_limits(t, q)
    return t, q, np.array([rates(*each) for each in zip(t, q)])


def _routed(chains: Chains, path: Any, t: Array, q: Array) -> tuple[Array, Array, Array, Scene]:
    """Times, joint positions and velocities, and the scene with the legs that fingers follow.

    t, q : times and joint positions of `_rolled`. Fingers can reach the places on the object where
        it ends, so legs of `cs.reach` lead there, but on the pads and without spin.
    """
    found = contacts_of(chains, path, t[[0, -1]], q[[0, -1]], np.zeros((2, q.shape[1])))
    first, last = found[..., STATES]
    goals = [
        Goal(object_at=state[4:6], finger_within=(*contact.finger_at, chains.hand.pad))
        for state, contact in zip(last, chains.scene.contacts)
    ]
    start = _starting(chains.scene, first).replace(duration=t[-1] - t[0])
    route = reach(start, goals).scene
    t = np.linspace(t[0], t[-1], max(LEG_NODES, len(t)))
    curves = make_plan(route).evaluate(t - t[0], "pose", "twist")
    near, rows = q[0], []
    for time, poses, twists in zip(t, curves["pose"], curves["twist"]):
        X_WO, V_WO = path.GetPose(time), path.GetVelocity(time)
        R = X_WO.rotation().matrix()
        swept = np.cross(V_WO[:3], poses[:, :3, 3] @ R.T)
        V_WF = V_WO + np.hstack([twists[:, :3] @ R.T, twists[:, 3:] @ R.T + swept])
        q = chains.positions(time, near, [X_WO @ RigidTransform(X_OF) for X_OF in poses])
        v = chains.velocities(q, V_WF)
        rows.append((q, v))
        near = q + (t[1] - t[0]) * v
    q, v = np.array(rows).swapaxes(0, 1)
    chains.refuse_limits(t, q)
    chains.refuse_speeds(t, v)
    return t, q, v, route


def _starting(scene: Scene, states: Any) -> Scene:
    """The scene with contacts that start at the places and angles of states, (n, 9)."""
    contacts = [
        dataclasses.replace(contact, finger_at=x[:2], object_at=x[4:6], angle=x[8])
        for contact, x in zip(scene.contacts, states)
    ]
    return scene.replace(contacts=contacts)


def _planned(
    scene: Scene, config: StationConfig, path: Any, inertia: SpatialInertia, least: float
) -> Reorientation:
    """The plan with contacts as deep as the configuration's normal force presses them in, and with
    normal forces of at least ``least``, N."""
    assert config.hand is not None
    rolling = rolling_scene(resting(scene), config)
    chains = Chains(config.hand, rolling, config.finger_mass, config.gravity)
    (t, q, v), route = _rolled(chains, path), None
    if min(map(len, chains.joints)) >= FREE:
        with contextlib.suppress(SceneError):  # those that cannot follow legs spin
            t, q, v, route = _routed(chains, path, t, q)
    chains.refuse_speeds(t, v)
    X_WO = np.array([path.GetPose(time).GetAsMatrix4() for time in t])
    R = X_WO[:, :3, :3]
    found = contacts_of(chains, path, t, q, v)
    states = found[..., STATES]
    points = np.stack([found[..., ON_FINGER], found[..., ON_OBJECT]], axis=2)
    _refuse_pads(rolling, config.hand, t, points[:, :, 0])
    _refuse_ends(rolling, t, points[:, :, 1])
    _refuse_overlap(scene, t, points[:, :, 1], found[..., NORMAL])
    normals, arms = (
        np.einsum("mij,mnj->mni", R, part) for part in (-found[..., NORMAL], points[:, :, 1])
    )
    rest = np.zeros((2, 6))  # before and after the path
    motion = path.GetVelocity, path.GetAcceleration
    V, A = (np.vstack([[get(x) for x in t], rest]) for get in motion)
    k = [*range(len(t)), 0, -1]
    wrench = needed_wrench(inertia, [0, 0, -config.gravity], R[k], V, A)
    wanted = [np.einsum("mij,mj->mi", R[k], part) for part in wrench]
    contacts, share = (arms[k], normals[k], config.friction), config.friction_share
    forces = balancing_forces(*contacts, *wanted, margin=share, least=least, t=t[k])
    forces, at_rest = np.split(forces, [-2])
    a = CubicHermiteSpline(t, q, v).derivative(2)(t)
    return Reorientation(
        hand=config.hand,
        scene=scene,
        config=config,
        rolling=_starting(rolling, states[0]),
        route=route,
        path=path,
        t=t,
        object_pose=X_WO,
        q=q,
        v=v,
        a=a,
        points=points,
        normals=normals,
        forces=forces,
        resting=at_rest,
        states=states,
        slip=np.linalg.norm(found[..., SLIP], axis=-1),
        spin=found[..., FOUND],
        cones=friction_used(forces, normals, config.friction),
        torques=_torques(chains, t, q, v, a, points[:, :, 0], forces),
        joints=chains.names,
        chains=chains,
    )


def contacts_of(chains: Chains, path: Any, t: Array, q: Array, v: Array) -> Array:
    """Every contact's `Probe.found` and, in column FOUND, its spin, rad/s: (m, n, FOUND + 1)."""
    rows = np.empty((len(q), len(chains.joints), FOUND + 1))
    for k, time in enumerate(t):
        X_WO, V_WO = path.GetPose(time), SpatialVelocity(path.GetVelocity(time))
        chains.set_state(q[k], v[k])
        for i, tip in enumerate(chains.tips):
            swept = V_WO.Shift(chains.pose(i).translation() - X_WO.translation())
            V_OF_W = tip.EvalSpatialVelocityInWorld(chains.context) - swept
            twist = V_OF_W.Rotate(X_WO.rotation().inverse()).get_coeffs()
            rows[k, i, :FOUND] = at = chains.touch(i, X_WO, twist)
            rows[k, i, FOUND] = at[NORMAL] @ twist[:3]
    return rows


def _refuse_pads(scene: Scene, hand: Hand, t: Array, points: Array) -> None:
    """Raise a SceneError if a contact leaves its pad; points (m, n, 3) on the fingers."""
    for i, contact in enumerate(scene.contacts):
        away = np.linalg.norm(points[:, i] - contact.finger.point(*contact.finger_at), axis=1)
        if away.max() > hand.pad:
            k = int(np.argmax(away > hand.pad))
            if k == 0:
                raise SceneError(
                    f"{scene.contact_title(i)} begins {away[0]:.4g} m from the middle of its pad, "
                    f"pad = {hand.pad:g} m; give the finger_at that the hand turns to the object, "
                    "a larger pad, or put the hand elsewhere"
                )
            raise SceneError(
                f"{scene.contact_title(i)} rolls off its pad, pad = {hand.pad:g} m, at t = "
                f"{t[k]:.3g} s, and would come to {away.max():.4g} m from the pad's middle; turn "
                "or move the object less, or give a larger pad"
            )


def _refuse_ends(scene: Scene, t: Array, points: Array) -> None:
    """Raise a SceneError if a contact leaves a cylinder; points (m, n, 3) on the object."""
    end = np.abs(points[0, :, 2]).max() + REACH  # z, as of the plant's mesh
    if isinstance(scene.object, Cylinder) and (over := np.abs(points[..., 2]) > end).any():
        k, i = np.argwhere(over)[0]
        raise SceneError(
            f"{scene.contact_title(i)} rolls off the object's end: at t = {t[k]:.3g} s it touches "
            f"at z = {points[k, i, 2]:.3g} m, and a cylinder ends {REACH:g} m beyond the contacts "
            "at the start; turn it less"
        )


def _refuse_overlap(scene: Scene, t: Array, points: Array, normals: Array) -> None:
    """Raise a SceneError if fingertips overlap, which in the plant pass through each other; points
    on the object and normals out of it, (m, n, 3)."""
    sizes = np.array([[contact.finger.size] for contact in scene.contacts])
    centres = points + sizes * normals
    for i, j in itertools.combinations(range(len(sizes)), 2):
        apart = np.linalg.norm(centres[:, i] - centres[:, j], axis=1)
        if (over := apart < sizes[i] + sizes[j]).any():
            raise SceneError(
                f"{scene.contact_title(i)} and {scene.contact_title(j)} overlap at t = "
                f"{t[np.argmax(over)]:.3g} s; put contacts farther apart, or give smaller fingers"
            )


def object_inertia(scene: Scene, config: StationConfig) -> SpatialInertia:
    """Inertia of the object, a homogeneous solid, in the plant of the scene."""
    if isinstance(scene.object, (Sphere, Ellipsoid)):
        return solid_inertia("object", scene.object, config.object_mass)
    # computed from the object's mesh, which takes half a second to build
    parts = AddScenePlant(DiagramBuilder(), scene, config)
    return parts.object_body.default_spatial_inertia()


def _torques(
    chains: Chains, t: Array, q: Array, v: Array, a: Array, points: Array, forces: Array
) -> Array:
    """Torques (m, nq) that move joints, carry links and exert forces; SceneError beyond a limit."""
    moving, pressing = np.zeros((2, *q.shape))
    for k in range(len(q)):
        chains.set_state(q[k], v[k])
        moving[k] = chains.inverse_dynamics(a[k])
        for i, (x, force) in enumerate(zip(points[k], forces[k])):
            pressing[k] += chains.jacobian(i, x)[3:].T @ force
    found = moving + pressing
    over = np.abs(found) > chains.effort
    if over.any():
        k, joint = np.argwhere(over)[0]
        unit, limit = "N" if chains.slides[joint] else "N m", chains.effort[joint]
        less = "press or carry less, " if abs(moving[k, joint]) < limit else ""
        raise SceneError(
            f"joint {chains.names[joint]} needs {found[k, joint]:.3g} {unit} at t = {t[k]:.3g} s, "
            f"its limit is {limit:.3g}; {less}move more gently, or give a stronger hand"
        )
    return found
