"""What contact physics made of a plan, contact by contact, beside what the paper reports."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contact_system import Scene, plan
from contact_system.measures import REJECTED, windows

from .contact_monitor import SATURATED

if TYPE_CHECKING:
    from .station import SimulationResult

Array = NDArray[np.float64]

EDGE = 0.1
"""Time after the start, and before and after a disturbance's edge, that counts as transient [s]."""

STANDING = 1e-4
"""Part of a contact's greatest speed below which slip relative to its speed says nothing."""


@dataclass(frozen=True)
class ContactReport:
    """One contact of a simulation. SI units; NaN where there is nothing to measure.

    Attributes
    ----------
    name : str
    normal_mean, normal_deviation : float
        Of the normal force outside the transients [N].
    friction_peak : float
        Greatest tangential force [N].
    friction_ratio : float
        Greatest tangential force over mu times the momentary normal force, where that is at least
        half its mean; NaN where mu is 0.
    rolling_friction : float
        Mean tangential force before any disturbance [N].
    rolling_slip : float
        Mean slip over the speed of the contact point on the object, before the disturbance, while
        that is more than 1e-4 of its greatest.
    disturbed_slip : float
        Mean slip during the last disturbance [m/s].
    saturated : float
        Part of that time with friction saturated.
    slip_before : float
        Greatest slip before any disturbance [m/s].
    recovery : float
        Time from the disturbance's end until slip stays below 5 % of `disturbed_slip`, or below
        `slip_before` where that is greater [s]; inf if it is above at the end.
    settling : float
        The same until it stays below what undisturbed rolling has at that speed, where that is
        more than 5 % of `disturbed_slip` [s]: the greatest slip over contact speed of this contact
        before any disturbance, and of contacts that are never disturbed at any time. Facets of
        meshes make slip in proportion to speed, which the first does not allow for.
    reported : float
        Within how long the paper reports it [s].
    distance : float
        Greatest distance of the measured contact point from the planned one on the object before
        any disturbance [m].
    """

    name: str
    normal_mean: float
    normal_deviation: float
    friction_peak: float
    friction_ratio: float
    rolling_friction: float
    rolling_slip: float
    disturbed_slip: float
    saturated: float
    slip_before: float
    recovery: float
    settling: float
    reported: float
    distance: float

    @property
    def as_reported(self) -> bool | None:
        """Whether slip is rejected within the time reported; None where nothing is to compare."""
        if math.isnan(self.recovery) or math.isnan(self.reported):
            return None
        return self.recovery <= self.reported

    @property
    def saturates(self) -> bool | None:
        """Whether friction is saturated during the disturbance at all; None where there is none."""
        return None if math.isnan(self.saturated) else self.saturated > 0


def contact_table(result: SimulationResult) -> list[ContactReport]:
    """Measure every contact of a simulation.

    Parameters
    ----------
    result : SimulationResult

    Returns
    -------
    list of ContactReport
        In the scene's order.
    """
    planned, t = plan(result.scene), result.t  # the plan knows the windows of every contact
    disturbed = [windows(planned, i) for i in range(len(result.scene.contacts))]
    edges = np.ravel([w for of_contact in disturbed for w in of_contact])
    before = (t >= EDGE) & (t < min(edges, default=math.inf))
    steady = (t >= EDGE) & (np.abs(t[:, None] - edges) > EDGE).all(1)
    slip = np.linalg.norm(result.measured["slip"], axis=2)
    speed = contact_speed(result.scene, result.planned["state"])
    moving = speed > STANDING * speed.max(axis=0)  # a path may start from rest, or end there
    ratio = np.divide(slip, speed, out=np.full_like(slip, math.nan), where=moving)
    untouched = ratio[t >= EDGE][:, [not w for w in disturbed]]
    reports = []
    for i, acting in enumerate(disturbed):
        usual = np.append(untouched, ratio[before, i])
        allowed = _greatest(usual[np.isfinite(usual)]) * speed[:, i]
        reports.append(
            ContactReport(
                **_rolling(result, i, before, steady),
                rolling_slip=_mean(ratio[before & moving[:, i], i]),
                slip_before=_greatest(slip[before, i]),
                **_rejection(result, i, acting, slip[:, i], before, allowed),
            )
        )
    return reports


def contact_speed(scene: Scene, states: Array) -> Array:
    """Speed of the contact points on the object, |M2 q2'|: (m, n, 9) -> (m, n), m/s."""
    root = scene.object.metric_root(states[..., 4], states[..., 5])
    return np.linalg.norm(np.einsum("...ij,...j->...i", root, states[..., 6:8]), axis=-1)


def recovery_time(t: Array, slip: Array, since: float, level: Array | float) -> float:
    """How long after a time a signal last lies at a level or above, s.

    Parameters
    ----------
    t, slip : (m,)
    since : float
    level : (m,) or float

    Returns
    -------
    float
        0 if it never does from then on, inf if it does at the end.
    """
    after = t >= since
    above = np.flatnonzero((slip >= level)[after])
    if not len(above):
        return 0.0
    later = t[after][above[-1] + 1 :]
    return float(later[0] - since) if len(later) else math.inf


def _rolling(
    result: SimulationResult, i: int, before: NDArray[np.bool_], steady: NDArray[np.bool_]
) -> dict[str, Any]:
    """Forces of one contact, and where it is while nothing has been disturbed yet."""
    normal, friction = _forces(result, i)
    apart = result.measured["contact_point"][:, i] - result.planned["contact_point"][:, i]
    limit = result.config.plant.friction * normal
    pressed = (normal > 0.5 * _mean(normal[steady])) & (limit > 0)
    return {
        "name": result.scene.contact_name(i),
        "normal_mean": _mean(normal[steady]),
        "normal_deviation": float(normal[steady].std()) if steady.any() else math.nan,
        "friction_peak": float(friction.max()),
        "friction_ratio": _greatest(friction[pressed] / limit[pressed]),
        "rolling_friction": _mean(friction[before]),
        "distance": _greatest(np.linalg.norm(apart[before], axis=1)),
    }


def _rejection(
    result: SimulationResult,
    i: int,
    disturbed: list[tuple[float, float]],
    slip: Array,
    before: NDArray[np.bool_],
    allowed: Array,
) -> dict[str, Any]:
    """What the last disturbance did, if it was seen and is over.

    allowed : (m,), the slip of rolling
    """
    t = result.t
    start, stop = disturbed[-1] if disturbed else (math.inf, math.inf)
    during = (t >= start) & (t < stop)
    if not during.any() or not (t > stop).any():
        nothing = ("disturbed_slip", "saturated", "recovery", "settling", "reported")
        return dict.fromkeys(nothing, math.nan)
    level = REJECTED * _mean(slip[during])
    normal, friction = _forces(result, i)
    # A finger that is off the object, or that nothing holds, has no friction to saturate.
    limit = result.config.plant.friction * normal
    saturated = (friction >= SATURATED * limit) & (friction > 0)
    return {
        "disturbed_slip": _mean(slip[during]),
        "saturated": float(saturated[during].mean()),
        "recovery": recovery_time(t, slip, stop, np.fmax(level, _greatest(slip[before]))),
        "settling": recovery_time(t, slip, stop, np.fmax(level, allowed)),
        "reported": result.scene.paper.get("recovery_time", math.nan),
    }


def _forces(result: SimulationResult, i: int) -> tuple[Array, Array]:
    """Normal force and size of the tangential force of one contact, (m,) each, N."""
    tangential = result.measured["tangential_force"][:, i]
    return result.measured["normal_force"][:, i], np.linalg.norm(tangential, axis=1)


def _mean(values: Array) -> float:
    return float(values.mean()) if len(values) else math.nan


def _greatest(values: Array) -> float:
    return float(values.max()) if len(values) else math.nan
