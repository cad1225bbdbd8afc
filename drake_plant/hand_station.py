"""A hand, its object, driver and monitor in one Diagram, simulated from the start of a plan."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from scipy.interpolate import make_interp_spline

from contact_system.checks import finite_number

from .config import require_config
from .contact_monitor import ContactMonitor
from .hand_driver import HandDriver
from .hand_kinematics import moving_joints
from .plant import AddScenePlant, ScenePlant
from .recording import Recording
from .reorientation import Reorientation
from .simulation import LOGGED, Asked, Log, SimulationResult, film_path, measurements
from .station import add_pushes, wire

Array = NDArray[np.float64]


@dataclass(eq=False, repr=False)
class HandResult(SimulationResult):
    """A :class:`SimulationResult` of a hand, and besides, m times:

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


def BuildHandStation(
    plan: Reorientation, extend: Callable[[DiagramBuilder, ScenePlant], None] | None = None
) -> tuple[Diagram, ScenePlant]:
    """Plant, :class:`HandDriver` and :class:`ContactMonitor` of a plan, wired.

    The systems are named "plant", "scene_graph", "driver", "monitor", and "push" where there are
    pushes; else the driver's port is exported as `push`. The plant's default state is the start.
    """
    require_config(plan, Reorientation, "plan")
    builder = DiagramBuilder()
    parts = AddScenePlant(builder, plan.scene, plan.config)
    plant = parts.plant
    driver = builder.AddNamedSystem("driver", HandDriver(plan, parts))
    monitor = builder.AddNamedSystem("monitor", ContactMonitor(plan.rolling, parts))
    wire(builder, plant, driver, "state", "body_poses")
    wire(builder, plant, monitor, "contact_results", "body_poses", "body_spatial_velocities")
    if plan.config.slip_gain:
        wire(builder, monitor, driver, "sliding")
    builder.Connect(
        driver.GetOutputPort("generalized_force"), plant.get_applied_generalized_force_input_port()
    )
    add_pushes(builder, plan.scene, plan.config, driver)
    plant.SetDefaultFloatingBaseBodyPose(parts.object_body, plan.path.GetPose(0.0))
    for joint, position in zip(moving_joints(plant), plan.q[0]):
        joint.set_default_positions([position])
    if extend is not None:
        extend(builder, parts)
    return builder.Build(), parts


def simulate_hand(
    plan: Reorientation,
    duration: float | None = None,
    progress: Callable[[float], None] | None = None,
    recording: str | Path | None = None,
) -> HandResult:
    """Simulate a plan from its start: see :func:`simulate`."""
    require_config(plan, Reorientation, "plan")
    duration = plan.scene.duration if duration is None else duration
    finite_number(duration, f"{plan.scene.title}: duration", "above 0")
    film = None
    if recording is not None:
        recording, film = film_path(plan.scene, recording), Recording()
    begun = time.perf_counter()
    station, parts = BuildHandStation(plan, None if film is None else film.Add)
    simulator = Simulator(station)
    root = simulator.get_mutable_context()
    driver, physics = station.GetSubsystemByName("driver"), parts.plant.GetMyContextFromRoot(root)
    torques, own = driver.GetOutputPort("torque"), driver.GetMyContextFromRoot(root)
    joints = [joint.position_start() for joint in moving_joints(parts.plant)]
    asked: Asked = {
        "q": lambda: parts.plant.GetPositions(physics)[joints],
        "torque": lambda: torques.Eval(own),
    }
    log = Log(station, root, parts, asked, LOGGED)
    ended = log.follow(simulator, duration, progress)
    t, said = log.read()
    result = HandResult(
        plan.rolling,
        plan.config,
        t,
        _planned(plan, t),
        measurements(said, plan.config),
        said["pose"],
        log.begun - begun,
        ended - log.begun,
        plan,
        np.array([plan.path.GetPose(x).GetAsMatrix4() for x in t]),
        said["q"],
        said["torque"],
    )
    if film is not None and recording is not None:
        film.Save(recording, result)
    return result


def _planned(plan: Reorientation, t: Array) -> dict[str, Array]:
    """What is planned, as a SimulationResult has it."""
    inside = np.clip(t, plan.t[0], plan.t[-1])
    planned = {
        "state": np.unwrap(plan.states, axis=0),
        "slip": np.zeros((*plan.states.shape[:2], 2)),
        "contact_point": plan.points[:, :, 1],
        "normal_force": np.einsum("mij,mij->mi", plan.forces, plan.normals),
        "friction_used": plan.cones,
    }
    return {key: make_interp_spline(plan.t, x, k=1)(inside) for key, x in planned.items()}
