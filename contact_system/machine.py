"""A `SceneSystem` evaluated at one place at a time, for integrators that ask often."""

from __future__ import annotations

import functools

import numpy as np

from .engine.binding import Machine
from .system import SceneSystem
from .theory import symbols as ca
from .theory.lowering import Table
from .theory.symbols import making_symbols


@functools.lru_cache(maxsize=128)
def lowered(system: SceneSystem, *outputs: str) -> tuple[Table, list[int]]:
    """The table (t, x, w, held | p) -> outputs, and where each of these ends."""
    with making_symbols():
        function = system.function(*outputs)
        given = [ca.SX.sym(f"x{i}", function.size1_in(i)) for i in range(function.n_in())]
        found = function.call(given)
        *point, p = given
        flat = ca.Function("flat", [ca.vertcat(*point), p], [ca.vertcat(*found)])
    return Table(flat), np.cumsum([value.numel() for value in found]).tolist()


class SystemMachine(Machine):
    """A machine of a scene's system: its `point` is t, x, w and held.

    Attributes
    ----------
    parts : list of arrays
        Of its `results`, one an output.
    """

    def __init__(self, system: SceneSystem, *outputs: str):
        table, ends = lowered(system, *outputs)
        super().__init__(table, system.parameters)
        self.parts = np.split(self.results, ends[:-1])
