"""The result of planning: ask for states, slip, twist, pose, points at any times.

A plan is like a geodesic line object: computed once, evaluated where asked, and nothing is
evaluated that was not asked for.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import numbers
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import kinds
from .chart_solution import SOLVERS, chart_groups
from .checks import FLOAT, a_path, flag, real_array, writing
from .errors import ChartSingularity, ContactSystemError, SceneError
from .groups import SIDES, Group, moments
from .kept import kept
from .kinds import Begun
from .kinematics import relative_pose, relative_twist
from .panels import runs
from .planner import group_name, plan_groups, require_regular
from .program import Program, chart_states, group_program, program_of
from .scene import Scene, acting, require_scene
from .scene_files import scene_from_toml, scene_to_toml
from .starts import (
    Start,
    Starts,
    covers_twice,
    measured_start,
    on_branch,
    scene_start,
    starts_from_plain,
)
from .tracks import Track

METHODS = ("auto", "chart")


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
        Bound of the error of contact points, as a fraction of the body's ``size``, 1e-15 to 1e-1.
        It holds for paths of a few sizes. Errors made on the way grow with the path, by as much as
        the surfaces draw neighbouring paths apart: over hundreds of sizes, and where accelerations
        drive a contact many times around, to tens or hundreds of tolerances. Below 1e-12, and for
        places many sizes from the origin, rounding may count for more.
    method : str
        "auto": per contact and interval the cheapest exact way (theory sections 4 to 7).
        "chart": the paper's equations (eqs. `timegeodesic`, `contrac`), errata corrected, by a
        scipy solver; for comparison.
    solver : str
        scipy's method for ``method="chart"``: RK23, RK45, DOP853, Radau, BDF or LSODA.
    compiled : bool or None
        True: compiled kernels, built where they are not in the cache yet; False: none;
        None: those that were built before.

    Raises
    ------
    ContactSystemError
        What is wrong with the scene, the contact, the value, and the remedy.
    """
    return Plan(scene, tolerance, method, solver, compiled, 0.0, None)


class Plan:
    """Contact curves of a scene, evaluated on demand. Made by :func:`plan`.

    Times are in seconds inside [:attr:`start`, :attr:`end`], one or an axis of them, in any order;
    results have the times along their first axis, of length 1 for one time, and the contacts along
    the second. At a window's edge they are those after it; at the end of the horizon, those before
    it. A time outside raises a ContactSystemError. Several threads may ask one plan, and plan
    scenes, at the same time.

    Attributes
    ----------
    scene : Scene
    tolerance : float
    method, solver : str
    start : float
        Where the plan begins, s: 0, or the time of :meth:`restart` or :meth:`continued`.
    end : float
        Where it ends, s: ``scene.duration``.
    """

    _groups: list[Group] | None = None
    _begun: Begun | None = None
    _asked = False

    def __init__(
        self,
        scene: Scene,
        tolerance: float,
        method: str,
        solver: str,
        compiled: bool | None,
        start: float,
        starts: Starts | None,
    ):
        if method not in METHODS:
            raise SceneError(f"method = {method!r}: use one of {', '.join(METHODS)}")
        if solver not in SOLVERS:
            raise SceneError(f"solver = {solver!r}: use one of {', '.join(SOLVERS)}")
        if not isinstance(scene, Scene):
            require_scene(scene)
        if not (type(tolerance) is float and 1e-15 <= tolerance <= 0.1):
            tolerance = checked_tolerance(tolerance)
        if compiled is not True:
            compiled = flag(compiled, "compiled", none=True)
        self.scene, self.tolerance, self.method = scene, tolerance, method
        self.solver, self.compiled, self.start, self.starts = solver, compiled, start, starts
        self.end = scene.duration
        if method == "chart":
            given = [s for s in starts or () if isinstance(s, Start)]
            given = given or [scene_start(contact) for contact in scene.contacts]
            self._groups = chart_groups(scene, given, start, tolerance, solver)
        else:
            numbers_alone = starts is None and compiled is not False and kinds.are_few(scene)
            if numbers_alone:
                self._begun = kinds.begin(scene, compiled)
            if self._begun is None:
                self._groups = plan_groups(scene, starts, start, tolerance, compiled)
                require_regular(scene, self._groups)
                if numbers_alone:
                    kinds.learn(scene, self._groups, compiled)
            elif self._begun.kind.charted:  # what is integrated for this is kept
                self._groups = self._begun.groups(scene, self.tolerance)
                require_regular(scene, self._groups)
        self._count = len(scene.contacts)

    def __reduce__(self) -> tuple:
        """What is pickled and copied: what the plan is made from, as in :meth:`save`."""
        made_from = (self.scene, self.tolerance, self.method, self.solver, self.compiled)
        return Plan, (*made_from, self.start, self.starts)

    @property
    def groups(self) -> list[Group]:
        """Contacts that move together, and their tracks."""
        if self._groups is None:
            assert self._begun is not None
            self._groups = self._begun.groups(self.scene, self.tolerance)
        return self._groups

    # --- results -------------------------------------------------------------------------------

    def states(self, t: ArrayLike) -> np.ndarray:
        """u1 v1 u1' v1' u2 v2 u2' v2' psi: (len(t), n_contacts, 9); rad, or m where charts have it.

        Coordinates and psi are continuous along the path. Rates are those of the contact point,
        object rate offsets included.

        Raises
        ------
        ChartSingularity
            At a time when a contact passes through a pole or an umbilic.
        """
        at_once = self._states_at_once(t)
        if at_once is not None:
            return at_once
        out = self._coordinates(t)
        psi = self._at_first("angle")[:, None] - (out[:, 4] + out[:, 9])
        out[:, 4:8] = out[:, 5:9]
        out[:, 8] = psi
        return out[:, :9].transpose(2, 0, 1)

    def points(self, t: ArrayLike) -> np.ndarray:
        """Contact point on finger and object, each in its body's frame: (len(t), n, 2, 3), m."""
        times = _one_axis(t)
        out = np.empty((self._count, 2, 3, len(times)))
        self._fill("points", times, 3, out)
        return out.transpose(3, 0, 1, 2)

    def slip(self, t: ArrayLike) -> np.ndarray:
        """Slip v_rel in E2 (eq. `netrelvel`): (len(t), n_contacts, 2), m/s.

        By the exact law, |v_rel| = |V| sigma exp(-L), not as a difference of velocities; while an
        object rate offset d acts, less M2 d.

        Raises
        ------
        ChartSingularity
            At a time when a contact that slips passes through a pole or an umbilic of the object.
        """
        return self._in_contact_frame(t, _slip)

    def slip_speed(self, t: ArrayLike) -> np.ndarray:
        """Length of :meth:`slip`: (len(t), n_contacts), m/s. It exists at a pole too."""
        return self._collect(t, lambda motion: np.linalg.norm(_slip(motion), axis=1), ())

    def acceleration(self, t: ArrayLike) -> np.ndarray:
        """Tangential relative acceleration in E2 (eqs. `velacceleration`, `contracaccel`).

        (len(t), n_contacts, 2), m/s^2. (sigma'/sigma - lam) v_rel, plus R_psi M1 d1 - M2 d2 while
        accelerations d act; object rate offsets are left out. Raises as :meth:`slip`.
        """
        return self._in_contact_frame(t, _acceleration)

    def pose(self, t: ArrayLike) -> np.ndarray:
        """Pose of the finger's body frame in the object's: (len(t), n_contacts, 4, 4).

        Homogeneous matrices, origin in m (theory section 8).
        """
        times = _one_axis(t)
        frames = np.empty((self._count, 18, len(times)))
        if self._fill_compiled("frames", times, 9, frames):
            return relative_pose(frames[:, :9], frames[:, 9:], self._at_first("r0")).swapaxes(0, 1)
        return self._collect(t, lambda motion: motion.pose, (4, 4))

    def twist(self, t: ArrayLike) -> np.ndarray:
        """Twist V_OF_O: (len(t), n_contacts, 6), rad/s then m/s.

        The finger frame's angular velocity and the velocity of its origin, in the object's frame
        (theory section 8).
        """
        return self._collect(t, lambda motion: motion.twist(), (6,))

    def carried(self, t: ArrayLike) -> np.ndarray:
        """The frames carried along by parallel transport (theory section 4), finger and object.

        (len(t), n_contacts, 2, 3): theta, rad, the frame's angle in E_i, continuous; and the path
        velocity in that frame, W_1 or W - V exp(-L), no unit, without object rate offsets. What
        u', v' are made of; it exists where sigma = 0 and is constant while nothing acts.

        Raises
        ------
        ChartSingularity
            At a time when a contact passes through a pole or an umbilic.
        SceneError
            ``method="chart"``, which carries no frames.
        """
        self._require_frames("carried")
        out = np.empty((len(_one_axis(t)), self._count, 2, 3))
        out[..., 0] = self._coordinates(t)[:, 4::5].transpose(2, 0, 1)
        times = self._times(t)
        for group in self.groups:
            for record, where in _parts(group.slips, times):
                own = record.finger_velocity(times[where])
                index = np.ix_(np.arange(len(times))[where], group.contacts)
                out[..., 0, 1:][index] = own.transpose(2, 0, 1)
                out[..., 1, 1:][index] = (group.r0 @ own - record.slip(times[where])).transpose(
                    2, 0, 1
                )
        return out

    # --- telling, saving -----------------------------------------------------------------------

    def explain(self) -> str:
        """Which way was taken for each contact and interval, why, and what was skipped.

        A text; its panels are steps of Gauss collocation.
        """
        lines = [f"{self.scene.title}: tolerance {self.tolerance:g}, method {self.method}"]
        for group in sorted(self.groups, key=lambda g: g.contacts[0]):
            names = ", ".join(str(i) for i in group.contacts)
            lines.append(f"contact{'s' * (len(group.contacts) > 1)} {names}:")
            for side in SIDES:
                for track in getattr(group, side):
                    lines.append(
                        f"  {side:6s} [{track.start:.6g}, {track.stop:.6g}] s  {track.method}"
                        f"  ({track.reason})"
                    )
            lines += [f"  skipped: {text}" for text in _skipped(group)]
        return "\n".join(lines)

    def continued(self, t: float, scene: Scene | None = None) -> Plan:
        """The plan from time t on, under other disturbances, gain, profile or duration.

        It goes on from the moving frames as they are, so that nothing is lost: what changes
        nothing reproduces this plan, also from a pole or where sigma = 0.

        Parameters
        ----------
        t : float
            s, inside this plan's horizon and before the end of the other scene.
        scene : Scene, optional
            The scene that holds from t on, with the same contacts' surfaces; by default this one.

        Raises
        ------
        SceneError
            Other surfaces or contacts, nothing left to plan, contacts whose rolling is imposed
            (in either scene), or ``method="chart"``.
        """
        after = self.scene if scene is None else scene
        require_scene(after)
        t = self._time(t)
        where = f"{after.title}, continued at t = {t:g} s"
        if not t < after.duration:
            raise SceneError(
                f"{where}: nothing is left to plan, the scene ends at "
                f"{after.duration:g} s; continue earlier or lengthen the scene"
            )
        if len(after.contacts) != self._count:
            raise SceneError(
                f"{where}: contacts = {len(after.contacts)}, and the plan has "
                f"{self._count}; give a scene of the same contacts"
            )
        fingers = [[c.finger for c in s.contacts] for s in (self.scene, after)]
        if fingers[0] != fingers[1] or self.scene.object != after.object:
            raise SceneError(
                f"{where}: the scene has other surfaces than the plan; give one with the same"
            )
        self._require_frames("continued")
        for s in (self.scene, after):
            for i, contact in enumerate(s.contacts):
                if contact.follows:
                    raise SceneError(
                        f"continued at t = {t:g} s: {s.title}, contact {i}: rolling that is "
                        "imposed has one plan; give finger_velocity as numbers"
                    )
        starts = moments(self.groups, t)
        return Plan(after, self.tolerance, self.method, self.solver, self.compiled, t, starts)

    def _require_frames(self, asked: str) -> None:
        if self.method == "chart":
            raise SceneError(
                f"{asked}: method 'chart' carries no frames along; use the default method"
            )

    def restart(self, t: float, state: ArrayLike) -> Plan:
        """Plan again from measured states at time t.

        Parameters
        ----------
        t : float
            s, with sigma(t) > 0. The path goes on along rates / sigma: beside a rest the rates'
            rounding alone may turn it. :meth:`continued` takes no rates and is exact there.
        state : (n_contacts, 9)
            Measured u1 v1 u1' v1' u2 v2 u2' v2' psi, as :meth:`states` gives them or in principal
            values: where a chart covers its surface twice, they are turned to the plan's side.

        Raises
        ------
        SceneError
            A wrong shape, NaN, a contact at a pole or an umbilic, sigma(t) = 0, nothing left to
            plan, or contacts whose rolling is imposed.
        """
        where, shape = f"{self.scene.title}, restart", (len(self.scene.contacts), 9)
        t = self._time(t)
        try:
            measured = real_array(state)
        except (TypeError, ValueError, OverflowError):
            raise SceneError(f"{where}: state = {state!r}; give numbers, shape {shape}") from None
        if measured.shape != shape:
            raise SceneError(f"{where}: state has shape {measured.shape}; give {shape}")
        if not t < self.end:
            raise SceneError(
                f"{where} at t = {t:g} s: nothing is left to plan, the scene ends at "
                f"{self.end:g} s; restart earlier or lengthen the scene"
            )
        measured = self._on_branch(t, measured)
        offsets, starts = acting(self.scene, t)[:, 4:], []
        for i, contact in enumerate(self.scene.contacts):
            if contact.follows:
                raise SceneError(
                    f"{where}: contact {i} has its rolling imposed; give finger_velocity as numbers"
                )
            starts.append(measured_start(self.scene, i, t, measured[i], offsets[i]))
        return Plan(self.scene, self.tolerance, self.method, self.solver, self.compiled, t, starts)

    def _on_branch(self, t: float, measured: np.ndarray) -> np.ndarray:
        """Rows on the plan's side of charts that cover their surface twice.

        Disturbances are chart components: on the other side they would act the other way.
        """
        with contextlib.suppress(ChartSingularity):  # the plan is at an umbilic: no side
            if covers_twice(self.scene):
                return on_branch(self.scene, measured, self.states(t)[0])
        return measured

    def save(self, path: str | os.PathLike, times: ArrayLike | None = None) -> None:
        """Write the plan and its sampled results.

        ``.npz``: the scene (as TOML text), what :func:`load` needs, and t, states, slip, twist,
        pose, points. ``.csv``: t, contact, the nine states, slip, slip magnitude.

        Parameters
        ----------
        path : path ending in .npz or .csv
        times : (n,), optional
            Default: 401 equally spaced times and the window edges.

        Raises
        ------
        ContactSystemError
            No path, another ending, or a file that cannot be written.
        """
        path = a_path(path)
        t = self.sample_times() if times is None else self._times(times)
        with writing(path, f"{self.scene.title}: "):
            self._write(path, t)

    def _write(self, path: Path, t: np.ndarray) -> None:
        if path.suffix == ".npz":
            header = {
                "tolerance": self.tolerance, "method": self.method, "solver": self.solver,
                "start": self.start,
                "starts": [vars(s) for s in self.starts] if self.starts else None,
            }  # fmt: skip
            np.savez_compressed(
                path, scene=scene_to_toml(self.scene), plan=json.dumps(header), t=t,
                states=self.states(t), slip=self.slip(t), twist=self.twist(t), pose=self.pose(t),
                points=self.points(t),
            )  # fmt: skip
        elif path.suffix == ".csv":
            path.write_text(self._csv(t))
        else:
            raise ContactSystemError(f"{path}: unknown ending {path.suffix!r}; use .npz or .csv")

    def sample_times(self, count: int = 401) -> np.ndarray:
        """Equally spaced times over the plan, and the scene's edges: (n,), ascending, s.

        None stands there twice but for rounding.

        Parameters
        ----------
        count : int
            Of the equally spaced ones, at least 1.
        """
        if not isinstance(count, numbers.Integral) or isinstance(count, bool) or count < 1:
            raise ContactSystemError(f"count = {count!r}: give a whole number, at least 1")
        grid, spacing = np.linspace(self.start, self.end, count, retstep=True)
        edges = np.array([e for e in self.scene.edges if e >= self.start])
        same = (np.abs(grid[:, None] - edges) < 1e-9 * spacing).any(axis=1)
        return np.union1d(grid[~same], edges)

    def _csv(self, t: np.ndarray) -> str:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["t [s]", "contact", "u1", "v1", "du1", "dv1", "u2", "v2", "du2", "dv2",
                         "psi [rad]", "slip x [m/s]", "slip y [m/s]", "slip [m/s]"])  # fmt: skip
        states, slip = self.states(t), self.slip(t)
        for k, time in enumerate(t):
            for i in range(len(self.scene.contacts)):
                numbers = [*states[k, i], *slip[k, i], np.hypot(*slip[k, i])]
                writer.writerow([repr(float(time)), i, *(repr(float(x)) for x in numbers)])
        return text.getvalue()

    # --- inside ----------------------------------------------------------------------------------

    def _time(self, t: Any) -> float:
        """One time inside the horizon."""
        times = self._times(t)
        if np.ndim(t):
            raise SceneError(f"{self.scene.title}: t = {t!r}; give a time in seconds")
        return float(times[0])

    def _times(self, t: ArrayLike) -> np.ndarray:
        times = _one_axis(t)
        if times.size and not (times.min() >= self.start and times.max() <= self.end):
            self._refuse(times)
        return times

    def _refuse(self, times: np.ndarray) -> None:
        first, last = self.start, self.end
        bad = float(times[~((times >= first) & (times <= last))][0])
        others = ""
        if bad > last:
            others = ", or lengthen the scene's duration"
        elif 0 <= bad < first:
            others = ", or the plan that this one goes on from"
        raise ContactSystemError(
            f"{self.scene.title}: t = {bad!r} s is outside the plan's horizon "
            f"[{first:g}, {last:g}] s; ask inside it{others}"
        )

    def _coordinates(self, t: ArrayLike) -> np.ndarray:
        """u v u' v' theta of the finger, then of the object: (n_contacts, 10, n_times)."""
        times = _one_axis(t)
        out = np.empty((self._count, 10, len(times)))
        self._fill("coordinates", times, 5, out)
        return out

    def _fill(self, output: str, times: np.ndarray, count: int, out: np.ndarray) -> None:
        """Write ``count`` rows of the finger, then of the object, of each contact."""
        if self._fill_compiled(output, times, count, out):
            return
        only, out = len(self.groups) == 1, out.reshape(self._count, 2 * count, len(times))
        group = self.groups[0]
        try:
            times = self._times(times)
            for group in self.groups:
                values = out if only else np.empty((len(group.contacts), *out.shape[1:]))
                self._fill_group(group, output, times, count, values)
                if values is not out:
                    out[group.contacts] = values
        except ChartSingularity as error:
            raise self._named(group, error) from None

    def _states_at_once(self, t: ArrayLike) -> np.ndarray | None:
        """The states by one compiled call, or None where there is no such way (program.py)."""
        times, begun = _one_axis(t), self._begun
        if not times.flags.c_contiguous:
            return None
        shape, code = (self._count, 9, len(times)), -1
        if begun is not None and begun.kind.states and (begun.kind.closed or self._first_look()):
            out = np.empty(shape)
            code = begun.states(times, out, self.tolerance)
        if begun is not None and not begun.kind.alone and self._groups is None:
            return None
        if code < 0:
            group = self.groups[0]
            one = len(self.groups) == 1 and group.moving
            made = chart_states(group, self.compiled) if one else None
            if made is None:
                return None
            out = np.empty(shape)
            code = made.fill(self.tolerance, times, out)
        if code > 0:
            self._refuse(times)
        return out.transpose(2, 0, 1) if code == 0 else None

    def _at_first(self, name: str) -> np.ndarray:
        """ "r0", R_0, or "angle", psi(0), of all contacts along the first axis."""
        if self._groups is None:
            return getattr(self._begun, name)
        parts = [getattr(group, name) for group in self._groups]
        if len(parts) == 1:
            return parts[0]
        found = np.empty((self._count, *parts[0].shape[1:]))
        for group, part in zip(self._groups, parts):
            found[group.contacts] = part
        return found

    def _named(self, group: Group, error: ChartSingularity) -> ChartSingularity:
        return ChartSingularity(f"{group_name(self.scene, group.contacts)}: {error}")

    def _fill_group(
        self, group: Group, output: str, times: np.ndarray, count: int, values: np.ndarray
    ) -> None:
        if group.pair is not None:
            group.anchor_pair()
            whole = values.reshape(2 * len(values), count, len(times))
            getattr(group.pair, output)(times, whole)
        else:
            for k, side in enumerate(SIDES):
                for track, where in _parts(getattr(group, side), times):
                    if output == "coordinates":
                        group.anchor(side, track)
                    part = values[:, k * count : (k + 1) * count]
                    _write(getattr(track, output), times, where, part)

    def _fill_compiled(self, output: str, times: np.ndarray, count: int, out: np.ndarray) -> bool:
        """The shortest way: all tracks in one call. False if there is none."""
        if not times.flags.c_contiguous:
            return False
        begun = self._begun
        if begun is not None and (begun.kind.closed or self._first_look()):
            found = begun.fill(output, count, times, out, self.tolerance)
            if found > 0:
                self._refuse(times)
            if found == 0:
                return True
        program = self._program(output)
        if program is None:
            return False
        if output == "coordinates":
            for group in self.groups:
                group.anchor_all()
        code = program.fill(count, times, out)
        if code:
            self._refuse(times)
        return code == 0

    def _first_look(self) -> bool:
        """Whether nothing was asked yet: who looks once needs no motions that are kept."""
        first, self._asked = not self._asked and self._groups is None, True
        return first

    @kept
    def _programs(self) -> dict[str, Program | None]:
        return {}

    def _program(self, output: str) -> Program | None:
        if len(self.groups) == 1:
            return group_program(self.groups[0], output)
        if output not in self._programs:
            self._programs[output] = program_of(self.groups, output)
        return self._programs[output]

    def _collect(
        self, t: ArrayLike, read: Callable[[Sample], np.ndarray], shape: tuple[int, ...]
    ) -> np.ndarray:
        times = self._times(t)
        out = np.empty((len(times), len(self.scene.contacts), *shape))
        for group in self.groups:
            for motion, where in _motions(group, times):
                index = where if isinstance(where, np.ndarray) else np.arange(len(times))[where]
                with np.errstate(under="ignore"):  # slip may end below what a double holds
                    out[np.ix_(index, group.contacts)] = read(motion).swapaxes(0, 1)
        return out

    def _in_contact_frame(self, t: ArrayLike, read: Callable[[Sample], np.ndarray]) -> np.ndarray:
        """Turn (n, 2, n_times) from the object's parallel frame into E2."""
        times = self._times(t)
        out = np.zeros((len(self.scene.contacts), 2, len(times)))
        for group in self.groups:
            values = np.zeros((len(group.contacts), 2, len(times)))
            for motion, where in _motions(group, times):
                with np.errstate(under="ignore"):  # slip may end below what a double holds
                    plane = read(motion)
                    if plane.any():
                        theta = self._object_angle(group, motion)
                        c, s = np.cos(theta), np.sin(theta)
                        values[:, 0, where] = c * plane[:, 0] - s * plane[:, 1]
                        values[:, 1, where] = s * plane[:, 0] + c * plane[:, 1]
            out[group.contacts] = values
        return out.transpose(2, 0, 1)

    def _object_angle(self, group: Group, motion: Sample) -> np.ndarray:
        """theta of the object, (n, n_times)."""
        values = np.empty((len(group.contacts), 5, len(motion.t)))
        group.anchor("object", motion.object)
        try:
            motion.object.coordinates(motion.t, values)
        except ChartSingularity as error:
            raise self._named(group, error) from None
        return values[:, 4]


def checked_tolerance(given: Any) -> float:
    """The tolerance as a float.

    Raises
    ------
    SceneError
        If it is no number from 1e-15 to 1e-1.
    """
    try:
        number = float(given) if isinstance(given, numbers.Real) else math.nan
    except OverflowError:
        number = math.inf
    if not 1e-15 <= number <= 0.1:
        raise SceneError(f"tolerance = {given!r}: give a number from 1e-15 to 1e-1")
    return number


def _one_axis(t: ArrayLike) -> np.ndarray:
    try:
        times = np.asarray(t)
        if times.dtype is not FLOAT:
            times = real_array(times)
    except (TypeError, ValueError, OverflowError):
        raise ContactSystemError(
            f"t = {t!r}: give a time in seconds, or one axis of times"
        ) from None
    if times.ndim == 1:
        return times
    if times.ndim == 0:
        return times[None]
    raise ContactSystemError(f"times have shape {times.shape}; give one axis of times")


def _write(method: Callable, times: np.ndarray, where: slice | np.ndarray, out: np.ndarray) -> None:
    """Call a track's method for some of the times, into some of the columns of out."""
    if isinstance(where, slice):
        method(times[where], out[..., where])
    else:
        part = np.empty((*out.shape[:-1], len(where)))
        method(times[where], part)
        out[..., where] = part


class Sample:
    """Both sides of a group at times of one interval."""

    def __init__(self, group: Group, finger: Track, obj: Track, slip, t: np.ndarray):
        self.group, self.finger, self.object, self.record, self.t = group, finger, obj, slip, t

    @kept
    def frames(self) -> tuple[np.ndarray, np.ndarray]:
        return self.finger.frames(self.t), self.object.frames(self.t)

    @kept
    def pose(self) -> np.ndarray:
        return relative_pose(*self.frames, self.group.r0)

    def twist(self) -> np.ndarray:
        tracks = self.finger, self.object
        states = [
            frame if track.ambient else track.state(self.t)
            for track, frame in zip(tracks, self.frames)
        ]
        velocities = [track.velocity(self.t, s) for track, s in zip(tracks, states)]
        shapes = [track.shape(s) for track, s in zip(tracks, states)]
        return relative_twist(
            self.frames[1],
            self.pose,
            (shapes[0], shapes[1]),
            (velocities[0], velocities[1]),
            self.group.r0,
            _slip(self),
        )


def _slip(motion: Sample) -> np.ndarray:
    """v_rel along (p_2, q_2): sigma V, less the object rate offset's velocity."""
    record, track = motion.record, motion.object
    tau = motion.t - record.start
    out = np.zeros((len(motion.group.contacts), 2, len(tau)))
    if record.of is not None:
        out += record.of(tau) * record.piece.speed(tau)
    if track.offset is not None:
        out -= track.parallel(track.state(motion.t), track.offset)
    return out


def _acceleration(motion: Sample) -> np.ndarray:
    record = motion.record
    tau = motion.t - record.start
    out = np.zeros((len(motion.group.contacts), 2, len(tau)))
    if record.of is not None:
        v = record.of(tau)
        lam = np.where(v.any((0, 1)), record.piece.gain(tau), 0.0)
        out += v * (record.piece.slope(tau) - lam * record.piece.speed(tau))
    if record.forcing is None:
        return out
    finger, obj = record.forcing
    if finger.any():
        pushed = motion.finger.parallel(motion.finger.state(motion.t), finger)
        out += motion.group.r0 @ pushed
    if obj.any():
        out -= motion.object.parallel(motion.object.state(motion.t), obj)
    return out


def _parts(intervals: Sequence[Any], times: np.ndarray) -> Iterator[tuple[Any, slice | np.ndarray]]:
    """(interval, where its times stand); an edge belongs to the later interval."""
    if len(intervals) == 1:
        yield intervals[0], slice(None)
        return
    which = np.searchsorted([i.start for i in intervals[1:]], times, side="right")
    for k, where in runs(which):
        yield intervals[k], where


def _motions(group: Group, times: np.ndarray):
    """Cut times by the tracks of both sides and the slip records."""
    for record, where in _parts(group.slips, times):
        index = np.arange(len(times))[where]
        for finger, inner in _parts(group.finger, times[index]):
            rest = index[inner]
            for obj, innermost in _parts(group.object, times[rest]):
                chosen = rest[innermost]
                yield Sample(group, finger, obj, record, times[chosen]), chosen


def _skipped(group: Group) -> list[str]:
    tracks = group.finger + group.object
    notes = []
    closed = [t for t in tracks if t.method.startswith("closed form")]
    if len(closed) == len(tracks):
        notes.append("all integration")
    elif all(t.method.startswith("closed form") for t in group.finger):
        notes.append("integration of the finger")
    if all(record.of is None for record in group.slips):
        if any(track.offset is not None for track in tracks):
            notes.append("gain (slip is that of rate offsets, which ends with them)")
        else:
            notes.append("slip and gain (there is none to reject)")
    return notes


def require_plan(given: Any) -> None:
    """Raise a ContactSystemError where something else is given, such as a scene."""
    if not isinstance(given, Plan):
        raise ContactSystemError(f"plan = {given!r:.80}: give a Plan, such as plan(scene)")


def load(path: str | os.PathLike) -> Plan:
    """Read a plan saved as .npz and plan it again from the scene inside.

    What it gives is the same but for rounding: the third scene of a kind is planned by a shorter
    way than the first.

    The sampled results can be read with ``numpy.load`` alone.

    Raises
    ------
    ContactSystemError
        If the file cannot be read, or is not such a plan.
    """
    try:
        with np.load(path) as data:
            text, header = str(data["scene"]), json.loads(str(data["plan"]))
        tolerance, method, solver = (header[key] for key in ("tolerance", "method", "solver"))
        start, starts = float(header["start"]), header["starts"] or None
        if starts is not None:
            starts = starts_from_plain(starts)
    except OSError as error:
        raise ContactSystemError(f"{path} cannot be read: {error}; give a plan's file") from None
    except Exception:  # whatever a file of another kind, or a damaged one, leads to
        raise ContactSystemError(
            f"{path}: not a plan written by Plan.save; give such a file ending in .npz"
        ) from None
    scene = scene_from_toml(text, source=str(path))
    return Plan(scene, tolerance, method, solver, None, start, starts)
