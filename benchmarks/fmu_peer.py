"""pythonfmu stepping the same equations: an FMU whose steps are plain Python.

The slave does what a user of pythonfmu would write: the paper's chart equations of all contacts,
one classical Runge-Kutta step a communication step. The equations come from contact_system's
kernel, instruction by instruction, so common terms are computed once.
"""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np

from contact_system.equations import chart_equations
from contact_system.kernels import c_statements
from contact_system.scene import Scene

SCRIPT = """
from math import *

from pythonfmu import Fmi2Causality, Fmi2Slave, Real

STARTS = {starts}
PROFILE = {profile}
ETA = {eta}


def drive(t):
    sigma, slope = 0.0, 0.0
    for c in reversed(PROFILE):
        slope, sigma = sigma + t * slope, c + t * sigma
    return slope / sigma, ETA * sigma * sigma


def rate(x, growth, lam):
    x0, x1, x2, x3, x4, x5, x6, x7, x8 = x
    {statements}
    return {results}


class Peer(Fmi2Slave):
    def __init__(self, **given):
        super().__init__(**given)
        self.x = [list(start) for start in STARTS]
        for i in range(len(STARTS)):
            for k in range(9):
                getter = lambda i=i, k=k: self.x[i][k]
                self.register_variable(
                    Real(f"x{{i}}_{{k}}", causality=Fmi2Causality.output, getter=getter)
                )

    def do_step(self, t, h):
        begin, middle, end = drive(t), drive(t + 0.5 * h), drive(t + h)
        for i, x in enumerate(self.x):
            k1 = rate(x, *begin)
            k2 = rate([a + 0.5 * h * b for a, b in zip(x, k1)], *middle)
            k3 = rate([a + 0.5 * h * b for a, b in zip(x, k2)], *middle)
            k4 = rate([a + h * b for a, b in zip(x, k3)], *end)
            self.x[i] = [
                a + h / 6.0 * (b + 2.0 * c + 2.0 * d + e)
                for a, b, c, d, e in zip(x, k1, k2, k3, k4)
            ]
        return True
"""


def build_peer(scene: Scene, starts: np.ndarray, folder: Path) -> Path:
    """Write the FMU of a scene whose contacts are alike, without disturbances.

    Parameters
    ----------
    scene : Scene
        Gain law `path`.
    starts : (n_contacts, 9)
        u1 v1 u1' v1' u2 v2 u2' v2' psi.
    folder : Path

    Raises
    ------
    ImportError
        pythonfmu is not installed.
    """
    from pythonfmu.builder import FmuBuilder

    finger = scene.contacts[0].finger
    x, growth, lam = ca.SX.sym("x", 9), ca.SX.sym("growth"), ca.SX.sym("lam")
    numbers = ca.DM([*finger.parameters, *scene.object.parameters])
    point = ca.vertcat(x, growth, lam, ca.SX.zeros(6))
    rates = chart_equations(finger, scene.object).function(point, numbers)
    function = ca.Function("rates", [x, growth, lam], [ca.cse(ca.densify(rates))])
    names = [[f"x{k}" for k in range(9)], ["growth"], ["lam"]]
    lines, outputs = c_statements(function, names)
    script = folder / "peer.py"
    script.write_text(SCRIPT.format(
        starts=[[float(v) for v in start] for start in starts],
        profile=[float(c) for c in scene.profile.coefficients], eta=float(scene.gain.value),
        statements="\n    ".join(s.removeprefix("const double ").rstrip(";") for s in lines),
        results=f"({', '.join(outputs[0])})",
    ))  # fmt: skip
    return Path(FmuBuilder.build_FMU(script, dest=folder))
