"""Legs of `reach` arrive at their goals, loops turn fingers; what cannot be reached is refused."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

import contact_system as cs
from benchmarks.steering import PAIRS, ROUND, SMALL, drawn
from contact_system.cli import main

ELLIPSOID = SMALL, ROUND


def scene(finger, obj, **contact) -> cs.Scene:
    given = {"object_at": (1.0, 0.2), "finger_at": (1.1, 0.4), "angle": 0.3, **contact}
    common = {"duration": 3.0, "profile": cs.Profile([0.1]), "gain": cs.Gain.time(20.0)}
    return cs.Scene(object=obj, contacts=[cs.Contact(finger, **given)], **common)


ALMOST = {"spheres of almost one size": (cs.Sphere(0.039), cs.Sphere(0.04), 0)}


@pytest.mark.parametrize("name", PAIRS | ALMOST)
def test_random_goals_of_both_places_and_the_angle_are_reached(name):
    finger, obj, _ = (PAIRS | ALMOST)[name]
    rng = np.random.default_rng(3)
    for _ in range(4):
        goal = cs.Goal(**drawn(rng, finger, obj))
        route = cs.reach(scene(finger, obj, **drawn(rng, finger, obj)), goal)
        assert len(route.legs[0]) <= 4 and route.residual <= 1e-12
        end = cs.plan(route.scene, 1e-14).points(3.0)[0, 0]
        assert end[0] == pytest.approx(finger.point(*goal.finger_at), abs=1e-12 * finger.size)
        assert end[1] == pytest.approx(obj.point(*goal.object_at), abs=1e-12 * obj.size)
        psi = cs.plan(route.scene, 1e-14).states(3.0)[0, 0, 8]
        if finger.chart.double_cover or obj.chart.double_cover:
            # the two covers' frames differ by half a turn
            psi = math.remainder(2 * (psi - goal.angle), 2 * math.pi)
        else:
            psi = math.remainder(psi - goal.angle, 2 * math.pi)
        assert abs(psi) < 1e-11


@pytest.mark.parametrize("bodies", [ELLIPSOID, (cs.Sphere(0.02), cs.Torus(0.3, 0.05, inside=True))])
def test_a_pose_of_the_finger_can_be_the_goal(bodies):
    start = scene(*bodies)
    goal = cs.Goal(object_at=(2.8, 1.0), finger_at=(1.0, 0.5), angle=1.0)
    pose = cs.plan(cs.reach(start, goal).scene).pose(3.0)[0, 0]
    route = cs.reach(start, cs.Goal(pose=pose))
    assert cs.plan(route.scene).pose(3.0)[0, 0] == pytest.approx(pose, abs=1e-12)
    goal, other = cs.Goal(pose=cs.plan(start).pose(0.0)[0, 0]), cs.Goal(pose=pose)
    assert cs.reach(start, goal).length == 0.0 and goal == dataclasses.replace(goal) != other


def test_poles_and_umbilics_can_be_goals_without_an_angle():
    route = cs.reach(
        scene(*ELLIPSOID), cs.Goal(finger_at=(0.0, 0.0), object_at=(0.0, 0.5 * math.pi))
    )
    found = cs.plan(route.scene).points(3.0)[0, 0]
    assert found == pytest.approx(np.array([SMALL.point(0, 0), ROUND.point(0, 0.5 * math.pi)]))


@pytest.mark.parametrize("legs", [2, 4])
def test_a_contact_that_slips_reaches_its_goal_by_more_legs_than_needed(legs):
    goal = cs.Goal(object_at=(2.0, 1.0))
    route = cs.reach(scene(*ELLIPSOID, object_velocity=(0.3, -0.5)), goal, legs=legs)
    assert len(route.legs[0]) == legs and route.residual <= 1e-12


@pytest.mark.parametrize("eta", [20.0, 1.0])
def test_every_contact_reaches_its_own_goal_or_rests_without_one(eta):
    start, obj = scene(*ELLIPSOID, object_velocity=(0.3, -0.5)), ELLIPSOID[1]  # the first slips
    start = start.replace(gain=cs.Gain.time(eta))
    fingers = [*ELLIPSOID[:1], cs.Ellipsoid(0.05, 0.04, 0.03), cs.Sphere(0.03)]
    contacts = [
        *start.contacts,
        cs.Contact(fingers[1], (2.0, -1.0), (1.0, 0.3), finger_velocity=(2.0, 1.0)),
        cs.Contact(fingers[2], (2.5, 0.3)),
    ]
    goals = [
        cs.Goal(object_at=(2.0, 1.0)),
        cs.Goal(object_at=(1.5, -0.5), finger_at=(1.3, 0.6), angle=0.8),
        None,
    ]
    route = cs.reach(start.replace(contacts=contacts), goals)
    assert [len(legs) for legs in route.legs] == [1, 3, 1] and route.residual <= 1e-12
    assert cs.plan(route.scene).slip_speed(0.1)[0, 0] > 1e-4  # it does slip on the way
    assert route.length == sum(leg.length for legs in route.legs for leg in legs)
    assert all(sum(leg.duration for leg in legs) == pytest.approx(3.0) for legs in route.legs)
    first, last = cs.plan(route.scene, 1e-14).points([0.0, 3.0])
    assert np.array_equal(first[2], last[2])
    for end, goal in zip(last, goals[:2]):
        assert end[1] == pytest.approx(obj.point(*goal.object_at), abs=1e-12)
    assert last[1, 0] == pytest.approx(fingers[1].point(*goals[1].finger_at), abs=1e-13)
    alone = cs.plan(route.scene.replace(contacts=route.scene.contacts[1:2]), 1e-14)
    t = np.linspace(0.0, 3.0, 7)
    assert alone.points(t)[:, 0] == pytest.approx(cs.plan(route.scene, 1e-14).points(t)[:, 1])


def test_no_leg_is_longer_than_asked_and_a_longer_search_finds_no_longer_route():
    start, goal = scene(*ELLIPSOID), cs.Goal(object_at=(2.0, 1.0), finger_at=(1.0, 0.5), angle=1.0)
    first, best = cs.reach(start, goal), cs.reach(start, goal, seconds=0.5)
    assert best.length <= first.length
    short = cs.reach(start, cs.Goal(object_at=(2.0, 1.0)), longest=0.2)
    assert max(leg.length for leg in itertools.chain(*short.legs)) <= 0.2 * (1 + 1e-12)


def test_a_contact_stays_within_the_region_of_its_goal_or_the_goal_is_refused():
    start, place = scene(*ELLIPSOID), {"object_at": (1.1, 0.25), "finger_at": (1.2, 0.45)}
    free, obj = cs.reach(start, cs.Goal(**place, angle=0.5)), ELLIPSOID[1]
    t = np.linspace(0.0, 3.0, 400)

    def farthest(route):
        """Greatest distance of the contact point on the object from its start."""
        points = cs.plan(route.scene).points(t)[:, 0, 1]
        return np.linalg.norm(points - obj.point(1.0, 0.2), axis=1).max()

    narrow = 0.9 * farthest(free)
    # the finger's region is about a pole of its chart
    regions = {"object_within": (1.0, 0.2, narrow), "finger_within": (0.0, 0.0, 0.06)}
    kept = cs.reach(start, cs.Goal(**place, angle=0.5, **regions))
    assert kept.residual <= 1e-12 and farthest(kept) <= narrow * (1 + 1e-9)
    with pytest.raises(cs.SceneError, match="finger_within 0.02 m; widen"):
        cs.reach(start, cs.Goal(**place, angle=2.5, finger_within=(1.1, 0.4, 0.02)), legs=3)


def test_a_sphere_rolls_straight_to_a_place_whole_revolutions_ahead_on_a_plane():
    finger, obj = cs.Sphere(0.04), cs.Plane()
    for times in (1, 2):
        ahead = times * 4 * math.pi * 0.04  # two or four revolutions
        start = scene(finger, obj, object_at=(0.0, 0.0))
        goal = cs.Goal(object_at=(ahead, 0.0), finger_at=(1.1, 0.4), angle=0.3)
        route = cs.reach(start, goal)
        assert route.residual <= 1e-12 and route.length <= ahead * (1 + 1e-9)
    assert cs.reach(start, cs.Goal(object_at=(30.0, 0.0), finger_at=(2.0, -1.0), angle=1.0))


LOOPS = [(*pair[:2], 0.7, {}) for pair in PAIRS.values()]
# has a point at (u, v) and at (-u, v + pi)
COVERED_TWICE = cs.ParametricSurface(("sin(u)*cos(v)", "sin(u)*sin(v)/2", "cos(u)"))
LOOPS += [(cs.Ellipsoid(0.3, 0.2, 0.05), cs.Plane(), 0.7, {})]
LOOPS += [(SMALL, COVERED_TWICE, 1, {})]
LOOPS += [(SMALL, cs.Plane(), 1e-4, {}), (cs.Sphere(3e-4), cs.Sphere(1.0), 0.7, {})]
LOOPS += [(*ELLIPSOID, 0.7, {"object_velocity": (0.5, -0.8)})]
# normals pass close to all directions
LOOPS += [(cs.Torus(0.1, 0.0995), cs.Torus(1.0, 0.98), 0.5, {"finger_at": (0.2, 3.5)})]


@pytest.mark.parametrize("finger, obj, angle, contact", LOOPS)
def test_a_loop_turns_the_finger_in_place_by_the_curvature_enclosed(finger, obj, angle, contact):
    found = cs.loop(scene(finger, obj, **contact), angle)
    first, last = cs.plan(found.scene, 1e-14).points([0.0, 3.0])[:, 0]
    assert last == pytest.approx(first, abs=1e-12)
    assert math.remainder(found.angle - angle, 2 * math.pi) == pytest.approx(0.0, abs=1e-11)
    assert found.gauss_bonnet < 1e-11
    assert not isinstance(obj, cs.Plane) or found.enclosed[1] == 0.0


def _reach(goal: dict, finger=SMALL, obj=ROUND, contact=None, **options) -> Callable[[], object]:
    """A call that is refused."""
    return lambda: cs.reach(scene(finger, obj, **(contact or {})), cs.Goal(**goal), **options)


BESIDE = np.eye(4)
BESIDE[0, 3] = 0.5  # m
PLACE = {"object_at": (2.0, 1.0)}
WHOLE = {**PLACE, "finger_at": (1.0, 0.5), "angle": 1.0}
TWO_PLACES = {**PLACE, "finger_at": (1.0, 0.5)}
BEYOND = {**PLACE, "object_within": (1.0, 0.2, 0.01)}
FAR, NEAR = (2.0, -1.0, 0.01), (1.0, 0.2, 0.01)
TWIN = cs.Ellipsoid(0.3, 0.2, 0.1)
MIRRORED = {"object_at": (1.0, 0.4), "finger_at": (1.0, -0.4), "angle": 0.0}
PUSH = cs.FingerAcceleration(contact=0, start=0.1, stop=0.2, value=(0.1, 0.0))
PUSHED = scene(SMALL, ROUND).replace(disturbances=[PUSH])
ROLLS = {"finger_velocity": "rolling", "object_velocity": (1.0, 0.0)}
SLIDING = {"finger_velocity": (0.0, 0.0), "object_velocity": (1.0, 0.0)}
FOLLOWING = scene(SMALL, ROUND, **ROLLS)
EQUAL = scene(SMALL, SMALL, object_velocity="rest")
TWO = scene(SMALL, ROUND)
TWO = TWO.replace(contacts=TWO.contacts * 2)
REFUSED: dict[str, tuple[str, Callable[[], object]]] = {
    "no place": ("needs a place", lambda: cs.Goal()),
    "an angle without places": ("give both places", lambda: cs.Goal(angle=1.0, **PLACE)),
    "a pose and a place": ("not both", lambda: cs.Goal(pose=np.eye(4), **PLACE)),
    "a pose of 3 by 3": ("shape", lambda: cs.Goal(pose=np.eye(3))),
    "a pose that mirrors": ("no rotation", lambda: cs.Goal(pose=np.diag([1, 1, -1, 1]))),
    "a region without size": ("radius", lambda: cs.Goal(**PLACE, finger_within=(1, 2, 0))),
    "no goal": ("goals given: 0; contacts: 1", lambda: cs.reach(scene(SMALL, ROUND), [])),
    "a table for a goal": ("give a Goal", lambda: cs.reach(scene(SMALL, ROUND), WHOLE)),
    "rests alone": ("every goal is None", lambda: cs.reach(scene(SMALL, ROUND), [None])),
    "an angle at a pole": ("pole", _reach({**WHOLE, "finger_at": (0.0, 0.0)})),
    "almost equal spheres": ("almost .* more than 2 %", _reach(WHOLE, obj=cs.Sphere(0.0401))),
    "a small turn of equal spheres": ("the same", lambda: cs.loop(EQUAL, 1e-5)),
    "flat bodies": ("choose a ball", _reach(WHOLE, cs.Plane(), cs.Quadric(np.diag([90.0, 9, 0])))),
    "mirror images": ("leave parts", _reach(TWO_PLACES, TWIN, TWIN, MIRRORED, legs=2)),
    "a start outside its region": ("the start lies", _reach({**PLACE, "finger_within": FAR})),
    "a goal outside its region": ("the goal lies", _reach({**PLACE, "object_within": NEAR})),
    "a pad too small": ("widen", _reach({**WHOLE, "finger_within": (1.1, 0.45, 0.007)})),
    "legs too short": ("longer ones", _reach(WHOLE, longest=0.01)),
    "one leg for five numbers": ("at least", _reach(WHOLE, legs=1)),
    "bodies that do not touch": ("touch", _reach({"pose": BESIDE}, legs=3)),
    "rolling that is imposed": ("two numbers", lambda: cs.reach(FOLLOWING, cs.Goal(**PLACE))),
    "no direction": ("direction", _reach(WHOLE, contact=SLIDING)),
    "disturbances": ("change its path", lambda: cs.reach(PUSHED, cs.Goal(**WHOLE))),
    "one of two fingers": ("contact 1", lambda: cs.reach(TWO, [None, cs.Goal(**BEYOND)])),
    "a loop of no turn": ("no turn", lambda: cs.loop(scene(SMALL, ROUND), 2 * math.pi)),
    "a loop of a third finger": ("0 to 1", lambda: cs.loop(TWO, 1.0, contact=2)),
}
"""What is refused: a part of the error's text, and the call."""


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_what_cannot_be_reached_is_refused_with_the_reason(name):
    part, ask = REFUSED[name]
    with pytest.raises(cs.ContactSystemError, match=part):
        ask()


def test_the_command_reach_writes_a_scene_that_ends_at_the_goal(tmp_path, capsys):
    file = tmp_path / "mine.toml"
    cs.save_scene(scene(*ELLIPSOID).replace(name="mine", paper={"reports": "that"}), file)
    to = 'object_at = ["4 / 2", 1], finger_at = [1, 0.5], angle = 1'
    arguments = ["reach", str(file), "--to", to, "--no-plots", "--out", str(tmp_path)]
    assert main(arguments) == 0
    assert "contact 0, leg 3: direction" in capsys.readouterr().out
    found = cs.load_scene(tmp_path / "mine-reached.toml")
    assert (found.name, found.paper) == ("mine-reached", {})
    end = cs.plan(found).points(3.0)[0, 0, 1]
    assert end == pytest.approx(ELLIPSOID[1].point(2.0, 1.0), abs=1e-12)
    refused = {"object = [2, 1]": "did you mean 'object_at'?", "angle = 90": "more than two turns"}
    for wrong, said in refused.items():
        assert main(["reach", str(file), "--to", wrong]) == 2
        assert said in capsys.readouterr().err
    assert main([*arguments[:-1], str(tmp_path / "none"), "--to", to]) == 2  # one goal too many
    assert not (tmp_path / "none").exists()
