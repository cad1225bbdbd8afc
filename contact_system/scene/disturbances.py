"""Disturbances of contacts: one class for each kind.

Each kind adds to one of the inputs of a contact, its slot (engine/rates.c reads them).
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass
from typing import ClassVar

from ..checks import finite_number, pair
from ..errors import SceneError
from ..theory.profile import Numbers

ALL = "all"
SLOTS = (("finger", True), ("object", True), ("object", False))
"""The inputs by which disturbances act on a contact, two chart components each, in the order of
systems and FMUs: the body in whose chart they are, and whether they accelerate it or add to its
rate."""


@dataclass(frozen=True)
class Disturbance:
    """A disturbance of one contact in the window [start, stop].

    Values of overlapping windows add.

    Parameters
    ----------
    contact : int or "all"
        Index of the contact, from 0; a scene expands "all" to one disturbance for each contact.
    start, stop : float
        The window [s], inside the scene's horizon.
    value : (float, float)
        Chart components.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    kind: ClassVar[str]
    """The name in scene files."""
    slot: ClassVar[int]
    """Index in `SLOTS`."""
    side: ClassVar[str]
    accelerates: ClassVar[bool]

    contact: int | str
    start: float
    stop: float
    value: Numbers

    def __init_subclass__(cls) -> None:
        cls.side, cls.accelerates = SLOTS[cls.slot]

    def __post_init__(self) -> None:
        put, contact = object.__setattr__, self.contact
        if not (isinstance(contact, str) and contact == ALL):
            if isinstance(contact, bool) or not isinstance(contact, numbers.Integral):
                raise SceneError(f'contact = {contact!r}: give an index from 0, or "all"')
            put(self, "contact", int(contact))
        put(self, "start", finite_number(self.start, "start"))
        put(self, "stop", finite_number(self.stop, "stop"))
        put(self, "value", pair(self.value, "value"))
        if not self.start < self.stop:
            raise SceneError(
                f"start = {self.start}, stop = {self.stop}: a window must stop after it "
                "starts; exchange them or make it longer"
            )


class FingerAcceleration(Disturbance):
    """Adds `value` = (du, dv) to the finger's (u1", v1") [rad/s^2, or the chart's units]."""

    kind: ClassVar[str] = "finger acceleration"
    slot: ClassVar[int] = 0


class ObjectAcceleration(Disturbance):
    """Adds `value` = (du, dv) to the object's (u2", v2") [rad/s^2, or the chart's units]."""

    kind: ClassVar[str] = "object acceleration"
    slot: ClassVar[int] = 1


class ObjectRateOffset(Disturbance):
    """Adds `value` = (du, dv) to the object's (u2', v2') [rad/s, or the chart's units].

    It moves the contact point and is part of the twist, but not of the feedback (the paper's
    dynamic examples).
    """

    kind: ClassVar[str] = "object rate offset"
    slot: ClassVar[int] = 2


DISTURBANCE_KINDS: list[type[Disturbance]] = [
    FingerAcceleration,
    ObjectAcceleration,
    ObjectRateOffset,
]
"""All kinds, in the order of `SLOTS`."""
