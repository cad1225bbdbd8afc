"""``contact-system drake``: what it measures, reports and writes of short simulations."""

from __future__ import annotations

import csv
import dataclasses
import functools
import math
import sys
import warnings

import numpy as np
import pytest

pytest.importorskip("pydrake")

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

import contact_system as cs
from contact_system.cli import main
from drake_plant import (
    BuildStation,
    Push,
    SetInitialState,
    SimulationResult,
    StationConfig,
    cli,
    contact_table,
    simulate,
)

START, STOP = 0.2, 0.4  # of disturbances here, earlier than in the bundled scenes
PUSHED = ["finger", "1", "0.5"]  # how the line of D4's first push begins


def setting(text: str) -> tuple[str, str]:
    return "--set", f"drake.{text}"


POINT = setting("contact_model=point")


@functools.cache
def simulated(name: str, **changes) -> SimulationResult:
    """A bundled scene with its disturbance from START to STOP, simulated until 0.6 s."""
    scene = cs.load_scene(name)
    windows = [dataclasses.replace(d, start=START, stop=STOP) for d in scene.disturbances]
    scene = scene.replace(disturbances=windows, duration=0.6)
    given = {"contact_model": "point", **changes}
    return simulate(scene, StationConfig.from_scene(scene, **given))


def reported(name: str, **changes) -> tuple[list, str]:
    """Reports of its contacts, and the text that the command prints."""
    result = simulated(name, **changes)
    return contact_table(result), " ".join(" ".join(cli._printed(result, None)).split())


# --- measures ------------------------------------------------------------------------------------


def test_a_disturbed_finger_slides_under_mu_and_recovers_while_the_others_roll_as_planned():
    result = simulated("D1")
    finger, *others = contact_table(result)
    t, slip = result.t, np.linalg.norm(result.measured["slip"][:, 0], axis=1)
    assert finger.disturbed_slip == pytest.approx(slip[(t > START) & (t <= STOP)].mean(), rel=0.01)
    level, gone = 0.05 * finger.disturbed_slip, STOP + finger.recovery
    assert finger.slip_before < level and 0.0 < finger.recovery < finger.reported == 0.2
    assert slip[t >= gone].max() < level <= slip[t < gone][-1] and finger.recovery <= 0.01
    assert finger.saturated > 0.9 and finger.friction_ratio == pytest.approx(1.0, abs=0.02)
    for report in (finger, *others):
        assert abs(report.normal_mean - 1.0) < 2e-3 > report.normal_deviation
        assert report.rolling_slip < 1e-4 > report.distance and report.rolling_friction < 0.01
    for other in others:
        assert math.isnan(other.recovery) and math.isnan(other.saturated)
        assert other.verdict == "undisturbed" and not other.slid
    # but for one step, in which the object's acceleration jumps, the others do not feel it
    friction = np.linalg.norm(result.measured["tangential_force"][:, 1:], axis=-1)
    assert friction[(t > START + 2.5e-3) & (t < STOP)].max() < 0.01


@pytest.mark.parametrize(("later", "verdict"), [(0.1, "as reported"), (5e-3, "still recovering")])
def test_recovery_is_measured_only_until_a_push_acts(later, verdict):
    scene = cs.load_scene("D1")
    window = dataclasses.replace(scene.disturbances[0], start=0.05, stop=0.1)
    push = Push("finger 2", 0.1 + later, 0.25, [0.0, 0.0, 1.0])
    scene = scene.replace(disturbances=[window])
    changes = {"contact_model": "point", "pushes": [push], "slip_gain": 800.0 * (later == 0.1)}
    result = simulate(scene, StationConfig.from_scene(scene, **changes), duration=0.3)
    finger, pushed, _ = contact_table(result)
    assert finger.followed == pytest.approx(later) and finger.recovery > 1e-3  # at least a step
    assert (finger.verdict, pushed.verdict) == (verdict, "pushed")


@pytest.mark.parametrize(("step", "start", "stop"), [(1, 0.1002, 0.1017), (2, 0.1005, 0.1025)])
def test_a_disturbance_between_two_samples_is_measured_at_the_next(step, start, stop):
    scene = cs.load_scene("D1")
    window = dataclasses.replace(scene.disturbances[0], start=start, stop=stop)
    scene = scene.replace(disturbances=[window])
    config = StationConfig.from_scene(scene, contact_model="point", time_step=1e-3 * step)
    result = simulate(scene, config, 0.15)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        finger = contact_table(result)[0]
    assert finger.disturbed_slip > 1e-2 and finger.verdict == "as reported"


def test_without_friction_there_is_no_saturation_and_no_friction_ratio():
    finger = contact_table(simulated("D1", friction=0.0))[0]
    assert finger.saturated == 0.0 and np.isnan(finger.friction_ratio)


def test_time_off_the_object_counts_every_step_and_not_only_those_logged():
    result = simulated("D1", normal_force=0.1)  # it is logged every 2 ms, two steps
    station = BuildStation(result.scene, result.config)
    builder = DiagramBuilder()
    builder.AddSystem(station)
    log = LogVectorOutput(station.GetOutputPort("normal_force"), builder, result.config.time_step)
    simulator = Simulator(builder.Build())
    SetInitialState(station, simulator.get_mutable_context())
    simulator.AdvanceTo(result.t[-1])
    off = (log.FindLog(simulator.get_context()).data()[:, 1:] <= 0).sum(axis=1)
    found = [report.time_off for report in contact_table(result)]
    assert found == pytest.approx(off * result.config.time_step) and off[0] > 100


# --- verdicts ------------------------------------------------------------------------------------


def test_a_contact_that_does_not_follow_the_plan_is_reported_astray_and_none_that_rests():
    contact = cs.Contact(cs.Cylinder(0.02), object_at=(0, 0), finger_at=(0, 0), angle=0.05)
    obj, profile = cs.Cylinder(0.1), cs.Profile([0.05])
    scene = cs.Scene(object=obj, contacts=[contact], duration=0.12, profile=profile)
    assert contact_table(simulate(scene))[0].verdict == "astray"
    scene = cs.load_scene("D1").replace(profile=cs.Profile([1e-6]), disturbances=[], duration=0.12)
    report = contact_table(simulate(scene))[0]
    assert report.distance > report.path and report.verdict == "undisturbed"


@pytest.mark.parametrize(
    ("changes", "verdict", "words"),
    [
        ({}, "as reported", "turned by 6.1|0.2 as reported|saturates at finger 1; its peak is 0.5"),
        ({"gravity": 9.81, "forces": "constant"}, "not kept", "moved by 1.75 m|It falls: 0% of"),
        ({"gravity": 9.81, "object": "welded"}, "as reported", "The object moved by 0 m"),
        ({"normal_force": 0.1}, "came off", "finger 1 was off the object for 0.1"),
    ],
)
def test_slip_is_rejected_as_reported_only_where_contacts_are_kept(changes, verdict, words):
    reports, text = reported("D1", **changes)
    assert reports[0].verdict == verdict and reports[0].slid
    assert all(word in text for word in words.split("|"))
    assert ("It falls" in text) == (verdict == "not kept")


@pytest.mark.parametrize(("name", "model"), [("K2", "point"), ("K4", "hydroelastic")])
def test_where_friction_holds_the_report_says_that_there_was_no_slip_to_reject(name, model):
    reports, text = reported(name, contact_model=model)
    for report in reports:
        assert not report.slid and report.verdict == "held" and math.isnan(report.recovery)
    assert text.count(" held ") == 3 and "there was no slip to reject" in text


def test_slip_of_the_plan_itself_is_reported_as_such_and_not_as_rolling():
    reports, text = reported("K1")
    for report in reports:
        assert math.isnan(report.rolling_friction) and math.isnan(report.rolling_slip)
        assert report.plan_slip_time == pytest.approx(0.6, abs=2e-3)
    assert "The plan itself slips at finger 1, finger 2, finger 3, for 0.6 s and by 0.11" in text
    assert "The paper reports: initial slip rejected within 0.04 s." in text


@pytest.mark.parametrize("finger", [cs.Sphere(0.05), cs.Torus(0.04, 0.02), cs.Cylinder(0.05)])
def test_fingers_that_are_planned_to_overlap_are_refused_by_name(finger):
    near = cs.Contact(cs.Sphere(0.02), object_at=(1.0, 0.3))
    long = cs.Contact(cs.Ellipsoid(0.04, 0.02, 0.01), object_at=(1.6, 0.3), name="its neighbour")
    slow = {"profile": cs.Profile([0.02]), "duration": 1.0}
    scene = cs.Scene(object=cs.Sphere(0.1), contacts=[near, long], **slow)
    assert simulate(scene, duration=1e-3).t[-1] == 1e-3
    nearer = dataclasses.replace(long, object_at=(1.3, 0.3))
    both = [dataclasses.replace(contact, finger=finger) for contact in (near, nearer)]
    with pytest.raises(cs.SceneError, match="plant: contact 0 and .*its neighbour. are .* at t ="):
        simulate(scene.replace(contacts=both))


def test_the_command_compares_slip_of_a_push_with_feedback_and_without(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    words = ("--until", 0.6, *POINT, "--no-recording", "--out", tmp_path)
    assert run("D4", *words) == 0
    lines = capsys.readouterr().out.splitlines()
    slip = {w[5]: float(w[6]) for line in lines if (w := line.split())[:3] == PUSHED}
    assert 0 < slip["closed"] < 0.5 * slip["open"] and (tmp_path / "D4-drake.png").exists()
    assert max(len(line) for line in lines if not line.startswith("wrote")) <= 80
    assert run("D4", "--until", 0.01, *words[2:]) == 0
    assert "No push has begun by the end" in capsys.readouterr().out


# --- the command ---------------------------------------------------------------------------------


def run(*words: object) -> int:
    return main(["drake", *map(str, words)])


def test_the_command_reports_and_writes_logs_picture_and_film(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    cs.save_scene(cs.load_scene("D1").replace(name="D1.2"), scene := tmp_path / "scene.toml")
    assert run(scene, "--until", 0.03, *POINT, "--out", tmp_path) == 0
    scene.unlink()
    out = capsys.readouterr().out
    assert "point contact" in out and "times real time" in out and "finger 3" in out
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {f"D1.2-drake.{s}" for s in ("npz", "csv", "png", "html")}
    assert all(f"wrote {tmp_path / name}" in out for name in names)
    assert "nan" not in out  # though the run is too short to measure a steady force
    assert "No disturbance is over by the end" in out
    with np.load(tmp_path / "D1.2-drake.npz") as logs:
        assert logs["measured_normal_force"].shape == (len(logs["t"]), 3)
        assert logs["planned_state"].shape == (len(logs["t"]), 3, 9)
        assert np.isfinite(logs["measured_slip"]).all()
        count = len(logs["t"])
    assert count == 16  # every 2 ms
    rows = list(csv.reader((tmp_path / "D1.2-drake.csv").open()))
    assert len(rows) == 1 + 3 * count and all(len(row) == len(rows[0]) for row in rows)


def test_without_recording_and_matplotlib_the_logs_alone_are_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    words = ("--until", 0.01, *POINT, *setting("time_step=5e-4"), *setting("coordinates=frame"))
    assert run("D1", "--out", tmp_path, "--no-recording", *words) == 0
    assert {p.suffix for p in tmp_path.iterdir()} == {".npz", ".csv"}
    out = capsys.readouterr().out
    assert "step 0.0005 s" in out and "no picture: pictures need matplotlib" in out


def test_keys_of_the_drake_table_can_be_set_on_the_command_line(tmp_path, capsys):
    words = ("--until", 0.01, "--no-recording", "--out", tmp_path)
    assert run("D1", *words, *setting("friction=.3"), *POINT) == 0
    with np.load(tmp_path / "D1-drake.npz") as logs:
        (tmp_path / "D1.toml").write_text(str(logs["scene"]))
    used = StationConfig.from_scene(cs.load_scene("D1"), friction=0.3, contact_model="point")
    assert StationConfig.from_scene(cs.load_scene(tmp_path / "D1.toml")) == used
    for wrong, said in (
        ("friction=0.3", "--set friction=0.3: write it like drake.friction=0.3"),
        ("drake.friction", "--set drake.friction: write it like"),
        ("drake.friction=slippery", "friction = 'slippery': give a finite number"),
    ):
        assert run("D1", *words, "--set", wrong) == 2
        assert said in capsys.readouterr().err
