"""Plans: contact curves computed once, evaluated at any times, written to files and read back.

A plan computes only the results that are asked for.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import (
    ROUNDING,
    finite_number,
    of_kind,
    one_of,
    shaped_array,
    whole_number,
    within,
)
from .errors import ChartSingularity, ContactSystemError, SceneError
from .files import a_path, opened, writing
from .planning.motion import SHAPES, Motion
from .planning.starts import Starts, measured_start, on_branch, read_starts
from .scene import Scene, acting, require_scene, scene_from_toml, scene_to_toml

METHODS = ("auto", "chart")
SOLVERS = ("RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA")
SAVED = ("tolerance", "method", "solver", "start", "starts")
"""Arguments and attributes of a plan that a file holds, beside its scene."""


def plan(
    scene: Scene,
    tolerance: float = 1e-12,
    method: str = "auto",
    solver: str = "DOP853",
    compiled: bool | None = None,
) -> Plan:
    """Plan the contact curves of a scene.

    Parameters
    ----------
    scene : Scene
    tolerance : float
        Bound on the error of contact points, as a fraction of the body's ``size``, 1e-15 to 1e-1.
        It holds for paths a few sizes long. On longer paths errors grow as neighbouring paths
        diverge: to tens or hundreds of tolerances over hundreds of sizes, or where accelerations
        drive a contact around many times; from 1e-3 rad beside an umbilic to thousands over 100
        sizes; on a rounded cube, whose geodesics are chaotic, until few digits are left after 300
        sizes. Below 1e-12, and many sizes away from the origin, rounding may dominate. With
        ``method="chart"`` it is the solver's tolerance for each step, and no bound.
    method : str
        "auto": the cheapest exact method for each contact and interval (theory sections 4 to 7).
        "chart": the paper's equations (eqs. `timegeodesic`, `contrac`), errata corrected, by a
        solver of scipy, which it needs; for comparison.
    solver : str
        scipy's method for ``method="chart"``: RK23, RK45, DOP853, Radau, BDF or LSODA.
    compiled : bool or None
        Accepted and ignored: there is one engine, which is compiled when the package is installed.

    Raises
    ------
    ContactSystemError
        Naming the scene, the contact, the value and the remedy.
    """
    return Plan(scene, tolerance, method, solver)


class Plan:
    """Contact curves of a scene, evaluated on demand. Made by :func:`plan`.

    Methods take one time or a 1-D array of times in [:attr:`start`, :attr:`end`], s, in any order.
    The first axis of a result is time (of length 1 for a single time), the second the contact. At
    the edge of a disturbance's window, results are those just after it, but at the end of the plan
    those before it. A time outside raises a ContactSystemError. Plans may be made and evaluated by
    several threads at once.

    Attributes
    ----------
    scene : Scene
    tolerance : float
    method, solver : str
    start : float
        When the plan begins, s: 0, or the time of :meth:`restart` or :meth:`continued`.
    end : float
        When it ends, s: ``scene.duration``.
    """

    def __init__(
        self,
        scene: Scene,
        tolerance: float,
        method: str,
        solver: str,
        start: float = 0.0,
        starts: Starts | None = None,
    ):
        one_of(method, METHODS, "method")
        one_of(solver, SOLVERS, "solver")
        require_scene(scene)
        self.scene, self.tolerance, self.method = scene, checked_tolerance(tolerance), method
        self.solver, self.start, self.starts = solver, start, starts
        self.end = scene.duration
        inputs = scene, self.tolerance, start, starts
        self._motion: Any
        if method == "auto":
            self._motion = Motion(*inputs)
        else:
            from .planning.chart_solution import ChartMotion  # scipy, which only this method needs

            self._motion = ChartMotion(*inputs, solver)

    def __repr__(self) -> str:
        count = len(self.scene.contacts)
        contacts = f"{count} contact{'s' * (count > 1)}"
        return f"<Plan of {self.scene.title}, {contacts}, {self.start:g} to {self.end:g} s>"

    def __reduce__(self) -> tuple:
        """Pickle and copy the plan's inputs, as :meth:`save` does; it is planned again."""
        made_from = self.scene, self.tolerance, self.method, self.solver, self.start, self.starts
        return Plan, made_from

    # --- results -------------------------------------------------------------------------------

    def evaluate(self, t: ArrayLike, *names: str) -> dict[str, np.ndarray]:
        """Several results at once, in one pass over the motion.

        Parameters
        ----------
        t : (n,) or a number
            s.
        names : str
            Names of the methods below: "states", "points", "slip", "slip_speed", "twist", "pose",
            "acceleration", "carried".

        Returns
        -------
        dict
            By name, the arrays that these methods return. They share one block of memory, which is
            freed with the last of them: of a large result copy the part that you keep.

        Raises
        ------
        ContactSystemError
            No name or an unknown one, a time outside the horizon, or an error of one of the
            methods.
        """
        if not names:
            raise ContactSystemError(
                f"{self.scene.title}: no result is asked for; name at least one of "
                f"{', '.join(SHAPES)}"
            )
        for name in names:
            one_of(name, SHAPES, f"{self.scene.title}: result", ContactSystemError)
        if "carried" in names:
            self._require_frames()
        times = _one_axis(t)
        results = self._motion.evaluate(times, names)  # None: a time is outside the horizon
        return self._motion.evaluate(self._times(times), names) if results is None else results

    def states(self, t: ArrayLike, gaps: bool = False) -> np.ndarray:
        """u1 v1 u1' v1' u2 v2 u2' v2' psi: (len(t), n_contacts, 9); rad, or m for lengths u, v.

        Coordinates and psi are continuous along the path. Exactly at a pole or an umbilic some of
        them jump by half or a quarter of a turn, and rounding decides in which direction. Rates are
        those of the contact point, object rate offsets included. With ``gaps``, NaN takes the place
        of the error.

        Raises
        ------
        ChartSingularity
            At a time when a contact passes through a pole or an umbilic.
        """
        if not gaps:
            return self.evaluate(t, "states")["states"]
        states = self._motion.evaluate(self._times(t), ("states",), gaps=True)["states"]
        states[~np.isfinite(states).all(axis=-1)] = np.nan
        return states

    def points(self, t: ArrayLike) -> np.ndarray:
        """Contact point on finger and object, each in its body's frame: (len(t), n, 2, 3), m."""
        return self.evaluate(t, "points")["points"]

    def slip(self, t: ArrayLike) -> np.ndarray:
        """Slip v_rel in E2 (eq. `netrelvel`): (len(t), n_contacts, 2), m/s.

        Computed from the exact law, |v_rel| = |V| sigma exp(-L), not as a difference of velocities.
        While an object rate offset d acts, M2 d is subtracted.

        Raises
        ------
        ChartSingularity
            At a time when a slipping contact passes through a pole or an umbilic of the object.
        """
        return self.evaluate(t, "slip")["slip"]

    def slip_speed(self, t: ArrayLike) -> np.ndarray:
        """Magnitude of :meth:`slip`: (len(t), n_contacts), m/s. Defined at poles too."""
        return self.evaluate(t, "slip_speed")["slip_speed"]

    def acceleration(self, t: ArrayLike) -> np.ndarray:
        """Tangential relative acceleration in E2 (eqs. `velacceleration`, `contracaccel`).

        (len(t), n_contacts, 2), m/s^2. (sigma'/sigma - lam) v_rel, plus R_psi M1 d1 - M2 d2 while
        accelerations d act; object rate offsets are left out. Raises as :meth:`slip`.
        """
        return self.evaluate(t, "acceleration")["acceleration"]

    def pose(self, t: ArrayLike) -> np.ndarray:
        """Pose of the finger's body frame in the object's: (len(t), n_contacts, 4, 4).

        Homogeneous matrices, origin in m (theory section 8).
        """
        return self.evaluate(t, "pose")["pose"]

    def twist(self, t: ArrayLike) -> np.ndarray:
        """Twist V_OF_O: (len(t), n_contacts, 6), rad/s then m/s.

        The finger frame's angular velocity and the velocity of its origin, in the object's frame
        (theory section 8).
        """
        return self.evaluate(t, "twist")["twist"]

    def carried(self, t: ArrayLike) -> np.ndarray:
        """Parallel-transported frames of finger and object (theory section 4).

        (len(t), n_contacts, 2, 3): theta, rad, the frame's angle in E_i, continuous; and the path
        velocity in that frame, W_1 or W - V exp(-L), dimensionless, without object rate offsets.
        Unlike u' and v' it exists where sigma = 0; W_1 and V are constant while nothing acts.

        Raises
        ------
        ChartSingularity
            At a time when a contact passes through a pole or an umbilic.
        SceneError
            ``method="chart"``, which has no such frames.
        """
        return self.evaluate(t, "carried")["carried"]

    # --- explaining, continuing, saving --------------------------------------------------------

    def explain(self) -> str:
        """A text on how each contact and interval was computed, why, and what was skipped.

        A panel is one step of Gauss collocation. A note follows for each contact whose bodies
        overlap beside the contact point.
        """
        from .measures import overlaps  # which imports this module

        head = f"{self.scene.title}: tolerance {self.tolerance:g}, method {self.method}"
        return "\n".join([head, *self._motion.lines(), *overlaps(self)])

    def continued(self, t: float, scene: Scene | None = None) -> Plan:
        """The plan from time t on, under other disturbances, gain, profile or duration.

        It starts from the exact state of the moving frames: with an unchanged scene it reproduces
        this plan, even from a pole or where sigma = 0, but beyond a pole it may have other whole
        turns in its states.

        Parameters
        ----------
        t : float
            s, inside this plan's horizon and before the end of the new scene.
        scene : Scene, optional
            The scene from t on, with the same surfaces and contacts; legs that begin after t may
            differ. Default: this plan's scene.

        Raises
        ------
        SceneError
            Other surfaces or contacts, no time left to plan, contacts with imposed rolling (in
            either scene), or ``method="chart"``.
        """
        after = self.scene if scene is None else scene
        require_scene(after)
        t = self._continuation_time(t, after, "continued")
        where = f"{after.title}, continued at t = {t:g} s"
        if after.surfaces != self.scene.surfaces:
            raise SceneError(
                f"{where}: the scene has other surfaces or contacts than the plan; give a scene "
                "with the same ones"
            )
        for i, (old, new) in enumerate(zip(self.scene.contacts, after.contacts)):
            begun = [
                [(leg.start, leg.turn) for leg in s.way(i) if leg.start <= t]
                for s in (self.scene, after)
            ]
            if old.start() != new.start() or begun[0] != begun[1]:
                raise SceneError(
                    f"{where}: {after.contact_title(i)} starts or turns in another way than in the "
                    "plan; give the same contact, of which only legs that begin after t may "
                    "differ, or continue from an earlier t"
                )
        return Plan(after, self.tolerance, self.method, self.solver, t, self.moments(t))

    def _continuation_time(self, t: Any, scene: Scene, how: str) -> float:
        """t, checked: a plan of the scene can replace this one from t on; ``how`` is for errors."""
        t = self._time(t)
        where = f"{scene.title}, {how} at t = {t:g} s"
        if not t < scene.duration:
            raise SceneError(
                f"{where}: nothing is left to plan, the scene ends at {scene.duration:g} s; give "
                "an earlier t or lengthen the scene"
            )
        for s in (self.scene, scene):
            for i, contact in enumerate(s.contacts):
                if contact.follows:
                    raise SceneError(
                        f"{where}: {s.title}, {s.contact_title(i)}: imposed rolling cannot go on "
                        "from there; give finger_velocity as numbers"
                    )
        return t

    def moments(self, t: float) -> Starts:
        """The state of every contact's moving frames at time t, as :meth:`continued` uses it.

        Raises
        ------
        ContactSystemError
            A time outside the horizon, or ``method="chart"``.
        """
        t = self._time(t)
        self._require_frames()
        return self._motion.moments(t)

    def _require_frames(self) -> None:
        if self.method == "chart":
            raise SceneError(
                f"{self.scene.title}: method 'chart' has no parallel frames; use the default method"
            )

    def restart(self, t: float, state: ArrayLike) -> Plan:
        """Plan again from measured states at time t.

        Parameters
        ----------
        t : float
            s, with sigma(t) > 0, except at contacts that rest to the end. The path velocity is
            rates / sigma, so close to rest rounding of the rates may turn the path;
            :meth:`continued` needs no rates and is exact there.
        state : (n_contacts, 9) or (1, n_contacts, 9)
            Measured u1 v1 u1' v1' u2 v2 u2' v2' psi, as ``states(t)`` gives them or in principal
            values. Where a chart covers its surface twice, they are moved to the plan's branch.

        Raises
        ------
        SceneError
            A wrong shape, NaN, a contact at a pole or an umbilic, sigma(t) = 0, no time left to
            plan, or contacts with imposed rolling.
        """
        t = self._continuation_time(t, self.scene, "restart")
        what, shape = f"{self.scene.title}, restart: state", (len(self.scene.contacts), 9)
        measured = shaped_array(state, what, remedy=f"numbers, shape {shape}")
        measured = measured[0] if measured.ndim == 3 and len(measured) == 1 else measured
        shaped_array(measured, what, shape)
        if any(surface.chart.double_cover for surface in self.scene.surfaces):
            with contextlib.suppress(ChartSingularity):  # at an umbilic the plan has no branch
                measured = on_branch(self.scene, measured, self.states(t)[0])
        offsets = acting(self.scene, t)[:, 4:]
        starts = [
            measured_start(self.scene, i, t, *row) for i, row in enumerate(zip(measured, offsets))
        ]
        return Plan(self.scene, self.tolerance, self.method, self.solver, t, starts)

    def save(self, path: str | os.PathLike[str], times: ArrayLike | None = None) -> None:
        """Write the plan and its sampled results.

        ``.npz``: the scene (as TOML text), what :func:`load` needs, and t, states, slip, twist,
        pose, points. ``.csv``: t, contact, the nine states, slip, slip magnitude.

        Parameters
        ----------
        path : path ending in .npz or .csv
        times : (n,), optional
            Default: :meth:`sample_times` that are :meth:`regular_times`.

        Raises
        ------
        ContactSystemError
            An unknown ending, or a file that cannot be written.
        ChartSingularity
            At one of ``times``, as :meth:`states`.
        """
        path = a_path(path, endings=(".npz", ".csv"))
        t = self.regular_times(self.sample_times()) if times is None else self._times(times)
        with writing(path, f"{self.scene.title}: ") as file:
            if path.suffix == ".csv":
                file.write(self._csv(t).encode())
                return
            inputs = {key: getattr(self, key) for key in SAVED}
            inputs["starts"] = [start._asdict() for start in self.starts or ()] or None
            held: dict[str, Any] = {"scene": scene_to_toml(self.scene), "plan": json.dumps(inputs)}
            held["t"] = t
            held |= self.evaluate(t, "states", "slip", "twist", "pose", "points")
            np.savez_compressed(file, **held)

    def sample_times(self, count: int = 401) -> np.ndarray:
        """Equally spaced times over the plan, and the scene's edges: (n,), ascending, s.

        An equally spaced time that differs from an edge by rounding alone is left out.

        Parameters
        ----------
        count : int
            Number of equally spaced times, at least 1.
        """
        count = whole_number(count, "count")
        grid, spacing = np.linspace(self.start, self.end, count, retstep=True)
        edges = np.array([e for e in self.scene.edges if e >= self.start])
        hair = 1e-9 * spacing
        first, last = np.searchsorted(edges, [grid - hair, grid + hair])
        return np.union1d(grid[first == last], edges)

    def regular_times(self, t: ArrayLike) -> np.ndarray:
        """The times, s, without those at which :meth:`states` raises a ChartSingularity: (m,)."""
        times = self._times(t)
        return times[np.isfinite(self.states(times, gaps=True)).all(axis=(1, 2))]

    def _csv(self, t: np.ndarray) -> str:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        names = ["t [s]", "contact", *"u1 v1 du1 dv1 u2 v2 du2 dv2".split(), "psi [rad]"]
        writer.writerow([*names, "slip x [m/s]", "slip y [m/s]", "slip [m/s]"])
        states, slip = self.evaluate(t, "states", "slip").values()
        table = np.concatenate([states, slip, np.hypot(*slip.T).T[..., None]], axis=2)
        for time, rows in zip(t.tolist(), table.tolist()):
            writer.writerows([time, i, *row] for i, row in enumerate(rows))
        return text.getvalue()

    # --- inside ----------------------------------------------------------------------------------

    def _time(self, t: Any) -> float:
        """One time inside the horizon."""
        times = self._times(t)
        if np.ndim(t):
            raise SceneError(f"{self.scene.title}: t = {t!r}; give a time in seconds")
        return float(times[0])

    def _times(self, t: ArrayLike) -> np.ndarray:
        """The times, checked to be in the horizon; those outside by rounding become its ends."""
        times, first, last = _one_axis(t), self.start, self.end
        inside = np.clip(times, first, last)
        outside = ~(np.abs(times - inside) <= ROUNDING * last)
        if not outside.any():
            return inside
        bad, alternative = float(times[outside][0]), ""
        if bad > last:
            alternative = ", or lengthen the scene's duration"
        elif 0 <= bad < first:
            alternative = ", or the plan that this one goes on from"
        raise ContactSystemError(
            f"{self.scene.title}: t = {bad!r} s is outside the plan's horizon "
            f"[{first:g}, {last:g}] s; ask inside it{alternative}"
        )


def checked_tolerance(value: Any) -> float:
    """The tolerance as a float; raises a SceneError if it is no number from 1e-15 to 1e-1."""
    number = value if type(value) is float else finite_number(value, "tolerance")
    if not 1e-15 <= number <= 0.1:
        raise SceneError(f"tolerance = {value!r}: give a number from 1e-15 to 1e-1")
    return number


def _one_axis(t: ArrayLike) -> np.ndarray:
    remedy = "a time in seconds, or one axis of times"
    times = shaped_array(t, "t", error=ContactSystemError, remedy=remedy)
    if times.ndim > 1:
        raise ContactSystemError(f"times have shape {times.shape}; give one axis of times")
    return np.atleast_1d(times)


def require_plan(value: Any) -> None:
    """Raise a ContactSystemError if the value is no Plan, such as a scene."""
    of_kind(Plan, value, "plan", "a Plan, such as plan(scene)", ContactSystemError)


def load(path: str | os.PathLike[str]) -> Plan:
    """Read a plan saved as .npz and plan it again from the scene inside.

    Its results are the same to the last bit. With ``method="chart"`` planning may take seconds;
    ``numpy.load`` reads the sampled results without it.

    Raises
    ------
    ContactSystemError
        The file cannot be read, is not such a plan, is damaged, or exceeds a limit of
        `contact_system.limits`.
    """
    path = a_path(path)
    if path.suffix == ".toml":
        raise ContactSystemError(f"{path} is a scene file: give it to load_scene, or a plan's .npz")
    with opened(path, "a plan written by Plan.save") as archive:
        text, inputs = _text(archive, "scene"), json.loads(_text(archive, "plan"))
        scene = scene_from_toml(text, str(path))
        inputs["starts"] = read_starts(scene, inputs["start"], inputs["starts"])
        return Plan(scene, **inputs)


def _text(archive: Any, name: str) -> str:
    """A text of a saved plan."""
    size = archive.getinfo(f"{name}.npy").file_size
    within("PLAN_BYTES", size, f"{name}.npy: bytes when unpacked", ContactSystemError)
    return str(np.load(io.BytesIO(archive.read(f"{name}.npy"))))
