"""ContactPlanner in Drake: cost of a derivative, and what cenic makes of it.

Costs are those of one evaluation of the derivatives inside a Simulator, beside a LeafSystem with as
many states that does nothing, in turns in one process.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem, System

import contact_system as cs
from drake_plant import ContactPlanner, PlanSource

from .report import Bar, Sections
from .timing import Job, interleaved

COORDINATES = ("chart", "frame")
TITLES = {"K1": "on a sphere", "D1": "on a sphere, with a window", "K3": "on an ellipsoid"}
TIMED, EVALUATIONS = 0.3, 900
"""s simulated in one sample of a cost, in steps of 1 ms by runge_kutta3."""


def simulator_of(
    system: System, scheme: str, step: float, accuracy: float | None = None
) -> Simulator:
    """A Simulator with steps of equal length, or with error control."""
    simulator = Simulator(system)
    control = {"use_error_control": accuracy is not None, "accuracy": accuracy or 1e-3}
    config = SimulatorConfig(integration_scheme=scheme, max_step_size=step, **control)
    ApplySimulatorConfig(config, simulator)
    simulator.Initialize()
    return simulator


class Empty(LeafSystem):
    """So many continuous states, and derivatives that nobody computes."""

    def __init__(self, x0: np.ndarray):
        super().__init__()
        self.DeclareContinuousState(BasicVector(x0))

    def DoCalcTimeDerivatives(self, context: Context, derivatives: Any) -> None:
        pass


def _job(system: LeafSystem) -> Job:
    make = partial(simulator_of, system, "runge_kutta3", 1e-3)
    return Job(lambda simulator: simulator.AdvanceTo(TIMED), make)


def cost(full: bool) -> Iterator[Bar]:
    """One evaluation of the derivatives in a Simulator, over an empty system's."""
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
            limit, note = None if name == "K3" else 4.0, f"empty takes {empty:.3g} us"
            what = f"3 spheres {title}, {coordinates}: over empty"
            yield Bar(what, limit, own - empty, "us", note=note)


def cenic(full: bool) -> Iterator[Bar]:
    """D1 to 0.5 s beside a continuous plant, whose error alone cenic controls."""
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


SECTIONS: Sections = {"cost": cost, "cenic": cenic}
