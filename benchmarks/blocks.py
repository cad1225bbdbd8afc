"""FMUs and slaves in this process, stepped by the same few calls, and what a plan says of them."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from fmu_hosts.native import Fmu

import contact_system as cs
from fmu_export import PlannerSlave2, PlannerSlave3, export_fmu, variable_table

Array = np.ndarray
VERSIONS = ("2.0", "3.0")
PARTS: dict[str, tuple[str, Callable[[Array], Array]]] = {
    "slip": ("slip", lambda x: x),
    "twist.angular": ("twist", lambda x: x[..., :3]),
    "twist.linear": ("twist", lambda x: x[..., 3:]),
    "pose.rotation": ("pose", lambda x: x[..., :3, :3]),
    "pose.position": ("pose", lambda x: x[..., :3, 3]),
    "finger.point": ("points", lambda x: x[..., 0, :]),
    "object.point": ("points", lambda x: x[..., 1, :]),
}
"""Name of a variable behind ``contact[i].`` -> what a plan is asked for, and its part of that."""
_KEPT = tempfile.TemporaryDirectory(prefix="benchmarks-", ignore_cleanup_errors=True)


def folder() -> Path:
    """A new folder that is gone after this process."""
    return Path(tempfile.mkdtemp(dir=_KEPT.name))


@functools.cache
def fmu_of(scene: cs.Scene, version: str, *platforms: str, **options: Any) -> Fmu:
    """The exported FMU of a scene, unpacked."""
    place, given = folder(), {"platforms": platforms or ("native",)} | options
    path = export_fmu(scene, place / f"{scene.name}.fmu", version, **given)
    return Fmu.unpacked(path, place / "unpacked")


def planned(plan: cs.Plan, t: Array) -> dict[str, Array]:
    """Name of a variable -> (n_times, n_contacts, n)."""
    shape = (len(t), len(plan.scene.contacts), -1)
    asked = {name: getattr(plan, name)(t) for name, _ in PARTS.values()}
    return {name: part(asked[output]).reshape(shape) for name, (output, part) in PARTS.items()}


class Refused(Exception):
    """A call that a block answered with an error; its text is what the block logged."""


class Stepper:
    """A stepped block of FMI 2.0 or 3.0: an "FMU", a "slave", or an FMU by "ModelExchange"."""

    def __init__(self, scene: cs.Scene, version: str, kind: str = "FMU"):
        self.scene, self.two, self.messages = scene, version == "2.0", []
        self.table, self.time = variable_table(scene), 0.0
        contacts = range(1, len(scene.contacts) + 1)
        self.rows = {n: [self.table[f"contact[{i}].{n}"] for i in contacts] for n in PARTS}

        def log(status: int, category: str, text: str) -> None:
            self.messages.append(text)

        if kind == "slave":
            self.slave = (PlannerSlave2 if self.two else PlannerSlave3)(scene, scene.name, log)
        else:
            interface = kind if kind == "ModelExchange" else "CoSimulation"
            self.slave = fmu_of(scene, version).instance(log, interface, scene.name)

    def call(self, method: str, *arguments: Any) -> Any:
        """Call fmpy's method, named as in FMI 3; raises `Refused` where the block does."""
        if self.two:
            method = _TWO.get(method, method)
        del self.messages[:]
        try:
            return getattr(self.slave, method)(*arguments)
        except FMICallException:
            raise Refused(" | ".join(self.messages) or f"{method} failed without a line") from None

    def begin(self, stop: float | None = None) -> None:
        """Back to the start, whatever happened before."""
        self.call("reset")
        self.time, experiment = 0.0, (None, 0.0, stop)
        if self.two:
            self.call("setupExperiment", *experiment)
        self.call("enterInitializationMode", *(() if self.two else experiment))
        self.call("exitInitializationMode")

    def step(self, size: float) -> None:
        """One step; time is what the importer adds up."""
        self.call("doStep", self.time, size)
        self.time += size

    def read(self) -> dict[str, Array]:
        """Name -> (1, n_contacts, n)."""
        rows = [row for own in self.rows.values() for row in own]
        values = self.call("getFloat64", self._references(rows))
        ends = np.cumsum([sum(row.size for row in own) for own in self.rows.values()])
        shape, parts = (1, len(self.scene.contacts), -1), np.split(np.array(values), ends[:-1])
        return {name: part.reshape(shape) for name, part in zip(self.rows, parts)}

    def set(self, name: str, values: Sequence[float]) -> None:
        """Set all elements of a variable."""
        self.call("setFloat64", self._references([self.table[name]]), list(values))

    def _references(self, rows: Sequence[Any]) -> list[int]:
        """Of all elements of rows of the table."""
        return [r for row in rows for r in range(row.reference, row.reference + row.size)]

    def saved(self) -> tuple[bytes, float]:
        """The state as bytes, and its time."""
        state = self.call("getFMUState")
        data = self.call("serializeFMUState", state)
        self.call("freeFMUState", state)
        return bytes(data), self.time

    def restore(self, data: bytes, time: float) -> None:
        """Go back to bytes."""
        state = self.call("deserializeFMUState", data)
        self.call("setFMUState", state)
        self.call("freeFMUState", state)
        self.time = time


_TWO = {
    "getFloat64": "getReal",
    "setFloat64": "setReal",
    "getFMUState": "getFMUstate",
    "setFMUState": "setFMUstate",
    "freeFMUState": "freeFMUstate",
    "serializeFMUState": "serializeFMUstate",
    "deserializeFMUState": "deSerializeFMUstate",
    "getContinuousStateDerivatives": "getDerivatives",
}
"""Names of FMI 2."""


def joined(seen: Sequence[dict[str, Array]]) -> dict[str, Array]:
    """What was read at several times, one after the other."""
    return {name: np.concatenate([values[name] for values in seen]) for name in PARTS}


def finite(found: dict[str, Array]) -> bool:
    """Whether all that was read is finite."""
    return all(np.isfinite(values).all() for values in found.values())
