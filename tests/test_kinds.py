"""Scenes whose kind is known are planned by numbers alone: beside plans made in full."""

import multiprocessing
import time
from collections import OrderedDict
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from conftest import SURFACES

import contact_system as cs
from contact_system import planner, program
from contact_system.kernels import find_compiler

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

TIMES = np.linspace(0.0, 1.0, 61)
OUTPUTS = ("points", "states", "slip", "twist", "pose", "acceleration")


def scenes(count: int, obj: str, finger: str, contacts: int = 1, slips: bool = True, **common):
    """Scenes of one kind, contacts of which start near the places of `SURFACES`."""
    rng = np.random.default_rng(4)
    for _ in range(count):
        chosen = []
        for _ in range(contacts):
            first, second = (
                np.add(SURFACES[name][1], 0.02 * rng.normal(size=2)) for name in (finger, obj)
            )
            velocity = rng.normal(size=2) if slips else "rolling"
            chosen.append(cs.Contact(
                finger=SURFACES[finger][0], finger_at=first, object_at=second,
                angle=rng.uniform(-3, 3), finger_velocity=rng.normal(size=2),
                object_velocity=velocity,
            ))  # fmt: skip
        values = {"gain": cs.Gain.path(300.0), "profile": cs.Profile([0.05, 0.1, -0.05])} | common
        yield cs.Scene(object=SURFACES[obj][0], contacts=chosen, duration=1.0, **values)


def begun(plan: cs.Plan) -> bool:
    return plan._begun is not None


def compare(scene: cs.Scene, plan: cs.Plan, outputs=OUTPUTS, times=TIMES) -> None:
    expected = cs.plan(scene, compiled=False)
    for output in outputs:
        truth = getattr(expected, output)(times)
        size = np.maximum(np.abs(truth).max(axis=0), 1.0)
        error = np.abs(getattr(plan, output)(times) - truth) / size
        assert error.max() < 2e-11, output


PAIRS = [(obj, "sphere") for obj in SURFACES]
PAIRS += [("sphere", "ellipsoid"), ("sphere", "torus"), ("sphere", "cylinder"), ("oblate", "bumps")]


@pytest.mark.parametrize("slips", [True, False], ids=["slip", "rolling"])
@pytest.mark.parametrize(("obj", "finger"), PAIRS)
def test_the_third_scene_of_a_kind_is_planned_as_if_it_were_the_first(obj, finger, slips):
    *_, scene, last = (
        (scene, cs.plan(scene, compiled=True)) for scene in scenes(4, obj, finger, slips=slips)
    )
    # charts found by iteration are planned in full
    expected = SURFACES[obj][0].has_chart
    assert begun(scene[1]) == begun(last[1]) == expected
    for output in OUTPUTS[:2]:  # the first look at a plan
        compare(last[0], cs.plan(last[0], compiled=True), [output])
    many, none = np.linspace(0.0, 1.0, 1500), np.empty(0)  # many: by series
    for times in (many, many[::-1], many[:1], many[::700], none):
        if times.size:
            compare(last[0], cs.plan(last[0], compiled=True), ["states"], times)
        else:
            assert cs.plan(last[0], compiled=True).states(times).shape == (0, 1, 9)
    compare(*scene)


@pytest.mark.parametrize("slips", [True, False], ids=["slip", "rolling"])
@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "torus", "cylinder"])
@pytest.mark.parametrize("contacts", [2, 11])
def test_contacts_of_a_kind_keep_to_themselves(obj, contacts, slips):
    for scene in scenes(4, obj, "sphere", contacts, slips):
        plan = cs.plan(scene, compiled=True)
    assert begun(plan)
    compare(scene, plan)
    compare(scene, cs.plan(scene, compiled=True), ["states"], np.linspace(0.0, 1.0, 900))


def test_slip_and_rolling_are_told_apart_under_one_key():
    for slips in (True, True, True, False, False, False, True, False):
        *_, scene = scenes(3, "sphere", "sphere", slips=slips, gain=cs.Gain.path(77.0))
        plan = cs.plan(scene, compiled=True)
        assert (plan.groups[0].slips[0].of is not None) == slips
        compare(scene, plan)
    assert begun(plan)
    rolling, slipping = scene.contacts[0], next(scenes(1, "sphere", "sphere")).contacts[0]
    for _ in range(3):  # one of each: two groups, which no kind holds
        mixed = scene.replace(contacts=[rolling, slipping])
        plan = cs.plan(mixed, compiled=True)
        assert not begun(plan) and len(plan.groups) == 2


def test_rolling_starts_are_no_slip_at_any_angle():
    rng = np.random.default_rng(8)
    for k in range(300):
        contact = cs.Contact(
            finger=cs.Sphere(0.04), object_at=(1.0, 0.2), angle=rng.uniform(-7, 7),
            finger_velocity=rng.normal(size=2) * 10 ** rng.uniform(-2, 2),
        )  # fmt: skip
        scene = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], profile=cs.Profile([0.01]),
                         duration=1.0)  # fmt: skip
        plan = cs.plan(scene, compiled=True)
        assert plan.groups[0].slips[0].of is None
        assert begun(plan) == (k > 1)


@pytest.mark.parametrize("obj", ["sphere", "ellipsoid", "cylinder"])
def test_what_a_kind_does_not_hold_is_planned_in_full(obj):
    common = {"profile": cs.Profile([1.0]), "gain": cs.Gain.path(3.0)}
    for scene in scenes(3, obj, "sphere", slips=False, **common):
        cs.plan(scene, compiled=True)
    (start,) = scene.contacts

    def moved(**values) -> cs.Scene:
        fields = {key: getattr(start, key) for key in ("finger", "object_at", "angle")} | values
        return scene.replace(contacts=[cs.Contact(**fields)], name="fast")

    still = moved(finger_velocity=(0.0, 0.0))
    compare(still, cs.plan(still, compiled=True), ["points", "states"])
    long = moved(finger_velocity=(300.0, 40.0))  # more turns than a double keeps
    compare(long, cs.plan(long, compiled=True), ["points"])
    with pytest.raises(cs.SceneError, match=r"scene 'fast', contact 0: its path is"):
        cs.plan(moved(finger_velocity=(1e20, 0.0)), compiled=True)


@pytest.mark.parametrize("obj", ["sphere", "ellipsoid"])
def test_begun_plans_restart_save_and_name_their_own_scene(obj, tmp_path):
    for scene in scenes(3, obj, "sphere", name="third"):
        plan = cs.plan(scene, compiled=True)
    assert begun(plan)
    assert plan.groups[0].object[0].problem.name == "scene 'third', contact 0"
    assert plan.explain() == cs.plan(scene.replace(), method="auto", compiled=True).explain()
    row = plan.states([0.5])[0]
    again = plan.restart(0.5, row).states([0.5, 0.8, 1.0])
    assert again == pytest.approx(plan.states([0.5, 0.8, 1.0]), abs=1e-10)
    plan.save(tmp_path / "plan.npz")
    assert cs.load(tmp_path / "plan.npz").points(TIMES) == pytest.approx(
        plan.points(TIMES), abs=1e-13
    )
    with pytest.raises(cs.ContactSystemError, match=r"'third': t = 1\.5 s is outside"):
        cs.plan(scene, compiled=True).states(np.linspace(0.0, 1.5, 4))
    with pytest.raises(cs.ContactSystemError, match=r"'third': t = -1\.0 s is outside"):
        cs.plan(scene, compiled=True).points([-1.0, 0.5])


FINGER, OBJECT, RATE = cs.FingerAcceleration, cs.ObjectAcceleration, cs.ObjectRateOffset
WINDOWS = {
    "finger at the start": [(FINGER, 0.0, 0.2)],
    "finger at the end": [(FINGER, 0.7, 1.0)],
    "object throughout": [(OBJECT, 0.0, 1.0)],
    "one after the other": [(FINGER, 0.2, 0.4), (OBJECT, 0.4, 0.5), (FINGER, 0.8, 0.9)],
    "both at once": [(FINGER, 0.3, 0.6), (OBJECT, 0.3, 0.6)],
    "rate offset": [(RATE, 0.2, 0.5), (FINGER, 0.5, 0.6)],
}
DISTURBED = [("sphere", "sphere", windows) for windows in WINDOWS]
DISTURBED += [
    ("ellipsoid", "sphere", "finger at the start"), ("ellipsoid", "sphere", "rate offset"),
    ("ellipsoid", "cylinder", "finger at the end"), ("sphere", "ellipsoid", "finger at the start"),
    ("sphere", "ellipsoid", "both at once"), ("torus", "sphere", "one after the other"),
    ("sphere", "torus", "finger at the end"), ("plane", "sphere", "one after the other"),
    ("oblate", "sphere", "rate offset"), ("ellipsoid", "sphere", "object throughout"),
]  # fmt: skip


@pytest.mark.parametrize(("obj", "finger", "windows"), DISTURBED)
def test_disturbed_scenes_of_a_kind_are_planned_as_if_they_were_the_first(obj, finger, windows):
    contacts, slips = 1 + len(windows) % 3, windows > "o"
    pushes = [
        kind(i, start, stop, (0.3, -0.2))
        for kind, start, stop in WINDOWS[windows] for i in range(contacts)
    ]  # fmt: skip
    *_, scene, last = (
        (scene, cs.plan(scene, compiled=True))
        for scene in scenes(4, obj, finger, contacts, slips, disturbances=pushes)
    )
    # Chart components on a triaxial ellipsoid have the sign of the branch the path has come to,
    # which plans in full follow alone.
    expected = not any(
        start > 0.0 and (finger if kind is FINGER else obj) == "ellipsoid"
        for kind, start, _ in WINDOWS[windows]
    )
    assert begun(scene[1]) == begun(last[1]) == expected
    compare(*scene, outputs=("points", "pose", "points", "states", "slip", "acceleration"))
    for times in (TIMES[::-1], TIMES[[0, -1]], np.array([0.2, 0.5, 0.7]), TIMES):
        for output in ("points", "states", "carried"):  # the first look at a plan
            compare(last[0], cs.plan(last[0], compiled=True), [output], times)
    many = cs.plan(last[0], tolerance=1e-5, compiled=True)
    assert begun(many) == expected
    assert many.points(TIMES) == pytest.approx(last[1].points(TIMES), abs=1e-5 * 0.3)


def test_many_disturbed_contacts_of_a_kind_keep_to_themselves():
    pushes = [cs.FingerAcceleration("all", 0.2, 0.4, (0.3, -0.2))]
    for scene in scenes(3, "ellipsoid", "sphere", 11, disturbances=pushes):
        plan = cs.plan(scene, compiled=True)
    assert begun(plan)
    compare(scene, plan, ("points",))
    alone = scene.replace(contacts=scene.contacts[9:10], disturbances=pushes)
    assert plan.points(TIMES)[:, 9] == pytest.approx(cs.plan(alone).points(TIMES)[:, 0], abs=1e-13)


def test_disturbed_plans_of_a_kind_say_what_is_wrong_themselves():
    pushes = [cs.FingerAcceleration("all", 0.2, 0.4, (0.3, -0.2))]
    for scene in scenes(3, "sphere", "sphere", disturbances=pushes, name="third"):
        plan = cs.plan(scene, compiled=True)
    assert begun(plan)
    with pytest.raises(cs.ContactSystemError, match=r"'third': t = 1\.5 s is outside"):
        plan.points([0.0, 1.5])
    (start,) = scene.contacts
    fast = cs.Contact(finger=start.finger, object_at=start.object_at, finger_velocity=(1e20, 0.0))
    with pytest.raises(cs.SceneError, match=r"contact 0: its path is"):
        cs.plan(scene.replace(contacts=[fast], disturbances=pushes), compiled=True)


@pytest.mark.parametrize("obj", ["plane", "ellipsoid"])
def test_scenes_with_a_contact_at_rest_do_not_say_how_those_that_move_are_planned(obj):
    # Without Clairaut's integral a path beside a meridian turned by 7e-6 m at the hole's rim.
    surface = cs.Torus(0.50025, 0.49975)

    def moving(*speeds):
        contacts = [
            cs.Contact(finger=surface, object_at=SURFACES[obj][1], finger_at=(1.957, -2.522),
                       finger_velocity=(speed, across)) for speed, across in speeds
        ]  # fmt: skip
        return cs.Scene(
            object=SURFACES[obj][0], contacts=contacts, profile=cs.Profile([0.0004]), duration=30.0
        )

    scene, times = moving((1e-9, 1000.0), (1e-3, 0.0)), np.linspace(0.0, 30.0, 31)
    for _ in range(3):
        rests = moving((1e-9, 1000.0), (0.0, 0.0))
        cs.plan(rests, compiled=True).points(times)
    finger = cs.plan(scene, compiled=True).points(times)[:, :, 0]
    expected = cs.plan(scene, compiled=False).points(times)[:, :, 0]
    assert finger == pytest.approx(expected, abs=1e-12)


def test_slip_of_rounding_is_planned_as_the_full_plan_has_it():
    """Full plans sort contacts by whether they slip, and may see none where a kind sees 1e-17."""
    pushes = [cs.FingerAcceleration("all", 0.4, 0.6, (0.3, -0.2))]

    def scene(v, velocity) -> cs.Scene:
        contacts = [
            cs.Contact(
                finger=cs.Sphere(0.04), object_at=(at, 0.3), angle=0.3, object_velocity=given,
                finger_velocity=own,
            ) for at, own, given in ((1.0, (0.5, 0.1), "rolling"), (v, *velocity))
        ]  # fmt: skip
        return cs.Scene(object=cs.Sphere(0.1), contacts=contacts, profile=cs.Profile([0.05, 0.1]),
                        gain=cs.Gain.path(300.0), duration=1.0, disturbances=pushes)  # fmt: skip

    for k in range(3):
        cs.plan(scene(1.02 + 0.01 * k, ((0.2, 0.3), "rolling")), compiled=True)
    tiny = scene(1.1, ((0.0, 0.0), (1e-170, 0.0)))
    plan = cs.plan(tiny, compiled=True)
    assert begun(plan) and len(cs.plan(tiny, compiled=False).groups) == 2
    compare(tiny, plan, ("points", "slip", "twist", "states", "points"))


def test_threads_that_ask_a_kind_first_get_one_program(monkeypatch):
    for scene in scenes(3, "sphere", "sphere", gain=cs.Gain.path(123.0)):
        plan = cs.plan(scene, compiled=True)
    make = program.program_of

    def slowly(*arguments):
        made = make(*arguments)
        time.sleep(0.05)
        return made

    monkeypatch.setattr(program, "program_of", slowly)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: plan._begun.kind.program("frames"), range(4)))
    assert all(program is found[0] for program in found)


@pytest.mark.parametrize("disturbed", [False, True])
def test_plans_of_one_kind_in_threads(disturbed):
    pushes = [cs.FingerAcceleration("all", 0.2, 0.4, (0.3, -0.2))] if disturbed else []
    chosen = list(scenes(200, "ellipsoid", "sphere", disturbances=pushes))

    def answer(scene: cs.Scene) -> np.ndarray:
        plan = cs.plan(scene, tolerance=1e-10, compiled=True)
        return np.concatenate([plan.states(TIMES).ravel(), plan.points(TIMES).ravel()])

    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(answer, chosen))
    for scene, found in zip(chosen, together):
        assert found == pytest.approx(answer(scene.replace()), abs=1e-10)


def test_scenes_that_are_planned_once_crowd_no_kind_out(monkeypatch):
    for memory in ("_FAMILIES", "_WITH_KIND"):
        monkeypatch.setattr(planner, memory, OrderedDict())
    for scene in scenes(3, "sphere", "sphere"):
        assert cs.plan(scene, compiled=True) is not None
    for k in range(planner.FAMILIES + 10):
        cs.plan(scene.replace(gain=cs.Gain.time(1.0 + k)), compiled=True)
    *_, last = scenes(4, "sphere", "sphere")
    assert begun(cs.plan(last, compiled=True))
    assert len(planner._FAMILIES) == planner.FAMILIES


def test_the_latest_kinds_are_remembered(monkeypatch):
    for memory in ("_FAMILIES", "_WITH_KIND"):
        monkeypatch.setattr(planner, memory, OrderedDict())
    monkeypatch.setattr(planner, "FAMILIES", 5)
    for k in range(8):
        for scene in scenes(3, "sphere", "sphere"):
            cs.plan(scene.replace(gain=cs.Gain.time(1.0 + k)), compiled=True)
    assert (len(planner._WITH_KIND), len(planner._FAMILIES)) == (5, 0)
    assert begun(cs.plan(scene.replace(gain=cs.Gain.time(8.0)), compiled=True))
    assert not begun(cs.plan(scene.replace(gain=cs.Gain.time(1.0)), compiled=True))


def test_imposed_rolling_has_no_kind_whether_or_not_it_passes_a_pole():
    def explained(angle):
        contact = cs.Contact(finger=cs.Sphere(0.04), object_at=(1.2, 0.3), angle=angle,
                             finger_velocity="rolling", object_velocity=(1, 0))  # fmt: skip
        profile = cs.Profile([0.1])
        scene = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], profile=profile, duration=4.0)
        return cs.plan(scene, compiled=True).explain()

    assert all("equations do not reach all" in explained(k * np.pi) for k in (1, -1, 3, -3))
    assert "rolling imposed, chart equations" in explained(0.5)


@pytest.mark.parametrize(("obj", "slips"), [("sphere", False), ("ellipsoid", True)])
def test_contacts_filled_by_several_threads_are_the_same_to_the_bit(monkeypatch, obj, slips):
    times, threads = np.linspace(0.0, 1.0, 600), []
    *_, (scene, _) = (
        (scene, cs.plan(scene, compiled=True)) for scene in scenes(4, obj, "sphere", 67, slips)
    )
    for count in (1, 3):
        monkeypatch.setattr(program, "processors", lambda count=count: count)
        plans = [cs.plan(scene, compiled=True) for _ in range(3)]
        threads.append([plans[0].states(times), plans[1].points(times), plans[2].pose(times)])
        plans[0].states(times[:1])  # keeps its motions from now on
        threads[-1].append(plans[0].states(times))
        with pytest.raises(cs.ContactSystemError, match=r"t = 1\.5 s is outside"):
            plans[0].states(np.append(times, 1.5))
    for one, three in zip(*threads):
        np.testing.assert_array_equal(one, three)


def test_what_a_search_for_poles_has_integrated_is_kept():
    hill = cs.ParametricSurface(("u", "v", "h*cos(10*u)*cos(v)"), parameters={"h": 0.05})
    for k in range(3):
        contact = cs.Contact(cs.Sphere(0.04), (0.1 * k, 0.2), object_velocity="rest")
        scene = cs.Scene(object=hill, contacts=[contact], profile=cs.Profile([0.3]), duration=1.0)
        plan = cs.plan(scene, compiled=True)
    track = plan.groups[0].object[0]
    assert plan._begun is not None and track.motion.data.done
    assert track is plan.groups[0].object[0]


def test_contacts_are_filled_though_no_thread_can_be_started(monkeypatch):
    def refuse(thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(program, "processors", lambda: 4)
    monkeypatch.setattr("threading.Thread.start", refuse)
    filled, t = [], np.zeros(10_000)

    def run(asked):
        first, last = program.ASKED.unpack(asked)[6:8]
        filled.append(last - first)
        return first

    assert program.by_contacts(run, (0, 0, 0.0, 0, 0, 0), 100, t, t) == 8
    assert sum(filled) == 100


@pytest.mark.parametrize("layout_known", [True, False])
def test_times_are_read_from_any_memory(monkeypatch, tmp_path, layout_known):
    if layout_known and not program.LAYOUT_KNOWN:
        pytest.skip("arrays of this Python keep their address elsewhere")
    monkeypatch.setattr(program, "LAYOUT_KNOWN", layout_known)
    fixed, mapped = TIMES.copy(), np.memmap(tmp_path / "times", float, "w+", shape=TIMES.shape)
    fixed.setflags(write=False)
    mapped[:] = TIMES
    inside, spread = np.zeros(100)[20 : 20 + TIMES.size], np.zeros(2 * TIMES.size)[::2]
    inside[:], spread[:] = TIMES, TIMES
    for scene in scenes(4, "ellipsoid", "sphere"):
        expected = cs.plan(scene, compiled=True)
    for times in (TIMES, fixed, mapped, inside, spread, TIMES.tolist(), TIMES.astype(">f8")):
        plan = cs.plan(scene, compiled=True)
        assert begun(plan)
        for output in ("points", "states"):
            values = getattr(plan, output)(times)
            np.testing.assert_allclose(values, getattr(expected, output)(TIMES), 0, 1e-10)


def test_workers_leave_processors_to_each_other(monkeypatch):
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(program.processors).result() == 1
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert program.processors() == 1
