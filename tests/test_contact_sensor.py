"""Contact states from only a measured relative pose and twist, compared with plans."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import SURFACES, one_contact
from oracles.formulas import reflection, slip_of_states

import contact_system as cs
from contact_system.contact_sensor import FRAME, GAP, ON_FINGER, ON_OBJECT, SLIP, STATES, probes_of

SCENES = ("K1", "K2", "K3", "K4", "D1", "D3", "C2", "bowl", "torus", "chart", "implicit")


def assert_same_states(scene: cs.Scene, measured: np.ndarray, planned: np.ndarray) -> None:
    """Equal modulo periods and half turns of double-covered charts, (n, 9) both."""
    for contact, row, wanted in zip(scene.contacts, measured.copy(), planned):
        for k, surface in ((0, contact.finger), (4, scene.object)):
            u, v, half_turn = surface.align(*row[k : k + 2], *wanted[k : k + 2])
            row[k : k + 2] = u, v
            if half_turn:
                row[k + 2 : k + 4] *= -1
                row[8] += math.pi
        row[8] += 2 * math.pi * np.round((wanted[8] - row[8]) / (2 * math.pi))
        near = conformity(contact.finger, scene.object, wanted)
        size = max(1.0, np.abs(wanted).max(), 0.01 * near)
        assert row == pytest.approx(wanted, abs=2e-12 * size)


def conformity(finger: cs.Surface, obj: cs.Surface, row: np.ndarray) -> float:
    """Factor by which rounding of a twist grows: greatest curvature over least relative one."""
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
    plan = cs.plan(scene, 1e-14)  # measuring takes its error times the conformity, twice
    pose, twist, points = at(plan, 0.3)
    try:
        measured = cs.measured_states(scene, pose, twist, points)
    except cs.ConformalContact:  # a bump of one fits a dent of the other
        pytest.skip("the two conform")
    assert_same_states(scene, measured, plan.states([0.3])[0])


@pytest.mark.parametrize("name", ["D1", "K4", "torus"])
def test_points_a_little_off_lead_to_the_same_states(name):
    scene = cs.load_scene(name)
    plan = cs.plan(scene)
    pose, twist, points = at(plan, 0.4)
    off = points + 3e-4 * np.random.default_rng(0).normal(size=points.shape)
    exact = cs.measured_states(scene, pose, twist, points)
    assert cs.measured_states(scene, pose, twist, off) == pytest.approx(exact, abs=1e-11)


def test_contacts_are_found_below_a_thin_chart_and_far_along_a_wire():
    thin = ("a*sin(u + 1)*cos(v)", "a*sin(u + 1)*sin(v)", "c*cos(u + 1)")  # u = v = 0 is on top
    thin = cs.ParametricSurface(thin, parameters={"a": 0.1, "c": 1e-3}, size=0.1, u_range=(-1, 2))
    for obj, object_at, off in ((thin, (1.14, 0.0), 0.0), (cs.Cylinder(5e-4), (0.3, 0.0), 0.04)):
        contact = cs.Contact(cs.Sphere(0.05), object_at)
        scene = cs.Scene(object=obj, contacts=[contact], profile=cs.Profile([0.1]), duration=1.0)
        pose, twist, points = at(cs.plan(scene), 0.0)
        found = cs.measured_states(scene, pose, twist, points + [0.0, 0.0, off])
        assert found[0, 4:6] == pytest.approx(object_at, abs=1e-12)


def probed(scene, pose, twist, points):
    """Results of the probes, (n, 37)."""
    rows = []
    for probe, X_OF, V_OF, point in zip(probes_of(scene), pose, twist, points):
        probe.seen[:18] = *X_OF[:3].ravel(), *V_OF
        rows.append(probe.find(point))
    return np.array(rows)


def test_rates_hold_the_slip_measured_at_the_objects_surface():
    scene = cs.load_scene("D1")
    plan = cs.plan(scene)
    pose, twist, points = at(plan, 0.4)
    pose[:, :3, 3] *= 0.998  # pressed in by 0.28 mm
    found = probed(scene, pose, twist, points)
    assert found[:, GAP] == pytest.approx(-0.002 * 0.14, rel=1e-9)
    frame, slip = found[:, FRAME].reshape(-1, 3, 3), found[:, SLIP]
    assert slip_of_states(scene, found[None, :, STATES])[0] == pytest.approx(slip, abs=1e-14)
    arm = 0.1 * frame[:, 2] - pose[:, :3, 3]
    velocity = twist[:, 3:] + np.cross(twist[:, :3], arm)
    sliding = -np.einsum("nij,nj->ni", frame[:, :2], velocity)
    assert slip == pytest.approx(sliding, abs=1e-14)
    assert np.abs(slip).max() > 1e-3


def near(scene, pose):
    """States measured from the grid point that is nearest to the object."""
    probe = probes_of(scene)[0]
    probe.seen[:12] = pose[:3].ravel()
    found = probe.find(probe.approach())
    probe.states("near")
    return found


def test_a_contact_at_a_pole_leaves_the_others_as_precise_as_ever():
    contacts = [cs.Contact(cs.Ellipsoid(0.05, 0.04, 0.03), (1.0, 0.3))] * 2
    profile = cs.Profile([0.1])
    scene = cs.Scene(object=cs.Sphere(0.1), contacts=contacts, profile=profile, duration=1.0)
    plan = cs.plan(scene)
    pose, twist, points = at(plan, 0.3)
    pose[0], pose[0, 2, 3], points = np.eye(4), 0.13, points + 0.003
    points[0] = 0, 0, 0.1
    found = probed(scene, pose, twist, points)
    assert np.isnan(found[0, STATES]).any()
    assert found[1, STATES] == pytest.approx(plan.states(0.3)[0, 1], abs=1e-10)


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
def test_nearest_points_are_found_whatever_the_fingers_shape_and_the_size_it_is_said_to_have(
    finger, at, obj, gap
):
    surface, (u, v) = SURFACES[obj]
    scene = cs.Scene(
        object=surface,
        contacts=[cs.Contact(finger, (u, v), at, angle=0.3)],
        profile=cs.Profile([0.1]),
        duration=0.1,
    )
    pose = cs.plan(scene).pose(0.0)[0, 0].copy()
    pose[:3, 3] += gap * surface.normal(u, v)
    found = near(scene, pose)
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


FLAT = cs.Quadric(np.outer([1.2, 1.0, 1.3], [1.2, 1.0, 1.3]))  # rounding gives it curvature
BALL = cs.ParametricSurface(("sin(u)*cos(v)", "sin(u)*sin(v)", "cos(u)"))  # points at u and at -u


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


@pytest.mark.parametrize(
    ("which", "given", "words"),
    [
        (0, lambda x: x.swapaxes(1, 2), "'D1', contact 0: pose = .* give X_OF"),
        (0, np.zeros((2, 4, 4)), "has shape"),
        *((i, x, "D1.*give numbers, shape") for i, x in enumerate(("pose", 1j, {}))),
        (1, np.full((3, 6), np.nan), "twist has a NaN"),
    ],
)
def test_what_is_no_measurement_is_refused(which, given, words):
    scene = cs.load_scene("D1")
    arguments: list = list(at(cs.plan(scene), 0.5))
    arguments[which] = given(arguments[which]) if callable(given) else given
    with pytest.raises(cs.ContactSystemError, match=words):
        cs.measured_states(scene, *arguments)
    with pytest.raises(cs.SceneError, match="'D1': give a Scene"):
        cs.measured_states("D1", *arguments)  # type: ignore[arg-type]
