"""Metric quantities against their definitions, differentiated by mpmath with 40 digits."""

from __future__ import annotations

from collections.abc import Callable

import mpmath as mp
import numpy as np
import pytest

from contact_system import (
    Cylinder,
    Ellipsoid,
    ImplicitSurface,
    ParametricSurface,
    Plane,
    Quadric,
    Sphere,
    Surface,
    Torus,
)

Chart = Callable[[mp.mpf, mp.mpf], list[mp.mpf]]


def paper_ellipsoid(u, v):
    """Eq. ``ellipsoid`` as printed, radii 0.3, 0.2, 0.1."""
    a, b, c = mp.mpf(0.3), mp.mpf(0.2), mp.mpf(0.1)
    whole = mp.sqrt(a**2 - c**2)
    return [
        a * mp.cos(u) * mp.sqrt(a**2 - b**2 * mp.sin(v) ** 2 - c**2 * mp.cos(v) ** 2) / whole,
        b * mp.sin(u) * mp.cos(v),
        c * mp.sin(v) * mp.sqrt(a**2 * mp.sin(u) ** 2 + b**2 * mp.cos(u) ** 2 - c**2) / whole,
    ]


def saddle(u, v):
    """An oblique chart, far from orthogonal."""
    return [u + 0.5 * v, v - 0.25 * u, u * v + 0.125 * u**3]


def one_sheet(u, v):
    """Axes of diag(1, 4, -1/4): 1, 1/2 and 2."""
    swell = mp.cosh(v)
    return [swell * mp.cos(u), mp.mpf(0.5) * swell * mp.sin(u), 2 * mp.sinh(v)]


def two_sheets(u, v):
    return [mp.sqrt(1 + u**2 + v**2), 2 * u, mp.mpf(0.5) * v]


def torus(u, v):
    rho = mp.mpf(0.1) + mp.mpf(0.03) * mp.cos(v)
    return [rho * mp.cos(u), rho * mp.sin(u), mp.mpf(0.03) * mp.sin(v)]


def sphere(u, v):
    r = mp.mpf(0.1)
    return [r * mp.sin(u) * mp.cos(v), r * mp.sin(u) * mp.sin(v), r * mp.cos(u)]


def oblate(u, v):
    a, c = mp.mpf(0.3), mp.mpf(0.1)
    return [a * mp.cos(u) * mp.cos(v), a * mp.sin(u) * mp.cos(v), c * mp.sin(v)]


def prolate(u, v):
    a, b = mp.mpf(0.3), mp.mpf(0.1)
    return [a * mp.cos(u), b * mp.sin(u) * mp.cos(v), b * mp.sin(u) * mp.sin(v)]


def quartic(u, v):
    """Central projection onto the quartic x^4 + y^4 + z^4 = 1."""
    d = [mp.sin(u) * mp.cos(v), mp.sin(u) * mp.sin(v), mp.cos(u)]
    rho = sum(w**4 for w in d) ** (mp.mpf(-1) / 4)
    return [rho * w for w in d]


CASES: dict[str, tuple[Surface, Chart]] = {
    "plane": (Plane(), lambda u, v: [u, v, mp.mpf(0)]),
    "sphere": (Sphere(0.1), sphere),
    "cylinder": (Cylinder(0.1), lambda u, v: [mp.mpf(0.1) * mp.cos(u), mp.mpf(0.1) * mp.sin(u), v]),
    "torus": (Torus(0.1, 0.03), torus),
    "ellipsoid": (Ellipsoid(0.3, 0.2, 0.1), paper_ellipsoid),
    "oblate": (Ellipsoid(0.3, 0.3, 0.1), oblate),
    "prolate": (Ellipsoid(0.3, 0.1, 0.1), prolate),
    "one sheet": (Quadric(np.diag([1.0, 4.0, -0.25])), one_sheet),
    "two sheets": (Quadric(np.diag([1.0, -0.25, -4.0])), two_sheets),
    "elliptic cylinder": (
        Quadric(np.diag([0.25, 1.0, 0.0])),
        lambda u, v: [2 * mp.cos(u), mp.sin(u), v],
    ),
    "hyperbolic cylinder": (
        Quadric(np.diag([1.0, -4.0, 0.0])),
        lambda u, v: [mp.sqrt(1 + u**2), u / 2, v],
    ),
    "oblique chart": (ParametricSurface(("u + 0.5*v", "v - 0.25*u", "u*v + 0.125*u**3")), saddle),
    "implicit": (ImplicitSurface("x**4 + y**4 + z**4 - 1"), quartic),
}
POINTS = [(0.7, 0.4), (2.1, -1.2), (1.3, 1.1)]


def as_array(rows) -> np.ndarray:
    return np.array([[float(w) for w in row] for row in rows])


def by_definition(chart: Chart, u: float, v: float) -> dict[str, np.ndarray]:
    """Every metric quantity straight from its definition (theory section 1)."""

    def derivative(function, wrt: int):
        step = (1, 0) if wrt == 0 else (0, 1)
        return mp.matrix(
            [mp.diff(lambda s, t, i=i: function(s, t)[i], (u, v), step) for i in range(3)]
        )

    def dot(a, b):
        return sum(a[i] * b[i] for i in range(3))

    def unit(a):
        return a / mp.sqrt(dot(a, a))

    def cross(a, b):
        after = [(1, 2), (2, 0), (0, 1)]  # mpmath 1.3 takes no index below 0
        return mp.matrix([a[i] * b[k] - a[k] * b[i] for i, k in after])

    def tangents(s, t):
        return [
            mp.matrix([mp.diff(lambda *w, i=i: chart(*w)[i], (s, t), o) for i in range(3)])
            for o in ((1, 0), (0, 1))
        ]

    def axes(s, t):
        f_u, f_v = tangents(s, t)
        x, n = unit(f_u), unit(cross(f_u, f_v))
        return x, cross(n, x), n

    f_q = tangents(u, v)
    x, y, n = axes(u, v)
    metric_root = mp.matrix(2, 2)
    for j in range(2):
        metric_root[0, j], metric_root[1, j] = dot(x, f_q[j]), dot(y, f_q[j])
    n_q = [derivative(lambda s, t: axes(s, t)[2], j) for j in range(2)]
    x_q = [derivative(lambda s, t: axes(s, t)[0], j) for j in range(2)]
    bend = mp.matrix([[dot(w, n_q[j]) for j in range(2)] for w in (x, y)])
    twist = mp.matrix([[dot(y, x_q[0]), dot(y, x_q[1])]])
    f_qq = [[derivative(lambda s, t, i=i: tangents(s, t)[i], j) for j in range(2)] for i in (0, 1)]
    inverse = (metric_root.T * metric_root) ** -1
    christoffel = np.zeros((2, 2, 2))
    for k, i, j in np.ndindex(2, 2, 2):
        christoffel[k, i, j] = sum(inverse[k, m] * dot(f_q[m], f_qq[i][j]) for m in range(2))
    return {
        "point": np.array([float(w) for w in chart(mp.mpf(u), mp.mpf(v))]),
        "frame": as_array(zip(x, y, n, strict=True)),
        "lame": np.array([float(mp.sqrt(dot(w, w))) for w in f_q]),
        "metric_root": as_array(metric_root.tolist()),
        "curvature_form": as_array((bend * metric_root**-1).tolist()),
        "torsion_form": as_array((twist * metric_root**-1).tolist())[0],
        "christoffel": christoffel,
    }


@pytest.mark.parametrize("name", CASES)
def test_metric_quantities_follow_their_definitions(name):
    surface, chart = CASES[name]
    with mp.workdps(40):
        for u, v in POINTS:
            for quantity, truth in by_definition(chart, u, v).items():
                value = getattr(surface, quantity)(u, v)
                assert value.shape == truth.shape, quantity
                error = np.max(np.abs(value - truth)) / max(1.0, np.max(np.abs(truth)))
                assert error < 2e-14, (quantity, u, v, error)
