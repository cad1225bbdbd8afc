"""SSP systems of planners and other FMUs, run by fmpy."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest
from conftest import one_contact

import contact_system as cs

fmpy = pytest.importorskip("fmpy")

from fmpy.ssp.simulation import simulate_ssp  # noqa: E402
from fmpy.ssp.ssd import read_ssd  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402
from fmu_hosts.blocks import Instance  # noqa: E402

from fmu_export import export_fmu, export_ssp  # noqa: E402

STEP, SLIP, PUSH = 0.01, "contact[1].slip_speed", "contact[1].finger.acceleration.u"
LEFT, RIGHT = one_contact(), one_contact("ellipsoid", object_velocity="rolling")


def test_an_output_of_one_model_disturbs_a_planner(tmp_path):
    """fmpy gives a model at each step the outputs of others from the step before."""
    other = export_fmu(LEFT, tmp_path / "other.fmu")
    wires = [(f"wind.{SLIP}", f"hand.{PUSH}"), (f"hand.{SLIP}", "slip")]
    assert read_ssd(str(export_ssp({"alone": LEFT}, tmp_path / "alone.ssp")))
    path = export_ssp({"wind": other, "hand": RIGHT}, tmp_path / "windy.ssp", wires)
    result = simulate_ssp(str(path), stop_time=0.5, step_size=STEP)
    wind, hand = (Instance(scene, "FMU", "2.0").begin() for scene in (LEFT, RIGHT))
    push, slips = 0.0, []
    for _ in result:
        hand.put({PUSH: push})
        wind.step(STEP), hand.step(STEP)
        (push,), (slip,) = wind.get(SLIP), hand.get(SLIP)
        slips.append(slip)
    assert result["slip"].tolist() == slips and max(slips) > 1e-6


def test_an_input_of_the_system_disturbs_the_connected_planner_and_no_other(tmp_path):
    wires = [("push", f"../right.{PUSH}"), (f"100%.{SLIP}", "first"), (f"100%.{SLIP}", "again")]
    wires += [(f"../right.{SLIP}", "second")]
    path = export_ssp({"100%": LEFT, "../right": RIGHT}, tmp_path / "two.ssp", iter(wires))
    inside = ["SystemStructure.ssd", "resources/1.fmu", "resources/2.fmu"]
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == inside
        for name in inside[1:]:
            assert validate_fmu(archive.extract(name, tmp_path)) == []
    system = read_ssd(str(path)).system
    assert [c.name for c in system.connectors] == ["push", "first", "again", "second"]
    assert [c.name for c in system.elements[0].connectors] == [SLIP]
    given = {"push": lambda t: 0.5 if t < 0.2 else 0.0}
    result = simulate_ssp(str(path), stop_time=0.5, step_size=STEP, input=given)
    window = cs.FingerAcceleration(0, STEP, 0.2 + STEP, (0.5, 0.0))  # a step late in fmpy
    for name, scene in (("first", LEFT), ("second", RIGHT.replace(disturbances=[window]))):
        t = np.minimum(STEP * np.arange(1, len(result) + 1), scene.duration)
        slip = cs.plan(scene, 1e-14).slip_speed(t)[:, 0]
        assert result[name] == pytest.approx(slip, abs=1e-12) and slip.max() > 1e-6


def test_a_variable_of_an_enumeration_type_can_be_connected(tmp_path):
    mode = """<fmiModelDescription fmiVersion="2.0" modelName="a" guid="a">
      <CoSimulation modelIdentifier="a"/><TypeDefinitions><SimpleType name="T"><Enumeration>
      <Item name="on" value="1"/></Enumeration></SimpleType></TypeDefinitions><ModelVariables>
      <ScalarVariable name="mode" valueReference="1" causality="input"
      variability="discrete"><Enumeration
      declaredType="T" start="1"/></ScalarVariable></ModelVariables><ModelStructure/>
      </fmiModelDescription>"""
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", mode)
    path = export_ssp({"a": tmp_path / "a.fmu"}, tmp_path / "a.ssp", [("pick", "a.mode")])
    assert [c.name for c in read_ssd(str(path)).system.connectors] == ["pick"]  # valid by schema


@pytest.mark.parametrize(
    ("models", "words"),
    [
        *((x, r"^models = .*: give Scenes") for x in ({}, LEFT, [LEFT], {1: LEFT})),
        *(({"a": x}, "models: 'a' = .*neither a Scene nor an FMU") for x in ("K1", 3)),
    ],
)
def test_models_that_are_not_a_dict_of_scenes_and_fmus_are_refused(models, words, tmp_path):
    with pytest.raises(cs.ContactSystemError, match=words):
        export_ssp(models, tmp_path / "none.ssp")


@pytest.mark.parametrize(
    ("wires", "words"),
    [
        ([("in", "a.push")], r"'a.push' is no input of 'a', which has .*contact\[1\]"),
        ([(f"a.{SLIP}s", "slip")], r"is no output of 'a' \(did you mean 'contact\[1\].slip_speed'"),
        ([("in", f"a.{PUSH}"), (f"a.{SLIP}", f"a.{PUSH}")], "is connected already"),
        ([("in", "out")], "neither is a variable of a model"),
        ([(f"a.{SLIP}", "x"), ("x", f"a.{PUSH}")], "'x' is connected already, as an output"),
        *((wires, "^connections.* give pairs") for wires in (["in"], [5], [(1, 2)], 5)),
    ],
)
def test_connections_of_wrong_names_directions_or_kind_are_refused(wires, words, tmp_path):
    with pytest.raises(cs.ContactSystemError, match=words):
        export_ssp({"a": LEFT}, tmp_path / "none.ssp", wires)
    assert not (tmp_path / "none.ssp").exists()
