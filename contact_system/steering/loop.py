"""Closed paths that turn a finger, by holonomy (theory section 11)."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import finite_number
from ..errors import SceneError
from ..motion import FRAMES, Buffer, Motion
from ..scene import Scene, require_scene
from .goal import Goal, Route
from .reach import TOLERANCE, reach

SETTLED = 1e-11
"""Change, rad, of the areas that curves enclose at which their integrals have converged."""
MOST_PARTS = 2048
"""Parts of a leg, at most, over which they are integrated."""


def _gauss(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss nodes and weights on [0, 1], and the matrix from values to derivatives at the nodes."""
    legendre = np.polynomial.legendre
    x, weights = legendre.leggauss(n)
    series = np.linalg.inv(legendre.legvander(x, n - 1))
    slopes = [legendre.legval(x, legendre.legder(c)) for c in np.eye(n)]
    return (1 + x) / 2, weights / 2, 2 * np.transpose(slopes) @ series


_NODES, _WEIGHTS, _SLOPES = _gauss(40)


@dataclass(frozen=True)
class Loop(Route):
    """A route that returns to its start on both bodies.

    Attributes
    ----------
    angle : float
        Change of psi, rad, in (-pi, pi].
    enclosed : (float, float)
        Integrals of the Gaussian curvature over the areas that the curves enclose on finger and
        object, rad, positive for curves counterclockwise about the normal. They equal the areas
        that the normals enclose on the unit sphere, up to multiples of 4 pi.
    gauss_bonnet : float
        Difference between the change of psi and minus the sum of these, rad: 0 by Gauss and Bonnet.
    """

    angle: float
    enclosed: tuple[float, float]
    gauss_bonnet: float


def loop(scene: Scene, angle: float, *, contact: int = 0, seconds: float = 0.0) -> Loop:
    """Find a closed path that turns a finger in place, by rolling alone.

    Parameters
    ----------
    scene : Scene
        Where the contact starts, and returns to, on both bodies. Other contacts rest.
    angle : float
        Wanted change of psi, rad.
    contact : int
        Index of the contact.
    seconds : float
        Time for an optimiser to look for a shorter path, s.

    Raises
    ------
    SceneError
        No path is found, and why.
    """
    require_scene(scene)
    scene.contact_name(contact)  # raises for a wrong index
    angle, start = finite_number(angle, "angle"), scene.contacts[contact]
    if not abs(math.remainder(angle, 2 * math.pi)) > 1e-9:
        raise SceneError(f"angle = {angle!r}: that is no turn; give another one, in rad")
    wanted = math.remainder(start.angle + angle, 2 * math.pi)
    goal = Goal(object_at=start.object_at, finger_at=start.finger_at, angle=wanted)
    goals = [goal if i == contact else None for i in range(len(scene.contacts))]
    route = reach(scene, goals, seconds=seconds)
    turned, enclosed = _turns(route.scene, contact)
    off = abs(math.remainder(turned + sum(enclosed), 2 * math.pi))
    fields = {f.name: getattr(route, f.name) for f in dataclasses.fields(route)}
    return Loop(**fields, angle=turned, enclosed=enclosed, gauss_bonnet=off)


def _turns(scene: Scene, contact: int) -> tuple[float, tuple[float, float]]:
    """The change of psi, and the areas that the normals along both curves enclose."""
    motion, edges = Motion(scene, Buffer(scene, TOLERANCE, 0.0, None)), np.array(scene.edges)
    ends: Any = motion.evaluate(edges[[0, -1]], ("pose", FRAMES))
    first, last = ends["pose"][:, contact, :3, :3]
    p, q = ends[FRAMES][0, contact, 1, 3:9].reshape(2, 3)
    turned = last @ first.T @ p  # the finger turns by -psi about the object's normal
    parts, enclosed, change = 8, _enclosed(motion, contact, edges, 8), math.inf
    while change > SETTLED and parts < MOST_PARTS:  # normals turn fast over a flat body's rim
        parts, before = 2 * parts, enclosed
        enclosed = _enclosed(motion, contact, edges, parts)
        change = max(abs(math.remainder(a - b, 4 * math.pi)) for a, b in zip(enclosed, before))
    return -math.atan2(turned @ q, turned @ p), enclosed


def _enclosed(motion: Motion, contact: int, edges: np.ndarray, parts: int) -> tuple[float, float]:
    """The areas that the normals along both curves enclose, by so many parts of each leg."""
    legs = np.arange(len(edges))
    ends = np.interp(np.arange(parts * legs[-1] + 1) / parts, legs, edges)
    inner = (ends[:-1, None] + np.diff(ends)[:, None] * _NODES).ravel()
    results: Any = motion.evaluate(inner, (FRAMES,))
    frames = results[FRAMES][:, contact].reshape(len(ends) - 1, -1, 2, 12)
    normals = np.cross(frames[..., 3:6], frames[..., 6:9])
    return _area(normals[:, :, 0]), _area(normals[:, :, 1])


def _area(n: np.ndarray) -> float:
    """Area enclosed by a closed curve n of unit vectors, (intervals, 40, 3).

    The integral of z . (n x dn) / (1 + z . n), with a direction z whose opposite is far from n.
    """
    k = np.arange(60)
    across, around = 1 - (2 * k + 1) / 60, k * math.pi * (3 - math.sqrt(5))
    level = np.sqrt(1 - across**2)
    ways = np.stack([level * np.cos(around), level * np.sin(around), across], axis=1)
    z = ways[np.argmax((n.reshape(-1, 3) @ ways.T).min(axis=0))]
    swept = np.cross(n, _SLOPES @ n) @ z / (1 + n @ z)
    return math.remainder(float(_WEIGHTS @ swept.sum(axis=0)), 4 * math.pi)
