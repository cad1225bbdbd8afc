"""Scenes: the paper's data, canonical coordinates, files, and errors that name the mistake."""

import math
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import contact_system as cs
from contact_system import (
    Contact,
    Cylinder,
    Ellipsoid,
    FingerAcceleration,
    Gain,
    ImplicitSurface,
    ObjectAcceleration,
    ObjectRateOffset,
    ParametricSurface,
    Plane,
    Profile,
    Quadric,
    Scene,
    SceneError,
    Sphere,
    Torus,
    Turning,
    load_scene,
    save_scene,
)

pi = math.pi
FINGER = Sphere(0.04)


def small_scene(**changes) -> Scene:
    fields = {
        "object": Sphere(0.1),
        "contacts": [Contact(FINGER, (1.0, 0.5)), Contact(FINGER, (1.0, 2.5))],
        "profile": Profile([0.1, 0.2]),
        "gain": Gain.path(100),
        "duration": 2.0,
        "name": "small",
    }
    return Scene(**(fields | changes))


def read(text: str, name: str = "wrong.toml") -> Scene:
    """The scene that a file of this text and name holds."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, name).write_text(text, "utf-8")
        return load_scene(Path(folder, name))


def written(scene: Scene) -> str:
    """The text of a scene's file."""
    with tempfile.TemporaryDirectory() as folder:
        save_scene(scene, Path(folder, "scene.toml"))
        return Path(folder, "scene.toml").read_text("utf-8")


# --- bundled scenes ----------------------------------------------------------------------------


SPHERES = [(pi / 6, pi / 6), (2 * pi / 3, pi / 6), (pi / 10, pi)]
ON_ELLIPSOID = [(2 * pi / 3, pi / 2), (-2 * pi / 3, -pi / 2), (pi / 6, pi / 2)]
DYNAMIC = [(0.3886, 2.6556), (1.57, 2.0944), (1.57, 2.44 - pi)]
SLOW, MEDIUM, FAST = (0.001, 0, 0.4), (0.1, 0.2, -0.02), (1, 0.2, -0.02)
BALL, EGG, DRIFT = Sphere(0.1), Ellipsoid(0.3, 0.2, 0.1), ObjectRateOffset


def push_all(*window):
    """The same acceleration of each of three fingers."""
    return [FingerAcceleration(i, *window) for i in range(3)]


@pytest.mark.parametrize(
    "name, object_, sigma, duration, contacts, disturbances, recovery",
    [
        ("K1", BALL, SLOW, 1, SPHERES, [], 0.04),
        ("K2", BALL, SLOW, 1, SPHERES, push_all(0, 0.1, (0.1, 0)), 0.04),
        ("K3", EGG, SLOW, 1, ON_ELLIPSOID, push_all(0.1, 0.15, (-0.1, -0.1)), 0.015),
        ("K4", EGG, MEDIUM, 4, ON_ELLIPSOID, push_all(1, 2, (-0.3, -0.3)), None),
        ("D1", BALL, FAST, 4, DYNAMIC, [DRIFT(0, 2, 2.5, (0.6, 1.0))], 0.2),
        ("D2", BALL, FAST, 4, DYNAMIC, [DRIFT(0, 0.5, 2.5, (0.6, 0.1))], 0.1),
        ("D3", BALL, SLOW, 4, DYNAMIC, [DRIFT(0, 0.5, 2.5, (0.6, 0.1))], 1.0),
    ],
)
def test_a_bundled_scene_holds_the_papers_numbers(
    name, object_, sigma, duration, contacts, disturbances, recovery
):
    scene = load_scene(name)
    assert scene.object == object_ and scene.profile == Profile(sigma)
    assert (scene.gain, scene.duration) == (Gain.path(100), duration)
    assert [c.finger for c in scene.contacts] == [FINGER] * 3
    assert np.array([c.object_at for c in scene.contacts]) == pytest.approx(
        np.array(contacts), rel=1e-15
    )
    start = "rest" if name == "K1" else "rolling"
    assert {c.object_velocity for c in scene.contacts} == {start}
    assert {c.finger_velocity for c in scene.contacts} == {(2**-0.5, 2**-0.5)}
    assert list(scene.disturbances) == disturbances
    assert scene.paper.get("recovery_time") == recovery
    assert ("stiffness" in scene.drake) == name.startswith("D")


def test_in_c1_the_turning_object_makes_a_finger_of_fixed_orientation_roll_as_planned():
    scene = load_scene("C1")
    (contact,) = scene.contacts
    frame = scene.object.frame(*contact.object_at)
    normal, velocity = frame[:, 2], frame[:, :2] @ contact.object_velocity
    assert np.dot(scene.turning.axis, normal) == pytest.approx(0, abs=1e-15)
    assert np.linalg.norm(contact.object_velocity) == pytest.approx(1, rel=1e-15)
    for t in (0.0, 0.2, 0.5, 0.9, 1.0):
        # the finger's angular velocity relative to the object; rolling spheres of 0.1 and 0.04 m
        omega = -scene.turning.angular_velocity(t)
        rolled = np.cross(omega, normal) / (1 / 0.1 + 1 / 0.04)
        assert rolled == pytest.approx(scene.profile(t) * velocity, abs=1e-15)
    assert scene.turning.rotation_vector(1.0) == pytest.approx([1, 1, 1], abs=1e-14)


# --- contacts ----------------------------------------------------------------------------------


@pytest.mark.parametrize("side", ["object", "finger"])
def test_a_contact_on_the_second_cover_of_an_ellipsoid_keeps_its_motion(side):
    """(u, v) and (-u, pi - v) are one point, whose frames differ by half a turn about the normal:
    velocities, angle and disturbances are given in the other one."""
    body, at, velocity = Ellipsoid(0.3, 0.2, 0.1), f"{side}_at", f"{side}_velocity"
    fields = {"finger": FINGER, "object_at": (1.0, 0.5), "angle": 0.3, velocity: (0.6, 0.8)}
    given = Contact(**(fields | {side: body} if side == "finger" else fields) | {at: (0.4, 2.0)})
    pushes = [FingerAcceleration(0, 0, 1, (0.1, 0.2)), ObjectAcceleration(0, 0, 1, (0.1, 0.2))]
    changes = {"object": body} if side == "object" else {}
    scene = small_scene(contacts=[given], disturbances=pushes, **changes)
    (contact,) = scene.contacts
    assert getattr(contact, at) == pytest.approx((-0.4, pi - 2.0))
    assert body.point(*getattr(contact, at)) == pytest.approx(body.point(0.4, 2.0), abs=1e-16)
    before = body.frame(0.4, 2.0)[:, :2] @ getattr(given, velocity)
    after = body.frame(*getattr(contact, at))[:, :2] @ getattr(contact, velocity)
    assert after == pytest.approx(before, abs=1e-14)
    assert math.cos(contact.angle - given.angle) == pytest.approx(-1)
    assert [d.value for d in scene.disturbances] == [
        (-0.1, -0.2) if d.side == side else (0.1, 0.2) for d in pushes
    ]
    assert scene.replace(duration=3.0).contacts == scene.contacts


def test_disturbances_that_replace_keeps_beside_new_contacts_are_not_turned_again():
    given = Contact(FINGER, (1.0, 1.9))  # on the second cover
    push = ObjectAcceleration(0, 0.2, 0.5, (1.0, 0.5))
    body = Ellipsoid(0.3, 0.2, 0.1)
    scene = small_scene(object=body, contacts=[given], disturbances=[push])
    assert scene.disturbances[0].value == (-1.0, -0.5)
    assert scene.replace(contacts=[given]) == scene.replace(contacts=scene.contacts) == scene
    assert scene.replace(contacts=[given], disturbances=[push]) == scene
    assert scene.replace(contacts=[given], object=body) == scene
    ends = [cs.plan(s).points([2.0]) for s in (scene, scene.replace(contacts=[given]))]
    assert np.array_equal(*ends)


def test_a_contact_at_a_pole_is_refused_by_its_index_and_name():
    others = [Contact(FINGER, (1.0, 0.1 * k)) for k in range(7)]
    with pytest.raises(SceneError, match="scene 'small': contact 7 .thumb.: object_at"):
        small_scene(contacts=[*others, Contact(FINGER, (0.0, 1.0), name="thumb")])
    with pytest.raises(SceneError, match="contact 7: finger_at"):
        small_scene(contacts=[*others, Contact(FINGER, (1.0, 1.0), finger_at=(pi, 0))])


# --- disturbances and edges --------------------------------------------------------------------


def test_a_disturbance_of_all_is_one_for_each_contact():
    scene = small_scene(disturbances=[FingerAcceleration("all", 0, 1, (1, 2))])
    assert [d.contact for d in scene.disturbances] == [0, 1]


def test_edges_are_the_sorted_window_edges_and_the_ends_of_the_horizon_but_for_rounding():
    windows = [(0, 0.5), (0.25, 0.5), (1.0, 2.0 + 1e-13), (0.25, 0.75)]
    scene = small_scene(disturbances=[ObjectRateOffset(0, *w, (1, 0)) for w in windows])
    assert scene.edges == (0, 0.25, 0.5, 0.75, 1, 2)
    assert small_scene().edges == (0, 2)


def test_a_file_has_room_for_the_most_windows_of_a_scene():
    third = 1e-100 / 3
    windows = [ObjectAcceleration(1, third, 2 * third, (-third, -third))] * 10
    size = len(written(small_scene(disturbances=windows))) - len(written(small_scene()))
    assert cs.limits.WINDOWS / 10 * size < cs.limits.SCENE_BYTES


def test_replace_checks_the_new_scene():
    assert small_scene().replace(gain=Gain.time(3)).gain == Gain.time(3)
    with pytest.raises(SceneError, match="sigma"):
        small_scene().replace(profile=Profile([0.1, -0.2]))
    with pytest.raises(SceneError, match="did you mean 'gain'"):
        small_scene().replace(gian=Gain.time(3))


def test_scenes_are_hashable_and_compare_by_value():
    assert small_scene() == small_scene()
    assert hash(small_scene()) == hash(small_scene())
    assert small_scene() != small_scene(duration=3.0)


# --- wrong input in Python ---------------------------------------------------------------------


def scene_with(**changes):
    return lambda: small_scene(**changes)


def contact_with(**changes):
    return lambda: Contact(**({"finger": FINGER, "object_at": (1, 1)} | changes))


def scene_with_window(start, stop, contact=0):
    return lambda: small_scene(disturbances=[FingerAcceleration(contact, start, stop, (1, 0))])


FOLLOWING = Contact(FINGER, (1, 1), finger_velocity="rolling", object_velocity=(1, 0))


@pytest.mark.parametrize(
    "make, words",
    [
        (scene_with(object=0.1), ["scene 'small'", "object = 0.1", "Sphere"]),
        (scene_with(contacts=[]), ["contacts", "at least one"]),
        (scene_with(contacts=[FINGER]), ["contacts[0]", "give a Contact"]),
        (scene_with(disturbances=[(0, 0, 1, (1, 1))]), ["disturbances[0]", "or ObjectRateOffset"]),
        (scene_with(profile=[0.1]), ["profile = [0.1]", "give a Profile, such as Profile("]),
        (scene_with(duration=0), ["duration = 0.0", "above 0"]),
        (scene_with(duration="2"), ["duration = '2'", "number"]),
        (scene_with(profile=Profile([0.1, -0.1])), ["-0.1 m/s", "t = 2 s", "before t = 1 s"]),
        (scene_with(name=3), ["name = 3", "text"]),
        (scene_with(paper={"reprots": "x"}), ["paper", "'reprots'", "'reports'"]),
        (
            scene_with(paper={"recovery_time": "soon"}),
            ["recovery_time = 'soon'", "a finite number"],
        ),
        (scene_with(paper=[1]), ["paper = [1]", "table"]),
        (scene_with(drake={"mass": math.nan}), ["drake: mass", "nan"]),
        (scene_with(paper={1: 2}), ["paper = {1: 2}", "keyed by texts"]),
        (scene_with(drake={"push": [{"on": None}]}), ["drake: push[0]: on = None", "texts"]),
        (scene_with(drake={"duration": 1.0}), ["drake: key 'duration'", "above all headers"]),
        (contact_with(finger=0.04), ["finger = 0.04", "Sphere"]),
        (contact_with(object_at=1.0), ["object_at = 1.0", "two numbers"]),
        (lambda: Profile({0.1, 0.2}), ["profile = {", "list of numbers"]),
        (contact_with(finger_at=(1, math.nan)), ["finger_at[1]", "nan", "finite"]),
        (
            contact_with(object_velocity="roling"),
            ["object_velocity = 'roling'", '"rolling" or "rest"'],
        ),
        (contact_with(finger_velocity="rolling"), ['"rolling"', "object_velocity as two numbers"]),
        (scene_with_window(1, 1), ["start = 1.0, stop = 1.0", "exchange"]),
        (scene_with_window(-0.5, 1), ["disturbances[0]", "start = -0.5", "[0, 2.0] s"]),
        (scene_with_window(0, 2.0000001), ["stop = 2.0000001: the window is not inside"]),
        (scene_with_window(0, 1, contact=2), ["contact = 2", "2 contacts", "0 to 1"]),
        (scene_with_window(0, 1, contact="every"), ["contact = 'every'", '"all"']),
        (
            scene_with(
                contacts=[FOLLOWING], disturbances=[FingerAcceleration("all", 0, 1, (1, 0))]
            ),
            ["contact = 0", "imposes rolling", "leave the disturbance out"],
        ),
        (lambda: Turning((0, 0, 0), [1]), ["axis", "not all zero"]),
    ],
)
def test_a_wrong_value_is_refused_by_name_value_and_remedy(make, words):
    with pytest.raises(SceneError) as error:
        make()
    for word in words:
        assert word in str(error.value)


# --- files -------------------------------------------------------------------------------------

GOOD = """
name = "good"
duration = 2.0
profile = [0.1, "1/5"]
gain = { law = "guaranteed", rho = 5 }
[turning]
axis = [0, 0, 1]
angle = [0, "pi/2"]
[object]
surface = "ellipsoid"
a = "3/10"
b = 0.2
c = 0.1
[[contacts]]
name = "thumb"
finger = { surface = "sphere", radius = "4e-2" }
object_at = ["2*pi/3", "pi/2"]
[[contacts]]
finger = { surface = "torus", major = 0.05, minor = 0.02, inside = false }
object_at = ["-2*pi/3", "-pi/2"]
object_velocity = [0.5, "sqrt(3)/2"]
finger_velocity = "rolling"
[[disturbances]]
kind = "object rate offset"
contact = 0
start = 0.5
stop = 1
value = [0.6, 0.1]
[drake]
friction = 0.5
"""
AXES = 'ellipsoid"\na = "3/10"\nb = 0.2\nc = 0.1'


def test_numbers_in_a_file_may_be_texts_of_arithmetic():
    scene = read(GOOD + '[paper]\nrecovery_time = "1/25"\nlateral_force = 1\n')
    assert scene.paper == {"recovery_time": 0.04, "lateral_force": 1.0}
    assert scene.profile == Profile([0.1, 0.2])
    assert scene.object == Ellipsoid(0.3, 0.2, 0.1)
    assert scene.turning == Turning((0, 0, 1), (0, pi / 2))
    assert scene.contacts[0].object_at == pytest.approx((2 * pi / 3, pi / 2), rel=1e-16)
    assert scene.contacts[1].object_velocity == pytest.approx((0.5, 3**0.5 / 2), rel=1e-15)


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('name = "good"', "name = good", ["not valid TOML", "line 2", "in quotes"]),
        ("duration = 2.0", "", ["'duration' is missing"]),
        ('[0.1, "1/5"]', '[0.1, "1/0"]', ["profile[1]", "division by zero"]),
        ('[0.1, "1/5"]', '"0.1 + 0.2*t"', ["profile = '0.1 + 0.2*t'", "coefficients of sigma"]),
        ("duration = 2.0", 'duration = "2 s"', ["duration: formula '2 s'", "leave units out"]),
        ("rho = 5", 'rho = "math.pi"', ["formula 'math.pi', column 1", "write pi without"]),
        ('{ law = "guaranteed", rho = 5 }', '"time"', ["gain", "'time'", '{ law = "time", eta']),
        ('law = "guaranteed"', 'law = "garanteed"', ["gain", "'guaranteed'"]),
        ('"ellipsoid"', '"elipsoid"', ["object", "'elipsoid'", "'ellipsoid'"]),
        ("c = 0.1", "c = 0.1\ninside = 1", ["object", "inside = 1", "true or false"]),
        (AXES, 'parametric"', ["parametric", "'f' is missing"]),
        (AXES, 'parametric"\nf = ["u", "v", "sni(u)"]', ["object: ParametricSurface", "sin"]),
        (AXES, 'parametric"\nf = ["u", "v", "h"]\nparameters = 3', ["parameters", "table"]),
        ('"ellipsoid"', "3", ["object", "surface = 3"]),
        ('radius = "4e-2"', "radus = 1", ["contacts[0]", "finger", "'radus'", "'radius'"]),
        ('"2*pi/3"', '"2*pii/3"', ["contacts[0]", "object_at[0]", "pii", "pi"]),
        ('"2*pi/3"', '"2, 1"', ["formula '2, 1'", 'a list is written as ["2*pi/3", "pi/2"]']),
        ('"2*pi/3"', "120", ["contacts[0]: object_at: 120 rad", '"120*pi/180"']),
        ('"2*pi/3"', "0", ["scene 'good'", "contact 0 (thumb)", "object_at = (0.0,"]),
        ('kind = "object rate offset"', 'kind = "object rate"', ["disturbances[0]", "kind"]),
        ('[0.1, "1/5"]', "[" * 2000 + "]" * 2000, ["nested too deeply"]),
        ("friction = 0.5", "x" + ".x" * 2000 + " = 1", ["key x.x.x", "dots: 2000"]),
        ("friction = 0.5", "friction = " + 5000 * "9", ["4300 digits", "correct"]),
        ("friction = 0.5", "[[legs]]\nlength = 1", ["legs", "a table [[contacts.legs]]"]),
    ],
)
def test_a_mistake_in_a_file_is_named_by_file_key_value_and_remedy(old, new, words):
    assert old in GOOD
    with pytest.raises(SceneError) as error:
        read(GOOD.replace(old, new, 1))
    for word in ["wrong.toml", *words]:
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("limit", "lower", "old", "new"),
    [
        ("SCENE_BYTES", 1e4, "duration = 2.0", "duration = 2.0 #" + "x" * 10**4),
        ("NESTING", 3, "friction = 0.5", "a.b.c.d.e = 1"),
        ("FORMULA_LENGTH", 100, '"2*pi/3"', f'"2{" " * 199}"'),
        ("FORMULA_NESTING", 20, '"2*pi/3"', f'"{"-" * 30}2"'),
        ("COEFFICIENTS", 4, '[0.1, "1/5"]', "[0.1, 0, 0, 0, 0]"),
        ("WINDOWS", 0, "", ""),
    ],
)
def test_a_file_beyond_a_limit_is_refused_and_read_once_the_limit_is_raised(
    monkeypatch, limit, lower, old, new
):
    assert old in GOOD
    monkeypatch.setattr(cs.limits, limit, lower)
    with pytest.raises(SceneError, match=f"wrong.toml.*set contact_system.limits.{limit} higher"):
        read(GOOD.replace(old, new, 1))
    monkeypatch.setattr(cs.limits, limit, 1e7)
    read(GOOD.replace(old, new, 1))


def test_errors_clip_long_texts_and_escape_control_characters():
    for key in ("x" * 10**5, "\\u001b[2J"):
        with pytest.raises(SceneError, match="wrong.toml: key .*use one of") as error:
            read(f'"{key}" = 1\n{GOOD}')
        assert len(str(error.value)) <= cs.limits.MESSAGE and "\x1b" not in str(error.value)


@pytest.mark.skipif(sys.platform != "linux", reason="file names are texts there")
def test_a_scene_without_a_name_gets_that_of_its_file_even_if_it_is_no_utf_8(tmp_path):
    scene = read(GOOD.replace('name = "good"', ""), os.fsdecode(b"gr\xf6sser.toml"))
    save_scene(scene, tmp_path / "x.toml")
    assert load_scene(tmp_path / "x.toml") == scene and scene.name == "gr\ufffdsser"


def test_an_unknown_scene_is_refused_with_the_nearest_name():
    for name, near in {"k1": "K1", "torsu": "torus", "scenes/K1.toml": "K1"}.items():
        with pytest.raises(SceneError, match=f"did you mean '{near}'"):
            load_scene(name)


@pytest.mark.parametrize("wrong", [None, 4, ["K4"]])
def test_load_scene_refuses_what_is_no_name_and_no_path(wrong):
    with pytest.raises(SceneError, match="scene = .*: give a name or a path"):
        load_scene(wrong)
    with pytest.raises(SceneError, match="cannot be read: .*embedded null"):
        load_scene("K4\0")
    assert load_scene(b"K4") == load_scene("K4")  # type: ignore[arg-type]


def test_folders_devices_and_files_that_are_not_utf_8_are_refused(tmp_path):
    for path in (tmp_path, os.devnull):
        with pytest.raises(SceneError, match="cannot be read: it is a folder, a device"):
            load_scene(path)
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match="cannot be read: .*; give a TOML file in UTF-8"):
        load_scene(tmp_path / "x.toml")


def test_a_file_of_windows_with_byte_order_mark_and_crlf_is_read(tmp_path):
    (tmp_path / "x.toml").write_text(GOOD.replace("good", "größer"), "utf-8-sig", newline="\r\n")
    assert load_scene(tmp_path / "x.toml") == read(GOOD.replace("good", "größer"))


CHART = {"f": ("r*cos(u)", "r*sin(u)", "v"), "parameters": {"r": 1 / 3}}
number, KEYS = st.floats(-10, 10), st.text().filter(lambda key: key not in vars(small_scene()))
SURFACES = [
    Plane(),
    Cylinder(0.1),
    Torus(0.2, 0.1, inside=True),
    Ellipsoid(0.3, 0.2, 0.1),
    Quadric(((30, 1, 0), (1, 20, 0), (0, 0, -10)), inside=True),
    Quadric(np.diag([4.0, -2.0, -3.0]), sheet=np.int64(-1)),
    Quadric(((-3, 0, 0), (0, -2, 0), (0, 0, 4)), sheet=-1.0),
    ParametricSurface(**CHART, u_period=2 * pi, u_range=(20, 27)),
    ImplicitSurface("x**2 + y**4 + z**2 - r**2", parameters={"r": 1 / 7}, size=1 / 9),
]


@settings(max_examples=15, deadline=None)
@given(
    st.sampled_from(SURFACES),
    st.text(min_size=1),
    st.tuples(number, number),
    st.floats(0, 1e300),
    st.dictionaries(KEYS, st.one_of(st.text(), number, st.lists(number), st.booleans())),
)
def test_every_float_and_every_text_is_the_same_after_saving(surface, text, velocity, eta, table):
    scene = small_scene(
        contacts=[Contact(surface, (1.1, 1 / 3), (0.3, 0.7), 99.9, velocity, velocity, text)],
        gain=Gain.time(min(eta, 1e99)),
        name=text,
        description=text,
        disturbances=[ObjectAcceleration(0, 0.1, 1 / 3, velocity)],
        turning=Turning((1 / 3, 0, 1), (*velocity, 0)),
        chosen=["contacts.angle", "drake"],
        paper={"reports": text, "recovery_time": 0.1},
        drake={**table, "nested": {"list": [1, 2.5, {"deep": True}]}},
    )
    assert read(written(scene)) == scene


def test_a_contact_where_a_formula_gives_no_point_is_refused():
    horn = ParametricSurface(["u", "v", "log(u - 1)"])  # below u = 1 only its derivatives are real
    assert small_scene(object=horn, contacts=[Contact(FINGER, (1.5, 0))]).contacts
    with pytest.raises(SceneError, match=r"contact 0: object_at = .*no point at \(u, v\)"):
        small_scene(object=horn, contacts=[Contact(FINGER, (0.5, 0))])


class Ball(Sphere):
    """A user's own kind of surface."""


def test_a_surface_that_a_file_cannot_hold_is_named():
    scene = small_scene(object=ParametricSurface(lambda u, v: (u, v, 0.01 * u * v)))
    with pytest.raises(SceneError, match="scene 'small': object: f is a Python function"):
        written(scene)
    scene = small_scene(contacts=[Contact(ImplicitSurface(lambda x: x.T @ x - 1), (1, 1))])
    with pytest.raises(SceneError, match=r"contacts\[0\]: finger: F is a Python function"):
        written(scene)
    with pytest.raises(SceneError, match=r"object = Ball\(0.1\): a file holds no Ball; .* sphere,"):
        written(small_scene(object=Ball(0.1)))
