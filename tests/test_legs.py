"""Paths of legs: corners, slip across them, disturbances within them, files, what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import assert_twist_is_the_rate_of_the_pose

import contact_system as cs

LEGS = (cs.Leg(0.3, 0.1, 1.0), cs.Leg(2.0, 0.15, 0.5), cs.Leg(-1.0, 0.05, 1.5))
CORNERS = (1.0, 1.5)
TURNS = (1.7, -3.0)
OBJECTS = {
    "ellipsoid": cs.Ellipsoid(0.3, 0.2, 0.1),
    "torus": cs.Torus(0.3, 0.1),
    "plane": cs.Plane(),
}


def scene(obj: cs.Surface, legs=LEGS, **changes) -> cs.Scene:
    given = {"finger_at": (1.1, 0.4), "finger_velocity": (1.0, 0.0), "angle": 0.4}
    given |= {key: changes.pop(key) for key in ("object_velocity",) if key in changes}
    contact = cs.Contact(cs.Ellipsoid(0.05, 0.04, 0.03), (1.0, 0.9), legs=legs, **given)
    return cs.Scene(object=obj, contacts=[contact], **changes)


@pytest.mark.parametrize("name", OBJECTS)
def test_curves_turn_by_the_legs_directions_on_both_bodies_and_have_their_lengths(name):
    plan = cs.plan(scene(OBJECTS[name]))
    surfaces = plan.scene.contacts[0].finger, plan.scene.object
    for corner, turn in zip(CORNERS, TURNS):
        for side, surface in enumerate(surfaces):
            at = plan.points([corner])[0, 0, side]
            before, after = plan.points([corner - 0.01, corner + 0.01])[:, 0, side]
            normal = surface.normal(*surface.coordinates(at))
            one, other = at - before, after - at
            angle = math.atan2(np.cross(one, other) @ normal, one @ other)
            expected = turn if side == 0 else -turn  # on the object, whose normal is opposite
            assert math.remainder(angle - expected, 2 * math.pi) == pytest.approx(0.0, abs=2e-3)
    t = np.linspace(0.0, 3.0, 20001)
    for side in (0, 1):
        steps = np.linalg.norm(np.diff(plan.points(t)[:, 0, side], axis=0), axis=1)
        assert steps.sum() == pytest.approx(sum(leg.length for leg in LEGS), rel=1e-6)


@pytest.mark.parametrize("name", OBJECTS)
def test_slip_decays_across_corners_by_the_gain_and_the_pose_moves_by_the_twist(name):
    gain = cs.Gain.time(3.0)
    plan = cs.plan(scene(OBJECTS[name], object_velocity=(0.5, 0.9), gain=gain, duration=3.5))
    t = np.linspace(0.01, 3.4, 120)
    sigma = np.zeros_like(t)
    for start, leg in zip((0.0, *CORNERS), LEGS):
        inside = (t >= start) & (t < start + leg.duration)
        sigma[inside] = leg.profile(t[inside] - start)
    law = sigma * np.exp(-3.0 * t)
    slip = plan.slip_speed(t)[:, 0]
    assert slip == pytest.approx(law * slip[0] / law[0], abs=1e-13)
    t = np.array([0.3, 0.9, 1.25, 1.8, 2.7])
    assert_twist_is_the_rate_of_the_pose(plan, t, 1e-9)


def test_a_disturbance_acts_across_the_end_of_a_leg_as_on_one_longer_leg():
    legs = [cs.Leg(0.3, None, 1.0, cs.Profile([0.1])), cs.Leg(0.3, None, 1.0, cs.Profile([0.1]))]
    window = cs.FingerAcceleration(0, 0.4, 1.4, (0.2, -0.1))
    joined = scene(OBJECTS["ellipsoid"], legs, disturbances=[window])
    whole = [cs.Leg(0.3, None, 2.0, cs.Profile([0.1]))]
    one = scene(OBJECTS["ellipsoid"], whole, disturbances=[window])
    t = np.linspace(0.0, 2.0, 50)
    assert cs.plan(joined).states(t) == pytest.approx(cs.plan(one).states(t), abs=1e-10)


def test_legs_are_saved_and_each_contact_follows_its_own_and_rests_after_them(tmp_path):
    custom = cs.Leg(0.1, None, 1.0, cs.Profile([0.0, 0.1, -0.1]))
    first = scene(OBJECTS["ellipsoid"], np.array([*LEGS, custom]), name="turns")
    cs.save_scene(first, tmp_path / "turns.toml")
    assert cs.load_scene(tmp_path / "turns.toml") == first == eval(repr(first), dict(vars(cs)))
    straight = cs.Contact(cs.Sphere(0.04), (1.0, 0.3))
    contacts = [*first.contacts, straight]
    both = first.replace(contacts=contacts, profile=cs.Profile([0.05]), duration=5.0)
    t = np.linspace(0.0, 4.0, 9)
    assert cs.plan(both).points(t)[:, :1] == pytest.approx(cs.plan(first).points(t), abs=1e-15)
    assert cs.Leg(0.1, None, 1.0, cs.Profile([0.0, 0.0])) == cs.Leg(0.1, 0.0, 1.0)
    rest = cs.plan(both).points([4.0, 5.0])[:, 0]
    assert np.array_equal(rest[0], rest[1])


def test_a_scene_lasts_as_long_as_its_legs_however_many():
    assert scene(cs.Plane(), [cs.Leg(0.1 * k, 0.01, 0.01) for k in range(400)]).duration == 4.0


REFUSED = {
    "length = None": lambda: cs.Leg(0.0, None, 1.0),
    r"duration = 1e\+87 s: give 1e-15 to 1e\+15 s": lambda: cs.Leg(0.0, 1.0, 1e87),
    "leave one of the two out, as None": lambda: cs.Leg(0, 1.0, 1.0, cs.Profile([0.1])),
    r"sigma = 0\.1 m/s at t = 1 s, where the path turns": lambda: scene(
        cs.Plane(), [cs.Leg(0.0, None, 1.0, cs.Profile([0.1])), cs.Leg(1.0, 0.1, 1.0)]
    ),
    r"sigma jumps from 0\.1 to 0 m/s": lambda: scene(
        cs.Plane(), [cs.Leg(0.0, None, 1.0, cs.Profile([0.1]))], duration=2.0
    ),
    "acceleration acts": lambda: cs.plan(
        scene(cs.Plane(), disturbances=[cs.FingerAcceleration(0, 0.5, 1.2, (0.1, 0.1))])
    ),
    r"legs\[0\] = 1: give a Leg": lambda: scene(cs.Plane(), [1]),
    '"rolling" follows one geodesic': lambda: cs.Contact(
        cs.Sphere(0.04), (1.0, 0.3), finger_velocity="rolling", object_velocity=(1, 0), legs=LEGS
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_legs_that_cannot_be_followed_are_refused_with_the_remedy(message):
    with pytest.raises(cs.SceneError, match=message):
        REFUSED[message]()
