"""Legs: a contact's path that turns at corners (theory section 11)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..checks import finite_number, naming
from ..errors import SceneError
from ..theory.profile import Profile, clear_value, polynomial

STILL = Profile([0.0])
_LONGEST = 1e15  # s
_JUMP = 1e-9  # of the greatest sigma: what speeds beside a joint may differ by, from rounding


@dataclass(frozen=True)
class Leg:
    """One leg of a contact's path: a geodesic on both bodies while nothing disturbs it.

    Legs follow each other from t = 0 on. The frames that are carried along, psi and slip go on
    from one to the next; only the path's direction turns. So the contact must rest at a corner.

    Parameters
    ----------
    direction : float
        Angle of the path from the contact's ``finger_velocity``, in the finger's frame that is
        carried along (theory section 4), rad. The same angle is no turn, however the path bends.
    length : float or None
        Length of the path s, m: on the finger, times the length of ``finger_velocity``. 0: a rest.
        None: that of the profile.
    duration : float
        s.
    profile : Profile, optional
        sigma over the leg's own time, from 0 on; by default from rest to rest,
        s = length (10 x^3 - 15 x^4 + 6 x^5) with x = t/duration.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    direction: float
    length: float | None
    duration: float
    profile: Profile | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "direction", finite_number(self.direction, "direction"))
        put(self, "duration", finite_number(self.duration, "duration", "above 0"))
        if not 1 / _LONGEST <= self.duration <= _LONGEST:  # its fifth power is a number, too
            raise SceneError(
                f"duration = {self.duration!r} s: give {1 / _LONGEST:g} to {_LONGEST:g} s"
            )
        if self.length is not None:
            put(self, "length", finite_number(self.length, "length", "not below 0"))
        if self.profile is None:
            if self.length is None:
                raise SceneError("length = None: give a length, or a profile")
            put(self, "profile", rest_to_rest(self.length, self.duration))
            return
        if not isinstance(self.profile, Profile):
            raise SceneError(f"profile = {self.profile!r}: give a Profile")
        if any(self.profile.coefficients):
            self.profile.check(self.duration)
        own = float(self.profile.arc_length(self.duration))
        if self.length is not None and not math.isclose(own, self.length, rel_tol=_JUMP):
            raise SceneError(
                f"length = {self.length!r}: the profile takes the path {own!r} m far in "
                f"{self.duration:g} s; leave one of the two out"
            )
        put(self, "length", own)


def rest_to_rest(length: float, duration: float) -> Profile:
    """The profile of least jerk from rest to rest, of a length [m] in a time [s]."""
    speed = length / duration
    rates = [30 * speed * c / duration**k for k, c in ((2, 1), (3, -2), (4, 1))]
    if not length > 0:
        return STILL
    return Profile([0.0, 0.0, *rates])


class Stretch(NamedTuple):
    """A leg on the horizon.

    Attributes
    ----------
    start, stop : float, s
    direction : float, rad
    profile : Profile
    turn : cosine and sine of the angle by which the path turns where it begins
    """

    start: float
    stop: float
    direction: float
    profile: Profile
    turn: tuple[float, float] = (1.0, 0.0)


def stretches(legs: Sequence[Leg], duration: float) -> tuple[Stretch, ...]:
    """Legs one after the other on a horizon [s], and the rest until its end."""
    found, start, before = [], 0.0, legs[0].direction
    for leg in legs:
        assert leg.profile is not None
        stop = start + leg.duration
        if not stop < duration * (1 - 1e-14):
            stop = duration
        angle = leg.direction - before
        turn = math.cos(angle), math.sin(angle)
        found.append(Stretch(start, stop, leg.direction, leg.profile, turn))
        start, before = stop, leg.direction
    if start < duration:
        found.append(Stretch(start, duration, legs[-1].direction, STILL))
    return tuple(found)


def endless(way: tuple[Stretch, ...]) -> tuple[Stretch, ...]:
    """A way, and where it comes to a rest at its end, that rest."""
    last = way[-1]
    if last.profile == STILL or _ends(last)[1]:
        return way
    return (*way, Stretch(last.stop, math.inf, last.direction, STILL))


def speed(way: Sequence[Stretch], t: np.ndarray) -> np.ndarray:
    """sigma at times [s], m/s."""
    t = np.asarray(t, dtype=float)
    found = way[0].profile(t)
    for stretch in way[1:]:
        found = np.where(t >= stretch.start, stretch.profile(t - stretch.start), found)
    return found


def length(way: Sequence[Stretch], t: float) -> float:
    """How far the path has come at time t [s], m; the last stretch goes on for ever."""
    ends = [*(stretch.stop for stretch in way[:-1]), math.inf]
    spans = [(s.profile, min(t, end) - s.start) for s, end in zip(way, ends) if s.start < t]
    return math.fsum(float(profile.arc_length(span)) for profile, span in spans)


def check_legs(legs: Sequence[Leg], duration: float) -> None:
    """Check that legs fit a horizon, and that the contact rests wherever its path turns.

    Raises
    ------
    SceneError
        Naming the leg, the value and the remedy.
    """
    whole = math.fsum(leg.duration for leg in legs)
    if whole > duration * (1 + 1e-14):
        raise SceneError(
            f"legs take {whole:.9g} s and the scene {duration:.9g} s; lengthen the scene"
        )
    way = stretches(legs, duration)
    for k, (one, other) in enumerate(zip(way, way[1:])):
        ends = _ends(one)[1], _ends(other)[0]
        with naming(f"legs[{k}]"):
            if any(ends) and one.direction != other.direction:
                raise SceneError(
                    f"sigma = {max(ends):.6g} m/s at t = {one.stop:.9g} s, where the path turns; "
                    "let sigma end and begin at 0 there, as without a profile"
                )
            if abs(ends[0] - ends[1]) > _JUMP * max(ends):
                raise SceneError(
                    f"sigma jumps from {ends[0]:.6g} to {ends[1]:.6g} m/s at t = {one.stop:.9g} s; "
                    "let the legs meet at one speed, and the last one end at rest"
                )


def _ends(stretch: Stretch) -> tuple[float, float]:
    """sigma where the stretch begins and ends, 0 where it cannot be told from rounding."""
    span, c = stretch.stop - stretch.start, stretch.profile.coefficients
    first, last = clear_value(c, 0.0), clear_value(c, span)
    if last and not abs(last) > _JUMP * polynomial([*map(abs, c)], span):
        last = 0.0
    return first, last
