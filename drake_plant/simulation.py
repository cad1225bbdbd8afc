"""A station simulated from its start, with what planner and monitor say along the way."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import Context, Diagram, EventStatus

from contact_system import Scene, SceneError
from contact_system.checks import a_path, finite_number, function_or_none

from .config import StationConfig
from .contact_gauge import COLUMNS
from .planner_base import PORTS
from .plant import ScenePlant
from .reorientation import plan_reorientation
from .station import SetInitialState, build, checked

Array = NDArray[np.float64]

PLANNED = ("state", "slip", "contact_point")
BALANCED = ("normal_force", "friction_used")
MEASURED = ("state", "slip", "normal_force", "tangential_force", "contact_point")
NEAR = 1e-6  # of a period, by which a step may end before it
LOGGED = 2e-3  # s, at which simulate logs where steps are shorter
INTEGRATION = SimulatorConfig(
    integration_scheme="runge_kutta3", accuracy=1e-3, max_step_size=1e-3, use_error_control=True
)
"""Of the planner's states beside a discrete plant: within 5e-6 m of the plan over all of D1."""
CONTINUOUS = SimulatorConfig(
    integration_scheme="runge_kutta3", accuracy=1e-4, max_step_size=1e-3, use_error_control=True
)
"""Of a continuous plant: with a larger accuracy the planner is further off than it may be."""


@dataclass
class SimulationResult:
    """What :func:`simulate` saw, about every 2 ms and at the end of every step in which a finger is
    off the object. m times, n contacts; SI units.

    Attributes
    ----------
    scene, config
    t : (m,)
    planned : dict
        state (m, n, 9), slip (m, n, 2), contact_point (m, n, 3), the latter on the object, in O;
        normal_force (m, n) and friction_used (m, n), the part of each cone, of what is asked for.
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
        Write a single-file Meshcat recording there.

    Raises
    ------
    SceneError
        A duration shorter than a time step, or not finite; a recording in a folder that does not
        exist; what :func:`BuildStation` raises.
    """
    gc.collect()  # Diagrams are cycles: free those of runs before this one
    config = checked(scene, config)
    duration = scene.duration if duration is None else duration
    step = config.time_step or CONTINUOUS.max_step_size
    if not finite_number(duration, f"{scene.title}: duration") >= step:
        raise SceneError(
            f"{scene.title}: a simulation of {duration!r} s with a time_step of {step:g} "
            "s: give a finite time of at least one step"
        )
    period = step * max(1, math.floor(min(LOGGED, duration) / step + NEAR))
    function_or_none(progress, f"{scene.title}: progress", "a function of a time")
    film = None
    if recording is not None:
        recording = a_path(recording, f"{scene.title}: recording")
        if not recording.parent.is_dir() or recording.is_dir():
            raise SceneError(
                f"{scene.title}: recording = {str(recording)!r}: no file can be written "
                "there; give a path in a folder that exists, such as 'film.html'"
            )
        from .recording import Recording

        film = Recording()

    if config.hand is not None:
        from .hand_station import simulate_hand

        planned_hand = plan_reorientation(config.hand, scene, config=config)
        return simulate_hand(planned_hand, duration, progress, film, recording)

    begun = time.perf_counter()
    station, parts = build(scene, config, None if film is None else film.Add)
    simulator = Simulator(station)
    ApplySimulatorConfig(INTEGRATION if config.time_step else CONTINUOUS, simulator)
    context = simulator.get_mutable_context()
    SetInitialState(station, context)
    log = _Log(station, context, parts, period)

    def note(root: Context) -> EventStatus:
        log.note(root)
        if progress is not None:
            progress(root.get_time())
        return EventStatus.DidNothing()

    simulator.set_monitor(note)
    simulator.Initialize()
    built = time.perf_counter()
    simulator.AdvanceTo(duration)
    finished = time.perf_counter()
    log.note(context, last=True)

    t, planned, measured, poses = log.read()
    result = SimulationResult(
        scene, config, t, planned, measured, poses, built - begun, finished - built
    )
    if film is not None and recording is not None:
        film.Save(recording, result)
    return result


class _Log:
    """What planner and monitor say and where the object is, at ends of steps: about a period apart,
    and of every step in which a finger is off the object."""

    def __init__(self, station: Diagram, root: Context, parts: ScenePlant, period: float):
        self._config, physics = parts.config, parts.plant.GetMyContextFromRoot(root)
        monitor = station.GetSubsystemByName("monitor")
        self._asked: dict[str, Callable[[], Array]] = {
            "pose": lambda: parts.object_body.EvalPoseInWorld(physics).GetAsMatrix4(),
            "measured": partial(monitor.Measured, monitor.GetMyContextFromRoot(root)),
        }
        planner = station.GetSubsystemByName("planner")
        own = planner.GetMyContextFromRoot(root)
        self._asked["planned"] = partial(planner.Evaluate, own, *PLANNED)
        if station.HasSubsystemNamed("balancer"):
            balancer = station.GetSubsystemByName("balancer")
            own = balancer.GetMyContextFromRoot(root)
            self._asked |= {name: partial(balancer.Evaluate, own, name) for name in BALANCED}
        ports = parts.plant.get_generalized_contact_forces_output_port
        instances = [body.model_instance() for body in parts.finger_bodies]
        self._pressing = [partial(ports(instance).Eval, physics) for instance in instances]
        self._period, self._next = period, 0.0
        self._t: list[float] = []
        self._rows: list[list[Array]] = []

    def note(self, root: Context, last: bool = False) -> None:
        t = root.get_time()
        due = t >= self._next or (last and t > self._t[-1])
        if not due and all(force().any() for force in self._pressing):
            return
        whole = math.floor(t / self._period + 0.5 * NEAR)
        self._next = (whole + 1 - NEAR) * self._period
        self._t.append(t)
        self._rows.append([ask().copy() for ask in self._asked.values()])

    def read(self) -> tuple[Array, dict[str, Array], dict[str, Array], Array]:
        """Times, planned and measured as in a SimulationResult, poses of the object."""
        said = {name: np.array(values) for name, values in zip(self._asked, zip(*self._rows))}
        ends = np.cumsum([PORTS[name] for name in PLANNED])[:-1]
        planned = dict(zip(PLANNED, np.split(said["planned"], ends, axis=2)))
        planned["contact_point"] = planned["contact_point"][:, :, 3:]
        measured = {name: said["measured"][:, :, COLUMNS[name]] for name in MEASURED}
        normal = measured["normal_force"] = measured["normal_force"][:, :, 0]
        for name, constant in zip(BALANCED, (self._config.normal_force, 0.0)):
            value = said[name][:, :, 0] if name in said else constant
            planned[name] = np.full_like(normal, value)
        friction = np.linalg.norm(measured["tangential_force"], axis=2)
        limit = self._config.friction * normal
        nothing = np.full_like(limit, math.nan)
        measured["friction_used"] = np.divide(friction, limit, out=nothing, where=limit > 0)
        return np.array(self._t), planned, measured, said["pose"]
