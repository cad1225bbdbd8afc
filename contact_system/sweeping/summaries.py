"""The default outputs of `sweep`."""

from __future__ import annotations

import numpy as np

from ..measures import REJECTED
from ..plan import Plan, require_plan

SAMPLES = 100  # times at which slip is evaluated


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
