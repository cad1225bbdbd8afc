"""How deep contact presses bodies into each other, and what they roll on then."""

from __future__ import annotations

import dataclasses

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
from contact_system.checks import naming
from contact_system.theory import symbols as ca

from .config import StationConfig

# Of kinds of surfaces what is less where they give way by a depth.
RADII = {Sphere: ("radius",), Cylinder: ("radius",), Torus: ("minor",), Ellipsoid: ("c", "b", "a")}


def contact_depth(config: StationConfig, force: float | None = None) -> float:
    """Depth at which a contact carries a force, or ``normal_force``, m.

    Force grows with the square of the depth in hydroelastic contact, linearly in point contact.
    """
    power = 2 if config.contact_model == "hydroelastic" else 1
    part = 1.0 if force is None else force / config.normal_force
    return power * config.normal_force / config.stiffness * part ** (1 / power)


def check_depth(scene: Scene, config: StationConfig) -> None:
    """Raise a SceneError where a contact would be as deep as half a body's least radius."""
    depth = contact_depth(config)
    for i, contact in enumerate(scene.contacts):
        for body in (contact.finger, scene.object):
            thin = least_radius(body)
            if not depth < thin / 2:
                raise SceneError(
                    f"stiffness = {config.stiffness!r}: contact {i} would be {depth:.3g} m deep at "
                    f"normal_force = {config.normal_force!r}, which is too much for {body!r}; give "
                    f"a stiffness far above {config.stiffness * depth / (thin / 2):.3g} N/m"
                )


def least_radius(body: Surface) -> float:
    if isinstance(body, Quadric) and body.chart.central:
        return float(np.linalg.eigvalsh(body.A)[-1] ** -0.5)
    return min(getattr(body, name) for name in RADII.get(type(body), ("size",)))


def rolling_scene(scene: Scene, config: StationConfig) -> Scene:
    """The scene with bodies as large as they roll once pressed together.

    A compliant finger gives way to a rigid object, so it rolls on a surface by the depth inside its
    own; two equal point contacts share the depth. (That the patch is curved does not matter: what
    the object's surface drops towards the rim the tilt of friction there makes up for, see
    `contact_monitor`.) Of spheres, cylinders and tori that surface is another of their kind, and so
    it is nearly of ellipsoids; of others it is their equation, shifted along the normal.

    Parameters
    ----------
    scene : Scene
    config : StationConfig
        Its normal force and stiffness say the depth.

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


def _smaller(surface: Surface, by: float) -> Surface:
    """The surface so much further inside the body: of all that can be fingertips, and planes."""
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
    """An ellipsoid with smaller axes; the given one if the smaller one had its (u, v) elsewhere."""
    values, axes = np.linalg.eigh(surface.A)
    matrix = axes @ np.diag((values**-0.5 - by) ** -2) @ axes.T
    smaller = dataclasses.replace(surface, A=(matrix + matrix.T) / 2)
    moved = np.linalg.norm(smaller.point(1.0, 0.5) - surface.point(1.0, 0.5))
    return smaller if moved < 2 * abs(by) else surface


def _smaller_implicit(surface: ImplicitSurface, by: float) -> ImplicitSurface:
    """The points from which the surface is so far along the gradient of its equation."""
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


def depth_between(nominal: Surface, planned: Surface) -> float:
    """By how much `_smaller` made a surface smaller, m."""
    name, *_ = RADII.get(type(nominal), ("size",))
    less = getattr(nominal, name) - getattr(planned, name)
    return -less if nominal.inside else less
