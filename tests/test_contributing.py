"""The examples of CONTRIBUTING.md work as they are printed."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import contact_system as cs
from contact_system.scene import DISTURBANCE_KINDS
from contact_system.theory.gain import LAWS, Law

PAGE = Path(__file__).parent.parent / "CONTRIBUTING.md"
T = np.linspace(0.0, 1.0, 21)


@pytest.fixture
def example(monkeypatch):
    """A function that runs a section's example; what it registers is removed after the test."""
    laws, kinds = dict(LAWS), list(DISTURBANCE_KINDS)

    def run(section: str, old: str = "", new: str = "") -> dict:
        text = PAGE.read_text("utf-8").split(f"## {section}\n")[1].split("\n## ")[0]
        scope: dict = {"__name__": "example"}
        code = re.search(r"```python\n(.*?)```", text, re.S)[1]
        exec(compile(code.replace(old, new), "example", "exec", dont_inherit=True), scope)
        return scope

    yield run
    LAWS.clear()
    LAWS.update(laws)
    DISTURBANCE_KINDS[:] = kinds


BALL = cs.Sphere(0.1)


def scene(obj: cs.Surface = BALL, **others) -> cs.Scene:
    contact = cs.Contact(finger=cs.Sphere(0.04), object_at=(0.4, 0.3), object_velocity="rest")
    given = {"profile": cs.Profile([0.1, 0.2]), "duration": 1.0, "contacts": [contact]} | others
    return cs.Scene(object=obj, **given)


def test_the_examples_surface_has_the_curvature_and_points_of_its_equation(example):
    bowl = example("A surface")["Paraboloid"](0.25)
    assert np.abs(bowl.curvature_form(0.0, 0.0) + 4.0 * np.eye(2)).max() < 1e-14
    points = cs.plan(scene(bowl)).points(T)[:, 0, 1]
    level = points[:, 2] - 2 * (points[:, 0] ** 2 + points[:, 1] ** 2)
    assert np.abs(level).max() < 1e-14
    # steering does not take it for flat, though its coordinates are lengths
    cup = dataclasses.replace(bowl, radius=0.1)
    contact = cs.Contact(finger=cup, object_at=(0.05, 0.02), finger_at=(0.01, 0.03))
    goal = cs.Goal(object_at=(0.09, 0.1), finger_at=(0.04, 0.06), angle=-0.07)
    assert cs.reach(scene(bowl, contacts=[contact]), goal).residual < 1e-12


def test_a_class_that_replaces_another_of_its_name_has_its_own_equation(example):
    for half in (2, 4):
        bowl = example("A surface", "(2 * ", f"({half} * ")["Paraboloid"](0.25)
        assert bowl.point(0.1, 0.0)[2] == pytest.approx(0.01 / (half * 0.25), rel=1e-12)


def test_under_the_examples_gain_law_slip_decays_by_its_integral(example):
    example("A gain law")
    plan = cs.plan(scene(gain=cs.Gain("speed", 20.0)))
    sigma, length = plan.scene.profile(T), plan.scene.profile.arc_length(T)
    expected = plan.slip_speed(0.0)[0, 0] * sigma / sigma[0] * np.exp(-20.0 * length)
    assert plan.slip_speed(T)[:, 0] == pytest.approx(expected, rel=1e-12)
    # sigma'/sigma^2 is greatest at the start
    assert plan.scene.contraction().least_eta == pytest.approx(0.2 / 0.1**2)
    assert "lam = eta sigma," in str(plan.scene.contraction())


def test_systems_and_sweeps_have_a_law_that_replaces_another_of_its_name(monkeypatch, tmp_path):
    for power in (1, 3):
        monkeypatch.setitem(LAWS, "speed", Law("eta", "", power))
        plan = cs.plan(scene(gain=cs.Gain("speed", 30.0)))
        system = cs.SceneSystem(plan.scene, "chart")
        found = system.evaluate("slip_acceleration", 0.0, system.x0)
        assert found == pytest.approx(plan.acceleration(0.0)[0, 0], rel=1e-12)
        table = cs.sweep([plan.scene], folder=tmp_path).table
        assert table["slip_end"] == cs.summary(plan)["slip_end"]


def test_the_examples_kind_of_disturbance_acts_and_is_saved_in_files(example, tmp_path):
    drift = example("A disturbance")["ObjectDrift"]
    found, expected = (
        scene(disturbances=[kind("all", 0.2, 0.5, (0.3, -0.1))])
        for kind in (drift, cs.ObjectRateOffset)
    )
    assert (cs.plan(found).states(T) == cs.plan(expected).states(T)).all()
    cs.save_scene(found, tmp_path / "drift.toml")
    assert cs.load_scene(tmp_path / "drift.toml").disturbances == found.disturbances
