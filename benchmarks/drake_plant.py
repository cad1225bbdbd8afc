"""Hydroelastic contact of a scene's plant: force, its spread, faces, queries, building.

Static forces come from a continuous plant, whose contact results are the integral of pressure.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from pydrake.geometry import HydroelasticContactRepresentation
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

import contact_system as cs
from drake_plant.plant import AddScenePlant, PlantConfig, ScenePlant, contact_depth

from .report import Bar

ORIENTATIONS = 60
FINE = {"finger_edge": 1.5e-3, "object_edge": 1.9e-3, "strip_margin": 1e-3}
EVERYWHERE = {**FINE, "strip_margin": 1.0}
DRAKES = {"drake_spheres": 1.5e-3}
POLYGONS = HydroelasticContactRepresentation.kPolygon


@dataclass(frozen=True)
class Forces:
    """Magnitude, N, and faces of patches; and what a query for contact surfaces takes, s."""

    force: np.ndarray
    faces: np.ndarray
    query: float

    def __str__(self) -> str:
        return (
            f"{self.force.mean():.4f} +- {self.force.std():.4f} N, {self.faces.mean():.0f} faces, "
            f"{1e3 * self.query:.2f} ms"
        )


class World:
    """A plant with one finger and its Context."""

    def __init__(self, obj: cs.Surface, **changes: Any):
        # A great circle around spheres and ellipsoids, a helix of a cylinder.
        contact = cs.Contact(cs.Sphere(0.04), (1.0, 0.4), finger_velocity=(0.6, 0.8))
        self.scene = cs.Scene(object=obj, contacts=[contact], profile=cs.Profile([0.6]), duration=1)
        self.config = PlantConfig(
            **{"time_step": 0.0, "object_mass": 4.18, "finger_mass": 0.261, **changes}
        )
        builder = DiagramBuilder()
        self.parts: ScenePlant = AddScenePlant(builder, self.scene, self.config)
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()

    def forces(self, poses: list[tuple[RigidTransform, RigidTransform]]) -> Forces:
        """Of a list of poses of object and finger."""
        plant, (finger,) = self.parts.plant, self.parts.finger_bodies
        force, faces, spent = [], [], []
        for X_WO, X_WF in poses:
            root = self.root
            if self.config.time_step:  # contact results are those of a step
                simulator = Simulator(self.diagram)
                root = simulator.get_mutable_context()
            context = plant.GetMyMutableContextFromRoot(root)
            plant.SetFreeBodyPose(context, self.parts.object_body, X_WO)
            plant.SetFreeBodyPose(context, finger, X_WF)
            query = plant.get_geometry_query_input_port().Eval(context)
            begin = time.perf_counter()
            query.ComputeContactSurfaces(POLYGONS)
            spent.append(time.perf_counter() - begin)
            if self.config.time_step:
                simulator.AdvanceTo(self.config.time_step)
            info = (
                plant.get_contact_results_output_port().Eval(context).hydroelastic_contact_info(0)
            )
            force.append(np.linalg.norm(info.F_Ac_W().translational()))
            faces.append(info.contact_surface().num_faces())
        return Forces(np.array(force), np.array(faces), statistics.median(spent))

    def along_plan(self) -> list[tuple[RigidTransform, RigidTransform]]:
        """Poses at random times of the plan, as deep as carries the normal force."""
        plan = cs.plan(self.scene)
        t = np.random.default_rng(5).uniform(0, 1, ORIENTATIONS)
        pose, point = plan.pose(t)[:, 0], plan.points(t)[:, 0, 1]
        normal = self.scene.object.normal(*self.scene.object.coordinates(point))
        depth = contact_depth(self.config)
        return [
            (RigidTransform(), _transform(X[:3, :3], X[:3, 3] - depth * n))
            for X, n in zip(pose, normal)
        ]


def _transform(turn: np.ndarray, at: np.ndarray) -> RigidTransform:
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(turn), at)


def orientations() -> list[tuple[RigidTransform, RigidTransform]]:
    """A sphere of 0.04 m, 0.2 mm deep in one of 0.1 m; both turned at random."""
    turns = Rotation.random(2 * ORIENTATIONS, random_state=6).as_matrix()
    at = np.array([0, 0, 0.14 - 2e-4])
    return [
        (_transform(R, np.zeros(3)), _transform(S, at))
        for R, S in zip(turns[:ORIENTATIONS], turns[ORIENTATIONS:])
    ]


def sphere_force(depth: float) -> float:
    """Integral of the pressure E (1 - r/r1) over the rigid sphere inside the finger, N.

    r is the distance from the finger's centre; no expansion for a small depth. E as for 10 kN/m at
    1 N (`drake_plant.plant`).
    """
    r1, r2 = 0.04, 0.1
    modulus = 1e8 * (r1 + r2) / r2 / (4 * math.pi)
    distance = r1 + r2 - depth
    edge = math.acos((r2**2 + distance**2 - r1**2) / (2 * r2 * distance))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    angle = edge * (nodes + 1) / 2
    r = np.sqrt(r2**2 + distance**2 - 2 * r2 * distance * np.cos(angle))
    push = modulus * (1 - r / r1) * np.cos(angle) * 2 * math.pi * r2**2 * np.sin(angle)
    return float(edge / 2 * weights @ push)


def spheres(full: bool) -> Iterator[Bar]:
    """Two spheres in random orientations, against the integral and against Drake's own."""
    ours, drakes = (World(cs.Sphere(0.1), **c).forces(orientations()) for c in ({}, DRAKES))
    exact, detail = sphere_force(2e-4), _detail(ours=ours, drakes=drakes)
    yield Bar("static force of spheres off the integral of pressure by", 0.01,
              abs(ours.force.mean() / exact - 1), note=f"{ours}", detail=detail)  # fmt: skip
    yield Bar("its spread over 60 orientations", 0.025, ours.force.std(), "N",
              note=f"Drake's 1.5 mm: {drakes}", detail=detail)  # fmt: skip
    stepped, fine = (
        World(cs.Sphere(0.1), time_step=1e-3, **c).forces(orientations()) for c in ({}, EVERYWHERE)
    )
    # D1's masses give way within the step, and "sap" is 1 % softer: 0.948 N instead of 0.998 N.
    limit = fine.force.mean()
    yield Bar("force in a step of 1 ms, off the fine meshes' by", 0.01,
              abs(stepped.force.mean() / limit - 1),
              note=f"{stepped}; limit {limit:.4f} N",
              detail=_detail(stepped=stepped, fine=fine))  # fmt: skip


def shapes(full: bool) -> Iterator[Bar]:
    """An ellipsoid and a cylinder against their own fine meshes, along a planned curve."""
    objects = {"ellipsoid .12/.1/.08": cs.Ellipsoid(0.12, 0.1, 0.08), "cylinder": cs.Cylinder(0.1)}
    if full:
        objects |= {"torus": cs.Torus(0.2, 0.08), "ellipsoid .3/.2/.1": cs.Ellipsoid(0.3, 0.2, 0.1)}
    for name, surface in objects.items():
        worlds = (World(surface, **changes) for changes in ({}, FINE))
        ours, fine = (world.forces(world.along_plan()) for world in worlds)
        ratio = ours.force / fine.force
        yield Bar(f"static force on the {name} off its fine meshes' by", 0.02,
                  abs(ratio.mean() - 1), note=f"spread {ratio.std():.4f}; {ours}",
                  detail=_detail(ours=ours, fine=fine))  # fmt: skip


def building(full: bool) -> Iterator[Bar]:
    """D1's plant and its Context, ours and Drake's own spheres turn by turn."""
    scene = cs.load_scene("D1")
    spent: dict[str, list[float]] = {"ours": [], "Drake's": []}
    for _ in range(5 if full else 3):
        for name, changes in (("ours", {}), ("Drake's", DRAKES)):
            begin = time.perf_counter()
            builder = DiagramBuilder()
            AddScenePlant(builder, scene, PlantConfig(**{**_physics(scene), **changes}))
            builder.Build().CreateDefaultContext()
            spent[name].append(time.perf_counter() - begin)
    ours, drakes = (statistics.median(spent[name]) for name in spent)
    yield Bar("building D1's plant and a Context", 3.0, ours, "s",
              note=f"Drake's spheres at 1.5 mm: {drakes:.2f} s", detail=spent)  # fmt: skip


def _physics(scene: cs.Scene) -> dict[str, Any]:
    """What a scene says about its plant."""
    known = {field.name for field in fields(PlantConfig)}
    return {key: value for key, value in scene.drake.items() if key in known}


def _detail(**forces: Forces) -> dict[str, Any]:
    return {name: {"force": f.force.tolist(), "faces": f.faces.tolist(), "query": f.query}
            for name, f in forces.items()}  # fmt: skip


SECTIONS = {"spheres": spheres, "shapes": shapes, "building": building}
