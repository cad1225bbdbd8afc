"""Pushes on a finger or the object: forces over time, as a scene's ``[drake]`` table has them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from contact_system import Scene
from contact_system.checks import finite_number

from .config import Push, body_names, check_pushes
from .planner_base import EARLY
from .plant import AGES


def PushSource(scene: Scene, pushes: Sequence[Push], time_step: float = 0.0) -> TrajectorySource:
    """What the port `push` of a :class:`FingertipDriver` takes: (3n + 3), N.

    Parameters
    ----------
    scene : Scene
    pushes : sequence of Push
    time_step : float
        Of a discrete plant, s, which holds a force for a step: in steps where a push begins or
        ends, its mean; 0: as it is.

    Raises
    ------
    SceneError
        A push on something that the scene has not, or a wrong number.
    """
    check_pushes(scene, pushes)
    finite_number(time_step, f"{scene.title}: time_step", "not below 0")
    names = body_names(scene)
    edges = np.array([0.0, *(p.start for p in pushes), *(p.stop for p in pushes)])
    if time_step:
        steps = np.floor(edges / time_step + 1e-6)
        edges = time_step * np.concatenate([steps, steps + 1])
    edges = np.unique(edges)  # those that differ by rounding alone count once
    edges = np.append(edges[np.diff(edges, prepend=-1.0) > 2 * EARLY], AGES)
    forces = np.zeros((len(edges), len(names), 3))
    for push in pushes:
        acting = np.diff(np.clip(edges, push.start, push.stop)) / np.diff(edges)
        forces[:-1, names.index(push.on)] += np.outer(acting, push.force)
    breaks = np.maximum(edges, EARLY) - EARLY
    held = PiecewisePolynomial.ZeroOrderHold(breaks, forces.reshape(len(breaks), -1).T)
    return TrajectorySource(held)
