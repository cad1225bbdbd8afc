"""Tables of instructions: what is generated and what runs them say what the symbols say."""

from __future__ import annotations

import numpy as np
import pytest

from contact_system.engine import binding
from contact_system.surfaces import ImplicitSurface, ParametricSurface
from contact_system.theory import generate
from contact_system.theory.development import IN_CHART, IN_SPACE, moving
from contact_system.theory.equations import contact_functions
from contact_system.theory.geometry import geometry_function, inverse_function, ray_function
from contact_system.theory.lowering import lowered

CUBE = ImplicitSurface("(x/r)**4 + (y/r)**4 + (z/r)**4 - 1", parameters={"r": 1.0})
BUMPS = ParametricSurface(("u", "v", "k*sin(3*u)*cos(4*v)"), parameters={"k": 0.05})
SURFACES = {**generate.bundled(), "rounded cube": CUBE, "bumps": BUMPS}


def functions_of(surface):
    """(group, index) -> CasADi function, of the tables that a surface has."""
    other = (geometry_function, inverse_function, ray_function)
    tables = lowered(surface)
    for group in ("ambient", "chart", "other"):
        for k, table in enumerate(getattr(tables, group)):
            if table is None:
                continue
            if group == "other":
                yield (group, k), table, other[k](surface)
            else:
                names = IN_SPACE if group == "ambient" else IN_CHART
                yield (group, k), table, moving(surface, group == "ambient")(names[k])


def assert_close(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    assert np.array_equal(np.isnan(found), np.isnan(expected))
    scale = 1e-3 + np.nanmax(np.abs(expected), axis=1, keepdims=True)
    assert np.nanmax(np.abs(found - expected) / scale, initial=0.0) < tolerance


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["outside", "inside"])
@pytest.mark.parametrize("name", SURFACES)
def test_tables_say_what_their_symbols_say(name, sign):
    surface = SURFACES[name]
    numbers = np.array([sign, *surface.parameters])
    for _, table, function in functions_of(surface):
        points = np.random.default_rng(1).uniform(0.2, 0.6, (table.n_in, 40))
        expected = function(points, numbers).full()
        assert_close(binding.run(table, points, numbers), expected, 5e-13)


@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["outside", "inside"])
@pytest.mark.parametrize("name", generate.bundled())
def test_the_engines_own_tables_and_their_twins_give_the_same_bits(name, sign):
    surface, known = SURFACES[name], binding.builtin(name)
    numbers = np.array([sign, *surface.parameters])
    for (group, k), table, _ in functions_of(surface):
        points = np.random.default_rng(2).uniform(0.2, 0.6, (table.n_in, 37))
        found = binding.run(getattr(known, group)[k], points, numbers)
        assert np.array_equal(found, binding.run(table, points, numbers), equal_nan=True)


@pytest.mark.parametrize("name", contact_functions())
def test_tables_of_contacts_say_what_their_symbols_say(name):
    functions = contact_functions()
    function, known = functions[name], binding.contact_table([*functions].index(name))
    rng = np.random.default_rng(3)
    points = rng.normal(size=(function.numel_in(0), 40))
    constants = rng.normal(size=function.numel_in(1))
    assert_close(binding.run(known, points, constants), function(points, constants).full(), 1e-14)


def test_generated_files_are_those_that_the_symbols_give():
    for file, text in generate.generated().items():
        assert (generate.FOLDER / file).read_text() == text, f"{file}: {generate.__doc__}"
