"""Results asked for together and in many threads; the modules that importing and planning load."""

from __future__ import annotations

import textwrap
from threading import Barrier

import numpy as np
import pytest
from conftest import disturbed, in_threads, one_contact, run_python, seven_contacts

import contact_system as cs

OUTPUTS = ("states", "points", "slip", "slip_speed", "twist", "pose", "acceleration", "carried")
SCENES = {
    "windows": disturbed,
    "contacts": seven_contacts,
    "flat": lambda: one_contact("plane", "cylinder"),
    "users' surfaces": lambda: one_contact("bumps", "rounded cube"),
    "imposed rolling": lambda: cs.load_scene("C2"),
    "rate offset": lambda: cs.load_scene("D1"),
}


# --- results asked for together


@pytest.mark.parametrize("name", SCENES)
def test_evaluate_gives_what_the_single_methods_give(name):
    scene = SCENES[name]()
    t = np.linspace(0.0, scene.duration, 41)
    outputs = OUTPUTS[:-1] if scene.contacts[0].follows else OUTPUTS
    plan = cs.plan(scene)
    found = plan.evaluate(t, *outputs)
    assert isinstance(found, dict) and tuple(found) == outputs
    for output, values in found.items():
        expected = getattr(plan, output)(t)
        assert values.shape == expected.shape and values.dtype == np.float64, output
        assert np.array_equal(values, expected), output
        alone = cs.plan(scene.replace()).evaluate(t, output)
        assert list(alone) == [output] and np.array_equal(alone[output], values), output


@pytest.mark.parametrize(
    ("outputs", "words"),
    [
        (("points", "twsit"), "'twsit'.*did you mean 'twist'"),
        (("point",), "'point'.*did you mean 'points'"),
        (("velocity",), "'velocity'.*states"),
        ((), "no result is asked for; name .* of states, points"),
        ((["points", "twist"],), r"\['points', 'twist'\]"),
    ],
)
def test_unknown_outputs_are_refused_with_the_nearest_name(outputs, words):
    with pytest.raises(cs.ContactSystemError, match=words):
        cs.plan(one_contact()).evaluate(0.5, *outputs)


# --- threads


@pytest.mark.parametrize("make", [disturbed, seven_contacts, SCENES["users' surfaces"]])
def test_threads_get_the_same_bits_from_one_plan(make):
    plan, t = cs.plan(make()), np.linspace(0.0, 1.0, 200)
    expected = cs.plan(make()).evaluate(t, *OUTPUTS)
    start_together = Barrier(6)

    def evaluate(turn: int) -> dict[str, np.ndarray]:
        start_together.wait()
        return plan.evaluate(t, *np.roll(OUTPUTS, turn).tolist())

    for found in in_threads(evaluate, range(6)):
        for output, values in expected.items():
            assert np.array_equal(found[output], values), output


def test_threads_plan_and_evaluate_scenes_of_every_kind_at_once():
    makers = [*SCENES.values()] * 4

    def answer(make) -> list[bytes]:
        scene = make()
        t = np.linspace(0.0, scene.duration, 50)
        found = cs.plan(scene, 1e-10).evaluate(t, "points", "states", "twist")
        return [values.tobytes() for values in found.values()]

    assert in_threads(answer, makers) == [answer(make) for make in makers]


# --- what is loaded


HEAVY = ("casadi", "scipy", "matplotlib", "pydrake", "fmpy", "drake_plant", "fmu_export")


def loaded(code: str) -> list[str]:
    """The lines that some code prints in a new process, then which of `HEAVY` it has loaded."""
    check = f"import sys\nprint([name for name in {HEAVY} if name in sys.modules])"
    return run_python("-c", textwrap.dedent(code) + check).splitlines()


def test_importing_loads_no_heavy_module_and_dir_lists_every_public_name():
    assert loaded("import contact_system\n") == ["[]"] and {*cs.__all__} <= {*dir(cs)}


def test_planning_scenes_without_formulas_loads_no_heavy_module():
    words = loaded("""
        import numpy as np
        import contact_system as cs
        planned = 0
        for name in cs.bundled_scenes():
            if name in ("chart", "implicit"):  # their surfaces are formulas, which CasADi reads
                continue
            scene = cs.load_scene(name)
            plan, t = cs.plan(scene), np.linspace(0.0, scene.duration, 5)
            plan.points(t), plan.states(t), plan.slip(t), plan.pose(t), plan.twist(t)
            plan.acceleration(t), plan.explain()
            for body in scene.surfaces:
                at = body.canonical(0.7, 0.4)
                body.christoffel(*at), body.curvature_form(*at), body.torsion_form(*at)
                body.coordinates(body.point(*at))
            planned += 1
        print(planned)
    """)
    assert int(words[0]) >= 10 and words[1:] == ["[]"]
