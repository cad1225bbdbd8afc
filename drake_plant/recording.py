"""A simulation as one HTML file that anybody can turn, zoom and play in a browser."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from pydrake.geometry import (
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Role,
)
from pydrake.multibody.meshcat import ContactVisualizer, ContactVisualizerParams
from pydrake.systems.framework import DiagramBuilder

from contact_system import SceneError
from contact_system.checks import a_path, finite_number
from contact_system.plots.style import INK
from contact_system.writing import writing

from .drake_meshes import rgba
from .film import BODIES, FORCES, draw, look_at, with_texts
from .plant import ScenePlant

if TYPE_CHECKING:
    from .simulation import SimulationResult

ARROW = 2.5  # length of the arrow of the normal force, in sizes of the largest finger


class Recording:
    """Records a simulation with Meshcat: bodies, contact points and contact forces.

    Parameters
    ----------
    frames : float
        Pictures a second of simulated time; each is taken at a step of a discrete plant.

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
        """Add visualizers of the illustration geometry and of contacts.

        Parameters
        ----------
        builder : DiagramBuilder
        scene_plant : ScenePlant
        """
        meshcat, scene, ink = self._meshcat, scene_plant.scene, rgba(INK)
        step, period = scene_plant.plant.time_step(), self._period
        if step:  # a picture between two steps would cut the planner's steps
            period = step * max(1, round(period / step))
        params = MeshcatVisualizerParams(
            publish_period=period, role=Role.kIllustration, prefix=BODIES
        )
        self._visualizer = MeshcatVisualizer.AddToBuilder(
            builder, scene_plant.scene_graph, meshcat, params
        )
        largest = max(contact.finger.size for contact in scene.contacts)
        forces = ContactVisualizerParams(
            publish_period=period,
            prefix=FORCES,
            color=ink,
            hydro_force_color=ink,
            newtons_per_meter=scene_plant.config.normal_force / (ARROW * largest),
            newton_meters_per_meter=1e9,  # moments are of no interest
            radius=largest / 20,
        )
        ContactVisualizer.AddToBuilder(builder, scene_plant.plant, meshcat, forces)
        self._visualizer.StartRecording(set_transforms_while_recording=False)
        for path in ("/Grid", "/Axes"):
            meshcat.SetProperty(path, "visible", False)
        for name in ("top_color", "bottom_color"):
            meshcat.SetProperty("/Background/<object>", name, [1.0, 1.0, 1.0])
        look_at(meshcat, scene)

    def Save(self, path: str | Path, result: SimulationResult | None = None) -> None:
        """Write the recording to a file that needs nothing else.

        Parameters
        ----------
        path : path
            Ending in .html.
        result : SimulationResult, optional
            Of the same simulation. With it curves are seen as they are drawn on both bodies, what
            disturbs while it does, and names; and the camera travels with the finger that is
            disturbed.
        """
        if self._visualizer is None:
            raise SceneError(f"nothing to save in {path}: call Add before the Diagram is built")
        self._visualizer.StopRecording()
        if result is not None:
            draw(self._meshcat, result)
        self._visualizer.PublishRecording()
        html = self._meshcat.StaticHtml()
        if result is not None:
            html = with_texts(html, result)
        with writing(a_path(path)) as file:
            file.write(html.encode())
