"""Many scenes: `cs.sweep` on one core, on two, over Dask, with a worker killed in the middle.

A finger slides on a sphere from places, directions and starting slips all over; of every scene the
chart states and the slip at 100 times are worked out; the greatest slip, the last one and the end
state are kept.
"""

from __future__ import annotations

import functools
import math
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np

import contact_system as cs
from contact_system.kernels import find_compiler

from .accuracy import slip_from_states
from .report import Bar
from .timing import resident

POINTS = 100
CROWD = 500  # contacts a scene, where one scene holds many
OBJECT, FINGER = cs.Sphere(0.2), cs.Sphere(0.04)
PROFILE, GAIN, DURATION = cs.Profile([0.05, 0.1]), cs.Gain.path(200.0), 1.0
PUSH = cs.FingerAcceleration(contact=0, start=0.3, stop=0.4, value=(-0.3, -0.3))


def evaluate(plan: cs.Plan) -> dict[str, np.ndarray]:
    """States and slip at 100 times; kept: two numbers and a state a contact."""
    t = np.linspace(0.0, plan.scene.duration, POINTS)
    states, slip = plan.states(t), plan.slip_speed(t)
    return {"slip_peak": slip.max(axis=0), "slip_end": slip[-1], "state_end": states[-1]}


def contact(k: int) -> cs.Contact:
    """Contact k: low-discrepancy values of six things, the same in every process."""
    x = np.modf((k + 1) * _STEPS)[0].tolist()
    direction, own, left = 2 * math.pi * x[0], 2 * math.pi * x[1], 0.2 + x[2]
    return cs.Contact(
        finger=FINGER,
        object_at=(0.9 + 1.2 * x[3], 6.0 * x[4] - 3.0),
        angle=6.0 * x[5] - 3.0,
        finger_velocity=(math.cos(direction), math.sin(direction)),
        object_velocity=(left * math.cos(own), left * math.sin(own)),
    )


_ROOT = 1.0 / 1.1347241384015194  # of x^7 = x + 1: the R6 sequence (Roberts 2018)
_STEPS = _ROOT ** np.arange(1, 7)


def scene(k: int, disturbed: bool = False) -> cs.Scene:
    """Scene k of one contact."""
    return _scene([contact(k)], disturbed)


def crowd(k: int) -> cs.Scene:
    """Scene k of CROWD contacts: the scenes CROWD k and on."""
    return _scene([contact(i) for i in range(CROWD * k, CROWD * (k + 1))], False)


def _scene(contacts: list[cs.Contact], disturbed: bool) -> cs.Scene:
    return cs.Scene(
        object=OBJECT, contacts=contacts, profile=PROFILE, gain=GAIN, duration=DURATION,
        disturbances=(PUSH,) if disturbed else (),
    )  # fmt: skip


def _timed(scenes: Any, executor: Executor | None = None, **options: Any) -> tuple[float, Any]:
    begin = time.perf_counter()
    found = cs.sweep(scenes, evaluate, executor, compiled=_compiled(), **options)
    return time.perf_counter() - begin, found


@functools.cache
def _compiled() -> bool:
    """Whether kernels are compiled here; they are, after this."""
    compiled = bool(find_compiler())
    for disturbed in (False, True):
        evaluate(cs.plan(scene(0, disturbed), compiled=compiled))
    return compiled


def exact(full: bool) -> Iterator[Bar]:
    """Scenes planned together against the exact law of slip (eq. `contracaccel`)."""
    many, t = crowd(0), np.linspace(0.0, DURATION, 11)
    states = cs.plan(many, compiled=_compiled()).states(t)
    slip = np.linalg.norm(slip_from_states(many, states), axis=2)
    lost = np.exp(-GAIN.exponent(PROFILE, t))
    law = slip[0] * (PROFILE(t) / PROFILE(0.0) * lost)[:, None]
    error = np.abs(slip - law).max() / slip.max()
    yield Bar(f"slip of {CROWD} contacts planned together, exact law", 1e-12, error)


def _rate(what: str, count: int, run: tuple[float, Any], note: str) -> Bar:
    """Scenes a second; the bar holds only if every scene has its row."""
    spent, found = run
    note = f"{1e6 * spent / count:.3g} us a scene; {note}"
    whole = len(found.table) == count
    return Bar(f"{count} {what}", 2e4, count / spent, "/s", least=True, note=note, holds=whole)


def making(full: bool) -> Iterator[Bar]:
    """Time to make one scene of new parts, with all checks, and to plan it and ask for points."""
    for name, limit, surface in (
        ("sphere", 20, lambda x: cs.Sphere(0.2 + x)),
        ("plane", 40, lambda x: cs.Plane()),
        ("cylinder", 40, lambda x: cs.Cylinder(0.2 + x)),
        ("torus", 40, lambda x: cs.Torus(0.3 + x, 0.1)),
        ("ellipsoid", 40, lambda x: cs.Ellipsoid(0.3 + x, 0.2, 0.1)),
    ):
        make = functools.partial(_new, surface)
        once = min(_pace(make, range(k, k + 500)) for k in range(0, 5000, 500))
        traced = functools.partial(_traced, make)
        points = min(_pace(traced, range(k, k + 50)) for k in range(0, 500, 50))
        note = f"all parts new; {1e6 * points:.3g} us with a plan and {POINTS} points"
        yield Bar(f"making a scene, sphere on {name}", limit, 1e6 * once, " us", note=note)


def _new(surface: Callable[[float], cs.Surface], k: int) -> cs.Scene:
    """Scene k of a sphere on a surface, of which no part was there before."""
    x = 1e-6 * k
    contact = cs.Contact(
        finger=cs.Sphere(0.04 + x),
        object_at=(1.0 + x, 0.5),
        object_velocity=(0.3, 0.2 + x),
    )
    return cs.Scene(
        object=surface(x), contacts=[contact], profile=cs.Profile([0.05 + x, 0.1]),
        gain=cs.Gain.path(200.0 + x), duration=DURATION,
    )  # fmt: skip


def _traced(make: Callable[[int], cs.Scene], k: int) -> np.ndarray:
    """Scene k made, planned, and its points at POINTS times."""
    t = np.linspace(0.0, DURATION, POINTS)
    return cs.plan(make(k), compiled=_compiled()).points(t)


def _pace(call: Callable[[int], Any], items: range) -> float:
    """Seconds a call."""
    begin = time.perf_counter()
    for k in items:
        call(k)
    return (time.perf_counter() - begin) / len(items)


def one_core(full: bool) -> Iterator[Bar]:
    """Scenes a second on one core, ready made and made on the way."""
    count = 100_000 if full else 20_000
    _compiled()
    run = min((_timed(map(scene, range(count))) for _ in range(3)), key=lambda run: run[0])
    note = "made on the way; the best of three"
    yield _rate("scenes with slip, from a generator", count, run, note)
    scenes = [scene(k) for k in range(count)]
    run = min((_timed(scenes) for _ in range(3)), key=lambda run: run[0])
    yield _rate("scenes with slip", count, run, "ready made; the best of three")
    run = _timed(map(crowd, range(count // CROWD)), chunk=2)
    yield _rate(f"contacts with slip, in scenes of {CROWD}", count, run, "made on the way")
    few = count // 4
    scenes = [scene(k, True) for k in range(few)]
    run = min((_timed(scenes) for _ in range(3)), key=lambda run: run[0])
    yield _rate("disturbed scenes", few, run, "ready made; an aim, three intervals each")


def memory(full: bool) -> Iterator[Bar]:
    """Growth of the process while streamed results go to a folder."""
    counts = (100, 1000) if full else (20, 100)
    sizes = []
    with tempfile.TemporaryDirectory() as folder:
        for k, count in enumerate((10, *counts)):
            _timed(map(crowd, range(count)), chunk=2, folder=f"{folder}/{k}")
            sizes.append(resident())
    yield Bar(f"memory, {CROWD * counts[1]} contacts after {CROWD * counts[0]}, to a folder",
              10.0, sizes[-1] - sizes[-2], "MB", detail={"sizes": sizes})  # fmt: skip


def _warm(worker: int) -> None:
    """Import and load what a worker needs, long enough that the other one gets its own call."""
    _compiled()
    time.sleep(0.5)


def two_cores(full: bool) -> Iterator[Bar]:
    """The disturbed scenes on one process and on two, one of which is killed in the middle."""
    count = 100_000 if full else 10_000
    make = [functools.partial(scene, k, True) for k in range(count)]
    _compiled()
    alone, found = _timed(make)
    truth = found.table
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        list(pool.map(_warm, range(2)))
        spent, found = _timed(make, pool)
    same = _alike(found.table, truth)
    note = f"an aim; {count / alone:.3g}/s here, {count / spent:.3g}/s on two, made by the workers"
    yield Bar(f"{count} disturbed scenes, two processes over one", 1.5, alone / spent, "x",
              least=True, note=note, holds=same)  # fmt: skip
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        list(pool.map(_warm, range(2)))
        victim = next(iter(pool._processes))
        yield _with_one_killed("processes", victim, 0.4 * spent, make, pool, truth)


def dask(full: bool) -> Iterator[Bar]:
    """The same through dask.distributed on loopback workers."""
    count = 100_000 if full else 10_000
    try:
        import distributed
    except ImportError as error:
        yield Bar("scenes lost with a killed Dask worker", 0, None, note=str(error))
        return
    make = [functools.partial(scene, k, True) for k in range(count)]
    begin = time.perf_counter()
    truth = _timed(make)[1].table
    alone = time.perf_counter() - begin
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        victim = next(iter(client.run(os.getpid).values()))
        yield _with_one_killed("Dask", victim, 0.3 * alone, make, client.get_executor(), truth)


def _alike(found: np.ndarray, truth: np.ndarray) -> bool:
    """Whether two tables are the same but for rounding: a new worker plans its first two scenes of
    a kind in another way than those after them."""
    return len(found) == len(truth) and all(
        np.allclose(found[name], truth[name], rtol=0.0, atol=1e-12)
        if truth[name].dtype.kind == "f"
        else np.array_equal(found[name], truth[name])
        for name in truth.dtype.names
    )


def _with_one_killed(
    name: str, victim: int, after: float, make: list, executor: Executor, truth: np.ndarray
) -> Bar:
    """Scenes lost, or not as they are without an accident."""
    killed: list[int] = []

    def kill() -> None:
        os.kill(victim, signal.SIGKILL)
        killed.append(victim)

    timer = threading.Timer(after, kill)
    timer.start()
    spent, found = _timed(make, executor)
    in_time = bool(killed)
    timer.cancel()
    lost = len(make) - len(np.intersect1d(found.table["scene"], truth["scene"]))
    note = f"{len(make) / spent:.3g}/s, killed after {after:.2g} of {spent:.2g} s, "
    same = _alike(found.table, truth)
    note += "the table the same" if same else "the table differs"
    return Bar(f"scenes lost of {len(make)}, one of two workers killed, {name}", 0, lost,
               note=note, holds=in_time and same)  # fmt: skip


SECTIONS = {
    "exact": exact,
    "making": making,
    "one_core": one_core,
    "memory": memory,
    "two_cores": two_cores,
    "dask": dask,
}
