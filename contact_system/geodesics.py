"""Geodesics with a first integral: half the states of a moving frame, or fewer."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from . import geometry
from .kept import kept
from .kernels import Kernel, Restoration, address, per_structure
from .panel_tracks import MovingTrack
from .surfaces import Surface
from .tracks import (
    AXIS,
    Evaluator,
    TrackData,
    evaluator,
    frame_coordinates,
    frame_kernel,
    rotation,
    whole_frame,
)

SX = ca.SX

FLAT = 1e-3


@dataclass(frozen=True, eq=False)
class GeodesicForm:
    """Geodesics whose acceleration depends on the place alone, thanks to a first integral.

    Half the states of a moving frame or fewer, and sweeps that converge twice as fast. All kernels
    take the surface's parameters and then the numbers of a path.

    Attributes
    ----------
    start : Kernel
        point: the body's state, w (2) -> state, numbers of the path, 1 / (size of each rate).
    motion : Kernel
        State, sigma, decay (both unused) -> its rates in arc length.
    body : Kernel
        State -> the body's state, (x, p, q) or (u, v, theta).
    points, frames, coordinates : Evaluator
        State -> x; x, p, q; state, sigma, 0 -> u, v, u', v', theta.
    n_rates : int
        How many of the states are rates: the last ones.
    """

    start: Kernel
    motion: Kernel
    body: Kernel
    points: Evaluator
    frames: Evaluator
    coordinates: Evaluator
    n_rates: int


@per_structure
def geodesic_form(surface: Surface, ambient: bool) -> GeodesicForm | None:
    """The form for a surface, or None where no first integral is known."""
    p = SX.sym("p", len(surface.parameters))
    if ambient:
        x = SX.sym("x", 3)
        _, hessian = geometry.implicit_geometry(surface.implicit_expr(p, x), x)
        return None if ca.depends_on(hessian, x) else _quadric_form(surface)
    uv = SX.sym("uv", 2)
    root = ca.simplify(surface.geometry_expr(p, uv[0], uv[1]).metric_root)
    turns = not ca.depends_on(root, uv[0]) and root[0, 1].is_zero()
    return _clairaut_form(surface) if turns and not ca.depends_on(root[1, 1], uv) else None


def _quadric_form(surface: Surface) -> GeodesicForm:
    r"""Quadrics F = 0, by Joachimsthal's integral: state x, x'; numbers J, \|x'\|, direction of w.

    x'' = -(x'.Hx')/\|g\|^2 g with g = grad F and H = g' constant, and J = (x'.Hx') \|g\|^2 is an
    integral of that, so x'' = -J g/\|g\|^4 (Joachimsthal 1843; Klingenberg, Riemannian Geometry,
    3.5).
    """
    p, numbers = SX.sym("p", len(surface.parameters)), SX.sym("numbers", 4)
    constant = ca.vertcat(p, numbers)
    axis, w = SX.sym("axis", AXIS), SX.sym("w", 2)
    frame = whole_frame(surface).function(axis, p)
    gradient, hessian = geometry.implicit_geometry(surface.implicit_expr(p, frame[0:3]), frame[0:3])
    velocity, pace = w[0] * frame[3:6] + w[1] * frame[6:9], ca.norm_2(w)
    integral = ca.dot(velocity, hessian @ velocity) * ca.dot(gradient, gradient)
    begin = ca.vertcat(frame[0:3], velocity, integral, pace, w / pace, SX.ones(3) / pace)

    state, drive = SX.sym("state", 6), SX.sym("drive", 2)
    x, rate = state[0:3], state[3:6]
    level = surface.implicit_expr(p, x)
    gradient = ca.gradient(level, x)
    square = ca.dot(gradient, gradient)
    bend = -(numbers[0] / square**2) * gradient
    motion = Kernel("geodesic", ca.vertcat(state, drive), constant, ca.vertcat(rate, bend))
    motion.nested = 3
    moved = x - level * gradient / square
    normal = ca.substitute(gradient, x, moved)
    along = rate - ca.dot(rate, normal) / ca.dot(normal, normal) * normal
    back = ca.vertcat(moved, along * (numbers[1] / ca.norm_2(along)))
    motion.restores = (Restoration(Kernel("restore_geodesic", state, constant, back), 0, 0),)

    along = rate / ca.norm_2(rate)
    across, turn = ca.cross(gradient / ca.sqrt(square), along), numbers[2:4]
    first = turn[0] * along - turn[1] * across
    body = ca.vertcat(x, first, turn[1] * along + turn[0] * across)
    chart = frame_coordinates(surface, p, x, first, drive[0] * rate)
    found = Kernel("geodesic_coordinates", ca.vertcat(state, drive), constant, chart)
    frames = Kernel("geodesic_frames", state, constant, body)
    return GeodesicForm(
        Kernel("geodesic_start", ca.vertcat(axis, w), p, begin), motion, frames,
        evaluator(surface, True, "points"), Evaluator(frames, False, 6, False),
        Evaluator(found, False, 6, True), 3,
    )  # fmt: skip


def _clairaut_form(surface: Surface) -> GeodesicForm:
    r"""Charts with h_u(v), h_v constant (torus), by Clairaut's integral L = h_u^2 u'.

    State u, v, v' with v'' = h_u'/(h_u^3 h_v^2) L^2; numbers L, \|w\|, and what the path's angle to
    f_u, which stays on one side of f_v, lacks to theta (do Carmo, Differential Geometry, 4-4).
    """
    p, numbers = SX.sym("p", len(surface.parameters)), SX.sym("numbers", 3)
    constant, place, w = ca.vertcat(p, numbers), SX.sym("place", 3), SX.sym("w", 2)
    state, drive = SX.sym("state", 3), SX.sym("drive", 2)

    def lame(uv: SX) -> SX:
        return surface.geometry_expr(p, uv[0], uv[1]).lame

    def angle(sideways: SX, integral: SX, h: SX) -> SX:
        lean = ca.atan2(sideways, ca.fabs(integral) / h[0])
        return ca.if_else(integral < 0, np.pi - lean, lean)

    c, h = rotation(place[2]) @ w, lame(place)
    integral = h[0] * c[0]
    rest = place[2] - angle(c[1], integral, h)
    pace = ca.norm_2(w)
    begin = ca.vertcat(place[:2], c[1] / h[1], integral, pace, rest, h[1] / pace)

    h = lame(state)
    slope = ca.jacobian(h[0], state[1])
    turn = numbers[0] / h[0] ** 2
    bend = turn**2 * h[0] * slope / h[1] ** 2
    motion = Kernel(
        "geodesic", ca.vertcat(state, drive), constant, ca.vertcat(turn, state[2], bend)
    )
    motion.nested, motion.reach = 1, surface.reach
    # A Newton step along the gradient of the speed's square puts it right; short of where that is
    # flat (equators), since rounding would be divided by its square.
    lean = h[1] * state[2] / numbers[1]
    excess = (numbers[0] / (h[0] * numbers[1])) ** 2 + lean**2 - 1
    slopes = ca.vertcat(ca.jacobian(excess, state[1]), 2 * lean)
    shift = -excess * slopes / (ca.sumsqr(slopes) + FLAT)
    back = ca.vertcat(state[0], state[1] + shift[0], state[2] + shift[1] * numbers[1] / h[1])
    motion.restores = (Restoration(Kernel("restore_geodesic", state, constant, back), 0, 0),)
    theta = angle(h[1] * state[2], numbers[0], h) + numbers[2]
    chart = ca.vertcat(state[:2], drive[0] * turn, drive[0] * state[2], theta)
    found = Kernel("geodesic_coordinates", ca.vertcat(state, drive), constant, chart)
    x, at = surface.chart_expr(p, state[0], state[1]), ca.vertcat(state[:2], theta)
    frames = Kernel("geodesic_frames", state, constant, frame_kernel(surface).function(at, p))
    return GeodesicForm(
        Kernel("geodesic_start", ca.vertcat(place, w), p, begin), motion,
        Kernel("geodesic_places", state, constant, at),
        Evaluator(Kernel("geodesic_points", state, constant, x), False, 3, False),
        Evaluator(frames, False, 3, False), Evaluator(found, False, 3, False), 1,
    )  # fmt: skip


class GeodesicTrack(MovingTrack):
    """Geodesics of a :class:`GeodesicForm`: panels of its states in arc length."""

    @kept
    def form(self) -> GeodesicForm:
        found = geodesic_form(self.surface, self.ambient)
        assert found is not None
        return found

    def _state_at(self, at: np.ndarray) -> np.ndarray:
        return self.run(self.form.body, self._own_state(at), self.problem.constants)

    def end(self) -> np.ndarray:
        return self.form.body.at(self.panels.end, self.problem.constants)[:, :AXIS]

    def _numbers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        unit = np.zeros_like(self.w)
        unit[:, 0] = 1.0
        return self.problem.constants, unit, unit

    def _point(self, data: TrackData) -> None:
        data.constants = address(self.problem.constants)

    def evaluator(self, output: str) -> Evaluator:
        return getattr(self.form, output)
