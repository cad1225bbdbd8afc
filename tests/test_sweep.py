"""Sweeps give what plans of their scenes one by one give, whatever happens to workers."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import re
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from conftest import Terminal, one_contact

import contact_system as cs
from contact_system.cli import Progress

PUSH = cs.FingerAcceleration(contact=0, start=0.2, stop=0.4, value=(-0.3, 0.2))
OFFSET = cs.ObjectRateOffset(contact=0, start=0.3, stop=0.5, value=(0.1, 0.2))
BUMP = cs.FingerAcceleration(contact=0, start=0.2, stop=0.4, value=(1.0, 0.0))


def rolling_towards(k: int, **changes) -> cs.Scene:
    """Scene k of a family on spheres."""
    velocity = (math.cos(0.3 + 0.1 * k), math.sin(0.3 + 0.1 * k))
    return one_contact(object_at=(0.9 + 0.01 * k, 0.4), finger_velocity=velocity, **changes)


def family(count: int, **changes) -> list[cs.Scene]:
    return [rolling_towards(k, **changes) for k in range(count)]


def middle(plan: cs.Plan) -> dict[str, np.ndarray]:
    """Contact points and states halfway."""
    return {k: x[0] for k, x in plan.evaluate([0.5 * plan.end], "points", "states").items()}


def middle_after_one_kill(mark: Path, plan: cs.Plan) -> dict[str, np.ndarray]:
    """`middle`, but the first worker that evaluates it is killed; a file marks that it was."""
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return middle(plan)


def middle_of_all_but_one(mark: Path, plan: cs.Plan) -> dict[str, np.ndarray]:
    """`middle`, but the family's second scene kills its worker as long as there is no mark."""
    if not mark.exists() and any(abs(c.object_at[0] - 0.91) < 1e-9 for c in plan.scene.contacts):
        os.kill(os.getpid(), signal.SIGKILL)
    return middle(plan)


def middle_slowly(plan: cs.Plan) -> dict[str, np.ndarray]:
    time.sleep(0.1)
    return middle(plan)


def one_by_one(scenes: list[cs.Scene], key: str) -> np.ndarray:
    return np.concatenate([middle(cs.plan(scene))[key] for scene in scenes])


@pytest.mark.parametrize("windows", [(), (PUSH, OFFSET)])
def test_scenes_planned_together_give_what_each_gives_alone(windows):
    scenes = family(7, disturbances=windows)
    table = cs.sweep(scenes, middle, chunk=5).table
    assert table["scene"].tolist() == list(range(7)) and not table["contact"].any()
    assert table["states"] == pytest.approx(one_by_one(scenes, "states"), abs=1e-11)

    def fails_for_the_fourth(plan):
        if 3 in numbers_of(plan):
            raise ValueError("not with this one")
        return middle(plan)

    found = cs.sweep(scenes, fails_for_the_fourth)
    assert [failure.scene for failure in found.failures] == [3]
    assert found.table["states"] == pytest.approx(np.delete(table["states"], 3, 0), abs=1e-11)


def test_scenes_that_have_nothing_in_common_keep_their_order():
    gains = [cs.Gain.time(3.0), cs.Gain.path(100.0), cs.Gain.time(3.0)]
    scenes = [rolling_towards(k, gain=gain) for k, gain in enumerate(gains)]
    scenes += [one_contact("ellipsoid"), cs.load_scene("K1"), rolling_towards(5)]
    table = cs.sweep(scenes, middle).table
    counts = [len(scene.contacts) for scene in scenes]
    assert table["scene"].tolist() == np.repeat(range(6), counts).tolist()
    assert table["name"].tolist() == np.repeat([scene.name for scene in scenes], counts).tolist()
    assert table["points"] == pytest.approx(one_by_one(scenes, "points"), abs=1e-12)
    own = [scene.replace(drake={"k": [k]}) for k, scene in enumerate(family(3))]
    assert cs.sweep(own, lambda plan: plan.scene.drake).table["k"].tolist() == [0, 1, 2]


def test_the_summary_is_what_rejections_and_states_tell():
    scenes = [
        rolling_towards(0, gain=cs.Gain.time(0.01), profile=(0.1,)),
        rolling_towards(1, gain=cs.Gain.time(7.0), profile=(0.2,)),
        rolling_towards(2, gain=cs.Gain.time(5e3), profile=(0.0, 0.1)),  # slip for 2 ms
        rolling_towards(3, object_velocity="rolling", disturbances=[OFFSET]),
        rolling_towards(4, gain=cs.Gain.time(50.0), object_velocity="rolling", disturbances=[BUMP]),
        rolling_towards(5, object_velocity="rolling"),
    ]
    table = cs.sweep(scenes).table
    for row, plan in zip(table, map(cs.plan, scenes)):
        (exact,) = cs.rejections(plan)
        assert (row["slip_start"], row["slip_end"]) == (exact.start, exact.end)
        assert row["slip_peak"] == pytest.approx(exact.peak, rel=0.02)
        assert row["recovery"] == pytest.approx(exact.time, rel=0.02, nan_ok=True)
        assert row["state_end"] == pytest.approx(plan.states(1.0)[0, 0], abs=1e-12)
    assert (table["slip_peak"] == table["slip_start"])[:2].all()  # slip only shrinks
    never, exponential, _, at_once, _, none = table["recovery"]
    assert (never, at_once) == (math.inf, 0.0) and math.isnan(none)
    assert exponential == pytest.approx(math.log(20) / 7, rel=1e-9)


def test_a_scene_that_fails_is_kept_with_its_error_beside_the_others(tmp_path):
    at_rest = rolling_towards(1, profile=(0.0, 0.1)).replace(
        name="resting",
        disturbances=[cs.FingerAcceleration(contact=0, start=0.0, stop=0.4, value=(1.0, 0.0))],
    )
    bad = functools.partial(rolling_towards, 2, duration=-1.0)
    scenes = [*family(4), at_rest, bad, "K1", "K0"]
    found = cs.sweep(scenes, middle, chunk=3)
    assert sorted(set(found.table["scene"].tolist())) == [0, 1, 2, 3, 6]
    assert [failure.scene for failure in found.failures] == [4, 5, 7]
    assert found.failures[0].name == "resting" and "sigma = 0" in found.failures[0].error
    (tmp_path / "failed.toml").write_text(found.failures[0].text)
    assert cs.load_scene(tmp_path / "failed.toml") == at_rest
    assert "duration = -1" in found.failures[1].error and "K0" in found.failures[2].error


@pytest.mark.parametrize(
    ("outputs", "said"),
    [
        (lambda n: {"end": [{}] * n}, r"'end' of shape \(1,\) and type object"),
        (lambda n: {"end": [[0], [0, 1]] * n}, "give one row of numbers or texts"),
        (lambda n: {1: [0] * n}, "the key 1; give names as text"),
        (lambda n: {"end": np.zeros((n + 1, 1, 9))}, r"'end' of shape \(2, 1, 9\)"),
    ],
)
def test_outputs_that_cannot_be_saved_are_refused_by_name(outputs, said):
    with pytest.raises(cs.ContactSystemError, match=said):
        cs.sweep(family(3), lambda plan: outputs(len(plan.scene.contacts)))


def angles(scene: cs.Scene, of=lambda contact: contact.angle) -> dict[str, np.ndarray]:
    """An evaluation of scenes, not of plans, that fails for K1."""
    if scene.name == "K1":
        raise ValueError("not this one")
    return {"angle": np.array([of(contact) for contact in scene.contacts])}


def test_with_each_a_function_gets_the_scenes_one_by_one_and_no_plan(tmp_path):
    scenes = [rolling_towards(0, angle=0.5), "K1", rolling_towards(1), "D1"]
    for _ in range(2):
        found = cs.sweep(scenes, angles, each=True, folder=tmp_path)
        assert found.table["scene"].tolist() == [0, 2, 3, 3, 3]
        assert found.table["angle"].tolist() == [0.5, 0.3, 0, 0, 0]
        assert [(f.scene, f.error) for f in found.failures] == [(1, "ValueError: not this one")]
    assert len(list(tmp_path.iterdir())) == 4  # a file for each scene


def test_outputs_that_differ_between_scenes_are_refused():
    def names(plan):
        return {plan.scene.name: np.zeros(len(plan.scene.contacts))}

    with pytest.raises(cs.ContactSystemError, match="different outputs for different"):
        cs.sweep([rolling_towards(0), one_contact("torus")], names)


def test_a_generator_of_scenes_is_read_no_further_ahead_than_asked():
    taken, seen = 0, []

    def scenes():
        nonlocal taken
        for k in range(40):
            taken += 1
            yield rolling_towards(k % 5)

    def count(plan):
        seen.append(taken)
        return middle(plan)

    with ThreadPoolExecutor(1) as pool:
        table = cs.sweep(scenes(), count, pool, chunk=2, ahead=3).table
    assert len(table) == 40
    assert all(now <= 2 * (k + 4) for k, now in enumerate(seen))


def numbers_of(plan: cs.Plan) -> list[int]:
    """Numbers of the scenes of `family` that were joined in one plan."""
    return [round(100 * (c.object_at[0] - 0.9)) for c in plan.scene.contacts]


def test_an_interrupted_sweep_goes_on_where_it_stopped(tmp_path):
    scenes, done = family(10), []

    def interrupted(plan):
        if 7 in numbers_of(plan) and 7 not in done:
            done.append(7)
            raise KeyboardInterrupt
        done.extend(numbers_of(plan))
        return middle(plan)

    with pytest.raises(KeyboardInterrupt):
        cs.sweep(scenes, interrupted, folder=tmp_path, chunk=2)
    first, done[:] = set(done), [7]
    table = cs.sweep(iter(scenes), interrupted, folder=tmp_path, chunk=2).table
    assert first >= {0, 1, 2, 3, 4, 5} and sorted(set(done[1:])) == [6, 7, 8, 9]
    assert table["points"] == pytest.approx(one_by_one(scenes, "points"), abs=1e-12)


def test_only_chunks_of_changed_scenes_are_done_again(tmp_path):
    scenes, done = [*family(5), functools.partial(rolling_towards, 5)], []

    def counted(plan):
        done.extend(numbers_of(plan))
        return middle(plan)

    cs.sweep(scenes, counted, folder=tmp_path, chunk=2)
    assert sorted(done) == list(range(6))
    done.clear()
    scenes[2] = rolling_towards(2, angle=0.5)
    (third,) = tmp_path.glob("chunk-00000004-*.npz")
    third.write_bytes(b"cut off")
    found = cs.sweep(scenes, counted, folder=tmp_path, chunk=2)
    assert sorted(done) == [2, 3, 4, 5]
    made = [*scenes[:5], rolling_towards(5)]
    assert found.table["states"] == pytest.approx(one_by_one(made, "states"), abs=1e-11)
    assert [len(table) for table in found] == [2, 2, 2]


def test_saved_results_are_not_used_for_a_surface_of_another_function(tmp_path):
    for function in (lambda u, v: (u, v, 0.1 * u * v), lambda u, v: (u, v, -0.5 * u * u)):
        surface = cs.ParametricSurface(function)
        scene = one_contact(object_at=(-0.4, 0.3)).replace(object=surface)
        found = cs.sweep([scene], middle, folder=tmp_path).table["states"]
        assert found == pytest.approx(one_by_one([scene], "states"), abs=1e-12)


def test_saved_results_are_not_used_for_a_scene_file_that_was_changed(tmp_path):
    file, folder = tmp_path / "scene.toml", tmp_path / "results"
    with pytest.raises(cs.ContactSystemError, match="no scene has a result; the first of 1"):
        _ = cs.sweep([str(file)], middle, folder=folder).table  # no such file yet
    for k in range(2):
        cs.save_scene(rolling_towards(k), file)
        found = cs.sweep([str(file)], middle, folder=folder).table["states"]
        assert found == pytest.approx(one_by_one([rolling_towards(k)], "states"), abs=1e-12)


def test_sweeps_may_share_a_folder_and_name_a_file_that_was_removed_from_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = cs.sweep(family(2), middle, folder="results")
    monkeypatch.chdir("/")
    expected = first.table
    second = cs.sweep(family(3)[1:], middle, folder=tmp_path / "results")
    assert not np.array_equal(second.table, expected)
    assert np.array_equal(first.table, expected)
    for file in (tmp_path / "results").iterdir():
        file.unlink()
    with pytest.raises(cs.ContactSystemError, match="chunk-00000000-.*npz' no longer holds"):
        _ = second.failures


@pytest.mark.parametrize(
    ("option", "value", "remedy"),
    [
        ("scenes", "K1", "give a list of scenes"),
        ("evaluate", "summary", "give a function of a plan"),
        ("executor", 4, "give an executor"),
        ("folder", 3, "give a path"),
        ("each", 1, "give True or False"),
        ("tolerance", 5, "give a number from 1e-15"),
        ("chunk", 0, "give a whole number"),
        ("ahead", 2.5, "give a whole number"),
    ],
)
def test_arguments_of_another_kind_are_refused_by_name(option, value, remedy):
    with pytest.raises(cs.ContactSystemError, match=f"{option} = .*: {remedy}"):
        cs.sweep(**{"scenes": ["K1"], option: value})
    with pytest.raises(cs.ContactSystemError, match="scenes = Scene.*: give a list of scenes"):
        cs.sweep(rolling_towards(0))


def test_functions_that_cannot_be_pickled_and_an_executor_that_was_shut_down_are_refused():
    with ProcessPoolExecutor(1) as pool:
        for scenes, evaluate in ((["K1"], lambda plan: middle(plan)), ([lambda: None], middle)):
            with pytest.raises(cs.ContactSystemError, match="give functions of a module"):
                cs.sweep(scenes, evaluate, pool)
    with pytest.raises(cs.ContactSystemError, match="takes no work .*; give one that is not shut"):
        cs.sweep(["C1"], executor=pool)


def test_a_folder_or_a_file_that_cannot_be_written_is_refused_by_name(tmp_path):
    (tmp_path / "taken").touch()
    with pytest.raises(cs.ContactSystemError, match="taken': .*; give another folder"):
        cs.sweep(["C1"], folder=tmp_path / "taken")
    (tmp_path / "taken").unlink()
    cs.sweep(["C1"], folder=tmp_path)
    (file,) = tmp_path.iterdir()
    file.unlink()
    file.mkdir()
    with pytest.raises(cs.ContactSystemError, match="chunk-00000000-.*npz' cannot be written: "):
        cs.sweep(["C1"], folder=tmp_path)


def state_at(t: float | np.ndarray, change=np.abs):
    """A function of a plan: its state at t, changed by another function."""

    def end(plan: cs.Plan) -> dict[str, np.ndarray]:
        return {"end": change(plan.states(np.reshape(t, 1))[0])}

    return end


ALMOST = (np.array(0.1),), (np.array(0.1 + 3e-10),)
PAIRS = [((0.1,), (0.5,)), ALMOST, ((0.1, np.ndarray.copy), (0.1, np.square))]


@pytest.mark.parametrize("captured", PAIRS)
def test_saved_results_are_not_used_for_a_function_with_another_captured_value(captured, tmp_path):
    for values in captured:
        end = state_at(*values)
        found = cs.sweep(family(1), np.errstate()(end), folder=tmp_path).table["end"]
        assert found == pytest.approx(end(cs.plan(family(1)[0]))["end"], abs=1e-12)
    with pytest.raises(cs.ContactSystemError, match="must recognise it later"):
        cs.sweep(family(1), state_at(0.1, lambda states: states), folder=tmp_path)


@pytest.mark.parametrize("known", [True, False])
def test_a_terminal_shows_how_many_scenes_are_done(known, monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr(Progress, "DELAY", 0.05)
    scenes = family(8)
    cs.sweep(scenes if known else iter(scenes), middle_slowly, chunk=1)
    drawn = sys.stderr.getvalue()
    assert re.search("[1-8] scenes", drawn) and ("[###" in drawn) is known


needs_kill = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL")


def spawned_processes() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, mp_context=get_context("spawn"))


@contextlib.contextmanager
def dask_workers():
    distributed = pytest.importorskip("distributed")
    cluster = distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None)
    with cluster, distributed.Client(cluster) as client:
        yield client.get_executor()


@needs_kill
@pytest.mark.parametrize("workers", [spawned_processes, dask_workers])
def test_nothing_is_lost_with_a_worker_that_is_killed(workers, tmp_path):
    scenes = family(12)
    evaluate = functools.partial(middle_after_one_kill, tmp_path / "killed")
    with workers() as pool:
        found = cs.sweep(scenes, evaluate, pool, chunk=2)
    assert (tmp_path / "killed").exists() and not found.failures
    assert found.table["scene"].tolist() == list(range(12))
    assert found.table["points"] == pytest.approx(one_by_one(scenes, "points"), abs=1e-12)


@needs_kill
def test_a_scene_that_kills_its_workers_fails_alone_and_the_next_sweep_tries_it_again(tmp_path):
    evaluate = functools.partial(middle_of_all_but_one, tmp_path / "mark")
    options = {"folder": tmp_path / "results", "chunk": 1}
    with spawned_processes() as pool:
        found = cs.sweep(family(4), evaluate, pool, **options)
    assert found.table["scene"].tolist() == [0, 2, 3]
    assert [failure.scene for failure in found.failures] == [1]
    assert re.match("BrokenProcessPool.*__main__", found.failures[0].error)
    (tmp_path / "mark").touch()
    assert len(cs.sweep(family(4), evaluate, **options).table) == 4
