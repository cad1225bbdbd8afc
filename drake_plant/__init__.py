"""A scene in Drake: the planner as a system, fingertips and object as a plant, wired and verified.

``contact-system drake D1`` runs it; :func:`BuildStation` and :func:`simulate` are where to start in
Python.
"""

try:
    import pydrake  # noqa: F401
except ImportError as error:
    raise ImportError(
        'drake_plant needs Drake: pip install "contact-system[drake]" (Linux and macOS)'
    ) from error

from .contact_monitor import ContactMonitor
from .fingertip_driver import DriverConfig, FingertipDriver
from .planner_system import ContactPlanner
from .plant import AddScenePlant, PlantConfig, ScenePlant
from .station import (
    BuildStation,
    SetInitialState,
    SimulationResult,
    StationConfig,
    rolling_scene,
    simulate,
)

__all__ = [
    "AddScenePlant",
    "BuildStation",
    "ContactMonitor",
    "ContactPlanner",
    "DriverConfig",
    "FingertipDriver",
    "PlantConfig",
    "ScenePlant",
    "SetInitialState",
    "SimulationResult",
    "StationConfig",
    "rolling_scene",
    "simulate",
]
