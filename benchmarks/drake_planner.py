"""ContactPlanner in Drake: exactness under Drake's integrators, cost of a derivative, scalars.

Costs are those of one evaluation of the derivatives inside a Simulator, beside a LeafSystem with as
many states that does nothing, in turns in one process.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.symbolic import Expression, Variable
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import BasicVector, Context, LeafSystem

import contact_system as cs
from contact_system.errors import ContactSystemError
from contact_system.kernels import find_compiler
from contact_system.system import COORDINATES
from drake_plant import ContactPlanner

from .report import Bar
from .timing import Job, interleaved

SCENES = ("K1", "K2", "K3", "K4")
ORDERS = {
    "bogacki_shampine3": 3, "explicit_euler": 1, "implicit_euler": 1, "radau1": 1, "radau3": 3,
    "runge_kutta2": 2, "runge_kutta3": 3, "runge_kutta5": 5, "semi_explicit_euler": 1,
    "velocity_implicit_euler": 1,
}  # fmt: skip
# Longest steps with which order shows, and times that take in a window's edges where there are any.
STEPS, UNTIL = (4e-3, 2e-3), {"K1": 0.4, "K2": 0.4, "K3": 0.4, "K4": 1.2}
SLACK = 0.2  # of an order
TIMED = 0.3  # [s] simulated in one sample of a cost, in steps of 1 ms by runge_kutta3
EVALUATIONS = 900


def _simulator(
    system: LeafSystem, scheme: str, step: float, accuracy: float | None = None
) -> Simulator:
    simulator = Simulator(system)
    config = SimulatorConfig(
        integration_scheme=scheme, max_step_size=step, use_error_control=accuracy is not None,
        accuracy=accuracy or 1e-3,
    )  # fmt: skip
    ApplySimulatorConfig(config, simulator)
    simulator.Initialize()
    return simulator


def _error(
    planner: ContactPlanner, until: float, scheme: str, step: float, accuracy: float | None = None
) -> float:
    """Greatest distance of a contact point from plan()'s at the end, m."""
    simulator = _simulator(planner, scheme, step, accuracy)
    simulator.AdvanceTo(until)
    points = planner.GetOutputPort("contact_point").Eval(simulator.get_context())
    truth = cs.plan(planner.system.scene, 1e-13).points(until)[0]
    return float(np.linalg.norm(points.reshape(-1, 2, 3) - truth, axis=-1).max())


# --- integrators ---------------------------------------------------------------------------------


def exact(full: bool) -> Iterator[Bar]:
    """Contact points at the end of K1 to K4 with steps of 1e-4 s."""
    for coordinates in COORDINATES:
        for scheme in ("runge_kutta5", "radau3"):
            errors = {}
            for name in SCENES:
                planner = ContactPlanner(cs.load_scene(name), coordinates)
                errors[name] = _error(planner, planner.system.scene.duration, scheme, 1e-4)
            yield Bar(f"K1-K4 against plan(), {coordinates}: {scheme} at 1e-4 s", 1e-9,
                      max(errors.values()), "m", detail=errors)  # fmt: skip


def orders(full: bool) -> Iterator[Bar]:
    """How far the order seen on K1 to K4 stays behind the scheme's; and error control ends."""
    for scheme, order in ORDERS.items():
        seen, controlled = {}, {}
        for name in SCENES:
            planner = ContactPlanner(cs.load_scene(name))
            errors = [_error(planner, UNTIL[name], scheme, step) for step in STEPS]
            seen[name] = math.log2(errors[0] / errors[1])
            controlled[name] = _error(planner, UNTIL[name], scheme, 0.01, 1e-4)
        yield Bar(
            f"K1-K4, chart: {scheme} falls short of its order {order} by", SLACK,
            order - min(seen.values()),
            note=f"error control at 1e-4 ends within {max(controlled.values()):.1e} m",
            detail={"orders": seen, "error with error control, m": controlled},
        )  # fmt: skip


# --- cost ----------------------------------------------------------------------------------------


class Empty(LeafSystem):
    """So many continuous states, and derivatives that nobody computes."""

    def __init__(self, x0: np.ndarray):
        super().__init__()
        self.DeclareContinuousState(BasicVector(x0))

    def DoCalcTimeDerivatives(self, context: Context, derivatives: Any) -> None:
        pass


class Vectorised(Empty):
    """The chart equations of spheres on a sphere by numpy, all contacts at once; law "path"."""

    def __init__(self, scene: cs.Scene):
        super().__init__(cs.SceneSystem(scene).x0)
        self._profile, self._eta = scene.profile, scene.gain.value
        radii = [[c.finger.radius, scene.object.radius] for c in scene.contacts]  # type: ignore
        self._radius = np.array(radii)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: Any) -> None:
        t = context.get_time()
        x = context.get_continuous_state_vector().CopyToVector().reshape(-1, 9)
        sigma = self._profile(t)
        bodies = x[:, :8].reshape(-1, 2, 4)
        rates = bodies[..., 2:]
        sine, cosine = np.sin(bodies[..., 0]), np.cos(bodies[..., 0])
        lame = np.stack([self._radius, self._radius * sine], axis=-1)
        out = np.empty_like(x)
        change = out[:, :8].reshape(-1, 2, 4)
        change[..., :2] = rates
        change[..., 2:] = self._profile.rate(t) / sigma * rates
        change[..., 2] += sine * cosine * rates[..., 1] ** 2
        change[..., 3] -= 2 * cosine / sine * rates[..., 0] * rates[..., 1]
        a = lame[:, 0] * rates[:, 0]
        c, s = np.cos(x[:, 8]), np.sin(x[:, 8])
        rolled = np.stack([c * a[:, 0] - s * a[:, 1], -s * a[:, 0] - c * a[:, 1]], axis=-1)
        change[:, 1, 2:] += self._eta * sigma**2 * (rolled / lame[:, 1] - rates[:, 1])
        out[:, 8] = (cosine * rates[..., 1]).sum(axis=1)
        derivatives.SetFromVector(out.ravel())


def _job(system: LeafSystem) -> Job:
    return Job(lambda s: s.AdvanceTo(TIMED), partial(_simulator, system, "runge_kutta3", 1e-3))


def cost(full: bool) -> Iterator[Bar]:
    """One evaluation of the derivatives in a Simulator, over an empty system's."""
    systems: dict[str, LeafSystem] = {"numpy, K1 chart": Vectorised(cs.load_scene("K1"))}
    # By default kernels are compiled where that is possible.
    engines = {"virtual machine": False} | ({"compiled (default)": None} if find_compiler() else {})
    for name in ("K1", "D1", "K3"):
        for coordinates in COORDINATES:
            scene = cs.load_scene(name)
            systems[f"empty, {name} {coordinates}"] = Empty(cs.SceneSystem(scene, coordinates).x0)
            for engine, compiled in engines.items():
                key = f"{engine}, {name} {coordinates}"
                systems[key] = ContactPlanner(scene, coordinates, compiled=compiled)
    timings = interleaved({key: _job(system) for key, system in systems.items()}, repeats=9)
    # Other work on the machine only ever adds: the least sample is the cost.
    cost = {key: 1e6 * timing.low / EVALUATIONS for key, timing in timings.items()}
    detail = {key: str(timing) for key, timing in timings.items()}
    empty = cost["empty, K1 chart"]
    yield Bar("peer: vectorised numpy, K1 chart: over empty", None,
              cost["numpy, K1 chart"] - empty, "us", detail=detail)  # fmt: skip
    titles = {"K1": "3 spheres on a sphere", "D1": "the same with a window",
              "K3": "3 spheres on an ellipsoid"}  # fmt: skip
    for name, title in titles.items():
        for coordinates in COORDINATES:
            empty = cost[f"empty, {name} {coordinates}"]
            for engine in engines:
                value = cost[f"{engine}, {name} {coordinates}"] - empty
                limit = None if name == "K3" else 4.0
                yield Bar(f"{title}, {coordinates}, {engine}: over empty", limit, value, "us",
                          note=f"empty takes {empty:.3g} us")  # fmt: skip


# --- scalars -------------------------------------------------------------------------------------


def scalars(full: bool) -> Iterator[Bar]:
    """AutoDiffXd Jacobian against central differences; Expression evaluated against float."""
    for coordinates in COORDINATES:
        worst, values = {}, {}
        for name in SCENES:
            planner = ContactPlanner(cs.load_scene(name), coordinates)
            context = planner.CreateDefaultContext()
            context.SetTime(0.02)
            x0 = planner.system.x0
            x = x0 * (1 + 0.01 * np.random.default_rng(1).normal(size=len(x0)))
            context.SetContinuousState(x)
            expected = planner.EvalTimeDerivatives(context).CopyToVector()
            exact, difference = _jacobians(planner, context, x)
            worst[name] = np.abs(exact - difference).max() / np.abs(difference).max()
            symbolic = _symbolic(planner, context, x)
            values[name] = np.abs(symbolic - expected).max() / np.abs(expected).max()
        yield Bar(f"AutoDiffXd Jacobian against central differences, {coordinates}", 1e-6,
                  max(worst.values()), detail=worst)  # fmt: skip
        yield Bar(f"Expression evaluated against float, {coordinates}", 1e-13,
                  max(values.values()), detail=values)  # fmt: skip


def _jacobians(
    planner: ContactPlanner, context: Context, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    other = planner.ToAutoDiffXd()
    found = other.CreateDefaultContext()
    found.SetTimeStateAndParametersFrom(context)
    found.SetContinuousState(InitializeAutoDiff(x).ravel())
    exact = ExtractGradient(other.EvalTimeDerivatives(found).CopyToVector().reshape(-1, 1))
    columns = []
    for k in range(len(x)):
        pair = []
        for step in (1e-6, -1e-6):
            moved = x.copy()
            moved[k] += step
            context.SetContinuousState(moved)
            pair.append(planner.EvalTimeDerivatives(context).CopyToVector())
        columns.append((pair[0] - pair[1]) / 2e-6)
    context.SetContinuousState(x)
    return exact, np.stack(columns, axis=1)


def _symbolic(planner: ContactPlanner, context: Context, x: np.ndarray) -> np.ndarray:
    other = planner.ToSymbolic()
    found, variables = other.CreateDefaultContext(), [Variable(f"x{k}") for k in range(len(x))]
    found.SetTimeStateAndParametersFrom(context)
    found.SetContinuousState(np.array([Expression(v) for v in variables]))
    rates = other.EvalTimeDerivatives(found).CopyToVector().ravel()
    return np.array([rate.Evaluate(dict(zip(variables, x))) for rate in rates])


# --- refusals ------------------------------------------------------------------------------------


def refusals(full: bool) -> Iterator[Bar]:
    """A finger that runs into its pole in chart coordinates, under every scheme."""
    contact = cs.Contact(cs.Sphere(0.04), object_at=(1.2, 0.3), finger_velocity=(1.0, 0.0))
    scene = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], profile=cs.Profile([0.1]),
                     duration=2.0, name="pole")  # fmt: skip
    said: dict[str, str] = {}
    for scheme in ORDERS:
        for accuracy in (None, 1e-4):
            key = scheme + (", error control" if accuracy else "")
            try:
                step = 0.1 if accuracy else 1e-3
                said[key] = f"off by {_error(ContactPlanner(scene), 1.5, scheme, step, accuracy)} m"
            except ContactSystemError:
                said[key] = ""
    silent = {key: text for key, text in said.items() if text}
    yield Bar("a pole passed without an error, of 20 runs", 0, len(silent), detail=silent)
    error = _error(ContactPlanner(scene, "frame"), 1.5, "runge_kutta5", 1e-3)
    yield Bar("the same pole passed in frame coordinates", 1e-9, error, "m")


SECTIONS = {
    "exact": exact,
    "orders": orders,
    "cost": cost,
    "scalars": scalars,
    "refusals": refusals,
}
