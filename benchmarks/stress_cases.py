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

from .stress_laws import Judge, Meter, left_over, run
from .stress_scenes import (
    DISTURBANCES,
    EPS,
    ETAS,
    LAWS,
    PROFILES,
    SHAPES,
    Body,
    Draw,
    Seeded,
    Trial,
    draw_trial,
    round_body,
    stretched,
)
from .verdicts import Case, Family, Verdict, refusal

# --- families ----------------------------------------------------------------------------------


def grid(
    name: str,
    repeats: int,
    axes: Sequence[Sequence[dict[str, Any]]],
    run_trial: Callable[[Trial], Verdict] = run,
) -> Family:
    """All combinations of choices, each repeated with all else drawn anew.

    Parameters
    ----------
    name : str
    repeats : int
        Of the whole grid; further indices draw further repeats.
    axes : per axis, choices as arguments of `draw_trial`
    run_trial : judge
    """
    count = math.prod(map(len, axes))
    key = zlib.crc32(name.encode())

    def make(index: int) -> Case:
        places = np.unravel_index(index % count, [len(axis) for axis in axes])
        fixed: dict[str, Any] = {}
        for axis, place in zip(axes, places):
            fixed |= axis[int(place)]
        draw = Seeded(key, index)
        return Case(f"{name} {index}: {fixed}", name, lambda: run_trial(draw_trial(draw, **fixed)))

    return Family(name, repeats * count, make, endless=True)


def axis(key: str, values: Sequence[Any]) -> list[dict[str, Any]]:
    """One choice of `draw_trial` with these values."""
    return [{key: value} for value in values]


BUILT_IN = ("plane", "sphere", "cylinder", "torus", "ellipsoid", "turned")
OF_USERS = ("chart_sphere", "chart_torus", "chart_waves", "implicit_ellipsoid", "implicit_cube")
MISSES = (0.0, *(10.0**-k for k in range(15, -1, -1)))
# What has poles or umbilics; `chart` is the user's sphere of one pole.
POLES = [
    {"kind": "sphere"},
    *({"kind": "ellipsoid", "shape": s} for s in ("oblate", "prolate", "equal axes", "plain",
                                                  "needle", "pancake", "nearly a sphere")),
    {"kind": "implicit_ellipsoid"},
]  # fmt: skip


def _poles() -> list[dict[str, Any]]:
    """Every kind of pole, passed by object and finger at every distance."""
    cases = []
    for what, side, miss in itertools.product(POLES, ("object", "finger"), MISSES):
        other = {"object": "finger", "finger": "object"}[side]
        shape = {"shape": what["shape"]} if "shape" in what else {}
        cases.append({side: what["kind"], other: "sphere", "pole": (side, miss),
                      "profile": "constant", "windows": 0, "turns": 4.0} | shape)  # fmt: skip
    return cases


def bowl(trial: Trial) -> Verdict:
    """The plan judged as ever; then its twist turned back into contact rates, or refused."""
    verdict = run(trial)
    if verdict.outcome != "right":
        return verdict
    plan = cs.plan(trial.scene, tolerance=trial.tolerance)
    judge = Judge(trial, plan)
    sample, _ = judge._sample(np.array([0.4, 0.7]) * trial.scene.duration)
    forms = [
        body.surface.curvature_form(*sample.states[:, 4 * k : 4 * k + 2].T)
        for k, body in enumerate(judge.bodies)
    ]
    a1, a2 = sample.plane(0), sample.plane(1)
    slip = plan.slip(sample.t)[:, 0]
    # Montana's inverse map, stated here: [-omega_y, omega_x] = K1 a1 + R K2 a2
    bend = np.einsum("nij,nj->ni", forms[0], a1)
    bend += np.einsum("nij,njk,nk->ni", sample.turn, forms[1], a2)
    omega = np.stack([bend[:, 1], -bend[:, 0]], axis=1)
    relative = forms[0] + sample.turn @ forms[1] @ sample.turn
    terms = abs(forms[0]).max() + abs(forms[1]).max()
    try:
        b1, b2 = cs.kinematics.forward_montana(*forms, sample.states[:, 8], omega, slip)
    except cs.ConformalContact as error:
        said = refusal(str(error))
        clear = np.abs(np.linalg.det(relative)).min() > 1e-9 * terms**2
        return Verdict("silent", 1.0, 0.0, "refused, but not conformal") if clear else said
    condition = terms / np.linalg.svd(relative, compute_uv=False).min()
    speed = np.linalg.norm(a1, axis=1).max() + np.linalg.norm(a2, axis=1).max()
    loss = sum(float(judge._loss(sample, k).max()) for k in (0, 1))
    judge.meter.see("contact rates from the twist", np.array([b1 - a1, b2 - a2]),
                    8 * condition * (loss + 64 * EPS) * speed)  # fmt: skip
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
    plan = cs.plan(crowd, tolerance=trial.tolerance, compiled=trial.compiled)
    return Judge(trial, OneOf(plan, index)).verdict()


def _bowls() -> list[dict[str, Any]]:
    """Fingers of a bowl's own form, less a part of their radius."""
    return [
        {"object": kind, "finger": kind, "ratio": 1.0 - less, "bowl": True, "windows": 0}
        for kind in ("sphere", "cylinder", "torus", "ellipsoid", "plane")
        for less in (0.0, *(10.0**-k for k in range(16, 0, -1)), 0.5)
    ]


# --- gain laws alone ---------------------------------------------------------------------------


def gain_law(draw: Draw, **fixed: Any) -> Verdict:
    """The decay that planners use, piece by piece, and `contraction`, against the law."""
    duration = 10 ** draw.real(-3, 3)
    profile = stretched(PROFILES[fixed["profile"]], 10 ** draw.real(-4, 4), duration)
    gain = cs.Gain(fixed["law"], fixed["eta"])
    profile.check(duration)
    sigma, left, meter = np.array(profile.coefficients), 1.0, Meter()
    terms = float(poly.polyval(duration, abs(sigma)))
    for piece in gain.pieces(profile, 0.0, duration):
        tau = (piece.stop - piece.start) * np.array([0.0, draw.real(0, 1), 1.0])
        speed = piece.speed(tau)
        decay = left * piece.decay(tau, speed)
        law = left_over(sigma, gain, piece.start + tau)
        # lam t has the rounding of t; exp(-x) x is at most 0.37
        meter.see("decay of a piece", np.nan_to_num(decay, nan=math.inf) * speed - law,
                  256 * EPS * terms)  # fmt: skip
        left = float(decay[-1])
    said = cs.profile.contraction(profile, gain, duration).left
    if not math.isnan(said):
        law = left_over(sigma, gain, np.array([duration])) / sigma[0]
        meter.see("what contraction says is left", said - law, 256 * EPS * terms / sigma[0])
    return meter.verdict()


def _gain_laws() -> Family:
    choices = list(itertools.product(PROFILES, LAWS, ETAS))

    def make(index: int) -> Case:
        fixed = dict(zip(("profile", "law", "eta"), choices[index % len(choices)]))
        draw = Seeded(zlib.crc32(b"gain laws"), index)
        return Case(f"gain laws {index}: {fixed}", "gain laws", lambda: gain_law(draw, **fixed))

    return Family("gain laws", 4 * len(choices), make, endless=True)


# --- input that must be refused ----------------------------------------------------------------

BAD = (math.nan, math.inf, -math.inf, -1.0, 0.0, 1e300, 5e-324, "0.1", None, True, (), "sphere",
       1e-200, 1e200, -0.0, 2.0)  # fmt: skip


def _wrong(draw: Draw) -> dict[str, Callable[[Any], Any]]:
    """Ways to put a value where it may not belong, by name; each plans what it makes."""
    good = {
        "object": cs.Sphere(0.1), "profile": cs.Profile([0.1]), "duration": 1.0, "name": "wrong",
        "contacts": [cs.Contact(finger=cs.Sphere(0.04), object_at=(1.0, 0.5))],
    }  # fmt: skip

    def planned(**changes: Any) -> Trial:
        scene = cs.Scene(**(good | changes))
        body = Body(scene.object, round_body(scene.object.size), scene.contacts[0].object_at,
                    scene.object.size, line="sphere")  # fmt: skip
        finger = scene.contacts[0].finger
        return Trial(scene, Body(finger, round_body(finger.size), scene.contacts[0].finger_at,
                                 finger.size, line="sphere"), body, compiled=True)  # fmt: skip

    def contact(**changes: Any) -> Trial:
        return planned(contacts=[cs.Contact(**({"finger": cs.Sphere(0.04), "object_at": (1.0, 0.5)}
                                               | changes))])  # fmt: skip

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
            object=cs.ImplicitSurface("x**2 + y**2 + z**2 - r", parameters={"r": x})),
        "parametric": lambda x: planned(
            object=cs.ParametricSurface(("u", "v", "k*u"), parameters={"k": x})),
        "window start": lambda x: disturbed(kind, 0, x, 0.5, (0.1, 0.1)),
        "window stop": lambda x: disturbed(kind, 0, 0.1, x, (0.1, 0.1)),
        "window contact": lambda x: disturbed(kind, x, 0.1, 0.5, (0.1, 0.1)),
        "window value": lambda x: disturbed(kind, 0, 0.1, 0.5, (0.1, x)),
        "tolerance": lambda x: cs.plan(planned().scene, tolerance=x),
        "time": lambda x: cs.plan(planned().scene).states([0.5, x]),
        "time, points": lambda x: cs.plan(planned().scene).points(x),
        "restart": lambda x: cs.plan(planned().scene).restart(x, np.ones((1, 9))),
        "restart, state": lambda x: cs.plan(planned().scene).restart(0.5, [[x] * 9]),
        "continued": lambda x: cs.plan(planned().scene).continued(x),
    }  # fmt: skip


def _wrong_case(index: int) -> Case:
    draw = Seeded(zlib.crc32(b"wrong input"), index)
    ways = _wrong(draw)
    name, value = list(ways)[index % len(ways)], BAD[index // len(ways) % len(BAD)]
    if index >= len(ways) * len(BAD):
        value = draw.pick([-1, 1]) * 10 ** draw.real(-320, 308)
    return Case(f"{name} = {value!r}", "wrong input", lambda: _tried(ways[name], value))


def _tried(way: Callable[[Any], Any], value: Any) -> Verdict:
    """Refused; or taken, and then nothing that comes out is NaN or infinite, spheres are right."""
    given = way(value)
    if isinstance(given, Trial):
        bodies = (given.finger, given.object)
        if all(b.surface.great_circles and 1e-100 < b.size < 1e100 for b in bodies):
            return run(given)
    if isinstance(given, Trial):
        given = cs.plan(given.scene, compiled=given.compiled)
    out = given
    if isinstance(given, cs.Plan):
        t = np.linspace(given.start, given.scene.duration, 4)
        out = np.concatenate([np.ravel(f(t)) for f in (given.points, given.states, given.slip,
                                                       given.pose, given.twist)])  # fmt: skip
    finite = bool(np.isfinite(out).all())
    return Verdict("right" if finite else "silent", 0.0 if finite else math.inf, 1.0, "finite")


FAMILIES = [
    _gain_laws(),
    grid("eta and gain law", 3, [axis("eta", ETAS), axis("law", LAWS), axis("object", BUILT_IN),
                                 [{"slip": 1, "windows": 0}]]),
    grid("profile", 1, [axis("profile", list(PROFILES)), axis("law", LAWS),
                        axis("object", BUILT_IN), axis("eta", [1.0, 1e3, 1e6, 1e9, 1e12]),
                        [{"slip": 1, "windows": 0}]]),
    grid("poles and umbilics", 3, [_poles(), axis("slip", [0, 1])]),
    grid("radius ratio", 6, [axis("ratio", [10 ** (k / 2) for k in range(-12, 13)]),
                              axis("object", BUILT_IN), [{"windows": 0}]]),
    grid("ellipsoids", 6, [
        axis("shape", SHAPES), [{"object": "ellipsoid"}, {"finger": "ellipsoid"}],
        axis("windows", [0, 0, 0, 1]), axis("inside", [False, True])]),
    grid("conforming bowls", 10, [_bowls()], bowl),
    grid("revolutions", 3, [axis("turns", [2 * math.pi * 10.0**k for k in range(6)]),
                            axis("object", BUILT_IN[:3]), axis("finger", BUILT_IN[:3]),
                            [{"windows": 0, "most": 2e6}]]),
    grid("revolutions, integrated", 1, [
        # compiled: the virtual machine takes 0.5 ms a panel
        axis("turns", [2 * math.pi * 10.0**k for k in range(6)]),
        [{"object": "torus"}, {"object": "ellipsoid", "shape": "plain"}, {"object": "chart_torus"}],
        [{"finger": "plane", "windows": 0, "most": 7e5, "compiled": True, "ratio": 10.0}]]),
    grid("tolerance", 8, [axis("tolerance", [10.0**-k for k in range(3, 16)]),
                           axis("object", BUILT_IN), axis("slip", [0, 1]), [{"windows": 0}]]),
    grid("disturbances", 100, [axis("windows", [1, 2, 3]), [{}]]),
    grid("contacts among others", 4, [
        axis("object", BUILT_IN), axis("finger", ["sphere", "sphere", "torus"]),
        axis("windows", [0, 1, 2, 3]), axis("compiled", [False, True])], among_others),
    grid("surfaces of users", 4, [axis("object", OF_USERS), axis("finger", OF_USERS),
                                  axis("slip", [0, 1])]),
    Family("wrong input", 5000, _wrong_case, endless=True),
    grid("everything", 800, [[{}]]),
]  # fmt: skip
