"""A scene's MultibodyPlant: its contact stiffness for all surfaces, its bodies, what is refused."""

import dataclasses
import math

import numpy as np
import pytest

pytest.importorskip("pydrake")

from conftest import SURFACES
from pydrake.geometry import Mesh, Role
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

import contact_system as cs
from drake_plant import AddScenePlant, BuildStation, StationConfig
from drake_plant.pressing import contact_depth

SPHERE = cs.Sphere(0.04)
DEPTH = 2e-4  # [m], where 10 kN/m carry 1 N


class World:
    """A scene's plant with a Context; with time_step 0 there are forces without a simulation."""

    def __init__(self, scene, **changes):
        self.scene = scene
        self.config = StationConfig(**{"object": "welded", "time_step": 0.0, **changes})
        builder = DiagramBuilder()
        self.parts = AddScenePlant(builder, scene, self.config)
        self.plant, self.diagram = self.parts.plant, builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)

    def place(self, body, X):
        self.plant.SetFreeBodyPose(self.context, body, X)

    def results(self):
        return self.plant.get_contact_results_output_port().Eval(self.context)

    def patches(self):
        """Force on the object (3,) and number of faces, by the finger's name."""
        found = {}
        for i in range(self.results().num_hydroelastic_contacts()):
            info = self.results().hydroelastic_contact_info(i)
            surface, inspector = info.contact_surface(), self.parts.scene_graph.model_inspector()
            bodies = [
                self.plant.GetBodyFromFrameId(inspector.GetFrameId(g)).name()
                for g in (surface.id_M(), surface.id_N())
            ]
            force = info.F_Ac_W().translational()
            sign = 1 if bodies[0] == "object" else -1
            (name,) = set(bodies) - {"object"}
            found[name] = (sign * force, surface.num_faces())
        return found

    def pressed(self, depth=DEPTH, count=30):
        """Fingers at times of the plan, pressed in by ``depth``: forces (count, n, 3), numbers of
        faces (count, n) and the object's normals there (count, n, 3)."""
        plan, scene = cs.plan(self.scene), self.scene
        t = np.random.default_rng(0).uniform(0, scene.duration, count)
        poses, points = plan.pose(t), plan.points(t)[:, :, 1]
        normals = scene.object.normal(*scene.object.coordinates(points))
        forces, faces = np.zeros(points.shape), np.zeros(points.shape[:2])
        for k in range(count):
            for X, n, body in zip(poses[k], normals[k], self.parts.finger_bodies):
                R = RotationMatrix.ProjectToRotationMatrix(X[:3, :3])
                self.place(body, RigidTransform(R, X[:3, 3] - depth * n))
            found = self.patches()
            for i, body in enumerate(self.parts.finger_bodies):
                forces[k, i], faces[k, i] = found[body.name()]
        return forces, faces, normals


def rolling(obj, finger=SPHERE, at=(1.0, 0.4), finger_at=(math.pi / 2, 0.0), length=0.3):
    """A scene with one finger that rolls so far, oblique to the object's axes."""
    contact = cs.Contact(finger, at, finger_at, finger_velocity=(0.6, 0.8))
    return cs.Scene(object=obj, contacts=[contact], profile=cs.Profile([length]), duration=1.0)


# --- how stiff contact is ----------------------------------------------------------------------


@pytest.mark.parametrize("name", SURFACES)
def test_a_finger_0_2_mm_deep_presses_with_1_newton_on_every_kind_of_object(name):
    surface, at = SURFACES[name]
    world = World(rolling(surface, cs.Sphere(0.02), at, length=0.01))
    forces, faces, normals = world.pressed(count=8)
    force = np.linalg.norm(forces, axis=-1)
    assert force.mean() == pytest.approx(1, rel=0.015) and force.std() < 0.025
    assert faces.mean() < 55  # a step takes time in proportion
    assert np.linalg.norm(forces / force[..., None] + normals, axis=-1).mean() < 4e-3
    lower, upper = (
        np.linalg.norm(world.pressed(factor * DEPTH, count=8)[0], axis=-1).mean()
        for factor in (0.95, 1.05)
    )
    assert (upper - lower) / (0.1 * DEPTH) == pytest.approx(1e4, rel=0.05)


@pytest.mark.parametrize(
    ("finger", "at"),
    [
        (cs.Ellipsoid(0.06, 0.05, 0.04), (0.3, 0.4)),
        (cs.Cylinder(0.04), (0.3, 0.0)),
        (cs.Torus(0.1, 0.04), (0.3, -0.2)),
        (
            cs.ImplicitSurface(
                "(x/r)**4 + (y/r)**4 + (z/r)**4 - 1", parameters={"r": 0.04}, size=0.04
            ),
            (1.05, 0.6),
        ),
    ],
    ids=["ellipsoid", "cylinder", "torus", "rounded cube"],
)
def test_every_kind_of_fingertip_presses_with_1_newton_where_it_is_0_2_mm_deep(finger, at):
    world = World(rolling(cs.Sphere(0.1), finger, finger_at=at, length=0.02))
    forces = np.linalg.norm(world.pressed(count=15)[0], axis=-1)
    # 6 %: the cube's curvature changes within a patch, which makes 4.7 % however fine its mesh is
    assert forces.mean() == pytest.approx(1, rel=0.06)


def test_the_depth_follows_from_the_stiffness_and_the_normal_force():
    changes = {"stiffness": 5e3, "normal_force": 2.0}
    world = World(rolling(cs.Sphere(0.05), cs.Sphere(0.03)), **changes)
    depth = contact_depth(world.config)
    assert depth == pytest.approx(8e-4)
    forces = np.linalg.norm(world.pressed(depth, count=15)[0], axis=-1)
    assert forces.mean() == pytest.approx(2, rel=0.02)
    point = StationConfig(contact_model="point", **changes)
    assert contact_depth(point) == pytest.approx(4e-4)


def test_a_plane_pushes_also_far_from_the_planned_curve_and_is_no_half_space_in_films():
    world = World(rolling(cs.Plane(), at=(0.0, 0.0)))
    inspector = world.parts.scene_graph.model_inspector()  # Meshcat shows no half spaces
    drawn = inspector.GetAllGeometryIds(Role.kIllustration)
    assert {type(inspector.GetShape(x)) for x in drawn} == {Mesh}
    world.place(world.parts.finger_bodies[0], RigidTransform([7.0, -3.0, 0.04 - DEPTH]))
    ((force, _),) = world.patches().values()
    assert force == pytest.approx([0, 0, -1], abs=0.02)


def test_point_contact_has_the_stiffness_of_the_scene():
    world = World(rolling(cs.Sphere(0.1)), contact_model="point")
    (finger,) = world.parts.finger_bodies
    world.place(finger, RigidTransform([0, 0, 0.14 - 1e-4]))
    force = world.results().point_pair_contact_info(0).contact_force()
    assert np.linalg.norm(force) == pytest.approx(1.0, rel=1e-9)


# --- what the plant is made of -----------------------------------------------------------------


def test_without_a_configuration_a_plant_is_that_of_the_scenes_drake_table():
    parts = AddScenePlant(DiagramBuilder(), cs.load_scene("D3"))
    assert parts.plant.time_step() == 2.5e-4
    turning = AddScenePlant(DiagramBuilder(), cs.load_scene("C1"))
    assert turning.plant.HasJointNamed("turning")


def test_d1_has_an_object_and_a_model_instance_for_every_finger():
    changes = {"finger_mass": 0.261, "object_mass": 4.18, "gravity": 9.81, "forces": "constant"}
    world = World(cs.load_scene("D1"), object="free", **changes)
    plant = world.plant
    assert plant.gravity_field().gravity_vector() == pytest.approx([0, 0, -9.81])
    names = ["object", "finger 1", "finger 2", "finger 3"]
    bodies = [world.parts.object_body, *world.parts.finger_bodies]
    assert [plant.GetModelInstanceName(b.model_instance()) for b in bodies] == names
    assert [b.default_mass() for b in bodies] == [4.18, 0.261, 0.261, 0.261]
    moments = bodies[1].default_spatial_inertia().CalcRotationalInertia().get_moments()
    assert moments == pytest.approx(0.4 * 0.261 * 0.04**2)


@pytest.mark.parametrize(
    "given",
    [
        ("", ""),
        ("left\n::a/b", ""),
        ("finger_1", ""),
        ("", "finger_0"),
        ("finger_1", "finger_1"),
        ("object", "world"),
    ],
)
def test_every_finger_has_a_name_of_its_own_whatever_contacts_are_called(given):
    places = ((1.0, 0.4), (2.0, -2.0))
    contacts = [cs.Contact(SPHERE, at, name=name) for at, name in zip(places, given)]
    scene = rolling(cs.Sphere(0.1)).replace(contacts=contacts)
    world = World(scene, contact_model="point")
    names = [body.name() for body in world.parts.finger_bodies]
    assert len({"object", *names}) == 3
    kept = [name for name, own in zip(given, names) if name == own]
    if given == ("", ""):
        assert names == ["finger_0", "finger_1"]
    assert [world.plant.GetModelInstanceByName(name) for name in names]
    assert set(kept) == set(given) - {"", "object"}
    for k, body in enumerate(world.parts.finger_bodies):  # fingers overlap, and do not collide
        world.place(body, RigidTransform([1.0, 0.0, 0.01 * k]))
    assert not world.results().num_point_pair_contacts()


def test_a_ring_has_the_inertia_of_a_torus():
    world = World(rolling(SPHERE, cs.Torus(0.05, 0.02), finger_at=(0.3, -0.2), length=0.02))
    (ring,) = world.parts.finger_bodies
    moments = ring.default_spatial_inertia().CalcRotationalInertia().get_moments() / 0.1
    axial = 0.05**2 + 0.75 * 0.02**2
    across = 0.5 * 0.05**2 + 0.625 * 0.02**2
    assert moments == pytest.approx([across, across, axial], rel=5e-3)


# --- what is refused ---------------------------------------------------------------------------


def parallel_cylinders(angle):
    scene = rolling(cs.Cylinder(0.1), cs.Cylinder(0.04), at=(0.3, 0.2), finger_at=(0.2, 0.0))
    return scene.replace(contacts=[dataclasses.replace(scene.contacts[0], angle=angle)])


@pytest.mark.parametrize(
    ("scene", "changes", "words"),
    [
        (
            rolling(cs.Ellipsoid(0.12, 0.1, 0.08)),
            {"contact_model": "point"},
            r"contact 0: contact_model = \"point\" is exact for a sphere on a sphere.*16 degrees",
        ),
        (rolling(cs.Sphere(0.1)), {"contact_model": "soft"}, "'soft' is unknown.*use one of"),
        (rolling(cs.Sphere(0.1)), {"stiffness": 0}, "stiffness = 0: give a finite number above 0"),
        (
            rolling(cs.Sphere(0.1)),
            {"stiffness": 1},
            r"stiffness = 1: contact 0 would be 2 m deep .* Sphere\(0.04\); give a stiffness",
        ),
        (
            rolling(cs.Sphere(0.1), cs.Torus(0.05, 0.002), finger_at=(0.3, -0.2), length=0.02),
            {"stiffness": 1e3},
            r"contact 0 would be 0.002 m deep .* Torus",
        ),
        (rolling(cs.Sphere(0.1)), {"object": "turning"}, r"the scene has no \[turning\]"),
        (rolling(cs.Plane(), at=(0, 0)), {"object": "free"}, "object: Plane.* give a closed one"),
        (rolling(cs.Sphere(0.2, inside=True)), {"object": "free"}, r"a solid .*\[drake\] object"),
        (rolling(cs.Sphere(0.1), cs.Plane(), finger_at=(0, 0)), {}, "a fingertip is a compliant"),
        (rolling(cs.Sphere(0.03, inside=True)), {}, "contact 0: finger and object overlap"),
        # rounding gives a least relative curvature of either sign
        *((parallel_cylinders(x), {}, "touch along a line .* turn the") for x in (0.0, math.pi)),
        (cs.load_scene("C1"), {"object": "turning"}, "needs a discrete plant"),
    ],
)
def test_what_cannot_be_simulated_is_refused_with_reason_and_remedy(scene, changes, words):
    with pytest.raises(cs.SceneError, match=words) as error:
        World(cs.Scene.replace(scene, name="mine"), **changes)
    assert str(error.value).startswith("scene 'mine', plant: ")


@pytest.mark.parametrize(
    ("key", "why"),
    [
        ("finger_edge", "contact 0: .* 0.007 m off .* 0.0002 m deep"),
        ("object_edge", "contact 0: .* 0.007 m off .* 0.0002 m deep"),
        ("time_step", "a finger of 0.003 kg"),
    ],
)
def test_an_edge_or_a_step_as_long_as_the_error_says_is_accepted(key, why):
    scene, light = rolling(cs.Sphere(0.1), length=0.02), {"finger_mass": 3e-3}
    with pytest.raises(cs.SceneError, match=f"{key} = 0.02: {why}.* give at most") as error:
        BuildStation(scene, StationConfig(**{key: 0.02}, **light))
    most = float(str(error.value).split("at most ")[1].split()[0])
    BuildStation(scene, StationConfig(**{key: most}, **light))


@pytest.mark.parametrize("name", ["plant", "scene_graph", "turning"])
def test_a_name_that_a_system_of_the_diagram_has_already_is_refused(name):
    """Drake itself would end the process."""
    scene, builder = cs.load_scene("C1"), DiagramBuilder()
    config = StationConfig(contact_model="point", object="turning")
    taken = builder.AddNamedSystem(name, ConstantVectorSource([0.0]))
    with pytest.raises(cs.SceneError, match=f"'C1', plant: the builder has a system named '{name}"):
        AddScenePlant(builder, scene, config)
    taken.set_name("mine")
    AddScenePlant(builder, scene, config)
    assert builder.Build().num_continuous_states() == 0
