r"""Forces that move free fingertips as planned relative to a moving object.

A fingertip is a free body. Its force is what the planned motion needs (feed-forward), the normal
force along the planned normal through the planned contact point, and tracking in the tangent plane;
along the normal there is only a damper, so that the contact itself decides how far the finger sinks
in. Slip that is really there is rejected by the paper's own term, an acceleration of -lam times it,
with the planned curve held: to plan anew from where a pushed finger is adds slip.

In a discrete plant (semi-implicit Euler, step h) a velocity at t_k moved the body from t_{k-1} to
t_k, so the velocity to track is the backward difference of desired positions, and the acceleration
to feed forward the second, ``A + h^2/12 A''``. The error lives in a frame that turns with the
contact normal at Omega = n x n', of which the normals of two steps, ``n_before x n = h Omega``,
tell the plan's part. docs/drake.md says what each term is worth.
"""

from __future__ import annotations

import math
from functools import partial
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex, RigidBody, world_index
from pydrake.systems.framework import Context, LeafSystem, State

from contact_system import SceneError
from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table
from contact_system.theory.symbols import per_structure

from .config import GAINS, require_config
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .planner_base import MOTION
from .plant import ScenePlant
from .scratch import Machines, PerThread

Array = NDArray[np.float64]
SHARE = 0.4
"""Of a velocity what an explicit damper may take in a step h, of an error what an explicit spring
may take over h; a damper's d and a spring's s are stable where 0 < d and s + 2 d < 4."""

SLIP_SHARE = 0.8
"""Of slip what may be taken away in a step: more would turn it over where friction helps."""

OFF = 1e-4
"""Of a finger's size, how far its mass centre may be from its origin."""


KEPT = {"restarts": 1, "steps": 1, "position": 3, "spin": 3, "normal": 3, "a": 3, "a_earlier": 3}
"""What a driver keeps of a finger from step to step."""
STATE = sum(KEPT.values())
POINT = {"X_WO": 12, "V_WO": 6, "A_WO": 6, "X_WF": 12, "V_WF": 6, "motion": sum(MOTION.values())}
POINT |= {"kept": STATE, "restarts": 1, "sliding": 3, "push": 3}
POINT |= {"contact_force": 3, "normal_force": 1}
"""What the law takes of a step: poses row by row, velocities and accelerations with the angular
part first."""
CONSTANT = {"h": 1, "mass": 1, "inertia": 9, "gravity": 3}
CONSTANT |= dict.fromkeys((*GAINS, "slip_gain"), 1)


@per_structure
def driving_law() -> Table:
    """Table of one finger: `POINT`, `CONSTANT` -> torque (3), force (3), in the world, `KEPT`."""
    point, x = _named(POINT)
    constant, c = _named(CONSTANT)
    plan, before = (_split(x.motion, MOTION), SimpleNamespace(**_split(x.kept, KEPT)))
    x.R_OF, x.p_OF = ca.reshape(plan["pose"][:9], 3, 3), plan["pose"][9:]
    (x.w_OF, x.v_OF), (x.alpha_OF, x.a_OF) = _halves(plan["twist"]), _halves(plan["acceleration"])
    x.normal, x.normal_rate = plan["normal"], plan["normal_rate"]
    x.point = plan["contact_point"][:3]
    # no difference is taken across a restart
    before.steps = ca.if_else(before.restarts == x.restarts, before.steps, 0)
    wanted = _desired_motion(x, c.h, before)
    x.contact_force -= x.normal_force * wanted.normal
    force, torque = _force(x, c, wanted), _torque(x, c, wanted)
    kept = [x.restarts, before.steps + 1, wanted.position, x.w_OF, x.normal, x.a_OF, before.a]
    found = ca.densify(ca.vertcat(torque, force, *kept))
    return Table(ca.Function("driving", [point, constant], [found]))


def _split(numbers: ca.SX, sizes: dict[str, int]) -> dict[str, ca.SX]:
    return dict(zip(sizes, ca.vertsplit(numbers, np.cumsum([0, *sizes.values()]).tolist())))


def _halves(motion: ca.SX) -> tuple[ca.SX, ca.SX]:
    return motion[:3], motion[3:]


def _named(sizes: dict[str, int]) -> tuple[ca.SX, SimpleNamespace]:
    """Symbols by their names; of a pose X R and p, of a velocity V w and v, of A alpha and a."""
    every = ca.SX.sym("x", sum(sizes.values()))
    found = _split(every, sizes)
    for name, value in list(found.items()):
        if name[0] == "X":
            rows = ca.reshape(value, 4, 3).T
            found |= {f"R{name[1:]}": rows[:, :3], f"p{name[1:]}": rows[:, 3]}
        elif name[0] in "VA":
            names = ("w", "v") if name[0] == "V" else ("alpha", "a")
            found |= {f"{own}{name[1:]}": half for own, half in zip(names, _halves(value))}
    return every, SimpleNamespace(**found)


def _desired_motion(x: SimpleNamespace, h: ca.SX, before: SimpleNamespace) -> SimpleNamespace:
    """The plan carried by the object, in the world, as a discrete plant needs it.

    position and acceleration ``a`` of now; velocity ``ago``, which brought the finger here; ``w``
    and ``alpha``; the contact's normal and how fast it turns.
    """
    cross, begun = ca.cross, before.steps > 0
    arm, v, spin = x.R_WO @ x.p_OF, x.R_WO @ x.v_OF, x.R_WO @ x.w_OF
    position, swept = x.p_WO + arm, cross(x.w_WO, arm)
    second = (x.a_OF - 2 * before.a + before.a_earlier) / 12  # h^2/12 A''
    a = x.a_WO + cross(x.alpha_WO, arm) + cross(x.w_WO, swept + 2 * v)
    a += x.R_WO @ (x.a_OF + ca.if_else(before.steps > 1, second, 0))
    now = x.v_WO + swept + v - 0.5 * h * a
    ago = ca.if_else(begun, (position - before.position) / h, now)
    w = x.w_WO + ca.if_else(begun, 0.5 * (spin + x.R_WO @ before.spin), spin)
    alpha = x.alpha_WO + x.R_WO @ x.alpha_OF + cross(x.w_WO, spin)
    normal = x.R_WO @ x.normal
    turned = cross(before.normal, x.normal) / h
    turned = x.R_WO @ ca.if_else(begun, turned, cross(x.normal, x.normal_rate))
    turning = turned + x.w_WO - ca.dot(x.w_WO, normal) * normal
    return SimpleNamespace(
        position=position, ago=ago, a=a, w=w, alpha=alpha, normal=normal, turning=turning
    )


def _force(x: SimpleNamespace, c: SimpleNamespace, wanted: SimpleNamespace) -> ca.SX:
    """Feed-forward, contact, tracking in the frame that turns with the contact, slip, a push."""
    cross, normal, turning = ca.cross, wanted.normal, wanted.turning
    error, error_rate = wanted.position - x.p_WF, wanted.ago - x.v_WF
    # The velocities are those of half a step ago, so the error has to be too.
    error_rate -= cross(turning, error - 0.5 * c.h * error_rate)
    a = wanted.a - 2 * cross(turning, error_rate) - cross(turning, cross(turning, error))
    a += c.slip_gain * (x.R_WO @ x.sliding)  # v_rel: minus the finger's velocity on the object
    approach = ca.dot(error_rate, normal)
    force = c.mass * (a - c.gravity) + x.contact_force + c.normal_damping * approach * normal
    force += c.position_gain * (error - ca.dot(error, normal) * normal)
    return force + c.velocity_gain * (error_rate - approach * normal) + x.push


def _torque(x: SimpleNamespace, c: SimpleNamespace, wanted: SimpleNamespace) -> ca.SX:
    """Feed-forward, the contact force through the contact point, damping of spin."""
    inertia, w = x.R_WF @ ca.reshape(c.inertia, 3, 3) @ x.R_WF.T, wanted.w
    off = x.R_WO @ x.R_OF @ x.R_WF.T
    axis = 0.5 * ca.vertcat(off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1])
    torque = inertia @ wanted.alpha + ca.cross(w, inertia @ w)
    torque += c.spin_gain * (w - x.w_WF) + c.rotation_gain * axis
    return torque + ca.cross(x.R_WO @ x.R_OF @ x.point, x.contact_force)


class FingertipDriver(LeafSystem):
    """Planned motion relative to the object, and the object's own, to forces on the fingertips.

    .. pydrake_system::

        name: FingertipDriver
        input_ports:
        - motion
        - body_poses
        - body_spatial_velocities
        - body_spatial_accelerations
        - contact_forces (optional)
        - restarts (optional)
        - sliding (optional)
        - push (optional)
        output_ports:
        - spatial_forces

    The first is :class:`ContactPlanner`'s output, the next three are the plant's. What is optional
    is zero where nothing is connected:

    - `contact_forces` (3n): forces of the fingers on the object in the world, N, as a
      :class:`ForceBalancer` gives them; where nothing is connected, the configuration's
      ``normal_force`` along each planned normal.
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
        not its origin.
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
        constants = [_constants(body, scene_plant) for body in fingers]
        self._laws = PerThread(partial(_Law, self.finger_indices, constants), {})
        n = len(fingers)
        poses, motions = Value[list[RigidTransform]], Value[list[SpatialVelocity]]
        self._motion = self.DeclareVectorInputPort("motion", sum(MOTION.values()) * n)
        self._poses = self.DeclareAbstractInputPort("body_poses", poses())
        self._velocities = self.DeclareAbstractInputPort("body_spatial_velocities", motions())
        self._accelerations = self.DeclareAbstractInputPort(
            "body_spatial_accelerations", Value[list[SpatialAcceleration]]()
        )
        self._optional = {
            "contact_force": self.DeclareVectorInputPort("contact_forces", 3 * n),
            "restarts": self.DeclareVectorInputPort("restarts", n),
            "sliding": self.DeclareVectorInputPort("sliding", 3 * n),
            "push": self.DeclareVectorInputPort("push", 3 * n + 3),
        }
        forces = Value[list[ExternallyAppliedSpatialForce]]
        step = plant.time_step()
        needs = (self.all_input_ports_ticket(), self.xd_ticket() if step else self.nothing_ticket())
        law, self._found = array_entry(self._CalcLaw, (n, 6 + STATE), needs)
        self.DeclareAbstractOutputPort("spatial_forces", forces, weakly(self._CalcForces), {law})
        if not step:
            return
        self.DeclareDiscreteState(STATE * n)
        # Unrestricted, because the plant's step is such an update (for its sampled ports), and
        # those come before discrete ones: a discrete update would see the object a step ahead.
        self.DeclarePeriodicUnrestrictedUpdateEvent(step, 0.0, weakly(self._Remember))

    def _CalcLaw(self, context: Context) -> Array:
        """Torque, force and what is to be kept of each finger: (n, 23)."""
        X, V = self._poses.Eval(context), self._velocities.Eval(context)
        A, o, law = self._accelerations.Eval(context), self.object_index, self._laws.own
        x, n = law.x, len(law.bodies)
        x["X_WO"][:], x["V_WO"][:] = X[o].GetAsMatrix34(), V[o].get_coeffs()
        x["A_WO"][:] = A[o].get_coeffs()
        for body, pose, velocity in zip(law.bodies, x["X_WF"], x["V_WF"]):
            pose[:], velocity[:] = X[body].GetAsMatrix34(), V[body].get_coeffs()
        x["motion"][:] = self._motion.Eval(context).reshape(n, -1)
        x["normal_force"][:] = self.config.normal_force
        for name, port in self._optional.items():
            x[name][:] = 0.0
            if port.HasValue(context):
                x[name][:] = port.Eval(context)[: x[name].size].reshape(n, -1)
        if self._optional["contact_force"].HasValue(context):
            x["normal_force"][:] = 0.0
        if context.num_discrete_state_groups():
            x["kept"][:] = context.get_discrete_state_vector().value().reshape(n, -1)
        law.run()
        return law.results

    def _CalcForces(self, context: Context, output: Value) -> None:
        law, push = self._laws.own, self._optional["push"]
        for applied, row in zip(law.applied, self._found(context)):
            applied.F_Bq_W = SpatialForce(row[:6])
        every = law.applied
        if push.HasValue(context) and (pushed := push.Eval(context)[-3:]).any():
            every = [*every, _at_centre(BodyIndex(self.object_index))]
            every[-1].F_Bq_W = SpatialForce(np.zeros(3), pushed)
        output.set_value(every)

    def _Remember(self, context: Context, state: State) -> None:
        now = state.get_mutable_discrete_state().get_mutable_value()
        now[:] = self._found(context)[:, 6:].ravel()


class _Law(Machines):
    """The law of all fingers, for one thread: ``x`` is what it takes by name, a row a finger, poses
    (3, 4); ``applied`` are their forces."""

    def __init__(self, bodies: list[BodyIndex], constants: list[list[float]]):
        super().__init__(driving_law(), constants)
        columns = np.split(self.points, np.cumsum([*POINT.values()])[:-1], axis=1)
        self.x = {
            name: column.reshape(-1, 3, 4) if name[0] == "X" else column
            for name, column in zip(POINT, columns)
        }
        self.bodies, self.applied = list(map(int, bodies)), list(map(_at_centre, bodies))


def _at_centre(body: BodyIndex) -> ExternallyAppliedSpatialForce:
    applied = ExternallyAppliedSpatialForce()
    applied.body_index, applied.p_BoBq_B = body, np.zeros(3)
    return applied


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
    return [h, mass, *inertia.ravel(), *gravity, *gains]
