"""Scenes of one kind, whose plans differ in numbers only.

Surfaces, profile, gain law and duration decide how undisturbed contacts are planned; where they
start enters as numbers. Once two scenes of a kind have been planned, one kernel works out all that
the tracks of a third hold, into one block of memory, and C evaluates the tracks of the kind with
that block in the place of their own: planning takes 4 us instead of 150.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import itertools
import math
import struct
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from .closed_form import (
    LONG_PHASE,
    Circle,
    CircleTrack,
    FlatTrack,
    circle_branch,
    circle_start,
    turned,
)
from .development import (
    MOST_FOUND,
    GeodesicTrack,
    MovingTrack,
    contact_start,
    geodesic_form,
    program_built,
    program_library,
)
from .kernels import Kernel, address, function_address, per_structure
from .planner import ENDLESS, TINY, Group, alike, group_name, slip_of, start_numbers
from .scene import Scene
from .surfaces import Surface
from .tracks import Track, axis_kernel, lame_kernel, scale_kernel

SX = ca.SX

GIVEN = 9  # numbers of a start
PACK = struct.Struct(f"{GIVEN}d").pack
SEEN = 1024  # keys that are remembered
ATTEMPTS = 6  # scenes of a key from which kinds are learned

Fields = dict[str, SX]
"""What a track holds of a body, by name."""

NONE = SX(0, 1)


# --- what tracks hold, from where a body starts ---------------------------------------------------


@dataclass(frozen=True)
class _Body:
    """A body of one contact where it starts, in symbols.

    Attributes
    ----------
    surface : Surface
    p, size : its parameters and size
    begin : u, v, theta
    w, v : path velocity W and slip V
    """

    surface: Surface
    p: SX
    size: SX
    begin: SX
    w: SX
    v: SX

    def state(self, ambient: bool) -> SX:
        """(x, p), or (u, v, theta)."""
        if not ambient:
            return self.begin
        return axis_kernel(self.surface).function(self.begin, self.p)


class _Form(NamedTuple):
    """What decides how a track is filled with numbers."""

    kind: type[Track]
    ambient: bool
    driven: bool

    @classmethod
    def of(cls, track: Track) -> _Form:
        slips = track.slip_length if isinstance(track, FlatTrack) else getattr(track, "v", None)
        return cls(type(track), track.ambient, slips is not None)


def _held(form: _Form, body: _Body) -> tuple[Fields, list[SX]]:
    """The fields of a track, and numbers that must keep within its :func:`_limits`."""
    if form.kind is CircleTrack:
        found = circle_start(body.surface).function(ca.vertcat(body.state(True), body.w), body.p)
        constants, pace, phase = found[:-5], found[-2], found[-1]
        branch = circle_branch().function(ca.vertcat(body.begin[1:], body.w, constants[-4:]), NONE)
        return {"pace": pace, "phase": phase, "constants": ca.vertcat(constants, branch)}, [phase]
    if form.kind is FlatTrack:
        lame = lame_kernel(body.surface).function(body.begin, body.p)
        slope, aside = (
            turned().function(ca.vertcat(body.begin[2], x), NONE) / lame for x in (body.w, body.v)
        )
        reach = [ca.mmax(ca.fabs(x)) / body.size for x in (slope, body.begin[:2])]
        slopes = ca.vertcat(slope, aside) if form.driven else slope
        return {"lame": lame, "constants": ca.vertcat(body.p, body.begin, slopes)}, reach
    state, facts = body.state(form.ambient), []
    scale = scale_kernel(body.surface, form.ambient).function(state, ca.vertcat(body.p, body.size))
    if form.kind is GeodesicTrack:
        own = geodesic_form(body.surface, form.ambient)
        assert own is not None
        n, rates = own.motion.n_result, own.n_rates
        found = own.start.function(ca.vertcat(state, body.w), body.p)
        state, numbers = found[:n], found[n:-rates]
        scale, facts = ca.vertcat(scale[: n - rates], found[-rates:]), [ca.norm_2(body.w)]
    else:
        numbers = ca.vertcat(body.w, body.v if form.driven else SX(2, 1), SX(2, 1))
    return {"start": state, "constants": ca.vertcat(body.p, numbers), "scale": scale}, facts


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
           name: str, tolerance: float) -> Track:  # fmt: skip
    """The track of a kind that holds other numbers: arrays of all bodies by the fields' names."""
    constants = held["constants"]
    if isinstance(track, CircleTrack):
        return track.moved(Circle(w, held["pace"][:, 0], held["phase"][:, 0], constants, True))
    if isinstance(track, FlatTrack):
        n = track.parameters.shape[1]
        slipping = v if track.slip_length is not None else 0 * w
        return track.moved(constants[:, n : n + 3].copy(), w, slipping, held["lame"], constants)
    assert isinstance(track, MovingTrack)
    problem = track.problem.moved(
        held["start"], constants, scale=held["scale"], name=name,
        slip=slip if track.problem.slip > 0 else 0.0,
    )  # fmt: skip
    return track.moved(tolerance, problem, w, None if track.v is None else v)


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

    def group(self, scene: Scene, tolerance: float) -> Group:
        """The scene's plan."""
        if self._group is None:
            self._group = self.kind.group(self.block, group_name(scene, self.kind.planned.contacts))
        return self._group.again(tolerance)

    def fill(
        self, output: str, count: int, t: np.ndarray, out: np.ndarray, tolerance: float
    ) -> int:
        """As :meth:`Program.fill`, without motions that are kept; < 0: ask the group."""
        kind = self.kind
        program = kind.program(output)
        if program is None:
            return -1
        return kind.library.fill_begun(
            kind.at, self.at, tolerance, *program, count, len(t), address(t), address(out)
        )

    @property
    def r0(self) -> np.ndarray:
        """As in :class:`Group`."""
        first, width = self.kind.places["r0"]
        n = self.kind.nb
        return np.frombuffer(self.block)[first : first + n * width].reshape(n, 2, 2)

    def states(self, t: np.ndarray, out: np.ndarray, tolerance: float) -> int:
        """Chart states (n, 9, n_t) as :meth:`ChartStates.fill`, in the same way."""
        kind = self.kind
        return kind.library.states(
            kind.at, self.at, tolerance, kind.states, kind.nb, len(t), address(t), address(out)
        )


class _Field(ctypes.Structure):
    """``field_t`` of c/program.c."""

    _fields_ = [(name, ctypes.c_long) for name in ("start", "width", "to")]


class _Kind(ctypes.Structure):
    """``kind_t`` of c/program.c."""

    _fields_ = [(name, ctypes.c_void_p) for name in (
        "start", "parameters", "limits", "rows", "fields", "block")]  # fmt: skip
    _fields_ += [(name, ctypes.c_long) for name in (
        "nb", "n_start", "n_parameters", "n_facts", "n_fields", "size")]  # fmt: skip


class Kind:
    """What scenes of one kind share.

    Attributes
    ----------
    compiled : bool or None
        The wish of those who plan them.
    nb : int
        Contacts of a scene.
    planned : Group
        One of them; its tracks point into a block of the kind's own.
    places : dict
        Where the fields begin in a block, and how many numbers each has of a contact.
    closed : bool
        Nothing is integrated.
    states : int or None
        Address of a :class:`ChartStates`.

    Raises
    ------
    LookupError
        The scene has no kind after all.
    """

    def __init__(self, scene: Scene, group: Group, compiled: bool | None):
        self.compiled, self.library, self.nb = compiled, program_library(), len(scene.contacts)
        surfaces = [contact.finger for contact in scene.contacts]
        bodies = [(finger, scene.object) for finger in surfaces]
        parameters = np.array([[*f.parameters, *o.parameters, f.size, o.size] for f, o in bodies])
        tracks, record = (group.finger[0], group.object[0]), group.slips[0]
        kernel, layout = _begin(*bodies[0], tuple(map(_Form.of, tracks)))
        path = max(record.piece.arc_length(record.stop - record.start), TINY)
        slips = (0.0, 0.0) if record.of is None else (TINY, math.inf)
        limits = [slips, *[(0.0, ENDLESS / path)] * 2, *_limits(tracks[0]), *_limits(tracks[1])]
        if not (kernel.built if compiled is None else compiled):
            raise LookupError("not built")
        if kernel.n_result > MOST_FOUND:
            raise LookupError("too much")
        nb, n_facts = self.nb, len(limits)
        rows = np.arange(max(kernel.n_result, GIVEN), dtype=np.dtype("l"))
        ends = list(itertools.accumulate(layout.values(), initial=0))
        self.places = {
            name: (n_facts + first * nb, width)
            for (name, width), first in zip(layout.items(), ends)
        }
        fields = (_Field * len(layout))(*[
            _Field(n_facts + first, width, self.places[name][0])
            for (name, width), first in zip(layout.items(), ends)
        ])  # fmt: skip
        size = n_facts + ends[-1] * nb
        self._block = ctypes.c_double * size
        own = self._block()
        kept = np.array(limits)
        self._data = _Kind(
            function_address(kernel.library), address(parameters), address(kept), rows.ctypes.data,
            ctypes.addressof(fields), ctypes.addressof(own), nb, GIVEN, parameters.shape[1],
            n_facts, len(layout), size,
        )  # fmt: skip
        self._kept = parameters, kept, rows, fields, own  # addresses point into them
        self._layouts: dict[str, Any] = {}
        self.at, self.planned = ctypes.addressof(self._data), group
        begun = self.begin(scene)
        if begun is None:
            raise LookupError("beyond its own limits")
        ctypes.memmove(own, begun.block, ctypes.sizeof(own))
        self.planned = self.group(own, group_name(scene, group.contacts))
        self.closed = not self.planned.moving
        self._programs: dict[str, tuple[int, int] | None] = {}
        states = self.planned.chart_states(compiled)
        self.states = None if states is None else states.at

    def program(self, output: str) -> tuple[int, int] | None:
        """Address and number of the parts of :class:`Program`; None where there is none."""
        if output not in self._programs:
            ready = output != "coordinates" or self.closed  # else they are to be anchored
            found = self.planned.program(output) if ready else None
            self._programs[output] = None if found is None else (found.at, len(found.parts))
        return self._programs[output]

    def begin(self, scene: Scene) -> Begun | None:
        """A scene with the same key; None if it is of another kind all the same."""
        starts = b"".join([PACK(*start_numbers(contact)) for contact in scene.contacts])
        block = self._block()
        at = ctypes.addressof(block)
        return None if self.library.begin(self.at, starts, at) else Begun(self, block, at)

    def group(self, block: Any, name: str) -> Group:
        """The plan of a scene from its block."""
        memory, planned = np.frombuffer(block), self.planned
        nb = len(planned.contacts)
        a = {
            key: memory[first : first + nb * width].reshape(nb, width)
            for key, (first, width) in self.places.items()
        }
        slip, w, v = float(memory[0]), (a["w1"], a["w2"]), a["v"]
        record = planned.slips[0]
        group = Group(
            planned.contacts,
            a["r0"].reshape(nb, 2, 2),
            a["angle"][:, 0],
            (a["begin1"], a["begin2"]),
        )
        held = [{k[2:]: a[k] for k in a if k.startswith(side)} for side in ("1 ", "2 ")]
        group.finger, group.object = (
            [_moved(tracks[0], held[k], w[k], v, slip, name, 1.0)]
            for k, tracks in enumerate((planned.finger, planned.object))
        )
        group.slips = [dataclasses.replace(record, of=slip_of(v, slip, record.piece), pushed=w[0])]
        group.layouts = self._layouts
        return group


@per_structure
def _begin(
    finger: Surface, obj: Surface, forms: tuple[_Form, _Form]
) -> tuple[Kernel, dict[str, int]]:
    """Kernel from a start to facts and fields; the fields' widths.

    constant: parameters and sizes of finger and object. Facts: length of V, of W_1 and W_2 - V in
    sizes, those of the tracks.
    """
    given, sizes = SX.sym("given", GIVEN), SX.sym("sizes", 2)
    angle, w1, y = given[4], given[5:7], given[7:9]
    found = contact_start().function(ca.vertcat(angle, w1, y), NONE)
    r0, w2, v = ca.vertsplit(found, [0, 4, 6, 8])
    p = [SX.sym(f"p{k}", len(s.parameters)) for k, s in enumerate((finger, obj))]
    bodies = [
        _Body(s, p[k], sizes[k], ca.vertcat(given[2 * k : 2 * k + 2], 0), (w1, w2)[k], v)
        for k, s in enumerate((finger, obj))
    ]
    fields = {"w1": w1, "w2": w2, "v": v, "r0": r0, "angle": angle}
    fields |= {"begin1": bodies[0].begin, "begin2": bodies[1].begin}
    facts = [ca.norm_2(v), ca.norm_2(w1) / sizes[0], ca.norm_2(w2 - v) / sizes[1]]
    for side, form, body in zip("12", forms, bodies):
        own, more = _held(form, body)
        fields |= {f"{side} {key}": value for key, value in own.items()}
        facts += more
    kernel = Kernel("begin", given, ca.vertcat(*p, sizes), ca.vertcat(*facts, *fields.values()))
    return kernel, {key: x.numel() for key, x in fields.items()}


def _has_kind(scene: Scene, groups: Sequence[Group], compiled: bool | None) -> bool:
    """Whether scenes like this one are planned by numbers alone."""
    group = groups[0]
    if len(groups) > 1 or any(len(x) > 1 for x in (group.finger, group.object, group.slips)):
        return False
    surfaces = [scene.object, *(contact.finger for contact in scene.contacts)]
    if not all(s.has_chart for s in surfaces) or not group.repeats(1e-9):
        return False
    known = (CircleTrack, FlatTrack, MovingTrack)
    tracks = group.finger + group.object
    if not all(isinstance(t, known) for t in tracks):
        return False
    for track in tracks:
        if isinstance(track, MovingTrack) and track.motion is None:
            return False
        if isinstance(track, FlatTrack) and track.slip_length and not track.slip_length.end[0, 1]:
            return False  # that depends on how large slip is
    return bool(compiled) or program_built()


# --- kinds that were seen -------------------------------------------------------------------------


@dataclass
class _Sights:
    """How many scenes of one key were planned in full that may have a kind, and what was learned.

    A key has few kinds: with slip, without, at rest.
    """

    count: int = 0
    kinds: list[Kind] = field(default_factory=list)


_SEEN: dict[Hashable, _Sights] = {}


def _forget() -> None:
    """Make room: keys without a kind first, then all."""
    for key, sights in list(_SEEN.items()):
        if not sights.kinds:
            _SEEN.pop(key, None)
    if len(_SEEN) > SEEN // 2:
        _SEEN.clear()


def begin(scene: Scene, compiled: bool | None) -> Begun | None:
    """What an undisturbed scene of a known kind is planned from; None for others."""
    known: Begun | None = scene.__dict__.get("_begun")
    if known is not None and known.kind.compiled is compiled:
        return known
    seen = _SEEN.get((compiled, alike(scene)))
    for kind in seen.kinds if seen is not None else ():
        begun = kind.begin(scene)
        if begun is not None:
            scene.__dict__["_begun"] = begun
            return begun
    return None


def learn(scene: Scene, groups: Sequence[Group], compiled: bool | None) -> None:
    """From the second scene on that was planned in full: what the next of its kind will need."""
    if not _has_kind(scene, groups, compiled):
        return
    if len(_SEEN) > SEEN:
        _forget()
    seen = _SEEN.setdefault((compiled, alike(scene)), _Sights())
    seen.count += 1
    if 1 < seen.count <= ATTEMPTS:
        with contextlib.suppress(LookupError):
            seen.kinds.append(Kind(scene, groups[0], compiled))
