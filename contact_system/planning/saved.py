"""Saved plans: their inputs as texts, and reading them back."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import within
from ..errors import ContactSystemError
from ..scene import Start, scene_from_toml, scene_to_toml
from .starts import Moment

if TYPE_CHECKING:
    from zipfile import ZipFile

    from ..plan import Plan

KEYS = ("tolerance", "method", "solver", "start", "starts")  # arguments and attributes of a Plan


def texts_of(plan: Plan) -> dict[str, str]:
    """The texts of a saved plan: its scene as TOML, its other inputs as JSON."""
    header = {key: getattr(plan, key) for key in KEYS}
    header["starts"] = [start._asdict() for start in plan.starts] if plan.starts else None
    return {"scene": scene_to_toml(plan.scene), "plan": json.dumps(header)}


def inputs_of(archive: ZipFile, source: str) -> dict[str, Any]:
    """The arguments of a saved plan; `source` names its file.

    Raises a ContactSystemError if the file exceeds a limit, other errors if it is no saved plan.
    """
    scene, plan = (_text(archive, f"{name}.npy") for name in ("scene", "plan"))
    inputs = json.loads(plan)
    if tables := inputs["starts"]:
        kind: Any = Moment if "slip" in tables[0] else Start
        inputs["starts"] = [
            kind(**{key: tuple(x) if isinstance(x, list) else x for key, x in table.items()})
            for table in tables
        ]
    return {"scene": scene_from_toml(scene, source), **inputs}


def _text(archive: ZipFile, member: str) -> str:
    size = archive.getinfo(member).file_size
    within("PLAN_BYTES", size, f"{member}: bytes when unpacked", ContactSystemError)
    return str(np.load(io.BytesIO(archive.read(member))))
