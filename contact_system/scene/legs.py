"""Legs: a contact's path that turns at corners (theory section 11)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..checks import finite_number, naming, of_kind
from ..errors import SceneError
from ..theory.profile import Profile, as_time, clear_value, polynomial

STILL = Profile([0.0])
STRAIGHT = (1.0, 0.0)
_LONGEST = 1e15  # s
_JUMP = 1e-9  # of the greatest sigma: rounding difference allowed between legs that meet


@dataclass(frozen=True)
class Leg:
    """One leg of a contact's path: a geodesic on both bodies while nothing disturbs it.

    Legs follow each other from t = 0 on. At a corner only the path's direction changes; parallel
    frames, psi and slip are continuous. So the contact must be at rest there.

    Parameters
    ----------
    direction : float
        Angle of the path from the contact's ``finger_velocity``, in the finger's parallel frame
        (theory section 4), rad. Two legs with the same direction meet without a corner.
    length : float
        Length along s, m; the curve on the finger is |finger_velocity| times as long. 0: the
        contact rests. None, as an argument: the length follows from the profile.
    duration : float
        s.
    profile : Profile, optional
        sigma as a function of the time t since the leg's start. Default: minimum jerk, from rest
        to rest, s = length (10 x^3 - 15 x^4 + 6 x^5) with x = t/duration.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    direction: float
    length: Any  # arguments may be None, values never are
    duration: float
    profile: Any = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "direction", finite_number(self.direction, "direction"))
        put(self, "duration", finite_number(self.duration, "duration", "above 0"))
        if not 1 / _LONGEST <= self.duration <= _LONGEST:  # so that its fifth power is a double
            raise SceneError(
                f"duration = {self.duration!r} s: give {1 / _LONGEST:g} to {_LONGEST:g} s"
            )
        if self.length is not None:
            put(self, "length", finite_number(self.length, "length", "not below 0"))
        if self.profile is None:
            if self.length is None:
                raise SceneError("length = None: give a length, or a profile")
            speed = self.length / self.duration
            rates = [30 * speed * c / self.duration**k for k, c in ((2, 1), (3, -2), (4, 1))]
            put(self, "profile", Profile([0.0, 0.0, *rates]) if self.length > 0 else STILL)
            return
        of_kind(Profile, self.profile, "profile", "a Profile")
        if any(self.profile.coefficients):
            self.profile.check(self.duration)
        else:
            put(self, "profile", STILL)
        arc = float(self.profile.arc_length(self.duration))
        if self.length is None:
            put(self, "length", arc)
        elif not math.isclose(arc, self.length, rel_tol=_JUMP):
            raise SceneError(
                f"length = {self.length!r}: the profile has the length {arc!r} m in "
                f"{self.duration:g} s; leave one of the two out, as None"
            )


class Stretch(NamedTuple):
    """The interval of a leg within the horizon, or that of the rest after the last leg."""

    start: float  # s
    stop: float
    profile: Profile  # sigma as a function of the time since the start
    turn: tuple[float, float] = STRAIGHT  # cosine and sine of the path's turn at the start


def stretches(legs: Sequence[Leg], duration: float) -> tuple[Stretch, ...]:
    """The intervals of legs on a horizon [s], and of the rest after them unless they end moving."""
    result, start, before = [], 0.0, legs[0].direction
    for leg in legs:
        stop = start + leg.duration
        if not stop < duration * (1 - 1e-14):
            stop = duration
        angle = leg.direction - before
        turn = math.cos(angle), math.sin(angle)
        result.append(Stretch(start, stop, leg.profile, turn))
        start, before = stop, leg.direction
    if start < duration or not _ends(result[-1])[1]:  # even of 0 s, for times after the horizon
        result.append(Stretch(start, duration, STILL))
    return tuple(result)


def speed(way: Sequence[Stretch], t: Any) -> Any:
    """sigma at times [s], m/s."""
    t = as_time(t)
    sigma = way[0].profile(t)
    for stretch in way[1:]:
        sigma = np.where(t >= stretch.start, stretch.profile(t - stretch.start), sigma)
    return sigma


def length(way: Sequence[Stretch], t: float) -> float:
    """Length of the path until time t [s], m; the last stretch continues beyond its stop."""
    ends = [*(stretch.stop for stretch in way[:-1]), math.inf]
    spans = [(s.profile, min(t, end) - s.start) for s, end in zip(way, ends) if s.start < t]
    return math.fsum(float(profile.arc_length(span)) for profile, span in spans)


def check_legs(legs: Sequence[Leg], duration: float) -> None:
    """Refuse legs that do not fit a horizon, or turn where the contact does not rest."""
    whole = math.fsum(leg.duration for leg in legs)
    if whole > duration * (1 + 1e-14):
        raise SceneError(
            f"legs take {whole:.9g} s and the scene {duration:.9g} s; lengthen the scene"
        )
    way = stretches(legs, duration)
    for k, (leg, following) in enumerate(zip(way, way[1:])):
        ends = _ends(leg)[1], _ends(following)[0]
        with naming(f"legs[{k}]"):
            if any(ends) and following.turn != STRAIGHT:
                raise SceneError(
                    f"sigma = {max(ends):.6g} m/s at t = {leg.stop:.9g} s, where the path turns; "
                    "let sigma end and begin at 0 there, as without a profile"
                )
            if abs(ends[0] - ends[1]) > _JUMP * max(ends):
                raise SceneError(
                    f"sigma jumps from {ends[0]:.6g} to {ends[1]:.6g} m/s at t = {leg.stop:.9g} s; "
                    "let the legs meet at one speed, and the last one end at rest"
                )


def _ends(stretch: Stretch) -> tuple[float, float]:
    """sigma at the start and the end of the stretch, m/s; 0 where it may be rounding."""
    span, c = stretch.stop - stretch.start, stretch.profile.coefficients
    first, last = clear_value(c, 0.0), clear_value(c, span)
    if last and not abs(last) > _JUMP * polynomial([*map(abs, c)], span):
        last = 0.0
    return first, last
