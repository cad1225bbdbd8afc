"""Surfaces given by a chart f(u, v) or a level function F(x), in Python or as text.

Their tables are made from the formula at first use. SI units, radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array, finite_number, finite_numbers
from ..engine.binding import address, rays, run
from ..errors import ContactSystemError, SurfaceError
from ..theory import symbols as ca
from ..theory.geometry import ChartGeometry, contact_frame, tangent_geometry
from ..theory.symbols import making_symbols
from .base import Surface, positive_length, store
from .charts import TURN, Chart, Frame, Pair, Periods, hypot
from .formula import Formula, make_formula
from .sphere import PolarChart

CELLS = 32  # in each coordinate of the grid from whose points the search for a nearest point starts
TRIES = 4  # most points of that grid from which the search starts, the nearest first
NEAR = 1e-9  # of the size: distance within which points are the same
FARTHEST = 2.0**40  # sizes from the centre within which the engine searches for the surface


class CentralChart(Chart):
    """Polar angle u from +z and azimuth v of the ray from a centre; p starts with the centre."""

    central = True
    periods = (None, TURN)
    singular_at = "a pole (u = 0 or pi), or out of the centre's sight"
    wrap = PolarChart.wrap

    def coordinates(self, x: ca.SX) -> Pair:
        return PolarChart(None).coordinates(x - self.p[:3])


@dataclass(frozen=True, eq=False, repr=False, init=False)
class UserSurface(Surface):
    """Base class of surfaces given by a formula."""

    panel_limit: ClassVar[float] = 2.0  # short panels, as the surface may have bumps anywhere
    formula: Formula
    size: float = field(default=1.0, kw_only=True)

    def _store(
        self, letters: str, definition: Any, formula: Any, parameters: Any, size: Any, inside: Any
    ) -> None:
        """Check and store the arguments that both kinds share; ``letters``: "uv" or "xyz"."""
        store(self, inside=inside)
        self.__post_init__()
        if definition is not None and formula is not None:
            raise SurfaceError(f"{self._kind}: f or F and formula are both given; give one of them")
        try:
            with making_symbols():
                formula = make_formula(
                    definition if formula is None else formula, parameters, letters
                )
        except ContactSystemError as error:
            raise SurfaceError(f"{self._kind}: {error}") from error.__cause__
        store(self, formula=formula, size=positive_length(self, "size", size))

    @property
    def named_parameters(self) -> dict[str, float]:
        """The parameters of the formula by name."""
        return self.formula.named

    def parameter_names(self, first: int = 0) -> tuple[str, ...]:
        return self.formula.names

    @property
    def structure(self) -> tuple[type, type | str]:
        return (type(self), self.formula.code)


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ParametricSurface(UserSurface):
    """A surface given by its chart f(u, v), orthogonal or not.

    A path through a point where f_u or f_v vanishes or they are parallel, such as a pole, is
    refused, unless rounding leads around it.

    Parameters
    ----------
    f : callable or sequence of three texts
        ``f(u, v)`` or ``f(u, v, **parameters)`` returning x, y, z in m from symbols, with numpy or
        CasADi functions; or texts such as ``"(R + r*cos(v))*cos(u)"``. f_u x f_v points out of
        the body.
    parameters : mapping of str to float, optional
        Named numbers of the formula; changing them needs no new tables.
    size : float
        Length scale of the surface, m, about its greatest radius; tolerances are fractions of it.
        Details narrower than a tenth of it, on otherwise flat ground, may be overlooked: then give
        the scale of the details.
    u_range, v_range : pairs of float, optional
        Where the inverse chart starts to search; default: one period about 0, or (-pi, pi). If the
        chart has points twice, give the part in which f_u x f_v points out of the body, such as
        (0, pi) for the polar angle of a ball.
    u_period, v_period : float, optional
        Period of a periodic coordinate.
    inside : bool
        The body is on the other side; (u, v) is then the point f(u, -v).
    formula : Formula, optional
        In place of f, the formula of another surface; ``parameters`` then changes some of its
        parameters. `dataclasses.replace` uses it.

    Raises
    ------
    SurfaceError
        Naming the argument, the value and the remedy.

    Examples
    --------
    A hollow of the ground, as a function and as text:

    >>> import contact_system as cs
    >>> ground = cs.ParametricSurface(
    ...     lambda u, v, k: (u, v, k * (u**2 + v**2)), parameters={"k": 2.0}, size=0.1)
    >>> same = cs.ParametricSurface(("u", "v", "k*(u**2 + v**2)"), parameters={"k": 2.0}, size=0.1)
    >>> print(ground.point(0.5, 0.0), same.point(0.5, 0.0))
    [0.5 0.  0.5] [0.5 0.  0.5]
    """

    chart = Chart
    has_implicit: ClassVar[bool] = False
    u_range: tuple[float, float] = field(kw_only=True)
    v_range: tuple[float, float] = field(kw_only=True)
    u_period: float | None = field(default=None, kw_only=True)
    v_period: float | None = field(default=None, kw_only=True)

    def __init__(
        self,
        f: Callable[..., Any] | Sequence[str] | None = None,
        *,
        parameters: Mapping[str, float] | None = None,
        size: float = 1.0,
        u_range: tuple[float, float] | None = None,
        v_range: tuple[float, float] | None = None,
        u_period: float | None = None,
        v_period: float | None = None,
        inside: bool = False,
        formula: Formula | None = None,
    ) -> None:
        self._store("uv", f, formula, parameters, size, inside)
        for name, given, period in (("u", u_range, u_period), ("v", v_range, v_period)):
            if period is not None:
                what = f"{self._kind}: {name}_period"
                period = finite_number(period, what, "above 0", SurfaceError)
            half = math.pi if period is None else period / 2
            span = _range(f"{self._kind}: {name}_range", (-half, half) if given is None else given)
            store(self, **{f"{name}_range": span, f"{name}_period": period})
        self._require_periods()

    def _require_periods(self) -> None:
        """Raise if points one period apart differ: wrapping coordinates would move contacts."""
        places = np.array([0.1, 0.4, 0.8])
        u, v = (low + (high - low) * places for low, high in (self.u_range, self.v_range))
        for name, period in (("u", self.u_period), ("v", self.v_period)):
            if period is None:
                continue
            turn_u, turn_v = (period, 0.0) if name == "u" else (0.0, period)
            with np.errstate(all="ignore"):  # a formula may have no point there
                here, there = self.point(u, v), self.point(u + turn_u, v + turn_v)
                apart = np.linalg.norm(there - here, axis=1)
                wrong = np.flatnonzero(apart > NEAR * self._scale(here))
            if len(wrong):
                i = wrong[0]
                raise SurfaceError(
                    f"{self._kind}: {name}_period = {period!r}: the points at (u, v) = "
                    f"({u[i]:.6g}, {v[i]:.6g}) and one period on are {apart[i]:.3g} m apart; give "
                    f"the period of the formula to all digits, or leave {name}_period out"
                )

    def _scale(self, points: Array) -> Array:
        """Lengths of which `NEAR` is a fraction at points (..., 3); far ones are rounded more."""
        return np.fmax(self.size, np.linalg.norm(points, axis=-1))

    @property
    def f(self) -> tuple[str, ...] | None:
        """The three texts of the chart; None where it was given as a function."""
        return self.formula.text

    @property
    def parameters(self) -> tuple[float, ...]:
        return self.formula.values

    def periods(self) -> Periods:
        return (self.u_period, self.v_period)

    def chart_expr(self, numbers: ca.SX, u: ca.SX, v: ca.SX) -> ca.SX:
        return self.formula(numbers[1:], u, numbers[0] * v)

    def _require_regular(self, u: Array, v: Array) -> None:
        with np.errstate(all="ignore"):  # the derivatives may exist where f does not: log(u)
            missing = ~np.isfinite(self.point(u, v)).all(axis=-1)
        if np.any(missing):
            raise SurfaceError(
                f"{self!r}: the formula has no point at (u, v) = "
                f"({float(u[missing][0])}, {float(v[missing][0])}); move the contact"
            )
        super()._require_regular(u, v)

    def _wrap(self, u: Any, v: Any) -> tuple[Any, Any]:
        return _into(u, self.u_range, self.u_period), _into(v, self.v_range, self.v_period)

    def coordinates(self, x: ArrayLike) -> tuple[Array, Array]:
        """Return (u, v) of points (..., 3) by Gauss-Newton on the distance to the surface.

        Parameters
        ----------
        x : array-like (..., 3)
            Points on the surface, m.

        Raises
        ------
        SurfaceError
            No point of the surface is found within 1e-9 of its size.
        """
        points = self._points(x)
        u, v, miss = self.nearest(points)
        # ~(a <= b) rather than a > b: a NaN is a miss too
        missed = np.flatnonzero(~(miss <= NEAR * self._scale(points)))
        if len(missed):
            i = int(missed[0])
            raise SurfaceError(
                f"{self!r}: no (u, v) found for the point {points.reshape(-1, 3)[i].tolist()}, "
                f"nearest miss {miss.ravel()[i]:.3g} m; check that it lies on the surface, or give "
                f"another u_range (now {self.u_range}) and v_range (now {self.v_range})"
            )
        return self._wrap(u, v)

    def nearest(self, x: ArrayLike) -> tuple[Array, Array, Array]:
        """Return (u, v) of the surface's points nearest to points (..., 3), and the distances.

        The search starts from the nearest points of a grid over u_range and v_range.

        Parameters
        ----------
        x : array-like (..., 3)
            m.

        Returns
        -------
        u, v, distance : arrays (...)
            The distance is infinite or NaN if no point is found.
        """
        points = self._points(x)
        flat = points.reshape(-1, 3)
        best, missed = np.full((3, len(flat)), math.inf), np.arange(len(flat))
        for start_u, start_v in self._grid_starts(flat):
            tried = np.array(self._descend(flat[missed], start_u[missed], start_v[missed]))
            best[:, missed] = np.where(~(tried[2] >= best[2, missed]), tried, best[:, missed])
            missed = np.flatnonzero(~(best[2] <= NEAR * self.size))
            if not len(missed):
                break
        u, v, miss = (w.reshape(points.shape[:-1]) for w in best)
        return u, v, miss

    def _grid_starts(self, flat: Array) -> list[tuple[Any, ...]]:
        """Return the nearest few grid points to each of (n, 3) points, nearest first."""
        # centres of cells, as charts have their poles at the edges of the range
        fraction = (np.arange(CELLS) + 0.5) / CELLS
        axes = [lo + (hi - lo) * fraction for lo, hi in (self.u_range, self.v_range)]
        grid_u, grid_v = (w.ravel() for w in np.meshgrid(*axes, indexing="ij"))
        grid_v = self.sign * grid_v
        grid = self.point(grid_u, grid_v)
        # NaN, where the formula has no point, is sorted last
        nearest = [np.argsort(np.sum((grid - x) ** 2, axis=1))[:TRIES] for x in flat]
        return [(grid_u[k], grid_v[k]) for k in np.reshape(nearest, (-1, TRIES)).astype(int).T]

    def _descend(self, target: Array, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Gauss-Newton with step halving; returns u, v and the distance left, each (n,)."""
        offset = target - self.point(u, v)
        miss = np.linalg.norm(offset, axis=1)
        fraction = np.ones(len(u))
        for _ in range(60):
            tangents = self.frame(u, v)[..., :2]
            ahead = np.einsum("nik,ni->nk", tangents, offset)
            if np.all(np.abs(ahead) <= np.finfo(float).eps * self.size):
                break
            m = self.metric_root(u, v)
            step_v = ahead[:, 1] / m[:, 1, 1]
            step_u = (ahead[:, 0] - m[:, 0, 1] * step_v) / m[:, 0, 0]
            trial_u, trial_v = u + fraction * step_u, v + fraction * step_v
            trial_offset = target - self.point(trial_u, trial_v)
            trial_miss = np.linalg.norm(trial_offset, axis=1)
            better = trial_miss < miss
            u, v = np.where(better, trial_u, u), np.where(better, trial_v, v)
            offset = np.where(better[:, None], trial_offset, offset)
            miss = np.where(better, trial_miss, miss)
            fraction = np.where(better, 1.0, fraction / 2)
            if np.all(fraction < 1e-6):
                break
        return u, v, miss


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ImplicitSurface(UserSurface):
    """The surface F(x) = 0 of a body F < 0 that is star-shaped about a centre.

    Coordinates are the polar angle u from the z direction and the azimuth v of the ray from the
    centre. The inverse chart is explicit; the chart is found by solving along the ray. Motion is
    planned in space, and methods that need an explicit chart refuse it (`has_chart` is False).

    Parameters
    ----------
    F : callable or text
        ``F(x)`` or ``F(x, **parameters)`` of a symbolic 3-vector, or a text in x, y, z such as
        ``"x**2/a**2 + y**2 + z**4 - 1"``. Negative inside the body.
    center : three floats
        A point inside the body (with ``inside=True``, in the hollow) from which the whole surface
        is visible, m. Where the surface is not visible, chart components are refused.
    parameters : mapping of str to float
        As for `ParametricSurface`; so are size, m, and formula.
    size : float
    formula : Formula, optional
    inside : bool
        The body is where F > 0; v is then the azimuth with the opposite sign.

    Raises
    ------
    SurfaceError
        Naming the argument, the value and the remedy.

    Examples
    --------
    A rounded cube, as text and as a function:

    >>> import contact_system as cs
    >>> cube = cs.ImplicitSurface("x**4 + y**4 + z**4 - r**4", parameters={"r": 0.1}, size=0.1)
    >>> same = cs.ImplicitSurface(
    ...     lambda x, r: x[0]**4 + x[1]**4 + x[2]**4 - r**4, parameters={"r": 0.1}, size=0.1)
    >>> print(cube.point(1.57, 0.0).round(3), same.point(1.57, 0.0).round(3))
    [0.1 0.  0. ] [0.1 0.  0. ]
    """

    chart = CentralChart
    has_chart: ClassVar[bool] = False
    center: tuple[float, float, float] = field(kw_only=True)

    def __init__(
        self,
        F: Callable[..., Any] | str | None = None,
        *,
        center: Sequence[float] = (0.0, 0.0, 0.0),
        parameters: Mapping[str, float] | None = None,
        size: float = 1.0,
        inside: bool = False,
        formula: Formula | None = None,
    ) -> None:
        self._store("xyz", F, formula, parameters, size, inside)
        point = finite_numbers(center, f"{self._kind}: center", SurfaceError)
        if len(point) != 3:
            raise SurfaceError(f"{self._kind}: center = {center!r}: give 3 numbers")
        store(self, center=point)

    @property
    def F(self) -> str | None:
        """The text of the level function; None where it was given as a function."""
        return None if self.formula.text is None else self.formula.text[0]

    @property
    def parameters(self) -> tuple[float, ...]:
        """The centre, then the formula's numbers in order of their names."""
        return (*self.center, *self.formula.values)

    def parameter_names(self, first: int = 0) -> tuple[str, ...]:
        return (*(f"center[{first + k}]" for k in range(3)), *self.formula.names)

    def frame_expr(self, numbers: ca.SX, x: ca.SX) -> Frame:
        return contact_frame(*self._tangents(numbers, x))

    def _tangents(self, numbers: ca.SX, x: ca.SX) -> Pair:
        """Return (f_u, f_v) of the central projection as fields of the point x."""
        side, p = numbers[0], numbers[1:]
        ray = x - p[:3]
        rho, s = ca.norm_2(ray), hypot(ray[0], ray[1])
        direction = ray / rho
        d_u = ca.vertcat(ray[0] * ray[2] / s, ray[1] * ray[2] / s, -s) / rho
        d_v = ca.vertcat(-ray[1], ray[0], 0) / rho
        gradient = ca.gradient(self._level(p, x), x)
        # 0, hence no frame, where the centre does not see the point: f_u x f_v would point inward
        along = ca.fmax(ca.dot(gradient, direction), 0)

        def tangent(d: ca.SX) -> ca.SX:
            """f_u = rho d_u plus a part along the ray that makes it tangent: grad F . f_u = 0."""
            return rho * (d - ca.dot(gradient, d) / along * direction)

        return tangent(d_u), tangent(side * d_v)

    def _level(self, p: ca.SX, x: ca.SX) -> ca.SX:
        return self.formula(p[3:], x)

    def level_geometry(self, p: ca.SX, x: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return those of F / max_i |dF/dx_i|, as |grad F|^2 may be too large for a double."""
        level, gradient, hessian = super().level_geometry(p, x)
        scale = 1 / ca.norm_inf(gradient)
        return scale * level, scale * gradient, scale * hessian

    def geometry_expr(self, numbers: ca.SX, place: ca.SX) -> ChartGeometry:
        f_u, f_v = self._tangents(numbers, place)
        along_u = ca.jacobian(f_u, place)
        second = along_u @ f_u, along_u @ f_v, ca.jacobian(f_v, place) @ f_v
        return tangent_geometry(place, f_u, f_v, second)

    def point(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Return the point where the ray (u, v) leaves the body, shape (..., 3), m.

        Newton's method along the ray, safeguarded by bisection. If a ray leaves the body more than
        once, because of a badly chosen centre, any one of these points is returned.

        Raises
        ------
        SurfaceError
            The centre is not inside, or the ray does not meet the surface.
        """
        u, v = self._finite(u, v)
        turned = (self.sign * v).ravel()
        across = np.sin(u).ravel()
        ray = np.stack([across * np.cos(turned), across * np.sin(turned), np.cos(u).ravel()])
        t = np.empty(ray.shape[1])
        arguments = address(self.numbers), self.size, len(t), address(ray), address(t)
        if rays(self.tables.ray.address, *arguments):
            raise MemoryError
        if not np.all((t > 0) & (t < math.inf)):
            self._refuse(u.ravel(), v.ravel(), t)
        return (np.array(self.center) + (t * ray).T).reshape((*u.shape, 3))

    def is_flat(self, u: float, v: float) -> bool:
        """Whether grad F vanishes at (u, v): F's slope along the ray drops to 0 there."""
        x = self.point(u, v)
        ray = x - self.center
        places = np.array([[*x, *ray], [*(x - 1e-4 * ray), *ray]]).T
        slope, before = run(self.tables.ray, places, self.numbers)[1]
        return bool(abs(slope) < 1e-3 * abs(before))

    def _refuse(self, u: Array, v: Array, t: Array) -> NoReturn:
        """Raise for the first ray without a distance t at which it leaves the body.

        t is 0 where the centre is not inside, infinite where a ray stays inside, NaN where the
        level function is too steep or not a number.
        """
        i = int(np.argmax(~((t > 0) & (t < math.inf))))
        at = f"(u, v) = ({u[i]}, {v[i]})"
        if t[i] == 0:
            there = np.array([*self.center, 0.0, 0.0, 0.0])[:, None]
            level = run(self.tables.ray, there, self.numbers)[0, 0]
            raise SurfaceError(
                f"{self!r}: F = {level} at center = {self.center}; F must be negative there: "
                "choose a center inside, or change the sign of F (and inside, if need be)"
            )
        if t[i] == math.inf:
            raise SurfaceError(
                f"{self!r}: the ray {at} from center = {self.center} does not meet the surface "
                f"within {FARTHEST * self.size:.3g} m; choose another center or point"
            )
        raise SurfaceError(
            f"{self!r}: the point at {at} is not found, F is too steep there or not a number; "
            "write F with lower powers"
        )


# --- helpers --------------------------------------------------------------------------------------


def _into(w: Any, span: tuple[float, float], period: float | None) -> Any:
    """Return a coordinate; if it is periodic and out of range, move it in by whole periods."""
    if period is None:
        return w
    return w - period * np.floor((w - span[0]) / period) * ((w < span[0]) | (w > span[1]))


def _range(what: str, value: Any) -> tuple[float, ...]:
    span = finite_numbers(value, what, SurfaceError)
    if len(span) != 2 or not span[0] < span[1]:
        raise SurfaceError(f"{what} = {value!r}: give two numbers, the lesser one first")
    return span
