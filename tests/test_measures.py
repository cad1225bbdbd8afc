"""What a plan achieved, measured: slip beside its law, its rejection, great circles."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import one_contact, refuse_at

import contact_system as cs
from contact_system import ContactSystemError, measures


@pytest.mark.parametrize("name", ["K1", "K4", "chart", "torus"])
def test_exact_slip_follows_the_polynomial_law_and_the_plan(name):
    scene = cs.load_scene(name)
    plan = cs.plan(scene)
    t, slip = measures.exact_slip(plan, 0)
    assert len(t) > 10
    assert not any(((t > a) & (t < b)).any() for a, b in measures.windows(plan, 0))
    # where a window starts the law tells the slip just before
    before = [start for start, _ in measures.windows(plan, 0)]
    planned = plan.slip(np.where(np.isin(t, before), np.nextafter(t, 0), t))[:, 0]
    assert np.abs(np.linalg.norm(planned, axis=1) - slip).max() < 1e-12 * slip.max()
    if name == "K1":  # |V| = 1, and L = 100 int (0.001 + 0.4 t^2)^2 written out
        lost = 100 * (1e-6 * t + 8e-4 * t**3 / 3 + 0.16 * t**5 / 5)
        assert slip == pytest.approx((0.001 + 0.4 * t**2) * np.exp(-lost), rel=1e-12)


@pytest.mark.parametrize("sigma", [(0.0, 0.3), (0.2, -0.8, 0.8)])  # zero at 0 s, at 0.5 s
@pytest.mark.parametrize("restarted", [False, True])
def test_exact_slip_under_the_guaranteed_gain_goes_on_after_a_rest(sigma, restarted):
    push = cs.ObjectAcceleration(contact=0, start=0.6, stop=0.7, value=(3.0, 2.0))
    scene = one_contact("sphere", profile=sigma, gain=cs.Gain.guaranteed(5.0), disturbances=[push])
    plan = cs.plan(scene)
    if restarted:
        plan = plan.restart(0.8, plan.states(0.8)[0])
    t, slip = measures.exact_slip(plan, 0)
    later = t > 0.75
    assert later.sum() > 5
    expected = plan.slip_speed(0.8)[0, 0] * np.exp(-5 * (t[later] - 0.8))  # sigma only grows there
    assert slip[later] == pytest.approx(expected, rel=1e-12)


def test_overlapping_windows_are_joined():
    pushes = [
        cs.FingerAcceleration(contact=0, start=a, stop=b, value=(0.1, 0))
        for a, b in ((0.6, 0.7), (0.1, 0.3), (0.2, 0.4), (0.4, 0.5))
    ]
    plan = cs.plan(one_contact("plane", disturbances=pushes))
    assert measures.windows(plan, 0) == [(0.1, 0.5), (0.6, 0.7)]


@pytest.mark.parametrize("name", ["K4", "D1", "bowl"])
def test_slip_speed_is_the_length_of_slip(name):
    plan = cs.plan(cs.load_scene(name))
    t = plan.sample_times(101)
    slip = np.linalg.norm(plan.slip(t), axis=2)
    assert plan.slip_speed(t) == pytest.approx(slip, rel=1e-14, abs=0)


def test_only_times_at_a_pole_are_not_regular(monkeypatch):
    # North along a meridian at 0.1 m/s on a radius of 0.1 m: u = 0.7 - t, but for rounding, by
    # which numpy 1.26 meets the pole at 0.7 s and others do not.
    scene = one_contact(
        "sphere",
        "plane",
        angle=0.0,
        object_at=(0.7, 0.0),
        profile=(0.1,),
        finger_velocity=(-1.0, 0.0),
        object_velocity="rolling",
    )
    plan = cs.plan(scene)
    t = np.array([0.1, *(0.7 + np.arange(-40, 41) * np.spacing(0.7)), 0.9])
    regular = measures.regular_times(plan, t)
    assert np.abs(np.setdiff1d(t, regular) - 0.7).max(initial=0.0) < 1e-15
    refuse_at(monkeypatch, t[40:43].tolist(), "states")
    assert np.array_equal(measures.regular_times(plan, t), np.setdiff1d(regular, t[40:43]))
    assert plan.slip_speed(t) == pytest.approx(0, abs=0)


def test_k1_recovers_within_the_reported_time_under_the_time_law():
    mpmath = pytest.importorskip("mpmath")
    scene = cs.load_scene("K1")
    crossing = mpmath.findroot(
        lambda t: (1 + 400 * t**2) * mpmath.exp(-100 * t) - mpmath.mpf("0.05"),
        (0.02, 0.05),
        solver="anderson",
    )
    for r in cs.rejections(cs.plan(scene.replace(gain=cs.Gain.time(100)))):
        assert r.time == pytest.approx(float(crossing), rel=1e-12)
        assert r.time < 0.04 and r.as_reported
        assert (r.start, r.peak, r.peak_time) == (pytest.approx(1e-3), pytest.approx(1e-3), 0)
    for r in cs.rejections(cs.plan(scene)):
        assert math.isinf(r.time) and r.as_reported is False


def test_the_last_crossing_counts_where_slip_grows_before_it_falls():
    # slip sigma exp(-L): 0.01 (1 + 20 t) exp(-12 t) grows at first
    mpmath = pytest.importorskip("mpmath")
    scene = cs.load_scene("K1").replace(profile=cs.Profile([0.01, 0.2]), gain=cs.Gain.time(12))
    (r, *_) = cs.rejections(cs.plan(scene))
    truth = mpmath.findroot(lambda t: (1 + 20 * t) * mpmath.exp(-12 * t) - mpmath.mpf("0.05"), 0.5)
    assert r.time == pytest.approx(float(truth), rel=1e-12)
    assert r.peak_time == pytest.approx(1 / 12 - 1 / 20, rel=1e-6)
    assert r.peak == pytest.approx(0.01 * (20 / 12) * math.exp(-0.4), rel=1e-9)


def test_recovery_counts_from_the_end_of_the_last_disturbance():
    mpmath = pytest.importorskip("mpmath")
    lost = lambda t: mpmath.quad(lambda x: (0.1 + 0.2 * x - 0.02 * x**2) ** 2, [2, t])  # noqa: E731
    sigma = lambda t: 0.1 + 0.2 * t - 0.02 * t**2  # noqa: E731
    truth = mpmath.findroot(
        lambda t: sigma(t) / sigma(2) * mpmath.exp(-100 * lost(t)) - mpmath.mpf("0.05"), 2.16
    )
    for r in cs.rejections(cs.plan(cs.load_scene("K4"))):
        assert r.since == 2
        assert r.time == pytest.approx(float(truth) - 2, rel=1e-9)


def test_an_offset_that_ends_leaves_nothing_to_recover_from():
    first, second, _ = cs.rejections(cs.plan(cs.load_scene("D1")))
    assert (first.since, first.time) == (2.5, 0.0) and first.peak > 0.1
    assert math.isnan(second.time) and second.peak == 0


def test_distance_from_a_great_circle_is_zero_on_one_and_known_beside_one():
    angle = np.linspace(0, 2 * math.pi, 60, endpoint=False)
    tilt = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    great = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1) @ tilt
    assert np.abs(cs.great_circle_distance(great)).max() < 1e-15
    assert [len(cs.great_circle_distance(great[:n])) for n in range(3)] == [0, 1, 2]
    assert np.abs(cs.great_circle_distance(great[:2])).max() < 1e-15
    # a circle of latitude 0.1 rad: every point is sin(0.1) from the plane through the centre
    small = np.cos(0.1) * great + np.sin(0.1) * tilt[2]
    assert np.abs(cs.great_circle_distance(small)) == pytest.approx(np.sin(0.1), rel=1e-12)


@pytest.mark.parametrize("measure", [cs.rejections, cs.summary])
def test_a_scene_in_the_place_of_its_plan_is_refused(measure):
    with pytest.raises(ContactSystemError, match="plan = Scene.*: give a Plan, such as plan"):
        measure(cs.load_scene("K1"))


@pytest.mark.parametrize("points", [[], np.zeros((5, 1, 2, 3)), [[0, 0, math.nan]], "plan", None])
def test_a_great_circle_asks_for_points_of_one_curve(points):
    with pytest.raises(ContactSystemError, match=r"shape .*\(n, 3\), such as plan.points"):
        cs.great_circle_distance(points)
