"""A scene: which bodies touch where, how the contacts move, what disturbs them; TOML in and out.

Everything a user can get wrong is checked here, once, when the object is built. The messages name
the scene (and file), the contact, the key, the value and the remedy. Contacts, disturbances and
`contacts[0]` count from 0, in Python as in scene files.

Scene files are TOML (see the bundled `scenes/*.toml`). Every number may be written as arithmetic
text, such as "2*pi/3".
"""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import numbers
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from contact_system.charts import Chart
from contact_system.errors import ContactSystemError, SceneError
from contact_system.expressions import parse
from contact_system.profile import (
    Contraction,
    Gain,
    Numbers,
    Profile,
    contraction,
    finite_number,
    finite_numbers,
    is_plain,
)
from contact_system.surfaces import Cylinder, Ellipsoid, Plane, Quadric, Sphere, Surface, Torus
from contact_system.user_surfaces import ImplicitSurface, ParametricSurface

Pair = tuple[float, float]

ROLLING = "rolling"
REST = "rest"
ALL = "all"


# --- messages ----------------------------------------------------------------------------------


@contextmanager
def _naming(place: str) -> Iterator[None]:
    """Put the place in front of every error of the package raised inside."""
    try:
        yield
    except ContactSystemError as error:
        raise SceneError(f"{place}: {error}") from None


def _nearest(word: object, known: Iterable[str]) -> str:
    """' (did you mean ...?)' with the nearest known word, or nothing."""
    by_lower = {k.lower(): k for k in known}
    close = difflib.get_close_matches(str(word).lower(), by_lower, n=1, cutoff=0.5)
    return f" (did you mean '{by_lower[close[0]]}'?)" if close else ""


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


# --- the parts of a scene ----------------------------------------------------------------------


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
        equations assume, and the velocities are read in that frame.
    angle : float
        psi at t = 0, the contact angle between the two frames [rad].
    finger_velocity : (float, float) or "rolling"
        M1 dq1/ds in the finger's frame E1, no unit. "rolling": the finger's curve is not planned
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
                f"angle = {self.angle!r}: beyond {MANY_TURNS:g} rad a double no longer tells well "
                "where in its turn an angle is; take whole turns off it"
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
        if contact != ALL:
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
    """Adds (du, dv) to the finger's (u1", v1") [rad/s^2, or the chart's units]."""

    kind: ClassVar[str] = "finger acceleration"


@dataclass(frozen=True, init=False)
class ObjectAcceleration(Disturbance):
    """Adds (du, dv) to the object's (u2", v2") [rad/s^2, or the chart's units]."""

    kind: ClassVar[str] = "object acceleration"


@dataclass(frozen=True, init=False)
class ObjectRateOffset(Disturbance):
    """Adds (du, dv) to the object's (u2', v2') [rad/s, or the chart's units].

    It moves the contact point and counts in the twist, but is kept out of the feedback
    (the paper's dynamic examples).
    """

    kind: ClassVar[str] = "object rate offset"


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
        What the paper reports; keys `PAPER_KEYS`.
    chosen : sequence of str
        Keys whose values the paper leaves out, such as "contacts.finger_at".
    drake : mapping
        Contact physics, passed through untouched.

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
        try:  # not `_naming`: a context manager would cost as much as the checks
            self._check_parts()
            self._check_motion()
            self._place_contacts()
            _check_chosen(self)
        except ContactSystemError as error:
            name = f"scene '{self.name}'" if self.name else "scene"
            raise SceneError(f"{name}: {error}") from None

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: the fields, not what a planner has worked out and keeps with them."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

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
                raise SceneError(f"a scene has no '{key}'{_nearest(key, known)}")
        made = dataclasses.replace(self, **changes)
        if "contacts" in changes and not {"object", "disturbances"} & set(changes):
            object.__setattr__(made, "disturbances", self.disturbances)
        return made

    @property
    def edges(self) -> tuple[float, ...]:
        """0, the window edges inside the horizon and the duration, ascending [s]."""
        windows = {t for d in self.disturbances for t in (d.start, d.stop)}
        return tuple(sorted({0.0, self.duration, *windows}))

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
        _known_keys(self.paper, PAPER_KEYS, "paper: ")
        for key, value in self.paper.items():
            (finite_number if key in _PAPER_NUMBERS else _text)(value, f"paper: {key}")

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
            with _naming(f"disturbances[{k}]"):
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
                f'counted from 0; use 0 to {count - 1} or "all"'
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
        contacts = []
        turned: set[tuple[str, int]] = set()
        known = self._places_at_once()
        for i, contact in enumerate(self.contacts):
            for body, surface in (("object", self.object), ("finger", contact.finger)):
                contact, half_turn = _placed(contact, i, surface, body, known.get((body, i)))
                if half_turn:
                    turned.add((body, i))
            contacts.append(contact)
        object.__setattr__(self, "contacts", tuple(contacts))
        if turned:
            moved = tuple(_turned(d, turned) for d in self.disturbances)
            object.__setattr__(self, "disturbances", moved)

    def _places_at_once(self) -> dict[tuple[str, int], Pair]:
        """Places on surfaces whose charts take a kernel to tell that a point is regular.

        Of all contacts of a surface in one call; none where one of them is refused, so that it is
        refused by name.
        """
        crowds: dict[tuple[str, int], list[int]] = {}
        if len(self.contacts) > 1:
            for i, contact in enumerate(self.contacts):
                for body, surface in (("object", self.object), ("finger", contact.finger)):
                    if surface.chart.metric_floor is Chart.metric_floor:
                        crowds.setdefault((body, id(surface)), []).append(i)
        known = {}
        for (body, _), members in crowds.items():
            first = self.contacts[members[0]]
            surface = self.object if body == "object" else first.finger
            given = np.array([getattr(self.contacts[i], f"{body}_at") for i in members])
            with suppress(ContactSystemError):
                u, v = surface.canonical(*given.T)
                known.update({(body, i): at for i, *at in zip(members, u.tolist(), v.tolist())})
        return {key: (at[0], at[1]) for key, at in known.items()}


def _all_of(kind: type, values: Any, what: str) -> tuple:
    # the usual kinds first: what an abstract class takes in costs more to find out
    if isinstance(values, (kind, str)) or not isinstance(values, (list, tuple, Iterable)):
        raise SceneError(f"{what} = {values!r}: give a list")
    values = tuple(values)
    for k, value in enumerate(values):
        if not isinstance(value, kind):
            raise SceneError(f"{what}[{k}] = {value!r}: give a {kind.__name__}")
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
                f"contacts[{i}]: {key}: {name} = {value!r}: beyond {MANY_TURNS:g} rad a double no "
                "longer tells well where in its turn an angle is; take whole turns off it"
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
"""What a scene's `paper` table may say: the figure's label in the paper, what it reports in words,
the time after the disturbance (or after t = 0) within which slip is reported rejected [s], and
the lateral force a contact saturates at [N]."""
_PAPER_NUMBERS = PAPER_KEYS[2:]

_SCENE_KEYS = (
    "name", "description", "duration", "profile", "gain", "chosen",
    "turning", "object", "contacts", "disturbances", "paper", "drake",
)  # fmt: skip
_CONTACT_KEYS = tuple(f.name for f in dataclasses.fields(Contact))
_TURNING_KEYS = tuple(f.name for f in dataclasses.fields(Turning))
_DISTURBANCES = {d.kind: d for d in (FingerAcceleration, ObjectAcceleration, ObjectRateOffset)}
_DISTURBANCE_KEYS = ("kind", *(f.name for f in dataclasses.fields(Disturbance)))
_GAINS = {"path": "eta", "time": "eta", "guaranteed": "rho"}
_SURFACES: dict[str, tuple[type, tuple[str, ...]]] = {
    "plane": (Plane, ()),
    "sphere": (Sphere, ("radius",)),
    "cylinder": (Cylinder, ("radius",)),
    "torus": (Torus, ("major", "minor")),
    "ellipsoid": (Ellipsoid, ("a", "b", "c")),
    "quadric": (Quadric, ("A", "sheet")),
    "parametric": (
        ParametricSurface,
        ("f", "parameters", "size", "u_range", "v_range", "u_period", "v_period"),
    ),
    "implicit": (ImplicitSurface, ("F", "center", "parameters", "size")),
}
_REQUIRED_SURFACE_KEYS = ("radius", "major", "minor", "a", "b", "c", "A", "f", "F")


def _known_keys(table: Mapping, known: Iterable[str], place: str = "") -> None:
    for key in table:
        if key not in known:
            raise SceneError(
                f"{place}key '{key}' is unknown{_nearest(key, known)}; "
                f"the keys here are {', '.join(known)}"
            )


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
        "contacts": _CONTACT_KEYS,
        "disturbances": _DISTURBANCE_KEYS,
        "turning": _TURNING_KEYS,
        "gain": ("law", "eta", "rho"),
        "paper": scene.paper,
        "drake": scene.drake,
    }
    for k, path in enumerate(scene.chosen):
        key, _, rest = path.partition(".")
        known = _SCENE_KEYS if key not in _SCENE_KEYS or not rest else below.get(key, (rest,))
        part = key if known is _SCENE_KEYS else rest
        if part not in known:
            raise SceneError(
                f"chosen[{k}] = '{path}': there is no key '{part}'{_nearest(part, known)}; "
                'write it like "contacts.finger_at"'
            )


# --- reading -----------------------------------------------------------------------------------


def scene_from_toml(text: str, source: str = "") -> Scene:
    """The scene a TOML text describes.

    Parameters
    ----------
    text : str
        TOML; the bundled scenes are the reference for its keys.
    source : str
        Where the text comes from, for messages; its stem is the name of a nameless scene.

    Raises
    ------
    SceneError
        Naming the source, the contact, the key, the value and the remedy.
    """
    with _naming(source or "TOML text"):
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise SceneError(f"is not valid TOML: {error}; correct that line") from None
        _known_keys(table, _SCENE_KEYS)
        _required(table, ("duration", "profile", "object", "contacts"))
        table = {"name": Path(source).stem, **table, "source": source}
        return Scene(**{key: _read(key, value) for key, value in table.items()})


def _read(key: str, value: Any) -> Any:
    """The field of a scene from its value in a file."""
    if key == "duration":
        return _numbers(value, key)
    if key == "profile":
        return Profile(_numbers(value, key))
    if key in ("contacts", "disturbances"):
        return _read_list(key, value, _read_contact if key == "contacts" else _read_disturbance)
    with _naming(key):
        if key == "object":
            return _read_surface(value)
        if key == "gain":
            return _read_gain(value)
        if key == "turning":
            _known_keys(_table(value), _TURNING_KEYS)
            _required(value, _TURNING_KEYS)
            return Turning(**{k: _numbers(x, k) for k, x in value.items()})
        if key == "paper":
            table = _table(value)
            return {k: _numbers(x, k) if k in _PAPER_NUMBERS else x for k, x in table.items()}
    return value


def _read_list(key: str, value: Any, read) -> list:
    if not isinstance(value, list):
        raise SceneError(f"{key} = {value!r}: write each one as a table under [[{key}]]")
    result = []
    for i, table in enumerate(value):
        with _naming(f"{key}[{i}]"):
            result.append(read(_table(table)))
    return result


def _read_contact(table: dict) -> Contact:
    _known_keys(table, _CONTACT_KEYS)
    _required(table, ("finger", "object_at"))
    fields = dict(table)
    with _naming("finger"):
        fields["finger"] = _read_surface(table["finger"])
    for key in ("object_at", "finger_at", "angle", "finger_velocity", "object_velocity"):
        words = (ROLLING, REST) if key.endswith("velocity") else ()
        if key in fields and isinstance(fields[key], str) and words:
            if fields[key] not in words:
                raise SceneError(
                    f"{key} = '{fields[key]}': give two numbers or one of {', '.join(words)}"
                    f"{_nearest(fields[key], words)}"
                )
        elif key in fields:
            fields[key] = _numbers(fields[key], key)
    return Contact(**fields)


def _read_disturbance(table: dict) -> Disturbance:
    _known_keys(table, _DISTURBANCE_KEYS)
    _required(table, _DISTURBANCE_KEYS)
    kind = _DISTURBANCES[_one_of(table["kind"], _DISTURBANCES, "kind")]
    values = {key: _numbers(table[key], key) for key in ("start", "stop", "value")}
    return kind(contact=table["contact"], **values)


def _read_gain(value: Any) -> Gain:
    table = _table(value)
    _required(table, ("law",))
    law = _one_of(table["law"], _GAINS, "law")
    parameter = _GAINS[law]
    _known_keys(table, ("law", parameter))
    _required(table, (parameter,))
    return Gain(law, _numbers(table[parameter], parameter))


def _read_surface(value: Any) -> Surface:
    table = _table(value)
    _required(table, ("surface",))
    name = _one_of(table["surface"], _SURFACES, "surface")
    kind, keys = _SURFACES[name]
    _known_keys(table, ("surface", *keys, "inside"), f"{name}: ")
    _required(table, [key for key in keys if key in _REQUIRED_SURFACE_KEYS], f"{name}: ")
    arguments = {key: value for key, value in table.items() if key != "surface"}
    for key, value in arguments.items():
        if key == "inside":
            if not isinstance(value, bool):
                raise SceneError(f"inside = {value!r}: write true or false")
        elif key == "parameters":
            with _naming(key):
                arguments[key] = {k: _numbers(x, k) for k, x in _table(value).items()}
        elif key not in ("f", "F"):
            arguments[key] = _numbers(value, key)
    with _naming(name):
        return kind(**arguments)


def _table(value: Any) -> dict:
    if not isinstance(value, dict):
        raise SceneError(f"{value!r} is not a table; write it like {{ key = value }}")
    return value


def _required(table: Mapping, keys: Iterable[str], place: str = "") -> None:
    for key in keys:
        if key not in table:
            raise SceneError(f"{place}key '{key}' is missing; add {key} = ...")


def _one_of(word: Any, known: Iterable[str], what: str) -> str:
    if not isinstance(word, str) or word not in known:
        raise SceneError(
            f"{what} = {word!r} is unknown{_nearest(word, known)}; use one of {', '.join(known)}"
        )
    return word


def _numbers(value: Any, what: str) -> Any:
    """Numbers of a file: itself, or a list of them; arithmetic texts evaluated."""
    if isinstance(value, list):
        return tuple(_numbers(x, f"{what}[{k}]") for k, x in enumerate(value))
    if isinstance(value, str):
        with _naming(what):
            value = parse(value, {})
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise SceneError(f"{what} = {value!r}: give a number")
    return value if what == "sheet" else finite_number(value, what)


# --- writing -----------------------------------------------------------------------------------


def scene_to_toml(scene: Scene) -> str:
    """TOML text of a scene; reading it back gives an equal scene, every float to the last bit.

    Raises
    ------
    SceneError
        If a surface was given as a Python function or is of a kind of your own, which a file
        cannot hold.
    """
    with _naming(f"scene '{scene.name}'"):
        gain = {"law": scene.gain.law, scene.gain.parameter: scene.gain.value}
        lines = _lines(
            {
                "name": scene.name,
                "description": scene.description,
                "duration": scene.duration,
                "profile": scene.profile.coefficients,
                "gain": gain,
                "chosen": scene.chosen,
            }
        )
        if scene.turning is not None:
            lines += ["", "[turning]", *_lines(dataclasses.asdict(scene.turning))]
        lines += ["", "[object]", *_lines(_surface_table(scene.object, "object"))]
        for i, contact in enumerate(scene.contacts):
            table = {key: getattr(contact, key) for key in _CONTACT_KEYS}
            table["finger"] = _surface_table(contact.finger, f"contacts[{i}]: finger")
            lines += ["", "[[contacts]]", *_lines(table)]
        for d in scene.disturbances:
            lines += ["", "[[disturbances]]"]
            lines += _lines({key: getattr(d, key) for key in _DISTURBANCE_KEYS})
        for key in ("paper", "drake"):
            if getattr(scene, key):
                lines += ["", f"[{key}]", *_lines(getattr(scene, key))]
    return "\n".join(lines) + "\n"


def _lines(table: Mapping[str, Any]) -> list[str]:
    return [f"{_toml_key(key)} = {_toml(value)}" for key, value in table.items()]


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml(key)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):  # JSON's escapes are TOML's, but for DEL
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_lines(value)) + " }"
    return "[" + ", ".join(_toml(x) for x in value) + "]"


def _surface_table(surface: Surface, what: str) -> dict[str, Any]:
    """The table of a surface in a scene file."""
    name = next((n for n, (kind, _) in _SURFACES.items() if type(surface) is kind), None)
    if name is None:
        raise SceneError(
            f"{what} = {surface!r}: a file holds no {type(surface).__name__}; "
            f"its surfaces are {', '.join(_SURFACES)}"
        )
    keys, table = _SURFACES[name][1], dict[str, Any](surface=name)
    for key in keys:
        value = getattr(surface, "named_parameters" if key == "parameters" else key)
        if value is None and key in _REQUIRED_SURFACE_KEYS:
            raise SceneError(
                f"{what}: {key} is a Python function, which a file cannot hold; give {key} as text"
            )
        if value is not None:
            table[key] = value
    if surface.inside:
        table["inside"] = True
    return table


# --- files -------------------------------------------------------------------------------------


def _bundled_folder():
    return resources.files("contact_system") / "scenes"


def _bundled_names() -> list[str]:
    names = (entry.name for entry in _bundled_folder().iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


def bundled_scenes() -> dict[str, str]:
    """Names of the bundled scenes, each with its one-line description."""
    folder = _bundled_folder()
    return {
        name: tomllib.loads((folder / f"{name}.toml").read_text("utf-8"))["description"]
        for name in _bundled_names()
    }


def require_scene(scene: Any) -> None:
    """Raise a SceneError where something else is given, such as a scene's name."""
    if not isinstance(scene, Scene):
        raise SceneError(f'scene = {scene!r:.80}: give a Scene, such as load_scene("K4")')


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """A bundled scene by its name, or a scene from a TOML file.

    A name in the list of `bundled_scenes` is taken before a file of the same name.

    Raises
    ------
    SceneError
        If there is neither, or the file is wrong.
    """
    return scene_from_toml(*scene_text(name_or_path))


def scene_text(name_or_path: str | os.PathLike[str]) -> tuple[str, str]:
    """The TOML text that `load_scene` reads, and where it comes from.

    Raises
    ------
    SceneError
        If there is no such scene, or the file cannot be read.
    """
    given = os.fspath(name_or_path)
    names = _bundled_names()
    if given in names:
        return (_bundled_folder() / f"{given}.toml").read_text("utf-8"), f"{given}.toml"
    try:
        return Path(given).read_text("utf-8"), given
    except FileNotFoundError:
        raise SceneError(
            f"'{given}' is neither a bundled scene nor a file{_nearest(given, names)}; "
            f"bundled are {', '.join(names)}"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"'{given}' cannot be read: {error}; give a TOML text file") from None


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene as a TOML file that `load_scene` reads back to an equal scene."""
    Path(path).write_text(scene_to_toml(scene), "utf-8")
