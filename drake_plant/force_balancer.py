"""What fingers shall exert so that the object stays in its place: balance, solved at every step."""

from __future__ import annotations

from copy import copy

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from contact_system.checks import Array, of_kind

from .balance import balancing_forces, friction_used, needed_wrench, way_to
from .config import StationConfig
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plant import MOTIONS, ScenePlant, declare_plant_inputs, gravity_on

COLUMNS = {"contact_forces": slice(0, 3), "normal_force": slice(3, 4), "friction_used": slice(4, 5)}


class ForceBalancer(LeafSystem):
    """Contact forces that keep an object in its place against gravity, inside the friction cones.

    .. pydrake_system::

        name: ForceBalancer
        input_ports:
        - contact_point
        - normal
        - body_poses
        - body_spatial_velocities
        output_ports:
        - contact_forces
        - normal_force
        - friction_used

    The first two inputs are a planner's, so that a planner that restarts from measured states moves
    them with the contacts; the others are the plant's. `contact_forces` (3n) are forces on the
    object in the world, N, by :func:`balancing_forces`: of what carries the object and leads it
    back to its place, critically damped at the configuration's ``object_rate``. The place is the
    Context's only parameter, a RigidTransform, by default the object's default pose. Where the
    cones cannot hold that, as in a push, they are those that leave the least of it. `normal_force`
    (n) and `friction_used` (n) are their normal parts, N, and the parts of the cones they use.

    Parameters
    ----------
    scene_plant : ScenePlant
        Its object is free; its configuration says friction, which part of it is used, and the rate.
    least : float
        Least normal force, N.
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, scene_plant: ScenePlant, least: float = 0.0):
        super().__init__()
        of_kind(ScenePlant, scene_plant, "scene_plant", "a ScenePlant")
        plant, body, config = scene_plant.plant, scene_plant.object_body, scene_plant.config
        n = len(scene_plant.finger_bodies)
        self._least, self._index = least, int(body.index())
        self._config: StationConfig = config
        self._inertia = copy(body.default_spatial_inertia())  # the body's own would keep the plant
        self._gravity = gravity_on(plant, body)
        self.DeclareAbstractParameter(Value(plant.GetDefaultFloatingBaseBodyPose(body)))
        self._points = self.DeclareVectorInputPort("contact_point", 6 * n)
        self._normals = self.DeclareVectorInputPort("normal", 3 * n)
        self._poses, self._velocities = declare_plant_inputs(self, plant, *MOTIONS)
        needs = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        ticket, self._found = array_entry(self._CalcFound, (n, 5), needs)
        for name, rows in COLUMNS.items():
            size, calc = n * (rows.stop - rows.start), weakly(self._CalcVector, name)
            self.DeclareVectorOutputPort(name, size, calc, {ticket})

    def _CalcVector(self, name: str, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._found(context)[:, COLUMNS[name]].ravel())

    def _CalcFound(self, context: Context) -> Array:
        X_WO = self._poses.Eval(context)[self._index]
        V_WO = self._velocities.Eval(context)[self._index].get_coeffs()
        R_WO, w, config = X_WO.rotation().matrix(), V_WO[:3], self._config
        rate, X_WP = config.object_rate, context.get_abstract_parameter(0).get_value()
        # back to the object's place
        alpha, a = np.split(rate * (rate * way_to(X_WP, X_WO) - 2 * V_WO), 2)
        force, torque = needed_wrench(self._inertia, self._gravity, R_WO[None], w, alpha, a)
        points = self._points.Eval(context).reshape(1, -1, 6)[..., 3:]
        normals = -self._normals.Eval(context).reshape(1, -1, 3)
        forces = balancing_forces(
            *(points, normals, config.friction, force, torque),
            margin=config.friction_share,
            least=self._least,
            strict=False,
        )
        pressing = np.sum(forces * normals, axis=-1)
        used = friction_used(forces, normals, config.friction)
        return np.hstack([forces[0] @ R_WO.T, pressing.T, used.T])
