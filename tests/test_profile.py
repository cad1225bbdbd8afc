"""Path profile, gain laws and contraction against mpmath, values on grids, the paper's numbers."""

import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest

import contact_system as cs
from contact_system import Gain, Profile, SceneError

SLOW = Profile([0.001, 0, 0.4])  # K1-K3, D3
MEDIUM = Profile([0.1, 0.2, -0.02])  # K4
FAST = Profile([1, 0.2, -0.02])  # D1, D2
WAVY = Profile([0.5, 1.0, -1.2, 0.35])  # grows, falls and grows again on [0, 2]
GAINS = [Gain.path(100), Gain.time(30), Gain.guaranteed(5)]


def contraction(profile: Profile, gain: Gain, duration: float) -> cs.Contraction:
    """The contraction report of a scene with this profile and gain."""
    contact = cs.Contact(finger=cs.Sphere(0.04), object_at=(0.0, 0.0))
    motion = {"profile": profile, "gain": gain, "duration": duration}
    return cs.Scene(object=cs.Plane(), contacts=[contact], **motion).contraction()


def slip_factor(profile: Profile, gain: Gain, start: float, stop: float) -> float:
    """Slip at stop over slip at start, by mpmath's quadrature of the gain's rate."""
    kinks = np.polynomial.Polynomial(profile.coefficients).deriv().roots()
    knots = [start, *sorted(t.real for t in kinks if start < t.real < stop), stop]
    with mpmath.workdps(30):
        exponent = mpmath.quad(lambda t: gain.rate(profile, float(t)), knots)
    return float(profile(stop) / profile(start) * mpmath.exp(-exponent))


# --- profile -----------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", [SLOW, MEDIUM, FAST, WAVY])
def test_arc_length_and_exponent_are_the_integrals_of_sigma_and_of_the_rate(profile):
    def sigma(t):
        return sum(c * t**k for k, c in enumerate(profile.coefficients))

    for t in (0.3, 1.7):
        with mpmath.workdps(30):
            length = mpmath.quad(sigma, [0, t])
            energy = mpmath.quad(lambda x: sigma(x) ** 2, [0, t])
        assert profile.arc_length(t) == pytest.approx(float(length), rel=4e-16)
        assert Gain.path(1).exponent(profile, t) == pytest.approx(float(energy), rel=4e-16)
        for gain in GAINS:
            left = profile(t) / profile(0) * math.exp(-gain.exponent(profile, t))
            assert left == pytest.approx(slip_factor(profile, gain, 0, t), rel=1e-10)


def test_a_profile_takes_times_of_any_shape():
    t = np.linspace(0, 1, 6).reshape(2, 3)
    for method in (SLOW, SLOW.rate, SLOW.arc_length):
        assert method(t).shape == (2, 3)
        assert method(t)[1, 2] == method(1.0)
        assert isinstance(method(1), float)
    for gain in GAINS:
        assert gain.rate(SLOW, t).shape == gain.exponent(SLOW, t).shape == (2, 3)
        assert gain.exponent(SLOW, t)[1, 2] == pytest.approx(gain.exponent(SLOW, 1), rel=1e-15)


def test_extrema_are_the_sign_changes_of_the_rate():
    rate = np.polynomial.Polynomial.fromroots([0.25, 0.5, 0.5, 1.5])
    profile = Profile(rate.integ().coef)
    assert profile.extrema(0, 1) == pytest.approx((0.25,), abs=1e-12)
    assert profile.extrema(0, 2) == pytest.approx((0.25, 1.5), abs=1e-12)
    assert Profile([1, 2]).extrema(0, 1) == ()
    # 0.09 - 0.6 t + t^2 = (t - 0.3)^2 up to rounding
    assert Profile([1, 0.09, -0.3, 1 / 3]).extrema(0, 1) == ()


def test_times_that_are_not_numbers_are_refused_by_name():
    for t in ("now", ["1.0"], 1j, [True], [[1.0], [2.0, 3.0]], None):
        with pytest.raises(SceneError, match=r"profile at t = .*: give times in seconds"):
            SLOW(t)
    for t in ("1", None, math.nan, [1.0]):
        for check, name in ((WAVY.check, "duration"), (lambda t: WAVY.extrema(0, t), "t1")):
            with pytest.raises(SceneError, match=f"{name} = .*: give a finite number"):
                check(t)


CANCELLING = np.polynomial.polynomial.polypow([0, 1, -1], 10)  # (t - t^2)^10


@pytest.mark.parametrize(
    "coefficients, words",
    [
        ([0.1, -0.2], ["-0.1 m/s", "t = 1 s", "before t = 0.5 s"]),
        ([0.0899, -0.6, 1], ["t = 0.3 s", "-0.0001 m/s", "before t = 0.29"]),
        ([-0.1], ["-0.1 m/s", "t = 0 s", "sigma >= 0"]),
        ([0, -1], ["t = 1 s", "sigma >= 0"]),
        ([-1e-12, 0, 1], ["t = 0 s", "-1e-12"]),
        ([0, 0], ["zero for all t", "at least one coefficient"]),
        ([1e99, 1e99], ["too large"]),
        (CANCELLING, ["9.54e-07 m/s", "1.02e+03 m/s", "lower degree"]),
    ],
)
def test_a_negative_or_zero_profile_is_refused_with_time_value_and_remedy(coefficients, words):
    with pytest.raises(SceneError) as error:
        Profile(coefficients).check(1.0 if max(coefficients) < 1e9 else 1e3)
    for word in words:
        assert word in str(error.value)


def test_profile_coefficients_must_be_finite_numbers():
    for bad in ([], [math.nan], [1, math.inf], 0.1, "0.1", ["0.1"], [True], [1e200], [None]):
        with pytest.raises(SceneError, match="profile"):
            Profile(bad)


# --- gain laws ---------------------------------------------------------------------------------


def test_the_guaranteed_law_ends_slip_at_once_where_sigma_starts_from_zero():
    start = Profile([0, 1])
    assert Gain.guaranteed(1).rate(start, 0.0) == math.inf
    assert Gain.guaranteed(1).exponent(start, np.array([0, 1e-9])).tolist() == [0, math.inf]
    touching = Profile([0.09, -0.6, 1])  # (t - 0.3)^2 up to rounding
    assert math.isfinite(Gain.guaranteed(1).exponent(touching, 0.3))
    assert Gain.guaranteed(1).exponent(touching, 0.4) == math.inf


@pytest.mark.parametrize("value", [-1, math.nan, math.inf, "100", True, None])
def test_gains_must_be_finite_and_not_negative(value):
    for law in (Gain.path, Gain.time, Gain.guaranteed):
        with pytest.raises(SceneError, match=rf"gain: (eta|rho) = {value!r}"):
            law(value)


# --- contraction -------------------------------------------------------------------------------


def test_the_printed_gain_lets_slip_grow_and_a_constant_one_gives_the_reported_times():
    """The third erratum: 1.64 and 1.77 with eta sigma^2, 3.0 % and 3.2 % with eta."""
    assert slip_factor(SLOW, Gain.path(100), 0, 0.04) == pytest.approx(1.64, abs=0.005)
    assert slip_factor(SLOW, Gain.path(100), 0.1, 0.14) == pytest.approx(1.77, abs=0.005)
    assert slip_factor(SLOW, Gain.time(100), 0, 0.04) == pytest.approx(0.030, abs=5e-4)
    assert slip_factor(SLOW, Gain.time(100), 0.1, 0.14) == pytest.approx(0.032, abs=6e-4)


@pytest.mark.parametrize("law", [Gain.path, Gain.time])
@pytest.mark.parametrize("profile", [SLOW, MEDIUM, FAST, WAVY])
def test_the_contraction_report_agrees_with_values_on_a_grid(law, profile):
    t, power = np.linspace(0, 2, 4001), 3 if law == Gain.path else 1
    least = contraction(profile, law(1), 2).least_eta
    assert least == pytest.approx(np.max(profile.rate(t) / profile(t) ** power), rel=1e-4)
    assert contraction(profile, law(least * (1 + 1e-9)), 2).throughout
    gain = law(0.5 * least)
    report = contraction(profile, gain, 2)
    assert not report.throughout
    logarithm = np.log(profile(t) / profile(0)) - gain.exponent(profile, t)
    factors = np.exp(logarithm)
    middle = 0.5 * (t[1:] + t[:-1])[1:-1]
    listed = np.any([(a < middle) & (middle < b) for a, b in report.intervals] or [t < 0], axis=0)
    near = [np.abs(middle - edge) < 1e-3 for edge in np.ravel(report.intervals)]
    assert (listed == (np.diff(logarithm)[1:-1] < 0))[~np.any(near, axis=0)].all()
    assert report.growth[1] == pytest.approx(factors.max(), rel=1e-5)
    assert report.growth[0] == pytest.approx(t[factors.argmax()], abs=1e-3)
    assert report.left == pytest.approx(slip_factor(profile, gain, 0, 2), rel=1e-6)


TERMS = (3005.140316123623, -1740.44932927908, 376.8862626368542, -36.174215599025, 1.29901991098)


def test_intervals_of_contraction_are_exact_where_terms_of_sigma_cancel():
    # slip contracts where sigma' < eta sigma^3, here judged by rational numbers
    intervals = contraction(Profile(TERMS), Gain.path(1.0), 7.9).intervals
    for t in map(Fraction, np.linspace(0.01, 7.89, 400).tolist()):
        sigma = sum(Fraction(x) * t**k for k, x in enumerate(TERMS))
        rate = sum(k * Fraction(x) * t ** (k - 1) for k, x in enumerate(TERMS) if k)
        if abs(rate - sigma**3) > 1e-3 * (abs(rate) + sigma**3) and sigma > 1e-6:
            assert any(a <= t <= b for a, b in intervals) == (rate < sigma**3), float(t)


@pytest.mark.parametrize("law", [Gain.path, Gain.time])
@pytest.mark.parametrize("c", [[0, 1], [0, 0, 0, 1], [0, 0, 1, -2, 1], [0.09, -0.6, 1]])
def test_no_finite_gain_contracts_throughout_where_sigma_rises_from_zero(law, c):
    report = contraction(Profile(c), law(1e6), 1)
    assert report.least_eta == math.inf
    assert not report.throughout
    assert ("starts from zero" if c[0] == 0 else "touches zero on the way") in str(report)
    if not any(c[:-1]):  # sigma = t^n: slip shrinks from n/t = lam on
        n = len(c) - 1
        begins = (n / 1e6) ** (1 / (2 * n + 1) if law == Gain.path else 1)
        assert report.intervals == (pytest.approx((begins, 1), rel=1e-12),)


def test_slip_contracts_throughout_only_if_the_gain_exceeds_the_least_one():
    falling = contraction(Profile([1, -0.5]), Gain.path(0), 1)
    assert (falling.throughout, falling.least_eta) == (True, 0)
    assert not contraction(Profile([1]), Gain.time(0), 1).throughout
    assert contraction(Profile([1]), Gain.time(1e-9), 1).throughout
    stopping = contraction(Profile([1, -1]), Gain.time(1), 1)
    assert (stopping.throughout, stopping.left) == (True, 0)
    assert contraction(WAVY, Gain.guaranteed(1e-9), 2).throughout
    resting = contraction(WAVY, Gain.guaranteed(0), 2)
    assert (resting.throughout, resting.least_eta) == (False, 0)
    turns = sorted(np.polynomial.Polynomial(WAVY.coefficients).deriv().roots())
    assert np.ravel(resting.intervals) == pytest.approx(turns, rel=1e-12)


def test_the_contraction_report_as_text_tells_law_intervals_growth_and_least_gain():
    text = str(contraction(SLOW, Gain.path(100), 1))
    for word in ("'path'", "eta sigma^2", "100", "[0.657, 1] s", "116 times", "1.04e+07"):
        assert word in text
    assert "whole horizon of 4 s" in str(contraction(FAST, Gain.path(100), 4))
    assert "exp(-rho t)" in str(contraction(SLOW, Gain.guaranteed(5), 1))
