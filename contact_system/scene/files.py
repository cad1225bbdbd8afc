"""Scenes as TOML: reading, writing, and the bundled scenes.

Errors name the file, the contact, the key, the value and the remedy. Every number outside `[drake]`
may be written as arithmetic text, such as "2*pi/3".
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import surfaces
from ..checks import did_you_mean, finite_number, known_keys, naming, one_of, within
from ..errors import ContactSystemError, SceneError
from ..expressions import parse
from ..files import a_path, require_regular, writing
from ..surfaces import TURN, Surface
from ..theory.gain import LAWS, Gain
from ..theory.profile import Profile
from .contact import Contact, Turning
from .disturbances import DISTURBANCE_KINDS, Disturbance
from .legs import STILL, Leg
from .scene import PAPER_KEYS, SCENE_KEYS, Scene, refuse_scene_keys, require_scene

if TYPE_CHECKING:
    from ..steering import Goal

_FORMULAS = ("f", "F")  # required in files; in Python ``formula`` may replace them


def _surface_keys(name: str) -> dict[str, bool]:
    """Keys of a surface in files, i.e. arguments of its class: whether each one is required."""
    arguments = inspect.signature(surfaces.KINDS[name]).parameters
    return {
        key: parameter.default is parameter.empty or key in _FORMULAS
        for key, parameter in arguments.items()
        if key != "formula"
    }


_DOTTED = re.compile(r"(?<![^\s\[])(?:[^\s.\[]++\s*+\.\s*+){2,}+")
"""A dotted key of many parts: the time to parse one grows with the square of their number."""

# --- reading -----------------------------------------------------------------------------------


def scene_from_toml(text: str, source: str = "") -> Scene:
    """The scene that a TOML text describes; without a name it gets the source's."""
    with naming(source or "TOML text"):
        try:
            return _scene(text, source)
        except RecursionError:
            raise SceneError("lists or tables are nested too deeply; nest them less") from None


def _scene(text: str, source: str) -> Scene:
    within("SCENE_BYTES", len(text), "characters")
    for key in _DOTTED.findall(text):
        within("NESTING", key.count("."), f"key {key:.40}...: dots")
    try:
        document = tomllib.loads(text)
    except ValueError as error:  # of TOML, or of a number of more than 4300 digits
        raise SceneError(
            f"is not valid TOML: {error}; correct that line (texts and arithmetic stand in quotes, "
            'as "2*pi/3")'
        ) from None
    if "legs" in document:
        raise SceneError("legs belong to a contact: write each one as a table [[contacts.legs]]")
    contacts = document.get("contacts")
    all_legs = isinstance(contacts, list) and all("legs" in c for c in contacts if type(c) is dict)
    motion = () if all_legs else ("duration", "profile")
    table = _table(document, SCENE_KEYS, (*motion, "object", "contacts"))
    # a file's name may have bytes that are no text, which no other file could hold
    name = os.fsencode(Path(source).stem).decode(errors="replace")
    fields = fields_of({"name": name, **table})
    for i, contact in enumerate(fields["contacts"]):
        with naming(f"contacts[{i}]"):
            refuse_degrees(contact, fields["object"], contact.finger)
    return Scene(**fields)


def refuse_degrees(places: Contact | Goal, body: Surface, finger: Surface) -> None:
    """Refuse coordinates beyond two turns: they are degrees by mistake, and without this check
    whole turns would be removed and the contact put at another place."""
    for key, surface in (("object_at", body), ("finger_at", finger)):
        if at := getattr(places, key):
            for x, moved, period in zip(at, surface._wrap(*at), surface.periods()):
                if x != moved:
                    _refuse_turns(x, key, period or TURN)


def _refuse_turns(x: Any, key: str, turn: float) -> None:
    if isinstance(x, (int, float)) and abs(x) > 2 * turn:
        raise SceneError(
            f"{key}: {x:g} rad is more than two turns; give radians, such as "
            f'"{x:g}*pi/180" for degrees'
        )


def fields_of(table: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a scene, of one of its parts or of a goal, from a table of a file."""
    return {key: _value(key, value) for key, value in table.items()}


def _value(key: str, value: Any) -> Any:
    """A key's value as the field's type; a key means the same in all tables, by default numbers."""
    if key in _AS_GIVEN or (key.endswith("velocity") and isinstance(value, str)):
        return value
    if key in _PARTS:
        with naming(key):
            return _PARTS[key](value)
    if key in _LISTS:
        if not isinstance(value, list):
            header = "contacts.legs" if key == "legs" else key
            raise SceneError(f"{key} = {value!r}: write each one as a table under [[{header}]]")
        items = []
        for i, item in enumerate(value):
            with naming(f"{key}[{i}]"):
                items.append(_LISTS[key](item))
        return items
    if key == "profile":
        if not isinstance(value, list):
            raise SceneError(
                f"profile = {value!r}: give a list, the coefficients of sigma(t) from that of t^0 "
                "on, such as [0.1, 0.2] for 0.1 + 0.2 t"
            )
        return Profile(_numbers(value, key))
    if key in ("angle", "direction"):
        _refuse_turns(value, key, TURN)
    return _numbers(value, key)


def _made(kind: Any, value: Any, **defaults: Any) -> Any:
    """A part of a scene from its table: an instance of ``kind``, whose fields are the keys."""
    fields = dataclasses.fields(kind)
    needed = [f.name for f in fields if f.default is dataclasses.MISSING]
    required = [key for key in needed if key not in defaults]
    return kind(**defaults | fields_of(_table(value, [f.name for f in fields], required)))


def _disturbance(value: Any) -> Disturbance:
    table = dict(_table(value, required=("kind",), example='kind = "finger acceleration"'))
    kinds = {kind.kind: kind for kind in DISTURBANCE_KINDS}
    return _made(kinds[one_of(table.pop("kind"), kinds, "kind")], table)


def _gain(value: Any) -> Gain:
    table = _table(value, required=("law",), example='law = "time", eta = 100')
    law = one_of(table["law"], LAWS, "law")
    parameter = LAWS[law].parameter
    table = _table(table, ("law", parameter), (parameter,))
    return Gain(law, _numbers(table[parameter], parameter))


def _surface(value: Any) -> Surface:
    table = _table(value, required=("surface",), example='surface = "sphere", radius = 0.04')
    name = one_of(table["surface"], surfaces.KINDS, "surface")
    keys = _surface_keys(name)
    required = [key for key, needed in keys.items() if needed]
    arguments = fields_of(_table(table, ("surface", *keys), required, place=f"{name}: "))
    del arguments["surface"]
    return surfaces.KINDS[name](**arguments)


_AS_GIVEN = "name description chosen contact surface f F inside figure reports".split()
_PARTS: dict[str, Callable[[Any], Any]] = {
    "object": _surface,
    "finger": _surface,
    "gain": _gain,
    "turning": lambda value: _made(Turning, value),
    "parameters": lambda value: {key: _numbers(x, key) for key, x in _table(value).items()},
    "paper": lambda value: fields_of(_table(value, PAPER_KEYS)),
    "drake": lambda value: _table(value),
}
_LISTS: dict[str, Callable[[Any], Any]] = {
    "contacts": lambda value: _made(Contact, value),
    "legs": lambda value: _made(Leg, value, length=None),
    "disturbances": _disturbance,
}


def _table(
    value: Any,
    known: Iterable[str] | None = None,
    required: Iterable[str] = (),
    place: str = "",
    example: str = "key = value",
) -> dict:
    """The value, checked to be a table with the required keys and no unknown ones."""
    if not isinstance(value, dict):
        raise SceneError(f"{value!r} is not a table; write it like {{ {example} }}")
    if known is not None:
        refuse_scene_keys(value, known)
        known_keys(value, known, place)
    for key in required:
        if key not in value:
            remedy = f"a table [[{key}]]" if key in _LISTS else f"{key} = ..."
            raise SceneError(f"{place}key '{key}' is missing; add {remedy}")
    return value


def _numbers(value: Any, what: str) -> Any:
    """A number or a list of numbers of a file; arithmetic texts are evaluated."""
    if isinstance(value, list):
        within("COEFFICIENTS", len(value), f"{what}: numbers")
        return tuple(_numbers(x, f"{what}[{k}]") for k, x in enumerate(value))
    if isinstance(value, str):
        with naming(what):
            value = parse(value, {})
    return finite_number(value, what)


# --- writing -----------------------------------------------------------------------------------


def scene_to_toml(scene: Scene) -> str:
    """TOML text of a scene; reading it back gives an equal scene, every float to the last bit.

    Raises a SceneError for a surface that is given by a Python function or is of a user's class.
    """
    with naming(scene.title):
        keys = [key for key in SCENE_KEYS if key not in {*_PARTS, *_LISTS}]
        table = {key: getattr(scene, key) for key in ("name", "description", *keys)}
        table["profile"] = scene.profile.coefficients
        if scene.profile == STILL:
            del table["profile"]
        table["gain"] = {"law": scene.gain.law, scene.gain.parameter: scene.gain.value}
        lines = _lines(table)
        if scene.turning is not None:
            lines += ["", "[turning]", *_lines(dataclasses.asdict(scene.turning))]
        lines += ["", "[object]", *_lines(_surface_table(scene.object, "object"))]
        for i, contact in enumerate(scene.contacts):
            table = dict(vars(contact)) | {"angle": _angle(contact.angle)}
            table["finger"] = _surface_table(contact.finger, f"contacts[{i}]: finger")
            table["legs"] = list(map(_leg_table, contact.legs))
            if not contact.legs:
                del table["legs"]
            lines += ["", "[[contacts]]", *_lines(table)]
        for d in scene.disturbances:
            lines += ["", "[[disturbances]]", *_lines({"kind": d.kind} | vars(d))]
        for key in ("paper", "drake"):
            if table := getattr(scene, key):
                lines += ["", f"[{key}]", *_lines(table)]
    return "\n".join(lines) + "\n"


def _lines(table: Mapping[str, Any]) -> list[str]:
    plain = r"[A-Za-z0-9_-]+"
    keys = [key if re.fullmatch(plain, key) else _toml(key) for key in table]
    return [f"{key} = {_toml(value)}" for key, value in zip(keys, table.values())]


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):  # JSON's escapes are valid TOML, except for DEL
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_lines(value)) + " }"
    return "[" + ", ".join(_toml(x) for x in value) + "]"


def _angle(x: float) -> float | str:
    """An angle for a file; beyond two turns a text, as a number would be refused as degrees."""
    return x if abs(x) <= 2 * TURN else repr(x)


def _leg_table(leg: Leg) -> dict[str, Any]:
    """The table of a leg: with its length, or with its own profile."""
    table = {"direction": _angle(leg.direction), "duration": leg.duration}
    if leg == Leg(leg.direction, leg.length, leg.duration):
        return table | {"length": leg.length}
    return table | {"profile": leg.profile.coefficients}


def _surface_table(surface: Surface, what: str) -> dict[str, Any]:
    """The table of a surface in a scene file."""
    name = next((n for n, kind in surfaces.KINDS.items() if type(surface) is kind), None)
    if name is None:
        raise SceneError(
            f"{what} = {surface!r}: a file holds no {type(surface).__name__}; "
            f"give one of {', '.join(surfaces.KINDS)}"
        )
    table: dict[str, Any] = {"surface": name}
    for key in _surface_keys(name):
        value = getattr(surface, "named_parameters" if key == "parameters" else key)
        if value is None and key in _FORMULAS:
            raise SceneError(
                f"{what}: {key} is a Python function, which a file cannot hold; give {key} as text"
            )
        if value is not None and value is not False:
            table[key] = value
    return table


# --- files -------------------------------------------------------------------------------------


def _bundled() -> dict[str, Path]:
    """The files of the bundled scenes by name."""
    folder = Path(__file__).parents[1] / "scenes"
    return {file.stem: file for file in sorted(folder.glob("*.toml"))}


def bundled_scenes() -> dict[str, str]:
    """Names of the bundled scenes, each with its one-line description."""
    return {n: tomllib.loads(f.read_text("utf-8"))["description"] for n, f in _bundled().items()}


def load_scene(name_or_path: str | os.PathLike[str]) -> Scene:
    """A bundled scene by its name, or a scene from a TOML file.

    A name in the list of `bundled_scenes` is taken before a file of the same name.

    Raises
    ------
    SceneError
        There is neither, or the file is wrong.
    """
    return scene_from_toml(*scene_text(name_or_path))


def scene_text(name_or_path: str | os.PathLike[str]) -> tuple[str, str]:
    """The TOML text that `load_scene` reads, and its file's name."""
    try:
        name = os.fsdecode(name_or_path)
    except TypeError:
        raise SceneError(f"scene = {name_or_path!r:.80}: give a name or a path") from None
    bundled = _bundled()
    if name in bundled:
        return bundled[name].read_text("utf-8"), bundled[name].name
    try:
        require_regular(name)
        with naming(name):
            within("SCENE_BYTES", os.path.getsize(name), "bytes")
        return Path(name).read_text("utf-8-sig"), name  # editors on Windows may write a BOM
    except ContactSystemError:
        raise
    except FileNotFoundError:
        near = did_you_mean(Path(name).name.removesuffix(".toml"), bundled)
        near = f" (did you mean '{name}.toml'?)" if os.path.exists(f"{name}.toml") else near
        raise SceneError(
            f"'{name}' is neither a bundled scene nor a file{near}; bundled are "
            f"{', '.join(bundled)}"
        ) from None
    except (OSError, ValueError) as error:  # unreadable, no text, or an impossible name
        raise SceneError(f"'{name}' cannot be read: {error}; give a TOML file in UTF-8") from None


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene as a TOML file that `load_scene` reads back to an equal scene.

    Raises
    ------
    SceneError
        It is no scene, a file cannot hold it, or the file cannot be written.
    """
    require_scene(scene)
    path, text = a_path(path), scene_to_toml(scene)
    with writing(path, f"{scene.title}: ") as file:
        file.write(text.encode())
