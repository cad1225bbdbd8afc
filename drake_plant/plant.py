"""A scene as a MultibodyPlant: the object, and one free fingertip for each contact."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.multibody.tree import PdControllerGains, RevoluteJoint, RigidBody
from pydrake.polynomial import Polynomial as DrakePolynomial
from pydrake.systems.framework import DiagramBuilder, InputPort, LeafSystem
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from contact_system import Cylinder, Plane, Scene, SceneError, Sphere, Torus, Turning
from contact_system.checks import Array, naming, of_kind
from contact_system.plots.style import BODY, colour_of

from .bodies import add_body, check_edges
from .config import StationConfig, checked
from .drake_meshes import rgba
from .hand_kinematics import add_hand
from .planner_base import FOREVER
from .pressing import Touch, check_depth, resting, touches_of

TURNING_GAIN = 1e8  # N m/rad
MOTIONS = "body_poses", "body_spatial_velocities"  # ports of plants
OPACITY = 0.6  # of fingers, and of an object around them: contacts are seen through them


def declare_plant_inputs(system: LeafSystem, plant: MultibodyPlant, *names: str) -> list[InputPort]:
    """Input ports of a system, for the plant's output ports of the same names."""
    return [
        system.DeclareAbstractInputPort(name, plant.GetOutputPort(name).Allocate())
        for name in names
    ]


def gravity_on(plant: MultibodyPlant, body: RigidBody) -> Array:
    """Gravity on a body, (3,), m/s^2, in the world: 0 where it is disabled for the body's model."""
    heavy = plant.is_gravity_enabled(body.model_instance())
    return float(heavy) * plant.gravity_field().gravity_vector()


@dataclass(frozen=True)
class ScenePlant:
    """A scene's plant in a DiagramBuilder: that of :func:`AddScenePlant`, or one of your own.

    The frames of the bodies are those of their surfaces.

    Attributes
    ----------
    scene : Scene
    config : StationConfig
        The plant's settings. Also with a plant of your own the driver reads the normal force and
        gains here, the monitor the friction coefficient, SetInitialState the depth of contacts.
    plant : MultibodyPlant
        Finalized.
    scene_graph : SceneGraph
    object_body : RigidBody
    finger_bodies : list of RigidBody
        One for each contact, in the scene's order.
    meshed : bool
        Whether bodies have meshes that end where contacts are at the scene's end, as those of
        AddScenePlant do: the driver then refuses to simulate beyond the scene's end.

    Raises
    ------
    SceneError
        A plant that is not finalized, or more or fewer fingers than contacts.
    """

    scene: Scene
    config: StationConfig
    plant: MultibodyPlant
    scene_graph: SceneGraph
    object_body: RigidBody
    finger_bodies: list[RigidBody]
    meshed: bool = False

    def __post_init__(self) -> None:
        wanted, given = len(self.scene.contacts), len(self.finger_bodies)
        if not self.plant.is_finalized():
            raise SceneError("the plant is not finalized: call plant.Finalize() first")
        if given != wanted:
            raise SceneError(f"{given} finger_bodies: give {wanted}, one for each contact")


def AddScenePlant(
    builder: DiagramBuilder, scene: Scene, config: StationConfig | None = None
) -> ScenePlant:
    """Add a finalized MultibodyPlant and a SceneGraph with the scene's bodies.

    The model instances are "object" and, for each contact, its name, or ``finger_<i>`` if it has
    none or the name is taken. The bodies' frames are those of their surfaces, and are at the
    world's origin until :func:`SetInitialState` puts the fingers in place. Fingers collide with
    the object alone.

    Drake cannot prescribe a joint's motion. So a turning object is on a revolute joint whose
    implicit controller follows a TrajectorySource "turning" with a high gain.

    Parameters
    ----------
    builder : DiagramBuilder
    scene : Scene
        It is planned here, to make meshes fine where contacts go.
    config : StationConfig, optional
        None: what the scene's ``[drake]`` table says.

    Raises
    ------
    SceneError
        A wrong setting, a surface that Drake's contact cannot take, or a builder that already has
        a system named "plant", "scene_graph" or "turning".
    """
    of_kind(DiagramBuilder, builder, "builder", "a DiagramBuilder")
    config = checked(scene, config, "plant")
    with naming(f"{scene.title}, plant"):
        _check_names(builder, config)
        config = dataclasses.replace(config)  # the caller may change what is his
        check_surfaces(scene, config)
        touches = touches_of(scene if config.hand is None else resting(scene))
        check_edges(scene, config, touches)
        return _add(builder, scene, config, touches)


def _add(
    builder: DiagramBuilder, scene: Scene, config: StationConfig, touches: Sequence[Touch]
) -> ScenePlant:
    plant, scene_graph = AddMultibodyPlant(
        MultibodyPlantConfig(
            time_step=config.time_step,
            contact_model=config.contact_model,
            discrete_contact_approximation=config.discrete_contact_approximation,
        ),
        builder,
    )
    colour = rgba(BODY[1], OPACITY if scene.object.inside else 1.0)
    object_body = add_body(plant, "object", 1, scene.object, colour, config, touches)
    fingers = [
        add_body(plant, name, 0, contact.finger, rgba(colour_of(i), OPACITY), config, [touch])
        for i, (name, contact, touch) in enumerate(zip(model_names(scene), scene.contacts, touches))
    ]
    touching = [plant.GetCollisionGeometriesForBody(body) for body in (object_body, *fingers)]
    excluded = CollisionFilterDeclaration().ExcludeWithin(GeometrySet(sum(touching[1:], [])))
    if config.hand is not None:
        links = add_hand(plant, config.hand, scene, fingers)
        excluded.ExcludeWithin(links)
        excluded.ExcludeBetween(links, GeometrySet(sum(touching, [])))
    scene_graph.collision_filter_manager().Apply(excluded)
    # a hand's file may have set another one
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -config.gravity])
    if config.object == "welded":
        plant.WeldFrames(plant.world_frame(), object_body.body_frame())
    turning = scene.turning if config.object == "turning" else None
    if turning is not None:
        _turning_joint(plant, object_body, turning)
    plant.Finalize()
    if turning is not None:
        _connect_turning(builder, plant, turning)
    meshed = config.contact_model == "hydroelastic"
    return ScenePlant(scene, config, plant, scene_graph, object_body, fingers, meshed)


def _check_names(builder: DiagramBuilder, config: StationConfig) -> None:
    """Refuse names that are taken: Drake would end the process when it builds the Diagram."""
    for name in ("plant", "scene_graph", *["turning"] * (config.object == "turning")):
        if builder.HasSubsystemNamed(name):
            raise SceneError(
                f"the builder has a system named {name!r} already, and two of a name cannot be in "
                f"a Diagram: call builder.GetMutableSubsystemByName({name!r}).set_name(...) first, "
                "or add the plant to a Diagram of its own"
            )


def model_names(scene: Scene) -> list[str]:
    """Names of the fingers' model instances: the contacts' names, or ``finger_<i>`` for a contact
    without a name of its own."""
    given, names = [contact.name for contact in scene.contacts], list[str]()
    for i, name in enumerate(given):
        if name in ("", "object", *names):
            name = f"finger_{i}"
            while name in given or name in names:
                name += "_"
        names.append(name)
    return names


def check_surfaces(scene: Scene, config: StationConfig) -> None:
    """Refuse what Drake's contact cannot do, with the reason."""
    if config.object == "turning" and scene.turning is None:
        raise SceneError(
            'object = "turning", but the scene has no [turning]; add that table, or give "free"'
        )
    if config.object == "turning" and config.time_step == 0:
        raise SceneError(
            'object = "turning" needs a discrete plant, whose implicit controllers are stable with '
            "a high gain; give time_step > 0"
        )
    check_depth(scene, config)
    for i, contact in enumerate(scene.contacts):
        finger = contact.finger
        if config.contact_model == "point":
            round_pair = isinstance(finger, Sphere) and isinstance(scene.object, (Sphere, Plane))
            if not round_pair or finger.inside or scene.object.inside:
                raise SceneError(
                    f'{scene.contact_title(i)}: contact_model = "point" is exact for a sphere on a '
                    f"sphere or on a plane, not for {finger!r} on {scene.object!r}: elsewhere "
                    "Drake's normal is wrong, on an ellipsoid by up to 16 degrees; use "
                    '"hydroelastic"'
                )
        elif finger.inside or not (finger.chart.central or isinstance(finger, (Cylinder, Torus))):
            raise SceneError(
                f"{scene.contact_title(i)}: a fingertip is a compliant solid, which {finger!r} "
                "does not bound; use a sphere, an ellipsoid, a cylinder, a torus or an "
                "ImplicitSurface"
            )


# --- a turning object --------------------------------------------------------------------------


def _turning_joint(plant: MultibodyPlant, body: RigidBody, turning: Turning) -> None:
    joint = plant.AddJoint(
        RevoluteJoint("turning", plant.world_frame(), body.body_frame(), turning.axis)
    )
    joint.set_default_angle(turning_angle(turning)(0.0))
    # With a position gain alone, Drake's implicit controller brings the joint to the desired angle
    # in every step, however high the gain: in C1 to 2e-9 rad.
    gains = PdControllerGains(p=TURNING_GAIN, d=0.0)
    plant.AddJointActuator("turning", joint).set_controller_gains(gains)


def _connect_turning(builder: DiagramBuilder, plant: MultibodyPlant, turning: Turning) -> None:
    # The controller brings the joint to what is desired when a step begins: give the step's end.
    ahead = turning_angle(turning)(Polynomial([plant.time_step(), 1.0]))
    # The object turns on beyond the scene's end, as the planner plans on.
    path = PiecewisePolynomial([np.array([[DrakePolynomial(ahead.coef)]])], [0.0, FOREVER])
    source = builder.AddNamedSystem("turning", TrajectorySource(path, output_derivative_order=1))
    port = plant.get_desired_state_input_port(plant.GetModelInstanceByName("object"))
    builder.Connect(source.get_output_port(), port)


def turning_angle(turning: Turning) -> Polynomial:
    """Angle about the normalized axis, rad, as a polynomial of time."""
    return float(np.linalg.norm(turning.axis)) * Polynomial(turning.angle)
