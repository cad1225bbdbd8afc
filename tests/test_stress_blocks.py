"""Stress of FMUs, slaves and Drake's schemes: a few cases of each family end as they must."""

from __future__ import annotations

import pytest

pytest.importorskip("fmpy")
pytest.importorskip("pydrake")

from benchmarks import stress_blocks, stress_drake
from benchmarks.verdicts import Meter, judged

BENCHES = (stress_blocks, stress_drake)
FAMILIES = {family.name: family for bench in BENCHES for family in bench.FAMILIES}
# Slaves in this process come third and fourth of BLOCKS; FMUs would have to be exported first.
SLAVES = [k for k, block in enumerate(stress_blocks.BLOCKS) if block.startswith("slave")]
OF_SLAVES = [family.name for family in stress_blocks.FAMILIES[:5]]


def outcomes(name, indices):
    """Verdicts of some cases that are failures, by the case's name."""
    cases = [FAMILIES[name].make(i) for i in indices]
    verdicts = {case.name: judged(case) for case in cases}
    return {k: v for k, v in verdicts.items() if v.outcome not in ("right", "refused")}


@pytest.mark.parametrize("name", OF_SLAVES)
def test_slaves_are_right_or_refuse(name):
    family, blocks = FAMILIES[name], len(stress_blocks.BLOCKS)
    count = family.count // blocks
    indices = range(1, count, max(1, count // 6))
    if name.startswith("steps"):  # random ones, the last, go on for a kilometre, which takes 5 s
        indices = range(1, 144, 60)
    assert outcomes(name, [blocks * i + SLAVES[k % 2] for k, i in enumerate(indices)]) == {}


def test_drake_schemes_are_right_within_their_order_or_refused():
    family = FAMILIES["Drake"]
    assert outcomes("Drake", range(3, family.count, 149)) == {}


def test_an_fmu_is_right_after_steps_of_all_lengths_and_after_what_it_refuses():
    blocks = len(stress_blocks.BLOCKS) * len(stress_blocks.STEPPED)
    first = len(stress_blocks.BLOCKS) * stress_blocks.STEPPED.index("hard")
    for name in OF_SLAVES:
        count = FAMILIES[name].count
        assert outcomes(name, range(first, count, blocks * max(1, count // blocks // 6))) == {}


def test_a_chart_that_runs_backwards_after_one_long_step_is_refused():
    # sigma grows five-fold in the step, so implicit Euler changes its sign; it is not too fast.
    run = ("K2", "chart", "implicit_euler", 0.1, None)
    verdict = judged(FAMILIES["Drake"].make(stress_drake.RUNS.index(run)))
    assert verdict.outcome == "refused" and "smaller steps" in verdict.message


def test_error_control_that_would_take_steps_of_a_nanosecond_to_the_end_is_refused():
    run = ("K4 with eta 1e+09", "chart", "radau1", 0.1, 1e-6)
    verdict = judged(FAMILIES["Drake"].make(stress_drake.RUNS.index(run)))
    assert verdict.outcome == "refused" and "smaller eta" in verdict.message


@pytest.mark.parametrize("index", range(0, 40, 6))
def test_derivatives_of_model_exchange_obey_the_laws_of_frames(index):
    first = 2 * stress_blocks.STEPPED.index("hard")
    case = 2 * len(stress_blocks.STEPPED) * index + first
    assert outcomes("Model Exchange", [case]) == {}


def test_a_judge_takes_what_is_no_number_for_wrong():
    meter = Meter()
    meter.see("slip", 0.5, 1.0)
    assert meter.verdict().outcome == "right"
    meter.see("twist", float("nan"), 1.0)
    assert meter.verdict().outcome == "silent"
    assert meter.verdict().message == "twist"
