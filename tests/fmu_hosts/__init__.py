"""Hosts of FMUs for tests: fmpy by names, other importers, programs in C; and a demanding scene."""

import contact_system as cs

EVERYTHING = cs.Scene(
    object=cs.Ellipsoid(0.3, 0.2, 0.1),
    contacts=[
        cs.Contact(cs.Sphere(0.04), object_at=(2.0, 0.7), object_velocity="rest"),
        cs.Contact(
            cs.Sphere(0.04), (1.0, 0.3), legs=[cs.Leg(0.3, 0.03, 0.35), cs.Leg(2.0, 0.02, 0.35)]
        ),
    ],
    profile=cs.Profile([0.3, -0.5, 0.6, -0.2]),
    gain=cs.Gain.guaranteed(8.0),
    duration=1.0,
    disturbances=[
        cs.FingerAcceleration(0, 0.1, 0.3, (0.2, -0.1)),
        cs.ObjectAcceleration(0, 0.2, 0.5, (-0.1, 0.1)),
        cs.ObjectRateOffset(0, 0.4, 0.55, (0.1, 0.2)),
    ],
    name="everything",
)
"""An ellipsoid covered twice, legs, overlapping windows, sigma that falls and rises (so that the
guaranteed gain changes its formula) and is negative from after the end of the scene on."""
