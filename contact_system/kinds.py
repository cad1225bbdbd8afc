"""Scenes of one kind, whose plans differ in numbers only.

Surfaces, profile, gain law, duration and disturbances decide how contacts are planned; where they
start enters as numbers. Once two scenes of a kind have been planned, C plans the third: a kernel
for each stage, at the start and wherever tracks begin later, works out all that those tracks hold,
from where contacts start or where their last motions ended, into one block of memory; and the
tracks of the kind are evaluated with that block in the place of their own. A plan takes 2 to 3 us
instead of 170.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from .charts import TINY
from .closed_form import (
    LONG_PHASE,
    Circle,
    CircleTrack,
    FlatTrack,
    circle_branch,
    circle_kernel,
    circle_start,
    line_evaluator,
    turned,
)
from .development import contact_start
from .geodesics import GeodesicTrack, geodesic_form
from .groups import Group, SlipRecord
from .kernels import Kernel, address, function_address, per_structure
from .panel_tracks import Forced, MovingTrack, PanelTrack
from .panels import MOST_AT_ONCE, MOST_FOUND, Motion, program_built, program_library
from .planner import (
    ENDLESS,
    MOST_ALIKE,
    charted,
    family,
    group_name,
    plan_groups,
    slip_of,
)
from .program import Program, by_contacts, chart_states, group_program
from .scene import GIVEN, Scene
from .surfaces import Surface
from .tracks import (
    AXIS,
    BRANCH,
    LOCK,
    NODE,
    Track,
    axis_kernel,
    lame_kernel,
    prefers_ambient,
    restoring_axis,
    scale_kernel,
    standing_size,
)

SX = ca.SX

ATTEMPTS = 6  # scenes of a family from which kinds are learned

Fields = dict[str, SX]
"""What a track holds of a body, by name."""


class NoKind(Exception):
    """A scene has none."""


NONE = SX(0, 1)
NUMBERS = 11
"""What a stage takes from the kind for each contact: how long the paths of the last tracks of
finger and object were; by how much slip has moved, and what is left of it; accelerations of finger
and object, object rate offset (2 each); slip that they can bring about."""


# --- what tracks hold, from where a body starts ---------------------------------------------------


@dataclass(frozen=True)
class _Body:
    """A body of one contact where a track of its begins, in symbols.

    Attributes
    ----------
    surface : Surface
    p, size : its parameters and size
    begin : u, v, theta; of a body in space at the start only
    axis : x, p; None: found from ``begin``
    w, v : path velocity W and slip V
    """

    surface: Surface
    p: SX
    size: SX
    begin: SX
    axis: SX | None
    w: SX
    v: SX

    def state(self, ambient: bool) -> SX:
        """(x, p), or (u, v, theta)."""
        if not ambient:
            return self.begin
        if self.axis is not None:
            return self.axis
        return axis_kernel(self.surface).function(self.begin, self.p)

    def scale(self, ambient: bool) -> SX:
        """1 / (size of the state)."""
        numbers = ca.vertcat(self.p, self.size)
        return scale_kernel(self.surface, ambient).function(self.state(ambient), numbers)


class _Form(NamedTuple):
    """What decides how a track is filled with numbers, and where it ends.

    ``driven``: slip moves it; under accelerations: the finger is accelerated.
    """

    kind: type[Track]
    ambient: bool
    driven: bool

    @classmethod
    def of(cls, track: Track | None) -> _Form | None:
        if track is None:
            return None
        if isinstance(track, FlatTrack):
            driven = track.slip_length is not None
        elif isinstance(track, PanelTrack) and track.forced is not None:
            driven = track.forced.w1 is not None
        else:
            driven = getattr(track, "v", None) is not None
        return cls(type(track), track.ambient, driven)


Forms = tuple[_Form | None, _Form]
"""Forms of the finger's and the object's tracks on one side of an edge; the finger's is None where
its track goes on across the edge."""


def _held(form: _Form, body: _Body, offset: SX) -> tuple[Fields, list[SX]]:
    """The fields of a track, and numbers that must keep within its :func:`_limits`."""
    if form.kind is CircleTrack:
        found = circle_start(body.surface).function(ca.vertcat(body.state(True), body.w), body.p)
        constants, pace, phase = found[: -BRANCH - 2], found[-2], found[-1]
        given = ca.vertcat(body.begin[1:], body.w, constants[-NODE:])
        branch = circle_branch().function(given, NONE)
        return {"pace": pace, "phase": phase, "constants": ca.vertcat(constants, branch)}, [phase]
    if form.kind is FlatTrack:
        lame = lame_kernel(body.surface).function(body.begin, body.p)
        slope, aside = (
            turned().function(ca.vertcat(body.begin[2], x), NONE) / lame for x in (body.w, body.v)
        )
        reach = [ca.mmax(ca.fabs(x)) / body.size for x in (slope, body.begin[:2])]
        slopes = ca.vertcat(slope, aside) if form.driven else slope
        return {"lame": lame, "constants": ca.vertcat(body.p, body.begin, slopes)}, reach
    state, facts, scale = body.state(form.ambient), [], body.scale(form.ambient)
    if form.kind is GeodesicTrack:
        own = geodesic_form(body.surface, form.ambient)
        assert own is not None
        n, rates = own.motion.n_result, own.n_rates
        found = own.start.function(ca.vertcat(state, body.w), body.p)
        state, numbers = found[:n], found[n:-rates]
        scale, facts = ca.vertcat(scale[: n - rates], found[-rates:]), [ca.norm_2(body.w)]
    else:
        numbers = ca.vertcat(body.w, body.v if form.driven else SX(2, 1), offset)
    return {"start": state, "constants": ca.vertcat(body.p, numbers), "scale": scale}, facts


def _forced(forms: Forms, bodies: Sequence[_Body], angle: SX, numbers: SX) -> Fields:
    """The fields of both tracks of a motion under accelerations."""
    (tip, obj), pushed = bodies, forms[1].driven
    turn, w1 = ca.vertcat(ca.cos(angle), ca.sin(angle)), tip.w
    start, scale = [obj.state(forms[1].ambient), obj.v], [obj.scale(forms[1].ambient)]
    scale.append(SX.ones(2) / ca.fmin(1, ca.fmax(ca.norm_2(obj.v), numbers[10])))
    if pushed:
        assert forms[0] is not None
        start = [tip.state(forms[0].ambient), w1, *start]
        scale = [tip.scale(forms[0].ambient), SX.ones(2), *scale]
    constants = ca.vertcat(tip.p, obj.p, turn, w1, numbers[4:10])
    found = {"start": ca.vertcat(*start), "constants": constants, "scale": ca.vertcat(*scale)}
    return {f"forced {key}": value for key, value in found.items()}


def _end(form: _Form, surface: Surface, p: SX, given: Fields, side: str, numbers: SX) -> SX:
    """(x, p) or (u, v, theta) where a track of a side ends that nothing accelerates."""
    if form.kind is MovingTrack:
        return given[f"{side} end"]
    length, moved = numbers[int(side) - 1], numbers[2]
    constants = given[f"{side} constants"]
    if form.kind is CircleTrack:
        at = ca.vertcat(given[f"{side} phase"] * length, SX(2, 1))
        frame = circle_kernel(surface, "frames").function(at, constants)
        return restoring_axis(surface).function(frame[:AXIS], p)
    if form.kind is FlatTrack:
        n = p.numel()
        begin, slope, aside = constants[n : n + 3], constants[n + 3 : n + 5], constants[n + 5 :]
        at = begin[:2] + slope * length
        return ca.vertcat(at - aside * moved if form.driven else at, begin[2])
    own = geodesic_form(surface, form.ambient)
    assert own is not None
    whole = own.body.function(given[f"{side} end"], constants)
    return whole[:AXIS] if form.ambient else whole


def _limits(track: Track) -> list[tuple[float, float]]:
    """Between which the facts of :func:`_held` must lie for the track to be of its kind."""
    if isinstance(track, GeodesicTrack):
        return [(TINY, math.inf)]
    if isinstance(track, MovingTrack):
        return []
    assert isinstance(track, (CircleTrack, FlatTrack))
    turns = LONG_PHASE / max(track.piece.arc_length(track.stop - track.start), TINY)
    if isinstance(track, CircleTrack):
        return [(0.0, turns)]
    return [(0.0, turns / 2), (0.0, LONG_PHASE / 2)]


def _moved(track: Track, held: dict[str, np.ndarray], w: np.ndarray, v: np.ndarray, slip: float,
           name: str) -> Track:  # fmt: skip
    """The track of a kind that holds other numbers: arrays of all bodies by the fields' names.

    Its tolerance is asked for later; slip may be 0 where it is not known yet.
    """
    constants = held["constants"]
    if isinstance(track, (CircleTrack, FlatTrack)):
        made: CircleTrack | FlatTrack
        if isinstance(track, CircleTrack):
            circle = Circle(w, held["pace"][:, 0], held["phase"][:, 0], constants, True)
            made = track.moved(circle)
        else:
            n, none = track.parameters.shape[1], 0 * w
            slipping = none if track.slip_length is None else v
            begin = constants[:, n : n + 3].copy()
            made = track.moved(begin, w, slipping, held["lame"], constants)
        made.__dict__["_long"] = False  # by the limits
        return made
    assert isinstance(track, MovingTrack)
    problem = track.problem.moved(
        held["start"], constants, scale=held["scale"], name=name,
        slip=(slip or track.problem.slip) if track.problem.slip > 0 else 0.0,
    )  # fmt: skip
    return track.moved(1.0, problem, w, None if track.v is None else v)


def _needed(form: _Form, surface: Surface) -> dict[str, int]:
    """What tells where a track ends, by name, and how many numbers it is."""
    if form.kind is CircleTrack:
        return {"constants": circle_kernel(surface, "frames").n_constant, "phase": 1}
    if form.kind is FlatTrack:
        return {"constants": line_evaluator(surface, "points", form.driven).kernel.n_constant}
    if form.kind is GeodesicTrack:
        own = geodesic_form(surface, form.ambient)
        assert own is not None
        return {"constants": own.motion.n_constant, "end": own.motion.n_result}
    return {"end": standing_size(form.ambient)}


@per_structure
def _stage(
    finger: Surface, obj: Surface, ended: Forms | None, begun: Forms
) -> tuple[Kernel, dict[str, int], dict[str, int]]:
    """Kernel from what is given of a contact to facts and fields; the widths of given and fields.

    ended, begun: the tracks that end and begin there; None: it is the start. constant: parameters
    and sizes of finger and object, NUMBERS. Facts: length of V; at the start, those of W_1 and
    W_2 - V in sizes; those of the tracks.
    """
    surfaces, names = (finger, obj), ("1", "2")
    p = [SX.sym(f"p{name}", len(s.parameters)) for name, s in zip(names, surfaces)]
    sizes, numbers = SX.sym("sizes", 2), SX.sym("numbers", NUMBERS)
    begins: list[SX] = [SX(3, 1), SX(3, 1)]
    axes: list[SX | None] = [None, None]
    fields: Fields = {}
    if ended is None:
        given = {"start": SX.sym("start", GIVEN)}
        start = given["start"]
        angle, w1 = start[4], start[5:7]
        found = contact_start().function(ca.vertcat(angle, w1, start[7:9]), NONE)
        r0, w2, v = ca.vertsplit(found, [0, 4, 6, 8])
        begins = [ca.vertcat(start[2 * k : 2 * k + 2], 0) for k in range(2)]
        fields = {"r0": r0, "angle": angle, "begin1": begins[0], "begin2": begins[1]}
        facts = [ca.norm_2(v), ca.norm_2(w1) / sizes[0], ca.norm_2(w2 - v) / sizes[1]]
    else:
        given = {
            name: SX.sym(name, n) for name, n in (("r0", 4), ("angle", 1), ("w1", 2), ("v", 2))
        }
        r0, angle, w1, v = given.values()
        v, rows = v * numbers[3], {}
        if ended[1].kind is PanelTrack:
            n1, n2 = (standing_size(form.ambient) if form is not None else 0 for form in ended)
            pushed = ended[1].driven
            n1 = n1 + 2 if pushed else 0
            end = given["forced end"] = SX.sym("end", n1 + n2 + 2)
            rows, v = {0: end[: n1 - 2], 1: end[n1 : n1 + n2]}, end[n1 + n2 :]
            w1 = end[n1 - 2 : n1] if pushed else w1
        for k, (form, name) in enumerate(zip(ended, names)):
            if form is None:
                continue
            if form.kind is PanelTrack:
                state = rows[k]
            else:
                for key, width in _needed(form, surfaces[k]).items():
                    given[f"{name} {key}"] = SX.sym(key, width)
                state = _end(form, surfaces[k], p[k], given, name, numbers)
            if form.ambient:
                axes[k] = state
            elif prefers_ambient(surfaces[k]):
                axes[k] = axis_kernel(surfaces[k]).function(state, p[k])
            else:
                begins[k] = state
        w2 = ca.reshape(r0, 2, 2).T @ w1
        facts = [ca.norm_2(v)]
    w = w1, w2
    bodies = [_Body(s, p[k], sizes[k], begins[k], axes[k], w[k], v) for k, s in enumerate(surfaces)]
    fields |= {"w1": w1, "w2": w2, "v": v}
    if begun[1].kind is PanelTrack:
        fields |= _forced(begun, bodies, angle, numbers)
    for name, form, body in zip(names, begun, bodies):
        if form is not None and form.kind is not PanelTrack:
            own, more = _held(form, body, numbers[8:10])
            fields |= {f"{name} {key}": value for key, value in own.items()}
            facts += more
    kernel = Kernel(
        "stage", ca.vertcat(*given.values()), ca.vertcat(*p, sizes, numbers),
        ca.vertcat(*facts, *fields.values()),
    )  # fmt: skip
    widths = [{key: x.numel() for key, x in found.items()} for found in (given, fields)]
    return kernel, widths[0], widths[1]


# --- kinds ----------------------------------------------------------------------------------------


class Begun:
    """Where a scene of a kind starts: its numbers, laid out.

    Attributes
    ----------
    kind : Kind
    block : ctypes array of double
    at : int
        Its address.
    """

    __slots__ = ("_group", "at", "block", "kind")

    def __init__(self, kind: Kind, block: Any, at: int):
        self.kind, self.block, self.at = kind, block, at
        self._group: Group | None = None

    def groups(self, scene: Scene, tolerance: float) -> list[Group]:
        """The scene's plan."""
        kind = self.kind
        if not kind.alone:  # where slip is rounding, planning may tell it from none
            return plan_groups(scene, None, 0.0, tolerance, kind.compiled)
        if self._group is None:
            self._group = kind.group(self.block, group_name(scene, kind.planned.contacts))
        return [self._group.again(tolerance)]

    def fill(
        self, output: str, count: int, t: np.ndarray, out: np.ndarray, tolerance: float
    ) -> int:
        """As :meth:`Program.fill`, without motions that are kept; < 0: ask the group."""
        kind = self.kind
        program = kind.program(output)
        if program is None:
            return -1
        head = kind.at, self.at, tolerance, program.at, len(program.parts), count
        return by_contacts(kind.library.fill_begun, head, kind.nb, t, out)

    @property
    def r0(self) -> np.ndarray:
        """As in :class:`Group`."""
        return self._field("r0").reshape(-1, 2, 2)

    @property
    def angle(self) -> np.ndarray:
        """As in :class:`Group`."""
        return self._field("angle")

    def _field(self, name: str) -> np.ndarray:
        first, width = self.kind.stages[0].fields[name]
        return np.frombuffer(self.block)[first : first + self.kind.nb * width]

    def states(self, t: np.ndarray, out: np.ndarray, tolerance: float) -> int:
        """Chart states (n, 9, n_t) as :meth:`ChartStates.fill`, in the same way."""
        kind = self.kind
        assert kind.states is not None
        head = kind.at, self.at, tolerance, kind.states, 0, 0
        return by_contacts(kind.library.states, head, kind.nb, t, out)


class _Field(ctypes.Structure):
    """``field_t`` of c/program.c."""

    _fields_ = [(name, ctypes.c_long) for name in ("at", "width", "place")]


class _Move(ctypes.Structure):
    """``move_t`` of c/program.c."""

    _fields_ = [("motion", ctypes.c_void_p), ("end", ctypes.c_long)]


class _Stage(ctypes.Structure):
    """``stage_t`` of c/program.c."""

    _fields_ = [(name, ctypes.c_void_p) for name in (
        "find", "parameters", "limits", "given", "fields", "moves")]  # fmt: skip
    _fields_ += [(name, ctypes.c_long) for name in (
        "n_parameters", "n_facts", "facts", "n_given", "n_fields", "n_moves")]  # fmt: skip


class _Kind(ctypes.Structure):
    """``kind_t`` of c/program.c."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("stages", "rows", "block")]
    _fields_ += [(name, ctypes.c_long) for name in ("nb", "n_stages", "n_moves", "size")]


Tracks = tuple[Track | None, Track]
"""Those of finger and object that begin, or end, at one time; the object's are cut there."""

Places = dict[str, tuple[int, int]]
"""Where numbers are in a block, of contact 0, and how many there are of each contact."""


@dataclass(eq=False)
class Stage:
    """Where tracks of a kind begin.

    Attributes
    ----------
    tracks : Tracks
    facts : int
        Where its facts are in a block; the first is slip.
    fields : Places
    ends : Places
        Where the last states of its motions go, in the order of :func:`_motions`.
    """

    tracks: Tracks
    facts: int
    fields: Places
    ends: Places


class Kind:
    """What scenes of one kind share.

    Attributes
    ----------
    compiled : bool or None
        The wish of those who plan them.
    nb : int
        Contacts of a scene.
    stages : list of Stage
    planned : Group
        One of them; its tracks point into a block of the kind's own.
    alone : bool
        Nothing disturbs it, and a block says all of a plan.
    closed : bool
        Nothing is integrated either.
    charted : bool
        Bodies are moved in charts that may have singular points: each plan is looked at.
    states : int or None
        Address of a :class:`ChartStates`.

    Raises
    ------
    NoKind
        The scene has no kind after all.
    """

    def __init__(self, scene: Scene, group: Group, compiled: bool | None):
        self.compiled, self.library, self.nb = compiled, program_library(), len(scene.contacts)
        starts = [track.start for track in group.object]
        self.stages: list[Stage] = []
        self._size, self._kept = 0, []  # addresses point into what is kept
        laid_out = (_Stage * len(starts))()
        known = {"start": self._place(self.nb, GIVEN)}
        for k, start in enumerate(starts):
            begun = _at_edge(group, "start", start)
            ended = _at_edge(group, "stop", start) if k else None
            laid_out[k] = self._lay_out(scene, group, begun, ended, known)
        self.alone = len(starts) == 1 and not scene.disturbances
        self._block = ctypes.c_double * self._size
        own, rows = self._block(), np.outer([1, MOST_AT_ONCE], np.arange(MOST_FOUND)).astype("l")
        self._data = _Kind(
            ctypes.addressof(laid_out), rows.ctypes.data, ctypes.addressof(own), self.nb,
            len(starts), sum(len(stage.ends) for stage in self.stages), self._size,
        )  # fmt: skip
        self._kept += [laid_out, own, rows]
        self._layouts: dict[str, Any] = {}
        self.at, self.planned = ctypes.addressof(self._data), group
        first = self.begin(scene)
        if first is None:
            raise NoKind("beyond its own limits")
        ctypes.memmove(own, first.block, ctypes.sizeof(own))
        moved = self._tracks(own, group_name(scene, group.contacts))
        self._motions: list[Motion] = []
        for data, stage, tracks in zip(laid_out, self.stages, moved):
            found, moves = _motions(tracks), (_Move * data.n_moves).from_address(data.moves)
            for move, (name, motion) in zip(moves, found.items()):
                move.motion, move.end = motion.at, stage.ends[name][0]
            self._motions += found.values()
            stage.tracks = tracks  # learned from no more: those keep panels
        self.planned = self._group(own, moved)
        self.closed = self.alone and not self._motions
        self.charted = bool(list(charted([group])))
        self._programs: dict[str, Program | None] = {}
        states = chart_states(self.planned, compiled) if self.alone else None
        self.states = None if states is None else states.at

    def _lay_out(
        self, scene: Scene, group: Group, begun: Tracks, ended: Tracks | None, known: Places
    ) -> _Stage:
        """The next stage but for its motions; known: where numbers of the stages before it are."""
        fingers, obj, nb = [contact.finger for contact in scene.contacts], scene.object, self.nb
        before, forms = (None if x is None else tuple(map(_Form.of, x)) for x in (ended, begun))
        kernel, given, fields = _stage(fingers[0], obj, before, forms)
        if not kernel.usable(self.compiled):
            raise NoKind("not built")
        if max(kernel.n_point, kernel.n_result) > MOST_FOUND:
            raise NoKind("too much")
        limits = np.array(_stage_limits(group, begun, ended is None))
        facts, _ = self._place(1, len(limits))
        places = {key: self._place(nb, n) for key, n in fields.items()}
        stage = Stage(begun, facts, places, {})
        into = [_field_data(known[name] for name in given)]
        into.append(_field_data(stage.fields.values(), len(limits)))
        for name, motion in _motions(begun).items():
            stage.ends[name] = self._place(nb, motion.data.nx)
            known[f"{name} end"] = stage.ends[name]
        known.update(stage.fields)
        self.stages.append(stage)
        numbers, moves = _numbers(group, begun, ended), (_Move * len(stage.ends))()
        parameters = np.array([
            [*finger.parameters, *obj.parameters, finger.size, obj.size, *own]
            for finger, own in zip(fingers, numbers.tolist())
        ])  # fmt: skip
        self._kept += [parameters, limits, into, moves]
        return _Stage(
            function_address(kernel.library), address(parameters), address(limits),
            *map(ctypes.addressof, into), ctypes.addressof(moves), parameters.shape[1],
            len(limits), facts, *map(len, into), len(moves),
        )  # fmt: skip

    def _place(self, count: int, width: int) -> tuple[int, int]:
        """Room for so many times so many numbers."""
        first = self._size
        self._size += count * width
        return first, width

    def program(self, output: str) -> Program | None:
        """The program of a scene's parts for ``fill_begun``; None where there is none."""
        if output not in self._programs:
            with LOCK:
                if output not in self._programs:
                    self._programs[output] = self._program(output)
        return self._programs[output]

    def _program(self, output: str) -> Program | None:
        found = group_program(self.planned, output)
        for part, track in zip(found.parts, found.tracks) if found is not None else ():
            if isinstance(track, PanelTrack) and track.motion is not None:
                part.moves = 1 + self._motions.index(track.motion)
                part.row = track.rows.start or 0
            if output == "coordinates" and not self.closed:
                self._continue(part, track)
        return found

    def _continue(self, part: Any, track: Track) -> None:
        """Tell C how coordinates of a track continue those before it."""
        part.begin = address(self.planned.begin[track in self.planned.object])
        if isinstance(track, CircleTrack) and not part.first:
            part.branch = function_address(circle_branch().library)
            part.path = address(track.circle.w)
        elif isinstance(track, PanelTrack) and track.ambient:
            part.anchor = function_address(track.evaluator("coordinates").library.anchor)

    def begin(self, scene: Scene) -> Begun | None:
        """A scene with the same key; None if it is of another kind all the same."""
        block = self._block()
        at = ctypes.addressof(block)
        return (
            None if self.library.begin(self.at, scene.packed_starts, at) else Begun(self, block, at)
        )

    def group(self, block: Any, name: str) -> Group:
        """The plan of a scene from its block, which says all of it if nothing disturbs it."""
        return self._group(block, self._tracks(block, name))

    def _group(self, block: Any, moved: Sequence[Tracks]) -> Group:
        """Tracks as a group, which knows of slip if nothing disturbs it."""
        first, planned = self._fields(block, self.stages[0]), self.planned
        r0 = first["r0"].reshape(self.nb, 2, 2)
        begin = first["begin1"], first["begin2"]
        group = Group(planned.contacts, r0, first["angle"][:, 0], begin)
        group.finger = [tracks[0] for tracks in moved if tracks[0] is not None]
        group.object = [tracks[1] for tracks in moved]
        if self.alone:
            record, slip = planned.slips[0], self._slip(block, self.stages[0])
            of = slip_of(first["v"], slip, record.piece)
            group.slips = [dataclasses.replace(record, of=of, pushed=first["w1"])]
        group.layouts = self._layouts
        return group

    def _tracks(self, block: Any, name: str) -> list[Tracks]:
        """The tracks of a scene, stage by stage. Where those of later stages begin is filled in by
        C."""
        turn = self._fields(block, self.stages[0])["r0"].reshape(self.nb, 2, 2)
        found: list[Tracks] = []
        for stage in self.stages:
            held, slip = self._fields(block, stage), self._slip(block, stage)
            w, motion = (held["w1"], held["w2"]), _motions(stage.tracks).get("forced")
            made: list[Any] = [None, None]
            if motion is not None:
                start, numbers, scale = (
                    held[f"forced {x}"] for x in ("start", "constants", "scale")
                )
                motion = motion.again(1.0, motion.problem.moved(start, numbers, scale=scale))
            for k, track in enumerate(stage.tracks):
                if isinstance(track, PanelTrack) and track.forced is not None:
                    assert motion is not None
                    made[k] = track.forced_by(motion, w[k], turn if track.forced.v else None)
                elif track is not None:
                    own = {key[2:]: x for key, x in held.items() if key.startswith(f"{k + 1} ")}
                    made[k] = _moved(track, own, w[k], held["v"], slip, name)
            found.append((made[0], made[1]))
        return found

    def _fields(self, block: Any, stage: Stage) -> dict[str, np.ndarray]:
        """The fields of a stage in a block: (nb, width) each."""
        memory, nb = np.frombuffer(block), self.nb
        return {
            key: memory[first : first + nb * width].reshape(nb, width)
            for key, (first, width) in stage.fields.items()
        }

    def _slip(self, block: Any, stage: Stage) -> float:
        return block[stage.facts]


def _field_data(places: Iterable[tuple[int, int]], at: int = 0) -> ctypes.Array[_Field]:
    """Numbers side by side, the first at ``at``, and where they are in a block."""
    found = []
    for place, width in places:
        found.append(_Field(at, width, place))
        at += width
    return (_Field * len(found))(*found)


def _at_edge(group: Group, edge: str, t: float) -> Tracks:
    """Whose "start", or "stop", is at time t."""
    finger, obj = (
        [x for x in side if getattr(x, edge) == t] for side in (group.finger, group.object)
    )
    return (finger[0] if finger else None), obj[0]


def _motions(tracks: Tracks) -> dict[str, Motion]:
    """What moves tracks: "1", "2", or "forced", which moves both."""
    found: dict[str, Motion] = {}
    for name, track in zip("12", tracks):
        if isinstance(track, PanelTrack) and track.motion is not None:
            found["forced" if track.forced is not None else name] = track.motion
    return found


def _forcing(tracks: Tracks) -> Forced | None:
    """Of the object's track, if the contact is accelerated."""
    track = tracks[1]
    return track.forced if isinstance(track, PanelTrack) else None


def _record(group: Group, tracks: Tracks) -> SlipRecord:
    """Of the interval in which the object's track begins."""
    return next(record for record in group.slips if record.start == tracks[1].start)


def _stage_limits(group: Group, begun: Tracks, first: bool) -> list[tuple[float, float]]:
    """Between which the facts of :func:`_stage` must lie."""
    record, forced = _record(group, begun), _forcing(begun)
    none, any_ = (0.0, 0.0), (TINY, math.inf)
    if forced is None:
        limits = [none if record.of is None else any_]
    else:
        assert forced.motion is not None
        slips = not first or forced.motion.problem.start[:, -2:].any()
        limits = [(TINY if first else 0.0, math.inf) if slips else none]
    if first:
        path = sum(r.piece.arc_length(r.stop - r.start) for r in group.slips)
        limits += [(0.0, ENDLESS / max(path, TINY))] * 2
    for track in begun:
        if track is not None and not (isinstance(track, PanelTrack) and track.forced is not None):
            limits += _limits(track)
    return limits


def _numbers(group: Group, begun: Tracks, ended: Tracks | None) -> np.ndarray:
    """NUMBERS of each contact, for :func:`_stage`."""
    out, forced = np.zeros((len(group.contacts), NUMBERS)), _forcing(begun)
    for k, track in enumerate(ended or ()):
        if isinstance(track, (CircleTrack, FlatTrack)):
            out[:, k] = track.piece.arc_length(track.stop - track.start)
        if isinstance(track, FlatTrack) and track.slip_length is not None:
            out[:, 2] = track.slip_length.end[0, 1]
    if ended is not None and _forcing(ended) is None:
        record = _record(group, ended)
        span = record.stop - record.start
        if record.of is not None:
            out[:, 3] = record.piece.decay(span, record.piece.speed(span))
    if forced is not None:
        assert forced.motion is not None
        out[:, 4:10] = forced.motion.problem.constants[:, -6:]
        out[:, 10] = forced.grown
    elif begun[1].offset is not None:
        out[:, 8:10] = begun[1].offset
    return out


def _has_kind(scene: Scene, groups: Sequence[Group], compiled: bool | None) -> bool:
    """Whether scenes like this one are planned by numbers alone."""
    group = groups[0]
    surfaces = [scene.object, *(contact.finger for contact in scene.contacts)]
    if len(groups) > 1 or not all(s.has_chart for s in surfaces):
        return False
    if scene.contacts[0].follows:  # by its chart equations, which reach a pole for some of a kind
        return False
    tracks = group.finger + group.object
    return all(map(_repeats, tracks)) and (bool(compiled) or program_built())


def _repeats(track: Track) -> bool:
    """Whether numbers alone change in a track that begins elsewhere."""
    if isinstance(track, FlatTrack):
        slip = track.slip_length  # without an end it depends on how large slip is
        return track.offset is None and (slip is None or bool(slip.end[0, 1]))
    if track.ambient != prefers_ambient(track.surface) and track.start > 0.0:
        return False  # in its chart, on the branch that the tracks before have come to
    if isinstance(track, MovingTrack):
        if track.by_length and type(track) is MovingTrack:  # a body rests, others of a kind may not
            if geodesic_form(track.surface, track.ambient) is not None:
                return False
        return track.motion is not None and not track.problem.stops
    forced = type(track) is PanelTrack and track.motion is not None
    return forced or isinstance(track, CircleTrack)


# --- kinds that were seen -------------------------------------------------------------------------


@dataclass
class _Learned:
    """How many scenes of a family were planned in full that may have a kind, and which they have.

    A family has few kinds: with slip, without, at rest.
    """

    count: int = 0
    kinds: list[Kind] = field(default_factory=list)


def are_few(scene: Scene) -> bool:
    """Whether a scene may have a kind: to compare disturbances of a crowd costs too much."""
    return not scene.disturbances or len(scene.contacts) <= MOST_ALIKE


def begin(scene: Scene, compiled: bool | None) -> Begun | None:
    """What a scene of a known kind is planned from; None for others."""
    known: Begun | None = scene.__dict__.get("_begun")
    if known is not None and known.kind.compiled is compiled:
        return known
    learned: _Learned | None = family(scene).learned.get(compiled)
    for kind in learned.kinds if learned is not None else ():
        begun = kind.begin(scene)
        if begun is not None:
            scene.__dict__["_begun"] = begun
            return begun
    return None


def learn(scene: Scene, groups: Sequence[Group], compiled: bool | None) -> None:
    """From the second scene on that was planned in full: what the next of its kind will need."""
    if not _has_kind(scene, groups, compiled):
        return
    learned = family(scene).learned.setdefault(compiled, _Learned())
    learned.count += 1
    if 1 < learned.count <= ATTEMPTS:
        with contextlib.suppress(NoKind):
            learned.kinds.append(Kind(scene, groups[0], compiled))
