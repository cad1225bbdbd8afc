"""How contacts start: as a scene says, from measured states, or at a later time of a plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..checks import finite_number, naming, shaped_array
from ..errors import SceneError
from ..scene import SIDES, Scene, Start, speed
from ..scene.legs import length
from ..surfaces import Surface, run_in_space
from ..theory.development import in_space


class Moment(NamedTuple):
    """One contact at one time of a plan: all that another plan needs to start from it exactly."""

    finger_at: tuple[float, ...]  # u, v, theta, continuous along the path
    object_at: tuple[float, ...]
    angle: float  # psi where both frame angles are zero
    finger_velocity: tuple[float, ...]  # W_1 in the parallel frame (theory section 4)
    slip: tuple[float, ...]  # V in the parallel frame
    finger_frame: tuple[float, ...]  # x, p; empty if the body is planned in its chart
    object_frame: tuple[float, ...]


Starts = Sequence[Start | Moment]
"""One for each contact, either all Start or all Moment."""


def require_place(surface: Surface, u: float, v: float, place: str) -> None:
    """Refuse coordinates outside the chart's regular range, except those off by whole periods."""
    with naming(place):
        at = surface.canonical(u, v)
    near = surface.align(*at, u, v)
    if math.hypot(near[0] - u, near[1] - v) > 1e-9:
        raise SceneError(
            f"{place}: (u, v) = ({u:.9g}, {v:.9g}) is outside the chart of {surface!r}; give the "
            f"same point as ({at[0]:.9g}, {at[1]:.9g}), where the rates and psi have other "
            "values"
        )


def read_starts(scene: Scene, begin: Any, tables: Any) -> Starts | None:
    """How a saved plan starts at a time, s, from the tables in its file.

    The file may be from anybody, and the engine trusts its numbers: refuses a time at which no plan
    begins, numbers that are missing or not finite, and points off the bodies.
    """
    if not 0 <= finite_number(begin, "start") < scene.duration:
        raise SceneError(f"start = {begin!r}: the scene lasts from 0 to {scene.duration:g} s")
    starts: list[Start | Moment] = []
    kind: Any = Moment if tables and "slip" in tables[0] else Start
    for contact, table in zip(scene.contacts, tables or (), strict=bool(tables)):
        fields = {key: tuple(x) if isinstance(x, list) else x for key, x in table.items()}
        with naming(f"starts[{len(starts)}]"):
            starts.append(_checked(kind(**fields), contact.finger, scene.object))
    return starts or None


def _checked(start: Start | Moment, *bodies: Surface) -> Start | Moment:
    """The start; refuses numbers that no plan has."""
    for key, value in start._asdict().items():
        shape: tuple[int, ...] = (3,) if key.endswith("_at") and type(start) is Moment else (2,)
        if key.endswith("_frame"):
            shape = (6,) if in_space(bodies[SIDES.index(key[:6])]) else (0,)
        shaped_array(value, key, () if key == "angle" else shape, finite=True)
    for side, body in zip(SIDES, bodies):
        if isinstance(start, Start):
            u, v = getattr(start, f"{side}_at")
            require_place(body, u, v, side)
        elif in_space(body):
            frame = getattr(start, f"{side}_frame")
            off = run_in_space(body, "restore", np.transpose([frame]))[:, 0] - frame
            size = max(body.size, math.hypot(*frame[:3]))  # far points are rounded more
            if not np.abs(off / ([size] * 3 + [1.0] * 3)).max() <= 1e-9:
                raise SceneError(f"{side}_frame = {frame}: off the body, or no unit tangent")
    return start


def measured_start(
    scene: Scene, index: int, t: float, row: np.ndarray, offset: np.ndarray
) -> Start:
    """The start of a contact from its measured state at time t.

    row (9): u1 v1 u1' v1' u2 v2 u2' v2' psi, with the object's rate offset, ``offset`` (2), in u2'
    and v2'. Of a contact that rests to the end the rates are not used. Refuses NaN, sigma = 0 of
    others, a pole, and coordinates outside the chart.
    """
    where = f"{scene.title}, restart at t = {t:g} s, {scene.contact_title(index)}"
    contact, way = scene.contacts[index], scene.way(index)
    sigma, rests = float(speed(way, t)), length(way, scene.duration) == length(way, t)
    if not np.isfinite(row).all():
        raise SceneError(
            f"{where}: the measured state has {row[~np.isfinite(row)][0]}; leave such a "
            "measurement out"
        )
    if not (0 < sigma < math.inf or rests):
        raise SceneError(
            f"{where}: sigma = {sigma:g} there, so rates do not determine path velocities; restart "
            "where sigma > 0"
        )
    velocities = []
    transported = row[4:8] - [0.0, 0.0, *offset]
    for side, surface, (u, v, *rates) in (
        ("finger", contact.finger, row[:4]),
        ("object", scene.object, transported),
    ):
        require_place(surface, u, v, f"{where}, {side}")
        velocities.append(surface.metric_root(u, v) @ rates)
    w1, w2 = contact.start()[3:] if rests else (tuple(w / sigma) for w in velocities)
    return Start(tuple(row[0:2]), tuple(row[4:6]), float(row[8]), w1, w2)


def on_branch(scene: Scene, measured: np.ndarray, planned: np.ndarray) -> np.ndarray:
    """Measured states (n_contacts, 9) on the planned branch of charts that are double covers.

    Disturbances are chart components: on the other branch they would have the opposite direction.
    """
    rows = measured.copy()
    for row, plan_row, contact in zip(rows, planned, scene.contacts):
        for surface, k in ((contact.finger, 0), (scene.object, 4)):
            if not surface.chart.double_cover:
                continue
            *row[k : k + 2], turned = surface.align(*row[k : k + 2], *plan_row[k : k + 2])
            if turned:
                row[k + 2 : k + 4] *= -1
                row[8] = plan_row[8] + math.remainder(row[8] + math.pi - plan_row[8], 2 * math.pi)
    return rows
