"""Several outputs in one pass, by many threads at once, and what importing and planning load."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest
from conftest import busy, one_contact, several

import contact_system as cs

OUTPUTS = ("states", "points", "slip", "slip_speed", "twist", "pose", "acceleration", "carried")
SCENES = {
    "windows": busy,
    "contacts": several,
    "flat": lambda: one_contact("plane", "cylinder"),
    "users' surfaces": lambda: one_contact("bumps", "rounded cube"),
    "imposed rolling": lambda: cs.load_scene("C2"),
    "rate offset": lambda: cs.load_scene("D1"),
}


# --- one pass


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


@pytest.mark.parametrize("make", [busy, several, SCENES["users' surfaces"]])
def test_threads_get_the_same_bits_from_one_plan(make):
    plan, t = cs.plan(make()), np.linspace(0.0, 1.0, 200)
    expected = cs.plan(make()).evaluate(t, *OUTPUTS)
    gate = Barrier(6)

    def ask(turn: int) -> dict[str, np.ndarray]:
        gate.wait()
        return plan.evaluate(t, *np.roll(OUTPUTS, turn).tolist())

    with ThreadPoolExecutor(6) as pool:
        for found in list(pool.map(ask, range(6))):
            for output, values in expected.items():
                assert np.array_equal(found[output], values), output


def test_threads_plan_and_evaluate_scenes_of_every_kind_at_once():
    makers = [make for make in SCENES.values()] * 6

    def answer(make) -> list[bytes]:
        scene = make()
        t = np.linspace(0.0, scene.duration, 50)
        found = cs.plan(scene, 1e-10).evaluate(t, "points", "states", "twist")
        return [values.tobytes() for values in found.values()]

    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(answer, makers))
    assert together == [answer(make) for make in makers]


# --- what is loaded


HEAVY = ("casadi", "scipy", "matplotlib", "pydrake", "fmpy", "drake_plant", "fmu_export")


def loaded(code: str) -> list[str]:
    """Runs code in a new process: what it prints, then those of HEAVY that it has loaded."""
    told = f"import sys\nprint([name for name in {HEAVY} if name in sys.modules])"
    command = [sys.executable, "-c", textwrap.dedent(code) + told]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_importing_loads_nothing_that_is_not_needed_and_names_all_there_is():
    assert loaded("import contact_system\n") == ["[]"] and {*cs.__all__} <= {*dir(cs)}


def test_planning_bundled_surfaces_loads_no_symbols():
    words = loaded("""
        import numpy as np
        import contact_system as cs
        planned = 0
        for name in cs.bundled_scenes():
            if name in ("chart", "implicit"):  # whose surfaces are formulas
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
