"""Geodesics between two points: they end there and are the shortest; what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import TURN, turned_quadric
from oracles.load import load, surface_of
from scipy.special import ellipe

import contact_system as cs
from benchmarks.steering import GROUND as HILLS

ELLIPSOID, TORUS = cs.Ellipsoid(0.3, 0.2, 0.1), cs.Torus(0.3, 0.1)
BOX = cs.ImplicitSurface("fmax(fabs(x)-.2, 0)**2 + fmax(fabs(y)-.1, 0)**2 + z**2 - .01", size=0.3)
EGG = cs.ParametricSurface(("sin(u)*cos(v)", "sin(u)*sin(v)", "cos(u)*1.5"), v_period=2 * math.pi)
UMBILIC, OPPOSITE = (0.0, math.pi / 2), (math.pi, -math.pi / 2)


def pairs(surface: cs.Surface, n: int) -> np.ndarray:
    """Random (u, v), shape (2, n, 2)."""
    reach = (0.8, 0.8) if surface is HILLS else (math.pi, 1.5)
    return np.random.default_rng(5).uniform(-1, 1, (2, n, 2)) * reach


def miss(surface: cs.Surface, line: cs.Geodesic, b: np.ndarray) -> float:
    """How far from b a line ends, over the surface's size."""
    return np.linalg.norm(line.points(line.length) - b, axis=-1).max() / surface.size


@pytest.mark.parametrize(
    "surface",
    [ELLIPSOID, TORUS, HILLS, cs.Torus(0.3, 0.03), cs.Ellipsoid(1.0, 0.5, 0.15), BOX],
    ids=["ellipsoid", "torus", "chart", "slim torus", "flat ellipsoid", "rounded box"],
)
def test_geodesics_end_at_b_and_are_as_long_from_b_to_a(surface):
    a, b = pairs(surface, 20)
    there, back = cs.geodesic(surface, a, b), cs.geodesic(surface, b, a)
    assert there.length == pytest.approx(back.length, rel=1e-12, abs=1e-12 * surface.size)
    for x, y, length in zip(a, b, there.length):
        line = cs.geodesic(surface, x, y)
        assert line.length == pytest.approx(length, rel=1e-12)
        grown = max(1.0, abs(line.m12) / surface.size)  # as an error of direction grows
        assert miss(surface, line, surface.point(*y)) <= 2e-14 * grown


# How many steps of a reference its curve is certainly the shortest between the ends.
SHORTEST = {"sphere": 12, "cylinder": 12, "torus": 1, "ellipsoid": 2, "spheroid": 8}


@pytest.mark.parametrize(("name", "steps"), SHORTEST.items())
def test_lengths_agree_with_references_of_30_digits(name, steps):
    given = load("geodesics")["geodesics"][name]
    x, t = given["points"], given["times"]
    line = cs.geodesic(surface_of(given["object"]), x[:-steps], x[steps:])
    assert line.length == pytest.approx(t[steps:] - t[:-steps], rel=1e-12)


@pytest.mark.parametrize("f", [1 / 298.257223563, 0.01, -0.01])
def test_ellipsoids_of_revolution_agree_with_geographiclib(f):
    geographiclib = pytest.importorskip("geographiclib.geodesic")
    b, rng = 1 - f, np.random.default_rng(1)
    lat, lon = np.arcsin(rng.uniform(-1, 1, (2, 200))), rng.uniform(-math.pi, math.pi, (2, 200))
    lat[1, :20] = -lat[0, :20]  # nearly antipodes
    lon[1, :20] = lon[0, :20] + math.pi * (1 - abs(f) * rng.uniform(0, 2, 20))
    lat[0, 20:22], lat[1, 20:22] = 0.5 * math.pi, -0.5 * math.pi
    beta = np.arctan(b * np.tan(lat))
    points = [np.cos(beta) * np.cos(lon), np.cos(beta) * np.sin(lon), b * np.sin(beta)]
    turned = np.stack(points if f > 0 else points[2:] + points[:2], axis=-1)
    line = cs.geodesic(cs.Ellipsoid(*((1, 1, b) if f > 0 else (b, 1, 1))), *turned)
    inverse = geographiclib.Geodesic(1.0, f).Inverse
    degrees = np.degrees([lat[0], lon[0], lat[1], lon[1]]).T.tolist()
    known = [inverse(*place, geographiclib.Geodesic.ALL) for place in degrees]
    assert line.length == pytest.approx([w["s12"] for w in known], abs=1e-12)
    # the first 22 pairs have several lines of almost one length, and either may be the one found
    for name in ("m12", "M12", "M21"):
        given = np.array([w[name] for w in known])[22:]
        assert getattr(line, name)[22:] == pytest.approx(given, abs=1e-11)


def test_a_turned_quadric_has_the_geodesics_of_its_ellipsoid():
    needle = cs.Ellipsoid(0.1, 0.00845, 0.0021)
    along = np.array([[-0.4333, -0.0517], [-3.0774, 0.0018]])
    for body, (a, b) in (ELLIPSOID, pairs(ELLIPSOID, 30)), (needle, along):
        known = cs.geodesic(body, a, b).length
        a, b = (body.point(*w.T) @ TURN.T for w in (a, b))
        line = cs.geodesic(turned_quadric(body.a**-2, body.b**-2, body.c**-2), a, b)
        assert line.length == pytest.approx(known, rel=1e-12)


def test_a_chart_of_a_slim_torus_has_the_geodesics_of_the_torus():
    slim, way = cs.Torus(0.3, 0.01), "(.3 + .01*cos(v))"
    chart = cs.ParametricSurface((f"{way}*cos(u)", f"{way}*sin(u)", ".01*sin(v)"), size=0.31)
    known, line = (cs.geodesic(body, *pairs(slim, 5)) for body in (slim, chart))
    assert line.length == pytest.approx(known.length, rel=1e-12)


def test_geodesics_on_sphere_plane_and_cylinder_have_their_closed_forms():
    a, b = pairs(ELLIPSOID, 30)
    ball = cs.Sphere(0.1)
    line = cs.geodesic(ball, *(np.abs(w) for w in (a, b)))
    x, y = (ball.point(*np.abs(w).T) for w in (a, b))
    angle = np.arctan2(np.linalg.norm(np.cross(x, y), axis=1), np.einsum("ij,ij->i", x, y))
    assert line.length == pytest.approx(0.1 * angle, abs=1e-13)
    assert line.m12 == pytest.approx(0.1 * np.sin(angle), abs=1e-13)
    assert line.M12 == pytest.approx(np.cos(angle), abs=1e-12)
    assert line.M21 == pytest.approx(np.cos(angle), abs=1e-12)
    ways = cs.geodesics(ball, np.abs(a[0]), np.abs(b[0]), 9)  # at most two turns more
    known = math.pi * np.array([0, 2, 2, 4, 4]) + angle[0] * np.array([1, -1, 1, -1, 1])
    assert [w.length for w in ways] == pytest.approx(0.1 * known, abs=1e-12)
    plane = cs.geodesic(cs.Plane(), a, b)
    assert plane.length == pytest.approx(np.hypot(*(b - a).T), rel=1e-15)
    assert plane.direction == pytest.approx(np.arctan2(*(b - a).T[::-1]), rel=1e-15)
    ways = cs.geodesics(cs.Cylinder(0.1), (3.0, 0.0), (-3.0, 0.2), 3)
    turns = 2 * math.pi - 6.0, -6.0, 4 * math.pi - 6.0
    assert [w.length for w in ways] == pytest.approx([math.hypot(0.1 * t, 0.2) for t in turns])
    assert [w.m12 for w in ways] == pytest.approx([w.length for w in ways])


def test_geodesics_begin_and_end_at_umbilics_poles_and_antipodes():
    line = cs.geodesic(ELLIPSOID, UMBILIC, OPPOSITE)
    half = 0.6 * ellipe(1 - (0.1 / 0.3) ** 2)  # half the ellipse through all umbilics
    assert line.length == pytest.approx(half, rel=1e-12)
    assert math.isnan(line.direction) and abs(line.m12) <= 1e-12
    ball = cs.Sphere(0.1)
    line = cs.geodesic(ball, (0, 0, 0.1), (0, 0, -0.1))
    assert line.length == pytest.approx(0.1 * math.pi, abs=1e-13)
    assert miss(ball, line, np.array([0, 0, -0.1])) <= 1e-12
    assert abs(line.tangent @ line.tangent - 1) <= 1e-14
    seam = cs.geodesic(ELLIPSOID, (1.0, math.pi / 2 - 0.1), (-1.0, math.pi / 2 - 0.1))
    assert seam.length < 0.2
    ways = cs.geodesics(TORUS, (0.0, 0.0), (math.pi, 0.0), 6)
    assert len(ways) == 6 and all(x.length <= y.length + 1e-12 for x, y in zip(ways, ways[1:]))
    for way in ways:
        assert miss(TORUS, way, TORUS.point(math.pi, 0.0)) <= 1e-12


def test_the_first_of_several_geodesics_is_the_shortest():
    # through poles; on the egg other lines come to a pole too, and cannot be followed
    ball = cs.ParametricSurface(("cos(u)*cos(v)", "-cos(u)*sin(v)", "sin(u)"))
    for surface, apart in (ELLIPSOID, 1e-6), (TORUS, 1e-4), (EGG, math.pi), (ball, math.pi):
        ends = surface, (1.0, 0.2), (1.0, 0.2 + apart)
        assert cs.geodesics(*ends, 3)[0].length == pytest.approx(cs.geodesic(*ends).length, 1e-9)


def test_two_geodesics_of_almost_one_length_beside_a_caustic_are_both_found():
    cube = cs.ImplicitSurface("x**4 + y**4 + z**4 - 1")
    ends = (2.68596, 0.23846), (1.4668, 0.76518)
    there, back = (cs.geodesics(cube, *way, 5) for way in (ends, ends[::-1]))
    assert [x.length for x in there] == pytest.approx([x.length for x in back], abs=1e-9)
    assert there[3].m12 * there[4].m12 < 0 < there[4].length - there[3].length < 1e-4


def test_a_leg_of_a_geodesics_direction_and_length_ends_where_it_does():
    a, b = (1.0, 0.2), (2.0, 1.0)
    line = cs.geodesic(ELLIPSOID, a, b)
    leg = cs.Leg(-line.direction, line.length, 1.0)  # the bodies' y axes are opposite at psi = 0
    contact = cs.Contact(cs.Sphere(0.04), object_at=a, finger_velocity=(1, 0), legs=[leg])
    scene = cs.Scene(object=ELLIPSOID, contacts=[contact], duration=1.0, profile=cs.Profile([0.1]))
    end = cs.plan(scene, 1e-14).points(1.0)[0, 0, 1]
    assert end == pytest.approx(ELLIPSOID.point(*b), abs=1e-12 * ELLIPSOID.size)


def test_geodesics_more_than_once_around_a_waist_end_at_b():
    waist, b = cs.Quadric(np.diag([1.0, 1.0, -1.0])), (-1.0, 0.0, 0.0)
    for k, line in enumerate(cs.geodesics(waist, (1.0, 0.0, 0.0), b, 4)):
        assert line.length == pytest.approx((math.pi, 3 * math.pi)[k > 1], abs=1e-11)
        assert line.points(line.length) == pytest.approx(np.array(b), abs=1e-11)


@pytest.mark.parametrize(
    "slim, a, b, parts",
    [
        (cs.Quadric(np.diag([1.0, 2.0, -30.0])), (0.39, -0.53), (-2.62, 0.25), 1e4),
        (cs.Torus(1.0, 0.02), (-1.38, 1.377), (1.88, 1.895), 1e7),
        (cs.Torus(1.0, 0.99), (1.97, -3.115), (0.595, -1.624), 4.0),
    ],
)
def test_the_shortest_line_is_found_where_neighbouring_lines_diverge_fast(slim, a, b, parts):
    there, back = cs.geodesic(slim, a, b), cs.geodesic(slim, b, a)
    assert there.length == pytest.approx(back.length, rel=1e-12)
    assert there.m12 > parts * slim.size
    way = (2.48, -2.98)  # over another point the way is longer
    assert there.length <= cs.geodesic(slim, [a, way], [way, b]).length.sum()


def test_lines_over_the_rim_of_a_disc_and_along_a_needle_are_the_shortest_both_ways():
    places = np.array([(0.7, -0.3), (3.0, 1.3)])
    x, y = np.cos(places[:, 1]) * np.exp(1j * places[:, 0])
    rim = np.exp(1j * np.linspace(0.0, 2 * math.pi, 10000))
    shortest = np.min(np.abs(x - rim) + np.abs(rim - y))
    line = cs.geodesic(cs.Ellipsoid(1.0, 1.0, 1e-3), *places)
    assert line.length == pytest.approx(shortest, abs=1e-3)
    disk = cs.Ellipsoid(0.1, 0.07, 0.0003)
    ends = [disk.coordinates(x) for x in ([0.0533, -0.0011, -0.0003], [-0.0696, -0.0502, 7e-6])]
    needle, tips = cs.Ellipsoid(0.1, 0.0084, 0.0021), ((-0.433, -0.052), (-3.077, 0.002))
    for body, (a, b), bound in (disk, ends, 0.14), (needle, tips, 0.19075):
        there, back = cs.geodesic(body, a, b).length, cs.geodesic(body, b, a).length
        assert there == pytest.approx(back, rel=1e-9) and there < bound


def test_geodesics_of_arrays_of_points_have_their_broadcast_shape():
    a, b = np.array([[[1.0, 0.2]], [[0.5, 0.3]]]), np.array([(2.0, 1.0), (1.5, 0.9), (2.5, 0.1)])
    lines = cs.geodesic(ELLIPSOID, a, b)
    assert lines.length.shape == lines.direction.shape == lines.m12.shape == (2, 3)
    assert lines.tangent.shape == (2, 3, 3)
    assert np.array_equal(cs.geodesic(ELLIPSOID, b[:, None], b).length == 0, np.eye(3))
    points = lines.points([[0.0, 0.1]])
    assert points.shape == (1, 2, 2, 3, 3)
    assert points[0, 0, 1, 2] == pytest.approx(ELLIPSOID.point(0.5, 0.3), abs=1e-15)
    alone = cs.geodesic(ELLIPSOID, a[0, 0], b[0])
    assert alone.points(0.1) == pytest.approx(points[0, 1, 0, 0])
    assert np.array_equal(alone.points([0.1, 9.0])[0], alone.points(0.1))  # has steps of its own


SHEETS = cs.Quadric(np.diag([1.0, -1.0, -1.0]))


@pytest.mark.parametrize(
    "surface, a, b, says",
    [
        (ELLIPSOID, (math.nan, 0.3), (1.0, 0.3), "a = .* finite"),
        (ELLIPSOID, (1.0, 0.3), (0.2, 0.2, 0.2), "b = .* is not on the surface"),
        (ELLIPSOID, np.ones((2, 2)), np.zeros((3, 2)), r"shapes \(2,\) and \(3,\)"),
        (3, (1.0, 0.3), (1.0, 0.3), "give a Surface"),
        (SHEETS, (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), "no geodesic of less than"),
        (SHEETS, (0.5, 0.1), (0.4, 1e90), r"e\+90 m apart, .* nearer points"),
        (EGG, (0.0, 0.0), (1.0, 0.0), "no contact frame at a or b"),
        (EGG, (2.0, 0.0), (2.4, math.pi), "too close to an edge or a pole"),
    ],
)
def test_points_that_no_geodesic_can_join_are_refused(surface, a, b, says):
    with pytest.raises(cs.SurfaceError, match=says):
        cs.geodesic(surface, a, b)


def test_wrong_counts_pairs_and_lengths_of_geodesics_are_refused():
    with pytest.raises(cs.SurfaceError, match="most = 0"):
        cs.geodesics(ELLIPSOID, (1, 1), (2, 1), 0)
    with pytest.raises(cs.SurfaceError, match="the same point"):
        cs.geodesics(ELLIPSOID, (1, 1), (1, 1), 2)
    with pytest.raises(cs.SurfaceError, match="one pair"):
        cs.geodesics(ELLIPSOID, [(1, 1), (1, 2)], (2, 1), 2)
    with pytest.raises(cs.SurfaceError, match="lengths in m"):
        cs.geodesic(ELLIPSOID, (1, 1), (2, 1)).points("far")
    cap = cs.ParametricSurface(("u", "v", "sqrt(1 - u**2 - v**2)"), u_range=(-1, 1))
    for surface, s in (cap, 3.0), (ELLIPSOID, 1e90), (HILLS, 1e90):
        with pytest.raises(cs.SurfaceError, match="too long, or comes to an edge"):
            cs.geodesic(surface, (0.1, 0.2), (0.3, 0.2)).points(s)


def test_a_search_that_is_too_long_is_refused(monkeypatch):
    monkeypatch.setattr(cs.limits, "STRIPS", 100)
    with pytest.raises(cs.SurfaceError, match="0.3, 0.2, 0.005.*limits.STRIPS higher"):
        cs.geodesic(cs.Ellipsoid(0.3, 0.2, 0.005), (0.4, 0.3), (2.5, -2.6))
