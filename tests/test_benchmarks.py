"""The benchmarks' own arithmetic: bars, times at an error, ratios, scenes made anew."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

import contact_system as cs

pytest.importorskip("mpmath")

from benchmarks import fresh, peers, problems, work_precision  # noqa: E402
from benchmarks.__main__ import PARTS, main  # noqa: E402
from benchmarks.report import THREADS, Bar  # noqa: E402
from benchmarks.work_precision import Run, best, ratio, time_at  # noqa: E402


@pytest.fixture(autouse=True)
def one_thread(monkeypatch):
    for name in THREADS:  # the command sets them too, but would do so for all tests that follow
        monkeypatch.setenv(name, "1")


@pytest.mark.parametrize(
    ("measured", "least", "met"),
    [
        (1.0, False, True),
        (2.0, False, False),
        (2.0, True, True),
        (None, True, None),
        (math.nan, True, False),
        (math.nan, False, False),
    ],
)
def test_a_bar_is_met_below_it_or_if_it_is_a_least_above_it_and_never_by_nan(measured, least, met):
    assert Bar("x", 1.5, measured, least=least).met is met


def test_time_at_an_error_is_interpolated_in_logarithms_along_the_best_runs():
    curve = [Run(1e-4, 1e-3), Run(1e-8, 1e-1), Run(1e-5, 1.0)]
    assert best(curve) == curve[:2]
    assert time_at(curve, 1e-6) == pytest.approx(1e-2)
    assert time_at(curve, 1e-9) is None
    assert time_at(curve, 1e-3) == 1e-3


def test_a_ratio_is_to_the_fastest_peer_that_reaches_the_error():
    curves = {"ours": [Run(1e-13, 1e-3)], "a": [Run(1e-13, 4e-3)], "b": [Run(1e-7, 1e-4)]}
    found = ratio(curves, 1e-9)
    assert (found.faster, found.rival) == (pytest.approx(4.0), "a")
    assert ratio(curves, 1e-14) == "ours does not reach this error"
    del curves["a"]
    assert ratio(curves, 1e-9) == "no peer reaches this error"


@pytest.mark.parametrize("name", ["K4", "implicit"])
def test_a_scene_made_anew_shares_no_object_with_the_old_one_and_moves_almost_alike(name):
    scene = cs.load_scene(name)
    new = fresh.anew(scene)
    assert new.object is not scene.object and new.object != scene.object
    assert new.profile != scene.profile and new.contacts[0] != scene.contacts[0]
    before, after = (cs.plan(each).points(0.5 * each.duration) for each in (scene, new))
    assert before == pytest.approx(after, abs=1e-6) and not np.array_equal(before, after)


@pytest.mark.parametrize("output", ["points", "states"])
def test_plans_without_slip_are_exact(output):
    problem = problems.no_slip(output, 5)
    found = problem.points(problem.solve(1e-12, problem.make()))
    assert problem.error(found) < 1e-14


def test_every_peer_begins_at_the_reference_and_cvodes_runs_down_to_rounding():
    for problem in problems.problems():
        for peer in peers.peers(problem, full=False):
            assert list(peer.tolerances) == sorted(peer.tolerances, reverse=True)
            if peer.name.startswith("CVODES"):
                assert np.finfo(float).eps < min(peer.tolerances) < 2 * np.finfo(float).eps
        for ode in problem.forms.values():
            starts = np.stack([ode.points(start[None]) for start in ode.starts], axis=1)
            assert problem.truth[:1] == pytest.approx(starts, abs=1e-14)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["accuracy", "--only", "revolution s"], "contains it; accuracy: references, slip law"),
        (["acuracy"], f"no part is called acuracy; use {PARTS[0]}"),
    ],
)
def test_an_unknown_part_or_section_is_refused_with_those_that_exist(arguments, said, capsys):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2 and said in capsys.readouterr().err


def test_a_part_whose_package_is_missing_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "benchmarks.drake", None)
    with pytest.raises(SystemExit, match=r'drake cannot run: .*pip install -e "\.\[bench\]"'):
        main(["drake"])


def test_a_missed_bar_is_printed_and_that_of_accuracy_makes_the_exit_code_1(monkeypatch, capsys):
    monkeypatch.setattr("benchmarks.accuracy.SECTIONS", {"x": lambda full: [Bar("x", 1.0, 2.0)]})
    assert main(["accuracy"]) == 1
    assert "MISSED by 2 x" in capsys.readouterr().out
    monkeypatch.setattr(work_precision, "SECTIONS", {"x": lambda full: [Bar("x", 1.0, 2.0)]})
    assert main(["work_precision"]) == 0
