"""CasADi functions evaluated with Drake's other scalars, AutoDiffXd and Expression."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pydrake.math as drake_math
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.symbolic import Expression, Formula, if_then_else

from contact_system.theory import symbols as ca
from contact_system.theory.lowering import replay


def select(condition: Any, value: Any, otherwise: Any) -> Any:
    """``value`` where the condition holds, else ``otherwise``; the condition may be a Formula."""
    if isinstance(condition, Formula):
        return if_then_else(condition, Expression(0.0) + value, Expression(0.0) + otherwise)
    return value if condition else otherwise


def _truncated(a: Any) -> Any:
    return select(a >= 0.0, drake_math.floor(a), drake_math.ceil(a))


_NAMES = "exp log sqrt sin cos tan asin acos atan atan2 sinh cosh tanh floor ceil".split()
_OPERATIONS: dict[int, Callable[..., Any]] = {  # all operations of tables
    **{getattr(ca, f"OP_{name.upper()}"): getattr(drake_math, name) for name in _NAMES},
    ca.OP_FABS: drake_math.abs,
    ca.OP_FMIN: drake_math.min,
    ca.OP_FMAX: drake_math.max,
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_NEG: operator.neg,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: 2.0 * a,
    ca.OP_INV: lambda a: 1.0 / a,
    ca.OP_POW: drake_math.pow,
    ca.OP_CONSTPOW: drake_math.pow,
    ca.OP_HYPOT: lambda a, b: drake_math.sqrt(a * a + b * b),
    ca.OP_ASINH: lambda a: drake_math.log(a + drake_math.sqrt(a * a + 1.0)),
    ca.OP_ACOSH: lambda a: drake_math.log(a + drake_math.sqrt(a * a - 1.0)),
    ca.OP_ATANH: lambda a: 0.5 * drake_math.log((1.0 + a) / (1.0 - a)),
    ca.OP_LOG1P: lambda a: drake_math.log(1.0 + a),
    ca.OP_EXPM1: lambda a: drake_math.exp(a) - 1.0,
    ca.OP_COPYSIGN: lambda a, b: select(b >= 0.0, drake_math.abs(a), -drake_math.abs(a)),
    ca.OP_SIGN: lambda a: select(a > 0.0, 1.0, select(a < 0.0, -1.0, 0.0)),
    ca.OP_FMOD: lambda a, b: a - b * _truncated(a / b),
    # for CasADi the result of a condition is a number, 1 or 0
    ca.OP_LT: lambda a, b: select(a < b, 1.0, 0.0),
    ca.OP_LE: lambda a, b: select(a <= b, 1.0, 0.0),
    ca.OP_EQ: lambda a, b: select(a == b, 1.0, 0.0),
    ca.OP_NE: lambda a, b: select(a != b, 1.0, 0.0),
    ca.OP_NOT: lambda a: select(a == 0.0, 1.0, 0.0),
    ca.OP_AND: lambda a, b: select(a != 0.0, select(b != 0.0, 1.0, 0.0), 0.0),
    ca.OP_OR: lambda a, b: select(a != 0.0, 1.0, select(b != 0.0, 1.0, 0.0)),
    ca.OP_IF_ELSE_ZERO: lambda a, b: select(a != 0.0, b, 0.0),
}


def evaluate_symbols(function: ca.Function, arguments: Sequence[Any]) -> np.ndarray:
    """The first output of a CasADi function as Expressions, (n,)."""
    (values, *_) = replay(function, arguments, lambda op, x: _OPERATIONS[op](*x))
    return np.array([v if isinstance(v, Expression) else Expression(v) for v in values])


def evaluate_derivatives(jacobian: ca.Function, arguments: Sequence[Any]) -> np.ndarray:
    """An output of `SceneSystem` as AutoDiffXd, (n,), by its `jacobian`."""
    *varied, parameters = arguments
    numbers = [v if isinstance(v, AutoDiffXd) else AutoDiffXd(v) for part in varied for v in part]
    values, along = ExtractValue(numbers).ravel(), ExtractGradient(numbers)
    parts = np.split(values, np.cumsum([len(part) for part in varied])[:-1])
    value, slopes = (np.array(found) for found in jacobian(*parts, parameters))
    moved = along.any(axis=1)  # others may have an infinite slope
    return InitializeAutoDiff(value, slopes[:, moved] @ along[moved]).ravel()
