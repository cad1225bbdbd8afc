"""The planner as an FMU: exact, small, quick, the same everywhere, and not to be broken.

Truth is `plan()`, fmpy's validation, other importers, other machines (wine, qemu) and sanitizers.
A tool that is missing leaves its bars unmeasured, and the note says what to install.
"""

from __future__ import annotations

import functools
import itertools
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from fmu_hosts import EVERYTHING, importers, native
from fmu_hosts.native import Fmu, Program, Unavailable

import contact_system as cs
from contact_system.scene import Scene
from fmu_export import export_fmu, variable_table
from fmu_export.build import library
from fmu_export.slave import in_process

from .fmu_peer import build_peer
from .report import Bar
from .timing import Job, interleaved

VERSIONS = ("2.0", "3.0")
KINEMATIC = ("K1", "K2", "K3", "K4")
SCENES = (*KINEMATIC, "D1", "D2", "D3", "C1", "C2")
STEPS = (1e-4, 1e-2, 0.3)
TARGETS = ("x86_64-windows", "aarch64-linux")
SPEED_STEP, SPEED_COUNT = 1e-3, 1000
_KEPT = tempfile.TemporaryDirectory(prefix="fmu-benchmarks-", ignore_cleanup_errors=True)


def fmu_of(scene: str | Scene, version: str, *platforms: str) -> Fmu:
    """The exported FMU of a scene, unpacked."""
    return _exported(cs.load_scene(scene) if isinstance(scene, str) else scene, version, *platforms)


@functools.cache
def _exported(scene: Scene, version: str, *platforms: str) -> Fmu:
    folder = Path(tempfile.mkdtemp(dir=_KEPT.name))
    path = folder / f"{scene.name}.fmu"
    export_fmu(scene, path, version, platforms=platforms or ("native",))
    return Fmu.unpacked(path, folder / "unpacked")


plan_of = functools.cache(lambda name: cs.plan(cs.load_scene(name)))


# --- against plan() ------------------------------------------------------------------------------


def planned(name: str, t: np.ndarray) -> dict[str, np.ndarray]:
    """Name of a quantity -> (n_times, size), in the order of the variables."""
    plan, found = plan_of(name), {}
    states, slip, twist, pose, points = (
        getattr(plan, what)(t) for what in ("states", "slip", "twist", "pose", "points")
    )
    for i in range(len(plan.scene.contacts)):
        c = f"contact[{i + 1}]."
        for k, side in enumerate(("finger", "object")):
            for j, axis in enumerate("uv"):
                found[f"{c}{side}.{axis}"] = states[:, i, 4 * k + j, None]
                found[f"der({c}{side}.{axis})"] = states[:, i, 4 * k + 2 + j, None]
            found[f"{c}{side}.point"] = points[:, i, k]
        found |= {
            f"{c}angle": states[:, i, 8, None],
            f"{c}slip": slip[:, i],
            f"{c}twist.angular": twist[:, i, :3],
            f"{c}twist.linear": twist[:, i, 3:],
            f"{c}pose.rotation": pose[:, i, :3, :3].reshape(len(t), 9),
            f"{c}pose.position": pose[:, i, :3, 3],
        }
    return found


def off_plan(name: str, t: np.ndarray, found: dict[str, np.ndarray]) -> float:
    """Greatest difference from the plan, of the size of the quantity."""
    worst = 0.0
    for quantity, wanted in planned(name, np.minimum(t, plan_of(name).scene.duration)).items():
        size = max(np.abs(wanted).max(), 1e-3)
        worst = max(worst, np.abs(found[quantity] - wanted).max() / size)
    return worst


def simulated(name: str, version: str, **options: Any) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times and quantities of ``fmpy.simulate_fmu``."""
    fmu, scene = fmu_of(name, version), cs.load_scene(name)
    given = {"filename": str(fmu.folder), "model_description": fmu.description}
    given |= {"fmi_type": "CoSimulation", "stop_time": scene.duration} | options
    result = fmpy.simulate_fmu(**given)
    table, t = variable_table(scene), result["time"]
    found = {}
    for quantity in planned(name, t[:1]):
        if version == "3.0":
            found[quantity] = result[quantity].reshape(len(t), -1)
        else:
            elements = table[quantity].elements or (quantity,)
            found[quantity] = np.stack([result[e] for e in elements], axis=1)
    return t, found


def initialize(slave: FMU2Slave | FMU3Slave) -> None:
    """Through initialization mode, from t = 0."""
    if isinstance(slave, FMU2Slave):
        slave.setupExperiment()
    slave.enterInitializationMode()
    slave.exitInitializationMode()


def stepped(name: str, version: str, times: Sequence[float]) -> dict[str, np.ndarray]:
    """Quantities where fmpy's slave was stepped to by hand."""
    slave, table = fmu_of(name, version).instance(), variable_table(cs.load_scene(name))
    rows = [table[quantity] for quantity in planned(name, np.zeros(1))]
    references = [r for row in rows for r in range(row.reference, row.reference + row.size)]
    initialize(slave)
    seen = []
    for k, t in enumerate(times):
        if k:
            slave.doStep(times[k - 1], t - times[k - 1])
        if version == "2.0":
            seen.append(slave.getReal(references))
        else:
            seen.append(slave.getFloat64([row.reference for row in rows], len(references)))
    slave.freeInstance()
    values = np.array(seen)
    ends = np.cumsum([0, *(row.size for row in rows)])
    return {row.name: values[:, a:b] for row, a, b in zip(rows, ends, ends[1:])}


def random_times(duration: float) -> np.ndarray:
    """Steps from micrometres of path to most of the horizon."""
    random = np.random.default_rng(4)
    steps = 10 ** random.uniform(-5, -0.3, 400)
    times = np.cumsum(np.concatenate([[0.0], steps]))
    return np.append(times[times < duration], duration)


def cosimulation(full: bool) -> Iterator[Bar]:
    """K1 to K4 stepped by fmpy with steps of all sizes, against the plan."""
    for version in VERSIONS:
        for step in STEPS:
            worst = {}
            for name in KINEMATIC:
                t, found = simulated(name, version, step_size=step, output_interval=step)
                worst[name] = off_plan(name, t, found)
            yield Bar(f"FMI {version}, steps of {step:g} s: off plan()", 1e-12,
                      max(worst.values()), detail=worst)  # fmt: skip
        worst = {}
        for name in KINEMATIC:
            times = random_times(plan_of(name).scene.duration)
            worst[name] = off_plan(name, times, stepped(name, version, times))
        yield Bar(f"FMI {version}, random steps: off plan()", 1e-12, max(worst.values()),
                  detail=worst)  # fmt: skip


def model_exchange(full: bool) -> Iterator[Bar]:
    """K1 to K4 integrated by fmpy's CVode at 1e-10, against the plan."""
    for version in VERSIONS:
        worst = {}
        for name in KINEMATIC:
            t, found = simulated(
                name, version, fmi_type="ModelExchange", solver="CVode", relative_tolerance=1e-10,
                step_size=0.02, output_interval=0.02, record_events=False,
            )  # fmt: skip
            worst[name] = off_plan(name, t, found)
        yield Bar(f"FMI {version}, Model Exchange, CVode at 1e-10: off plan()", 1e-7,
                  max(worst.values()), detail=worst)  # fmt: skip


def slave(full: bool) -> Iterator[Bar]:
    """The in-process slave against the FMU."""
    for version in VERSIONS:
        worst = {}
        for name in KINEMATIC:
            for step in (0.01, 0.3):
                options = {"step_size": step, "output_interval": step}
                _, wanted = simulated(name, version, **options)
                with in_process(cs.load_scene(name), version) as given:
                    _, found = simulated(name, version, **options, **given)
                worst[f"{name}, {step:g} s"] = max(
                    np.abs(found[q] - wanted[q]).max() / max(np.abs(wanted[q]).max(), 1e-3)
                    for q in wanted
                )
        yield Bar(f"FMI {version}: in-process slave off the FMU", 1e-13, max(worst.values()),
                  detail=worst)  # fmt: skip


# --- other tools ---------------------------------------------------------------------------------


def validation(full: bool) -> Iterator[Bar]:
    """Messages of fmpy's validation for all scenes of the paper."""
    said = {f"{n} {v}": validate_fmu(str(fmu_of(n, v).path)) for n in SCENES for v in VERSIONS}
    yield Bar(f"fmpy's validation of {len(said)} FMUs: messages", 0, sum(map(len, said.values())),
              detail=said)  # fmt: skip


def _measured(what: str, limit: float, measure: Callable[[], float]) -> Bar:
    """A bar, unmeasured where a tool is missing."""
    try:
        return Bar(what, limit, measure())
    except (Unavailable, ImportError) as error:
        return Bar(what, limit, None, note=str(error))


def other_importers(full: bool) -> Iterator[Bar]:
    """ecos and libcosim against fmpy; CasADi's Jacobians against the kernels' and differences."""
    runs = [("ecos", importers.with_ecos, v) for v in VERSIONS]
    runs.append(("libcosim", importers.with_libcosim, "2.0"))
    for tool, run, version in runs:
        what = f"{tool}, FMI {version}, K1 to K4: off fmpy's trajectory"
        yield _measured(what, 1e-12, functools.partial(_off_fmpy, run, version))
    for version in VERSIONS:
        note = "scalars: CasADi knows no arrays of FMI 3" if version == "3.0" else ""
        found = [_jacobians(name, version, r) for name in KINEMATIC for r in ("ode", "y")]
        exact, differences = (max(column) for column in zip(*found))
        yield Bar(f"CasADi, FMI {version}: Jacobian off the kernels' own", 1e-12, exact, note=note)
        yield Bar(f"CasADi, FMI {version}: Jacobian off central differences", 1e-6, differences)


def _off_fmpy(run: Callable[..., np.ndarray], version: str) -> float:
    worst, count = 0.0, 128
    for name in KINEMATIC:
        fmu = fmu_of(name, version)
        step = cs.load_scene(name).duration / count  # a power of two: sums of it are exact
        scalars = [v for v in fmu.outputs if not v.dimensions]
        arguments = fmu, [v.name for v in scalars], step, count
        found, wanted = run(*arguments), importers.with_fmpy(*arguments)
        worst = max(worst, native.difference(scalars, found, wanted))
    return worst


def _jacobians(name: str, version: str, result: str) -> tuple[float, float]:
    """CasADi's Jacobian of an FMU off the exact one and off differences, of its greatest entry."""
    scene, table = cs.load_scene(name), variable_table(cs.load_scene(name))
    with tempfile.TemporaryDirectory() as folder:
        f, arguments, results = importers.casadi_function(
            fmu_of(name, version), result, Path(folder)
        )
    columns, rows = ([table[n].reference for n in names] for names in (arguments, results))
    values = table.start_values
    values[columns] += 0.1 * np.random.default_rng(3).standard_normal(len(columns))
    exact = importers.kernel_jacobian(scene, values)[np.ix_(rows, columns)]
    point, at = values[columns], [f.size1_in(0)]
    parts = f.jacobian()(*np.split(point, at), f(*np.split(point, at)))
    found = np.hstack([part.full() for part in parts])
    sides = [
        [f(*np.split(point + sign * step, at)).full().ravel() for step in 1e-6 * np.eye(len(point))]
        for sign in (1, -1)
    ]
    differences = (np.array(sides[0]) - np.array(sides[1])).T / 2e-6
    size = np.abs(exact).max()
    return np.abs(found - exact).max() / size, np.abs(found - differences).max() / size


def platforms(full: bool) -> Iterator[Bar]:
    """The same FMU under wine and qemu, against this machine."""
    for target in TARGETS:
        for version in VERSIONS:
            what = f"{target}, FMI {version}, K1 to K4: off this machine"
            yield _measured(what, 1e-14, functools.partial(_off_host, version, target))


def _off_host(version: str, target: str) -> float:
    worst = 0.0
    for name in KINEMATIC:
        fmu = fmu_of(name, version, "native", *TARGETS)
        step = cs.load_scene(name).duration / 100
        arguments = (repr(step), "100", *fmu.model_arguments(fmu.outputs))
        found, wanted = (
            Program("trajectory", fmu, t).table(*arguments) for t in (target, "native")
        )
        worst = max(worst, native.difference(fmu.outputs, found, wanted))
    return worst


# --- speed and size ------------------------------------------------------------------------------


def _run(slave: FMU2Slave | FMU3Slave, read: Callable[[], Any] | None) -> None:
    for k in range(SPEED_COUNT):
        slave.doStep(k * SPEED_STEP, SPEED_STEP)
        if read is not None:
            read()


def _fmpy_job(fmu: Fmu, names: Sequence[str]) -> Job:
    """A second in steps of 1 ms by a new instance; with the values of some variables after each."""
    references = [v.valueReference for v in fmu.description.modelVariables if v.name in names]

    def make() -> FMU2Slave | FMU3Slave:
        slave = fmu.instance()
        initialize(slave)
        return slave

    def call(slave: FMU2Slave | FMU3Slave) -> None:
        get = slave.getReal if fmu.version == "2.0" else slave.getFloat64
        _run(slave, functools.partial(get, references) if references else None)
        slave.freeInstance()

    return Job(call, make)


def _states(contacts: int) -> list[str]:
    names = []
    for i in range(contacts):
        for side in ("finger", "object"):
            own = [f"contact[{i + 1}].{side}.{axis}" for axis in "uv"]
            names += [*own, *(f"der({n})" for n in own)]
        names.append(f"contact[{i + 1}].angle")
    return names


def speed(full: bool) -> Iterator[Bar]:
    """Steps of 1 ms of K1's three contacts: a loop in C, fmpy, and pythonfmu beside them.

    A step of the FMU puts off what nobody asks for, one of pythonfmu cannot; so both are timed with
    all states read after each step, too. Most of that time is fmpy's own: it makes two C arrays and
    a list for every call. So what it takes with an FMU that does nothing is measured beside it, and
    bounds how much faster than pythonfmu any FMU can be there.
    """
    for version in VERSIONS:
        fmu = fmu_of("K1", version)
        states = [v for v in fmu.outputs if v.name in _states(3)]
        what = f"FMI {version}, loop in C: doStep of 1 ms, a contact"
        try:
            program = Program("endurance", fmu)
        except Unavailable as error:
            yield Bar(what, 2.0, None, "us", note=str(error))
            continue
        ns = {}
        for read, variables in (("its 9 states", states), ("all its outputs", fmu.outputs)):
            arguments = (SPEED_STEP, SPEED_COUNT, 15, *fmu.model_arguments(variables))
            ns["nothing"], ns[read] = 1e3 * np.median(program.table("time", *arguments), axis=0) / 3
        note = ", ".join(f"{read} read: {found:.0f} ns" for read, found in ns.items())
        yield Bar(what, 2.0, ns["nothing"] / 1e3, "us", note=note, detail=ns)
    yield from _through_fmpy(full)


def _empty(fmu: Fmu) -> Fmu:
    """An FMU of the same description whose functions do nothing."""
    kind, create = (
        (FMU2Slave, "fmi2Instantiate")
        if fmu.version == "2.0"
        else (FMU3Slave, "fmi3InstantiateCoSimulation")
    )
    names = [name for name in dir(kind) if name.startswith(create[:4]) and name != create]
    text = f"static int one;\nvoid *{create}(void) {{ return &one; }}\n"
    text += "".join(f"int {name}(void) {{ return 0; }}\n" for name in names)
    folder = Path(shutil.copytree(fmu.folder, Path(tempfile.mkdtemp(dir=_KEPT.name)) / "empty"))
    empty = Fmu(fmu.path, folder, fmu.description)
    identifier = fmu.description.coSimulation.modelIdentifier
    empty.library("native").write_bytes(library({"empty.c": text}, identifier, "native"))
    return empty


def _through_fmpy(full: bool) -> Iterator[Bar]:
    fmus, off, missing = {f"FMI {version}": fmu_of("K1", version) for version in VERSIONS}, 0.0, ""
    try:
        folder = Path(tempfile.mkdtemp(dir=_KEPT.name))
        path = build_peer(cs.load_scene("K1"), plan_of("K1").states(0.0)[0], folder)
        fmus["pythonfmu"] = Fmu.unpacked(path, folder / "unpacked")
        off = _peer_error(fmus["pythonfmu"])
    except ImportError as error:
        missing = str(error)
    fmus |= {f"empty {key}": _empty(fmu) for key, fmu in fmus.items() if key != "pythonfmu"}
    jobs = {}
    for key, fmu in fmus.items():
        states = [v.name for v in fmu.outputs] if key == "pythonfmu" else _states(3)
        jobs[f"{key}, doStep"] = _fmpy_job(fmu, ())
        jobs[f"{key}, doStep and 27 states"] = _fmpy_job(fmu, states)
    timings = interleaved(jobs, repeats=15 if full else 7)
    us = {key: 1e6 * timing.median / SPEED_COUNT for key, timing in timings.items()}
    detail = {key: f"{timing} for {SPEED_COUNT} steps" for key, timing in timings.items()}
    for version in VERSIONS:
        key, peer = f"FMI {version}, doStep", us.get("pythonfmu, doStep")
        note = f"{us[key]:.3g} us {missing}"
        if peer is not None:
            note = f"{us[key]:.3g} us against {peer:.3g} us, which ends {off:.0e} off plan()"
        yield Bar(
            f"through fmpy, {key}: faster than pythonfmu by", 10.0, peer and peer / us[key],
            "x", least=True, note=note, detail=detail,
        )  # fmt: skip
    for version in VERSIONS:
        key, peer = (
            f"FMI {version}, doStep and 27 states",
            us.get("pythonfmu, doStep and 27 states"),
        )
        empty = us[f"empty {key}"]
        note = f"{us[key]:.3g} us, of which fmpy takes {empty:.3g} us{missing and f'; {missing}'}"
        if peer is not None:
            note += f"; pythonfmu's FMU {peer / us[key]:.3g} x that, an empty one allows "
            note += f"{peer / empty:.3g} x"
        yield Bar(f"through fmpy, {key}: share of an empty FMU's speed", 0.5, empty / us[key],
                  least=True, note=note, detail=detail)  # fmt: skip


def _peer_error(fmu: Fmu) -> float:
    """How far pythonfmu's states are from the plan after a second, of the greatest state."""
    slave = fmu.instance()
    initialize(slave)
    _run(slave, None)
    found = np.array(slave.getReal([v.valueReference for v in fmu.outputs])).reshape(3, 9)
    slave.freeInstance()
    wanted = plan_of("K1").states(SPEED_COUNT * SPEED_STEP)[0]
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def package(full: bool) -> Iterator[Bar]:
    """Size of the files; time of an export in a fresh process whose compiler's work is cached."""
    sizes = {f"{n} {v}": fmu_of(n, v).path.stat().st_size / 1e3 for n in SCENES for v in VERSIONS}
    yield Bar("greatest FMU for one platform", 300.0, max(sizes.values()), "kB", detail=sizes)
    code = (
        "import sys, time, contact_system as cs\n"
        "from fmu_export import export_fmu\n"
        "scene, began = cs.load_scene(sys.argv[1]), time.perf_counter()\n"
        "export_fmu(scene, sys.argv[2], sys.argv[3])\n"
        "print(time.perf_counter() - began)\n"
    )
    times: dict[str, list[float]] = {}
    for _ in range(3):
        for name, version in (("K1", "2.0"), ("K4", "3.0"), ("D1", "3.0")):
            command = [sys.executable, "-c", code, name, f"{_KEPT.name}/timed.fmu", version]
            run = subprocess.run(command, capture_output=True, text=True, check=True)
            times.setdefault(f"{name} {version}", []).append(float(run.stdout))
    slowest = max(statistics.median(found) for found in times.values())
    yield Bar("export, slowest of K1, K4 and D1", 3.0, slowest, "s", detail=times)


# --- robustness ----------------------------------------------------------------------------------


def fuzz(full: bool) -> Iterator[Bar]:
    """Random calls, damaged and forged state bytes under sanitizers: 10 000 of each.

    full: of each in every FMU. A forged state has the right checksum and wrong numbers.
    """
    scenes = (cs.load_scene("K2"), cs.load_scene("K4"), EVERYTHING)
    count = 10_000 if full else -(-10_000 // (len(scenes) * len(VERSIONS)))
    for seed, (scene, version) in enumerate(itertools.product(scenes, VERSIONS)):
        what = f"{scene.name}, FMI {version}: {count} sequences, damaged, forged states: findings"
        fmu = fmu_of(scene, version)
        try:
            program = Program("fuzz", fmu, sanitized=True)
            said = program.run(count, count, seed, *fmu.model_arguments(), timeout=3600.0)
        except Unavailable as error:
            yield Bar(what, 0, None, note=str(error))
        except (AssertionError, subprocess.TimeoutExpired) as error:
            yield Bar(what, 0, 1, note=str(error)[:200].replace("\n", " "),
                      detail={"said": str(error)})  # fmt: skip
        else:
            made, granted, slowest, call, taken = said.split()
            note = f"{made} calls, {granted} of them legal; slowest {slowest} s, {call}; {taken} "
            note += "forged states told nothing impossible and were taken"
            yield Bar(what, 0, 0, note=note)


def endurance(full: bool) -> Iterator[Bar]:
    """A million steps; 64 instances in two threads."""
    for scene in (cs.load_scene("K1"), cs.load_scene("K4"), EVERYTHING):
        for version in VERSIONS:
            fmu, duration = fmu_of(scene, version), scene.duration
            model = fmu.model_arguments(fmu.outputs)
            what = f"{scene.name}, FMI {version}: "
            try:
                program = Program("endurance", fmu)
            except Unavailable as error:
                yield Bar(what + "endurance", 0, None, note=str(error))
                continue
            arguments = (duration / 1000, 1000, 1000, *model)
            inside, heap, process = program.table("memory", *arguments)[0]
            yield Bar(
                what + "1e6 steps: growth of heap and process", 0, max(heap, process), "bytes",
                note=f"{inside:.0f} allocations inside of steps", holds=inside == 0,
            )  # fmt: skip
            different = program.table("threads", duration / 500, 500, 64, *model)[0, 0]
            yield Bar(what + "64 instances on 2 threads: in other bits than one", 0, different)


SECTIONS = {
    "validation": validation,
    "cosimulation": cosimulation,
    "model_exchange": model_exchange,
    "slave": slave,
    "importers": other_importers,
    "platforms": platforms,
    "speed": speed,
    "package": package,
    "fuzz": fuzz,
    "endurance": endurance,
}
