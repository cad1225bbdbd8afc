"""A scene that is stepped in this process: values, time, and the plan between two events.

Knows nothing of FMI, as component.c does not. An event is a change of an input or of the gain; it
continues the plan under another scene (`Plan.continued`), in which an input that is held is a
disturbance window from that moment on. A step evaluates nothing. What is asked for is evaluated
for some equal steps ahead.
"""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import math
import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from contact_system.errors import ChartSingularity, ContactSystemError, SceneError
from contact_system.plan import Plan
from contact_system.scene import DISTURBANCE_KINDS, Contact, Disturbance, Scene, acting
from contact_system.starts import Start, Starts, scene_start, starts_from_plain
from contact_system.surfaces import Surface
from contact_system.theory import symbols as ca

from .model import RESULTS, STATES, TOLERANCE, contact_results, jacobian, regularity, surface_with
from .variables import BLOCK, INPUTS, Table, variable_table

AHEAD = 256  # most steps that one evaluation serves
GAIN = 1  # reference of the gain
PUSHES = 4  # of `INPUTS`, the first: accelerations

Inputs = tuple[tuple[float, ...], ...]


class MotionEnds(SceneError):
    """Sigma turns negative before the time asked for."""


@dataclass
class Memory:
    """Everything that changes; an FMU state is a copy of it.

    Attributes
    ----------
    phase : str
        For the FMI layer.
    time : float
        s.
    stop : float
        Where stepping will end, s; infinite where nobody said.
    values : (n_values,)
        Parameters, inputs and, up to the start, states.
    plan : Plan or None
        The motion since the last event; None before the start.
    gain, inputs : float, tuple
        What the plan was made with; `INPUTS` numbers a contact.
    settled : bool
        They are those of ``values``.
    pending : bool
        An edge is reached, and values are still those before it.
    """

    phase: str
    time: float
    stop: float
    values: np.ndarray
    plan: Plan | None = None
    gain: float = math.nan
    inputs: Inputs = ()
    settled: bool = True
    pending: bool = False

    def copied(self) -> Memory:
        """A copy that shares nothing that changes."""
        return dataclasses.replace(self, values=self.values.copy())


class Block:
    """A scene that is stepped.

    Parameters
    ----------
    scene : Scene
    phase : str
        Of the memory, at first and after :meth:`reset`.

    Attributes
    ----------
    scene : Scene
    table : Table
    now : Memory
    edges : tuple of float
        Where disturbance windows begin or end, s, ascending.
    asked, rows : list
        What the FMI layer was asked for last, and the answer at each of the times ahead; emptied
        when they no longer hold.

    Raises
    ------
    SceneError
        A scene that no importer can step.
    """

    def __init__(self, scene: Scene, phase: str):
        self.scene, self.table = scene, variable_table(scene)
        self._phase, self._places = phase, _places(self.table)
        self.edges = scene.window_edges
        self._own: dict[tuple[float, ...], Scene] = {}
        self.reset()

    def reset(self) -> None:
        """Back to where the scene starts."""
        self.take(Memory(self._phase, 0.0, math.inf, self.table.start_values.copy()))

    def take(self, memory: Memory) -> None:
        """Go on from a memory."""
        self.now = memory
        self._run, self._since = 0, memory.time
        self._forget()

    def _forget(self) -> None:
        """What was evaluated no longer holds."""
        self.times: list[float] = []
        self.row = 0
        self.asked: list[int] = []
        self.rows: list[list[float]] = []
        self._requests: dict[tuple[int, ...], list[list[float]]] = {}
        self._groups: dict[str, np.ndarray] = {}

    # --- time

    def change(self, reference: int, value: float) -> None:
        """Set one of the values."""
        if self.now.values[reference] != value:
            self.now.values[reference] = value
            self.now.settled = False
            self._forget()

    def start(self) -> None:
        """Plan from the states as they are set.

        Raises
        ------
        ContactSystemError
            What is wrong with a start value, and the remedy.
        """
        now, scene, duration = self.now, self._scene_with(self.now.values), self.scene.duration
        starts = [self._start_of(scene, i) for i in range(len(scene.contacts))]
        last = now.time + duration if now.time >= duration else duration
        end = now.stop if now.time < now.stop < math.inf else last
        self._look(lambda: self._plan_from(now.time, end, _just_after(now.time), starts))

    def advance(self, target: float) -> None:
        """Let time go on; evaluates nothing, plans where something has changed.

        Raises
        ------
        ContactSystemError
            What stands in the way; time stands still then.
        """
        now = self.now
        if type(target) is not float:  # an importer's time may be numpy's
            target = float(target)
        if not now.settled:
            self._settle(target)
        assert now.plan is not None
        if target > now.plan.end:
            self._lengthen(target)
        now.time = target
        self.row += 1
        if now.pending:
            self.hold(False)

    def hold(self, pending: bool) -> None:
        """Keep values as they are before the edge that time is at, or let them pass it."""
        if self.now.pending != pending:
            self.now.pending = pending
            self._forget()

    def _look(self, settle: Callable[[], None]) -> None:
        """Plan for values of this time; where a path rests that is pushed, without the push.

        It has no rate, which shows in the rates alone; the next step will refuse it.
        """
        now, values = self.now, self.now.values
        pushes = [first + k for first in self.table.blocks for k in range(PUSHES)]
        if not (values[pushes].any() and self.rests()):
            settle()
            return
        now.values = values.copy()
        now.values[pushes] = 0.0
        try:
            settle()
        finally:
            now.values, now.settled = values, False

    def _settle(self, target: float = 0.0) -> None:
        """Let the inputs and the gain as they are set act from now on; plan up to target at least.

        Where events follow each other closely, it is no use to plan far.
        """
        now, plan = self.now, self.now.plan
        if now.settled or plan is None:
            return
        at = min(self.snapped(now.time), plan.end)
        if now.pending:  # what is set now acts already before the edge
            at = max(math.nextafter(at, -math.inf), plan.start)
        if at - plan.start <= _rounding(at):  # nothing has moved yet
            assert plan.starts is not None
            least = max(target, _just_after(plan.start))
            self._plan_from(plan.start, max(plan.end, target), least, plan.starts)
            return
        lasted = at - plan.start
        far = max(self.scene.duration, at + lasted, now.stop if now.stop < math.inf else 0.0)
        end = max(target, min(at + lasted, far))
        self._plan_on(at, end, max(target, math.nextafter(at, math.inf)))

    def _lengthen(self, target: float) -> None:
        plan = self.now.plan
        assert plan is not None
        at, length = plan.end, self._scene_with(self.now.values).profile.arc_length
        # Twice as far as before, so that few plans follow after an input, not one a step; along the
        # path, which is what a plan costs, at most four times as far.
        end, most = at + 2 * (at - plan.start), 5 * length(at) - 4 * length(plan.start)
        while end > target and length(end) > most:
            end = at + 0.5 * (end - at)
        self._plan_on(at, max(target, end), target)

    def _plan_from(self, begin: float, end: float, least: float, starts: Starts) -> None:
        def plan(scene: Scene) -> Plan:
            return Plan(scene, TOLERANCE, "auto", "DOP853", None, begin, starts)

        self._plan_ahead(plan, begin, end, least)

    def _plan_on(self, at: float, end: float, least: float) -> None:
        plan = self.now.plan
        assert plan is not None
        self._plan_ahead(lambda scene: plan.continued(at, scene), at, end, least)

    def _plan_ahead(
        self, plan: Callable[[Scene], Plan], begin: float, end: float, least: float
    ) -> None:
        """Plan to the end, or to ``least`` where something stands in the way behind it."""
        try:
            self._planned(plan(self._scene_between(begin, end, least)))
        except MotionEnds:
            raise
        except ContactSystemError as error:  # sigma = 0 under an input, a pole of a user's chart
            if not least < end:
                raise
            try:
                self._planned(plan(self._scene_between(begin, least, least)))
            except ContactSystemError:
                raise error from None

    def _planned(self, plan: Plan) -> None:
        now = self.now
        now.plan, now.settled = plan, True
        now.gain, now.inputs = float(now.values[GAIN]), self._inputs()
        self._forget()

    def snapped(self, time: float) -> float:
        """The time, or the edge of a disturbance window that it is but for rounding."""
        near = _rounding(time)
        for edge in self.edges:
            if abs(edge - time) <= near:
                return edge
        return time

    def next_edge(self) -> float:
        """The first edge of a disturbance window after now, s; infinite where there is none."""
        after = self.snapped(self.now.time)
        return min((t for t in self.edges if t > after), default=math.inf)

    # --- scenes

    def _inputs(self) -> Inputs:
        values = self.now.values
        return tuple(tuple(values[b : b + INPUTS].tolist()) for b in self.table.blocks)

    def _scene_between(self, begin: float, end: float, least: float) -> Scene:
        """The scene under the inputs of now, to ``end``, or ``least`` where sigma goes no further.

        A bit further where a window begins or ends: values at an edge are those after it.

        Raises
        ------
        MotionEnds
            Sigma is negative before ``least``.
        SceneError
            Inputs that cannot act then.
        """
        profile, edge = self._scene_with(self.now.values).profile, self.snapped(end)
        if edge > begin and edge in self.edges:
            end = edge + 0.01 * (edge - begin)
        try:
            profile.check(end)
        except SceneError:
            end = least
            try:
                profile.check(end)
            except SceneError as error:
                raise MotionEnds(str(error)) from None
        reached = self.snapped(end)
        return self._scene_to(begin, reached if reached > begin else end)

    def _scene_to(self, begin: float, end: float) -> Scene:
        scene = self._scene_with(self.now.values)
        windows: list[Disturbance] = [
            dataclasses.replace(d, stop=min(d.stop, end))
            for d in self.scene.disturbances
            if d.start < end and d.stop > begin
        ]
        for i, row in enumerate(self._inputs()):
            for k, kind in enumerate(DISTURBANCE_KINDS):
                if any(row[2 * k : 2 * k + 2]):
                    windows.append(kind(i, begin, end, row[2 * k : 2 * k + 2]))
        gain = dataclasses.replace(scene.gain, value=float(self.now.values[GAIN]))
        return scene.replace(gain=gain, duration=end, disturbances=windows)

    def _scene_with(self, values: np.ndarray) -> Scene:
        """The scene with the profile and the surfaces as they are set.

        Of no duration yet: how far sigma goes is seen when a motion is planned.
        """
        key = tuple(values[GAIN + 1 : self.table.blocks[0]].tolist())
        if key not in self._own:
            self._own.clear()  # or runs with other parameters each would fill the memory
            n = len(self.scene.profile.coefficients)
            at, *fingers = (
                first - GAIN - 1
                for first in (self.table.parameter_first["object"], *self.table.finger_first)
            )
            contacts = [
                dataclasses.replace(_with_numbers(c), finger=surface_with(c.finger, key[own:]))
                for c, own in zip(self.scene.contacts, fingers)
            ]
            self._own[key] = self.scene.replace(
                object=surface_with(self.scene.object, key[at:]),
                contacts=contacts,
                profile=dataclasses.replace(self.scene.profile, coefficients=key[:n]),
                duration=sys.float_info.epsilon,
                disturbances=(),
            )
        return self._own[key]

    def _start_of(self, scene: Scene, i: int) -> Start:
        """The start of a contact as its states are set."""
        block = self.table.blocks[i] + INPUTS
        x = self.now.values[block : block + STATES].tolist()
        u1, theta1, w1, u2, theta2, w2, psi = x[0:2], x[2], x[3:5], x[5:7], x[7], x[8:10], x[10]
        bodies = (("finger", scene.contacts[i].finger, u1), ("object", scene.object, u2))
        finger_at, object_at = (
            _outward_place(f"contact[{i + 1}].{side}", surface, at, outward)
            for (side, surface, at), outward in zip(bodies, self._outward(i, x))
        )
        return Start(finger_at, object_at, psi, _turned(w1, theta1), _turned(w2, theta2))

    def _outward(self, i: int, state: Sequence[float]) -> list[bool]:
        """Whether the frames of finger and object of contact i exist and point out of the body."""
        scene = self.scene
        least = regularity(scene.contacts[i].finger, scene.object)(state, *self._numbers(i)[1:])
        return [x > 0 for x in least.full().ravel()]

    # --- results

    def values_of(self, key: tuple[int, ...]) -> list[float]:
        """The values of some references now.

        Raises
        ------
        ChartSingularity
            A contact is where its coordinates do not exist.
        """
        if self.now.plan is None:
            return self._system_values()[list(key)].tolist()
        row = self._rows_of(key)[self.row]
        return [self.now.time if r == 0 else x for r, x in zip(key, row)]

    def remember(self, asked: Sequence[int], key: tuple[int, ...]) -> None:
        """The next steps' answers to a question are at hand in ``rows``."""
        if self.now.plan is not None and 0 not in key:
            self.asked, self.rows = list(asked), self._rows_of(key)

    def is_ahead(self) -> bool:
        """Whether what was evaluated holds this time."""
        k, time = self.row, self.now.time
        if k >= len(self.times):
            return False
        return abs(self.times[k] - time) <= _rounding(time)

    def _rows_of(self, key: tuple[int, ...]) -> list[list[float]]:
        self._look(self._settle)
        if not self.is_ahead():
            self._look_ahead()
        if key not in self._requests:
            self._requests[key] = self._tabulated(key)
        return self._requests[key]

    def _look_ahead(self) -> None:
        """Lay out times: this one, and after a run of equal steps twice as many as before."""
        time, before = self.now.time, len(self.times)
        if self.row == before and before:
            self._run += before
        else:
            self._run, self._since = 0, time
        # A step is a difference of rounded times: 256 of them are where their mean says.
        count, step = min(2 * before, AHEAD), (time - self._since) / max(1, self._run)
        ahead = 1 if self.now.pending or not self._run else count
        self._forget()
        self._lay_out([time, *(time + step * np.arange(1, ahead))])

    def _lay_out(self, times: Sequence[float]) -> None:
        plan = self.now.plan
        assert plan is not None
        self.times = [float(t) for t in times if t <= plan.end] or [self.now.time]
        at = np.array([self.snapped(t) for t in self.times])
        if self.now.pending:
            at = np.nextafter(at, -math.inf)
        self._at = np.clip(at, plan.start, plan.end)

    def _tabulated(self, key: tuple[int, ...]) -> list[list[float]]:
        """Rows of values, one for each time laid out."""
        try:
            return self._columns(key).tolist()
        except ChartSingularity:
            if len(self.times) == 1:
                raise
        self._forget()  # it may be a later time that is the singular one
        self._lay_out([self.now.time])
        return self._columns(key).tolist()

    def _columns(self, key: tuple[int, ...]) -> np.ndarray:
        self._find({self._places[reference][0] for reference in key})
        out = np.empty((len(self.times), len(key)))
        for column, reference in enumerate(key):
            group, contact, index = self._places[reference]
            if group:
                out[:, column] = self._groups[group][:, contact, index]
            else:
                out[:, column] = self.now.values[reference]
        return out

    def _find(self, names: set[str]) -> None:
        """Evaluate groups of results at all times laid out: (n_times, n_contacts, n) each."""
        plan, groups = self.now.plan, self._groups
        assert plan is not None
        if "rates" in names:
            names = names | {"states", "carried"}
        missing = names - groups.keys() - {"", "rates"}
        if missing:
            for name, values in plan.evaluate(self._at, *missing).items():
                groups[name] = values.reshape(len(self.times), len(self.scene.contacts), -1)
        if "carried" in missing:
            self._turn(groups["carried"])
        if "rates" in names and "rates" not in groups:
            groups["rates"] = self._rates()

    def _turn(self, carried: np.ndarray) -> None:
        """From `Plan.carried`, whose frames start as the contact frames, to the angles as set."""
        for i, block in enumerate(self.table.blocks):
            for side, at in enumerate((2, 7)):
                angle = self.now.values[block + INPUTS + at]
                if angle:
                    own = carried[:, i, 3 * side : 3 * side + 3]
                    own[:, 0] += angle
                    own[:, 1:] = np.stack(_turned(own[:, 1:].T, -angle), axis=-1)

    def _states(self) -> np.ndarray:
        """The eleven numbers of each contact: (n_times, n_contacts, 11)."""
        chart, frames = self._groups["states"], self._groups["carried"]
        parts = [chart[..., 0:2], frames[..., :3], chart[..., 4:6], frames[..., 3:], chart[..., 8:]]
        return np.concatenate(parts, axis=-1)

    def _rates(self) -> np.ndarray:
        """All results as functions of the states: rates of velocities and psi are taken of it."""
        states = self._states()
        acting = np.array([self._disturbance(t) for t in self._at])
        n = range(len(self.scene.contacts))
        found = [self._results(i, self._at, states[:, i], acting[:, i]) for i in n]
        return np.stack(found, axis=1)

    # --- as a system of equations

    def _disturbance(self, t: float) -> np.ndarray:
        """Inputs and the scene's windows: (n_contacts, 6)."""
        return np.array(self._inputs()) + acting(self.scene, t)

    def _numbers(self, i: int) -> list[list[float]]:
        """What `contact_results` takes besides time, state and disturbance."""
        values, scene = self.now.values, self.scene
        own, at = self.table.finger_first[i], self.table.parameter_first["object"]
        return [
            values[GAIN : GAIN + 1 + len(scene.profile.coefficients)].tolist(),
            values[own : own + len(scene.contacts[i].finger.parameters)].tolist(),
            values[at : at + len(scene.object.parameters)].tolist(),
        ]

    def _kernel(self, i: int) -> ca.Function:
        scene, n_profile = self.scene, len(self.scene.profile.coefficients)
        return contact_results(scene.contacts[i].finger, scene.object, scene.gain.law, n_profile)

    def _results(self, i: int, t: np.ndarray, states: np.ndarray, acting: np.ndarray) -> np.ndarray:
        """`contact_results` at times t: (n_times, RESULTS)."""
        found = self._kernel(i)(t[None, :], states.T, acting.T, *self._numbers(i))
        return found.full().T

    def _system_values(self) -> np.ndarray:
        """All values as functions of the states that are set, before the start."""
        values, time = self.now.values.copy(), np.array([self.now.time])
        values[0] = self.now.time
        acting = self._disturbance(self.snapped(self.now.time))
        for i, block in enumerate(self.table.blocks):
            at = block + INPUTS + STATES
            state = values[None, block + INPUTS : at]
            values[at : at + RESULTS] = self._results(i, time, state, acting[i : i + 1])[0]
            if not all(self._outward(i, state[0])):  # numbers of a frame that points inward
                values[at : at + RESULTS] = math.nan
        return values

    def rests(self) -> bool:
        """Whether sigma is zero but for rounding, and contact frames exist as states are set."""
        now, n = self.now, len(self.scene.profile.coefficients)
        terms = now.values[GAIN + 1 : GAIN + 1 + n] * now.time ** np.arange(n)
        if now.plan is None:
            blocks = enumerate(self.table.blocks)
            states = [(i, now.values[b + INPUTS : b + INPUTS + STATES].tolist()) for i, b in blocks]
            if not all(all(self._outward(i, x)) for i, x in states):
                return False
        return bool(terms.sum() <= 1e-15 * np.abs(terms).sum())

    def jacobians(self) -> list[tuple[np.ndarray, list[int], list[int]]]:
        """Exact derivatives of each contact's results: matrix, references of rows and columns.

        Raises
        ------
        ChartSingularity
            A contact is where its coordinates do not exist.
        """
        if self.now.plan is None:
            blocks = np.array(self.table.blocks)[:, None] + INPUTS
            states = self.now.values[blocks + np.arange(STATES)]
            acting = self._disturbance(self.snapped(self.now.time))
        else:
            self._rows_of((self.table.blocks[0] + INPUTS,))
            self._find({"states", "carried"})
            states = self._states()[self.row]
            acting = self._disturbance(self._at[self.row])
        found = []
        for i, block in enumerate(self.table.blocks):
            point = [self.now.time, *states[i], *acting[i], *sum(self._numbers(i), [])]
            rows = list(range(block + INPUTS + STATES, block + BLOCK))
            matrix = jacobian(self._kernel(i))(point).full()
            if self.now.plan is None and not all(self._outward(i, states[i])):
                matrix[:] = math.nan
            found.append((matrix, rows, self.table.arguments(i)))
        return found


def _rounding(time: float) -> float:
    """Times this near are one time, as in the C of an FMU: ten steps of 0.1 s are not 1 s."""
    return 8 * sys.float_info.epsilon * max(1.0, time)


def _just_after(time: float) -> float:
    return time + _rounding(time)


def _places(table: Table) -> list[tuple[str, int, int]]:
    """For each reference the group of results, or "" for what is set; contact, index in it."""
    states = [
        ("states", 0),
        ("states", 1),
        *(("carried", k) for k in (0, 1, 2)),
        ("states", 4),
        ("states", 5),
        *(("carried", k) for k in (3, 4, 5)),
        ("states", 8),
    ]
    rates = [("rates", k) for k in range(STATES)]
    for k, column in ((0, 2), (1, 3), (5, 6), (6, 7)):
        rates[k] = ("states", column)
    groups = [("", 0)] * INPUTS + states + rates
    groups += [("slip", k) for k in range(2)] + [("twist", k) for k in range(6)]
    groups += [("pose", 4 * row + column) for row in range(3) for column in range(3)]
    groups += [("pose", 4 * row + 3) for row in range(3)] + [("points", k) for k in range(6)]
    assert len(groups) == BLOCK
    n = len(table.blocks)
    return [("", 0, 0)] * table.blocks[0] + [(g, i, k) for i in range(n) for g, k in groups]


def _with_numbers(contact: Contact) -> Contact:
    """The contact with the words "rolling" and "rest" as numbers."""
    start = scene_start(contact)
    return dataclasses.replace(
        contact, finger_velocity=start.finger_velocity, object_velocity=start.object_velocity
    )


def _turned(vector: Any, angle: float) -> tuple[Any, Any]:
    """Rot(angle) times a vector of the plane."""
    c, s = math.cos(angle), math.sin(angle)
    return c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]


def _outward_place(
    place: str, surface: Surface, at: Sequence[float], outward: bool
) -> tuple[float, float]:
    """Coordinates of a start with the same frame, as plans take them.

    Raises
    ------
    SceneError
        The chart's frame is lost there or points into the body.
    """
    try:
        canonical = surface.canonical(*at)
    except ContactSystemError as error:
        raise SceneError(f"{place}: {error}") from None
    if not outward:
        raise SceneError(
            f"{place}.u, .v = {at[0]:.9g}, {at[1]:.9g} has no outward frame on {surface!r}; set "
            f"{canonical[0]:.9g}, {canonical[1]:.9g}, the same point, and velocity and angle as "
            "seen from there"
        )
    near = surface.align(*canonical, *at)
    here = math.hypot(near[0] - at[0], near[1] - at[1]) <= 1e-9
    return (at[0], at[1]) if here else canonical


# --- state bytes ---------------------------------------------------------------------------------

_MAGIC, _VERSION = b"CONTACTP", 4
_HEADER = struct.Struct("<8sQQ16s16s")  # magic, version, length, model, checksum


class StateRefused(ContactSystemError):
    """State bytes that do not fit; the text says why."""


def digest(data: bytes) -> bytes:
    """16 bytes that tell data from other data."""
    return hashlib.blake2b(data, digest_size=16).digest()


def state_bytes(memory: Memory, model: bytes) -> bytes:
    """A memory as bytes: magic, version, length, model (16 bytes), checksum, then JSON."""
    plain: dict[str, Any] = {f.name: getattr(memory, f.name) for f in dataclasses.fields(memory)}
    plain["values"] = memory.values.tolist()
    if memory.plan is not None:
        plan = memory.plan
        starts = [vars(start) for start in plan.starts or ()]
        plain["plan"] = {"start": plan.start, "end": plan.end, "starts": starts}
    body = json.dumps(plain).encode()
    return _HEADER.pack(_MAGIC, _VERSION, len(body), model, digest(body)) + body


def memory_of(data: bytes, block: Block, model: bytes) -> Memory:
    """The memory that `state_bytes` wrote, for a block of the same scene.

    Raises
    ------
    StateRefused
        Bytes that are not such a memory.
    """
    if len(data) < _HEADER.size:
        raise StateRefused("its length is not that of a state; pass all of the bytes")
    magic, version, length, other, checksum = _HEADER.unpack_from(data)
    body = data[_HEADER.size :]
    for wrong, text in (
        (magic != _MAGIC, "it is not a state of an in-process planner"),
        (version != _VERSION, f"it was written by version {version}, this is {_VERSION}"),
        (length != len(body), "its header gives another length; pass all of the bytes"),
        (other != model, "it belongs to another scene"),
        (checksum != digest(body), "its checksum does not match; it has been changed"),
    ):
        if wrong:
            raise StateRefused(text)
    plain = json.loads(body)
    planned = plain.pop("plan")
    plain["values"] = np.array(plain["values"])
    plain["inputs"] = tuple(map(tuple, plain["inputs"]))
    memory = Memory(**plain)
    if planned is not None:
        memory.plan = _plan_again(planned, memory, block)
    return memory


def _plan_again(plain: dict[str, Any], memory: Memory, block: Block) -> Plan:
    """The plan of a memory, made again from where it started: the same to the last bit."""
    starts = starts_from_plain(plain["starts"])
    helper = copy.copy(block)
    helper.take(memory.copied())
    helper.now.values[GAIN] = memory.gain
    for first, own in zip(block.table.blocks, memory.inputs):
        helper.now.values[first : first + INPUTS] = own
    helper._plan_from(plain["start"], plain["end"], plain["end"], starts)
    assert helper.now.plan is not None
    return helper.now.plan
