"""Surfaces given by a user's formula, a Python function or text, which is converted to data.

A function is called only once, with symbols. Named parameters stay symbols, so that changing one
needs no new tables. Tables are made from the formula at first use.
"""

from __future__ import annotations

import keyword
import math
import unicodedata
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from ..checks import finite_number, of_kind, one_of
from ..errors import ContactSystemError, SurfaceError
from ..expressions import FUNCTIONS, parse
from ..theory import symbols as ca
from ..theory.symbols import immediate_ctrl_c, making_symbols
from .base import Surface, positive_length, store


@dataclass(frozen=True, repr=False)
class Formula:
    """A user's formula as data, so that surfaces can be compared, hashed and pickled."""

    code: str
    """Serialised CasADi function of (named parameters, *variables)."""
    names: tuple[str, ...]
    """Named parameters, sorted."""
    values: tuple[float, ...]
    text: tuple[str, ...] | None
    """The formula as written; None if it was given as a function."""

    @property
    def named(self) -> dict[str, float]:
        return dict(zip(self.names, self.values))

    def function(self) -> ca.Function:
        return ca.Function.deserialize(self.code)

    def __call__(self, p: ca.SX, *variables: ca.SX) -> ca.SX:
        return self.function()(p, *variables)

    def __repr__(self) -> str:
        """The formula and its parameters, as arguments of a surface; a function by its digest."""
        text = repr(self.text)
        if self.text is None:
            import hashlib  # slow to import

            text = f"<function {hashlib.sha256(self.code.encode()).hexdigest()[:12]}>"
        return f"{text}, parameters={self.named}" if self.names else text


@dataclass(frozen=True, eq=False, repr=False, init=False)
class UserSurface(Surface):
    """Base class of surfaces given by a formula."""

    panel_limit: ClassVar[float] = 2.0  # short panels, as the surface may have bumps anywhere
    formula: Formula
    size: float = field(default=1.0, kw_only=True)

    def __init__(
        self, letters: str, definition: Any, formula: Any, parameters: Any, size: Any, inside: Any
    ) -> None:
        """Check and store the arguments that both kinds share; ``letters``: "uv" or "xyz"."""
        super().__init__(inside=inside)
        if definition is not None and formula is not None:
            raise SurfaceError(f"{self._kind}: f or F and formula are both given; give one of them")
        try:
            with making_symbols():
                formula = make_formula(
                    definition if formula is None else formula, parameters, letters
                )
        except ContactSystemError as error:
            raise SurfaceError(f"{self._kind}: {error}") from error.__cause__
        store(self, formula=formula, size=positive_length(self, "size", size))

    @property
    def named_parameters(self) -> dict[str, float]:
        """The parameters of the formula by name."""
        return self.formula.named

    def parameter_names(self, first: int = 0) -> tuple[str, ...]:
        return self.formula.names

    @property
    def structure(self) -> tuple[type, type | str]:
        return (type(self), self.formula.code)


def make_formula(formula: Any, parameters: Any, letters: str) -> Formula:
    """Turn what a user gave, a function, texts or a `Formula`, into a checked `Formula`.

    letters: the variables of texts, "uv" for a chart, of three components, "xyz" for a level
    function, of one.
    """
    numbers = _named(parameters, letters)
    if letters == "uv":
        arguments, count = [ca.SX.sym("u"), ca.SX.sym("v")], 3
    else:
        arguments, count = [ca.SX.sym("x", 3)], 1
    if isinstance(formula, Formula):
        return _renumbered(formula, numbers, letters, count)
    p = ca.SX.sym("p", len(numbers))
    symbols = dict(zip(numbers, ca.vertsplit(p)))
    if callable(formula):
        text, value = None, _trace(formula, arguments, symbols, count)
    else:
        text = _texts(formula, count)
        known = dict(zip(letters, ca.vertsplit(ca.vertcat(*arguments)))) | symbols
        value = ca.vertcat(*(ca.SX(parse(line, known)) for line in text))
    function = _checked_function(p, arguments, value)
    return Formula(function.serialize(), tuple(numbers), tuple(numbers.values()), text)


def _texts(formula: Any, count: int) -> tuple[Any, ...]:
    """The lines of a formula, one for each component; a line may be a number."""
    lines = (formula,) if isinstance(formula, str) else formula
    if not isinstance(lines, Sequence) or len(lines) != count:
        raise SurfaceError(
            f"{formula!r} must be a function of symbols, or {count} text(s), one for each component"
        )
    return tuple(str(line) if type(line) in (int, float) else line for line in lines)


def _checked_function(p: ca.SX, arguments: list[ca.SX], value: ca.SX) -> ca.Function:
    """The function (parameters, *arguments) -> value, checked to be usable for a surface."""
    inputs = ca.vertcat(p, *arguments)
    unknown = [symbol.name() for symbol in ca.symvar(value) if not ca.depends_on(inputs, symbol)]
    if unknown:
        raise SurfaceError(
            f"the formula uses symbols that are not its arguments ({', '.join(unknown)}); let it "
            "take them as arguments by name, and give their numbers in parameters"
        )
    function = ca.Function("surface", [p, *arguments], [value])
    for i in range(function.n_instructions()):
        is_constant = function.instruction_id(i) == ca.OP_CONST
        if is_constant and not math.isfinite(function.instruction_constant(i)):
            raise SurfaceError(
                "the formula holds a NaN or infinite constant; in a function of symbols "
                "use numpy or casadi functions (np.cos), not those of math"
            )
    for argument in arguments:
        if not ca.depends_on(value, argument):
            raise SurfaceError(f"the formula does not depend on {argument}, as a surface must")
    return function


def _named(parameters: Any, letters: str) -> dict[str, float]:
    """Return the named parameters, sorted by name."""
    if parameters is None:
        return {}
    of_kind(Mapping, parameters, "parameters", 'a table, such as {"R": 0.1}', SurfaceError)
    numbers: dict[str, float] = {}
    for given, value in parameters.items():
        # Python's parser writes a formula's names in this form, such as a micro sign as mu
        name = unicodedata.normalize("NFKC", given) if isinstance(given, str) else ""
        if not name.isidentifier() or keyword.iskeyword(name):
            raise SurfaceError(f"parameter name {given!r} must be a Python name, such as r_1")
        if name in (*letters, *FUNCTIONS, *numbers):
            raise SurfaceError(
                f"parameter name {given!r} already has a meaning in formulas; use another"
            )
        numbers[name] = finite_number(value, f"parameters[{given!r}]")
    return dict(sorted(numbers.items()))


def _renumbered(formula: Formula, numbers: dict[str, float], letters: str, count: int) -> Formula:
    """Return the formula with other values; raise if it is not for this kind of surface."""
    if formula.function().numel_out(0) != count:
        raise SurfaceError(
            f"formula = {formula!r} is that of another kind of surface; give "
            f"one of {count} component{'s' * (count > 1)} in {', '.join(letters)}"
        )
    for name in numbers:
        one_of(name, formula.names, "parameter of the formula", SurfaceError)
    return replace(formula, values=tuple({**formula.named, **numbers}.values()))


def _trace(
    function: Callable[..., Any], arguments: list[ca.SX], symbols: dict[str, ca.SX], count: int
) -> ca.SX:
    """Call a user's function on symbols and return its components as one column."""
    try:
        with warnings.catch_warnings(), immediate_ctrl_c():
            # CasADi warns of a future change of numpy functions of symbols
            warnings.simplefilter("ignore", FutureWarning)
            value = function(*arguments, **symbols)
            if isinstance(value, np.ndarray):
                value = value.ravel().tolist()
            parts = value if isinstance(value, (list, tuple)) else [value]
            column = ca.vertcat(*(ca.vec(ca.SX(part)) for part in parts))
    except Exception as error:  # whatever a user's function may raise
        names = "x, one column of three coordinates" if len(arguments) == 1 else "u, v"
        raise SurfaceError(
            f"the function fails on symbols ({type(error).__name__}: {error}); it is called with "
            f"{names}, and with the parameters {list(symbols)} by name: use these arguments, numpy "
            "or casadi functions, no if and no conversion to float"
        ) from error
    if column.shape != (count, 1):
        raise SurfaceError(
            f"the function returns {column.numel()} component(s); it must return {count}"
        )
    return column
