"""What plans cost later in a process, of scenes made anew each time, so that no cache helps.

Times are those of planning and evaluating, without making the scene.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from oracles.load import load, scene_of

import contact_system as cs

from .accuracy import reference_error
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
            fields = (f.name for f in dataclasses.fields(part) if f.init)
            return dataclasses.replace(part, **{k: grown(getattr(part, k)) for k in fields})
        return more * part if isinstance(part, float) else part

    names = ("object", "contacts", "profile", "gain")
    return scene.replace(**{name: grown(getattr(scene, name)) for name in names})


def _asked(times: np.ndarray, *outputs: str) -> Callable[[cs.Scene], Any]:
    return lambda scene: cs.plan(scene).evaluate(times, *outputs)


def _like(name: str, *outputs: str) -> Job:
    """A job that plans new scenes like a bundled one and evaluates outputs."""
    scene = cs.load_scene(name)
    times = np.linspace(0.0, scene.duration, POINTS)
    return Job(_asked(times, *outputs), partial(anew, scene))


def scenes(full: bool) -> Iterator[Bar]:
    """Later scenes like those that `first` plans; then all outputs of K4."""
    jobs = {name: _like(name, "points") for name in LIMITS} | {"all": _like("K4", *OUTPUTS)}
    times = interleaved(jobs, 15 if full else 7)
    for name, limit in LIMITS.items():
        yield Bar(f"later fresh plan and {POINTS} points, {name}", limit, 1e3 * times[name], "ms")
    what = "the same and states, slip, pose, twist, K4"
    yield Bar(what, 2.0, 1e3 * times["all"], "ms")


def geodesic(full: bool) -> Iterator[Bar]:
    """The end of a geodesic of 3 m on the ellipsoid 0.3/0.2/0.1, 200 of them in turn."""
    data = load("ellipsoid_geodesics")
    surface, length = cs.Ellipsoid(*data["axes"]), float(data["length"])

    def make(u: float, v: float, a: float) -> cs.Scene:
        body = dataclasses.replace(surface)
        return geodesic_scene(body, (u, v), (math.cos(a), math.sin(a)), length)

    def end(scene: cs.Scene) -> np.ndarray:
        return cs.plan(scene).points(length)[0, 0, 1]

    turn = itertools.cycle(data["start"])
    ms = 1e3 * interleaved({"line": Job(end, lambda: make(*next(turn)))}, 15)["line"]
    ends = np.array([end(make(*start)) for start in data["start"]])
    note = f"greatest error {np.linalg.norm(ends - data['end'], axis=1).max():.1e} m"
    yield Bar("triaxial geodesic, fresh plan and its end", 0.06, ms, "ms", note=note)


PEAKS = {1e2: 2.0, 1e5: 40.0, 1e7: 40.0}  # greatest eta sigma^2 [1/s]: bar, times faster


def heyoka(full: bool) -> Iterator[Bar]:
    """At equal achieved error, 400 outputs; heyoka's integrators and initial states are ready."""
    for output, limit in (("points", 3.0), ("states", 2.0)):
        problem = no_slip(output, POINTS)
        curves = measure(problem, heyokas(problem), repeats=9)
        yield beside(problem.name, curves, 1e-14, limit)
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
    """Chart states under slip; truth is our own plan at 1e-15, whose error the note tells."""
    scene, off = slip_scene(obj, cs.Gain.path(peak / 0.401**2)), truth_error(kind)
    name, times = f"slip, {kind}, peak {peak:.0e}", np.linspace(0.0, 1.0, POINTS)
    truth, forms = cs.plan(scene, 1e-15).points(times), {"chart": chart(scene, times)}
    given = times, truth, sizes_of(scene), forms, "states"
    problem = Problem(name, scene.replace, *given)
    curves = measure(problem, heyokas(problem), decades(1, 15), limit=2.0, repeats=7)
    for target in TARGETS:
        note = f"; truth within {off:.0e}"
        yield beside(name, curves, target, limit, note=note, holds=off <= 0.1 * target)


@functools.cache
def truth_error(kind: str) -> float:
    """Greatest error of plans at 1e-15 against 30 digits, peaks 1e0 to 1e7, over the size."""
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
        times = interleaved(jobs, 7)
        most, least = max(times, key=times.__getitem__), min(times, key=times.__getitem__)
        note = f"{1e6 * times[most]:.4g} us at {most}, {1e6 * times[least]:.4g} us at {least}"
        name = f"time over eta 1 to 1e10, most over least, {kind}, law {law}"
        yield Bar(name, 1.5, times[most] / times[least], "x", note=note)


SECTIONS: Sections = {
    "scenes": scenes,
    "geodesic": geodesic,
    "heyoka": heyoka,
    "eta": eta,
}
