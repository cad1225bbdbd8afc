"""Speed bars: planning and evaluating beside the best of other integrators.

All competitors run in this process, on one thread, in turns (scenes of many contacts on all
processors). Kernels are warm and just-in-time compilation is told apart. The peers' integrators are
built and their initial states worked out before the clock starts; so are our scenes, and others of
their kind were planned, which is when kernels are built. Compiled, the bars count scenes that were
never planned: "ready" in the notes is the time for a scene that was, and keeps where it starts.
Without a compiler they count scenes that were, whose great circles are kept; "new scene" is the
time for others.
"""

from __future__ import annotations

import itertools
import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from oracles.load import load

import contact_system as cs
from contact_system.chart_solution import initial_state
from contact_system.starts import scene_start

from . import peers
from .accuracy import arc_length, chart_points, engines, great_circle, point_error
from .peers import Method, Solver
from .report import Bar
from .timing import SLOW, Job, Timing, interleaved, least

POINTS = 400
AGAIN = ", prepared"
STARTS = 6
FINGER = cs.Sphere(0.04)
OBJECTS = {"sphere": cs.Sphere(0.1), "ellipsoid": cs.Ellipsoid(0.3, 0.2, 0.1)}
PROFILE = cs.Profile([0.001, 0.0, 0.4])


def _scene(obj: cs.Surface, gain: cs.Gain, velocity: Any = (0.2, -0.9)) -> cs.Scene:
    """One contact of K1's kind, as in tests/oracles/*_slip.json."""
    contact = cs.Contact(
        finger=FINGER, object_at=(0.7, 0.4), finger_at=(1.1, 0.2), angle=0.3,
        object_velocity=velocity,
    )  # fmt: skip
    return cs.Scene(object=obj, contacts=[contact], profile=PROFILE, gain=gain, duration=1.0)


def _states(scene: cs.Scene, t: np.ndarray, tolerance: float, compiled: bool) -> np.ndarray:
    return cs.plan(scene, tolerance=tolerance, compiled=compiled).states(t)


def _points(scene: cs.Scene, t: np.ndarray, tolerance: float, compiled: bool) -> np.ndarray:
    return cs.plan(scene, tolerance=tolerance, compiled=compiled).points(t)


def _engine(compiled: bool) -> str:
    return "compiled" if compiled else "no compiler"


# --- no slip -----------------------------------------------------------------------------------


def no_slip(full: bool) -> Iterator[Bar]:
    """A sphere rolls on a sphere: points beside heyoka in space, states beside heyoka on charts."""
    for package in ("mpmath", "heyoka"):
        if not peers.installed(package):
            yield Bar("no slip, beside heyoka", 3.0, None, "x", note=f"{package} not installed")
            return
    t = np.linspace(0.0, 1.0, POINTS)
    scenes = [_rolling_scene(k) for k in range(STARTS)]
    truths = [_rolling_truth(scene, t) for scene in scenes]
    radii, lengths = (FINGER.size, OBJECTS["sphere"].size), PROFILE.arc_length(t)
    chart = peers.heyoka_method(scenes[0], t, slip=False)
    yield from _beside(
        "points", scenes, truths, partial(_points, t=t, tolerance=1e-12), 3.0,
        lambda tolerance: peers.heyoka_great_circles(radii, lengths, tolerance), _start_in_space,
    )  # fmt: skip
    yield from _beside(
        "chart states", scenes, truths, partial(_states, t=t, tolerance=1e-12), 1.5,
        lambda tolerance: partial(chart.build(tolerance), eta=0.0), _start_on_charts,
    )  # fmt: skip


def _rolling_scene(k: int) -> cs.Scene:
    """Start number k: errors at rounding level are a matter of luck in a single one."""
    spread = np.random.default_rng(k).uniform(-0.3, 0.3, 5)
    contact = cs.Contact(
        finger=FINGER, object_at=(1.2 + spread[0], 0.4 + spread[1]), angle=0.3 + spread[2],
        finger_at=(1.5 + spread[3], 0.2 + spread[4]),
    )  # fmt: skip
    return cs.Scene(object=OBJECTS["sphere"], contacts=[contact], profile=PROFILE, duration=1.0)


def _rolling_truth(scene: cs.Scene, t: np.ndarray) -> np.ndarray:
    """Contact points in closed form: (n, 2, 3)."""
    import mpmath as mp

    contact = scene.contacts[0]
    with mp.workdps(40):
        w, psi = [mp.mpf(x) for x in contact.finger_velocity], mp.mpf(contact.angle)
        cos, sin = mp.cos(psi), mp.sin(psi)
        turned = (cos * w[0] - sin * w[1], -sin * w[0] - cos * w[1])
        bodies = ((FINGER, contact.finger_at, w), (scene.object, contact.object_at, turned))
        lengths = [arc_length(mp, scene.profile, x) for x in t]
        rows = [[great_circle(mp, b.size, at, v, s) for b, at, v in bodies] for s in lengths]
        return np.array(rows, dtype=float)


def _start_in_space(scene: cs.Scene) -> np.ndarray:
    contact, start = scene.contacts[0], scene_start(scene.contacts[0])
    rows = []
    for surface, at, w in (
        (contact.finger, contact.finger_at, start.finger_velocity),
        (scene.object, contact.object_at, start.object_velocity),
    ):
        rows += [surface.point(*at), surface.frame(*at)[:, :2] @ w]
    return np.concatenate(rows)


def _start_on_charts(scene: cs.Scene) -> np.ndarray:
    return initial_state(scene, 0, scene_start(scene.contacts[0]), 0.0)


def _beside(
    what: str,
    scenes: list[cs.Scene],
    truths: list[np.ndarray],
    ours: Callable[..., np.ndarray],
    limit: float,
    build: Callable[[float], Callable[[np.ndarray], np.ndarray]],
    start: Callable[[cs.Scene], np.ndarray],
) -> Iterator[Bar]:
    """Ours beside heyoka at the tolerance of its least error; errors: worst of the starts."""

    def worst(solve: Callable[[cs.Scene], np.ndarray]) -> float:
        errors = []
        for scene, truth in zip(scenes, truths, strict=True):
            found = solve(scene)
            points = found if found.ndim == 3 else chart_points(scene, found)
            errors.append(point_error(scene, 0, points, truth))
        return max(errors)

    solvers, errors, compilation = {}, {}, {}
    for tolerance in (1e-13, 1e-14, 1e-15, 2.3e-16):
        begin = time.perf_counter()
        solvers[tolerance] = solver = build(tolerance)
        compilation[tolerance] = time.perf_counter() - begin
        errors[tolerance] = worst(lambda scene, solver=solver: solver(start(scene)))
    chosen = min(errors, key=lambda k: errors[k])
    first = start(scenes[0])
    jobs = {"heyoka": Job(lambda _: solvers[chosen](first))}
    for compiled in engines():
        call = partial(ours, compiled=compiled)
        jobs[_engine(compiled)] = Job(call, partial(_rolling_scene, 0))
        jobs[_engine(compiled) + AGAIN] = Job(call, lambda: scenes[0])
    times = interleaved(jobs, repeats=15)
    detail = {
        "times": {k: str(v) for k, v in times.items()}, "heyoka tolerance": chosen,
        "heyoka errors": {f"{k:g}": v for k, v in errors.items()},
        "heyoka compilation [s]": compilation[chosen],
    }  # fmt: skip
    for compiled in reversed(engines()):
        own = worst(lambda scene, compiled=compiled: ours(scene, compiled=compiled)[:, 0])
        name = _engine(compiled)
        ready, new, peer = (times[k].median for k in (name + AGAIN, name, "heyoka"))
        counts, other = (new, "ready") if compiled else (ready, "new scene")
        note = (
            f"{1e6 * counts:.3g} us beside {1e6 * peer:.3g} us; errors {own:.1e} beside "
            f"{errors[chosen]:.1e}; {other} {1e6 * (ready + new - counts):.3g} us"
        )
        yield Bar(
            f"no slip, {what}, {name}", limit if compiled else 1.0, peer / counts, "x", True, note,
            own <= errors[chosen], detail,
        )  # fmt: skip


# --- slip --------------------------------------------------------------------------------------

PEAKS = {1e2: 3.0, 1e5: 10.0, 1e7: 10.0}  # greatest eta sigma^2 [1/s]: times faster
TARGETS = (1e-6, 1e-9, 1e-12)
OURS = peers.decades(1, 15)


def slip(full: bool) -> Iterator[Bar]:
    """Chart states under slip, at equal achieved error, beside the best of the peers.

    Errors are those against our plan at 1e-15, at 400 times. A bar holds only where 30-digit
    references, or the best peer where there is none, agree with it to a tenth of the error.
    """
    t = np.linspace(0.0, 1.0, POINTS)
    for kind, obj in OBJECTS.items():
        methods = _methods(_scene(obj, cs.Gain.path(1.0)), t, 20.0 if full else 1.0)
        built: dict[tuple[str, float], Solver] = {}
        for peak, limit in PEAKS.items():
            make = partial(_scene, obj, cs.Gain.path(peak / PROFILE(1.0) ** 2))
            yield from _work_precision(kind, peak, limit, make, t, methods, built)


def _methods(scene: cs.Scene, t: np.ndarray, limit: float) -> list[Method]:
    found = [peers.heyoka_method(scene, t)] if peers.installed("heyoka") else []
    return found + peers.cvodes_methods(scene, t) + peers.scipy_methods(scene, t, limit)


def _work_precision(
    kind: str,
    peak: float,
    limit: float,
    make: Callable[[], cs.Scene],
    t: np.ndarray,
    methods: list[Method],
    built: dict[tuple[str, float], Solver],
) -> Iterator[Bar]:
    """One scene: a bar for each achieved error."""
    scene = make()
    truth = cs.plan(scene, tolerance=1e-15, compiled=False).points(t)[:, 0]
    start = initial_state(scene, 0, scene_start(scene.contacts[0]), 0.0)
    runs: dict[str, tuple[Job, float, float]] = {}  # name -> job, error, s
    failures: dict[str, str] = {}
    for method in methods:
        _scan_peer(method, scene, start, truth, built, runs, failures)
    for compiled in engines():
        for tolerance in OURS:
            call = partial(_states, t=t, tolerance=tolerance, compiled=compiled)
            error = point_error(scene, 0, chart_points(scene, call(make())[:, 0]), truth)
            chosen_by = least(Job(call, make), 50)  # 5 us tell them apart
            runs[f"ours {_engine(compiled)} {tolerance:g}"] = (Job(call, make), error, chosen_by)
    check = _reference_check(kind, scene, runs)
    picked = {target: _pick(runs, target) for target in TARGETS}
    jobs = {name: runs[name][0] for names in picked.values() for name in names}
    for name in [n for n in jobs if n.startswith("ours")]:
        jobs[name + AGAIN] = Job(runs[name][0].call, lambda: scene)
    times = interleaved(jobs, repeats=7)
    for target, names in picked.items():
        name = f"slip, {kind}, peak {peak:.0e}/s, error {target:.0e}"
        yield _slip_bar(name, limit, target, names, times, runs, failures, check)


def _scan_peer(
    method: Method,
    scene: cs.Scene,
    start: np.ndarray,
    truth: np.ndarray,
    built: dict[tuple[str, float], Solver],
    runs: dict[str, tuple[Job, float, float]],
    failures: dict[str, str],
) -> None:
    """Error and time of a peer at its tolerances, until one fails or is needlessly tight."""
    for tolerance in method.tolerances:
        key = (method.name, tolerance)
        try:
            if key not in built:
                built[key] = method.build(tolerance)
            solver = built[key]
            begin = time.perf_counter()
            states = solver(start, scene.gain.value)
            elapsed = time.perf_counter() - begin
            if elapsed > method.limit:
                raise TimeoutError(f"longer than {method.limit:g} s")
            if not np.isfinite(states).all():
                raise ArithmeticError("the result is not finite")
        except (TimeoutError, ArithmeticError, ValueError, RuntimeError) as reason:
            failures[f"{method.name} {tolerance:g}"] = str(reason).strip().splitlines()[-1][-120:]
            return
        job = Job(lambda _, solver=solver: solver(start, scene.gain.value))
        error = point_error(scene, 0, chart_points(scene, states), truth)
        elapsed = elapsed if elapsed > SLOW else least(job, 3)
        runs[f"{method.name} {tolerance:g}"] = (job, error, elapsed)
        if error < 0.1 * min(TARGETS):
            return


def _pick(runs: dict[str, tuple[Job, float, float]], target: float) -> list[str]:
    """The cheapest run of each engine of ours that achieves the error, and the two best peers."""
    reached = sorted((s, name) for name, (_, error, s) in runs.items() if error <= target)
    names = []
    for compiled in engines():
        names += [name for _, name in reached if name.startswith(f"ours {_engine(compiled)}")][:1]
    return names + [name for _, name in reached if not name.startswith("ours")][:2]


def _slip_bar(
    name: str,
    limit: float,
    target: float,
    names: list[str],
    times: dict[str, Timing],
    runs: dict[str, tuple[Job, float, float]],
    failures: dict[str, str],
    check: dict[str, float],
) -> Bar:
    own = [n for n in names if n.startswith(f"ours {_engine(engines()[-1])}")]
    plain = [n for n in names if n.startswith(f"ours {_engine(False)}")]
    rivals = [n for n in names if not n.startswith("ours")]
    detail = {
        "times": {n: str(t) for n, t in times.items() if n.removesuffix(AGAIN) in names},
        "errors": {n: runs[n][1] for n in names},
        "scan [s], error": {n: [s, e] for n, (_, e, s) in runs.items()},
        "failed": failures, "reference check": check,
    }  # fmt: skip
    if not own or not rivals:
        who = "we do" if not own else "no peer does"
        note = f"{who} not reach this error" if not own else f"{who} reach this error"
        return Bar(name, limit, None, "x", True, note, detail=detail)
    rival = min(rivals, key=lambda n: times[n].median)
    mine, best = times[own[0]].median, times[rival].median
    note = f"{1e6 * mine:.3g} us beside {1e6 * best:.3g} us ({rival})"
    note += f"; ready {1e6 * times[own[0] + AGAIN].median:.3g} us"
    if engines()[-1] and plain:
        note += f"; no compiler {best / times[plain[0] + AGAIN].median:.3g} x"
    if not engines()[-1]:
        note += "; no compiler on this machine"
    off = check.get("30 digits", check["best peer"])
    note += f"; reference within {off:.0e}"
    return Bar(name, limit, best / mine, "x", True, note, off <= 0.1 * target, detail)


def _reference_check(kind: str, scene: cs.Scene, runs: dict[str, Any]) -> dict[str, float]:
    """How far the reference (our plan at 1e-15) is from independent solutions."""
    rivals = [error for name, (_, error, _) in runs.items() if not name.startswith("ours")]
    check = {"best peer": min(rivals, default=math.nan)}
    peaks = load("slip_peaks")["scenes"]
    records = load(f"{kind}_slip")["scenes"] | {
        key: record for key, record in peaks.items() if key.startswith(kind)
    }
    for record in records.values():
        law, eta = record["gain"]["law"], record["gain"]["eta"]
        if law == scene.gain.law and math.isclose(eta, scene.gain.value, rel_tol=1e-14):
            exact = scene.replace(gain=cs.Gain(law, eta))
            points = cs.plan(exact, tolerance=1e-15, compiled=False).points(record["times"])[:, 0]
            check["30 digits"] = point_error(exact, 0, points, record["contacts"][0]["points"])
    return check


# --- gain --------------------------------------------------------------------------------------


def eta(full: bool) -> Iterator[Bar]:
    """Time at eta = 1e10 over time at eta = 1; between them the cost is noted."""
    t = np.linspace(0.0, 1.0, POINTS)
    etas = [10.0**k for k in range(0, 11, 2)]
    for compiled in reversed(engines()):
        for kind, obj in OBJECTS.items():
            for law in ("path", "time"):
                call = partial(_states, t=t, tolerance=1e-12, compiled=compiled)
                jobs = {
                    f"{value:g}": Job(call, partial(_scene, obj, cs.Gain(law, value)))
                    for value in etas
                }
                times = {k: v.median for k, v in interleaved(jobs, repeats=7).items()}
                first, last, most = times["1"], times["1e+10"], max(times, key=lambda k: times[k])
                note = f"{1e6 * first:.4g} us at 1; most at {most}: {times[most] / first:.3g} x"
                name = f"eta 1e10 over 1, {kind}, law {law}, {_engine(compiled)}"
                yield Bar(name, 2.0, last / first, "x", note=note, detail=times)


# --- start -------------------------------------------------------------------------------------

START = """
import time
a = time.perf_counter()
import contact_system as cs
b = time.perf_counter()
scene = cs.load_scene("K4")
c = time.perf_counter()
plan = cs.plan(scene, compiled=False)
d = time.perf_counter()
plan.states([0.0, 1.0, 4.0])
print(b - a, c - b, d - c, time.perf_counter() - d)
"""


def start(full: bool) -> Iterator[Bar]:
    """Import and the first plan of K4, each in a fresh process."""
    root = Path(__file__).parents[1]
    rows = []
    for _ in range(6):  # the first one warms the file cache
        done = subprocess.run(
            [sys.executable, "-c", START], cwd=root, env=os.environ, capture_output=True, text=True
        )
        if done.returncode:
            raise RuntimeError(done.stderr)
        rows.append([float(x) for x in done.stdout.split()])
    columns = list(zip(*rows[1:], strict=True))
    imported, loaded, planned, evaluated = (statistics.median(column) for column in columns)
    spread = [f"{min(c):.3g} to {max(c):.3g} s" for c in columns]
    yield Bar("import contact_system", 0.6, imported, "s", note=spread[0])
    note = f"{spread[2]}; reading the scene {loaded:.3g} s, first states {evaluated:.3g} s"
    yield Bar("first plan of K4, no compiler", 0.15, planned, "s", note=note)


# --- many contacts -----------------------------------------------------------------------------

COUNTS = (1, 10, 100, 1000)
KINDS = (("sphere", False), ("sphere", True), ("ellipsoid", False), ("ellipsoid", True))


def many(full: bool) -> Iterator[Bar]:
    """Contacts of one kind in one scene beside Python loops over scenes of one contact.

    A scene of many contacts is evaluated on all processors, as users have it; the note tells of one
    thread. In the loop all scenes are of one kind: compiled, they are planned by numbers as well.
    The note tells of a loop that plans every scene in full, each having a gain of its own. Twice:
    with the scenes made before, and from a list of contacts, where both have to make them.
    """
    t = np.linspace(0.0, 1.0, 100)
    for compiled in reversed(engines()):
        counts = COUNTS if compiled or full else COUNTS[:-1]
        for kind, slips in KINDS:
            call = partial(_states, t=t, tolerance=1e-12, compiled=compiled)
            most = counts[-1]
            jobs = {str(n): Job(_unpinned(call), partial(_crowd, kind, slips, n)) for n in counts}
            jobs["one thread"] = Job(call, partial(_crowd, kind, slips, most))
            for loop, step in (("loop", 1e-6), ("loop, one kind", 0.0)):
                jobs[loop] = Job(
                    lambda scenes, call=call: [call(scene) for scene in scenes],
                    lambda kind=kind, slips=slips, n=most, step=step: _loop(kind, slips, n, step),
                )
            crowd = partial(_crowd, kind, slips, most)
            jobs["made"] = Job(_unpinned(lambda s, call=call: call(_made(s, s.contacts))), crowd)
            jobs["loop, made"] = Job(
                lambda s, call=call: [call(_made(s, [contact])) for contact in s.contacts], crowd
            )
            times = {k: v.median for k, v in interleaved(jobs, repeats=5).items()}
            growth = [times[str(10 * n)] / (10 * times[str(n)]) for n in counts[:-1]]
            name = f"{kind}, {'slip' if slips else 'no slip'}, {_engine(compiled)}"
            each = ", ".join(f"{1e6 * times[str(n)] / n:.3g}" for n in counts)
            note = f"us a contact for {', '.join(map(str, counts))}: {each}"
            bar = f"time of 10 x contacts over 10 x time, {name}"
            yield Bar(bar, 1.0, max(growth), note=note, detail=times)
            whole, alike, alone = (times[k] for k in ("loop", "loop, one kind", "one thread"))
            note = f"loop {1e6 * alike / most:.3g} us a contact; planned in full "
            note += f"{1e6 * whole / most:.3g} us, {whole / times[str(most)]:.3g} x; on one thread "
            note += f"{1e6 * alone / most:.3g} us, {alike / alone:.3g} x"
            ratio = alike / times[str(most)]
            yield Bar(f"{most} contacts beside a loop, {name}", 5.0, ratio, "x", True, note)
            whole, loop = times["made"], times["loop, made"]
            note = f"{1e6 * whole / most:.3g} us a contact beside {1e6 * loop / most:.3g} us"
            bar = f"{most} contacts, scenes made on the way, beside a loop, {name}"
            yield Bar(bar, 5.0, loop / whole, "x", True, note)


def _unpinned(call: Callable[[cs.Scene], np.ndarray]) -> Callable[[cs.Scene], np.ndarray]:
    """The same on all processors: the bench leaves one thread to every competitor."""

    def run(scene: cs.Scene) -> np.ndarray:
        pinned = os.environ.pop("OMP_NUM_THREADS", None)
        try:
            return call(scene)
        finally:
            if pinned is not None:
                os.environ["OMP_NUM_THREADS"] = pinned

    return run


_OWN = itertools.count(1)


def _loop(kind: str, slips: bool, count: int, step: float) -> list[cs.Scene]:
    """Scenes of one contact; gains grow by ``step``, and no two lists have one in common."""
    whole = _crowd(kind, slips, count)
    return [
        whole.replace(contacts=[contact], gain=cs.Gain.time(20.0 + step * next(_OWN)))
        for contact in whole.contacts
    ]


def _made(scene: cs.Scene, contacts: Sequence[cs.Contact]) -> cs.Scene:
    """A scene like this one."""
    return cs.Scene(
        object=scene.object, contacts=contacts, profile=scene.profile, gain=scene.gain,
        duration=scene.duration,
    )  # fmt: skip


def _crowd(kind: str, slips: bool, count: int) -> cs.Scene:
    """A scene of many contacts."""
    random = np.random.default_rng(count)
    contacts = []
    for u, v, angle, a, b in random.uniform(-0.3, 0.3, (count, 5)):
        velocity = (0.2 + a, -0.9 + b) if slips else "rolling"
        contacts.append(
            cs.Contact(
                finger=FINGER,
                object_at=(0.9 + u, 0.4 + v),
                finger_at=(1.3 + v, 0.2),
                angle=angle,
                object_velocity=velocity,
            )  # fmt: skip
        )
    return cs.Scene(
        object=OBJECTS[kind], contacts=contacts, profile=PROFILE, gain=cs.Gain.time(20.0),
        duration=1.0,
    )  # fmt: skip


SECTIONS = {"no slip": no_slip, "slip": slip, "eta": eta, "start": start, "many": many}
