"""One step of a scene whose inputs change at every step.

A plan of a horizon costs milliseconds and is thrown away at the next change. Here each contact goes
on by panels of the motion that a plan has under disturbances (`forced_motion`), all contacts of a
kind in lockstep, and what can be asked for is evaluated where the step ends, in one kernel. What is
left is a `Moment` of each contact, from which a plan or another such step goes on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import casadi as ca
import numpy as np

from contact_system import panels
from contact_system.charts import TURN
from contact_system.development import forced_motion, state_size
from contact_system.errors import ContactSystemError
from contact_system.kernels import Kernel, per_structure
from contact_system.profile import GainPiece
from contact_system.scene import Scene
from contact_system.starts import Moment
from contact_system.surfaces import Surface
from contact_system.system import FLIP
from contact_system.tracks import (
    coordinate_kernel,
    frame_kernel,
    in_space,
    lame_kernel,
    prefers_ambient,
    rotation,
    standing_size,
)

from .model import arguments, contact_values

SX = ca.SX

TOLERANCE = 1e-14  # of a panel's tail; with 1e-13 K4 ends 4e-14 of its size away
GROUPS = {"states": 9, "slip": 2, "twist": 6, "pose": 16, "points": 6, "carried": 6}
"""What is evaluated at the end of a step, and how many numbers a contact."""


class Following:
    """A step of all contacts under held inputs.

    Parameters
    ----------
    lockstep : sequence of LockstepGroup
        All contacts; see :func:`lockstep_groups`.
    piece : GainPiece
        sigma and the gain from the beginning of the step on.
    law : sequence of float
        The gain, then the profile's coefficients.
    end : float
        s.
    starts : sequence of Moment
        Each contact at ``piece.start``.
    acting : (n_contacts, 6)
        Disturbances: accelerations of finger and object, object rate offset.

    Attributes
    ----------
    start, end : float
        s.
    starts, moments : list of Moment
        At the two ends of the step.
    found : dict of arrays
        `GROUPS` at the end of the step, (1, n_contacts, n).

    Raises
    ------
    ContactSystemError
        The motion cannot be continued.
    """

    def __init__(
        self, lockstep: Sequence[LockstepGroup], piece: GainPiece, law: Sequence[float], end: float,
        starts: Sequence[Moment], acting: np.ndarray,
    ):  # fmt: skip
        self.start, self.end, self.starts = piece.start, end, list(starts)
        self.found = {name: np.empty((1, len(starts), size)) for name, size in GROUPS.items()}
        self.moments: list[Moment] = list(starts)
        for group in lockstep:
            members = group.members
            state, rows = group.moved(
                [starts[i] for i in members], acting[members], piece, law, end
            )
            for i, numbers, own, row in zip(members, group.numbers, state.tolist(), rows):
                group.wind(row, starts[i])
                self.moments[i] = group.moment(numbers, own, row, starts[i])
            results, at = np.array(rows), 0
            for name, size in GROUPS.items():
                self.found[name][0, members] = results[:, at : at + size]
                at += size


_CARRIED = sum(GROUPS.values()) - GROUPS["carried"]
_ROTATION = [
    sum(GROUPS[name] for name in ("states", "slip", "twist")) + 4 * row + column
    for row in range(3)
    for column in range(3)
]


class LockstepGroup:
    """Contacts whose fingers are of one structure, which are moved in lockstep.

    A state is the finger's frame, W_1, the object's frame, V; a frame is x, p, q or u, v, theta.

    Parameters
    ----------
    scene : Scene
    members : list of int
        Contacts.
    """

    def __init__(self, scene: Scene, members: list[int]):
        finger, obj = scene.contacts[members[0]].finger, scene.object
        self.members = members
        self.name = f"{scene.title}, contact {', '.join(map(str, members))}"
        self.forms = in_space(finger, True), in_space(obj, True)
        self.charted = not (finger.has_implicit and obj.has_implicit)
        self.size = list(map(state_size, self.forms))
        self.motion = forced_motion(finger, obj, self.forms, True)
        n_profile = len(scene.profile.coefficients)
        self.results = _results(finger, obj, scene.gain.law, n_profile)
        numbers = [[*scene.contacts[i].finger.parameters, *obj.parameters] for i in members]
        n1, n2 = self.size
        columns = [slice(0, n1), slice(n1 + 2, n1 + 2 + n2)]
        first = len(finger.parameters)
        own = [slice(0, first), slice(first, None)]  # numbers of finger and object
        self.bodies = list(zip((finger, obj), self.forms, columns, own))
        sizes = np.array([[scene.contacts[i].finger.size, obj.size] for i in members])
        self.numbers, self.sizes = np.array(numbers), sizes
        self.periods = [
            [(place, k, period) for k, (place, period) in enumerate(zip(places, periods)) if period]
            for places, periods in (
                ((0, 1, _CARRIED), (*finger.periods(), TURN)),
                ((4, 5, _CARRIED + 3), (*obj.periods(), TURN)),
            )
        ]

    def moved(
        self, starts: Sequence[Moment], acting: np.ndarray, piece: GainPiece, law: Sequence[float],
        end: float,
    ) -> tuple[np.ndarray, list[list[float]]]:  # fmt: skip
        """The states where the step ends, and the results there.

        Raises
        ------
        ContactSystemError
            The motion cannot be continued, or a contact frame turns over, as it does where a path
            goes straight through a pole of a user's chart: the equations are smooth there.
        """
        state = np.array([
            [*(m.finger_frame if self.forms[0] else m.finger_at), *m.finger_velocity,
             *(m.object_frame if self.forms[1] else m.object_at), *m.slip] for m in starts
        ])  # fmt: skip
        n, at = len(starts), self.numbers.shape[1]
        constants = np.zeros((n, at + 10))
        constants[:, :at], constants[:, at + 4 :] = self.numbers, acting
        constants[:, at] = [math.cos(m.angle) for m in starts]
        constants[:, at + 1] = [math.sin(m.angle) for m in starts]
        length = end - piece.start
        problem = panels.Problem(
            self.name,
            state,
            constants,
            self._scale(state, acting),
            piece,
            length,
            length,
            slip=1.0,
            stiff=2,
        )
        before, state = state, panels.integrate(self.motion, problem, TOLERANCE, None).end
        machine = self.results.machine(n)
        machine.x[:, 0], machine.x[:, 1] = end, [m.angle for m in starts]
        machine.x[:, 2:-6], machine.x[:, -6:] = state, acting
        machine.c[:, : len(law)], machine.c[:, len(law) :] = law, self.numbers
        machine.run()
        rows = machine.y.tolist()
        if self.charted:
            machine.x[:, 0], machine.x[:, 2:-6] = piece.start, before
            machine.run()
            # of bodies that turn by less than a right angle in a step the trace is more than 1
            trace = np.sum(np.array(rows)[:, _ROTATION] * machine.y[:, _ROTATION], axis=1)
            if not trace.min() > 1.0:
                raise ContactSystemError(f"{self.name}: a contact frame turns over")
        return state, rows

    def _scale(self, state: np.ndarray, acting: np.ndarray) -> np.ndarray:
        """1 / (size of each state): positions by the body's size, directions and angles by 1."""
        scale = np.ones_like(state)
        for k, (surface, ambient, columns, own) in enumerate(self.bodies):
            first, sizes = columns.start, self.sizes[:, k, None]
            if ambient:
                scale[:, first : first + 3] = 1.0 / sizes
            else:
                lame = lame_kernel(surface).at(state[:, columns], self.numbers[:, own])
                scale[:, first : first + 2] = np.maximum(lame / sizes, 1e-2)
        slip = max(np.abs(state[:, -2:]).max(), np.abs(acting).max())
        scale[:, -2:] = 1.0 / min(1.0, max(1e-3, slip))
        return scale

    def wind(self, row: list[float], before: Moment) -> None:
        """Bring coordinates and frame angles to the branch nearest those before, in place."""
        for k, near in enumerate((before.finger_at, before.object_at)):
            if not self.forms[k]:
                continue
            for place, index, period in self.periods[k]:
                if math.isfinite(row[place]):
                    row[place] += period * round((near[index] - row[place]) / period)
        row[8] = before.angle - row[_CARRIED] - row[_CARRIED + 3]

    def moment(
        self, numbers: np.ndarray, state: list[float], row: list[float], before: Moment
    ) -> Moment:
        """What is left of a contact; coordinates that do not exist stay where they were."""
        places, moving = [], []
        for k, at in enumerate((before.finger_at, before.object_at)):
            surface, ambient, columns, own = self.bodies[k]
            frame = state[columns]
            place = [row[4 * k], row[4 * k + 1], row[_CARRIED + 3 * k]] if ambient else frame
            if not all(map(math.isfinite, place)):
                place = list(at)
            if not ambient:
                frame = []
                if prefers_ambient(surface):
                    frame = (
                        frame_kernel(surface).at(np.array([place]), numbers[None, own])[0].tolist()
                    )
            places.append(tuple(place))
            moving.append(tuple(frame))
        n1 = self.size[0]
        return Moment(before.angle, tuple(state[n1 : n1 + 2]), tuple(state[-2:]), *places, *moving)


def lockstep_groups(scene: Scene) -> list[LockstepGroup]:
    """All contacts of a scene; its disturbances, gain and duration do not count."""
    kinds: dict[object, list[int]] = {}
    for i, contact in enumerate(scene.contacts):
        kinds.setdefault((contact.finger.structure, contact.finger.periods()), []).append(i)
    return [LockstepGroup(scene, members) for members in kinds.values()]


@per_structure
def _results(finger: Surface, obj: Surface, law: str, n_profile: int) -> Kernel:
    """`GROUPS` of a contact from its time, state and disturbance; law and numbers are constants."""
    forms = in_space(finger, True), in_space(obj, True)
    a = arguments(finger, obj, n_profile)
    n1, n2 = map(state_size, forms)
    state, angle = SX.sym("state", n1 + n2 + 4), SX.sym("angle")
    tip, w1, body, v = ca.vertsplit(state, [0, n1, n1 + 2, n1 + 2 + n2, n1 + n2 + 4])
    # contact_values wants psi = -theta_1 - theta_2, and a frame in space as (x, p)
    w = rotation(angle) @ w1
    turned = ca.vertcat(tip[:2], tip[2] - angle)
    if forms[0]:
        turned = ca.vertcat(tip[:3], ca.cos(angle) * tip[3:6] - ca.sin(angle) * tip[6:9])
    carried = ca.vertcat(turned, body[: standing_size(forms[1])], w, v)
    found = contact_values(finger, obj, forms, law, a, carried)
    theta = [
        coordinate_kernel(s, k).function(ca.vertcat(f, SX(2, 1)), p)[4]
        for s, k, f, p in zip((finger, obj), forms, (tip, body), (a.finger, a.object))
    ]
    rows = ca.vertcat(ca.reshape(found["pose"][:9], 3, 3), found["pose"][9:].T)
    pose = ca.vec(ca.horzcat(rows, SX([0, 0, 0, 1])))
    result = ca.vertcat(
        found["state"], found["slip"], found["twist"], pose, found["contact_point"],
        theta[0], w1, theta[1], FLIP @ w - v,
    )  # fmt: skip
    point = ca.vertcat(a.time, angle, state, a.disturbance)
    return Kernel("results", point, ca.vertcat(a.law, a.finger, a.object), result)
