r"""Path profile sigma(t), gain laws lam(t), and what a gain law does to slip.

Slip obeys an exact scalar law on every surface (eq. `contracaccel`, with any gain lam in the place
of eta sigma^2)::

    |v_rel|(t) = |v_rel|(0) sigma(t)/sigma(0) exp(-L(t)),        L(t) = int_0^t lam

sigma is a polynomial, so every integral needed here is one too: nothing is integrated numerically.
Products, squares and shifts of polynomials are formed exactly, in integers over one power of two
(as `fractions.Fraction` would, several times as fast), and rounded once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from operator import truediv
from typing import TYPE_CHECKING, Any

import numpy as np

from .checks import LARGEST, finite_number, finite_numbers, real_array
from .errors import SceneError
from .kept import kept

Coefficients = tuple[float, ...]
"""Coefficients of a polynomial, lowest power first."""

Exact = tuple[Sequence[int], int]
"""The same in rational numbers: numerators and the denominator of all, a power of two."""

Numbers = Sequence[float] | np.ndarray
"""What users may give for a few numbers, all of which are kept as tuples of floats."""

CANCELLED = 1e5  # times as large as sigma may its terms be: 11 digits are left of it, 6 of int lam
_BISECTIONS = 200  # down to neighbouring floats, also for a root very close to 0


# --- polynomials -------------------------------------------------------------------------------


def polynomial(coefficients: Sequence, t):
    """The value at t, numbers or symbols, of a polynomial; coefficients from the lowest power."""
    if len(coefficients) < 2:
        return sum(coefficients, 0.0 * t)
    result = coefficients[-1] * t
    for c in reversed(coefficients[1:-1]):
        result += c  # in place for arrays
        result *= t
    return result + coefficients[0]


def _noise(coefficients: Sequence[float], t: float) -> float:
    """Bound of the rounding error of `polynomial`, which also forgives rounded coefficients."""
    return (
        4e-16 * len(coefficients) * polynomial([abs(c) for c in coefficients], abs(t)) if t else 0.0
    )


def _clear_value(coefficients: Sequence[float], t: float) -> float:
    """The value at t, or 0 where its sign cannot be told from rounding."""
    value = polynomial(coefficients, t)
    return value if abs(value) > _noise(coefficients, t) else 0.0


def _derivative(coefficients: Sequence[float]) -> Coefficients:
    return tuple(k * c for k, c in enumerate(coefficients))[1:] or (0.0,)


def integral(coefficients: Sequence) -> tuple:
    """Coefficients of the integral from 0, numbers or symbols."""
    return (0.0, *(c / (k + 1) for k, c in enumerate(coefficients)))


def product(a: Sequence, b: Sequence) -> tuple:
    """Coefficients of the product of two polynomials, numbers or symbols."""
    result = [0 * a[0]] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            result[i + j] = result[i + j] + x * y
    return tuple(result)


def _exact(coefficients: Sequence[float]) -> Exact:
    ratios = [c.as_integer_ratio() for c in coefficients]
    whole = max(below for _, below in ratios)
    return [above * (whole // below) for above, below in ratios], whole


def _product(*factors: Sequence[float]) -> Exact:
    """Exact product of polynomials."""
    numerators, whole = _exact(factors[0])
    for factor in factors[1:]:
        others, below = _exact(factor)
        numerators, whole = product(numerators, others), whole * below
    return numerators, whole


def _rounded(*terms: Exact) -> Coefficients:
    """Sum of exact polynomials, each coefficient rounded once."""
    whole = max(below for _, below in terms)
    total = [0] * max(len(numerators) for numerators, _ in terms)
    for numerators, below in terms:
        for k, x in enumerate(numerators):
            total[k] += x * (whole // below)
    return tuple(x / whole for x in total)


def _sign_changes(coefficients: Sequence[float], start: float, stop: float) -> list[float]:
    """Times inside (start, stop) at which the polynomial changes sign, ascending.

    Between the sign changes of its derivative a polynomial is monotone, so bisection finds every
    one. Roots that only touch zero, rounded or not, are no sign changes.
    """
    if not any(coefficients[1:]):
        return []
    turns = _sign_changes(_derivative(coefficients), start, stop)
    signed = [(t, _clear_value(coefficients, t)) for t in (start, *turns, stop)]
    signed = [(t, value) for t, value in signed if value != 0]
    return [
        _bisect(coefficients, a, b, at_a)
        for (a, at_a), (b, at_b) in zip(signed, signed[1:])
        if at_a * at_b < 0
    ]


def _bisect(coefficients: Sequence[float], a: float, b: float, value_at_a: float) -> float:
    if len(coefficients) == 2:  # a line: its root, kept between the ends
        return min(max(a, -coefficients[0] / coefficients[1]), b)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (a + b)
        if not a < middle < b:
            break
        if polynomial(coefficients, middle) * value_at_a > 0:
            a = middle
        else:
            b = middle
    return b


# --- the path profile --------------------------------------------------------------------------


@dataclass(frozen=True)
class Profile:
    """Path profile sigma(t) = ds/dt = sum_k c_k t^k, a polynomial (eq. `sigma`).

    Parameters
    ----------
    coefficients : sequence of float
        c_0, c_1, ... [m/s, m/s^2, ...], lowest power first. Where terms of both signs are larger
        than sigma, rounding takes as many digits of sigma and twice as many of int sigma^2:
        2 and 4 for the minimum-jerk profile.

    Raises
    ------
    SceneError
        If there is no coefficient, or one is not a finite number.
    """

    coefficients: Coefficients

    if TYPE_CHECKING:  # the fields say what is kept, this what may be given

        def __init__(self, coefficients: Numbers) -> None: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", finite_numbers(self.coefficients, "profile"))

    def __call__(self, t):
        """sigma(t) [m/s]; t [s] of any shape."""
        return polynomial(self.coefficients, _as_time(t))

    def rate(self, t):
        """sigma'(t) [m/s^2]; t [s] of any shape."""
        return polynomial(self._rate, _as_time(t))

    def arc_length(self, t):
        """s(t) = int_0^t sigma [m]; t [s] of any shape."""
        return polynomial(self._arc_length, _as_time(t))

    def energy(self, t):
        """int_0^t sigma^2 [m^2/s]; t [s] of any shape."""
        return polynomial(self._energy, _as_time(t))

    def shifted(self, t0: float) -> Coefficients:
        """Coefficients of tau -> sigma(t0 + tau), each rounded once."""
        return _shifted(self.coefficients, finite_number(t0, "t0"))

    def extrema(self, t0: float, t1: float) -> tuple[float, ...]:
        """Times inside (t0, t1) at which sigma' changes sign, ascending [s]."""
        span = finite_number(t0, "t0"), finite_number(t1, "t1")
        return tuple(_sign_changes(self._rate, *span))

    def knots(self, t0: float, t1: float) -> tuple[float, ...]:
        """t0, the extrema between, t1: sigma is monotonic from each to the next [s]."""
        return (t0, *self.extrema(t0, t1), t1)

    def growths(self, t0: float, t1: float) -> list[tuple[float, float]]:
        """The intervals of [t0, t1] on which sigma grows [s]."""
        knots = self.knots(t0, t1)
        return [(a, b) for a, b in zip(knots, knots[1:]) if self.rate(0.5 * (a + b)) > 0]

    def check(self, duration: float) -> None:
        """Check that sigma is a path speed on [0, duration]: finite, not negative, not all zero.

        Touching zero is allowed; so is starting or ending there.

        Raises
        ------
        SceneError
            Naming the time, the value and the remedy.
        """
        c, duration = self.coefficients, finite_number(duration, "duration")
        if not any(c):
            raise SceneError(
                f"profile = {list(c)}: sigma is zero for all t, so nothing moves; "
                "give at least one coefficient that is not zero"
            )
        reach = polynomial([abs(x) for x in c], duration)
        if not reach < LARGEST:
            raise SceneError(
                f"profile = {list(c)}: sigma reaches about {reach:.3g} m/s at t = {duration:g} s, "
                "too large for floating point; shorten the duration or lower the coefficients"
            )
        if min(c) >= 0:  # no sum of such terms is negative
            return
        knots = self.knots(0.0, duration)
        t = min(knots, key=lambda t: _clear_value(c, t))
        if _clear_value(c, t) >= 0:
            peak = max(map(self, knots))
            if not reach <= CANCELLED * peak:
                raise SceneError(
                    f"profile = {list(c)}: sigma is {peak:.3g} m/s at most and its terms are "
                    f"{reach:.3g} m/s together at t = {duration:g} s, so that rounding leaves few "
                    "digits of it; give a polynomial of lower degree, or a shorter duration"
                )
            return
        crossings = _sign_changes(c, 0.0, duration)
        if crossings and self(0.5 * crossings[0]) > 0:
            remedy = f"end the scene before t = {crossings[0]:.6g} s, where sigma changes sign"
        else:
            remedy = "start with sigma >= 0 (to run a path backwards turn its path velocities)"
        raise SceneError(
            f"profile = {list(c)}: sigma = {self(t):.6g} m/s at t = {t:.6g} s is negative, "
            f"and sigma is a speed along the path; {remedy}"
        )

    def zeros(self, duration: float) -> tuple[float, ...]:
        """Times in [0, duration] at which a checked profile touches zero, ascending [s]."""
        if min(self.coefficients) >= 0:
            return () if self.coefficients[0] else (0.0,)
        knots = self.knots(0.0, finite_number(duration, "duration"))
        return tuple(t for t in knots if _clear_value(self.coefficients, t) <= 0)

    @kept
    def square(self) -> Coefficients:
        """Coefficients of sigma^2."""
        return _rounded(_product(self.coefficients, self.coefficients))

    @kept
    def _rate(self) -> Coefficients:
        return _derivative(self.coefficients)

    @kept
    def _arc_length(self) -> Coefficients:
        return integral(self.coefficients)

    @kept
    def _energy(self) -> Coefficients:
        return integral(self.square)


@lru_cache(maxsize=1024)
def _shifted(coefficients: Coefficients, t0: float) -> Coefficients:
    if t0 == 0:
        return coefficients
    numerators, whole = _exact(coefficients)
    step, unit = t0.as_integer_ratio()
    last = len(numerators) - 1
    scaled = [x * unit ** (last - j) for j, x in enumerate(numerators)]
    return tuple(
        sum(math.comb(j, k) * scaled[j] * step ** (j - k) for j in range(k, last + 1))
        / (whole * unit ** (last - k))
        for k in range(last + 1)
    )


def _as_time(t):
    if isinstance(t, float):
        return float(t)
    try:
        return real_array(t) if np.ndim(t) else float(real_array(t))
    except (TypeError, ValueError, OverflowError):
        raise SceneError(f"profile at t = {t!r}: give times in seconds") from None


# --- gain laws ---------------------------------------------------------------------------------

GAIN_LAWS = {"path": "eta", "time": "eta", "guaranteed": "rho"}
"""The gain laws and what their parameter is called."""


# Rounding in arc lengths would be most of the error of a great circle's coordinates. x86 has
# doubles of 80 bits; elsewhere long ones are plain, or have 128 bits and are slow.
WIDE = np.longdouble if np.finfo(np.longdouble).nmant == 63 else np.float64


@dataclass(frozen=True)
class GainPiece:
    """One piece of the horizon on which the decay of slip has a single closed form.

    With tau = t - start, and L = int lam::

        exp(-(L(t) - L(start))) = exp(-P(tau)) (sigma(start)/sigma(t))^power

    Attributes
    ----------
    start, stop : float
        The piece [s].
    sigma : tuple of float
        Coefficients of tau -> sigma(start + tau), lowest first.
    exponent : tuple of float
        Coefficients of P, lowest first; exponent[0] is 0.
    power : int
        0, or 1 where the guaranteed law makes up for a growing sigma. Where sigma(start) = 0 the
        ratio is 0 for tau > 0: slip per path speed ends at once.
    """

    start: float
    stop: float
    sigma: Coefficients
    exponent: Coefficients
    power: int

    def speed(self, tau):
        """sigma at local time tau [m/s]."""
        return polynomial(self.sigma, tau)

    def slope(self, tau):
        """sigma' at local time tau [m/s^2]."""
        return polynomial(self._slope, tau)

    def arc_length(self, tau):
        """int_0^tau sigma [m]."""
        return polynomial(self.lengths, tau)

    def rounded_length(self, tau: np.ndarray) -> np.ndarray:
        """:meth:`arc_length`, rounded once where there is a type for it."""
        wide = tau.astype(WIDE)
        return (wide * polynomial(self.lengths[1:], wide)).astype(float)

    def lost(self, tau):
        """P(tau), the exponent of the decay."""
        return polynomial(self.exponent, tau)

    def decay(self, tau, speed):
        """exp(-(L(tau) - L(0))) at local time tau, where sigma is ``speed``."""
        # slip may end below what a double holds, and sigma be 0 where a piece begins
        with np.errstate(under="ignore", divide="ignore", invalid="ignore"):
            decay = np.exp(-polynomial(self.exponent, tau))
            if self.power:
                decay = decay * np.where(np.asarray(tau) > 0, self.sigma[0] / speed, 1.0)
        return decay

    def gain(self, tau):
        """lam at local time tau [1/s]."""
        lam = polynomial(self._lost_slope, tau)
        if self.power:
            with np.errstate(divide="ignore", invalid="ignore"):
                lam = lam + self.slope(tau) / self.speed(tau)
        return lam

    @kept
    def _slope(self) -> Coefficients:
        return _derivative(self.sigma)

    @kept
    def lengths(self) -> Coefficients:
        """Coefficients of the arc length, lowest first."""
        return integral(self.sigma)

    @kept
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """sigma, lengths and exponent as arrays, for compiled code."""
        return np.array(self.sigma), np.array(self.lengths), np.array(self.exponent)

    @kept
    def _lost_slope(self) -> Coefficients:
        return _derivative(self.exponent)


@dataclass(frozen=True)
class Gain:
    """Gain law lam(t) [1/s]: how hard the object's curve is pulled towards rolling.

    Use the constructors `Gain.path`, `Gain.time`, `Gain.guaranteed`. The paper prints the first
    (eq. `contrac`); its reported recovery times are those of the second.

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

    def __post_init__(self) -> None:
        if not isinstance(self.law, str) or self.law not in GAIN_LAWS:
            raise SceneError(
                f"gain: law = {self.law!r} is unknown; use 'path', 'time' or 'guaranteed'"
            )
        value = finite_number(self.value, f"gain: {self.parameter}")
        if value < 0:
            raise SceneError(
                f"gain: {self.parameter} = {value!r} is negative and would feed slip; use 0 or more"
            )
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
        """lam = max(0, sigma'/sigma) + rho: slip decays at least as fast as exp(-rho t) [1/s].

        It is below 5 % after 3/rho, whatever sigma does.
        """
        return cls("guaranteed", rho)

    @property
    def parameter(self) -> str:
        """Name of the number in the law: "eta" or "rho"."""
        return GAIN_LAWS[self.law]

    def rate(self, profile: Profile, t):
        """lam(t) [1/s]; t [s] of any shape.

        The guaranteed law is +inf where sigma = 0: it removes slip at once as a path starts.
        """
        t = _as_time(t)
        sigma: Any = profile(t)
        growth: Any = 0.0
        if self.law == "guaranteed":
            with np.errstate(divide="ignore", invalid="ignore"):
                growth = np.maximum(0.0, np.asarray(profile.rate(t)) / sigma)
            growth = np.where(np.asarray(sigma) > 0, growth, np.inf)[()]
        return law_rate(self.law, self.value, sigma, growth)

    def exponent(self, profile: Profile, t):
        """L(t) = int_0^t lam, closed form; t >= 0 [s] of any shape.

        Growth of the guaranteed law is log(sigma/sigma(start of the growth)), which is +inf after
        a start at sigma = 0.
        """
        t = _as_time(t)
        if self.law == "path":
            return self.value * profile.energy(t)
        total = self.value * t
        if self.law == "guaranteed":
            last = float(np.max(t, initial=0.0))
            for start, stop in profile.growths(0.0, last):
                with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                    first = _clear_value(profile.coefficients, start)
                    ratio = np.divide(profile(np.clip(t, start, stop)), first)
                total = total + np.where(t > start, np.log(np.maximum(ratio, 1.0)), 0.0)
        return total

    def pieces(self, profile: Profile, start: float, stop: float) -> list[GainPiece]:
        """Cut [start, stop] into pieces with one closed form of the decay each.

        path and time have one piece; guaranteed is cut at the extrema of sigma. Everything is
        local to a piece, so that a large gain loses nothing to cancellation.
        """
        return list(_pieces(self, profile, float(start), float(stop)))


def law_rate(law: str, value, sigma, growth):
    """lam of a gain law (theory section 2), of numbers or symbols.

    value is the law's eta or rho; growth, max(0, sigma'/sigma), matters to "guaranteed" only.
    """
    if law == "path":
        return value * sigma**2
    return value + (growth if law == "guaranteed" else 0.0 * sigma)


@lru_cache(maxsize=1024)
def _pieces(gain: Gain, profile: Profile, start: float, stop: float) -> tuple[GainPiece, ...]:
    if gain.law != "guaranteed":
        sigma = profile.shifted(start)
        exponent: Coefficients = (0.0, gain.value)
        if gain.law == "path":
            rates = _rounded(_product((gain.value,), sigma, sigma))
            exponent = integral(rates)
        return (GainPiece(start, stop, sigma, exponent, 0),)
    knots, growths = profile.knots(start, stop), profile.growths(start, stop)
    pieces = []
    for a, b in zip(knots, knots[1:]):
        # where sigma touches zero its rounded first coefficient must not set the ratio's scale
        sigma = (_clear_value(profile.coefficients, a), *profile.shifted(a)[1:])
        pieces.append(GainPiece(a, b, sigma, (0.0, gain.value), int((a, b) in growths)))
    return tuple(pieces)


# --- what a gain law guarantees ----------------------------------------------------------------


@dataclass(frozen=True)
class Contraction:
    """What a gain law does to slip over a horizon (eq. `contracaccel`).

    Attributes
    ----------
    gain : Gain
        The law examined.
    duration : float
        The horizon [s].
    intervals : tuple of (float, float)
        The times between which slip shrinks: sigma'/sigma - lam < 0 [s].
    throughout : bool
        True if slip shrinks over the whole horizon.
    least_eta : float
        The law shrinks slip over the whole horizon for every gain above this one, in the unit of
        `Gain.value`; inf if none does (sigma leaves zero), 0 if every positive one does.
    growth : tuple of (float, float)
        When slip is greatest [s], and how many times its value at t = 0 it then is. (0, nan) if
        sigma(0) = 0, because slip itself then starts at zero.
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
        formula = {
            "path": "lam = eta sigma^2",
            "time": "lam = eta",
            "guaranteed": "lam = max(0, sigma'/sigma) + rho",
        }[self.gain.law]
        text = [f"Gain law '{self.gain.law}', {formula}, {self.gain.parameter} = "]
        text.append(f"{self.gain.value:.6g}: {self._when()}")
        if self.growth[1] > 1:
            text.append(
                f" Slip that is there at t = 0 is greatest at t = {self.growth[0]:.3g} s, "
                f"{self.growth[1]:.3g} times its first value."
            )
        if not math.isnan(self.left):
            text.append(f" At the end slip is {self.left:.2g} times its value at t = 0.")
        return "".join(text) + self._remedy()

    def _when(self) -> str:
        if self.throughout:
            return f"slip shrinks over the whole horizon of {self.duration:g} s."
        if not self.intervals:
            return f"slip never shrinks in the horizon of {self.duration:g} s."
        listed = ", ".join(f"[{a:.3g}, {b:.3g}] s" for a, b in self.intervals)
        return f"slip shrinks only on {listed} of the horizon of {self.duration:g} s."

    def _remedy(self) -> str:
        if self.gain.law == "guaranteed":
            return " Any rho > 0 makes slip shrink throughout, at least as fast as exp(-rho t)."
        if math.isinf(self.least_eta):
            leaves = "starts from zero" if math.isnan(self.left) else "touches zero on the way"
            return (
                f" No finite eta shrinks it throughout: sigma {leaves}, where sigma'/sigma "
                "is unbounded (slip in units of the path speed shrinks all the same). The law "
                "'guaranteed' does."
            )
        return f" This law shrinks it throughout for every eta above {self.least_eta:.3g}."


def contraction(profile: Profile, gain: Gain, duration: float) -> Contraction:
    """Where slip shrinks under a gain law, and the least gain that shrinks it throughout.

    Parameters
    ----------
    profile : Profile
        A path profile that passes `Profile.check`.
    gain : Gain
        The law and its gain.
    duration : float
        The horizon [s].

    Returns
    -------
    Contraction
        Its `str` is one readable paragraph.
    """
    supremum = _least_gain(profile, gain.law, duration)
    throughout = gain.value > supremum
    intervals = ((0.0, duration),) if throughout else _shrinking(profile, gain, duration)
    growth, left = _slip_factors(profile, gain, duration, intervals)
    return Contraction(gain, duration, intervals, throughout, max(0.0, supremum), growth, left)


def _least_gain(profile: Profile, law: str, duration: float) -> float:
    """Supremum over the horizon of sigma'/sigma^3 (path), sigma'/sigma (time)."""
    c, slope = profile.coefficients, profile._rate
    zeros = profile.zeros(duration)
    if law != "guaranteed" and any(t < duration for t in zeros):
        return math.inf
    power = 3 if law == "path" else 1
    # d/dt (sigma' sigma^-power) = 0  <=>  sigma'' sigma - power sigma'^2 = 0
    stationary = _rounded(_product(_derivative(slope), c), _product((-power,), slope, slope))
    times = {0.0, duration, *_sign_changes(stationary, 0.0, duration)} - set(zeros)
    # divided step by step: the cube of a tiny sigma is 0
    steep = (reduce(truediv, [profile(t)] * power, profile.rate(t)) for t in times)
    supremum = max(steep, default=math.inf)
    return min(0.0, supremum) if law == "guaranteed" else supremum


def _shrinking(profile: Profile, gain: Gain, duration: float) -> tuple[tuple[float, float], ...]:
    """Intervals on which sigma' - lam sigma < 0."""
    found: list[tuple[float, float]] = []
    knots = profile.knots(0.0, duration)
    for start, stop in zip(knots, knots[1:]):
        # around its middle, where terms of sigma^3 cancel least
        middle = 0.5 * (start + stop)
        rate = _slip_rate(profile.shifted(middle), gain)
        ends = start - middle, stop - middle
        turns = [middle + tau for tau in _sign_changes(rate, *ends)]
        for a, b in zip([start, *turns], [*turns, stop]):
            if _clear_value(rate, 0.5 * (a + b) - middle) < 0:
                if found and found[-1][1] == a:
                    a = found.pop()[0]
                found.append((a, b))
    return tuple(found)


def _slip_rate(c: Coefficients, gain: Gain) -> Coefficients:
    """Coefficients of sigma' - lam sigma from those of sigma."""
    slope = _derivative(c)
    if gain.law == "guaranteed":  # rho = 0: the law only makes up for growth
        return slope
    power = 3 if gain.law == "path" else 1
    return _rounded(_exact(slope), _product((-gain.value,), *[c] * power))


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
