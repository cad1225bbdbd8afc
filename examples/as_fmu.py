"""The planner as an FMU, pushed by its importer

A scene becomes a file for any simulator with FMI 2.0 or 3.0. Here fmpy runs it with an input: an
acceleration of finger 1 that is not part of the scene. Other inputs stay 0, as fmpy warns.
"""

import fmpy
import matplotlib.pyplot as plt
import numpy as np

import contact_system as cs
from fmu_export import export_fmu

scene = cs.load_scene("K1").replace(gain=cs.Gain.time(15.0))
export_fmu(scene, "k1.fmu")
push, slip = "contact[1].finger.acceleration.u", "contact[{}].slip_speed"
signals = np.array([(0.0, 0.0), (0.4, 2.0), (0.5, 0.0)], [("time", float), (push, float)])
result = fmpy.simulate_fmu(
    "k1.fmu",
    fmi_type="CoSimulation",
    stop_time=1.0,
    step_size=1e-3,
    input=signals,
    output=[slip.format(i) for i in (1, 2, 3)],
)
figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for i, width in zip((1, 2, 3), (1.5, 4.0, 1.5)):  # contact 3 slips like contact 2
    axes.semilogy(result["time"], result[slip.format(i)], linewidth=width, label=f"contact {i}")
axes.set(
    xlabel="t [s]", ylabel="slip [m/s]", ylim=(1e-7, 1.0), title="K1 as an FMU, finger 1 pushed"
)
axes.legend()
figure.savefig("as_fmu.png", dpi=100)
