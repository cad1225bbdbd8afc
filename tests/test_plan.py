"""A plan as an object: times, restart, files, what it says, and which ways it takes."""

from __future__ import annotations

import contextlib
import copy
import csv
import dataclasses
import functools
import pickle
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from math import pi
from threading import Barrier

import numpy as np
import pytest
from conftest import (
    PAST_UMBILICS,
    SURFACES,
    one_contact,
    path_velocities,
    reflection,
    slip_of_states,
)
from numpy.polynomial import polynomial
from scipy.integrate import quad, solve_ivp

import contact_system as cs
from contact_system import panel_tracks, panels, planner
from contact_system.errors import ContactSystemError, SceneError

SHAPES = {"states": (9,), "points": (2, 3), "slip": (2,), "acceleration": (2,), "pose": (4, 4),
          "twist": (6,)}  # fmt: skip
ASK = tuple(SHAPES)
WINDOWS = [
    cs.FingerAcceleration(0, 0.2, 0.4, (0.5, -0.8)),
    cs.ObjectAcceleration(0, 0.3, 0.6, (0.7, 0.6)),
    cs.ObjectRateOffset(0, 0.5, 0.8, (0.4, -0.3)),
]


def busy(obj: str = "ellipsoid", finger: str = "sphere", **given) -> cs.Scene:
    """A slipping contact with overlapping windows of all three kinds."""
    return one_contact(obj, finger, profile=(0.2, 0.1), disturbances=WINDOWS, **given)


def several() -> cs.Scene:
    """Seven contacts on an ellipsoid: two finger kinds, rest, rolling, slip, one window."""
    sphere, torus = cs.Sphere(0.04), cs.Torus(0.05, 0.02)
    places = [(0.7, 0.4), (1.9, -0.6), (-2.0, 1.1), (2.6, 0.2), (-0.6, -1.0), (1.2, 1.3)]
    places += [(-1.4, 0.8)]
    starts = [(0.2, -0.5), "rolling", "rest", (0.4, 0.1), "rolling", (-0.3, 0.3), (0.9, 0.9)]
    fingers = [sphere, sphere, torus, cs.Sphere(0.02), torus, sphere, sphere]
    contacts = [
        cs.Contact(finger=f, object_at=at, finger_at=(1.2, 0.3), angle=0.2 * i, object_velocity=v)
        for i, (f, at, v) in enumerate(zip(fingers, places, starts))
    ]
    return cs.Scene(
        object=cs.Ellipsoid(0.3, 0.2, 0.1), contacts=contacts, profile=cs.Profile([0.1, 0.2]),
        gain=cs.Gain.time(5.0), duration=1.0,
        disturbances=[cs.FingerAcceleration(5, 0.3, 0.5, (0.4, -0.2))],
    )  # fmt: skip


# --- asking


@pytest.mark.parametrize("ask", ASK)
def test_results_have_times_first_and_contacts_second(ask):
    plan = cs.plan(several())
    assert getattr(plan, ask)(np.linspace(0, 1, 5)).shape == (5, 7, *SHAPES[ask])
    assert getattr(plan, ask)(0.5).shape == (1, 7, *SHAPES[ask])
    assert getattr(plan, ask)([]).shape == (0, 7, *SHAPES[ask])


@pytest.mark.parametrize("ask", ASK)
@pytest.mark.parametrize("scene", [busy, several], ids=["windows", "contacts"])
def test_times_come_in_any_order(scene, ask):
    plan = cs.plan(scene())
    t = np.random.default_rng(0).permutation(np.append(np.linspace(0, 1, 57), [0.5, 0.5, 0.2]))
    together = getattr(plan, ask)(t)
    one_by_one = np.concatenate([getattr(plan, ask)(x) for x in t])
    scale = np.abs(one_by_one).max()
    assert together == pytest.approx(one_by_one, abs=1e-14 * scale)


def test_what_was_asked_before_does_not_change_an_answer():
    t = np.linspace(0, 1, 31)
    fresh, used = cs.plan(busy()), cs.plan(busy())
    for ask in reversed(ASK):
        getattr(used, ask)(t[::7])
    for ask in ASK:
        assert np.array_equal(getattr(fresh, ask)(t), getattr(used, ask)(t)), ask


@pytest.mark.parametrize(("gain", "method"), [
    (cs.Gain.time(1e4), "auto"), (cs.Gain.guaranteed(1e4), "auto"), (cs.Gain.time(1.0), "chart"),
])  # fmt: skip
def test_slip_that_ends_below_what_a_double_holds_is_no_error(gain, method):
    scene = cs.load_scene("K2").replace(gain=gain)
    with np.errstate(all="raise"):
        plan = cs.plan(scene, method=method, compiled=False)
        for ask in ASK:
            getattr(plan, ask)(np.linspace(0, scene.duration, 9))
        assert np.isfinite(cs.summary(plan)["slip_end"]).all()
        assert len(cs.rejections(plan)) == len(scene.contacts)


def test_plans_are_deterministic():
    t = np.linspace(0, 1, 31)
    scene = busy()
    plans = [cs.plan(scene), cs.plan(scene, tolerance=1e-6), cs.plan(scene), cs.plan(busy())]
    for ask in ASK:
        first, _, again, other = (getattr(plan, ask)(t) for plan in plans)
        assert np.array_equal(first, again) and np.array_equal(first, other), ask


@pytest.mark.parametrize("t", [-1e-9, 1.0000001, [0.5, 2.0], np.nan, np.inf])
def test_time_outside_the_horizon_is_named_with_the_horizon(t):
    plan = cs.plan(one_contact())
    bad = np.ravel(t)[-1]
    words = rf"'sphere on sphere': t = \S*{bad:.3g}.*outside the plan's horizon \[0, 1\] s"
    for ask in ASK:
        with pytest.raises(ContactSystemError, match=words):
            getattr(plan, ask)(t)


def test_table_of_times_is_refused():
    with pytest.raises(ContactSystemError, match=r"times have shape \(1, 2\); give one axis"):
        cs.plan(one_contact()).points([[0.1, 0.2]])


@pytest.mark.parametrize("tolerance", [0.0, -1e-9, 1e-16, 0.2, np.nan, np.inf, 10**400])
def test_tolerance_out_of_bounds_is_refused(tolerance):
    with pytest.raises(SceneError, match="tolerance = .*: give a number from 1e-15 to 1e-1"):
        cs.plan(one_contact(), tolerance=tolerance)


@pytest.mark.parametrize("compiled", ["no", 0, 1.0])
def test_only_true_false_and_none_say_whether_kernels_are_compiled(compiled):
    message = f"compiled = {compiled!r}: give True or False, or None"
    with pytest.raises(SceneError, match=message):
        cs.plan(one_contact(), compiled=compiled)
    with pytest.raises(SceneError, match=message):
        cs.sweep([one_contact()], compiled=compiled)


def test_tolerance_may_be_of_any_kind_of_number():
    assert cs.plan(one_contact(), tolerance=np.float32(1e-6)).tolerance == np.float32(1e-6)
    for wrong in ("1e-6", True, None, 1e-6j):
        with pytest.raises(SceneError, match="tolerance = .*: give a number"):
            cs.plan(one_contact(), tolerance=wrong)


def test_what_is_no_scene_is_refused():
    with pytest.raises(SceneError, match="scene = 'K4': give a Scene, such as load_scene"):
        cs.plan("K4")


@pytest.mark.parametrize("t", ["0.5", ["0.5"], [True], 0.5 + 0j, [0.5 + 1j], [[0.1], [0.2, 0.3]]])
def test_what_is_no_time_is_refused(t):
    for ask in ASK:
        with pytest.raises(ContactSystemError, match="give a time in seconds, or one axis"):
            getattr(cs.plan(one_contact()), ask)(t)


def test_times_may_be_of_any_kind_of_number():
    plan = cs.plan(one_contact(duration=2.0))
    expected = plan.states([1.0, 2.0])
    for t in ([1, 2], np.array([1, 2], np.uint8), np.float32([1, 2]), [Fraction(1), Fraction(2)]):
        assert np.array_equal(plan.states(t), expected)


def test_an_integer_beyond_floating_point_is_no_time_and_no_state():
    plan = cs.plan(one_contact())
    with pytest.raises(ContactSystemError, match="t = 1000.*: give a time in seconds"):
        plan.states(10**400)
    with pytest.raises(SceneError, match=r"give numbers, shape \(1, 9\)"):
        plan.restart(0.5, [[10**400] * 9])


@pytest.mark.parametrize("name", ["D1", "K4", "C2"])
def test_no_times_have_no_answers_without_a_compiler_either(name):
    plan = cs.plan(cs.load_scene(name), compiled=False)
    for ask in ASK:
        assert getattr(plan, ask)([]).shape[:2] == (0, len(plan.scene.contacts))


def test_unknown_method_is_refused():
    with pytest.raises(SceneError, match="method = 'euler': use one of auto, chart"):
        cs.plan(one_contact(), method="euler")


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12])
@pytest.mark.parametrize("name", ["ellipsoid", "torus", "bumps", "rounded cube", "several"])
def test_contact_points_are_right_to_the_tolerance(name, tolerance):
    scene = several() if name == "several" else busy(name, "ellipsoid")
    t = np.linspace(0, 1, 101)
    truth, plan = cs.plan(scene, tolerance=1e-15), cs.plan(scene, tolerance=tolerance)
    gap = np.abs(plan.points(t) - truth.points(t)).max((0, 3))
    sizes = np.array([[c.finger.size, scene.object.size] for c in scene.contacts])
    assert (gap / sizes).max() <= tolerance


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-4])
def test_coarse_tolerances_are_kept_on_a_torus(tolerance, compiled):
    major, minor, at, w = 0.25, 0.125, (0.42, -2.44), np.array([-0.765, -0.716])
    torus = cs.Torus(major, minor)
    contact = cs.Contact(torus, object_at=(0.0, 0.0), finger_at=at, finger_velocity=tuple(w))
    scene = cs.Scene(object=cs.Plane(), contacts=[contact], profile=cs.Profile([1.0]), duration=2.0)

    def geodesic(_, y):  # by Clairaut's and the chart's equations of second order
        _, v, du, dv = y
        rho, slope = major + minor * np.cos(v), -minor * np.sin(v)
        return [du, dv, -2 * slope / rho * du * dv, rho * slope / minor**2 * du**2]

    rates = w / (major + minor * np.cos(at[1]), minor)
    t = np.linspace(0, 2, 41)
    truth = solve_ivp(geodesic, (0, 2), [*at, *rates], "DOP853", t, rtol=1e-11, atol=1e-11).y
    points = cs.plan(scene, tolerance, compiled=compiled).points(t)[:, 0, 0]
    gap = np.linalg.norm(points - torus.point(*truth[:2]), axis=1)
    assert gap.max() <= tolerance * torus.size


PUSHED_UNDER_STRONG_GAIN = {
    "finger accelerated": cs.Scene(
        object=cs.Plane(),
        contacts=[cs.Contact(
            cs.Torus(0.0311, 0.0182), (0.224, -0.13), (-1.418, 2.472), 1.589, (0.601, 0.628)
        )],
        profile=cs.Profile([0.0742, 0.3]), duration=0.82, gain=cs.Gain.time(2024.0),
        disturbances=[cs.FingerAcceleration(0, 0.06, 0.67, (-0.334, -0.334))],
    ),
    "object's rate offset": cs.Scene(
        object=cs.Ellipsoid(0.2009, 0.1734, 0.1524),
        contacts=[cs.Contact(
            cs.Ellipsoid(0.0737, 0.0737, 0.0323), (-2.977, 0.491), (-1.714, 0.575), 0.241,
            (-0.79, 0.776), "rest",
        )],
        profile=cs.Profile([0.0156]), duration=0.85, gain=cs.Gain.time(14856.0),
        disturbances=[cs.ObjectRateOffset(0, 0.0, 0.831, (0.0165, -0.0384))],
    ),
}  # fmt: skip


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("name", PUSHED_UNDER_STRONG_GAIN)
def test_tolerances_are_kept_where_slip_settles_within_a_panel(name, compiled):
    # Sweeps once stopped as if all had settled with slip, 110 tolerances off. Few panels: a tenth.
    scene = PUSHED_UNDER_STRONG_GAIN[name]
    t = np.linspace(0.0, scene.duration, 30)
    truth = cs.plan(scene, 1e-13, method="chart", solver="Radau").points(t)[:, 0]
    sizes = np.array([scene.contacts[0].finger.size, scene.object.size])
    for tolerance in (1e-6, 1e-8, 1e-9):
        gap = cs.plan(scene, tolerance, compiled=compiled).points(t)[:, 0] - truth
        assert (np.linalg.norm(gap, axis=-1) <= 0.1 * tolerance * sizes).all(), tolerance


# --- continuity


# Closed geodesics along a chart line: start, direction, the state that grows, the radius.
CLOSED = {
    "sphere": ((pi / 2, 0.4), (0.0, 1.0), 5, 0.1),
    "cylinder": ((0.5, 0.2), (1.0, 0.0), 4, 0.1),
    "torus": ((0.3, 0.0), (1.0, 0.0), 4, 0.13),
    "oblate": ((1.2, 0.0), (1.0, 0.0), 4, 0.3),
}


@pytest.mark.parametrize("obj", CLOSED)
def test_coordinates_count_revolutions(obj):
    at, w, turning, r = CLOSED[obj]
    scene = one_contact(obj, "plane", object_at=at, angle=0.0, object_velocity="rolling",
                        finger_velocity=(w[0], -w[1]), profile=(1.0,), duration=9.0)  # fmt: skip
    t = np.array([0.0, 8.9, 0.1, 4.0, 9.0])
    states = cs.plan(scene).states(t)[:, 0]
    assert states[:, turning] == pytest.approx(at[turning - 4] + t / r, abs=1e-11)


@pytest.mark.parametrize("obj", ["sphere", "bowl", "cylinder", "torus", "ellipsoid", "oblate",
                                 "prolate", "turned ellipsoid", "rounded cube"])  # fmt: skip
def test_states_are_continuous_over_many_revolutions(obj):
    scene = one_contact(obj, gain=cs.Gain.time(1.0), profile=(0.4, 0.1), duration=8.0,
                        disturbances=[cs.ObjectRateOffset(0, 2.0, 3.0, (0.1, 0.2))])  # fmt: skip
    plan = cs.plan(scene)
    t = np.linspace(0, 8, 20001)
    states = plan.states(t)[:, 0]
    step = np.abs(np.diff(states[:, [0, 1, 4, 5]], axis=0))
    allowed = 1.5 * np.maximum(np.abs(states[:-1, [2, 3, 6, 7]]), np.abs(states[1:, [2, 3, 6, 7]]))
    assert (step <= allowed * (t[1] - t[0]) + 1e-3).all()
    assert np.abs(np.diff(states[:, 8])).max() < 0.5
    assert plan.points(t)[:, 0, 1] == pytest.approx(
        np.asarray(scene.object.point(states[:, 4], states[:, 5])), abs=1e-12
    )


@pytest.mark.parametrize("obj", ["sphere", "torus", "ellipsoid", "rounded cube"])
def test_sparse_times_see_the_same_branch_as_dense_times(obj):
    scene = one_contact(obj, gain=cs.Gain.time(1.0), profile=(0.4, 0.1), duration=8.0)
    dense = cs.plan(scene).states(np.linspace(0, 8, 2001))
    assert cs.plan(scene).states([8.0])[0] == pytest.approx(dense[-1], abs=1e-12)
    few = cs.plan(scene).states([8.0, 0.0, 3.0])
    assert few == pytest.approx(dense[[-1, 0, 750]], abs=1e-12)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("scene", PAST_UMBILICS, ids=lambda scene: scene.name)
def test_paths_close_to_umbilics_stay_on_their_branch(scene, compiled):
    t = np.linspace(0.0, 4.0, 161)
    truth = cs.plan(scene, method="chart")  # the paper's equations, by scipy
    expected = truth.states(t), truth.points(t)
    for _ in range(3):  # the third is planned by what the first two taught
        plan = cs.plan(scene.replace(), compiled=compiled)
        assert np.abs(plan.states(t[::40]) - expected[0][::40]).max() < 1e-7
        assert np.abs(plan.states(t) - expected[0]).max() < 1e-7
        assert np.abs(plan.points(t) - expected[1]).max() < 1e-9


@pytest.mark.parametrize("compiled", [False, True])
def test_geodesic_along_a_seam_crosses_beside_the_umbilic(compiled):
    # Jacobi's constant is positive, and so cos v is never 0: 1e-13 of the size off the seam, the
    # path crosses y = 0 where sin u is 0, 4e-7 beyond the umbilic
    contact = cs.Contact(
        finger=cs.Sphere(0.04), object_at=(3.144943168853535, -1.5707579168350703),
        finger_velocity=(0.9962732538067015, 0.08625313762065588),
    )  # fmt: skip
    obj = cs.Ellipsoid(1.0, 0.9999999461818512, 0.9999968767629274)
    scene = cs.Scene(object=obj, contacts=[contact], profile=cs.Profile([12.0]), duration=1.0)
    v = cs.plan(scene, compiled=compiled).states(np.linspace(0, 1, 400))[:, 0, 5]
    assert (np.cos(v) > 0).all()


def test_coarse_plans_have_one_branch_for_few_and_many_times():
    contact = cs.Contact(
        finger=cs.Sphere(0.04), object_at=(-0.0016728859139098205, 1.570554192253053),
        finger_velocity=(0.9998052877529914, -0.019732880711087683),
    )  # fmt: skip
    scene = cs.Scene(
        object=cs.Ellipsoid(1, 0.6, 0.59), contacts=[contact], profile=cs.Profile([1.0]), duration=1
    )
    t, tolerance = np.linspace(0, 1, 401), 0.08113544635687064
    many = cs.plan(scene, tolerance, compiled=True).states(t)
    few = cs.plan(scene.replace(), tolerance, compiled=True).states(t[::40])
    assert np.abs(many[::40] - few).max() < 0.2


@pytest.mark.parametrize("object_velocity", ["rolling", "rest"])
def test_quadric_that_is_a_rounded_sphere_is_planned_as_the_sphere(object_velocity):
    # R (1/r^2) R^T has no zeros off its diagonal, and eigenvectors in any direction
    rounding = [[0.0, 3.7e-17, 3.0e-17], [3.7e-17, -2.2e-16, -6.7e-17], [3.0e-17, -6.7e-17, 0.0]]
    quadric = cs.Quadric(np.eye(3) / 0.2**2 + 0.2**-2 * np.array(rounding))
    contact = cs.Contact(
        finger=quadric, object_at=(1.1, -2.0), finger_at=(0.9, 0.4), object_velocity=object_velocity
    )  # fmt: skip
    scene = cs.Scene(object=quadric, contacts=[contact], profile=cs.Profile([0.1, 0.2]), duration=2)
    ball = dataclasses.replace(contact, finger=cs.Sphere(0.2))
    truth, t = cs.plan(scene.replace(object=cs.Sphere(0.2), contacts=[ball])), np.linspace(0, 2, 9)
    for ask in ("states", "points", "twist"):
        expected = getattr(truth, ask)(t)
        assert getattr(cs.plan(scene), ask)(t) == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("method", ["auto", "chart"])
def test_values_at_the_end_are_those_before_the_windows_that_end_there(method):
    windows = [cs.ObjectRateOffset(0, 0.5, 1.0, (0.4, -0.3)),
               cs.ObjectAcceleration(0, 0.5, 1.0, (0.1, 0.2))]  # fmt: skip
    plan = cs.plan(one_contact(disturbances=windows), 1e-9, method)
    for ask in ("states", "slip", "acceleration", "twist"):
        before, end = getattr(plan, ask)([1 - 1e-9, 1.0])
        assert end == pytest.approx(before, abs=1e-6), ask


@pytest.mark.parametrize("obj", ["sphere", "cylinder", "ellipsoid", "bumps", "rounded cube"])
def test_motion_is_continuous_at_window_edges(obj):
    plan = cs.plan(busy(obj))
    for edge in plan.scene.edges[1:-1]:
        before, at = edge - 1e-12, edge
        for ask, kept in (("points", ...), ("pose", ...), ("states", [0, 1, 2, 3, 4, 5, 8])):
            x, y = (getattr(plan, ask)(t)[0, 0] for t in (before, at))
            x, y = (np.asarray(z)[kept] for z in (x, y))
            assert x == pytest.approx(y, abs=1e-10), (ask, edge)
        own = [plan.states(t)[0, 0, 6:8] for t in (before, at)]
        jump = np.array([0.4, -0.3]) * ((edge == 0.5) - (edge == 0.8))
        assert own[1] - own[0] == pytest.approx(jump, abs=1e-10)


def test_offset_acts_from_the_start_of_its_window_up_to_its_stop():
    # A rolling contact: its slip is -M2 d inside, nothing outside.
    d = np.array([0.6, 1.0])
    scene = one_contact("torus", object_velocity="rolling", profile=(0.2, 0.1),
                        disturbances=[cs.ObjectRateOffset(0, 0.25, 0.5, tuple(d))])  # fmt: skip
    plan = cs.plan(scene)
    for t, inside in ((0.25 - 1e-15, 0), (0.25, 1), (0.5 - 1e-15, 1), (0.5, 0)):
        u, v = plan.states(t)[0, 0, 4:6]
        expected = -inside * np.asarray(scene.object.metric_root(u, v)) @ d
        assert plan.slip(t)[0, 0] == pytest.approx(expected, abs=1e-15)


def test_disturbance_on_the_second_cover_acts_on_the_point_that_it_names():
    # (u, v) ~ (-u, pi - v), where both axes are turned: the same contact, written both ways.
    push = cs.ObjectAcceleration, cs.ObjectRateOffset
    second = one_contact(
        "ellipsoid", object_at=(-0.7, pi - 0.4), profile=(0.2, 0.1),
        disturbances=[kind(0, 0.3, 0.6, (0.5, -0.8)) for kind in push],
    )  # fmt: skip
    first = one_contact(
        "ellipsoid", object_at=(0.7, 0.4), profile=(0.2, 0.1), angle=0.3 + pi,
        object_velocity=(-0.2, 0.5),
        disturbances=[kind(0, 0.3, 0.6, (-0.5, 0.8)) for kind in push],
    )  # fmt: skip
    t = np.linspace(0, 1, 31)
    one, two = cs.plan(first), cs.plan(second)
    assert two.pose(t) == pytest.approx(one.pose(t), abs=1e-13)
    assert two.twist(t) == pytest.approx(one.twist(t), abs=1e-12)
    assert np.linalg.norm(two.slip(t), axis=-1) == pytest.approx(
        np.linalg.norm(one.slip(t), axis=-1), abs=1e-13
    )


# --- many contacts


def test_contacts_together_move_as_each_alone():
    scene, t = several(), np.linspace(0, 1, 41)
    together = cs.plan(scene)
    for i, contact in enumerate(scene.contacts):
        windows = [cs.FingerAcceleration(0, d.start, d.stop, d.value)
                   for d in scene.disturbances if d.contact == i]  # fmt: skip
        alone = cs.plan(scene.replace(contacts=[contact], disturbances=windows))
        for ask in ASK:
            expected = getattr(alone, ask)(t)[:, 0]
            bar = 1e-13 * max(1.0, np.abs(expected).max())
            assert getattr(together, ask)(t)[:, i] == pytest.approx(expected, abs=bar), (ask, i)


def test_undisturbed_contact_is_not_integrated_because_another_is_disturbed():
    scene = cs.load_scene("D1")
    disturbed, calm = cs.plan(scene), cs.plan(scene.replace(disturbances=()))
    t = np.linspace(0, 4, 41)
    assert np.array_equal(disturbed.states(t)[:, 1:], calm.states(t)[:, 1:])
    assert np.array_equal(disturbed.twist(t)[:, 1:], calm.twist(t)[:, 1:])
    others = disturbed.explain().split("contacts 1, 2:")[1]
    assert "great circle" in others and "skipped: all integration" in others
    assert "panels" not in others


@pytest.mark.parametrize("compiled", [False, None])
@pytest.mark.parametrize("obj, finger", [
    ("sphere", "sphere"), ("ellipsoid", "sphere"), ("torus", "ellipsoid"), ("cylinder", "torus"),
    ("rounded cube", "bumps"),
])  # fmt: skip
@pytest.mark.parametrize("kinds", [
    (cs.FingerAcceleration,), (cs.ObjectAcceleration,), (cs.ObjectRateOffset,),
    (cs.FingerAcceleration, cs.ObjectRateOffset),
])  # fmt: skip
def test_a_plan_does_not_depend_on_scenes_planned_before(monkeypatch, kinds, obj, finger, compiled):
    windows = [kind(0, 0.2, 0.4 + 0.1 * k, (0.3, -0.2)) for k, kind in enumerate(kinds)]
    scene = one_contact(obj, finger).replace(disturbances=windows, name="second")
    start, t = scene.contacts[0], np.linspace(0, 1, 21)
    other = dataclasses.replace(
        start, angle=start.angle + 0.4, finger_velocity=(0.3, -0.8), object_velocity=(0.1, 0.5),
        object_at=np.multiply(start.object_at, 1.01),
    )  # fmt: skip

    def found() -> list:
        plan = cs.plan(scene.replace(), compiled=compiled)
        return [plan.explain(), *(getattr(plan, ask)(t).tobytes() for ask in ASK)]

    for memory in ("_FAMILIES", "_WITH_KIND"):
        monkeypatch.setattr(planner, memory, OrderedDict())
    alone = found()
    monkeypatch.setattr(planner, "_FAMILIES", OrderedDict())
    cs.plan(scene.replace(contacts=[other], name="first"), 1e-6, compiled=compiled).states(t)
    assert len(planner._FAMILIES) == 1
    assert found() == alone
    assert len(planner._FAMILIES) == 1


def test_a_refusal_names_the_scene_that_is_planned_now(monkeypatch):
    monkeypatch.setattr(panels, "MOST_HERE", 1e3)
    for name in ("one", "two"):
        windows = [cs.ObjectRateOffset(0, 0.1, 1.0, (-3.0, 0.0))]
        scene = one_contact("sphere", "sphere").replace(disturbances=windows, name=name)
        with pytest.raises(cs.ContactSystemError, match=f"scene '{name}', contact 0: .*pole"):
            cs.plan(scene, compiled=False).states([0.0, 1.0])


def test_an_acceleration_where_the_path_almost_rests_is_refused_as_such(monkeypatch):
    monkeypatch.setattr(panels, "MOST_HERE", 1e3)
    windows = [cs.FingerAcceleration(0, 0.1, 1.0, (0.3, 0.1))]
    scene = one_contact("sphere", "sphere").replace(
        disturbances=windows, profile=cs.Profile([0.1 + 1e-9, -0.4, 0.4])
    )
    with pytest.raises(cs.ContactSystemError, match=r"sigma = .* m/s; add a constant"):
        cs.plan(scene, compiled=False).states([0.0, 1.0])


def test_the_latest_families_are_remembered(monkeypatch):
    monkeypatch.setattr(planner, "_FAMILIES", OrderedDict())
    scene = one_contact("sphere", "sphere")
    for k in range(planner.FAMILIES + 10):
        cs.plan(scene.replace(gain=cs.Gain.time(10.0 + k)), compiled=False)
    assert len(planner._FAMILIES) == planner.FAMILIES
    crowd = scene.replace(contacts=scene.contacts * 50)
    cs.plan(crowd, compiled=False)
    assert len(planner._FAMILIES) == planner.FAMILIES
    assert not planner.family(crowd).patterns  # too many to be worth it


def test_disturbed_scenes_are_planned_in_many_threads():
    rng, t = np.random.default_rng(7), np.linspace(0, 1, 31)
    scenes = []
    for _ in range(48):
        angle, heading = rng.uniform(-3, 3, 2)
        scenes.append(busy(angle=angle, finger_velocity=(np.cos(heading), np.sin(heading))))

    def answer(scene: cs.Scene) -> bytes:
        plan = cs.plan(scene, 1e-9)
        return plan.states(t).tobytes() + plan.points(t).tobytes()

    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(answer, scenes))
    assert together == [answer(scene.replace()) for scene in scenes]


@pytest.mark.parametrize("compiled", [False, None])
def test_contacts_of_a_crowd_are_planned_as_if_they_were_alone(compiled):
    # two windows: the second is given in components of the branch that the first has come to
    contact = cs.Contact(
        finger=cs.Sphere(0.04), object_at=(1.0, 1.2), finger_velocity=(0.2, -1.0)
    )  # fmt: skip
    windows = [
        cs.FingerAcceleration("all", 1.2, 1.3, (0.1, 0.1)),
        cs.ObjectAcceleration("all", 1.5, 1.8, (0.5, 0.3)),
    ]
    alone = cs.Scene(
        object=cs.Ellipsoid(0.3, 0.2, 0.1), contacts=[contact], profile=cs.Profile([0.1]),
        duration=2.0, gain=cs.Gain.time(5.0), disturbances=windows,
    )  # fmt: skip
    crowd = alone.replace(contacts=[contact] * 60, disturbances=windows)
    t = np.linspace(0.0, 2.0, 41)
    for output in ("points", "states"):
        one, many = (
            getattr(cs.plan(s, compiled=compiled), output)(t) for s in (alone, crowd)
        )  # fmt: skip
        assert np.abs(many - one).max() < 1e-12, output


@pytest.mark.parametrize("compiled", [False, None])
def test_threads_may_ask_one_plan(compiled):
    window = [cs.FingerAcceleration("all", 0.3, 0.5, (3.0, 1.0))]
    contacts = [
        cs.Contact(
            finger=cs.Ellipsoid(0.06, 0.05, 0.04), object_at=(0.3 + 0.2 * k, 1.2),
            finger_at=(1.0, 0.5), object_velocity="rest",
        ) for k in range(3)
    ]  # fmt: skip
    scene = cs.Scene(
        object=cs.Ellipsoid(0.3, 0.2, 0.1), contacts=contacts, profile=cs.Profile([0.3]),
        gain=cs.Gain.time(5.0), duration=1.0, disturbances=window,
    )  # fmt: skip
    t = np.linspace(0.0, 0.95, 23)
    expected = cs.plan(scene, 1e-9, compiled=compiled).states(t)
    with ThreadPoolExecutor(6) as pool:
        for _ in range(40 if compiled else 4):
            plan, gate = cs.plan(scene.replace(), 1e-9, compiled=compiled), Barrier(6)

            def ask(plan=plan, gate=gate) -> np.ndarray:
                gate.wait()
                return plan.states(t)

            for found in [pool.submit(ask) for _ in range(6)]:
                assert np.abs(found.result() - expected).max() < 1e-12


@pytest.mark.parametrize("compiled", [False, None])
@pytest.mark.parametrize("length", [5e-324, 1e-310, 1e-300, 1e-160, 1e-20])
def test_a_window_may_be_as_short_as_it_likes(length, compiled):
    plain = one_contact(finger="sphere", object_velocity=(0.2, -0.5))
    scene = plain.replace(disturbances=[cs.FingerAcceleration("all", 0.0, length, (0.1, 0.2))])
    t = np.linspace(0.0, 1.0, 5)
    for output in ("points", "states"):
        found, expected = (
            getattr(cs.plan(s, compiled=compiled), output)(t) for s in (scene, plain)
        )  # fmt: skip
        assert found == pytest.approx(expected, abs=1e-13), output


# --- which way is taken


@pytest.mark.parametrize("finger, words", [
    ("sphere", "closed form: great circle"), ("bowl", "closed form: great circle"),
    ("plane", "closed form: straight line on the developed surface"),
    ("cylinder", "closed form: straight line on the developed surface"),
    ("torus", "geodesic in arc length"),
    ("ellipsoid", "geodesic in arc length"), ("bumps", "geodesic in arc length"),
])  # fmt: skip
def test_undisturbed_finger_takes_the_cheapest_exact_way(finger, words):
    (line,) = [x for x in cs.plan(one_contact(finger=finger)).explain().splitlines()
               if x.startswith("  finger")]  # fmt: skip
    assert words in line


@pytest.mark.parametrize("obj, slipping, rolling", [
    ("sphere", "development in space", "closed form: great circle"),
    ("plane", "quadrature of slip", "closed form: straight line on the developed surface"),
    ("cylinder", "quadrature of slip", "closed form: straight line on the developed surface"),
    ("ellipsoid", "development in space", "geodesic in arc length"),
    ("rounded cube", "development in space", "geodesic in arc length"),
    ("bumps", "development in its chart", "geodesic in arc length"),
])  # fmt: skip
def test_object_takes_the_cheapest_exact_way(obj, slipping, rolling):
    assert slipping in cs.plan(one_contact(obj)).explain()
    text = cs.plan(one_contact(obj, object_velocity="rolling")).explain()
    assert rolling in text and slipping not in text
    assert "no slip" in text


def test_explain_names_scene_tolerance_intervals_and_causes():
    text = cs.plan(busy(), tolerance=1e-10).explain()
    for words in ("'sphere on ellipsoid'", "tolerance 1e-10", "method auto", "contact 0:",
                  "[0.2, 0.3] s  forced development", "finger acceleration and object acceleration",
                  "object rate offset", "object [0.8, 1] s"):  # fmt: skip
        assert words in text
    assert "imposed" in cs.plan(cs.load_scene("C2")).explain()


@pytest.mark.parametrize(
    ("obj", "angle"),
    [
        (cs.Sphere(0.1), pi),  # through a pole of the finger
        (cs.ImplicitSurface("x**2 + y**2 + z**4 - 1"), 0.5),
    ],
)
def test_imposed_rolling_passes_poles_and_needs_no_chart(obj, angle):
    contact = cs.Contact(finger=cs.Sphere(0.04), object_at=(1.2, 0.3), angle=angle,
                         finger_velocity="rolling", object_velocity=(1, 0))  # fmt: skip
    scene = cs.Scene(object=obj, contacts=[contact], profile=cs.Profile([0.1]), duration=4.0)
    t = np.linspace(0, 4, 41)
    # unit speed at (pi/2, 0), where E1 = [-z y x], along R_psi (1, 0)
    along = np.array([0.0, -np.sin(angle), -np.cos(angle)])
    s = 0.1 * t / 0.04
    circle = 0.04 * (np.outer(np.cos(s), [1, 0, 0]) + np.outer(np.sin(s), along))
    assert np.abs(cs.plan(scene).points(t)[:, 0, 0] - circle).max() < 1e-12 * 0.04


def test_imposed_rolling_keeps_the_pose_where_the_finger_goes_through_its_pole():
    common = {"profile": cs.Profile([0.1]), "duration": 2.0, "object": cs.Sphere(0.3)}
    given = {"finger": cs.Sphere(0.04), "finger_at": (0.5, 0.2), "object_at": (1.5, 0.3)}
    rolling = cs.Contact(**given, finger_velocity="rolling", object_velocity=(-1, 0))
    planned = cs.Contact(**given, finger_velocity=(-1, 0))
    plans = [cs.plan(cs.Scene(contacts=[contact], **common)) for contact in (rolling, planned)]
    t = np.linspace(0, 2, 41)
    assert plans[0].pose(t) == pytest.approx(plans[1].pose(t), abs=1e-13)


BALL = cs.ParametricSurface(
    ("r*sin(u)*cos(v)", "r*sin(u)*sin(v)", "r*cos(u)"), parameters={"r": 0.1}, size=0.1
)
CONE = cs.ParametricSurface(("v*cos(u)", "v*sin(u)", "-v"), size=0.1)


def test_states_are_refused_where_the_centre_of_an_implicit_surface_does_not_see_the_path():
    level = "(sqrt(x**2 + y**2) - 0.2)**2 + z**2 - 0.07**2"  # a ring, seen from within its tube
    ring = cs.ImplicitSurface(level, center=(0.2, 0, 0), size=0.27)
    u, v = ring.coordinates(cs.Torus(0.2, 0.07).point(0.1, 0.3))
    contact = cs.Contact(
        finger=cs.Plane(), finger_at=(0, 0), object_at=(u, v), finger_velocity=(0.8, 0.6),
        object_velocity=(0.5, 0.2),
    )  # fmt: skip
    gain, profile = cs.Gain.time(3), cs.Profile([1.5])
    scene = cs.Scene(object=ring, contacts=[contact], profile=profile, gain=gain, duration=1)
    plan = cs.plan(scene, compiled=False)
    assert plan.points(1.0)[0, 0, 1, 0] < 0 and np.isfinite(plan.twist(1.0)).all()
    assert np.isfinite(plan.states(0.1)).all()
    for ask in (plan.states, plan.slip):
        with pytest.raises(cs.ChartSingularity, match="out of the centre's sight"):
            ask([0.1, 1.0])
    motion = plan.pose(1.0)[0], plan.twist(1.0)[0], plan.points(1.0)[0, :, 1]
    with pytest.raises(cs.ChartSingularity, match="out of sight of an .* another center"):
        cs.measured_states(scene, *motion)


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("tolerance", [1e-12, 1e-3])
@pytest.mark.parametrize(("obj", "at", "along", "text"), [
    (BALL, (0.5, 0.2), (-1.0, 0.0), r"contact 0: .*ParametricSurface.* at \(u, v\) = \(.*, 0.2\)"),
    (CONE, (0.2, 0.05), (0.0, -1.0),
     r"contact 0: .*(ParametricSurface.* at \(u, v\) = \(0.2, .*\)|past arc length 0.07071)"),
])  # fmt: skip
def test_path_straight_through_a_pole_of_a_users_chart_is_refused(
    obj, at, along, text, tolerance, compiled
):
    finger = cs.Sphere(0.04)

    def scene(direction: tuple[float, float], place: tuple[float, float]) -> cs.Scene:
        contact = cs.Contact(finger, object_at=place, angle=0.0, finger_velocity=direction)
        return cs.Scene(object=obj, contacts=[contact], profile=cs.Profile([0.1]), duration=1.0)

    aside = -along[1], along[0]  # R_0 turns v over
    for k in range(3):  # the third of a kind is planned from its numbers
        calm = scene(aside, (at[0] + 0.01 * k, at[1]))
        assert np.isfinite(cs.plan(calm, tolerance, compiled=compiled).pose([0.1])).all()
    with pytest.raises(ContactSystemError, match=text):
        cs.plan(scene((along[0], -along[1]), at), tolerance, compiled=compiled)


@pytest.mark.parametrize(("finger", "at"), [
    (cs.Ellipsoid(0.1, 0.1, 0.001), (0.4, 0.3)), (cs.Ellipsoid(0.1, 0.001, 0.00099), (1.2, 0.3)),
    (cs.Torus(0.1, 0.1 * (1 - 1e-9)), (0.3, 0.5)),
])  # fmt: skip
def test_a_short_path_far_from_a_tip_or_an_inner_rim_takes_few_panels(finger, at):
    contact = cs.Contact(finger, (0.0, 0.0), at, finger_velocity=(0.6, 0.8))
    scene = cs.Scene(
        object=cs.Plane(), contacts=[contact], profile=cs.Profile([0.002]), duration=1.0
    )
    plan = cs.plan(scene, compiled=False)
    plan.pose(0.5)
    assert plan.groups[0].finger[0].panels.count <= 6


@pytest.mark.parametrize(("profile", "tolerance"), [
    ((0.02, 0.3), 1.4e-10), ((0.02, 0.3), 1e-8), ((0.4, -0.39), 1.1e-3), ((0.4, -0.39), 1.6e-4),
])  # fmt: skip
@pytest.mark.parametrize("searched", [1, 4096])
def test_a_pole_is_seen_wherever_panels_end(monkeypatch, profile, tolerance, searched):
    monkeypatch.setattr(panel_tracks, "SEARCHED", searched)
    refused, t = 0, np.linspace(0, 1, 11)
    for u in np.linspace(1.46, 1.47, 40):
        contact = cs.Contact(cs.Plane(), (u, 0.2), (0.0, 0.0), finger_velocity=(-1.0, 0.0))
        common = {"contacts": [contact], "profile": cs.Profile(profile), "duration": 1.0}
        try:
            pose = cs.plan(cs.Scene(object=BALL, **common), tolerance, compiled=False).pose(t)
        except ContactSystemError as error:
            assert "singular point of its chart" in str(error)
            refused += 1
        else:  # rounding may lead a path past the pole, in ever smaller panels
            right = cs.plan(cs.Scene(object=cs.Sphere(0.1), **common)).pose(t)
            assert pose == pytest.approx(right, abs=tolerance)
    assert refused > 5


@pytest.mark.parametrize("u", [1e-6, 1e-3, 0.98, 0.999, 1 - 1e-7, 1 + 1e-7, 1.01])
@pytest.mark.parametrize("method", ["auto", "chart"])
def test_a_pole_beside_an_end_of_the_path_is_seen_and_one_beyond_it_is_not(u, method):
    contact = cs.Contact(cs.Plane(), (u, 0.0), (0.0, 0.0), finger_velocity=(-1.0, 0.0))
    common = {"contacts": [contact], "profile": cs.Profile([0.1]), "duration": 1.0}
    if u < 1:
        with pytest.raises(ContactSystemError, match=r"singular point of its chart.* at \(u, v\)"):
            cs.plan(cs.Scene(object=BALL, **common), 1e-9, method)
    else:
        scenes = [cs.Scene(object=obj, **common) for obj in (BALL, cs.Sphere(0.1))]
        pose, expected = (cs.plan(scene, 1e-9, method).pose(1.0) for scene in scenes)
        assert pose == pytest.approx(expected, abs=1e-8)


BUMP = "h*exp(-(({} - 3)**2 + {}**2)/h**2)"
GROUND = {
    "chart": (cs.ParametricSurface(
        ("u", "v", BUMP.format("u", "v")), parameters={"h": 0.005}, size=0.1), (0.0, 0.0), 1.0),
    "implicit": (cs.ImplicitSurface(
        "z - " + BUMP.format("x", "y"), parameters={"h": 0.005}, size=0.1, center=(1.7, 0.0, -4.0)),
        (np.arctan(1.7 / 4.0), pi), -1.0),
}  # fmt: skip


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("slip", [0.0, 0.5])
@pytest.mark.parametrize("push", [0.0, 1e-13])
@pytest.mark.parametrize("ground", GROUND)
def test_a_bump_far_out_on_even_ground_is_seen(ground, push, slip, compiled):
    """A path straight over its top stays upright: its length is that of the bump's outline.

    Also where an acceleration, too small to be noticed, has both bodies moved together.
    """
    obj, at, ahead = GROUND[ground]
    contact = cs.Contact(
        cs.Plane(), at, (0.0, 0.0), finger_velocity=(ahead, 0.0),
        object_velocity=(ahead * (1 - slip), 0.0),
    )  # fmt: skip
    pushes = [cs.FingerAcceleration(0, 0.1, 1.0, (ahead * push, 0.0))] if push else []
    scene = cs.Scene(
        object=obj, contacts=[contact], profile=cs.Profile([3.5]), duration=1.0, disturbances=pushes
    )
    x, y, z = cs.plan(scene, compiled=compiled).points(1.0)[0, 0, 1]
    reach = slip * 3.5 / 100 * (1 - np.exp(-100))  # lam = 100 1/s
    slope = lambda u: 2 * (u - 3) / 0.005 * np.exp(-(((u - 3) / 0.005) ** 2))  # noqa: E731
    rise = quad(lambda u: np.hypot(1, slope(u)) - 1, 2.95, 3.05, points=[3], epsabs=1e-13)[0]
    assert [x, y, z] == pytest.approx([3.5 - reach - rise, 0, 0], abs=1e-11)


@pytest.mark.filterwarnings("error")
def test_panels_too_short_for_a_difference_of_times_are_no_warning():
    # Some 1e-13 m beside the pole. Which of these get past it, and which are told that they cannot
    # be continued, depends on numpy's last digits.
    at = (2.6435730446771846, -2.887402784955306)
    profile = cs.Profile([0.0, 1.8095648730350078])
    for aside in np.linspace(1e-12, 1e-11, 40):
        contact = cs.Contact(cs.Plane(), at, (0.2, 0.1), finger_velocity=(-1.0, -aside))
        scene = cs.Scene(object=BALL, contacts=[contact], profile=profile, duration=1.0)
        with contextlib.suppress(ContactSystemError):
            plan = cs.plan(scene, 1e-8, compiled=True)
            break
    assert np.diff(plan.groups[0].object[0].panels.edges).min() < 1e-14


@pytest.mark.parametrize("compiled", [True, False])
def test_coordinates_lose_no_turn_where_a_path_that_slips_goes_straight_through_a_pole(compiled):
    rng, asked = np.random.default_rng(4), 0
    for k in range(60):
        contact = cs.Contact(
            finger=cs.Sphere(0.04), finger_at=(1.3, 0.2), finger_velocity=(-1.0, 0.0),
            object_at=(rng.uniform(0.4, 2.6), rng.uniform(-3, 3)), object_velocity=(0.6, 0.0),
        )  # fmt: skip
        scene = cs.Scene(
            object=cs.Sphere(0.1) if k % 2 else cs.Ellipsoid(0.1, 0.1, 0.07), contacts=[contact],
            profile=cs.Profile([rng.uniform(0.3, 1.0)]), duration=1.0,
            gain=cs.Gain.path(10.0 ** rng.uniform(0, 4)),
        )  # fmt: skip
        plan = cs.plan(scene, tolerance=10.0 ** rng.uniform(-13, -6), compiled=compiled)
        for count in (150, 701):
            with contextlib.suppress(cs.ChartSingularity):  # a time at a pole
                v = plan.states(np.linspace(0.0, 1.0, count))[:, 0, [1, 5]]
                assert np.abs(np.diff(v, axis=0)).max() < 3.2
                asked += 1
    assert asked > 100  # of 120


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("obj", [
    cs.Torus(3.0, 1.0), cs.Ellipsoid(3.0, 2.0, 1.0),
    cs.ParametricSurface(("u", "v", "0.1*cos(u)*cos(v)")),
])  # fmt: skip
def test_a_window_may_end_where_rounding_sees_the_path_rest_an_instant_later(obj, compiled):
    profile = cs.Profile((2.442754781845688, -0.3257006375794251, 0.010856687919314168))
    edge = 15.0
    (rest,) = profile.extrema(0.0, 30.0)
    assert edge < rest < edge + 1e-14  # between them no path is left, or less than none
    scene = cs.Scene(
        object=obj, profile=profile, gain=cs.Gain.guaranteed(5.0), duration=30.0,
        contacts=[cs.Contact(finger=cs.Sphere(0.5), finger_at=(1.3, 0.2), object_at=(0.9, 0.4))],
        disturbances=[cs.ObjectRateOffset(0, 6.0, edge, (0.1, 0.2))],
    )  # fmt: skip
    t = [edge - 1e-9, edge, rest, edge + 1e-9]
    for ask in ("points", "states"):
        found = getattr(cs.plan(scene, tolerance=1e-8, compiled=compiled), ask)(t)[:, 0]
        found = found[..., [0, 1, 4, 5, 8]] if ask == "states" else found
        assert np.abs(found - found[1]).max() < 1e-8


def test_chart_equations_refuse_a_path_straight_through_a_pole():
    contact = cs.Contact(cs.Sphere(0.04), object_at=(0.5, 0.2), finger_velocity=(-1.0, 0.0))
    common = {"profile": cs.Profile([0.1]), "duration": 1.0}
    scene = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], **common)
    with pytest.raises(ContactSystemError, match=r"contact 0: .*Sphere\(0.04\) at .*default"):
        cs.plan(scene, method="chart")


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-8])
def test_imposed_rolling_keeps_a_coarse_tolerance_beside_an_umbilic(tolerance):
    finger = cs.Ellipsoid(0.8, 0.5, 0.45)
    rolling = {"finger_velocity": "rolling", "object_velocity": (-1.0, -1.2)}
    given = {"finger": finger, "finger_at": (0.5, -0.08), "object_at": (0.0, 0.0)}
    t, common = np.linspace(0, 2, 9), {"profile": cs.Profile([1.3, 0.3]), "duration": 2.0}
    for angle in np.linspace(-3, 3, 13):
        contact = cs.Contact(**given, **rolling, angle=angle)
        scene = cs.Scene(object=cs.Plane(), contacts=[contact], **common)
        c, s = np.cos(angle), np.sin(angle)
        own = np.array([[c, -s], [-s, -c]]) @ rolling["object_velocity"]
        planned = scene.replace(contacts=[cs.Contact(**given, angle=angle, finger_velocity=own)])
        error = cs.plan(scene, tolerance).points(t) - cs.plan(planned).points(t)
        assert np.abs(error).max() < tolerance * 0.8


@pytest.mark.parametrize("compiled", [False, None])
def test_paths_of_which_rounding_leaves_too_few_digits_are_refused(compiled):
    for size in (1.0, 2.0, 3.0, 1.05e11, 5e11, 1.05e11):  # the third is of a kind that is known
        contact = cs.Contact(cs.Sphere(0.04), (0.7, 0.4), finger_velocity=(0.04 * size, 0.0))
        scene = cs.Scene(
            object=cs.Sphere(0.1), contacts=[contact], profile=cs.Profile([1.0]), duration=1.0
        )
        if size < 1e11:
            cs.plan(scene, compiled=compiled)
        else:
            with pytest.raises(cs.SceneError, match="leave less than four digits of its position"):
                cs.plan(scene, compiled=compiled)


def test_path_at_rest_under_an_acceleration_is_refused():
    # sigma = 0 where d acts on dq/ds: the path velocity would be infinite
    for c in ((0.0, 0.3), (0.1, -0.4, 0.4)):
        push = cs.FingerAcceleration(0, 0.0, 0.6, (0.1, 0.0))
        scene = one_contact(profile=c, disturbances=[push])
        with pytest.raises(SceneError, match="contact 0: sigma = 0 at t = .*accelerate while"):
            cs.plan(scene)
        calm = scene.replace(disturbances=[cs.ObjectRateOffset(0, 0.0, 0.6, (0.1, 0.0))])
        assert np.isfinite(cs.plan(calm).twist(np.linspace(0, 1, 11))).all()


# --- restart


@pytest.mark.parametrize("t0", [0.0, 0.1, 0.2, 0.25, 0.35, 0.5, 0.55, 0.7, 0.8, 0.9])
@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "bumps", "rounded cube"])
def test_restart_from_its_own_states_reproduces_the_plan(obj, t0):
    plan = cs.plan(busy(obj))
    again = plan.restart(t0, plan.states(t0)[0])
    t = np.linspace(t0, 1, 17)
    assert again.start == t0 and again.end == again.scene.duration
    for ask in ASK:
        expected = getattr(plan, ask)(t)
        bar = 2e-12 * max(1.0, np.abs(expected).max())
        assert getattr(again, ask)(t) == pytest.approx(expected, abs=bar), ask


def test_restart_of_many_contacts_reproduces_the_plan():
    plan = cs.plan(several())
    again = plan.restart(0.4, plan.states(0.4)[0])
    t = np.linspace(0.4, 1, 17)
    assert again.states(t) == pytest.approx(plan.states(t), abs=1e-11)


def test_restart_takes_up_the_measured_slip():
    plan = cs.plan(one_contact("ellipsoid", object_velocity="rolling", profile=(0.2, 0.1)))
    state = plan.states(0.5)[0]
    state[0, 6:8] += [0.05, -0.04]
    again, t = plan.restart(0.5, state), np.linspace(0.5, 1, 21)
    first = slip_of_states(plan.scene, state[None])[0, 0]
    assert again.slip(0.5)[0, 0] == pytest.approx(first, abs=1e-15)
    sigma = polynomial.polyval(t, (0.2, 0.1))
    law = np.linalg.norm(first) * sigma / sigma[0] * np.exp(-3.0 * (t - 0.5))
    assert np.linalg.norm(again.slip(t)[:, 0], axis=1) == pytest.approx(law, abs=1e-14)
    a1, _ = path_velocities(plan.scene, again.states(t))
    assert np.linalg.norm(a1[:, 0], axis=1) == pytest.approx(sigma, rel=1e-12)


@pytest.mark.parametrize("kind", [cs.ObjectAcceleration, cs.ObjectRateOffset])
@pytest.mark.parametrize("t0", [1.0, 1.4])
@pytest.mark.parametrize("finger", [cs.Ellipsoid(0.06, 0.05, 0.04), cs.Sphere(0.05)])
def test_restart_from_principal_values_beyond_the_seam_is_pushed_the_same_way(finger, kind, t0):
    """An ellipsoid's chart covers it twice, with axes turned by pi: pushes are the plan's."""
    scene = cs.Scene(
        object=cs.Ellipsoid(0.3, 0.2, 0.1), profile=cs.Profile([0.1]), gain=cs.Gain.time(5.0),
        duration=2.0, disturbances=[kind(0, 1.2, 1.8, (0.5, 0.3))],
        contacts=[cs.Contact(finger=finger, object_at=(1.0, 1.2), finger_at=(1.2, 0.5),
                             object_velocity=(0.2, 1.0), finger_velocity=(0.2, -1.0))],
    )  # fmt: skip
    plan = cs.plan(scene)
    own, t = plan.states(t0)[0], np.linspace(t0, 2.0, 9)
    assert own[0, 5] > pi / 2  # the seam is crossed
    measured = cs.measured_states(
        scene, plan.pose(t0)[0], plan.twist(t0)[0], plan.points(t0)[0, :, 1]
    )
    assert measured[0, 5] < pi / 2
    again = plan.restart(t0, measured)
    assert again.states(t) == pytest.approx(plan.restart(t0, own).states(t), abs=1e-12)
    assert again.points(t) == pytest.approx(plan.points(t), abs=1e-13)


def test_restart_takes_a_time_of_any_kind():
    plan = cs.plan(one_contact())
    state = plan.states(0.5)[0]
    for t in (np.array(0.5), np.float32(0.5)):
        assert plan.restart(t, state).start == plan.continued(t).start == 0.5
    for t in ([0.5], True, "0.5", None):
        with pytest.raises(ContactSystemError, match="give a time in seconds|horizon"):
            plan.restart(t, state)


def test_restart_has_no_past():
    plan = cs.plan(one_contact())
    again = plan.restart(0.5, plan.states(0.5)[0])
    with pytest.raises(ContactSystemError, match=r"outside the plan's horizon \[0.5, 1\] s"):
        again.states(0.4)
    for t, remedy in ((0.4, "or the plan that this one goes on from"), (1.5, "or lengthen")):
        with pytest.raises(ContactSystemError, match=f"ask inside it, {remedy}"):
            again.slip(t)
    with pytest.raises(ContactSystemError, match="ask inside it$"):
        again.points(-1.0)
    assert again.sample_times(11)[0] == 0.5


def test_restart_refuses_what_it_cannot_start_from():
    plan = cs.plan(one_contact(profile=(0.1, -0.4, 0.4)))
    state = plan.states(0.4)[0]
    with pytest.raises(SceneError, match=r"state has shape \(9,\); give \(1, 9\)"):
        plan.restart(0.4, state[0])
    with pytest.raises(
        SceneError, match="restart at t = 0.4 s, contact 0: the measured state has nan"
    ):
        plan.restart(0.4, np.where(np.arange(9) == 3, np.nan, state))
    for given in (state + 1e-3j, state.astype(str), state > 0, [[None] * 9]):
        with pytest.raises(SceneError, match="restart"):
            plan.restart(0.4, given)
    with pytest.raises(SceneError, match="sigma = 0 there.*restart where sigma > 0"):
        plan.restart(0.5, state)
    with pytest.raises(ContactSystemError, match="outside the plan's horizon"):
        plan.restart(2.0, state)
    with pytest.raises(SceneError, match="scene 'C2', restart: contact 0 has its rolling imposed"):
        dragged = cs.plan(cs.load_scene("C2"))
        dragged.restart(0.5, dragged.states(0.5)[0])


def test_restart_at_the_very_end_leaves_nothing_to_plan():
    plan = cs.plan(one_contact())
    with pytest.raises(ContactSystemError, match="restart at t = 1 s"):
        plan.restart(1.0, plan.states(1.0)[0])


# --- continued, carried frames


@pytest.mark.parametrize("t0", [0.0, 0.1, 0.2, 0.25, 0.35, 0.5, 0.55, 0.7, 0.8, 0.9])
@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "cylinder", "torus", "bumps", "bowl",
                                 "rounded cube"])  # fmt: skip
def test_plan_continued_under_the_same_scene_is_the_same_plan(obj, t0):
    plan = cs.plan(busy(obj), tolerance=1e-14)
    again = plan.continued(t0)
    t = np.linspace(t0, 1, 17)
    assert again.start == t0
    for ask in (*ASK, "carried"):
        expected = getattr(plan, ask)(t)
        bar = 2e-13 * max(1.0, np.abs(expected).max())
        assert getattr(again, ask)(t) == pytest.approx(expected, abs=bar), ask


def test_continuing_many_contacts_again_and_again_loses_nothing():
    plan = again = cs.plan(several(), tolerance=1e-14)
    for t in np.linspace(0, 1, 51)[:-1]:
        again = again.continued(t)
    for ask in (*ASK, "carried"):
        expected = getattr(plan, ask)(1.0)
        bar = 1e-13 * max(1.0, np.abs(expected).max())
        assert getattr(again, ask)(1.0) == pytest.approx(expected, abs=bar), ask


def test_disturbance_brought_in_by_continuing_is_the_window_of_a_scene():
    free, t = busy().replace(disturbances=()), np.linspace(0.5, 1, 21)
    later = cs.plan(free, tolerance=1e-14).continued(
        0.2, free.replace(disturbances=[w for w in WINDOWS if w.start < 0.4])
    )
    later = later.continued(0.35, busy()).continued(0.5, busy())
    expected = cs.plan(busy(), tolerance=1e-14).states(t)
    assert later.states(t) == pytest.approx(expected, abs=2e-13 * np.abs(expected).max())


def test_plan_is_continued_from_a_pole():
    scene = one_contact(object_at=(pi / 2, 0.0), finger_velocity=(1.0, 0.0), angle=0.0,
                        object_velocity=(1.0, 0.0), profile=(pi / 20,), duration=3.0)  # fmt: skip
    plan = cs.plan(scene)
    again, t = plan.continued(1.0), np.array([1.5, 2.5, 3.0])
    assert np.hypot(*plan.points(1.0)[0, 0, 1, :2]) < 1e-16
    assert again.points(t) == pytest.approx(plan.points(t), abs=1e-16)
    assert again.states(t) == pytest.approx(plan.states(t), abs=2e-15)


def test_plan_is_continued_from_a_rest():
    plan = cs.plan(one_contact(profile=(0.1, -0.4, 0.4)), tolerance=1e-14)
    again, t = plan.continued(0.5), np.linspace(0.5, 1, 9)
    assert again.states(t) == pytest.approx(plan.states(t), abs=1e-14)


def test_continuing_refuses_other_surfaces_the_end_and_imposed_rolling():
    plan = cs.plan(one_contact())
    with pytest.raises(SceneError, match="at t = 0.5 s: the scene has other surfaces"):
        plan.continued(0.5, one_contact("ellipsoid"))
    with pytest.raises(SceneError, match="at t = 1 s: nothing is left to plan"):
        plan.continued(1.0)
    with pytest.raises(ContactSystemError, match="outside the plan's horizon"):
        plan.continued(1.5)
    with pytest.raises(SceneError, match="contact 0: rolling that is imposed has one plan"):
        cs.plan(cs.load_scene("C2")).continued(0.5)
    imposed = plan.scene.contacts[0], {"finger_velocity": "rolling", "object_velocity": (0.2, 1.0)}
    rolling = plan.scene.replace(contacts=[dataclasses.replace(imposed[0], **imposed[1])])
    with pytest.raises(SceneError, match="contact 0: rolling that is imposed has one plan"):
        plan.continued(0.5, rolling)
    with pytest.raises(SceneError, match="contacts = 2, and the plan has 1; give"):
        plan.continued(0.5, plan.scene.replace(contacts=plan.scene.contacts * 2))
    with pytest.raises(SceneError, match="scene = 'K4': give a Scene"):
        plan.continued(0.5, "K4")
    for ask in ("continued", "carried"):
        with pytest.raises(SceneError, match="'chart' carries no frames along"):
            getattr(cs.plan(one_contact(), method="chart"), ask)(0.5)


def test_continued_plan_comes_back_from_an_npz_file(tmp_path):
    again, t = cs.plan(busy()).continued(0.45), np.linspace(0.45, 1, 12)
    again.save(tmp_path / "again.npz")
    assert np.array_equal(cs.load(tmp_path / "again.npz").states(t), again.states(t))


def test_carried_frames_say_the_rates_and_the_angle_of_the_states():
    scene = busy(angle=0.3).replace(disturbances=WINDOWS[:2])
    plan, t = cs.plan(scene), np.linspace(0, 1, 41)
    states, carried = plan.states(t), plan.carried(t)
    sigma = polynomial.polyval(t, (0.2, 0.1))[:, None]
    for k, expected in enumerate(path_velocities(scene, states)):
        theta, x, y = carried[:, :, k].transpose(2, 0, 1)
        found = np.stack([np.cos(theta) * x - np.sin(theta) * y,
                          np.sin(theta) * x + np.cos(theta) * y], axis=-1)  # fmt: skip
        assert sigma[:, :, None] * found == pytest.approx(expected, abs=2e-14)
    assert states[..., 8] == pytest.approx(0.3 - carried[..., 0].sum(axis=-1), abs=1e-14)


def test_carried_velocities_are_the_scenes_while_nothing_acts_also_from_rest():
    free = one_contact("ellipsoid", profile=(0.0, 0.1), object_velocity="rolling")
    carried = cs.plan(free).carried(np.linspace(0, 1, 9))
    assert carried[0, 0, :, 0] == pytest.approx([0.0, 0.0], abs=1e-15)
    assert carried[:, 0, 0, 1:] == pytest.approx(np.full((9, 2), (0.6, 0.8)), abs=1e-15)
    assert np.ptp(carried[:, 0, 1, 1:], axis=0) == pytest.approx(0.0, abs=1e-15)


# --- files


@pytest.mark.parametrize("method", ["auto", "chart"])
def test_plan_comes_back_from_an_npz_file(tmp_path, method):
    plan = cs.plan(busy(), tolerance=1e-9, method=method)
    path = tmp_path / "plan.npz"
    plan.save(path)
    again, t = cs.load(path), np.linspace(0, 1, 23)
    for ask in ASK:
        assert np.array_equal(getattr(again, ask)(t), getattr(plan, ask)(t)), ask
    assert (again.scene, again.tolerance, again.method) == (plan.scene, 1e-9, method)


def test_restarted_plan_comes_back_from_an_npz_file(tmp_path):
    plan = cs.plan(busy())
    state = plan.states(0.45)[0]
    state[0, 6] += 0.1
    again = plan.restart(0.45, state)
    again.save(tmp_path / "again.npz")
    loaded, t = cs.load(tmp_path / "again.npz"), np.linspace(0.45, 1, 12)
    assert loaded.start == 0.45
    assert np.array_equal(loaded.states(t), again.states(t))


def test_npz_file_holds_sampled_results(tmp_path):
    plan = cs.plan(several())
    plan.save(str(tmp_path / "plan.npz"))
    with np.load(tmp_path / "plan.npz") as data:
        t = data["t"]
        assert len(t) == 401 + len(set(plan.scene.edges) - set(np.linspace(0, 1, 401)))
        assert set(plan.scene.edges) <= set(t)
        for ask in ("states", "slip", "twist", "pose", "points"):
            assert np.array_equal(data[ask], getattr(plan, ask)(t)), ask


def test_csv_file_holds_states_and_slip_to_the_last_digit(tmp_path):
    plan, t = cs.plan(several()), [0.0, 0.25, 1.0]
    plan.save(tmp_path / "plan.csv", t)
    with open(tmp_path / "plan.csv", newline="") as file:
        head, *rows = csv.reader(file)
    table = np.array(rows, dtype=float).reshape(3, 7, 14)
    assert head[:4] == ["t [s]", "contact", "u1", "v1"] and len(head) == 14
    assert np.array_equal(table[:, :, 0], np.repeat(np.array(t)[:, None], 7, axis=1))
    assert np.array_equal(table[0, :, 1], np.arange(7))
    assert np.array_equal(table[:, :, 2:11], plan.states(t))
    assert np.array_equal(table[:, :, 11:13], plan.slip(t))
    assert table[:, :, 13] == pytest.approx(np.linalg.norm(plan.slip(t), axis=-1), rel=1e-15)


def test_files_of_other_kinds_are_refused(tmp_path):
    plan = cs.plan(one_contact())
    with pytest.raises(ContactSystemError, match="unknown ending '.mat'; use .npz or .csv"):
        plan.save(tmp_path / "plan.mat")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(ContactSystemError, match="not a plan written by Plan.save"):
        cs.load(tmp_path / "other.npz")
    for content in (b"junk", b"", b"PK\3\4 cut short"):
        (tmp_path / "junk.npz").write_bytes(content)
        with pytest.raises(ContactSystemError, match="junk.npz: not a plan written by Plan.save"):
            cs.load(tmp_path / "junk.npz")
    plan.save(tmp_path / "plan.npz")
    with np.load(tmp_path / "plan.npz") as data:
        kept = dict(data)
    for header in ("{}", "[]", '{"tolerance": 1e-9, "method": "auto", "solver": "", "start": "x"}'):
        np.savez(tmp_path / "junk.npz", **{**kept, "plan": header})
        with pytest.raises(ContactSystemError, match="junk.npz: not a plan written by Plan.save"):
            cs.load(tmp_path / "junk.npz")
    with pytest.raises(ContactSystemError, match="cannot be read: .*No such file"):
        cs.load(tmp_path / "none.npz")


@pytest.mark.parametrize("name", ["x.npz", "x.csv", "x.toml"])
def test_files_in_a_folder_that_is_missing_are_refused_by_name(name, tmp_path):
    plan = cs.plan(cs.load_scene("C2"))
    path = tmp_path / "missing" / name
    save = plan.save if name != "x.toml" else functools.partial(cs.save_scene, plan.scene)
    with pytest.raises(ContactSystemError, match=f"'C2'.*{name}' cannot be written: .* a path in"):
        save(path)


@pytest.mark.parametrize("path", [None, 3, "a\0.npz", cs.load_scene("C2")])
def test_what_is_no_path_is_refused(path):
    plan = cs.plan(cs.load_scene("C2"))
    for write in (plan.save, functools.partial(cs.save_scene, plan.scene)):
        with pytest.raises(ContactSystemError, match="path = .*: give a path"):
            write(path)
    with pytest.raises(ContactSystemError, match="scene = 'C2.toml': give a Scene"):
        cs.save_scene("C2.toml", path)


def test_a_damaged_file_is_read_or_refused(tmp_path):
    cs.plan(one_contact()).save(tmp_path / "plan.npz", [0.0])
    content, rng = (tmp_path / "plan.npz").read_bytes(), np.random.default_rng(1)
    for _ in range(200):
        damaged = bytearray(content)
        damaged[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        (tmp_path / "plan.npz").write_bytes(damaged)
        with contextlib.suppress(ContactSystemError):
            cs.load(tmp_path / "plan.npz")


@pytest.mark.parametrize("method", ["auto", "chart"])
@pytest.mark.parametrize("copied", [lambda plan: pickle.loads(pickle.dumps(plan)), copy.deepcopy])
def test_plans_are_pickled_and_copied(copied, method):
    plan, t = cs.plan(busy(), tolerance=1e-9, method=method), np.linspace(0.45, 1, 12)
    plans = [plan, plan.restart(0.45, plan.states(0.45)[0])]
    for one in plans + ([plan.continued(0.45)] if method == "auto" else []):
        again = copied(one)
        for ask in ASK:
            assert np.array_equal(getattr(again, ask)(t), getattr(one, ask)(t)), ask
        assert (again.scene, again.start, again.tolerance) == (one.scene, one.start, 1e-9)


# --- bundled scenes


@pytest.mark.parametrize("name", cs.bundled_scenes())
def test_every_bundled_scene_can_be_planned_and_asked(name):
    plan = cs.plan(cs.load_scene(name))
    t = plan.sample_times(31)
    for ask in ASK:
        assert np.isfinite(getattr(plan, ask)(t)).all(), ask
    assert plan.slip(t) == pytest.approx(slip_of_states(plan.scene, plan.states(t)), abs=1e-12)


@pytest.mark.parametrize("edge", [0.0675, 0.14, 0.7, 0.7 + 1e-15])
def test_an_edge_on_a_sample_time_is_sampled_once(edge):
    # The grid comes within rounding of it; differences over such a pair would mean nothing.
    window = cs.FingerAcceleration(contact=0, start=edge, stop=0.8, value=(0.5, 0.5))
    times = cs.plan(one_contact(disturbances=(window,))).sample_times()
    assert len(times) == 401 and np.diff(times).min() > 0.0024
    assert {0.0, edge, 0.8, 1.0} <= set(times)


@pytest.mark.parametrize("count", [0, -1, 2.5, "9", True])
def test_a_count_of_times_is_a_whole_number(count):
    with pytest.raises(ContactSystemError, match=f"count = {count!r}: give a whole number"):
        cs.plan(one_contact()).sample_times(count)


def test_object_at_rest_starts_with_the_whole_path_velocity_as_slip():
    scene = cs.load_scene("K1")
    first = cs.plan(scene).slip(0.0)[0]
    assert first == pytest.approx(
        np.broadcast_to(1e-3 * reflection(0.0) @ [2**-0.5, 2**-0.5], (3, 2)), abs=1e-18
    )


def test_fingers_of_every_surface_roll_alike_on_the_object():
    # Whatever the finger, the object's curve develops from the same straight line.
    contacts = [
        cs.Contact(finger=f, object_at=(0.7, 0.4), finger_at=at) for f, at in SURFACES.values()
    ]
    scene = cs.Scene(
        object=cs.Ellipsoid(0.3, 0.2, 0.1), contacts=contacts, profile=cs.Profile([0.3]), duration=1
    )
    x = cs.plan(scene).points([0.0, 1.0])[:, :, 1]
    assert x == pytest.approx(np.broadcast_to(x[:, :1], x.shape), abs=1e-14)
