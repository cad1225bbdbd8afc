"""A scene in Drake: the planner as a system, fingertips and object as a plant, and their Diagram.

``contact-system drake D1`` simulates a scene; in Python start with :func:`BuildStation` or
:func:`simulate`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

try:
    import pydrake  # noqa: F401
except ImportError as error:
    raise ImportError(
        f'drake_plant needs Drake: pip install "contact-system[drake]" (Linux, macOS): {error}'
    ) from error

if TYPE_CHECKING:
    from .balance import ForceBalancer, balancing_forces
    from .config import Push, StationConfig
    from .contact_monitor import ContactMonitor
    from .fingertip_driver import FingertipDriver
    from .fmu_system import FmuSystem as FmuSystem
    from .hand import Hand
    from .hand_driver import HandDriver
    from .measures import HandReport, contact_table, hand_report, object_report, outcome, push_table
    from .plan_source import PlanSource
    from .planner_system import ContactPlanner
    from .plant import AddScenePlant, ScenePlant
    from .plots import plot
    from .pressing import rolling_scene
    from .recording import Recording
    from .reorientation import Reorientation, plan_reorientation
    from .simulation import HandResult, SimulationResult, simulate, simulate_hand
    from .station import BuildHandStation, BuildStation, PushSource, SetInitialState
    from .trajectories import ContactTrajectories, MakeTrajectories

__all__ = [  # without FmuSystem, as `import *` would then need fmpy
    "AddScenePlant",
    "BuildHandStation",
    "BuildStation",
    "ContactMonitor",
    "ContactPlanner",
    "ContactTrajectories",
    "FingertipDriver",
    "ForceBalancer",
    "Hand",
    "HandDriver",
    "HandReport",
    "HandResult",
    "MakeTrajectories",
    "PlanSource",
    "Push",
    "PushSource",
    "Recording",
    "Reorientation",
    "ScenePlant",
    "SetInitialState",
    "SimulationResult",
    "StationConfig",
    "balancing_forces",
    "contact_table",
    "hand_report",
    "object_report",
    "outcome",
    "plan_reorientation",
    "plot",
    "push_table",
    "rolling_scene",
    "simulate",
    "simulate_hand",
]

_MODULES = {
    "balance": ("ForceBalancer", "balancing_forces"),
    "config": ("Push", "StationConfig"),
    "contact_monitor": ("ContactMonitor",),
    "fingertip_driver": ("FingertipDriver",),
    "fmu_system": ("FmuSystem",),
    "hand": ("Hand",),
    "hand_driver": ("HandDriver",),
    "measures": (
        *("HandReport", "contact_table", "hand_report", "object_report", "outcome", "push_table"),
    ),
    "plan_source": ("PlanSource",),
    "planner_system": ("ContactPlanner",),
    "plant": ("AddScenePlant", "ScenePlant"),
    "plots": ("plot",),
    "pressing": ("rolling_scene",),
    "recording": ("Recording",),
    "reorientation": ("Reorientation", "plan_reorientation"),
    "simulation": ("HandResult", "SimulationResult", "simulate", "simulate_hand"),
    "station": ("BuildHandStation", "BuildStation", "PushSource", "SetInitialState"),
    "trajectories": ("ContactTrajectories", "MakeTrajectories"),
}
"""Modules are imported when a name of theirs is used: all take three times as long as Drake."""


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *sum(_MODULES.values(), ())})
