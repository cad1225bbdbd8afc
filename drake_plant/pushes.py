"""Pushes on a finger or the object: forces over time, as a scene's ``[drake]`` table has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from contact_system import Scene, SceneError
from contact_system.checks import did_you_mean, finite_number, known_keys, naming

from .plant import AGES, require_config, types_known

EARLY = 1e-9  # s, by which a push begins and ends before its time: a step may come as late


@types_known
@dataclass
class Push:
    """A force on one body for some time.

    Attributes
    ----------
    on : str
        The contact's name, such as "finger 1", or "object".
    start, stop : float
        s
    force : list of float
        Three numbers, N, in the world, at the mass centre.
    """

    on: str = ""
    start: float = 0.0
    stop: float = 0.0
    force: list[float] = field(default_factory=list)

    def check(self, scene: Scene) -> None:
        """Raise a SceneError that names the first field that is wrong, its value and the remedy."""
        if self.on not in (names := _names(scene)):
            raise SceneError(
                f"on = {self.on!r}{did_you_mean(str(self.on), names)}: give one of "
                f"{', '.join(names)}"
            )
        for key in ("start", "stop"):
            finite_number(getattr(self, key), key, "not below 0")
        if not self.start < self.stop:
            raise SceneError(f"stop = {self.stop!r}: give a time after start = {self.start!r}")
        if not isinstance(self.force, (list, tuple, np.ndarray)) or len(self.force) != 3:
            raise SceneError(f"force = {self.force!r}: give three numbers, N, in the world")
        for value in self.force:
            finite_number(value, "force")


def pushes_of(table: Any) -> list[Push]:
    """Pushes from the list of tables that a scene file has."""
    if not isinstance(table, Sequence) or isinstance(table, str):
        raise SceneError(f"pushes = {table!r}: give a list of tables")
    keys = [f.name for f in dataclasses.fields(Push)]
    for k, push in enumerate(table):
        if not isinstance(push, (dict, Push)):
            raise SceneError(f"pushes[{k}] = {push!r}: give a table with {', '.join(keys)}")
        if isinstance(push, dict):
            known_keys(push, keys, f"pushes[{k}]: ")
    return [push if isinstance(push, Push) else Push(**push) for push in table]


def check_pushes(scene: Scene, pushes: Sequence[Push]) -> None:
    """Raise a SceneError for the first push that a scene cannot have."""
    for k, push in enumerate(pushes):
        with naming(f"pushes[{k}]"):
            require_config(push, Push, "push")
            push.check(scene)


def PushSource(scene: Scene, pushes: Sequence[Push]) -> TrajectorySource:
    """What the port `push` of a :class:`FingertipDriver` takes: (3n + 3), N.

    Parameters
    ----------
    scene : Scene
    pushes : sequence of Push

    Raises
    ------
    SceneError
        A push on something that the scene has not, or a wrong number.
    """
    check_pushes(scene, pushes)
    names = _names(scene)
    edges = sorted({0.0, *(p.start for p in pushes), *(p.stop for p in pushes)})
    forces = np.zeros((len(edges) + 1, len(names), 3))
    for push in pushes:
        acting = [push.start <= edge < push.stop for edge in edges]
        forces[:-1][acting, names.index(push.on)] += push.force
    breaks = np.maximum([*edges, AGES], EARLY) - EARLY
    held = PiecewisePolynomial.ZeroOrderHold(breaks, forces.reshape(len(breaks), -1).T)
    return TrajectorySource(held)


def _names(scene: Scene) -> list[str]:
    return [*(scene.contact_name(i) for i in range(len(scene.contacts))), "object"]
