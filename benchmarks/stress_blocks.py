"""Stress cases of what steps a plan: FMUs, and slaves in this process.

Stepped blocks are judged against `plan` of the same scene (which `stress_laws` judges by exact
laws), with the inputs that they were given as windows; derivatives of Model Exchange by the laws
of moving frames (theory section 4). Only what is free of charts is compared: slip by its length
or in E2, twist, pose, contact points.

Bounds of stepped blocks: 1e-12 of the greatest value of the quantity, and 16 eps for every radian
that the contact turns about the smallest body, or would at its last speed from the start: arc
length and time carry that many digits less. Normals, so rotation and twist, lose the curvature,
counted in sizes of the body (`_bend`).
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException as Refused
from fmu_hosts import EVERYTHING
from fmu_hosts.blocks import Instance
from numpy.polynomial import polynomial

import contact_system as cs

from .blocks import VERSIONS, finite, joined, outputs, planned
from .stress_cases import grid
from .stress_scenes import DISTURBANCES, EPS, Array, Draw
from .verdicts import NAN, VALUE, Meter, Verdict, refusal

# A path that starts at rest, a gain of 1e9, every kind of disturbance, one inside another.
HARD = cs.Scene(
    name="hard",
    object=cs.Torus(0.2, 0.08),
    contacts=[
        cs.Contact(cs.Sphere(0.01), (0.3, 0.4), (1.2, 0.1), object_velocity="rest"),
        cs.Contact(cs.Cylinder(0.03), (2.0, -1.0), (0.2, 0.05), object_velocity=(0.3, -0.4)),
    ],
    disturbances=[
        cs.FingerAcceleration(0, 0.2, 0.6, (2.0, -1.0)),
        cs.ObjectAcceleration(0, 0.3, 0.4, (1.0, 1.0)),
        cs.ObjectRateOffset(1, 0.0, 0.35, (0.5, -0.2)),
    ],
    profile=cs.Profile([0.0, 0.2, 0.5]),
    gain=cs.Gain.path(1e9),
    duration=1.0,
)
OWN = {"hard": HARD, "everything": EVERYTHING}
STEPPED = ("K2", "K4", "D1", "bowl", "hard", "everything")
HORIZON = 12.0
"""s; how far beyond their end scenes are stepped, where sigma lets them."""


@functools.cache
def scene_of(name: str) -> cs.Scene:
    """A bundled scene, or one of `OWN`."""
    return OWN.get(name) or cs.load_scene(name)


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
    return cs.plan(scene_of(name).replace(duration=horizon(name)), 1e-14)


def _bend(scene: cs.Scene) -> float:
    """The greatest curvature where contacts start, in 1 / sizes of their bodies, or 1."""
    bodies = [(scene.object, c.object_at) for c in scene.contacts]
    bodies += [(c.finger, c.finger_at) for c in scene.contacts]
    return max(1.0, *(b.size * float(np.abs(b.curvature_form(*at)).max()) for b, at in bodies))


BLOCKS = ("FMU 2.0", "FMU 3.0", "slave 2.0", "slave 3.0")


@functools.cache
def instance(name: str, kind: str, version: str, interface: str) -> Instance:
    """The one instance of a block in this process, made when it is first needed."""
    return Instance(scene_of(name), kind, version, interface)


def begun(name: str, block: str, stop: float | None = None) -> Instance:
    """A block at its start, whatever happened before."""
    kind, version, *interface = block.split()
    found = instance(name, kind, version, *interface or ["CoSimulation"])
    found.own.reset()
    found.said.clear()
    return found.begin(stop=stop)


def told(block: Instance) -> Verdict:
    """The verdict of a refusal: its line names a value and a remedy; the instance is the scene."""
    lines = [text for *_, text in block.said[-1:]] or ["refused without a line"]
    block.said.clear()
    return refusal(lines[0], place=VALUE)


def silent(text: str) -> Verdict:
    """What ought to have been refused."""
    return Verdict("silent", NAN, NAN, text)


LENGTHS = (1e-300, 1e-17, 1e-12, *(10.0**k for k in range(-9, 2)), 0.3, 3.0)
NEAR = (0.0, 1e-16, -1e-16, 1e-12, -1e-12, 1e-9, -1e-9)
FEW = 12


class Walk:
    """A block's steps from its start, and what it says after some of them."""

    def __init__(self, name: str, block: str):
        self.block, self.times, self.seen = begun(name, block), [], []

    def to(self, t: float, look: bool = True) -> None:
        """One step to a time."""
        self.block.step(t - self.block.time)
        if look:
            self.look()

    def look(self) -> None:
        """Note what the block says now."""
        self.times.append(self.block.time)
        self.seen.append(outputs(self.block))

    def verdict(self, plan: cs.Plan) -> Verdict:
        """Against a plan, at the latest at its end.

        Blocks take times within 8 eps of a window's edge for the edge.
        """
        scene, meter, found = plan.scene, Meter(), joined(self.seen)
        t = np.minimum(self.times, scene.duration)
        for edge in scene.window_edges:
            t = np.where(np.abs(t - edge) <= 8 * EPS * max(1.0, edge), edge, t)
        least = min(s.size for s in (scene.object, *(c.finger for c in scene.contacts)))
        last = t.max()  # which is known to its rounding only
        turned = float(scene.profile.arc_length(last) + last * scene.profile(last)) / least
        bent = _bend(scene)
        whole = planned(plan, np.linspace(plan.start, scene.duration, 33)[:-1])
        for name, wanted in planned(plan, t).items():
            size = max(np.abs(wanted).max(), np.abs(whole[name]).max(), 1e-3)
            lost = bent if name.startswith(("pose.rotation", "twist")) else 1.0
            bound = (1e-12 + 16 * EPS * turned) * lost * size
            meter.see(name, found[name] - wanted, bound)
        return meter.verdict()


def _stepping(name: str, block: str, lengths: Sequence[float]) -> Verdict:
    walk = Walk(name, block)
    try:
        for h in lengths:
            walk.block.step(h)
            walk.look()
    except Refused:
        verdict = told(walk.block)
        if walk.block.time + h <= horizon(name) and h > 1e-15:
            return Verdict("crash", NAN, NAN, f"a step of {h:g} s was refused: {verdict.message}")
        return verdict
    return walk.verdict(long_plan(name))


def steps(draw: Draw, how: tuple[str, float], name: str, block: str) -> Verdict:
    """Equal steps of one length, steps to near windows' edges, or random ones."""
    scene, random, end = scene_of(name), draw.random, horizon(name)
    kind, x = how
    if kind == "equal":  # a step to anywhere, equal ones, one to the end or beyond it
        lengths = [] if x >= 0.1 else [scene.duration * random.uniform(0, 0.8)]
        lengths += [x] * FEW
        while sum(lengths) > end:
            lengths.pop()
        last = min(max(scene.duration, sum(lengths) * 1.1 + 1e-3), 0.999 * end)
        lengths += [last - sum(lengths)] if last > sum(lengths) else []
    elif kind == "near":  # from near an edge of a window to near the next
        times = [e + x * max(1.0, e) for e in scene.edges if e > 0]
        lengths = np.diff([0.0, *times, times[-1] + 1e-3]).tolist()
    else:
        sizes = 10 ** random.uniform(-9, 1, 3 * FEW)
        lengths = sizes[np.cumsum(sizes) < 0.999 * end].tolist() or [0.999 * end]
    return _stepping(name, block, lengths)


def beyond(draw: Draw, name: str, block: str) -> Verdict:
    """Past the end of sigma, or past a stop time that was announced."""
    stop = None if horizon(name) < HORIZON else scene_of(name).duration
    own, end = begun(name, block, stop), horizon(name) if stop is None else stop
    try:
        own.step(end * draw.real(0.1, 0.99), end * draw.real(1.0, 3.0))
        outputs(own)
    except Refused:
        return told(own)
    return silent(f"stepped to {own.time} s, where nothing is")


def _pushes(name: str, random: np.random.Generator, most: float) -> list[Any]:
    """Inputs that are held for a while, one after the other, as windows."""
    scene, found = scene_of(name), []
    times = np.sort(random.uniform(0.05, 0.95, 4)) * scene.duration
    for start, stop in zip(times[:-1], times[1:]):
        kind = DISTURBANCES[random.integers(3)]
        value = random.normal(size=2) * 10 ** random.uniform(-3, math.log10(most))
        contact = int(random.integers(len(scene.contacts)))
        found.append(kind(contact, float(start), float(stop), tuple(value.tolist())))
    return found


INPUTS = ("finger.acceleration", "object.acceleration", "object.rate_offset")


def _set_input(own: Instance, kind: int, contact: int, values: Sequence[float]) -> None:
    name = f"contact[{contact + 1}].{INPUTS[kind]}."
    own.put({name + axis: value for axis, value in zip("uv", values)})


def with_inputs(draw: Draw, most: float, name: str, block: str) -> Verdict:
    """Against the plan of a scene that has the inputs as windows."""
    scene, walk = scene_of(name), Walk(name, block)
    pushes = _pushes(name, draw.random, most)
    try:
        plan = cs.plan(scene.replace(disturbances=[*scene.disturbances, *pushes]), 1e-14)
        plan.states(scene.duration)
    except cs.ContactSystemError as error:
        plan, why = None, str(error)
    own = walk.block
    try:
        for push in pushes:
            kind = DISTURBANCES.index(type(push))
            if push.start > own.time:
                walk.to(push.start, look=False)
            own.time = push.start  # what a difference of times adds up to is rounded
            _set_input(own, kind, push.contact, push.value)
            for part in (0.4, 0.8):  # not at the end, where the input still acts and is no window
                walk.to((1 - part) * push.start + part * push.stop)
            walk.to(push.stop, look=False)
            own.time = push.stop
            _set_input(own, kind, push.contact, (0.0, 0.0))
        walk.to(scene.duration)
    except Refused:
        verdict = told(own)
        if plan is not None:
            text = f"what plan() does is refused: {verdict.message}"
            return Verdict("crash", NAN, NAN, text)
        return verdict
    if plan is None:
        return refusal(why) if finite(joined(walk.seen)) else silent("NaN handed out")
    return walk.verdict(plan)


WILD = (NAN, math.inf, -math.inf, 1e308, -1e308, 1e200, 1e30, 5e-324)


def wild_values(draw: Draw, kind: int, value: float, name: str, block: str) -> Verdict:
    """Values as inputs that nobody can follow; afterwards the block goes on as ever."""
    scene, own, refused = scene_of(name), begun(name, block), None
    own.step(0.1 * scene.duration)
    try:
        _set_input(own, kind, kind % len(scene.contacts), (0.0, value))
        own.step(0.3 * scene.duration)
        if not finite(outputs(own)):
            return silent(f"a value that is not finite was handed out after {value:g}")
        if not abs(value) < 1e-300:
            return silent(f"{value:g} acts, and nobody says anything")
    except Refused:
        refused = told(own)
    after = _stepping(name, block, [0.5 * scene.duration, 0.5 * scene.duration])
    return refused if refused and after.outcome == "right" else after


def _spoiled(data: bytes, random: np.random.Generator) -> bytes:
    """Bytes that are not what they were: one bit, a part, or all of them; cut; longer."""
    at, size = int(random.integers(len(data))), len(data)
    ways = (
        data[:at] + bytes([data[at] ^ 1 << int(random.integers(8))]) + data[at + 1 :],
        data[:at],
        data + random.bytes(1 + at % 99),
        (data[:at] + random.bytes(64) + data[at + 64 :])[:size],
        data[:at] + bytes(size - at),
        random.bytes(size),
    )
    found = ways[random.integers(len(ways))]
    return found if found != data else data[:-1]


def blobs(draw: Draw, name: str, block: str) -> Verdict:
    """Spoiled bytes are refused, and the true ones go on from where they were saved."""
    random, end, walk = draw.random, scene_of(name).duration, Walk(name, block)
    own = walk.block
    own.step(end * random.uniform(0.05, 0.5))
    blob, time = own.written(), own.time
    own.step(end * random.uniform(0.05, 0.3))
    try:
        own.read(_spoiled(blob, random))
        return silent("spoiled bytes were taken for a state")
    except Refused:
        refused = Verdict("refused", NAN, NAN, told(own).message)
    own.restore(own.read(blob), time)
    for t in np.linspace(time, end, 4)[1:]:
        walk.to(t)
    after = walk.verdict(long_plan(name))
    return refused if after.outcome == "right" else after


DERIVATIVES = {"2.0": "getDerivatives", "3.0": "getContinuousStateDerivatives"}


def _continuous(own: Instance, method: str, array: Array) -> Array:
    """Get or set an array of continuous states or derivatives."""
    values = (ctypes.c_double * len(array))(*array)
    getattr(own.own, method)(values, len(array))
    return np.array(values)


def _wild_states(own: Instance, random: np.random.Generator) -> Array:
    """The start, some of its numbers replaced: (11 n)."""
    x = _continuous(own, "getContinuousStates", np.zeros(11 * len(own.scene.contacts)))
    if random.integers(4):
        x += random.normal(size=len(x)) * 10 ** random.uniform(-3, 2)
    odd = (0.0, math.pi, math.pi / 2, 1e-15, 1e-300, 1e8, -1e16, 1e155, 1e300, NAN, math.inf)
    for _ in range(int(random.integers(4))):
        x[random.integers(len(x))] = odd[random.integers(len(odd))]
    return x


def _laws_of_frames(meter: Meter, scene: cs.Scene, t: float, x: Array, rate: Array) -> None:
    """|M q'| = sigma |path velocity|, psi' = -theta1' - theta2', W1' = 0 while nothing acts."""
    sigma = float(scene.profile(t))
    # No event has been handled since t = 0, so what acts is what acted then.
    acts = {int(d.contact) for d in scene.disturbances if d.start <= 0 < d.stop}
    for i, contact in enumerate(scene.contacts):
        own, change = x[11 * i : 11 * i + 11], rate[11 * i : 11 * i + 11]
        spin = abs(change[2]) + abs(change[7])
        meter.see("psi'", abs(change[10] + change[2] + change[7]), 1e-13 * spin + 1e-290)
        if i in acts:
            continue
        fast = sigma * float(np.hypot(*own[3:5]))
        meter.see("W1'", float(np.hypot(*change[3:5])), 1e-13 * fast + 1e-290)
        for k, surface in ((0, contact.finger), (5, scene.object)):
            lame = surface.lame(own[k], own[k + 1])
            moved = float(np.hypot(*(lame * change[k : k + 2])))
            wanted = sigma * float(np.hypot(*own[k + 3 : k + 5]))
            # sines of large angles are known to their rounding
            loss = EPS * (1 + np.abs(own[k : k + 2]).max()) * surface.size / np.abs(lame).min()
            # a path at rest is taken to move at 1e-300 m/s
            bound = ((1e-12 + 16 * loss) * sigma + 1e-290) * np.abs(own[[3, 4, 8, 9]]).max()
            meter.see("|M q'|", abs(moved - wanted), bound + 1e-290)


def exchange(draw: Draw, name: str, block: str) -> Verdict:
    """Derivatives at a wild state, by the laws of moving frames."""
    own, random = begun(name, block), draw.random
    own.own.enterContinuousTimeMode()
    x, meter = _wild_states(own, random), Meter()
    t = float(random.choice([0.0, 0.37, 1.0, 3.0])) * own.scene.duration
    try:
        own.own.setTime(t)
        _continuous(own, "setContinuousStates", x)
        rate = _continuous(own, DERIVATIVES[own.version], np.zeros(len(x)))
    except Refused:
        return told(own)
    if not np.isfinite(rate).all():
        return silent("derivatives that are not finite, and status OK")
    with np.errstate(all="ignore"):
        _laws_of_frames(meter, own.scene, t, x, rate)
    with contextlib.suppress(Refused):
        if not finite(outputs(own)):
            return silent("outputs that are not finite, and status OK")
    return meter.verdict()


EACH = {"name": STEPPED, "block": BLOCKS}
HOW = [*(("equal", x) for x in LENGTHS), *(("near", x) for x in NEAR), *[("random", None)] * 3]
OUT = {"kind": range(3), "value": WILD}
FRAMES = {"name": STEPPED, "block": [f"FMU {version} ModelExchange" for version in VERSIONS]}
FAMILIES = [
    grid("steps of FMU and slave", 1, steps, how=HOW, **EACH),
    grid("FMU and slave beyond the end", 2, beyond, **EACH),
    grid("inputs of FMU and slave", 2, with_inputs, most=(1.0, 3.0, 30.0), **EACH),
    grid("values from outside", 1, wild_values, **OUT, **EACH),
    grid("states of FMU and slave", 10, blobs, **EACH),
    grid("Model Exchange", 120, exchange, **FRAMES),
]
