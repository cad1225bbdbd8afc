"""Tables of instructions that systems evaluate, each thread in memory of its own."""

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
from contact_system.system import SystemMachine, consecutive
from contact_system.theory import symbols as ca
from contact_system.theory.lowering import Table


class Scratch:
    """Arguments of a SceneSystem's functions, and machines that evaluate them, for one thread.

    Attributes
    ----------
    arguments : t, x, w, held, the arrays that `SceneSystem.function` takes, but for p
    w_valid : w is the same from the first of these times until the second
    written : t and x as memoryviews, which are written faster than arrays
    rates : run, guard and derivatives of the machine that computes derivatives
    """

    def __init__(self, system: SceneSystem):
        self._machine = functools.cache(functools.partial(SystemMachine, system))
        self.w_valid = (0.0, 0.0)
        machine = SystemMachine(system, "derivatives", "guard", "clearance")
        sizes = (1, len(system.x0), system.n_w, len(system.held0))
        self.arguments = [machine.point[part] for part in consecutive(sizes)]
        self.t, self.x, self.w, self.held = self.arguments
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
    """A table that is evaluated for each finger, for one thread.

    points : the table's arguments, a row per finger; x : the same by name, poses (n, 3, 4)
    results : (n, n_out)
    machines : one per finger
    """

    def __init__(self, table: Table, sizes: dict[str, int], constants: Sequence[list[float]]):
        registers = np.zeros((len(constants), table.n_regs))
        self.machines = [Machine(table, *each) for each in zip(constants, registers)]
        self.points = registers[:, : table.n_in]
        self.x: dict[str, Array] = {}
        for name, part in slices(sizes).items():
            columns = self.points[:, part]
            self.x[name] = columns.reshape(-1, 3, 4) if name[0] == "X" else columns
        self.results = registers[:, table.first_out :][:, : table.n_out]

    def put(self, X_W: Any, V_W: Any, obj: int, fingers: list[int]) -> None:
        """Set poses and velocities of object and fingers, from Drake's lists of all bodies."""
        x = self.x
        x["X_WO"][:], x["V_WO"][:] = X_W[obj].GetAsMatrix34(), V_W[obj].get_coeffs()
        for body, pose, velocity in zip(fingers, x["X_WF"], x["V_WF"]):
            pose[:], velocity[:] = X_W[body].GetAsMatrix34(), V_W[body].get_coeffs()

    def run(self) -> None:
        for machine in self.machines:
            machine.run()


def slices(sizes: dict[str, int]) -> dict[str, slice]:
    """The columns of named parts that follow each other in a row; sizes: how many each part has."""
    return dict(zip(sizes, consecutive(sizes.values())))


def named(sizes: dict[str, int]) -> tuple[ca.SX, SimpleNamespace]:
    """Symbols of a row, and its parts by name; of X_WB also R_WB, p_WB, of V w, v; A alpha, a."""
    every = ca.SX.sym("x", sum(sizes.values()))
    found = {name: every[part] for name, part in slices(sizes).items()}
    for name, value in list(found.items()):
        if name[0] == "X":
            rows = ca.reshape(value, 4, 3).T
            found |= {f"R{name[1:]}": rows[:, :3], f"p{name[1:]}": rows[:, 3]}
        elif name[0] in "VA":
            names = ("w", "v") if name[0] == "V" else ("alpha", "a")
            found |= {x + name[1:]: half for x, half in zip(names, ca.vertsplit(value, 3))}
    return every, SimpleNamespace(**found)


def per_thread(make: Callable[[], Any]) -> Callable[[], Any]:
    """A function that gives the object that was made for the calling thread.

    Threads may share a System, with a Context each. A ``threading.local`` would take a thread that
    Drake started for a new one at every call.
    """
    made = functools.cache(lambda thread: make())
    return lambda: made(threading.get_ident())
