"""Accuracy bars: errors against truth that contact_system has no part in, and exact identities.

Truth: 30-digit references of ``tests/oracles``, closed forms in mpmath, geographiclib. Identities:
slip law, Jacobi's integral, chart round trip, with charts, profiles and gain laws of the package.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from oracles.load import load, scene_of

import contact_system as cs
from contact_system.kernels import find_compiler
from contact_system.kinematics import contact_map

from .report import Bar


def engines() -> list[bool]:
    """Values of ``compiled`` that this machine can run."""
    return [False, True] if find_compiler() else [False]


def slip_from_states(scene: cs.Scene, states: np.ndarray) -> np.ndarray:
    """v_rel = R_psi M1 q1' - M2 q2' in E2 (eq. `netrelvel`), m/s.

    (n, n_contacts, 9) -> (n, n_contacts, 2).
    """
    columns = []
    for i, contact in enumerate(scene.contacts):
        s = states[:, i]
        a1 = contact.finger.metric_root(s[:, 0], s[:, 1]) @ s[:, 2:4, None]
        a2 = scene.object.metric_root(s[:, 4], s[:, 5]) @ s[:, 6:8, None]
        columns.append((contact_map(s[:, 8]) @ a1 - a2)[:, :, 0])
    return np.stack(columns, axis=1)


def chart_points(scene: cs.Scene, states: np.ndarray) -> np.ndarray:
    """Contact points of chart states of the first contact: (n, 9) -> (n, 2, 3), m."""
    tip = scene.contacts[0].finger.point(states[:, 0], states[:, 1])
    return np.stack([tip, scene.object.point(states[:, 4], states[:, 5])], axis=1)


def point_error(scene: cs.Scene, contact: int, found: np.ndarray, truth: np.ndarray) -> float:
    """Greatest distance of contact points (n, 2, 3) as a fraction of each body's size."""
    sizes = (scene.contacts[contact].finger.size, scene.object.size)
    return float((np.linalg.norm(found - truth, axis=2) / sizes).max())


# --- the paper's scenes ------------------------------------------------------------------------


def paper_scenes(full: bool) -> Iterator[Bar]:
    """K1 to K4 with the printed gain, K1 and K2 with the gain of the reported times."""
    detail: dict[str, float] = {}
    for name, law in (("k_scenes", "path"), ("k_scenes_time", "time")):
        for key, record in load(name)["scenes"].items():
            scene = cs.load_scene(key).replace(gain=cs.Gain(law, 100.0))
            for compiled in engines():
                points = cs.plan(scene, 1e-12, compiled=compiled).points(record["times"])
                errors = [
                    point_error(scene, i, points[:, i], truth["points"])
                    for i, truth in enumerate(record["contacts"])
                ]
                detail[f"{key} {law}{' compiled' * compiled}"] = max(errors)
    worst = max(detail.values())
    yield Bar("K1-K4, points / size, against 30 digits", 1e-12, worst, detail=detail)


def stiff_slip_scenes(full: bool) -> Iterator[Bar]:
    """Slip under gains up to 1e7/s, on sphere and ellipsoid, against 30-digit references."""
    detail: dict[str, float] = {}
    for name in ("sphere_slip", "ellipsoid_slip"):
        for key, record in load(name)["scenes"].items():
            scene = scene_of(record)
            truth = record["contacts"][0]["points"]
            for compiled in engines():
                points = cs.plan(scene, 1e-12, compiled=compiled).points(record["times"])[:, 0]
                error = point_error(scene, 0, points, truth)
                detail[f"{name} {key}{' compiled' * compiled}"] = error
    worst = max(detail.values())
    yield Bar("slip scenes, points / size, against 30 digits", 1e-12, worst, detail=detail)


# --- the slip law ------------------------------------------------------------------------------


def _hyperboloid(*signs: int) -> cs.Quadric:
    """x^T A x = 1 with semi-axes 0.3, 0.2, 0.1, turned so that no axis is special."""
    c, s = math.cos(0.4), math.sin(0.4)
    about_z, about_x = [[c, -s, 0], [s, c, 0], [0, 0, 1]], [[1, 0, 0], [0, c, -s], [0, s, c]]
    turn = np.array(about_z) @ np.array(about_x)
    a = turn @ np.diag([k / r**2 for k, r in zip(signs, (0.3, 0.2, 0.1), strict=True)]) @ turn.T
    return cs.Quadric(0.5 * (a + a.T))


def _ground(u: Any, v: Any) -> list[Any]:
    """A chart that is not orthogonal."""
    return [u + 0.3 * v, v, 0.01 * np.cos(20 * u) * np.cos(20 * v)]


def _rounded_cube(x: Any) -> Any:
    return (x[0] / 0.1) ** 4 + (x[1] / 0.1) ** 4 + (x[2] / 0.1) ** 4 - 1


def surfaces() -> dict[str, tuple[cs.Surface, tuple[float, float]]]:
    """Every kind of surface, with a contact on it."""
    return {
        "plane": (cs.Plane(), (0.1, -0.2)),
        "sphere": (cs.Sphere(0.1), (1.2, 0.3)),
        "bowl": (cs.Sphere(0.2, inside=True), (1.2, 0.3)),
        "cylinder": (cs.Cylinder(0.1), (0.5, 0.02)),
        "torus": (cs.Torus(0.2, 0.08), (0.3, 2.0)),
        "ellipsoid": (cs.Ellipsoid(0.3, 0.2, 0.1), (0.7, 0.4)),
        "oblate": (cs.Ellipsoid(0.2, 0.2, 0.1), (0.7, 0.4)),
        "prolate": (cs.Ellipsoid(0.2, 0.1, 0.1), (0.9, 0.4)),
        "one sheet": (_hyperboloid(1, 1, -1), (0.7, 0.2)),
        "two sheets": (_hyperboloid(1, -1, -1), (0.3, 0.2)),
        "chart, not orthogonal": (cs.ParametricSurface(_ground, size=0.1), (0.02, 0.03)),
        "implicit": (cs.ImplicitSurface(_rounded_cube, size=0.1), (math.pi / 3, math.pi / 5)),
    }


def slip_law(full: bool) -> Iterator[Bar]:
    """|v_rel| = |v_rel|(0) sigma/sigma(0) exp(-L) on every surface, under three gain laws."""
    detail: dict[str, float] = {}
    for name, (surface, at) in surfaces().items():
        finger = cs.Sphere(0.04)
        contact = cs.Contact(finger=finger, object_at=at, angle=0.3, object_velocity=(0.2, -0.9))
        for gain in (cs.Gain.path(100.0), cs.Gain.time(4.0), cs.Gain.guaranteed(2.0)):
            scene = cs.Scene(
                object=surface, contacts=[contact], profile=cs.Profile([0.02, 0, 0.3]),
                gain=gain, duration=1.0,
            )  # fmt: skip
            errors = [_slip_law_error(scene, compiled) for compiled in engines()]
            detail[f"{name}, {gain.law}"] = max(errors)
    worst = max(detail, key=lambda k: detail[k])
    note = f"worst: {worst}"
    name = "slip law, relative to the greatest slip"
    yield Bar(name, 1e-12, detail[worst], note=note, detail=detail)


def _slip_law_error(scene: cs.Scene, compiled: bool) -> float:
    """Of the states' slip and of Plan.slip: magnitude against the law; and their difference."""
    t = np.linspace(0.0, scene.duration, 101)
    plan = cs.plan(scene, compiled=compiled)
    rates, told = slip_from_states(scene, plan.states(t))[:, 0], plan.slip(t)[:, 0]
    profile, contact = scene.profile, scene.contacts[0]
    start = contact_map(contact.angle) @ contact.finger_velocity - contact.object_velocity
    law = np.hypot(*start) * profile(t) * np.exp(-scene.gain.exponent(profile, t))
    differences = [np.hypot(*rates.T) - law, np.hypot(*told.T) - law, *(rates - told).T]
    return float(max(np.abs(d).max() for d in differences) / law.max())


# --- 1000 revolutions --------------------------------------------------------------------------

REVOLUTIONS = 1000


def revolutions(full: bool) -> Iterator[Bar]:
    """Geodesics of spheres and cylinders over 1000 revolutions against mpmath."""
    try:
        import mpmath
    except ImportError:
        yield Bar("1000 revolutions, sphere and cylinder", 1e-12, None, note="mpmath not installed")
        return
    random = np.random.default_rng(1000)
    for kind, truth in ((cs.Sphere, great_circle), (cs.Cylinder, helix)):
        errors, spacings = [], []
        for _ in range(60 if full else 12):
            radius, heading = random.uniform(0.02, 2.0), random.uniform(-math.pi / 4, math.pi / 4)
            at = (random.uniform(0.5, 2.5), random.uniform(-3.0, 3.0) * radius)
            w = (math.cos(heading), math.sin(heading))
            scene = _long_scene(kind(radius), at, w, random)
            t = np.append(np.sort(random.uniform(0.0, scene.duration, 30)), scene.duration)
            found = cs.plan(scene).points(t)[:, 0, 1]
            with mpmath.workdps(40):
                lengths = [arc_length(mpmath, scene.profile, time) for time in t]
                exact = np.array([truth(mpmath, radius, at, w, s) for s in lengths])
            errors.append(np.linalg.norm((found - exact).astype(float), axis=1).max() / radius)
            spacings.append(np.spacing(np.abs(found).max()) / radius)
        note = f"float64 spacing of the coordinates: {max(spacings):.1e} of the radius"
        name = f"{kind.__name__.lower()}, {REVOLUTIONS} revolutions, of the radius"
        yield Bar(name, 1e-12, max(errors), note=note, detail={"errors": errors})


def _long_scene(
    surface: cs.Surface,
    at: tuple[float, float],
    w: tuple[float, float],
    random: np.random.Generator,
) -> cs.Scene:
    """Rolls a plane along a geodesic of the surface; the profile and its horizon are random."""
    coefficients = random.uniform(0.1, 1.0, random.integers(1, 5))
    profile = cs.Profile(coefficients)
    around = math.hypot(*w) if isinstance(surface, cs.Sphere) else w[0]
    goal = REVOLUTIONS * 2 * math.pi * surface.size / around
    low, high = 0.0, goal / coefficients[0]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if profile.arc_length(middle) < goal else (low, middle)
    contact = cs.Contact(
        finger=cs.Plane(), object_at=at, finger_at=(0.0, 0.0), finger_velocity=(w[0], -w[1]),
        object_velocity=w,
    )  # fmt: skip
    return cs.Scene(object=surface, contacts=[contact], profile=profile, duration=high)


def arc_length(mp: Any, profile: cs.Profile, t: float) -> Any:
    """s(t) in mpmath, m."""
    powers = enumerate(profile.coefficients)
    return mp.fsum(mp.mpf(c) * mp.mpf(t) ** (k + 1) / (k + 1) for k, c in powers)


def great_circle(
    mp: Any, radius: float, at: tuple[Any, Any], w: tuple[Any, Any], s: Any
) -> list[Any]:
    """Point of a sphere at arc length s, from chart coordinates ``at`` along path velocity w."""
    (u, v), r, pace = map(mp.mpf, at), mp.mpf(radius), mp.hypot(*map(mp.mpf, w))
    normal = [mp.sin(u) * mp.cos(v), mp.sin(u) * mp.sin(v), mp.cos(u)]
    x_axis = [mp.cos(u) * mp.cos(v), mp.cos(u) * mp.sin(v), -mp.sin(u)]
    y_axis = [-mp.sin(v), mp.cos(v), mp.mpf(0)]
    phase = pace * s / r
    along = [(w[0] * a + w[1] * b) / pace for a, b in zip(x_axis, y_axis, strict=True)]
    return [r * (mp.cos(phase) * n + mp.sin(phase) * e) for n, e in zip(normal, along, strict=True)]


def helix(mp: Any, radius: float, at: tuple[Any, Any], w: tuple[Any, Any], s: Any) -> list[Any]:
    """The same on a cylinder."""
    (u, v), r = map(mp.mpf, at), mp.mpf(radius)
    turned = u + w[0] * s / r
    return [r * mp.cos(turned), r * mp.sin(turned), v + w[1] * s]


# --- ellipsoids --------------------------------------------------------------------------------


def geodesic_scene(
    surface: cs.Surface,
    at: tuple[float, float],
    direction: tuple[float, float],
    length: float,
    finger_at: tuple[float, float] = (math.pi / 2, 0.0),
) -> cs.Scene:
    """A sphere rolls at 1 m/s; the object's contact curve is the geodesic."""
    x, y = direction
    contact = cs.Contact(
        finger=cs.Sphere(0.04), object_at=at, finger_at=finger_at, finger_velocity=(x, -y),
        object_velocity=(x, y),
    )  # fmt: skip
    return cs.Scene(object=surface, contacts=[contact], profile=cs.Profile([1.0]), duration=length)


def triaxial(full: bool) -> Iterator[Bar]:
    """200 geodesics of 3 m on the ellipsoid 0.3/0.2/0.1; Jacobi's integral along each."""
    data = load("ellipsoid_geodesics")
    axes, length = data["axes"], float(data["length"])
    surface = cs.Ellipsoid(*axes)
    errors, drifts, from_start = [], [], []
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
        size = np.abs(terms).sum(axis=1)
        drift = np.abs(terms.sum(axis=1) - data["jacobi"][k]).max()
        drifts.append(drift / size.max())
        from_start.append(drift / size[0])
    detail = {"errors [m]": errors, "drifts": drifts, "drifts over terms at start": from_start}
    yield Bar("ellipsoid 0.3/0.2/0.1, 200 geodesics of 3 m", 1e-13, max(errors), "m", detail=detail)
    name = "the same: Jacobi's integral, relative"
    note = f"median {np.median(drifts):.1e}; over its terms at the start {max(from_start):.1e}"
    yield Bar(name, 1e-13, max(drifts), note=note)


def _jacobi(surface: cs.Ellipsoid, states: np.ndarray) -> np.ndarray:
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
    name = "ellipsoids of revolution against geographiclib, of a"
    try:
        from geographiclib.geodesic import Geodesic
    except ImportError:
        yield Bar(name, 1e-13, None, note="geographiclib not installed")
        return
    random = np.random.default_rng(2013)
    errors: dict[str, float] = {"oblate": 0.0, "prolate": 0.0}
    for _ in range(200):
        f = random.uniform(-0.01, 0.01)
        latitude, azimuth = random.uniform(-85, 85), random.uniform(-180, 180)
        length = random.uniform(0.1, 2.5) * 2 * math.pi
        end = Geodesic(1.0, f).Direct(latitude, 0.0, azimuth, length)
        scene = _spheroid_scene(f, latitude, azimuth, length)
        found = cs.plan(scene, tolerance=1e-15).points([length])[0, 0, 1]
        truth = _spheroid_point(f, end["lat2"], end["lon2"])
        kind = "oblate" if f > 0 else "prolate"
        errors[kind] = max(errors[kind], float(np.linalg.norm(found - truth)))
    note = "geographiclib itself: about 2.4e-15"
    yield Bar(name, 1e-13, max(errors.values()), note=note, detail=errors)


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


def _spheroid_point(f: float, latitude: float, longitude: float) -> np.ndarray:
    beta, turn = _reduced(f, latitude), math.radians(longitude)
    around = (math.cos(beta) * math.cos(turn), math.cos(beta) * math.sin(turn))
    axial = (1 - f) * math.sin(beta)
    return np.array([*around, axial] if f > 0 else [axial, *around])


# --- chart round trip --------------------------------------------------------------------------


def round_trip(full: bool) -> Iterator[Bar]:
    """(u, v) -> x -> (u, v) -> x, in x, at random points, on seams, 1e-9 from singular points."""
    random = np.random.default_rng(4)
    detail = {}
    for name, (surface, at) in surfaces().items():
        u, v = _trip_coordinates(name, at, random)
        x = surface.point(u, v)
        again = surface.point(*surface.coordinates(x))
        detail[name] = float(np.linalg.norm(again - x, axis=1).max() / surface.size)
    worst = max(detail, key=lambda k: detail[k])
    note = f"worst: {worst}"
    name = "chart round trip, all surfaces, of the size"
    yield Bar(name, 4e-15, detail[worst], note=note, detail=detail)


def _trip_coordinates(
    name: str, at: tuple[float, float], random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Random coordinates of a surface, and its difficult ones."""
    half, near = math.pi / 2, [1e-9, -1e-9, 1e-5, -1e-5]
    n = 2000
    turn, other = random.uniform(-math.pi, math.pi, (2, n))
    latitude, polar = random.uniform(-half, half, n), random.uniform(0, math.pi, n)
    local = 0.05 * random.standard_normal((2, n))
    if name in ("sphere", "bowl", "prolate", "implicit"):
        poles = np.array([1e-9, 1e-5, math.pi - 1e-9, math.pi - 1e-5])
        around = np.repeat([0.0, 1.0, half, math.pi, -half, -2.5], 4)
        return np.append(polar, np.tile(poles, 6)), np.append(turn, around)
    if name == "oblate":
        poles = np.array([half - 1e-9, half - 1e-5, 1e-9 - half, 1e-5 - half])
        around = np.repeat([0.0, 1.0, half, math.pi, -half, -2.5], 4)
        return np.append(turn, around), np.append(latitude, np.tile(poles, 6))
    if name == "ellipsoid":
        seam = np.where(random.random(n) < 0.5, half, -half)
        offset = np.array([(d, e) for d in [0.0, *near] for e in [0.0, *near]])
        umbilics = [(u, v) for u in (0.0, math.pi) for v in (half, -half)]
        us, vs = zip(*((u + offset[:, 0], v + offset[:, 1]) for u, v in umbilics), strict=True)
        u = np.concatenate([turn, other, *us])
        return u, np.concatenate([latitude, seam, *vs])
    if name == "torus":
        return turn, other
    if name in ("cylinder", "one sheet"):
        return turn, 4 * local[0]
    return at[0] + local[0], at[1] + local[1]


SECTIONS = {
    "paper": paper_scenes,
    "stiff": stiff_slip_scenes,
    "slip law": slip_law,
    "revolutions": revolutions,
    "triaxial": triaxial,
    "spheroids": spheroids,
    "round trip": round_trip,
}
