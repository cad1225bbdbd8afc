"""An FMU beside another model

K2 is disturbed by a wind, an FMU made by pythonfmu, which stops when the finger slips. The two FMUs
run in one system (SSP) and, dashed, in a container of fmu-manipulation-toolbox. In the SSP, fmpy
passes on the outputs of the previous step. Needs pythonfmu and fmu-manipulation-toolbox.
"""

import os
from pathlib import Path

import fmpy
import matplotlib.pyplot as plt
from fmpy.ssp.simulation import simulate_ssp
from fmu_manipulation_toolbox.assembly import AssemblyNode
from pythonfmu.builder import FmuBuilder

import contact_system as cs
from fmu_export import export_fmu, export_ssp

WIND = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

class Wind(Fmi2Slave):
    def __init__(self, **given):
        super().__init__(**given)
        self.push, self.slip = 0.0, 0.0
        self.register_variable(Real("push", causality=Fmi2Causality.output))
        self.register_variable(Real("slip", causality=Fmi2Causality.input))

    def do_step(self, t, h):
        self.push = 4.0 if 0.1 <= t < 0.6 and self.slip < 0.01 else 0.0
        return True
"""
Path("wind_model.py").write_text(WIND)
FmuBuilder.build_FMU("wind_model.py", dest=".")  # Wind.fmu
scene = cs.load_scene("K2").replace(disturbances=(), gain=cs.Gain.time(15.0))
push, slip = "contact[1].finger.acceleration.u", "contact[1].slip_speed"
wires = [("wind.push", f"planner.{push}"), (f"planner.{slip}", "wind.slip")]
wires.append((f"planner.{slip}", "slip"))
export_ssp({"planner": scene, "wind": "Wind.fmu"}, "windy.ssp", wires)
coupled = simulate_ssp("windy.ssp", stop_time=1.0, step_size=1e-3)

export_fmu(scene, "planner.fmu")
windy = AssemblyNode("windy.fmu", step_size=1e-3, auto_input=False, auto_output=False)
windy.add_link("Wind.fmu", "push", "planner.fmu", push)
windy.add_link("planner.fmu", slip, "Wind.fmu", "slip")
windy.add_output("planner.fmu", slip, "slip")
windy.make_fmu(Path("."))
contained = fmpy.simulate_fmu("windy.fmu", stop_time=1.0, output_interval=1e-3)
off = coupled["slip"][:-1] - contained["slip"][1:-1]  # rows of the SSP are ends of steps
print(abs(off).max(), "m/s apart", flush=True)

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
axes.plot(coupled["time"], 1e3 * coupled["slip"], label="system (SSP)")
axes.plot(contained["time"], 1e3 * contained["slip"], "--", label="container")
axes.set(xlabel="t [s]", ylabel="slip of finger 1 [mm/s]", title="K2 in a wind")
axes.legend()
figure.savefig("wind.png", dpi=100)
os._exit(0)  # at an ordinary exit pythonfmu's library uses memory that it has freed
