"""Tracks of bodies that are integrated in panels."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from .kernels import Kernel, address, contiguous
from .panels import Motion, Panels, Problem, integrate, usable
from .profile import GainPiece
from .surfaces import Surface, second_cover
from .tracks import (
    LOCK,
    Evaluator,
    Track,
    TrackData,
    altered,
    coordinate_kernel,
    drive_data,
    evaluator,
    kept,
    once,
    whole_frame,
    wind,
)


@dataclass(eq=False)
class Forced:
    """Rows of the panels of a contact under accelerations.

    Attributes
    ----------
    w1, v : slice or None
        Of W_1 and V; None where they are constant, or are no part of the body's drive.
    grown : float
        Slip that they can bring about.
    turn : (n_bodies, 2, 2) or None
        The map from W_1 to the body's W; None for the finger's own.
    motion : Motion or None
        That of the contact, where C integrates.
    """

    w1: slice | None
    v: slice | None
    grown: float
    turn: np.ndarray | None
    motion: Motion | None

    def drive(self, track: PanelTrack, tau: np.ndarray) -> np.ndarray:
        """W - V at local times, (n_bodies, 2, n)."""
        at = np.clip(tau, 0.0, track.panels.edges[-1])
        drive = track.w[:, :, None]
        if self.w1 is not None:
            drive = track.panels.evaluate(at, self.w1)
            drive = drive if self.turn is None else self.turn @ drive
        return drive - track.panels.evaluate(at, self.v) if self.v is not None else drive


@dataclass(eq=False)
class PanelTrack(Track):
    """Bodies whose states are panels in local time, or in arc length for geodesics.

    In space the panels hold (x, p) alone.

    Attributes
    ----------
    panels : Panels
    rows : slice
        The rows of the panels that hold these bodies' states.
    piece : GainPiece
        sigma and decay in local time.
    w, v : (n_bodies, 2)
        Drive sigma (w - v decay), unless ``forced`` says otherwise.
    by_length : bool
        The panels' variable is the arc length since start.
    forced : Forced or None
        Where W_1 and V are, if accelerations change them.
    """

    panels: Panels
    rows: slice
    piece: GainPiece
    w: np.ndarray
    v: np.ndarray | None
    by_length: bool = False
    forced: Forced | None = None

    def __post_init__(self) -> None:
        self._anchors: tuple[np.ndarray, np.ndarray] | None = None

    def state(self, t: np.ndarray) -> np.ndarray:
        return self.frames(t) if self.ambient else self._state_at(self._variable(t))

    def _frames(self, t: np.ndarray) -> np.ndarray:
        return self._state_at(self._variable(t)) if self.ambient else super()._frames(t)

    def _variable(self, t: np.ndarray) -> np.ndarray:
        """Where times are on the panels."""
        tau = t - self.start
        return self.piece.arc_length(tau) if self.by_length else tau

    def _state_at(self, at: np.ndarray) -> np.ndarray:
        own = self._own_state(at)
        return self.run(whole_frame(self.surface), own, self.parameters) if self.ambient else own

    def _own_state(self, at: np.ndarray) -> np.ndarray:
        """The rows of the panels; rounding may put a time 1e-16 outside."""
        return self.panels.evaluate(np.clip(at, 0.0, self.panels.edges[-1]), self.rows)

    def drive(self, t: np.ndarray) -> np.ndarray:
        tau = t - self.start
        sigma = self.piece.speed(tau)
        if self.forced is not None:
            return self.forced.drive(self, tau) * sigma
        drive = self.w[:, :, None] * sigma
        if self.v is not None:
            drive -= self.v[:, :, None] * (sigma * self.piece.decay(tau, sigma))
        return drive

    def end(self) -> np.ndarray:
        return self.panels.end[:, self.rows]

    # --- compiled evaluation

    @once
    def _data(self) -> tuple[int, Any, Any]:
        """Address of the C form of this track, that form, and what it points to."""
        data, kept = self._track_data()
        series, edges = self.panels.coefficients, self.panels.edges
        first = (self.rows.start or 0) * series.strides[2]
        at = self.panels.at or (address(edges), address(series))
        data.n_panels, data.edges, data.coefficients = len(edges) - 1, at[0], at[1] + first
        data.panel_stride, data.body_stride = series.strides[0] // 8, series.strides[1] // 8
        return ctypes.addressof(data), data, (kept, series, edges)

    def forced_by(self, motion: Motion, w: np.ndarray, turn: np.ndarray | None) -> PanelTrack:
        """This track for C alone, which integrates another motion under the same accelerations."""
        known = self.forced
        assert known is not None
        forced = Forced(known.w1, known.v, known.grown, turn, motion)
        other = altered(self, ("_entries",), panels=None, w=w, forced=forced)
        data, kept = other._track_data()
        other.__dict__["_data"] = ctypes.addressof(data), data, kept
        return other

    @property
    def motion(self) -> Motion | None:
        """What C integrates; None where it does not."""
        return None if self.forced is None else self.forced.motion

    def _track_data(self) -> tuple[TrackData, Any]:
        """All but the panels, and what it points to."""
        piece, (period_u, period_v) = self.piece, self.surface.periods()
        constants, w, v = map(contiguous, self._numbers())
        data = TrackData(
            start=self.start, stop=self.stop, drive=drive_data(piece), nb=self.n_bodies,
            slips=self.v is not None, by_length=self.by_length,
            double_cover=self.surface.double_cover, period_u=period_u or 0.0,
            period_v=period_v or 0.0, constants=address(constants),
            length=address(piece.arrays[1]), w=address(w), v=address(v),
            n_constants=constants.shape[1], n_drive=2,
        )  # fmt: skip
        turn, offset = None, self.offset
        if offset is not None:
            offset = contiguous(offset)
            data.offset = address(offset)
        if self.forced is not None:
            first, turn = self.rows.start, self.forced.turn
            data.forced = True
            data.w_row = self.forced.w1.start - first if self.forced.w1 else 0
            data.v_row = self.forced.v.start - first if self.forced.v else 0
            data.turn = None if turn is None else address(turn)
        return data, (piece, constants, w, v, turn, offset)

    def _numbers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Constants of the evaluators' kernels, w and v."""
        return self.parameters, self.w, self.w if self.v is None else self.v

    def _entry(self, output: str) -> tuple[Evaluator, int] | None:
        compiled = self.evaluator(output)
        return (compiled, self._data[0]) if compiled.usable(self.compiled) else None

    def data_at(self, output: str) -> int | None:
        return self._data[0]

    def evaluator(self, output: str) -> Evaluator:
        """Of "points", "frames" or "coordinates"."""
        return evaluator(self.surface, self.ambient, output)

    def _coordinates(self, t: np.ndarray) -> np.ndarray:
        values = super()._coordinates(t)
        if self.ambient and self._anchors is not None:
            self._continue(t, values)
        return values

    # --- coordinates continued along the path

    @property
    def anchored(self) -> bool:
        return not self.ambient or self._anchors is not None

    def anchor(self, begin: np.ndarray) -> None:
        with LOCK:
            if not self.anchored:
                self._anchors = self._anchored(contiguous(begin))

    def _anchored(self, begin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places on the panels, and u, v, theta there; C is told of them."""
        entry, n = self.entry("coordinates"), self.n_bodies
        if entry is not None:
            m = 4 * self.panels.count + 1
            at, anchors, work = np.empty(m), np.empty((n, 3, m)), np.empty((n, 5, m))
            entry[0].library.anchor(
                entry[1], address(begin), address(at), address(anchors), address(work)
            )
            return at, anchors
        edges = self.panels.edges
        at = (edges[:-1, None] + (edges[1:] - edges[:-1])[:, None] * _QUARTERS).ravel()
        at = np.append(at, edges[-1])
        raw = self._principal(at)
        u, v, theta = (
            np.vstack([begin[:, k], raw[:, i].T]) for k, i in enumerate((0, 1, 4))
        )  # places first, as unwind wants
        if self.surface.double_cover:
            # the second cover begins where a seam is crossed, which neighbours alone do not tell
            first = self.surface.align(u[1], v[1], u[0], v[0])[2]
            turned = np.logical_xor.accumulate(np.vstack([first, self._seams(at, raw)]), axis=0)
            u[1:], v[1:] = np.where(turned, -u[1:], u[1:]), np.where(turned, np.pi - v[1:], v[1:])
            theta[1:] += np.pi * turned
        for values, period in zip((u, v, theta), (*self.surface.periods(), 2 * np.pi)):
            if period is not None:
                values[:] = np.unwrap(values, axis=0, period=period)
        return at, np.stack([u, v, theta])[:, 1:].transpose(2, 0, 1)

    def _principal(self, at: np.ndarray) -> np.ndarray:
        """u, v, rates, theta at places on the panels, in principal values; the rates are none."""
        points = np.concatenate([self._state_at(at), np.zeros((self.n_bodies, 2, len(at)))], axis=1)
        with np.errstate(all="ignore"):
            return self.run(coordinate_kernel(self.surface, True), points, self.parameters)

    def _seams(self, at: np.ndarray, raw: np.ndarray) -> np.ndarray:
        """Where the paths cross cos v = 0 between places, (n - 1, n_bodies).

        There, or where sin u = 0, the sign of y = sin u cos v changes; between places on one side
        it may do so twice.
        """
        y, side = np.sin(raw[:, 0]) * np.cos(raw[:, 1]), second_cover(raw[:, 0], raw[:, 1])[1]
        seams = np.zeros((len(at) - 1, len(raw)), dtype=bool)
        b, i = np.nonzero(side[:, 1:] != side[:, :-1])
        seams[i, b] = self._over_seam(b, side[b, i], at[i], y[b, i], at[i + 1], y[b, i + 1])
        for b, i in self._bends(at, y, side):
            there = self._comes_back(b, side[b, i], at[i], y[b, i], at[i + 1], y[b, i + 1])
            if there is not None:
                x = np.insert(at[i : i + 2], 1, there[0])
                ys = np.insert(y[b, i : i + 2], 1, there[1])
                sides = np.array([side[b, i], not side[b, i]])
                both = self._over_seam([b, b], sides, x[:-1], ys[:-1], x[1:], ys[1:])
                seams[i, b] = both[0] != both[1]
        return seams

    def _bends(self, at: np.ndarray, y: np.ndarray, side: np.ndarray) -> np.ndarray:
        """Bodies, and places up to the next of which they may leave their side of y = 0: (n, 2)."""
        far = np.fmin(np.abs(y[:, 1:]), np.abs(y[:, :-1])) > 0.25  # for less than half a radian
        near = (side[:, 1:] == side[:, :-1]) & ~far
        if not near.any():
            return np.argwhere(near)
        here, sign = self._principal(0.5 * (at[1:] + at[:-1])), np.where(side[:, 1:], -1.0, 1.0)
        a, c, b = sign * y[:, :-1], sign * y[:, 1:], sign * np.sin(here[:, 0]) * np.cos(here[:, 1])
        with np.errstate(all="ignore"):  # the least value of a parabola, and where that is
            bend, place = a - 2 * b + c, 0.5 * (a - c)
            lowest = np.where(np.abs(place) < np.abs(bend), b - 0.5 * place**2 / bend, np.inf)
        return np.argwhere(near & ((b < 0) | ((bend > 0) & (lowest <= 0.1 * np.fmax(a, c)))))

    def _comes_back(
        self, body: int, side: bool, a: float, ya: float, c: float, yc: float
    ) -> tuple[float, float] | None:
        """A place between a and c at which y has another sign than at both, and y; or None.

        By parabolas towards the least |y|.
        """
        sign, b, yb = (-1.0 if side else 1.0), 0.5 * (a + c), math.inf
        ya, yc, at = sign * ya, sign * yc, b
        for k in range(30):
            if not a < at < c:
                return None
            here = self._principal(np.array([at]))[body, :, 0]
            found = math.sin(here[0]) * math.cos(here[1])
            now = sign * found
            if now < 0.0:
                return at, found
            if k == 0:
                yb = now
            elif now < yb:
                a, ya, c, yc = (a, ya, b, yb) if at < b else (b, yb, c, yc)
                b, yb = at, now
            else:
                a, ya, c, yc = (at, now, c, yc) if at < b else (a, ya, at, now)
            if not a < b < c:
                return None
            first, second = (yb - ya) / (b - a), (yc - yb) / (c - b)
            bend = (second - first) / (c - a)
            if not bend > 0.0:
                return None
            at = 0.5 * (a + b) - 0.5 * first / bend
            if ya + (at - a) * (first + bend * (at - b)) > 0.1 * max(ya, yc):
                return None
        return None

    def _over_seam(self, b: Any, side: Any, x: Any, a: Any, x2: Any, c: Any) -> np.ndarray:
        """Whether bodies b cross cos v = 0, not sin u = 0, between places x and x2, where y = a and
        y = c have different signs; side: a is negative.

        Told at the crossing, by regula falsi (Illinois), and so right beside an umbilic too.
        """
        seams, kept = np.zeros(len(x), dtype=bool), np.zeros(len(x))
        for _ in range(100 if len(x) else 0):
            with np.errstate(invalid="ignore"):
                middle = x + (x2 - x) * (a / (a - c))
            middle = np.where((x < middle) & (middle < x2), middle, 0.5 * (x + x2))
            here = self._principal(middle)[b, :, np.arange(len(x))]
            sin, cos = np.sin(here[:, 0]), np.cos(here[:, 1])
            seams = cos < np.abs(sin)
            there = np.fmin(np.abs(sin), cos) <= 1e-15 * np.fmax(np.abs(sin), cos)
            if (there | (middle <= x) | (middle >= x2)).all():
                break  # to rounding: a path may run along a seam and cross it elsewhere
            before = (sin < 0) == side  # an end that is kept twice counts half
            c = np.where(before, np.where(kept > 0, 0.5 * c, c), sin * cos)
            a = np.where(before, sin * cos, np.where(kept < 0, 0.5 * a, a))
            x, x2 = np.where(before, middle, x), np.where(before, x2, middle)
            kept = np.where(before, 1, -1)
        return seams

    def _followed(self, body: int, at: float, anchor: np.ndarray, x: float) -> np.ndarray:
        """u, v, theta of one body at a place x, continued from an anchor before it."""
        raw = self._principal(np.array([at, x]))
        u, v, theta = raw[body, [0, 1, 4], 1]
        if self._seams(np.array([at, x]), raw)[0, body] != second_cover(*anchor[:2])[0]:
            u, v, theta = -u, np.pi - v, theta + np.pi
        whole = np.array([p or math.inf for p in (*self.surface.periods(), 2 * np.pi)])
        found = np.array([u, v, theta])
        return found + np.round((anchor - found) / whole) * np.where(whole < math.inf, whole, 0.0)

    def _continue(self, t: np.ndarray, values: np.ndarray) -> None:
        """Bring (u, v, theta) to the branch of an anchor beside them, in place."""
        at, anchors = self._anchors  # type: ignore[misc]
        x = self._variable(t)
        nearest = np.searchsorted(0.5 * (at[1:] + at[:-1]), x)
        reference = anchors[:, :, nearest]
        if self.surface.double_cover:
            # that on the point's side of y = 0, and its cover; where both anchors are on one side,
            # the path has left it between them, and must be followed
            before = np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(at) - 2)
            side = second_cover(values[:, 0], values[:, 1])[1]
            covers, sides = second_cover(anchors[:, 0], anchors[:, 1])
            first, last = sides[:, before], sides[:, before + 1]
            chosen = np.where(first == last, nearest, before + (side != first))
            reference = np.take_along_axis(anchors, chosen[:, None], axis=2)
            alike = covers[:, before] == covers[:, before + 1]
            for b, i in np.argwhere((first == last) & ((side != first) | ~alike)):
                k = before[i]
                reference[b, :, i] = self._followed(b, at[k], anchors[b, :, k], x[i])
            u, v, turned = self.surface.align(
                values[:, 0], values[:, 1], reference[:, 0], reference[:, 1]
            )
            values[:, 0], values[:, 1] = u, v
            values[:, 2:4] *= np.where(turned, -1.0, 1.0)[:, None]
            values[:, 4] += np.pi * turned
        else:
            for row, period in enumerate(self.surface.periods()):
                if period is not None:
                    wind(values[:, row], reference[:, row], period)
        wind(values[:, 4], reference[:, 2], 2 * np.pi)


_QUARTERS = np.arange(4) / 4.0


class MovingTrack(PanelTrack):
    """Bodies integrated when something asks for their motion.

    Attributes
    ----------
    kernel : Kernel
    problem : Problem
    tolerance : float
    """

    def __init__(
        self,
        surface: Surface,
        parameters: np.ndarray,
        piece: GainPiece,
        why: str,
        ambient: bool,
        compiled: bool | None,
        kernel: Kernel,
        problem: Problem,
        tolerance: float,
        w: np.ndarray,
        v: np.ndarray | None,
        offset: np.ndarray | None = None,
    ):
        self.surface, self.parameters, self.ambient = surface, parameters, ambient
        self.start, self.stop, self.compiled, self.offset = (
            piece.start, piece.stop, compiled, offset,
        )  # fmt: skip
        self.rows, self.piece, self.w, self.v = slice(None), piece, w, v
        self.by_length, self.forced = v is None, None
        self.kernel, self.problem, self.tolerance, self._why = kernel, problem, tolerance, why
        self._anchors = None

    @once
    def motion(self) -> Motion | None:
        """The problem laid out for C; None where it is integrated here."""
        if usable(self.kernel, self.compiled):
            data, self._pointed = self._track_data()
            return Motion(self.kernel, self.problem, self.tolerance, data)
        return None

    @kept
    def panels(self) -> Panels:
        """The motion, integrated once."""
        if self.motion:
            return self.motion.panels()
        return integrate(self.kernel, self.problem, self.tolerance)

    @once
    def _data(self) -> tuple[int, Any, Any]:
        if self.motion is None:
            return super()._data
        track = self.motion.data.track
        return self.motion.at, track, None

    def data_at(self, output: str) -> int | None:
        if self.motion is None:
            return super().data_at(output)
        return self.motion.at

    def _evaluate(self, output: str, t: np.ndarray, out: np.ndarray) -> int | None:
        if self.motion is not None:
            self.motion.run()
        return super()._evaluate(output, t, out)

    def again(self, tolerance: float) -> Track | None:
        if self.problem.stops or self.offset is not None:
            return None
        own, other = self.motion, self._copy(tolerance)
        if own is not None:
            other.__dict__["motion"] = own.again(tolerance)
        return other

    def moved(
        self, tolerance: float, problem: Problem, w: np.ndarray, v: np.ndarray | None
    ) -> MovingTrack:
        """This track for a problem that was :meth:`Problem.moved`, with other path velocities."""
        motion, other = self.motion, self._copy(tolerance)
        other.problem, other.w, other.v = problem, w, v
        if motion is not None:
            other.__dict__["motion"] = motion = motion.again(tolerance, problem)
            other._point(motion.data.track)
        return other

    def _point(self, data: TrackData) -> None:
        """Point to the numbers that :meth:`moved` changed."""
        data.w, data.v = address(self.w), address(self.w if self.v is None else self.v)

    def _copy(self, tolerance: float) -> MovingTrack:
        return altered(self, _OWN, tolerance=tolerance, _anchors=None)

    @property
    def method(self) -> str:  # type: ignore[override]
        place = "space" if self.ambient else "its chart"
        if self.v is None:
            return f"geodesic in arc length, in {place}, {self.panels.count} panels"
        return f"development in {place}, {self.panels.count} panels"

    @property
    def reason(self) -> str:  # type: ignore[override]
        if self.panels.released is None:
            return self._why
        return f"{self._why}, below tolerance from t = {self.start + self.panels.released:.6g} s on"


_OWN = ("panels", "_data", "_entries")  # what a track for another tolerance must find anew
