"""A plan as Drake's own trajectories."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.trajectories import PiecewisePolynomial, PiecewisePose, PiecewiseQuaternionSlerp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from contact_system import Plan, SceneError
from contact_system.checks import finite_number
from contact_system.plan import require_plan

FIRST, MOST = 64, 2**17
"""Pieces of a trajectory at first, and the most before a tolerance is refused."""
ROWS = ((0, 6), (6, 3), (9, 3), (12, 3))
"""Of twist, position and contact points on finger and object, where they begin, and how many."""


@dataclass(frozen=True)
class ContactTrajectories:
    """How one finger moves relative to the object, of :func:`MakeTrajectories`; SI units.

    Drake's trajectories cannot be pickled; these are, by what they are made from.

    Attributes
    ----------
    plan, contact, tolerance
    pose : PiecewisePose
        X_OF: cubic positions, orientations by slerp.
    twist : PiecewisePolynomial
        V_OF_O, angular then linear, (6, 1); it jumps where a disturbance makes it.
    finger_point, object_point : PiecewisePolynomial
        The contact point, in F and in O, (3, 1).
    """

    plan: Plan
    contact: int
    tolerance: float
    pose: PiecewisePose
    twist: PiecewisePolynomial
    finger_point: PiecewisePolynomial
    object_point: PiecewisePolynomial

    def __reduce__(self) -> tuple:
        return MakeTrajectories, (self.plan, self.contact, self.tolerance)


def MakeTrajectories(plan: Plan, contact: int = 0, tolerance: float = 1e-5) -> ContactTrajectories:
    """The trajectories of one contact of a plan, from its start to its end.

    Parameters
    ----------
    plan : Plan
    contact : int
    tolerance : float
        Of positions, as a fraction of the object's size, of orientations, rad, and of twists, as a
        fraction of the greatest. Pieces are halved until all keep it.

    Raises
    ------
    SceneError
        No such contact, or a tolerance that 130 000 pieces do not keep.
    """
    require_plan(plan)
    count = len(plan.scene.contacts)
    if contact not in range(count):
        raise SceneError(f"{plan.scene.title}: contact = {contact!r}: give one of 0 to {count - 1}")
    finite_number(tolerance, f"{plan.scene.title}: tolerance", "above 0")
    edges = [e for e in plan.scene.edges if plan.start < e < plan.end]
    spans = list(zip([plan.start, *edges], [*edges, plan.end]))
    parts: list[_Part] = []
    for span in spans:
        pieces = FIRST
        while (part := _Part(plan, contact, span, pieces)).error() > tolerance:
            pieces *= 2
            if pieces > MOST:
                raise SceneError(
                    f"{plan.scene.title}, contact {contact}: tolerance = {tolerance:g} takes more "
                    f"than {MOST} pieces between t = {span[0]:g} and {span[1]:g} s; give a larger "
                    "one, or ask a PlanSource"
                )
        parts.append(part)
    whole, *others = (part.cubic() for part in parts)
    for other in others:
        whole.ConcatenateInTime(other)
    twist, position, *points = (whole.Block(k, 0, n, 1) for k, n in ROWS)
    # neighbouring parts share a break
    breaks = np.concatenate([parts[0].t[:1], *(part.t[1:] for part in parts)])
    turns = np.concatenate([parts[0].turn[:1], *(part.turn[1:] for part in parts)])
    slerp = PiecewiseQuaternionSlerp(breaks.tolist(), [RotationMatrix(R) for R in turns])
    pose = PiecewisePose(position, slerp)
    return ContactTrajectories(plan, contact, tolerance, pose, twist, *points)


class _Part:
    """Values at the breaks between two edges, and half-way between breaks.

    t (m + 1), values (m + 1, 15), turn (m + 1, 3, 3)
    """

    def __init__(self, plan: Plan, contact: int, span: tuple[float, float], pieces: int):
        t = np.linspace(*span, 2 * pieces + 1)
        asked = t.copy()
        asked[-1] = np.nextafter(t[-1], t[0])  # a plan tells what is after an edge
        found = plan.evaluate(asked, "twist", "pose", "points")
        X, twist = found["pose"][:, contact], found["twist"][:, contact]
        points = found["points"][:, contact].reshape(-1, 6)
        values = np.hstack([twist, X[:, :3, 3], points])
        self.t, self.values, self.turn = t[::2], values[::2], X[::2, :3, :3]
        self._half, self._there, self._turned = t[1::2], values[1::2], X[1::2, :3, :3]
        self._spline, self._size = CubicSpline(self.t, self.values), plan.scene.object.size

    def error(self) -> float:
        """The greatest, half-way between breaks, in tolerances of 1."""
        turning = np.linalg.norm(self.values[:, :3], axis=1).max()
        if turning * (self.t[1] - self.t[0]) > 1.0:  # rad; whole turns in a piece look like none
            return np.inf
        off = np.abs(self._spline(self._half) - self._there)
        scale = np.full(15, self._size)
        for rows in (slice(0, 3), slice(3, 6)):
            scale[rows] = np.abs(self.values[:, rows]).max() or 1.0
        before, after = Rotation.from_matrix(self.turn[:-1]), Rotation.from_matrix(self.turn[1:])
        half = before * Rotation.from_rotvec((before.inv() * after).as_rotvec() / 2)
        turned = (half.inv() * Rotation.from_matrix(self._turned)).magnitude()
        return max(float((off / scale).max()), float(turned.max()))

    def cubic(self) -> PiecewisePolynomial:
        return PiecewisePolynomial.CubicHermite(self.t, self.values.T, self._spline(self.t, 1).T)
