"""Pose, twist and acceleration of plans; Montana's equations both ways (theory section 8)."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import SURFACES, derivative, one_contact, path_velocities, reflection, slip_of_states

import contact_system as cs
from contact_system.errors import ConformalContact
from contact_system.kinematics import forward_montana, inverse_montana

T = np.linspace(0.05, 0.95, 13)
PAIRS = [(name, "sphere") for name in SURFACES] + [("sphere", name) for name in SURFACES]
PAIRS += [("ellipsoid", "torus"), ("bumps", "rounded cube"), ("one sheet", "bumps")]
WINDOWS = {
    "none": (),
    "finger acceleration": (cs.FingerAcceleration(0, 0.0, 1.0, (0.3, -0.2)),),
    "object acceleration": (cs.ObjectAcceleration(0, 0.0, 1.0, (0.2, 0.1)),),
    "object rate offset": (cs.ObjectRateOffset(0, 0.0, 1.0, (0.3, -0.2)),),
    "all at once": (
        cs.FingerAcceleration(0, 0.0, 1.0, (0.3, -0.2)),
        cs.ObjectAcceleration(0, 0.0, 1.0, (0.2, 0.1)),
        cs.ObjectRateOffset(0, 0.0, 1.0, (0.3, -0.2)),
    ),
}


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
    n1 = SURFACES[finger][0].normal(*states[:, 0:2].T)
    n2 = SURFACES[obj][0].normal(*states[:, 4:6].T)
    assert np.einsum("nij,nj->ni", turn, n1) == pytest.approx(-n2, abs=1e-13)


@pytest.mark.parametrize("obj, finger", PAIRS)
def test_pose_is_e2_r_psi_e1(obj, finger):
    # R_21 = E2 diag3(R_psi, -1) E1^T (theory section 8), from states alone.
    plan = cs.plan(one_contact(obj, finger))
    states = plan.states(T)[:, 0]
    e1 = SURFACES[finger][0].frame(*states[:, 0:2].T)
    e2 = SURFACES[obj][0].frame(*states[:, 4:6].T)
    middle = np.zeros((len(T), 3, 3))
    middle[:, :2, :2], middle[:, 2, 2] = reflection(states[:, 8]), -1.0
    assert plan.pose(T)[:, 0, :3, :3] == pytest.approx(e2 @ middle @ e1.swapaxes(1, 2), abs=2e-13)


@pytest.mark.parametrize("obj, finger", PAIRS)
def test_twist_is_the_derivative_of_the_pose(obj, finger):
    assert_twist_is_the_derivative_of_the_pose(cs.plan(one_contact(obj, finger)), T)


@pytest.mark.parametrize("window", WINDOWS)
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
    omega = inverse_montana(k1, k2, s[:, 8], a1[:, 0], a2[:, 0])
    e1, e2 = tip.frame(*s[:, 0:2].T), body.frame(*s[:, 4:6].T)
    omega = np.einsum("nij,njk,nk->ni", turn, e1[..., :2], omega)
    v_rel = np.einsum("nij,nj->ni", e2[..., :2], slip_of_states(scene, states)[:, 0])
    arm = plan.points(T)[:, 0, 1] - plan.pose(T)[:, 0, :3, 3]
    twist = np.hstack([omega, -v_rel - np.cross(omega, arm)])
    assert plan.twist(T)[:, 0] == pytest.approx(twist, abs=1e-12 * np.abs(twist).max())


# --- Montana both ways


def random_forms(count: int) -> tuple[np.ndarray, ...]:
    """K_1 positive definite, K_2 positive definite, psi, a_1, a_2."""
    rng = np.random.default_rng(1)
    forms = rng.normal(size=(2, count, 2, 2))
    forms = forms @ forms.swapaxes(-1, -2) + 0.1 * np.eye(2)
    return (*forms, rng.uniform(-4, 4, count), *rng.normal(size=(2, count, 2)))


def test_forward_map_undoes_the_inverse_map():
    k1, k2, psi, a1, a2 = random_forms(200)
    v_rel = np.einsum("nij,nj->ni", reflection(psi), a1) - a2
    back = forward_montana(k1, k2, psi, inverse_montana(k1, k2, psi, a1, a2), v_rel)
    assert back[0] == pytest.approx(a1, abs=1e-11)
    assert back[1] == pytest.approx(a2, abs=1e-11)


def test_inverse_map_undoes_the_forward_map():
    k1, k2, psi, omega, v_rel = random_forms(200)
    a1, a2 = forward_montana(k1, k2, psi, omega, v_rel)
    assert inverse_montana(k1, k2, psi, a1, a2) == pytest.approx(omega, abs=1e-11)
    rolled = np.einsum("nij,nj->ni", reflection(psi), a1)
    assert rolled - a2 == pytest.approx(v_rel, abs=1e-11)


def test_inverse_map_takes_one_velocity_at_many_angles():
    k1, k2, psi, a1, a2 = random_forms(5)
    each = inverse_montana(k1[0], k2[0], psi, a1[0], a2[0])
    for found, angle in zip(each, psi, strict=True):
        assert found == pytest.approx(inverse_montana(k1[0], k2[0], angle, a1[0], a2[0]), abs=1e-14)


def test_forward_map_accepts_one_contact_without_axes():
    a1, a2 = forward_montana(
        10 * np.eye(2), np.zeros((2, 2)), 0.0, np.array([0.0, 3.0]), np.zeros(2)
    )
    # A ball of radius 0.1 on a plane turning at 3 rad/s about y1 rolls at 0.3 m/s along -x1.
    assert a1 == pytest.approx([-0.3, 0.0])
    assert a2 == pytest.approx([-0.3, 0.0])


@pytest.mark.parametrize("shape", [(), (3,)])
def test_sphere_in_a_bowl_of_its_own_radius_is_a_conformal_contact(shape):
    ball, bowl = cs.Sphere(0.1), cs.Sphere(0.1, inside=True)
    k1 = np.broadcast_to(ball.curvature_form(1.0, 0.0), (*shape, 2, 2))
    k2 = np.broadcast_to(bowl.curvature_form(2.0, 0.0), (*shape, 2, 2))
    psi, pair = np.full(shape, 0.3), np.ones((*shape, 2))
    with pytest.raises(ConformalContact, match="change a radius"):
        forward_montana(k1, k2, psi, pair, pair)


def test_ball_along_the_line_of_a_cylinder_of_its_own_radius_is_a_conformal_contact():
    # conforming in one direction only: the relative curvature has rank one
    k1 = cs.Cylinder(0.1).curvature_form(0.0, 0.0)
    k2 = cs.Cylinder(0.1, inside=True).curvature_form(0.0, 0.0)
    with pytest.raises(ConformalContact, match="singular"):
        forward_montana(k1, k2, np.array(0.0), np.ones(2), np.ones(2))


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_whether_bodies_conform_does_not_depend_on_the_unit_of_length(unit):
    ball = cs.Sphere(0.1 * unit).curvature_form(1.0, 0.0)
    for gap, conforms in ((1e-5, False), (1e-7, True)):
        bowl = cs.Sphere(0.1 * unit * (1 + gap), inside=True).curvature_form(2.0, 0.0)
        given = ball, bowl, np.array(0.3), np.ones(2), np.zeros(2)
        if conforms:
            with pytest.raises(ConformalContact):
                forward_montana(*given)
        else:
            assert np.isfinite(forward_montana(*given)).all()


def test_conformal_contact_among_others_is_found():
    k1 = np.array([np.eye(2), np.eye(2), np.eye(2)])
    k2 = np.array([np.eye(2), -np.eye(2), np.eye(2)])
    with pytest.raises(ConformalContact):
        forward_montana(k1, k2, np.zeros(3), np.ones((3, 2)), np.ones((3, 2)))


def test_the_conformal_contact_of_a_table_is_named_by_its_curvature():
    k1 = np.broadcast_to(np.eye(2), (2, 3, 2, 2)).copy()
    k1[1, 2] = [[7.0, 0.0], [0.0, 0.0]]
    words = r"relative curvature \[\[7.0, 0.0\], \[0.0, 0.0\]\] 1/m"
    with pytest.raises(ConformalContact, match=words):
        forward_montana(k1, np.zeros((2, 2)), np.zeros((2, 3)), np.ones(2), np.ones(2))


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
