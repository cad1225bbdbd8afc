"""Sign conventions, each tested on its own (theory sections 1, 2, 4, 8)."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from conftest import SURFACES, derivative, one_contact
from oracles.formulas import reflection

import contact_system as cs

T = np.linspace(0.1, 0.9, 5)


# --- one body


def test_curvature_is_positive_on_a_sphere_and_negative_inside_a_bowl():
    u, v = SURFACES["sphere"][1]
    assert cs.Sphere(0.1).curvature_form(u, v) == pytest.approx(10 * np.eye(2), abs=1e-13)
    bowl = cs.Sphere(0.1, inside=True)
    assert bowl.curvature_form(*bowl.canonical(u, v)) == pytest.approx(-10 * np.eye(2), abs=1e-13)


# --- two bodies


def test_at_psi_zero_first_axes_agree_and_second_axes_oppose():
    plan = cs.plan(one_contact(angle=0.0, object_velocity="rolling"))
    turn = plan.pose(0.0)[0, 0, :3, :3]
    e1 = SURFACES["sphere"][0].frame(*SURFACES["sphere"][1])  # finger and object start alike
    assert e1[:, 0] @ turn @ e1[:, 0] == pytest.approx(1.0)
    assert e1[:, 1] @ turn @ e1[:, 1] == pytest.approx(-1.0)
    assert e1[:, 2] @ turn @ e1[:, 2] == pytest.approx(-1.0)


def test_psi_turns_the_fingers_first_axis_from_the_objects_first_axis_clockwise():
    # R_psi (1, 0) = (cos psi, -sin psi)
    psi = 0.3
    plan = cs.plan(one_contact("plane", "plane", angle=psi))
    x1_in_object = plan.pose(0.0)[0, 0, :3, :3] @ [1.0, 0.0, 0.0]
    assert x1_in_object == pytest.approx([np.cos(psi), -np.sin(psi), 0.0])


@pytest.mark.parametrize("obj", ["sphere", "bowl", "ellipsoid", "bumps"])
def test_fingers_material_point_moves_by_minus_slip_relative_to_the_objects(obj):
    scene = one_contact(obj)
    plan = cs.plan(scene)
    states = plan.states(T)
    for k, t in enumerate(T):
        x1, x2 = plan.points(t)[0, 0]

        def material_point(time, x1=x1):
            pose = plan.pose(time)[:, 0]
            return pose[:, :3, :3] @ x1 + pose[:, :3, 3]

        velocity = derivative(material_point, np.array([t]))[0]
        assert material_point([t])[0] == pytest.approx(x2, abs=1e-13)
        frame = scene.object.frame(*states[k, 0, 4:6])
        expected = -frame[:, :2] @ plan.slip(t)[0, 0]
        assert np.linalg.norm(expected) > 1e-3
        assert velocity == pytest.approx(expected, abs=1e-10)


def great_circle_angle(surface: cs.Sphere, at, direction, length) -> np.ndarray:
    """Angle in the contact frame of the tangent of a great circle, at arc lengths (n,)."""
    frame = surface.frame(*at)
    n, e = frame[:, 2], frame[:, :2] @ direction
    phi = np.asarray(length)[:, None] / surface.radius
    x = surface.radius * (np.cos(phi) * n + np.sin(phi) * e)
    tangent = np.cos(phi) * e - np.sin(phi) * n
    south = np.stack([x[:, 0] * x[:, 2], x[:, 1] * x[:, 2], -(x[:, 0] ** 2 + x[:, 1] ** 2)], 1)
    south /= np.linalg.norm(south, axis=1)[:, None]  # f_u of the polar chart, written out
    east = np.stack([-x[:, 1], x[:, 0], 0 * x[:, 0]], 1)
    east /= np.linalg.norm(east, axis=1)[:, None]
    return np.unwrap(np.arctan2((tangent * east).sum(1), (tangent * south).sum(1)))


@pytest.mark.parametrize("rolling", ["finger", "object", "finger and object"])
def test_psi_is_psi_0_less_the_angles_of_the_parallel_frames(rolling):
    # The tangent of a great circle is parallel, so theta is its angle in E; theta = 0 on a plane.
    bodies = ["sphere" if side in rolling else "plane" for side in ("object", "finger")]
    scene = one_contact(*bodies, object_velocity="rolling", profile=(0.05, 0.2))
    (ball, at), w, t = SURFACES["sphere"], np.array([0.6, 0.8]), np.linspace(0.0, 1.0, 101)
    directions = {"finger": w, "object": reflection(0.3) @ w}
    theta = sum(
        great_circle_angle(ball, at, along, 0.05 * t + 0.1 * t**2)
        for side, along in directions.items()
        if side in rolling
    )
    assert np.ptp(theta) > 0.1
    psi = cs.plan(scene).states(t)[:, 0, 8]
    assert psi == pytest.approx(0.3 - (theta - theta[0]), abs=1e-13)


# --- twist


def test_twist_has_no_spin_about_the_normal():
    plan = cs.plan(one_contact("ellipsoid", "torus"))
    normals = SURFACES["ellipsoid"][0].normal(*plan.states(T)[:, 0, 4:6].T)
    omega = plan.twist(T)[:, 0, :3]
    assert np.linalg.norm(omega, axis=1).min() > 0.1
    assert (omega * normals).sum(1) == pytest.approx(0.0, abs=1e-13)


# --- the trap


def test_a_contact_with_an_inward_frame_is_read_as_the_same_point_with_the_outward_frame():
    # (-1.57, 2.44), as the paper prints it, is (1.57, 2.44 + pi) up to whole turns.
    trap = cs.plan(one_contact(object_at=(-1.57, 2.44)))
    plain = cs.plan(one_contact(object_at=(1.57, 2.44 - pi)))
    x = trap.points(T)[:, 0, 1]
    assert x == pytest.approx(plain.points(T)[:, 0, 1], abs=1e-15)
    by_hand = 0.1 * np.array(
        [np.sin(-1.57) * np.cos(2.44), np.sin(-1.57) * np.sin(2.44), np.cos(-1.57)]
    )
    assert trap.points(0.0)[0, 0, 1] == pytest.approx(by_hand, abs=1e-16)
    assert np.sin(trap.states(0.0)[0, 0, 4]) > 0
