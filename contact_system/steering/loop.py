"""Closed paths that turn a finger, by holonomy (theory section 11)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import finite_number, naming
from ..errors import SceneError
from ..planning.motion import FRAMES, Motion
from ..scene import Scene, require_scene
from .goal import Goal, Route
from .reach import TOLERANCE, reach

SETTLED = 1e-9
"""Change of the enclosed areas, rad, at which sums have converged: each has about twice as many
digits as the one before."""
PARTS = [2**k for k in range(6, 17)]
"""Numbers of parts of a leg over which areas are summed, tried in this order."""
AXES = np.array([axis for axis in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(axis)])
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
"""Directions from a cube's centre to its faces, edges and corners. With those to its faces alone,
sums over 11 of 4575 loops through the holes of slim tori had not converged, up to 1.4 rad off."""


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
        ``angle`` plus the sum of ``enclosed``, without whole turns, as a positive number, rad: 0
        by the theorem of Gauss and Bonnet.
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
        No path is found; the text says why.
    """
    require_scene(scene)
    with naming(scene.title):
        scene.require_contact(contact)
    angle, start = finite_number(angle, "angle"), scene.contacts[contact]
    if not abs(math.remainder(angle, 2 * math.pi)) > 1e-9:
        raise SceneError(f"angle = {angle!r}: that is no turn; give another one, in rad")
    wanted = math.remainder(start.angle + angle, 2 * math.pi)
    goal = Goal(object_at=start.object_at, finger_at=start.finger_at, angle=wanted)
    goals = [goal if i == contact else None for i in range(len(scene.contacts))]
    route = reach(scene, goals, seconds=seconds)
    turned, enclosed = _turns(route.scene, contact)
    off = abs(math.remainder(turned + sum(enclosed), 2 * math.pi))
    return Loop(**vars(route), angle=turned, enclosed=enclosed, gauss_bonnet=off)


def _turns(scene: Scene, contact: int) -> tuple[float, tuple[float, float]]:
    """The change of psi, and the areas that the normals along both curves enclose."""
    motion = Motion(scene, TOLERANCE)
    ends: Any = motion.evaluate(np.array([0.0, scene.duration]), ("pose", FRAMES))
    first, last = ends["pose"][:, contact, :3, :3]
    p, q = ends[FRAMES][0, contact, 1, 3:9].reshape(2, 3)
    turned = last @ first.T @ p  # the finger turns by -psi about the object's normal
    return -math.atan2(turned @ q, turned @ p), _enclosed(motion, contact)


def _enclosed(motion: Motion, contact: int) -> tuple[float, float]:
    """The areas that the normals along both curves enclose on the unit sphere.

    They are sums over equal steps of a parameter x, twice as many each time. Such sums converge
    fast if the integrand begins and ends smoothly, so a leg's time is a smooth function of x.
    """
    areas = np.full(2, math.nan)
    for parts in PARTS:  # normals turn fast over a flat body's rim
        before, areas = areas, _areas(*_swept(motion, contact, parts)) / parts
        if np.abs(_wrapped(areas - before)).max() <= SETTLED:
            break
    finger, object_ = _wrapped(areas).tolist()
    return finger, object_


def _swept(motion: Motion, contact: int, parts: int) -> np.ndarray:
    """Normals n of finger and object in each part of each leg, and n x dn: (2, times, 2, 3).

    dn: the derivative of n by x, which goes from 0 to 1 on each leg.
    """
    turn = 2 * math.pi * np.arange(parts) / parts
    t, speeds = [], []
    for leg in motion.scene.way(contact):
        span = leg.stop - leg.start
        tau = span * (turn - np.sin(turn)) / (2 * math.pi)
        t.append(leg.start + tau)
        speeds.append(leg.profile(tau) * span * (1 - np.cos(turn)))
    results: Any = motion.evaluate(np.concatenate(t), (FRAMES, "carried"), gaps=True)
    frames, velocity = (results[name][:, contact] for name in (FRAMES, "carried"))
    p, q, k = frames[..., 3:6], frames[..., 6:9], frames[..., 9:]
    rates = np.concatenate(speeds)[:, None, None] * velocity[..., 1:]  # along p and q of each body
    turns = k[..., :2] * rates[..., :1] + k[..., 1:] * rates[..., 1:]
    return np.array([np.cross(p, q), turns[..., :1] * q - turns[..., 1:] * p])


def _areas(n: np.ndarray, swept: np.ndarray) -> np.ndarray:
    """Sums of z . (n x dn) / (1 + z . n), (2,), with an axis z for which -z is far from all n."""
    z = AXES[np.argmax((n @ AXES.T).min(axis=0), axis=-1)]
    up, over = np.einsum("tij,ij->ti", n, z), np.einsum("tij,ij->ti", swept, z)
    return (over / (1 + up)).sum(axis=0)


def _wrapped(area: np.ndarray) -> np.ndarray:
    """Areas up to multiples of 4 pi, in (-2 pi, 2 pi]."""
    return area - 4 * math.pi * np.rint(area / (4 * math.pi))
