"""A hand, its object, driver and monitor in one Diagram, simulated from the start of a plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Diagram, DiagramBuilder
from scipy.interpolate import make_interp_spline

from contact_system.checks import finite_number

from .config import require_config
from .contact_monitor import ContactMonitor
from .hand_driver import HandDriver
from .hand_kinematics import moving_joints
from .plant import AddScenePlant, ScenePlant
from .reorientation import Reorientation
from .simulation import LOGGED, Asked, Run, SimulationResult
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
    run = Run(plan.scene, plan.config, partial(BuildHandStation, plan), recording)
    driver, plant = run.station.GetSubsystemByName("driver"), run.parts.plant
    own, physics = (system.GetMyContextFromRoot(run.root) for system in (driver, plant))
    joints = [joint.position_start() for joint in moving_joints(plant)]
    asked: Asked = {
        "q": lambda: plant.GetPositions(physics)[joints],
        "torque": partial(driver.GetOutputPort("torque").Eval, own),
    }
    t, said, measured = run.follow(duration, LOGGED, progress, asked)
    seen = t, _planned(plan, t), measured, said["pose"], *run.times
    wanted = np.array([plan.path.GetPose(x).GetAsMatrix4() for x in t])
    return run.filmed(
        HandResult(plan.rolling, plan.config, *seen, plan, wanted, said["q"], said["torque"])
    )


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
