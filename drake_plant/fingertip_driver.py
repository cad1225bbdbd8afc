r"""Forces that move free fingertips as planned relative to a moving object.

A fingertip is a free body. Its force is what the planned motion needs (feed-forward), the normal
force along the planned normal through the planned contact point, and tracking in the tangent plane;
along the normal there is only a damper, so that the contact itself decides how far the finger sinks
in. Slip that is really there is rejected by the paper's own term, an acceleration of -lam times it,
with the planned curve held: to plan anew from where a pushed finger is adds slip.

Two things decide how steady the normal force is, because the fingers of D1 need up to 8 N of
centripetal force beside the 1 N of contact, and those of D3 150 N:

* What a discrete plant needs (semi-implicit Euler, step h). Its velocity at t_k moved the body from
  t_{k-1} to t_k, so the velocity to track is the backward difference of desired positions. Its
  acceleration leads to the next backward difference, so the one to feed forward is the second
  difference, ``A + h^2/12 A''``. With the values at t_k instead, the force of D1 is wrong by 5 %.
* The error lives in a frame that turns with the contact normal at Omega = n x n', of which the
  normals of two steps, ``n_before x n = h Omega``, tell the plan's part. A finger that is
  off by a constant e there goes round with the plan and needs ``Omega x (Omega x e)`` less. Without
  this term e is driven away with a stiffness of -m Omega^2, 1000 N/m in D3; without the Coriolis
  term friction that drags the finger sideways shows in its normal force.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex, RigidBody, world_index
from pydrake.systems.framework import Context, InputPort, LeafSystem, State

from contact_system import SceneError
from contact_system.engine.binding import run
from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table
from contact_system.theory.symbols import per_structure

from .config import GAINS, require_config
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plant import ScenePlant

Array = NDArray[np.float64]
SHARE = 0.4
"""Of a velocity what an explicit damper may take in a step h, of an error what an explicit spring
may take over h; a damper's d and a spring's s are stable where 0 < d and s + 2 d < 4."""

SLIP_SHARE = 0.5
"""Of slip what may be taken away in a step: more would turn it over where friction helps."""

OFF = 1e-4
"""Of a finger's size, how far its mass centre may be from its origin."""


# Rows of the table's inputs: what the object, the plan, the finger, the steps before and sensors
# give.
_OBJECT = ("R_WO", "p_WO", "w_WO", "v_WO", "alpha_WO", "a_WO")
_PLAN = ("R_OF", "p_OF", "w_OF", "v_OF", "alpha_OF", "a_OF", "normal", "point")
_FINGER = ("R_WF", "p_WF", "w_WF", "v_WF")
_BEFORE = ("steps", "position", "spin", "normal_before", "a_before", "a_earlier")
_NOW = ("sliding", "push", "normal_rate")
POINT = dict.fromkeys((*_OBJECT, *_PLAN, *_FINGER, *_BEFORE, *_NOW), 3)
POINT |= {"R_WO": 9, "R_OF": 9, "R_WF": 9, "steps": 1}
CONSTANT = {"h": 1, "mass": 1, "inertia": 9, "gravity": 3, "normal_force": 1}
CONSTANT |= dict.fromkeys((*GAINS, "slip_gain"), 1)
KEPT = 17
"""Numbers a finger that its driver keeps from step to step."""


@per_structure
def driving_law() -> Table:
    """Table of one finger: `POINT`, `CONSTANT` -> torque (3), force (3), desired position (3).

    All in the world. Rotations are given row by row.
    """

    def symbols(sizes: dict[str, int]) -> tuple[ca.SX, SimpleNamespace]:
        every = {name: ca.SX.sym(name, n) for name, n in sizes.items()}
        shaped = {k: ca.reshape(v, 3, 3).T if v.numel() == 9 else v for k, v in every.items()}
        return ca.vertcat(*every.values()), SimpleNamespace(**shaped)

    point, x = symbols(POINT)
    constant, c = symbols(CONSTANT)
    wanted = _desired_motion(x, c.h)
    force, torque = _force(x, c, wanted), _torque(x, c, wanted)
    found = ca.densify(ca.vertcat(torque, force, wanted.position))
    return Table(ca.Function("driving", [point, constant], [found]))


def _desired_motion(x: SimpleNamespace, h: ca.SX) -> SimpleNamespace:
    """The plan carried by the object, in the world, as a discrete plant needs it.

    position and acceleration ``a`` of now; velocity ``ago``, which brought the finger here; ``w``
    and ``alpha``; the contact's normal and how fast it turns.
    """
    cross, begun = ca.cross, x.steps > 0
    arm, v, spin = x.R_WO @ x.p_OF, x.R_WO @ x.v_OF, x.R_WO @ x.w_OF
    position, swept = x.p_WO + arm, cross(x.w_WO, arm)
    second = (x.a_OF - 2 * x.a_before + x.a_earlier) / 12  # h^2/12 A''
    a = x.a_WO + cross(x.alpha_WO, arm) + cross(x.w_WO, swept + 2 * v)
    a += x.R_WO @ (x.a_OF + ca.if_else(x.steps > 1, second, 0))
    ago = ca.if_else(begun, (position - x.position) / h, x.v_WO + swept + v - 0.5 * h * a)
    w = x.w_WO + ca.if_else(begun, 0.5 * (spin + x.R_WO @ x.spin), spin)
    alpha = x.alpha_WO + x.R_WO @ x.alpha_OF + cross(x.w_WO, spin)
    normal = x.R_WO @ x.normal
    turned = cross(x.normal_before, x.normal) / h
    turned = x.R_WO @ ca.if_else(begun, turned, cross(x.normal, x.normal_rate))
    turning = turned + x.w_WO - ca.dot(x.w_WO, normal) * normal
    return SimpleNamespace(
        position=position, ago=ago, a=a, w=w, alpha=alpha, normal=normal, turning=turning
    )


def _force(x: SimpleNamespace, c: SimpleNamespace, wanted: SimpleNamespace) -> ca.SX:
    """Feed-forward, pressing, tracking in the frame that turns with the contact, slip, a push."""
    cross, normal, turning = ca.cross, wanted.normal, wanted.turning
    error, error_rate = wanted.position - x.p_WF, wanted.ago - x.v_WF
    # The velocities are those of half a step ago, so the error has to be too.
    error_rate -= cross(turning, error - 0.5 * c.h * error_rate)
    a = wanted.a - 2 * cross(turning, error_rate) - cross(turning, cross(turning, error))
    a += c.slip_gain * (x.R_WO @ x.sliding)  # v_rel: minus the finger's velocity on the object
    approach = ca.dot(error_rate, normal)
    force = c.mass * (a - c.gravity) + (c.normal_damping * approach - c.normal_force) * normal
    force += c.position_gain * (error - ca.dot(error, normal) * normal)
    return force + c.velocity_gain * (error_rate - approach * normal) + x.push


def _torque(x: SimpleNamespace, c: SimpleNamespace, wanted: SimpleNamespace) -> ca.SX:
    """Feed-forward, the normal force through the contact point, damping of spin."""
    inertia, w = x.R_WF @ c.inertia @ x.R_WF.T, wanted.w
    off = x.R_WO @ x.R_OF @ x.R_WF.T
    axis = 0.5 * ca.vertcat(off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1])
    torque = inertia @ wanted.alpha + ca.cross(w, inertia @ w)
    torque += c.spin_gain * (w - x.w_WF) + c.rotation_gain * axis
    return torque - c.normal_force * ca.cross(x.R_WO @ x.R_OF @ x.point, wanted.normal)


class FingertipDriver(LeafSystem):
    """Planned motion relative to the object, and the object's own, to forces on the fingertips.

    .. pydrake_system::

        name: FingertipDriver
        input_ports:
        - pose
        - twist
        - acceleration
        - normal
        - normal_rate (of a continuous plant)
        - contact_point
        - body_poses
        - body_spatial_velocities
        - body_spatial_accelerations
        - restarts (optional)
        - sliding (optional)
        - push (optional)
        output_ports:
        - spatial_forces

    The first six are :class:`ContactPlanner`'s outputs, the next three the plant's. What is
    optional is zero where nothing is connected:

    - `restarts` (n): how often the plan of each finger began anew, as a planner that restarts says
      it. No difference is taken across that.
    - `sliding` (3n): slip to be rejected, as :class:`ContactMonitor` gives it.
    - `push` (3n + 3): forces in the world on the fingers and on the object, N.

    The output is a list of ExternallyAppliedSpatialForce, one a fingertip and one on an object that
    is pushed, at their mass centres.

    Where the plant is discrete, a discrete state holds 17 numbers a finger: its restarts, the steps
    since the last one, its desired position in the world, planned spin and normal one step ago, and
    planned accelerations one and two steps ago.

    Parameters
    ----------
    scene_plant : ScenePlant
        Finalized; if it is discrete, with sampled output ports as Drake's own are, and if it is
        continuous, with an :class:`ObjectAcceleration` for the last port. Its configuration says
        the normal force and the gains, its bodies' defaults the masses, whatever a Context says.

    Raises
    ------
    SceneError
        No ScenePlant; a discrete plant without sampled output ports, or whose steps
        are too long for a finger; a finger that is not free, or whose mass centre is
        not its origin. In a simulation: more or fewer poses than fingers.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, scene_plant: ScenePlant):
        super().__init__()
        require_config(scene_plant, ScenePlant, "scene_plant")
        plant, fingers = scene_plant.plant, scene_plant.finger_bodies
        # What the plant is made from; the plant itself would keep this system for ever.
        self.scene, self.config = scene_plant.scene, scene_plant.config
        self.object_index = int(scene_plant.object_body.index())
        self.finger_indices = [body.index() for body in fingers]
        _check(scene_plant)
        self._constants = np.transpose([_constants(body, scene_plant) for body in fingers])
        n = len(fingers)
        poses, motions = Value[list[RigidTransform]], Value[list[SpatialVelocity]]
        self._pose = self.DeclareAbstractInputPort("pose", poses())
        self._twist = self.DeclareVectorInputPort("twist", 6 * n)
        self._acceleration = self.DeclareVectorInputPort("acceleration", 6 * n)
        self._normal = self.DeclareVectorInputPort("normal", 3 * n)
        self._point = self.DeclareVectorInputPort("contact_point", 6 * n)
        self._poses = self.DeclareAbstractInputPort("body_poses", poses())
        self._velocities = self.DeclareAbstractInputPort("body_spatial_velocities", motions())
        self._accelerations = self.DeclareAbstractInputPort(
            "body_spatial_accelerations", Value[list[SpatialAcceleration]]()
        )
        self._restarts = self.DeclareVectorInputPort("restarts", n)
        self._sliding = self.DeclareVectorInputPort("sliding", 3 * n)
        self._push = self.DeclareVectorInputPort("push", 3 * n + 3)
        forces = Value[list[ExternallyAppliedSpatialForce]]
        step = plant.time_step()
        self._normal_rate: Any = None
        if not step:  # else differences tell it
            self._normal_rate = self.DeclareVectorInputPort("normal_rate", 3 * n)
        needs = (self.all_input_ports_ticket(), self.xd_ticket() if step else self.nothing_ticket())
        law, self._law = array_entry(self._CalcLaw, (n, 9), needs)
        self.DeclareAbstractOutputPort("spatial_forces", forces, weakly(self._CalcForces), {law})
        if not step:
            return
        self.DeclareDiscreteState(KEPT * n)
        # Unrestricted, because the plant's step is such an update (for its sampled ports), and
        # those come before discrete ones: a discrete update would see the object a step ahead.
        self.DeclarePeriodicUnrestrictedUpdateEvent(step, 0.0, weakly(self._Remember))

    def _CalcLaw(self, context: Context) -> Array:
        """Torque, force and desired position of each finger: (n, 9)."""
        X, V = self._poses.Eval(context), self._velocities.Eval(context)
        A, X_OF = self._accelerations.Eval(context), self._pose.Eval(context)
        twist, acceleration = self._twist.Eval(context), self._acceleration.Eval(context)
        normal, point = self._normal.Eval(context), self._point.Eval(context)
        fingers = len(self.finger_indices)
        if len(X_OF) != fingers:  # Drake compares sizes of vectors only
            raise SceneError(
                f"{self.scene.title}: {len(X_OF)} poses on the driver's input port 'pose' "
                f"for {fingers} fingers; connect the planner of this scene"
            )
        x, o = np.empty((fingers, sum(POINT.values()))), self.object_index
        x[:, 0:12] = _numbers(X[o])
        x[:, 12:18], x[:, 18:24] = V[o].get_coeffs(), A[o].get_coeffs()
        x[:, 24:36] = [_numbers(pose) for pose in X_OF]
        x[:, 36:42], x[:, 42:48] = twist.reshape(-1, 6), acceleration.reshape(-1, 6)
        x[:, 48:51], x[:, 51:54] = normal.reshape(-1, 3), point.reshape(-1, 6)[:, :3]
        x[:, 54:66] = [_numbers(X[i]) for i in self.finger_indices]
        x[:, 66:72] = [V[i].get_coeffs() for i in self.finger_indices]
        x[:, 72:88] = self._Before(context)[:, 1:]
        x[:, 88:91] = _given(self._sliding, context).reshape(-1, 3)
        x[:, 91:94] = _given(self._push, context)[:-3].reshape(-1, 3)
        x[:, 94:97] = 0.0
        if self._normal_rate is not None:
            x[:, 94:97] = self._normal_rate.Eval(context).reshape(-1, 3)
        return run(driving_law(), x.T, self._constants).T

    def _Before(self, context: Context) -> Array:
        """What is kept, (n, 17), with no steps behind those that have restarted since."""
        kept = np.zeros((len(self.finger_indices), KEPT))
        if context.num_discrete_state_groups():
            kept[:] = context.get_discrete_state_vector().value().reshape(-1, KEPT)
        restarts = _given(self._restarts, context)
        kept[restarts != kept[:, 0], 1] = 0
        kept[:, 0] = restarts
        return kept

    def _CalcForces(self, context: Context, output: Value) -> None:
        driven = zip(self.finger_indices, self._law(context))
        applied = [_at_centre(index, row[0:3], row[3:6]) for index, row in driven]
        if (pushed := _given(self._push, context)[-3:]).any():
            applied.append(_at_centre(BodyIndex(self.object_index), np.zeros(3), pushed))
        output.set_value(applied)

    def _Remember(self, context: Context, state: State) -> None:
        position, before = self._law(context)[:, 6:], self._Before(context)
        now = state.get_mutable_discrete_state().get_mutable_value()
        spin = self._twist.Eval(context).reshape(-1, 6)[:, :3]
        normal = self._normal.Eval(context).reshape(-1, 3)
        a = self._acceleration.Eval(context).reshape(-1, 6)[:, 3:]
        steps = before[:, :2] + [0, 1]
        now[:] = np.hstack([steps, position, spin, normal, a, before[:, 11:14]]).ravel()


def _at_centre(body: BodyIndex, torque: Array, force: Array) -> ExternallyAppliedSpatialForce:
    applied = ExternallyAppliedSpatialForce()
    applied.body_index, applied.p_BoBq_B = body, np.zeros(3)
    applied.F_Bq_W = SpatialForce(torque, force)
    return applied


def _given(port: InputPort, context: Context) -> Array:
    """What a port has, zeros where nothing is connected to it."""
    return port.Eval(context) if port.HasValue(context) else np.zeros(port.size())


def _numbers(X: RigidTransform) -> Array:
    """Rotation row by row, then translation: (12,)."""
    matrix = X.GetAsMatrix34()
    return np.concatenate([matrix[:, :3], matrix[:, 3]], axis=None)


def _check(parts: ScenePlant) -> None:
    """Refuse what the forces are not made for, such as steps in which nothing explicit can hold a
    finger.

    A force N that presses a body of size a on one of size b pushes it off with N/(a + b) times the
    error.
    """
    scene, config, step = parts.scene, parts.config, parts.plant.time_step()
    if step and not parts.plant.has_sampled_output_ports():  # Drake would tell of an algebraic loop
        raise SceneError(
            f"{scene.title}: the plant has no sampled output ports, so that its accelerations "
            "depend on the forces that are made from them; give MultibodyPlantConfig "
            "use_sampled_output_ports=True"
        )
    joints = list(map(parts.plant.get_joint, parts.plant.GetJointIndices()))
    for i, (contact, body) in enumerate(zip(scene.contacts, parts.finger_bodies)):
        for joint in joints:
            inboard, index = joint.parent_body().index(), body.index()
            free = joint.num_velocities() == 6 and inboard == world_index()
            if inboard == index or (joint.child_body().index() == index and not free):
                raise SceneError(
                    f"{scene.title}, contact {i}: body '{body.name()}' is not free, but has the "
                    f"joint '{joint.name()}'; forces are made for a body that moves alone: take "
                    "the joint away, and make one body of several that are welded together"
                )
        mass, center = body.default_mass(), body.default_com()
        if not np.linalg.norm(center) <= OFF * contact.finger.size:
            raise SceneError(
                f"{scene.title}, contact {i}: the mass centre of body '{body.name()}' is at "
                f"{center.tolist()} m in its frame; forces are made for one at the origin, which "
                "is that of the finger's surface: give the body such an inertia"
            )
        borne = SHARE * mass / step**2 if step else math.inf
        needed = config.normal_force / (contact.finger.size + scene.object.size)
        if borne < needed:
            raise SceneError(
                f"{scene.title}, contact {i}: time_step = {step!r}: a finger of "
                f"{mass:g} kg can be held with {borne:.3g} N/m, and pressing with "
                f"{config.normal_force:g} N needs {needed:.3g} N/m; give at most "
                f"{math.sqrt(SHARE * mass / needed):.2g} s, or a heavier finger"
            )


def _constants(body: RigidBody, parts: ScenePlant) -> list[float]:
    """`CONSTANT` of a finger."""
    config = parts.config
    h, mass = parts.plant.time_step(), body.default_mass()
    inertia = body.default_spatial_inertia().CalcRotationalInertia().CopyToFullMatrix3()
    # A model's gravity may be switched off.
    heavy = parts.plant.is_gravity_enabled(body.model_instance())
    gravity = float(heavy) * parts.plant.gravity_field().gravity_vector()
    least = float(np.linalg.eigvalsh(inertia)[0])

    # of each gain, what it moves and to which power the step divides what is borne
    moved = ((mass, 2), (mass, 1), (mass, 1), (least, 2), (least, 1))
    borne = [SHARE * inert / h**order if h else math.inf for inert, order in moved]
    gains = [min(getattr(config, name), most) for name, most in zip(GAINS, borne)]
    gains.append(min(config.slip_gain, SLIP_SHARE / h if h else math.inf))
    return [h, mass, *inertia.ravel(), *gravity, config.normal_force, *gains]
