"""Balls in Drake do what others know of them, on the plants that stations are made of."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("pydrake")
sys.path.append(str(Path(__file__).parents[1]))  # benchmarks run from a checkout

from benchmarks import drake_physics as physics  # noqa: E402


@pytest.mark.parametrize(("model", "step"), [("point", 1e-3), ("hydroelastic", 2.5e-4)])
def test_a_ball_circles_on_a_turntable_in_seven_halves_of_its_period(model, step):
    found, law, _ = physics.turntable(model, step, part=0.25)
    assert found == pytest.approx(law, rel=2e-3)
    assert law == pytest.approx(3.5, rel=1e-2)


@pytest.mark.parametrize("model", physics.MODELS)
def test_a_ball_between_plates_goes_half_as_fast(model):
    assert physics.between_plates(model, 1e-3, 0.1) == pytest.approx(0.5, abs=1e-4)


@pytest.mark.parametrize(("slope", "friction"), [(0.2, 0.5), (0.6, 0.1)])
def test_a_ball_rolls_and_slides_down_a_slope(slope, friction):
    found, law = physics.down("point", 1e-3, slope, friction)
    assert found == pytest.approx(law, rel=1e-5)


def test_hydroelastic_patches_resist_rolling_in_proportion_to_the_step():
    """Drake's own doing, and why a ball on a level plane comes to rest; points do not resist."""
    assert abs(physics.resistance("point", 1e-3)) < 1e-9
    coarse, fine = (physics.resistance("hydroelastic", h) for h in (1e-3, 5e-4))
    assert coarse / fine == pytest.approx(2.0, rel=0.05)
