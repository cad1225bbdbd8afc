"""Every example of the gallery runs on its own and draws its picture."""

from __future__ import annotations

import pytest
from conftest import ROOT, run_python

NEEDS = {"as_fmu": "fmpy", "wind": "fmu_manipulation_toolbox", "pushed_in_drake": "pydrake"}


@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.stem)
def test_an_example_runs_alone_and_draws_its_picture(example, tmp_path):
    pytest.importorskip("matplotlib")
    pytest.importorskip(NEEDS.get(example.stem, "contact_system"))
    printed = run_python(example, folder=tmp_path, MPLBACKEND="Agg")
    assert (tmp_path / f"{example.stem}.png").stat().st_size > 5000
    assert (ROOT / "docs" / "gallery" / f"{example.stem}.png").stat().st_size < 150_000
    assert len(example.read_text("utf-8").splitlines()) < 60
    if example.stem == "wind":  # slip is the same in the SSP system and in the FMU container
        assert float(printed.splitlines()[-1].removesuffix(" m/s apart")) < 1e-15
