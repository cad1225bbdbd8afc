"""Goals of contacts, and routes to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..checks import finite_number, finite_numbers, pair, rigid_motion, shaped_array
from ..errors import SceneError
from ..scene import Leg, Scene
from ..theory.profile import Numbers


@dataclass(frozen=True, kw_only=True)
class Goal:
    """The goal of a contact; coordinates that are left out are free.

    Parameters
    ----------
    object_at, finger_at : (float, float), optional
        Chart coordinates (u, v) of the contact on the object and on the finger; a pole is allowed
        if no angle is given.
    angle : float, optional
        psi at the goal [rad]; only with both places.
    pose : (4, 4), optional
        Instead of places and angle: the finger's frame in the object's, a homogeneous matrix, m.
    object_within, finger_within : (float, float, float), optional
        u, v, radius: a region, such as a fingertip's pad. On the whole path the contact stays
        within the radius, a straight-line distance, m, of the point (u, v) of object or finger.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    object_at: Numbers | None = None
    finger_at: Numbers | None = None
    angle: float | None = None
    pose: Any = None
    object_within: Numbers | None = None
    finger_within: Numbers | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for side in ("object", "finger"):
            for key, checked in ((f"{side}_at", pair), (f"{side}_within", _region)):
                if (given := getattr(self, key)) is not None:
                    put(self, key, checked(given, key))
        if self.angle is not None:
            put(self, "angle", finite_number(self.angle, "angle"))
        places = self.object_at is not None, self.finger_at is not None
        if self.pose is not None:
            if any(places) or self.angle is not None:
                raise SceneError("pose: give a pose or places and an angle, not both")
            pose = shaped_array(self.pose, "pose", (4, 4))
            rows = rigid_motion(pose, "pose", 1e-9).tolist()
            put(self, "pose", tuple(map(tuple, rows)))
        elif not any(places):
            raise SceneError("a goal needs a place on a body: object_at, finger_at or a pose")
        elif self.angle is not None and not all(places):
            raise SceneError("angle: it is the angle between two frames; give both places with it")


def _region(given: Any, key: str) -> tuple[float, ...]:
    region = finite_numbers(given, key)
    if len(region) != 3 or not region[2] > 0:
        raise SceneError(f"{key} = {given!r:.80}: give u, v and a radius above 0, m")
    return region


@dataclass(frozen=True)
class Route:
    """Legs that reach a goal.

    Attributes
    ----------
    scene : Scene
        The scene with these legs, for :func:`plan`.
    legs : tuple of tuple of Leg
        The legs of each contact.
    length : float
        Sum of the lengths of all legs, along s, m.
    residual : float
        Greatest error at the goals: of places as a fraction of the bodies' sizes, of angles in rad.
        It is that of a plan of tolerance 1e-14. With the default of 1e-12, a plan of many turns on
        a slim torus was 2.5e-11 of the size off.
    tried : str
        How many legs and random starts the search took to find a first route.
    """

    scene: Scene
    legs: tuple[tuple[Leg, ...], ...]
    length: float
    residual: float
    tried: str
