"""Base class of systems that tell how contacts move: their ports, events and outputs."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform_, RotationMatrix_

from contact_system import SceneSystem
from contact_system.checks import Array

from .lifetimes import NO_DICTIONARY, weakly

EARLY = 1e-9
"""How long before their time restarts and pushes happen, s: rounding may make a step late."""
FOREVER = 1e9
"""Longer than any simulation, s: the period of an event that happens once."""
PORTS = {
    "state": 9,
    "slip": 2,
    "twist": 6,
    "acceleration": 6,
    "contact_point": 6,
    "normal": 3,
    "normal_rate": 3,
}
"""Vector ports, and how many numbers they have for each contact."""
MOTION = {"pose": 12} | {name: PORTS[name] for name in PORTS if name not in ("state", "slip")}
"""The parts of a contact's row on the port `motion`, which a FingertipDriver reads."""


# A SceneSystem is large: planners of the same scene share it.
scene_system = functools.lru_cache(maxsize=16)(SceneSystem)


_System: Any = object  # each subclass also derives from LeafSystem_[T]


class PlannerBase(_System):
    """Ports, events and outputs of a system that tells how contacts move, for any scalar T.

    Attributes
    ----------
    system : SceneSystem
    """

    __slots__ = NO_DICTIONARY

    T: type = float

    def _DeclareOutputs(self, system: SceneSystem) -> None:
        self.system, n = system, len(system.scene.contacts)
        # These events do nothing, but integrators end a step at each: so no step crosses an edge.
        for edge in system.edges:
            for time in (max(0.0, math.nextafter(edge, -math.inf)), edge):
                self.DeclarePeriodicPublishEvent(FOREVER, time, lambda context: None)
        for name, size in (PORTS | {"motion": sum(MOTION.values())}).items():
            outputs = tuple(MOTION) if name == "motion" else (name,)
            calc = weakly(self._CalcVector, outputs)
            self.DeclareVectorOutputPort(name, size * n, calc, self._Prerequisites(*outputs))
        kind, calc = Value[list[RigidTransform_[self.T]]], weakly(self._CalcPose)
        self.DeclareAbstractOutputPort("pose", kind, calc, self._Prerequisites("pose"))

    def _Prerequisites(self, *outputs: str) -> set:
        """Tickets of what outputs depend on."""
        return {self.time_ticket()}

    def Evaluate(self, context: Any, *outputs: str) -> Array:
        """The ports of these names now, side by side, a row per contact; "pose" as 12 numbers."""
        n = len(self.system.scene.contacts)
        return np.concatenate(
            [part.reshape(n, -1) for part in self._Parts(context, *outputs)], axis=1
        )

    def _Parts(self, context: Any, *outputs: str) -> list[Array]:
        """The named outputs, each an array of all contacts' numbers."""
        raise NotImplementedError

    def _CalcVector(self, outputs: tuple[str, ...], context: Any, vector: Any) -> None:
        vector.SetFromVector(self.Evaluate(context, *outputs).ravel())

    def _CalcPose(self, context: Any, value: Any) -> None:
        Transform, Rotation = RigidTransform_[self.T], RotationMatrix_[self.T]
        rows = self.Evaluate(context, "pose")
        value.set_value([Transform(Rotation(r[:9].reshape(3, 3).T), r[9:]) for r in rows])
