r"""Forces that move free fingertips as planned relative to a moving object.

A fingertip is a free body; `tip_law` gives the wrench on it. Also while slip is fed back it tracks
the planned curve: a new plan from where a pushed finger is would add slip.
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
from .tables import FingerTables, per_thread
from .tip_law import FREE_TIP, STIFF, driving_law, tip_constants

ROUNDING = 1e-9
"""Relative error of a time that is a sum of steps."""
OFF = 1e-4
"""How far a finger's mass centre may be from its origin, as a fraction of its size."""


class FingertipDriver(LeafSystem):
    """Forces on the fingertips that make them move relative to the object as planned.

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

    `motion` is :class:`ContactPlanner`'s output, the next three are the plant's. The accelerations
    of a continuous plant depend on the forces that this system computes from them. So it takes the
    contact forces on the object's model instance instead, and computes the object's acceleration
    from these and gravity alone. Optional ports:

    - `contact_forces` (3n): forces of the fingers on the object in the world, N, as a
      :class:`ForceBalancer` gives them; if not connected, the configuration's ``normal_force``
      along each planned normal.
    - `sliding` (3n): slip to be rejected, as :class:`ContactMonitor` gives it; else zero.
    - `push` (3n + 3): forces in the world on the fingers and on the object, N; else zero.

    The output is a list of ExternallyAppliedSpatialForce at mass centres: one for each fingertip,
    and one for the object if it is pushed.

    Parameters
    ----------
    scene_plant : ScenePlant
        Finalized. If it is discrete it needs sampled output ports, which Drake's plants have by
        default; if it is continuous the object must be free and alone in its model instance, or
        welded to the world. Normal force and gains are those of its configuration, masses those
        of its bodies' defaults, even if a Context has others.

    Raises
    ------
    SceneError
        A discrete plant without sampled output ports, or with steps too long for a finger; a
        continuous one with the object on joints; a finger that is not free, or whose mass centre is
        not at its origin; in a simulation a time beyond the scene's end, where the meshes of
        AddScenePlant end.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, scene_plant: ScenePlant):
        super().__init__()
        of_kind(ScenePlant, scene_plant, "scene_plant", "a ScenePlant")
        fingers, plant, body = scene_plant.finger_bodies, scene_plant.plant, scene_plant.object_body
        # Keep what the plant is made from: a reference to the plant would keep this system alive.
        self.scene, self.config = scene_plant.scene, scene_plant.config
        self.object_index = int(body.index())
        self._inertia = copy(body.default_spatial_inertia())
        self._gravity = gravity_on(plant, body)
        self.finger_indices = [int(body.index()) for body in fingers]
        _check(scene_plant)
        constants = [tip_constants(body, scene_plant, hold=0.0) for body in fingers]
        self._laws = per_thread(partial(FingerTables, driving_law(), FREE_TIP, constants))
        n = len(fingers)
        self._motion = self.DeclareVectorInputPort("motion", sum(MOTION.values()) * n)
        self._poses, self._velocities = declare_plant_inputs(self, plant, *MOTIONS)
        self.step = plant.time_step()
        if self.step:
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
        o, law = self.object_index, self._laws()
        x, n, given = law.x, len(self.finger_indices), self._accelerating.Eval(context)
        law.put(X, V, o, self.finger_indices)
        x["A_WO"][:] = given[o].get_coeffs() if self.step else self._A_WO(X[o], V[o], given)
        x["motion"][:] = self._motion.Eval(context).reshape(n, -1)
        for name, port in self._optional.items():
            connected = port.HasValue(context)
            x[name][:] = port.Eval(context)[: x[name].size].reshape(n, -1) if connected else 0.0
            if name == "contact_force":
                x["normal_force"][:] = 0.0 if connected else self.config.normal_force
        law.run()
        forces = [_force(*each) for each in zip(self.finger_indices, law.results)]
        push = self._optional["push"]
        if push.HasValue(context) and (pushed := push.Eval(context)[-3:]).any():
            forces.append(_force(o, np.append(np.zeros(3), pushed), self._inertia.get_com()))
        output.set_value(forces)

    def _A_WO(self, X_WO: RigidTransform, V_WO: SpatialVelocity, contact: Array) -> Array:
        """A_WO by gravity and generalized contact forces (6,), or (0,) if the object is welded."""
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
            f"{scene.title}: t = {context.get_time():.6g} s: the plant's meshes reach only as far "
            f"as contacts go until the scene's end at {scene.duration:g} s; to simulate longer "
            "build it from scene.replace(duration=...)"
        )


def _check(parts: ScenePlant) -> None:
    """Refuse plants that the forces are not made for, and steps too long for the explicit spring.

    The spring must be stiffer than N/(a + b): a force N that presses a body of size a on one of
    size b pushes it on by N/(a + b) times its distance from its place.
    """
    scene, config, plant, obj = parts.scene, parts.config, parts.plant, parts.object_body
    step, floats = plant.time_step(), obj.is_floating_base_body()
    alone = plant.num_velocities(obj.model_instance()) == 6 * floats
    if step and not plant.has_sampled_output_ports():  # Drake would report an algebraic loop
        raise SceneError(
            f"{scene.title}: the plant has no sampled output ports, so that its accelerations "
            "depend on the forces that are computed from them; give MultibodyPlantConfig "
            "use_sampled_output_ports=True"
        )
    if not step and not (alone and (floats or plant.IsAnchored(obj))):
        raise SceneError(
            f"{scene.title}: time_step = 0: the object is on a joint, or with others in its model "
            "instance, so that contact forces alone do not tell its acceleration; give it a model "
            "instance of its own, or a time step, such as 0.001 s"
        )
    joints = list(map(plant.get_joint, plant.GetJointIndices()))
    for i, (contact, body) in enumerate(zip(scene.contacts, parts.finger_bodies)):
        for joint in joints:
            ends = joint.parent_body().index(), joint.child_body().index()
            free = joint.num_velocities() == 6 and world_index() in ends
            if body.index() in ends and not free:
                raise SceneError(
                    f"{scene.title}, {scene.contact_title(i)}: body '{body.name()}' is not free, "
                    f"but has the joint '{joint.name()}'; forces are for a body that moves alone: "
                    "take the joint away, and make one body of several that are welded together"
                )
        mass, center = body.default_mass(), body.default_com()
        if not np.linalg.norm(center) <= OFF * contact.finger.size:
            raise SceneError(
                f"{scene.title}, {scene.contact_title(i)}: the mass centre of body '{body.name()}' "
                f"is at {center.tolist()} m in its frame; it has to be at the origin, which is "
                "that of the finger's surface: give the body such an inertia"
            )
        borne = STIFF * mass / step**2 if step else math.inf
        needed = config.normal_force / (contact.finger.size + scene.object.size)
        if borne < needed:
            most = 0.95 * math.sqrt(STIFF * mass / needed)  # so that rounding is no excess
            raise SceneError(
                f"{scene.title}, {scene.contact_title(i)}: time_step = {step!r}: a finger of "
                f"{mass:g} kg can be held with {borne:.3g} N/m, and pressing with "
                f"{config.normal_force:g} N needs {needed:.3g} N/m; give at most "
                f"{most:.2g} s, or a heavier finger"
            )
