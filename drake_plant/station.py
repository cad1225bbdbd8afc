"""A scene wired up: planner, plant, fingertip driver and contact monitor in one Diagram.

``BuildStation`` gives the Diagram, ``SetInitialState`` puts its bodies where the plan starts, and
``simulate`` does both, runs and logs::

    station = BuildStation(scene)                      # systems "planner", "plant", "driver", ...
    simulator = Simulator(station)
    SetInitialState(station, simulator.get_mutable_context())
    simulator.AdvanceTo(4.0)
"""

from __future__ import annotations

import dataclasses
import gc
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import LogVectorOutput

from contact_system import ImplicitSurface, Quadric, Scene, SceneError, Surface
from contact_system import plan as make_plan
from contact_system.checks import (
    a_path,
    did_you_mean,
    finite_number,
    flag,
    function_or_none,
    naming,
)
from contact_system.scene import require_scene
from contact_system.system import COORDINATES
from contact_system.theory import symbols as ca

from .contact_monitor import ContactMonitor
from .fingertip_driver import DriverConfig, FingertipDriver
from .meshes import is_round
from .object_acceleration import ObjectAcceleration
from .plan_check import TOLERANCE
from .plan_source import PlanSource
from .planner_system import LOOK, ContactPlanner, PlannerBase
from .plant import (
    RADII,
    AddScenePlant,
    PlantConfig,
    ScenePlant,
    check_depth,
    check_numbers,
    check_words,
    contact_depth,
    require_config,
    turning_angle,
    types_known,
)
from .pushes import Push, PushSource, check_pushes, pushes_of

Array = NDArray[np.float64]

STARTED = {"planner": PlannerBase, "driver": FingertipDriver, "plant": MultibodyPlant}
PLANNED = ("state", "slip", "contact_point")
LOGGED = 1e-3  # s, at which simulate logs where steps are shorter
MEASURED = ("state", "slip", "normal_force", "tangential_force", "contact_point")
INTEGRATION = SimulatorConfig(
    integration_scheme="runge_kutta5", accuracy=1e-8, max_step_size=1e-2, use_error_control=True
)
""" Of the planner's continuous states; the plant's are discrete."""
CONTINUOUS = SimulatorConfig(
    integration_scheme="runge_kutta3", accuracy=1e-4, max_step_size=1e-3, use_error_control=True
)
"""Of a continuous plant: with a larger accuracy the planner is further off than it may be."""


@types_known
@dataclass
class StationConfig:
    """What a station is made of.

    Attributes
    ----------
    plant : PlantConfig
    driver : DriverConfig
    coordinates : str or None
        "chart" or "frame", of the :class:`ContactPlanner`, who chooses where it is None; "plan": a
        :class:`PlanSource` is the planner, without states, disturbance port and restarts, exact
        under every scheme.
    disturbance_input : bool
        Whether the planner's `disturbance` port is there, exported.
    restart_period, restart_distance : float or None
        The planner restarts from the measured state every so many seconds; with both, only
        contacts that are so many m from the planned point; with the distance alone, looked at every
        0.01 s. None: it does not. Restarts have to fall on steps of the plant. Slip is rejected by
        the driver's ``slip_gain``; a restart serves where the way back to the curve is too long.
    rolling_radii : bool
        Plan on the radii that bodies roll on once they are pressed together (see
        :func:`rolling_scene`), else on the nominal ones.
    pushes : list of Push
        Where there are any, they are what the port `push` would give.
    """

    plant: PlantConfig = field(default_factory=PlantConfig)
    driver: DriverConfig = field(default_factory=DriverConfig)
    coordinates: str | None = None
    disturbance_input: bool = False
    restart_period: float | None = None
    restart_distance: float | None = None
    rolling_radii: bool = True
    pushes: list[Push] = field(default_factory=list)

    @property
    def restarts(self) -> bool:
        """Whether the planner restarts from measured states."""
        return self.restart_period is not None or self.restart_distance is not None

    @property
    def closed_loop(self) -> bool:
        """Whether anything that is measured acts on the fingers."""
        return self.restarts or self.driver.slip_gain > 0

    def opened(self) -> StationConfig:
        """The same with the loop open."""
        driver = dataclasses.replace(self.driver, slip_gain=0.0)
        return dataclasses.replace(self, driver=driver, restart_period=None, restart_distance=None)

    def check(self) -> None:
        """Raise a SceneError that names the first field that is wrong, its value and the remedy."""
        for key, kind in (("plant", PlantConfig), ("driver", DriverConfig)):
            part = getattr(self, key)
            require_config(part, kind, key)
            part.check()
        if self.coordinates is not None:
            check_words(self, {"coordinates": (*COORDINATES, "plan")})
        for key in ("disturbance_input", "rolling_radii"):
            flag(getattr(self, key), key)
        check_numbers(self, ("restart_period",), "above 0")
        check_numbers(self, ("restart_distance",), "not below 0")
        if self.coordinates == "plan" and (self.restarts or self.disturbance_input):
            raise SceneError(
                'coordinates = "plan": a plan has no disturbance port and does not restart; give '
                '"chart" or "frame", or leave disturbance_input and restarts out'
            )
        if self.driver.slip_gain and not self.plant.time_step:
            raise SceneError(
                f"slip_gain = {self.driver.slip_gain!r}: at time_step = 0 the slip depends "
                "on the force that it asks for: give a time step, such as 0.001 s, or no slip_gain"
            )
        if self.restarts and self.plant.time_step:
            self._check_restarts()

    def _check_restarts(self) -> None:
        """Between two steps a discrete plant is at the end of the step already: a planner that
        restarts there is ahead of its time, by another part of a step each time."""
        step, period = self.plant.time_step, self.restart_period
        steps = max((LOOK if period is None else period) / step, 1e-9)
        whole = round(steps) if steps > 0.75 else 1 / round(1 / steps)
        # A little early does no harm; a little late is a whole step ahead (but see EARLY).
        if not -1e-6 < steps / whole - 1 < 1e-9:
            every = f" (None: {LOOK:g} s)" if period is None else ""
            raise SceneError(
                f"restart_period = {period!r}{every}: restarts have to fall on steps of the plant, "
                f"time_step = {step!r}; give restart_period = {max(1, round(steps)) * step:.9g}, "
                "or another multiple of it"
            )

    @classmethod
    def from_scene(cls, scene: Scene, **changes: Any) -> StationConfig:
        """The scene's ``[drake]`` table, one flat table of all fields, and changes to it.

        The object of a scene with a ``[turning]`` is "turning" unless they say otherwise.

        Raises
        ------
        SceneError
            An unknown key, with the nearest known one, or a value that is wrong.
        """
        require_scene(scene)
        table = {**({"object": "turning"} if scene.turning else {}), **scene.drake, **changes}
        own = [f for f in dataclasses.fields(cls) if f.name not in ("plant", "driver")]
        known = {
            "plant": dataclasses.fields(PlantConfig),
            "driver": dataclasses.fields(DriverConfig),
        }
        names = {f.name for fields in (own, *known.values()) for f in fields}
        for key in table:
            if key not in names:
                raise SceneError(
                    f"{scene.title}, [drake]: key {key!r} is unknown"
                    f"{did_you_mean(key, names)}; the keys here are {', '.join(sorted(names))}"
                )

        def take(fields: Any) -> dict[str, Any]:
            return {f.name: table[f.name] for f in fields if f.name in table}

        config = cls(
            plant=PlantConfig(**take(known["plant"])),
            driver=DriverConfig(**take(known["driver"])),
            **take(own),
        )
        with naming(f"{scene.title}, [drake]"):
            config.pushes = pushes_of(config.pushes)
            config.check()
            check_pushes(scene, config.pushes)
        return config


def rolling_scene(scene: Scene, config: PlantConfig) -> Scene:
    """The scene with bodies as large as they roll once pressed together.

    A compliant finger gives way to a rigid object, so it rolls on a surface by the depth inside its
    own; two equal point contacts share the depth. (That the patch is curved does not matter: what
    the object's surface drops towards the rim the tilt of friction there makes up for, see
    `contact_monitor`.) Of spheres, cylinders and tori that surface is another of their kind, and so
    it is nearly of ellipsoids; of others it is their equation, shifted along the normal.

    Parameters
    ----------
    scene : Scene
    config : PlantConfig
        Its normal force and stiffness say the depth.

    Raises
    ------
    SceneError
        No scene, no PlantConfig, or a depth of half a body's least radius or more.
    """
    require_scene(scene)
    with naming(scene.title):
        require_config(config, PlantConfig)
        check_depth(scene, config)
    depth, point = contact_depth(config), config.contact_model == "point"
    of_finger, of_object = (0.5 * depth, 0.5 * depth) if point else (depth, 0.0)
    contacts = [
        dataclasses.replace(contact, finger=_smaller(contact.finger, of_finger))
        for contact in scene.contacts
    ]
    return dataclasses.replace(scene, object=_smaller(scene.object, of_object), contacts=contacts)


def _smaller(surface: Surface, by: float) -> Surface:
    """The surface so much further inside the body: of all that can be fingertips, and planes."""
    names, less = RADII.get(type(surface)), -by if surface.inside else by
    if names:
        values = {name: getattr(surface, name) - less for name in names}
        return dataclasses.replace(surface, **values)
    if isinstance(surface, Quadric) and is_round(surface) and less:
        return _smaller_quadric(surface, less)
    if isinstance(surface, ImplicitSurface) and less:
        return _smaller_implicit(surface, less)
    return surface


def _smaller_quadric(surface: Quadric, by: float) -> Quadric:
    """An ellipsoid with smaller axes; as it is where coordinates would be laid another way."""
    values, axes = np.linalg.eigh(surface.A)
    matrix = axes @ np.diag((values**-0.5 - by) ** -2) @ axes.T
    smaller = dataclasses.replace(surface, A=(matrix + matrix.T) / 2)
    moved = np.linalg.norm(smaller.point(1.0, 0.5) - surface.point(1.0, 0.5))
    return smaller if moved < 2 * abs(by) else surface


def _smaller_implicit(surface: ImplicitSurface, by: float) -> ImplicitSurface:
    """The points from which the surface is so far along the gradient of its equation."""
    formula = surface.formula
    depth = max("depth", *formula.names, key=len) + "_"  # a name that is free

    def shifted(x: ca.SX, **numbers: ca.SX) -> ca.SX:
        by = numbers.pop(depth)
        level = formula(ca.vertcat(*(numbers[name] for name in formula.names)), x)
        gradient = ca.gradient(level, x)
        normal = gradient / ca.sqrt(ca.sumsqr(gradient) + np.finfo(float).tiny)  # 0 at the centre
        return ca.substitute(level, x, x + by * normal)

    return ImplicitSurface(
        shifted,
        center=surface.center,
        parameters={**surface.named_parameters, depth: by},
        size=surface.size - by,
        inside=surface.inside,
    )


def _depth_between(nominal: Surface, planned: Surface) -> float:
    """By how much `_smaller` made a surface smaller, m."""
    name, *_ = RADII.get(type(nominal), ("size",))
    less = getattr(nominal, name) - getattr(planned, name)
    return -less if nominal.inside else less


def BuildStation(scene: Scene, config: StationConfig | None = None) -> Diagram:
    """Planner, plant, driver and monitor of a scene, wired.

    .. pydrake_system::

        name: Station
        input_ports:
        - push (without pushes)
        - noise
        - disturbance (with disturbance_input)
        output_ports:
        - state
        - slip
        - twist
        - acceleration
        - contact_point
        - normal
        - normal_rate
        - pose
        - restarts (with restart_period or restart_distance)
        - spatial_forces
        - measured_slip
        - normal_force
        - tangential_force
        - measured_contact_point
        - measured_state
        - sliding
        - plant_state
        - object_state
        - body_poses
        - contact_results
        - query

    The first eight are the planner's (see :class:`ContactPlanner`), `spatial_forces` the driver's,
    the next six the monitor's (see :class:`ContactMonitor`), the last five the plant's and the
    scene graph's; `push` is the driver's (see :class:`FingertipDriver`), `noise` the monitor's. The
    systems are named "planner", "driver", "monitor", "plant" and "scene_graph", with pushes "push"
    too. Threads may share a station, with a Context each.

    Parameters
    ----------
    scene : Scene
    config : StationConfig, optional
        None: ``StationConfig.from_scene(scene)``.

    Raises
    ------
    SceneError, SurfaceError
        A value of the configuration, or what :func:`AddScenePlant` and :class:`ContactPlanner`
        cannot do, with the remedy.
    """
    return _build(scene, _checked(scene, config))[0]


def _checked(scene: Scene, config: StationConfig | None) -> StationConfig:
    if config is None:
        return StationConfig.from_scene(scene)
    require_scene(scene)
    with naming(f"{scene.title}, station"):
        require_config(config, StationConfig)
        config.check()
        check_pushes(scene, config.pushes)
    return config


def _build(
    scene: Scene,
    config: StationConfig,
    extend: Callable[[DiagramBuilder, ScenePlant], None] | None = None,
) -> tuple[Diagram, ScenePlant]:
    builder = DiagramBuilder()
    parts = AddScenePlant(builder, scene, config.plant)
    planned = rolling_scene(scene, config.plant) if config.rolling_radii else scene
    planner = builder.AddNamedSystem("planner", _planner(planned, config))
    start = _finger_poses(planner, planner.CreateDefaultContext(), scene, config.plant)
    for body, X_OF in zip(parts.finger_bodies, start):
        parts.plant.SetDefaultFloatingBaseBodyPose(body, X_OF)
    driver = builder.AddNamedSystem("driver", FingertipDriver(parts, config.driver))
    monitor = builder.AddNamedSystem("monitor", ContactMonitor(planned, parts))
    accelerating: LeafSystem = parts.plant
    if not config.plant.time_step:
        accelerating = _object_acceleration(builder, parts)
    _connect(builder, config, planner, driver, monitor, parts.plant, accelerating)
    if config.pushes:
        source = builder.AddNamedSystem("push", PushSource(scene, config.pushes))
        builder.Connect(source.get_output_port(), driver.GetInputPort("push"))
    else:
        builder.ExportInput(driver.GetInputPort("push"), "push")
    builder.ExportInput(monitor.GetInputPort("noise"), "noise")
    if config.disturbance_input:
        builder.ExportInput(planner.GetInputPort("disturbance"), "disturbance")
    _export(builder, planner, driver, monitor, parts)
    if extend is not None:
        extend(builder, parts)
    return builder.Build(), parts


def _connect(
    builder: DiagramBuilder,
    config: StationConfig,
    planner: PlannerBase,
    driver: FingertipDriver,
    monitor: ContactMonitor,
    plant: MultibodyPlant,
    accelerating: LeafSystem,
) -> None:
    planned = ("pose", "twist", "acceleration", "normal", "contact_point")
    if not config.plant.time_step:
        planned += ("normal_rate",)  # type: ignore[assignment]
    wires: list[tuple[LeafSystem, LeafSystem, tuple[str, ...]]] = [
        (planner, driver, planned),
        (plant, driver, ("body_poses", "body_spatial_velocities")),
        (accelerating, driver, ("body_spatial_accelerations",)),
        (plant, monitor, ("contact_results", "body_poses", "body_spatial_velocities")),
    ]
    if config.driver.slip_gain:
        wires.append((monitor, driver, ("sliding",)))
    if config.restarts:
        wires.append((planner, driver, ("restarts",)))
        builder.Connect(monitor.GetOutputPort("state"), planner.GetInputPort("measured_state"))
    for source, target, names in wires:
        for name in names:
            builder.Connect(source.GetOutputPort(name), target.GetInputPort(name))
    applied = plant.get_applied_spatial_force_input_port()
    builder.Connect(driver.GetOutputPort("spatial_forces"), applied)


def _object_acceleration(builder: DiagramBuilder, parts: ScenePlant) -> ObjectAcceleration:
    plant, made = (
        parts.plant,
        builder.AddNamedSystem("object_acceleration", ObjectAcceleration(parts)),
    )
    instance = parts.object_body.model_instance()
    forces = plant.get_generalized_contact_forces_output_port(instance)
    builder.Connect(forces, made.GetInputPort("generalized_contact_forces"))
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), made.GetInputPort(name))
    return made


def _export(
    builder: DiagramBuilder,
    planner: PlannerBase,
    driver: FingertipDriver,
    monitor: ContactMonitor,
    parts: ScenePlant,
) -> None:
    for system in (planner, driver, monitor):
        for i in range(system.num_output_ports()):
            port = system.get_output_port(i)
            taken = system is monitor and planner.HasOutputPort(port.get_name())
            builder.ExportOutput(port, "measured_" * taken + port.get_name())
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
        # steps as short as a discrete plant's make every scheme but Euler's better than contact is
        tolerance=1e-4 if config.plant.time_step else TOLERANCE,
    )


def SetInitialState(station: Diagram, context: Context) -> None:
    """Put the fingers of a station where its planner is, moving as planned.

    What is planned is what the context has for the planner, state and time (by default the start of
    the scene). The object stays as the context has it (by default at the world's origin, at rest),
    but one that turns on the joint of :func:`AddScenePlant` is put where the scene has it at that
    time. Each finger is pressed in as deep as its normal force presses it. Driver and plant forget
    the steps before: as in a new context, the plant's accelerations and contact forces are zero
    until its first step.

    Parameters
    ----------
    station : Diagram
        From :func:`BuildStation`, or of your own with systems "planner", "driver" and "plant".
    context : Context
        The root: the station's own, or that of a Diagram that contains it.

    Raises
    ------
    SceneError
        No station, or no Context.
    """
    if not isinstance(station, Diagram) or not all(
        station.HasSubsystemNamed(name) and isinstance(station.GetSubsystemByName(name), kind)
        for name, kind in STARTED.items()
    ):
        raise SceneError(
            f"station = {station!r}: give what BuildStation made, or a Diagram of your own whose "
            "ContactPlanner, FingertipDriver and MultibodyPlant are named 'planner', 'driver' and "
            "'plant'; of a Diagram that contains it give the station, and the Diagram's context"
        )
    require_config(context, Context, "context")
    planner, driver, plant = map(station.GetSubsystemByName, STARTED)
    now, physics = planner.GetMyContextFromRoot(context), plant.GetMyMutableContextFromRoot(context)
    scene, config, t = driver.scene, driver.plant_config, context.get_time()
    # A velocity of a discrete plant is the one that brought it here: that of half a step ago.
    ago = 0.5 * plant.time_step()
    # A plant of somebody's own may turn its object in another way.
    if config.object == "turning" and scene.turning and plant.HasJointNamed("turning"):
        joint, angle = plant.GetJointByName("turning"), turning_angle(scene.turning)
        joint.set_angle(physics, angle(t))
        joint.set_angular_rate(physics, angle.deriv()(t - ago))
    obj = plant.get_body(BodyIndex(driver.object_index))
    X_WO, V_WO = obj.EvalPoseInWorld(physics), obj.EvalSpatialVelocityInWorld(physics)
    R_WO = X_WO.rotation()
    twist, change = (planner.GetOutputPort(name).Eval(now) for name in ("twist", "acceleration"))
    twists = (twist - ago * change).reshape(-1, 6)
    poses = _finger_poses(planner, now, scene, config)
    for index, X_OF, twist in zip(driver.finger_indices, poses, twists):
        body = plant.get_body(index)
        V_OF_W = SpatialVelocity(twist[:3], twist[3:]).Rotate(R_WO)
        V_WF = V_WO.ComposeWithMovingFrameVelocity(R_WO @ X_OF.translation(), V_OF_W)
        plant.SetFreeBodyPose(physics, body, X_WO @ X_OF)
        plant.SetFreeBodySpatialVelocity(context=physics, body=body, V_JpJc=V_WF)
    if plant.time_step():
        driver.GetMyMutableContextFromRoot(context).get_mutable_discrete_state_vector().SetZero()
    # The sampled outputs of Drake's plant outlive SetDefaultContext.
    new = plant.CreateDefaultContext()
    sampled = physics.get_mutable_state().get_mutable_abstract_state()
    for k in range(sampled.size()):
        sampled.get_mutable_value(k).SetFrom(new.get_abstract_state().get_value(k))


def _finger_poses(
    planner: PlannerBase, context: Context, nominal: Scene, config: PlantConfig
) -> list[RigidTransform]:
    """X_OF as planned, each finger pressed in by the depth on the nominal surfaces."""
    planned, poses = planner.system.scene, planner.GetOutputPort("pose").Eval(context)
    normals = planner.GetOutputPort("normal").Eval(context).reshape(-1, 3)
    left = contact_depth(config) - _depth_between(nominal.object, planned.object)
    sunk = [
        left - _depth_between(a.finger, b.finger)
        for a, b in zip(nominal.contacts, planned.contacts)
    ]
    return [
        RigidTransform(X.rotation(), X.translation() - d * n)
        for X, n, d in zip(poses, normals, sunk)
    ]


@dataclass
class SimulationResult:
    """What :func:`simulate` saw, at every step or about every ms. m times, n contacts; SI units.

    Attributes
    ----------
    scene, config
    t : (m,)
    planned : dict
        state (m, n, 9), slip (m, n, 2), contact_point (m, n, 3), the latter on the object, in O.
    measured : dict
        slip (m, n, 2), normal_force (m, n), tangential_force (m, n, 2), contact_point (m, n, 3),
        state (m, n, 9): those of the step that ended at t.
    object_pose : (m, 4, 4)
        X_WO.
    build_time, wall_time : float
        s, of making the Diagram and of simulating it.
    """

    scene: Scene
    config: StationConfig
    t: Array
    planned: Mapping[str, Array]
    measured: Mapping[str, Array]
    object_pose: Array
    build_time: float
    wall_time: float


def simulate(
    scene: Scene,
    config: StationConfig | None = None,
    duration: float | None = None,
    progress: Callable[[float], None] | None = None,
    recording: str | Path | None = None,
) -> SimulationResult:
    """Build the station of a scene, simulate it, and return what was planned and measured.

    Parameters
    ----------
    scene : Scene
    config : StationConfig, optional
        None: ``StationConfig.from_scene(scene)``.
    duration : float, optional
        s; None: the scene's.
    progress : callable, optional
        Called now and then with the simulated time, s.
    recording : path, optional
        Write a single-file Meshcat recording there.

    Raises
    ------
    SceneError
        A duration shorter than a time step, or not finite; a recording in a folder that does not
        exist; what :func:`BuildStation` raises.
    """
    gc.collect()  # Diagrams are cycles: free those of runs before this one
    config = _checked(scene, config)
    duration = scene.duration if duration is None else duration
    step = config.plant.time_step or CONTINUOUS.max_step_size
    if not finite_number(duration, f"{scene.title}: duration") >= step:
        raise SceneError(
            f"{scene.title}: a simulation of {duration!r} s with a time_step of {step:g} "
            "s: give a finite time of at least one step"
        )
    period = step
    while 2 * period <= min(LOGGED, duration):  # powers of 2, so that logs meet steps to the bit
        period *= 2
    function_or_none(progress, f"{scene.title}: progress", "a function of a time")
    loggers: dict[str, Any] = {}
    film = None
    if recording is not None:
        recording = a_path(recording, f"{scene.title}: recording")
        if not recording.parent.is_dir() or recording.is_dir():
            raise SceneError(
                f"{scene.title}: recording = {str(recording)!r}: no file can be written "
                "there; give a path in a folder that exists, such as 'film.html'"
            )
        from .recording import Recording

        film = Recording()

    def extend(builder: DiagramBuilder, parts: ScenePlant) -> None:
        systems = {s.get_name(): s for s in builder.GetMutableSystems()}
        for system, names in (("planner", PLANNED), ("monitor", MEASURED)):
            for name in names:
                port = systems[system].GetOutputPort(name)
                loggers[f"{system}.{name}"] = LogVectorOutput(port, builder, period)
        instance = parts.object_body.model_instance()
        port = parts.plant.get_state_output_port(instance)
        loggers["object"] = LogVectorOutput(port, builder, period)
        if film is not None:
            film.Add(builder, parts)

    begun = time.perf_counter()
    station, parts = _build(scene, config, extend)
    simulator = Simulator(station)
    ApplySimulatorConfig(INTEGRATION if config.plant.time_step else CONTINUOUS, simulator)
    context = simulator.get_mutable_context()
    SetInitialState(station, context)
    if progress is not None:
        simulator.set_monitor(lambda root: progress(root.get_time()) or EventStatus.DidNothing())
    simulator.Initialize()
    built = time.perf_counter()
    simulator.AdvanceTo(duration)
    finished = time.perf_counter()
    if film is not None and recording is not None:
        film.Save(recording)

    logs = {name: sink.FindLog(context) for name, sink in loggers.items()}
    t = logs["object"].sample_times()

    def rows(system: str, names: tuple[str, ...]) -> dict[str, Array]:
        n = len(scene.contacts)
        return {name: logs[f"{system}.{name}"].data().T.reshape(len(t), n, -1) for name in names}

    planned, measured = rows("planner", PLANNED), rows("monitor", MEASURED)
    planned["contact_point"] = planned["contact_point"][:, :, 3:]
    measured["normal_force"] = measured["normal_force"][:, :, 0]
    poses = _object_poses(parts, logs["object"].data().T)
    return SimulationResult(
        scene, config, t, planned, measured, poses, built - begun, finished - built
    )


def _object_poses(parts: ScenePlant, states: Array) -> Array:
    """X_WO of states of the object's model instance, be it free, turning or welded: (m, 4, 4)."""
    plant, body = parts.plant, parts.object_body
    context, poses = plant.CreateDefaultContext(), np.empty((len(states), 4, 4))
    for k, state in enumerate(states):
        plant.SetPositionsAndVelocities(context, body.model_instance(), state)
        poses[k] = body.EvalPoseInWorld(context).GetAsMatrix4()
    return poses
