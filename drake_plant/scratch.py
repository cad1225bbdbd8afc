"""Where numbers are evaluated: CasADi functions between fixed arrays, a set for each thread."""

from __future__ import annotations

import functools
import threading
from collections.abc import Sequence

import casadi as ca
import numpy as np

from contact_system import SceneSystem
from contact_system.errors import ContactSystemError
from contact_system.expressions import SYMBOLS
from contact_system.kernels import compiled_library, find_compiler, library_path

from .invariants import StepWatch, has_invariants, no_limits, pace_function

Array = np.ndarray


class BufferedFunction:
    """A CasADi function that reads and writes the same arrays at every :attr:`run`.

    Parameters
    ----------
    function : casadi.Function
    arguments : arrays that it reads
    compiled : bool or None
        None: as compiled C where it can be built here, or was built before, else in CasADi's
        virtual machine; True: as compiled C, or an error; False: in the virtual machine.
    """

    def __init__(self, function: ca.Function, arguments: Sequence[Array], compiled: bool | None):
        function = _compiled(function, compiled)
        self._buffer, self.run = function.buffer()
        self.results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        for i, array in enumerate(arguments):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore
        for i, array in enumerate(self.results):
            self._buffer.set_res(i, memoryview(array))  # type: ignore


def _compiled(function: ca.Function, compiled: bool | None) -> ca.Function:
    if compiled is False or (compiled is None and find_compiler() is None):
        return function
    generator = ca.CodeGenerator(function.name())
    generator.add(function)
    source = generator.dump()
    try:
        compiled_library(source)
    except (ContactSystemError, OSError):  # a compiler without headers, a cache nobody may use
        if compiled:
            raise
        return function
    return _external(function.name(), str(library_path(source)))


_external = functools.lru_cache(maxsize=64)(ca.external)


@functools.lru_cache(maxsize=16)
def _pace(system: SceneSystem) -> ca.Function:
    with SYMBOLS:
        return pace_function(system)


class Scratch:
    """What one thread evaluates with: arrays, and machines that read and write them.

    Attributes
    ----------
    t, x, w, held : arguments of `SceneSystem.function`, the first of `given`
    same : between these times w stays as it is
    limits : what `pace_function` compares with, those of the last simulation looked at
    hot : t, x, run, guard, derivatives of the machine of the derivatives
    """

    def __init__(self, system: SceneSystem, compiled: bool | None):
        self._system, self._compiled = system, compiled
        self.t, self.x, self.w = np.zeros(1), system.x0.copy(), np.zeros(system.n_w)
        self.held = system.held0.copy()
        self.given = (self.t, self.x, self.w, self.held)
        self.same = (0.0, 0.0)
        self._machines: dict[str, BufferedFunction] = {}
        self.limits, self.steps = no_limits(system), StepWatch(system.scene)
        if has_invariants(system):
            given = (*self.given, system.parameters, self.limits)
            machine = BufferedFunction(_pace(system), given, compiled)
            self.run_pace, self.paces = machine.run, machine.results[4:]
            self.excess = machine.results[3].data
        else:
            machine = self._machine("derivatives", "guard", "clearance")
        self._hot_machine = machine  # `run` does not keep its buffers
        rates, guard, clearance = machine.results[:3]
        self.hot = (self.t.data, self.x.data, machine.run, guard.data, rates)
        self.clearance = clearance.data

    def _machine(self, *outputs: str) -> BufferedFunction:
        given = (*self.given, self._system.parameters)
        return BufferedFunction(self._system.function(*outputs), given, self._compiled)

    def evaluate(self, output: str) -> Array:
        """An output of what is loaded; the array is written again."""
        if output not in self._machines:
            self._machines[output] = self._machine(output)
        machine = self._machines[output]
        machine.run()
        return machine.results[0]


class Scratches(threading.local):
    """``own`` is the Scratch of the thread that asks.

    A System is const, and threads that share one have a Context each. ``made`` keeps them by
    ``get_ident()``: to ``threading.local`` a thread of Drake's own is a new one at every call.
    """

    def __init__(self, system: SceneSystem, compiled: bool | None, made: dict[int, Scratch]):
        thread = threading.get_ident()
        if thread not in made:
            made[thread] = Scratch(system, compiled)
        self.own = made[thread]
