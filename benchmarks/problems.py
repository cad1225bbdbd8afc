"""Problems of the work-precision diagrams: scene, 30-digit truth, and equations for the peers.

Truth is data of ``tests/oracles``. The peers' equations are written out once, over any module with
sin, cos and sqrt, so that each integrator has them in its own arithmetic: the paper's chart
equations (theory section 2) and, for geodesics, x" = -(x'^T Hess F x')/|grad F|^2 grad F in space,
which has no trigonometry.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from oracles.load import load, scene_of, surface_of

import contact_system as cs
from contact_system.chart_solution import initial_state
from contact_system.starts import scene_start

from .accuracy import chart_points, geodesic_scene

Rates = Callable[[Any, Any, Sequence[Any], Sequence[Any]], list[Any]]
"""(module with sin, cos, sqrt; t; state; parameters) -> state'."""


@dataclass(frozen=True)
class Piece:
    """An interval without edges inside.

    Attributes
    ----------
    times : (n,), outputs, both ends included, s
    parameters : constant on the interval
    """

    times: np.ndarray
    parameters: np.ndarray


@dataclass(frozen=True, eq=False)
class Ode:
    """An initial value problem for each contact of a problem.

    Attributes
    ----------
    key : str
        Problems with the same key have the same right-hand side.
    rates : callable
    starts : (n_contacts, n_states)
    pieces : in the order of time, each starting where the one before ends
    points : callable
        States (n, n_states) -> contact points (n, n_bodies, 3), m.
    """

    key: str
    rates: Rates
    starts: np.ndarray
    pieces: tuple[Piece, ...]
    points: Callable[[np.ndarray], np.ndarray]

    def all_points(self, states: Sequence[np.ndarray]) -> np.ndarray:
        """States (n, n_states) of each contact -> (n, n_contacts, n_bodies, 3), m."""
        return np.stack([self.points(rows) for rows in states], axis=1)


@dataclass(frozen=True, eq=False)
class Problem:
    """What all methods solve.

    Attributes
    ----------
    name : str
    make : callable
        A new scene.
    times : (n,), s
    truth : (n, n_contacts, n_bodies, 3), contact points, m
    sizes : (n_bodies,), m
    forms : name -> Ode
    """

    name: str
    make: Callable[[], cs.Scene]
    times: np.ndarray
    truth: np.ndarray
    sizes: np.ndarray
    forms: dict[str, Ode]

    def of_plan(self, plan: cs.Plan) -> np.ndarray:
        """Contact points of a plan, the layout of ``truth``."""
        return plan.points(self.times)[:, :, 2 - len(self.sizes) :]

    def error(self, points: np.ndarray) -> float:
        """Greatest distance from the truth, of the body's size."""
        return float((np.linalg.norm(points - self.truth, axis=3) / self.sizes).max())


def problems() -> Iterator[Problem]:
    """All of them."""
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


# --- rolling with slip -------------------------------------------------------------------------


def _rolling(name: str, record: dict[str, Any]) -> Problem:
    scene = scene_of(record)
    times = record["times"]
    truth = np.stack([c["points"] for c in record["contacts"]], axis=1)
    sizes = np.array([record["finger_radius"], scene.object.size])
    return Problem(
        name, partial(scene_of, record), times, truth, sizes, {"chart": chart_form(scene, times)}
    )


def chart_form(scene: cs.Scene, times: np.ndarray) -> Ode:
    """The paper's equations of one contact, gain law `path`: u1 v1 u1' v1' u2 v2 u2' v2' psi.

    Parameters: eta, the accelerations added to u1" v1" u2" v2", the profile's coefficients.
    """
    finger, obj = scene.contacts[0].finger, scene.object

    def rates(m: Any, t: Any, x: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        u1, v1, a1, b1, u2, v2, a2, b2, psi = (x[i] for i in range(9))
        sigma = p[5] + t * (p[6] + t * p[7])
        growth = (p[6] + 2.0 * t * p[7]) / sigma
        lam = p[0] * sigma * sigma
        tip, body = metric(finger, m, u1, v1, a1, b1), metric(obj, m, u2, v2, a2, b2)
        forward, sideways = tip.lame[0] * a1, tip.lame[1] * b1
        cos, sin = m.cos(psi), m.sin(psi)
        rolled = (cos * forward - sin * sideways, -sin * forward - cos * sideways)
        return [
            a1, b1, growth * a1 + tip.bend[0] + p[1], growth * b1 + tip.bend[1] + p[2],
            a2, b2,
            growth * a2 + body.bend[0] + lam * (rolled[0] / body.lame[0] - a2) + p[3],
            growth * b2 + body.bend[1] + lam * (rolled[1] / body.lame[1] - b2) + p[4],
            tip.spin + body.spin,
        ]  # fmt: skip

    starts = [initial_state(scene, i, scene_start(c), 0.0) for i, c in enumerate(scene.contacts)]
    pieces = tuple(_pieces(scene, times))
    points = partial(chart_points, scene)
    return Ode(f"chart {finger!r} {obj!r}", rates, np.stack(starts), pieces, points)


def _pieces(scene: cs.Scene, times: np.ndarray) -> Iterator[Piece]:
    coefficients = [*scene.profile.coefficients, 0.0, 0.0][:3]
    for begin, end in zip(scene.edges, scene.edges[1:]):
        pushed = np.zeros(4)
        for d in scene.disturbances:
            if d.contact == 0 and d.start <= begin and end <= d.stop:
                first = 0 if isinstance(d, cs.FingerAcceleration) else 2
                pushed[first : first + 2] += d.value
        inside = times[(begin <= times) & (times <= end)]
        yield Piece(inside, np.array([scene.gain.value, *pushed, *coefficients]))


@dataclass(frozen=True)
class Metric:
    """h_u, h_v; -Gamma^k_ij q'_i q'_j; T M q'."""

    lame: Sequence[Any]
    bend: Sequence[Any]
    spin: Any


def metric(surface: cs.Surface, m: Any, u: Any, v: Any, du: Any, dv: Any) -> Metric:
    """Of the charts of theory section 1, by hand."""
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


# --- geodesics ---------------------------------------------------------------------------------


def _geodesic(name: str, record: dict[str, Any]) -> Problem:
    surface, (x, y) = surface_of(record["object"]), record["velocity"]
    start = {"at": tuple(record["at"]), "direction": (x, y), "finger_at": (1.5, 0.2)}
    make = partial(geodesic_scene, surface, length=record["duration"], **start)
    forms = {"chart": _geodesic_on_chart(record), "space": _geodesic_in_space(record)}
    return Problem(
        f"geodesic {name}", make, record["times"], record["points"][:, None, None],
        np.array([surface.size]), forms,
    )  # fmt: skip


def _geodesic_on_chart(record: dict[str, Any]) -> Ode:
    surface, w = surface_of(record["object"]), record["velocity"]

    def rates(m: Any, t: Any, x: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        bend = metric(surface, m, x[0], x[1], x[2], x[3]).bend
        return [x[2], x[3], bend[0] + 0.0 * x[2], bend[1] + 0.0 * x[3]]

    lame = metric(surface, np, *record["at"], 0.0, 0.0).lame
    start = np.array([*record["at"], w[0] / lame[0], w[1] / lame[1]])
    return Ode(
        f"geodesic chart {surface!r}", rates, start[None], (Piece(record["times"], np.zeros(0)),),
        lambda states: surface.point(states[:, 0], states[:, 1])[:, None],
    )  # fmt: skip


def _geodesic_in_space(record: dict[str, Any]) -> Ode:
    surface, at = surface_of(record["object"]), record["at"]

    def rates(m: Any, t: Any, x: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        place, pace = [x[i] for i in range(3)], [x[i] for i in range(3, 6)]
        slope, bend = _implicit(surface, m, place, pace)
        factor = -bend / sum(g * g for g in slope)
        return [*pace, *(factor * g for g in slope)]

    start = np.append(surface.point(*at), surface.frame(*at)[:, :2] @ record["velocity"])
    return Ode(
        f"geodesic space {surface!r}", rates, start[None], (Piece(record["times"], np.zeros(0)),),
        lambda states: states[:, None, :3],
    )  # fmt: skip


def _implicit(surface: cs.Surface, m: Any, x: list[Any], p: list[Any]) -> tuple[list[Any], Any]:
    """grad F and p^T (Hess F) p, both up to one factor."""
    if isinstance(surface, cs.Torus):  # F = (rho - R)^2 + z^2 - r^2 over 2
        square = x[0] * x[0] + x[1] * x[1]
        rho = m.sqrt(square)
        pull, along = surface.major / rho, x[0] * p[0] + x[1] * p[1]
        slope = [(1.0 - pull) * x[0], (1.0 - pull) * x[1], x[2]]
        flat = (1.0 - pull) * (p[0] * p[0] + p[1] * p[1]) + p[2] * p[2]
        return slope, flat + pull * along * along / square
    if isinstance(surface, cs.Ellipsoid):
        diagonal = [1.0 / r**2 for r in (surface.a, surface.b, surface.c)]
    else:
        diagonal = [1.0, 1.0, 1.0 if isinstance(surface, cs.Sphere) else 0.0]
    slope = [d * c for d, c in zip(diagonal, x)]
    return slope, sum(d * c * c for d, c in zip(diagonal, p))
