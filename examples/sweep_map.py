"""A map of four thousand scenes

`cs.sweep` plans many scenes, here on a pool of threads. Each point of the map is a scene with its
own gain and length of a disturbance; the colour is the slip 0.1 s after the disturbance.
"""

from concurrent.futures import ThreadPoolExecutor

import matplotlib.pyplot as plt
import numpy as np

import contact_system as cs

gains = np.geomspace(1.0, 100.0, 64)
lengths = np.linspace(0.01, 0.5, 64)
contact = cs.Contact(cs.Sphere(0.04), object_at=(1.0, 0.5))
scene = cs.Scene(object=cs.Sphere(0.1), contacts=[contact], profile=cs.Profile([0.2]), duration=1.0)


def scenes():
    """One scene for each point of the map, made when the sweep needs it."""
    for eta in gains:
        for length in lengths:
            push = cs.FingerAcceleration(0, 0.0, length, (0.0, 3.0))
            yield scene.replace(gain=cs.Gain.time(eta), disturbances=[push])


def slip_left(plan):
    """Slip 0.1 s after each contact's push, m/s."""
    stops = {push.contact: push.stop for push in plan.scene.disturbances}
    stops = np.array([stops[i] for i in range(len(plan.scene.contacts))])
    here = np.arange(len(stops))
    return {"left": plan.slip_speed(stops + 0.1)[here, here]}


with ThreadPoolExecutor(2) as pool:
    table = cs.sweep(scenes(), slip_left, pool).table
left = table["left"].reshape(len(gains), len(lengths))
figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
filled = axes.pcolormesh(lengths, gains, 1e3 * left, shading="gouraud", cmap="viridis")
axes.set(xlabel="length of the push [s]", ylabel="eta [1/s]", yscale="log")
figure.colorbar(filled, label="slip 0.1 s after the push [mm/s]")
figure.savefig("sweep_map.png", dpi=90)
