"""What a hand did with its object, told and drawn: errors, friction, torques, limits."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_system.plots.style import INK, colour_of
from contact_system.terminal import paragraph, table

from .config import require_config
from .hand_kinematics import Chains
from .hand_station import HandResult
from .measures import EDGE, durations, path_slid, time_off

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HandReport:
    """Measures of a simulated hand. SI units, angles in rad; n fingers, nq joints.

    Attributes
    ----------
    off, turned_off : (m,)
        Distance of the object's origin from its path, and angle of its orientation.
    slipped, lost : (n,)
        Slip summed while touching, m, and time off the object, s.
    cones_planned, cones : (n,)
        The greatest part of a friction cone that is used; measured outside pushes and 0.1 s after,
        NaN if the finger never touches then.
    torque_share : (nq,)
        Greatest torque over its limit, in plan and run; of a joint that slides, force.
    room : (nq,)
        How near a joint comes to a limit, negative beyond it, in plan and run.
    """

    off: Array
    turned_off: Array
    slipped: Array
    lost: Array
    cones_planned: Array
    cones: Array
    torque_share: Array
    room: Array


def hand_report(result: HandResult) -> HandReport:
    """Measure what a hand did."""
    require_config(result, HandResult, "result")
    plan, chains, t = result.plan, result.plan.chains, result.t
    X, wanted = result.object_pose, result.wanted_pose
    apart = Rotation.from_matrix(X[:, :3, :3]) * Rotation.from_matrix(wanted[:, :3, :3]).inv()
    pushed = np.zeros(len(t), bool)
    for push in result.config.pushes:
        pushed |= (t >= push.start) & (t < push.stop + EDGE)
    used = result.measured["friction_used"][~pushed]
    seen = np.isfinite(used).any(axis=0)
    torques, q = np.vstack([plan.torques, result.torque]), np.vstack([plan.q, result.q])
    return HandReport(
        off=np.linalg.norm(X[:, :3, 3] - wanted[:, :3, 3], axis=1),
        turned_off=apart.magnitude(),
        slipped=path_slid(result).sum(axis=0),
        lost=time_off(result).sum(axis=0),
        cones_planned=plan.cones.max(axis=0),
        cones=np.where(seen, np.nanmax(used, axis=0, initial=0.0), np.nan),
        torque_share=(np.abs(torques) / chains.effort).max(axis=0),
        room=chains.room(q).min(axis=0),
    )


def hand_lines(result: HandResult) -> Iterable[str]:
    """What the command line tells of a hand."""
    told, plan = hand_report(result), result.plan
    head = [("finger", ""), ("normal force", "N"), ("cone planned", ""), ("cone measured", "")]
    head += (("slip", "mm"), ("off object", "s"), ("spin", "degrees"))
    normal = np.average(result.measured["normal_force"], axis=0, weights=durations(result))
    spin = np.abs(np.trapezoid(plan.spin, plan.t, axis=0))
    rows = [
        (
            result.scene.contact_name(i),
            f"{normal[i]:.3f}",
            f"{told.cones_planned[i]:.1%}",
            "-" if math.isnan(told.cones[i]) else f"{told.cones[i]:.1%}",
            f"{1e3 * told.slipped[i]:.3f}",
            f"{told.lost[i]:.3f}",
            f"{math.degrees(spin[i]):.1f}",
        )
        for i in range(len(normal))
    ]
    yield from (*table(head, rows, 1), "")
    first, last = Rotation.from_matrix(plan.object_pose[[0, -1], :3, :3])
    goal = (last * first.inv()).magnitude()
    yield paragraph(
        f"The object is to turn by {math.degrees(goal):.3g} degrees. At the end it is "
        f"{1e3 * told.off[-1]:.3g} mm and {math.degrees(told.turned_off[-1]):.3g} degrees from "
        "where it is to be then; on the way it was off its path by "
        f"{1e3 * told.off.max():.3g} mm and "
        f"{math.degrees(told.turned_off.max()):.3g} degrees at most."
    )
    yield paragraph(_of_joints(plan.chains, told))
    yield ""
    yield paragraph(
        "Cone: part of the friction cone that is used, measured outside pushes and 0.1 s after. "
        "Slip: summed. Spin: how far the plan turns the finger about the normal, which point "
        "contact does not resist."
    )
    yield ""


def _of_joints(chains: Chains, told: HandReport) -> str:
    k, j = int(np.argmax(told.torque_share)), int(np.argmin(told.room / chains.unit))
    torques = f"{told.torque_share[k]:.0%} of the limit at most, at {chains.names[k]}"
    if not np.isfinite(chains.effort).any():
        torques = "without limits, as the model has no actuators"
    near = f"{math.degrees(told.room[j]):.3g} degrees"
    if chains.slides[j]:
        near = f"{1e3 * told.room[j]:.3g} mm"
    return f"Torques: {torques}. Joints: {chains.names[j]} comes to {near} from a limit."


# --- panels of its picture ---------------------------------------------------------------------


def draw_errors(ax: Any, result: HandResult) -> None:
    told = hand_report(result)
    for values, style in ((1e3 * told.off, "-"), (np.degrees(told.turned_off), ":")):
        ax.plot(result.t, values, color=INK, linewidth=1.2, linestyle=style)
    _label(ax, "Object off its path (dotted: angle, degrees)", "distance [mm]")


def draw_slip(ax: Any, result: HandResult) -> None:
    for i, slipped in enumerate(1e3 * np.cumsum(path_slid(result), axis=0).T):
        ax.plot(result.t, slipped, color=colour_of(i), linewidth=1.2)
    _label(ax, "Slip, summed", "slip [mm]")


def draw_cones(ax: Any, result: HandResult) -> None:
    for i, used in enumerate(result.measured["friction_used"].T):
        ax.plot(result.t, used, color=colour_of(i), linewidth=1.2)
        ax.plot(result.plan.t, result.plan.cones[:, i], color=colour_of(i), linestyle="--")
    ax.axhline(result.config.friction_share, color=INK, linewidth=0.9, linestyle=":")
    title = "Part of the friction cone (dashed: planned; dotted: allowed)"
    _label(ax, title, r"$f_t / \mu N$", top=1.0)


def draw_torques(ax: Any, result: HandResult) -> None:
    for i, own in enumerate(result.plan.chains.joints):
        share = np.abs(result.torque[:, own]) / result.plan.chains.effort[own]
        ax.plot(result.t, share, color=colour_of(i), linewidth=0.9)
    _label(ax, "Torques over their limits, each joint", "part", top=1.0)


def _label(ax: Any, title: str, unit: str, top: float | None = None) -> None:
    ax.set_title(title, loc="left", weight="bold")
    ax.set_ylabel(unit)
    ax.set_ylim(0.0, top)


HAND_PANELS = (draw_errors, draw_slip, draw_cones, draw_torques)
