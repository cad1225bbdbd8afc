"""From a scene to a plan: per contact and interval, the cheapest exact way to move it.

Contacts of one kind (same surfaces, same windows) move together. For each group the horizon is cut
at the edges of its own windows; on each interval

* a finger that nothing accelerates runs on a geodesic, in closed form on plane, cylinder and
  sphere, else integrated once in arc length;
* the object runs on a geodesic too while there is no slip to speak of, on the developed curve
  W s - V g while there is;
* only contacts under an acceleration are integrated together with their forcing.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from . import development
from .closed_form import CircleTrack, FlatTrack
from .development import PanelTrack, Problem
from .errors import SceneError
from .kinematics import contact_map
from .profile import GainPiece
from .scene import (
    Contact,
    Disturbance,
    FingerAcceleration,
    ObjectAcceleration,
    ObjectRateOffset,
    Scene,
)
from .surfaces import Surface
from .tracks import Track, frame_kernel, lame_function, prefers_ambient, restoring_function

# Slip whose whole remaining displacement is below this fraction of tolerance * size is let go.
NEGLIGIBLE = 0.01


@dataclass(frozen=True)
class Start:
    """Where one contact starts, in its contact frames at the start time.

    Attributes
    ----------
    finger_at, object_at : (u, v)
    angle : psi
    finger_velocity : M1 dq1/ds in E1
    object_velocity : M2 dq2/ds in E2, without object rate offsets
    """

    finger_at: tuple[float, float]
    object_at: tuple[float, float]
    angle: float
    finger_velocity: tuple[float, float]
    object_velocity: tuple[float, float]


def scene_start(contact: Contact) -> Start:
    """The start that a scene's contact describes; words become numbers here."""
    turn = contact_map(contact.angle)
    given = contact.object_velocity
    if contact.follows:
        finger = tuple(turn @ np.array(given))
    else:
        finger = contact.finger_velocity
    rolled = turn @ np.array(finger)
    if isinstance(given, str):
        given = tuple(rolled) if given == "rolling" else (0.0, 0.0)
    return Start(contact.finger_at, contact.object_at, contact.angle, finger, given)


@dataclass(eq=False)
class SlipRecord:
    """V(t) on [start, stop] in the object's parallel frame; slip is sigma V less the offset's part.

    ``of`` maps local times to V (n, 2, n_times), or is None where there is no slip.
    """

    start: float
    stop: float
    piece: GainPiece
    of: Callable[[np.ndarray], np.ndarray] | None
    forcing: tuple[np.ndarray, np.ndarray]


@dataclass(eq=False)
class Group:
    """Contacts that move together, and their motion.

    Attributes
    ----------
    contacts : (n,) int
    r0 : (n, 2, 2)
        Map between the parallel frames, constant.
    angle : (n,)
        psi where both frame angles are zero.
    finger, object : list of Track
    slips : list of SlipRecord
    """

    contacts: np.ndarray
    r0: np.ndarray
    angle: np.ndarray
    begin: tuple[np.ndarray, np.ndarray]
    finger: list[Track] = field(default_factory=list)
    object: list[Track] = field(default_factory=list)
    slips: list[SlipRecord] = field(default_factory=list)

    def coordinates_at_end(self, side: str, count: int) -> np.ndarray:
        """Continuous (u, v, theta) at the end of the first ``count`` tracks: (n, 3)."""
        tracks = getattr(self, side)
        reference = self.begin[side == "object"]
        for track in tracks[:count]:
            if not track.ambient:
                reference = track.state(np.array([track.stop]))[:, :, 0]
            elif track.anchors is None:
                reference = track.anchor(reference)
            else:
                reference = track.anchors[1][:, :, -1]
        return reference


@dataclass(eq=False)
class Body:
    """The bodies of one side of a group while they are being planned."""

    surface: Surface
    parameters: np.ndarray
    state: np.ndarray
    ambient: bool

    @property
    def size(self) -> float:
        return self.surface.size

    @property
    def lame(self) -> np.ndarray:
        """h_u, h_v of each body where it stands, chart form: (n, 2)."""
        return np.array([lame_function(self.surface)(p, s).full().ravel()
                         for p, s in zip(self.parameters, self.state)])  # fmt: skip


def plan_groups(
    scene: Scene,
    starts: Sequence[Start],
    begin: float,
    tolerance: float,
    compiled: bool | None,
) -> list[Group]:
    """Plan all contacts of a scene from time ``begin`` to its end."""
    members: dict[tuple, list[int]] = {}
    for i, contact in enumerate(scene.contacts):
        members.setdefault(_kind(scene, i, contact, starts[i], begin), []).append(i)
    return [
        GroupPlanner(scene, np.array(indices), starts, begin, tolerance, compiled).run()
        for indices in members.values()
    ]


def _kind(scene: Scene, i: int, contact: Contact, start: Start, begin: float) -> tuple:
    windows = tuple(
        (type(d), d.start, d.stop) for d in scene.disturbances if d.contact == i and d.stop > begin
    )
    rolled = contact_map(start.angle) @ np.array(start.finger_velocity)
    slips = bool(np.any(rolled != np.array(start.object_velocity)))
    return contact.finger.structure, contact.follows, windows, slips


class GroupPlanner:
    """Builds the tracks of one group, interval by interval."""

    def __init__(
        self,
        scene: Scene,
        contacts: np.ndarray,
        starts: Sequence[Start],
        begin: float,
        tolerance: float,
        compiled: bool | None,
    ):
        self.scene, self.contacts, self.begin = scene, contacts, begin
        self.tolerance, self.compiled = tolerance, compiled
        own = [starts[i] for i in contacts]
        fingers = [scene.contacts[i].finger for i in contacts]
        self.angle = np.array([s.angle for s in own])
        r0 = contact_map(self.angle)
        self.w1 = np.array([s.finger_velocity for s in own], dtype=float)
        self.r0 = r0
        self.v = self._along(self.w1) - np.array([s.object_velocity for s in own], dtype=float)
        # R_psi W1 of a rolling start is rounded twice; what is left is no slip.
        self.v[np.abs(self.v) <= 4e-16 * np.abs(self.w1).max(1, initial=1e-300, keepdims=True)] = 0.0
        self.finger, finger_at = _body(fingers, [s.finger_at for s in own], False)
        self.object, object_at = _body([scene.object] * len(own), [s.object_at for s in own], False)
        self.follows = scene.contacts[contacts[0]].follows
        self.group = Group(contacts, r0, self.angle, (finger_at, object_at))
        self.disturbances = [
            d for d in scene.disturbances if d.contact in set(contacts) and d.stop > begin
        ]

    def _along(self, w1: np.ndarray) -> np.ndarray:
        return (self.r0 @ w1[:, :, None])[:, :, 0]

    # --- the horizon ---------------------------------------------------------------------------

    def run(self) -> Group:
        """Plan every interval in turn."""
        if self.follows:
            self._rolling_imposed()
            return self.group
        edges = self._edges()
        finger_until = self.begin
        for start, stop in zip(edges, edges[1:]):
            forcing = self._forcing(start, stop)
            pushed = bool(forcing[FingerAcceleration].any())
            if not pushed and finger_until <= start:
                finger_until = self._finger_free_until(edges, start)
                self._finger_geodesic(start, finger_until)
            if pushed:
                finger_until = stop
            if pushed or forcing[ObjectAcceleration].any():
                self._forced(start, stop, forcing, pushed)
            else:
                self._free(start, stop, forcing[ObjectRateOffset])
        return self.group

    def _edges(self) -> list[float]:
        edges = {self.begin, self.scene.duration}
        edges |= {t for d in self.disturbances for t in (d.start, d.stop) if t > self.begin}
        if self.v.any() or self.disturbances:
            pieces = self.scene.gain.pieces(self.scene.profile, self.begin, self.scene.duration)
            edges |= {p.start for p in pieces}
        return sorted(edges)

    def _forcing(self, start: float, stop: float) -> dict[type[Disturbance], np.ndarray]:
        """Sums of the chart components that act on [start, stop], by kind: (n, 2) each."""
        position = {i: k for k, i in enumerate(self.contacts.tolist())}
        total = {
            kind: np.zeros((len(self.contacts), 2))
            for kind in (FingerAcceleration, ObjectAcceleration, ObjectRateOffset)
        }
        for d in self.disturbances:
            if d.start <= start and stop <= d.stop:
                total[type(d)][position[d.contact]] += d.value
        return total

    def _finger_free_until(self, edges: list[float], start: float) -> float:
        for a, b in zip(edges, edges[1:]):
            if a >= start and self._forcing(a, b)[FingerAcceleration].any():
                return a
        return edges[-1]

    def _piece(self, start: float, stop: float) -> GainPiece:
        return self.scene.gain.pieces(self.scene.profile, start, stop)[0]

    # --- fingers -------------------------------------------------------------------------------

    def _finger_geodesic(self, start: float, stop: float) -> None:
        track = self._geodesic(self.finger, self.w1, start, stop, "nothing accelerates the finger")
        self._append("finger", track)

    def _append(self, side: str, track: Track) -> None:
        getattr(self.group, side).append(track)
        if track.stop < self.scene.duration:
            body = self.finger if side == "finger" else self.object
            body.state = _restored(body, track.state(np.array([track.stop]))[:, :, 0])

    def _geodesic(self, body: Body, w: np.ndarray, start: float, stop: float, why: str) -> Track:
        piece = GainPiece(start, stop, self.scene.profile.shifted(start), (0.0,), 0)
        place = (body.surface, body.parameters, start, stop)
        if body.surface.great_circles:
            return CircleTrack(*place, "closed form: great circle", why, True, self.compiled,
                               begin=body.state, w=w, piece=piece)  # fmt: skip
        if body.surface.developable:
            return self._flat(body, w, np.zeros_like(w), start, stop, None, why)
        length = piece.arc_length(stop - start)
        one = GainPiece(0.0, length, (1.0,), (0.0,), 0)
        kernel = development.driven_motion(body.surface, body.ambient)
        none = np.zeros_like(w)
        problem = Problem(
            start=body.state,
            constants=np.hstack([body.parameters, w, none, none]),
            scale=_scale(body),
            drive=one,
            length=length,
            tolerance=self.tolerance,
            first=min(length, 0.3 * body.size),
        )
        panels = development.integrate(kernel, problem, self.compiled)
        method = f"geodesic in arc length, {len(panels.edges) - 1} panels"
        return PanelTrack(*place, method, why + "; no closed form on this surface", body.ambient,
                          self.compiled, panels=panels, rows=slice(None), piece=piece,
                          drive_of=functools.partial(_constant_drive, w, piece),
                          by_length=True)  # fmt: skip

    def _flat(
        self,
        body: Body,
        w: np.ndarray,
        v: np.ndarray,
        start: float,
        stop: float,
        offset: np.ndarray | None,
        why: str,
    ) -> FlatTrack:
        piece = self._piece(start, stop) if v.any() else GainPiece(
            start, stop, self.scene.profile.shifted(start), (0.0,), 0
        )  # fmt: skip
        slip_length, method = None, "closed form: straight line unrolled"
        if v.any():
            slip_length = self._slip_length(piece, stop - start)
            method = f"quadrature of slip, {len(slip_length.edges) - 1} panels"
            why = "T = 0: the developed curve is the curve"
        lame = body.lame
        return FlatTrack(body.surface, body.parameters, start, stop, method, why, False,
                         self.compiled, offset=offset, begin=body.state, w=w, v=v, lame=lame,
                         piece=piece, slip_length=slip_length)  # fmt: skip

    def _slip_length(self, piece: GainPiece, span: float) -> development.Panels:
        problem = Problem(
            start=np.zeros((1, 1)),
            constants=np.zeros((1, 1)),
            scale=np.full((1, 1), 1.0 / piece.arc_length(span)),
            drive=piece,
            length=span,
            tolerance=self.tolerance,
            first=span,
            slip=1.0,
        )
        return development.integrate(development.slip_displacement(), problem, self.compiled)

    # --- the object, free of accelerations -------------------------------------------------------

    def _free(self, start: float, stop: float, offset: np.ndarray) -> None:
        piece = self._piece(start, stop)
        span = stop - start
        shifted = offset if offset.any() else None
        negligible = NEGLIGIBLE * self.tolerance * self.object.size * _slip_reach(self.scene, piece)
        slip = float(np.hypot(self.v[:, 0], self.v[:, 1]).max())
        v = self.v
        of = functools.partial(_decaying, v, piece) if slip > 0 else None
        self.group.slips.append(SlipRecord(start, stop, piece, of, (0 * v, 0 * v)))
        w = self._along(self.w1)
        if self.object.surface.developable:
            moving = v if slip > negligible else 0 * v
            why = "no slip to speak of" if slip <= negligible else ""
            self._append("object", self._flat(self.object, w, moving, start, stop, shifted, why))
        elif slip <= negligible and shifted is None:
            why = "no slip" if slip == 0 else f"slip is below tolerance ({slip:.1e} per path speed)"
            self._append("object", self._geodesic(self.object, w, start, stop, why))
        else:
            reached = self._driven(start, stop, piece, shifted, slip, negligible)
            if reached < stop:
                why = f"slip has fallen below tolerance at t = {reached:.6g} s"
                self._append("object", self._geodesic(self.object, w, reached, stop, why))
        decay = piece.decay(span, piece.speed(span))
        self.v = self.v * decay

    def _driven(
        self,
        start: float,
        stop: float,
        piece: GainPiece,
        offset: np.ndarray | None,
        slip: float,
        negligible: float,
    ) -> float:
        """Integrate the development while slip lasts; returns the time reached."""
        body, w = self._in_form(self.object, "object", offset is not None), self._along(self.w1)
        none = np.zeros_like(w)
        kernel = development.driven_motion(body.surface, body.ambient, offset=offset is not None)
        length = piece.arc_length(stop - start)
        problem = Problem(
            start=body.state,
            constants=np.hstack([body.parameters, w, self.v, none if offset is None else offset]),
            scale=_scale(body),
            drive=piece,
            length=stop - start,
            tolerance=self.tolerance,
            first=(stop - start) * min(1.0, 0.3 * body.size / length),
            slip=slip,
            finish=negligible if offset is None else 0.0,
        )
        panels = development.integrate(kernel, problem, self.compiled)
        reached = stop if panels.edges[-1] >= stop - start else start + panels.edges[-1]
        why = "slip" if offset is None else "object rate offset" + (", slip" if slip > 0 else "")
        track = PanelTrack(
            body.surface, body.parameters, start, reached,
            f"development in {'space' if body.ambient else 'its chart'}, {len(panels.edges) - 1} panels",
            why, body.ambient, self.compiled, offset=offset, panels=panels, rows=slice(None),
            piece=piece, drive_of=functools.partial(_decaying_drive, w, self.v, piece),
        )  # fmt: skip
        self._append("object", track)
        self._back_to_form(self.object, body, "object")
        return reached

    # --- accelerations ---------------------------------------------------------------------------

    def _forced(
        self,
        start: float,
        stop: float,
        forcing: dict[type[Disturbance], np.ndarray],
        pushed: bool,
    ) -> None:
        piece = self._piece(start, stop)
        self._refuse_rest(start, stop)
        d1, d2 = forcing[FingerAcceleration], forcing[ObjectAcceleration]
        offset = forcing[ObjectRateOffset]
        on_chart = bool(d2.any() or offset.any())
        obj = self._in_form(self.object, "object", on_chart)
        tip = self._in_form(self.finger, "finger", True) if pushed else self.finger
        kernel = development.forced_motion(
            tip.surface, obj.surface, (tip.ambient, obj.ambient), pushed
        )
        turn = np.stack([np.cos(self.angle), np.sin(self.angle)], axis=1)
        constants = [tip.parameters, obj.parameters, turn, self.w1, d1, d2, offset]
        n1 = tip.state.shape[1] if pushed else 0
        first = [tip.state, self.w1] if pushed else []
        scales = [_scale(tip), np.ones_like(self.w1)] if pushed else []
        length = piece.arc_length(stop - start)
        least = min(tip.size, obj.size)
        problem = Problem(
            start=np.hstack([*first, obj.state, self.v]),
            constants=np.hstack(constants),
            scale=np.hstack([*scales, _scale(obj), np.ones_like(self.v)]),
            drive=piece,
            length=stop - start,
            tolerance=self.tolerance,
            first=(stop - start) * min(1.0, 0.3 * least / length),
            slip=1.0,
            stiff=2,
        )
        panels = development.integrate(kernel, problem, self.compiled)
        count = len(panels.edges) - 1
        rows_w1, rows_v = slice(n1, n1 + 2), slice(panels.end.shape[1] - 2, None)
        rows_obj = slice(n1 + 2 if pushed else 0, panels.end.shape[1] - 2)
        drive_1 = (
            functools.partial(_panel_drive, panels, rows_w1, piece)
            if pushed
            else functools.partial(_constant_drive, self.w1, piece)
        )
        drive_2 = functools.partial(
            _object_drive, panels, rows_w1 if pushed else None, rows_v, self.r0, self.w1, piece
        )
        if pushed:
            self._append("finger", PanelTrack(
                tip.surface, tip.parameters, start, stop, f"forced development, {count} panels",
                "finger acceleration", tip.ambient, self.compiled, panels=panels,
                rows=slice(0, n1), piece=piece, drive_of=drive_1,
            ))  # fmt: skip
            self.w1 = panels.end[:, rows_w1]
            self._back_to_form(self.finger, tip, "finger")
        why = " and ".join(
            name
            for name, d in (("finger acceleration", d1), ("object acceleration", d2),
                            ("object rate offset", offset))
            if d.any()
        )  # fmt: skip
        self._append("object", PanelTrack(
            obj.surface, obj.parameters, start, stop, f"forced development, {count} panels", why,
            obj.ambient, self.compiled, offset=offset if offset.any() else None, panels=panels,
            rows=rows_obj, piece=piece, drive_of=drive_2,
        ))  # fmt: skip
        self._back_to_form(self.object, obj, "object")
        record = functools.partial(_panel_states, panels, rows_v)
        self.group.slips.append(SlipRecord(start, stop, piece, record, (d1, d2)))
        self.v = panels.end[:, rows_v]

    def _refuse_rest(self, start: float, stop: float) -> None:
        """sigma = 0 under an acceleration: path velocities would have to be infinite."""
        profile = self.scene.profile
        inside = [t for t in profile.zeros(self.scene.duration) if start <= t <= stop]
        if inside:
            names = ", ".join(str(i) for i in self.contacts)
            raise SceneError(
                f"scene '{self.scene.name}', contact {names}: sigma = 0 at t = {inside[0]:g} s "
                f"inside the window [{start:g}, {stop:g}] s of an acceleration, where the path "
                "velocity dq/ds would be infinite; add a small constant to the profile or move "
                "the window"
            )

    # --- imposed rolling -------------------------------------------------------------------------

    def _rolling_imposed(self) -> None:
        start, stop, piece = self.begin, self.scene.duration, None
        w2 = self._along(self.w1)
        track = self._geodesic(self.object, w2, start, stop, "planned curve of the object")
        piece = GainPiece(start, stop, self.scene.profile.shifted(start), (0.0,), 0)
        self.group.object.append(track)
        self.group.slips.append(SlipRecord(start, stop, piece, None, (0 * w2, 0 * w2)))
        tip, obj = (_on_chart(b, at) for b, at in zip((self.finger, self.object), self.group.begin))
        kernel = development.rolling_motion(tip.surface, obj.surface)
        begin = np.hstack([tip.state[:, :2], self.angle[:, None], obj.state])
        length = piece.arc_length(stop - start)
        problem = Problem(
            start=begin,
            constants=np.hstack([tip.parameters, obj.parameters, w2]),
            scale=np.hstack([_scale(tip)[:, :2], np.ones((len(begin), 1)), _scale(obj)]),
            drive=piece,
            length=stop - start,
            tolerance=self.tolerance,
            first=(stop - start) * min(1.0, 0.3 * min(tip.size, obj.size) / length),
        )
        panels = development.integrate(kernel, problem, self.compiled)
        method = f"rolling imposed, chart equations, {len(panels.edges) - 1} panels"
        self.group.finger.append(RollingTrack(
            tip.surface, tip.parameters, start, stop, method, "the finger follows the object",
            False, self.compiled, panels=panels, rows=slice(None), piece=piece,
            drive_of=functools.partial(_constant_drive, self.w1, piece), angle=self.angle,
        ))  # fmt: skip

    # --- forms -----------------------------------------------------------------------------------

    def _in_form(self, body: Body, side: str, uses_chart_components: bool) -> Body:
        """The body in the form this interval needs.

        A disturbance is given in chart components. Where the chart is a double cover (triaxial
        ellipsoid) their sign belongs to the branch the path is on, which only the chart form knows.
        """
        if not (uses_chart_components and body.ambient and body.surface.double_cover):
            return body
        now = self.group.coordinates_at_end(side, len(getattr(self.group, side)))
        return Body(body.surface, body.parameters, now, False)

    def _back_to_form(self, body: Body, used: Body, side: str) -> None:
        if body.ambient and not used.ambient:
            track = getattr(self.group, side)[-1]
            end = track.state(np.array([track.stop]))
            frames = track.run(frame_kernel(body.surface), end, body.parameters)[:, :, 0]
            body.state = _restored(body, frames)


@dataclass(eq=False)
class RollingTrack(PanelTrack):
    """Fingers dragged along by imposed rolling: panels of (u1, v1, psi, u2, v2, theta2)."""

    angle: np.ndarray = field(kw_only=True)

    def state(self, t: np.ndarray) -> np.ndarray:
        values = super().state(t)
        out = values[:, :3].copy()
        out[:, 2] = self.angle[:, None] - values[:, 5] - values[:, 2]  # theta1 = psi0 - theta2 - psi
        return out


# --- small parts ---------------------------------------------------------------------------------


def _body(
    surfaces: Sequence[Surface], at: Sequence[tuple[float, float]], chart: bool
) -> tuple[Body, np.ndarray]:
    """Bodies of one structure at their chart coordinates, frames along their contact frames."""
    first = surfaces[0]
    parameters = np.array([s.parameters for s in surfaces], dtype=float)
    uv = np.array(at, dtype=float)
    begin = np.hstack([uv, np.zeros((len(uv), 1))])
    body = Body(first, parameters, begin, False)
    if prefers_ambient(first) and not chart:
        x = np.array([s.point(*q) for s, q in zip(surfaces, uv)])
        frames = np.array([s.frame(*q) for s, q in zip(surfaces, uv)])
        body = Body(first, parameters, np.hstack([x, frames[:, :, 0], frames[:, :, 1]]), True)
        body.state = _restored(body, body.state)
    return body, begin


def _on_chart(body: Body, at: np.ndarray) -> Body:
    return Body(body.surface, body.parameters, at, False)


def _restored(body: Body, state: np.ndarray) -> np.ndarray:
    if not body.ambient:
        return state
    restore = restoring_function(body.surface)
    return np.ascontiguousarray(np.array(restore(state.T, body.parameters.T)).T)


def _scale(body: Body) -> np.ndarray:
    """1 / (size of the states): positions by the body's size, angles and directions by 1."""
    n = len(body.parameters)
    if body.ambient:
        return np.hstack([np.full((n, 3), 1.0 / body.size), np.ones((n, 6))])
    return np.hstack([np.maximum(body.lame / body.size, 1e-2), np.ones((n, 1))])


def _slip_reach(scene: Scene, piece: GainPiece) -> float:
    """Least lam/sigma of a piece, or 1/length: slip V still moves the contact by |V| over this."""
    span = piece.stop - piece.start
    knots = (piece.start, *scene.profile.extrema(piece.start, piece.stop), piece.stop)
    speeds = [float(scene.profile(t)) for t in knots]
    value = scene.gain.value
    if scene.gain.law == "path":
        per_metre = value * min(speeds)
    else:
        per_metre = value / max(speeds)
    return max(per_metre, 1.0 / piece.arc_length(span))


def _constant_drive(w: np.ndarray, piece: GainPiece, tau: np.ndarray) -> np.ndarray:
    return w[:, :, None] * piece.speed(tau)


def _decaying(v: np.ndarray, piece: GainPiece, tau: np.ndarray) -> np.ndarray:
    return v[:, :, None] * piece.decay(tau, piece.speed(tau))


def _decaying_drive(w: np.ndarray, v: np.ndarray, piece: GainPiece, tau: np.ndarray) -> np.ndarray:
    sigma = piece.speed(tau)
    return w[:, :, None] * sigma - v[:, :, None] * (sigma * piece.decay(tau, sigma))


def _panel_states(panels: development.Panels, rows: slice, tau: np.ndarray) -> np.ndarray:
    return panels.evaluate(np.clip(tau, 0.0, panels.edges[-1]), rows)


def _panel_drive(
    panels: development.Panels, rows: slice, piece: GainPiece, tau: np.ndarray
) -> np.ndarray:
    return _panel_states(panels, rows, tau) * piece.speed(tau)


def _object_drive(
    panels: development.Panels,
    rows_w1: slice | None,
    rows_v: slice,
    r0: np.ndarray,
    w1: np.ndarray,
    piece: GainPiece,
    tau: np.ndarray,
) -> np.ndarray:
    own = w1[:, :, None] if rows_w1 is None else _panel_states(panels, rows_w1, tau)
    return (r0 @ own - _panel_states(panels, rows_v, tau)) * piece.speed(tau)
