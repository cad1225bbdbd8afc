"""Whole plans in one compiled call against the tracks asked one by one, without a compiler."""

import dataclasses
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
from conftest import SURFACES, one_contact

import contact_system as cs
from contact_system.kernels import find_compiler
from contact_system.panels import MOST_ROOM, Motion, _program_source
from contact_system.program import chart_states

COMPILER = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

TIMES = np.linspace(0.0, 1.0, 301)
GAINS = {
    "path": cs.Gain.path(300.0), "time": cs.Gain.time(30.0), "guaranteed": cs.Gain.guaranteed(5.0),
    "stiff": cs.Gain.time(1e7), "none": cs.Gain.time(0.0),
}  # fmt: skip


def by_one_call(plan: cs.Plan) -> bool:
    return chart_states(plan.groups[0], True) is not None


@COMPILER
@pytest.mark.parametrize("gain", GAINS)
@pytest.mark.parametrize("obj", ["sphere", "bowl", "ellipsoid", "oblate", "turned ellipsoid"])
def test_one_call_gives_the_states_of_the_motion(obj, gain):
    scene = one_contact(obj, "sphere", gain=GAINS[gain])
    plan = cs.plan(scene, compiled=True)
    expected = cs.plan(scene, tolerance=1e-14, compiled=False).states(TIMES)
    size = np.maximum(np.abs(expected).max(axis=(0, 1)), 1.0)
    assert by_one_call(plan) or len(plan.groups[0].object) > 1
    assert np.abs(plan.states(TIMES) - expected).max(axis=(0, 1)) / size == pytest.approx(
        0, abs=1e-11
    )


@COMPILER
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_error_of_one_call_follows_the_tolerance(tolerance):
    scene = one_contact("ellipsoid", "sphere", gain=cs.Gain.path(300.0))
    found = cs.plan(scene, tolerance=tolerance, compiled=True).states(TIMES)
    expected = cs.plan(scene, tolerance=1e-14, compiled=False).states(TIMES)
    assert np.abs(found - expected).max() / np.abs(expected).max() < tolerance


@COMPILER
@pytest.mark.parametrize("tolerance", [1e-1, 1e-3])
def test_fingers_that_turn_many_times_miss_no_turn(tolerance):
    contact = cs.Contact(
        finger=cs.Sphere(1e-3), object_at=(0.7, 0.4), finger_at=(1.1, 0.2),
        object_velocity=(0.2, -0.9),
    )  # fmt: skip
    scene = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], profile=cs.Profile([0.1]),
                     gain=cs.Gain.path(500.0), duration=1.0)  # fmt: skip
    found = cs.plan(scene, tolerance=tolerance, compiled=True).states(TIMES)
    expected = cs.plan(scene, tolerance=1e-14, compiled=False).states(TIMES)
    places = [0, 1, 4, 5, 8]
    assert np.abs(found - expected)[..., places].max() < tolerance


@COMPILER
@pytest.mark.parametrize(("axes", "at", "along", "tolerance"), [
    ((0.1, 0.0004438, 0.0002084), (0.6568, 1.305), (0.1245, -0.4823), 1e-10),
    ((0.1, 0.0008505, 0.0005225), (0.9113, 1.2948), (-0.8555, -5.435e-5), 3e-8),
    ((0.1, 0.0049151, 0.0017677), (0.6223, -1.3992), (0.4888, 0.7038), 1e-11),
])  # fmt: skip
def test_axes_are_right_where_panels_are_short_against_the_body(axes, at, along, tolerance):
    contact = cs.Contact(cs.Plane(), at, (0.0, 0.0), finger_velocity=along)
    scene = cs.Scene(object=cs.Ellipsoid(*axes), contacts=[contact], profile=cs.Profile([0.1]),
                     duration=1.0)  # fmt: skip
    found = cs.plan(scene, tolerance=tolerance, compiled=True).pose(TIMES)
    expected = cs.plan(scene, tolerance=1e-14, compiled=False).pose(TIMES)
    assert np.abs(found - expected)[..., :3, :3].max() < tolerance


@COMPILER
def test_axes_on_a_blade_are_right_at_every_tolerance():
    """One tolerance alone may be met by luck: that of another compiler is not."""
    contact = cs.Contact(cs.Plane(), (0.9113, 1.2948), (0.0, 0.0),
                         finger_velocity=(-0.8555, -5.435e-5))  # fmt: skip
    scene = cs.Scene(object=cs.Ellipsoid(0.1, 0.0008505, 0.0005225), contacts=[contact],
                     profile=cs.Profile([0.1]), duration=1.0)  # fmt: skip
    expected = cs.plan(scene, tolerance=1e-14, compiled=False).pose(TIMES)
    for tolerance in np.geomspace(5e-9, 1e-7, 14):
        found = cs.plan(scene, tolerance=float(tolerance), compiled=True).pose(TIMES)
        assert np.abs(found - expected)[..., :3, :3].max() < tolerance, tolerance


@COMPILER
@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
def test_along_a_meridian_the_noise_of_longitude_asks_for_no_pieces(tolerance):
    contact = cs.Contact(
        finger=cs.Sphere(0.08), object_at=(0.9, 0.4), finger_at=(1.0, 0.2), angle=0.0,
        finger_velocity=(1.0, 0.0), object_velocity=(1.3, 0.0),
    )  # fmt: skip
    scene = cs.Scene(object=cs.Sphere(0.12), contacts=[contact], gain=cs.Gain.path(600.0),
                     profile=cs.Profile([0.001, 0, 0.4]), duration=1.0)  # fmt: skip
    plan, out = cs.plan(scene, tolerance=tolerance, compiled=True), np.empty((1, 9, len(TIMES)))
    made = chart_states(plan.groups[0], True)
    assert made is not None
    assert made.fill(tolerance, TIMES, out) == 0
    expected = cs.plan(scene, tolerance=1e-14, compiled=False).states(TIMES)
    assert np.abs(out.transpose(2, 0, 1) - expected).max() < 10 * tolerance


@COMPILER
@pytest.mark.parametrize("aside", [1e-2, 1e-3, 1e-4, 1e-6, 1e-8])
def test_fingers_that_graze_a_pole_take_no_end_of_pieces(aside):
    for k in range(5):
        scene = one_contact(
            "sphere", finger_at=(1.1 + 0.001 * k, 0.4), finger_velocity=(-1.83, aside),
            gain=cs.Gain.path(300.0), profile=(0.05, 0.1, -0.05),
        )  # fmt: skip
        plan, out = cs.plan(scene, compiled=True), np.empty((1, 9, len(TIMES)))
        made = chart_states(plan.groups[0], True)
        assert made is not None
        assert made.fill(1e-12, TIMES, out) == 0
        found, expected = plan.states(TIMES), cs.plan(scene, compiled=False).states(TIMES)
        assert (out.transpose(2, 0, 1) == found).all()
        assert found[..., 4:8] == pytest.approx(expected[..., 4:8], abs=1e-10)
        assert found[..., 0] == pytest.approx(expected[..., 0], abs=1e-10)


@COMPILER
@pytest.mark.parametrize("slips", [True, False], ids=["slip", "rolling"])
@pytest.mark.parametrize("obj", SURFACES)
def test_one_call_tells_contacts_apart(obj, slips):
    first = one_contact(obj, "sphere")
    contacts = [
        dataclasses.replace(
            first.contacts[0], angle=angle, finger_velocity=(0.5, 0.1 + angle),
            object_velocity=(0.2, 0.3 * angle) if slips else "rolling",
        )
        for angle in (0.0, 1.0, -0.4)
    ]  # fmt: skip
    scene = first.replace(contacts=contacts)
    found, expected = (cs.plan(scene, compiled=compiled) for compiled in (True, False))
    assert found.points(TIMES) == pytest.approx(expected.points(TIMES), abs=1e-12)
    assert found.states(TIMES) == pytest.approx(expected.states(TIMES), abs=1e-10)


@COMPILER
@pytest.mark.parametrize("obj", ["sphere", "ellipsoid"])
def test_a_plan_asked_twice_answers_the_same(obj):
    scene = one_contact(obj, "sphere", gain=cs.Gain.path(300.0))
    cs.plan(scene, compiled=True).states(TIMES)  # later plans keep no motion at their first look
    for output in ("states", "points"):
        plan = cs.plan(scene, tolerance=1e-9, compiled=True)
        first, again = getattr(plan, output)(TIMES), getattr(plan, output)(TIMES)
        assert np.array_equal(first, again)
        assert plan.groups[0].object[0].panels.count > 0


@COMPILER
@pytest.mark.parametrize("pushed", [[0], [1], [2], [0, 2], [1, 3]], ids=str)
def test_contacts_of_one_motion_may_have_others_between_them(pushed):
    scene = cs.load_scene("K2")
    contacts = [*scene.contacts, dataclasses.replace(scene.contacts[0], object_at=(1.0, 2.0))]
    push = [cs.FingerAcceleration(i, 0.4, 0.6, (0.2, 0.1)) for i in pushed]
    scene = scene.replace(contacts=contacts, disturbances=push)
    found = cs.plan(scene, compiled=True).states(TIMES)
    expected = cs.plan(scene, compiled=False).states(TIMES)
    assert np.abs(found - expected).max() / np.abs(expected).max() < 1e-12


@COMPILER
@pytest.mark.parametrize("count", [7, 90, 160, 2000])
@pytest.mark.parametrize("begin", [0.0, 0.4])
@pytest.mark.parametrize(("obj", "turns"), [("sphere", 2), ("torus", 0.8), ("triaxial", 1)])
def test_turns_are_counted_however_many_times_are_asked(obj, turns, count, begin):
    surface = {"sphere": cs.Sphere(0.1), "torus": cs.Torus(0.2, 0.1),
               "triaxial": cs.Ellipsoid(0.3, 0.2, 0.1)}[obj]  # fmt: skip
    contact = cs.Contact(cs.Sphere(0.03), (0.7, 0.4), (1.1, 0.2), 0.3, object_velocity=(0.9, -0.5))
    scenes = [
        cs.Scene(object=surface, contacts=[contact], gain=cs.Gain.time(20.0 + k), duration=1.0,
                 profile=cs.Profile([0.0, 6.0, 0.0, -6.0]))  # at rest at both ends
        for k in range(4)
    ]  # fmt: skip
    times = np.linspace(begin, 1.0, count)
    expected = cs.plan(scenes[0], tolerance=1e-14, compiled=False).states(times)
    passed = np.abs(expected[-1, 0, [4, 5]] - (0.7, 0.4)).max() / (2 * np.pi)
    assert passed > turns
    for scene in (*scenes[1:], scenes[0]):  # the last is planned by numbers
        found = cs.plan(scene, tolerance=1e-12, compiled=True).states(times)
    size = np.maximum(np.abs(expected).max(axis=(0, 1)), 1.0)
    assert (np.abs(found - expected) / size).max() < 1e-10


@COMPILER
def test_times_of_one_call_come_in_any_order():
    plan = cs.plan(one_contact("sphere", "sphere"), compiled=True)
    order = np.random.default_rng(3).permutation(len(TIMES))
    assert plan.states(TIMES[order]) == pytest.approx(plan.states(TIMES)[order], abs=1e-14)


@COMPILER
def test_one_call_refuses_times_outside_the_horizon():
    plan = cs.plan(one_contact("sphere", "sphere"), compiled=True)
    with pytest.raises(cs.ContactSystemError, match=r"t = 1\.01\d* s is outside"):
        plan.states(np.linspace(0.0, 1.5, 100))


@COMPILER
def test_a_path_that_grazes_a_pole_falls_back_to_the_motion_itself():
    scene = one_contact(
        object_at=(0.3, 0.0), object_velocity=(-0.9, 1e-9), finger_velocity=(1.0, 0.0),
        gain=cs.Gain.time(0.1), profile=(0.05,),
    )  # fmt: skip
    plan = cs.plan(scene, compiled=True)
    expected = cs.plan(scene, compiled=False).states(TIMES)
    assert plan.states(TIMES)[:, :, 4] == pytest.approx(expected[:, :, 4], abs=1e-12)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=COMPILER)])
@pytest.mark.parametrize("obj", SURFACES)
def test_rates_begin_as_the_scene_says_however_short_slip_lasts(obj, compiled):
    scene = one_contact(obj, "sphere", gain=cs.Gain.time(1e12), object_velocity=(0.2, -0.5))
    first = cs.plan(scene, compiled=compiled).states(np.linspace(0.0, 1.0, 101))[0, 0]
    velocity = scene.object.metric_root(first[4], first[5]) @ first[6:8]
    assert velocity == pytest.approx(np.array([0.2, -0.5]) * scene.profile(0.0), rel=1e-12)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=COMPILER)])
@pytest.mark.parametrize("obj", SURFACES)
def test_a_scene_planned_before_is_planned_to_the_tolerance_asked_for_now(obj, compiled):
    def make() -> cs.Scene:
        return one_contact(obj, "sphere", gain=cs.Gain.time(30.0), object_velocity=(0.7, -0.7001))

    again, fresh = make(), make()
    for tolerance in (1e-2, 1e-6):
        cs.plan(again, tolerance=tolerance, compiled=compiled).points(TIMES)
    found = cs.plan(again, compiled=compiled)
    expected = cs.plan(fresh, compiled=compiled)
    assert np.abs(found.points(TIMES) - expected.points(TIMES)).max() < 1e-14
    assert np.abs(found.states(TIMES) - expected.states(TIMES)).max() < 1e-11


@COMPILER
@pytest.mark.parametrize("scene", ["K1", "K2", "K3", "K4", "D1", "D2", "D3", "C1"])
def test_times_in_any_order_and_a_second_plan_give_the_same(scene):
    scene = cs.load_scene(scene)
    t = np.linspace(0.0, scene.duration, 101)
    order = np.random.default_rng(5).permutation(len(t))
    first = cs.plan(scene, compiled=True)
    for output in ("points", "states", "pose", "twist"):
        expected = getattr(cs.plan(scene, compiled=False), output)(t)
        size = np.maximum(np.abs(expected).max(axis=0), 1.0)
        for plan in (first, cs.plan(scene, compiled=True)):
            assert (np.abs(getattr(plan, output)(t) - expected) / size).max() < 1e-11
            assert (np.abs(getattr(plan, output)(t[order]) - expected[order]) / size).max() < 1e-11


@COMPILER
@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "oblate", "torus", "plane"])
def test_what_is_accelerated_all_the_time_goes_round(obj):
    push = cs.ObjectAcceleration(contact=0, start=0.0, stop=4.0, value=(0.3, -0.2))
    scene = one_contact(obj, "ellipsoid", profile=(0.4,), disturbances=(push,), duration=4.0)
    t = np.linspace(0.0, 4.0, 1001)
    found, expected = (cs.plan(scene, compiled=compiled).states(t) for compiled in (True, False))
    assert found == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@COMPILER
@pytest.mark.parametrize("obj", SURFACES)
def test_object_rate_offsets_are_in_the_rates(obj):
    offset = cs.ObjectRateOffset(contact=0, start=0.3, stop=0.6, value=(0.2, -0.1))
    scene = one_contact(obj, "sphere", disturbances=(offset,))
    plans = [cs.plan(scene, compiled=compiled) for compiled in (True, False)]
    for output in ("states", "pose", "twist", "slip"):
        found, expected = (getattr(plan, output)(TIMES) for plan in plans)
        assert found == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())
    rates = [plans[0].states([t])[0, 0, 6:8] for t in (0.3 - 1e-9, 0.3)]
    assert rates[1] - rates[0] == pytest.approx([0.2, -0.1], abs=1e-7)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=COMPILER)])
@pytest.mark.parametrize("obj", ["torus", "ellipsoid", "oblate"])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-9, 1e-13])
def test_speed_along_a_geodesic_is_kept_to_the_tolerance(obj, tolerance, compiled):
    scene = one_contact(obj, "sphere", object_velocity="rolling", profile=(3.0,))
    states = cs.plan(scene, tolerance=tolerance, compiled=compiled).states(TIMES)[:, 0]
    roots = [scene.object.metric_root(*row[4:6]) for row in states]
    speeds = [np.linalg.norm(root @ row[6:8]) / 3.0 for root, row in zip(roots, states)]
    assert np.ptp(speeds) < 30 * tolerance


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=COMPILER)])
@pytest.mark.parametrize("obj", SURFACES)
def test_slip_whose_path_is_negligible_still_shows_in_the_rates(obj, compiled):
    scene = one_contact(obj, "sphere", gain=cs.Gain.time(1e9), object_velocity=(0.2, -0.5))
    plan = cs.plan(scene, tolerance=1e-2, compiled=compiled)
    first = plan.states(np.linspace(0.0, 1.0, 11))[0, 0]
    velocity = scene.object.metric_root(first[4], first[5]) @ first[6:8]
    assert velocity == pytest.approx(np.array([0.2, -0.5]) * scene.profile(0.0), rel=1e-9)


@COMPILER
@pytest.mark.parametrize(("eta", "tolerance"), [(1e6, 1e-3), (1e8, 1e-5)])
@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "oblate"])
def test_slip_that_moves_nothing_shows_in_the_rates_at_many_times(obj, eta, tolerance):
    scene = one_contact(obj, "sphere", gain=cs.Gain.time(eta), object_velocity=(0.2, -0.5))
    plan = cs.plan(scene, tolerance=tolerance, compiled=True)
    layer = np.linspace(0.0, 40.0, 21) / eta
    times = np.concatenate([layer, np.linspace(0.01, 1.0, 4000)])
    for state, slip in zip(plan.states(times)[:21, 0], plan.slip(layer)[:, 0]):
        c, s = np.cos(state[8]), np.sin(state[8])
        finger = scene.contacts[0].finger.metric_root(*state[0:2]) @ state[2:4]
        velocity = scene.object.metric_root(*state[4:6]) @ state[6:8]
        expected = np.array([[c, -s], [-s, -c]]) @ finger - slip
        assert velocity == pytest.approx(expected, abs=3 * tolerance * scene.profile(0.0))


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=COMPILER)])
@pytest.mark.parametrize(("coefficients", "most"), [([0.001, 0.0, 0.4], 2), ([0.401, -0.4], 6)])
def test_a_gain_that_grows_later_takes_no_more_panels(coefficients, most, compiled):
    scene = one_contact(
        "sphere", "sphere", profile=coefficients, gain=cs.Gain.path(620.0),
        object_velocity="rest", duration=1.0,
    )  # fmt: skip
    plan = cs.plan(scene, tolerance=1e-6, compiled=compiled)
    exact = cs.plan(scene, tolerance=1e-14, compiled=False).points(TIMES)
    assert np.abs(plan.points(TIMES) - exact).max() < 1e-6 * scene.contacts[0].finger.size
    assert plan.groups[0].object[0].panels.count <= most


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=COMPILER)])
@pytest.mark.parametrize("obj", SURFACES)
def test_rolling_does_not_end_with_a_piece_of_the_gain(obj, compiled):
    gain, profile = cs.Gain.guaranteed(2.0), (0.1, 1.0, -1.0)
    scene = one_contact(obj, "sphere", gain=gain, profile=profile, object_velocity="rolling")
    free = one_contact(obj, "sphere", profile=profile, object_velocity="rolling")
    found, expected = (cs.plan(s, compiled=compiled).points(TIMES) for s in (scene, free))
    assert found == pytest.approx(expected, abs=1e-14)


def has_fma() -> bool:
    """Whether the compiler makes instructions that multiply and add with one rounding here."""
    command = [*find_compiler(), "-march=native", "-dM", "-E", "-x", "c", "-"]
    known = subprocess.run(command, input="", capture_output=True, text=True).stdout
    return "__FP_FAST_FMA " in known or "__FMA__ " in known


@COMPILER
def test_paths_are_as_long_as_a_double_can_say():
    if not has_fma():
        pytest.skip("no fma here")
    sigma = (0.001, 0.0, 0.375)
    contact = cs.Contact(cs.Sphere(0.04), object_at=(0.0, 0.0), finger_velocity=(1.0, 0.0))
    scene = cs.Scene(object=cs.Plane(), contacts=[contact], profile=cs.Profile(sigma), duration=1.0)
    found = cs.plan(scene, compiled=True).states(TIMES)[:, 0, 4]
    for t, length in zip(TIMES[1:].tolist(), found[1:].tolist()):
        true = sum(Fraction(c) * Fraction(t) ** (k + 1) / (k + 1) for k, c in enumerate(sigma))
        assert abs(Fraction(length) - true) <= true / 2**53


@COMPILER
def test_room_for_more_panels_is_made_while_no_other_thread_integrates(monkeypatch):
    held, failed = [], Motion.failed

    def watched(motion, code):
        held.append(motion.lock.locked())
        failed(motion, code)

    monkeypatch.setattr(Motion, "failed", watched)
    scene = one_contact("ellipsoid", "ellipsoid", profile=(1000.0,), object_velocity="rolling")
    plan = cs.plan(scene, compiled=True)
    plan.points(TIMES)
    assert plan.groups[0].object[0].panels.count > MOST_ROOM
    assert held and all(held)


@pytest.mark.slow  # ziglang builds a C library for Windows when it is used first
def test_no_address_is_cut_short_where_a_long_has_32_bits(tmp_path):
    pytest.importorskip("ziglang")
    code = tmp_path / "program.c"
    code.write_text(_program_source())
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu"]
    flags = ["-std=gnu99", "-Werror=int-to-pointer-cast", "-o", str(tmp_path / "program.obj")]
    run = subprocess.run([*compiler, *flags, "-c", str(code)], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
