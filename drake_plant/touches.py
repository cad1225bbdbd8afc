"""Where a plan lets bodies touch, and how they curve there."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contact_system import Ellipsoid, Quadric, Scene, SceneError, Sphere, Surface
from contact_system import plan as make_plan
from contact_system.measures import CONFORMS, relative_curvature

from .pressing import least_radius

Array = NDArray[np.float64]

SPACING = 0.0025  # m, of points along the plan that show where contacts go
LINE = 1e-6  # of the greatest relative curvature: less is a line, straight but for rounding


@dataclass(frozen=True)
class Touch:
    """Where two bodies are planned to touch, and how they curve there.

    finger_points, object_points : (m, 3), each in its body's frame, m
    finger_normals : (m, 3), out of the finger; NaN where its chart has no frame
    finger_curvature, object_curvature : mean curvatures, mean over the curve, 1/m
    openness : (m,), sqrt(det(K_1 + R K_2 R)), 1/m; NaN where a chart has no frame
    """

    finger_points: Array
    object_points: Array
    finger_normals: Array
    finger_curvature: float
    object_curvature: float
    openness: Array


def touches_of(scene: Scene) -> list[Touch]:
    """How the plan lets each finger touch the object.

    Raises
    ------
    SceneError
        The surfaces do not part around a planned contact, or two fingers are to be in one place.
    """
    plan, length = make_plan(scene), scene.path_length(scene.duration)
    times = np.linspace(0, scene.duration, min(max(100, math.ceil(length / SPACING)), 20_000))
    points, poses = plan.points(times), plan.pose(times)
    _check_apart(scene, times, poses[..., :3, 3])
    of_contacts, touches = relative_curvature(plan, times), []
    for i, contact in enumerate(scene.contacts):
        relative = of_contacts[:, i]
        # A chart has no frame at its poles; the curve is known beside them.
        known = np.all(np.isfinite(relative), axis=(1, 2))
        curvatures = np.linalg.eigvalsh(relative[known])
        least = curvatures[:, 0].min()
        line = max(LINE * curvatures[:, 1].max(), CONFORMS / contact.finger.size)
        if not least > line:
            what, remedy = "overlap", "make the finger smaller, or plan contact where the object is"
            remedy += " less concave"
            if least >= -line:
                what, remedy = (
                    "touch along a line or a face",
                    "turn the finger, or take another one",
                )
            raise SceneError(
                f"contact {i}: finger and object {what} where they are planned to touch (the "
                f"least relative curvature is {least:.3g} 1/m); {remedy}"
            )
        finger_points, object_points = points[:, i].swapaxes(0, 1)
        normals = contact.finger.normal(*contact.finger.coordinates(finger_points))
        touches.append(
            Touch(
                finger_points,
                object_points,
                normals,
                finger_curvature=_mean_curvature(contact.finger, finger_points[known]),
                object_curvature=_mean_curvature(scene.object, object_points[known]),
                openness=np.sqrt(np.linalg.det(relative)),
            )
        )
    return touches


def _mean_curvature(surface: Surface, points: Array) -> float:
    """The mean over points (m, 3) of half the trace of K, 1/m."""
    forms = surface.curvature_form(*surface.coordinates(points))
    return float(np.trace(forms, axis1=1, axis2=2).mean() / 2)


def _check_apart(scene: Scene, times: Array, places: Array) -> None:
    """Refuse fingers that would overlap, as they do not collide here; places (m, n, 3).

    A finger is taken as the ball about its origin that fits into it, a sphere as what it is.
    """
    radii = [_inner_radius(contact.finger) for contact in scene.contacts]
    for i, j in itertools.combinations(range(len(radii)), 2):
        apart = np.linalg.norm(places[:, i] - places[:, j], axis=1) - (radii[i] + radii[j])
        k = int(np.argmin(apart))
        if apart[k] < 0 and min(radii[i], radii[j]) > 0:
            raise SceneError(
                f"{scene.contact_name(i)} and {scene.contact_name(j)} are planned to overlap by "
                f"{-apart[k]:.3g} m at t = {times[k]:.3g} s; move one of them, shorten the scene "
                "or make them smaller"
            )


def _inner_radius(finger: Surface) -> float:
    """Radius of the ball about the origin that fits into a finger, m; 0 if it is not known."""
    return least_radius(finger) if isinstance(finger, (Sphere, Ellipsoid, Quadric)) else 0.0
