"""What users write of a surface, a function of symbols or text, as data.

A function is called once, on symbols; what a user wrote is never called again. Named parameters
stay symbols, so that changing one needs no new tables.
"""

from __future__ import annotations

import hashlib
import keyword
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..checks import finite_number
from ..errors import ContactSystemError, SurfaceError
from ..expressions import FUNCTIONS, parse
from ..theory import symbols as ca
from ..theory.symbols import MOST_KEPT


@dataclass(frozen=True)
class Formula:
    """A user's function of symbols, kept as data so that surfaces compare, hash and pickle.

    Attributes
    ----------
    code : str
        Serialised CasADi function of (named parameters, *variables).
    names : tuple of str
        Named parameters, sorted.
    values : tuple of float
        Their numbers.
    text : tuple of str, or None
        The formula as written, where it was written as text.
    """

    code: str = field(repr=False)
    names: tuple[str, ...]
    values: tuple[float, ...]
    text: tuple[str, ...] | None

    @property
    def named(self) -> dict[str, float]:
        """The numbers by their names."""
        return dict(zip(self.names, self.values, strict=True))

    def __call__(self, p: ca.SX, *variables: ca.SX) -> ca.SX:
        return _restore(self.code)(p, *variables)

    def describe(self) -> str:
        """Return the arguments that make this formula; other ones for another formula."""
        said = repr(self.text)
        if self.text is None:
            said = f"<function {hashlib.sha256(self.code.encode()).hexdigest()[:12]}>"
        return f"{said}, parameters={self.named}" if self.names else said


@lru_cache(maxsize=MOST_KEPT)
def _restore(code: str) -> ca.Function:
    return ca.Function.deserialize(code)


def _named(kind: str, given: Any, variables: Mapping[str, ca.SX]) -> dict[str, float]:
    """Return named parameters in order of their names."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise SurfaceError(f'{kind}: parameters = {given!r} must be a table such as {{"R": 0.1}}')
    for name in given:
        if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
            raise SurfaceError(f"{kind}: parameter name {name!r} must be a plain word")
        if name in variables or name in FUNCTIONS:
            raise SurfaceError(
                f"{kind}: parameter name {name!r} already has a meaning in formulas; use another"
            )
    return {
        name: finite_number(given[name], f"{kind}: parameters[{name!r}]", error=SurfaceError)
        for name in sorted(given)
    }


def make_formula(
    kind: str,
    given: Any,
    variables: Mapping[str, ca.SX],
    arguments: list[ca.SX],
    parameters: Any,
    count: int,
) -> Formula:
    """Turn a user's function or text into a checked `Formula` with ``count`` components."""
    numbers = _named(kind, parameters, variables)
    if isinstance(given, Formula):
        function = _restore(given.code)
        if (function.n_in(), function.numel_out(0)) != (1 + len(arguments), count):
            raise SurfaceError(
                f"{kind}: formula = {given.describe()} is that of another kind of surface; give "
                f"one of {count} component{'s' * (count > 1)} in {', '.join(variables)}"
            )
        return _with_numbers(kind, given, numbers)
    p = ca.SX.sym("p", len(numbers))
    symbols = {name: p[i] for i, name in enumerate(numbers)}
    text = None
    if callable(given):
        value = _trace(kind, given, arguments, symbols, count)
    else:
        text = _texts(kind, given, count)
        try:
            lines = [parse(line, {**variables, **symbols}) for line in text]
            value = ca.vertcat(*map(ca.SX, lines))
        except ContactSystemError as error:
            raise SurfaceError(f"{kind}: {error}") from None
    known = ca.vertcat(p, *arguments)
    strange = [symbol.name() for symbol in ca.symvar(value) if not ca.depends_on(known, symbol)]
    if strange:
        raise SurfaceError(
            f"{kind}: the formula uses symbols of its own ({', '.join(strange)}); give them "
            "numbers in parameters and take them as arguments by name"
        )
    for argument in arguments:
        if not ca.depends_on(value, argument):
            raise SurfaceError(
                f"{kind}: the formula does not depend on {argument}, as a surface must"
            )
    function = ca.Function("surface", [p, *arguments], [value])
    for i in range(function.n_instructions()):
        is_constant = function.instruction_id(i) == ca.OP_CONST
        if is_constant and not math.isfinite(function.instruction_constant(i)):
            raise SurfaceError(
                f"{kind}: the formula holds a NaN or infinite constant; in a function of symbols "
                "use numpy or casadi functions (np.cos), not those of math"
            )
    return Formula(function.serialize(), tuple(numbers), tuple(numbers.values()), text)


def one_of(kind: str, name: str, given: Any, formula: Formula | None) -> Any:
    if given is not None and formula is not None:
        raise SurfaceError(f"{kind}: {name} and formula are both given; give one of them")
    return formula if given is None else given


def _with_numbers(kind: str, formula: Formula, numbers: dict[str, float]) -> Formula:
    for name in numbers:
        if name not in formula.names:
            raise SurfaceError(
                f"{kind}: the formula has no parameter {name!r}; known: {', '.join(formula.names)}"
            )
    return replace(formula, values=tuple({**formula.named, **numbers}.values()))


def _texts(kind: str, given: Any, count: int) -> tuple[str, ...]:
    lines = (given,) if isinstance(given, str) else given
    if not isinstance(lines, Sequence) or len(lines) != count:
        raise SurfaceError(
            f"{kind}: {given!r} must be a function of symbols, or {count} text(s), one for each "
            "component"
        )
    return tuple(lines)


def _trace(
    kind: str,
    function: Callable[..., Any],
    arguments: list[ca.SX],
    symbols: dict[str, ca.SX],
    count: int,
) -> ca.SX:
    """Call a user's function on symbols and return its components as one column."""
    try:
        with warnings.catch_warnings():
            # CasADi announces a coming change of what numpy functions of symbols return.
            warnings.simplefilter("ignore", FutureWarning)
            value = function(*arguments, **symbols)
            column = ca.vertcat(*(ca.vec(ca.SX(part)) for part in _parts(value)))
    except Exception as error:  # whatever a user's function may raise
        given = "x, one column of three coordinates" if len(arguments) == 1 else "u, v"
        raise SurfaceError(
            f"{kind}: the function fails on symbols ({type(error).__name__}: {error}); it is given "
            f"{given}, and the parameters {list(symbols)} by name: take them so, use numpy or "
            "casadi functions, no if and no conversion to float"
        ) from error
    if column.shape != (count, 1):
        raise SurfaceError(
            f"{kind}: the function returns {column.numel()} component(s); it must return {count}"
        )
    return column


def _parts(value: Any) -> list[Any]:
    if isinstance(value, np.ndarray):
        return value.ravel().tolist()
    return list(value) if isinstance(value, (list, tuple)) else [value]
