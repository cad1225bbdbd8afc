"""Base class of systems that tell how contacts move: their ports, events and outputs."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform_, RotationMatrix_
from pydrake.systems.framework import BasicVector_

from contact_system import SceneSystem
from contact_system.checks import Array

from .lifetimes import NO_DICTIONARY, weakly
from .scalars import select

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
    _held: Any = None  # None: this planner has no such state or port
    _disturbance: Any = None
    _measured: Any = None
    _restarts: Any = None

    def _Declare(self, system: SceneSystem, x0: Array | None, period: float | None) -> None:
        """Declare states, from x0 (None: none), ports and events; period: of restarts, s."""
        self.system, self._period, self._fed_through = system, period, {"derivatives"}
        n = len(system.scene.contacts)
        if x0 is not None:
            self.DeclareContinuousState(BasicVector_[self.T](x0))
        # These events do nothing, but integrators end a step at each: so no step crosses an edge.
        for edge in system.edges:
            for time in (max(0.0, math.nextafter(edge, -math.inf)), edge):
                self.DeclarePeriodicPublishEvent(FOREVER, time, lambda context: None)
        corners = system.corners if x0 is not None else ()
        if len(system.held0) and (corners or period is not None):
            self._held = self.DeclareDiscreteState(BasicVector_[self.T](system.held0))
        for edge in corners:
            self.DeclarePeriodicUnrestrictedUpdateEvent(FOREVER, edge, weakly(self._Turn, edge))
        if system.disturbance_input:
            self._disturbance = self.DeclareVectorInputPort("disturbance", 6 * n)
            self._fed_through |= {name for name in PORTS if "w" in system.depends(name)}
        if period is not None:
            self._measured = self.DeclareVectorInputPort("measured_state", 9 * n)
            self._restarts = self.DeclareDiscreteState(BasicVector_[self.T](np.zeros(n)))
            # A little early: in floating point 3 * 0.1 s is after 300 * 1 ms. A discrete plant
            # would have made its step by then, and its state would be ahead of the planner's.
            first, restart = period - EARLY, weakly(self._Restart)
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, first, restart)
        for name, size in (PORTS | {"motion": sum(MOTION.values())}).items():
            outputs = tuple(MOTION) if name == "motion" else (name,)
            calc = weakly(self._CalcVector, outputs)
            self.DeclareVectorOutputPort(name, size * n, calc, self._Prerequisites(*outputs))
        kind, calc = Value[list[RigidTransform_[self.T]]], weakly(self._CalcPose)
        self.DeclareAbstractOutputPort("pose", kind, calc, self._Prerequisites("pose"))
        if self._restarts is not None:
            self.DeclareStateOutputPort("restarts", self._restarts)

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

    def _Restart(self, context: Any, state: Any) -> None:
        raise TypeError("a ContactPlanner restarts with T = float only: simulate that one")

    def _Turn(self, edge: float, context: Any, state: Any) -> None:
        """At a corner contacts turn to their next legs; at a rest their slip is dropped."""
        x, held = self._StateAndHeld(context)
        x, held = self.system.turned(edge, x, held, self._Parts(context, "carried")[0])
        state.get_mutable_continuous_state().SetFromVector(x)
        if self._held is not None:
            state.get_mutable_discrete_state(self._held).SetFromVector(held)

    def _StateAndHeld(self, context: Any) -> tuple[Array, Array]:
        x, held = context.get_continuous_state_vector(), self.system.held0
        if self._held is not None:
            held = context.get_discrete_state(self._held).CopyToVector().ravel()
        return x.CopyToVector().ravel(), held

    def _Prerequisites(self, *outputs: str) -> set:
        """Tickets of what outputs depend on."""
        found = {self.time_ticket(), self.xc_ticket()}
        if self._held is not None:
            found.add(self.discrete_state_ticket(self._held))
        if not self._fed_through.isdisjoint(outputs):
            found.add(self.input_port_ticket(self._disturbance.get_index()))
        return found

    def _Acting(self, context: Any, *outputs: str) -> list[Any]:
        """The disturbances that act now, from windows and the port, (n_w,).

        For outputs without feedthrough the port is not evaluated, as it may depend on them.
        """
        t, port = context.get_time(), self._disturbance
        w: list[Any] = [0.0] * self.system.n_w
        for d, rows in self.system.windows:
            acts = select(t >= d.start, 1.0, 0.0) - select(t >= d.stop, 1.0, 0.0)
            for k, value in enumerate(d.value, rows.start):
                w[k] += acts * value
        fed = port is not None and not self._fed_through.isdisjoint(outputs)
        if fed and port.HasValue(context):
            return [a + b for a, b in zip(w, port.Eval(context).ravel().tolist())]
        return w
