"""Set-ups of `truth_exact` in Drake, on the plants that `drake_plant.AddScenePlant` makes."""

from __future__ import annotations

import math
import time
from importlib import metadata
from typing import NamedTuple

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialForce, SpatialVelocity
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    EventStatus,
    LeafSystem,
    OutputPort,
)
from scipy.spatial.transform import Rotation

import contact_system as cs
from drake_plant import AddScenePlant, StationConfig

from .truth_exact import MASS, Drive, Ended, Setup, setups

VERSION = f"Drake {metadata.version('drake')}"
STIFFNESS = 1e4
"""N/m, of the contact at its normal force."""
BALL = "finger_0"


class Method(NamedTuple):
    """A contact model, and an approximation of the discrete plant, or an integration scheme of a
    continuous one, for which an accuracy takes the place of the step."""

    name: str
    model: str
    approximation: str = "sap"
    scheme: str = ""


MODELS = ("point", "hydroelastic")
METHODS = [Method(f"{m}, {a}", m, a) for m in MODELS for a in ("sap", "lagged")]
SCHEMES = ("runge_kutta3", "cenic")
METHODS += [Method(f"{m}, {s}", m, "lagged", s) for m in MODELS for s in SCHEMES]


def takes(setup: Setup, method: Method) -> bool:
    """Whether `AddScenePlant` does not refuse it: a turning object needs a discrete plant, and the
    normal of point contact between ellipsoid and sphere is up to 16 degrees off."""
    round_ = method.model != "point" or not isinstance(setup.surface, cs.Ellipsoid)
    return round_ and not (setup.table and method.scheme)


def run(name: str, method: Method, step: float, limit: float = math.inf) -> Ended:
    """Simulate a set-up by a method, with a step or an accuracy; give up after ``limit`` s."""
    depth = setups()[name].pressed / STIFFNESS * (1 if method.model == "point" else 2)
    setup = setups(*((depth / 2, depth / 2) if method.model == "point" else (depth, 0.0)))[name]
    simulator, plant = _built(setup, method, step)
    end = setup.end if method.scheme else round(setup.end / step) * step
    begin = time.thread_time()

    def watch(root: Context) -> EventStatus:
        if time.thread_time() - begin < limit:
            return EventStatus.DidNothing()
        return EventStatus.ReachedTermination(plant, "given up")

    if math.isfinite(limit):
        simulator.set_monitor(watch)
    simulator.AdvanceTo(end)
    spent = time.thread_time() - begin
    context = plant.GetMyContextFromRoot(simulator.get_context())
    quaternion, x, _, v = np.split(_state(plant).Eval(context), [4, 7, 10])
    turned = Rotation.from_quat(quaternion, scalar_first=True)
    t = simulator.get_context().get_time()
    return Ended(setup, t, x, v, turned, spent, whole=t > end - 1e-9)


def _state(plant: MultibodyPlant) -> OutputPort:
    """State of the ball (13,): quaternion, position, angular velocity, velocity."""
    return plant.get_state_output_port(plant.GetModelInstanceByName(BALL))


def _built(setup: Setup, method: Method, step: float) -> tuple[Simulator, MultibodyPlant]:
    """Simulator and plant at the start of the set-up, with the ball as deep as it is pressed."""
    config = StationConfig(
        time_step=0.0 if method.scheme else step,
        contact_model=method.model,
        discrete_contact_approximation=method.approximation,
        object="turning" if setup.table else "welded",
        finger_mass=MASS,
        normal_force=setup.pressed,
        stiffness=STIFFNESS,
        friction=setup.friction,
    )
    builder = DiagramBuilder()
    parts = AddScenePlant(builder, setup.scene, config)
    plant, ball = parts.plant, parts.finger_bodies[0]
    plant.mutable_gravity_field().set_gravity_vector(setup.gravity)
    if setup.guide:
        wrench = builder.AddSystem(_Wrench(Drive(setup, config.time_step), ball.index()))
        builder.Connect(_state(plant), wrench.get_input_port())
        builder.Connect(wrench.get_output_port(), plant.get_applied_spatial_force_input_port())
    simulator = Simulator(builder.Build())
    if method.scheme:
        scheme = {"integration_scheme": method.scheme, "accuracy": step, "max_step_size": 0.1}
        ApplySimulatorConfig(SimulatorConfig(**scheme, use_error_control=True), simulator)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    start = setup.motion(np.zeros(1))
    turn = RotationMatrix(start.turned[0].as_matrix())
    plant.SetFreeBodyPose(context, ball, RigidTransform(turn, start.x[0]))
    moving = SpatialVelocity(start.w[0], start.v[0])
    plant.SetFreeBodySpatialVelocity(context=context, body=ball, V_JpJc=moving)
    simulator.Initialize()
    return simulator, plant


class _Wrench(LeafSystem):
    """The wrench of a `Drive` for the ball's state (13,), as an applied force of a plant."""

    def __init__(self, drive: Drive, ball: BodyIndex):
        super().__init__()
        self._drive, self._force = drive, ExternallyAppliedSpatialForce()
        self._force.body_index, self._force.p_BoBq_B = ball, np.zeros(3)
        self.DeclareVectorInputPort("state", 13)
        made = lambda: Value([ExternallyAppliedSpatialForce()])  # noqa: E731
        self.DeclareAbstractOutputPort("wrench", made, self._calc)

    def _calc(self, context: Context, output: Value) -> None:
        q, x, w, v = np.split(self.get_input_port().Eval(context), [4, 7, 10])
        turned = Rotation.from_quat(q, scalar_first=True).as_matrix()
        wrench = self._drive(context.get_time(), x, v, turned, w)
        self._force.F_Bq_W = SpatialForce(wrench[:3], wrench[3:])
        output.set_value([self._force])
