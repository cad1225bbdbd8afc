"""Reports on a simulation: on each contact, with a verdict, each push, the object and the hand."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_system import Scene, plan
from contact_system.checks import Array, of_kind
from contact_system.measures import REJECTED, windows

from .config import Push, body_names
from .contact_monitor import SATURATED
from .planner_base import EARLY
from .simulation import CONTINUOUS, NEAR, HandResult, SimulationResult, simulate

EDGE = 0.1  # s after the start, and around the edges of disturbances, that count as transient
STANDING = 1e-4  # of a contact's greatest speed; slip over a lower speed is not meaningful
ROLLS = 1e-2  # of sigma; a plan with less slip counts as rolling
# A contact slides if slip is above so many times that before any disturbance, and so many m/s.
SLIDING, CREEPING = 10.0, 1e-3
CARRIED = 0.95  # of the weight; an object of which less is carried falls
# A contact does not follow the plan if it is off by more than these parts of the path's length and
# of the finger's size; where contacts rest, compliance alone is a part of the path.
ASTRAY, BESIDE = 0.5, 0.05
LATELY, MOMENT = 0.5, 0.01  # s before the end that are judged, and over which a speed is measured


@dataclass(frozen=True, kw_only=True)
class ContactReport:
    """One contact of a simulation. SI units; NaN where there is nothing to measure.

    Attributes
    ----------
    name : str
    normal_mean, normal_deviation : float
        Of the normal force outside the transients [N].
    time_off : float
        Off the object, from the first step on [s].
    kept : bool
        Whether no contact of the simulation was ever off the object, and the object does not fall.
    friction_peak : float
        Greatest tangential force [N].
    friction_ratio : float
        Greatest ratio of the tangential force to mu times the normal force of the same moment,
        while that is at least half its mean (of all times if all are transient); NaN if mu is 0.
    planned_slip : float
        Greatest slip of the plan itself before any disturbance [m/s].
    plan_slip_time : float
        Time before any disturbance in which the plan's slip is more than 1 % of sigma [s].
    rolling_friction : float
        Mean tangential force before any disturbance, while the plan rolls [N].
    rolling_slip : float
        Mean ratio of slip to the speed of the contact point on the object, before any disturbance,
        while the plan rolls and that speed is more than 1e-4 of its greatest.
    pushed : bool
        Whether a push on this finger or on the object began.
    disturbed_slip : float
        Mean slip during the contact's last disturbance that is over [m/s].
    saturated : float
        Part of that disturbance's time in which friction was saturated.
    slid : bool
        Whether the contact slid in that disturbance: while it touched, friction reached its limit,
        or slip was over ten times `slip_before` and 1 mm/s, as friction of "lagged" is too small.
    slip_before : float
        Greatest slip before any disturbance [m/s].
    recovery : float
        Time from the disturbance's end until slip stays below 5 % of `disturbed_slip`, or below
        `slip_before` if that is greater [s]; inf if slip is still above after the time `followed`.
    followed : float
        Time from the disturbance's end until the next disturbance or push of any body begins, or
        the simulation ends [s].
    reported : float
        Recovery time in the paper [s].
    distance : float
        Greatest distance on the object, before any disturbance, of the measured contact point from
        that of the plan before restarts [m].
    path : float
        Length of the path on the object, as planned before restarts [m].
    astray : bool
        Whether `distance` is more than half of `path` and 5 % of the finger's size, as if bodies
        touch almost along a line, or at a second place.
    """

    name: str
    normal_mean: float
    normal_deviation: float
    time_off: float
    kept: bool
    friction_peak: float
    friction_ratio: float
    planned_slip: float
    plan_slip_time: float
    rolling_friction: float
    rolling_slip: float
    pushed: bool
    disturbed_slip: float = math.nan
    saturated: float = math.nan
    slid: bool = False
    slip_before: float
    recovery: float = math.nan
    followed: float = math.nan
    reported: float = math.nan
    distance: float
    path: float
    astray: bool

    @property
    def disturbed(self) -> bool:
        """Whether a disturbance of this contact is over."""
        return not math.isnan(self.disturbed_slip)

    @property
    def verdict(self) -> str:
        """The outcome in a word or two.

        "came off": the finger was off the object; "not kept": another one was, or the object falls.
        "astray": it does not follow the plan even before any disturbance. "undisturbed", "pushed":
        no disturbance of it is over by the end. "held": friction alone withstood the disturbance.
        Else slip was "rejected" or "not rejected"; if the paper reports a time, it was rejected "as
        reported", "not as reported", or is "still recovering", if followed for less than that time.
        """
        if not self.kept:
            return "came off" if self.time_off else "not kept"
        if self.astray:
            return "astray"
        if not self.disturbed:
            return "pushed" if self.pushed else "undisturbed"
        if not self.slid:
            return "held"
        gone = math.isfinite(self.recovery)
        if math.isnan(self.reported):
            return "rejected" if gone else "not rejected"
        if self.recovery <= self.reported:
            return "as reported"
        return "not as reported" if gone or self.followed >= self.reported else "still recovering"


@dataclass(frozen=True)
class ObjectReport:
    """How far the object moved, and whether it falls.

    Attributes
    ----------
    moved, turned : float
        Greatest distance and angle from where it began [m], [rad].
    carried : float
        Part of its weight that is balanced, at most 1: 1 + a/g, a the mean upward acceleration in
        the last 0.5 s, less that of its path in a hand. NaN without gravity, if the object is not
        free, and in simulations shorter than 0.02 s.
    """

    moved: float
    turned: float
    carried: float

    @property
    def falls(self) -> bool:
        """Whether gravity is not balanced."""
        return self.carried < CARRIED


@dataclass(frozen=True)
class PushReport:
    """What a push did to its finger, or one on the object to the worst one, until the next began.

    Attributes
    ----------
    push : Push
    slip : float
        Summed while touching [m].
    time_off : float
        Off the object [s].
    farthest, left : float
        Greatest and last distance of the contact point from that of the plan before restarts [m].
    """

    push: Push
    slip: float
    time_off: float
    farthest: float
    left: float


@dataclass(frozen=True)
class HandReport:
    """Measures of a simulated hand. SI units, angles in rad; n fingers, nq joints.

    Attributes
    ----------
    off, turned_off : (m,)
        Distance of the object's origin from its path, and angle of its orientation.
    slipped, time_off : (n,)
        Slip summed while touching, m, and time off the object, s.
    cones_planned, cones : (n,)
        The greatest part of a friction cone that is used; measured outside pushes and 0.1 s after,
        NaN if the finger never touches then.
    torque_share : (nq,)
        Greatest torque over its limit, in plan and simulation; for a sliding joint, force.
    room : (nq,)
        Least distance of a joint from its limits in plan and simulation, negative beyond a limit.
    """

    off: Array
    turned_off: Array
    slipped: Array
    time_off: Array
    cones_planned: Array
    cones: Array
    torque_share: Array
    room: Array


def outcome(scene: Scene, duration: float | None = None) -> dict[str, Array]:
    """Simulate a scene as its ``[drake]`` table says, and report on each contact.

    For sweeps: ``cs.sweep(scenes, drake_plant.outcome, executor, each=True, folder="runs")``.

    Parameters
    ----------
    scene : Scene
    duration : float, optional
        s; None: the scene's.

    Returns
    -------
    dict
        ``verdict`` and all numbers of its :class:`ContactReport`, (n_contacts,); ``object_moved``,
        m, and ``object_turned``, rad, the same for all.

    Raises
    ------
    SceneError
        What :func:`simulate` raises.
    """
    result = simulate(scene, duration=duration)
    reports, body = contact_table(result), object_report(result)
    names = ["verdict", *(f.name for f in fields(ContactReport) if f.name != "name")]
    found = {name: np.array([getattr(report, name) for report in reports]) for name in names}
    whole = {"object_moved": body.moved, "object_turned": body.turned}
    return found | {name: np.full(len(reports), value) for name, value in whole.items()}


def object_report(result: SimulationResult) -> ObjectReport:
    """How far the object moved and turned, and whether it falls."""
    of_kind(SimulationResult, result, "result", "a SimulationResult")
    poses = result.object_pose
    path = poses[:, :3, 3] - poses[0, :3, 3]
    config, carried = result.config, math.nan
    if config.gravity and config.object == "free" and np.ptp(result.t) >= 2 * MOMENT:
        carried = min(1.0, 1 + _acceleration(result) / config.gravity)
    farthest, most = np.linalg.norm(path, axis=1).max(), angles_between(poses, poses[0]).max()
    return ObjectReport(float(farthest), float(most), float(carried))


def angles_between(one: Array, other: Array) -> Array:
    """Angles between the orientations of two arrays of poses (..., 4, 4): (...), rad."""
    turns = [Rotation.from_matrix(X[..., :3, :3]) for X in (one, other)]
    return (turns[0] * turns[1].inv()).magnitude()


def _acceleration(result: SimulationResult) -> float:
    """The object's mean upward acceleration in the last `LATELY`, m/s^2. It follows from two
    speeds, so pushes cancel out from which the object has come back."""
    end, time = result.t[-1], min(LATELY, result.t[-1] - result.t[0])
    wanted = getattr(result, "wanted_pose", result.object_pose[:1])
    marks = end - np.array([time, time - MOMENT, MOMENT, 0.0])
    z = np.interp(marks, result.t, result.object_pose[:, 2, 3] - wanted[:, 2, 3])
    return float((z[3] - z[2] - z[1] + z[0]) / MOMENT / (time - MOMENT))


def push_table(result: SimulationResult) -> list[PushReport]:
    """What each push of a simulation did, in the order of time."""
    of_kind(SimulationResult, result, "result", "a SimulationResult")
    pushes = sorted(result.config.pushes, key=lambda push: push.start)
    names = body_names(result.scene)
    apart = np.linalg.norm(misses(result), axis=2)
    slips, away, reports = path_slid(result), time_off(result), []
    for push in pushes:
        stop = min((p.start for p in pushes if p.start > push.start), default=math.inf)
        seen = (result.t > push.start) & (result.t <= stop)
        if seen.any():
            on = slice(None) if push.on == "object" else [names.index(push.on)]
            slid = slips[seen][:, on].sum(0)
            off, miss = away[seen][:, on].sum(0), apart[seen][:, on]
            found = (slid.max(), off.max(), miss.max(), miss[-1].max())
            reports.append(PushReport(push, *map(float, found)))
    return reports


def contact_table(result: SimulationResult) -> list[ContactReport]:
    """Measure every contact of a simulation, in the scene's order."""
    of_kind(SimulationResult, result, "result", "a SimulationResult")
    planned, t = plan(result.scene), result.t  # the plan knows the windows of every contact
    disturbed = [windows(planned, i) for i in range(len(result.scene.contacts))]
    pushes = [(push.start, push.stop) for push in result.config.pushes]
    acting = np.array([*itertools.chain(*disturbed), *pushes]).reshape(-1, 2)
    early = t < acting[:, 0].min(initial=math.inf)
    steady = (t >= EDGE) & (np.abs(t[:, None] - acting.ravel()) > EDGE).all(1)
    off, reports = time_off(result).sum(0), []
    kept = not off.any() and not object_report(result).falls
    for i, spans in enumerate(disturbed):
        found = _rolling(result, i, early, steady)
        found |= _rejection(result, i, spans, acting[:, 0], found["slip_before"])
        name, size = result.scene.contact_name(i), result.scene.contacts[i].finger.size
        astray = found["distance"] > max(ASTRAY * found["path"], BESIDE * size)
        pushed = any(p.on in (name, "object") and p.start < t[-1] for p in result.config.pushes)
        found |= {"kept": kept, "time_off": float(off[i]), "pushed": pushed, "astray": astray}
        reports.append(ContactReport(name=name, **found))
    return reports


def hand_report(result: HandResult) -> HandReport:
    """Measure what a hand did."""
    of_kind(HandResult, result, "result", "a HandResult")
    plan, chains, t = result.plan, result.plan.chains, result.t
    X, wanted = result.object_pose, result.wanted_pose
    pushed = np.zeros(len(t), bool)
    for push in result.config.pushes:
        pushed |= (t >= push.start) & (t < push.stop + EDGE)
    used = result.measured["friction_used"][~pushed]
    seen = np.isfinite(used).any(axis=0)
    torques, q = np.vstack([plan.torques, result.torque]), np.vstack([plan.q, result.q])
    return HandReport(
        off=np.linalg.norm(X[:, :3, 3] - wanted[:, :3, 3], axis=1),
        turned_off=angles_between(X, wanted),
        slipped=path_slid(result).sum(axis=0),
        time_off=time_off(result).sum(axis=0),
        cones_planned=plan.cones.max(axis=0),
        cones=np.where(seen, np.nanmax(used, axis=0, initial=0.0), np.nan),
        torque_share=(np.abs(torques) / chains.effort).max(axis=0),
        room=chains.room(q).min(axis=0),
    )


def path_slid(result: SimulationResult) -> Array:
    """How far each contact slid in the time that a row stands for, while it touches, (m, n), m."""
    slip = np.linalg.norm(result.measured["slip"], axis=2)
    touches = result.measured["normal_force"] > 0
    return durations(result)[:, None] * slip * touches


def time_off(result: SimulationResult) -> Array:
    """Time that each contact was off the object, of that which a row stands for, (m, n), s."""
    return durations(result)[:, None] * (result.measured["normal_force"] <= 0)


def durations(result: SimulationResult) -> Array:
    """The time that each row stands for, (m,), s.

    Steps with a finger off the object are all logged, and a row of one stands for it alone. Other
    rows stand for all other steps since the last row of their kind.
    """
    since = np.diff(result.t, prepend=result.t[0])
    off = (result.measured["normal_force"] <= 0).any(axis=1)
    longest = result.config.time_step or CONTINUOUS.max_step_size
    lasts = np.where(off, np.minimum(since, longest), 0.0)
    lasts[~off] = np.diff(np.cumsum(since - lasts)[~off], prepend=0.0)
    return lasts


def planned_points(result: SimulationResult) -> Array:
    """Contact points on the object, (m, n, 3), m, as planned before any restart."""
    return result.planned.get("first_contact_point", result.planned["contact_point"])


def misses(result: SimulationResult) -> Array:
    """From planned to measured contact points on the object, (m, n, 3), m."""
    return result.measured["contact_point"] - planned_points(result)


def recovery_time(t: Array, slip: Array, since: float, level: float) -> float:
    """Time from ``since`` until slip is below a level for good, s: 0 if it is never above, inf if
    it is not below at the end, or if there is no row after ``since``."""
    after = t >= since - EARLY  # rows are at an edge but for rounding
    t, above = t[after], slip[after] >= level
    if not len(t) or above[-1]:
        return math.inf
    return float(t[np.flatnonzero(above)[-1] + 1] - since) if above.any() else 0.0


def _rolling(
    result: SimulationResult, i: int, early: NDArray[np.bool_], steady: NDArray[np.bool_]
) -> dict[str, Any]:
    """Fields of a ContactReport: forces, at `steady` times or all, and slip at `early` ones."""
    t, before, time = result.t, early & (result.t >= EDGE), durations(result)
    normal, used = (result.measured[key][:, i] for key in ("normal_force", "friction_used"))
    friction = np.linalg.norm(result.measured["tangential_force"][:, i], axis=1)
    mean = _mean(normal[steady], time[steady])
    usual = mean if steady.any() else _mean(normal[normal > 0], time[normal > 0])
    pressed = (normal > 0.5 * usual) & np.isfinite(used)
    slip, of_plan = (
        np.linalg.norm(logs["slip"][:, i], axis=1) for logs in (result.measured, result.planned)
    )
    states, obj = result.planned["state"][:, i], result.scene.object
    root = obj.metric_root(states[:, 4], states[:, 5])
    speed = np.linalg.norm(np.einsum("mij,mj->mi", root, states[:, 6:8]), axis=1)  # on the object
    steps = np.diff(planned_points(result)[:, i], axis=0)
    slips = of_plan > ROLLS * result.scene.speeds(t)[:, i]
    moves = before & ~slips & (speed > STANDING * speed.max())  # a path may start or end at rest
    return {
        "normal_mean": mean,
        "normal_deviation": _mean((normal[steady] - mean) ** 2, time[steady]) ** 0.5,
        "friction_peak": float(friction.max()),
        "friction_ratio": _greatest(used[pressed]),
        "planned_slip": _greatest(of_plan[early]),
        "plan_slip_time": float((early & slips) @ time),
        "rolling_friction": _mean(friction[before & ~slips], time[before & ~slips]),
        "rolling_slip": _mean(slip[moves] / speed[moves], time[moves]),
        "slip_before": _greatest(slip[before]),
        "distance": _greatest(np.linalg.norm(misses(result)[before, i], axis=1)),
        "path": float(np.linalg.norm(steps, axis=1).sum()),
    }


def _rejection(
    result: SimulationResult,
    i: int,
    disturbed: list[tuple[float, float]],
    begins: Array,
    before: float,
) -> dict[str, Any]:
    """Fields of a ContactReport on the last disturbance that is over; none if there is none.

    disturbed : when the contact's disturbances start and stop; begins : when any body's begin, s
    before : greatest slip before any disturbance, m/s
    """
    t, slip = result.t, np.linalg.norm(result.measured["slip"][:, i], axis=1)
    over = [window for window in disturbed if window[1] <= t[-1]]
    if not over:
        return {}
    start, stop = over[-1]
    # rows of the steps that began in the disturbance, up to rounding; row 0 is not of a step
    later = (1 - NEAR) * result.config.time_step
    first, last = np.maximum(np.searchsorted(t, (start + later, stop + later)), 1)
    # A disturbance may fall between two rows: the row after it counts too.
    during, seen = slice(first, max(last, first + 1)), slice(first, last + 1)
    normal, used = (result.measured[key][:, i] for key in ("normal_force", "friction_used"))
    time = durations(result)[during]
    mean = _mean(slip[during], time)
    level = np.fmax(REJECTED * mean, before)
    at_limit, sliding = used >= SATURATED, slip > np.fmax(SLIDING * before, CREEPING)
    slid = bool((at_limit | sliding & (normal > 0))[seen].any())
    until = begins[begins >= stop].min(initial=t[-1])
    followed = t <= until
    return {
        "disturbed_slip": mean,
        "saturated": _mean(at_limit[during], time),
        "slid": slid,
        "recovery": recovery_time(t[followed], slip[followed], stop, level) if slid else math.nan,
        "followed": float(until - stop),
        "reported": result.scene.paper.get("recovery_time", math.nan),
    }


def _mean(values: NDArray[Any], durations: Array) -> float:
    """The mean over time of values that last for the durations; NaN if there are none."""
    return float(np.average(values, weights=durations)) if durations.any() else math.nan


def _greatest(values: Array) -> float:
    return float(values.max()) if len(values) else math.nan
