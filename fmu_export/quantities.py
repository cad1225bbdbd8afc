"""A variable of an FMU, and its unit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from contact_system.surfaces import Surface, UserSurface

Unit = tuple[int, int, int]
"""Exponents of metre, second and radian."""

METRE, RADIAN, SECOND, NONE = (1, 0, 0), (0, 0, 1), (0, 1, 0), (0, 0, 0)


@dataclass(eq=False)
class Variable:
    """One row of the table.

    Attributes
    ----------
    name : str
        In FMI 3, and in FMI 2 if it is a scalar.
    reference : int
        Value reference: index of the first element in the component's values.
    causality, variability : str
    initial : str or None
        None for inputs and time, as the standard wants.
    description : str
    unit : (int, int, int) or None
        Exponents of m, s, rad; None where a user's chart does not say.
    start : tuple of float
        One value an element; empty where the value is calculated.
    elements : tuple of str
        Names of the elements in FMI 2, row by row; empty for a scalar.
    shape : tuple of int
        () for a scalar.
    minimum, nominal : float or None
    derivative : int or None
        Reference of the variable whose time derivative this is.
    known : tuple of tuple of int
        For each element, references of the elements that it depends on, itself left out: inputs,
        states, parameters, time. Empty where the value is not a result.
    """

    name: str
    reference: int
    causality: str
    variability: str
    initial: str | None
    description: str
    unit: Unit | None = NONE
    start: tuple[float, ...] = ()
    elements: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()
    minimum: float | None = None
    nominal: float | None = None
    derivative: int | None = None
    known: tuple[tuple[int, ...], ...] = ()

    @property
    def size(self) -> int:
        """Number of elements."""
        return len(self.elements) or 1

    @property
    def kind(self) -> str:
        """When it is set, if ever: "fixed", "tunable", "input", "independent", "exact" (a start
        value) or "calculated"."""
        if self.causality == "parameter":
            return self.variability
        if self.causality in ("input", "independent"):
            return self.causality
        return self.initial or "calculated"

    def scalars(self) -> Iterator[Variable]:
        """The variables of FMI 2 in this row."""
        if not self.shape:
            yield self
            return
        for i, name in enumerate(self.elements):
            yield replace(
                self,
                name=name,
                reference=self.reference + i,
                start=self.start[i : i + 1],
                elements=(),
                shape=(),
                derivative=None if self.derivative is None else self.derivative + i,
                known=self.known[i : i + 1],
            )


def unit_name(unit: Unit) -> str:
    """Such as "rad/s2"; "1" where nothing is left."""
    over, under = "", ""
    for symbol, exponent in zip(("m", "rad", "s"), (unit[0], unit[2], unit[1])):
        text = symbol + (str(abs(exponent)) if abs(exponent) > 1 else "")
        over, under = (over + text * (exponent > 0), under + text * (exponent < 0))
    return (over or "1") + ("/" + under if under else "")


def chart_units(surface: Surface) -> tuple[Unit | None, Unit | None]:
    """Units of u and v; None where a user's chart does not say."""
    if isinstance(surface, UserSurface):
        u, v = (RADIAN if period else None for period in surface.periods())
    else:
        u, v = (METRE if is_length else RADIAN for is_length in surface.chart.lengths)
    return u, v


def per_second(unit: Unit | None, times: int) -> Unit | None:
    """The unit of a rate; None where the unit is not known."""
    return None if unit is None else (unit[0], unit[1] - times, unit[2])
