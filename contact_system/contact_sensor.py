r"""Contact states from a measured relative motion of the bodies: nothing of a plan is needed.

Where two bodies touch, or would touch next, follows from their relative pose alone: the points
x_1, x_2 at which the line that joins them is normal to both surfaces. Newton's method finds them,
and its step is Montana's forward map (:func:`contact_system.kinematics.contact_velocities`): how
far contact points have to move so that normals turn by what they miss, and so that the line stands
on both surfaces. A gap g between the bodies is met by moving the object's surface out to the
finger, which makes its curvature form ``(I + g K_2)^{-1} K_2``.

The rates are then the forward map of the measured twist.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .charts import SX, TINY
from .checks import real_array
from .development import reflection
from .errors import ChartSingularity, ConformalContact, ContactSystemError
from .geometry import implicit_geometry, upper_inverse
from .kernels import Kernel, per_structure
from .kinematics import SINGULAR, contact_velocities
from .scene import Scene, require_scene
from .surfaces import Surface
from .user_surfaces import ParametricSurface

MOST_STEPS = 30
ROWS = 40  # of a Measurement
SETTLED = 1e3  # steps at which rounding may hold Newton's method up, in those asked for
NO_ROTATION = 1e-2  # what is measured may miss a rotation by its noise
GRID = 25  # points in each coordinate of a finger, of which the nearest to the object is sought
LONGEST_STEP = 0.5  # of the body's size, where bodies are far apart


class Measurement:
    """What a relative pose and twist say about n contacts.

    Not finite where there is no contact frame.

    Attributes
    ----------
    table : (n, 40)
        All of it.
    step : (n,)
        Length of the step that Newton's method would take next, m.
    relative : (n,)
        det of the relative curvature over the square of its size: 0 where bodies conform.
    states : (n, 9)
        u1 v1 u1' v1' u2 v2 u2' v2' psi, principal values.
    slip : (n, 2)
        v_rel in E2, m/s.
    points : (n, 2, 3)
        x_1 on the finger and x_2 on the object, each in its body's frame, m.
    frame : (n, 3, 3)
        E2, rows x, y, n, in the object's frame.
    surfaces : (n, 20)
        x_2, E2 as in `frame`, K_2, K_1 in E2, 1/m.
    gap : (n,)
        Distance of the surfaces along the normal, negative where they overlap, m.
    velocity : (n, 3)
        Of the contact point on the object, in its frame, m/s.
    """

    def __init__(self, table: np.ndarray):
        n, self.table = len(table), table
        self.step, self.relative, self.gap = table[:, 0], table[:, 1], table[:, 36]
        self.velocity = table[:, 37:40]
        self.states, self.slip = table[:, 2:11], table[:, 11:13]
        self.points = table[:, 13:19].reshape(n, 2, 3)
        self.frame, self.surfaces = table[:, 19:28].reshape(n, 3, 3), table[:, 16:36]


def measured_states(
    scene: Scene, pose: ArrayLike, twist: ArrayLike, points: ArrayLike
) -> np.ndarray:
    """States of a scene's contacts from the measured relative motion of the bodies.

    Parameters
    ----------
    scene : Scene
        Its surfaces and the order of its contacts; its motion does not matter.
    pose : (n, 4, 4)
        X_OF, the finger's body frame in the object's.
    twist : (n, 6)
        V_OF_O, rad/s then m/s, as :meth:`Plan.twist` gives it.
    points : (n, 3)
        Points near the contacts, such as contact physics reports, in the object's frame, m.
        They choose among the places where bodies could touch and do not enter the result.

    Returns
    -------
    (n, 9)
        u1 v1 u1' v1' u2 v2 u2' v2' psi, as :meth:`Plan.states` gives them, in principal values.
        Bodies are taken as touching: the rates fulfil ``R_psi M1 q1' - M2 q2' = v_rel`` with the
        slip measured at the object's surface.

    Raises
    ------
    ContactSystemError
        A wrong shape, NaN, a pose that is no rigid motion, or points from which no contact is
        found.
    ChartSingularity
        A contact is at a pole or an umbilic, or out of sight of an implicit surface's center.
    ConformalContact
        The twist does not determine where the bodies touch.
    """
    require_scene(scene)
    sensor = scene.__dict__.get("_sensor")
    if sensor is None:
        sensor = scene.__dict__["_sensor"] = ContactSensor(scene)
    n = sensor.count
    arrays = []
    for given, name, shape in (
        (pose, "pose", (4, 4)), (twist, "twist", (6,)), (points, "points", (3,)),
    ):  # fmt: skip
        try:
            a = real_array(given)
        except (TypeError, ValueError, OverflowError):
            raise ContactSystemError(
                f"{scene.title}: {name} = {given!r:.80}; give numbers, shape {(n, *shape)}"
            ) from None
        arrays.append(a)
        if a.shape != (n, *shape):
            raise ContactSystemError(
                f"{scene.title}: {name} has shape {a.shape}; give {(n, *shape)}"
            )
        if not np.isfinite(a).all():
            raise ContactSystemError(f"{scene.title}: {name} has a NaN or infinity")
    _check_rigid(scene, arrays[0])
    found = sensor.measure(arrays[0][:, :3].reshape(n, 12), *arrays[1:])
    sensor.check(found)
    return found.states


def _check_rigid(scene: Scene, pose: np.ndarray) -> None:
    """Refuse poses (n, 4, 4) that are no rigid motion, such as transposed ones."""
    turn = pose[:, :3, :3]
    missed = np.abs(np.matmul(turn, turn.swapaxes(1, 2)) - np.eye(3)).max((1, 2))
    missed = np.fmax(missed, np.abs(pose[:, 3] - [0, 0, 0, 1]).max(1))
    wrong = np.flatnonzero((missed > NO_ROTATION) | (np.linalg.det(turn) < 0))
    if len(wrong):
        i = int(wrong[0])
        raise ContactSystemError(
            f"{scene.title}, contact {i}: pose = {pose[i].tolist()} is no rotation and "
            "translation over the row 0, 0, 0, 1; give X_OF, the finger's frame in the object's"
        )


class ContactSensor:
    """Measures the contacts of one scene, again and again.

    Parameters
    ----------
    scene : Scene
    tolerance : float
        Of the places of the contacts, as a fraction of the smallest body's size. From points that
        contact physics reports Newton's steps shrink as 2e-3, 4e-6, 2e-11.
    """

    def __init__(self, scene: Scene, tolerance: float = 1e-13):
        self.scene, self.count = scene, len(scene.contacts)
        sizes = [scene.object.size, *(contact.finger.size for contact in scene.contacts)]
        self._small = tolerance * min(sizes)
        # steps shrink as their squares do: what stays above is rounding, as of a far larger body
        self._settled = max(SETTLED * self._small, 1e-15 * max(sizes))
        kinds: dict[object, list[int]] = {}
        for i, contact in enumerate(scene.contacts):
            kinds.setdefault(contact.finger.structure, []).append(i)
        self._groups = [_Group(scene, contacts) for contacts in kinds.values()]

    def measure(
        self,
        pose: np.ndarray,
        twist: np.ndarray,
        points: np.ndarray,
        share: np.ndarray | float = 0,
        slip: np.ndarray | None = None,
    ) -> Measurement:
        """Measure all contacts; see :func:`measured_states`, whose checks are left out here.

        Parameters
        ----------
        pose : (n, 12)
            The upper three rows of X_OF, row by row.
        twist : (n, 6)
        points : (n, 3)
        share : (n,) or float
            Where slip is taken: 0 at the object's surface, 1 at the finger's, between them where
            they overlap.
        slip : (n, 2), optional
            Known v_rel in E2, m/s, to be used instead of what the twist says.

        Returns
        -------
        Measurement
        """
        table = np.empty((self.count, ROWS))
        for group in self._groups:
            table[group.contacts] = group.find(pose, twist, points, share, slip, self._small)
        return Measurement(table)

    def approach(self, pose: np.ndarray, away: Iterable[int]) -> np.ndarray:
        """Points near which those that are away would touch: (n, 12) -> (len(away), 3), m."""
        obj, fingers = self.scene.object, [contact.finger for contact in self.scene.contacts]
        return np.array([_ahead(fingers[i], obj, pose[i].reshape(3, 4)) for i in away])

    def check(self, found: Measurement) -> None:
        """Raise what is wrong with a measurement; see :func:`measured_states`."""
        for i in range(self.count):
            what = f"{self.scene.title}, contact {i}"
            if abs(found.relative[i]) <= SINGULAR:
                raise ConformalContact(
                    f"{what}: the surfaces conform to each other at the contact, so a twist does "
                    "not determine where they touch; change a radius or a surface"
                )
            if not np.isfinite(found.states[i]).all():
                at = found.points[i].tolist()
                raise ChartSingularity(
                    f"{what}: measured at a pole, an umbilic or out of sight of an implicit "
                    f"surface's center, where there is no contact frame ({at[0]} m on the finger, "
                    f"{at[1]} m on the object); measure nearby, turn the body's axes so that the "
                    "pole lies elsewhere, or choose another center"
                )
            if not found.step[i] <= self._settled:
                raise ContactSystemError(
                    f"{what}: no common normal of the surfaces is found, the next step is "
                    f"{found.step[i]:.3g} m; give a point nearer to the contact"
                )


class _Group:
    """Contacts whose fingers are of one kind."""

    def __init__(self, scene: Scene, contacts: list[int]):
        self.contacts = np.array(contacts)
        self.surfaces = [scene.contacts[i].finger for i in contacts], scene.object
        self.kernel = contact_kernel(self.surfaces[0][0], scene.object)
        self.n_start = tuple(_unknowns(s) for s in (self.surfaces[0][0], scene.object))
        obj = (*scene.object.parameters, scene.object.size)
        self.constants = np.array([(*f.parameters, f.size, *obj) for f in self.surfaces[0]])

    def find(
        self,
        pose: np.ndarray,
        twist: np.ndarray,
        points: np.ndarray,
        share: np.ndarray | float,
        slip: np.ndarray | None,
        small: float,
    ) -> np.ndarray:
        """Newton's method: (n_contacts of the group, n_result without the next start)."""
        machine, n = self.kernel.machine(len(self.contacts)), sum(self.n_start)
        x, y = machine.x, machine.y
        machine.c[:] = self.constants
        x[:, n : n + 12] = pose = pose[self.contacts]
        x[:, n + 12 : n + 18] = twist[self.contacts]
        x[:, n + 18] = share if np.isscalar(share) else share[self.contacts]  # type: ignore
        x[:, n + 19] = slip is not None
        x[:, n + 20 : n + 22] = 0.0 if slip is None else slip[self.contacts]
        x[:, :n] = self._start(pose.reshape(-1, 3, 4), points[self.contacts])
        machine.run()
        first = y[:, n + 1].copy()
        for _ in range(MOST_STEPS):
            if not (y[:, n] > small).any():
                break
            framed = ~np.isnan(y[:, n])
            x[framed, :n] = y[framed, :n]
            machine.run()
        # steps along bodies that conform lead anywhere, and there bodies may not
        conform = (np.abs(first) <= SINGULAR) & ~(y[:, n] <= small)
        y[conform, n + 1] = first[conform]
        return y[:, n:]

    def _start(self, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Both sides' unknowns from points near the contacts."""
        of_finger = np.matmul((points - pose[:, :, 3])[:, None], pose[:, :, :3])[:, 0]
        fingers, obj = self.surfaces
        sides = ((fingers, of_finger), ([obj] * len(points), points))
        return np.hstack([
            x if _unknowns(surfaces[0]) == 3 else
            np.array([_nearest(s, at) for s, at in zip(surfaces, x)])
            for surfaces, x in sides
        ])  # fmt: skip


# --- symbolic ----------------------------------------------------------------------------------


def _unknowns(surface: Surface) -> int:
    """A contact point is sought in space, or by its coordinates where there is only a chart."""
    return 3 if surface.has_implicit else 2


@dataclass
class _Side:
    """A body at the unknowns z: a point, by `missed` off its surface, or coordinates."""

    x: SX
    frame: SX
    metric_root: SX
    curvature: SX
    coordinates: SX
    z: SX
    missed: SX

    @property
    def tangents(self) -> SX:
        return self.frame[:, :2]

    @property
    def normal(self) -> SX:
        return self.frame[:, 2]

    def rates(self, velocity: SX) -> SX:
        return upper_inverse(self.metric_root) @ velocity

    def moved(self, step: SX) -> SX:
        return self.z + (self.tangents @ step if self.z.numel() == 3 else self.rates(step))


def _side(surface: Surface, p: SX, z: SX) -> _Side:
    if z.numel() == 2:
        shape = surface.geometry_expr(p, z[0], z[1])
        return _Side(shape.point, shape.frame, shape.metric_root, shape.curvature_form, z, z, SX(0))
    level = surface.implicit_expr(p, z)
    gradient, hessian = implicit_geometry(level, z)
    x_axis, y_axis, metric_root = surface.frame_expr(p, z)
    tangents = ca.horzcat(x_axis, y_axis)
    curvature = tangents.T @ hessian @ tangents / ca.norm_2(gradient)
    frame = ca.horzcat(tangents, ca.cross(x_axis, y_axis))
    coordinates = ca.vertcat(*surface.coordinates_expr(p, z))
    # all of it one Newton step nearer to the surface: what is left is the distance's square
    x = z - level * gradient / ca.dot(gradient, gradient)
    there = ca.substitute([frame, metric_root, curvature, coordinates], [z], [x])
    frame, metric_root, curvature, coordinates = there
    return _Side(x, frame, metric_root, curvature, coordinates, x, ca.norm_2(x - z))


@per_structure
def contact_kernel(finger: Surface, obj: Surface) -> Kernel:
    """Kernel of one contact: a Newton step towards it, and all that is measured.

    point: unknowns of finger and object, X_OF (12, row by row), V_OF_O (6), share, whether slip is
    known, known slip (2).
    constant: parameters and size of the finger, and of the object.
    result: next unknowns, length of the step, det of the relative curvature over its square,
    states (9), slip (2), x_1, x_2 (6), E2 (9), K_2, K_1 in E2 (8), gap, velocity (3).
    """
    z1, z2 = SX.sym("z1", _unknowns(finger)), SX.sym("z2", _unknowns(obj))
    pose, twist, share = SX.sym("pose", 12), SX.sym("twist", 6), SX.sym("share")
    is_known, known = SX.sym("is_known"), SX.sym("known", 2)
    p1, p2 = SX.sym("p1", len(finger.parameters) + 1), SX.sym("p2", len(obj.parameters) + 1)
    rows = ca.reshape(pose, 4, 3).T
    turn, origin = rows[:, :3], rows[:, 3]
    tip, body = _side(finger, p1[:-1], z1), _side(obj, p2[:-1], z2)
    between = turn @ tip.x + origin - body.x
    gap = ca.dot(body.normal, between)
    alike = body.tangents.T @ turn @ tip.tangents
    psi = ca.atan2(-(alike[0, 1] + alike[1, 0]), alike[0, 0] - alike[1, 1])
    map_21 = reflection(ca.cos(psi), ca.sin(psi))

    # Newton's step: as velocities that turn the normals and move the points by what they miss
    missed = map_21 @ (body.tangents.T @ (-turn @ tip.normal - body.normal))
    outside = _solve(SX.eye(2) + gap * body.curvature, body.curvature)
    step_1, step_2 = contact_velocities(
        tip.curvature, outside, map_21, missed, -body.tangents.T @ between, _solve
    )
    step_2 = _solve(SX.eye(2) + gap * body.curvature, step_2)
    step_1, step_2 = (_shortened(s, LONGEST_STEP * p[-1]) for s, p in ((step_1, p1), (step_2, p2)))

    # what the twist says, of bodies taken as touching
    at = body.x + share * between
    seen = -body.tangents.T @ (twist[3:] + ca.cross(twist[:3], at - origin))
    slip = ca.if_else(is_known, known, seen)
    omega = tip.tangents.T @ (turn.T @ twist[:3])
    bend = ca.vertcat(-omega[1], omega[0])
    a1, a2 = contact_velocities(tip.curvature, body.curvature, map_21, bend, slip, _solve)
    tip_curvature = map_21 @ tip.curvature @ map_21
    relative = body.curvature + tip_curvature
    size = ca.norm_fro(tip.curvature) + ca.norm_fro(body.curvature)
    relative = ca.det(relative) / ca.fmax(size**2, TINY)  # planes, of no curvature, conform too
    result = ca.vertcat(
        tip.moved(step_1), body.moved(step_2),
        ca.norm_2(ca.vertcat(step_1, step_2, tip.missed, body.missed)), relative,
        tip.coordinates, tip.rates(a1), body.coordinates, body.rates(a2), psi,
        slip, tip.x, body.x, ca.vec(body.frame), ca.vec(body.curvature),
        ca.vec(tip_curvature), gap, body.tangents @ a2,
    )  # fmt: skip
    point, constant = ca.vertcat(z1, z2, pose, twist, share, is_known, known), ca.vertcat(p1, p2)
    return Kernel("measured", point, constant, result)


def _solve(a: SX, b: SX) -> SX:
    """Cramer's rule for 2x2."""
    adjugate = ca.vertcat(ca.horzcat(a[1, 1], -a[0, 1]), ca.horzcat(-a[1, 0], a[0, 0]))
    return adjugate @ b / (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0])


def _shortened(step: SX, longest: SX) -> SX:
    return step * ca.fmin(1, longest / (ca.norm_2(step) + 1e-300))


# --- where to begin ----------------------------------------------------------------------------


def _nearest(surface: Surface, x: np.ndarray) -> np.ndarray:
    """(u, v) of the point nearest to one point, (2,)."""
    assert isinstance(surface, ParametricSurface)  # the only kind without a level function
    return np.array(surface.nearest(x)[:2])


def _ahead(finger: Surface, obj: Surface, pose: np.ndarray) -> np.ndarray:
    """Of a grid of points on a finger the one that is nearest to the object, in its frame, (3,)."""
    turn, origin = pose[:, :3], pose[:, 3]
    points = _grid(finger, -_height(obj, origin, origin[None])[0, 1:] @ turn, obj.size)
    points = points @ turn.T + origin
    return points[np.nanargmin(_height(obj, origin, points)[:, 0])]


def _grid(finger: Surface, foot: np.ndarray, reach: float) -> np.ndarray:
    """Points around a finger, and where it has no end as far as another body reaches: (n, 3)."""
    at = finger.coordinates(foot) if finger.has_implicit else _nearest(finger, foot)
    at, part, rows = np.nan_to_num(at), np.linspace(-1, 1, GRID), []
    for w, lame, period in zip(at, finger.lame(*at), finger.periods()):
        half = (reach + 2 * finger.size) / lame if period is None else period / 2
        rows.append(w + half * part)
    u, v = np.meshgrid(*rows)
    return finger.point(u.ravel(), v.ravel())


def _height(surface: Surface, origin: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Of points (n, 3) their height over a body, to first order, and the way up to there: (n, 4).

    Of a body known by its chart only the plane is taken that touches it below the origin.
    """
    if surface.has_implicit:
        constants = np.broadcast_to(surface.parameters, (len(points), len(surface.parameters)))
        return _height_kernel(surface).at(points, constants)
    below = _nearest(surface, origin)
    normal = surface.normal(*below)
    heights = (points - surface.point(*below)) @ normal
    return np.column_stack([heights, np.multiply.outer(heights, normal)])


@per_structure
def _height_kernel(surface: Surface) -> Kernel:
    x, p = SX.sym("x", 3), SX.sym("p", len(surface.parameters))
    level = surface.implicit_expr(p, x)
    gradient = ca.gradient(level, x)
    size = ca.norm_2(gradient) + TINY  # 0 at the centre
    return Kernel("height", x, p, ca.vertcat(level, level * gradient / size) / size)
