"""Decay of slip on a triaxial ellipsoid

Three fingertips start to move while their contact points on the ellipsoid are at rest. With the
gain law lam = eta, slip decays as sigma(t)/sigma(0) exp(-eta t) on any surface, as dots show.
"""

import contact_system as cs
from contact_system.plots import plot

places = [(0.5, 0.9), (2.1, 1.6), (-2.2, 0.8)]  # Jacobi's coordinates (u, v) on the ellipsoid
scene = cs.Scene(
    name="slip dies out",
    object=cs.Ellipsoid(0.3, 0.2, 0.1),
    contacts=[cs.Contact(cs.Sphere(0.04), at, object_velocity="rest") for at in places],
    profile=cs.Profile([0.1, 0.2, -0.02]),  # sigma(t) = 0.1 + 0.2 t - 0.02 t^2, m/s
    gain=cs.Gain.time(5.0),
    duration=3.0,
)
plan = cs.plan(scene)
plot(plan, "slip_dies.png", dpi=72)
for found in cs.rejections(plan):
    print(f"contact {found.contact}: below 5 % after {found.time:.3f} s")
