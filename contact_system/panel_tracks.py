"""Tracks of bodies that are integrated in panels."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from .branches import follow, lay_anchors
from .kept import kept
from .kernels import Kernel, address, contiguous
from .panels import Motion, Panels, Problem, integrate, usable
from .profile import GainPiece
from .surfaces import Surface
from .tracks import (
    LOCK,
    Evaluator,
    Track,
    TrackData,
    altered,
    coordinate_kernel,
    drive_data,
    evaluator,
    in_parts,
    once,
    whole_frame,
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


SEARCHED = 4096  # panels of all bodies that a search for poles looks at together


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

    def crossed(self) -> tuple[float, float] | None:
        """u, v of a singular point of its chart that a path goes through; None without one."""
        if self.ambient:
            return None
        own = slice(self.rows.start or 0, (self.rows.start or 0) + 2)
        edges, many = self.panels.edges, -(-SEARCHED // self.n_bodies)
        for k in range(0, len(edges) - 1, many):  # or long paths would fill the memory
            some = slice(k, min(k + many, len(edges) - 1))
            place = self.singular_place(
                in_parts(edges[some.start : some.stop + 1]),
                self.panels.in_parts(some, own),
                lambda at, bodies: self.panels.evaluate_each(at, bodies, own),
            )
            if place is not None:
                return place
        return None

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
            at, anchors = self._anchors
            follow(self.surface, self._principal, at, anchors, self._variable(t), values)
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
        return at, lay_anchors(self.surface, self._principal, at, begin)

    def _principal(self, at: np.ndarray) -> np.ndarray:
        """u, v, rates, theta at places on the panels, in principal values; the rates are none."""
        points = np.concatenate([self._state_at(at), np.zeros((self.n_bodies, 2, len(at)))], axis=1)
        with np.errstate(all="ignore"):
            return self.run(coordinate_kernel(self.surface, True), points, self.parameters)


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
