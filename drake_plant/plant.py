r"""A scene as a MultibodyPlant: the object, and one free fingertip for each contact.

A fingertip is compliant, the object rigid. Where they overlap by a depth d, at x in the tangent
plane the object's surface lies ``d - (K_1 + R K_2 R)(x, x)/2`` below the finger's to second order.
Drake's pressure there is E times this over the distance l from the finger's surface to the inner
point below it (`compliant_mesh`). Over the patch, an ellipse of area
``2 pi d/sqrt(det(K_1 + R K_2 R))``, this adds up to

.. math:: F = \frac{E}{l} \frac{\pi d^2}{\sqrt{\det(K_1 + R K_2 R)}}, \qquad
          k = \frac{dF}{dd} = \frac{2 F}{d},

so a stiffness k at a force F needs the modulus ``E = k^2 l sqrt(det(K_1 + R K_2 R))/(4 pi F)``;
the depth is then 2 F/k. For spheres of 0.04 and 0.1 m that are 0.2 mm deep, the force integrated
without the expansion is 0.2 % less. SI units, radians.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    CollisionFilterDeclaration,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    Rgba,
    SceneGraph,
    Shape,
    SurfaceTriangle,
    TriangleSurfaceMesh,
)
from pydrake.geometry import Sphere as SphereShape
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    CoulombFriction,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.multibody.tree import (
    CalcSpatialInertia,
    PdControllerGains,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
)
from pydrake.polynomial import Polynomial as DrakePolynomial
from pydrake.systems.framework import DiagramBuilder, InputPort, LeafSystem
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from scipy.spatial import cKDTree

from contact_system import (
    Cylinder,
    Ellipsoid,
    Plane,
    Scene,
    SceneError,
    Sphere,
    Surface,
    Torus,
    Turning,
)
from contact_system.checks import Array, naming, of_kind
from contact_system.plots.style import BODY, colour_of

from .config import EDGES, StationConfig, checked
from .drake_meshes import compliant_mesh, inner_points, painted, rgba, rigid_mesh
from .hand_kinematics import add_hand
from .meshes import SurfaceMesh, contact_mesh, domain_of
from .planner_base import FOREVER
from .pressing import REACH, Touch, check_depth, contact_depth, resting, touches_of

# Edges h are so long that along one a gap of so many contact depths opens. The distance of facets
# from the surface ripples with the period of the mesh, and a patch of radius a averages the ripple
# with the weight J1(q a)/(q a), q = 4 pi/(sqrt(3) h). The finger's edges are near the second zero
# of J1, h = 1.03 a, the object's near the first, h = 1.89 a. Spheres of 0.04 and 0.1 m, 0.2 mm:
#   finger, object   spread of the force, 400 orientations   faces in the patch
#   1.04    1.04     0.3 %                                   58
#   1.04    2.8      1.0 %                                   39
#   1.04    3.5      0.6 %                                   37
#   1.4     3.5      1.1 %                                   32
# On the object 2.9 is taken: at 3.5 the facets tilt the normals so far that friction, taken along
# the true normal, reads 2.3 % above mu N in D1 (2.9: 1.7 %, 2.4: 1.2 %).
# A step of D1 takes 4 us a face, and 21 us without contact.
GAPS = 1.04, 2.9  # of finger and object
# The widest gap, in depths, of edges that the user sets. At 9 the force of D1 has a spread of 0.2
# to 0.3 N of 1 N (Drake's own spheres 0.9 N), at 35 fingers bounce, beyond that contact is lost.
WIDEST_GAP = 10.0

STRIP = 0.01  # m beyond the planned patches, up to which a large mesh is fine
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
        _check_edges(scene, config, touches)
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
    object_body = _add_body(plant, "object", 1, scene.object, colour, config, touches)
    fingers = [
        _add_body(plant, name, 0, contact.finger, rgba(colour_of(i), OPACITY), config, [touch])
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


def _check_edges(scene: Scene, config: StationConfig, touches: Sequence[Touch]) -> None:
    """Refuse edges so long that bodies which roll on such meshes lose contact."""
    for key in EDGES:
        edge, depth = getattr(config, key), contact_depth(config)
        if edge is None or config.contact_model == "point":
            continue
        for i, touch in enumerate(touches):
            half = sum(touch.curvatures) / 2
            if half * edge**2 > WIDEST_GAP * depth:
                raise SceneError(
                    f"{key} = {edge!r}: {scene.contact_title(i)}: along such an edge bodies are up "
                    f"to {half * edge**2:.2g} m off each other, pressed {depth:.2g} m deep; give "
                    f"at most {math.sqrt(WIDEST_GAP * depth / half):.2g} m, or leave it out"
                )


# --- bodies ------------------------------------------------------------------------------------


def _add_body(
    plant: MultibodyPlant,
    name: str,
    side: int,
    surface: Surface,
    colour: Rgba,
    config: StationConfig,
    touches: Sequence[Touch],
) -> RigidBody:
    """A body with its contact geometry, painted in two colours so that rolling can be seen.

    side : 0 for a finger, whose own touch is given, 1 for the object, with those of all fingers
    """
    curve = np.vstack([touch.points[side] for touch in touches])
    curvature = float(np.mean([touch.curvatures[side] for touch in touches]))
    opposing = max(touch.curvatures[1 - side] for touch in touches)
    depth, edge = contact_depth(config), getattr(config, EDGES[side])
    patch = math.sqrt(2 * depth / (curvature + opposing))
    gap = GAPS[side] * depth if edge is None else (curvature + opposing) * edge**2 / 2
    domain = mesh = None
    shape: Shape = HalfSpace()
    properties, hydroelastic = _material(config), config.contact_model == "hydroelastic"
    if not isinstance(surface, Plane):
        domain = domain_of(surface, curve, REACH + patch, opposing)
        shape = SphereShape(surface.size)
        if hydroelastic:
            mesh = contact_mesh(domain, curve, opposing, gap, STRIP + patch)
    if hydroelastic and side:
        AddRigidHydroelasticProperties(properties)
        shape = shape if mesh is None else rigid_mesh(mesh)
    elif mesh is not None:
        inner = inner_points(surface)
        shape = compliant_mesh(mesh, inner, name)
        hint = surface.size  # Drake asks for one, and ignores it for meshes
        AddCompliantHydroelasticProperties(hint, _modulus(config, touches[0], inner), properties)
    mass = (config.finger_mass, config.object_mass)[side]
    # A welded or turning object may be a surface that bounds no solid; its inertia has no effect.
    inertia = SpatialInertia.SolidSphereWithMass(mass, surface.size)
    if not side or config.object == "free":
        inertia = solid_inertia(name, surface, mass, mesh)
    body, at = plant.AddRigidBody(name, plant.AddModelInstance(name), inertia), RigidTransform()
    plant.RegisterCollisionGeometry(body, at, shape, name, properties)
    paintings = [(shape, colour)] if domain is None else painted(domain, colour)
    for k, (painting, shade) in enumerate(paintings):
        plant.RegisterVisualGeometry(body, at, painting, f"{name}_{k}", shade.rgba)
    return body


def _modulus(config: StationConfig, touch: Touch, inner: Array) -> float:
    """Hydroelastic modulus, Pa, for the stiffness at the normal force, averaged over the curve."""
    below = inner[cKDTree(inner).query(touch.points[0])[1]]
    height = np.sum(touch.normals * (touch.points[0] - below), axis=1)
    compliance = np.nanmean(1 / (height * touch.relative_curvature))
    return config.stiffness**2 / (4 * math.pi * config.normal_force * float(compliance))


def _material(config: StationConfig) -> ProximityProperties:
    properties = ProximityProperties()
    AddContactMaterial(
        properties,
        dissipation=0.0,
        point_stiffness=2 * config.stiffness,  # Drake puts those of two bodies in series
        friction=CoulombFriction(config.friction, config.friction),
    )
    properties.AddProperty("material", "relaxation_time", 0.0)
    return properties


def solid_inertia(
    name: str, surface: Surface, mass: float, mesh: SurfaceMesh | None = None
) -> SpatialInertia:
    """Inertia of a homogeneous solid about its mass centre, which is put at the body's origin."""
    if isinstance(surface, Sphere) and not surface.inside:
        return SpatialInertia.SolidSphereWithMass(mass, surface.radius)
    if isinstance(surface, Ellipsoid) and not surface.inside:
        return SpatialInertia.SolidEllipsoidWithMass(mass, surface.a, surface.b, surface.c)
    if mesh is not None and not surface.inside:
        if isinstance(surface, Cylinder):
            length = np.ptp(mesh.points[:, 2])
            return SpatialInertia.SolidCylinderWithMass(mass, surface.radius, length, [0, 0, 1])
        if mesh.closed:
            triangles = [SurfaceTriangle(*map(int, t)) for t in mesh.triangles]
            unit = CalcSpatialInertia(TriangleSurfaceMesh(triangles, list(mesh.corrected())), 1.0)
            central = unit.Shift(unit.get_com())
            return SpatialInertia(mass, np.zeros(3), central.get_unit_inertia())
    raise SceneError(
        f"{name}: {surface!r} does not bound a solid whose inertia could be computed; give a "
        'closed one, or, without a hand, [drake] object = "welded" or "turning"'
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
