"""Problems with a known answer: scene, truth, and equations for other libraries.

Truth has 25 to 30 digits; it is data of ``tests/oracles`` or a closed form in mpmath. The peers'
equations are written out once, over any module with sin, cos and sqrt, so that each integrator has
them in its own arithmetic: the paper's chart equations (theory section 2) and, for geodesics, x" =
-(x'^T Hess F x')/|grad F|^2 grad F in space, which has no trigonometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mpmath as mp
import numpy as np
from oracles.formulas import arc_length, geodesic_rates, great_circle
from oracles.load import load, scene_of, surface_of

import contact_system as cs

Array = np.ndarray
Rates = Callable[[Any, Any, Sequence[Any], Sequence[Any]], list[Any]]
"""(module with sin, cos, sqrt; t; state; parameters) -> state'."""


@dataclass(frozen=True)
class Piece:
    """An interval without edges inside: output times (n,), with both ends, s; parameters."""

    times: Array
    parameters: Array


@dataclass(frozen=True, eq=False)
class Ode:
    """An initial value problem for each contact of a problem."""

    rates: Rates
    starts: Array  # (n_contacts, n_states)
    pieces: tuple[Piece, ...]  # each starts where the one before ends
    points: Callable[[Array], Array]  # (n, n_states) -> contact points (n, n_bodies, 3), m

    def all_points(self, states: Sequence[Array]) -> Array:
        """States (n, n_states) of each contact -> (n, n_contacts, n_bodies, 3), m."""
        return np.stack([self.points(rows) for rows in states], axis=1)


@dataclass(frozen=True, eq=False)
class Problem:
    """A problem that all methods solve."""

    name: str
    make: Callable[[], cs.Scene]  # a new scene each time
    times: Array  # (n,), s
    truth: Array  # contact points (n, n_contacts, n_bodies, 3), m
    sizes: Array  # (n_bodies,), m
    forms: dict[str, Ode]
    output: str = "points"  # of a plan; points that follow from "states" are not timed

    def solve(self, tolerance: float, scene: cs.Scene) -> Array:
        """Plan a scene and evaluate the output."""
        return getattr(cs.plan(scene, tolerance), self.output)(self.times)

    def points(self, found: Array) -> Array:
        """Contact points of a result of `solve`, in the layout of ``truth``."""
        if self.output == "states":
            found = points_of_states(self.make(), found)
        return found[:, :, 2 - len(self.sizes) :]

    def error(self, points: Array) -> float:
        """Greatest distance from the truth, over the body's size."""
        return float((np.linalg.norm(points - self.truth, axis=3) / self.sizes).max())


def points_of_states(scene: cs.Scene, states: Array) -> Array:
    """Contact points of chart states: (n, n_contacts, 9) -> (n, n_contacts, 2, 3), m."""
    pairs = [_pair(c.finger, scene.object, states[:, i]) for i, c in enumerate(scene.contacts)]
    return np.stack(pairs, axis=1)


def _pair(finger: cs.Surface, obj: cs.Surface, s: Array) -> Array:
    return np.stack([finger.point(s[:, 0], s[:, 1]), obj.point(s[:, 4], s[:, 5])], axis=1)


def problems() -> Iterator[Problem]:
    """All problems of `work_precision`."""
    for name, record in load("geodesics")["geodesics"].items():
        yield _geodesic(name, record)
    peaks = load("slip_peaks")["scenes"]
    for kind in ("sphere", "ellipsoid"):
        stiffest = load(f"{kind}_slip")["scenes"]["path peak 1e7"]
        own = {k.split()[-1]: v for k, v in peaks.items() if k.startswith(kind)}
        for peak, record in (own | {"1e+07": stiffest}).items():
            yield _rolling(f"slip sphere-{kind} {peak.replace('+0', '')}", record)
    scenes = load("k_scenes")["scenes"]
    for name in ("K2", "K4"):
        yield _rolling(f"disturbed {name}", scenes[name])


def _rolling(name: str, record: dict[str, Any]) -> Problem:
    scene, times = scene_of(record), record["times"]
    truth = np.stack([c["points"] for c in record["contacts"]], axis=1)
    forms = {"chart": chart(scene, times)}
    return Problem(name, partial(scene_of, record), times, truth, sizes_of(scene), forms)


def sizes_of(scene: cs.Scene) -> Array:
    """Sizes of finger and object, (2,), m."""
    return np.array([scene.contacts[0].finger.size, scene.object.size])


def chart(scene: cs.Scene, times: Array, slip: bool = True) -> Ode:
    """The paper's equations of a contact, gain law `path`: u1 v1 u1' v1' u2 v2 u2' v2' psi.

    Parameters: eta, if it slips; in disturbed scenes also the terms added to u1" v1" u2" v2".
    """
    finger, obj = scene.contacts[0].finger, scene.object
    c0, c1, c2 = (*scene.profile.coefficients, 0.0, 0.0)[:3]

    def rates(m: Any, t: Any, x: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        u1, v1, a1, b1, u2, v2, a2, b2, psi = (x[i] for i in range(9))
        sigma = c0 + t * (c1 + t * c2)
        growth = (c1 + 2.0 * c2 * t) / sigma
        tip, body = metric(finger, m, u1, v1, a1, b1), metric(obj, m, u2, v2, a2, b2)
        found = [growth * a1 + tip.bend[0], growth * b1 + tip.bend[1]]
        found += [growth * a2 + body.bend[0], growth * b2 + body.bend[1]]
        if slip:
            lam, cos, sin = p[0] * sigma * sigma, m.cos(psi), m.sin(psi)
            forward, sideways = tip.lame[0] * a1, tip.lame[1] * b1
            found[2] += lam * ((cos * forward - sin * sideways) / body.lame[0] - a2)
            found[3] += lam * ((-sin * forward - cos * sideways) / body.lame[1] - b2)
        if scene.disturbances:
            found = [rate + p[1 + k] for k, rate in enumerate(found)]
        return [a1, b1, *found[:2], a2, b2, *found[2:], tip.spin + body.spin]

    starts = cs.SceneSystem(scene, "chart").x0.reshape(-1, 9)
    return Ode(rates, starts, tuple(_pieces(scene, times, slip)), partial(_pair, finger, obj))


def _pieces(scene: cs.Scene, times: Array, slip: bool) -> Iterator[Piece]:
    for begin, end in zip(scene.edges, scene.edges[1:]):
        pushed = np.zeros(4 * bool(scene.disturbances))
        for d in scene.disturbances:
            if d.contact == 0 and d.start <= begin and end <= d.stop:
                first = 0 if isinstance(d, cs.FingerAcceleration) else 2
                pushed[first : first + 2] += d.value
        inside = times[(begin <= times) & (times <= end)]
        yield Piece(inside, np.append([scene.gain.value] * slip, pushed))


@dataclass(frozen=True)
class Metric:
    """h_u, h_v; -Gamma^k_ij q'_i q'_j; T M q'."""

    lame: Sequence[Any]
    bend: Sequence[Any]
    spin: Any


def metric(surface: cs.Surface, m: Any, u: Any, v: Any, du: Any, dv: Any) -> Metric:
    """The metric of a chart of theory section 1, derived by hand."""
    if isinstance(surface, cs.Cylinder):
        return Metric((surface.radius, 1.0), (0.0, 0.0), 0.0)
    if isinstance(surface, cs.Sphere):
        su, cu = m.sin(u), m.cos(u)
        r = surface.radius
        return Metric((r, r * su), (su * cu * dv * dv, -2.0 * (cu / su) * du * dv), cu * dv)
    if isinstance(surface, cs.Torus):
        sv, r = m.sin(v), surface.minor
        rho = surface.major + r * m.cos(v)
        return Metric((rho, r), (2.0 * r * sv / rho * du * dv, -rho * sv / r * du * du), sv * du)
    return _ellipsoid_metric(surface, m, u, v, du, dv)


def _ellipsoid_metric(surface: cs.Ellipsoid, m: Any, u: Any, v: Any, du: Any, dv: Any) -> Metric:
    """h_u^2 = p A(u), h_v^2 = p B(v) (eq. `ellipsoid`), p = l sin^2 u + k cos^2 v, k + l = 1."""
    su, cu, sv, cv = m.sin(u), m.cos(u), m.sin(v), m.cos(v)
    a2, b2, c2 = surface.a**2, surface.b**2, surface.c**2
    k, ell = (b2 - c2) / (a2 - c2), (a2 - b2) / (a2 - c2)
    p = ell * su * su + k * cv * cv
    up, down = a2 * su * su + b2 * cu * cu, k + ell * su * su
    top, under = b2 * sv * sv + c2 * cv * cv, ell + k * cv * cv
    big_a, big_b = up / down, top / under
    p_u, p_v = 2.0 * ell * su * cu / p, -2.0 * k * sv * cv / p
    a_u = 2.0 * su * cu * ((a2 - b2) / up - ell / down)  # A'/A
    b_v = 2.0 * sv * cv * ((b2 - c2) / top + k / under)  # B'/B
    ratio = big_b / big_a
    bend_u = 0.5 * ((p_u + a_u) * du * du - ratio * p_u * dv * dv) + p_v * du * dv
    bend_v = 0.5 * ((p_v + b_v) * dv * dv - p_v / ratio * du * du) + p_u * du * dv
    root = m.sqrt(ratio)
    spin = 0.5 * (p_u * root * dv - p_v / root * du)
    return Metric((m.sqrt(p * big_a), m.sqrt(p * big_b)), (-bend_u, -bend_v), spin)


def geodesic_scene(
    surface: cs.Surface, at: tuple[float, float], direction: tuple[float, float], length: float
) -> cs.Scene:
    """A sphere rolls at 1 m/s; the object's contact curve is the geodesic."""
    x, y = direction
    contact = cs.Contact(cs.Sphere(0.04), at, finger_velocity=(x, -y), object_velocity=(x, y))
    return cs.Scene(object=surface, contacts=[contact], profile=cs.Profile([1.0]), duration=length)


def _geodesic(name: str, record: dict[str, Any]) -> Problem:
    body, velocity = record["object"], tuple(record["velocity"])
    surface = surface_of(body)
    at, times = tuple(record["at"]), record["times"]
    pieces = (Piece(times, np.zeros(0)),)

    def on_chart(m: Any, t: Any, x: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        bend = metric(surface, m, x[0], x[1], x[2], x[3]).bend
        return [x[2], x[3], bend[0] + 0.0 * x[2], bend[1] + 0.0 * x[3]]

    def in_space(m: Any, t: Any, x: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        return geodesic_rates(body["surface"], body["radii"].tolist(), m, x)

    def of_chart(states: Array) -> Array:
        return surface.point(states[:, 0], states[:, 1])[:, None]

    lame = metric(surface, np, *at, 0.0, 0.0).lame
    chart = np.array([[*at, velocity[0] / lame[0], velocity[1] / lame[1]]])
    space = np.append(surface.point(*at), surface.frame(*at)[:, :2] @ velocity)[None]
    forms = {
        "chart": Ode(on_chart, chart, pieces, of_chart),
        "space": Ode(in_space, space, pieces, lambda x: x[:, None, :3]),
    }
    make = partial(geodesic_scene, surface, at, velocity, record["duration"])
    truth, sizes = record["points"][:, None, None], np.array([surface.size])
    return Problem(f"geodesic {name}", make, times, truth, sizes, forms)


def no_slip(output: str, count: int) -> Problem:
    """Great circles on both spheres, as "points" in space or as "states" on charts."""
    pace, profile = math.sqrt(0.5), cs.Profile([0.001, 0.0, 0.4])
    bodies = [
        (cs.Sphere(0.04), (1.4, 0.1), (pace, pace)),
        (cs.Sphere(0.1), (1.1, 0.5), (pace, -pace)),  # psi = 0 turns y about
    ]
    (finger, finger_at, w), (obj, object_at, _) = bodies

    def make() -> cs.Scene:
        contact = cs.Contact(finger, object_at, finger_at, finger_velocity=w)
        return cs.Scene(object=obj, contacts=[contact], profile=profile, duration=1.0)

    def rates(m: Any, t: Any, x: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        found = []
        for k, (body, _, _) in enumerate(bodies):
            place, path = x[6 * k : 6 * k + 3], x[6 * k + 3 : 6 * k + 6]
            square = sum(c * c for c in path) / body.radius**2
            found += [*path, *(-square * c for c in place)]
        return found

    times = np.linspace(0.0, 1.0, count)
    start = [[s.point(*at), s.frame(*at)[:, :2] @ along] for s, at, along in bodies]
    pieces = (Piece(profile.arc_length(times), np.zeros(0)),)
    space = Ode(rates, np.reshape(start, (1, 12)), pieces, _of_space)
    forms = {"points": {"space": space}, "states": {"chart": chart(make(), times, slip=False)}}
    truth = _great_circles(profile, bodies, times)[:, None]
    sizes = sizes_of(make())
    return Problem(f"no slip, {output}", make, times, truth, sizes, forms[output], output)


def _of_space(states: Array) -> Array:
    """Points of both bodies; for each, states hold a point and a path velocity."""
    return states.reshape(-1, 2, 6)[:, :, :3]


def _great_circles(profile: cs.Profile, bodies: Any, times: Array) -> Array:
    """Contact points in closed form, (n, 2, 3), m."""
    with mp.workdps(40):
        lengths = [arc_length(profile.coefficients, t) for t in times]
        rows = [[great_circle(b.radius, at, w, s) for b, at, w in bodies] for s in lengths]
        return np.array(rows, dtype=float)
