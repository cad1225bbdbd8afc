"""The film of a simulation in a real browser: curves, points, forces, names, colours are there."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import re

import numpy as np
import pytest

pytest.importorskip("pydrake")
pytest.importorskip("matplotlib")
pytest.importorskip("websockets")

from matplotlib.image import imread

import contact_system as cs
from benchmarks.chromium import PROGRAM, Chromium
from contact_system.plots.style import COLOURS, DISTURBED
from drake_plant import Push, StationConfig, simulate

WIDTH, HEIGHT = 320, 280
EARLY, WHILE, AFTER = 0.05, 0.25, 0.35  # a disturbance acts from 0.1 to 0.3 s
BODIES = "drake/film/bodies"
FINGERS = [f"{BODIES}/finger {k}/finger {k}" for k in (1, 2, 3)]
THINGS = {
    "curves on the object": [f"{BODIES}/object/object/curve {i}" for i in range(3)],
    "curves on the fingers": [f"{finger}/curve" for finger in FINGERS],
    "planned curves": [f"{BODIES}/object/object/planned {i}" for i in range(3)],
    "contact points": [f"{BODIES}/object/object/point {i}" for i in range(3)],
    "contact forces": ["drake/film/forces"],
    "names": [f"{finger}/name" for finger in FINGERS],
    "the disturbance": [f"{FINGERS[0]}/disturbed"],
}
SHOOT = """(() => {
  const show = on => hidden.forEach(path => viewer.set_property(path.split("/"), "visible", on));
  const [time, hidden] = %s;
  viewer.animator.pause();
  viewer.animator.seek(time);
  show(false);
  const picture = viewer.capture_image(%d, %d);
  show(true);
  return picture;
})()"""
"""The film's picture at a time, without some things, as a data URL."""


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """The film of D1 with a disturbance from 0.1 to 0.3 s, and a push that ends before."""
    scene, path = cs.load_scene("D1"), tmp_path_factory.mktemp("film") / "film.html"
    early = dataclasses.replace(scene.disturbances[0], start=0.1, stop=0.3)
    config = StationConfig.from_scene(scene, pushes=[Push("finger 1", 0.15, 0.2, [0, 0, 1e-3])])
    simulate(scene.replace(disturbances=[early], duration=0.4), config, recording=path)
    return path


def shots(film, wanted):
    """The browser's pictures (HEIGHT, WIDTH, 3), one for each (time, paths of things to hide)."""
    with Chromium(film.as_uri()) as page:
        page.wait("window.viewer && viewer.animator.duration > 0", 60)
        for shot in wanted:
            _, data = page.run(SHOOT % (json.dumps(shot), WIDTH, HEIGHT)).split(",")
            yield imread(io.BytesIO(base64.b64decode(data)))[..., :3]
        assert not page.errors


def differing_pixels(picture, other):
    """How many pixels differ."""
    return np.count_nonzero(np.abs(picture - other).max(axis=-1) > 0.1)


def pixels_of_hue(picture, colour):
    """How many pixels have the hue of a colour, however light or dark."""
    wanted = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    tints, tint = (w - w.mean(axis=-1, keepdims=True) for w in (picture, wanted))
    strength = np.linalg.norm(tints, axis=-1)
    alike = tints @ tint > 0.95 * strength * np.linalg.norm(tint)
    return np.count_nonzero(alike & (strength > 0.15))


@pytest.mark.skipif(PROGRAM is None, reason="needs a browser: apt-get install chromium")
def test_the_film_shows_curves_points_forces_names_and_the_disturbance(film):
    curves = THINGS["curves on the object"]
    wanted = [(WHILE, []), *((WHILE, paths) for paths in THINGS.values())]
    whole, *without, after, early, bare = shots(
        film, [*wanted, (AFTER, []), (EARLY, []), (EARLY, curves)]
    )
    seen = {thing: differing_pixels(whole, other) for thing, other in zip(THINGS, without)}
    assert min(seen.values()) > 30, seen
    # early in the film curves are short
    assert 0 < differing_pixels(early, bare) < 0.5 * seen["curves on the object"]
    for colour in COLOURS[:3]:
        assert min(pixels_of_hue(whole, colour), pixels_of_hue(after, colour)) > 200, colour
    assert pixels_of_hue(whole, DISTURBED) > 1000 > 100 > pixels_of_hue(after, DISTURBED)


def test_the_films_page_has_a_legend_of_its_colours(film):
    simulate(cs.load_scene("D1"), duration=0.01, recording=(brief := film.with_name("brief.html")))
    for words in ("D1: Dynamic: three spheres", "finger 1: contact as measured", "planned"):
        assert words in film.read_text() and words in brief.read_text()
    assert "disturbed" in film.read_text() and "disturbed" not in brief.read_text()


def test_every_picture_of_a_film_shows_the_bodies_at_its_own_time(tmp_path):
    msgpack = pytest.importorskip("msgpack")
    scene, path = cs.load_scene("D1"), tmp_path / "film.html"
    config = StationConfig.from_scene(scene, contact_model="point", time_step=7e-4)
    simulate(scene, config, duration=0.2, recording=path)
    command = re.findall('base64,([^"]*)"', path.read_text())[-2]
    clips = msgpack.unpackb(base64.b64decode(command))["animations"]
    (tracks,) = (a["clip"]["tracks"] for a in clips if a["path"] == f"/{FINGERS[0]}")
    for track in tracks:  # position and orientation
        assert [key["time"] for key in track["keys"]] == list(range(13))  # 23 steps apart
