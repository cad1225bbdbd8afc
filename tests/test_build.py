"""The engine's library: its sources, its vector instructions, its compiler."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from conftest import run_python

from contact_system.engine import binding
from contact_system.theory import generate

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


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="one variant")
def test_plans_are_the_same_to_the_last_bit_with_and_without_avx2():
    wide, *results = run_python("-c", PLAN, CONTACT_SYSTEM_VECTORS="").splitlines()
    narrow, *same = run_python("-c", PLAN, CONTACT_SYSTEM_VECTORS="baseline").splitlines()
    avx2 = "avx2" in Path("/proc/cpuinfo").read_text() if sys.platform == "linux" else wide == "v3"
    assert (wide, narrow) == ("v3" if avx2 else "baseline", "baseline")
    for one, other in zip(results, same, strict=True):
        assert one == other, one.split()[0]


@pytest.mark.skipif(sys.platform != "linux", reason="looks into an ELF file")
def test_the_library_needs_no_other_library_than_libc_and_libm():
    # the names of needed libraries are in the file's table of strings
    library = Path(binding.__file__).with_name("_engine.so").read_bytes()
    for stranger in (b"libmvec", b"libgomp", b"libgcc_s", b"libstdc++", b"libpython"):
        assert stranger not in library


def test_pip_fetches_ziglang_only_where_there_is_no_c_compiler(tmp_path):
    pytest.importorskip("setuptools", "77")
    asked = "import sys; sys.path.insert(0, '.'); import setup; print(setup.ZIGLANG in "
    asked += "setup.get_requires_for_build_wheel(), setup.system_compiler() == ())"
    for path in (str(tmp_path), os.environ["PATH"]):
        fetches, lacks = run_python("-c", asked, PATH=path, CC="").split()[-2:]
        assert fetches == lacks
        assert path == os.environ["PATH"] or fetches == "True"


def test_files_that_an_older_version_left_in_the_clone_get_into_no_wheel(tmp_path):
    pytest.importorskip("setuptools", "77")
    clone, root = tmp_path / "clone", Path(__file__).parents[1]
    for folder in ("contact_system", "fmu_export", "drake_plant"):
        shutil.copytree(root / folder, clone / folder, ignore=shutil.ignore_patterns("*.so"))
    for file in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(root / file, clone)
    built = f"lib.{sysconfig.get_platform()}-{sys.implementation.cache_tag}"
    old = clone / "build" / built / "contact_system/scenes/old.toml"
    old.parent.mkdir(parents=True)
    old.touch()
    build = "import os, sys; os.chdir(sys.argv[1]); sys.path.insert(0, '.'); import setup"
    run_python("-c", f"{build}; setup.build_wheel('dist')", clone, CONTACT_SYSTEM_CFLAGS="-O0")
    (wheel,) = clone.glob("dist/*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert "contact_system/scenes/K1.toml" in names
    assert "contact_system/scenes/old.toml" not in names


def test_generated_c_is_what_the_generator_makes_of_the_equations_now():
    for file, text in generate.generated().items():
        assert (generate.FOLDER / file).read_text() == text, f"{file}: {generate.__doc__}"
