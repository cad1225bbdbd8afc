"""The page: bodies, rolling fingers, growing curves, sliders, the plot of slip.

All windows of the browser share one state. Callbacks of viser only store requests; the thread that
called :meth:`Explorer.run` plans and draws the latest one.
"""

from __future__ import annotations

import contextlib
import io
import socket
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ContactSystemError
from ..files import make_folder
from ..plan import Plan, plan
from ..plots import DECADES
from ..plots.bodies import best_view
from ..plots.curves import curve_of
from ..plots.meshes import Mesh, mesh_of
from ..plots.style import BODY, DISTURBED, colour_of
from ..scene import NO_CLAIMS, Scene, save_scene
from ..steering import Goal, reach
from ..surfaces import ParametricSurface
from ..terminal import tell
from ..theory.gain import LAWS
from .sliders import Place, Slider, adjusted, sliders_of

try:
    import viser
except ImportError as error:
    raise ContactSystemError(
        f'the explorer needs viser: pip install ".[explore]" in the clone ({error})'
    ) from None

HOST = "127.0.0.1"  # this machine only, as the page can write files
SAMPLES = 401
CELLS, FINGER_CELLS = 32, 16  # of meshes in each coordinate; finer ones look alike
LINES = 4  # every fourth line of a mesh is drawn
# of the object's size: width of lines, error of curves, depth of lines below curves, and of bodies
# below lines
WIDTH, BEND, DEPTH = 3e-3, 1e-3, 1.5e-3
FRAME = 1 / 30  # s, between frames of an animation


class Sampled:
    """A plan at times (n,): points (n, contacts, 2, 3), poses (n, contacts, 4, 4), slip."""

    def __init__(self, planned: Plan):
        self.plan, self.t = planned, np.linspace(planned.start, planned.end, SAMPLES)
        results = planned.evaluate(self.t, "points", "pose", "slip_speed")
        self.points, self.pose, self.slip = results.values()


class Explorer:
    """A scene in the browser, at a port; 0: any free one. The button *Save scene* writes `file`.

    Raises a ContactSystemError for a scene that cannot be planned, or a port that is in use.
    """

    def __init__(self, scene: Scene, file: Path, port: int):
        self.base, self.file = scene, file
        self.moved: dict[Place, Any] = {}
        self.goals: dict[int, Goal] = {}
        self.wake, self.stale, self.playing = threading.Event(), False, False
        self.knots: dict[tuple[int, int], np.ndarray] = {}
        self.clicked: tuple[np.ndarray, np.ndarray] | None = None
        self.now = scene.duration
        self.shown = Sampled(plan(scene))
        self.meshes: list[Mesh | None] = [None] * (1 + len(scene.contacts))  # object, fingers
        mesh = mesh_of(self.shown.plan, 1, range(len(scene.contacts)), CELLS)
        self.unit = 1.0 / (scene.object.size if mesh is None else mesh.size)
        _require_free(port)
        with contextlib.redirect_stdout(io.StringIO()):  # viser's own greeting
            self.server = viser.ViserServer(HOST, port, scene.name or "contact_system", False)
        self.address = f"http://{HOST}:{self.server.get_port()}"
        self._add_controls()
        self._add_bodies()
        self._look()
        self._draw()

    def run(self) -> None:
        """Print the address, and serve until Ctrl-C."""
        try:
            tell(f"{self.base.title} at {self.address}; Ctrl-C ends it")
            last = time.monotonic()
            while True:
                self.wake.wait(FRAME if self.playing else 0.5)
                self.wake.clear()
                elapsed, last = time.monotonic() - last, time.monotonic()
                self.step(elapsed)
        finally:
            self.close()

    def ask(self, values: Mapping[Place, Any]) -> None:
        """Request the scene with these values in these places; the next step draws it."""
        self.moved |= values
        self.stale = True
        self.wake.set()

    def step(self, elapsed: float) -> None:
        """Handle requests, and advance a running animation by `elapsed` seconds."""
        try:
            if self.clicked is not None:
                self._click(*self.clicked)
            elif self.stale:
                self._plan_again()
        except ContactSystemError as error:
            self.said.content = f"**Refused, so the picture stays:** {error}"
        if self.playing:
            span = self.shown.plan.end - self.shown.plan.start
            self.now = (self.now + elapsed) % span
            self.clock.value = round(self.now, 4)  # type: ignore[misc]
        if self.drawn != self.now:
            self._draw()
        self.server.flush()

    def close(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    # --- controls ------------------------------------------------------------------------------

    def _add_controls(self) -> None:
        gui, scene = self.server.gui, self.base
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()  # beside the picture, which else is partly behind it
        self.said = gui.add_markdown(scene.description)
        self.slip = gui.add_uplot(
            self._slip_data(),
            ({"label": "time"}, *map(self._slip_style, range(len(scene.contacts)))),
            scales={"x": {"time": False}},
            legend={"show": False},
            title="log10 of slip [m/s] over time [s]",
            aspect=1.8,
            padding=(8, 24, 0, 0),  # room for the topmost number
        )
        self.play = gui.add_button("Play")
        self.clock = gui.add_slider("time [s]", 0.0, scene.duration, 1e-3, scene.duration)
        self.finger = gui.add_dropdown(
            "a click sends", [f"{i}: {scene.contact_name(i)}" for i in range(len(scene.contacts))]
        )
        self.forget = gui.add_button("Forget goals", disabled=True)
        self.save = gui.add_button("Save scene")
        self.law = gui.add_dropdown("gain law", tuple(LAWS), initial_value=scene.gain.law)
        value, place = scene.gain.value, ("gain", "value")
        most = 4 * value or 100.0
        self.gain = self._slider(Slider("", self._parameter(), 0.0, most, value, (place,)))
        folders: dict[str, Any] = {}
        self.idle: list[Any] = []  # folders of what a route to a goal leaves out
        for slider in sliders_of(scene):
            if slider.folder not in folders:
                first = slider.folder in ("profile", "shapes")
                folders[slider.folder] = gui.add_folder(slider.folder, expand_by_default=first)
                if slider.places[0][0] in ("profile", "disturbances"):
                    self.idle.append(folders[slider.folder])
            with folders[slider.folder]:
                self._slider(slider)
        self._add_handlers()

    def _add_handlers(self) -> None:
        """What the controls do."""

        @self.law.on_update
        async def _(_: Any) -> None:
            self.gain.label = self._parameter()
            self.ask({("gain", "law"): self.law.value})

        @self.play.on_click
        async def _(_: Any) -> None:
            self.playing = not self.playing
            self.play.label = "Pause" if self.playing else "Play"
            self.wake.set()

        @self.clock.on_update
        async def _(event: Any) -> None:
            if event.client is not None:
                self.now = self.clock.value
                self.wake.set()

        @self.forget.on_click
        async def _(_: Any) -> None:
            self.goals.clear()
            self.ask({})

        @self.save.on_click
        def _(_: Any) -> None:
            self._save()

    def _slider(self, slider: Slider) -> Any:
        """A slider in the page. It shows a rounded value; until it is moved, and again when it is
        moved back to its first place, the scene has its exact value."""
        span = slider.high - slider.low
        step = 10.0 ** np.floor(np.log10(span / 200))
        low, high = (round(x / step) * step for x in (slider.low, slider.high))
        value = float(np.clip(round(slider.value / step) * step, low, high))
        low, high, value, step = (float(f"{x:.9g}") for x in (low, high, value, step))
        handle = self.server.gui.add_slider(slider.label, low, high, step, value)

        @handle.on_update
        async def _(_: Any) -> None:
            now = slider.value if handle.value == value else handle.value
            self.ask({place: slider.made(now) for place in slider.places})

        return handle

    def _parameter(self) -> str:
        law = LAWS[self.law.value]
        return f"{law.parameter} [{law.unit}]"

    # --- requests ------------------------------------------------------------------------------

    def _requested(self) -> tuple[Scene, str]:
        """The scene with the values of the sliders and the legs to the goals, and a text on it."""
        scene = adjusted(self.base, dict(self.moved))
        if not self.goals:
            return scene, scene.description
        goals = [self.goals.get(i) for i in range(len(scene.contacts))]
        left = " Fingers without a goal rest." if None in goals else ""
        left += " Disturbances are left out." if scene.disturbances else ""
        route = reach(scene.replace(disturbances=()), goals)
        legs = sum(leg.length != 0 for own in route.legs for leg in own)
        text = f"{legs} leg{'s' * (legs > 1)}, {route.length:.3g} m in all, to the goal."
        return route.scene, text + left

    def _plan_again(self) -> None:
        """Plan and draw the requested scene."""
        self.stale = False
        scene, text = self._requested()
        self.shown = Sampled(plan(scene))
        with self.server.atomic():  # otherwise the browser may draw twice
            self.said.content, self.forget.disabled = text, not self.goals
            for folder in self.idle:
                folder.visible = not self.goals
            self._draw_shapes()
            self._draw()

    def _click(self, origin: np.ndarray, direction: np.ndarray) -> None:
        """Make the point where a ray meets the object the goal of the chosen finger."""
        self.clicked = None
        mesh = self.meshes[0]
        hit = None if mesh is None else _first_hit(mesh, origin / self.unit, direction)
        if hit is None:
            return
        body = self.shown.plan.scene.object
        if isinstance(body, ParametricSurface):  # the hit is on a triangle near it
            u, v, _ = body.nearest(hit)
        else:
            u, v = body.coordinates(hit)
        before, i = dict(self.goals), int(self.finger.value.partition(":")[0])
        self.goals[i] = Goal(object_at=(float(u), float(v)))
        try:
            self._plan_again()
        except ContactSystemError:
            self.goals = before
            raise

    def _save(self) -> None:
        try:
            make_folder(self.file.parent, "name another one with --out")
            moved = self.shown.plan.scene.replace(name=self.file.stem, **NO_CLAIMS)
            save_scene(moved, self.file)
        except ContactSystemError as error:
            self.said.content = f"**Not saved:** {error}"
        else:
            self.said.content = f"Wrote `{self.file}`"

    # --- picture -------------------------------------------------------------------------------

    def _add_bodies(self) -> None:
        """Add all nodes of the picture; later only their properties change."""
        tree, contacts = self.server.scene, self.base.contacts
        tree.configure_default_lights(cast_shadow=False)
        tree.configure_environment_map(None)  # reflections take half of the time without a GPU
        tree.add_light_ambient("/light")
        none, flat = np.zeros((1, 2, 3), np.uint8), (np.zeros((3, 3)), np.array([[0, 1, 2]]))
        names = ["/object", *(f"/finger {i}" for i in range(len(contacts)))]
        self.frames: list[Any] = [tree.add_frame(name, show_axes=False) for name in names]
        self.bodies: list[Any] = []
        self.lines: list[Any] = []
        for k, name in enumerate(names):
            dark, light = [colour_of(k - 1)] * 2 if k else BODY
            style: dict[str, Any] = {"color": _rgb(dark), "opacity": 0.6 if k else None}
            self.bodies.append(tree.add_mesh_simple(f"{name}/body", *flat, **style))
            self.lines.append(tree.add_mesh_simple(f"{name}/lines", *flat, color=_rgb(light)))
        self.curves: list[list[Any]] = [
            [
                tree.add_line_segments(
                    f"{name}/curve {i}", none, none, thickness=w, thickness_units="screen"
                )
                for name, w in ((f"/finger {i}", 3), ("/object", 4))
            ]
            for i in range(len(contacts))
        ]
        self.marks = [
            tree.add_icosphere(f"/goal {i}", 0.02, color=_rgb(colour_of(i)), visible=False)
            for i in range(len(contacts))
        ]
        self._draw_shapes()

        @self.bodies[0].on_click
        async def _(event: Any) -> None:
            self.clicked = np.array(event.ray_origin), np.array(event.ray_direction)
            self.wake.set()

    def _draw_shapes(self) -> None:
        """Draw what does not depend on time: bodies, colours, goals, the plot of slip."""
        shown, scene = self.shown, self.shown.plan.scene
        self.slip.data = self._slip_data()
        self.law.disabled = self.gain.disabled = not shown.slip.any()
        for k, (body, lines) in enumerate(zip(self.bodies, self.lines)):
            surface = scene.contacts[k - 1].finger if k else scene.object
            mesh = self.meshes[k]
            if mesh is not None and mesh.whole and mesh.surface == surface:
                continue
            which = [k - 1] if k else range(len(scene.contacts))
            mesh = mesh_of(shown.plan, int(not k), which, FINGER_CELLS if k else CELLS)
            self.meshes[k] = mesh
            body.visible = lines.visible = mesh is not None
            if mesh is not None:
                body.side = "front" if mesh.whole or surface.inside else "double"
                lines.side = "double" if k or surface.inside else body.side
                points = mesh.points * self.unit - DEPTH * mesh.normals
                body.vertices, body.faces = points - DEPTH * mesh.normals, mesh.triangles()
                lines.vertices, lines.faces = replace(mesh, points=points).strips(LINES, WIDTH)
        for i, pair in enumerate(self.curves):
            curve = curve_of(shown.plan, i, shown.t, shown.points[:, i, 1])
            colours = np.where(curve.disturbed[:, None], _linear(DISTURBED), _linear(curve.colour))
            for side, node in enumerate(pair):
                self.knots[i, side] = _knots(shown.points[:, i, side] * self.unit, curve.disturbed)
                node.colors = np.repeat(colours[self.knots[i, side][:-1], None], 2, axis=1)
            goal = self.goals.get(i)
            self.marks[i].visible = goal is not None
            if goal is not None and goal.object_at is not None:
                self.marks[i].position = scene.object.point(*goal.object_at) * self.unit

    def _draw(self) -> None:
        """Draw what depends on time: the curves so far, and the fingers' poses."""
        shown, self.drawn = self.shown, self.now
        k = max(int(np.searchsorted(shown.t, self.now + 1e-9, "right")) - 1, 0)
        with self.server.atomic():
            for i, pair in enumerate(self.curves):
                for side, node in enumerate(pair):
                    so_far = np.minimum(self.knots[i, side], k)
                    points = shown.points[so_far, i, side] * self.unit
                    node.points = np.stack([points[:-1], points[1:]], axis=1)
                pose = shown.pose[k, i]
                turn = viser.transforms.SO3.from_matrix(pose[:3, :3])
                self.frames[1 + i].wxyz = turn.wxyz
                self.frames[1 + i].position = pose[:3, 3] * self.unit

    def _slip_data(self) -> tuple[np.ndarray, ...]:
        """Times, and log10 of each contact's slip."""
        slip = self.shown.slip
        least = max(slip.max() * 10.0**-DECADES, 1e-16)
        return self.shown.t, *np.log10(np.maximum(slip, least)).T

    def _slip_style(self, contact: int) -> Any:
        style = {"stroke": colour_of(contact), "width": 2, "points": {"show": False}}
        return {"label": str(contact), **style}

    def _look(self) -> None:
        """Place the camera at the best view of the curves, where it sees all bodies whole."""
        shown, points = self.shown, self.shown.points[:, :, 1]
        curves = [curve_of(shown.plan, i, shown.t, points[:, i]) for i in range(points.shape[1])]
        bodies = zip(self.meshes, (np.eye(4), *shown.pose[-1]))
        placed = [m.points @ pose[:3, :3].T + pose[:3, 3] for m, pose in bodies if m is not None]
        seen = np.concatenate([points.reshape(-1, 3), *placed]) * self.unit
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
        camera: Any = self.server.initial_camera
        camera.fov, camera.look_at = 0.8, middle
        away = 1.25 * np.linalg.norm(seen - middle, axis=1).max() / np.sin(camera.fov / 2)
        camera.position = middle + away * best_view(self.meshes[0], curves)[:, 2]

        @self.server.on_client_connect
        async def _(client: Any) -> None:  # windows taller than wide see as much across
            narrow = min(client.camera.aspect, 1.0)
            client.camera.fov = 2 * np.arctan(np.tan(camera.fov / 2) / narrow)


def _require_free(port: int) -> None:
    try:
        socket.create_server((HOST, port)).close()
    except OSError as error:
        raise ContactSystemError(
            f"port {port}: {error.strerror}; give another one with --port, or 0 for any"
        ) from None


def _rgb(colour: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def _linear(colour: str) -> np.ndarray:
    """The colour in linear light, as viser takes colours of points: (3,)."""
    return np.rint(255 * (np.array(_rgb(colour)) / 255) ** 2.2).astype(np.uint8)


def _knots(points: np.ndarray, disturbed: np.ndarray) -> np.ndarray:
    """Indices (m,) of few points that approximate a curve (n, 3): each segment is a draw call."""
    bent = np.linalg.norm(np.diff(points, 2, axis=0), axis=1)
    lines = np.floor(np.cumsum(np.sqrt(bent / (8 * BEND))))
    inner = np.diff(lines, prepend=0.0) + np.diff(disturbed)[:-1]
    return np.concatenate([[0], 1 + np.flatnonzero(inner), [len(points) - 1]])


def _first_hit(mesh: Mesh, origin: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
    """The first point of a ray on a mesh, (3,); on a hollow, on its visible side."""
    triangles = mesh.triangles()
    if mesh.surface.inside:
        triangles = triangles[mesh.normals[triangles[:, 0]] @ direction < 0]
    a, b, c = (mesh.points[triangles[:, k]] for k in range(3))
    sides = np.stack([b - a, c - a, np.broadcast_to(-direction, a.shape)], axis=2)
    across = np.linalg.det(sides) != 0.0  # others are seen edge-on
    x, y, t = np.linalg.solve(sides[across], (origin - a)[across, :, None])[..., 0].T
    hits = (x >= 0) & (y >= 0) & (x + y <= 1) & (t > 0)
    return origin + t[hits].min() * direction if hits.any() else None
