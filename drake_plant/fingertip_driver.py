r"""Forces that move free fingertips as planned relative to a moving object.

A fingertip is a free body. Its force is what the planned motion needs (feed-forward), the normal
force along the planned normal, and tracking in the tangent plane; along the normal there is only a
damper, so that the contact itself decides how far the finger sinks in.

Two things decide how steady the normal force is, because the fingers of D1 need up to 9 N of
centripetal force beside the 1 N of contact, and those of D3 150 N:

* What a discrete plant needs (semi-implicit Euler, step h). Its velocity at t_k moved the body from
  t_{k-1} to t_k, so the velocity to track is the backward difference of desired positions. Its
  acceleration leads to the next backward difference, so the one to feed forward is the second
  difference, ``A + h^2/12 A''``. With the values at t_k instead, the force of D1 is wrong by 5 %.
* The error lives in a frame that turns with the contact normal at Omega = n x n'. A finger that is
  off by a constant e there goes round with the plan and needs ``Omega x (Omega x e)`` less. Without
  this term e is driven away with a stiffness of -m Omega^2, 1000 N/m in D3; without the Coriolis
  term friction that drags the finger sideways shows in its normal force.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context, LeafSystem, State, ValueProducer

from contact_system.kernels import Kernel, Machine

from .lifetimes import NO_DICTIONARY, weakly
from .plant import ScenePlant

SX = ca.SX
Array = NDArray[np.float64]


@dataclass
class DriverConfig:
    """Gains of a :class:`FingertipDriver`.

    Attributes
    ----------
    normal_force : float
        N, along the planned normal, towards the object.
    position_gain, velocity_gain : float
        N/m and N s/m, in the tangent plane.
    normal_damping : float
        N s/m, along the normal; at most 0.4 m/h is used, which an explicit force bears. The sap
        solver lifts a sliding contact by h mu |slip|; much damping would turn changes of that into
        normal force (100 N s/m: 2.4 % in D1, 30: 0.8 %).
    rotation_gain, spin_gain : float
        N m and N m s. With a rotation_gain of 0 the finger may roll on the radius that the
        penetration leaves it, and no friction comes from that; spheres have no orientation to keep.
    """

    normal_force: float = 1.0
    position_gain: float = 400.0
    velocity_gain: float = 60.0
    normal_damping: float = 30.0
    rotation_gain: float = 0.0
    spin_gain: float = 0.04


# Rows of the kernel's inputs: what the object, the plan, the finger and the steps before give.
POINT = {
    "R_WO": 9, "p_WO": 3, "w_WO": 3, "v_WO": 3, "alpha_WO": 3, "a_WO": 3,
    "R_OF": 9, "p_OF": 3, "w_OF": 3, "v_OF": 3, "alpha_OF": 3, "a_OF": 3, "normal": 3,
    "R_WF": 9, "p_WF": 3, "w_WF": 3, "v_WF": 3,
    "steps": 1, "position": 3, "spin": 3, "a_before": 3, "a_earlier": 3,
}  # fmt: skip
CONSTANT = {
    "h": 1, "mass": 1, "inertia": 9, "gravity": 3, "normal_force": 1, "position_gain": 1,
    "velocity_gain": 1, "normal_damping": 1, "rotation_gain": 1, "spin_gain": 1,
}  # fmt: skip


@functools.cache
def driving_law() -> Kernel:
    """Kernel of one finger: `POINT`, `CONSTANT` -> torque (3), force (3), desired position (3).

    All in the world. Rotations are given row by row.
    """

    def symbols(sizes: dict[str, int]) -> tuple[SX, dict[str, Any]]:
        every = {name: SX.sym(name, n) for name, n in sizes.items()}
        shaped = {k: ca.reshape(v, 3, 3).T if v.numel() == 9 else v for k, v in every.items()}
        return ca.vertcat(*every.values()), shaped

    point, now = symbols(POINT)
    constant, given = symbols(CONSTANT)
    x, c = SimpleNamespace(**now), SimpleNamespace(**given)
    cross, dot, h = ca.cross, ca.dot, c.h

    # Desired motion in the world: the plan carried by the object.
    arm, v, spin = x.R_WO @ x.p_OF, x.R_WO @ x.v_OF, x.R_WO @ x.w_OF
    position, swept = x.p_WO + arm, cross(x.w_WO, arm)
    second = (x.a_OF - 2 * x.a_before + x.a_earlier) / 12  # h^2/12 A''
    a = x.a_WO + cross(x.alpha_WO, arm) + cross(x.w_WO, swept + 2 * v)
    a += x.R_WO @ (x.a_OF + ca.if_else(x.steps > 1, second, 0))
    ago = ca.if_else(x.steps > 0, (position - x.position) / h, x.v_WO + swept + v - 0.5 * h * a)
    w = x.w_WO + ca.if_else(x.steps > 0, 0.5 * (spin + x.R_WO @ x.spin), spin)
    alpha = x.alpha_WO + x.R_WO @ x.alpha_OF + cross(x.w_WO, spin)

    # The finger's centre moves in the tangent plane, n.v = 0, so n.a = -n'.v gives n'.
    bend = -dot(x.normal, x.a_OF) / ca.fmax(dot(x.v_OF, x.v_OF), 1e-30)
    normal = x.R_WO @ x.normal
    turning = cross(normal, bend * v + cross(x.w_WO, normal))

    error, error_rate = position - x.p_WF, ago - x.v_WF
    # The velocities are those of half a step ago, so the error has to be too.
    error_rate -= cross(turning, error - 0.5 * h * error_rate)
    a -= 2 * cross(turning, error_rate) + cross(turning, cross(turning, error))
    approach = dot(error_rate, normal)
    force = c.mass * (a - c.gravity) + (c.normal_damping * approach - c.normal_force) * normal
    force += c.position_gain * (error - dot(error, normal) * normal)
    force += c.velocity_gain * (error_rate - approach * normal)

    inertia = x.R_WF @ c.inertia @ x.R_WF.T
    off = x.R_WO @ x.R_OF @ x.R_WF.T
    axis = 0.5 * ca.vertcat(off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1])
    torque = inertia @ alpha + cross(w, inertia @ w)
    torque += c.spin_gain * (w - x.w_WF) + c.rotation_gain * axis
    return Kernel("driving", point, constant, ca.vertcat(torque, force, position))


class FingertipDriver(LeafSystem):
    """Planned motion relative to the object, and the object's own, to forces on the fingertips.

    .. pydrake_system::

        name: FingertipDriver
        input_ports:
        - pose
        - twist
        - acceleration
        - normal
        - body_poses
        - body_spatial_velocities
        - body_spatial_accelerations
        output_ports:
        - spatial_forces

    The first four are :class:`ContactPlanner`'s outputs, the others the plant's. The output is a
    list of ExternallyAppliedSpatialForce, one a fingertip, at its mass centre.

    With a discrete plant the discrete state counts the steps and holds the fingers' desired
    positions in the world and planned spins one step ago, and planned accelerations one and two
    steps ago.

    Parameters
    ----------
    scene_plant : ScenePlant
        Finalized.
    config : DriverConfig
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, scene_plant: ScenePlant, config: DriverConfig):
        super().__init__()
        plant, fingers = scene_plant.plant, scene_plant.finger_bodies
        self.object_index = int(scene_plant.object_body.index())
        self.finger_indices = [body.index() for body in fingers]
        self._machine = Machine(driving_law(), len(fingers))
        self._machine.c[:] = [_constants(body, plant, config) for body in fingers]
        n, step = len(fingers), plant.time_step()
        poses, motions = Value[list[RigidTransform]], Value[list[SpatialVelocity]]
        self._pose = self.DeclareAbstractInputPort("pose", poses())
        self._twist = self.DeclareVectorInputPort("twist", 6 * n)
        self._acceleration = self.DeclareVectorInputPort("acceleration", 6 * n)
        self._normal = self.DeclareVectorInputPort("normal", 3 * n)
        self._poses = self.DeclareAbstractInputPort("body_poses", poses())
        self._velocities = self.DeclareAbstractInputPort("body_spatial_velocities", motions())
        self._accelerations = self.DeclareAbstractInputPort(
            "body_spatial_accelerations", Value[list[SpatialAcceleration]]()
        )
        forces = Value[list[ExternallyAppliedSpatialForce]]
        law = self.DeclareCacheEntry(
            "law",
            ValueProducer(allocate=lambda: AbstractValue.Make([None]), calc=weakly(self._CalcLaw)),
            prerequisites_of_calc={self.all_input_ports_ticket(), self.xd_ticket()},
        )
        self.DeclareAbstractOutputPort(
            "spatial_forces", forces, weakly(self._CalcForces), {law.ticket()}
        )
        self._law = law.cache_index()  # the entry itself would keep this system for ever
        # Steps behind us; of each finger position, spin, acceleration one step ago and two.
        self.DeclareDiscreteState(1 + 12 * n)
        if step:
            # Unrestricted, because the plant's step is such an update (for its sampled ports), and
            # those come before discrete ones: a discrete update would see the object a step ahead.
            self.DeclarePeriodicUnrestrictedUpdateEvent(step, 0.0, weakly(self._Remember))

    def _CalcLaw(self, context: Context, value: AbstractValue) -> None:
        """Torque, force and desired position of each finger: (n, 9)."""
        x, past = self._machine.x, context.get_discrete_state_vector().value()
        X, V = self._poses.Eval(context), self._velocities.Eval(context)
        A = self._accelerations.Eval(context)
        o = self.object_index
        x[:, 0:12] = _numbers(X[o])
        x[:, 12:18], x[:, 18:24] = V[o].get_coeffs(), A[o].get_coeffs()
        x[:, 24:36] = [_numbers(X_OF) for X_OF in self._pose.Eval(context)]
        x[:, 36:42] = self._twist.Eval(context).reshape(-1, 6)
        x[:, 42:48] = self._acceleration.Eval(context).reshape(-1, 6)
        x[:, 48:51] = self._normal.Eval(context).reshape(-1, 3)
        x[:, 51:63] = [_numbers(X[i]) for i in self.finger_indices]
        x[:, 63:69] = [V[i].get_coeffs() for i in self.finger_indices]
        x[:, 69], x[:, 70:] = past[0], past[1:].reshape(-1, 12)
        self._machine.run()
        value.set_value([self._machine.y.copy()])

    def _CalcForces(self, context: Context, output: Value) -> None:
        applied = []
        for index, row in zip(
            self.finger_indices, self.get_cache_entry(self._law).Eval(context)[0].tolist()
        ):
            force = ExternallyAppliedSpatialForce()
            force.body_index = index
            force.p_BoBq_B = np.zeros(3)
            force.F_Bq_W = SpatialForce(row[0:3], row[3:6])
            applied.append(force)
        output.set_value(applied)

    def _Remember(self, context: Context, state: State) -> None:
        position = self.get_cache_entry(self._law).Eval(context)[0][:, 6:]
        now = state.get_mutable_discrete_state().get_mutable_value()
        spin = self._twist.Eval(context).reshape(-1, 6)[:, :3]
        a = self._acceleration.Eval(context).reshape(-1, 6)[:, 3:]
        before = context.get_discrete_state_vector().value()[1:].reshape(-1, 12)[:, 6:9]
        now[0] += 1
        now[1:] = np.hstack([position, spin, a, before]).ravel()


def _numbers(X: RigidTransform) -> Array:
    """Rotation row by row, then translation: (12,)."""
    matrix = X.GetAsMatrix34()
    return np.concatenate([matrix[:, :3], matrix[:, 3]], axis=None)


def _constants(body: RigidBody, plant: MultibodyPlant, config: DriverConfig) -> list[float]:
    """`CONSTANT` of a finger."""
    h, mass = plant.time_step(), body.default_mass()
    inertia = body.default_spatial_inertia().CalcRotationalInertia().CopyToFullMatrix3()
    damping = min(config.normal_damping, 0.4 * mass / h) if h else config.normal_damping
    return [
        h, mass, *inertia.ravel(), *plant.gravity_field().gravity_vector(), config.normal_force,
        config.position_gain, config.velocity_gain, damping, config.rotation_gain,
        config.spin_gain,
    ]  # fmt: skip
