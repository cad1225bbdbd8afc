"""Libraries for other platforms, run here by wine and qemu, against this machine's own."""

from __future__ import annotations

import re

import pytest

import contact_system as cs

pytest.importorskip("fmpy")

from fmu_hosts.native import Fmu, Program, Unavailable, difference

from fmu_export import export_fmu


def program(fmu, target):
    try:
        return Program("trajectory", fmu, target)
    except Unavailable as error:
        pytest.skip(str(error))


@pytest.mark.slow
def test_a_windows_library_bears_the_name_of_its_file(tmp_path):
    pytest.importorskip("ziglang")
    path = export_fmu(cs.load_scene("C1"), tmp_path / "C1.fmu", platforms=("x86_64-windows",))
    fmu = Fmu.unpacked(path, tmp_path / "C1")
    assert b"\0C1.dll\0" in fmu.library("x86_64-windows").read_bytes()


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize(
    "target",
    # ziglang builds a C library for Windows when it is used first, wine a Windows
    [pytest.param("x86_64-windows", marks=pytest.mark.slow), "aarch64-linux"],
)
def test_another_platform_finds_the_same_trajectory(target, version, tmp_path):
    pytest.importorskip("ziglang")
    scene = cs.load_scene("K2")
    platforms = ("native", target)
    path = export_fmu(scene, tmp_path / "K2.fmu", version, platforms=platforms)
    fmu = Fmu.unpacked(path, tmp_path / "K2")
    asked = re.findall(rb"GLIBC_2\.(\d+)", fmu.library(target).read_bytes())
    assert all(int(minor) <= 17 for minor in asked)  # it loads where Linux is old
    arguments = ("0.01", "100", *fmu.model_arguments(fmu.outputs))
    found = program(fmu, target).table(*arguments)
    wanted = program(fmu, "native").table(*arguments)
    assert difference(fmu.outputs, found, wanted) < 1e-14
