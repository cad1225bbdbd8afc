"""Our own methods for the work-precision diagrams: plans, the FMU, ContactPlanner in Drake."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

import contact_system as cs

from .accuracy import engines
from .peers import decades
from .problems import Problem
from .timing import Job

TOLERANCES = decades(3, 15)
ACCURACIES = (1e-3, 1e-6, 1e-9)
SCHEMES = ("runge_kutta3", "runge_kutta5", "radau3")


@dataclass(frozen=True)
class Ours:
    """One of our methods.

    Attributes
    ----------
    name : str
    tolerances : loosest first
    build : callable
        tolerance -> Job, whose call returns contact points, the layout of ``Problem.truth``.
    """

    name: str
    tolerances: tuple[float, ...]
    build: Callable[[float], Job]


def engine(compiled: bool) -> str:
    """Name of a plan's engine."""
    return "compiled" if compiled else "virtual machine"


def plans(problem: Problem) -> Iterator[Ours]:
    """``plan()`` and its points; of a scene planned before and, "new scene", of one never planned.

    A scene keeps where it starts, laid out for C; a disturbed one its frames and intervals. A new
    one is planned after others of its kind. Slip and geodesics without a closed form are integrated
    anew in both.
    """
    for compiled in engines():
        warm: list[bool] = []

        def job(
            tolerance: float, new: bool, compiled: bool = compiled, warm: list[bool] = warm
        ) -> Job:
            def call(scene: cs.Scene) -> np.ndarray:
                return problem.of_plan(cs.plan(scene, tolerance, compiled=compiled))

            for _ in range(0 if warm else 3):  # kernels are built for the first and second scene
                call(problem.make())
            warm.append(True)
            ready = problem.make()
            return Job(call, problem.make if new else lambda: ready)

        for new in (False, True) if compiled == engines()[-1] else (False,):
            name = f"ours, {engine(compiled)}{', new scene' * new}"
            yield Ours(name, TOLERANCES, partial(job, new=new))


def chart(problem: Problem) -> Iterator[Ours]:
    """``method="chart"``, the paper's equations as printed."""

    def build(tolerance: float) -> Job:
        def call(scene: cs.Scene) -> np.ndarray:
            return problem.of_plan(cs.plan(scene, tolerance, "chart", "LSODA"))

        return Job(call, problem.make)

    yield Ours('ours, method="chart"', (1e-4, 1e-7, 1e-10, 1e-13), build)


# --- the FMU -----------------------------------------------------------------------------------


def fmu(problem: Problem) -> Iterator[Ours]:
    """The exported FMU, stepped from output to output by fmpy; it has one tolerance, 1e-14.

    Raises
    ------
    ImportError
        fmpy is not installed.
    """
    from .fmu import fmu_of, initialize

    made = fmu_of(problem.make().replace(name="scene"), "2.0")
    slave, wanted = made.instance(), _points(made.description, problem)
    times = problem.times.tolist()
    shape = (len(times), *problem.truth.shape[1:])

    def call(_: Any) -> np.ndarray:
        slave.reset()
        initialize(slave)
        rows = [slave.getReal(wanted)]
        for begin, end in zip(times, times[1:]):
            slave.doStep(currentCommunicationPoint=begin, communicationStepSize=end - begin)
            rows.append(slave.getReal(wanted))
        return np.array(rows).reshape(shape)

    yield Ours("ours, FMU", (1e-14,), lambda _: Job(call))


def _points(description: Any, problem: Problem) -> list[int]:
    """References of the contact points."""
    references = {v.name: v.valueReference for v in description.modelVariables}
    bodies = ("finger", "object")[2 - len(problem.sizes) :]
    return [
        references[f"contact[{i + 1}].{body}.point.{axis}"]
        for i in range(problem.truth.shape[1]) for body in bodies for axis in "xyz"
    ]  # fmt: skip


# --- Drake -------------------------------------------------------------------------------------


def drake(problem: Problem, limit: float) -> Iterator[Ours]:
    """ContactPlanner in frame coordinates under Drake's schemes with error control.

    Raises
    ------
    ImportError
        Drake is not installed.
    """
    from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig

    from drake_plant import ContactPlanner

    planner = ContactPlanner(problem.make(), "frame")
    port = planner.GetOutputPort("contact_point")

    def simulator(scheme: str, accuracy: float) -> Any:
        made = Simulator(planner)
        config = SimulatorConfig(
            integration_scheme=scheme, max_step_size=0.1, use_error_control=True, accuracy=accuracy
        )
        ApplySimulatorConfig(config, made)
        made.Initialize()
        return made

    def call(made: Any) -> np.ndarray:
        rows, begin = [], time.perf_counter()
        for t in problem.times:
            made.AdvanceTo(t)
            rows.append(port.Eval(made.get_context()))
            if time.perf_counter() - begin > limit:
                raise TimeoutError(f"longer than {limit:g} s")
        points = np.array(rows).reshape(len(rows), -1, 2, 3)
        return points[:, :, 2 - len(problem.sizes) :]

    for scheme in SCHEMES:
        yield Ours(
            f"ours, Drake {scheme}", ACCURACIES,
            lambda accuracy, scheme=scheme: Job(call, partial(simulator, scheme, accuracy)),
        )  # fmt: skip
