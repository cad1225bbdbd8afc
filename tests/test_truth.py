"""Drake's balls move as closed forms and books say; the truth bench's closed forms are exact."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks import truth_exact

SETUPS = truth_exact.setups()


@pytest.mark.parametrize("name", SETUPS)
def test_the_benchs_exact_motion_solves_newtons_and_eulers_equations(name):
    assert truth_exact.proof(SETUPS[name]) < 1e-12


def drake(name: str, model: str, step: float) -> truth_exact.Ended:
    pytest.importorskip("pydrake")
    from benchmarks import truth_drake

    return truth_drake.run(name, truth_drake.Method(model, model), step)


@pytest.mark.parametrize(("model", "step"), [("point", 1e-3), ("hydroelastic", 2.5e-4)])
def test_a_ball_circles_on_a_turntable_in_7_2_of_the_tables_period(model, step):
    run = drake("turntable", model, step)
    (vx, vy, _), (ex, ey, _) = run.v, run.exact.v[0]
    late = math.atan2(vx * ey - vy * ex, vx * ex + vy * ey) / (2 * math.pi)  # of a turn
    assert abs(late) < 2e-3
    assert run.setup.end == pytest.approx(3.5 * 2 * np.pi / truth_exact.TABLE, rel=1e-2)


@pytest.mark.parametrize("name", ["slope, rolling", "slope, sliding", "slip that dies"])
def test_a_ball_on_a_slope_has_the_exact_speed_whether_it_rolls_or_slides(name):
    run = drake(name, "point", 1e-3)
    assert run.v[0] == pytest.approx(run.exact.v[0, 0], rel=1e-3)


@pytest.mark.parametrize("model", ["point", "hydroelastic"])
def test_a_ball_between_plates_goes_half_as_fast(model):
    """One plate is fixed; the other slides over the ball and is so heavy that nothing slows it."""
    pytest.importorskip("pydrake")
    from pydrake import geometry as shapes
    from pydrake.math import RigidTransform
    from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
    from pydrake.multibody.tree import PrismaticJoint, SpatialInertia
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    builder, soft, rigid = (DiagramBuilder(), *(shapes.ProximityProperties() for _ in range(2)))
    plant, _ = AddMultibodyPlant(MultibodyPlantConfig(contact_model=model), builder)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    for made in (soft, rigid):
        grip = CoulombFriction(0.5, 0.5)
        shapes.AddContactMaterial(point_stiffness=2e4, friction=grip, properties=made)
    shapes.AddCompliantHydroelasticProperties(2e-3, 1e7, soft)
    shapes.AddRigidHydroelasticProperties(1.0, rigid)
    ball = plant.AddRigidBody("ball", SpatialInertia.SolidSphereWithMass(0.1, 0.04))
    plate = plant.AddRigidBody("plate", SpatialInertia.SolidSphereWithMass(1e5, 1.0))
    frames = plant.world_frame(), plate.body_frame()
    joint = plant.AddJoint(PrismaticJoint("slide", *frames, [1.0, 0.0, 0.0]))
    plant.RegisterCollisionGeometry(ball, RigidTransform(), shapes.Sphere(0.04), "ball", soft)
    for body, z in ((plant.world_body(), -0.0898), (plate, 0.0898)):
        box, pose = shapes.Box(2.0, 2.0, 0.1), RigidTransform(np.array([0.0, 0.0, z]))
        plant.RegisterCollisionGeometry(body, pose, box, "plate", rigid)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    joint.set_translation_rate(context, 0.1)
    simulator.AdvanceTo(0.1)
    speed = ball.EvalSpatialVelocityInWorld(context).translational()[0]
    assert speed == pytest.approx(0.05, abs=1e-5)
