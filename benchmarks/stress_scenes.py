"""Scenes of the stress bench: how bodies, paths, gains and disturbances are drawn.

`draw_trial` draws every scene, with a seeded generator here and with hypothesis in the tests; a
family of cases fixes some choices. Level functions are written independently of the package.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial import polynomial as poly

import contact_system as cs

EPS = 2.0**-52
Array = np.ndarray


class Draw:
    """Random choices with a seed of integers; in the tests hypothesis chooses instead."""

    def __init__(self, *seed: int):
        self.random = np.random.default_rng(seed)

    def pick(self, values: Sequence[Any]) -> Any:
        """One of the values."""
        return values[int(self.random.integers(len(values)))]

    def real(self, low: float, high: float) -> float:
        """A number between two."""
        return float(self.random.uniform(low, high))


@dataclass(frozen=True)
class Shape:
    """A surface F(x, p) = 0, with its parameters p; CasADi derives F."""

    F: Callable[[ca.SX, ca.SX], ca.SX]
    p: tuple[float, ...]
    integral: Callable[[Array, Array], tuple[Array, Array, Array]] | None = None
    """(points, directions) -> a first integral of geodesics, bounds of its derivatives by both."""

    def derived(self, x: Array, y: Array | None = None) -> tuple[Array, Array, Array]:
        """F (n,), grad F (n, 3) and (Hess F) y (n, 3) of points x and vectors y (n, 3)."""
        y = np.zeros_like(x) if y is None else y
        level, slope, bend = _derivatives(self.F, len(self.p))(x.T, y.T, self.p)
        return level.full()[0], slope.full().T, bend.full().T


@functools.cache
def _derivatives(F: Callable[[ca.SX, ca.SX], ca.SX], count: int) -> ca.Function:
    x, y, p = ca.SX.sym("x", 3), ca.SX.sym("y", 3), ca.SX.sym("p", count)
    slope = ca.gradient(level := F(x, p), x)
    return ca.Function(F.__name__, [x, y, p], [level, slope, ca.jtimes(slope, x, y)])


def level_of_quadric(x: ca.SX, p: ca.SX) -> ca.SX:
    """x A x / 2 + b . x = c / 2."""
    return x.T @ ca.reshape(p[:9], 3, 3) @ x / 2 + p[9:12].T @ x - p[12] / 2


def quadric(A: Array, b: Sequence[float] = (0, 0, 0), c: float = 1.0) -> Shape:
    """The quadric x A x / 2 + b . x = c / 2, with Joachimsthal's integral."""

    def integral(x: Array, p: Array) -> tuple[Array, Array, Array]:
        ax, ap = x @ A + b, p @ A
        normal, along = np.sum(ax * ax, 1), np.sum(p * ap, 1)
        by_x = 2 * np.linalg.norm(ax @ A, axis=1) * abs(along)
        return normal * along, by_x, 2 * normal * np.linalg.norm(ap, axis=1)

    return Shape(level_of_quadric, (*A.ravel(), *b, c), integral)


def level_of_tube(x: ca.SX, p: ca.SX) -> ca.SX:
    """Torus about z: ((rho - R)^2 + z^2 - r^2) / 2 = 0."""
    return ((ca.hypot(x[0], x[1]) - p[0]) ** 2 + x[2] ** 2 - p[1] ** 2) / 2


def clairaut(x: Array, p: Array) -> tuple[Array, Array, Array]:
    """Clairaut's integral rho^2 phi'; see `Shape.integral`."""
    return x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0], np.ones(len(x)), np.hypot(x[:, 0], x[:, 1])


def level_of_waves(x: ca.SX, p: ca.SX) -> ca.SX:
    """z = h cos(k (x - 0.4 y)) cos(k y)."""
    return x[2] - p[0] * ca.cos(p[1] * (x[0] - 0.4 * x[1])) * ca.cos(p[1] * x[1])


@dataclass(frozen=True)
class Body:
    """A surface, a contact on it, and what is known about it independently of the package."""

    surface: cs.Surface
    shape: Shape
    at: tuple[float, float]  # u, v
    size: float  # m; errors are counted in it
    kappa: float = 1.0  # size times the greatest curvature, at least 1
    line: str = ""  # "plane", "sphere" or "cylinder": its geodesics have this closed form
    integrated: bool = True  # planners integrate its geodesics, as they have no closed form
    umbilics: bool = False  # it has umbilics, and Jacobi's chart

    def normal(self, x: Array) -> Array:
        """Unit normals out of the body (n, 3)."""
        return self.turning(x, x)[0]

    def turning(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Unit normals, and their derivatives along y, (n, 3) each."""
        _, slope, bend = self.shape.derived(x, y)
        length = np.linalg.norm(slope, axis=1, keepdims=True)
        length *= -1.0 if self.surface.inside else 1.0
        n, change = slope / length, bend / length
        return n, change - n * np.sum(n * change, 1, keepdims=True)

    def geodesic(self, x: Array, p: Array, s: Array) -> Array | None:
        """Closed form of the geodesic from x with velocity p at times s, (n, 3), or None."""
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
            height = (x[2] + p[2] * s[:, None]) * [0.0, 0.0, 1.0]
            return flat * np.cos(turn) + across * np.sin(turn) + height
        return None


def _ellipsoid(a: float, b: float, c: float) -> Shape:
    return quadric(np.diag([a**-2, b**-2, c**-2]))


def _tube(major: float, minor: float) -> Shape:
    return Shape(level_of_tube, (major, minor), clairaut)


TURN = np.linalg.qr(np.array([[1.0, 0.3, -0.2], [0.1, 1.0, 0.7], [-0.6, 0.2, 1.0]]))[0]


def plane(draw: Draw, size: float, inside: bool) -> Body:
    """The plane; ``inside`` puts the body above."""
    at = (size * draw.real(-1, 1), size * draw.real(-1, 1))
    shape = quadric(np.zeros((3, 3)), (0, 0, 1), 0.0)
    return Body(cs.Plane(inside=inside), shape, at, 1.0, line="plane", integrated=False)


def sphere(draw: Draw, size: float, inside: bool) -> Body:
    """A sphere or a spherical bowl."""
    surface, known = cs.Sphere(size, inside=inside), {"line": "sphere", "integrated": False}
    return Body(surface, quadric(np.eye(3) / size**2), _polar(draw), size, **known)


def cylinder(draw: Draw, size: float, inside: bool) -> Body:
    """A cylinder or a bore."""
    shape = quadric(np.diag([size**-2, size**-2, 0.0]))
    at = (draw.real(-3, 3), size * draw.real(-1, 1))
    surface = cs.Cylinder(size, inside=inside)
    return Body(surface, shape, at, size, line="cylinder", integrated=False)


def torus(draw: Draw, size: float, inside: bool) -> Body:
    """A torus, thin to nearly closed."""
    part = draw.pick([0.3, 0.01, 0.9, draw.real(0.02, 0.95)])
    major = size / (1 + part)
    r = part * major
    kappa = size * max(1 / r, 1 / (major - r))
    at = (draw.real(-3, 3), draw.real(-3, 3))
    return Body(cs.Torus(major, r, inside=inside), _tube(major, r), at, major + r, kappa)


SHAPES: dict[str, Callable[[float, float, float, float], tuple[float, float]]] = {
    "plain": lambda near, x, y, z: (2 / 3, 1 / 3),
    "needle": lambda near, x, y, z: (0.01, 0.009),
    "pancake": lambda near, x, y, z: (0.98, 0.01),
    "nearly a sphere": lambda near, x, y, z: (near, near * near),
    "nearly oblate": lambda near, x, y, z: (near, 0.3),
    "nearly prolate": lambda near, x, y, z: (0.3, 0.3 * near),
    "oblate": lambda near, x, y, z: (1.0, x),
    "prolate": lambda near, x, y, z: (0.2, 0.2),
    "equal axes": lambda near, x, y, z: (1.0, 1.0),
    "any": lambda near, x, y, z: (y, z),
}
"""The two smaller axes of ellipsoids over the greatest, from drawn numbers; ``near`` is about 1."""


def ellipsoid(draw: Draw, size: float, inside: bool, shape: str | None = None) -> Body:
    """An ellipsoid of one of `SHAPES`."""
    near = 1 - 10 ** draw.real(-15, -6) if draw.pick([0, 1]) else 1 - 1e-12
    drawn = near, draw.real(0.02, 0.9), draw.real(0.3, 1.0), draw.real(0.02, 0.3)
    b, c = SHAPES[shape or draw.pick(list(SHAPES))](*drawn)
    b, c = min(b * size, size), min(c * size, b * size)
    surface, level = cs.Ellipsoid(size, b, c, inside=inside), _ellipsoid(size, b, c)
    kappa, umbilics = (size / c) ** 2, b not in (size, c)
    at = _jacobi(draw) if umbilics else _polar(draw)
    if size == b == c:
        return Body(surface, level, at, size, kappa, "sphere", integrated=False)
    return Body(surface, level, at, size, kappa, umbilics=umbilics)


def turned(draw: Draw, size: float, inside: bool) -> Body:
    """A quadric with turned axes: ellipsoids, hyperboloids, cylinders."""
    values = draw.pick([(1, 2, 9), (1, 1.5, -0.5), (3, -1, -2), (1, 4, 0), (1, 1, 5), (1, 4, 4)])
    matrix = TURN @ np.diag(values) @ TURN.T / size**2
    matrix = (matrix + matrix.T) / 2
    surface = cs.Quadric(matrix, inside=inside)
    at = (draw.real(0.3, 1.2), draw.real(0.2, 1.2) * (size if values[2] == 0 else 1.0))
    # Open quadrics are most curved at their waist or vertex; their size is the longest axis.
    kappa = max(1.0, surface.size * max(map(abs, values)) / size) ** 2
    return Body(surface, quadric(matrix), at, surface.size, kappa)


def chart_torus(draw: Draw, size: float, inside: bool) -> Body:
    """A torus by a user's chart whose coordinate lines are not orthogonal."""
    major, r = size / 1.3, 0.3 * size / 1.3
    f = ("(R + r*cos(v))*cos(u + 0.3*v)", "(R + r*cos(v))*sin(u + 0.3*v)", "r*sin(v)")
    surface = cs.ParametricSurface(f, parameters={"R": major, "r": r}, size=size, inside=inside)
    at = (draw.real(-3, 3), draw.real(-3, 3))
    return Body(surface, _tube(major, r), at, size, size / r)


def chart_waves(draw: Draw, size: float, inside: bool) -> Body:
    """Bumpy ground by a user's chart."""
    h, k = 0.1 * size, 2.0 / size
    f = ("u + 0.4*v", "v", "h*cos(k*u)*cos(k*v)")
    surface = cs.ParametricSurface(f, parameters={"h": h, "k": k}, size=size, inside=inside)
    at = (size * draw.real(-1, 1), size * draw.real(-1, 1))
    return Body(surface, Shape(level_of_waves, (h, k)), at, size, 2.0)


def implicit_ellipsoid(draw: Draw, size: float, inside: bool) -> Body:
    """An ellipsoid by a user's equation."""
    b, c = 0.7 * size, 0.4 * size
    text, axes = "(x/a)**2 + (y/b)**2 + (z/c)**2 - 1", {"a": size, "b": b, "c": c}
    surface = cs.ImplicitSurface(text, parameters=axes, size=size, inside=inside)
    return Body(surface, _ellipsoid(size, b, c), _polar(draw), size, (size / c) ** 2)


MADE = (plane, sphere, cylinder, torus, ellipsoid, turned)
OF_USERS = (chart_torus, chart_waves, implicit_ellipsoid)
BODIES: dict[str, Callable[..., Body]] = {f.__name__: f for f in (*MADE, *OF_USERS)}
OFTEN = [*list(BODIES)[:6] * 8, *BODIES]
"""Names to draw from; surfaces of users cost ten times as much, so they come less often."""


def _polar(draw: Draw) -> tuple[float, float]:
    return draw.real(0.1, 3.0), draw.real(-3.1, 3.1)


def _jacobi(draw: Draw) -> tuple[float, float]:
    """Coordinates off umbilics, sometimes on a seam."""
    return draw.real(0.1, 3.0), draw.pick([draw.real(-1.4, 1.4), math.pi / 2, -math.pi / 2])


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
"""sigma over its scale as a polynomial of t over the duration, from the lowest power."""
LAWS = ("path", "time", "guaranteed")
ETAS = tuple(10.0**k for k in range(-3, 13))
DISTURBANCES = (cs.FingerAcceleration, cs.ObjectAcceleration, cs.ObjectRateOffset)
TURNS = 40.0
"""Greatest turn of a body that needs integration, rad, unless a family fixes ``most``."""


@dataclass(frozen=True)
class Trial:
    """A scene, how to plan it, and what is known about its bodies independently of the package."""

    scene: cs.Scene
    finger: Body
    object: Body
    tolerance: float = 1e-12
    special: tuple[float, ...] = ()
    """Times to be judged besides drawn ones, s."""
    seed: int = 0


def draw_trial(draw: Draw, **fixed: Any) -> Trial:
    """Draw a trial; ``fixed`` holds choices that are not drawn.

    Choices are finger, object (names of `BODIES`), size, ratio, shape, inside, profile, law, eta,
    turns, duration, tolerance, slip, windows, angle, pole (side and angle, see `_aimed`), bowl (the
    object is hollow, the finger is not), most (see `TURNS`).
    """

    def choose(key: str, values: Sequence[Any]) -> Any:
        return fixed[key] if key in fixed else draw.pick(values)

    def body(kind: str, size: float, own: bool) -> Body:
        inside = own if "bowl" in fixed else choose("inside", [False, False, True])
        shape = {"shape": fixed["shape"]} if kind == "ellipsoid" and "shape" in fixed else {}
        return BODIES[kind](draw, size, inside, **shape)

    size = choose("size", [0.1, 0.1, 1.0, 10 ** draw.real(-4, 4)])
    ratio = choose("ratio", [0.4, 1.0, 10 ** draw.real(-2, 2)])
    kinds = [choose(side, OFTEN) for side in ("object", "finger")]
    obj, finger = body(kinds[0], size, True), body(kinds[1], ratio * size, False)
    duration = choose("duration", [1.0, 1.0, 0.01, 30.0])
    turns = choose("turns", [1.0, 5.0, 10 ** draw.real(-3, 2)])
    length = turns * obj.size
    for each in (obj, finger):
        if each.integrated:
            length = min(length, fixed.get("most", TURNS) * each.size / each.kappa)
    profile = stretched(PROFILES[choose("profile", list(PROFILES))], length, duration)
    obj, finger, contact, special = _contact(draw, fixed, obj, finger, length, duration)
    gain = cs.Gain(choose("law", LAWS), choose("eta", [*ETAS, 10 ** draw.real(-3, 12)]))
    count, bodies = choose("windows", [0, 0, 1, 2]), (finger, obj)
    scene = cs.Scene(
        object=obj.surface,
        contacts=[contact],
        profile=profile,
        duration=duration,
        gain=gain,
        name="stress",
        disturbances=[_disturbance(draw, bodies, length, duration) for _ in range(count)],
    )
    tolerance = choose("tolerance", [1e-12, 1e-12, 1e-9, 1e-6])
    return Trial(scene, finger, obj, tolerance, special, int(draw.real(0, 2**31)))


def stretched(shape: Sequence[float], length: float, duration: float) -> cs.Profile:
    """The profile of a shape of `PROFILES`, with this arc length over the duration."""
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
        body = dataclasses.replace(body, at=at)
        obj, finger = (body, finger) if side == "object" else (obj, body)
        special = tuple(duration * f for f in arc / length + np.array([0.0, -1e-9, 1e-9]))
        special = tuple(t for t in special if 0 <= t <= duration)
        if side == "object":  # the finger's heading for this one; R_psi is its own inverse
            heading = -angle - heading
    slips = fixed["slip"] if "slip" in fixed else draw.pick([0, 1, 1, 2])
    slipping = (draw.real(-1, 1), draw.real(-1, 1))
    contact = cs.Contact(
        finger=finger.surface,
        object_at=obj.at,
        finger_at=finger.at,
        angle=angle,
        finger_velocity=(math.cos(heading), math.sin(heading)),
        object_velocity=("rolling", slipping, "rest")[slips],
    )
    return obj, finger, contact, special


def _aimed(draw: Draw, body: Body, miss: float) -> tuple[tuple[float, float], float, float]:
    """A start, a heading there that misses a pole or umbilic by an angle, and the length up to it.

    Polar charts: along a meridian. Jacobi's chart: along the ellipse y = 0, which holds all four
    umbilics; the length to the first one is not computed, but 0.
    """
    if body.umbilics:
        return (draw.real(0.3, 2.8), math.pi / 2), draw.pick([0.0, math.pi]) + miss, 0.0
    u = draw.real(0.2, 2.9)
    # u is the polar angle on all of these charts; only a sphere's meridian has a simple length
    arc = u * body.size if body.line == "sphere" else 0.0
    return (u, draw.real(-3, 3)), math.pi + miss, arc


def _disturbance(draw: Draw, bodies: tuple[Body, Body], length: float, duration: float) -> Any:
    """A disturbance as strong as the motion itself, or weaker, in one window."""
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
