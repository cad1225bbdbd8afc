"""Contacts that move together: their tracks, their slip, and where they have come to."""

from __future__ import annotations

import bisect
import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .closed_form import CircleTrack
from .errors import ChartSingularity
from .kept import kept
from .panel_tracks import MovingTrack
from .profile import GainPiece
from .starts import Moment
from .tracks import Track, altered, prefers_ambient, restoring_kernel

SIDES = ("finger", "object")


@dataclass(eq=False)
class SlipRecord:
    """V(t) on [start, stop] in the object's parallel frame; slip is sigma V less the offset's part.

    ``of`` maps local times to V (n, 2, n_times), or is None where there is no slip; ``pushed`` maps
    them to W_1, or is the constant W_1 (n, 2); None where frames are not carried along.
    """

    start: float
    stop: float
    piece: GainPiece
    of: Callable[[np.ndarray], np.ndarray] | None
    forcing: tuple[np.ndarray, np.ndarray] | None
    pushed: Callable[[np.ndarray], np.ndarray] | np.ndarray | None = None

    def slip(self, t: np.ndarray) -> np.ndarray:
        """V: (n, 2, n_times)."""
        if self.of is None:
            return 0 * self.finger_velocity(t)
        return self.of(t - self.start)

    def finger_velocity(self, t: np.ndarray) -> np.ndarray:
        """W_1: (n, 2, n_times)."""
        assert self.pushed is not None
        if callable(self.pushed):
            return self.pushed(t - self.start)
        return np.repeat(self.pushed[:, :, None], len(t), axis=2)


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
    begin : two (n, 3)
        u, v, theta of finger and object at the start.
    finger, object : list of Track
    slips : list of SlipRecord
    pair : CircleTrack or None
        Fingers and objects as one track of 2 n bodies, where both run on one great circle each.
    layouts, programs : dict
        What `program` keeps: with the scene, as long as tracks are of the same kinds; and with the
        group.
    """

    contacts: np.ndarray
    r0: np.ndarray
    angle: np.ndarray
    begin: tuple[np.ndarray, np.ndarray]
    finger: list[Track] = field(default_factory=list)
    object: list[Track] = field(default_factory=list)
    slips: list[SlipRecord] = field(default_factory=list)
    pair: CircleTrack | None = None
    layouts: dict[str, Any] = field(default_factory=dict)
    programs: dict[str, Any] = field(default_factory=dict)

    def repeats(self, tolerance: float) -> bool:
        """Whether only the last track of each side depends on the tolerance."""
        for tracks in (self.finger, self.object):
            others = [track.again(tolerance) for track in tracks]
            if others[-1] is None or any(a is not b for a, b in zip(tracks[:-1], others)):
                return False
        return True

    @kept
    def in_a_row(self) -> bool:
        """Whether no contact of another group lies between: rows of finger and object alternate."""
        return bool((np.diff(self.contacts) == 1).all())

    @kept
    def moving(self) -> list[MovingTrack]:
        """Of a group that :meth:`repeats`, the tracks that another tolerance changes."""
        ends = self.finger[-1], self.object[-1]
        return [track for track in ends if isinstance(track, MovingTrack)]

    def again(self, tolerance: float) -> Group:
        """A group that :meth:`repeats`, for another tolerance."""
        if not self.moving:
            return self
        anew = {track: track.again(tolerance) for track in self.moving}
        finger, obj = (
            [*tracks[:-1], anew.get(tracks[-1], tracks[-1])]  # type: ignore[call-overload]
            for tracks in (self.finger, self.object)
        )
        return altered(self, ("moving",), finger=finger, object=obj, programs={})

    def coordinates_at(self, side: str, count: int) -> np.ndarray:
        """Continuous (u, v, theta) at the end of the first ``count`` tracks: (n, 3).

        On the way those tracks learn the branch they continue.
        """
        now = self.begin[side == "object"]
        tracks = getattr(self, side)[:count]
        for track in tracks:
            if not track.anchored:
                track.anchor(now)
            values = np.empty((len(now), 5, 1))
            track.coordinates(np.array([track.stop]), values)
            now = values[:, [0, 1, 4], 0]
        return now

    def anchor(self, side: str, track: Track) -> None:
        """Make a track's coordinates continue those of the tracks before it."""
        if not track.anchored:
            index = getattr(self, side).index(track)
            begin = self.begin[side == "object"]
            track.anchor(begin if index == 0 else self.coordinates_at(side, index))

    def anchor_all(self) -> None:
        """Make coordinates continuous, of all tracks that programs read (program.py)."""
        if self.in_a_row:
            self.anchor_pair()
        if self.pair is None or not self.in_a_row:
            for side in SIDES:
                self.coordinates_at(side, len(getattr(self, side)) - 1)
                self.anchor(side, getattr(self, side)[-1])

    def anchor_pair(self) -> None:
        """The same for :attr:`pair`."""
        if self.pair is not None and not self.pair.anchored:
            self.pair.anchor(np.stack(self.begin, axis=1).reshape(-1, 3))

    def moments(self, t: float) -> list[Moment]:
        """Where each contact has come to at time t."""
        time = np.array([t])
        record = _acting(self.slips, t)
        w1, v = record.finger_velocity(time)[:, :, 0], record.slip(time)[:, :, 0]
        columns = [self.angle[:, None], w1, v]
        columns += [self._places(side, t) for side in SIDES]
        columns += [_moving_frame(_acting(getattr(self, side), t), t) for side in SIDES]
        rows = zip(*(column.tolist() for column in columns))
        return [Moment(angle[0], *map(tuple, others)) for angle, *others in rows]

    def _places(self, side: str, t: float) -> np.ndarray:
        """u, v, theta at time t, (n, 3); where there are none, of a moment before or after.

        They say which branch is to be continued; the place itself is that of the moving frame.
        """
        track = _acting(getattr(self, side), t)
        if not prefers_ambient(track.surface):
            return track.state(np.array([t]))[:, :, 0]
        self.anchor(side, track)
        values = np.empty((track.n_bodies, 5, 1))
        aside = 1e-7 * (track.stop - track.start)
        for near in (t, max(t - aside, track.start), min(t + aside, track.stop)):
            with contextlib.suppress(ChartSingularity):
                track.coordinates(np.array([near]), values)
                return values[:, [0, 1, 4], 0]
        raise track.singular(t)


def moments(groups: Sequence[Group], t: float) -> list[Moment]:
    """Where every contact of a plan has come to at time t, in the scene's order."""
    found = {i: m for group in groups for i, m in zip(group.contacts, group.moments(t))}
    return [found[i] for i in range(len(found))]


def _acting(intervals: Sequence[Any], t: float) -> Any:
    """The track or record of a time; an edge belongs to the later one."""
    return intervals[bisect.bisect_right([i.start for i in intervals[1:]], t)]


def _moving_frame(track: Track, t: float) -> np.ndarray:
    """x, p, q at time t on the surface, (n, 9); (n, 0) where bodies are moved in their chart."""
    if not prefers_ambient(track.surface):
        return np.empty((track.n_bodies, 0))
    frames = track.frames(np.array([t]))[:, :, 0]
    return restoring_kernel(track.surface).at(frames, track.parameters)
