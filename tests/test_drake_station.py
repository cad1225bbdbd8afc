"""The station: fingers driven as planned, contact physics, closed loop, configuration."""

import dataclasses
import inspect
import math
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

pytest.importorskip("pydrake")

from pydrake.common import Parallelism
from pydrake.common.yaml import yaml_dump_typed, yaml_load_typed
from pydrake.geometry import HalfSpace
from pydrake.geometry import Sphere as SphereShape
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import (
    PrismaticJoint,
    RpyFloatingJoint,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import BatchEvalTimeDerivatives, Simulator
from pydrake.systems.framework import DiagramBuilder, InputPortSelection
from scipy.spatial.transform import Rotation

import contact_system as cs
from drake_plant import (
    AddScenePlant,
    BuildStation,
    ContactMonitor,
    ContactPlanner,
    DriverConfig,
    FingertipDriver,
    PlantConfig,
    ScenePlant,
    SetInitialState,
    StationConfig,
    rolling_scene,
    simulate,
)
from drake_plant.fingertip_driver import CONSTANT, POINT, driving_law
from drake_plant.recording import Recording


def config(scene, **changes):
    return StationConfig.from_scene(scene, **{"contact_model": "point", **changes})


def early(name, start=0.2, stop=0.4, duration=0.6):
    """A bundled scene with its disturbance soon after the start."""
    scene = cs.load_scene(name)
    windows = [dataclasses.replace(d, start=start, stop=stop) for d in scene.disturbances]
    return dataclasses.replace(scene, disturbances=windows, duration=duration)


@pytest.fixture(scope="module")
def disturbed():
    scene = early("D1")
    return simulate(scene, config(scene))


@pytest.fixture(scope="module")
def patches():
    scene = cs.load_scene("D1")
    return simulate(scene, config(scene, contact_model="hydroelastic"), duration=0.35)


def speed(result):
    """sigma: what the contact point travels on the object."""
    return result.scene.profile(result.t)


def between(result, start, stop):
    return (result.t > start) & (result.t < stop)


def test_point_contact_holds_one_newton_while_the_fingers_roll_at_a_metre_a_second(disturbed):
    force = disturbed.measured["normal_force"][between(disturbed, 0.1, 0.2)]
    assert abs(force.mean(axis=0) - 1).max() < 0.01
    assert force.std(axis=0).max() < 0.01


def test_undisturbed_point_contact_rolls_without_slip_and_almost_without_friction(disturbed):
    rolling = between(disturbed, 0.05, 0.2)
    slip = np.linalg.norm(disturbed.measured["slip"][rolling], axis=-1)
    friction = np.linalg.norm(disturbed.measured["tangential_force"][rolling], axis=-1)
    assert (slip / speed(disturbed)[rolling, None]).mean() < 1e-4
    assert friction.mean() < 0.01


def test_friction_saturates_at_mu_times_the_normal_force_while_the_object_rate_is_offset(disturbed):
    window = between(disturbed, 0.25, 0.4)
    friction = np.linalg.norm(disturbed.measured["tangential_force"][window, 0], axis=-1)
    ratio = friction / disturbed.measured["normal_force"][window, 0]
    assert abs(friction.mean() - 0.5) < 0.01
    assert ratio.max() < 0.5 * 1.02


def test_slip_has_gone_ten_milliseconds_after_the_disturbance(disturbed):
    slip = np.linalg.norm(disturbed.measured["slip"][:, 0], axis=-1)
    assert slip[between(disturbed, 0.25, 0.4)].mean() > 0.03
    assert (
        slip[between(disturbed, 0.41, 1.0)].max() < 0.05 * slip[between(disturbed, 0.2, 0.4)].mean()
    )


def test_measured_contact_points_follow_the_planned_curve(disturbed):
    before = between(disturbed, 0.0, 0.2)
    miss = disturbed.measured["contact_point"] - disturbed.planned["contact_point"]
    assert np.linalg.norm(miss[before], axis=-1).max() < 2e-4


def test_undisturbed_fingers_do_not_feel_the_disturbed_one(disturbed):
    """But for one step, in which the object's acceleration jumps."""
    window = between(disturbed, 0.2025, 0.4)
    friction = np.linalg.norm(disturbed.measured["tangential_force"][window, 1:], axis=-1)
    assert friction.max() < 0.01


def test_hydroelastic_patches_hold_one_newton_and_roll(patches):
    rolling = between(patches, 0.1, 1.0)
    force = patches.measured["normal_force"][rolling]
    slip = np.linalg.norm(patches.measured["slip"][rolling], axis=-1)
    assert abs(force.mean(axis=0) - 1).max() < 0.01
    assert force.std(axis=0).max() < 0.05
    assert (slip.mean(axis=0) / speed(patches)[rolling].mean()).max() < 1e-3
    friction = np.linalg.norm(patches.measured["tangential_force"][rolling], axis=-1)
    assert friction.mean() < 0.1


def test_frame_and_chart_coordinates_drive_the_same_motion():
    scene = cs.load_scene("D1")
    one, other = (
        simulate(scene, config(scene, coordinates=form), duration=0.05)
        for form in ("chart", "frame")
    )
    points = [r.measured["contact_point"] for r in (one, other)]
    assert np.abs(points[0] - points[1]).max() < 1e-7


def test_a_station_without_offset_of_radii_spends_friction_on_it():
    scene = cs.load_scene("D1")
    friction = [
        np.linalg.norm(
            simulate(scene, config(scene, rolling_radii=rolling), duration=0.15).measured[
                "tangential_force"
            ][100:],
            axis=-1,
        ).mean()
        for rolling in (True, False)
    ]
    assert friction[0] < 0.3 * friction[1]


def test_rolling_radii_share_the_depth_in_point_contact_and_take_it_off_compliant_fingers():
    scene = cs.load_scene("D1")
    planned = rolling_scene(scene, PlantConfig(contact_model="point", stiffness=1e4))
    assert planned.object.radius == pytest.approx(0.1 - 0.5e-4, abs=1e-12)
    assert planned.contacts[0].finger.radius == pytest.approx(0.04 - 0.5e-4, abs=1e-12)
    soft = rolling_scene(scene, PlantConfig(contact_model="hydroelastic", stiffness=1e4))
    assert soft.object == scene.object
    assert soft.contacts[0].finger.radius == pytest.approx(0.04 - 2e-4, abs=1e-12)
    assert soft.contacts[0].object_at == scene.contacts[0].object_at


@pytest.mark.parametrize(
    "finger",
    [cs.Sphere(0.04), cs.Torus(0.2, 0.04), cs.Quadric(np.diag([123.0, 278.0, 625.0]))],
)
def test_a_contact_deeper_than_a_body_bears_has_no_rolling_radius(finger):
    scene = cs.load_scene("D1")
    contacts = [cs.Contact(finger, scene.contacts[0].object_at)]
    scene = scene.replace(contacts=contacts, disturbances=[])
    rolling_scene(scene, PlantConfig(stiffness=110.0))
    with pytest.raises(cs.SceneError, match="'D1': stiffness = 90.0: contact 0 would be .* deep"):
        rolling_scene(scene, PlantConfig(stiffness=90.0))


TURN = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3
AXES = np.array([0.05, 0.04, 0.03])


CUBE = cs.ImplicitSurface("(x**2 + y**2 + z**2)/2/r**2 + (x**4 + y**4 + z**4)/r**4 - 1", size=0.03,
                          parameters={"r": 0.04})  # fmt: skip


def on_a_sphere(finger):
    contact = cs.Contact(finger=finger, finger_at=(1.1, 0.8), object_at=(1.6, 0.3))
    profile = cs.Profile([0.15])
    return cs.Scene(object=cs.Sphere(0.1), contacts=[contact], duration=0.3, profile=profile)


@pytest.mark.parametrize(
    "finger",
    [
        cs.Quadric(np.diag(AXES**-2)),
        cs.Quadric(TURN @ np.diag(AXES**-2) @ TURN.T),
        cs.ImplicitSurface("(x/a)**2 + (y/b)**2 + (z/depth)**2 - 1", size=0.04,
                           parameters={"a": 0.05, "b": 0.04, "depth": 0.03}),
        CUBE,
    ],
    ids=["quadric", "turned", "implicit ellipsoid", "rounded cube"],
)  # fmt: skip
def test_a_fingertip_of_any_kind_rolls_on_the_surface_at_its_depth(finger):
    inner = rolling_scene(on_a_sphere(finger), PlantConfig(stiffness=1e4)).contacts[0].finger
    u, v = (grid.ravel() for grid in np.meshgrid([0.4, 1.1, 2.2], [-2.0, -0.3, 0.8]))
    outside = inner.point(u, v) + 2e-4 * inner.frame(u, v)[..., 2]  # 1 N is so deep
    on_finger = finger.point(*finger.coordinates(outside))
    assert np.abs(on_finger - outside).max() < 1e-5


def test_a_rounded_cube_as_fingertip_rolls_without_friction():
    config = StationConfig(PlantConfig(object="welded"), coordinates="frame")
    friction = simulate(on_a_sphere(CUBE), config).measured["tangential_force"][100:]
    assert np.linalg.norm(friction, axis=-1).mean() < 0.01  # N; 0.015 on the nominal surface


def test_a_closed_loop_restarts_the_planner_from_the_measured_state():
    """The object is pushed on a little; with the loop closed the plan learns of it."""
    scene = cs.load_scene("D1")
    apart = []
    for changes in ({}, {"restart_period": 0.02}):
        result = simulate(scene, config(scene, rolling_radii=False, **changes), duration=0.2)
        miss = result.measured["contact_point"] - result.planned["contact_point"]
        apart.append(np.linalg.norm(miss[-20:], axis=-1).mean())
        assert np.isfinite(result.planned["state"]).all()
    assert apart[1] < apart[0]


def test_restarts_fall_together_with_steps_of_the_plant_whatever_floating_point_makes_of_both():
    """3 * 0.1 s lies after 300 * 1 ms; a restart a step late would make slip of 0.3 m/s."""
    scene = cs.load_scene("D1")
    result = simulate(scene, config(scene, restart_period=0.1), duration=0.35)
    slip = np.linalg.norm(result.measured["slip"][between(result, 0.05, 1.0)], axis=-1)
    assert slip.max() < 1e-4


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"restart_period": 0.0015}, "0.0015: .* time_step = 0.001; give restart_period = 0.002"),
        ({"restart_period": 0.01, "time_step": 0.003}, "0.01: .* give restart_period = 0.009"),
        ({"restart_slip": 0.1, "time_step": 0.003}, r"None \(None: 0.01 s\).* = 0.009"),
    ],
)
def test_restarts_between_steps_of_the_plant_are_refused(changes, told):
    with pytest.raises(cs.SceneError, match=r"'D1', \[drake\]: restart_period = " + told):
        config(cs.load_scene("D1"), **changes)


@pytest.mark.parametrize("period", (0.3, 0.003, 0.001, 0.0005, None))
def test_restarts_on_steps_of_the_plant_are_fine(period):
    assert config(cs.load_scene("D1"), restart_period=period, restart_slip=0.1).closed_loop


def test_ports_are_exported_only_where_they_have_a_use():
    scene = cs.load_scene("D1")
    plain = BuildStation(scene, config(scene, monitor=False))
    outputs = {plain.get_output_port(i).get_name() for i in range(plain.num_output_ports())}
    assert plain.num_input_ports() == 0
    assert {"state", "slip", "spatial_forces", "contact_results", "query"} <= outputs
    assert not any(name.startswith("measured") for name in outputs)
    full = BuildStation(scene, config(scene, disturbance_input=True))
    assert full.GetInputPort("disturbance").size() == 18
    assert full.GetOutputPort("measured_slip").size() == 6


def test_a_disturbance_from_outside_moves_the_contact_like_a_scheduled_one():
    scheduled = early("D1", 0.0, 0.05, 0.05)
    free = dataclasses.replace(scheduled, disturbances=[])
    planned = simulate(scheduled, config(scheduled)).planned["slip"][-1, 0]
    station = BuildStation(free, config(free, disturbance_input=True))
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    offset = np.zeros(18)
    offset[4:6] = scheduled.disturbances[0].value
    station.GetInputPort("disturbance").FixValue(context, offset)
    SetInitialState(station, context)
    simulator.AdvanceTo(0.05)
    assert station.GetOutputPort("slip").Eval(context)[:2] == pytest.approx(planned, abs=1e-6)


def test_a_start_shakes_contact_little():
    """With the velocities of the moment instead of half a step ago it would be 0.22 N."""
    scene = cs.load_scene("D1")
    force = simulate(scene, config(scene), duration=0.03).measured["normal_force"]
    assert np.abs(force[1:] - 1).max() < 0.1


def test_fingers_start_in_contact_and_moving_as_planned():
    scene = cs.load_scene("D1")
    station = BuildStation(scene, config(scene))
    context = station.CreateDefaultContext()
    SetInitialState(station, context)
    plant = station.GetSubsystemByName("plant")
    physics = plant.GetMyContextFromRoot(context)
    for body in (plant.GetBodyByName(name) for name in ("finger 1", "finger 2", "finger 3")):
        gap = np.linalg.norm(body.EvalPoseInWorld(physics).translation()) - 0.14
        assert gap == pytest.approx(-1e-4, abs=1e-9)
    planned = cs.plan(rolling_scene(scene, StationConfig.from_scene(scene).plant)).twist([0.0])[0]
    moving = plant.GetBodyByName("finger 1").EvalSpatialVelocityInWorld(physics)
    assert moving.get_coeffs() == pytest.approx(planned[0], rel=0.01, abs=0.01)


def test_docstrings_list_the_ports_in_the_order_of_their_indices():
    station = BuildStation(cs.load_scene("D1"))
    for system, described in [
        (station, BuildStation), (station.GetSubsystemByName("planner"), ContactPlanner),
        (station.GetSubsystemByName("driver"), FingertipDriver),
        (station.GetSubsystemByName("monitor"), ContactMonitor),
    ]:  # fmt: skip
        block = inspect.getdoc(described).split("output_ports:\n")[1].split("\n\n")[0]
        names = [system.get_output_port(i).get_name() for i in range(system.num_output_ports())]
        assert [line.split()[1] for line in block.splitlines()] == names


def test_without_drake_the_import_says_what_to_install():
    code = "import sys; sys.modules['pydrake'] = None; import drake_plant"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (
        'ImportError: drake_plant needs Drake: pip install "contact-system[drake]"' in told.stderr
    )


def test_drake_does_not_load_fmpy_until_it_is_needed():
    code = "import drake_plant, sys; assert 'fmpy' not in sys.modules; drake_plant.FmuSystem"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_unknown_key_of_the_drake_table_names_the_nearest():
    scene = cs.load_scene("D1")
    with pytest.raises(cs.SceneError, match=r"scene 'D1', \[drake\]: key 'frction'.*'friction'"):
        StationConfig.from_scene(scene, frction=0.3)


def test_the_drake_table_fills_plant_and_driver():
    built = StationConfig.from_scene(cs.load_scene("D3"))
    assert built.plant.time_step == 2.5e-4
    assert built.plant.object_edge == 0.0038
    assert built.plant.stiffness == 1e4
    assert built.plant.normal_force == 1.0
    assert built.driver == DriverConfig()


# --- gains and the step --------------------------------------------------------------------------


def two_spheres():
    """Spheres of 0.04 and 0.01 m that roll on one of 0.1 m."""
    at = ((0.04, (1.0, 0.2)), (0.01, (2.0, 2.0)))
    contacts = [cs.Contact(cs.Sphere(radius), place) for radius, place in at]
    return cs.Scene(object=cs.Sphere(0.1), contacts=contacts, profile=cs.Profile([0.2]),
                    duration=1.0, name="two")  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"finger_mass": 1e-3},
        {"time_step": 5e-3},
        {"position_gain": 1e6, "velocity_gain": 1e5, "normal_damping": 1e5, "spin_gain": 1e3,
         "rotation_gain": 1e4},
    ],
)  # fmt: skip
def test_no_finger_is_so_light_or_step_so_long_that_gains_throw_it_off(changes):
    scene = two_spheres()
    result = simulate(scene, config(scene, **changes), duration=0.2)
    late = result.t > 0.1
    assert np.abs(result.measured["normal_force"][late] - 1).max() < 0.01
    assert np.abs(result.measured["slip"][late]).max() < 1e-5  # they roll


@pytest.mark.parametrize(("off", "leaving", "bar"), [(1e-4, 0.0, 1e-3), (0.0, 0.01, 0.01)])
def test_a_finger_that_is_off_goes_round_with_the_plan(off, leaving, bar):
    """In a discrete plant, by `off` and more by `leaving` m/s: what acts is what that takes."""
    r, omega, h, damping = 0.14, 20.0, 1e-3, 200.0

    def normal(k):
        return np.array([math.cos(omega * k * h), math.sin(omega * k * h), 0.0])

    def place(k):
        return (r + off + leaving * k * h) * normal(k)

    still = {"R_WO": np.eye(3), "R_OF": np.eye(3), "R_WF": np.eye(3), "p_OF": r * normal(0),
             "position": r * normal(-1), "normal": normal(0), "normal_before": normal(-1),
             "p_WF": place(0), "v_WF": (place(0) - place(-1)) / h, "steps": 2.0}  # fmt: skip
    for k, name in ((0, "a_OF"), (-1, "a_before"), (-2, "a_earlier")):
        still[name] = -(omega**2) * r * normal(k)
    held = {"h": h, "mass": 1.0, "normal_damping": damping}
    machine = driving_law().machine(1)
    for row, sizes, given in ((machine.x, POINT, still), (machine.c, CONSTANT, held)):
        row[0] = np.concatenate([np.ravel(given.get(k, np.zeros(n))) for k, n in sizes.items()])
    machine.run()
    needed = (place(1) - 2 * place(0) + place(-1)) / h**2 - damping * leaving * normal(0)
    assert machine.y[0, 3:6] == pytest.approx(needed, abs=bar)


def test_a_step_in_which_no_gain_could_hold_a_finger_is_refused():
    scene = two_spheres()
    with pytest.raises(cs.SceneError, match="'two', contact 0: time_step = 0.005.*0.0001 kg.*give"):
        BuildStation(scene, config(scene, finger_mass=1e-4, time_step=5e-3))


def test_fingers_press_with_the_normal_force_that_the_plant_is_made_for():
    scene = two_spheres()
    plant = PlantConfig(contact_model="point", normal_force=5.0)
    force = simulate(scene, StationConfig(plant=plant), duration=0.1).measured["normal_force"]
    assert force[-1] == pytest.approx([5.0, 5.0], rel=0.01)


# --- fingertips of other shapes ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("finger", "at"),
    [
        (cs.Torus(0.05, 0.02), (1.0, 0.3)),
        (cs.Ellipsoid(0.05, 0.04, 0.03), (1.0, 0.5)),
        (cs.Cylinder(0.04), (1.0, 0.0)),
    ],
    ids=["torus", "ellipsoid", "cylinder"],
)
def test_fingertips_that_are_no_spheres_press_with_one_newton_and_roll(finger, at):
    """The normal force passes their mass centres by."""
    contacts = [cs.Contact(finger, (1.0, 0.2), at)]
    scene = cs.Scene(object=cs.Sphere(0.1), contacts=contacts, profile=cs.Profile([0.15]),
                     duration=0.6)  # fmt: skip
    result = simulate(scene, StationConfig.from_scene(scene, coordinates="frame"))
    late = result.t > 0.05
    force = result.measured["normal_force"][late]
    assert force.mean() == pytest.approx(1, abs=0.015)
    assert force.std() < 0.025
    assert np.linalg.norm(result.measured["slip"][late], axis=-1).mean() < 1e-3 * 0.15
    assert np.linalg.norm(result.measured["tangential_force"][late], axis=-1).mean() < 0.03


# --- objects that are not free -------------------------------------------------------------------


@pytest.mark.parametrize("time_step", [0.0, 1e-3])
def test_a_finger_on_something_else_does_not_touch_the_object(time_step):
    """In a plant of the user's own, where a table stands under the fingertip."""
    scene, builder = cs.load_scene("C2"), DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
    bodies = []
    for name, surface in (("object", scene.object), ("finger", scene.contacts[0].finger)):
        inertia = SpatialInertia.SolidSphereWithMass(1.0, surface.size)
        bodies.append(plant.AddRigidBody(name, inertia))
        shape = SphereShape(surface.size)
        plant.RegisterCollisionGeometry(
            bodies[-1], RigidTransform(), shape, name, CoulombFriction(0.5, 0.5)
        )
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "table", CoulombFriction(0.5, 0.5)
    )
    plant.Finalize()
    parts = ScenePlant(scene, PlantConfig(time_step), plant, scene_graph, bodies[0], bodies[1:])
    monitor = builder.AddSystem(ContactMonitor(scene, parts))
    for name in ("contact_results", "body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), monitor.GetInputPort(name))
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    for body, place in zip(bodies, ([0, 0, 5.0], [0.5, 0, scene.contacts[0].finger.size - 1e-3])):
        plant.SetFreeBodyPose(context, body, RigidTransform(np.array(place)))
    simulator.AdvanceTo(time_step)
    assert plant.get_contact_results_output_port().Eval(context).num_point_pair_contacts() == 1
    own = monitor.GetMyContextFromRoot(root)
    for name, nothing in (("normal_force", [0.0]), ("tangential_force", [0.0, 0.0])):
        assert monitor.GetOutputPort(name).Eval(own).tolist() == nothing


def test_a_welded_object_stays_where_it_is():
    scene = two_spheres()
    result = simulate(scene, config(scene, object="welded"), duration=0.1)
    assert np.abs(result.object_pose - np.eye(4)).max() < 1e-15
    assert result.measured["normal_force"][-1] == pytest.approx([1.0, 1.0], rel=0.01)


@pytest.mark.parametrize("rolling_radii", (True, False))
def test_slip_on_a_plane_is_that_of_drakes_point_contact(rolling_radii):
    contact = cs.Contact(cs.Sphere(0.04), object_at=(0.0, 0.0), finger_velocity=(0.6, 0.8))
    scene = cs.Scene(
        name="flat", object=cs.Plane(), contacts=[contact], profile=cs.Profile([0.1]), duration=0.1
    )
    chosen = config(scene, object="welded", contact_model="point", rolling_radii=rolling_radii)
    station = BuildStation(scene, chosen)
    simulator = Simulator(station)
    SetInitialState(station, simulator.get_mutable_context())
    simulator.AdvanceTo(0.05)
    root = simulator.get_context()
    drakes = station.GetOutputPort("contact_results").Eval(root).point_pair_contact_info(0)
    slip = np.linalg.norm(station.GetOutputPort("measured_slip").Eval(root))
    assert slip == pytest.approx(drakes.slip_speed(), abs=1e-8)


@pytest.fixture(scope="module")
def turned():
    scene = cs.load_scene("C1")
    return simulate(scene, config(scene, coordinates="frame"))


def test_an_object_turns_as_the_scene_says_without_being_asked_to(turned):
    found = Rotation.from_matrix(turned.object_pose[:, :3, :3])
    wanted = Rotation.from_rotvec(turned.scene.turning.rotation_vector(turned.t))
    assert (found * wanted.inv()).magnitude().max() < 1e-7
    assert not turned.object_pose[:, :3, 3].any()


def test_an_object_goes_on_turning_beyond_the_end_of_its_scene(turned):
    scene = turned.scene.replace(duration=0.02)
    config = StationConfig.from_scene(scene, coordinates="frame", contact_model="point")
    run = simulate(scene, config, duration=0.06)
    found = Rotation.from_matrix(run.object_pose[-1, :3, :3])
    wanted = Rotation.from_rotvec(scene.turning.rotation_vector(run.t[-1:]))
    assert (found * wanted[0].inv()).magnitude() < 1e-7


def test_a_finger_rolls_on_a_turning_object_and_does_not_turn_itself(turned):
    """The corollary's great circle, and what C1's profile was chosen for."""
    force = turned.measured["normal_force"][turned.t > 0.05]
    assert np.abs(force - 1).max() < 0.01
    assert np.linalg.norm(turned.measured["slip"], axis=-1).max() < 1e-3
    points = turned.measured["contact_point"][:, 0]
    assert np.abs(points @ np.ones(3)).max() < 1e-5  # the plane of the great circle


# --- starting anywhere ---------------------------------------------------------------------------


def at_time(station, t):
    """A context of a station with its planner where the plan is at t."""
    planner = station.GetSubsystemByName("planner")
    context = station.CreateDefaultContext()
    context.SetTime(t)
    state = cs.plan(planner.system.scene).states([t]).reshape(1, -1, 9)[0]
    x = planner.system.from_states(t, state, np.zeros(planner.system.n_w))[0]
    planner.GetMyMutableContextFromRoot(context).SetContinuousState(x)
    return context


def test_a_configuration_that_is_changed_later_changes_nothing():
    scene = cs.load_scene("D1")
    given = config(scene)
    station = BuildStation(scene, given)
    states = []
    for _ in range(2):
        context = station.CreateDefaultContext()
        SetInitialState(station, context)
        states.append(station.GetOutputPort("plant_state").Eval(context))
        given.plant.normal_force *= 5
    assert np.array_equal(*states)


@pytest.mark.parametrize("rolling", [True, False])
def test_a_station_starts_where_its_planner_is(rolling):
    scene, t = cs.load_scene("D1"), 1.2
    station = BuildStation(scene, config(scene, rolling_radii=rolling))
    planner, plant = (station.GetSubsystemByName(name) for name in ("planner", "plant"))
    context = at_time(station, t)
    SetInitialState(station, context)
    physics, planned = plant.GetMyContextFromRoot(context), cs.plan(planner.system.scene)
    half_a_step_ago = planned.twist([t - 5e-4])[0]  # a discrete plant moves with this
    normals = planned.points([t])[0, :, 1] / 0.1
    for i, X_OF in enumerate(planned.pose([t])[0]):
        body = plant.GetBodyByName(f"finger {i + 1}")
        if not rolling:
            X_OF[:3, 3] -= 1e-4 * normals[i]  # 1 N by 10 kN/m
        assert body.EvalPoseInWorld(physics).GetAsMatrix4() == pytest.approx(X_OF, abs=1e-8)
        moving = body.EvalSpatialVelocityInWorld(physics).get_coeffs()
        assert moving == pytest.approx(half_a_step_ago[i], abs=5e-3)
    simulator = Simulator(station, context)
    for late in (0.01, 0.05, 0.1):
        simulator.AdvanceTo(t + late)
        force = station.GetOutputPort("normal_force").Eval(context)
        assert force == pytest.approx([1.0, 1.0, 1.0], abs=0.02)


def test_a_station_that_has_run_starts_anew():
    scene = cs.load_scene("D1")
    station = BuildStation(scene, config(scene))
    planner, plant = (station.GetSubsystemByName(name) for name in ("planner", "plant"))
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    forces = []
    for _ in range(2):
        context.SetTime(0.0)
        for system in (planner, plant):
            system.SetDefaultContext(system.GetMyMutableContextFromRoot(context))
        SetInitialState(station, context)
        simulator.Initialize()
        assert not station.GetOutputPort("normal_force").Eval(context).any()
        simulator.AdvanceTo(2e-3)
        forces.append(station.GetOutputPort("normal_force").Eval(context).copy())
    assert forces[0] == pytest.approx(forces[1], abs=1e-6)


def test_stations_start_inside_another_diagram_under_names_of_their_own():
    scene, builder = cs.load_scene("D1"), DiagramBuilder()
    names = ("left", "right")
    stations = [builder.AddNamedSystem(n, BuildStation(scene, config(scene))) for n in names]
    diagram = builder.Build()
    simulator = Simulator(diagram)
    root = simulator.get_mutable_context()
    for wrong in (diagram, root, stations[0].GetSubsystemByName("planner")):
        with pytest.raises(cs.SceneError, match="station = .*: give what BuildStation made, or"):
            SetInitialState(wrong, root)
    with pytest.raises(cs.SceneError, match="context = .*: give a Context"):
        SetInitialState(stations[0], simulator)
    for station in stations:
        SetInitialState(station, root)
    simulator.AdvanceTo(0.02)
    for station in stations:
        own = station.GetMyContextFromRoot(root)
        force = station.GetOutputPort("normal_force").Eval(own)
        assert force == pytest.approx([1.0, 1.0, 1.0], abs=0.02)


def test_a_diagram_of_ones_own_starts_by_the_names_of_its_systems():
    """And is refused where systems of these names are others."""
    scene, builder = cs.load_scene("D1"), DiagramBuilder()
    parts = AddScenePlant(builder, scene, config(scene).plant)
    planner = builder.AddNamedSystem("planner", ContactPlanner(scene))
    driver = builder.AddNamedSystem("driver", FingertipDriver(parts, DriverConfig()))
    diagram = builder.Build()
    SetInitialState(diagram, root := diagram.CreateDefaultContext())
    X_WF = parts.finger_bodies[0].EvalPoseInWorld(parts.plant.GetMyContextFromRoot(root))
    assert np.linalg.norm(X_WF.translation()) == pytest.approx(0.14, abs=1e-3)
    for system, name in ((planner, "planner"), (driver, "driver"), (parts.plant, "plant")):
        system.set_name("mine")
        parts.scene_graph.set_name(name)
        with pytest.raises(cs.SceneError, match="FingertipDriver and .* are named 'planner', 'dr"):
            SetInitialState(diagram, root)
        parts.scene_graph.set_name("scene_graph")
        system.set_name(name)


def test_threads_share_a_station_with_a_context_each():
    scene = cs.load_scene("D1")
    station = BuildStation(scene, config(scene, disturbance_input=True))

    def pressed(rate):
        simulator = Simulator(station)
        context = simulator.get_mutable_context()
        station.GetInputPort("disturbance").FixValue(context, np.full(18, rate))
        SetInitialState(station, context)
        simulator.AdvanceTo(0.03)
        return station.GetOutputPort("plant_state").Eval(context)

    rates, interval = (0.0, 0.1, 0.2, 0.3), sys.getswitchinterval()
    expected = [pressed(rate) for rate in rates]
    sys.setswitchinterval(1e-6)  # threads take turns after every few instructions
    try:
        with ThreadPoolExecutor(len(rates)) as pool:
            found = list(pool.map(pressed, rates))
    finally:
        sys.setswitchinterval(interval)
    assert np.array_equal(found, expected)


def test_drake_evaluates_batches_of_a_station_that_has_run():
    """It copies Contexts, what is cached included, without the lock of Python.

    With two threads Drake's own copies of its SceneGraph's query race.
    """
    scene = cs.load_scene("D1")
    station = BuildStation(scene, config(scene))
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    SetInitialState(station, context)
    simulator.AdvanceTo(0.003)
    station.GetOutputPort("measured_state").Eval(context)
    x = context.get_continuous_state_vector().CopyToVector()
    found = BatchEvalTimeDerivatives(
        station, context, np.full((1, 20), 0.003), np.tile(x, (20, 1)).T, np.zeros((0, 20)),
        InputPortSelection.kNoInput, Parallelism(1),
    )  # fmt: skip
    rates = station.EvalTimeDerivatives(context).CopyToVector()
    assert np.array_equal(found, np.tile(rates, (20, 1)).T)


def test_a_turning_object_starts_as_it_turns_then():
    scene = cs.load_scene("C1")
    station = BuildStation(scene, config(scene, coordinates="frame"))
    context = at_time(station, 0.5)
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


def test_an_object_of_a_plant_of_ones_own_that_turns_in_another_way_stays_where_it_is():
    scene, builder = cs.load_scene("C1"), DiagramBuilder()
    turns = StationConfig.from_scene(scene, coordinates="frame").plant
    parts = own_parts(builder=builder, scene=scene, config=turns)
    builder.AddNamedSystem("planner", ContactPlanner(scene, "frame"))
    builder.AddNamedSystem("driver", FingertipDriver(parts, DriverConfig()))
    context = at_time(station := builder.Build(), 0.5)
    SetInitialState(station, context)
    physics = parts.plant.GetMyContextFromRoot(context)
    assert parts.object_body.EvalPoseInWorld(physics).IsExactlyIdentity()


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"time_step": 0}, "time_step = 0: .* discrete plant only; give"),
        ({"time_step": "1e-3"}, "time_step = '1e-3': give a finite number"),
        ({"friction": True}, "friction = True: give a finite number"),
        ({"velocity_gain": np.nan}, "velocity_gain = nan: give a finite number not below 0"),
        ({"spin_gain": -1}, "spin_gain = -1: .* not below 0"),
        ({"coordinates": "charts"}, "coordinates = 'charts': use one of chart, frame"),
        ({"coordinates": ["chart"]}, "coordinates = .*: use one of chart, frame"),
        ({"monitor": "no"}, "monitor = 'no': give True or False"),
        ({"restart_period": 0.0}, "restart_period = 0.0: give a finite number above 0"),
        ({"restart_slip": "small"}, "restart_slip = 'small': give"),
    ],
)  # fmt: skip
def test_a_wrong_value_of_the_drake_table_is_named(changes, words):
    with pytest.raises(cs.SceneError, match=r"^scene 'D1', \[drake\]: " + words):
        StationConfig.from_scene(cs.load_scene("D1"), **changes)


def test_a_wrong_configuration_is_refused_before_anything_is_built():
    scene = cs.load_scene("D1")
    for wrong, words in (
        (StationConfig(plant=PlantConfig(time_step=0.0)), "time_step = 0.0: .* discrete"),
        (StationConfig(driver=DriverConfig(position_gain=None)), "position_gain = None"),
        (StationConfig(plant={"friction": 0.5}), "plant = .*: give a PlantConfig"),
        (PlantConfig(), "config = PlantConfig.*: give a StationConfig"),
        ({"friction": 0.5}, "config = {'friction': 0.5}: give a StationConfig"),
    ):
        for start in (BuildStation, simulate):
            with pytest.raises(cs.SceneError, match="^scene 'D1', station: " + words):
                start(scene, wrong)


def test_drakes_yaml_functions_read_and_write_configurations():
    text = "plant: {time_step: 2e-3, finger_edge: 0.001}\ndriver: {spin_gain: 0.1}\n"
    text += "coordinates: frame\nrestart_period: 0.1\n"
    read = yaml_load_typed(schema=StationConfig, data=text, defaults=StationConfig())
    plant = PlantConfig(time_step=2e-3, finger_edge=1e-3)
    assert read == StationConfig(
        plant, DriverConfig(spin_gain=0.1), coordinates="frame", restart_period=0.1
    )
    assert yaml_load_typed(schema=StationConfig, data=yaml_dump_typed(read)) == read


def test_a_configuration_of_another_kind_is_refused():
    scene, builder = cs.load_scene("D1"), DiagramBuilder()
    for wrong in (StationConfig(), None):
        with pytest.raises(cs.SceneError, match="^scene 'D1': config = .*: give a PlantConfig"):
            rolling_scene(scene, wrong)
        with pytest.raises(cs.SceneError, match="^scene 'D1', plant: config = .* a PlantConfig"):
            AddScenePlant(builder, scene, wrong)


def test_parts_of_another_kind_or_scene_are_refused():
    """The plant itself is not what driver and monitor are made from."""
    scene, builder = cs.load_scene("D1"), DiagramBuilder()
    parts = AddScenePlant(builder, scene, config(scene).plant)
    for start, message in (
        (lambda: FingertipDriver(parts.plant, DriverConfig()), "scene_plant = .*: give a ScenePl"),
        (lambda: ContactMonitor(scene, parts.plant), "scene_plant = .*: give a ScenePlant"),
        (lambda: ContactMonitor(parts, scene), "scene = .*: give a Scene"),
        (lambda: ContactMonitor(cs.load_scene("C1"), parts), "'C1' has 1 .* 'D1', 3: give"),
    ):
        with pytest.raises(cs.SceneError, match=message):
            start()


def own_parts(
    step=1e-3, off=0.0, finalized=True, more=lambda plant, finger: None, sampled=True, builder=None,
    **changes,
):  # fmt: skip
    """Of two bodies by hand, and what ``more`` adds, changed."""
    scene, builder = cs.load_scene("C2"), builder or DiagramBuilder()
    wanted = MultibodyPlantConfig(time_step=step, use_sampled_output_ports=sampled)
    plant, scene_graph = AddMultibodyPlant(wanted, builder)
    inertia = SpatialInertia(0.01, np.array([off, 0.0, 0.0]), UnitInertia.SolidSphere(0.04))
    bodies = [plant.AddRigidBody(name, inertia) for name in ("object", "finger")]
    more(plant, bodies[1])
    if finalized:
        plant.Finalize()
    given = dict(
        scene=scene, config=PlantConfig(), plant=plant, scene_graph=scene_graph,
        object_body=bodies[0], finger_bodies=bodies[1:],
    )  # fmt: skip
    return ScenePlant(**given | changes)


@pytest.mark.parametrize(
    ("step", "off", "message"),
    [
        (0.0, 0.0, "'C2': time_step = 0.0: fingers are driven in a discrete plant only"),
        (0.1, 0.0, "'C2', contact 0: time_step = 0.1: a finger of 0.01 kg can be held"),
        (1e-3, 1e-3, "'C2', contact 0: the mass centre of body 'finger' is at .0.001, 0"),
    ],
)
def test_fingers_of_a_plant_of_ones_own_that_cannot_be_driven_are_refused(step, off, message):
    """Whatever its PlantConfig says."""
    parts = own_parts(step, off)
    with pytest.raises(cs.SceneError, match=message):
        FingertipDriver(parts, DriverConfig())


def with_a_camera(plant, finger):
    camera = plant.AddRigidBody("camera", SpatialInertia.SolidSphereWithMass(0.1, 0.01))
    plant.WeldFrames(finger.body_frame(), camera.body_frame())


def on_a_slide(plant, finger):
    slide = PrismaticJoint("slide", plant.world_frame(), finger.body_frame(), [0.0, 0.0, 1.0])
    plant.AddJoint(slide)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"more": with_a_camera}, "0: body 'finger' is not free, but has the joint 'finger_welds_"),
        ({"more": on_a_slide}, "0: body 'finger' is not free, but has the joint 'slide'; forces"),
        ({"sampled": False}, "the plant has no sampled output ports, .* give Multi"),
    ],
)
def test_fingers_that_do_not_move_alone_are_refused(changes, message):
    """And forces that depend on the accelerations that they cause."""
    with pytest.raises(cs.SceneError, match=message):
        FingertipDriver(own_parts(**changes), DriverConfig())


def test_a_finger_may_have_a_floating_joint_of_ones_own():
    def floating(plant, finger):
        plant.AddJoint(RpyFloatingJoint("free", plant.world_frame(), finger.body_frame()))

    FingertipDriver(own_parts(more=floating), DriverConfig())


@pytest.mark.parametrize("heavy", (True, False))
def test_fingers_move_as_planned_whether_gravity_pulls_them_or_not(heavy):
    """Drake can switch it off for a model; nothing else acts here."""
    builder = DiagramBuilder()

    def pulled(plant, finger):
        plant.set_gravity_enabled(finger.model_instance(), heavy)

    parts = own_parts(builder=builder, more=pulled, config=PlantConfig(normal_force=1e-9))
    planner = builder.AddNamedSystem("planner", ContactPlanner(parts.scene))
    driver = builder.AddNamedSystem("driver", FingertipDriver(parts, DriverConfig()))
    for port in map(driver.get_input_port, range(driver.num_input_ports())):
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


def test_wrong_parts_of_a_plant_of_ones_own_are_named():
    other = own_parts()
    for changes, words in (
        ({"finalized": False}, "the plant is not finalized: call plant.Finalize.. first"),
        ({"plant": None}, "plant = None: give a MultibodyPlant"),
        ({"scene_graph": None}, "scene_graph = None: give a SceneGraph"),
        ({"config": StationConfig()}, "config = StationConfig.*: give a PlantConfig"),
        ({"object_body": "object"}, "object_body = 'object': give a RigidBody"),
        ({"object_body": other.object_body}, "object_body = .* is a body of another plant"),
        ({"finger_bodies": ["finger"]}, r"finger_bodies\[0\] = 'finger': give a RigidBody"),
        ({"finger_bodies": other.object_body}, "finger_bodies = <.*: give a list of 1, one for"),
        ({"finger_bodies": []}, r"finger_bodies = \[\]: give a list of 1, one for each contact"),
    ):
        with pytest.raises(cs.SceneError, match=f"^scene 'C2', scene_plant: {words}"):
            own_parts(**changes)
    with pytest.raises(cs.SceneError, match="scene = 'C2': give a Scene"):
        own_parts(scene="C2")
    with pytest.raises(cs.SceneError, match=r"finger_bodies\[0\] = .* is object_body already"):
        dataclasses.replace(other, finger_bodies=[other.object_body])


def test_poses_of_another_scene_are_refused():
    scene, builder = cs.load_scene("D1"), DiagramBuilder()
    parts = AddScenePlant(builder, scene, config(scene).plant)
    driver = builder.AddSystem(FingertipDriver(parts, DriverConfig()))
    context = driver.CreateDefaultContext()
    for k in range(driver.num_input_ports()):
        port = driver.get_input_port(k)
        value = driver.AllocateInputAbstract(port)
        port.FixValue(context, value)
    with pytest.raises(cs.SceneError, match="'D1': 0 poses on .* port 'pose' for 3 fingers; con"):
        driver.get_output_port().Eval(context)


def test_numbers_of_numpy_are_numbers():
    scene = cs.load_scene("D1")
    changes = {"time_step": np.float32(1e-3), "stiffness": np.int64(10_000), "gravity": np.int32(0),
               "velocity_gain": np.float32(60), "monitor": np.bool_(True),
               "relaxation_time": np.float32(0), "restart_slip": np.float32(0.1)}  # fmt: skip
    result = simulate(scene, config(scene, **changes), duration=np.float32(0.05))
    assert result.measured["normal_force"][-1] == pytest.approx([1.0, 1.0, 1.0], abs=0.02)


@pytest.mark.parametrize("duration", [0, -1.0, float("nan"), float("inf"), 1e-4, "1", True])
def test_a_time_in_which_nothing_can_be_simulated_is_refused(duration):
    scene = cs.load_scene("D1")
    message = f"scene 'D1': (a simulation of|duration =) {duration!r}"
    with pytest.raises(cs.SceneError, match=message):
        simulate(scene, config(scene), duration=duration)


@pytest.mark.parametrize("name", ["none/film.html", ""])
def test_a_recording_that_cannot_be_written_is_refused_before_anything_is_simulated(tmp_path, name):
    scene = cs.load_scene("D1")
    with pytest.raises(cs.SceneError, match="scene 'D1': recording = .*folder that exists"):
        simulate(scene, config(scene), recording=tmp_path / name)


@pytest.mark.parametrize("progress", [3, "bar", True])
def test_a_progress_that_is_no_function_is_refused(progress):
    with pytest.raises(cs.SceneError, match=f"'D1': progress = {progress!r}: give a function of a"):
        simulate(cs.load_scene("D1"), progress=progress)


def test_a_recording_that_is_none_is_refused(tmp_path):
    with pytest.raises(cs.SceneError, match="scene 'D1': recording = 5: give a path"):
        simulate(cs.load_scene("D1"), recording=5)
    for frames in (0, -3.0, "many"):
        with pytest.raises(cs.SceneError, match=f"frames = {frames!r}: give a finite number above"):
            Recording(frames)
    with pytest.raises(cs.SceneError, match="nothing to save in film.html: call Add before"):
        Recording().Save("film.html")
    builder, film, scene = DiagramBuilder(), Recording(), cs.load_scene("D1")
    for given, name in (((None, scene), "builder"), ((builder, scene), "scene_plant")):
        with pytest.raises(cs.SceneError, match=f"{name} = .*: give a "):
            film.Add(*given)
    with pytest.raises(cs.SceneError, match="'D1', plant: builder = None: give a DiagramBuilder"):
        AddScenePlant(None, scene, config(scene).plant)
    film.Add(builder, AddScenePlant(builder, scene, config(scene).plant))
    builder.Build()
    with pytest.raises(cs.SceneError, match="'.*film.html' cannot be written: .*give a path in a"):
        film.Save(tmp_path / "none" / "film.html")
