r"""Forces that move free fingertips as planned relative to a moving object.

A fingertip is a free body, whose wrench is the law of `tip_law`. Slip is rejected with the planned
curve held: to plan anew from where a pushed finger is adds slip.
"""

from __future__ import annotations

import math
from copy import copy
from functools import partial
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex, world_index
from pydrake.systems.framework import Context, LeafSystem

from contact_system import Scene, SceneError
from contact_system.checks import Array, of_kind

from .balance import needed_wrench
from .lifetimes import NO_DICTIONARY, weakly
from .planner_base import MOTION
from .plant import MOTIONS, ScenePlant, declare_plant_inputs, gravity_on
from .scratch import FingerTables, PerThread
from .tip_law import POINT, STIFF, driving_law, tip_constants

ROUNDING = 1e-9
"""Of a time that is a sum of steps."""
OFF = 1e-4
"""Of a finger's size, how far its mass centre may be from its origin."""


class FingertipDriver(LeafSystem):
    """Planned motion relative to the object, and the object's own, to forces on the fingertips.

    .. pydrake_system::

        name: FingertipDriver
        input_ports:
        - motion
        - body_poses
        - body_spatial_velocities
        - body_spatial_accelerations, or generalized_contact_forces
        - contact_forces (optional)
        - sliding (optional)
        - push (optional)
        output_ports:
        - spatial_forces

    The first is :class:`ContactPlanner`'s output, the next three are the plant's. The accelerations
    of a continuous plant depend on the forces that are made of them; it gives the contact forces of
    the object's model instance instead, which with gravity are taken to move the object. What is
    optional is zero where nothing is connected:

    - `contact_forces` (3n): forces of the fingers on the object in the world, N, as a
      :class:`ForceBalancer` gives them; where nothing is connected, the configuration's
      ``normal_force`` along each planned normal.
    - `sliding` (3n): slip to be rejected, as :class:`ContactMonitor` gives it.
    - `push` (3n + 3): forces in the world on the fingers and on the object, N.

    The output is a list of ExternallyAppliedSpatialForce, one a fingertip and one on an object that
    is pushed, at their mass centres.

    Parameters
    ----------
    scene_plant : ScenePlant
        Finalized; if it is discrete, with sampled output ports as Drake's own are, and if it is
        continuous, with an object that is free, alone in its model instance, or welded to the
        world. Its configuration says the normal force and the gains, its bodies' defaults the
        masses, whatever a Context says.

    Raises
    ------
    SceneError
        A discrete plant without sampled output ports, or whose steps are too long for a finger; a
        continuous one with its object on joints; a finger that is not free, or whose mass centre is
        not its origin; in a simulation a time beyond the scene's end, up to which the meshes of
        AddScenePlant reach.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, scene_plant: ScenePlant):
        super().__init__()
        of_kind(ScenePlant, scene_plant, "scene_plant", "a ScenePlant")
        fingers, plant, body = scene_plant.finger_bodies, scene_plant.plant, scene_plant.object_body
        # What the plant is made from; the plant itself would keep this system for ever.
        self.scene, self.config = scene_plant.scene, scene_plant.config
        self.object_index = int(body.index())
        self._inertia = copy(body.default_spatial_inertia())
        self._gravity = gravity_on(plant, body)
        self.finger_indices = [int(body.index()) for body in fingers]
        _check(scene_plant)
        constants = [tip_constants(body, scene_plant, hold=0.0) for body in fingers]
        self._laws = PerThread(partial(FingerTables, driving_law(), POINT, constants), {})
        n = len(fingers)
        self._motion = self.DeclareVectorInputPort("motion", sum(MOTION.values()) * n)
        self._poses, self._velocities = declare_plant_inputs(self, plant, *MOTIONS)
        self._discrete = plant.time_step() > 0
        if self._discrete:
            (self._accelerating,) = declare_plant_inputs(self, plant, "body_spatial_accelerations")
        else:
            size = 6 * body.is_floating_base_body()
            self._accelerating = self.DeclareVectorInputPort("generalized_contact_forces", size)
        self._optional = {
            "contact_force": self.DeclareVectorInputPort("contact_forces", 3 * n),
            "sliding": self.DeclareVectorInputPort("sliding", 3 * n),
            "push": self.DeclareVectorInputPort("push", 3 * n + 3),
        }
        forces = Value[list[ExternallyAppliedSpatialForce]]
        self.DeclareAbstractOutputPort("spatial_forces", forces, weakly(self._CalcForces))
        if scene_plant.meshed:
            self.DeclarePerStepPublishEvent(partial(_refuse_beyond, self.scene))

    def _CalcForces(self, context: Context, output: Value) -> None:
        X, V = self._poses.Eval(context), self._velocities.Eval(context)
        o, law = self.object_index, self._laws.own
        x, n, given = law.x, len(self.finger_indices), self._accelerating.Eval(context)
        law.put(X, V, o, self.finger_indices)
        x["A_WO"][:] = given[o].get_coeffs() if self._discrete else self._Falling(X[o], V[o], given)
        x["motion"][:] = self._motion.Eval(context).reshape(n, -1)
        for name, port in self._optional.items():
            given = port.HasValue(context)
            x[name][:] = port.Eval(context)[: x[name].size].reshape(n, -1) if given else 0.0
            if name == "contact_force":
                x["normal_force"][:] = 0.0 if given else self.config.normal_force
        law.run()
        forces = [_force(*each) for each in zip(self.finger_indices, law.results)]
        push = self._optional["push"]
        if push.HasValue(context) and (pushed := push.Eval(context)[-3:]).any():
            forces.append(_force(o, np.append(np.zeros(3), pushed), self._inertia.get_com()))
        output.set_value(forces)

    def _Falling(self, X_WO: RigidTransform, V_WO: SpatialVelocity, contact: Array) -> Array:
        """A_WO of the object by gravity and its contacts, whose forces are none if it is welded."""
        if not contact.size:
            return np.zeros(6)
        R_WO, V = X_WO.rotation().matrix(), V_WO.get_coeffs()
        force, torque = needed_wrench(self._inertia, self._gravity, R_WO[None], V, np.zeros(6))
        acts = contact.reshape(2, 3) @ R_WO - np.vstack([torque, force])
        A_WO = np.linalg.solve(self._inertia.CopyToFullMatrix6(), acts.ravel())
        return (A_WO.reshape(2, 3) @ R_WO.T).ravel()


def _force(body: int, F_Bq_W: Array, p_BoBq_B: Any = (0, 0, 0)) -> ExternallyAppliedSpatialForce:
    applied = ExternallyAppliedSpatialForce()
    applied.body_index, applied.p_BoBq_B = BodyIndex(body), p_BoBq_B
    applied.F_Bq_W = SpatialForce(F_Bq_W)
    return applied


def _refuse_beyond(scene: Scene, context: Context) -> None:
    if context.get_time() > scene.duration * (1 + ROUNDING):
        raise SceneError(
            f"{scene.title}: t = {context.get_time():.6g} s: the plant's meshes reach as far as "
            f"contacts go until the scene's end at {scene.duration:g} s; to simulate longer build "
            "it of scene.replace(duration=...)"
        )


def _check(parts: ScenePlant) -> None:
    """Refuse what the forces are not made for, such as steps in which nothing explicit can hold a
    finger.

    A force N that presses a body of size a on one of size b pushes it off with N/(a + b) times the
    error.
    """
    scene, config, plant, obj = parts.scene, parts.config, parts.plant, parts.object_body
    step, floats = plant.time_step(), obj.is_floating_base_body()
    alone = plant.num_velocities(obj.model_instance()) == 6 * floats
    if step and not plant.has_sampled_output_ports():  # Drake would tell of an algebraic loop
        raise SceneError(
            f"{scene.title}: the plant has no sampled output ports, so that its accelerations "
            "depend on the forces that are made from them; give MultibodyPlantConfig "
            "use_sampled_output_ports=True"
        )
    if not step and not (alone and (floats or plant.IsAnchored(obj))):
        raise SceneError(
            f"{scene.title}: time_step = 0: the object is on a joint, or with others in its model "
            "instance, so that its acceleration is not known beforehand; give it a model instance "
            "of its own, or a time step, such as 0.001 s"
        )
    joints = list(map(plant.get_joint, plant.GetJointIndices()))
    for i, (contact, body) in enumerate(zip(scene.contacts, parts.finger_bodies)):
        for joint in joints:
            parent, child = joint.parent_body().index(), joint.child_body().index()
            free = joint.num_velocities() == 6 and parent == world_index()
            if parent == body.index() or (child == body.index() and not free):
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
        borne = STIFF * mass / step**2 if step else math.inf
        needed = config.normal_force / (contact.finger.size + scene.object.size)
        if borne < needed:
            raise SceneError(
                f"{scene.title}, contact {i}: time_step = {step!r}: a finger of "
                f"{mass:g} kg can be held with {borne:.3g} N/m, and pressing with "
                f"{config.normal_force:g} N needs {needed:.3g} N/m; give at most "
                f"{math.sqrt(STIFF * mass / needed):.2g} s, or a heavier finger"
            )
