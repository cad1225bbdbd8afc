"""The file that `export_fmu` and ``contact-system fmu`` write: contents, platforms, refusals."""

from __future__ import annotations

import argparse
import ctypes
import itertools
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from conftest import of_versions

import contact_system as cs
from contact_system.cli import file_name

fmpy = pytest.importorskip("fmpy")

from fmpy.validation import validate_fmu  # noqa: E402
from fmu_hosts.blocks import exported  # noqa: E402
from fmu_hosts.native import (  # noqa: E402
    FMI_HEADERS,
    Fmu,
    Program,
    Unavailable,
    difference,
    find_compiler,
)

from fmu_export import build, check_fmu, cli, export_fmu  # noqa: E402
from fmu_export.build import PLATFORMS  # noqa: E402
from fmu_export.export import write_fmu  # noqa: E402

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
K1, C2 = cs.load_scene("K1"), cs.load_scene("C2")
WRONG = b"""<fmiModelDescription fmiVersion="2.0" modelName="x" guid="x">
<CoSimulation modelIdentifier="x"/><ModelVariables><ScalarVariable name="a" valueReference="1"
causality="output"><Real/></ScalarVariable></ModelVariables><ModelStructure/>
</fmiModelDescription>"""
"""A description that is not valid: its output is not in its ModelStructure."""


# --- contents


@of_versions
def test_an_exported_fmu_is_valid_less_than_700_kb_and_complete(version):
    fmu = exported(cs.load_scene("K4"), version)
    assert validate_fmu(str(fmu.path)) == []
    assert fmu.path.stat().st_size < 700_000
    archive = zipfile.ZipFile(fmu.path)
    names = {*archive.namelist()}
    assert b"Permission is hereby" in archive.read("documentation/licenses/license.txt")
    wanted = {"modelDescription.xml", "documentation/index.html", "sources/buildDescription.xml"}
    assert wanted | {"resources/scene.bin"} <= names and any(n.endswith(".png") for n in names)
    assert any(n.startswith("sources/") and n.endswith(".c") for n in names)
    assert not any("Function" in n for n in names)  # the importer has FMI's headers


def test_the_same_scene_gives_the_same_bytes_of_an_fmu(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    seen: list[str] = []
    first = export_fmu(C2, tmp_path / "one.fmu", progress=seen.append).read_bytes()
    assert export_fmu(C2, tmp_path / "two.fmu", platforms=iter(["native"])).read_bytes() == first
    assert seen == ["taking the library for native", "packing"]


def sources(scene: cs.Scene, version: str) -> tuple[Path, list[str]]:
    """The folder of an FMU's sources, and their names."""
    folder = exported(scene, version).folder / "sources"
    return folder, sorted(f.name for f in folder.glob("*.c"))


@needs_compiler
def test_a_library_that_fmpy_builds_from_the_sources_gives_the_same_results(tmp_path):
    if not shutil.which("cmake"):
        pytest.skip("no cmake")
    scene = cs.load_scene("K2")
    path = export_fmu(scene, tmp_path / "K2.fmu", "3.0")
    options = {"stop_time": 1.0, "output_interval": 0.1, "output": ["contact[2].object.u"]}
    prebuilt = fmpy.simulate_fmu(str(path), **options)
    from fmpy.build import build_platform_binary

    folder = fmpy.extract(str(path), str(tmp_path / "K2"))
    build_platform_binary(folder, configuration="Debug")
    built = fmpy.simulate_fmu(folder, **options)
    for name in prebuilt.dtype.names:
        np.testing.assert_allclose(built[name], prebuilt[name], rtol=0, atol=1e-13)


@needs_compiler
@of_versions
def test_sources_of_two_models_build_without_warnings_to_one_program(version, tmp_path):
    """FMI 3.0.2, 2.2.2: functions that are linked statically begin with the model's name."""
    toolbox = pytest.importorskip("fmu_manipulation_toolbox")  # fmpy's FMI 2 headers lack prefixes
    headers = Path(toolbox.__file__).parent / "resources" / "fmi"
    flags, objects, main = ["-std=c11", "-O0", "-Wall", "-Wextra", "-Wshadow"], [], ""
    flags += ["-pedantic-errors", "-Werror", f"-I{headers}"]
    get = f"fmi{version[0]}GetVersion"
    for name in ("K3", "C2"):
        folder, files = sources(cs.load_scene(name), version)
        (own := tmp_path / name).mkdir()
        prefix = f"-DFMI3_FUNCTION_PREFIX={name}_"
        command = [*find_compiler(), *flags, prefix, "-c", *(str(folder / f) for f in files)]
        run = subprocess.run(command, cwd=own, capture_output=True, text=True)
        assert run.returncode == 0, run.stderr
        objects += map(str, own.glob("*.o"))
        main += f"const char *{name}_{get}(void);\n"
    main += f"int main(void) {{ return K3_{get}()[0] != C2_{get}()[0]; }}\n"
    (tmp_path / "main.c").write_text(main)
    program = str(tmp_path / "both")
    link = [*find_compiler(), str(tmp_path / "main.c"), *objects, "-o", program, "-lm"]
    subprocess.run(link, check=True)
    assert subprocess.run([program]).returncode == 0


@needs_compiler
def test_the_sources_refuse_a_build_without_infinities():
    folder, files = sources(K1, "2.0")  # they would run, and be wrong by 7 rad/s in K4
    command = [*find_compiler(), "-Ofast", f"-I{FMI_HEADERS}", "-fsyntax-only"]
    for file in files:  # kernel.c is the engine alone
        run = subprocess.run([*command, str(folder / file)], capture_output=True, text=True)
        assert run.returncode and "compile without -ffast-math" in run.stderr


def test_the_library_exports_only_the_standards_functions():
    library = exported(K1, "2.0").library("x86_64-linux")
    if not library.exists():
        pytest.skip("reads the symbols of a Linux library")
    table, loaded = library.read_bytes(), ctypes.CDLL(str(library))
    assert b"\0fmi2DoStep\0" in table
    for name in ("step", "start", "reset", "report", "motion_0", "contact_of"):
        assert not hasattr(loaded, name) or b"\0" + name.encode() + b"\0" not in table


# --- other platforms, run here by wine and qemu


@pytest.mark.slow  # ziglang builds a C library for each when it is used first
def test_one_fmu_can_hold_libraries_for_several_platforms(tmp_path, monkeypatch):
    pytest.importorskip("ziglang")
    quickly = "-O0", "-fno-sanitize=undefined"  # with -O0 ziglang sanitizes, if not told otherwise
    monkeypatch.setattr(build, "FLAGS", (*build.FLAGS, *quickly))
    rest = {*PLATFORMS} - {"x86_64-windows", "aarch64-linux", "wasm32"}  # other tests have these
    path = export_fmu(cs.load_scene("C1"), tmp_path / "C1.fmu", "3.0", platforms=sorted(rest))
    names = zipfile.ZipFile(path).namelist()
    for platform in rest:
        assert any(n.startswith(f"binaries/{PLATFORMS[platform].folder_3}/") for n in names)


@pytest.mark.parametrize(
    ("target", "version"),
    [pytest.param("x86_64-windows", "2.0", marks=pytest.mark.slow), ("aarch64-linux", "3.0")],
)
def test_windows_and_arm_libraries_give_the_same_trajectory(target, version, tmp_path):
    pytest.importorskip("ziglang")
    scene = cs.load_scene("K2")
    path = export_fmu(scene, tmp_path / "K2.fmu", version, platforms=("native", target))
    fmu = Fmu.unpacked(path, tmp_path / "K2")
    if "windows" in target:
        assert b"\0K2.dll\0" in fmu.library(target).read_bytes()
    asked = re.findall(rb"GLIBC_2\.(\d+)", fmu.library(target).read_bytes())
    assert all(int(minor) <= 17 for minor in asked)  # so that it loads in old systems
    arguments = ("0.01", "100", *fmu.model_arguments(fmu.outputs))
    try:
        found, wanted = (
            Program("trajectory", fmu, platform).table(*arguments)
            for platform in (target, "native")
        )
    except Unavailable as error:
        pytest.skip(str(error))
    assert difference(fmu.outputs, found, wanted) < 1e-14


def test_the_error_of_a_failed_build_quotes_the_compiler(tmp_path, monkeypatch):
    pytest.importorskip("ziglang")
    monkeypatch.setattr(build, "UNITS", (one := tmp_path / "one.c",))
    one.write_text("#error no such thing\n")
    with pytest.raises(cs.ContactSystemError, match="(?s)failed:.*no such thing"):
        build.library("x86_64-linux", "one")


# --- the command


def command(*words: str) -> int:
    parser = argparse.ArgumentParser()
    cli.register(parser.add_subparsers())
    args = parser.parse_args(["fmu", *words])
    return args.run(args)


def test_the_command_fmu_writes_a_valid_file_and_prints_what_it_holds(
    tmp_path, monkeypatch, capsys
):
    path = tmp_path / "planner.fmu"
    given = ("C2", "-o", str(path), "--fmi", "3.0", "--interfaces", "CoSimulation")
    assert command(*given) == 0
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    assert (description.fmiVersion, description.modelExchange) == ("3.0", None)
    said = " ".join(capsys.readouterr().out.split())
    assert f"wrote {path}:" in said and "kB, FMI 3.0, CoSimulation, for native;" in said
    monkeypatch.chdir(tmp_path)
    command("K1")
    assert (tmp_path / "K1.fmu").exists() and "wrote K1.fmu" in capsys.readouterr().out
    with pytest.raises(cs.ContactSystemError, match="add it to --interfaces"):
        command("K1", "--interfaces", "ModelExchange", "--check")


@pytest.mark.parametrize(
    ("name", "version"), [*zip(cs.bundled_scenes(), itertools.cycle(["2.0", "3.0"]))]
)
def test_every_scenes_fmu_agrees_with_the_reference_results_in_it(name, version, tmp_path, capsys):
    path = tmp_path / f"{name}.fmu"
    arrays = ["--arrays"] if version == "3.0" else []
    assert command(name, "-o", str(path), "--fmi", version, "--check", *arrays) == 0
    assert "of its reference results" in capsys.readouterr().out


def test_a_check_leaves_out_an_edge_at_the_end_of_the_scene_and_refuses_other_results(tmp_path):
    """An FMU gives the twist after it, a plan the one before."""
    scene = K1.replace(disturbances=[cs.ObjectRateOffset(0, 0.5, K1.duration, (0.5, 0.2))])
    path = export_fmu(scene, tmp_path / "x.fmu")
    assert check_fmu(path) < 1e-12
    with zipfile.ZipFile(path) as archive:
        files = {n: archive.read(n) for n in archive.namelist()}
    results = next(n for n in files if n.endswith("reference.csv"))
    files[results] = files[results].replace(b",0.0", b",0.1", 9)
    write_fmu(path, files)
    with pytest.raises(cs.ContactSystemError, match="off its reference results by"):
        check_fmu(path)


def test_scenes_of_any_name_have_file_names_that_every_system_allows(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = {"é" * 300: "é" * 50, "../x": "x"}
    for name, stem in names.items():
        assert file_name(K1.replace(name=name)) == stem
    cs.save_scene(K1.replace(name="é" * 300), "long.toml")
    assert command("long.toml") == 0
    assert (tmp_path / f"{'é' * 50}.fmu").exists()


def test_files_folders_interfaces_and_platforms_that_cannot_be_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    for words, said in (
        (("-o", ""), "it is a folder, a device or a pipe"),
        (("-o", str(tmp_path)), "it is a folder, a device or a pipe"),
        (("-o", "file/k1.fmu"), "name a file in a folder that you may write to"),
        (("-o", "x" * 300), "cannot be written"),
        (("--interfaces", "ModelExchange", "--measured", "pose"), "only Co-Simulation takes"),
        (("-o", "k1.fmu", "--platforms", "riscv"), "'riscv'.: give a list of one or more of .*x86"),
    ):
        with pytest.raises(cs.ContactSystemError, match=said):
            command("K1", *words)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    with pytest.raises(cs.ContactSystemError, match="neither a bundled scene nor a file"):
        command("K9")


def test_an_existing_fmu_is_replaced_only_by_a_valid_one(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1")
    path = tmp_path / "one.fmu"
    path.write_bytes(b"old")
    with pytest.raises(cs.ContactSystemError, match="one.fmu: fmpy's validation says: "):
        write_fmu(path, {"modelDescription.xml": WRONG})
    assert path.read_bytes() == b"old"
    write_fmu(path, {"first": b"1"})
    found = [(file.filename, file.date_time[0]) for file in zipfile.ZipFile(path).infolist()]
    assert (found, [*tmp_path.iterdir()]) == ([("first", 1980)], [path])  # zip knows none before


@pytest.mark.parametrize(
    ("option", "wrong", "words"),
    [
        *(("platforms", x, "give a list") for x in ((), None, "native", 3, np.array([]))),
        ("platforms", ("amiga",), "x86_64-linux"),
        *(("interfaces", x, "give a list") for x in ((), None, 3, True, ("x",), "CoSimulation")),
        ("arrays", True, "FMI 2.0 has none; choose FMI 3.0"),
        ("fmi_version", "1.0", "is unknown .*; use one of 2.0, 3.0"),
        *(("progress", x, "give a ") for x in (3, True)),
        *(("path", x, "give a path") for x in (None, K1, "\ud800")),
    ],
)
def test_options_of_the_wrong_kind_are_refused(option, wrong, words, tmp_path):
    given = {"path": tmp_path / "k1.fmu", option: wrong}
    with pytest.raises(cs.ContactSystemError, match=words):
        export_fmu(K1, given.pop("path"), **given)


def test_without_fmpy_the_import_says_what_to_install():
    code = "import sys; sys.modules['fmpy'] = None; import fmu_export"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert 'pip install "contact-system[fmu]"' in run.stderr
