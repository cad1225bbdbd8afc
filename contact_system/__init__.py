"""Plan the contact curves of fingers that roll on an object, exactly and fast.

Kumar & Mukherjee, "A note on synthesizing geodesic based contact curves".
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .contact_sensor import measured_states
from .errors import ChartSingularity, ConformalContact, ContactSystemError, SceneError, SurfaceError
from .measures import Rejection, great_circle_distance, rejections, summary
from .plan import Plan, load, plan
from .scene import (
    Contact,
    FingerAcceleration,
    Leg,
    ObjectAcceleration,
    ObjectRateOffset,
    Scene,
    Turning,
    bundled_scenes,
    load_scene,
    save_scene,
)
from .surfaces import (
    Cylinder,
    Ellipsoid,
    ImplicitSurface,
    ParametricSurface,
    Plane,
    Quadric,
    Sphere,
    Surface,
    Torus,
)
from .system import SceneSystem
from .theory.gain import Contraction, Gain
from .theory.profile import Profile

if TYPE_CHECKING:
    from .steering.geodesic import Geodesic, geodesic, geodesics
    from .steering.goal import Goal, Route
    from .steering.loop import Loop, loop
    from .steering.reach import reach
    from .sweeping import Failure, Sweep, sweep

__version__ = "0.1.0"

__all__ = [
    "ChartSingularity",
    "ConformalContact",
    "Contact",
    "ContactSystemError",
    "Contraction",
    "Cylinder",
    "Ellipsoid",
    "Failure",
    "FingerAcceleration",
    "Gain",
    "Geodesic",
    "Goal",
    "ImplicitSurface",
    "Leg",
    "Loop",
    "ObjectAcceleration",
    "ObjectRateOffset",
    "ParametricSurface",
    "Plan",
    "Plane",
    "Profile",
    "Quadric",
    "Rejection",
    "Route",
    "Scene",
    "SceneError",
    "SceneSystem",
    "Sphere",
    "Surface",
    "SurfaceError",
    "Sweep",
    "Torus",
    "Turning",
    "bundled_scenes",
    "geodesic",
    "geodesics",
    "great_circle_distance",
    "load",
    "load_scene",
    "loop",
    "measured_states",
    "plan",
    "reach",
    "rejections",
    "save_scene",
    "summary",
    "sweep",
]


def __getattr__(name: str) -> Any:
    """Import `steering` or `sweeping`, which plans do not need, when one of their names is used."""
    for package in ("steering", "sweeping") if name in __all__ else ():
        module = import_module(f"{__name__}.{package}")
        if name in module.__all__:
            return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
