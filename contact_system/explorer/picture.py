"""The picture of a plan: bodies, rolling fingers, growing curves, goals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from ..plan import Plan
from ..plots.bodies import best_view
from ..plots.curves import curve_of
from ..plots.meshes import Mesh, mesh_of
from ..plots.style import BODY, DISTURBED, colour_of
from ..steering import Goal
from ..surfaces import ParametricSurface

SAMPLES = 401
CELLS, FINGER_CELLS = 32, 16  # of meshes in each coordinate; finer ones look alike
LINES = 4  # every fourth line of a mesh is drawn
# of the object's size: width of lines, error of curves, depth of lines below curves, and of bodies
# below lines
WIDTH, BEND, DEPTH = 3e-3, 1e-3, 1.5e-3


class Picture:
    """A plan in viser's scene, at times t (n,): points (n, contacts, 2, 3), pose (n, contacts, 4,
    4), slip (n, contacts). All nodes are added at once; later only their properties change.

    A click calls a function with the ray's origin and direction.
    """

    def __init__(self, server: viser.ViserServer, first: Plan, clicked: Callable[..., None]):
        self.server, tree, contacts = server, server.scene, first.scene.contacts
        self.knots: dict[tuple[int, int], np.ndarray] = {}
        self.meshes: list[Mesh | None] = [None] * (1 + len(contacts))  # object, fingers
        mesh = mesh_of(first, 1, range(len(contacts)), CELLS)
        self.unit = 1.0 / (first.scene.object.size if mesh is None else mesh.size)
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

        @tree.on_click()  # if the object itself took clicks, it would be painted below the mouse
        def _(event: Any) -> None:
            clicked(np.array(event.ray_origin), np.array(event.ray_direction))

    def show(self, plan: Plan, goals: Mapping[int, Goal]) -> None:
        """Evaluate a plan, and draw what does not depend on time: bodies, colours, goals."""
        t = np.linspace(plan.start, plan.end, SAMPLES)
        results = plan.evaluate(t, "points", "pose", "slip_speed")  # if refused, all stays
        self.plan, self.t, scene = plan, t, plan.scene
        self.points, self.pose, self.slip = results.values()
        for k, (body, lines) in enumerate(zip(self.bodies, self.lines)):
            surface = scene.contacts[k - 1].finger if k else scene.object
            mesh = self.meshes[k]
            if mesh is not None and mesh.whole and mesh.surface == surface:
                continue
            which = [k - 1] if k else range(len(scene.contacts))
            mesh = mesh_of(plan, int(not k), which, FINGER_CELLS if k else CELLS)
            self.meshes[k] = mesh
            body.visible = lines.visible = mesh is not None
            if mesh is not None:
                body.side = "front" if mesh.whole or surface.inside else "double"
                lines.side = "double" if k or surface.inside else body.side
                points = mesh.points * self.unit - DEPTH * mesh.normals
                body.vertices, body.faces = points - DEPTH * mesh.normals, mesh.triangles()
                lines.vertices, lines.faces = replace(mesh, points=points).strips(LINES, WIDTH)
        for i, pair in enumerate(self.curves):
            curve = curve_of(plan, i, self.t, self.points[:, i, 1])
            colours = np.where(curve.disturbed[:, None], _linear(DISTURBED), _linear(curve.colour))
            for side, node in enumerate(pair):
                self.knots[i, side] = _knots(self.points[:, i, side] * self.unit, curve.disturbed)
                node.colors = np.repeat(colours[self.knots[i, side][:-1], None], 2, axis=1)
            goal = goals.get(i)
            self.marks[i].visible = goal is not None
            if goal is not None and goal.object_at is not None:
                self.marks[i].position = scene.object.point(*goal.object_at) * self.unit

    def draw(self, now: float) -> None:
        """Draw what depends on time: the curves so far, and the fingers' poses."""
        self.drawn = now
        k = max(int(np.searchsorted(self.t, now + 1e-9, "right")) - 1, 0)
        with self.server.atomic():
            for i, pair in enumerate(self.curves):
                for side, node in enumerate(pair):
                    so_far = np.minimum(self.knots[i, side], k)
                    points = self.points[so_far, i, side] * self.unit
                    node.points = np.stack([points[:-1], points[1:]], axis=1)
                pose = self.pose[k, i]
                turn = viser.transforms.SO3.from_matrix(pose[:3, :3])
                self.frames[1 + i].wxyz = turn.wxyz
                self.frames[1 + i].position = pose[:3, 3] * self.unit

    def look(self) -> None:
        """Place the camera at the best view of the curves, where it sees all bodies whole."""
        points = self.points[:, :, 1]
        curves = [curve_of(self.plan, i, self.t, points[:, i]) for i in range(points.shape[1])]
        bodies = zip(self.meshes, (np.eye(4), *self.pose[-1]))
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

    def met(self, origin: np.ndarray, direction: np.ndarray) -> tuple[float, float] | None:
        """(u, v) where a ray first meets the object; None where it does not."""
        mesh = self.meshes[0]
        hit = None if mesh is None else _first_hit(mesh, origin / self.unit, direction)
        if mesh is None or hit is None:
            return None
        body = mesh.surface
        if isinstance(body, ParametricSurface):  # the hit is on a triangle near it
            u, v, _ = body.nearest(hit)
        else:
            u, v = body.coordinates(hit)
        return float(u), float(v)


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
