"""Charts and metric quantities against their definitions, by mpmath's derivatives of charts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import mpmath as mp
import numpy as np
import pytest
from mpmath import cos, cosh, mpf, sin, sinh, sqrt

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

Chart = Callable[[mp.mpf, mp.mpf], tuple[mp.mpf, mp.mpf, mp.mpf]]


def printed_ellipsoid(*axes: float) -> Chart:
    """Eq. ``ellipsoid`` as printed."""

    def chart(u, v):
        a, b, c = map(mpf, axes)
        whole = sqrt(a**2 - c**2)
        return (
            a * cos(u) * sqrt(a**2 - b**2 * sin(v) ** 2 - c**2 * cos(v) ** 2) / whole,
            b * sin(u) * cos(v),
            c * sin(v) * sqrt(a**2 * sin(u) ** 2 + b**2 * cos(u) ** 2 - c**2) / whole,
        )

    return chart


def torus(u, v):
    rho = 0.1 + 0.03 * cos(v)
    return rho * cos(u), rho * sin(u), 0.03 * sin(v)


def ray(u, v):
    return sin(u) * cos(v), sin(u) * sin(v), cos(u)


def quartic(u, v):
    """Central projection onto x^4 + y^4 + z^4 = 1."""
    rho = sum(w**4 for w in ray(u, v)) ** mpf(-0.25)
    return tuple(rho * w for w in ray(u, v))


CASES: dict[str, tuple[Surface, Chart]] = {
    "plane": (Plane(), lambda u, v: (u, v, 0 * u)),
    "sphere": (Sphere(0.1), lambda u, v: tuple(0.1 * w for w in ray(u, v))),
    "cylinder": (Cylinder(0.1), lambda u, v: (0.1 * cos(u), 0.1 * sin(u), v)),
    "torus": (Torus(0.1, 0.03), torus),
    "ellipsoid": (Ellipsoid(0.3, 0.2, 0.1), printed_ellipsoid(0.3, 0.2, 0.1)),
    "oblate": (
        Ellipsoid(0.3, 0.3, 0.1),
        lambda u, v: (0.3 * cos(u) * cos(v), 0.3 * sin(u) * cos(v), 0.1 * sin(v)),
    ),
    "prolate": (
        Ellipsoid(0.3, 0.1, 0.1),
        lambda u, v: (0.3 * cos(u), 0.1 * sin(u) * cos(v), 0.1 * sin(u) * sin(v)),
    ),
    "one sheet": (
        Quadric(np.diag([1.0, 4.0, -0.25])),
        lambda u, v: (cosh(v) * cos(u), 0.5 * cosh(v) * sin(u), 2 * sinh(v)),
    ),
    "two sheets": (
        Quadric(np.diag([1.0, -0.25, -4.0])),
        lambda u, v: (sqrt(1 + u**2 + v**2), 2 * u, 0.5 * v),
    ),
    "elliptic cylinder": (Quadric(np.diag([0.25, 1.0, 0.0])), lambda u, v: (2 * cos(u), sin(u), v)),
    "hyperbolic cylinder": (
        Quadric(np.diag([1.0, -4.0, 0.0])),
        lambda u, v: (sqrt(1 + u**2), u / 2, v),
    ),
    "oblique chart": (
        ParametricSurface(("u + 0.5*v", "v - 0.25*u", "u*v + 0.125*u**3")),
        lambda u, v: (u + 0.5 * v, v - 0.25 * u, u * v + 0.125 * u**3),
    ),
    "implicit": (ImplicitSurface("x**4 + y**4 + z**4 - 1"), quartic),
}


def by_definition(chart: Chart, u: float, v: float) -> dict[str, np.ndarray]:
    """Every metric quantity from the chart's derivatives (theory section 1)."""

    def d(i: int, j: int) -> list[float]:
        return [float(mp.diff(lambda *q, k=k: chart(*q)[k], (u, v), (i, j))) for k in range(3)]

    f = np.array([d(1, 0), d(0, 1)])
    second = np.array([[d(2, 0), d(1, 1)], [d(1, 1), d(0, 2)]])
    lame = np.linalg.norm(f, axis=1)
    normal = np.cross(*f)
    normal /= np.linalg.norm(normal)
    x = f[0] / lame[0]
    y = np.cross(normal, x)
    root = np.array([x, y]) @ f.T
    inverse = np.linalg.inv(root)
    return {
        "point": np.array([float(w) for w in chart(mpf(u), mpf(v))]),
        "frame": np.stack([x, y, normal], axis=1),
        "lame": lame,
        "metric_root": root,
        # n' = [x y] K M q', where f_i . n_j = -f_ij . n
        "curvature_form": -inverse.T @ (second @ normal) @ inverse,
        "torsion_form": (second[0] @ y) / lame[0] @ inverse,  # y . x' = T M q'
        "christoffel": np.einsum("km,mc,ijc->kij", inverse @ inverse.T, f, second),
    }


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_metric_quantities_follow_their_definitions(name, inside):
    surface, chart = CASES[name]
    if inside:  # v changes its sign, and the normal with it
        surface, chart = (
            dataclasses.replace(surface, inside=True),
            lambda u, v: CASES[name][1](u, -v),
        )
    with mp.workdps(40):
        for u, v in [(0.7, 0.4), (2.1, -1.2), (1.3, 1.1)]:
            for quantity, truth in by_definition(chart, u, v).items():
                value = getattr(surface, quantity)(u, v)
                assert value.shape == truth.shape, quantity
                error = np.max(np.abs(value - truth)) / max(1.0, np.max(np.abs(truth)))
                assert error < 2e-14, (quantity, u, v, error)


AXES = [
    (0.3, 0.2, 0.1),
    (3.0, 2.0, 1.0),
    (1 + 1e-6, 1.0, 1 - 1e-6),
    (1 + 1e-6, 1.0, 0.5),
    (2.0, 1.0, 1 - 1e-6),
    (np.nextafter(1.0, 2.0), 1.0, 0.5),
    (2.0, 1.0, np.nextafter(1.0, 0.0)),
    (100.0, 1.0, 0.9),
    (100.0, 99.0, 1.0),
    (1e3, 1.0, 1e-3),
]


@pytest.mark.parametrize("axes", AXES)
def test_the_ellipsoids_chart_is_the_printed_one_and_invertible_at_seams_and_umbilics(axes):
    surface, random = Ellipsoid(*axes), np.random.default_rng(4)
    u, v = random.uniform(-3, 3, (2, 20))
    with mp.workdps(60):
        for s, t, x in zip(u, v, surface.point(u, v)):
            printed = printed_ellipsoid(*axes)(mpf(s), mpf(t))
            assert max(abs(w - p) for w, p in zip(x, printed)) < 5e-16 * axes[0]
    near = np.array([0.0, 1e-300, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 0.03, 1.0, 2.0])
    corners, sides = np.array([0.0, np.pi, -np.pi]), np.array([-1, 1]) * np.pi / 2
    u, v = np.meshgrid(
        np.ravel([corners[:, None] - near, corners[:, None] + near]),
        np.ravel([sides[:, None] - near, sides[:, None] + near]),
    )
    x = surface.point(u, v)
    u, v = surface.coordinates(x)
    assert np.max(np.abs(surface.point(u, v) - x)) < 1e-15 * surface.size
    assert np.all((u > -np.pi) & (u <= np.pi) & (np.abs(v) <= np.pi / 2))
