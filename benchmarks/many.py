"""Many contacts in one scene, and many scenes: `cs.sweep` on one core and on two threads.

Contacts differ in place, direction and starting slip. For each scene a sweep computes chart states
and slip at 100 times, and keeps the greatest slip, the last one and the end state.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from oracles.formulas import slip_of_states

import contact_system as cs

from .report import Bar, Sections
from .timing import Job, in_new_process, interleaved

FINGER = cs.Sphere(0.04)
OBJECTS = {"sphere": cs.Sphere(0.2), "ellipsoid": cs.Ellipsoid(0.3, 0.2, 0.1)}
PROFILE, GAIN, DURATION = cs.Profile([0.05, 0.1]), cs.Gain.path(200.0), 1.0
TIMES = np.linspace(0.0, DURATION, 100)
OUTPUTS = ("points", "states", "slip", "pose", "twist")
_STEPS = [1.1347241384015194**-j for j in range(1, 7)]  # x^7 = x + 1: R6 sequence (Roberts 2018)


def contact(k: int) -> cs.Contact:
    """Contact k of a low-discrepancy sequence over six parameters, the same in every process."""
    x = [(k + 1) * step % 1.0 for step in _STEPS]
    direction, own, left = 2 * math.pi * x[0], 2 * math.pi * x[1], 0.2 + x[2]
    return cs.Contact(
        finger=FINGER,
        object_at=(0.9 + 1.2 * x[3], 6.0 * x[4] - 3.0),
        angle=6.0 * x[5] - 3.0,
        finger_velocity=(math.cos(direction), math.sin(direction)),
        object_velocity=(left * math.cos(own), left * math.sin(own)),
    )


def scene(first: int, count: int = 1, kind: str = "sphere") -> cs.Scene:
    """A scene of ``count`` contacts from contact number ``first`` on."""
    return cs.Scene(
        object=OBJECTS[kind],
        contacts=[contact(k) for k in range(first, first + count)],
        profile=PROFILE,
        gain=GAIN,
        duration=DURATION,
    )


def contacts(full: bool) -> Iterator[Bar]:
    """1000 contacts at 100 times, each time a new scene: a plan and one output, or all of them."""
    for kind in OBJECTS:
        whole = scene(0, 1000, kind)
        asked = {name: (name,) for name in OUTPUTS} | {"together": OUTPUTS}
        jobs = {name: Job(partial(_asked, names), whole.replace) for name, names in asked.items()}
        times = {name: 1e3 * t for name, t in interleaved(jobs, 5).items()}
        together, name = times.pop("together"), f"1000 contacts on {kind}, 100 times"
        note = ", ".join(f"{output} {ms:.3g}" for output, ms in times.items())
        error = _law_error(whole)
        checked = {"note": f"slip within {error:.0e} of its exact law", "holds": error < 1e-12}
        yield Bar(f"{name}, five outputs together", 60.0, together, "ms", **checked)
        yield Bar(f"{name}, one of them alone", 25.0, max(times.values()), "ms", note=note)


def _asked(outputs: tuple[str, ...], scene: cs.Scene) -> dict[str, np.ndarray]:
    return cs.plan(scene).evaluate(TIMES, *outputs)


def _law_error(scene: cs.Scene) -> float:
    """Error of the states' slip against its law (eq. `contracaccel`), over the greatest slip."""
    slip = np.linalg.norm(slip_of_states(scene, cs.plan(scene).states(TIMES)), axis=2)
    left = PROFILE(TIMES) / PROFILE(0.0) * np.exp(-GAIN.exponent(PROFILE, TIMES))
    return float(np.abs(slip - slip[0] * left[:, None]).max() / slip.max())


CROWD = """
import json, resource, sys, time
import numpy as np
import contact_system as cs
from benchmarks.many import DURATION, scene

count = int(sys.argv[1])
begin = time.perf_counter()
made = scene(0, count, "ellipsoid")
ready = time.perf_counter()
points = cs.plan(made).points(np.linspace(0.0, DURATION, 10))
end = time.perf_counter()
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
print(json.dumps({"made": ready - begin, "planned": end - ready, "GB": peak}))
"""


def crowd(full: bool) -> Iterator[Bar]:
    """100 000 contacts on an ellipsoid in one scene, in a process of its own."""
    found = in_new_process(CROWD, "100000")
    name = "100 000 contacts, points at 10 times"
    seconds, note = found["made"] + found["planned"], f"{found['made']:.3g} s to make the scene"
    yield Bar(f"{name}, scene, plan and points", 5.0, seconds, "s", note=note)
    yield Bar(f"{name}, peak of the process", 1.0, found["GB"], "GB")


def kept(plan: cs.Plan) -> dict[str, np.ndarray]:
    """What a sweep keeps of each contact: greatest and last slip, and the end state."""
    found = plan.evaluate(TIMES, "states", "slip_speed")
    slip = found["slip_speed"]
    return {"slip_peak": slip.max(axis=0), "slip_end": slip[-1], "state_end": found["states"][-1]}


def _timed(count: int, executor: Executor | None = None) -> tuple[float, np.ndarray]:
    begin = time.perf_counter()
    table = cs.sweep(map(scene, range(count)), kept, executor).table
    return time.perf_counter() - begin, table


def sweep(full: bool) -> Iterator[Bar]:
    """Scenes with slip, made as the sweep needs them: on this thread and on two, in turns."""
    count = 100_000 if full else 20_000
    spent: dict[str, list[float]] = {"one": [], "two": []}
    tables: dict[str, Any] = {}
    with ThreadPoolExecutor(2) as pool:
        for name, executor in (("one", None), ("two", pool)) * 3:
            seconds, tables[name] = _timed(count, executor)
            spent[name].append(seconds)
    one, two = (min(times) for times in spent.values())
    whole, note = len(tables["one"]) == count, f"{1e6 * one / count:.3g} us a scene; best of three"
    rate = {"unit": "/s", "least": True, "note": note, "holds": whole}
    yield Bar(f"sweep of {count} scenes with slip, one core", 4e4, count / one, **rate)
    same = tables["one"].tobytes() == tables["two"].tobytes()
    ratio = {"unit": "x", "least": True, "note": "best of three, in turns", "holds": same}
    yield Bar("the same, two threads over one", 1.8, one / two, **ratio)


SECTIONS: Sections = {"contacts": contacts, "crowd": crowd, "sweep": sweep}
