"""Turning in place by rolling

A closed path brings the finger back to the same points of both bodies, but turned. The angle is
minus the Gaussian curvature that its curves enclose; here it is 40 degrees, without any spin.
"""

from math import degrees, radians

import contact_system as cs
from contact_system.plots import plot_curves

contact = cs.Contact(cs.Sphere(0.06), object_at=(1.0, 1.5))
scene = cs.Scene(
    name="turned by 40 degrees",
    object=cs.Ellipsoid(0.3, 0.2, 0.1),
    contacts=[contact],
    profile=cs.Profile([0.1]),
    duration=4.0,
)
turned = cs.loop(scene, angle=radians(40))
plan = cs.plan(turned.scene)
begin, end = plan.states([0.0, plan.end])[:, 0]
print(f"psi from {degrees(begin[8]):.3f} to {degrees(end[8]):.3f} degrees")
finger, object_ = map(degrees, turned.enclosed)
print(f"curvature enclosed: {finger:.3f} on the finger, {object_:.3f} on the object, degrees")
print(f"Gauss and Bonnet hold to {turned.gauss_bonnet:.0e} rad")
plot_curves(plan, "holonomy.png", dpi=72)
