"""The commands run, scenes and explain, in this process."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import Terminal

import contact_system as cs
from contact_system import cli

DRAWN = ("K1", "C2")  # scenes that are run with pictures, which take long


def _run(*words: object) -> int:
    return cli.main([str(w) for w in words])


def _error(capsys, *words: object) -> str:
    """The one line on stderr of a command that must be refused."""
    assert _run(*words) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("contact-system: error: ")
    assert captured.err.count("\n") == 1
    return captured.err


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_scenes_with_names_in_any_script_run_on_terminals_of_any_encoding(
    encoding, tmp_path, monkeypatch
):
    scene = cs.load_scene("C1").replace(name="球 ü\x1b[2J")
    cs.save_scene(scene, tmp_path / "scene.toml")
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", stream)
    assert _run("run", tmp_path / "scene.toml", "--no-plots", "--out", tmp_path) == 0
    stream.flush()
    printed = stream.buffer.getvalue()
    assert printed.startswith(b"\\u7403 ") and b"\x1b" not in printed
    assert cs.load(next(tmp_path.glob("*.npz"))).scene == scene


# --- what works --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", cs.bundled_scenes())
def test_every_bundled_scene_runs_and_writes_its_files(name, tmp_path, capsys):
    if name in DRAWN:
        pytest.importorskip("matplotlib")
    assert _run("run", name, "--out", tmp_path, *[] if name in DRAWN else ["--no-plots"]) == 0
    out = capsys.readouterr().out
    expected = {".npz", ".csv"} | ({".png"} if name in DRAWN else set())
    assert {p.suffix for p in tmp_path.iterdir()} == expected
    assert all(f"wrote {tmp_path / name}{suffix}" in out for suffix in expected)
    assert not any(x in out for x in ("\n\n\n", "Note: ", "e-21"))  # in K2 nothing slips at first
    scene = cs.load_scene(name)
    assert cs.load(tmp_path / f"{name}.npz").scene == scene
    with np.load(tmp_path / f"{name}.npz") as data:
        assert all(np.isfinite(data[x]).all() for x in ("states", "slip", "pose", "twist"))
    if scene.contacts[0].follows:  # the finger's curve is a great circle to rounding
        (line,) = [x for x in out.splitlines() if "great circle's plane" in x]
        assert max(float(w) for w in line.split() if "e-" in w) < 1e-12
    if "reports" in scene.paper and not scene.contacts[0].follows:
        assert f"The paper reports: {scene.paper['reports']}." in " ".join(out.split())


def test_scenes_lists_all_with_their_descriptions(capsys):
    assert _run("scenes") == 0
    out = capsys.readouterr().out
    for name, description in cs.bundled_scenes().items():
        assert f"{name} " in out and description in out


def test_run_and_explain_number_contacts_without_names_from_0(tmp_path, capsys):
    assert _run("run", "chart", "--no-plots", "--out", tmp_path) == 0 == _run("explain", "chart")
    out = capsys.readouterr().out
    assert "\ncontact 0  " in out and "\ncontact 0:\n" in out and "contact 1" not in out


def test_run_notes_a_finger_that_is_too_large_for_its_bowl(tmp_path, capsys):
    polar = "r*sin(u)*cos(v)", "r*sin(u)*sin(v)", "r*cos(u)"  # covers the sphere twice
    small = cs.ParametricSurface(polar, parameters={"r": 0.02}, size=0.02)
    fingers = [cs.Contact(finger, object_at=(1.0, 0.5)) for finger in (cs.Sphere(0.2), small)]
    bowl = {"object": cs.Sphere(0.1, inside=True), "profile": cs.Profile([0.1]), "duration": 1.0}
    cs.save_scene(cs.Scene(contacts=fingers, name="bowl", **bowl), tmp_path / "bowl.toml")
    assert _run("run", tmp_path / "bowl.toml", "--no-plots", "--out", tmp_path) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "Note: contact 0: from t = 0 s on the bodies overlap" in out and out.count("Note: ") == 1
    assert "bodies overlap" in cs.plan(cs.load_scene(tmp_path / "bowl.toml")).explain()


def test_explain_prints_methods_and_contraction(capsys):
    assert _run("explain", "K4", "--eta", "300") == 0
    out = capsys.readouterr().out
    assert "closed form: great circle" in out and max(map(len, out.splitlines())) <= 80
    # an eta of 200 would be enough
    assert "undisturbed slip shrinks over the whole" in out.replace("\n", " ")


def test_run_of_k1_says_which_gain_law_reproduces_the_papers_recovery_time(tmp_path, capsys):
    assert _run("run", "K1", "--no-plots", "--out", tmp_path) == 0
    out = capsys.readouterr().out
    assert "Gain law 'path' with eta = 100 does not reproduce that time." in out
    assert "Gain law 'time' with eta = 100 reproduces that time." in out
    assert max(len(line) for line in out.splitlines() if not line.startswith("wrote")) <= 80
    words = ("run", "K1", "--no-plots", "--out", tmp_path, "--gain", "guaranteed", "--rho", "80")
    assert _run(*words) == 0 and "guaranteed, rho = 80" in capsys.readouterr().out
    assert cs.load(tmp_path / "K1.npz").scene.gain == cs.Gain.guaranteed(80)


def test_run_without_matplotlib_still_writes_numbers(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert _run("run", "torus", "--out", tmp_path) == 0
    assert 'pip install "contact-system[plot]"' in capsys.readouterr().out
    assert (tmp_path / "torus.csv").exists()


def test_method_chart_without_scipy_says_what_to_install(monkeypatch, capsys):
    monkeypatch.delitem(sys.modules, "contact_system.planning.chart_solution", raising=False)
    monkeypatch.setitem(sys.modules, "scipy.integrate", None)
    error = _error(capsys, "explain", "K1", "--method", "chart")
    assert 'method "chart" needs scipy: pip install scipy' in error


def test_a_sample_time_at_a_pole_is_left_out_of_the_files(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    # The first contact rolls over the pole at t = 0.7: 0.07 m on a radius of 0.1 m. The window on
    # the second contact starts at that time and so makes it a sample time.
    pole = 0.7
    rolls = cs.Contact(cs.Plane(), (0.7, 0.3), (0, 0), finger_velocity=(-1, 0))
    common = {"object": cs.Sphere(0.1), "profile": cs.Profile([0.1]), "duration": 1}
    push = cs.FingerAcceleration(contact=1, start=pole, stop=0.8, value=(0.5, 0.5))
    contacts = [rolls, cs.Contact(finger=cs.Sphere(0.04), object_at=(1.5, 1.0))]
    scene = cs.Scene(name="pole", contacts=contacts, disturbances=[push], **common)
    cs.save_scene(scene, tmp_path / "pole.toml")

    assert _run("run", tmp_path / "pole.toml", "--out", tmp_path) == 0
    out = capsys.readouterr().out
    assert f"\nleft out of the files: t = {pole!r} s; at a pole" in out
    assert "Below 5%: " in out and (tmp_path / "pole.png").exists()
    with np.load(tmp_path / "pole.npz") as data:
        times = cs.plan(scene).sample_times()
        assert np.array_equal(data["t"], times[times != pole])
        assert np.isfinite(data["states"]).all()
    cs.plan(scene).save(tmp_path / "pole.csv")
    assert len((tmp_path / "pole.csv").read_text().splitlines()) == 1 + 2 * (len(times) - 1)


# --- what does not -----------------------------------------------------------------------------


def test_mistakes_in_names_and_files_are_refused_in_one_line(tmp_path, capsys):
    assert "did you mean 'torus'" in _error(capsys, "run", "tors")
    (broken := tmp_path / "broken.toml").write_text('name = "x"\nduration = \n')
    assert "broken.toml'?)" in _error(capsys, "run", tmp_path / "broken")
    assert "line 2" in _error(capsys, "run", broken)
    error = _error(capsys, "run", "C1", "--no-plots", "--out", broken)
    assert f"no folder '{broken}': " in error and "another one with --out" in error


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--eta", "-1"], "eta = -1.0: give a finite number not below 0"),
        (["--rho", "5"], "scene 'K1': --rho 5: the gain law 'path' takes eta; give --eta"),
        (["--gain", "guaranteed", "--eta", "5"], "--eta 5: the gain law 'guaranteed' takes rho"),
        (["--tolerance", "0"], "tolerance = 0.0"),
    ],
)
def test_wrong_numbers_are_refused_in_one_line(words, said, tmp_path, capsys):
    assert said in _error(capsys, "run", "K1", "--out", tmp_path, *words)


def test_a_run_that_is_interrupted_says_so_in_one_line(monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "plan", interrupted)
    assert _run("run", "K1") == 130
    assert capsys.readouterr() == ("", "contact-system: interrupted\n")


# --- commands of other packages ----------------------------------------------------------------


def test_a_command_whose_package_cannot_be_imported_says_what_to_install(monkeypatch, capsys):
    def load():
        raise ImportError("No module named 'wings'\nand more")

    point = SimpleNamespace(name="fly", load=load)
    monkeypatch.setattr(cli, "entry_points", lambda group: [point] if group == cli.GROUP else [])
    error = _error(capsys, "fly", "--high")
    assert "'fly'" in error and "No module named 'wings'; pip install" in error
    with pytest.raises(SystemExit) as stop:
        _run("--help")
    assert stop.value.code == 0 and "unavailable" in capsys.readouterr().out


def test_version_prints_the_packages_version(capsys):
    with pytest.raises(SystemExit) as stop:
        _run("--version")
    assert stop.value.code == 0 and capsys.readouterr().out == f"{cli.PROGRAM} {cs.__version__}\n"


# --- progress ----------------------------------------------------------------------------------


def test_progress_is_drawn_on_a_terminal_only_and_only_when_it_takes_long(monkeypatch):
    terminal, pipe = Terminal(), io.StringIO()
    monkeypatch.setattr(sys, "stderr", terminal)
    with cli.Progress(2, "quick"):
        pass
    assert terminal.getvalue() == ""
    monkeypatch.setattr(cli.Progress, "DELAY", 0.0)
    for stream in (terminal, pipe):
        monkeypatch.setattr(sys, "stderr", stream)
        with cli.Progress(2, "first") as progress:
            progress.step("second")
            progress.finished.wait(0.25)
    assert pipe.getvalue() == ""
    assert "[############............] second, 0 s" in terminal.getvalue()
    assert terminal.getvalue().endswith("\r\x1b[K")  # the line is left empty


@pytest.mark.skipif(os.name == "nt", reason="Windows reports a closed pipe in other ways")
def test_a_closed_stream_is_no_error_and_the_files_are_written(tmp_path):
    reads, writes = os.pipe()
    os.close(reads)
    command = [sys.executable, "-um", *"contact_system run K1 --no-plots --out".split(), tmp_path]
    ended = subprocess.run(command, stdout=writes, stderr=subprocess.PIPE)
    os.close(writes)
    assert (ended.returncode, ended.stderr, len([*tmp_path.iterdir()])) == (0, b"", 2)
    for closed in (">&-", "2>&-"):  # nor is a stream that was never open
        shell = ["sh", "-c", f'exec "$@" {closed}', "sh", *command]
        ended = subprocess.run(shell, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        assert (ended.returncode, ended.stderr) == (0, b"")
