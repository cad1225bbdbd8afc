"""Measures of a plan: slip by its exact law, rejection of slip, distance from a great circle."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .checks import shaped_array
from .errors import ContactSystemError
from .plan import Plan, require_plan
from .scene import STILL, Scene
from .theory import equations
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


def exact_slip(plan: Plan, contact: int) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,), s, and slip (n,), m/s, by the exact law where nothing disturbs the contact.

    |v_rel|(t) = |v_rel|(t0) sigma(t)/sigma(t0) exp(-(L(t) - L(t0))) (eq. `contracaccel`), with t0
    the start of each undisturbed interval. Only the slip at t0 is taken from the plan.
    The times are 25 equally spaced ones and the edges of windows, without those of no slip.
    """
    knots = [plan.start, *np.ravel(windows(plan, contact)), plan.end]
    grid = np.union1d(np.linspace(plan.start, plan.end, 25), knots)
    times, values = [np.empty(0)], [np.empty(0)]
    intervals = itertools.product(plan.scene.way(contact), zip(knots[::2], knots[1::2]))
    for (begin, end, profile, _), (start, stop) in intervals:
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
        Slip at the start, its maximum (in each window, of 65 samples or more), and slip at the end
        [m/s].
    peak_time : float
        Time of the maximum [s].
    since : float
        End of the contact's last disturbance, or start of the plan if there is none [s].
    time : float
        Time from `since` until slip stays below 5 % of its value at `since` [s] (just before, if a
        window ends there), or of its later peak if it is zero there, as in a start from rest. inf
        if slip is not below at the end, nan if there is no slip.
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
    edges = np.array([e for e in plan.scene.edges if e > plan.start])
    disturbed = {w for i in range(len(plan.scene.contacts)) for w in windows(plan, i)}
    inside = [np.linspace(start, min(stop, plan.end), 65) for start, stop in disturbed]
    times = [changes[changes > plan.start], np.nextafter(edges, plan.start), *inside]
    t = np.unique(np.concatenate([plan.sample_times(1001), *times]))
    slip = plan.slip_speed(t)
    since, level, last = _last_slip(plan, t, slip)
    paper = {} if is_dynamic(plan.scene) else plan.scene.paper
    reported = paper.get("recovery_time", math.nan)
    result = []
    for i, k in enumerate(last.tolist()):
        if level[i] == 0 or k < 0 or k == len(t) - 1:
            time = math.nan if level[i] == 0 else 0.0 if k < 0 else math.inf
        else:
            time = _crossing(plan, i, t[k : k + 2].tolist(), level[i]) - float(since[i])
        top, values = int(slip[:, i].argmax()), slip[:, i].tolist()
        ends = values[top], float(t[top]), values[-1], float(since[i])
        result.append(Rejection(i, values[0], *ends, time, reported))
    return result


def _last_slip(plan: Plan, t: np.ndarray, slip: np.ndarray) -> tuple[np.ndarray, ...]:
    """From slip (n_times, n_contacts), for each contact: when its last disturbance ends or the plan
    starts, s; the level below which slip counts as rejected, m/s; and the index of the last time
    at which slip is not below it, -1 if there is none."""
    since = np.full(slip.shape[1], plan.start)
    for d in plan.scene.disturbances:
        since[d.contact] = max(since[d.contact], d.stop)
    # slip by a rate offset ends with its window: take the slip just before
    before = np.where(since > plan.start, np.nextafter(since, plan.start), since)
    after = t[:, None] >= since
    first = slip[np.searchsorted(t, before), np.arange(slip.shape[1])]
    level = REJECTED * np.where(first > 0, first, np.where(after, slip, 0.0).max(axis=0))
    above = after & (slip >= level)
    last = len(t) - 1 - np.argmax(above[::-1], axis=0)
    return since, level, np.where(above.any(axis=0), last, -1)


def _monotonic(scene: Scene) -> np.ndarray:
    """Times, s, between which undisturbed slip only grows or only shrinks on a leg."""
    times = set()
    for start, stop, profile, _ in {s for i in range(len(scene.contacts)) for s in scene.way(i)}:
        if profile != STILL:
            intervals = contraction(profile, scene.gain, stop - start).intervals
            times |= {start + t for interval in intervals for t in interval}
    return np.array(sorted(times))


def is_dynamic(scene: Scene) -> bool:
    """Whether the paper's results of the scene are a dynamic simulation."""
    return "lateral_force" in scene.paper


def _crossing(plan: Plan, contact: int, times: list[float], level: float) -> float:
    """When slip falls below a level between two times, by bisection."""
    high, low = times
    while high < (middle := 0.5 * (high + low)) < low:
        if plan.slip_speed(middle)[0, contact] >= level:
            high = middle
        else:
            low = middle
    return low


# --- many contacts at once ----------------------------------------------------------------------

SAMPLES = 100  # times at which `summary` evaluates slip
EARLY = np.geomspace(1e-6, 1e-2, 25)  # more of them: slip from rest may be over before the second


def summary(plan: Plan) -> dict[str, np.ndarray]:
    """Slip, its rejection and the final state of each contact: the default outputs of `sweep`.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    dict
        ``slip_start``, ``slip_peak``, ``slip_end`` : (n_contacts,), m/s; the peak is the greatest
        at 100 equally spaced times, at some soon after the start and at the ends of disturbances.
        ``recovery`` : (n_contacts,), s, as `Rejection.time`, but interpolated between those times;
        inf if slip does not stay below 5 %, nan if there is none at those times.
        ``state_end`` : (n_contacts, 9), as :meth:`Plan.states`; for a contact that ends at a pole,
        the state 1e-8 of the horizon earlier.

    Raises
    ------
    ContactSystemError
        If it is not a plan.
    """
    require_plan(plan)
    stops = np.array([d.stop for d in plan.scene.disturbances if d.stop > plan.start])
    grid = np.linspace(plan.start, plan.end, SAMPLES)
    early = plan.start + (plan.end - plan.start) * EARLY
    t = np.unique(np.concatenate([grid, early, stops, np.nextafter(stops, plan.start)]))
    slip = plan.slip_speed(t)
    since, level, last = _last_slip(plan, t, slip)
    each, k = np.arange(slip.shape[1]), np.clip(last, 0, len(t) - 2)
    high, low = slip[k, each], slip[k + 1, each]
    with np.errstate(all="ignore"):  # slip decays exponentially, or is gone at once
        part = np.where(low > 0, np.log(high / level) / np.log(high / low), 1.0)
        time = t[k] + part * (t[k + 1] - t[k]) - since
    time[last == len(t) - 1] = np.inf
    time[last < 0] = 0.0
    time[level == 0] = np.nan
    before, end = plan.states([plan.end - 1e-8 * (plan.end - plan.start), plan.end], gaps=True)
    return {
        "slip_start": slip[0],
        "slip_peak": slip.max(axis=0),
        "slip_end": slip[-1],
        "recovery": time,
        "state_end": np.where(np.isnan(end), before, end),
    }


# --- bodies beside a contact ---------------------------------------------------------------------

CONFORMS = 1e-9
"""Least eigenvalue of the relative curvature, times the finger's size, that may be rounding."""


def relative_curvature(plan: Plan, t: np.ndarray) -> np.ndarray:
    """K_2 + R_psi K_1 R_psi in E2, of each contact, (n_times, n_contacts, 2, 2), 1/m.

    In directions in which it is positive the bodies part beside the contact; in those in which it
    is negative they overlap. It is NaN at a pole or an umbilic.
    """
    states = plan.states(t, gaps=True)
    psi = states[..., 8]
    turn = np.array(equations.reflection_rows(np.cos(psi), np.sin(psi))).transpose(2, 3, 0, 1)
    relative = np.full_like(turn, np.nan)
    for i, contact in enumerate(plan.scene.contacts):
        known = np.isfinite(psi[:, i])
        tip = contact.finger.curvature_form(*states[known, i, 0:2].T)
        body = plan.scene.object.curvature_form(*states[known, i, 4:6].T)
        relative[known, i] = equations.relative_curvature(body, tip, turn[known, i])
    return relative


def overlaps(plan: Plan) -> list[str]:
    """Notes on contacts whose bodies overlap beside the contact point, which plans do not check."""
    t, notes = plan.regular_times(plan.sample_times()), list[str]()
    least = np.linalg.eigvalsh(relative_curvature(plan, t))[..., 0]
    for i, contact in enumerate(plan.scene.contacts):
        found = np.flatnonzero(least[:, i] < -CONFORMS / contact.finger.size)
        if len(found):
            notes.append(
                f"Note: {plan.scene.contact_title(i)}: from t = {t[found[0]]:.3g} s on the bodies "
                "overlap beside the contact point (the least relative curvature is "
                f"{least[found, i].min():.3g} 1/m), as real ones cannot. Make the finger smaller, "
                "or plan contact where the object is less concave."
            )
    return notes


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
