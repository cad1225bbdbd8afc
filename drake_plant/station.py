"""A scene wired up: planner, plant, driver and contact monitor in one Diagram."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from contact_system import Scene, SceneError
from contact_system import plan as make_plan
from contact_system.checks import Array, of_kind

from .balance import OUTPUTS, ForceBalancer, pressed_config
from .config import Push, StationConfig, body_names, check_pushes, checked
from .contact_monitor import ContactMonitor
from .fingertip_driver import FingertipDriver
from .hand_driver import HandDriver
from .hand_kinematics import moving_joints
from .plan_check import TOLERANCE
from .plan_source import PlanSource
from .planner_base import EARLY, FOREVER, PlannerBase
from .planner_system import ContactPlanner
from .plant import MOTIONS, AddScenePlant, ScenePlant, turning_angle
from .pressing import contact_depth, depth_between, require_alike, rolling_scene
from .reorientation import Reorientation


def BuildStation(scene: Scene, config: StationConfig | None = None) -> Diagram:
    """A Diagram of planner, plant, driver and monitor of a scene.

    The planner plans :func:`rolling_scene`, on the surfaces that bodies roll on once pressed.

    .. pydrake_system::

        name: Station
        input_ports:
        - push (without pushes)
        - noise
        - disturbance (with disturbance_input)
        output_ports:
        - planned_contact_forces, planned_normal_force, planned_friction_used (with a balance)
        - those of the planner, such as pose
        - spatial_forces
        - those of the monitor, such as normal_force; measured_state, measured_slip
          and measured_contact_point, as the planner has ports of these names
        - plant_state
        - object_state
        - body_poses
        - contact_results
        - query

    `push` and `spatial_forces` are the driver's (see :class:`FingertipDriver`), `noise` the
    monitor's (:class:`ContactMonitor`), `disturbance` the planner's (:class:`ContactPlanner`), the
    last five the plant's and the scene graph's, and planned forces a :class:`ForceBalancer`'s.
    The systems are named "planner", "driver", "monitor", "plant" and "scene_graph"; with pushes
    there is a "push", and if forces balance gravity a "balancer". Threads may share a station if
    each has its own Context.

    Parameters
    ----------
    scene : Scene
    config : StationConfig, optional
        None: ``StationConfig.from_scene(scene)``.

    Raises
    ------
    SceneError
        A wrong setting, or a scene that :func:`AddScenePlant` or :class:`ContactPlanner` refuses;
        in a simulation with meshes, a time beyond the scene's end.
    """
    return build(scene, checked(scene, config, "station"))[0].Build()


def build(
    scene: Scene, config: StationConfig, until: float | None = None
) -> tuple[DiagramBuilder, ScenePlant]:
    """Builder and plant of a station to be simulated until a time, s (None: the scene's end)."""
    if config.hand is not None:
        raise SceneError(
            f"{scene.title}: its fingertips are on a hand: give plan_reorientation(hand, scene) to "
            "BuildHandStation"
        )
    builder, least = DiagramBuilder(), config.normal_force
    config = pressed_config(scene, config, scene.duration if until is None else until)
    parts = AddScenePlant(builder, scene, config)
    planned = rolling_scene(scene, config)
    planner = builder.AddNamedSystem("planner", _planner(planned, config))
    driver = builder.AddNamedSystem("driver", FingertipDriver(parts))
    starts = _starts(planner, planner.CreateDefaultContext(), driver, np.zeros(3))
    for body, (X_OF, _) in zip(parts.finger_bodies, starts):
        parts.plant.SetDefaultFloatingBaseBodyPose(body, X_OF)
    monitor = _add_monitor(builder, parts, planned, driver)
    plant = parts.plant
    wire(builder, planner, driver, "motion")
    wire(builder, plant, driver, *MOTIONS)
    if config.time_step:
        wire(builder, plant, driver, "body_spatial_accelerations")
    else:
        instance = parts.object_body.model_instance()
        forces = plant.get_generalized_contact_forces_output_port(instance)
        builder.Connect(forces, driver.GetInputPort("generalized_contact_forces"))
    if config.restarts:
        builder.Connect(monitor.GetOutputPort("state"), planner.GetInputPort("measured_state"))
    applied = plant.get_applied_spatial_force_input_port()
    builder.Connect(driver.GetOutputPort("spatial_forces"), applied)
    if config.balances:
        balancer = builder.AddNamedSystem("balancer", ForceBalancer(parts, least))
        wire(builder, planner, balancer, "contact_point", "normal")
        wire(builder, plant, balancer, *MOTIONS)
        wire(builder, balancer, driver, "contact_forces")
        for name in OUTPUTS:
            builder.ExportOutput(balancer.GetOutputPort(name), f"planned_{name}")
    builder.ExportInput(monitor.GetInputPort("noise"), "noise")
    if config.disturbance_input:
        builder.ExportInput(planner.GetInputPort("disturbance"), "disturbance")
    _export(builder, parts, planner, driver, monitor)
    return builder, parts


def BuildHandStation(plan: Reorientation) -> Diagram:
    """A Diagram of plant, :class:`HandDriver` and :class:`ContactMonitor` for a hand's plan.

    The systems are named "plant", "scene_graph", "driver" and "monitor"; with pushes there is a
    "push", else the driver's port `push` is exported. The plant starts as the plan does.
    """
    of_kind(Reorientation, plan, "plan", "a Reorientation")
    return build_hand(plan)[0].Build()


def build_hand(plan: Reorientation) -> tuple[DiagramBuilder, ScenePlant]:
    """Builder and plant of a hand's station."""
    builder = DiagramBuilder()
    parts = AddScenePlant(builder, plan.scene, plan.config)
    plant = parts.plant
    driver = builder.AddNamedSystem("driver", HandDriver(plan, parts))
    _add_monitor(builder, parts, plan.rolling, driver)
    wire(builder, plant, driver, "state", "body_poses")
    builder.Connect(
        driver.GetOutputPort("generalized_force"), plant.get_applied_generalized_force_input_port()
    )
    plant.SetDefaultFloatingBaseBodyPose(parts.object_body, plan.wanted(0.0))
    for joint, position in zip(moving_joints(plant), plan.q[0]):
        joint.set_default_positions([position])
    return builder, parts


def wire(builder: DiagramBuilder, source: LeafSystem, target: LeafSystem, *names: str) -> None:
    """Connect ports that have the same names on both systems."""
    for name in names:
        builder.Connect(source.GetOutputPort(name), target.GetInputPort(name))


def _add_monitor(
    builder: DiagramBuilder, parts: ScenePlant, planned: Scene, driver: LeafSystem
) -> ContactMonitor:
    """Add the monitor; connect the driver's port `push` to the given pushes, or export it."""
    monitor = builder.AddNamedSystem("monitor", ContactMonitor(planned, parts))
    wire(builder, parts.plant, monitor, "contact_results", *MOTIONS)
    if parts.config.time_step:
        wire(builder, parts.plant, monitor, "body_spatial_accelerations")
    config, port = parts.config, driver.GetInputPort("push")
    if config.slip_gain:
        wire(builder, monitor, driver, "sliding")
    if config.pushes:
        source = PushSource(parts.scene, config.pushes, config.time_step)
        builder.Connect(builder.AddNamedSystem("push", source).get_output_port(), port)
    else:
        builder.ExportInput(port, "push")
    return monitor


def PushSource(scene: Scene, pushes: Sequence[Push], time_step: float = 0.0) -> TrajectorySource:
    """A source of pushes for the port `push` of a :class:`FingertipDriver`: (3n + 3), N.

    Parameters
    ----------
    scene : Scene
    pushes : sequence of Push
    time_step : float
        s, of a discrete plant, which applies a constant force in each step: where a push begins or
        ends within a step, the force is its mean over the step. 0: a push acts as it is given.

    Raises
    ------
    SceneError
        A push on a body that the scene does not have, or a wrong number.
    """
    check_pushes(scene, pushes)
    names = body_names(scene)
    edges = np.array([0.0, *(p.start for p in pushes), *(p.stop for p in pushes)])
    if time_step:
        steps = np.floor(edges / time_step + 1e-6)
        edges = time_step * np.concatenate([steps, steps + 1])
    edges = np.unique(edges)  # below, edges that differ by rounding alone are merged
    edges = np.append(edges[np.diff(edges, prepend=-1.0) > 2 * EARLY], FOREVER)
    forces = np.zeros((len(edges), len(names), 3))
    for push in pushes:
        acting = np.diff(np.clip(edges, push.start, push.stop)) / np.diff(edges)
        forces[:-1, names.index(push.on)] += np.outer(acting, push.force)
    breaks = np.maximum(edges, EARLY) - EARLY
    held = PiecewisePolynomial.ZeroOrderHold(breaks, forces.reshape(len(breaks), -1).T)
    return TrajectorySource(held)


def _export(builder: DiagramBuilder, parts: ScenePlant, *systems: LeafSystem) -> None:
    """Export outputs; one whose name an earlier system has exported gets the prefix measured_."""
    taken: set[str] = set()
    for system in systems:
        for port in map(system.get_output_port, range(system.num_output_ports())):
            name = port.get_name()
            builder.ExportOutput(port, "measured_" * (name in taken) + name)
            taken.add(name)
    plant, instance = parts.plant, parts.object_body.model_instance()
    builder.ExportOutput(plant.get_state_output_port(), "plant_state")
    builder.ExportOutput(plant.get_state_output_port(instance), "object_state")
    for name in ("body_poses", "contact_results"):
        builder.ExportOutput(plant.GetOutputPort(name), name)
    builder.ExportOutput(parts.scene_graph.get_query_output_port(), "query")


def _planner(scene: Scene, config: StationConfig) -> PlannerBase:
    if config.coordinates == "plan":
        return PlanSource(make_plan(scene))
    return ContactPlanner(
        scene,
        config.coordinates,
        disturbance_input=config.disturbance_input,
        restart_period=config.restart_period,
        restart_distance=config.restart_distance,
        # With the short steps of a discrete plant all schemes but Euler's are accurate enough.
        tolerance=1e-4 if config.time_step else TOLERANCE,
    )


def SetInitialState(station: Diagram, context: Context) -> None:
    """Put the fingers of a station where they are planned, with the planned velocities.

    The plan is taken at the planner's state and time in the context (by default the start of the
    scene). The object stays as the context has it (by default at the world's origin, at rest), but
    if it turns on the joint of :func:`AddScenePlant`, it is put where the scene has it at that
    time. Each finger is pressed in as deep as its normal force presses it at the end of the plant's
    first step. Earlier steps of the plant are forgotten: as in a new context, the plant's
    accelerations and contact forces are zero until its first step.

    Parameters
    ----------
    station : Diagram
        From :func:`BuildStation`, or your own with systems "planner", "driver" and "plant", and a
        ForceBalancer "balancer" if contact forces balance gravity.
    context : Context
        The root Context: the station's, or that of the outermost Diagram that contains it.

    Raises
    ------
    SceneError
        Not a station, or a planner with other surfaces, sizes or contacts than the driver has.
    """
    names = "planner", "driver", "plant"
    if not isinstance(station, Diagram) or not all(map(station.HasSubsystemNamed, names)):
        raise SceneError(
            f"station = {station!r}: give what BuildStation made, or a Diagram of your own whose "
            "ContactPlanner, FingertipDriver and MultibodyPlant are named 'planner', 'driver' and "
            "'plant'; of a Diagram that contains it give the station, and the Diagram's context"
        )
    planner, driver, plant = map(station.GetSubsystemByName, names)
    require_alike(planner.system.scene, driver.scene, driver.config, "planner")
    try:
        now = planner.GetMyContextFromRoot(context)
    except RuntimeError:
        raise SceneError("context: give the root's, of the Diagram that contains all") from None
    physics = plant.GetMyMutableContextFromRoot(context)
    scene, config, t = driver.scene, driver.config, context.get_time()
    # A plant of the user's own may turn its object in another way.
    if config.object == "turning" and scene.turning and plant.HasJointNamed("turning"):
        joint, angle = plant.GetJointByName("turning"), turning_angle(scene.turning)
        joint.set_angle(physics, angle(t))
        joint.set_angular_rate(physics, angle.deriv()(t - driver.step / 2))
    obj = plant.get_body(BodyIndex(driver.object_index))
    X_WO, V_WO = obj.EvalPoseInWorld(physics), obj.EvalSpatialVelocityInWorld(physics)
    forces = None
    if station.HasSubsystemNamed("balancer"):
        balancer = station.GetSubsystemByName("balancer")
        balancing = balancer.GetMyMutableContextFromRoot(context)
        balancing.get_mutable_abstract_parameter(0).set_value(X_WO)
        forces = balancer.GetOutputPort("normal_force").Eval(balancing)
    R_WO = X_WO.rotation()
    starts = _starts(planner, now, driver, R_WO.inverse() @ V_WO.rotational(), forces)
    for index, (X_OF, V_OF) in zip(driver.finger_indices, starts):
        body, p_OF_W = plant.get_body(BodyIndex(index)), R_WO @ X_OF.translation()
        V_WF = V_WO.ComposeWithMovingFrameVelocity(p_OF_W, V_OF.Rotate(R_WO))
        plant.SetFreeBodyPose(physics, body, X_WO @ X_OF)
        plant.SetFreeBodySpatialVelocity(context=physics, body=body, V_JpJc=V_WF)
    # Reset the plant's sampled outputs, which SetDefaultContext leaves as they were.
    sampled = plant.CreateDefaultContext().get_abstract_state()
    physics.get_mutable_state().get_mutable_abstract_state().SetFrom(sampled)


def _starts(
    planner: PlannerBase,
    now: Context,
    driver: FingertipDriver,
    w_O: Array,
    forces: Array | None = None,
) -> list[tuple[RigidTransform, SpatialVelocity]]:
    """X_OF and V_OF_O as planned, but pressed in by the depth for the forces (None: the usual one);
    w_O is the object's angular velocity in O."""
    poses, step = planner.GetOutputPort("pose").Eval(now), driver.step
    p = np.array([X_OF.translation() for X_OF in poses])
    planned = planner.Evaluate(now, "twist", "acceleration", "contact_point", "normal")
    w, v, alpha, a, _, at, normals = np.split(planned, 7, axis=1)
    # A discrete plant's velocity moved it over the last step: it is that of half a step ago.
    v = v - step / 2 * (a + np.cross(w_O, np.cross(w_O, p) + 2 * v))
    w = w - step / 2 * (alpha + np.cross(w_O, w))
    # The first step presses by the depth at its end, taken along the normal at its beginning: a
    # finger comes nearer in it by as much as it went away in the step before.
    away = step * np.sum(normals * (v + np.cross(w, at - p)), axis=1)
    pairs = zip(driver.scene.surfaces, planner.system.scene.surfaces)
    of_object, *of_fingers = (depth_between(nominal, planned) for nominal, planned in pairs)
    starts = []
    for i, X_OF in enumerate(poses):
        depth = contact_depth(driver.config, None if forces is None else forces[i])
        out = away[i] + of_object + of_fingers[i] - depth
        X_OF = RigidTransform(X_OF.rotation(), p[i] + out * normals[i])
        starts.append((X_OF, SpatialVelocity(w[i], v[i])))
    return starts
