"""Surfaces given by a level function F(x), in Python or as text, and their polar chart."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array, finite_numbers
from ..engine.binding import address, rays, run
from ..errors import SurfaceError
from ..theory import symbols as ca
from ..theory.geometry import ChartGeometry, contact_frame, tangent_geometry
from .base import store
from .charts import TURN, Chart, Frame, Pair
from .formula import Formula, UserSurface
from .sphere import PolarChart

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
        super().__init__("xyz", F, formula, parameters, size, inside)
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
        rho, s = ca.norm_2(ray), ca.hypot(ray[0], ray[1])
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
