"""What a user writes: contacts, disturbances, scenes, and scene files."""

from .contact import REST, ROLLING, Contact, Turning
from .disturbances import (
    DISTURBANCE_KINDS,
    SLOTS,
    Disturbance,
    FingerAcceleration,
    ObjectAcceleration,
    ObjectRateOffset,
)
from .files import (
    bundled_scenes,
    load_scene,
    save_scene,
    scene_from_toml,
    scene_text,
    scene_to_toml,
)
from .legs import STILL, Leg, Stretch, speed
from .scene import Scene, acting, refuse_rest, require_scene

__all__ = [
    "DISTURBANCE_KINDS",
    "REST",
    "ROLLING",
    "SLOTS",
    "STILL",
    "Contact",
    "Disturbance",
    "FingerAcceleration",
    "Leg",
    "ObjectAcceleration",
    "ObjectRateOffset",
    "Scene",
    "Stretch",
    "Turning",
    "acting",
    "bundled_scenes",
    "load_scene",
    "refuse_rest",
    "require_scene",
    "save_scene",
    "scene_from_toml",
    "scene_text",
    "scene_to_toml",
    "speed",
]
