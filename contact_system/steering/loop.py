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

SETTLED = 1e-12
"""Change, rad, of the areas that curves enclose at which their extrapolation has converged."""
MOST_PARTS = 65536
"""Sides of the polygons, at most, that stand for the curves of a leg."""


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
    return -math.atan2(turned @ q, turned @ p), _enclosed(motion, contact, edges)


def _enclosed(motion: Motion, contact: int, edges: np.ndarray) -> tuple[float, float]:
    """The areas that the normals along both curves enclose on the unit sphere.

    Areas of polygons with twice as many sides each time are extrapolated (Romberg's method).
    """
    parts, change = 16, math.inf
    row = [_areas(motion, contact, edges, parts)]
    while change > SETTLED and parts < MOST_PARTS:  # normals turn fast over a flat body's rim
        parts, before = 2 * parts, row
        row = [_areas(motion, contact, edges, parts)]
        for k, coarser in enumerate(before, 1):
            row.append(row[-1] + _wrapped(row[-1] - coarser) / (4**k - 1))
        change = np.abs(_wrapped(row[-1] - before[-1])).max()
    finger, object_ = _wrapped(row[-1]).tolist()
    return finger, object_


def _areas(motion: Motion, contact: int, edges: np.ndarray, parts: int) -> np.ndarray:
    """Areas of the spherical polygons of the normals, with so many sides for each leg, (2,)."""
    legs = np.arange(len(edges))
    t = np.interp(np.arange(parts * legs[-1]) / parts, legs, edges)
    results: Any = motion.evaluate(t, (FRAMES,))
    frames = results[FRAMES][:, contact]
    n = np.cross(frames[..., 3:6], frames[..., 6:9])
    following = np.roll(n, -1, axis=0)
    # triangles from a direction whose opposite is far from the normals
    axes = np.vstack([np.eye(3), -np.eye(3)])
    z = axes[np.argmax((n @ axes.T).min(axis=0), axis=-1)]
    volume = np.einsum("kij,ij->ki", np.cross(n, following), z)
    cosines = np.einsum("kij,ij->ki", n + following, z) + (n * following).sum(axis=-1)
    return 2 * np.arctan2(volume, 1 + cosines).sum(axis=0)


def _wrapped(area: np.ndarray) -> np.ndarray:
    """Areas up to multiples of 4 pi, in (-2 pi, 2 pi]."""
    return area - 4 * math.pi * np.rint(area / (4 * math.pi))
