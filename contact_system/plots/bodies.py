"""Bodies and their curves, projected orthographically onto plain 2-D axes.

mplot3d is not used because it sorts whole artists by depth: a curve would be entirely in front of a
surface or entirely behind it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .curves import Curve
from .meshes import CELLS, Mesh, edges
from .style import BODY, DISTURBED, HOLLOW, INK

OCCLUDER = 3  # every third mesh line is used for hiding; the error on a sphere is 0.005 r
UNITS = ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"))  # of the scale bar


def draw_body(ax: Any, mesh: Mesh | None, curves: Sequence[Curve]) -> None:
    """A body, its curves and a scale bar, from the best view of the curves."""
    view = best_view(mesh, curves)
    if mesh is not None:
        _draw_surface(ax, mesh, view)
    hidden = [is_hidden(mesh, view, curve.points) for curve in curves]
    for curve, behind in zip(curves, hidden):
        _draw_curve(ax, curve.points @ view, curve, behind)
    starts = np.array([(curve.points[0] @ view)[:2] for curve in curves])
    room = 0.04 * max(ax.dataLim.width, ax.dataLim.height)  # size of a label
    for k, curve in enumerate(curves):
        before = np.linalg.norm(starts[:k] - starts[k], axis=1) < room
        _mark_start(ax, starts[k], curve, hidden[k][0], int(before.sum()))
    for curve, behind in zip(curves, hidden):
        _draw_legs(ax, mesh, view, curve)
        for frame, dim in zip(curve.frames, (behind[0], behind[-1])):
            _draw_frame(ax, (frame @ view)[:, :2], 3.0 * room, 0.4 if dim else 1.0)
    ax.set_aspect("equal")
    ax.margins(0.06)
    ax.set_axis_off()
    _scale_bar(ax)


def best_view(mesh: Mesh | None, curves: Sequence[Curve]) -> np.ndarray:
    """The view, of some orthographic cameras around the body, that curves face most.

    (3, 3): x @ view is right, up and depth, m; nearer points have a greater depth.
    """
    points = np.concatenate([c.points[::20] for c in curves])
    starts = np.array([c.points[0] for c in curves])
    elevation, azimuth = np.meshgrid([28, 40, 60, -28], range(0, 360, 15), indexing="ij")
    penalty = np.repeat([0.0, 0.06, 0.3, 0.15], azimuth.shape[1])  # of steep views, and from below
    e, a = np.radians(elevation).ravel(), np.radians(azimuth).ravel()
    toward = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], 1)
    right = np.stack([-np.sin(a), np.cos(a), 0 * a], 1)
    normals = _normals_at(mesh, points), _normals_at(mesh, starts)
    facing, first = (np.clip(n @ toward.T, -0.2, 0.6).mean(0) for n in normals)
    best = np.argmax(facing + 0.5 * first - penalty)
    return np.stack([right, np.cross(toward, right), toward], 2)[best]


def _normals_at(mesh: Mesh | None, points: np.ndarray) -> np.ndarray:
    """Normal of the mesh vertex nearest to each point."""
    if mesh is None:
        return np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return mesh.normals[[((mesh.points - x) ** 2).sum(1).argmin() for x in points]]


def is_hidden(mesh: Mesh | None, view: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether the surface lies between each point and the camera: (n,) bool."""
    hidden = np.zeros(len(points), bool)
    if mesh is None:
        return hidden
    triangles, slack = mesh.triangles(OCCLUDER), 0.02 * mesh.size
    if mesh.surface.inside:  # a hollow is open towards the camera
        triangles = triangles[(mesh.normals @ view[:, 2])[triangles].mean(1) > 0]
    corners = (mesh.points @ view)[triangles]
    a, b, c = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    across = np.abs(area) > 1e-9 * slack**2  # triangles seen edge-on hide nothing
    a, b, c, area = a[across], b[across], c[across], area[across]
    zero, one = np.zeros_like(area), np.ones_like(area)
    # linear functions of a point: its barycentric coordinates, and how much nearer the triangle is
    beta = np.stack([c[:, 1], -c[:, 0], zero]) / area
    gamma = np.stack([-b[:, 1], b[:, 0], zero]) / area
    nearer = beta * b[:, 2] + gamma * c[:, 2] - np.stack([zero, zero, one])
    slopes = np.stack([beta, gamma, -beta - gamma, nearer])
    offsets = np.stack([zero, zero, one, -slack * one]) - np.einsum("kim,mi->km", slopes, a)
    low, high = corners[across, :, :2].min(1), corners[across, :, :2].max(1)
    for first in range(0, len(points), 16):  # neighbouring points, near to few triangles
        projected = points[first : first + 16] @ view
        near = ((low <= projected[:, :2].max(0)) & (high >= projected[:, :2].min(0))).all(1)
        covers = projected @ slopes[:, :, near] + offsets[:, None, near] >= 0
        hidden[first : first + 16] = covers.all(0).any(1)
    return hidden


def _draw_surface(ax: Any, mesh: Mesh, view: np.ndarray) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    (x, y, depth), triangles = (mesh.points @ view).T, mesh.triangles()
    triangles = triangles[np.argsort(depth[triangles].mean(1))]
    facing = (mesh.normals @ view[:, 2])[triangles].mean(1)
    light = view @ np.array([-0.45, 0.6, 0.75])
    shade = 0.5 + 0.5 * mesh.normals @ (light / np.linalg.norm(light))
    layers = [(facing <= 0, HOLLOW, 1 - shade), (facing > 0, BODY, shade)]
    style = {"shading": "gouraud", "vmin": 0, "vmax": 1, "zorder": 1, "rasterized": True}
    # only the far side of a hollow is drawn, as of a bowl that is cut open
    for chosen, colours, values in layers[mesh.surface.inside :]:
        if chosen.any():
            colours = LinearSegmentedColormap.from_list("body", colours)
            ax.tripcolor(x, y, triangles[chosen], values, cmap=colours, **style)
    _draw_chart_lines(ax, mesh, view)
    _draw_outline(ax, mesh, view)


def _draw_chart_lines(ax: Any, mesh: Mesh, view: np.ndarray) -> None:
    step = CELLS // 12
    for lines in (mesh.grid[::step], mesh.grid.T[::step]):
        x, shown = mesh.points[lines], mesh.normals[lines] @ view[:, 2] > 0
        shown[shown] = ~is_hidden(mesh, view, x[shown])
        x[~shown] = np.nan
        ax.plot(*(x @ view).T[:2], color="white", linewidth=0.7, alpha=0.75, zorder=2)


def _draw_outline(ax: Any, mesh: Mesh, view: np.ndarray) -> None:
    """The silhouette, where the normal turns from the camera, and the surface's edges."""
    from matplotlib.collections import LineCollection

    facing, triangles = mesh.normals @ view[:, 2], mesh.triangles()
    following = triangles[:, [1, 2, 0]]
    crosses = (facing[triangles] > 0) != (facing[following] > 0)  # on two sides, or none
    a, b = triangles[crosses], following[crosses]
    part = (facing[a] / (facing[a] - facing[b]))[:, None]
    turns = mesh.points[a] + part * (mesh.points[b] - mesh.points[a])
    pairs = np.concatenate([turns.reshape(-1, 2, 3), edges(mesh)])
    pairs = (pairs[~is_hidden(mesh, view, pairs.mean(1))] @ view)[:, :, :2]
    style = {"colors": "#6b7580", "linewidths": 0.9, "zorder": 2, "capstyle": "round"}
    ax.add_collection(LineCollection(pairs, **style))


def _draw_curve(ax: Any, projected: np.ndarray, curve: Curve, hidden: np.ndarray) -> None:
    """A projected curve, (n, 3), with an arrowhead at its end."""
    for disturbed in (False, True):
        colour = DISTURBED if disturbed else curve.colour
        for behind in (True, False):
            style: dict[str, Any] = (
                {"linewidth": 1.3, "alpha": 0.33} if behind else {"linewidth": 2.4}
            )
            style |= {"color": colour, "zorder": 3 if behind else 4 + disturbed}
            chosen = (curve.disturbed == disturbed) & (hidden == behind)
            chosen[1:] |= chosen[:-1]  # join with the next run
            line = np.where(chosen[:, None], projected, np.nan)
            ax.plot(*line.T[:2], solid_capstyle="round", **style)
    projected = projected[:, :2]
    away = np.linalg.norm(projected - projected[-1], axis=1)
    far = np.flatnonzero(away > 0.01 * np.ptp(projected, axis=0).max())
    if len(far):
        colour = DISTURBED if curve.disturbed[-1] else curve.colour
        arrow: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": 16, "linewidth": 0}
        arrow |= {"shrinkA": 0, "shrinkB": 0, "color": colour, "alpha": 0.4 if hidden[-1] else 1.0}
        ends = projected[-1], projected[far[-1]]
        ax.annotate("", *ends, zorder=6, annotation_clip=False, arrowprops=arrow)


def _mark_start(ax: Any, start: np.ndarray, curve: Curve, behind: bool, below: int) -> None:
    """Write a curve's number at its start, or below the numbers of ``below`` others there."""
    style: dict[str, Any] = {"size": 9, "weight": "bold", "ha": "center", "va": "center"}
    style |= {"color": "white", "alpha": 0.75 if behind else 1.0, "zorder": 8}
    box = {"facecolor": curve.colour, "edgecolor": "white", "linewidth": 1.1}
    box["alpha"] = 0.55 if behind else 1.0
    box["boxstyle"] = "circle,pad=0.25" if len(curve.label) < 2 else "round,pad=0.25"
    place = (0, -17 * below)
    ax.annotate(curve.label, start, place, textcoords="offset points", bbox=box, **style)


def _draw_legs(ax: Any, mesh: Mesh | None, view: np.ndarray, curve: Curve) -> None:
    """The number of each leg of a curve beside its middle."""
    for k, middle in enumerate(curve.legs):
        dim = is_hidden(mesh, view, middle[None])[0]
        style: dict[str, Any] = {"size": 9, "ha": "center", "va": "center", "zorder": 7}
        style |= {"color": curve.colour, "alpha": 0.6 if dim else 1.0}
        style["bbox"] = {"boxstyle": "round,pad=0.15", "facecolor": "white", "linewidth": 0}
        style["bbox"]["alpha"] = 0.8
        ax.text(*(middle @ view)[:2], str(k + 1), **style)


def _draw_frame(ax: Any, projected: np.ndarray, length: float, alpha: float) -> None:
    """Draw two axes of a projected frame, which is its origin and the axes' tips, (3, 2)."""
    for tip, name in zip(projected[1:], "xy"):
        end = projected[0] + length * (tip - projected[0])
        arrow = {"arrowstyle": "->", "linewidth": 1.3, "color": INK, "alpha": alpha, "shrinkA": 0}
        ax.annotate("", end, projected[0], zorder=7, annotation_clip=False, arrowprops=arrow)
        place = projected[0] + 1.25 * length * (tip - projected[0])
        ax.text(*place, name, size=8, ha="center", va="center", color=INK, alpha=alpha, zorder=7)


def _scale_bar(ax: Any) -> None:
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    wanted, height = 0.3 * (right - left), top - bottom
    decade = 10.0 ** math.floor(math.log10(wanted))
    length = max(k * decade for k in (1, 2, 5) if k * decade <= wanted)
    y, middle = bottom - 0.02 * height, left + length / 2
    ax.plot([left, left + length], [y, y], color=INK, linewidth=2.5, solid_capstyle="butt")
    unit, name = next((unit for unit in UNITS if length > 0.09 * unit[0]), UNITS[0])
    ax.text(middle, y - 0.015 * height, f"{length / unit:g} {name}", ha="center", va="top", size=9)
    ax.set_ylim(y - 0.09 * height, top)
