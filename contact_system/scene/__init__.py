"""Scenes: contacts, legs, disturbances, and scene files."""

# ruff: noqa: F401

from .contact import REST, ROLLING, SIDES, Contact, Start, Turning
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
from .scene import NO_CLAIMS, Scene, acting, refuse_rest, require_scene
