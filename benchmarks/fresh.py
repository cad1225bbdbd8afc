"""What a plan costs later: scenes made anew each time, of which nothing was ever planned.

Times hold the plan and what it is asked for, not the making of the scene.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from oracles.load import load, scene_of

import contact_system as cs

from .accuracy import reference_error, rolled
from .many import OUTPUTS
from .peers import decades, heyokas
from .problems import Problem, chart, geodesic_scene, no_slip, sizes_of
from .report import Bar, Sections
from .timing import Job, interleaved
from .work_precision import TARGETS, beside, measure

POINTS = 400
LIMITS = {"K1": 0.15, "K2": 0.5, "K4": 0.6, "D1": 0.6, "bowl": 0.6, "implicit": 1.0, "chart": 1.0}
OBJECTS = {"sphere": cs.Sphere(0.1), "ellipsoid": cs.Ellipsoid(0.3, 0.2, 0.1)}
_NUMBER = itertools.count(1)


def anew(scene: cs.Scene) -> cs.Scene:
    """A scene like this one whose parts are all new and differ in the ninth digit each time."""
    more = 1.0 + 1e-9 * next(_NUMBER)

    def grown(part: Any) -> Any:
        if isinstance(part, tuple):
            return tuple(grown(x) for x in part)
        if isinstance(part, (cs.Surface, cs.Contact, cs.Gain, cs.Profile)):
            fields = (f.name for f in dataclasses.fields(part))
            return dataclasses.replace(part, **{k: grown(getattr(part, k)) for k in fields})
        return more * part if isinstance(part, float) else part

    names = ("object", "contacts", "profile", "gain")
    return scene.replace(**{name: grown(getattr(scene, name)) for name in names})


def _asked(times: np.ndarray, *outputs: str) -> Callable[[cs.Scene], Any]:
    return lambda scene: cs.plan(scene).evaluate(times, *outputs)


def _like(name: str, *outputs: str) -> Job:
    """Plans scenes like a bundled one and asks them."""
    scene = cs.load_scene(name)
    times = np.linspace(0.0, scene.duration, POINTS)
    return Job(_asked(times, *outputs), partial(anew, scene))


def scenes(full: bool) -> Iterator[Bar]:
    """Later scenes like those that `first` plans; then all that K4 can be asked for."""
    jobs = {name: _like(name, "points") for name in LIMITS} | {"all": _like("K4", *OUTPUTS)}
    times = interleaved(jobs, 15 if full else 7)
    for name, limit in LIMITS.items():
        what = f"later fresh plan and {POINTS} points, {name}"
        yield Bar(what, limit, 1e3 * times[name].median, "ms", note=f"{times[name]}")
    what = "the same and states, slip, pose, twist, K4"
    yield Bar(what, 2.0, 1e3 * times["all"].median, "ms", note=f"{times['all']}")


def geodesic(full: bool) -> Iterator[Bar]:
    """The end of a geodesic of 3 m on the ellipsoid 0.3/0.2/0.1, 200 of them in turn."""
    data = load("ellipsoid_geodesics")
    length = float(data["length"])

    def make(k: int) -> cs.Scene:
        u, v, a = data["start"][k]
        surface, direction = cs.Ellipsoid(*data["axes"]), (math.cos(a), math.sin(a))
        return geodesic_scene(surface, (u, v), direction, length)

    def end(tolerance: float, scene: cs.Scene) -> np.ndarray:
        return cs.plan(scene, tolerance).points(length)[0, 0, 1]

    turn = itertools.cycle(range(len(data["start"])))
    tolerances = (1e-12, 1e-15)
    jobs = {f"{x:g}": Job(partial(end, x), lambda: make(next(turn))) for x in tolerances}
    times = interleaved(jobs, 15)
    for tolerance in tolerances:
        ends = [end(tolerance, make(k)) for k in range(len(data["start"]))]
        error = np.linalg.norm(np.array(ends) - data["end"], axis=1).max()
        limit = 0.06 if tolerance == tolerances[0] else None
        what = f"triaxial geodesic, fresh plan and its end, tolerance {tolerance:g}"
        ms = 1e3 * times[f"{tolerance:g}"].median
        yield Bar(what, limit, ms, "ms", note=f"greatest error {error:.1e} m")


PEAKS = {1e2: 2.0, 1e5: 40.0, 1e7: 40.0}  # greatest eta sigma^2 [1/s]: times faster


def heyoka(full: bool) -> Iterator[Bar]:
    """At equal achieved error, 400 outputs; heyoka's integrators and initial states are ready."""
    for output, limit in (("points", 3.0), ("states", 2.0)):
        problem = no_slip(output, POINTS)
        yield beside(measure(problem, heyokas(problem), repeats=9), 1e-14, limit)
    for peak, limit in PEAKS.items():
        for kind, obj in OBJECTS.items():
            yield from _slip(kind, obj, peak, limit)


def slip_scene(obj: cs.Surface, gain: cs.Gain) -> cs.Scene:
    """A contact that slips at first, as in tests/oracles/*_slip.json."""
    at = {"object_at": (0.7, 0.4), "finger_at": (1.1, 0.2), "angle": 0.3}
    contact = cs.Contact(cs.Sphere(0.04), **at, object_velocity=(0.2, -0.9))
    profile = cs.Profile([0.001, 0.0, 0.4])
    return cs.Scene(object=obj, contacts=[contact], profile=profile, gain=gain, duration=1.0)


def _slip(kind: str, obj: cs.Surface, peak: float, limit: float) -> Iterator[Bar]:
    """Chart states under slip; truth is our plan at 1e-15, as exact as is told behind."""
    scene, off = slip_scene(obj, cs.Gain.path(peak / 0.401**2)), truth_error(kind)
    name, times = f"slip, {kind}, peak {peak:.0e}", np.linspace(0.0, 1.0, POINTS)
    truth, forms = cs.plan(scene, 1e-15).points(times), {"chart": chart(scene, times)}
    given = times, truth, sizes_of(scene), forms, "states"
    problem = Problem(name, scene.replace, *given)
    outcome = measure(problem, heyokas(problem), decades(1, 15), limit=2.0, repeats=7)
    for target in TARGETS:
        note = f"; truth within {off:.0e}"
        yield beside(outcome, target, limit, note=note, holds=off <= 0.1 * target)


@functools.cache
def truth_error(kind: str) -> float:
    """Greatest error of plans at 1e-15 against 30 digits, peaks 1e0 to 1e7, of the size."""
    peaks = load("slip_peaks")["scenes"].items()
    records = [r for key, r in peaks if key.startswith(kind)]
    records += load(f"{kind}_slip")["scenes"].values()
    return max(reference_error(scene_of(r), r, 1e-15) for r in records)


def eta(full: bool) -> Iterator[Bar]:
    """Time over gains from 1 to 1e10: plan and states at 400 times."""
    call = _asked(np.linspace(0.0, 1.0, POINTS), "states")
    for (kind, obj), law in itertools.product(OBJECTS.items(), ("path", "time")):
        gains = (cs.Gain(law, 10.0**k) for k in range(0, 11, 2))
        jobs = {f"{gain.value:g}": Job(call, partial(slip_scene, obj, gain)) for gain in gains}
        times = {name: timing.median for name, timing in interleaved(jobs, 7).items()}
        most, least = max(times, key=times.__getitem__), min(times, key=times.__getitem__)
        note = f"{1e6 * times[most]:.4g} us at {most}, {1e6 * times[least]:.4g} us at {least}"
        name = f"time over eta 1 to 1e10, most over least, {kind}, law {law}"
        yield Bar(name, 1.5, times[most] / times[least], "x", note=note)


def as_chart(surface: cs.Surface) -> cs.ParametricSurface:
    """The surface as a chart of which nothing is known, so without closed forms."""

    def f(u: ca.SX, v: ca.SX, **given: ca.SX) -> ca.SX:
        return surface.chart_expr(ca.vertcat(*given.values()), u, v)

    parameters = {f"p{i}": value for i, value in enumerate(surface.parameters)}
    known = dict(zip(("u_period", "v_period"), surface.periods()), size=surface.size)
    return cs.ParametricSurface(f, parameters=parameters, **known)


def full_dress(scene: cs.Scene) -> cs.Scene:
    """The same motion on charts, every contact disturbed in all ways, too little to be seen.

    Imposed rolling becomes a finger velocity. Windows leave out a hundredth of the horizon at both
    ends, where sigma may be 0.
    """
    contacts = []
    for contact in scene.contacts:
        given = contact.finger_velocity
        if given == "rolling":
            given = tuple(rolled(contact.angle, np.array(contact.object_velocity)))
        changes = {"finger": as_chart(contact.finger), "finger_velocity": given}
        contacts.append(dataclasses.replace(contact, **changes))
    window = 0.01 * scene.duration, 0.99 * scene.duration, (1e-13, 1e-13)
    kinds = (cs.FingerAcceleration, cs.ObjectAcceleration, cs.ObjectRateOffset)
    disturbances = [kind(i, *window) for i in range(len(contacts)) for kind in kinds]
    disturbances += scene.disturbances
    surface = as_chart(scene.object)
    return scene.replace(object=surface, contacts=contacts, disturbances=disturbances)


def skipped(full: bool) -> Iterator[Bar]:
    """What a scene does not have costs nothing: the paper's scenes beside themselves in full dress.

    The library has no switch for what it skips; a scene that needs it asks for it.
    """
    for name in ("K1", "K2", "K3", "K4", "D1", "D2", "D3", "C1", "C2"):
        scene = cs.load_scene(name)
        dressed, times = full_dress(scene), np.linspace(0.0, scene.duration, POINTS)
        off = float(np.abs(cs.plan(scene).points(times) - cs.plan(dressed).points(times)).max())
        call = _asked(times, "points")
        jobs = {"plain": Job(call, scene.replace), "dressed": Job(call, dressed.replace)}
        plain, dear = (1e3 * timing.median for timing in interleaved(jobs, 5).values())
        note = f"{plain:.3g} ms beside {dear:.3g} ms; paths {off:.0e} m apart"
        what = f"{name}, plan and {POINTS} points, times faster than in full dress"
        yield Bar(what, 1.0, dear / plain, "x", True, note, off < 1e-10)


SECTIONS: Sections = {
    "scenes": scenes,
    "geodesic": geodesic,
    "heyoka": heyoka,
    "eta": eta,
    "skipped": skipped,
}
