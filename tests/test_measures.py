"""What is measured of plans: slip beside its law, times of rejection, great circles."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from conftest import disturbed, one_contact

import contact_system as cs
from contact_system import ContactSystemError, measures

RESTING = {"profile": (0.2, -0.8, 0.8), "gain": cs.Gain.guaranteed(5.0)}  # at 0.5 s
SCENES = [*map(cs.load_scene, ("K1", "K4", "chart", "torus")), disturbed(), one_contact(**RESTING)]


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
def test_the_exact_law_drawn_in_pictures_is_the_plans_slip_between_disturbances(scene):
    plan = cs.plan(scene)
    t, slip = measures.exact_slip(plan, 0)
    assert len(t) > 5
    windows = [(d.start, d.stop) for d in scene.disturbances if d.contact == 0]
    assert not any(((t > a) & (t < b)).any() for a, b in windows)
    # at the start of a window the law gives the slip just before it
    before = np.where(np.isin(t, [start for start, _ in windows]), np.nextafter(t, 0), t)
    assert plan.slip_speed(before)[:, 0] == pytest.approx(slip, abs=1e-12 * slip.max())
    if scene.name == "K1":  # |V| = 1, and L = 100 int (0.001 + 0.4 t^2)^2 written out
        lost = 100 * (1e-6 * t + 8e-4 * t**3 / 3 + 0.16 * t**5 / 5)
        assert slip == pytest.approx((0.001 + 0.4 * t**2) * np.exp(-lost), rel=1e-12)


def test_recovery_is_the_last_time_that_slip_falls_below_a_twentieth():
    # slip sigma exp(-L): 0.01 (1 + 20 t) exp(-12 t) grows at first
    scene = cs.load_scene("K1").replace(profile=cs.Profile([0.01, 0.2]), gain=cs.Gain.time(12))
    (r, *_) = cs.rejections(cs.plan(scene))
    truth = mpmath.findroot(lambda t: (1 + 20 * t) * mpmath.exp(-12 * t) - mpmath.mpf("0.05"), 0.5)
    assert r.time == pytest.approx(float(truth), rel=1e-12)
    assert (r.start, r.since) == (pytest.approx(0.01, rel=1e-12), 0.0)
    assert r.peak_time == pytest.approx(1 / 12 - 1 / 20, rel=1e-6)
    assert r.peak == pytest.approx(0.01 * (20 / 12) * math.exp(-0.4), rel=1e-9)


def test_recovery_counts_from_the_end_of_the_last_disturbance():
    lost = lambda t: mpmath.quad(lambda x: (0.1 + 0.2 * x - 0.02 * x**2) ** 2, [2, t])  # noqa: E731
    sigma = lambda t: 0.1 + 0.2 * t - 0.02 * t**2  # noqa: E731
    truth = mpmath.findroot(
        lambda t: sigma(t) / sigma(2) * mpmath.exp(-100 * lost(t)) - mpmath.mpf("0.05"), 2.16
    )
    for r in cs.rejections(cs.plan(cs.load_scene("K4"))):
        assert r.since == 2
        assert r.time == pytest.approx(float(truth) - 2, rel=1e-9)


def test_recovery_from_a_rate_offset_takes_no_time_as_its_slip_ends_with_it():
    first, second, _ = cs.rejections(cs.plan(cs.load_scene("D1")))
    assert (first.since, first.time) == (2.5, 0.0) and first.peak > 0.1
    assert math.isnan(second.time) and second.peak == 0


def test_distance_from_a_great_circle_is_zero_on_it_and_that_of_a_circle_of_latitude():
    angle = np.linspace(0, 2 * math.pi, 60, endpoint=False)
    tilt = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    great = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1) @ tilt
    assert np.abs(cs.great_circle_distance(great)).max() < 1e-15
    assert [len(cs.great_circle_distance(great[:n])) for n in range(3)] == [0, 1, 2]
    assert np.abs(cs.great_circle_distance(great[:2])).max() < 1e-15
    # a circle of latitude 0.1 rad: every point is sin(0.1) from the plane through the centre
    small = np.cos(0.1) * great + np.sin(0.1) * tilt[2]
    assert np.abs(cs.great_circle_distance(small)) == pytest.approx(np.sin(0.1), rel=1e-12)


@pytest.mark.parametrize("points", [[], np.zeros((5, 1, 2, 3)), [[0, 0, math.nan]], "plan", None])
def test_great_circle_distance_refuses_what_is_not_points_of_one_curve(points):
    with pytest.raises(ContactSystemError, match=r"shape .*\(n, 3\), such as plan.points"):
        cs.great_circle_distance(points)
