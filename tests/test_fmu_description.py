"""modelDescription.xml and its companions, against fmpy's own reading and validation."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import contact_system as cs

pytest.importorskip("fmpy")

from fmpy.model_description import read_build_description, read_model_description
from fmpy.validation import validate_fmu
from fmu_hosts.importers import kernel_jacobian

from fmu_export.description import (
    INTERFACES,
    VERSIONS,
    build_description,
    instantiation_token,
    model_description,
    model_identifier,
    terminals,
)
from fmu_export.ssp import _consumer_description
from fmu_export.variables import variable_table

PAPER = ["K1", "K2", "K3", "K4", "D1", "D2", "D3", "C1", "C2"]


@pytest.fixture
def written(tmp_path):
    """Write a description; return its folder."""

    def write(name, version, **options):
        table = variable_table(cs.load_scene(name) if isinstance(name, str) else name)
        text = model_description(table, version, **options)
        (tmp_path / "modelDescription.xml").write_text(text, encoding="utf-8")
        return tmp_path

    return write


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", [*PAPER, "torus", "chart", "bowl"])
def test_validation_has_nothing_to_say(name, version, written):
    assert validate_fmu(str(written(name, version))) == []


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_reads_back_what_the_table_says(version, written):
    table = variable_table(cs.load_scene("K4"))
    read = read_model_description(written("K4", version))
    rows = table.rows if version == "3.0" else table.scalars()[1:]
    assert [(v.name, v.valueReference, v.causality) for v in read.modelVariables] == [
        (v.name, v.reference, v.causality) for v in rows
    ]
    assert len(read.derivatives) == (33 if version == "2.0" else 3 * 9)
    assert read.defaultExperiment.stopTime == "4.0"
    assert read.generationDateAndTime.endswith("Z")


def test_memory_that_an_importer_offers_is_said_not_to_be_used(written):
    """FMI 2.0.4, tables in 3.3.1 and 4.3.1: by default allocateMemory would be called."""
    read = read_model_description(written("C2", "2.0"))
    consumer = ET.fromstring(_consumer_description(1, "{}")).find("CoSimulation")
    assert read.coSimulation.canNotUseMemoryManagementFunctions
    assert read.modelExchange.canNotUseMemoryManagementFunctions
    assert consumer.get("canNotUseMemoryManagementFunctions") == "true"


def test_dependencies_stand_by_index_in_fmi_2(written):
    read = read_model_description(written("C2", "2.0"))
    found = {u.variable.name: {d.name for d in u.dependencies} for u in read.outputs}
    assert found["der(contact[1].object.v)"] == {
        "contact[1].object.velocity.y", "contact[1].object.velocity.x",
        "contact[1].object.frame_angle", "contact[1].object.rate_offset.v",
    }  # fmt: skip
    initial = {u.variable.name: {d.name for d in u.dependencies} for u in read.initialUnknowns}
    assert "profile[2]" in initial["der(contact[1].object.v)"]


@pytest.mark.parametrize("interfaces", [INTERFACES, ("CoSimulation",)], ids=" ".join)
@pytest.mark.parametrize("version", VERSIONS)
def test_whatever_moves_an_output_or_a_derivative_is_listed(version, interfaces, written):
    """All knowns of FMI 2.0.4, 2.2.8 and FMI 3.0.2, 2.4.8: parameters in FMI 3, states also in
    Co-Simulation, which gives directional derivatives."""
    scene = cs.load_scene("K4").replace(disturbances=())
    table = variable_table(scene)
    read = read_model_description(written(scene, version, interfaces=interfaces))
    states = {v.derivative.valueReference for v in read.modelVariables if v.derivative}
    kinds = ("input",) if version == "2.0" else ("input", "parameter", "independent")
    rows = [v for v in read.modelVariables if v.causality in kinds or v.valueReference in states]
    values = table.start_values + 0.1 * np.random.default_rng(1).standard_normal(table.n_values)
    values[0] = 0.7
    jacobian = kernel_jacobian(scene, values)

    def elements(variable):
        first = variable.valueReference
        return slice(first, first + int(np.prod([int(d.start) for d in variable.dimensions])))

    for unknown in (*read.outputs, *read.derivatives):
        moved = {
            known.name
            for known in rows
            if np.abs(jacobian[elements(unknown.variable), elements(known)]).max() > 1e-9
        }
        assert moved <= {d.name for d in unknown.dependencies}


def test_two_variables_of_one_name_are_refused():
    tip = cs.ParametricSurface(
        ("point*sin(u)*cos(v)", "point*sin(u)*sin(v)", "point*cos(u)"),
        parameters={"point": 0.04}, size=0.04,
    )  # fmt: skip
    contact = cs.Contact(tip, object_at=(1.2, 0.3), finger_at=(1.5, 0.0))
    scene = cs.load_scene("K1").replace(contacts=[contact])
    with pytest.raises(cs.SceneError, match=r"called contact\[1\].finger.point; give the surface"):
        variable_table(scene)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_parameter_may_have_a_greek_name(version, written):
    """Structured names are ASCII (FMI 2.0.4, 2.2.9; FMI 3.0.2, 2.4.7.5.1)."""
    ball = cs.ParametricSurface(
        ("λ*sin(u)*cos(v)", "λ*sin(u)*sin(v)", "λ*cos(u)"), parameters={"λ": 0.04}, size=0.04
    )
    contact = cs.Contact(ball, object_at=(1.2, 0.3), finger_at=(1.5, 0.0))
    folder = written(cs.load_scene("K1").replace(contacts=[contact]), version)
    assert validate_fmu(str(folder)) == []
    names = {v.name for v in read_model_description(folder).modelVariables}
    assert "contact[1].finger.λ" in names


def test_outputs_may_be_read_between_internal_steps(written):
    """FMI 3.0.2, 4.2.2: a variable that is not marked must not be."""
    read = ET.parse(written("K4", "3.0") / "modelDescription.xml").find("ModelVariables")
    marked = {v.get("name") for v in read if v.get("intermediateUpdate") == "true"}
    assert marked == {v.get("name") for v in read if v.get("causality") == "output"}


@pytest.mark.parametrize("version", VERSIONS)
def test_every_unit_is_made_of_base_units(version, written):
    read = read_model_description(written("C2", version))
    units = {u.name: u.baseUnit for u in read.unitDefinitions}
    assert (units["rad/s2"].rad, units["rad/s2"].s) == (1, -2)
    assert (units["m/s2"].m, units["m/s2"].s) == (1, -2)


def test_the_token_tells_scenes_apart_and_not_dates(monkeypatch):
    def token(scene):
        return instantiation_token(model_description(variable_table(scene), "3.0"))

    scene = cs.load_scene("K2")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    first = token(scene)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    assert token(scene) == first
    window = scene.disturbances[0]
    moved = type(window)(0, window.start, window.stop, (0.2, 0.0))
    assert token(scene.replace(disturbances=[moved])) != first


def test_the_date_is_the_one_asked_for(monkeypatch, written):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    read = read_model_description(written("C1", "2.0"))
    assert read.generationDateAndTime == "1970-01-02T00:00:00Z"
    for wrong in ("abc", "-1", "1e9", "9" * 30):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", wrong)
        with pytest.raises(cs.ContactSystemError, match=f"SOURCE_DATE_EPOCH = '{wrong}': give"):
            written("C1", "2.0")


def test_the_identifier_is_a_c_name():
    scene = cs.load_scene("C1")
    for name, identifier in (
        ("4 balls & a cup", "scene_4_balls___a_cup"), ("", "scene"), ("Con", "scene_Con"),
        ("console", "console"),
    ):  # fmt: skip
        assert model_identifier(variable_table(scene.replace(name=name))) == identifier
    assert len(model_identifier(variable_table(scene.replace(name="x" * 300)))) == 100


def test_names_are_escaped_for_xml(written):
    scene = cs.load_scene("C1").replace(name="a<b>&\"c'", description="1 < 2 & 3")
    read = read_model_description(written(scene, "2.0"))
    assert (read.modelName, read.description) == ("a<b>&\"c'", "1 < 2 & 3")


def test_characters_that_xml_cannot_hold_are_replaced(written):
    scene = cs.load_scene("C1")
    contact = dataclasses.replace(scene.contacts[0], name="\ud800b")
    scene = scene.replace(name="a\x01b", description="\x00\ufffe", contacts=[contact])
    read = read_model_description(written(scene, "3.0"))
    assert (read.modelName, read.description) == ("a\ufffdb", "\ufffd\ufffd")
    assert "\ufffdb" in ET.fromstring(terminals(variable_table(scene)).encode())[0][0].get(
        "description"
    )


def test_the_build_description_is_valid(tmp_path):
    table = variable_table(cs.load_scene("K1"))
    (tmp_path / "sources").mkdir()
    (tmp_path / "sources" / "buildDescription.xml").write_text(build_description(table, ["a.c"]))
    (build,) = read_build_description(tmp_path)
    assert build.modelIdentifier == "K1"
    assert build.sourceFileSets[0].sourceFiles == ["a.c"]


def test_a_terminal_gathers_a_contact():
    text = terminals(variable_table(cs.load_scene("K1")))
    assert text.count("<Terminal ") == 3
    assert 'variableName="contact[2].slip" memberName="slip"' in text


@pytest.mark.parametrize(
    "options",
    [
        {"fmi_version": "1.0"},
        {"interfaces": ()},
        {"interfaces": ("Scheduled",)},
        {"interfaces": ("CoSimulation", "CoSimulation")},
        {"interfaces": "CoSimulation"},
        {"interfaces": None},
    ],
)
def test_what_there_is_not_is_refused(options):
    with pytest.raises(cs.ContactSystemError, match=r"use one of|give a list of one or both"):
        model_description(variable_table(cs.load_scene("C1")), **options)
