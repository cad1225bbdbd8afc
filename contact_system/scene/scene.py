"""A scene: which bodies touch where, how the contacts move, what disturbs them.

Everything a user can get wrong is checked here, once, when the object is built. The messages name
the scene, the contact, the key, the value and the remedy. Contacts, disturbances and `contacts[0]`
count from 0, in Python as in scene files (`files`).
"""

from __future__ import annotations

import copy
import dataclasses
import math
import numbers
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..checks import did_you_mean, finite_number, known_keys, naming, within
from ..errors import ContactSystemError, SceneError
from ..surfaces import Surface
from ..surfaces.charts import fold_latitude
from ..theory.gain import Contraction, Gain, contraction
from ..theory.profile import Profile
from .contact import MANY_TURNS, Contact, Pair, Turning, a_surface, a_text, all_of
from .disturbances import ALL, SLOTS, Disturbance
from .legs import STILL, Leg, Stretch, check_legs, length, speed


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
        sigma(t) [m/s] of contacts without legs, who must be given one; not negative on the horizon.
    gain : Gain
        The gain law; the default is `Gain.time(100)`.
    duration : float
        The horizon, from 0 on [s]; by default as long as the legs take.
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
        Contact physics: fields of `drake_plant`'s StationConfig, which checks them.

    Raises
    ------
    SceneError
        Naming the scene, the contact, the key, the value and the remedy.
    """

    object: Surface
    contacts: Sequence[Contact]
    profile: Profile = STILL
    duration: float = 0.0
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
        except ContactSystemError as error:
            raise SceneError(f"{self.title}: {error}") from None

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
        """Where legs and windows begin or end, 0 and the duration, ascending [s]."""
        ways = (self.way(i) for i, contact in enumerate(self.contacts) if contact.legs)
        corners = {stretch.start for way in ways for stretch in way}
        return tuple(sorted({0.0, self.duration, *self.window_edges, *corners}))

    def way(self, contact: int) -> tuple[Stretch, ...]:
        """sigma of a contact, leg by leg; of one without legs the scene's profile."""
        return self.contacts[contact].way(self.profile, self.duration)

    def speeds(self, t) -> np.ndarray:
        """sigma of every contact at times t [s]: t.shape + (n_contacts,), m/s."""
        ways = (contact.whole_way(self.profile, self.duration) for contact in self.contacts)
        return np.stack([speed(way, t) for way in ways], axis=-1)

    def path_length(self, t: float) -> float:
        """How far a contact has come at time t [s] at most, m."""
        ways = (contact.whole_way(self.profile, self.duration) for contact in self.contacts)
        return max(length(way, t) for way in ways)

    def _check_parts(self) -> None:
        """Types, and everything into its plain immutable form."""
        put = object.__setattr__
        a_surface(self.object, "object")
        put(self, "contacts", all_of(Contact, self.contacts, "contacts", "Contact"))
        if not self.contacts:
            raise SceneError("contacts = []: a scene needs at least one contact")
        names = "FingerAcceleration, ObjectAcceleration or ObjectRateOffset"
        put(self, "disturbances", all_of(Disturbance, self.disturbances, "disturbances", names))
        for key, kind in (("profile", Profile), ("gain", Gain), ("turning", Turning)):
            value = getattr(self, key)
            if not isinstance(value, kind) and not (key == "turning" and value is None):
                raise SceneError(f"{key} = {value!r}: give a {kind.__name__}")
        for key in ("name", "description", "source"):
            a_text(getattr(self, key), key)
        for key in ("paper", "drake"):
            put(self, key, _plain_table(getattr(self, key), key))
        known_keys(self.paper, PAPER_KEYS, "paper: ")
        for key, value in self.paper.items():
            (finite_number if key in PAPER_NUMBERS else a_text)(value, f"paper: {key}")

    def _check_motion(self) -> None:
        """The horizon, sigma on it, and every window inside it."""
        put = object.__setattr__
        with_legs = [(i, c.legs) for i, c in enumerate(self.contacts) if c.legs]
        longest = max((sum(x.duration for x in legs) for _, legs in with_legs), default=0.0)
        put(self, "duration", finite_number(self.duration or longest, "duration"))
        if not self.duration > 0:
            raise SceneError(f"duration = {self.duration:g} s: give a horizon longer than 0 s")
        for i, legs in with_legs:
            with naming(f"contacts[{i}]"):
                check_legs(legs, self.duration)
        if len(with_legs) < len(self.contacts) or self.profile != STILL:
            self.profile.check(self.duration)
        if not self.disturbances:
            return
        copies = (len(self.contacts) if d.contact == ALL else 1 for d in self.disturbances)
        within("WINDOWS", sum(copies), "disturbances: windows of all contacts")
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
        for i in range(len(contacts)):
            for body in ("object", "finger"):
                surface = self.object if body == "object" else contacts[i].finger
                contacts[i], half_turn = _placed(contacts[i], i, surface, body)
                if half_turn:
                    turned.add((body, i))
        object.__setattr__(self, "contacts", tuple(contacts))
        if turned:
            disturbances = [
                dataclasses.replace(d, value=(-d.value[0], -d.value[1]))
                if (d.side, d.contact) in turned
                else d
                for d in self.disturbances
            ]
            object.__setattr__(self, "disturbances", tuple(disturbances))


def _placed(contact: Contact, i: int, surface: Surface, body: str) -> tuple[Contact, bool]:
    """The contact with its coordinates on one body in the regular range of that body's chart.

    Also whether both frame axes turned by pi on the way: the triaxial ellipsoid's chart covers it
    twice, (u, v) ~ (-u, pi - v), the second time with turned axes.
    """
    key = f"{body}_at"
    given: Pair = getattr(contact, key)
    try:
        at: Pair = surface.canonical(*given)
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
    half_turn = surface.double_cover and fold_latitude(given[1])[1]
    changes: dict[str, Any] = {key: at}
    if half_turn:
        changes["angle"] = math.remainder(contact.angle + math.pi, 2 * math.pi)
        velocity = getattr(contact, f"{body}_velocity")
        if not isinstance(velocity, str):
            changes[f"{body}_velocity"] = (-velocity[0], -velocity[1])
    moved = copy.copy(contact)
    vars(moved).update(changes)  # a new Contact would check everything again
    return moved, half_turn


# --- keys of scene files -----------------------------------------------------------------------

PAPER_KEYS = ("figure", "reports", "recovery_time", "lateral_force")
PAPER_NUMBERS = PAPER_KEYS[2:]

SCENE_KEYS = tuple(f.name for f in dataclasses.fields(Scene) if f.name != "source")
CONTACT_KEYS = tuple(f.name for f in dataclasses.fields(Contact))
LEG_KEYS = tuple(f.name for f in dataclasses.fields(Leg))
TURNING_KEYS = tuple(f.name for f in dataclasses.fields(Turning))
DISTURBANCE_KEYS = ("kind", *(f.name for f in dataclasses.fields(Disturbance)))


def _plain_table(table: Any, what: str) -> dict[str, Any]:
    """A copy of a table in TOML's own types, with only finite numbers."""
    if not isinstance(table, (dict, Mapping)):
        raise SceneError(f"{what} = {table!r}: give a table")
    for key in table:
        a_text(key, f"{what}: key")
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
    object.__setattr__(scene, "chosen", all_of(str, scene.chosen, "chosen", "text"))
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

    Two numbers each, in the order of `SLOTS`.
    """
    found = np.zeros((len(scene.contacts), 2 * len(SLOTS)))
    for d in scene.disturbances:
        if d.start <= t < d.stop:
            found[int(d.contact), 2 * d.slot : 2 * d.slot + 2] += d.value
    return found


def refuse_rest(scene: Scene, contact: int, start: float, stop: float) -> None:
    """Raise a SceneError where sigma = 0 under an acceleration: dq/ds would have to be infinite."""
    inside = [
        max(stretch.start + t, start)
        for stretch in scene.way(contact)
        for t in stretch.profile.zeros(stretch.stop - stretch.start)
        if start <= stretch.start + t <= stop
    ]
    if inside:
        raise SceneError(
            f"{scene.title}, contact {contact}: sigma = 0 at t = {inside[0]:g} s while an "
            "acceleration acts, which would make the path velocity dq/ds infinite; accelerate "
            "while sigma > 0, or add a small constant to the profile"
        )


def require_scene(scene: Any) -> None:
    """Raise a SceneError where something else is given, such as a scene's name."""
    if not isinstance(scene, Scene):
        raise SceneError(f'scene = {scene!r:.80}: give a Scene, such as load_scene("K4")')
