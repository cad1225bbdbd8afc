r"""One body of a scene in a MultibodyPlant: its contact geometry, material and inertia.

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

import math
from collections.abc import Sequence

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    HalfSpace,
    ProximityProperties,
    Rgba,
    Shape,
    SurfaceTriangle,
    TriangleSurfaceMesh,
)
from pydrake.geometry import Sphere as SphereShape
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import CalcSpatialInertia, RigidBody, SpatialInertia
from scipy.spatial import cKDTree

from contact_system import Cylinder, Ellipsoid, Plane, Scene, SceneError, Sphere, Surface
from contact_system.checks import Array

from .config import EDGES, StationConfig
from .drake_meshes import compliant_mesh, inner_points, painted, rigid_mesh
from .meshes import SurfaceMesh, contact_mesh, domain_of
from .pressing import REACH, Touch, contact_depth

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


def add_body(
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
    shape: Shape = HalfSpace()
    reach, mesh = REACH + patch, None
    properties, hydroelastic = _material(config), config.contact_model == "hydroelastic"
    if isinstance(surface, Plane):  # for pictures alone; a narrow strip would take many patches
        domain = domain_of(surface, curve, reach + np.ptp(curve, axis=0).max() / 4, opposing)
    else:
        domain, shape = domain_of(surface, curve, reach, opposing), SphereShape(surface.size)
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
    for k, (painting, shade) in enumerate(painted(domain, colour)):
        plant.RegisterVisualGeometry(body, at, painting, f"{name}_{k}", shade.rgba)
    return body


def _modulus(config: StationConfig, touch: Touch, inner: Array) -> float:
    """Hydroelastic modulus, Pa, for the stiffness at the normal force, averaged over the curve."""
    below = inner[cKDTree(inner).query(touch.points[0])[1]]
    height = np.sum(touch.normals * (touch.points[0] - below), axis=1)
    compliance = np.mean(1 / (height * touch.relative_curvature))
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


def check_edges(scene: Scene, config: StationConfig, touches: Sequence[Touch]) -> None:
    """Refuse edges so long that bodies which roll on such meshes lose contact."""
    for key in EDGES:
        edge, depth = getattr(config, key), contact_depth(config)
        if edge is None or config.contact_model == "point":
            continue
        for i, touch in enumerate(touches):
            half = sum(touch.curvatures) / 2
            if half * edge**2 > WIDEST_GAP * depth:
                most = 0.95 * math.sqrt(WIDEST_GAP * depth / half)  # so that rounding is no excess
                raise SceneError(
                    f"{key} = {edge!r}: {scene.contact_title(i)}: along such an edge bodies are up "
                    f"to {half * edge**2:.2g} m off each other, pressed {depth:.2g} m deep; give "
                    f"at most {most:.2g} m, or leave it out"
                )
