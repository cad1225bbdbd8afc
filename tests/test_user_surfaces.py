"""Surfaces that users write: charts and level functions, in Python and as text."""

from __future__ import annotations

import math
import random
from math import pi

import casadi as ca
import numpy as np
import pytest
from conftest import one_contact, run_python

import contact_system as cs
from contact_system import ContactSystemError, ImplicitSurface, ParametricSurface, SurfaceError

TORUS = ("(R + r*cos(v))*cos(u)", "(R + r*cos(v))*sin(u)", "r*sin(v)")
RADII = {"R": 0.1, "r": 0.03}
PARAMETRIC = ParametricSurface(TORUS, parameters=RADII, size=0.13)


# --- functions of Python


def by_numpy(u, v):
    rho = 0.1 + 0.03 * np.cos(v)
    return [rho * np.cos(u), rho * np.sin(u), 0.03 * np.sin(v)]


def by_casadi(u, v):
    rho = 0.1 + 0.03 * ca.cos(v)
    return ca.vertcat(rho * ca.vertcat(ca.cos(u), ca.sin(u)), 0.03 * ca.sin(v))


@pytest.mark.parametrize(
    "chart", [by_numpy, lambda u, v: np.array(by_numpy(u, v)), by_casadi], ids=range(3)
)
def test_chart_may_be_plain_numpy_or_casadi(chart):
    surface, truth = ParametricSurface(chart, size=0.13), cs.Torus(0.1, 0.03)
    assert np.allclose(surface.point(0.4, 0.7), truth.point(0.4, 0.7), atol=1e-17)
    assert np.allclose(surface.christoffel(0.4, 0.7), truth.christoffel(0.4, 0.7), atol=1e-15)


@pytest.mark.parametrize(
    "level",
    [
        "x**2 + y**2 + z**2 - 0.01",
        lambda x: x[0] ** 2 + x[1] ** 2 + x[2] ** 2 - 0.01,
        lambda x: np.dot(x, x) - 0.01,
        lambda x: x.T @ np.eye(3) @ x - 0.01,
        lambda x: [ca.norm_2(x) - 0.1],
        "1e200*(x**2 + y**2 + z**2 - 0.01)",  # |grad F|^2 is above the greatest double
    ],
)
def test_a_sphere_by_its_level_function_is_the_sphere(level):
    surface, truth = ImplicitSurface(level, size=0.1), cs.Sphere(0.1)
    path, known = (cs.plan(one_contact(shape)).points([0.0, 1.0]) for shape in (surface, truth))
    assert np.allclose(path, known, rtol=0, atol=1e-13)
    for quantity in ("point", "frame", "lame", "christoffel", "curvature_form", "torsion_form"):
        value = getattr(surface, quantity)(0.8, -2.0)
        assert np.allclose(value, getattr(truth, quantity)(0.8, -2.0), rtol=1e-13, atol=1e-13)


def test_named_parameters_reach_a_function_by_name():
    surface = ParametricSurface(lambda u, v, k: [u, v, k * u * v], parameters={"k": 3.0})
    assert np.allclose(surface.point(2.0, 0.5), [2.0, 0.5, 3.0])
    assert surface.f is None and surface.named_parameters == {"k": 3.0}
    assert PARAMETRIC.f == TORUS and PARAMETRIC.parameters == (0.1, 0.03)
    assert ImplicitSurface("x**2 + y**4 + z**2 - 1").F == "x**2 + y**4 + z**2 - 1"


ONE = "exp log sqrt sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh log1p expm1 fabs"
ONE += " sign floor ceil"
TWO = {
    "divide": (lambda x, y: x / y,) * 2,
    "power": (lambda x, y: ca.fabs(x) ** y, lambda x, y: np.abs(x) ** y),
    "whole powers": (
        lambda x, y: x**2 + y**-3 + 1 / x + ca.fabs(y) ** 1.7,
        lambda x, y: x**2 + y**-3.0 + 1 / x + np.abs(y) ** 1.7,
    ),
    "sums of products": (lambda x, y: x * y + x * x - 3 * y + (y - x * y) * (x * y - 2),) * 2,
    "inverses": (lambda x, y: x / y + 2 / y + 1 / (1 + x * x) - x * (1 / (y * y + 2)),) * 2,
    "less": (lambda x, y: x < y, lambda x, y: 1.0 * (x < y)),
    "less or equal": (lambda x, y: x <= y, lambda x, y: 1.0 * (x <= y)),
    "equal": (lambda x, y: ca.eq(ca.sign(x), ca.sign(y)), lambda x, y: 1.0 * (x * y > 0)),
    "not equal": (lambda x, y: ca.ne(ca.sign(x), ca.sign(y)), lambda x, y: 1.0 * (x * y < 0)),
    "and": (lambda x, y: ca.logic_and(x > 0, y > 0), lambda x, y: 1.0 * ((x > 0) & (y > 0))),
    "or": (lambda x, y: ca.logic_or(x > 0, y > 0), lambda x, y: 1.0 * ((x > 0) | (y > 0))),
    "not": (lambda x, y: ca.logic_not(x > y), lambda x, y: 1.0 * (x <= y)),
    "if else": (lambda x, y: ca.if_else(x > y, x, 3 * y), lambda x, y: np.where(x > y, x, 3 * y)),
}
for _name in ("atan2", "hypot", "fmin", "fmax", "copysign", "fmod"):
    TWO[_name] = getattr(ca, _name), getattr(np, _name)


@pytest.mark.parametrize("name", ONE.split())
def test_functions_of_one_number_agree_with_numpys(name):
    numpy_name = "arc" + name[1:] if name[0] == "a" else name
    x = np.random.default_rng(0).uniform(-3, 3, 100)
    with np.errstate(all="ignore"):
        expected = getattr(np, numpy_name)(x)
    surface = ParametricSurface(lambda u, v: [u, v, getattr(ca, name)(u)])
    known = np.isfinite(expected)
    found = surface.point(x[known], 0.3)[:, 2]
    assert known.sum() > 20 and found == pytest.approx(expected[known], rel=2e-15, abs=1e-15)


@pytest.mark.parametrize("name", TWO)
def test_functions_of_two_numbers_agree_with_numpys(name):
    of_symbols, of_numbers = TWO[name]
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0.2, 2, (2, 50)) * rng.choice([-1, 1], (2, 50))
    chart = lambda u, v, k: [u, v, of_symbols(u, v) + of_symbols(u, k)]  # noqa: E731
    surface = ParametricSurface(chart, parameters={"k": 0.7})
    truth = of_numbers(x, y) + of_numbers(x, 0.7 + 0 * x)
    assert surface.point(x, y)[:, 2] == pytest.approx(truth, rel=4e-15, abs=2e-15)


def test_an_operation_that_the_engine_lacks_is_named_with_what_to_write_instead():
    bell = ParametricSurface(lambda u, v: [u, v, ca.erf(u)])
    words = "operation OP_ERF of CasADi has no .*write the surface with"
    with pytest.raises(ContactSystemError, match=words):
        cs.plan(one_contact(bell)).points([0.0, 1.0])


# --- coordinates


def test_coordinates_of_an_implicit_surface_are_angles_about_its_center():
    level, center = "x**2/0.09 + y**2/0.04 + z**2/0.01 - 1", (0.05, 0.02, 0.01)
    surface = ImplicitSurface(level, center=center, size=0.3)
    u, v = surface.canonical(*np.random.default_rng(5).uniform(-3, 3, (2, 200)))
    x = surface.point(u, v)
    assert np.max(np.abs(np.sum((x / [0.3, 0.2, 0.1]) ** 2, axis=1) - 1)) < 2e-15
    ray = x - surface.center
    assert np.allclose(np.arctan2(ray[:, 1], ray[:, 0]), v, atol=1e-14)
    assert np.allclose(np.arccos(ray[:, 2] / np.linalg.norm(ray, axis=1)), u, atol=1e-13)


def test_coordinates_of_a_periodic_chart_lie_in_its_range():
    whole = {"u_range": (0, 2 * pi), "u_period": 2 * pi}
    surface = ParametricSurface(TORUS, parameters=RADII, size=0.13, **whole)
    assert np.isclose(surface.coordinates(surface.point(-0.5, 0.2))[0], 2 * pi - 0.5)
    assert np.isclose(surface.canonical(-0.5, 0.2)[0], 2 * pi - 0.5)


def test_coordinates_of_a_point_off_a_parametric_surface_are_refused():
    with pytest.raises(SurfaceError, match="nearest miss.*u_range"):
        PARAMETRIC.coordinates([[0.13, 0.0, 0.0], [0.0, 0.0, 1.0]])


def test_nearest_points_of_a_parametric_surface_are_found_from_any_distance():
    u, v = np.meshgrid(np.linspace(-3, 3, 7), np.linspace(-1.2, 1.2, 5))
    for far in (0.0, 0.01, 1.0, 100.0):
        *place, _ = PARAMETRIC.nearest(PARAMETRIC.point(u, v) + far * PARAMETRIC.normal(u, v))
        assert np.allclose(place, (u, v), atol=1e-6)


# --- formulas as text: what they mean, and that anything else is refused


def value(text: str, **numbers: float) -> float:
    """The value of a formula at (u, v) = (0.3, 0.4), as the height of a surface over a plane."""
    return float(ParametricSurface(("u", "v", text), parameters=numbers).point(0.3, 0.4)[2])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-2*pi/3", -2 * math.pi / 3),
        (" 1e-3 + .5 ", 1e-3 + 0.5),
        ("2**-0.5", 2**-0.5),
        ("-2**2", -4.0),
        ("2**3**2", 512.0),
        ("(1 + 2)*3 - +4", 5.0),
        ("hypot(3, 4) + e", 5.0 + math.e),
        ("atan2(1, -1)", 3 * math.pi / 4),
        ("fmin(2, 3)*fmax(2, 3) + sign(-2) + copysign(3, -0.5)", 2.0),
        ("abs(-3) + fabs(-4)", 7.0),
        ("\n  1\n  + 2*3\r\n- hypot(3,\n4)\n", 2.0),
        ("1 + 2  # a remark", 3.0),
        ("u + 2*v", 1.1),
    ],
)
def test_formulas_mean_what_they_mean_in_python(text, expected):
    assert value(text) == pytest.approx(expected, rel=1e-15)


def test_names_take_precedence_over_constants():
    assert value("e*2 + µ", **{"e": 3.0, "µ": 1.0}) == 7.0  # a micro sign, as keyboards have it


@pytest.mark.parametrize(
    "name", "sqrt sin cos tan asin acos atan atan2 exp log sinh cosh tanh hypot pow".split()
)
def test_functions_in_formulas_are_those_of_the_math_module(name):
    numbers = (0.3, 0.7)[: 2 if name in ("atan2", "hypot", "pow") else 1]
    expected = pytest.approx(getattr(math, name)(*numbers), rel=4e-16)
    given = dict(zip("ab", numbers))
    assert value(f"{name}({', '.join(map(str, numbers))})") == expected
    assert value(f"{name}({', '.join(given)})", **given) == expected


def test_arithmetic_in_scene_files_gives_pythons_result_to_the_last_bit(tmp_path):
    texts, numbers = ["0.483**3", "pi/6"], random.Random(1)
    for _ in range(100):
        a, b = round(numbers.uniform(0.1, 9), 3), numbers.randint(2, 19)
        texts += [f"{a}**{b % 4}", f"{a}*pi/{b}", f"{b}**-1 - {a}", f"-{a}**0.5 * sqrt({b})"]
    cs.save_scene(one_contact("plane", "plane"), tmp_path / "scene.toml")
    whole = (tmp_path / "scene.toml").read_text()
    contact = '[[contacts]]\nfinger = { surface = "plane" }\nobject_at = [0, 0]\nfinger_at = [0, 0]'
    more = "\n".join(f'{contact}\nangle = "{text}"\n' for text in texts)
    (tmp_path / "scene.toml").write_text(f"{whole}\n{more}")
    _, *contacts = cs.load_scene(tmp_path / "scene.toml").contacts
    for text, contact in zip(texts, contacts, strict=True):
        assert contact.angle == eval(text, {"pi": math.pi, "sqrt": math.sqrt}), text


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("0/0", 1, "division by zero"),
        ("2 + 1/0*u", 5, "division by zero"),
        ("u*sqrt(-1)", 3, "domain"),
        ("(-8)**(1/3)", 1, "domain"),
        ("9**9**9", 1, "range"),
        ("2*1e308*1e308", 1, "too large"),
        ("u**1e9", 1, "the power 1e.09 is beyond"),
        ("1 + u^2", 1, r"not a power here; write \*\*"),
        ("  R + r*cso(v)", 9, "did you mean 'cos'"),
        ("2 * ( raduis )", 7, "did you mean 'radius"),
    ],
)
def test_mistakes_in_formulas_are_refused_by_column(text, column, words):
    numbers = {"R": 1.0, "r": 0.1, "radius": 2.0}
    with pytest.raises(ContactSystemError, match=f"column {column}: .*{words}"):
        value(text, **numbers)


@pytest.mark.parametrize("power", [10, 1000, 60000])
def test_points_of_a_level_function_of_high_power_are_exact_at_its_sharp_edges(power):
    surface, at = ImplicitSurface(f"x**{power} + y**4 + z**4 - 1"), np.mgrid[0.1:3:9j, -3:3:9j]
    x = surface.point(*at)
    steps = 10 * np.finfo(float).eps * np.array([power, 4, 4])
    assert (np.abs((x ** [power, 4, 4]).sum(-1) - 1) < steps.max()).all()
    for place, point in zip(at.reshape(2, -1).T, x.reshape(-1, 3)):
        assert np.array_equal(surface.point(*place), point)  # alone, to the last bit


UNKNOWN = """__import__('os').system('true') | ().__class__ | u.real | [1, 2] | (1, 2) | lambda: 1
    1 if 2 else 3 | u < 1 | u and 1 | not u | ~u | u // 2 | u % 2 | u @ u | f'{u}' | 'text' | True
    None | 1j | ... | (u := 3) | sin(x=1) | sin(*u) | sin() | atan2(1) | eval(1) | sin | 1e999
    2 3 | sin( | x = 2 | import os | \0""".replace("\n    ", " | ").split(" | ")
LONG = ["(" * 3000 + "1" + ")" * 3000, "-" * 9000 + "1", "1+" * 6000 + "1", "9" * 400, ""]


@pytest.mark.parametrize("text", UNKNOWN + LONG, ids=lambda text: text[:20] or "empty")
def test_texts_that_are_not_arithmetic_are_refused(text):
    with pytest.raises(ContactSystemError, match="formula"):
        value(text)


AT_ONCE = """
import dataclasses, sys
from concurrent.futures import ThreadPoolExecutor
import contact_system as cs

waves = cs.ParametricSurface(("u", "v", "cos(u)*sin(v)"))
finger = cs.Contact(cs.Sphere(0.04), (0, 0))

def make(k):
    f = (f"u*{k}.5", f"v + {k}/7", f"0.05*sin({k}.25*u)*cos(v*{k})")
    return cs.ParametricSurface(f).normal(0.1, 0.2)

def read(k):
    return cs.load_scene("K4" if k % 2 else "chart").contacts

def planned(scene):
    return cs.plan(scene).points(1.0).tolist()

sys.setswitchinterval(1e-6)
with ThreadPoolExecutor(8) as executor:
    list(executor.map(read, range(100)))
    list(executor.map(make, range(100)))
    for k in range(500):
        surface = dataclasses.replace(waves, size=1 + 1e-9 * k)
        scene = cs.Scene(object=surface, contacts=[finger], profile=cs.Profile([0.1]), duration=1.0)
        first, *others = executor.map(planned, 8 * [scene])
        assert others == 7 * [first]
"""


def test_many_threads_may_read_formulas_and_plan_with_them_at_once():
    """In a process of its own, which crashed where two threads at once made the same constant of
    CasADi, or the tables of the same surface."""
    run_python("-c", AT_ONCE)


# --- errors


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ParametricSurface(("u", "v")), ["3 text(s)"]),
        (lambda: ParametricSurface(("u", "v", "cso(u)")), ["did you mean 'cos'"]),
        (lambda: ParametricSurface(("u", "u", "u")), ["does not depend on v"]),
        (lambda: ParametricSurface(lambda u, v: [u, v]), ["2 component", "3"]),
        (lambda: ParametricSurface(lambda u, v: [u, v, __import__("math").cos(u)]), ["np.cos"]),
        (lambda: ParametricSurface(lambda u, v: [u, v, u if u > 0 else v]), ["no if"]),
        (lambda: ParametricSurface(lambda u, v, k: [u, v, k]), ["TypeError", "by name"]),
        (lambda: ParametricSurface(lambda u, v: [u, v, ca.SX.sym("k") * u]), ["(k)", "parameters"]),
        (lambda: ImplicitSurface(lambda x: x.T @ x - ca.SX.sym("r")), ["(r)", "parameters"]),
        (lambda: ParametricSurface(("u", "v", "u"), size=-1), ["size = -1"]),
        (lambda: ParametricSurface(("u", "v", "u"), u_range=(1, 0)), ["u_range = (1, 0)"]),
        (
            lambda: ParametricSurface(TORUS, u_period=pi, v_period=2 * pi, parameters=RADII),
            ["u_period = 3.14", "m apart", "leave u_period out"],
        ),
        (
            lambda: ParametricSurface(TORUS, u_period=2 * pi, v_period=6.2832, parameters=RADII),
            ["v_period = 6.2832", "to all digits"],
        ),
        (
            lambda: ParametricSurface(  # with points at v > 0 alone
                ("0.1*u", "v", "sqrt(v)"), u_period=2 * pi, v_range=(0.1, 1), inside=True
            ),
            ["u_period", "0.628 m apart"],
        ),
        (lambda: ParametricSurface(("u", "v", "k"), parameters={"k": np.inf}), ["'k'", "inf"]),
        (lambda: ParametricSurface(("u", "v", "u"), parameters={"ｕ": 1}), ["'ｕ'", "meaning"]),
        (lambda: ParametricSurface(("u", "v", "u"), parameters={"a b": 1}), ["'a b'"]),
        (lambda: ImplicitSurface(lambda x, y, z: x + y * z), ["'z'", "x, one column of three"]),
        (lambda: ImplicitSurface("x + q"), ["unknown name q"]),
        (lambda: ImplicitSurface("3"), ["does not depend"]),
        (lambda: ImplicitSurface(lambda x: math.sqrt(x[0]) - 1), ["not those of math"]),
        (lambda: ImplicitSurface("x", center=(0, 0)), ["center = (0, 0)", "3 numbers"]),
        (lambda: ImplicitSurface("x**2 + y**2 + z**2 + 1").point(1, 1), ["negative", "center"]),
        (lambda: ImplicitSurface("z - 1").point(2.5, 1.0), ["does not meet", "(2.5, 1.0)"]),
    ],
)
def test_errors_name_the_argument_the_value_and_the_remedy(make, words):
    with pytest.raises(SurfaceError) as caught:
        make()
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_formula_of_another_kind_of_surface_is_refused():
    ground = ParametricSurface(("u", "v", "0.1*u*v"))
    with pytest.raises(SurfaceError, match=r"another kind of surface; give one of 1 component"):
        ImplicitSurface(formula=ground.formula)
    ball = ImplicitSurface("x**2 + y**2 + z**2 - 1")
    with pytest.raises(SurfaceError, match=r"give one of 3 components in u, v"):
        ParametricSurface(formula=ball.formula)
    with pytest.raises(SurfaceError, match=r"F and formula are both given"):
        ImplicitSurface("x**2 + y**2 + 2*z**2 - 1", formula=ball.formula)
