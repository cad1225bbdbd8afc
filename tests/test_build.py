"""The engine's library: what it is made of, which vectors it takes, who compiles it."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from contact_system.engine import binding
from contact_system.theory import generate

ROOT = Path(__file__).parents[1]

PLAN = """
import contact_system as cs
from contact_system.engine import binding
print(binding.ENGINE.variant.decode())
contact = cs.Contact(cs.Sphere(0.04), (1.0, 1.0), legs=[cs.Leg(k, 0.1, 1.0) for k in range(9)])
legs = cs.Scene(name="legs", object=cs.Ellipsoid(0.3, 0.2, 0.1), contacts=[contact])
for scene in (legs, *map(cs.load_scene, ("K2", "K4", "D1", "bowl", "chart", "implicit"))):
    plan = cs.plan(scene)
    found = plan.evaluate(plan.sample_times(37), "points", "states", "slip", "pose", "twist")
    print(scene.name, *(values.tobytes().hex() for values in found.values()))
"""


def in_a_process(program: str, **environment: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **environment},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="one variant")
def test_wider_vectors_give_the_same_to_the_last_bit():
    wide, *results = in_a_process(PLAN, CONTACT_SYSTEM_VECTORS="").splitlines()
    narrow, *same = in_a_process(PLAN, CONTACT_SYSTEM_VECTORS="baseline").splitlines()
    avx2 = "avx2" in Path("/proc/cpuinfo").read_text() if sys.platform == "linux" else wide == "v3"
    assert (wide, narrow) == ("v3" if avx2 else "baseline", "baseline")
    for one, other in zip(results, same, strict=True):
        assert one == other, one.split()[0]


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


def test_generated_files_are_those_that_the_symbols_give():
    for file, text in generate.generated().items():
        assert (generate.FOLDER / file).read_text() == text, f"{file}: {generate.__doc__}"
