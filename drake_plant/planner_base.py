"""What planners of every scalar share: ports, windows, and what follows from a system's outputs."""

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
"""Restarts and pushes happen so much before their time, s, as a step may come late by rounding."""
AGES = 1e9
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
"""Ports of vectors, and what they hold of each contact."""
MOTION = {"pose": 12} | {name: PORTS[name] for name in PORTS if name not in ("state", "slip")}
"""What a FingertipDriver takes of each contact, one after the other, on one port."""


# What is derived from a scene is large: planners of the same one share it.
scene_system = functools.lru_cache(maxsize=16)(SceneSystem)


_System: Any = object  # LeafSystem_[T] comes behind it in each class


class PlannerBase(_System):
    """Ports, windows and outputs of a system that tells how contacts move, of any scalar.

    Attributes
    ----------
    system : SceneSystem
    """

    __slots__ = NO_DICTIONARY

    T: type = float
    _held: Any = None  # states and ports that not all have
    _disturbance: Any = None
    _measured: Any = None
    _restarts: Any = None

    def _Declare(self, system: SceneSystem, x0: Array | None, period: float | None) -> None:
        """States, ports and events; period: of restarts, s."""
        self.system, self._period, self._fed_through = system, period, {"derivatives"}
        n = len(system.scene.contacts)
        if x0 is not None:
            self.DeclareContinuousState(BasicVector_[self.T](x0))
        # Nothing happens, but no integrator steps across an edge: a step ends before it, and the
        # next one begins at it.
        for edge in system.edges:
            for time in (max(0.0, math.nextafter(edge, -math.inf)), edge):
                self.DeclarePeriodicPublishEvent(AGES, time, lambda context: None)
        turns = system.corners if x0 is not None else ()
        if len(system.held0) and x0 is not None and (turns or period is not None):
            self._held = self.DeclareDiscreteState(BasicVector_[self.T](system.held0))
        for edge in turns:
            self.DeclarePeriodicUnrestrictedUpdateEvent(AGES, edge, weakly(self._Turn, edge))
        if system.disturbance_input:
            self._disturbance = self.DeclareVectorInputPort("disturbance", 6 * n)
        if period is not None:
            self._measured = self.DeclareVectorInputPort("measured_state", 9 * n)
            self._restarts = self.DeclareDiscreteState(BasicVector_[self.T](np.zeros(n)))
            # A little early: 3 * 0.1 s comes after 300 * 1 ms in floating point, and a discrete
            # plant that has stepped already would be measured a step ahead of the planner.
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
        """What the ports of these names say now, a row a contact; of "pose" its numbers."""
        n = len(self.system.scene.contacts)
        return np.concatenate(
            [part.reshape(n, -1) for part in self._Parts(context, *outputs)], axis=1
        )

    def _Parts(self, context: Any, *outputs: str) -> list[Array]:
        """Outputs of the system, each contact after contact."""
        raise NotImplementedError

    def _CalcVector(self, outputs: tuple[str, ...], context: Any, vector: Any) -> None:
        vector.SetFromVector(self.Evaluate(context, *outputs).ravel())

    def _CalcPose(self, context: Any, value: Any) -> None:
        Transform, Rotation = RigidTransform_[self.T], RotationMatrix_[self.T]
        rows = self.Evaluate(context, "pose")
        value.set_value([Transform(Rotation(r[:9].reshape(3, 3).T), r[9:]) for r in rows])

    def _Restart(self, context: Any, state: Any) -> None:
        raise TypeError("ContactPlanner restarts with T = float only; simulate that one")

    def _Turn(self, edge: float, context: Any, state: Any) -> None:
        """Contacts go on along their next legs, or without slip from a rest."""
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
        """What outputs depend on, from the sparsity of their functions."""
        needs = {output: self.system.depends(output) for output in outputs}
        self._fed_through |= {output for output in outputs if "w" in needs[output]}
        inputs = set().union(*needs.values())
        tickets = {"t": self.time_ticket(), "x": self.xc_ticket(), "w": self.time_ticket()}
        found = {ticket for name, ticket in tickets.items() if name in inputs}
        if "held" in inputs and self._held is not None:
            found.add(self.discrete_state_ticket(self._held))
        if "w" in inputs and self._disturbance is not None:
            found.add(self.input_port_ticket(self._disturbance.get_index()))
        return found or {self.nothing_ticket()}

    def _Acting(self, context: Any, *outputs: str) -> list[Any]:
        """What windows and the disturbance port add, (n_w,).

        Outputs without feedthrough do not ask the port, which may depend on them.
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
