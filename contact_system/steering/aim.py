"""A contact's goal as numbers for the engine, which searches for paths (theory section 11)."""

from __future__ import annotations

import ctypes
import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from ..checks import naming
from ..engine import binding
from ..engine.binding import Steer, address
from ..errors import ChartSingularity, SceneError
from ..scene import ROLLING, SIDES, Contact, Scene
from ..surfaces.plane import is_plane
from ..theory.equations import reflection_rows
from .goal import Goal
from .shooting import Array, Follower

MOST_LEGS = 4
LANES = 16
"""Paths that the engine searches at once."""
PARTS = 8
"""Points of a leg at which regions are enforced."""


class Region(NamedTuple):
    """A ball about a point of body 0 or 1, m."""

    side: int
    centre: Array
    radius: float


class Aim(Steer):
    """A contact's goal as numbers; raises a SceneError for an impossible one.

    The engine's fields are explained in engine.h.

    Attributes
    ----------
    name, contact, bodies
        The contact's name in messages, the contact, finger and object.
    sides : tuple of int
        The bodies with a wanted place: 0 the finger, 1 the object.
    start, goal : ((3,), (3, 3)) for each body
        Point and contact frame.
    curvatures : (2, 2)
        Gaussian curvatures of finger and object, at start and goal, 1/m^2.
    goal_psi : float
        psi at the goal.
    pose : (4, 4)
        The finger's pose at the goal, wanted only if `has_rotation`.
    regions : list of Region
        Where the contact must stay.
    sizes : list of float
        Sizes of the bodies, m; for a plane, that of the other body.
    far : float
        Straight distance to the goal, for a pose to its origin, in lengths of s, m.
    """

    def __init__(self, scene: Scene, index: int, goal: Goal, longest: float | None):
        self.name = f"{scene.title}, {scene.contact_title(index)}"
        self.contact = _steerable(scene, index, self.name)
        self.bodies = self.contact.finger, scene.object
        self.psi, self.goal_psi = self.contact.angle, goal.angle or 0.0
        self._place(goal)
        start_pose, self.pose = _pose(self.psi, self.start), _pose(self.goal_psi, self.goal)
        away = [math.dist(self.start[side][0], self.goal[side][0]) for side in self.sides]
        self.is_pose = goal.pose is not None
        self.has_rotation = self.is_pose or goal.angle is not None
        if self.is_pose:
            self.pose = np.array(goal.pose)
            away = [math.dist(start_pose[:3, 3], self.pose[:3, 3])]
        self.rotation[:] = self.pose[:3, :3].ravel().tolist()
        self.origin[:] = self.pose[:3, 3].tolist()
        self.regions = self._regions(goal)
        w: Any = self.contact.finger_velocity
        self.w_length, self.w_angle = math.hypot(*w), math.atan2(w[1], w[0])
        sizes = {body.size for body in self.bodies if not is_plane(body)} or {1.0}
        self.sizes = [min(sizes) if is_plane(body) else body.size for body in self.bodies]
        self.far = max(away) / self.w_length
        radii = [region.radius for region in self.regions]
        unit = min([self._turning_length(), *radii]) / self.w_length
        self.unit = max(unit, 0.05 * self.far)  # far goals take long steps
        self.size = min(self.sizes)  # with a greater one places would weigh too little
        self.longest = (1 - 1e-10) * (longest or 0.0)  # paths keep to it within 1e-12 or so
        self.parts = PARTS if self.regions else 1
        self._followers: list[Follower] = []  # the engine points into them
        for side in (0, 1):
            self._set_body(side)
        off = self.gap(np.array([x for x, _ in self.start]), start_pose)
        self.start_off = float(np.linalg.norm(off))

    @property
    def fewest(self) -> int:
        """Least number of legs with as many unknowns as equations."""
        return (1 + (5 if self.has_rotation else 2 * len(self.sides))) // 2

    def search(self, z: Array, tolerance: float, reached: float) -> tuple[Array, Array, Array]:
        """Gauss-Newton steps from paths z, (2 n, m), until two end within ``reached`` of the goal.

        A path is (phi_1, ..., phi_n, s_1, ..., s_n): directions measured from ``finger_velocity``,
        and lengths along s, m; a path of negative length runs backwards. tolerance: error of a step
        of a geodesic, as a fraction of the size.

        Returns the paths found, (2 n, 16); how far they ended from the goal before the last step,
        in sizes of the smaller body and rad, (16); J^T J then, lengths in ``unit``, (2 n, 2 n, 16).
        """
        rows, count = z.shape
        tried = np.empty((rows, LANES))
        tried[:, :count] = z
        self.tolerance, self.reached = tolerance, reached
        off, squares = np.full(LANES, math.inf), np.empty((rows, rows, LANES))
        out = address(tried), address(off), address(squares)
        if binding.steer(ctypes.addressof(self), rows // 2, count, *out):
            raise MemoryError
        return tried, off, squares

    def gap(self, points: Array, pose: Array) -> Array:
        """Contact points and pose minus those of the goal: one vector, in sizes and rad."""
        parts = [(points[side] - self.goal[side][0]) / self.sizes[side] for side in self.sides]
        if self.has_rotation:
            parts.append((pose[:3, :3] - self.pose[:3, :3]).ravel())
            if self.is_pose:
                parts.append((pose[:3, 3] - self.pose[:3, 3]) / max(self.sizes))
        return np.concatenate(parts)

    # --- helpers --------------------------------------------------------------------------------

    def _place(self, goal: Goal) -> None:
        """Find start and goal on both bodies."""
        sides, self.start, self.goal, curvatures = [], [], [], []
        for side, body in enumerate(self.bodies):
            at = getattr(self.contact, f"{SIDES[side]}_at")
            wanted = getattr(goal, f"{SIDES[side]}_at")
            if wanted is not None:
                sides.append(side)
                with naming(f"{self.name}: goal: {SIDES[side]}_at"):
                    try:
                        regular = body.canonical(*wanted)
                    except ChartSingularity:
                        if goal.angle is not None:
                            raise
                        regular = wanted  # a pole is a place, but psi has no value there
                # on a double cover psi depends on the branch
                wanted = wanted if body.chart.double_cover else regular
            both = np.transpose([at, at if wanted is None else wanted])
            points, frames, forms = body._evaluate(*both, "point", "frame", "curvature_form")
            self.start.append((points[0], frames[0]))
            self.goal.append((points[1], frames[1]))
            curvatures.append(forms[:, 0, 0] * forms[:, 1, 1] - forms[:, 0, 1] ** 2)
        self.sides, self.curvatures = tuple(sides), np.array(curvatures)

    def _turning_length(self) -> float:
        """Size, m, of a closed path that turns the finger by 1 rad with K_1 - K_2 as at the start.

        It is between the sizes of the bodies: large if a small cylinder rolls on a large ball.
        """
        least, greatest = min(self.sizes), max(self.sizes)
        k_1, k_2 = self.curvatures[:, 0].tolist()
        apart = abs(k_1 - k_2)  # NaN if the contact starts at a pole
        return max(least, apart**-0.5) if apart > greatest**-2 else greatest

    def _regions(self, goal: Goal) -> list[Region]:
        """The goal's regions; raises a SceneError if the start or the goal lies outside.

        A search keeps to balls that are a little smaller.
        """
        regions = []
        for side, body in enumerate(self.bodies):
            key = f"{SIDES[side]}_within"
            given = getattr(goal, key)
            if given is None:
                continue
            *at, radius = given
            centre = body.point(*at)  # which may be a pole: it needs no frame
            places = {"start": self.start[side][0]}
            if side in self.sides:
                places["goal"] = self.goal[side][0]
            away = {what: math.dist(place, centre) for what, place in places.items()}
            for what, distance in away.items():
                if not distance <= radius * (1 + 1e-12):
                    raise SceneError(
                        f"{self.name}: {key} = {given}: the {what} lies {distance:.6g} m from that "
                        "point; move it, or widen the region"
                    )
            regions.append(Region(side, centre, radius))
            self.body[side].within[:] = [*centre, max(0.99 * radius, *away.values())]
        return regions

    def _set_body(self, side: int) -> None:
        """Fill the engine's fields of a body."""
        data, body, (x, frame) = self.body[side], self.bodies[side], self.start[side]
        data.wanted = side in self.sides
        data.start[:] = [*x.tolist(), *frame[:, :2].T.ravel().tolist()]
        data.goal[:] = self.goal[side][0].tolist()
        if body.chart.great_circles:
            data.normal_curvature = body.sign / body.size
        elif not is_plane(body):
            follower = Follower(body)
            self._followers.append(follower)
            data.geodesic = ctypes.addressof(follower)
            if not follower.space:
                data.place[:] = [*getattr(self.contact, f"{SIDES[side]}_at"), 0.0]


def _pose(psi: float, both: list[tuple[Array, Array]]) -> Array:
    """The finger's pose, (4, 4), from psi and the contact points and frames of both bodies."""
    frames = np.concatenate([(x, *frame.T[:2]) for x, frame in both]).reshape(-1, 1)
    r = np.ravel(reflection_rows(np.cos(psi), np.sin(psi)))
    found = binding.run(binding.POSE, frames, r)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = found[:9].reshape(3, 3), found[9:, 0]
    return pose


def _steerable(scene: Scene, index: int, name: str) -> Contact:
    """The contact; raises a SceneError if it cannot have legs."""
    contact = scene.contacts[index]
    if contact.follows:
        raise SceneError(f'{name}: finger_velocity = "rolling" has no legs; give it as two numbers')
    if not any(contact.finger_velocity):
        if any(contact.start().object_velocity):
            raise SceneError(
                f"{name}: finger_velocity = (0, 0) gives legs no direction; give it one"
            )
        contact = dataclasses.replace(contact, finger_velocity=(1.0, 0.0), object_velocity=ROLLING)
    if any(d.contact == index for d in scene.disturbances):
        raise SceneError(
            f"{name}: disturbances would change its path; leave them out of the scene, and "
            "add them to that of the route"
        )
    return contact
