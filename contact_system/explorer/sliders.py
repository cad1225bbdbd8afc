"""The sliders of a scene: the numbers they change, and their ranges."""

from __future__ import annotations

import cmath
import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..plots.meshes import closed_span
from ..scene import REST, ROLLING, Scene
from ..surfaces import Surface
from ..surfaces.base import OfLengths

Place = tuple[str | int, ...]
"""Path to a number of a scene: names of fields and indices."""


@dataclass(frozen=True)
class Slider:
    """A number that can be changed, in one place of the scene or several."""

    folder: str
    label: str
    low: float
    high: float
    value: float
    places: tuple[Place, ...]
    made: Callable[[float], Any] = float
    """Converts the slider's number to the value at those places."""


def adjusted(part: Any, values: Mapping[Place, Any]) -> Any:
    """A scene or a part of one, with new values at some places; checked once, as a whole."""
    if () in values:
        return values[()]
    below: dict[Any, dict[Place, Any]] = {}
    for (head, *rest), value in values.items():
        below.setdefault(head, {})[tuple(rest)] = value
    if not below:
        return part
    if part == REST:
        part = 0.0, 0.0
    if isinstance(part, tuple):
        return tuple(adjusted(x, below.get(k, {})) for k, x in enumerate(part))
    if isinstance(part, Mapping):
        return {key: adjusted(x, below.get(key, {})) for key, x in part.items()}
    fields = {head: "named_parameters" if head == "parameters" else head for head in below}
    changes = {head: adjusted(getattr(part, fields[head]), below[head]) for head in below}
    replace = Scene.replace if isinstance(part, Scene) else dataclasses.replace
    return replace(part, **changes)


def sliders_of(scene: Scene) -> list[Slider]:
    """All sliders except that of the gain."""
    disturbed = {d.contact for d in scene.disturbances}
    moved = (
        i in disturbed or any(map(any, contact.start()[-2:]))
        for i, contact in enumerate(scene.contacts)
        if not contact.legs
    )
    profile = _of_profile(scene) if any(moved) else ()
    return [*profile, *_of_radii(scene), *_of_disturbances(scene), *_of_starts(scene)]


def _of_profile(scene: Scene) -> Iterator[Slider]:
    c = scene.profile.coefficients
    for k, value in enumerate(c):
        span = 2 * abs(value) or max(map(abs, c)) / scene.duration**k
        low = value - span if k else 0.0
        label, place = f"t^{k} [m/s{f'^{k + 1}' * (k > 0)}]", ("profile", "coefficients", k)
        yield Slider("profile", label, low, value + span, value, (place,))


def _of_radii(scene: Scene) -> Iterator[Slider]:
    bodies: list[tuple[str, Surface, list[Place]]] = [("object", scene.object, [("object",)])]
    for i, contact in enumerate(scene.contacts):
        same = next((b for b in bodies[1:] if b[1] == contact.finger), None)
        if same is None:
            same = (f"finger of {scene.contact_name(i)}", contact.finger, [])
            bodies.append(same)
        same[2].append(("contacts", i, "finger"))
    for name, surface, whole in bodies:
        for label, value, tail in _numbers_of(surface):
            name = "fingers" if name != "object" and len(bodies) == 2 else name
            low, high = sorted((0.25 * value, 2.5 * value))
            places = tuple((*place, *tail) for place in whole)
            yield Slider("shapes", f"{name}: {label}", low, high, value, places)


def _numbers_of(surface: Surface) -> Iterator[tuple[str, float, Place]]:
    named = getattr(surface, "named_parameters", None)
    if named is not None:
        yield from ((key, x, ("parameters", key)) for key, x in named.items() if x)
        return
    for key in surface.__match_args__:
        if isinstance(value := getattr(surface, key), float):
            yield key + " [m]" * isinstance(surface, OfLengths), value, (key,)


def _of_disturbances(scene: Scene) -> Iterator[Slider]:
    alike: dict[Any, list[int]] = {}
    for k, d in enumerate(scene.disturbances):
        alike.setdefault((d.kind, d.start, d.stop, d.value), []).append(k)
    for (kind, start, stop, pair), which in alike.items():
        most = 3 * max(map(abs, pair)) or 1.0
        numbers: dict[Place, tuple[str, float, float, float]] = {
            ("start",): ("start [s]", 0.0, scene.duration, start),
            ("stop",): ("stop [s]", 0.0, scene.duration, stop),
            ("value", 0): ("du", -most, most, pair[0]),
            ("value", 1): ("dv", -most, most, pair[1]),
        }
        for tail, number in numbers.items():
            yield Slider(kind, *number, tuple(("disturbances", k, *tail) for k in which))


def _of_starts(scene: Scene) -> Iterator[Slider]:
    for i, contact in enumerate(scene.contacts):
        folder, place = f"start of {scene.contact_name(i)}", ("contacts", i)
        for side, body in (("object", scene.object), ("finger", contact.finger)):
            at = getattr(contact, f"{side}_at")
            for k, value in enumerate(at):
                span = closed_span(body, k)
                if span is None:
                    reach = 2 * body.size / float(body.lame(*at)[k])
                    span = value - reach, value + reach
                label = f"{'uv'[k]} on the {side}"
                yield Slider(folder, label, *span, value, ((*place, f"{side}_at", k),))
        turn = -math.pi, math.pi
        yield Slider(folder, "angle psi [rad]", *turn, contact.angle, ((*place, "angle"),))
        if not isinstance(contact.finger_velocity, str) and any(contact.finger_velocity):
            length, angle = cmath.polar(complex(*contact.finger_velocity))

            def turned(angle: float, length: float = length) -> tuple[float, float]:
                return length * math.cos(angle), length * math.sin(angle)

            places = ((*place, "finger_velocity"),)
            yield Slider(folder, "direction [rad]", *turn, angle, places, turned)
        if contact.object_velocity != ROLLING:  # which follows from the finger
            start = contact.start()
            most = 2 * max(map(abs, start.finger_velocity + start.object_velocity)) or 1.0
            for k, value in enumerate(start.object_velocity):
                label, own = f"{'xy'[k]} velocity on the object", (*place, "object_velocity", k)
                yield Slider(folder, label, -most, most, value, (own,))
