"""Legs that take contacts from a start to a goal (theory section 11).

Rolling has two inputs and five coordinates: a point on each body and psi. Legs are found by a
damped Gauss-Newton method with exact derivatives, from many starts at once.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import random
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import all_of, finite_number
from ..errors import ContactSystemError, SceneError
from ..plan import plan
from ..planning.motion import Motion
from ..scene import NO_CLAIMS, ROLLING, SIDES, STILL, Leg, Scene, require_scene
from .aim import LANES, MOST_LEGS, Aim
from .four_rolls import four_rolls
from .goal import Goal, Route
from .shooting import SHARP, Array

REACHED = 1e-12
"""Error at which a goal is reached: of places as a fraction of the size, of angles in rad."""
TOLERANCE = 1e-14
"""Error of the plan of a path, as a fraction of the size."""
COARSE = 1e-6
"""Error of a step of a geodesic, as a fraction of the size, in a search of many paths."""
NEAR, NEARER = 1e-4, 1e-7
"""Errors at the goal before the last step, which squares them: of one of many paths, of a route."""
STARTS, ROUNDS, LONGER = 128, 8, 1.5
"""Random starts for each number of legs in a round of the search, rounds, and the factor by which
legs grow from round to round: on bodies of almost one form curves differ only after many turns."""
ENOUGH_STEPS = 1_500_000
"""Steps of geodesics, 16 at once, after which no further round begins: each takes 2 to 5 us."""
CORRECTIONS, DIFFERENCE = 8, 1e-6
"""Most corrections of a path for slip, and the unknowns' step in difference quotients, in units."""
FLAT = 1e-12
"""Gaussian curvature, times the size squared, that is 0 but for rounding."""
SAMPLES = 201
"""Times at which a route is checked against its regions."""


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
        The contacts' starts, with or without slip. Legs divide its duration equally, and replace
        its profile and the legs that it has. A contact that rests is given the ``finger_velocity``
        (1, 0), from which their directions are measured.
    goal : Goal, or a sequence of Goal or None
        One for each contact; None: it stays at rest.
    legs : int, optional
        Number of legs, 1 to 4; default: the first number that is found to reach the goal.
    longest : float, optional
        Greatest length of a leg, m.
    seconds : float
        Time for an optimiser to search for a shorter route, s, also one of more legs if ``legs``
        is not given. 0: return the first route found.

    Raises
    ------
    SceneError
        No route is found; the text says why.

    Notes
    -----
    A sphere on a plane needs three legs at most; see theory section 11.
    """
    require_scene(scene)
    goals = _goals(scene, goal)
    if legs is not None:
        if legs not in range(1, MOST_LEGS + 1):
            raise SceneError(f"legs = {legs!r}: give a number from 1 to {MOST_LEGS}")
        legs = int(legs)
    if longest is not None:
        longest = finite_number(longest, "longest", "above 0")
    seconds = finite_number(seconds, "seconds", "not below 0")
    rest = (Leg(0.0, 0.0, scene.duration),)
    contacts, residual, texts = list(scene.contacts), 0.0, []
    share = seconds / sum(wanted is not None for wanted in goals)
    for i, wanted in enumerate(goals):
        if wanted is None:
            contacts[i] = dataclasses.replace(contacts[i], legs=rest)
            continue
        route, tried = _Search(scene, i, wanted, longest).shortest(legs, share)
        contacts[i], residual = route.scene.contacts[0], max(residual, route.residual)
        texts.append(f"{scene.contact_name(i)}: {tried}")
    legged = scene.replace(contacts=contacts, profile=STILL, **NO_CLAIMS)
    legs_by_contact = tuple(tuple(contact.legs) for contact in legged.contacts)
    whole = sum(leg.length for path in legs_by_contact for leg in path)
    return Route(legged, legs_by_contact, whole, residual, "; ".join(texts))


def _goals(scene: Scene, goal: Any) -> list[Goal | None]:
    """One goal for each contact, checked."""
    listed = [goal] if isinstance(goal, Goal) else goal
    names = "Goal, or None for a contact at rest"
    goals = list(all_of((Goal, type(None)), listed, "goal", names))
    if len(goals) != len(scene.contacts):
        raise SceneError(
            f"{scene.title}: goals given: {len(goals)}; contacts: {len(scene.contacts)}; give one "
            'for each, and for a contact at rest None (on the command line --to "")'
        )
    if not any(goals):
        raise SceneError(f"{scene.title}: every goal is None; give one for a contact at least")
    return goals


# --- one contact -------------------------------------------------------------------------------


@dataclass
class _Route:
    """A path z (see `Aim.search`), a scene of this contact alone on it, its error, and J^T J."""

    z: Array
    scene: Scene
    residual: float
    squares: Array

    @property
    def length(self) -> float:
        return _length(self.z)


def _length(z: Array) -> float:
    return float(np.abs(z[len(z) // 2 :]).sum())


class _Search:
    """The search for the legs of one contact."""

    def __init__(self, scene: Scene, index: int, goal: Goal, longest: float | None):
        self.aim = aim = Aim(scene, index, goal, longest)
        self.scene, self.longest = scene, longest
        # well below the error of the start, or paths of length 0 would seem to arrive
        self.near = max(min(NEAR, 0.01 * aim.start_off), REACHED)
        self.nearest = math.inf
        if longest is not None and not aim.is_pose and MOST_LEGS * longest < aim.far:
            raise SceneError(
                f"{aim.name}: longest = {longest:g} m: the goal is {aim.far:.6g} m away, and "
                f"there are {MOST_LEGS} legs at most; allow longer ones"
            )

    def alone(self, z: Array) -> Scene:
        """A scene of this contact alone, on the legs of the path z."""
        n, legs = len(z) // 2, []
        for direction, length in zip(z[:n].tolist(), z[n:].tolist()):
            direction = (direction + math.pi if length < 0 else direction) % (2 * math.pi)
            legs.append(Leg(direction, abs(length), self.scene.duration / n))
        moving = dataclasses.replace(self.aim.contact, legs=legs)
        changed = {"contacts": [moving], "disturbances": [], "profile": STILL}
        return self.scene.replace(**changed, **NO_CLAIMS)

    def shortest(self, legs: int | None, seconds: float) -> tuple[_Route, str]:
        """The first route found, of few legs; then shorter ones until the time is up."""
        if self.aim.start_off <= REACHED:  # it stays at rest
            z = np.zeros(2 * (legs or 1))
            return _Route(z, self.alone(z), self.aim.start_off, np.eye(0)), "it starts at its goal"
        until = time.perf_counter() + seconds
        counts = range(self.aim.fewest, MOST_LEGS + 1) if legs is None else (legs,)
        per_round = STARTS // LANES
        for k in range(ROUNDS):
            batches = range(k * per_round, (k + 1) * per_round)
            for n, batch in itertools.product(counts, batches):
                for route in filter(self._stays, self._routes(n, batch, LONGER**k)):
                    rolls = None if legs else self._four_rolls(route.length)
                    how = f"{n} leg{'s' * (n > 1)}, {(batch + 1) * LANES} starts"
                    return self._shorter(rolls or route, counts, until), how
            hopeless = counts[0] < self.aim.fewest or self._same_curvature()
            if hopeless or self.aim.steps > ENOUGH_STEPS:
                break
        raise SceneError(self._refusal(counts, batches.stop * LANES))

    def _four_rolls(self, below: float) -> _Route | None:
        """Hammersley's route of a sphere on a plane, if it is shorter than ``below``, m along s."""
        z = four_rolls(self.aim, below)
        route = None if z is None else self._route_near(z)
        return route if route and route.length < below and self._stays(route) else None

    def _routes(self, n: int, batch: int, longer: float = 1.0) -> Iterator[_Route]:
        """Routes of n legs, longer by a factor, from 16 random starts, the shortest first."""
        aim, rng = self.aim, random.Random(f"{n} {batch}")  # numpy's takes 9 ms to import
        part = np.array([rng.random() for _ in range(2 * n * LANES)]).reshape(2 * n, LANES)
        lengths = longer * 0.5 ** (batch % 4) * aim.unit * (0.5 + 2.5 * part[n:]) + aim.far / n
        z = np.concatenate([math.pi * (2 * part[:n] - 1), lengths])
        z, off, _ = aim.search(z, min(COARSE, 0.1 * self.near), self.near)
        self.nearest = min(self.nearest, float(off.min()))
        found = sorted(z[:, off < self.near].T, key=_length)
        yield from filter(None, map(self._route_near, found))

    def _route_near(self, z: Array) -> _Route | None:
        """The route to which the Gauss-Newton method leads from a path; None if there is none.

        Its error is that of the planned path. If slip moves the object's curve off the geodesics,
        difference quotients of plans serve as derivatives to bring its end to the goal.
        """
        try:
            paths, off, squares = self.aim.search(z[:, None], SHARP, NEARER)
            if not off[0] < NEAR:
                return None
            z, scene, residual = self._corrected(paths[:, 0])
            return _Route(z, scene, residual, squares[..., 0]) if residual <= REACHED else None
        except ContactSystemError:  # such as a path through a pole
            return None

    def _corrected(self, z: Array) -> tuple[Array, Scene, float]:
        """The path, corrected by least-norm Gauss-Newton steps until its plan ends at the goal; its
        scene and its error."""
        n, longest = len(z) // 2, self.longest or math.inf
        unit, most = np.repeat([[1.0, self.aim.unit], [math.inf, longest]], n, axis=1)
        scene, gap = self._planned(z)
        for _ in range(CORRECTIONS):
            if np.linalg.norm(gap) <= REACHED:
                break
            both = [(z + h, z - h) for h in np.diag(DIFFERENCE * unit)]
            rows = [self._planned(more)[1] - self._planned(less)[1] for more, less in both]
            slopes = np.transpose(rows) / (2 * DIFFERENCE)
            slopes[:, np.abs(z) >= most] = 0.0  # a leg of the greatest length keeps it
            step = np.linalg.lstsq(slopes, gap, rcond=1e-9)[0]
            step /= max(1.0, np.abs(step).max())  # where slopes almost vanish it leads far away
            z = np.clip(z - unit * step, -most, most)
            scene, gap = self._planned(z)
        return z, scene, float(np.linalg.norm(gap))

    def _planned(self, z: Array) -> tuple[Scene, Array]:
        """The scene of a path, and the difference between the end of its plan and the goal."""
        scene = self.alone(z)
        motion = Motion(scene, TOLERANCE)
        results: Any = motion.evaluate(np.array([scene.duration]), ("points", "pose"))
        return scene, self.aim.gap(results["points"][0, 0], results["pose"][0, 0])

    # --- shorter ones ---------------------------------------------------------------------------

    def _shorter(self, route: _Route, counts: Sequence[int], until: float) -> _Route:
        """The shortest route found until a time: this one and those of more starts, shortened."""
        best, batch = self._shortened(route, until), STARTS // LANES
        while time.perf_counter() < until:
            for route in itertools.chain(*(self._routes(n, batch) for n in counts)):
                route = self._shortened(route, until)
                if route.length < best.length and self._stays(route):
                    best = route
                if time.perf_counter() >= until:
                    break
            batch += 1
        return best

    def _shortened(self, route: _Route, until: float) -> _Route:
        """The route shortened by steps in the null space of J, until its length is a minimum."""
        n = len(route.z) // 2
        unit, step = np.repeat([1.0, self.aim.unit], n), 0.1
        while step > 1e-4 and time.perf_counter() < until:
            values, vectors = np.linalg.eigh(route.squares)
            free = vectors[:, values <= 1e-14 * values[-1]].T
            slope = free.T @ (free @ np.concatenate([np.zeros(n), np.sign(route.z[n:])]))
            if np.linalg.norm(slope) < 1e-6:
                break
            shorter = self._route_near(route.z - step * unit * slope / np.linalg.norm(slope))
            if shorter and shorter.length < route.length and self._stays(shorter):
                route, step = shorter, 2.0 * step
            else:
                step *= 0.3
        return route

    # --- regions and refusals -------------------------------------------------------------------

    def _stays(self, route: _Route) -> bool:
        """Whether a route stays within its regions."""
        if not self.aim.regions:
            return True
        points = plan(route.scene).points(np.linspace(0.0, self.scene.duration, SAMPLES))[:, 0]
        return all(
            np.linalg.norm(points[:, side] - centre, axis=1).max() <= radius * (1 + 1e-9)
            for side, centre, radius in self.aim.regions
        )

    def _refusal(self, counts: Sequence[int], starts: int) -> str:
        why = "no path was found that arrives there"
        limits = [f"within {SIDES[r.side]}_within {r.radius:g} m" for r in self.aim.regions]
        if self.longest is not None:
            limits.append(f"with no leg above {self.longest:g} m")
        if limits:
            why += f" {' and '.join(limits)}; widen that, or leave parts of the goal out"
        if self.nearest < self.near and self.aim.contact.object_velocity != ROLLING:
            why += (
                "; paths without slip do, but slip leads off them; raise the gain, or let it roll"
            )
        elif self._same_curvature(0.02):
            balls = self.aim.bodies[0].chart.great_circles
            other = "sizes that differ by more than 2 %" if balls else "a ball for one of them"
            why += (
                "; the finger and the object have "
                f"{'' if self._same_curvature() else 'almost '}the same Gaussian curvature "
                "everywhere: a place on one body determines that on the other, and the angle; "
                f"choose {other}, or leave parts of the goal out"
            )
        elif self.aim.is_pose:
            why += f"; do the bodies touch there, from outside, to {REACHED:g} of their size?"
        elif counts[0] < self.aim.fewest:
            why += f"; this goal mostly takes {self.aim.fewest} legs at least"
        elif not limits:
            why += (
                "; leave parts of the goal out, reach another goal first, or move this one away "
                "from a pole or an edge of its chart"
            )
        return (
            f"{self.aim.name}: {why}; tried {', '.join(map(str, counts))} "
            f"leg{'s' * (counts[-1] > 1)} from {starts} starts, of which the nearest ends "
            f"{self.nearest:.2g} (in sizes, rad) off"
        )

    def _same_curvature(self, part: float = 0.0) -> bool:
        """Whether K_1 = K_2 everywhere: rolling cannot reach all goals (theory section 11).

        part: greatest difference of two balls' radii, as a fraction of the object's.
        """
        finger, obj = self.aim.bodies
        balls = finger.chart.great_circles and obj.chart.great_circles
        near = abs(finger.size - obj.size) <= part * obj.size
        straight = finger.chart.lengths[1] and obj.chart.lengths[1]  # as on planes and cylinders
        flat = straight and bool((np.abs(self.aim.curvatures) < FLAT / self.aim.size**2).all())
        return (balls and near) or flat
