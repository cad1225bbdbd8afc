"""A route to a goal on both bodies

Without spin and without sliding, three or four rolls take a finger from anywhere to anywhere: to a
given point of the object, with a given point of the finger and a given angle.
"""

import contact_system as cs
from contact_system.plots import plot_curves

contact = cs.Contact(cs.Sphere(0.04), object_at=(1.0, 0.2), angle=0.3)
scene = cs.Scene(
    name="a route",
    object=cs.Ellipsoid(0.3, 0.2, 0.1),
    contacts=[contact],
    profile=cs.Profile([0.1]),
    duration=3.0,
)
goal = cs.Goal(object_at=(2.0, 1.0), finger_at=(1.0, 0.5), angle=1.0)
route = cs.reach(scene, goal, legs=4)  # seconds=2 would search 2 s for a shorter one
for leg in route.legs[0]:
    print(f"turn to {leg.direction:+.3f} rad, roll {leg.length:.4f} m")
print(f"{route.length:.3f} m in all, off the goal by {route.residual:.0e} of the size")
plot_curves(cs.plan(route.scene), "route.png", dpi=72)
