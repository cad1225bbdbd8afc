"""ContactPlanner and PlanSource in Drake: Simulators move contacts as plan() does."""

from __future__ import annotations

import dataclasses
import math
import pickle

import numpy as np
import pytest

pytest.importorskip("pydrake")

from conftest import in_threads
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.common import Parallelism
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.planning import DirectCollocation
from pydrake.solvers import Solve
from pydrake.symbolic import Expression, Variable
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    BatchEvalTimeDerivatives,
    Simulator,
    Simulator_,
    SimulatorConfig,
)
from pydrake.systems.framework import DiagramBuilder, InputPortSelection
from pydrake.systems.primitives import ConstantVectorSource, Linearize

import contact_system as cs
from drake_plant import BuildStation, ContactPlanner, MakeTrajectories, PlanSource

COORDINATES = ("chart", "frame")
ORDERS = {
    "bogacki_shampine3": 3,
    "explicit_euler": 1,
    "implicit_euler": 1,
    "radau1": 1,
    "radau3": 3,
    "runge_kutta2": 2,
    "runge_kutta3": 3,
    "runge_kutta5": 5,
    "semi_explicit_euler": 1,
    "velocity_implicit_euler": 1,
}
VALUES = ("state", "slip", "twist", "acceleration", "contact_point", "normal")


def simulator(planner, scheme="runge_kutta3", step=1e-3, accuracy=None, start=0.0):
    found = Simulator(planner)
    ApplySimulatorConfig(
        SimulatorConfig(
            integration_scheme=scheme,
            max_step_size=step,
            use_error_control=accuracy is not None,
            accuracy=accuracy or 1e-3,
            start_time=start,
        ),
        found,
    )
    return found


def run(planner, until, *arguments, **options):
    """The Context after a simulation until that time."""
    found = simulator(planner, *arguments, **options)
    found.AdvanceTo(until)
    return found.get_context()


def error(planner, context, plan=None):
    """Greatest distance of a contact point from the planned one, m."""
    plan = plan or cs.plan(planner.system.scene, 1e-13)
    points = planner.GetOutputPort("contact_point").Eval(context).reshape(-1, 2, 3)
    return np.linalg.norm(points - plan.points(context.get_time())[0], axis=-1).max()


def to_float(value):
    """The float of a number of any scalar type of Drake's."""
    for ask in ("value", "Evaluate"):
        value = getattr(value, ask)() if hasattr(value, ask) else value
    return float(value)


def pole_scene(aside=0.0, profile=(0.1,), duration=2.0):
    """A finger whose contact point moves towards its pole, or by an angle past it."""
    velocity = (np.cos(aside), np.sin(aside))
    contact = cs.Contact(cs.Sphere(0.04), object_at=(1.2, 0.3), finger_velocity=velocity)
    return cs.Scene(
        name="pole",
        object=cs.Sphere(0.1),
        contacts=[contact],
        profile=cs.Profile(profile),
        duration=duration,
    )


# --- integration ---------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ORDERS)
def test_every_scheme_converges_at_its_order_across_a_window(scheme):
    planner = ContactPlanner(cs.load_scene("K3"), tolerance=1.0)
    coarse, fine = (error(planner, run(planner, 0.4, scheme, h)) for h in (4e-3, 2e-3))
    assert np.log2(coarse / fine) > ORDERS[scheme] - 0.2


@pytest.mark.parametrize("name", ("K1", "K2", "K3", "K4"))
@pytest.mark.parametrize("coordinates", COORDINATES)
def test_kinematic_scenes_move_as_planned_and_no_step_crosses_an_edge(name, coordinates):
    planner = ContactPlanner(cs.load_scene(name), coordinates)
    until, step = planner.system.scene.duration, 1.3e-3  # no multiple of it is an edge
    assert error(planner, run(planner, until, "runge_kutta5", step)) < 1e-9


# --- steps that are too long ---------------------------------------------------------------------


def scene_under_gain(name, eta):
    return cs.load_scene(name).replace(gain=cs.Gain.time(eta))


@pytest.mark.parametrize(
    ("scene", "coordinates", "scheme", "step"),
    [
        (cs.load_scene("K4"), "chart", "runge_kutta3", 0.1),
        (cs.load_scene("K1"), "chart", "explicit_euler", 0.1),
        (cs.load_scene("K1"), "chart", "radau1", 0.1),
        (scene_under_gain("K4", 1e6), "frame", "explicit_euler", 0.1),
        (scene_under_gain("K1", 1e9), "chart", "runge_kutta5", 0.01),
    ],
)
def test_steps_too_long_for_a_scheme_are_refused_with_a_remedy(scene, coordinates, scheme, step):
    planner = ContactPlanner(scene, coordinates)
    with pytest.raises(cs.ContactSystemError, match=r"scene 'K\d', contact \d.*smaller steps"):
        run(planner, min(scene.duration, 2.5), scheme, step)


def test_error_control_of_too_little_accuracy_is_refused_with_the_remedy():
    planner = ContactPlanner(cs.load_scene("D1"), restart_distance=0.01)
    found = simulator(planner, "runge_kutta3", 0.1, accuracy=1e-3)
    measured = cs.plan(planner.system.scene).states(0.0)[0]
    measured[1:] = np.nan  # so that one contact restarts
    planner.GetInputPort("measured_state").FixValue(found.get_mutable_context(), measured.ravel())
    with pytest.raises(cs.SceneError, match="error control with a smaller accuracy"):
        found.AdvanceTo(2.0)


@pytest.mark.parametrize("eta", (1e3, 1e6, 1e9))
@pytest.mark.parametrize("scheme", ("radau3", "implicit_euler"))
def test_implicit_schemes_take_long_steps_however_stiff_the_gain(scheme, eta):
    planner = ContactPlanner(scene_under_gain("K4", eta), "frame", tolerance=0.1)
    assert error(planner, run(planner, 1.5, scheme, 0.01)) < 0.02


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_a_simulation_may_begin_with_other_speeds_than_the_scene_has(coordinates):
    """Steps are checked by the exact law of slip from that state on."""
    planner = ContactPlanner(cs.load_scene("K2"), coordinates)
    plan = cs.plan(planner.system.scene, 1e-13)
    faster = plan.states(0.2)[0]
    faster[:, [2, 3, 6, 7]] *= [3.0, 3.0, -2.0, 2.0]
    x, _ = planner.system.from_states(0.2, faster)
    slow, fast = (simulator(planner, "runge_kutta5", start=t) for t in (0.0, 0.2))
    fast.get_mutable_context().SetContinuousState(x)
    for until in (0.25, 0.35):  # two simulations of one system take turns
        slow.AdvanceTo(until - 0.2)
        fast.AdvanceTo(until)
    assert error(planner, slow.get_context(), plan) < 1e-9
    assert error(planner, fast.get_context(), plan.restart(0.2, faster)) < 1e-9


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_a_state_set_in_a_simulation_is_refused_without_another_initialize(coordinates):
    planner = ContactPlanner(cs.load_scene("K2"), coordinates)
    plan = cs.plan(planner.system.scene, 1e-13)
    faster = plan.states(0.2)[0]
    faster[:, [2, 3, 6, 7]] *= 3.0
    found = simulator(planner, "runge_kutta5")
    found.AdvanceTo(0.2)
    run(planner, 0.4, "runge_kutta5")  # another Context, which must not be taken for this one
    found.get_mutable_context().SetContinuousState(planner.system.from_states(0.2, faster)[0])
    with pytest.raises(cs.SceneError, match=r"another state .* call Simulator\.Initialize\(\)"):
        found.AdvanceTo(0.3)


def test_cenic_which_does_not_control_a_planners_error_is_refused():
    scene = cs.load_scene("D1")
    for step in (0.1, 1e-3, 1e-4):
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
        plant.AddRigidBody("body", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
        plant.Finalize()
        port = builder.AddSystem(ContactPlanner(scene, disturbance_input=True)).get_input_port()
        builder.Connect(builder.AddSystem(ConstantVectorSource([0] * 18)).get_output_port(), port)
        found = simulator(builder.Build(), "cenic", step, accuracy=1e-3)
        with pytest.raises(cs.SceneError, match=r"0 .finger 1.: .* off the exact.*\(not cenic"):
            found.AdvanceTo(0.5)


# --- PlanSource, a planner without states --------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "coordinates"),
    [
        ("D1", "chart"),
        *((name, "frame") for name in ("K4", "D1", "C1", "torus", "chart", "implicit", "R1")),
    ],
)
def test_the_outputs_of_a_plan_source_are_those_of_an_integrated_planner(name, coordinates):
    scene = cs.load_scene(name)
    planner, source = ContactPlanner(scene, coordinates), PlanSource(cs.plan(scene))
    until = 1.01 * planner.system.edges[0] if planner.system.edges else 0.3
    integrated = run(planner, until, "runge_kutta5", 1e-2, 1e-11)
    asked = run(source, until, step=0.1)
    for port in (*VALUES[2:], "normal_rate", "slip"):
        found, wanted = (
            system.GetOutputPort(port).Eval(context)
            for system, context in ((source, asked), (planner, integrated))
        )
        if port == "slip":  # a triaxial ellipsoid's frames may differ by half a turn
            found, wanted = np.abs(found), np.abs(wanted)
        assert np.abs(found - wanted).max() < 1e-9 * max(1.0, np.abs(wanted).max()), port
    for system, context, bar in ((source, asked, 1e-14), (planner, integrated, 1e-8)):
        X, Y = system.GetOutputPort("pose").Eval(context), cs.plan(scene).pose(until)[0]
        assert max(np.abs(x.GetAsMatrix4() - y).max() for x, y in zip(X, Y)) < bar
    state = source.GetOutputPort("state").Eval(asked)
    assert np.array_equal(state.reshape(-1, 9), cs.plan(scene).states(until)[0])
    if name == "D1":  # a sphere, whose frames do not differ
        off = planner.GetOutputPort("state").Eval(integrated).reshape(3, 9) - state.reshape(3, 9)
        off[:, [0, 1, 4, 5, 8]] = np.sin(off[:, [0, 1, 4, 5, 8]] / 2)  # but for whole turns
        assert np.abs(off).max() < 1e-6


def test_a_window_that_begins_at_the_start_acts_in_a_planner_and_a_plan_source():
    offset = cs.ObjectRateOffset(0, 0.0, 0.4, (1, 0))
    plan = cs.plan(cs.load_scene("K1").replace(disturbances=[offset]))
    planner, source = ContactPlanner(plan.scene), PlanSource(plan)
    assert error(planner, run(planner, 0.6, "runge_kutta5"), plan) < 1e-9
    context = source.CreateDefaultContext()
    for t in (0.0, 0.4):
        context.SetTime(t)
        slip = source.GetOutputPort("slip").Eval(context).reshape(-1, 2)
        assert np.allclose(slip, plan.slip(t)[0], atol=1e-12)


def test_a_plan_source_refuses_other_things_than_plans_and_times_outside_its_horizon():
    scene = cs.load_scene("K1")
    with pytest.raises(cs.ContactSystemError, match="give a Plan, such as plan"):
        PlanSource(scene)
    with pytest.raises(cs.SceneError, match="method = 'chart': give a plan of the default method"):
        PlanSource(cs.plan(scene, method="chart"))
    source = PlanSource(cs.plan(scene))
    with pytest.raises(cs.ContactSystemError, match="outside the plan's horizon"):
        source.GetOutputPort("slip").Eval(run(source, 1.1))


# --- trajectories --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ("K3", "D1", "bowl"))
def test_trajectories_follow_the_plan_and_can_be_pickled(name):
    plan = cs.plan(cs.load_scene(name))
    made = MakeTrajectories(plan, 0, 1e-4)
    kept = pickle.loads(pickle.dumps(made))
    t = np.random.default_rng(0).uniform(0.0, plan.end, 50)
    there = plan.evaluate(t, "pose", "twist", "points")
    assert (made.pose.start_time(), made.pose.end_time()) == (0.0, plan.end)
    for k, time in enumerate(t):
        X = made.pose.GetPose(time).GetAsMatrix4()
        assert np.abs(X - there["pose"][k, 0]).max() < 1e-4
        twist, (finger, obj) = there["twist"][k, 0], there["points"][k, 0]
        assert np.abs(made.twist.value(time).ravel() - twist).max() < 1e-4 * np.abs(twist).max()
        assert np.abs(made.finger_point.value(time).ravel() - finger).max() < 1e-5
        assert np.abs(made.object_point.value(time).ravel() - obj).max() < 1e-5
        for one, other in zip(vars(made).values(), vars(kept).values()):
            if hasattr(one, "value"):
                assert np.array_equal(one.value(time), other.value(time))


def test_a_trajectory_of_many_turns_makes_all_of_them():
    profile = {"profile": cs.Profile([0.8]), "duration": 3.2 * np.pi}  # 128 turns
    ball = cs.Contact(cs.Sphere(0.01), object_at=(0.0, 0.0))
    made = MakeTrajectories(cs.plan(cs.Scene(object=cs.Plane(), contacts=[ball], **profile)))
    assert np.linalg.norm(made.pose.GetVelocity(1.0)[:3]) == pytest.approx(80.0, rel=1e-3)


def test_trajectories_of_a_missing_contact_or_of_too_many_pieces_are_refused(monkeypatch):
    monkeypatch.setattr("drake_plant.trajectories.MOST", 2**10)
    plan = cs.plan(cs.load_scene("K1"))
    with pytest.raises(cs.SceneError, match="contact = 3: .* 3 contacts; give 0 to 2"):
        MakeTrajectories(plan, 3)
    with pytest.raises(cs.SceneError, match="tolerance = 1e-14 takes more than"):
        MakeTrajectories(plan, 0, 1e-14)


# --- threads -------------------------------------------------------------------------------------


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_threads_share_a_planner_with_a_context_each(coordinates):
    planner = ContactPlanner(cs.load_scene("K3"), coordinates)
    plan = cs.plan(planner.system.scene, 1e-13)
    ends = in_threads(lambda t: run(planner, t, "runge_kutta5"), (0.12, 0.16, 0.2))
    assert max(error(planner, context, plan) for context in ends) < 1e-9


def test_a_batch_evaluated_by_drake_in_two_threads_is_the_planners_derivatives():
    planner = ContactPlanner(cs.load_scene("K3"))
    context, times = run(planner, 0.1), np.linspace(0.0, 0.2, 20)
    x, no_input = context.get_continuous_state_vector().CopyToVector(), np.zeros((0, 20))
    given = np.tile(x, (20, 1)).T, no_input, InputPortSelection.kNoInput
    found = BatchEvalTimeDerivatives(planner, context, times[None], *given, Parallelism(2))
    own = context.Clone()
    for t, rates in zip(times, found.T):
        own.SetTime(t)
        assert np.array_equal(rates, planner.EvalTimeDerivatives(own).CopyToVector())


# --- ports ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_the_disturbance_port_acts_like_a_window(coordinates):
    values = {
        cs.FingerAcceleration: (2.0, -1.0),
        cs.ObjectAcceleration: (0.5, 0.7),
        cs.ObjectRateOffset: (0.3, -0.2),
    }
    scene = cs.load_scene("K1").replace(duration=0.5)
    windows = [kind(1, 0.0, 0.5, value) for kind, value in values.items()]
    planner = ContactPlanner(scene, coordinates, disturbance_input=True)
    found = simulator(planner, "runge_kutta5")
    w = np.zeros((3, 6))
    w[1] = np.concatenate([*values.values()])
    port = planner.GetInputPort("disturbance")
    port.FixValue(found.get_mutable_context(), w.ravel())
    found.AdvanceTo(0.5)
    plan = cs.plan(scene.replace(disturbances=windows), 1e-13)
    assert error(planner, found.get_context(), plan) < 1e-9


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_derivatives_of_every_scalar_type_have_the_windows_without_a_simulator(coordinates):
    planner = ContactPlanner(cs.load_scene("K4"), coordinates)  # with windows from 1 s to 2 s
    system, context = planner.system, planner.CreateDefaultContext()
    others = [planner.ToAutoDiffXd(), planner.ToSymbolic()]
    for t, inside in ((0.5, False), (1.0, True), (1.5, True), (2.0, False), (2.5, False)):
        context.SetTime(t)
        w = system.window_values(1.5 if inside else 0.5)
        expected = system.evaluate("derivatives", t, system.x0, w)
        rates = [planner.EvalTimeDerivatives(context).CopyToVector()]
        for other in others:
            found = other.CreateDefaultContext()
            found.SetTimeStateAndParametersFrom(context)
            values = other.EvalTimeDerivatives(found).CopyToVector().ravel()
            rates.append([to_float(v) for v in values])
        assert np.allclose(rates, expected, rtol=1e-10, atol=1e-10)


# --- restarts ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("off", "distance", "told"),
    [
        ((0.05, np.nan, 0.05), None, [1, 0, 1]),  # nan: this finger has lost its contact
        ((0.0, 0.009, 0.011), 1e-3, [0, 0, 1]),  # rad, on a sphere of 0.1 m
    ],
)
@pytest.mark.parametrize("coordinates", COORDINATES)
def test_contacts_that_touch_and_are_off_the_plan_restart_where_they_are(
    coordinates, off, distance, told
):
    options = {"restart_period": 0.2, "restart_distance": distance}
    planner = ContactPlanner(cs.load_scene("K1"), coordinates, **options)
    plan = cs.plan(planner.system.scene, 1e-13)
    planned = plan.states(0.2)[0]
    measured = planned.copy()
    measured[:, [0, 4, 8]] += np.array(off)[:, None]
    found = simulator(planner, "runge_kutta5")
    planner.GetInputPort("measured_state").FixValue(found.get_mutable_context(), measured.ravel())
    found.AdvanceTo(0.35)
    assert planner.GetOutputPort("restarts").Eval(found.get_context()).tolist() == told
    expected = np.where(np.array(told)[:, None], measured, planned)
    assert error(planner, found.get_context(), plan.restart(0.2, expected)) < 1e-9


# --- legs ----------------------------------------------------------------------------------------


def steered(**changes):
    """R1, slipping at the start."""
    scene = cs.load_scene("R1")
    contact = dataclasses.replace(scene.contacts[0], object_velocity=(0.3, -0.4))
    return scene.replace(**{"contacts": [contact], "gain": cs.Gain.time(1.0)} | changes)


@pytest.mark.parametrize("gain", (cs.Gain.time(1.0), cs.Gain.guaranteed(1.0)))
@pytest.mark.parametrize("until", (1.0, 2.5, 4.3))
def test_corners_are_turned_as_planned_and_at_the_end_the_contact_rests(until, gain):
    planner = ContactPlanner(steered(gain=gain))
    plan = cs.plan(steered(gain=gain, duration=5.0), 1e-13)
    assert error(planner, run(planner, until, "runge_kutta5", 1e-2, 1e-11), plan) < 1e-9


def test_a_disturbance_and_a_restart_act_on_contacts_with_legs():
    window = cs.FingerAcceleration(0, 1.3, 1.6, (2.0, -1.0))
    scene = steered(disturbances=[window])
    measured = cs.plan(scene).states(1.8)[0]
    measured[:, [0, 4, 8]] += 0.05
    for period, count in ((1.8, 1), (1.0, 0)):  # at 1.0 and 2.0 s contacts rest: no restart
        planner = ContactPlanner(scene, restart_period=period)
        found = simulator(planner, "runge_kutta5", 1e-2, 1e-11)
        port = planner.GetInputPort("measured_state")
        port.FixValue(found.get_mutable_context(), measured.ravel())
        found.AdvanceTo(2.7)
        assert planner.GetOutputPort("restarts").Eval(found.get_context()) == [count]
        plan = cs.plan(scene, 1e-13)
        plan = plan.restart(1.8, measured) if count else plan
        assert error(planner, found.get_context(), plan) < 2e-8  # of a restart 1e-9 s early


def test_simulations_with_autodiff_turn_corners_too():
    planner = ContactPlanner(steered(), tolerance=1.0)
    other = planner.ToAutoDiffXd()
    found = Simulator_[AutoDiffXd](other)
    context = found.get_mutable_context()
    for name, value in (("maximum_step_size", 0.05), ("fixed_step_mode", True)):
        getattr(found.get_mutable_integrator(), f"set_{name}")(value)
    found.AdvanceTo(1.1)
    wanted = run(planner, 1.1, step=0.05)
    x = context.get_continuous_state_vector().CopyToVector().ravel()
    wanted = wanted.get_continuous_state_vector().CopyToVector()
    assert np.allclose([to_float(v) for v in x], wanted)


def test_a_planner_is_compared_with_the_plan_again_once_its_port_is_quiet():
    planner = ContactPlanner(cs.load_scene("K1"), "frame", disturbance_input=True)
    port = planner.GetInputPort("disturbance")
    for scheme, step in ("runge_kutta3", 1e-3), ("explicit_euler", 1e-2):
        found = simulator(planner, scheme, step)
        context = found.get_mutable_context()
        port.FixValue(context, 0.1 * np.ones(18))
        found.AdvanceTo(0.5)  # no plan knows what the port will do
        port.FixValue(context, np.zeros(18))
        if scheme == "runge_kutta3":
            found.AdvanceTo(1.0)
            continue
        with pytest.raises(cs.SceneError, match="K1.*off the exact plan.*error control"):
            found.AdvanceTo(1.0)


# --- other scalars -------------------------------------------------------------------------------


def disturbed_planner(name, coordinates):
    """A planner and a Context with a disturbance, at a random state near the start."""
    planner = ContactPlanner(cs.load_scene(name), coordinates, disturbance_input=True)
    context = planner.CreateDefaultContext()
    random = np.random.default_rng(1)
    context.SetTime(0.12)
    planner.GetInputPort("disturbance").FixValue(context, 0.1 * random.normal(size=18))
    x = planner.system.x0
    context.SetContinuousState(x * (1 + 0.01 * random.normal(size=len(x))))
    return planner, context


def with_derivatives(planner, context):
    """The planner and its Context of AutoDiffXd, with derivatives along the continuous state."""
    other = planner.ToAutoDiffXd()
    found = other.CreateDefaultContext()
    found.SetTimeStateAndParametersFrom(context)
    x = context.get_continuous_state_vector().CopyToVector()
    found.SetContinuousState(InitializeAutoDiff(x).ravel())
    w = planner.GetInputPort("disturbance").Eval(context)
    other.GetInputPort("disturbance").FixValue(found, w)
    return other, found


@pytest.mark.parametrize("coordinates", COORDINATES)
@pytest.mark.parametrize("name", ("K1", "K3"))
def test_autodiff_gives_the_same_numbers_and_the_right_derivatives(name, coordinates):
    planner, context = disturbed_planner(name, coordinates)
    other, found = with_derivatives(planner, context)
    for port in VALUES:
        expected = planner.GetOutputPort(port).Eval(context)
        value = ExtractValue(other.GetOutputPort(port).Eval(found).reshape(-1, 1)).ravel()
        assert np.allclose(value, expected, rtol=1e-12, atol=1e-13)
    X, Y = (s.GetOutputPort("pose").Eval(c)[0] for s, c in ((planner, context), (other, found)))
    assert np.allclose(X.translation(), ExtractValue(Y.translation().reshape(-1, 1)).ravel())
    jacobian = ExtractGradient(other.EvalTimeDerivatives(found).CopyToVector().reshape(-1, 1))
    ports = [planner.GetInputPort("disturbance"), planner.GetOutputPort("slip")]
    at = [port.get_index() for port in ports]
    linear = Linearize(planner, context, *at, equilibrium_check_tolerance=np.inf)
    assert np.allclose(linear.A(), jacobian) and linear.B().shape == (len(jacobian), 18)
    x, columns = context.get_continuous_state_vector().CopyToVector(), []
    for e in 1e-6 * np.eye(len(x)):
        pair = []
        for moved in (x + e, x - e):
            context.SetContinuousState(moved)
            pair.append(planner.EvalTimeDerivatives(context).CopyToVector())
        columns.append((pair[0] - pair[1]) / 2e-6)
    expected = np.stack(columns, axis=1)
    assert np.abs(jacobian - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("coordinates", COORDINATES)
@pytest.mark.parametrize("name", ("K1", "K3"))
def test_symbolic_derivatives_evaluate_to_the_numbers(name, coordinates):
    planner, context = disturbed_planner(name, coordinates)
    symbolic = planner.ToSymbolic()
    found, t = symbolic.CreateDefaultContext(), Variable("t")
    x = context.get_continuous_state_vector().CopyToVector()
    variables = [Variable(f"x{k}") for k in range(len(x))]
    found.SetTimeStateAndParametersFrom(context)
    found.SetTime(Expression(t))
    found.SetContinuousState(np.array([Expression(v) for v in variables]))
    w = np.array([Expression(v) for v in planner.GetInputPort("disturbance").Eval(context)])
    symbolic.GetInputPort("disturbance").FixValue(found, w)
    environment = {**dict(zip(variables, x)), t: 0.12}
    rates = symbolic.EvalTimeDerivatives(found).CopyToVector().ravel()
    values = np.array([rate.Evaluate(environment) for rate in rates])
    expected = planner.EvalTimeDerivatives(context).CopyToVector()
    assert np.abs(values - expected).max() <= 1e-13 * np.abs(expected).max()


def test_direct_collocation_of_a_constant_profile_ends_where_the_plan_does():
    scene = cs.load_scene("K1").replace(profile=cs.Profile([0.1]), gain=cs.Gain.time(5.0))
    planner = ContactPlanner(scene, "frame", disturbance_input=True)
    port, start = planner.GetInputPort("disturbance"), planner.system.x0
    samples, step = 11, 0.05
    collocation = DirectCollocation(
        planner, planner.CreateDefaultContext(), samples, step, step, port.get_index()
    )
    program, end = collocation.prog(), collocation.final_state()
    program.AddBoundingBoxConstraint(start, start, collocation.initial_state())
    for k in range(samples):
        program.AddBoundingBoxConstraint(0.0, 0.0, collocation.input(k))
        program.SetInitialGuess(collocation.state(k), start)
    result = Solve(program)
    context = planner.CreateDefaultContext()
    context.SetTime(step * (samples - 1))
    context.SetContinuousState(result.GetSolution(end))
    assert result.is_success()
    assert error(planner, context, cs.plan(scene)) < 1e-6


NOT_NUMBERS = {
    "disturbance": "scene 'K1', contact 1 .finger 2.: the disturbance at t = 0 s",
    "state": "contact 2 .finger 3.: the state at t = 0 s is .*must be finite",
    "time": "scene 'K1', contact 0 .finger 1.: at t = nan s",
}


@pytest.mark.parametrize("what", NOT_NUMBERS)
@pytest.mark.parametrize("coordinates", COORDINATES)
def test_nan_in_disturbance_state_or_time_is_refused_by_name(coordinates, what):
    planner = ContactPlanner(cs.load_scene("K1"), coordinates, disturbance_input=True)
    found = simulator(planner)
    context, w = found.get_mutable_context(), np.zeros(18)
    x = context.get_mutable_continuous_state_vector()
    w[8] = np.nan if what == "disturbance" else 0.0
    planner.GetInputPort("disturbance").FixValue(context, w)
    if what == "state":
        x.SetAtIndex(22 if coordinates == "chart" else x.size() - 4, np.nan)
    if what == "time":
        context.SetTime(math.nan)
    asks = [lambda: planner.EvalTimeDerivatives(context)]
    if what == "state" and coordinates == "chart":  # u2 of contact 2, which outputs depend on
        asks += [lambda p=p: planner.GetOutputPort(p).Eval(context) for p in (*VALUES, "pose")]
    if what != "time":
        asks += [lambda: found.AdvanceTo(0.1)]
    for ask in asks:
        with pytest.raises(cs.ContactSystemError, match=NOT_NUMBERS[what]):
            ask()


# --- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", ({}, {"step": 0.1, "accuracy": 1e-6}, {"scheme": "radau3"}))
def test_a_chart_near_its_pole_is_refused_and_frame_coordinates_are_named(options):
    message = "scene 'pole', contact 0, finger: at t = 0.62.*a pole.*coordinates=\"frame\""
    with pytest.raises(cs.ChartSingularity, match=message):
        run(ContactPlanner(pole_scene(0.001)), 1.5, **options)


def test_a_simulation_that_starts_later_needs_the_state_of_that_time():
    for scene in map(cs.load_scene, ("R1", "K4")):
        late = Simulator(ContactPlanner(scene))
        late.get_mutable_context().SetTime(1.5)
        with pytest.raises(cs.SceneError, match="t = 1.5 s with the state of t = 0 s: set"):
            late.Initialize()
    state, _ = cs.SceneSystem(scene).from_states(1.5, cs.plan(scene).states(1.5)[0])
    late.get_mutable_context().SetContinuousState(state)
    late.Initialize()


def test_too_long_steps_are_refused_also_in_a_scene_that_starts_at_rest():
    scene = cs.load_scene("bowl")  # sigma(0) = 0; slip is integrated, as an acceleration acts later
    planner = ContactPlanner(scene, "frame")
    assert error(planner, run(planner, 2.0, "runge_kutta5")) < 1e-9
    stiff = ContactPlanner(scene.replace(gain=cs.Gain.path(1e7)), "frame")
    with pytest.raises(cs.SceneError, match=r"contact 0: .* off the exact plan"):
        run(stiff, 2.0, "explicit_euler", 0.01)


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_beyond_the_horizon_the_motion_goes_on_until_sigma_turns_negative(coordinates):
    planner = ContactPlanner(pole_scene(1.2, (0.1, -0.05), duration=1.5), coordinates)
    longer = cs.plan(planner.system.scene.replace(duration=1.9), 1e-13)
    assert error(planner, run(planner, 1.9, "runge_kutta5"), longer) < 1e-9
    message = r"sigma = -.* the scene runs from 0 to 1\.5 s: .* or change the profile"
    with pytest.raises(cs.SceneError, match=message):
        run(planner, 2.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"restart_period": 0}, "'K1': restart_period = 0: give a finite number"),
        ({"restart_distance": -1}, "'K1': restart_distance = -1: give a finite number"),
        ({"disturbance_input": "no"}, "disturbance_input = 'no': give True or False"),
        ({"coordinates": "frames"}, "'frames' is unknown .*'frame'.*use one of chart, frame"),
    ],
)
def test_options_of_wrong_value_are_refused(options, message):
    with pytest.raises(cs.SceneError, match=message):
        ContactPlanner(cs.load_scene("K1"), **options)
    for make, wrong in ((ContactPlanner, "K4"), (BuildStation, "K4")):
        with pytest.raises(cs.SceneError, match="scene = .*: give a Scene, such as load_scene"):
            make(wrong)
