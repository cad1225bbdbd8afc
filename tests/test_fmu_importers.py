"""In every importer an FMU gives the plan's numbers."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import derivative, one_contact

import contact_system as cs

pytest.importorskip("fmpy")

from fmu_hosts import importers
from fmu_hosts.blocks import close, exported, simulated
from fmu_hosts.importers import casadi_function
from fmu_hosts.native import Unavailable

from fmu_export import variable_table

VERSIONS, K4 = ("2.0", "3.0"), cs.load_scene("K4")


def off_plan(scene: cs.Scene, run, version: str, count: int, **options) -> float:
    try:
        return importers.off_plan(run, exported(scene, version, **options), scene, count)
    except Unavailable as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("importer", importers.STEPPING)
def test_importers_step_an_fmu_along_the_plan(importer, version):
    assert off_plan(K4, getattr(importers, f"{importer}_steps"), version, 96) < 1e-12


@pytest.mark.slow  # ziglang builds a C library when it is used first
def test_wasmtime_steps_an_fmu_along_the_plan():
    pytest.importorskip("ziglang")
    off = off_plan(K4, importers.wasm_steps, "3.0", 96, platforms=("wasm32",))
    print(f"wasm32: {off:.1e} off plan()")
    assert off < 1e-13


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("importer", importers.INTEGRATING)
def test_importers_integrate_an_fmu_along_the_plan(importer, version):
    scene = one_contact("ellipsoid", duration=2.0) if importer == "casadi" else K4  # no windows
    assert off_plan(scene, getattr(importers, f"{importer}_integrates"), version, 64) < 1e-7


def test_cvode_with_the_fmus_default_tolerance_follows_a_path_of_many_turns():
    scene = cs.load_scene("D3")
    run, fmu = importers.fmpy_integrates, exported(scene, "2.0")
    assert importers.off_plan(run, fmu, scene, 256, scene.duration / 256) < 1e-7


@pytest.mark.parametrize("version", VERSIONS)
def test_model_exchange_under_an_input_that_jumps_gives_what_co_simulation_gives(version):
    times, name = np.linspace(0.0, 1.0, 101), "contact[1].finger.acceleration.u"
    signal = np.rec.fromarrays([times, np.sin(3 * times)], names=["time", name])
    given = {"input": signal, "stop_time": 1.0, "output_interval": 0.01, "record_events": False}
    given |= {"output": ["contact[1].object.point.x"], "relative_tolerance": None}
    held, solved = (
        simulated(K4, version, fmi_type=kind, **given)["contact[1].object.point.x"]
        for kind in ("CoSimulation", "ModelExchange")
    )
    close(solved, held, 1e-9)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("result", ["ode", "y"])
def test_the_jacobian_in_casadi_agrees_with_central_differences(result, version):
    table = variable_table(K4)
    function, builder = casadi_function(exported(K4, version), ["x", "u"], result)
    columns = [table[n].reference for n in [*builder.x(), *builder.u()]]
    x = table.start_values[columns] + 0.1 * np.random.default_rng(1).standard_normal(len(columns))
    split = lambda x: np.split(x, [function.size1_in(0)])  # noqa: E731
    parts = function.jacobian()(*split(x), function(*split(x)))
    jacobian = np.hstack([part.full() for part in parts])
    value = lambda h: function(*split(x + h)).full().ravel()  # noqa: E731
    columns = [
        derivative(lambda t, e=e: np.array([value(s * e) for s in t]), np.zeros(1), 1e-2)[0]
        for e in np.eye(len(x))
    ]
    assert np.abs(np.stack(columns, axis=1) - jacobian).max() < 1e-9 * np.abs(jacobian).max()
