"""Tables of instructions: what is lowered, what is generated, and what runs them, all the same."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from contact_system.engine import binding
from contact_system.errors import ContactSystemError
from contact_system.surfaces import ImplicitSurface, ParametricSurface
from contact_system.theory import generate
from contact_system.theory.development import IN_CHART, IN_SPACE, moving
from contact_system.theory.equations import contact_functions
from contact_system.theory.geometry import geometry_function, inverse_function, ray_function
from contact_system.theory.lowering import OPERATIONS, Table, instructions, lowered

BY_NUMPY = {
    "ASSIGN": lambda a: a,
    "ADD": np.add,
    "SUB": np.subtract,
    "MUL": np.multiply,
    "DIV": np.divide,
    "FMA": lambda a, b, c: a * b + c,
    "FMS": lambda a, b, c: a * b - c,
    "FNMA": lambda a, b, c: c - a * b,
    "DOT2": lambda a, b, c, d: a * b + c * d,
    "DOT3": lambda a, b, c, d, e, f: a * b + c * d + e * f,
    "NEG": np.negative,
    "INV": lambda a: 1.0 / a,
    "SQRT": np.sqrt,
    "FABS": np.abs,
    "FMIN": lambda a, b: np.where(b < a, b, a),
    "FMAX": lambda a, b: np.where(a < b, b, a),
    "COPYSIGN": np.copysign,
    "SIGN": np.sign,
    "LT": np.less,
    "LE": np.less_equal,
    "EQ": np.equal,
    "NE": np.not_equal,
    "NOT": np.logical_not,
    "AND": np.logical_and,
    "OR": np.logical_or,
    "IF_ELSE_ZERO": lambda a, b: np.where(a != 0, b, 0.0),
    "ATAN2": np.arctan2,
    "SIN": np.sin,
    "COS": np.cos,
    "TAN": np.tan,
    "ASIN": np.arcsin,
    "ACOS": np.arccos,
    "ATAN": np.arctan,
    "SINH": np.sinh,
    "COSH": np.cosh,
    "TANH": np.tanh,
    "ASINH": np.arcsinh,
    "ACOSH": np.arccosh,
    "ATANH": np.arctanh,
    "EXP": np.exp,
    "LOG": np.log,
    "LOG1P": np.log1p,
    "EXPM1": np.expm1,
    "FLOOR": np.floor,
    "CEIL": np.ceil,
    "POW": np.power,
    "FMOD": np.fmod,
}


def by_numpy(table: Table, points: np.ndarray, constants: np.ndarray) -> np.ndarray:
    """Run a table in the plainest way: (n_in, n), (n_const,) -> (n_out, n)."""
    r = np.full((table.n_regs, points.shape[1]), np.nan)
    r[: table.n_in] = points
    r[table.n_in : table.first_lit] = np.reshape(constants, (-1, 1))
    r[table.first_lit : table.first_lit + len(table.literals)] = table.literals[:, None]
    with np.errstate(all="ignore"):
        for part in (table.prologue, table.body):
            for op, to, operands in instructions(part):
                r[to] = BY_NUMPY[OPERATIONS[op - 1].name](*r[operands])
    return r[table.first_out : table.first_out + table.n_out]


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
        assert_close(by_numpy(table, points, numbers), expected, 5e-13)
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


X = ca.SX.sym("x")
Y = ca.SX.sym("y")
C = ca.SX.sym("c")
EXPRESSIONS = {
    "arithmetic": X + Y - X * Y / (X - 3) + 2 * X + X**2,
    "powers": ca.vertcat(X**3, X**-2, X**0.5, X**2.7, X**Y, X**C, X**120, ca.hypot(X, Y)),
    "sums of products": ca.vertcat(X * Y + C * X, X * Y + C * X + X * X, C - X * Y, X * Y - C),
    "inverses": ca.vertcat(X / Y + C / Y, X / C, 1 / Y, 1 / C, C / (1 + C)),
    "one inverse": ca.vertcat(X / (Y + 1), X * (1 / (Y + 2))),
    "circular": ca.vertcat(ca.sin(X), ca.cos(X), ca.tan(X), ca.atan2(X - 1, Y - 1)),
    "inverse circular": ca.vertcat(ca.asin(X / 3), ca.acos(X / 3), ca.atan(X)),
    "hyperbolic": ca.vertcat(ca.sinh(X), ca.cosh(X), ca.tanh(X), ca.asinh(X), ca.atanh(X / 3)),
    "acosh": ca.acosh(X + 1),
    "exponential": ca.vertcat(ca.exp(X), ca.log(X), ca.log1p(X), ca.expm1(X)),
    "rounding": ca.vertcat(
        ca.floor(X), ca.ceil(X), ca.fmod(X, 0.7), ca.sign(X - 1), ca.fabs(X - 1)
    ),
    "least": ca.vertcat(ca.fmin(X, Y), ca.fmax(X, C), ca.copysign(X, Y - 1)),
    "choices": ca.if_else(ca.logic_and(X < Y, X != 1), X, ca.if_else(Y <= C, Y, -C)),
    "logic": ca.vertcat(ca.logic_or(X < 1, Y < 1), ca.logic_not(X < Y), X == Y, X >= Y),
    "copies": ca.vertcat(X, X, C, 2.5, 0.0, X * Y, X * Y, C + 1),
    "nothing varies": ca.vertcat(C, C * C, 1.0),
}


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_every_operation_is_lowered(name):
    function = ca.Function("f", [ca.vertcat(X, Y), C], [ca.densify(EXPRESSIONS[name])])
    table = Table(function)
    points = np.random.default_rng(4).uniform(0.1, 2.0, (2, 50))
    expected = function(points, 0.7).full()
    for run in (by_numpy, binding.run):
        found = run(table, points, np.array([0.7]))
        assert found == pytest.approx(expected, rel=1e-13, abs=1e-15)


def test_what_depends_on_constants_alone_is_found_once_a_body():
    table = Table(ca.Function("f", [X, C], [X * ca.sin(C) / ca.exp(C)]))
    assert len(table.prologue) > len(table.body) - 1  # the last row ends each
    names = [OPERATIONS[op - 1].name for op, _, _ in instructions(table.body)]
    assert names == ["MUL", "MUL"]


def test_an_operation_without_a_form_here_is_refused_by_name():
    with pytest.raises(ContactSystemError, match="operation OP_ERF of CasADi has no C form here"):
        Table(ca.Function("f", [X, C], [ca.erf(X)]))
