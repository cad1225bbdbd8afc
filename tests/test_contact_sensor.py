"""Contact states from only a measured relative pose and twist, compared with plans."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import SURFACES, one_contact
from oracles.formulas import reflection, slip_of_states

import contact_system as cs
from contact_system.contact_sensor import GAP, ON_FINGER, ON_OBJECT, probes_of

SCENES = ("K1", "K2", "K3", "K4", "D1", "D3", "C2", "bowl", "torus", "chart", "implicit")


def assert_same_states(scene: cs.Scene, measured: np.ndarray, planned: np.ndarray) -> None:
    """States (n, 9) are equal but for periods, and but for the cover of charts with two."""
    for contact, row, wanted in zip(scene.contacts, measured.copy(), planned):
        for k, surface in ((0, contact.finger), (4, scene.object)):
            u, v, half_turn = surface.align(*row[k : k + 2], *wanted[k : k + 2])
            row[k : k + 2] = u, v
            if half_turn:
                row[k + 2 : k + 4] *= -1
                row[8] += math.pi
        row[8] += 2 * math.pi * np.round((wanted[8] - row[8]) / (2 * math.pi))
        grows = conformity(contact.finger, scene.object, wanted)
        size = max(1.0, np.abs(wanted).max(), 0.01 * grows)
        assert row == pytest.approx(wanted, abs=2e-12 * size)


def conformity(finger: cs.Surface, obj: cs.Surface, row: np.ndarray) -> float:
    """Greatest curvature over least relative curvature, by which rounding of a twist grows."""
    turn = reflection(row[8])
    first, second = finger.curvature_form(*row[:2]), obj.curvature_form(*row[4:6])
    least = np.linalg.norm(first + turn @ second @ turn, -2)
    return max(np.abs(first).max(), np.abs(second).max()) / least


def at(plan: cs.Plan, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose, twist and contact points on the object, as a measurement would give them."""
    return plan.pose([t])[0], plan.twist([t])[0], plan.points([t])[0, :, 1]


@pytest.mark.parametrize("name", SCENES)
def test_a_plans_pose_and_twist_give_its_states_back(name):
    scene = cs.load_scene(name)
    plan = cs.plan(scene)
    for t in np.linspace(0.01, 0.99, 6) * scene.duration:  # inside and outside the windows
        measured = cs.measured_states(scene, *at(plan, t))
        assert_same_states(scene, measured, plan.states([t])[0])


@pytest.mark.parametrize("finger", ["sphere", "ellipsoid", "torus", "bumps", "rounded cube"])
@pytest.mark.parametrize("obj", SURFACES)
def test_states_of_any_two_surfaces_are_measured(obj, finger):
    scene = one_contact(obj, finger)
    plan = cs.plan(scene, 1e-14)  # errors grow by the conformity in pose and in twist
    pose, twist, points = at(plan, 0.3)
    try:
        measured = cs.measured_states(scene, pose, twist, points)
    except cs.ConformalContact:  # a bump of one fits a dent of the other
        pytest.skip("the surfaces conform")
    assert_same_states(scene, measured, plan.states([0.3])[0])


@pytest.mark.parametrize("name", ["D1", "K4", "torus"])
def test_contact_points_may_be_given_a_fraction_of_a_millimetre_off(name):
    scene = cs.load_scene(name)
    plan = cs.plan(scene)
    pose, twist, points = at(plan, 0.4)
    off = points + 3e-4 * np.random.default_rng(0).normal(size=points.shape)
    exact = cs.measured_states(scene, pose, twist, points)
    assert cs.measured_states(scene, pose, twist, off) == pytest.approx(exact, abs=1e-11)


def test_contacts_are_found_on_the_lower_side_of_a_thin_body_and_far_along_a_wire():
    thin = ("a*sin(u + 1)*cos(v)", "a*sin(u + 1)*sin(v)", "c*cos(u + 1)")  # u = v = 0 is above
    thin = cs.ParametricSurface(thin, parameters={"a": 0.1, "c": 1e-3}, size=0.1, u_range=(-1, 2))
    for obj, object_at, off in ((thin, (1.14, 0.0), 0.0), (cs.Cylinder(5e-4), (0.3, 0.0), 0.04)):
        contact = cs.Contact(cs.Sphere(0.05), object_at)
        scene = cs.Scene(object=obj, contacts=[contact], profile=cs.Profile([0.1]), duration=1.0)
        pose, twist, points = at(cs.plan(scene), 0.0)
        found = cs.measured_states(scene, pose, twist, points + [0.0, 0.0, off])
        assert found[0, 4:6] == pytest.approx(object_at, abs=1e-12)


def test_measured_slip_is_that_at_the_objects_surface_where_bodies_overlap():
    scene = cs.load_scene("D1")
    pose, twist, points = at(cs.plan(scene), 0.4)
    pose[:, :3, 3] *= 0.998  # pressed in by 0.28 mm
    measured = cs.measured_states(scene, pose, twist, points)
    frame = scene.object.frame(*measured[:, 4:6].T)
    arm = 0.1 * frame[..., 2] - pose[:, :3, 3]
    velocity = twist[:, 3:] + np.cross(twist[:, :3], arm)
    sliding = -np.einsum("nji,nj->ni", frame[..., :2], velocity)
    assert slip_of_states(scene, measured[None])[0] == pytest.approx(sliding, abs=1e-14)
    assert np.abs(sliding).max() > 1e-3


def nearest_points(scene, pose):
    """What a contact's probe finds without being told a point, as in Drake's ContactMonitor."""
    probe = probes_of(scene)[0]
    probe.seen[:12] = pose[:3].ravel()
    found = probe.find(probe.approach())
    probe.states("near")  # raises if there are none
    return found


@pytest.mark.parametrize("gap", [-1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("obj", ["sphere", "bowl", "plane", "torus", "ellipsoid", "bumps"])
@pytest.mark.parametrize(
    ("finger", "at"),
    [
        (cs.Torus(0.05, 0.02), (1.0, 0.3)),
        (cs.Ellipsoid(0.04, 0.04, 0.01), (0.4, 0.5)),
        (cs.Ellipsoid(0.1, 0.02, 0.02), (0.3, 0.5)),
        (cs.ImplicitSurface("1e200*(x**2 + y**2 + z**2 - 0.03**2)", size=0.3), (1.0, 0.5)),
    ],
    ids=["torus", "disc", "needle", "wrong size and steep"],
)
def test_nearest_points_are_found_whatever_the_fingers_shape_and_given_size(finger, at, obj, gap):
    surface, (u, v) = SURFACES[obj]
    scene = cs.Scene(
        object=surface,
        contacts=[cs.Contact(finger, (u, v), at, angle=0.3)],
        profile=cs.Profile([0.1]),
        duration=0.1,
    )
    pose = cs.plan(scene).pose(0.0)[0, 0].copy()
    pose[:3, 3] += gap * surface.normal(u, v)
    found = nearest_points(scene, pose)
    assert found[ON_FINGER] == pytest.approx(finger.point(*at), abs=1e-9)
    assert found[ON_OBJECT] == pytest.approx(surface.point(u, v), abs=1e-9)
    assert found[GAP] == pytest.approx(gap, abs=1e-9)


def test_a_contact_on_a_body_a_thousand_times_larger_is_measured():
    for k in range(10):
        contact = cs.Contact(finger=cs.Sphere(0.005), object_at=(0.9 + 0.01 * k, 0.5), angle=k)
        profile = cs.Profile([0.005])
        scene = cs.Scene(object=cs.Sphere(5), contacts=[contact], profile=profile, duration=1)
        plan = cs.plan(scene)
        measured = cs.measured_states(scene, *at(plan, 0.3))
        assert_same_states(scene, measured, plan.states(0.3)[0])


def test_measuring_at_a_pole_names_the_contact():
    scene = one_contact("sphere", "sphere")
    pose = np.eye(4)[None].copy()
    pose[0, :3, 3] = 0.0, 0.0, 0.2
    with pytest.raises(cs.ChartSingularity, match="contact 0: measured at a pole, an umbilic or"):
        cs.measured_states(scene, pose, np.zeros((1, 6)), [[0.0, 0.0, 0.1]])


FLAT = cs.Quadric(np.outer([1.2, 1.0, 1.3], [1.2, 1.0, 1.3]))  # a plane but for rounding
BALL = cs.ParametricSurface(("sin(u)*cos(v)", "sin(u)*sin(v)", "cos(u)"))  # covers it twice


@pytest.mark.parametrize(
    ("obj", "finger", "words"),
    [
        (cs.Sphere(0.1, inside=True), cs.Sphere(0.1), "contact 0: the surfaces conform"),
        (cs.Cylinder(0.1, inside=True), cs.Cylinder(0.1), "conform"),  # in one direction only
        (FLAT, cs.Plane(), "conform"),
        (BALL, cs.Sphere(0.1), "contact 0: f_u x f_v .* u_range"),
    ],
)
def test_conforming_surfaces_and_a_normal_into_the_body_are_refused(obj, finger, words):
    contact = cs.Contact(finger=finger, object_at=(1, 1))
    scene = cs.Scene(object=obj, contacts=[contact], profile=cs.Profile([0.1]), duration=1)
    with pytest.raises(cs.ContactSystemError, match=words):
        cs.measured_states(scene, *at(cs.plan(scene), 0.5))


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_whether_bodies_conform_does_not_depend_on_the_unit_of_length(unit):
    contact, profile = cs.Contact(cs.Sphere(0.1 * unit), (1, 1)), cs.Profile([0.1 * unit])
    for gap, conforms in ((1e-5, False), (1e-7, True), (0.0, True)):
        bowl = cs.Sphere(0.1 * unit * (1 + gap), inside=True)
        plan = cs.plan(cs.Scene(object=bowl, contacts=[contact], profile=profile, duration=1))
        if conforms:
            with pytest.raises(cs.ConformalContact, match="contact 0: .*change a radius"):
                cs.measured_states(plan.scene, *at(plan, 0.0))
        else:
            off = cs.measured_states(plan.scene, *at(plan, 0.0)) - plan.states(0.0)[0]
            assert np.abs(off).max() < 1e-9


@pytest.mark.parametrize(
    ("which", "given", "words"),
    [
        (0, lambda x: x.swapaxes(1, 2), "'D1', contact 0 .finger 1.: pose = .* give X_OF"),
        (0, np.zeros((2, 4, 4)), "has shape"),
        *((i, x, "D1.*give numbers, shape") for i, x in enumerate(("pose", 1j, {}))),
        (1, np.full((3, 6), np.nan), "twist has a NaN"),
    ],
)
def test_poses_twists_and_points_of_wrong_kind_are_refused(which, given, words):
    scene = cs.load_scene("D1")
    arguments: list = list(at(cs.plan(scene), 0.5))
    arguments[which] = given(arguments[which]) if callable(given) else given
    with pytest.raises(cs.ContactSystemError, match=words):
        cs.measured_states(scene, *arguments)
    with pytest.raises(cs.SceneError, match="'D1': give a Scene"):
        cs.measured_states("D1", *arguments)  # type: ignore[arg-type]
