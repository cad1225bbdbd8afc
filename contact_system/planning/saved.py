"""Saved plans: their inputs as texts, and reading them back unless the file was changed since."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

import numpy as np

from ..checks import within
from ..errors import ContactSystemError
from ..scene import Start, scene_from_toml, scene_to_toml
from .starts import Moment

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
    """Digest of the texts, which reveals changes of the file."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


def inputs_of(archive: ZipFile, source: str) -> dict[str, Any]:
    """The arguments of a saved plan; `source` names its file.

    Raises a ContactSystemError if the file exceeds a limit, or was changed after it was written,
    and other errors if it is no saved plan.
    """
    texts = []
    for name in ("scene", "plan", "digest"):
        info = archive.getinfo(f"{name}.npy")
        what = f"{info.filename}: bytes when unpacked"
        within("PLAN_BYTES", info.file_size, what, ContactSystemError)
        texts.append(str(np.load(io.BytesIO(archive.read(info)))))
    scene, plan, known = texts
    if known != digest([scene, plan]):
        raise ContactSystemError(
            f"not {PLAN_FILE}, but changed since: its digest does not match; use the file as it "
            "was written"
        )
    inputs = json.loads(plan)
    if tables := inputs["starts"]:
        kind: Any = Moment if "slip" in tables[0] else Start
        inputs["starts"] = [
            kind(**{key: tuple(x) if isinstance(x, list) else x for key, x in table.items()})
            for table in tables
        ]
    return {"scene": scene_from_toml(scene, source), **inputs}
