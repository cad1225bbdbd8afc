"""Contact curves that need no integration (theory section 6).

* Great circles on a sphere: the moving frame is carried by one rotation.
* Developable bodies (plane, cylinder): the developed plane curve *is* the curve, slip or not;
  slip costs the scalar quadrature g(t) = int sigma exp(-L).
"""

from __future__ import annotations

import ctypes
import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from .charts import TINY, TURN
from .development import slip_displacement
from .kept import kept
from .kernels import Kernel, address, made_once, per_structure
from .panels import Panels, Problem, integrate
from .profile import GainPiece
from .surfaces import Surface
from .tracks import (
    AXIS,
    BRANCH,
    NODE,
    Evaluator,
    Track,
    TrackData,
    altered,
    drive_data,
    frame_kernel,
    once,
    point_kernel,
    rotation,
    whole_frame,
)

SX = ca.SX

# A phase of 2 pi k carries k times the rounding of the arc length; beyond this many radians it is
# computed in doubled precision instead.  256 rad leave 256 * 1.1e-16 * 2 = 6e-14 of the radius.
LONG_PHASE = 256.0


@per_structure
def circle_kernel(surface: Surface, output: str) -> Kernel:
    """Great circle through x0 along e: x = x0 cos(phi) + r e sin(phi).

    point: phi modulo 2 pi, speed, phi. constant: parameters, x0/r (3), e (3), b = third axis (3),
    direction of the drive in [p q] (2), inclination (cosine, sine), phase of x0 from the node where
    the circle crosses the equator upwards and longitude of that node (4 in all), branch (3).
    ``output``: "points" -> x; "frames" -> x, p, q; "coordinates" -> u, v, u', v', theta.

    By spherical trigonometry a great circle's longitude stays within pi/2 of branch[0] + branch[1]
    phi, and theta within pi/2 of branch[2]; both are continuous after any number of turns.
    """
    point, p = SX.sym("point", 3), SX.sym("p", len(surface.parameters))
    start, along, across = SX.sym("n", 3), SX.sym("e", 3), SX.sym("b", 3)
    turn, node, branch = SX.sym("w", 2), SX.sym("node", NODE), SX.sym("branch", BRANCH)
    constant = ca.vertcat(p, start, along, across, turn, node, branch)
    if output == "coordinates":
        flat, steep = node[0], node[1]
        sin, cos = ca.sin(point[0] + node[2]), ca.cos(point[0] + node[2])
        rho = ca.sqrt(cos**2 + (flat * sin) ** 2)  # sin u
        v = branch[0] + branch[1] * (point[2] + _lead(flat, steep, sin, cos))
        pace, climb = point[1] / rho, (branch[1] * steep) * cos  # dz/dphi eastwards
        rates = (-branch[1] / p[0]) * (climb * pace), (branch[1] * flat / p[0]) * (pace / rho)
        theta = branch[2] + ca.atan2(climb, flat)
        result = ca.vertcat(ca.atan2(rho, steep * sin), v, *rates, theta)
        return Kernel("circle_coordinates", point, constant, result)
    cos, sin = ca.cos(point[0]), ca.sin(point[0])
    x = cos * (p[0] * start) + sin * (p[0] * along)
    if output == "points":
        return Kernel("circle_points", point, constant, x)
    tangent = cos * along - sin * start
    first = turn[0] * tangent - turn[1] * across
    second = turn[1] * tangent + turn[0] * across
    return Kernel("circle_frames", point, constant, ca.vertcat(x, first, second))


def _lead(flat: SX, steep: SX, sin: SX, cos: SX) -> SX:
    """By how much a great circle's longitude from its node is ahead of its phase: within pi/2."""
    bend = steep**2 / (-1 - flat)  # flat - 1
    return ca.atan2(bend * (sin * cos), cos**2 + flat * sin**2)


def nearest_branch(angle: SX, reference: SX | float) -> SX:
    """The angle, by whole turns as near as can be to a reference."""
    return angle + TURN * ca.floor((reference - angle) / TURN + 0.5)


@per_structure
def circle_evaluator(surface: Surface, output: str) -> Evaluator:
    """The compiled evaluator of :func:`circle_kernel`."""
    return Evaluator(circle_kernel(surface, output), True, 0, False)


@dataclass(eq=False)
class CircleTrack(Track):
    """Geodesics of spheres (also bowls).

    Attributes
    ----------
    circle : Circle
        The great circles.
    piece : GainPiece
        sigma in local time.
    """

    circle: Circle
    piece: GainPiece

    def __post_init__(self) -> None:
        self._memories: dict[str, dict[str, Any]] = {"points": {}, "coordinates": {}}

    @kept
    def _long(self) -> bool:
        turn = self.circle.fastest * self.piece.arc_length(self.stop - self.start)
        return turn > LONG_PHASE

    def _phases(self, t: np.ndarray, only_place: bool = True) -> np.ndarray:
        """Inputs of the kernel; phase modulo 2 pi alone, or speed and whole phase too."""
        tau = t - self.start
        points, circle = np.empty((3, self.n_bodies, len(t))), self.circle
        phase = points[0] if only_place else points[2]
        length = self.piece.arc_length(tau) if only_place else self.piece.rounded_length(tau)
        np.multiply(circle.phase_per_metre[:, None], length, out=phase)
        if not only_place:
            np.multiply(circle.pace[:, None], self.piece.speed(tau), out=points[1])
            points[0] = phase
        if self._long:
            points[0] = long_phase(circle.w, self.parameters[:, 0], self.piece.sigma, tau)
            if not only_place:
                points[2] = points[0] + TURN * np.rint((points[2] - points[0]) / TURN)
        return points.transpose(1, 0, 2)

    def state(self, t: np.ndarray) -> np.ndarray:
        return self.frames(t)

    def _frames(self, t: np.ndarray) -> np.ndarray:
        kernel = circle_kernel(self.surface, "frames")
        return self.run(kernel, self._phases(t), self.circle.constants)

    def drive(self, t: np.ndarray) -> np.ndarray:
        return self.circle.w[:, :, None] * self.piece.speed(t - self.start)

    def _points(self, t: np.ndarray, out: np.ndarray) -> None:
        kernel = circle_kernel(self.surface, "points")
        constants, memory = self.circle.constants, self._memories["points"]
        kernel(self._phases(t), constants, out, self.compiled, memory)

    def _entry(self, output: str) -> tuple[Evaluator, int] | None:
        compiled = circle_evaluator(self.surface, output)
        if self._long or not compiled.usable(self.compiled):
            return None
        return compiled, self._data[0]

    def data_at(self, output: str) -> int | None:
        return None if self._long else self._data[0]

    def moved(self, circle: Circle) -> CircleTrack:
        """This track on other circles."""
        data = TrackData.from_buffer_copy(self._data[1][0])
        data.constants, data.w, data.v = (
            address(circle.constants), address(circle.pace), address(circle.phase_per_metre),
        )  # fmt: skip
        return altered(
            self, ("_entries", "_long"), circle=circle, _memories={"points": {}, "coordinates": {}},
            _data=(ctypes.addressof(data), (data, circle)),
        )  # fmt: skip

    def again(self, tolerance: float) -> Track:
        return self

    def _coordinates(self, t: np.ndarray) -> np.ndarray:
        kernel = circle_kernel(self.surface, "coordinates")
        out = np.empty((self.n_bodies, 5, len(t)))
        constants, memory = self.circle.constants, self._memories["coordinates"]
        kernel(self._phases(t, False), constants, out, self.compiled, memory)
        return out

    @once
    def _data(self) -> tuple[int, tuple]:
        """Address of the C form of this track, and what it points to."""
        piece, circle = self.piece, self.circle
        data = TrackData(
            start=self.start, stop=self.stop, drive=drive_data(piece), nb=self.n_bodies,
            constants=address(circle.constants), length=address(piece.arrays[1]),
            w=address(circle.pace), v=address(circle.phase_per_metre),
            n_constants=circle.constants.shape[1], n_drive=1,
        )  # fmt: skip
        return ctypes.addressof(data), (data, circle)

    @property
    def anchored(self) -> bool:
        return self.circle.branched

    def anchor(self, begin: np.ndarray) -> None:
        self.circle.branch(begin)
        self._memories["coordinates"].clear()


@dataclass(eq=False)
class Circle:
    """Great circles of several bodies: where they start and how they run.

    Attributes
    ----------
    w : (n, 2)
        Path velocity in the parallel frame.
    pace, phase_per_metre : (n,)
        |w| and |w|/r.
    constants : (n, n_constant)
        See :func:`circle_kernel`.
    """

    w: np.ndarray
    pace: np.ndarray
    phase_per_metre: np.ndarray
    constants: np.ndarray
    branched: bool = False

    @property
    def fastest(self) -> float:
        """Greatest phase per metre."""
        return max(self.phase_per_metre.tolist())  # of the few there are: numpy's takes 2 us

    def branch(self, begin: np.ndarray) -> None:
        """Fix the branch of v and theta from (u, v, theta) at the start: (n, 3)."""
        node = self.constants[:, -BRANCH - NODE : -BRANCH]
        points = np.concatenate([begin[:, 1:], self.w, node], axis=1)
        self.constants[:, -BRANCH:] = circle_branch().at(points, np.empty((len(points), 0)))
        self.branched = True


def pair_of(tracks: Sequence[CircleTrack]) -> CircleTrack | None:
    """Two tracks of one surface kind over one interval as one, body by body in turn; or None."""
    if len(tracks) != 2:
        return None
    one, two = tracks
    alike = one.surface.structure == two.surface.structure and one.piece is two.piece
    if not alike or one.compiled != two.compiled:
        return None
    a, b = one.circle, two.circle

    def woven(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        both = np.empty((2 * len(x), *x.shape[1:]))
        both[0::2], both[1::2] = x, y
        return both

    circle = Circle(
        woven(a.w, b.w), woven(a.pace, b.pace), woven(a.phase_per_metre, b.phase_per_metre),
        woven(a.constants, b.constants),
    )  # fmt: skip
    return CircleTrack(
        one.surface, woven(one.parameters, two.parameters), one.start, one.stop, one.method, "",
        True, one.compiled, circle=circle, piece=one.piece,
    )  # fmt: skip


@made_once
def circle_branch() -> Kernel:
    """point: v, theta, w (2), node (4) -> the branch of :func:`circle_kernel`'s constants.

    v and theta say which branch, and may be a little off; where the circle is, the node says.
    """
    point = SX.sym("point", 8)
    v, theta, w, flat, steep, past, node = ca.vertsplit(point, [0, 1, 2, 4, 5, 6, 7, 8])
    turn = ca.atan2(w[1], w[0])  # 0 for a point at rest
    azimuth = theta + turn
    sense = ca.if_else(ca.sin(azimuth) < 0, -1, 1)
    reference = v - sense * _lead(flat, steep, ca.sin(past), ca.cos(past))
    begin = nearest_branch(node + sense * past, reference)
    middle = nearest_branch(sense * (np.pi / 2) - turn, theta)
    return Kernel("circle_branch", point, SX(0, 1), ca.vertcat(begin, sense, middle))


@per_structure
def circle_start(surface: Surface) -> Kernel:
    """point: x, p (6), w (2) -> the constants of :func:`circle_kernel` but for the branch, |w|,
    |w|/r."""
    axis, w = SX.sym("axis", AXIS), SX.sym("w", 2)
    numbers = SX.sym("p", len(surface.parameters))
    x, p, q = ca.vertsplit(whole_frame(surface).function(axis, numbers), [0, 3, 6, 9])
    pace = ca.sqrt(ca.dot(w, w))
    # A contact point at rest has no direction; p will do.
    turn = ca.if_else(pace > 0, w / ca.fmax(pace, TINY), ca.vertcat(1, 0))
    along, across = turn[0] * p + turn[1] * q, turn[0] * q - turn[1] * p
    r = numbers[0]
    n = x / r
    past = ca.atan2(n[2], along[2])
    _, node = surface.coordinates_expr(numbers, r * (ca.cos(past) * n - ca.sin(past) * along))
    flat = ca.fabs(n[0] * along[1] - n[1] * along[0])
    circle = ca.vertcat(flat, ca.norm_2(ca.vertcat(n[2], along[2])), past, node)
    result = ca.vertcat(numbers, n, along, across, turn, circle, SX(BRANCH, 1), pace, pace / r)
    return Kernel("circle_start", ca.vertcat(axis, w), numbers, result)


def great_circle(
    surface: Surface, parameters: np.ndarray, begin: np.ndarray, w: np.ndarray
) -> Circle:
    """The circles through (x, p), (n, 6), with path velocities w, (n, 2)."""
    found = circle_start(surface).at(np.concatenate([begin, w], axis=1), parameters)
    pace, phase_per_metre = np.ascontiguousarray(found[:, -2:].T)
    return Circle(w, pace, phase_per_metre, np.ascontiguousarray(found[:, :-2]))


@made_once
def turned() -> Kernel:
    """point: theta, w (2) -> Rot(theta) w."""
    point = SX.sym("point", 3)
    return Kernel("turned", point, SX(0, 1), rotation(point[0]) @ point[1:])


@per_structure
def line_evaluator(surface: Surface, output: str, slips: bool) -> Evaluator:
    """The developed curve on a developable surface, compiled: a straight line but for slip.

    point: length, speed, length; constant: parameters, u, v, theta, and (u, v) per metre. With
    slip: s, g, speed, -speed decay; (u, v) per metre of g too.
    """
    p, begin = SX.sym("p", len(surface.parameters)), SX.sym("begin", 3)
    along, aside = SX.sym("along", 2), SX.sym("aside", 2 * slips)
    point = SX.sym("point", 4 if slips else 3)
    at, rates = begin[:2] + along * point[0], along * point[2 if slips else 1]
    if slips:
        at, rates = at - aside * point[1], rates + aside * point[3]
    if output == "points":
        result = surface.chart_expr(p, at[0], at[1])
    elif output == "frames":
        result = frame_kernel(surface).function(ca.vertcat(at, begin[2]), p)
    else:
        result = ca.vertcat(at, rates, begin[2])
    kernel = Kernel(f"line_{output}", point, ca.vertcat(p, begin, along, aside), result)
    return Evaluator(kernel, not slips, 2 * slips, False)


@functools.lru_cache(maxsize=256)
def slip_length(piece: GainPiece, slip_matters: bool, compiled: bool | None) -> Panels:
    """s(t) and g(t) over a piece, right to rounding for all who plan with this profile and gain.

    Unless ``slip_matters``, g is left at 0.
    """
    span = piece.stop - piece.start
    problem = Problem(
        name=f"quadrature of slip over [{piece.start:g}, {piece.stop:g}] s",
        start=np.zeros((1, 2)),
        constants=np.zeros((1, 1)),
        scale=np.full((1, 2), 1.0 / max(piece.arc_length(span), TINY)),
        drive=piece,
        length=span,
        first=4.0 * span,  # at any tolerance
        slip=float(slip_matters),
    )
    kernel = slip_displacement()
    if not slip_matters:
        return integrate(kernel, problem, 1e-15, compiled)
    rough = integrate(kernel, problem, 1e-3, compiled)  # how large g is
    problem.scale[0, 1] = 1.0 / max(rough.end[0, 1], TINY)
    return integrate(kernel, problem, 1e-15, compiled)


@dataclass(eq=False)
class FlatTrack(Track):
    """Plane and cylinder: u, v are linear in the developed displacement and theta is constant.

    Attributes
    ----------
    begin : (n_bodies, 3)
        u, v, theta at ``start``.
    w, v : (n_bodies, 2)
        Drive sigma (w - v decay) in the parallel frame.
    lame : (n_bodies, 2)
        h_u, h_v, constant.
    piece : GainPiece
    slip_length : Panels or None
        s(t) and g(t); None where v is zero.
    """

    begin: np.ndarray
    w: np.ndarray
    v: np.ndarray
    lame: np.ndarray
    piece: GainPiece
    slip_length: Panels | None
    constants: np.ndarray | None = None

    def __post_init__(self) -> None:
        theta, none = self.begin[:, 2:], np.empty((self.n_bodies, 0))
        self.along, self.aside = (
            turned().at(np.concatenate([theta, w], axis=1), none) for w in (self.w, self.v)
        )

    def again(self, tolerance: float) -> Track | None:
        return self

    def _entry(self, output: str) -> tuple[Evaluator, int] | None:
        compiled = line_evaluator(self.surface, output, self.slip_length is not None)
        if self.offset is not None or self._long:
            return None
        return (compiled, self._data[0]) if compiled.usable(self.compiled) else None

    def moved(
        self, begin: np.ndarray, w: np.ndarray, v: np.ndarray, lame: np.ndarray,
        constants: np.ndarray,
    ) -> FlatTrack:  # fmt: skip
        """This track from another start; constants: see :func:`line_evaluator`."""
        return dataclasses.replace(self, begin=begin, w=w, v=v, lame=lame, constants=constants)

    @once
    def _data(self) -> tuple[int, tuple]:
        """Address of the C form of this track, and what it points to."""
        constants, panels, piece = self.constants, self.slip_length, self.piece
        if constants is None:
            slopes = [self.along / self.lame]
            if panels is not None:
                slopes.append(self.aside / self.lame)
            constants = np.hstack([self.parameters, self.begin, *slopes])
        units = ([1.0], [1.0]) if panels is None else ([1.0, 0.0], [0.0, 1.0])
        w, v = (np.tile(unit, (self.n_bodies, 1)) for unit in units)
        data = TrackData(
            start=self.start, stop=self.stop, drive=drive_data(piece), nb=self.n_bodies,
            constants=address(constants), length=address(piece.arrays[1]), w=address(w),
            v=address(v), n_constants=constants.shape[1], n_drive=w.shape[1],
        )  # fmt: skip
        if panels is not None:  # the same for all bodies
            series = panels.coefficients
            at = panels.at or (address(panels.edges), address(series))
            data.slips, data.n_panels, data.panel_stride = True, panels.count, series[0].size
            data.edges, data.coefficients = at
        return ctypes.addressof(data), (data, piece, constants, w, v, panels)

    @kept
    def _long(self) -> bool:
        """Whether whole turns must be taken off somewhere."""
        span = self.piece.arc_length(self.stop - self.start)
        moved = np.abs(self.along / self.lame) * span + np.abs(self.begin[:, :2])
        return bool((moved / self.surface.size).max() > LONG_PHASE)

    def state(self, t: np.ndarray) -> np.ndarray:
        return self._state(t - self.start, False)

    def _state(self, tau: np.ndarray, reduced: bool) -> np.ndarray:
        """u, v, theta; with ``reduced``, whole turns are taken off long paths."""
        length = self.piece.arc_length(tau)
        out = np.empty((self.n_bodies, 3, len(tau)))
        moved = out[:, :2]
        np.multiply((self.along / self.lame)[:, :, None], length, out=moved)
        moved += self.begin[:, :2, None]
        if reduced and np.abs(moved / self.surface.size).max(initial=0.0) > LONG_PHASE:
            exact = long_length(self.piece.sigma, tau)
            for i, period in enumerate(self.surface.periods()):
                moved[:, i] = long_line(
                    self.begin[:, i], self.along[:, i], self.lame[:, i], exact, period is not None
                )
        if self.slip_length is not None:
            shift = self.slip_length.evaluate(tau, slice(1, 2))[0]
            moved -= (self.aside / self.lame)[:, :, None] * shift
        if self.offset is not None:
            moved += self.offset[:, :, None] * tau
        out[:, 2] = self.begin[:, 2:]
        return out

    def _frames(self, t: np.ndarray) -> np.ndarray:
        state = self._state(t - self.start, True)
        return self.run(frame_kernel(self.surface), state, self.parameters)

    def _points(self, t: np.ndarray, out: np.ndarray) -> None:
        state = self._state(t - self.start, True)
        point_kernel(self.surface)(state, self.parameters, out, compiled=self.compiled)

    def drive(self, t: np.ndarray) -> np.ndarray:
        tau = t - self.start
        sigma = self.piece.speed(tau)
        drive = self.w[:, :, None] * sigma
        if self.v.any():
            drive = drive - self.v[:, :, None] * (sigma * self.piece.decay(tau, sigma))
        return drive


# --- doubled precision for long paths ----------------------------------------------------------


def _two_sum(a, b):
    s = a + b
    z = s - a
    return s, (a - (s - z)) + (b - z)


def _two_product(a, b):
    p = a * b
    split = 134217729.0  # 2^27 + 1, Dekker
    a1 = split * a
    a1 = a1 - (a1 - a)
    b1 = split * b
    b1 = b1 - (b1 - b)
    a2, b2 = a - a1, b - b1
    return p, ((a1 * b1 - p) + a1 * b2 + a2 * b1) + a2 * b2


def _multiply(a, b):
    p, e = _two_product(a[0], b[0])
    return _two_sum(p, e + (a[0] * b[1] + a[1] * b[0]))


def _add(a, b):
    s, e = _two_sum(a[0], b[0])
    return _two_sum(s, e + (a[1] + b[1]))


def _divide(a, b):
    q = a[0] / b[0]
    p, e = _two_product(q, b[0])
    return _two_sum(q, ((a[0] - p) - e + a[1] - q * b[1]) / b[0])


_TURN = (6.283185307179586, 2.4492935982947064e-16)  # 2 pi in doubled precision


def long_length(sigma: tuple[float, ...], tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """int_0^tau sigma in doubled precision, high and low parts."""
    zero = np.zeros_like(tau)
    total = (zero, zero)
    for k in range(len(sigma) - 1, -1, -1):
        term = _divide((sigma[k] + zero, zero), (k + 1.0 + zero, zero))
        total = _multiply(_add(total, term), (tau, zero))
    return total


def long_phase(
    w: np.ndarray, radius: np.ndarray, sigma: tuple[float, ...], tau: np.ndarray
) -> np.ndarray:
    """|w| s(tau) / radius modulo 2 pi, right to 1e-16 after any number of revolutions.

    Parameters
    ----------
    w : (n, 2)
    radius : (n,)
    sigma : coefficients in local time
    tau : (n_times,)
    """
    x, y = w[:, :1], w[:, 1:]
    square = _add(_two_product(x, x), _two_product(y, y))
    root = np.sqrt(square[0])
    error = _add(square, tuple(-z for z in _two_product(root, root)))
    safe = np.where(root > 0, root, 1.0)  # a contact point at rest has pace 0
    pace = _two_sum(root, np.where(root > 0, error[0] / (2 * safe), 0.0))
    rate = _divide(pace, (radius[:, None], np.zeros_like(radius)[:, None]))
    length = long_length(sigma, tau)
    phase = _multiply(rate, tuple(z[None, :] for z in length))
    return reduce_turns(phase)


def reduce_turns(phase: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """A doubled-precision angle modulo 2 pi, in (-pi, pi]."""
    turns = np.rint(phase[0] / _TURN[0])
    whole = _multiply((-turns, np.zeros_like(turns)), _TURN)
    return _add(phase, whole)[0]


def long_line(
    begin: np.ndarray,
    along: np.ndarray,
    lame: np.ndarray,
    length: tuple[np.ndarray, np.ndarray],
    turns: bool,
) -> np.ndarray:
    """begin + along * length / lame, rounded once; modulo 2 pi where ``turns``.

    begin, along, lame (n,), doubled length (n_times,) -> (n, n_times).
    """
    zero = np.zeros_like(along)[:, None]
    rate = _divide((along[:, None], zero), (lame[:, None], zero))
    line = _multiply(rate, tuple(z[None, :] for z in length))
    line = _add(line, (begin[:, None], zero))
    return reduce_turns(line) if turns else line[0]
