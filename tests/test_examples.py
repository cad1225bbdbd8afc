"""Every example of the gallery runs on its own and draws its picture."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NEEDS = {"as_fmu": "fmpy", "wind": "fmu_manipulation_toolbox", "pushed_in_drake": "pydrake"}


@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.stem)
def test_an_example_draws_its_picture(example, tmp_path):
    pytest.importorskip("matplotlib")
    pytest.importorskip(NEEDS.get(example.stem, "contact_system"))
    paths = filter(None, (str(ROOT), os.environ.get("PYTHONPATH", "")))
    run = subprocess.run(
        [sys.executable, example],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "MPLBACKEND": "Agg"},
    )
    assert run.returncode == 0, run.stderr
    assert (tmp_path / f"{example.stem}.png").stat().st_size > 5000
    assert (ROOT / "docs" / "gallery" / f"{example.stem}.png").stat().st_size < 150_000
    assert len(example.read_text("utf-8").splitlines()) < 60
    if example.stem == "wind":  # the system and the container slip alike
        assert float(run.stdout.splitlines()[-1].removesuffix(" m/s apart")) < 1e-15
