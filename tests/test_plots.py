"""Pictures: visibility and names are checked, and that files come out; what is refused."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import contact_system as cs
from contact_system import plots

FINGER = cs.Sphere(0.04)


def _scene(surface: cs.Surface, at=(0.3, 0.2), **changes) -> cs.Scene:
    contact = cs.Contact(finger=FINGER, object_at=at, object_velocity="rest")
    fields = {"profile": cs.Profile([0.1, 0.2]), "gain": cs.Gain.time(4), "duration": 1.0}
    return cs.Scene(object=surface, contacts=[contact], **{**fields, **changes})


@pytest.fixture
def pillow():
    return pytest.importorskip("PIL.Image", reason="pictures need contact-system[plot]")


def _ink(image) -> float:
    """Fraction of a picture that is not white."""
    return float((np.asarray(image.convert("L")) < 250).mean())


def test_points_behind_a_sphere_are_hidden_and_those_in_front_are_not():
    plan = cs.plan(_scene(cs.Sphere(0.1), at=(1.0, 0.2)))
    mesh = plots.mesh_of(plan, 1, [0])
    view = np.eye(3)  # the camera looks down the z axis
    x = np.random.default_rng(2).normal(size=(300, 3))
    x *= 0.1 / np.linalg.norm(x, axis=1)[:, None]
    x = x[np.abs(x[:, 2]) > 0.03]
    assert np.array_equal(plots.bodies.is_hidden(mesh, view, x), x[:, 2] < 0)


def test_a_hollow_is_seen_from_its_open_side():
    plan = cs.plan(_scene(cs.Sphere(0.2, inside=True), at=(3 * math.pi / 4, 0.0)))
    mesh = plots.mesh_of(plan, 1, [0])
    curve = plots.curves.curves_of(plan, [0], 1)
    hidden = plots.bodies.is_hidden(mesh, plots.bodies.best_view(mesh, curve), curve[0].points)
    assert not hidden.any()


SURFACES = {
    "plane": (cs.Plane(), (0.0, 0.0)),
    "ellipsoid of revolution": (cs.Ellipsoid(0.3, 0.1, 0.1), (1.0, 0.0)),
    "hyperboloid": (cs.Quadric(np.diag([100.0, 100.0, -100.0]).tolist()), (0.0, 0.0)),
    "pipe": (cs.Cylinder(0.2, inside=True), (0.0, 0.0)),
    "open implicit": (cs.ImplicitSurface("z + 3*x**2 + 3*y**2 - 0.1", size=0.1), (0.5, 0.0)),
}


@pytest.mark.parametrize("name", SURFACES)
def test_every_kind_of_surface_can_be_drawn(name, tmp_path, pillow):
    surface, at = SURFACES[name]
    plots.plot_curves(cs.plan(_scene(surface, at)), tmp_path / "x.png", dpi=30)
    with pillow.open(tmp_path / "x.png") as image:
        assert image.size == (360, 180)
        assert _ink(image) > 0.05


def test_an_open_surface_is_seen_around_a_contact_at_rest():
    plan = cs.plan(_scene(cs.Plane(), gain=cs.Gain.time(0)))  # the finger turns in place
    assert plots.mesh_of(plan, 1, [0]).size > 0.1


@pytest.mark.parametrize("name", ["K1", "D1", "C1"])
def test_slip_can_be_drawn_beside_another_law_with_a_jump_and_where_there_is_none(
    name, tmp_path, pillow
):
    scene = cs.load_scene(name)
    other = cs.plan(scene.replace(gain=cs.Gain.time(50))) if name == "K1" else None
    plots.plot_slip(cs.plan(scene), tmp_path / "x.png", other, dpi=40)
    with pillow.open(tmp_path / "x.png") as image:
        assert 0.01 < _ink(image) < 0.6


def test_without_slip_the_speed_of_each_contact_is_drawn_in_its_colour(tmp_path, pillow):
    contacts = [cs.Contact(FINGER, (1.0, v), legs=[cs.Leg(0, v, 1)]) for v in (0.1, 0.2)]
    plan = cs.plan(_scene(cs.Sphere(0.1)).replace(contacts=contacts))
    plots.plot_slip(plan, tmp_path / "x.png", dpi=60)
    with pillow.open(tmp_path / "x.png") as image:
        drawn = np.asarray(image.convert("RGB"))[:, : image.width * 7 // 10]  # not the legend
    for colour in plots.COLOURS[:2]:
        assert (drawn == list(bytes.fromhex(colour[1:]))).all(axis=2).any()


def test_names_and_descriptions_are_drawn_as_written_and_not_as_formulas(tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    words = [r"costs $\foo$ and $5", r"$\bar{x$", r"half \frac{ of $x$"]
    contact = cs.Contact(FINGER, (0.3, 0.2), name=words[1], legs=[cs.Leg(0, 0.1, 1)])
    broken = words[2].replace(" ", "\n")  # it is drawn in one line
    scene = _scene(cs.Sphere(0.1), name=words[0], description=broken).replace(contacts=[contact])
    words.append("σ of legs,   gain time, eta = 4")  # no contact follows the scene's profile
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # text as text
        plots.plot(cs.plan(scene), tmp_path / "odd.svg")
    drawn = (tmp_path / "odd.svg").read_text()
    assert [f">{word}<" in drawn for word in words] == [True] * 4


def test_curves_are_numbered_as_in_the_legend_and_coinciding_ones_have_one_label(tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    named = [cs.Contact(finger=FINGER, object_at=(1.0, 0.2), name="f12")]
    alone, both = (_scene(cs.Sphere(0.1)).replace(contacts=k * named) for k in (1, 2))
    for text, scene in {"1,2,3": cs.load_scene("K1"), "12": alone, "contact 1 (f12)": both}.items():
        with matplotlib.rc_context({"svg.fonttype": "none"}):  # text as text
            plots.plot_curves(cs.plan(scene), tmp_path / "x.svg")
        assert f">{text}<" in (tmp_path / "x.svg").read_text()


def test_the_last_line_of_the_longest_legend_is_in_the_picture(tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    start = {"legs": [cs.Leg(0, 0.1, 1)], "object_velocity": "rest"}
    contacts = [cs.Contact(FINGER, (1.0, 0.6 * k), **start) for k in range(7)]
    push = cs.ObjectRateOffset("all", 0.1, 0.2, (0.1, 0))
    scene = _scene(cs.Sphere(0.1)).replace(contacts=contacts, disturbances=[push])
    with matplotlib.rc_context({"svg.fonttype": "none"}):  # text as text
        other = cs.plan(scene.replace(gain=cs.Gain.time(9)))
        plots.plot(cs.plan(scene), tmp_path / "x.svg", other)
    (y,) = re.findall(r'y="([\d.]+)"[^>]*>the finger\'s frame', (tmp_path / "x.svg").read_text())
    assert float(y) < 430  # of 432 points


def test_a_picture_that_cannot_be_written_is_refused(tmp_path):
    pytest.importorskip("matplotlib")
    plan = cs.plan(cs.load_scene("K1"))
    with pytest.raises(cs.ContactSystemError, match="x.png' cannot be written: No such file"):
        plots.plot_slip(plan, tmp_path / "missing" / "x.png", dpi=30)
    for name in ("x.txt", "x"):
        with pytest.raises(cs.ContactSystemError, match="unknown ending .*; use .png, .pdf or"):
            plots.plot_slip(plan, tmp_path / name)
    for dpi in ("x", 0, np.nan):
        with pytest.raises(cs.ContactSystemError, match=r"dpi = .*: give a (finite )?number"):
            plots.plot_slip(plan, tmp_path / "x.png", dpi=dpi)
    assert not list(tmp_path.iterdir())
