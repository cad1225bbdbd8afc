r"""Rolling as the development of a plane curve: moving frames on any surface (theory 4, 5).

The contact point of body i moves with velocity ``c_1 p + c_2 q``, where ``[p q]`` is a frame
carried by parallel transport and ``c`` is known in advance:

.. math:: c_1 = \sigma W_1, \qquad c_2 = \sigma (W - V e^{-L}), \qquad W = R_0 W_1 .

No sigma'/sigma, no stiffness, and no coupling between the bodies. Two forms of state:

* in space, (x, p), for surfaces with an implicit form: no chart, no poles; q = n x p;
* in the chart, (u, v, theta), for surfaces given by a chart: [p q] is the contact frame turned by
  theta.

Each form has a class that defines the frame (`place`, `turn`, `theta`) and its motion; the base
class derives the rest. Every function takes (point, numbers): the state with further inputs, and
the surface's sign and parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import symbols as ca
from .geometry import number_symbols, numbers_function, plane_turn, rotation, upper_inverse
from .symbols import making_symbols, per_structure

if TYPE_CHECKING:
    from ..surfaces.base import Surface

IN_CHART = ("motion", "coordinates", "vector", "shape", "frame", "point", "lame")
IN_SPACE = ("motion", "coordinates", "vector", "shape", "second", "restore", "start")
INPUTS = {"motion": 2, "coordinates": 2, "vector": 2, "geodesic": 4}
"""Sizes of further inputs after the state: a vector of the plane, or Jacobi fields."""


def in_space(surface: Surface, disturbed: bool = False) -> bool:
    """Whether a body is planned in space, (x, p); if not, in its chart, (u, v, theta).

    A disturbance has chart components. On a double cover (triaxial ellipsoid) their sign depends on
    the path's branch, which the state in space does not determine.
    """
    in_chart = surface.chart.developable or (disturbed and surface.chart.double_cover)
    return surface.has_implicit and not in_chart


class Moving:
    """A frame [p q] carried along a surface, in symbols."""

    size: int
    """Number of states."""
    place: tuple[ca.SX, ca.SX]
    """u, v of the point."""
    theta: ca.SX
    turn: ca.SX
    """Rot(theta), (2, 2): rotates the contact frame into [p q]."""
    metric_root: ca.SX

    def __init__(self, surface: Surface):
        self.surface = surface
        self.numbers = number_symbols(surface)
        self.state = ca.SX.sym("state", self.size)
        self._functions: dict[str, ca.Function] = {}

    def __call__(self, name: str) -> ca.Function:
        """Return one of `IN_SPACE` or `IN_CHART` as a function of (point, numbers)."""
        if name not in self._functions:
            with making_symbols():
                self._functions[name] = self._function(name)
        return self._functions[name]

    def _function(self, name: str) -> ca.Function:
        inputs = [ca.SX.sym("c", INPUTS[name])] if name in INPUTS else []
        point, result = ca.vertcat(self.state, *inputs), getattr(self, name)(*inputs)
        return numbers_function(name, point, self.numbers, result)

    def coordinates(self, c: ca.SX) -> ca.SX:
        """u, v, u', v', theta for the velocity c in the parallel frame, m/s."""
        rates = upper_inverse(self.metric_root) @ (self.turn @ c)
        return ca.vertcat(*self.place, rates, self.theta)

    def geodesic(self, fields: ca.SX) -> ca.SX:
        """Derivatives by arc length along p of the state and of J, J', M, M' (section 11)."""
        j, j_rate, m, m_rate = ca.vertsplit(fields)
        minus_k = -self.gauss()
        return ca.vertcat(self.motion(ca.SX([1, 0])), j_rate, minus_k * j, m_rate, minus_k * m)

    def motion(self, c: ca.SX) -> ca.SX:
        """Rates of the state if the point moves with the velocity c in the parallel frame."""
        raise NotImplementedError

    def gauss(self) -> ca.SX:
        """Gaussian curvature, 1/m^2."""
        raise NotImplementedError

    def vector(self, components: ca.SX) -> ca.SX:
        """The vector a f_u + b f_v in the parallel frame: Rot(theta)^T M (a, b)."""
        return self.turn.T @ (self.metric_root @ components)


class InSpace(Moving):
    """State x, p: a point of the surface and a unit tangent, m and 1."""

    size = 6

    def __init__(self, surface: Surface):
        super().__init__(surface)
        self.x, self.first = ca.vertsplit(self.state, [0, 3, 6])
        # with ``inside`` the gradient points into the body
        self.level, self.gradient, self.hessian = surface.level_geometry(self.numbers[1:], self.x)
        self._steepness = 1 / ca.dot(self.gradient, self.gradient)
        # grad F x p, and the factor, sign/|grad F|, that makes it q = n x p
        self._across = ca.cross(self.gradient, self.first)
        self._scale = self.numbers[0] * ca.sqrt(self._steepness)
        self.place = surface.coordinates_expr(self.numbers, self.x)
        x_axis, y_axis, self.metric_root = surface.frame_expr(self.numbers, self.x)
        self.turn = plane_turn(ca.dot(self.first, x_axis), ca.dot(self.first, y_axis))
        self.theta = ca.atan2(self.turn[1, 0], self.turn[0, 0])

    def second(self) -> ca.SX:
        """q = n x p, n the normal out of the body."""
        return self._scale * self._across

    def frame(self) -> ca.SX:
        """x, p, q, (9)."""
        return ca.vertcat(self.state, self.second())

    def motion(self, c: ca.SX) -> ca.SX:
        """x' = c1 p + c2 q, p' = -II(p, x') n."""
        velocity = c[0] * self.first + (c[1] * self._scale) * self._across
        # n and II both change sign with the side, so p' needs no sign
        second_form = ca.dot(self.hessian @ self.first, velocity) * self._steepness
        return ca.vertcat(velocity, -second_form * self.gradient)

    def gauss(self) -> ca.SX:
        """g . adj(H) g / |g|^4 with g = grad F and H = Hess F."""
        a, b, c = ca.horzsplit(self.hessian)
        adjoint = ca.horzcat(ca.cross(b, c), ca.cross(c, a), ca.cross(a, b))
        return ca.dot(self.gradient, adjoint @ self.gradient) * self._steepness**2

    def shape(self) -> ca.SX:
        """K in the parallel frame, (K_pp, K_pq, K_qq)."""
        frame = ca.horzcat(self.first, self.second())
        k = frame.T @ self.hessian @ frame * self._scale
        return ca.vertcat(k[0, 0], k[0, 1], k[1, 1])

    def restore(self) -> ca.SX:
        """The state with x put back on the surface and p made a unit tangent.

        One Newton step along the gradient squares the distance from the surface.
        """
        # with the gradient at x: by that on the surface, a step from afar would end beyond the body
        restored = self.x - self.level * self._steepness * self.gradient
        normal = ca.substitute(self.gradient, self.x, restored)
        normal /= ca.norm_2(normal)
        first = self.first - ca.dot(self.first, normal) * normal
        return ca.vertcat(restored, first / ca.norm_2(first))

    def _function(self, name: str) -> ca.Function:
        if name != "start":
            return super()._function(name)
        # u, v, theta -> x, p, on the surface to rounding
        place = ca.SX.sym("place", 3)
        frame = moving(self.surface, False)("frame")(place, self.numbers)
        back = self("restore")(frame[:6], self.numbers)
        return numbers_function(name, place, self.numbers, back)


class InChart(Moving):
    """State u, v, theta."""

    size = 3

    def __init__(self, surface: Surface):
        super().__init__(surface)
        u, v, self.theta = ca.vertsplit(self.state)
        self.place, self.turn = (u, v), rotation(self.theta)
        self.geometry = surface.geometry_expr(self.numbers, self.state[:2])
        self.metric_root = self.geometry.metric_root

    def motion(self, c: ca.SX) -> ca.SX:
        """(u', v') = M^-1 Rot(theta) c, theta' = -T Rot(theta) c."""
        velocity = self.turn @ c
        rates = upper_inverse(self.metric_root) @ velocity
        return ca.vertcat(rates, -self.geometry.torsion_form @ velocity)

    def gauss(self) -> ca.SX:
        return ca.det(self.geometry.curvature_form)

    def frame(self) -> ca.SX:
        """x, p, q, (9)."""
        return ca.vertcat(self.point(), ca.vec(self.geometry.frame[:, :2] @ self.turn))

    def shape(self) -> ca.SX:
        """K in the parallel frame, (K_pp, K_pq, K_qq)."""
        k = self.turn.T @ self.geometry.curvature_form @ self.turn
        return ca.vertcat(k[0, 0], k[0, 1], k[1, 1])

    def point(self) -> ca.SX:
        """x, (3)."""
        return self.geometry.point

    def lame(self) -> ca.SX:
        """h_u, h_v and the least diagonal entry of M, m, which is 0 where the chart is singular."""
        m = self.metric_root
        return ca.vertcat(self.geometry.lame, ca.fmin(m[0, 0], m[1, 1]))


@per_structure
def moving(surface: Surface, space: bool) -> Moving:
    """The moving frame of surfaces of one structure, in space or in their chart."""
    return (InSpace if space else InChart)(surface)
