"""A station simulated from its start, with what planner and monitor say along the way."""

from __future__ import annotations

import gc
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, EventStatus

from contact_system import ContactSystemError, Scene, SceneError, plan
from contact_system.checks import a_path, finite_number
from contact_system.scene import scene_to_toml
from contact_system.writing import writing

from .balance import friction_used
from .config import StationConfig, checked
from .contact_gauge import COLUMNS
from .planner_base import PORTS
from .plant import ScenePlant
from .recording import Recording
from .reorientation import plan_reorientation
from .station import SetInitialState, build

Array = NDArray[np.float64]

PLANNED = ("state", "slip", "contact_point")
BALANCED = ("normal_force", "friction_used")
NEAR = 1e-6  # of a period, by which a step may end before it
LOGGED = 2e-3  # s, at which simulate logs where steps are shorter
INTEGRATION = SimulatorConfig(
    integration_scheme="runge_kutta3", accuracy=1e-3, max_step_size=1e-3, use_error_control=True
)
"""Of the planner's states beside a discrete plant: within 1.1e-5 m of the plan over all of D1."""
CONTINUOUS = SimulatorConfig(
    integration_scheme="runge_kutta3", accuracy=1e-4, max_step_size=1e-3, use_error_control=True
)
"""Of a continuous plant: with a larger accuracy the planner is further off than it may be."""


@dataclass(eq=False, repr=False)
class SimulationResult:
    """What :func:`simulate` saw, about every 2 ms and at the end of every step in which a finger is
    off the object. m times, n contacts; SI units.

    Attributes
    ----------
    scene, config
    t : (m,)
    planned : dict
        state (m, n, 9), slip (m, n, 2), contact_point (m, n, 3), the latter on the object, in O;
        normal_force (m, n) and friction_used (m, n), the part of each cone, of what is asked for;
        with restarts first_contact_point (m, n, 3), as it was before any.
    measured : dict
        slip (m, n, 2), normal_force (m, n), tangential_force (m, n, 2), contact_point (m, n, 3),
        state (m, n, 9), friction_used (m, n): those of the step that ended at t. The latter is NaN
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

        ``.npz``: the scene (as TOML text, its [drake] table what `config` says), all logs, such as
        ``planned_slip`` and ``measured_slip``, and the other arrays, such as t and object_pose.
        ``.csv``: forces, slip and contact points, one line a time and contact.

        Raises
        ------
        ContactSystemError
            An unknown ending, or a file that cannot be written.
        """
        path = a_path(path)
        if path.suffix not in (".npz", ".csv"):
            raise ContactSystemError(f"{path}: unknown ending {path.suffix!r}; use .npz or .csv")
        with writing(path, f"{self.scene.title}: ") as file:
            if path.suffix == ".csv":
                self._write_csv(file)
                return
            logs: dict[str, Any] = {
                f"{kind}_{name}": values
                for kind, table in (("planned", self.planned), ("measured", self.measured))
                for name, values in table.items()
            }
            own = {field.name: getattr(self, field.name) for field in fields(self)}
            logs |= {key: values for key, values in own.items() if isinstance(values, np.ndarray)}
            settings = {key: x for key, x in asdict(self.config).items() if x is not None}
            scene = scene_to_toml(self.scene.replace(drake=settings))
            np.savez_compressed(file, scene=np.array(scene), **logs)

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


def simulate(
    scene: Scene,
    config: StationConfig | None = None,
    duration: float | None = None,
    progress: Callable[[float], None] | None = None,
    recording: str | Path | None = None,
) -> SimulationResult:
    """Build the station of a scene, simulate it, and return what was planned and measured.

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
        A duration shorter than a time step, not finite, or beyond the scene's where there is no
        plan; a recording in a folder that does not exist; what :func:`BuildStation` raises.
    """
    gc.collect()  # Diagrams are cycles: free those of runs before this one
    config = checked(scene, config, "station")
    duration = scene.duration if duration is None else duration
    step = config.time_step or CONTINUOUS.max_step_size
    if not finite_number(duration, f"{scene.title}: duration") >= step:
        raise SceneError(
            f"{scene.title}: a simulation of {duration!r} s with a time_step of {step:g} "
            "s: give a finite time of at least one step"
        )
    period = step * max(1, math.floor(min(LOGGED, duration) / step + NEAR))
    if config.hand is not None:
        from .hand_station import simulate_hand

        planned_hand = plan_reorientation(config.hand, scene, config=config)
        return simulate_hand(planned_hand, duration, progress, recording)
    film = None
    if recording is not None:
        recording, film = film_path(scene, recording), Recording()
    begun = time.perf_counter()
    # meshes have to reach as far as contacts go
    whole = scene if duration <= scene.duration else scene.replace(duration=duration)
    station, parts = build(whole, config, None if film is None else film.Add, duration)
    simulator = Simulator(station)
    ApplySimulatorConfig(INTEGRATION if config.time_step else CONTINUOUS, simulator)
    context = simulator.get_mutable_context()
    SetInitialState(station, context)
    planner = station.GetSubsystemByName("planner")
    own = planner.GetMyContextFromRoot(context)
    asked: Asked = {"planned": lambda: planner.Evaluate(own, *PLANNED)}
    for name in BALANCED if config.balances else ():
        asked[name] = partial(station.GetOutputPort(f"planned_{name}").Eval, context)
    log = Log(station, context, parts, asked, period)
    ended = log.follow(simulator, duration, progress)
    t, said = log.read()
    measured = measurements(said, config)
    planned = _planned(said, measured, config)
    if config.restarts:
        first = plan(planner.system.scene)
        planned["first_contact_point"] = first.points(t)[:, :, 1]
    result = SimulationResult(
        scene, config, t, planned, measured, said["pose"], log.begun - begun, ended - log.begun
    )
    if film is not None and recording is not None:
        film.Save(recording, result)
    return result


def film_path(scene: Scene, recording: str | Path) -> Path:
    """Where a film can be written; a simulation may take hours before it is."""
    path = a_path(recording, f"{scene.title}: recording")
    if not path.parent.is_dir() or path.is_dir() or path.suffix != ".html":
        raise SceneError(
            f"{scene.title}: recording = {str(path)!r}: give a path that ends in '.html', in a "
            "folder that exists"
        )
    return path


Asked = dict[str, Callable[[], Array]]


class Log:
    """Where the object is, what the monitor measures and what else is asked for, at ends of steps:
    about a period apart, and of every step in which a finger is off the object."""

    def __init__(
        self, station: Diagram, root: Context, parts: ScenePlant, asked: Asked, period: float
    ):
        plant, physics = parts.plant, parts.plant.GetMyContextFromRoot(root)
        monitor = station.GetSubsystemByName("monitor")
        self._measured = partial(monitor.measured, monitor.GetMyContextFromRoot(root))
        self._asked = asked | {"measured": self._measured}
        self._asked["pose"] = lambda: parts.object_body.EvalPoseInWorld(physics).GetAsMatrix4()
        self._step, self._period, self._next = plant.time_step(), period, 0
        self._t: list[float] = []
        self._rows: list[list[Array]] = []
        self.begun = math.nan

    def follow(
        self, simulator: Simulator, duration: float, progress: Callable[[float], None] | None
    ) -> float:
        """Simulate to the end; returns when that is reached, of `time.perf_counter`."""

        def note(root: Context) -> EventStatus:
            self._note(root)
            if progress is not None:
                progress(root.get_time())
            return EventStatus.DidNothing()

        simulator.set_monitor(note)
        simulator.Initialize()
        self.begun = time.perf_counter()
        simulator.AdvanceTo(duration)
        ended = time.perf_counter()
        self._note(simulator.get_context(), last=True)
        return ended

    def _note(self, root: Context, last: bool = False) -> None:
        t = root.get_time()
        steps = t / self._step if self._step else 0.0
        if abs(steps - round(steps)) > NEAR and not last:  # the planner's, within one of the plant
            return
        periods = math.floor(t / self._period + NEAR)
        due = periods >= self._next or (last and t > self._t[-1])
        if not due and (self._measured()[:, COLUMNS["normal_force"]] > 0).all():
            return
        self._next = periods + 1
        self._t.append(t)
        self._rows.append([ask().copy() for ask in self._asked.values()])

    def read(self) -> tuple[Array, dict[str, Array]]:
        """Times, and what was said then."""
        said = {name: np.array(values) for name, values in zip(self._asked, zip(*self._rows))}
        return np.array(self._t), said


def _planned(
    said: Mapping[str, Array], measured: Mapping[str, Array], config: StationConfig
) -> dict[str, Array]:
    """As a SimulationResult has it."""
    ends = np.cumsum([PORTS[name] for name in PLANNED])[:-1]
    planned = dict(zip(PLANNED, np.split(said["planned"], ends, axis=2)))
    planned["contact_point"] = planned["contact_point"][:, :, 3:]
    for name, constant in zip(BALANCED, (config.normal_force, 0.0)):
        planned[name] = said.get(name, np.full_like(measured["normal_force"], constant))
    return planned


def measurements(said: Mapping[str, Array], config: StationConfig) -> dict[str, Array]:
    """As a SimulationResult has them."""
    measured = {name: said["measured"][:, :, columns] for name, columns in COLUMNS.items()}
    normal = measured["normal_force"] = measured["normal_force"][:, :, 0]
    forces = np.dstack([measured["tangential_force"], normal])
    measured["friction_used"] = friction_used(forces, [0.0, 0.0, 1.0], config.friction)
    return measured
