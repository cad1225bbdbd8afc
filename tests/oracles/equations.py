"""The paper's equations and charts, written anew for heyoka and mpmath, and checks of solutions.

For `make_references`, whose head says what is solved and how; nothing here imports the package.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

import heyoka as hy
import mpmath as mp
from formulas import geodesic_rates

mp.mp.prec = 240
AGREEMENT = mp.mpf("1e-28")
#: (tolerance, precision in bits) of the two passes; the first is the one that is stored.
PASSES = (("1e-42", 220), ("1e-37", 190))
#: The same for stiff scenes, whose cost is the number of steps and not the smoothness.
STIFF_PASSES = (("1e-36", 180), ("1e-33", 165))

STATE = ("u1", "v1", "du1", "dv1", "u2", "v2", "du2", "dv2", "psi")


# Surfaces: charts (theory section 1) for mpmath numbers, and their metric for heyoka's symbols.


def sphere_chart(p: Sequence[Any], u: Any, v: Any) -> list[Any]:
    """Point of the sphere of radius p[0]."""
    return [p[0] * mp.sin(u) * mp.cos(v), p[0] * mp.sin(u) * mp.sin(v), p[0] * mp.cos(u)]


def torus_chart(p: Sequence[Any], u: Any, v: Any) -> list[Any]:
    """Point of the torus of major radius p[0] and minor radius p[1]."""
    rho = p[0] + p[1] * mp.cos(v)
    return [rho * mp.cos(u), rho * mp.sin(u), p[1] * mp.sin(v)]


def ellipsoid_chart(p: Sequence[Any], u: Any, v: Any) -> list[Any]:
    """Point of the ellipsoid with semi-axes p in Jacobi's coordinates, eq. `ellipsoid`."""
    a2, b2, c2 = (axis * axis for axis in p)
    su, cu, sv, cv = mp.sin(u), mp.cos(u), mp.sin(v), mp.cos(v)
    root = mp.sqrt(a2 - c2)
    return [
        p[0] * cu * mp.sqrt(a2 - b2 * sv**2 - c2 * cv**2) / root,
        p[1] * su * cv,
        p[2] * sv * mp.sqrt(a2 * su**2 + b2 * cu**2 - c2) / root,
    ]


CHARTS = {"sphere": sphere_chart, "torus": torus_chart, "ellipsoid": ellipsoid_chart}


def squares(surface: str, p: Sequence[Any], u: Any, v: Any) -> tuple[Any, Any]:
    """E = f_u^2 and G = f_v^2 as heyoka expressions, by hand; `slip_law_error` checks them.

    Those of the ellipsoid are of Liouville's type; l3 and l2 are the confocal coordinates.
    """
    su, cu, sv, cv = hy.sin(u), hy.cos(u), hy.sin(v), hy.cos(v)
    if surface == "sphere":
        return p[0] * p[0], p[0] * p[0] * su**2.0
    if surface == "torus":
        return (p[0] + p[1] * cv) ** 2.0, p[1] * p[1]
    a2, b2, c2 = (axis * axis for axis in p)
    l3 = a2 * su**2.0 + b2 * cu**2.0
    l2 = b2 * sv**2.0 + c2 * cv**2.0
    return (l3 - l2) * l3 / (l3 - c2), (l3 - l2) * l2 / (a2 - l2)


def metric(surface: str, p: Sequence[Any], u: Any, v: Any) -> SimpleNamespace:
    """E, G and their partial derivatives, in heyoka's variables u and v."""
    E, G = squares(surface, p, u, v)
    rates = {"E_u": hy.diff(E, u), "E_v": hy.diff(E, v), "G_u": hy.diff(G, u), "G_v": hy.diff(G, v)}
    return SimpleNamespace(E=E, G=G, **rates)


def tangents(surface: str, p: Sequence[Any], at: Sequence[Any]) -> list[mp.matrix]:
    """f_u and f_v, by mpmath's differences in its own high precision."""

    def component(k: int) -> Any:
        return lambda u, v: CHARTS[surface](p, u, v)[k]

    return [mp.matrix([mp.diff(component(k), at, n) for k in range(3)]) for n in ((1, 0), (0, 1))]


def lame(surface: str, p: Sequence[Any], at: Sequence[Any]) -> list[mp.mpf]:
    """|f_u| and |f_v|."""
    return [mp.norm(f) for f in tangents(surface, p, at)]


def christoffel(g: SimpleNamespace) -> list[Any]:
    """G^1_11, G^1_12, G^1_22, G^2_11, G^2_12, G^2_22 of an orthogonal chart."""
    first = [g.E_u / (2 * g.E), g.E_v / (2 * g.E), -g.G_u / (2 * g.E)]
    return [*first, -g.E_v / (2 * g.G), g.G_u / (2 * g.G), g.G_v / (2 * g.G)]


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


def speeds(g: SimpleNamespace, rates: Sequence[Any]) -> list[Any]:
    """M q': velocity components along the axes of the contact frame."""
    return [hy.sqrt(g.E) * rates[0], hy.sqrt(g.G) * rates[1]]


def geodesic_acceleration(g: SimpleNamespace, q: Sequence[Any], ratio: Any) -> list[Any]:
    """Right-hand side of eq. `timegeodesic` (errata applied); ratio = sigma'/sigma."""
    G = christoffel(g)
    return [
        ratio * q[k]
        - (G[3 * k] * q[0] * q[0] + 2 * G[3 * k + 1] * q[0] * q[1] + G[3 * k + 2] * q[1] * q[1])
        for k in range(2)
    ]


def spin(g: SimpleNamespace, q: Sequence[Any]) -> Any:
    """T M q' = y . x', the turning rate of the contact frame about its normal."""
    return (g.G_u * q[1] - g.E_v * q[0]) / (2 * hy.sqrt(g.E * g.G))


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
    g1 = metric("sphere", [p["finger"]], s["u1"], s["v1"])
    g2 = metric(surface, shape, s["u2"], s["v2"])
    q1, q2 = [s["du1"], s["dv1"]], [s["du2"], s["dv2"]]
    a1 = geodesic_acceleration(g1, q1, ratio)
    a2 = geodesic_acceleration(g2, q2, ratio)
    rolled = turned(s["psi"], speeds(g1, q1), hy)
    h2 = [hy.sqrt(g2.E), hy.sqrt(g2.G)]
    right = [*q1, a1[0] + p["d1u"], a1[1] + p["d1v"], *q2]
    right += [a2[k] + lam * (rolled[k] / h2[k] - q2[k]) + p[f"d2{'uv'[k]}"] for k in range(2)]
    right.append(spin(g1, q1) + spin(g2, q2))
    return list(zip((s[name] for name in STATE), right))


def real(x: Any, bits: int) -> hy.real:
    """An mpmath number, double or text as a heyoka number of that many bits."""
    return hy.real(mp.nstr(mp.mpf(x), 80), bits)


def from_real(x: hy.real) -> mp.mpf:
    """The mpmath number of a heyoka number."""
    return mp.mpf(str(x))


@cache
def integrator(equations: Callable, arguments: tuple[Any, ...], tolerance: str, bits: int) -> Any:
    """Compiled Taylor integrator of a system of equations."""
    system = equations(*arguments)
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
    w2 = turned(e.angle, e.finger_velocity, mp)
    if case.object_velocity != "rolling":
        w2 = [mp.mpf(x) for x in case.object_velocity]
    rates = [e.profile[0] * w for w in (*e.finger_velocity, *w2)]
    scales = lame("sphere", [e.finger], e.finger_at) + lame(case.object, e.radii, e.object_at)
    dq = [w / h for w, h in zip(rates, scales)]
    return [*e.finger_at, *dq[:2], *e.object_at, *dq[2:], e.angle]


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
    ta = integrator(paper_equations, (case.object, len(case.radii), case.law), tolerance, bits)
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
    bodies = ("sphere", [case.exact.finger]), (case.object, case.exact.radii)
    a1, a2 = (
        [h * rate for h, rate in zip(lame(*body, state[k : k + 2]), state[k + 2 : k + 4])]
        for body, k in zip(bodies, (0, 4))
    )
    return [x - y for x, y in zip(turned(state[8], a1, mp), a2)]


def contact_points(case: Case, state: Sequence[mp.mpf]) -> list[list[mp.mpf]]:
    """Contact point on the finger and on the object, each in its body's frame."""
    x1 = sphere_chart([case.exact.finger], *state[:2])
    return [x1, CHARTS[case.object](case.exact.radii, *state[4:6])]


# Checks by other equations.


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
    for (u, v, theta), body, p, w in (
        (x[:3], "sphere", [hy.par[9]], W1),
        (x[3:], surface, shape, [a - b * left for a, b in zip(W, V)]),
    ):
        g = metric(body, p, u, v)
        sigma = c[0] + t * (c[1] + t * c[2])
        cos, sin = hy.cos(theta), hy.sin(theta)
        q = [sigma * (cos * w[0] - sin * w[1]) / hy.sqrt(g.E)]
        q.append(sigma * (sin * w[0] + cos * w[1]) / hy.sqrt(g.G))
        right += [*q, -spin(g, q)]
    return list(zip(x, right))


def development_error(case: Case, times: Sequence[float], states: Sequence[Any]) -> mp.mpf:
    """Greatest difference in u, v and psi (rad) between `states` and theory section 4.

    For a case without windows.
    """
    e = case.exact
    bits = STIFF_PASSES[0][1]
    W = turned(e.angle, e.finger_velocity, mp)
    start = W if case.object_velocity == "rolling" else [mp.mpf(x) for x in case.object_velocity]
    V = [a - b for a, b in zip(W, start)]
    arguments = (case.object, len(case.radii), case.law)
    ta = integrator(development_equations, arguments, *STIFF_PASSES[0])
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


# Geodesics in space.

AXES = (0.3, 0.2, 0.1)


def geodesic_equations(surface: str, radii: int) -> list[tuple[Any, Any]]:
    """x and x' in arc length; parameters are the radii."""
    state = hy.make_vars("x", "y", "z", "dx", "dy", "dz")
    shape = [hy.par[i] for i in range(radii)]
    return list(zip(state, geodesic_rates(surface, shape, hy, state)))


def start_in_space(surface: str, radii: Sequence[Any], at: Any, w: Sequence[Any]) -> list[mp.mpf]:
    """Point and velocity w[0] f_u/|f_u| + w[1] f_v/|f_v|."""
    p, at = [mp.mpf(r) for r in radii], [mp.mpf(x) for x in at]
    pairs = zip(w, tangents(surface, p, at))
    velocity = sum((f * (mp.mpf(x) / mp.norm(f)) for x, f in pairs), mp.zeros(3, 1))
    return [*CHARTS[surface](p, *at), *velocity]


def geodesic(
    state: Sequence[Any],
    lengths: Sequence[float],
    passed: tuple[str, int],
    surface: str = "ellipsoid",
    radii: Sequence[float] = AXES,
) -> list[Any]:
    """Point and direction after each arc length, shape (len(lengths), 6)."""
    bits = passed[1]
    ta = integrator(geodesic_equations, (surface, len(radii)), *passed)
    ta.time = real(0, bits)
    ta.state[:] = [real(x, bits) for x in state]
    ta.pars[:] = [real(x, bits) for x in radii[: len(ta.pars)]]  # a torus needs the major one
    found = []
    for s in lengths:
        ta.propagate_until(real(s, bits))
        found.append([from_real(x) for x in ta.state])
    return found
