"""A scene: which bodies touch where, how the contacts move, what disturbs them.

Arguments are checked when a scene is made; errors name the scene, the contact, the key, the value
and the remedy. Indices count from 0, in Python and in scene files.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..checks import ROUNDING, a_text, all_of, finite_number, known_keys, naming, of_kind, within
from ..errors import ContactSystemError, SceneError
from ..surfaces import Surface
from ..theory.gain import Contraction, Gain, contraction
from ..theory.profile import Profile
from .contact import Contact, Turning
from .disturbances import ALL, DISTURBANCE_KINDS, SLOTS, Disturbance
from .legs import STILL, Stretch, check_legs, length, speed, stretches

KINDS = " or ".join(kind.__name__ for kind in DISTURBANCE_KINDS)
NO_CLAIMS: Mapping[str, Any] = {"paper": {}, "chosen": ()}
"""Changes for a scene that is derived from another: the paper reports nothing of it."""


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Bodies, contacts, path profile, gain law and disturbances over one horizon.

    Collisions away from the contacts are not checked, such as those of two fingers side by side, or
    of a finger that is wider than its bowl.

    Parameters
    ----------
    object : Surface
        The object (body 2).
    contacts : sequence of Contact
        At least one.
    profile : Profile
        sigma(t) [m/s] of contacts without legs, not negative on the horizon.
    gain : Gain
        The gain law; the default is `Gain.time(100)`.
    duration : float
        The horizon is 0 to duration [s]; default: as long as the legs take.
    disturbances : sequence of Disturbance
        Overlapping windows add.
    turning : Turning, optional
        How the object turns in the world. Contact curves do not depend on it: they are relative to
        the object.
    name, description : str
        For messages and pictures.
    paper : mapping
        What the paper reports: ``figure`` and ``reports``, texts; ``recovery_time`` of slip [s];
        ``lateral_force`` at which a contact saturates [N].
    chosen : sequence of str
        Keys whose values are not in the paper and were chosen, such as "contacts.finger_at".
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
    paper: Mapping[str, Any] = field(default_factory=dict, hash=False)
    chosen: Sequence[str] = ()
    drake: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        try:  # not `naming`: a context manager would cost as much as the checks
            self._check_parts()
            self._check_motion()
            self._place_contacts()
        except ContactSystemError as error:
            raise SceneError(f"{self.title}: {error}") from None

    def contraction(self) -> Contraction:
        """Intervals on which slip shrinks, and the least eta for which it shrinks throughout.

        For contacts without legs.

        Raises
        ------
        SceneError
            If all contacts have legs, whose profiles are their own.
        """
        if all(contact.legs for contact in self.contacts):
            raise SceneError(
                f"{self.title}: no contact has the scene's profile, as all have legs; "
                "cs.rejections(cs.plan(scene)) tells how slip shrinks along them"
            )
        return contraction(self.profile, self.gain, self.duration)

    def replace(self, **changes: Any) -> Scene:
        """A copy with some fields changed, checked like any scene.

        If contacts are replaced and disturbances are not, the latter keep their components, which
        refer to coordinates in the chart's regular range.

        Raises
        ------
        SceneError
            An unknown field, or a wrong value.
        """
        fields = vars(self)
        known_keys(changes, fields, "changes of a scene: ")
        made = Scene(**(fields | changes))
        if "contacts" in changes and "disturbances" not in changes:
            object.__setattr__(made, "disturbances", self.disturbances)
        return made

    @property
    def title(self) -> str:
        """The scene as messages call it: "scene 'K4'"."""
        return f"scene '{self.name}'" if self.name else "scene"

    def contact_title(self, index: int) -> str:
        """The contact as messages call it: "contact 0", with its name "contact 0 (finger 1)"."""
        name = self.contacts[index].name
        return f"contact {index}" + f" ({name})" * bool(name)

    def contact_name(self, index: int) -> str:
        """The contact's name for tables and pictures, where no other contact has the same; else as
        in messages."""
        name = self.contacts[index].name
        alone = name and sum(contact.name == name for contact in self.contacts) == 1
        return name if alone else self.contact_title(index)

    def require_contact(self, index: Any, others: str = "") -> None:
        """Raise a SceneError if the scene has no contact of this index. Its remedy names the
        indices, and ``others`` that the caller takes besides."""
        count = len(self.contacts)
        if index not in range(count):
            raise SceneError(
                f"contact = {index!r}: the scene has {count} contact{'s' * (count > 1)}; give "
                f"{f'0 to {count - 1}' if count > 1 else 0}{others}"
            )

    @property
    def surfaces(self) -> list[Surface]:
        """The object's surface, then those of the fingers."""
        return [self.object, *(contact.finger for contact in self.contacts)]

    @property
    def window_edges(self) -> tuple[float, ...]:
        """Start and stop times of the disturbances, ascending [s]."""
        return tuple(sorted({t for d in self.disturbances for t in (d.start, d.stop)}))

    @property
    def edges(self) -> tuple[float, ...]:
        """Start and stop times of legs and disturbances, 0 and the duration, ascending [s]."""
        ways = (self.way(i) for i, contact in enumerate(self.contacts) if contact.legs)
        corners = {stretch.start for way in ways for stretch in way}
        return tuple(sorted({0.0, self.duration, *self.window_edges, *corners}))

    def way(self, contact: int) -> tuple[Stretch, ...]:
        """The stretches of a contact's path: its legs, or one with the scene's profile."""
        if legs := self.contacts[contact].legs:
            return stretches(legs, self.duration)
        return (Stretch(0.0, self.duration, self.profile),)

    def speeds(self, t: ArrayLike) -> np.ndarray:
        """sigma of every contact at times t [s]: t.shape + (n_contacts,), m/s."""
        return np.stack([speed(self.way(i), t) for i in range(len(self.contacts))], axis=-1)

    def path_length(self, t: float) -> float:
        """Length along s, m, of the longest path of any contact until time t [s]."""
        return max(length(self.way(i), t) for i in range(len(self.contacts)))

    def _check_parts(self) -> None:
        """Check types, and convert values to immutable ones."""
        put = object.__setattr__
        of_kind(Surface, self.object, "object", "a surface, such as Sphere(0.1)")
        of_kind(Profile, self.profile, "profile", "a Profile, such as Profile([0.1, 0.2])")
        of_kind(Gain, self.gain, "gain", "a Gain, such as Gain.path(100)")
        turning = "a Turning, such as Turning((0, 0, 1), [0, 0.5])"
        of_kind((Turning, type(None)), self.turning, "turning", turning)
        put(self, "contacts", all_of(Contact, self.contacts, "contacts", "Contact"))
        if not self.contacts:
            raise SceneError("contacts = []: a scene needs at least one contact")
        put(self, "disturbances", all_of(Disturbance, self.disturbances, "disturbances", KINDS))
        put(self, "chosen", all_of(str, self.chosen, "chosen", "text"))
        for key in ("name", "description"):
            a_text(getattr(self, key), key)
        for key in ("paper", "drake"):
            if (table := getattr(self, key)) != {}:
                put(self, key, _plain(of_kind(Mapping, table, key, "a table"), key))
        if self.drake:
            with naming("drake"):
                refuse_scene_keys(self.drake, ("object",))
        if self.paper:
            known_keys(self.paper, PAPER_KEYS, "paper: ")
            for key, value in self.paper.items():
                (finite_number if key in PAPER_NUMBERS else a_text)(value, f"paper: {key}")

    def _check_motion(self) -> None:
        """Check the horizon, sigma on it, and that windows lie inside it."""
        put = object.__setattr__
        with_legs = [(i, c.legs) for i, c in enumerate(self.contacts) if c.legs]
        duration = self.duration or max(
            (math.fsum(x.duration for x in legs) for _, legs in with_legs), default=0.0
        )
        put(self, "duration", finite_number(duration, "duration", "above 0"))
        for i, legs in with_legs:
            with naming(self.contact_title(i)):
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
        """The disturbance, checked against the scene, once for each contact it acts on.

        A window that ends after the horizon by rounding ends with it.
        """
        d, stop = disturbance, min(disturbance.stop, self.duration)
        if not 0 <= d.start < stop or d.stop - stop > ROUNDING * stop:
            raise SceneError(
                f"start = {d.start}, stop = {d.stop}: the window is not inside the horizon "
                f"[0, {self.duration}] s; move it or change the duration"
            )
        if isinstance(d.contact, str):
            indices = [*range(len(self.contacts))]
        else:
            self.require_contact(d.contact, f' or "{ALL}"')
            indices = [d.contact]
        for i in indices:
            if self.contacts[i].follows:
                raise SceneError(
                    f'contact = {i}: its finger_velocity = "rolling" imposes rolling, which '
                    "cannot be disturbed; give finger_velocity as two numbers, or leave the "
                    "disturbance out"
                )
        return [
            d if (d.contact, d.stop) == (i, stop) else dataclasses.replace(d, contact=i, stop=stop)
            for i in indices
        ]

    def _place_contacts(self) -> None:
        """Bring every contact's coordinates into the charts' regular range."""
        contacts, turned = list(self.contacts), set[tuple[str, int]]()
        for i, contact in enumerate(self.contacts):
            for body, surface, given in (
                ("object", self.object, contact.object_at),
                ("finger", contact.finger, contact.finger_at),
            ):
                try:
                    at = surface.canonical(*given)
                except ContactSystemError as error:
                    what = f"{self.contact_title(i)}: {body}_at = {given}"
                    raise SceneError(f"{what}: {error}") from None
                if at == given:
                    continue
                changes: dict[str, Any] = {f"{body}_at": at}
                # a double cover has the same point at (u, v) and (-u, pi - v), with opposite axes
                if surface.chart.double_cover and surface.align(*at, *given)[2]:
                    changes["angle"] = math.remainder(contacts[i].angle + math.pi, 2 * math.pi)
                    velocity = getattr(contact, f"{body}_velocity")
                    if not isinstance(velocity, str):
                        changes[f"{body}_velocity"] = (-velocity[0], -velocity[1])
                    turned.add((body, i))
                contacts[i] = dataclasses.replace(contacts[i], **changes)
        object.__setattr__(self, "contacts", tuple(contacts))
        if turned:
            disturbances = (
                dataclasses.replace(d, value=(-d.value[0], -d.value[1]))
                if (d.side, d.contact) in turned
                else d
                for d in self.disturbances
            )
            object.__setattr__(self, "disturbances", tuple(disturbances))


# --- keys of scene files -----------------------------------------------------------------------

SCENE_KEYS = [field.name for field in dataclasses.fields(Scene)]
PAPER_KEYS = ("figure", "reports", "recovery_time", "lateral_force")
PAPER_NUMBERS = PAPER_KEYS[2:]


def refuse_scene_keys(table: Mapping, allowed: Iterable[str]) -> None:
    """Refuse keys of the scene in another table: to TOML a line belongs to the header above it."""
    for key in table:
        if key in SCENE_KEYS and key not in allowed:
            raise SceneError(
                f"key '{key}' is no key of this table but one of the scene: write it above all "
                "headers, such as [[contacts]]"
            )


def _plain(value: Any, key: str) -> Any:
    """A copy of a value, of types that a scene file can hold; raises if it has others."""
    value = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    if isinstance(value, Mapping) and all(isinstance(name, str) for name in value):
        return {name: _plain(x, f"{key}: {name}") for name, x in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(x, f"{key}[{k}]") for k, x in enumerate(value)]
    if isinstance(value, (str, int)) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise SceneError(
        f"{key} = {value!r}: give finite numbers, texts, lists or tables of them, keyed by texts"
    )


def acting(scene: Scene, t: float) -> np.ndarray:
    """Disturbances that act on the interval that begins at t: (n_contacts, 6), chart components.

    The columns are two for each of `SLOTS`, in their order.
    """
    values = np.zeros((len(scene.contacts), 2 * len(SLOTS)))
    for d in scene.disturbances:
        if d.start <= t < d.stop:
            values[int(d.contact), 2 * d.slot : 2 * d.slot + 2] += d.value
    return values


def refuse_rest(scene: Scene, contact: int, start: float, stop: float) -> None:
    """Raise a SceneError if sigma = 0 in an acceleration's window: dq/ds would become infinite."""
    inside = [
        max(stretch.start + t, start)
        for stretch in scene.way(contact)
        for t in stretch.profile.zeros(stretch.stop - stretch.start)
        if start <= stretch.start + t <= stop
    ]
    if inside:
        raise SceneError(
            f"{scene.title}, {scene.contact_title(contact)}: sigma = 0 at t = {inside[0]:g} s "
            "while an acceleration acts, which would make the path velocity dq/ds infinite; "
            "accelerate while sigma > 0, or add a small constant to the profile"
        )


def require_scene(scene: Any) -> None:
    """Raise a SceneError for anything but a Scene, such as a scene's name."""
    of_kind(Scene, scene, "scene", 'a Scene, such as load_scene("K4")')
