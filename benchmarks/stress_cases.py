"""Stress cases of the planner: families of scenes, gain laws alone, and wrong input."""

from __future__ import annotations

import dataclasses
import itertools
import math
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.polynomial import polynomial as poly

import contact_system as cs

from .stress_laws import Judge, left_over, run
from .stress_scenes import (
    DISTURBANCES,
    EPS,
    ETAS,
    LAWS,
    MADE,
    OF_USERS,
    PROFILES,
    SHAPES,
    Body,
    Draw,
    Trial,
    draw_trial,
    round_body,
    stretched,
)
from .verdicts import Case, Family, Meter, Verdict, refusal


def on_trials(judge: Callable[[Trial], Verdict]) -> Callable[..., Verdict]:
    """The judge of a trial as one of choices."""
    return lambda draw, **fixed: judge(draw_trial(draw, **fixed))


judged_plan = on_trials(run)


def grid(
    name: str,
    /,
    repeats: int,
    judge: Callable[..., Verdict] = judged_plan,
    cases: Sequence[dict[str, Any]] = ({},),
    always: dict[str, Any] | None = None,
    **axes: Sequence[Any],
) -> Family:
    """All combinations of choices, each repeated with all else drawn anew.

    The judge takes a source of choices, and those that are made. ``cases`` are the first axis,
    several choices of `draw_trial` at once; ``always`` is chosen in all; ``axes`` are further axes,
    values by the name of the choice.
    """
    lengths = [len(cases), *map(len, axes.values())]
    key = zlib.crc32(name.encode())

    def make(index: int) -> Case:
        first, *others = np.unravel_index(index % math.prod(lengths), lengths)
        drawn = {choice: axes[choice][i] for choice, i in zip(axes, others)}
        fixed, draw = cases[first] | drawn | (always or {}), Draw(key, index)
        return Case(f"{name} {index}: {fixed}", lambda: judge(draw, **fixed))

    return Family(name, repeats * math.prod(lengths), make, endless=True)


BUILT_IN, USERS = ([f.__name__ for f in made] for made in (MADE, OF_USERS))
MISSES = (0.0, *(10.0**-k for k in range(15, -1, -1)))
HARD = ("oblate", "prolate", "equal axes", "plain", "needle", "pancake", "nearly a sphere")
POLES = [
    {"kind": "sphere"},
    *({"kind": "ellipsoid", "shape": shape} for shape in HARD),
    {"kind": "implicit_ellipsoid"},
]
"""What has poles or umbilics."""


def _poles() -> list[dict[str, Any]]:
    """Every kind of pole, passed by object and finger at every distance."""
    cases = []
    always = {"profile": "constant", "windows": 0, "turns": 4.0}
    for what, side, miss in itertools.product(POLES, ("object", "finger"), MISSES):
        other = {"object": "finger", "finger": "object"}[side]
        shape = {"shape": what["shape"]} if "shape" in what else {}
        cases.append({side: what["kind"], other: "sphere", "pole": (side, miss)} | always | shape)
    return cases


def _bowls() -> list[dict[str, Any]]:
    """Fingers of a bowl's own form, less a part of their radius."""
    return [
        {"object": kind, "finger": kind, "ratio": 1.0 - less}
        for kind in ("sphere", "cylinder", "torus", "ellipsoid", "plane")
        for less in (0.0, *(10.0**-k for k in range(16, 0, -1)), 0.5)
    ]


def bowl(trial: Trial) -> Verdict:
    """The plan judged as ever; then its states found back from pose and twist, or refused."""
    plan = cs.plan(trial.scene, trial.tolerance)
    judge = Judge(trial, plan)
    if (verdict := judge.verdict()).outcome != "right":
        return verdict
    sample, _ = judge.sample(np.array([0.4, 0.7]) * trial.scene.duration)
    bends = [
        body.surface.curvature_form(*sample.states[:, 4 * k : 4 * k + 2].T)
        for k, body in enumerate(judge.bodies)
    ]
    relative = bends[0] + sample.turn @ bends[1] @ sample.turn
    least, terms = np.linalg.svd(relative, compute_uv=False).min(), abs(np.array(bends)).max()
    condition = 2 * terms / least if least > 0 else math.inf
    found = []
    for given in zip(plan.pose(sample.t)[:, 0], plan.twist(sample.t)[:, 0], sample.x[1]):
        try:
            found.append(cs.measured_states(trial.scene, *(part[None] for part in given))[0])
        except cs.ContactSystemError as error:
            well = Verdict("silent", condition, 1e6, f"well posed, but: {error}")
            return well if condition < 1e6 else refusal(str(error))
    again = judge.seen(sample.t, np.array(found))
    lost = 8 * condition * (judge.loss(sample, 0) + judge.loss(sample, 1))
    for k, body in enumerate(judge.bodies):
        size = body.size + np.linalg.norm(sample.x[k], axis=1)
        away = np.linalg.norm(again.x[k] - sample.x[k], axis=1)
        judge.meter.see(f"point {k + 1} from the pose", away, lost * size)
        speed = np.linalg.norm(sample.rate[k], axis=1) + 1e-3 * judge.terms
        away = np.linalg.norm(again.rate[k] - sample.rate[k], axis=1)
        judge.meter.see(f"rate {k + 1} from the twist", away, 8 * lost * speed)
    return judge.meter.verdict()


class OneOf:
    """What a plan says of one of its contacts, as a plan of that contact alone would."""

    def __init__(self, plan: cs.Plan, index: int):
        self.tolerance, self._plan, self._own = plan.tolerance, plan, slice(index, index + 1)

    def __getattr__(self, name: str) -> Callable[[Any], np.ndarray]:
        return lambda t: getattr(self._plan, name)(t)[:, self._own]


def among_others(trial: Trial) -> Verdict:
    """A contact among others, some of which are disturbed as it is, judged as if it were alone."""
    random, scene = np.random.default_rng(trial.seed), trial.scene
    count, (own,) = int(random.integers(2, 6)), scene.contacts
    index, duration = int(random.integers(count)), scene.duration
    contacts, windows = [], []
    for i in range(count):
        contacts.append(own)
        for window in scene.disturbances:
            if i == index or random.random() < 0.5:
                windows.append(dataclasses.replace(window, contact=i))
        if i != index:
            contacts[i] = dataclasses.replace(own, angle=own.angle + random.uniform(-2, 2))
            if random.random() < 0.5:
                pace = scene.profile.arc_length(duration) / duration**2 / trial.finger.size
                push = tuple(pace * random.uniform(-1, 1, 2))
                start, stop = duration * random.uniform(0, 0.4), duration * 0.5
                windows.append(cs.FingerAcceleration(i, start, stop, push))
    crowd = scene.replace(contacts=contacts, disturbances=windows)
    plan = cs.plan(crowd, trial.tolerance)
    return Judge(trial, OneOf(plan, index)).verdict()


def gain_law(draw: Draw, **fixed: Any) -> Verdict:
    """The integral of lam, and what `Scene.contraction` says is left of slip, against the law."""
    duration = 10 ** draw.real(-3, 3)
    profile = stretched(PROFILES[fixed["profile"]], 10 ** draw.real(-4, 4), duration)
    gain, meter = cs.Gain(fixed["law"], fixed["eta"]), Meter()
    sigma = np.array(profile.coefficients)
    terms = float(poly.polyval(duration, abs(sigma)))
    t = duration * np.array([0.0, draw.real(0, 1), draw.real(0, 1), 1.0])
    left = np.maximum(profile(t), 0.0) * np.exp(-gain.exponent(profile, t))
    # lam t has the rounding of t; exp(-x) x is at most 0.37
    meter.see("what lam leaves", left - left_over(sigma, gain, t), 256 * EPS * terms)
    contact = cs.Contact(finger=cs.Sphere(0.04), object_at=(1.0, 0.5))
    given = {"profile": profile, "gain": gain, "duration": duration}
    said = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], **given).contraction().left
    if not math.isnan(said):
        law = left_over(sigma, gain, t[-1:]) / sigma[0]
        meter.see("what contraction says is left", said - law, 256 * EPS * terms / sigma[0])
    return meter.verdict()


BAD = [math.nan, math.inf, -math.inf, -1.0, 0.0, 1e300, 5e-324, "0.1", None, True, (), "sphere"]
BAD += [1e-200, 1e200, -0.0, 2.0]


def planned(contact: dict[str, Any] | None = None, **changes: Any) -> Trial:
    """A sphere on a sphere, but for what is changed."""
    own = {"finger": cs.Sphere(0.04), "object_at": (1.0, 0.5)} | (contact or {})
    given = {"object": cs.Sphere(0.1), "profile": cs.Profile([0.1]), "duration": 1.0}
    given |= {"contacts": [cs.Contact(**own)], "name": "wrong"} | changes
    scene = cs.Scene(**given)
    made = scene.contacts[0]
    finger, obj = (
        Body(surface, round_body(surface.size), at, surface.size, line="sphere")
        for surface, at in ((made.finger, made.finger_at), (scene.object, made.object_at))
    )
    return Trial(scene, finger, obj)


def _wrong(draw: Draw) -> dict[str, Callable[[Any], Any]]:
    """Ways to put a value where it may not belong, by name; each plans what it makes."""

    def contact(**changes: Any) -> Trial:
        return planned(changes)

    def plan() -> cs.Plan:
        return cs.plan(planned().scene)

    def disturbed(kind: type, *values: Any) -> Trial:
        return planned(disturbances=[kind(*values)])

    kind = draw.pick(DISTURBANCES)
    return {
        "radius": lambda x: planned(object=cs.Sphere(x)),
        "finger radius": lambda x: contact(finger=cs.Sphere(x)),
        "finger": lambda x: contact(finger=x),
        "object": lambda x: planned(object=x),
        "object_at u": lambda x: contact(object_at=(x, 0.5)),
        "object_at v": lambda x: contact(object_at=(1.0, x)),
        "object_at": lambda x: contact(object_at=x),
        "angle": lambda x: contact(angle=x),
        "finger_velocity": lambda x: contact(finger_velocity=(x, 1.0)),
        "finger_velocity, whole": lambda x: contact(finger_velocity=x),
        "object_velocity": lambda x: contact(object_velocity=(0.1, x)),
        "object_velocity, whole": lambda x: contact(object_velocity=x),
        "profile": lambda x: planned(profile=cs.Profile([0.1, x])),
        "profile, first": lambda x: planned(profile=cs.Profile([x])),
        "profile, high": lambda x: planned(profile=cs.Profile([0.1, 0, 0, 0, 0, 0, x])),
        "duration": lambda x: planned(duration=x),
        "gain path": lambda x: planned(gain=cs.Gain.path(x)),
        "gain time": lambda x: planned(gain=cs.Gain.time(x)),
        "gain guaranteed": lambda x: planned(gain=cs.Gain.guaranteed(x)),
        "gain law": lambda x: planned(gain=cs.Gain(x, 1.0)),
        "torus": lambda x: planned(object=cs.Torus(x, 0.03)),
        "torus, tube": lambda x: planned(object=cs.Torus(0.1, x)),
        "ellipsoid": lambda x: planned(object=cs.Ellipsoid(0.3, x, 0.1)),
        "quadric": lambda x: planned(object=cs.Quadric([[x, 0, 0], [0, 2, 0], [0, 0, x]])),
        "quadric, one": lambda x: planned(object=cs.Quadric([[1, 0.2, 0], [0.2, x, 0], [0, 0, 3]])),
        "implicit": lambda x: planned(
            object=cs.ImplicitSurface("x**2 + y**2 + z**2 - r", parameters={"r": x})
        ),
        "parametric": lambda x: planned(
            object=cs.ParametricSurface(("u", "v", "k*u"), parameters={"k": x})
        ),
        "window start": lambda x: disturbed(kind, 0, x, 0.5, (0.1, 0.1)),
        "window stop": lambda x: disturbed(kind, 0, 0.1, x, (0.1, 0.1)),
        "window contact": lambda x: disturbed(kind, x, 0.1, 0.5, (0.1, 0.1)),
        "window value": lambda x: disturbed(kind, 0, 0.1, 0.5, (0.1, x)),
        "tolerance": lambda x: cs.plan(planned().scene, tolerance=x),
        "time": lambda x: plan().states([0.5, x]),
        "time, points": lambda x: plan().points(x),
        "restart": lambda x: plan().restart(x, np.ones((1, 9))),
        "restart, state": lambda x: plan().restart(0.5, [[x] * 9]),
        "continued": lambda x: plan().continued(x),
    }


def _wrong_case(index: int) -> Case:
    draw = Draw(zlib.crc32(b"wrong input"), index)
    ways = _wrong(draw)
    name, value = list(ways)[index % len(ways)], BAD[index // len(ways) % len(BAD)]
    if index >= len(ways) * len(BAD):
        value = draw.pick([-1, 1]) * 10 ** draw.real(-320, 308)
    return Case(f"{name} = {value!r}", lambda: _tried(ways[name], value))


def _tried(way: Callable[[Any], Any], value: Any) -> Verdict:
    """Refused; or taken, and then nothing that comes out is NaN or infinite, spheres are right."""
    out = way(value)
    if isinstance(out, Trial):
        surfaces = (out.finger.surface, out.object.surface)
        if all(isinstance(s, cs.Sphere) and 1e-100 < s.size < 1e100 for s in surfaces):
            return run(out)
        out = cs.plan(out.scene)
    if isinstance(out, cs.Plan):
        t, plan = np.linspace(out.start, out.scene.duration, 4), out
        told = (plan.points, plan.states, plan.slip, plan.pose, plan.twist)
        out = np.concatenate([np.ravel(tell(t)) for tell in told])
    finite = bool(np.isfinite(out).all())
    return Verdict("right" if finite else "silent", 0.0 if finite else math.inf, 1.0, "finite")


SLIPS = {"slip": 1, "windows": 0}
QUIET, SIGMAS = {"windows": 0}, list(PROFILES)
TURNS = [2 * math.pi * 10.0**k for k in range(6)]
LONG = ({"object": "torus"}, {"object": "ellipsoid", "shape": "plain"}, {"object": "chart_torus"})
LONGEST = {"finger": "plane", "windows": 0, "most": 7e5, "ratio": 10.0}
SIDES = [{"shape": s, side: "ellipsoid"} for s in SHAPES for side in ("object", "finger")]
RATIOS = [10 ** (k / 2) for k in range(-12, 13)]
RESTING = {"windows": 0, "most": 2e6}
FLAT = BUILT_IN[:3]
TIGHT = [10.0**-k for k in range(3, 16)]
TURNING = [{"turns": turns} | body for turns in TURNS for body in LONG]
BESIDE = ["sphere", "sphere", "torus"]
EVERY = {"object": BUILT_IN, "windows": [0, 1, 2, 3]}
FAMILIES = [
    grid("gain laws", 4, gain_law, profile=SIGMAS, law=LAWS, eta=ETAS),
    grid("eta and gain law", 3, always=SLIPS, eta=ETAS, law=LAWS, object=BUILT_IN),
    grid("profile", 1, always=SLIPS, profile=SIGMAS, law=LAWS, object=BUILT_IN, eta=ETAS[3::3]),
    grid("poles and umbilics", 3, cases=_poles(), slip=[0, 1]),
    grid("radius ratio", 6, always=QUIET, ratio=RATIOS, object=BUILT_IN),
    grid("ellipsoids", 6, cases=SIDES, windows=[0, 0, 0, 1], inside=[False, True]),
    grid("conforming bowls", 10, on_trials(bowl), _bowls(), QUIET | {"bowl": True}),
    grid("revolutions", 3, always=RESTING, turns=TURNS, object=FLAT, finger=FLAT),
    grid("revolutions, integrated", 1, cases=TURNING, always=LONGEST),
    grid("tolerance", 8, always=QUIET, tolerance=TIGHT, object=BUILT_IN, slip=[0, 1]),
    grid("disturbances", 100, windows=[1, 2, 3]),
    grid("contacts among others", 8, on_trials(among_others), finger=BESIDE, **EVERY),
    grid("surfaces of users", 4, object=USERS, finger=USERS, slip=[0, 1]),
    Family("wrong input", 5000, _wrong_case, endless=True),
    grid("everything", 5000),
]
