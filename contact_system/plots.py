"""Pictures of a plan: contact curves on the bodies in 3-D, slip on a log axis.

matplotlib is imported only when a picture is asked for, and never needs a display. Bodies are
drawn by an orthographic projection of our own onto plain 2-D axes: mplot3d sorts whole artists by
depth, so that a curve there is either in front of a surface everywhere or behind it everywhere.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from .checks import a_path, finite_number
from .errors import ContactSystemError
from .measures import exact_slip, great_circle_distance, regular_times, windows
from .plan import Plan, require_plan
from .scene import STILL, Scene, speed
from .surfaces import Surface
from .theory.gain import Gain
from .theory.profile import Profile
from .writing import writing

COLOURS = ("#1f5fa8", "#12876f", "#e08e0b", "#7a4fa3", "#3aa0d8", "#8a6a3b", "#5b7083")
DISTURBED = "#d1274b"
RECOVERY = "#12876f"
INK = "#2b2f36"
GREY = "#5a6370"
# Lists, since a tuple of two is a colour and its opacity to matplotlib 3.8.
BODY = ["#8f9aa6", "#f3f5f7"]  # a surface turned away from the light, and towards it
HOLLOW = ["#6d7884", "#b9c2cb"]  # the back of a surface with an edge

FEWEST, MOST = 10, 2400  # dots an inch: with fewer there are no letters
DECADES = 10  # of slip below its peak that a picture shows
CELLS = 96  # of a surface's mesh in each coordinate
OCCLUDER = 3  # every third mesh line tells what is hidden: flat faces miss a sphere by 0.005 r
UNITS = ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"))  # of a scale, from 0.1 of each on
UNBOUNDED = 50  # times its size: an implicit surface that large does not close
STYLE = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.labelsize": 11,
    "legend.fontsize": 10,
    "axes.edgecolor": INK,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "mathtext.fontset": "dejavusans",
}
TITLE = {"loc": "left", "weight": "bold"}
DOTS: Any = {"linestyle": "none", "marker": "o", "markersize": 4.5}
DOTS |= {"markerfacecolor": "white", "markeredgecolor": INK}
NUMBER: Any = {"linestyle": "none", "marker": "$1$", "markersize": 7, "color": COLOURS[0]}


class MissingMatplotlib(ContactSystemError):
    """Pictures are asked for and matplotlib is not installed."""


# --- pictures ----------------------------------------------------------------------------------


def plot(plan: Plan, path: str | os.PathLike, other: Plan | None = None, dpi: int = 160) -> None:
    """One picture: contact curves on the object and on a finger, slip beside its exact law.

    Parameters
    ----------
    plan : Plan
    path : path
        Its ending chooses the format (.png, .pdf, .svg).
    other : Plan, optional
        The same scene under another gain law; its slip is drawn beside this one's.
    dpi : int
        Dots an inch, 10 to 2400; the picture is 12 by 6 inches.

    Raises
    ------
    MissingMatplotlib
        If it is not installed.
    ContactSystemError
        No plan, no path, another ending, or a file that cannot be written.
    """
    laws = _plans(plan, other)
    slips = plan.slip_speed(plan.sample_times()).any()
    with Picture(path, (12, 6), dpi) as figure:
        left, right = figure.subfigures(1, 2, width_ratios=(1, 0.95))
        draw_title(left, plan)
        _draw_object(left.add_axes((0.02, 0.04, 0.94, 0.80)), plan)
        _draw_slip(right.add_axes((0.15, 0.52, 0.79, 0.42)), laws)
        _draw_finger(right.add_axes((0.04, 0.02, 0.42, 0.37)), plan)
        _draw_key(right.add_axes((0.53, 0.01, 0.45, 0.39)), plan, laws if slips else ())


def plot_curves(plan: Plan, path: str | os.PathLike, dpi: int = 160) -> None:
    """Contact curves in 3-D, on the object and on a finger; see :func:`plot`."""
    require_plan(plan)
    with Picture(path, (12, 6), dpi) as figure:
        draw_title(figure, plan)
        _draw_object(figure.add_axes((0.02, 0.04, 0.58, 0.80)), plan)
        _draw_finger(figure.add_axes((0.63, 0.38, 0.34, 0.46)), plan)
        _draw_key(figure.add_axes((0.68, 0.03, 0.30, 0.30)), plan)


def plot_slip(
    plan: Plan, path: str | os.PathLike, other: Plan | None = None, dpi: int = 160
) -> None:
    """Slip magnitude of each contact on a log axis beside its exact law; see :func:`plot`."""
    laws = _plans(plan, other)
    with Picture(path, (11, 5), dpi) as figure:
        _draw_slip(figure.add_axes((0.09, 0.13, 0.62, 0.77)), laws)
        _draw_key(figure.add_axes((0.73, 0.13, 0.26, 0.77)), plan, laws, bodies=False)


def _plans(plan: Plan, other: Plan | None) -> list[Plan]:
    laws = [plan] if other is None else [plan, other]
    for given in laws:
        require_plan(given)
    return laws


@contextmanager
def Picture(path: str | os.PathLike, size: tuple[float, float], dpi: int) -> Iterator[Any]:
    """A figure in our style, written to its path at the end."""
    path, dots = a_path(path), finite_number(dpi, "dpi")
    if not FEWEST <= dots <= MOST:
        raise ContactSystemError(f"dpi = {dpi!r}: give a number from {FEWEST} to {MOST}")
    try:
        import matplotlib
        from matplotlib.backend_bases import FigureCanvasBase
        from matplotlib.figure import Figure
    except ImportError:
        remedy = 'pictures need matplotlib: pip install "contact-system[plot]"'
        raise MissingMatplotlib(remedy) from None
    ending = path.suffix[1:].lower()
    if ending not in FigureCanvasBase.get_supported_filetypes():
        raise ContactSystemError(f"{path}: unknown ending {path.suffix!r}; use .png, .pdf or .svg")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, facecolor="white")
        yield figure
        with writing(path) as file:
            figure.savefig(file, format=ending, dpi=dots)


# --- words -------------------------------------------------------------------------------------


def draw_title(figure: Any, plan: Plan) -> None:
    """Name, profile, gain and description of a scene at the top of a figure."""
    scene = plan.scene
    still = scene.profile == STILL
    sigma = "of legs" if still else f"= {_polynomial(scene.profile)} m/s"
    facts = rf"$\sigma$ {sigma},   gain {gain_text(scene.gain)}"
    name = figure.text(0.035, 0.955, _shortened(scene.name, 30), size=18, weight="bold")
    told = figure.text(0.965, 0.955, facts, size=10, ha="right", color=GREY)
    if told.get_window_extent().x0 < name.get_window_extent().x1 + 10:  # no room beside the name
        told.set(x=0.035, y=0.865, ha="left")
    figure.text(0.035, 0.905, _shortened(scene.description, 84), size=11)


def gain_text(gain: Gain) -> str:
    """Short name of a gain law, such as 'path, eta = 100'."""
    return f"{gain.law}, {gain.parameter} = {gain.value:g}"


def _polynomial(profile: Profile) -> str:
    terms: list[str] = []
    for k, c in enumerate(profile.coefficients):
        if c:
            power = "" if k == 0 else r"$\,t$" if k == 1 else rf"$\,t^{{{k}}}$"
            sign = ("- " if c < 0 else "+ ") if terms else "-" * (c < 0)
            terms.append(f"{sign}{abs(c):.4g}{power}")
    return " ".join([*terms[:4], "+ …"] if len(terms) > 5 else terms)


def _shortened(text: str, width: int) -> str:
    """The text for a picture, or its beginning and an ellipsis where it has more characters.

    Dollar signs in it are those of a name, and begin no mathematics.
    """
    text = text if len(text) <= width else text[: width - 1].rstrip() + "…"
    return text.replace("$", r"\$")


def colour_of(contact: int) -> str:
    """The colour of a contact in all pictures."""
    return COLOURS[contact % len(COLOURS)]


def contact_keys(scene: Scene) -> list[Any]:
    """Legend entries of the contacts: one a colour, with the numbers of all that have it."""
    entries, count = [], len(scene.contacts)
    for i in range(min(count, len(COLOURS))):
        others = (_number_of(scene, k) for k in range(i + len(COLOURS), count, len(COLOURS)))
        names = _shortened(", ".join([scene.contact_name(i), *others]), 26)
        entries.append(_entry(names, color=colour_of(i), linewidth=2.4))
    return entries


def _number_of(scene: Scene, contact: int) -> str:
    """The number at the end of its name, such as that of "finger 1", or its index."""
    name = scene.contact_name(contact)
    number = name[len(name.rstrip("0123456789")) :]
    return number if 0 < len(number) < 10 else str(contact)


def _entry(label: str, **style: Any) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **style)


def _draw_key(ax: Any, plan: Plan, laws: Sequence[Plan] = (), bodies: bool = True) -> None:
    """What the colours and signs mean: of the slip of some laws, of the bodies, or of both."""
    from matplotlib.patches import Patch

    entries = []
    for k, law in enumerate(laws):
        text = f"gain {gain_text(law.scene.gain)}"
        entries.append(_entry(text, color=INK, linewidth=2.2, linestyle="--" if k else "-"))
    contacts = range(len(plan.scene.contacts))
    if laws and any(len(exact_slip(plan, i)[0]) for i in contacts):
        entries.append(_entry("exact law", **DOTS))
    if laws and "recovery_time" in plan.scene.paper:
        entries.append(Patch(color=RECOVERY, alpha=0.2, label="recovery time in the paper"))
    entries += contact_keys(plan.scene)
    if plan.scene.disturbances:
        entries.append(_entry("disturbance", color=DISTURBED, linewidth=2.4))
    if bodies:
        entries.append(_entry("behind the body", color=INK, linewidth=1.3, alpha=0.35))
        if any(contact.legs for contact in plan.scene.contacts):
            entries.append(_entry("number of a leg", **NUMBER))
            entries.append(_entry("the finger's frame", color=INK, linewidth=1.3))
    ax.set_axis_off()
    ax.legend(handles=entries, loc="center left", frameon=False, handlelength=2.2)


# --- slip --------------------------------------------------------------------------------------


def _draw_slip(ax: Any, laws: Sequence[Plan]) -> None:
    plan = laws[0]
    slip = np.concatenate([_slip_lines(ax, law, dashed=k > 0) for k, law in enumerate(laws)])
    ax.set_xlim(plan.start, plan.end)
    ax.set_xlabel("time [s]")
    ax.ticklabel_format(axis="x", scilimits=(-2, 4))  # longer numbers run into each other
    if not slip.any():
        _draw_rolling(ax, plan)
        return
    ax.set_yscale("log")
    # slip may leave the picture long before it ends, and need not fill it
    peak, least = slip.max(), slip[slip > 0].min()
    ax.set_ylim(max(peak * 10.0**-DECADES, min(least / 5, peak / 1e3)), peak * 10)
    ax.set_ylabel("slip [m/s]")
    ax.grid(axis="y", color="#e4e7eb", linewidth=0.8)
    ax.set_axisbelow(True)
    shade_windows(ax, plan)
    ax.set_title("Slip at the contacts", **TITLE)


def _slip_lines(ax: Any, plan: Plan, dashed: bool) -> np.ndarray:
    """Draw one law; returns the slip drawn, (n, n_contacts), m/s."""
    t = plan.sample_times(1201)
    # an offset's slip ends at once: the last time before the edge belongs to the line as well
    t = np.unique(np.append(t, np.nextafter(t[np.isin(t, plan.scene.edges) & (t > plan.start)], 0)))
    slip = plan.slip_speed(t)
    style: dict[str, Any] = {"dashes": (2.2, 1.1)} if dashed else {}
    for i in np.flatnonzero(slip.any(axis=0)).tolist():
        # lines that lie on each other: the lower the wider, so that each is seen
        above = np.isclose(slip[:, i + 1 :], slip[:, i : i + 1], rtol=0.02).all(0).sum()
        style |= {"color": colour_of(i), "linewidth": 1.8 + 1.7 * min(above, 3)}
        line = np.where(slip[:, i] > 0, slip[:, i], np.nan)
        ax.plot(t, line, solid_capstyle="butt", **style)
        ax.plot(*exact_slip(plan, i), markeredgewidth=0.9, zorder=5, **DOTS)
    return slip


def shade_windows(ax: Any, plan: Plan) -> None:
    """Shade when contacts are disturbed, and the time in which the paper says slip is rejected."""
    shaded = {w for i in range(len(plan.scene.contacts)) for w in windows(plan, i)}
    for start, stop in shaded:
        ax.axvspan(start, stop, color=DISTURBED, alpha=0.10, linewidth=0)
    wanted = plan.scene.paper.get("recovery_time")
    if wanted:
        end = max((stop for _, stop in shaded), default=0.0)
        ax.axvspan(end, end + wanted, color=RECOVERY, alpha=0.16, linewidth=0)


def _draw_rolling(ax: Any, plan: Plan) -> None:
    """No slip at all: the finger's distance from its great circle where it has one."""
    t, contacts = plan.sample_times(), plan.scene.contacts
    followers = [i for i, c in enumerate(contacts) if c.follows and c.finger.great_circles]
    if not followers:
        for way in {plan.scene.way(i) for i in range(len(contacts))}:
            ax.plot(t, speed(way, t), color=INK, linewidth=1.8)
        ax.set_ylim(bottom=0.0)
        ax.set_ylabel(r"path speed $\sigma$ [m/s]")
        ax.set_title("No slip: the contacts roll", **TITLE)
        return
    for i in followers:
        points = plan.points(t)[:, i, 0]
        distance = np.abs(great_circle_distance(points)) / contacts[i].finger.size
        ax.plot(t, np.maximum(distance, 1e-17), color=colour_of(i), linewidth=1.2)
    ax.axhline(np.finfo(float).eps, color="#9aa3ad", linewidth=1, linestyle=":")
    ax.text(t[0], 3e-18, " dotted: relative spacing of doubles, 2.2e-16", size=9, color=GREY)
    ax.set_yscale("log")
    ax.set_ylim(1e-18, 1e-13)
    ax.set_ylabel("distance / radius")
    ax.set_title("Finger's curve from a great circle", **TITLE)


# --- curves ------------------------------------------------------------------------------------


@dataclass
class _Curve:
    """A contact curve: points (n, 3) [m], whether disturbed there (n,), its colour and number.

    Of one with legs also the middle of each (n, 3), and the frames at the start and the goal as
    corners: their origins, and the tips of unit x and y axes, (2, 3, 3).
    """

    points: np.ndarray
    disturbed: np.ndarray
    colour: str
    label: str
    legs: np.ndarray | tuple[()] = ()
    frames: np.ndarray | tuple[()] = ()


def _draw_object(ax: Any, plan: Plan) -> None:
    contacts = range(len(plan.scene.contacts))
    draw_body(ax, mesh_of(plan, plan.scene.object, 1, contacts), _curves(plan, contacts, 1))


def _draw_finger(ax: Any, plan: Plan) -> None:
    """The first finger, with the curves of all contacts that have the same one."""
    contacts = plan.scene.contacts
    finger = contacts[0].finger
    same = [i for i, c in enumerate(contacts) if c.finger == finger]
    curves = _distinct(_curves(plan, same, 0), 1e-3 * finger.size)
    draw_body(ax, mesh_of(plan, finger, 0, same), curves)
    text = "On the fingers" if len(contacts) > 1 else "On the finger"
    if len(same) < len(contacts):
        text = _shortened(f"Finger ({', '.join(map(plan.scene.contact_name, same))})", 40)
    ax.set_title(text, pad=4, **TITLE)


def _curves(plan: Plan, contacts: Sequence[int], side: int) -> list[_Curve]:
    t = plan.sample_times(1601)
    points = plan.points(t)
    curves = [curve_of(plan, i, t, points[:, i, side]) for i in contacts]
    for i, curve in zip(contacts, curves):
        if plan.scene.contacts[i].legs:
            _add_legs(curve, plan, i, side)
    return curves


def _add_legs(curve: _Curve, plan: Plan, contact: int, side: int) -> None:
    """Where the legs are, and how the finger's frame lies at the start and the goal."""
    way = [leg for leg in plan.scene.way(contact) if leg.profile != STILL]
    curve.legs = plan.points([(leg.start + leg.stop) / 2 for leg in way])[:, contact, side]
    ends = [plan.start, plan.end]
    if len(regular_times(plan, np.array(ends))) < 2:
        return
    found = plan.evaluate(ends, "points", "states", "pose")
    finger, states = plan.scene.contacts[contact].finger, found["states"][:, contact]
    axes = finger.frame(states[:, 0], states[:, 1])[..., :2]
    if side:  # as it lies on the object
        axes = found["pose"][:, contact, :3, :3] @ axes
    at = found["points"][:, contact, side]
    curve.frames = np.stack([at, at + axes[..., 0], at + axes[..., 1]], axis=1)


def curve_of(plan: Plan, contact: int, t: np.ndarray, points: np.ndarray) -> _Curve:
    """The curve of a contact through points (n, 3) at times t (n,), and where it is disturbed."""
    disturbed = np.zeros(len(t), bool)
    for start, stop in windows(plan, contact):
        disturbed |= (t >= start) & (t < stop)
    return _Curve(points, disturbed, colour_of(contact), _number_of(plan.scene, contact))


def _distinct(curves: Sequence[_Curve], distance: float) -> list[_Curve]:
    """Curves that coincide are one curve with all their numbers."""
    groups: list[list[_Curve]] = []
    for curve in curves:
        for group in groups:
            if np.abs(group[0].points - curve.points).max() < distance:
                group.append(curve)
                break
        else:
            groups.append([curve])
    for first, *others in groups:
        first.disturbed = np.any([c.disturbed for c in (first, *others)], axis=0)
        first.label = _shortened(_listed([c.label for c in (first, *others)]), 12)
    return [group[0] for group in groups]


def _listed(numbers: Sequence[str]) -> str:
    """Numbers in short, such as 1,2,5-12: four or more that follow on each other are a range."""
    runs: list[list[str]] = []
    for number in numbers:
        if runs and int(number) == int(runs[-1][-1]) + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 3 else ",".join(run) for run in runs)


# --- bodies ------------------------------------------------------------------------------------


@dataclass
class _View:
    """Orthographic camera: rows right, up, towards the camera."""

    axes: np.ndarray

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Right, up and depth (greater is nearer) of points (..., 3), m."""
        return x @ self.axes.T


@dataclass
class _Mesh:
    """A surface on a grid of this shape: points and normals, (n, 3)."""

    shape: tuple[int, int]
    points: np.ndarray
    normals: np.ndarray
    inside: bool

    @property
    def grid(self) -> np.ndarray:
        """Numbers of the points."""
        return np.arange(len(self.points)).reshape(self.shape)

    @property
    def size(self) -> float:
        """Of its bounding box, m."""
        return np.ptp(self.points, axis=0).max()

    def triangles(self, every: int = 1) -> np.ndarray:
        """Between some lines of the grid: (m, 3)."""
        grid = self.grid[::every, ::every]
        a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
        return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)


def mesh_of(plan: Plan, surface: Surface, side: int, contacts: Sequence[int]) -> _Mesh | None:
    """The whole surface if it closes on itself, else what lies around the curves."""
    for whole in (True, False):
        spans = [_span(plan, surface, side, contacts, k, whole) for k in (0, 1)]
        try:
            u, v = np.meshgrid(*(np.linspace(*span, CELLS + 1) for span in spans), indexing="ij")
            points, normals = surface.point(u, v), surface.normal(u, v)
        except ContactSystemError:  # an implicit surface that the rays of its chart do not all meet
            continue
        mesh = _Mesh(u.shape, points.reshape(-1, 3), normals.reshape(-1, 3), surface.inside)
        if not whole or mesh.size <= UNBOUNDED * surface.size:
            return mesh
    return None


def _span(
    plan: Plan, surface: Surface, side: int, contacts: Sequence[int], k: int, whole: bool
) -> tuple[float, float]:
    """Range of u or v to draw, a hair less: charts end at poles, where there is no frame."""
    period = surface.periods()[k]
    if surface.double_cover:
        start, stop = ((-math.pi, math.pi), (-math.pi / 2, math.pi / 2))[k]
    elif whole and period is not None:
        start, stop = -period / 2, period / 2
    elif whole and surface.chart.singular_at:  # only charts with poles close without a period
        start, stop = ((0.0, math.pi), (-math.pi / 2, math.pi / 2))[k]
    else:
        t = regular_times(plan, plan.sample_times())
        found = plan.evaluate(t, "states", "points")
        q = found["states"][:, contacts, 4 * side : 4 * side + 2].reshape(-1, 2)
        reach = np.ptp(found["points"][:, contacts, side].reshape(-1, 3), axis=0).max()
        margin = 0.35 * reach / surface.lame(*q[len(q) // 2])[k]
        start, stop = q[:, k].min() - margin, q[:, k].max() + margin
    hair = 1e-6 * (stop - start)
    return start + hair, stop - hair


def draw_body(ax: Any, mesh: _Mesh | None, curves: Sequence[_Curve]) -> None:
    """A body from where its curves are seen best, with those curves and a scale."""
    view = best_view(mesh, curves)
    if mesh is not None:
        _draw_surface(ax, mesh, view)
    hidden = [is_hidden(mesh, view, curve.points) for curve in curves]
    for curve, behind in zip(curves, hidden):
        _draw_curve(ax, view(curve.points), curve, behind)
    starts = np.array([view(curve.points[0])[:2] for curve in curves])
    room = 0.04 * max(ax.dataLim.width, ax.dataLim.height)  # of a label
    for k, curve in enumerate(curves):
        before = np.linalg.norm(starts[:k] - starts[k], axis=1) < room
        _mark_start(ax, starts[k], curve, hidden[k][0], int(before.sum()))
    for curve, behind in zip(curves, hidden):
        _draw_legs(ax, mesh, view, curve, room)
        for frame, dim in zip(curve.frames, (behind[0], behind[-1])):
            _draw_frame(ax, view(frame)[:, :2], 3.0 * room, 0.4 if dim else 1.0)
    ax.set_aspect("equal")
    ax.margins(0.06)
    ax.set_axis_off()
    _scale_bar(ax)


def best_view(mesh: _Mesh | None, curves: Sequence[_Curve]) -> _View:
    """Of a ring of cameras the one that the curves face most."""
    points = np.concatenate([c.points[::20] for c in curves])
    starts = np.array([c.points[0] for c in curves])
    elevation, azimuth = np.meshgrid([28, 40, 60, -28], range(0, 360, 15), indexing="ij")
    penalty = np.repeat([0.0, 0.06, 0.3, 0.15], azimuth.shape[1])
    e, a = np.radians(elevation).ravel(), np.radians(azimuth).ravel()
    toward = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], 1)
    right = np.stack([-np.sin(a), np.cos(a), 0 * a], 1)
    normals = _normals_at(mesh, points), _normals_at(mesh, starts)
    facing, first = (np.clip(n @ toward.T, -0.2, 0.6).mean(0) for n in normals)
    best = np.argmax(facing + 0.5 * first - penalty)
    return _View(np.stack([right, np.cross(toward, right), toward], 1)[best])


def _normals_at(mesh: _Mesh | None, points: np.ndarray) -> np.ndarray:
    """Normal of the mesh vertex next to each point."""
    if mesh is None:
        return np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return mesh.normals[[((mesh.points - x) ** 2).sum(1).argmin() for x in points]]


def is_hidden(mesh: _Mesh | None, view: _View, points: np.ndarray) -> np.ndarray:
    """Whether the surface lies between each point and the camera: (n,) bool."""
    hidden = np.zeros(len(points), bool)
    if mesh is None:
        return hidden
    triangles, slack = mesh.triangles(OCCLUDER), 0.02 * mesh.size
    if mesh.inside:  # a hollow is open towards the camera
        triangles = triangles[(mesh.normals @ view.axes[2])[triangles].mean(1) > 0]
    corners = view(mesh.points)[triangles]
    a, b, c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    area[np.abs(area) <= 1e-12 * slack**2] = np.nan  # seen from the side: hides nothing
    for first in range(0, len(points), 64):
        p = view(points[first : first + 64])[:, None] - a
        beta = (p[..., 0] * c[:, 1] - p[..., 1] * c[:, 0]) / area
        gamma = (b[:, 0] * p[..., 1] - b[:, 1] * p[..., 0]) / area
        nearer = beta * b[:, 2] + gamma * c[:, 2] - p[..., 2] > slack
        covers = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1) & nearer
        hidden[first : first + 64] = covers.any(1)
    return hidden


# --- drawing bodies ----------------------------------------------------------------------------


def _draw_surface(ax: Any, mesh: _Mesh, view: _View) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    (x, y, depth), triangles = view(mesh.points).T, mesh.triangles()
    triangles = triangles[np.argsort(depth[triangles].mean(1))]
    facing = (mesh.normals @ view.axes[2])[triangles].mean(1)
    light = view.axes.T @ np.array([-0.45, 0.6, 0.75])
    shade = 0.5 + 0.5 * mesh.normals @ (light / np.linalg.norm(light))
    layers = [(facing <= 0, HOLLOW, 1 - shade), (facing > 0, BODY, shade)]
    style = {"shading": "gouraud", "vmin": 0, "vmax": 1, "zorder": 1, "rasterized": True}
    # of a hollow only the far side is seen, as in a bowl cut open
    for chosen, colours, values in layers[mesh.inside :]:
        if chosen.any():
            colours = LinearSegmentedColormap.from_list("body", colours)
            ax.tripcolor(x, y, triangles[chosen], values, cmap=colours, **style)
    _draw_chart_lines(ax, mesh, view)
    _draw_outline(ax, mesh, view)


def _draw_chart_lines(ax: Any, mesh: _Mesh, view: _View) -> None:
    step = CELLS // 12
    for line in (*mesh.grid[::step], *mesh.grid.T[::step]):
        x, shown = mesh.points[line], mesh.normals[line] @ view.axes[2] > 0
        shown[shown] = ~is_hidden(mesh, view, x[shown])
        for run in _runs(shown):
            ax.plot(*view(x[run]).T[:2], color="white", linewidth=0.7, alpha=0.75, zorder=2)


def _draw_outline(ax: Any, mesh: _Mesh, view: _View) -> None:
    """Where the surface turns away from the camera, and its edges: n . d = 0 in each triangle."""
    from matplotlib.collections import LineCollection

    facing, triangles = mesh.normals @ view.axes[2], mesh.triangles()
    following = triangles[:, [1, 2, 0]]
    crosses = (facing[triangles] > 0) != (facing[following] > 0)  # on two sides, or none
    a, b = triangles[crosses], following[crosses]
    part = (facing[a] / (facing[a] - facing[b]))[:, None]
    turns = mesh.points[a] + part * (mesh.points[b] - mesh.points[a])
    pairs = np.concatenate([turns.reshape(-1, 2, 3), _edges(mesh)])
    pairs = view(pairs[~is_hidden(mesh, view, pairs.mean(1))])[:, :, :2]
    style = {"colors": "#6b7580", "linewidths": 0.9, "zorder": 2, "capstyle": "round"}
    ax.add_collection(LineCollection(pairs, **style))


def _edges(mesh: _Mesh) -> np.ndarray:
    """Segments (n, 2, 3) of the grid's border that do not close on another one."""

    def meet(first: np.ndarray, last: np.ndarray) -> bool:
        return np.linalg.norm(first - last, axis=1).max() < 1e-3 * mesh.size

    grid = mesh.points.reshape(*mesh.shape, 3)
    pairs = [np.empty((0, 2, 3))]
    for first, last in ((grid[0], grid[-1]), (grid[:, 0], grid[:, -1])):
        for line in () if meet(first, last) else (first, last):
            if not meet(line, line[::-1]):  # a pole, or a seam folded on itself, is no edge
                pairs.append(np.stack([line[:-1], line[1:]], 1))
    return np.concatenate(pairs)


def _runs(chosen: np.ndarray) -> list[slice]:
    """Slices of consecutive true entries, of two or more."""
    runs = np.ma.clump_masked(np.ma.array(chosen, mask=chosen))
    return [run for run in runs if run.stop - run.start > 1]


def _draw_curve(ax: Any, seen: np.ndarray, curve: _Curve, hidden: np.ndarray) -> None:
    """A curve as it is seen, (n, 3), with an arrowhead at its end."""
    for disturbed in (False, True):
        colour = DISTURBED if disturbed else curve.colour
        for behind in (True, False):
            style: dict[str, Any] = (
                {"linewidth": 1.3, "alpha": 0.33} if behind else {"linewidth": 2.4}
            )
            style |= {"color": colour, "zorder": 3 if behind else 4 + disturbed}
            chosen = (curve.disturbed == disturbed) & (hidden == behind)
            chosen[1:] |= chosen[:-1]  # join with the next run
            for run in _runs(chosen):
                ax.plot(*seen[run].T[:2], solid_capstyle="round", **style)
    seen = seen[:, :2]
    away = np.linalg.norm(seen - seen[-1], axis=1)
    far = np.flatnonzero(away > 0.01 * np.ptp(seen, axis=0).max())
    if len(far):
        colour = DISTURBED if curve.disturbed[-1] else curve.colour
        arrow: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 16, "linewidth": 0}
        arrow |= {"shrinkA": 0, "shrinkB": 0, "color": colour, "alpha": 0.4 if hidden[-1] else 1.0}
        ends = seen[-1], seen[far[-1]]
        ax.annotate("", *ends, zorder=6, annotation_clip=False, arrowprops=arrow)


def _mark_start(ax: Any, start: np.ndarray, curve: _Curve, behind: bool, below: int) -> None:
    """A curve's number where it begins, or below so many others that stand there."""
    style: dict[str, Any] = {"size": 9, "weight": "bold", "ha": "center", "va": "center"}
    style |= {"color": "white", "alpha": 0.75 if behind else 1.0, "zorder": 8}
    box = {"facecolor": curve.colour, "edgecolor": "white", "linewidth": 1.1}
    box["alpha"] = 0.55 if behind else 1.0
    box["boxstyle"] = "circle,pad=0.25" if len(curve.label) < 2 else "round,pad=0.25"
    place = (0, -17 * below)
    ax.annotate(curve.label, start, place, textcoords="offset points", bbox=box, **style)


def _draw_legs(ax: Any, mesh: _Mesh | None, view: _View, curve: _Curve, room: float) -> None:
    """The number of each leg of a curve beside its middle."""
    for k, middle in enumerate(curve.legs):
        dim = is_hidden(mesh, view, middle[None])[0]
        style: dict[str, Any] = {"size": 9, "ha": "center", "va": "center", "zorder": 7}
        style |= {"color": curve.colour, "alpha": 0.6 if dim else 1.0}
        style["bbox"] = {"boxstyle": "round,pad=0.15", "facecolor": "white", "linewidth": 0}
        style["bbox"]["alpha"] = 0.8
        ax.text(*view(middle)[:2], str(k + 1), **style)


def _draw_frame(ax: Any, seen: np.ndarray, length: float, alpha: float) -> None:
    """Two axes of a frame from its origin, as they are seen: (3, 2)."""
    for tip, name in zip(seen[1:], "xy"):
        end = seen[0] + length * (tip - seen[0])
        arrow = {"arrowstyle": "->", "linewidth": 1.3, "color": INK, "alpha": alpha, "shrinkA": 0}
        ax.annotate("", end, seen[0], zorder=7, annotation_clip=False, arrowprops=arrow)
        place = seen[0] + 1.25 * length * (tip - seen[0])
        ax.text(*place, name, size=8, ha="center", va="center", color=INK, alpha=alpha, zorder=7)


def _scale_bar(ax: Any) -> None:
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    wanted, height = 0.3 * (right - left), top - bottom
    decade = 10.0 ** math.floor(math.log10(wanted))
    length = max(k * decade for k in (1, 2, 5) if k * decade <= wanted)
    y, middle = bottom - 0.02 * height, left + length / 2
    ax.plot([left, left + length], [y, y], color=INK, linewidth=2.5, solid_capstyle="butt")
    ax.text(middle, y - 0.015 * height, _length_text(length), ha="center", va="top", size=9)
    ax.set_ylim(y - 0.09 * height, top)


def _length_text(length: float) -> str:
    """A round length [m] in the unit that people read it in."""
    unit, name = next((unit for unit in UNITS if length > 0.09 * unit[0]), UNITS[0])
    return f"{length / unit:g} {name}"
