"""Pushes on a finger or the object: forces over time, as a scene's ``[drake]`` table has them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from contact_system import Scene

from .config import Push, body_names, check_pushes
from .plant import AGES

EARLY = 1e-9  # s, by which a push begins and ends before its time: a step may come as late


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
    names = body_names(scene)
    edges = sorted({0.0, *(p.start for p in pushes), *(p.stop for p in pushes)})
    forces = np.zeros((len(edges) + 1, len(names), 3))
    for push in pushes:
        acting = [push.start <= edge < push.stop for edge in edges]
        forces[:-1][acting, names.index(push.on)] += push.force
    breaks = np.maximum([*edges, AGES], EARLY) - EARLY
    held = PiecewisePolynomial.ZeroOrderHold(breaks, forces.reshape(len(breaks), -1).T)
    return TrajectorySource(held)
