"""The explorer in a real browser: sliders, goals that are clicked, pictures; and its errors."""

from __future__ import annotations

import functools
import io
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

pytest.importorskip("viser")
pytest.importorskip("matplotlib")

from matplotlib.image import imread

import contact_system as cs
from benchmarks.chromium import PROGRAM, Chromium
from contact_system import cli
from contact_system.explorer.page import Explorer
from contact_system.explorer.sliders import adjusted, sliders_of

SIZE = 800, 560
SLIDERS = "document.querySelectorAll('[role=slider]')"
CHART = "Object.values(window.__viserTestpoints?.uplots ?? {})[0]?.chart"
SLIP = f"JSON.stringify({CHART}?.data[1] ?? 0)"
SAVE = "[...document.querySelectorAll('button')].find(b => b.innerText == 'Save scene').click()"
LONG = 60  # s to wait: without a graphics card pictures take long


@pytest.mark.skipif(PROGRAM is None, reason="needs Chromium or Chrome")
def test_a_slider_plans_again_and_a_click_on_the_object_is_reached_and_saved(tmp_path):
    file = tmp_path / "new" / "explored.toml"
    # texts of scenes show as they stand, so nothing is loaded from elsewhere
    scene = cs.load_scene("K1").replace(description="2*3*4 ![](http://127.0.0.1:9/x.png)")
    explorer = Explorer(scene, file, port=0)
    threading.Thread(target=explorer.run, daemon=True).start()
    try:
        with Chromium(explorer.address, SIZE) as page:
            page.wait(f"!!({CHART})", LONG)
            page.wait(lambda: _is_body(_picture(page)).mean() > 0.04, LONG)
            assert scene.description in page.run("document.body.innerText")
            before, shown = page.run(SLIP), _picture(page)
            assert _coloured(shown, "#1f5fa8") > 30  # the curve
            slide = "new KeyboardEvent('keydown', {key: 'ArrowLeft', bubbles: true})"
            page.run(f"{SLIDERS}[1].dispatchEvent({slide})")  # the gain's, after the time's
            page.wait(lambda: page.run(SLIP) != before, LONG)
            page.click(*_middle(shown))
            page.wait(r"/^(?!.*t\^0).*to the goal/s.test(document.body.innerText)", LONG)
            page.wait(lambda: np.abs(_picture(page) - shown).max() > 0.3, LONG)
            assert _coloured(_picture(page), "#e6e680") < 500  # nothing lights up below the mouse
            page.run(SAVE)
            page.wait("document.body.innerText.includes('Wrote ')", LONG)
            assert {url.split("/")[2] for url in page.urls if url[:2] in ("ht", "ws")} == {
                explorer.address.removeprefix("http://")
            }
            assert not page.errors
    finally:
        explorer.close()
    saved = cs.load_scene(file)
    assert saved.contacts[0].legs and saved.gain.value < 100


def _picture(page):
    """The page without its panel, (height, width, 3) from 0 to 1."""
    return imread(io.BytesIO(page.picture()))[:, : SIZE[0] // 2, :3]


def _is_body(picture):
    """Where the picture is grey and not white."""
    grey = np.ptp(picture, axis=2) < 0.12
    return grey & (picture.max(axis=2) < 0.85) & (picture.min(axis=2) > 0.3)


def _coloured(picture, colour):
    """How many pixels have a colour."""
    wanted = np.array(list(bytes.fromhex(colour[1:]))) / 255
    return np.count_nonzero(np.abs(picture - wanted).max(axis=2) < 0.2)


def _middle(picture):
    """A place on the body, away from its edge: (x, y)."""
    y, x = np.nonzero(_is_body(picture))
    return float(np.median(x)), float(np.median(y))


def test_a_slider_value_without_a_valid_scene_is_refused_and_the_picture_stays(tmp_path):
    explorer = Explorer(cs.load_scene("K1"), tmp_path / "x.toml", port=0)
    try:
        shown = explorer.picture.plan
        explorer.gain.value = -1.0
        assert explorer.wake.wait(10)
        explorer.step(0.0)
        assert r"\-1\.0" in explorer.said.content and explorer.picture.plan is shown
    finally:
        explorer.close()


@pytest.mark.parametrize("name", ["K4", "R1", "D2", "H1", "bowl", "chart", "implicit", "torus"])
def test_every_slider_gives_a_scene_or_an_error_at_its_ends_and_its_value(name):
    scene = cs.load_scene(name)
    assert any(slider.folder == "profile" for slider in sliders_of(scene)) == (name not in "H1 R1")
    labels = {slider.label for slider in sliders_of(scene)}
    assert "v on the finger" in labels
    assert ("x velocity on the object" in labels) == (name in "bowl chart implicit torus")
    for slider in sliders_of(scene):
        ends = [slider.made(x) for x in (slider.low, slider.value, slider.high)]
        assert slider.low <= slider.value <= slider.high and ends[0] != ends[2], slider.label
        for made in ends:
            try:
                assert adjusted(scene, {place: made for place in slider.places}).contacts
            except cs.ContactSystemError as error:
                assert len(str(error)) > 20


def test_ctrl_c_ends_the_explorer(tmp_path):
    words = [sys.executable, "-m", "contact_system", "explore", "K1", "--port", "0"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # where a shell runs the tests in the background, Ctrl-C is ignored unless it is set anew
    default = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(words, cwd=tmp_path, preexec_fn=default, **pipes) as program:
        assert "http://127.0.0.1:" in program.stdout.readline()
        program.send_signal(signal.SIGINT)
        said = program.communicate(timeout=60)
    assert program.returncode == 130
    assert said == ("", "contact-system: interrupted\n")
    assert not list(tmp_path.iterdir())


def test_a_port_in_use_is_refused_by_number(tmp_path, capsys):
    explorer = Explorer(cs.load_scene("K1"), tmp_path / "x.toml", port=0)
    port = explorer.address.rpartition(":")[2]
    assert cli.main(["explore", "K1", "--port", port]) == 2
    explorer.close()
    assert f"port {port}" in capsys.readouterr().err
