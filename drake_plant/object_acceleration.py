"""How contact accelerates an object, where Drake's own answer would be an algebraic loop."""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialAcceleration
from pydrake.systems.framework import Context, LeafSystem

from contact_system import SceneError

from .balance import needed_wrench
from .lifetimes import NO_DICTIONARY, weakly
from .plant import ScenePlant, declare_plant_inputs, gravity_on


class ObjectAcceleration(LeafSystem):
    """The object's acceleration by its contacts and gravity, for a continuous plant's driver.

    .. pydrake_system::

        name: ObjectAcceleration
        input_ports:
        - generalized_contact_forces
        - body_poses
        - body_spatial_velocities
        output_ports:
        - body_spatial_accelerations

    The inputs are the plant's, forces those of the object's model instance. The plant's own
    accelerations depend on the forces that the :class:`FingertipDriver` makes of them. Here forces
    that are applied to the object itself are left out, and other bodies' accelerations are zero.

    Parameters
    ----------
    scene_plant : ScenePlant
        Its object is free, alone in its model instance, or welded to the world.

    Raises
    ------
    SceneError
        An object on joints, or with others in its model instance.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, scene_plant: ScenePlant):
        super().__init__()
        plant, body = scene_plant.plant, scene_plant.object_body
        self._free = body.is_floating_base_body()
        size = plant.num_velocities(body.model_instance())
        if size != 6 * self._free or not (self._free or plant.IsAnchored(body)):
            raise SceneError(
                f"{scene_plant.scene.title}: time_step = 0: the object is on a joint, or with "
                "others in its model instance, so that its acceleration is not known beforehand; "
                "give it a model instance of its own, or a time step, such as 0.001 s"
            )
        self._index, self._count = int(body.index()), plant.num_bodies()
        self._inertia = copy(body.default_spatial_inertia())  # the body's own would keep the plant
        self._gravity = gravity_on(plant, body)
        self._forces = self.DeclareVectorInputPort("generalized_contact_forces", size)
        self._poses, self._velocities = declare_plant_inputs(
            self, "body_poses", "body_spatial_velocities"
        )
        kind = Value[list[SpatialAcceleration]]
        self.DeclareAbstractOutputPort("body_spatial_accelerations", kind, weakly(self._Calc))

    def _Calc(self, context: Context, output: Any) -> None:
        found = [SpatialAcceleration(np.zeros(3), np.zeros(3)) for _ in range(self._count)]
        if self._free:
            R_WO = self._poses.Eval(context)[self._index].rotation().matrix()
            w, rest = self._velocities.Eval(context)[self._index].rotational(), np.zeros(3)
            force, torque = needed_wrench(self._inertia, self._gravity, R_WO[None], w, rest, rest)
            acts = self._forces.Eval(context).reshape(2, 3) @ R_WO - np.vstack([torque, force])
            A_WO = np.linalg.solve(self._inertia.CopyToFullMatrix6(), acts.ravel())
            found[self._index] = SpatialAcceleration(*A_WO.reshape(2, 3) @ R_WO.T)
        output.set_value(found)
