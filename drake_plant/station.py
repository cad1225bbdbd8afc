"""A scene wired up: planner, plant, driver and contact monitor in one Diagram."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

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

from .balance import FOUND, ForceBalancer, pressed_config
from .config import Push, StationConfig, body_names, check_pushes, checked
from .contact_monitor import ContactMonitor
from .fingertip_driver import FingertipDriver
from .hand_driver import HandDriver
from .hand_kinematics import moving_joints
from .plan_check import TOLERANCE
from .plan_source import PlanSource
from .planner_base import AGES, EARLY, PlannerBase
from .planner_system import ContactPlanner
from .plant import MOTIONS, AddScenePlant, ScenePlant, turning_angle
from .pressing import contact_depth, depth_between, require_alike, rolling_scene
from .reorientation import Reorientation

STARTED = "planner", "driver", "plant"


def BuildStation(scene: Scene, config: StationConfig | None = None) -> Diagram:
    """Planner, plant, driver and monitor of a scene, wired.

    The planner plans on the radii that bodies roll on once they are pressed together: that is of
    :func:`rolling_scene`.

    .. pydrake_system::

        name: Station
        input_ports:
        - push (without pushes)
        - noise
        - disturbance (with disturbance_input)
        output_ports:
        - those of the planner, such as pose
        - spatial_forces
        - those of the monitor, such as normal_force; measured_state, measured_slip
          and measured_contact_point, as the planner has ports of these names
        - planned_contact_forces, planned_normal_force, planned_friction_used (with a balance)
        - plant_state
        - object_state
        - body_poses
        - contact_results
        - query

    `push` and `spatial_forces` are the driver's (see :class:`FingertipDriver`), `noise` the
    monitor's (:class:`ContactMonitor`), `disturbance` the planner's (:class:`ContactPlanner`), the
    last five the plant's and the scene graph's, those that are planned a :class:`ForceBalancer`'s.
    The systems are named "planner", "driver", "monitor", "plant" and "scene_graph", with pushes
    "push" too, and "balancer" where forces balance gravity. Threads may share a station, with
    a Context each.

    Parameters
    ----------
    scene : Scene
    config : StationConfig, optional
        None: ``StationConfig.from_scene(scene)``.

    Raises
    ------
    SceneError
        A value of the configuration, or what :func:`AddScenePlant` and :class:`ContactPlanner`
        cannot do, with the remedy; in a simulation with meshes, a time beyond the scene's end.
    """
    return build(scene, checked(scene, config, "station"))[0].Build()


def build(
    scene: Scene, config: StationConfig, until: float | None = None
) -> tuple[DiagramBuilder, ScenePlant]:
    """A station, to be built, that is simulated until a time, s, or the scene's end."""
    if config.hand is not None:
        raise SceneError(
            f"{scene.title}: a hand holds its fingertips: give plan_reorientation(hand, scene) to "
            "BuildHandStation"
        )
    builder, least = DiagramBuilder(), config.normal_force
    config = pressed_config(scene, config, scene.duration if until is None else until)
    parts = AddScenePlant(builder, scene, config)
    planned = rolling_scene(scene, config)
    planner = builder.AddNamedSystem("planner", _planner(planned, config))
    driver = builder.AddNamedSystem("driver", FingertipDriver(parts))
    start = _finger_poses(planner, planner.CreateDefaultContext(), driver)
    for body, X_OF in zip(parts.finger_bodies, start):
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
        for name in FOUND:
            builder.ExportOutput(balancer.GetOutputPort(name), f"planned_{name}")
    builder.ExportInput(monitor.GetInputPort("noise"), "noise")
    if config.disturbance_input:
        builder.ExportInput(planner.GetInputPort("disturbance"), "disturbance")
    _export(builder, parts, planner, driver, monitor)
    return builder, parts


def BuildHandStation(plan: Reorientation) -> Diagram:
    """Plant, :class:`HandDriver` and :class:`ContactMonitor` of a plan, wired.

    The systems are named "plant", "scene_graph", "driver", "monitor", and "push" where there are
    pushes; else the driver's port is exported as `push`. The plant's default state is the start.
    """
    of_kind(Reorientation, plan, "plan", "a Reorientation")
    return build_hand(plan)[0].Build()


def build_hand(plan: Reorientation) -> tuple[DiagramBuilder, ScenePlant]:
    """A hand's station, to be built."""
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
    """What measures contact, and what disturbs it: the configuration's pushes, or a port."""
    monitor = builder.AddNamedSystem("monitor", ContactMonitor(planned, parts))
    wire(builder, parts.plant, monitor, "contact_results", *MOTIONS)
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
    """What the port `push` of a :class:`FingertipDriver` takes: (3n + 3), N.

    Parameters
    ----------
    scene : Scene
    pushes : sequence of Push
    time_step : float
        Of a discrete plant, s, which holds a force for a step: in steps where a push begins or
        ends, its mean; 0: as it is.

    Raises
    ------
    SceneError
        A push on something that the scene has not, or a wrong number.
    """
    check_pushes(scene, pushes)
    names = body_names(scene)
    edges = np.array([0.0, *(p.start for p in pushes), *(p.stop for p in pushes)])
    if time_step:
        steps = np.floor(edges / time_step + 1e-6)
        edges = time_step * np.concatenate([steps, steps + 1])
    edges = np.unique(edges)  # those that differ by rounding alone count once
    edges = np.append(edges[np.diff(edges, prepend=-1.0) > 2 * EARLY], AGES)
    forces = np.zeros((len(edges), len(names), 3))
    for push in pushes:
        acting = np.diff(np.clip(edges, push.start, push.stop)) / np.diff(edges)
        forces[:-1, names.index(push.on)] += np.outer(acting, push.force)
    breaks = np.maximum(edges, EARLY) - EARLY
    held = PiecewisePolynomial.ZeroOrderHold(breaks, forces.reshape(len(breaks), -1).T)
    return TrajectorySource(held)


def _export(builder: DiagramBuilder, parts: ScenePlant, *systems: LeafSystem) -> None:
    """Export outputs, measured ones by another name where a system before has that."""
    taken: set[str] = set()
    for system in systems:
        names = [system.get_output_port(i).get_name() for i in range(system.num_output_ports())]
        for name in names:
            builder.ExportOutput(system.GetOutputPort(name), "measured_" * (name in taken) + name)
        taken.update(names)
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
        # With steps as short as a discrete plant's, all schemes but Euler's are exact enough.
        tolerance=1e-4 if config.time_step else TOLERANCE,
    )


def SetInitialState(station: Diagram, context: Context) -> None:
    """Put the fingers of a station where its planner is, moving as planned.

    What is planned is what the context has for the planner, state and time (by default the start of
    the scene). The object stays as the context has it (by default at the world's origin, at rest),
    but one that turns on the joint of :func:`AddScenePlant` is put where the scene has it at that
    time. Each finger is pressed in as deep as its normal force presses it. The plant forgets
    the steps before: as in a new context, the plant's accelerations and contact forces are zero
    until its first step.

    Parameters
    ----------
    station : Diagram
        From :func:`BuildStation`, or of your own with systems "planner", "driver" and "plant", and
        with a ForceBalancer "balancer" where forces balance.
    context : Context
        The root: the station's own, or that of a Diagram that contains it.

    Raises
    ------
    SceneError
        No station, or a planner with other surfaces, sizes or contacts than the driver has.
    """
    planner, driver, plant = _started(station)
    require_alike(planner.system.scene, driver.scene, driver.config, "planner")
    try:
        now = planner.GetMyContextFromRoot(context)
    except RuntimeError:
        raise SceneError("context: give the root's, of the Diagram that contains all") from None
    physics = plant.GetMyMutableContextFromRoot(context)
    scene, config, t = driver.scene, driver.config, context.get_time()
    # A velocity of a discrete plant is the one that brought it here: that of half a step ago.
    ago = 0.5 * plant.time_step()
    # A plant of somebody's own may turn its object in another way.
    if config.object == "turning" and scene.turning and plant.HasJointNamed("turning"):
        joint, angle = plant.GetJointByName("turning"), turning_angle(scene.turning)
        joint.set_angle(physics, angle(t))
        joint.set_angular_rate(physics, angle.deriv()(t - ago))
    obj = plant.get_body(BodyIndex(driver.object_index))
    X_WO, V_WO = obj.EvalPoseInWorld(physics), obj.EvalSpatialVelocityInWorld(physics)
    forces = None
    if station.HasSubsystemNamed("balancer"):
        balancer = station.GetSubsystemByName("balancer")
        own = balancer.GetMyMutableContextFromRoot(context)
        own.get_mutable_abstract_parameter(0).set_value(X_WO)
        forces = balancer.GetOutputPort("normal_force").Eval(own)
    R_WO = X_WO.rotation()
    twist, change = (planner.GetOutputPort(name).Eval(now) for name in ("twist", "acceleration"))
    twists = (twist - ago * change).reshape(-1, 6)
    poses = _finger_poses(planner, now, driver, forces)
    for index, X_OF, twist in zip(driver.finger_indices, poses, twists):
        body = plant.get_body(BodyIndex(index))
        V_OF_W = SpatialVelocity(twist[:3], twist[3:]).Rotate(R_WO)
        V_WF = V_WO.ComposeWithMovingFrameVelocity(R_WO @ X_OF.translation(), V_OF_W)
        plant.SetFreeBodyPose(physics, body, X_WO @ X_OF)
        plant.SetFreeBodySpatialVelocity(context=physics, body=body, V_JpJc=V_WF)
    # The sampled outputs of Drake's plant outlive SetDefaultContext.
    sampled = plant.CreateDefaultContext().get_abstract_state()
    physics.get_mutable_state().get_mutable_abstract_state().SetFrom(sampled)


def _started(station: Diagram) -> list[Any]:
    """The systems named in `STARTED`."""
    if not isinstance(station, Diagram) or not all(map(station.HasSubsystemNamed, STARTED)):
        raise SceneError(
            f"station = {station!r}: give what BuildStation made, or a Diagram of your own whose "
            "ContactPlanner, FingertipDriver and MultibodyPlant are named 'planner', 'driver' and "
            "'plant'; of a Diagram that contains it give the station, and the Diagram's context"
        )
    return [station.GetSubsystemByName(name) for name in STARTED]


def _finger_poses(
    planner: PlannerBase, context: Context, driver: FingertipDriver, forces: Array | None = None
) -> list[RigidTransform]:
    """X_OF as planned, each finger pressed in by the depth of its force on the nominal surfaces."""
    config, poses = driver.config, planner.GetOutputPort("pose").Eval(context)
    normals = planner.GetOutputPort("normal").Eval(context).reshape(-1, 3)
    if forces is None:
        forces = np.full(len(poses), config.normal_force)
    pairs = zip(driver.scene.surfaces, planner.system.scene.surfaces)
    of_object, *of_fingers = (depth_between(nominal, planned) for nominal, planned in pairs)
    return [
        RigidTransform(X.rotation(), X.translation() - (contact_depth(config, force) - d) * n)
        for X, n, force, d in zip(poses, normals, forces, of_object + np.array(of_fingers))
    ]
