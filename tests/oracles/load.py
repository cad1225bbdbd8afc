"""Read the reference solutions of this folder, and the scenes that they are of."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import contact_system as cs

_SURFACES = {
    "sphere": cs.Sphere,
    "cylinder": cs.Cylinder,
    "torus": cs.Torus,
    "ellipsoid": cs.Ellipsoid,
}
_WINDOWS = {"finger": cs.FingerAcceleration, "object": cs.ObjectAcceleration}
_START = ("object_at", "object_velocity", "finger_at", "finger_velocity", "angle")


def load(name: str) -> dict[str, Any]:
    """The reference file `name`.json with every list of numbers as a float64 array.

    "k_scenes", "k_scenes_time", "torus_slip", "ellipsoid_slip", "sphere_slip", "slip_peaks":
    scenes under the key "scenes", each with "times" (n,) in s and "contacts", a list of records
    holding "states" (n, 9), "points" (n, 2, 3) in m and "slip" (n, 2) in m/s; their inputs
    beside them. "ellipsoid_geodesics": "start" (200, 3) and "middle", "end", "end_direction"
    (200, 3), "jacobi" (200,). "geodesics": records under the key "geodesics", each with
    "times" (n,) in s and "points" (n, 3) in m. The key "about" describes the file.
    """
    return _convert(json.loads(Path(__file__).with_name(f"{name}.json").read_text()))


def surface_of(record: dict[str, Any]) -> cs.Surface:
    """The surface that a record's "object" describes."""
    return _SURFACES[record["surface"]](*record["radii"])


def scene_of(record: dict[str, Any]) -> cs.Scene:
    """The scene that a record of "scenes" describes."""
    finger, gain = cs.Sphere(record["finger_radius"]), record["gain"]
    starts = ({key: _plain(contact[key]) for key in _START} for contact in record["contacts"])
    return cs.Scene(
        object=surface_of(record["object"]),
        contacts=[cs.Contact(finger, **start) for start in starts],
        profile=cs.Profile(record["profile"]),
        gain=cs.Gain(gain["law"], gain["eta"]),
        duration=record["duration"],
        disturbances=[
            _WINDOWS[w["kind"]]("all", w["start"], w["stop"], w["value"]) for w in record["windows"]
        ],
    )


def _plain(value: Any) -> Any:
    return tuple(value) if isinstance(value, np.ndarray) else value


def _convert(node: Any) -> Any:
    """Replace numbers, decimal texts and lists of them; leave words and records alone."""
    if isinstance(node, dict):
        return {key: _convert(value) for key, value in node.items()}
    if isinstance(node, list):
        parts = [_convert(value) for value in node]
        return parts if any(isinstance(part, dict) for part in parts) else np.array(parts)
    if isinstance(node, str):
        try:
            return float(node)
        except ValueError:
            return node
    return float(node)
