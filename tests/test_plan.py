"""The interface of plans: times, arguments, several contacts, and what `explain` says."""

from __future__ import annotations

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from conftest import RESULTS, disturbed, one_contact, seven_contacts

import contact_system as cs
from contact_system import plots

SHAPES = {"states": (9,), "points": (2, 3), "slip": (2,), "acceleration": (2,), "pose": (4, 4)}
SHAPES |= {"twist": (6,), "slip_speed": (), "carried": (2, 3)}


# --- results at times


def test_results_have_times_along_their_first_axis_and_contacts_along_their_second():
    plan = cs.plan(seven_contacts())
    for result, shape in SHAPES.items():
        for t, count in ((np.linspace(0, 1, 5), 5), (0.5, 1), ([], 0)):
            assert getattr(plan, result)(t).shape == (count, 7, *shape), result


@pytest.mark.parametrize("scene", [disturbed, seven_contacts], ids=["windows", "contacts"])
def test_times_may_be_in_any_order(scene):
    plan = cs.plan(scene())
    t = np.random.default_rng(0).permutation(np.append(np.linspace(0, 1, 57), [0.5, 0.5, 0.2]))
    for result in RESULTS:
        one_by_one = np.concatenate([getattr(plan, result)(x) for x in t])
        bar = 1e-14 * np.abs(one_by_one).max()
        assert getattr(plan, result)(t) == pytest.approx(one_by_one, abs=bar), result


@pytest.mark.parametrize("t", [-1e-9, 1.0000001, [0.5, 2.0], np.nan, np.inf])
def test_time_outside_the_horizon_is_named_with_the_horizon(t):
    words = rf"'sphere on sphere': t = \S*{np.ravel(t)[-1]:.3g}.*the plan's horizon \[0, 1\] s"
    for plan in (cs.plan(one_contact()), cs.plan(one_contact(), method="chart")):
        for result in SHAPES.keys() - {"carried"}:  # the chart method has no carried frames
            with pytest.raises(cs.ContactSystemError, match=words):
                getattr(plan, result)(t)
        assert (plan.points(1.0 + 1e-15) == plan.points(1.0)).all()
    with pytest.raises(cs.ContactSystemError, match=words):
        cs.plan(one_contact()).moments(t)


@pytest.mark.parametrize(
    "t", ["0.5", [True], 0.5 + 0j, [[0.1], [0.2, 0.3]], [0.1, None], np.ma.array([0], mask=1)]
)
def test_times_that_are_not_numbers_are_refused(t):
    plan = cs.plan(one_contact())
    for result in SHAPES:
        with pytest.raises(cs.ContactSystemError, match="give a time in seconds, or one axis"):
            getattr(plan, result)(t)


def test_times_may_be_any_real_numbers_in_any_array(tmp_path):
    plan = cs.plan(one_contact(duration=2.0))
    expected = plan.states([1.0, 2.0])
    fixed, mapped = np.array([1.0, 2.0]), np.memmap(tmp_path / "times", float, "w+", shape=(2,))
    fixed.setflags(write=False)
    mapped[:] = fixed
    numbers = [1, 2], np.array([1, 2], np.uint8), np.float32([1, 2]), [Fraction(1), Fraction(2)]
    for t in (*numbers, fixed, mapped, np.array([1.0, 0.0, 2.0])[::2], fixed.astype(">f8")):
        assert np.array_equal(plan.states(t), expected)
    with pytest.raises(cs.ContactSystemError, match=r"times have shape \(1, 2\); give one axis"):
        plan.points([[0.1, 0.2]])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        *(
            ({"tolerance": x}, "tolerance = .*: give a (finite number|number from 1e-15 to 1e-1)")
            for x in (0.0, -1e-9, 1e-16, 0.2, np.nan, np.inf, 10**400, "1e-6", True, None, 1j)
        ),
        ({"method": "euler"}, "method = 'euler' is unknown; use one of auto, chart"),
        ({"scene": "K4"}, "scene = 'K4': give a Scene, such as load_scene"),
    ],
)
def test_wrong_arguments_of_plan_are_refused(given, words):
    with pytest.raises(cs.SceneError, match=words):
        cs.plan(**{"scene": one_contact(), **given})


def test_a_scene_given_instead_of_its_plan_is_refused(tmp_path):
    scene, file = cs.load_scene("K1"), tmp_path / "x.png"
    calls = [(measure, scene) for measure in (cs.rejections, cs.summary)]
    calls += [(draw, scene, file) for draw in (plots.plot, plots.plot_slip, plots.plot_curves)]
    calls += [(draw, cs.plan(scene), file, scene) for draw in (plots.plot, plots.plot_slip)]
    for ask, *given in calls:
        with pytest.raises(cs.ContactSystemError, match="plan = Scene.*: give a Plan, such as"):
            ask(*given)


@pytest.mark.parametrize("edge", [0.0675, 0.14, 0.7, 0.7 + 1e-15])
def test_an_edge_on_a_sample_time_is_sampled_once(edge):
    # The grid of samples has a time within rounding of the edge. Both would be a pair of which no
    # finite difference can be formed.
    window = cs.FingerAcceleration(contact=0, start=edge, stop=0.8, value=(0.5, 0.5))
    times = cs.plan(one_contact(disturbances=(window,))).sample_times()
    assert len(times) == 401 and np.diff(times).min() > 0.0024
    assert {0.0, edge, 0.8, 1.0} <= set(times)


def test_contacts_together_move_as_each_alone():
    scene, t = seven_contacts(), np.linspace(0, 1, 41)
    together = cs.plan(scene)
    for i, contact in enumerate(scene.contacts):
        windows = [dataclasses.replace(d, contact=0) for d in scene.disturbances if d.contact == i]
        alone = cs.plan(scene.replace(contacts=[contact], disturbances=windows))
        for result in RESULTS:
            expected = getattr(alone, result)(t)[:, 0]
            bar = 1e-13 * max(1.0, np.abs(expected).max())
            assert getattr(together, result)(t)[:, i] == pytest.approx(expected, abs=bar), (
                result,
                i,
            )


def test_a_contact_is_not_integrated_only_because_another_is_disturbed():
    others = cs.plan(cs.load_scene("D1")).explain().split("contact 2 (finger 3):")[1]
    assert "great circle" in others and "skipped: all integration" in others
    assert "panels" not in others


# --- explain


CIRCLE, ARC = "closed form: great circle", "geodesic in arc length"
LINE = "closed form: straight line on the developed surface"
METHODS = {  # of a path without slip, and of one with slip
    "sphere": (CIRCLE, "development in space"),
    "bowl": (CIRCLE, "development in space"),
    "plane": (LINE, "quadrature of slip"),
    "cylinder": (LINE, "quadrature of slip"),
    "ellipsoid": (ARC, "development in space"),
    "rounded cube": (ARC, "development in space"),
    "bumps": (ARC, "development in its chart"),
}


@pytest.mark.parametrize("surface", METHODS)
def test_explain_tells_the_method_for_each_body_the_cheapest_that_is_exact(surface):
    alone, slipping = METHODS[surface]
    lines = cs.plan(one_contact(finger=surface)).explain().splitlines()
    assert [alone in line for line in lines if line.startswith("  finger")] == [True]
    assert slipping in cs.plan(one_contact(surface)).explain()
    text = cs.plan(one_contact(surface, object_velocity="rolling")).explain()
    assert alone in text and "no slip" in text and slipping not in text
    soon = cs.plan(one_contact(surface, gain=cs.Gain.time(100.0))).explain()
    settles = surface not in ("plane", "cylinder")  # these need no integration while it slips
    assert ("slip is below tolerance" in soon) == settles and "below tolerance" not in text


def test_explain_names_scene_tolerance_intervals_and_causes():
    text = cs.plan(disturbed(), tolerance=1e-10).explain()
    words = ["'sphere on ellipsoid'", "tolerance 1e-10", "method auto", "contact 0:"]
    words += ["[0.2, 0.3] s  forced development", "finger acceleration and object acceleration"]
    assert [w for w in (*words, "object rate offset", "object [0.8, 1] s") if w not in text] == []
    text = cs.plan(cs.load_scene("C2").replace(object=cs.Torus(0.3, 0.1)), compiled=True).explain()
    assert all(f"rolling is imposed; {why}" in text for why in ("integrated", "no closed form"))


def test_explain_tells_of_rate_offsets_of_rests_and_of_many_windows_in_one_line():
    offset = cs.ObjectRateOffset(0, 0.2, 0.4, (0.1, 0.3))
    scene = one_contact("cylinder", object_velocity="rolling", disturbances=[offset])
    assert "(object rate offset)" in cs.plan(scene).explain()
    scene = one_contact("ellipsoid", legs=[cs.Leg(0.3, 0.05, 0.5)])
    assert "(the contact rests)" in cs.plan(scene).explain()
    many = [cs.FingerAcceleration(0, k / 100, (k + 1) / 100, (0.1, 0.0)) for k in range(100)]
    text = cs.plan(one_contact(disturbances=many)).explain()
    assert "finger [0, 1] s  forced development, 100 panels  (finger acceleration)" in text
    pytest.raises(cs.SceneError, scene.contraction).match("all have legs")


def test_all_contacts_share_the_limit_of_panels_and_the_one_that_takes_most_is_named(monkeypatch):
    scene = cs.load_scene("K4")
    short, long = (
        dataclasses.replace(scene.contacts[0], finger_velocity=(speed, 0.0)) for speed in (1, 20)
    )
    scene = scene.replace(contacts=[short, long, short], disturbances=())
    monkeypatch.setattr(cs.limits, "PANELS", 1e4)
    found = cs.plan(scene)
    monkeypatch.setattr(cs.limits, "PANELS", 400)
    with pytest.raises(cs.ContactSystemError, match="most 400, .* for contact 1 .*; .*PANELS high"):
        cs.plan(scene)
    assert np.isfinite(found.points(1.0)).all()
