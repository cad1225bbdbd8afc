"""Balls whose exact motion is known, and the wrench under which a free ball moves so.

A set-up is a ball on a surface. Its motion is a closed form or a plan of contact_system; a free
ball follows it under gravity, or under the wrench that `Drive` gives at each step. In simulators
bodies sink into each other, so exact motions are those on smaller balls and surfaces, on which
simulated ones roll. `proof` checks exact motions: it integrates Newton's and Euler's equations
independently, with rolling imposed or with Coulomb's friction.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import contact_system as cs

Array = NDArray[np.float64]
RADIUS, MASS, GRAVITY = 0.04, 0.1, 9.81
INERTIA, PRESSED = 0.4 * MASS * RADIUS**2, MASS * GRAVITY
TABLE = 15.0
"""rad/s, of the turntable."""
SPEED = 0.3
"""m/s, of the contact along a plan."""
UP = np.array([0.0, 0.0, 1.0])
NODES, AFTER = 100, 0.05
"""Chebyshev nodes of a drive, and s beyond the set-up's end that it also covers."""
GUIDE = {"position": (100.0, 4.0), "rotation": (0.25, 0.008)}
"""Stiffness and damping of the guide that holds a ball to its path in the tangent plane, N/m and
N s/m, or upright, N m and N m s: soft, and stable at steps of 4 ms."""


@dataclass(frozen=True)
class Motion:
    """A ball's motion at n times: its centre's x, m, and v, m/s, w (angular velocity), rad/s, the
    surface's normal, (n, 3) each; its orientation."""

    x: Array
    v: Array
    w: Array
    normal: Array
    turned: Rotation

    def off(self, x: Array, turned: Rotation) -> float:
        """How far a ball is off the first pose: the centre, in radii, plus the angle, rad."""
        angle = (turned.inv() * self.turned[0]).magnitude()
        return float(np.linalg.norm(x - self.x[0]) / RADIUS + angle)


@dataclass(frozen=True)
class Ended:
    """State of a ball at the end of a run, and its processor time, s; ``whole``: not given up."""

    setup: Setup
    t: float
    x: Array
    v: Array
    turned: Rotation
    seconds: float
    whole: bool = True

    @property
    def exact(self) -> Motion:
        return self.setup.motion(np.array([self.t]))

    @property
    def error(self) -> float:
        """How far off the ball is, as `Motion.off` measures it."""
        return self.exact.off(self.x, self.turned)


@dataclass(frozen=True)
class Setup:
    """A ball on a surface, and its exact motion."""

    name: str
    scene: cs.Scene  # of nominal bodies, with the ball's path
    surface: cs.Surface  # on which the ball rolls
    radius: float  # m, on which the ball rolls
    motion: Callable[[Array], Motion]
    end: float  # s
    friction: float = 0.5
    slope: float = 0.0  # of the plane, rad; with a guide the wrench presses, not gravity
    table: float = 0.0  # angular velocity of the surface about z, rad/s
    guide: str = ""  # "position" or "rotation": a wrench drives the ball, and softly guides this
    until: float = 0.0  # s; the ball slides until then

    @property
    def pressed(self) -> float:
        """Normal force, N."""
        return PRESSED * math.cos(self.slope)

    @property
    def gravity(self) -> Array:
        """m/s^2; none if a wrench drives the ball."""
        if self.guide:
            return np.zeros(3)
        return GRAVITY * np.array([math.sin(self.slope), 0.0, -math.cos(self.slope)])

    def slip(self, m: Motion) -> Array:
        """Velocity of the ball's lowest point over the surface, (n, 3), m/s."""
        below = self.radius * m.normal
        return m.v - np.cross(m.w, below) - self.table * np.cross(UP, m.x - below)


def motion_of_plan(scene: cs.Scene, t: Array) -> Motion:
    """Motion of a plan's first finger, a sphere, on an object at rest."""
    found = cs.plan(scene).evaluate(np.asarray(t), "pose", "twist", "points")
    pose, twist = found["pose"][:, 0], found["twist"][:, 0]
    normal = pose[:, :3, 3] - found["points"][:, 0, 1]
    normal /= scene.contacts[0].finger.radius
    turned = Rotation.from_matrix(pose[:, :3, :3])
    return Motion(pose[:, :3, 3], twist[:, 3:], twist[:, :3], normal, turned)


def _at_height(height: float, motion: Callable[[Array], Motion], t: Array) -> Motion:
    """The motion with the ball's centre at this height, m."""
    found = motion(np.asarray(t))
    return replace(found, x=found.x * [1.0, 1.0, 0.0] + height * UP)


def _straight(v: float, w: float, a: float, alpha: float, until: float, t: Array) -> Motion:
    """Along x on a plane: accelerated until a time, then at constant speeds."""
    early, zero, up = np.minimum(t, until), np.zeros(len(t)), np.tile(UP, (len(t), 1))

    def along(rate: float, change: float) -> tuple[Array, Array]:
        now = rate + change * early
        return rate * early + change * early**2 / 2 + now * (t - early), now

    (way, speed), (angle, turning) = along(v, a), along(w, alpha)
    x, rates = np.stack([way, zero, zero], axis=1), np.stack([speed, zero, zero], axis=1)
    turned = Rotation.from_rotvec(np.stack([zero, angle, zero], axis=1))
    return Motion(x, rates, np.stack([zero, turning, zero], axis=1), up, turned)


def _circle(radius: float, t: Array) -> Motion:
    """Weltner's circle around the axis of a turntable; nothing changes in a frame that goes round
    with the ball."""
    beta = INERTIA / (MASS * radius**2)
    rate, v0 = TABLE * beta / (1 + beta), np.array([0.0, SPEED, 0.0])
    x0 = np.cross(v0, UP) / rate
    w0 = np.cross(UP, v0 - TABLE * np.cross(UP, x0)) / radius + TABLE * UP  # no relative spin
    round_ = Rotation.from_rotvec(np.outer(t, rate * UP))
    turned = round_ * Rotation.from_rotvec(np.outer(t, w0 - rate * UP))
    return Motion(
        round_.apply(x0), round_.apply(v0), round_.apply(w0), np.tile(UP, (len(t), 1)), turned
    )


# --- set-ups --------------------------------------------------------------------------------------

PLANNED = {
    "sphere": (cs.Sphere(0.1), (0.6, 0.8, 0.0), (0.3, 0.4, 1.0)),
    "principal ellipse": (cs.Ellipsoid(0.3, 0.2, 0.1), (0.0, 0.6, 0.8), (0.0, 1.0, 0.0)),
    "triaxial geodesic": (cs.Ellipsoid(0.3, 0.2, 0.1), (0.64, 0.48, 0.6), (0.2, -1.0, 0.5)),
}
"""Surface, where the contact starts, in units of its axes, and the direction in which it goes."""


def setups(ball: float = 0.0, below: float = 0.0) -> dict[str, Setup]:
    """All set-ups; the ball is smaller by ``ball``, and surfaces are lower by ``below``, m."""
    r = RADIUS - ball
    found = _on_planes(r, r - below)
    for name, (surface, start, way) in PLANNED.items():
        scene, less = _geodesic(surface, RADIUS, start, way), axes_of(surface) - below
        round_ = isinstance(surface, cs.Sphere)
        smaller = cs.Sphere(less[0]) if round_ else cs.Ellipsoid(*less.tolist())
        rolled = functools.partial(motion_of_plan, _geodesic(smaller, r, start, way))
        found.append(Setup(name, scene, smaller, r, rolled, 1.0, guide="position"))
    return {setup.name: setup for setup in found}


def _on_planes(r: float, height: float) -> list[Setup]:
    """Set-ups on planes, of balls of radius r with centres ``height`` over the nominal plane."""
    beta = INERTIA / (MASS * r**2)
    rolls = GRAVITY * math.sin(0.2) / (1 + beta)
    slides, grips = GRAVITY * math.sin(0.6), 0.1 * GRAVITY * math.cos(0.6)
    brakes = 0.2 * GRAVITY  # from 1 m/s until it rolls, at 5/7 of that if it is rigid
    until = beta / (1 + beta) / brakes

    def plane(name: str, motion: Callable, *numbers: Any, end: float = 0.5, **more: Any) -> Setup:
        moves = functools.partial(_at_height, height, functools.partial(motion, *numbers))
        given = {"scene": _on_plane(), "end": end} | more
        return Setup(name, surface=cs.Plane(), radius=r, motion=moves, **given)

    turning = {"table": TABLE, "scene": _on_plane(cs.Turning(tuple(UP), [0.0, TABLE]))}
    orbit = 2 * math.pi * (1 + beta) / (TABLE * beta)
    sliding = {"slope": 0.6, "friction": 0.1, "until": 0.5}
    dying = {"friction": 0.2, "until": until}
    law = {"scene": _slipping(RADIUS), "guide": "position", "friction": 0.2, "until": 1.0}
    spun = grips / (beta * r)
    return [
        plane("plane", _straight, 0.5, 0.5 / r, 0.0, 0.0, 1.0, end=1.0),
        plane("turntable", _circle, r, end=orbit, **turning),
        plane("slope, rolling", _straight, 0.0, 0.0, rolls, rolls / r, 1.0, slope=0.2),
        plane("slope, sliding", _straight, 0.1, 0.0, slides - grips, spun, 1.0, **sliding),
        plane("slip that dies", _straight, 1.0, 0.0, -brakes, brakes / (beta * r), until, **dying),
        plane("creep", _straight, 0.0, 0.0, 0.0, 0.0, 0.0, end=1.0, guide="rotation"),
        plane("slip law", motion_of_plan, _slipping(r), end=1.0, **law),
    ]


def axes_of(surface: cs.Surface) -> Array:
    """Semi-axes of an ellipsoid or a sphere, (3,), m."""
    return np.array([getattr(surface, k, surface.size) for k in "abc"])


def _on_plane(turning: cs.Turning | None = None) -> cs.Scene:
    contact = cs.Contact(cs.Sphere(RADIUS), object_at=(0.0, 0.0))
    return cs.Scene(
        object=cs.Plane(),
        contacts=[contact],
        profile=cs.Profile([0.1]),
        duration=1.0,
        turning=turning or cs.Turning(tuple(UP), [0.0]),
    )


def _geodesic(surface: cs.Surface, radius: float, start: Array, way: Array) -> cs.Scene:
    """A ball rolls from ``start``, in units of the axes, along ``way`` in the tangent plane."""
    at = surface.coordinates(np.array(start) * axes_of(surface))
    frame = surface.frame(*at)[:, :2]
    along = frame.T @ np.array(way)
    along /= np.hypot(*along)
    velocity = (float(along[0]), float(-along[1]))  # R_psi at psi = 0
    contact = cs.Contact(
        cs.Sphere(radius), object_at=tuple(map(float, at)), finger_velocity=velocity
    )
    return cs.Scene(
        object=surface, contacts=[contact], profile=cs.Profile([SPEED]), duration=1.0 + 2 * AFTER
    )


def _slipping(radius: float) -> cs.Scene:
    """The contact on the plane starts at rest, so that the ball slides; slip dies as exp(-5 t)."""
    contact = cs.Contact(
        cs.Sphere(radius), object_at=(0.0, 0.0), finger_velocity=(1.0, 0.0), object_velocity="rest"
    )
    return cs.Scene(
        object=cs.Plane(),
        contacts=[contact],
        profile=cs.Profile([SPEED]),
        gain=cs.Gain.time(5.0),
        duration=1.0 + 2 * AFTER,
    )


# --- the wrench -----------------------------------------------------------------------------------


class Drive:
    """The wrench on a ball, torque and force, under which it moves exactly as a set-up says.

    It is what the ball's acceleration needs, less the surface's normal force and friction, and a
    soft guide that is zero on the exact path; the guide acts across the normal, so that it does not
    change the normal force.
    """

    def __init__(self, setup: Setup, step: float = 0.0):
        """step : s, in which a simulator holds a force; it gets that of the step's middle."""
        self._ahead, self._guide = step / 2, setup.guide
        self._half = (setup.end + AFTER) / 2
        nodes = self._half * (1 + chebyshev.chebpts2(NODES))
        m = setup.motion(nodes)
        fit = functools.partial(chebyshev.chebfit, self._scaled(nodes), deg=NODES - 1)
        a, alpha = (chebyshev.chebder(fit(y)) / self._half for y in (m.v, m.w))
        force = MASS * chebyshev.chebval(self._scaled(nodes), a).T - PRESSED * m.normal
        torque = INERTIA * chebyshev.chebval(self._scaled(nodes), alpha).T
        if setup.until or setup.guide == "rotation":
            slip = setup.slip(m)
            friction = np.tile([-0.6 * setup.friction * PRESSED, 0.0, 0.0], (NODES, 1))
            if setup.until:
                lengths = np.linalg.norm(slip, axis=1, keepdims=True)
                friction = -setup.friction * PRESSED * slip / lengths
            force -= friction
            torque -= np.cross(-setup.radius * m.normal, friction)
        self._table = fit(np.hstack([torque, force, m.x, m.v, m.normal]))

    def _scaled(self, t: Array) -> Array:
        return t / self._half - 1

    def _at(self, t: float) -> Array:
        angle = math.acos(min(1.0, max(-1.0, t / self._half - 1)))
        return np.cos(angle * np.arange(NODES)) @ self._table

    def __call__(self, t: float, x: Array, v: Array, turned: Array, w: Array) -> Array:
        """Torque and force (6,) at a time, from centre, velocity, rotation matrix, and w."""
        wrench = self._at(t + self._ahead)[:6]
        stiffness, damping = GUIDE[self._guide]
        if self._guide == "rotation":
            skew = turned - turned.T
            tilt = 0.5 * np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
            wrench[:3] -= stiffness * tilt + damping * w
        else:
            now = self._at(t)
            pull = stiffness * (now[6:9] - x) + damping * (now[9:12] - v)
            normal = now[12:15]
            wrench[3:] += pull - normal * (normal @ pull)
        return wrench


# --- checking exact motions -----------------------------------------------------------------------


def proof(setup: Setup) -> float:
    """How far the exact motion's end is off one integrated independently (see `Motion.off`)."""
    start = setup.motion(np.zeros(1))
    p = start.x[0] - setup.radius * start.normal[0]
    state = np.hstack([p, start.v[0], start.w[0], start.turned[0].as_quat()])
    drive = Drive(setup) if setup.guide else None
    if setup.until:
        state = _solved(setup, drive, state, 0.0, setup.until, rolling=False)
    if setup.until < setup.end:
        state = _solved(setup, drive, state, setup.until, setup.end, rolling=True)
    normal, _ = _normal(setup.surface, state[:3])
    end = setup.motion(np.array([setup.end]))
    return end.off(state[:3] + setup.radius * normal, Rotation.from_quat(state[9:]))


def _solved(
    setup: Setup, drive: Drive | None, state: Array, start: float, stop: float, rolling: bool
) -> Array:
    slip = setup.slip(setup.motion(np.array([start])))[0]
    ahead = slip / (np.linalg.norm(slip) or 1.0)
    rates = functools.partial(_rates, setup, drive, rolling, ahead)
    options = {"method": "DOP853", "rtol": 3e-14, "atol": 1e-16}
    return solve_ivp(rates, (start, stop), state, **options).y[:, -1]


def _rates(
    setup: Setup, drive: Drive | None, rolling: bool, ahead: Array, t: float, state: Array
) -> Array:
    """Rates of p (contact point), v, w and a quaternion, by Newton and Euler.

    Rolling imposes v = w x r n + V of the surface. Else Coulomb's friction acts against ``ahead``,
    the initial direction of slip, which does not change in these set-ups.
    """
    r, m, inertia = setup.radius, MASS, INERTIA
    p, v, w, quaternion = np.split(state, [3, 6, 9])
    normal, bend = _normal(setup.surface, p)
    spin = setup.table * UP
    turned = Rotation.from_quat(quaternion)
    torque, force = np.zeros(3), m * setup.gravity
    if drive is not None:
        torque, force = np.split(drive(t, p + r * normal, v, turned.as_matrix(), w), 2)
    dp = np.linalg.solve(np.eye(3) + r * bend, v)
    dn = bend @ dp
    if rolling:
        known = r * np.cross(w, dn) + np.cross(spin, dp)
        b = torque + r * np.cross(normal, force - m * known)
        dw = (b + m * r**2 / inertia * normal * (normal @ b)) / (inertia + m * r**2)
        dv = r * np.cross(dw, normal) + known
    else:
        friction = -setup.friction * setup.pressed * ahead
        dw = (torque - r * np.cross(normal, friction)) / inertia
        dv = (force + friction) / m
        dv -= normal * (normal @ dv) + normal * (v @ dn)
    x, y, z, s = quaternion
    rate = s * w + np.cross(w, [x, y, z])
    return np.hstack([dp, dv, dw, 0.5 * rate, -0.5 * (w @ [x, y, z])])


def _normal(surface: cs.Surface, p: Array) -> tuple[Array, Array]:
    """Outward normal, and its derivative by the point (3, 3)."""
    if isinstance(surface, cs.Plane):
        return UP, np.zeros((3, 3))
    axes = axes_of(surface)
    gradient = p / axes**2
    size = np.linalg.norm(gradient)
    normal = gradient / size
    return normal, (np.eye(3) - np.outer(normal, normal)) @ np.diag(axes**-2) / size
