"""The engine's library: what it needs, which vectors it takes, who compiles it."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from contact_system.engine import binding

ROOT = Path(__file__).parents[1]

PLAN = """
import sys, numpy as np, contact_system as cs
from contact_system.engine import binding
plan = cs.plan(cs.load_scene(sys.argv[1]))
t = np.linspace(plan.start, plan.end, 37)
results = [plan.points(t), plan.states(t), plan.slip(t), plan.pose(t), plan.twist(t)]
print(binding.ENGINE.variant.decode(), b"".join(np.asarray(r).tobytes() for r in results).hex())
"""


def in_a_process(program: str, *arguments: str, **environment: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env={**os.environ, **environment},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="one variant")
@pytest.mark.parametrize("scene", ["K2", "K4", "D1", "bowl", "chart", "implicit"])
def test_wider_vectors_give_the_same_to_the_last_bit(scene):
    wide, results = in_a_process(PLAN, scene, CONTACT_SYSTEM_VECTORS="").split()
    narrow, same = in_a_process(PLAN, scene, CONTACT_SYSTEM_VECTORS="baseline").split()
    avx2 = "avx2" in Path("/proc/cpuinfo").read_text() if sys.platform == "linux" else wide == "v3"
    assert (wide, narrow) == ("v3" if avx2 else "baseline", "baseline")
    assert results == same


@pytest.mark.skipif(sys.platform != "linux", reason="libraries of ELF")
def test_the_library_needs_libc_and_libm_alone():
    # the names of needed libraries stand in the table of strings
    library = Path(binding.__file__).with_name("_engine.so").read_bytes()
    for stranger in (b"libmvec", b"libgomp", b"libgcc_s", b"libstdc++", b"libpython"):
        assert stranger not in library


def test_pip_fetches_a_compiler_only_where_there_is_none(tmp_path):
    pytest.importorskip("setuptools", "77")
    asked = "import sys; sys.path.insert(0, '.'); import setup; print(setup.ZIGLANG in "
    asked += "setup.get_requires_for_build_wheel(), setup.system_compiler() == ())"
    for path in (str(tmp_path), os.environ["PATH"]):
        fetches, lacks = in_a_process(asked, PATH=path, CC="").split()[-2:]
        assert fetches == lacks
        assert path == os.environ["PATH"] or fetches == "True"
