"""Stress cases of the planner: how scenes are drawn, and the laws that judge a plan.

One maker (`draw_trial`) draws every scene, from a seeded generator here and from hypothesis in the
tests; a family fixes some of its choices on a grid. Nothing is judged by a second run of our own:

========================  =========================================================================
law                       how it is written here
========================  =========================================================================
on the surface            level functions of this module (`Quadric`, `Tube`, `Cube`, `Waves`)
speed                     |M1 q1'| = sigma |W1|,  |M2 q2'| = sigma |W - V exp(-L)|
slip                      v_rel = sigma exp(-L) V in closed form, length and angle to R_psi M1 q1'
no slip part              R_psi M1 q1' - M2 q2' = v_rel from states; material points in the twist
one branch                coordinates are the same when asked among many times, and lose no turn on
                          the way
no spin                   omega . n = 0; normals turn with the bodies (`_twist`)
frames                    pose orthonormal, contact points meet, normals oppose
geodesics                 plane, cylinder, sphere: closed form; quadrics: Joachimsthal's integral
                          (x A A x)(p A p), in which Jacobi's and Clairaut's are contained; torus:
                          Clairaut
motion, anywhere          x(b) - x(a) = int x' dt, and D(M q'/sigma)/dt = (forcing + lam v_rel)/
                          sigma with parallel transport in space, as Gauss sums over short panels
========================  =========================================================================

Bounds. A plan's tolerance bounds contact points as a part of the body's size; rounding adds
64 eps, and 8 eps for every radian that the path turns at most (arc length and coordinates carry
that many digits less after many revolutions). Call their sum e. Directions and normals lose kappa,
size times greatest curvature, and what is read from chart coordinates a factor
size / (least Lame coefficient) at a pole. Each law below states its multiple.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.polynomial import polynomial as poly
from numpy.polynomial.legendre import leggauss

import contact_system as cs

from .verdicts import Case, Family, Verdict, refusal

EPS = 2.0**-52
NODES, WEIGHTS = leggauss(10)
Array = np.ndarray


# --- where choices come from -------------------------------------------------------------------


class Draw(Protocol):
    """A source of choices: seeded here, hypothesis in the tests."""

    def pick(self, values: Sequence[Any]) -> Any:
        """One of the values."""

    def real(self, low: float, high: float) -> float:
        """A number between two."""


class Seeded:
    """Choices of a generator with a seed of integers."""

    def __init__(self, *seed: int):
        self.random = np.random.default_rng(seed)

    def pick(self, values: Sequence[Any]) -> Any:
        """One of the values."""
        return values[int(self.random.integers(len(values)))]

    def real(self, low: float, high: float) -> float:
        """A number between two."""
        return float(self.random.uniform(low, high))


# --- shapes: level functions that the package has no part in -----------------------------------


@dataclass(frozen=True)
class Quadric:
    """x A x / 2 + b . x = c / 2; x (n, 3)."""

    A: Array
    b: Array
    c: float

    def level(self, x: Array) -> Array:
        """F (n,)."""
        return 0.5 * np.einsum("ni,ij,nj->n", x, self.A, x) + x @ self.b - self.c / 2

    def slope(self, x: Array) -> Array:
        """grad F (n, 3)."""
        return x @ self.A + self.b

    def bend(self, x: Array, y: Array) -> Array:
        """(Hess F) y (n, 3)."""
        return y @ self.A

    def integral(self, x: Array, p: Array) -> tuple[Array, Array, Array]:
        """Joachimsthal's integral and how it changes with x and p, (n,) each."""
        ax, ap = self.slope(x), p @ self.A
        normal, along = np.sum(ax * ax, 1), np.sum(p * ap, 1)
        by_x = 2 * np.linalg.norm(ax @ self.A, axis=1) * abs(along)
        return normal * along, by_x, 2 * normal * np.linalg.norm(ap, axis=1)


@dataclass(frozen=True)
class Tube:
    """Torus about z: ((rho - R)^2 + z^2 - r^2) / 2 = 0."""

    R: float
    r: float

    def level(self, x: Array) -> Array:
        """F (n,)."""
        rho = np.hypot(x[:, 0], x[:, 1])
        return ((rho - self.R) ** 2 + x[:, 2] ** 2 - self.r**2) / 2

    def slope(self, x: Array) -> Array:
        """grad F (n, 3)."""
        rho = np.hypot(x[:, 0], x[:, 1])
        return x * np.stack([1 - self.R / rho, 1 - self.R / rho, np.ones(len(x))], 1)

    def bend(self, x: Array, y: Array) -> Array:
        """(Hess F) y (n, 3)."""
        rho = np.hypot(x[:, 0], x[:, 1])
        flat = x * [1.0, 1.0, 0.0]
        along = (self.R * np.sum(flat * y, 1) / rho**3)[:, None] * flat
        return y * np.stack([1 - self.R / rho, 1 - self.R / rho, np.ones(len(x))], 1) + along

    def integral(self, x: Array, p: Array) -> tuple[Array, Array, Array]:
        """Clairaut's integral rho^2 phi' and how it changes with x and p, (n,) each."""
        one = np.ones(len(x))
        return x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0], one, np.hypot(x[:, 0], x[:, 1])


@dataclass(frozen=True)
class Cube:
    """Rounded cube: sum (x/r)^4 = 1."""

    r: float

    def level(self, x: Array) -> Array:
        """F (n,)."""
        return np.sum((x / self.r) ** 4, 1) - 1

    def slope(self, x: Array) -> Array:
        """grad F (n, 3)."""
        return 4 * (x / self.r) ** 3 / self.r

    def bend(self, x: Array, y: Array) -> Array:
        """(Hess F) y (n, 3)."""
        return 12 * (x / self.r**2) ** 2 * y


@dataclass(frozen=True)
class Waves:
    """z = h cos(k (x - 0.4 y)) cos(k y)."""

    h: float
    k: float

    def _parts(self, x: Array) -> tuple[Array, ...]:
        u, v = x[:, 0] - 0.4 * x[:, 1], x[:, 1]
        return (np.cos(self.k * u), np.sin(self.k * u), np.cos(self.k * v), np.sin(self.k * v))

    def level(self, x: Array) -> Array:
        """F (n,)."""
        cu, _, cv, _ = self._parts(x)
        return x[:, 2] - self.h * cu * cv

    def slope(self, x: Array) -> Array:
        """grad F (n, 3)."""
        cu, su, cv, sv = self._parts(x)
        by_u, by_v = self.h * self.k * su * cv, self.h * self.k * cu * sv
        return np.stack([by_u, by_v - 0.4 * by_u, np.ones(len(x))], 1)

    def bend(self, x: Array, y: Array) -> Array:
        """(Hess F) y (n, 3)."""
        cu, su, cv, sv = self._parts(x)
        pure, mixed = self.h * self.k**2 * cu * cv, -self.h * self.k**2 * su * sv
        du, dv = y[:, 0] - 0.4 * y[:, 1], y[:, 1]
        by_u, by_v = pure * du + mixed * dv, mixed * du + pure * dv
        return np.stack([by_u, by_v - 0.4 * by_u, 0 * by_u], 1)


@dataclass(frozen=True)
class Body:
    """A surface, a contact on it, and what is known about it without the package.

    Attributes
    ----------
    surface : contact_system.Surface
    shape : level function with ``level``, ``slope``, ``bend`` and perhaps ``integral``
    at : (u, v)
    size : float
        m; errors are counted in it.
    kappa : float
        Size times the greatest curvature, at least 1.
    line : {"", "plane", "sphere", "cylinder"}
        Which closed form its geodesics have.
    """

    surface: cs.Surface
    shape: Any
    at: tuple[float, float]
    size: float
    kappa: float = 1.0
    line: str = ""

    @property
    def side(self) -> float:
        """-1 for a body on the other side of its surface."""
        return -1.0 if self.surface.inside else 1.0

    def normal(self, x: Array) -> tuple[Array, Array]:
        """Unit normals out of the body and |grad F|: (n, 3), (n, 1)."""
        slope = self.side * self.shape.slope(x)
        length = np.linalg.norm(slope, axis=1, keepdims=True)
        return slope / length, length

    def turning(self, x: Array, y: Array) -> Array:
        """How the normal changes along y, and -II(y, .) as a vector: (n, 3)."""
        n, length = self.normal(x)
        change = self.side * self.shape.bend(x, y) / length
        return change - n * np.sum(n * change, 1, keepdims=True)

    def geodesic(self, x: Array, p: Array, s: Array) -> Array | None:
        """Closed form of the geodesic from x along p (not unit: s is path), (n, 3), or None."""
        speed = np.linalg.norm(p)
        if self.line == "plane":
            return x + p * s[:, None]
        if self.line == "sphere":
            turn = speed * s[:, None] / self.size
            return x * np.cos(turn) + (self.size / max(float(speed), 1e-300)) * p * np.sin(turn)
        if self.line == "cylinder":
            across = np.array([-x[1], x[0], 0.0])
            turn = s[:, None] * (p @ across) / self.size**2
            flat = x * [1.0, 1.0, 0.0]
            return (
                flat * np.cos(turn) + across * np.sin(turn) + (x[2] + p[2] * s[:, None]) * [0, 0, 1]
            )
        return None


def _round(r: float) -> Quadric:
    return Quadric(np.eye(3) / r / r, np.zeros(3), 1.0)


def _ellipsoid(a: float, b: float, c: float) -> Quadric:
    return Quadric(np.diag([a**-2, b**-2, c**-2]), np.zeros(3), 1.0)


TURN = np.linalg.qr(np.array([[1.0, 0.3, -0.2], [0.1, 1.0, 0.7], [-0.6, 0.2, 1.0]]))[0]


# --- drawing bodies ----------------------------------------------------------------------------


def plane(draw: Draw, size: float, inside: bool) -> Body:
    """The plane; ``inside`` puts the body above."""
    at = (size * draw.real(-1, 1), size * draw.real(-1, 1))
    shape = Quadric(np.zeros((3, 3)), np.array([0.0, 0.0, 1.0]), 0.0)
    return Body(cs.Plane(inside=inside), shape, at, 1.0, line="plane")


def sphere(draw: Draw, size: float, inside: bool) -> Body:
    """A sphere or a spherical bowl."""
    return Body(cs.Sphere(size, inside=inside), _round(size), _polar(draw), size, line="sphere")


def cylinder(draw: Draw, size: float, inside: bool) -> Body:
    """A cylinder or a bore."""
    shape = Quadric(np.diag([size**-2, size**-2, 0.0]), np.zeros(3), 1.0)
    at = (draw.real(-3, 3), size * draw.real(-1, 1))
    return Body(cs.Cylinder(size, inside=inside), shape, at, size, line="cylinder")


def torus(draw: Draw, size: float, inside: bool) -> Body:
    """A torus, thin to nearly closed."""
    part = draw.pick([0.3, 0.01, 0.9, draw.real(0.02, 0.95)])
    major = size / (1 + part)
    r = part * major
    kappa = size * max(1 / r, 1 / (major - r))
    at = (draw.real(-3, 3), draw.real(-3, 3))
    return Body(cs.Torus(major, r, inside=inside), Tube(major, r), at, major + r, kappa)


SHAPES = ("plain", "needle", "pancake", "nearly a sphere", "nearly oblate", "nearly prolate",
          "oblate", "prolate", "equal axes", "any")  # fmt: skip


def ellipsoid(draw: Draw, size: float, inside: bool, shape: str | None = None) -> Body:
    """An ellipsoid of one of `SHAPES`."""
    near = 1 - 10 ** draw.real(-15, -6) if draw.pick([0, 1]) else 1 - 1e-12
    b, c = {
        "plain": (2 / 3, 1 / 3), "needle": (0.01, 0.009), "pancake": (0.98, 0.01),
        "nearly a sphere": (near, near * near), "nearly oblate": (near, 0.3),
        "nearly prolate": (0.3, 0.3 * near), "oblate": (1.0, draw.real(0.02, 0.9)),
        "prolate": (0.2, 0.2), "equal axes": (1.0, 1.0),
        "any": (draw.real(0.3, 1.0), draw.real(0.02, 0.3)),
    }[shape or draw.pick(SHAPES)]  # fmt: skip
    b, c = min(b * size, size), min(c * size, b * size)
    surface = cs.Ellipsoid(size, b, c, inside=inside)
    at = _polar(draw) if b in (size, c) else _jacobi(draw)
    line = "sphere" if size == b == c else ""
    return Body(surface, _ellipsoid(size, b, c), at, size, (size / c) ** 2, line)


def turned(draw: Draw, size: float, inside: bool) -> Body:
    """A quadric along no axis: ellipsoids, hyperboloids, cylinders."""
    values = draw.pick([(1, 2, 9), (1, 1.5, -0.5), (3, -1, -2), (1, 4, 0), (1, 1, 5), (1, 4, 4)])
    matrix = TURN @ np.diag(values) @ TURN.T / size**2
    matrix = (matrix + matrix.T) / 2
    surface = cs.Quadric(matrix, inside=inside)
    at = (draw.real(0.3, 1.2), draw.real(0.2, 1.2) * (size if values[2] == 0 else 1.0))
    # Open quadrics are most curved at their waist or vertex, and have size = their longest axis.
    kappa = max(1.0, surface.size * max(map(abs, values)) / size)
    return Body(surface, Quadric(matrix, np.zeros(3), 1.0), at, surface.size, kappa**2)


def chart_sphere(draw: Draw, size: float, inside: bool) -> Body:
    """A sphere by a user's stereographic chart, from its south pole."""
    # x and y stand so that f_u x f_v points out
    f = ("2*r*v/(1 + u*u + v*v)", "2*r*u/(1 + u*u + v*v)", "r*(u*u + v*v - 1)/(1 + u*u + v*v)")
    surface = cs.ParametricSurface(f, parameters={"r": size}, size=size, inside=inside)
    at = (draw.real(-1, 1), draw.real(-1, 1))
    return Body(surface, _round(size), at, size, line="sphere")


def chart_torus(draw: Draw, size: float, inside: bool) -> Body:
    """A torus by a user's chart whose lines are sheared, so not orthogonal."""
    major, r = size / 1.3, 0.3 * size / 1.3
    f = ("(R + r*cos(v))*cos(u + 0.3*v)", "(R + r*cos(v))*sin(u + 0.3*v)", "r*sin(v)")
    surface = cs.ParametricSurface(f, parameters={"R": major, "r": r}, size=size, inside=inside)
    at = (draw.real(-3, 3), draw.real(-3, 3))
    return Body(surface, Tube(major, r), at, size, size / r)


def chart_waves(draw: Draw, size: float, inside: bool) -> Body:
    """Bumpy ground by a user's chart."""
    h, k = 0.1 * size, 2.0 / size
    f = ("u + 0.4*v", "v", "h*cos(k*u)*cos(k*v)")
    surface = cs.ParametricSurface(f, parameters={"h": h, "k": k}, size=size, inside=inside)
    at = (size * draw.real(-1, 1), size * draw.real(-1, 1))
    return Body(surface, Waves(h, k), at, size, 2.0)


def implicit_ellipsoid(draw: Draw, size: float, inside: bool) -> Body:
    """An ellipsoid by a user's equation."""
    b, c = 0.7 * size, 0.4 * size
    text = "(x/a)**2 + (y/b)**2 + (z/c)**2 - 1"
    surface = cs.ImplicitSurface(
        text, parameters={"a": size, "b": b, "c": c}, size=size, inside=inside
    )
    return Body(surface, _ellipsoid(size, b, c), _polar(draw), size, (size / c) ** 2)


def implicit_cube(draw: Draw, size: float, inside: bool) -> Body:
    """A rounded cube by a user's equation."""
    text = "(x/r)**4 + (y/r)**4 + (z/r)**4 - 1"
    surface = cs.ImplicitSurface(text, parameters={"r": size}, size=size, inside=inside)
    return Body(surface, Cube(size), _polar(draw), size, 4.0)


BODIES: dict[str, Callable[[Draw, float, bool], Body]] = {
    f.__name__: f
    for f in (plane, sphere, cylinder, torus, ellipsoid, turned, chart_sphere, chart_torus,
              chart_waves, implicit_ellipsoid, implicit_cube)
}  # fmt: skip


OFTEN = [*list(BODIES)[:6] * 8, *BODIES]
"""Names to draw from; surfaces of users cost ten times as much, so they come less often."""


def _polar(draw: Draw) -> tuple[float, float]:
    return draw.real(0.1, 3.0), draw.real(-3.1, 3.1)


def _jacobi(draw: Draw) -> tuple[float, float]:
    """Coordinates off umbilics, sometimes on a seam."""
    return draw.real(0.1, 3.0), draw.pick([draw.real(-1.4, 1.4), math.pi / 2, -math.pi / 2])


# --- drawing scenes ----------------------------------------------------------------------------

PROFILES: dict[str, tuple[float, ...]] = {
    "constant": (1.0,),
    "rising": (0.2, 1.0),
    "falling": (1.0, -0.8),
    "bump": (0.1, 1.0, -1.0),
    "from 1e-12": (1e-12, 1.0),
    "from 1e-6": (1e-6, 0.0, 1.0),
    "from rest": (0.0, 1.0),
    "from rest, third order": (0.0, 0.0, 0.0, 1.0),
    "to rest": (1.0, -1.0),
    "rest to rest": (0.0, 0.0, 30.0, -60.0, 30.0),
    "zero inside": (0.25, -1.0, 1.0),
    "two zeros inside": tuple(poly.polymul(*[poly.polymul((-0.25, 1), (-0.75, 1))] * 2)),
}
"""sigma over its scale, of t over the horizon; coefficients from the lowest power."""
LAWS = ("path", "time", "guaranteed")
ETAS = tuple(10.0**k for k in range(-3, 13))
DISTURBANCES = (cs.FingerAcceleration, cs.ObjectAcceleration, cs.ObjectRateOffset)
TURNS = 40.0
"""Radians that a body which needs integration turns at most, unless a family asks for more."""


@dataclass(frozen=True)
class Trial:
    """A scene, how to plan it, and what is known about its bodies without the package."""

    scene: cs.Scene
    finger: Body
    object: Body
    tolerance: float = 1e-12
    compiled: bool | None = None
    special: tuple[float, ...] = ()
    """Times beside the drawn ones, s."""
    seed: int = 0


def draw_trial(draw: Draw, **fixed: Any) -> Trial:
    """A trial; ``fixed`` holds choices that are not to be drawn.

    Parameters
    ----------
    draw : Draw
    fixed
        finger, object (names of `BODIES`), size, ratio, shape, inside, profile, law, eta, turns,
        duration, tolerance, compiled, slip, windows, angle, pole (see `_aimed`), bowl (the object
        hollow, the finger not), most (radians that a body turns which needs integration).

    Raises
    ------
    ContactSystemError
        Where the package refuses the scene.
    """

    def choose(key: str, values: Sequence[Any]) -> Any:
        return fixed[key] if key in fixed else draw.pick(values)

    size = choose("size", [0.1, 0.1, 1.0, 10 ** draw.real(-4, 4)])
    ratio = choose("ratio", [0.4, 1.0, 10 ** draw.real(-2, 2)])
    shape = {"shape": fixed["shape"]} if "shape" in fixed else {}
    kinds = [choose(side, OFTEN) for side in ("object", "finger")]
    obj, finger = (
        BODIES[kind](draw, length,
                     own if "bowl" in fixed else choose("inside", [False, False, True]),
                     **(shape if kind == "ellipsoid" else {}))
        for kind, length, own in zip(kinds, (size, ratio * size), (True, False))
    )  # fmt: skip
    duration = choose("duration", [1.0, 1.0, 0.01, 30.0])
    turns = choose("turns", [1.0, 5.0, 10 ** draw.real(-3, 2)])
    length = turns * obj.size
    for body in (obj, finger):
        if not (body.surface.great_circles or body.surface.developable):  # it is integrated
            length = min(length, fixed.get("most", TURNS) * body.size / body.kappa)
    profile = _profile(PROFILES[choose("profile", list(PROFILES))], length, duration)
    obj, finger, contact, special = _contact(draw, fixed, obj, finger, length, duration)
    values = {
        "object": obj.surface, "contacts": [contact], "profile": profile, "duration": duration,
        "gain": cs.Gain(choose("law", LAWS), choose("eta", [*ETAS, 10 ** draw.real(-3, 12)])),
        "name": "stress",
    }  # fmt: skip
    windows = choose("windows", [0, 0, 1, 2])
    if windows:
        bodies = (finger, obj)
        values["disturbances"] = [
            _disturbance(draw, bodies, length, duration) for _ in range(windows)
        ]
    return Trial(
        cs.Scene(**values), finger, obj, choose("tolerance", [1e-12, 1e-12, 1e-9, 1e-6]),
        _compiled(draw, fixed, kinds), special, int(draw.real(0, 2**31)),
    )  # fmt: skip


COMPILED = {"plane", "sphere", "cylinder", "torus", "chart_torus", "implicit_ellipsoid"}
"""Bodies whose kernels are also compiled here: 0.2 s each, once."""


def _compiled(draw: Draw, fixed: dict, kinds: list[str]) -> bool | None:
    few = COMPILED.issuperset(kinds)
    return fixed["compiled"] if "compiled" in fixed else draw.pick([few or None, None, False])


def _profile(shape: Sequence[float], length: float, duration: float) -> cs.Profile:
    """The shape over a horizon, with this arc length in all."""
    scale = length / duration / poly.polyval(1.0, poly.polyint(shape))
    return cs.Profile([scale * c / duration**k for k, c in enumerate(shape)])


def _contact(
    draw: Draw, fixed: dict, obj: Body, finger: Body, length: float, duration: float
) -> tuple[Body, Body, cs.Contact, tuple[float, ...]]:
    """Where and how a contact starts, and special times."""
    angle = fixed["angle"] if "angle" in fixed else draw.pick([0.0, 0.3, draw.real(-3, 3)])
    heading = draw.real(-math.pi, math.pi)
    special: tuple[float, ...] = ()
    if "pole" in fixed:
        side, miss = fixed["pole"]
        body = obj if side == "object" else finger
        at, heading, arc = _aimed(draw, body, miss)
        body = Body(body.surface, body.shape, at, body.size, body.kappa, body.line)
        obj, finger = (body, finger) if side == "object" else (obj, body)
        special = tuple(duration * f for f in arc / length + np.array([0.0, -1e-9, 1e-9]))
        special = tuple(t for t in special if 0 <= t <= duration)
        if side == "object":  # R_psi is its own inverse: what the finger does to that end
            heading = -angle - heading
    given = (math.cos(heading), math.sin(heading))
    slips = fixed["slip"] if "slip" in fixed else draw.pick([0, 1, 1, 2])
    slipping = (draw.real(-1, 1), draw.real(-1, 1))
    velocity: Any = ("rolling", slipping, "rest")[slips]
    contact = cs.Contact(
        finger=finger.surface, object_at=obj.at, finger_at=finger.at, angle=angle,
        finger_velocity=given, object_velocity=velocity,
    )  # fmt: skip
    return obj, finger, contact, special


def _aimed(draw: Draw, body: Body, miss: float) -> tuple[tuple[float, float], float, float]:
    """A start, a heading in its frame that runs into a pole or umbilic but for an angle, the path.

    Polar charts: along a meridian. Jacobi's chart: along the ellipse y = 0, which holds all four
    umbilics, so the path to the first is not told (0).
    """
    if body.surface.double_cover:
        return (draw.real(0.3, 2.8), math.pi / 2), draw.pick([0.0, math.pi]) + miss, 0.0
    u = draw.real(0.2, 2.9)
    # u is a polar angle on every chart with poles here; only a sphere's meridian is so simple
    arc = u * body.size if body.line == "sphere" else 0.0
    return (u, draw.real(-3, 3)), math.pi + miss, arc


def _disturbance(
    draw: Draw, bodies: tuple[Body, Body], length: float, duration: float
) -> cs.scene.Disturbance:
    """One window, as strong as the motion itself or weaker."""
    kind = draw.pick(DISTURBANCES)
    start = draw.pick([0.0, 0.2, draw.real(0, 0.7)])
    stop = min(1.0, start + draw.pick([0.3, 1e-3, draw.real(0.01, 0.3)]))
    speed = length / duration / (1 if kind is cs.ObjectRateOffset else duration)
    body = bodies[0] if kind is cs.FingerAcceleration else bodies[1]
    strength = speed * 10 ** draw.real(-3, 0.5)
    # Where a Lame coefficient is small at the start it is greater later on.
    lame = np.maximum(np.diag(body.surface.metric_root(*body.at)), 0.3 * body.size)
    value = strength / lame * [math.cos(a := draw.real(-3, 3)), math.sin(a)]
    return kind(contact=0, start=start * duration, stop=stop * duration, value=tuple(value))


# --- judging -----------------------------------------------------------------------------------


@dataclass
class Meter:
    """Errors against their bounds; keeps the one that is worst by that measure."""

    law: str = "nothing compared"
    error: float = 0.0
    bound: float = math.inf
    compared: int = 0

    def see(self, law: str, error: Any, bound: Any) -> None:
        """Take note of errors (any shape) and their bounds (of a shape that broadcasts)."""
        error, bound = np.broadcast_arrays(np.abs(error), np.asarray(bound, dtype=float))
        if not error.size:
            return
        self.compared += 1
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = error / np.maximum(bound, 1e-300)
        k = int(np.argmax(np.where(np.isnan(ratio), np.inf, ratio)))
        if not ratio.flat[k] <= self.error / self.bound:
            self.law, self.error = law, float(error.flat[k])
            self.bound = max(float(bound.flat[k]), 1e-300)

    def verdict(self) -> Verdict:
        """Right if everything was within its bound."""
        right = self.compared > 0 and self.error <= self.bound
        return Verdict("right" if right else "silent", self.error, self.bound, self.law)


def run(trial: Trial) -> Verdict:
    """Plan a trial and judge the plan; every other compiled one after two scenes of its kind."""
    alone = not trial.compiled or trial.seed % 2 or trial.scene.disturbances
    kin = [] if alone else [trial.scene.replace() for _ in range(2)]
    *_, plan = (
        cs.plan(scene, tolerance=trial.tolerance, compiled=trial.compiled)
        for scene in (*kin, trial.scene)
    )
    return Judge(trial, plan).verdict()


def left_over(sigma: Array, gain: cs.Gain, t: Array, since: float = 0.0) -> Array:
    """|v_rel| at t (n,) over |v_rel/sigma| at ``since``: sigma exp(-L) of the gain laws, m/s."""
    if gain.law == "path":
        energy = poly.polyint(poly.polymul(sigma, sigma))
        lost = gain.value * (poly.polyval(t, energy) - poly.polyval(since, energy))
        return poly.polyval(t, sigma) * np.exp(-np.maximum(lost, 0.0))
    left = np.exp(-gain.value * (t - since))
    if gain.law == "time":
        return left * poly.polyval(t, sigma)
    # guaranteed: slip keeps its size while sigma grows and shrinks with it
    return left * _fallen(sigma, since, t)


def turning(sigma: Array, end: float) -> list[float]:
    """Times up to end where sigma turns."""
    slope = np.trim_zeros(poly.polyder(sigma), "b")
    roots = poly.polyroots(slope) if len(slope) > 1 else np.array([])
    return sorted(float(r.real) for r in roots if abs(r.imag) < 1e-6 * end and 0 < r.real < end)


def _fallen(sigma: Array, since: float, t: Array) -> Array:
    """sigma(since) times the factors by which sigma falls until t (n,)."""
    knots = np.array([since, *(k for k in turning(sigma, float(t.max())) if since < k)])
    values, now = (np.maximum(poly.polyval(at, sigma), 0.0) for at in (knots, t))
    left = [values[0]]
    for before, after in itertools.pairwise(values):
        left.append(left[-1] * (min(1.0, after / before) if before > 0 else 1.0))
    k = np.searchsorted(knots, t, side="right") - 1
    shrunk = np.minimum(now, values[k]) / np.maximum(values[k], 1e-300)
    return np.array(left)[k] * np.where(values[k] > 0, shrunk, 1.0)


@dataclass
class Sample:
    """What a plan says at some times, all of them regular.

    Attributes
    ----------
    t : (n,)
    states : (n, 9)
    x, frame, rate, force : finger's, object's
        Contact points (n, 3), frames (n, 3, 3), contact points' velocities in space (n, 3), and
        M of the chart (n, 2, 2).
    """

    t: Array
    states: Array
    x: tuple[Array, Array]
    frame: tuple[Array, Array]
    root: tuple[Array, Array]
    rate: tuple[Array, Array]

    def part(self, where: slice) -> Sample:
        """Some of the times."""
        pairs = (self.x, self.frame, self.root, self.rate)
        return Sample(self.t[where], self.states[where],
                      *((a[where], b[where]) for a, b in pairs))  # fmt: skip

    @cached_property
    def turn(self) -> Array:
        """R_psi (n, 2, 2)."""
        c, s = np.cos(self.states[:, 8]), np.sin(self.states[:, 8])
        return np.moveaxis(np.array([[c, -s], [-s, -c]]), -1, 0)

    def plane(self, k: int) -> Array:
        """M q' in the contact frame, (n, 2)."""
        return np.einsum("nij,nj->ni", self.root[k], self.states[:, 4 * k + 2 : 4 * k + 4])

    def space(self, k: int, plane: Array) -> Array:
        """Components in a contact frame as vectors in space, (n, 3)."""
        return np.einsum("nij,nj->ni", self.frame[k][:, :, :2], plane)


MANY = 700
"""Times at which a plan evaluates in its fastest way."""


class Judge:
    """Compares one plan with the laws."""

    def __init__(self, trial: Trial, plan: cs.Plan):
        self.trial, self.plan, self.scene = trial, plan, trial.scene
        self.bodies = (trial.finger, trial.object)
        self.meter, self.random = Meter(), np.random.default_rng(trial.seed)
        contact = self.scene.contacts[0]
        c, s = math.cos(contact.angle), math.sin(contact.angle)
        turn = np.array([[c, -s], [-s, -c]])
        given = contact.object_velocity
        self.w1 = np.array(contact.finger_velocity, dtype=float)
        self.w2 = turn @ self.w1
        start = {"rolling": self.w2, "rest": np.zeros(2)}
        self.v = self.w2 - (start[given] if isinstance(given, str) else np.array(given))
        self.sigma = np.array(self.scene.profile.coefficients)
        self.windows = [(d.start, d.stop) for d in self.scene.disturbances]
        self.quiet = min([a for a, _ in self.windows], default=math.inf)
        self.speed = float(self._sigma(np.linspace(0, self.scene.duration, 33)).max())
        # Terms of sigma cancel near its zeros: this is what its rounding counts in.
        self.terms = float(poly.polyval(self.scene.duration, abs(self.sigma)))
        clear = np.where(abs(self.sigma) > 1e-30 * abs(self.sigma).max(), self.sigma, 0.0)
        self.roots = poly.polyroots(np.trim_zeros(clear, "b"))
        path = poly.polyval(self.scene.duration, poly.polyint(self.sigma))
        reach = path * (np.hypot(*self.w1) + np.hypot(*self.v))
        if self.windows:  # most disturbances are no stronger than the motion
            reach = max(5 * reach, *(self._pushed(d) for d in self.scene.disturbances))
        turns = [reach * b.kappa / b.size for b in self.bodies]
        self.turns = max(turns)
        self.e = [plan.tolerance + EPS * (64 + 8 * x) for x in turns]

    def _pushed(self, window: cs.scene.Disturbance) -> float:
        """The path that a window adds at most while sigma keeps its size, m."""
        body = self.bodies[0 if isinstance(window, cs.FingerAcceleration) else 1]
        added = float(np.hypot(*window.value)) * body.size * (window.stop - window.start)
        offset = isinstance(window, cs.ObjectRateOffset)
        return added * (1.0 if offset else self.scene.duration - window.start)

    def verdict(self) -> Verdict:
        """Every law in turn."""
        if max(self.e) - self.plan.tolerance > 1e-3:
            nan = float("nan")
            return Verdict("silent", nan, nan, "planned, though no digit of a point can be known")
        times = self._times()
        everywhere = self.plan.points(times)[:, 0]
        self._on_surfaces(everywhere)
        sample, gaps = self._sample(times)
        for text in gaps:
            if (said := refusal(text)).outcome != "refused":
                return said
        if len(sample.t):
            self._states(sample)
            self._among_many(sample)
            self._pose(sample)
            self._slip(sample)
        self._geodesics(times, everywhere, sample)
        self._developed(times, everywhere)
        self._short_panel(sample)
        every = 3 if self.trial.compiled else 12  # without a compiler it takes far longer
        if self.trial.seed % every == 0 and self.turns < TURNS * math.pi:
            self._in_company(times, everywhere)
        return self.meter.verdict()

    # -- what the plan says

    def _times(self) -> Array:
        end = self.scene.duration
        drawn = self.random.uniform(0, end, 4)
        layer = 10 ** self.random.uniform(-14, 0, 2) * end
        edges = [e for w in self.windows for e in w]
        return np.unique([0.0, *drawn, *layer, *edges, *self.trial.special, end])

    def _sample(self, times: Array) -> tuple[Sample, list[str]]:
        """The plan at those of the times where states exist, and what it says about the others."""
        gaps: list[str] = []
        try:
            states = self.plan.states(times)[:, 0]
        except cs.ChartSingularity:
            kept, rows = [], []
            for t in times:
                try:
                    rows.append(self.plan.states([t])[0, 0])
                    kept.append(t)
                except cs.ChartSingularity as error:
                    gaps.append(str(error))
            times, states = np.array(kept), np.array(rows).reshape(-1, 9)
        points = self.plan.points(times)[:, 0]
        self.meter.see("finite states", np.where(np.isfinite(states), 0.0, math.inf), 1.0)
        parts: list[tuple[Array, ...]] = []
        for k, body in enumerate(self.bodies):
            q = states[:, 4 * k : 4 * k + 2].T
            frame, root = body.surface.frame(*q), body.surface.metric_root(*q)
            plane = np.einsum("nij,nj->ni", root, states[:, 4 * k + 2 : 4 * k + 4])
            rate = np.einsum("nij,nj->ni", frame[:, :, :2], plane)
            parts.append((points[:, k], frame, root, rate))
        return Sample(times, states, *zip(*parts)), gaps

    def _sigma(self, t: Array) -> Array:
        return poly.polyval(t, self.sigma)

    def _left(self, t: Array, since: float = 0.0) -> Array:
        return left_over(self.sigma, self.scene.gain, np.asarray(t, dtype=float), since)

    # -- laws

    def _chart_loss(self, sample: Sample, k: int) -> Array:
        """Rounding of what is read from chart coordinates, (n,)."""
        body, q = self.bodies[k], sample.states[:, 4 * k : 4 * k + 2]
        root = sample.root[k]
        least = np.minimum(root[:, 0, 0], root[:, 1, 1])
        # A chart in metres counts from its own origin.
        reach = 1 + np.abs(q).max(axis=1) * np.maximum(1.0, np.minimum(1.0, least / body.size))
        return 64 * EPS * reach * np.maximum(1.0, body.size / least)

    def _loss(self, sample: Sample, k: int) -> Array:
        """Bound of a unit vector's error in space as read from states, (n,)."""
        return 4 * self.bodies[k].kappa * self.e[k] + self._chart_loss(sample, k)

    def _on_surfaces(self, points: Array) -> None:
        for k, body in enumerate(self.bodies):
            x = points[:, k]
            level = body.shape.level(x)
            away = level / np.linalg.norm(body.shape.slope(x), axis=1)
            scale = body.size + np.linalg.norm(x, axis=1)
            self.meter.see(f"point {k + 1} on its surface", away, self.e[k] * scale)

    def _states(self, sample: Sample) -> None:
        """Coordinates say where the points are; rates say how fast."""
        # An edge belongs to the window that starts there.
        sigma, still = self._sigma(sample.t), sample.t < self.quiet
        for k, (body, w) in enumerate(zip(self.bodies, self._path_velocities(sample.t))):
            where = body.surface.point(*sample.states[:, 4 * k : 4 * k + 2].T)
            size = body.size + np.linalg.norm(where, axis=1)
            bound = (2 * self.e[k] + self._chart_loss(sample, k)) * size
            self.meter.see(f"f(u{k + 1}, v{k + 1}) is point {k + 1}",
                           np.linalg.norm(where - sample.x[k], axis=1), bound)  # fmt: skip
            speed = np.hypot(*sample.plane(k).T)  # which does not underflow
            bound = self._loss(sample, k) * (sigma + 1e-3 * self.terms) + 16 * EPS * self.terms
            bound *= 1 + np.hypot(*self.v)
            self.meter.see(f"speed of contact point {k + 1}", (speed - w)[still], bound[still])

    def _among_many(self, sample: Sample) -> None:
        """Coordinates do not depend on what is asked beside them, and lose no turn on the way."""
        if self.trial.seed % 3 or self.turns > TURNS:
            return
        t = np.union1d(sample.t, np.linspace(0.0, self.scene.duration, MANY))
        try:
            states = self.plan.states(t)[:, 0]
        except cs.ChartSingularity:
            return
        apart = states[np.searchsorted(t, sample.t)] - sample.states
        loss = [
            8 * (4 * self.e[k] + self._chart_loss(sample, k))[:, None]
            * body.size / np.diagonal(sample.root[k], axis1=1, axis2=2)
            for k, body in enumerate(self.bodies)
        ]  # fmt: skip
        self.meter.see("psi among many times", apart[:, 8], sum(x.max(axis=1) for x in loss))
        for k, body in enumerate(self.bodies):
            q = slice(4 * k, 4 * k + 2)
            self.meter.see(f"u{k + 1}, v{k + 1} among many times", apart[:, q], loss[k])
            for r, period in enumerate(body.surface.periods(), 4 * k):
                if period:
                    rate = abs(states[:, r + 2])
                    slow = np.maximum(rate[1:], rate[:-1]) * np.diff(t) < 0.1 * period
                    step = np.diff(states[:, r])[slow]
                    # passing a pole takes half a turn
                    self.meter.see(f"no turn of body {k + 1} lost", step, 0.75 * period)

    def _path_velocities(self, t: Array) -> tuple[Array, Array]:
        """|M1 q1'| and |M2 q2'| while nothing disturbs, m/s."""
        own = self._sigma(t) * np.hypot(*self.w1)
        difference = self._sigma(t)[:, None] * self.w2 - self._left(t)[:, None] * self.v
        return own, np.hypot(*difference.T)

    def _pose(self, sample: Sample) -> None:
        """Frames are orthonormal, points meet, normals oppose, the heading is psi."""
        pose, twist = self.plan.pose(sample.t)[:, 0], self.plan.twist(sample.t)[:, 0]
        rotation, origin = pose[:, :3, :3], pose[:, :3, 3]
        square = np.einsum("nji,njk->nik", rotation, rotation) - np.eye(3)
        self.meter.see("pose orthonormal", square, 4 * sum(self.e))
        x1, x2 = sample.x
        reach = sum(np.linalg.norm(x, axis=1) for x in (x1, x2, origin))
        met = np.einsum("nij,nj->ni", rotation, x1) + origin - x2
        self.meter.see("contact points meet", met, sum(self.e) * reach[:, None])
        n1, n2 = (b.normal(x)[0] for b, x in zip(self.bodies, sample.x))
        n1 = np.einsum("nij,nj->ni", rotation, n1)
        loss = [self._loss(sample, k) for k in (0, 1)]
        self.meter.see("normals oppose", n1 + n2, sum(loss)[:, None])
        flip = np.zeros((len(sample.t), 3, 3))
        flip[:, :2, :2], flip[:, 2, 2] = sample.turn, -1.0
        told = sample.frame[1] @ flip @ sample.frame[0].transpose(0, 2, 1)
        self.meter.see("pose against psi", rotation - told, 4 * sum(loss)[:, None, None])
        self._twist(sample, twist, pose, n2, loss)

    def _twist(self, sample: Sample, twist: Array, pose: Array, n2: Array, loss: list) -> None:
        """No spin; material points in contact move by slip alone; normals turn with the bodies."""
        omega, v = twist[:, :3], twist[:, 3:]
        # Rates of normals, and how wrong they may be: |x'| kappa / size is a body's own turning;
        # speeds are known to rounding of the greatest one.
        change = [b.turning(x, r) for b, x, r in zip(self.bodies, sample.x, sample.rate)]
        fast = sum(
            (np.linalg.norm(r, axis=1) + 1e-3 * self.terms) * b.kappa / b.size
            for b, r in zip(self.bodies, sample.rate)
        )
        bound = 8 * sum(loss) * (fast + np.linalg.norm(omega, axis=1))
        self.meter.see("no spin", np.sum(omega * n2, 1), bound)
        turned = np.cross(omega, n2) - change[1]
        turned -= np.einsum("nij,nj->ni", pose[:, :3, :3], change[0])
        self.meter.see("normals turn with the bodies", turned, bound[:, None])
        slip, arm = sample.space(1, self.plan.slip(sample.t)[:, 0]), sample.x[1] - pose[:, :3, 3]
        point = v + np.cross(omega, arm)
        reach = sum(np.linalg.norm(x, axis=1) for x in (*sample.x, pose[:, :3, 3]))
        rounding = sum(self.e) * fast * reach + loss[1] * np.linalg.norm(slip, axis=1)
        self.meter.see("twist has slip alone", point + slip, 8 * rounding[:, None])

    def _slip(self, sample: Sample) -> None:
        """The exact law, its direction, and the same from the states."""
        slip = self.plan.slip(sample.t)[:, 0]
        length, still = np.linalg.norm(slip, axis=1), sample.t < self.quiet
        law = self._left(sample.t) * np.hypot(*self.v)
        floor = 64 * EPS * self.terms * (1 + np.hypot(*self.v))
        self.meter.see("slip law", (length - law)[still], floor)
        finger, obj = sample.plane(0), sample.plane(1)
        rolled = np.einsum("nij,nj->ni", sample.turn, finger)
        scale = np.linalg.norm(finger, axis=1) + np.linalg.norm(obj, axis=1)
        bound = sum(self._loss(sample, k) for k in (0, 1)) * scale + floor
        self.meter.see("slip of states", rolled - obj - slip, bound[:, None])
        # V and W2 are carried together: slip keeps its angle to R_psi M1 q1'.
        c, s = self.w2 @ self.v, self.w2[0] * self.v[1] - self.w2[1] * self.v[0]
        carried = np.array([[c, -s], [s, c]]) @ rolled.T / (self.w2 @ self.w2)
        carried *= self._left(sample.t) / np.maximum(self._sigma(sample.t), 1e-300)
        clear = still & (self._sigma(sample.t) > 1e-9 * self.speed)
        self.meter.see("direction of slip", (slip - carried.T)[clear], bound[clear, None])
        self._later(sample)

    def _later(self, sample: Sample) -> None:
        """The law again after the last window, from what that left."""
        last = max([b for _, b in self.windows], default=math.inf)
        t = np.append(last, sample.t[sample.t > last])
        if not self.windows or last >= self.scene.duration or self._sigma(t[0]) < 1e-6 * self.speed:
            return
        speed = self.plan.slip_speed(t)[:, 0]
        law = speed[0] / self._sigma(t[0]) * self._left(t, last)
        floor = 64 * EPS * self.terms * (1 + np.hypot(*self.v))
        self.meter.see("slip law after the windows", speed - law, floor + 1e-12 * speed[0])

    def _geodesics(self, times: Array, everywhere: Array, sample: Sample) -> None:
        """Closed forms and integrals of the sides that run on geodesics."""
        kinds = [type(d) for d in self.scene.disturbances]
        free = (cs.FingerAcceleration not in kinds, not kinds and not self.v.any())
        path = poly.polyval(times, poly.polyint(self.sigma))
        for k, (body, w) in enumerate(zip(self.bodies, (self.w1, self.w2))):
            if not free[k]:
                continue
            frame, x = body.surface.frame(*body.at), body.surface.point(*body.at)
            exact = body.geodesic(x, frame[:, :2] @ w, path)
            if exact is not None:
                error = np.linalg.norm(everywhere[:, k] - exact, axis=1)
                bound = 2 * self.e[k] * (body.size + np.linalg.norm(exact, axis=1))
                self.meter.see(f"geodesic {k + 1} in closed form", error, bound)
            elif hasattr(body.shape, "integral") and len(sample.t):
                self._integral(k, body, sample, x, frame[:, :2] @ w)

    def _developed(self, times: Array, everywhere: Array) -> None:
        """On plane and cylinder W s - V g, unrolled, is the curve, however soon slip ends."""
        body = self.bodies[1]
        if body.line not in ("plane", "cylinder") or self.windows or not self.v.any():
            return
        end = self.scene.duration
        knots = [*times, *turning(self.sigma, end)]  # where the guaranteed law changes
        cells = np.union1d(knots, end * np.geomspace(1e-40, 1.0, 400))
        node, weight = np.polynomial.legendre.leggauss(24)
        half = 0.5 * np.diff(cells, prepend=0.0)
        inner = (cells - half)[:, None] + half[:, None] * node
        parts = half * (self._left(inner.ravel()).reshape(inner.shape) @ weight)
        slipped = np.cumsum(parts)[np.searchsorted(cells, times)]
        path = poly.polyval(times, poly.polyint(self.sigma))
        frame, x = body.surface.frame(*body.at)[:, :2], body.surface.point(*body.at)
        for s, g, point in zip(path, slipped, everywhere[:, 1]):
            exact = body.geodesic(x, frame @ (self.w2 * s - self.v * g), np.ones(1))
            assert exact is not None
            bound = 2 * self.e[1] * (body.size + np.linalg.norm(exact))
            self.meter.see("developed curve", np.linalg.norm(point - exact[0]), bound)

    def _integral(self, k: int, body: Body, sample: Sample, x: Array, p: Array) -> None:
        clear = self._sigma(sample.t) > 1e-9 * self.speed
        sigma = self._sigma(sample.t[clear])
        along = sample.rate[k][clear] / sigma[:, None]
        value, by_x, by_p = body.shape.integral(sample.x[k][clear], along)
        first, from_x, from_p = body.shape.integral(x[None], p[None])
        # the rate has the rounding of sigma, by which it is divided
        loss = self._loss(sample, k)[clear] + 16 * EPS * self.terms / sigma
        bound = 4 * self.e[k] * body.size * (by_x + from_x) + loss * (by_p + from_p)
        self.meter.see(f"integral of geodesic {k + 1}", value - first, bound)

    # -- the equations of motion over short panels

    def _in_company(self, times: Array, everywhere: Array) -> None:
        """The contact is where it is alone when another one is planned before it.

        Not after many turns: a tolerance bounds what one panel adds to a point's error.
        """
        contact = self.scene.contacts[0]
        other = dataclasses.replace(contact, angle=contact.angle - 0.5)
        windows = [dataclasses.replace(d, contact=1) for d in self.scene.disturbances]
        both = self.scene.replace(contacts=[other, contact], disturbances=windows)
        try:
            plan = cs.plan(both, tolerance=self.trial.tolerance, compiled=self.trial.compiled)
            points = plan.points(times)[:, 1]
        except cs.ContactSystemError:
            return  # it is the other one that runs into something
        for k, body in enumerate(self.bodies):
            away = np.linalg.norm(points[:, k] - everywhere[:, k], axis=1)
            self.meter.see("in company", away, 10 * self.e[k] * body.size)

    def _short_panel(self, sample: Sample) -> None:
        """Gauss sums over a panel from one of the times, where states exist."""
        count = len(sample.t)
        panel = self._panel(sample, int(self.random.integers(0, count))) if count else None
        if panel is None:
            return
        t, acting = panel
        inside, gaps = self._sample(t)
        if not gaps and (self._sigma(t) > 1e-9 * self.speed).all():
            self._balance(inside, 0.5 * WEIGHTS * (t[-1] - t[0]), acting)

    def _panel(self, sample: Sample, k: int) -> tuple[Array, list] | None:
        """Ends and nodes of the panel from a time of the sample, and the windows around it."""
        here, begin = sample.part(slice(k, k + 1)), float(sample.t[k])
        acting = [d for d in self.scene.disturbances if d.start <= begin < d.stop]
        edges = [e for w in self.windows for e in w] + [self.scene.duration]
        later = [e for e in edges if e > begin]
        length = min(min(later) - begin, self._resolved(here, acting)) if later else 0.0
        if length <= 1e-6 * begin or length < 1e-290:
            return None
        # An edge belongs to the interval that starts there, so the panel ends before it.
        return begin + 0.999 * length * np.array([0.0, *(0.5 * (1 + NODES)), 1.0]), acting

    def _resolved(self, here: Sample, acting: list) -> float:
        """Seconds in which nothing changes by more than a part of itself."""
        t, rates = here.t[0], [1e-300]
        sigma = float(self._sigma(t))
        fast = [float(np.linalg.norm(r)) + self.speed for r in here.rate]
        rates += [5 * f * b.kappa / b.size for f, b in zip(fast, self.bodies)]
        if sigma > 0 and not self._gone(float(self._left(here.t)[0]) / sigma):
            # what is divided by sigma, and where the guaranteed law changes
            knots = [*self.roots, *self.scene.profile.extrema(0, self.scene.duration)]
            rates += [5 / max(abs(t - x), 1e-300) for x in knots]
            rates.append(self._stiffness(t, 1 / max(rates)))
        for d in acting:
            body = self.bodies[0 if isinstance(d, cs.FingerAcceleration) else 1]
            rates.append(5 * math.sqrt(float(np.hypot(*d.value)) * body.kappa))
        if acting:
            for k, f in enumerate(fast):
                least = np.min(np.diagonal(here.root[k][0]))
                rates.append(5 * f / least)
        return 1 / max(rates)

    def _stiffness(self, t: float, length: float) -> float:
        """Half of the greatest lam on a panel from t, not longer than one that this allows."""
        while True:
            ahead = np.linspace(t, min(t + length, self.scene.duration), 5)
            lam = float(np.max(self.scene.gain.rate(self.scene.profile, ahead)))
            if not lam * length > 2:
                return 1 / length
            length /= 4

    def _gone(self, left: float) -> bool:
        """There is no slip, or none but rounding, and nothing makes any."""
        return not self.windows and (not self.v.any() or left < 1e-18)

    def _balance(self, sample: Sample, weights: Array, acting: list) -> None:
        """x' and D(M q'/sigma)/dt integrate to what has changed."""
        sigma = self._sigma(sample.t)
        gain = self.scene.gain.rate(self.scene.profile, sample.t)
        if self._gone(float(self._left(sample.t[:1])[0] / sigma[0])):
            gain = 0 * gain  # a slip of rounding alone times any gain is no force
        given = {kind: np.zeros(2) for kind in DISTURBANCES}
        for d in acting:
            given[type(d)] = given[type(d)] + d.value
        forces = [given[cs.FingerAcceleration], given[cs.ObjectAcceleration]]
        velocity = [sample.plane(0), sample.plane(1) - sample.root[1] @ given[cs.ObjectRateOffset]]
        slip = np.einsum("nij,nj->ni", sample.turn, velocity[0]) - velocity[1]
        for k, body in enumerate(self.bodies):
            push = sample.root[k] @ forces[k] + (gain[:, None] * slip if k else 0.0)
            path = sample.space(k, velocity[k]) / sigma[:, None]
            n, _ = body.normal(sample.x[k])
            bent = n * np.sum(body.turning(sample.x[k], sample.rate[k]) * path, 1, keepdims=True)
            change = sample.space(k, push) / sigma[:, None] - bent
            loss = float(self._loss(sample, k).max())
            moved = weights @ np.linalg.norm(sample.rate[k][1:-1], axis=1)
            reach = body.size + np.linalg.norm(sample.x[k][0])
            error = sample.x[k][-1] - sample.x[k][0] - weights @ sample.rate[k][1:-1]
            self.meter.see(f"point {k + 1} moves by its rate", error,
                           4 * self.e[k] * reach + loss * moved)  # fmt: skip
            # lam times an error of the velocities adds to their change
            stiff = weights.sum() * gain.max()
            scale = np.linalg.norm(path, axis=1).max() + np.hypot(*self.w1)
            other = float(self._loss(sample, 0).max()) if k else 0.0
            error = path[-1] - path[0] - weights @ change[1:-1]
            unsure = self.terms / sigma.min() * EPS * 64  # rounding of sigma, by which both divide
            self.meter.see(f"path velocity {k + 1} obeys its equation", error,
                           8 * (loss + other + unsure) * scale * (1 + stiff))  # fmt: skip


# --- families ----------------------------------------------------------------------------------


def grid(
    name: str,
    repeats: int,
    axes: Sequence[Sequence[dict[str, Any]]],
    run_trial: Callable[[Trial], Verdict] = run,
) -> Family:
    """All combinations of choices, each repeated with all else drawn anew.

    Parameters
    ----------
    name : str
    repeats : int
        Of the whole grid; further indices draw further repeats.
    axes : per axis, choices as arguments of `draw_trial`
    run_trial : judge
    """
    count = math.prod(map(len, axes))
    key = zlib.crc32(name.encode())

    def make(index: int) -> Case:
        places = np.unravel_index(index % count, [len(axis) for axis in axes])
        fixed: dict[str, Any] = {}
        for axis, place in zip(axes, places):
            fixed |= axis[int(place)]
        draw = Seeded(key, index)
        return Case(f"{name} {index}: {fixed}", name, lambda: run_trial(draw_trial(draw, **fixed)))

    return Family(name, repeats * count, make, endless=True)


def axis(key: str, values: Sequence[Any]) -> list[dict[str, Any]]:
    """One choice of `draw_trial` with these values."""
    return [{key: value} for value in values]


BUILT_IN = ("plane", "sphere", "cylinder", "torus", "ellipsoid", "turned")
OF_USERS = ("chart_sphere", "chart_torus", "chart_waves", "implicit_ellipsoid", "implicit_cube")
MISSES = (0.0, *(10.0**-k for k in range(15, -1, -1)))
# What has poles or umbilics; `chart` is the user's sphere of one pole.
POLES = [
    {"kind": "sphere"},
    *({"kind": "ellipsoid", "shape": s} for s in ("oblate", "prolate", "equal axes", "plain",
                                                  "needle", "pancake", "nearly a sphere")),
    {"kind": "implicit_ellipsoid"},
]  # fmt: skip


def _poles() -> list[dict[str, Any]]:
    """Every kind of pole, passed by object and finger at every distance."""
    cases = []
    for what, side, miss in itertools.product(POLES, ("object", "finger"), MISSES):
        other = {"object": "finger", "finger": "object"}[side]
        shape = {"shape": what["shape"]} if "shape" in what else {}
        cases.append({side: what["kind"], other: "sphere", "pole": (side, miss),
                      "profile": "constant", "windows": 0, "turns": 4.0} | shape)  # fmt: skip
    return cases


def bowl(trial: Trial) -> Verdict:
    """The plan judged as ever; then its twist turned back into contact rates, or refused."""
    verdict = run(trial)
    if verdict.outcome != "right":
        return verdict
    plan = cs.plan(trial.scene, tolerance=trial.tolerance)
    judge = Judge(trial, plan)
    sample, _ = judge._sample(np.array([0.4, 0.7]) * trial.scene.duration)
    forms = [
        body.surface.curvature_form(*sample.states[:, 4 * k : 4 * k + 2].T)
        for k, body in enumerate(judge.bodies)
    ]
    a1, a2 = sample.plane(0), sample.plane(1)
    slip = plan.slip(sample.t)[:, 0]
    # Montana's inverse map, stated here: [-omega_y, omega_x] = K1 a1 + R K2 a2
    bend = np.einsum("nij,nj->ni", forms[0], a1)
    bend += np.einsum("nij,njk,nk->ni", sample.turn, forms[1], a2)
    omega = np.stack([bend[:, 1], -bend[:, 0]], axis=1)
    relative = forms[0] + sample.turn @ forms[1] @ sample.turn
    terms = abs(forms[0]).max() + abs(forms[1]).max()
    try:
        b1, b2 = cs.kinematics.forward_montana(*forms, sample.states[:, 8], omega, slip)
    except cs.ConformalContact as error:
        said = refusal(str(error))
        clear = np.abs(np.linalg.det(relative)).min() > 1e-9 * terms**2
        return Verdict("silent", 1.0, 0.0, "refused, but not conformal") if clear else said
    condition = terms / np.linalg.svd(relative, compute_uv=False).min()
    speed = np.linalg.norm(a1, axis=1).max() + np.linalg.norm(a2, axis=1).max()
    loss = sum(float(judge._loss(sample, k).max()) for k in (0, 1))
    judge.meter.see("contact rates from the twist", np.array([b1 - a1, b2 - a2]),
                    8 * condition * (loss + 64 * EPS) * speed)  # fmt: skip
    return judge.meter.verdict()


def _bowls() -> list[dict[str, Any]]:
    """Fingers of a bowl's own form, less a part of their radius."""
    return [
        {"object": kind, "finger": kind, "ratio": 1.0 - less, "bowl": True, "windows": 0}
        for kind in ("sphere", "cylinder", "torus", "ellipsoid", "plane")
        for less in (0.0, *(10.0**-k for k in range(16, 0, -1)), 0.5)
    ]


# --- gain laws alone ---------------------------------------------------------------------------


def gain_law(draw: Draw, **fixed: Any) -> Verdict:
    """The decay that planners use, piece by piece, and `contraction`, against the law."""
    duration = 10 ** draw.real(-3, 3)
    profile = _profile(PROFILES[fixed["profile"]], 10 ** draw.real(-4, 4), duration)
    gain = cs.Gain(fixed["law"], fixed["eta"])
    profile.check(duration)
    sigma, left, meter = np.array(profile.coefficients), 1.0, Meter()
    terms = float(poly.polyval(duration, abs(sigma)))
    for piece in gain.pieces(profile, 0.0, duration):
        tau = (piece.stop - piece.start) * np.array([0.0, draw.real(0, 1), 1.0])
        speed = piece.speed(tau)
        decay = left * piece.decay(tau, speed)
        law = left_over(sigma, gain, piece.start + tau)
        # lam t has the rounding of t; exp(-x) x is at most 0.37
        meter.see("decay of a piece", np.nan_to_num(decay, nan=math.inf) * speed - law,
                  256 * EPS * terms)  # fmt: skip
        left = float(decay[-1])
    said = cs.profile.contraction(profile, gain, duration).left
    if not math.isnan(said):
        law = left_over(sigma, gain, np.array([duration])) / sigma[0]
        meter.see("what contraction says is left", said - law, 256 * EPS * terms / sigma[0])
    return meter.verdict()


def _gain_laws() -> Family:
    choices = list(itertools.product(PROFILES, LAWS, ETAS))

    def make(index: int) -> Case:
        fixed = dict(zip(("profile", "law", "eta"), choices[index % len(choices)]))
        draw = Seeded(zlib.crc32(b"gain laws"), index)
        return Case(f"gain laws {index}: {fixed}", "gain laws", lambda: gain_law(draw, **fixed))

    return Family("gain laws", 4 * len(choices), make, endless=True)


# --- input that must be refused ----------------------------------------------------------------

BAD = (math.nan, math.inf, -math.inf, -1.0, 0.0, 1e300, 5e-324, "0.1", None, True, (), "sphere",
       1e-200, 1e200, -0.0, 2.0)  # fmt: skip


def _wrong(draw: Draw) -> dict[str, Callable[[Any], Any]]:
    """Ways to put a value where it may not belong, by name; each plans what it makes."""
    good = {
        "object": cs.Sphere(0.1), "profile": cs.Profile([0.1]), "duration": 1.0, "name": "wrong",
        "contacts": [cs.Contact(finger=cs.Sphere(0.04), object_at=(1.0, 0.5))],
    }  # fmt: skip

    def planned(**changes: Any) -> Trial:
        scene = cs.Scene(**(good | changes))
        body = Body(scene.object, _round(scene.object.size), scene.contacts[0].object_at,
                    scene.object.size, line="sphere")  # fmt: skip
        finger = scene.contacts[0].finger
        return Trial(scene, Body(finger, _round(finger.size), scene.contacts[0].finger_at,
                                 finger.size, line="sphere"), body, compiled=True)  # fmt: skip

    def contact(**changes: Any) -> Trial:
        return planned(contacts=[cs.Contact(**({"finger": cs.Sphere(0.04), "object_at": (1.0, 0.5)}
                                               | changes))])  # fmt: skip

    def disturbed(kind: type, *values: Any) -> Trial:
        return planned(disturbances=[kind(*values)])

    kind = draw.pick(DISTURBANCES)
    return {
        "radius": lambda x: planned(object=cs.Sphere(x)),
        "finger radius": lambda x: contact(finger=cs.Sphere(x)),
        "finger": lambda x: contact(finger=x),
        "object": lambda x: planned(object=x),
        "object_at u": lambda x: contact(object_at=(x, 0.5)),
        "object_at v": lambda x: contact(object_at=(1.0, x)),
        "object_at": lambda x: contact(object_at=x),
        "angle": lambda x: contact(angle=x),
        "finger_velocity": lambda x: contact(finger_velocity=(x, 1.0)),
        "finger_velocity, whole": lambda x: contact(finger_velocity=x),
        "object_velocity": lambda x: contact(object_velocity=(0.1, x)),
        "object_velocity, whole": lambda x: contact(object_velocity=x),
        "profile": lambda x: planned(profile=cs.Profile([0.1, x])),
        "profile, first": lambda x: planned(profile=cs.Profile([x])),
        "profile, high": lambda x: planned(profile=cs.Profile([0.1, 0, 0, 0, 0, 0, x])),
        "duration": lambda x: planned(duration=x),
        "gain path": lambda x: planned(gain=cs.Gain.path(x)),
        "gain time": lambda x: planned(gain=cs.Gain.time(x)),
        "gain guaranteed": lambda x: planned(gain=cs.Gain.guaranteed(x)),
        "gain law": lambda x: planned(gain=cs.Gain(x, 1.0)),
        "torus": lambda x: planned(object=cs.Torus(x, 0.03)),
        "torus, tube": lambda x: planned(object=cs.Torus(0.1, x)),
        "ellipsoid": lambda x: planned(object=cs.Ellipsoid(0.3, x, 0.1)),
        "quadric": lambda x: planned(object=cs.Quadric([[x, 0, 0], [0, 2, 0], [0, 0, x]])),
        "quadric, one": lambda x: planned(object=cs.Quadric([[1, 0.2, 0], [0.2, x, 0], [0, 0, 3]])),
        "implicit": lambda x: planned(
            object=cs.ImplicitSurface("x**2 + y**2 + z**2 - r", parameters={"r": x})),
        "parametric": lambda x: planned(
            object=cs.ParametricSurface(("u", "v", "k*u"), parameters={"k": x})),
        "window start": lambda x: disturbed(kind, 0, x, 0.5, (0.1, 0.1)),
        "window stop": lambda x: disturbed(kind, 0, 0.1, x, (0.1, 0.1)),
        "window contact": lambda x: disturbed(kind, x, 0.1, 0.5, (0.1, 0.1)),
        "window value": lambda x: disturbed(kind, 0, 0.1, 0.5, (0.1, x)),
        "tolerance": lambda x: cs.plan(planned().scene, tolerance=x),
        "time": lambda x: cs.plan(planned().scene).states([0.5, x]),
        "time, points": lambda x: cs.plan(planned().scene).points(x),
        "restart": lambda x: cs.plan(planned().scene).restart(x, np.ones((1, 9))),
        "restart, state": lambda x: cs.plan(planned().scene).restart(0.5, [[x] * 9]),
        "continued": lambda x: cs.plan(planned().scene).continued(x),
    }  # fmt: skip


def _wrong_case(index: int) -> Case:
    draw = Seeded(zlib.crc32(b"wrong input"), index)
    ways = _wrong(draw)
    name, value = list(ways)[index % len(ways)], BAD[index // len(ways) % len(BAD)]
    if index >= len(ways) * len(BAD):
        value = draw.pick([-1, 1]) * 10 ** draw.real(-320, 308)
    return Case(f"{name} = {value!r}", "wrong input", lambda: _tried(ways[name], value))


def _tried(way: Callable[[Any], Any], value: Any) -> Verdict:
    """Refused; or taken, and then nothing that comes out is NaN or infinite, spheres are right."""
    given = way(value)
    if isinstance(given, Trial):
        bodies = (given.finger, given.object)
        if all(b.surface.great_circles and 1e-100 < b.size < 1e100 for b in bodies):
            return run(given)
    if isinstance(given, Trial):
        given = cs.plan(given.scene, compiled=given.compiled)
    out = given
    if isinstance(given, cs.Plan):
        t = np.linspace(given.start, given.scene.duration, 4)
        out = np.concatenate([np.ravel(f(t)) for f in (given.points, given.states, given.slip,
                                                       given.pose, given.twist)])  # fmt: skip
    finite = bool(np.isfinite(out).all())
    return Verdict("right" if finite else "silent", 0.0 if finite else math.inf, 1.0, "finite")


FAMILIES = [
    _gain_laws(),
    grid("eta and gain law", 3, [axis("eta", ETAS), axis("law", LAWS), axis("object", BUILT_IN),
                                 [{"slip": 1, "windows": 0}]]),
    grid("profile", 1, [axis("profile", list(PROFILES)), axis("law", LAWS),
                        axis("object", BUILT_IN), axis("eta", [1.0, 1e3, 1e6, 1e9, 1e12]),
                        [{"slip": 1, "windows": 0}]]),
    grid("poles and umbilics", 3, [_poles(), axis("slip", [0, 1])]),
    grid("radius ratio", 6, [axis("ratio", [10 ** (k / 2) for k in range(-12, 13)]),
                              axis("object", BUILT_IN), [{"windows": 0}]]),
    grid("ellipsoids", 6, [
        axis("shape", SHAPES), [{"object": "ellipsoid"}, {"finger": "ellipsoid"}],
        axis("windows", [0, 0, 0, 1]), axis("inside", [False, True])]),
    grid("conforming bowls", 10, [_bowls()], bowl),
    grid("revolutions", 3, [axis("turns", [2 * math.pi * 10.0**k for k in range(6)]),
                            axis("object", BUILT_IN[:3]), axis("finger", BUILT_IN[:3]),
                            [{"windows": 0, "most": 2e6}]]),
    grid("revolutions, integrated", 1, [
        # compiled: the virtual machine takes 0.5 ms a panel
        axis("turns", [2 * math.pi * 10.0**k for k in range(6)]),
        [{"object": "torus"}, {"object": "ellipsoid", "shape": "plain"}, {"object": "chart_torus"}],
        [{"finger": "plane", "windows": 0, "most": 7e5, "compiled": True, "ratio": 10.0}]]),
    grid("tolerance", 8, [axis("tolerance", [10.0**-k for k in range(3, 16)]),
                           axis("object", BUILT_IN), axis("slip", [0, 1]), [{"windows": 0}]]),
    grid("disturbances", 100, [axis("windows", [1, 2, 3]), [{}]]),
    grid("surfaces of users", 4, [axis("object", OF_USERS), axis("finger", OF_USERS),
                                  axis("slip", [0, 1])]),
    Family("wrong input", 5000, _wrong_case, endless=True),
    grid("everything", 800, [[{}]]),
]  # fmt: skip
