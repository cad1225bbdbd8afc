"""Formulas for tests, references and benchmarks: closed forms by mpmath, geodesics, slip of states.

SI units and radians; mpmath works to its own precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mpmath as mp
import numpy as np

if TYPE_CHECKING:
    import contact_system as cs


def arc_length(coefficients: Sequence[float], t: Any) -> Any:
    """The integral of sigma from 0 to t."""
    powers = enumerate(coefficients)
    return mp.fsum(mp.mpf(c) * mp.mpf(t) ** (k + 1) / (k + 1) for k, c in powers)


def great_circle(radius: Any, at: Any, w: Any, s: Any) -> list[Any]:
    """Point of a sphere at s of the great circle that starts at coordinates ``at`` with x'(s) = w,
    components in the contact frame."""
    (u, v), r, w = map(mp.mpf, at), mp.mpf(radius), [mp.mpf(x) for x in w]
    normal = [mp.sin(u) * mp.cos(v), mp.sin(u) * mp.sin(v), mp.cos(u)]
    x_axis = [mp.cos(u) * mp.cos(v), mp.cos(u) * mp.sin(v), -mp.sin(u)]
    y_axis = [-mp.sin(v), mp.cos(v), mp.mpf(0)]
    pace = mp.norm(w)
    phase = pace * mp.mpf(s) / r
    along = [(w[0] * a + w[1] * b) / pace for a, b in zip(x_axis, y_axis)]
    return [r * (mp.cos(phase) * n + mp.sin(phase) * e) for n, e in zip(normal, along)]


def helix(radius: Any, at: Any, w: Any, s: Any) -> list[Any]:
    """The same of a helix on the cylinder (r cos u, r sin u, v)."""
    r = mp.mpf(radius)
    u = mp.mpf(at[0]) + mp.mpf(w[0]) * mp.mpf(s) / r
    return [r * mp.cos(u), r * mp.sin(u), mp.mpf(at[1]) + mp.mpf(w[1]) * mp.mpf(s)]


def geodesic_rates(surface: str, radii: Sequence[Any], m: Any, state: Sequence[Any]) -> list[Any]:
    """(x, x')' = (x', -(x'^T Hess F x')/|grad F|^2 grad F), over a module m with sqrt."""
    x, p = state[:3], state[3:]
    if surface == "torus":  # F = (rho - R)^2 + z^2 - r^2 over 2
        square = x[0] * x[0] + x[1] * x[1]
        pull, along = radii[0] / m.sqrt(square), x[0] * p[0] + x[1] * p[1]
        slope = [(1.0 - pull) * x[0], (1.0 - pull) * x[1], x[2]]
        bend = (1.0 - pull) * (p[0] * p[0] + p[1] * p[1]) + p[2] * p[2]
        bend = bend + pull * along * along / square
    else:
        weights = {"sphere": [1.0, 1.0, 1.0], "cylinder": [1.0, 1.0, 0.0]}.get(surface)
        weights = weights or [1.0 / (r * r) for r in radii]
        slope = [a * c for a, c in zip(weights, x)]
        bend = sum(a * c * c for a, c in zip(weights, p))
    factor = -bend / sum(g * g for g in slope)
    return [*p, *(factor * g for g in slope)]


def reflection(psi: np.ndarray) -> np.ndarray:
    """R_psi as printed in eq. `rotation`: (...) -> (..., 2, 2)."""
    c, s = np.cos(psi), np.sin(psi)
    return np.moveaxis(np.array([[c, -s], [-s, -c]]), (0, 1), (-2, -1))


def path_velocities(scene: cs.Scene, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M1 q1' in E1 and M2 q2' in E2 of (n, contacts, 9) states: two (n, contacts, 2), m/s."""
    out = np.empty((2, *states.shape[:2], 2))
    for i, contact in enumerate(scene.contacts):
        for k, surface in enumerate((contact.finger, scene.object)):
            u, v, *rates = states[:, i, 4 * k : 4 * k + 4].T
            out[k, :, i] = np.einsum("nij,jn->ni", surface.metric_root(u, v), rates)
    return out[0], out[1]


def slip_of_states(scene: cs.Scene, states: np.ndarray) -> np.ndarray:
    """v_rel = R_psi M1 q1' - M2 q2' (eq. `netrelvel`) of (n, contacts, 9) states, m/s."""
    a1, a2 = path_velocities(scene, states)
    return np.einsum("...ij,...j->...i", reflection(states[..., 8]), a1) - a2
