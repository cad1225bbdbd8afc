"""The variables of one contact: inputs, states, their derivatives and other results, in order."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from contact_system.scene import Contact, Scene
from contact_system.surfaces import Surface

from .model import frame_sizes
from .quantities import METRE, NONE, RADIAN, SECOND, Unit, Variable, chart_units, per_second

SMALL = 0.1
"""Nominal value of angles and path velocities: solvers take their absolute tolerances from it."""
XY, XYZ = ("x", "y"), ("x", "y", "z")
STATE = ("local", "exact")
PSI = "Contact angle psi between the contact frames E1 and E2"

INPUT_GROUPS, STATE_GROUP, DERIVATIVES = 2, 2, 3
"""Of the groups of a contact's numbers: how many are inputs; which are states, derivatives."""


def contact_groups(
    scene: Scene, contact: Contact, starts: Sequence[float], measured: str
) -> list[list[Variable]]:
    """A contact's variables in the groups of c/model.h, their names without ``contact[i].``.

    starts: values of the states.
    """
    states, coordinates = _states(scene, contact), _coordinates(scene, contact)
    derivatives = [_derivative(v) for v in states]
    inputs = [replace(v, start=(0.0,)) for v in _inputs(scene, contact)]
    groups = [inputs, [], states, derivatives, coordinates, *_outputs(scene, contact)]
    if measured != "nothing":
        groups[1] = _measured(scene, contact, measured)
    at = 0
    for k, v in enumerate(states):
        states[k], at = replace(v, start=tuple(starts[at : at + v.size])), at + v.size
    return groups


def _quantity(
    name: str,
    axes: tuple[str, ...],
    unit: Unit | None,
    text: str,
    nominal: float | None = None,
    shape: tuple[int, ...] = (),
    kind: tuple[str, str | None] = ("output", "calculated"),
) -> Variable:
    """A row before it has a place, its names without ``contact[i].``."""
    elements = tuple(name + (axis if axis.startswith("[") else f".{axis}") for axis in axes)
    shape = shape or ((len(axes),) if axes else ())
    said = (name, 0, kind[0], "continuous", kind[1], text, unit, (), elements, shape)
    return Variable(*said, nominal=nominal)


def _inputs(scene: Scene, contact: Contact) -> Iterator[Variable]:
    for side, surface, quantity, power, to in (
        ("finger", contact.finger, "acceleration", 2, "second derivative"),
        ("object", scene.object, "acceleration", 2, "second derivative"),
        ("object", scene.object, "rate_offset", 1, "rate, not to the feedback,"),
    ):
        for axis, unit in zip("uv", chart_units(surface)):
            text = f"Added to the {to} of {axis} of the {side}"
            text += ", in addition to the scene's disturbance windows"
            name = f"{side}.{quantity}.{axis}"
            yield _quantity(name, (), per_second(unit, power), text, kind=("input", None))


def _measured(scene: Scene, contact: Contact, what: str) -> list[Variable]:
    """The trigger; then states as `Plan.states` has them, or twist and pose."""
    text = "Co-Simulation goes on from what is measured when this changes to another number than 0"
    rows = [_quantity("trigger", (), NONE, text)]
    start = [0.0, *np.zeros(6), *np.eye(3).ravel(), *np.zeros(3)]
    if what == "pose":
        rows += [v for group in _motion(scene, contact) for v in group]
    else:
        rows += _coordinates(scene, contact)
        (u1, v1), (u2, v2) = contact.finger_at, contact.object_at
        start = [0.0, u1, v1, 0.0, 0.0, u2, v2, 0.0, 0.0, contact.angle]
    found, at = [], 0
    for v in rows:
        name, *elements = (
            "measured." + re.sub(r"der\((.*)\)", r"\1_rate", n) for n in (v.name, *v.elements)
        )
        said = f"Measured: {v.description}" if at else v.description
        v = replace(v, name=name, elements=tuple(elements), description=said)
        given = tuple(map(float, start[at : at + v.size]))
        found.append(replace(v, causality="input", initial=None, start=given))
        at += v.size
    return found


def _bodies(scene: Scene, contact: Contact) -> tuple[tuple[str, Surface], ...]:
    return ("finger", contact.finger), ("object", scene.object)


def _coordinates_of(stem: str, surface: Surface, what: str) -> list[Variable]:
    """Coordinates u and v as states."""
    units = chart_units(surface)
    nominals = [SMALL * surface.size if unit == METRE else SMALL for unit in units]
    return [
        _quantity(f"{stem}.{axis}", (), unit, f"Coordinate {axis} of the {what}", size, kind=STATE)
        for axis, unit, size in zip("uv", units, nominals)
    ]


def _states(scene: Scene, contact: Contact) -> list[Variable]:
    rows = []
    sizes = frame_sizes(contact.finger, scene.object)
    for (side, surface), size in zip(_bodies(scene, contact), sizes):
        stem, carried = f"{side}.frame", f"frame carried along on the {side}"
        if size == 3:
            rows += _coordinates_of(stem, surface, carried)
            text = f"Angle in the chart of the {carried}"
            rows.append(_quantity(f"{stem}.angle", (), RADIAN, text, SMALL, kind=STATE))
            continue
        for name, unit, text, nominal in (
            ("point", METRE, "Origin", SMALL * surface.size),
            ("axis", NONE, "First axis", SMALL),
        ):
            text = f"{text} of the {carried}"
            rows.append(_quantity(f"{stem}.{name}", XYZ, unit, text, nominal, kind=STATE))
    for name, text in (
        ("velocity", "Path velocity of the finger's contact point in its carried frame"),
        ("slip", "Slip over sigma in the object's carried frame"),
    ):
        rows.append(_quantity(f"frame.{name}", XY, NONE, text, SMALL, kind=STATE))
    return rows


def _coordinates(scene: Scene, contact: Contact) -> list[Variable]:
    """What charts say of carried frames, in the engine's order."""
    rows: list[Variable] = []
    for side, surface in _bodies(scene, contact):
        places = _coordinates_of(side, surface, f"contact point on the {side}")
        rows += [
            replace(v, causality="output", initial="calculated", nominal=None)
            for v in (*places, *map(_derivative, places))
        ]
    return [*rows, _quantity("angle", (), RADIAN, PSI)]


def _derivative(state: Variable) -> Variable:
    return replace(
        state,
        name=f"der({state.name})",
        elements=tuple(f"der({name})" for name in state.elements),
        description="Time derivative: " + state.description,
        unit=per_second(state.unit, 1),
        causality="local",
        initial="calculated",
        nominal=None,
    )


def _motion(scene: Scene, contact: Contact) -> tuple[list[Variable], list[Variable]]:
    """Twist and pose of the finger relative to the object."""
    cells = tuple(f"[{a},{b}]" for a in (1, 2, 3) for b in (1, 2, 3))
    matrix = "Rotation matrix from the finger's frame to the object's"
    size, speed = max(contact.finger.size, scene.object.size), _speed(scene)
    there, origin = "in the object's frame", "of the finger's frame in the object's frame"
    return [
        _quantity("twist.angular", XYZ, (0, -1, 1), f"Angular velocity of the finger {there}"),
        _quantity("twist.linear", XYZ, (1, -1, 0), f"Velocity of the origin {origin}", speed),
    ], [
        _quantity("pose.rotation", cells, NONE, matrix, shape=(3, 3)),
        _quantity("pose.position", XYZ, METRE, f"Origin {origin}", size),
    ]


def _speed(scene: Scene) -> float | None:
    return scene.speeds(np.linspace(0.0, scene.duration, 33)).max() or None


def _outputs(scene: Scene, contact: Contact) -> list[list[Variable]]:
    """Groups of results: slip, twist, pose, points, condition."""
    speed, moving = _speed(scene), (1, -1, 0)
    recovery = "Time in which slip falls to a hundredth at its present rate; at most 1e6 s"
    path = "sigma, the speed of the contact along its path"
    finger, obj = contact.finger.size, scene.object.size
    points = [
        _quantity("finger.point", XYZ, METRE, "Contact point in the finger's frame", finger),
        _quantity("object.point", XYZ, METRE, "Contact point in the object's frame", obj),
    ]
    condition = [
        _quantity("path.speed", (), moving, path, speed),
        _quantity("slip_speed", (), moving, "Length of the slip", speed),
        _quantity("disturbance.active", (), NONE, "1 while an input or a window acts, else 0"),
        _quantity("recovery_time", (), SECOND, recovery),
    ]
    slip = _quantity("slip", XY, moving, "Slip v_rel in E2", speed)
    return [[slip], *_motion(scene, contact), points, condition]
