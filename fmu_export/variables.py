"""One table of variables for a scene: what an importer sees, and where the component keeps it.

The component's values lie in one array of float64. A variable's value reference is the index of its
first element there; every element is a scalar of its own name, but for FMI 3 with arrays. The array
begins with time and the parameters; a block of numbers a contact follows: inputs, states, their
derivatives and other results (`fmu_export.model`).

Names are structured (FMI 2.0.4, section 2.2.9; FMI 3.0.2, section 2.4.7.5.1) and count from 1.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from contact_system.errors import ChartSingularity, SceneError
from contact_system.kept import kept
from contact_system.plan import plan
from contact_system.scene import Scene, require_scene
from contact_system.surfaces import Quadric, Surface, UserSurface
from contact_system.system import SceneSystem
from contact_system.theory.gain import LAWS

from .contact_variables import contact_rows
from .model import (
    CHART_STATES,
    COORDINATES,
    INPUTS,
    RESULTS,
    equations,
    frame_sizes,
    jacobian,
    kept_order,
    start_states,
    way_of,
)
from .quantities import METRE, NONE, SECOND, Unit, Variable, chart_units, per_second


@dataclass(frozen=True, eq=False)
class Table:
    """All variables of a scene.

    Attributes
    ----------
    scene : Scene
    rows : list of Variable
        By reference, ascending.
    parameter_first : dict
        References of ``gain``, ``profile`` and ``object``: where their numbers begin.
    finger_first : list of int
        Reference of the first number of each contact's finger.
    window_first : int
        Reference of the first number of the scene's disturbance windows, four each.
    blocks : list of int
        Reference of the first number of each contact.
    frames : bool
        Whether the states are moving frames, not charts.
    arrays : bool
        Whether FMI 3 sees arrays.
    measured : str
        Of `MEASUREMENTS`.
    """

    scene: Scene
    rows: list[Variable]
    parameter_first: dict[str, int]
    finger_first: list[int]
    window_first: int
    blocks: list[int]
    frames: bool
    arrays: bool
    measured: str

    @kept
    def _by_name(self) -> dict[str, Variable]:
        return {v.name: v for row in self.rows for v in (row, *row.scalars())}

    def __getitem__(self, name: str) -> Variable:
        """The variable of an FMI 2 or FMI 3 name; KeyError where there is none."""
        return self._by_name[name]

    @property
    def n_values(self) -> int:
        """Length of the component's array of values."""
        return self.blocks[-1] + self.block_size(len(self.blocks) - 1)

    def n_states(self, contact: int) -> int:
        """Number of a contact's states."""
        if not self.frames:
            return CHART_STATES
        return sum(frame_sizes(self.scene.contacts[contact].finger, self.scene.object)) + 4

    @property
    def n_measured(self) -> int:
        """Number of a contact's inputs of what is measured."""
        return MEASUREMENTS[self.measured]

    def block_size(self, contact: int) -> int:
        """Number of a contact's values."""
        coordinates = COORDINATES if self.frames else 0
        return (
            INPUTS
            + self.n_measured
            + 2 * self.n_states(contact)
            + coordinates
            + sum(RESULTS.values())
        )

    @property
    def states(self) -> list[int]:
        """References of the continuous states."""
        return [
            block + INPUTS + self.n_measured + k
            for i, block in enumerate(self.blocks)
            for k in range(self.n_states(i))
        ]

    @kept
    def sizes(self) -> list[int]:
        """How many values each reference has; 0 inside an array."""
        rows = self.rows if self.arrays else self.scalars()
        return [size for v in rows for size in (v.size, *[0] * (v.size - 1))]

    @kept
    def start_values(self) -> np.ndarray:
        """The values before initialization: starts, and 0 for what is calculated, (n_values,)."""
        values = np.zeros(self.n_values)
        for row in self.rows:
            if row.start:
                values[row.reference : row.reference + row.size] = row.start
        return values

    def scalars(self) -> list[Variable]:
        """Every variable as FMI 2 sees it, by reference."""
        return self._scalars

    @kept
    def _scalars(self) -> list[Variable]:
        return [scalar for row in self.rows for scalar in row.scalars()]

    @kept
    def orders(self) -> list[tuple[int, int]]:
        """References of pairs of a surface's numbers, as `model.kept_order` has them."""
        scene, first = self.scene, self.parameter_first["object"]
        surfaces = [(first, scene.object)]
        surfaces += [(at, c.finger) for at, c in zip(self.finger_first, scene.contacts)]
        return [(at + i, at + j) for at, surface in surfaces for i, j in kept_order(surface)]

    @kept
    def state_nominals(self) -> np.ndarray:
        """Nominal values of the continuous states, contact by contact."""
        states = set(self.states)
        return np.array([v.nominal for v in self.scalars() if v.reference in states])

    def arguments(self, contact: int) -> list[int]:
        """References of the point and the constants of `model.equations`, in order; -1: none."""
        first, block = self.parameter_first, self.blocks[contact]
        own = self.scene.contacts[contact].finger
        law = [first["gain"], *_range(first["profile"], len(self.scene.profile.coefficients))]
        if self.scene.contacts[contact].legs:  # whose profiles are no variables
            law[1:] = [-1] * len(
                way_of(self.scene, self.scene.contacts[contact])[0].profile.coefficients
            )
        finger = _range(self.finger_first[contact], len(own.parameters))
        obj = _range(first["object"], len(self.scene.object.parameters))
        first_state = block + INPUTS + self.n_measured
        state, inputs = _range(first_state, self.n_states(contact)), _range(block, INPUTS)
        return [0, *state, *inputs, *law, *finger, *obj]


STATES = ("auto", "chart", "frame")
MEASUREMENTS = {"nothing": 0, "states": 10, "pose": 19}
"""What can be measured of a contact, and how many inputs that is, the trigger among them."""


def variable_table(
    scene: Scene,
    states: str = "auto",
    arrays: bool = False,
    measured: str = "nothing",
) -> Table:
    """The variables of a scene.

    Parameters
    ----------
    scene : Scene
    states : "auto", "chart" or "frame"
        What the states of Model Exchange, and the start values, are: charts, or moving frames, in
        whose way no pole stands. "auto": frames where a surface has no chart, or where a path comes
        near a pole of one.
    arrays : bool
        Whether FMI 3 sees vectors and matrices instead of scalars.
    measured : "nothing", "states" or "pose"
        Of what there are inputs, from which a trigger lets contacts go on: states, or the finger's
        pose and twist relative to the object.

    Raises
    ------
    SceneError
        A scene that no importer can step: sigma = 0 inside the window of an acceleration; names of
        a user's parameters that outputs have as well; charts where there are none.
    """
    require_scene(scene)
    if states not in STATES:
        raise SceneError(f"states = {states!r}: use one of {', '.join(STATES)}")
    if measured not in tuple(MEASUREMENTS):
        raise SceneError(f"measured = {measured!r}: use one of {', '.join(MEASUREMENTS)}")
    surfaces = [scene.object, *(c.finger for c in scene.contacts)]
    frames = states == "frame"
    if states == "auto":
        frames = not all(s.has_chart for s in surfaces) or _comes_near_pole(scene)
    for surface in surfaces:
        if not (frames or surface.has_chart):
            raise SceneError(
                f"{scene.title}: {surface!r} has no explicit chart f(u, v), in which states could "
                'be; give states="frame" or a ParametricSurface'
            )
        if MEASUREMENTS[measured] and not surface.has_chart:
            raise SceneError(
                f"{scene.title}: {surface!r} has no explicit chart f(u, v), in which states could "
                "be measured; leave measured out, or give a ParametricSurface"
            )
    n_profile = len(scene.profile.coefficients)
    ways = (way_of(scene, contact) for contact in scene.contacts)
    most = max(n_profile, *(len(way[0].profile.coefficients) for way in ways))
    if most > MOST_COEFFICIENTS:
        raise SceneError(
            f"{scene.title}: a profile has {most} coefficients, and an FMU holds "
            f"{MOST_COEFFICIENTS}; give a profile of a lower degree"
        )
    names = _parameter_names(scene)
    law = [(x, None) for x in (scene.gain.value, *scene.profile.coefficients)]
    law.append((1.0, None))
    values = [*law, *((x, surface) for surface in surfaces for x in surface.parameters)]
    rows = [
        Variable("time", 0, "independent", "continuous", None, "Simulation time", SECOND),
        *(_parameter(scene, n, 1 + k, *x) for k, (n, x) in enumerate(zip(names, values))),
    ]
    first = {"gain": 1, "profile": 2, "scale": 2 + n_profile, "object": 3 + n_profile}
    fingers, at = [], first["object"] + len(scene.object.parameters)
    for contact in scene.contacts:
        fingers.append(at)
        at += len(contact.finger.parameters)
    rows += _window_rows(scene, at)
    table = Table(scene, rows, first, fingers, at, [], frames, arrays, measured)
    at += 4 * len(scene.disturbances)
    for i in range(len(scene.contacts)):
        table.blocks.append(at)
        at += table.block_size(i)
    for i in range(len(scene.contacts)):
        rows += contact_rows(table, i, _known(table, i))
    _require_names(table)
    return table


MOST_COEFFICIENTS = 48
NEAR = 0.3
"""Sine of the angle from a pole, or a Lame coefficient over a body's size. Euler's method, with the
step that the file says, is lost in charts on D2, which comes as near as 0.268, and gets through on
K1 and K2, 0.309."""


def _comes_near_pole(scene: Scene) -> bool:
    """Whether a path comes near a pole or an umbilic of a chart."""
    try:
        states = plan(scene).states(np.linspace(0.0, scene.duration, 401))
    except ChartSingularity:
        return True
    for i, contact in enumerate(scene.contacts):
        for surface, k in ((contact.finger, 0), (scene.object, 4)):
            least = np.min(surface.lame(*states[:, i, k : k + 2].T))
            if surface.chart.singular_at != "" and least < NEAR * surface.size:
                return True
    return False


# --- parameters ----------------------------------------------------------------------------------


def _parameter_names(scene: Scene) -> list[str]:
    """Those of `SceneSystem`, without the sizes of the bodies, which follow their numbers."""
    names = iter(SceneSystem(scene, "frame").parameter_names)
    kept = [*islice(names, 1 + len(scene.profile.coefficients)), "disturbances.scale"]
    for surface in (scene.object, *(c.finger for c in scene.contacts)):
        kept += islice(names, len(surface.parameters))
        next(names)
    return kept


def _require_names(table: Table) -> None:
    """Refuse two variables of one name, in FMI 3 or in FMI 2."""
    for names in ([row.name for row in table.rows], [v.name for v in table.scalars()]):
        name, count = Counter(names).most_common(1)[0]
        if count > 1:
            raise SceneError(
                f"{table.scene.title}: two variables of the FMU would be called {name}; "
                f"give the surface's parameter '{name.rpartition('.')[2]}' another name"
            )


def _parameter(
    scene: Scene, name: str, reference: int, value: float, surface: Surface | None
) -> Variable:
    """A row for one of `SceneSystem.parameter_names`; indices count from 1 here."""
    name = _counted_from_one(name)
    owner, _, last = name.rpartition(".")
    unit: Unit | None = METRE
    variability, low, nominal, text = "fixed", None, None, f"Surface of {owner}: {last}"
    if owner == "gain":
        power = LAWS[scene.gain.law].power  # lam = gain sigma^power, 1/s
        unit, low = (-power, power - 1, 0), 0.0
        variability, text = "tunable", f"Gain of the law '{scene.gain.law}'"
    elif owner == "disturbances":
        unit, text = NONE, "Factor of the scene's own disturbances; 0 leaves them out"
    elif not owner:
        power = int(last[len("profile[") : -1]) - 1
        unit, text = (1, -1 - power, 0), f"Path profile sigma(t), coefficient of t^{power}"
    elif isinstance(surface, (UserSurface, Quadric)):
        unit = None
    else:
        low, nominal = min(1e-6, 1e-3 * value), value  # m
    named = (name, reference, "parameter", variability, "exact", text, unit, (value,))
    return Variable(*named, minimum=low, nominal=nominal or None)


def _window_rows(scene: Scene, at: int) -> Iterator[Variable]:
    """Start, stop and components of each of the scene's disturbances."""
    for k, d in enumerate(scene.disturbances):
        i = int(d.contact)
        surface = scene.contacts[i].finger if d.slot == 0 else scene.object
        units = [per_second(unit, 2 if d.slot < 2 else 1) for unit in chart_units(surface)]
        what = f"disturbance of contact {i + 1}, {d.kind}"
        for j, (name, unit, value) in enumerate(
            (
                ("start", SECOND, d.start),
                ("stop", SECOND, d.stop),
                ("u", units[0], d.value[0]),
                ("v", units[1], d.value[1]),
            )
        ):
            text = (
                f"{name.capitalize()} of the {what}" if j < 2 else f"Component {name} of the {what}"
            )
            named = (f"disturbance[{k + 1}].{name}", at + 4 * k + j, "parameter", "fixed", "exact")
            yield Variable(*named, text, unit, (float(value),), minimum=0.0 if j < 2 else None)


def _counted_from_one(name: str) -> str:
    name = name.replace("contacts[", "contact[")
    head, *tail = name.split("[")
    for part in tail:
        index, rest = part.split("]", 1)
        head += f"[{int(index) + 1}]{rest}"
    return head


# --- dependencies --------------------------------------------------------------------------------


def _known(table: Table, i: int) -> list[tuple[int, ...]]:
    """For each result of a contact, references of what it depends on.

    From exact derivatives at sample points: the expression's own structure would name too much. A
    path velocity of the object passes through V = R_0 W_1 - a_2, and R_0 W_1 - V depends on nothing
    but a_2 after all.
    """
    scene, n_states = table.scene, table.n_states(i)
    finger, obj = scene.contacts[i].finger, scene.object
    way = [s for s in way_of(scene, scene.contacts[i]) if s.stop < math.inf]
    longest = max(way, key=lambda s: s.profile.arc_length(s.stop - s.start))
    profile = longest.profile.coefficients
    made = equations(finger, obj, scene.gain.law, len(profile), table.frames)
    random = np.random.default_rng(1)
    start = start_states(scene, scene.contacts[i], table.frames)
    step = np.full(n_states, 0.02)
    if not table.frames:
        step[[2, 3, 4, 7, 8, 9, 10]] = 0.18
    scale = np.ones(n_states)
    if table.frames:
        clear = np.abs(start) > 1e-6
        scale = np.where(clear, start, np.abs(start[clear]).min())
    constants = [scene.gain.value + 1.0, *profile, *finger.parameters]
    constants += obj.parameters
    arguments = table.arguments(i)
    found = np.zeros((made.n_out, len(arguments)), dtype=bool)
    for t in (longest.stop - longest.start) * np.array([0.21, 0.52, 0.83]):
        # off the start, where symmetry hides dependencies, and inside any chart it is in
        state = start + step * random.standard_normal(n_states) * scale
        state[-4:] += 0.1 * random.standard_normal(4) if table.frames else 0.0
        at = np.array([t, *state, *random.standard_normal(INPUTS), *constants])
        values = np.abs(jacobian(made, at[: made.n_in], at[made.n_in :]) * np.where(at == 0, 1, at))
        largest = np.maximum(values.max(axis=1, keepdims=True), 1e-300)
        found |= ~(values <= 1e-12 * largest)  # a NaN says that there is a dependence
    first_input = 1 + n_states
    inputs = slice(first_input, first_input + INPUTS)
    found[made.n_out - 3 - 2, inputs] = True  # disturbance.active, which jumps
    behind = [[reference] * (reference >= 0) for reference in arguments]
    for k, d in enumerate(scene.disturbances):
        for axis in range(2 if d.contact == i else 0):
            own, factor = table.window_first + 4 * k, table.parameter_first["scale"]
            behind[first_input + 2 * d.slot + axis] += [own, own + 1, own + 2 + axis, factor]
    return [tuple(sorted({r for j in np.flatnonzero(row) for r in behind[j]})) for row in found]


def _range(first: int, count: int) -> list[int]:
    return list(range(first, first + count))
