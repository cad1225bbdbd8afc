r"""Surfaces of bodies: chart, inverse chart, level function, and all that is metric about them.

A surface is said twice, symbolically for the kernels (``*_expr`` methods, over CasADi SX symbols
for its parameters) and numerically for everybody (vectorised over leading axes). A surface joins a
`Chart` to numbers. ``inside=True`` puts the body on the other side: the chart becomes ``f(u, -v)``
and the level function changes sign, so that ``f_u x f_v`` still points out of the body.

Surfaces that users write themselves are in `contact_system.user_surfaces`. SI units, radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, fields
from numbers import Real
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .charts import (
    SX,
    Array,
    Chart,
    EllipticCylinderChart,
    FlatChart,
    Frame,
    HyperbolicCylinderChart,
    JacobiChart,
    OblateChart,
    OffsetPlaneChart,
    OneSheetChart,
    Pair,
    Periods,
    PolarChart,
    ProlateChart,
    RoundCylinderChart,
    TorusChart,
    TwoSheetChart,
    hypot,
)
from .checks import finite_number, real_array
from .errors import ChartSingularity, SurfaceError
from .expressions import SYMBOLS
from .geometry import ChartGeometry, chart_geometry, revolved_geometry
from .kept import kept

# A contact frame whose axes shrink below this fraction of the surface's size is taken as lost.
# A pole typed with 16 digits gives 1e-16, a point 1e-9 rad from one still gives 1e-9.
SINGULAR = 1e-12
LEAST_LENGTH = 1e-150  # m; squares of less, and what is divided by them, are no numbers any more

# CasADi functions by (surface structure, what they compute).
_FUNCTIONS: dict[tuple[Hashable, str], ca.Function] = {}


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """A smooth surface that bounds a body. Immutable; equal where structure and numbers are equal.

    Subclasses say `parameters`, `chart` and `_level`; `Quadric` also turns its chart in space.
    ``p`` stands for an SX vector of as many symbols as `parameters` has numbers.

    Parameters
    ----------
    inside : bool
        True: the body is on the other side of the surface. (u, v) is then the point f(u, -v) of
        the chart that the class tells: the frame stays right-handed with n out of the body.
    """

    inside: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        if type(self.inside) is bool:
            return
        if not isinstance(self.inside, np.bool_):
            raise SurfaceError(
                f"{self._kind}: inside = {self.inside!r} must be True or False; True puts the "
                "body on the other side, as for a bowl"
            )
        store(self, inside=bool(self.inside))

    # -- what a surface is

    has_chart: ClassVar[bool] = True
    has_implicit: ClassVar[bool] = True
    ambient: ClassVar[bool] = False
    reach: ClassVar[float] = math.inf  # sizes that a panel grows to: it sees nothing between nodes

    @property
    def _kind(self) -> str:
        return type(self).__name__

    @property
    def chart(self) -> type[Chart]:
        """The chart of the surface."""
        raise NotImplementedError

    @property
    def parameters(self) -> tuple[float, ...]:
        """Run-time numbers, such as radii in m; the values behind the symbols ``p``."""
        raise NotImplementedError

    @kept
    def structure(self) -> Hashable:
        """What kernels are specialised by: equal structures differ in `parameters` alone."""
        return (self._kind, self.inside, self.chart.__name__)

    @property
    def size(self) -> float:
        """Length, m, of which tolerances are fractions: the greatest radius; of a plane 1 m."""
        raise NotImplementedError

    @property
    def bend(self) -> float:
        """Least radius of curvature, m, as far as it is known and where many paths come; else the
        size. At a tip or on an inner rim, which few paths meet, it may be far less."""
        return self.size

    @property
    def developable(self) -> bool:
        """T = 0 exactly and constant Lame coefficients: a straight line stays one, unrolled."""
        return self.chart.developable

    @property
    def great_circles(self) -> bool:
        """The surface is a sphere about the origin of its frame."""
        return self.chart.great_circles

    @property
    def double_cover(self) -> bool:
        """(-u, pi - v) is the same point as (u, v), with both frame axes turned by pi."""
        return self.chart.double_cover

    def periods(self) -> Periods:
        """Return the periods of u and v, rad, None where a coordinate has none."""
        return self.chart.periods

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Surface):
            return NotImplemented
        return self.identity == other.identity

    def __hash__(self) -> int:
        return hash((self.structure, self.parameters))  # the rest seldom tells any apart

    def __repr__(self) -> str:
        said = [f"{getattr(self, w.name)!r}" for w in fields(self) if not w.kw_only]
        named = [w for w in fields(self) if w.kw_only and getattr(self, w.name) != w.default]
        said += [f"{w.name}={getattr(self, w.name)!r}" for w in named]
        return f"{self._kind}({', '.join(said)})"

    @kept
    def identity(self) -> Hashable:
        """What tells surfaces apart."""
        return (self.structure, self.parameters, self.size, self.periods())

    # -- symbolic

    def chart_expr(self, p: SX, u: SX, v: SX) -> SX:
        """Return the chart f(u, v), (3, 1), m.

        Raises
        ------
        SurfaceError
            For an `ImplicitSurface`, which has no explicit chart (`has_chart` is False).
        """
        return self._outward_chart(p, u, -v if self.inside else v)

    def implicit_expr(self, p: SX, x: SX) -> SX:
        """Return F(x), zero on the surface, gradient out of the body.

        Raises
        ------
        SurfaceError
            For a `ParametricSurface`, which has no such form (`has_implicit` is False).
        """
        return -self._level(p, x) if self.inside else self._level(p, x)

    def coordinates_expr(self, p: SX, x: SX) -> Pair:
        """Return (u, v) of a point of the surface, in the ranges that its chart documents.

        Raises
        ------
        SurfaceError
            For a `ParametricSurface`, whose inverse chart is numerical only.
        """
        u, v = self._outward_coordinates(p, x)
        return u, (-v if self.inside else v)

    def frame_expr(self, p: SX, x: SX) -> Frame:
        """Return (x axis, y axis, M) of the contact frame as expressions of the point x.

        Raises
        ------
        SurfaceError
            For a `ParametricSurface`, whose inverse chart is numerical only.
        """
        x_axis, y_axis, m = self._outward_frame(p, x)
        if not self.inside:
            return x_axis, y_axis, m
        # v turns, hence f_v and the normal do; y = n x x turns with the normal.
        turned = m if self.chart.orthogonal else ca.vertcat(m[0, :] * SX([[1, -1]]), m[1, :])
        return x_axis, -y_axis, turned

    def geometry_expr(self, p: SX, u: SX, v: SX) -> ChartGeometry:
        """Return every metric quantity at (u, v), symbols; see `ChartGeometry`."""
        shape = chart_geometry(self.chart_expr(p, u, v), u, v, self.chart.orthogonal)
        if self.chart.turning is None:
            return shape
        lame, poles = self.chart.lame(p, u, v), bool(self.chart.singular_at)
        return revolved_geometry(shape, u, v, self.chart.turning, lame, poles)

    def _outward_chart(self, p: SX, u: SX, v: SX) -> SX:
        return self.chart.point(p, u, v)

    def _outward_coordinates(self, p: SX, x: SX) -> Pair:
        return self.chart.coordinates(p, x)

    def _outward_frame(self, p: SX, x: SX) -> Frame:
        return self.chart.frame(p, x)

    def _level(self, p: SX, x: SX) -> SX:
        raise NotImplementedError

    # -- numeric, vectorised over leading axes

    def point(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return f(u, v), shape (..., 3), m."""
        return self._evaluate("point", u, v, (3,))

    def frame(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the contact frame E, columns x, y, n, shape (..., 3, 3) (eq. ``rotationmat``).

        Partly NaN at poles and umbilics, which `canonical` refuses.
        """
        return self._evaluate("frame", u, v, (3, 3))

    def normal(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the unit normal out of the body, shape (..., 3)."""
        return self.frame(u, v)[..., 2]

    def lame(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the Lame coefficients (h_u, h_v), shape (..., 2), m/rad (or m a unit of u, v)."""
        return self._evaluate("lame", u, v, (2,))

    def metric_root(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return M, shape (..., 2, 2): coordinate rates to velocity in the contact frame.

        Units as of `lame`; diagonal where the chart is orthogonal (eq. ``finetune``).
        """
        return self._evaluate("metric_root", u, v, (2, 2))

    def christoffel(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return Gamma^k_ij, shape (..., 2, 2, 2), indices k, i, j (eq. ``christoffel``)."""
        return self._evaluate("christoffel", u, v, (2, 2, 2))

    def curvature_form(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return K, shape (..., 2, 2), 1/m; +I/r on a sphere."""
        return self._evaluate("curvature_form", u, v, (2, 2))

    def torsion_form(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return T, shape (..., 2), 1/m: ``y . x' = T M q'``."""
        return self._evaluate("torsion_form", u, v, (2,))

    def coordinates(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return (u, v), each of shape (...), of points (..., 3) on the surface.

        The principal branch; its range is `chart`.ranges, with the sign of v turned inside.

        Raises
        ------
        SurfaceError
            Points of another shape, or not finite.
        """
        points = self._points(x)
        uv = self._call("coordinates", points.reshape(-1, 3).T)
        lead = points.shape[:-1]
        # atan2(-0.0, negative) is -pi, the half-open range ends at +pi.
        u, v = (
            np.where(w == -math.pi, math.pi, w) if period else w
            for w, period in zip(uv, self.periods(), strict=True)
        )
        return u.reshape(lead), v.reshape(lead)

    def canonical(self, u: ArrayLike, v: ArrayLike) -> tuple[Any, Any]:
        """Return the same points in the chart's principal range, checked to be regular.

        Points in range stay as they are, bit for bit. Components given along the frame axes refer
        to the frame at the returned coordinates. Floats in, floats out.

        Raises
        ------
        SurfaceError
            A coordinate is NaN or infinite.
        ChartSingularity
            The frame is lost there (pole, umbilic): the metric root is below 1e-12 of the size.
        """
        if one := isinstance(u, float) and isinstance(v, float) and math.isfinite(u + v):
            us, vs = self._wrap(float(u), float(v))
        else:
            us, vs = self._wrap(*self._finite(u, v))
        # told regular without kernels, and one point without arrays, wherever that is clear
        clear = self.chart.metric_floor(self.parameters, us, vs) > 2 * SINGULAR * self.size
        if not (clear if one else np.all(clear)):
            self._require_regular(np.asarray(us), np.asarray(vs))
        return (float(us), float(vs)) if one or np.ndim(us) == 0 else (us, vs)

    def align(
        self, u: ArrayLike, v: ArrayLike, u_ref: ArrayLike, v_ref: ArrayLike
    ) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the coordinates of the same points that continue reference coordinates.

        Nearest to them; of a `double_cover` on the same one, if sin(u) cos(v) has the same sign.

        Returns
        -------
        u, v : arrays of the broadcast shape
        half_turn : bool array
            Where both frame axes are turned by pi against the coordinates given.
        """
        u, v, u_ref, v_ref = self._numbers(u, v, u_ref, v_ref)
        period_u, period_v = self.periods()
        near_u, near_v = _nearest(u, u_ref, period_u), _nearest(v, v_ref, period_v)
        if not self.double_cover:
            return near_u, near_v, np.zeros(u.shape, dtype=bool)
        other_u = _nearest(-u, u_ref, period_u)
        other_v = _nearest(math.pi - v, v_ref, period_v)
        nearer = np.hypot(other_u - u_ref, other_v - v_ref) < np.hypot(
            near_u - u_ref, near_v - v_ref
        )
        (second, side), (second_ref, side_ref) = second_cover(u, v), second_cover(u_ref, v_ref)
        told = (side == side_ref) & ~on_seam(u, v) & ~on_seam(u_ref, v_ref)
        half_turn = np.where(told, second != second_ref, nearer)
        return (
            np.where(half_turn, other_u, near_u),
            np.where(half_turn, other_v, near_v),
            half_turn,
        )

    def unwind(self, u: ArrayLike, v: ArrayLike) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return coordinates made continuous along axis 0, starting from the first as given.

        The same as `align` of each sample to the one before, for a whole path at once. Samples
        must lie close enough that the nearest representative is the right one.

        Returns
        -------
        u, v : arrays of the given shape
        half_turn : bool array
            Where both frame axes are turned by pi against the coordinates given.
        """
        u, v = self._numbers(u, v)
        half_turn = np.zeros(u.shape, dtype=bool)
        if self.double_cover and u.ndim and len(u) > 1:
            # Turning both neighbours leaves their distance: turns against the neighbour add up.
            step = self.align(u[1:], v[1:], u[:-1], v[:-1])[2]
            half_turn[1:] = np.logical_xor.accumulate(step, axis=0)
            u, v = np.where(half_turn, -u, u), np.where(half_turn, math.pi - v, v)
        period_u, period_v = self.periods()
        return _unwrap(u, period_u), _unwrap(v, period_v), half_turn

    def _wrap(self, u: Any, v: Any) -> tuple[Any, Any]:
        return self.chart.wrap(u, v)

    def _require_regular(self, u: Array, v: Array) -> None:
        m = self.metric_root(u, v)
        least = np.minimum(m[..., 0, 0], m[..., 1, 1])
        lost = ~(least > SINGULAR * self.size)
        if np.any(lost):
            at = (float(u[lost][0]), float(v[lost][0]))
            where = self.chart.singular_at or "a point where f_u or f_v vanishes or they align"
            raise ChartSingularity(
                f"{self!r}: no contact frame at (u, v) = {at}, {where}; the metric root is "
                f"{float(least[lost][0]):.3g} against a size of {self.size:.3g}. Move the contact "
                "away from that point, or turn the body's axes so that it lies elsewhere"
            )

    def _numbers(self, *given: ArrayLike) -> Sequence[Array]:
        try:
            return np.broadcast_arrays(*map(real_array, given))
        except (TypeError, ValueError, OverflowError):
            names = "(u, v, u_ref, v_ref)" if len(given) > 2 else "(u, v)"
            raise SurfaceError(
                f"{self!r}: coordinates {names} = {given!r} must be numbers of one shape"
            ) from None

    def _finite(self, u: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
        u, v = self._numbers(u, v)
        bad = ~(np.isfinite(u) & np.isfinite(v))
        if np.any(bad):
            raise SurfaceError(
                f"{self!r}: coordinates (u, v) = ({u[bad][0]}, {v[bad][0]}) must be finite numbers"
            )
        return u, v

    def _points(self, x: ArrayLike) -> Array:
        try:
            points = real_array(x)
        except (TypeError, ValueError, OverflowError):
            raise SurfaceError(f"{self!r}: points = {x!r:.80} must be numbers") from None
        if points.ndim == 0 or points.shape[-1] != 3:
            raise SurfaceError(
                f"{self!r}: points have shape {points.shape}; the last axis must hold x, y, z"
            )
        if not np.all(np.isfinite(points)):
            raise SurfaceError(f"{self!r}: points must be finite numbers, got NaN or inf")
        return points

    def _evaluate(self, name: str, u: ArrayLike, v: ArrayLike, shape: tuple[int, ...]) -> Array:
        u, v = self._numbers(u, v)
        columns = self._call(name, *self._arguments(u.ravel(), v.ravel()))
        # Functions return each point's entries in one column, first index fastest.
        entries = columns.T.reshape((u.size, *shape[::-1]))
        order = (0, *range(len(shape), 0, -1))
        return np.ascontiguousarray(entries.transpose(order)).reshape(u.shape + shape)

    def _arguments(self, u: Array, v: Array) -> tuple[Array, ...]:
        """Return what the CasADi functions take besides p, one column a point."""
        return u[None, :], v[None, :]

    def _call(self, name: str, *columns: Array) -> Array:
        key = (self.structure, name)
        if key not in _FUNCTIONS:
            with SYMBOLS:
                if key not in _FUNCTIONS:  # another thread may have been first
                    _FUNCTIONS[key] = self._build(name)
        if columns[0].shape[1] == 0:
            return np.zeros((_FUNCTIONS[key].size1_out(0), 0))
        return _FUNCTIONS[key](ca.DM(self.parameters), *columns).full()

    def _build(self, name: str) -> ca.Function:
        p = SX.sym("p", len(self.parameters))
        if name == "coordinates":
            x = SX.sym("x", 3)
            return ca.Function(name, [p, x], [ca.vertcat(*self.coordinates_expr(p, x))])
        arguments, geometry = self._geometry(p)
        if name == "christoffel":
            # (k, i, j) with k fastest, as the column-major convention of _evaluate wants.
            first, second = geometry.christoffel
            value = ca.horzcat(ca.vec(first), ca.vec(second)).T
        else:
            value = getattr(geometry, name)
        return ca.Function(name, [p, *arguments], [ca.vec(value)])

    def _geometry(self, p: SX) -> tuple[tuple[SX, ...], ChartGeometry]:
        u, v = SX.sym("u"), SX.sym("v")
        return (u, v), self.geometry_expr(p, u, v)


@dataclass(frozen=True, eq=False, repr=False)
class Plane(Surface):
    """The plane z = 0, body below; chart (u, v, 0), coordinates in m."""

    @property
    def chart(self) -> type[Chart]:
        return FlatChart

    @property
    def parameters(self) -> tuple[float, ...]:
        return ()

    @property
    def size(self) -> float:
        return 1.0

    def _level(self, p: SX, x: SX) -> SX:
        return x[2]


@dataclass(frozen=True, eq=False, repr=False)
class _OfRadius(Surface):
    """What sphere and cylinder share: one radius, m."""

    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        store(self, radius=positive_length(self, "radius", self.radius))

    @property
    def parameters(self) -> tuple[float, ...]:
        return (self.radius,)

    @property
    def size(self) -> float:
        return self.radius


@dataclass(frozen=True, eq=False, repr=False)
class Sphere(_OfRadius):
    """Sphere about the origin; chart r (sin u cos v, sin u sin v, cos u), poles at u = 0, pi.

    Parameters
    ----------
    radius : float
        m.
    inside : bool
        True: a spherical bowl; (u, v) is then the chart's f(u, -v).
    """

    ambient: ClassVar[bool] = True

    @property
    def chart(self) -> type[Chart]:
        return PolarChart

    def _level(self, p: SX, x: SX) -> SX:
        return (ca.dot(x, x) / p[0] ** 2 - 1) / 2


@dataclass(frozen=True, eq=False, repr=False)
class Cylinder(_OfRadius):
    """Circular cylinder about the z axis; chart (r cos u, r sin u, v), v in m.

    Parameters
    ----------
    radius : float
        m.
    inside : bool
        True: a bore; (u, v) is then the chart's f(u, -v).
    """

    @property
    def chart(self) -> type[Chart]:
        return RoundCylinderChart

    def _level(self, p: SX, x: SX) -> SX:
        return ((x[0] ** 2 + x[1] ** 2) / p[0] ** 2 - 1) / 2


@dataclass(frozen=True, eq=False, repr=False)
class Torus(Surface):
    """Torus about the z axis; chart ((R + r cos v) cos u, (R + r cos v) sin u, r sin v).

    Parameters
    ----------
    major, minor : float
        R and r, m, 0 < r < R.
    inside : bool
        True: the inside of a tube; (u, v) is then the chart's f(u, -v).
    """

    major: float
    minor: float

    def __post_init__(self) -> None:
        super().__post_init__()
        store(
            self,
            major=positive_length(self, "major", self.major),
            minor=positive_length(self, "minor", self.minor),
        )
        if not self.minor < self.major:
            raise SurfaceError(
                f"Torus: minor = {self.minor} must be less than major = {self.major}, or the tube "
                "meets itself; give Torus(major, minor) in that order"
            )

    @property
    def chart(self) -> type[Chart]:
        return TorusChart

    @property
    def parameters(self) -> tuple[float, ...]:
        return (self.major, self.minor)

    @property
    def size(self) -> float:
        return self.major + self.minor

    @property
    def bend(self) -> float:
        return self.minor

    def _level(self, p: SX, x: SX) -> SX:
        return ((hypot(x[0], x[1]) - p[0]) ** 2 + x[2] ** 2 - p[1] ** 2) / 2


@dataclass(frozen=True, eq=False, repr=False)
class Ellipsoid(Surface):
    """Ellipsoid with semi-axes a >= b >= c along x, y, z; Jacobi's chart, eq. ``ellipsoid``.

    Equal axes take the regular limit of that chart: `OblateChart` (a = b), `ProlateChart` (b = c),
    and for a = b = c the sphere's `PolarChart`; ``help(surface.chart)`` shows its formula.

    Parameters
    ----------
    a, b, c : float
        Semi-axes, m.
    inside : bool
        True: an ellipsoidal bowl; (u, v) is then the chart's f(u, -v).
    """

    ambient: ClassVar[bool] = True
    a: float
    b: float
    c: float

    def __post_init__(self) -> None:
        super().__post_init__()
        axes = tuple(positive_length(self, name, getattr(self, name)) for name in "abc")
        if not axes[0] >= axes[1] >= axes[2]:
            given, sorted_ = (", ".join(map(repr, w)) for w in (axes, sorted(axes, reverse=True)))
            raise SurfaceError(
                f"Ellipsoid: semi-axes ({given}) must satisfy a >= b >= c; write "
                f"Ellipsoid({sorted_}), or Quadric for axes along other directions"
            )
        store(self, a=axes[0], b=axes[1], c=axes[2])

    @property
    def chart(self) -> type[Chart]:
        return _ellipsoid_chart(self.a, self.b, self.c)[0]

    @property
    def parameters(self) -> tuple[float, ...]:
        return _ellipsoid_chart(self.a, self.b, self.c)[1]

    @property
    def size(self) -> float:
        return self.a

    @property
    def bend(self) -> float:
        return max(self.c**2 / self.a, self.c / 3)

    def _level(self, p: SX, x: SX) -> SX:
        axes = {
            JacobiChart: (0, 1, 2),
            OblateChart: (0, 0, 1),
            ProlateChart: (0, 1, 1),
            PolarChart: (0, 0, 0),
        }[self.chart]
        return (ca.sumsqr(x / ca.vertcat(*(p[k] for k in axes))) - 1) / 2


@dataclass(frozen=True, eq=False, repr=False)
class Quadric(Surface):
    """x^T A x = 1 for a symmetric A of any signature that gives a smooth surface.

    Coordinates are laid along the principal axes: an ellipsoid in any orientation (charts of
    `Ellipsoid`), hyperboloids of one and two sheets, elliptic and hyperbolic cylinders, a pair of
    planes; ``help(surface.chart)`` shows the chart. The normal is along A x, so the body is where
    x^T A x < 1; ``inside`` turns it.

    Parameters
    ----------
    A : array-like (3, 3)
        Symmetric, 1/m^2; at least one positive eigenvalue.
    sheet : {1, -1}
        Which of two sheets: the one on the positive or the negative side of the first principal
        axis. Only for the two-sheeted hyperboloid, the hyperbolic cylinder and the planes.
    inside : bool
        Body on the side x^T A x > 1; (u, v) is then the chart's f(u, -v).
    """

    ambient: ClassVar[bool] = True
    A: tuple[tuple[float, float, float], ...]
    sheet: int = field(default=1, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        matrix = _symmetric(self.A)
        store(self, A=tuple(tuple(float(w) for w in row) for row in matrix))
        given = self.sheet
        if not isinstance(given, Real) or isinstance(given, bool) or given not in (1, -1):
            raise SurfaceError(f"Quadric: sheet = {given!r} must be 1 or -1")
        store(self, sheet=int(given))
        chart = self.chart
        if self.sheet == -1 and chart not in (
            TwoSheetChart,
            HyperbolicCylinderChart,
            OffsetPlaneChart,
        ):
            raise SurfaceError(
                "Quadric: sheet = -1, but this surface is in one piece "
                f"({chart.__name__}); leave sheet out"
            )

    @kept
    def _principal(self) -> tuple[type[Chart], tuple[float, ...], Array]:
        """Chart, its numbers, and the rotation from chart axes to the body's, (3, 3)."""
        chart, numbers, rotation = _principal_chart(np.array(self.A))
        if self.sheet == -1:
            # Half a turn about the third axis carries one sheet, chart and normal, to the other.
            rotation = rotation * np.array([-1.0, -1.0, 1.0])
        return chart, numbers, rotation

    @property
    def chart(self) -> type[Chart]:
        return self._principal[0]

    @kept
    def parameters(self) -> tuple[float, ...]:
        """Three chart numbers (padded), nine of the rotation row by row, six of A."""
        _, numbers, rotation = self._principal
        padded = (*numbers, 1.0, 1.0)[:3]
        matrix = np.array(self.A)
        upper = matrix[np.triu_indices(3)]
        return (*padded, *map(float, rotation.ravel()), *map(float, upper))

    @property
    def size(self) -> float:
        return max(self._principal[1])

    @property
    def bend(self) -> float:
        return min(self._principal[1])

    def _rotation(self, p: SX) -> SX:
        return ca.reshape(p[3:12], 3, 3).T

    def _outward_chart(self, p: SX, u: SX, v: SX) -> SX:
        return self._rotation(p) @ self.chart.point(p, u, v)

    def _outward_coordinates(self, p: SX, x: SX) -> Pair:
        return self.chart.coordinates(p, self._rotation(p).T @ x)

    def _outward_frame(self, p: SX, x: SX) -> Frame:
        rotation = self._rotation(p)
        x_axis, y_axis, m = self.chart.frame(p, rotation.T @ x)
        return rotation @ x_axis, rotation @ y_axis, m

    def _level(self, p: SX, x: SX) -> SX:
        a = p[12:18]
        pure = a[0] * x[0] ** 2 + a[3] * x[1] ** 2 + a[5] * x[2] ** 2
        mixed = a[1] * x[0] * x[1] + a[2] * x[0] * x[2] + a[4] * x[1] * x[2]
        return (pure + 2 * mixed - 1) / 2


# --------------------------------------------------------------------------- helpers


def second_cover(u: Array, v: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Of a double cover: where cos(v) < 0, and where sin(u) cos(v) < 0.

    Both change where a path crosses sin(u) = 0 or cos(v) = 0, and nowhere else.
    """
    second = np.cos(v) < 0
    return second, (np.sin(u) < 0) != second


def on_seam(u: Array, v: Array) -> NDArray[np.bool_]:
    """Where sin(u) = 0 or cos(v) = 0 but for rounding: `second_cover` tells nothing there."""
    turns = np.array([u, v - 0.5 * math.pi]) / math.pi
    return np.asarray((np.abs(turns - np.rint(turns)) < 1e-12).any(axis=0))


def _nearest(angle: Array, reference: Array, period: float | None) -> Array:
    if period is None:
        return angle
    return angle + period * np.round((reference - angle) / period)


def _unwrap(angle: Array, period: float | None) -> Array:
    if period is None or not angle.ndim or len(angle) < 2:
        return angle
    turns = np.cumsum(np.round(np.diff(angle, axis=0) / period), axis=0)
    return np.concatenate([angle[:1], angle[1:] - period * turns])


def store(surface: Surface, **values: Any) -> None:
    """Store checked values in a frozen dataclass that is still being made."""
    for name, value in values.items():
        object.__setattr__(surface, name, value)


def positive_length(surface: Surface, name: str, value: Any) -> float:
    """Return a length in m as a float; raise a SurfaceError where it is not above 0."""
    kind = type(surface).__name__
    number = finite_number(value, f"{kind}: {name}", error=SurfaceError)
    if number <= 0:
        raise SurfaceError(
            f"{kind}: {name} = {value!r} must be a positive length in metres; for a concave "
            "surface give the length positive and inside=True"
        )
    if number < LEAST_LENGTH:
        raise SurfaceError(
            f"{kind}: {name} = {value!r} m is below {LEAST_LENGTH:g} m, and its square is no "
            "number any more; use a smaller unit of length"
        )
    return number


def _ellipsoid_chart(a: float, b: float, c: float) -> tuple[type[Chart], tuple[float, ...]]:
    """Return the chart that is regular for a >= b >= c, and the numbers it takes."""
    if a == b == c:
        return PolarChart, (a,)
    if a == b:
        return OblateChart, (a, c)
    if b == c:
        return ProlateChart, (a, b)
    return JacobiChart, (a, b, c)


def _symmetric(given: Any) -> Array:
    try:
        matrix = real_array(given)
    except (TypeError, ValueError, OverflowError):
        raise SurfaceError(f"Quadric: A = {given!r} must be a 3 by 3 matrix of numbers") from None
    if matrix.shape != (3, 3):
        raise SurfaceError(f"Quadric: A has shape {matrix.shape}; it must be 3 by 3")
    if not np.all(np.isfinite(matrix)):
        raise SurfaceError(f"Quadric: A = {matrix.tolist()} must be finite")
    if np.max(np.abs(matrix - matrix.T)) > 1e-15 * np.max(np.abs(matrix)):
        raise SurfaceError(
            f"Quadric: A = {matrix.tolist()} must be symmetric; use (A + A.T)/2, which gives the "
            "same surface"
        )
    return (matrix + matrix.T) / 2


def _principal_chart(matrix: Array) -> tuple[type[Chart], tuple[float, ...], Array]:
    """Return chart, its numbers and a proper rotation, columns the chart's axes in the body."""
    values, vectors = _eigen(matrix)
    scale = np.max(np.abs(values))
    # eigh is good to a few units in the last place of the greatest eigenvalue.
    values = np.where(np.abs(values) <= 8 * np.finfo(float).eps * scale, 0.0, values)
    signs = "".join("-0+"[int(np.sign(w)) + 1] for w in values)
    if "+" not in signs:
        raise SurfaceError(
            f"Quadric: A has eigenvalues {values.tolist()}, none positive, so x^T A x = 1 has no "
            "points; at least one must be positive"
        )
    axes = 1 / np.sqrt(np.where(values == 0, 1.0, np.abs(values)))
    # Order: positive (longest first), then negative (longest first), then zero.
    rank = {"+": 0, "-": 1, "0": 2}
    order = sorted(range(3), key=lambda i: (rank[signs[i]], -axes[i]))
    case = "".join(signs[i] for i in order)
    axes, rotation = axes[order], vectors[:, order]
    if np.linalg.det(rotation) < 0:
        rotation = rotation * np.array([1.0, 1.0, -1.0])
    chart, numbers = _CASES[case](*map(float, _merge_equal(axes, case)))
    if chart.great_circles:  # what eigh finds of a rounded sphere says nothing
        rotation = np.eye(3)
    return chart, numbers, rotation


def _eigen(matrix: Array) -> tuple[Array, Array]:
    """Return eigenvalues and eigenvectors; exact for a diagonal matrix."""
    if np.count_nonzero(matrix - np.diag(np.diag(matrix))) == 0:
        return np.diag(matrix).copy(), np.eye(3)
    return np.linalg.eigh(matrix)


def _merge_equal(axes: Array, case: str) -> Array:
    """Make axes of one sign equal where they differ by rounding alone."""
    merged = axes.copy()
    for i in (1, 2):
        if case[i] == case[i - 1] and merged[i - 1] - merged[i] <= 4e-15 * merged[i - 1]:
            merged[i] = merged[i - 1]
    return merged


_CASES: dict[str, Callable[[float, float, float], tuple[type[Chart], tuple[float, ...]]]] = {
    "+++": _ellipsoid_chart,
    "++-": lambda a, b, c: (OneSheetChart, (a, b, c)),
    "+--": lambda a, b, c: (TwoSheetChart, (a, b, c)),
    "++0": lambda a, b, c: (
        (RoundCylinderChart, (a,)) if a == b else (EllipticCylinderChart, (a, b))
    ),
    "+-0": lambda a, b, c: (HyperbolicCylinderChart, (a, b)),
    "+00": lambda a, b, c: (OffsetPlaneChart, (a,)),
}
