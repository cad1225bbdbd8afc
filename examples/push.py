"""Slip after a push

A fingertip rolls on a torus. From 0.5 to 0.8 s it is accelerated across its path, and the contact
slips; after the push, slip decays at the rate of the gain. A second push follows at 2 s;
`continued` plans the motion from 1.5 s on without it.
"""

import contact_system as cs
from contact_system.plots import plot

pushes = [
    cs.FingerAcceleration(0, start=0.5, stop=0.8, value=(-8.0, 4.0)),
    cs.ObjectAcceleration(0, start=2.0, stop=2.1, value=(1.0, -6.0)),
]
scene = cs.Scene(
    name="two pushes on a ring",
    object=cs.Torus(0.15, 0.05),
    contacts=[cs.Contact(cs.Sphere(0.03), object_at=(0.3, 1.0), object_velocity="rolling")],
    profile=cs.Profile([0.25]),
    gain=cs.Gain.time(8.0),
    disturbances=pushes,
    duration=3.0,
)
plan = cs.plan(scene)
plot(plan, "push.png", dpi=76)
calm = plan.continued(1.5, scene.replace(disturbances=pushes[:1]))
for name, each in (("pushed twice", plan), ("pushed once", calm)):
    print(f"{name}: at 3 s on the object at {each.points(3.0)[0, 0, 1].round(4)} m")
