"""A variable of an FMU, and its unit."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from contact_system.surfaces import Surface, UserSurface

Unit = tuple[int, int, int]
"""Exponents of metre, second and radian."""

METRE, RADIAN, SECOND, NONE = (1, 0, 0), (0, 0, 1), (0, 1, 0), (0, 0, 0)


@dataclass(eq=False)
class Variable:
    """A scalar variable or, in FMI 3, an array.

    Attributes
    ----------
    name, description : str
    unit : (int, int, int) or None
        Exponents of m, s, rad; None where a user's chart does not say.
    causality, variability : str
    initial : str or None
        None for inputs and time, as the standard wants.
    reference : int
        Value reference: index of the first element in the component's values.
    start : tuple of float
        One value an element; empty where the value is calculated.
    shape : tuple of int
        () for a scalar.
    within : (str, tuple of int)
        Name and shape of the array that this is an element of; "" and () if of none.
    minimum, nominal : float or None
    derivative : int or None
        Reference of the variable whose time derivative this is.
    jumps : bool
        Whether it is a state that events change.
    known : tuple of int
        References of the scalars that it depends on, except itself: inputs, states, parameters,
        time. Empty if the variable is not a result.
    """

    name: str
    description: str
    unit: Unit | None
    causality: str = "output"
    variability: str = "continuous"
    initial: str | None = "calculated"
    reference: int = 0
    start: tuple[float, ...] = ()
    shape: tuple[int, ...] = ()
    within: tuple[str, tuple[int, ...]] = ("", ())
    minimum: float | None = None
    nominal: float | None = None
    derivative: int | None = None
    jumps: bool = False
    known: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Number of its elements."""
        return math.prod(self.shape)

    @property
    def kind(self) -> str:
        """When it is set, if ever: "constant", "fixed", "tunable", "input", "independent", "exact"
        (a start value) or "calculated"."""
        if self.variability in ("constant", "fixed", "tunable"):
            return self.variability
        if self.causality in ("input", "independent"):
            return self.causality
        return self.initial or "calculated"


def array_of(elements: Sequence[Variable]) -> Variable:
    """The array of these elements, or the one scalar if it belongs to no array."""
    first, (name, shape) = elements[0], elements[0].within
    if not name:
        return first
    start = tuple(x for v in elements for x in v.start)
    known = tuple({reference for v in elements for reference in v.known})
    return replace(first, name=name, shape=shape, start=start, known=known)


@functools.cache
def unit_name(unit: Unit) -> str:
    """A unit's name, such as "rad/s2"; "1" if there is none."""
    over, under = "", ""
    for symbol, exponent in zip(("m", "rad", "s"), (unit[0], unit[2], unit[1])):
        text = symbol + (str(abs(exponent)) if abs(exponent) > 1 else "")
        over, under = (over + text * (exponent > 0), under + text * (exponent < 0))
    return (over or "1") + ("/" + under if under else "")


def chart_units(surface: Surface) -> tuple[Unit | None, Unit | None]:
    """Units of u and v; None where a user's chart does not say."""
    if isinstance(surface, UserSurface):
        around = [period and math.isclose(period, 2 * math.pi) for period in surface.periods()]
        u, v = (RADIAN if turns else None for turns in around)
    else:
        u, v = (METRE if is_length else RADIAN for is_length in surface.chart.lengths)
    return u, v


def per_second(unit: Unit | None, times: int) -> Unit | None:
    """The unit of a rate; None where the unit is not known."""
    return None if unit is None else (unit[0], unit[1] - times, unit[2])
