"""Paths of several legs from a contact's start: where they end, and how the ends move with them.

A path is z = (phi_1, ..., phi_n, s_1, ..., s_n), directions from ``finger_velocity`` on and lengths
along s; a negative length runs backwards. Both kinds of paths give, for a goal, how far a path ends
from it (rows: places in sizes, angles in rad) and the exact derivatives of that.
"""

from __future__ import annotations

import cmath
import ctypes
import dataclasses
import math
from array import array
from ctypes import c_double
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..buffer import AT_CONTACTS, LEG, LEGS, TOLERATED, W1, Buffer, Y
from ..engine.binding import Steer, address, steer
from ..motion import FRAMES, Motion
from ..scene import ROLLING, Contact, Leg, Scene
from ..scene.contact import rolled, turned
from ..surfaces import Surface
from .jacobi import NODES, Array, fields, shifts

TOLERANCE, COARSE, NEAR = 1e-14, 1e-7, 1e-3
"""Of the size, to which paths are rolled; the second where they end farther off than the third."""


class Region(NamedTuple):
    """Places of a body, 0 or 1, around a point: paths aim to stay within the radius, m, and must
    within the widest."""

    side: int
    centre: Array
    radius: float
    widest: float


@dataclass
class Aim:
    """A contact's goal in numbers.

    Attributes
    ----------
    contact : Contact
        Where it starts.
    bodies : (Surface, Surface)
        Finger and object.
    sides : tuple of int
        The bodies on which a place is wanted, 0 and 1.
    start, goal : ((3,), (3, 3)) for each body
        Point and contact frame.
    angles : (float, float)
        psi at the start and at the goal.
    pose : (4, 4) or None
        That of the finger at the goal, where its rotation matters.
    is_pose : bool
        Whether it was given, and its place matters too.
    regions : list of Region
        Where it is to stay.
    """

    contact: Contact
    bodies: tuple[Surface, Surface]
    sides: tuple[int, ...]
    start: list[tuple[Array, Array]]
    goal: list[tuple[Array, Array]]
    angles: tuple[float, float]
    pose: Array | None
    is_pose: bool
    regions: list[Region]

    def __post_init__(self) -> None:
        w: Any = self.contact.finger_velocity
        self.pace, self.lean = math.hypot(*w), math.atan2(w[1], w[0])
        self.sizes = [body.size for body in self.bodies]
        self.turned = self.pose is not None and not self.is_pose

    @property
    def in_closed_form(self) -> bool:
        """Whether `ClosedPaths` will do."""
        return (
            self.contact.object_velocity == ROLLING
            and not self.is_pose
            and not self.regions
            and all(
                body.great_circles or (body.developable and body.periods() == (None, None))
                for body in self.bodies
            )
        )

    def moves(self, phi: Array, along: Array) -> Array:
        """`shifts` of both bodies for directions and lengths of a path, along (2, n, 4)."""
        own, n = phi + self.lean, len(phi)
        found = shifts(np.array([own, -own - self.angles[0]]), along)  # W_2 = R_psi W_1
        found[1, :n] *= -1.0
        found[:, n:] *= self.pace
        return found


# --- spheres and planes ------------------------------------------------------------------------


class ClosedPaths:
    """Rolling on spheres and planes, in closed form."""

    def __init__(self, aim: Aim, n: int):
        self.aim, self.n, sides = aim, n, (0, 1)
        self.curvatures = [b.size**-2 if b.great_circles else 0.0 for b in aim.bodies]
        self.back = [self._from_goal(side) for side in sides]
        self.data = Steer(
            tuple(self.curvatures),
            tuple(aim.sizes),
            tuple((c_double * 4)(*back) for back in self.back),
            *(aim.angles[0], aim.angles[1] - aim.angles[0], aim.lean, aim.pace),
            tuple(side in aim.sides for side in sides),
            aim.turned,
        )
        rows = 2 * len(aim.sides) + 2 * aim.turned
        self._off, self._slopes = np.empty(rows), np.empty((rows, 2 * n))

    def off(self, z: Array) -> tuple[Array, Array]:
        """How far a path ends from the goal (rows), and the derivatives of that (rows, 2 n)."""
        off, slopes = self._off.copy(), self._slopes.copy()
        steer(ctypes.addressof(self.data), self.n, address(z), address(off), address(slopes))
        return off, slopes

    def _from_goal(self, side: int) -> list[float]:
        """The motion from the goal's frame back to the start's, as real and imaginary parts."""
        aim = self.aim
        (x0, frame0), (x1, frame1) = aim.start[side], aim.goal[side]
        if not self.curvatures[side]:
            turn = frame0.T @ frame1
            a = cmath.sqrt(complex(turn[0, 0], turn[1, 0]))
            x, y, _ = (frame0.T @ (x1 - x0)).tolist()
            b = complex(x, y) / (2 * a)
            return [a.real, -a.imag, -b.real, -b.imag]
        mirror = np.array([1.0, 1.0, aim.bodies[side].sign])  # p, q and x: left-handed in a bowl
        w, x, y, z = _quaternion((frame0 * mirror).T @ (frame1 * mirror))
        r = aim.sizes[side]
        return [w, -z, -y * r, x * r]


def _quaternion(turn: Array) -> list[float]:
    """w, x, y, z of a rotation, from the greatest of them."""
    (a, d, e), (f, b, g), (h, i, c) = turn.tolist()
    rows = (
        (1 + a + b + c, i - g, e - h, f - d),
        (i - g, 1 + a - b - c, d + f, e + h),
        (e - h, d + f, 1 - a + b - c, g + i),
        (f - d, e + h, g + i, 1 - a - b + c),
    )
    row = max(range(4), key=lambda k: rows[k][k])
    norm = math.hypot(*rows[row])
    return [x / norm for x in rows[row]]


# --- every surface -----------------------------------------------------------------------------


def _parts_of_time() -> Array:
    """When a contact passes the nodes of a leg from rest to rest, in parts of the leg's time."""
    low, high = np.zeros(16), np.ones(16)
    for _ in range(60):
        x = (low + high) / 2
        beyond = x**3 * (10 + x * (6 * x - 15)) > NODES
        low, high = np.where(beyond, low, x), np.where(beyond, x, high)
    return low


_PARTS = np.append(_parts_of_time(), 1.0)
_PLACES = np.append(NODES, 1.0)


class RolledPaths:
    """Rolling by the engine: any surface, slip, goals that are poses, regions to stay within.

    The derivatives are exact but where a contact slips: they leave out how slip bends a path.
    """

    def __init__(self, aim: Aim, n: int, scene: Scene):
        self.aim, self.n = aim, n
        legs = [Leg(0.0, 1.0, scene.duration / n) for _ in range(n)]
        moving = dataclasses.replace(aim.contact, legs=legs)
        self.scene = scene.replace(contacts=[moving], disturbances=[], turning=None)
        self.buffer = Buffer(self.scene, TOLERANCE, 0.0, None)
        self.numbers = array("d", self.buffer.numbers)
        self.row = int(self.numbers[AT_CONTACTS])
        self.legs = int(self.numbers[self.row + LEGS])
        first, count = (int(x) for x in self.numbers[self.legs + 1 : self.legs + 3])
        self.sigma = self.numbers[first : first + count]
        self.times = np.add.outer(np.arange(n), _PARTS).ravel() * (scene.duration / n)
        self.times[-1] = scene.duration
        c, s = math.cos(aim.angles[0]), math.sin(aim.angles[0])
        self.joint = np.array([[c, -s, 0.0], [-s, -c, 0.0], [0.0, 0.0, -1.0]])

    def off(self, z: Array) -> tuple[Array, Array]:
        """How far a path ends from the goal (rows), and the derivatives of that (rows, 2 n)."""
        self._write(z[: self.n].tolist(), z[self.n :].tolist())
        off, slopes = self._rolled(z)
        near = float(off @ off) < NEAR**2
        if near and self.numbers[TOLERATED] > TOLERANCE:
            self._tolerate(TOLERANCE)
            off, slopes = self._rolled(z)
        elif not near:
            self._tolerate(COARSE)
        return off, slopes

    def _tolerate(self, tolerance: float) -> None:
        self.numbers[TOLERATED] = tolerance
        self.buffer.numbers = self.numbers.tobytes()

    def _rolled(self, z: Array) -> tuple[Array, Array]:
        aim, n = self.aim, self.n
        found: Any = Motion(self.scene, self.buffer).evaluate(self.times, (FRAMES,))
        frames = found[FRAMES].reshape(n, 17, 2, 12).transpose(2, 0, 1, 3)  # side, leg, place
        form = frames[:, :, :16, 9:]
        curvature = form[..., 0] * form[..., 2] - form[..., 1] ** 2
        passed = fields(curvature, np.array([z[n:], z[n:]]) * aim.pace)
        moves, ends = aim.moves(z[:n], passed[:, :, 16]), frames[:, -1, 16]
        space = (moves[:, :, :2] @ ends[:, 3:9].reshape(2, 2, 3)).transpose(0, 2, 1)
        offs, slopes = [], []
        for side in aim.sides:
            offs.append((ends[side, :3] - aim.goal[side][0]) / aim.sizes[side])
            slopes.append(space[side] / aim.sizes[side])
        if aim.pose is not None:
            self._add_pose(ends, moves, space, offs, slopes)
        for region in aim.regions:
            self._add_outside(z, frames, passed, region, offs, slopes)
        return np.concatenate(offs), np.concatenate(slopes)

    def _write(self, phi: list[float], lengths: list[float]) -> None:
        """A path into the buffer."""
        numbers, aim, last = self.numbers, self.aim, 0.0
        for k, (way, s) in enumerate(zip(phi, lengths)):
            way, s = (way + math.pi, -s) if s < 0 else (way, s)
            leg = self.legs + k * LEG
            at = int(numbers[leg + 1])
            numbers[at : at + len(self.sigma)] = array("d", [c * s for c in self.sigma])
            turn = way - last if k else 0.0
            numbers[leg + LEG - 2], numbers[leg + LEG - 1] = math.cos(turn), math.sin(turn)
            if not k:
                given: Any = aim.contact.finger_velocity
                own = turned(math.cos(way), math.sin(way), given)
                numbers[self.row + W1], numbers[self.row + W1 + 1] = own
                if aim.contact.object_velocity == ROLLING:
                    other = rolled(aim.contact.angle, own)
                    numbers[self.row + Y], numbers[self.row + Y + 1] = other
            last = way
        self.buffer.numbers = numbers.tobytes()

    def _add_pose(
        self, ends: Array, moves: Array, space: Array, offs: list[Array], slopes: list[Array]
    ) -> None:
        """The finger's rotation against the goal's and, of a pose, its origin in sizes."""
        goal: Any = self.aim.pose
        axes = [_axes(*end[3:9].tolist()) for end in ends]
        turns = [_turns(end[9:], move) for end, move in zip(ends, moves)]
        rotation = axes[1] @ self.joint @ axes[0].T
        slope = axes[1] @ (turns[1] @ self.joint - self.joint @ turns[0]) @ axes[0].T  # (2 n, 3, 3)
        offs.append((rotation - goal[:3, :3]).ravel())
        slopes.append(slope.reshape(-1, 9).T)
        if self.aim.is_pose:
            size = max(self.aim.sizes)
            offs.append((ends[1, :3] - rotation @ ends[0, :3] - goal[:3, 3]) / size)
            slopes.append((space[1] - rotation @ space[0] - (slope @ ends[0, :3]).T) / size)

    def _add_outside(
        self,
        z: Array,
        frames: Array,
        passed: Array,
        region: Region,
        offs: list[Array],
        slopes: list[Array],
    ) -> None:
        """How far each leg leaves a region, where it does so most, in radii."""
        n, (side, centre, radius, _) = self.n, region
        aside = frames[side, :, :, :3] - centre
        away = np.linalg.norm(aside, axis=-1)
        worst = away.argmax(axis=1)
        off, slope = np.zeros(n), np.zeros((n, 2 * n))
        for k in np.flatnonzero(away.max(axis=1) > radius).tolist():
            i = int(worst[k])
            along = np.concatenate([passed[:, :k, 16], passed[:, k : k + 1, i]], axis=1)
            move = self.aim.moves(z[: k + 1], along)[side]
            move[k + 1 + k] *= _PLACES[i]  # the place lies at this part of the last leg
            outward = frames[side, k, i, 3:9].reshape(2, 3) @ (aside[k, i] / away[k, i] / radius)
            off[k] = away[k, i] / radius - 1.0
            slope[k, : k + 1], slope[k, n : n + k + 1] = np.split(move[:, :2] @ outward, 2)
        offs.append(off)
        slopes.append(slope)


def _axes(a: float, b: float, c: float, d: float, e: float, f: float) -> Array:
    """p, q and their normal as columns."""
    return np.array([[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]])


def _turns(form: Array, move: Array) -> Array:
    """How p, q and n turn in their own frame for each move, (m, 3, 3): by K the normal."""
    found = np.zeros((len(move), 3, 3))
    tilt = move[:, :2] @ np.array([[form[0], form[1]], [form[1], form[2]]])
    found[:, 1, 0], found[:, 0, 1] = move[:, 2], -move[:, 2]
    found[:, :2, 2], found[:, 2, :2] = tilt, -tilt
    return found
