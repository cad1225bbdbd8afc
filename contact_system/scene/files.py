"""Scenes as TOML: reading, writing, and the scenes that come with the package.

The messages name the file, the contact, the key, the value and the remedy. See the bundled
`scenes/*.toml`. Every number may be written as arithmetic text, such as "2*pi/3", but for those of
`[drake]`, which may hold words too.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from ..checks import a_path, did_you_mean, finite_number, known_keys, naming, writing
from ..errors import SceneError
from ..expressions import parse
from ..surfaces import (
    Cylinder,
    Ellipsoid,
    ImplicitSurface,
    ParametricSurface,
    Plane,
    Quadric,
    Sphere,
    Surface,
    Torus,
)
from ..theory.gain import LAWS, Gain
from ..theory.profile import Profile
from .contact import REST, ROLLING, Contact, Turning
from .disturbances import DISTURBANCE_KINDS, Disturbance
from .scene import (
    CONTACT_KEYS,
    DISTURBANCE_KEYS,
    PAPER_NUMBERS,
    SCENE_KEYS,
    TURNING_KEYS,
    Scene,
    require_scene,
)

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
    with naming(source or "TOML text"):
        try:
            return _scene(text, source)
        except RecursionError:
            raise SceneError("lists or tables are nested too deeply; nest them less") from None


def _scene(text: str, source: str) -> Scene:
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"is not valid TOML: {error}; correct that line") from None
    except ValueError as error:  # int() reads no more than 4300 digits
        raise SceneError(f"holds a number that is too long: {error}; shorten it") from None
    known_keys(table, SCENE_KEYS)
    _required(table, ("duration", "profile", "object", "contacts"))
    table = {"name": Path(source).stem, **table, "source": source}
    return Scene(**{key: _read(key, value) for key, value in table.items()})


def _read(key: str, value: Any) -> Any:
    """The field of a scene from its value in a file."""
    if key == "duration":
        return _numbers(value, key)
    if key == "profile":
        if not isinstance(value, list):
            raise SceneError(
                f"profile = {value!r}: give a list, the coefficients of sigma(t) from that of t^0 "
                "on, such as [0.1, 0.2] for 0.1 + 0.2 t"
            )
        return Profile(_numbers(value, key))
    if key in ("contacts", "disturbances"):
        return _read_list(key, value, _read_contact if key == "contacts" else _read_disturbance)
    with naming(key):
        if key == "object":
            return _read_surface(value)
        if key == "gain":
            return _read_gain(value)
        if key == "turning":
            known_keys(_table(value), TURNING_KEYS)
            _required(value, TURNING_KEYS)
            return Turning(**{k: _numbers(x, k) for k, x in value.items()})
        if key == "paper":
            table = _table(value)
            return {k: _numbers(x, k) if k in PAPER_NUMBERS else x for k, x in table.items()}
    return value


def _read_list(key: str, value: Any, read) -> list:
    if not isinstance(value, list):
        raise SceneError(f"{key} = {value!r}: write each one as a table under [[{key}]]")
    result = []
    for i, table in enumerate(value):
        with naming(f"{key}[{i}]"):
            result.append(read(_table(table)))
    return result


def _read_contact(table: dict) -> Contact:
    known_keys(table, CONTACT_KEYS)
    _required(table, ("finger", "object_at"))
    fields = dict(table)
    with naming("finger"):
        fields["finger"] = _read_surface(table["finger"])
    for key in ("object_at", "finger_at", "angle", "finger_velocity", "object_velocity"):
        words = (ROLLING, REST) if key.endswith("velocity") else ()
        if key in fields and isinstance(fields[key], str) and words:
            if fields[key] not in words:
                raise SceneError(
                    f"{key} = '{fields[key]}': give two numbers or one of {', '.join(words)}"
                    f"{did_you_mean(fields[key], words)}"
                )
        elif key in fields:
            fields[key] = _numbers(fields[key], key)
    return Contact(**fields)


def _read_disturbance(table: dict) -> Disturbance:
    known_keys(table, DISTURBANCE_KEYS)
    _required(table, DISTURBANCE_KEYS)
    kinds = {kind.kind: kind for kind in DISTURBANCE_KINDS}
    kind = kinds[_one_of(table["kind"], kinds, "kind")]
    values = {key: _numbers(table[key], key) for key in ("start", "stop", "value")}
    return kind(contact=table["contact"], **values)


def _read_gain(value: Any) -> Gain:
    table = _table(value, 'law = "time", eta = 100')
    _required(table, ("law",))
    law = _one_of(table["law"], LAWS, "law")
    parameter = LAWS[law].parameter
    known_keys(table, ("law", parameter))
    _required(table, (parameter,))
    return Gain(law, _numbers(table[parameter], parameter))


def _read_surface(value: Any) -> Surface:
    table = _table(value, 'surface = "sphere", radius = 0.04')
    _required(table, ("surface",))
    name = _one_of(table["surface"], _SURFACES, "surface")
    kind, keys = _SURFACES[name]
    known_keys(table, ("surface", *keys, "inside"), f"{name}: ")
    _required(table, [key for key in keys if key in _REQUIRED_SURFACE_KEYS], f"{name}: ")
    arguments = {key: value for key, value in table.items() if key != "surface"}
    for key, value in arguments.items():
        if key == "inside":
            if not isinstance(value, bool):
                raise SceneError(f"inside = {value!r}: write true or false")
        elif key == "parameters":
            with naming(key):
                arguments[key] = {k: _numbers(x, k) for k, x in _table(value).items()}
        elif key not in ("f", "F"):
            arguments[key] = _numbers(value, key)
    with naming(name):
        return kind(**arguments)


def _table(value: Any, example: str = "key = value") -> dict:
    if not isinstance(value, dict):
        raise SceneError(f"{value!r} is not a table; write it like {{ {example} }}")
    return value


def _required(table: Mapping, keys: Iterable[str], place: str = "") -> None:
    for key in keys:
        if key not in table:
            raise SceneError(f"{place}key '{key}' is missing; add {key} = ...")


def _one_of(word: Any, known: Iterable[str], what: str) -> str:
    if not isinstance(word, str) or word not in known:
        raise SceneError(
            f"{what} = {word!r} is unknown{did_you_mean(word, known)}; "
            f"use one of {', '.join(known)}"
        )
    return word


def _numbers(value: Any, what: str) -> Any:
    """Numbers of a file: itself, or a list of them; arithmetic texts evaluated."""
    if isinstance(value, list):
        return tuple(_numbers(x, f"{what}[{k}]") for k, x in enumerate(value))
    if isinstance(value, str):
        with naming(what):
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
    with naming(scene.title):
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
            table = {key: getattr(contact, key) for key in CONTACT_KEYS}
            table["finger"] = _surface_table(contact.finger, f"contacts[{i}]: finger")
            lines += ["", "[[contacts]]", *_lines(table)]
        for d in scene.disturbances:
            lines += ["", "[[disturbances]]"]
            lines += _lines({key: getattr(d, key) for key in DISTURBANCE_KEYS})
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
    try:
        given = os.fsdecode(name_or_path)
    except TypeError:
        raise SceneError(f"scene = {name_or_path!r:.80}: give a name or a path") from None
    names = _bundled_names()
    if given in names:
        return (_bundled_folder() / f"{given}.toml").read_text("utf-8"), f"{given}.toml"
    try:
        return Path(given).read_text("utf-8-sig"), given  # editors on Windows begin with a mark
    except FileNotFoundError:
        near = Path(given).name.removesuffix(".toml")
        raise SceneError(
            f"'{given}' is neither a bundled scene nor a file{did_you_mean(near, names)}; "
            f"bundled are {', '.join(names)}"
        ) from None
    except (OSError, ValueError) as error:  # no text, or no name that a file may have
        raise SceneError(f"'{given}' cannot be read: {error}; give a TOML text file") from None


def save_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene as a TOML file that `load_scene` reads back to an equal scene.

    Raises
    ------
    SceneError
        If it is no scene, a file cannot hold it, or cannot be written.
    """
    require_scene(scene)
    path, text = a_path(path), scene_to_toml(scene)
    with writing(path, f"{scene.title}: "):
        path.write_text(text, "utf-8")
