"""Where numbers are evaluated: tables on registers of their own, a set for each thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from contact_system import SceneSystem
from contact_system.system import SystemMachine

from .plan_check import StepWatch

Array = np.ndarray


class Scratch:
    """What one thread evaluates with: arrays, and machines that read and write them.

    Attributes
    ----------
    t, x, w, held : arguments of `SceneSystem.function`, the first of `given`
    same : between these times w stays as it is
    hot : t, x, run, guard, derivatives of the machine of the derivatives
    """

    def __init__(self, system: SceneSystem):
        self._system = system
        self.same = (0.0, 0.0)
        self._machines: dict[tuple[str, ...], SystemMachine] = {}
        machine = SystemMachine(system, "derivatives", "guard", "clearance")
        sizes = (1, len(system.x0), system.n_w, len(system.held0))
        self.given = np.split(machine.point, np.cumsum(sizes)[:-1])
        self.t, self.x, self.w, self.held = self.given
        self._given = machine.point
        self.x[:], self.held[:] = system.x0, system.held0
        self.steps = StepWatch(system.scene.duration)
        rates, guard, clearance = machine.parts
        self.hot = (self.t.data, self.x.data, machine.run, guard.data, rates)
        self.clearance = clearance.data

    def evaluate(self, *outputs: str) -> Array:
        """Outputs of what is loaded, one after the other; the array is written again."""
        if outputs not in self._machines:
            self._machines[outputs] = SystemMachine(self._system, *outputs)
        machine = self._machines[outputs]
        machine.point[:] = self._given
        machine.run()
        return machine.results


class PerThread(threading.local):
    """``own`` is what was made for the thread that asks.

    A System is const, and threads that share one have a Context each. ``made`` keeps them by
    ``get_ident()``: to ``threading.local`` a thread of Drake's own is a new one at every call.
    """

    def __init__(self, make: Callable[[], Any], made: dict[int, Any]):
        thread = threading.get_ident()
        if thread not in made:
            made[thread] = make()
        self.own = made[thread]
