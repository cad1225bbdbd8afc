r"""Torques that make a hand move an object as planned, pressing as planned.

Of every finger, with J its tip's Jacobian and J_c that of the contact,

.. math:: \tau = \tau_{id}(q, \dot q, \ddot q_d) - g(q) + J_c^T f_d + J^T (K e + D \dot e)
                 + K_q (q_d - q) + D_q (\dot q_d - \dot q)

f_d the planned force on the object, e what the tip is off its planned place in the world. The last
two terms hold what the tip's place leaves free. What the object is measured to be off its path
moves the tips' places, slowly: they are turned and shifted against it, as one body about the
object's middle.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State
from scipy.interpolate import CubicHermiteSpline

from .config import require_config
from .hand_kinematics import Chains, cross
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plant import ScenePlant
from .reorientation import Reorientation
from .scratch import PerThread

Array = NDArray[np.float64]

POSTURE, POSTURE_DAMPING = 0.4, 0.01  # N m and N m s, of what the tips' places leave free
CORRECTION = 8.0  # 1/s, of what the object is off its path
MOST = 0.02, 0.3  # m and rad, by which tips' places are corrected


class HandDriver(LeafSystem):
    """Joint torques from a plan, the plant's state and where the object is.

    .. pydrake_system::

        name: HandDriver
        input_ports:
        - state
        - body_poses
        - push (optional)
        output_ports:
        - generalized_force
        - torque

    `state` and `body_poses` are the plant's, `generalized_force` is its
    `applied_generalized_force`; `torque` (nq) is that of the joints alone, within their limits, in
    the order of the plan's. `push` (3n + 3) are forces on tips and the object in the world, N.

    State: by how much tips' places are corrected, a rotation vector and a shift, (6,).

    Parameters
    ----------
    plan : Reorientation
    scene_plant : ScenePlant
        Made from the plan's scene and configuration, whose gains are those at the tip.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, plan: Reorientation, scene_plant: ScenePlant):
        super().__init__()
        require_config(plan, Reorientation, "plan")
        require_config(scene_plant, ScenePlant, "scene_plant")
        plant, config = scene_plant.plant, plan.config
        self.plan, self._step = plan, plant.time_step()
        self._object = int(scene_plant.object_body.index())
        self._sizes = plant.num_positions(), plant.num_velocities()
        joints = [plant.GetJointByName(name) for name in plan.joints]
        self._at_q = [joint.position_start() for joint in joints]
        self._at_v = [joint.velocity_start() for joint in joints]
        self._free = scene_plant.object_body.floating_velocities_start_in_v()
        self._gains = config.position_gain, config.velocity_gain
        self._table = _Table(plan)
        made = partial(Chains, plan.hand, plan.rolling, config.finger_mass, config.gravity)
        self._chains = PerThread(made, {})
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        self._push = self.DeclareVectorInputPort("push", 3 * len(plan.chains.joints) + 3)
        needs = (self.all_input_ports_ticket(), self.xd_ticket(), self.time_ticket())
        law, self._law = array_entry(self._CalcLaw, (len(joints),), needs)
        self.DeclareVectorOutputPort("torque", len(joints), weakly(self._CalcTorque), {law})
        self.DeclareVectorOutputPort(
            "generalized_force", self._sizes[1], weakly(self._CalcForce), {law}
        )
        self.DeclareDiscreteState(6)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._step, 0.0, weakly(self._Correct))

    def _CalcLaw(self, context: Context) -> Array:
        chains, x = self._chains.own, self._state.Eval(context)
        q, v = x[self._at_q], x[self._sizes[0] :][self._at_v]
        want = self._table.at(context.get_time())
        turn, shift = np.split(context.get_discrete_state_vector().value(), 2)
        K, D = self._gains
        chains.put(q, v)
        none = MultibodyForces(chains.plant)
        torque = chains.plant.CalcInverseDynamics(chains.context, want["a"], none)
        torque = torque - chains.plant.CalcGravityGeneralizedForces(chains.context)
        torque += POSTURE * (want["q"] - q) + POSTURE_DAMPING * (want["v"] - v)
        for i, force in enumerate(want["forces"]):
            J, p = chains.jacobian(i), want["tips"][i]
            off = p + shift + cross(turn, p - want["place"]) - chains.pose(i).translation()
            pull = force + K * off + D * (want["tip_rates"][i] - J[3:] @ v)
            torque += J[3:].T @ pull + J[:3].T @ cross(want["arms"][i], force)
        return np.clip(torque, -chains.effort, chains.effort)

    def _CalcTorque(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._law(context))

    def _CalcForce(self, context: Context, output: BasicVector) -> None:
        force, torque = np.zeros(self._sizes[1]), self._law(context)
        force[self._at_v] = torque
        if self._push.HasValue(context):
            *tips, obj = self._push.Eval(context).reshape(-1, 3)
            force[self._free + 3 : self._free + 6] += obj
            for i, pushed in enumerate(tips):
                if pushed.any():
                    force[self._at_v] += self._chains.own.jacobian(i)[3:].T @ pushed
        output.SetFromVector(force)

    def _Correct(self, context: Context, state: State) -> None:
        X_WO = self._poses.Eval(context)[self._object]
        X = self.plan.path.GetPose(context.get_time())
        turn = (X.rotation() @ X_WO.rotation().inverse()).ToAngleAxis()
        off = np.append(turn.angle() * turn.axis(), X.translation() - X_WO.translation())
        now = state.get_mutable_discrete_state().get_mutable_value()
        now += CORRECTION * self._step * off
        for part, most in ((now[:3], MOST[1]), (now[3:], MOST[0])):
            part *= min(1.0, most / max(float(np.linalg.norm(part)), 1e-9))


class _Table:
    """What is planned at any time: before the first and after the last all rests."""

    def __init__(self, plan: Reorientation):
        self.t = plan.t
        m, n = plan.forces.shape[:2]
        chains = plan.chains
        tips, rates = np.empty((m, n, 3)), np.empty((m, n, 3))
        for k in range(m):
            chains.put(plan.q[k])
            for i in range(n):
                tips[k, i] = chains.pose(i).translation()
                rates[k, i] = chains.jacobian(i)[3:] @ plan.v[k]
        values = np.hstack([plan.q, tips.reshape(m, -1)])
        slopes = np.hstack([plan.v, rates.reshape(m, -1)])
        self.motion = CubicHermiteSpline(self.t, values, slopes)
        self.velocity, self.acceleration = self.motion.derivative(), self.motion.derivative(2)
        sizes = np.array([[c.finger.size] for c in plan.rolling.contacts])
        self.rest = {
            "forces": plan.forces,
            "arms": sizes * plan.normals,
            "place": plan.object_pose[:, :3, 3],
        }
        self.nq = plan.q.shape[1]

    def at(self, time: float) -> dict[str, Array]:
        t, nq = self.t, self.nq
        inside = min(max(time, t[0]), t[-1])
        moves = float(t[0] < time < t[-1])
        x, v, a = (
            self.motion(inside),
            moves * self.velocity(inside),
            moves * self.acceleration(inside),
        )
        k = min(max(int(np.searchsorted(t, inside)) - 1, 0), len(t) - 2)
        part = (inside - t[k]) / (t[k + 1] - t[k])
        found = {name: (1 - part) * y[k] + part * y[k + 1] for name, y in self.rest.items()}
        found |= {"q": x[:nq], "tips": x[nq:].reshape(-1, 3), "v": v[:nq], "a": a[:nq]}
        return found | {"tip_rates": v[nq:].reshape(-1, 3)}
