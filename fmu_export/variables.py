"""The table of a scene's variables: what an importer sees, and where the component keeps it.

The component's values are one array of float64. A variable's value reference is the index of its
first element there; unless FMI 3 sees arrays, every element is a scalar with a name of its own.
The array begins with time and the parameters; groups of values of each contact follow.

Names are structured (FMI 2.0.4, section 2.2.9; FMI 3.0.2, section 2.4.7.5.1) and count from 1.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from contact_system.caching import cached_property
from contact_system.checks import flag, one_of
from contact_system.errors import ContactSystemError, SceneError
from contact_system.scene import Scene, require_scene
from contact_system.surfaces import Quadric, Surface
from contact_system.surfaces.base import OfLengths
from contact_system.system import SceneSystem
from contact_system.theory.gain import Law

from .contact_variables import DERIVATIVES, STATES, contact_groups
from .equations import equations
from .quantities import METRE, NONE, SECOND, Unit, Variable, array_of, chart_units, per_second


@dataclass(frozen=True, eq=False)
class Table:
    """All variables of a scene.

    Attributes
    ----------
    scene : Scene
    rows : list of Variable
        Scalars, by reference, which counts them.
    first : dict
        References of the first value of ``gain``, ``scale``, ``profile``, ``object``, ``finger 0``
        and so on, and of ``windows``, which have four each.
    groups : list of list of int
        Of each contact, the references at which its groups begin, and where the last one ends.
    arrays : bool
        Whether FMI 3 sees arrays.
    measured : str
        Of `MEASUREMENTS`.
    """

    scene: Scene
    rows: list[Variable]
    first: dict[str, int]
    groups: list[list[int]]
    arrays: bool
    measured: str

    @cached_property
    def _by_name(self) -> dict[str, Variable]:
        return {v.name: v for v in (*self.joined, *self.rows)}

    def __getitem__(self, name: str) -> Variable:
        """The scalar or array of a name; KeyError where there is none."""
        return self._by_name[name]

    @cached_property
    def states(self) -> list[int]:
        """References of the continuous states."""
        return [r for g in self.groups for r in range(g[STATES], g[DERIVATIVES])]

    @cached_property
    def inputs(self) -> list[int]:
        """References of the inputs."""
        return [r for g in self.groups for r in range(g[0], g[STATES])]

    @cached_property
    def start_values(self) -> np.ndarray:
        """The values before initialization: starts, and 0 for what is calculated, (n_values,)."""
        return np.array([x for row in self.rows for x in row.start or (0.0,)])

    def structure(self, i: int) -> tuple[Surface, Surface, Law, int]:
        """The arguments of `equations` for contact i."""
        scene, contact = self.scene, self.scene.contacts[i]
        most = max(len(stretch.profile.coefficients) for stretch in scene.way(i))
        return contact.finger, scene.object, scene.gain.row, most

    def columns(self, i: int) -> list[int]:
        """References of the equations' inputs and constants; -1 for profiles of legs."""
        first, group, (finger, obj, _, n_profile) = self.first, self.groups[i], self.structure(i)
        states, inputs = range(group[STATES], group[DERIVATIVES]), range(group[0], group[1])
        legs = self.scene.contacts[i].legs
        profile = [-1 if legs else first["profile"] + k for k in range(n_profile)]
        tip, body = (
            [first[key] + k for k in range(len(s.parameters))]
            for key, s in ((f"finger {i}", finger), ("object", obj))
        )
        return [0, *states, *inputs, first["gain"], *profile, *tip, *body]

    @cached_property
    def joined(self) -> list[Variable]:
        """The variables with arrays instead of their elements."""
        arrays = groupby(self.rows, key=lambda v: v.within[0] or v.name)
        return [array_of([*elements]) for _, elements in arrays]

    def listed(self, fmi_version: str) -> list[Variable]:
        """The variables that importers see, in order; FMI 2 leaves out the independent one."""
        if fmi_version == "2.0":
            if self.arrays:
                raise ContactSystemError("arrays: FMI 2.0 has none; choose FMI 3.0")
            return self.rows[1:]
        return self.joined if self.arrays else self.rows


MEASUREMENTS = ("nothing", "states", "pose")


def variable_table(scene: Scene, arrays: bool = False, measured: str = "nothing") -> Table:
    """The variables of a scene.

    Parameters
    ----------
    scene : Scene
    arrays : bool
        Whether FMI 3 sees vectors and matrices instead of scalars.
    measured : "nothing" or "states" or "pose"
        Which measurement has inputs: states, or the finger's pose and twist relative to the object.
        Contacts go on from it when a trigger changes to another number than 0.

    Raises
    ------
    SceneError
        A scene that no importer can step: a user's parameter that has the name of an output;
        measurements on a surface without a chart.
    """
    require_scene(scene)
    one_of(measured, MEASUREMENTS, "measured")
    unmeasured = [s for s in scene.surfaces if measured != "nothing" and not s.has_chart]
    if unmeasured:
        raise SceneError(
            f"{scene.title}: {unmeasured[0]!r} has no explicit chart f(u, v), in which states "
            "could be measured; leave measured out, or give a ParametricSurface"
        )
    rows = [Variable("time", "Simulation time", SECOND, "independent", initial=None)]

    def add(more: Iterable[Variable]) -> int:
        """Add rows; returns the reference of the first one."""
        at = len(rows)
        for v in more:
            v.reference = len(rows)
            rows.append(v)
        return at

    first = {key: add(variables) for key, variables in _parameters(scene).items()}
    system, groups = SceneSystem(scene, "frame", True), []
    speed = scene.speeds(np.linspace(0.0, scene.duration, 65)).max() or None
    for i, part in enumerate(system.state_slices):
        starts = system.x0[part]
        # as at sigma = 1: at sigma = 0 slip may be left out, but importers may start elsewhere
        starts[-4:] = system.carried(scene.contacts[i].start(), 1.0)
        groups.append([*map(add, contact_groups(scene, i, starts, measured, speed)), len(rows)])
    table = Table(scene, rows, first, groups, flag(arrays, "arrays"), measured)
    for i in range(len(groups)):
        _set_dependencies(table, i)
    _require_names(table)
    return table


# --- parameters ----------------------------------------------------------------------------------


def _require_names(table: Table) -> None:
    """Refuse two variables of one name, in FMI 3 or in FMI 2."""
    for variables in (table.joined, table.rows):
        name, count = Counter(v.name for v in variables).most_common(1)[0]
        if count > 1:
            raise SceneError(
                f"{table.scene.title}: two variables of the FMU would be called {name}; "
                f"give the surface's parameter '{name.rpartition('.')[2]}' another name"
            )


def _parameter(name: str, value: float, unit: Unit | None, text: str, **more: Any) -> Variable:
    kind = {"causality": "parameter", "variability": "fixed", "initial": "exact"} | more
    return Variable(name, text, unit, start=(float(value),), **kind)


def _parameters(scene: Scene) -> dict[str, Iterable[Variable]]:
    """The parameters, in the order of their references, by the keys of `Table.first`."""
    name, text = f"gain.{scene.gain.parameter}", f"Gain of the law '{scene.gain.law}'"
    tunable = {"variability": "tunable", "minimum": 0.0}
    gain = _parameter(name, scene.gain.value, (*scene.gain.row.dimension, 0), text, **tunable)
    shared = () if all(c.legs for c in scene.contacts) else scene.profile.coefficients
    text = "Path profile sigma(t), coefficient of t^"
    profile = [
        _parameter(f"profile[{k + 1}]", value, (1, -1 - k, 0), f"{text}{k}")
        for k, value in enumerate(shared)
    ]
    text = "Factor of the scene's own disturbances; 0 leaves them out"
    scale = _parameter("disturbances.scale", 1.0, NONE, text)
    found: dict[str, Iterable[Variable]] = {"gain": [gain], "scale": [scale], "profile": profile}
    found["object"] = _numbers("object", scene.object)
    for i, contact in enumerate(scene.contacts):
        found[f"finger {i}"] = _numbers(f"contact[{i + 1}].finger", contact.finger)
    return found | {"windows": _window_rows(scene)}


def _numbers(owner: str, surface: Surface) -> Iterator[Variable]:
    """The parameters of a body's surface."""
    for name, value in zip(surface.parameter_names(1), surface.parameters):
        named = f"{owner}.{name}", value
        text = f"Parameter {name} of the {owner.rpartition('.')[2]}'s surface"
        if isinstance(surface, OfLengths):
            least = min(1e-6, 1e-3 * value)
            yield _parameter(*named, METRE, text, minimum=least, nominal=value)
        else:
            unit, more = METRE if name.startswith("center[") else None, dict[str, Any]()
            if isinstance(surface, Quadric):  # whose numbers depend on each other
                more = {"causality": "local", "variability": "constant"}
            yield _parameter(*named, unit, text, **more)


def _window_rows(scene: Scene) -> Iterator[Variable]:
    """Start, stop and components of each of the scene's disturbances."""
    for k, d in enumerate(scene.disturbances):
        surface = scene.contacts[int(d.contact)].finger if d.side == "finger" else scene.object
        units = [per_second(unit, 1 + d.accelerates) for unit in chart_units(surface)]
        stem = f"disturbance[{k + 1}]."
        what = f"disturbance of contact {int(d.contact) + 1}, {d.kind}"
        yield _parameter(f"{stem}start", d.start, SECOND, f"Start of the {what}", minimum=0.0)
        yield _parameter(f"{stem}stop", d.stop, SECOND, f"Stop of the {what}", minimum=0.0)
        for axis, unit, value in zip("uv", units, d.value):
            yield _parameter(f"{stem}{axis}", value, unit, f"Component {axis} of the {what}")


# --- dependencies --------------------------------------------------------------------------------


def _set_dependencies(table: Table, i: int) -> None:
    """Set `known`, and `derivative`, of a contact's derivatives and results, by their equations."""
    scene, first, group, columns = table.scene, table.first, table.groups[i], table.columns(i)
    _, found = equations(*table.structure(i))
    behind = [[r] if r >= 0 else [] for r in columns]
    inputs = columns.index(group[0])
    for k, d in enumerate(scene.disturbances):
        for axis in range(2 if d.contact == i else 0):
            ref = first["windows"] + 4 * k
            behind[inputs + 2 * d.slot + axis] += [ref, ref + 1, ref + 2 + axis, first["scale"]]
    known = [tuple(sorted({r for j in np.flatnonzero(row) for r in behind[j]})) for row in found]
    for at, v in enumerate(table.rows[group[DERIVATIVES] : group[-1]]):
        v.known = known[at]
        if v.causality == "output":  # reading it takes up a new measurement
            v.known += tuple(range(group[1], group[STATES]))
        if v.reference < group[DERIVATIVES + 1]:
            v.derivative = at + group[STATES]
