"""``contact-system fmu``."""

from __future__ import annotations

import argparse

import pytest

import contact_system as cs

fmpy = pytest.importorskip("fmpy")

from fmpy.validation import validate_fmu  # noqa: E402

from fmu_export import cli, export_fmu  # noqa: E402


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


def test_wrong_words_are_told(tmp_path, capsys):
    with pytest.raises(SystemExit):
        command("K1", "--fmi", "1.0")
    assert "invalid choice: '1.0'" in capsys.readouterr().err
    with pytest.raises(cs.ContactSystemError, match="'riscv' is unknown; use one of native, "):
        command("K1", "-o", str(tmp_path / "k1.fmu"), "--platforms", "riscv")
    with pytest.raises(cs.ContactSystemError, match="neither a bundled scene nor a file"):
        command("K9")
