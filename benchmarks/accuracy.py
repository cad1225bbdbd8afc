"""Accuracy bars: errors against independent truth, and errors of exact identities.

Truth: 30-digit references of ``tests/oracles``, closed forms in mpmath, geographiclib. Identities:
slip law, Jacobi's integral, chart round trip, for charts, profiles and gain laws of the package.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import mpmath as mp
import numpy as np
from oracles.formulas import arc_length, great_circle, helix, reflection, slip_of_states
from oracles.load import load, scene_of

import contact_system as cs

from . import stress_scenes as drawn
from .problems import geodesic_scene
from .report import Bar

Array = np.ndarray


def reference_error(scene: cs.Scene, record: dict[str, Any], tolerance: float = 1e-12) -> float:
    """Greatest distance of contact points from a scene's reference, over the body's size."""
    points = cs.plan(scene, tolerance).points(record["times"])
    worst = 0.0
    for i, truth in enumerate(record["contacts"]):
        sizes = (scene.contacts[i].finger.size, scene.object.size)
        off = np.linalg.norm(points[:, i] - truth["points"], axis=2) / sizes
        worst = max(worst, float(off.max()))
    return worst


def references(full: bool) -> Iterator[Bar]:
    """K1 to K4 with the printed gain, K1 and K2 also with law `time`; scenes of stiff slip."""
    errors = []
    for name, law in (("k_scenes", "path"), ("k_scenes_time", "time")):
        for key, record in load(name)["scenes"].items():
            scene = cs.load_scene(key).replace(gain=cs.Gain(law, 100.0))
            errors.append(reference_error(scene, record))
    yield Bar("K1-K4, points / size, against 30 digits", 1e-12, max(errors))
    errors = [
        reference_error(scene_of(record), record)
        for name in ("sphere_slip", "ellipsoid_slip", "torus_slip")
        for record in load(name)["scenes"].values()
    ]
    yield Bar("stiff slip, points / size, against 30 digits", 1e-12, max(errors))


def surfaces() -> dict[str, tuple[cs.Surface, tuple[float, float]]]:
    """Every kind of surface, with a contact on it."""
    bodies = {name: make(drawn.Draw(1), 0.2, False) for name, make in drawn.BODIES.items()}
    del bodies["ellipsoid"]  # its shape is drawn
    bodies["bowl"] = drawn.sphere(drawn.Draw(2), 0.2, True)
    for shape in ("plain", "oblate", "prolate"):
        bodies[f"ellipsoid, {shape}"] = drawn.ellipsoid(drawn.Draw(3), 0.3, False, shape)
    for seed in (4, 5, 6):
        bodies[f"turned {seed}"] = drawn.turned(drawn.Draw(seed), 0.1, False)
    return {name: (body.surface, body.at) for name, body in bodies.items()}


def _worst(name: str, limit: float, errors: dict[str, float]) -> Bar:
    worst = max(errors, key=errors.__getitem__)
    return Bar(name, limit, errors[worst], note=f"worst: {worst}")


def slip_law(full: bool) -> Iterator[Bar]:
    """|v_rel| = |v_rel|(0) sigma/sigma(0) exp(-L) on every surface, under three gain laws."""
    errors: dict[str, float] = {}
    profile, velocity = cs.Profile([0.02, 0, 0.3]), (0.2, -0.9)
    for name, (surface, at) in surfaces().items():
        contact = cs.Contact(cs.Sphere(0.04), at, angle=0.3, object_velocity=velocity)
        for gain in (cs.Gain.path(100.0), cs.Gain.time(4.0), cs.Gain.guaranteed(2.0)):
            given = {"profile": profile, "gain": gain, "duration": 1.0}
            scene = cs.Scene(object=surface, contacts=[contact], **given)
            errors[f"{name}, {gain.law}"] = _slip_law_error(scene)
    yield _worst("slip law, relative to the greatest slip", 1e-12, errors)


def _slip_law_error(scene: cs.Scene) -> float:
    """Errors of slip from states and of Plan.slip against the law, and their difference."""
    t = np.linspace(0.0, scene.duration, 101)
    plan, profile, contact = cs.plan(scene), scene.profile, scene.contacts[0]
    rates, slip = slip_of_states(scene, plan.states(t))[:, 0], plan.slip(t)[:, 0]
    start = reflection(contact.angle) @ contact.finger_velocity - contact.object_velocity
    law = np.hypot(*start) * profile(t) * np.exp(-scene.gain.exponent(profile, t))
    differences = [np.hypot(*rates.T) - law, np.hypot(*slip.T) - law, *(rates - slip).T]
    return float(max(np.abs(d).max() for d in differences) / law.max())


REVOLUTIONS = 1000


def revolutions(full: bool) -> Iterator[Bar]:
    """Geodesics of spheres and cylinders over 1000 revolutions against mpmath."""
    random = np.random.default_rng(1000)
    for kind, truth in ((cs.Sphere, great_circle), (cs.Cylinder, helix)):
        errors = []
        for _ in range(60 if full else 12):
            radius, heading = random.uniform(0.02, 2.0), random.uniform(-math.pi / 4, math.pi / 4)
            at = (random.uniform(0.5, 2.5), random.uniform(-3.0, 3.0) * radius)
            w = (math.cos(heading), math.sin(heading))
            scene = _long_scene(kind(radius), at, w, random)
            t = np.append(np.sort(random.uniform(0.0, scene.duration, 30)), scene.duration)
            found = cs.plan(scene).points(t)[:, 0, 1]
            with mp.workdps(40):
                lengths = [arc_length(scene.profile.coefficients, time) for time in t]
                exact = np.array([truth(radius, at, w, s) for s in lengths])
            errors.append(np.linalg.norm((found - exact).astype(float), axis=1).max() / radius)
        name = f"{kind.__name__.lower()}, {REVOLUTIONS} revolutions, of the radius"
        yield Bar(name, 1e-12, max(errors))


def _long_scene(surface: cs.Surface, at: Any, w: Any, random: np.random.Generator) -> cs.Scene:
    """A plane rolls along a geodesic of the surface; profile and duration are random."""
    coefficients, duration = random.uniform(0.1, 1.0, random.integers(1, 5)), random.uniform(1, 1e3)
    around = math.hypot(*w) if isinstance(surface, cs.Sphere) else w[0]
    goal = REVOLUTIONS * 2 * math.pi * surface.size / around
    profile = cs.Profile(coefficients * goal / cs.Profile(coefficients).arc_length(duration))
    ways = {"finger_velocity": (w[0], -w[1]), "object_velocity": w}
    contact = cs.Contact(cs.Plane(), at, (0.0, 0.0), **ways)
    return cs.Scene(object=surface, contacts=[contact], profile=profile, duration=duration)


def triaxial(full: bool) -> Iterator[Bar]:
    """200 geodesics of 3 m on the ellipsoid 0.3/0.2/0.1; Jacobi's integral along each."""
    data = load("ellipsoid_geodesics")
    surface, length = cs.Ellipsoid(*data["axes"]), float(data["length"])
    errors, drifts = [], []
    t = np.linspace(0.0, length, 50)
    for k, (u, v, a) in enumerate(data["start"]):
        scene = geodesic_scene(surface, (u, v), (math.cos(a), math.sin(a)), length)
        plan = cs.plan(scene, tolerance=1e-15)
        found = plan.points([0.5 * length, length])[:, 0, 1]
        truth = np.array([data["middle"][k], data["end"][k]])
        errors.append(np.linalg.norm(found - truth, axis=1).max())
        terms = _jacobi(surface, plan.states(t)[:, 0])
        # Relative to the greatest size of its two terms on the path: the integral of a geodesic
        # aimed at an umbilic is 1e-19 m^2, a difference of terms of 1e-2 m^2.
        drift = np.abs(terms.sum(axis=1) - data["jacobi"][k]).max()
        drifts.append(drift / np.abs(terms).sum(axis=1).max())
    yield Bar("ellipsoid 0.3/0.2/0.1, 200 geodesics of 3 m", 1e-13, max(errors), "m")
    note = f"median {np.median(drifts):.1e}"
    yield Bar("the same: Jacobi's integral, relative", 1e-13, max(drifts), note=note)


def _jacobi(surface: cs.Ellipsoid, states: Array) -> Array:
    """Both terms of (b^2-c^2) cos^2 v sin^2 a - (a^2-b^2) sin^2 u cos^2 a: (n, 9) -> (n, 2), m^2.

    Theory section 9; a is the angle from the v-line, so sin a is the component along f_u.
    """
    u, v = states[:, 4], states[:, 5]
    velocity = (surface.metric_root(u, v) @ states[:, 6:8, None])[:, :, 0]
    along_u, along_v = (velocity / np.linalg.norm(velocity, axis=1, keepdims=True)).T
    a2, b2, c2 = surface.a**2, surface.b**2, surface.c**2
    first = (b2 - c2) * (np.cos(v) * along_u) ** 2
    return np.stack([first, -(a2 - b2) * (np.sin(u) * along_v) ** 2], axis=1)


def spheroids(full: bool) -> Iterator[Bar]:
    """200 random geodesics on ellipsoids of revolution against geographiclib (Karney 2013)."""
    from geographiclib.geodesic import Geodesic

    random = np.random.default_rng(2013)
    errors = []
    for _ in range(200):
        f = random.uniform(-0.01, 0.01)
        latitude, azimuth = random.uniform(-85, 85), random.uniform(-180, 180)
        length = random.uniform(0.1, 2.5) * 2 * math.pi
        end = Geodesic(1.0, f).Direct(latitude, 0.0, azimuth, length)
        scene = _spheroid_scene(f, latitude, azimuth, length)
        found = cs.plan(scene, tolerance=1e-15).points([length])[0, 0, 1]
        truth = spheroid_point(f, end["lat2"], end["lon2"])
        errors.append(float(np.linalg.norm(found - truth)))
    name, note = "ellipsoids of revolution, of a", "against geographiclib, itself about 2.4e-15"
    yield Bar(name, 1e-13, max(errors), note=note)


def _reduced(f: float, latitude: float) -> float:
    """Parametric latitude of a geodetic one: degrees -> radians."""
    phi = math.radians(latitude)
    return math.atan2((1 - f) * math.sin(phi), math.cos(phi))


def _spheroid_scene(f: float, latitude: float, azimuth: float, length: float) -> cs.Scene:
    """Oblate bodies turn about z (u is the longitude), prolate ones about x (v is)."""
    beta, alpha = _reduced(f, latitude), math.radians(azimuth)
    east, north = math.sin(alpha), math.cos(alpha)
    if f > 0:
        surface = cs.Ellipsoid(1.0, 1.0, 1.0 - f)
        return geodesic_scene(surface, (0.0, beta), (east, north), length)
    surface = cs.Ellipsoid(1.0 - f, 1.0, 1.0)
    return geodesic_scene(surface, (math.pi / 2 - beta, 0.0), (-north, east), length)


def spheroid_point(f: float, latitude: float, longitude: float) -> Array:
    """A point of a spheroid with flattening f and equatorial radius 1; angles in degrees."""
    beta, turn = _reduced(f, latitude), math.radians(longitude)
    around = (math.cos(beta) * math.cos(turn), math.cos(beta) * math.sin(turn))
    axial = (1 - f) * math.sin(beta)
    return np.array([*around, axial] if f > 0 else [axial, *around])


def round_trip(full: bool) -> Iterator[Bar]:
    """(u, v) -> x -> (u, v) -> x, in x, at random points, on seams, 1e-12 from singular points."""
    random = np.random.default_rng(4)
    errors = {}
    for name, (surface, at) in surfaces().items():
        u, v = _trip_coordinates(name, at, random)
        x = surface.point(u, v)
        again = surface.point(*surface.coordinates(x))
        errors[name] = float(np.linalg.norm(again - x, axis=1).max() / surface.size)
    yield _worst("chart round trip, all surfaces, of the size", 4e-15, errors)


def _trip_coordinates(
    name: str, at: tuple[float, float], random: np.random.Generator
) -> tuple[Array, Array]:
    """Random coordinates on a surface, and some near its poles, umbilics and seams."""
    half, n = math.pi / 2, 2000
    turn, other = random.uniform(-math.pi, math.pi, (2, n))
    around = np.repeat([0.0, 1.0, half, math.pi, -half, -2.5], 6)
    poles = np.tile([*(near := [1e-12, 1e-9, 1e-5]), *(math.pi - x for x in near)], 6)
    if name in ("sphere", "bowl", "ellipsoid, prolate", "implicit_ellipsoid"):
        return np.append(random.uniform(0, math.pi, n), poles), np.append(turn, around)
    latitude = random.uniform(-half, half, n)
    if name == "ellipsoid, oblate":
        return np.append(turn, around), np.append(latitude, half - poles)
    if name == "ellipsoid, plain":
        seam, off = np.where(random.random(n) < 0.5, half, -half), [0, *near, *(-x for x in near)]
        umbilics = itertools.product((0.0, math.pi), (half, -half), off, off)
        us, vs = zip(*((u + d, v + e) for u, v, d, e in umbilics))
        return np.concatenate([turn, other, us]), np.concatenate([latitude, seam, vs])
    if name == "torus":
        return turn, other
    local = 0.05 * random.standard_normal((2, n))
    return at[0] + local[0], at[1] + local[1] * (0.2 if name == "cylinder" else 1.0)


SECTIONS = {
    "references": references,
    "slip law": slip_law,
    "revolutions": revolutions,
    "triaxial": triaxial,
    "spheroids": spheroids,
    "round trip": round_trip,
}
