"""SceneSystem: its equations, integrated by scipy, give what plan() gives."""

from __future__ import annotations

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from conftest import SURFACES, derivative, one_contact
from scipy.integrate import solve_ivp

import contact_system as cs
from contact_system import SceneSystem

COORDINATES = ("chart", "frame")
SIZE = dict(state=9, slip=2, twist=6, acceleration=6, pose=12, contact_point=6, slip_acceleration=2)
# Surfaces with every form of state: in space, in a chart alone, developable, without a chart.
OBJECTS = ("plane", "sphere", "ellipsoid", "bumps", "cylinder", "rounded cube")
WINDOW = (0.3, 0.6)
DISTURBANCES = {
    "finger": cs.FingerAcceleration(0, *WINDOW, (0.5, -0.8)),
    "object": cs.ObjectAcceleration(0, *WINDOW, (0.7, 0.6)),
    "offset": cs.ObjectRateOffset(0, *WINDOW, (0.4, -0.3)),
}
LATE = cs.FingerAcceleration(0, 0.5, 0.75, (0.1, 0.2))
BETWEEN = cs.ObjectRateOffset(0, 0.4, 0.6, (0.4, -0.3))  # corners of `LEGS`: 0.3, 0.7 and 0.9 s


def integrate(system, t, begin=0.0, x=None, held=None):
    """(t, x, w, held) at ascending times, integrated from each edge of a window to the next."""
    x = system.x0 if x is None else x
    held = system.held0 if held is None else held
    function, found = system.function("derivatives"), []
    knots = [begin, *(e for e in system.edges if begin < e < t[-1]), t[-1]]
    for a, b in zip(knots, knots[1:]):
        w = system.window_values(a)

        def rate(time, y, w=w, held=held):
            return function(time, y, w, held, system.parameters).full().ravel()

        run = solve_ivp(rate, (a, b), x, method="DOP853", rtol=1e-11, atol=1e-12, dense_output=True)
        found += [(time, run.sol(time), w, held) for time in t if a <= time < b]
        x = run.y[:, -1]
        if b in system.corners:
            x, held = system.turned(b, x, held, system.evaluate("carried", b, x, w, held))
    return [*found, (t[-1], x, w, held)]


def outputs(system, run, name):
    rows = [system.evaluate(name, *arguments) for arguments in run]
    return np.array(rows).reshape(len(run), -1, SIZE[name])


def error(system, t, scene=None):
    """Greatest difference from plan(): of points, pose and twist by component, and of slip and its
    acceleration by length, as the axes of two frames at one point may differ."""
    plan, run = cs.plan(scene or system.scene, 1e-13), integrate(system, t)
    points = outputs(system, run, "contact_point") - plan.points(t).reshape(len(t), -1, 6)
    pose, planned = outputs(system, run, "pose"), plan.pose(t)
    turned = pose[..., :9].reshape(len(t), -1, 3, 3).swapaxes(-1, -2) - planned[..., :3, :3]
    slip = np.linalg.norm(outputs(system, run, "slip"), axis=-1) - plan.slip_speed(t)
    acceleration = np.linalg.norm(outputs(system, run, "slip_acceleration"), axis=-1)
    acceleration -= np.linalg.norm(plan.acceleration(t), axis=-1)
    acceleration = acceleration[:-1]  # at the end of a leg: before it or after it
    twist = outputs(system, run, "twist") - plan.twist(t)
    moved = pose[..., 9:] - planned[..., :3, 3]
    return max(np.abs(part).max() for part in (points, turned, moved, slip, acceleration, twist))


@pytest.mark.parametrize("pushes", [(), (*DISTURBANCES.values(),)], ids=["calm", "disturbed"])
@pytest.mark.parametrize(
    ("obj", "coordinates"),
    [(o, c) for o in OBJECTS for c in COORDINATES if c == "frame" or SURFACES[o][0].has_chart],
)
def test_a_slipping_contact_moves_as_planned(obj, coordinates, pushes):
    scene = one_contact(obj, gain=cs.Gain.guaranteed(3.0), disturbances=pushes)
    assert error(SceneSystem(scene, coordinates), np.linspace(0, 1, 7)) < 1e-9


LEGS = (cs.Leg(0.3, 0.1, 0.3), cs.Leg(2.0, 0.15, 0.4), cs.Leg(-1.0, 0.05, 0.2))
SPEED = cs.Profile([0.1, 0.1])
JOINED = (cs.Leg(0.3, None, 0.5, SPEED), cs.Leg(0.3, None, 0.5, cs.Profile([0.15, 0, -0.6])))
MOTIONS = {
    "sigma grows and falls": {"profile": (0.05, 0.2, -0.2)},
    "from rest": {"profile": (0.0, 0.0, 0.3)},
    "pushed after a rest": {"profile": (0.0, 0.3), "disturbances": [LATE]},
    "pushed before a rest": {
        "profile": (0.64, -1.6, 1.0),
        "disturbances": [DISTURBANCES["finger"]],
    },
    "corners": {"legs": LEGS},
    "corners, pushed": {"legs": LEGS, "disturbances": [BETWEEN]},
    "legs that meet at a speed": {"legs": JOINED},
}


@pytest.mark.parametrize("gain", (cs.Gain.path(50.0), cs.Gain.time(4.0), cs.Gain.guaranteed(4.0)))
@pytest.mark.parametrize("motion", MOTIONS)
def test_slip_decays_by_every_gain_law_as_planned(motion, gain):
    for obj in ("bowl", "rounded cube"):
        scene = one_contact(obj, gain=gain, **MOTIONS[motion])
        # 1e-8: the guaranteed gain's rate has kinks, across which this integrator steps
        assert error(SceneSystem(scene, "frame"), np.linspace(0, 1, 7)) < 1e-8


def test_every_contact_turns_at_the_corners_of_its_own_legs():
    scene = one_contact("ellipsoid", legs=LEGS)
    both = [scene.contacts[0], dataclasses.replace(scene.contacts[0], legs=())]
    system = SceneSystem(scene.replace(contacts=both))
    assert error(system, np.linspace(0, 1, 9)) < 1e-9
    _, held = system.place(-0.1, [contact.start() for contact in both])  # on the first leg
    assert (held[5:11] == system.held0[5:11]).all()


@pytest.mark.parametrize("name", ("C1", "C2"))
def test_imposed_rolling_moves_as_planned(name):
    scene = cs.load_scene(name)
    assert error(SceneSystem(scene, "frame"), np.linspace(0, scene.duration, 5)) < 1e-9


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_acceleration_is_the_rate_of_the_planned_twist(coordinates):
    scene = one_contact("ellipsoid", disturbances=(cs.FingerAcceleration(0, 0.0, 1.0, (0.5, 1)),))
    system, plan = SceneSystem(scene, coordinates), cs.plan(scene, 1e-14)
    t = np.array([0.2, 0.5, 0.8])
    found = outputs(system, integrate(system, [*t, 0.9]), "acceleration")[:3]
    assert np.abs(found - derivative(plan.twist, t, 1e-2)).max() < 1e-7


@pytest.mark.parametrize("coordinates", COORDINATES)
@pytest.mark.parametrize("kind", DISTURBANCES)
def test_measured_states_restart_the_motion(kind, coordinates):
    scene = one_contact("ellipsoid", disturbances=(DISTURBANCES[kind],))
    system, plan, t = SceneSystem(scene, coordinates), cs.plan(scene, 1e-13), np.array([0.7, 1.0])
    x, held = system.from_states(0.4, plan.states(0.4)[0])
    run = integrate(system, t, 0.4, x, held)
    points = outputs(system, run, "contact_point") - plan.points(t).reshape(2, -1, 6)
    assert np.abs(points).max() < 1e-10


def test_states_that_determine_no_motion_are_refused():
    system = SceneSystem(one_contact("bowl", profile=(0.0, 0.3)), "frame")
    state = cs.plan(system.scene).states(0.5)
    for t, speed in ((0.0, "0"), (np.inf, "inf")):
        with pytest.raises(cs.SceneError, match=f"sigma = {speed}"):
            system.from_states(t, state)
    with pytest.raises(cs.SceneError, match=r"scene '.*', restart: state has shape \(9, 1\)"):
        system.from_states(0.5, state[0].T)
    with pytest.raises(cs.SceneError, match="at t = 0.5 s, contact 0: the measured state has nan"):
        system.from_states(0.5, np.full(9, np.nan))
    beyond = state.copy()
    beyond[..., 0] *= -1
    with pytest.raises(cs.SceneError, match="contact 0, finger: .* outside the chart"):
        system.from_states(0.5, beyond)


def test_drift_off_the_surface_dies_out_along_the_path():
    system = SceneSystem(one_contact(profile=(0.2,)), "frame")
    system.parameters[system.parameter_names.index("contacts[0].finger.size")] = 1.0  # as in FMUs
    off = system.x0.copy()
    off[:3] *= 1.01
    (*_, (_, x, _, _)) = integrate(system, [0.5, 1.0], x=off)
    # 0.2 m are two radii of 0.1 m
    assert np.linalg.norm(x[:3]) / 0.1 - 1 == pytest.approx(0.01 * np.exp(-2), rel=0.05)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_with_another_value_of_a_parameter_the_system_is_that_of_another_scene(coordinates):
    scene, other = cs.load_scene("K1"), cs.Sphere(0.13)
    system = SceneSystem(scene, coordinates)
    changed = SceneSystem(dataclasses.replace(scene, object=other), coordinates)
    assert len(set(system.parameter_names)) == len(system.parameters)
    p = dict(zip(system.parameter_names, system.parameters))
    assert p["gain.eta"] == 100 and p["profile[2]"] == 0.4
    p |= {"object.radius": 0.13, "object.size": 0.13}
    function = system.function("derivatives")
    found = function(0.3, changed.x0, [], changed.held0, list(p.values())).full().ravel()
    assert np.array_equal(found, changed.evaluate("derivatives", 0.3, changed.x0))


def test_edges_windows_and_dependencies_are_those_that_the_scene_needs():
    free = SceneSystem(cs.load_scene("K1"), "frame")
    assert free.n_w == 0 and free.edges == ()
    assert free.depends("contact_point") == {"x", "p"}
    disturbed = SceneSystem(cs.load_scene("D1"), "frame")
    assert disturbed.edges == (2.0, 2.5)
    assert disturbed.window_values(2.0)[4:6].tolist() == [0.6, 1.0]
    assert not disturbed.window_values(2.5).any()


def test_the_guard_is_positive_only_where_states_and_sigma_are_valid():
    system = SceneSystem(one_contact(profile=(0.1, -0.05)), "chart")
    assert system.evaluate("guard", 1.0, system.x0)[0] > 0
    assert system.evaluate("guard", 2.5, system.x0)[0] < 0  # sigma < 0
    assert not system.evaluate("guard", 1.0, system.x0 * np.nan)[0] > 0


def test_clearance_is_the_sine_of_the_angle_from_a_pole_and_negative_beyond():
    system = SceneSystem(one_contact(), "chart")
    for u in (0.3, 1e-3, -1e-3):
        x = system.x0.copy()
        x[0] = u
        assert system.evaluate("clearance", 0.5, x)[0] == pytest.approx(np.sin(u), rel=1e-12)


def test_wrong_arguments_are_refused_by_name():
    scene = cs.load_scene("K4")
    system, state = SceneSystem(scene), cs.plan(scene).states(0.5)[0]
    cases = [
        (lambda: system.place(0.5, cs.plan(scene).moments(0.5)), "moments .* in frames"),
        (lambda: system.function("slips"), "output = 'slips' .* mean 'slip'"),
        (lambda: system.depends(["pose"]), r"output = \['pose'\] is unknown"),
        (lambda: system.evaluate("slip", 0.0, system.x0[:3]), r"x has shape \(3,\); give"),
        (lambda: system.evaluate("state", None, system.x0), "t = None: give a time"),
        (lambda: system.from_states(0.5, state, [1.0]), r"w has shape \(1,\)"),
    ]
    for wrong in ("a", {}, 1j, 10**400):
        cases += [
            (lambda x=wrong: system.evaluate("state", x, system.x0), "t"),
            (lambda x=wrong: system.evaluate("state", 0.1, x), "x"),
            (lambda x=wrong: system.from_states(x, state), "t"),
            (lambda x=wrong: system.from_states(0.5, x), "state"),
        ]
    for ask, words in cases:
        with pytest.raises(cs.SceneError, match=f"scene 'K4'(, restart)?: {words}"):
            ask()


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda system: pickle.loads(pickle.dumps(system))]
)
def test_a_system_can_be_pickled_and_copied_after_it_was_evaluated(copied):
    system = cs.SceneSystem(cs.load_scene("K4"), "frame")
    expected = system.evaluate("twist", 0.1, system.x0)
    assert system.depends("slip")
    assert np.array_equal(copied(system).evaluate("twist", 0.1, system.x0), expected)


@pytest.mark.parametrize(
    ("scene", "coordinates", "message"),
    [
        (one_contact(profile=(0.0, 0.3)), "chart", 'sigma, which is zero at t = 0 .*"frame"'),
        (one_contact(legs=LEGS), "chart", 'contact 0: legs = 3: .* corner; use .*"frame"'),
        (one_contact("rounded cube"), "chart", 'contact 0: .* no explicit chart .*"frame"'),
        (one_contact(), "polar", "use one of chart, frame"),
        (
            one_contact(profile=(0, 0.3), disturbances=(cs.ObjectAcceleration(0, 0, 1, (1, 1)),)),
            "frame",
            "contact 0: sigma = 0 at t = 0 s while an acceleration acts",
        ),
    ],
)
def test_scenes_without_equations_in_these_coordinates_are_refused(scene, coordinates, message):
    with pytest.raises(cs.SceneError, match=message):
        SceneSystem(scene, coordinates)
