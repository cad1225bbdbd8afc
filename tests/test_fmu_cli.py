"""``contact-system fmu``."""

from __future__ import annotations

import argparse
import os
import zipfile

import numpy as np
import pytest

import contact_system as cs
from contact_system.cli import file_name

fmpy = pytest.importorskip("fmpy")

from fmpy.validation import validate_fmu  # noqa: E402

from fmu_export import cli, export_fmu, write_description  # noqa: E402
from fmu_export.build import write_fmu  # noqa: E402

WRONG = b"""<fmiModelDescription fmiVersion="2.0" modelName="x" guid="x">
<CoSimulation modelIdentifier="x"/><ModelVariables><ScalarVariable name="a" valueReference="1"
causality="output"><Real/></ScalarVariable></ModelVariables><ModelStructure/>
</fmiModelDescription>"""
"""An output that the structure does not list."""


def command(*words: str) -> int:
    parser = argparse.ArgumentParser()
    cli.register(parser.add_subparsers())
    args = parser.parse_args(["fmu", *words])
    return args.run(args)


def test_command_writes_a_valid_fmu_and_says_so(tmp_path, capsys):
    path = tmp_path / "planner.fmu"
    given = ("C2", "-o", str(path), "--fmi", "3.0", "--interfaces", "CoSimulation")
    assert command(*given) == 0
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    assert (description.fmiVersion, description.modelExchange) == ("3.0", None)
    said = " ".join(capsys.readouterr().out.split())
    assert f"wrote {path}:" in said and "kB, FMI 3.0, CoSimulation, for native;" in said


def test_progress_names_what_is_begun(tmp_path):
    seen: list[str] = []
    export_fmu(cs.load_scene("K1"), tmp_path / "k1.fmu", progress=seen.append)
    assert seen == ["compiling for native", "packing"]


def test_file_is_named_after_the_scene(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    command("K1")
    assert (tmp_path / "K1.fmu").exists() and "wrote K1.fmu" in capsys.readouterr().out


def test_the_file_of_any_name_can_be_written_on_any_system(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = {"é" * 300: "é" * 50, "aux": "scene-aux", "LPT1.a": "scene-LPT1.a", "../x": "x"}
    for name, stem in names.items():
        assert file_name(cs.load_scene("K1").replace(name=name)) == stem
    cs.save_scene(cs.load_scene("K1").replace(name="é" * 300), "long.toml")
    assert command("long.toml") == 0
    assert (tmp_path / f"{'é' * 50}.fmu").exists()


def test_what_cannot_be_written_to_is_told_before_anything_is_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    for out in ("", str(tmp_path)):
        with pytest.raises(cs.ContactSystemError, match="is a folder; name the file to write in"):
            command("K1", "-o", out)
    with pytest.raises(cs.ContactSystemError, match="no file can be written to"):
        command("K1", "-o", "file/k1.fmu")
    with pytest.raises(cs.ContactSystemError, match="no file can be written to"):
        command("K1", "-o", "x" * 300)
    with pytest.raises(cs.ContactSystemError, match="each once"):
        command("K1", "--interfaces", "CoSimulation", "CoSimulation")
    scene = cs.load_scene("K1")
    for given in (None, scene):  # in the place of each other, too
        with pytest.raises(cs.ContactSystemError, match="path = .*: give a path"):
            export_fmu(scene, given)
    with pytest.raises(cs.ContactSystemError, match="folder = 3: give a path"):
        write_description(scene, 3)
    with pytest.raises(cs.ContactSystemError, match="modelDescription.xml' cannot be written: "):
        write_description(scene, "file")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a pipe that is a file")
def test_a_device_or_a_pipe_is_not_replaced_by_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # as /dev/null, which root can replace
    with pytest.raises(cs.ContactSystemError, match="pipe' is a device or a pipe, which a file"):
        command("K1", "-o", str(tmp_path / "pipe"))
    assert (tmp_path / "pipe").is_fifo()


def test_a_file_is_written_where_a_link_leads(tmp_path):
    real, link = tmp_path / "there" / "real.fmu", tmp_path / "link.fmu"
    real.parent.mkdir()
    real.write_bytes(b"old")
    try:
        link.symlink_to(real)
    except OSError as error:  # Windows wants a privilege
        pytest.skip(str(error))
    write_fmu(link, {"new": b"1"}, (2026, 1, 1, 0, 0, 0))
    assert link.is_symlink() and zipfile.ZipFile(real).namelist() == ["new"]


def test_a_wrong_file_replaces_nothing_and_leaves_nothing_behind(tmp_path):
    path, moment = tmp_path / "good.fmu", (1970, 1, 1, 0, 0, 0)
    path.write_bytes(b"good")
    with pytest.raises(cs.ContactSystemError, match="good.fmu: fmpy's validation says: "):
        write_fmu(path, {"modelDescription.xml": WRONG}, moment, validate_fmu)
    assert path.read_bytes() == b"good"
    write_fmu(path, {"modelDescription.xml": WRONG}, moment)  # before 1980: zip's first year
    assert zipfile.ZipFile(path).infolist()[0].date_time == (1980, 1, 1, 0, 0, 0)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("wrong", [(), None, "native", 3, np.array([])])
def test_platforms_are_a_list(wrong, tmp_path):
    with pytest.raises(cs.ContactSystemError, match="platforms = .*: give a list"):
        export_fmu(cs.load_scene("K1"), tmp_path / "k1.fmu", platforms=wrong)


@pytest.mark.parametrize("option", ["interfaces", "progress"])
@pytest.mark.parametrize("wrong", [3, True])
def test_other_options_of_the_wrong_kind_are_refused(option, wrong, tmp_path):
    with pytest.raises(cs.ContactSystemError, match=f"{option} = {wrong}: give a "):
        export_fmu(cs.load_scene("K1"), tmp_path / "k1.fmu", **{option: wrong})


def test_wrong_words_are_told(tmp_path, capsys):
    with pytest.raises(SystemExit):
        command("K1", "--fmi", "1.0")
    assert "invalid choice: '1.0'" in capsys.readouterr().err
    with pytest.raises(cs.ContactSystemError, match="'riscv' is unknown; use one of native, "):
        command("K1", "-o", str(tmp_path / "k1.fmu"), "--platforms", "riscv")
    with pytest.raises(cs.ContactSystemError, match="neither a bundled scene nor a file"):
        command("K9")
