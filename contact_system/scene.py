"""A scene: which bodies touch where, how the contacts move, what disturbs them.

Everything a user can get wrong is checked here, once, when the object is built. The messages name
the scene, the contact, the key, the value and the remedy. Contacts, disturbances and `contacts[0]`
count from 0, in Python as in scene files (`scene_files`).
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import struct
from collections.abc import Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .charts import Chart
from .checks import did_you_mean, finite_number, finite_numbers, is_plain, known_keys, naming
from .errors import ContactSystemError, SceneError
from .kept import kept
from .profile import Contraction, Gain, Numbers, Profile, contraction
from .surfaces import Surface

Pair = tuple[float, float]

ROLLING = "rolling"
REST = "rest"
ALL = "all"


def _pair(value: Any, what: str, words: Sequence[str] = ()) -> Pair:
    if is_plain(value) and len(value) == 2:
        return value
    choice = "".join(f' or "{word}"' for word in words)
    remedy = f"{what} = {value!r}: give two numbers{choice}"
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise SceneError(remedy)
    pair = finite_numbers(value, what)
    if len(pair) != 2:
        raise SceneError(remedy)
    return pair


def _surface(value: Any, what: str) -> Surface:
    if not isinstance(value, Surface):
        raise SceneError(f"{what} = {value!r}: give a surface, such as Sphere(0.04)")
    return value


def _text(value: Any, what: str) -> str:
    if not isinstance(value, str):
        raise SceneError(f"{what} = {value!r}: give a text in quotes")
    return value


MANY_TURNS = 1e3  # [rad]: psi keeps 13 digits of a turn
MANY_PLACES = 16  # on one surface, from which on arrays are faster
GIVEN = 9  # numbers that say where and how fast a contact starts
PACK = struct.Struct(f"{GIVEN}d").pack


# --- the parts of a scene ----------------------------------------------------------------------


def _rolled(angle: float, w: Pair) -> Pair:
    """R_psi w, before V is worked out from it and rounding told from slip."""
    c, s = math.cos(angle), math.sin(angle)
    return c * w[0] - s * w[1], -s * w[0] - c * w[1]


@dataclass(frozen=True)
class Contact:
    """One finger on the object, and how their contact starts to move.

    Velocities are path velocities (per metre of s), so sigma may start at zero.

    Parameters
    ----------
    finger : Surface
        The finger (body 1).
    object_at, finger_at : (float, float)
        Chart coordinates (u, v) of the contact on the object and on the finger (rad, or the
        chart's own units). A scene brings them into the chart's regular range: a point with an
        inward frame, such as (-1.57, 2.44) on a sphere, becomes the same point with the frame the
        equations assume, and the velocities are read in that frame. A triaxial ellipsoid's chart
        covers it twice: there velocities, angle and disturbances are turned with the frame.
    angle : float
        psi at t = 0, the contact angle between the two frames [rad].
    finger_velocity : (float, float) or "rolling"
        M1 dq1/ds in the finger's frame E1, no unit: its length times sigma is the speed of the
        contact point on the finger, m/s. "rolling": the finger's curve is not planned
        but follows from rolling imposed on the object's (eq. `corollary`).
    object_velocity : (float, float), "rolling" or "rest"
        M2 dq2/ds in the object's frame E2, no unit. "rolling": no slip at the start;
        "rest": the contact point on the object starts at rest, so the finger slides.
    name : str
        For messages and pictures.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    finger: Surface
    object_at: Pair
    finger_at: Pair = (math.pi / 2, 0.0)
    angle: float = 0.0
    finger_velocity: Pair | str = (2**-0.5, 2**-0.5)
    object_velocity: Pair | str = ROLLING
    name: str = ""

    if TYPE_CHECKING:  # the fields say what is kept, this what may be given

        def __init__(
            self,
            finger: Surface,
            object_at: Numbers,
            finger_at: Numbers = ...,
            angle: float = ...,
            finger_velocity: Numbers | str = ...,
            object_velocity: Numbers | str = ...,
            name: str = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        _text(self.name, "name")
        _surface(self.finger, "finger")
        put = object.__setattr__
        put(self, "object_at", _pair(self.object_at, "object_at"))
        put(self, "finger_at", _pair(self.finger_at, "finger_at"))
        put(self, "angle", finite_number(self.angle, "angle"))
        if abs(self.angle) > MANY_TURNS:
            raise SceneError(
                f"angle = {self.angle!r}: beyond {MANY_TURNS:g} rad a double resolves an angle "
                "within its turn too poorly; subtract whole turns"
            )
        for key, words in (("finger_velocity", (ROLLING,)), ("object_velocity", (ROLLING, REST))):
            value = getattr(self, key)
            if not (isinstance(value, str) and value in words):
                put(self, key, _pair(value, key, words))
        if self.follows and isinstance(self.object_velocity, str):
            raise SceneError(
                f'finger_velocity = "rolling" lets the finger follow the object\'s curve, which '
                f'object_velocity = "{self.object_velocity}" does not give; '
                "give object_velocity as two numbers"
            )

    def start_numbers(self) -> tuple[float, ...]:
        """The 9 numbers of a :class:`.starts.Start` in their order; words become numbers here."""
        own: Any = self.finger_velocity
        given: Any = self.object_velocity
        if isinstance(own, str):  # imposed: the other is a pair
            own = _rolled(self.angle, given)
        elif isinstance(given, str):
            given = _rolled(self.angle, own) if given == ROLLING else (0.0, 0.0)
        (u1, v1), (u2, v2) = self.finger_at, self.object_at
        return u1, v1, u2, v2, self.angle, own[0], own[1], given[0], given[1]

    @property
    def follows(self) -> bool:
        """True if the finger's curve follows from imposed rolling (the paper's corollary)."""
        return self.finger_velocity == ROLLING


@dataclass(frozen=True)
class Disturbance:
    """Something added to one contact's motion on the window [start, stop].

    Windows may overlap, also of one kind on one contact: their values add.

    Parameters
    ----------
    contact : int or "all"
        Index of the contact, from 0; a scene expands "all" to one disturbance a contact.
    start, stop : float
        The window [s], inside the scene's horizon.
    value : (float, float)
        Chart components of what is added.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    kind: ClassVar[str]
    """The name in scene files."""

    contact: int | str
    start: float
    stop: float
    value: Pair

    if TYPE_CHECKING:  # the fields say what is kept, this what may be given

        def __init__(
            self, contact: int | str, start: float, stop: float, value: Numbers
        ) -> None: ...

    def __post_init__(self) -> None:
        put, contact = object.__setattr__, self.contact
        if not (isinstance(contact, str) and contact == ALL):
            if isinstance(contact, bool) or not isinstance(contact, numbers.Integral):
                raise SceneError(f'contact = {contact!r}: give an index from 0, or "all"')
            put(self, "contact", int(contact))
        put(self, "start", finite_number(self.start, "start"))
        put(self, "stop", finite_number(self.stop, "stop"))
        put(self, "value", _pair(self.value, "value"))
        if not self.start < self.stop:
            raise SceneError(
                f"start = {self.start:g}, stop = {self.stop:g}: a window must stop after it "
                "starts; exchange them or make it longer"
            )


@dataclass(frozen=True, init=False)
class FingerAcceleration(Disturbance):
    """Adds `value` = (du, dv) to the finger's (u1", v1") [rad/s^2, or the chart's units].

    `contact` is its index from 0, or "all"; `start` and `stop` [s] lie inside the horizon.
    """

    kind: ClassVar[str] = "finger acceleration"


@dataclass(frozen=True, init=False)
class ObjectAcceleration(Disturbance):
    """Adds `value` = (du, dv) to the object's (u2", v2") [rad/s^2, or the chart's units].

    `contact` is its index from 0, or "all"; `start` and `stop` [s] lie inside the horizon.
    """

    kind: ClassVar[str] = "object acceleration"


@dataclass(frozen=True, init=False)
class ObjectRateOffset(Disturbance):
    """Adds `value` = (du, dv) to the object's (u2', v2') [rad/s, or the chart's units].

    `contact` is its index from 0, or "all"; `start` and `stop` [s] lie inside the horizon.
    It moves the contact point and counts in the twist, but is kept out of the feedback
    (the paper's dynamic examples).
    """

    kind: ClassVar[str] = "object rate offset"


DISTURBANCE_KINDS = (FingerAcceleration, ObjectAcceleration, ObjectRateOffset)
"""In the order in which systems and blocks take them as inputs."""


@dataclass(frozen=True)
class Turning:
    """Turning of the object in the world: rotation vector p(t) * axis.

    Parameters
    ----------
    axis : (float, float, float)
        The axis, used as given: its length scales the angle. (1, 1, 1) turns with angular
        velocity p'(t) (1, 1, 1).
    angle : sequence of float
        Coefficients of the polynomial p(t) [rad], lowest power first.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    axis: tuple[float, float, float]
    angle: tuple[float, ...]

    if TYPE_CHECKING:  # the fields say what is kept, this what may be given

        def __init__(self, axis: Numbers, angle: Numbers) -> None: ...

    def __post_init__(self) -> None:
        axis = finite_numbers(self.axis, "axis")
        if len(axis) != 3 or not any(axis):
            raise SceneError(f"axis = {self.axis!r}: give three numbers, not all zero")
        object.__setattr__(self, "axis", axis)
        object.__setattr__(self, "angle", finite_numbers(self.angle, "angle"))

    def rotation_vector(self, t) -> np.ndarray:
        """p(t) axis [rad], shape t.shape + (3,); t [s]."""
        return np.multiply.outer(np.asarray(Profile(self.angle)(t)), self.axis)

    def angular_velocity(self, t) -> np.ndarray:
        """p'(t) axis [rad/s], shape t.shape + (3,); t [s]."""
        return np.multiply.outer(np.asarray(Profile(self.angle).rate(t)), self.axis)


# --- the scene ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Bodies, contacts, path profile, gain law and disturbances over one horizon.

    Nothing looks at whether bodies meet elsewhere too, as fingers side by side may, or a finger
    that is wider than its bowl.

    Parameters
    ----------
    object : Surface
        The object (body 2).
    contacts : sequence of Contact
        At least one.
    profile : Profile
        sigma(t) [m/s]; not negative on the horizon.
    gain : Gain
        The gain law; the default is `Gain.time(100)`.
    duration : float
        The horizon is [0, duration] [s].
    disturbances : sequence of Disturbance
        Overlapping windows add.
    turning : Turning, optional
        How the object turns in the world. The contacts move relative to the object and do not
        depend on it.
    name, description : str
        For messages and pictures.
    source : str
        Where the scene was read from; not compared.
    paper : mapping
        What the paper reports: ``figure`` and ``reports``, texts; ``recovery_time``, within which
        slip is rejected [s]; ``lateral_force``, at which a contact saturates [N].
    chosen : sequence of str
        Keys whose values the paper leaves out, such as "contacts.finger_at".
    drake : mapping
        Contact physics: fields of `drake_plant`'s StationConfig, PlantConfig and DriverConfig, by
        whom they are checked.

    Raises
    ------
    SceneError
        Naming the scene, the contact, the key, the value and the remedy.
    """

    object: Surface
    contacts: Sequence[Contact]
    profile: Profile
    duration: float
    gain: Gain = Gain("time", 100.0)
    disturbances: Sequence[Disturbance] = ()
    turning: Turning | None = None
    name: str = ""
    description: str = ""
    source: str = field(default="", compare=False)
    paper: Mapping[str, Any] = field(default_factory=dict, hash=False)
    chosen: Sequence[str] = ()
    drake: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        try:  # not `naming`: a context manager would cost as much as the checks
            self._check_parts()
            self._check_motion()
            self._place_contacts()
            _check_chosen(self)
            _ = self.packed_starts, self.likeness  # ready, as initial states of integrators are
        except ContactSystemError as error:
            raise SceneError(f"{self.title}: {error}") from None

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: the fields, not what a planner has worked out and keeps with them."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    @kept
    def packed_starts(self) -> bytes:
        """:meth:`Contact.start_numbers` of each, as C takes them: (n_contacts, 9) doubles."""
        return b"".join([PACK(*contact.start_numbers()) for contact in self.contacts])

    @kept
    def likeness(self) -> Hashable:
        """What scenes share that differ only in where and how fast their contacts start."""
        gain, fingers = self.gain, []
        for contact in self.contacts:
            fingers.append(contact.finger.identity)
            if isinstance(contact.finger_velocity, str):
                fingers.append(True)  # it follows
        return (
            self.duration, self.profile.coefficients, gain.law, gain.value, self.object.identity,
            self.disturbances, *fingers,
        )  # fmt: skip

    def contraction(self) -> Contraction:
        """Where slip shrinks under the gain law, and the least eta that shrinks it throughout."""
        return contraction(self.profile, self.gain, self.duration)

    def replace(self, **changes: Any) -> Scene:
        """A copy with some fields changed, checked like any scene.

        Disturbances that are kept beside new contacts stay as this scene holds them: components at
        coordinates in the chart's regular range, whichever coordinates the contacts are given in.

        Raises
        ------
        SceneError
            If there is no such field, or the new scene is wrong.
        """
        known = [f.name for f in dataclasses.fields(self)]
        for key in changes:
            if key not in known:
                raise SceneError(f"a scene has no '{key}'{did_you_mean(key, known)}")
        made = dataclasses.replace(self, **changes)
        if "contacts" in changes and not {"object", "disturbances"} & set(changes):
            object.__setattr__(made, "disturbances", self.disturbances)
        return made

    def contact_name(self, index: int) -> str:
        """What tables and pictures call a contact: its name, or its index from 0."""
        if not isinstance(index, numbers.Integral) or not 0 <= index < len(self.contacts):
            raise SceneError(
                f"{self.title}: contact = {index!r}: give an index from 0 to "
                f"{len(self.contacts) - 1}"
            )
        return self.contacts[index].name or f"contact {index}"

    @property
    def title(self) -> str:
        """What messages call it."""
        return f"scene '{self.name}'" if self.name else "scene"

    @property
    def window_edges(self) -> tuple[float, ...]:
        """Where windows of disturbances begin or end, ascending [s]."""
        return tuple(sorted({t for d in self.disturbances for t in (d.start, d.stop)}))

    @property
    def edges(self) -> tuple[float, ...]:
        """0, the window edges inside the horizon and the duration, ascending [s]."""
        return tuple(sorted({0.0, self.duration, *self.window_edges}))

    def _check_parts(self) -> None:
        """Types, and everything into its plain immutable form."""
        put = object.__setattr__
        _surface(self.object, "object")
        put(self, "contacts", _all_of(Contact, self.contacts, "contacts"))
        if not self.contacts:
            raise SceneError("contacts = []: a scene needs at least one contact")
        put(self, "disturbances", _all_of(Disturbance, self.disturbances, "disturbances"))
        for key, kind in (("profile", Profile), ("gain", Gain), ("turning", Turning)):
            value = getattr(self, key)
            if not isinstance(value, kind) and not (key == "turning" and value is None):
                raise SceneError(f"{key} = {value!r}: give a {kind.__name__}")
        for key in ("name", "description", "source"):
            _text(getattr(self, key), key)
        for key in ("paper", "drake"):
            put(self, key, _plain_table(getattr(self, key), key))
        known_keys(self.paper, PAPER_KEYS, "paper: ")
        for key, value in self.paper.items():
            (finite_number if key in PAPER_NUMBERS else _text)(value, f"paper: {key}")

    def _check_motion(self) -> None:
        """The horizon, sigma on it, and every window inside it."""
        put = object.__setattr__
        put(self, "duration", finite_number(self.duration, "duration"))
        if not self.duration > 0:
            raise SceneError(f"duration = {self.duration:g} s: give a horizon longer than 0 s")
        self.profile.check(self.duration)
        if not self.disturbances:
            return
        expanded: list[Disturbance] = []
        for k, disturbance in enumerate(self.disturbances):
            with naming(f"disturbances[{k}]"):
                expanded += self._on_contacts(disturbance)
        put(self, "disturbances", tuple(expanded))

    def _on_contacts(self, disturbance: Disturbance) -> list[Disturbance]:
        """The disturbance, checked against the scene, once a contact that it acts on."""
        count, d = len(self.contacts), disturbance
        if d.start < 0 or d.stop > self.duration:
            raise SceneError(
                f"start = {d.start:g}, stop = {d.stop:g}: the window is not inside the horizon "
                f"[0, {self.duration:g}] s; move it or change the duration"
            )
        indices = range(count) if isinstance(d.contact, str) else [d.contact]
        if not 0 <= indices[0] < count:
            raise SceneError(
                f"contact = {d.contact}: the scene has {count} contact{'s' * (count > 1)}, "
                f'counted from 0; use {f"0 to {count - 1}" if count > 1 else 0} or "all"'
            )
        for i in indices:
            if self.contacts[i].follows:
                raise SceneError(
                    f'contact = {i}: its finger_velocity = "rolling" imposes rolling, which '
                    "nothing can disturb; plan its finger_velocity or leave the disturbance out"
                )
        return [d if d.contact == i else dataclasses.replace(d, contact=i) for i in indices]

    def _place_contacts(self) -> None:
        """Every contact's coordinates into the charts' regular range."""
        contacts = list(self.contacts)
        turned: set[tuple[str, int]] = set()
        unplaced = self._unplaced()
        for i, body, known in unplaced:
            surface = self.object if body == "object" else contacts[i].finger
            contacts[i], half_turn = _placed(contacts[i], i, surface, body, known)
            if half_turn:
                turned.add((body, i))
        object.__setattr__(self, "contacts", tuple(contacts))
        if unplaced:
            self.__dict__.pop("packed_starts", None)  # of the coordinates as given
        if turned:
            moved = tuple(_turned(d, turned) for d in self.disturbances)
            object.__setattr__(self, "disturbances", moved)

    def _unplaced(self) -> list[tuple[int, str, Pair | None]]:
        """Contacts and bodies whose coordinates may have to change, and to what, if that is known.

        Many places on one surface are told at once; one by one where one of them is refused, so
        that it is refused by name.
        """
        contacts = self.contacts
        if len(contacts) == 1:
            return [(0, "object", None), (0, "finger", None)]
        fingers: dict[int, list[int]] = {}
        for i, contact in enumerate(contacts):
            fingers.setdefault(id(contact.finger), []).append(i)
        found: list[tuple[int, str, Pair | None]] = []
        starts = np.frombuffer(self.packed_starts).reshape(-1, GIVEN)
        everyone = [("object", list(range(len(contacts))))]
        for body, members in everyone + [("finger", members) for members in fingers.values()]:
            surface = self.object if body == "object" else contacts[members[0]].finger
            quick = surface.chart.metric_floor is not Chart.metric_floor
            if len(members) >= (MANY_PLACES if quick else 2):
                own = starts if len(members) == len(contacts) else starts[members]
                u, v = own.T[2:4] if body == "object" else own.T[0:2]
                with suppress(ContactSystemError):
                    us, vs = surface.canonical(u, v)
                    moved = np.flatnonzero((us != u) | (vs != v)).tolist()
                    found += [(members[k], body, (float(us[k]), float(vs[k]))) for k in moved]
                    continue
            found += [(i, body, None) for i in members]
        return sorted(found, key=lambda place: place[0])


def _all_of(kind: type, values: Any, what: str) -> tuple:
    # the usual kinds first: what an abstract class takes in costs more to find out
    if isinstance(values, (kind, str)) or not isinstance(values, (list, tuple, Iterable)):
        raise SceneError(f"{what} = {values!r}: give a list")
    values = tuple(values)
    for k, value in enumerate(values):
        if not isinstance(value, kind):
            kinds = DISTURBANCE_KINDS if kind is Disturbance else (kind,)
            names = " or ".join(k.__name__ for k in kinds)
            raise SceneError(f"{what}[{k}] = {value!r}: give a {names}")
    return values


def _placed(
    contact: Contact, i: int, surface: Surface, body: str, known: Pair | None
) -> tuple[Contact, bool]:
    """The contact with its coordinates on one body in the regular range of that body's chart.

    Also whether both frame axes turned by pi on the way: the triaxial ellipsoid's chart covers it
    twice, (u, v) ~ (-u, pi - v), the second time with turned axes.
    """
    key = f"{body}_at"
    given: Pair = getattr(contact, key)
    try:
        at: Pair = surface.canonical(*given) if known is None else known
    except ContactSystemError as error:
        name = f" '{contact.name}'" if contact.name else ""
        raise SceneError(f"contacts[{i}]{name}: {key} = {given}: {error}") from None
    if at == given:
        return contact, False
    for name, value, here in zip("uv", given, at):
        if value != here and abs(value) > MANY_TURNS:
            raise SceneError(
                f"contacts[{i}]: {key}: {name} = {value!r}: beyond {MANY_TURNS:g} rad a "
                "double resolves an angle within its turn too poorly; subtract whole turns"
            )
    half_turn = surface.double_cover and bool(surface.align(*at, *given)[2])
    if half_turn:
        contact = _half_turn(contact, f"{body}_velocity")
    moved: dict[str, Any] = {key: at}
    return dataclasses.replace(contact, **moved), half_turn


def _turned(disturbance: Disturbance, turned: set[tuple[str, int]]) -> Disturbance:
    """The disturbance with its chart components in the frame its contact has now."""
    body = "finger" if isinstance(disturbance, FingerAcceleration) else "object"
    if (body, disturbance.contact) not in turned:
        return disturbance
    u, v = disturbance.value
    return dataclasses.replace(disturbance, value=(-u, -v))


def _half_turn(contact: Contact, velocity: str) -> Contact:
    """The same contact seen from a frame turned by pi about the normal."""
    value = getattr(contact, velocity)
    turned: dict[str, Any] = {"angle": math.remainder(contact.angle + math.pi, 2 * math.pi)}
    if not isinstance(value, str):
        turned[velocity] = (-value[0], -value[1])
    return dataclasses.replace(contact, **turned)


# --- keys of scene files -----------------------------------------------------------------------

PAPER_KEYS = ("figure", "reports", "recovery_time", "lateral_force")
PAPER_NUMBERS = PAPER_KEYS[2:]

SCENE_KEYS = (
    "name", "description", "duration", "profile", "gain", "chosen",
    "turning", "object", "contacts", "disturbances", "paper", "drake",
)  # fmt: skip
CONTACT_KEYS = tuple(f.name for f in dataclasses.fields(Contact))
TURNING_KEYS = tuple(f.name for f in dataclasses.fields(Turning))
DISTURBANCE_KEYS = ("kind", *(f.name for f in dataclasses.fields(Disturbance)))


def _plain_table(table: Any, what: str) -> dict[str, Any]:
    """A copy of a table in TOML's own types, with only finite numbers."""
    if not isinstance(table, (dict, Mapping)):
        raise SceneError(f"{what} = {table!r}: give a table")
    for key in table:
        _text(key, f"{what}: key")
    return {key: _plain(value, f"{what}.{key}") for key, value in table.items()}


def _plain(value: Any, what: str) -> Any:
    if isinstance(value, (bool, str)):
        return value
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        return finite_number(value, what)
    if isinstance(value, Mapping):
        return _plain_table(value, what)
    if isinstance(value, Iterable):
        return [_plain(x, f"{what}[{k}]") for k, x in enumerate(value)]
    raise SceneError(f"{what} = {value!r}: give a number, a text, a list or a table")


def _check_chosen(scene: Scene) -> None:
    """Every entry of `chosen` names a key that a scene file has."""
    object.__setattr__(scene, "chosen", _all_of(str, scene.chosen, "chosen"))
    if not scene.chosen:
        return
    below: dict[str, Iterable[str]] = {
        "contacts": CONTACT_KEYS,
        "disturbances": DISTURBANCE_KEYS,
        "turning": TURNING_KEYS,
        "gain": ("law", "eta", "rho"),
        "paper": scene.paper,
        "drake": scene.drake,
    }
    for k, path in enumerate(scene.chosen):
        key, _, rest = path.partition(".")
        known = SCENE_KEYS if key not in SCENE_KEYS or not rest else below.get(key, (rest,))
        part = key if known is SCENE_KEYS else rest
        if part not in known:
            raise SceneError(
                f"chosen[{k}] = '{path}': there is no key '{part}'{did_you_mean(part, known)}; "
                'write it like "contacts.finger_at"'
            )


def acting(scene: Scene, t: float) -> np.ndarray:
    """What the windows add on the interval that begins at t: (n_contacts, 6), chart components.

    Two numbers each, in the order of `DISTURBANCE_KINDS`.
    """
    found = np.zeros((len(scene.contacts), 2 * len(DISTURBANCE_KINDS)))
    for d in scene.disturbances:
        if d.start <= t < d.stop:
            k = 2 * DISTURBANCE_KINDS.index(type(d))
            found[int(d.contact), k : k + 2] += d.value
    return found


def refuse_rest(scene: Scene, where: str, start: float, stop: float) -> None:
    """Raise a SceneError where sigma = 0 under an acceleration: dq/ds would have to be infinite."""
    inside = [t for t in scene.profile.zeros(scene.duration) if start <= t <= stop]
    if inside:
        raise SceneError(
            f"{where}: sigma = 0 at t = {inside[0]:g} s while an acceleration acts, which would "
            "make the path velocity dq/ds infinite; accelerate while sigma > 0, or add a small "
            "constant to the profile"
        )


def require_scene(scene: Any) -> None:
    """Raise a SceneError where something else is given, such as a scene's name."""
    if not isinstance(scene, Scene):
        raise SceneError(f'scene = {scene!r:.80}: give a Scene, such as load_scene("K4")')
