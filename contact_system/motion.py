"""The motion of a scene's contacts, as the engine plans and evaluates it."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref
from typing import Any

import numpy as np

from . import limits
from .buffer import MOMENT, Buffer
from .engine import binding
from .engine.binding import address
from .errors import ChartSingularity, ContactSystemError, SceneError
from .scene import DISTURBANCE_KINDS, Scene
from .starts import Moment
from .surfaces import Surface

SHAPES: dict[str, tuple[int, ...]] = {
    "states": (9,),
    "points": (2, 3),
    "slip": (2,),
    "slip_speed": (),
    "twist": (6,),
    "pose": (4, 4),
    "acceleration": (2,),
    "carried": (2, 3),
}
"""What can be asked for, in the engine's order, and its shape for one contact at one time."""
FRAMES = "frames"
"""What steering asks for besides: of each body x, p, q, and its curvature form K_pp, K_pq, K_qq."""
_ALL = {**SHAPES, FRAMES: (2, 12)}
_TIMES_FIRST = {name: (len(shape) + 1, *range(len(shape) + 1)) for name, shape in _ALL.items()}
IN_CONTACT_FRAMES = {"states", "slip", "acceleration", "carried"}
"""What needs to know the branch of the charts."""

SIDES = ("finger", "object")
ENDLESS = 1e11
ALMOST_RESTS = 1e-5  # of the greatest coefficient of sigma: what is said of an acceleration there

# failure_t.code and the kinds and reasons of fact_t, as in engine.h
_, NO_MEMORY, STUCK, TOO_MANY_PANELS, TOO_LONG, SINGULAR_CHART, SINGULAR_TIME, OUTSIDE = range(8)
CIRCLE, LINE, PANELS = range(3)
UNPUSHED, NO_SLIP, SLIP_LEFT, SLIPS, OFFSET, OFFSET_AND_SLIP, PUSHED, NEGLIGIBLE, FOLLOWING = range(
    9
)


class Motion:
    """Contacts planned by the engine: finger and object, interval by interval.

    Parameters
    ----------
    scene : Scene
    buffer : Buffer
        Its numbers.

    Raises
    ------
    ContactSystemError
        What stands in the way.
    """

    _as_parameter_: int | None = None  # the plan's address, by which the engine takes this object

    def __init__(self, scene: Scene, buffer: Buffer):
        self.scene, self._count = scene, buffer.count
        self._surfaces = buffer.surfaces  # the engine points into their tables
        addresses = (ctypes.c_void_p * len(self._surfaces))(*map(_address, self._surfaces))
        self._addresses, self._anchored = addresses, False
        failure = binding.Failure()
        size = len(buffer.numbers) // 8
        at = binding.plan(buffer.numbers, size, ctypes.addressof(addresses), byref(failure))
        self._as_parameter_ = at
        if not at:
            raise self._error(failure)

    __del__ = binding.drop

    # --- results -------------------------------------------------------------------------------

    def evaluate(self, t: np.ndarray, names: Sequence[str]) -> dict[str, np.ndarray] | None:
        """What is asked for, in one pass: (n_times, n_contacts, ...); None outside the horizon."""
        if not self._anchored and not IN_CONTACT_FRAMES.isdisjoint(names):
            self._anchor()
        t = np.ascontiguousarray(t)
        count, n = self._count, len(t)
        found = {name: np.empty((count, *_ALL[name], n)) for name in names}
        if n:
            wanted = (ctypes.c_void_p * len(_ALL))(
                *[address(found[name]) if name in found else None for name in _ALL]
            )
            failure = binding.Failure()
            at = address(t), ctypes.addressof(wanted)
            if binding.evaluate(self, n, *at, byref(failure)):
                if failure.code == OUTSIDE:
                    return None
                raise self._error(failure)
        return {name: values.transpose(_TIMES_FIRST[name]) for name, values in found.items()}

    def _anchor(self) -> None:
        """Find the branches of charts; a second time it changes nothing."""
        failure = binding.Failure()
        if binding.anchor(self, byref(failure)):
            raise self._error(failure)
        self._anchored = True

    def moments(self, t: float) -> list[Moment]:
        """Where every contact has come to at time t."""
        self._anchor()
        found = np.empty((len(self.scene.contacts), MOMENT))
        failure = binding.Failure()
        if binding.moments(self, t, address(found), byref(failure)):
            raise self._error(failure)
        return [self._moment(i, row) for i, row in enumerate(found.tolist())]

    def _moment(self, index: int, row: list[float]) -> Moment:
        frames = [
            tuple(row[at : at + 6]) if surface.tables.ambient[0] is not None else ()
            for surface, at in zip(self._bodies(index), (11, 17))
        ]
        places = tuple(row[5:8]), tuple(row[8:11])
        return Moment(row[0], tuple(row[1:3]), tuple(row[3:5]), *places, *frames)

    def _bodies(self, index: int) -> tuple[Surface, Surface]:
        return self.scene.contacts[index].finger, self.scene.object

    # --- telling -------------------------------------------------------------------------------

    def lines(self) -> list[str]:
        """Which way was taken for each contact and interval, why, and what was skipped."""
        told: dict[tuple[str, ...], list[int]] = {}
        for i in range(len(self.scene.contacts)):
            told.setdefault(tuple(self._told(i)), []).append(i)
        lines = []
        for text, contacts in told.items():
            names = ", ".join(map(str, contacts))
            lines += [f"contact{'s' * (len(contacts) > 1)} {names}:", *text]
        return lines

    def facts(self, index: int) -> list[binding.Fact]:
        """What became of a contact's bodies, interval by interval, the finger first."""
        count = binding.facts(self, index, 0, None)
        found = (binding.Fact * count)()
        binding.facts(self, index, count, found)
        return list(found)

    def _told(self, index: int) -> list[str]:
        facts = self.facts(index)
        lines = [
            f"  {SIDES[f.side]:6s} [{f.start:.6g}, {f.stop:.6g}] s  {_method(f)}"
            f"  ({self._reason(index, f)})"
            for f in facts
        ]
        return lines + [f"  skipped: {text}" for text in _skipped(facts)]

    def _reason(self, index: int, f: binding.Fact) -> str:
        if f.kind == LINE and f.panels:
            return "T = 0: the developed curve is the curve"
        if f.kind == LINE and f.reason == SLIPS:
            return "slip negligible"
        if f.reason == PUSHED:
            return self._pushes(index, f)
        why = _REASONS[f.reason].format(f)
        if f.kind == PANELS and f.by_length:
            why += "; no closed form on this surface"
        elif f.released == f.released:
            why += f", below tolerance from t = {f.released:.6g} s on"
        return why

    def _pushes(self, index: int, f: binding.Fact) -> str:
        """What acts, in the order of the kinds; on a finger only what accelerates it."""
        acting = {
            type(d)
            for d in self.scene.disturbances
            if d.contact == index and d.start <= f.start < d.stop and any(d.value)
        }
        if SIDES[f.side] == "finger":
            acting = {kind for kind in acting if kind.side == "finger"}
        return " and ".join(kind.kind for kind in DISTURBANCE_KINDS if kind in acting)

    # --- errors --------------------------------------------------------------------------------

    def _error(self, failure: binding.Failure) -> Exception:
        """What to raise for a failure of the engine."""
        name = f"{self.scene.title}, contact {failure.contact}"
        surface = self._bodies(failure.contact)[failure.side]
        if failure.code == STUCK:
            return _stuck(self.scene, name, failure)
        if failure.code == TOO_MANY_PANELS:
            return _endless(self.scene, name, failure)
        if failure.code == TOO_LONG:
            return SceneError(
                f"{name}: its path is {failure.value:.3g} times as long as {surface!r} is large, "
                "and rounding would leave less than four digits of its position (limit "
                f"{ENDLESS:g}); lower its velocity, sigma or the duration"
            )
        if failure.code == SINGULAR_CHART:
            return passed(name, surface, (failure.u, failure.v))
        if failure.code == SINGULAR_TIME:
            return singular(name, surface, failure.t)
        return ContactSystemError(
            f"{name}: there is not enough memory; shorten the scene, or plan fewer contacts at once"
        )


MAY_BE_SINGULAR = 1  # surface_t.flags: nobody knows where the chart is regular


def _address(surface: Surface) -> int:
    """Of the engine's ``surface_t``; that of a user's surface is made once and kept with it."""
    if surface.table_name is not None:
        return surface.tables.address
    data = surface.__dict__.get("_engine_data")
    if data is None:
        data = binding.surface_data(
            surface.tables,
            len(surface.numbers),
            surface.double_cover,
            0,
            0 if surface.has_implicit else MAY_BE_SINGULAR,
            surface.periods(),
        )
        surface.__dict__["_engine_data"] = data
    return ctypes.addressof(data)


def singular(name: str, surface: Surface, t: float) -> ChartSingularity:
    """The error of a contact at a pole or an umbilic at time t."""
    return ChartSingularity(
        f"{name}: {surface!r}: at t = {t:.17g} s the contact is at a singular point of the chart "
        f"({surface.chart.singular_at or 'pole'}), where u', v' and psi do not exist. Ask for "
        "points, pose and twist there (they do), or for a time nearby"
    )


def passed(name: str, surface: Surface, place: tuple[float, float]) -> ContactSystemError:
    """The error of a path through a singular point of its chart."""
    other = "use the default method" if surface.has_implicit else "give an ImplicitSurface"
    return ContactSystemError(
        f"{name}: the path goes through a singular point of its chart, {surface!r} at (u, v) = "
        f"({place[0]:.9g}, {place[1]:.9g}), where the contact frame turns over; start elsewhere, "
        f"change the direction, end the scene before, or {other}, which needs no chart"
    )


def _pushed_at_rest(scene: Scene, failure: binding.Failure) -> str:
    """What to do about an acceleration where the path all but rests; empty elsewhere."""
    sigma, way = failure.value, scene.way(failure.contact)
    greatest = max(abs(c) for stretch in way for c in stretch.profile.coefficients)
    if not failure.pushed or sigma > ALMOST_RESTS * greatest:
        return ""
    return (
        f"an acceleration acts where the path almost rests, sigma = {sigma:.3g} m/s; add a "
        "constant to the profile, or accelerate before or after"
    )


def _stuck(scene: Scene, name: str, failure: binding.Failure) -> ContactSystemError:
    why = _pushed_at_rest(scene, failure) or (
        "the path reaches a singular point of its chart or its surface, or moves too fast for "
        "double precision; start elsewhere, change the direction or end the scene before"
    )
    variable = "arc length" if failure.by_length else "local time"
    return ContactSystemError(
        f"{name}: the motion cannot be continued past {variable} {failure.t:.9g}: {why}"
    )


def _endless(scene: Scene, name: str, failure: binding.Failure) -> ContactSystemError:
    why = _pushed_at_rest(scene, failure) or (
        "shorten the scene, lower the speed, the acceleration or the surface's curvature, or give "
        "a surface of your own a greater size; where a disturbance drives the contact into a pole "
        "of its chart, end its window before"
    )
    variable = "arc length" if failure.by_length else "local time"
    return ContactSystemError(
        f"{name}: {failure.panels} panels reach {variable} {failure.t:.9g} of {failure.end:.9g} "
        f"only, and what is left of the plan's limit will not do: it has tried {failure.spent}, "
        f"contact {failure.greediest} most, {failure.most}, and the limit is {limits.PANELS:.15g}; "
        f"{why}, or set contact_system.limits.PANELS higher"
    )


_REASONS = {
    UNPUSHED: "nothing accelerates it",
    NO_SLIP: "no slip",
    SLIP_LEFT: "slip has fallen below tolerance at t = {0.start:.6g} s",
    SLIPS: "slip",
    OFFSET: "object rate offset",
    OFFSET_AND_SLIP: "object rate offset, slip",
    NEGLIGIBLE: "slip negligible",
    FOLLOWING: "rolling is imposed",
}


def _method(f: binding.Fact) -> str:
    place = "space" if f.ambient else "its chart"
    if f.kind == CIRCLE:
        return "closed form: great circle"
    if f.kind == LINE and f.panels:
        return f"quadrature of slip, {f.panels} panels"
    if f.kind == LINE:
        return "closed form: straight line on the developed surface"
    if f.forced:
        return f"forced development, {f.panels} panels"
    if f.by_length:
        return f"geodesic in arc length, in {place}, {f.panels} panels"
    return f"development in {place}, {f.panels} panels"


def _skipped(facts: Sequence[binding.Fact]) -> list[str]:
    def closed(f: binding.Fact) -> bool:
        return f.kind == CIRCLE or (f.kind == LINE and not f.panels)

    notes = []
    if all(map(closed, facts)):
        notes.append("all integration")
    elif all(closed(f) for f in facts if SIDES[f.side] == "finger"):
        notes.append("integration of the finger")
    objects: list[Any] = [f for f in facts if SIDES[f.side] == "object"]
    if not any(f.slips or f.forced or f.reason in (SLIP_LEFT, NEGLIGIBLE) for f in objects):
        if any(f.reason == OFFSET for f in objects):
            notes.append("gain (slip is that of rate offsets, which ends with them)")
        else:
            notes.append("slip and gain (there is none to reject)")
    return notes
