"""A simulation as one HTML file, to be turned, zoomed and played in a browser.

Besides bodies and forces it shows curves, disturbances and names. These are added to Meshcat's
recording after the simulation, from its logs. They move with the bodies, as they are on the bodies'
branches of Meshcat's tree.
"""

from __future__ import annotations

import html
import json
import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, Role, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.meshcat import ContactVisualizer, ContactVisualizerParams
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from contact_system import Scene
from contact_system.checks import Array
from contact_system.files import a_path, writing
from contact_system.plots.meshes import ribbons
from contact_system.plots.style import DISTURBED, INK, colour_of

from .config import body_names
from .drake_meshes import rgba
from .plant import ScenePlant, model_names

if TYPE_CHECKING:
    from .simulation import SimulationResult

PERIOD = 0.016  # s of a picture; rows of logs, which are 2 ms apart, fall on pictures
FILM = "/drake/film"
BODIES, FORCES = f"{FILM}/bodies", f"{FILM}/forces"
LIFT = 0.02  # height of lines over a surface, whose facets would hide them, of the finger's size
THICK, THIN = 0.1, 0.025  # half of the width of ribbons, of the finger's size
DOT = 0.2  # radius of contact points, of the finger's size
HALO = 1.3  # radius of the sphere that marks a disturbed body, of the body's size
VIEW = np.array([math.sqrt(0.75), 0.0, 0.5])
"""Direction from the middle of the picture to the camera, whose right is y."""
ASIDE = np.array([0.4, 0.7, 0.6]) / math.hypot(0.4, 0.7, 0.6)
"""Direction in which the followed finger is kept: beside the line of sight, to show its contact."""
HAND_VIEW = np.array([[3.8, 2.2, 1.0], [0.0, 0.0, -0.6]])
"""Where the camera is for a hand, and what it looks at, in sizes of the object."""
SEES = math.radians(75.0)  # the angle of view of Meshcat's camera
AROUND = 2.2  # margin around the object or the contacts, in sizes of the largest finger
TURN = 0.4  # greatest turn of the camera from frame to frame, rad: it travels between fingers
ARROW = 2.5  # length of the arrow of the normal force, in sizes of the largest finger


class Recording:
    """Records a simulation with Meshcat: bodies, contact points and contact forces.

    There is a picture for every 16 ms of simulated time, or for the nearest number of steps of a
    discrete plant.

    Parameters
    ----------
    builder : DiagramBuilder
        Visualizers are added to it.
    scene_plant : ScenePlant

    Examples
    --------
    Before builder.Build() and after the simulation:

        film = Recording(builder, scene_plant)

        film.Save("film.html")
    """

    def __init__(self, builder: DiagramBuilder, scene_plant: ScenePlant):
        log = logging.getLogger("drake")
        level = log.level
        log.setLevel(logging.WARNING)  # else Drake prints the address at which Meshcat listens
        self._meshcat = meshcat = Meshcat()
        log.setLevel(level)
        scene, ink = scene_plant.scene, rgba(INK)
        step, period = scene_plant.plant.time_step(), PERIOD
        if step:  # a picture between two steps would end a step of the planner there
            period = step * max(1, round(period / step))
        params = MeshcatVisualizerParams(
            publish_period=period, role=Role.kIllustration, prefix=BODIES
        )
        MeshcatVisualizer.AddToBuilder(builder, scene_plant.scene_graph, meshcat, params)
        largest = max(contact.finger.size for contact in scene.contacts)
        forces = ContactVisualizerParams(
            publish_period=period,
            prefix=FORCES,
            color=ink,
            hydro_force_color=ink,
            newtons_per_meter=scene_plant.config.normal_force / (ARROW * largest),
            newton_meters_per_meter=1e9,  # moments are not to be seen
            radius=largest / 20,
        )
        ContactVisualizer.AddToBuilder(builder, scene_plant.plant, meshcat, forces)
        # Drake rounds frames down: without the little more, k periods are at times in frame k - 1
        meshcat.StartRecording((1.0 + 1e-9) / period, set_visualizations_while_recording=False)
        for path in ("/Grid", "/Axes", "/Background"):
            meshcat.SetProperty(path, "visible", False)
        self._fingers = model_names(scene)
        look_at(meshcat, scene)

    def Save(self, path: str | Path, result: SimulationResult | None = None) -> None:
        """Write the recording to a self-contained file.

        Parameters
        ----------
        path : path
            Ending in .html.
        result : SimulationResult, optional
            Of the same simulation. It adds the curves that contacts draw on both bodies, marks on
            bodies while they are disturbed, and names; and the camera follows the disturbed finger.
        """
        self._meshcat.StopRecording()
        # Drake draws a patch's force on the object, inside it: show the opposite one on the finger.
        for name in self._fingers:
            force = f"{FORCES}/hydroelastic/object+{name}/force_C_W"
            self._meshcat.SetProperty(force, "scale", [1.0, 1.0, -1.0])
        if result is not None:
            draw(self._meshcat, result)
        self._meshcat.PublishRecording()
        page = self._meshcat.StaticHtml()
        if result is not None:
            page = with_texts(page, result)
        with writing(a_path(path)) as file:
            file.write(page.encode())


def look_at(meshcat: Meshcat, scene: Scene, points: Array | None = None) -> Array:
    """Put the camera so far away that it sees the bodies; returns the middle of its view, in O.

    points : (m, n, 3), contact points, the part to be seen of an object that has no centre
    """
    middle, size = np.zeros(3), scene.object.size
    if points is not None and not scene.object.chart.central:
        middle = 0.5 * (np.nanmin(points, axis=(0, 1)) + np.nanmax(points, axis=(0, 1)))
        size = float(np.nanmax(np.linalg.norm(points - middle, axis=-1)))
    distance = size + AROUND * max(contact.finger.size for contact in scene.contacts)
    meshcat.SetCameraPose(distance / math.sin(SEES / 2) * VIEW, np.zeros(3))
    return middle


def disturbances(result: SimulationResult) -> list[tuple[int, float, float]]:
    """Disturbances and pushes in a result: the body's number in `body_names`, start, stop, s."""
    names = body_names(result.scene)
    found = [(int(d.contact), d.start, d.stop) for d in result.scene.disturbances]
    found += [(names.index(push.on), push.start, push.stop) for push in result.config.pushes]
    return [event for event in found if event[1] < result.t[-1]]


def draw(meshcat: Meshcat, result: SimulationResult) -> None:
    """Add curves, contact points, disturbances and the camera's motion to Meshcat's recording."""
    recording, scene = meshcat.get_mutable_recording(), result.scene
    times = np.arange(0.0, result.t[-1], 1.0 / recording.frames_per_second())
    frames = np.searchsorted(result.t, times)  # the logged row for each frame
    for path, (points, faces), drawn, colour in _curves(result):
        side = Meshcat.SideOfFaceToRender.kDoubleSide
        meshcat.SetTriangleMesh(path, points.T, faces.T.astype(np.int32), rgba(colour), side=side)
        if drawn is not None:
            for frame, segments in enumerate(np.searchsorted(drawn, times).tolist()):
                recording.SetProperty(frame, f"{path}/<object>", "drawn", float(segments))
    for i, contact in enumerate(scene.contacts):
        path = f"{_branch(scene, -1)}/point {i}"
        meshcat.SetObject(path, Sphere(DOT * contact.finger.size), rgba("#ffffff"))
        for frame, point in enumerate(result.measured["contact_point"][frames, i]):
            recording.SetTransform(frame, path, RigidTransform(point))
    acting = disturbances(result)
    bodies = [*(contact.finger for contact in scene.contacts), scene.object]
    for on in {on for on, _, _ in acting}:
        path = f"{_branch(scene, on)}/disturbed"
        meshcat.SetObject(path, Sphere(HALO * bodies[on].size), rgba(DISTURBED, 0.35))
        meshcat.SetProperty(f"{path}/<object>", "material.depthWrite", False)
        spans = [(times < stop) & (times > start - PERIOD) for i, start, stop in acting if i == on]
        marked = np.any(spans, axis=0)
        for frame in np.flatnonzero(np.diff(marked, prepend=~marked[0])).tolist():
            recording.SetProperty(frame, path, "visible", bool(marked[frame]))
    if result.config.hand is not None:  # a fixed camera: up stays up
        meshcat.SetCameraPose(*(scene.object.size * HAND_VIEW))
        return
    middle = look_at(meshcat, scene, result.measured["contact_point"])
    for frame, X in enumerate(_views(result, middle, times)):
        recording.SetTransform(frame, FILM, X)


def _branch(scene: Scene, on: int) -> str:
    """A body's branch of Meshcat's tree; ``on`` is its number in `body_names`, -1 the object."""
    name = [*model_names(scene), "object"][on].replace("::", "/")  # as Drake's visualizer does
    return f"{BODIES}/{name}/{name}"


def _curves(
    result: SimulationResult,
) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray], Array | None, str]]:
    """For each curve: Meshcat's path, ribbon, when its points are drawn (None: at once), colour."""
    scene, state = result.scene, result.measured["state"]
    for i, contact in enumerate(scene.contacts):
        u1, v1, u2, v2 = state[:, i, [0, 1, 4, 5]].T
        out, size, colour = scene.object.normal(u2, v2), contact.finger.size, colour_of(i)
        obj, finger = _branch(scene, -1), _branch(scene, i)
        planned, measured = (w["contact_point"][:, i] for w in (result.planned, result.measured))
        on_finger = contact.finger.point(u1, v1), contact.finger.normal(u1, v1)
        for path, points, normals, width, shade in (
            (f"{obj}/planned {i}", planned + 0.5 * LIFT * size * out, out, THIN, INK),
            (f"{obj}/curve {i}", measured, out, THICK, colour),
            (f"{finger}/curve", *on_finger, THICK, colour),
        ):
            known = np.isfinite(points + normals).all(axis=1)
            at, up = points[known], normals[known]
            curve = ribbons(at + LIFT * size * up, up, width * size)
            yield path, curve, None if shade == INK else result.t[known], shade


def _views(result: SimulationResult, middle: Array, times: Array) -> Iterator[RigidTransform]:
    """Pose of the whole film at each frame: it moves in the place of the camera, which is fixed."""
    frames, acting = np.searchsorted(result.t, times), disturbances(result)
    at = result.measured["state"][frames]
    normals = result.scene.object.normal(at[..., 4], at[..., 5])
    contacts = range(len(result.scene.contacts))
    fingers = [event for event in acting if event[0] in contacts] or [(0, 0.0, 0.0)]
    turn, most = Rotation.identity(), math.pi
    for t, X_WO, normal in zip(times, result.object_pose[frames], normals):
        # the finger that is disturbed now, last or next
        i, *_ = min(fingers, key=lambda event: max(event[1] - t, t - event[2], 0.0))
        now = turn.apply(X_WO[:3, :3] @ normal[i])
        if np.isfinite(now).all():
            more, _ = Rotation.align_vectors(ASIDE, now)
            turn, most = more ** (most / max(more.magnitude(), most)) * turn, TURN
        place = X_WO[:3, 3] + X_WO[:3, :3] @ middle
        yield RigidTransform(RotationMatrix(turn.as_matrix()), -turn.apply(place))


# --- additions to the page, whose viewer can do more than Drake's Meshcat ----------------------

DRAWN = """
<script>
  Object.defineProperty(MeshCat.THREE.Object3D.prototype, "drawn", {
    get() { return 0; },
    set(segments) { this.geometry.setDrawRange(0, 6 * Math.floor(segments)); },
  });
</script>
"""
"""How much of a ribbon is drawn, as a property that an animation can change."""
KEY = """
<div style="position: fixed; left: 16px; top: 12px; font: 15px sans-serif; color: {ink}">
<b>{title}</b><br>{entries}
</div>
<script>
for (const [path, text, size] of {names})
  viewer.set_object_from_json(path.split("/").filter(word => word), {{
    metadata: {{version: 4.5, type: "Object"}}, geometries: [],
    textures: [{{uuid: "t", type: "_text", text, font_size: 64, font_face: "sans-serif"}}],
    materials: [
      {{uuid: "m", type: "SpriteMaterial", map: "t", transparent: true, depthTest: false}}],
    object: {{uuid: "o", type: "Sprite", material: "m", renderOrder: 1,
              matrix: [size, 0, 0, 0, 0, size, 0, 0, 0, 0, size, 0, 0, 0, 0, 1]}},
  }});
</script>
"""
"""A legend of colours, and the bodies' names: Drake's Meshcat has no texts."""


def with_texts(page: str, result: SimulationResult) -> str:
    """A recording's page with names on the bodies, and a legend."""
    scene, entries, names = result.scene, [], []
    for i, contact in enumerate(scene.contacts):
        name = scene.contact_name(i)
        names.append((f"{_branch(scene, i)}/name", name, 2.0 * contact.finger.size))
        entries.append((colour_of(i), "\u2501", f"{name}: contact as measured, on both bodies"))
    entries += [(INK, "\u2500", "planned"), (INK, "\u25cb\u2191", "contact point, force")]
    if disturbances(result):
        entries.append((DISTURBED, "\u25cf", "disturbed"))
    lines = [
        f'<span style="color: {colour}">{mark}</span> {html.escape(text)}'
        for colour, mark, text in entries
    ]
    title = html.escape(f"{scene.name}: {scene.description}".strip(": "))
    listed = json.dumps(names).replace("</", "<\\/")
    key = KEY.format(ink=INK, title=title, entries="<br>".join(lines), names=listed)
    page = page.replace("</script>", "</script>" + DRAWN, 1)  # after the viewer's own script
    return page.replace("</body>", key + "</body>")
