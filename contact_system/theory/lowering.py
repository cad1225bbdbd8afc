"""Lowering of symbols to tables of instructions for the engine, and to their twins in C.

A table is a straight-line program on registers of 16 lanes, made from a CasADi SX function
(point, constants) -> result. Its registers are, in this order: point, constants, literals, results
of the prologue, results, temporaries. The prologue computes what depends on constants alone, once
for each surface; the body computes the rest, at every point.

Equal values are computed once. A division by a constant, or by a number that divides several times,
becomes a multiplication by the inverse, which is much faster.
"""

from __future__ import annotations

import copy
import re
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..caching import cached_property
from ..engine.binding import TableData
from ..errors import ContactSystemError
from . import symbols as ca
from .development import IN_CHART, IN_SPACE, in_space, moving
from .geometry import number_symbols, numbers_function
from .symbols import making_symbols, per_structure

if TYPE_CHECKING:
    from ..surfaces.base import Surface


class Operation(NamedTuple):
    """One row of the table of operations."""

    name: str
    """As in CasADi's OP_..."""
    c: str
    """C expression of the operands A and B; for kind "SINCOS" s, the sine, or c, the cosine."""
    partials: tuple[str, ...]
    """C expressions of the derivatives by each operand."""
    kind: str = "SIMPLE"
    """"SIMPLE"; "CALL" of the C library, which compilers do not vectorise; or "SINCOS"."""


_CALLS = {
    "TAN": "1.0 / (cos(A) * cos(A))",
    "ASIN": "1.0 / sqrt(1.0 - A * A)",
    "ACOS": "-1.0 / sqrt(1.0 - A * A)",
    "ATAN": "1.0 / (1.0 + A * A)",
    "SINH": "cosh(A)",
    "COSH": "sinh(A)",
    "TANH": "1.0 / (cosh(A) * cosh(A))",
    "ASINH": "1.0 / sqrt(A * A + 1.0)",
    "ACOSH": "1.0 / sqrt(A * A - 1.0)",
    "ATANH": "1.0 / (1.0 - A * A)",
    "LOG": "1.0 / A",
    "LOG1P": "1.0 / (1.0 + A)",
    "EXPM1": "exp(A)",
    "FLOOR": "0.0",
    "CEIL": "0.0",
}
_STEPS = ("0.0", "0.0")
_POWER = ("B == 0 ? 0.0 : B * pow(A, B - 1.0)", "pow(A, B) * log(A)")
OPERATIONS = (
    Operation("ASSIGN", "A", ("1.0",)),
    Operation("ADD", "A + B", ("1.0", "1.0")),
    Operation("SUB", "A - B", ("1.0", "-1.0")),
    Operation("MUL", "A * B", ("B", "A")),
    Operation("DIV", "A / B", ("1.0 / B", "-A / (B * B)")),
    Operation("NEG", "-A", ("-1.0",)),
    Operation("INV", "1.0 / A", ("-1.0 / (A * A)",)),
    Operation("SQRT", "sqrt(A)", ("0.5 / sqrt(A)",)),
    Operation("FABS", "fabs(A)", ("A > 0 ? 1.0 : A < 0 ? -1.0 : 0.0",)),
    Operation("FMIN", "B < A ? B : A", ("B < A ? 0.0 : 1.0", "B < A ? 1.0 : 0.0")),
    Operation("FMAX", "A < B ? B : A", ("A < B ? 0.0 : 1.0", "A < B ? 1.0 : 0.0")),
    Operation("COPYSIGN", "copysign(A, B)", ("(A < 0) == (B < 0) ? 1.0 : -1.0", "0.0")),
    Operation("SIGN", "A > 0 ? 1.0 : A < 0 ? -1.0 : 0.0", ("0.0",)),
    Operation("LT", "A < B ? 1.0 : 0.0", _STEPS),
    Operation("LE", "A <= B ? 1.0 : 0.0", _STEPS),
    Operation("EQ", "A == B ? 1.0 : 0.0", _STEPS),
    Operation("NE", "A != B ? 1.0 : 0.0", _STEPS),
    Operation("NOT", "A == 0 ? 1.0 : 0.0", ("0.0",)),
    Operation("AND", "A != 0 && B != 0 ? 1.0 : 0.0", _STEPS),
    Operation("OR", "A != 0 || B != 0 ? 1.0 : 0.0", _STEPS),
    Operation("IF_ELSE_ZERO", "A != 0 ? B : 0.0", ("0.0", "A != 0 ? 1.0 : 0.0")),
    Operation("ATAN2", "v_atan2(A, B)", ("B / (A * A + B * B)", "-A / (A * A + B * B)")),
    Operation("EXP", "v_exp(A)", ("exp(A)",)),
    Operation("SIN", "s", ("cos(A)",), "SINCOS"),
    Operation("COS", "c", ("-sin(A)",), "SINCOS"),
    *(Operation(name, f"{name.lower()}(A)", (slope,), "CALL") for name, slope in _CALLS.items()),
    Operation("POW", "pow(A, B)", _POWER, "CALL"),
    Operation("FMOD", "fmod(A, B)", ("1.0", "-trunc(A / B)"), "CALL"),
)
"""The operations in the order of their codes in tables, from 1 on; code 0 ends a program."""

CODES = {row.name: code for code, row in enumerate(OPERATIONS, start=1)}

Value = tuple[Any, ...]
"""An operation and its operands, indices of earlier values; or one of `LEAVES`."""
Step = tuple[str, int, list[int]]
"""An instruction: operation, register of the result, registers of the operands."""
LEAVES = ("IN", "CONSTANT", "LITERAL")
COMMUTE = ("ADD", "MUL")


def replay(
    function: ca.Function,
    arguments: Sequence[Sequence[Any]],
    apply: Callable[[int, list[Any]], Any],
    constant: Callable[[float], Any] = lambda value: value,
) -> list[list[Any]]:
    """Replay the instructions of a dense SX function on scalars of any type.

    Scalars may be mpmath numbers, Drake expressions, or indices of instructions. Only this function
    reads CasADi's instructions. It takes the scalars of each input, column by column, and returns
    those of each output. ``apply(op, operands)`` gives the value of the CasADi operation ``op``,
    ``constant`` that of a float in the expression.
    """
    work: list[Any] = [None] * function.sz_w()
    results: list[list[Any]] = [
        [constant(0.0)] * function.nnz_out(i) for i in range(function.n_out())
    ]
    op_input, op_output, op_const = ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        out, inp = function.instruction_output(k), function.instruction_input(k)
        if op == op_input:
            work[out[0]] = arguments[inp[0]][inp[1]]
        elif op == op_output:
            results[out[0]][out[1]] = work[inp[0]]
        elif op == op_const:
            work[out[0]] = constant(function.instruction_constant(k))
        else:
            work[out[0]] = apply(op, [work[i] for i in inp])
    return results


def _no_operation(op: int) -> ContactSystemError:
    """The error for an operation of CasADi that tables do not have."""
    import casadi

    known = vars(casadi)
    name = next((key for key in known if key.startswith("OP_") and known[key] == op), op)
    return ContactSystemError(
        f"operation {name} of CasADi has no C form here; write the surface with "
        "+ - * / sqrt, trigonometric, hyperbolic, exp, log, pow, fabs, fmin, fmax, fmod, if_else"
    )


@cache
def _names() -> dict[int, str]:
    """CasADi's operation codes -> names of `OPERATIONS`, or of those that `_Values` replaces."""
    codes = {getattr(ca, f"OP_{name}"): name for name in (*CODES, "SQ", "TWICE", "HYPOT")}
    return codes | {ca.OP_CONSTPOW: "POW"}


class _Values:
    """A program as distinct values in the order of their computation."""

    def __init__(self, function: ca.Function):
        self.rows: list[Value] = []
        self.uniform: list[bool] = []
        """Whether each value depends on constants and literals alone."""
        self._numbers: dict[Value, int] = {}
        self.inputs = [self.put("IN", i) for i in range(function.numel_in(0))]
        self.constants = [self.put("CONSTANT", i) for i in range(function.numel_in(1))]
        arguments, literal = (self.inputs, self.constants), partial(self.put, "LITERAL")
        self.results = replay(function, arguments, self.apply, literal)[0]
        self._divide()

    def put(self, name: str, *operands: Any) -> int:
        """The index of a value, which is added if it is new."""
        a, b = operands[0], operands[-1]
        value = (name, b, a) if name in COMMUTE and a > b else (name, *operands)
        number = self._numbers.setdefault(value, len(self.rows))
        if number == len(self.rows):
            self.rows.append(value)
            known = name != "IN" if name in LEAVES else self.uniform[a] and self.uniform[b]
            self.uniform.append(known)
        return number

    def apply(self, op: int, operands: list[int]) -> int:
        """The index of the value of a CasADi operation."""
        name = _names().get(op)
        a, b = operands[0], operands[-1]
        match name:
            case None:
                raise _no_operation(op)
            case "SQ":
                return self.put("MUL", a, a)
            case "TWICE":
                return self.put("ADD", a, a)
            case "HYPOT":
                squares = self.put("MUL", a, a), self.put("MUL", b, b)
                return self.put("SQRT", self.put("ADD", *squares))
            case "DIV" if not (self.uniform[a] and self.uniform[b]):
                return self.put("MUL", a, self.put("INV", b))
        return self.put(name, *operands)

    def _divide(self) -> None:
        """Turn products with inverses that are used only once into divisions: they round less."""
        rows = self.rows
        uses = Counter(j for row in rows if row[0] not in LEAVES for j in row[1:])
        uses.update(self.results)
        for k, (name, *operands) in enumerate(rows):
            if name != "MUL":
                continue
            for inverse, other in (operands, operands[::-1]):
                is_inverse = rows[inverse][0] == "INV" and not self.uniform[inverse]
                if is_inverse and uses[inverse] == 1:
                    rows[k] = ("DIV", other, rows[inverse][1])
                    break

    def live(self) -> list[int]:
        """Indices of the values that the results need, ascending."""
        needed = set(self.results)
        for k in range(len(self.rows) - 1, -1, -1):
            if k in needed and self.rows[k][0] not in LEAVES:
                needed.update(self.rows[k][1:])
        return sorted(needed)


class Table(TableData):
    """A program of instructions, made from the function (point, constants) -> result.

    words: the instructions of prologue and body, (n, 4) uint16 each; a row is op, to, a, b, and the
    last row is all 0. numbers: the literals, (n_lit,).
    """

    def __init__(self, function: ca.Function):
        assert function.nnz_out(0) == function.numel_out(0), "results must be dense"
        with making_symbols():
            values = _Values(function)
        rows, live = values.rows, values.live()
        super().__init__(len(values.inputs), len(values.constants), len(values.results), twin=-1)
        place = {k: k for k in (*values.inputs, *values.constants)}  # the register of each value
        literals = [k for k in live if rows[k][0] == "LITERAL"]
        steps = [k for k in live if rows[k][0] not in LEAVES]
        prepared = [*literals, *(k for k in steps if values.uniform[k])]
        self.n_lit, self.first_lit = len(literals), self.n_in + self.n_const
        self.numbers = np.array([rows[k][1] for k in literals])
        self.first_out = self.first_lit + len(prepared)
        place.update((k, self.first_lit + i) for i, k in enumerate(prepared))
        copies = list[Step]()  # results that have a register already, such as an input
        for i, k in enumerate(values.results):
            if k in place:
                copies.append(("ASSIGN", self.first_out + i, [place[k]]))
            else:
                place[k] = self.first_out + i
        last = {j: k for k in steps for j in rows[k][1:]}  # the last step that reads each value
        free: list[int] = []  # registers of temporaries that no later step reads
        self.n_regs = first_free = self.first_out + self.n_out
        prologue, body = list[Step](), list[Step]()
        for k in steps:
            name, *operands = rows[k]
            registers = [place[j] for j in operands]
            free += {r for j, r in zip(operands, registers) if r >= first_free and last[j] == k}
            if k not in place:
                place[k] = free.pop() if free else self.n_regs
                self.n_regs = max(self.n_regs, place[k] + 1)
            (prologue if values.uniform[k] else body).append((name, place[k], registers))
        self.words = _words(prologue), _words(body + copies)
        arrays = *self.words, self.numbers
        self.prologue, self.body, self.literals = (array.ctypes.data for array in arrays)

    @property
    def sizes(self) -> list[int]:
        """The fields before `twin`."""
        return [getattr(self, field[0]) for field in TableData._fields_[:7]]

    def c_text(self) -> str | None:
        """C code that does the same to registers r as the body; None if the body calls functions.

        It is a loop over the lanes that keeps values in the processor's registers. Its operations
        are those of the table, so that both give the same bits.
        """
        literals = range(self.first_lit, self.first_lit + self.n_lit)
        results = range(self.first_out, self.first_out + self.n_out)
        local: dict[int, str] = {}

        def operand(register: int) -> str:
            if register in literals:
                return str(float(self.numbers[register - self.first_lit]))
            return local.get(register, f"r[{register}][i]")

        lines = list[str]()
        for op, to, *registers in self.words[1][:-1].tolist():
            row = OPERATIONS[op - 1]
            if row.kind != "SIMPLE":
                return None
            values = dict(zip("AB", map(operand, registers)))
            value = re.sub(r"\b[AB]\b", lambda match: values[match[0]], row.c)  # noqa: B023
            lines.append(f"const double t{len(lines)} = {value};")
            local[to] = f"t{len(lines) - 1}"
        lines += [f"r[{to}][i] = {local[to]};" for to in results]
        loop = "".join(f"    {line}\n" for line in lines)
        return f"  EACH_LANE(i) {{\n{loop}  }}\n"


def _words(steps: list[Step]) -> np.ndarray:
    rows = [(CODES[name], to, *[*registers, 0][:2]) for name, to, registers in steps]
    return np.array([*rows, (0, 0, 0, 0)], dtype=np.uint16)


# --- the tables of a surface ---------------------------------------------------------------------


class SurfaceTables:
    """The tables of the surfaces of one structure, each made at its first use."""

    def __init__(self, surface: Surface):
        self.surface = surface

    @cached_property
    def space(self) -> tuple[Table | None, ...]:
        """State x, p: `development.IN_SPACE`."""
        return self._moving(in_space(self.surface), True, IN_SPACE)

    @cached_property
    def chart(self) -> tuple[Table | None, ...]:
        """State u, v, theta: `development.IN_CHART`, for surfaces that may need this form."""
        wanted = self.surface.chart.double_cover or not in_space(self.surface)
        return self._moving(wanted, False, IN_CHART)

    def _moving(self, wanted: bool, space: bool, names: Sequence[str]) -> tuple[Any, ...]:
        if not wanted:
            return (None,) * len(names)
        body, missing = moving(self.surface, space), () if self.surface.has_chart else ("start",)
        return tuple(None if name in missing else Table(body(name)) for name in names)

    @cached_property
    def geodesic(self) -> Table:
        """A geodesic with its Jacobi fields, in space or in the chart as `in_space` says."""
        return Table(moving(self.surface, in_space(self.surface))("geodesic"))

    @cached_property
    def geometry(self) -> Table:
        """(u, v), or x on a surface without a chart -> `ChartGeometry.column`."""
        size, shape = 2 if self.surface.has_chart else 3, self.surface.geometry_expr
        return self._made(size, lambda numbers, place: shape(numbers, place).column())

    @cached_property
    def inverse(self) -> Table:
        """x -> u, v, for surfaces with an implicit form."""
        inverse = self.surface.coordinates_expr
        return self._made(3, lambda numbers, x: ca.vertcat(*inverse(numbers, x)))

    @cached_property
    def ray(self) -> Table:
        """x, d -> the level function and its slope along d, for surfaces without a chart."""

        def along(numbers: ca.SX, point: ca.SX) -> ca.SX:
            x, ray = point[:3], point[3:]
            level = self.surface._level(numbers[1:], x)
            return ca.vertcat(level, ca.dot(ca.gradient(level, x), ray))

        return self._made(6, along)

    def _made(self, size: int, result: Callable[[ca.SX, ca.SX], ca.SX]) -> Table:
        """The table of ``result(numbers, point)``, where the point is a column of this size."""
        with making_symbols():
            numbers, point = number_symbols(self.surface), ca.SX.sym("point", size)
            return Table(numbers_function("table", point, numbers, result(numbers, point)))


@per_structure
def lowered(surface: Surface) -> SurfaceTables:
    """The tables of a surface that has none in the engine, such as a user's."""
    return SurfaceTables(copy.copy(surface))  # a copy: surface and tables would form a cycle
