"""From CasADi functions to C99: straight-line code, one statement an operation."""

from __future__ import annotations

import functools
import re
from collections import Counter
from collections.abc import Sequence

from contact_system.theory import symbols as ca
from contact_system.theory.lowering import FUSED, OPERATIONS, no_operation, replay


@functools.cache
def _expressions() -> dict[int, str]:
    """CasADi's codes of operations -> C expressions of the operands A and B."""
    found = {ca.OP_SQ: "A * A", ca.OP_TWICE: "2.0 * A", ca.OP_CONSTPOW: "pow(A, B)"}
    found[ca.OP_HYPOT] = "sqrt(A * A + B * B)"
    calls = {"CALL1": "(A)", "CALL2": "(A, B)"}
    for row in OPERATIONS:
        if row.name not in FUSED:
            # lanes_sin and v_atan2 are the engine's, of many numbers at once
            text = re.sub(r"^(lanes|v)_", "", row.c) + calls.get(row.kind, "")
            found[getattr(ca, f"OP_{row.name}")] = text
    return found


def c_statements(
    function: ca.Function, arguments: Sequence[Sequence[str]]
) -> tuple[list[str], list[list[str]]]:
    """C99 declarations that evaluate ``function``, and the names that hold its outputs.

    What divides several numbers is inverted once: that costs one rounding more, and processors
    multiply many times faster than they divide.
    """
    steps: list[tuple[int, list[str]]] = []

    def apply(op: int, operands: list[str]) -> str:
        steps.append((op, operands))
        return f"w{len(steps) - 1}"

    outputs = replay(function, arguments, apply, lambda value: f"({value!r})")
    divisions = (ca.OP_DIV, ca.OP_INV)
    divides = Counter(operands[-1] for op, operands in steps if op in divisions)
    lines, inverse = [], dict[str, str]()
    for k, (op, operands) in enumerate(steps):
        divisor = operands[-1]
        if op in divisions and divides[divisor] > 1:
            if divisor not in inverse:
                inverse[divisor] = f"over{k}"
                lines.append(f"const double over{k} = 1.0 / {divisor};")
            value = " * ".join([*operands[:-1], inverse[divisor]])
        else:
            value = _value(op, operands)
        lines.append(f"const double w{k} = {value};")
    return lines, outputs


def _value(op: int, operands: Sequence[str]) -> str:
    text = _expressions().get(op)
    if text is None:
        raise no_operation(op, "C")
    given = dict(zip("AB", operands))
    return re.sub(r"\b[AB]\b", lambda name: given[name[0]], text)


def c_function(name: str, inputs: Sequence[ca.SX], value: ca.SX) -> str:
    """C99 of a ``kernel_t``: ``void name(arguments_t a, double *y)``."""
    names = [[f"a[{i}][{j}]" for j in range(x.numel())] for i, x in enumerate(inputs)]
    body = _body(inputs, value, names, "y[{}]", "  ")
    return f"static void {name}(arguments_t a, double *restrict y) {{\n{body}}}\n\n"


def c_loop(name: str, point: ca.SX, constant: ca.SX, value: ca.SX) -> str:
    """C99 of the rates of a ``motion_t``: the same at all nodes of a panel."""
    names = [
        [f"x[{j}][i]" for j in range(point.numel())],
        [f"c[{j}]" for j in range(constant.numel())],
    ]
    body = _body((point, constant), value, names, "f[{}][i]", "    ")
    return (
        f"static void {name}(double (*restrict x)[L], const double *restrict c,\n"
        f"{' ' * (len(name) + 13)}double (*restrict f)[L]) {{\n"
        f"#pragma omp simd\n  for (int i = 0; i < L; i++) {{\n{body}  }}\n}}\n\n"
    )


def _body(
    inputs: Sequence[ca.SX], value: ca.SX, names: Sequence[Sequence[str]], output: str, indent: str
) -> str:
    function = ca.Function("f", list(inputs), [ca.cse(ca.densify(ca.vec(value)))])
    lines, (outputs,) = c_statements(function, names)
    lines += [f"{output.format(i)} = {found};" for i, found in enumerate(outputs)]
    return "".join(f"{indent}{line}\n" for line in lines)
