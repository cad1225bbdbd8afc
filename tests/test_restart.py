"""Plans restarted from a measured state or continued, and plans in files."""

from __future__ import annotations

import contextlib
import copy
import csv
import dataclasses
import functools
import json
import pickle
from math import pi

import numpy as np
import pytest
from conftest import RESULTS, WINDOWS, assert_plans_agree, disturbed, one_contact, seven_contacts
from numpy.polynomial import polynomial
from oracles.formulas import path_velocities, slip_of_states

import contact_system as cs

PLACES = [0.0, 0.1, 0.2, 0.35, 0.5, 0.55, 0.8, 0.9]


# --- restart


@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "bumps", "rounded cube", "seven contacts"])
def test_restart_from_its_own_states_reproduces_the_plan(obj):
    plan = cs.plan(seven_contacts() if obj == "seven contacts" else disturbed(obj))
    for t0 in PLACES:
        again = plan.restart(t0, plan.states(t0))
        assert again.start == t0 and again.end == again.scene.duration
        assert_plans_agree(again, plan, np.linspace(t0, 1, 17), 2e-12)


def test_after_a_restart_slip_decays_from_the_measured_one():
    plan = cs.plan(one_contact("ellipsoid", object_velocity="rolling", profile=(0.2, 0.1)))
    state = plan.states(0.5)[0]
    state[0, 6:8] += [0.05, -0.04]
    again, t = plan.restart(0.5, state), np.linspace(0.5, 1, 21)
    first = slip_of_states(plan.scene, state[None])[0, 0]
    assert again.slip(0.5)[0, 0] == pytest.approx(first, abs=1e-15)
    sigma = polynomial.polyval(t, (0.2, 0.1))
    law = np.linalg.norm(first) * sigma / sigma[0] * np.exp(-3.0 * (t - 0.5))
    assert again.slip_speed(t)[:, 0] == pytest.approx(law, abs=1e-14)
    a1, _ = path_velocities(plan.scene, again.states(t))
    assert np.linalg.norm(a1[:, 0], axis=1) == pytest.approx(sigma, rel=1e-12)


@pytest.mark.parametrize("kind", [cs.ObjectAcceleration, cs.ObjectRateOffset])
@pytest.mark.parametrize("finger", [cs.Ellipsoid(0.06, 0.05, 0.04), cs.Sphere(0.05)])
def test_disturbances_act_alike_after_a_restart_from_the_other_cover_of_an_ellipsoid(finger, kind):
    """An ellipsoid's chart covers it twice, with opposite axes. The plan's states are on the cover
    beyond the seam, the measured ones on the principal cover; the disturbance must not turn."""
    start = {"object_at": (1.0, 1.2), "finger_at": (1.2, 0.5), "angle": 0.0}
    start |= {"object_velocity": (0.2, 1.0), "finger_velocity": (0.2, -1.0), "profile": (0.1,)}
    push = [kind(0, 1.2, 1.8, (0.5, 0.3))]
    scene = one_contact(
        "ellipsoid", finger, cs.Gain.time(5.0), disturbances=push, duration=2.0, **start
    )
    plan = cs.plan(scene)
    for t0 in (1.0, 1.4):
        planned, t = plan.states(t0)[0], np.linspace(t0, 2.0, 9)
        assert planned[0, 5] > pi / 2  # the seam is crossed
        motion = plan.pose(t0)[0], plan.twist(t0)[0], plan.points(t0)[0, :, 1]
        measured = cs.measured_states(scene, *motion)
        assert measured[0, 5] < pi / 2
        again = plan.restart(t0, measured)
        assert again.states(t) == pytest.approx(plan.restart(t0, planned).states(t), abs=1e-12)
        assert again.points(t) == pytest.approx(plan.points(t), abs=1e-13)


def test_a_contact_that_rests_to_the_end_restarts_at_its_measured_place():
    scene = one_contact()
    legs = [dataclasses.replace(scene.contacts[0], legs=[cs.Leg(0, s, 1.0)]) for s in (0.1, 0.0)]
    plan = cs.plan(scene.replace(contacts=legs))
    state = plan.states(0.5)[0]
    state[1, [1, 8]] += 0.01
    again = plan.restart(0.5, state)
    assert again.states(1.0)[0, 1] == pytest.approx(state[1], abs=1e-15)
    assert again.states(1.0)[0, 0] == pytest.approx(plan.states(1.0)[0, 0], abs=1e-12)


def test_a_restarted_plan_has_no_results_before_its_start():
    plan = cs.plan(one_contact())
    again = plan.restart(0.5, plan.states(0.5)[0])
    with pytest.raises(cs.ContactSystemError, match=r"outside the plan's horizon \[0.5, 1\] s"):
        again.states(0.4)
    for t, remedy in ((0.4, "or the plan that this one goes on from"), (1.5, "or lengthen")):
        with pytest.raises(cs.ContactSystemError, match=f"ask inside it, {remedy}"):
            again.slip(t)
    with pytest.raises(cs.ContactSystemError, match="ask inside it$"):
        again.points(-1.0)
    assert again.sample_times(11)[0] == 0.5


def test_states_and_times_that_a_plan_cannot_restart_from_are_refused():
    plan = cs.plan(one_contact(profile=(0.1, -0.4, 0.4)))
    state = plan.states(0.4)[0]
    broken = np.where(np.arange(9) == 3, np.nan, state)
    for t, given, words in (
        (0.4, state[0], r"state has shape \(9,\); give \(1, 9\)"),
        (0.4, broken, "restart at t = 0.4 s, contact 0: the measured state has nan"),
        (0.4, [[10**400] * 9], r"give numbers, shape \(1, 9\)"),
        *((0.4, x, "restart") for x in (state + 1e-3j, state.astype(str), state > 0, [[None] * 9])),
        *((t, state, "give a time in seconds|horizon") for t in ([0.4], True, "0.4", None, 2.0)),
        (0.5, state, "contact 0: sigma = 0 there.*restart where sigma > 0"),
        (1.0, state, "restart at t = 1 s"),
    ):
        with pytest.raises(cs.ContactSystemError, match=words):
            plan.restart(t, given)
    imposed = cs.plan(cs.load_scene("C2"))
    with pytest.raises(cs.SceneError, match="'C2', contact 0 .finger.: imposed rolling"):
        imposed.restart(0.5, imposed.states(0.5)[0])


# --- continued, carried frames


# At 0.5 s the path of NORTH goes through a pole, and that of CORNER has just turned.
NORTH = {"object_at": (0.5, 0.0), "finger_velocity": (1.0, 0.0), "object_velocity": (-1.0, 0.0)}
CORNER = (cs.Leg(0.3, 0.1, 0.45), cs.Leg(2.0, 0.15, 0.55))
CONTINUED = [
    disturbed(obj) for obj in ("sphere", "ellipsoid", "cylinder", "torus", "bumps", "bowl")
]
CONTINUED += [
    disturbed("rounded cube"),
    one_contact("sphere", angle=0.0, profile=(0.1,), **NORTH),
    one_contact("sphere", profile=(0.1, -0.4, 0.4)),  # rests at 0.5 s
    one_contact("ellipsoid", "ellipsoid", legs=CORNER),
]


@pytest.mark.parametrize("scene", CONTINUED)
def test_a_plan_continued_under_the_same_scene_is_the_same_plan(scene):
    plan = cs.plan(scene, tolerance=1e-14)
    for t0 in PLACES:
        again = plan.continued(t0)
        assert again.start == t0
        assert_plans_agree(again, plan, np.linspace(t0, 1, 17)[1:], 2e-13, *RESULTS, "carried")


def test_continuing_a_plan_fifty_times_loses_no_digits():
    plan = again = cs.plan(seven_contacts(), tolerance=1e-14)
    for t in np.linspace(0, 1, 51)[:-1]:
        again = again.continued(t)
    assert_plans_agree(again, plan, 1.0, 1e-13, *RESULTS, "carried")


def test_a_disturbance_added_by_continuing_acts_as_one_that_the_scene_had_from_the_start():
    free = disturbed().replace(disturbances=())
    some = free.replace(disturbances=[w for w in WINDOWS if w.start < 0.4])
    later = cs.plan(free, tolerance=1e-14).continued(0.2, some)
    later = later.continued(0.35, disturbed()).continued(0.5, disturbed())
    expected = cs.plan(disturbed(), tolerance=1e-14)
    assert_plans_agree(later, expected, np.linspace(0.5, 1, 21), 2e-13, "states")


def with_a_corner(direction: float) -> cs.Scene:
    legs = [cs.Leg(0.0, 0.1, 1.0), cs.Leg(direction, 0.1, 1.0)]
    return one_contact(legs=legs, duration=2.0)


def test_legs_that_have_not_begun_may_be_changed_by_continuing():
    right, left = cs.plan(with_a_corner(1.0)), with_a_corner(-1.0)
    assert_plans_agree(
        right.continued(0.9, left), cs.plan(left), np.linspace(0.9, 2.0, 12), 1e-13, "points"
    )


def test_continuing_refuses_other_surfaces_the_end_and_imposed_rolling():
    plan = cs.plan(one_contact())
    (contact,) = plan.scene.contacts
    imposed = {"finger_velocity": "rolling", "object_velocity": (0.2, 1.0)}
    rolling = plan.scene.replace(contacts=[dataclasses.replace(contact, **imposed)])
    not_imposed = "contact 0( .finger.)?: imposed rolling cannot go on"
    for begun, t, scene, words in (
        (plan, 0.5, one_contact("ellipsoid"), "at t = 0.5 s: the scene has other surfaces"),
        (plan, 1.0, None, "at t = 1 s: nothing is left to plan"),
        (plan, 1.5, None, "outside the plan's horizon"),
        (plan, [0.5], None, "give a time in seconds"),
        (cs.plan(cs.load_scene("C2")), 0.5, None, not_imposed),
        (plan, 0.5, rolling, not_imposed),
        (plan, 0.5, plan.scene.replace(contacts=[contact] * 2), "other surfaces or contacts"),
        (plan, 0.5, one_contact(angle=0.4), "contact 0 starts or turns in another way"),
        (cs.plan(with_a_corner(1.0)), 1.0, with_a_corner(-1.0), "0 starts or turns in another way"),
        (plan, 0.5, "K4", "scene = 'K4': give a Scene"),
    ):
        with pytest.raises(cs.ContactSystemError, match=words):
            begun.continued(t, scene)
    for method in ("continued", "carried", "moments"):
        with pytest.raises(cs.SceneError, match="'chart' has no parallel frames"):
            getattr(cs.plan(one_contact(), method="chart"), method)(0.5)


PUSHED = one_contact("ellipsoid", profile=(0.2, 0.1), disturbances=WINDOWS[:2])


@pytest.mark.parametrize("scene", [PUSHED, one_contact(profile=(0.0, 0.1))], ids=["pushed", "free"])
def test_parallel_frames_agree_with_the_rates_and_the_angle_of_the_states(scene):
    plan, t = cs.plan(scene), np.linspace(0, 1, 41)
    states, carried = plan.states(t), plan.carried(t)
    sigma = scene.profile(t)[:, None]
    for k, expected in enumerate(path_velocities(scene, states)):
        theta, x, y = carried[:, :, k].transpose(2, 0, 1)
        c, s = np.cos(theta), np.sin(theta)
        found = np.stack([c * x - s * y, s * x + c * y], axis=-1)
        assert sigma[:, :, None] * found == pytest.approx(expected, abs=2e-14)
    assert states[..., 8] == pytest.approx(0.3 - carried[..., 0].sum(axis=-1), abs=1e-14)
    assert carried[0, 0, 0] == pytest.approx([0.0, 0.6, 0.8], abs=1e-15)  # also where sigma = 0


# --- files


@pytest.mark.parametrize("begun", ["auto", "chart", "restarted", "continued"])
@pytest.mark.parametrize("way", ["npz", "pickle", "deepcopy"])
def test_plans_come_back_from_files_pickles_and_copies(tmp_path, way, begun):
    plan = cs.plan(disturbed(), tolerance=1e-9, method="chart" if begun == "chart" else "auto")
    if begun == "restarted":
        state = plan.states(0.45)[0]
        state[0, 6] += 0.1
        plan = plan.restart(0.45, state)
    elif begun == "continued":
        plan = plan.continued(0.45)
    if way == "npz":
        plan.save(tmp_path / "plan.npz")
        again = cs.load(tmp_path / "plan.npz")
    else:
        again = pickle.loads(pickle.dumps(plan)) if way == "pickle" else copy.deepcopy(plan)
    assert_plans_agree(again, plan, np.linspace(plan.start, 1, 12), 0.0)
    expected = plan.scene, plan.start, plan.tolerance, plan.method
    assert (again.scene, again.start, again.tolerance, again.method) == expected


def test_npz_file_holds_sampled_results(tmp_path):
    plan = cs.plan(seven_contacts())
    plan.save(str(tmp_path / "plan.npz"))
    with np.load(tmp_path / "plan.npz") as data:
        t = data["t"]
        assert len(t) == 401 + len(set(plan.scene.edges) - set(np.linspace(0, 1, 401)))
        assert set(plan.scene.edges) <= set(t)
        for result in ("states", "slip", "twist", "pose", "points"):
            assert np.array_equal(data[result], getattr(plan, result)(t)), result


def test_csv_file_holds_states_and_slip_to_the_last_digit(tmp_path):
    plan, t = cs.plan(seven_contacts()), [0.0, 0.25, 1.0]
    plan.save(tmp_path / "plan.csv", t)
    with open(tmp_path / "plan.csv", newline="") as file:
        head, *rows = csv.reader(file)
    table = np.array(rows, dtype=float).reshape(3, 7, 14)
    assert head[:4] == ["t [s]", "contact", "u1", "v1"] and len(head) == 14
    assert np.array_equal(table[:, :, 0], np.repeat(np.array(t)[:, None], 7, axis=1))
    assert np.array_equal(table[0, :, 1], np.arange(7))
    assert np.array_equal(table[:, :, 2:11], plan.states(t))
    assert np.array_equal(table[:, :, 11:13], plan.slip(t))
    assert table[:, :, 13] == pytest.approx(plan.slip_speed(t), rel=1e-15)


def test_files_that_no_plan_was_saved_to_are_refused(tmp_path):
    plan = cs.plan(one_contact(cs.Quadric(np.diag([1, 0.7, -0.5])), object_at=(1.0, 24.0)))
    with pytest.raises(cs.ContactSystemError, match="unknown ending '.mat'; use .npz or .csv"):
        plan.save(tmp_path / "plan.mat")
    with pytest.raises(cs.ContactSystemError, match="cannot be read: .*No such file"):
        cs.load(tmp_path / "none.npz")
    path = tmp_path / "junk.npz"
    plan.continued(0.4).save(path, [0.5])
    assert cs.load(path).start == 0.4  # and rounding is large, 1e10 sizes from the origin
    with np.load(path) as data:
        kept = dict(data)
    header = json.loads(str(kept["plan"]))
    (start,) = header["starts"]
    wrong = {"finger_at": [1.0, 1.0], "angle": None, "slip": [np.nan, 0], "object_frame": [0.1] * 6}
    edits = [{"start": 1.0}, *({"starts": [start | {key: wrong[key]}]} for key in wrong)]
    headers = ["{}", "[]", *(json.dumps(header | edit) for edit in edits)]  # the scene lasts 1 s
    contents = [functools.partial(np.savez, path, **{**kept, "plan": x}) for x in headers]
    contents += [functools.partial(np.savez, path, x=np.zeros(3))]
    contents += [functools.partial(path.write_bytes, x) for x in (b"junk", b"", b"PK\3\4 cut")]
    for write in contents:
        write()
        with pytest.raises(cs.ContactSystemError, match="junk.npz: (not a plan written|start)"):
            cs.load(path)


def test_a_file_with_a_flipped_bit_is_read_as_it_was_or_refused(tmp_path):
    plan = cs.plan(one_contact())
    plan.save(tmp_path / "plan.npz", [0.0])
    content, rng = (tmp_path / "plan.npz").read_bytes(), np.random.default_rng(1)
    for _ in range(200):
        damaged = bytearray(content)
        damaged[rng.integers(len(content))] ^= 1 << int(rng.integers(8))
        (tmp_path / "plan.npz").write_bytes(damaged)
        with contextlib.suppress(cs.ContactSystemError):
            assert cs.load(tmp_path / "plan.npz").scene == plan.scene


def test_a_saved_plan_unpacks_to_no_more_than_a_limit(tmp_path, monkeypatch):
    path = tmp_path / "plan.npz"
    np.savez_compressed(path, scene="x" * 10**7, plan="{}")
    monkeypatch.setattr(cs.limits, "PLAN_BYTES", 1e7)
    with pytest.raises(cs.ContactSystemError, match="plan.npz: scene.npy.*limits.PLAN_BYTES high"):
        cs.load(path)
