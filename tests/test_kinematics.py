"""Pose, twist, slip and acceleration of plans (theory section 8)."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import SURFACES, assert_twist_is_the_rate_of_the_pose, derivative, one_contact
from oracles.formulas import path_velocities, reflection

import contact_system as cs

T = np.linspace(0.05, 0.95, 13)
PAIRS = [(name, "sphere") for name in SURFACES] + [("sphere", name) for name in SURFACES]
PAIRS += [("ellipsoid", "torus"), ("bumps", "rounded cube"), ("one sheet", "bumps")]
WINDOWS = (
    cs.FingerAcceleration(0, 0.0, 1.0, (0.3, -0.2)),
    cs.ObjectAcceleration(0, 0.0, 1.0, (0.2, 0.1)),
    cs.ObjectRateOffset(0, 0.0, 1.0, (0.3, -0.2)),
)


# --- pose and twist of plans


@pytest.mark.parametrize("obj, finger", PAIRS)
def test_pose_brings_contact_points_together_with_frames_at_the_angle_psi(obj, finger):
    plan = cs.plan(one_contact(obj, finger))
    pose, points, states = plan.pose(T)[:, 0], plan.points(T)[:, 0], plan.states(T)[:, 0]
    turn = pose[:, :3, :3]
    identity = np.broadcast_to(np.eye(3), turn.shape)
    assert turn @ turn.swapaxes(1, 2) == pytest.approx(identity, abs=1e-14)
    assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-14)
    assert pose[:, 3] == pytest.approx(np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(T), 4)), abs=0)
    moved = np.einsum("nij,nj->ni", turn, points[:, 0]) + pose[:, :3, 3]
    assert moved == pytest.approx(points[:, 1], abs=1e-15)
    # R_21 = E2 diag3(R_psi, -1) E1^T (theory section 8), from states alone; -1: normals oppose
    e1 = SURFACES[finger][0].frame(*states[:, 0:2].T)
    e2 = SURFACES[obj][0].frame(*states[:, 4:6].T)
    middle = np.zeros((len(T), 3, 3))
    middle[:, :2, :2], middle[:, 2, 2] = reflection(states[:, 8]), -1.0
    assert turn == pytest.approx(e2 @ middle @ e1.swapaxes(1, 2), abs=2e-13)


@pytest.mark.parametrize("windows", [(), WINDOWS], ids=["calm", "disturbed"])
@pytest.mark.parametrize("obj, finger", PAIRS)
def test_twist_is_the_rate_of_the_pose(obj, finger, windows):
    # sigma is not near 0, where differences would be coarse: accelerations act as d / sigma^2
    plan = cs.plan(one_contact(obj, finger, disturbances=windows, profile=(0.2, 0.1)))
    assert_twist_is_the_rate_of_the_pose(plan, T, 1e-10)


def test_twist_of_a_small_finger_keeps_its_digits_on_a_large_object():
    contact = cs.Contact(finger=cs.Sphere(1e-3), object_at=(1, 1))
    obj, profile = cs.Sphere(1e3), cs.Profile([0.01])
    scene = cs.Scene(object=obj, contacts=[contact], profile=profile, duration=1)
    speed = np.linalg.norm(cs.plan(scene).twist(T)[:, 0, 3:], axis=1)  # of the finger's centre
    assert speed == pytest.approx(0.01 * (1 + 1e-6), rel=1e-14, abs=0)


# --- relative acceleration


@pytest.mark.parametrize("obj", SURFACES)
def test_acceleration_is_the_covariant_derivative_of_slip(obj):
    # Components in E2, which turns by theta2' = -T2 a2 against the parallel frame: that adds
    # T2 a2 (-v_y, v_x) to v'. Without extremum of sigma lam is smooth, also of the guaranteed law.
    gains = cs.Gain.path(20.0), cs.Gain.time(3.0), cs.Gain.guaranteed(1.0)
    cases = [{"gain": gain, "profile": (0.3, -0.1)} for gain in gains]
    cases += [{"disturbances": WINDOWS[:2], "profile": (0.2, 0.1)}, {"object_velocity": "rolling"}]
    for given in cases:
        plan = cs.plan(one_contact(obj, **given))
        states, slip = plan.states(T), plan.slip(T)[:, 0]
        _, a2 = path_velocities(plan.scene, states)
        torsion = SURFACES[obj][0].torsion_form(*states[:, 0, 4:6].T).reshape(-1, 2)
        turning = (torsion * a2[:, 0]).sum(1)
        quarter_turned = np.stack([-slip[:, 1], slip[:, 0]], axis=1)
        rate = derivative(lambda t: plan.slip(t)[:, 0], T)  # noqa: B023
        expected = rate + turning[:, None] * quarter_turned
        assert plan.acceleration(T)[:, 0] == pytest.approx(expected, abs=1e-9)
