"""From a start to a goal: legs that take a contact there (theory section 11).

Rolling has two inputs and five coordinates, a point on each body and psi. Legs are found by the
method of Gauss and Newton with damping, from many starts; every path is rolled by the engine.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .buffer import AT_CONTACTS, COUNT, LEG, LEGS, W1, Buffer, Y
from .checks import finite_number, real_array
from .errors import SceneError
from .motion import Motion
from .plan import plan
from .scene import ROLLING, STILL, Contact, Leg, Scene, require_scene
from .scene.contact import pair, rolled, turned
from .theory.profile import Profile

Array = np.ndarray

TOLERANCE = 1e-14
"""Of the size, to which paths are rolled while legs are looked for."""
REACHED = 1e-12
"""A goal is reached where nothing is farther off: places in sizes of the bodies, angles in rad."""
MOST_LEGS = 4
STARTS = 60
"""So many starts are tried with each number of legs."""
_STEPS, _SHIFT = 40, 1e-7


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Where a contact is to arrive; what is left out may come out as it likes.

    Parameters
    ----------
    object_at, finger_at : (float, float), optional
        Chart coordinates (u, v) of the contact on the object and on the finger.
    angle : float, optional
        psi between the frames there [rad]; with both places.
    pose : (4, 4), optional
        In the place of all these: the finger's frame in the object's, a homogeneous matrix, m.

    Raises
    ------
    SceneError
        Naming the key, the value and the remedy.
    """

    object_at: tuple[float, float] | None = None
    finger_at: tuple[float, float] | None = None
    angle: float | None = None
    pose: Any = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        for key in ("object_at", "finger_at"):
            if getattr(self, key) is not None:
                put(self, key, pair(getattr(self, key), key))
        if self.angle is not None:
            put(self, "angle", finite_number(self.angle, "angle"))
        places = self.object_at is not None, self.finger_at is not None
        if self.pose is not None:
            if any(places) or self.angle is not None:
                raise SceneError("pose: give a pose or places and an angle, not both")
            put(self, "pose", _pose(self.pose))
        elif not any(places):
            raise SceneError("a goal needs a place on a body: object_at, finger_at or a pose")
        elif self.angle is not None and not all(places):
            raise SceneError("angle: it is that between two frames; give both places with it")


def _pose(given: Any) -> Array:
    try:
        found = real_array(given)
    except (TypeError, ValueError, OverflowError):
        found = np.empty(0)
    if found.shape != (4, 4) or not np.isfinite(found).all():
        raise SceneError(f"pose = {given!r:.80}: give a homogeneous matrix, shape (4, 4)")
    turn = found[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-9 or np.linalg.det(turn) < 0:
        raise SceneError("pose: its first three rows and columns are no rotation")
    return found


@dataclass(frozen=True)
class Route:
    """Legs that reach a goal.

    Attributes
    ----------
    scene : Scene
        The scene with these legs, for :func:`plan`.
    legs : tuple of tuple of Leg
        Of each contact.
    length : float
        Of all legs of all contacts, along s, m.
    residual : float
        How far off the goals the contacts arrive: places in sizes of the bodies, angles in rad.
    tried : str
        With how many legs, from how many starts.
    """

    scene: Scene
    legs: tuple[tuple[Leg, ...], ...]
    length: float
    residual: float
    tried: str


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
        So long an optimiser may look for a shorter route; 0: the first that is found.

    Raises
    ------
    SceneError
        What cannot be reached, and why.

    Notes
    -----
    A sphere on a plane needs three legs at most; see theory section 11.
    """
    require_scene(scene)
    goals = [goal] if isinstance(goal, Goal) else list(goal)
    for own in goals:
        if not (own is None or isinstance(own, Goal)):
            raise SceneError(f"goal = {own!r:.80}: give a Goal, or None where a contact rests")
    if len(goals) != len(scene.contacts):
        raise SceneError(
            f"{scene.title}: {len(goals)} goals for {len(scene.contacts)} contacts; give one each, "
            "None where a contact rests"
        )
    if legs is not None and legs not in range(1, MOST_LEGS + 1):
        raise SceneError(f"legs = {legs!r}: give a number from 1 to {MOST_LEGS}")
    found: list[tuple[Leg, ...]] = []
    told, off = [], 0.0
    for i, own in enumerate(goals):
        if own is None:
            found.append((Leg(0.0, 0.0, scene.duration),))
            continue
        search = _Search(scene, i, own, longest)
        way, tried = search.shortest(legs, seconds / len(goals))
        found.append(way.legs())
        told.append(f"contact {i}: {tried}")
        off = max(off, way.residual)
    contacts = [dataclasses.replace(c, legs=own) for c, own in zip(scene.contacts, found)]
    whole = sum(leg.length or 0.0 for own in found for leg in own)
    legged = scene.replace(contacts=contacts, profile=STILL)
    return Route(legged, tuple(found), whole, off, "; ".join(told))


# --- one contact -------------------------------------------------------------------------------


class _Rolls:
    """Paths of n legs from a contact's start, many at once."""

    def __init__(self, scene: Scene, contact: Contact, n: int):
        legs = [Leg(0.0, 1.0, scene.duration / n) for _ in range(n)]
        alone = scene.replace(
            contacts=[dataclasses.replace(contact, legs=legs)], disturbances=[], turning=None
        )
        self.n, self.contact = n, contact
        self._scene = alone
        self._buffer = Buffer(alone, TOLERANCE, 0.0, None)
        numbers = np.frombuffer(self._buffer.numbers)
        at = int(numbers[AT_CONTACTS])
        self._head, self._row = numbers[:at].copy(), numbers[at:].copy()
        first = int(self._row[LEGS])
        self._legs = numbers[first : first + n * LEG].reshape(n, LEG).copy()
        places = [slice(int(leg[1]), int(leg[1] + leg[2])) for leg in self._legs]
        self._sigma = np.stack([numbers[place] for place in places])

    def ends(self, z: Array) -> tuple[Array, Array]:
        """Contact points (m, 2, 3) and poses (m, 4, 4) at the end of paths z (m, 2 n)."""
        buffer = copy.copy(self._buffer)
        buffer.count, buffer.numbers = len(z), self._numbers(*np.split(z, 2, axis=1)).tobytes()
        end = np.array([self._scene.duration])
        found: Any = Motion(self._scene, buffer).evaluate(end, ("points", "pose"))
        return found["points"][0], found["pose"][0]

    def _numbers(self, phi: Array, s: Array) -> Array:
        """The buffer of many contacts that differ in their legs alone."""
        m, n = s.shape
        phi, s = np.where(s < 0, phi + math.pi, phi), np.abs(s)
        size = self._sigma.shape[1]
        legs = np.repeat(self._legs[None], m, axis=0)
        offset = len(self._head) + np.arange(m) * n * (size + LEG)
        legs[:, :, 1] = offset[:, None] + np.arange(n) * size
        turn = np.diff(phi, axis=1, prepend=phi[:, :1])
        legs[:, :, 5], legs[:, :, 6] = np.cos(turn), np.sin(turn)
        sigma = self._sigma * s[..., None]
        blocks = np.hstack([sigma.reshape(m, -1), legs.reshape(m, -1)])
        rows = np.repeat(self._row[None], m, axis=0)
        rows[:, LEGS] = offset + n * size
        given: Any = self.contact.finger_velocity
        own = turned(np.cos(phi[:, 0]), np.sin(phi[:, 0]), given)
        rows[:, W1], rows[:, W1 + 1] = own
        if self.contact.object_velocity == ROLLING:
            rows[:, Y], rows[:, Y + 1] = rolled(self.contact.angle, own)
        head = self._head.copy()
        head[COUNT], head[AT_CONTACTS] = m, len(head) + blocks.size
        return np.concatenate([head, blocks.ravel(), rows.ravel()])


@dataclass
class _Way:
    """Legs that were found: directions and lengths z (2 n), and how far off they end."""

    z: Array
    residual: float
    seconds: float  # of each leg

    def legs(self) -> tuple[Leg, ...]:
        phi, s = np.split(self.z, 2)
        phi = np.where(s < 0, phi + math.pi, phi)
        ways = zip(np.remainder(phi, 2 * math.pi).tolist(), np.abs(s).tolist())
        return tuple(Leg(direction, length, self.seconds) for direction, length in ways)

    @property
    def length(self) -> float:
        return float(np.abs(np.split(self.z, 2)[1]).sum())


class _Search:
    """The legs that take one contact to its goal."""

    def __init__(self, scene: Scene, index: int, goal: Goal, longest: float | None):
        self.scene, self.contact, self.goal = scene, scene.contacts[index], goal
        self.name, self.longest = f"{scene.title}, contact {index}", longest
        if self.contact.follows:
            raise SceneError(
                f'{self.name}: finger_velocity = "rolling" has no legs; give it as two numbers'
            )
        self.bodies = self.contact.finger, scene.object
        self.sizes = np.array([body.size for body in self.bodies])
        here, there, pose = self._touching(self.contact)[0], *self._touching(self._arrived())
        given = goal.finger_at is not None, goal.object_at is not None
        self.points = [(side, there[side]) for side in (0, 1) if given[side]]
        self.pose = pose if goal.angle is not None else goal.pose
        wanted = 2 * len(self.points) if self.pose is None else 5
        self.fewest = (wanted + 1) // 2
        self.unit = float(self.sizes.min())
        self.far = max((float(np.linalg.norm(x - here[k])) for k, x in self.points), default=0.0)

    def _arrived(self) -> Contact:
        """The contact as it is at the goal; what that leaves out is as at the start."""
        names = ("object_at", "finger_at", "angle")
        given = {key: value for key in names if (value := getattr(self.goal, key)) is not None}
        return dataclasses.replace(self.contact, legs=(), **given)

    def _touching(self, contact: Contact) -> tuple[Array, Array]:
        """Contact points (2, 3) and the finger's pose (4, 4)."""
        alone = self.scene.replace(contacts=[contact], disturbances=[], profile=Profile([1.0]))
        found = plan(alone).evaluate(0.0, "points", "pose")
        return found["points"][0, 0], found["pose"][0, 0]

    def off(self, rolls: _Rolls, z: Array) -> Array:
        """How far the ends of paths are from the goal, (m, k): in sizes and of rotations."""
        points, poses = rolls.ends(z)
        parts = [(points[:, side] - point) / self.sizes[side] for side, point in self.points]
        if self.pose is not None:
            parts.append((poses[:, :3, :3] - self.pose[:3, :3]).reshape(len(poses), 9))
            if self.goal.pose is not None:
                parts.append((poses[:, :3, 3] - self.pose[:3, 3]) / self.sizes.max())
        if self.longest is not None:
            parts.append(np.maximum(np.abs(z[:, rolls.n :]) / self.longest - 1.0, 0.0))
        return np.hstack(parts)

    def shortest(self, legs: int | None, seconds: float) -> tuple[_Way, str]:
        """The first route with the least number of legs; then the shortest found in the time."""
        begin, tried = time.perf_counter(), []
        counts = range(self.fewest, MOST_LEGS + 1) if legs is None else (legs,)
        nearest = math.inf
        for n in counts:
            rolls = _Rolls(self.scene, self.contact, n)
            rng = np.random.default_rng(n)
            for k in range(STARTS):
                way = self._newton(rolls, self._guess(rng, n))
                nearest = min(nearest, way.residual)
                if way.residual <= REACHED:
                    told = f"{n} legs, start {k + 1}"
                    return self._shorter(rolls, way, rng, begin + seconds), told
            tried.append(f"{n} legs from {STARTS} starts")
        raise SceneError(self._refusal(tried, nearest))

    def _guess(self, rng: np.random.Generator, n: int) -> Array:
        phi = rng.uniform(-math.pi, math.pi, n)
        return np.concatenate([phi, self.unit * rng.uniform(0.3, 2.0, n) + self.far / n])

    def _newton(self, rolls: _Rolls, z: Array) -> _Way:
        """Gauss and Newton's method with Levenberg's damping, derivatives by differences."""
        n = len(z)
        unit = np.repeat([1.0, self.unit], n // 2)
        damping, best, mark, model = 1e-2, math.inf, math.inf, None
        tried = z
        for k in range(_STEPS):
            if k % 6 == 5:  # starts that only creep are given up
                if best > 0.25 * mark:
                    break
                mark = best
            shifted = tried + _SHIFT * unit * np.vstack([np.zeros(n), np.eye(n)])
            off, *others = self.off(rolls, shifted)
            if off @ off < best:
                z, best, damping = tried, off @ off, 0.1 * damping
                left, values, right = np.linalg.svd((others - off).T / _SHIFT, full_matrices=False)
                model = left.T @ off, values, right
                if best < (0.1 * REACHED) ** 2:
                    break
            else:
                damping *= 10.0
            assert model is not None
            off, values, right = model
            step = right.T @ (values / (values**2 + damping) * off)
            tried = z - unit * step * min(1.0, 1.5 / max(np.abs(step).max(), 1e-300))
        return _Way(z, math.sqrt(best), self.scene.duration / rolls.n)

    def _shorter(self, rolls: _Rolls, way: _Way, rng: np.random.Generator, until: float) -> _Way:
        """The shortest of the routes from other starts, until a time."""
        while time.perf_counter() < until:
            other = self._newton(rolls, self._guess(rng, rolls.n))
            if other.residual <= REACHED and other.length < way.length:
                way = other
        return way

    def _refusal(self, tried: Sequence[str], nearest: float) -> str:
        why = "no path was found that arrives there"
        if self._alike():
            why = (
                "the finger and the object have the same curvature everywhere, so that a place on "
                "one body sets the place on the other, and the angle"
            )
        elif self.goal.pose is not None:
            why += "; do the bodies touch in that pose, from outside?"
        return (
            f"{self.name}: {why}; tried {', '.join(tried)}, of which the nearest ends "
            f"{nearest:.2g} (in sizes, rad) off"
        )

    def _alike(self) -> bool:
        """Whether rolling keeps a relation between the places: K_1 = K_2 (theory section 11)."""
        one, other = self.bodies
        balls = one.great_circles and other.great_circles
        return (balls and one.size == other.size) or (one.developable and other.developable)
