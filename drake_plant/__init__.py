"""A scene in Drake: the planner as a system, fingertips and object as a plant, wired and verified.

``contact-system drake D1`` runs it; :func:`BuildStation` and :func:`simulate` are where to start in
Python.
"""

import warnings
from typing import Any

try:
    import pydrake  # noqa: F401
except ImportError as error:
    raise ImportError(
        'drake_plant needs Drake: pip install "contact-system[drake]" (Linux and macOS)'
    ) from error

from .balance import balancing_forces
from .config import Push, StationConfig
from .contact_monitor import ContactMonitor
from .fingertip_driver import FingertipDriver
from .force_balancer import ForceBalancer
from .hand import Hand
from .hand_driver import HandDriver
from .hand_outcome import HandReport, hand_report
from .hand_station import BuildHandStation, HandResult, simulate_hand
from .measures import contact_table, object_report, outcome, push_table
from .plan_source import PlanSource
from .planner_system import ContactPlanner
from .plant import AddScenePlant, ScenePlant
from .plots import plot
from .pressing import rolling_scene
from .pushes import PushSource
from .recording import Recording
from .reorientation import Reorientation, plan_reorientation
from .simulation import SimulationResult, simulate
from .station import BuildStation, SetInitialState
from .trajectories import ContactTrajectories, MakeTrajectories


def __getattr__(name: str) -> Any:
    """FmuSystem, imported when it is asked for, as nothing else needs fmpy; and former names."""
    if name == "FmuSystem":
        from .fmu_system import FmuSystem

        return FmuSystem
    if name in ("PlantConfig", "DriverConfig"):
        warnings.warn(f"{name} is StationConfig now", DeprecationWarning, stacklevel=2)
        return StationConfig
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [  # what a star imports: FmuSystem needs fmpy
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
