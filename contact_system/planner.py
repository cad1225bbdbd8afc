"""From a scene to a plan: per contact and interval, the cheapest exact way to move it.

Contacts of one kind (same surfaces, same windows) move together. For each group the horizon is cut
at the edges of its own windows; on each interval

* a finger that nothing accelerates runs on a geodesic, in closed form on plane, cylinder and
  sphere, else integrated once in arc length;
* the object runs on a geodesic too while slip is negligible, on the developed curve
  W s - V g while there is;
* only contacts under an acceleration are integrated together with their forcing.
"""

from __future__ import annotations

import functools
import math
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .charts import TINY
from .closed_form import CircleTrack, FlatTrack, great_circle, pair_of, slip_length
from .development import (
    axis_forced_motion,
    axis_motion,
    contact_start,
    rolling_motion,
)
from .errors import ContactSystemError, SceneError
from .geodesics import GeodesicTrack, geodesic_form
from .groups import Group, SlipRecord
from .kept import kept
from .kernels import Kernel, contiguous
from .panel_tracks import Forced, MovingTrack, PanelTrack
from .panels import Motion, Panels, Problem, integrate, usable
from .profile import GainPiece, Profile
from .scene import (
    DISTURBANCE_KINDS,
    Disturbance,
    FingerAcceleration,
    ObjectAcceleration,
    ObjectRateOffset,
    Scene,
    refuse_rest,
)
from .starts import Moment, Starts, scene_start
from .surfaces import Surface
from .tracks import (
    AXIS,
    Evaluator,
    Track,
    axis_kernel,
    in_space,
    lame_kernel,
    passed,
    prefers_ambient,
    restoring_axis,
    scale_kernel,
)

FIRST = 0.7  # least radii along a first panel's path, at a tolerance of 1e-12
# Slip whose whole remaining displacement is below this fraction of tolerance * size is let go.
NEGLIGIBLE = 0.01
# The same of what no tolerance asks for.
ROUNDING = 1e-17
# Slip left when a slipping object goes over to a great circle, in path speeds and tolerances.
RATE_LEFT = 0.1
# Path beyond which, in sizes of a sphere, the rest of a slipping interval is made a great circle.
LONG_REST = 6.0
# Path, in sizes of a body, after which rounding leaves less than four digits of its position.
ENDLESS = 1e11


@dataclass(eq=False)
class Body:
    """The bodies of one side of a group where they stand.

    Attributes
    ----------
    surface : Surface
        One of their surfaces.
    parameters : (n, n_parameters)
    sizes : (n, 1)
        Length scale of each, m.
    state : (n, 6) ambient, (x, p); or (n, 3) chart, (u, v, theta)
    ambient : bool
    size, bend : float
        The least of the sizes, and of the least radii, m.
    scales : dict
        What does not depend on where they stand: the scale of (x, p).
    """

    surface: Surface
    parameters: np.ndarray
    sizes: np.ndarray
    state: np.ndarray
    ambient: bool
    size: float
    bend: float
    scales: dict[bool, np.ndarray] = field(default_factory=dict)

    @classmethod
    def of(cls, surfaces: Sequence[Surface]) -> Body:
        """Bodies of one structure, nowhere yet."""
        parameters = np.array([s.parameters for s in surfaces], dtype=float)
        sizes, nowhere = [s.size for s in surfaces], np.empty((len(surfaces), 0))
        return cls(
            surfaces[0], parameters, np.array(sizes)[:, None], nowhere, False, min(sizes),
            min(s.bend for s in surfaces),
        )  # fmt: skip

    def at(self, state: np.ndarray, ambient: bool) -> Body:
        """The same bodies elsewhere."""
        return Body(
            self.surface, self.parameters, self.sizes, state, ambient, self.size, self.bend,
            self.scales,
        )  # fmt: skip

    @property
    def lame(self) -> np.ndarray:
        """h_u, h_v of each body where it stands, chart form: (n, 2)."""
        return lame_kernel(self.surface).at(self.state, self.parameters)

    @property
    def scale(self) -> np.ndarray:
        """1 / (size of the states)."""
        scale = self.scales.get(self.ambient)
        if scale is None:
            numbers = np.concatenate([self.parameters, self.sizes], axis=1)
            scale = scale_kernel(self.surface, self.ambient).at(self.state, numbers)
            if self.ambient:
                self.scales[True] = scale
        return scale


@dataclass(frozen=True, eq=False)
class Interval:
    """One interval of a group between edges of its windows.

    Attributes
    ----------
    start, stop, length : float
        s, s, m.
    piece : GainPiece
    forcing : dict
        Sums of chart components by kind of disturbance: (n, 2) each.
    pushed : bool
        A finger is accelerated.
    free_until : float
        The end of the run of intervals, from this one on, in which no finger is accelerated.
    reach : float
        Slip V still moves the contact by |V|/reach at most.
    """

    start: float
    stop: float
    length: float
    piece: GainPiece
    forcing: dict[type[Disturbance], np.ndarray]
    pushed: bool
    free_until: float
    reach: float

    @kept
    def accelerated(self) -> bool:
        """Finger or object is accelerated."""
        return self.pushed or bool(self.forcing[ObjectAcceleration].any())

    @kept
    def turns(self) -> bool:
        """Something is given in chart components of the object."""
        return bool(self.forcing[ObjectAcceleration].any()) or self.offset is not None

    @kept
    def offset(self) -> np.ndarray | None:
        """Object rate offsets, (n, 2), or None where there are none."""
        offset = self.forcing[ObjectRateOffset]
        return offset if offset.any() else None


@dataclass(frozen=True, eq=False)
class Pattern:
    """What scenes that differ only in where contacts start have in common, of one group.

    ``finger`` and ``object`` stand nowhere. ``memory`` holds tracks and problems that begin at
    edges of the intervals, from which those of another start or tolerance are made, with what C
    knows of them.
    """

    contacts: np.ndarray
    finger: Body
    object: Body
    follows: bool
    intervals: tuple[Interval, ...]
    memory: dict[Any, Any] = field(default_factory=dict)

    @kept
    def edges(self) -> set[float]:
        """Starts of the intervals."""
        return {interval.start for interval in self.intervals}


@dataclass(eq=False)
class Prepared:
    """What the scene alone says about a group; kept with the scene, so worked out once.

    ``memory`` holds what planning finds and no tolerance changes: great circles from the start, and
    whole groups that consist of them.
    """

    scene: Scene
    pattern: Pattern
    begin: float
    angle: np.ndarray
    r0: np.ndarray
    w1: np.ndarray
    w2: np.ndarray
    v: np.ndarray
    finger: Body
    object: Body
    at: tuple[np.ndarray, np.ndarray]
    memory: dict[Any, Any] = field(default_factory=dict)


def plan_groups(
    scene: Scene,
    starts: Starts | None,
    begin: float,
    tolerance: float,
    compiled: bool | None,
) -> list[Group]:
    """Plan all contacts from time ``begin``; ``starts`` None: as the scene says, from 0."""
    if starts is None:
        prepared = scene.__dict__.get("_prepared")
        if prepared is None:
            prepared = prepare(scene, [scene_start(c) for c in scene.contacts], 0.0)
            scene.__dict__["_prepared"] = prepared
    else:
        prepared = prepare(scene, starts, begin)
    return [_planned(group, tolerance, compiled) for group in prepared]


def _planned(prepared: Prepared, tolerance: float, compiled: bool | None) -> Group:
    known: Group | None = prepared.memory.get(("group", compiled))
    if known is not None:
        return known.again(tolerance)
    group = GroupPlanner(prepared, tolerance, compiled).run()
    if "repeats" not in prepared.memory:
        prepared.memory["repeats"] = group.repeats(tolerance)
    if prepared.memory["repeats"]:
        prepared.memory["group", compiled] = group.again(tolerance)  # without what this one finds
    return group


def prepare(scene: Scene, starts: Starts, begin: float) -> list[Prepared]:
    """Sort the contacts into groups that can move together, and lay out their intervals."""
    moved = isinstance(starts[0], Moment)
    known = [
        (s.angle, *s.finger_velocity, *(s.slip if isinstance(s, Moment) else s.object_velocity))
        for s in starts
    ]
    numbers = np.array(known, dtype=float)
    found = contact_start().at(numbers, np.empty((len(starts), 0)))
    parts = found[:, :4], numbers[:, 1:3], found[:, 4:6], numbers[:, 3:5] if moved else found[:, 6:]
    turns, w1, w2, v = map(np.ascontiguousarray, parts)  # C reads them
    turns = turns.reshape(-1, 2, 2)
    slips = tuple([x != 0.0 or y != 0.0 for x, y in v.tolist()])
    groups, patterns = [], _patterns(scene, slips, begin)
    for pattern in patterns:
        indices = pattern.contacts.tolist()
        own = [starts[i] for i in indices]
        fingers = [scene.contacts[i].finger for i in indices]
        finger, finger_at = _standing(pattern.finger, fingers, own, "finger")
        obj, object_at = _standing(pattern.object, [scene.object] * len(own), own, "object")
        chosen: Any = indices if len(patterns) > 1 else slice(None)
        groups.append(Prepared(
            scene, pattern, begin, np.array([s.angle for s in own]), turns[chosen],
            w1[chosen], w2[chosen], v[chosen], finger, obj, (finger_at, object_at),
        ))  # fmt: skip
    return groups


@dataclass(eq=False)
class Family:
    """What is remembered of scenes that differ only in where and how fast their contacts start.

    Attributes
    ----------
    patterns : dict
        By which contacts slip; of few contacts alone.
    learned : dict
        What `kinds` learned of such scenes, by how they are compiled.
    """

    patterns: dict[tuple[bool, ...], list[Pattern]] = field(default_factory=dict)
    learned: dict[bool | None, Any] = field(default_factory=dict)

    @property
    def has_kind(self) -> bool:
        """Whether `kinds` learned how to plan such scenes by numbers alone."""
        return any(known.kinds for known in list(self.learned.values()))


FAMILIES = 512  # the latest, which are remembered; 2 to 40 kB each
MOST_ALIKE = 16  # contacts of a scene whose patterns are
_FAMILIES: OrderedDict[Hashable, Family] = OrderedDict()
_WITH_KIND: OrderedDict[Hashable, Family] = OrderedDict()  # no scenes planned once push them out
_LATEST: tuple[Hashable, Family] = (None, Family())  # a key is compared sooner than hashed


def family(scene: Scene) -> Family:
    """That of a scene."""
    global _LATEST
    key, (latest, known) = scene.likeness, _LATEST
    if key == latest:
        return known
    found = _WITH_KIND.get(key)
    if found is not None:
        _LATEST = key, found
        return found
    found = _FAMILIES.pop(key, None) or Family()
    room = _WITH_KIND if found.has_kind else _FAMILIES
    room[key] = found  # the latest is last
    if len(room) > FAMILIES:
        room.popitem(last=False)
    return found


def _patterns(scene: Scene, slips: tuple[bool, ...], begin: float) -> list[Pattern]:
    """Contacts sorted into groups that move together, and their intervals."""
    if begin > 0.0 or len(slips) > MOST_ALIKE:
        return _sorted(scene, slips, begin)
    known = family(scene).patterns
    if slips not in known:
        known[slips] = _sorted(scene, slips, begin)
    return known[slips]


def _sorted(scene: Scene, slips: tuple[bool, ...], begin: float) -> list[Pattern]:
    windows: list[list[Disturbance]] = [[] for _ in slips]
    for d in scene.disturbances:
        if d.stop > begin:
            windows[d.contact].append(d)  # type: ignore[index]
    members: dict[tuple, list[int]] = {}
    for i, contact in enumerate(scene.contacts):
        shape = tuple((type(d), d.start, d.stop) for d in windows[i])
        kind = (
            contact.finger.structure,
            contact.follows,
            shape,
            slips[i],
        )
        members.setdefault(kind, []).append(i)
    patterns = []
    for indices in members.values():
        first = indices[0]
        disturbed = [(k, d) for k, i in enumerate(indices) for d in windows[i]]
        patterns.append(Pattern(
            np.array(indices), Body.of([scene.contacts[i].finger for i in indices]),
            Body.of([scene.object] * len(indices)), scene.contacts[first].follows,
            _intervals(scene, len(indices), disturbed, slips[first], begin),
        ))  # fmt: skip
    return patterns


def _intervals(
    scene: Scene, count: int, disturbed: list[tuple[int, Disturbance]], slips: bool, begin: float
) -> tuple[Interval, ...]:
    profile, gain, end = scene.profile, scene.gain, scene.duration
    edges = {begin, end, *(t for _, d in disturbed for t in (d.start, d.stop) if t > begin)}
    if slips or disturbed:
        edges |= {p.start for p in gain.pieces(profile, begin, end)}
    knots = sorted(edges)
    result: list[Interval] = []
    free_until, none = end, np.zeros((count, 2))
    for start, stop in reversed(list(zip(knots, knots[1:]))):
        forcing: dict[type[Disturbance], np.ndarray] = dict.fromkeys(DISTURBANCE_KINDS, none)
        for k, d in disturbed:
            if d.start <= start and stop <= d.stop:
                if forcing[type(d)] is none:
                    forcing[type(d)] = none.copy()
                forcing[type(d)][k] += d.value
        pushed = bool(disturbed) and bool(forcing[FingerAcceleration].any())
        if pushed:
            free_until = start
        piece = gain.pieces(profile, start, stop)[0]
        length = piece.arc_length(stop - start)
        result.append(Interval(start, stop, length, piece, forcing, pushed, free_until,
                               _slip_reach(scene, piece, length)))  # fmt: skip
    return tuple(reversed(result))


@dataclass(eq=False)
class _Forced:
    """What an interval under accelerations is, wherever its contacts have come to.

    Attributes
    ----------
    kernel : Kernel
    problem : Problem
        But for its start, angles and W_1.
    given : slice
        Where cos psi, sin psi and W_1 stand in the constants.
    grown : float
        Slip that the accelerations can bring about, or what is small.
    why : str
    compiled : bool or None
    known : array or None
        The scale, if it depends neither on where contacts are nor on slip at the start.
    motion : Motion or None
        One of them, laid out for C.
    """

    kernel: Kernel
    problem: Problem
    given: slice
    grown: float
    why: str
    compiled: bool | None
    known: np.ndarray | None = None
    motion: Motion | None = None

    def scale(self, tip: Body, obj: Body, pushed: bool, v: np.ndarray) -> np.ndarray:
        """1 / (size of the states), for slips v at the start: slip is to be right to tolerance."""
        small = _greatest(v) <= self.grown
        if small and self.known is not None:
            return self.known
        slip = np.maximum(np.hypot(v[:, :1], v[:, 1:]), self.grown)
        ones = np.ones((len(v), 2))
        finger = [tip.scale, ones] if pushed else []
        found = np.concatenate([*finger, obj.scale, ones / np.minimum(slip, 1.0)], axis=1)
        if small and obj.ambient and (tip.ambient or not pushed):
            self.known = found
        return found

    def integrate(
        self, name: str, start: np.ndarray, given: np.ndarray, scale: np.ndarray, tolerance: float
    ) -> tuple[Panels, Motion | None]:
        """The motion from a state, (n, n_states), with cos psi, sin psi and W_1, (n, 4)."""
        constants = self.problem.constants.copy()
        constants[:, self.given] = given
        problem = self.problem.moved(start, constants, name=name, scale=scale)
        if self.motion is not None:
            motion = self.motion.again(tolerance, problem)
        elif usable(self.kernel, self.compiled):
            motion = Motion(self.kernel, problem, tolerance)
            self.motion = motion.again(tolerance)  # without what this one finds
        else:
            return integrate(self.kernel, problem, tolerance, False), None
        return motion.panels(), motion


class GroupPlanner:
    """Builds the tracks of one group, interval by interval."""

    def __init__(self, prepared: Prepared, tolerance: float, compiled: bool | None):
        self.prepared, self.tolerance, self.compiled = prepared, tolerance, compiled
        self.scene, self.r0 = prepared.scene, prepared.r0
        self.w1, self.w2, self.v = prepared.w1, prepared.w2, prepared.v
        self.finger, self.object = prepared.finger, prepared.object
        self.pattern = pattern = prepared.pattern
        self.group = Group(pattern.contacts, prepared.r0, prepared.angle, prepared.at)
        self.name: str = self._once("name", lambda: group_name(self.scene, pattern.contacts))

    def run(self) -> Group:
        """Plan every interval in turn."""
        self._once("checked", self._refuse_endless)
        if self.pattern.follows:
            self._rolling_imposed()
            return self.group
        finger_until = self.prepared.begin
        for interval in self.pattern.intervals:
            if interval.pushed:
                finger_until = interval.stop
            elif finger_until <= interval.start:
                finger_until = interval.free_until
                track = self._geodesic(
                    "finger", interval.start, finger_until, "nothing accelerates it"
                )
                self._append("finger", track)
            if interval.accelerated:
                self._forced(interval)
            else:
                self._free(interval)
        group = self.group
        tracks = group.finger + group.object
        circles = [track for track in tracks if isinstance(track, CircleTrack)]
        if len(circles) == len(tracks) and not self.v.any():
            group.pair = pair_of(circles)
        kinds = len(group.finger), *((type(t), t.ambient) for t in tracks)
        group.layouts = self.pattern.memory.setdefault(("layouts", self.compiled, kinds), {})
        return group

    def _once(self, key: Any, find: Callable[[], Any]) -> Any:
        """What the scene alone says, found once."""
        memory = self.prepared.memory
        if key not in memory:
            memory[key] = find()
        return memory[key]

    def _refuse_endless(self) -> bool:
        path = sum(interval.length for interval in self.pattern.intervals)
        for w, body in ((self.w1, self.finger), (self.w2 - self.v, self.object)):
            if len(w) < 8 and _greatest(w) * path <= ENDLESS * body.size:
                continue  # the commonest, without numpy's 10 us
            with np.errstate(over="ignore"):
                turns = np.hypot(w[:, 0], w[:, 1]) * path / body.sizes[:, 0]
            if not turns.max() <= ENDLESS:
                worst = int(self.pattern.contacts[turns.argmax()])
                raise SceneError(
                    f"{self.scene.title}, contact {worst}: its path is {turns.max():.3g} "
                    f"times as long as {body.surface!r} is large, and rounding would leave less "
                    f"than four digits of its position (limit {ENDLESS:g}); lower its velocity, "
                    "sigma or the duration"
                )
        return True

    # --- bodies that nothing accelerates -------------------------------------------------------

    def _append(self, side: str, track: Track) -> None:
        getattr(self.group, side).append(track)
        if track.stop < self.scene.duration:
            body = getattr(self, side)
            state = track.end()
            if body.ambient:
                if not track.ambient:
                    state = axis_kernel(body.surface).at(state, body.parameters)
                elif not isinstance(track, PanelTrack):  # panels end on the surface
                    state = restoring_axis(body.surface).at(state, body.parameters)
            setattr(self, side, body.at(state, body.ambient))

    def _geodesic(self, side: str, start: float, stop: float, why: str) -> Track:
        body: Body = getattr(self, side)
        w = self.w1 if side == "finger" else self.w2
        piece = plain_piece(self.scene.profile, start, stop)
        if body.surface.great_circles:
            return self._great_circle(side, body, w, piece, why)
        if body.surface.developable:
            return self._flat(body, w, 0 * w, piece, None, why)
        # where sigma touches zero at a window's edge an interval may be rounding long
        length = max(piece.arc_length(stop - start), TINY)
        form = geodesic_form(body.surface, body.ambient) if w.any(1).all() else None
        if form is not None:
            found = form.start.at(np.hstack([body.state, w]), body.parameters)
            kernel, rates, n = form.motion, form.n_rates, form.motion.n_result
            first, numbers = found[:, :n], [found[:, n:-rates]]
            scale = np.hstack([body.scale[:, : n - rates], found[:, -rates:]])
        else:
            kernel = axis_motion(body.surface, body.ambient)
            first, scale = body.state, body.scale
            numbers = [w, np.zeros_like(w), np.zeros_like(w)]
        first, constants = contiguous(first), np.hstack([body.parameters, *numbers])
        key = "geodesic", side, start, stop, form is None, body.ambient, self.compiled
        known: MovingTrack | None = self.pattern.memory.get(key)
        if known is not None:
            problem = known.problem.moved(first, constants, scale=scale, name=self.name)
            return known.moved(self.tolerance, problem, w, None)
        problem = Problem(
            name=self.name,
            start=first,
            constants=constants,
            scale=scale,
            drive=GainPiece(0.0, length, (1.0,), (0.0,), 0),
            length=length,
            first=FIRST * body.bend,
            variable="arc length",
        )
        track = (GeodesicTrack if form else MovingTrack)(
            body.surface, body.parameters, piece, why + "; no closed form on this surface",
            body.ambient, self.compiled, kernel, problem, self.tolerance, w, None,
        )  # fmt: skip
        if start in self.pattern.edges:
            self.pattern.memory[key] = track.again(self.tolerance)  # without what this one finds
        return track

    def _great_circle(
        self, side: str, body: Body, w: np.ndarray, piece: GainPiece, why: str
    ) -> Track:
        """A great circle; the scene keeps the one from its start."""
        key = side, piece.start, piece.stop, self.compiled
        if piece.start == self.prepared.begin:
            return self._once(key, lambda: self._new_circle(key, body, w, piece, why))
        return self._new_circle(key, body, w, piece, why)

    def _new_circle(
        self, key: Hashable, body: Body, w: np.ndarray, piece: GainPiece, why: str
    ) -> CircleTrack:
        circle = great_circle(body.surface, body.parameters, body.state, w)
        known: CircleTrack | None = self.pattern.memory.get(key)
        if known is not None:
            return known.moved(circle)
        track = CircleTrack(
            body.surface, body.parameters, piece.start, piece.stop, "closed form: great circle",
            why, True, self.compiled, circle=circle, piece=piece,
        )  # fmt: skip
        if piece.start in self.pattern.edges:
            self.pattern.memory[key] = track
        return track

    def _flat(
        self,
        body: Body,
        w: np.ndarray,
        v: np.ndarray,
        piece: GainPiece,
        offset: np.ndarray | None,
        why: str,
        slip_matters: bool = False,
    ) -> FlatTrack:
        length, method = None, "closed form: straight line on the developed surface"
        if v.any():
            try:
                length = slip_length(piece, slip_matters, self.compiled)
            except ContactSystemError as error:
                raise ContactSystemError(f"{self.name}: {error}") from None
            if slip_matters:
                method = f"quadrature of slip, {length.count} panels"
                why = "T = 0: the developed curve is the curve"
        return FlatTrack(body.surface, body.parameters, piece.start, piece.stop, method, why, False,
                         self.compiled, offset=offset, begin=body.state, w=w, v=v, lame=body.lame,
                         piece=piece, slip_length=length)  # fmt: skip

    def _free(self, interval: Interval) -> None:
        """The object while only slip and rate offsets act."""
        piece, start, stop = interval.piece, interval.start, interval.stop
        if piece.power and piece.sigma[0] == 0.0:
            self.v = 0 * self.v  # the guaranteed law lets no slip leave a rest
        shifted = interval.offset
        v = self.v
        slip = _greatest(v)
        record = SlipRecord(start, stop, piece, slip_of(v, slip, piece), None, self.w1)
        self.group.slips.append(record)
        if self.object.surface.developable:
            if slip == 0:  # the interval may be longer than a piece of the gain
                piece = plain_piece(self.scene.profile, start, stop)
            matters = slip > ROUNDING * self.object.size * interval.reach
            why = "slip negligible" if slip else "no slip"
            flat = self._flat(self.object, self.w2, v, piece, shifted, why, matters)
            self._append("object", flat)
        elif slip == 0 and shifted is None:
            self._append("object", self._geodesic("object", start, stop, "no slip"))
        else:
            negligible = NEGLIGIBLE * self.object.size * interval.reach  # in tolerances
            reached = self._driven(interval, shifted, slip, negligible)
            if reached < stop:
                why = f"slip has fallen below tolerance at t = {reached:.6g} s"
                self._append("object", self._geodesic("object", reached, stop, why))
        if slip > 0 and stop < self.scene.duration:
            self.v = v * piece.decay(stop - start, piece.speed(stop - start))

    def _driven(
        self, interval: Interval, offset: np.ndarray | None, slip: float, negligible: float
    ) -> float:
        """Develop the object while slip lasts; returns the time reached.

        Slip that moves the contact by less than the tolerance is left out of the integration, never
        out of the rates: they begin as the scene says.
        """
        body, span = self._in_form("object", offset is not None), interval.stop - interval.start
        # A great circle is free however long it is; a short rest is cheaper as one more panel.
        stops = body.surface.great_circles and interval.length > LONG_REST * body.size
        finish = min(negligible, RATE_LEFT) if stops else negligible
        key = "driven", interval.start, body.ambient, self.compiled
        known = self.pattern.memory.get(key)
        start, w, v = contiguous(body.state), contiguous(self.w2), contiguous(self.v)
        if known is not None and not stops:
            constants, n = known.problem.constants.copy(), body.parameters.shape[1]
            constants[:, n : n + 2], constants[:, n + 2 : n + 4] = w, v
            problem = known.problem.moved(
                start, constants, slip=slip, scale=body.scale, name=self.name
            )
            track = known.moved(self.tolerance, problem, w, v)
        else:
            aside = np.zeros_like(v) if offset is None else offset
            constants = np.concatenate([body.parameters, w, v, aside], axis=1)
            kernel = axis_motion(body.surface, body.ambient, offset is not None)
            problem = Problem(
                name=self.name,
                start=start,
                constants=constants,
                scale=body.scale,
                drive=interval.piece,
                length=span,
                first=_first_panel(interval.piece, span, body.bend),
                slip=slip,
                finish=finish if offset is None else 0.0,
                stops=stops,
            )
            why = "slip" if offset is None else "object rate offset" + ", slip" * (slip > 0)
            track = MovingTrack(
                body.surface, body.parameters, interval.piece, why, body.ambient, self.compiled,
                kernel, problem, self.tolerance, w, v, offset,
            )  # fmt: skip
            self.pattern.memory[key] = track.again(self.tolerance) if offset is None else None
        if stops and track.panels.edges[-1] < span:
            track.stop = interval.start + track.panels.edges[-1]
        self._append("object", track)
        return track.stop

    # --- accelerations ---------------------------------------------------------------------------

    def _forced(self, interval: Interval) -> None:
        start, stop, piece, pushed = interval.start, interval.stop, interval.piece, interval.pushed
        d1, d2, offset = (interval.forcing[k] for k in DISTURBANCE_KINDS)
        obj = self._in_form("object", interval.turns)
        tip = self._in_form("finger", True) if pushed else self.finger
        n1 = tip.state.shape[1] if pushed else 0
        key = "forced", start, tip.ambient, obj.ambient, self.compiled
        known: _Forced | None = self.pattern.memory.get(key)
        if known is None:
            known = self.pattern.memory[key] = self._forced_problem(interval, tip, obj)
        moving = [tip.state, self.w1, obj.state, self.v] if pushed else [obj.state, self.v]
        scale = known.scale(tip, obj, pushed, self.v)
        given = np.concatenate([self._once("turn", self._turn), self.w1], axis=1)
        panels, motion = known.integrate(
            self.name, np.concatenate(moving, axis=1), given, scale, self.tolerance
        )
        method = f"forced development, {len(panels.edges) - 1} panels"
        last = panels.end.shape[1]
        rows_w1 = slice(n1, n1 + 2) if pushed else None
        rows_v = slice(last - 2, last)
        if rows_w1 is not None:
            self._append("finger", PanelTrack(
                tip.surface, tip.parameters, start, stop, method, "finger acceleration",
                tip.ambient, self.compiled, panels=panels, rows=slice(0, n1), piece=piece,
                w=self.w1, v=None, forced=Forced(rows_w1, None, known.grown, None, motion),
            ))  # fmt: skip
        self._append("object", PanelTrack(
            obj.surface, obj.parameters, start, stop, method, known.why, obj.ambient, self.compiled,
            offset=interval.offset, panels=panels,
            rows=slice(n1 + 2 if pushed else 0, last - 2), piece=piece, w=self.w2, v=None,
            forced=Forced(rows_w1, rows_v, known.grown, self.r0, motion),
        ))  # fmt: skip
        of = functools.partial(_panel_states, panels, rows_v)
        grown = self.w1 if rows_w1 is None else functools.partial(_panel_states, panels, rows_w1)
        self.group.slips.append(SlipRecord(start, stop, piece, of, (d1, d2), grown))
        if rows_w1 is not None:
            self.w1 = panels.end[:, rows_w1].copy()
            self.w2 = (self.r0 @ self.w1[:, :, None])[:, :, 0]
        self.v = panels.end[:, rows_v].copy()

    def _forced_problem(self, interval: Interval, tip: Body, obj: Body) -> _Forced:
        refuse_rest(self.scene, self.name, interval.start, interval.stop)
        span, pushed, forcing = interval.stop - interval.start, interval.pushed, interval.forcing
        kernel = axis_forced_motion(tip.surface, obj.surface, (tip.ambient, obj.ambient), pushed)
        d = [forcing[kind] for kind in DISTURBANCE_KINDS]
        problem = Problem(
            name=self.name,
            start=obj.state,
            constants=np.hstack([tip.parameters, obj.parameters, 0 * self.w1, 0 * self.w1, *d]),
            scale=obj.scale,
            drive=interval.piece,
            length=span,
            first=_first_panel(interval.piece, span, min(tip.bend, obj.bend)),
            slip=1.0,
            stiff=2,
        )
        at = tip.parameters.shape[1] + obj.parameters.shape[1]
        why = " and ".join(k.kind for k in DISTURBANCE_KINDS if forcing[k].any())
        grown = max(self._slip_grown(interval, tip, obj), 1e-3)
        return _Forced(kernel, problem, slice(at, at + 4), grown, why, self.compiled)

    def _turn(self) -> np.ndarray:
        """cos psi, sin psi."""
        return np.array([(math.cos(x), math.sin(x)) for x in self.prepared.angle.tolist()])

    def _slip_grown(self, interval: Interval, tip: Body, obj: Body) -> float:
        """The slip that this interval can bring about."""
        speeds = self._speeds(interval)
        sides = ((FingerAcceleration, tip), (ObjectAcceleration, obj))
        pushes = [np.abs(interval.forcing[kind]).max() * body.size for kind, body in sides]
        return float(
            max(pushes)
            / max(min(speeds), TINY)
            * min(interval.stop - interval.start, self._slowest(interval))
        )

    def _speeds(self, interval: Interval) -> list[float]:
        profile = self.scene.profile
        return [float(profile(t)) for t in profile.knots(interval.start, interval.stop)]

    def _slowest(self, interval: Interval) -> float:
        """1 / (least lam): how long slip is remembered."""
        gains = [interval.piece.gain(t) for t in (0.0, interval.stop - interval.start)]
        return 1.0 / max(min(gains), 1e-9)

    # --- imposed rolling -------------------------------------------------------------------------

    def _rolling_imposed(self) -> None:
        start, stop = self.prepared.begin, self.scene.duration
        piece = plain_piece(self.scene.profile, start, stop)
        track = self._geodesic("object", start, stop, "planned curve of the object")
        self.group.object.append(track)
        self.group.slips.append(SlipRecord(start, stop, piece, None, None, self.w1))
        dragged = self._dragged(piece)
        if dragged is None:
            reason = "a geodesic like the object's: chart equations do not reach all of it"
            dragged = self._geodesic("finger", start, stop, reason)
        self.group.finger.append(dragged)

    def _dragged(self, piece: GainPiece) -> Track | None:
        """Fingers by the chart equations; None at poles and where there is no chart."""
        if not (self.finger.surface.has_chart and self.object.surface.has_chart):
            return None
        tip, obj = (
            body.at(at, False) for body, at in zip((self.finger, self.object), self.group.begin)
        )
        kernel = rolling_motion(tip.surface, obj.surface)
        angle, length = self.prepared.angle, piece.stop - piece.start
        problem = Problem(
            name=self.name,
            start=np.hstack([tip.state[:, :2], angle[:, None], obj.state]),
            constants=np.hstack([tip.parameters, obj.parameters, self.w2]),
            scale=np.hstack([tip.scale, obj.scale]),
            drive=piece,
            length=length,
            first=_first_panel(piece, length, min(tip.bend, obj.bend)),
        )
        try:
            # beside a pole these equations magnify what a coarse tolerance leaves
            panels = integrate(kernel, problem, min(self.tolerance, 1e-12), self.compiled)
        except ContactSystemError:
            return None
        method = f"rolling imposed, chart equations, {len(panels.edges) - 1} panels"
        track = RollingTrack(
            tip.surface, tip.parameters, piece.start, piece.stop, method,
            "the finger follows the object", False, self.compiled, panels=panels, rows=slice(None),
            piece=piece, w=self.w1, v=None, angle=angle,
        )  # fmt: skip
        return None if track.crossed() else track

    # --- forms -----------------------------------------------------------------------------------

    def _in_form(self, side: str, uses_chart_components: bool) -> Body:
        """The body in the form this interval needs."""
        body: Body = getattr(self, side)
        if body.ambient == in_space(body.surface, uses_chart_components):
            return body
        now = self.group.coordinates_at(side, len(getattr(self.group, side)))
        return body.at(now, False)


@dataclass(eq=False)
class RollingTrack(PanelTrack):
    """Fingers dragged along by imposed rolling: panels of (u1, v1, psi, u2, v2, theta2)."""

    angle: np.ndarray = field(kw_only=True)

    def _entry(self, output: str) -> tuple[Evaluator, int] | None:
        return super()._entry(output) if output == "points" else None

    def state(self, t: np.ndarray) -> np.ndarray:
        values = super().state(t)
        out = values[:, :3].copy()
        out[:, 2] = (
            self.angle[:, None] - values[:, 5] - values[:, 2]
        )  # theta1 = psi0 - theta2 - psi
        return out

    def end(self) -> np.ndarray:
        return Track.end(self)  # not the panels' rows


# --- singular points of charts -------------------------------------------------------------------


def charted(groups: Sequence[Group]) -> Iterator[tuple[Group, PanelTrack]]:
    """The tracks that are moved in charts of which nobody knows whether they are regular."""
    for group in groups:
        for track in (*group.finger, *group.object):
            if isinstance(track, PanelTrack) and not track.surface.has_implicit:
                yield group, track


def require_regular(scene: Scene, groups: Sequence[Group]) -> None:
    """Raise a ContactSystemError where a path goes through a singular point of its chart."""
    for group, track in charted(groups):
        place = track.crossed()
        if place is not None:
            raise passed(group_name(scene, group.contacts), track.surface, place)


# --- small parts ---------------------------------------------------------------------------------


def group_name(scene: Scene, contacts: np.ndarray) -> str:
    """Contacts of a scene, for messages."""
    return f"{scene.title}, contact {', '.join(map(str, contacts.tolist()))}"


def _standing(
    body: Body, surfaces: Sequence[Surface], starts: Starts, side: str
) -> tuple[Body, np.ndarray]:
    """Bodies where they start, and u, v, theta there.

    Frames lie along the contact frames, or where they have come to.
    """
    first, parameters = body.surface, body.parameters
    places = [getattr(s, f"{side}_at") for s in starts]
    begin = np.array([(*at, 0.0)[:3] for at in places], dtype=float)  # theta is 0 at a start
    if not prefers_ambient(first):
        return body.at(begin, False), begin
    if first.has_chart and not isinstance(starts[0], Moment):
        return body.at(axis_kernel(first).at(begin, parameters), True), begin
    if isinstance(starts[0], Moment):
        state = np.array([getattr(s, f"{side}_frame")[:AXIS] for s in starts])
    else:  # the point is found numerically
        x = np.array([s.point(*q) for s, q in zip(surfaces, places)])
        frames = np.array([s.frame(*q) for s, q in zip(surfaces, places)])
        state = np.hstack([x, frames[:, :, 0]])
    return body.at(restoring_axis(first).at(state, parameters), True), begin


def _greatest(v: np.ndarray) -> float:
    """Greatest length of the rows of (n, 2)."""
    if len(v) < 8:
        return max(map(math.hypot, *v.T.tolist()))
    return float(np.hypot(v[:, 0], v[:, 1]).max())


@functools.lru_cache(maxsize=1024)
def plain_piece(profile: Profile, start: float, stop: float) -> GainPiece:
    """The profile in local time, without gain."""
    return GainPiece(start, stop, profile.shifted(start), (0.0,), 0)


def _slip_reach(scene: Scene, piece: GainPiece, length: float) -> float:
    """Least lam/sigma of a piece, or 1/length: slip V still moves the contact by |V| over this."""
    speeds = [float(scene.profile(t)) for t in scene.profile.knots(piece.start, piece.stop)]
    value = scene.gain.value
    per_metre = value * min(speeds) if scene.gain.law == "path" else value / max(*speeds, TINY)
    return max(per_metre, 1.0 / max(length, TINY))


def slip_of(
    v: np.ndarray, slip: float, piece: GainPiece
) -> Callable[[np.ndarray], np.ndarray] | None:
    """V at local times from V at the start, whose greatest length is ``slip``."""
    return functools.partial(_decaying, v, piece) if slip > 0 else None


def _decaying(v: np.ndarray, piece: GainPiece, tau: np.ndarray) -> np.ndarray:
    with np.errstate(under="ignore"):
        return v[:, :, None] * piece.decay(tau, piece.speed(tau))


def _first_panel(piece: GainPiece, span: float, bend: float) -> float:
    """About the time in which a path that may slip grows as long as a first panel may be, s."""
    reach = 0.4 * FIRST * bend
    first = span * min(1.0, reach / max(piece.arc_length(span), TINY))
    for _ in range(20):  # sigma may grow a lot
        if first == span:
            return 4.0 * span  # at any tolerance
        longer = min(1.5 * first, span)
        if piece.arc_length(longer) > reach:
            break
        first = longer
    return first


def _panel_states(panels: Panels, rows: slice, tau: np.ndarray) -> np.ndarray:
    return panels.evaluate(np.clip(tau, 0.0, panels.edges[-1]), rows)
