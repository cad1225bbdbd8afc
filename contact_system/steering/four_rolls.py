"""A sphere on a plane in four rolls: two turn it, two of whole revolutions move it.

After Hammersley, "Oxford commemoration ball" (1983); the two turning rolls are chosen to make the
path short. Its length bounds that of a route.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from ..surfaces.plane import is_plane
from .aim import Aim
from .shooting import Array


def four_rolls(aim: Aim, below: float) -> Array | None:
    """The path z of four legs (see `Aim.search`) to places on both bodies and an angle.

    None for other goals, and if the path is not shorter than ``below``, m along s.
    """
    pairs = zip(aim.bodies, reversed(aim.bodies))
    kinds = [body.chart.great_circles and is_plane(other) for body, other in pairs]
    if not any(kinds) or not aim.has_rotation or aim.is_pose:
        return None
    ball, plane = kinds.index(True), kinds.index(False)
    r, psi = aim.sizes[ball], aim.psi
    if below <= max(4 * math.pi * r / aim.w_length, aim.far):
        return None
    # the ball's turn includes the change of psi, as rolling does not turn the plane's frame
    (a, b), (turned, moved) = _turn_of_ball(aim, ball), _move_on_plane(aim, plane)
    half = cmath.rect(1.0, 0.5 * (psi - aim.goal_psi)) * turned
    a, b, wanted = a * half, b * half.conjugate() / r, 2 * turned * moved
    first = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 361)  # directions of the first roll
    unit = np.exp(1j * first)
    s1 = np.arctan2(-a.imag, (unit * b.conjugate()).imag)  # half its angle; one roll, s2, is left
    s1 -= math.pi * np.round(s1 / math.pi)
    real = (np.cos(s1) * a + np.sin(s1) * unit * b.conjugate()).real
    rest = (np.cos(s1) * b - np.sin(s1) * unit * a.conjugate()) * np.where(real < 0, -1.0, 1.0)
    s2, second = np.arctan2(np.abs(rest), np.abs(real)), np.angle(rest)
    rolled = cmath.rect(2 * r, -psi) * (s1 / unit + s2 * np.exp(-1j * second))
    left = wanted - rolled
    revolutions = np.ceil(np.abs(left) / (4 * math.pi * r))
    k = int(np.argmin(np.abs(s1) + s2 + 2 * math.pi * revolutions))

    whole = 2 * math.pi * r * float(revolutions[k])  # length of each of the last two rolls
    open_by = math.acos(min(1.0, abs(left[k]) / (2 * whole))) if whole else 0.0
    ahead = -psi - cmath.phase(left[k])
    headings = np.array([first[k], second[k], ahead - open_by, ahead + open_by])
    lengths = np.array([2 * r * s1[k], 2 * r * s2[k], whole, whole])
    if np.abs(lengths).sum() >= below * aim.w_length:
        return None
    directions = headings if ball == 0 else -psi - headings
    return np.concatenate([directions - aim.w_angle, lengths / aim.w_length])


def _move_on_plane(aim: Aim, side: int) -> tuple[complex, complex]:
    """The motion (a, b) from start to goal: a turn by 2 arg a, and a shift by 2 a b."""
    (x0, frame0), (x1, frame1) = aim.start[side], aim.goal[side]
    turn = frame0.T @ frame1
    a = cmath.sqrt(complex(turn[0, 0], turn[1, 0]))
    x, y, _ = (frame0.T @ (x1 - x0)).tolist()
    return a, complex(x, y) / (2 * a)


def _turn_of_ball(aim: Aim, side: int) -> tuple[complex, complex]:
    """The rotation from start to goal: the halves of a quaternion, one times the radius."""
    (_, frame0), (_, frame1) = aim.start[side], aim.goal[side]
    mirror = np.array([1.0, 1.0, aim.bodies[side].sign])  # p, q and x: left-handed in a bowl
    turn = (frame0 * mirror).T @ (frame1 * mirror)
    # to a quaternion by Bar-Itzhack (2000), as scipy's takes 0.3 s to import
    trace, odd = np.trace(turn), turn - turn.T
    axis = [odd[2, 1], odd[0, 2], odd[1, 0]]
    k = np.block([[turn + turn.T - trace * np.eye(3), np.c_[axis]], [np.r_[axis, trace]]])
    x, y, z, w = np.linalg.eigh(k)[1][:, -1].tolist()
    return complex(w, z), aim.sizes[side] * complex(y, -x)
