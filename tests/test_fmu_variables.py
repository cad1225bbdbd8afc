"""The table of variables of an FMU."""

from __future__ import annotations

import numpy as np
import pytest

import contact_system as cs
from contact_system.system import SceneSystem

pytest.importorskip("fmpy")

from fmu_export.model import RESULTS, STATES, contact_results, start_state
from fmu_export.variables import BLOCK, INPUTS, chart_units, unit_name, variable_table

PAPER = ["K1", "K2", "K3", "K4", "D1", "D2", "D3", "C1", "C2"]


def results_at(scene, contact, state, w=(0.0,) * 6, t=0.0):
    """The component's results from the generated expression."""
    finger = scene.contacts[contact].finger
    law = (scene.gain.value, *scene.profile.coefficients)
    function = contact_results(finger, scene.object, scene.gain.law, len(law) - 1)
    value = function(t, state, w, law, finger.parameters, scene.object.parameters)
    return value.full().ravel()


def test_names_of_a_contact_are_those_that_were_promised():
    table = variable_table(cs.load_scene("K4"))
    for name in (
        "contact[1].finger.u", "contact[1].finger.v", "der(contact[1].finger.u)",
        "der(contact[3].object.v)", "contact[2].object.u", "contact[1].angle",
        "contact[3].slip.x", "contact[1].slip.y", "contact[1].twist.angular.z",
        "contact[1].pose.rotation[3,1]", "contact[1].pose.position.x", "gain.eta", "profile[3]",
        "object.a", "contact[2].finger.radius", "contact[1].finger.acceleration.u",
        "contact[1].object.rate_offset.v",
    ):  # fmt: skip
        assert table[name].name == name


@pytest.mark.parametrize("name", PAPER)
def test_references_count_the_elements_without_gaps(name):
    table = variable_table(cs.load_scene(name))
    scalars = table.scalars()
    assert [v.reference for v in scalars] == list(range(table.n_values))
    assert len({v.name for v in scalars}) == len(scalars)
    at = 0
    for row in table.rows:
        assert row.reference == at
        assert row.size == int(np.prod(row.shape, dtype=int))
        at += row.size


def test_a_block_holds_inputs_state_and_results():
    assert BLOCK == INPUTS + STATES + RESULTS
    table = variable_table(cs.load_scene("K1"))
    assert np.diff(table.blocks).tolist() == [BLOCK, BLOCK]
    first = table.blocks[1]
    assert table["contact[2].finger.acceleration.u"].reference == first
    assert table["contact[2].finger.u"].reference == first + INPUTS
    assert table["der(contact[2].finger.u)"].reference == first + INPUTS + STATES


def test_start_values_are_those_of_the_scene():
    scene = cs.load_scene("K3")
    table = variable_table(scene)
    starts = table.start_values
    assert starts[table["object.b"].reference] == 0.2
    assert starts[table["contact[2].object.u"].reference] == scene.contacts[1].object_at[0]
    assert starts[table["gain.eta"].reference] == 100.0
    c = scene.contacts[0]
    velocity = table["contact[1].finger.velocity"]
    assert velocity.start == c.finger_velocity


def test_derivatives_point_at_their_states():
    table = variable_table(cs.load_scene("D1"))
    names = {v.reference: v.name for v in table.scalars()}
    found = [v for v in table.scalars() if v.derivative is not None]
    assert len(found) == 3 * STATES
    assert all(v.name == f"der({names[v.derivative]})" for v in found)


def test_units_follow_the_chart():
    rad, metre = (0, 0, 1), (1, 0, 0)
    assert chart_units(cs.Sphere(1.0)) == (rad, rad)
    assert chart_units(cs.Cylinder(1.0)) == (rad, metre)
    assert chart_units(cs.Plane()) == (metre, metre)
    table = variable_table(cs.load_scene("C2"))
    units = {v.name: unit_name(v.unit) for v in table.rows if v.unit is not None}
    assert units["der(contact[1].object.v)"] == "m/s"
    assert units["contact[1].object.acceleration.u"] == "rad/s2"
    assert units["profile[2]"] == "m/s2"
    assert units["contact[1].finger.velocity"] == "1"


def test_a_path_gain_has_its_unit():
    table = variable_table(cs.load_scene("K1"))
    assert unit_name(table["gain.eta"].unit) == "s/m2"


@pytest.mark.parametrize("name", ["K1", "K4", "C2", "C1"])
def test_results_at_the_start_are_those_of_the_plan(name):
    scene = cs.load_scene(name)
    plan = cs.plan(scene)
    for i, contact in enumerate(scene.contacts):
        got = results_at(scene, i, start_state(contact))
        wanted = plan.states(0.0)[0, i]
        rates = got[[0, 1, 5, 6]]
        assert np.allclose(rates, wanted[[2, 3, 6, 7]], rtol=0, atol=1e-13)
        assert np.allclose(got[STATES : STATES + 2], plan.slip(0.0)[0, i], rtol=0, atol=1e-15)
        assert np.allclose(got[STATES + 2 : STATES + 8], plan.twist(0.0)[0, i], rtol=0, atol=2e-13)
        pose = plan.pose(0.0)[0, i]
        assert np.allclose(got[STATES + 8 : STATES + 17], pose[:3, :3].ravel(), rtol=0, atol=1e-14)
        assert np.allclose(got[STATES + 17 : STATES + 20], pose[:3, 3], rtol=0, atol=1e-15)


def test_results_agree_with_the_chart_equations_away_from_the_start():
    scene = cs.load_scene("K4")
    t, w = 1.5, np.array([-0.3, 0.2, 0.1, 0.4, 0.5, -0.6])
    system = SceneSystem(scene, "chart", disturbance_input=True)
    random = np.random.default_rng(3)
    state = start_state(scene.contacts[0]) + 0.1 * random.standard_normal(STATES)
    got = results_at(scene, 0, state, w, t)
    sigma = scene.profile(t)
    turned = [np.array([[np.cos(x), -np.sin(x)], [np.sin(x), np.cos(x)]]) for x in state[[2, 7]]]
    roots = [
        scene.contacts[0].finger.metric_root(*state[:2]),
        scene.object.metric_root(*state[5:7]),
    ]
    q1 = sigma * np.linalg.solve(roots[0], turned[0] @ state[3:5])
    q2 = sigma * np.linalg.solve(roots[1], turned[1] @ state[8:10])
    chart = np.array([*state[:2], *q1, *state[5:7], *q2, state[10]])
    x = np.concatenate([chart, system.x0[9:]])
    wide = np.concatenate([w, np.zeros(12)])
    slip = system.evaluate("slip", t, x, wide)[:2]
    twist = system.evaluate("twist", t, x, wide)[:6]
    rate = system.evaluate("derivatives", t, x, wide)[:9]
    assert np.allclose(got[[0, 1, 5, 6, 10]], rate[[0, 1, 4, 5, 8]], rtol=0, atol=1e-13)
    assert np.allclose(got[STATES : STATES + 2], slip, rtol=0, atol=1e-14)
    assert np.allclose(got[STATES + 2 : STATES + 8], twist, rtol=0, atol=1e-12)


def test_results_exist_where_sigma_is_zero():
    scene = cs.load_scene("C1")
    assert scene.profile(0.0) == 0.0
    assert np.isfinite(results_at(scene, 0, start_state(scene.contacts[0]))).all()


def test_dependencies_are_exact_on_a_sphere():
    table = variable_table(cs.load_scene("K1"))

    def known(name):
        names = {v.reference: v.name for v in table.scalars()}
        return {names[r] for r in table[name].known[0]}

    profile = {"profile[1]", "profile[2]", "profile[3]"}
    assert known("der(contact[1].finger.u)") == {
        "time", *profile, "contact[1].finger.radius", "contact[1].finger.frame_angle",
        "contact[1].finger.velocity.x", "contact[1].finger.velocity.y",
    }  # fmt: skip
    assert known("der(contact[1].object.u)") == {
        "time", *profile, "object.radius", "contact[1].object.frame_angle",
        "contact[1].object.velocity.x", "contact[1].object.velocity.y",
        "contact[1].object.rate_offset.u",
    }  # fmt: skip
    assert known("contact[1].object.point.z") == {"object.radius", "contact[1].object.u"}


def test_a_surface_without_a_chart_is_refused_by_name():
    with pytest.raises(cs.SceneError, match="no explicit chart"):
        variable_table(cs.load_scene("implicit"))


def test_a_name_is_no_scene():
    with pytest.raises(cs.SceneError, match="^scene = 'K1': give a Scene, such as load_scene"):
        variable_table("K1")
