"""Gain laws, and one of your own

The gain lam(t) determines how fast slip decays. The paper's law is weak where the path speed sigma
is small; `guaranteed` makes up for a growing sigma; a law of your own is one row of a table.
"""

import matplotlib.pyplot as plt
import numpy as np

import contact_system as cs
from contact_system.theory.gain import LAWS, Law

LAWS["speed"] = Law("eta", "lam = eta sigma", power=1)

contact = cs.Contact(cs.Sphere(0.04), object_at=(1.2, 0.3), object_velocity="rest")
scene = cs.Scene(
    object=cs.Torus(0.2, 0.06),
    contacts=[contact],
    profile=cs.Profile([0.02, 0.3]),
    duration=1.0,
)
gains = [cs.Gain.path(100), cs.Gain.time(8), cs.Gain.guaranteed(8), cs.Gain("speed", 40)]
t = np.linspace(0.0, 1.0, 400)
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
for gain in gains:
    plan = cs.plan(scene.replace(gain=gain))
    axes.semilogy(t, plan.slip_speed(t)[:, 0], label=gain.row.formula)
    print(plan.scene.contraction())
axes.set(xlabel="t [s]", ylabel="slip [m/s]", ylim=(1e-5, 0.2), title="Slip under four gain laws")
axes.legend()
figure.savefig("own_gain.png", dpi=100)
