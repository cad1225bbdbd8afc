"""Variables and modelDescription.xml, as fmpy reads and validates them."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from conftest import of_versions

import contact_system as cs

fmpy = pytest.importorskip("fmpy")

from fmpy.model_description import read_model_description  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402
from fmu_hosts.blocks import Instance  # noqa: E402

from fmu_export import in_process, variable_table  # noqa: E402
from fmu_export.data import scene_data  # noqa: E402
from fmu_export.description import model_description, model_identifier, terminals  # noqa: E402

BOTH = ("CoSimulation", "ModelExchange")
K1, C2 = cs.load_scene("K1"), cs.load_scene("C2")


# --- the table


@of_versions
def test_units_of_coordinates_are_those_of_the_chart_in_si_base_units(version, written):
    read = read_model_description(written(C2, version))
    units = {u.name: u.baseUnit for u in read.unitDefinitions}
    assert (units["rad/s2"].rad, units["rad/s2"].s) == (1, -2)
    assert (units["m/s2"].m, units["m/s2"].s) == (1, -2)
    found = {v.name: (v.unit, v.displayUnit) for v in read.modelVariables}
    assert found["der(contact[1].object.v)"] == ("m/s", None)  # of a cylinder
    assert found["contact[1].object.acceleration.u"] == ("rad/s2", "deg/s2")
    assert found["contact[1].twist.angular.x"] == ("rad/s", "deg/s")
    assert variable_table(K1)["gain.eta"].unit == (-2, 1, 0)  # s/m2, m s rad


def test_scenes_and_options_that_make_no_variable_table_are_refused():
    with pytest.raises(cs.SceneError, match="no explicit chart.*leave measured out"):
        variable_table(cs.load_scene("implicit"), measured="states")
    with pytest.raises(cs.SceneError, match="'all' is unknown; use one of nothing, states, pose"):
        variable_table(K1, measured="all")
    with pytest.raises(cs.SceneError, match="^scene = 'K1': give a Scene, such as load_scene"):
        variable_table("K1")
    chart = ("point*sin(u)*cos(v)", "point*sin(u)*sin(v)", "point*cos(u)")
    tip = cs.ParametricSurface(chart, parameters={"point": 0.04}, size=0.04)
    scene = K1.replace(contacts=[cs.Contact(tip, object_at=(1.2, 0.3), finger_at=(1.5, 0.0))])
    with pytest.raises(cs.SceneError, match=r"called contact\[1\].finger.point; give the surface"):
        variable_table(scene)


# --- modelDescription.xml


@pytest.fixture
def written(tmp_path):
    """A function that writes a scene's modelDescription.xml and returns its folder."""

    def write(scene, version, arrays=False, **options):
        scene = cs.load_scene(scene) if isinstance(scene, str) else scene
        table = variable_table(scene, arrays=arrays)
        text = model_description(table, scene_data(table, version)[1], version, **options)
        (tmp_path / "modelDescription.xml").write_text(text, encoding="utf-8")
        return tmp_path

    return write


# Every export is validated except for names of variables, which take fmpy's validation long; these
# scenes have names of all kinds.
@pytest.mark.parametrize(
    ("name", "version"),
    [("D1", "3.0"), ("H3", "2.0"), ("implicit", "3.0"), ("torus", "2.0"), ("chart", "3.0")],
)
def test_fmpy_finds_nothing_wrong_with_the_description(name, version, written):
    assert validate_fmu(str(written(name, version))) == []


@pytest.mark.parametrize(("version", "arrays"), [("2.0", False), ("3.0", False), ("3.0", True)])
def test_fmpy_reads_the_variables_of_the_table(version, arrays, written):
    table = variable_table(cs.load_scene("K4"), arrays=arrays)
    read = read_model_description(written("K4", version, arrays))
    rows = table.joined if arrays else table.rows[version == "2.0" :]
    assert [(v.name, v.valueReference, v.causality, v.start) for v in read.modelVariables] == [
        (v.name, v.reference, v.causality, " ".join(map(repr, v.start)) or None) for v in rows
    ]
    assert len(read.derivatives) == sum(v.derivative is not None for v in rows)
    assert read.defaultExperiment.stopTime == "4.0"
    if version == "2.0":  # FMI 2.0.4, 3.3.1 and 4.3.1: by default allocateMemory would be called
        assert read.coSimulation.canNotUseMemoryManagementFunctions
        assert read.modelExchange.canNotUseMemoryManagementFunctions


@of_versions
def test_states_that_jump_at_events_have_reinit_in_model_exchange(version):
    table = variable_table(cs.load_scene("R1").replace(gain=cs.Gain.guaranteed(1.0)))
    rows = ET.fromstring(model_description(table, "{}", version)).find("ModelVariables")
    found = [v.get("name") for v in rows if any(e.get("reinit") == "true" for e in v.iter())]
    assert found == [f"contact[1].frame.{n}.{a}" for n in ("velocity", "slip") for a in "xy"]
    assert "reinit" not in model_description(table, "{}", version, ("CoSimulation",))


@pytest.mark.parametrize("interfaces", [BOTH, ("CoSimulation",)], ids=" ".join)
@of_versions
def test_every_known_that_changes_an_output_or_a_derivative_is_a_listed_dependency(
    version, interfaces, written
):
    """Knowns by FMI 2.0.4, 2.2.8 and FMI 3.0.2, 2.4.8: inputs, parameters (FMI 3), and states, even
    in Co-Simulation, as it has directional derivatives."""
    scene = cs.load_scene("K4").replace(disturbances=())
    read = read_model_description(written(scene, version, interfaces=interfaces))
    states = {v.derivative.valueReference for v in read.modelVariables if v.derivative}
    kinds = ("input",) if version == "2.0" else ("input", "parameter")
    rows = [v for v in read.modelVariables if v.causality in kinds or v.valueReference in states]
    one = Instance(scene, "slave", "2.0").begin()
    one.step(0.7)
    calculated = [v.reference for v in one.table.rows if v.initial == "calculated"]
    at = {reference: k for k, reference in enumerate(calculated)}
    derivatives = one.own.getDirectionalDerivative
    moved = {v.name: derivatives(calculated, [v.valueReference], [1.0]) for v in rows}
    # no output depends on accelerations, so that a loop over them is no algebraic loop
    listed = {u.variable.name: {d.name for d in u.dependencies} for u in read.outputs}
    assert not any("accel" in d for name, ds in listed.items() if "active" not in name for d in ds)
    for unknown in (*read.outputs, *read.derivatives):
        k, listed = at[unknown.variable.valueReference], {d.name for d in unknown.dependencies}
        for name, column in moved.items():
            assert name in listed or abs(column[k]) <= 1e-9, (unknown.variable.name, name)


@of_versions
def test_a_parameter_may_have_a_greek_name(version, written):
    """Structured names are ASCII (FMI 2.0.4, 2.2.9; FMI 3.0.2, 2.4.7.5.1)."""
    chart = ("λ*sin(u)*cos(v)", "λ*sin(u)*sin(v)", "λ*cos(u)")
    ball = cs.ParametricSurface(chart, parameters={"λ": 0.04}, size=0.04)
    contact = cs.Contact(ball, object_at=(1.2, 0.3), finger_at=(1.5, 0.0))
    folder = written(K1.replace(contacts=[contact]), version)
    assert validate_fmu(str(folder)) == []
    names = {v.name for v in read_model_description(folder).modelVariables}
    assert "contact[1].finger.λ" in names


def test_the_token_depends_on_the_scene_and_not_on_the_date(monkeypatch, written):
    def token(scene):
        return read_model_description(written(scene, "3.0")).instantiationToken

    scene = cs.load_scene("K2")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    first = token(scene)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    assert token(scene) == first
    date = read_model_description(written(scene, "2.0")).generationDateAndTime
    assert date == "1970-01-02T00:00:00Z"
    moved = dataclasses.replace(scene.disturbances[0], value=(0.2, 0.0))
    assert token(scene.replace(disturbances=[moved])) != first


def test_names_of_scenes_become_model_identifiers_and_are_escaped_in_xml(written):
    for name, identifier in {
        "4 balls & a cup": "scene_4_balls___a_cup",
        "": "scene",
        "x" * 300: "x" * 100,
    }.items():
        assert model_identifier(C2.replace(name=name)) == identifier
    scene = C2.replace(name="a<b>&\"c'", description="1 < 2 & 3\x01\n\ufffe\U0001f600")
    for version in ("2.0", "3.0"):
        read = read_model_description(written(scene, version))
        told = "1 < 2 & 3\ufffd\n\ufffd\U0001f600"  # XML has no control characters
        assert (read.modelName, read.description) == (scene.name, told)


@of_versions
def test_the_description_of_a_slave_has_its_capabilities(version):
    with in_process(K1, version) as planner:
        text, read = Path(planner["filename"], "modelDescription.xml"), planner["model_description"]
        assert "ntermediateUpdate" not in text.read_text()
    assert read.fmiVersion == version and read.modelExchange is None
    assert read.coSimulation.canHandleVariableCommunicationStepSize
    assert not read.coSimulation.canInterpolateInputs
    with pytest.raises(cs.ContactSystemError, match="fmi_version = '1.0' is unknown.*2.0, 3.0"):
        in_process(K1, "1.0").__enter__()


def test_fmpy_steps_a_slave_with_event_mode_to_each_event():
    with in_process(cs.load_scene("K2"), "3.0", event_mode=True, early_return=True) as planner:
        times = fmpy.simulate_fmu(**planner, output_interval=0.25)["time"].tolist()
    assert times == [0.0, 0.1, 0.1, 0.25, 0.5, 0.75, 1.0]


@pytest.mark.parametrize("measured", ["pose", "states"])
def test_terminals_for_motion_and_for_measured_inputs_have_the_same_members(measured):
    table = variable_table(cs.load_scene("K2"), measured=measured)
    found = {t.get("name"): t for t in ET.fromstring(terminals(table)).find("Terminals")}
    members = {name: {m.get("memberName") for m in t} for name, t in found.items()}
    kinds = "disturbance", "measured", "motion"
    assert {f"contact{i}_{kind}" for i in (1, 2, 3) for kind in kinds} == set(members)
    assert members["contact1_measured"] - members["contact1_motion"] == {"trigger"}
    trigger = table["contact[1].measured.trigger"].reference  # outputs show what was measured
    assert trigger in table["contact[1].slip.x"].known
