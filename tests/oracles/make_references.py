"""Reference solutions of high precision: external truth for the tests.

Nothing here imports ``contact_system``. The paper's chart equations (theory section 2: eq.
`contrac` with the errata of the README, plus Montana's angle equation) are stated once more in
heyoka expressions and integrated by an adaptive Taylor method in multiple precision arithmetic
(Jorba and Zou, Experimental Mathematics 14, 2005; Biscani and Izzo, MNRAS 504, 2021). The metric
of each chart is written out by hand and checked against finite differences of the chart itself.
Every solution is computed twice: with two tolerances, hence two orders, two step sequences and two
precisions, or, where that is too slow, compared with the development form (theory section 4);
the greatest difference is stored with it and must stay below `AGREEMENT`.

Run ``python tests/oracles/make_references.py [name ...]`` with the names of `MAKERS`; without a
name everything is made, in about 20 minutes. heyoka (multiprecision build) and mpmath are needed.
All inputs are the doubles that a Python user would write; results are decimal strings.
SI units, angles in radians.
"""

from __future__ import annotations

import json
import math
import random
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import heyoka as hy
import mpmath as mp
from formulas import arc_length, geodesic_rates, great_circle, helix

DIGITS = 25
mp.mp.prec = 240
AGREEMENT = mp.mpf("1e-28")
#: (tolerance, precision in bits) of the two passes; the first is the one that is stored.
PASSES = (("1e-42", 220), ("1e-37", 190))
#: The same for stiff scenes, whose cost is the number of steps and not the smoothness.
STIFF_PASSES = (("1e-36", 180), ("1e-33", 165))

STATE = ("u1", "v1", "du1", "dv1", "u2", "v2", "du2", "dv2", "psi")
MPMATH = SimpleNamespace(sin=mp.sin, cos=mp.cos, sqrt=mp.sqrt)
HEYOKA = SimpleNamespace(sin=hy.sin, cos=hy.cos, sqrt=hy.sqrt)


# Surfaces: chart (theory section 1) and metric, for mpmath numbers and heyoka symbols alike.


@dataclass(frozen=True)
class Metric:
    """Squared Lame coefficients E = h_u^2, G = h_v^2 and their partial derivatives."""

    E: Any
    G: Any
    E_u: Any
    E_v: Any
    G_u: Any
    G_v: Any


def sphere_chart(p: Sequence[Any], u: Any, v: Any, m: Any) -> list[Any]:
    """Point of the sphere of radius p[0]."""
    return [p[0] * m.sin(u) * m.cos(v), p[0] * m.sin(u) * m.sin(v), p[0] * m.cos(u)]


def sphere_metric(p: Sequence[Any], u: Any, v: Any, m: Any) -> Metric:
    """Metric of `sphere_chart`."""
    r2 = p[0] * p[0]
    zero = 0 * r2
    return Metric(r2, r2 * m.sin(u) ** 2, zero, zero, 2 * r2 * m.sin(u) * m.cos(u), zero)


def torus_chart(p: Sequence[Any], u: Any, v: Any, m: Any) -> list[Any]:
    """Point of the torus of major radius p[0] and minor radius p[1]."""
    rho = p[0] + p[1] * m.cos(v)
    return [rho * m.cos(u), rho * m.sin(u), p[1] * m.sin(v)]


def torus_metric(p: Sequence[Any], u: Any, v: Any, m: Any) -> Metric:
    """Metric of `torus_chart`."""
    rho = p[0] + p[1] * m.cos(v)
    zero = 0 * p[0]
    return Metric(rho**2, p[1] * p[1], zero, -2 * rho * p[1] * m.sin(v), zero, zero)


def ellipsoid_chart(p: Sequence[Any], u: Any, v: Any, m: Any) -> list[Any]:
    """Point of the ellipsoid with semi-axes p in Jacobi's coordinates, eq. `ellipsoid`."""
    a2, b2, c2 = (axis * axis for axis in p)
    su, cu, sv, cv = m.sin(u), m.cos(u), m.sin(v), m.cos(v)
    root = m.sqrt(a2 - c2)
    return [
        p[0] * cu * m.sqrt(a2 - b2 * sv**2 - c2 * cv**2) / root,
        p[1] * su * cv,
        p[2] * sv * m.sqrt(a2 * su**2 + b2 * cu**2 - c2) / root,
    ]


def ellipsoid_metric(p: Sequence[Any], u: Any, v: Any, m: Any) -> Metric:
    """Metric of `ellipsoid_chart`: E = W P(u), G = W Q(v), the chart being of Liouville's type.

    With l3 = a^2 sin^2 u + b^2 cos^2 u and l2 = b^2 sin^2 v + c^2 cos^2 v (the confocal
    coordinates), W = l3 - l2, P = l3/(l3 - c^2) and Q = l2/(a^2 - l2).
    """
    a2, b2, c2 = (axis * axis for axis in p)
    su, cu, sv, cv = m.sin(u), m.cos(u), m.sin(v), m.cos(v)
    l3 = a2 * su**2 + b2 * cu**2
    l2 = b2 * sv**2 + c2 * cv**2
    W = l3 - l2
    W_u = 2 * (a2 - b2) * su * cu
    W_v = -2 * (b2 - c2) * sv * cv
    P, Q = l3 / (l3 - c2), l2 / (a2 - l2)
    P_u = -c2 * W_u / (l3 - c2) ** 2
    Q_v = -a2 * W_v / (a2 - l2) ** 2
    return Metric(W * P, W * Q, W_u * P + W * P_u, W_v * P, W_u * Q, W_v * Q + W * Q_v)


CHARTS = {
    "sphere": (sphere_chart, sphere_metric),
    "torus": (torus_chart, torus_metric),
    "ellipsoid": (ellipsoid_chart, ellipsoid_metric),
}


def christoffel(g: Metric) -> list[Any]:
    """G^1_11, G^1_12, G^1_22, G^2_11, G^2_12, G^2_22 of an orthogonal chart."""
    first = [g.E_u / (2 * g.E), g.E_v / (2 * g.E), -g.G_u / (2 * g.E)]
    return [*first, -g.E_v / (2 * g.G), g.G_u / (2 * g.G), g.G_v / (2 * g.G)]


def check_charts() -> mp.mpf:
    """Greatest error of metric and Christoffel symbols against differences of the chart.

    The symbols are those of eq. `christoffel`, f_k . f_ij / |f_k|^2, with mpmath's
    high-precision finite differences.

    Raises
    ------
    ArithmeticError
        If the error exceeds 1e-30.
    """
    worst = mp.mpf(0)
    cases = [("sphere", (0.04,)), ("torus", (0.1, 0.03)), ("ellipsoid", (0.3, 0.2, 0.1))]
    for name, radii in cases:
        chart, metric = CHARTS[name]
        p = [mp.mpf(r) for r in radii]
        for u, v in [(0.7, 0.4), (2.1, -1.3), (1.1, math.pi / 2)]:
            at = (mp.mpf(u), mp.mpf(v))

            def d(i: int, j: int, at=at, chart=chart, p=p) -> list[mp.mpf]:
                return [
                    mp.diff(lambda s, t, k=k: chart(p, s, t, MPMATH)[k], at, (i, j))
                    for k in range(3)
                ]

            f_u, f_v = d(1, 0), d(0, 1)
            second = [d(2, 0), d(1, 1), d(0, 2)]
            g = metric(p, *at, MPMATH)
            truth = [mp.fdot(f, f_ij) / mp.fdot(f, f) for f in (f_u, f_v) for f_ij in second]
            errors = [x - y for x, y in zip(truth, christoffel(g))]
            errors += [mp.fdot(f_u, f_u) - g.E, mp.fdot(f_v, f_v) - g.G, mp.fdot(f_u, f_v)]
            worst = max([worst, *map(abs, errors)])
    if worst > mp.mpf("1e-30"):
        raise ArithmeticError(f"chart metrics disagree with finite differences by {worst}")
    return worst


# One contact: its data, and the paper's equations.


@dataclass(frozen=True)
class Window:
    """Acceleration `value` added to q1" ("finger") or q2" ("object") for start < t < stop."""

    kind: str
    start: float
    stop: float
    value: tuple[float, float]


@dataclass(frozen=True)
class Case:
    """One contact, in the words of the scene files.

    `object_velocity` is M2 dq2/ds or the word "rolling"; `law` is "path" (lam = eta sigma^2)
    or "time" (lam = eta). The finger is a sphere.
    """

    object: str
    radii: tuple[float, ...]
    finger: float
    object_at: tuple[float, float]
    object_velocity: tuple[float, float] | str
    profile: tuple[float, float, float]
    law: str
    eta: float
    finger_at: tuple[float, float] = (math.pi / 2, 0.0)
    finger_velocity: tuple[float, float] = (2**-0.5, 2**-0.5)
    angle: float = 0.0
    duration: float = 1.0
    windows: tuple[Window, ...] = ()

    @property
    def exact(self) -> SimpleNamespace:
        """The numbers of the case as mpmath numbers."""
        names = ("radii", "object_at", "profile", "finger_at", "finger_velocity")
        lists = {n: [mp.mpf(x) for x in getattr(self, n)] for n in names}
        singles = {n: mp.mpf(getattr(self, n)) for n in ("finger", "eta", "angle")}
        return SimpleNamespace(**lists, **singles)


def turned(psi: Any, a: Sequence[Any], m: Any) -> list[Any]:
    """R_psi a, from finger frame to object frame."""
    c, s = m.cos(psi), m.sin(psi)
    return [c * a[0] - s * a[1], -s * a[0] - c * a[1]]


def speeds(g: Metric, rates: Sequence[Any], m: Any) -> list[Any]:
    """M q': velocity components along the axes of the contact frame."""
    return [m.sqrt(g.E) * rates[0], m.sqrt(g.G) * rates[1]]


def geodesic_acceleration(g: Metric, q: Sequence[Any], ratio: Any) -> list[Any]:
    """Right-hand side of eq. `timegeodesic` (errata applied); ratio = sigma'/sigma."""
    G = christoffel(g)
    return [
        ratio * q[k]
        - (G[3 * k] * q[0] * q[0] + 2 * G[3 * k + 1] * q[0] * q[1] + G[3 * k + 2] * q[1] * q[1])
        for k in range(2)
    ]


def spin(g: Metric, q: Sequence[Any], m: Any) -> Any:
    """T M q' = y . x', the turning rate of the contact frame about its normal."""
    return (g.G_u * q[1] - g.E_v * q[0]) / (2 * m.sqrt(g.E * g.G))


#: Run-time parameters of the compiled equations; the object's radii follow.
PARAMETERS = ("c0", "c1", "c2", "eta", "d1u", "d1v", "d2u", "d2v", "finger")


def paper_equations(surface: str, radii: int, law: str) -> list[tuple[Any, Any]]:
    """Theory section 2 as heyoka expressions."""
    s = dict(zip(STATE, hy.make_vars(*STATE)))
    p = {name: hy.par[i] for i, name in enumerate(PARAMETERS)}
    shape = [hy.par[len(PARAMETERS) + i] for i in range(radii)]
    t = hy.time
    sigma = p["c0"] + t * (p["c1"] + t * p["c2"])
    ratio = (p["c1"] + 2 * p["c2"] * t) / sigma
    lam = p["eta"] * sigma**2 if law == "path" else p["eta"]
    g1 = sphere_metric([p["finger"]], s["u1"], s["v1"], HEYOKA)
    g2 = CHARTS[surface][1](shape, s["u2"], s["v2"], HEYOKA)
    q1, q2 = [s["du1"], s["dv1"]], [s["du2"], s["dv2"]]
    a1 = geodesic_acceleration(g1, q1, ratio)
    a2 = geodesic_acceleration(g2, q2, ratio)
    rolled = turned(s["psi"], speeds(g1, q1, HEYOKA), HEYOKA)
    h2 = [hy.sqrt(g2.E), hy.sqrt(g2.G)]
    right = [*q1, a1[0] + p["d1u"], a1[1] + p["d1v"], *q2]
    right += [a2[k] + lam * (rolled[k] / h2[k] - q2[k]) + p[f"d2{'uv'[k]}"] for k in range(2)]
    right.append(spin(g1, q1, HEYOKA) + spin(g2, q2, HEYOKA))
    return list(zip((s[name] for name in STATE), right))


def real(x: Any, bits: int) -> hy.real:
    """An mpmath number, double or text as a heyoka number of that many bits."""
    return hy.real(mp.nstr(mp.mpf(x), 80), bits)


def from_real(x: hy.real) -> mp.mpf:
    """The mpmath number of a heyoka number."""
    return mp.mpf(str(x))


@cache
def integrator(equations: str, arguments: tuple[Any, ...], tolerance: str, bits: int) -> Any:
    """Compiled Taylor integrator of a system named by its builder function."""
    builders = (
        paper_equations,
        development_equations,
        geodesic_equations,
    )
    system = {f.__name__: f for f in builders}[equations](*arguments)
    return hy.taylor_adaptive(
        system,
        [real(0, bits)] * len(system),
        time=real(0, bits),
        tol=real(tolerance, bits),
        compact_mode=True,
        fp_type=hy.real,
        prec=bits,
    )


def start_state(case: Case) -> list[mp.mpf]:
    """The state at t = 0 in the order of `STATE`."""
    e = case.exact
    (u1, v1), (u2, v2) = e.finger_at, e.object_at
    g1 = sphere_metric([e.finger], u1, v1, MPMATH)
    g2 = CHARTS[case.object][1](e.radii, u2, v2, MPMATH)
    w2 = turned(e.angle, e.finger_velocity, MPMATH)
    if case.object_velocity != "rolling":
        w2 = [mp.mpf(x) for x in case.object_velocity]
    rates = [e.profile[0] * w for w in (*e.finger_velocity, *w2)]
    lame = [mp.sqrt(x) for x in (g1.E, g1.G, g2.E, g2.G)]
    dq = [w / h for w, h in zip(rates, lame)]
    return [u1, v1, *dq[:2], u2, v2, *dq[2:], e.angle]


def forcing(case: Case, start: float, stop: float) -> list[mp.mpf]:
    """Acceleration of the windows that cover [start, stop]: du1, dv1, du2, dv2."""
    d = {"finger": [mp.mpf(0)] * 2, "object": [mp.mpf(0)] * 2}
    for w in case.windows:
        if w.start <= start and stop <= w.stop:
            d[w.kind] = [x + mp.mpf(y) for x, y in zip(d[w.kind], w.value)]
    return [*d["finger"], *d["object"]]


def integrate(case: Case, times: Sequence[float], tolerance: str, bits: int) -> list[list[mp.mpf]]:
    """States at `times` (increasing, from 0, holding every window edge), shape (len(times), 9).

    The integrator is restarted at each of the times, so no step crosses a window's edge.
    """
    e = case.exact
    ta = integrator("paper_equations", (case.object, len(case.radii), case.law), tolerance, bits)
    ta.time = real(0, bits)
    ta.state[:] = [real(x, bits) for x in start_state(case)]
    states = [start_state(case)]
    for begin, end in zip(times, times[1:]):
        values = [*e.profile, e.eta, *forcing(case, begin, end), e.finger, *e.radii]
        ta.pars[:] = [real(x, bits) for x in values]
        outcome = ta.propagate_until(real(end, bits))[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise ArithmeticError(f"Taylor integration of {case} stopped: {outcome}")
        states.append([from_real(x) for x in ta.state])
    return states


def slip(case: Case, state: Sequence[mp.mpf]) -> list[mp.mpf]:
    """v_rel in E2, eq. `netrelvel`."""
    e = case.exact
    u1, v1, du1, dv1, u2, v2, du2, dv2, psi = state
    a1 = speeds(sphere_metric([e.finger], u1, v1, MPMATH), (du1, dv1), MPMATH)
    a2 = speeds(CHARTS[case.object][1](e.radii, u2, v2, MPMATH), (du2, dv2), MPMATH)
    return [x - y for x, y in zip(turned(psi, a1, MPMATH), a2)]


def contact_points(case: Case, state: Sequence[mp.mpf]) -> list[list[mp.mpf]]:
    """Contact point on the finger and on the object, each in its body's frame."""
    e = case.exact
    x1 = sphere_chart([e.finger], state[0], state[1], MPMATH)
    return [x1, CHARTS[case.object][0](e.radii, state[4], state[5], MPMATH)]


# Checks that do not come from the same equations.


def decay(case: Case, begin: float, end: float) -> mp.mpf:
    """The exact slip law between two times: sigma(end)/sigma(begin) exp(-L), theory section 3."""
    e = case.exact
    t0, t1 = mp.mpf(begin), mp.mpf(end)
    sigma = mp.polyval(e.profile[::-1], t1) / mp.polyval(e.profile[::-1], t0)
    gain = gain_integral(e.profile, e.eta, case.law)
    return sigma * mp.exp(-mp.polyval(gain[::-1], t1) + mp.polyval(gain[::-1], t0))


def gain_integral(profile: Sequence[Any], eta: Any, law: str) -> list[Any]:
    """Coefficients, lowest first, of L(t), the integral of lam from 0."""
    if law == "time":
        return [0 * eta, eta]
    square = [
        sum(profile[i] * profile[k - i] for i in range(3) if 0 <= k - i < 3) for k in range(5)
    ]
    return [0 * eta, *(eta * c / (k + 1) for k, c in enumerate(square))]


def slip_law_error(case: Case, times: Sequence[float], states: Sequence[Any]) -> mp.mpf:
    """Greatest deviation from the exact slip law over the intervals without forcing, m/s."""
    worst = mp.mpf(0)
    for i, (begin, end) in enumerate(zip(times, times[1:])):
        if not any(forcing(case, begin, end)):
            before, after = (mp.norm(slip(case, states[k])) for k in (i, i + 1))
            worst = max(worst, abs(after - before * decay(case, begin, end)))
    return worst


def great_circle_error(case: Case, times: Sequence[float], states: Sequence[Any]) -> mp.mpf:
    """Greatest distance of an unforced spherical finger from its great circle, m."""
    worst = mp.mpf(0)
    if any(w.kind == "finger" for w in case.windows):
        return worst
    for t, state in zip(times, states):
        s = arc_length(case.profile, t)
        truth = great_circle(case.finger, case.finger_at, case.finger_velocity, s)
        worst = max(worst, mp.norm([a - b for a, b in zip(contact_points(case, state)[0], truth)]))
    return worst


def development_equations(surface: str, radii: int, law: str) -> list[tuple[Any, Any]]:
    """Theory section 4 in chart coordinates: (u, v, theta) of finger and object, no stiffness.

    Parameters: c0, c1, c2, W1 (2), W (2), V (2), finger radius, the object's radii, then the
    coefficients of L(t) from the first power on (computed outside: heyoka replaces a division by
    3 or 5 with a multiplication by a double).
    """
    x = hy.make_vars("u1", "v1", "t1", "u2", "v2", "t2")
    c = [hy.par[i] for i in range(3)]
    W1, W, V = ([hy.par[3 + 2 * k], hy.par[4 + 2 * k]] for k in range(3))
    shape = [hy.par[10 + i] for i in range(radii)]
    t = hy.time
    exponent = 0 * t
    for i in reversed(range(1 if law == "time" else 5)):
        exponent = (exponent + hy.par[10 + radii + i]) * t
    left = hy.exp(-exponent)
    right = []
    for (u, v, theta), metric, p, w in (
        (x[:3], sphere_metric, [hy.par[9]], W1),
        (x[3:], CHARTS[surface][1], shape, [a - b * left for a, b in zip(W, V)]),
    ):
        g = metric(p, u, v, HEYOKA)
        sigma = c[0] + t * (c[1] + t * c[2])
        cos, sin = hy.cos(theta), hy.sin(theta)
        q = [sigma * (cos * w[0] - sin * w[1]) / hy.sqrt(g.E)]
        q.append(sigma * (sin * w[0] + cos * w[1]) / hy.sqrt(g.G))
        right += [*q, -spin(g, q, HEYOKA)]
    return list(zip(x, right))


def development_error(case: Case, times: Sequence[float], states: Sequence[Any]) -> mp.mpf:
    """Greatest difference in u, v and psi (rad) between `states` and theory section 4.

    For a case without windows.
    """
    e = case.exact
    bits = STIFF_PASSES[0][1]
    W = turned(e.angle, e.finger_velocity, MPMATH)
    start = W if case.object_velocity == "rolling" else [mp.mpf(x) for x in case.object_velocity]
    V = [a - b for a, b in zip(W, start)]
    arguments = (case.object, len(case.radii), case.law)
    ta = integrator("development_equations", arguments, *STIFF_PASSES[0])
    ta.time = real(0, bits)
    ta.state[:] = [real(x, bits) for x in (*e.finger_at, 0, *e.object_at, 0)]
    gain = gain_integral(e.profile, e.eta, case.law)[1:]
    values = [*e.profile, *e.finger_velocity, *W, *V, e.finger, *e.radii, *gain]
    ta.pars[:] = [real(x, bits) for x in values]
    worst = mp.mpf(0)
    for t, state in zip(times, states):
        ta.propagate_until(real(t, bits))
        u1, v1, theta1, u2, v2, theta2 = (from_real(x) for x in ta.state)
        found = [u1, v1, u2, v2, e.angle - theta1 - theta2]
        truth = [state[i] for i in (0, 1, 4, 5, 8)]
        worst = max([worst, *(abs(a - b) for a, b in zip(found, truth))])
    return worst


# The files.


def text(x: mp.mpf) -> str:
    """Decimal text of `DIGITS` significant digits."""
    return mp.nstr(x, DIGITS)


def short(x: mp.mpf) -> float:
    """An error measure rounded to two digits."""
    return float(mp.nstr(x, 2))


def agreed(what: str, difference: mp.mpf) -> float:
    """`short` of a difference that must stay below `AGREEMENT`, or ArithmeticError."""
    if difference > AGREEMENT:
        raise ArithmeticError(f"{what}: {mp.nstr(difference, 3)} exceeds {AGREEMENT}")
    return short(difference)


def sample_times(case: Case, count: int) -> list[float]:
    """`count` equally spaced doubles over the horizon, with the edges of the windows."""
    grid = {k * case.duration / (count - 1) for k in range(count)}
    return sorted(grid | {t for w in case.windows for t in (w.start, w.stop)})


def contact_record(case: Case, times: Sequence[float], stiff: bool) -> dict[str, Any]:
    """Solve one contact, check it and lay it out for the file."""
    begun = time.time()
    name = f"{case.object} {case.law} {case.eta:.3g} at {case.object_at}"
    first, second = STIFF_PASSES if stiff else PASSES
    states = integrate(case, times, *first)
    checks = {
        "slip_law_error": agreed(f"slip law, {name}", slip_law_error(case, times, states)),
        "great_circle_error": agreed(f"finger, {name}", great_circle_error(case, times, states)),
    }
    if not case.windows:
        difference = development_error(case, times, states)
        checks["development_error"] = agreed(f"development, {name}", difference)
    if not stiff:
        other = integrate(case, times, *second)
        difference = max(abs(a - b) for x, y in zip(states, other) for a, b in zip(x, y))
        checks["two_pass_difference"] = agreed(f"two passes, {name}", difference)
    print(f"  {name}: {checks}, {time.time() - begun:.1f} s", flush=True)
    slips = [slip(case, state) for state in states]
    given = ("object_at", "object_velocity", "finger_at", "finger_velocity", "angle")
    return {name: getattr(case, name) for name in given} | {
        "checks": checks,
        "states": [[text(x) for x in state] for state in states],
        "points": [[[text(c) for c in x] for x in contact_points(case, s)] for s in states],
        "slip": [[text(x) if abs(x) > 1e-30 else "0.0" for x in pair] for pair in slips],
    }


def scene_record(cases: Sequence[Case], count: int, stiff: bool = False) -> dict[str, Any]:
    """A scene: cases that differ in the object's contact only."""
    case = cases[0]
    times = sample_times(case, count)
    return {
        "object": {"surface": case.object, "radii": case.radii},
        "finger_radius": case.finger,
        "profile": case.profile,
        "gain": {"law": case.law, "eta": case.eta},
        "duration": case.duration,
        "windows": [vars(w) for w in case.windows],
        "times": times,
        "contacts": [contact_record(c, times, stiff) for c in cases],
    }


ABOUT = (
    "Made by tests/oracles/make_references.py from the paper's chart equations. states: u1 v1 du1 "
    "dv1 u2 v2 du2 dv2 psi; points: on the finger, on the object, each in its body's frame; slip: "
    "in E2, 0 below 1e-30. Absolute error below 1e-28, see checks."
)


def save(name: str, content: dict[str, Any]) -> None:
    """Write one file of the folder and print its size."""
    file = Path(__file__).with_name(f"{name}.json")
    file.write_text(json.dumps(content, separators=(",", ":")).replace("]],", "]],\n") + "\n")
    print(f"{file.name}: {file.stat().st_size / 1e3:.0f} kB", flush=True)


SPHERE_CONTACTS = (
    (math.pi / 6, math.pi / 6),
    (2 * math.pi / 3, math.pi / 6),
    (math.pi / 10, math.pi),
)
ELLIPSOID_CONTACTS = (
    (2 * math.pi / 3, math.pi / 2),
    (-2 * math.pi / 3, -math.pi / 2),
    (math.pi / 6, math.pi / 2),
)
GROWING = (0.001, 0.0, 0.4)
SETTLING = (0.1, 0.2, -0.02)


def paper_scenes(names: Sequence[str], law: str) -> dict[str, Any]:
    """Scenes K1 to K4 of theory section 10 with the given gain law and eta = 100."""
    ball = Case("sphere", (0.1,), 0.04, (0.0, 0.0), "rolling", GROWING, law, 100.0)
    egg = replace(ball, object="ellipsoid", radii=(0.3, 0.2, 0.1))
    scenes = {
        "K1": (replace(ball, object_velocity=(0.0, 0.0)), SPHERE_CONTACTS),
        "K2": (replace(ball, windows=(Window("finger", 0.0, 0.1, (0.1, 0.0)),)), SPHERE_CONTACTS),
        "K3": (
            replace(egg, windows=(Window("finger", 0.1, 0.15, (-0.1, -0.1)),)),
            ELLIPSOID_CONTACTS,
        ),
        "K4": (
            replace(
                egg,
                profile=SETTLING,
                duration=4.0,
                windows=(Window("finger", 1.0, 2.0, (-0.3, -0.3)),),
            ),
            ELLIPSOID_CONTACTS,
        ),
    }
    return {
        name: scene_record([replace(case, object_at=at) for at in contacts], 41)
        for name, (case, contacts) in scenes.items()
        if name in names
    }


def make_k_scenes() -> None:
    """K1 to K4 with the gain law `path`; K1 and K2 with `time` in a file of their own."""
    save("k_scenes", {"about": ABOUT, "scenes": paper_scenes(("K1", "K2", "K3", "K4"), "path")})
    save("k_scenes_time", {"about": ABOUT, "scenes": paper_scenes(("K1", "K2"), "time")})


def make_torus_slip() -> None:
    """One contact on a torus, both bodies disturbed."""
    case = Case(
        "torus",
        (0.1, 0.03),
        0.02,
        (0.3, 0.8),
        (0.3, -0.5),
        (0.02, 0.0, 0.4),
        "time",
        5.0,
        angle=0.4,
        windows=(Window("finger", 0.2, 0.4, (0.5, -0.8)), Window("object", 0.5, 0.6, (0.7, 1.1))),
    )
    save("torus_slip", {"about": ABOUT, "scenes": {"torus": scene_record([case], 11)}})


def slip_case(surface: str, radii: tuple[float, ...]) -> Case:
    """The contact of all scenes with slip."""
    case = Case(surface, radii, 0.04, (0.7, 0.4), (0.2, -0.9), GROWING, "path", 100.0)
    return replace(case, finger_at=(1.1, 0.2), angle=0.3)


def slip_scenes(surface: str, radii: tuple[float, ...]) -> dict[str, Any]:
    """Slip under six gains, up to the stiffness 1e7; the keys name law and gain.

    The two stiffest are integrated once, with `STIFF_PASSES`[0]: their second, independent
    solution is the development form.
    """
    case = slip_case(surface, radii)
    gains = {
        "path 1e2": ("path", 1e2),
        "path 1e4": ("path", 1e4),
        "path peak 1e7": ("path", 1e7 / 0.401**2),
        "time 1e2": ("time", 1e2),
        "time 1e4": ("time", 1e4),
        "time 1e6": ("time", 1e6),
    }
    return {
        name: scene_record([replace(case, law=law, eta=eta)], 11, stiff=eta > 1e5)
        for name, (law, eta) in gains.items()
    }


def make_ellipsoid_slip() -> None:
    """Slip on the triaxial ellipsoid from mild to stiff."""
    scenes = slip_scenes("ellipsoid", (0.3, 0.2, 0.1))
    save("ellipsoid_slip", {"about": ABOUT, "scenes": scenes})


def make_sphere_slip() -> None:
    """Slip on the sphere from mild to stiff."""
    save("sphere_slip", {"about": ABOUT, "scenes": slip_scenes("sphere", (0.1,))})


def make_slip_peaks() -> None:
    """Slip whose greatest eta sigma^2 is 1, 1e3 and 1e5; 1e7 is in the files above."""
    scenes = {}
    for surface, radii in (("sphere", (0.1,)), ("ellipsoid", AXES)):
        case = replace(slip_case(surface, radii), law="path")
        for peak in (1e0, 1e3, 1e5):
            chosen = replace(case, eta=peak / 0.401**2)
            record = scene_record([chosen], 11, stiff=chosen.eta > 1e5)
            scenes[f"{surface} peak {peak:.0e}"] = record
    save("slip_peaks", {"about": ABOUT, "scenes": scenes})


# Geodesics of the triaxial ellipsoid.

AXES = (0.3, 0.2, 0.1)
LENGTH = 3.0


def geodesic_equations(surface: str, radii: int) -> list[tuple[Any, Any]]:
    """x and x' in arc length; parameters are the radii."""
    state = hy.make_vars("x", "y", "z", "dx", "dy", "dz")
    shape = [hy.par[i] for i in range(radii)]
    return list(zip(state, geodesic_rates(surface, shape, HEYOKA, state)))


def start_in_space(surface: str, radii: Sequence[Any], at: Any, w: Sequence[Any]) -> list[mp.mpf]:
    """Point and velocity w[0] f_u/|f_u| + w[1] f_v/|f_v|."""
    p, (u, v), (chart, metric) = [mp.mpf(r) for r in radii], map(mp.mpf, at), CHARTS[surface]
    g = metric(p, u, v, MPMATH)
    cu, cv = mp.mpf(w[0]) / mp.sqrt(g.E), mp.mpf(w[1]) / mp.sqrt(g.G)

    def along(t: mp.mpf) -> list[mp.mpf]:
        return chart(p, u + cu * t, v + cv * t, MPMATH)

    return along(mp.mpf(0)) + [mp.diff(lambda t, k=k: along(t)[k], 0) for k in range(3)]


def geodesic(
    state: Sequence[Any],
    lengths: Sequence[float],
    passed: tuple[str, int],
    surface: str = "ellipsoid",
    radii: Sequence[float] = AXES,
) -> list[Any]:
    """Point and direction after each arc length, shape (len(lengths), 6)."""
    bits = passed[1]
    ta = integrator("geodesic_equations", (surface, len(radii)), *passed)
    ta.time = real(0, bits)
    ta.state[:] = [real(x, bits) for x in state]
    ta.pars[:] = [real(x, bits) for x in radii[: len(ta.pars)]]  # a torus needs the major one
    found = []
    for s in lengths:
        ta.propagate_until(real(s, bits))
        found.append([from_real(x) for x in ta.state])
    return found


def jacobi_integral(state: Sequence[mp.mpf]) -> mp.mpf:
    """(b^2-c^2) cos^2 v sin^2 a - (a^2-b^2) sin^2 u cos^2 a, a from the v-line; in m^2.

    From point and direction, with sin^2 u and cos^2 v by the closed inverse chart.
    """
    a2, b2, c2 = squares = [mp.mpf(r) ** 2 for r in AXES]
    x, p = state[:3], state[3:]
    P = sum(squares) - mp.fdot(x, x)
    pairs = (b2 + c2, a2 + c2, a2 + b2)
    Q = a2 * b2 + a2 * c2 + b2 * c2 - mp.fsum(w * c * c for w, c in zip(pairs, x))
    root = mp.sqrt(P * P - 4 * Q)
    l3, l2 = (P + root) / 2, (P - root) / 2
    # The gradient of a confocal coordinate l points along the line on which only l changes.
    gradient = [c / (square - l3) for c, square in zip(x, squares)]
    sin2a = mp.fdot(gradient, p) ** 2 / mp.fdot(gradient, gradient)
    return (b2 - l2) * sin2a - (l3 - b2) * (1 - sin2a)


def geodesic_starts() -> list[tuple[float, float, float]]:
    """190 random (u, v, angle), then 10 aimed at an umbilic but for an offset of the angle."""
    rng = random.Random(20240229)
    a2, b2, c2 = (r * r for r in AXES)
    starts = []
    for i in range(200):
        u, v = rng.uniform(-math.pi, math.pi), rng.uniform(-math.pi / 2, math.pi / 2)
        angle = rng.uniform(-math.pi, math.pi)
        if i >= 190:
            offset = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10, 1e-12, 0.0)[i - 190]
            ratio = math.sqrt((b2 - c2) / (a2 - b2)) * math.cos(v) / abs(math.sin(u))
            angle = math.copysign(1.0, angle) * (math.atan(ratio) + offset)
        starts.append((u, v, angle))
    return starts


def geodesic_record(start: tuple[float, float, float]) -> dict[str, Any]:
    """One geodesic, computed twice and checked."""
    u, v, angle = start
    state = start_in_space("ellipsoid", AXES, (u, v), (mp.cos(angle), mp.sin(angle)))
    points = (LENGTH / 2, LENGTH)
    found, other = (geodesic(state, points, passed) for passed in PASSES)
    difference = max(abs(a - b) for x, y in zip(found, other) for a, b in zip(x, y))
    integral = jacobi_integral(state)
    drift = max(abs(jacobi_integral(x) - integral) for x in found)
    return {
        "start": start,
        "middle": [text(x) for x in found[0][:3]],
        "end": [text(x) for x in found[1][:3]],
        "end_direction": [text(x) for x in found[1][3:]],
        "jacobi": text(integral),
        "checks": [agreed(f"geodesic {start}", x) for x in (difference, drift)],
    }


def make_ellipsoid_geodesics() -> None:
    """200 geodesics of 3 m on the ellipsoid 0.3/0.2/0.1."""
    about = (
        "Made by tests/oracles/make_references.py, integrating x'' = -(x'.Ax')/|Ax|^2 Ax. start: "
        "u, v, angle of the direction from f_u towards f_v; middle, end: points at s = 1.5 and 3; "
        "jacobi: (b^2-c^2) cos^2 v sin^2 a - (a^2-b^2) sin^2 u cos^2 a, a from the v-line, m^2. "
        "The last 10 are aimed at an umbilic but for an offset. checks: greatest difference of "
        "two passes, greatest drift of Jacobi's integral."
    )
    records = [geodesic_record(start) for start in geodesic_starts()]
    columns = {key: [r[key] for r in records] for key in records[0] if key != "checks"}
    checks = [max(r["checks"][k] for r in records) for k in range(2)]
    named = dict(zip(("two_pass_difference", "jacobi_drift"), checks))
    print(f"  {named}")
    head = {"about": about, "axes": AXES, "length": LENGTH, "checks": named}
    save("ellipsoid_geodesics", head | columns)


# Geodesics of one start on several surfaces, for run time against error.


def geodesic_points(
    surface: str, radii: Sequence[float], at: Any, w: Any, times: Sequence[float], passed: Any
) -> list[list[mp.mpf]]:
    """Points of one geodesic, shape (len(times), 3); ``passed`` as in `PASSES`."""
    if surface in ("sphere", "cylinder"):
        closed = great_circle if surface == "sphere" else helix
        return [closed(radii[0], at, w, t) for t in times]
    start = start_in_space(surface, radii, at, w)
    return [row[:3] for row in geodesic(start, times, passed, surface, radii)]


#: Ten times the body's size at about 1 m/s.
GEODESICS = {
    "sphere": ("sphere", (0.1,), (1.2, 0.3), 1.0),
    "cylinder": ("cylinder", (0.1,), (0.5, 0.02), 1.0),
    "torus": ("torus", (0.1, 0.03), (0.3, 0.8), 1.3),
    "ellipsoid": ("ellipsoid", AXES, (0.7, 0.4), 3.0),
    "spheroid": ("ellipsoid", (1.0, 1.0, 0.99), (0.7, 0.4), 10.0),
}


def make_geodesics() -> None:
    """One geodesic on each of the surfaces, with 41 points."""
    records, w = {}, (0.6, 0.8)
    for name, (surface, radii, at, duration) in GEODESICS.items():
        times = [k * duration / 40 for k in range(41)]
        found, other = (geodesic_points(surface, radii, at, w, times, p) for p in PASSES)
        difference = max(abs(a - b) for x, y in zip(found, other) for a, b in zip(x, y))
        records[name] = {
            "object": {"surface": surface, "radii": radii},
            "at": at,
            "velocity": w,
            "duration": duration,
            "checks": {"two_pass_difference": agreed(f"geodesic, {name}", difference)},
            "times": times,
            "points": [[text(c) for c in x] for x in found],
        }
        print(f"  {name}: {records[name]['checks']}", flush=True)
    about = (
        "Made by tests/oracles/make_references.py. points: of the geodesic that starts at (u, v) = "
        "at with velocity (m/s) along the axes of the chart's frame, at times (s), in m; closed "
        "form on sphere and cylinder. checks: greatest difference of two passes."
    )
    save("geodesics", {"about": about, "geodesics": records})


MAKERS: dict[str, Callable[[], None]] = {
    "k_scenes": make_k_scenes,
    "torus_slip": make_torus_slip,
    "ellipsoid_geodesics": make_ellipsoid_geodesics,
    "ellipsoid_slip": make_ellipsoid_slip,
    "sphere_slip": make_sphere_slip,
    "slip_peaks": make_slip_peaks,
    "geodesics": make_geodesics,
}


def main(names: Sequence[str]) -> None:
    """Make the named references, or all of them."""
    unknown = [name for name in names if name not in MAKERS]
    if unknown:
        raise SystemExit(f"unknown reference {unknown[0]!r}; known: {', '.join(MAKERS)}")
    print(f"chart metrics against finite differences: {mp.nstr(check_charts(), 2)}")
    for name in names or MAKERS:
        print(name)
        MAKERS[name]()


if __name__ == "__main__":
    main(sys.argv[1:])
