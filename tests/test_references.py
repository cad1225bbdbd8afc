"""Plans against references of 25 digits that were made without this package (tests/oracles).

Contact points, geodesics and charts are judged by `benchmarks.accuracy`.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from oracles.formulas import reflection
from oracles.load import load, scene_of

import contact_system as cs
from benchmarks import accuracy

FILES = ("k_scenes", "k_scenes_time", "torus_slip", "ellipsoid_slip", "sphere_slip", "slip_peaks")

reference = functools.cache(load)
CASES = [(file, name) for file in FILES for name in reference(file)["scenes"]]


def true_values(file: str, name: str, key: str) -> np.ndarray:
    """Contacts along the second axis."""
    contacts = reference(file)["scenes"][name]["contacts"]
    return np.stack([contact[key] for contact in contacts], axis=1)


@pytest.mark.parametrize("section", accuracy.SECTIONS)
def test_the_accuracy_benchmarks_bars_are_met(section):
    for bar in accuracy.SECTIONS[section](False):
        assert bar.met, bar.row()


@pytest.mark.parametrize("file, name", CASES)
def test_states_and_slip_agree_with_the_reference(file, name):
    record = reference(file)["scenes"][name]
    plan, times = cs.plan(scene_of(record)), record["times"]
    truth = true_values(file, name, "states")
    # rates of the finger reach sigma/radius, those of an ellipsoid more where its metric is small
    scale = np.maximum(1.0, np.abs(truth).max((0, 1)))
    assert (np.abs(plan.states(times) - truth) / scale).max() <= 1e-12
    truth = true_values(file, name, "slip")
    slip, path_speed = np.linalg.norm(truth, axis=-1).max(), plan.scene.profile(times).max()
    # slip under an acceleration is integrated: exact to digits of the path speed, not of itself
    bar = 1e-13 * path_speed if plan.scene.disturbances else 1e-12 * slip
    assert np.abs(plan.slip(times) - truth).max() <= bar


def test_directions_of_geodesics_agree_with_the_reference():
    # The finger is a plane that rolls at unit speed: the geodesic's direction is R_21 w1, the
    # contact point's velocity on the finger in the object's frame.
    contacts = []
    for u, v, a in reference("ellipsoid_geodesics")["start"]:
        w = np.array([np.cos(a), np.sin(a)])
        contacts.append(cs.Contact(cs.Plane(), (u, v), (0.0, 0.0), 0.0, reflection(0.0) @ w, w))
    body = cs.Ellipsoid(0.3, 0.2, 0.1)
    scene = cs.Scene(object=body, contacts=contacts, profile=cs.Profile([1.0]), duration=3.0)
    w1 = np.array([[*contact.finger_velocity, 0.0] for contact in contacts])
    turn = cs.plan(scene, tolerance=1e-14).pose(3.0)[0, :, :3, :3]
    truth = reference("ellipsoid_geodesics")["end_direction"]
    assert np.abs(np.einsum("nij,nj->ni", turn, w1) - truth).max() <= 1e-12
