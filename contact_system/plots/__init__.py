"""Pictures of a plan: contact curves on the bodies in 3-D, slip on a log axis.

matplotlib is imported when the first picture is drawn; no display is needed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..checks import finite_number
from ..errors import ContactSystemError
from ..files import a_path, writing
from ..measures import exact_slip, windows
from ..plan import Plan, require_plan
from ..scene import Scene
from ..theory.gain import Gain
from ..theory.profile import Profile
from .bodies import draw_body
from .curves import curves_of, distinct
from .meshes import mesh_of
from .style import (
    COLOURS,
    DISTURBED,
    DOTS,
    GREY,
    INK,
    NUMBER,
    RECOVERY,
    STYLE,
    colour_of,
    number_of,
    shortened,
)

FEWEST, MOST = 10, 2400  # dots per inch; below, text cannot be drawn
DECADES = 10  # of slip shown below its peak


class MissingMatplotlib(ContactSystemError):
    """A picture needs matplotlib, which is not installed."""


# --- pictures ----------------------------------------------------------------------------------


def plot(
    plan: Plan, path: str | os.PathLike[str], other: Plan | None = None, dpi: int = 160
) -> None:
    """One picture: contact curves on the object and on a finger, slip beside its exact law.

    Parameters
    ----------
    plan : Plan
    path : path
        The ending selects the format (.png, .pdf, .svg).
    other : Plan, optional
        The same scene under another gain law; its slip is drawn beside this one's.
    dpi : int
        Dots per inch, 10 to 2400; the picture is 12 by 6 inches.

    Raises
    ------
    MissingMatplotlib
        matplotlib is not installed.
    ContactSystemError
        A wrong argument, an unknown ending, or a file that cannot be written.
    """
    plans = _plans(plan, other)
    slips = plan.slip_speed(plan.sample_times()).any()
    with Picture(path, (12, 6), dpi) as figure:
        left, right = figure.subfigures(1, 2, width_ratios=(1, 0.95))
        draw_title(left, plan)
        _draw_object(left.add_axes((0.02, 0.04, 0.94, 0.80)), plan)
        _draw_slip(right.add_axes((0.15, 0.52, 0.79, 0.42)), plans)
        _draw_finger(right.add_axes((0.04, 0.02, 0.42, 0.37)), plan)
        _draw_key(right.add_axes((0.53, 0.01, 0.45, 0.39)), plan, plans if slips else ())


def plot_curves(plan: Plan, path: str | os.PathLike[str], dpi: int = 160) -> None:
    """Contact curves in 3-D, on the object and on a finger; see :func:`plot`."""
    require_plan(plan)
    with Picture(path, (12, 6), dpi) as figure:
        draw_title(figure, plan)
        _draw_object(figure.add_axes((0.02, 0.04, 0.58, 0.80)), plan)
        _draw_finger(figure.add_axes((0.63, 0.38, 0.34, 0.46)), plan)
        _draw_key(figure.add_axes((0.68, 0.03, 0.30, 0.30)), plan)


def plot_slip(
    plan: Plan, path: str | os.PathLike[str], other: Plan | None = None, dpi: int = 160
) -> None:
    """Slip magnitude of each contact on a log axis beside its exact law; see :func:`plot`."""
    plans = _plans(plan, other)
    with Picture(path, (11, 5), dpi) as figure:
        _draw_slip(figure.add_axes((0.09, 0.13, 0.62, 0.77)), plans)
        _draw_key(figure.add_axes((0.73, 0.13, 0.26, 0.77)), plan, plans, bodies=False)


def _plans(plan: Plan, other: Plan | None) -> list[Plan]:
    plans = [plan] if other is None else [plan, other]
    for one in plans:
        require_plan(one)
    return plans


@contextmanager
def Picture(path: str | os.PathLike[str], size: tuple[float, float], dpi: int) -> Iterator[Any]:
    """A figure in the common style, written to its path at the end."""
    path, dots = a_path(path), finite_number(dpi, "dpi")
    if not FEWEST <= dots <= MOST:
        raise ContactSystemError(f"dpi = {dpi!r}: give a number from {FEWEST} to {MOST}")
    try:
        import matplotlib
        from matplotlib.backend_bases import FigureCanvasBase
        from matplotlib.figure import Figure
    except ImportError as error:
        remedy = f'pictures need matplotlib: pip install "contact-system[plot]" ({error})'
        raise MissingMatplotlib(remedy) from None
    ending = path.suffix[1:].lower()
    if ending not in FigureCanvasBase.get_supported_filetypes():
        raise ContactSystemError(f"{path}: unknown ending {path.suffix!r}; use .png, .pdf or .svg")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, facecolor="white")
        yield figure
        with writing(path) as file:
            figure.savefig(file, format=ending, dpi=dots)


# --- titles and legends ------------------------------------------------------------------------


def draw_title(figure: Any, plan: Plan, moves: bool = True) -> None:
    """A scene's name and description at the top; profile and gain too if they move the contacts."""
    scene = plan.scene
    legs_alone = all(contact.legs for contact in scene.contacts)
    sigma = "of legs" if legs_alone else f"= {_polynomial(scene.profile)} m/s"
    facts = f"σ {sigma},   gain {gain_text(scene.gain)}" if moves else ""
    name = figure.text(0.035, 0.955, shortened(scene.name, 30), size=18, weight="bold")
    right = figure.text(0.965, 0.955, facts, size=10, ha="right", color=GREY)
    if right.get_window_extent().x0 < name.get_window_extent().x1 + 10:  # no room beside the name
        right.set(x=0.035, y=0.865, ha="left")
    figure.text(0.035, 0.905, shortened(scene.description, 84), size=11)


def gain_text(gain: Gain) -> str:
    """Short name of a gain law, such as 'path, eta = 100'."""
    return f"{gain.law}, {gain.parameter} = {gain.value:g}"


def _polynomial(profile: Profile) -> str:
    """The profile as text, such as '0.001 + 0.4·t²'; terms of 0 are left out."""
    raised = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
    powers = ["", "·t", *(f"·t{k}".translate(raised) for k in range(2, len(profile.coefficients)))]
    terms = [f"{c:.4g}{power}" for c, power in zip(profile.coefficients, powers) if c]
    return shortened(" + ".join(terms).replace("+ -", "- ") or "0", 50)


def contact_keys(scene: Scene) -> list[Any]:
    """Legend entries of the contacts: one for each colour, with the numbers of its contacts."""
    entries, count = [], len(scene.contacts)
    for i in range(min(count, len(COLOURS))):
        others = (number_of(scene, k) for k in range(i + len(COLOURS), count, len(COLOURS)))
        names = shortened(", ".join([scene.contact_name(i), *others]), 26)
        entries.append(_entry(names, color=colour_of(i), linewidth=2.4))
    return entries


def _entry(label: str, **style: Any) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **style)


def _draw_key(ax: Any, plan: Plan, plans: Sequence[Plan] = (), bodies: bool = True) -> None:
    """The legend, of slip under one or two gain laws, of the bodies, or of both."""
    from matplotlib.patches import Patch

    entries = []
    for k, one in enumerate(plans):
        text = f"gain {gain_text(one.scene.gain)}"
        entries.append(_entry(text, color=INK, linewidth=2.2, linestyle="--" if k else "-"))
    contacts = range(len(plan.scene.contacts))
    if plans and any(len(exact_slip(plan, i)[0]) for i in contacts):
        entries.append(_entry("exact law", **DOTS))
    if plans and "recovery_time" in plan.scene.paper:
        entries.append(Patch(color=RECOVERY, alpha=0.2, label="recovery time in the paper"))
    entries += contact_keys(plan.scene)
    if plan.scene.disturbances:
        entries.append(_entry("disturbance", color=DISTURBED, linewidth=2.4))
    if bodies:
        entries.append(_entry("behind the body", color=INK, linewidth=1.3, alpha=0.35))
        if any(contact.legs for contact in plan.scene.contacts):
            entries.append(_entry("number of a leg", **NUMBER))
            entries.append(_entry("the finger's frame", color=INK, linewidth=1.3))
    room = 72 * ax.bbox.height / ax.figure.dpi  # points; a line takes 1.6 of its size
    size = min(STYLE["legend.fontsize"], room / (1.6 * len(entries)))
    ax.set_axis_off()
    ax.legend(handles=entries, loc="center left", frameon=False, handlelength=2.2, fontsize=size)


# --- slip --------------------------------------------------------------------------------------


def _draw_slip(ax: Any, plans: Sequence[Plan]) -> None:
    plan = plans[0]
    slip = np.concatenate([_slip_lines(ax, one, dashed=k > 0) for k, one in enumerate(plans)])
    ax.set_xlim(plan.start, plan.end)
    ax.set_xlabel("time [s]")
    ax.ticklabel_format(axis="x", scilimits=(-2, 4))  # longer numbers run into each other
    if not slip.any():
        _draw_speed(ax, plan)
        return
    ax.set_yscale("log")
    # show at least 3 decades, and at most DECADES, below the peak
    peak, least = slip.max(), slip[slip > 0].min()
    ax.set_ylim(max(peak * 10.0**-DECADES, min(least / 5, peak / 1e3)), peak * 10)
    ax.set_ylabel("slip [m/s]")
    ax.grid(axis="y", color="#e4e7eb", linewidth=0.8)
    ax.set_axisbelow(True)
    shade_windows(ax, plan)
    ax.set_title("Slip at the contacts")


def _slip_lines(ax: Any, plan: Plan, dashed: bool) -> np.ndarray:
    """Draw the slip of one plan and return it, (n, n_contacts), m/s."""
    t = plan.sample_times(1201)
    # slip by a rate offset jumps at an edge: also draw the slip just before
    t = np.unique(np.append(t, np.nextafter(t[np.isin(t, plan.scene.edges) & (t > plan.start)], 0)))
    slip = plan.slip_speed(t)
    dashes: dict[str, Any] = {"dashes": (2.2, 1.1)} if dashed else {}
    _draw_lines(ax, t, np.where(slip > 0, slip, np.nan), **dashes)
    for i in np.flatnonzero(slip.any(axis=0)).tolist():
        ax.plot(*exact_slip(plan, i), markeredgewidth=0.9, zorder=5, **DOTS)
    return slip


def _draw_lines(ax: Any, t: np.ndarray, values: np.ndarray, **style: Any) -> None:
    """Draw a line for each contact through its values, (n, n_contacts)."""
    for i, line in enumerate(values.T):
        # where lines coincide the lower ones are wider, so that each is visible
        same = np.isclose(values[:, i + 1 :], line[:, None], rtol=0.02, equal_nan=True)
        width = 1.8 + 1.7 * min(same.all(axis=0).sum(), 3)
        ax.plot(t, line, color=colour_of(i), linewidth=width, solid_capstyle="butt", **style)


def shade_windows(ax: Any, plan: Plan) -> None:
    """Shade the windows of disturbances, and the paper's recovery time after them."""
    shaded = {w for i in range(len(plan.scene.contacts)) for w in windows(plan, i)}
    for start, stop in shaded:
        ax.axvspan(start, stop, color=DISTURBED, alpha=0.10, linewidth=0)
    wanted = plan.scene.paper.get("recovery_time")
    if wanted:
        end = max((stop for _, stop in shaded), default=0.0)
        ax.axvspan(end, end + wanted, color=RECOVERY, alpha=0.16, linewidth=0)


def _draw_speed(ax: Any, plan: Plan) -> None:
    """Draw the speeds of the contact points, if there is no slip to draw."""
    t, scene = plan.sample_times(), plan.scene
    lengths = [math.hypot(*contact.start().finger_velocity) for contact in scene.contacts]
    _draw_lines(ax, t, np.array(lengths) * scene.speeds(t))
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel("speed of the contact point [m/s]")
    ax.set_title("No slip at any contact" if any(lengths) else "Every contact rests")


def _draw_object(ax: Any, plan: Plan) -> None:
    contacts = range(len(plan.scene.contacts))
    draw_body(ax, mesh_of(plan, 1, contacts), curves_of(plan, contacts, 1))


def _draw_finger(ax: Any, plan: Plan) -> None:
    """The first finger, with the curves of all contacts that have an equal finger."""
    contacts = plan.scene.contacts
    finger = contacts[0].finger
    same = [i for i, c in enumerate(contacts) if c.finger == finger]
    curves = distinct(curves_of(plan, same, 0), 1e-3 * finger.size)
    draw_body(ax, mesh_of(plan, 0, same), curves)
    text = "On the fingers" if len(contacts) > 1 else "On the finger"
    if len(same) < len(contacts):
        text = shortened(f"Finger ({', '.join(map(plan.scene.contact_name, same))})", 40)
    ax.set_title(text, pad=4)
