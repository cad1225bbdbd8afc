"""ContactMonitor in a plant of Drake's own spheres, against forces and motions of the bodies."""

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
    """A plant of an object and two fingers, and a monitor of their contacts.

    stiffer : the object's stiffness over a finger's, in point contact
    moduli : of object and finger, Pa; None: rigid
    pads : where a finger's collision spheres are, m along the first axis of E2
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
        """One step from where the scene's contacts are; bodies have random velocities.

        The fingers' material points slide relative to the object's by `sliding` in E2, m/s. Keeps
        poses X_W at the beginning of the step and velocities before and after it, V0_W and V_W.
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
        """Of fingers' material points relative to the object, in E2 and along the normal."""
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

    def forces(self) -> np.ndarray:
        """Force on each finger, from its gain of momentum, in E2 and along the normal."""
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
    assert setup.read("slip") == pytest.approx(expected, abs=1e-6)  # of 0.8 m/s
    assert np.sign(setup.read("slip")[0, 1]) == -np.sign(sliding[1]) or sliding[1] == 0


@pytest.mark.parametrize("fingers_first", [True, False])
@pytest.mark.parametrize(("stiffer", "sliding"), [(1.0, (0.0, 0.0)), (100.0, (0.05, 0.1))])
def test_slip_has_the_speed_that_drakes_point_contact_reports(sliding, stiffer, fingers_first):
    setup = Setup("point", fingers_first, stiffer=stiffer)
    setup.run(sliding)
    results = setup.plant.GetOutputPort("contact_results").Eval(setup.context)
    speeds = [results.point_pair_contact_info(k).slip_speed() for k in range(2)]
    speeds = speeds[::-1] if fingers_first else speeds
    assert np.linalg.norm(setup.read("slip"), axis=1) == pytest.approx(speeds, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("step", [0.0, STEP])
@pytest.mark.parametrize("model", ["point", "hydroelastic"])
def test_slip_is_that_of_the_present_velocities_without_sampled_output_ports(model, step):
    setup = Setup(model, step=step, sampled=False)
    setup.run((0.05, -0.02))
    assert setup.read("slip") == pytest.approx(np.array([[-0.05, 0.02]] * 2), abs=1e-12)
    assert (setup.read("normal_force") > 0.5).all()


def test_forces_are_those_that_accelerate_the_fingers(setup):
    setup.run((0.2, -0.1))
    normal, tangential = setup.read("normal_force"), setup.read("tangential_force")
    forces = setup.forces()
    # 2 %: in E2 where the scene has the contact, while the patch's normal is slightly another one
    assert normal[:, 0] == pytest.approx(forces[:, 2], rel=0.02)
    assert tangential == pytest.approx(forces[:, :2], abs=0.02 * forces[0, 2])
    assert (normal > 0.5).all()


def test_sliding_friction_is_mu_times_the_normal_force_along_slip(setup):
    setup.run((0.2, -0.1))
    normal, friction = setup.read("normal_force"), setup.read("tangential_force")
    size, slip = np.linalg.norm(friction, axis=1), setup.read("slip")
    assert size == pytest.approx(FRICTION * normal[:, 0], rel=0.01)
    along = slip / np.linalg.norm(slip, axis=1)[:, None]
    assert (friction * along).sum(1) == pytest.approx(size, rel=1e-3)


PATCHES = [((1e6, None), False), ((1e6, 1e5), True), ((1e5, 1e6), False)]
"""Moduli of object and finger, and whether Drake has the fingers first."""


@pytest.mark.parametrize(("moduli", "fingers_first"), PATCHES)
def test_friction_is_along_slip_on_a_compliant_object_too(moduli, fingers_first):
    """Slip is that at the patch; at the object's surface it would be up to 0.16 rad off."""
    setup = Setup("hydroelastic", fingers_first, moduli=moduli)
    setup.run((0.2, 0.0))
    friction, slip = setup.read("tangential_force"), setup.read("slip")
    assert (np.linalg.norm(friction, axis=1) > 0.02).all()
    angles = [np.arctan2(*v.T[::-1]) for v in (friction, slip)]
    assert np.sin(angles[0] - angles[1]) == pytest.approx([0.0, 0.0], abs=0.03)


@pytest.mark.parametrize(("moduli", "fingers_first"), [*PATCHES, ((None, 1e6), False)])
def test_without_friction_a_curved_patch_has_no_tangential_force(moduli, fingers_first):
    setup = Setup("hydroelastic", fingers_first, friction=0.0, moduli=moduli)
    setup.run()
    friction, normal = setup.read("tangential_force"), setup.read("normal_force")
    assert np.abs(friction / normal).max() < 5e-3


@pytest.mark.parametrize("pads", [(0.008, -0.002), (0.009, 0.001, -0.002)])
def test_the_force_of_a_finger_with_several_contact_points_is_their_sum(pads):
    setup = Setup("point", friction=0.0, pads=pads)
    setup.run(depth=4e-4)
    forces, normal = setup.forces(), setup.read("normal_force")[:, 0]
    # without friction every force points to the object's centre, and so does their sum
    assert normal == pytest.approx(np.linalg.norm(forces, axis=1), rel=1e-3)
    assert (np.abs(forces[:, 0]) > 5e-3 * forces[:, 2]).all()  # not where the scene's contact is
    assert np.abs(setup.read("tangential_force")).max() < 1e-3


def test_state_and_contact_point_are_measured_from_the_bodies_present_poses(setup):
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
    # 2 %: `expected` is of velocities at the end of the step, rates hold the slip within it
    assert state == pytest.approx(expected, rel=2e-2)
    assert slip_of_states(setup.scene, state[None])[0] == pytest.approx(
        setup.read("slip"), abs=1e-12
    )


def test_without_contact_there_is_no_force_and_slip_is_that_of_the_nearest_points(setup):
    setup.run((0.03, -0.02), depth=-5e-3)
    assert not setup.read("normal_force").any() and not setup.read("tangential_force").any()
    assert setup.read("slip") == pytest.approx(-np.array([[0.03, -0.02]] * 2), abs=1e-6)
    assert np.linalg.norm(setup.read("contact_point"), axis=1) == pytest.approx(R2, abs=1e-12)


def test_at_a_pole_the_state_is_nan_and_the_other_contact_is_measured(setup):
    setup.run()
    for body, z in ((setup.object, 0.0), (setup.fingers[0], R1 + R2 - DEPTH[setup.model])):
        setup._set(body, RigidTransform([0.0, 0.0, z]), SpatialVelocity.Zero())
    for name in OUTPUTS:
        assert np.isfinite(setup.read(name)[1]).all()
    assert not np.isfinite(setup.read("state")[0]).all()
    assert setup.read("contact_point")[0] == pytest.approx([0, 0, R2], abs=1e-12)
