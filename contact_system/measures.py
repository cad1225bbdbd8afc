"""Measures of a plan: slip by its exact law, rejection of slip, distance from a great circle."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .checks import shaped_array
from .errors import ChartSingularity, ContactSystemError
from .plan import Plan, require_plan
from .scene import STILL, Scene
from .theory.gain import contraction

REJECTED = 0.05
"""Slip counts as rejected below this fraction of its value at the end of the disturbance."""


# --- slip --------------------------------------------------------------------------------------


def windows(plan: Plan, contact: int) -> list[tuple[float, float]]:
    """Windows (start, stop), s, in which a contact is disturbed, ascending.

    Overlapping windows are joined, and those that end before the plan starts left out.
    """
    joined: list[tuple[float, float]] = []
    acting = [d for d in plan.scene.disturbances if d.contact == contact and d.stop > plan.start]
    for start, stop in sorted((max(d.start, plan.start), d.stop) for d in acting):
        if joined and start <= joined[-1][1]:
            start, stop = joined[-1][0], max(joined.pop()[1], stop)
        joined.append((start, stop))
    return joined


def regular_times(plan: Plan, t: np.ndarray) -> np.ndarray:
    """The times, s, without those at which a contact is at a pole or an umbilic: (m,).

    At those :meth:`Plan.states` does not exist.
    """
    try:
        plan.states(t)
    except ChartSingularity:
        if len(t) == 1:
            return t[:0]
        return np.concatenate([regular_times(plan, t[k : k + 1]) for k in range(len(t))])
    return t


def exact_slip(plan: Plan, contact: int, count: int = 25) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,), s, and slip (n,), m/s, by the exact law where nothing disturbs the contact.

    |v_rel|(t) = |v_rel|(t0) sigma(t)/sigma(t0) exp(-(L(t) - L(t0))) (eq. `contracaccel`), with t0
    the start of each undisturbed interval. Only the slip at t0 is taken from the plan.
    The times are ``count`` equally spaced ones and the edges of windows, where there is slip.
    """
    knots = [plan.start, *np.ravel(windows(plan, contact)), plan.end]
    grid = np.union1d(np.linspace(plan.start, plan.end, count), knots)
    times, values = [np.empty(0)], [np.empty(0)]
    ways = itertools.product(plan.scene.way(contact), zip(knots[::2], knots[1::2]))
    for (begin, end, _, profile, _), (start, stop) in ways:
        tau = grid[(grid >= max(start, begin)) & (grid <= min(stop, end))] - begin
        tau = tau[profile(tau) > 0]
        if stop <= start or not len(tau):
            continue
        first = plan.slip_speed(begin + tau[:1])[0, contact]
        decay = np.exp(-plan.scene.gain.exponent(profile, tau, tau[0]))
        times.append(begin + tau)
        values.append(first * profile(tau) / profile(tau[0]) * decay)
    t, slip = np.concatenate(times), np.concatenate(values)
    return t[slip > 0], slip[slip > 0]


# --- rejection of slip -------------------------------------------------------------------------


@dataclass(frozen=True)
class Rejection:
    """How one contact's slip evolves and is rejected.

    Attributes
    ----------
    contact : int
    start, peak, end : float
        Slip at the start, its maximum, and slip at the end [m/s].
    peak_time : float
        Time of the maximum [s].
    since : float
        End of the contact's last disturbance, or start of the plan if there is none [s].
    time : float
        Time from `since` until slip falls below 5 % of its value there for good [s]; of its peak
        afterwards, where a path starts from rest. inf if it is above at the end, nan if there is
        no slip.
    reported : float
        Rejection time that the paper reports [s]; nan if it reports none, or if it comes from a
        dynamic simulation, as a plan has no contact physics.
    """

    contact: int
    start: float
    peak: float
    peak_time: float
    end: float
    since: float
    time: float
    reported: float

    @property
    def as_reported(self) -> bool | None:
        """Whether slip is rejected within the reported time; None without slip or reported time."""
        if math.isnan(self.time) or math.isnan(self.reported):
            return None
        return self.time <= self.reported


def rejections(plan: Plan) -> list[Rejection]:
    """How each contact's slip is rejected, after its last disturbance or after the start.

    Rejection times are found by bisection to the last bit, between the times at which the exact
    law (eq. `contracaccel`) changes from growth to decay.

    Returns
    -------
    list of Rejection
        One for each contact, in the scene's order.

    Raises
    ------
    ContactSystemError
        If it is not a plan.
    """
    require_plan(plan)
    changes = _monotonic(plan.scene)
    knots = np.unique([plan.start, *changes[changes > plan.start], plan.end])
    edges = np.array([e for e in plan.scene.edges if e > plan.start])
    times = np.unique([*plan.sample_times(1001), *knots, *np.nextafter(edges, plan.start)])
    slip = plan.slip_speed(times)
    reported = math.nan
    if not is_dynamic(plan.scene):
        reported = plan.scene.paper.get("recovery_time", reported)
    result = []
    for i in range(len(plan.scene.contacts)):
        acting = windows(plan, i)
        since = acting[-1][1] if acting else plan.start
        # slip by an object rate offset ends with it: take the slip just before
        left = _slip_at(plan, i, math.nextafter(since, plan.start) if acting else since)
        level = REJECTED * (left or slip[times >= since, i].max())
        greatest = int(slip[:, i].argmax())
        first, peak, end = slip[[0, greatest, -1], i].tolist()
        taken = _rejection_time(plan, i, since, level, knots)
        result.append(
            Rejection(i, first, peak, float(times[greatest]), end, since, taken, reported)
        )
    return result


def _monotonic(scene: Scene) -> np.ndarray:
    """Times, s, between which undisturbed slip only grows or only shrinks."""
    times = set()
    for start, stop, _, profile, _ in {s for i in range(len(scene.contacts)) for s in scene.way(i)}:
        times |= {start, stop}
        if profile != STILL:
            intervals = contraction(profile, scene.gain, stop - start).intervals
            times |= {start + t for interval in intervals for t in interval}
    return np.array(sorted(times))


def is_dynamic(scene: Scene) -> bool:
    """Whether the paper's results of the scene are a dynamic simulation."""
    return "lateral_force" in scene.paper


def _slip_at(plan: Plan, contact: int, t: float) -> float:
    return float(plan.slip_speed(t)[0, contact])


def _rejection_time(
    plan: Plan, contact: int, since: float, level: float, knots: np.ndarray
) -> float:
    """Time from `since` to the last crossing of a level of slip, by bisection."""
    if level == 0:
        return math.nan
    steps = np.array([since, *knots[knots > since]])
    above = np.flatnonzero(plan.slip_speed(steps)[:, contact] >= level)
    if not len(above):
        return 0.0
    if above[-1] == len(steps) - 1:
        return math.inf
    high, low = steps[above[-1] :][:2].tolist()
    while high < (middle := 0.5 * (high + low)) < low:
        if _slip_at(plan, contact, middle) >= level:
            high = middle
        else:
            low = middle
    return low - since


# --- many contacts at once ----------------------------------------------------------------------

SAMPLES = 100  # times at which `summary` evaluates slip


def summary(plan: Plan) -> dict[str, np.ndarray]:
    """Slip, its rejection and the final state of each contact: the default outputs of `sweep`.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    dict
        ``slip_start``, ``slip_peak``, ``slip_end`` : (n_contacts,), m/s; the peak is the greatest
        of 100 equally spaced times. ``recovery`` : (n_contacts,), s, the time from the end of the
        contact's last disturbance (or the start) until slip stays below 5 % of its value there,
        interpolated between those times; inf if it stays above, nan if there is no slip.
        ``state_end`` : (n_contacts, 9), as :meth:`Plan.states`.

    Raises
    ------
    ContactSystemError
        If it is not a plan.
    """
    require_plan(plan)
    since = np.full(len(plan.scene.contacts), plan.start)
    for d in plan.scene.disturbances:
        since[d.contact] = max(since[d.contact], d.stop)
    # slip by a rate offset ends with its window: take the slip just before
    before = np.where(since > plan.start, np.nextafter(since, plan.start), since)
    grid = np.linspace(plan.start, plan.end, SAMPLES)
    t = np.unique(np.concatenate([grid, since, before]))
    slip = plan.slip_speed(t)
    return {
        "slip_start": slip[0],
        "slip_peak": slip.max(axis=0),
        "slip_end": slip[-1],
        "recovery": _recovery(t, slip, since, before),
        "state_end": plan.states(plan.end)[0],
    }


def _recovery(t: np.ndarray, slip: np.ndarray, since: np.ndarray, before: np.ndarray) -> np.ndarray:
    """See `summary`; slip is (n_times, n_contacts)."""
    each, after = np.arange(slip.shape[1]), t[:, None] >= since
    left = slip[np.searchsorted(t, before), each]
    level = REJECTED * np.where(left > 0, left, np.where(after, slip, 0.0).max(axis=0))
    above = after & (slip >= level)
    last = len(t) - 1 - np.argmax(above[::-1], axis=0)
    following = np.minimum(last + 1, len(t) - 1)
    high, low = slip[last, each], slip[following, each]
    with np.errstate(all="ignore"):  # slip decays exponentially, or is gone at once
        part = np.where(low > 0, np.log(high / level) / np.log(high / low), 1.0)
        time = t[last] + part * (t[following] - t[last]) - since
    time[last == len(t) - 1] = np.inf
    time[~above.any(axis=0)] = 0.0
    time[level == 0] = np.nan
    return time


# --- curves ------------------------------------------------------------------------------------


def great_circle_distance(points: ArrayLike) -> np.ndarray:
    """Distance of a curve on a sphere from its great-circle plane (the paper's corollary).

    Parameters
    ----------
    points : (n, 3)
        Points of the curve, from the sphere's centre, m.

    Returns
    -------
    (n,)
        Signed distance from the plane through the centre that fits them best (least squares), m.

    Raises
    ------
    ContactSystemError
        A wrong shape, or a point that is not finite.
    """
    remedy = "finite points of one curve, shape (n, 3), such as plan.points(t)[:, 0, 0]"
    points = shaped_array(points, "points", error=ContactSystemError, remedy=remedy)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ContactSystemError(f"points of shape {points.shape}: give {remedy}")
    return points @ np.linalg.svd(points, full_matrices=len(points) < 3)[2][2]
