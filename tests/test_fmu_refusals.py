"""What FMUs and slaves refuse, with which messages, and that they work afterwards."""

from __future__ import annotations

import ctypes
import logging
import math

import numpy as np
import pytest
from conftest import of_blocks, of_kinds, of_versions, one_contact

import contact_system as cs

pytest.importorskip("fmpy")

from fmu_hosts.blocks import Instance, close, simulated, simulated_states

from fmu_export import PlannerSlave2, PlannerSlave3, variable_table

K1, K3, K4 = (cs.load_scene(name) for name in ("K1", "K3", "K4"))
PUSH = "contact[1].finger.acceleration.u"
BALL = cs.ParametricSurface(
    ("r*sin(u)*cos(v)", "r*sin(u)*sin(v)", "r*cos(u)"), parameters={"r": 0.1}, size=0.1
)
LINE = {"profile[1]": 0.3, "profile[2]": -0.2, "profile[3]": 0.0}
"""Start values of a profile that is zero at 1.5 s and negative afterwards."""


# --- values


@of_blocks
def test_wrong_values_are_refused_by_name_value_and_remedy_and_change_nothing(kind, version):
    one = Instance(K1, kind, version).begin()
    inputs = [v.name for v in one.table.rows if v.causality == "input"]
    before = one.everything()
    for name in inputs:
        for value in (math.nan, math.inf, -math.inf):
            words = rf"{name} = {value} is refused; give a finite number".replace("[", r"\[")
            one.refused(words, one.put, {name: value})
    for name, value, words in (
        ("gain.eta", -1.0, r"gain.eta = -1(.0)? is refused; give 0"),
        ("object.radius", 0.2, "object.radius.* is fixed; set it before"),
        ("contact[2].frame.slip.x", 0.1, r"contact\[2\].frame.slip.x.* is a start value"),
        ("contact[1].angle", 0.1, r"contact\[1\].angle.* is calculated"),
    ):
        one.refused(words, one.put, {name: value})
    names = ("getReal", "setReal") if version == "2.0" else ("getFloat64", "setFloat64")
    read, write = (getattr(one.own, name) for name in names)
    one.refused("value reference 4000", read, [4000])
    one.refused("value reference 4000", write, [4000], [1.0])
    good, bad = (one.reference(f"contact[{k}].finger.acceleration.u") for k in (1, 2))
    one.refused("nan", write, [good, bad], [0.3, math.nan])  # a call sets all its values or none
    assert np.array_equal(one.everything(), before)
    one.step(1.0)
    close(one.states(), cs.plan(K1).states(1.0)[0])


TURNED = cs.Quadric([[30.0, 5.0, 0.0], [5.0, 40.0, 0.0], [0.0, 0.0, 100.0]])
RINGED = one_contact(TURNED, cs.Torus(0.05, 0.02)).replace(name="a*/b\u00e9")
OF_QUADRIC = next(v.name for v in variable_table(RINGED).rows if v.name.startswith("object."))


@of_blocks
@pytest.mark.parametrize(
    ("scene", "start", "words"),
    [
        (K1, {"object.radius": 0.0}, r"object.radius = 0(.0)? is refused; give 1e-06 or more"),
        (K3, {"object.a": 0.2}, "object.a = 0.2 is refused: it must be greater than object.b ="),
        (K3, {"object.c": 0.25}, "object.b = 0.2 .* it must be greater than object.c = 0.25"),
        (RINGED, {"contact[1].finger.minor": 0.06}, r"finger.major = 0.05 is refused: it must"),
        (K3, {"disturbance[1].stop": 0.1}, r"stop = 0.1 is refused: it must be .*start = 0.1"),
        (RINGED, {OF_QUADRIC: 5.0}, r" = 5(.0)? is refused now: it is constant, as the numbers of"),
    ],
)
def test_start_values_that_contradict_each_other_are_refused(scene, start, words, kind, version):
    one = Instance(scene, kind, version)
    one.refused(words, lambda: one.begin(start=start))
    Instance(K3, kind, version).begin(start={"object.a": 0.15, "object.b": 0.12})


@of_blocks
def test_a_start_at_a_pole_or_with_its_frame_off_the_surface_is_refused(kind, version):
    at_pole = one_contact(BALL, object_at=(0.3, 0.5), duration=0.1)
    for scene, start, words in (
        (at_pole, {"contact[1].object.frame.u": 0.0}, "the path reaches a singular point"),
        (K1, {"contact[1].finger.frame.point.x": 0.0}, "the finger's frame is not on its surface"),
    ):
        one = Instance(scene, kind, version)
        one.refused(words, lambda: one.begin(start=start))  # noqa: B023


@of_blocks
@pytest.mark.parametrize(("what", "u"), [("states", 0.0), ("states", -0.5), ("pose", None)])
def test_a_measurement_off_the_chart_or_without_a_contact_is_ignored(what, u, kind, version):
    given = {"measured": what} | ({"eventModeUsed": True} if version == "3.0" else {})
    one, other = (Instance(K4, kind, version, **given).begin() for _ in range(2))
    for block in (one, other):
        if version == "3.0":
            block.own.enterStepMode()
        block.step(0.5)
    off = {} if u is None else {"contact[2].measured.finger.u": u}
    one.put(off | {"contact[2].measured.trigger": 1.0})  # the pose is still that at the start
    one.refused(r"contact\[2\].*no step.*measure", one.step, 0.1)
    one.put({"contact[2].measured.trigger": 2.0})
    one.refused("no values", one.directional, ["der(contact[1].finger.u)"], [PUSH], [1.0])
    for block in (one, other):
        block.step(0.1)
    assert one.states().tolist() == other.states().tolist()


@of_kinds
def test_start_values_can_be_read_before_initialization(kind):
    """FMI 3.0.2, 2.3.2: those of the description or those set. FMI 2 has no values before."""
    one = Instance(K1, kind, "3.0")
    one.put({"gain.eta": 7.0})
    point = K1.contacts[0].object_at[0]
    name = "contact[1].object.frame.point.z"
    assert one.get("gain.eta", name) == pytest.approx([7.0, 0.1 * math.cos(point)], rel=1e-15)
    one.refused("has no start value", one.get, "contact[1].angle")
    one.begin()


# --- steps and the order of calls


@of_blocks
def test_steps_of_wrong_size_or_time_are_refused_and_the_instance_works_on(kind, version):
    one = Instance(K1, kind, version).begin(stop=0.9)
    one.step(0.5)
    for step in (-0.1, 0.0, math.nan):
        one.refused("give a positive", one.own.doStep, 0.5, step)
    for time in (0.4, 0.5 + 1e-6):
        one.refused("instance stands at t = 0.5", one.own.doStep, time, 0.1)
    one.own.doStep(0.5 + 1e-12, 0.1)  # by rounding, where an importer adds up steps
    for start, stop in ((-1.0, None), (math.nan, None), (1.0, 0.5)):
        other = Instance(K1, kind, version)
        other.refused("give 0 <= start", other.begin, start, stop)


@of_blocks
def test_calls_out_of_order_are_refused(kind, version):
    one = Instance(K1, kind, version)
    for state in ("instantiated", "step mode", "terminated"):
        words = f"not allowed in the state '{state}', only in: "
        if state == "terminated":
            one.own.terminate()
        if state != "instantiated":
            one.refused(words, one.own.enterInitializationMode)
        if state != "step mode":
            one.refused(words, one.own.doStep, 0.0, 0.1)
            one.refused(words, one.own.exitInitializationMode)
        if state == "instantiated":
            one.refused(words, one.own.terminate)
            one.begin()
    one.own.reset()
    one.begin()
    assert one.get("contact[1].object.u") == pytest.approx(K1.contacts[0].object_at[0], rel=1e-15)


def test_functions_that_the_model_has_no_use_for_are_refused_by_name():
    two, three = (Instance(K1, "slave", version).begin() for version in ("2.0", "3.0"))
    two.refused("fmi2SetInteger: there are no variables of", two.own.setInteger, [1], [1])
    three.refused("fmi3GetInt32: there are no variables of", three.own.getInt32, [1])
    two.refused("unknown category 'logAll'", two.own.setDebugLogging, True, ["logAll"])
    three.refused("made without event mode", three.own.enterEventMode)
    stepped, solved = (Instance(K1, "FMU", "2.0", x) for x in ("CoSimulation", "ModelExchange"))
    real, integer = (ctypes.c_double * 33)(), (ctypes.c_int * 1)(1)
    reference = (ctypes.c_uint * 1)(stepped.reference(PUSH))
    for one, function, arguments in (
        (solved, "fmi2SetRealInputDerivatives", (reference, 1, integer, real)),
        (stepped, "fmi2GetNominalsOfContinuousStates", (real, 33)),
    ):
        sizes = [ctypes.c_size_t(x) if isinstance(x, int) else x for x in arguments]
        called = getattr(one.own.dll, function)
        assert called(ctypes.c_void_p(one.own.component), *sizes) == 3
        assert f"{function}: the instance was made for" in one.said[-1][2]


@of_blocks
def test_refusals_are_logged_even_with_logging_off(kind, version, caplog):
    one = Instance(K1, kind, version)
    if kind == "slave":  # without a logger of the user's own
        one.own = {"2.0": PlannerSlave2, "3.0": PlannerSlave3}[version](K1)
    one.begin()
    one.own.setDebugLogging(False, [])
    with caplog.at_level(logging.INFO, "fmu_export"):
        one.refused("", one.put, {"gain.eta": -1.0})
        one.refused("", one.own.doStep, 0.0, -0.1)
    lines = [r.getMessage() for r in caplog.records] or [f"{c}: {text}" for _, c, text in one.said]
    assert lines[-1].startswith("logStatusError: ")
    if kind == "slave":
        assert lines[0] == "logStatusDiscard: gain.eta = -1 is refused; give 0 or more"


def test_options_of_the_wrong_kind_are_refused():
    for option, wrong in (("logger", "log"), ("event_mode", "no"), ("early_return", None)):
        with pytest.raises(cs.ContactSystemError, match=f"{option} = {wrong!r}: give "):
            PlannerSlave3(one_contact(), **{option: wrong})


# --- where sigma turns negative or the path ends


@pytest.mark.parametrize(("version", "end"), [("2.0", 1.4), ("3.0", 1.5)])
def test_an_importer_stops_where_sigma_turns_negative(version, end):
    # FMI 2 has no early return: at the last communication point before
    scene, given = K1.replace(profile=cs.Profile([0.3, -0.2])), {"output_interval": 0.2}
    given |= {"early_return_allowed": True} if version == "3.0" else {}
    result = simulated(scene, version, stop_time=3.0, **given)
    assert result["time"][-1] == pytest.approx(end, abs=1e-15)


@of_blocks
def test_a_profile_that_is_negative_at_the_start_is_refused_there_and_later_ones_at_their_step(
    kind, version
):
    one = Instance(K1, kind, version)
    start = LINE | {"profile[1]": 0.0}
    one.refused("is negative", lambda: one.begin(start=start))
    late = Instance(K1, kind, version)
    late.refused("is negative from t = 1.6 s on", lambda: late.begin(1.6, start=LINE))
    short = Instance(K1.replace(duration=1e-3), kind, version).begin(start=LINE)
    short.refused("is negative from t = 1.5 s on", short.step, 2.0)
    short.step(1.5)
    short.put({"contact[1].object.rate_offset.u": 0.1})
    close(short.states()[0, 6], 0.1)  # u' of the object, which the path does not move any more
    short.refused("is negative from t = 1.5 s on", short.step, 0.5)


@of_blocks
def test_a_profile_that_touches_zero_up_to_rounding_does_not_end_the_motion(kind, version):
    # 0.7 (t - 0.4)^2, whose least value in doubles is -3e-17 m/s
    start = {"profile[1]": 0.112, "profile[2]": -0.56, "profile[3]": 0.7}
    one = Instance(K1, kind, version).begin(start=start)
    one.step(1.0)
    close(one.states(), cs.plan(K1.replace(profile=cs.Profile([*start.values()]))).states(1.0)[0])


@of_versions
def test_model_exchange_ends_where_sigma_turns_negative(version):
    scene = K1.replace(profile=cs.Profile([*LINE.values()]), duration=1.5)
    options = {"fmi_type": "ModelExchange", "solver": "CVode", "start_values": LINE}
    options |= {"output_interval": 0.05, "step_size": 0.05}
    result = simulated(K1, version, stop_time=2.0, **options)
    assert result["time"][-1] == pytest.approx(1.5, abs=1e-15)  # the FMU ends the simulation
    planned = cs.plan(scene).states(np.minimum(result["time"], 1.5))
    close(simulated_states(result, planned), planned, 1e-7)
    one, rate = Instance(K1, "FMU", version, "ModelExchange").begin(start=LINE), "der({}.u)"
    rate, events = rate.format("contact[1].finger"), []

    def update():
        own = one.own
        flags = own.newDiscreteStates() if version == "2.0" else own.updateDiscreteStates()
        events.append((flags[-1] if flags[-2] else None, bool(flags[1])))  # next event, terminate

    update()
    one.own.enterContinuousTimeMode()
    one.own.setTime(1.55)  # solvers evaluate beyond the event before they find it: the path rests
    assert one.get(rate)[0] == pytest.approx(0.0, abs=1e-15)
    one.own.setTime(1.5)
    one.own.enterEventMode()
    update()
    assert events == [(pytest.approx(1.5, abs=1e-15), False), (None, True)]
    one.own.enterContinuousTimeMode()
    one.own.setTime(1.55)
    words = "sigma is negative from t = 1.5 s on; end there"
    one.refused(words, one.get, rate)
    one.refused(words, one.directional, [rate], ["gain.eta"], [1.0])


@of_blocks
def test_steps_end_where_a_profile_of_high_degree_turns_negative(kind, version):
    one = Instance(one_contact(profile=(0.1, *[0.0] * 62, -1e-48)), kind, version).begin()
    one.refused("sigma is negative from t = 5.57", one.step, 6.0)


@of_versions
def test_model_exchange_has_no_values_at_a_pole_of_a_users_chart(version):
    scene = one_contact(BALL, object_at=(0.3, 0.5), duration=0.2)
    one = Instance(scene, "FMU", version, "ModelExchange").begin()
    if version == "3.0":
        one.own.updateDiscreteStates()
    one.put({"contact[1].object.frame.u": 0.0})
    one.refused("at a singular point of a chart", one.get, "der(contact[1].object.frame.u)")


@of_blocks
def test_after_a_step_that_failed_a_shorter_one_may_be_tried(kind, version):
    """FMI 2.0.4, 4.2.2, fmi2Discard; FMI 3.0.2, 2.2.3: the failed step has changed nothing."""
    scene = one_contact(profile=(0.3, -0.3))
    one = Instance(scene, kind, version).begin(start={PUSH: 0.1})
    one.step(0.5)
    before = one.everything()
    for _ in range(2):
        one.refused("(?s)status 2.*sigma is zero", one.step, 0.5)
        assert np.array_equal(one.everything(), before)
    one.step(0.4)
    window = cs.FingerAcceleration(0, 0.0, 0.9, (0.1, 0.0))
    close(one.states(), cs.plan(scene.replace(duration=0.9, disturbances=[window])).states(0.9)[0])
    one.own.terminate()
    one.own.reset()
    one.begin()


@of_versions
def test_a_step_that_would_take_too_many_pieces_is_refused(version):
    start = {"object.a": 3e-5, "object.b": 2e-5, "object.c": 1e-5}
    one = Instance(K4, "FMU", version).begin(start=start | {"profile[2]": 0.0, "profile[3]": 0.0})
    one.refused("too long", one.step, 50.0)
    one.step(1e-3)
    one.put({PUSH: 1e100})  # no plan can be made with it, and so there are no derivatives
    one.refused("too fast", one.directional, ["der(contact[1].frame.slip.x)"], [PUSH], [1.0])
    slow = Instance(one_contact(profile=(1e-6,)), "FMU", version).begin(start={PUSH: 1e6})
    slow.refused("too long", slow.step, 1.0)  # it does not rest


@of_blocks
@pytest.mark.parametrize(("profile", "at"), [((0.0, 1.0), 0.0), ((0.09, -0.6, 1.0), 0.3)])
def test_an_acceleration_where_sigma_is_zero_can_be_set_and_read_but_no_step_be_made(
    profile, at, kind, version
):
    """All values but the rates and their derivatives can still be read."""
    scene = one_contact(profile=profile, duration=0.2)
    one = Instance(scene, kind, version).begin()
    if at:
        one.step(at)
    one.put({PUSH: 0.5})
    kept, rate = one.state(), "der(contact[1].finger.u)"
    expected = cs.plan(scene.replace(duration=0.4), 1e-14)
    coordinates = ["finger.u", "finger.v", "object.u", "object.v", "angle"]
    for _ in range(2):
        seen = one.get(*(f"contact[1].{name}" for name in coordinates))
        close(seen, expected.states(at)[0, 0, [0, 1, 4, 5, 8]])
        one.refused("sigma is zero", one.own.doStep, at, 0.1)
    one.restore(one.read(one.written(kept)), at).put({PUSH: 0.0})
    assert one.get(rate) == pytest.approx([0.0], abs=1e-15)
    one.step(0.1)
    close(one.states(), expected.states(at + 0.1)[0])


@of_blocks
def test_an_acceleration_where_sigma_is_zero_makes_rates_and_their_derivatives_invalid(
    kind, version
):
    one = Instance(one_contact(profile=(0.0, 1.0), gain=cs.Gain.guaranteed(3.0)), kind, version)
    one.own.enterInitializationMode()
    rate, slip = "der(contact[1].frame.velocity.x)", "contact[1].frame.slip.x"
    words = r"der\(contact\[1\].frame.velocity.x\) has no value at t = 0 s: sigma is zero"
    one.refused(words, one.directional, [rate], [PUSH], [1.0])
    one.put({PUSH: 0.5})
    if version == "3.0":  # nor with respect to a known that it does not depend on
        one.refused(words, one.product, "Adjoint", [rate], ["contact[1].finger.radius"], [1.0])
    one.refused(words, one.get, rate)  # this once was 4e+297 with status OK
    one.put({PUSH: 0.0})
    assert one.get(rate) == [0.0]
    # under this law slip is gone at rest, whatever V is
    assert one.get(f"der({slip})") == one.directional([f"der({slip})"], [slip], [1.0]) == [0.0]
