"""A hand: fingers as serial chains, the project's own one or any model by file."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from contact_system import SceneError
from contact_system.checks import finite_number, finite_numbers, of_kind


class Part(NamedTuple):
    """A joint of the project's own fingers and the link behind it: rad, kg, m."""

    axis: str
    lower: float
    upper: float
    mass: float
    length: float


SIDEWAYS, CURL, TWIST = "1 0 0", "0 -1 0", "0 0 1"
ARM = (
    Part(SIDEWAYS, -0.8, 0.8, 0.01, 0.0),
    Part(CURL, -1.7, 0.6, 0.035, 0.055),
    Part(CURL, 0.0, 2.2, 0.03, 0.045),
)
FINGERS = {
    4: (*ARM, Part(CURL, -0.3, 1.7, 0.02, 0.035)),
    6: (
        *ARM,
        Part(CURL, -1.0, 1.7, 0.01, 0.015),
        Part(SIDEWAYS, -1.3, 1.3, 0.005, 0.0),
        Part(TWIST, -1.7, 1.7, 0.01, 0.02),
    ),
}
"""By the number of their joints. Six leave a tip's pose free: two more turn it at its wrist."""

TORQUE = 0.7  # N m, of every joint
ROTOR = 2e-4  # kg m^2, of a motor behind its gear
DAMPING = 0.01  # N m s
PALM = 0.05  # m, from the palm's middle to where a finger begins


# Drake's YAML reads annotations as types: without `from __future__ import annotations`
@dataclass
class Hand:
    """Fingers on joints, one for each contact of a scene, whose surface its fingertip has.

    Parameters
    ----------
    model : str
        An SDF, URDF or MJCF file, or its package:// URL; "": the project's own hand, whose fingers
        stand around a palm where the scene's contacts are. Each has a joint that swings it sideways
        and three that curl it.
    joints : int
        Of each of the own hand's fingers: 4, or 6, with two more at its wrist.
    tips : list of str
        The model's frames that carry fingertips, in the order of the contacts; the origin of a
        fingertip's surface is put there.
    base : list of float
        Where the model's origin is in the world, m, at the scene's start; the object is at the
        origin.
    pad : float
        How far from the middle of its pad, the scene's ``finger_at``, a fingertip may touch, m.
    """

    model: str = ""
    joints: int = 4
    tips: list[str] = field(default_factory=list)
    base: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.11])
    pad: float = 0.02

    def check(self, contacts: int) -> None:
        """Raise a SceneError that names the first field that is wrong, its value and the remedy."""
        if self.joints not in FINGERS:
            raise SceneError(f"hand: joints = {self.joints!r}: give one of {[*FINGERS]}")
        if len(finite_numbers(self.base, "hand: base")) != 3:
            raise SceneError(f"hand: base = {self.base!r}: give three numbers, m")
        finite_number(self.pad, "hand: pad", "above 0")
        of_kind((str, os.PathLike), self.model, "hand: model", "the path of a file")
        of_kind((list, tuple), self.tips, "hand: tips", "a list of the model's frames")
        for i, tip in enumerate(self.tips):
            of_kind(str, tip, f"hand: tips[{i}]", "the name of a frame")
        wanted = contacts if self.model else 0
        if len(self.tips) != wanted:
            raise SceneError(
                f"hand: tips = {self.tips!r}: give {wanted} names"
                + (", a frame for each contact" if self.model else " for the project's own hand")
            )


def own_hand(azimuths: Sequence[float], joints: int = 4) -> str:
    """SDF of the project's own hand: a finger at each azimuth about the palm's z axis, rad.

    Frames ``tip_0`` and so on have z along the last link and x, where a pad is by default, to the
    side to which the finger curls. The fingers of a hand that is at its zeros stand up.
    """
    parts = [_link("palm", "", 0.2, PALM, 0.01, 0.0)]
    for i, azimuth in enumerate(azimuths):
        x, y = PALM * math.cos(azimuth), PALM * math.sin(azimuth)
        parent, where = "palm", f'<pose relative_to="palm">{x} {y} 0 0 0 {azimuth}</pose>'
        for k, part in enumerate(FINGERS[joints]):
            name = f"finger_{i}_link_{k}"
            parts.append(_link(name, where, part.mass, 0.008, part.length, part.length / 2))
            parts.append(_joint(f"finger_{i}_joint_{k}", parent, name, part))
            parent, where = name, f'<pose relative_to="{name}">0 0 {part.length} 0 0 0</pose>'
        end = f'<pose relative_to="{parent}">0 0 {part.length} 0 0 {math.pi}</pose>'
        parts.append(f'<frame name="tip_{i}" attached_to="{parent}">{end}</frame>')
    body = "\n".join(parts)
    return f'<sdf version="1.9"><model name="hand">\n{body}\n</model></sdf>'


def _link(name: str, where: str, mass: float, radius: float, length: float, middle: float) -> str:
    """A link as a rod, or the palm as a disc, with its middle so high in its frame."""
    across = mass * (3 * radius**2 + length**2) / 12 + 1e-7
    at = f"<pose>0 0 {middle} 0 0 0</pose>"
    seen = f"<cylinder><radius>{radius}</radius><length>{max(length, 0.016)}</length></cylinder>"
    return (
        f'<link name="{name}">{where}<inertial>{at}<mass>{mass}</mass><inertia>'
        f"<ixx>{across}</ixx><iyy>{across}</iyy><izz>{mass * radius**2 / 2 + 1e-7}</izz>"
        "<ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>"
        f'<visual name="{name}">{at}<geometry>{seen}</geometry>'
        "<material><diffuse>0.6 0.62 0.66 1</diffuse></material></visual></link>"
    )


def _joint(name: str, parent: str, child: str, part: Part) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent>{parent}</parent><child>{child}</child>'
        f"<axis><xyz>{part.axis}</xyz><limit><lower>{part.lower}</lower><upper>{part.upper}</upper>"
        f"<effort>{TORQUE}</effort></limit><dynamics><damping>{DAMPING}</damping></dynamics></axis>"
        f"<drake:rotor_inertia xmlns:drake='drake'>{ROTOR}</drake:rotor_inertia></joint>"
    )
