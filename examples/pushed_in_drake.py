"""Contact physics in Drake, and a push

In Drake's contact physics, three fingers hold a free sphere by friction and roll on it as planned.
A force of 2 N pushes finger 1 for 50 ms; the measured slip is fed back, and the finger rolls on.
"""

import contact_system as cs
from drake_plant import StationConfig, contact_table, plot, push_table, simulate

scene = cs.load_scene("D4").replace(name="a push in Drake")
push = {"on": "finger 1", "start": 0.15, "stop": 0.2, "force": [-1.82, -0.64, -0.54]}
config = StationConfig.from_scene(scene, contact_model="point", pushes=[push])
result = simulate(scene, config, duration=0.4)
for finger in contact_table(result):
    print(f"{finger.name}: friction up to {finger.friction_peak:.3f} N, kept: {finger.kept}")
for push in push_table(result):
    print(f"pushed {1e3 * push.farthest:.2f} mm off, slipped {1e3 * push.slip:.3f} mm on the way")
plot(result, "pushed_in_drake.png", dpi=60)
