"""The benchmarks' own arithmetic: what a bar, a ratio, a record and a skipped part mean."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import contact_system as cs

sys.path.append(str(Path(__file__).parents[1]))  # benchmarks run from a checkout

from benchmarks import (  # noqa: E402
    integrators,
    ours,
    peers,
    problems,
    regression,
    skip,
    speed,
    timing,
    work_precision,
)
from benchmarks.__main__ import LONG, PARTS, SHARING, main  # noqa: E402
from benchmarks.curves import Outcome, Run, time_at  # noqa: E402
from benchmarks.report import THREADS, Bar, markdown_table, quietly  # noqa: E402
from benchmarks.timing import Timing  # noqa: E402
from benchmarks.work_precision import MARKS, between_marks  # noqa: E402

PENDULUM = regression.reference_job()


def record(commit: str, ratio: float, error: float = 0.01, processor: str = "one") -> dict:
    figures = {"plan": {"ratio": ratio, "error": error, "s": 1e-3}}
    return {"version": "1", "commit": commit, "date": "", "processor": processor,
            "figures": figures}  # fmt: skip


# --- bars ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("measured", "least", "met"),
    [(1.0, False, True), (2.0, False, False), (2.0, True, True), (None, True, None),
     (math.nan, True, False), (math.nan, False, False)],
)  # fmt: skip
def test_a_bar_is_met_on_its_side_only_and_never_by_nan(measured, least, met):
    assert Bar("x", 1.5, measured, least=least).met is met


def test_a_markdown_table_has_a_rule_below_its_head():
    assert markdown_table(["a", "b"], [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |\n"


# --- regression ----------------------------------------------------------------------------------


def test_half_as_fast_as_the_best_record_is_a_clear_regression():
    history = [record("a", 1.0), record("b", 1.8)]
    found = regression.compare(history, record("c", 2.0))["plan"]
    assert found is not None and found.commit == "a"
    assert found.slower == pytest.approx(2.0)
    assert regression.LIMIT < found.surely < found.slower
    assert found.confidence > 0.99


def test_the_same_speed_is_no_regression():
    found = regression.compare([record("a", 1.0)], record("b", 1.02))["plan"]
    assert found is not None and found.surely < regression.LIMIT and found.confidence < 0.01


def test_a_slow_figure_with_a_wide_spread_is_no_clear_regression():
    found = regression.compare([record("a", 1.0)], record("b", 1.4, error=0.3))["plan"]
    assert found is not None and found.slower > regression.LIMIT > found.surely
    assert found.confidence < 0.95


def test_the_bar_and_the_confidence_agree_at_95_percent():
    found = regression.Comparison(slower=1.5, surely=regression.LIMIT, commit="a")
    assert found.confidence == pytest.approx(0.95, abs=1e-4)


def test_records_of_the_same_processor_come_first():
    history = [record("a", 1.0, processor="other"), record("b", 3.0)]
    found = regression.compare(history, record("c", 3.0))["plan"]
    assert found is not None and found.commit == "b" and found.slower == pytest.approx(1.0)
    found = regression.compare(history[:1], record("c", 3.0))["plan"]
    assert found is not None and found.commit == "a"


def test_a_figure_without_a_record_is_compared_with_nothing():
    assert regression.compare([], record("a", 1.0)) == {"plan": None}
    own = record("a", 1.0)
    assert regression.compare([own], own) == {"plan": None}


def test_a_commit_has_one_record_a_processor(tmp_path):
    path = tmp_path / "history.json"
    assert regression.read_history(path) == []
    for new in (record("a", 1.0), record("b", 2.0), record("a", 3.0, processor="other")):
        regression.keep(regression.read_history(path), new, path)
    kept = regression.keep(regression.read_history(path), record("b", 4.0), path)
    assert [(r["commit"], r["figures"]["plan"]["ratio"]) for r in kept] == [
        ("a", 1.0), ("a", 3.0), ("b", 4.0)
    ]  # fmt: skip
    assert json.loads(path.read_text()) == kept


def test_the_error_of_a_figure_is_that_of_the_median_of_normal_noise():
    random = np.random.default_rng(1)
    samples = np.exp(0.1 * random.standard_normal((2000, 15)))
    found = [regression.figure(list(row), 1.0) for row in samples]
    scatter = np.std([math.log(figure["ratio"]) for figure in found])
    assert np.mean([figure["error"] for figure in found]) == pytest.approx(scatter, rel=0.2)


def test_a_machine_that_becomes_slower_leaves_a_job_beside_itself_at_one(monkeypatch):
    seconds = itertools.count(1)
    monkeypatch.setattr(regression, "jobs", lambda: {"pendulum": PENDULUM})
    monkeypatch.setattr(regression, "sample", lambda job, count=1: 1e-3 * next(seconds))
    found = regression.measure(turns=9)["pendulum"]
    assert found["ratio"] == pytest.approx(1.0, rel=1e-14) and found["error"] < 1e-14


def test_a_slower_figure_fails_the_section(monkeypatch, tmp_path):
    monkeypatch.setattr(regression, "HISTORY", tmp_path / "history.json")
    own = record("new", 2.0)
    monkeypatch.setattr(regression, "measure", lambda turns: own["figures"])
    monkeypatch.setattr(regression, "record_of", lambda figures: own)
    monkeypatch.setattr(regression, "read_history", lambda: [record("old", 1.0)])
    monkeypatch.setattr(regression, "keep", lambda history, new: [*history, new])
    (bar,) = regression.figures(False)
    assert bar.met is False and "confidence 100%" in bar.note


# --- skip ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["K1", "K3", "C1", "C2"])
def test_everything_switched_on_is_the_same_motion_without_closed_forms(name):
    scene = cs.load_scene(name)
    plan, whole = cs.plan(scene), cs.plan(skip.switched_on(scene))
    t = np.linspace(0.0, scene.duration, 21)
    assert np.abs(plan.points(t) - whole.points(t)).max() < 1e-11
    tracks = [track for g in whole.groups for track in (*g.finger, *g.object)]
    assert not any(track.method.startswith("closed form") for track in tracks)
    assert sum(track.method.startswith("forced") for track in tracks) >= 2


def test_scenes_are_compared_without_the_kernels_that_one_of_them_may_have(monkeypatch):
    engines = []

    def plan(scene, compiled=None):
        engines.append(compiled)
        return cs.Plan(scene, 1e-12, "auto", "DOP853", compiled, 0.0, None)

    monkeypatch.setattr(skip, "SCENES", ("C1",))
    monkeypatch.setattr(skip.cs, "plan", plan)
    bars = [bar for section in (skip.planner, skip.outputs) for bar in section(False)]
    assert all(bar.holds for bar in bars) and set(engines) == {False}


def test_a_sphere_in_space_needs_no_trigonometry_and_its_chart_does():
    ambient = skip.driven_motion(cs.Sphere(0.1), True).function
    chart = skip.driven_motion(skip.as_chart(cs.Sphere(0.1)), False).function
    assert skip._operations(ambient)[1] == 0 < skip._operations(chart)[1]


def test_explain_is_true_about_what_it_skipped():
    (bar,) = skip.explained(False)
    assert bar.measured == 0, bar.detail


def test_planning_imports_no_pictures_no_drake_and_no_fmpy():
    assert skip._printed(skip.IMPORT)[2:] == []


# --- speed ---------------------------------------------------------------------------------------


def test_the_short_form_takes_a_hundred_contacts_of_every_kind_without_a_compiler(monkeypatch):
    counts = []

    def times(jobs, repeats):
        counts.append([int(name) for name in jobs if name.isdigit()])
        return dict.fromkeys(jobs, Timing(1.0, 1.0, 1.0))

    monkeypatch.setattr(speed, "interleaved", times)
    monkeypatch.setattr(speed, "engines", lambda: [False, True])
    assert len(list(speed.many(False))) == 24
    assert counts == 4 * [[1, 10, 100, 1000]] + 4 * [[1, 10, 100]]


def test_heyoka_is_tried_at_as_many_tolerances_as_we_are():
    assert set(speed.OURS[2:]) <= set(peers.HEYOKA)


@pytest.mark.parametrize("full", [False, True])
def test_cvodes_is_tried_down_to_the_rounding_unit(full):
    scene = speed._scene(speed.OBJECTS["sphere"], cs.Gain.path(1.0))
    (problem,) = (p for p in problems.problems() if p.name == "slip sphere-sphere 1e7")
    found = [*peers.cvodes_methods(scene, np.linspace(0.0, 1.0, 3)),
             *integrators.peers(problem, full)]  # fmt: skip
    finest = [min(peer.tolerances) for peer in found if peer.name.startswith("CVODES")]
    assert len(finest) == 4
    assert all(np.finfo(float).eps < tolerance < 2 * np.finfo(float).eps for tolerance in finest)


@pytest.mark.parametrize("kind", speed.OBJECTS)
@pytest.mark.parametrize(("peak", "known"), [(1e2, False), (1e5, True), (1e7, True)])
def test_what_slip_is_judged_by_agrees_with_30_digits_where_there_are_any(kind, peak, known):
    gain = cs.Gain.path(peak / speed.PROFILE(1.0) ** 2)
    check = speed._reference_check(kind, speed._scene(speed.OBJECTS[kind], gain), {})
    assert check.get("30 digits", 0.0) < 1e-14 and ("30 digits" in check) is known


@pytest.mark.parametrize(("off", "holds"), [(1e-8, False), (1e-11, True)])
def test_a_ratio_holds_only_where_the_reference_is_better_than_the_error(off, holds):
    names = ["ours no compiler 1e-09", "ours compiled 1e-09", "peer 1e-09"]
    runs = {name: (None, 1e-10, 1.0) for name in names}
    times = {name + more: Timing(1.0, 1.0, 1.0) for name in names for more in ("", speed.AGAIN)}
    bar = speed._slip_bar("slip", 1.0, 1e-9, names, times, runs, {}, {"best peer": off})
    assert bar.measured == 1.0 and bar.met is holds


# --- work-precision ------------------------------------------------------------------------------


def run(error: float, seconds: float) -> Run:
    return Run(error, error, Timing(seconds, seconds, seconds), 0.0)


def test_time_at_an_error_is_interpolated_in_logarithms():
    curve = [run(1e-4, 1e-3), run(1e-8, 1e-1), run(1e-5, 1.0)]
    assert time_at(curve, 1e-6) == pytest.approx(1e-2)
    assert time_at(curve, 1e-9) is None
    assert time_at(curve, 1e-3) == 1e-3


def test_the_readme_has_the_marks_of_its_table_and_keeps_the_rest():
    page = (Path(__file__).parents[1] / "README.md").read_text("utf-8")
    text = between_marks(page, "| new |\n")
    assert f"{MARKS[0]}\n| new |\n\n{MARKS[1]}" in text
    assert between_marks(text, page.split(MARKS[0])[1].split(MARKS[1])[0].strip("\n") + "\n")
    assert text.startswith(page.split(MARKS[0])[0]) and text.endswith(page.split(MARKS[1])[1])
    with pytest.raises(ValueError, match="lacks the lines"):
        between_marks("no marks", "")


def test_the_readme_tells_where_new_scenes_are_slower():
    own = f"ours, {ours.engine(ours.engines()[-1])}"
    curves = {own: [run(1e-13, 1e-3)], f"{own}, new scene": [run(1e-13, 4e-3)]}
    outcome = Outcome("roll", {**curves, "peer": [run(1e-13, 2e-3)]})
    about = {"date": "2000-01-01T00:00", "machine": {"processor": "one"}}
    table = work_precision.readme_table([outcome], about)
    assert "| roll | 2 x (**0.5 x**) | 2 x (**0.5 x**) | 2 x (**0.5 x**) | peer | 1e-13 |" in table
    assert "Geometric mean 2; in brackets, of scenes never planned before, 0.5." in table


def test_without_a_run_the_readme_stays_and_the_line_says_what_to_run(monkeypatch, tmp_path):
    monkeypatch.setattr(work_precision, "RESULTS", tmp_path)
    (bar,) = work_precision.readme(False)
    assert bar.met is None and "python -m benchmarks work_precision" in bar.note


def test_stored_results_come_back_as_they_were(tmp_path):
    curve = [run(1e-6, 1e-3), run(1e-13, 2e-3)]
    bar = Bar("problem, smallest error, of the size", 1e-13, 0.0,
              detail={"curves": {"peer": [work_precision._plain(r) for r in curve]}})  # fmt: skip
    path = tmp_path / "work_precision.json"
    path.write_text(json.dumps({"date": "today", "bars": [dataclasses.asdict(bar)]}))
    (outcome,), about = work_precision.stored(path)
    assert outcome == Outcome("problem", {"peer": curve})
    assert about["date"] == "today"


# --- the whole bench -----------------------------------------------------------------------------


def test_every_section_that_is_named_for_the_whole_bench_exists():
    for table in (SHARING, LONG):
        for name, chosen in table.items():
            assert name in PARTS
            text = (Path(regression.__file__).parent / f"{name}.py").read_text()
            problems = work_precision.SECTIONS if name == "work_precision" else ()
            for section in chosen or ():
                assert section in problems or f'"{section}"' in text, (name, section)


def test_what_is_only_reported_is_no_bar_that_is_met():
    bar = Bar("cost", None, 4.2, "us")
    assert bar.met is None and bar.row().split() == ["cost", "reported", "4.2", "us", "-"]


@pytest.mark.parametrize("part, others", [(["accuracy"], "; accuracy: "), ([], "\n")])
def test_a_section_that_does_not_exist_is_an_error(part, others, monkeypatch, capsys):
    for name in THREADS:
        monkeypatch.setenv(name, "1")  # as the command does, but not for the tests that follow
    with pytest.raises(SystemExit) as end:
        main([*part, "--only", "revolution s"])
    assert end.value.code == 2
    assert f"no section is called 'revolution s' or contains it{others}" in capsys.readouterr().err


def test_a_part_whose_package_is_missing_says_what_to_install(monkeypatch):
    for name in THREADS:
        monkeypatch.setenv(name, "1")
    monkeypatch.setitem(sys.modules, "benchmarks.drake_planner", None)
    with pytest.raises(SystemExit, match=r'drake_planner cannot run: .*pip install "\.\[bench\]"'):
        main(["drake_planner"])


def test_a_part_run_beside_another_gives_its_bars_and_prints_nothing(capfd):
    bars, spent = quietly("accuracy", ("revolutions",), False)
    assert bars and all(bar.met for bar in bars) and spent > 0
    assert capfd.readouterr().out == ""


def test_calls_that_compile_first_are_not_timed_one_by_one(monkeypatch):
    monkeypatch.setattr(timing, "SLOW", 0.02)
    slow, calls = iter([0.05, 0.03]), []

    def call(_):
        calls.append(time.sleep(next(slow, 0.0)))

    found = timing.interleaved({"compiles twice": timing.Job(call)}, repeats=2, burst=0.01)
    assert found["compiles twice"].median < 0.02
    assert len(calls) > 20  # several in each sample
