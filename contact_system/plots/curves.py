"""Contact curves for pictures and the explorer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..measures import windows
from ..plan import Plan
from ..scene import STILL
from .style import colour_of, number_of, shortened


@dataclass
class Curve:
    """A contact curve: points (n, 3) [m], whether disturbed there (n,), its colour and number.

    With legs also the middle of each leg (n, 3), and the finger's frames at start and end: origin
    and tips of unit x and y axes, (2, 3, 3).
    """

    points: np.ndarray
    disturbed: np.ndarray
    colour: str
    label: str
    legs: np.ndarray | tuple[()] = ()
    frames: np.ndarray | tuple[()] = ()


def curves_of(plan: Plan, contacts: Sequence[int], side: int) -> list[Curve]:
    t = plan.sample_times(1601)
    points = plan.points(t)
    curves = [curve_of(plan, i, t, points[:, i, side]) for i in contacts]
    for i, curve in zip(contacts, curves):
        if plan.scene.contacts[i].legs:
            _add_legs(curve, plan, i, side)
    return curves


def _add_legs(curve: Curve, plan: Plan, contact: int, side: int) -> None:
    """Add the middles of the legs, and the finger's frames at the start and the end."""
    way = [leg for leg in plan.scene.way(contact) if leg.profile != STILL]
    curve.legs = plan.points([(leg.start + leg.stop) / 2 for leg in way])[:, contact, side]
    ends = [plan.start, plan.end]
    if len(plan.regular_times(ends)) < 2:
        return
    results = plan.evaluate(ends, "points", "states", "pose")
    finger, states = plan.scene.contacts[contact].finger, results["states"][:, contact]
    axes = finger.frame(states[:, 0], states[:, 1])[..., :2]
    if side:  # in the object's frame
        axes = results["pose"][:, contact, :3, :3] @ axes
    at = results["points"][:, contact, side]
    curve.frames = np.stack([at, at + axes[..., 0], at + axes[..., 1]], axis=1)


def curve_of(plan: Plan, contact: int, t: np.ndarray, points: np.ndarray) -> Curve:
    """The curve of a contact through points (n, 3) at times t (n,)."""
    disturbed = np.zeros(len(t), bool)
    for start, stop in windows(plan, contact):
        disturbed |= (t >= start) & (t < stop)
    return Curve(points, disturbed, colour_of(contact), number_of(plan.scene, contact))


def distinct(curves: Sequence[Curve], distance: float) -> list[Curve]:
    """The curves, coincident ones merged into one curve with all their numbers."""
    groups: list[list[Curve]] = []
    for curve in curves:
        for group in groups:
            if np.abs(group[0].points - curve.points).max() < distance:
                group.append(curve)
                break
        else:
            groups.append([curve])
    for first, *others in groups:
        first.disturbed = np.any([c.disturbed for c in (first, *others)], axis=0)
        first.label = shortened(",".join(c.label for c in (first, *others)), 12)
    return [group[0] for group in groups]
