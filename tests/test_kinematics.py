"""Pose, twist and acceleration of plans; Montana's equations both ways (theory section 8)."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import SURFACES, derivative, one_contact
from oracles.formulas import path_velocities, reflection, slip_of_states

import contact_system as cs
from contact_system import ConformalContact

T = np.linspace(0.05, 0.95, 13)
PAIRS = [(name, "sphere") for name in SURFACES] + [("sphere", name) for name in SURFACES]
PAIRS += [("ellipsoid", "torus"), ("bumps", "rounded cube"), ("one sheet", "bumps")]
_ALL = (
    cs.FingerAcceleration(0, 0.0, 1.0, (0.3, -0.2)),
    cs.ObjectAcceleration(0, 0.0, 1.0, (0.2, 0.1)),
    cs.ObjectRateOffset(0, 0.0, 1.0, (0.3, -0.2)),
)
WINDOWS = {"none": (), "all at once": _ALL} | {d.kind: (d,) for d in _ALL}


def angular(rate: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """omega of R' R^T: (n, 3, 3), (n, 3, 3) -> (n, 3)."""
    w = rate @ turn.swapaxes(1, 2)
    assert w == pytest.approx(-w.swapaxes(1, 2), abs=1e-7 * np.abs(w).max())
    return np.stack([w[:, 2, 1], w[:, 0, 2], w[:, 1, 0]], axis=1)


def assert_twist_is_the_derivative_of_the_pose(plan: cs.Plan, times: np.ndarray) -> None:
    for i in range(len(plan.scene.contacts)):
        rate = derivative(lambda t: plan.pose(t)[:, i], times)  # noqa: B023
        twist = plan.twist(times)[:, i]
        parts = (angular(rate[:, :3, :3], plan.pose(times)[:, i, :3, :3]), rate[:, :3, 3])
        for given, expected in zip((twist[:, :3], twist[:, 3:]), parts):
            assert given == pytest.approx(expected, abs=1e-10 * np.abs(expected).max() + 1e-12)


# --- pose and twist of plans


@pytest.mark.parametrize("obj, finger", PAIRS)
def test_pose_is_a_rigid_transform_that_brings_the_contacts_together(obj, finger):
    plan = cs.plan(one_contact(obj, finger))
    pose, points, states = plan.pose(T)[:, 0], plan.points(T)[:, 0], plan.states(T)[:, 0]
    turn = pose[:, :3, :3]
    identity = np.broadcast_to(np.eye(3), turn.shape)
    assert turn @ turn.swapaxes(1, 2) == pytest.approx(identity, abs=1e-14)
    assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-14)
    assert pose[:, 3] == pytest.approx(np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(T), 4)), abs=0)
    moved = np.einsum("nij,nj->ni", turn, points[:, 0]) + pose[:, :3, 3]
    assert moved == pytest.approx(points[:, 1], abs=1e-15)
    # R_21 = E2 diag3(R_psi, -1) E1^T (theory section 8), from states alone: normals oppose
    e1 = SURFACES[finger][0].frame(*states[:, 0:2].T)
    e2 = SURFACES[obj][0].frame(*states[:, 4:6].T)
    middle = np.zeros((len(T), 3, 3))
    middle[:, :2, :2], middle[:, 2, 2] = reflection(states[:, 8]), -1.0
    assert turn == pytest.approx(e2 @ middle @ e1.swapaxes(1, 2), abs=2e-13)


@pytest.mark.parametrize("obj, finger", PAIRS)
def test_twist_is_the_derivative_of_the_pose(obj, finger):
    assert_twist_is_the_derivative_of_the_pose(cs.plan(one_contact(obj, finger)), T)


@pytest.mark.parametrize("window", [w for w in WINDOWS if w != "none"])
@pytest.mark.parametrize(
    "obj", ["sphere", "cylinder", "ellipsoid", "torus", "bumps", "rounded cube"]
)
def test_twist_is_the_derivative_of_the_pose_under_a_disturbance(obj, window):
    # profile away from zero: accelerations act on dq/ds as d / sigma^2
    scene = one_contact(obj, disturbances=WINDOWS[window], profile=(0.2, 0.1))
    assert_twist_is_the_derivative_of_the_pose(cs.plan(scene), T)


@pytest.mark.parametrize("name", ["K1", "K2", "K3", "K4", "D1", "D3", "C1", "C2", "bowl", "chart"])
def test_twist_is_the_derivative_of_the_pose_in_bundled_scenes(name):
    scene = cs.load_scene(name)
    plan = cs.plan(scene)
    times = np.linspace(0.02, 0.98, 12) * scene.duration
    times = times[np.abs(times[:, None] - scene.edges).min(1) > 5e-3]
    assert_twist_is_the_derivative_of_the_pose(plan, times)


@pytest.mark.parametrize("window", ["none", "object acceleration", "object rate offset"])
@pytest.mark.parametrize("obj, finger", [("ellipsoid", "torus"), ("sphere", "bumps")])
def test_montanas_inverse_gives_the_plans_twist(obj, finger, window):
    scene = one_contact(obj, finger, disturbances=WINDOWS[window], profile=(0.2, 0.1))
    plan = cs.plan(scene)
    states, turn = plan.states(T), plan.pose(T)[:, 0, :3, :3]
    a1, a2 = path_velocities(scene, states)
    s, tip, body = states[:, 0], SURFACES[finger][0], SURFACES[obj][0]
    k1, k2 = tip.curvature_form(*s[:, 0:2].T), body.curvature_form(*s[:, 4:6].T)
    bend = np.einsum("nij,nj->ni", k1, a1[:, 0])
    bend += np.einsum("nij,njk,nk->ni", reflection(s[:, 8]), k2, a2[:, 0])
    omega = np.stack([bend[:, 1], -bend[:, 0]], axis=1)  # in E1
    e1, e2 = tip.frame(*s[:, 0:2].T), body.frame(*s[:, 4:6].T)
    omega = np.einsum("nij,njk,nk->ni", turn, e1[..., :2], omega)
    v_rel = np.einsum("nij,nj->ni", e2[..., :2], slip_of_states(scene, states)[:, 0])
    arm = plan.points(T)[:, 0, 1] - plan.pose(T)[:, 0, :3, 3]
    twist = np.hstack([omega, -v_rel - np.cross(omega, arm)])
    assert plan.twist(T)[:, 0] == pytest.approx(twist, abs=1e-12 * np.abs(twist).max())


# --- conforming bodies


def measured(finger: cs.Surface, obj: cs.Surface) -> np.ndarray:
    """Montana's equations the other way: rates from the twist at the start."""
    size = finger.radius
    contact = cs.Contact(finger=finger, object_at=(1, 1))
    profile = cs.Profile([size])
    scene = cs.Scene(object=obj, contacts=[contact], profile=profile, duration=1)
    plan = cs.plan(scene)
    motion = plan.pose(0.0)[0], plan.twist(0.0)[0], plan.points(0.0)[0, :, 1]
    return cs.measured_states(scene, *motion) - plan.states(0.0)[0]


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_whether_bodies_conform_does_not_depend_on_the_unit_of_length(unit):
    ball = cs.Sphere(0.1 * unit)
    for gap, conforms in ((1e-5, False), (1e-7, True), (0.0, True)):
        bowl = cs.Sphere(0.1 * unit * (1 + gap), inside=True)
        if conforms:
            with pytest.raises(ConformalContact, match="contact 0: .*change a radius"):
                measured(ball, bowl)
        else:
            assert np.abs(measured(ball, bowl)).max() < 1e-9


# --- relative acceleration


@pytest.mark.parametrize("gain", [cs.Gain.path(20.0), cs.Gain.time(3.0), cs.Gain.guaranteed(1.0)])
@pytest.mark.parametrize("obj", SURFACES)
def test_acceleration_is_the_covariant_derivative_of_slip(obj, gain):
    # In E2, which turns against the parallel frame: Dv/dt = v' + theta2-turning, theta2' = -T2 a2.
    profile = (0.3, -0.1)  # sigma has no extremum: lam is smooth for each law
    scene = one_contact(obj, gain=gain, profile=profile)
    assert_acceleration_is_the_covariant_derivative(cs.plan(scene), T)


@pytest.mark.parametrize("window", ["finger acceleration", "object acceleration"])
@pytest.mark.parametrize("obj", ["plane", "sphere", "ellipsoid", "torus", "bumps", "rounded cube"])
def test_acceleration_contains_the_disturbing_accelerations(obj, window):
    scene = one_contact(obj, disturbances=WINDOWS[window], profile=(0.2, 0.1))
    assert_acceleration_is_the_covariant_derivative(cs.plan(scene), T)


def assert_acceleration_is_the_covariant_derivative(plan: cs.Plan, times: np.ndarray) -> None:
    scene, states = plan.scene, plan.states(times)
    slip = plan.slip(times)[:, 0]
    rate = derivative(lambda t: plan.slip(t)[:, 0], times)
    _, a2 = path_velocities(scene, states)
    torsion = scene.object.torsion_form(*states[:, 0, 4:6].T).reshape(-1, 2)
    turning = (torsion * a2[:, 0]).sum(1)
    quarter = np.stack([-slip[:, 1], slip[:, 0]], axis=1)
    expected = rate + turning[:, None] * quarter
    assert plan.acceleration(times)[:, 0] == pytest.approx(expected, abs=1e-9)


def test_acceleration_is_zero_while_rolling():
    plan = cs.plan(one_contact("ellipsoid", object_velocity="rolling"))
    assert not plan.acceleration(T).any()
