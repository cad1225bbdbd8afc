"""Exported FMUs, run by fmpy: against plans, against themselves, against misuse."""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from conftest import PAST_UMBILICS

import contact_system as cs
from contact_system.system import SceneSystem

pytest.importorskip("fmpy")

import fmpy
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Model, FMU3Slave
from fmu_hosts import EVERYTHING
from fmu_hosts.native import Fmu

from fmu_export import export_fmu, variable_table
from fmu_export.build import FMI_HEADERS, PLATFORMS, write_fmu
from fmu_export.model import STATES, contact_results

VERSIONS = ("2.0", "3.0")
KINEMATIC = ("K1", "K2", "K3", "K4")
OVER_POLE = cs.Scene(
    object=cs.Sphere(0.1),
    contacts=[cs.Contact(cs.Sphere(0.04), object_at=(0.3, 0.5), finger_at=(1.2, 0.3), angle=0.0,
                         finger_velocity=(-1.0, 0.0))],
    profile=cs.Profile([0.1]), gain=cs.Gain.path(100.0), duration=0.5, name="over_pole",
)  # fmt: skip
"""Along a meridian of the object, through its pole at 0.3 s."""


class Exported:
    """An FMU on disk, its table, and instances of it."""

    def __init__(self, scene, version, folder):
        self.scene, self.version, self.table = scene, version, variable_table(scene)
        self.path = export_fmu(scene, folder / f"{scene.name}_{version}.fmu", version)
        self.fmu = Fmu.unpacked(self.path, folder / f"{scene.name}_{version}")
        self.folder, self.messages = self.fmu.folder, []

    def reference(self, name):
        return self.table[name].reference

    def simulate(self, step, **options):
        options = {"fmi_type": "CoSimulation", "stop_time": self.scene.duration} | options
        return fmpy.simulate_fmu(
            str(self.folder), model_description=self.fmu.description, step_size=step,
            output_interval=step, relative_tolerance=1e-10, **options,
        )  # fmt: skip

    def instance(self, interface="CoSimulation", start=None, ready=True, **options):
        """An instance, initialized if ``ready``; ``start``: name -> value."""
        fmu = self.fmu.instance(lambda *said: self.messages.append(said), interface, **options)
        if start:
            self.set(fmu, start)
        if ready:
            self.initialize(fmu)
        return fmu

    def initialize(self, fmu, time=0.0):
        if self.version == "2.0":
            fmu.setupExperiment(startTime=time)
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(startTime=time)
        fmu.exitInitializationMode()

    def set(self, fmu, values):
        put = fmu.setReal if self.version == "2.0" else fmu.setFloat64
        for name, value in values.items():
            put([self.reference(name)], np.atleast_1d(value).tolist())

    def get(self, fmu, *names):
        if self.version == "2.0":
            return np.array(fmu.getReal([self.reference(n) for n in names]))
        return np.array(fmu.getFloat64([self.reference(n) for n in names]))

    def step(self, fmu, time, size):
        return fmu.doStep(currentCommunicationPoint=time, communicationStepSize=size)

    def states(self, fmu):
        """u1 v1 u1' v1' u2 v2 u2' v2' psi of every contact, as `Plan.states` has them."""
        return self.get(fmu, *(n for i in range(len(self.scene.contacts)) for n in columns(i)))


def columns(i):
    c = f"contact[{i + 1}]."
    finger, obj = [[f"{c}{side}.u", f"{c}{side}.v"] for side in ("finger", "object")]
    return [*finger, *(f"der({n})" for n in finger), *obj, *(f"der({n})" for n in obj), c + "angle"]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    known = {}
    folder = tmp_path_factory.mktemp("fmu")

    def get(scene, version="2.0"):
        scene = cs.load_scene(scene) if isinstance(scene, str) else scene
        key = (scene.name, version)
        if key not in known:
            known[key] = Exported(scene, version, folder)
        known[key].messages.clear()
        return known[key]

    return get


def relative(found, wanted):
    return np.abs(found - wanted).max() / max(1.0, np.abs(wanted).max())


def worst_difference(fmu, result, plan=None):
    """Greatest difference of a simulation's states, slip, twist, pose and points from the plan."""
    plan = plan or cs.plan(fmu.scene)
    t = np.minimum(result["time"], fmu.scene.duration)

    def read(name):
        row = fmu.table[name]
        if fmu.version == "3.0":
            return result[name].reshape(len(t), -1)
        return np.stack([result[e] for e in row.elements], axis=1)

    worst = 0.0
    states, slip, twist, pose = plan.states(t), plan.slip(t), plan.twist(t), plan.pose(t)
    points = plan.points(t)
    for i in range(len(fmu.scene.contacts)):
        c = f"contact[{i + 1}]."
        pairs = [(np.stack([result[n] for n in columns(i)], axis=1), states[:, i])]
        pairs += [
            (read(c + "slip"), slip[:, i]),
            (read(c + "twist.angular"), twist[:, i, :3]),
            (read(c + "twist.linear"), twist[:, i, 3:]),
            (read(c + "pose.rotation"), pose[:, i, :3, :3].reshape(len(t), 9)),
            (read(c + "pose.position"), pose[:, i, :3, 3]),
            (read(c + "finger.point"), points[:, i, 0]),
            (read(c + "object.point"), points[:, i, 1]),
        ]
        for found, wanted in pairs:
            size = max(np.abs(wanted).max(), 1e-6)
            worst = max(worst, np.abs(found - wanted).max() / size)
    return worst


# --- motion --------------------------------------------------------------------------------------


def over_position(result, version):
    name = "contact[1].pose.position"
    if version == "3.0":
        return result[name]
    return np.stack([result[f"{name}.{axis}"] for axis in "xyz"], axis=1)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", KINEMATIC)
@pytest.mark.parametrize("step", [1e-2, 0.3])
def test_steps_of_any_size_follow_the_plan(name, version, step, exported):
    fmu = exported(name, version)
    assert worst_difference(fmu, fmu.simulate(step)) < 1e-12


@pytest.mark.parametrize("name", ["C1", "C2", "D1", "chart"])
def test_other_scenes_follow_their_plans(name, exported):
    fmu = exported(name)
    assert worst_difference(fmu, fmu.simulate(0.01)) < 1e-12


@pytest.mark.parametrize("scene", PAST_UMBILICS, ids=lambda scene: scene.name)
@pytest.mark.parametrize("step", [0.01, 0.4])
def test_paths_close_to_umbilics_stay_on_their_branch(scene, step, exported):
    fmu = exported(scene)
    assert worst_difference(fmu, fmu.simulate(step)) < 1e-8


def test_a_chart_that_is_a_python_function_exports_like_any_other(exported):
    ground = cs.ParametricSurface(
        lambda u, v, size, k: (u, v, size * np.sin(6 * u) * np.cos(k * v)),
        parameters={"size": 0.05, "k": 5.0},  # a name that surfaces have a use for themselves
    )
    contact = cs.Contact(finger=cs.Sphere(0.04), object_at=(0.1, 0.2), object_velocity="rest")
    scene = cs.Scene(
        object=ground, contacts=[contact], profile=cs.Profile([0.1]), duration=1, name="function"
    )
    fmu = exported(scene)
    assert worst_difference(fmu, fmu.simulate(0.05)) < 1e-12


@pytest.mark.parametrize("push", [0.0, 0.05])
def test_a_path_straight_through_a_pole_of_a_users_chart_ends_there(push, exported):
    ball = cs.ParametricSurface(
        ("r*sin(u)", "r*sin(v)*cos(u)", "r*cos(v)*cos(u)"), parameters={"r": 0.1}, size=0.1
    )
    contact = cs.Contact(
        cs.Plane(), (np.pi / 2 - 0.5, 0.0), (0.0, 0.0), finger_velocity=(1.0, 0.0)
    )
    scene = cs.Scene(
        object=ball, contacts=[contact], profile=cs.Profile([0.1]), duration=0.4, name="own_pole"
    )
    window = cs.FingerAcceleration(0, 0.0, 0.4, (push, 0.0))
    expected = cs.plan(scene.replace(disturbances=[window])).points(0.4)[0, 0, 1]
    fmu = exported(scene)
    one = fmu.instance(start={"contact[1].finger.acceleration.u": push})
    for k in range(4):
        fmu.step(one, 0.1 * k, 0.1)
    names = [f"contact[1].object.point.{axis}" for axis in "xyz"]
    assert fmu.get(one, *names) == pytest.approx(expected, abs=1e-13)
    with pytest.raises(FMICallException):
        fmu.step(one, 0.4, 0.4)
    assert "the path reaches a singular point of its chart" in fmu.messages[-1][2]
    assert fmu.get(one, *names) == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("version", VERSIONS)
def test_fine_and_random_steps_end_in_the_same_bits(version, exported):
    fmu = exported("K4", version)
    ends = []
    random = np.random.default_rng(5)
    for grid in (
        np.array([0.0, 1.7]),
        np.linspace(0.0, 1.7, 17001),
        np.array([0.0, *np.sort(random.uniform(0.0, 1.7, 200)), 1.7]),
    ):
        one = fmu.instance()
        for a, b in zip(grid, grid[1:]):
            fmu.step(one, a, b - a)
        ends.append(fmu.states(one))
        one.freeInstance()
    assert relative(ends[1], ends[0]) < 1e-15
    assert relative(ends[2], ends[0]) < 1e-15


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", KINEMATIC)
def test_model_exchange_with_cvode_follows_the_plan(name, version, exported):
    fmu = exported(name, version)
    result = fmu.simulate(0.05, fmi_type="ModelExchange", solver="CVode", record_events=False)
    assert worst_difference(fmu, result) < 1e-7


GUARANTEED = cs.load_scene("K1").replace(
    name="dip", profile=cs.Profile([0.3, -0.84, 2.0, -4 / 3]), gain=cs.Gain.guaranteed(8.0)
)
FROM_REST = cs.load_scene("K1").replace(
    name="rest", profile=cs.Profile([0.0, 0.3, -0.1]), gain=cs.Gain.time(20.0)
)

SLIPLESS = FROM_REST.replace(name="slipless", gain=cs.Gain.guaranteed(8.0))


@pytest.mark.parametrize("scene", ["C1", SLIPLESS], ids=("C1", "guaranteed"))
def test_model_exchange_starts_from_rest(scene, exported):
    fmu = exported(scene)
    result = fmu.simulate(0.05, fmi_type="ModelExchange", solver="CVode")
    assert worst_difference(fmu, result) < 1e-7


@pytest.mark.parametrize("scene", [GUARANTEED, FROM_REST], ids=lambda s: s.name)
def test_every_gain_law_follows_its_plan(scene, exported):
    fmu = exported(scene)
    assert worst_difference(fmu, fmu.simulate(0.07)) < 1e-12


# --- inputs, parameters, starts ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("version", "name", "kind", "inputs"),
    [
        ("3.0", "K1", cs.FingerAcceleration, "finger.acceleration"),
        ("2.0", "K3", cs.ObjectAcceleration, "object.acceleration"),
        ("2.0", "K3", cs.ObjectRateOffset, "object.rate_offset"),
    ],
)
def test_a_held_input_does_what_a_window_does(version, name, kind, inputs, exported):
    scene = cs.load_scene(name)
    scene = scene.replace(duration=0.6, disturbances=(), name=f"{name} free")
    fmu = exported(scene, version)
    disturbed = scene.replace(disturbances=[kind(0, 0.25, 0.4, (0.2, -0.1))])
    plan = cs.plan(disturbed)
    one = fmu.instance()
    fmu.step(one, 0.0, 0.25)
    fmu.set(one, {f"contact[1].{inputs}.u": 0.2, f"contact[1].{inputs}.v": -0.1})
    fmu.step(one, 0.25, 0.1)
    assert relative(fmu.states(one), plan.states(0.35).ravel()) < 1e-12
    fmu.step(one, 0.35, 0.4 - 0.35)
    fmu.set(one, {f"contact[1].{inputs}.u": 0.0, f"contact[1].{inputs}.v": 0.0})
    fmu.step(one, 0.4, 0.2)
    assert relative(fmu.states(one), plan.states(0.6).ravel()) < 1e-12
    one.freeInstance()


def paper_equations_under_a_ramp(scene, slope, stop):
    """States of contact 1 whose finger's u is accelerated by slope t, by scipy."""
    from scipy.integrate import solve_ivp

    system = SceneSystem(scene, "chart", disturbance_input=True)
    run = system.function("derivatives")
    x = system.x0
    for a, b in ((0.0, 0.1), (0.1, stop)):  # K2's windows end at 0.1 s

        def rate(t, x, windows):
            w = windows.copy()
            w[0] += slope * t
            return run(t, x, w, system.held0, system.parameters).full().ravel()

        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
        x = solve_ivp(rate, (a, b), x, args=(system.window_values(a),), **options).y[:, -1]
    return x[:9]


@pytest.mark.parametrize("step", [0.05, 0.25])
def test_an_input_with_a_slope_is_extrapolated(step, exported):
    fmu, name = exported("K2"), "contact[1].finger.acceleration.u"
    one = fmu.instance()
    for t in np.arange(0.0, 0.5 - 1e-9, step):
        fmu.set(one, {name: 0.8 * t})
        one.setRealInputDerivatives([fmu.reference(name)], [1], [0.8])
        fmu.step(one, t, step)
    assert fmu.get(one, name)[0] == pytest.approx(0.4, abs=1e-15)
    found, wanted = fmu.states(one)[:9], paper_equations_under_a_ramp(fmu.scene, 0.8, 0.5)
    assert np.allclose(found, wanted, rtol=0, atol=1e-9)


def test_a_slope_given_before_initialization_begins_at_the_start(exported):
    """FMI 2.0.4, table in 4.2.4: derivatives of inputs may be set from the first state on."""
    fmu, name, ends = exported("K2"), "contact[1].finger.acceleration.u", []
    for early in (True, False):
        one = fmu.instance(ready=False)
        if early:
            one.setRealInputDerivatives([fmu.reference(name)], [1], [0.8])
        fmu.initialize(one, 0.2)
        if not early:
            one.setRealInputDerivatives([fmu.reference(name)], [1], [0.8])
        fmu.step(one, 0.2, 0.5)
        ends.append(fmu.get(one, name, "contact[1].finger.u", "contact[1].object.u").tolist())
    assert ends[0] == ends[1]
    assert ends[0][0] == pytest.approx(0.4, abs=1e-15)


def test_starts_and_parameters_can_be_changed_before_initialization(exported):
    fmu = exported("K1")
    contacts = list(fmu.scene.contacts)
    contacts[1] = cs.Contact(
        finger=cs.Sphere(0.05), object_at=(1.2, -0.4), finger_at=(1.3, 0.2), angle=0.6,
        finger_velocity=(0.3, 0.8), object_velocity=(0.1, 0.2),
    )  # fmt: skip
    plan = cs.plan(fmu.scene.replace(contacts=contacts, gain=cs.Gain.path(40.0)))
    c = "contact[2]."
    start = {
        "gain.eta": 40.0, c + "finger.radius": 0.05, c + "object.u": 1.2, c + "object.v": -0.4,
        c + "finger.u": 1.3, c + "finger.v": 0.2, c + "angle": 0.6,
        c + "finger.velocity.x": 0.3, c + "finger.velocity.y": 0.8,
        c + "object.velocity.x": 0.1, c + "object.velocity.y": 0.2,
    }  # fmt: skip
    result = fmu.simulate(0.1, start_values=start)
    assert worst_difference(fmu, result, plan) < 1e-12


def test_the_gain_can_be_tuned_on_the_way(exported):
    fmu = exported("K1")
    one = fmu.instance()
    fmu.step(one, 0.0, 0.4)
    before = cs.plan(fmu.scene)
    fmu.set(one, {"gain.eta": 500.0})
    fmu.step(one, 0.4, 0.6)
    after = cs.plan(fmu.scene.replace(gain=cs.Gain.path(500.0)))
    plan = after.restart(0.4, before.states(0.4)[0])
    assert relative(fmu.states(one), plan.states(1.0).ravel()) < 1e-12
    one.freeInstance()


def test_a_later_start_time_starts_there(exported):
    fmu = exported("K1")
    one = fmu.instance(ready=False)
    fmu.initialize(one, time=0.5)
    fmu.step(one, 0.5, 0.5)
    starts = cs.plan(fmu.scene).states(0.0)[0]
    starts[:, [2, 3, 6, 7]] *= fmu.scene.profile(0.5) / fmu.scene.profile(0.0)
    plan = cs.plan(fmu.scene).restart(0.5, starts)
    assert relative(fmu.states(one), plan.states(1.0).ravel()) < 1e-12
    one.freeInstance()


# --- derivatives ---------------------------------------------------------------------------------


def jacobian_of_kernel(fmu, contact, time, values):
    """d results/d arguments from CasADi, as a matrix over references."""
    import casadi as ca

    scene, table = fmu.scene, fmu.table
    f = contact_results(
        scene.contacts[contact].finger, scene.object, scene.gain.law,
        len(scene.profile.coefficients),
    )  # fmt: skip
    sizes = np.cumsum([0, *(f.nnz_in(i) for i in range(f.n_in()))]).tolist()
    z = ca.SX.sym("z", sizes[-1])
    whole = ca.Function("g", [z], [ca.jacobian(f(*ca.vertsplit(z, sizes)), z)])
    references = table.arguments(contact)
    at = values[references].copy()
    at[0] = time
    matrix = np.zeros((f.nnz_out(0), table.n_values))
    matrix[:, references] = whole(at).full()
    return matrix


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_directional_derivatives_are_those_of_the_kernels(interface, exported):
    fmu = exported("K3")
    one = fmu.instance(interface, ready=False)
    one.setupExperiment()
    one.enterInitializationMode()
    table = fmu.table
    values = table.start_values
    exact = jacobian_of_kernel(fmu, 1, 0.0, values)
    first = table.blocks[1] + 6 + STATES
    unknowns = list(range(first, first + len(exact)))
    knowns = [r for r in table.arguments(1) if r > 0]
    for known in knowns:
        column = one.getDirectionalDerivative(unknowns, [known], [1.0])
        assert np.allclose(column, exact[:, known], rtol=1e-12, atol=1e-12)
    one.freeInstance()


def test_adjoint_derivatives_are_the_transpose(exported):
    fmu = exported("K3", "3.0")
    one = fmu.instance(ready=False)
    one.enterInitializationMode()
    rows, names = fmu.table.rows, ["contact[1].slip", "contact[1].twist.linear"]
    unknowns = [fmu.reference(n) for n in names]
    knowns = [v for v in rows if v.reference in fmu.table.arguments(0) and v.reference]
    references, count = [v.reference for v in knowns], sum(v.size for v in knowns)
    forward = np.array([directional3(one, unknowns, references, seed, 5) for seed in np.eye(count)])
    backward = np.array([adjoint3(one, unknowns, references, seed, count) for seed in np.eye(5)])
    assert np.allclose(forward, backward.T, rtol=1e-12, atol=1e-13)
    assert np.abs(forward).max() > 0.01
    one.freeInstance()


def _product3(function, one, unknowns, knowns, seed, count):
    u, k = (ctypes.c_uint32 * len(unknowns))(*unknowns), (ctypes.c_uint32 * len(knowns))(*knowns)
    s, out = (ctypes.c_double * len(seed))(*seed), (ctypes.c_double * count)()
    function(one.component, u, len(unknowns), k, len(knowns), s, len(seed), out, count)
    return np.array(out)


def directional(one, unknowns, knowns, seed):
    """Of as many scalar unknowns as there are, in either version."""
    count = [len(unknowns)] if isinstance(one, (FMU3Slave, FMU3Model)) else []
    return one.getDirectionalDerivative(unknowns, knowns, seed, *count)


def directional3(one, unknowns, knowns, seed, count):
    return _product3(one.fmi3GetDirectionalDerivative, one, unknowns, knowns, seed, count)


def adjoint3(one, unknowns, knowns, seed, count):
    return _product3(one.fmi3GetAdjointDerivative, one, unknowns, knowns, seed, count)


def test_derivatives_while_stepping_agree_with_differences(exported):
    fmu = exported("K1")
    one = fmu.instance()
    fmu.step(one, 0.0, 0.4)
    name = "contact[1].object.rate_offset.u"
    outputs = ["contact[1].slip.x", "contact[1].twist.linear.y", "der(contact[1].object.u)"]
    unknowns = [fmu.reference(n) for n in outputs]
    exact = one.getDirectionalDerivative(unknowns, [fmu.reference(name)], [1.0])
    sides = []
    for value in (1e-4, -1e-4):
        fmu.set(one, {name: value})
        sides.append(fmu.get(one, *outputs))
    assert np.allclose((sides[0] - sides[1]) / 2e-4, exact, rtol=1e-9, atol=1e-11)
    one.freeInstance()


# --- FMU states ----------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_a_serialized_state_restores_in_another_instance(version, exported):
    fmu = exported("K4", version)
    one, other = fmu.instance(), fmu.instance()
    fmu.step(one, 0.0, 1.3)
    names = ("getFMUstate", "serializeFMUstate", "deSerializeFMUstate", "setFMUstate")
    if version == "3.0":
        names = ("getFMUState", "serializeFMUState", "deserializeFMUState", "setFMUState")
    get, write, read, put = names
    state = getattr(one, get)()
    data = getattr(one, write)(state)
    getattr(other, put)(getattr(other, read)(data))
    for instance in (one, other):
        fmu.step(instance, 1.3, 0.9)
    assert fmu.states(one).tobytes() == fmu.states(other).tobytes()
    getattr(one, put)(state)
    fmu.step(one, 1.3, 0.9)
    assert fmu.states(one).tobytes() == fmu.states(other).tobytes()


def test_state_bytes_that_were_changed_are_refused(exported):
    fmu, other = exported("K1"), exported("K2")
    one = fmu.instance()
    data = bytes(one.serializeFMUstate(one.getFMUstate()))
    foreign = other.instance()
    theirs = bytes(foreign.serializeFMUstate(foreign.getFMUstate()))
    random = np.random.default_rng(2)
    flipped = []
    for k in random.integers(0, len(data), 50):
        flipped.append(data[:k] + bytes([data[k] ^ 0x10]) + data[k + 1 :])
    for wrong in (b"", data[:-1], data + b"\0", theirs, *flipped):
        with pytest.raises(FMICallException):
            one.deSerializeFMUstate(wrong)
    assert all("refused" in text for _, _, text in fmu.messages)
    fmu.step(one, 0.0, 0.1)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_with_legendre_series_is_refused(version, exported):
    """Version 1: the same scene's, of the same length, so that only the version tells."""
    fmu = exported("K4", version)
    one = fmu.instance()
    fmu.step(one, 0.0, 0.3)
    if version == "2.0":
        write, read = one.serializeFMUstate, one.deSerializeFMUstate
        data = bytes(write(one.getFMUstate()))
    else:
        write, read = one.serializeFMUState, one.deserializeFMUState
        data = bytes(write(one.getFMUState()))
    read(data)
    with pytest.raises(FMICallException):
        read(data[:8] + (1).to_bytes(8, sys.byteorder) + data[16:])
    assert "it was written by another version" in fmu.messages[-1][2]


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_of_another_model_is_refused(version, exported):
    fmu = exported("K1", version)
    one, other = fmu.instance(), exported("C2", version).instance()
    suffix = "FMUstate" if version == "2.0" else "FMUState"
    theirs = getattr(other, f"get{suffix}")()  # of another size
    for name in ("set", "serialize", "free"):
        with pytest.raises(FMICallException):
            getattr(one, name + suffix)(theirs)
        assert "another model's; give one that this model handed out" in fmu.messages[-1][2]
    getattr(other, f"free{suffix}")(theirs)
    fmu.step(one, 0.0, 0.1)


# --- misuse --------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_values_that_are_no_numbers_are_refused_and_the_instance_lives(version, exported):
    fmu = exported("K1", version)
    one = fmu.instance()
    for value in (np.nan, np.inf, -np.inf):
        with pytest.raises(FMICallException):
            fmu.set(one, {"contact[1].finger.acceleration.u": value})
    with pytest.raises(FMICallException):
        fmu.set(one, {"gain.eta": -1.0})
    assert {c for _, c, _ in fmu.messages} == {"logStatusDiscard"}
    fmu.step(one, 0.0, 1.0)
    assert relative(fmu.states(one), cs.plan(fmu.scene).states(1.0).ravel()) < 1e-12


@pytest.mark.parametrize("version", VERSIONS)
def test_a_refusal_names_the_variable_its_value_and_what_to_do(version, exported):
    fmu = exported("K1", version)
    one = fmu.instance()
    given = [row.name for row in fmu.table.rows if row.causality == "input"]
    refusals = {name: (np.nan, f"{name} = nan is refused; give a finite number") for name in given}
    refusals |= {
        "gain.eta": (-1.0, "gain.eta = -1 is refused; give 0 or more"),
        "object.radius": (0.2, "object.radius = 0.2 is refused now: it is fixed; set it before"),
        "contact[2].angle": (0.1, "contact[2].angle = 0.1 is refused now: it is a start value"),
    }
    for name, (value, words) in refusals.items():
        fmu.messages.clear()
        with pytest.raises(FMICallException):
            fmu.set(one, {name: value})
        assert words in fmu.messages[0][2]
    fmu.messages.clear()
    with pytest.raises(FMICallException):
        (one.getReal if version == "2.0" else one.getFloat64)([4000])
    assert "no variable with value reference 4000; see modelDescription.xml" in fmu.messages[0][2]


@pytest.mark.parametrize("version", VERSIONS)
def test_a_length_that_is_not_positive_is_refused_where_it_is_set(version, exported):
    fmu = exported("K1", version)
    one = fmu.instance(ready=False)
    for value in (0.0, -1.0):
        fmu.messages.clear()
        with pytest.raises(FMICallException):
            fmu.set(one, {"object.radius": value})
        words = f"object.radius = {value:g} is refused; give 1e-150 or more"
        assert words in fmu.messages[0][2]


def test_an_element_of_an_array_is_named_as_in_fmi_2(exported):
    fmu = exported("K1", "3.0")
    one = fmu.instance(ready=False)
    with pytest.raises(FMICallException):
        fmu.set(one, {"contact[2].object.velocity": [1.0, np.nan]})
    assert "contact[2].object.velocity.y = nan is refused" in fmu.messages[0][2]


@pytest.mark.parametrize("version", VERSIONS)
def test_steps_of_no_length_and_starts_before_the_profile_are_refused(version, exported):
    fmu = exported("K1", version)
    for time, words in ((-1.0, "give 0 <= start <= stop"), (np.nan, "give 0 <= start")):
        with pytest.raises(FMICallException):
            fmu.initialize(fmu.instance(ready=False), time)
        assert words in fmu.messages[-1][2]
    with pytest.raises(FMICallException):
        fmu.step(fmu.instance(), 0.0, 0.0)
    assert "a step of 0 s from t = 0 s is refused; give a positive length" in fmu.messages[-1][2]


@pytest.mark.parametrize("version", VERSIONS)
def test_steps_from_another_time_are_refused(version, exported):
    fmu = exported("K1", version)
    one = fmu.instance()
    fmu.step(one, 0.0, 0.1)
    for time in (0.1 - 1e-6, 0.1 + 1e-6):
        with pytest.raises(FMICallException):
            fmu.step(one, time, 0.1)
        assert "the instance stands at t = 0.1" in fmu.messages[-1][2]
    fmu.step(one, 0.1 + 1e-12, 0.1)  # importers add up steps


@pytest.mark.parametrize("version", VERSIONS)
def test_model_exchange_tells_of_a_pole_and_refuses_what_lies_beyond(version, exported):
    fmu = exported(OVER_POLE, version)
    one, u = fmu.instance("ModelExchange"), "contact[1].object.u"
    if version == "3.0":
        one.updateDiscreteStates()
    rate, near = f"der({u})", {0.3: 0, 1e-4: 1, 2e-4: 1, 0.2: 1, 1e-5: 2}
    for place, warnings in near.items():  # one warning each time the path comes near
        fmu.set(one, {u: place})
        fmu.get(one, rate)
        warned = [m for _, c, m in fmu.messages if c == "logStatusWarning"]
        assert len(warned) == warnings
    assert warned[0].startswith("contact[1].object: at t = 0 s the path is within 0.0001 of")
    fmu.set(one, {u: -0.1})
    with pytest.raises(FMICallException):
        fmu.get(one, rate)
    assert "beyond a singular point of a chart" in fmu.messages[-1][2]
    unknown, known = fmu.reference(rate), fmu.reference("contact[1].object.rate_offset.u")
    with pytest.raises(FMICallException):  # derivatives no more than values
        directional(one, [unknown], [known], [1.0])
    assert "beyond a singular point of a chart" in fmu.messages[-1][2]
    fmu.set(one, {u: 0.3})
    assert fmu.get(one, rate)[0] == pytest.approx(-1.0, abs=1e-14)  # sigma / r
    assert directional(one, [unknown], [known], [1.0]) == [1.0]
    over = fmu.simulate(0.05)  # while Co-Simulation passes it
    wanted = cs.plan(OVER_POLE).pose(over["time"])[:, 0, :3, 3]
    assert relative(over_position(over, version), wanted) < 1e-12


@pytest.mark.parametrize("version", VERSIONS)
def test_calls_out_of_order_are_refused_with_a_message(version, exported):
    fmu = exported("K1", version)
    one = fmu.instance(ready=False)
    order, terminate = "in the state 'instantiated', only in: ", "event mode, step mode"
    attempts = [
        (lambda: fmu.step(one, 0.0, 0.1), order + "step mode"),
        (lambda: fmu.get(one, "der(contact[1].angle)"), "initialization"),
        (lambda: one.exitInitializationMode(), order + "initialization mode"),
        (lambda: one.terminate(), order + terminate),
    ]
    for attempt, words in attempts:
        fmu.messages.clear()
        with pytest.raises(FMICallException):
            attempt()
        ((status, category, text),) = fmu.messages
        assert (status, category) == (3, "logStatusError") and words in text
    fmu.initialize(one)
    result = "contact[1].slip.x" if version == "2.0" else "der(contact[1].angle)"
    for attempt in (
        lambda: fmu.set(one, {"object.radius": 0.2}),
        lambda: fmu.set(one, {"contact[1].angle": 0.2}),
        lambda: fmu.set(one, {result: 0.2}),
        lambda: fmu.step(one, 0.5, 0.1),
        lambda: fmu.step(one, 0.0, -0.1),
        lambda: fmu.step(one, 0.0, np.nan),
        lambda: one.enterInitializationMode(),
    ):  # fmt: skip
        with pytest.raises(FMICallException):
            attempt()
    fmu.step(one, 0.0, 1.0)
    assert relative(fmu.states(one), cs.plan(fmu.scene).states(1.0).ravel()) < 1e-12
    one.terminate()
    with pytest.raises(FMICallException):
        fmu.step(one, 1.0, 0.1)
    assert "in the state 'terminated', only in: step mode; reset, or set" in fmu.messages[-1][2]
    one.reset()
    fmu.initialize(one)
    assert fmu.get(one, "contact[1].object.u")[0] == fmu.scene.contacts[0].object_at[0]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_interfaces_of_an_iterator_are_all_in_the_file(version, tmp_path):
    both = ["CoSimulation", "ModelExchange"]
    path = export_fmu(cs.load_scene("C1"), tmp_path / "C1.fmu", version, iter(both))
    found = fmpy.read_model_description(path)
    assert found.coSimulation is not None and found.modelExchange is not None


def test_functions_of_the_other_interface_are_refused(exported):
    fmu = exported("K1")
    ready = ["CoSimulation", "ModelExchange"]
    stepped, solved = (fmu.instance(interface, ready=False) for interface in ready)
    slope = fmu.reference("contact[1].finger.acceleration.u")
    real, integer = (ctypes.c_double * 33)(), (ctypes.c_int * 1)(1)
    reference = (ctypes.c_uint * 1)(slope)
    for one, function, arguments in (
        (solved, "fmi2SetRealInputDerivatives", (reference, 1, integer, real)),
        (stepped, "fmi2GetNominalsOfContinuousStates", (real, 33)),
    ):
        called = getattr(one.dll, function)
        sizes = [ctypes.c_size_t(x) if isinstance(x, int) else x for x in arguments]
        assert called(ctypes.c_void_p(one.component), *sizes) == 3
        assert f"{function}: the instance was made for" in fmu.messages[-1][2]


def test_start_values_can_be_read_before_initialization(exported):
    """FMI 3.0.2, 2.3.2: of the description, or as they were set; FMI 2 has no values yet."""
    fmu = exported("K1", "3.0")
    one = fmu.instance(ready=False, start={"gain.eta": 7.0})
    assert fmu.get(one, "gain.eta", "contact[1].object.u").tolist() == [7.0, np.pi / 6]
    with pytest.raises(FMICallException):
        fmu.get(one, "contact[1].angle", "der(contact[1].angle)")
    assert "der(contact[1].angle) is calculated and has no start value" in fmu.messages[-1][2]
    fmu.initialize(one)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_start_without_a_contact_frame_is_refused(version, exported):
    fmu = exported("K1", version)
    for place in (0.0, np.pi, -1.0):
        with pytest.raises(FMICallException):
            fmu.instance(start={"contact[1].finger.u": place})
        assert "no outward contact frame" in fmu.messages[-1][2]


def test_no_step_goes_where_sigma_is_negative(exported):
    scene = cs.load_scene("K1").replace(name="short", profile=cs.Profile([0.3, -0.2]))
    fmu = exported(scene)
    one = fmu.instance()
    fmu.step(one, 0.0, 1.4)
    with pytest.raises(FMICallException):
        fmu.step(one, 1.4, 0.2)
    assert "sigma is negative" in fmu.messages[-1][2]
    fmu.step(one, 1.4, 0.1)


def test_an_importer_stops_where_sigma_ends(exported):
    """It asks fmi2Terminated after a step that was discarded."""
    scene = cs.load_scene("K1").replace(name="short", profile=cs.Profile([0.3, -0.2]))
    result = exported(scene).simulate(0.2, stop_time=3.0)
    assert 1.3 < result["time"][-1] < 1.6


LINE = {"profile[1]": 0.3, "profile[2]": -0.2, "profile[3]": 0.0}
"""sigma, zero at 1.5 s."""


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("version", VERSIONS)
def test_sigma_that_falls_from_zero_is_refused_at_the_start(version, interface, exported):
    fmu = exported("K1", version)
    with pytest.raises(FMICallException):
        fmu.instance(interface, start=LINE | {"profile[1]": 0.0})
    assert "sigma is negative from t = 0 s on; change the profile" in fmu.messages[-1][2]
    one = fmu.instance(interface, start=LINE, ready=False)
    with pytest.raises(FMICallException):
        fmu.initialize(one, 1.5)
    assert "sigma is negative from t = 1.5 s on" in fmu.messages[-1][2]


@pytest.mark.parametrize("version", VERSIONS)
def test_sigma_that_touches_zero_does_not_end_there(version, exported):
    fmu = exported("K1", version)  # 0.7 (t - 0.4)^2, in doubles -3e-17 m/s where it is least
    start = {"profile[1]": 0.112, "profile[2]": -0.56, "profile[3]": 0.7}
    one = fmu.instance(start=start)
    fmu.step(one, 0.0, 1.0)
    plan = cs.plan(fmu.scene.replace(profile=cs.Profile([*start.values()])))
    assert relative(fmu.states(one), plan.states(1.0).ravel()) < 1e-12


@pytest.mark.parametrize("version", VERSIONS)
def test_model_exchange_ends_where_sigma_does(version, exported):
    fmu = exported("K1", version)
    scene = fmu.scene.replace(profile=cs.Profile([*LINE.values()]), duration=1.5)
    options = {"fmi_type": "ModelExchange", "solver": "CVode", "start_values": LINE}
    result = fmu.simulate(0.05, stop_time=1.5, **options)
    assert result["time"][-1] == 1.5
    found = np.stack([result[n] for i in range(3) for n in columns(i)], axis=1)
    wanted = cs.plan(scene).states(result["time"]).reshape(len(found), -1)
    assert relative(found, wanted) < 1e-7
    longer = fmu.simulate(0.05, stop_time=2.0, **options)
    assert longer["time"][-1] == pytest.approx(1.5, abs=1e-15)  # the FMU ends the simulation
    one, rate = fmu.instance("ModelExchange", start=LINE), "der(contact[1].finger.u)"
    events = []

    def update():
        told = one.newDiscreteStates() if version == "2.0" else one.updateDiscreteStates()
        events.append((told[-1] if told[-2] else None, bool(told[1])))

    update()
    one.enterContinuousTimeMode()
    one.setTime(1.55)  # a solver looks beyond the end of its last step, where the path rests
    assert fmu.get(one, rate)[0] == pytest.approx(0.0, abs=1e-15)
    one.setTime(1.5)
    one.enterEventMode()
    update()
    assert events == [(pytest.approx(1.5, abs=1e-15), False), (None, True)]
    one.enterContinuousTimeMode()
    assert fmu.get(one, rate)[0] == pytest.approx(0.0, abs=1e-15)
    one.setTime(1.55)
    unknown, known = fmu.reference(rate), fmu.reference("gain.eta")
    for refused in (
        lambda: fmu.get(one, rate),
        lambda: fmu.get(one, "contact[1].pose.position.x" if version == "2.0" else rate),
        lambda: directional(one, [unknown], [known], [1.0]),
    ):
        fmu.messages.clear()
        with pytest.raises(FMICallException):
            refused()
        assert "sigma is negative from t = 1.5 s on; end there" in fmu.messages[-1][2]


@pytest.mark.parametrize("version", VERSIONS)
def test_after_a_failed_step_values_are_those_of_before(version, exported):
    """FMI 2.0.4, 4.2.4, state error; FMI 3.0.2, 2.3.8: for debugging."""
    fmu = exported("K1", version)
    steady = {"profile[1]": 0.1, "profile[2]": 0.0, "profile[3]": 0.0}
    one = fmu.instance(start=steady | {"contact[2].finger.radius": 1e-6})
    kept = one.getFMUstate() if version == "2.0" else one.getFMUState()
    fmu.step(one, 0.0, 0.05)
    before = fmu.states(one)
    go_back = one.setFMUstate if version == "2.0" else one.setFMUState
    go_back(kept)
    fmu.step(one, 0.0, 0.05)  # and nobody looks
    with pytest.raises(FMICallException):
        fmu.step(one, 0.05, 50.0)  # the first contact gets there
    words = "contact 2: a step of 50 s to t = 50.05 s is too long, it would take more than 20000"
    assert words in fmu.messages[-1][2]
    assert fmu.states(one).tobytes() == before.tobytes()
    assert fmu.get(one, "gain.eta")[0] == 100.0
    with pytest.raises(FMICallException):
        fmu.step(one, 0.05, 0.1)
    go_back(kept)
    fmu.step(one, 0.0, 0.05)
    assert fmu.states(one).tobytes() == before.tobytes()


def test_an_acceleration_of_a_path_at_rest_is_said_to_be_one(exported):
    fmu, name = exported("K1"), "contact[2].finger.acceleration.u"
    one = fmu.instance(start={"profile[1]": 0.0, "profile[2]": 0.0, name: 0.5})
    with pytest.raises(FMICallException):
        fmu.step(one, 0.0, 0.1)
    words = "contact 2: the motion cannot be continued past t = 0 s: sigma is zero, and an accelera"
    assert words in fmu.messages[-1][2]


def test_an_acceleration_up_to_where_a_path_comes_to_rest_is_said_to_be_one(exported):
    fmu = exported("C1")
    one = fmu.instance()
    fmu.step(one, 0.0, 0.3)
    fmu.set(one, {"contact[1].finger.acceleration.u": 0.05})
    fmu.step(one, 0.3, 0.6)
    with pytest.raises(FMICallException):  # after as many pieces as a step may have
        fmu.step(one, 0.9, 0.1)
    words = r"contact 1: the motion cannot be continued past t = 0.99\d* s: sigma is zero, and"
    assert re.match(words, fmu.messages[-1][2])


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_an_acceleration_of_a_path_at_rest_has_no_rate_and_no_derivative(interface, exported):
    fmu, push = exported(FROM_REST), "contact[2].finger.acceleration.u"
    rates = [f"der(contact[2].finger.velocity.{axis})" for axis in "xy"]
    one = fmu.instance(interface)
    assert not fmu.get(one, *rates).any()
    for ask in (
        lambda: directional(one, [fmu.reference(rates[0])], [fmu.reference(push)], [1.0]),
        lambda: fmu.get(one, *rates),  # 4e+297, with status OK
    ):
        with pytest.raises(FMICallException):
            ask()
        assert f"{rates[0]} has no value at t = 0 s: sigma is zero, and" in fmu.messages[-1][2]
        fmu.set(one, {push: 0.5})
    fmu.set(one, {push: 0.0})
    assert not fmu.get(one, *rates).any()


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("version", VERSIONS)
def test_numbers_that_make_another_kind_of_surface_are_refused(version, interface, exported):
    fmu = exported("K3", version)
    for start, words in (
        ({"object.a": 0.15}, "object.a = 0.15 is refused: it must be greater than object.b = 0.2"),
        ({"object.a": 0.2}, "object.a = 0.2 is refused: it must be greater than object.b = 0.2"),
        ({"object.c": 0.25}, "object.b = 0.2 is refused: it must be greater than object.c = 0.25"),
    ):
        with pytest.raises(FMICallException):
            fmu.instance(interface, start=start)
        assert words in fmu.messages[-1][2]
    fmu.instance(interface, start={"object.a": 0.15, "object.b": 0.12})


def test_numbers_of_a_torus_keep_their_order_and_those_of_a_quadric_stay(exported):
    contact = cs.Contact(cs.Torus(0.05, 0.02), object_at=(0.7, 0.4), finger_at=(0.3, 0.2))
    turned = cs.Quadric([[30.0, 5.0, 0.0], [5.0, 40.0, 0.0], [0.0, 0.0, 100.0]])
    profile = cs.Profile([0.1])
    fmu = exported(cs.Scene(object=turned, contacts=[contact], profile=profile, duration=1,
                            name="a*/b\x01\u00e9"))  # fmt: skip
    assert worst_difference(fmu, fmu.simulate(0.25)) < 1e-12
    radius = "contact[1].finger.m"
    for start, words in (
        ({radius + "inor": 0.06}, f"{radius}ajor = 0.05 is refused: it must be greater than"),
        ({fmu.table.rows[3].name: 5.0}, " = 5 is refused: the parameters of this surface dep"),
    ):
        with pytest.raises(FMICallException):
            fmu.instance(start=start)
        assert words in fmu.messages[-1][2]


@pytest.mark.parametrize("version", VERSIONS)
def test_all_values_of_a_call_are_set_or_none(version, exported):
    fmu = exported("K1", version)
    one = fmu.instance()
    good, bad = (fmu.reference(f"contact[{k}].finger.acceleration.u") for k in (1, 2))
    setter = one.setReal if version == "2.0" else one.setFloat64
    with pytest.raises(FMICallException):
        setter([good, bad], [0.3, np.nan])
    assert fmu.get(one, "contact[1].finger.acceleration.u")[0] == 0.0


@pytest.mark.parametrize("version", VERSIONS)
def test_errors_are_told_though_logging_is_off(version, exported):
    fmu = exported("K1", version)
    one = fmu.instance(loggingOn=False)
    with pytest.raises(FMICallException):
        fmu.set(one, {"gain.eta": np.nan})  # discarded
    assert fmu.messages == []
    with pytest.raises(FMICallException):
        fmu.step(one, 0.0, -0.1)
    assert [(s, c) for s, c, _ in fmu.messages] == [(3, "logStatusError")]
    assert "a step of -0.1 s from t = 0 s is refused" in fmu.messages[0][2]


def test_a_text_with_percent_signs_is_only_text(exported):
    fmu = exported("K1")
    one = fmu.instance(ready=False)
    with pytest.raises(FMICallException):
        one.setDebugLogging(True, ["%s%n"])
    assert "%n" not in fmu.messages[-1][2]


def test_instances_do_not_touch_each_other(exported):
    fmu = exported("K2")
    alone, *many = (fmu.instance() for _ in range(9))
    fmu.step(alone, 0.0, 1.0)
    for k in range(10):
        for one in many:
            fmu.step(one, 0.1 * k, 0.1)
    for one in many:
        assert relative(fmu.states(one), fmu.states(alone)) < 1e-14


# --- events of FMI 3 -----------------------------------------------------------------------------


def test_steps_return_early_at_window_edges_where_that_is_allowed(exported):
    fmu = exported("K4", "3.0")
    one = fmu.instance(ready=False, eventModeUsed=True, earlyReturnAllowed=True)
    fmu.initialize(one)
    stops, t = [], 0.0
    while t < 4.0:
        update = one.updateDiscreteStates()
        stops.append(update[-1] if update[-2] else None)
        one.enterStepMode()
        event, _, early, t = fmu.step(one, t, 4.0 - t)
        assert event == early == (t < 4.0)
        if event:
            one.enterEventMode()
    assert stops == [1.0, 2.0, None]
    assert relative(fmu.states(one), cs.plan(fmu.scene).states(4.0).ravel()) < 1e-12


def test_a_step_to_a_window_edge_but_for_rounding_tells_of_it(exported):
    fmu, t = exported(EVERYTHING, "3.0"), 0.2
    one = fmu.instance(ready=False, eventModeUsed=True)
    fmu.initialize(one)
    one.enterStepMode()
    fmu.step(one, 0.0, t)
    assert t + 0.1 > 0.3
    assert fmu.step(one, t, 0.1) == (True, False, False, 0.3)


def test_event_mode_shows_values_after_the_edge_before_the_update(exported):
    """An importer passes outputs on in event mode, then updates (FMI 3.0.2, 2.3.5)."""
    fmu, name = exported(EVERYTHING, "3.0"), "der(contact[1].object.u)"
    one = fmu.instance(ready=False, eventModeUsed=True)
    fmu.initialize(one)
    one.enterStepMode()
    edge = next(d.start for d in fmu.scene.disturbances if type(d) is cs.ObjectRateOffset)
    before, after = cs.plan(fmu.scene).states([np.nextafter(edge, 0), edge])[:, 0, 6]
    assert abs(after - before) > 1e-3
    fmu.step(one, 0.0, edge)
    assert fmu.get(one, name) == pytest.approx([before], abs=1e-12)
    saved = one.getFMUState()
    one.enterEventMode()
    for _ in range(2):
        assert fmu.get(one, name) == pytest.approx([after], abs=1e-12)
        one.updateDiscreteStates()
    plain = fmu.instance()
    plain.setFMUState(saved)
    assert fmu.get(plain, name) == pytest.approx([after], abs=1e-12)


def test_only_windows_are_events_of_a_co_simulation(exported):
    """Not where sigma begins to grow, which begins a piece of the guaranteed gain."""
    fmu = exported(EVERYTHING, "3.0")
    one = fmu.instance(ready=False, eventModeUsed=True, earlyReturnAllowed=True)
    fmu.initialize(one)
    stops, t = [], 0.0
    while t < 1.0:
        one.updateDiscreteStates()
        one.enterStepMode()
        event, _, _, t = fmu.step(one, t, 1.0 - t)
        if event:
            stops.append(t)
            one.enterEventMode()
    assert stops == [0.1, 0.2, 0.3, 0.4, 0.5, 0.55]
    assert relative(fmu.states(one), cs.plan(fmu.scene).states(1.0).ravel()) < 1e-12


def test_a_step_returns_at_the_time_that_the_importer_asks_for(exported):
    """FMI 3.0.2, 4.2.1.2: earlyReturnTime may lie after the intermediate update."""
    fmu, told = exported("K4", "3.0"), []

    def update(environment, time, sets, gets, finished, may_return, wants, when):
        told.append(time)
        wants[0], when[0] = time == 1.0, 1.6

    one = fmu.instance(ready=False, earlyReturnAllowed=True, intermediateUpdate=update)
    fmu.initialize(one)
    assert fmu.step(one, 0.0, 4.0) == (False, False, True, 1.6)
    assert told == [1.0, 1.6]
    assert relative(fmu.states(one), cs.plan(fmu.scene).states(1.6).ravel()) < 1e-12


def test_a_state_of_event_mode_goes_on_without_it(exported):
    fmu = exported("K4", "3.0")
    one = fmu.instance(ready=False, eventModeUsed=True, earlyReturnAllowed=True)
    fmu.initialize(one)
    one.enterStepMode()
    fmu.step(one, 0.0, 4.0)
    other, rate, found = fmu.instance(), [fmu.reference("der(contact[1].finger.velocity)")], []
    for arrive in (lambda: None, one.enterEventMode):  # before and after the edge
        arrive()
        other.setFMUState(other.deserializeFMUState(one.serializeFMUState(one.getFMUState())))
        found.append(other.getFloat64(rate, 2))
    assert found[0] == found[1] == one.getFloat64(rate, 2) and any(found[0])
    fmu.step(other, 1.0, 0.7)
    assert relative(fmu.states(other), cs.plan(fmu.scene).states(1.7).ravel()) < 1e-12


def test_event_mode_of_fmpy_gives_the_same_motion(exported):
    fmu = exported("K4", "3.0")
    result = fmu.simulate(0.3, use_event_mode=True, early_return_allowed=True)
    assert worst_difference(fmu, result) < 1e-12


# --- the package ---------------------------------------------------------------------------------


@pytest.mark.parametrize("version", VERSIONS)
def test_the_file_is_small_and_complete(version, exported):
    fmu = exported("K4", version)
    assert fmu.path.stat().st_size < 300_000
    names = set(zipfile.ZipFile(fmu.path).namelist())
    wanted = {"modelDescription.xml", "documentation/index.html", "sources/buildDescription.xml",
              "sources/model.c", f"sources/fmi{version[0]}.c"}  # fmt: skip
    assert wanted <= names
    assert any(n.endswith(".png") for n in names)
    assert not any("Function" in n for n in names)  # FMI's headers are the importer's


def test_the_same_scene_gives_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    scene = cs.load_scene("C2")
    first = export_fmu(scene, tmp_path / "one.fmu").read_bytes()
    assert export_fmu(scene, tmp_path / "two.fmu").read_bytes() == first


@pytest.mark.parametrize(
    "dialect",
    [[], ["-DPLAIN_C", "-pedantic-errors"], ["-mfpmath=387"]],
    ids=["gnu", "c99", "as x86 of 32 bits"],
)
@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_inside_build_without_warnings(version, dialect, exported, tmp_path):
    from contact_system.kernels import find_compiler

    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler on this machine")
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [*compiler, *dialect, str(probe), "-o", str(tmp_path / "probe")]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip(f"the compiler does not take {dialect}")
    folder = os.path.join(exported("K3", version).folder, "sources")
    files = sorted(f for f in os.listdir(folder) if f.endswith(".c"))
    flags = ["-std=c99", "-O0", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared"]
    flags += [f"-I{FMI_HEADERS}", *dialect]
    run = subprocess.run(
        [*compiler, *flags, *files, "-o", str(tmp_path / "built"), "-lm"],
        cwd=folder, capture_output=True, text=True,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr


def test_sources_have_no_words_of_gnu_for_other_compilers(exported, tmp_path):
    from contact_system.kernels import find_compiler

    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler on this machine")
    for name in "float math stdarg stdbool stddef stdint stdio stdlib string".split():
        (tmp_path / f"{name}.h").touch()  # a C library's own headers may define them away
    folder = os.path.join(exported("K1", "3.0").folder, "sources")
    files = sorted(f for f in os.listdir(folder) if f.endswith(".c"))
    flags = ["-std=c99", "-E", "-U__GNUC__", "-U__clang__", "-nostdinc", f"-I{tmp_path}"]
    command = [*compiler, *flags, f"-I{FMI_HEADERS}", *files]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    assert "fmi3DoStep" in run.stdout and "__attribute__" not in run.stdout


def test_sources_of_two_models_make_one_program(exported, tmp_path):
    """FMI 3.0.2, 2.2.2: functions that an importer links bear the model's name."""
    from contact_system.kernels import find_compiler

    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler on this machine")
    flags, objects, main = ["-std=c99", "-O0", f"-I{FMI_HEADERS}"], [], ""
    for name in ("K1", "C2"):
        folder = os.path.join(exported(name, "3.0").folder, "sources")
        own = tmp_path / name
        own.mkdir()
        files = [os.path.join(folder, f) for f in os.listdir(folder) if f.endswith(".c")]
        prefix = f"-DFMI3_FUNCTION_PREFIX={name}_"
        subprocess.run([*compiler, *flags, prefix, "-c", *files], cwd=own, check=True)
        objects += map(str, own.glob("*.o"))
        main += f"const char *{name}_fmi3GetVersion(void);\n"
    main += "int main(void) { return K1_fmi3GetVersion()[0] != C2_fmi3GetVersion()[0]; }\n"
    (tmp_path / "main.c").write_text(main)
    program = str(tmp_path / "both")
    link = [*compiler, str(tmp_path / "main.c"), *objects, "-o", program, "-lm"]
    subprocess.run(link, check=True)
    assert subprocess.run([program]).returncode == 0


@pytest.mark.parametrize("name", ["contact", "enter", "check", "va"])
def test_a_scene_may_be_called_as_the_sources_call_their_own_things(name, tmp_path):
    # contact_kinds, enter_windows, check_step, va_start
    path = export_fmu(cs.load_scene("C1").replace(name=name), tmp_path / "one.fmu")
    assert fmpy.read_model_description(str(path)).coSimulation.modelIdentifier == name


def test_the_sources_refuse_a_build_without_infinities(exported, tmp_path):
    # which would run, and be wrong by 7 rad/s in K4
    from contact_system.kernels import find_compiler

    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler on this machine")
    folder = os.path.join(exported("K1").folder, "sources")
    command = [*compiler, "-Ofast", "-c", "component.c", "-o", str(tmp_path / "built")]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert run.returncode != 0 and "compile without -ffast-math" in run.stderr


def test_only_the_standards_functions_are_seen_outside(exported):
    fmu = exported("K1")
    library = os.path.join(fmu.folder, "binaries", "linux64", "K1.so")
    if not os.path.exists(library):
        pytest.skip("reads the symbols of a Linux library")
    with open(library, "rb") as file:
        table = file.read()
    assert b"\0fmi2DoStep\0" in table
    loaded = ctypes.CDLL(library)
    for name in ("step", "start", "reset", "report", "motion_0", "places"):
        assert not hasattr(loaded, name) or b"\0" + name.encode() + b"\0" not in table


def test_a_cache_that_cannot_be_written_to_is_named(tmp_path, monkeypatch):
    (tmp_path / "taken").touch()
    monkeypatch.setenv("CONTACT_SYSTEM_CACHE", str(tmp_path / "taken"))
    with pytest.raises(cs.ContactSystemError, match="taken': .*; set CONTACT_SYSTEM_CA"):
        export_fmu(cs.load_scene("C1"), tmp_path / "x.fmu")
    assert not (tmp_path / "x.fmu").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")
def test_a_compiler_may_write_in_any_encoding(tmp_path, monkeypatch):
    compiler = tmp_path / "cc"
    compiler.write_text("#!/bin/sh\nprintf 'caf\\351 ferm\\351' >&2\nexit 1\n")
    compiler.chmod(0o755)
    monkeypatch.setattr("fmu_export.build.find_compiler", lambda: (str(compiler),))
    monkeypatch.setenv("CONTACT_SYSTEM_CACHE", str(tmp_path))
    with pytest.raises(cs.ContactSystemError, match="cc(.|\n)*failed:\ncaf"):
        export_fmu(cs.load_scene("C1"), tmp_path / "x.fmu")


def test_two_that_write_one_file_at_a_time_leave_one_that_is_whole(tmp_path):
    path, moment = tmp_path / "x.fmu", (2026, 1, 1, 0, 0, 0)

    def meanwhile(half):
        write_fmu(path, {"later": b"2"}, moment)
        return []

    write_fmu(path, {"first": b"1"}, moment, meanwhile)
    assert zipfile.ZipFile(path).namelist() == ["first"]
    assert [file.name for file in tmp_path.iterdir()] == ["x.fmu"]


def test_an_unknown_platform_is_refused(tmp_path):
    with pytest.raises(cs.ContactSystemError, match="x86_64-linux"):
        export_fmu(cs.load_scene("C1"), tmp_path / "x.fmu", platforms=("amiga",))
    assert "x86_64-windows" in PLATFORMS


@pytest.mark.slow
@pytest.mark.parametrize("platform", sorted(PLATFORMS))
def test_every_platform_compiles(platform, tmp_path):
    pytest.importorskip("ziglang")
    path = export_fmu(cs.load_scene("C1"), tmp_path / "x.fmu", "3.0", platforms=(platform,))
    names = zipfile.ZipFile(path).namelist()
    assert any(n.startswith(f"binaries/{PLATFORMS[platform][1]}/") for n in names)


def test_without_fmpy_the_import_says_what_to_install():
    code = "import sys; sys.modules['fmpy'] = None; import fmu_export"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert 'pip install "contact-system[fmu]"' in run.stderr
