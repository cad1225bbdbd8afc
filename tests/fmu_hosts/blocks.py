"""An exported FMU or a slave in this process with one interface, asked by variables' names."""

from __future__ import annotations

import ctypes
import functools
import math
import re
import tempfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException

import contact_system as cs
from fmu_export import PlannerSlave2, PlannerSlave3, export_fmu, variable_table

from .native import Fmu

_STATE = {"2.0": ("FMUstate", "deSerialize"), "3.0": ("FMUState", "deserialize")}


@functools.cache
def _folder() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="fmu-blocks-")


@functools.cache
def exported(scene: cs.Scene, version: str, **options: Any) -> Fmu:
    """The scene's FMU, exported once in a process."""
    folder = Path(tempfile.mkdtemp(dir=_folder().name))
    return Fmu.unpacked(export_fmu(scene, folder / "x.fmu", version, **options), folder / "x")


def columns(i: int) -> list[str]:
    """Variables u1 v1 u1' v1' u2 v2 u2' v2' psi of contact i (0, 1, ...), as in `Plan.states`."""
    c = f"contact[{i + 1}]."
    sides = [[f"{c}{side}.u", f"{c}{side}.v"] for side in ("finger", "object")]
    return [*(n for ab in sides for n in (*ab, *(f"der({n})" for n in ab))), c + "angle"]


class Instance:
    """An instance of an FMU or a slave; ``time`` is its time, ``said`` its log.

    Options are those of fmpy (``eventModeUsed``, ``earlyReturnAllowed``), also for a slave, and
    ``measured`` of `export_fmu`.
    """

    def __init__(self, scene: cs.Scene, kind: str, version: str, interface="CoSimulation", **given):
        self.scene, self.kind, self.version, self.interface = scene, kind, version, interface
        described = {name: given.pop(name) for name in ("measured",) if name in given}
        self.table, self.time = variable_table(scene, **described), 0.0
        self.said: list[tuple[int, str, str]] = []
        if kind == "FMU":
            log = lambda *line: self.said.append(line)  # noqa: E731
            self.own = exported(scene, version, **described).instance(log, interface, **given)
        else:
            names = {"eventModeUsed": "event_mode", "earlyReturnAllowed": "early_return"}
            options = {names[key]: value for key, value in given.items()} | described
            slave = {"2.0": PlannerSlave2, "3.0": PlannerSlave3}[version]
            self.own = slave(scene, logger=lambda *line: self.said.append(line), **options)

    def begin(self, time: float = 0.0, stop: float | None = None, **start: Any) -> Instance:
        """Set ``start`` values by name and initialize. FMI 3 with events is then in event mode."""
        self.put(start.get("start", {}))
        self.time = time
        if self.version == "2.0":
            self.own.setupExperiment(startTime=time, stopTime=stop)
            self.own.enterInitializationMode()
        else:
            self.own.enterInitializationMode(startTime=time, stopTime=stop)
        self.own.exitInitializationMode()
        return self

    def reference(self, name: str) -> int:
        return self.table[name].reference

    def put(self, values: dict[str, Any]) -> None:
        for name, value in values.items():
            first, numbers = self.reference(name), np.ravel(value).tolist()
            put = self.own.setReal if self.version == "2.0" else self.own.setFloat64
            put(list(range(first, first + len(numbers))), numbers)

    def get(self, *names: str) -> np.ndarray:
        found = []
        for name in names:
            first, size = self.reference(name), self.table[name].size
            get = self.own.getReal if self.version == "2.0" else self.own.getFloat64
            found += get(list(range(first, first + size)))
        return np.array(found)

    def step(self, *sizes: float) -> Any:
        for size in sizes:
            found = self.own.doStep(self.time, size)
            self.time = found[-1] if self.version == "3.0" else self.time + size
        return found

    def states(self) -> np.ndarray:
        """(n_contacts, 9)"""
        count = len(self.scene.contacts)
        return self.get(*(n for i in range(count) for n in columns(i))).reshape(count, 9)

    def everything(self) -> np.ndarray:
        """The values of all variables but time."""
        return self.get(*(v.name for v in self.table.rows[1:]))

    def state(self) -> Any:
        return getattr(self.own, f"get{_STATE[self.version][0]}")()

    def restore(self, state: Any, time: float) -> Instance:
        getattr(self.own, f"set{_STATE[self.version][0]}")(state)
        self.time = time
        return self

    def written(self, state: Any = None) -> bytes:
        """A state as bytes; by default the present one."""
        write = getattr(self.own, f"serialize{_STATE[self.version][0]}")
        return bytes(write(self.state() if state is None else state))

    def read(self, data: bytes) -> Any:
        suffix, word = _STATE[self.version]
        return getattr(self.own, word + suffix)(data)

    def free(self, state: Any) -> None:
        getattr(self.own, f"free{_STATE[self.version][0]}")(state)

    def directional(self, unknowns: list[str], knowns: list[str], seed: Any) -> np.ndarray:
        """Directional derivatives along a seed, of and by variables of one element each."""
        count = () if self.version == "2.0" else (len(unknowns),)
        references = [[self.reference(n) for n in names] for names in (unknowns, knowns)]
        return np.array(self.own.getDirectionalDerivative(*references, list(seed), *count))

    def product(self, which: str, unknowns: list[str], knowns: list[str], seed: Any) -> np.ndarray:
        """FMI 3: "Directional" or "Adjoint" derivative along a seed."""
        references = [
            [v.reference + i for n in names for v in [self.table[n]] for i in range(v.size)]
            for names in (unknowns, knowns)
        ]
        rows, count = map(len, references)
        u, k = ((ctypes.c_uint32 * len(r))(*r) for r in references)
        out = (ctypes.c_double * (rows if which == "Directional" else count))()
        s = (ctypes.c_double * len(seed))(*seed)
        call = getattr(self.own, f"fmi3Get{which}Derivative")
        call(self.own.component, u, len(u), k, len(k), s, len(s), out, len(out))
        return np.array(out)

    def refused(self, words: str, call: Any, *arguments: Any) -> None:
        """Assert that a call ends in an error whose message, or a line logged in it, has words."""
        self.said.clear()
        try:
            call(*arguments)
        except FMICallException as error:
            messages = "\n".join([str(error), *(line[-1] for line in self.said)])
            assert re.search(words, messages), messages
        else:
            raise AssertionError("not refused")


def simulated(scene: cs.Scene, version: str, **given: Any) -> np.ndarray:
    """All outputs and states from `fmpy.simulate_fmu`."""
    scalars = variable_table(scene).rows
    names = [v.name for v in scalars if v.causality in ("output", "local")]
    usual = {"output": names, "relative_tolerance": 1e-10, "fmi_type": "CoSimulation"}
    given = usual | {"stop_time": scene.duration} | given
    fmu = exported(scene, version)
    return fmpy.simulate_fmu(str(fmu.folder), model_description=fmu.description, **given)


def simulated_states(result: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """States (n_times, n_contacts, 9) of a result of fmpy, less whole turns against ``wanted``."""
    rows = [[result[name] for name in columns(i)] for i in range(wanted.shape[1])]
    found = np.moveaxis(np.array(rows), 2, 0)
    return found - math.tau * np.rint((found - wanted) / math.tau)


def close(found: Any, expected: Any, bar: float = 1e-12) -> None:
    """Assert agreement to ``bar`` times the greatest expected number, or times 1."""
    size = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0, atol=bar * size)
