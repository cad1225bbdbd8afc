"""Hands that hold and turn objects: their plans, what is refused, short simulations."""

import dataclasses
import math
import pickle
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pydrake", reason="Drake is an extra: pip install .[drake]")

from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.trajectories import PiecewisePose

import contact_system as cs
from contact_system.cli import main
from drake_plant import Hand, StationConfig, hand_report, plan_reorientation, simulate
from drake_plant.hand import own_hand
from drake_plant.measures import object_report
from drake_plant.simulation import simulate_hand
from drake_plant.station import BuildHandStation

H2 = cs.load_scene("H2")


def hand_plan(scene=H2, **changes):
    """A scene's plan, with changes to its [drake] table."""
    scene = scene.replace(drake={**scene.drake, **changes})
    return plan_reorientation(StationConfig.from_scene(scene).hand, scene)


@pytest.mark.parametrize("name", ["H2", "H3"])
def test_fingers_of_a_plan_roll_and_press_as_the_object_needs(name):
    scene = cs.load_scene(name)
    plan = hand_plan(scene)
    assert plan.slip.max() < 1e-8
    assert np.trace(plan.object_pose[-1]) == pytest.approx(2 + 2 * np.cos(0.6266), abs=0.01)
    weight = plan.config.object_mass * plan.config.gravity
    np.testing.assert_allclose(plan.forces.sum(axis=1), [[0, 0, weight]] * len(plan.t), atol=1e-6)
    assert plan.cones.max() <= 0.8 + 1e-6
    assert (plan.q >= plan.chains.lower).all() and (plan.q <= plan.chains.upper).all()
    if name == "H3":  # the plan is the same for the ellipsoid written as a quadric
        axes = np.array([scene.object.a, scene.object.b, scene.object.c])
        same = hand_plan(scene.replace(object=cs.Quadric(np.diag(axes**-2))))
        np.testing.assert_allclose(same.forces, plan.forces, rtol=0, atol=1e-7)


def test_fingers_of_six_joints_follow_routes_of_reach_and_can_be_filmed(tmp_path):
    scene = cs.load_scene("H5")
    table = {key: value for key, value in scene.drake.items() if key != "hand"}
    table["normal_force"] = 1.0  # less than what friction needs
    hand = Hand(joints=6, base=np.array([0.0, 0.0, -0.11]))
    assert StationConfig(hand=Hand(Path("mine.sdf"))).table()["hand"]["model"] == "mine.sdf"
    plan = plan_reorientation(hand, scene.replace(drake=table))
    strong = own_hand(AZIMUTHS, 6).replace("<effort>0.7", "<effort>7")
    slides = re.sub('(joint_4" type=")revolute', r"\1prismatic", strong)
    cannot = hand_plan(hand=file_table(tmp_path, slides), turn=[[0, 0, 5]])
    assert plan.slip.max() < 1e-8 and cannot.route is hand_plan().route is None
    points = cs.plan(plan.route).points(plan.t - plan.t[0])
    np.testing.assert_allclose(plan.points, points, atol=1e-11)
    simulate_hand(plan, 0.01, recording=tmp_path / "film.html").save(tmp_path / "H5.npz")
    assert (tmp_path / "film.html").exists()
    (tmp_path / "H5.toml").write_text(str(np.load(tmp_path / "H5.npz")["scene"]))
    saved = cs.load_scene(tmp_path / "H5.toml")  # with the scene's bodies, forces and hand
    assert saved.surfaces == scene.surfaces and saved.drake["hand"]["joints"] == 6
    assert saved.drake["normal_force"] == table["normal_force"] < plan.config.normal_force
    with pytest.raises(cs.SceneError, match="0.0001 s .* of at least one step"):
        simulate_hand(plan, 1e-4)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"hand": {"joints": [4, 6]}}, [r"joints = \[4, 6\]", "one of .4, 6"]),
        ({"hand": {"base": [0, 0, -0.3]}}, ["finger 1. does not reach", "joint", "limit|rad"]),
        ({"hand": {"pad": 0.011}}, ["finger 3. rolls off its pad, pad = 0.011", "0.0162. m"]),
        ({"turn": [[0, -60, 0]]}, ["finger 1. does not get as far", "finger_0_joint_", "rad"]),
        ({"normal_force": 15.0, "stiffness": 1e5}, ["finger_0_joint", "0.7; press or carry less"]),
        ({"hand": {"joints": 6, "pad": 0.006}}, ["finger 1. begins 0.007", "give the finger_at"]),
        ({"hand": {"tips": ["a"]}}, ["tips = .'a'.", "0 names"]),
        ({"hand": {"model": "a", "tips": [0, 1, 2]}}, [r"tips\[0\] = 0: give the name"]),
        ({"hand": {"model": "none.sdf", "tips": ["a", "b", "c"]}}, ["none.sdf': there .* give"]),
        ({"turn": [[0, 30]]}, [r"turn\[0\] = \[0, 30\]"]),
        ({"restart_period": 0.01}, ["restart_period = 0.01", "nothing with a hand"]),
    ],
)
def test_what_a_hand_cannot_do_is_refused_with_the_reason(changes, words):
    with pytest.raises(cs.SceneError, match=".*".join(words)):
        hand_plan(**changes)


def test_who_only_moves_too_fast_is_not_told_to_press_less(tmp_path):
    with pytest.raises(cs.SceneError, match="its limit is 0.7; move more gently"):
        hand_plan(H2.replace(duration=0.05))
    limit = r"\1<velocity>0.04</velocity>"  # 0.006 rad/s on legs, 0.066 with spin
    slow = re.sub("(finger_2_joint_3.*</effort>)", limit, own_hand(AZIMUTHS, 6))
    assert hand_plan(hand=file_table(tmp_path, slow)).route
    slow = own_hand(AZIMUTHS, 6).replace("</effort>", "</effort><velocity>0.3</velocity>")
    table = file_table(tmp_path, slow)
    assert hand_plan(hand=table).route is None  # legs take up to 0.39 rad/s
    with pytest.raises(cs.SceneError, match="_joint_. moves at .* its limit is 0.3; move more"):
        hand_plan(H2.replace(duration=1.0), hand=table)


def test_point_contact_on_an_ellipsoid_and_tips_that_overlap_are_refused():
    with pytest.raises(cs.SceneError, match="is exact for a sphere on a sphere or on a plane"):
        hand_plan(H2.replace(object=cs.Ellipsoid(0.05, 0.05, 0.05)), contact_model="point")
    beside = dataclasses.replace(H2.contacts[1], object_at=(1.75, 0.47))
    with pytest.raises(cs.SceneError, match="finger 1. and contact 1 .finger 2. overlap at t"):
        hand_plan(H2.replace(contacts=[H2.contacts[0], beside, H2.contacts[2]]))


AZIMUTHS = [0, 2 * math.pi / 3, -2 * math.pi / 3]
OWN_HAND = own_hand(AZIMUTHS)  # the SDF text of the package's hand


def file_table(folder, text, name="mine.sdf"):
    """The [drake.hand] table of a hand whose model is read from a file of this text."""
    (folder / name).write_text(text)
    return {"model": str(folder / name), "tips": [f"tip_{i}" for i in range(3)]}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("tip_2", "thumb_2", r"tips\[2\] = 'tip_2': .* frame .did you mean 'tip_"),
        ("<xyz>1 0 0", "<xyz>0 -1 0", "finger 1. would slip"),
        ('revolute(">.*)1 0 0(.*-)0.8(.*)0.8', r"prismatic\g<1>0 1 0\g<2>0.1\g<3>0.1", r"0.1\] m$"),
        (">palm(?=</parent><child>finger_1)", ">finger_0_link_0", "shares finger_0_joint_0"),
        ("revolute", "ball", "joint finger_0_joint_0 has more than one degree of freedom"),
        ("<upper>1.7</upper>", "", "joint finger_0_joint_3 .* one limit alone"),
    ],
)
def test_what_a_hand_of_a_users_model_cannot_do_is_refused(tmp_path, old, new, words):
    rounded = re.sub(r"(\.\d{7})\d+", r"\1", OWN_HAND)  # as users write numbers
    with pytest.raises(cs.SceneError, match=words):
        hand_plan(hand=file_table(tmp_path, re.sub(old, new, rounded)), move=[0, 0.9, 0])


def test_a_users_model_a_hundred_times_lighter_moves_as_the_packages_hand(tmp_path, monkeypatch):
    (tmp_path / "package.xml").write_text("<package><name>light</name></package>")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    text = re.sub(
        "(<mass>|<i..>|<effort>|<damping>|'drake'>)([^<]+)",
        lambda found: f"{found[1]}{0.01 * float(found[2])}",
        OWN_HAND.replace("finger_0_joint_1", "object").replace(
            '<link name="palm">', '<link name="palm"><pose>0 0 0.02 0 0 0</pose>'
        ),
    )
    contacts = [dataclasses.replace(c, name=x) for c, x in zip(H2.contacts, ("hand", "b", "c"))]
    light = {key: 0.01 * H2.drake[key] for key in ("object_mass", "finger_mass", "stiffness")}
    hand = {"model": "package://light/mine.sdf", "base": [0, 0, -0.13]}
    light |= {"normal_force": 0.02, "contact_model": "point"}
    light["hand"] = file_table(tmp_path, text) | hand
    plan = hand_plan(H2.replace(contacts=contacts), **light)
    np.testing.assert_allclose(plan.q, hand_plan(contact_model="point").q, atol=1e-6)
    told = hand_report(pickle.loads(pickle.dumps(simulate(plan.scene, duration=0.3))))
    assert told.off.max() < 1e-5 and told.slipped.max() < 1e-4 and not told.time_off.any()


@pytest.mark.parametrize("joints", [4, 6])
def test_a_hand_moves_the_object_along_a_trajectory_of_drakes(joints):
    goal = RigidTransform(RotationMatrix.MakeXRotation(0.2), [0.0, 0.005, 0.0])
    path = PiecewisePose.MakeLinear([0.0, 4.0], [RigidTransform(), goal])
    plan = plan_reorientation(Hand(joints=joints), H2, path=path)
    np.testing.assert_allclose(plan.object_pose[-1], goal.GetAsMatrix4(), atol=1e-12)
    assert plan.slip.max() < 1e-8 and plan.config.hand == plan.hand
    t = np.linspace(0, 4, 401)
    fast = [RigidTransform(RotationMatrix.MakeZRotation(0.02 * np.sin(9 * x))) for x in t]
    path = PiecewisePose.MakeCubicLinearWithEndLinearVelocity(t, fast)
    assert plan_reorientation(Hand(joints=joints), H2, path=path).slip.max() < 1e-8
    brief = PiecewisePose.MakeLinear([0.0, 0.35], [RigidTransform(), fast[4]])  # 16 equal steps
    assert np.abs(plan_reorientation(Hand(joints=joints), H2, path=brief).a).max() < 1.0
    with pytest.raises(cs.SceneError, match="lasts from 0 to 4 s, the scene from 0 to duration"):
        plan_reorientation(Hand(), H2.replace(duration=3.0), path=path)


@pytest.mark.parametrize(("part", "before"), [(1.0, 2e-6), (1.3, 1e-3)])
def test_even_an_object_heavier_than_planned_rests_before_and_after_a_users_path(part, before):
    ends = [RigidTransform(), RigidTransform(RotationMatrix.MakeZRotation(0.06), [0, 0, 0.01])]
    path = PiecewisePose.MakeCubicLinearWithEndLinearVelocity([0.0, 0.3], ends)
    names = {name: getattr(path, name) for name in ("GetPose", "GetVelocity", "GetAcceleration")}
    own = SimpleNamespace(start_time=lambda: 0.1, end_time=lambda: 0.2, **names)
    scene = H2.replace(drake={**H2.drake, "contact_model": "point"})
    plan = plan_reorientation(Hand(), scene, path=own)
    heavier = dataclasses.replace(plan.config, object_mass=part * plan.config.object_mass)
    result = simulate_hand(dataclasses.replace(plan, config=heavier), 0.8)
    poses, told = result.object_pose, hand_report(result)
    np.testing.assert_allclose(poses[[0, -1]], plan.object_pose[[0, -1]], atol=1e-4)
    np.testing.assert_allclose(result.q[-1], plan.q[-1], atol=0.02)
    assert told.turned_off[result.t > 0.25].max() < math.radians(0.1)
    assert told.off[result.t < 0.1].max() < before
    simulator = Simulator(BuildHandStation(plan))
    simulator.get_mutable_context().SetTime(0.5)
    with pytest.raises(cs.SceneError, match="begins at t = 0.5 s with joints as planned at 0 s"):
        simulator.Initialize()


def test_slip_feedback_makes_a_pushed_finger_slip_less():
    push = {"on": "finger 1", "start": 0.1, "stop": 0.15, "force": [0, 0, 5]}
    changes = {"contact_model": "point", "friction": 0.4, "pushes": [push]}
    open_loop, closed = (
        hand_report(simulate_hand(hand_plan(**changes, slip_gain=gain), 0.2))
        for gain in (0.0, 800.0)
    )
    assert closed.slipped[0] < 0.7 * open_loop.slipped[0] and open_loop.slipped[0] > 1e-3
    push["force"] = [0, 0, 30]
    assert np.abs(simulate_hand(hand_plan(**changes), 0.15).torque).max() == 0.7  # joints' limit


@pytest.mark.parametrize("model", ["point", "hydroelastic"])
def test_a_ball_that_a_hand_turns_ends_where_it_was_planned(model):
    scene = H2.replace(duration=0.5, drake={**H2.drake, "turn": [[3, 0, 4]], "normal_force": 0.5})
    result = simulate(scene, StationConfig.from_scene(scene, contact_model=model))
    told, planned = hand_report(result), result.planned["contact_point"]
    assert np.ptp(np.linalg.norm(planned, axis=-1)) < 1e-12  # on the ball
    assert told.off[-1] < 1e-4 and told.turned_off[-1] < math.radians(0.1)
    assert told.cones.max() < 0.9 and not told.time_off.any() and told.slipped.max() < 2e-4
    assert told.torque_share.max() < 1 and told.room.min() > 0


@pytest.fixture
def cartesian(tmp_path):
    """The table of a hand, an MJCF file without gravity: tips on three slides, in a ball."""
    slides = "".join(f'<joint type="slide" axis="{x}"/>' for x in ("1 0 0", "0 1 0", "0 0 1"))
    tip = f"<body name='tip_%d'>{slides}<geom size='1' mass='1'/></body>"
    bodies = "<geom size='1'/>" + "".join(tip % i for i in range(3))
    text = f"<mujoco model='m'><option gravity='0 0 0'/><worldbody>{bodies}</worldbody></mujoco>"
    return file_table(tmp_path, text, "mine.xml") | {"pad": 1}


def test_gravity_and_walls_of_a_hands_file_and_the_scenes_motion_do_not_matter(cartesian):
    drake = {**H2.drake, "turn": [], "move": [0, 0, -0.03], "contact_model": "point"}
    drake["hand"] = cartesian
    moving = [dataclasses.replace(contact, finger_velocity=(1.0, 0.0)) for contact in H2.contacts]
    scene = H2.replace(duration=0.3, profile=cs.Profile([2.0]), contacts=moving, drake=drake)
    result = simulate(scene)  # lowers the ball as planned
    assert not object_report(result).falls and hand_report(result).off.max() < 1e-4


def test_a_contact_that_rolls_beyond_a_cylinders_end_is_refused(cartesian):
    around = [dataclasses.replace(c, object_at=c.object_at[::-1]) for c in H2.contacts]
    scene = H2.replace(object=cs.Cylinder(0.05), contacts=around)
    with pytest.raises(cs.SceneError, match="rolls off the object's end: .* 0.02 m beyond"):
        hand_plan(scene, turn=[[150, 0, 0]], hand=cartesian)


def test_the_command_drake_reports_a_hands_forces_angles_and_room(tmp_path, capsys):
    words = ["drake", "H4", "--until", "0.1", "--no-recording", "--out", str(tmp_path)]
    assert main([*words, "--set", "drake.contact_model=point"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for words in ("H4: Hand", "force planned measured", "degrees from a limit", "35.9 degrees"):
        assert words in printed
    assert (tmp_path / "H4-drake.png").exists()
