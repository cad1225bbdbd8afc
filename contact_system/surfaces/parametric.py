"""Surfaces given by a chart f(u, v), in Python or as text."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array, finite_number, finite_numbers
from ..errors import SurfaceError
from ..theory import symbols as ca
from .base import store
from .charts import Chart, Periods
from .formula import Formula, UserSurface

CELLS = 32  # in each coordinate of the grid from whose points the search for a nearest point starts
TRIES = 4  # most points of that grid from which the search starts, the nearest first
NEAR = 1e-9  # of the size: distance within which points are the same


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
        Ranges of f's arguments in which the inverse chart starts to search; default: one period
        about 0, or (-pi, pi). If the chart has points twice, give the part in which f_u x f_v
        points out of the body, such as (0, pi) for the polar angle of a ball.
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
        super().__init__("uv", f, formula, parameters, size, inside)
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
        v *= self.sign  # the ranges are those of the formula's arguments
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
        """Return (u, v) of points (..., 3) on the surface, m.

        Raises a SurfaceError for a point that is not within 1e-9 of the surface's size of it; and
        for some on charts with more than 16 waves over u_range or v_range: narrow that.
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
        """Return (u, v) of the surface's points nearest to points (..., 3), and the distances, m.

        Newton's method on the distance, from the nearest points of a grid over u_range and v_range.
        A distance is infinite or NaN if no point is found.
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
        """Newton's method with step halving; returns u, v and the distance left, each (n,)."""
        offset = target - self.point(u, v)
        miss = np.linalg.norm(offset, axis=1)
        fraction = np.ones(len(u))
        for _ in range(60):
            frame, m, k = self._evaluate(u, v, "frame", "metric_root", "curvature_form")
            along = np.einsum("nik,ni->nk", frame, offset)
            ahead, height = along[:, :2], along[:, 2, None, None]
            if np.all(np.abs(ahead) <= np.finfo(float).eps * self.size):
                break
            lifted = np.eye(2) + height * k
            rising = (np.linalg.det(lifted) > 0) & (lifted[:, 0, 0] > 0)
            lifted[~rising] = np.eye(2)  # beyond a centre of curvature: Gauss-Newton's step
            step = np.linalg.solve(lifted, ahead[..., None])
            step_v = step[:, 1, 0] / m[:, 1, 1]
            step_u = (step[:, 0, 0] - m[:, 0, 1] * step_v) / m[:, 0, 0]
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
