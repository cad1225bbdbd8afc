"""The planner as an FMU: exact, small, quick, the same everywhere, and robust.

FMUs are compared with `plan()`, and on other machines (wine, qemu) with this one; random calls run
under sanitizers. If a tool is missing, its bars are not measured, and notes say what to install.
"""

from __future__ import annotations

import ctypes
import itertools
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmu_hosts import EVERYTHING, importers, native
from fmu_hosts.blocks import columns, exported
from fmu_hosts.native import Fmu, Program, Unavailable

import contact_system as cs
from fmu_export import variable_table

from .fmu_peer import build_peer
from .report import Bar, Sections
from .timing import Job, in_new_process, interleaved

VERSIONS = ("2.0", "3.0")
KINEMATIC = ("K1", "K2", "K3", "K4")
SCENES = cs.bundled_scenes()
STEPS = (1e-4, 1e-2, 0.3)
TARGETS = ("x86_64-windows", "aarch64-linux")
STEP, COUNT = 1e-3, 1000
Array = np.ndarray

scene_of = cache(cs.load_scene)
plan_of = cache(lambda name: cs.plan(scene_of(name)))


def fmu_of(scene: cs.Scene, version: str, *platforms: str, **options: Any) -> Fmu:
    """The exported FMU of a scene, unpacked."""
    return exported(scene, version, **({"platforms": platforms} if platforms else {}), **options)


def _cut(fmu: Fmu, names: Sequence[str], step: float, count: int) -> Array:
    """Values of names after each step, which is made of up to nine steps of random lengths."""
    slave, random, rows, t = _begun(fmu), np.random.default_rng(4), [], 0.0
    get = slave.getReal if fmu.version == "2.0" else slave.getFloat64
    for k in range(count):
        cuts = random.uniform(k * step, (k + 1) * step, random.integers(9))
        for stop in [*np.sort(cuts), (k + 1) * step]:
            slave.doStep(t, stop - t)
            t = stop
        rows.append(get(importers.references_of(fmu, names)))
    slave.freeInstance()
    return np.array(rows)


def cosimulation(full: bool) -> Iterator[Bar]:
    """K1 to K4 stepped by fmpy with steps of all sizes, against the plan."""
    for version in VERSIONS:
        for step, run in (*((step, importers.fmpy_steps) for step in STEPS), (0.05, _cut)):
            worst = 0.0
            for scene in map(scene_of, KINEMATIC):
                given = run, fmu_of(scene, version), scene, int(scene.duration / step), step
                worst = max(worst, importers.off_plan(*given))
            how = "cut at random" if run is _cut else f"of {step:g} s"
            yield Bar(f"FMI {version}, steps {how}: off plan()", 1e-12, worst)


def euler(full: bool) -> Iterator[Bar]:
    """Model Exchange of all scenes by Euler's method at their FMUs' default steps."""
    worst, orders = {}, {}
    for name in SCENES:
        scene = scene_of(name)
        fmu = fmu_of(scene, "2.0")
        step = float(fmu.description.defaultExperiment.stepSize)
        errors = []
        # the order shows over a short path: over a long one the error is as large as the bodies
        for part, end in ((1, 1.0), (16, 0.02), (32, 0.02)):
            try:
                errors.append(_by_euler(fmu, scene, step / part, end * scene.duration))
            except FMICallException:
                errors.append(np.inf)
        worst[name] = errors[0]
        if errors[2] > 1e-15:  # H1 to H4 begin at rest
            orders[name] = np.log2(errors[1] / errors[2])
    discarded = [name for name, error in worst.items() if not np.isfinite(error)]
    note = ", ".join(f"{n} {worst[n]:.0e}, order {order:.2g}" for n, order in orders.items())
    yield Bar("Model Exchange by Euler: scenes that are discarded", 0, len(discarded), note=note)


def _by_euler(fmu: Fmu, scene: cs.Scene, step: float, end: float) -> float:
    """How far the contact points are off the plan at the time ``end``, m."""
    contacts = range(1, len(scene.contacts) + 1)
    points = [f"contact[{i}].{side}.point" for i in contacts for side in ("finger", "object")]
    names = [f"{point}.{axis}" for point in points for axis in "xyz"]
    end = step * max(1, round(end / step))
    steps = {"step_size": step, "output_interval": step, "stop_time": end}
    given = {"fmi_type": "ModelExchange", "solver": "Euler"} | steps
    result = fmpy.simulate_fmu(str(fmu.path), output=names, **given)
    found = np.array([result[name][-1] for name in names])
    return float(np.abs(found - plan_of(scene.name).points(end)[0].ravel()).max())


def resynchronizing(full: bool) -> Iterator[Bar]:
    """Go on from measured values, K1 to K4: one call of setReal, and the next step."""
    for measured in ("states", "pose"):
        worst, spent = 0.0, []
        for name in KINEMATIC:
            for off, us in _resynchronized(scene_of(name), measured):
                worst = max(worst, off)
                spent.append(us)
        what = {"states": "states", "pose": "pose and twist"}[measured]
        yield Bar(f"resynchronised by {what}, K1 to K4, off plan().restart", 1e-12, worst)
        note = "one setReal, and a step of 1 ms"
        yield Bar("the same, a contact", 10.0, float(np.median(spent)), "us", note=note)


def _resynchronized(scene: cs.Scene, measured: str) -> Iterator[tuple[float, float]]:
    """After steps from measured values: how far states are off, and time per contact, us."""
    plan, rest, trigger = cs.plan(scene, 1e-14), 1e-3, itertools.count(1.0)
    fmu, table = fmu_of(scene, "2.0", measured=measured), variable_table(scene, measured=measured)
    rows = [v for v in table.rows if ".measured." in v.name]
    references = (ctypes.c_uint * len(rows))(*(v.reference for v in rows))
    random, slave = np.random.default_rng(3), _begun(fmu)
    asked = [table[n].reference for i in range(3) for n in columns(i) if not n.startswith("der(")]
    kept = slave.getFMUstate()
    for _ in range(10):
        start = random.uniform(0.15, 0.8) * scene.duration
        slave.setFMUstate(kept)
        slave.doStep(0.0, start)
        other = plan.restart(start, plan.states(start)[0] + 1e-3 * random.standard_normal((3, 9)))
        times = start + rest * np.arange(11)  # a tracker measures at every step
        rotation, position = other.pose(times)[:, :, :3, :3], other.pose(times)[:, :, :3, 3]
        motion = [other.twist(times), rotation.reshape(11, 3, 9), position]
        parts = motion if measured == "pose" else [other.states(times)]
        for t, *given in zip(times[:-1], *parts):
            numbers = np.hstack([np.full((3, 1), next(trigger)), *given]).ravel()
            values = (ctypes.c_double * len(rows))(*numbers)
            began = time.perf_counter()
            slave.fmi2SetReal(slave.component, references, len(rows), values)
            slave.fmi2DoStep(slave.component, t, rest, 1)
            spent = 1e6 * (time.perf_counter() - began) / 3
            wanted = other.states(t + rest)[0]
            found = np.array(slave.getReal(asked)).reshape(3, 5)
            yield float(np.abs(found - wanted[:, [0, 1, 4, 5, 8]]).max()), spent
    slave.freeInstance()


def other_importers(full: bool) -> Iterator[Bar]:
    """Scenes stepped and integrated by all importers, at the tolerances of their files."""
    for version in VERSIONS:
        kinds = {"steps": (importers.STEPPING, 1e-12), "integrates": (importers.INTEGRATING, 1e-7)}
        for kind, (names, bar) in kinds.items():
            for name in names:
                yield _imported(f"{name}_{kind}", version, bar)
    yield _imported("wasm_steps", "3.0", 1e-13, "wasm32")


def _imported(run: str, version: str, bar: float, *platforms: str) -> Bar:
    """K4; with CVode also long paths; with CasADi, without windows but with slip at the start."""
    scenes, what = [scene_of("K4")], f"FMI {version}, {run.replace('_', ' ')}: off plan()"
    if run == "fmpy_integrates":
        scenes = [scene_of(name) for name in (*KINEMATIC, "D1", "D2", "D3")]
    if run.startswith("casadi"):
        still = [replace(contact, object_velocity="rest") for contact in scenes[0].contacts]
        scenes = [scenes[0].replace(disturbances=[], contacts=still)]
    try:
        files, steps = (fmu_of(s, version, *platforms) for s in scenes), 256
        given = ((fmu, s, steps, s.duration / steps) for fmu, s in zip(files, scenes))
        off = [importers.off_plan(getattr(importers, run), *one) for one in given]
    except Unavailable as error:
        return Bar(what, bar, None, note=str(error))
    note = ", ".join(f"{s.name} {x:.1e}" for s, x in zip(scenes, off))
    return Bar(what, bar, max(off), note=note)


def platforms(full: bool) -> Iterator[Bar]:
    """The same FMU under wine and qemu, against this machine."""
    for target, version in itertools.product(TARGETS, VERSIONS):
        what = f"{target}, FMI {version}, K1 to K4: off this machine"
        try:
            yield Bar(what, 1e-14, max(_off_host(name, version, target) for name in KINEMATIC))
        except Unavailable as error:
            yield Bar(what, 1e-14, None, note=str(error))


def _off_host(name: str, version: str, target: str) -> float:
    fmu = fmu_of(scene_of(name), version, "native", *TARGETS)
    step = repr(scene_of(name).duration / 100)
    arguments = (step, "100", *fmu.model_arguments(fmu.outputs))
    runs = [Program("trajectory", fmu, t).table(*arguments) for t in (target, "native")]
    return native.difference(fmu.outputs, *runs)


def _states(fmu: Fmu) -> list[Any]:
    """The output variables of K1's three contacts that are states of `Plan.states`."""
    names = {name for i in range(3) for name in columns(i)}
    return [v for v in fmu.outputs if v.name in names]


def speed(full: bool) -> Iterator[Bar]:
    """Steps of 1 ms of K1's three contacts in a loop in C; values are computed when read."""
    for version in VERSIONS:
        fmu, ns = fmu_of(scene_of("K1"), version), {}
        what = f"FMI {version}, loop in C: doStep of 1 ms, a contact"
        try:
            program = Program("endurance", fmu)
        except Unavailable as error:
            yield Bar(what, 2.0, None, "us", note=str(error))
            continue
        for read, variables in (("its 9 states", _states(fmu)), ("all its outputs", fmu.outputs)):
            arguments = (STEP, COUNT, 15, *fmu.model_arguments(variables))
            alone, ns[read] = 1e3 * np.median(program.table("time", *arguments), axis=0) / 3
        note = ", ".join(f"{read} read: {found:.0f} ns" for read, found in ns.items())
        yield Bar(what, 2.0, alone / 1e3, "us", note=note)


def _begun(fmu: Fmu) -> Any:
    """An instance in fmpy, initialized."""
    slave = fmu.instance()
    if fmu.version == "2.0":
        slave.setupExperiment()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave


def _run(slave: Any, read: Callable[[], Any] = lambda: None) -> None:
    """Simulate a second in steps of 1 ms."""
    for k in range(COUNT):
        slave.doStep(k * STEP, STEP)
        read()


def _job(fmu: Fmu, variables: Sequence[Any]) -> Job:
    """A second of a new instance in fmpy, with the values of some variables after each step."""
    references = [v.valueReference for v in variables]

    def call(slave: Any) -> None:
        get = slave.getReal if fmu.version == "2.0" else slave.getFloat64
        _run(slave, *([partial(get, references)] if references else []))
        slave.freeInstance()

    return Job(call, partial(_begun, fmu))


def pythonfmu(full: bool) -> Iterator[Bar]:
    """Steps through fmpy, compared with an FMU of pythonfmu, also with all states read each time.

    Reading takes mostly fmpy's own time: it makes two C arrays and a list for every call.
    """
    kept, scene = tempfile.TemporaryDirectory(prefix="benchmarks-"), scene_of("K1")
    place = Path(kept.name)
    fmus = {f"FMI {version}": fmu_of(scene, version) for version in VERSIONS}
    path = build_peer(scene, plan_of("K1").states(0.0)[0], place)
    fmus["pythonfmu"] = peer = Fmu.unpacked(path, place / "unpacked")
    jobs = {}
    for name, fmu in fmus.items():
        jobs[f"{name}, doStep"] = _job(fmu, ())
        states = fmu.outputs if fmu is peer else _states(fmu)
        jobs[f"{name}, doStep and 27 states"] = _job(fmu, states)
    us = {name: 1e6 * time / COUNT for name, time in interleaved(jobs, 15 if full else 7).items()}
    off = f"which ends {_peer_error(peer):.0e} off plan()"
    for what, limit in (("doStep", 10.0), ("doStep and 27 states", None)):
        for version in VERSIONS:
            own, other = us[f"FMI {version}, {what}"], us[f"pythonfmu, {what}"]
            note = f"{own:.3g} us against {other:.3g} us, {off}"
            name = f"through fmpy, FMI {version}, {what}: over pythonfmu"
            yield Bar(name, limit, other / own, "x", True, note)


def _peer_error(fmu: Fmu) -> float:
    """How far pythonfmu's states are off the plan after a second, over the greatest state."""
    slave = _begun(fmu)
    _run(slave)
    found = np.array(slave.getReal([v.valueReference for v in fmu.outputs])).reshape(3, 9)
    slave.freeInstance()
    wanted = plan_of("K1").states(COUNT * STEP)[0]
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


EXPORT = """
import json, sys, time
import contact_system as cs
from fmu_export import export_fmu
scene, spent = cs.load_scene(sys.argv[1]), []
for _ in range(6):
    began = time.perf_counter()
    export_fmu(scene, sys.argv[2], sys.argv[3])
    spent.append(time.perf_counter() - began)
print(json.dumps([spent[0], sorted(spent[1:])[2]]))
"""


def package(full: bool) -> Iterator[Bar]:
    """Size of the files; time of an export in a new process."""
    made = {f"{n} {v}": fmu_of(scene_of(n), v) for n in SCENES for v in VERSIONS}
    sizes = {name: fmu.path.stat().st_size / 1e3 for name, fmu in made.items()}
    yield Bar("greatest FMU for one platform", 600.0, max(sizes.values()), "kB")
    kept, times = tempfile.TemporaryDirectory(prefix="benchmarks-"), {}
    path = str(Path(kept.name) / "timed.fmu")
    for name, version in (("K1", "2.0"), ("K4", "3.0"), ("D1", "3.0")):
        spent = [in_new_process(EXPORT, name, path, version) for _ in range(3)]
        times[f"{name} {version}"] = np.median(spent, axis=0).tolist()
    for k, (which, bar) in enumerate((("first", 0.3), ("later", 0.05))):
        own = {name: spent[k] for name, spent in times.items()}
        note = ", ".join(f"{name} {seconds:.2g} s" for name, seconds in own.items())
        yield Bar(f"export, {which}, slowest of K1, K4, D1", bar, max(own.values()), "s", note=note)


def fuzz(full: bool) -> Iterator[Bar]:
    """10 000 sequences of random calls and 10 000 damaged states under sanitizers.

    full: so many in every FMU. Measured states or poses are among the inputs.
    """
    scenes = (scene_of("K2"), scene_of("K4"), EVERYTHING)
    count = 10_000 if full else -(-10_000 // (len(scenes) * len(VERSIONS)))
    for seed, (scene, version) in enumerate(itertools.product(scenes, VERSIONS)):
        what = f"{scene.name}, FMI {version}: {count} sequences, damaged states: findings"
        fmu = fmu_of(scene, version, measured=("states", "pose")[seed % 3 > 0])
        try:
            program = Program("fuzz", fmu, sanitized=True)
            printed = program.run(count, count, seed, *fmu.model_arguments(), timeout=3600.0)
        except Unavailable as error:
            yield Bar(what, 0, None, note=str(error))
        except (AssertionError, subprocess.TimeoutExpired) as error:
            yield Bar(what, 0, 1, note=str(error)[:200].replace("\n", " "))
        else:
            made, granted, slowest, call = printed.split()
            note = f"{made} calls, {granted} legal; slowest {slowest} s, {call}"
            yield Bar(what, 0, 0, note=note)


def endurance(full: bool) -> Iterator[Bar]:
    """A million steps, with all values read: allocations in steps, growth of heap and process."""
    for version in VERSIONS:
        fmu = fmu_of(EVERYTHING, version)
        what = f"FMI {version}, a million steps: calls of the allocator in steps"
        try:
            program = Program("endurance", fmu)
        except Unavailable as error:
            yield Bar(what, 0, None, note=str(error))
            continue
        found = program.table("memory", STEP, COUNT, 1000, *fmu.model_arguments())
        inside, heap, process = found[0]
        yield Bar(what, 0, inside, note=f"heap and process grow by {heap:g} and {process:g} bytes")


SECTIONS: Sections = {
    "cosimulation": cosimulation,
    "euler": euler,
    "resynchronizing": resynchronizing,
    "importers": other_importers,
    "platforms": platforms,
    "speed": speed,
    "pythonfmu": pythonfmu,
    "package": package,
    "fuzz": fuzz,
    "endurance": endurance,
}
