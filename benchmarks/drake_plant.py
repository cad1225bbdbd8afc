"""Hydroelastic contact of a scene's plant: force, its spread, faces of patches, cost of a query.

Forces are static, of a continuous plant, whose contact results are the integral of pressure: here
of two spheres in random orientations.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator

import numpy as np
from pydrake.geometry import HydroelasticContactRepresentation
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

import contact_system as cs
from drake_plant.plant import AddScenePlant, PlantConfig

from .report import Bar, Sections

ORIENTATIONS, DEPTH = 60, 2e-4  # [m]
FINGER, OBJECT = 0.04, 0.1  # [m]
POLYGONS = HydroelasticContactRepresentation.kPolygon


def measured() -> tuple[np.ndarray, str]:
    """Forces [N] in all orientations, and what to say about them and the query."""
    contact = cs.Contact(cs.Sphere(FINGER), (1.0, 0.4), finger_velocity=(0.6, 0.8))
    given = {"contacts": [contact], "profile": cs.Profile([0.6]), "duration": 1}
    scene, builder = cs.Scene(object=cs.Sphere(OBJECT), **given), DiagramBuilder()
    config = PlantConfig(time_step=0.0, object_mass=4.18, finger_mass=0.261)
    parts = AddScenePlant(builder, scene, config)
    root, plant = builder.Build().CreateDefaultContext(), parts.plant
    context = plant.GetMyMutableContextFromRoot(root)
    turns = Rotation.random(2 * ORIENTATIONS, random_state=6).as_matrix()
    at = np.array([0, 0, FINGER + OBJECT - DEPTH])
    force, faces, spent = [], [], []
    for one, other in zip(turns[:ORIENTATIONS], turns[ORIENTATIONS:]):
        plant.SetFreeBodyPose(context, parts.object_body, _pose(one, np.zeros(3)))
        plant.SetFreeBodyPose(context, parts.finger_bodies[0], _pose(other, at))
        query = plant.get_geometry_query_input_port().Eval(context)
        begin = time.perf_counter()
        query.ComputeContactSurfaces(POLYGONS)
        spent.append(time.perf_counter() - begin)
        results = plant.get_contact_results_output_port().Eval(context)
        info = results.hydroelastic_contact_info(0)
        force.append(np.linalg.norm(info.F_Ac_W().translational()))
        faces.append(info.contact_surface().num_faces())
    told = f"{np.mean(force):.4f} +- {np.std(force):.4f} N, {np.mean(faces):.0f} faces, "
    return np.array(force), told + f"{1e3 * statistics.median(spent):.2f} ms"


def _pose(turn: np.ndarray, at: np.ndarray) -> RigidTransform:
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(turn), at)


def sphere_force(depth: float) -> float:
    """Integral of the pressure E (1 - r/r1) over the rigid sphere inside the finger, N.

    r is the distance from the finger's centre; no expansion for a small depth. E as for 10 kN/m at
    1 N (`drake_plant.plant`).
    """
    r1, r2 = FINGER, OBJECT
    modulus = 1e8 * (r1 + r2) / r2 / (4 * math.pi)
    distance = r1 + r2 - depth
    edge = math.acos((r2**2 + distance**2 - r1**2) / (2 * r2 * distance))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    angle = edge * (nodes + 1) / 2
    r = np.sqrt(r2**2 + distance**2 - 2 * r2 * distance * np.cos(angle))
    push = modulus * (1 - r / r1) * np.cos(angle) * 2 * math.pi * r2**2 * np.sin(angle)
    return float(edge / 2 * weights @ push)


def spheres(full: bool) -> Iterator[Bar]:
    """Two spheres in random orientations, against the integral."""
    force, told = measured()
    off = abs(force.mean() / sphere_force(DEPTH) - 1)
    yield Bar("static force of spheres off the integral of pressure by", 0.01, off, note=told)
    yield Bar(f"its spread over {ORIENTATIONS} orientations", 0.025, force.std(), "N")


SECTIONS: Sections = {"spheres": spheres}
