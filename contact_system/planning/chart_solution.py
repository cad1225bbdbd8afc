"""``method="chart"``: the paper's equations, errata corrected, integrated by a scipy solver.

For comparison: they are stiff in lam, and singular at poles and where sigma = 0.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..checks import within
from ..errors import ContactSystemError, SceneError
from ..scene import Scene, Start
from ..system import SceneSystem, SystemMachine, without_chart
from .explanation import singular_path
from .motion import SHAPES

try:
    from scipy.integrate import OdeSolution, solve_ivp
except ImportError as error:
    raise ContactSystemError(f'method "chart" needs scipy: pip install scipy ({error})') from None

PARTS, ROUNDS = 16, 10  # parts of a solver's step; rounds in which parts are divided again
LEAST_COSINE = 0.7  # of the angle by which a frame turns in a part that is not divided
OUTPUTS = {
    "states": "state",
    "points": "contact_point",
    "slip_speed": "slip",
    "acceleration": "slip_acceleration",
}
"""The outputs of `SceneSystem` from which results of other names follow."""


class ChartMotion:
    """All contacts by the chart equations; with the methods of :class:`.planning.motion.Motion`.

    Raises a ContactSystemError for sigma = 0 inside the horizon, imposed rolling, a surface without
    a chart, a path into a singular point, or a solver that fails.
    """

    def __init__(
        self,
        scene: Scene,
        tolerance: float,
        begin: float,
        starts: Sequence[Any] | None,  # each a Start, as these plans are not continued
        solver: str,
    ):
        if reason := without_chart(scene):
            raise SceneError(f"{scene.title}{reason}; use the default method")
        self._begin, self._end = begin, scene.duration
        evaluations = itertools.count(1)  # of all contacts
        self._contacts = [
            ChartContact(scene, tolerance, begin, solver, i, start, evaluations)
            for i, start in enumerate(starts or [contact.start() for contact in scene.contacts])
        ]

    def evaluate(
        self, t: np.ndarray, names: Sequence[str], gaps: bool = False
    ) -> dict[str, np.ndarray] | None:
        """Results, (n_times, n_contacts, ...); None if a time is outside the plan.

        ``gaps`` does nothing: paths through singular points are refused.
        """
        if not ((t >= self._begin) & (t <= self._end)).all():
            return None
        return {name: np.stack([c.result(name, t) for c in self._contacts], 1) for name in names}

    def lines(self) -> list[str]:
        """How each contact was integrated."""
        return [line for contact in self._contacts for line in contact.lines]


class ChartContact:
    """One contact of a scene, integrated by itself."""

    def __init__(
        self,
        scene: Scene,
        tolerance: float,
        begin: float,
        solver: str,
        index: int,
        start: Start,
        evaluations: Iterator[int],
    ):
        contact, title = scene.contacts[index], scene.contact_title(index)
        self._where = f"{scene.title}, {title}"
        if contact.follows:
            raise SceneError(
                f'{self._where}: method "chart" cannot impose rolling; use the default method'
            )
        disturbances = [replace(d, contact=0) for d in scene.disturbances if d.contact == index]
        alone = scene.replace(contacts=[contact], disturbances=disturbances)
        self._system = SceneSystem(alone, "chart", disturbance_input=True)
        cancels_growth, ends = scene.gain.row.cancels_growth, (begin, scene.duration)
        knots = scene.profile.knots(*ends) if cancels_growth else ends  # where the gain has a kink
        windows = [t for t in self._system.edges if t > begin]
        self._edges = np.array(sorted({*windows, *knots}))
        self._acting = np.array([self._system.window_values(t) for t in self._edges[:-1]])
        self.lines = [f"{title}:"]
        self._solution = self._integrated(start, tolerance, solver, evaluations)
        self._require_regular()

    def _integrated(
        self, start: Start, tolerance: float, solver: str, evaluations: Iterator[int]
    ) -> OdeSolution:
        """Integrate from edge to edge, with the disturbances that act there."""
        what = f"{self._where}: {solver}: evaluations of the plan's chart equations"
        remedy = "give a greater tolerance, use the default method"
        machine = SystemMachine(self._system, "derivatives")
        state = self._system.place(float(self._edges[0]), [start])[0]
        time, place, pushes = np.split(machine.point, [1, 1 + len(state)])
        times, steps = [self._edges[0]], []
        tolerances = {"rtol": max(tolerance, 3e-14), "atol": tolerance}
        for a, b, acting in zip(self._edges, self._edges[1:], self._acting):
            pushes[:] = acting

            def f(t: float, x: np.ndarray) -> np.ndarray:
                within("EVALUATIONS", next(evaluations), what, remedy=remedy)
                time[0], place[:] = t, x
                machine.run()
                return machine.results.copy()

            with np.errstate(under="ignore"):  # the spacing of doubles at t = 0 underflows
                result = solve_ivp(f, (a, b), state, solver, dense_output=True, **tolerances)
            if not result.success or not np.isfinite(result.y).all():
                raise ContactSystemError(
                    f"{self._where}: {solver} on the chart equations stopped at "
                    f"t = {result.t[-1]:.6g} s ({result.message}); the path may reach a pole, or "
                    "lam is too stiff; use the default method"
                )
            state = result.y[:, -1]
            times += result.sol.ts[1:].tolist()
            steps += result.sol.interpolants
            way = f"chart equations by {solver}, {result.nfev} evaluations"
            self.lines.append(f"  both   [{a:.6g}, {b:.6g}] s  {way}  (asked for)")
        return OdeSolution(times, steps)

    def _require_regular(self) -> None:
        """Refuse a path through a singular point of a chart, where the contact frame turns over.

        A solver does not notice a pole that a path crosses along a meridian: the equations are
        smooth there. Steps in which the frame turns far are divided: across a pole it still does.
        """
        scene, ends = self._system.scene, self._solution.ts
        for side, surface in enumerate((scene.contacts[0].finger, scene.object)):
            low, high = ends[:-1], ends[1:]
            for _ in range(ROUNDS):
                if not len(low):
                    break
                t = np.linspace(low, high, PARTS + 1)
                place = self._solution(t.ravel())[4 * side : 4 * side + 2]
                frame = surface.frame(*place).reshape(*t.shape, 3, 3)
                cosine = np.einsum("...ij,...ij->...j", frame[1:], frame[:-1]).min(axis=-1)
                k, interval = np.nonzero(~(cosine > LEAST_COSINE))  # NaN at the point itself
                low, high = t[k, interval], t[k + 1, interval]
            if len(low):
                u, v = self._solution(low[0])[4 * side : 4 * side + 2].tolist()
                raise singular_path(self._where, surface, (u, v))

    def result(self, name: str, t: np.ndarray) -> np.ndarray:
        """A result of a plan for this contact: (n_times, ...)."""
        if not len(t):
            return np.empty((0, *SHAPES[name]))
        system, interval = self._system, np.searchsorted(self._edges[1:-1], t, side="right")
        arguments = t[None], self._solution(t), self._acting[interval].T, system.held0
        function = system.function(OUTPUTS.get(name, name))
        values = function(*arguments, system.parameters).full().T
        if name == "slip_speed":
            return np.hypot(*values.T)
        if name == "pose":
            pose = np.tile(np.eye(4), (len(t), 1, 1))
            pose[:, :3, :] = values.reshape(-1, 4, 3).swapaxes(1, 2)
            return pose
        return values.reshape(-1, *SHAPES[name])
