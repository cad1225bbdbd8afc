"""Plans follow the exact slip law and other closed forms (theory sections 3, 6, 9)."""

from __future__ import annotations

import contextlib
import itertools
from math import pi, sqrt

import mpmath as mp
import numpy as np
import pytest
from conftest import SURFACES, assert_twist_is_the_rate_of_the_pose, one_contact
from numpy.polynomial import polynomial
from oracles.formulas import reflection, slip_of_states

import contact_system as cs
from benchmarks.stress_laws import left_over

T = np.linspace(0.0, 1.0, 41)
GAINS = cs.Gain.path(30.0), cs.Gain.time(3.0), cs.Gain.guaranteed(2.0)


def assert_slip_follows_the_exact_law(scene: cs.Scene, t: np.ndarray) -> None:
    """|v_rel| = |V| sigma exp(-L) (theory section 3), where V is slip over sigma at the start."""
    plan, (contact,) = cs.plan(scene), scene.contacts
    slip, from_states = plan.slip(t)[:, 0], slip_of_states(scene, plan.states(t))[:, 0]
    first = reflection(contact.angle) @ contact.finger_velocity - contact.object_velocity
    sigma = np.array(scene.profile.coefficients)
    law = np.linalg.norm(first) * left_over(sigma, scene.gain, t)
    bar = 1e-12 * law.max()
    assert np.linalg.norm(slip, axis=1) == pytest.approx(law, abs=bar)
    assert slip == pytest.approx(from_states, abs=bar)


@pytest.mark.parametrize("obj", SURFACES)
def test_slip_follows_the_exact_law_with_every_finger(obj):
    for finger, gain in zip(SURFACES, itertools.cycle(GAINS)):
        assert_slip_follows_the_exact_law(one_contact(obj, finger, gain), T)


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


@pytest.mark.parametrize("eta", [*10.0 ** np.arange(-3, 13, 3), 1e35, 1e60])
@pytest.mark.parametrize("obj", ["plane", "cylinder"])
def test_contact_point_on_a_developable_body_is_the_quadrature_of_the_law(obj, eta):
    # unrolled, the curve is W s - V g; with constant sigma and lam = eta,
    # g = sigma (1 - exp(-eta t)) / eta
    sigma, w, y = 0.2, np.array([0.6, 0.8]), np.array([0.2, -0.5])
    scene = one_contact(obj, gain=cs.Gain.time(eta), profile=(sigma,))
    t = np.unique([*T, *np.minimum(1.0, np.array([0.1, 1.0, 10.0]) / eta)])
    g = -sigma * np.expm1(-eta * t) / eta
    rolled = reflection(0.3) @ w
    moved = np.outer(sigma * t, rolled) - np.outer(g, rolled - y)
    unrolled = cs.plan(scene).states(t)[:, 0, 4:6] - SURFACES[obj][1]
    unrolled[:, 0] *= {"plane": 1.0, "cylinder": 0.1}[obj]
    assert unrolled == pytest.approx(moved, abs=1e-15)
    # where an acceleration d acts on rolling, v_rel = -(1 - exp(-eta t)) M d / eta
    push = [cs.ObjectAcceleration(0, 0.0, 1.0, (0.3, -0.2))]
    given = {"gain": scene.gain, "profile": (sigma,), "object_velocity": "rolling"}
    plan = cs.plan(one_contact(obj, disturbances=push, **given))
    moved = np.array([0.3 * {"plane": 1.0, "cylinder": 0.1}[obj], -0.2])
    slip = np.outer(np.expm1(-eta * t) / eta, moved)
    assert plan.slip(t)[:, 0] == pytest.approx(slip, abs=5e-12 * np.abs(slip).max())
    assert plan.acceleration(t)[:, 0] == pytest.approx(
        np.outer(-np.exp(-eta * t), moved), abs=1e-12
    )


def test_a_profile_whose_terms_cancel_costs_digits_and_is_not_refused():
    # its values have rounding errors that no number of panels makes smaller
    sigma = 4e3 * polynomial.polyfromroots(2 * [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    scene = one_contact("plane", gain=cs.Gain.path(100.0), profile=tuple(sigma))
    x, weights = np.polynomial.legendre.leggauss(200)
    g = weights / 2 @ left_over(sigma, scene.gain, (1 + x) / 2)
    rolled = reflection(0.3) @ [0.6, 0.8]
    moved = polynomial.polyval(1, polynomial.polyint(sigma)) * rolled - g * (rolled - [0.2, -0.5])
    unrolled = cs.plan(scene).states(1.0)[0, 0, 4:6] - SURFACES["plane"][1]
    assert unrolled == pytest.approx(moved, abs=1e-8)


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
    # the finger's contact point rests, so the object's moves along a straight line or great circle
    for obj in (cs.Plane(), cs.Sphere(1.0)):
        scene = one_contact(obj, cs.Sphere(0.1), cs.Gain.path(eta), c, **start)
        first, last = cs.plan(scene).points([0.0, 1.0])[:, 0, 1]
        moved = np.linalg.norm(last - first)
        moved = 2 * np.arcsin(moved / 2) if obj.chart.great_circles else moved
        assert moved == pytest.approx(g, abs=2e-13)


@pytest.mark.parametrize("least", [1e-1, 1e-4, 1e-6])
def test_slip_under_an_acceleration_is_exact_where_sigma_is_almost_zero(least):
    # on a plane, with lam = eta: v = sigma exp(-eta t) (v(0)/sigma(0) - d int exp(eta t)/sigma)
    eta, d, sigma = 3.0, 0.03, (least + 0.1, -0.2, 0.1)
    push = [cs.ObjectAcceleration(contact=0, start=0.5, stop=1.75, value=(d, 0.0))]
    scene = one_contact(cs.Plane(), "sphere", cs.Gain.time(eta), sigma, push, 2.0)
    t = [0.0, 0.9, 1.0, 1.3, 2.0]
    first, *slip = cs.plan(scene).slip(t)[:, 0, 0]

    def speed(x):
        return sum(c * mp.mpf(x) ** k for k, c in enumerate(sigma))

    with mp.workdps(30):
        near = [1 + k * mp.sqrt(least) for k in (-30, -10, -3, -1, 0, 1, 3, 10, 30)]
        for time, found in zip(t[1:], slip):
            places = [0.5, *(x for x in near if 0.5 < x < min(time, 1.75)), min(time, 1.75)]
            left = first / speed(0) - d * mp.quad(lambda x: mp.exp(eta * x) / speed(x), places)
            assert abs(speed(time) * mp.exp(-eta * mp.mpf(time)) * left - found) < 1e-12


# sigma is zero at the start, where the chart equations have no value, or at 1/2 s
@pytest.mark.parametrize(("profile", "rest"), [((0.0, 0.3, -0.1), 0.0), ((0.1, -0.4, 0.4), 0.5)])
@pytest.mark.parametrize("obj", ["plane", "sphere", "ellipsoid", "bumps", "rounded cube"])
def test_where_the_path_rests_all_rates_are_zero_and_slip_follows_its_law(obj, profile, rest):
    for gain in (cs.Gain.path(50.0), cs.Gain.time(4.0)):
        scene = one_contact(obj, gain=gain, profile=profile)
        assert_slip_follows_the_exact_law(scene, T)
        plan = cs.plan(scene)
        assert np.abs(plan.states(rest)[0, 0, [2, 3, 6, 7]]).max() < 1e-14
        assert np.abs(plan.twist(rest)).max() < 1e-14
        assert np.isfinite(plan.acceleration(T)).all()


def test_slip_of_a_billionth_and_less_of_sigma_is_not_taken_for_rolling():
    rolled = reflection(0.3) @ (0.6, 0.8)
    for off in (1e-9, 1e-12):
        plan = cs.plan(one_contact(object_velocity=tuple(rolled - [0.0, off])))
        assert plan.slip([0.0])[0, 0] == pytest.approx([0, 0.05 * off], abs=1e-17)


# --- the corollary


@pytest.mark.parametrize("finger", ["sphere", "ellipsoid", "torus", "cylinder", "bumps"])
@pytest.mark.parametrize("obj", ["sphere", "cylinder", "oblate", "bumps"])
def test_imposed_rolling_along_a_geodesic_moves_the_finger_along_a_geodesic(obj, finger):
    # eq. `corollary`: with imposed rolling the finger's curve follows from the object's; it must be
    # the geodesic that is planned on the finger itself.
    w = np.array([0.28, -0.96])
    given = {"gain": cs.Gain.time(1.0), "object_velocity": tuple(w)}
    imposed = cs.plan(one_contact(obj, finger, finger_velocity="rolling", **given))
    planned = cs.plan(one_contact(obj, finger, finger_velocity=tuple(reflection(0.3) @ w), **given))
    assert imposed.points(T) == pytest.approx(planned.points(T), abs=1e-13)
    assert imposed.pose(T) == pytest.approx(planned.pose(T), abs=1e-12)
    assert not imposed.slip(T).any()


# --- poles and umbilics


# A start, the direction of its meridian, and the pole at its end. The last goes along the ellipse
# y = 0, which is a geodesic, to an umbilic.
MERIDIANS = {
    "sphere": ((pi / 2, 0.0), (-1.0, 0.0), (0.0, 0.0, 0.1)),
    "round ellipsoid": ((pi / 2, 0.0), (-1.0, 0.0), (0.0, 0.0, 0.2)),
    "oblate": ((0.3, 0.0), (0.0, 1.0), (0.0, 0.0, 0.1)),
    "prolate": ((pi / 2, 0.2), (-1.0, 0.0), (0.3, 0.0, 0.0)),
    "rounded cube": ((pi / 2, 0.0), (-1.0, 0.0), (0.0, 0.0, 0.1)),
    "ellipsoid": ((1.0, pi / 2), (-1.0, 0.0), (0.3 * sqrt(5 / 8), 0.0, 0.1 * sqrt(3 / 8))),
}


@pytest.mark.parametrize("part", [1.0, 0.5], ids=["rolling", "slipping"])
@pytest.mark.parametrize("name", MERIDIANS)
def test_path_through_a_pole_or_an_umbilic_is_smooth(name, part):
    at, w, pole = MERIDIANS[name]
    start = {"object_at": at, "finger_velocity": (w[0], -w[1]), "angle": 0.0}
    start |= {"object_velocity": (part * w[0], part * w[1]), "profile": (0.6,)}
    plan, t = cs.plan(one_contact(name, "plane", **start)), np.linspace(0.02, 0.98, 2001)
    distance = np.linalg.norm(plan.points(t)[:, 0, 1] - pole, axis=1)
    assert distance.min() < 4e-4
    times = t[np.argmin(distance)] + np.array([-1e-2, -1e-3, -1e-5, 0.0, 1e-5, 1e-3, 1e-2])
    assert np.isfinite(plan.points(times)).all()
    assert_twist_is_the_rate_of_the_pose(plan, times, 1e-8, 2e-3)


def has_states(plan: cs.Plan, t: float) -> bool:
    with contextlib.suppress(cs.ChartSingularity):
        return bool(np.isfinite(plan.states(t)).all())
    return False


def test_states_within_rounding_of_a_pole_are_those_of_one_side_or_the_other():
    # North along a meridian at 0.1 m/s on a radius of 0.1 m: u = u0 - t, but for rounding.
    u0 = 0.7
    start = {"angle": 0.0, "object_at": (u0, 0.0), "finger_velocity": (-1.0, 0.0)}
    scene = one_contact("sphere", "plane", profile=(0.1,), object_velocity="rolling", **start)
    plan = cs.plan(scene)
    t = u0 + np.arange(-40, 41) * np.spacing(u0)
    x = plan.points(t)[:, 0, 1]
    assert x == pytest.approx(np.broadcast_to([0.0, 0.0, 0.1], x.shape), abs=1e-15)
    assert np.isfinite(plan.pose(t)).all() and np.isfinite(plan.twist(t)).all()
    t = np.array([x for x in t if has_states(plan, x)])  # one of them may meet the pole exactly
    assert len(t) > 70
    u, v, du, dv = plan.states(t)[:, 0, 4:8].T
    assert np.abs(scene.object.point(u, v) - plan.points(t)[:, 0, 1]).max() < 1e-16
    turned = np.abs(v) > 1.0  # beyond the pole v is half a turn away and u grows
    assert np.array_equal(np.sign(du), np.where(turned, 1.0, -1.0)) and not dv.any()
    assert np.abs(np.abs(v) - np.where(turned, pi, 0.0)).max() < 1e-15
    assert turned[-1] and not turned[0]
