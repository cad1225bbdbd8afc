"""From one symbolic expression to fast numbers: virtual machine, numpy, or compiled C.

A kernel is a CasADi SX function whose scalar instructions are replayed by one of three engines:

* CasADi's virtual machine: no set-up cost, best for a few dozen points (integration nodes);
* numpy source generated from the same instructions: best for hundreds of points (output);
* C99 generated from the same instructions, one loop over points that the compiler turns into
  SIMD code, built once per structure and kept in the user's cache.

:func:`replay` is the only place that reads CasADi's instructions. It works for any scalar type:
mpmath numbers, Drake expressions, strings of source code.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from .errors import ContactSystemError
from .expressions import SYMBOLS
from .kept import kept

C_SOURCES = Path(__file__).parent / "c"
NODES = 16  # Gauss points of a panel; see panels.Collocation

# One row an operation: CasADi's op code -> (C expression, numpy ufunc); {0}, {1} are the operands.
_OPERATIONS: dict[int, tuple[str, str]] = {
    ca.OP_ASSIGN: ("{0}", "positive"),
    ca.OP_ADD: ("{0} + {1}", "add"),
    ca.OP_SUB: ("{0} - {1}", "subtract"),
    ca.OP_MUL: ("{0} * {1}", "multiply"),
    ca.OP_DIV: ("{0} / {1}", "divide"),
    ca.OP_NEG: ("-{0}", "negative"),
    ca.OP_SQ: ("{0} * {0}", "square"),
    ca.OP_TWICE: ("2.0 * {0}", "twice"),
    ca.OP_INV: ("1.0 / {0}", "reciprocal"),
    ca.OP_EXP: ("exp({0})", "exp"),
    ca.OP_LOG: ("log({0})", "log"),
    ca.OP_POW: ("pow({0}, {1})", "power"),
    ca.OP_CONSTPOW: ("pow({0}, {1})", "power"),
    ca.OP_SQRT: ("sqrt({0})", "sqrt"),
    ca.OP_SIN: ("sin({0})", "sin"),
    ca.OP_COS: ("cos({0})", "cos"),
    ca.OP_TAN: ("tan({0})", "tan"),
    ca.OP_ASIN: ("asin({0})", "arcsin"),
    ca.OP_ACOS: ("acos({0})", "arccos"),
    ca.OP_ATAN: ("atan({0})", "arctan"),
    ca.OP_ATAN2: ("atan2({0}, {1})", "arctan2"),
    ca.OP_HYPOT: ("sqrt({0} * {0} + {1} * {1})", "hypot"),
    ca.OP_SINH: ("sinh({0})", "sinh"),
    ca.OP_COSH: ("cosh({0})", "cosh"),
    ca.OP_TANH: ("tanh({0})", "tanh"),
    ca.OP_ASINH: ("asinh({0})", "arcsinh"),
    ca.OP_ACOSH: ("acosh({0})", "arccosh"),
    ca.OP_ATANH: ("atanh({0})", "arctanh"),
    ca.OP_LOG1P: ("log1p({0})", "log1p"),
    ca.OP_EXPM1: ("expm1({0})", "expm1"),
    ca.OP_FABS: ("fabs({0})", "absolute"),
    ca.OP_FMIN: ("({1} < {0} ? {1} : {0})", "minimum"),
    ca.OP_FMAX: ("({0} < {1} ? {1} : {0})", "maximum"),
    ca.OP_COPYSIGN: ("copysign({0}, {1})", "copysign"),
    ca.OP_SIGN: ("({0} > 0 ? 1.0 : {0} < 0 ? -1.0 : 0.0)", "sign"),
    ca.OP_FLOOR: ("floor({0})", "floor"),
    ca.OP_CEIL: ("ceil({0})", "ceil"),
    ca.OP_FMOD: ("fmod({0}, {1})", "fmod"),
    ca.OP_LT: ("({0} < {1} ? 1.0 : 0.0)", "less"),
    ca.OP_LE: ("({0} <= {1} ? 1.0 : 0.0)", "less_equal"),
    ca.OP_EQ: ("({0} == {1} ? 1.0 : 0.0)", "equal"),
    ca.OP_NE: ("({0} != {1} ? 1.0 : 0.0)", "not_equal"),
    ca.OP_NOT: ("({0} == 0 ? 1.0 : 0.0)", "logical_not"),
    ca.OP_AND: ("({0} != 0 && {1} != 0 ? 1.0 : 0.0)", "logical_and"),
    ca.OP_OR: ("({0} != 0 || {1} != 0 ? 1.0 : 0.0)", "logical_or"),
    ca.OP_IF_ELSE_ZERO: ("({0} != 0 ? {1} : 0.0)", "if_else_zero"),
}


def replay(
    function: ca.Function,
    arguments: Sequence[Sequence[Any]],
    apply: Callable[[int, list[Any]], Any],
    constant: Callable[[float], Any] = lambda value: value,
) -> list[list[Any]]:
    """Replay the scalar instructions of an SX function on scalars of any type.

    Parameters
    ----------
    function : casadi.Function
        An SX function with dense inputs and outputs.
    arguments : sequence of sequences
        ``arguments[i][j]`` is the j-th scalar of input i (column-major).
    apply : callable
        ``apply(op, operands)`` returns the value of the CasADi operation ``op``.
    constant : callable
        Turns a float constant of the expression into the scalar type.

    Returns
    -------
    list of lists: the scalars of each output.
    """
    work: list[Any] = [None] * function.sz_w()
    results: list[list[Any]] = [
        [constant(0.0)] * function.nnz_out(i) for i in range(function.n_out())
    ]
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        out, inp = function.instruction_output(k), function.instruction_input(k)
        if op == ca.OP_INPUT:
            work[out[0]] = arguments[inp[0]][inp[1]]
        elif op == ca.OP_OUTPUT:
            results[out[0]][out[1]] = work[inp[0]]
        elif op == ca.OP_CONST:
            work[out[0]] = constant(function.instruction_constant(k))
        else:
            work[out[0]] = apply(op, [work[i] for i in inp])
    return results


def no_operation(op: int, form: str) -> ContactSystemError:
    """The error of an operation of CasADi that cannot be written in a form, such as C."""
    name = next((key for key in vars(ca) if key.startswith("OP_") and vars(ca)[key] == op), op)
    return ContactSystemError(
        f"operation {name} of CasADi has no {form} form here; write the surface with "
        "+ - * / sqrt, trigonometric, hyperbolic, exp, log, pow, fabs, fmin, fmax, fmod, if_else"
    )


def _name_of(op: int, column: int) -> str:
    if op not in _OPERATIONS:
        raise no_operation(op, ("C", "numpy")[column])
    return _OPERATIONS[op][column]


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
    divides = Counter(x[-1] for op, x in steps if op in (ca.OP_DIV, ca.OP_INV))
    lines, inverse = [], dict[str, str]()
    for k, (op, operands) in enumerate(steps):
        divisor = operands[-1]
        if op in (ca.OP_DIV, ca.OP_INV) and divides[divisor] > 1:
            if divisor not in inverse:
                inverse[divisor] = f"over{k}"
                lines.append(f"const double over{k} = 1.0 / {divisor};")
            factors = [inverse[divisor]] if op == ca.OP_INV else [operands[0], inverse[divisor]]
            lines.append(f"const double w{k} = {' * '.join(factors)};")
        else:
            lines.append(f"const double w{k} = {_name_of(op, 0).format(*operands)};")
    return lines, outputs


class Kernel:
    """One expression evaluated at many points of many bodies.

    Parameters
    ----------
    name : str
    point : SX (n_point)
        Inputs that change from point to point.
    constant : SX (n_constant)
        Inputs that are constant for a body (radii, initial frames).
    result : SX (n_result)
    """

    def __init__(self, name: str, point: ca.SX, constant: ca.SX, result: ca.SX):
        self.name = name
        self.n_point, self.n_constant = point.numel(), constant.numel()
        self.n_result = result.numel()
        self.function = ca.Function(name, [point, constant], [ca.cse(ca.densify(ca.vec(result)))])
        self.restores: tuple[Restoration, ...] = ()
        self.nested = 0  # so many last states are rates of others, see panels.c
        self.reach = np.inf  # sizes by which its states change in a panel, see Surface.reach
        self._memory = threading.local()  # a machine has buffers: one for each thread

    def machine(self, n: int) -> Machine:
        """The virtual machine for n points, each with its own constants (made once per n)."""
        machines: dict[int, Machine] = self._memory.__dict__.setdefault("machines", {})
        if n not in machines:
            if len(machines) > 32:
                machines.clear()
            machines[n] = Machine(self, n)
        return machines[n]

    def nodes(self, constants: np.ndarray, n: int) -> Nodes:
        """Buffers and an engine for n points of each of some bodies, evaluated again and again.

        constants : (n_bodies, n_constant)
        """
        bodies = len(constants)
        if bodies * n >= MANY_POINTS:
            x, y = np.zeros((self.n_point, bodies, n)), np.zeros((bodies, self.n_result, n))
            memory: dict[str, Any] = {}  # the constants do not change
            program, columns = self._numpy, constants.T[:, :, None]
            run = functools.partial(program, x, columns, y, memory)
            return Nodes(x.transpose(1, 2, 0), y.transpose(0, 2, 1), run)
        machine = self.machine(bodies * n)
        machine.c.reshape(bodies, n, -1)[:] = constants[:, None, :]
        return Nodes(
            machine.x.reshape(bodies, n, -1), machine.y.reshape(bodies, n, -1), machine.run
        )

    @kept
    def _numpy(self) -> NumpyProgram:
        return NumpyProgram(self.function)

    @kept
    def loop_source(self) -> str:
        """:meth:`loop` under the kernel's own name."""
        return self.loop(self.name)

    def loop(self, name: str) -> str:
        """C99: ``void name(nb, nt, in, in_row, in_body, constants, out, out_row, out_body)``."""
        point = [f"in[in_row[{i}] + b * in_body + i]" for i in range(self.n_point)]
        constant = [f"c[{i}]" for i in range(self.n_constant)]
        lines, (outputs,) = c_statements(self.function, [point, constant])
        body = "".join(f"      {line}\n" for line in lines)
        body += "".join(
            f"      out[out_row[{i}] + b * out_body + i] = {name};\n"
            for i, name in enumerate(outputs)
        )
        return (
            f"void {name}(long nb, long nt, const double *restrict in, "
            "const long *restrict in_row, long in_body, const double *restrict constants, "
            "double *restrict out, const long *restrict out_row, long out_body) {\n"
            "  for (long b = 0; b < nb; b++) {\n"
            f"    const double *restrict c = constants + b * {self.n_constant};\n"
            "    #pragma omp simd\n"
            "    for (long i = 0; i < nt; i++) {\n"
            f"{body}    }}\n  }}\n}}\n"
        )

    @kept
    def library(self) -> Any:
        """:meth:`loop`, compiled."""
        library = compiled_library(PRELUDE + self.loop_source)
        entry = getattr(library, self.name)
        pointer = ctypes.c_void_p
        entry.argtypes = [ctypes.c_long] * 2 + [pointer, pointer, ctypes.c_long, pointer]
        entry.argtypes += [pointer, pointer, ctypes.c_long]
        entry.restype = None
        return entry

    @kept
    def built(self) -> bool:
        """Whether the compiled form lies in the cache (looked up once)."""
        return is_built(PRELUDE + self.loop_source)

    def usable(self, compiled: bool | None) -> bool:
        """Whether to run compiled, as asked for by True, False or None: if it was built."""
        return self.built if compiled is None else compiled

    def __call__(
        self,
        points: np.ndarray,
        constants: np.ndarray,
        out: np.ndarray,
        compiled: bool | None = False,
        memory: dict[str, Any] | None = None,
    ) -> None:
        """Evaluate at the points of some bodies.

        Parameters
        ----------
        points : (n_bodies, n_point, n) float64, contiguous; n_bodies may be 1 (shared)
        constants : (n_bodies, n_constant) float64, contiguous
        out : (n_bodies, n_result, n) float64 with unit stride along the last axis
        compiled : bool or None
            True: compile if need be; False: numpy; None: compiled if it was built before.
        memory : dict, optional
            Where numpy keeps what follows from the constants alone; for the same constants only.
        """
        if self.usable(compiled):
            n_bodies, _, n = out.shape
            points, constants = contiguous(points), contiguous(constants)
            shared = points.shape[0] == 1
            self.library(
                n_bodies, n, address(points), row_offsets(tuple(range(self.n_point)), n),
                0 if shared else points.shape[1] * n, address(constants), out.ctypes.data,
                row_offsets(tuple(range(self.n_result)), out.strides[1] // 8), out.strides[0] // 8,
            )  # fmt: skip
            return
        self._numpy(points.transpose(1, 0, 2), constants.T[:, :, None], out, memory)

    def at(self, points: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """Evaluate at one point of each body: (n, n_point), (n, n_constant) -> (n, n_result)."""
        machine = self.machine(len(points))
        machine.x[:] = points
        machine.c[:] = constants
        machine.run()
        return machine.y.copy()


def contiguous(a: np.ndarray) -> np.ndarray:
    """The array itself, or a contiguous copy."""
    return a if a.flags.c_contiguous else np.ascontiguousarray(a)


def row_offsets(rows: tuple[int, ...], stride: int) -> int:
    """Address of the offsets ``rows * stride`` as C longs; kept, because making one costs 2 us.

    Until 4096 others were asked for: those that a call of C is reading are among the latest.
    """
    return _offsets(rows, stride)[0]


@functools.lru_cache(maxsize=4096)
def _offsets(rows: tuple[int, ...], stride: int) -> tuple[int, np.ndarray]:
    offsets = np.array(rows, dtype=np.dtype("l")) * stride
    return offsets.ctypes.data, offsets


class Restoration(NamedTuple):
    """How part of a motion's state is put back on its surface after a step.

    kernel : state -> state, with the surface's parameters
    row : where that part begins in the motion's state
    constant : where those parameters begin in the motion's constants
    """

    kernel: Kernel
    row: int
    constant: int


# The virtual machine takes about 190 ns a point for 90 operations, numpy 45 us + 55 ns a point.
MANY_POINTS = 400


class Nodes(NamedTuple):
    """Write ``x`` (n_bodies, n, n_point), call ``run``, read ``y`` (n_bodies, n, n_result)."""

    x: np.ndarray
    y: np.ndarray
    run: Callable[[], Any]


class Machine:
    """CasADi's virtual machine on n points, with fixed buffers.

    Write ``x`` (n, n_point) and ``c`` (n, n_constant), call ``run``, read ``y`` (n, n_result).
    """

    def __init__(self, kernel: Kernel, n: int):
        mapped = kernel.function.map(n) if n > 1 else kernel.function
        self.x = np.zeros((n, kernel.n_point))
        self.c = np.zeros((n, kernel.n_constant))
        self.y = np.zeros((n, kernel.n_result))
        self._buffer, self.run = mapped.buffer()
        # CasADi's own type hints ask for a second argument that its memoryview form does not take.
        set_arg: Any = self._buffer.set_arg
        set_res: Any = self._buffer.set_res
        if kernel.n_point:
            set_arg(0, memoryview(self.x.data))
        if kernel.n_constant:
            set_arg(1, memoryview(self.c.data))
        set_res(0, memoryview(self.y.data))


class NumpyProgram:
    """A function's instructions as numpy calls that write into reused buffers.

    A ufunc on 800 numbers takes 0.45 us into a warm buffer and 0.75 us into a new array, so every
    value that changes from point to point lives in a register; registers are freed after their last
    use. What depends on a body's constants alone is computed once a body.
    """

    def __init__(self, function: ca.Function):
        steps: list[Step] = []
        inputs = [[("x", i) for i in range(function.nnz_in(0))],
                  [("c", i) for i in range(function.nnz_in(1))]]  # fmt: skip

        def apply(op: int, operands: list[Any]) -> tuple[str, int]:
            steps.append((len(steps), _name_of(op, 1), operands))
            return "w", len(steps) - 1

        (self._outputs,) = replay(function, inputs, apply)
        lines, self._registers = self._source(_pair_sines_and_cosines(steps))
        fixed = [line for line in lines if line.startswith("    k")]
        moving = [line for line in lines if not line.startswith("    k")]
        names = [line.split(" = ")[0].strip() for line in fixed]
        unpack = [f"    {', '.join(names)}, = k"] if names else []
        source = ["def constants(c):", *fixed, f"    return [{', '.join(names)}]"]
        source += ["def program(x, c, k, r, out):", *unpack, *moving, "    return"]
        scope: dict[str, Any] = {"np": np, "twice": _twice, "if_else_zero": _if_else_zero}
        exec("\n".join(source), scope)  # our own source
        self._constants, self._program = scope["constants"], scope["program"]
        self._memory = threading.local()

    def __call__(
        self, x: np.ndarray, c: np.ndarray, out: np.ndarray, memory: dict[str, Any] | None
    ) -> None:
        """x (n_point, n_bodies or 1, n), c (n_constant, n_bodies, 1) -> out (n_bodies, ., n)."""
        known = None if memory is None else memory.get("constants")
        if known is None:
            known = self._constants(c)
            if memory is not None:
                memory["constants"] = known
        shape = (self._registers, out.shape[0], out.shape[2])
        kept, registers = getattr(self._memory, "registers", (None, []))
        if kept != shape:
            # separate small arrays: one large one would be mapped anew by malloc every time
            registers = [np.empty(shape[1:]) for _ in range(self._registers)]
            if self._registers * shape[1] * shape[2] < 1_000_000:
                self._memory.registers = shape, registers
        self._program(x, c, known, registers, out.transpose(1, 0, 2))

    def _source(self, steps: list[Step]) -> tuple[list[str], int]:
        """Statements, and how many registers they use."""
        last: dict[int, int] = {}
        for k, (_, _, operands) in enumerate(steps):
            last |= {o[1]: k for o in operands if _is_work(o)}
        last |= {o[1]: len(steps) for o in self._outputs if _is_work(o)}
        place: dict[int, str] = {}
        register_of: dict[int, int] = {}  # values that change from point to point
        free: list[int] = []
        lines, count = [], 0
        # A result is computed where it belongs; a value that is two results is copied once.
        results = {o[1]: i for i, o in reversed(list(enumerate(self._outputs))) if _is_work(o)}

        def name(operand: Any) -> str:
            if not isinstance(operand, tuple):
                return repr(operand)
            return place[operand[1]] if operand[0] == "w" else f"{operand[0]}[{operand[1]}]"

        for k, (value, ufunc, operands) in enumerate(steps):
            if value not in last:
                continue
            call = ufunc if ufunc in ("twice", "if_else_zero") else f"np.{ufunc}"
            arguments = ", ".join(name(o) for o in operands)
            works = {o[1] for o in operands if _is_work(o)}
            varies = any(isinstance(o, tuple) and o[0] == "x" for o in operands)
            varies = varies or any(w in register_of for w in works)
            free += [register_of[w] for w in works if last[w] == k and register_of.get(w, -1) >= 0]
            if varies and value in results:
                place[value] = f"out[{results[value]}]"
                register_of[value] = -1
                lines.append(f"    {call}({arguments}, out={place[value]})")
            elif varies:
                if not free:
                    free.append(count)
                    count += 1
                register_of[value] = free.pop()
                place[value] = f"r[{register_of[value]}]"
                lines.append(f"    {call}({arguments}, out={place[value]})")
            else:
                place[value] = f"k{value}"
                lines.append(f"    {place[value]} = {call}({arguments})")
        for i, o in enumerate(self._outputs):
            if not (_is_work(o) and place[o[1]] == f"out[{i}]"):
                lines.append(f"    out[{i}] = {name(o)}")
        return lines, count


Step = tuple[int, str, list[Any]]
"""Number of the value, numpy ufunc, operands: ("x" | "c" | "w", index) or a number."""


def _is_work(operand: Any) -> bool:
    return isinstance(operand, tuple) and operand[0] == "w"


def _twice(x: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    return np.add(x, x, out=out)


def _if_else_zero(
    condition: np.ndarray, value: np.ndarray, out: np.ndarray | None = None
) -> np.ndarray:
    chosen = np.where(condition != 0, value, 0.0)
    if out is None:
        return chosen
    out[...] = chosen
    return out


def _pair_sines_and_cosines(steps: list[Step]) -> list[Step]:
    """Replace sin(a), cos(a) by t = tan(a/2): 2t/(1+t^2) and 2/(1+t^2) - 1.

    numpy's sine and cosine together cost ten times its tangent; both forms are right to 3e-16.
    """
    calls: dict[Any, dict[str, int]] = {}
    for value, ufunc, operands in steps:
        if ufunc in ("sin", "cos") and isinstance(operands[0], tuple):
            calls.setdefault(operands[0], {})[ufunc] = value
    pairs = {frozenset(found.values()) for found in calls.values() if len(found) == 2}
    result: list[Step] = []
    helpers: dict[Any, tuple[tuple[str, int], tuple[str, int]]] = {}
    number = len(steps)
    for value, ufunc, operands in steps:
        if not any(value in pair for pair in pairs):
            result.append((value, ufunc, operands))
            continue
        argument = operands[0]
        if argument not in helpers:
            half, tangent, square, whole, scale = (("w", number + i) for i in range(5))
            number += 5
            result += [
                (half[1], "multiply", [0.5, argument]),
                (tangent[1], "tan", [half]),
                (square[1], "square", [tangent]),
                (whole[1], "add", [1.0, square]),
                (scale[1], "divide", [2.0, whole]),
            ]
            helpers[argument] = tangent, scale
        tangent, scale = helpers[argument]
        if ufunc == "sin":
            result.append((value, "multiply", [tangent, scale]))
        else:
            result.append((value, "subtract", [scale, 1.0]))
    return result


# --- compiled C ------------------------------------------------------------------------------

# glibc's vector mathematics is switched on function by function, so that nothing else of
# -ffast-math (reassociation, no infinities) comes with it.  Their error bound is 4 ulp.
PRELUDE = """#include <math.h>
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#if __GLIBC_PREREQ(2, 35)
#define VECTOR __attribute__((simd("notinbranch"), const))
VECTOR double sin(double); VECTOR double cos(double); VECTOR double tan(double);
VECTOR double exp(double); VECTOR double log(double); VECTOR double pow(double, double);
VECTOR double atan(double); VECTOR double atan2(double, double);
VECTOR double asin(double); VECTOR double acos(double);
#endif
#endif
"""
_FLAGS = ["-std=gnu99", "-O3", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math",
          "-fopenmp-simd", "-march=native"]  # fmt: skip
# GCC prefers half the width of AVX-512 on Intel's processors: 10 to 20 % slower on crowds. Before
# its version 8 it had no such option.
_X86 = platform.machine().lower() in ("x86_64", "amd64")
_WIDTHS = [["-mprefer-vector-width=512"], []] if _X86 else [[]]
# GCC's sincos pass would turn sin(x), cos(x) into a call that has no vector form (measured: 7 times
# slower); Clang finds glibc's vector forms by its own option.
_FORMS: list[list[str]] = [["-fdisable-tree-sincos", "-lmvec"], ["-fveclib=libmvec", "-lmvec"], []]
# Tried in turn until one builds
_VARIANTS = [[*width, *form, "-lm"] for width in _WIDTHS for form in _FORMS]


@functools.cache
def find_compiler() -> tuple[str, ...] | None:
    """The command of a C compiler: ``$CC``, cc, gcc, clang, or the ziglang package; else None."""
    named = os.environ.get("CC", "").split()
    for name, *options in [*([named] if named else []), ["cc"], ["gcc"], ["clang"]]:
        path = shutil.which(name)
        if path:
            return (path, *options)
    try:
        import ziglang  # noqa: F401
    except ImportError:
        return None
    return (sys.executable, "-m", "ziglang", "cc")


# Where users' caches are: the variable that names the folder, and what it is below their homes.
_CACHES = {"win32": ("LOCALAPPDATA", "AppData", "Local"), "darwin": ("", "Library", "Caches")}
_REMEDY = "set CONTACT_SYSTEM_CACHE to a folder that can be written to"


def cache_folder() -> Path:
    """Where compiled kernels are kept: ``$CONTACT_SYSTEM_CACHE`` or the user's cache folder.

    Raises
    ------
    ContactSystemError
        The user has no home folder, as some users of containers.
    """
    chosen = os.environ.get("CONTACT_SYSTEM_CACHE")
    if chosen:
        return Path(chosen).absolute()  # a bare file name would be sought among the system's
    variable, *below = _CACHES.get(sys.platform, ("XDG_CACHE_HOME", ".cache"))
    base = Path(os.environ.get(variable, ""))
    if not base.is_absolute():  # XDG has it ignored then
        try:
            base = Path.home().joinpath(*below)
        except RuntimeError:
            raise ContactSystemError(f"this user has no home folder; {_REMEDY}") from None
    return base / "contact_system"


def make_folder(path: Path, remedy: str) -> Path:
    """The folder, made if it is not there.

    Raises
    ------
    ContactSystemError
        It cannot be made; the message ends with the remedy.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ContactSystemError(f"no folder '{path}': {error.strerror}; {remedy}") from None
    return path


@contextlib.contextmanager
def cache_room() -> Iterator[Path]:
    """A folder in the cache's, for the time in which a file is made that goes there.

    Raises
    ------
    ContactSystemError
        Nothing can be written there.
    """
    folder = make_folder(cache_folder(), _REMEDY)
    try:
        with tempfile.TemporaryDirectory(dir=folder) as room:
            yield Path(room)
    except OSError as error:
        raise ContactSystemError(f"cache folder '{folder}': {error}; {_REMEDY}") from None


@functools.cache
def _machine_tag() -> str:
    """-march=native code must not be shared by machines of different kinds through one cache."""
    try:
        info = Path("/proc/cpuinfo").read_text().split("\n\n", 1)[0]
        kept = [line for line in info.splitlines() if line.startswith(("flags", "Features"))]
    except OSError:
        kept = []
    return sysconfig.get_platform() + "".join(kept)


def library_path(source: str) -> Path:
    """The cache file of a C source: its name is a digest of source, flags and machine."""
    compiler = " ".join(find_compiler() or ("none",))
    flags = [*_FLAGS, *_VARIANTS[0]]
    digest = hashlib.sha256("\0".join([source, *flags, compiler, _machine_tag()]).encode())
    suffix = ".dll" if sys.platform == "win32" else ".so"
    return cache_folder() / (digest.hexdigest()[:24] + suffix)


def is_built(source: str) -> bool:
    """Whether a C source has been built here before, where this user may read it."""
    try:
        return find_compiler() is not None and os.access(library_path(source), os.R_OK)
    except ContactSystemError:  # no folder to look in
        return False


def compiled_library(source: str) -> ctypes.CDLL:
    """Build a C source, or find it in the cache, and load it.

    Raises
    ------
    ContactSystemError
        No compiler, the compiler refused (its message is quoted), or a cache folder that cannot be
        written to, or that no library can be loaded from.
    """
    path = library_path(source)
    with contextlib.suppress(OSError):  # not there, or damaged: built again
        if not _is_cut_short(path):
            return ctypes.CDLL(str(path))
    _build(source, path)
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        path.unlink(missing_ok=True)  # or plans that take what they find would fail from now on
        raise ContactSystemError(
            f"what the compiler built cannot be loaded: {error}; if that folder may hold no "
            "programs (noexec), set CONTACT_SYSTEM_CACHE to another one, else set CC to this "
            "machine's compiler"
        ) from None


def _is_cut_short(path: Path) -> bool:
    """Whether a library lacks its end, which ends the process that loads it (SIGBUS).

    64-bit ELF files have the table of their sections last; others are left to the loader.
    """
    with path.open("rb") as file:
        head = file.read(64)
    if head[:5] != b"\x7fELF\2":
        return False
    table, length, count = (int.from_bytes(head[a:b], sys.byteorder) for a, b in _ELF_SECTIONS)
    return path.stat().st_size < table + length * count


_ELF_SECTIONS = ((40, 48), (58, 60), (60, 62))  # where they begin, the length of each, how many


def _build(source: str, path: Path) -> None:
    compiler = find_compiler()
    if compiler is None:
        raise ContactSystemError(
            "no C compiler found: install one (cc, gcc, clang), set CC, or `pip install ziglang`; "
            "or plan without compiled=True, which needs none"
        )
    with cache_room() as folder:
        code = folder / "kernel.c"
        code.write_text(source)
        built = folder / path.name
        for variant in _VARIANTS:
            command = [*compiler, *_FLAGS, str(code), "-o", str(built), *variant]
            run = subprocess.run(command, capture_output=True, text=True, errors="replace")
            if run.returncode == 0:
                os.replace(built, path)  # atomic: a second process never sees half a file
                return
    raise ContactSystemError(f"{' '.join(command)} failed:\n{run.stderr[-2000:]}")


def c_source(name: str) -> str:
    """A hand-written C file of this package, with what all of them share before it."""
    common = (C_SOURCES / "common.h").read_text()
    return f"#define N {NODES}\n{common}{(C_SOURCES / name).read_text()}"


_CACHE: dict[tuple[Any, ...], Any] = {}


def per_structure(build: Callable[..., Any]) -> Callable[..., Any]:
    """Cache a builder of kernels by the structures of the surfaces (and the flags) it is given."""

    @functools.wraps(build)
    def cached(*arguments: Any) -> Any:
        key = (build, *(getattr(a, "structure", a) for a in arguments))
        found = _CACHE.get(key)
        if found is None:
            with SYMBOLS:
                found = _CACHE.get(key)  # another thread may have been first
                if found is None:
                    found = _CACHE[key] = build(*arguments)
        return found

    return cached


def made_once(build: Callable[[], Any]) -> Callable[[], Any]:
    """The same for a builder without arguments, whose result is looked up faster."""

    @functools.cache
    @functools.wraps(build)
    def made() -> Any:
        with SYMBOLS:
            return build()

    return made


def address(array: np.ndarray) -> int:
    """Address of a contiguous array's first number (0.26 us; ``.ctypes.data`` takes 1 us)."""
    try:
        return _addressof(_number_in(array))  # type: ignore[arg-type]
    except (TypeError, ValueError, BufferError):  # read-only or empty
        assert array.flags.c_contiguous, "C reads numbers side by side"
        return array.ctypes.data


_addressof, _number_in = ctypes.addressof, ctypes.c_double.from_buffer


def function_address(function: Any) -> int:
    """Address of a compiled library's function."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0
