"""Random search for scenes that fail, with the scenes and exact laws of the stress benchmark.

`benchmarks.stress_scenes` draws scenes and `stress_laws` judges their plans; here hypothesis makes
the choices, so that it can shrink a failure. Failures that were found have tests in `test_paths`.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

pytest.importorskip("hypothesis")
from hypothesis import HealthCheck, given, settings  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

import contact_system as cs  # noqa: E402
from benchmarks import stress, stress_laws, stress_scenes  # noqa: E402


class Choices:
    """Hypothesis as the source of choices of `stress_scenes.draw_trial`."""

    def __init__(self, data: st.DataObject):
        self.data = data

    def pick(self, values):
        return self.data.draw(st.sampled_from(list(values)))

    def real(self, low, high):
        # Rounded: durations and windows of almost no length have tests in test_paths.
        return round(self.data.draw(st.floats(low, high)), 9)


def search(examples: int):
    """Settings of a search that is the same in every run."""
    slow = [HealthCheck.too_slow, HealthCheck.data_too_large]
    same = {"derandomize": True, "deadline": None, "database": None}
    return settings(max_examples=examples, suppress_health_check=slow, **same)


DISTURBED = {"object": "sphere", "finger": "ellipsoid", "shape": "plain", "windows": 2}


def verdict_of(data: st.DataObject, **fixed) -> stress_laws.Verdict:
    def call() -> stress_laws.Verdict:
        return stress_laws.run(stress_scenes.draw_trial(Choices(data), **fixed))

    return stress.judged(call)


@search(60)
@given(st.data(), st.sampled_from([{}, DISTURBED]))
def test_any_scene_ends_right_or_refused(data, fixed):
    verdict = verdict_of(data, **fixed)
    assert verdict.outcome in ("right", "refused"), verdict


@search(25)
@given(st.data(), st.sampled_from(stress._poles()))
def test_any_path_through_or_past_a_pole_ends_right_or_refused(data, aim):
    verdict = verdict_of(data, **aim)
    assert verdict.outcome in ("right", "refused"), verdict


@pytest.mark.parametrize("name", stress.FAMILIES)
def test_every_family_makes_cases_that_end_right_or_refused(name):
    family, few = stress.FAMILIES[name], {"mutated files": 60, "revolutions, integrated": 2}
    for index in np.linspace(0, family.count - 1, few.get(name, 6)).astype(int):
        verdict = stress.judged(functools.partial(family.run, int(index)))
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


@pytest.mark.parametrize("what", WRONG)
def test_the_judge_notices_small_errors_and_nan(what):
    output, change = WRONG[what]
    drawn = trial()
    plan = cs.plan(drawn.scene)
    assert stress_laws.Judge(drawn, plan).verdict().outcome == "right"
    right = getattr(plan, output)
    setattr(plan, output, lambda t: change(right(t)))
    assert stress_laws.Judge(drawn, plan).verdict().outcome == "silent"


def test_the_judge_counts_an_error_without_place_value_and_remedy_as_a_crash():
    text = "scene 'x', contact 0: angle = nan: give a finite number"
    assert stress_laws.refusal(text).outcome == "refused"
    for part in ("array must not contain infs", "scene 'x': no", "failed, use another"):
        assert stress_laws.refusal(part).outcome == "crash"
