"""ContactMonitor in a small plant of spheres, against the motion that Drake gives the bodies."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.formulas import slip_of_states

pytest.importorskip("pydrake")

from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

import contact_system as cs
from drake_plant import ScenePlant, StationConfig
from drake_plant.contact_monitor import ContactMonitor

R1, R2, MASS, STEP, FRICTION = 0.04, 0.1, 0.3, 1e-3, 0.5
STIFFNESS = 1e4
DEPTH = {"point": 1e-4, "hydroelastic": 1e-3}  # Drake's own meshes are coarse
OUTPUTS = ("state", "slip", "normal_force", "tangential_force", "contact_point")


class Setup:
    """Two fingers and an object, and a monitor of their contacts.

    stiffer : how much the object is than a finger, in point contact
    moduli : of object and finger, Pa; None: rigid
    pads : where a finger has spheres, m along the first axis of E2
    """

    def __init__(
        self,
        model: str,
        fingers_first: bool = False,
        step: float = STEP,
        friction: float = FRICTION,
        sampled: bool = True,
        stiffer: float = 1.0,
        moduli: tuple[float | None, float | None] = (None, 1e6),
        pads: tuple[float, ...] = (0.0,),
    ):
        self.pads = pads
        self.model, self.step, self.friction = model, step, friction
        self.sampled, self.stiffer, self.moduli = sampled, stiffer, moduli
        self.scene = cs.Scene(
            object=cs.Sphere(R2),
            contacts=[cs.Contact(cs.Sphere(R1), (1.0, 0.3)), cs.Contact(cs.Sphere(R1), (2.0, -2))],
            profile=cs.Profile([1.0]),
            duration=1.0,
        )
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=step, contact_model=model)
        if step:
            config.discrete_contact_approximation = "sap"
            config.use_sampled_output_ports = sampled
        self.plant, scene_graph = AddMultibodyPlant(config, builder)
        self.plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
        names = ["object", "finger 0", "finger 1"]
        bodies = {name: self._body(name) for name in (names[::-1] if fingers_first else names)}
        self.plant.Finalize()
        self.object, *self.fingers = self.bodies = [bodies[name] for name in names]
        parts = ScenePlant(
            self.scene, StationConfig(), self.plant, scene_graph, self.object, self.fingers
        )
        self.monitor = builder.AddSystem(ContactMonitor(self.scene, parts))
        for port in ("contact_results", "body_poses", "body_spatial_velocities"):
            builder.Connect(self.plant.GetOutputPort(port), self.monitor.GetInputPort(port))
        self.diagram = builder.Build()

    def _body(self, name: str):
        radius = R2 if name == "object" else R1
        inertia = SpatialInertia.SolidSphereWithMass(MASS, radius)
        body = self.plant.AddRigidBody(name, self.plant.AddModelInstance(name), inertia)
        material = ProximityProperties()
        AddContactMaterial(
            material,
            point_stiffness=2 * STIFFNESS * (self.stiffer if name == "object" else 1.0),
            friction=CoulombFriction(self.friction, self.friction),
        )
        if self.step:
            material.AddProperty("material", "relaxation_time", 0.0)
        modulus = self.moduli[name != "object"]
        if modulus is None:
            AddRigidHydroelasticProperties(0.004, material)
        else:
            AddCompliantHydroelasticProperties(0.004, modulus, material)
        for k, x in enumerate((0.0,) if name == "object" else self.pads):
            label, at = f"{name} shape {k}", RigidTransform([x, 0.0, 0.0])
            self.plant.RegisterCollisionGeometry(body, at, Sphere(radius), label, material)
        return body

    def run(self, sliding: tuple[float, float] = (0, 0), depth: float | None = None) -> None:
        """One step from fingers that touch where the scene says, all bodies moving anyhow.

        The fingers' material points slide relative to the object's by `sliding` in E2. Keeps the
        poses X_W at the beginning of the step and the velocities before and after, V0_W and V_W.
        """
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)
        rng = np.random.default_rng(4)
        depth = DEPTH[self.model] if depth is None else depth
        X_WO = RigidTransform(_any_rotation(rng), [0.3, -0.2, 0.1])
        V_WO = SpatialVelocity(rng.normal(size=6))
        self._set(self.object, X_WO, V_WO)
        self.frames = []
        for body, contact in zip(self.fingers, self.scene.contacts):
            frame = self.scene.object.frame(*contact.object_at)
            centre = (R1 + R2 - depth) * frame[:, 2]
            omega = 20.0 * (frame[:, :2] @ rng.normal(size=2))
            arm = self.height(depth) * frame[:, 2] - centre
            velocity = frame[:, :2] @ sliding - np.cross(omega, arm)
            V_OF = SpatialVelocity(X_WO.rotation() @ omega, X_WO.rotation() @ velocity)
            V_WF = V_WO.ComposeWithMovingFrameVelocity(X_WO.rotation() @ centre, V_OF)
            self.frames.append(X_WO.rotation().matrix() @ frame)
            R_WF = _any_rotation(rng) if self.pads == (0.0,) else RotationMatrix(self.frames[-1])
            self._set(body, RigidTransform(R_WF, X_WO @ centre), V_WF)
        self._advance()

    def height(self, depth: float) -> float:
        """Where friction acts: at the object's surface; in point contact at half of the depth."""
        return R2 - (depth / 2 if self.model == "point" and depth > 0 else 0.0)

    def _advance(self) -> None:
        self.X_W = [body.EvalPoseInWorld(self.context) for body in self.bodies]
        self.V0_W = [body.EvalSpatialVelocityInWorld(self.context) for body in self.bodies]
        if self.step and self.sampled:
            Simulator(self.diagram, self.root).AdvanceTo(self.step)
        self.V_W = [body.EvalSpatialVelocityInWorld(self.context) for body in self.bodies]

    def _set(self, body, X: RigidTransform, V: SpatialVelocity) -> None:
        self.plant.SetFreeBodyPose(self.context, body, X)
        self.plant.SetFreeBodySpatialVelocity(context=self.context, body=body, V_JpJc=V)

    def read(self, name: str) -> np.ndarray:
        context = self.monitor.GetMyContextFromRoot(self.root)
        return self.monitor.GetOutputPort(name).Eval(context).reshape(2, -1)

    def velocities(self, depth: float) -> np.ndarray:
        """Of each finger's material point relative to the object's, in E2 and along the normal, by
        hand."""
        found = []
        for k, frame in enumerate(self.frames, 1):
            point = self.X_W[0].translation() + self.height(depth) * frame[:, 2]
            v_O, v_F = (
                self.V_W[b].translational()
                + np.cross(self.V_W[b].rotational(), point - self.X_W[b].translation())
                for b in (0, k)
            )
            found.append(frame.T @ (v_F - v_O))
        return np.array(found)

    def pushes(self) -> np.ndarray:
        """Force on each finger in E2 and along the normal, from the momentum of the step."""
        gained = [after - before for after, before in zip(self.V_W, self.V0_W)]
        force = [MASS / self.step * V.translational() for V in gained[1:]]
        return np.array([frame.T @ f for frame, f in zip(self.frames, force)])


def _any_rotation(rng: np.random.Generator) -> RotationMatrix:
    return RotationMatrix(RollPitchYaw(*rng.uniform(-1.4, 1.4, 3)))


@pytest.fixture(scope="module", params=["point", "hydroelastic"])
def setup(request) -> Setup:
    return Setup(request.param)


@pytest.mark.parametrize("sliding", [(0.0, 0.0), (0.05, 0.0), (-0.01, 0.3)])
def test_slip_is_minus_the_velocity_of_the_fingers_material_point(setup, sliding):
    setup.run(sliding)
    expected = -setup.velocities(DEPTH[setup.model])[:, :2]
    assert setup.read("slip") == pytest.approx(expected, abs=1e-6)  # 1e-5 of fingers at 0.8 m/s
    assert np.sign(setup.read("slip")[0, 1]) == -np.sign(sliding[1]) or sliding[1] == 0


@pytest.mark.parametrize("fingers_first", [True, False])
@pytest.mark.parametrize(("stiffer", "sliding"), [(1.0, (0.0, 0.0)), (100.0, (0.05, 0.1))])
def test_slip_is_the_one_that_drakes_point_contact_works_with(sliding, stiffer, fingers_first):
    setup = Setup("point", fingers_first, stiffer=stiffer)
    setup.run(sliding)
    results = setup.plant.GetOutputPort("contact_results").Eval(setup.context)
    speeds = [results.point_pair_contact_info(k).slip_speed() for k in range(2)]
    speeds = speeds[::-1] if fingers_first else speeds
    assert np.linalg.norm(setup.read("slip"), axis=1) == pytest.approx(speeds, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("step", [0.0, STEP])
@pytest.mark.parametrize("model", ["point", "hydroelastic"])
def test_slip_is_that_of_now_in_a_plant_that_reports_what_comes(model, step):
    setup = Setup(model, step=step, sampled=False)
    setup.run((0.05, -0.02))
    assert setup.read("slip") == pytest.approx(np.array([[-0.05, 0.02]] * 2), abs=1e-12)
    assert (setup.read("normal_force") > 0.5).all()


def test_forces_are_those_that_push_the_fingers(setup):
    setup.run((0.2, -0.1))
    normal, tangential = setup.read("normal_force"), setup.read("tangential_force")
    pushes = setup.pushes()  # in E2 at the middle of the contact; the patch has its normal nearby
    assert normal[:, 0] == pytest.approx(pushes[:, 2], rel=0.02)
    assert tangential == pytest.approx(pushes[:, :2], abs=0.02 * pushes[0, 2])
    assert (normal > 0.5).all()


def test_sliding_friction_is_mu_times_the_normal_force_and_drags_along_slip(setup):
    setup.run((0.2, -0.1))
    normal, friction = setup.read("normal_force"), setup.read("tangential_force")
    size, slip = np.linalg.norm(friction, axis=1), setup.read("slip")
    assert size == pytest.approx(FRICTION * normal[:, 0], rel=0.01)
    along = slip / np.linalg.norm(slip, axis=1)[:, None]
    assert (friction * along).sum(1) == pytest.approx(size, rel=1e-3)


PATCHES = [((1e6, None), False), ((1e6, 1e5), True), ((1e5, 1e6), False)]
"""Moduli of object and finger, and whether Drake has the fingers first."""


@pytest.mark.parametrize(("moduli", "fingers_first"), PATCHES)
def test_friction_drags_along_slip_on_a_compliant_object_too(moduli, fingers_first):
    """Where the patch is: at the object's surface slip would be up to 0.16 rad off."""
    setup = Setup("hydroelastic", fingers_first, moduli=moduli)
    setup.run((0.2, 0.0))
    friction, slip = setup.read("tangential_force"), setup.read("slip")
    assert (np.linalg.norm(friction, axis=1) > 0.02).all()
    angles = [np.arctan2(*v.T[::-1]) for v in (friction, slip)]
    assert np.sin(angles[0] - angles[1]) == pytest.approx([0.0, 0.0], abs=0.03)


@pytest.mark.parametrize(("moduli", "fingers_first"), [*PATCHES, ((None, 1e6), False)])
def test_without_friction_there_is_no_tangential_force_on_a_patch_however_it_bends(
    moduli, fingers_first
):
    setup = Setup("hydroelastic", fingers_first, friction=0.0, moduli=moduli)
    setup.run()
    friction, normal = setup.read("tangential_force"), setup.read("normal_force")
    assert np.abs(friction / normal).max() < 5e-3


@pytest.mark.parametrize("pads", [(0.008, -0.002), (0.009, 0.001, -0.002)])
def test_forces_of_several_points_are_those_of_their_sum_at_its_place(pads):
    setup = Setup("point", friction=0.0, pads=pads)
    setup.run(depth=4e-4)
    pushes, normal = setup.pushes(), setup.read("normal_force")[:, 0]
    # without friction each passes through the object's middle, and so does the sum
    assert normal == pytest.approx(np.linalg.norm(pushes, axis=1), rel=1e-3)
    assert (np.abs(pushes[:, 0]) > 5e-3 * pushes[:, 2]).all()  # it is not at the middle
    assert np.abs(setup.read("tangential_force")).max() < 1e-3


def test_state_and_contact_point_are_those_of_the_bodies_poses_now(setup):
    setup.run((0.03, -0.02))
    obj, pose, twist = setup.object.body_frame(), [], []
    for F in (body.body_frame() for body in setup.fingers):
        pose.append(F.CalcPose(setup.context, obj).GetAsMatrix4())
        twist.append(F.CalcSpatialVelocity(setup.context, obj, obj).get_coeffs())
    centres = np.array(pose)[:, :3, 3]
    nearest = R2 * centres / np.linalg.norm(centres, axis=1)[:, None]
    assert setup.read("contact_point") == pytest.approx(nearest, abs=1e-8)
    state = setup.read("state")
    expected = cs.measured_states(setup.scene, np.array(pose), np.array(twist), nearest)
    assert state[:, [0, 1, 4, 5, 8]] == pytest.approx(expected[:, [0, 1, 4, 5, 8]], abs=1e-6)
    assert state == pytest.approx(expected, rel=2e-2)  # which has the velocities' slip at the end
    assert slip_of_states(setup.scene, state[None])[0] == pytest.approx(
        setup.read("slip"), abs=1e-12
    )


def test_without_contact_there_is_no_force_and_slip_is_that_of_the_nearest_points(setup):
    setup.run((0.03, -0.02), depth=-5e-3)
    assert not setup.read("normal_force").any() and not setup.read("tangential_force").any()
    assert setup.read("slip") == pytest.approx(-np.array([[0.03, -0.02]] * 2), abs=1e-6)
    assert np.linalg.norm(setup.read("contact_point"), axis=1) == pytest.approx(R2, abs=1e-12)


def test_what_needs_a_contact_frame_is_nan_at_a_pole_and_other_contacts_are_measured(setup):
    setup.run()
    for body, z in ((setup.object, 0.0), (setup.fingers[0], R1 + R2 - DEPTH[setup.model])):
        setup._set(body, RigidTransform([0.0, 0.0, z]), SpatialVelocity.Zero())
    for name in OUTPUTS:
        assert np.isfinite(setup.read(name)[1]).all()
    assert not np.isfinite(setup.read("state")[0]).all()
    assert setup.read("contact_point")[0] == pytest.approx([0, 0, R2], abs=1e-12)
