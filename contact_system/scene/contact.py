"""Contacts, and how the object turns. Arguments are checked when an instance is made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..checks import a_text, all_of, finite_number, finite_numbers, of_kind, pair, within
from ..errors import SceneError
from ..surfaces import Surface
from ..theory.profile import Numbers, Profile
from .legs import Leg

Pair = tuple[float, float]

SIDES = ("finger", "object")
ROLLING = "rolling"
REST = "rest"


def rolled(angle: float, w: Any) -> Any:
    """R_psi w with psi = angle, for two numbers; for symbols see `theory.equations.reflection`."""
    c, s = math.cos(angle), math.sin(angle)
    return c * w[0] - s * w[1], -s * w[0] - c * w[1]


def rotated(cosine: Any, sine: Any, w: Pair) -> Any:
    """A vector of the plane, rotated by an angle with this cosine and sine."""
    return cosine * w[0] - sine * w[1], sine * w[0] + cosine * w[1]


class Start(NamedTuple):
    """How a contact starts, in its contact frames."""

    finger_at: Pair  # u, v
    object_at: Pair
    angle: float  # psi
    finger_velocity: Pair  # M1 dq1/ds in E1
    object_velocity: Pair  # M2 dq2/ds in E2, without object rate offsets


@dataclass(frozen=True)
class Contact:
    """One finger on the object, and the initial state of their contact.

    Velocities are per metre of path length s, not per second, so sigma may start at zero.

    Parameters
    ----------
    finger : Surface
        The finger (body 1).
    object_at : (float, float)
        Chart coordinates (u, v) of the contact on the object (rad, or the chart's own units;
        ``math.radians(120)`` for 120 degrees). A scene moves them into the chart's regular range
        and removes whole turns. On a sphere (-1.57, 2.44), where f_u x f_v points inward, becomes
        the coordinates of the same point at which it points outward, and velocities are taken in
        the frame there. The chart of a triaxial ellipsoid covers it twice: if the other pair of
        coordinates is taken, velocities, angle and disturbances are turned with the frame.
    finger_at : (float, float)
        The same on the finger.
    angle : float
        psi at t = 0, the angle between the two contact frames (theory section 2) [rad].
    finger_velocity : (float, float) or "rolling"
        M1 dq1/ds in the finger's frame E1, dimensionless: its length times sigma is the speed of
        the contact point on the finger, m/s. "rolling": rolling is imposed, and the finger's curve
        follows from the object's (eq. `corollary`).
    object_velocity : (float, float) or "rolling" or "rest"
        M2 dq2/ds in the object's frame E2, dimensionless. "rolling": no slip at the start;
        "rest": the contact point on the object starts at rest, so the finger slides.
    name : str
        For messages and pictures.
    legs : sequence of Leg
        A path with corners. Each leg has its own direction, length, duration and sigma, which
        replaces the scene's profile; after the last leg the contact rests. Directions are measured
        from ``finger_velocity``, which must then be two numbers.

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
        of_kind(Surface, self.finger, "finger", "a surface, such as Sphere(0.04)")
        put = object.__setattr__
        put(self, "object_at", pair(self.object_at, "object_at"))
        put(self, "finger_at", pair(self.finger_at, "finger_at"))
        put(self, "angle", finite_number(self.angle, "angle"))
        for key, words in (("finger_velocity", (ROLLING,)), ("object_velocity", (ROLLING, REST))):
            value = getattr(self, key)
            if not (isinstance(value, str) and value in words):
                put(self, key, pair(value, key, words))
        if self.follows and isinstance(self.object_velocity, str):
            raise SceneError(
                'finger_velocity = "rolling" makes the finger follow the object\'s curve, which '
                f'object_velocity = "{self.object_velocity}" does not determine; '
                "give object_velocity as two numbers"
            )
        put(self, "legs", all_of(Leg, self.legs, "legs", "Leg"))
        if self.legs and self.follows:
            raise SceneError(
                'finger_velocity = "rolling" follows one geodesic of the object and takes no '
                "legs; give finger_velocity as two numbers, or leave the legs out"
            )

    def start(self) -> Start:
        """The start, with the words "rolling" and "rest" replaced by numbers."""
        w1: Any = self.finger_velocity
        w2: Any = self.object_velocity
        if self.legs:
            w1 = rotated(math.cos(self.legs[0].direction), math.sin(self.legs[0].direction), w1)
        if w1 == ROLLING:
            w1 = rolled(self.angle, w2)
        elif w2 == ROLLING:
            w2 = rolled(self.angle, w1)
        elif w2 == REST:
            w2 = (0.0, 0.0)
        return Start(self.finger_at, self.object_at, self.angle, w1, w2)  # type: ignore[arg-type]

    @property
    def follows(self) -> bool:
        """True if the finger's curve follows from imposed rolling (the paper's corollary)."""
        return self.finger_velocity == ROLLING


@dataclass(frozen=True)
class Turning:
    """Rotation of the object in the world: rotation vector p(t) * axis.

    Parameters
    ----------
    axis : (float, float, float)
        Not normalised: its length scales the angle. (1, 1, 1) has the angular velocity
        p'(t) (1, 1, 1).
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

    def rotation_vector(self, t: ArrayLike) -> np.ndarray:
        """p(t) axis [rad], shape t.shape + (3,); t [s]."""
        return np.multiply.outer(Profile(self.angle)(t), self.axis)

    def angular_velocity(self, t: ArrayLike) -> np.ndarray:
        """p'(t) axis [rad/s], shape t.shape + (3,); t [s]."""
        return np.multiply.outer(Profile(self.angle).rate(t), self.axis)
