"""Formulas written as text, read safely: arithmetic and known functions only.

A scene file may hold ``"2*pi/3"`` or the chart of a surface, ``"(R + r*cos(v))*cos(u)"``. Python
parses the text; only arithmetic is then evaluated, and no code is run.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from .checks import did_you_mean, within
from .errors import ContactSystemError
from .theory import symbols as ca

MOST_POWER = 1e6  # higher ones, such as x**(1e17), make edges that doubles cannot resolve
CONSTANTS: dict[str, float] = {"pi": math.pi, "e": math.e}

Value: TypeAlias = "ca.SX | float"
Meaning: TypeAlias = tuple[int, Callable[..., Any], str]
"""Number of arguments, the function for numbers, and CasADi's name of the one for symbols."""


def _alike(names: str, count: int) -> dict[str, Meaning]:
    """Functions with the same name in Python's math and in CasADi."""
    return {name: (count, getattr(math, name), name) for name in names.split()}


FUNCTIONS: dict[str, Meaning] = {
    **_alike("sqrt sin cos tan asin acos atan exp log sinh cosh tanh", 1),
    **_alike("atan2 copysign hypot", 2),
    "pow": (2, math.pow, "power"),  # of numbers: real, or an error
    "abs": (1, abs, "fabs"),
    "fabs": (1, abs, "fabs"),
    "fmin": (2, min, "fmin"),
    "fmax": (2, max, "fmax"),
    "sign": (1, lambda x: float((x > 0) - (x < 0)), "sign"),
}

_BINARY: dict[type[ast.operator], Meaning] = {
    ast.Add: (2, operator.add, "plus"),
    ast.Sub: (2, operator.sub, "minus"),
    ast.Mult: (2, operator.mul, "times"),
    ast.Div: (2, operator.truediv, "rdivide"),
    ast.Pow: FUNCTIONS["pow"],
}


def parse(text: str, names: Mapping[str, ca.SX]) -> Value:
    """Return the value of a formula: a float, or a scalar SX expression if it uses the names.

    The text holds arithmetic (``+ - * / **``, parentheses), numbers, ``pi``, ``e``, the functions
    of `FUNCTIONS`, and names, which take precedence over ``pi`` and ``e``. Call it inside
    `theory.symbols.making_symbols` if there are names.

    Raises a ContactSystemError for anything else, or no result (``1/0``); it names the text, the
    column (from 1) and the nearest known name.
    """
    if not isinstance(text, str):
        raise ContactSystemError(f"formula {text!r} must be a text such as '2*pi/3'")
    within("FORMULA_LENGTH", len(text), f"formula {text:.40}...: characters", ContactSystemError)
    stripped = text.strip()
    if "#" not in text:  # join lines; a comment ends with its line
        stripped = stripped.replace("\r", " ").replace("\n", " ")
    lead = len(text) - len(text.lstrip())
    try:
        body = ast.parse(stripped, mode="eval").body
        return _Reader(text, lead, {**CONSTANTS, **names}).read(body)
    except SyntaxError as error:
        column = lead + max(error.offset or 1, 1)
        raise ContactSystemError(
            f"formula {text!r}, column {column}: not readable ({error.msg}); write products with "
            "* and leave units out (SI, radians)"
        ) from None
    except (RecursionError, MemoryError):
        raise ContactSystemError(
            f"formula {text:.40}... is nested too deeply; nest it less, or shorten its sums"
        ) from None


@dataclass
class _Reader:
    """Evaluates the syntax tree of one formula."""

    text: str
    lead: int
    names: Mapping[str, Value]

    def fail(self, node: ast.expr, problem: str) -> ContactSystemError:
        # Python counts columns in UTF-8 bytes, people count characters.
        before = self.text.lstrip().encode()[: node.col_offset]
        column = self.lead + len(before.decode(errors="replace")) + 1
        return ContactSystemError(f"formula {self.text!r}, column {column}: {problem}")

    def read(self, node: ast.expr, depth: int = 0) -> Value:
        """The value of a node, ``depth`` operations deep."""
        within("FORMULA_NESTING", depth, f"formula {self.text:.40}...: nesting")
        match node:
            case ast.Constant(value) if type(value) in (int, float):
                return self.result(node, float, value)
            case ast.Constant(value):
                problem = f"{value!r} is not a real number"
            case ast.Name(name) if name in self.names:
                return self.names[name]
            case ast.Name(name) if name in FUNCTIONS:
                problem = f"{name} is a function; write {name}(...)"
            case ast.Name(name):
                problem = f"unknown name {name}{_nearest(name, self.names)}"
            case ast.UnaryOp(ast.USub(), operand):
                return -self.read(operand, depth + 1)
            case ast.UnaryOp(ast.UAdd(), operand):
                return self.read(operand, depth + 1)
            case ast.BinOp(left, op, right) if type(op) in _BINARY:
                return self.apply(node, _BINARY[type(op)], depth + 1, left, right)
            case ast.BinOp(op=ast.BitXor()):
                problem = "^ is not a power here; write **"
            case ast.BinOp():
                problem = "only + - * / ** combine two values in a formula"
            case ast.Call(ast.Name(name), given, []) if name in FUNCTIONS:
                count, *_ = meaning = FUNCTIONS[name]
                if len(given) == count:
                    return self.apply(node, meaning, depth + 1, *given)
                problem = f"{name} takes {count} argument(s), not {len(given)}"
            case ast.Call(ast.Name(name), _, []):
                problem = f"unknown function {name}{_nearest(name, FUNCTIONS)}"
            case ast.Call():
                problem = "call functions by their plain name, as in atan2(y, x)"
            case ast.Attribute(attr=name):
                problem = f"write {name} without the module before it"
            case _:
                problem = "write arithmetic and known functions; a list is written as "
                problem += '["2*pi/3", "pi/2"]'
        raise self.fail(node, problem)

    def result(self, node: ast.expr, function: Callable[..., float], *values: Any) -> float:
        """The function's value at numbers; raises if it is not a finite real number."""
        try:
            result = function(*values)
        except (ArithmeticError, ValueError) as error:
            raise self.fail(node, f"the result is not a real number ({error})") from None
        if not math.isfinite(result):
            raise self.fail(node, "the number is too large")
        return result

    def apply(self, node: ast.expr, meaning: Meaning, depth: int, *given: ast.expr) -> Value:
        _, of_numbers, of_symbols = meaning
        values = [self.read(operand, depth) for operand in given]
        if not all(isinstance(value, float) for value in values):
            power = values[-1] if of_symbols == "power" else 0.0
            if isinstance(power, float) and abs(power) > MOST_POWER:
                problem = f"the power {power:g} is beyond {MOST_POWER:g}; write a lower one"
                raise self.fail(node, problem)
            return getattr(ca, of_symbols)(*values)
        return self.result(node, of_numbers, *values)


def _nearest(name: str, known: Iterable[str]) -> str:
    return did_you_mean(name, known) or f"; known are {', '.join(sorted(known))}"
