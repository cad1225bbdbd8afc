"""Meshes for hydroelastic contact: closed, on their surface, fine along the contact's curve."""

import math

import numpy as np
import pytest

pytest.importorskip("pydrake")

from conftest import SURFACES
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    GeometryInstance,
    ProximityProperties,
    SceneGraph,
    SourceId,
)
from pydrake.math import RigidTransform

import contact_system as cs
from drake_plant.drake_meshes import compliant_mesh, inner_points
from drake_plant.meshes import contact_mesh, domain_of

AROUND = np.linspace(0, 2 * math.pi, 90)
CIRCLE = np.stack([np.cos(AROUND), np.sin(AROUND), 0 * AROUND], axis=1)


def ellipsoid(a, b, c):
    return cs.Ellipsoid(a, b, c), [a, b, 0] * CIRCLE, 4 / 3 * math.pi * a * b * c


# Surface, a curve on it, and its volume.
SOLIDS = {
    "sphere": (cs.Sphere(0.04), 0.04 * CIRCLE, 4 / 3 * math.pi * 0.04**3),
    "ellipsoid": ellipsoid(0.12, 0.1, 0.08),
    "torus": (cs.Torus(0.05, 0.02), 0.07 * CIRCLE, 2 * math.pi**2 * 0.05 * 0.02**2),
    "quadric": (
        cs.Quadric(np.diag([100.0, 100.0, 400.0])),
        0.1 * CIRCLE,
        4 / 3 * math.pi * 0.1 * 0.1 * 0.05,
    ),
    "needle": ellipsoid(0.3, 0.03, 0.03),
    "disc": ellipsoid(0.3, 0.3, 0.02),
    "blade": ellipsoid(0.3, 0.1, 0.02),
}


def mesh_of(surface, curve, gap=1e-3, opposing=25.0, strip=0.01):
    domain = domain_of(surface, np.asarray(curve), 0.03, opposing)
    return contact_mesh(domain, np.asarray(curve), opposing, gap, strip)


def hydroelastic(shape):
    """The VolumeMesh that Drake makes of a compliant shape."""
    graph = SceneGraph()
    source: SourceId = graph.RegisterSource("test")
    instance = GeometryInstance(RigidTransform(), shape, "shape")
    properties = ProximityProperties()
    AddCompliantHydroelasticProperties(1.0, 1e6, properties)
    instance.set_proximity_properties(properties)
    geometry = graph.RegisterGeometry(source, graph.world_frame_id(), instance)
    return graph.model_inspector().maybe_get_hydroelastic_mesh(geometry)


@pytest.mark.parametrize("name", SOLIDS)
def test_meshes_of_solids_are_closed_without_folds_face_outwards_and_keep_the_volume(name):
    surface, curve, true = SOLIDS[name]
    mesh = mesh_of(surface, curve, 3e-4)
    assert mesh.closed
    # closed, so with 3/2 as many edges as triangles
    assert len(mesh.points) - len(mesh.triangles) / 2 == (0 if name == "torus" else 2)
    a, b, c = (mesh.points[w] for w in mesh.triangles.T)
    facing = np.einsum("ti,ti->t", np.cross(b - a, c - a), mesh.normals[mesh.triangles[:, 0]])
    assert facing.min() > 0
    a, b, c = (mesh.corrected()[w] for w in mesh.triangles.T)
    assert np.einsum("ti,ti->", a, np.cross(b, c)) / 6 == pytest.approx(true, rel=0.02)


@pytest.mark.parametrize("name", SURFACES)
def test_every_kind_of_surface_has_a_mesh_with_its_vertices_and_normals_on_it(name):
    surface, (u, v) = SURFACES[name]
    curve = surface.point(u + np.linspace(0, 0.02, 5), np.full(5, v))
    mesh = mesh_of(surface, curve, opposing=100.0, strip=0.005)
    u, v = surface.coordinates(mesh.points[::37])
    assert np.abs(surface.point(u, v) - mesh.points[::37]).max() < 1e-8
    normal = surface.normal(u, v)
    known = np.all(np.isfinite(normal), axis=1)
    assert np.abs(normal[known] - mesh.normals[::37][known]).max() < 1e-6


def test_a_mesh_is_fine_in_a_strip_along_the_curve_coarse_elsewhere_and_closed():
    around = np.linspace(0, 2 * math.pi, 1000)
    surface, curve = cs.Sphere(1.0), np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
    strip = mesh_of(surface, curve, 3e-4, strip=0.02)
    assert strip.closed and len(strip.triangles) < 80_000  # 1.2 million if fine all over
    edge = np.linalg.norm(np.ptp(strip.points[strip.triangles], axis=1), axis=1)
    height = np.abs(strip.points[strip.triangles].mean(axis=1)[:, 2])
    fine = edge[height < 0.02]
    assert fine.max() < 1.3 * fine.mean()
    assert edge[height > 0.5].min() > 5 * fine.mean()


@pytest.mark.parametrize("name", ["sphere", "torus", "cylinder"])
def test_drakes_tetrahedra_fill_a_compliant_fingertip(name):
    cylinder = cs.Cylinder(0.02), 0.02 * CIRCLE, math.pi * 0.02**2 * 0.06
    surface, curve, true = (SOLIDS | {"cylinder": cylinder})[name]
    mesh = mesh_of(surface, curve, 3e-4, opposing=10.0)
    solid = hydroelastic(compliant_mesh(mesh, inner_points(surface), "finger"))
    assert solid.CalcVolume() == pytest.approx(true, rel=2e-3)


def test_a_mesh_that_would_be_too_large_is_refused_with_the_remedy():
    with pytest.raises(cs.SurfaceError, match="more than 200000 triangles; give a longer edge"):
        mesh_of(cs.Sphere(1.0), CIRCLE, 1e-6, strip=0.5)


def test_a_chart_that_is_singular_within_the_mesh_is_refused_with_the_place():
    cone = cs.ParametricSurface(("u*cos(v)", "u*sin(v)", "-u"), v_period=2 * math.pi)
    with pytest.raises(cs.SurfaceError, match="a pole of its chart"):
        mesh_of(cone, cone.point(np.linspace(0.0, 0.1, 9), np.zeros(9)))


def test_a_chart_that_covers_points_twice_is_refused_and_meshed_in_ranges_that_do_not():
    f = ("a*sin(u)*cos(v)", "a*sin(u)*sin(v)", "c*cos(u)")
    given = {"parameters": {"a": 0.1, "c": 0.13}, "size": 0.13, "v_period": 2 * math.pi}
    twice = cs.ParametricSurface(f, **given)
    once = cs.ParametricSurface(f, u_range=(0.0, math.pi), **given)
    curve = once.point(np.linspace(1.2, 1.5, 50), np.linspace(0.3, 0.0, 50))
    with pytest.raises(cs.SurfaceError, match="u_range and v_range cover places twice, give"):
        mesh_of(twice, curve)
    assert not mesh_of(once, curve).closed
