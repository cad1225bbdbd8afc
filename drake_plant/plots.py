"""Pictures of a simulation: slip, forces and contact curves, measured beside planned.

Colours, and bodies, are drawn as in :mod:`contact_system.plots`. matplotlib is imported only when a
picture is drawn.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from contact_system import Plan, plan
from contact_system.checks import Array, of_kind
from contact_system.plots import Picture, contact_keys, draw_title, shade_windows
from contact_system.plots.bodies import best_view, draw_body, is_hidden
from contact_system.plots.curves import curve_of
from contact_system.plots.meshes import mesh_of
from contact_system.plots.style import DISTURBED, INK, RECOVERY, colour_of

from .measures import hand_report, misses, path_slid
from .simulation import HandResult, SimulationResult

SMOOTH = 0.02  # s over which the bold line of a rippling signal is averaged
BOLD = f"bold: mean of {1e3 * SMOOTH:g} ms"
INTEGRATED = 1e-4  # of the greatest path speed; less slip in a plan is an error of integration
APART = 0.02  # distance of dots on a planned curve, of the picture's diagonal


def plot(
    result: SimulationResult,
    path: str | os.PathLike[str],
    dpi: int = 160,
    opened: SimulationResult | None = None,
) -> None:
    """One picture: contact curves on the object; slip, forces and distances over time.

    Parameters
    ----------
    result : SimulationResult
    path : path
        Its ending chooses the format (.png, .pdf, .svg).
    dpi : int
        Dots an inch, 10 to 2400; the picture is 13 by 9 inches.
    opened : SimulationResult, optional
        The same simulation with the loop open; its slip and distances are drawn too.

    Raises
    ------
    MissingMatplotlib
        If it is not installed.
    """
    of_kind(SimulationResult, result, "result", "a SimulationResult")
    planned = plan(result.scene)
    with Picture(path, (13, 9), dpi) as figure:
        left, right = figure.subfigures(1, 2, width_ratios=(1, 1.15))
        draw_title(left, planned, moves=not isinstance(result, HandResult))
        _draw_curves(left.add_axes((0.02, 0.18, 0.96, 0.68)), result, planned)
        _key(left.add_axes((0.05, 0.02, 0.9, 0.15)), result)
        panels: Sequence[Any] = HAND_PANELS if isinstance(result, HandResult) else PANELS
        place = {"left": 0.12, "right": 0.96, "bottom": 0.065, "top": 0.96, "hspace": 0.065 / 0.175}
        axes = right.subplots(len(panels), sharex=True, gridspec_kw=place)
        axes[-1].set_xlabel("time [s]")
        for ax, draw in zip(axes, panels):
            draw(ax, result)
            if opened is not None and draw in (_draw_slip, _draw_distance):
                draw(ax, opened, closed=False)
            _finish(ax, result, planned)


# --- over time ---------------------------------------------------------------------------------


def _draw_slip(ax: Any, result: SimulationResult, closed: bool = True) -> None:
    """Measured slip and, dashed, that of the plan; with the loop open only measured, dotted."""
    slip, planned = (
        np.linalg.norm(logs["slip"], axis=2) for logs in (result.measured, result.planned)
    )
    peak = max(slip.max(), planned.max())
    _each(ax, result.t, slip, linewidth=0.9, linestyle="-" if closed else ":")
    title = "Slip (dotted: loop open)"
    if closed:
        fastest = result.scene.speeds(result.t).max()
        shown = np.where(planned > INTEGRATED * fastest, planned, np.nan)
        _each(ax, result.t, shown, linewidth=1.6, dashes=(2.2, 1.1))
        title = "Slip, measured" + " (dashed: of the plan)" * bool(np.isfinite(shown).any())
    ax.set_yscale("log")
    if peak > 0:
        ax.set_ylim(1e-5 * peak, 3 * peak)
    ax.set(title=title, ylabel="slip [m/s]")


def _draw_normal(ax: Any, result: SimulationResult) -> None:
    wanted = result.planned["normal_force"]
    _draw_rippling(ax, result.t, result.measured["normal_force"], wanted, 2 * wanted.max())
    ax.set(title=f"Normal force ({BOLD}; dotted: asked for)", ylabel="force [N]")


def _draw_friction(ax: Any, result: SimulationResult) -> None:
    """Tangential forces, or, if forces balance gravity, the part of the friction cones used."""
    if result.config.balances:
        used = np.nan_to_num(result.measured["friction_used"])
        _draw_rippling(ax, result.t, used, result.planned["friction_used"], 1.3)
        ax.axhline(1.0, color=INK, linewidth=0.9)
        title = "Friction used (line: all of the cone; dotted: planned)"
        ax.set(title=title, ylabel="part of the cone")
        return
    friction = np.linalg.norm(result.measured["tangential_force"], axis=2)
    limit = result.config.friction * result.planned["normal_force"]
    _draw_rippling(ax, result.t, friction, limit, 1.3 * limit.max())
    ax.set(title=rf"Tangential force ({BOLD}; dotted: $\mu N$)", ylabel="force [N]")


def _draw_distance(ax: Any, result: SimulationResult, closed: bool = True) -> None:
    distance = 1e3 * np.linalg.norm(misses(result), axis=2)
    _each(ax, result.t, distance, linewidth=1.2, linestyle="-" if closed else ":")
    ax.set(title="Measured contact point from the planned one", ylabel="distance [mm]")
    ax.relim()
    ax.set_ylim(bottom=0.0, top=1.05 * ax.dataLim.ymax or None)


def _draw_errors(ax: Any, result: HandResult) -> None:
    report = hand_report(result)
    for values, style in ((1e3 * report.off, "-"), (np.degrees(report.turned_off), ":")):
        ax.plot(result.t, values, color=INK, linewidth=1.2, linestyle=style)
    ax.set(
        title="Object off its path (dotted: angle, degrees)", ylabel="distance [mm]", ylim=(0, None)
    )


def _draw_slipped(ax: Any, result: HandResult) -> None:
    _each(ax, result.t, 1e3 * np.cumsum(path_slid(result), axis=0), linewidth=1.2)
    ax.set(title="Slip, summed", ylabel="slip [mm]", ylim=(0, None))


def _draw_cones(ax: Any, result: HandResult) -> None:
    _each(ax, result.t, result.measured["friction_used"], linewidth=1.2)
    _each(ax, result.plan.t, result.plan.cones, linestyle="--")
    ax.axhline(result.config.friction_share, color=INK, linewidth=0.9, linestyle=":")
    title = "Part of the friction cone (dashed: planned; dotted: allowed)"
    ax.set(title=title, ylabel=r"$f_t / \mu N$", ylim=(0, 1))


def _draw_torques(ax: Any, result: HandResult) -> None:
    for i, joints in enumerate(result.plan.chains.joints):
        share = np.abs(result.torque[:, joints]) / result.plan.chains.effort[joints]
        ax.plot(result.t, share, color=colour_of(i), linewidth=0.9)
    ax.set(title="Torques over their limits, each joint", ylabel="part", ylim=(0, 1))


PANELS = (_draw_slip, _draw_normal, _draw_friction, _draw_distance)
HAND_PANELS = (_draw_errors, _draw_slipped, _draw_cones, _draw_torques)


def _each(ax: Any, t: Array, values: Array, **line: Any) -> None:
    """A line for each contact, of the columns of values (m, n)."""
    for i, column in enumerate(values.T):
        ax.plot(t, column, color=colour_of(i), **line)


def _draw_rippling(ax: Any, t: Array, values: Array, wanted: Array, top: float) -> None:
    """Signals, pale, and their running means, without the start, and, dotted, wanted values."""
    late, values = t[1:], values[1:]
    _each(ax, late, values, linewidth=0.5, alpha=0.35)
    if len(late) > 1:  # rows may be unequally far apart
        integral = make_interp_spline(late, values, k=1).antiderivative()
        since, until = (np.clip(late + w, late[0], late[-1]) for w in (-SMOOTH / 2, SMOOTH / 2))
        means = (integral(until) - integral(since)) / (until - since)[:, None]
        _each(ax, late, means, linewidth=1.5)
    ax.plot(t, wanted, color=INK, linewidth=0.9, linestyle=":")
    ax.set_ylim(0.0, top or None)


def _finish(ax: Any, result: SimulationResult, planned: Plan) -> None:
    ax.set_xlim(result.t[0], result.t[-1])
    ax.grid(axis="y", color="#e4e7eb", linewidth=0.8)
    ax.set_axisbelow(True)
    if result.scene.disturbances:
        shade_windows(ax, planned)
    for push in result.config.pushes:
        ax.axvspan(push.start, push.stop, color=DISTURBED, alpha=0.3, linewidth=0)


# --- on the object -----------------------------------------------------------------------------


def _draw_curves(ax: Any, result: SimulationResult, planned: Plan) -> None:
    """Measured contact curves on the object, and dots on the planned ones."""
    contacts, points = range(len(result.scene.contacts)), result.measured["contact_point"]
    curves = [curve_of(planned, i, result.t, points[:, i]) for i in contacts]
    mesh = mesh_of(planned, 1, contacts)
    draw_body(ax, mesh, curves)
    view = best_view(mesh, curves)
    dots = {"linestyle": "none", "marker": "o", "markersize": 1.7, "color": "white"}
    for points in result.planned["contact_point"].swapaxes(0, 1):
        seen = points[~is_hidden(mesh, view, points)] @ view
        ax.plot(*seen.T[:2], **dots, markevery=APART, zorder=7)


def _key(ax: Any, result: SimulationResult) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    scene, end = result.scene, result.t[-1]
    entries = contact_keys(scene)
    label = "measured curve, dots where planned"
    dots = {"marker": "o", "markersize": 2.5, "markerfacecolor": "white", "markeredgewidth": 0}
    entries.append(Line2D([], [], color=INK, linewidth=2.4, label=label, **dots))
    disturbed = any(d.start < end for d in scene.disturbances)
    if disturbed or any(push.start < end for push in result.config.pushes):
        label = "disturbance" if disturbed else "push"
        entries.append(Patch(color=DISTURBED, alpha=0.3, label=label))
    over = max((d.stop for d in scene.disturbances), default=end) < end
    if over and "recovery_time" in scene.paper:
        entries.append(Patch(color=RECOVERY, alpha=0.2, label="recovery time in the paper"))
    ax.set_axis_off()
    ax.legend(handles=entries, loc="upper left", ncols=2, frameon=False, handlelength=2.2)
