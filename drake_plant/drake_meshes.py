"""Meshes and surfaces as shapes of Drake, made in memory: for contact, and for pictures."""

from __future__ import annotations

import math

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh, Rgba

from contact_system.errors import SurfaceError
from contact_system.surfaces import ImplicitSurface, Surface, Torus

from .meshes import Array, Domain, SurfaceMesh, Triangles, edges_of, refined

FINER = 2  # how often the patches that are painted in two shades are subdivided
SHADE = 0.65  # brightness of the darker shade
# Offset of inner points along a ring, in steps, and along its axis, in minor radii. In one plane
# with edges of the grid they would give flat tetrahedra, which Drake refuses.
AHEAD, RAISED = math.sqrt(2) - 1, 0.01


def rigid_mesh(mesh: SurfaceMesh) -> Mesh:
    """The corrected triangles as a Drake Mesh in memory, for rigid hydroelastic contact."""
    lines = _rows("v %.9g %.9g %.9g", mesh.corrected())
    lines += _rows("f %d %d %d", mesh.triangles + 1)
    return _in_memory(lines, ".obj")


def inner_points(surface: Surface) -> Array:
    """The deepest points of a fingertip: its centre, or a torus's middle circle, (k, 3), m."""
    if isinstance(surface, Torus):
        around = (np.arange(64) + AHEAD) * math.pi / 32
        x, y = surface.major * np.stack([np.cos(around), np.sin(around)])
        return np.stack([x, y, np.full(64, RAISED * surface.minor)], axis=1)
    return np.array([surface.center if isinstance(surface, ImplicitSurface) else (0.0, 0.0, 0.0)])


def compliant_mesh(mesh: SurfaceMesh, inner: Array, name: str) -> Mesh:
    """The solid under the corrected triangles as a Drake Mesh, for compliant hydroelastic contact.

    Every triangle is the base of one tetrahedron, whose apex is the nearest inner point. Drake's
    pressure is linear in each, from 0 on the surface to the modulus at the inner point: so it is
    proportional to the depth below the triangle.

    mesh : closed, or a cylinder's side about the z axis, which gets flat ends
    inner : (k, 3), one point, or points around a ring in order, m
    """
    points, triangles = _with_ends(mesh)
    cells = _tetrahedra(points, triangles, inner, name)
    points = np.vstack([points, inner])
    lines = ["# vtk DataFile Version 3.0", "fingertip", "ASCII", "DATASET UNSTRUCTURED_GRID"]
    lines += [f"POINTS {len(points)} double"]
    lines += _rows("%.9g %.9g %.9g", points)
    lines += [f"CELLS {len(cells)} {5 * len(cells)}"]
    lines += _rows("4 %d %d %d %d", cells)
    lines += [f"CELL_TYPES {len(cells)}", *["10"] * len(cells)]
    return _in_memory(lines, ".vtk")


def _with_ends(mesh: SurfaceMesh) -> tuple[Array, Triangles]:
    """Corrected points and triangles, with a fan over each end of a cylinder's side."""
    points, triangles = mesh.corrected(), mesh.triangles
    pairs = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges, sides = edges_of(triangles)
    rim = pairs[np.bincount(sides.ravel())[sides.ravel()] == 1]
    for side in (-1, 1):
        end = rim[np.sign(points[rim[:, 0], 2]) == side]
        if len(end):
            middle = np.full(len(end), len(points))
            points = np.vstack([points, [0, 0, points[end[0, 0], 2]]])
            triangles = np.vstack([triangles, np.column_stack([end[:, ::-1], middle])])
    return points, triangles


def _tetrahedra(points: Array, triangles: Triangles, inner: Array, name: str) -> Triangles:
    """A tetrahedron under each triangle, and others in wedges between those of unequal apexes."""
    count, apex = len(inner), _apexes(points, triangles, inner)
    cells = [np.column_stack([triangles, len(points) + apex])]
    if count > 1:
        edges, sides = edges_of(triangles)
        order = np.argsort(sides.ravel(), kind="stable")
        first, second = np.repeat(apex, 3)[order].reshape(-1, 2).T
        ahead = (second - first + count // 2) % count - count // 2  # steps around the ring
        for k in range(np.abs(ahead).max()):
            wedge = np.abs(ahead) > k
            a = first[wedge] + k * np.sign(ahead[wedge])
            b = a + np.sign(ahead[wedge])
            ring = len(points) + np.column_stack([a, b]) % count
            cells.append(np.column_stack([edges[wedge], ring]))
    cell = np.vstack(cells)
    corner = np.vstack([points, inner])[cell]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1])
    if np.any(volume[: len(triangles)] >= 0):
        raise SurfaceError(
            f"{name}: a triangle of its mesh faces away from the inner point below it, so that no "
            "solid can be built; put the surface's centre where it sees the whole surface, and "
            "near the contacts"
        )
    return np.where((volume < 0)[:, None], cell[:, [0, 2, 1, 3]], cell)


def _apexes(points: Array, triangles: Triangles, inner: Array) -> Triangles:
    """For each triangle the inner point nearest in angle about z to the middle of its span.

    So both triangles at an edge that runs along the ring get the same one.
    """
    x, y, _ = points[triangles].T
    angle = np.arctan2(y, x)
    spans = (angle - angle[0] + math.pi) % (2 * math.pi) - math.pi
    middle = angle[0] + (spans.min(axis=0) + spans.max(axis=0)) / 2
    return np.rint(middle * len(inner) / (2 * math.pi) - AHEAD).astype(int) % len(inner)


def rgba(colour: str, alpha: float = 1.0) -> Rgba:
    """Drake's colour of "#rrggbb"."""
    return Rgba(*(x / 255 for x in bytes.fromhex(colour[1:])), alpha)


def painted(domain: Domain, colour: Rgba) -> list[tuple[Mesh, Rgba]]:
    """The true surface as two meshes of alternate patches, in two shades, so that rolling shows."""
    q, triangles = domain.base(domain.patches)
    dark = np.arange(len(triangles)) % 2 == 1
    for _ in range(FINER):
        q, triangles = refined(domain, q, triangles, np.full(len(triangles), True))
        dark = np.tile(dark, 4)
    points, normals = domain.place(q)
    lines = _rows("v %.5g %.5g %.5g", points)
    lines += _rows("vn %.3f %.3f %.3f", normals)
    facing = np.repeat(triangles + 1, 2, axis=1)
    return [
        (_in_memory(lines + _rows("f %d//%d %d//%d %d//%d", facing[part]), ".obj"), shade)
        for part, shade in ((~dark, colour), (dark, colour.scale_rgb(SHADE)))
    ]


def _rows(form: str, table: Array | Triangles) -> list[str]:
    return [form % tuple(row) for row in table.tolist()]


def _in_memory(lines: list[str], extension: str) -> Mesh:
    content = "\n".join(lines) + "\n"
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(content, extension, f"made{extension}")))
