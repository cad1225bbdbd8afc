"""From a start to a goal: legs that take a contact there (theory section 11).

Rolling has two inputs and five coordinates, a point on each body and psi. Legs are found by the
method of Gauss and Newton with damping, from many starts at once, with exact derivatives.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..buffer import Buffer
from ..checks import finite_number
from ..errors import ContactSystemError, SceneError
from ..motion import SIDES, Motion
from ..plan import plan
from ..scene import STILL, Leg, Scene, require_scene
from .aim import LANES, MOST_LEGS, Aim, Paths
from .aiming import Array
from .four_rolls import four_rolls
from .goal import Goal, Route

REACHED = 1e-12
"""A goal is reached where nothing is farther off: places in sizes of the bodies, angles in rad."""
SHARP, TOLERANCE = 5e-15, 1e-14
"""Of the size: what steps of a path may be off, and a plan of it."""
COARSE, NEAR = 1e-8, 1e-6
"""The same of a path that may still be another, and how far from the goal it may end."""
STARTS = 64
"""So many starts are tried with each number of legs."""
FEW = 4
"""Starts at once on spheres and planes."""
CORRECTIONS = 12
"""What slip does to a path is put right so often."""
LOOKS = 201
"""Times at which a route is seen to stay within its regions."""


def reach(
    scene: Scene,
    goal: Goal | Sequence[Goal | None],
    *,
    legs: int | None = None,
    longest: float | None = None,
    seconds: float = 0.0,
) -> Route:
    """Find legs that take the contacts of a scene to their goals.

    Parameters
    ----------
    scene : Scene
        Where the contacts start; slip that is there dies on the way. The legs share its duration
        in equal parts.
    goal : Goal, or a sequence of Goal or None
        One a contact; None: it rests where it is.
    legs : int, optional
        So many, 1 to 4; by default the least number with which the goal is reached.
    longest : float, optional
        Greatest length of a leg, m.
    seconds : float
        So long an optimiser looks for the shortest route, also with more legs where ``legs`` is
        left out; 0: the first that is found.

    Raises
    ------
    SceneError
        What cannot be reached, and why.

    Notes
    -----
    A sphere on a plane needs three legs at most; see theory section 11.
    """
    require_scene(scene)
    goals = _goals(scene, goal)
    if legs is not None and (isinstance(legs, bool) or legs not in range(1, MOST_LEGS + 1)):
        raise SceneError(f"legs = {legs!r}: give a number from 1 to {MOST_LEGS}")
    if longest is not None:
        longest = finite_number(longest, "longest", "above 0")
    seconds = finite_number(seconds, "seconds", "not below 0")
    found: list[tuple[Leg, ...]] = []
    told, residual = [], 0.0
    for i, own in enumerate(goals):
        if own is None:
            found.append((Leg(0.0, 0.0, scene.duration),))
            continue
        search = _Search(scene, i, own, longest)
        way, tried = search.shortest(legs, seconds / sum(goal is not None for goal in goals))
        found.append(search.legs(way.z))
        told.append(f"contact {i}: {tried}")
        residual = max(residual, way.residual)
    contacts = [dataclasses.replace(c, legs=own) for c, own in zip(scene.contacts, found)]
    legged = scene.replace(contacts=contacts, profile=STILL)
    whole = sum(leg.length or 0.0 for own in found for leg in own)
    return Route(legged, tuple(found), whole, residual, "; ".join(told))


def _goals(scene: Scene, goal: Any) -> list[Goal | None]:
    """One a contact, checked."""
    goals: list[Goal | None]
    if isinstance(goal, Goal):
        goals = [goal]
    elif isinstance(goal, Sequence) and not isinstance(goal, str):
        goals = list(goal)
    else:
        raise SceneError(f"goal = {goal!r:.80}: give a Goal, or a list of one for each contact")
    for own in goals:
        if not (own is None or isinstance(own, Goal)):
            raise SceneError(f"goal = {own!r:.80}: give a Goal, or None where a contact rests")
    if len(goals) != len(scene.contacts):
        raise SceneError(
            f"{scene.title}: {len(goals)} goals for {len(scene.contacts)} contacts; give one each, "
            "None where a contact rests"
        )
    if not any(goals):
        raise SceneError(f"{scene.title}: every goal is None; give one for a contact at least")
    return goals


# --- one contact -------------------------------------------------------------------------------


@dataclass
class _Way:
    """A path z, how far off it ends, and the squares of the slopes of that."""

    z: Array
    residual: float
    squares: Array

    @property
    def length(self) -> float:
        return _length(self.z)


def _length(z: Array) -> float:
    return float(np.abs(z[len(z) // 2 :]).sum())


@functools.cache
def _starts(n: int, count: int, batch: int) -> Array:
    """Directions of n legs, and lengths, 0.5 to 3; of some paths, (2 n, count)."""
    rng = np.random.default_rng((n, count, batch))
    ways = rng.uniform(-math.pi, math.pi, (n, count))
    return np.concatenate([ways, rng.uniform(0.5, 3.0, (n, count))])


class _Search:
    """The legs that take one contact to its goal."""

    def __init__(self, scene: Scene, index: int, goal: Goal, longest: float | None):
        self.aim = aim = Aim(scene, index, goal, longest)
        self.scene, self.longest = scene, longest
        self.nearest = math.inf
        if longest is not None and MOST_LEGS * longest < aim.far:
            raise SceneError(
                f"{aim.name}: longest = {longest:g} m: the goal is {aim.far:.6g} m away, and "
                f"there are {MOST_LEGS} legs at most; allow longer ones"
            )

    def legs(self, z: Array) -> tuple[Leg, ...]:
        n = len(z) // 2
        span = self.scene.duration / n
        turned = np.where(z[n:] < 0, math.pi, 0.0)
        directions = np.remainder(z[:n] + turned, 2 * math.pi).tolist()
        return tuple(Leg(a, s, span) for a, s in zip(directions, np.abs(z[n:]).tolist()))

    def shortest(self, legs: int | None, seconds: float) -> tuple[_Way, str]:
        """The first route with the least number of legs; then the shortest found in the time."""
        begin, tried = time.perf_counter(), []
        for n in range(self.aim.fewest, MOST_LEGS + 1) if legs is None else (legs,):
            for batch in range(STARTS // self._at_once):
                for way in self._ways(n, batch):
                    if self._stays(way):
                        way = way if legs else self._not_long(way)
                        told = f"{n} legs, {(batch + 1) * self._at_once} starts"
                        return self._shorter(way, legs, begin + seconds), told
            tried.append(f"{n} legs from {STARTS} starts")
        raise SceneError(self._refusal(tried))

    @property
    def _at_once(self) -> int:
        return FEW if self.aim.in_closed_form else LANES

    def _not_long(self, way: _Way) -> _Way:
        """Of a sphere on a plane no route is longer than Hammersley's four rolls."""
        aim = self.aim
        if not aim.in_closed_form or way.length <= max(4 * math.pi * aim.unit, aim.far):
            return way
        z = four_rolls(aim, way.length)
        other = None if z is None else self._met(z)
        return way if other is None or other.length > way.length else other

    def _ways(self, n: int, batch: int) -> Iterator[_Way]:
        """Routes of n legs from some random starts, the shortest of them first."""
        aim = self.aim
        z = _starts(n, self._at_once, batch).copy()
        z[n:] = aim.unit * z[n:] + aim.far / n
        found = aim.search(z, COARSE, NEAR)
        self.nearest = min(self.nearest, float(found.off.min()))
        for k in sorted(np.flatnonzero(found.off < NEAR), key=lambda k: _length(found.z[:, k])):
            way = self._met(found.z[:, k])
            if way is not None:
                yield way

    def _met(self, z: Array, steps: int = 10) -> _Way | None:
        """The route near a path; None where Newton's method finds none.

        It is met as the engine plans it: where slip takes the path elsewhere than geodesics lead,
        that is added to their ends, until nothing changes any more.
        """
        tail = None
        for _ in range(CORRECTIONS):
            found = self.aim.search(z[:, None], SHARP, 0.1 * REACHED, steps=steps, tail=tail)
            z, squares = found.z[:, 0], found.squares[:, :, 0]
            if not found.off[0] < NEAR:
                return None
            try:
                off, end = self._planned(z, found)
            except ContactSystemError:  # such as one through a pole
                return None
            if off <= REACHED:
                return _Way(z, off, squares)
            end = end if tail is None else _frame(tail) @ end
            tail = np.ascontiguousarray(end[:3, [3, 0, 1]].T)
        return None

    def _planned(self, z: Array, found: Paths) -> tuple[float, Array]:
        """How far from the goal the engine's plan of a path ends, and where that is in the frame in
        which the search saw the object's path end."""
        moving = dataclasses.replace(self.aim.contact, legs=self.legs(z))
        alone = self.scene.replace(contacts=[moving], disturbances=[], turning=None, profile=STILL)
        motion = Motion(alone, Buffer(alone, TOLERANCE, 0.0, None))
        asked: Any = motion.evaluate(np.array([alone.duration]), ("points", "pose"))
        points, pose = asked["points"][0, 0], asked["pose"][0, 0]
        finger, seen = map(_frame, found.ends[:, 0].reshape(2, 3, 3))
        there = np.eye(4)  # on the object, p along p of the finger, q and n against its own
        there[:3, :3] = pose[:3, :3] @ finger[:3, :3] * [1.0, -1.0, -1.0]
        there[:3, 3] = points[1]
        return self.aim.off(points, pose), np.linalg.inv(seen) @ there

    # --- shorter ones ---------------------------------------------------------------------------

    def _shorter(self, way: _Way, legs: int | None, until: float) -> _Way:
        """The shortest route found until a time: other starts, each slid down to a least length."""
        if time.perf_counter() >= until:
            return way
        best = self._slid(way, until)
        counts = range(self.aim.fewest, MOST_LEGS + 1) if legs is None else (legs,)
        for batch in itertools.count(STARTS // self._at_once):
            for way in itertools.chain(*(self._ways(n, batch) for n in counts)):
                if time.perf_counter() >= until:
                    return best
                way = self._slid(way, until)
                if way.length < best.length and self._stays(way):
                    best = way
        raise AssertionError

    def _slid(self, way: _Way, until: float) -> _Way:
        """The route moved along the routes beside it to where it is no longer than they are."""
        n = len(way.z) // 2
        unit, step = np.repeat([1.0, self.aim.unit], n), 0.1
        while step > 1e-4 and time.perf_counter() < until:
            values, vectors = np.linalg.eigh(way.squares)
            free = vectors[:, values <= 1e-14 * values[-1]].T
            fall = free.T @ (free @ np.concatenate([np.zeros(n), np.sign(way.z[n:])]))
            if np.linalg.norm(fall) < 1e-6:
                break
            other = self._met(way.z - step * unit * fall / np.linalg.norm(fall), steps=8)
            if other is not None and other.length < way.length and self._stays(other):
                way, step = other, 2.0 * step
            else:
                step *= 0.3
        return way

    # --- what cannot be -------------------------------------------------------------------------

    def _stays(self, way: _Way) -> bool:
        """Whether a route stays within its regions."""
        if not self.aim.regions:
            return True
        moving = dataclasses.replace(self.aim.contact, legs=self.legs(way.z))
        alone = self.scene.replace(contacts=[moving], disturbances=[], turning=None, profile=STILL)
        points = plan(alone).points(np.linspace(0.0, alone.duration, LOOKS))[:, 0]
        return all(
            np.linalg.norm(points[:, side] - centre, axis=1).max() <= widest * (1 + 1e-9)
            for side, centre, _, widest in self.aim.regions
        )

    def _refusal(self, tried: Sequence[str]) -> str:
        why = "no path was found that arrives there"
        if self._alike():
            why = (
                "the finger and the object have the same curvature everywhere, so that a place on "
                "one body sets the place on the other, and the angle"
            )
        elif self.aim.is_pose:
            why += "; do the bodies touch in that pose, from outside?"
        elif tried[0][0] < str(self.aim.fewest):
            why += f": this goal mostly takes {self.aim.fewest} legs at least"
        limits = [f"within {side} {r:g} m" for side, r in self._limits()]
        if self.longest is not None:
            limits.append(f"with no leg above {self.longest:g} m")
        if limits:
            why += f" {' and '.join(limits)}; widen that, or leave parts of the goal out"
        return (
            f"{self.aim.name}: {why}; tried {', '.join(tried)}, of which the nearest ends "
            f"{self.nearest:.2g} (in sizes, rad) off"
        )

    def _limits(self) -> list[tuple[str, float]]:
        return [(f"{SIDES[side]}_within", widest) for side, _, _, widest in self.aim.regions]

    def _alike(self) -> bool:
        """Whether rolling keeps a relation between the places: K_1 = K_2 (theory section 11)."""
        one, other = self.aim.bodies
        balls = one.great_circles and other.great_circles
        return (balls and one.size == other.size) or (one.developable and other.developable)


def _frame(rows: Array) -> Array:
    """A frame, (4, 4), of its origin and its first two axes, (3, 3)."""
    frame = np.eye(4)
    frame[:3, [3, 0, 1]] = rows.T
    frame[:3, 2] = np.cross(rows[1], rows[2])
    return frame
