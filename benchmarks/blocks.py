"""FMUs in this process, as the tests step them, and what a plan says of them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fmu_hosts.blocks import Instance, exported
from fmu_hosts.native import Fmu

import contact_system as cs

Array = np.ndarray
VERSIONS = ("2.0", "3.0")
PARTS: dict[str, tuple[str, Callable[[Array], Array]]] = {
    "slip": ("slip", lambda x: x),
    "twist.angular": ("twist", lambda x: x[..., :3]),
    "twist.linear": ("twist", lambda x: x[..., 3:]),
    "pose.rotation": ("pose", lambda x: x[..., :3, :3]),
    "pose.position": ("pose", lambda x: x[..., :3, 3]),
    "finger.point": ("points", lambda x: x[..., 0, :]),
    "object.point": ("points", lambda x: x[..., 1, :]),
}
"""Name of a variable behind ``contact[i].`` -> what a plan is asked for, and its part of that."""
_KEPT = tempfile.TemporaryDirectory(prefix="benchmarks-", ignore_cleanup_errors=True)


def folder() -> Path:
    """A new folder that is gone after this process."""
    return Path(tempfile.mkdtemp(dir=_KEPT.name))


def fmu_of(scene: cs.Scene, version: str, *platforms: str, **options: Any) -> Fmu:
    """The exported FMU of a scene, unpacked."""
    return exported(scene, version, **({"platforms": platforms} if platforms else {}), **options)


def planned(plan: cs.Plan, t: Array) -> dict[str, Array]:
    """Name of a variable -> (n_times, n_contacts, n)."""
    shape = (len(t), len(plan.scene.contacts), -1)
    asked = {name: getattr(plan, name)(t) for name, _ in PARTS.values()}
    return {name: part(asked[output]).reshape(shape) for name, (output, part) in PARTS.items()}


def outputs(block: Instance) -> dict[str, Array]:
    """What a block says now: name -> (1, n_contacts, n)."""
    contacts = range(1, len(block.scene.contacts) + 1)
    return {
        name: np.stack([block.get(f"contact[{i}].{name}") for i in contacts])[None]
        for name in PARTS
    }


def joined(seen: Sequence[dict[str, Array]]) -> dict[str, Array]:
    """What was read at several times, one after the other."""
    return {name: np.concatenate([values[name] for values in seen]) for name in PARTS}
