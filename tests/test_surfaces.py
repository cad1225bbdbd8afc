"""Surfaces: charts and their inverses, orientation, canonical coordinates, errors."""

from __future__ import annotations

import dataclasses
import pickle
from math import pi

import numpy as np
import pytest
from conftest import turned_quadric

from contact_system import (
    ChartSingularity,
    Cylinder,
    Ellipsoid,
    ImplicitSurface,
    ParametricSurface,
    Plane,
    Quadric,
    Sphere,
    Surface,
    SurfaceError,
    Torus,
)

TORUS = ("(R + r*cos(v))*cos(u)", "(R + r*cos(v))*sin(u)", "r*sin(v)")
SIGNATURES = {
    "triaxial": (1.0, 2.0, 3.0),
    "oblate": (1.0, 1.0, 2.0),
    "prolate": (2.0, 2.0, 1.0),
    "round": (4.0, 4.0, 4.0),
    "one sheet": (1.0, 2.0, -1.0),
    "two sheets": (1.0, -2.0, -1.0),
    "elliptic cylinder": (1.0, 2.0, 0.0),
    "round cylinder": (4.0, 4.0, 0.0),
    "hyperbolic cylinder": (1.0, -2.0, 0.0),
    "planes": (4.0, 0.0, 0.0),
}

EXPLICIT: dict[str, Surface] = {
    "plane": Plane(),
    "sphere": Sphere(0.1),
    "cylinder": Cylinder(0.1),
    "torus": Torus(0.1, 0.03),
    "ellipsoid": Ellipsoid(0.3, 0.2, 0.1),
    "ellipsoid oblate": Ellipsoid(0.3, 0.3, 0.1),
    "ellipsoid prolate": Ellipsoid(0.3, 0.1, 0.1),
    "ellipsoid round": Ellipsoid(0.2, 0.2, 0.2),
    **{f"quadric {name}": turned_quadric(*values) for name, values in SIGNATURES.items()},
}
IMPLICIT = ImplicitSurface("x**2/a**2 + y**4 + z**2 - 1", parameters={"a": 1.5}, size=1.5)
RADII = {"R": 0.1, "r": 0.03}
PARAMETRIC = ParametricSurface(TORUS, parameters=RADII, size=0.13)
ALL = EXPLICIT | {"implicit": IMPLICIT, "parametric": PARAMETRIC}


def inside_out(surface: Surface) -> Surface:
    return dataclasses.replace(surface, inside=True)


def sample(surface: Surface, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """(u, v) spread over the chart, away from its singular points."""
    u, v = np.random.default_rng(5).uniform(-3, 3, (2, count))
    return surface.canonical(u, v)


# --- inverse charts


both_sides = pytest.mark.parametrize("inside", [False, True])


@both_sides
@pytest.mark.parametrize("name", ALL)
def test_coordinates_are_the_inverse_of_point(name, inside):
    surface = inside_out(ALL[name]) if inside else ALL[name]
    u, v = sample(surface)
    x = surface.point(u, v)
    back_u, back_v = surface.coordinates(x)
    scale = np.maximum(surface.size, np.linalg.norm(x, axis=-1))
    assert np.max(np.abs(surface.point(back_u, back_v) - x).max(axis=-1) / scale) < 4e-15
    turn_u, turn_v = (w or np.inf for w in surface.periods())
    for w, back, turn in ((u, back_u, turn_u), (v, back_v, turn_v)):
        away = np.abs(w - back)
        # 1e-12: rounding of 1e-14 over the sample's least sine of a polar angle, 0.01
        assert np.max(np.minimum(away, np.abs(turn - away))) < 1e-12


# --- frames, orientation, level functions


def level_gradient(surface: Surface, x: np.ndarray) -> np.ndarray:
    """The level function's gradient at points (n, 3), by hand; it points out of a solid."""
    flat = x * [1, 1, 0]
    if isinstance(surface, Torus):
        along = flat / np.linalg.norm(flat, axis=1)[:, None]
        return x - surface.major * along
    if isinstance(surface, Quadric):
        return x @ np.array(surface.A)
    if isinstance(surface, Ellipsoid):
        return x / np.square([surface.a, surface.b, surface.c])
    if surface is IMPLICIT:
        return np.stack([2 * x[:, 0] / 1.5**2, 4 * x[:, 1] ** 3, 2 * x[:, 2]], axis=1)
    return {Plane: 0 * x + [0, 0, 1], Sphere: x, Cylinder: flat}[type(surface)]


@both_sides
@pytest.mark.parametrize("name", [n for n in ALL if n != "parametric"])
def test_normal_is_along_the_gradient_of_the_level_function(name, inside):
    surface = inside_out(ALL[name]) if inside else ALL[name]
    u, v = sample(surface)
    gradient = level_gradient(ALL[name], surface.point(u, v)) * (-1 if inside else 1)
    gradient /= np.linalg.norm(gradient, axis=1)[:, None]
    assert np.allclose(surface.normal(u, v), gradient, atol=1e-14)


@pytest.mark.parametrize("distance", [1e-2, 1e-4, 1e-6])
def test_frames_near_an_umbilic_lose_no_more_digits_than_rounding_of_the_point_costs(distance):
    surface = Ellipsoid(0.3, 0.2, 0.1)
    angle = np.linspace(0, 2 * pi, 40)
    u, v = distance * np.sin(angle), pi / 2 - distance * np.abs(np.cos(angle)) - 1e-3 * distance
    found = surface.frame(*surface.coordinates(surface.point(u, v)))
    assert np.abs(found[..., 0] - surface.frame(u, v)[..., 0]).max() < 1e-15 / distance**2
    assert np.allclose(found.swapaxes(1, 2) @ found, np.eye(3), atol=1e-15 / distance)


@pytest.mark.parametrize("name", ALL)
def test_inside_changes_the_signs_of_v_and_the_normal_and_keeps_the_surface(name):
    outer, inner = ALL[name], inside_out(ALL[name])
    u, v = sample(outer, 30)
    assert np.array_equal(inner.point(u, -v), outer.point(u, v))
    assert np.allclose(inner.normal(u, -v), -outer.normal(u, v), atol=1e-15)
    frame = inner.frame(u, -v)
    assert np.allclose(np.linalg.det(frame), 1)
    assert np.allclose(frame[..., 0], outer.frame(u, v)[..., 0], atol=1e-15)


@pytest.mark.parametrize("name", ["two sheets", "hyperbolic cylinder", "planes"])
def test_sheet_minus_one_is_the_opposite_sheet_with_its_normal_outward(name):
    upper, lower = turned_quadric(*SIGNATURES[name]), turned_quadric(*SIGNATURES[name], sheet=-1)
    u, v = np.random.default_rng(6).uniform(-2, 2, (2, 20))
    first_axis = upper.normal(0.0, 0.0)
    assert np.all(upper.point(u, v) @ first_axis > 0)
    assert np.all(lower.point(u, v) @ first_axis < 0)
    assert np.allclose(lower.normal(0.0, 0.0), -first_axis)


@pytest.mark.parametrize("name", SIGNATURES)
def test_quadric_points_satisfy_its_equation(name):
    surface = EXPLICIT[f"quadric {name}"]
    u, v = sample(surface)
    x = surface.point(u, v)
    value = np.einsum("ni,ij,nj->n", x, np.array(surface.A), x)
    assert np.max(np.abs(value - 1) / (1 + np.sum(x**2, axis=1))) < 1e-14


def test_quadrics_are_taken_for_spheres_and_cylinders_up_to_rounding_only():
    for ball in ("sphere", "ellipsoid round", "quadric round"):
        assert EXPLICIT[ball].chart.great_circles
    for flat in ("plane", "cylinder", "quadric round cylinder", "quadric planes"):
        assert EXPLICIT[flat].chart.developable
    assert EXPLICIT["quadric oblate"].periods() == (2 * pi, None)
    nearly = [Quadric(np.diag(values)) for values in ([1.0, 1.0, 1.0 + 1e-10], [1.0, 4.0, 1e-10])]
    for other in (EXPLICIT["quadric triaxial"], *nearly):
        assert not other.chart.great_circles and not other.chart.developable
    for own in (np.diag([1.0, 4.0, 9.0]), np.diag([4.0, -1.0, -2.0])):
        assert np.allclose(Quadric(own + 1e-15).point(1, 0.5), Quadric(own).point(1, 0.5))


# --- canonical coordinates


@pytest.mark.parametrize("at", [(2 * pi / 3, pi / 2), (-2 * pi / 3, -pi / 2), (pi / 6, pi / 2)])
def test_canonical_coordinates_of_the_papers_ellipsoid_contacts_are_as_given(at):
    assert Ellipsoid(0.3, 0.2, 0.1).canonical(*at) == at


@both_sides
@pytest.mark.parametrize("name", [n for n in EXPLICIT if not n.startswith("quadric")])
def test_canonical_coordinates_name_the_same_point_with_the_normal_outward(name, inside):
    surface = inside_out(EXPLICIT[name]) if inside else EXPLICIT[name]
    raw_u, raw_v = np.random.default_rng(8).uniform(-9, 9, (2, 200))
    u, v = surface.canonical(raw_u, raw_v)
    assert np.allclose(surface.point(u, v), surface.point(raw_u, raw_v), atol=2e-15)
    again = surface.canonical(u, v)
    assert np.array_equal(again[0], u) and np.array_equal(again[1], v)
    assert not any(map(np.shares_memory, again, (u, v)))  # the caller's own are not returned
    if name != "torus":  # the others are convex bodies about their origin, or a plane through it
        outward = np.einsum("ni,ni->n", surface.normal(u, v), surface.point(u, v))
        assert np.all(-outward >= 0 if inside else outward >= 0)


@pytest.mark.parametrize(
    ("surface", "at"),
    [
        (Sphere(0.1), (0.0, 0.3)),
        (Sphere(0.1), (pi, 0.3)),
        (Sphere(1e-4), (-2 * pi, 0.3)),
        (Ellipsoid(0.3, 0.2, 0.1), (0.0, pi / 2)),
        (Ellipsoid(0.3, 0.2, 0.1), (pi, -pi / 2)),
        (Ellipsoid(0.3, 0.3, 0.1), (0.4, pi / 2)),
        (Ellipsoid(0.3, 0.1, 0.1), (pi, 0.4)),
        (IMPLICIT, (0.0, 1.0)),
        (ParametricSurface(("u**2", "v", "u**3")), (0.0, 1.0)),
    ],
)
def test_poles_and_umbilics_are_refused_with_surface_place_and_remedy(surface, at):
    with pytest.raises(ChartSingularity) as caught:
        surface.canonical(*at)
    text = str(caught.value)
    assert type(surface).__name__ in text and "(u, v) = (" in text and "Move the contact" in text


@pytest.mark.parametrize("name", EXPLICIT)
def test_canonical_treats_one_point_and_an_array_of_one_alike(name):
    surface, rng = EXPLICIT[name], np.random.default_rng(11)
    w = rng.uniform(-3.2, 3.2, (400, 2))
    near = rng.choice([-1, 1], w.shape) * 10 ** rng.uniform(-16, -1, w.shape)
    w = np.where(rng.random(w.shape) < 0.5, rng.integers(-2, 3, w.shape) * pi / 2 + near, w)
    for at in w:
        u, v = at.tolist()
        try:
            expected = tuple(w[0] for w in surface.canonical([u], [v]))
        except ChartSingularity as error:
            with pytest.raises(ChartSingularity) as caught:
                surface.canonical(u, v)
            assert str(caught.value) == str(error)
        else:
            assert surface.canonical(u, v) == surface.canonical(*at) == expected
            # floats, not numpy's, even where those are given
            assert all(type(w) is float for w in surface.canonical(*at))


@pytest.mark.parametrize(
    "at", [(np.nan, 0.0), (0.0, np.inf), ("a", 0.0), ([1, 2], [1, 2, 3]), (None, 1.0)]
)
def test_coordinates_that_are_not_finite_numbers_are_refused(at):
    with pytest.raises(SurfaceError, match="coordinates"):
        Torus(0.1, 0.03).canonical(*at)
    if not isinstance(at[0], float):
        with pytest.raises(SurfaceError, match="coordinates"):
            Torus(0.1, 0.03).point(*at)


# --- continuity


def test_align_gives_the_coordinates_of_the_point_that_are_nearest_to_others():
    surface = Ellipsoid(0.3, 0.2, 0.1)
    u, v, half_turn = surface.align(-0.5, 1.5, 0.5 + 2 * pi, pi - 1.45)
    assert np.allclose([u, v], [0.5 + 2 * pi, pi - 1.5]) and half_turn
    assert np.allclose(surface.point(u, v), surface.point(-0.5, 1.5), atol=1e-15)
    turned = surface.frame(-0.5, 1.5) * [-1, -1, 1]
    assert np.allclose(surface.frame(u, v), turned, atol=1e-14)
    u, v, half_turn = Torus(0.1, 0.03).align(3.0, 0.0, -3.0, 2 * pi)
    assert np.allclose([u, v], [3.0 - 2 * pi, 2 * pi]) and not half_turn


# --- identity, shapes


@pytest.mark.parametrize("name", ALL)
def test_surfaces_are_hashable_compare_by_value_and_can_be_pickled(name):
    surface = ALL[name]
    again = pickle.loads(pickle.dumps(surface))
    assert again == surface and hash(again) == hash(surface)
    assert inside_out(surface) != surface != "surface"
    assert Sphere(0.1) != Cylinder(0.1)
    assert Sphere(0.1) == Sphere(np.float64(0.1)) != Sphere(0.2)
    assert Quadric(np.eye(3)) == Quadric([[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert np.array_equal(again.point(0.5, 0.6), surface.point(0.5, 0.6))
    assert type(surface).__name__ in repr(surface)


def test_surfaces_that_differ_print_differently():
    level, chart = "x**2 + y**2 + z**4 - r", ("cos(u)", "cos(v)", "sin(u) + sin(v)")
    given = ({}, {"center": (0.1, 0.0, 0.0)}, {"size": 2.0}, {"parameters": {"r": 2.0}})
    surfaces = {ImplicitSurface(level, **{"parameters": {"r": 1.0}} | more) for more in given}
    surfaces |= {ImplicitSurface(lambda x, k=k: x.T @ x - k) for k in (1, 2)}
    given = ({"u_range": (0, 1)}, {"v_range": (0, 1)}, {"u_period": 2 * pi}, {"v_period": 2 * pi})
    surfaces |= {ParametricSurface(chart, **more) for more in ({}, {"size": 0.1}, *given)}
    assert len(surfaces) == 12
    surfaces |= {*ALL.values()}
    assert len({repr(s) for s in surfaces}) == len(surfaces)


def test_parameters_are_changed_by_dataclasses_replace():
    wider = dataclasses.replace(PARAMETRIC, parameters={"R": 0.7})
    numbers = PARAMETRIC.named_parameters | {"R": 0.7}
    assert wider.named_parameters == numbers
    with pytest.raises(SurfaceError, match="= 'Q' is unknown; use one of R, r"):
        dataclasses.replace(PARAMETRIC, parameters={"Q": 0.7})


@pytest.mark.parametrize("name", ALL)
def test_methods_take_arrays_of_coordinates_of_any_shape(name):
    surface = ALL[name]
    u, v = np.full((4, 1), 0.5), np.linspace(0.1, 1, 3)
    shapes = {
        "point": (3,),
        "normal": (3,),
        "frame": (3, 3),
        "lame": (2,),
        "christoffel": (2, 2, 2),
        "curvature_form": (2, 2),
        "torsion_form": (2,),
        "metric_root": (2, 2),
    }
    for quantity, shape in shapes.items():
        value = getattr(surface, quantity)(u, v)
        assert value.shape == (4, 3, *shape)
        assert np.allclose(value[2, 1], getattr(surface, quantity)(0.5, v[1]), atol=1e-14)
        assert getattr(surface, quantity)(np.zeros(0), 0.0).shape == (0, *shape)
    assert surface.coordinates(surface.point(u, v))[1].shape == (4, 3)


# --- errors


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sphere(-0.1), ["Sphere", "radius = -0.1", "inside=True"]),
        (lambda: Sphere(np.nan), ["radius = nan", "finite"]),
        (lambda: Sphere("0.1"), ["radius = '0.1'", "number"]),
        (lambda: Sphere(True), ["radius = True"]),
        (lambda: Sphere(0.1, inside="yes"), ["inside = 'yes'"]),
        (lambda: Torus(0.1, 0.2), ["minor = 0.2", "major = 0.1"]),
        (lambda: Ellipsoid(0.1, 0.2, 0.3), ["a >= b >= c", "Ellipsoid(0.3, 0.2, 0.1)"]),
        (
            lambda: Ellipsoid(0.1, 0.1, 9e-8),
            ["9e-08 m", "less than 1e-06 of the greatest", "Plane"],
        ),
        (lambda: Quadric(np.diag([1, 1, 2e12])), ["less than 1e-06 of the greatest", "thicker"]),
        (lambda: Sphere(1e-160), ["Sphere: radius = 1e-160 m", "above 1e-150 m"]),
        (lambda: Sphere(0.1).coordinates([0.1j, 0, 0]), ["Sphere(0.1): points", "numbers"]),
        (lambda: Quadric(-np.eye(3)), ["none positive"]),
        (lambda: Quadric(np.eye(2)), ["(2, 2)"]),
        (lambda: Quadric([[1, 2, 0], [0, 1, 0], [0, 0, 1]]), ["symmetric", "(A + A.T)/2"]),
        (lambda: Quadric(np.diag([1, np.nan, 1])), ["finite"]),
        (lambda: Quadric("A"), ["'A'", "numbers in a 3 by 3 matrix"]),
        (lambda: Quadric(np.eye(3), sheet=-1), ["sheet = -1", "one piece"]),
        (lambda: Sphere(1).coordinates([1.0, 2.0]), ["last axis"]),
        (lambda: Sphere(1).coordinates([1.0, 2.0, np.nan]), ["finite"]),
    ],
)
def test_errors_name_the_argument_the_value_and_the_remedy(make, words):
    with pytest.raises(SurfaceError) as caught:
        make()
    assert all(word in str(caught.value) for word in words), str(caught.value)
