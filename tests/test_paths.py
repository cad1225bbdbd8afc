"""Paths keep the tolerance and lose no turn: at window edges, poles, umbilics and extremes."""

from __future__ import annotations

import contextlib
import itertools
import math
from fractions import Fraction
from math import pi

import numpy as np
import pytest
from conftest import (
    NEAR_UMBILICS,
    RESULTS,
    SURFACES,
    WINDOWS,
    assert_plans_agree,
    disturbed,
    one_contact,
    seven_contacts,
)
from oracles.formulas import slip_of_states
from scipy.integrate import quad

import contact_system as cs

FINGER = cs.Sphere(0.04)
TIMES = np.linspace(0.0, 1.0, 301)


def alone(obj: cs.Surface, at=(0.7, 0.4), profile=(0.1,), duration=1.0, **contact) -> cs.Scene:
    """A scene of one contact, which rolls unless velocities are given."""
    common = {k: contact.pop(k) for k in ("gain", "disturbances") if k in contact}
    contacts = [cs.Contact(**{"finger": FINGER, "object_at": at} | contact)]
    path = cs.Profile(profile)
    return cs.Scene(object=obj, contacts=contacts, profile=path, duration=duration, **common)


def on_a_plane(finger: cs.Surface, at, along, profile=(0.1,), **given) -> cs.Scene:
    """A finger that rolls over a plane along one of its geodesics."""
    start = {"finger": finger, "finger_at": at, "finger_velocity": along}
    return alone(cs.Plane(), (0.0, 0.0), profile, **start, **given)


# --- tolerances


@pytest.mark.parametrize("name", ["ellipsoid", "torus", "bumps", "rounded cube", "seven contacts"])
def test_contact_points_are_within_the_tolerance_times_the_bodies_sizes(name):
    scene = seven_contacts() if name == "seven contacts" else disturbed(name, "ellipsoid")
    t = np.linspace(0, 1, 101)
    truth = cs.plan(scene, tolerance=1e-15).points(t)
    sizes = np.array([[c.finger.size, scene.object.size] for c in scene.contacts])
    for tolerance in (1e-1, 1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12):
        gap = np.abs(cs.plan(scene, tolerance=tolerance).points(t) - truth).max((0, 3))
        assert (gap / sizes).max() <= tolerance


TORUS, ROUND = cs.Torus(0.0311, 0.0182), cs.Ellipsoid(0.0737, 0.0737, 0.0323)
PUSHED_UNDER_STRONG_GAIN = {
    "finger accelerated": cs.Scene(
        object=cs.Plane(),
        contacts=[cs.Contact(TORUS, (0.224, -0.13), (-1.418, 2.472), 1.589, (0.601, 0.628))],
        profile=cs.Profile([0.0742, 0.3]),
        duration=0.82,
        gain=cs.Gain.time(2024.0),
        disturbances=[cs.FingerAcceleration(0, 0.06, 0.67, (-0.334, -0.334))],
    ),
    "object's rate offset": alone(
        cs.Ellipsoid(0.2009, 0.1734, 0.1524),
        (-2.977, 0.491),
        (0.0156,),
        duration=0.85,
        **{"finger": ROUND, "finger_at": (-1.714, 0.575), "angle": 0.241},
        **{"finger_velocity": (-0.79, 0.776), "object_velocity": "rest"},
        gain=cs.Gain.time(14856.0),
        disturbances=[cs.ObjectRateOffset(0, 0.0, 0.831, (0.0165, -0.0384))],
    ),
}


@pytest.mark.parametrize("name", PUSHED_UNDER_STRONG_GAIN)
def test_tolerances_are_kept_where_slip_settles_within_a_panel(name):
    # The solver's sweeps over a panel once stopped when slip had settled, 110 tolerances off. On
    # so few panels the error is a tenth of the tolerance at most.
    scene = PUSHED_UNDER_STRONG_GAIN[name]
    t = np.linspace(0.0, scene.duration, 30)
    truth = cs.plan(scene, 1e-14).points(t)[:, 0]
    sizes = np.array([scene.contacts[0].finger.size, scene.object.size])
    for tolerance in (1e-6, 1e-8, 1e-9):
        gap = cs.plan(scene, tolerance).points(t)[:, 0] - truth
        assert (np.linalg.norm(gap, axis=-1) <= 0.1 * tolerance * sizes).all(), tolerance


def test_tolerances_are_kept_where_a_path_comes_to_a_bump():
    # Sweeps once stopped after one that changed little, though the next would have changed more:
    # 50 tolerances off. On so few panels the error is a tenth of the tolerance at most.
    start = {"finger": cs.Plane(), "finger_at": (0.0, 0.0)}
    bump = cs.ParametricSurface(("u", "v", "0.02*exp(-(u**2 + v**2)/0.04**2)"), size=0.1)
    rng, t = np.random.default_rng(1), np.linspace(0, 1, 21)
    for _ in range(60):
        scene = alone(bump, (-0.15, rng.uniform(-0.05, 0.05)), (0.3,), angle=rng.normal(), **start)
        truth = cs.plan(scene, 1e-15).points(t)
        for tolerance in (1e-6, 1e-9, 1e-12):
            gap = cs.plan(scene, tolerance).points(t) - truth
            assert np.abs(gap).max() <= 0.1 * tolerance * bump.size, (scene, tolerance)


@pytest.mark.parametrize(
    ("finger", "at", "along", "tolerances"),
    [
        # sweeps of panels that are far too long overflow
        (cs.Torus(1.0, 0.01), (0.0, 0.3), (-22.3, -20.1), [1e-6]),
        (cs.Ellipsoid(0.1, 0.0004438, 0.0002084), (0.6568, 1.305), (0.1245, -0.4823), [1e-10]),
        (cs.Ellipsoid(0.1, 0.0049151, 0.0017677), (0.6223, -1.3992), (0.4888, 0.7038), [1e-11]),
        # many tolerances: one may be met by luck, and not with another compiler's rounding
        (
            cs.Ellipsoid(0.1, 0.0008505, 0.0005225),
            (0.9113, 1.2948),
            (-0.8555, -5.435e-5),
            np.geomspace(5e-9, 1e-7, 14),
        ),
    ],
)
def test_axes_are_right_where_panels_are_short_against_the_body(finger, at, along, tolerances):
    scene = on_a_plane(finger, at, along)
    expected = cs.plan(scene, tolerance=1e-14).pose(TIMES)
    for tolerance in tolerances:
        found = cs.plan(scene, tolerance=float(tolerance)).pose(TIMES)
        # the tolerance bounds points; axes turn by ten times as much on bodies as thin as these
        assert np.abs(found - expected)[..., :3, :3].max() < 10 * tolerance, tolerance


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-6, 1e-9])
def test_states_of_a_small_finger_that_turns_often_lose_no_turn_and_keep_the_tolerance(tolerance):
    given = {"finger_at": (1.1, 0.2), "object_velocity": (0.2, -0.9), "gain": cs.Gain.path(500.0)}
    scene = alone(cs.Sphere(0.1), finger=cs.Sphere(1e-3), **given)
    found, expected = (cs.plan(scene, tolerance=x).states(TIMES) for x in (tolerance, 1e-14))
    assert np.abs(found - expected)[..., [0, 1, 4, 5, 8]].max() < tolerance


def test_paths_have_their_exact_length_to_four_roundings():
    sigma = (0.001, 0.0, 0.375)
    found = cs.plan(on_a_plane(FINGER, (1.0, 0.0), (1.0, 0.0), sigma)).states(TIMES)[:, 0, 4]
    for t, length in zip(TIMES[1:].tolist(), found[1:].tolist()):
        true = sum(Fraction(c) * Fraction(t) ** (k + 1) / (k + 1) for k, c in enumerate(sigma))
        assert abs(Fraction(length) - true) <= 4 * true / 2**53


# --- slip that is short or very small


@pytest.mark.parametrize(
    ("gain", "method"),
    [(cs.Gain.time(1e4), "auto"), (cs.Gain.guaranteed(1e4), "auto"), (cs.Gain.time(1.0), "chart")],
)
def test_slip_that_falls_below_the_least_double_is_no_error(gain, method):
    scene = cs.load_scene("K2").replace(gain=gain)
    with np.errstate(all="raise"):
        plan = cs.plan(scene, method=method)
        plan.evaluate(np.linspace(0, scene.duration, 9), *RESULTS)
        assert np.isfinite(cs.summary(plan)["slip_end"]).all()
        assert len(cs.rejections(plan)) == len(scene.contacts)


@pytest.mark.parametrize(("eta", "tolerance"), [(1e6, 1e-3), (1e9, 1e-2), (1e12, 1e-12)])
@pytest.mark.parametrize("obj", SURFACES)
def test_rates_show_slip_too_short_to_move_the_contact(obj, eta, tolerance):
    scene = one_contact(obj, "sphere", gain=cs.Gain.time(eta))
    plan, layer = cs.plan(scene, tolerance=tolerance), np.linspace(0.0, 40.0, 21) / eta
    bar = max(1e-13, 3 * tolerance * scene.profile(0.0))
    # whether they are asked for at few times or at many
    for times in (np.append(layer, 1.0), np.append(layer, np.linspace(0.01, 1.0, 4000))):
        states = plan.states(times)[:21]
        assert plan.slip(layer) == pytest.approx(slip_of_states(scene, states), abs=bar)
        velocity = scene.object.metric_root(*states[0, 0, 4:6]) @ states[0, 0, 6:8]
        expected = np.array([0.2, -0.5]) * scene.profile(0.0)
        assert velocity == pytest.approx(expected, rel=max(1e-12, 1e-9 * (eta < 1e12)))


def test_a_contact_that_starts_rolling_has_exactly_no_slip_at_any_angle():
    rng = np.random.default_rng(8)
    for angle in rng.uniform(-7, 7, 60):
        w = tuple(rng.normal(size=2) * 10 ** rng.uniform(-2, 2))
        plan = cs.plan(alone(cs.Sphere(0.1), angle=angle, finger_velocity=w, profile=(0.01,)))
        assert "(no slip)" in plan.explain() and not plan.slip([0.0, 0.5]).any()


@pytest.mark.parametrize("obj", SURFACES)
def test_rolling_goes_on_where_the_guaranteed_gain_changes_its_formula(obj):
    given = {"profile": (0.1, 1.0, -1.0), "object_velocity": "rolling"}
    scenes = [one_contact(obj, "sphere", gain=g, **given) for g in (cs.Gain.guaranteed(2.0), None)]
    found, expected = (cs.plan(scene).points(TIMES) for scene in scenes)
    assert found == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("length", [5e-324, 1e-310, 1e-160, 1e-20])
def test_a_window_of_next_to_no_length_changes_nothing(length):
    plain = one_contact()
    scene = plain.replace(disturbances=[cs.FingerAcceleration("all", 0.0, length, (0.1, 0.2))])
    assert_plans_agree(
        cs.plan(scene), cs.plan(plain), np.linspace(0, 1, 5), 1e-13, "points", "states"
    )


# --- branches and turns


OPEN = ("plane", "bumps", "one sheet", "two sheets")
CLOSED = [name for name in SURFACES if name not in OPEN]


@pytest.mark.parametrize("profile", [(0.4, 0.1), (0.0, 3.2, -0.4)])  # the second rests at both ends
@pytest.mark.parametrize("obj", CLOSED)
def test_states_are_continuous_over_many_revolutions_at_few_and_many_times(obj, profile):
    offset = [cs.ObjectRateOffset(0, 2.0, 3.0, (0.1, 0.2))]
    given = {"gain": cs.Gain.time(1.0), "profile": profile, "duration": 8.0}
    scene = one_contact(obj, disturbances=offset, **given)
    plan, t = cs.plan(scene), np.linspace(0, 8, 4001)
    states = plan.states(t)[:, 0]
    # no step of a coordinate is longer than its rates allow: 1.5 for their change within a step
    step = np.abs(np.diff(states[:, [0, 1, 4, 5]], axis=0))
    allowed = 1.5 * np.maximum(np.abs(states[:-1, [2, 3, 6, 7]]), np.abs(states[1:, [2, 3, 6, 7]]))
    assert (step <= allowed * (t[1] - t[0]) + 1e-3).all()
    assert np.abs(np.diff(states[:, 8])).max() < 0.5
    assert np.ptp(states[:, 4:6], axis=0).max() > 2 * pi
    again = scene.object.point(states[:, 4], states[:, 5])
    assert plan.points(t)[:, 0, 1] == pytest.approx(again, abs=1e-12)
    for rows in ([4000], [4000, 0, 1500], range(0, 4001, 500), range(2000, 4001, 40)):
        found = cs.plan(scene).states(t[list(rows)])[:, 0]
        assert found == pytest.approx(states[list(rows)], abs=1e-12 * np.abs(states).max())


@pytest.mark.parametrize("scene", NEAR_UMBILICS, ids=lambda scene: scene.name)
def test_paths_close_to_umbilics_stay_on_their_branch(scene):
    t = np.linspace(0.0, 4.0, 161)
    truth = cs.plan(scene, method="chart")  # the paper's equations, integrated by scipy
    expected, plan = truth.states(t), cs.plan(scene)
    assert np.abs(plan.states(t[::40]) - expected[::40]).max() < 1e-7
    assert np.abs(cs.plan(scene).states(t) - expected).max() < 1e-7
    assert np.abs(plan.points(t) - truth.points(t)).max() < 1e-9


def test_paths_that_begin_on_or_beside_a_seam_stay_on_their_cover():
    # Jacobi's constant keeps cos v > 0: 1e-13 of the size beside the seam, the path crosses y = 0
    # where sin u is 0, 4e-7 of the size beyond the umbilic
    at, along = (3.144943168853535, -1.5707579168350703), (0.9962732538067015, 0.08625313762065588)
    body = cs.Ellipsoid(1.0, 0.9999999461818512, 0.9999968767629274)
    plan = cs.plan(alone(body, at, (12.0,), finger_velocity=along))
    assert (np.cos(plan.states(np.linspace(0, 1, 400))[:, 0, 5]) > 0).all()
    body = cs.Ellipsoid(0.1, 0.0999999999999, 0.03)  # two of its seams are 0.3 um long
    slips = {"object_velocity": (1.2, -0.2), "gain": cs.Gain.time(10.0)}
    plan = cs.plan(alone(body, (-0.8, -pi / 2), (0.01,), finger_velocity=(0.0, -1.0), **slips))
    assert np.abs(np.diff(plan.states(np.linspace(0.0, 0.1, 401))[2:, 0, 8])).max() < 0.1


def test_coordinates_lose_no_turn_where_a_path_that_slips_goes_through_a_pole_or_around_it():
    rng = np.random.default_rng(4)
    # three that turn back around a pole, the first in 0.3 ms
    slow = {"angle": pi, "finger_velocity": (-1.0, -0.2), "object_velocity": (-2.9e-3, 2e-4)}
    plans = [cs.plan(alone(cs.Sphere(0.1), (2e-7, 1.0), gain=cs.Gain.time(10.0), **slow))]
    back = {"angle": pi, "finger_velocity": (-1.0, 0.05), "object_velocity": (-2.6, -0.05)}
    plans += [cs.plan(alone(cs.Sphere(0.1), (0.009, 1.0), gain=cs.Gain.time(140.0), **back))]
    push = {"disturbances": [cs.ObjectAcceleration(0, 0.1, 0.8, (-32.0, 33.8))]}
    push |= {"gain": cs.Gain.time(11.54), "finger_velocity": (-0.1768, -0.2854)}
    spheroid, at = cs.Ellipsoid(0.1, 0.1, 0.07), (-2.1804, 1.5432)
    plans += [cs.plan(alone(spheroid, at, (0.1216,), finger_at=(1.3, 0.2), **push))]
    for k in range(60):
        body = cs.Sphere(0.1) if k % 2 else cs.Ellipsoid(0.1, 0.1, 0.07)
        at, profile = (rng.uniform(0.4, 2.6), rng.uniform(-3, 3)), (rng.uniform(0.3, 1.0),)
        along = {"finger_velocity": (-1.0, 0.0), "object_velocity": (0.6, 0.0)}
        gain = cs.Gain.path(10.0 ** rng.uniform(0, 4))
        scene = alone(body, at, profile, finger_at=(1.3, 0.2), gain=gain, **along)
        plans.append(cs.plan(scene, tolerance=10.0 ** rng.uniform(-13, -6)))
    t = np.unique([*np.geomspace(1e-6, 1e-2, 100), *np.linspace(0.0, 1.0, 701)])
    for plan in plans:
        states = plan.states(t, gaps=True)[:, 0, [1, 4, 5]]
        assert np.nanmax(np.abs(np.diff(states, axis=0))) < 3.2


@pytest.mark.parametrize("aside", [1e-2, 1e-8, 1e-11])
@pytest.mark.parametrize("name", ["sphere", "rounded cube"])
def test_states_beside_a_pole_are_those_of_the_point_and_lose_no_turn(name, aside):
    body, given = SURFACES[name][0], {"finger_velocity": (0.0, 1.0), "gain": cs.Gain.time(0.0)}
    for direction in range(8):  # away from the place beside the pole, then back and past it
        there = {"object_velocity": (math.cos(direction), math.sin(direction)), **given}
        u, v, *rates = cs.plan(alone(body, (aside, 0.3), (0.1,), **there)).states(1.0)[0, 0, 4:8]
        back = {"object_velocity": -10.0 * body.metric_root(u, v) @ rates, **given}
        plan, t = cs.plan(alone(body, (u, v), (0.1,), 2.0, **back)), np.linspace(0.0, 1.9, 400)
        u, v, psi = plan.states(t)[:, 0, [4, 5, 8]].T
        assert plan.points(t)[:, 0, 1] == pytest.approx(body.point(u, v), abs=1e-15)
        assert np.abs(np.diff(psi - v)).max() < 0.5  # passing this pole turns psi and v alike


def test_states_and_moving_frames_at_a_pole_are_refused():
    for v, name in itertools.product(np.linspace(0.1, 3.0, 30), ("states", "carried")):
        plan = cs.plan(rolled_over(cs.Sphere(0.1), 0.7, v=v))
        with pytest.raises(cs.ChartSingularity, match="contact 0: Sphere.*pole"):
            plan.evaluate(0.7, name)
    # a sweep's summary has the state of a moment before
    scenes = [rolled_over(cs.Sphere(0.1), u, v=v).replace(duration=0.7) for u in (0.7, 0.7, 0.9)]
    found = cs.sweep(scenes).table["state_end"]
    assert found[1, 4:6] == pytest.approx([0.0, v], abs=1e-6)
    assert found[2] == pytest.approx(cs.plan(scenes[2]).states(0.7)[0, 0], abs=1e-12)


@pytest.mark.parametrize("object_velocity", ["rolling", "rest"])
def test_a_quadric_that_is_a_sphere_but_for_rounding_is_planned_as_the_sphere(object_velocity):
    # as R (1/r^2) R^T comes out: off its diagonal not zero, its eigenvectors in any direction
    rounding = [[0.0, 3.7e-17, 3.0e-17], [3.7e-17, -2.2e-16, -6.7e-17], [3.0e-17, -6.7e-17, 0.0]]
    quadric = cs.Quadric(np.eye(3) / 0.2**2 + 0.2**-2 * np.array(rounding))
    start = {"finger_at": (0.9, 0.4), "object_velocity": object_velocity, "at": (1.1, -2.0)}
    path, bodies, t = {"profile": (0.1, 0.2), "duration": 2.0}, (quadric, cs.Sphere(0.2)), range(3)
    found, truth = (cs.plan(alone(body, finger=body, **path, **start)) for body in bodies)
    for ask in ("states", "points", "twist"):
        assert getattr(found, ask)(t) == pytest.approx(getattr(truth, ask)(t), abs=1e-13)


def test_a_turned_quadric_moves_as_one_along_the_axes_even_far_away_or_thin():
    turn = np.array([[2, -1, 2], [2, 2, -1], [-1, 2, 2]]) / 3
    for values, sigma in (([100, 40, 0], (0.0, 3.2, -0.4)), ([100, 200, 1e6], (0.02,))):
        bodies = cs.Quadric(turn * values @ turn.T), cs.Quadric(np.diag(values))
        found, truth = (cs.plan(alone(b, (0.4, 0.1), sigma, 8.0)).states(8.0) for b in bodies)
        assert found == pytest.approx(truth, abs=1e-11)


# --- edges of windows


@pytest.mark.parametrize("obj", ["sphere", "cylinder", "ellipsoid", "bumps", "rounded cube"])
def test_motion_is_continuous_at_window_edges_and_at_the_end(obj):
    last = [cs.ObjectRateOffset(0, 0.9, 1.0, (0.4, -0.3)), *WINDOWS]
    plan = cs.plan(one_contact(obj, profile=(0.2, 0.1), disturbances=last))
    for at in plan.scene.edges[1:]:
        before = np.nextafter(at, 0.0)
        for result, kept in (("points", ...), ("pose", ...), ("states", [0, 1, 2, 3, 4, 5, 8])):
            x, y = (np.asarray(getattr(plan, result)(t)[0, 0])[kept] for t in (before, at))
            assert x == pytest.approx(y, abs=1e-10), (result, at)
        # the object's rates alone jump, by the rate offset that begins or ends
        rates = [plan.states(t)[0, 0, 6:8] for t in (before, at)]
        jump = np.array([0.4, -0.3]) * ((at in (0.5, 0.9)) - (at == 0.8))
        assert rates[1] - rates[0] == pytest.approx(jump, abs=1e-10)


RESTING_SOON = (2.442754781845688, -0.3257006375794251, 0.010856687919314168)


@pytest.mark.parametrize(
    "obj",
    [cs.Torus(3, 1), cs.Ellipsoid(3, 2, 1), cs.ParametricSurface(("u", "v", "0.1*cos(u)*cos(v)"))],
)
def test_a_window_may_end_an_instant_before_the_path_rests(obj):
    edge, (rest,) = 15.0, cs.Profile(RESTING_SOON).extrema(0.0, 30.0)
    assert edge < rest < edge + 1e-14  # rounding makes the length between them zero or negative
    start = {"finger": cs.Sphere(0.5), "finger_at": (1.3, 0.2), "gain": cs.Gain.guaranteed(5.0)}
    offset = [cs.ObjectRateOffset(0, 6.0, edge, (0.1, 0.2))]
    scene = alone(obj, (0.9, 0.4), RESTING_SOON, 30.0, disturbances=offset, **start)
    plan, t = cs.plan(scene, tolerance=1e-8), [edge - 1e-9, edge, rest, edge + 1e-9]
    for found in (plan.points(t)[:, 0], plan.states(t)[:, 0, [0, 1, 4, 5, 8]]):
        assert np.abs(found - found[1]).max() < 1e-8


PUSH = cs.FingerAcceleration(0, 0.1, 0.6, (0.3, 0.1))
AT_REST = "sigma = 0 at t = .*accelerate while"


@pytest.mark.parametrize(
    ("push", "profile", "words"),
    [
        (cs.ObjectRateOffset(0, 0.1, 1.0, (-3.0, 0.0)), (0.05, 0.2, -0.1), "pole"),
        (PUSH, (0.1 + 1e-9, -0.4, 0.4), "sigma = .* m/s; add a constant"),
        # the acceleration d changes dq/ds by d/sigma^2, which is infinite where sigma = 0
        (PUSH, (0.1, -0.4, 0.4), AT_REST),
        (cs.FingerAcceleration(0, 0.0, 0.6, (0.3, 0.1)), (0.0, 0.3), AT_REST),
    ],
)
def test_disturbances_that_no_plan_can_follow_are_refused(push, profile, words):
    scene = one_contact(disturbances=[push], profile=profile)
    with pytest.raises(cs.ContactSystemError, match=f"'sphere on sphere', contact 0: .*{words}"):
        cs.plan(scene).states([0.0, 1.0])
    calm = scene.replace(disturbances=[cs.ObjectRateOffset(0, push.start, 0.6, (0.1, 0.0))])
    assert np.isfinite(cs.plan(calm).twist(np.linspace(0, 1, 11))).all()


# --- imposed rolling


# The first pair goes through a pole of the finger; the second object has no explicit chart.
@pytest.mark.parametrize(
    ("obj", "angle"), [(cs.Sphere(0.1), pi), (cs.ImplicitSurface("x**2 + y**2 + z**4 - 1"), 0.5)]
)
def test_imposed_rolling_passes_poles_and_needs_no_explicit_chart(obj, angle):
    given = {"object_velocity": (1, 0), "angle": angle, "at": (1.2, 0.3), "duration": 4.0}
    along, t = np.array([np.cos(angle), -np.sin(angle)]), np.linspace(0, 4, 41)  # R_psi (1, 0)
    imposed, planned = (cs.plan(alone(obj, finger_velocity=w, **given)) for w in ("rolling", along))
    # the finger's great circle from (pi/2, 0), where E1 = [-z y x]
    s = 0.1 * t / 0.04
    circle = np.outer(np.cos(s), [1, 0, 0]) + np.outer(np.sin(s), [0.0, along[1], -along[0]])
    assert np.abs(imposed.points(t)[:, 0, 0] - 0.04 * circle).max() < 1e-12 * 0.04
    assert imposed.pose(t) == pytest.approx(planned.pose(t), abs=1e-12)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-8])
def test_imposed_rolling_keeps_a_coarse_tolerance_beside_an_umbilic(tolerance):
    finger, w, t = cs.Ellipsoid(0.8, 0.5, 0.45), (-1.0, -1.2), np.linspace(0, 2, 9)
    for angle in np.linspace(-3, 3, 13):
        c, s = np.cos(angle), np.sin(angle)
        given = {"angle": angle, "profile": (1.3, 0.3), "duration": 2.0}
        rolling = on_a_plane(finger, (0.5, -0.08), "rolling", object_velocity=w, **given)
        planned = on_a_plane(finger, (0.5, -0.08), np.array([[c, -s], [-s, -c]]) @ w, **given)
        error = cs.plan(rolling, tolerance).points(t) - cs.plan(planned).points(t)
        assert np.abs(error).max() < tolerance * 0.8


# --- surfaces of users: poles, bumps, points that rays from the centre do not reach first


BALL = cs.ParametricSurface(
    ("r*sin(u)*cos(v)", "r*sin(u)*sin(v)", "r*cos(u)"), parameters={"r": 0.1}, size=0.1
)
CONE = cs.ParametricSurface(("v*cos(u)", "v*sin(u)", "-v"), size=0.1)
TANGENTS = cs.ParametricSurface(("cos(u) - v*sin(u)", "sin(u) + v*cos(u)", "(u + v)/2"))


def test_path_through_the_tip_of_a_cone_or_the_edge_of_a_helixs_tangents_is_refused():
    aside, up = (alone(CONE, (0.2, 0.05), finger_velocity=w) for w in ((1.0, 0.0), (0.0, 1.0)))
    assert np.isfinite(cs.plan(aside).pose([0.1])).all()
    for scene in (up, alone(TANGENTS, (0.2, 0.7), (1.0,), angle=1.5, finger_velocity=(1.0, 0.3))):
        with pytest.raises(cs.ContactSystemError, match=r"contact 0: .* \(u, v\) = \("):
            cs.plan(scene, 1e-6)


def rolled_over(obj: cs.Surface, u: float, profile=(0.1,), v=0.0) -> cs.Scene:
    """A plane that is rolled over a ball of 0.1 m, north along a meridian."""
    return alone(obj, (u, v), profile, finger=cs.Plane(), finger_at=(0, 0), finger_velocity=(-1, 0))


@pytest.mark.parametrize(
    ("profile", "tolerance"),
    [((0.02, 0.3), 1e-11), ((0.02, 0.3), 1e-7), ((0.4, -0.39), 1.1e-3), ((0.4, -0.39), 1.6e-4)],
)
def test_a_path_through_a_users_pole_is_refused_or_right_wherever_panels_end(profile, tolerance):
    refused, t = 0, np.linspace(0, 1, 11)
    for u in np.linspace(1.46, 1.47, 40):
        try:
            pose = cs.plan(rolled_over(BALL, u, profile, 0.2), tolerance).pose(t)
        except cs.ContactSystemError as error:
            assert "singular point of its chart" in str(error)
            refused += 1
        else:  # rounding may lead the path past the pole
            right = cs.plan(rolled_over(cs.Sphere(0.1), u, profile, 0.2)).pose(t)
            assert pose == pytest.approx(right, abs=tolerance)
    assert refused > 5


@pytest.mark.parametrize("u", [1e-6, 1e-3, 0.98, 0.999, 1 - 1e-7, 1 + 1e-7, 1.01])
@pytest.mark.parametrize("method", ["auto", "chart"])
def test_a_users_pole_just_inside_an_end_of_the_path_is_refused_and_one_beyond_is_not(u, method):
    if u < 1:
        with pytest.raises(cs.ContactSystemError, match=r"singular point of its chart.* \(u, v\)"):
            cs.plan(rolled_over(BALL, u), 1e-9, method)
    else:
        scenes = [rolled_over(obj, u) for obj in (BALL, cs.Sphere(0.1))]
        pose, expected = (cs.plan(scene, 1e-9, method).pose(1.0) for scene in scenes)
        assert pose == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
def test_tolerances_are_kept_where_rates_jump_within_a_panel(tolerance):
    """A rate offset along f_u turns over at a pole; the curvature of surfaces with `fmax` jumps."""
    push = [cs.ObjectRateOffset(0, 0.1, 0.9, (0.1, 0.0))]
    edge = cs.ParametricSurface(("u", "v", "0.5*u + 2*fmax(u, 0)**2"), size=0.1)
    length = lambda s: (s * np.hypot(1, s) + np.arcsinh(s)) / 8  # noqa: E731
    for u in np.linspace(0.5, 1, 60):
        over = alone(cs.Sphere(0.1), (u, 0), (0.2,), finger_velocity=(-1, 0), disturbances=push)
        x, _, z = cs.plan(over, tolerance).points(1.0)[0, 0, 1]
        met = 0.1 + (u - 0.2) / 1.9
        assert np.arctan2(-x, z) == pytest.approx(2.1 * (0.9 - met) + 0.2, abs=tolerance)
        begin = 0.14 * u - 0.2
        along = alone(edge, (begin, 0), (0.22,), finger_velocity=(1, 0))
        x = cs.plan(along, tolerance).points(1.0)[0, 0, 1, 0]
        gone = length(0.5 + 4 * x) - length(0.5) - begin * np.hypot(1, 0.5)
        assert gone == pytest.approx(0.22, abs=0.1 * tolerance)
    box = cs.ImplicitSurface(lambda x: sum(np.fmax(abs(x[i]) - 1, 0) ** 2 for i in range(3)) - 1)
    over = alone(box, (1.2, 1.9), (10.0,), finger=cs.Plane(), finger_at=(0, 0), angle=-0.9)
    found, truth = (cs.plan(over, error).points(1.0) for error in (tolerance, 1e-14))
    assert found == pytest.approx(truth, abs=tolerance)


@pytest.mark.filterwarnings("error")
def test_a_path_next_to_a_users_pole_is_planned_or_refused_without_warnings():
    # Some 1e-13 m beside the pole, where panels get shorter than times can be told apart. Which of
    # these paths pass it, and which are refused, depends on the last digits.
    start = {"finger": cs.Plane(), "finger_at": (0.2, 0.1)}
    at = (2.6435730446771846, -2.887402784955306)
    for aside in np.linspace(1e-12, 1e-11, 12):
        along = {"profile": (0.0, 1.8095648730350078), "finger_velocity": (-1.0, -aside)}
        with contextlib.suppress(cs.ContactSystemError):
            assert np.isfinite(cs.plan(alone(BALL, at, **along, **start), 1e-8).pose(1.0)).all()


BUMP = "h*exp(-(({} - 3)**2 + {}**2)/h**2)"
GIVEN = {"parameters": {"h": 0.005}, "size": 0.1}
LEVEL = "z - " + BUMP.format("x", "y")
GROUND = {  # surface, start, and the sign of its first axis along x
    "chart": (cs.ParametricSurface(("u", "v", BUMP.format("u", "v")), **GIVEN), (0.0, 0.0), 1.0),
    "implicit": (
        cs.ImplicitSurface(LEVEL, center=(1.7, 0.0, -4.0), **GIVEN),
        (np.arctan(1.7 / 4.0), pi),
        -1.0,
    ),
}


@pytest.mark.parametrize("slip", [0.0, 0.5])
@pytest.mark.parametrize("push", [0.0, 1e-13])
@pytest.mark.parametrize("ground", GROUND)
def test_a_bump_of_five_millimetres_on_a_path_of_metres_is_not_stepped_over(ground, push, slip):
    """A path straight over its top stays in its plane: its length is that of the bump's outline.

    With an acceleration, even of 1e-13, both bodies' paths are integrated together.
    """
    obj, at, ahead = GROUND[ground]
    start = {"finger": cs.Plane(), "finger_at": (0.0, 0.0), "finger_velocity": (ahead, 0.0)}
    start |= {"object_velocity": (ahead * (1 - slip), 0.0), "gain": cs.Gain.time(100)}
    pushes = [cs.FingerAcceleration(0, 0.1, 1.0, (ahead * push, 0.0))] if push else []
    plan = cs.plan(alone(obj, at, (3.5,), disturbances=pushes, **start))
    reach = slip * 3.5 / 100 * (1 - np.exp(-100))
    slope = lambda u: 2 * (u - 3) / 0.005 * np.exp(-(((u - 3) / 0.005) ** 2))  # noqa: E731
    rise = quad(lambda u: np.hypot(1, slope(u)) - 1, 2.95, 3.05, points=[3], epsabs=1e-13)[0]
    assert plan.points(1.0)[0, 0, 1] == pytest.approx([3.5 - reach - rise, 0, 0], abs=1e-11)


def test_states_are_refused_where_the_centre_of_an_implicit_surface_does_not_see_the_path():
    level = "(sqrt(x**2 + y**2) - 0.2)**2 + z**2 - 0.07**2"  # a ring; its centre lies in the tube
    ring = cs.ImplicitSurface(level, center=(0.2, 0, 0), size=0.27)
    at = ring.coordinates(cs.Torus(0.2, 0.07).point(0.1, 0.3))
    start = {"finger": cs.Plane(), "finger_at": (0, 0), "finger_velocity": (0.8, 0.6)}
    start |= {"object_velocity": (0.5, 0.2), "gain": cs.Gain.time(3)}
    scene = alone(ring, at, (1.5,), **start)
    plan = cs.plan(scene)
    assert plan.points(1.0)[0, 0, 1, 0] < 0 and np.isfinite(plan.twist(1.0)).all()
    assert np.isfinite(plan.states(0.1)).all()
    for ask in (plan.states, plan.slip):
        with pytest.raises(cs.ChartSingularity, match="out of the centre's sight"):
            ask([0.1, 1.0])
    with pytest.raises(cs.ChartSingularity, match="out of sight of an .* another center"):
        cs.measured_states(scene, plan.pose(1.0)[0], plan.twist(1.0)[0], plan.points(1.0)[0, :, 1])


# --- extremes


def test_paths_so_long_that_rounding_leaves_few_digits_are_refused():
    for speed in (4.2e9, 1e89):
        with pytest.raises(cs.SceneError, match="contact 0.*leaves less than four digits of its"):
            cs.plan(alone(cs.Sphere(0.1), profile=(1.0,), finger_velocity=(speed, 0.0)))


def test_only_the_product_of_sigma_and_velocity_counts_under_accelerations():
    push = [cs.FingerAcceleration(0, 0.1, 0.6, (3.0, 1.0))]
    given = {"object_velocity": "rest", "gain": cs.Gain.time(3.0), "disturbances": push}
    found, expected = (
        cs.plan(alone(cs.Torus(0.3, 0.1), profile=(sigma,), finger_velocity=w, **given))
        for sigma, w in ((1e-10, (6e8, 8e8)), (0.1, (0.6, 0.8)))
    )
    assert np.abs(found.points(TIMES) - expected.points(TIMES)).max() < 1e-14


def test_a_path_of_too_many_panels_is_refused_with_the_cause(monkeypatch):
    monkeypatch.setattr(cs.limits, "PANELS", 1e4)  # for a short test
    far = cs.ImplicitSurface("(x-1e4)**2 + y**2 + 2*z**2 - 0.01", size=0.1, center=(1e4, 0, 0))
    flat, ball = cs.ImplicitSurface("(x**2 + y**2 + z**2 - 0.01)**3", size=0.1), cs.Sphere(0.1)
    force, pull = cs.ObjectAcceleration(0, 0, 1, (0, 5e18)), cs.ObjectRateOffset(0, 0, 1, (-9, 0))
    for obj, acts, why in (
        (ball, force, "panels reach t = .* s of .*PANELS higher"),
        (far, force, "panels reach t = .* s of .*so give tolerance=1e-10"),
        (ball, pull, r"past t = 0\.\d+ s: .* a pole .* or end the scene or the disturbance before"),
        (flat, pull, "the gradient of F vanishes on the surface"),
    ):
        with pytest.raises(cs.ContactSystemError, match=why):
            cs.plan(alone(obj, object_velocity="rest", disturbances=[acts]))


@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
def test_slip_on_a_cylinder_keeps_the_tolerance_on_long_paths(tolerance):
    # unrolled to a plane, the path is W s - V g with g = sigma (1 - exp(-eta t)) / eta
    sigma, rate, t = 785.0, 1e4, np.array([1e-5, 3e-5, 1e-4, 3e-4, 1e-3])
    start = {"finger_velocity": (1, 0), "object_velocity": (0.3, 0.9), "gain": cs.Gain.time(rate)}
    plan = cs.plan(alone(cs.Cylinder(0.1), (0.0, 0.0), (sigma,), 30.0, **start), tolerance)
    g = -sigma * np.expm1(-rate * t) / rate
    assert plan.states(t)[:, 0, 4] == pytest.approx((sigma * t - 0.7 * g) / 0.1, abs=tolerance)
