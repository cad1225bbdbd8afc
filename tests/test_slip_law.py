"""The exact slip law and the other integrals of the motion (theory sections 3, 6, 9)."""

from __future__ import annotations

import itertools
from math import pi, remainder, sqrt

import mpmath as mp
import numpy as np
import pytest
from conftest import SURFACES, derivative, one_contact
from numpy.polynomial import legendre, polynomial
from oracles.formulas import path_velocities, reflection, slip_of_states

import contact_system as cs
from benchmarks.stress_laws import left_over

T = np.linspace(0.0, 1.0, 41)
PROFILE = (0.05, 0.2, -0.1)
GAINS = {
    "path": cs.Gain.path(30.0),
    "time": cs.Gain.time(3.0),
    "guaranteed": cs.Gain.guaranteed(2.0),
}


def exact_slip(scene: cs.Scene, first: np.ndarray, t: np.ndarray) -> np.ndarray:
    """|v_rel|(t) of one contact from slip ``first`` at t = 0 (theory section 3)."""
    sigma = np.array(scene.profile.coefficients)
    return np.linalg.norm(first) * left_over(sigma, scene.gain, t) / sigma[0]


def assert_slip_follows_the_exact_law(scene: cs.Scene, t: np.ndarray) -> None:
    plan = cs.plan(scene)
    slip, from_states = plan.slip(t)[:, 0], slip_of_states(scene, plan.states(t))[:, 0]
    (contact,) = scene.contacts
    first = scene.profile(0.0) * (
        reflection(contact.angle) @ contact.finger_velocity - contact.object_velocity
    )
    law = exact_slip(scene, first, t)
    bar = 1e-12 * law.max()
    assert np.linalg.norm(slip, axis=1) == pytest.approx(law, abs=bar)
    assert np.linalg.norm(from_states, axis=1) == pytest.approx(law, abs=bar)
    assert slip == pytest.approx(from_states, abs=bar)


# --- the law


@pytest.mark.parametrize("obj", SURFACES)
def test_slip_follows_the_exact_law_with_every_finger(obj):
    for finger, gain in zip(SURFACES, itertools.cycle(GAINS.values())):
        assert_slip_follows_the_exact_law(one_contact(obj, finger, gain, PROFILE), T)


@pytest.mark.parametrize("obj", SURFACES)
def test_slip_is_carried_by_parallel_transport_along_the_objects_curve(obj):
    # The slip's angle in E2 turns by -int T2 M2 q2' dt: Gauss quadrature on a plan's states.
    scene = one_contact(obj, gain=GAINS["time"])
    plan = cs.plan(scene)
    node, weight = legendre.leggauss(60)
    t = 0.5 * (1 + node)
    states = plan.states(t)
    torsion = scene.object.torsion_form(*states[:, 0, 4:6].T).reshape(-1, 2)
    turned = -(torsion * path_velocities(scene, states)[1][:, 0]).sum(1) @ (0.5 * weight)
    slip = plan.slip(T)[:, 0]
    angle = np.unwrap(np.arctan2(slip[:, 1], slip[:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(turned, abs=1e-11)


@pytest.mark.parametrize("gain", GAINS)
def test_slip_shrinks_where_the_scene_says_that_it_contracts(gain):
    scene = one_contact("ellipsoid", gain=GAINS[gain])
    magnitude = np.linalg.norm(cs.plan(scene).slip(T)[:, 0], axis=1)
    intervals = scene.contraction().intervals
    for a, b, before, after in zip(T, T[1:], magnitude, magnitude[1:]):
        if any(start <= a and b <= stop for start, stop in intervals):
            assert after < before
        elif not any(start < b and a < stop for start, stop in intervals):
            assert after >= before


# --- where the gain and the profile are extreme


@pytest.mark.parametrize("eta", 10.0 ** np.arange(-3, 13, 3))
@pytest.mark.parametrize("obj", ["plane", "sphere", "ellipsoid", "torus", "bumps", "rounded cube"])
def test_slip_follows_the_exact_law_at_any_gain(obj, eta):
    layer = min(1.0, 1.0 / eta)
    t = np.unique([*T, *(layer * np.array([0.1, 0.5, 1.0, 3.0, 10.0]).clip(max=1 / layer))])
    scene = one_contact(obj, gain=cs.Gain.time(eta), profile=(0.2, 0.1))
    assert_slip_follows_the_exact_law(scene, t)
    # lam = eta sigma^2, sigma from 0.2 to 0.3
    scene = one_contact(obj, gain=cs.Gain.path(eta / 0.09), profile=(0.2, 0.1))
    assert_slip_follows_the_exact_law(scene, t)


@pytest.mark.parametrize("eta", 10.0 ** np.arange(-3, 13, 3))
@pytest.mark.parametrize("obj", ["plane", "cylinder"])
def test_contact_point_on_a_developable_body_is_the_quadrature_of_the_law(obj, eta):
    # constant sigma, lam = eta: g = sigma (1 - exp(-eta t)) / eta, the curve is W s - V g unrolled
    sigma, w, y = 0.2, np.array([0.6, 0.8]), np.array([0.2, -0.5])
    scene = one_contact(obj, gain=cs.Gain.time(eta), profile=(sigma,))
    t = np.unique([*T, *np.minimum(1.0, np.array([0.1, 1.0, 10.0]) / eta)])
    g = -sigma * np.expm1(-eta * t) / eta
    rolled = reflection(0.3) @ w
    moved = np.outer(sigma * t, rolled) - np.outer(g, rolled - y)
    unrolled = cs.plan(scene).states(t)[:, 0, 4:6] - SURFACES[obj][1]
    unrolled[:, 0] *= {"plane": 1.0, "cylinder": 0.1}[obj]
    assert unrolled == pytest.approx(moved, abs=1e-15)


PROFILES = {
    "growing": (0.001, 0.0, 0.4),
    "from rest": (0.0, 1.0, -1.0),
    "rest to rest": (0.0, 0.0, 30.0, -60.0, 30.0),
    "pausing": (1.0, -4.0, 4.0),
}


@pytest.mark.parametrize("eta", [1e4, 1e9, 1e12, 1e15])
@pytest.mark.parametrize("profile", PROFILES)
def test_slip_moves_a_contact_by_the_integral_of_the_law(profile, eta):
    # g = int sigma exp(-L), lam = eta sigma^2, by mpmath: also where lam is 0 at both ends
    c = PROFILES[profile]
    lost = [mp.mpf(x) for x in polynomial.polyint(polynomial.polymul(c, c))]

    def integrand(t):
        sigma, left = (sum(x * t**k for k, x in enumerate(of)) for of in (c, lost))
        return sigma * mp.exp(-eta * left)

    g = float(mp.quad(integrand, [0, *np.geomspace(1e-16, 1.0, 33).tolist()]))
    start = {"object_at": (1.3, 0.1), "finger_at": (1.2, 0.1), "angle": 0.0}
    start |= {"finger_velocity": (0.0, 0.0), "object_velocity": (0.6, 0.8)}
    for obj in (cs.Plane(), cs.Sphere(1.0)):  # a great circle, since the finger rests
        scene = one_contact(obj, cs.Sphere(0.1), cs.Gain.path(eta), c, **start)
        first, last = cs.plan(scene).points([0.0, 1.0])[:, 0, 1]
        moved = np.linalg.norm(last - first)
        moved = 2 * np.arcsin(moved / 2) if obj.great_circles else moved
        assert moved == pytest.approx(g, abs=2e-13)


@pytest.mark.parametrize("obj", ["plane", "sphere", "ellipsoid", "bumps", "rounded cube"])
@pytest.mark.parametrize("gain", [cs.Gain.path(50.0), cs.Gain.time(4.0)])
def test_path_may_start_from_rest(obj, gain):
    # sigma(0) = 0: slip is |V(0)| sigma exp(-L), which the chart equations cannot even state
    c = (0.0, 0.3, -0.1)
    scene = one_contact(obj, gain=gain, profile=c)
    plan = cs.plan(scene)
    slip = plan.slip(T)[:, 0]
    v = np.linalg.norm(reflection(0.3) @ [0.6, 0.8] - [0.2, -0.5])
    law = v * left_over(np.array(c), gain, T)
    assert np.linalg.norm(slip, axis=1) == pytest.approx(law, abs=1e-12 * law.max())
    assert slip == pytest.approx(slip_of_states(scene, plan.states(T))[:, 0], abs=1e-12 * law.max())
    assert not plan.states(0.0)[0, 0, [2, 3, 6, 7]].any()
    assert np.isfinite(plan.acceleration(T)).all()


@pytest.mark.parametrize("obj", ["plane", "sphere", "ellipsoid", "bumps", "rounded cube"])
@pytest.mark.parametrize("gain", [cs.Gain.path(50.0), cs.Gain.time(4.0)])
def test_path_may_pause_on_the_way(obj, gain):
    # sigma = 0.4 (t - 1/2)^2 touches zero at t = 1/2
    c = (0.1, -0.4, 0.4)
    scene = one_contact(obj, gain=gain, profile=c)
    assert_slip_follows_the_exact_law(scene, T)
    plan = cs.plan(scene)
    assert np.abs(plan.slip(0.5)).max() < 1e-16
    assert np.abs(plan.twist(0.5)).max() < 1e-14


@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "bumps"])
def test_slip_treatment_ends_once_slip_is_below_tolerance(obj):
    scene = one_contact(obj, gain=cs.Gain.time(100.0), profile=(0.2,))
    assert "below tolerance" in cs.plan(scene).explain()
    rolling = one_contact(obj, object_velocity="rolling", profile=(0.2,))
    assert "below tolerance" not in cs.plan(rolling).explain()
    assert_slip_follows_the_exact_law(scene, T)


def test_the_least_slip_is_slip():
    rolled = reflection(0.3) @ (0.6, 0.8)
    for off in (1e-9, 1e-12):
        plan = cs.plan(one_contact(object_velocity=tuple(rolled - [0.0, off])))
        assert plan.slip([0.0])[0, 0] == pytest.approx([0, 0.05 * off], abs=1e-17)


# --- the corollary


@pytest.mark.parametrize("finger", ["sphere", "ellipsoid", "torus", "cylinder", "bumps"])
@pytest.mark.parametrize("obj", ["sphere", "cylinder", "oblate", "bumps"])
def test_geodesic_on_the_object_gives_a_geodesic_on_the_finger(obj, finger):
    # eq. `corollary`: imposed rolling drags the finger's curve; it is the geodesic planned as such.
    w = np.array([0.28, -0.96])
    given = {"gain": cs.Gain.time(1.0), "object_velocity": tuple(w)}
    dragged = cs.plan(one_contact(obj, finger, finger_velocity="rolling", **given))
    planned = cs.plan(one_contact(obj, finger, finger_velocity=tuple(reflection(0.3) @ w), **given))
    assert dragged.points(T) == pytest.approx(planned.points(T), abs=1e-13)
    assert dragged.pose(T) == pytest.approx(planned.pose(T), abs=1e-12)
    assert not dragged.slip(T).any()


# --- holonomy


def test_octant_of_a_sphere_has_a_holonomy_of_ninety_degrees():
    # Three legs of 90 degrees with left turns of 90 degrees between them close on a sphere; the
    # parallel frame comes back turned by the octant's area over r^2. On the plane theta2 = 0.
    r = 0.1
    leg = pi * r / 2
    scene = one_contact(
        "plane",
        "sphere",
        profile=(leg,),
        duration=3.0,
        object_velocity="rolling",
        finger_at=(1.1, 0.4),
        finger_velocity=(0.6, 0.8),
    )
    plan, left = cs.plan(scene), np.array([[0.0, -1.0], [1.0, 0.0]])
    first = plan.states(0.0)[0, 0]
    for corner in (1.0, 2.0):
        (state,) = plan.states(corner)
        a1, a2 = (a[0, 0] for a in path_velocities(scene, state[None]))
        # a left turn on the ball, seen from outside, is a right turn on the plane
        root = scene.contacts[0].finger.metric_root(*state[0, :2])
        state[0, 2:4] = np.linalg.solve(root, left @ a1)
        state[0, 6:8] = left.T @ a2
        plan = plan.restart(corner, state)
    last = plan.states(3.0)[0, 0]
    assert plan.points(3.0)[0, 0, 0] == pytest.approx(cs.Sphere(r).point(1.1, 0.4), abs=1e-15)
    # psi = psi(0) - theta1, and theta1 = +90 degrees round a triangle walked with left turns
    assert remainder(last[8] - first[8] + pi / 2, 2 * pi) == pytest.approx(0.0, abs=1e-13)


# --- poles and umbilics


def assert_smooth_across(plan: cs.Plan, place: np.ndarray) -> None:
    """Points, pose and twist are finite, the twist is the pose's derivative, about one point."""
    t = np.linspace(0.02, 0.98, 2001)
    distance = np.linalg.norm(plan.points(t)[:, 0, 1] - place, axis=1)
    assert distance.min() < 4e-4
    times = t[np.argmin(distance)] + np.array([-1e-2, -1e-3, -1e-5, 0.0, 1e-5, 1e-3, 1e-2])
    for values in (plan.points(times), plan.pose(times), plan.twist(times)):
        assert np.isfinite(values).all()
    rate = derivative(lambda t: plan.pose(t)[:, 0], times, 2e-3)
    turn, twist = plan.pose(times)[:, 0, :3, :3], plan.twist(times)[:, 0]
    w = rate[:, :3, :3] @ turn.swapaxes(1, 2)
    omega = np.stack([w[:, 2, 1], w[:, 0, 2], w[:, 1, 0]], axis=1)
    assert omega == pytest.approx(twist[:, :3], abs=1e-8 * np.abs(twist).max())
    assert rate[:, :3, 3] == pytest.approx(twist[:, 3:], abs=1e-8 * np.abs(twist).max())


# A start on the equator, the direction of its meridian, and the pole at the end of it.
MERIDIANS = {
    "sphere": ((pi / 2, 0.0), (-1.0, 0.0), (0.0, 0.0, 0.1)),
    "round ellipsoid": ((pi / 2, 0.0), (-1.0, 0.0), (0.0, 0.0, 0.2)),
    "oblate": ((0.3, 0.0), (0.0, 1.0), (0.0, 0.0, 0.1)),
    "prolate": ((pi / 2, 0.2), (-1.0, 0.0), (0.3, 0.0, 0.0)),
    "rounded cube": ((pi / 2, 0.0), (-1.0, 0.0), (0.0, 0.0, 0.1)),
}


@pytest.mark.parametrize("slipping", [False, True])
@pytest.mark.parametrize("name", MERIDIANS)
def test_path_through_a_pole_is_smooth(name, slipping):
    at, w, pole = MERIDIANS[name]
    scene = one_contact(
        name,
        "plane",
        angle=0.0,
        object_at=at,
        profile=(0.6,),
        finger_velocity=(w[0], -w[1]),
        object_velocity=(0.5 * w[0], 0.5 * w[1]) if slipping else w,
    )
    assert_smooth_across(cs.plan(scene), np.array(pole))


@pytest.mark.parametrize("slipping", [False, True])
def test_path_through_an_umbilic_is_smooth(slipping):
    # The ellipse y = 0 is a geodesic, and all four umbilics lie on it.
    given = {"object_velocity": (-0.5, 0.0)} if slipping else {"object_velocity": "rolling"}
    scene = one_contact(
        "ellipsoid",
        "sphere",
        angle=0.0,
        object_at=(1.0, pi / 2),
        profile=(0.4,),
        finger_velocity=(-1.0, 0.0),
        **given,
    )
    assert_smooth_across(cs.plan(scene), np.array([0.3 * sqrt(5 / 8), 0.0, 0.1 * sqrt(3 / 8)]))


def has_states(plan: cs.Plan, t: float) -> bool:
    try:
        return bool(np.isfinite(plan.states(t)).all())
    except cs.ChartSingularity:
        return False


def test_states_at_a_pole_are_those_of_one_side_or_the_other():
    # North along a meridian at 0.1 m/s on a radius of 0.1 m: u = u0 - t, but for rounding.
    u0 = 0.7
    scene = one_contact(
        "sphere",
        "plane",
        angle=0.0,
        object_at=(u0, 0.0),
        profile=(0.1,),
        finger_velocity=(-1.0, 0.0),
        object_velocity="rolling",
    )
    plan = cs.plan(scene)
    t = u0 + np.arange(-40, 41) * np.spacing(u0)
    x = plan.points(t)[:, 0, 1]
    assert x == pytest.approx(np.broadcast_to([0.0, 0.0, 0.1], x.shape), abs=1e-15)
    assert np.isfinite(plan.pose(t)).all() and np.isfinite(plan.twist(t)).all()
    t = np.array([x for x in t if has_states(plan, x)])  # one may meet the pole exactly
    assert len(t) > 70
    u, v, du, dv = plan.states(t)[:, 0, 4:8].T
    assert np.abs(scene.object.point(u, v) - plan.points(t)[:, 0, 1]).max() < 1e-16
    turned = np.abs(v) > 1.0  # beyond the pole v is half a turn away and u grows
    assert np.array_equal(np.sign(du), np.where(turned, 1.0, -1.0)) and not dv.any()
    assert np.abs(np.abs(v) - np.where(turned, pi, 0.0)).max() < 1e-15
    assert turned[-1] and not turned[0]
