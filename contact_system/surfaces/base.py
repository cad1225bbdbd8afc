r"""The base class of surfaces: chart, inverse chart, level function and metric quantities.

A surface is defined in symbols (``*_expr`` methods, CasADi SX), which are lowered to tables of
instructions; numerical methods run these tables and are vectorised over leading axes. A surface has
a `Chart` and numbers for it. ``inside=True`` puts the body on the other side, where the level
function is positive; the chart becomes ``f(u, -v)``, so that ``f_u x f_v`` still points out of the
body. In symbols the side is a sign, -1 inside, and the first of the surface's numbers.

SI units, radians.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..caching import cached_property
from ..checks import Array, finite_number, of_kind, real_array, shaped_array
from ..engine.binding import SURFACES, SurfaceData, address, builtin_tables, run, wind
from ..errors import ChartSingularity, SurfaceError
from ..theory import symbols as ca
from ..theory.development import IN_SPACE
from ..theory.geometry import QUANTITIES, ROWS, ChartGeometry, tangent_geometry
from ..theory.lowering import lowered
from .charts import Chart, Frame, Pair, Periods

# There is no contact frame where a diagonal entry of the metric root is below this fraction of the
# surface's size. A pole given with 16 digits has 1e-16, a point 1e-9 rad away from it 1e-9.
SINGULAR = 1e-12
LEAST_LENGTH = 1e-150  # m; the square of less underflows


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """A smooth surface that bounds a body. Immutable; compared by structure and numbers.

    Subclasses define `chart`, `size`, `_level`, and `parameters` if these are not the fields. In
    symbolic methods, ``numbers`` is an SX vector: the sign of the side, -1 inside, then ``p``, the
    symbols of `parameters`.

    Parameters
    ----------
    inside : bool
        True: the body is on the other side of the surface. (u, v) is then the point f(u, -v) of
        the chart, so that the frame is right-handed with n out of the body.
    """

    inside: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        remedy = "True or False (in files true or false); True: the body is on the other side"
        of_kind((bool, np.bool_), self.inside, f"{self._kind}: inside", remedy, SurfaceError)
        store(self, inside=bool(self.inside))

    # -- what a surface is

    has_chart: ClassVar[bool] = True
    has_implicit: ClassVar[bool] = True
    panel_limit: ClassVar[float] = math.inf  # in sizes; longer panels miss bumps between nodes
    __match_args__: ClassVar[tuple[str, ...]]  # the positional arguments, set by dataclasses
    examples: ClassVar[tuple[tuple[Any, ...], ...]] = ()
    """Arguments for one surface of each structure, for classes with tables in the engine."""

    @property
    def _kind(self) -> str:
        return type(self).__name__

    @property
    def chart(self) -> type[Chart]:
        """The chart's class."""
        raise NotImplementedError

    @cached_property
    def parameters(self) -> tuple[float, ...]:
        """Numbers of the surface, such as radii in m; the values of the symbols ``p``."""
        return tuple([getattr(self, name) for name in self.__match_args__])

    def parameter_names(self, first: int = 0) -> tuple[str, ...]:
        """Names of `parameters`: those of the arguments, or indices, counted from ``first``."""
        names, count = self.__match_args__, len(self.parameters)
        if len(names) == count:
            return names
        return tuple(f"parameters[{first + k}]" for k in range(count))

    @property
    def structure(self) -> tuple[type, type | str]:
        """Key of the tables: surfaces of one structure differ only in `numbers`."""
        return (type(self), self.chart)

    @property
    def table_name(self) -> str | None:
        """Name of this structure's tables in the engine; None if they are made at first use."""
        names = type(self).__name__, self.chart.__name__
        return "_".join(names) if "examples" in vars(type(self)) else None

    @property
    def sign(self) -> float:
        """-1 where the body is inside, else 1."""
        return -1.0 if self.inside else 1.0

    @cached_property
    def numbers(self) -> Array:
        """Constants of the tables: the sign of the side, then `parameters`."""
        return np.array([self.sign, *self.parameters])

    @cached_property
    def tables(self) -> Any:
        """The tables of instructions of this structure: see `lowering.SurfaceTables`."""
        name = self.table_name
        return lowered(self) if name is None else builtin_tables(SURFACES[name])

    @property
    def traits(self) -> list[float]:
        """The fields of the engine's ``surface_t`` between its name and its tables."""
        chart = self.chart
        closed_form = 1 if chart.great_circles else 2 if chart.developable else 0
        sizes = len(self.numbers), int(chart.double_cover), closed_form, int(not self.has_implicit)
        return [*sizes, *(period or 0.0 for period in self.periods())]

    @property
    def engine_data(self) -> SurfaceData:
        """The engine's ``surface_t``, which points to the tables."""
        return self._own_data if self.table_name is None else SURFACES[self.table_name]

    @cached_property
    def _own_data(self) -> SurfaceData:
        made = SurfaceData(b"", *self.traits)
        for group in ("space", "chart"):
            for k, table in enumerate(getattr(self.tables, group)):
                getattr(made, group)[k] = table and table.address
        return made

    @property
    def size(self) -> float:
        """Reference length for tolerances, m: the greatest radius; 1 m for a plane."""
        raise NotImplementedError

    @property
    def least_radius(self) -> float:
        """Typical least radius of curvature, m; the size if it is not known. The radius may be far
        less at a tip or an inner rim, which few paths meet."""
        return self.size

    @property
    def injectivity(self) -> float:
        """Length, m, up to which each geodesic is the shortest line to its end; 0: unknown."""
        return 0.0

    def periods(self) -> Periods:
        """Return the periods of u and v, rad, None where a coordinate has none."""
        return self.chart.periods

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Surface) and self.identity == other.identity

    def __hash__(self) -> int:
        return hash((self.structure, self.parameters))

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the fields, without cached values."""
        return {w.name: getattr(self, w.name) for w in fields(self)}

    def __repr__(self) -> str:
        arguments = [f"{getattr(self, name)!r}" for name in self.__match_args__]
        named = [w for w in fields(self) if w.kw_only and getattr(self, w.name) != w.default]
        arguments += [f"{w.name}={getattr(self, w.name)!r}" for w in named]
        return f"{self._kind}({', '.join(arguments)})"

    @cached_property
    def identity(self) -> Hashable:
        """The structure, numbers and options by which surfaces are compared."""
        options = [getattr(self, w.name) for w in fields(self) if w.kw_only]
        return (self.structure, self.parameters, self.size, *options)

    # -- symbolic: the chart's need `has_chart`, the level function's `has_implicit`

    def chart_expr(self, numbers: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        """Return the chart f(u, v), (3, 1), m."""
        side, p = numbers[0], numbers[1:]
        return self._axes(p) @ self.chart(p).point(u, side * v)

    def coordinates_expr(self, numbers: ca.SX, x: ca.SX) -> Pair:
        """Return (u, v) of a point of the surface, in the principal ranges of its chart."""
        side, p = numbers[0], numbers[1:]
        u, v = self.chart(p).coordinates(self._axes(p).T @ x)
        return u, side * v

    def frame_expr(self, numbers: ca.SX, x: ca.SX) -> Frame:
        """Return (x axis, y axis, M) of the contact frame as expressions of the point x."""
        side, p = numbers[0], numbers[1:]
        axes = self._axes(p)
        x_axis, y_axis, m = self.chart(p).frame(axes.T @ x)
        # inside, v changes its sign, hence f_v and the normal; y = n x x changes with the normal
        m = ca.vertcat(ca.horzcat(m[0, 0], side * m[0, 1]), m[1, :])
        return axes @ x_axis, side * (axes @ y_axis), m

    def geometry_expr(self, numbers: ca.SX, place: ca.SX) -> ChartGeometry:
        """Return every metric quantity at the symbols ``place``: (u, v), or x without a chart."""
        point = self.chart_expr(numbers, place[0], place[1])
        f_u, f_v = ca.horzsplit(ca.jacobian(point, place))
        f_uu, f_uv = ca.horzsplit(ca.jacobian(f_u, place))
        second = f_uu, f_uv, ca.jacobian(f_v, place[1])
        return tangent_geometry(point, f_u, f_v, second, self.chart.orthogonal)

    def level_geometry(self, p: ca.SX, x: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the level function, its gradient and Hessian, in symbols of `parameters` and x.

        It is zero on the surface. The gradient points out of the body, or into it if ``inside``.
        """
        level = self._level(p, x)
        hessian, gradient = ca.hessian(level, x)
        return level, gradient, hessian

    def _axes(self, p: ca.SX) -> ca.SX:
        """Return the rotation from the chart's axes to the body's, (3, 3)."""
        return ca.SX.eye(3)

    def _level(self, p: ca.SX, x: ca.SX) -> ca.SX:
        raise NotImplementedError

    # -- numeric, vectorised over leading axes

    def point(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return f(u, v), shape (..., 3), m."""
        return self._evaluate(u, v, "point")[0]

    def frame(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the contact frame E, columns x, y, n, shape (..., 3, 3) (eq. ``rotationmat``).

        Partly NaN at poles and umbilics, which `canonical` refuses.
        """
        return self._evaluate(u, v, "frame")[0]

    def point_and_frame(self, u: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
        """Return `point` and `frame`; an implicit surface solves for the points only once."""
        point, frame = self._evaluate(u, v, "point", "frame")
        return point, frame

    def normal(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the unit normal out of the body, shape (..., 3); NaN where `frame` is."""
        return self.frame(u, v)[..., 2]

    def lame(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the Lame coefficients (h_u, h_v), shape (..., 2), m/rad (or m/unit)."""
        return self._evaluate(u, v, "lame")[0]

    def metric_root(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return M, shape (..., 2, 2): from coordinate rates to velocity in the contact frame.

        Units as of `lame`; diagonal if the chart is orthogonal (eq. ``finetune``).
        """
        return self._evaluate(u, v, "metric_root")[0]

    def christoffel(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return Gamma^k_ij, shape (..., 2, 2, 2), indices k, i, j (eq. ``christoffel``)."""
        return self._evaluate(u, v, "christoffel")[0]

    def curvature_form(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return K, shape (..., 2, 2), 1/m; +I/r on a sphere."""
        return self._evaluate(u, v, "curvature_form")[0]

    def torsion_form(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return T, shape (..., 2), 1/m: ``y . x' = T M q'``."""
        return self._evaluate(u, v, "torsion_form")[0]

    def coordinates(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return (u, v), each of shape (...), of points (..., 3) on the surface.

        They are in the chart's principal range, with the opposite sign of v inside.

        Raises
        ------
        SurfaceError
            A wrong shape, or points that are not finite.
        """
        points = self._points(x)
        uv = run(self.tables.inverse, points.reshape(-1, 3).T, self.numbers)
        # atan2(-0.0, negative) is -pi, the half-open range ends at +pi.
        u, v = (
            np.where(w == -math.pi, math.pi, w) if period else w
            for w, period in zip(uv, self.periods())
        )
        return u.reshape(points.shape[:-1]), v.reshape(points.shape[:-1])

    def canonical(self, u: ArrayLike, v: ArrayLike) -> tuple[Any, Any]:
        """Return the same points in the chart's principal range, checked to be regular.

        Coordinates in range are not changed. Floats in, floats out.

        Raises
        ------
        SurfaceError
            A coordinate is NaN or infinite.
        ChartSingularity
            There is no contact frame (pole, umbilic): the metric root is below 1e-12 of the size.
        """
        if isinstance(u, float) and isinstance(v, float) and math.isfinite(u + v):
            # fast way for one point: no arrays, and no table if the point is clearly regular
            us, vs = self._wrap(u, v)
            if not self.chart(self.parameters).floor(us, vs) > 2 * SINGULAR * self.size:
                self._require_regular(np.asarray(us), np.asarray(vs))
            return float(us), float(vs)
        # copies: a chart without periods returns the coordinates given
        us, vs = map(np.array, self._wrap(*self._finite(u, v)))
        self._require_regular(us, vs)
        return (float(us), float(vs)) if us.ndim == 0 else (us, vs)

    def align(self, u: float, v: float, u_ref: float, v_ref: float) -> tuple[float, float, bool]:
        """Return the coordinates of the same point that are nearest to reference coordinates.

        Return also whether both frame axes there are turned by pi from those at (u, v).
        """
        place, reference = np.array([u, v, 1.0, 0.0, 0.0]), np.array([u_ref, v_ref, 0.0])
        wind(ctypes.addressof(self.engine_data), address(reference), address(place))
        u, v, rate, *_ = place.tolist()
        return u, v, rate < 0

    def _wrap(self, u: Any, v: Any) -> tuple[Any, Any]:
        return self.chart.wrap(u, v)

    def _require_regular(self, u: Array, v: Array) -> None:
        if self.chart.singular_at == "":
            return
        m = self.metric_root(u, v)
        least = np.minimum(m[..., 0, 0], m[..., 1, 1])
        singular = ~(least > SINGULAR * self.size)
        if np.any(singular):
            at = (float(u[singular][0]), float(v[singular][0]))
            where = self.chart.singular_at or "a point where f_u or f_v vanishes or they align"
            raise ChartSingularity(
                f"{self!r}: no contact frame at (u, v) = {at}, {where}; the metric root is "
                f"{float(least[singular][0]):.3g} against a size of {self.size:.3g}. Move the "
                "contact away from that point, or turn the body's axes so that it lies elsewhere"
            )

    def _numbers(self, u: ArrayLike, v: ArrayLike) -> Sequence[Array]:
        try:
            return np.broadcast_arrays(real_array(u), real_array(v))
        except (TypeError, ValueError, OverflowError):
            raise SurfaceError(
                f"{self!r}: coordinates (u, v) = {(u, v)!r} must be numbers of one shape"
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
        points = shaped_array(x, f"{self!r}: points", error=SurfaceError, finite=True)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise SurfaceError(
                f"{self!r}: points have shape {points.shape}; the last axis must hold x, y, z"
            )
        return points

    def _evaluate(self, u: ArrayLike, v: ArrayLike, *names: str) -> list[Array]:
        u, v = self._numbers(u, v)
        flat = u.ravel(), v.ravel()
        places = np.stack(flat) if self.has_chart else self.point(*flat).T
        table = run(self.tables.geometry, places, self.numbers)
        results = []
        for name in names:  # the table has a column for each point, first index fastest
            entries = table[ROWS[name]].reshape((*QUANTITIES[name], u.size), order="F")
            results.append(np.moveaxis(entries, -1, 0).reshape(u.shape + QUANTITIES[name]))
        return results


# --- helpers --------------------------------------------------------------------------------------


def run_in_space(surface: Surface, name: str, *rows: ArrayLike) -> Array:
    """Run a table of `development.IN_SPACE` at inputs in columns, given by their rows."""
    return run(surface.tables.space[IN_SPACE.index(name)], np.vstack(rows), surface.numbers)


def store(surface: Surface, **values: Any) -> None:
    """Set attributes of a frozen dataclass while it is being initialised."""
    for name, value in values.items():
        object.__setattr__(surface, name, value)


def positive_length(surface: Surface, name: str, value: Any) -> float:
    """Return a length in m as a float; raise a SurfaceError if it is not above 0."""
    what = f"{type(surface).__name__}: {name}"
    number = finite_number(value, what, error=SurfaceError)
    if number >= LEAST_LENGTH:
        return number
    raise SurfaceError(
        f"{what} = {value!r} m must be above {LEAST_LENGTH:g} m; for a concave surface give the "
        "length positive and inside=True"
    )


class OfLengths(Surface):
    """A surface whose positional arguments are lengths, m, such as radii or semi-axes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        lengths: tuple[str, ...] = self.__match_args__
        for name in lengths:
            store(self, **{name: positive_length(self, name, getattr(self, name))})

    @property
    def size(self) -> float:
        return max(self.parameters)
