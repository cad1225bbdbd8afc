r"""Polynomials with exact integrals, and the path profile sigma(t).

Products and shifts of polynomials are computed exactly, in fractions, and rounded once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from itertools import zip_longest
from operator import mul
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..caching import cached_property
from ..checks import LARGEST, finite_number, finite_numbers, shaped_array, within
from ..engine.binding import sign_changes
from ..errors import SceneError

Coefficients = tuple[float, ...]
"""Coefficients of a polynomial, lowest power first."""

Exact = tuple[Fraction, ...]
"""The same in rational numbers."""

Numbers = Sequence[float] | np.ndarray
"""A few numbers as users give them; they are stored as a tuple of floats."""

CANCELLED = 1e5  # greatest ratio of sigma's terms to sigma: sigma keeps 11 digits, int lam 6


# --- polynomials -------------------------------------------------------------------------------


def polynomial(coefficients: Sequence, t: Any) -> Any:
    """The value of a polynomial at t, numbers or symbols; coefficients from the lowest power."""
    if len(coefficients) < 2:
        return sum(coefficients, 0.0 * t)
    result = coefficients[-1] * t
    for c in reversed(coefficients[1:-1]):
        result += c  # in place for arrays
        result *= t
    return result + coefficients[0]


def clear_value(coefficients: Sequence[float], t: float) -> float:
    """The value at t, or 0 if it may be due to rounding, including that of the coefficients."""
    value = polynomial(coefficients, t)
    terms = polynomial([*map(abs, coefficients)], abs(t)) if t else 0.0
    return value if abs(value) > 4e-16 * len(coefficients) * terms else 0.0


def derivative(coefficients: Sequence[float]) -> Coefficients:
    return tuple(map(mul, range(1, len(coefficients)), coefficients[1:])) or (0.0,)


def integral(coefficients: Sequence) -> tuple:
    """Coefficients, numbers or symbols, of the integral from 0."""
    return (0.0, *(c / (k + 1) for k, c in enumerate(coefficients)))


def product(a: Sequence, b: Sequence) -> tuple:
    """Coefficients, numbers or symbols, of the product of two polynomials."""
    result = [0 * a[0]] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            result[i + j] = result[i + j] + x * y
    return tuple(result)


def exact_product(*factors: Sequence[float]) -> Exact:
    """Exact product of polynomials."""
    return reduce(product, (tuple(map(Fraction, factor)) for factor in factors))


def rounded(*terms: Exact) -> Coefficients:
    """Sum of exact polynomials, each coefficient rounded once."""
    sums = map(sum, zip_longest(*terms, fillvalue=Fraction()))
    return tuple(map(float, sums))


# --- the path profile --------------------------------------------------------------------------


@dataclass(frozen=True)
class Profile:
    """Path profile sigma(t) = ds/dt = sum_k c_k t^k, a polynomial (eq. `sigma`).

    Parameters
    ----------
    coefficients : sequence of float
        c_0, c_1, ... [m/s, m/s^2, ...], lowest power first. Where terms of both signs are larger
        than sigma, cancellation costs digits of sigma, and twice as many of int sigma^2: 2 and 4
        for the minimum-jerk profile.

    Raises
    ------
    SceneError
        If there is no coefficient, or one is not a finite number.
    """

    coefficients: Coefficients

    if TYPE_CHECKING:  # arguments may have other types than the fields

        def __init__(self, coefficients: Numbers) -> None: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", finite_numbers(self.coefficients, "profile"))
        within("COEFFICIENTS", len(self.coefficients), "profile: coefficients")

    def __call__(self, t: ArrayLike) -> Any:
        """sigma(t) [m/s]; t [s] of any shape."""
        return polynomial(self.coefficients, as_time(t))

    def rate(self, t: ArrayLike) -> Any:
        """sigma'(t) [m/s^2]; t [s] of any shape."""
        return polynomial(self.slope, as_time(t))

    def arc_length(self, t: ArrayLike) -> Any:
        """s(t) = int_0^t sigma [m]; t [s] of any shape."""
        return polynomial(integral(self.coefficients), as_time(t))

    def shifted(self, t0: float) -> Coefficients:
        """Coefficients of tau -> sigma(t0 + tau), each rounded once.

        Rounding may put a zero of sigma just below zero, which scenes refuse: `Plan.continued` goes
        on from t0 without it.
        """
        c, start = exact_product(self.coefficients), Fraction(finite_number(t0, "t0"))
        powers = range(len(c))
        return tuple(
            float(sum(math.comb(j, k) * c[j] * start ** (j - k) for j in powers[k:]))
            for k in powers
        )

    def extrema(self, t0: float, t1: float) -> tuple[float, ...]:
        """Times inside (t0, t1) at which sigma' changes sign, ascending [s]."""
        span = finite_number(t0, "t0"), finite_number(t1, "t1")
        return tuple(sign_changes(self.coefficients, *span, order=1))

    def knots(self, t0: float, t1: float) -> tuple[float, ...]:
        """t0, the extrema between, t1: sigma is monotonic from each to the next [s]."""
        return (t0, *self.extrema(t0, t1), t1)

    def growths(self, t0: float, t1: float) -> list[tuple[float, float]]:
        """The intervals of [t0, t1] on which sigma grows [s]."""
        knots = self.knots(t0, t1)
        return [(a, b) for a, b in zip(knots, knots[1:]) if self.rate(0.5 * (a + b)) > 0]

    def check(self, duration: float) -> None:
        """Check that sigma is a path speed on [0, duration]: finite, not negative, not all zero.

        It may start, end or touch zero.

        Raises
        ------
        SceneError
            Naming the time, the value and the remedy.
        """
        c, duration = self.coefficients, finite_number(duration, "duration")
        if min(c) >= 0 and 0 < polynomial(c, duration) < LARGEST:  # then sigma >= 0 everywhere
            return
        if not any(c):
            raise SceneError(
                f"profile = {list(c)}: sigma is zero for all t, so nothing moves; "
                "give at least one coefficient that is not zero"
            )
        terms = polynomial([abs(x) for x in c], duration)
        if not terms < LARGEST:
            raise SceneError(
                f"profile = {list(c)}: sigma reaches about {terms:.3g} m/s at t = {duration:g} s, "
                "too large for floating point; shorten the duration or lower the coefficients"
            )
        knots = self.knots(0.0, duration)
        t = min(knots, key=lambda t: clear_value(c, t))
        if clear_value(c, t) >= 0:
            peak = max(map(self, knots))
            if not terms <= CANCELLED * peak:
                raise SceneError(
                    f"profile = {list(c)}: sigma is {peak:.3g} m/s at most and its terms are "
                    f"{terms:.3g} m/s together at t = {duration:g} s, so that rounding leaves few "
                    "digits of it; give a polynomial of lower degree, or a shorter duration"
                )
            return
        crossings = sign_changes(c, 0.0, duration)
        if crossings and self(0.5 * crossings[0]) > 0:
            remedy = f"end the scene before t = {crossings[0]:.6g} s, where sigma changes sign"
        else:
            remedy = "start with sigma >= 0 (to run a path backwards, reverse its path velocities)"
        raise SceneError(
            f"profile = {list(c)}: sigma = {self(t):.6g} m/s at t = {t:.6g} s is negative, "
            f"and sigma is a speed along the path; {remedy}"
        )

    def zeros(self, duration: float) -> tuple[float, ...]:
        """Times in [0, duration] at which a checked profile touches zero, ascending [s]."""
        if min(self.coefficients) >= 0:
            return () if self.coefficients[0] else (0.0,)
        knots = self.knots(0.0, finite_number(duration, "duration"))
        return tuple(t for t in knots if clear_value(self.coefficients, t) <= 0)

    @cached_property
    def slope(self) -> Coefficients:
        """Coefficients of sigma'."""
        return derivative(self.coefficients)


def as_time(t: ArrayLike) -> Any:
    """Times as an array of floats, or one time as a float."""
    if isinstance(t, float):
        return float(t)
    array = shaped_array(t, "profile at t", remedy="times in seconds")
    return array if array.ndim else float(array)
