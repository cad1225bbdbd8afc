"""A hand, whose fingers are serial chains of joints: the project's own, or a model from a file."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from contact_system import SceneError
from contact_system.checks import finite_number, finite_numbers, of_kind


class Part(NamedTuple):
    """A joint of the project's own fingers, rad, and the link that it moves, kg and m."""

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
"""Parts of a finger by its number of joints; with six, two in a wrist, its tip takes any pose."""

TORQUE = 0.7  # N m, effort limit of each joint
ROTOR = 2e-4  # kg m^2, a motor's inertia as its gear makes the joint feel it
DAMPING = 0.01  # N m s
PALM = 0.05  # m, from the palm's middle to the first joint of each finger


# Drake's YAML reads annotations as types: without `from __future__ import annotations`
@dataclass
class Hand:
    """Fingers with joints, one for each contact; a fingertip has the contact's finger surface.

    Parameters
    ----------
    model : str
        An SDF, URDF or MJCF file, or its package:// URL; "": the project's own hand, whose fingers
        stand around a palm, in the directions of the scene's contacts. Each has a joint that swings
        it sideways and three that curl it.
    joints : int
        Number of joints of each finger of the project's own hand: 4, or 6, two of them at a wrist.
    tips : list of str
        Frames of the model to which fingertips are welded, in the order of the contacts. The frame
        of a fingertip's surface coincides with it.
    base : list of float
        Position of the model's origin in the world, m. The object starts at the world's origin.
    pad : float
        Greatest distance of a contact from the middle of its pad, the scene's ``finger_at``, m.
    """

    model: str = ""
    joints: int = 4
    tips: list[str] = field(default_factory=list)
    base: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.11])
    pad: float = 0.02

    def check(self, contacts: int) -> None:
        """Raise a SceneError that names the first field that is wrong, its value and the remedy."""
        if self.joints not in [*FINGERS]:  # not the dict: a list has no hash
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
            whose = ", a frame for each contact" if self.model else " for the project's own hand"
            raise SceneError(f"hand: tips = {self.tips!r}: give {wanted} names{whose}")


def own_hand(azimuths: Sequence[float], joints: int = 4) -> str:
    """SDF of the project's own hand: a finger at each azimuth about the palm's z axis, rad.

    The frames ``tip_0``, ``tip_1``, ... have z along the last link, and x, where pads are by
    default, to the side to which the finger curls. With all joints at zero the fingers stand up.
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
    """A link, or the palm, as a cylinder along z whose middle is at this height in its frame."""
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
