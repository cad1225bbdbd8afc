"""Drake: what the planner's derivatives cost, and how D1 to D4 go with contact physics.

Costs are those of one evaluation of the derivatives inside a Simulator, less those of a LeafSystem
with as many states that does nothing, measured in turns in one process.

The paper's scenes D1 to D3 are simulated over their whole duration, with hydroelastic and with
point contact; D4 until 0.5 s after one push at a time, with the loop open and closed.
"""

from __future__ import annotations

import functools
import itertools
import math
import os
import resource
import signal
import statistics
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter, process_time, sleep
from typing import Any

import numpy as np
from pydrake.common import RandomDistribution
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import (
    ApplySimulatorConfig,
    GetIntegrationSchemes,
    Simulator,
    SimulatorConfig,
)
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    LeafSystem,
    System,
)
from pydrake.systems.primitives import LogVectorOutput, MatrixGain, RandomSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

import contact_system as cs
from drake_plant import (
    AddScenePlant,
    BuildStation,
    ContactPlanner,
    PlanSource,
    Push,
    SetInitialState,
    StationConfig,
    contact_table,
    outcome,
    push_table,
    rolling_scene,
    simulate,
)
from drake_plant.contact_monitor import SATURATED
from drake_plant.simulation import INTEGRATION

from .report import Bar, Sections
from .timing import Job, interleaved

RUNS = 200  # of the sweep
SCENES = ("D1", "D2", "D3")
MODELS = ("hydroelastic", "point")
PUSHED, AFTER = 0.2, 0.5  # [s] when a push begins, and how long it is followed after its end
SPEED_TIME = 0.5  # [s] simulated in a run of the speed comparison
SCHEMES_TIME = 0.1  # [s] simulated under every scheme
EULERS = ("explicit_euler", "semi_explicit_euler", "implicit_euler", "radau1", "runge_kutta2")
STEPS: dict[str, tuple[float, float | None]] = {
    **dict.fromkeys(EULERS, (1e-4, None)),
    **dict.fromkeys(("bogacki_shampine3", "runge_kutta3", "runge_kutta5"), (1e-3, 1e-2)),
    "cenic": (5e-4, 1e-4),
}
"""Greatest step, s, and accuracy, None without error control; other schemes: 1e-3, None."""
COORDINATES = ("chart", "frame")
TITLES = {"K1": "on a sphere", "D1": "on a sphere, with a window"}
TIMED, EVALUATIONS = 0.3, 900
"""s simulated in one sample of a cost, in steps of 1 ms by runge_kutta3."""


# --- the planner alone ---------------------------------------------------------------------------


def simulator_of(system: System, scheme: str, step: float, accuracy: float | None) -> Simulator:
    """A Simulator with error control, or with steps of equal length for the accuracy None."""
    simulator = Simulator(system)
    control = {"use_error_control": accuracy is not None, "accuracy": accuracy or 1e-3}
    config = SimulatorConfig(integration_scheme=scheme, max_step_size=step, **control)
    ApplySimulatorConfig(config, simulator)
    simulator.Initialize()
    return simulator


class Empty(LeafSystem):
    """A system with continuous states, whose derivatives take no time."""

    def __init__(self, x0: np.ndarray):
        super().__init__()
        self.DeclareContinuousState(BasicVector(x0))

    def DoCalcTimeDerivatives(self, context: Context, derivatives: Any) -> None:
        pass


def _job(system: LeafSystem) -> Job:
    make = functools.partial(simulator_of, system, "runge_kutta3", 1e-3, None)
    return Job(lambda simulator: simulator.AdvanceTo(TIMED), make)


def cost(full: bool) -> Iterator[Bar]:
    """One evaluation of the derivatives in a Simulator, less that of an empty system."""
    jobs = {}
    for name in TITLES:
        for coordinates in COORDINATES:
            scene = cs.load_scene(name)
            jobs[f"empty {name} {coordinates}"] = _job(Empty(cs.SceneSystem(scene, coordinates).x0))
            jobs[f"{name} {coordinates}"] = _job(ContactPlanner(scene, coordinates))
    costs = {key: 1e6 * time / EVALUATIONS for key, time in interleaved(jobs).items()}
    for name, title in TITLES.items():
        for coordinates in COORDINATES:
            own, empty = costs[f"{name} {coordinates}"], costs[f"empty {name} {coordinates}"]
            what = f"3 spheres {title}, {coordinates}: over empty"
            yield Bar(what, 4.0, own - empty, "us", note=f"empty takes {empty:.3g} us")


def cenic(full: bool) -> Iterator[Bar]:
    """D1 to 0.5 s in a Diagram with a continuous plant; cenic controls only the plant's error."""
    scene = cs.load_scene("D1")
    truth = cs.plan(scene, 1e-13).points(0.5)[0]
    for step in (0.1, 1e-2, 1e-3, 1e-4):
        for planner in (ContactPlanner(scene), PlanSource(cs.plan(scene))):
            builder = DiagramBuilder()
            plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
            plant.AddRigidBody("body", SpatialInertia.SolidSphereWithMass(1.0, 0.1))
            plant.Finalize()
            builder.AddSystem(planner)
            simulator = simulator_of(builder.Build(), "cenic", step, 1e-3)
            off, note = 0.0, ""
            try:
                simulator.AdvanceTo(0.5)
            except cs.SceneError:
                note = f"refused at {simulator.get_context().get_time():.2g} s"
            else:
                context = planner.GetMyContextFromRoot(simulator.get_context())
                points = planner.GetOutputPort("contact_point").Eval(context).reshape(-1, 2, 3)
                off = float(np.linalg.norm(points - truth, axis=-1).max())
            what = f"D1 at 0.5 s, cenic, steps to {step:g} s, {type(planner).__name__}: off"
            yield Bar(what, 1e-6, off, "m", note=note)


# --- stations ------------------------------------------------------------------------------------


@functools.cache
def worst(name: str, model: str) -> dict[str, float]:
    """The greatest value of each number of the contacts' reports, over the scene's duration."""
    scene = cs.load_scene(name)
    reports = contact_table(simulate(scene, StationConfig.from_scene(scene, contact_model=model)))
    rows = [{**asdict(report), "off": abs(report.normal_mean - 1)} for report in reports]
    numbers = [key for key, value in rows[0].items() if isinstance(value, float)]
    return {key: float(np.nanmax([row[key] for row in rows])) for key in numbers}


def forces(full: bool) -> Iterator[Bar]:
    """Normal force, but for 0.1 s around edges, and friction over mu times it."""
    for (model, limit), name in itertools.product(zip(MODELS, (0.05, 0.01)), SCENES):
        what, found = f"{name} {model}: ", worst(name, model)
        yield Bar(what + "mean normal force off 1 N by", 0.01, found["off"], "N")
        yield Bar(what + "its standard deviation", limit, found["normal_deviation"], "N")
        note = f"saturated {found['saturated']:.0%} of the disturbance"
        yield Bar(what + "tangential force over mu N", 1.02, found["friction_ratio"], note=note)


def rolling(full: bool) -> Iterator[Bar]:
    """D1 before its disturbance: slip, friction, measured against planned contact points."""
    for model, limit in zip(MODELS, (1e-3, 1e-4)):
        what, found = f"D1 {model}: ", worst("D1", model)
        yield Bar(what + "slip over contact speed", limit, found["rolling_slip"])
        yield Bar(what + "friction spent", 0.1, found["rolling_friction"], "N")
        yield Bar(what + "contact point off the plan", 1e-3, found["distance"], "m")


def recovery(full: bool) -> Iterator[Bar]:
    """Time until slip is rejected, against what the paper reports."""
    for model, name in itertools.product(MODELS, SCENES):
        found = worst(name, model)
        yield Bar(f"{name} {model}: recovery", found["reported"], found["recovery"], "s")


def _pushed(size: float, time: float, across: bool, model: str, closed: bool) -> dict[str, float]:
    """D4's finger 1 after one push: path slid, time off the object, and distance left.

    size : N, of a force that is constant in the world
    """
    scene, finger = cs.load_scene("D4"), 0
    around = PUSHED + np.array([-1e-5, 0, 1e-5])
    points = cs.plan(scene).points(around)[:, finger, 1]
    along = (points[2] - points[0]) / np.linalg.norm(points[2] - points[0])
    normal = points[1] / np.linalg.norm(points[1])
    force = size * (np.cross(normal, along) if across else along)
    name, stop = scene.contact_name(finger), PUSHED + time
    pushes = [Push(name, PUSHED, stop, force.tolist())]
    config = StationConfig.from_scene(scene, contact_model=model, pushes=pushes)
    result = simulate(scene, config if closed else config.opened(), duration=stop + AFTER)
    (push,), used = push_table(result), result.measured["friction_used"][result.t > PUSHED, finger]
    slides = bool(np.nanmax(used) >= SATURATED)
    return {"slip": push.slip, "slides": slides, "off": push.time_off, "distance": push.left}


def feedback(full: bool) -> Iterator[Bar]:
    """Pushes of 0.5 to 4 N on a finger of D4, along and across its path: closed over open loop."""
    sizes, times = ((0.5, 2, 4), (0.02, 0.05, 0.3)) if full else ((2, 4), (0.02, 0.05))
    for model in MODELS:
        pairs = []
        for size, time, across in itertools.product(sizes, times, (True, False)):
            if full or model == "point" or size == 4:
                opened, closed = (
                    _pushed(size, time, across, model, loop) for loop in (False, True)
                )
                pairs.append((opened, closed))
        ratios = [b["slip"] / a["slip"] for a, b in pairs if a["slides"]]
        what, held = f"D4 {model}: ", len(pairs) - len(ratios)
        note = f"{len(ratios)} pushes; friction holds {held} more"
        name = "slip while touching, closed over open, geometric mean"
        mean = statistics.geometric_mean(ratios)
        yield Bar(what + name, 0.7, mean, note=note + "; the aim is 0.5")
        yield Bar(what + "the greatest of these", 1.05, max(ratios))
        more = max(b["off"] - a["off"] for a, b in pairs)
        longest = max(a["off"] for a, _ in pairs)
        note = f"open up to {longest:.3g} s"
        yield Bar(what + "longer off the object, closed than open", 0.0, more, "s", note=note)
        left = max(b["distance"] for _, b in pairs)
        yield Bar(what + "distance from the curve 0.5 s after a push", 1e-4, left, "m")


def noise(full: bool) -> Iterator[Bar]:
    """D4 without pushes, with a restart every 10 ms from states with noise of 1 mrad, 0.1 rad/s."""
    scene, time = cs.load_scene("D4"), 3.0 if full else 0.5
    for model in MODELS:
        slipped = []
        for size in (0.0, 1.0):
            config = StationConfig.from_scene(
                scene, contact_model=model, pushes=[], restart_period=0.01
            )
            builder, n = DiagramBuilder(), len(scene.contacts)
            station = builder.AddSystem(BuildStation(scene, config))
            source = builder.AddSystem(RandomSource(RandomDistribution.kGaussian, 9 * n, 1e-3))
            sizes = size * np.tile([1e-3, 1e-3, 0.1, 0.1, 1e-3, 1e-3, 0.1, 0.1, 1e-3], n)
            scaled = builder.AddSystem(MatrixGain(np.diag(sizes)))
            builder.Connect(source.get_output_port(), scaled.get_input_port())
            builder.Connect(scaled.get_output_port(), station.GetInputPort("noise"))
            log = LogVectorOutput(station.GetOutputPort("measured_slip"), builder, 1e-3)
            simulator = Simulator(builder.Build())
            ApplySimulatorConfig(INTEGRATION, simulator)
            context = simulator.get_mutable_context()
            SetInitialState(station, context)
            simulator.AdvanceTo(time)
            slip = log.FindLog(context).data().T.reshape(-1, n, 2)
            slipped.append(1e-3 * np.linalg.norm(slip, axis=2).sum(axis=0).max())
        still, shaken = slipped
        note = f"in {time:g} s; {1e3 * still:.3g} mm without noise"
        yield Bar(f"D4 {model}: slip that noise adds", 1e-4, shaken - still, "m", note=note)


def reach(full: bool) -> Iterator[Bar]:
    """A sphere steered on an ellipsoid in four legs: where it ends, against the goal."""
    r1 = cs.load_scene("R1")
    contact = replace(r1.contacts[0], legs=(), object_at=(1.0, 0.2), angle=0.3)
    scene = r1.replace(contacts=[contact], profile=cs.Profile([0.1]))
    config = StationConfig.from_scene(scene, contact_model="hydroelastic")
    goal = cs.Goal(object_at=(2.0, 1.0), finger_at=(1.0, 0.5), angle=1.0)
    radii = {"effective": (rolling_scene(scene, config), 1e-3), "nominal": (scene, None)}
    for name, (rolls, bar) in radii.items():
        legs = replace(contact, legs=cs.reach(rolls, goal, legs=4).legs[0])
        end = simulate(scene.replace(contacts=[legs]), config).measured["state"][-1, 0]
        places = (contact.finger, end[:2], goal.finger_at), (scene.object, end[4:6], goal.object_at)
        away = max(np.linalg.norm(s.point(*at) - s.point(*wanted)) for s, at, wanted in places)
        off = math.degrees(abs(math.remainder(end[8] - goal.angle, math.tau)))
        what = f"distance from the goal, legs for {name} radii"
        yield Bar(what, bar, float(away), "m", note=f"and {off:.3f} degrees")


def speed(full: bool) -> Iterator[Bar]:
    """D1 with its film, as the command line simulates it: simulated over processor time; and how
    much of a step planner, driver, monitor and logs take."""
    scene = cs.load_scene("D1")
    for model, limit in zip(MODELS, (0.4, 1.2)):
        config, rates = StationConfig.from_scene(scene, contact_model=model), []
        with tempfile.TemporaryDirectory() as folder:
            for _ in range(5 if full else 3):
                run, film = _StepTimes(), Path(folder) / "film.html"
                simulate(scene, config, SPEED_TIME, run, film)
                rates.append(SPEED_TIME / sum(run.station))
        what, rate = f"D1 {model}: ", statistics.median(rates)
        yield Bar(what + "simulated over time spent", limit, rate, "x", True)
        times = _StepTimes(_plant_alone(scene, config))
        simulate(scene, config, SPEED_TIME, times)
        rest, plant = (
            1e3 * config.time_step / SPEED_TIME * value
            for value in (sum(times.station) - sum(times.plant), sum(times.plant))
        )
        note = f"the plant alone {plant:.2f} ms"
        yield Bar(what + "a step but for the plant", 0.5, rest, "ms", note=note)


class _StepTimes:
    """Processor time of each step of a station, and of a plant alone, in turns, s."""

    def __init__(self, step_alone: Callable[[float], float] | None = None):
        self.station, self.plant = list[float](), list[float]()
        self._step_alone, self._since = step_alone, math.nan

    def __call__(self, t: float) -> None:
        if not math.isnan(self._since):
            self.station.append(process_time() - self._since)
        if self._step_alone is not None:
            self.plant.append(self._step_alone(t))
        self._since = process_time()


def _plant_alone(scene: cs.Scene, config: StationConfig) -> Callable[[float], float]:
    """A function that advances the plant alone, without Python, to a time, and returns processor
    time, s. Forces are those of a station's driver, and steps begin in the station's states.
    """
    station, step = BuildStation(scene, config), config.time_step
    simulator = Simulator(station)
    ApplySimulatorConfig(INTEGRATION, simulator)
    root, plant = simulator.get_mutable_context(), station.GetSubsystemByName("plant")
    SetInitialState(station, root)
    forces = np.zeros((plant.num_velocities(), round(SPEED_TIME / step) + 1))
    states = []
    for k in range(forces.shape[1]):
        simulator.AdvanceTo(k * step)
        states.append(plant.GetPositionsAndVelocities(plant.GetMyContextFromRoot(root)))
        for applied in station.GetOutputPort("spatial_forces").Eval(root):
            first = plant.get_body(applied.body_index).floating_velocities_start_in_v()
            forces[first : first + 6, k] = applied.F_Bq_W.get_coeffs()
    held = PiecewisePolynomial.ZeroOrderHold((np.arange(forces.shape[1]) - 0.01) * step, forces)

    builder = DiagramBuilder()
    parts = AddScenePlant(builder, scene, config)
    source = builder.AddSystem(TrajectorySource(held)).get_output_port()
    builder.Connect(source, parts.plant.get_applied_generalized_force_input_port())
    alone = Simulator(builder.Build())
    alone.Initialize()
    own = parts.plant.GetMyMutableContextFromRoot(alone.get_mutable_context())

    def spent(t: float) -> float:
        now = alone.get_context().get_time()
        parts.plant.SetPositionsAndVelocities(own, states[round(now / step)])
        since = process_time()
        alone.AdvanceTo(t)
        return process_time() - since

    return spent


def schemes(full: bool) -> Iterator[Bar]:
    """D1 on a continuous plant under all of Drake's schemes, against the discrete plant."""
    plant = {"coordinates": "plan", "contact_model": "point"}
    discrete, _ = _points({**plant, "time_step": 1e-3}, "runge_kutta3", (1e-3, None))
    for scheme in GetIntegrationSchemes():
        points, spent = _points(
            {**plant, "time_step": 0.0}, scheme, STEPS.get(scheme, (1e-3, None))
        )
        apart = float(np.linalg.norm(points - discrete, axis=1).max())
        what = f"D1 to {SCHEMES_TIME} s, continuous, {scheme}: contact points apart"
        yield Bar(what, 5e-4, apart, "m", note=f"{spent:.1f} s")


def _points(
    changes: dict[str, Any], scheme: str, how: tuple[float, float | None]
) -> tuple[np.ndarray, float]:
    """D1's contact points on the object at the end, and the time that the simulation took, s."""
    scene, (step, accuracy) = cs.load_scene("D1"), how
    station = BuildStation(scene, StationConfig.from_scene(scene, **changes))
    simulator = simulator_of(station, scheme, step, accuracy)
    SetInitialState(station, simulator.get_mutable_context())
    begun = perf_counter()
    simulator.AdvanceTo(SCHEMES_TIME)
    port = station.GetOutputPort("measured_contact_point")
    points = port.Eval(simulator.get_context()).reshape(-1, 3)
    return points, perf_counter() - begun


def d1(k: int) -> cs.Scene:
    """D1 for a second in point contact, with an early window, and friction and offset by k."""
    scene = cs.load_scene("D1")
    offset = cs.ObjectRateOffset(contact=0, start=0.3, stop=0.6, value=(0.1 * (k % 20), 0.5))
    drake = scene.drake | {"contact_model": "point", "friction": 0.1 + 0.05 * (k // 20)}
    return scene.replace(name=f"D1 {k}", duration=1.0, disturbances=[offset], drake=drake)


def sweep(full: bool) -> Iterator[Bar]:
    """Simulations on two processes, one of which is killed half-way, and on one core."""

    def alone(first: int) -> tuple[float, float]:
        begin, busy = perf_counter(), process_time()
        cs.sweep(map(d1, range(first, RUNS, 20)), outcome, each=True)
        part = RUNS / len(range(first, RUNS, 20))
        return part * (perf_counter() - begin), part * (process_time() - busy)

    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(2) as pool:
        killer = threading.Thread(target=_kill_one, args=(pool, Path(folder), RUNS // 2))
        one = [alone(3)]
        killer.start()
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
        found = cs.sweep(map(d1, range(RUNS)), outcome, pool, each=True, folder=folder)
        two = perf_counter() - begin
        killer.join()
        one.append(alone(13))
        table, failures = found.table, found.failures
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    verdicts = Counter(table["verdict"][table["contact"] == 0].tolist())
    lost = RUNS - len(set(table["scene"].tolist())) + len(failures)
    note = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    yield Bar(f"{RUNS} runs of D1, a worker killed half-way: missing", 0, lost, note=note)
    busy = after.ru_utime - before.ru_utime
    wall, cpu = (statistics.mean(spent) for spent in zip(*one))
    note = f"{wall:.0f} s over {two:.0f} s; by processor time {2 * cpu / busy:.2f} x: the workers "
    note += f"had {busy / two:.2f} of two cores"
    yield Bar("the same, two processes over one core", 1.8, wall / two, "x", True, note)


def _kill_one(pool: ProcessPoolExecutor, folder: Path, half: int) -> None:
    """Kill a worker once half of the results are there."""
    while len(list(folder.glob("*.npz"))) < half:
        sleep(0.05)
    os.kill(next(iter(pool._processes)), signal.SIGKILL)


SECTIONS: Sections = {
    "cost": cost,
    "cenic": cenic,
    "forces": forces,
    "rolling": rolling,
    "recovery": recovery,
    "feedback": feedback,
    "noise": noise,
    "reach": reach,
    "speed": speed,
    "schemes": schemes,
    "sweep": sweep,
}
