"""Stress cases of what steps a plan: FMUs, slaves in this process, ContactPlanner in Drake.

Stepped blocks are judged against `plan` of the same scene (which `stress_laws` judges by exact
laws), with the inputs that they were given as windows; derivatives of Model Exchange by the laws
of moving frames (theory section 4). Only what is free of charts is compared: slip by its length
or in E2, twist, pose, contact points.

Bounds of stepped blocks: 1e-12 of the greatest value of the quantity, and 16 eps for every radian
that the contact turns about the smallest body, or would at its last speed from the start: arc
length and time carry that many digits less. Normals, so rotation and twist, lose the curvature,
counted in sizes of the body (`_bend`).
Bounds of Drake's schemes are those of their order: see `_order_bound`.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import math
import re
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
from numpy.polynomial import polynomial

import contact_system as cs
from contact_system.errors import ContactSystemError
from contact_system.kernels import find_compiler
from contact_system.scene import DISTURBANCE_KINDS, Disturbance, Scene
from contact_system.system import COORDINATES

from .verdicts import Case, Family, Verdict, refusal

EPS = 2.0**-52
BUILT = True if find_compiler() else None
"""Plans are compiled, and slaves find what that built; kilometres take seconds otherwise."""
NAN = math.nan
Array = np.ndarray

# --- scenes --------------------------------------------------------------------------------------


def _hard() -> Scene:
    """A path that starts at rest, a gain of 1e9, every kind of disturbance, one inside another."""
    contacts = [
        cs.Contact(cs.Sphere(0.01), (0.3, 0.4), (1.2, 0.1), object_velocity="rest"),
        cs.Contact(cs.Cylinder(0.03), (2.0, -1.0), (0.2, 0.05), object_velocity=(0.3, -0.4)),
    ]
    windows = [
        cs.FingerAcceleration(0, 0.2, 0.6, (2.0, -1.0)),
        cs.ObjectAcceleration(0, 0.3, 0.4, (1.0, 1.0)),
        cs.ObjectRateOffset(1, 0.0, 0.35, (0.5, -0.2)),
    ]
    return cs.Scene(
        name="hard", object=cs.Torus(0.2, 0.08), contacts=contacts, disturbances=windows,
        profile=cs.Profile([0.0, 0.2, 0.5]), gain=cs.Gain.path(1e9), duration=1.0,
    )  # fmt: skip


def _bowl() -> Scene:
    """A marble in a bowl; the guaranteed law while sigma grows and falls; no window."""
    marble = cs.Contact(cs.Sphere(0.02), (1.9, 0.4), (0.9, 0.2), object_velocity=(0.1, 0.0))
    return cs.Scene(
        name="bowl", object=cs.Sphere(0.1, inside=True), contacts=[marble],
        profile=cs.Profile([0.01, 0.5, -0.4]), gain=cs.Gain.guaranteed(30.0), duration=1.0,
    )  # fmt: skip


OWN: dict[str, Callable[[], Scene]] = {"hard": _hard, "bowl": _bowl}
STEPPED = ("K2", "K3", "K4", "D1", "hard", "bowl")
HORIZON = 12.0
"""s; how far beyond their end scenes are stepped, where sigma lets them."""


@functools.cache
def scene_of(name: str) -> Scene:
    """A bundled scene, or one of this module."""
    return OWN[name]() if name in OWN else cs.load_scene(name)


@functools.cache
def horizon(name: str) -> float:
    """Until when a scene can go on, s: sigma > 0 and at most `HORIZON`."""
    scene = scene_of(name)
    roots = polynomial.polyroots(scene.profile.coefficients)
    real = roots[np.abs(roots.imag) < 1e-9].real
    return min([HORIZON, *real[real > scene.duration].tolist()])


@functools.cache
def long_plan(name: str) -> cs.Plan:
    """The plan of a scene that lasts until its horizon."""
    return cs.plan(scene_of(name).replace(duration=horizon(name)), 1e-14, compiled=BUILT)


# --- what is compared ----------------------------------------------------------------------------

QUANTITIES = {
    "slip": ("slip",), "twist": ("twist.angular", "twist.linear"),
    "pose": ("pose.rotation", "pose.position"), "points": ("finger.point", "object.point"),
}  # fmt: skip
"""Methods of a plan, and names of variables behind ``contact[i].``"""


def _planned(plan: cs.Plan, t: Array) -> dict[str, Array]:
    """Name of a variable -> (n_times, n_contacts, n)."""
    shape = (len(t), len(plan.scene.contacts), -1)
    twist, pose, points = plan.twist(t), plan.pose(t), plan.points(t)
    parts = (
        plan.slip(t), twist[..., :3], twist[..., 3:], pose[..., :3, :3], pose[..., :3, 3],
        points[..., 0, :], points[..., 1, :],
    )  # fmt: skip
    names = (name for names in QUANTITIES.values() for name in names)
    return {name: part.reshape(shape) for name, part in zip(names, parts, strict=True)}


def _bend(scene: Scene) -> float:
    """The greatest curvature where contacts start, in 1 / sizes of their bodies, or 1."""
    bodies = [(scene.object, c.object_at) for c in scene.contacts]
    bodies += [(c.finger, c.finger_at) for c in scene.contacts]
    return max(1.0, *(b.size * float(np.abs(b.curvature_form(*at)).max()) for b, at in bodies))


class Judge:
    """The errors of a case and the one that is nearest to its bound."""

    def __init__(self) -> None:
        self.share, self.verdict = -1.0, Verdict("right", 0.0, 1.0, "nothing was compared")

    def see(self, what: str, error: float, bound: float) -> None:
        """Note one comparison; NaN is beyond every bound."""
        share = error / bound if math.isfinite(error) else math.inf
        if share > self.share:
            outcome = "right" if share <= 1.0 else "silent"
            self.share, self.verdict = share, Verdict(outcome, float(error), float(bound), what)

    def motion(self, plan: cs.Plan, t: Array, found: dict[str, Array]) -> None:
        """Compare what was read at times t, (n_times, n_contacts, n) each.

        Blocks take times within 8 eps of a window's edge for the edge.
        """
        scene = plan.scene
        for edge in scene.window_edges:
            t = np.where(np.abs(t - edge) <= 8 * EPS * max(1.0, edge), edge, t)
        least = min(s.size for s in (scene.object, *(c.finger for c in scene.contacts)))
        last = t.max()  # which is known to its rounding only
        turned = float(scene.profile.arc_length(last) + last * scene.profile(last)) / least
        bent = _bend(scene)
        whole = _planned(plan, np.linspace(plan.start, scene.duration, 33)[:-1])
        for name, wanted in _planned(plan, t).items():
            size = max(np.abs(wanted).max(), np.abs(whole[name]).max(), 1e-3)
            lost = bent if name.startswith(("pose.rotation", "twist")) else 1.0
            bound = (1e-12 + 16 * EPS * turned) * lost * size
            self.see(name, float(np.abs(found[name] - wanted).max()), bound)


# --- blocks that are stepped ---------------------------------------------------------------------

BLOCKS = ("FMU 2.0", "FMU 3.0", "slave 2.0", "slave 3.0")
_KEPT = tempfile.TemporaryDirectory(prefix="stress-", ignore_cleanup_errors=True)


class Refused(Exception):
    """A call that a block answered with an error; its text is what the block logged."""


class Stepper:
    """A stepped block: an FMU or a slave in this process, FMI 2 or 3, by the same few calls."""

    def __init__(self, scene: Scene, version: str, slave: Any, messages: list[str]):
        from fmu_export import variable_table

        self.scene, self.version, self.slave, self.messages = scene, version, slave, messages
        self.table, self.time = variable_table(scene), 0.0
        names = [n for part in QUANTITIES.values() for n in part]
        self.rows = [[self.table[f"contact[{i + 1}].{n}"] for i in range(len(scene.contacts))]
                     for n in names]  # fmt: skip
        self.names = names

    def call(self, method: str, *arguments: Any) -> Any:
        """Call fmpy's method.

        Raises
        ------
        Refused
            The block answered with an error.
        """
        from fmpy.fmi1 import FMICallException

        del self.messages[:]
        try:
            return getattr(self.slave, method)(*arguments)
        except FMICallException:
            raise Refused(" | ".join(self.messages) or f"{method} failed without a line") from None

    def begin(self, stop: float | None = None) -> None:
        """Back to the start, whatever happened before."""
        self.call("reset")
        self.time = 0.0
        if self.version == "2.0":
            self.call("setupExperiment", None, 0.0, stop)
            self.call("enterInitializationMode")
        else:
            self.call("enterInitializationMode", None, 0.0, stop)
        self.call("exitInitializationMode")

    def step(self, size: float) -> None:
        """One step; time is what the importer adds up."""
        self.call("doStep", self.time, size)
        self.time += size

    def read(self) -> dict[str, Array]:
        """Name -> (1, n_contacts, n)."""
        rows = [row for rows in self.rows for row in rows]
        count = sum(row.size for row in rows)
        if self.version == "2.0":
            references = [r for row in rows for r in range(row.reference, row.reference + row.size)]
            values = np.array(self.call("getReal", references))
        else:
            values = np.array(self.call("getFloat64", [row.reference for row in rows], count))
        shape, begin, found = (1, len(self.scene.contacts), -1), 0, {}
        for name, own in zip(self.names, self.rows):
            end = begin + sum(row.size for row in own)
            found[name], begin = values[begin:end].reshape(shape), end
        return found

    def set(self, name: str, values: Sequence[float]) -> None:
        """Set all elements of a variable."""
        row = self.table[name]
        if self.version == "2.0":
            references = list(range(row.reference, row.reference + row.size))
            self.call("setReal", references, list(values))
        else:
            self.call("setFloat64", [row.reference], list(values))

    def saved(self) -> tuple[bytes, float]:
        """The state as bytes, and its time."""
        two = self.version == "2.0"
        state = self.call("getFMUstate" if two else "getFMUState")
        data = self.call("serializeFMUstate" if two else "serializeFMUState", state)
        self.call("freeFMUstate" if two else "freeFMUState", state)
        return bytes(data), self.time

    def restore(self, data: bytes, time: float) -> None:
        """Go back to bytes."""
        two = self.version == "2.0"
        method = "deSerializeFMUstate" if two else "deserializeFMUState"
        state = self.call(method, data)
        self.call("setFMUstate" if two else "setFMUState", state)
        self.call("freeFMUstate" if two else "freeFMUState", state)
        self.time = time


@functools.cache
def exported(name: str, version: str) -> Any:
    """The FMU of a scene, unpacked."""
    from fmu_hosts.native import Fmu

    from fmu_export import export_fmu

    folder = Path(tempfile.mkdtemp(dir=_KEPT.name))
    # fmpy's validation takes 85 % of an export, and is a matter of other tests.
    with mock.patch("fmu_export.export.validate_fmu", return_value=[]):
        path = export_fmu(scene_of(name), folder / f"{name}.fmu", version)
    return Fmu.unpacked(path, folder / "unpacked")


@functools.cache
def instance(name: str, block: str, exchange: bool = False) -> Stepper:
    """The one instance of a block in this process, made when it is first needed."""
    kind, version = block.split()
    scene, messages = scene_of(name), []  # type: tuple[Scene, list[str]]

    def log(status: int, category: str, text: str) -> None:
        messages.append(text)

    if kind == "slave":
        from fmu_export.slave import PlannerSlave2, PlannerSlave3

        made = (PlannerSlave2 if version == "2.0" else PlannerSlave3)(scene, name, log)
    else:
        interface = "ModelExchange" if exchange else "CoSimulation"
        made = exported(name, version).instance(log, interface, name)
    return Stepper(scene, version, made, messages)


REMEDY = re.compile(r"\b(give|ask|set|use|announce|choose|end|start|run|pass|move|shorten|lower)\b")


def told(error: Refused) -> Verdict:
    """The verdict of a refusal: its line names a value and a remedy; the instance is the scene."""
    text = str(error)
    missing = [name for name, pattern in (("value", re.compile(r"\d|nan|inf")), ("remedy", REMEDY))
               if not pattern.search(text)]  # fmt: skip
    if missing:
        return Verdict("crash", NAN, NAN, f"the log names no {' and no '.join(missing)}: {text}")
    return Verdict("refused", NAN, NAN, text)


# --- steps of all lengths ------------------------------------------------------------------------

LENGTHS = (1e-300, 1e-17, 1e-12, *(10.0**k for k in range(-9, 2)), 0.3, 3.0)
NEAR = (0.0, 1e-16, -1e-16, 1e-12, -1e-12, 1e-9, -1e-9)
FEW = 12


def _equal_steps(name: str, length: float, random: np.random.Generator) -> list[float]:
    """A step to anywhere, then some equal ones, then one to the end or beyond it."""
    scene, end = scene_of(name), horizon(name)
    steps = [length] * FEW if length >= 0.1 else [scene.duration * random.uniform(0, 0.8)]
    steps += [length] * FEW if length < 0.1 else []
    while sum(steps) > end:
        steps.pop()
    last = min(max(scene.duration, sum(steps) * 1.1 + 1e-3), 0.999 * end)
    return [*steps, last - sum(steps)] if last > sum(steps) else steps


def _random_steps(name: str, random: np.random.Generator) -> list[float]:
    steps = [*10 ** random.uniform(-9, 1, 3 * FEW)]
    random.shuffle(steps)
    end = 0.999 * horizon(name)
    return [h for k, h in enumerate(steps) if sum(steps[: k + 1]) < end] or [end]


def _edge_steps(name: str, off: float) -> list[float]:
    """From near an edge of a window to near the next."""
    times = [e + off * max(1.0, e) for e in scene_of(name).edges if e > 0]
    return np.diff([0.0, *times, times[-1] + 1e-3]).tolist()


def _stepping(name: str, block: str, steps: Sequence[float]) -> Verdict:
    stepper, judge = instance(name, block), Judge()
    stepper.begin()
    times, seen = [], []
    try:
        for h in steps:
            stepper.step(h)
            times.append(stepper.time)
            seen.append(stepper.read())
    except Refused as error:
        if stepper.time + h <= horizon(name) and h > 1e-15:
            return Verdict("crash", NAN, NAN, f"a step of {h:g} s was refused: {error}")
        return told(error)
    found = {k: np.concatenate([s[k] for s in seen]) for k in stepper.names}
    judge.motion(long_plan(name), np.minimum(np.array(times), horizon(name)), found)
    return judge.verdict


def _case_of_steps(index: int) -> Case:
    index, b = divmod(index, len(BLOCKS))
    index, s = divmod(index, len(STEPPED))
    name, block, random = STEPPED[s], BLOCKS[b], np.random.default_rng((7, index, s))
    if index < len(LENGTHS):
        what, steps = f"{LENGTHS[index]:g} s", _equal_steps(name, LENGTHS[index], random)
    elif index < len(LENGTHS) + len(NEAR):
        off = NEAR[index - len(LENGTHS)]
        what, steps = f"to windows' edges {off:+g}", _edge_steps(name, off)
    else:
        what, steps = f"random {index}", _random_steps(name, random)
    title = f"{block} of {name}, steps: {what}"
    return Case(title, "steps of FMU and slave", lambda: _stepping(name, block, steps))


def _case_beyond(index: int) -> Case:
    """Past the end of sigma, and past a stop time that was announced."""
    index, b = divmod(index, len(BLOCKS))
    name = STEPPED[index % len(STEPPED)]
    block = BLOCKS[b]

    def call() -> Verdict:
        stepper, random = instance(name, block), np.random.default_rng((8, index))
        scene, ends = scene_of(name), horizon(name)
        stop = None if ends < HORIZON else scene.duration
        stepper.begin(stop)
        end = ends if stop is None else stop
        try:
            stepper.step(end * random.uniform(0.1, 0.99))
            stepper.step(end * random.uniform(1.0, 3.0))
            stepper.read()
        except Refused as error:
            return told(error)
        return Verdict("silent", NAN, NAN, f"stepped to {stepper.time} s, where nothing is")

    return Case(f"{block} of {name}, beyond the end, {index}", "FMU and slave beyond the end", call)


# --- inputs --------------------------------------------------------------------------------------


def _pushes(name: str, random: np.random.Generator, most: float) -> list[Push]:
    """Inputs that are held for a while, one after the other."""
    scene, found = scene_of(name), []
    times = np.sort(random.uniform(0.05, 0.95, 4)) * scene.duration
    for start, stop in zip(times[:-1], times[1:]):
        kind = DISTURBANCE_KINDS[random.integers(3)]
        value = random.normal(size=2) * 10 ** random.uniform(-3, math.log10(most))
        contact = int(random.integers(len(scene.contacts)))
        found.append(Push(kind, contact, float(start), float(stop), tuple(value.tolist())))
    return found


class Push(NamedTuple):
    """An input of one contact that is held for a while."""

    kind: type[Disturbance]
    contact: int
    start: float
    stop: float
    value: tuple[float, float]

    def window(self) -> Disturbance:
        """The same as a window of a scene."""
        return self.kind(self.contact, self.start, self.stop, self.value)


INPUT_NAMES = dict(
    zip(DISTURBANCE_KINDS, ("finger.acceleration", "object.acceleration", "object.rate_offset"))
)


def _set_input(stepper: Stepper, push: Push, values: Sequence[float]) -> None:
    for axis, value in zip("uv", values):
        stepper.set(f"contact[{push.contact + 1}].{INPUT_NAMES[push.kind]}.{axis}", [value])


def _with_inputs(name: str, block: str, pushes: Sequence[Push]) -> Verdict:
    scene, stepper = scene_of(name), instance(name, block)
    try:
        plan = cs.plan(
            scene.replace(disturbances=[*scene.disturbances, *(p.window() for p in pushes)]), 1e-14,
            compiled=BUILT,
        )  # fmt: skip
        plan.states(scene.duration)
    except ContactSystemError as error:
        plan, why = None, str(error)
    stepper.begin()
    times, seen = [], []
    try:
        for push in pushes:
            if push.start > stepper.time:
                stepper.step(push.start - stepper.time)
            stepper.time = push.start  # what a difference of times adds up to is rounded
            _set_input(stepper, push, push.value)
            for part in (0.4, 0.8):  # not at the end, where the input still acts and is no window
                stepper.step((1 - part) * push.start + part * push.stop - stepper.time)
                times.append(stepper.time)
                seen.append(stepper.read())
            stepper.step(push.stop - stepper.time)
            stepper.time = push.stop
            _set_input(stepper, push, (0.0, 0.0))
        stepper.step(scene.duration - stepper.time)
        times.append(stepper.time)
        seen.append(stepper.read())
    except Refused as error:
        if plan is not None:
            return Verdict("crash", NAN, NAN, f"what plan() does is refused: {error}")
        return told(error)
    found = {k: np.concatenate([s[k] for s in seen]) for k in stepper.names}
    if plan is None:
        bad = not all(np.isfinite(v).all() for v in found.values())
        return Verdict("silent", NAN, NAN, "NaN handed out") if bad else refusal(why)
    judge = Judge()
    judge.motion(plan, np.minimum(times, scene.duration), found)
    return judge.verdict


def _case_of_inputs(index: int) -> Case:
    index, b = divmod(index, len(BLOCKS))
    index, s = divmod(index, len(STEPPED))
    name, block = STEPPED[s], BLOCKS[b]
    most = (1.0, 3.0, 30.0)[index % 3]
    pushes = _pushes(name, np.random.default_rng((9, index, s)), most)
    title = f"{block} of {name}, inputs up to {most:g}, {index}"
    return Case(title, "inputs of FMU and slave", lambda: _with_inputs(name, block, pushes))


WILD = (NAN, math.inf, -math.inf, 1e308, -1e308, 1e200, 1e30, 5e-324)


def _case_of_wild_values(index: int) -> Case:
    index, b = divmod(index, len(BLOCKS))
    index, s = divmod(index, len(STEPPED))
    index, w = divmod(index, len(WILD))
    name, block, value = STEPPED[s], BLOCKS[b], WILD[w]

    def call() -> Verdict:
        scene, stepper = scene_of(name), instance(name, block)
        kind, contact = DISTURBANCE_KINDS[index % 3], index % len(scene.contacts)
        push = Push(kind, contact, 0.1 * scene.duration, scene.duration, (0.0, value))
        stepper.begin()
        stepper.step(push.start)
        text = ""
        try:
            _set_input(stepper, push, push.value)
            stepper.step(0.3 * scene.duration)
            found = stepper.read()
        except Refused as error:
            text = str(error)
        else:
            if not all(np.isfinite(v).all() for v in found.values()):
                return Verdict("silent", NAN, NAN, "a value that is not finite was handed out")
            if not abs(value) < 1e-300:
                return Verdict("silent", NAN, NAN, f"{value:g} acts, and nobody says anything")
        after = _stepping(name, block, [0.5 * scene.duration, 0.5 * scene.duration])
        if after.outcome != "right":
            return Verdict(after.outcome, after.error, after.bound, f"afterwards: {after.message}")
        return told(Refused(text)) if text else after

    title = f"{block} of {name}, {value:g} as an input, {index}"
    return Case(title, "values from outside", call)


# --- state blobs ---------------------------------------------------------------------------------


def _spoiled(data: bytes, random: np.random.Generator) -> bytes:
    """Bytes that are not what they were."""
    found, k = bytearray(data), int(random.integers(6))
    at = int(random.integers(len(found)))
    if k == 0:
        found[at] ^= 1 << int(random.integers(8))
    elif k == 1:
        del found[at:]
    elif k == 2:
        found += bytes(random.integers(0, 256, 1 + at % 99, dtype=np.uint8))
    elif k == 3:
        found[at : at + 64] = bytes(random.integers(0, 256, 64, dtype=np.uint8))
    elif k == 4:
        found[at:] = bytes(len(found) - at)
    else:
        found = bytearray(random.integers(0, 256, len(found), dtype=np.uint8).tobytes())
    return bytes(found) if bytes(found) != data else data[:-1]


def _case_of_blobs(index: int) -> Case:
    index, b = divmod(index, len(BLOCKS))
    index, s = divmod(index, len(STEPPED))
    name, block = STEPPED[s], BLOCKS[b]

    def call() -> Verdict:
        stepper, random = instance(name, block), np.random.default_rng((10, index, s))
        scene, judge = scene_of(name), Judge()
        stepper.begin()
        stepper.step(scene.duration * random.uniform(0.05, 0.5))
        blob, time = stepper.saved()
        stepper.step(scene.duration * random.uniform(0.05, 0.3))
        try:
            stepper.restore(_spoiled(blob, random), time)
            return Verdict("silent", NAN, NAN, "spoiled bytes were taken for a state")
        except Refused as error:
            text = str(error)
        stepper.restore(blob, time)
        times = np.linspace(time, scene.duration, 4)[1:]
        seen = []
        for t in times:
            stepper.step(t - stepper.time)
            seen.append(stepper.read())
        found = {k: np.concatenate([x[k] for x in seen]) for k in stepper.names}
        judge.motion(long_plan(name), times, found)
        if judge.verdict.outcome != "right":
            return judge.verdict
        return Verdict("refused", NAN, NAN, text) if text else judge.verdict

    return Case(f"{block} of {name}, spoiled state, {index}", "states of FMU and slave", call)


# --- Model Exchange ------------------------------------------------------------------------------


def _wild_states(stepper: Stepper, random: np.random.Generator) -> Array:
    """The start, some of its numbers replaced: (11 n)."""
    from fmu_export.model import start_state

    x = np.concatenate([start_state(c) for c in stepper.scene.contacts])
    if random.integers(4):
        x += random.normal(size=len(x)) * 10 ** random.uniform(-3, 2)
    odd = (0.0, math.pi, math.pi / 2, 1e-15, 1e-300, 1e8, -1e16, 1e155, 1e300, NAN, math.inf)
    for _ in range(int(random.integers(4))):
        x[random.integers(len(x))] = odd[random.integers(len(odd))]
    return x


def _derivatives(stepper: Stepper, t: float, x: Array) -> Array:
    """Of Model Exchange at a time and a state; Refused where the FMU refuses either."""
    from ctypes import c_double

    n = len(x)
    given, rate = (c_double * n)(*x), (c_double * n)()
    stepper.call("setTime", t)
    if stepper.version == "2.0":
        stepper.call("setContinuousStates", given, n)
        stepper.call("getDerivatives", rate, n)
    else:
        stepper.call("setContinuousStates", given, n)
        stepper.call("getContinuousStateDerivatives", rate, n)
    return np.array(rate)


def _laws_of_frames(judge: Judge, scene: Scene, t: float, x: Array, rate: Array) -> None:
    """|M q'| = sigma |path velocity|, psi' = -theta1' - theta2', W1' = 0 while nothing acts."""
    sigma = float(scene.profile(t))
    # No event has been handled since t = 0, so what acts is what acted then.
    acts = {int(d.contact) for d in scene.disturbances if d.start <= 0 < d.stop}
    for i, contact in enumerate(scene.contacts):
        own, change = x[11 * i : 11 * i + 11], rate[11 * i : 11 * i + 11]
        spin = abs(change[2]) + abs(change[7])
        judge.see("psi'", abs(change[10] + change[2] + change[7]), 1e-13 * spin + 1e-290)
        if i in acts:
            continue
        fast = sigma * float(np.hypot(*own[3:5]))
        judge.see("W1'", float(np.hypot(*change[3:5])), 1e-13 * fast + 1e-290)
        for k, surface in ((0, contact.finger), (5, scene.object)):
            lame = surface.lame(own[k], own[k + 1])
            moved = float(np.hypot(*(lame * change[k : k + 2])))
            wanted = sigma * float(np.hypot(*own[k + 3 : k + 5]))
            # sines of large angles are known to their rounding
            loss = EPS * (1 + np.abs(own[k : k + 2]).max()) * surface.size / np.abs(lame).min()
            # a path at rest is taken to move at 1e-300 m/s
            bound = ((1e-12 + 16 * loss) * sigma + 1e-290) * np.abs(own[[3, 4, 8, 9]]).max()
            judge.see("|M q'|", abs(moved - wanted), bound + 1e-290)


def _case_of_exchange(index: int) -> Case:
    index, v = divmod(index, 2)
    index, s = divmod(index, len(STEPPED))
    name, block = STEPPED[s], ("FMU 2.0", "FMU 3.0")[v]

    def call() -> Verdict:
        stepper, random = instance(name, block, exchange=True), np.random.default_rng((11, index))
        stepper.begin()
        stepper.call("enterContinuousTimeMode")
        x = _wild_states(stepper, random)
        t = float(random.choice([0.0, 0.37, 1.0, 3.0])) * stepper.scene.duration
        try:
            rate = _derivatives(stepper, t, x)
        except Refused as error:
            return told(error)
        if not np.isfinite(rate).all():
            return Verdict("silent", NAN, NAN, "derivatives that are not finite, and status OK")
        judge = Judge()
        with np.errstate(all="ignore"):
            _laws_of_frames(judge, stepper.scene, t, x, rate)
        with contextlib.suppress(Refused):
            if not all(np.isfinite(part).all() for part in stepper.read().values()):
                return Verdict("silent", NAN, NAN, "outputs that are not finite, and status OK")
        return judge.verdict

    return Case(f"{block} of {name}, Model Exchange, wild state {index}", "Model Exchange", call)


# --- Drake ---------------------------------------------------------------------------------------

ORDERS = {
    "bogacki_shampine3": 3, "explicit_euler": 1, "implicit_euler": 1, "radau1": 1, "radau3": 3,
    "runge_kutta2": 2, "runge_kutta3": 3, "runge_kutta5": 5, "semi_explicit_euler": 1,
    "velocity_implicit_euler": 1,
}  # fmt: skip
IMPLICIT = ("implicit_euler", "radau1", "radau3", "velocity_implicit_euler")
ESTIMATING = ("bogacki_shampine3", "runge_kutta3", "runge_kutta5")
"""Explicit schemes that estimate their error; to the others Drake gives steps of equal length."""
STEP_LENGTHS = (1e-3, 1e-2, 3e-2, 0.1)
ACCURACIES = (1e-2, 1e-4, 1e-6)
SIMULATED = 0.4
"""s that is simulated."""


def _early(name: str) -> Scene:
    """K4 with its window soon after the start; the others have theirs there."""
    import dataclasses

    scene = cs.load_scene(name)
    if name == "K4":
        windows = [dataclasses.replace(d, start=0.1, stop=0.2) for d in scene.disturbances]
        scene = scene.replace(disturbances=windows)
    return scene.replace(duration=SIMULATED)


DRIVEN: dict[str, Callable[[], Scene]] = {
    name: functools.partial(_early, name) for name in ("K1", "K2", "K3", "K4")
}
DRIVEN |= {
    f"{name} with eta {eta:g}": functools.partial(
        lambda name, eta: _early(name).replace(gain=cs.Gain.time(eta)), name, eta
    )
    for name in ("K1", "K4")
    for eta in (1e3, 1e9)
}


class Driven(NamedTuple):
    """A planner for Drake and the truth at the end."""

    planner: Any
    points: Array
    slip: Array
    path: float
    rate: float
    gain: float
    first: float


@functools.cache
def _driven(name: str, coordinates: str) -> Driven:
    """Truth, length of the path, the greatest rate of the motion and lam [1/s], slip at first."""
    from drake_plant import ContactPlanner

    scene = DRIVEN[name]()
    plan, t = cs.plan(scene, 1e-13), np.linspace(0.0, SIMULATED, 401)
    states, sigma = plan.states(t), scene.profile(t)
    path = float(scene.profile.arc_length(SIMULATED))
    rates = [np.abs(states[..., (2, 3, 6, 7)]).max(), sigma.max() / path]  # sigma is integrated
    if coordinates == "chart":
        rates.append((np.abs(scene.profile.rate(t)) / sigma).max())
    end = np.array(SIMULATED)
    return Driven(
        ContactPlanner(scene, coordinates), plan.points(end)[0],
        np.linalg.norm(plan.slip(end)[0], axis=-1), path, float(max(rates)),
        float(scene.gain.rate(scene.profile, t).max()),
        float(np.linalg.norm(plan.slip(0.0)[0], axis=-1).max()),
    )  # fmt: skip


def _order_bound(case: Driven, scheme: str, h: float) -> float:
    """Part of the path by which a scheme may be wrong.

    The order's own (h rate)^p, in which lam takes the place of the rate from the third order on
    (order reduction); x / (1 - x) of implicit schemes of first order while sigma grows; Newton's
    iterations of implicit schemes end within 1e-4; slip that decays within one step is still
    moved by for that step. Never more than the path itself: what is lost altogether is no order.
    """
    order, slow = ORDERS[scheme], h * case.rate
    if scheme in IMPLICIT and order == 1:
        slow = slow / (1 - slow) if slow < 1 else math.inf
    slow *= 1.25 if order == 1 else 1.0  # what the second order adds
    own = slow ** min(order, 2) * max(slow, min(3.0, h * case.gain)) ** max(0, order - 2)
    newton = 1e-4 if scheme in IMPLICIT else 0.0
    return min(1.0, own + newton + h * case.first / case.path) + 1e-12


def _simulated(case: Driven, scheme: str, step: float, accuracy: float | None) -> Any:
    from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig

    simulator = Simulator(case.planner)
    config = SimulatorConfig(
        integration_scheme=scheme, max_step_size=step, use_error_control=accuracy is not None,
        accuracy=accuracy or 1e-3,
    )  # fmt: skip
    ApplySimulatorConfig(config, simulator)
    simulator.AdvanceTo(SIMULATED)
    return simulator.get_context()


def _drive(
    name: str, coordinates: str, scheme: str, step: float, accuracy: float | None
) -> Verdict:
    case = _driven(name, coordinates)
    context = _simulated(case, scheme, step, accuracy)
    points = case.planner.GetOutputPort("contact_point").Eval(context).reshape(-1, 2, 3)
    slip = np.linalg.norm(case.planner.GetOutputPort("slip").Eval(context).reshape(-1, 2), axis=-1)
    scene = case.planner.system.scene
    most = float(scene.profile(np.linspace(0, SIMULATED, 41)).max())
    part = _order_bound(case, scheme, step)
    bounds = 2 * part * case.path, 2 * part * most
    if accuracy:  # of angles and rates, in each of accuracy^(-1 / (p + 1)) steps
        own = accuracy ** (1 - 1 / (ORDERS[scheme] + 1))
        bounds = 20 * own * scene.object.size, 20 * own * scene.object.size
    judge = Judge()
    judge.see("points", float(np.linalg.norm(points - case.points, axis=-1).max()), bounds[0])
    judge.see("slip", float(np.abs(slip - case.slip).max()), bounds[1])
    return judge.verdict


def _runs() -> list[tuple[str, str, str, float, float | None]]:
    """Scene, coordinates, scheme, step and accuracy of every run, the longest steps first.

    Left out are schemes that do not estimate their error, under error control; and what takes steps
    of 1 / lam by its nature, up to 4e8 of them: explicit schemes under error control where a gain
    of 1e6 or more is integrated.
    """
    lengths: list[tuple[float, float | None]] = [(0.1, a) for a in ACCURACIES]
    lengths += [(h, None) for h in sorted(STEP_LENGTHS, reverse=True)]
    return [
        (name, coordinates, scheme, step, accuracy)
        for step, accuracy in lengths
        for scheme in ORDERS
        for name in DRIVEN
        for coordinates in COORDINATES
        if not accuracy
        or scheme in IMPLICIT
        or (scheme in ESTIMATING and not name.endswith("e+09"))
    ]


def _case_of_drake(index: int) -> Case:
    name, coordinates, scheme, step, accuracy = run = _runs()[index]
    what = f"error control at {accuracy:g}" if accuracy else f"steps of {step:g} s"
    return Case(f"{name}, {coordinates}: {scheme}, {what}", "Drake", lambda: _drive(*run))


# --- all -----------------------------------------------------------------------------------------


def _families() -> Iterable[Family]:
    if importlib.util.find_spec("fmpy"):
        per = len(BLOCKS) * len(STEPPED)
        grid = per * (len(LENGTHS) + len(NEAR))
        yield Family("steps of FMU and slave", grid + 3 * per, _case_of_steps, endless=True)
        yield Family("FMU and slave beyond the end", 2 * per, _case_beyond)
        yield Family("inputs of FMU and slave", 6 * per, _case_of_inputs, endless=True)
        yield Family("values from outside", 3 * per * len(WILD), _case_of_wild_values)
        yield Family("states of FMU and slave", 10 * per, _case_of_blobs, endless=True)
        yield Family("Model Exchange", 2 * len(STEPPED) * 120, _case_of_exchange, endless=True)
    if importlib.util.find_spec("pydrake"):
        yield Family("Drake", len(_runs()), _case_of_drake)


FAMILIES = tuple(_families())
