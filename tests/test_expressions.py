"""Formulas as text: what they mean, and that nothing else is understood."""

from __future__ import annotations

import math
import random
import subprocess
import sys

import casadi as ca
import pytest

from contact_system.errors import ContactSystemError
from contact_system.expressions import CONSTANTS, FUNCTIONS, parse

SX = ca.SX


def value(text: str, **numbers: float) -> float:
    symbols = {name: SX.sym(name) for name in numbers}
    function = ca.Function("f", list(symbols.values()), [parse(text, symbols)])
    return float(function.call(list(numbers.values()))[0])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2*pi/3", 2 * math.pi / 3),
        ("-2*pi/3", -2 * math.pi / 3),
        (" 1e-3 + .5 ", 1e-3 + 0.5),
        ("2**-0.5", 2**-0.5),
        ("-2**2", -4.0),
        ("2**3**2", 512.0),
        ("(1 + 2)*3 - +4", 5.0),
        ("hypot(3, 4) + e", 5.0 + math.e),
        ("atan2(1, -1)", 3 * math.pi / 4),
        ("fmin(2, 3)*fmax(2, 3) + sign(-2) + copysign(3, -0.5)", 2.0),
        ("abs(-3) + fabs(-4)", 7.0),
        ("7", 7.0),
        ("\n  1\n  + 2*3\r\n- hypot(3,\n4)\n", 2.0),
        ("1 + 2  # a remark", 3.0),
    ],
)
def test_arithmetic_means_what_python_means(text, expected):
    assert value(text) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize("name", sorted(set(FUNCTIONS) & set(vars(math))))
def test_functions_are_those_of_the_math_module(name):
    arguments = (0.3, 0.7)[: FUNCTIONS[name][0]]
    text = f"{name}({', '.join(map(str, arguments))})"
    assert value(text) == pytest.approx(getattr(math, name)(*arguments), rel=4e-16)


def test_numbers_without_symbols_read_as_floats():
    assert float(parse("pi/6", {})) == math.pi / 6


def test_numbers_are_pythons_to_the_last_bit():
    assert parse("0.483**3", {}) == 0.483**3
    numbers = random.Random(1)
    for _ in range(300):
        a, b = round(numbers.uniform(0.1, 9), 3), numbers.randint(2, 19)
        for text in (f"{a}**{b % 5}", f"{a}*pi/{b}", f"{b}**-1 - {a}", f"-{a}**0.5 * sqrt({b})"):
            found = parse(text, {"u": SX.sym("u")})
            assert type(found) is float and found == eval(text, {"pi": math.pi, "sqrt": math.sqrt})


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [("0/0", 1, "division by zero"), ("2 + 1/0*u", 5, "division by zero"),
     ("u*sqrt(-1)", 3, "domain"), ("(-8)**(1/3)", 1, "domain"), ("9**9**9", 1, "range"),
     ("2*1e308*1e308", 1, "too large")],
)  # fmt: skip
def test_numbers_without_a_result_are_refused_by_column(text, column, words):
    with pytest.raises(ContactSystemError, match=f"column {column}: .*{words}"):
        parse(text, {"u": SX.sym("u")})


IN_THREADS = """
import sys
from concurrent.futures import ThreadPoolExecutor
import contact_system as cs
from contact_system.expressions import parse

def read(k):
    for i in range(50):
        parse(f"2*pi/{k + 0.5} + {i}.25", {})

def make(k):
    f = (f"u*{k}.5", f"v + {k}/7", f"0.05*sin({k}.25*u)*cos(v*{k})")
    return cs.ParametricSurface(f).normal(0.1, 0.2)

sys.setswitchinterval(1e-5)
with ThreadPoolExecutor(8) as executor:
    list(executor.map(read, range(1000)))
    list(executor.map(make, range(100)))
"""


def test_formulas_are_read_in_many_threads():
    """In a process of its own: constants of CasADi that two threads made at once ended it."""
    assert subprocess.run([sys.executable, "-c", IN_THREADS], check=False).returncode == 0


def test_names_take_precedence_over_constants():
    assert value("e*2 + R", e=3.0, R=1.0) == 7.0
    assert set(CONSTANTS) == {"pi", "e"}


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "().__class__",
        "u.real",
        "[1, 2]",
        "(1, 2)",
        "lambda: 1",
        "1 if 2 else 3",
        "u < 1",
        "u and 1",
        "not u",
        "~u",
        "u // 2",
        "u % 2",
        "u @ u",
        "f'{u}'",
        "'text'",
        "True",
        "None",
        "1j",
        "...",
        "(u := 3)",
        "sin(x=1)",
        "sin(*u)",
        "sin()",
        "atan2(1)",
        "eval(1)",
        "sin",
        "1e999",
        "9" * 400,
        "",
        "2 3",
        "sin(",
        "x = 2",
        "import os",
        "\0",
    ],
)
def test_nothing_but_arithmetic_is_understood(text):
    with pytest.raises(ContactSystemError, match="formula"):
        parse(text, {"u": SX.sym("u")})


def test_errors_name_text_column_and_nearest_name():
    with pytest.raises(ContactSystemError) as caught:
        parse("  R + r*cso(v)", {w: SX.sym(w) for w in ("R", "r", "v")})
    assert "'  R + r*cso(v)', column 9" in str(caught.value)
    assert "did you mean 'cos'?" in str(caught.value)
    with pytest.raises(ContactSystemError, match="column 7: .*did you mean 'radius"):
        parse("2 * ( raduis )", {"radius": SX.sym("radius")})


def test_caret_is_answered_with_the_power_sign():
    with pytest.raises(ContactSystemError, match=r"\*\*"):
        parse("u^2", {"u": SX.sym("u")})


def test_deep_and_long_texts_end_in_an_error_not_in_a_crash():
    for text in ("(" * 3000 + "1" + ")" * 3000, "-" * 9000 + "1", "1+" * 6000 + "1"):
        with pytest.raises(ContactSystemError):
            parse(text, {})
