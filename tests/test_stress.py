"""Random search for scenes that fail, by the benchmark's own maker of cases and its laws.

`benchmarks.stress_scenes` draws scenes, `stress_laws` judges plans by exact laws; here hypothesis
makes the choices, so that a failure is shrunk. Failures that the search has found stand below, each
with its own truth.
"""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("hypothesis")
from hypothesis import HealthCheck, given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

import contact_system as cs  # noqa: E402
from benchmarks import stress_cases, stress_laws, stress_scenes, verdicts  # noqa: E402


class Choices:
    """Hypothesis as the source of choices of `stress_scenes.draw_trial`."""

    def __init__(self, data: st.DataObject):
        self.data = data

    def pick(self, values):
        return self.data.draw(st.sampled_from(list(values)))

    def real(self, low, high):
        # Horizons and windows next to nothing have a test of their own below.
        return round(self.data.draw(st.floats(low, high)), 9)


def search(examples: int):
    """Settings of a search that is the same in every run."""
    slow = [HealthCheck.too_slow, HealthCheck.data_too_large]
    same = {"derandomize": True, "deadline": None, "database": None}
    return settings(max_examples=examples, suppress_health_check=slow, **same)


DISTURBED = {"object": "sphere", "finger": "ellipsoid", "shape": "plain", "turns": 1.0}


def verdict_of(data: st.DataObject, **fixed) -> verdicts.Verdict:
    def call() -> verdicts.Verdict:
        return stress_laws.run(stress_scenes.draw_trial(Choices(data), **fixed))

    return verdicts.judged(verdicts.Case("drawn", call))


@search(40)
@given(st.data())
def test_any_scene_ends_right_or_refused(data):
    verdict = verdict_of(data)
    assert verdict.outcome in ("right", "refused"), verdict


@search(20)
@given(st.data())
def test_any_disturbed_scene_ends_right_or_refused(data):
    verdict = verdict_of(data, windows=2, **DISTURBED)
    assert verdict.outcome in ("right", "refused"), verdict


@search(25)
@given(st.data(), st.sampled_from(stress_cases._poles()))
def test_any_path_through_or_past_a_pole_ends_right_or_refused(data, aim):
    verdict = verdict_of(data, **aim)
    assert verdict.outcome in ("right", "refused"), verdict


@pytest.mark.parametrize("family", stress_cases.FAMILIES, ids=lambda family: family.name)
def test_every_family_makes_cases_that_end_right_or_refused(family):
    few = {"wrong input": 60, "revolutions, integrated": 3}.get(family.name, 6)
    for index in np.linspace(0, family.count - 1, few).astype(int):
        verdict = verdicts.judged(family.make(int(index)))
        assert verdict.outcome in ("right", "refused"), (int(index), verdict)


# --- the judge itself --------------------------------------------------------------------------


def trial() -> stress_scenes.Trial:
    bodies = {"object": "ellipsoid", "finger": "torus", "shape": "plain", "inside": False}
    motion = {"law": "time", "eta": 2.0, "profile": "rising", "turns": 3.0, "duration": 1.0}
    given = bodies | motion | {"slip": 1, "windows": 0, "ratio": 0.4, "size": 0.1}
    return stress_scenes.draw_trial(stress_scenes.Draw(5), tolerance=1e-12, **given)


WRONG = {
    "points off the surface by 1e-9": ("points", lambda x: x * (1 + 1e-9)),
    "psi off by 1e-7": ("states", lambda x: x + 1e-7 * np.eye(9)[8]),
    "object's rate off by 1e-7": ("states", lambda x: x * (1 + 1e-7 * np.eye(9)[6])),
    "slip off by 1e-9": ("slip", lambda x: x * (1 + 1e-9)),
    "spin of 1e-6": ("twist", lambda x: x + 1e-6 * np.eye(6)[2]),
    "finger displaced by 1e-9 m": ("pose", lambda x: x + 1e-9 * np.outer(*np.eye(4)[[0, 3]])),
    "a NaN": ("states", lambda x: np.where(np.arange(9) == 3, math.nan, x)),
}


def test_judge_finds_a_plan_right():
    verdict = stress_laws.run(trial())
    assert verdict.outcome == "right", verdict


@pytest.mark.parametrize("what", WRONG)
def test_judge_notices(what):
    output, change = WRONG[what]
    drawn = trial()
    plan = cs.plan(drawn.scene)
    own = getattr(plan, output)
    setattr(plan, output, lambda t: change(own(t)))
    assert stress_laws.Judge(drawn, plan).verdict().outcome == "silent"


def test_judge_notices_a_path_that_leaves_its_geodesic():
    # A plan of another start, told as if it were this one: every law holds but that of the start.
    drawn = trial()
    (contact,) = drawn.scene.contacts
    turned = dataclasses.replace(contact, finger_velocity=contact.finger_velocity[::-1])
    plan = cs.plan(drawn.scene.replace(contacts=[turned]))
    assert stress_laws.Judge(drawn, plan).verdict().outcome == "silent"


def test_a_refusal_must_name_place_value_and_remedy():
    text = "scene 'x', contact 0: angle = nan: give a finite number"
    assert verdicts.refusal(text).outcome == "refused"
    for part in ("array must not contain infs", "scene 'x': no", "failed, use another"):
        assert verdicts.refusal(part).outcome == "crash"


# --- what the search has found -----------------------------------------------------------------


AHEAD = {"object_at": (0.0, 0.0), "finger_velocity": (1.0, 0.0)}


def planned(**changes) -> cs.Plan:
    contact = {"finger": cs.Sphere(0.04), "object_at": (1.0, 0.5)} | changes.pop("contact", {})
    tolerance = changes.pop("tolerance", 1e-12)
    scene = {"object": cs.Sphere(0.1), "profile": cs.Profile([0.1]), "duration": 1.0} | changes
    return cs.plan(cs.Scene(contacts=[cs.Contact(**contact)], **scene), tolerance)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
def test_slip_on_a_cylinder_keeps_the_tolerance_on_long_paths(tolerance):
    # y = W s - V g unrolled, g = sigma (1 - exp(-eta t)) / eta
    sigma, rate, t = 785.0, 1e4, np.array([1e-5, 3e-5, 1e-4, 3e-4, 1e-3])
    plan = planned(
        contact={**AHEAD, "finger": cs.Sphere(0.3), "object_velocity": (0.3, 0.9)},
        object=cs.Cylinder(0.1),
        duration=30.0,
        profile=cs.Profile([sigma]),
        gain=cs.Gain.time(rate),
        tolerance=tolerance,
    )
    g = -sigma * np.expm1(-rate * t) / rate
    u = plan.states(t)[:, 0, 4]
    assert u == pytest.approx((sigma * t - 0.7 * g) / 0.1, abs=tolerance)


def test_an_object_that_rolls_on_a_plane_comes_to_the_end_under_every_gain():
    # The guaranteed law has two pieces here, and nothing to do.
    finger = {"finger": cs.Ellipsoid(0.3, 0.2, 0.1), "finger_at": (1.0, 0.5)}
    plan = planned(
        contact={**AHEAD, **finger, "finger_velocity": (0.6, 0.8)},
        object=cs.Plane(),
        profile=cs.Profile([0.1, 1.0, -1.0]),
        gain=cs.Gain.guaranteed(2.0),
    )
    t = np.linspace(0.0, 1.0, 6)
    path = 0.1 * t + t**2 / 2 - t**3 / 3
    expected = np.outer(path, [0.6, -0.8, 0.0])
    assert plan.points(t)[:, 0, 1] == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("surface", [cs.Plane(), cs.Cylinder(0.1)])
def test_slip_whose_path_is_below_the_tolerance_still_has_its_rate(surface):
    contact = {**AHEAD, "object_velocity": (0.3, 0.9)}
    plan = planned(contact=contact, object=surface, gain=cs.Gain.time(1e12), tolerance=1e-6)
    t = np.array([0.0, 1e-12])
    rates = plan.states(t)[:, 0, 6:8] * np.diag(surface.metric_root(0.0, 0.0))
    slip = np.outer(np.exp(-1e12 * t), [0.7, -0.9])
    assert rates == pytest.approx(0.1 * ([1.0, 0.0] - slip), abs=1e-12)


@pytest.mark.parametrize("u", [1e9, 1e17, 5.038120424778432e39])
def test_a_coordinate_of_many_turns_is_the_same_point_or_refused(u):
    try:
        plan = planned(contact={"object_at": (0.5, u)})
    except cs.ContactSystemError:
        return
    r, polar = 0.1 * math.sin(0.5), 0.1 * math.cos(0.5)
    place = [r * math.cos(u), r * math.sin(u), polar]
    assert plan.points([0.0])[0, 0, 1] == pytest.approx(place, abs=1e-9)


@pytest.mark.parametrize("start", [5e-324, 1e-240])
def test_an_interval_too_short_for_any_path_is_planned_or_refused(start):
    window = cs.FingerAcceleration(0, start, 0.5, (0.1, 0.1))
    try:
        plan = planned(disturbances=[window], profile=cs.Profile([0.0, 0.1]))
    except cs.ContactSystemError:
        return
    assert np.isfinite(plan.points([0.0, 1.0])).all()


@pytest.mark.parametrize("turns", [1e20, 1e42])
def test_a_contact_angle_of_many_turns_is_the_angle_or_refused(turns):
    try:
        plan = planned(contact={"angle": turns, "object_velocity": (0.2, 0.1)})
    except cs.ContactSystemError:
        return
    states = plan.states([1.0])
    psi = states[0, 0, 8]
    a1, a2 = (
        s.metric_root(*states[0, 0, 4 * k : 4 * k + 2]) @ states[0, 0, 4 * k + 2 : 4 * k + 4]
        for k, s in enumerate((plan.scene.contacts[0].finger, plan.scene.object))
    )
    c, s = math.cos(psi), math.sin(psi)
    assert np.array([[c, -s], [-s, -c]]) @ a1 - a2 == pytest.approx(
        plan.slip([1.0])[0, 0], abs=1e-9
    )


def test_a_path_of_more_radians_than_digits_is_refused():
    with pytest.raises(cs.ContactSystemError, match="contact"):
        planned(contact={"finger_velocity": (1e89, 1.0)})


@pytest.mark.parametrize("call", ["restart", "continued", "points", "states"])
def test_a_time_that_is_no_number_is_refused(call):
    given = ("0.1", np.ones((1, 9))) if call == "restart" else ("0.1s",)
    with pytest.raises(cs.ContactSystemError):
        getattr(planned(), call)(*given)


HANGS = {
    "force": "disturbances=[cs.FingerAcceleration(0, 0.1, 0.5, (0.1, 5e18))]",
    "tube": "object=cs.Torus(0.1, 1.2e-12)",
    "grain": "object=cs.Quadric([[-4e14, 0, 0], [0, 2, 0], [0, 0, -4e14]])",
}


@pytest.mark.parametrize("what", HANGS)
def test_a_path_of_very_many_panels_ends_soon_or_is_refused(what):
    text = f"""
import signal
signal.setitimer(signal.ITIMER_PROF, 10.0)
import contact_system as cs
s = cs.Scene(object=cs.Sphere(0.1), profile=cs.Profile([0.1]), duration=1.0,
             contacts=[cs.Contact(finger=cs.Sphere(0.04), object_at=(1.0, 0.5))])
try:
    cs.plan(s.replace({HANGS[what]})).points([1.0])
except cs.ContactSystemError as error:
    print("refused:", error)
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
