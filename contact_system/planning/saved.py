"""Saved plans: their inputs as texts, read back if nothing in the file was changed."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..archives import opened
from ..checks import known_keys, naming, within
from ..errors import ContactSystemError, SceneError
from ..scene import Start, scene_to_toml
from .starts import Moment, Starts

if TYPE_CHECKING:
    from ..plan import Plan

KEYS = ("tolerance", "method", "solver", "start", "starts")  # arguments and attributes of a Plan
PLAN_FILE = "a plan written by Plan.save"


def texts_of(plan: Plan) -> dict[str, str]:
    """The texts of a saved plan: its scene as TOML, its other inputs as JSON, and their digest."""
    header = {key: getattr(plan, key) for key in KEYS}
    header["starts"] = [start._asdict() for start in plan.starts] if plan.starts else None
    texts = {"scene": scene_to_toml(plan.scene), "plan": json.dumps(header)}
    return texts | {"digest": digest(texts.values())}


def digest(texts: Iterable[str]) -> str:
    """Digest of the texts, by which changes of the file are noticed."""
    import hashlib  # slow to import

    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


def read_plan(path: Path) -> tuple[str, dict[str, Any]]:
    """The scene's TOML text and the other inputs of a saved plan, by `KEYS`.

    Raises
    ------
    ContactSystemError
        No such file, a damaged one, or one that was changed after it was written.
    """
    with opened(path, PLAN_FILE) as archive:
        texts = []
        for name in ("scene", "plan", "digest"):
            info = archive.getinfo(f"{name}.npy")
            what = f"{info.filename}: bytes when unpacked"
            within("PLAN_BYTES", info.file_size, what, ContactSystemError)
            data = io.BytesIO(archive.read(info))
            texts.append(str(np.lib.format.read_array(data, allow_pickle=False)[()]))
        scene, plan, known = texts
        if known != digest([scene, plan]):
            raise ContactSystemError(
                f"{path}: not {PLAN_FILE}, but changed since: its digest does not match; take "
                "the file as it was written"
            )
        header = json.loads(plan)
    with naming(f"{path}: not {PLAN_FILE}"):
        if not isinstance(header, dict):
            raise SceneError(f"plan = {header!r}: give a table of {', '.join(KEYS)}")
        known_keys(header, KEYS, "plan: ")
        for key in KEYS:
            if key not in header:
                raise SceneError(f"plan: key '{key}' is missing; save the plan again")
    return scene, header


def starts_of(tables: list[dict[str, Any]] | None) -> Starts | None:
    """The starts of a saved plan's contacts."""
    if tables is None:
        return None
    kind: Any = Moment if "slip" in tables[0] else Start
    return [
        kind(**{key: tuple(x) if isinstance(x, list) else x for key, x in table.items()})
        for table in tables
    ]
