"""The shortest geodesic between two points of a surface, and others (theory section 11).

Newton's method aims a geodesic at a point; the Jacobi field is its derivative. It starts from the
chord. If the geodesic found is longer than `Surface.injectivity`, there may be a shorter one: a fan
of rays then covers all points that are no farther, and every candidate in it is aimed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..caching import cached_property
from ..checks import finite_number, of_kind, shaped_array, whole_number
from ..errors import SurfaceError
from ..surfaces import SINGULAR, Surface, run_in_space
from .shooting import MET, SHARP, Array, Follower, Search

ON_SURFACE = 1e-9  # of the size: greatest distance from the surface of points on it


@dataclass(frozen=True, eq=False)
class Geodesic:
    """The geodesic from a to b, or many of them, for arrays of pairs of the shape (...).

    Attributes
    ----------
    surface : Surface
    length : float or (...)
        m.
    direction : float or (...)
        Angle at a, from the x axis of the contact frame towards its y axis, rad; NaN where there
        is no contact frame.
    tangent : (..., 3)
        Unit tangent at a, in space.
    """

    surface: Surface
    length: Any
    direction: Any
    tangent: Array
    _start: Array = field(repr=False)

    @property
    def m12(self) -> Any:
        """Reduced length, m: a turn by dphi at a moves the end sideways by m12 dphi."""
        return self._fields[0]

    @property
    def M12(self) -> Any:
        """Geodesic scale: a sideways shift of a by dy moves the end by M12 dy."""
        return self._fields[2]

    @property
    def M21(self) -> Any:
        """Geodesic scale of the way back, from b to a."""
        return self._fields[1]

    @cached_property
    def _fields(self) -> list[Any]:
        rows = self._ends(self._start, np.ravel(self.length))[9:]
        return [_shaped(row, np.shape(self.length)) for row in rows]

    def points(self, s: ArrayLike) -> Array:
        """Points at lengths s from a, m, shape (*s.shape, ..., 3), m."""
        what, remedy = f"{self.surface!r}: s", "lengths in m"
        distances = shaped_array(s, what, error=SurfaceError, remedy=remedy, finite=True)
        lengths = np.repeat(distances.ravel(), self._start.shape[1])
        ends = self._ends(np.tile(self._start, (1, distances.size)), lengths)[:3]
        return ends.T.reshape(*distances.shape, *np.shape(self.length), 3)

    def _ends(self, start: Array, lengths: Array) -> Array:
        ends = Follower(self.surface)(start, lengths, SHARP)
        if not np.isfinite(ends).all():
            raise SurfaceError(
                f"{self.surface!r}: the geodesic is too long, or comes to an edge or a pole of the "
                "chart; ask for less than thousands of sizes, move an end a little, or write the "
                "surface as an ImplicitSurface"
            )
        return ends


def geodesic(surface: Surface, a: ArrayLike, b: ArrayLike) -> Geodesic:
    """Find the shortest geodesic from a to b.

    Parameters
    ----------
    surface : Surface
    a, b : (..., 2) or (..., 3)
        Chart coordinates (u, v), or points in space, m. Many pairs at once take less time each.

    Returns
    -------
    Geodesic
        If several are equally short, any one of them; between equal points one of length 0.

    Raises
    ------
    SurfaceError
        Points not on the surface or 1e4 sizes apart, no geodesic between them, the shortest too
        close to a pole of a user's chart, or a search that exceeds ``limits.STRIPS``, as on a body
        as thin as a leaf.
    """
    pairs = Pairs(surface, a, b)
    if surface.chart.developable:
        phi, s = (w[:, 0] for w in pairs.unrolled())
    else:
        phi, s = Search(pairs).shortest()
    return pairs.geodesic(phi, s)


def geodesics(
    surface: Surface, a: ArrayLike, b: ArrayLike, most: int, *, longest: float | None = None
) -> list[Geodesic]:
    """Find the shortest geodesics from a to b, including those that wind around the body.

    Parameters
    ----------
    surface : Surface
    a, b : (2,) or (3,)
        As for `geodesic`, of one pair.
    most : int
        Greatest number of geodesics. A continuous family, as between the poles of a sphere, counts
        as one.
    longest : float, optional
        Greatest length, m; default: the shortest plus twice round a sphere of the size.

    Returns
    -------
    list of Geodesic
        The shortest first. Lines that come to a pole of a user's chart may be missing.

    Raises
    ------
    SurfaceError
        As for `geodesic`, and equal points.
    """
    pairs = Pairs(surface, a, b)
    if pairs.shape:
        raise SurfaceError(f"{surface!r}: give one pair of points; `geodesic` takes many")
    if pairs.chord[0] <= MET * surface.size:
        raise SurfaceError(
            f"{surface!r}: a and b are the same point, {pairs.b[0].tolist()}; give two"
        )
    most = whole_number(most, "most", SurfaceError)
    if longest is not None:
        longest = finite_number(longest, "longest", "above 0", SurfaceError)
    if surface.chart.developable:
        phi, s = (w[0] for w in pairs.unrolled(most))
    else:
        phi, s = Search(pairs).several(most, longest)
    keep = s <= (math.inf if longest is None else longest)
    shortest = list(zip(phi[keep][:most], s[keep][:most]))
    return [pairs.geodesic(np.array([phi]), np.array([s])) for phi, s in shortest]


# --- pairs of points ------------------------------------------------------------------------------


class Pairs:
    """Pairs of points a, b, and the states of geodesics that start at a."""

    def __init__(self, surface: Surface, a: ArrayLike, b: ArrayLike):
        of_kind(Surface, surface, "surface", "a Surface", SurfaceError)
        self.surface, self.follow = surface, Follower(surface)
        places = [self._placed(name, w) for name, w in (("a", a), ("b", b))]
        try:
            first, last = np.broadcast_arrays(*places)
        except ValueError:
            shapes = " and ".join(str(x.shape[:-1]) for x in places)
            raise SurfaceError(
                f"{surface!r}: a and b are points of shapes {shapes}; give equally many, or one"
            ) from None
        self.shape = first.shape[:-1]
        self.uv, self.x = np.split(first.reshape(-1, 5), [2], axis=1)
        self.uv_b, self.b = np.split(last.reshape(-1, 5), [2], axis=1)
        self.chord = np.linalg.norm(self.b - self.x, axis=1)
        frame, self.singular = self._frames(self.uv)
        if not self.follow.space and (self.singular | self._frames(self.uv_b)[1]).any():
            raise SurfaceError(
                f"{surface!r}: there is no contact frame at a or b, such as at a pole; move the "
                "point a little, or write the surface as an ImplicitSurface"
            )
        if self.singular.any():
            frame[self.singular] = self._some_frame(self.x[self.singular])
        self.p, self.q = frame[..., 0], frame[..., 1]

    def start(self, which: Array, phi: Array) -> Array:
        """States at a of geodesics of the pairs ``which`` in directions phi."""
        if not self.follow.space:
            return np.vstack([self.uv[which].T, phi])
        first = np.cos(phi) * self.p[which].T + np.sin(phi) * self.q[which].T
        return np.vstack([self.x[which].T, first])

    def geodesic(self, phi: Array, s: Array) -> Geodesic:
        """The result for directions and lengths at a."""
        tangent = np.cos(phi)[:, None] * self.p + np.sin(phi)[:, None] * self.q
        direction = np.where(
            self.singular, math.nan, np.remainder(phi + math.pi, 2 * math.pi) - math.pi
        )
        start = self.start(np.arange(len(phi)), phi)
        numbers = _shaped(s, self.shape), _shaped(direction, self.shape)
        return Geodesic(self.surface, *numbers, tangent.reshape(*self.shape, 3), start)

    def unrolled(self, most: int = 1) -> tuple[Array, Array]:
        """Directions and lengths of straight lines on the unrolled surface, (pairs, lines)."""
        period, lame = self.surface.periods()[0], self.surface.lame(*self.uv.T)
        apart = (self.uv_b - self.uv)[:, None, :]
        if period is not None:
            turns = np.arange(-most, most + 1) - np.rint(apart[..., 0] / period)
            apart = np.stack([apart[..., 0] + period * turns, apart[..., 1] + 0 * turns], axis=-1)
        apart = lame[:, None, :] * apart
        phi, s = np.arctan2(apart[..., 1], apart[..., 0]), np.hypot(apart[..., 0], apart[..., 1])
        order = np.argsort(s, axis=1, kind="stable")
        return np.take_along_axis(phi, order, axis=1), np.take_along_axis(s, order, axis=1)

    # -- points

    def _placed(self, name: str, given: ArrayLike) -> Array:
        """u, v, x, y, z of points, (..., 5)."""
        surface = self.surface
        points = shaped_array(given, f"{surface!r}: {name}", error=SurfaceError)
        if points.ndim == 0 or points.shape[-1] not in (2, 3) or not np.isfinite(points).all():
            raise SurfaceError(
                f"{surface!r}: {name} = {given!r:.80}: give finite (u, v), or points x, y, z in m"
            )
        in_space = points.shape[-1] == 3
        # in the regular range, where contacts have their frames
        uv = surface.coordinates(points) if in_space else surface._wrap(*np.moveaxis(points, -1, 0))
        if self.follow.space and in_space:  # to the last digit, at poles too
            there = self._restored(points.reshape(-1, 3), np.ones(3))[0].reshape(points.shape)
        else:
            there = surface.point(*uv)
        off = np.linalg.norm(there - (points if in_space else there), axis=-1)  # NaN: no point
        missing = ~(off <= ON_SURFACE * surface.size)
        if missing.any():
            wrong = points[missing][0].tolist()
            raise SurfaceError(
                f"{surface!r}: {name} = {wrong} is not on the surface; give other "
                "coordinates (u, v), or a point projected onto it"
            )
        return np.concatenate([np.stack(uv, axis=-1), there], axis=-1)

    def _frames(self, uv: Array) -> tuple[Array, Array]:
        """Contact frames (n, 3, 3), and whether each is missing, as at a pole (n,)."""
        frame, m = self.surface._evaluate(*uv.T, "frame", "metric_root")
        least = np.minimum(m[:, 0, 0], m[:, 1, 1])
        return frame, ~(least > SINGULAR * self.surface.size)

    def _restored(self, x: Array, p: Array) -> tuple[Array, Array]:
        """Points (n, 3) put back on the surface, and vectors made unit tangents there."""
        restored = run_in_space(self.surface, "restore", x.T, np.broadcast_to(p, x.shape).T).T
        return restored[:, :3], restored[:, 3:]

    def _some_frame(self, x: Array) -> Array:
        """Frames (n, 3, 3) with arbitrary p and q, at points without a contact frame."""
        tries = np.stack([self._restored(x, axis)[1] for axis in np.eye(3)], axis=1)
        best = np.nanargmax(np.einsum("nii->ni", tries), axis=1)  # farthest from the normal
        p = tries[np.arange(len(x)), best]
        q = run_in_space(self.surface, "second", x.T, p.T).T
        return np.stack([p, q, np.cross(p, q)], axis=-1)


# --- helpers --------------------------------------------------------------------------------------


def _shaped(numbers: Array, shape: tuple[int, ...]) -> Any:
    return numbers.reshape(shape) if shape else float(numbers[0])
