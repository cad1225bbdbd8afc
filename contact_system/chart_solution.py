"""``method="chart"``: the paper's equations, errata corrected, integrated by a scipy solver.

For comparison, and for whoever asks for it: stiff in lam, singular at poles and where sigma = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .checks import naming
from .equations import chart_equations
from .errors import ContactSystemError, SceneError
from .groups import Group, SlipRecord
from .kinematics import contact_map
from .profile import GainPiece
from .scene import Scene, acting
from .starts import Start
from .tracks import Track, in_parts, passed

SOLVERS = ("RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA")


@dataclass(eq=False)
class ChartTrack(Track):
    """One side of one contact from a dense solution; [p q] is chosen along the chart of the object.

    Any frame angles with psi + theta1 + theta2 = psi(0) describe the same motion: theta2 = 0.
    """

    solution: object
    finger: bool
    angle: float

    def _values(self, t: np.ndarray) -> np.ndarray:
        return self.solution(t)  # type: ignore[operator]

    def state(self, t: np.ndarray) -> np.ndarray:
        y = self._values(t)
        theta = self.angle - y[8] if self.finger else 0.0 * t
        return np.stack([*(y[0:2] if self.finger else y[4:6]), theta])[None]

    def drive(self, t: np.ndarray) -> np.ndarray:
        y, state = self._values(t), self.state(t)
        rates = y[2:4] if self.finger else y[6:8]
        root = self.surface.metric_root(state[0, 0], state[0, 1])
        a = np.einsum("tij,jt->it", root, rates)
        c, s = np.cos(state[0, 2]), np.sin(state[0, 2])
        return np.stack([c * a[0] + s * a[1], -s * a[0] + c * a[1]])[None]


def chart_groups(
    scene: Scene, starts: Sequence[Start], begin: float, tolerance: float, solver: str
) -> list[Group]:
    """Integrate every contact by itself.

    Raises
    ------
    SceneError
        sigma = 0 inside the horizon, or imposed rolling.
    """
    zeros = [t for t in scene.profile.zeros(scene.duration) if t >= begin]
    if zeros:
        raise SceneError(
            f"{scene.title}: the chart equations divide by sigma, which is zero at "
            f"t = {zeros[0]:g} s; use the default method, which does not"
        )
    return [_chart_group(scene, i, starts[i], begin, tolerance, solver) for i in range(len(starts))]


def initial_state(scene: Scene, index: int, start: Start, begin: float) -> np.ndarray:
    """u1 v1 u1' v1' u2 v2 u2' v2' psi of a contact at its start: (9,)."""
    sigma, finger = float(scene.profile(begin)), scene.contacts[index].finger
    q1 = np.linalg.solve(finger.metric_root(*start.finger_at), start.finger_velocity)
    q2 = np.linalg.solve(scene.object.metric_root(*start.object_at), start.object_velocity)
    return np.array([*start.finger_at, *(sigma * q1), *start.object_at, *(sigma * q2), start.angle])


def _chart_group(
    scene: Scene, index: int, start: Start, begin: float, tolerance: float, solver: str
) -> Group:
    from scipy.integrate import solve_ivp  # 0.2 s to import, and only this method needs it

    contact, where = scene.contacts[index], f"{scene.title}, contact {index}"
    if contact.follows:
        raise SceneError(f"{where}: imposed rolling has no chart method; use the default method")
    angle = np.array([start.angle])
    at = [np.array([[*q, 0.0]]) for q in (start.finger_at, start.object_at)]
    group = Group(np.array([index]), contact_map(angle), angle, (at[0], at[1]))
    with naming(where):
        kernel = chart_equations(contact.finger, scene.object)
    machine = kernel.machine(1)
    machine.c[0] = [*contact.finger.parameters, *scene.object.parameters]
    y = initial_state(scene, index, start, begin)
    own = [d for d in scene.disturbances if d.contact == index]
    windows = [t for d in own for t in (d.start, d.stop) if t > begin]
    pieces = [p.start for p in scene.gain.pieces(scene.profile, begin, scene.duration)]
    edges = sorted({begin, scene.duration, *windows, *pieces})
    for a, b in zip(edges, edges[1:]):
        machine.x[0, 11:] = acts = acting(scene, a)[index]
        d1, d2, offset = acts.reshape(3, 2)

        def rate(t: float, state: np.ndarray) -> np.ndarray:
            machine.x[0, :9] = state
            sigma = scene.profile(t)
            machine.x[0, 9] = scene.profile.rate(t) / sigma
            machine.x[0, 10] = scene.gain.rate(scene.profile, t)
            machine.run()
            return machine.y[0].copy()  # the solver keeps it

        with np.errstate(under="ignore"):  # of the spacing of doubles at t = 0
            result = solve_ivp(
                rate,
                (a, b),
                y,
                method=solver,
                rtol=max(tolerance, 3e-14),
                atol=tolerance,
                dense_output=True,
            )
        if not result.success or not np.isfinite(result.y).all():
            raise ContactSystemError(
                f"{where}: {solver} on the chart equations stopped at "
                f"t = {result.t[-1]:.6g} s ({result.message}); the path may reach a pole, or "
                "lam is too stiff; use the default method"
            )
        y = result.y[:, -1]
        method = f"chart equations by {solver}, {result.nfev} evaluations"
        for side, surface in ((True, contact.finger), (False, scene.object)):
            track = ChartTrack(
                surface, np.array([surface.parameters]), a, b, method, "asked for", False, False,
                offset=None if side or not offset.any() else offset[None],
                solution=result.sol, finger=side, angle=start.angle,
            )  # fmt: skip
            times = in_parts(result.sol.ts)
            place = track.singular_place(
                times,
                track.state(times)[:, :2],
                lambda t, _: track.state(t)[0, :2].T,  # noqa: B023
            )
            if place is not None:
                raise passed(where, surface, place)
            (group.finger if side else group.object).append(track)
        piece = scene.gain.pieces(scene.profile, a, b)[0]
        pair = (group.finger[-1], group.object[-1])
        group.slips.append(
            SlipRecord(a, b, piece, _slip_of(pair, group.r0, piece), (d1[None], d2[None]))
        )
    return group


def _slip_of(pair: tuple[Track, Track], r0: np.ndarray, piece: GainPiece):
    def slip(tau: np.ndarray) -> np.ndarray:
        t = piece.start + tau
        return (r0 @ pair[0].drive(t) - pair[1].drive(t)) / piece.speed(tau)

    return slip
