"""Balls whose motion others know, on the plants of drake_plant: rolling, sliding, a turntable.

A ball is the finger of a scene with nobody to drive it, the object is the plane under it. It rolls
on the radius that contact leaves it: less by the depth where it alone gives way (hydroelastic), by
half of it where both do (point).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    ProximityProperties,
)
from pydrake.geometry import Sphere as SphereShape
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import PrismaticJoint, RigidBody, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder

import contact_system as cs
from drake_plant import AddScenePlant, StationConfig

from .report import Bar, Sections

MODELS = ("point", "hydroelastic")
RADIUS, MASS, GRAVITY = 0.04, 0.1, 9.81
TABLE = 15.0
"""rad/s, of the turntable."""


class Rolled(NamedTuple):
    """What became of a ball: t (m,), velocity (m, 3), and the radius that it rolled on, m."""

    t: np.ndarray
    velocity: np.ndarray
    radius: float


def roll(
    model: str,
    step: float,
    duration: float,
    velocity: tuple[float, float] = (0.0, 0.0),
    slope: float = 0.0,
    friction: float = 0.5,
    table: float = 0.0,
) -> Rolled:
    """A ball that starts to roll on a plane that turns, on a circle around its axis, or slopes."""
    start = cs.Contact(cs.Sphere(RADIUS), object_at=(0.0, 0.0))
    scene = cs.Scene(
        object=cs.Plane(),
        contacts=[start],
        profile=cs.Profile([0.1]),
        duration=1.0,
        turning=cs.Turning((0.0, 0.0, 1.0), [0.0, table]),
    )
    pressed = MASS * GRAVITY * math.cos(slope)
    config = StationConfig(
        time_step=step,
        contact_model=model,
        object="turning" if table else "welded",
        finger_mass=MASS,
        normal_force=pressed,
        gravity=GRAVITY,
        friction=friction,
    )
    builder = DiagramBuilder()
    parts = AddScenePlant(builder, scene, config)
    plant, ball = parts.plant, parts.finger_bodies[0]
    down = np.array([math.sin(slope), 0.0, -math.cos(slope)])
    plant.mutable_gravity_field().set_gravity_vector(GRAVITY * down)
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    depth = pressed / config.stiffness * (1 if model == "point" else 2)
    radius = RADIUS - depth * (0.5 if model == "point" else 1.0)
    v = np.array([*velocity, 0.0])
    circle, up = np.zeros(3), np.array([0.0, 0.0, 1.0])
    if table:
        circle = 3.5 / table * np.cross(v, up)
    w = np.cross(up, v - table * np.cross(up, circle)) / radius + table * up  # no drilling
    at = RigidTransform(circle + [0.0, 0.0, RADIUS - depth])
    plant.SetFreeBodyPose(context, ball, at)
    plant.SetFreeBodySpatialVelocity(context=context, body=ball, V_JpJc=SpatialVelocity(w, v))
    return _watched(simulator, plant, context, ball, duration, radius)


def between_plates(model: str, step: float, duration: float = 0.5) -> float:
    """A ball at rest, held by a fixed plate and one that slides above it: its speed over theirs."""
    builder, depth = DiagramBuilder(), 2e-4
    config = MultibodyPlantConfig(time_step=step, contact_model=model)
    plant, _ = AddMultibodyPlant(config, builder)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    inertia = SpatialInertia.SolidSphereWithMass(MASS, RADIUS)
    ball = plant.AddRigidBody("ball", inertia)
    plate = plant.AddRigidBody("plate", SpatialInertia.SolidSphereWithMass(1e6 * MASS, 1.0))
    frames = plant.world_frame(), plate.body_frame()
    joint = plant.AddJoint(PrismaticJoint("slide", *frames, [1.0, 0.0, 0.0]))
    at = RigidTransform()
    soft, rigid = _material(), _material()
    AddCompliantHydroelasticProperties(2e-3, 1e7, soft)
    AddRigidHydroelasticProperties(1.0, rigid)
    plant.RegisterCollisionGeometry(ball, at, SphereShape(RADIUS), "ball", soft)
    for body, z, name in ((plant.world_body(), -1.0, "below"), (plate, 1.0, "above")):
        far = z * (RADIUS - depth + 0.05)
        pose = RigidTransform(np.array([0.0, 0.0, far]))
        plant.RegisterCollisionGeometry(body, pose, Box(2.0, 2.0, 0.1), name, rigid)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    joint.set_translation_rate(context, 0.1)
    simulator.AdvanceTo(duration)
    return float(ball.EvalSpatialVelocityInWorld(context).translational()[0] / 0.1)


def _material() -> ProximityProperties:
    made = ProximityProperties()
    AddContactMaterial(point_stiffness=2e4, friction=CoulombFriction(0.5, 0.5), properties=made)
    made.AddProperty("material", "relaxation_time", 0.0)
    return made


def _watched(
    simulator: Simulator,
    plant: MultibodyPlant,
    context: Context,
    ball: RigidBody,
    duration: float,
    radius: float,
) -> Rolled:
    t, seen = np.linspace(0.0, duration, 101), []
    for now in t:
        simulator.AdvanceTo(now)
        seen.append(ball.EvalSpatialVelocityInWorld(context).translational())
    return Rolled(t, np.array(seen), radius)


# --- what is known --------------------------------------------------------------------------------


def turntable(model: str, step: float, part: float = 1.0) -> tuple[float, float, float]:
    """Weltner's period of a ball's circle over the table's: found, its law's, and speed kept.

    1 + 5/2 (r/a)^2 for a homogeneous ball of radius a that rolls on r. part : of an orbit.
    """
    rolled = roll(model, step, part * 7 * math.pi / TABLE, velocity=(0.0, 0.3), table=TABLE)
    t, v = rolled.t[5:], rolled.velocity[5:]
    turned = np.unwrap(np.arctan2(v[:, 1], v[:, 0]))
    found = TABLE * (t[-1] - t[0]) / abs(turned[-1] - turned[0])
    speed = float(np.hypot(*rolled.velocity[-1, :2])) / 0.3
    return found, 1 + 2.5 * (rolled.radius / RADIUS) ** 2, speed


def resistance(model: str, step: float) -> float:
    """The share of its speed that a ball on a level plane loses in a second."""
    rolled = roll(model, step, 0.3, velocity=(0.5, 0.0))
    (t0, v0), (t1, v1) = ((rolled.t[k], rolled.velocity[k, 0]) for k in (10, -1))
    return float(math.log(v0 / v1) / (t1 - t0))


def down(model: str, step: float, slope: float, friction: float) -> tuple[float, float]:
    """Acceleration down a slope, found and its law's: of rolling, or sliding where that is more."""
    rolled = roll(model, step, 0.3, slope=slope, friction=friction)
    found = float(np.polyfit(rolled.t[10:], rolled.velocity[10:, 0], 1)[0])
    along, across = math.sin(slope), math.cos(slope)
    rolling = along / (1 + 0.4 * (RADIUS / rolled.radius) ** 2)
    return found, GRAVITY * max(rolling, along - friction * across)


# --- bars -----------------------------------------------------------------------------------------


def weltner(full: bool) -> Iterator[Bar]:
    """A ball on a turntable, against the law with the radius that it rolls on."""
    for model, step in (("point", 1e-3), ("hydroelastic", 1e-3), ("hydroelastic", 2.5e-4)):
        found, law, speed = turntable(model, step)
        note = f"{found:.4f}, law {law:.4f}; speed {speed - 1:+.1%} an orbit"
        limit = 2e-3 if (model, step) != ("hydroelastic", 1e-3) else None
        what = f"turntable, {model}, {1e3 * step:g} ms: period off by"
        yield Bar(what, limit, abs(found / law - 1), note=note)


def plates(full: bool) -> Iterator[Bar]:
    """A ball between a fixed plate and one that slides goes half as fast."""
    for model in MODELS:
        what = f"between plates, {model}: off half the plate's speed by"
        yield Bar(what, 1e-3, abs(between_plates(model, 1e-3) - 0.5))


def slopes(full: bool) -> Iterator[Bar]:
    """Rolling down 0.2 rad at mu = 0.5, sliding down 0.6 rad at mu = 0.1."""
    for (slope, friction), model in itertools.product(((0.2, 0.5), (0.6, 0.1)), MODELS):
        step = 1e-3 if model == "point" else 2.5e-4
        found, law = down(model, step, slope, friction)
        kind = "sliding" if friction < 0.5 else "rolling"
        limit = 0.012 if (model, kind) == ("hydroelastic", "rolling") else 1e-3
        what = f"{kind} down {slope:g} rad, {model}, {1e3 * step:g} ms: off by"
        yield Bar(what, limit, abs(found / law - 1), note=f"{found:.4f}, law {law:.4f} m/s^2")


def level(full: bool) -> Iterator[Bar]:
    """What rolling on a level plane loses: Drake's hydroelastic patches resist with the step."""
    yield Bar("level, point, 1 ms: speed lost in a second", 1e-6, abs(resistance("point", 1e-3)))
    for step in (1e-3, 5e-4, 2.5e-4):
        lost = resistance("hydroelastic", step)
        note = f"0.86 g h/(1.4 a) is {0.86 * GRAVITY * step / (1.4 * RADIUS):.4f}"
        what = f"level, hydroelastic, {1e3 * step:g} ms: speed lost in a second"
        yield Bar(what, None, lost, note=note)


SECTIONS: Sections = {"weltner": weltner, "plates": plates, "slopes": slopes, "level": level}
