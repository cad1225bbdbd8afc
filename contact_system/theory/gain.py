r"""Gain laws lam(t), and their effect on slip. Each law is one row of `LAWS`.

Slip obeys an exact scalar law on every surface (eq. `contracaccel`, with any gain lam in place of
eta sigma^2)::

    |v_rel|(t) = |v_rel|(0) sigma(t)/sigma(0) exp(-L(t)),        L(t) = int_0^t lam
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import truediv
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite_number, one_of
from ..engine.binding import sign_changes
from ..errors import SceneError
from .profile import (
    Profile,
    as_time,
    clear_value,
    derivative,
    exact_product,
    integral,
    polynomial,
    rounded,
)


@dataclass(frozen=True)
class Law:
    """A gain law: lam = value sigma^power, plus max(0, sigma'/sigma) if it `cancels_growth`.

    The integral of lam is a polynomial, plus a logarithm where sigma grows. Slip shrinks while
    sigma'/sigma - lam < 0. Without `cancels_growth` this holds throughout for every value above the
    greatest sigma'/sigma^(power + 1); with `cancels_growth` it holds for every positive value.
    """

    parameter: str
    """Name of the value."""
    formula: str
    power: int
    cancels_growth: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.power, int) or self.power < 0:
            raise SceneError(f"law: power = {self.power!r}: give a whole number, 0 or more")

    @property
    def dimension(self) -> tuple[int, int]:
        """Exponents of metre and second in the value's unit: that of lam, 1/s, over sigma^power."""
        return -self.power, self.power - 1

    @property
    def unit(self) -> str:
        """The value's unit, such as "s/m^2"."""
        metre, second = self.dimension
        over = "s" + f"^{second}" * (second > 1) if second > 0 else "1"
        return over + "/" + ("m" + f"^{-metre}" * (metre < -1) if metre else "s")

    def rate(self, value: Any, sigma: Any, growth: Any) -> Any:
        """lam for numbers or symbols; growth is max(0, sigma'/sigma)."""
        lam = value * sigma**self.power
        return lam + growth if self.cancels_growth else lam


LAWS = {
    "path": Law("eta", "lam = eta sigma^2", 2),
    "time": Law("eta", "lam = eta", 0),
    "guaranteed": Law("rho", "lam = max(0, sigma'/sigma) + rho", 0, cancels_growth=True),
}
"""The gain laws: the paper's; the one that gives its reported times; one that suits any sigma."""


@dataclass(frozen=True)
class Gain:
    """Gain law lam(t) [1/s], which steers the object's curve towards rolling.

    Use the constructors `Gain.path`, `Gain.time`, `Gain.guaranteed`. The paper prints the first
    (eq. `contrac`), but the recovery times that it reports are those of the second.

    Attributes
    ----------
    law : str
        "path" lam = eta sigma^2; "time" lam = eta; "guaranteed" lam = max(0, sigma'/sigma) + rho.
    value : float
        eta [s/m^2] for "path", eta [1/s] for "time", rho [1/s] for "guaranteed".

    Raises
    ------
    SceneError
        If the law is unknown, or the value negative or not finite.
    """

    law: str
    value: float
    row: Law = field(init=False, repr=False)
    """The law's row of `LAWS`, as it is when the gain is made."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "row", LAWS[one_of(self.law, LAWS, "gain: law")])
        value = finite_number(self.value, f"gain: {self.parameter}", "not below 0")
        object.__setattr__(self, "value", value)

    @classmethod
    def path(cls, eta: float) -> Gain:
        """lam = eta sigma^2, as printed in eq. `contrac`; eta [s/m^2]."""
        return cls("path", eta)

    @classmethod
    def time(cls, eta: float) -> Gain:
        """lam = eta, a constant rate [1/s]."""
        return cls("time", eta)

    @classmethod
    def guaranteed(cls, rho: float) -> Gain:
        """lam = max(0, sigma'/sigma) + rho; rho [1/s].

        For any sigma, slip decays at least as fast as exp(-rho t): below 5 % after 3/rho.
        """
        return cls("guaranteed", rho)

    @property
    def parameter(self) -> str:
        """Name of the number in the law, such as "eta"."""
        return self.row.parameter

    def rate(self, profile: Profile, t: ArrayLike) -> Any:
        """lam(t) [1/s]; t [s] of any shape.

        The guaranteed law is +inf where sigma = 0: it removes slip at once when a path starts.
        """
        sigma = profile(t)
        growth: Any = 0.0
        if self.row.cancels_growth:
            with np.errstate(divide="ignore", invalid="ignore"):
                growth = np.maximum(0.0, np.asarray(profile.rate(t)) / sigma)
            growth = np.where(sigma > 0, growth, np.inf)[()]
        return self.row.rate(self.value, sigma, growth)

    def exponent(self, profile: Profile, t: ArrayLike, since: float = 0.0) -> Any:
        """L(t) - L(since) = int lam, closed form; t >= since [s] of any shape.

        For the guaranteed law each growth of sigma adds log(sigma/sigma(start of the growth)),
        which is +inf after sigma = 0. Polynomials are expanded about `since`, so that large gains
        cause no cancellation.
        """
        time = as_time(t)
        sigma = profile.shifted(since) if since else profile.coefficients
        lam = rounded(exact_product((self.value,), *[sigma] * self.row.power))
        total = polynomial(integral(lam), time - since)
        if self.row.cancels_growth:
            last = float(np.max(time, initial=since))
            for start, stop in profile.growths(since, last):
                with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                    first = clear_value(profile.coefficients, start)
                    ratio = np.divide(profile(np.clip(time, start, stop)), first)
                total = total + np.where(time > start, np.log(np.maximum(ratio, 1.0)), 0.0)
        return total


# --- contraction of slip -----------------------------------------------------------------------


@dataclass(frozen=True)
class Contraction:
    """Effect of a gain law on slip that nothing disturbs, over a horizon (eq. `contracaccel`).

    Attributes
    ----------
    gain : Gain
        The law.
    duration : float
        The horizon [s].
    intervals : tuple of (float, float)
        Intervals in which slip shrinks: sigma'/sigma - lam < 0 [s].
    throughout : bool
        True if slip shrinks over the whole horizon.
    least_eta : float
        Slip shrinks over the whole horizon for every gain above this one, in the unit of
        `Gain.value`; inf if there is none (sigma grows from zero), 0 if every positive one does.
    growth : tuple of (float, float)
        Time at which slip is greatest [s], and its value there as a multiple of that at t = 0.
        (0, nan) if sigma(0) = 0, as slip then starts at zero.
    left : float
        Slip at the end as a multiple of its value at t = 0; nan if sigma(0) = 0.
    """

    gain: Gain
    duration: float
    intervals: tuple[tuple[float, float], ...]
    throughout: bool
    least_eta: float
    growth: tuple[float, float]
    left: float

    def __str__(self) -> str:
        listed = ", ".join(f"[{a:.3g}, {b:.3g}] s" for a, b in self.intervals)
        shrinks = f"shrinks only on {listed} of the" if listed else "never shrinks in the"
        text = f"Gain law '{self.gain.law}', {self.gain.row.formula}, {self.gain.parameter} = "
        text += f"{self.gain.value:.6g}: undisturbed slip "
        text += "shrinks over the whole" if self.throughout else shrinks
        text += f" horizon of {self.duration:g} s."
        if self.growth[1] > 1:
            text += (
                f" It is greatest at t = {self.growth[0]:.3g} s, {self.growth[1]:.3g} times its "
                "value at t = 0."
            )
        if not math.isnan(self.left):
            text += f" At the end it is {self.left:.2g} times its value at t = 0."
        return text + self._remedy()

    def _remedy(self) -> str:
        name, row = self.gain.parameter, self.gain.row
        if row.cancels_growth:
            least = "" if row.power else f", at least as fast as exp(-{name} t)"
            return f" Any {name} > 0 makes slip shrink throughout{least}."
        if math.isinf(self.least_eta):
            leaves = "starts from zero" if math.isnan(self.left) else "touches zero on the way"
            ratio = " (slip divided by sigma shrinks all the same)" if self.gain.value else ""
            return (
                f" No finite {name} shrinks it throughout: sigma {leaves}, where sigma'/sigma "
                f"is unbounded{ratio}. The law 'guaranteed' does."
            )
        return f" This law shrinks it throughout for every {name} above {self.least_eta:.3g}."


def contraction(profile: Profile, gain: Gain, duration: float) -> Contraction:
    """Intervals on which slip shrinks under a gain law, and the least gain for all the horizon.

    The profile must pass `Profile.check` on the horizon [0, duration] [s].
    """
    supremum = _least_gain(profile, gain.row, duration)
    throughout = gain.value > supremum
    intervals = ((0.0, duration),) if throughout else _shrinking(profile, gain, duration)
    growth, left = _slip_factors(profile, gain, duration, intervals)
    return Contraction(gain, duration, intervals, throughout, max(0.0, supremum), growth, left)


def _least_gain(profile: Profile, law: Law, duration: float) -> float:
    """Supremum over the horizon of sigma'/sigma^(power + 1)."""
    c, slope = profile.coefficients, profile.slope
    zeros = profile.zeros(duration)
    if not law.cancels_growth and any(t < duration for t in zeros):
        return math.inf
    n = law.power + 1
    # d/dt (sigma' sigma^-n) = 0  <=>  sigma'' sigma - n sigma'^2 = 0
    stationary = rounded(exact_product(derivative(slope), c), exact_product((-n,), slope, slope))
    times = {0.0, duration, *sign_changes(stationary, 0.0, duration)} - set(zeros)
    # divided step by step, as a power of a tiny sigma underflows
    steepest = (reduce(truediv, [profile(t)] * n, profile.rate(t)) for t in times)
    supremum = max(steepest, default=math.inf)
    return min(0.0, supremum) if law.cancels_growth else supremum


def _shrinking(profile: Profile, gain: Gain, duration: float) -> tuple[tuple[float, float], ...]:
    """Intervals on which sigma' - lam sigma < 0."""
    intervals: list[tuple[float, float]] = []
    knots, halves = profile.knots(0.0, duration), list[tuple[float, float, float]]()
    for before, after in zip(knots, knots[1:]):
        middle = 0.5 * (before + after)
        halves += [(before, before, middle), (after, middle, after)]
    for knot, start, stop in halves:
        # expand polynomials about the nearest knot: sigma may be zero there, and terms cancel
        c, law = profile.shifted(knot), gain.row
        # a law that cancels growth is here only with rho = 0: slip shrinks where sigma' < 0
        loss = () if law.cancels_growth else exact_product((-gain.value,), *[c] * (law.power + 1))
        rate = rounded(exact_product(derivative(c)), loss)
        turns = [knot + tau for tau in sign_changes(rate, start - knot, stop - knot)]
        for a, b in zip([start, *turns], [*turns, stop]):
            if clear_value(rate, 0.5 * (a + b) - knot) < 0:
                if intervals and intervals[-1][1] == a:
                    a = intervals.pop()[0]
                intervals.append((a, b))
    return tuple(intervals)


def _slip_factors(
    profile: Profile, gain: Gain, duration: float, intervals: Sequence[tuple[float, float]]
) -> tuple[tuple[float, float], float]:
    """Greatest slip (time, factor) and slip at the end (factor), both over slip at t = 0."""
    if 0.0 in profile.zeros(duration):
        return (0.0, math.nan), math.nan

    def factor(t: float) -> float:
        growth, exponent = profile(t) / profile(0.0), gain.exponent(profile, t)
        return growth * math.exp(-exponent) if growth > 0 else 0.0

    # slip is greatest where it starts to shrink, or at an end of the horizon
    times = sorted({0.0, duration, *(start for start, _ in intervals)})
    greatest = max(times, key=factor)
    return (greatest, factor(greatest)), factor(duration)
