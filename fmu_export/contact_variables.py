"""The variables of one contact: inputs, states, their derivatives and other results, in order."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from contact_system.scene import Contact, Scene

from .model import INPUTS, frame_sizes, start_states
from .quantities import METRE, NONE, RADIAN, SECOND, Unit, Variable, chart_units, per_second

if TYPE_CHECKING:
    from .variables import Table

SMALL = 0.1
"""Nominal value of angles and path velocities: solvers take their absolute tolerances from it."""
XY, XYZ = ("x", "y"), ("x", "y", "z")


def contact_rows(table: Table, i: int, known: list[tuple[int, ...]]) -> Iterator[Variable]:
    scene, contact, first = table.scene, table.scene.contacts[i], table.blocks[i]
    states = _frame_states(scene, contact) if table.frames else _states(scene, contact)
    derivatives = [_derivative(v, table.frames) for v in states]
    measured = _measured(table, contact)
    n_inputs = INPUTS + table.n_measured
    starts = [
        *[0.0] * INPUTS,
        *_measured_starts(table, contact),
        *start_states(scene, contact, table.frames).tolist(),
    ]
    results = [*(_coordinates(scene, contact) if table.frames else ()), *_outputs(scene, contact)]
    n_states, at = table.n_states(i), 0
    for v in (*_inputs(scene, contact), *measured, *states, *derivatives, *results):
        end, result = at + v.size, at - n_inputs - n_states
        derivative = first + at - n_states if 0 <= result < n_states else None
        yield replace(
            v,
            name=_of_contact(i, v.name),
            reference=first + at,
            start=tuple(starts[at:end]),
            elements=tuple(_of_contact(i, name) for name in v.elements),
            derivative=derivative,
            known=tuple(known[result : result + v.size]) if result >= 0 else (),
        )
        at = end


def _of_contact(i: int, name: str) -> str:
    head, inner = ("der(", name[4:]) if name.startswith("der(") else ("", name)
    return f"{head}contact[{i + 1}].{inner}"


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


def _measured(table: Table, contact: Contact) -> Iterator[Variable]:
    """The trigger; then states as `Plan.states` has them, or twist and pose."""
    if table.measured == "nothing":
        return
    text = "Co-Simulation goes on from what is measured when this changes to another number than 0"
    yield _quantity("measured.trigger", (), NONE, text, kind=("input", None))
    posed = table.measured == "pose"
    for v in (_motion if posed else _coordinates)(table.scene, contact):
        name, *elements = (
            "measured." + re.sub(r"der\((.*)\)", r"\1_rate", n) for n in (v.name, *v.elements)
        )
        v = replace(
            v, name=name, elements=tuple(elements), description=f"Measured: {v.description}"
        )
        yield replace(v, causality="input", initial=None)


def _measured_starts(table: Table, contact: Contact) -> list[float]:
    (u1, v1), (u2, v2) = contact.finger_at, contact.object_at
    states = [u1, v1, 0.0, 0.0, u2, v2, 0.0, 0.0, contact.angle]
    motion = [*np.zeros(6), *np.eye(3).ravel(), *np.zeros(3)]
    return {"nothing": [], "states": [0.0, *states], "pose": [0.0, *motion]}[table.measured]


def _states(scene: Scene, contact: Contact) -> list[Variable]:
    rows: list[tuple[str, tuple[str, ...], Unit | None, str, float]] = []
    for side, body, surface in (("finger", 1, contact.finger), ("object", 2, scene.object)):
        for axis, unit in zip("uv", chart_units(surface)):
            nominal = SMALL * surface.size if unit == METRE else SMALL
            text = f"Coordinate {axis} of the contact point on the {side}"
            rows.append((f"{side}.{axis}", (), unit, text, nominal))
        text = f"Angle in E{body} of a frame carried along the path by parallel transport"
        rows.append((f"{side}.frame_angle", (), RADIAN, text, SMALL))
        text = f"Path velocity of the {side}'s contact point, M{body} dq{body}/ds, in that frame"
        rows.append((f"{side}.velocity", XY, NONE, text, SMALL))
    text = "Contact angle psi between the contact frames E1 and E2"
    rows.append(("angle", (), RADIAN, text, SMALL))
    return [_quantity(*row, kind=("output", "exact")) for row in rows]


def _frame_states(scene: Scene, contact: Contact) -> list[Variable]:
    rows: list[tuple[str, tuple[str, ...], Unit | None, str, float]] = []
    sizes = frame_sizes(contact.finger, scene.object)
    for side, surface, size in zip(("finger", "object"), (contact.finger, scene.object), sizes):
        stem, carried = f"{side}.frame", f"frame carried along on the {side}"
        length = SMALL * surface.size
        if size == 6:
            rows.append((f"{stem}.point", XYZ, METRE, f"Origin of the {carried}", length))
            rows.append((f"{stem}.axis", XYZ, NONE, f"First axis of the {carried}", SMALL))
            continue
        for axis, unit in zip("uv", chart_units(surface)):
            text = f"Coordinate {axis} of the {carried}"
            rows.append((f"{stem}.{axis}", (), unit, text, length if unit == METRE else SMALL))
        rows.append((f"{stem}.angle", (), RADIAN, f"Angle in the chart of the {carried}", SMALL))
    text = "Path velocity of the finger's contact point in its carried frame"
    rows.append(("frame.velocity", XY, NONE, text, SMALL))
    rows.append(("frame.slip", XY, NONE, "Slip over sigma in the object's carried frame", SMALL))
    return [_quantity(*row, kind=("output", "exact")) for row in rows]


def _coordinates(scene: Scene, contact: Contact) -> list[Variable]:
    """What charts say of carried frames, in the engine's order."""
    rows = []
    for side, surface in (("finger", contact.finger), ("object", scene.object)):
        units = chart_units(surface)
        for axis, unit in zip("uv", units):
            text = f"Coordinate {axis} of the contact point on the {side}"
            rows.append(_quantity(f"{side}.{axis}", (), unit, text))
        for axis, unit in zip("uv", units):
            text = f"Time derivative: Coordinate {axis} of the contact point on the {side}"
            rows.append(_quantity(f"der({side}.{axis})", (), per_second(unit, 1), text))
    text = "Contact angle psi between the contact frames E1 and E2"
    return [*rows, _quantity("angle", (), RADIAN, text)]


def _derivative(state: Variable, local: bool) -> Variable:
    """Rates of coordinates are outputs, the other derivatives are local."""
    return replace(
        state,
        name=f"der({state.name})",
        elements=tuple(f"der({name})" for name in state.elements),
        description="Time derivative: " + state.description,
        unit=per_second(state.unit, 1),
        causality="output" if state.name[-2:] in (".u", ".v") and not local else "local",
        initial="calculated",
        nominal=None,
    )


def _motion(scene: Scene, contact: Contact) -> list[Variable]:
    """Twist and pose of the finger relative to the object."""
    cells = tuple(f"[{a},{b}]" for a in (1, 2, 3) for b in (1, 2, 3))
    matrix = "Rotation matrix from the finger's frame to the object's"
    size, speed = max(contact.finger.size, scene.object.size), _speed(scene)
    there, origin = "in the object's frame", "of the finger's frame in the object's frame"
    return [
        _quantity("twist.angular", XYZ, (0, -1, 1), f"Angular velocity of the finger {there}"),
        _quantity("twist.linear", XYZ, (1, -1, 0), f"Velocity of the origin {origin}", speed),
        _quantity("pose.rotation", cells, NONE, matrix, shape=(3, 3)),
        _quantity("pose.position", XYZ, METRE, f"Origin {origin}", size),
    ]


def _speed(scene: Scene) -> float | None:
    return scene.speeds(np.linspace(0.0, scene.duration, 33)).max() or None


def _outputs(scene: Scene, contact: Contact) -> list[Variable]:
    speed, moving = _speed(scene), (1, -1, 0)
    recovery = "Time in which slip falls to a hundredth at its present rate; at most 1e6 s"
    path = "sigma, the speed of the contact along its path"
    finger, obj = contact.finger.size, scene.object.size
    return [
        _quantity("slip", XY, moving, "Slip v_rel in E2", speed),
        *_motion(scene, contact),
        _quantity("finger.point", XYZ, METRE, "Contact point in the finger's frame", finger),
        _quantity("object.point", XYZ, METRE, "Contact point in the object's frame", obj),
        _quantity("path.speed", (), moving, path, speed),
        _quantity("slip_speed", (), moving, "Length of the slip", speed),
        _quantity("disturbance.active", (), NONE, "1 while an input or a window acts, else 0"),
        _quantity("recovery_time", (), SECOND, recovery),
    ]
