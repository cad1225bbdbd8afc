"""Systems of planner FMUs, run by fmpy's SSP simulation."""

from __future__ import annotations

import ctypes
import zipfile

import numpy as np
import pytest
from conftest import one_contact

import contact_system as cs

fmpy = pytest.importorskip("fmpy")

from fmpy.fmi1 import FMICallException  # noqa: E402
from fmpy.ssp.simulation import simulate_ssp  # noqa: E402
from fmpy.ssp.ssd import read_ssd  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402
from fmu_hosts.native import Fmu  # noqa: E402

from fmu_export.ssp import export_ssp, system_structure  # noqa: E402
from fmu_export.variables import variable_table  # noqa: E402

STEP = 0.01


def slid(scene: cs.Scene, rows: int) -> np.ndarray:
    """What the consumer adds up: slip as the planner told it one step before, held for a step.

    (rows, n_contacts), m.
    """
    speeds = cs.plan(scene, 1e-14).slip_speed(np.minimum(STEP * np.arange(1, rows), scene.duration))
    return np.vstack([0 * speeds[:1], STEP * np.cumsum(speeds, axis=0)])


def distances(result: np.ndarray, count: int, prefix: str = "") -> np.ndarray:
    """The outputs of the system: (rows, n_contacts), m; known to it one row later."""
    return np.stack([result[f"{prefix}distance[{i + 1}]"] for i in range(count)], axis=1)


def test_consumer_adds_up_the_slip_of_the_plan(tmp_path):
    scene = cs.load_scene("K1")
    path = export_ssp(scene, tmp_path / "planner.ssp")
    result = simulate_ssp(str(path), stop_time=0.5, step_size=STEP)
    found, expected = distances(result, 3), slid(scene, len(result))
    assert found == pytest.approx(expected, abs=1e-15)
    assert found[-1].min() > 1e-5


def test_disturbances_come_in_through_the_system_and_planners_do_not_mix(tmp_path):
    left, right = one_contact(), one_contact("ellipsoid", object_velocity="rolling")
    path = export_ssp({"100%": left, "../right": right}, tmp_path / "two.ssp")
    with zipfile.ZipFile(path) as archive:  # names that a file or a URI would have to escape
        assert archive.namelist() == [
            "SystemStructure.ssd",
            "resources/100__planner.fmu",
            "resources/100__slip_integrator.fmu",
            "resources/___right_planner.fmu",
            "resources/___right_slip_integrator.fmu",
        ]
    push = "../right.contact[1].finger.acceleration.u"
    result = simulate_ssp(
        str(path), stop_time=0.5, step_size=STEP, input={push: lambda t: 0.5 if t < 0.2 else 0.0}
    )
    assert distances(result, 1, "100%.") == pytest.approx(slid(left, len(result)), abs=1e-15)
    # The input acts one step late, as all that passes through fmpy's connections.
    window = cs.FingerAcceleration(0, STEP, 0.2 + STEP, (0.5, 0.0))
    pushed = slid(right.replace(disturbances=[window]), len(result))
    assert distances(result, 1, "../right.") == pytest.approx(pushed, abs=1e-12)
    assert pushed[-1] > 1e-6


def test_file_is_valid_and_holds_valid_fmus(tmp_path):
    path = export_ssp(cs.load_scene("C2"), tmp_path / "planner.ssp", iter(["native"]))
    assert read_ssd(str(path)).system.name == "planners"
    with zipfile.ZipFile(path) as archive:
        fmus = [name for name in archive.namelist() if name.endswith(".fmu")]
        assert fmus == ["resources/planner.fmu", "resources/slip_integrator.fmu"]
        for name in fmus:
            archive.extract(name, tmp_path)
            assert validate_fmu(str(tmp_path / name)) == []
    consumer = str(tmp_path / fmus[1])
    can = fmpy.read_model_description(consumer).coSimulation
    assert can.canNotUseMemoryManagementFunctions  # else allocateMemory would be called
    slips = {"distance[1]": 0.25, "slip[1].x": 0.3, "slip[1].y": -0.4}
    result = fmpy.simulate_fmu(consumer, start_values=slips, stop_time=1.0, output_interval=0.5)
    assert result["distance[1]"].tolist() == pytest.approx([0.25, 0.5, 0.75], abs=1e-15)


@pytest.fixture(scope="module")
def consumer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("consumer")
    path = export_ssp(cs.load_scene("C2"), folder / "planner.ssp")
    with zipfile.ZipFile(path) as archive:
        archive.extract("resources/slip_integrator.fmu", folder)
    return Fmu.unpacked(folder / "resources" / "slip_integrator.fmu", folder / "consumer")


def test_consumer_refuses_as_planners_do_with_a_line_in_the_log(consumer):
    said: list[tuple] = []
    one = consumer.instance(lambda *line: said.append(line))

    def refused(words, call, *arguments):
        with pytest.raises(FMICallException):
            call(*arguments)
        status, category, text = said[-1]
        assert (status, category) == (3, "logStatusError") and words in text

    refused("fmi2DoStep is not allowed before initialization begins", one.doStep, 0.0, 0.1)
    one.setupExperiment()
    one.enterInitializationMode()
    one.setReal([0, 1, 2], [3.0, 4.0, 1.0])
    one.exitInitializationMode()
    for size in (0.0, -0.1, np.inf, np.nan):
        refused("give a positive length", one.doStep, 0.0, size)
    one.doStep(0.0, 0.1)
    refused("begins at t = 0 s, but the instance stands at t = 0.1", one.doStep, 0.0, 0.1)
    refused("distance[1] is a start value", one.setReal, [0, 2], [1.0, 0.0])
    refused("value reference 0 = nan is refused", one.setReal, [0], [np.nan])
    refused("no variable with value reference 3", one.getReal, [3])
    refused("fmi2GetFMUstate: this block does not have it", one.getFMUstate)
    assert one.getInteger([]) == []
    assert one.getReal([0, 1, 2]) == [3.0, 4.0, 1.5]
    one.terminate()
    refused("after the simulation has ended; reset first", one.doStep, 0.1, 0.1)
    assert one.dll.fmi2DoStep(None, ctypes.c_double(0.0), ctypes.c_double(0.1), 0) == 3
    categories = [category.name for category in consumer.description.logCategories]
    assert {line[1] for line in said} == {*categories}


def test_names_alike_get_files_of_their_own():
    scene = one_contact()
    tables = {name: variable_table(scene) for name in ("a_b_3", "a/b", "a b", "A_B")}
    text = system_structure(tables)
    for stem in ("a_b_3", "a_b", "a_b_3_3", "A_B_4"):
        for part in ("planner", "slip_integrator"):
            assert text.count(f'source="resources/{stem}_{part}.fmu"') == 1


@pytest.mark.parametrize("scenes", [{}, "K1", [one_contact()], {1: one_contact()}, {"a": "K1"}])
def test_what_are_no_scenes_by_name_is_refused(scenes, tmp_path):
    with pytest.raises(cs.ContactSystemError, match=r"^scenes? = .*: give a Scene, "):
        export_ssp(scenes, tmp_path / "none.ssp")
