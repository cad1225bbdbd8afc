"""The motion of contact points on one kind of body over one interval, and what is read off it.

A track moves several bodies of one surface kind together. It knows the moving frame (x; p, q) of
each, with [p q] carried by parallel transport, and the velocity of the contact point in that frame.
Coordinates, rates, frame angle and curvature are evaluated from these by kernels, on demand.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from . import geometry
from .errors import ChartSingularity, ContactSystemError
from .kept import T, kept
from .kernels import (
    PRELUDE,
    Kernel,
    address,
    c_source,
    compiled_library,
    function_address,
    is_built,
    per_structure,
    row_offsets,
)
from .profile import GainPiece
from .surfaces import SINGULAR, Surface

SX = ca.SX

LOCK = threading.RLock()
"""Held while something is found that plans keep: other threads may ask the same plan."""


class once(kept[T]):
    """As `kept`, but computed once, under LOCK: C holds pointers into what it gives."""

    def __get__(self, instance: Any, owner: type | None = None) -> T:
        with LOCK:
            return super().__get__(instance, owner)


def altered(instance: Any, without: Sequence[str] = (), **changes: Any) -> Any:
    """A copy with other attributes, ``without`` those that it must find anew.

    In less than half the time of `dataclasses.replace`, which finds all anew.
    """
    other = object.__new__(type(instance))
    known = other.__dict__
    known.update(instance.__dict__)
    for name in without:
        known.pop(name, None)
    known.update(changes)
    return other


AXIS = 6  # numbers of (x, p), to which q = n x p adds nothing
NODE, BRANCH = 4, 3  # the last constants of a great circle, see closed_form.circle_kernel


def standing_size(ambient: bool) -> int:
    """How many numbers say where a body stands: (x, p), or (u, v, theta)."""
    return AXIS if ambient else 3


def prefers_ambient(surface: Surface) -> bool:
    """Whether bodies of this surface are moved as (x, p, q) in space, else as (u, v, theta)."""
    return surface.ambient and not surface.developable


def in_space(surface: Surface, disturbed: bool) -> bool:
    """Whether a body is moved in space, as (x, p, q), by whether a disturbance acts on it.

    A disturbance is given in chart components. Where the chart is a double cover (triaxial
    ellipsoid) their sign belongs to the branch the path is on, which only the chart form knows.
    """
    return prefers_ambient(surface) and not (disturbed and surface.double_cover)


def rotation(angle: SX) -> SX:
    """Rot(angle), 2x2."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))


# --- symbolic: quantities of a moving frame ----------------------------------------------------


def frame_coordinates(surface: Surface, p: SX, x: SX, first: SX, velocity: SX) -> SX:
    """(u, v, u', v', theta) from a point x, the frame's first axis p and a velocity, in space."""
    x_axis, y_axis, metric_root = surface.frame_expr(p, x)
    rates = geometry.upper_inverse(metric_root) @ ca.vertcat(
        ca.dot(velocity, x_axis), ca.dot(velocity, y_axis)
    )
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


def _axis_symbols(surface: Surface) -> tuple[SX, SX, SX, SX]:
    state, p = SX.sym("state", AXIS), SX.sym("p", len(surface.parameters))
    frame = whole_frame(surface).function(state, p)
    return state, state[0:3], ca.reshape(frame[3:9], 3, 2), p


def _chart_symbols(surface: Surface) -> tuple[SX, geometry.ChartGeometry, SX]:
    state, p = SX.sym("state", 3), SX.sym("p", len(surface.parameters))
    return state, surface.geometry_expr(p, state[0], state[1]), p


@per_structure
def whole_frame(surface: Surface) -> Kernel:
    """point: x, p -> x, p, q (9): q = n x p, with the outward normal n."""
    axis, p = SX.sym("axis", AXIS), SX.sym("p", len(surface.parameters))
    gradient = ca.gradient(surface.implicit_expr(p, axis[0:3]), axis[0:3])
    second = ca.cross(gradient, axis[3:6]) / ca.norm_2(gradient)
    return Kernel("whole", axis, p, ca.vertcat(axis, second))


@per_structure
def coordinate_kernel(surface: Surface, ambient: bool, axis: bool = False) -> Kernel:
    """point: state, c (2) -> u, v, u', v', theta; c is the velocity in the parallel frame.

    ``axis``: the ambient state is (x, p) alone.
    """
    c = SX.sym("c", 2)
    if ambient:
        state, x, frame, p = _axis_symbols(surface) if axis else _ambient_symbols(surface)
        result = frame_coordinates(surface, p, x, frame[:, 0], frame @ c)
    else:
        state, shape, p = _chart_symbols(surface)
        rates = geometry.upper_inverse(shape.metric_root) @ (rotation(state[2]) @ c)
        result = ca.vertcat(state[:2], rates, state[2])
    return Kernel("coordinates", ca.vertcat(state, c), p, result)


@per_structure
def split_kernel(surface: Surface) -> Kernel:
    """point: x, p, two velocities c and d in the parallel frame (2 + 2) -> u, v, rates of c, theta,
    rates of d."""
    state, x, frame, p = _axis_symbols(surface)
    c, d = SX.sym("c", 2), SX.sym("d", 2)
    chart, aside = (frame_coordinates(surface, p, x, frame[:, 0], frame @ w) for w in (c, d))
    return Kernel("split", ca.vertcat(state, c, d), p, ca.vertcat(chart, aside[2:4]))


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
def restoring_kernel(surface: Surface) -> Kernel:
    """point: ambient state -> the state with x back on the surface and [p q] orthonormal.

    One Newton step along the gradient: what is left is the square of the defect.
    """
    state, x, frame, p = _ambient_symbols(surface)
    level = surface.implicit_expr(p, x)
    gradient = ca.gradient(level, x)
    moved = x - level * gradient / ca.dot(gradient, gradient)
    normal = ca.substitute(gradient, x, moved)
    normal /= ca.norm_2(normal)
    first = frame[:, 0] - ca.dot(frame[:, 0], normal) * normal
    first /= ca.norm_2(first)
    return Kernel("restore", state, p, ca.vertcat(moved, first, ca.cross(normal, first)))


@per_structure
def restoring_axis(surface: Surface) -> Kernel:
    """:func:`restoring_kernel` of (x, p) alone."""
    state, p = SX.sym("state", AXIS), SX.sym("p", len(surface.parameters))
    back = restoring_kernel(surface).function(ca.vertcat(state, SX(3, 1)), p)[:AXIS]
    return Kernel("restore", state, p, back)


@per_structure
def axis_kernel(surface: Surface) -> Kernel:
    """point: chart state (u, v, theta) -> x, p (6), on the surface to rounding."""
    state, p = SX.sym("state", 3), SX.sym("p", len(surface.parameters))
    frame = frame_kernel(surface).function(state, p)
    return Kernel("axes", state, p, restoring_axis(surface).function(frame[:AXIS], p))


@per_structure
def lame_kernel(surface: Surface) -> Kernel:
    """point: chart state -> h_u, h_v."""
    state, shape, p = _chart_symbols(surface)
    return Kernel("lame", state, p, shape.lame)


@per_structure
def regularity_kernel(surface: Surface) -> Kernel:
    """point: u, v -> the lesser of M's diagonal, m: 0 where the chart is singular."""
    u, v, p = SX.sym("u"), SX.sym("v"), SX.sym("p", len(surface.parameters))
    m = surface.geometry_expr(p, u, v).metric_root
    return Kernel("regularity", ca.vertcat(u, v), p, ca.fmin(m[0, 0], m[1, 1]))


@per_structure
def scale_kernel(surface: Surface, ambient: bool) -> Kernel:
    """point: (x, p) or chart state; constant: parameters, size -> 1 / (size of each state).

    Positions count by the body's size, angles and directions by 1.
    """
    size = SX.sym("size")
    if ambient:
        state, p = SX.sym("state", AXIS), SX.sym("p", len(surface.parameters))
        scale = ca.vertcat(SX.ones(3) / size, SX.ones(3))
    else:
        state, shape, p = _chart_symbols(surface)
        scale = ca.vertcat(ca.fmax(shape.lame / size, 1e-2), 1)
    return Kernel("scale", state, ca.vertcat(p, size), scale)


# --- tracks ------------------------------------------------------------------------------------

PARTS = 16  # of an integrator's step, between which a search for singular points looks


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
    ambient : bool
        The form of the state: (x, p, q), else (u, v, theta).
    compiled : bool or None
        Evaluate with compiled kernels (None: those built before).
    offset : (n_bodies, 2) or None
        Chart rates added to the motion (object rate offset).
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

    def state(self, t: np.ndarray) -> np.ndarray:
        """The moving frame: (n_bodies, 9, n) ambient or (n_bodies, 3, n) chart."""
        raise NotImplementedError

    def end(self) -> np.ndarray:
        """The moving frame at ``stop``: (x, p), (n_bodies, 6), or (u, v, theta), (n_bodies, 3)."""
        return self.state(np.array([self.stop]))[:, :AXIS, 0]

    def drive(self, t: np.ndarray) -> np.ndarray:
        """Velocity of the contact point in the parallel frame without offset: (n_bodies, 2, n)."""
        raise NotImplementedError

    @property
    def anchored(self) -> bool:
        """Whether :meth:`coordinates` knows the branch to continue."""
        return True

    def anchor(self, begin: np.ndarray) -> None:
        """Continue the coordinates from (u, v, theta) at ``start``: (n_bodies, 3)."""

    def singular_place(
        self,
        at: np.ndarray,
        places: np.ndarray,
        place: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> tuple[float, float] | None:
        """u, v of a singular point of the chart that a path goes through; None without one.

        Integrators step across one that a path heads for along a meridian: the equations are
        smooth there, and the contact frame turns over.

        Parameters
        ----------
        at : (n,)
            Local times, :func:`in_parts`.
        places : (n_bodies, 2, n)
            u, v then.
        place : callable
            (m,) local times, (m,) bodies -> u, v of each body at its own, (m, 2).
        """
        kernel, lost = regularity_kernel(self.surface), SINGULAR * self.surface.size
        values = self.run(kernel, places, self.parameters)[:, 0]
        before, here, after = values[:, :-2], values[:, 1:-1], values[:, 2:]
        step = np.diff(at)
        with np.errstate(all="ignore"):  # steps may be shorter than a time resolves
            slope = np.fmax((before - here) / step[:-1], (after - here) / step[1:])
            # |x| that falls to 0 beside the least of three places does so within half the longer
            # step
            near = here <= 2 / 3 * np.fmax(step[:-1], step[1:]) * slope
        bodies, k = np.nonzero((here <= np.fmin(before, after)) & near)
        fall = slope[bodies, k] * (at[k + 2] - at[k])  # twice that of |x| on half the bracket
        low, high = np.maximum(at[k], at[1]), np.minimum(at[k + 2], at[-2])
        for _ in range(100):  # thirds of all brackets at once: to neighbouring floats
            if not len(bodies):
                break
            tried = np.concatenate([2 * low + high, low + 2 * high]) / 3
            both = np.concatenate([bodies, bodies])
            reached = place(tried, both)
            found = kernel.at(reached, self.parameters[both])[:, 0]
            if (found <= lost).any():
                u, v = reached[np.argmax(found <= lost)].tolist()
                return u, v
            first, second = found.reshape(2, -1)
            left = first <= second
            low, high = (
                np.where(left, low, tried[: len(low)]), np.where(left, tried[len(low) :], high),
            )  # fmt: skip
            fall *= 2 / 3  # what is left of a bracket lies this near to the better of the two
            may = ~(np.fmin(first, second) > fall)
            bodies, low, high, fall = bodies[may], low[may], high[may], fall[may]
        return None

    @property
    def n_bodies(self) -> int:
        return len(self.parameters)

    def run(self, kernel: Kernel, points: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """Evaluate a kernel at (n_bodies, n_point, n): (n_bodies, n_result, n)."""
        out = np.empty((self.n_bodies, kernel.n_result, points.shape[-1]))
        kernel(points, constants, out, compiled=self.compiled)
        return out

    def frames(self, t: np.ndarray) -> np.ndarray:
        """(x, p, q) at times t: (n_bodies, 9, n)."""
        out = np.empty((self.n_bodies, 9, len(t)))
        return out if self._evaluate("frames", t, out) == 0 else self._frames(t)

    def _frames(self, t: np.ndarray) -> np.ndarray:
        state = self.state(t)
        if self.ambient:
            return state
        return self.run(frame_kernel(self.surface), state, self.parameters)

    def points(self, t: np.ndarray, out: np.ndarray) -> None:
        """Write the contact points in the body's frame, m, to out (n_bodies, 3, n)."""
        if self._evaluate("points", t, out) is None:
            self._points(t, out)

    def _points(self, t: np.ndarray, out: np.ndarray) -> None:
        state = self.state(t)
        if self.ambient:
            out[...] = state[:, :3]
        else:
            kernel = point_kernel(self.surface)
            kernel(state, self.parameters, out, compiled=self.compiled)

    def entry(self, output: str) -> tuple[Evaluator, int] | None:
        """The compiled evaluation of "points", "frames" or "coordinates" and the address of this
        track's ``track_t``; None where there is none."""
        if output not in self._entries:
            self._entries[output] = self._entry(output)
        return self._entries[output]

    def data_at(self, output: str) -> int | None:
        """The address alone, of a track whose kind is known to have a compiled evaluation."""
        entry = self.entry(output)
        return None if entry is None else entry[1]

    def _entry(self, output: str) -> tuple[Evaluator, int] | None:
        return None

    @kept
    def _entries(self) -> dict[str, tuple[Evaluator, int] | None]:
        return {}

    def again(self, tolerance: float) -> Track | None:
        """This track for another tolerance; None if it must be planned anew for that."""
        return None

    def _evaluate(self, output: str, t: np.ndarray, out: np.ndarray) -> int | None:
        """Run the compiled evaluation; its code, or None where there is none."""
        entry = self.entry(output)
        if entry is None:
            return None
        t = t if t.flags.c_contiguous else np.ascontiguousarray(t)
        strides = out.strides
        return entry[0].library.evaluate(
            entry[1], len(t), address(t), out.ctypes.data,
            row_offsets(tuple(range(out.shape[1])), strides[1] // 8),
            strides[0] // 8,
        )  # fmt: skip

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

    def coordinates(self, t: np.ndarray, out: np.ndarray) -> None:
        """Write u, v, u', v', theta, continuous along the path, to out.

        Parameters
        ----------
        t : (n,)
        out : (n_bodies, 5, n), unit stride along the last axis

        Raises
        ------
        ChartSingularity
            At a time when the contact passes through a pole or an umbilic.
        """
        code = self._evaluate("coordinates", t, out)
        if code is not None:
            if code < 0:
                raise self.singular(float(t[-1 - code]))
            return
        with np.errstate(all="ignore"):
            values = self._coordinates(t)
        if not np.isfinite(values).all():
            raise self.singular(float(t[np.argwhere(~np.isfinite(values))[0][2]]))
        if self.offset is not None:
            values[:, 2:4] += self.offset[:, :, None]
        out[...] = values

    def _coordinates(self, t: np.ndarray) -> np.ndarray:
        points = np.concatenate([self.state(t), self.drive(t)], axis=1)
        return self.run(coordinate_kernel(self.surface, self.ambient), points, self.parameters)

    def singular(self, t: float) -> ChartSingularity:
        """The error of a contact at a pole or an umbilic at time t."""
        return ChartSingularity(
            f"{self.surface!r}: at t = {t:.17g} s the contact is at a singular point of the chart "
            f"({self.surface.chart.singular_at or 'pole'}), where u', v' and psi do not exist. Ask "
            "for points, pose and twist there (they do), or for a time nearby"
        )


def in_parts(edges: np.ndarray) -> np.ndarray:
    """Edges of K steps -> PARTS equal parts of each, and one before and one after: (K PARTS + 3,).

    A pole beside an end is between them too.
    """
    steps = np.diff(edges)[:, None] / PARTS
    at = edges[:-1, None] + steps * np.arange(PARTS)
    return np.concatenate([edges[:1] - steps[0], at.ravel(), edges[-1:], edges[-1:] + steps[-1]])


def passed(where: str, surface: Surface, place: tuple[float, float]) -> ContactSystemError:
    """The error of a path that :meth:`Track.singular_place` told of."""
    other = "use the default method" if surface.has_implicit else "give an ImplicitSurface"
    return ContactSystemError(
        f"{where}: the path goes through a singular point of its chart, {surface!r} at (u, v) = "
        f"({place[0]:.9g}, {place[1]:.9g}), where the contact frame turns over; start elsewhere, "
        f"change the direction, end the scene before, or {other}, which needs no chart"
    )


def wind(values: np.ndarray, reference: np.ndarray, period: float) -> None:
    """Add whole periods so that values lie nearest to the reference, in place."""
    turns = np.rint((reference - values) * (1.0 / period))
    if turns.any():
        values += period * turns


# --- compiled evaluation -------------------------------------------------------------------------


class Drive(ctypes.Structure):
    """``drive_t`` of c/common.h: sigma and decay of a GainPiece."""

    _fields_ = [("n_sigma", ctypes.c_long), ("n_exponent", ctypes.c_long), ("power", ctypes.c_long),
                ("sigma", ctypes.c_void_p), ("exponent", ctypes.c_void_p)]  # fmt: skip


def drive_data(piece: GainPiece) -> Drive:
    """A piece for C; it points to the piece's arrays."""
    sigma, _, exponent = piece.arrays
    return Drive(len(sigma), len(exponent), piece.power, address(sigma), address(exponent))


class TrackData(ctypes.Structure):
    """``track_t`` of c/common.h."""

    _fields_ = (
        [(name, ctypes.c_double) for name in ("start", "stop")]
        + [("drive", Drive)]
        + [(name, ctypes.c_long) for name in (
            "nb", "slips", "by_length", "n_panels", "panel_stride", "body_stride", "n_constants",
            "n_drive", "n_anchors", "double_cover")]
        + [(name, ctypes.c_double) for name in ("period_u", "period_v")]
        + [(name, ctypes.c_void_p) for name in ("constants", "length", "w", "v")]
        + [(name, ctypes.c_long) for name in ("forced", "w_row", "v_row")]
        + [(name, ctypes.c_void_p) for name in (
            "turn", "offset", "edges", "coefficients", "anchor_at", "anchors")]
    )  # fmt: skip


class Evaluator:
    """The compiled evaluation of one kernel over a whole track (c/tracks.c)."""

    def __init__(self, kernel: Kernel, closed: bool, n_states: int, winds: bool):
        self.kernel = kernel
        rows = ", ".join(f"{i} * POINTS" for i in range(kernel.n_point))
        head = PRELUDE + "static __attribute__((noinline)) " + kernel.loop_source
        head += f"#define KERNEL {kernel.name}\n#define NP {kernel.n_point}\n"
        head += f"#define NC {kernel.n_constant}L\n#define NR {kernel.n_result}\n"
        head += f"#define NS {n_states}\n#define ROWS {rows}\n"
        head += "#define CLOSED\n" * closed + "#define WINDS\n" * winds
        self.source = head + c_source("tracks.c")

    @kept
    def built(self) -> bool:
        """Whether the compiled form lies in the cache (looked up once)."""
        return is_built(self.source)

    @kept
    def library(self) -> ctypes.CDLL:
        """``evaluate`` and, where coordinates are continued, ``anchor``."""
        library = compiled_library(self.source)
        pointer, integer = ctypes.c_void_p, ctypes.c_long
        library.evaluate.argtypes = [pointer, integer, pointer, pointer, pointer, integer]
        library.evaluate.restype = integer
        if hasattr(library, "anchor"):
            library.anchor.argtypes = [pointer] * 5
            library.anchor.restype = None
        return library

    @kept
    def pointer(self) -> int:
        """Address of ``evaluate``."""
        return function_address(self.library.evaluate)

    def usable(self, compiled: bool | None) -> bool:
        """As :meth:`Kernel.usable`."""
        return self.built if compiled is None else compiled


@per_structure
def evaluator(surface: Surface, ambient: bool, output: str) -> Evaluator:
    """The evaluator of a panel track: "coordinates", "points", "frames", or "split": see
    c/program.c."""
    if output == "frames":
        kernel = whole_frame(surface) if ambient else frame_kernel(surface)
        return Evaluator(kernel, False, kernel.n_point, False)
    if output == "split":
        return Evaluator(split_kernel(surface), False, AXIS, False)
    if output == "coordinates":
        kernel = coordinate_kernel(surface, ambient, ambient)
        return Evaluator(kernel, False, kernel.n_point - 2, ambient)
    if ambient:
        x = SX.sym("x", 3)
        none = SX.sym("none", len(surface.parameters))
        return Evaluator(Kernel("identity", x, none, x), False, 3, False)
    return Evaluator(point_kernel(surface), False, 3, False)
