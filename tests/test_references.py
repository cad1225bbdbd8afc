"""Plans against references of 25 digits that know nothing of this package (tests/oracles)."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from conftest import path_velocities, reflection
from oracles.load import load, load_residual, scene_of

import contact_system as cs

FILES = {
    "k_scenes": ["K1", "K2", "K3", "K4"],
    "k_scenes_time": ["K1", "K2"],
    "torus_slip": ["torus"],
    "ellipsoid_slip": ["path 1e2", "path 1e4", "path peak 1e7", "time 1e2", "time 1e4", "time 1e6"],
    "sphere_slip": ["path 1e2", "path 1e4", "path peak 1e7", "time 1e2", "time 1e4", "time 1e6"],
}
CASES = [(file, name) for file, names in FILES.items() for name in names]

reference = functools.cache(load)
residual = functools.cache(load_residual)


@functools.cache
def planned(file: str, name: str) -> cs.Plan:
    return cs.plan(scene_of(reference(file)["scenes"][name]), tolerance=1e-12)


def true_values(file: str, name: str, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Nearest doubles and what they leave out, contacts along the second axis."""
    return tuple(
        np.stack([c[key] for c in of(file)["scenes"][name]["contacts"]], axis=1)
        for of in (reference, residual)
    )


def error(values: np.ndarray, truth: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return np.abs((values - truth[0]) - truth[1])


@pytest.mark.parametrize("file, name", CASES)
def test_contact_points_agree_with_the_reference(file, name):
    plan = planned(file, name)
    times = reference(file)["scenes"][name]["times"]
    gap = error(plan.points(times), true_values(file, name, "points")).max((0, 1, 3))
    assert (
        gap <= 1e-12 * np.array([plan.scene.contacts[0].finger.size, plan.scene.object.size])
    ).all()


@pytest.mark.parametrize("file, name", CASES)
def test_states_and_slip_agree_with_the_reference(file, name):
    plan = planned(file, name)
    times = reference(file)["scenes"][name]["times"]
    truth = true_values(file, name, "states")
    # rates of the finger reach sigma / radius; the ellipsoid's own, more where its chart is narrow
    scale = np.maximum(1.0, np.abs(truth[0]).max((0, 1)))
    assert (error(plan.states(times), truth) / scale).max() <= 1e-12
    truth = true_values(file, name, "slip")
    slip, path_speed = np.linalg.norm(truth[0], axis=-1).max(), plan.scene.profile(times).max()
    # An acceleration's slip is integrated as a part of the path velocity, and exact as such.
    bar = 1e-13 * path_speed if plan.scene.disturbances else 1e-12 * slip
    assert error(plan.slip(times), truth).max() <= bar


@pytest.mark.parametrize("name", FILES["k_scenes"])
def test_bundled_scene_is_the_scene_of_the_reference(name):
    # Same curves from the TOML file as from the reference's own inputs.
    t = reference("k_scenes")["scenes"][name]["times"]
    bundled = cs.plan(cs.load_scene(name))
    gap = error(bundled.points(t), true_values("k_scenes", name, "points"))
    assert gap.max() <= 1e-12 * bundled.scene.object.size


# --- geodesics of the triaxial ellipsoid


@functools.cache
def geodesic_plan() -> cs.Plan:
    """200 contacts that roll along the reference's geodesics, at 1 m/s for 3 s."""
    turn = reflection(0.0)
    contacts = []
    for u, v, a in reference("ellipsoid_geodesics")["start"]:
        w = np.array([np.cos(a), np.sin(a)])
        contacts.append(cs.Contact(cs.Plane(), (u, v), (0.0, 0.0), 0.0, turn @ w, w))
    body = cs.Ellipsoid(0.3, 0.2, 0.1)
    scene = cs.Scene(object=body, contacts=contacts, profile=cs.Profile([1.0]), duration=3.0)
    return cs.plan(scene, tolerance=1e-14)


@pytest.mark.parametrize("key, t", [("middle", 1.5), ("end", 3.0)])
def test_geodesics_of_the_ellipsoid_agree_with_the_reference(key, t):
    points = geodesic_plan().points(t)[0, :, 1]
    truth = reference("ellipsoid_geodesics")[key], residual("ellipsoid_geodesics")[key]
    assert error(points, truth).max() <= 1e-13


def test_directions_of_geodesics_agree_with_the_reference():
    # At unit speed: the finger is a plane and does not slip, so its contact point moves along
    # R_21 w1, the velocity of the contact point in the object's frame.
    plan = geodesic_plan()
    w1 = np.array([[*contact.finger_velocity, 0.0] for contact in plan.scene.contacts])
    direction = np.einsum("nij,nj->ni", plan.pose(3.0)[0, :, :3, :3], w1)
    truth = tuple(of("ellipsoid_geodesics")["end_direction"] for of in (reference, residual))
    assert error(direction, truth).max() <= 1e-12


def test_jacobis_integral_agrees_with_the_reference():
    plan = geodesic_plan()
    states = plan.states(np.linspace(0.0, 3.0, 31))
    _, a2 = path_velocities(plan.scene, states)
    a, b, c = 0.3, 0.2, 0.1
    u, v = states[..., 4], states[..., 5]
    value = (b**2 - c**2) * (np.cos(v) * a2[..., 0]) ** 2
    value -= (a**2 - b**2) * (np.sin(u) * a2[..., 1]) ** 2
    truth = reference("ellipsoid_geodesics")["jacobi"]
    # relative to the constant's range, (a^2 - c^2)
    assert np.abs(value - truth).max() <= 1e-13 * (a**2 - c**2)


# --- ellipsoids of revolution


def geographic(equator: float, f: float, lat: float, lon: float, azimuth: float) -> np.ndarray:
    """Position and unit direction of a geodesic from degrees: (2, 3), about the z axis."""
    (phi, lam, alpha), e2 = np.radians([lat, lon, azimuth]), f * (2 - f)
    across = equator / np.sqrt(1 - e2 * np.sin(phi) ** 2)
    east = np.array([-np.sin(lam), np.cos(lam), 0.0])
    north = np.array([-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)])
    out = np.array([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), (1 - e2) * np.sin(phi)])
    return np.array([across * out, np.cos(alpha) * north + np.sin(alpha) * east])


@pytest.mark.parametrize("f", [0.01, 0.003, -0.003, -0.01])
def test_geodesics_of_an_ellipsoid_of_revolution_agree_with_geographiclib(f):
    geographiclib = pytest.importorskip("geographiclib.geodesic")
    equator, length = 1.0, 4.0
    polar = equator * (1 - f)
    # an Ellipsoid has its longest axis along x, so a prolate one turns about x
    shift = 0 if f > 0 else 1
    body = cs.Ellipsoid(equator, equator, polar) if f > 0 else cs.Ellipsoid(polar, equator, equator)
    line, rng = geographiclib.Geodesic(equator, f), np.random.default_rng(7)
    contacts, ends = [], []
    for lat, lon, azimuth in rng.uniform([-80, -180, -180], [80, 180, 180], (40, 3)):
        start, w = np.roll(geographic(equator, f, lat, lon, azimuth), shift, axis=1)
        end = line.Direct(lat, lon, azimuth, length)
        ends.append(geographic(equator, f, end["lat2"], end["lon2"], end["azi2"])[0])
        at = body.coordinates(start)
        along = body.frame(*at)[:, :2].T @ w
        given = reflection(0.0) @ along
        contacts.append(cs.Contact(cs.Plane(), at, (0.0, 0.0), 0.0, given, along))
    scene = cs.Scene(object=body, contacts=contacts, profile=cs.Profile([1.0]), duration=length)
    points = cs.plan(scene, tolerance=1e-14).points(length)[0, :, 1]
    # geographiclib gives degrees: 4e-16 relative of up to 180 degrees is 1e-15 of the equator
    assert np.abs(points - np.roll(ends, shift, axis=1)).max() <= 1e-13 * equator
