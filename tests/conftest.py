"""Shared by tests of motion: surfaces, scenes, and arithmetic that is independent of plans."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import contact_system as cs

TURN = np.linalg.qr(np.array([[1.0, 0.3, -0.2], [0.1, 1.0, 0.7], [-0.6, 0.2, 1.0]]))[0]


# A long file that begins last leaves the other processes idle: these begin first, longest first.
LONG = "drake_station fmu_robustness readme fmu_package examples drake_film drake_cli".split()


def pytest_configure(config: pytest.Config) -> None:
    """Let pytest-xdist keep the order of files; by default files with most tests begin first."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    place = {f"test_{name}.py": k for k, name in enumerate(LONG)}
    items.sort(key=lambda item: place.get(item.path.name, len(LONG)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """0 workers, that is this process, for tests of one file: a worker would only start later."""
    files = {Path(argument.split("::")[0]) for argument in config.args}
    return 0 if len(files) == 1 and files.pop().is_file() else None


def turned(*eigenvalues: float, **options: int) -> cs.Quadric:
    """The quadric with these eigenvalues (1/m^2) and axes along no coordinate axis."""
    matrix = TURN @ np.diag(eigenvalues) @ TURN.T
    return cs.Quadric((matrix + matrix.T) / 2, **options)


# A surface of each kind, and coordinates on it off poles, umbilics and seams.
SURFACES: dict[str, tuple[cs.Surface, tuple[float, float]]] = {
    "plane": (cs.Plane(), (0.1, -0.05)),
    "sphere": (cs.Sphere(0.1), (1.1, 0.4)),
    "bowl": (cs.Sphere(0.2, inside=True), (2.0, 0.3)),
    "cylinder": (cs.Cylinder(0.1), (0.5, 0.2)),
    "pipe": (cs.Cylinder(0.15, inside=True), (0.5, 0.2)),
    "torus": (cs.Torus(0.1, 0.03), (0.3, 2.5)),
    "ellipsoid": (cs.Ellipsoid(0.3, 0.2, 0.1), (0.7, 0.4)),
    "hollow ellipsoid": (cs.Ellipsoid(0.3, 0.2, 0.1, inside=True), (0.7, 0.4)),
    "oblate": (cs.Ellipsoid(0.3, 0.3, 0.1), (1.2, 0.4)),
    "prolate": (cs.Ellipsoid(0.3, 0.1, 0.1), (1.2, 0.4)),
    "round ellipsoid": (cs.Ellipsoid(0.2, 0.2, 0.2), (1.2, 0.4)),
    "turned ellipsoid": (turned(11.0, 25.0, 100.0), (0.7, 0.4)),
    "one sheet": (turned(100.0, 50.0, -30.0), (0.4, 0.3)),
    "two sheets": (turned(50.0, -30.0, -20.0), (0.2, 0.3)),
    "elliptic cylinder": (turned(100.0, 40.0, 0.0), (0.4, 0.1)),
    "bumps": (
        cs.ParametricSurface(
            ("u + 0.4*v", "v", "h*cos(k*u)*cos(k*v)"), parameters={"h": 0.01, "k": 20.0}, size=0.1
        ),
        (0.02, 0.03),
    ),
    "rounded cube": (
        cs.ImplicitSurface("(x/r)**4 + (y/r)**4 + (z/r)**4 - 1", parameters={"r": 0.1}, size=0.1),
        (1.05, 0.6),
    ),
}


def one_contact(
    obj: str | cs.Surface = "sphere",
    finger: str | cs.Surface = "sphere",
    gain: cs.Gain | None = None,
    profile: tuple[float, ...] = (0.05, 0.2, -0.1),
    disturbances: Sequence = (),
    duration: float = 1.0,
    **contact,
) -> cs.Scene:
    """A scene with one contact between two surfaces (of `SURFACES`), slipping at the start."""
    (body, object_at), (tip, finger_at) = (
        SURFACES[x] if isinstance(x, str) else (x, (0.7, 0.4)) for x in (obj, finger)
    )
    values = {"finger_velocity": (0.6, 0.8), "object_velocity": (0.2, -0.5), "angle": 0.3}
    values |= {"finger_at": finger_at, "object_at": object_at} | contact
    return cs.Scene(
        object=body,
        contacts=[cs.Contact(finger=tip, **values)],
        profile=cs.Profile(profile),
        gain=gain or cs.Gain.time(3.0),
        duration=duration,
        disturbances=disturbances,
        name=f"{finger} on {obj}",
    )


ASK = ("states", "points", "slip", "acceleration", "pose", "twist")
WINDOWS = [
    cs.FingerAcceleration(0, 0.2, 0.4, (0.5, -0.8)),
    cs.ObjectAcceleration(0, 0.3, 0.6, (0.7, 0.6)),
    cs.ObjectRateOffset(0, 0.5, 0.8, (0.4, -0.3)),
]


def busy(obj: str = "ellipsoid", finger: str = "sphere", **given) -> cs.Scene:
    """A slipping contact with overlapping windows of all three kinds."""
    return one_contact(obj, finger, profile=(0.2, 0.1), disturbances=WINDOWS, **given)


def several() -> cs.Scene:
    """Seven contacts on an ellipsoid: two finger kinds, rest, rolling, slip, one window."""
    sphere, torus = cs.Sphere(0.04), cs.Torus(0.05, 0.02)
    places = [(0.7, 0.4), (1.9, -0.6), (-2.0, 1.1), (2.6, 0.2), (-0.6, -1.0), (1.2, 1.3)]
    places += [(-1.4, 0.8)]
    starts = [(0.2, -0.5), "rolling", "rest", (0.4, 0.1), "rolling", (-0.3, 0.3), (0.9, 0.9)]
    fingers = [sphere, sphere, torus, cs.Sphere(0.02), torus, sphere, sphere]
    contacts = [
        cs.Contact(finger=f, object_at=at, finger_at=(1.2, 0.3), angle=0.2 * i, object_velocity=v)
        for i, (f, at, v) in enumerate(zip(fingers, places, starts))
    ]
    push = cs.FingerAcceleration(5, 0.3, 0.5, (0.4, -0.2))
    common = {"profile": cs.Profile([0.1, 0.2]), "gain": cs.Gain.time(5.0), "duration": 1.0}
    body = cs.Ellipsoid(0.3, 0.2, 0.1)
    return cs.Scene(object=body, contacts=contacts, disturbances=[push], **common)


def assert_same(found: cs.Plan, expected: cs.Plan, t, bar: float, *asked: str) -> None:
    """Results of two plans agree to ``bar`` times the greatest value or, if larger, times 1."""
    for ask in asked or ASK:
        truth = getattr(expected, ask)(t)
        allowed = bar * max(1.0, np.abs(truth).max())
        assert getattr(found, ask)(t) == pytest.approx(truth, abs=allowed), ask


def derivative(f, t: np.ndarray, h: float = 4e-3) -> np.ndarray:
    """f'(t) by central differences, extrapolated four times (Richardson): error O(h^10)."""
    table = [(f(t + h / 2**k) - f(t - h / 2**k)) / (h / 2 ** (k - 1)) for k in range(5)]
    for order in range(1, 5):
        table = [b + (b - a) / (4**order - 1) for a, b in zip(table, table[1:])]
    return table[0]


def assert_twist_is_the_rate_of_the_pose(plan: cs.Plan, t: np.ndarray, bar: float, h=4e-3) -> None:
    """Compare with omega from R' R^T and with the velocity of the finger's origin."""
    rate, pose, twist = derivative(plan.pose, t, h), plan.pose(t), plan.twist(t)
    turning = rate[..., :3, :3] @ pose[..., :3, :3].swapaxes(-1, -2)
    omega = turning[..., [2, 0, 1], [1, 2, 0]]
    for found, expected in ((twist[..., :3], omega), (twist[..., 3:], rate[..., :3, 3])):
        assert found == pytest.approx(expected, abs=bar * np.abs(expected).max() + 1e-12)


def _past(name, axes, at, angle, profile, eta, edge, push, **velocities) -> cs.Scene:
    contact = cs.Contact(cs.Sphere(0.04), at, angle=angle, **velocities)
    common = {"profile": cs.Profile([profile]), "gain": cs.Gain.time(eta), "duration": 4.0}
    windows = [cs.ObjectAcceleration(0, edge, 3.7, push)]
    return cs.Scene(
        object=cs.Ellipsoid(*axes), contacts=[contact], disturbances=windows, name=name, **common
    )


_AT = 0.13165289212708675, 0.6643586305579765
_ROUND = {"finger_velocity": (0.491, -1.0), "object_velocity": (-0.179, 1.0)}
PAST_UMBILICS = [
    _past("one", (0.3, 0.2, 0.1), _AT, -2.5355341811604113, 0.3, 5.0, 2.5, (0.5, 0.3)),
    _past("pairs", (0.3, 0.10001, 0.1), (1.28, -0.36), -0.91, 0.3, 5.0, 3.4, (0.5, 0.3)),
    _past("round", (0.3, 0.2, 0.1), (7e-5, 1.337), 0.0, 0.052, 5.6, 2.5, (0.05, 0.03), **_ROUND),
]
"""Past one umbilic at 0.6 mm, four that are in pairs 1.3 mm apart, and round one at 0.2 mm, where y
changes its sign at 0.3 and 117 ms; the window's components are those of the branch come to."""
