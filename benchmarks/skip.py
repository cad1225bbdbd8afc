"""What each bundled scene leaves out because it has none of it, and what that saves.

The yardstick is the same motion with everything switched on: the same surfaces as charts of no
known kind (`ParametricSurface`), which have no closed form, no ambient form and no constants, and
on every contact all kinds of disturbance, too small to be seen in the result. The library has no
switch for this; the scene alone asks for it. Plans are made without compiled kernels, which the
cache may hold for one of two scenes and not for the other.
"""

from __future__ import annotations

import dataclasses
import itertools
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np

import contact_system as cs
from contact_system.development import driven_motion
from contact_system.scene import Scene
from contact_system.starts import scene_start
from contact_system.surfaces import Surface
from contact_system.tracks import prefers_ambient

from .report import RESULTS, Bar, Sections, markdown_table
from .timing import Job, interleaved

SCENES = ("K1", "K2", "K3", "K4", "D1", "D2", "D3", "C1", "C2")
FEW = ("K4", "C2")
"""Where a scene takes seconds to build; --full takes all."""
TINY = 1e-13  # [rad/s^2, rad/s] below what a tolerance of 1e-12 sees
OUTPUTS = ("states", "points", "slip", "slip_speed", "pose", "twist", "acceleration")
FOREIGN = ("matplotlib", "pydrake", "fmpy", "scipy.integrate", "drake_plant", "fmu_export")
TRIGONOMETRY = (
    ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN, ca.OP_ATAN2,
)  # fmt: skip
SIMULATED = 0.05  # [s]

TABLE: dict[str, dict[str, str]] = {}
"""Scene -> column -> cell, as measured in this process; the summary's input."""


# --- everything switched on ----------------------------------------------------------------------


def as_chart(surface: Surface) -> cs.ParametricSurface:
    """The surface as a chart that nothing is known about, in the same coordinates."""
    names = [f"p{i}" for i in range(len(surface.parameters))]

    def f(u: ca.SX, v: ca.SX, **given: ca.SX) -> ca.SX:
        return surface.chart_expr(ca.vertcat(*given.values()), u, v)

    period_u, period_v = surface.periods()
    return cs.ParametricSurface(
        f, parameters=dict(zip(names, surface.parameters)), size=surface.size,
        u_period=period_u, v_period=period_v,
    )  # fmt: skip


def switched_on(scene: Scene) -> Scene:
    """The same motion without anything that could be left out.

    Parameters
    ----------
    scene : Scene
        Of surfaces with a chart. Rolling that is imposed becomes a finger velocity. Accelerations
        leave out a hundredth of the horizon at both ends, where sigma may be 0.
    """
    contacts = []
    for contact in scene.contacts:
        start = scene_start(contact)
        contacts.append(dataclasses.replace(
            contact, finger=as_chart(contact.finger), finger_velocity=start.finger_velocity,
            object_velocity=start.object_velocity,
        ))  # fmt: skip
    kinds = (cs.FingerAcceleration, cs.ObjectAcceleration, cs.ObjectRateOffset)
    window = {"start": 0.01 * scene.duration, "stop": 0.99 * scene.duration}
    pushes = [
        kind(contact=i, value=(TINY, TINY), **window)
        for i, kind in itertools.product(range(len(contacts)), kinds)
    ]
    return dataclasses.replace(
        scene, object=as_chart(scene.object), contacts=contacts,
        disturbances=[*scene.disturbances, *pushes],
    )  # fmt: skip


def _note(scene: str, column: str, cell: str) -> None:
    TABLE.setdefault(scene, {})[column] = cell


# --- the planner ---------------------------------------------------------------------------------


def planner(full: bool) -> Iterator[Bar]:
    """plan() and contact points of a new scene against everything switched on."""
    for name in SCENES:
        scene = cs.load_scene(name)
        whole, t = switched_on(scene), np.linspace(0.0, scene.duration, 101)
        plan, other = (cs.plan(each, compiled=False) for each in (scene, whole))
        off = float(np.abs(plan.points(t) - other.points(t)).max())
        alone = ("points",)
        jobs = {"as it is": _asked(scene, t, alone), "everything": _asked(whole, t, alone)}
        times = interleaved(jobs, repeats=7 if full else 3, burst=0.0)
        as_is, everything = (1e3 * times[key].median for key in jobs)
        closed, tracks = _closed(plan)
        _note(name, "integrated", f"{tracks - closed} of {_closed(other)[1]}")
        _note(name, "plan [ms]", f"{as_is:.3g} / {everything:.3g}")
        note = f"{as_is:.3g} ms beside {everything:.3g} ms; {closed} of {tracks} tracks closed form"
        yield Bar(f"{name}, plan and points, times faster than everything", 1.0,
                  everything / as_is, "x", True, f"{note}; paths {off:.0e} m apart",
                  holds=off < 1e-10, detail={"skipped": _told(plan), "off": off})  # fmt: skip


def _closed(plan: cs.Plan) -> tuple[int, int]:
    """Tracks in closed form, and all of a plan's tracks."""
    tracks = [track for group in plan.groups for track in (*group.finger, *group.object)]
    return sum(track.method.startswith("closed form") for track in tracks), len(tracks)


def _told(plan: cs.Plan) -> list[str]:
    """What `plan.explain()` says it skipped."""
    lines = (line.strip() for line in plan.explain().splitlines())
    return [line.removeprefix("skipped: ") for line in lines if line.startswith("skipped: ")]


def explained(full: bool) -> Iterator[Bar]:
    """What explain() calls skipped is what the tracks did without."""
    wrong = {}
    for name in SCENES:
        plan = cs.plan(cs.load_scene(name))
        expected = []
        for group in sorted(plan.groups, key=lambda group: group.contacts[0]):
            panels = [
                [hasattr(track, "panels") or hasattr(track, "kernel") for track in side]
                for side in (group.finger, group.object)
            ]
            if not any(map(any, panels)):
                expected.append("all integration")
            elif not any(panels[0]):
                expected.append("integration of the finger")
            if not plan.slip_speed(_undisturbed(plan.scene))[:, group.contacts].any():
                offset = plan.slip_speed(plan.sample_times())[:, group.contacts].any()
                expected.append(
                    "gain (slip is that of rate offsets, which ends with them)"
                    if offset
                    else "slip and gain (there is none to reject)"
                )
        if expected != _told(plan):
            wrong[name] = {"told": _told(plan), "found": expected}
    yield Bar("scenes whose explain() is wrong about what it skipped", 0, len(wrong),
              note=", ".join(wrong), detail=wrong)  # fmt: skip


def _undisturbed(scene: Scene) -> np.ndarray:
    """Times off all object rate offsets, which are slip while they last and leave none behind."""
    t = np.linspace(0.0, scene.duration, 201)
    offsets = [d for d in scene.disturbances if isinstance(d, cs.ObjectRateOffset)]
    return t[[not any(d.start <= time <= d.stop for d in offsets) for time in t]]


def outputs(full: bool) -> Iterator[Bar]:
    """A plan and one output against a plan and all."""
    for name in SCENES:
        scene = cs.load_scene(name)
        t = np.linspace(0.01, 0.99, 101) * scene.duration
        jobs = {"points": _asked(scene, t, ("points",)), "all": _asked(scene, t, OUTPUTS)}
        times = interleaved(jobs, repeats=7 if full else 3, burst=0.0)
        one, every = (1e3 * times[key].median for key in jobs)
        _note(name, "one output / all [ms]", f"{one:.3g} / {every:.3g}")
        yield Bar(f"{name}, a plan and its points, times faster than with all outputs", 1.0,
                  every / one, "x", True, f"{one:.3g} ms beside {every:.3g} ms")  # fmt: skip


def _asked(scene: Scene, t: np.ndarray, names: tuple[str, ...]) -> Job:
    """A plan of a scene that was never planned before, and outputs of it."""

    def call(new: Scene) -> None:
        plan = cs.plan(new, compiled=False)
        for name in names:
            getattr(plan, name)(t)

    return Job(call, lambda: dataclasses.replace(scene))


def kernels(full: bool) -> Iterator[Bar]:
    """Operations in the right-hand side of each body, against the chart of no known kind."""
    for name in SCENES:
        scene = cs.load_scene(name)
        cells = []
        for side, surface in (("finger", scene.contacts[0].finger), ("object", scene.object)):
            general = driven_motion(as_chart(surface), False).function
            own = driven_motion(surface, prefers_ambient(surface)).function
            count, trigonometry = _operations(own)
            whole, whole_trigonometry = _operations(general)
            cells.append(f"{count} ({trigonometry})")
            yield Bar(f"{name}, {side}: operations over those of a chart", 1.0, count / whole,
                      note=f"{count} beside {whole}; trigonometric {trigonometry} "
                      f"beside {whole_trigonometry}")  # fmt: skip
        _note(name, "operations (trigonometric), finger, object", ", ".join(cells))


def _operations(function: ca.Function) -> tuple[int, int]:
    """Arithmetic instructions of a function, and the trigonometric ones among them."""
    moves = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER)
    kinds = [function.instruction_id(k) for k in range(function.n_instructions())]
    kinds = [kind for kind in kinds if kind not in moves]
    return len(kinds), sum(kind in TRIGONOMETRY for kind in kinds)


# --- the FMU -------------------------------------------------------------------------------------


def fmu(full: bool) -> Iterator[Bar]:
    """A step against a step and all outputs; against everything switched on; sizes of the files."""
    try:
        from .fmu import Program, Unavailable, fmu_of
    except ImportError as error:
        yield Bar("FMU", 1.0, None, note=str(error))
        return
    for name in SCENES if full else FEW:
        scene, found = cs.load_scene(name), []
        for variant in (scene, switched_on(scene)):
            made = fmu_of(variant, "2.0")
            try:
                program = Program("endurance", made)
            except Unavailable as error:
                yield Bar(f"{name}, FMU", 1.0, None, note=str(error))
                return
            # Half a horizon in steps of 1 ms, nine times; without outputs, and with them.
            arguments = 1e-3, int(500 * scene.duration), 9, *made.model_arguments(made.outputs)
            alone, reading = np.median(program.table("time", *arguments), axis=0)
            found.append((alone, reading, made.path.stat().st_size / 1e3))
        (alone, reading, size), (whole, _, whole_size) = found
        _note(name, "FMU step / with outputs / everything [us]",
              f"{alone:.2g} / {reading:.2g} / {whole:.2g}")  # fmt: skip
        _note(name, "FMU [kB]", f"{size:.0f} / {whole_size:.0f}")
        yield Bar(f"{name}, FMU: a step alone, times faster than with all outputs", 1.0,
                  reading / alone, "x", True,
                  f"{alone:.3g} us beside {reading:.3g} us")  # fmt: skip
        yield Bar(f"{name}, FMU: a step, times faster than everything", 1.0, whole / alone, "x",
                  True, f"{alone:.3g} us beside {whole:.3g} us; "
                  f"{size:.0f} kB beside {whole_size:.0f} kB")  # fmt: skip


# --- Drake ---------------------------------------------------------------------------------------


def drake(full: bool) -> Iterator[Bar]:
    """Ports, collision pairs and mesh faces of a station; building it; watching contact."""
    try:
        from drake_plant.station import BuildStation, StationConfig
    except ImportError as error:
        yield Bar("Drake station", 1.0, None, note=str(error))
        return
    for name in SCENES if full else FEW:
        scene, found = cs.load_scene(name), []
        rest = {"coordinates": "frame"} if name == "C1" else {}  # sigma(0) = 0
        every: dict[str, Any] = {
            "strip_margin": 1.0, "disturbance_input": True, "restart_period": 0.01
        }  # fmt: skip
        for changes in ({"monitor": False}, every):
            config = StationConfig.from_scene(scene, **rest, **changes)
            begin = time.perf_counter()
            station = BuildStation(scene, config)
            station.CreateDefaultContext()
            found.append((time.perf_counter() - begin, *_parts(station)))
        (built, ports, pairs, faces), (whole_built, whole_ports, _, whole_faces) = found
        bodies = len(scene.contacts) + 1
        every_pair = bodies * (bodies - 1) // 2
        _note(name, "ports", f"{ports} / {whole_ports}")
        _note(name, "collision pairs", f"{pairs} / {every_pair}")
        _note(name, "mesh faces", f"{faces} / {whole_faces}")
        _note(name, "station built [s]", f"{built:.2g} / {whole_built:.2g}")
        yield Bar(f"{name}, Drake: mesh faces over a uniform fine mesh's", 1.0,
                  faces / whole_faces, note=f"{faces} beside {whole_faces}; collision pairs "
                  f"{pairs} of {every_pair}; ports {ports} of {whole_ports}; built in "
                  f"{built:.2g} s beside {whole_built:.2g} s")  # fmt: skip
    yield from _monitored(full)


def _parts(station: Any) -> tuple[int, int, int]:
    """Declared ports of all systems, candidates for collision, faces of all contact meshes."""
    from pydrake.geometry import Mesh, Role

    systems = station.GetSystems()
    ports = sum(system.num_input_ports() + system.num_output_ports() for system in systems)
    inspector = station.GetSubsystemByName("scene_graph").model_inspector()
    faces = 0
    for geometry in inspector.GetAllGeometryIds(Role.kProximity):
        shape = inspector.GetShape(geometry)
        if isinstance(shape, Mesh):
            text = shape.source().in_memory().mesh_file.contents()
            lines = (text if isinstance(text, str) else text.decode()).splitlines()
            triangles = sum(line.startswith("f ") for line in lines)
            # A tetrahedral mesh has one inner point a star, so a cell for every face.
            cells = next((line for line in lines if line.startswith("CELLS ")), "CELLS 0")
            faces += triangles or int(cells.split()[1])
    return ports, len(inspector.GetCollisionCandidates()), faces


def _monitored(full: bool) -> Iterator[Bar]:
    """D1 simulated without a monitor, and with one whose outputs are read after each step."""
    from pydrake.systems.analysis import Simulator

    from drake_plant.station import BuildStation, SetInitialState, StationConfig

    scene = cs.load_scene("D1")
    names = ("measured_state", "measured_slip", "normal_force", "tangential_force",
             "measured_contact_point")  # fmt: skip

    def job(monitor: bool) -> Job:
        station = BuildStation(scene, StationConfig.from_scene(scene, monitor=monitor))
        step = StationConfig.from_scene(scene).plant.time_step
        ports = [station.GetOutputPort(name) for name in names if monitor]

        def make() -> Any:
            simulator = Simulator(station)
            SetInitialState(station, simulator.get_mutable_context())
            simulator.Initialize()
            return simulator

        def call(simulator: Any) -> None:
            for k in range(1, round(SIMULATED / step) + 1):
                simulator.AdvanceTo(k * step)
                for port in ports:
                    port.Eval(simulator.get_context())

        return Job(call, make)

    jobs = {"without": job(False), "with": job(True)}
    times = interleaved(jobs, repeats=7 if full else 3, burst=0.0)
    rates = {key: SIMULATED / timing.median for key, timing in times.items()}
    _note("D1", "simulated over wall time, without / with a monitor",
          f"{rates['without']:.2g} / {rates['with']:.2g}")  # fmt: skip
    # What a monitor costs is hardly more than these times scatter.
    yield Bar("D1, Drake: without a monitor, times faster", 0.9,
              times["with"].median / times["without"].median, "x", True,
              f"{rates['without']:.2g} of real time, watched {rates['with']:.2g}")  # fmt: skip


# --- imports -------------------------------------------------------------------------------------

IMPORT = """
import sys, time
before, begin = set(sys.modules), time.perf_counter()
import contact_system as cs
spent = time.perf_counter() - begin
cs.plan(cs.load_scene("K4"), compiled=False).states([0.0, 1.0])
print(spent, len(set(sys.modules) - before), *[n for n in {names!r} if n in sys.modules])
"""
EVERYTHING = """
import sys, time
before, begin = set(sys.modules), time.perf_counter()
for name in ("contact_system", *{names!r}):
    try:
        __import__(name)
    except ImportError:
        pass
print(time.perf_counter() - begin, len(set(sys.modules) - before))
"""


def imports(full: bool) -> Iterator[Bar]:
    """What a plan imports, in fresh processes."""
    alone = [_printed(IMPORT) for _ in range(5 if full else 3)]
    whole = [_printed(EVERYTHING) for _ in range(2)]
    foreign = alone[0][2:]
    spent, everything = (min(float(run[0]) for run in runs) for runs in (alone, whole))
    yield Bar("imports for a plan: modules of Drake, fmpy, pictures, scipy's integrators", 0,
              len(foreign), note=", ".join(foreign) or f"{alone[0][1]} modules")  # fmt: skip
    yield Bar("import contact_system, times faster than with all those", 1.0, everything / spent,
              "x", True, f"{spent:.2f} s beside {everything:.2f} s and {whole[0][1]} modules"
              )  # fmt: skip


def _printed(code: str) -> list[str]:
    command = [sys.executable, "-c", code.format(names=FOREIGN)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def summary(full: bool) -> Iterator[Bar]:
    """Write ``results/benchmarks/skip.md``: a line a scene."""
    if not TABLE:
        return
    columns = list(dict.fromkeys(column for row in TABLE.values() for column in row))
    rows = [[name, *(row.get(column, "") for column in columns)] for name, row in TABLE.items()]
    RESULTS.mkdir(parents=True, exist_ok=True)
    text = markdown_table(["scene", *columns], rows)
    text += "\nBefore a slash: the scene as it is. After it: everything switched on.\n"
    (RESULTS / "skip.md").write_text(text)
    print(text)
    yield Bar("scenes in skip.md", len(SCENES), len(rows), least=True)


SECTIONS: Sections = {
    "planner": planner,
    "explained": explained,
    "outputs": outputs,
    "kernels": kernels,
    "fmu": fmu,
    "drake": drake,
    "imports": imports,
    "summary": summary,
}
