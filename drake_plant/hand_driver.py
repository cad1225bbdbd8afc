r"""Torques that make a hand move an object as planned, pressing as planned.

Of every finger, with J its tip's Jacobian and F_tip the wrench of `tip_law`,

.. math:: \tau = \tau_{id}(q, \dot q, \ddot q) - g(q) + J^T F_{tip},
                 \quad \ddot q = \ddot q_d + \omega^2 (q_d - q) + 2 \omega (\dot q_d - \dot q)

The first two terms carry the links, and hold what the tip's pose leaves free. What the
object is measured to be off its path moves the tips' places, slowly: they are turned and shifted
against it, as one body about the object's middle.
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
from .scratch import FingerTables, PerThread
from .tip_law import HELD, holding_law, tip_constants

POSTURE = 30.0  # 1/s, omega
CORRECTION = 8.0  # 1/s, of what the object is off its path
AWAY = 1e-3  # rad or m, of joints that are not where a simulation begins


class HandDriver(LeafSystem):
    """Joint torques from a plan, the plant's state and where the object is.

    .. pydrake_system::

        name: HandDriver
        input_ports:
        - state
        - body_poses
        - sliding (optional)
        - push (optional)
        output_ports:
        - generalized_force
        - torque

    `state` and `body_poses` are the plant's, `generalized_force` is its
    `applied_generalized_force`; `torque` (nq) is that of the joints alone, within their limits, in
    the order of the plan's. `sliding` (3n) is slip to be rejected, as :class:`ContactMonitor` gives
    it; `push` (3n + 3) are forces on tips and the object in the world, N.

    State: by how much tips' places are corrected, a rotation vector and a shift, (6,).

    Parameters
    ----------
    plan : Reorientation
    scene_plant : ScenePlant
        Made from the plan's scene and configuration, whose gains are those at the tip.

    Raises
    ------
    SceneError
        A simulation that begins after the start with joints that are where they are at the start.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, plan: Reorientation, scene_plant: ScenePlant):
        super().__init__()
        plant = scene_plant.plant
        self.plan, self._step = plan, plant.time_step()
        self._object = int(scene_plant.object_body.index())
        self._sizes = plant.num_positions(), plant.num_velocities()
        joints = moving_joints(plant)
        self._at_q = [joint.position_start() for joint in joints]
        self._at_v = [joint.velocity_start() for joint in joints]
        self._free = scene_plant.object_body.floating_velocities_start_in_v()
        self._motion = CubicHermiteSpline(plan.t, plan.q, plan.v)
        pressing = np.stack([plan.forces, plan.normals], axis=1)
        self._pressing = make_interp_spline(plan.t, pressing, k=1)
        self._radii = np.array([[contact.finger.size] for contact in plan.rolling.contacts])
        tips = scene_plant.finger_bodies
        constants = [tip_constants(tip, scene_plant, hold=1.0) for tip in tips]
        # links without tips, whose mass the law carries
        links = partial(Chains, plan.hand, plan.rolling, 0.0, plan.config.gravity)
        self._chains = PerThread(links, {})
        self._laws = PerThread(partial(FingerTables, holding_law(), HELD, constants), {})
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        (self._poses,) = declare_plant_inputs(self, plant, "body_poses")
        self._sliding = self.DeclareVectorInputPort("sliding", 3 * len(constants))
        self._push = self.DeclareVectorInputPort("push", 3 * len(constants) + 3)
        needs = (self.all_input_ports_ticket(), self.xd_ticket(), self.time_ticket())
        law, self._law = array_entry(self._CalcLaw, (2, len(joints)), needs)
        self.DeclareVectorOutputPort("torque", len(joints), weakly(self._CalcTorque), {law})
        self.DeclareVectorOutputPort(
            "generalized_force", self._sizes[1], weakly(self._CalcForce), {law}
        )
        self.DeclareInitializationPublishEvent(weakly(self._Begin))
        self.DeclareDiscreteState(6)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._step, 0.0, weakly(self._Correct))

    def _Begin(self, context: Context) -> None:
        """Refuse a time set by itself: SetDefaultContext leaves it alone."""
        time, (first, last) = context.get_time(), self.plan.t[[0, -1]]
        q, start = self._state.Eval(context)[self._at_q], self.plan.q[0]
        off = np.abs(self._motion(np.clip(time, first, last)) - start).max()
        if off > AWAY and (q == start).all():
            raise SceneError(
                f"{self.plan.scene.title}: the simulation begins at t = {time:g} s with joints as "
                f"planned at 0 s, off by up to {off:.2g} rad or m: set the time to 0, or the state "
                "of the plant to that of the plan at that time"
            )

    def _CalcLaw(self, context: Context) -> Array:
        """Torques of the joints, and what pushes on the tips are to them, (2, nq)."""
        chains, laws, x = self._chains.own, self._laws.own, self._state.Eval(context)
        q, v = x[self._at_q], x[self._sizes[0] :][self._at_v]
        time, (first, last) = context.get_time(), self.plan.t[[0, -1]]
        inside = min(max(time, first), last)
        q_d, v_d, a_d = (self._motion(inside, k) for k in range(3))
        forces, normals = self._pressing(inside)
        if not first < time < last:  # all rests
            v_d = a_d = np.zeros(len(q_d))
            forces = self.plan.resting[int(time >= last)]
        turn, shift = np.split(context.get_discrete_state_vector().value(), 2)
        R_WO = self._poses.Eval(context)[self._object].rotation().matrix()
        given = laws.x
        given["slip"][:] = 0.0
        if self._sliding.HasValue(context):
            given["slip"][:] = self._sliding.Eval(context).reshape(-1, 3) @ R_WO.T
        given["contact_force"][:], given["normal"][:] = forces, normals
        given["arm"][:] = self._radii * given["normal"]
        place = self.plan.wanted(time).translation()
        chains.put(q_d, v_d)
        for i, motion in enumerate(chains.motions(a_d)):
            given["p_WT"][i], given["V_WT"][i], given["A_WT"][i] = motion
        given["p_WT"] += shift + np.cross(turn, given["p_WT"] - place)
        chains.put(q, v)
        back = POSTURE * (POSTURE * (q_d - q) + 2 * (v_d - v))
        torque = chains.carrying(a_d + back)
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
            force[self._free + 3 : self._free + 6] += self._push.Eval(context)[-3:]
        output.SetFromVector(force)

    def _Correct(self, context: Context, state: State) -> None:
        X_WO = self._poses.Eval(context)[self._object]
        off = way_to(self.plan.wanted(context.get_time()), X_WO)
        now = state.get_mutable_discrete_state().get_mutable_value()
        now += CORRECTION * self._step * off
