"""Contact forces that hold an object: closed forms, simulations, grasps that cannot hold it."""

import math

import numpy as np
import pytest

import contact_system as cs

pytest.importorskip("pydrake", reason="Drake is an extra: pip install .[drake]")

from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder

from drake_plant import BuildStation, ForceBalancer, ScenePlant, StationConfig, simulate
from drake_plant.balance import balancing_forces, friction_used, needed_wrench
from drake_plant.cli import _printed
from drake_plant.measures import object_report

WEIGHT = 0.2 * 9.81


def contacts_at(angles):
    """Contact points at angles on the equator of a ball of 0.1 m, and normals into it."""
    normals = -np.stack([np.cos(angles), np.sin(angles), 0 * np.array(angles)], axis=-1)[None]
    return -0.1 * normals, normals


def evenly_spaced_contacts(n):
    return contacts_at(2 * np.pi * np.arange(n) / n)


@pytest.mark.parametrize("n", [2, 3, 5])
@pytest.mark.parametrize("friction", [0.1, 0.5])
def test_fingers_around_the_equator_press_no_more_than_the_weight_needs(n, friction):
    points, normals = evenly_spaced_contacts(n)
    torque = [[1e-9, 0, 0]]  # two fingers cannot balance it, but it is small enough for rounding
    forces = balancing_forces(points, normals, friction, [[0, 0, WEIGHT]], torque)
    least = WEIGHT / (n * 0.8 * friction)
    np.testing.assert_allclose(np.sum(forces * normals, axis=-1), least, rtol=1e-6)
    np.testing.assert_allclose(forces.sum(axis=1), [[0, 0, WEIGHT]], atol=1e-7)
    np.testing.assert_allclose(friction_used(forces, normals, friction), 0.8, rtol=1e-6)


def test_forces_exert_the_wrench_that_is_asked_for_at_every_time():
    rng = np.random.default_rng(3)
    angles = 2 * np.pi * np.arange(3) / 3 + 0.3 * rng.normal(size=(20, 3))
    points, normals = (x[0] for x in contacts_at(angles))
    force = [0, 0, WEIGHT] + 0.1 * rng.normal(size=(20, 3))
    torque = 0.01 * rng.normal(size=(20, 3))
    forces = balancing_forces(points, normals, [0.4, 0.5, 0.6], force, torque, least=0.5)
    np.testing.assert_allclose(forces.sum(axis=1), force, atol=1e-6)
    np.testing.assert_allclose(np.cross(points, forces).sum(axis=1), torque, atol=1e-7)
    assert friction_used(forces, normals, [0.4, 0.5, 0.6]).max() < 0.8 + 1e-6
    assert np.sum(forces * normals, axis=-1).min() > 0.5 - 1e-6


@pytest.mark.parametrize(
    ("angles", "friction", "torque", "left"),
    [
        ([0.0], 0.5, (0, 0, 0), "a force of"),
        ([0, np.pi], 0.0, (0, 0, 0), r"a force of \(0, 0, -1.96\) N and a torque of \(0, 0, 0\)"),
        ([0, np.pi], 0.5, (1e-6, 0, 0), r"torque of \(-1e-06, 0, 0\)"),
        ([0, np.pi], 0.5, (0.01, 0, 0), r"force of \(0, 0, 0\) N and a torque of \(-0.01, 0, 0\)"),
    ],
)
def test_contacts_that_cannot_hold_are_refused_with_what_is_unbalanced(
    angles, friction, torque, left
):
    points, normals = (np.tile(x, (2, 1, 1)) for x in contacts_at(np.array(angles)))
    force, torque = [[0, 0, 0], [0, 0, WEIGHT]], [[0, 0, 0], torque]
    with pytest.raises(cs.SceneError, match=rf"^t = 0.3 s: .*{left}"):
        balancing_forces(points, normals, friction, force, torque, t=[0.2, 0.3])


def test_normals_forces_friction_and_margin_of_wrong_size_are_refused():
    points, normals = evenly_spaced_contacts(3)
    right = {"normals": normals, "friction": 0.5, "force": [[0, 0, WEIGHT]], "torque": [[0, 0, 0]]}
    for wrong, words in (
        *(({"normals": x * normals}, "give vectors of length 1") for x in (0.0, 0.5, np.nan)),
        ({"force": [0, 0, WEIGHT]}, r"^force has shape \(3,\); give \(1, 3\)"),
        ({"friction": [0.5, 0.5]}, "give a number, or one for each contact"),
        ({"margin": 2}, "^margin = 2: give a part of the friction cones, at most 1"),
    ):
        with pytest.raises(cs.SceneError, match=words):
            balancing_forces(points, **right | wrong)


def test_the_needed_wrench_obeys_newtons_and_eulers_equations():
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])[None]  # O's x is the world's y
    body, down = SpatialInertia(2.0, np.zeros(3), UnitInertia(0.5, 1.0, 1.5)), [0, 0, -9.81]
    force, torque = needed_wrench(body, down, turned, [0, 2, 3, 0, 0, 0], [0.5, 0, 0, 0, 1, 0])
    np.testing.assert_allclose(force, [[2.0, 0, 2 * 9.81]], atol=1e-7)
    # in O: w = (2, 0, 3), alpha = (0, -0.5, 0), w x I w = (0, 3 2 - 2 9, 0)
    np.testing.assert_allclose(torque, [[0, 2 * -0.5 + 6 - 18, 0]], atol=1e-7)


def held_ball(**changes):
    """A ball of 0.2 kg with three fingertips around its equator, which move hardly at all."""
    at = [(math.pi / 2, 2 * math.pi * i / 3) for i in range(3)]
    contacts = [cs.Contact(finger=cs.Sphere(0.02), object_at=x) for x in at]
    drake = {"object_mass": 0.2, "finger_mass": 0.05, "gravity": 9.81, **changes}
    given = {"profile": cs.Profile([1e-6]), "duration": 1.0, "drake": drake, "name": "held"}
    return cs.Scene(object=cs.Sphere(0.05), contacts=contacts, **given)


@pytest.mark.parametrize("model", ["point", "hydroelastic"])
def test_three_fingers_hold_a_ball_against_gravity(model):
    result = simulate(held_ball(contact_model=model), duration=0.25)
    found = object_report(result)
    assert found.moved < 1e-4 and found.turned < np.radians(0.1) and not found.falls
    assert (result.measured["normal_force"][1:] > 0).all()
    np.testing.assert_allclose(result.planned["friction_used"], 0.8, atol=0.01)
    assert result.measured["friction_used"][1:].max() < 0.85
    told = " ".join("\n".join(_printed(result, None)).split())
    assert "Its weight is carried by the fingers" in told
    assert "80% of the friction cones as planned" in told


def test_forces_balance_the_weight_at_the_mass_centre_of_a_users_plant():
    scene, builder, center = held_ball(), DiagramBuilder(), np.array([0.01, 0.0, 0.005])
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 1e-3)
    inertia = SpatialInertia.SolidSphereWithMass(0.2, 0.03).Shift(-center)
    bodies = [plant.AddRigidBody(name, inertia) for name in ("object", "a", "b", "c")]
    plant.Finalize()
    config = StationConfig.from_scene(scene)
    parts = ScenePlant(scene, config, plant, scene_graph, bodies[0], bodies[1:])
    balancer = builder.AddSystem(ForceBalancer(parts))
    for name in ("body_poses", "body_spatial_velocities"):
        builder.Connect(plant.GetOutputPort(name), balancer.GetInputPort(name))
    context = balancer.GetMyContextFromRoot(builder.Build().CreateDefaultContext())
    (points,), (normals,) = evenly_spaced_contacts(3)
    both = np.hstack([points, points])  # on fingers, and on the object
    for name, values in (("contact_point", both), ("normal", -normals)):
        balancer.GetInputPort(name).FixValue(context, values.ravel())
    forces = balancer.GetOutputPort("contact_forces").Eval(context).reshape(3, 3)
    weight = [0.0, 0.0, WEIGHT]
    np.testing.assert_allclose(forces.sum(axis=0), weight, atol=1e-6)
    torque = np.cross(points, forces).sum(axis=0)
    np.testing.assert_allclose(torque, np.cross(center, weight), atol=1e-7)


@pytest.mark.parametrize("force", [-0.5, 2.0])
def test_a_ball_pushed_while_it_is_held_comes_back(force):
    push = {"on": "object", "start": 0.05, "stop": 0.1, "force": [0.0, 0.0, force]}
    result = simulate(held_ball(contact_model="point", pushes=[push]), duration=0.5)
    path = np.linalg.norm(result.object_pose[:, :3, 3], axis=1)
    assert path.max() > 2e-4 and path[-1] < 1e-4 and not object_report(result).falls


def test_an_object_that_its_contacts_cannot_hold_is_refused_before_the_simulation():
    scene = held_ball().replace(contacts=held_ball().contacts[:1])
    with pytest.raises(cs.SceneError, match="^scene 'held': t = 0 s: no contact forces within 80%"):
        BuildStation(scene)


def test_an_object_under_constant_forces_or_pushed_off_a_finger_is_reported_to_fall():
    scene = held_ball(contact_model="point", forces="constant")
    result, soon = (simulate(scene, duration=duration) for duration in (0.1, 0.002))
    assert object_report(result).falls and math.isnan(object_report(soon).carried)
    assert (result.planned["normal_force"] == 1.0).all()
    assert "nothing balances it" in " ".join(_printed(result, None))
    push = {"on": "contact 0", "start": 0.42, "stop": 1.0, "force": [20.0, 0.0, 0.0]}
    scene = held_ball(contact_model="point", pushes=[push])
    assert object_report(simulate(scene, duration=0.5)).falls


def test_only_a_free_object_is_balanced():
    with pytest.raises(cs.SceneError, match='forces = "balance": the object is welded'):
        StationConfig.from_scene(held_ball(), object="welded", forces="balance")
    assert not StationConfig.from_scene(held_ball(), object="welded").balances
    with pytest.raises(cs.SceneError, match="at time_step = 0 integrators take hours"):
        StationConfig.from_scene(held_ball(), time_step=0.0)
