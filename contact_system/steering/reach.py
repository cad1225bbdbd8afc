"""From a start to a goal: legs that take a contact there (theory section 11).

Rolling has two inputs and five coordinates, a point on each body and psi. Legs are found by the
method of Gauss and Newton with damping, from many starts, with exact derivatives.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..buffer import Buffer
from ..checks import finite_number, naming
from ..errors import ContactSystemError, SceneError
from ..motion import SIDES, Motion
from ..plan import plan
from ..scene import STILL, Contact, Leg, Scene, require_scene
from .four_rolls import four_rolls
from .goal import Goal, Route
from .jacobi import Array
from .paths import TOLERANCE, Aim, ClosedPaths, Region, RolledPaths

REACHED = 1e-12
"""A goal is reached where nothing is farther off: places in sizes of the bodies, angles in rad."""
MOST_LEGS = 4
STARTS = 60
"""So many starts are tried with each number of legs."""
LOOKS = 201
"""Times at which a route is seen to stay within its regions."""
_STEPS = 40


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
    told = []
    searches: dict[int, _Search] = {}
    for i, own in enumerate(goals):
        if own is None:
            found.append((Leg(0.0, 0.0, scene.duration),))
            continue
        search = searches[i] = _Search(scene, i, own, longest)
        share = seconds / sum(goal is not None for goal in goals)
        way, tried = search.shortest(legs, share)
        found.append(search.legs(way))
        told.append(f"contact {i}: {tried}")
    contacts = [dataclasses.replace(c, legs=own) for c, own in zip(scene.contacts, found)]
    legged = scene.replace(contacts=contacts, profile=STILL)
    whole = sum(leg.length or 0.0 for own in found for leg in own)
    off = _arrival(legged, searches)
    return Route(legged, tuple(found), whole, off, "; ".join(told))


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


def _arrival(scene: Scene, searches: dict[int, _Search]) -> float:
    """How far off their goals the contacts arrive, planned by the engine as the scene is."""
    motion = Motion(scene, Buffer(scene, TOLERANCE, 0.0, None))
    found: Any = motion.evaluate(np.array([scene.duration]), ("points", "pose"))
    return max(
        search.off(found["points"][0, i], found["pose"][0, i]) for i, search in searches.items()
    )


# --- one contact -------------------------------------------------------------------------------


@dataclass
class _Way:
    """A path z, and how far off it ends."""

    z: Array
    residual: float

    @property
    def length(self) -> float:
        return float(np.abs(self.z[len(self.z) // 2 :]).sum())


class _Search:
    """The legs that take one contact to its goal."""

    def __init__(self, scene: Scene, index: int, goal: Goal, longest: float | None):
        self.scene, self.goal, self.longest = scene, goal, longest
        self.name = f"{scene.title}, contact {index}"
        self.aim = _aim(scene, scene.contacts[index], goal, self.name)
        wanted = 5 if self.aim.pose is not None else 2 * len(self.aim.sides)
        self.fewest = (wanted + 1) // 2
        bounds = [region.widest for region in self.aim.regions]
        self.unit = min(self.aim.sizes + bounds) / self.aim.pace
        self.far = max((self._apart(side) for side in self.aim.sides), default=0.0) / self.aim.pace
        if longest is not None and MOST_LEGS * longest < self.far:
            raise SceneError(
                f"{self.name}: longest = {longest:g} m: the goal is {self.far:.6g} m away, and "
                f"there are {MOST_LEGS} legs at most; allow longer ones"
            )

    def _apart(self, side: int) -> float:
        return float(np.linalg.norm(self.aim.goal[side][0] - self.aim.start[side][0]))

    def off(self, points: Array, pose: Array) -> float:
        """How far from the goal a contact is with these contact points and this pose."""
        aim = self.aim
        parts = [(points[side] - aim.goal[side][0]) / aim.sizes[side] for side in aim.sides]
        if aim.pose is not None:
            parts.append((pose[:3, :3] - aim.pose[:3, :3]).ravel())
            if aim.is_pose:
                parts.append((pose[:3, 3] - aim.pose[:3, 3]) / max(aim.sizes))
        return float(np.linalg.norm(np.concatenate(parts)))

    def legs(self, way: _Way) -> tuple[Leg, ...]:
        n = len(way.z) // 2
        span = self.scene.duration / n
        turned = np.where(way.z[n:] < 0, math.pi, 0.0)
        directions = np.remainder(way.z[:n] + turned, 2 * math.pi).tolist()
        return tuple(Leg(a, s, span) for a, s in zip(directions, np.abs(way.z[n:]).tolist()))

    def shortest(self, legs: int | None, seconds: float) -> tuple[_Way, str]:
        """The first route with the least number of legs; then the shortest found in the time."""
        begin, tried, nearest = time.perf_counter(), [], math.inf
        for n in range(self.fewest, MOST_LEGS + 1) if legs is None else (legs,):
            for k, way in enumerate(self._ways(n, range(STARTS)), 1):
                nearest = min(nearest, way.residual)
                if way.residual <= REACHED and self._stays(way):
                    way = way if legs else self._not_long(way)
                    return self._shorter(way, legs, begin + seconds), f"{n} legs, start {k}"
            tried.append(f"{n} legs from {STARTS} starts")
        raise SceneError(self._refusal(tried, nearest))

    def _not_long(self, way: _Way) -> _Way:
        """Of a sphere on a plane no route is longer than Hammersley's four rolls."""
        if not self.aim.in_closed_form or way.length <= max(4 * math.pi * self.unit, self.far):
            return way
        z = four_rolls(self.aim, way.length)
        other = way if z is None else self._newton(self._paths(4), z)
        return other if other.residual <= REACHED and other.length < way.length else way

    def _ways(self, n: int, starts: range) -> Iterator[_Way]:
        """What Newton's method makes of random starts with n legs."""
        paths = self._paths(n)
        for k in starts:
            rng = np.random.default_rng((n, k))
            phi = rng.uniform(-math.pi, math.pi, n)
            z = np.concatenate([phi, self.unit * rng.uniform(0.5, 3.0, n) + self.far / n])
            yield self._newton(paths, z)

    def _paths(self, n: int) -> ClosedPaths | RolledPaths:
        if self.aim.in_closed_form:
            return ClosedPaths(self.aim, n)
        return RolledPaths(self.aim, n, self.scene)

    def _residual(self, paths: ClosedPaths | RolledPaths, z: Array) -> tuple[Array, Array]:
        off, slopes = paths.off(z)
        if self.longest is None:
            return off, slopes
        n = paths.n
        beyond = np.abs(z[n:]) > self.longest
        over = np.where(beyond, np.abs(z[n:]) / self.longest - 1.0, 0.0)
        slope = np.diag(np.where(beyond, np.sign(z[n:]) / self.longest, 0.0))
        return np.concatenate([off, over]), np.vstack([slopes, np.hstack([0 * slope, slope])])

    def _newton(self, paths: ClosedPaths | RolledPaths, z: Array, steps: int = _STEPS) -> _Way:
        """Gauss and Newton's method with Levenberg's damping."""
        n = len(z)
        unit = np.repeat([1.0, self.unit], n // 2)
        damping, best, mark = 1e-2, math.inf, math.inf
        diagonal, tried = np.diag_indices(n), z
        for k in range(steps):
            if k % 6 == 5:  # starts that only creep are given up
                if best > 0.5 * mark:
                    break
                mark = best
            try:
                off, slopes = self._residual(paths, tried)
                size = float(off @ off)
            except ContactSystemError:  # a path that cannot be rolled, as through a pole
                size = math.inf
            if size < best:
                z, best, damping = tried, size, max(0.3 * damping, 1e-11)
                slopes = slopes * unit
                square, pull = slopes.T @ slopes, slopes.T @ off
                if best < (0.1 * REACHED) ** 2:
                    break
            elif best < math.inf:
                damping *= 10.0
            else:
                break
            damped = square.copy()
            damped[diagonal] += damping
            step = np.linalg.solve(damped, pull)
            tried = z - unit * (step / max(1.0, *map(abs, step.tolist())))
        return _Way(z, math.sqrt(best))

    # --- shorter ones ---------------------------------------------------------------------------

    def _shorter(self, way: _Way, legs: int | None, until: float) -> _Way:
        """The shortest route found until a time: other starts, each slid down to a least length."""
        if time.perf_counter() >= until:
            return way
        best = self._slid(way, until)
        counts = range(self.fewest, MOST_LEGS + 1) if legs is None else (legs,)
        others = [self._ways(n, range(STARTS, sys.maxsize)) for n in counts]
        for ways in itertools.cycle(others):
            if time.perf_counter() >= until:
                break
            way = next(ways)
            if way.residual <= REACHED and (way := self._slid(way, until)).length < best.length:
                best = way if self._stays(way) else best
        return best

    def _slid(self, way: _Way, until: float) -> _Way:
        """The route moved along the routes beside it to where it is no longer than they are."""
        n = len(way.z) // 2
        paths, unit, step = self._paths(n), np.repeat([1.0, self.unit], n), 0.1
        while step > 1e-4 and time.perf_counter() < until:
            off, slopes = self._residual(paths, way.z)
            left, values, right = np.linalg.svd(slopes * unit, full_matrices=True)
            free = right[int((values > 1e-9 * values[0]).sum()) :]
            fall = free.T @ (free @ np.concatenate([np.zeros(n), np.sign(way.z[n:])]))
            if np.linalg.norm(fall) < 1e-6:
                break
            tried = way.z - step * unit * fall / np.linalg.norm(fall)
            other = self._newton(paths, tried, steps=8)
            if other.residual <= REACHED and other.length < way.length and self._stays(other):
                way, step = other, 2.0 * step
            else:
                step *= 0.3
        return way

    # --- what cannot be -------------------------------------------------------------------------

    def _stays(self, way: _Way) -> bool:
        """Whether a route stays within its regions."""
        if not self.aim.regions:
            return True
        moving = dataclasses.replace(self.aim.contact, legs=self.legs(way))
        alone = self.scene.replace(contacts=[moving], turning=None)
        points = plan(alone).points(np.linspace(0.0, alone.duration, LOOKS))[:, 0]
        return all(
            np.linalg.norm(points[:, side] - centre, axis=1).max() <= widest * (1 + 1e-9)
            for side, centre, _, widest in self.aim.regions
        )

    def _refusal(self, tried: Sequence[str], nearest: float) -> str:
        why = "no path was found that arrives there"
        if self._alike():
            why = (
                "the finger and the object have the same curvature everywhere, so that a place on "
                "one body sets the place on the other, and the angle"
            )
        elif self.aim.is_pose:
            why += "; do the bodies touch in that pose, from outside?"
        elif tried[0][0] < str(self.fewest):
            why += f": this goal mostly takes {self.fewest} legs at least"
        limits = [f"within {side} {r:g} m" for side, r in self._limits()]
        if self.longest is not None:
            limits.append(f"with no leg above {self.longest:g} m")
        if limits:
            why += f" {' and '.join(limits)}; widen that, or leave parts of the goal out"
        return (
            f"{self.name}: {why}; tried {', '.join(tried)}, of which the nearest ends "
            f"{nearest:.2g} (in sizes, rad) off"
        )

    def _limits(self) -> list[tuple[str, float]]:
        return [(f"{SIDES[side]}_within", widest) for side, _, _, widest in self.aim.regions]

    def _alike(self) -> bool:
        """Whether rolling keeps a relation between the places: K_1 = K_2 (theory section 11)."""
        one, other = self.aim.bodies
        balls = one.great_circles and other.great_circles
        return (balls and one.size == other.size) or (one.developable and other.developable)


# --- a goal in numbers ---------------------------------------------------------------------------


def _aim(scene: Scene, contact: Contact, goal: Goal, name: str) -> Aim:
    """What the search needs to know; refuses what is no goal of this contact."""
    if contact.follows:
        raise SceneError(f'{name}: finger_velocity = "rolling" has no legs; give it as two numbers')
    if not any(contact.finger_velocity):
        raise SceneError(f"{name}: finger_velocity = (0, 0) gives legs no direction; give it one")
    index = scene.contacts.index(contact)
    if any(d.contact == index for d in scene.disturbances):
        raise SceneError(
            f"{name}: disturbances would take it off its way; leave them out of the scene, and "
            "add them to that of the route"
        )
    bodies = contact.finger, scene.object
    start, there, sides = [], [], []
    for side, body in enumerate(bodies):
        at = getattr(contact, f"{SIDES[side]}_at")
        wanted = getattr(goal, f"{SIDES[side]}_at")
        if wanted is not None:
            sides.append(side)
            with naming(f"{name}: goal: {SIDES[side]}_at"):
                regular = body.canonical(*wanted)
            # another cover has another frame, and psi is that of the frame
            wanted = wanted if body.double_cover else regular
        points, frames = body.point_and_frame(*np.transpose([at, at if wanted is None else wanted]))
        start.append((points[0], frames[0]))
        there.append((points[1], frames[1]))
    pose = goal.pose
    if goal.angle is not None:
        c, s = math.cos(goal.angle), math.sin(goal.angle)
        joint = np.array([[c, -s, 0.0], [-s, -c, 0.0], [0.0, 0.0, -1.0]])
        pose = np.eye(4)
        pose[:3, :3] = there[1][1] @ joint @ there[0][1].T
    angles = contact.angle, goal.angle or 0.0
    aim = Aim(contact, bodies, tuple(sides), start, there, angles, pose, goal.pose is not None, [])
    aim.regions += _regions(aim, goal, name)
    return aim


def _regions(aim: Aim, goal: Goal, name: str) -> Iterator[Region]:
    """Regions to stay within; refuses those that the start or the goal lies outside of."""
    for side, body in enumerate(aim.bodies):
        key = f"{SIDES[side]}_within"
        given = getattr(goal, key)
        if given is None:
            continue
        *at, widest = given
        with naming(f"{name}: goal: {key}"):
            centre = body.point(*body.canonical(*at))
        places = [("start", aim.start[side][0])]
        if side in aim.sides:
            places.append(("goal", aim.goal[side][0]))
        radius = 0.99 * widest
        for what, place in places:
            away = float(np.linalg.norm(place - centre))
            if away > widest * (1 + 1e-12):
                raise SceneError(
                    f"{name}: {key} = {given}: the {what} lies {away:.6g} m from that point; move "
                    "it, or widen the region"
                )
            radius = max(radius, away)
        yield Region(side, centre, radius, widest)
