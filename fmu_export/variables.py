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
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from contact_system.errors import SceneError
from contact_system.kept import kept
from contact_system.scene import Contact, Scene, require_scene
from contact_system.scene import speed as speed_along
from contact_system.surfaces import Quadric, Surface, UserSurface
from contact_system.system import SceneSystem
from contact_system.theory.gain import LAWS

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

SMALL = 0.1
"""Nominal value of angles and path velocities: solvers take their absolute tolerances from it."""

Unit = tuple[int, int, int]
"""Exponents of metre, second and radian."""

METRE, RADIAN, NONE = (1, 0, 0), (0, 0, 1), (0, 0, 0)
_PLAIN_CHARTS = {
    "FlatChart": (METRE, METRE),
    "OffsetPlaneChart": (METRE, METRE),
    "RoundCylinderChart": (RADIAN, METRE),
    "EllipticCylinderChart": (RADIAN, METRE),
    "HyperbolicCylinderChart": (RADIAN, METRE),
}


@dataclass(frozen=True)
class Variable:
    """One row of the table.

    Attributes
    ----------
    name : str
        In FMI 3, and in FMI 2 if it is a scalar.
    reference : int
        Value reference: index of the first element in the component's values.
    causality, variability : str
    initial : str or None
        None for inputs and time, as the standard wants.
    description : str
    unit : (int, int, int) or None
        Exponents of m, s, rad; None where a user's chart does not say.
    start : tuple of float
        One value an element; empty where the value is calculated.
    elements : tuple of str
        Names of the elements in FMI 2, row by row; empty for a scalar.
    shape : tuple of int
        () for a scalar.
    minimum, nominal : float or None
    derivative : int or None
        Reference of the variable whose time derivative this is.
    known : tuple of tuple of int
        For each element, references of the elements that it depends on, itself left out: inputs,
        states, parameters, time. Empty where the value is not a result.
    """

    name: str
    reference: int
    causality: str
    variability: str
    initial: str | None
    description: str
    unit: Unit | None = NONE
    start: tuple[float, ...] = ()
    elements: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()
    minimum: float | None = None
    nominal: float | None = None
    derivative: int | None = None
    known: tuple[tuple[int, ...], ...] = ()

    @property
    def size(self) -> int:
        """Number of elements."""
        return len(self.elements) or 1

    @property
    def kind(self) -> str:
        """When it is set, if ever: "fixed", "tunable", "input", "independent", "exact" (a start
        value) or "calculated"."""
        if self.causality == "parameter":
            return self.variability
        if self.causality in ("input", "independent"):
            return self.causality
        return self.initial or "calculated"

    def scalars(self) -> Iterator[Variable]:
        """The variables of FMI 2 in this row."""
        if not self.shape:
            yield self
            return
        for i, name in enumerate(self.elements):
            yield replace(
                self,
                name=name,
                reference=self.reference + i,
                start=self.start[i : i + 1],
                elements=(),
                shape=(),
                derivative=None if self.derivative is None else self.derivative + i,
                known=self.known[i : i + 1],
            )


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
    measured : bool
        Whether there are inputs of measured states.
    """

    scene: Scene
    rows: list[Variable]
    parameter_first: dict[str, int]
    finger_first: list[int]
    window_first: int
    blocks: list[int]
    frames: bool
    arrays: bool
    measured: bool

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
        """Number of a contact's inputs of measured states."""
        return MEASURED if self.measured else 0

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


def variable_table(
    scene: Scene, states: str = "auto", arrays: bool = False, measured: bool = False
) -> Table:
    """The variables of a scene.

    Parameters
    ----------
    scene : Scene
    states : "auto", "chart" or "frame"
        What the states of Model Exchange, and the start values, are: charts, or moving frames, in
        whose way no pole stands. "auto": charts where all surfaces have one.
    arrays : bool
        Whether FMI 3 sees vectors and matrices instead of scalars.
    measured : bool
        Whether there are inputs of measured states, from which a trigger lets contacts go on.

    Raises
    ------
    SceneError
        A scene that no importer can step: sigma = 0 inside the window of an acceleration; names of
        a user's parameters that outputs have as well; charts where there are none.
    """
    require_scene(scene)
    if states not in STATES:
        raise SceneError(f"states = {states!r}: use one of {', '.join(STATES)}")
    surfaces = [scene.object, *(c.finger for c in scene.contacts)]
    frames = states == "frame" or (states == "auto" and not all(s.has_chart for s in surfaces))
    for surface in surfaces:
        if not (frames or surface.has_chart):
            raise SceneError(
                f"{scene.title}: {surface!r} has no explicit chart f(u, v), in which states could "
                'be; give states="frame" or a ParametricSurface'
            )
        if measured and not surface.has_chart:
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
        Variable("time", 0, "independent", "continuous", None, "Simulation time", (0, 1, 0)),
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
        rows += _contact_rows(table, i, _known(table, i))
    _require_names(table)
    return table


MOST_COEFFICIENTS = 48


def unit_name(unit: Unit) -> str:
    """Such as "rad/s2"; "1" where nothing is left."""
    over, under = "", ""
    for symbol, exponent in zip(("m", "rad", "s"), (unit[0], unit[2], unit[1])):
        text = symbol + (str(abs(exponent)) if abs(exponent) > 1 else "")
        over, under = (over + text * (exponent > 0), under + text * (exponent < 0))
    return (over or "1") + ("/" + under if under else "")


def chart_units(surface: Surface) -> tuple[Unit | None, Unit | None]:
    """Units of u and v; None where a user's chart does not say."""
    if isinstance(surface, UserSurface):
        u, v = (RADIAN if period else None for period in surface.periods())
        return u, v
    return _PLAIN_CHARTS.get(surface.chart.__name__, (RADIAN, RADIAN))


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
        units = [_per_second(unit, 2 if d.slot < 2 else 1) for unit in chart_units(surface)]
        what = f"disturbance of contact {i + 1}, {d.kind}"
        for j, (name, unit, value) in enumerate(
            (
                ("start", (0, 1, 0), d.start),
                ("stop", (0, 1, 0), d.stop),
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


# --- contacts ------------------------------------------------------------------------------------


XY, XYZ = ("x", "y"), ("x", "y", "z")


def _contact_rows(table: Table, i: int, known: list[tuple[int, ...]]) -> Iterator[Variable]:
    scene, contact, first = table.scene, table.scene.contacts[i], table.blocks[i]
    states = _frame_states(scene, contact) if table.frames else _states(scene, contact)
    derivatives = [_derivative(v, table.frames) for v in states]
    measured = _measured(scene, contact) if table.n_measured else []
    n_inputs = INPUTS + table.n_measured
    starts = [
        *[0.0] * INPUTS,
        *_measured_starts(contact)[: len(measured)],
        *start_states(scene, contact, table.frames).tolist(),
    ]
    results = [*(_coordinates(scene, contact) if table.frames else ()), *_outputs(scene, contact)]
    n_states, at = table.n_states(i), 0
    for v in (*_inputs(scene, contact), *measured, *states, *derivatives, *results):
        end, result = at + v.size, at - n_inputs - n_states
        derivative = first + at - n_states if 0 <= result < n_states else None
        yield replace(
            v,
            name=_of_contact(i, v.name),
            reference=first + at,
            start=tuple(starts[at:end]),
            elements=tuple(_of_contact(i, name) for name in v.elements),
            derivative=derivative,
            known=tuple(known[result : result + v.size]) if result >= 0 else (),
        )
        at = end


def _of_contact(i: int, name: str) -> str:
    head, inner = ("der(", name[4:]) if name.startswith("der(") else ("", name)
    return f"{head}contact[{i + 1}].{inner}"


def _quantity(
    name: str,
    axes: tuple[str, ...],
    unit: Unit | None,
    text: str,
    nominal: float | None = None,
    shape: tuple[int, ...] = (),
    kind: tuple[str, str | None] = ("output", "calculated"),
) -> Variable:
    """A row before it has a place, its names without ``contact[i].``."""
    elements = tuple(name + (axis if axis.startswith("[") else f".{axis}") for axis in axes)
    shape = shape or ((len(axes),) if axes else ())
    said = (name, 0, kind[0], "continuous", kind[1], text, unit, (), elements, shape)
    return Variable(*said, nominal=nominal)


def _inputs(scene: Scene, contact: Contact) -> Iterator[Variable]:
    for side, surface, quantity, power, to in (
        ("finger", contact.finger, "acceleration", 2, "second derivative"),
        ("object", scene.object, "acceleration", 2, "second derivative"),
        ("object", scene.object, "rate_offset", 1, "rate, not to the feedback,"),
    ):
        for axis, unit in zip("uv", chart_units(surface)):
            text = f"Added to the {to} of {axis} of the {side}"
            text += ", in addition to the scene's disturbance windows"
            name = f"{side}.{quantity}.{axis}"
            yield _quantity(name, (), _per_second(unit, power), text, kind=("input", None))


MEASURED = 10


def _measured(scene: Scene, contact: Contact) -> list[Variable]:
    """Inputs of a contact's measured states, as `Plan.states` has them, and the trigger."""
    rows = []
    for side, surface in (("finger", contact.finger), ("object", scene.object)):
        units = list(zip("uv", chart_units(surface)))
        for rate in ("", "_rate"):
            for axis, unit in units:
                text = f"Measured {'rate of ' * bool(rate)}{axis} of the contact on the {side}"
                unit = _per_second(unit, 1) if rate else unit
                name = f"measured.{side}.{axis}{rate}"
                rows.append(_quantity(name, (), unit, text, kind=("input", None)))
    text = "Measured contact angle psi"
    rows.append(_quantity("measured.angle", (), RADIAN, text, kind=("input", None)))
    text = "Co-Simulation goes on from what is measured when this changes to another number than 0"
    return [*rows, _quantity("measured.trigger", (), NONE, text, kind=("input", None))]


def _measured_starts(contact: Contact) -> list[float]:
    (u1, v1), (u2, v2) = contact.finger_at, contact.object_at
    return [u1, v1, 0.0, 0.0, u2, v2, 0.0, 0.0, contact.angle, 0.0]


def _states(scene: Scene, contact: Contact) -> list[Variable]:
    rows: list[tuple[str, tuple[str, ...], Unit | None, str, float]] = []
    for side, body, surface in (("finger", 1, contact.finger), ("object", 2, scene.object)):
        for axis, unit in zip("uv", chart_units(surface)):
            nominal = SMALL * surface.size if unit == METRE else SMALL
            text = f"Coordinate {axis} of the contact point on the {side}"
            rows.append((f"{side}.{axis}", (), unit, text, nominal))
        text = f"Angle in E{body} of a frame carried along the path by parallel transport"
        rows.append((f"{side}.frame_angle", (), RADIAN, text, SMALL))
        text = f"Path velocity of the {side}'s contact point, M{body} dq{body}/ds, in that frame"
        rows.append((f"{side}.velocity", XY, NONE, text, SMALL))
    text = "Contact angle psi between the contact frames E1 and E2"
    rows.append(("angle", (), RADIAN, text, SMALL))
    return [_quantity(*row, kind=("output", "exact")) for row in rows]


def _frame_states(scene: Scene, contact: Contact) -> list[Variable]:
    rows: list[tuple[str, tuple[str, ...], Unit | None, str, float]] = []
    sizes = frame_sizes(contact.finger, scene.object)
    for side, surface, size in zip(("finger", "object"), (contact.finger, scene.object), sizes):
        carried = f"frame carried along on the {side}"
        if size == 6:
            rows.append(
                (f"{side}.frame.point", XYZ, METRE, f"Origin of the {carried}", surface.size)
            )
            rows.append((f"{side}.frame.axis", XYZ, NONE, f"First axis of the {carried}", 1.0))
            continue
        for axis, unit in zip("uv", chart_units(surface)):
            nominal = SMALL * surface.size if unit == METRE else SMALL
            rows.append(
                (f"{side}.frame.{axis}", (), unit, f"Coordinate {axis} of the {carried}", nominal)
            )
        rows.append(
            (f"{side}.frame.angle", (), RADIAN, f"Angle in the chart of the {carried}", SMALL)
        )
    text = "Path velocity of the finger's contact point in its carried frame"
    rows.append(("frame.velocity", XY, NONE, text, SMALL))
    rows.append(("frame.slip", XY, NONE, "Slip over sigma in the object's carried frame", SMALL))
    return [_quantity(*row, kind=("output", "exact")) for row in rows]


def _coordinates(scene: Scene, contact: Contact) -> list[Variable]:
    """What charts say of carried frames, in the engine's order."""
    rows = []
    for side, surface in (("finger", contact.finger), ("object", scene.object)):
        units = chart_units(surface)
        for axis, unit in zip("uv", units):
            text = f"Coordinate {axis} of the contact point on the {side}"
            rows.append(_quantity(f"{side}.{axis}", (), unit, text))
        for axis, unit in zip("uv", units):
            text = f"Time derivative: Coordinate {axis} of the contact point on the {side}"
            rows.append(_quantity(f"der({side}.{axis})", (), _per_second(unit, 1), text))
    text = "Contact angle psi between the contact frames E1 and E2"
    return [*rows, _quantity("angle", (), RADIAN, text)]


def _derivative(state: Variable, local: bool) -> Variable:
    """Rates of coordinates are outputs, the other derivatives are local."""
    return replace(
        state,
        name=f"der({state.name})",
        elements=tuple(f"der({name})" for name in state.elements),
        description="Time derivative: " + state.description,
        unit=_per_second(state.unit, 1),
        causality="output" if state.name[-2:] in (".u", ".v") and not local else "local",
        initial="calculated",
        nominal=None,
    )


def _outputs(scene: Scene, contact: Contact) -> list[Variable]:
    finger, obj = contact.finger.size, scene.object.size
    times = np.linspace(0.0, scene.duration, 33)
    speed = max(speed_along(contact.way(scene.profile, scene.duration), times)) or None
    cells = tuple(f"[{a},{b}]" for a in (1, 2, 3) for b in (1, 2, 3))
    there, turning, moving = "in the object's frame", (0, -1, 1), (1, -1, 0)
    recovery = "Time in which slip falls to a hundredth at its present rate; at most 1e6 s"
    matrix = "Rotation matrix from the finger's frame to the object's"
    origin = "of the finger's frame " + there
    return [
        _quantity("slip", XY, moving, "Slip v_rel in E2", speed),
        _quantity("twist.angular", XYZ, turning, f"Angular velocity of the finger {there}"),
        _quantity("twist.linear", XYZ, moving, f"Velocity of the origin {origin}", speed),
        _quantity("pose.rotation", cells, NONE, matrix, shape=(3, 3)),
        _quantity("pose.position", XYZ, METRE, f"Origin {origin}", max(finger, obj)),
        _quantity("finger.point", XYZ, METRE, "Contact point in the finger's frame", finger),
        _quantity("object.point", XYZ, METRE, f"Contact point {there}", obj),
        _quantity(
            "path.speed", (), moving, "sigma, the speed of the contact along its path", speed
        ),
        _quantity("slip_speed", (), moving, "Length of the slip", speed),
        _quantity("disturbance.active", (), NONE, "1 while an input or a window acts, else 0"),
        _quantity("recovery_time", (), (0, 1, 0), recovery),
    ]


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
    constants = [scene.gain.value + 1.0, *profile, *finger.parameters]
    constants += obj.parameters
    arguments = table.arguments(i)
    found = np.zeros((made.n_out, len(arguments)), dtype=bool)
    for t in (longest.stop - longest.start) * np.array([0.21, 0.52, 0.83]):
        # off the start, where symmetry hides dependencies, and inside any chart it is in
        state = start + step * random.standard_normal(n_states) * np.where(table.frames, start, 1.0)
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
            own, scale = table.window_first + 4 * k, table.parameter_first["scale"]
            behind[first_input + 2 * d.slot + axis] += [own, own + 1, own + 2 + axis, scale]
    return [tuple(sorted({r for j in np.flatnonzero(row) for r in behind[j]})) for row in found]


def _range(first: int, count: int) -> list[int]:
    return list(range(first, first + count))


def _per_second(unit: Unit | None, times: int) -> Unit | None:
    return None if unit is None else (unit[0], unit[1] - times, unit[2])
