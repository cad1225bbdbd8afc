"""Where bodies touch in a plan, how they curve there, and how deep contact presses them."""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from contact_system import (
    Cylinder,
    Ellipsoid,
    ImplicitSurface,
    Quadric,
    Scene,
    SceneError,
    Sphere,
    Surface,
    Torus,
)
from contact_system.checks import Array, naming
from contact_system.measures import CONFORMS
from contact_system.planning.motion import FRAMES, Motion
from contact_system.theory import equations
from contact_system.theory import symbols as ca

from .config import StationConfig
from .drake_meshes import inner_points
from .meshes import RoundDomain, icosphere

TOLERANCE = 1e-12  # error of the plan of a path, as a fraction of the size
SPACING = 0.0025  # m, between the points of a planned path at which contacts are examined
ANOTHER = 0.1  # bodies whose sizes differ by more than this part are not the same body
LINE = 1e-6  # a least relative curvature below this part of the greatest is 0 but for rounding
REACH = 0.02  # m, by which meshes of unbounded surfaces reach beyond the planned patches
POINTS, _ = icosphere(4)  # unit vectors, mapped to the points of a finger that must not overlap
BALLS = 33  # along a cylinder's axis
FILLED = Sphere, Cylinder, Torus  # their `coordinates` of a point are those of the nearest point
# The lengths of a surface that shrink by the depth by which contact presses it in.
RADII = {Sphere: ("radius",), Cylinder: ("radius",), Torus: ("minor",), Ellipsoid: ("c", "b", "a")}


def contact_depth(config: StationConfig, force: float | None = None) -> float:
    """Depth at which a contact carries a force, or ``normal_force``, m.

    Force grows with the square of the depth in hydroelastic contact, linearly in point contact.
    """
    power = 2 if config.contact_model == "hydroelastic" else 1
    part = 1.0 if force is None else force / config.normal_force
    return power * config.normal_force / config.stiffness * part ** (1 / power)


def check_depth(scene: Scene, config: StationConfig) -> None:
    """Raise a SceneError if a contact would be at least half as deep as a body's least radius."""
    depth = contact_depth(config)
    for i, contact in enumerate(scene.contacts):
        for body in (contact.finger, scene.object):
            thin = body.c if isinstance(body, Ellipsoid) else body.least_radius
            if not depth < thin / 2:
                raise SceneError(
                    f"stiffness = {config.stiffness!r}: {scene.contact_title(i)} would be "
                    f"{depth:.3g} m deep at normal_force = {config.normal_force!r}, which is too "
                    f"much for {body!r}; give a stiffness far above "
                    f"{config.stiffness * depth / (thin / 2):.3g} N/m"
                )


def rolling_scene(scene: Scene, config: StationConfig) -> Scene:
    """The scene with the surfaces on which bodies roll, pressed together by the configuration.

    A rigid object presses a compliant finger in by the depth of the contact, so the finger rolls on
    an offset surface, deeper by that much; in point contact each body takes half of the depth. (The
    curvature of the patch does not matter: see `contact_monitor`.) The offset surface of a sphere,
    cylinder or torus is of the same kind, and nearly so that of an ellipsoid; others get their
    equation shifted along the normal.

    Raises
    ------
    SceneError
        A depth of half a body's least radius or more.
    """
    with naming(scene.title):
        check_depth(scene, config)
    depth, point = contact_depth(config), config.contact_model == "point"
    of_finger, of_object = (0.5 * depth, 0.5 * depth) if point else (depth, 0.0)
    contacts = [
        dataclasses.replace(contact, finger=_smaller(contact.finger, of_finger))
        for contact in scene.contacts
    ]
    return dataclasses.replace(scene, object=_smaller(scene.object, of_object), contacts=contacts)


def resting(scene: Scene) -> Scene:
    """The scene as a hand begins it, which does not follow its velocities and legs."""
    contacts = [
        dataclasses.replace(c, finger_velocity=(0.0, 0.0), object_velocity="rolling", legs=())
        for c in scene.contacts
    ]
    return scene.replace(contacts=contacts)


def _smaller(surface: Surface, by: float) -> Surface:
    """The offset surface, so many m deeper in the body; planes, for one, stay as they are."""
    names, less = RADII.get(type(surface)), -by if surface.inside else by
    if names:
        values = {name: getattr(surface, name) - less for name in names}
        return dataclasses.replace(surface, **values)
    if isinstance(surface, Quadric) and surface.chart.central and less:
        return _smaller_quadric(surface, less)
    if isinstance(surface, ImplicitSurface) and less:
        return _smaller_implicit(surface, less)
    return surface


def _smaller_quadric(surface: Quadric, by: float) -> Quadric:
    """An ellipsoid with shorter axes; the given one if on it a (u, v) would be at another place."""
    values, axes = np.linalg.eigh(surface.A)
    matrix = axes @ np.diag((values**-0.5 - by) ** -2) @ axes.T
    smaller = dataclasses.replace(surface, A=((matrix + matrix.T) / 2).tolist())
    moved = np.linalg.norm(smaller.point(1.0, 0.5) - surface.point(1.0, 0.5))
    return smaller if moved < 2 * abs(by) else surface


def _smaller_implicit(surface: ImplicitSurface, by: float) -> ImplicitSurface:
    """The offset surface as an equation: F(x + by n) = 0 with n = grad F/|grad F|."""
    formula = surface.formula
    depth = max("depth", *formula.names, key=len) + "_"  # a name that is free

    def shifted(x: ca.SX, **numbers: ca.SX) -> ca.SX:
        by = numbers.pop(depth)
        level = formula(ca.vertcat(*(numbers[name] for name in formula.names)), x)
        gradient = ca.gradient(level, x)
        normal = gradient / ca.sqrt(ca.sumsqr(gradient) + np.finfo(float).tiny)  # 0 at the centre
        return ca.substitute(level, x, x + by * normal)

    return ImplicitSurface(
        shifted,
        center=surface.center,
        parameters={**surface.named_parameters, depth: by},
        size=surface.size - by,
        inside=surface.inside,
    )


def require_alike(planned: Scene, nominal: Scene, config: StationConfig, what: str) -> None:
    """Raise a SceneError where the planned scene has other bodies than the plant's, apart from
    the depth of contacts; ``what`` names the planned one."""
    pressed, bodies = 2 * contact_depth(config), (planned.surfaces, nominal.surfaces)
    if len(planned.contacts) != len(nominal.contacts) or not all(
        type(a) is type(b) and abs(a.size - b.size) <= max(ANOTHER * b.size, pressed)
        for a, b in zip(*bodies)
    ):
        raise SceneError(
            f"{what}, of {planned.title}, has other surfaces, sizes or contacts than the plant, of "
            f"{nominal.title}: give it the plant's scene, or rolling_scene of it"
        )


def depth_between(nominal: Surface, planned: Surface) -> float:
    """How deep the planned surface lies in the nominal one, m: what `_smaller` was given."""
    less = nominal.size - planned.size
    return -less if nominal.inside else less


# --- where bodies touch ------------------------------------------------------------------------


@dataclass(frozen=True)
class Touch:
    """Where two bodies are planned to touch, and how they curve there, at m times.

    points : (2, m, 3), on finger and object, each in its body's frame, m
    normals : (m, 3), out of the finger
    curvatures : (2,), mean curvatures of finger and object, averaged over the curve, 1/m
    relative_curvature : (m,), sqrt(det(K_1 + R K_2 R)), 1/m
    """

    points: Array
    normals: Array
    curvatures: list[float]
    relative_curvature: Array


def touches_of(scene: Scene) -> list[Touch]:
    """Where fingers touch the object in the scene's plan; refuses line contact and overlap."""
    count = min(max(100, math.ceil(scene.path_length(scene.duration) / SPACING)), 20_000)
    times = np.linspace(0, scene.duration, count)
    results: Any = Motion(scene, TOLERANCE).evaluate(times, ("points", "pose", FRAMES))
    frames, touches = results[FRAMES], []
    forms = frames[..., [9, 10, 10, 11]].reshape(*frames.shape[:3], 2, 2)
    means = np.trace(forms, axis1=-2, axis2=-1).mean(axis=0) / 2
    for i, contact in enumerate(scene.contacts):
        # frames that are carried along both paths keep their angle
        turn = equations.reflection_rows(math.cos(contact.angle), math.sin(contact.angle))
        relative = equations.relative_curvature(forms[:, i, 1], forms[:, i, 0], np.array(turn))
        curvatures = np.linalg.eigvalsh(relative)
        least = curvatures[:, 0].min()
        line = max(LINE * curvatures[:, 1].max(), CONFORMS / contact.finger.size)
        if not least > line:
            what, remedy = "overlap", "make the finger smaller, or plan contact where the object is"
            remedy += " less concave"
            if least >= -line:
                what = "touch along a line or a face"
                remedy = "turn the finger, or take another one"
            raise SceneError(
                f"{scene.contact_title(i)}: finger and object {what} where they are planned to "
                f"touch (the least relative curvature is {least:.3g} 1/m); {remedy}"
            )
        points, finger = results["points"][:, i].swapaxes(0, 1), frames[:, i, 0]
        normals = np.cross(finger[:, 3:6], finger[:, 6:9])
        touches.append(Touch(points, normals, means[i].tolist(), np.sqrt(curvatures.prod(axis=1))))
    _check_apart(scene, times, results["pose"], touches)
    return touches


def _check_apart(scene: Scene, times: Array, poses: Array, touches: list[Touch]) -> None:
    """Refuse fingers that would overlap, as fingers do not collide here; poses (m, n, 4, 4).

    Balls that fill one finger, or points of its surface, must be outside the other one.
    """
    fingers, R, p = [c.finger for c in scene.contacts], poses[..., :3, :3], poses[..., :3, 3]
    # half the lengths of cylinders, whose axis is z
    halves = [float(np.abs(touch.points[0, :, 2]).max()) + REACH for touch in touches]
    for i, j in itertools.permutations(range(len(fingers)), 2):
        centres, radius = _filling(fingers[i], halves[i], isinstance(fingers[j], FILLED))
        x = (centres @ R[:, i].swapaxes(1, 2) + (p[:, i] - p[:, j])[:, None]) @ R[:, j]
        foot, frame = fingers[j].point_and_frame(*fingers[j].coordinates(x))
        apart = np.einsum("mki,mki->mk", x - foot, frame[..., 2])
        if isinstance(fingers[j], Cylinder):  # the distance from one with flat ends
            side, end = apart, np.abs(x[..., 2]) - halves[j]
            outside = np.hypot(np.maximum(side, 0.0), np.maximum(end, 0.0))
            apart = outside + np.minimum(np.maximum(side, end), 0.0)
        overlap = (apart < radius).any(axis=1)
        if overlap.any():
            raise SceneError(
                f"{scene.contact_title(i)} and {scene.contact_title(j)} are planned to overlap at "
                f"t = {times[np.argmax(overlap)]:.3g} s; move one of them, shorten the scene or "
                "make them smaller"
            )


def _filling(finger: Surface, half: float, balls: bool) -> tuple[Array, float]:
    """Centres (k, 3) and radius of balls that fill a finger; else points of its surface, and 0.

    half : half the length of a cylinder, m
    balls : whether distances from the other finger are exact; if not, only their sign is right, and
        points are needed
    """
    if isinstance(finger, Cylinder):
        size = finger.radius
        if balls:
            return np.linspace(-1, 1, BALLS)[:, None] * (0, 0, max(half - size, 0)), min(size, half)
        rim = np.maximum(np.hypot(*POINTS.T[:2]), np.abs(POINTS[:, 2]))
        return POINTS / rim[:, None] * (size, size, half), 0.0
    if balls and isinstance(finger, FILLED):
        return inner_points(finger), finger.least_radius
    around, _ = RoundDomain(finger).place(POINTS)
    return finger.point(*finger.coordinates(around)), 0.0
