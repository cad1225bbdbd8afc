r"""Contact states from the measured relative motion of the bodies, without a plan.

The relative pose determines the points x_1, x_2 at which the bodies touch, or would touch next:
the line that joins them is normal to both surfaces. Newton's method finds them. Its step is
Montana's forward map (:func:`.theory.equations.contact_velocities`), which moves the contact points
until the normals oppose each other and the line is normal to both surfaces. For a gap g between the
bodies the object's surface is offset by g, so that its curvature form is ``(I + g K_2)^{-1} K_2``.

The rates are the forward map of the measured twist.
"""

from __future__ import annotations

import ctypes
import functools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import rigid_motion, shaped_array
from .engine.binding import Machine, Sensor, run, sense
from .errors import ChartSingularity, ConformalContact, ContactSystemError
from .scene import Scene, require_scene
from .surfaces import SINGULAR, ParametricSurface, Surface
from .surfaces.plane import is_plane
from .theory import symbols as ca
from .theory.equations import contact_velocities, reflection, relative_curvature, solve_plane
from .theory.geometry import number_symbols, numbers_function, upper_inverse
from .theory.lowering import Table
from .theory.symbols import per_structure

CONFORMAL = 1e-12  # bodies conform up to this det of the relative curvature/(|K_1| + |K_2|)^2
FLAT = 1e-8  # curvature times the greater body's size, below which it may be rounding
MOST_STEPS = 200
SETTLED = 1e3  # a last step this many times as long as wanted may still be rounding
NOISE = 1e-2  # by which a measured rotation matrix may differ from a rotation
NEARBY = 0.02  # fraction of the body's size; contacts move less between two measurements
GRID = 25  # points in each coordinate of a finger, of which the one nearest to the object is taken
LONGEST_STEP = 0.5  # of Newton's method, over a curved body's size, as bodies may be far apart
SEEN = 22  # numbers of `Probe.seen`
# columns of `Probe.found`, the results of `measured_contact` after the next unknowns; FOUND: all
STEP, RELATIVE, STATES, SLIP, ON_FINGER = 0, 1, slice(2, 11), slice(11, 13), slice(13, 16)
ON_OBJECT, FRAME, NORMAL, GAP, FOUND = slice(16, 19), slice(19, 28), slice(25, 28), 36, 37


def measured_states(
    scene: Scene, pose: ArrayLike, twist: ArrayLike, points: ArrayLike
) -> np.ndarray:
    """States of a scene's contacts from the measured relative motion of the bodies.

    Parameters
    ----------
    scene : Scene
        Only its surfaces and the order of its contacts matter.
    pose : (n, 4, 4)
        X_OF, the finger's body frame in the object's.
    twist : (n, 6)
        V_OF_O, rad/s then m/s, as :meth:`Plan.twist` gives it.
    points : (n, 3)
        Points near the contacts, in the object's frame, m, such as contact physics reports. They
        select one of the places where the bodies may touch, and have no other effect.

    Returns
    -------
    (n, 9)
        u1 v1 u1' v1' u2 v2 u2' v2' psi, as :meth:`Plan.states` gives them, in principal values.
        The rates satisfy ``R_psi M1 q1' - M2 q2' = v_rel``, as for touching bodies, with the slip
        at the object's surface.

    Raises
    ------
    ContactSystemError
        A wrong shape, NaN, a pose that is no rigid motion, or points from which no contact is
        found.
    ChartSingularity
        A contact is at a pole or an umbilic, or not visible from an implicit surface's center.
    ConformalContact
        The twist does not determine the rates.
    """
    require_scene(scene)
    poses = _given(scene, "pose", pose, (4, 4))
    others = _given(scene, "twist", twist, (6,)), _given(scene, "points", points, (3,))
    states = []
    for i, (probe, pose_i, twist_i, point) in enumerate(zip(probes_of(scene), poses, *others)):
        what = f"{scene.title}, {scene.contact_title(i)}"
        rigid_motion(pose_i, f"{what}: pose", NOISE, ContactSystemError)
        probe.seen[:18] = *pose_i[:3].ravel(), *twist_i
        probe.find(point)
        states.append(probe.states(what))
    return np.array(states)


def _given(scene: Scene, name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """A finite measurement of every contact."""
    shape = (len(scene.contacts), *shape)
    return shaped_array(value, f"{scene.title}: {name}", shape, ContactSystemError, finite=True)


def limits_of(scene: Scene, tolerance: float = 1e-13) -> Sensor:
    """When Newton's method ends for a scene's contacts.

    tolerance : error of the contact points, as a fraction of the smallest body's size; from points
    that contact physics reports, Newton's steps shrink as 2e-3, 4e-6, 2e-11
    """
    sizes = [surface.size for surface in scene.surfaces]
    small = tolerance * min(sizes)
    # steps shrink quadratically: a step that stays above is rounding, as of a far larger body
    settled = max(SETTLED * small, 1e-15 * max(sizes))
    return Sensor(small, MOST_STEPS, settled, CONFORMAL)


def probes_of(scene: Scene, tolerance: float = 1e-13) -> list[Probe]:
    """A probe for each contact of a scene; tolerance: see `limits_of`."""
    (obj, *fingers), limits = scene.surfaces, limits_of(scene, tolerance)
    return [Probe(finger, obj, limits) for finger in fingers]


class Probe:
    """Measures one contact, again and again; one thread at a time.

    Attributes
    ----------
    seen : (22,)
        Inputs, written by the caller: the upper three rows of X_OF, row by row; V_OF_O; the place
        of slip, from 0 at the object's surface to 1 at the finger's; whether slip is known, and
        then v_rel in E2, m/s, which replaces the slip of the twist.
    found : (37,)
        Not finite if there is no contact frame. Length of the next step of Newton's method, m; det
        of the relative curvature over (|K_1| + |K_2|)^2; u1 v1 u1' v1' u2 v2 u2' v2' psi, principal
        values; v_rel in E2, m/s; x_1 on the finger and x_2 on the object,
        each in its body's frame, m; E2, column by column, in the object's frame; K_2, K_1 in E2,
        1/m; distance along the normal, negative where the bodies overlap, m.
    limits : Sensor
        When Newton's method ends, and the longest accepted last step, m.
    """

    def __init__(self, finger: Surface, obj: Surface, limits: Sensor):
        numbers = *finger.numbers, finger.size, *obj.numbers, obj.size
        self._machine = machine = Machine(measurement(finger, obj), numbers)
        n = len(machine.point) - SEEN
        self._x, self.seen, self.found = *np.split(machine.point, [n]), machine.results[n:]
        self._pose, self.limits = self.seen[:12].reshape(3, 4), limits
        self._sense = functools.partial(sense, *machine.addresses, n, ctypes.byref(limits))
        self._surfaces = finger, obj
        self._in_space = not any(isinstance(s, ParametricSurface) for s in self._surfaces)
        self._x[:] = np.nan  # no last measurement

    def find(self, point: Any, of_finger: Any = None) -> np.ndarray:
        """Newton's method from a point near the contact, until steps are small; returns `found`.

        point, of_finger : (3,), in the object's frame and, if known, in the finger's
        """
        x, found = self._x, self.found
        if of_finger is None:
            of_finger = (point - self._pose[:, 3]) @ self._pose[:, :3]
        n = 2 if isinstance(self._surfaces[0], ParametricSurface) else 3
        near = zip(self._surfaces, (of_finger, point), (x[:n], x[n:]))
        x[:] = np.concatenate([_unknowns(surface, p, last) for surface, p, last in near])
        self._sense()
        for at, surface in zip((found[2:4], found[6:8]), self._surfaces):
            if isinstance(surface, ParametricSurface):
                at[:] = surface._wrap(*at)
        return found

    def states(self, what: str) -> np.ndarray:
        """The states found, (9,); raises errors as :func:`measured_states`, which name `what`."""
        found = self.found
        if abs(found[RELATIVE]) <= CONFORMAL:
            raise ConformalContact(
                f"{what}: the surfaces conform to each other at the contact, so a twist does "
                "not determine where they touch; change a radius or a surface"
            )
        if found[STEP] > self.limits.settled:
            raise ContactSystemError(
                f"{what}: no common normal of the surfaces was found, the next step is "
                f"{found[STEP]:.3g} m; give a point nearer to the contact"
            )
        if not np.isfinite(found[STATES]).all():
            raise ChartSingularity(
                f"{what}: measured at a pole, an umbilic or out of sight of an implicit "
                "surface's center, where there is no contact frame "
                f"({found[ON_FINGER].tolist()} m on the finger, {found[ON_OBJECT].tolist()} m on "
                "the object); measure nearby, turn the body's axes so that the "
                "pole lies elsewhere, or choose another center"
            )
        at, (finger, obj) = found[STATES], self._surfaces
        if self._in_space or self._pose[:, :3] @ finger.normal(*at[:2]) @ obj.normal(*at[4:6]) < 0:
            return at
        raise ContactSystemError(  # a chart like a sphere's has points twice, at u and at -u
            f"{what}: f_u x f_v of a ParametricSurface points into its body at {at[:2].tolist()} "
            f"of the finger or {at[4:6].tolist()} of the object; give it a u_range and v_range in "
            "which f_u x f_v points out of the body"
        )

    def approach(self) -> np.ndarray:
        """A point near which bodies that are apart would touch, in O: (3,), m.

        Of a grid of points on the finger, it is the one nearest to the object.
        """
        finger, obj = self._surfaces
        turn, origin = self._pose[:, :3], self._pose[:, 3]
        up = np.nan_to_num(_height(obj, origin, origin[None])[0, 1:])  # NaN at a centre
        points = _grid(finger, -up @ turn, obj.size) @ turn.T + origin
        return points[np.nanargmin(_height(obj, origin, points)[:, 0])]


def _unknowns(surface: Surface, x: np.ndarray, last: np.ndarray | None = None) -> np.ndarray:
    """Newton's unknowns for a point near the surface: the point, or (u, v) on a chart surface.

    If the contact has hardly moved since the last measurement, its unknowns ``last`` are taken: a
    search over the whole chart takes a hundred times as long.
    """
    if not isinstance(surface, ParametricSurface):
        return x
    if last is not None and np.linalg.norm(surface.point(*last) - x) <= NEARBY * surface.size:
        return last
    return np.array(surface.nearest(x)[:2])


# --- symbolic ----------------------------------------------------------------------------------


class _Side:
    """A body as a function, in symbols, of its unknowns: a point near it, or (u, v).

    constants: sign, parameters and size. missed: distance of the point from the surface, m.
    """

    def __init__(self, surface: Surface):
        self.size, numbers = ca.SX.sym("size"), number_symbols(surface)
        self.constants = ca.vertcat(numbers, self.size)
        self.in_space, self.flat = surface.has_implicit, is_plane(surface)
        self.unknowns = z = ca.SX.sym("z", 3 if self.in_space else 2)
        if not self.in_space:
            at = surface.geometry_expr(numbers, z)
            self.x, self.tangents, self.normal = at.point, at.frame[:, :2], at.frame[:, 2]
            self.metric_root, self.curvature = at.metric_root, at.curvature_form
            self.coordinates, self.missed = z, ca.SX(0)
            return
        level, gradient, hessian = surface.level_geometry(numbers[1:], z)
        x_axis, y_axis, metric_root = surface.frame_expr(numbers, z)
        tangents = ca.horzcat(x_axis, y_axis)
        curvature = numbers[0] * (tangents.T @ hessian @ tangents) / ca.norm_2(gradient)
        coordinates = ca.vertcat(*surface.coordinates_expr(numbers, z))
        # one Newton step onto the surface squares the distance from it
        self.x = z - level * gradient / ca.dot(gradient, gradient)
        quantities = [tangents, metric_root, curvature, coordinates]
        self.tangents, self.metric_root, self.curvature, self.coordinates = ca.substitute(
            quantities, [z], [self.x]
        )
        self.normal = ca.cross(self.tangents[:, 0], self.tangents[:, 1])
        self.missed = ca.norm_2(self.x - z)

    def rates(self, velocity: ca.SX) -> ca.SX:
        return upper_inverse(self.metric_root) @ velocity

    def framed(self) -> ca.SX:
        """Whether there is a contact frame, by the criterion of `Surface.canonical`."""
        return ca.fmin(self.metric_root[0, 0], self.metric_root[1, 1]) > SINGULAR * self.size

    def shortened(self, step: ca.SX) -> ca.SX:
        if self.flat:
            return step
        return step * ca.fmin(1, LONGEST_STEP * self.size / (ca.norm_2(step) + 1e-300))

    def moved(self, step: ca.SX) -> ca.SX:
        """The next unknowns."""
        return self.x + self.tangents @ step if self.in_space else self.unknowns + self.rates(step)


@per_structure
def measurement(finger: Surface, obj: Surface) -> Table:
    """The table of `measured_contact`, without M_1 and M_2."""
    point, constants, *results = measured_contact(finger, obj)
    result = ca.densify(ca.vertcat(*results[:-1]))
    return Table(ca.Function("measured", [point, constants], [result]))


def measured_contact(finger: Surface, obj: Surface) -> list[ca.SX]:
    """Point, constants and results of one contact: a step of Newton's method, and the measurement.

    point: unknowns of finger and object, X_OF (12, row by row), V_OF_O (6), place of slip, whether
    slip is known, known slip (2).
    constants: sign, parameters and size of the finger, and of the object.
    results: next unknowns; the numbers of `Probe.found`; M_1, M_2 (8).
    """
    pose, twist, share = ca.SX.sym("pose", 12), ca.SX.sym("twist", 6), ca.SX.sym("share")
    is_known, known = ca.SX.sym("is_known"), ca.SX.sym("known", 2)
    tip, body = _Side(finger), _Side(obj)
    rows = ca.reshape(pose, 4, 3).T
    turn, origin = rows[:, :3], rows[:, 3]
    between = turn @ tip.x + origin - body.x
    axes = body.tangents.T @ turn @ tip.tangents
    psi = ca.atan2(-(axes[0, 1] + axes[1, 0]), axes[0, 0] - axes[1, 1])
    map_21 = reflection(ca.cos(psi), ca.sin(psi))
    step_1, step_2 = _newton_step(tip, body, turn, between, map_21)
    # rates from the twist, as of touching bodies
    at = body.x + share * between
    of_twist = -body.tangents.T @ (twist[3:] + ca.cross(twist[:3], at - origin))
    slip = ca.if_else(is_known, known, of_twist)
    omega = tip.tangents.T @ (turn.T @ twist[:3])
    rolling = ca.vertcat(-omega[1], omega[0])
    a1, a2 = contact_velocities(tip.curvature, body.curvature, map_21, rolling, slip)
    relative = ca.det(relative_curvature(body.curvature, tip.curvature, map_21))
    size = ca.norm_fro(tip.curvature) + ca.norm_fro(body.curvature)
    flat = FLAT / ca.fmax(tip.size, body.size)
    states = ca.vertcat(tip.coordinates, tip.rates(a1), body.coordinates, body.rates(a2), psi)
    point = ca.vertcat(tip.unknowns, body.unknowns, pose, twist, share, is_known, known)
    return [
        point,
        ca.vertcat(tip.constants, body.constants),
        ca.vertcat(tip.moved(step_1), body.moved(step_2)),
        ca.norm_2(ca.vertcat(step_1, step_2, tip.missed, body.missed)),
        relative / ca.fmax(size, flat) ** 2,  # tiny also if both are flat to within rounding
        ca.if_else(ca.logic_and(tip.framed(), body.framed()), states, np.nan),
        slip,
        ca.vertcat(tip.x, body.x),
        ca.vertcat(ca.vec(body.tangents), body.normal),
        ca.vertcat(ca.vec(body.curvature), ca.vec(map_21 @ tip.curvature @ map_21)),
        ca.dot(body.normal, between),
        ca.vertcat(ca.vec(tip.metric_root), ca.vec(body.metric_root)),
    ]


def _newton_step(
    tip: _Side, body: _Side, turn: ca.SX, between: ca.SX, map_21: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """The forward map of the errors: of the normals, and of the points across the normal."""
    missed = map_21 @ (body.tangents.T @ (-turn @ tip.normal - body.normal))
    lifted = ca.SX.eye(2) + ca.dot(body.normal, between) * body.curvature
    outside = solve_plane(lifted, body.curvature)
    off = -body.tangents.T @ between
    step_1, step_2 = contact_velocities(tip.curvature, outside, map_21, missed, off)
    return tip.shortened(step_1), body.shortened(solve_plane(lifted, step_2))


# --- where to begin ----------------------------------------------------------------------------


def _grid(finger: Surface, foot: np.ndarray, reach: float) -> np.ndarray:
    """Points of a finger, on an unbounded one as far as the other body reaches: (n, 3)."""
    at = finger.coordinates(foot) if finger.has_implicit else _unknowns(finger, foot)
    at, part, rows = np.nan_to_num(at), np.linspace(-1, 1, GRID), []
    for w, lame, period in zip(at, finger.lame(*at), finger.periods()):
        half = (reach + 2 * finger.size) / lame if period is None else period / 2
        rows.append(w + half * part)
    u, v = np.meshgrid(*rows)
    return finger.point(u.ravel(), v.ravel())


def _height(surface: Surface, origin: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Height of points (n, 3) over a body to first order, and that height as a vector: (n, 4).

    A body given by its chart is replaced by its tangent plane below the origin.
    """
    if surface.has_implicit:
        return run(_heights(surface), points.T, surface.numbers).T
    below = _unknowns(surface, origin)
    normal = surface.normal(*below)
    heights = (points - surface.point(*below)) @ normal
    return np.column_stack([heights, np.outer(heights, normal)])


@per_structure
def _heights(surface: Surface) -> Table:
    x, numbers = ca.SX.sym("x", 3), number_symbols(surface)
    level, gradient, _ = surface.level_geometry(numbers[1:], x)
    size = ca.norm_2(gradient)
    height = ca.vertcat(numbers[0] * level, level * gradient / size) / size
    return Table(numbers_function("heights", x, numbers, height))
