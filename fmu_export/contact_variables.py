"""The variables of one contact: inputs, states, their derivatives and other results, in order."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contact_system.measures import REJECTED
from contact_system.scene import SLOTS, Contact, Scene
from contact_system.surfaces import Surface

from .equations import frame_size
from .quantities import METRE, NONE, RADIAN, SECOND, Unit, Variable, chart_units, per_second

SMALL = 0.1
"""Nominal value of angles and path velocities: solvers take their absolute tolerances from it."""
XY, XYZ = (".x", ".y"), (".x", ".y", ".z")
CELLS = tuple(f"[{a},{b}]" for a in (1, 2, 3) for b in (1, 2, 3))

STATES, DERIVATIVES = 2, 3
"""Indices of the groups of states and of their derivatives; the groups before are inputs."""


def contact_groups(
    scene: Scene, i: int, starts: np.ndarray, measured: str, speed: float | None
) -> list[list[Variable]]:
    """The variables of a scene's contact i, in the groups of c/model.h; starts: of the states;
    speed: nominal value of speeds, m/s."""
    variables = _Contact(scene, scene.contacts[i], f"contact[{i + 1}].", speed)
    states = [
        replace(v, causality="local", initial="exact", start=(float(x),))
        for v, x in zip(variables.states(), starts)
    ]
    return [
        variables.inputs(),
        [] if measured == "nothing" else variables.measured(measured),
        states,
        [_derivative(v) for v in states],
        variables.coordinates(),
        *variables.outputs(),
    ]


def _derivative(v: Variable) -> Variable:
    array, shape = v.within
    return replace(
        v,
        name=f"der({v.name})",
        within=(array and f"der({array})", shape),
        description="Time derivative: " + v.description,
        unit=per_second(v.unit, 1),
        initial="calculated",
        start=(),
        nominal=None,
        jumps=False,
    )


@dataclass(frozen=True)
class _Contact:
    """Variables of one contact, not yet with references; stem: what names begin with."""

    scene: Scene
    contact: Contact
    stem: str
    speed: float | None

    def rows(
        self, name: str, axes: tuple[str, ...], unit: Unit | None, text: str, **more: Any
    ) -> list[Variable]:
        """A scalar, or the elements of an array; more: attributes that differ from an output's."""
        v = Variable(self.stem + name, text, unit, **more)
        shape = (3, 3) if axes is CELLS else (len(axes),)
        return [replace(v, name=v.name + axis, within=(v.name, shape)) for axis in axes] or [v]

    def inputs(self) -> list[Variable]:
        found, bodies = [], dict(self.bodies)
        for side, accelerates in SLOTS:
            quantity = "acceleration" if accelerates else "rate_offset"
            to = "second derivative" if accelerates else "rate, not to the feedback,"
            for axis, unit in zip("uv", chart_units(bodies[side])):
                text = f"Added to the {to} of {axis} of the {side}"
                text += ", in addition to the scene's disturbance windows"
                arguments = f"{side}.{quantity}.{axis}", (), per_second(unit, 1 + accelerates), text
                found += self.rows(*arguments, causality="input", initial=None, start=(0.0,))
        return found

    def measured(self, what: str) -> list[Variable]:
        """Inputs: the trigger; then the states of `Plan.states`, or twist and pose."""
        inputs = replace(self, stem=f"{self.stem}measured.")
        if what == "pose":
            rows = [v for group in inputs.motion() for v in group]
            starts = [*np.zeros(6), *np.eye(3).ravel(), *np.zeros(3)]
        else:
            rows, contact = inputs.coordinates(), self.contact
            starts = [*contact.finger_at, 0.0, 0.0, *contact.object_at, 0.0, 0.0, contact.angle]
        text = "Co-Simulation goes on from what is measured when this changes to another number "
        # discrete, so that importers hold values and do not interpolate them
        kind: dict[str, Any] = {"causality": "input", "variability": "discrete", "initial": None}
        return inputs.rows("trigger", (), NONE, text + "than 0", start=(0.0,), **kind) + [
            replace(
                v,
                name=re.sub(r"der\((.*)\)", r"\1_rate", v.name),
                description=f"Measured: {v.description}",
                start=(float(x),),
                **kind,
            )
            for v, x in zip(rows, starts)
        ]

    @property
    def bodies(self) -> tuple[tuple[str, Surface], ...]:
        return ("finger", self.contact.finger), ("object", self.scene.object)

    def places(self, stem: str, surface: Surface, what: str) -> list[Variable]:
        return [
            v
            for axis, unit in zip("uv", chart_units(surface))
            for v in self.rows(f"{stem}.{axis}", (), unit, f"Coordinate {axis} of the {what}")
        ]

    def states(self) -> list[Variable]:
        rows: list[Variable] = []
        for side, surface in self.bodies:
            stem, carried = f"{side}.frame", f"frame carried along on the {side}"
            if frame_size(surface) == 3:
                frame = self.places(stem, surface, carried)
                text = f"Angle in the chart of the {carried}"
                frame += self.rows(f"{stem}.angle", (), RADIAN, text)
            else:
                frame = self.rows(f"{stem}.point", XYZ, METRE, f"Origin of the {carried}")
                frame += self.rows(f"{stem}.axis", XYZ, NONE, f"First axis of the {carried}")
            for v in frame:
                v.nominal = SMALL * surface.size if v.unit == METRE else SMALL
            rows += frame
        turns, stops = bool(self.contact.legs), self.scene.gain.row.cancels_growth
        moving = "Path velocity of the finger's contact point in its carried frame"
        slipping = "Slip over sigma in the object's carried frame"
        for name, jumps, text in (("velocity", turns, moving), ("slip", stops, slipping)):
            rows += self.rows(f"frame.{name}", XY, NONE, text, nominal=SMALL, jumps=jumps)
        return rows

    def coordinates(self) -> list[Variable]:
        """Chart coordinates, their rates and psi, in the order of `Plan.states`."""
        rows: list[Variable] = []
        for side, surface in self.bodies:
            places = self.places(side, surface, f"contact point on the {side}")
            rows += [*places, *map(_derivative, places)]
        text = "Contact angle psi between the contact frames E1 and E2"
        return [*rows, *self.rows("angle", (), RADIAN, text)]

    def motion(self) -> tuple[list[Variable], list[Variable]]:
        """Twist and pose of the finger relative to the object."""
        origin = "origin of the finger's frame in the object's frame"
        turning = "Angular velocity of the finger in the object's frame"
        matrix = "Rotation matrix from the finger's frame to the object's"
        size = max(surface.size for _, surface in self.bodies)
        twist = self.rows("twist.angular", XYZ, (0, -1, 1), turning)
        twist += self.speeds("twist.linear", XYZ, f"Velocity of the {origin}")
        pose = self.rows("pose.rotation", CELLS, NONE, matrix)
        pose += self.rows("pose.position", XYZ, METRE, origin.capitalize(), nominal=size)
        return twist, pose

    def speeds(self, name: str, axes: tuple[str, ...], text: str) -> list[Variable]:
        return self.rows(name, axes, (1, -1, 0), text, nominal=self.speed)

    def outputs(self) -> list[list[Variable]]:
        """Groups of results: slip, twist, pose, points, slip speed, condition."""
        points: list[Variable] = []
        for name, surface in self.bodies:
            text = f"Contact point in the {name}'s frame"
            points += self.rows(f"{name}.point", XYZ, METRE, text, nominal=surface.size)
        recovery = f"Time in which slip falls to {REJECTED:.0%} at its present rate; at most 1e6 s"
        condition = [
            *self.speeds("path.speed", (), "sigma, the speed of the contact along its path"),
            *self.rows("disturbance.active", (), NONE, "1 while an input or a window acts, else 0"),
            *self.rows("recovery_time", (), SECOND, recovery),
        ]
        slip = self.speeds("slip", XY, "Slip v_rel in E2")
        slip_speed = self.speeds("slip_speed", (), "Length of the slip")
        return [slip, *self.motion(), points, slip_speed, condition]
