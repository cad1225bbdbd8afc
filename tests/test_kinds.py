"""Scenes whose kind is known are planned by numbers alone: beside plans made in full."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from conftest import SURFACES

import contact_system as cs
from contact_system import kinds
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


def test_plans_of_one_kind_in_threads():
    chosen = list(scenes(200, "ellipsoid", "sphere"))

    def answer(scene: cs.Scene) -> np.ndarray:
        plan = cs.plan(scene, tolerance=1e-10, compiled=True)
        return np.concatenate([plan.states(TIMES).ravel(), plan.points(TIMES).ravel()])

    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(answer, chosen))
    for scene, found in zip(chosen, together):
        assert found == pytest.approx(answer(scene.replace()), abs=1e-10)


def test_many_keys_seen_once_do_not_crowd_out_a_kind():
    for scene in scenes(3, "sphere", "sphere"):
        assert cs.plan(scene, compiled=True) is not None
    for k in range(1100):
        cs.plan(scene.replace(gain=cs.Gain.time(1.0 + k)), compiled=True)
    *_, last = scenes(4, "sphere", "sphere")
    assert begun(cs.plan(last, compiled=True))
    assert len(kinds._SEEN) <= kinds.SEEN + 1
