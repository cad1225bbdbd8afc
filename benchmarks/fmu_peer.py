"""An FMU of the same equations in plain Python, built with pythonfmu.

It does what a user of pythonfmu would write: the paper's chart equations of all contacts, with one
classical Runge-Kutta step in each communication step.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import contact_system as cs

SCRIPT = """
from math import cos, sin

from pythonfmu import Fmi2Causality, Fmi2Slave, Real

STARTS = {starts}
C0, C1, C2 = {profile}
ETA = {eta}
RATIO = {ratio}


def rate(x, t):
    u1, v1, a1, b1, u2, v2, a2, b2, psi = x
    sigma = C0 + t * (C1 + t * C2)
    growth, lam = (C1 + 2.0 * C2 * t) / sigma, ETA * sigma * sigma
    s1, s2, spin1, spin2 = sin(u1), sin(u2), cos(u1) * b1, cos(u2) * b2
    forward, sideways, c, s = RATIO * a1, RATIO * s1 * b1, cos(psi), sin(psi)
    return (
        a1,
        b1,
        growth * a1 + s1 * spin1 * b1,
        growth * b1 - 2.0 * a1 * spin1 / s1,
        a2,
        b2,
        growth * a2 + s2 * spin2 * b2 + lam * (c * forward - s * sideways - a2),
        growth * b2 - 2.0 * a2 * spin2 / s2 - lam * ((s * forward + c * sideways) / s2 + b2),
        spin1 + spin2,
    )


def moved(x, h, k):
    return [a + h * b for a, b in zip(x, k)]


class Peer(Fmi2Slave):
    def __init__(self, **given):
        super().__init__(**given)
        self.x = [list(start) for start in STARTS]
        out = Fmi2Causality.output
        for i in range(len(STARTS)):
            for k in range(9):
                getter = lambda i=i, k=k: self.x[i][k]
                self.register_variable(Real(f"x{{i}}_{{k}}", causality=out, getter=getter))

    def do_step(self, t, h):
        for i, x in enumerate(self.x):
            k1 = rate(x, t)
            k2 = rate(moved(x, 0.5 * h, k1), t + 0.5 * h)
            k3 = rate(moved(x, 0.5 * h, k2), t + 0.5 * h)
            k4 = rate(moved(x, h, k3), t + h)
            slope = [a + 2.0 * b + 2.0 * c + d for a, b, c, d in zip(k1, k2, k3, k4)]
            self.x[i] = moved(x, h / 6.0, slope)
        return True
"""


def build_peer(scene: cs.Scene, starts: np.ndarray, folder: Path) -> Path:
    """Write the FMU of spheres on a sphere, gain law `path`, without disturbances.

    ``starts`` (n_contacts, 9): u1 v1 u1' v1' u2 v2 u2' v2' psi.
    """
    from pythonfmu.builder import FmuBuilder

    script, contact = folder / "peer.py", scene.contacts[0]
    profile = (*map(float, scene.profile.coefficients), 0.0, 0.0)[:3]
    given = {"starts": np.asarray(starts).tolist(), "profile": profile, "eta": scene.gain.value}
    script.write_text(SCRIPT.format(**given, ratio=contact.finger.radius / scene.object.radius))
    return Path(FmuBuilder.build_FMU(script, dest=folder))
