"""The parts of a scene: contacts, and how the object turns.

Everything a user can get wrong is checked where it is given; messages name the key, the value and
the remedy.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import did_you_mean, finite_number, finite_numbers, is_plain, within
from ..errors import SceneError
from ..surfaces import Surface
from ..theory.profile import Numbers, Profile
from .legs import Leg, Stretch, endless, stretches

Pair = tuple[float, float]

ROLLING = "rolling"
REST = "rest"


def pair(value: Any, what: str, words: Sequence[str] = ()) -> Pair:
    if is_plain(value) and len(value) == 2:
        return value
    if isinstance(value, Iterable) and not isinstance(value, str):
        found = finite_numbers(value, what)
        if len(found) == 2:
            return found
    choice = "".join(f' or "{word}"' for word in words) + did_you_mean(value, words)
    raise SceneError(f"{what} = {value!r}: give two numbers{choice}")


def a_surface(value: Any, what: str) -> Surface:
    if not isinstance(value, Surface):
        raise SceneError(f"{what} = {value!r}: give a surface, such as Sphere(0.04)")
    return value


def a_text(value: Any, what: str) -> str:
    if not isinstance(value, str):
        raise SceneError(f"{what} = {value!r}: give a text in quotes")
    return value


def all_of(kind: type | tuple[type, ...], values: Any, what: str, names: str) -> tuple:
    """The values as a tuple, each of which must be of the kind, which errors call by the names."""
    # the usual kinds first: what an abstract class takes in costs more to find out
    if isinstance(values, (kind, str)) or not isinstance(values, (list, tuple, Iterable)):
        raise SceneError(f"{what} = {values!r}: give a list")
    values = tuple(values)
    for k, value in enumerate(values):
        if not isinstance(value, kind):
            raise SceneError(f"{what}[{k}] = {value!r}: give a {names}")
    return values


MANY_TURNS = 1e3  # [rad]: psi keeps 13 digits of a turn


def rolled(angle: float, w: Any) -> Any:
    """R_psi w, before V is worked out from it and rounding told from slip."""
    c, s = math.cos(angle), math.sin(angle)
    return c * w[0] - s * w[1], -s * w[0] - c * w[1]


def rotated(cosine: Any, sine: Any, w: Pair) -> Any:
    """A path velocity turned by an angle."""
    return cosine * w[0] - sine * w[1], sine * w[0] + cosine * w[1]


@dataclass(frozen=True)
class Contact:
    """One finger on the object, and how their contact starts to move.

    Velocities are path velocities (per metre of s), so sigma may start at zero.

    Parameters
    ----------
    finger : Surface
        The finger (body 1).
    object_at, finger_at : (float, float)
        Chart coordinates (u, v) of the contact on the object and on the finger (rad, or the
        chart's own units). A scene brings them into the chart's regular range: a point with an
        inward frame, such as (-1.57, 2.44) on a sphere, becomes the same point with the frame the
        equations assume, and the velocities are read in that frame. A triaxial ellipsoid's chart
        covers it twice: there velocities, angle and disturbances are turned with the frame.
    angle : float
        psi at t = 0, the contact angle between the two frames [rad].
    finger_velocity : (float, float) or "rolling"
        M1 dq1/ds in the finger's frame E1, no unit: its length times sigma is the speed of the
        contact point on the finger, m/s. "rolling": the finger's curve is not planned
        but follows from rolling imposed on the object's (eq. `corollary`).
    object_velocity : (float, float), "rolling" or "rest"
        M2 dq2/ds in the object's frame E2, no unit. "rolling": no slip at the start;
        "rest": the contact point on the object starts at rest, so the finger slides.
    name : str
        For messages and pictures.
    legs : sequence of Leg
        The path turns at corners: each leg has its own direction, length, time and sigma, and the
        scene's profile is not this contact's. After the last one the contact rests. With one,
        ``finger_velocity`` is where the directions count from, and "rolling" is no choice for it.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    finger: Surface
    object_at: Numbers
    finger_at: Numbers = (math.pi / 2, 0.0)
    angle: float = 0.0
    finger_velocity: Numbers | str = (2**-0.5, 2**-0.5)
    object_velocity: Numbers | str = ROLLING
    name: str = ""
    legs: Sequence[Leg] = ()

    def __post_init__(self) -> None:
        a_text(self.name, "name")
        a_surface(self.finger, "finger")
        put = object.__setattr__
        put(self, "object_at", pair(self.object_at, "object_at"))
        put(self, "finger_at", pair(self.finger_at, "finger_at"))
        put(self, "angle", finite_number(self.angle, "angle"))
        if abs(self.angle) > MANY_TURNS:
            raise SceneError(
                f"angle = {self.angle!r}: beyond {MANY_TURNS:g} rad a double resolves an angle "
                "within its turn too poorly; subtract whole turns"
            )
        for key, words in (("finger_velocity", (ROLLING,)), ("object_velocity", (ROLLING, REST))):
            value = getattr(self, key)
            if not (isinstance(value, str) and value in words):
                put(self, key, pair(value, key, words))
        if self.follows and isinstance(self.object_velocity, str):
            raise SceneError(
                f'finger_velocity = "rolling" lets the finger follow the object\'s curve, which '
                f'object_velocity = "{self.object_velocity}" does not give; '
                "give object_velocity as two numbers"
            )
        if self.legs != ():
            put(self, "legs", all_of(Leg, self.legs, "legs", "Leg"))
        if self.legs and self.follows:
            raise SceneError(
                'finger_velocity = "rolling" has one geodesic of the object to follow, and no '
                "legs; give finger_velocity as two numbers, or leave the legs out"
            )

    def start_numbers(self) -> tuple[float, ...]:
        """The 9 numbers of a :class:`.starts.Start` in their order; words become numbers here."""
        own: Any = self.finger_velocity
        given: Any = self.object_velocity
        if self.legs:
            own = rotated(math.cos(self.legs[0].direction), math.sin(self.legs[0].direction), own)
        if isinstance(own, str):  # imposed: the other is a pair
            own = rolled(self.angle, given)
        elif isinstance(given, str):
            given = rolled(self.angle, own) if given == ROLLING else (0.0, 0.0)
        (u1, v1), (u2, v2) = self.finger_at, self.object_at
        return u1, v1, u2, v2, self.angle, own[0], own[1], given[0], given[1]

    def way(self, profile: Profile, duration: float) -> tuple[Stretch, ...]:
        """sigma leg by leg on a horizon [s]; without legs the profile's."""
        if self.legs:
            return stretches(self.legs, duration)
        return (Stretch(0.0, duration, 0.0, profile),)

    def whole_way(self, profile: Profile, duration: float) -> tuple[Stretch, ...]:
        """The same for ever: after legs that come to a rest there is that."""
        way = self.way(profile, duration)
        return endless(way) if self.legs else way

    @property
    def follows(self) -> bool:
        """True if the finger's curve follows from imposed rolling (the paper's corollary)."""
        return self.finger_velocity == ROLLING


@dataclass(frozen=True)
class Turning:
    """Turning of the object in the world: rotation vector p(t) * axis.

    Parameters
    ----------
    axis : (float, float, float)
        The axis, used as given: its length scales the angle. (1, 1, 1) turns with angular
        velocity p'(t) (1, 1, 1).
    angle : sequence of float
        Coefficients of the polynomial p(t) [rad], lowest power first.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    axis: Numbers
    angle: Numbers

    def __post_init__(self) -> None:
        axis = finite_numbers(self.axis, "axis")
        if len(axis) != 3 or not any(axis):
            raise SceneError(f"axis = {self.axis!r}: give three numbers, not all zero")
        object.__setattr__(self, "axis", axis)
        object.__setattr__(self, "angle", finite_numbers(self.angle, "angle"))
        within("COEFFICIENTS", len(self.angle), "angle: coefficients")

    def rotation_vector(self, t) -> np.ndarray:
        """p(t) axis [rad], shape t.shape + (3,); t [s]."""
        return np.multiply.outer(np.asarray(Profile(self.angle)(t)), self.axis)

    def angular_velocity(self, t) -> np.ndarray:
        """p'(t) axis [rad/s], shape t.shape + (3,); t [s]."""
        return np.multiply.outer(np.asarray(Profile(self.angle).rate(t)), self.axis)
