"""The motion of contact points on one kind of body over one interval, and what is read off it.

A track moves several bodies of one surface kind together. It knows the moving frame (x; p, q) of
each, with [p q] carried by parallel transport, and the velocity of the contact point in that frame.
Coordinates, rates, frame angle and curvature are evaluated from these by kernels, on demand.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from . import geometry
from .errors import ChartSingularity
from .kernels import Kernel, per_structure
from .surfaces import Surface

SX = ca.SX


def prefers_ambient(surface: Surface) -> bool:
    """Whether bodies of this surface are moved as (x, p, q) in space, else as (u, v, theta)."""
    return surface.ambient and not surface.developable


def rotation(angle: SX) -> SX:
    """Rot(angle), 2x2."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))


# --- symbolic: quantities of a moving frame ----------------------------------------------------


def frame_coordinates(surface: Surface, p: SX, x: SX, frame: SX, velocity: SX) -> SX:
    """(u, v, u', v', theta) from an ambient frame; frame is [p q], velocity a vector in space."""
    x_axis, y_axis, metric_root = surface.frame_expr(p, x)
    rates = geometry.upper_inverse(metric_root) @ ca.vertcat(
        ca.dot(velocity, x_axis), ca.dot(velocity, y_axis)
    )
    first = frame[:, 0]
    theta = ca.atan2(ca.dot(first, y_axis), ca.dot(first, x_axis))
    return ca.vertcat(*surface.coordinates_expr(p, x), rates, theta)


def chart_to_parallel(surface: Surface, ambient: bool, p: SX, state: SX, components: SX) -> SX:
    """The vector a f_u + b f_v in the parallel frame: Rot(theta)^T M (a, b)."""
    if ambient:
        x_axis, y_axis, metric_root = surface.frame_expr(p, state[0:3])
        vector = ca.horzcat(x_axis, y_axis) @ (metric_root @ components)
        return ca.reshape(state[3:9], 3, 2).T @ vector
    shape = surface.geometry_expr(p, state[0], state[1])
    return rotation(state[2]).T @ (shape.metric_root @ components)


def _ambient_symbols(surface: Surface) -> tuple[SX, SX, SX, SX]:
    state = SX.sym("state", 9)
    return state, state[0:3], ca.reshape(state[3:9], 3, 2), SX.sym("p", len(surface.parameters))


def _chart_symbols(surface: Surface) -> tuple[SX, geometry.ChartGeometry, SX]:
    state, p = SX.sym("state", 3), SX.sym("p", len(surface.parameters))
    return state, surface.geometry_expr(p, state[0], state[1]), p


@per_structure
def coordinate_kernel(surface: Surface, ambient: bool) -> Kernel:
    """point: state, c (2) -> u, v, u', v', theta; c is the velocity in the parallel frame."""
    c = SX.sym("c", 2)
    if ambient:
        state, x, frame, p = _ambient_symbols(surface)
        result = frame_coordinates(surface, p, x, frame, frame @ c)
    else:
        state, shape, p = _chart_symbols(surface)
        rates = geometry.upper_inverse(shape.metric_root) @ (rotation(state[2]) @ c)
        result = ca.vertcat(state[:2], rates, state[2])
    return Kernel("coordinates", ca.vertcat(state, c), p, result)


@per_structure
def frame_kernel(surface: Surface) -> Kernel:
    """point: chart state (u, v, theta) -> x, p, q (9)."""
    state, shape, p = _chart_symbols(surface)
    frame = shape.frame[:, :2] @ rotation(state[2])
    return Kernel("frames", state, p, ca.vertcat(shape.point, ca.vec(frame)))


@per_structure
def point_kernel(surface: Surface) -> Kernel:
    """point: chart state (u, v, theta) -> x (3)."""
    state, p = SX.sym("state", 3), SX.sym("p", len(surface.parameters))
    return Kernel("points", state, p, surface.chart_expr(p, state[0], state[1]))


@per_structure
def shape_kernel(surface: Surface, ambient: bool) -> Kernel:
    """point: state -> K in the parallel frame, as (K_pp, K_pq, K_qq)."""
    if ambient:
        state, x, frame, p = _ambient_symbols(surface)
        gradient, hessian = geometry.implicit_geometry(surface.implicit_expr(p, x), x)
        k = frame.T @ hessian @ frame / ca.norm_2(gradient)
    else:
        state, shape, p = _chart_symbols(surface)
        turn = rotation(state[2])
        k = turn.T @ shape.curvature_form @ turn
    return Kernel("shape", state, p, ca.vertcat(k[0, 0], k[0, 1], k[1, 1]))


@per_structure
def vector_kernel(surface: Surface, ambient: bool) -> Kernel:
    """point: state; constant: parameters, chart components (2) -> parallel components (2)."""
    state, p = SX.sym("state", 9 if ambient else 3), SX.sym("p", len(surface.parameters))
    components = SX.sym("components", 2)
    result = chart_to_parallel(surface, ambient, p, state, components)
    return Kernel("vector", state, ca.vertcat(p, components), result)


@per_structure
def lame_function(surface: Surface) -> ca.Function:
    """(parameters, chart state) -> h_u, h_v."""
    state, shape, p = _chart_symbols(surface)
    return ca.Function("lame", [p, state], [shape.lame])


@per_structure
def restoring_function(surface: Surface) -> ca.Function:
    """(state 9, p) -> state with x back on the surface (one Newton step) and [p q] orthonormal."""
    state, x, frame, p = _ambient_symbols(surface)
    level = surface.implicit_expr(p, x)
    gradient = ca.gradient(level, x)
    moved = x - level * gradient / ca.dot(gradient, gradient)
    normal = ca.substitute(gradient, x, moved)
    normal /= ca.norm_2(normal)
    first = frame[:, 0] - ca.dot(frame[:, 0], normal) * normal
    first /= ca.norm_2(first)
    return ca.Function("restore", [state, p], [ca.vertcat(moved, first, ca.cross(normal, first))])


# --- tracks ------------------------------------------------------------------------------------


@dataclass(eq=False)
class Track:
    """Bodies of one surface kind on [start, stop].

    Attributes
    ----------
    surface : Surface
        One of the bodies' surfaces; the others differ in their parameters only.
    parameters : (n_bodies, n_parameters)
    start, stop : float
        The interval, s.
    method, reason : str
        For :meth:`Plan.explain`.
    offset : (n_bodies, 2) or None
        Chart rates added to the motion (object rate offset).
    ambient : bool
        The form of the state: (x, p, q), else (u, v, theta).
    compiled : bool or None
        Evaluate with compiled kernels (None: those built before).
    anchors : tuple or None
        Times and continuous (u, v, theta) at them: (m,), (n_bodies, 3, m). Filled by the plan.
    """

    surface: Surface
    parameters: np.ndarray
    start: float
    stop: float
    method: str
    reason: str
    ambient: bool
    compiled: bool | None
    offset: np.ndarray | None = field(default=None, kw_only=True)
    anchors: tuple[np.ndarray, np.ndarray] | None = field(default=None, kw_only=True)

    def state(self, t: np.ndarray) -> np.ndarray:
        """The moving frame: (n_bodies, 9, n) ambient or (n_bodies, 3, n) chart."""
        raise NotImplementedError

    def drive(self, t: np.ndarray) -> np.ndarray:
        """Velocity of the contact point in the parallel frame without offset: (n_bodies, 2, n)."""
        raise NotImplementedError

    def anchor_times(self) -> np.ndarray:
        """Times between which coordinates move by less than half a period."""
        raise NotImplementedError

    @property
    def n_bodies(self) -> int:
        return len(self.parameters)

    def run(self, kernel: Kernel, points: np.ndarray, constants: np.ndarray) -> np.ndarray:
        out = np.empty((self.n_bodies, kernel.n_result, points.shape[-1]))
        kernel(points, constants, out, compiled=self.compiled)
        return out

    def frames(self, t: np.ndarray) -> np.ndarray:
        """(x, p, q) at times t: (n_bodies, 9, n)."""
        state = self.state(t)
        if self.ambient:
            return state
        return self.run(frame_kernel(self.surface), state, self.parameters)

    def positions(self, t: np.ndarray) -> np.ndarray:
        """Contact points in the body's frame: (n_bodies, 3, n), m."""
        state = self.state(t)
        if self.ambient:
            return state[:, :3]
        return self.run(point_kernel(self.surface), state, self.parameters)

    def velocity(self, t: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Velocity of the contact point in the parallel frame, offset included: (n, 2, n_t)."""
        c = self.drive(t)
        return c if self.offset is None else c + self.parallel(state, self.offset)

    def parallel(self, state: np.ndarray, components: np.ndarray) -> np.ndarray:
        """Parallel-frame components of a chart vector: (n_bodies, 2, n)."""
        constants = np.hstack([self.parameters, components])
        return self.run(vector_kernel(self.surface, self.ambient), state, constants)

    def shape(self, state: np.ndarray) -> np.ndarray:
        """(K_pp, K_pq, K_qq): (n_bodies, 3, n)."""
        return self.run(shape_kernel(self.surface, self.ambient), state, self.parameters)

    def raw_coordinates(self, t: np.ndarray) -> np.ndarray:
        """(u, v, u', v', theta), principal branch: (n_bodies, 5, n)."""
        points = np.concatenate([self.state(t), self.drive(t)], axis=1)
        return self.run(coordinate_kernel(self.surface, self.ambient), points, self.parameters)

    def coordinates(self, t: np.ndarray) -> np.ndarray:
        """(u, v, u', v', theta), continuous along the path: (n_bodies, 5, n).

        Raises
        ------
        ChartSingularity
            At a time when the contact passes through a pole or an umbilic.
        """
        with np.errstate(all="ignore"):
            values = self.raw_coordinates(t)
        if not np.isfinite(values).all():
            self._refuse(t, values)
        if self.offset is not None:
            values[:, 2:4] += self.offset[:, :, None]
        if self.ambient:
            self._continue(t, values)
        return values

    def _refuse(self, t: np.ndarray, values: np.ndarray) -> None:
        body, _, k = np.argwhere(~np.isfinite(values))[0]
        raise ChartSingularity(
            f"{self.surface!r}, body {body} of its track: at t = {t[k]:.17g} s the contact is at a "
            "singular point of the chart (pole or umbilic), where u', v' and psi do not exist. Ask "
            "for points, pose and twist there (they do), or for a time nearby"
        )

    def _continue(self, t: np.ndarray, values: np.ndarray) -> None:
        """Bring (u, v, theta) to the branch of the nearest anchor, in place."""
        assert self.anchors is not None
        times, anchors = self.anchors
        if len(times) == 1:
            reference = anchors
        else:
            reference = anchors[:, :, np.searchsorted(0.5 * (times[1:] + times[:-1]), t)]
        period_u, period_v = self.surface.periods()
        if self.surface.double_cover:
            u, v, turned = self.surface.align(
                values[:, 0], values[:, 1], reference[:, 0], reference[:, 1]
            )
            values[:, 0], values[:, 1] = u, v
            values[:, 2:4] *= np.where(turned, -1.0, 1.0)[:, None]
            values[:, 4] += np.pi * turned
        else:
            for row, period in ((0, period_u), (1, period_v)):
                if period is not None:
                    _wind(values[:, row], reference[:, row], period)
        _wind(values[:, 4], reference[:, 2], 2 * np.pi)

    def anchor(self, reference: np.ndarray | None) -> np.ndarray:
        """Fill :attr:`anchors`, continuing (n_bodies, 3) coordinates; returns those at stop."""
        times = self.anchor_times()
        with np.errstate(all="ignore"):
            raw = self.raw_coordinates(times)[:, [0, 1, 4]]
        u, v, theta = (raw[:, i].T for i in range(3))  # time first, as unwind wants
        if reference is not None:
            u, v, theta = (np.vstack([reference[:, i], w]) for i, w in enumerate((u, v, theta)))
        u, v, turned = self.surface.unwind(u, v)
        theta = np.unwrap(theta + np.pi * turned, axis=0)
        stacked = np.stack([u, v, theta], axis=0).transpose(2, 0, 1)
        if reference is not None:
            stacked = stacked[:, :, 1:]
        self.anchors = (times, np.ascontiguousarray(stacked))
        return stacked[:, :, -1]


def _wind(values: np.ndarray, reference: np.ndarray, period: float) -> None:
    """Add whole periods so that values lie nearest to the reference, in place."""
    turns = np.rint((reference - values) * (1.0 / period))
    if turns.any():
        values += period * turns
