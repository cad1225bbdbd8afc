"""``contact-system drake`` and what it measures: on made-up signals, and on short simulations."""

from __future__ import annotations

import argparse
import csv
import dataclasses
import functools
import math
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pydrake")

import contact_system as cs
from drake_plant import Push, SimulationResult, StationConfig, cli, contact_table, simulate
from drake_plant.measures import contact_speed, durations, time_off

T = np.linspace(0.0, 4.0, 4001)
START, STOP = 2.0, 2.5  # of D1's disturbance
NOISE = 1e-4
PUSHED = ["finger", "1", "0.5"]  # the line of D4's first push
LIMIT = np.full(len(T), 0.5)  # mu N


def made_up(slip: np.ndarray, friction: np.ndarray, normal: np.ndarray | float = 1.0):
    """A result of D1 whose three contacts have these slips (m/s) and forces (N) along x."""
    scene = cs.load_scene("D1")
    plan = cs.plan(scene)
    points = plan.points(T)[:, :, 1]
    along = np.zeros((len(T), 3, 2))
    along[:, :, 0] = 1.0
    planned = {"state": plan.states(T), "slip": plan.slip(T), "contact_point": points}
    measured = {
        "state": planned["state"],
        "slip": slip[:, None, None] * along,
        "normal_force": np.ones((len(T), 3)) * np.reshape(normal, (-1, 1)),
        "tangential_force": friction[:, None, None] * along,
        "contact_point": points + [0.0, 3e-4, 0.0],
    }
    config, poses = StationConfig(contact_model="point"), np.tile(np.eye(4), (len(T), 1, 1))
    return SimulationResult(scene, config, T, planned, measured, poses, 0.0, 0.0)


def decaying(rate: float) -> np.ndarray:
    """Slip of 0.05 m/s while disturbed, decaying afterwards, over a floor of noise."""
    slip = np.full(len(T), NOISE)
    slip[(T >= START) & (T < STOP)] = 0.05
    return np.maximum(slip, 0.05 * np.exp(-rate * (T - STOP)) * (T >= STOP))


def setting(text: str) -> tuple[str, str]:
    return "--set", f"drake.{text}"


POINT = setting("contact_model=point")


# --- measures ------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [10.0, 40.0])
def test_recovery_is_when_slip_falls_below_a_twentieth(rate):
    finger = contact_table(made_up(decaying(rate), LIMIT))[0]
    assert finger.disturbed_slip == pytest.approx(0.05, rel=1e-9)
    assert finger.recovery == pytest.approx(math.log(20) / rate, abs=1.1e-3)
    assert finger.reported == 0.2
    assert finger.as_reported is (rate == 40.0)
    assert contact_table(made_up(decaying(rate), 0.8 * LIMIT))[0].recovery == finger.recovery
    slip = decaying(rate)
    slip[T > 3.999] = 0.01  # slip that comes back has not recovered
    reports = contact_table(made_up(slip, LIMIT))
    assert reports[0].recovery == math.inf and reports[0].as_reported is False
    assert [math.isnan(r.recovery) for r in reports] == [False, True, True]  # not disturbed
    assert reports[0].saturated > 0 and math.isnan(reports[1].saturated)


def test_a_disturbance_that_is_over_is_judged_until_the_next():
    result = made_up(np.where(T > 3.0, 0.05, decaying(40.0)), LIMIT)
    for push, edges, verdict in (
        (3.0, [START, STOP], "as reported"),
        (3.5, [START, STOP, 3.0, 4.5], "as reported"),
        (3.5, [START, 3.9], "still recovering"),
    ):
        result.config.pushes = [Push("finger 1", push, push + 0.1, [1.0, 0.0, 0.0])]
        both = [cs.ObjectRateOffset(0, *edge, (0.6, 1.0)) for edge in zip(edges[::2], edges[1::2])]
        result.scene = result.scene.replace(duration=5.0, disturbances=both)
        assert contact_table(result)[0].verdict == verdict


def test_slip_need_not_fall_below_what_it_was_before():
    slip = decaying(10.0)
    slip[T < START] = 0.01
    finger = contact_table(made_up(slip, LIMIT))[0]
    assert finger.slip_before == pytest.approx(0.01)
    assert finger.recovery == pytest.approx(math.log(5) / 10, abs=1.1e-3)


def test_a_disturbance_between_two_samples_is_seen_in_the_next():
    result = made_up(decaying(40.0), np.zeros(len(T)))
    short = dataclasses.replace(result.scene.disturbances[0], start=0.1002, stop=0.1007)
    result = dataclasses.replace(result, scene=result.scene.replace(disturbances=[short]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        finger = contact_table(result)[0]
    assert finger.verdict == "held" and finger.saturated == 0.0


def test_forces_are_compared_with_the_momentary_normal_force():
    normal = 1.0 + 0.1 * np.sin(40 * T)
    friction = np.where((T >= START) & (T < STOP), 0.5 * normal, 0.05)
    normal[T < 0.01] = 0.01  # hardly touching, where the ratio says nothing
    finger = contact_table(made_up(decaying(40.0), friction, normal))[0]
    assert finger.friction_ratio == pytest.approx(1.0)
    assert finger.friction_peak == pytest.approx(0.55, abs=1e-3)
    assert finger.saturated == 1.0
    assert finger.rolling_friction == pytest.approx(0.05)


@pytest.mark.parametrize(("mu", "pressing"), [(0.0, 1.0), (0.5, 0.0)])
def test_where_no_friction_can_act_none_is_saturated(mu, pressing):
    """Without a coefficient, or where a finger is off the object while disturbed."""
    normal = np.where((T >= START) & (T < STOP), pressing, 1.0)
    result = made_up(decaying(40.0), np.zeros(len(T)), normal)
    result.config.friction = mu
    finger = contact_table(result)[0]
    assert finger.saturated == 0.0
    assert np.isnan(finger.friction_ratio) if mu == 0 else finger.friction_ratio == 0


def test_normal_force_is_measured_outside_of_transients():
    normal = np.ones(len(T))
    for edge in (0.0, START, STOP):
        normal[np.abs(T - edge) < 0.1] = 5.0
    finger = contact_table(made_up(decaying(40.0), np.zeros(len(T)), normal))[0]
    assert (finger.normal_mean, finger.normal_deviation) == (1.0, 0.0)


def test_rows_stand_for_steps_that_end_off_the_object_or_all_since_the_last():
    """Logs are 2 ms apart, but for steps of 1 ms off the object."""
    t = np.array([0.0, 0.002, 0.004, 0.005, 0.006])
    normal = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 1.0], [1.0, 1.0]])
    result = SimpleNamespace(t=t, measured={"normal_force": normal}, config=StationConfig())
    assert time_off(result).sum(axis=0) == pytest.approx([0.002, 0.0])
    assert durations(result) == pytest.approx([0.0, 0.002, 0.001, 0.001, 0.002])


def test_rolling_is_measured_before_the_disturbance():
    result = made_up(decaying(40.0), np.zeros(len(T)))
    scene, t = result.scene, T[(T >= 0.1) & (T < START)]
    sigma = scene.profile(T)
    speed = contact_speed(scene, result.planned["state"])
    assert speed[T < START] == pytest.approx(np.tile(sigma[T < START, None], (1, 3)), rel=1e-9)
    for report in contact_table(result):
        assert report.rolling_slip == pytest.approx(np.mean(NOISE / scene.profile(t)), rel=1e-6)
        assert report.distance == pytest.approx(3e-4)


# --- what happened -------------------------------------------------------------------------------


@functools.cache
def told(name: str, **changes) -> tuple[list, str]:
    """The reports of a scene with its disturbance early, and all that is said of it."""
    scene = cs.load_scene(name)
    windows = [dataclasses.replace(d, start=0.2, stop=0.4) for d in scene.disturbances]
    scene = scene.replace(disturbances=windows, duration=0.6)
    result = simulate(
        scene, StationConfig.from_scene(scene, **{"contact_model": "point", **changes})
    )
    return contact_table(result), " ".join(" ".join(cli._told(result, None)).split())


def test_slip_that_is_rejected_with_all_contacts_kept_is_as_reported():
    reports, text = told("D1")
    assert reports[0].as_reported and reports[0].slid and not reports[0].off
    assert "Here slip is rejected within that time." in text
    assert "Tangential force saturates at finger 1; its peak is 0.5" in text
    assert "The object moved by 0.023 m and turned by 6.1" in text


def test_bodies_that_fall_together_are_not_what_the_paper_reports():
    reports, text = told("D1", gravity=9.81, forces="constant")
    assert reports[0].as_reported is False
    assert "The object moved by 1.75 m" in text and "It falls: 0% of its weight is carr" in text
    assert "This is not what the paper reports on: the object falls." in text


def test_a_finger_that_leaves_the_object_is_not_as_reported():
    reports, text = told("D1", normal_force=0.1)
    assert reports[0].off > 0.1 and reports[0].as_reported is False
    assert "finger 1 was off the object for" in text
    assert "contact was lost at finger 1." in text and "is rejected" not in text


def test_an_object_that_flies_away_is_told_of_and_no_cause_is_made_up():
    _, text = told("D1", object_mass=0.05)
    assert "The object moved by 1.79 m" in text
    assert "facets" not in text and "meshes" not in text


@pytest.mark.parametrize(("name", "model"), [("K2", "point"), ("K4", "hydroelastic")])
def test_where_friction_holds_there_is_nothing_to_reject(name, model):
    reports, text = told(name, contact_model=model)
    for report in reports:
        assert not report.slid and report.as_reported is None and math.isnan(report.recovery)
    assert "Friction alone held finger 1, finger 2, finger 3, with at most " in text
    assert "rejected." not in text and text.count(" held ") == 4


def test_a_plan_that_slides_is_not_said_to_roll():
    reports, text = told("K1")
    for report in reports:
        assert math.isnan(report.rolling_friction) and math.isnan(report.rolling_slip)
        assert report.plan_slips == pytest.approx(0.6, abs=2e-3)
    assert (
        "The plan itself slips at finger 1, finger 2, finger 3, for 0.6 s and by 0.11 m/s" in text
    )


def test_a_welded_object_does_not_fall():
    reports, text = told("D1", gravity=9.81, object="welded")
    assert reports[0].as_reported and "falls" not in text and "moved by 0 m" in text


def test_fingers_that_are_planned_to_overlap_are_refused_by_name():
    scene = cs.load_scene("D1")
    near = dataclasses.replace(scene.contacts[1], object_at=(0.3886, 3.6), name="its neighbour")
    crowded = scene.replace(contacts=[scene.contacts[0], near])
    words = "'D1', plant: finger 1 and its neighbour are planned to overlap by .* m at t = .*; move"
    with pytest.raises(cs.SceneError, match=words):
        simulate(crowded, duration=0.1)


def test_pushes_are_told_with_the_loop_closed_and_open(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    words = ("--until", 0.6, *POINT, "--no-recording", "--out", tmp_path)
    assert run("D4", *words) == 0
    out = capsys.readouterr().out
    line = next(line.split() for line in out.splitlines() if line.split()[:3] == PUSHED)
    closed, opened = map(float, line[5:7])
    assert 0 < closed < 0.5 * opened
    assert (tmp_path / "D4-drake.png").exists()
    assert run("D4", "--until", 0.01, *words[2:]) == 0
    assert "No push has begun by the end" in capsys.readouterr().out


# --- the command ---------------------------------------------------------------------------------


def run(*words: object) -> int:
    parser = argparse.ArgumentParser()
    cli.register(parser.add_subparsers())
    args = parser.parse_args(["drake", *map(str, words)])
    return args.run(args)


def test_d1_runs_tells_and_writes(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert run("D1", "--until", 0.03, *POINT, "--out", tmp_path) == 0
    out = capsys.readouterr().out
    assert "point contact" in out and "times real time" in out and "finger 3" in out
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {f"D1-drake.{s}" for s in ("npz", "csv", "png", "html")}
    assert all(f"wrote {tmp_path / name}" in out for name in names)
    assert "nan" not in out  # too short a run to measure a steady force
    assert "No disturbance is over by the end" in out
    with np.load(tmp_path / "D1-drake.npz") as logs:
        assert logs["measured_normal_force"].shape == (len(logs["t"]), 3)
        assert logs["planned_state"].shape == (len(logs["t"]), 3, 9)
        assert np.isfinite(logs["measured_slip"]).all()
        count = len(logs["t"])
    assert count == 16  # every 2 ms
    rows = list(csv.reader((tmp_path / "D1-drake.csv").open()))
    assert len(rows) == 1 + 3 * count and all(len(row) == len(rows[0]) for row in rows)


def test_no_recording_is_written_where_none_is_wanted(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    words = ("--until", 0.01, *POINT, *setting("time_step=5e-4"), *setting("coordinates=frame"))
    assert run("D1", "--out", tmp_path, "--no-recording", *words) == 0
    assert {p.suffix for p in tmp_path.iterdir()} == {".npz", ".csv"}
    out = capsys.readouterr().out
    assert "step 0.0005 s" in out and "no picture: pictures need matplotlib" in out


def test_keys_of_the_drake_table_can_be_set_for_a_run(tmp_path):
    words = ("--until", 0.01, "--no-recording", "--out", tmp_path)
    assert run("D1", *words, *setting("friction=0.3"), *POINT) == 0
    for wrong, told in (
        ("friction=0.3", "--set friction=0.3: write it like drake.friction=0.3"),
        ("drake.friction", "--set drake.friction: write it like"),
        ("drake.friction=slippery", "friction = 'slippery': give a finite number"),
    ):
        with pytest.raises(cs.SceneError, match=told):
            run("D1", *words, "--set", wrong)
