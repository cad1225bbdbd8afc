"""A `SceneSystem` evaluated at one place at a time, for integrators that ask often."""

from __future__ import annotations

import ctypes
import functools

import numpy as np

from .engine.binding import step
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


class Machine:
    """A table on registers of one number each, which are written to and read from.

    Attributes
    ----------
    point : (n_in,)
        What `run` reads.
    results : list of arrays
        What it writes.
    """

    def __init__(self, system: SceneSystem, *outputs: str):
        table, ends = lowered(system, *outputs)
        r = np.zeros(table.n_regs)
        r[table.n_in : table.first_lit] = system.parameters
        r[table.first_lit :][: len(table.literals)] = table.literals
        code, prologue = (
            (ctypes.c_void_p * 2)(words.ctypes.data, r.ctypes.data)
            for words in (table.body, table.prologue)
        )
        step(ctypes.addressof(prologue))
        # an address made beforehand saves half of the time of a call
        self.run = functools.partial(step, ctypes.c_void_p(ctypes.addressof(code)))
        self._kept = table, code  # which C knows by their addresses alone
        self.point = r[: table.n_in]
        self.results = np.split(r[table.first_out :][: table.n_out], ends[:-1])
