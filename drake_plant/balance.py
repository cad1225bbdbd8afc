r"""The smallest contact forces inside the friction cones that exert a wanted wrench on an object.

Forces f_i at point contacts p_i are chosen by

.. math:: \min \sum_i |f_i|^2, \quad \sum_i (f_i,\; p_i \times f_i) = (F, T), \quad
          |f_i - (f_i \cdot n_i) n_i| \le c\, \mu_i\, f_i \cdot n_i, \quad f_i \cdot n_i \ge N_i,

where (F, T) is the wrench, n_i the normal into the object, mu_i the friction coefficient, N_i the
least normal force, and c the part of the cones that may be used. The cost is strictly convex, so
forces do not jump unless contacts do. SI units.
"""

from __future__ import annotations

import dataclasses
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import Value
from pydrake.multibody.tree import SpatialInertia
from pydrake.solvers import ClarabelSolver, LorentzConeConstraint, MathematicalProgram
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from contact_system import Scene, SceneError
from contact_system.checks import Array, finite_number, of_kind, shaped_array
from contact_system.planning.motion import FRAMES, Motion

from .config import StationConfig
from .hand_kinematics import way_to
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plant import MOTIONS, ScenePlant, declare_plant_inputs, gravity_on
from .pressing import TOLERANCE
from .tables import slices

MARGIN = 0.8
"""The part of a friction cone that is used: with facets and feedback less than 90 % is measured."""
RATE = 30.0  # 1/s, of the critically damped return of an object to its place
KNOTS = 51  # times at which a plan is balanced before it is simulated
UNIT = 1e-6  # how far from 1 a normal's length may be
LEFT = 1e-3  # least part of the wrench that an error reports as not balanced
NONE, ROUNDING = 1e-14, 1e-6  # between these, a part of the wrench that no forces exert is rounding
WRENCH_COST = 1e6  # of a wrench that is left, over that of forces, both squared and scaled to 1
OUTPUTS = {"contact_forces": 3, "normal_force": 1, "friction_used": 1}  # numbers of each contact


def balancing_forces(
    points: ArrayLike,
    normals: ArrayLike,
    friction: ArrayLike,
    force: ArrayLike,
    torque: ArrayLike,
    *,
    margin: float = MARGIN,
    least: ArrayLike = 0.0,
    t: ArrayLike | None = None,
    strict: bool = True,
) -> Array:
    """Forces of n contacts on the object at m times, all in one frame.

    Parameters
    ----------
    points, normals : (m, n, 3)
        Contact points, m, and unit normals into the object.
    friction : (n,) or float
        Coulomb's coefficients.
    force, torque : (m, 3)
        The wrench that all contacts together are to exert on the object, N and N m about the
        frame's origin: mass times acceleration less its weight (see :func:`needed_wrench`).
    margin : float
        Part of each friction cone that may be used, 1 or less; default 0.8.
    least : (n,) or float
        Least normal forces, N.
    t : (m,), optional
        s; an error names the time.
    strict : bool
        False: where no forces exert the wrench, return those that come nearest to it.

    Returns
    -------
    (m, n, 3)
        N, on the object.

    Raises
    ------
    SceneError
        No forces exert the wrench: it tells the first such time and the wrench that is left;
        arrays of other shapes, numbers that are not finite, normals that are not unit vectors, a
        margin outside 0 to 1.
    """
    points = shaped_array(points, "points", finite=True)
    if points.ndim != 3 or points.shape[2] != 3 or not points.size:
        raise SceneError(f"points has shape {points.shape}; give (times, contacts, 3), none of 0")
    times, count, _ = points.shape
    normals = shaped_array(normals, "normals", points.shape)
    force, torque = (
        shaped_array(given, name, (times, 3), finite=True)
        for name, given in (("force", force), ("torque", torque))
    )
    if finite_number(margin, "margin", "not below 0") > 1:
        raise SceneError(f"margin = {margin!r}: give a part of the friction cones, at most 1")
    for name, given in (("friction", friction), ("least", least)):
        if shaped_array(given, name, finite=True).shape not in ((), (count,)):
            raise SceneError(f"{name} = {given!r}: give a number, or one for each contact")
    if not (np.abs(np.linalg.norm(normals, axis=-1) - 1) < UNIT).all():
        raise SceneError("normals: give vectors of length 1")
    # scale everything to sizes of about 1
    length = np.abs(points).max() or 1.0
    wanted = np.hstack([force, torque / length])
    floor = np.broadcast_to(least, count)
    size = max(np.abs(wanted).max(), np.max(floor)) or 1.0
    cones = margin * np.broadcast_to(friction, count).astype(float)
    forces, left = _solve(points / length, normals, wanted / size, cones, floor / size)
    if left is not None and strict:
        most = np.abs(left).max(axis=1)
        k = int(np.argmax(most >= min(LEFT, most.max())))
        acts = -left[k]
        acts[np.abs(acts) < LEFT * np.abs(acts).max()] = 0.0
        acts *= size * np.repeat([1.0, length], 3)
        when = "" if t is None else f"t = {np.ravel(t)[k]:.6g} s: "
        F, T = (", ".join(f"{x:.3g}" for x in part + 0.0) for part in (acts[:3], acts[3:]))
        raise SceneError(
            f"{when}no contact forces within {margin:.0%} of the friction cones balance what acts "
            f"on the object: at least a force of ({F}) N and a torque of ({T}) N m about its "
            f"origin are left; give more friction than {friction!r}, or contacts that hold it, "
            "such as three around its mass centre"
        )
    return size * forces


def friction_used(forces: ArrayLike, normals: ArrayLike, friction: ArrayLike) -> Array:
    """Part of each friction cone that forces use, (..., n), NaN without contact or friction; forces
    and normals (..., n, 3), friction (n,)."""
    forces, normals = np.asarray(forces), np.asarray(normals)
    pressing = np.sum(forces * normals, axis=-1)
    across = np.linalg.norm(forces - pressing[..., None] * normals, axis=-1)
    limit = np.multiply(friction, pressing)
    return np.divide(across, limit, out=np.full_like(limit, np.nan), where=limit > 0)


def needed_wrench(
    inertia: SpatialInertia, gravity: ArrayLike, R_WO: Array, V_WO: ArrayLike, A_WO: ArrayLike
) -> tuple[Array, Array]:
    """Force and torque about the origin, in O, (m, 3) each, that give A_WO together with gravity.

    inertia : in O, about its origin
    gravity : (3,), in the world
    R_WO : (m, 3, 3)
    V_WO, A_WO : (m, 6) or (6,), of the origin, the angular part first, in the world
    """
    parts = np.hstack([V_WO, A_WO]).reshape(-1, 4, 3) - np.multiply.outer([0, 0, 0, 1], gravity)
    w, _, alpha, a = np.einsum("mji,mkj->kmi", R_WO, parts)
    mass, center = inertia.get_mass(), inertia.get_com()
    about = inertia.CalcRotationalInertia().CopyToFullMatrix3()
    force = mass * (a + np.cross(alpha, center) + np.cross(w, np.cross(w, center)))
    return force, alpha @ about + np.cross(w, w @ about) + mass * np.cross(center, a)


def pressed_config(scene: Scene, config: StationConfig, until: float) -> StationConfig:
    """The configuration with the mean normal force that balancing takes in the scene's plan until a
    time, s, with the object at rest at the world's origin."""
    if not config.balances:
        return config
    t = np.linspace(0.0, until, KNOTS)
    results: Any = Motion(scene, TOLERANCE).evaluate(t, (FRAMES,))
    points, p, q = np.split(results[FRAMES][:, :, 1, :9], 3, axis=-1)
    normals, weight = -np.cross(p, q), config.object_mass * config.gravity
    try:
        forces = balancing_forces(
            *(points, normals, config.friction),
            *(np.tile([0.0, 0.0, weight], (KNOTS, 1)), np.zeros((KNOTS, 3))),
            margin=config.friction_share,
            least=config.normal_force,
            t=t,
        )
    except SceneError as error:
        remedy = 'forces = "constant" presses without a balance'
        raise SceneError(f"{scene.title}: {error}; or {remedy}") from None
    return dataclasses.replace(config, normal_force=float(np.sum(forces * normals, axis=-1).mean()))


def _solve(
    arms: Array, normals: Array, wanted: Array, cones: Array, floor: Array, leaving: bool = False
) -> tuple[Array, Array | None]:
    """Forces, (m, n, 3), and, where no forces exert the wrench, what is left of it, (m, 6)."""
    m, n, _ = arms.shape
    program = MathematicalProgram()
    forces = program.NewContinuousVariables(3 * m * n).reshape(m, n, 3)
    left = program.NewContinuousVariables(6 * m * leaving).reshape(m, -1)
    unit = np.broadcast_to(np.eye(3), (m, n, 3, 3))
    grasp = np.concatenate([unit, np.cross(arms[:, :, None], unit)], axis=3)  # wrench of each unit
    matrices = grasp.reshape(m, -1, 6).swapaxes(1, 2)
    along = normals[:, :, None]
    across = np.eye(3) - along * normals[..., None]
    cone = np.concatenate([cones[:, None, None] * along, across], axis=2)
    costs = 2 * np.diag([*np.ones(3 * n), *np.full(left.shape[1], WRENCH_COST)])
    for k in range(m):
        unknowns = np.append(forces[k], left[k])
        matrix = np.hstack([matrices[k], np.eye(6, left.shape[1])])
        program.AddLinearEqualityConstraint(matrix, wanted[k], unknowns)
        program.AddQuadraticCost(costs, np.zeros(len(unknowns)), unknowns, is_convex=True)
        for i in range(n):
            program.AddConstraint(LorentzConeConstraint(cone[k, i], np.zeros(4)), forces[k, i])
            if floor[i] or not cones[i]:  # a cone without width allows pulling
                program.AddLinearConstraint(normals[k, i], floor[i], np.inf, forces[k, i])
    result = ClarabelSolver().Solve(program)
    if not leaving and not result.is_success():
        # Two opposite contacts exert no torque about their line: drop what rounding asks for there.
        basis, sizes, _ = np.linalg.svd(matrices, full_matrices=False)
        basis *= (sizes > ROUNDING * sizes[:, :1])[:, None]
        possible = (basis @ (basis.swapaxes(1, 2) @ wanted[..., None]))[..., 0]
        if NONE < np.abs(possible - wanted).max() < ROUNDING:
            return _solve(arms, normals, possible, cones, floor)
        return _solve(arms, normals, wanted, cones, floor, leaving=True)
    return (
        result.GetSolution(forces.ravel()).reshape(m, n, 3),
        result.GetSolution(left.ravel()).reshape(m, 6) if leaving else None,
    )


class ForceBalancer(LeafSystem):
    """Contact forces inside the friction cones that hold an object in its place against gravity.

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

    The first two inputs are a planner's (one that restarts moves them with the measured contacts),
    the others the plant's. `contact_forces` (3n) are forces on the object in the world, N, by
    :func:`balancing_forces`: they carry the object's weight and return it to its place, critically
    damped at 30 1/s. The place is the Context's only parameter, a RigidTransform, by default the
    object's default pose. Where the cones do not allow it, as in a push, they come as near as they
    can. `normal_force` (n) and `friction_used` (n) are their normal components, N, and the parts of
    the cones that they use.

    Parameters
    ----------
    scene_plant : ScenePlant
        Its object is free. Friction, and the part of it that is used, are its configuration's.
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
        ticket, self._outputs = array_entry(self._CalcOutputs, (n, sum(OUTPUTS.values())), needs)
        for name, columns in slices(OUTPUTS).items():
            calc = weakly(self._CalcVector, columns)
            self.DeclareVectorOutputPort(name, n * OUTPUTS[name], calc, {ticket})

    def _CalcVector(self, columns: slice, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._outputs(context)[:, columns].ravel())

    def _CalcOutputs(self, context: Context) -> Array:
        X_WO = self._poses.Eval(context)[self._index]
        V_WO = self._velocities.Eval(context)[self._index].get_coeffs()
        R_WO, config = X_WO.rotation().matrix(), self._config
        X_WP = context.get_abstract_parameter(0).get_value()
        A_WO = RATE * (RATE * way_to(X_WP, X_WO) - 2 * V_WO)
        force, torque = needed_wrench(self._inertia, self._gravity, R_WO[None], V_WO, A_WO)
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
