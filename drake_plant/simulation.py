"""Simulate a station from its start, and log what is planned and measured."""

from __future__ import annotations

import gc
import math
import os
import time
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from contact_system import Scene, SceneError, plan
from contact_system.checks import Array, finite_number, of_kind
from contact_system.contact_sensor import ON_OBJECT, SLIP, STATES
from contact_system.files import a_path, writing
from contact_system.scene import scene_to_toml

from .balance import friction_used
from .config import StationConfig, checked
from .contact_monitor import COLUMNS
from .plant import ScenePlant
from .recording import Recording
from .reorientation import Reorientation, contacts_of, plan_reorientation
from .station import SetInitialState, build, build_hand

PLANNED = ("state", "slip", "contact_point")
BALANCED = ("normal_force", "friction_used")
NEAR = 1e-6  # part of a period by which rounding may let a step end before it
LOG_PERIOD = 2e-3  # s, of rows that simulate logs, unless steps are longer
INTEGRATION = SimulatorConfig(
    integration_scheme="runge_kutta3", accuracy=1e-3, max_step_size=1e-3, use_error_control=True
)
"""For a planner with a discrete plant: within 1.1e-5 m of the plan over all of D1."""
CONTINUOUS = copy(INTEGRATION)
CONTINUOUS.accuracy = 1e-5
"""For a planner with a continuous plant: at 1e-4 integrators' errors make friction in rolling."""


@dataclass(eq=False, repr=False)
class SimulationResult:
    """What :func:`simulate` logged: about every 2 ms, at the end of every step in which a finger is
    off the object (of a continuous plant every 1 ms), and at the end of the last whole step. m
    times, n contacts; SI units.

    Attributes
    ----------
    scene, config
    t : (m,)
    planned : dict
        state (m, n, 9), slip (m, n, 2), contact_point (m, n, 3), which is on the object, in O;
        of wanted forces normal_force (m, n) and friction_used (m, n), the part of each friction
        cone; with restarts first_contact_point (m, n, 3), of the plan before any restart.
    measured : dict
        slip (m, n, 2), normal_force (m, n), tangential_force (m, n, 2), contact_point (m, n, 3),
        state (m, n, 9), friction_used (m, n), of the step that ended at t. friction_used is NaN
        without contact or friction.
    object_pose : (m, 4, 4)
        X_WO.
    build_time, wall_time : float
        s, of making the Diagram and of simulating it.
    """

    scene: Scene
    config: StationConfig
    t: Array
    planned: Mapping[str, Array]
    measured: Mapping[str, Array]
    object_pose: Array
    build_time: float
    wall_time: float

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the logs.

        ``.npz``: a scene that gives the same result (as TOML text, with the settings as its [drake]
        table), all logs, such as ``planned_slip`` and ``measured_slip``, and the other arrays, such
        as t and object_pose.
        ``.csv``: forces, slip and contact points, one line for each time and contact.

        Raises
        ------
        ContactSystemError
            An unknown ending, or a file that cannot be written.
        """
        path = a_path(path, endings=(".npz", ".csv"))
        with writing(path, f"{self.scene.title}: ") as file:
            if path.suffix == ".csv":
                self._write_csv(file)
                return
            logs: dict[str, Any] = {}
            for kind in ("planned", "measured"):
                logs |= {f"{kind}_{name}": x for name, x in getattr(self, kind).items()}
            logs |= {name: x for name, x in vars(self).items() if isinstance(x, np.ndarray)}
            np.savez_compressed(file, scene=np.array(scene_to_toml(self._given())), **logs)

    def _given(self) -> Scene:
        """A scene whose simulation gives this result."""
        return self.scene.replace(drake=self.config.table())

    def _write_csv(self, file: BinaryIO) -> None:
        head = ["t [s]", "contact", "normal force [N]"]
        columns = [self.measured["normal_force"][:, :, None]]
        for kind, name, axes, unit in (
            ("measured", "tangential force", "xy", "N"),
            ("measured", "slip", "xy", "m/s"),
            ("planned", "slip", "xy", "m/s"),
            ("measured", "contact point", "xyz", "m"),
            ("planned", "contact point", "xyz", "m"),
        ):
            title = name if kind == "measured" else f"planned {name}"
            head += [f"{title} {axis} [{unit}]" for axis in axes]
            columns.append(getattr(self, kind)[name.replace(" ", "_")])
        table = np.concatenate(columns, axis=2)
        m, n, width = table.shape
        whose = np.repeat(self.t, n), np.tile(np.arange(n), m)
        rows = np.column_stack([*whose, table.reshape(m * n, width)])
        form = ["%s", "%d", *["%s"] * width]
        np.savetxt(file, rows, form, ",", header=",".join(head), comments="")


@dataclass(eq=False, repr=False)
class HandResult(SimulationResult):
    """A :class:`SimulationResult` of a hand. It also has, at m times:

    Attributes
    ----------
    plan : Reorientation
    wanted_pose : (m, 4, 4)
        X_WO as planned.
    q, torque : (m, nq)
    """

    plan: Reorientation
    wanted_pose: Array
    q: Array
    torque: Array

    def _given(self) -> Scene:
        return self.plan.scene  # `scene` has smaller bodies, which roll alike once pressed together


def simulate(
    scene: Scene,
    config: StationConfig | None = None,
    duration: float | None = None,
    progress: Callable[[float], None] | None = None,
    recording: str | Path | None = None,
) -> SimulationResult:
    """Build the station of a scene, simulate it, and log what is planned and measured.

    Parameters
    ----------
    scene : Scene
    config : StationConfig, optional
        None: ``StationConfig.from_scene(scene)``.
    duration : float, optional
        s; None: the scene's.
    progress : callable, optional
        Called now and then with the simulated time, s.
    recording : path, optional
        Write a single-file Meshcat recording there; it ends in .html.

    Raises
    ------
    SceneError
        A duration not finite, shorter than a time step, or so long that there is no plan for it;
        a recording in a folder that does not exist; what :func:`BuildStation` raises.
    """
    gc.collect()  # Diagrams are reference cycles: free those of earlier runs
    config = checked(scene, config, "station")
    duration = _checked_duration(scene, config, duration)
    if config.hand is not None:
        planned_hand = plan_reorientation(config.hand, scene, config=config)
        return simulate_hand(planned_hand, duration, progress, recording)
    # the meshes of a longer simulation have to reach as far as its contacts go
    whole = scene if duration <= scene.duration else scene.replace(duration=duration)
    run = Run(scene, partial(build, whole, config, until=duration), recording)
    station, root = run.station, run.root
    SetInitialState(station, root)
    names = [*PLANNED, *(f"planned_{name}" for name in BALANCED if config.balances)]
    logged: Logged = {name: partial(station.GetOutputPort(name).Eval, root) for name in names}
    t, logs, measured = run.advance(duration, progress, logged)
    planned = {name: logs[name].reshape(len(t), len(scene.contacts), -1) for name in PLANNED}
    planned["contact_point"] = planned["contact_point"][:, :, 3:]
    for name, constant in zip(BALANCED, (config.normal_force, 0.0)):
        unbalanced = np.full_like(measured["normal_force"], constant)
        planned[name] = logs.get(f"planned_{name}", unbalanced)
    if config.restarts:
        first = plan(station.GetSubsystemByName("planner").system.scene)
        planned["first_contact_point"] = first.points(t)[:, :, 1]
    result = SimulationResult(scene, config, t, planned, measured, logs["pose"], *run.times)
    run.film(result)
    return result


def simulate_hand(
    plan: Reorientation,
    duration: float | None = None,
    progress: Callable[[float], None] | None = None,
    recording: str | Path | None = None,
) -> HandResult:
    """Simulate a plan from its start: see :func:`simulate`."""
    of_kind(Reorientation, plan, "plan", "a Reorientation")
    duration = _checked_duration(plan.scene, plan.config, duration)
    run = Run(plan.scene, partial(build_hand, plan), recording)
    driver, plant = run.station.GetSubsystemByName("driver"), run.parts.plant
    control, physics = (system.GetMyContextFromRoot(run.root) for system in (driver, plant))
    logged: Logged = {
        "q": lambda: plant.GetPositions(physics)[driver.at_q],
        "torque": partial(driver.GetOutputPort("torque").Eval, control),
    }
    t, logs, measured = run.advance(duration, progress, logged)
    seen = t, _hand_planned(plan, t), measured, logs["pose"], *run.times
    wanted = np.array([plan.wanted(x).GetAsMatrix4() for x in t])
    result = HandResult(plan.rolling, plan.config, *seen, plan, wanted, logs["q"], logs["torque"])
    run.film(result)
    return result


def _checked_duration(scene: Scene, config: StationConfig, duration: float | None) -> float:
    """How long a simulation lasts, s; the scene's duration if None is given."""
    duration = scene.duration if duration is None else duration
    step = config.time_step or CONTINUOUS.max_step_size
    if not finite_number(duration, f"{scene.title}: duration") >= step:
        raise SceneError(
            f"{scene.title}: a simulation of {duration!r} s with a time_step of {step:g} "
            "s: give a finite time of at least one step"
        )
    return duration


def _hand_planned(plan: Reorientation, t: Array) -> dict[str, Array]:
    """`SimulationResult.planned` of a hand's plan at times t, with joints and forces as its driver
    interpolates them."""
    inside, joints = np.clip(t, *plan.t[[0, -1]]), CubicHermiteSpline(plan.t, plan.q, plan.v)
    found = contacts_of(plan.chains, plan.path, inside, joints(inside), joints(inside, 1))
    pressing = np.einsum("mij,mij->mi", plan.forces, plan.normals)
    loads = make_interp_spline(plan.t, np.stack([pressing, plan.cones]), k=1, axis=1)(inside)
    for k, rests in enumerate((t <= plan.t[0], t >= plan.t[-1])):
        forces, normals = plan.resting[k], plan.normals[-k]
        loads[0, rests] = np.sum(forces * normals, axis=-1)
        loads[1, rests] = friction_used(forces, normals, plan.config.friction)
    parts = {"state": np.unwrap(found[..., STATES], axis=0), "slip": found[..., SLIP]}
    return parts | {"contact_point": found[..., ON_OBJECT]} | dict(zip(BALANCED, loads))


Logged = dict[str, Callable[[], Any]]
"""Functions that give the current values, by the names of the logs that they are noted in."""


class Run:
    """A simulation of a station, and its logs.

    Attributes
    ----------
    station, parts : Diagram and ScenePlant that ``make`` gave, with visualizers for a recording
    root : Context
    times : s, of making the station and of simulating it
    """

    def __init__(
        self,
        scene: Scene,
        make: Callable[[], tuple[DiagramBuilder, ScenePlant]],
        recording: str | Path | None,
    ):
        # refuse a wrong path now, not after hours of simulation
        self._path = None if recording is None else film_path(scene, recording)
        self._begun = time.perf_counter()
        builder, self.parts = make()
        self._film = None if recording is None else Recording(builder, self.parts)
        self.station = builder.Build()
        self._simulator = Simulator(self.station)
        discrete = self.parts.config.time_step > 0
        ApplySimulatorConfig(INTEGRATION if discrete else CONTINUOUS, self._simulator)
        self.root = self._simulator.get_mutable_context()

    def advance(
        self, duration: float, progress: Callable[[float], None] | None, logged: Logged
    ) -> tuple[Array, dict[str, Array], dict[str, Array]]:
        """Simulate to the end; returns times, logs (with the object's pose), and measurements."""
        config, plant, rows = self.parts.config, self.parts.plant, []
        # a continuous plant is read at the ends of equal times
        step = config.time_step or duration / math.ceil(duration / CONTINUOUS.max_step_size - NEAR)
        every = max(1, math.floor(min(LOG_PERIOD, duration) / step + NEAR))
        last = math.floor(duration / step + NEAR)
        physics = plant.GetMyContextFromRoot(self.root)
        monitor = self.station.GetSubsystemByName("monitor")
        measured = partial(monitor.measured, monitor.GetMyContextFromRoot(self.root))
        logged = logged | {
            "t": self.root.get_time,
            "pose": lambda: self.parts.object_body.EvalPoseInWorld(physics).GetAsMatrix4(),
            "measured": measured,
        }
        self._simulator.Initialize()
        made = time.perf_counter()
        for k in range(last + 1):
            if k:  # at the start it would make the plant's first step
                self._simulator.AdvanceTo(min(k * step, duration))
            if progress is not None:
                progress(self.root.get_time())
            touch = measured()[:, COLUMNS["normal_force"]] > 0
            if k % every == 0 or k == last or not touch.all():
                rows.append([np.array(value()) for value in logged.values()])
        self.times = made - self._begun, time.perf_counter() - made
        logs = {name: np.array(values) for name, values in zip(logged, zip(*rows))}
        return logs["t"], logs, _measurements(logs["measured"], config)

    def film(self, result: SimulationResult) -> None:
        """Write the recording that shows a result, if one is wanted."""
        if self._film and self._path:
            self._film.Save(self._path, result)


def film_path(scene: Scene, recording: str | Path) -> Path:
    """The path of a recording; refuses one that cannot be written."""
    path = a_path(recording, f"{scene.title}: recording")
    if not path.parent.is_dir() or path.is_dir() or path.suffix != ".html":
        raise SceneError(
            f"{scene.title}: recording = {str(path)!r}: give a path that ends in '.html', in a "
            "folder that exists"
        )
    return path


def _measurements(rows: Array, config: StationConfig) -> dict[str, Array]:
    """`SimulationResult.measured` of the monitor's rows (m, n, 17)."""
    measured = {name: rows[:, :, columns] for name, columns in COLUMNS.items()}
    normal = measured["normal_force"] = measured["normal_force"][:, :, 0]
    forces = np.dstack([measured["tangential_force"], normal])
    measured["friction_used"] = friction_used(forces, [0.0, 0.0, 1.0], config.friction)
    return measured
