"""Where numbers are evaluated: tables on registers of their own, a set for each thread."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from contact_system import SceneSystem
from contact_system.checks import Array
from contact_system.engine.binding import Machine
from contact_system.system import SystemMachine
from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table


class Scratch:
    """What one thread evaluates with: arrays, and machines that read and write them.

    Attributes
    ----------
    t, x, w, held : arguments of `SceneSystem.function`, the first of `given`
    same : between these times w stays as it is
    written : t and x, as they are written fastest
    rates : run, guard and derivatives of the machine of the derivatives
    """

    def __init__(self, system: SceneSystem):
        self._machine = functools.cache(functools.partial(SystemMachine, system))
        self.same = (0.0, 0.0)
        machine = SystemMachine(system, "derivatives", "guard", "clearance")
        sizes = (1, len(system.x0), system.n_w, len(system.held0))
        self.given = np.split(machine.point, np.cumsum(sizes)[:-1])
        self.t, self.x, self.w, self.held = self.given
        self._given = machine.point
        self.x[:], self.held[:] = system.x0, system.held0
        rates, guard, clearance = machine.parts
        self.written = self.t.data, self.x.data
        self.rates = machine.run, guard.data, rates
        self.clearance = clearance.data

    def evaluate(self, *outputs: str) -> list[Array]:
        """Outputs of what is loaded; the next call overwrites them."""
        machine = self._machine(*outputs)
        machine.point[:] = self._given
        machine.run()
        return machine.parts


class FingerTables:
    """A table run for several fingers, one after the other, for one thread.

    points : what it takes, a row a finger; x : the same by name, poses (n, 3, 4)
    results : (n, n_out)
    machines : one a finger
    """

    def __init__(self, table: Table, sizes: dict[str, int], constants: Sequence[list[float]]):
        registers = np.zeros((len(constants), table.n_regs))
        self.machines = [Machine(table, *each) for each in zip(constants, registers)]
        self.points = registers[:, : table.n_in]
        self.x: dict[str, Array] = {}
        for name, part in slices(sizes).items():
            own = self.points[:, part]
            self.x[name] = own.reshape(-1, 3, 4) if name[0] == "X" else own
        self.results = registers[:, table.first_out :][:, : table.n_out]

    def put(self, X_W: Any, V_W: Any, obj: int, fingers: list[int]) -> None:
        """Where object and fingers are, and how they move, of Drake's lists of all bodies."""
        x = self.x
        x["X_WO"][:], x["V_WO"][:] = X_W[obj].GetAsMatrix34(), V_W[obj].get_coeffs()
        for body, pose, velocity in zip(fingers, x["X_WF"], x["V_WF"]):
            pose[:], velocity[:] = X_W[body].GetAsMatrix34(), V_W[body].get_coeffs()

    def run(self) -> None:
        for machine in self.machines:
            machine.run()


def slices(sizes: dict[str, int]) -> dict[str, slice]:
    """Where parts of so many numbers each are in a row, by their names."""
    ends = np.cumsum([*sizes.values()]).tolist()
    return dict(zip(sizes, map(slice, [0, *ends], ends)))


def named(sizes: dict[str, int]) -> tuple[ca.SX, SimpleNamespace]:
    """Symbols by their names; of a pose X R and p, of a velocity V w and v, of A alpha and a."""
    every = ca.SX.sym("x", sum(sizes.values()))
    found = {name: every[part] for name, part in slices(sizes).items()}
    for name, value in list(found.items()):
        if name[0] == "X":
            rows = ca.reshape(value, 4, 3).T
            found |= {f"R{name[1:]}": rows[:, :3], f"p{name[1:]}": rows[:, 3]}
        elif name[0] in "VA":
            names = ("w", "v") if name[0] == "V" else ("alpha", "a")
            found |= {f"{own}{name[1:]}": half for own, half in zip(names, ca.vertsplit(value, 3))}
    return every, SimpleNamespace(**found)


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
