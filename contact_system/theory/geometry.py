r"""Metric quantities of a surface in symbols, for any chart.

A chart ``f(u, v)`` need not be orthogonal. Its contact frame is ``E = [x y n]`` with

.. math:: x = f_u/|f_u|, \quad n = f_u \times f_v/|f_u \times f_v|, \quad y = n \times x,

and ``M`` (the metric root, ``M^T M`` is the metric) turns coordinate rates into velocity
components along ``x`` and ``y``. For an orthogonal chart ``y = f_v/|f_v|`` and
``M = diag(h_u, h_v)``, and the frame, M and the Christoffel symbols are those printed in the paper
(eqs. ``rotationmat``, ``finetune``, ``christoffel``). ``orthogonal`` says that ``f_u . f_v`` is
zero everywhere, which shortens every expression.

Lengths in metres, angles in radians. All results are CasADi SX expressions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

from . import symbols as ca

if TYPE_CHECKING:
    from ..surfaces.base import Surface


@dataclass(frozen=True, eq=False)
class ChartGeometry:
    """The metric quantities of a chart at one point, as SX expressions."""

    point: ca.SX
    """Position f, (3, 1), m."""
    frame: ca.SX
    """Contact frame E, columns x, y, n."""
    metric_root: ca.SX
    """M, (2, 2), upper triangular: ``M @ (u', v')`` is the velocity along (x, y)."""
    lame: ca.SX
    """Lame coefficients ``|f_u|``, ``|f_v|``, (2, 1)."""
    christoffel: tuple[ca.SX, ca.SX]
    """Second kind, ``christoffel[k][i, j]`` = Gamma^k_ij, both symmetric."""
    curvature_form: ca.SX
    """K, (2, 2), symmetric: ``n' = [x y] K M q'``; +I/r on a sphere of radius r. 1/m."""
    torsion_form: ca.SX
    """T, (1, 2): ``y . x' = T M q'``. 1/m."""

    def column(self) -> ca.SX:
        """Return all quantities as one column, as in `QUANTITIES`, the first index fastest."""
        first, second = (ca.vec(gamma) for gamma in self.christoffel)
        # (k, i, j), k fastest
        quantities = vars(self) | {"christoffel": ca.horzcat(first, second).T}
        return ca.vertcat(*(ca.vec(quantities[name]) for name in QUANTITIES))


QUANTITIES: dict[str, tuple[int, ...]] = {
    "point": (3,),
    "frame": (3, 3),
    "lame": (2,),
    "metric_root": (2, 2),
    "christoffel": (2, 2, 2),
    "curvature_form": (2, 2),
    "torsion_form": (2,),
}
"""Shapes of the quantities."""

_ENDS = [*accumulate(map(math.prod, QUANTITIES.values()), initial=0)]
ROWS = dict(zip(QUANTITIES, map(slice, _ENDS, _ENDS[1:])))
"""Rows of each in `ChartGeometry.column`."""


def contact_frame(f_u: ca.SX, f_v: ca.SX, orthogonal: bool = False) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the unit tangent axes x and y (3, 1) of f_u and f_v, and the metric root (2, 2)."""
    h_u = ca.norm_2(f_u)
    x = f_u / h_u
    if orthogonal:
        h_v = ca.norm_2(f_v)
        return x, f_v / h_v, ca.diag(ca.vertcat(h_u, h_v))
    along = ca.dot(x, f_v)
    # y is f_v without its x part, normalised: this is n cross x, but takes no cross products.
    across = f_v - along * x
    h_across = ca.norm_2(across)
    metric_root = ca.vertcat(ca.horzcat(h_u, along), ca.horzcat(0, h_across))
    return x, across / h_across, metric_root


def tangent_geometry(
    point: ca.SX, f_u: ca.SX, f_v: ca.SX, second: Sequence[ca.SX], orthogonal: bool = False
) -> ChartGeometry:
    """Return every metric quantity from a chart's value and derivatives, (3, 1) each.

    second: f_uu, f_uv, f_vv.
    """
    x, y, m = contact_frame(f_u, f_v, orthogonal)
    n = ca.cross(x, y)
    # components of the second derivatives along each axis
    along_x, along_y, along_n = (
        symmetric(*(ca.dot(axis, d) for d in second)) for axis in (x, y, n)
    )
    # Gamma^k_ij = g^kl f_l.f_ij; with g = M^T M this is M^-1 [x y]^T f_ij, no metric inverse.
    gamma_v = along_y / m[1, 1]
    gamma_u = (along_x - m[0, 1] * gamma_v) / m[0, 0]
    # Differentiating n.f_j = 0 gives n_i.f_j = -n.f_ij, so K needs no derivative of the normal.
    m_inv = upper_inverse(m)
    curvature = -m_inv.T @ along_n @ m_inv
    # y.x_i = y.f_ui/h_u, as the rest of x_i is along x.
    torsion = along_y[0, :] / m[0, 0] @ m_inv
    return ChartGeometry(
        point=point,
        frame=ca.horzcat(x, y, n),
        metric_root=m,
        lame=ca.vertcat(m[0, 0], ca.norm_2(f_v)),
        christoffel=(gamma_u, gamma_v),
        curvature_form=curvature,
        torsion_form=torsion,
    )


def symmetric(a: ca.SX, b: ca.SX, c: ca.SX) -> ca.SX:
    """Return the matrix [[a, b], [b, c]]."""
    return ca.vertcat(ca.horzcat(a, b), ca.horzcat(b, c))


def plane_turn(cos: ca.SX, sin: ca.SX) -> ca.SX:
    """Return the rotation of the plane by an angle with this cosine and sine, 2x2."""
    return ca.vertcat(ca.horzcat(cos, -sin), ca.horzcat(sin, cos))


def rotation(angle: ca.SX) -> ca.SX:
    """Return Rot(angle), 2x2."""
    return plane_turn(ca.cos(angle), ca.sin(angle))


def upper_inverse(m: ca.SX) -> ca.SX:
    """Return the inverse of an upper triangular 2x2 matrix, term by term."""
    corner = -m[0, 1] / (m[0, 0] * m[1, 1])
    return ca.vertcat(ca.horzcat(1 / m[0, 0], corner), ca.horzcat(0, 1 / m[1, 1]))


# --- functions of (point, numbers of a surface) --------------------------------------------------


def number_symbols(surface: Surface) -> ca.SX:
    """Return symbols for a surface's sign and its parameters, one column."""
    return ca.SX.sym("numbers", 1 + len(surface.parameters))


def numbers_function(name: str, point: ca.SX, numbers: ca.SX, result: ca.SX) -> ca.Function:
    """Return the function (point, numbers) -> result, one column each."""
    return ca.Function(name, [point, numbers], [ca.densify(ca.vec(result))])
