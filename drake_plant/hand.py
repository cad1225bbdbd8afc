"""A hand: fingers as serial chains, the project's own three-jointed one or any model by file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contact_system import SceneError
from contact_system.checks import finite_number, finite_numbers

Array = NDArray[np.float64]

LINKS = (0.055, 0.045, 0.035)  # m, of the project's own fingers
MASSES = (0.035, 0.03, 0.02)  # kg
LOWER, UPPER = (-0.8, -1.7, 0.0, -0.3), (0.8, 0.6, 2.2, 1.7)  # rad
TORQUE = 0.7  # N m, of every joint
ROTOR = 2e-4  # kg m^2, of a motor behind its gear
DAMPING = 0.01  # N m s
PALM = 0.05  # m, from the palm's middle to where a finger begins


@dataclass
class Hand:
    """Fingers on joints, one for each contact of a scene, whose surface its fingertip has.

    Parameters
    ----------
    model : str
        An SDF, URDF or MJCF file; "": the project's own hand, whose fingers stand around a palm
        where the scene's contacts are. Each has a joint that swings it sideways and three that curl
        it.
    tips : list of str
        The model's frames that carry fingertips, in the order of the contacts; the origin of a
        fingertip's surface is put there.
    base : list of float
        Where the model's root is in the world, m, at the scene's start; the object is at the
        origin.
    pad : float
        How far from the middle of its pad, the scene's ``finger_at``, a fingertip may touch, m.
    """

    model: str = ""
    tips: list[str] = field(default_factory=list)
    base: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.11])
    pad: float = 0.02

    def check(self, contacts: int) -> None:
        """Raise a SceneError that names the first field that is wrong, its value and the remedy."""
        if not isinstance(self.model, str):
            raise SceneError(f'hand: model = {self.model!r}: give a file, or "" for the own hand')
        if len(finite_numbers(self.base, "hand: base")) != 3:
            raise SceneError(f"hand: base = {self.base!r}: give three numbers, m")
        finite_number(self.pad, "hand: pad", "above 0")
        if isinstance(self.tips, str) or not isinstance(self.tips, Sequence):
            raise SceneError(f"hand: tips = {self.tips!r}: give a list of the model's frames")
        wanted = contacts if self.model else 0
        if len(self.tips) != wanted:
            raise SceneError(
                f"hand: tips = {self.tips!r}: give {wanted} names"
                + (", a frame for each contact" if self.model else " for the project's own hand")
            )


def own_hand(azimuths: Sequence[float]) -> str:
    """SDF of the project's own hand: a finger at each azimuth about the palm's z axis, rad.

    Frames ``tip_0`` and so on have z along the last link and x, where a pad is by default, to the
    side to which the finger curls. The fingers of a hand that is at its zeros stand up.
    """
    parts = [_link("palm", None, (0.0, 0.0, 0.0), 0.2, (PALM, 0.01))]
    for i, azimuth in enumerate(azimuths):
        root = (PALM * math.cos(azimuth), PALM * math.sin(azimuth), 0.0)
        parent, placed, lengths = "palm", (*root, azimuth), (0.0, *LINKS)
        for k, length in enumerate(lengths):
            name, mass = f"finger_{i}_link_{k}", MASSES[k - 1] if k else 0.01
            parts.append(
                _link(name, (parent, *placed), (0.0, 0.0, length / 2), mass, (0.008, length))
            )
            axis = "1 0 0" if k == 0 else "0 -1 0"
            parts.append(_joint(f"finger_{i}_joint_{k}", parent, name, axis, LOWER[k], UPPER[k]))
            parent, placed = name, (0.0, 0.0, length, 0.0)
        parts.append(
            f'<frame name="tip_{i}" attached_to="{parent}">'
            f'<pose relative_to="{parent}">0 0 {LINKS[-1]} 0 0 {math.pi}</pose></frame>'
        )
    body = "\n".join(parts)
    return f'<sdf version="1.9"><model name="hand">\n{body}\n</model></sdf>'


def _link(
    name: str,
    placed: tuple | None,
    centre: tuple[float, float, float],
    mass: float,
    shape: tuple[float, float],
) -> str:
    """A link as a rod, or the palm as a disc: radius and length of its cylinder."""
    radius, length = shape
    across = mass * (3 * radius**2 + length**2) / 12 + 1e-7
    at = "{} {} {} 0 0 0".format(*centre)
    where = ""
    if placed is not None:
        parent, x, y, z, yaw = placed
        where = f'<pose relative_to="{parent}">{x} {y} {z} 0 0 {yaw}</pose>'
    seen = f"<cylinder><radius>{radius}</radius><length>{max(length, 0.016)}</length></cylinder>"
    return (
        f'<link name="{name}">{where}<inertial><pose>{at}</pose><mass>{mass}</mass><inertia>'
        f"<ixx>{across}</ixx><iyy>{across}</iyy><izz>{mass * radius**2 / 2 + 1e-7}</izz>"
        "<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>"
        f'<visual name="{name}"><pose>{at}</pose><geometry>{seen}</geometry>'
        "<material><diffuse>0.6 0.62 0.66 1</diffuse></material></visual></link>"
    )


def _joint(name: str, parent: str, child: str, axis: str, lower: float, upper: float) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent>{parent}</parent><child>{child}</child>'
        f"<axis><xyz>{axis}</xyz><limit><lower>{lower}</lower><upper>{upper}</upper>"
        f"<effort>{TORQUE}</effort></limit><dynamics><damping>{DAMPING}</damping></dynamics></axis>"
        f"<drake:rotor_inertia xmlns:drake='drake'>{ROTOR}</drake:rotor_inertia></joint>"
    )
