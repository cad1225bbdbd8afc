"""A plan as Drake's own trajectories."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.trajectories import PiecewisePolynomial, PiecewisePose, PiecewiseQuaternionSlerp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from contact_system import Plan, SceneError
from contact_system.checks import Array, finite_number, naming
from contact_system.plan import require_plan

FIRST, MOST = 64, 2**17
"""Number of pieces between edges at first, and the greatest; a tolerance that needs more fails."""


@dataclass(frozen=True)
class ContactTrajectories:
    """How one finger moves relative to the object; made by :func:`MakeTrajectories`. SI units.

    Drake's trajectories cannot be pickled. This object can: it is made anew from its arguments.

    Attributes
    ----------
    plan, contact, tolerance
    pose : PiecewisePose
        X_OF: cubic positions, orientations by slerp. In each piece the angular part of its
        ``GetVelocity`` is constant, with an error of up to sqrt(2 tolerance times the angular
        acceleration): by default up to 3e-3 of the greatest angular velocity in the bundled scenes.
        `twist` keeps the tolerance.
    twist : PiecewisePolynomial
        V_OF_O, angular then linear, (6, 1); it jumps where a disturbance makes it jump.
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
        Greatest error of positions, as a fraction of the object's size, of orientations, rad, and
        of twists, as a fraction of the greatest. Pieces are halved until all errors are below it.

    Raises
    ------
    SceneError
        No such contact, or a tolerance that takes more than 130 000 pieces.
    """
    require_plan(plan)
    with naming(plan.scene.title):
        plan.scene.require_contact(contact)
        finite_number(tolerance, "tolerance", "above 0")
    edges = [e for e in plan.scene.edges if plan.start < e < plan.end]
    spans = itertools.pairwise([plan.start, *edges, plan.end])
    t, turns, (whole, *others) = zip(*(_fitted(plan, contact, span, tolerance) for span in spans))
    for other in others:
        whole.ConcatenateInTime(other)
    rows = (0, 6), (6, 3), (9, 3), (12, 3)  # as `_fitted` stacks them
    twist, position, *points = (whole.Block(k, 0, n, 1) for k, n in rows)
    # neighbouring parts share a break
    breaks, first = np.unique(np.concatenate(t), return_index=True)
    rotations = [RotationMatrix(R) for R in np.concatenate(turns)[first]]
    pose = PiecewisePose(position, PiecewiseQuaternionSlerp(breaks.tolist(), rotations))
    return ContactTrajectories(plan, contact, tolerance, pose, twist, *points)


@np.errstate(under="ignore")  # slopes that are 0 but for rounding underflow
def _fitted(
    plan: Plan, contact: int, span: tuple[float, float], tolerance: float
) -> tuple[Array, Array, PiecewisePolynomial]:
    """Breaks between two edges, (m + 1,), rotations there, and cubics of all else, (15, 1)."""
    pieces = FIRST
    while pieces <= MOST:
        t = np.linspace(*span, 2 * pieces + 1)
        before = t.copy()
        before[-1] = np.nextafter(t[-1], t[0])  # at an edge a plan gives what comes after it
        found = plan.evaluate(before, "twist", "pose", "points")
        X, twist = found["pose"][:, contact], found["twist"][:, contact]
        values = np.hstack([twist, X[:, :3, 3], found["points"][:, contact].reshape(-1, 6)])
        breaks, spline = t[::2], CubicSpline(t[::2], values[::2])
        if _error(spline, t, values, X[:, :3, :3], plan.scene.object.size) <= tolerance:
            rates = spline(breaks, 1)
            cubics = PiecewisePolynomial.CubicHermite(breaks, values[::2].T, rates.T)
            return breaks, X[::2, :3, :3], cubics
        pieces *= 2
    raise SceneError(
        f"{plan.scene.title}, {plan.scene.contact_title(contact)}: tolerance = {tolerance:g} takes "
        f"more than {MOST} pieces between t = {span[0]:g} and {span[1]:g} s; give a larger one, or "
        "ask a PlanSource"
    )


def _error(spline: CubicSpline, t: Array, values: Array, turns: Array, size: float) -> float:
    """The greatest error half-way between breaks; values and rotations are given at all t."""
    turning = np.linalg.norm(values[:, :3], axis=1).max()
    if turning * (t[2] - t[0]) > 1.0:  # rad; a whole turn in a piece would look like no turn
        return np.inf
    greatest = [np.abs(values[:, k : k + 3]).max() or 1.0 for k in (0, 3)]
    scale = np.repeat([*greatest, size], [3, 3, 9])
    off = np.abs(spline(t[1::2]) - values[1::2]) / scale
    at, between = Rotation.from_matrix(turns[::2]), Rotation.from_matrix(turns[1::2])
    half = at[:-1] * Rotation.from_rotvec((at[:-1].inv() * at[1:]).as_rotvec() / 2)
    return max(float(off.max()), float((half.inv() * between).magnitude().max()))
