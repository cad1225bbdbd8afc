"""Surfaces, scenes, comparisons and a run of Python that tests of several files share."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contact_system as cs

ROOT = Path(__file__).parents[1]
TURN = np.linalg.qr(np.array([[1.0, 0.3, -0.2], [0.1, 1.0, 0.7], [-0.6, 0.2, 1.0]]))[0]

of_versions = pytest.mark.parametrize("version", ["2.0", "3.0"])
of_kinds = pytest.mark.parametrize("kind", ["FMU", "slave"])
# FMU and slave run the same code, so two of the four combinations of kind and version are enough.
of_blocks = pytest.mark.parametrize(("kind", "version"), [("FMU", "2.0"), ("slave", "3.0")])

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
    """No worker process for the tests of one file: it would only start more slowly."""
    files = {Path(argument.split("::")[0]) for argument in config.args}
    return 0 if len(files) == 1 and files.pop().is_file() else None


def run_python(*words: object, folder: Path = ROOT, **environment: str) -> str:
    """What a new Python process, which can import this checkout, prints; it must not fail."""
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": paths, **environment}
    command = [sys.executable, *map(str, words)]
    run = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment)
    assert run.returncode == 0, run.stderr
    return run.stdout


def in_threads(function: Callable, values: Sequence) -> list[Any]:
    """The function's results, one thread for each value; threads take turns very often."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # s: after every few instructions
    try:
        with ThreadPoolExecutor(len(values)) as pool:
            return list(pool.map(function, values))
    finally:
        sys.setswitchinterval(interval)


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self) -> bool:
        return True


def turned_quadric(*eigenvalues: float, **options: int) -> cs.Quadric:
    """The quadric with these eigenvalues (1/m^2), its axes oblique to those of its frame."""
    matrix = TURN @ np.diag(eigenvalues) @ TURN.T
    return cs.Quadric((matrix + matrix.T) / 2, **options)


# A surface of each kind, and (u, v) of a point away from its poles, umbilics and seams.
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
    "turned ellipsoid": (turned_quadric(11.0, 25.0, 100.0), (0.7, 0.4)),
    "one sheet": (turned_quadric(100.0, 50.0, -30.0), (0.4, 0.3)),
    "two sheets": (turned_quadric(50.0, -30.0, -20.0), (0.2, 0.3)),
    "elliptic cylinder": (turned_quadric(100.0, 40.0, 0.0), (0.4, 0.1)),
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
    """A contact between two surfaces, names of `SURFACES` or others, that slips at the start."""
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


RESULTS = ("states", "points", "slip", "acceleration", "pose", "twist")
WINDOWS = [
    cs.FingerAcceleration(0, 0.2, 0.4, (0.5, -0.8)),
    cs.ObjectAcceleration(0, 0.3, 0.6, (0.7, 0.6)),
    cs.ObjectRateOffset(0, 0.5, 0.8, (0.4, -0.3)),
]


def disturbed(obj: str = "ellipsoid", finger: str = "sphere", **given) -> cs.Scene:
    """A contact that slips, under overlapping windows of all three kinds."""
    return one_contact(obj, finger, profile=(0.2, 0.1), disturbances=WINDOWS, **given)


def seven_contacts() -> cs.Scene:
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


def assert_plans_agree(found: cs.Plan, expected: cs.Plan, t, bar: float, *results: str) -> None:
    """Results at times t agree to ``bar`` times the greatest number of each, or times 1."""
    for result in results or RESULTS:
        truth = getattr(expected, result)(t)
        allowed = bar * max(1.0, np.abs(truth).max())
        assert getattr(found, result)(t) == pytest.approx(truth, abs=allowed), result


def derivative(f, t: np.ndarray, h: float = 4e-3) -> np.ndarray:
    """f'(t) by central differences, extrapolated four times (Richardson): error O(h^10)."""
    table = [(f(t + h / 2**k) - f(t - h / 2**k)) / (h / 2 ** (k - 1)) for k in range(5)]
    for order in range(1, 5):
        table = [b + (b - a) / (4**order - 1) for a, b in zip(table, table[1:])]
    return table[0]


def assert_twist_is_the_rate_of_the_pose(plan: cs.Plan, t: np.ndarray, bar: float, h=4e-3) -> None:
    """Of every contact: omega is that of R' R^T, and the velocity that of the finger's origin."""
    rate, pose, twist = derivative(plan.pose, t, h), plan.pose(t), plan.twist(t)
    turning = rate[..., :3, :3] @ pose[..., :3, :3].swapaxes(-1, -2)
    omega = turning[..., [2, 0, 1], [1, 2, 0]]
    for found, expected in ((twist[..., :3], omega), (twist[..., 3:], rate[..., :3, 3])):
        assert found == pytest.approx(expected, abs=bar * np.abs(expected).max() + 1e-12)


def _near(name, axes, at, angle, profile, eta, edge, push, **velocities) -> cs.Scene:
    contact = cs.Contact(cs.Sphere(0.04), at, angle=angle, **velocities)
    common = {"profile": cs.Profile([profile]), "gain": cs.Gain.time(eta), "duration": 4.0}
    windows = [cs.ObjectAcceleration(0, edge, 3.7, push)]
    return cs.Scene(
        object=cs.Ellipsoid(*axes), contacts=[contact], disturbances=windows, name=name, **common
    )


_AT = 0.13165289212708675, 0.6643586305579765
_AROUND = {"finger_velocity": (0.491, -1.0), "object_velocity": (-0.179, 1.0)}
NEAR_UMBILICS = [
    _near("one", (0.3, 0.2, 0.1), _AT, -2.5355341811604113, 0.3, 5.0, 2.5, (0.5, 0.3)),
    _near("pairs", (0.3, 0.10001, 0.1), (1.28, -0.36), -0.91, 0.3, 5.0, 3.4, (0.5, 0.3)),
    _near("around", (0.3, 0.2, 0.1), (7e-5, 1.337), 0.0, 0.052, 5.6, 2.5, (0.05, 0.03), **_AROUND),
]
"""Paths that pass one umbilic at 0.6 mm; four umbilics, in pairs 1.3 mm apart; and half around one
at 0.2 mm, with y = 0 at 0.3 and 117 ms. A window later has components along f_u and f_v of the
cover that the states are then on, and so moves the contact wrongly if that is the other one."""
