"""Exported FMUs, and slaves in this process, move as plans do: inputs, states, events."""

from __future__ import annotations

import dataclasses
import math
import sys

import numpy as np
import pytest
from conftest import derivative, of_blocks, of_kinds, of_versions, one_contact

import contact_system as cs

pytest.importorskip("fmpy")

from fmu_hosts import EVERYTHING
from fmu_hosts.blocks import Instance, close, columns, simulated, simulated_states

from fmu_export import variable_table

K1 = cs.load_scene("K1")
NAMES = ("K2", "K3", "K4", "D1", "C1", "C2", "chart", "implicit")
SCENES = {name: cs.load_scene(name) for name in NAMES}
R1 = cs.load_scene("R1")
SLIPPING = dataclasses.replace(R1.contacts[0], object_velocity=(0.3, -0.4))
STRAIGHT = dataclasses.replace(SLIPPING, legs=(), finger_velocity=(1.0, 0.0))
SCENES |= {
    "R1": R1,
    "legs": R1.replace(
        contacts=[SLIPPING, STRAIGHT],
        profile=cs.Profile([0.05]),
        gain=cs.Gain.time(1.0),
        duration=4.5,
        disturbances=[cs.FingerAcceleration(0, 1.3, 1.6, (2.0, -1.0))],
    ),
    "short legs": one_contact(
        "ellipsoid",
        legs=[cs.Leg(0.3, 0.03, 0.4), cs.Leg(2.0, 0.03, 0.3), cs.Leg(-1.0, 0.02, 0.2)],
        angle=-4.0,
    ),
    "guaranteed legs": R1.replace(contacts=[SLIPPING], gain=cs.Gain.guaranteed(1.0)),
    "dip": K1.replace(profile=cs.Profile([0.3, -0.84, 2.0, -4 / 3]), gain=cs.Gain.guaranteed(8.0)),
    "touch": K1.replace(profile=cs.Profile([0.25, -1.0, 1.0]), gain=cs.Gain.guaranteed(5.0)),
    "edges that differ by rounding": K1.replace(
        disturbances=[
            cs.ObjectRateOffset(*w, (0.3, 0.1)) for w in ((0, 0.1, 0.3), (1, 0, 0.1 + 0.2))
        ]
    ),
    "rest": K1.replace(profile=cs.Profile([0.0, 0.3, -0.1]), gain=cs.Gain.time(20.0)),
    "function": one_contact(
        cs.ParametricSurface(
            lambda u, v, size, k: (u, v, size * np.sin(6 * u) * np.cos(k * v)),
            parameters={"size": 0.05, "k": 5.0},  # surfaces have a `size` of their own
        ),
        object_at=(0.1, 0.2),
        angle=7.0,
    ),
}


def assert_follows(one: Instance, plan: cs.Plan) -> None:
    """All outputs are the plan's results at the instance's time."""
    t = min(one.time, plan.end)
    close(one.states(), plan.states(t)[0])
    for i in range(len(one.scene.contacts)):
        pose, twist = plan.pose(t)[0, i], plan.twist(t)[0, i]
        for name, expected in {
            "slip": plan.slip(t)[0, i],
            "twist.angular": twist[:3],
            "twist.linear": twist[3:],
            "pose.position": pose[:3, 3],
            "pose.rotation": pose[:3, :3].ravel(),
            "finger.point": plan.points(t)[0, i, 0],
            "object.point": plan.points(t)[0, i, 1],
        }.items():
            close(one.get(f"contact[{i + 1}].{name}"), expected)


# --- motion


@pytest.mark.parametrize(
    ("name", "version"), [*((name, "2.0") for name in SCENES), ("K4", "3.0"), ("D1", "3.0")]
)
@of_kinds
def test_steps_of_any_size_follow_the_plan(name, version, kind):
    scene = SCENES[name]
    plan, one = cs.plan(scene, 1e-14), Instance(scene, kind, version).begin()
    assert_follows(one, plan)
    cuts = np.sort(np.random.default_rng(5).uniform(0, 0.4 * scene.duration, 12))
    for t in [*cuts, 0.7 * scene.duration, scene.duration]:
        one.step(t - one.time)
        assert_follows(one, plan)


@of_blocks
def test_times_past_the_scenes_duration_are_planned_too(kind, version):
    one = Instance(K1, kind, version).begin()
    one.step(0.7, 1.3)
    close(one.states(), cs.plan(K1.replace(duration=2.0), 1e-14).states(2.0)[0])


@pytest.mark.parametrize(
    ("name", "version"),
    [
        *(("K2", "2.0"), ("K4", "3.0"), ("C1", "2.0"), ("rest", "2.0"), ("touch", "3.0")),
        ("implicit", "2.0"),
        *(("short legs", "2.0"), ("short legs", "3.0")),
        *(("legs", "3.0"), ("guaranteed legs", "2.0"), ("edges that differ by rounding", "2.0")),
    ],
)
def test_model_exchange_with_cvode_follows_the_plan(name, version):
    scene = SCENES[name]
    options = {"fmi_type": "ModelExchange", "relative_tolerance": 1e-11, "record_events": False}
    result = simulated(scene, version, output_interval=0.05, solver="CVode", **options)
    wanted = cs.plan(scene).states(np.minimum(result["time"], scene.duration))
    close(simulated_states(result, wanted), wanted, 5e-8)


@of_kinds
def test_at_a_pole_of_a_sphere_coordinates_are_those_of_a_moment_before(kind):
    contact = cs.Contact(cs.Plane(), (0.7, 0.3), (0.0, 0.0), finger_velocity=(-1.0, 0.0))
    profile = cs.Profile([0.1])
    scene = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], profile=profile, duration=1.0)
    one = Instance(scene, kind, "3.0").begin()
    one.step(0.7)
    found = [one.get(f"contact[1].{name}")[0] for name in ("object.u", "object.v", "angle")]
    close(found, [0.0, 0.3, 0.0], 1e-7)


@of_kinds
@pytest.mark.parametrize("push", [0.0, 0.05])
def test_a_step_through_a_pole_of_a_users_chart_is_refused_and_changes_nothing(push, kind):
    ball = cs.ParametricSurface(
        ("r*sin(u)", "r*sin(v)*cos(u)", "r*cos(v)*cos(u)"), parameters={"r": 0.1}, size=0.1
    )
    contact = cs.Contact(cs.Plane(), (np.pi / 2 - 0.5, 0.0), (0.0, 0.0), finger_velocity=(1.0, 0.0))
    scene = cs.Scene(object=ball, contacts=[contact], profile=cs.Profile([0.1]), duration=0.4)
    window = cs.FingerAcceleration(0, 0.0, 0.4, (push, 0.0))
    expected = cs.plan(scene.replace(disturbances=[window])).points(0.4)[0, 0, 1]
    one = Instance(scene, kind, "3.0").begin(start={"contact[1].finger.acceleration.u": push})
    one.step(*[0.1] * 4)
    assert one.get("contact[1].object.point") == pytest.approx(expected, abs=1e-13)
    one.refused("singular point of its chart", one.step, 0.4)
    assert one.get("contact[1].object.point") == pytest.approx(expected, abs=1e-13)


@of_blocks
def test_with_a_later_start_time_profile_and_windows_are_those_from_that_time_on(kind, version):
    # under this law there is no slip from t = 0 on, where sigma rises from zero, but from 0.25 s on
    slips_later = {"profile": (0.0, 0.2, -0.1), "gain": cs.Gain.guaranteed(3.0)}
    window = cs.ObjectRateOffset(0, 0.2, 0.4, (0.3, 0.1))
    scene = one_contact("ellipsoid", disturbances=[window], **slips_later)
    one = Instance(scene, kind, version).begin(0.25)
    shifted = cs.Profile((scene.profile(0.25), 0.2 - 0.5 * 0.1, -0.1))
    window = cs.ObjectRateOffset(0, 0.0, 0.4 - 0.25, (0.3, 0.1))
    plan = cs.plan(scene.replace(profile=shifted, duration=0.65, disturbances=[window]), 1e-14)
    for t in (0.3, 0.5, 0.9):
        one.step(t - one.time)
        close(one.states(), plan.states(min(t - 0.25, 0.65))[0])


# --- inputs


def set_inputs(one: Instance, *windows: cs.scene.Disturbance) -> None:
    """Set the disturbance inputs to the sum of these windows' values, others to zero."""
    given = {v.name: 0.0 for v in one.table.rows if v.causality == "input"}
    for d in windows:
        side, _, kind = d.kind.partition(" ")
        for axis, x in zip("uv", d.value):
            given[f"contact[{d.contact + 1}].{side}.{kind.replace(' ', '_')}.{axis}"] += x
    one.put(given)


THREE = cs.Scene(
    object=cs.Sphere(0.1),
    contacts=[
        cs.Contact(cs.Sphere(0.04), object_at=(0.3, 0.5), finger_velocity=(-1.0, 0.0)),
        *(cs.Contact(cs.Ellipsoid(0.05, 0.04, 0.03), object_at=(1.2, v)) for v in (1.0, 2.0)),
    ],
    profile=cs.Profile((0.1, 0.05)),
    gain=cs.Gain.path(300.0),
    duration=1.0,
    disturbances=[cs.ObjectRateOffset(1, 0.31, 0.57, (0.3, -0.2))],
)
"""The first contact passes a pole."""


@of_blocks
@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "bumps"])
def test_inputs_that_are_held_act_as_windows_of_a_scene(obj, kind, version):
    scene = one_contact(obj, profile=(0.1, 0.1))
    windows = [
        cs.FingerAcceleration(0, 0.2, 0.5, (0.4, -0.3)),
        cs.ObjectAcceleration(0, 0.3, 0.6, (0, 0.5)),
        cs.ObjectRateOffset(0, 0.5, 0.8, (0.2, 0.1)),
    ]
    plan = cs.plan(scene.replace(disturbances=windows), 1e-14)
    one = Instance(scene, kind, version).begin()
    for a, b in zip(plan.scene.edges, plan.scene.edges[1:]):
        set_inputs(one, *(d for d in windows if d.start <= a < d.stop))
        for t in (0.5 * (a + b), b):
            one.step(t - one.time)
            before = plan.states(np.nextafter(t, 0))[0]
            close(one.states(), before if t < 1 else plan.states(1.0)[0])


@of_blocks
@pytest.mark.parametrize("read", [False, True])
def test_inputs_that_change_at_every_step_act_as_a_window_each(read, kind, version):
    # some importers read outputs between setting the inputs and the step: for feed-through
    for scene, steps in (
        (one_contact("ellipsoid", profile=(0.2,)), [0.025] * 40),
        (THREE, [0.02] * 50),
        (SCENES["D1"].replace(disturbances=()), [0.1, 0.2, 0.25, 0.3]),  # a turn or less in a step
    ):
        one, windows = Instance(scene, kind, version).begin(), list(scene.disturbances)
        for k, step in enumerate(steps):
            i, a = k % len(scene.contacts), one.time
            windows.append(cs.FingerAcceleration(i, a, a + step, (math.sin(9 * a), 0.3)))
            set_inputs(one, windows[-1])
            if read:
                one.everything()
            one.step(step)
        end = one.time
        same = scene.replace(disturbances=windows, duration=max(scene.duration, end))
        close(one.states(), cs.plan(same, 1e-14).states(end)[0], 1e-11)


@of_kinds
@pytest.mark.parametrize("steps", [[0.1] * 6, [0.3, 0.1, 0.2], [0.4, 0.2]], ids=str)
def test_a_step_that_ends_at_an_edge_gives_values_after_the_edge_while_inputs_change(steps, kind):
    scene = one_contact(disturbances=[cs.ObjectRateOffset(0, 0.4, 0.6, (0.5, 0.2))])
    one, windows, at_edges = Instance(scene, kind, "2.0").begin(), list(scene.disturbances), []
    for k, step in enumerate(steps):
        windows.append(cs.FingerAcceleration(0, one.time, one.time + step, (0.1 + 0.1 * k, 0.0)))
        set_inputs(one, windows[-1])
        one.step(step)
        if any(abs(one.time - edge) < 1e-9 for edge in (0.4, 0.6)):
            at_edges.append(one.states()[0])
    plan = cs.plan(scene.replace(disturbances=windows), 1e-14)
    close(np.array(at_edges), plan.states([0.4, 0.6])[:, 0])


@of_blocks
def test_inputs_and_measured_states_act_on_contacts_with_legs(kind, version):
    scene = SCENES["legs"]
    window = cs.ObjectRateOffset(0, 0.7, 1.2, (0.2, 0.1))
    plan = cs.plan(scene.replace(disturbances=[*scene.disturbances, window]), 1e-14)
    one = Instance(scene, kind, version, measured="states").begin()
    one.step(0.7)
    set_inputs(one, window)
    one.step(0.5)
    set_inputs(one)
    one.step(0.6)
    close(one.states(), plan.states(1.8)[0])
    measured = plan.states(1.8)[0] + 1e-3
    for i, row in enumerate(measured):
        names = [v.name for v in one.table.rows if f"contact[{i + 1}].measured." in v.name]
        one.put(dict(zip(names, [1.0, *row])))
    one.step(1.0)
    close(one.states(), plan.restart(1.8, measured).states(2.8)[0])


@of_blocks
@pytest.mark.parametrize("name", ["K1", "K2", "K3", "K4"])
@pytest.mark.parametrize("what", ["states", "pose"])
def test_the_next_step_starts_from_the_measured_states_or_pose(name, what, kind, version):
    scene = cs.load_scene(name)
    random, plan = np.random.default_rng(7), cs.plan(scene, 1e-14)
    table = variable_table(scene, measured=what)
    inputs = [v.name for v in table.rows if v.name.startswith("contact[1].measured.")]
    rates = [v.name for v in table.rows if v.name.startswith("der(")]
    for k in range(4):
        t = random.uniform(0.15, 0.8) * scene.duration
        measured = plan.states(t)[0] + 1e-3 * random.standard_normal((3, 9))
        other = plan.restart(t, measured)
        pose = other.pose(t)[0]
        motion = [other.twist(t)[0], pose[:, :3, :3].reshape(3, 9), pose[:, :3, 3]]
        turned = measured + math.tau * np.eye(9)[1] - math.tau * np.eye(9)[8]
        rows = turned if what == "states" else np.hstack(motion)
        one = Instance(scene, kind, version, measured=what).begin()
        one.step(t)
        for i, row in enumerate(rows):
            own = [n.replace("[1]", f"[{i + 1}]", 1) for n in inputs]
            one.put(dict(zip(own, [1.0 + k, *row])))
        close(one.states(), measured, 1e-12)
        one.step(0.5 * (scene.duration - t))
        given, before = one.get(*rates), one.get(*(n[4:-1] for n in rates))
        one.step(1e-6)
        close((one.get(*(n[4:-1] for n in rates)) - before) / 1e-6, given, 1e-4)
        one.step(scene.duration - one.time)
        close(one.states(), other.states(scene.duration)[0], 1e-12)


@of_blocks
def test_windows_can_be_changed_by_parameters_and_switched_off_by_their_scale(kind, version):
    scene = SCENES["K4"]
    windows = [dataclasses.replace(d, start=0.5, value=(0.1, 0.0)) for d in scene.disturbances]
    moved = scene.replace(disturbances=windows)
    start = {}
    for k in (1, 2, 3):
        start |= {f"disturbance[{k}].{n}": x for n, x in (("start", 0.5), ("u", 0.1), ("v", 0.0))}
    none = scene.replace(disturbances=())
    for given, other in ((start, moved), ({"disturbances.scale": 0.0}, none)):
        one = Instance(scene, kind, version).begin(start=given)
        one.step(0.8, 1.7)
        close(one.states(), cs.plan(other, 1e-14).states(2.5)[0])


@of_blocks
def test_outputs_have_sigma_slip_speed_active_disturbance_and_recovery_time(kind, version):
    scene = SCENES["K4"].replace(gain=cs.Gain.time(20.0))
    one, plan = Instance(scene, kind, version).begin(), cs.plan(scene)
    names = [f"contact[2].{n}" for n in ("path.speed", "slip_speed", "disturbance.active")]
    for t in (0.4, 1.3, 2.2):
        one.step(t - one.time)
        expected = [scene.profile(t), plan.slip_speed(t)[0, 1], 1 < t < 2]
        close(one.get(*names), np.array(expected, dtype=float))
    rate = 20.0 - scene.profile.rate(2.2) / scene.profile(2.2)
    assert one.get("contact[2].recovery_time")[0] == pytest.approx(math.log(20) / rate, rel=1e-12)
    one = Instance(one_contact(profile=(0.0, 0.2), gain=cs.Gain.guaranteed(5.0)), kind, version)
    assert one.begin().get("contact[1].recovery_time") == pytest.approx([math.log(20) / 5])


@of_versions
@pytest.mark.parametrize(("start", "expected"), [(0.0, [0, 0, 1, 1, 0]), (1.5, [0, 1, 0])])
def test_model_exchange_reports_changed_states_where_a_window_begins_or_ends(
    start, expected, version
):
    one = Instance(SCENES["K4"], "FMU", version, "ModelExchange").begin(start)
    update = one.own.newDiscreteStates if version == "2.0" else one.own.updateDiscreteStates
    states_changed = []
    for t in (start, *(t for t in (0.5, 1.0, 2.0, 3.0) if t > start)):
        if t > start:
            one.own.setTime(t)
            one.own.enterEventMode()
        states_changed.append(bool(update()[3]))
        one.own.enterContinuousTimeMode()
    assert states_changed == expected


# --- start values and parameters


@of_blocks
def test_with_other_start_values_an_instance_is_another_scene(kind, version):
    contact = cs.Contact(cs.Sphere(0.05), (0.9, 0.3), (1.4, -0.2), 0.7, (0.8, -0.6), (0.1, 0.4))
    scene = one_contact("ellipsoid")
    other = scene.replace(
        object=cs.Ellipsoid(0.4, 0.2, 0.15),
        contacts=[contact],
        gain=cs.Gain.time(5.0),
        profile=cs.Profile((0.1, 0.0, 0.05)),
    )
    one = Instance(scene, kind, version)
    rows, plan = variable_table(other).rows, cs.plan(other, 1e-14)
    one.begin(start={v.name: v.start for v in rows if v.start and v.causality != "input"})
    for _ in range(3):
        one.step(0.3)
        close(one.states(), plan.states(one.time)[0])


@of_kinds
def test_a_radius_that_is_set_moves_the_starting_point_onto_the_new_surface(kind):
    long, longer = K1.replace(object=cs.Ellipsoid(0.2, 0.1, 0.1)), cs.Ellipsoid(0.25, 0.1, 0.1)
    cases = [*((K1, "radius", cs.Sphere(r)) for r in (0.12, 0.03)), (long, "a", longer)]
    for scene, name, body in cases:
        one, plan = Instance(scene, kind, "3.0"), cs.plan(scene.replace(object=body))
        one.own.enterInitializationMode()
        one.put({f"object.{name}": body.size})
        close(one.get("contact[1].object.point"), plan.points(0.0)[0, 0, 1])
        one.own.exitInitializationMode()
        one.step(0.5)
        close(one.get("contact[1].object.point"), plan.points(0.5)[0, 0, 1])


@of_kinds
def test_instances_one_after_the_other_have_their_own_parameters_of_a_users_surface(kind):
    scene = SCENES["chart"]
    for k in (20.0, 20.2):
        one = Instance(scene, kind, "2.0").begin(start={"object.k": k})
        one.step(0.9)
        wavy = dataclasses.replace(scene.object, parameters={"k": k})
        close(one.states(), cs.plan(scene.replace(object=wavy), 1e-14).states(0.9)[0])


@of_blocks
def test_the_gain_can_be_changed_between_steps(kind, version):
    one = Instance(K1, kind, version).begin()
    one.step(0.4)
    one.put({"gain.eta": 500.0})
    one.step(0.6)
    after = cs.plan(K1.replace(gain=cs.Gain.path(500.0)))
    close(one.states(), after.restart(0.4, cs.plan(K1).states(0.4)[0]).states(1.0)[0])


@of_blocks
def test_instances_are_independent_and_reset_starts_anew(kind, version):
    scene = SCENES["K2"]
    alone = Instance(scene, kind, version).begin()
    alone.step(*[0.1] * 5)
    several = [Instance(scene, kind, version).begin() for _ in range(3)]
    set_inputs(several[1], cs.FingerAcceleration(0, 0, 1, (1.0, 0.0)))
    for _ in range(5):
        for one in several:
            one.step(0.1)
    for k in (0, 2):
        assert np.array_equal(several[k].everything(), alone.everything())
    if kind == "slave":  # it may be freed, even twice, and instantiated again
        several[1].own.freeInstance(), several[1].own.freeInstance(), several[1].own.instantiate()
    else:
        several[1].own.reset()
    several[1].begin().step(*[0.1] * 5)
    assert np.array_equal(several[1].everything(), alone.everything())


# --- FMU states


@of_blocks
def test_a_saved_state_can_be_restored_and_as_bytes_also_in_another_instance(kind, version):
    scene = SCENES["K4"]
    one = Instance(scene, kind, version).begin()
    one.step(0.3, 0.2)
    offset = cs.ObjectRateOffset(1, 0, 1, (0.1, 0.0))
    set_inputs(one, offset)
    one.put({"gain.eta": 50.0})
    for _ in range(5):
        one.step(0.05)
    set_inputs(one)  # the state includes inputs that no step has used yet
    state, time = one.state(), one.time
    data = one.written(state)
    one.step(0.4, 0.4)
    expected = one.everything()
    one.restore(state, time).step(0.4, 0.4)
    assert np.array_equal(one.everything(), expected)
    fresh = Instance(scene, kind, version)
    if kind == "FMU":
        fresh.begin()
    fresh.restore(fresh.read(data), time).step(0.4, 0.4)
    assert np.array_equal(fresh.everything(), expected)
    one.free(state)


@of_blocks
def test_damaged_bytes_and_states_of_another_model_are_refused(kind, version):
    one, other = (Instance(s, kind, version).begin() for s in (K1, SCENES["K2"]))
    data, random = one.written(), np.random.default_rng(2)
    places = random.integers(0, len(data), 50)
    flipped = [data[:k] + bytes([data[k] ^ 0x10]) + data[k + 1 :] for k in places]
    for wrong in (b"", data[:-1], data + b"\0", other.written(), *flipped):
        one.refused("refused", one.read, wrong)
    old = data[:8] + (1).to_bytes(8, sys.byteorder) + data[16:]
    one.refused("another model or another version", one.read, old)
    theirs = other.state()
    for call in (lambda: one.restore(theirs, 0.0), lambda: one.free(theirs)):
        one.refused("another model's", call)
    one.step(0.1)


# --- events of FMI 3


@of_kinds
@pytest.mark.parametrize("name", ["K4", "everything", "legs"])
def test_steps_return_early_at_window_edges_where_that_is_allowed(name, kind):
    scene = EVERYTHING if name == "everything" else SCENES[name]
    edges = [t for t in scene.edges if 0.0 < t < scene.duration]  # not at extrema of sigma
    one = Instance(scene, kind, "3.0", eventModeUsed=True, earlyReturnAllowed=True).begin()
    stops, next_events = [], []
    while one.time < scene.duration:
        update = one.own.updateDiscreteStates()
        next_events.append(update[-1] if update[-2] else None)
        one.own.enterStepMode()
        event, _, early, t = one.step(scene.duration - one.time)
        assert event == early == (t < scene.duration)
        if event:
            stops.append(t)
            one.own.enterEventMode()
    assert stops == edges and next_events == [*edges, None]
    close(one.states(), cs.plan(scene).states(scene.duration)[0])


@of_kinds
def test_without_early_return_a_step_over_an_edge_is_made_and_reports_the_event(kind):
    one = Instance(SCENES["K4"], kind, "3.0", eventModeUsed=True).begin()
    one.own.enterStepMode()
    assert one.step(2.0) == (True, False, False, 2.0)
    rounded = Instance(EVERYTHING, kind, "3.0", eventModeUsed=True).begin()
    rounded.own.enterStepMode()
    rounded.step(0.2)  # and 0.2 + 0.1 > 0.3
    assert rounded.step(0.1) == (True, False, False, pytest.approx(0.3))
    ends = Instance(EVERYTHING, kind, "3.0", eventModeUsed=True)
    ends.put({f"profile[{k + 1}]": x for k, x in enumerate((1.0, -1.0, 0.0))})
    ends.begin().own.enterStepMode()
    ends.refused("sigma is negative from", ends.step, 1.5)
    assert ends.step(0.2) == (True, False, False, 0.2)  # it still stands at 0 s


@of_kinds
@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "bumps"])
def test_in_event_mode_values_are_those_after_the_edge_even_before_the_update(obj, kind):
    """Importers pass outputs on in event mode before they update discrete states (FMI 3.0.2,
    2.3.5)."""
    window = cs.ObjectRateOffset(0, 0.3, 0.8, (0.5, 0.2))
    scene = one_contact(obj, disturbances=[window])
    one = Instance(scene, kind, "3.0", eventModeUsed=True).begin()
    one.own.enterStepMode()
    plan = cs.plan(scene, 1e-14)
    before, after = plan.states([0.3 - 1e-15, 0.3])
    one.step(0.1, 0.1, 0.1)
    close(one.states(), before)
    saved, data = one.state(), one.written()
    plain = Instance(scene, kind, "3.0").begin()
    close(plain.restore(plain.read(data), 0.3).states(), after)  # an instance without event mode
    # an input that is set at the edge adds to what acted before it
    set_inputs(one, cs.ObjectRateOffset(0, 0, 1, (0.3, 0.0)))
    close(one.states() - before, np.array([[0, 0, 0, 0, 0, 0, 0.3, 0, 0]]))
    one.restore(saved, 0.3).own.enterEventMode()
    for _ in range(2):
        close(one.states(), after)
        one.own.updateDiscreteStates()
    one.own.enterStepMode()
    one.step(0.4)
    close(one.states(), plan.states(0.7)[0])


# --- derivatives


@of_blocks
@pytest.mark.parametrize("t", [None, 0.0, 1.3])
def test_directional_derivatives_agree_with_differences(t, kind, version):
    one = Instance(SCENES["K4"], kind, version)
    knowns = [v.name for v in one.table.rows if v.causality == "input"]
    knowns.append("gain.eta")
    if t is None:  # in initialization mode, where starts are functions of the surfaces' parameters
        one.own.enterInitializationMode()
        knowns += ["object.a", "object.c", "contact[2].finger.radius"]
        knowns += [one.table.rows[r].name for r in one.table.states]
    else:
        one.begin()
    if t:
        one.step(t)
    unknowns = [n for n in columns(1) if n.startswith("der(")]
    more = [] if version == "3.0" else ["contact[2].slip.x", "contact[2].twist.linear.y"]
    unknowns += more  # in FMI 3 these are elements of arrays
    seed = np.random.default_rng(0).standard_normal(len(knowns))
    exact = one.directional(unknowns, knowns, seed)
    start, state = one.get(*knowns), one.state()

    def moved(h: np.ndarray) -> np.ndarray:
        rows = []
        for step in h:
            one.put(dict(zip(knowns, start + step * seed)))
            rows.append(one.get(*unknowns))
        return np.array(rows)

    expected = derivative(moved, np.array([0.0]), 1e-2)[0]
    one.restore(state, t or 0.0)
    assert exact == pytest.approx(expected, abs=1e-8 * max(1.0, np.abs(expected).max()))


@of_kinds
def test_adjoint_derivatives_are_the_transpose(kind):
    window = cs.FingerAcceleration(contact=0, start=0.1, stop=0.5, value=(1e-3, 0.0))
    one = Instance(SCENES["K3"].replace(disturbances=[window] * 33), kind, "3.0").begin()
    one.step(0.2)
    unknowns = ["contact[1].slip", "contact[1].twist.linear", "der(contact[1].frame.velocity)"]
    knowns = [v.name for v in one.table.rows if v.causality in ("input", "parameter")]
    knowns += ["contact[1].object.frame.u", "contact[1].frame.velocity"]
    rows, count = (sum(one.table[n].size for n in names) for names in (unknowns, knowns))
    forward = [one.product("Directional", unknowns, knowns, e) for e in np.eye(count)]
    backward = [one.product("Adjoint", unknowns, knowns, e) for e in np.eye(rows)]
    assert np.allclose(forward, np.transpose(backward), rtol=1e-12, atol=1e-13)
    assert np.any(forward[knowns.index("disturbance[33].u")])
