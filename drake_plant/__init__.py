"""A scene in Drake: the planner as a system, fingertips and object as a plant, and their Diagram.

``contact-system drake D1`` simulates a scene; in Python start with :func:`BuildStation` or
:func:`simulate`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

try:
    import pydrake  # noqa: F401
    import scipy  # noqa: F401
except ImportError as error:
    raise ImportError(
        'drake_plant needs Drake and scipy: pip install "contact-system[drake]" (Linux, macOS): '
        f"{error}"
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

_MODULES = (
    "config hand planner_system plan_source trajectories pressing balance plant contact_monitor "
    "fingertip_driver reorientation hand_driver station recording simulation measures plots"
).split()
"""Where the names of `__all__` are. Those that import least come first: importing all takes three
times as long as importing Drake."""


def __getattr__(name: str) -> Any:
    """Import modules, when one of their names is used, until one has it."""
    for module in _MODULES if name in __all__ else ("fmu_system",) * (name == "FmuSystem"):
        found = vars(import_module(f"{__name__}.{module}"))
        if name in found:
            return found[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "FmuSystem"})
