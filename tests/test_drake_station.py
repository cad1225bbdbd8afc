"""Stations: fingers driven as planned in contact physics, slip feedback, start, configuration."""

import dataclasses
import gc
import math
import subprocess
import sys
import weakref

import numpy as np
import pytest

pytest.importorskip("pydrake")

from pydrake.common import RandomDistribution
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.geometry import HalfSpace
from pydrake.geometry import Sphere as SphereShape
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import PrismaticJoint, RpyFloatingJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, MatrixGain, RandomSource
from scipy.spatial.transform import Rotation

import contact_system as cs
from drake_plant import (
    AddScenePlant,
    BuildStation,
    ContactMonitor,
    ContactPlanner,
    FingertipDriver,
    Push,
    Recording,
    ScenePlant,
    SetInitialState,
    StationConfig,
    contact_table,
    outcome,
    push_table,
    rolling_scene,
    simulate,
)


def config(scene, **changes):
    return StationConfig.from_scene(scene, **{"contact_model": "point", **changes})


def disturbed_early(start, stop, duration):
    """D1 with its disturbance soon after the start."""
    scene = cs.load_scene("D1")
    windows = [dataclasses.replace(d, start=start, stop=stop) for d in scene.disturbances]
    return dataclasses.replace(scene, disturbances=windows, duration=duration)


def lengths(result, name):
    return np.linalg.norm(result.measured[name], axis=-1)


def test_fingers_in_hydroelastic_contact_press_with_one_newton_and_roll():
    scene = cs.load_scene("D1")
    patches = simulate(scene, config(scene, contact_model="hydroelastic"), duration=0.35)
    rolling = patches.t > 0.1
    force = patches.measured["normal_force"][rolling]
    slip, friction = (lengths(patches, name)[rolling] for name in ("slip", "tangential_force"))
    assert abs(force.mean(axis=0) - 1).max() < 0.01
    assert force.std(axis=0).max() < 0.05
    assert (slip.mean(axis=0) / scene.profile(patches.t)[rolling].mean()).max() < 1e-3
    assert friction.mean() < 0.1


def test_rolling_radii_are_smaller_by_half_the_depth_or_by_all_of_it_for_compliant_fingers():
    scene = cs.load_scene("D1")
    planned = rolling_scene(scene, StationConfig(contact_model="point", stiffness=1e4))
    assert planned.object.radius == pytest.approx(0.1 - 0.5e-4, abs=1e-12)
    assert planned.contacts[0].finger.radius == pytest.approx(0.04 - 0.5e-4, abs=1e-12)
    soft = rolling_scene(scene, StationConfig(contact_model="hydroelastic", stiffness=1e4))
    assert soft.object == scene.object
    assert soft.contacts[0].finger.radius == pytest.approx(0.04 - 2e-4, abs=1e-12)
    assert soft.contacts[0].object_at == scene.contacts[0].object_at


TURN = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3
AXES = np.array([0.05, 0.04, 0.03])


@pytest.mark.parametrize(
    "finger",
    [
        cs.Quadric(np.diag(AXES**-2)),
        cs.Quadric(TURN @ np.diag(AXES**-2) @ TURN.T),
        cs.ImplicitSurface(
            "(x/a)**2 + (y/b)**2 + (z/depth)**2 - 1",
            size=0.04,
            parameters={"a": 0.05, "b": 0.04, "depth": 0.03},
        ),
        cs.ImplicitSurface(
            "(x**2 + y**2 + z**2)/2/r**2 + (x**4 + y**4 + z**4)/r**4 - 1",
            size=0.03,
            parameters={"r": 0.04},
        ),
    ],
    ids=["quadric", "turned", "implicit ellipsoid", "rounded cube"],
)
def test_a_fingertip_of_any_kind_rolls_on_the_surface_at_its_depth(finger):
    contact, profile = cs.Contact(finger, (1.6, 0.3), (1.1, 0.8)), cs.Profile([0.15])
    scene = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], duration=0.3, profile=profile)
    inner = rolling_scene(scene, StationConfig(stiffness=1e4)).contacts[0].finger
    u, v = (grid.ravel() for grid in np.meshgrid([0.4, 1.1, 2.2], [-2.0, -0.3, 0.8]))
    outside = inner.point(u, v) + 2e-4 * inner.frame(u, v)[..., 2]  # the depth at 1 N
    on_finger = finger.point(*finger.coordinates(outside))
    assert np.abs(on_finger - outside).max() < 1e-5


@pytest.mark.parametrize(
    ("finger", "at"),
    [(cs.Torus(0.05, 0.02), (1.0, 0.3)), (cs.Ellipsoid(0.05, 0.04, 0.03), (1.0, 0.5))],
)
def test_fingertips_that_are_no_spheres_press_with_one_newton_and_roll(finger, at):
    """The normal force does not pass through their mass centres."""
    contact, profile = cs.Contact(finger, (1.0, 0.2), at), cs.Profile([0.15])
    scene = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], profile=profile, duration=0.6)
    result = simulate(scene, StationConfig.from_scene(scene, coordinates="frame"))
    late = result.t > 0.05
    force = result.measured["normal_force"][late]
    assert force.mean() == pytest.approx(1, abs=0.015) and force.std() < 0.025
    assert lengths(result, "slip")[late].mean() < 1e-3 * 0.15
    assert lengths(result, "tangential_force")[late].mean() < 0.03


def test_a_finger_that_legs_steer_arrives_in_contact_physics():
    r1 = cs.load_scene("R1")
    start = dataclasses.replace(r1.contacts[0], legs=())
    scene = r1.replace(contacts=[start], profile=cs.Profile([0.1]), duration=1.6)
    goal = cs.Goal(object_at=(2.0, 1.0), finger_at=(1.0, 0.5), angle=1.0)
    made = config(scene, contact_model="hydroelastic")
    route = cs.reach(rolling_scene(scene, made), goal, legs=4)
    steered = dataclasses.replace(start, legs=route.legs[0])
    result = simulate(scene.replace(contacts=[steered]), made)
    u1, v1, _, _, u2, v2, _, _, angle = result.measured["state"][-1, 0]
    off = start.finger.point(u1, v1) - start.finger.point(*goal.finger_at)
    assert np.linalg.norm(off) < 1e-3
    assert np.linalg.norm(scene.object.point(u2, v2) - scene.object.point(*goal.object_at)) < 1e-3
    assert abs(math.remainder(angle - goal.angle, 2 * math.pi)) < math.radians(1)


def pushed(push=None, model="point", **changes):
    """D4, simulated under one push: by default 4 N on finger 1 for 0.05 s."""
    scene = cs.load_scene("D4")
    pushes = [push or Push("finger 1", 0.1, 0.15, [-3.64, -1.28, -1.07])]  # along the object
    given = {"contact_model": model, "pushes": pushes, **changes}
    # the end lies within a step
    return simulate(scene, StationConfig.from_scene(scene, **given), duration=0.4003)


def slipped(result):
    """Slip of finger 1 summed while it touches, m."""
    touches = result.measured["normal_force"][:, 0] > 0
    return np.diff(result.t, prepend=0.0)[touches] @ lengths(result, "slip")[touches, 0]


@pytest.mark.parametrize("model", ["point", "hydroelastic"])
def test_with_slip_feedback_a_pushed_finger_slips_less_than_half_and_comes_back(model):
    # of so great a gain the driver uses what is stable at this step
    closed, opened = pushed(model=model, slip_gain=1e6), pushed(model=model, slip_gain=0.0)
    assert 5e-4 < slipped(opened) > 2.5 * slipped(closed)
    for result in (closed, opened):
        miss = result.measured["contact_point"][-1] - result.planned["contact_point"][-1]
        assert np.linalg.norm(miss, axis=1).max() < 1e-4


def test_restarts_of_the_plan_while_a_finger_is_pushed_do_not_jerk_it():
    """The plan jumps to where the finger is: 0.1 m/s and more, were that taken for a velocity."""
    damped = 4.0 / StationConfig().velocity_gain  # m/s, to which 4 N accelerate against the damping
    often = pushed(slip_gain=0.0, restart_period=0.01)
    assert lengths(often, "slip")[often.t >= 0.05].max() < damped
    assert lengths(often, "slip")[often.t >= 0.25].max() < 1e-4
    far, opened = pushed(restart_distance=5e-4), pushed(slip_gain=0.0)
    assert slipped(far) < 0.7 * slipped(opened)
    assert np.diff(often.t).min() > 9e-4  # no row just before a restart
    often_off, off = (
        said.measured["contact_point"] - said.planned["contact_point"] for said in (often, opened)
    )
    assert np.abs(often_off).max() < np.abs(off).max()
    table, opened_path = push_table(opened)[0], contact_table(opened)[0].path
    # `farthest` and `path` are those of the first plan, to which no restart leads back
    assert contact_table(often)[0].path == pytest.approx(opened_path, rel=1e-6)
    assert push_table(often)[0].farthest > table.farthest
    assert table.left == pytest.approx(np.linalg.norm(off[-1, 0]), rel=1e-6)


def test_the_outcome_of_a_simulation_is_a_row_of_a_sweep():
    scene = disturbed_early(0.12, 0.22, 0.3)
    scene = scene.replace(drake=scene.drake | {"contact_model": "point"})
    found = cs.sweep([scene], outcome, each=True)
    assert found.table["verdict"].tolist() == ["as reported", "undisturbed", "undisturbed"]


def test_a_push_on_the_object_moves_it_by_its_mass():
    # the push begins and ends within a step, in which the mean of its force acts
    runs = [pushed(Push("object", 0.1002, 0.1008, [0, 0, force])) for force in (800.0, 0.0)]
    speed = 800.0 * 0.0006 / (4.18 + 3 * 0.261)  # the fingers go with it
    pushed_so, still = (r.object_pose[[np.searchsorted(r.t, 0.15), -1], :3, 3] for r in runs)
    moved = np.diff(pushed_so - still, axis=0)[0]
    assert moved == pytest.approx([0.0, 0.0, speed * 0.25], abs=0.2 * speed * 0.25)


def test_noise_on_measured_states_makes_no_rolling_finger_slip():
    scene, builder = cs.load_scene("D4"), DiagramBuilder()
    station = builder.AddSystem(BuildStation(scene, config(scene, pushes=[], restart_period=0.01)))
    noise = builder.AddSystem(RandomSource(RandomDistribution.kGaussian, 27, 1e-3))
    sizes = np.tile([1e-3, 1e-3, 0.1, 0.1, 1e-3, 1e-3, 0.1, 0.1, 1e-3], 3)
    scaled = builder.AddSystem(MatrixGain(np.diag(sizes)))
    builder.Connect(noise.get_output_port(), scaled.get_input_port())
    builder.Connect(scaled.get_output_port(), station.GetInputPort("noise"))
    log = LogVectorOutput(station.GetOutputPort("measured_slip"), builder, 1e-3)
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    SetInitialState(station, context)
    simulator.AdvanceTo(0.305)
    slip = np.linalg.norm(log.FindLog(context).data().T.reshape(-1, 3, 2), axis=2)
    assert slip[10:].max() < 1e-4
    own = station.GetMyContextFromRoot(context)
    measured, planned = (station.GetOutputPort(x).Eval(own) for x in ("measured_state", "state"))
    assert 0.01 < np.abs(measured - planned).reshape(3, 9)[:, [2, 3, 6, 7]].max() < 2.0


@pytest.mark.parametrize(("name", "period"), [("D1", 0.1), ("D3", 0.01)])
def test_restarts_of_fingers_that_roll_neither_make_slip_nor_leave_the_first_plan(name, period):
    """A step late (3 * 0.1 > 300 * 0.001 in doubles) makes slip; by old rates D3 lags 0.4 mm."""
    scene = cs.load_scene(name).replace(disturbances=[])
    result = simulate(scene, config(scene, restart_period=period, time_step=1e-3), duration=0.35)
    slip = lengths(result, "slip")[result.t > 0.05]
    off = result.measured["contact_point"] - result.planned["first_contact_point"]
    assert slip.max() < 1e-4 and np.abs(off).max() < 2e-5


def test_a_disturbance_at_the_input_port_moves_the_contact_like_one_of_the_scene():
    scheduled = disturbed_early(0.0, 0.06, 0.06)
    free = dataclasses.replace(scheduled, disturbances=[])
    planned = simulate(scheduled, config(scheduled), 0.05).planned["slip"][-1, 0]
    station = BuildStation(free, config(free, disturbance_input=True))
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    offset = np.zeros(18)
    offset[4:6] = scheduled.disturbances[0].value
    station.GetInputPort("disturbance").FixValue(context, offset)
    SetInitialState(station, context)
    simulator.AdvanceTo(0.05)
    assert station.GetOutputPort("slip").Eval(context)[:2] == pytest.approx(planned, abs=1e-6)


@pytest.mark.parametrize("missing", ["pydrake", "scipy"])
def test_without_drake_or_scipy_the_import_says_what_to_install(missing):
    code = f"import sys; sys.modules[{missing!r}] = None; import drake_plant"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "ImportError: drake_plant needs Drake and scipy: pip install" in told.stderr


def test_importing_drake_plant_loads_fmpy_only_for_fmu_systems():
    code = "import drake_plant as d, sys; assert 'fmpy' not in sys.modules; d.FmuSystem"
    code += "; assert {*d.__all__, 'FmuSystem'} <= {*dir(d)}"
    subprocess.run([sys.executable, "-c", code], check=True)


# --- gains and the step --------------------------------------------------------------------------


def two_spheres():
    """Spheres of 0.04 and 0.01 m that roll on one of 0.1 m."""
    at = ((0.04, (1.0, 0.2)), (0.01, (2.0, 2.0)))
    contacts = [cs.Contact(cs.Sphere(radius), place) for radius, place in at]
    ball, profile = cs.Sphere(0.1), cs.Profile([0.2])
    return cs.Scene(object=ball, contacts=contacts, profile=profile, duration=1.0, name="two")


@pytest.mark.parametrize(
    "changes",
    [
        {"object": "welded"},
        {"finger_mass": 1e-3, "object_mass": 2e-4, "normal_force": 0.01},
        {"time_step": 5e-3, "normal_force": 5.0},
        {"position_gain": 1e6, "velocity_gain": 1e5, "normal_damping": 1e5, "spin_gain": 1e3},
    ],
)
def test_light_fingers_long_steps_and_great_gains_still_hold_the_force_and_roll(changes):
    scene, wanted = two_spheres(), changes.get("normal_force", 1.0)
    result = simulate(scene, config(scene, **changes), duration=0.2)
    late = result.t > 0.1
    assert np.abs(result.measured["normal_force"][late] / wanted - 1).max() < 0.01
    assert np.abs(result.measured["slip"][late]).max() < 1e-5
    if "object" in changes:
        assert np.abs(result.object_pose - np.eye(4)).max() < 1e-15


# --- continuous plants ---------------------------------------------------------------------------


@pytest.mark.parametrize("model", ("point", "hydroelastic"))
def test_fingers_move_alike_in_a_continuous_and_a_discrete_plant(model):
    scene, points = cs.load_scene("D1"), []
    for step in (0.0, 1e-3):
        found = simulate(scene, config(scene, time_step=step, contact_model=model), duration=0.02)
        assert np.abs(found.measured["normal_force"][-1] - 1).max() < 0.1
        assert model != "point" or step or lengths(found, "tangential_force").max() < 1e-5
        points.append(found.measured["contact_point"][-1])
    assert np.abs(points[0] - points[1]).max() < 2e-5


@pytest.mark.parametrize("scheme", ("cenic", "radau3", "runge_kutta2"))
def test_every_integrator_runs_a_continuous_station_whose_planner_has_no_states(scheme):
    scene = cs.load_scene("D1")
    station = BuildStation(
        scene, config(scene, time_step=0.0, contact_model="point", coordinates="plan")
    )
    simulator = Simulator(station)
    step = 1e-4 if scheme == "runge_kutta2" else 1e-3
    setting = SimulatorConfig(
        integration_scheme=scheme, max_step_size=step, use_error_control=scheme == "cenic"
    )
    ApplySimulatorConfig(setting, simulator)
    context = simulator.get_mutable_context()
    SetInitialState(station, context)
    simulator.AdvanceTo(0.01)
    planned, measured = (
        station.GetOutputPort(name).Eval(context).reshape(3, -1)[:, -3:]
        for name in ("contact_point", "measured_contact_point")
    )
    assert np.abs(planned - measured).max() < 1e-4


# --- objects that are not free -------------------------------------------------------------------


def test_a_finger_rolls_on_a_turning_object_and_does_not_turn_itself():
    """The object turns as C1 says, and the contact point follows the corollary's great circle."""
    scene = cs.load_scene("C1")
    turned = simulate(scene, config(scene, coordinates="frame"))
    found = Rotation.from_matrix(turned.object_pose[:, :3, :3])
    wanted = Rotation.from_rotvec(scene.turning.rotation_vector(turned.t))
    assert (found * wanted.inv()).magnitude().max() < 1e-7
    assert not turned.object_pose[:, :3, 3].any()
    force = turned.measured["normal_force"][turned.t > 0.05]
    assert np.abs(force - 1).max() < 0.01
    assert np.linalg.norm(turned.measured["slip"], axis=-1).max() < 1e-3
    points = turned.measured["contact_point"][:, 0]
    assert np.abs(points @ np.ones(3)).max() < 1e-5  # the plane of the great circle


# --- starting anywhere ---------------------------------------------------------------------------


def context_at(station, t):
    """A station's Context at time t, with its planner where the plan is then."""
    planner = station.GetSubsystemByName("planner")
    context = station.CreateDefaultContext()
    context.SetTime(t)
    state = cs.plan(planner.system.scene).states([t]).reshape(1, -1, 9)[0]
    x = planner.system.from_states(t, state, np.zeros(planner.system.n_w))[0]
    planner.GetMyMutableContextFromRoot(context).SetContinuousState(x)
    return context


def test_a_station_starts_where_its_planner_is():
    scene, t = cs.load_scene("D1"), 1.2
    station = BuildStation(scene, config(scene))
    planner, plant = (station.GetSubsystemByName(name) for name in ("planner", "plant"))
    context = context_at(station, t)
    SetInitialState(station, context)
    physics, planned = plant.GetMyContextFromRoot(context), cs.plan(planner.system.scene)
    # the velocity of a discrete plant is the mean over its last step
    half_a_step_ago = planned.twist([t - 5e-4])[0]
    for i, X_OF in enumerate(planned.pose([t])[0]):
        body = plant.GetBodyByName(f"finger {i + 1}")
        assert body.EvalPoseInWorld(physics).GetAsMatrix4() == pytest.approx(X_OF, abs=2e-5)
        moving = body.EvalSpatialVelocityInWorld(physics).get_coeffs()
        assert moving == pytest.approx(half_a_step_ago[i], abs=5e-3)
    simulator = Simulator(station, context)
    for late in (0.001, 0.01, 0.05, 0.1):
        simulator.AdvanceTo(t + late)
        force = station.GetOutputPort("normal_force").Eval(context)
        assert force == pytest.approx([1.0, 1.0, 1.0], abs=0.01)


def test_two_stations_in_one_diagram_are_each_started_by_themselves():
    scene, builder = cs.load_scene("D1"), DiagramBuilder()
    stations = [builder.AddSystem(BuildStation(scene, config(scene))) for _ in range(2)]
    diagram = builder.Build()
    simulator = Simulator(diagram)
    root = simulator.get_mutable_context()
    for wrong in (diagram, root, stations[0].GetSubsystemByName("planner")):
        with pytest.raises(cs.SceneError, match="station = .*: give what BuildStation made, or"):
            SetInitialState(wrong, root)
    with pytest.raises(cs.SceneError, match="context: give the root's"):
        SetInitialState(stations[0], stations[0].GetMyContextFromRoot(root))
    for station in stations:
        SetInitialState(station, root)
    simulator.AdvanceTo(0.02)
    for station in stations:
        own = station.GetMyContextFromRoot(root)
        force = station.GetOutputPort("normal_force").Eval(own)
        assert force == pytest.approx([1.0, 1.0, 1.0], abs=0.02)


@pytest.mark.parametrize("step", [0.0, 1e-3])
def test_a_station_that_is_no_longer_referenced_is_freed(step):
    station = BuildStation(scene := cs.load_scene("D1"), config(scene, time_step=step))
    SetInitialState(station, station.CreateDefaultContext())
    systems = [weakref.ref(system) for system in station.GetSystems()]
    del station
    gc.collect()
    assert not any(system() for system in systems)


def test_a_users_diagram_with_the_stations_system_names_can_be_started():
    scene, builder = cs.load_scene("D1"), DiagramBuilder()
    parts = AddScenePlant(builder, scene, config(scene))
    planner = builder.AddNamedSystem("planner", ContactPlanner(scene))
    driver = builder.AddNamedSystem("driver", FingertipDriver(parts))
    diagram = builder.Build()
    SetInitialState(diagram, root := diagram.CreateDefaultContext())
    X_WF = parts.finger_bodies[0].EvalPoseInWorld(parts.plant.GetMyContextFromRoot(root))
    assert np.linalg.norm(X_WF.translation()) == pytest.approx(0.14, abs=1e-3)
    for system, name in ((planner, "planner"), (driver, "driver"), (parts.plant, "plant")):
        system.set_name("mine")
        with pytest.raises(cs.SceneError, match="FingertipDriver and .* are named 'planner', 'dr"):
            SetInitialState(diagram, root)
        system.set_name(name)


def test_a_turning_object_starts_at_the_orientation_and_rate_of_that_time():
    scene = cs.load_scene("C1")
    station = BuildStation(scene, config(scene, coordinates="frame"))
    context = context_at(station, 0.5)
    SetInitialState(station, context)
    plant = station.GetSubsystemByName("plant")
    body, physics = plant.GetBodyByName("object"), plant.GetMyContextFromRoot(context)
    turn = Rotation.from_rotvec(scene.turning.rotation_vector(0.5)).as_matrix()
    assert body.EvalPoseInWorld(physics).rotation().matrix() == pytest.approx(turn, abs=1e-12)
    rate = body.EvalSpatialVelocityInWorld(physics).rotational()
    assert rate == pytest.approx(scene.turning.angular_velocity(0.5 - 5e-4), abs=1e-12)
    simulator = Simulator(station, context)
    simulator.AdvanceTo(0.55)
    assert station.GetOutputPort("normal_force").Eval(context) == pytest.approx([1.0], rel=0.02)
    assert np.linalg.norm(station.GetOutputPort("measured_slip").Eval(context)) < 1e-3


def test_a_finger_on_something_else_does_not_touch_the_object():
    """In a user's plant, where the fingertip lies on a table."""

    def table(plant, finger):
        friction, nowhere = CoulombFriction(0.5, 0.5), RigidTransform()
        for body, shape in ((plant.world_body(), HalfSpace()), (finger, SphereShape(0.04))):
            plant.RegisterCollisionGeometry(body, nowhere, shape, body.name(), friction)

    builder = DiagramBuilder()
    parts = own_parts(more=table, builder=builder)
    plant, monitor = parts.plant, builder.AddSystem(ContactMonitor(parts.scene, parts))
    for name in ("contact_results", "body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), monitor.GetInputPort(name))
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    for body, place in ((parts.object_body, [0, 0, 5.0]), (*parts.finger_bodies, [0.5, 0, 0.039])):
        plant.SetFreeBodyPose(context, body, RigidTransform(np.array(place)))
    simulator.AdvanceTo(1e-3)
    assert plant.get_contact_results_output_port().Eval(context).num_point_pair_contacts() == 1
    own = monitor.GetMyContextFromRoot(root)
    for name in ("normal_force", "tangential_force"):
        assert not monitor.GetOutputPort(name).Eval(own).any()


def own_parts(step=1e-3, off=0.0, finalized=True, more=None, sampled=True, builder=None, **changes):
    """The ScenePlant of a user's plant: an object, a finger, and what ``more`` adds to it."""
    scene, builder = cs.load_scene("C2"), builder or DiagramBuilder()
    wanted = MultibodyPlantConfig(time_step=step, use_sampled_output_ports=sampled)
    plant, scene_graph = AddMultibodyPlant(wanted, builder)
    inertia = SpatialInertia(0.01, np.array([off, 0.0, 0.0]), UnitInertia.SolidSphere(0.04))
    object_body, *fingers = [plant.AddRigidBody(name, inertia) for name in ("object", "finger")]
    if more:
        more(plant, fingers[0])
    if finalized:
        plant.Finalize()
    given = {"scene": scene, "config": StationConfig(), "plant": plant, "scene_graph": scene_graph}
    given |= {"object_body": object_body, "finger_bodies": fingers}
    return ScenePlant(**given | changes)


@pytest.mark.parametrize("heavy", (True, False))
def test_fingers_move_as_planned_whether_gravity_pulls_them_or_not(heavy):
    """Drake can switch gravity off for a model; there are next to no other forces here."""
    builder = DiagramBuilder()

    def pulled(plant, finger):
        plant.set_gravity_enabled(finger.model_instance(), heavy)

    parts = own_parts(builder=builder, more=pulled, config=StationConfig(normal_force=1e-9))
    planner = builder.AddNamedSystem("planner", ContactPlanner(parts.scene))
    driver = builder.AddNamedSystem("driver", FingertipDriver(parts))
    for port in map(driver.get_input_port, range(4)):
        source = planner if planner.HasOutputPort(port.get_name()) else parts.plant
        builder.Connect(source.GetOutputPort(port.get_name()), port)
    applied = parts.plant.get_applied_spatial_force_input_port()
    builder.Connect(driver.get_output_port(), applied)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    root = simulator.get_mutable_context()
    SetInitialState(diagram, root)
    simulator.AdvanceTo(0.05)
    physics = parts.plant.GetMyContextFromRoot(root)
    X_WO, X_WF = (b.EvalPoseInWorld(physics) for b in (parts.object_body, *parts.finger_bodies))
    (X_OF,) = planner.GetOutputPort("pose").Eval(planner.GetMyContextFromRoot(root))
    assert X_WO.translation()[2] == pytest.approx(-0.5 * 9.81 * 0.05**2 * heavy, rel=0.05)
    assert (X_WO.inverse() @ X_WF).IsNearlyEqualTo(X_OF, 1e-5)


def test_a_simulation_needs_held_objects_and_meshes_only_for_its_own_time():
    scene = cs.load_scene("D1")
    heavy = config(scene, gravity=9.81)
    simulate(scene, heavy, duration=0.01)
    with pytest.raises(cs.SceneError, match="'D1': t = 0.48 s: no contact forces within 80%"):
        simulate(scene, heavy)
    scene = cs.load_scene("C2").replace(duration=0.01)
    station = BuildStation(scene, StationConfig(object="welded"))
    simulator = Simulator(station)
    SetInitialState(station, simulator.get_mutable_context())
    simulator.AdvanceTo(0.01)
    with pytest.raises(cs.SceneError, match=r"'C2': .* end at 0.01 s; .* scene.replace\(duration="):
        simulator.AdvanceTo(0.02)


# --- configuration, and what is refused


def test_a_configuration_read_from_yaml_is_that_of_the_same_drake_table():
    scene = cs.load_scene("D4")
    given = StationConfig.from_scene(scene)
    assert (given.slip_gain, given.object_mass, given.spin_gain) == (800.0, 4.18, 0.04)
    text = "{time_step: 2e-3, finger_edge: 0.001, spin_gain: 0.1, coordinates: frame}"
    read = yaml_load_typed(schema=StationConfig, data=text, defaults=given)
    changes = {"time_step": 2e-3, "finger_edge": 1e-3, "spin_gain": 0.1, "coordinates": "frame"}
    assert read == StationConfig.from_scene(scene, **changes)
    for one in (read, StationConfig.from_scene(cs.load_scene("H2"))):
        assert yaml_load_typed(schema=StationConfig, data=yaml_dump_typed(one)) == one


def one_push(**changes):
    """A change of the [drake] table: one push."""
    push = {"on": "object", "start": 0.1, "stop": 0.2, "force": [0.0, 0.0, 1.0]}
    return {"pushes": [push | changes]}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (one_push(on="finger 9"), "pushes.0.: on = 'finger 9' .*; use one of finger 1, .*, object"),
        (one_push(start=-1.0), "pushes.0.: start = -1.0: give a finite number not below 0"),
        (one_push(stop=0.1), "pushes.0.: stop = 0.1: give a time after start = 0.1"),
        (one_push(force=[1.0, 2.0]), r"pushes.0.: force = \[1.0, 2.0\]: give three numbers"),
        (one_push(force=[1.0, 2.0, "3"]), "pushes.0.: force = .*: give a list of numbers"),
        (one_push(stopp=0.1), "pushes.0.: key = 'stopp' is unknown.*'stop'"),
        ({"pushes": "often"}, "pushes = .*: give a list"),
        ({"pushes": [1.0]}, "pushes.0. = .*: give a table"),
        ({"pushes": {"on": "object"}}, "pushes = .*: give a list"),  # [drake.pushes] for [[ ]]
        ({"frction": 0.3}, "key = 'frction'.*'friction'"),
        ({"time_step": "1e-3"}, "time_step = '1e-3': give a finite number"),
        ({"restart_period": 0.0015}, "restart_period = 0.0015: .* give restart_period = 0.002"),
        ({"restart_distance": 0.1, "time_step": 1 / 480}, ".*None: 0.01 s.* 0.0104166666667,"),
    ],
)
def test_a_wrong_value_of_the_drake_table_is_named(changes, words):
    with pytest.raises(cs.SceneError, match=r"^scene 'D1', \[drake\]: " + words):
        StationConfig.from_scene(cs.load_scene("D1"), **changes)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (StationConfig(coordinates="plan", restart_distance=0.1), "coordinates = .plan.: a plan"),
        (StationConfig(position_gain=None), "position_gain = None"),
        ({"friction": 0.5}, "config = {'friction': 0.5}: give a StationConfig"),
    ],
)
def test_a_wrong_configuration_is_refused_before_anything_is_built(wrong, words):
    for start in (BuildStation, simulate):
        with pytest.raises(cs.SceneError, match="^scene 'D1', station: " + words):
            start(cs.load_scene("D1"), wrong)


def with_a_camera(plant, finger):
    camera = plant.AddRigidBody("camera", SpatialInertia.SolidSphereWithMass(0.1, 0.01))
    plant.WeldFrames(finger.body_frame(), camera.body_frame())


def on_a_joint(kind, parent, *axis):
    return lambda plant, finger: plant.AddJoint(
        kind("joint", plant.GetFrameByName(parent), finger.body_frame(), *axis)
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step": 0.1}, "'C2', contact 0 .finger.: time_step = 0.1: a finger of 0.01 kg can be"),
        ({"off": 1e-3}, "'C2', contact 0 .finger.: the mass centre of body 'finger' is at .0.001"),
        ({"more": with_a_camera}, "0 .finger.: body 'finger' is not free, but has the joint '"),
        ({"more": on_a_joint(PrismaticJoint, "world", [0.0, 0.0, 1.0])}, "has the joint 'joint'"),
        # its positions would be relative to the object
        ({"more": on_a_joint(RpyFloatingJoint, "object")}, "has the joint 'joint'; forces"),
        # forces would depend on the accelerations that they cause
        ({"sampled": False}, "the plant has no sampled output ports, .* give Multi"),
    ],
)
def test_fingers_that_cannot_be_driven_alone_are_refused(changes, message):
    """A floating joint to the world, which the user has added, is fine."""
    with pytest.raises(cs.SceneError, match=message):
        FingertipDriver(own_parts(**changes))
    FingertipDriver(own_parts(more=on_a_joint(RpyFloatingJoint, "world")))


def test_a_users_plant_that_is_not_finalized_or_lacks_fingers_is_refused():
    with pytest.raises(cs.SceneError, match=r"the plant is not finalized: call plant.Finalize.."):
        own_parts(finalized=False)
    with pytest.raises(cs.SceneError, match="0 finger_bodies: give 1, one for each contact"):
        own_parts(finger_bodies=[])


def test_arguments_of_another_kind_are_refused_by_name(tmp_path):
    scene, builder = cs.load_scene("D1"), DiagramBuilder()
    given, k4, larger = config(scene), cs.load_scene("K4"), scene.replace(object=cs.Sphere(0.12))
    parts = AddScenePlant(builder, scene, given)
    builder.AddNamedSystem("planner", ContactPlanner(k4))
    builder.AddNamedSystem("driver", FingertipDriver(parts))
    refused = [
        (lambda: AddScenePlant(builder, scene, {}), "'D1', plant: config = {}: give a Station"),
        (lambda: AddScenePlant(3, scene), "builder = 3: give a DiagramBuilder"),
        (lambda: ContactMonitor(k4, parts), "'K4', has other .* 'D1': give"),
        (lambda: ContactMonitor(larger, parts), "'D1', has other .* 'D1': give"),
    ]
    for path in (tmp_path / "none" / "film.html", tmp_path):
        refused += [(lambda path=path: simulate(scene, given, recording=path), "in a folder that")]
    for time in (-1.0, math.nan, 1e-4):
        refused += [(lambda time=time: simulate(scene, given, duration=time), f"D1': .* {time!r}")]
    for call, words in refused:
        with pytest.raises(cs.SceneError, match=words):
            call()
    light = config(two_spheres(), finger_mass=1e-4, time_step=5e-3)
    with pytest.raises(cs.SceneError, match="'two', contact 0: time_step = 0.005.*0.0001 kg.*give"):
        BuildStation(two_spheres(), light)
    film = Recording(builder, parts)
    diagram = builder.Build()
    with pytest.raises(cs.SceneError, match="planner, of scene 'K4', has other .* 'D1': give it"):
        SetInitialState(diagram, diagram.CreateDefaultContext())
    with pytest.raises(cs.SceneError, match="'.*film.html' cannot be written: .*give a path in a"):
        film.Save(tmp_path / "none" / "film.html")
