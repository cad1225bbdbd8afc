r"""Joint torques with which a hand moves an object as planned and presses on it as planned.

For each finger, with J the Jacobian of its tip and F_tip the wrench that `tip_law` gives,

.. math:: \tau = \tau_{id}(q, \dot q, \ddot q) - g(q) + J^T F_{tip},
                 \quad \ddot q = \ddot q_d + \omega^2 (q_d - q) + 2 \omega (\dot q_d - \dot q)

The first two terms move the links and carry their weight, and control the freedom that joints have
besides the tip's motion. If the object is measured off its path, the wanted positions of all tips
are slowly turned about its planned origin, and shifted, against that error.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from contact_system import SceneError
from contact_system.checks import Array

from .hand_kinematics import Chains, moving_joints, way_to
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plant import ScenePlant, declare_plant_inputs
from .reorientation import Reorientation
from .tables import FingerTables, per_thread
from .tip_law import HELD, holding_law, tip_constants

POSTURE = 30.0  # 1/s, omega
CORRECTION = 8.0  # 1/s, the rate at which the error of the object's pose is integrated
AWAY = 1e-3  # rad or m: how far joints must be off their plan for a start to be refused


class HandDriver(LeafSystem):
    """Joint torques that follow a plan, from the state of the plant and the pose of the object.

    .. pydrake_system::

        name: HandDriver
        input_ports:
        - state
        - body_poses
        - sliding (optional)
        - push (optional)
        output_ports:
        - torque
        - generalized_force

    `state` and `body_poses` are the plant's, `generalized_force` goes to its
    `applied_generalized_force`. `torque` (nq) are the torques of the joints, within their limits,
    in the plan's order. `sliding` (3n) is slip that shall be rejected, from a
    :class:`ContactMonitor`; `push` (3n + 3) are forces on the tips and the object in the world, N.

    Discrete state (6): the correction of the tips' wanted positions, a rotation vector and a shift.

    Parameters
    ----------
    plan : Reorientation
    scene_plant : ScenePlant
        Made from the plan's scene and configuration, which has the gains of the tips.

    Raises
    ------
    SceneError
        A simulation begins at a later time with the joints where the plan starts.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, plan: Reorientation, scene_plant: ScenePlant):
        super().__init__()
        plant = scene_plant.plant
        self.plan, self._step = plan, plant.time_step()
        self._object = int(scene_plant.object_body.index())
        self._sizes = plant.num_positions(), plant.num_velocities()
        joints = moving_joints(plant)
        self.at_q = [joint.position_start() for joint in joints]
        self._at_v = [joint.velocity_start() for joint in joints]
        self._object_v = scene_plant.object_body.floating_velocities_start_in_v()
        self._motion = CubicHermiteSpline(plan.t, plan.q, plan.v)
        self._pressing = make_interp_spline(plan.t, np.stack([plan.forces, plan.normals], 1), k=1)
        self._radii = np.array([[contact.finger.size] for contact in plan.rolling.contacts])
        constants = [tip_constants(x, scene_plant, hold=1.0) for x in scene_plant.finger_bodies]
        # without the mass of tips, which the law's wrench moves and carries
        links = partial(Chains, plan.hand, plan.rolling, 0.0, plan.config.gravity)
        self._chains = per_thread(links)
        self._laws = per_thread(partial(FingerTables, holding_law(), HELD, constants))
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        (self._poses,) = declare_plant_inputs(self, plant, "body_poses")
        self._sliding = self.DeclareVectorInputPort("sliding", 3 * len(constants))
        self._push = self.DeclareVectorInputPort("push", 3 * len(constants) + 3)
        law, self._law = array_entry(self._CalcLaw, (2, len(joints)), {self.all_sources_ticket()})
        self.DeclareVectorOutputPort("torque", len(joints), weakly(self._CalcTorque), {law})
        self.DeclareVectorOutputPort(
            "generalized_force", self._sizes[1], weakly(self._CalcForce), {law}
        )
        self.DeclareInitializationPublishEvent(weakly(self._Begin))
        self.DeclareDiscreteState(6)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._step, 0.0, weakly(self._Correct))

    def _Begin(self, context: Context) -> None:
        """Refuse a later time with joints at the start; SetDefaultContext leaves the time alone."""
        time, (first, last) = context.get_time(), self.plan.t[[0, -1]]
        q, start = self._state.Eval(context)[self.at_q], self.plan.q[0]
        off = np.abs(self._motion(np.clip(time, first, last)) - start).max()
        if off > AWAY and (q == start).all():
            raise SceneError(
                f"{self.plan.scene.title}: the simulation begins at t = {time:g} s with joints as "
                f"planned at 0 s, off by up to {off:.2g} rad or m: set the time to 0, or the state "
                "of the plant to that of the plan at that time"
            )

    def _CalcLaw(self, context: Context) -> Array:
        """Torques that the joints exert, and those equivalent to pushes on the tips, (2, nq)."""
        chains, laws, x = self._chains(), self._laws(), self._state.Eval(context)
        q, v = x[self.at_q], x[self._sizes[0] :][self._at_v]
        time, (first, last) = context.get_time(), self.plan.t[[0, -1]]
        inside = min(max(time, first), last)
        q_d, v_d, a_d = (self._motion(inside, k) for k in range(3))
        forces, normals = self._pressing(inside)
        if not first < time < last:  # the object rests
            v_d = a_d = np.zeros(len(q_d))
            forces = self.plan.resting[int(time >= last)]
        turn, shift = np.split(context.get_discrete_state_vector().value(), 2)
        R_WO = self._poses.Eval(context)[self._object].rotation().matrix()
        given = laws.x
        given["slip"][:] = 0.0
        if self._sliding.HasValue(context):
            given["slip"][:] = self._sliding.Eval(context).reshape(-1, 3) @ R_WO.T
        given["contact_force"][:], given["normal"][:] = forces, normals
        given["arm"][:] = self._radii * normals
        chains.set_state(q_d, v_d)
        A_WB = chains.plant.CalcSpatialAccelerationsFromVdot(chains.context, a_d)
        for i, tip in enumerate(chains.tips):
            given["p_WT"][i] = chains.pose(i).translation()
            given["V_WT"][i] = tip.EvalSpatialVelocityInWorld(chains.context).get_coeffs()
            given["A_WT"][i] = A_WB[tip.index()].get_coeffs()
        origin = self.plan.wanted(time).translation()
        given["p_WT"] += shift + np.cross(turn, given["p_WT"] - origin)
        chains.set_state(q, v)
        feedback = POSTURE * (POSTURE * (q_d - q) + 2 * (v_d - v))
        torque = chains.inverse_dynamics(a_d + feedback)
        tips = range(len(chains.tips))
        J = np.array([chains.jacobian(i) for i in tips])
        given["X_WF"][:], given["V_WF"][:] = [chains.pose(i).GetAsMatrix34() for i in tips], J @ v
        laws.run()
        torque += np.einsum("nik,ni->k", J, laws.results)
        pushed = np.zeros(len(torque))
        if self._push.HasValue(context):
            pushed += J[:, 3:].reshape(-1, len(torque)).T @ self._push.Eval(context)[:-3]
        return np.array([np.clip(torque, -chains.effort, chains.effort), pushed])

    def _CalcTorque(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._law(context)[0])

    def _CalcForce(self, context: Context, output: BasicVector) -> None:
        force = np.zeros(self._sizes[1])
        force[self._at_v] = self._law(context).sum(0)
        if self._push.HasValue(context):
            force[self._object_v + 3 : self._object_v + 6] += self._push.Eval(context)[-3:]
        output.SetFromVector(force)

    def _Correct(self, context: Context, state: State) -> None:
        X_WO = self._poses.Eval(context)[self._object]
        error = way_to(self.plan.wanted(context.get_time()), X_WO)
        correction = state.get_mutable_discrete_state().get_mutable_value()
        correction += CORRECTION * self._step * error
