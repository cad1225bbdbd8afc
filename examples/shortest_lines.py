"""Shortest lines between two points

`cs.geodesic` finds the shortest geodesic between two points of any surface, for many pairs in one
call. `cs.geodesics` finds several, such as those around the hole of a torus.
"""

import matplotlib.pyplot as plt
import numpy as np

import contact_system as cs

figure = plt.figure(figsize=(10, 4.2))
figure.subplots_adjust(left=0, bottom=0, right=1, top=0.93, wspace=0)


def show(number, surface, extent, lines, title):
    """Draw lines over the coordinate lines of the surface."""
    axes = figure.add_subplot(1, 2, number, projection="3d", computed_zorder=False)
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 61), np.linspace(0, 2 * np.pi, 61))
    axes.plot_wireframe(*surface.point(u, v).T, rstride=3, cstride=3, color="0.85", linewidth=0.6)
    for line in lines:
        axes.plot(*line.T)
    axes.set_title(title)
    axes.set_box_aspect(extent, zoom=1.55)
    axes.set_axis_off()
    axes.view_init(35, -35)


ellipsoid = cs.Ellipsoid(0.3, 0.2, 0.1)
ends = np.column_stack([np.full(15, 2.6), np.linspace(-1.4, 1.4, 15)])
fan = cs.geodesic(ellipsoid, (1.0, 0.2), ends)  # 15 pairs at once
lines = [fan.points(np.linspace(0.0, fan.length[k], 80))[:, k] for k in range(15)]
show(1, ellipsoid, (3, 2, 1), lines, "15 shortest lines on an ellipsoid")

torus = cs.Torus(0.3, 0.1)
ways = cs.geodesics(torus, (0.0, 0.0), (3.0, 0.5), most=5)
lines = [way.points(np.linspace(0.0, way.length, 300)) for way in ways]
show(2, torus, (4, 4, 1), lines, "the five shortest ways between two points of a torus")
print("lengths on the torus:", ", ".join(f"{way.length:.3f} m" for way in ways))
figure.savefig("shortest_lines.png", dpi=80)
