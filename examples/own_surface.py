"""A surface of your own, by its equation

Any surface F(x, y, z) = 0 that is visible as a whole from its centre can be an object or a finger.
Fingertips roll all over it, as there are no poles.
"""

import numpy as np

import contact_system as cs
from contact_system.plots import plot


def bumpy_ball(x, r, h):
    """Negative inside a ball of radius r with waves of height h; x is a column of coordinates."""
    waves = np.cos(4 * x[0] / r) + np.cos(4 * x[1] / r) + np.cos(4 * x[2] / r)
    return np.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2) - r - h * waves


scene = cs.Scene(
    name="a ball with bumps",
    object=cs.ImplicitSurface(bumpy_ball, parameters={"r": 0.1, "h": 0.004}, size=0.1),
    contacts=[
        cs.Contact(cs.Sphere(0.01), object_at=(1.0, 0.4), object_velocity="rest"),
        cs.Contact(cs.Sphere(0.01), object_at=(2.0, 2.5), object_velocity="rest"),
    ],
    profile=cs.Profile([0.2]),
    gain=cs.Gain.time(4.0),
    duration=3.0,
)
plot(cs.plan(scene), "own_surface.png", dpi=72)
