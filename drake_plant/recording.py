"""A simulation as one HTML file that anybody can turn, zoom and play in a browser."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Role
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem

from contact_system import SceneError
from contact_system.checks import a_path, finite_number
from contact_system.writing import writing

from .config import require_config
from .lifetimes import NO_DICTIONARY, weakly
from .plant import ScenePlant

Array = NDArray[np.float64]

BODIES = "bodies"  # path of the visualizer in Meshcat's tree
LENS = 1.35  # distance of the camera over what lets the scene's sphere touch the picture's rim


class Recording:
    """Records a simulation with Meshcat, the camera travelling with the object.

    Parameters
    ----------
    frames : float
        Pictures a second of simulated time.

    Examples
    --------
    ::

        film = Recording()
        film.Add(builder, scene_plant)      # before builder.Build()
        simulator.AdvanceTo(1.0)
        film.Save("film.html")
    """

    def __init__(self, frames: float = 64.0):
        self._period = 1.0 / finite_number(frames, "frames", "above 0")
        log = logging.getLogger("drake")
        level = log.level
        log.setLevel(logging.WARNING)  # nobody needs to know the address it listens at
        self._meshcat = Meshcat()
        log.setLevel(level)
        self._visualizer: MeshcatVisualizer | None = None

    def Add(self, builder: DiagramBuilder, scene_plant: ScenePlant) -> None:
        """Add a visualizer of the illustration geometry, and what keeps the object in sight.

        Parameters
        ----------
        builder : DiagramBuilder
        scene_plant : ScenePlant
            With the default poses that the camera is to look at.
        """
        require_config(builder, DiagramBuilder, "builder")
        require_config(scene_plant, ScenePlant, "scene_plant")
        params = MeshcatVisualizerParams(
            publish_period=self._period, role=Role.kIllustration, prefix=BODIES
        )
        self._visualizer = MeshcatVisualizer.AddToBuilder(
            builder, scene_plant.scene_graph, self._meshcat, params
        )
        self._visualizer.StartRecording(set_transforms_while_recording=False)
        follower = builder.AddSystem(_Follower(self._meshcat, scene_plant, self._period))
        builder.Connect(scene_plant.plant.GetOutputPort("body_poses"), follower.get_input_port())
        self._meshcat.SetProperty("/Grid", "visible", False)
        self._meshcat.SetProperty("/Axes", "visible", False)
        self._meshcat.SetCameraPose(*camera_pose(scene_plant))

    def Save(self, path: str | Path) -> None:
        """Write the recording to a file that needs nothing else.

        Parameters
        ----------
        path : path
            Ending in .html.
        """
        if self._visualizer is None:
            raise SceneError(f"nothing to save in {path}: call Add before the Diagram is built")
        self._visualizer.StopRecording()
        self._visualizer.PublishRecording()
        with writing(a_path(path)) as file:
            file.write(self._meshcat.StaticHtml().encode())


class _Follower(LeafSystem):
    """Moves Meshcat's tree of bodies so that the object stays at the origin.

    .. pydrake_system::

        name: Follower
        input_ports:
        - body_poses
    """

    __slots__ = NO_DICTIONARY

    def __init__(self, meshcat: Meshcat, scene_plant: ScenePlant, period: float):
        super().__init__()
        self._meshcat = meshcat
        self._object = int(scene_plant.object_body.index())
        self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        self.DeclarePeriodicPublishEvent(period, 0.0, weakly(self._Publish))
        self.DeclareForcedPublishEvent(weakly(self._Publish))

    def _Publish(self, context: Context) -> None:
        p_WO = self.get_input_port().Eval(context)[self._object].translation()
        self._meshcat.SetTransform(BODIES, RigidTransform(-p_WO), context.get_time())


def camera_pose(scene_plant: ScenePlant) -> tuple[Array, Array]:
    """Where a camera sees all fingers at their default poses, the object being at the origin.

    Parameters
    ----------
    scene_plant : ScenePlant

    Returns
    -------
    camera, target : (3,)
        In the world, less the object's place, m.
    """
    plant = scene_plant.plant
    context = plant.CreateDefaultContext()
    origin = scene_plant.object_body.EvalPoseInWorld(context).translation()
    places = [b.EvalPoseInWorld(context).translation() - origin for b in scene_plant.finger_bodies]
    fingers = np.array(places)
    toward = best_direction(fingers)
    target = 0.3 * fingers.mean(0)
    reach = max(np.linalg.norm(fingers - target, axis=1).max(), *_extent(scene_plant)) * 1.2
    half_angle = math.radians(75.0) / 2  # Meshcat's camera sees 75 degrees
    return target + LENS * reach / math.sin(half_angle) * toward, target


def best_direction(fingers: Array) -> Array:
    """Of directions above the horizon the one that the least visible finger faces most.

    Parameters
    ----------
    fingers : (n, 3)
        From the object's middle.

    Returns
    -------
    (3,)
        Unit vector from the object towards the camera.
    """
    grid = np.meshgrid(np.radians(np.arange(0, 360, 10)), np.radians([15, 30, 45]))
    azimuth, elevation = (angle.ravel() for angle in grid)
    level = np.cos(elevation)
    toward = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    sizes = np.linalg.norm(fingers, axis=1, keepdims=True)
    facing = toward @ (fingers / np.where(sizes > 0, sizes, 1.0)).T
    return toward[np.argmax(facing.min(1) + 0.3 * facing.mean(1))]


def _extent(scene_plant: ScenePlant) -> list[float]:
    """Greatest half-width of each bounding box of a collision shape that has an end [m]."""
    inspector = scene_plant.scene_graph.model_inspector()
    sizes = [0.0]
    for body in (scene_plant.object_body, *scene_plant.finger_bodies):
        for geometry in scene_plant.plant.GetCollisionGeometriesForBody(body):
            box = inspector.GetObbInGeometryFrame(geometry)
            if box is not None:
                sizes.append(float(np.max(box.half_width())))
    return sizes
