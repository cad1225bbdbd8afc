r"""The whole scene as one system of ordinary differential equations, as CasADi functions.

Other integrators can use them, such as Drake's Simulator. Everything is a pure function of

====== =========================================================================================
t      time, s
x      continuous states, contact by contact
w      disturbances acting now, 6 for each contact: accelerations of finger and object (chart
       components), object rate offset; empty without disturbances and ``disturbance_input``
held   numbers that change only at restarts and corners. In frame coordinates 5 for each contact
       that is not accelerated: W_1, V, and the time since the start of its leg at which V has
       this value. For a contact with legs, also the start and profile coefficients of its leg
p      parameters: gain, profile coefficients, parameters and sizes of the surfaces
====== =========================================================================================

Two choices of coordinates describe the same motion:

* "chart", the paper's equations (theory section 2): u1 v1 u1' v1' u2 v2 u2' v2' psi a contact;
  singular at poles and where sigma = 0, as at corners; stiff in lam;
* "frame", moving frames (theory sections 4, 5): a point and a tangent (x, p) in space, or
  (u, v, theta) on a surface that has only a chart or whose chart decides the sign of a disturbance.
  Slip needs no state, as V e^{-L} is in closed form. W_1 and V are states only of a contact that
  is accelerated, and of one with legs under a gain law that cancels growth of sigma: such a
  law removes slip at corners. The frames are chosen so that psi = -theta_1 - theta_2 and the map
  between them is diag(1, -1).

The equations are those of `theory`. CasADi is loaded when the first system is made.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .caching import cached_property
from .checks import flag, one_of, shaped_array
from .contact_equations import Form, contact_function
from .engine.binding import START, Machine, run
from .errors import SceneError
from .planning.starts import Moment, measured_start
from .scene import SLOTS, Disturbance, Scene, Start, acting, refuse_rest, require_scene
from .scene.contact import rotated
from .surfaces import TINY, Surface, run_in_space
from .theory import symbols as ca
from .theory.development import in_space
from .theory.lowering import Table
from .theory.profile import polynomial
from .theory.symbols import making_symbols

Array = np.ndarray

COORDINATES = ("chart", "frame")
INPUTS = ("t", "x", "w", "held", "p")


class SceneSystem:
    """The equations of all contacts of a scene, ready to be integrated.

    Parameters
    ----------
    scene : Scene
    coordinates : "chart" or "frame", optional
        ``help(contact_system.system)`` explains both, and t, x, w, held and p. Default: "frame" if
        the scene has legs, sigma = 0 or a surface without a chart, else "chart".
    disturbance_input : bool
        Whether w may hold any disturbances, of every contact, not only those of the scene.

    Attributes
    ----------
    x0, held0 : (n_x,), (n_held,)
        Initial values, at t = 0.
    parameters : (n_p,)
        Values of p; their names are ``parameter_names``.
    n_w : int
        6 for each contact, or 0 if w is empty.
    edges : tuple of float
        Times at which :meth:`window_values` changes, and corners, ascending, s.
    corners : frozenset of float
        Times at which x or held jump; :meth:`turned` gives them just after. A leg after the first
        begins, or sigma = 0 sets a V that is a state to 0, under a law that cancels growth.
    state_slices, held_slices : list of slice
        The parts of x and held that belong to each contact.

    Raises
    ------
    SceneError
        A scene that cannot be written in these coordinates: in charts, one with legs, sigma = 0 or
        a surface without an explicit chart; in both, sigma = 0 while a contact is accelerated.
    """

    def __init__(
        self, scene: Scene, coordinates: str | None = None, disturbance_input: bool = False
    ):
        require_scene(scene)
        if coordinates is None:
            coordinates = "frame" if without_chart(scene) else "chart"
        self.scene, self.coordinates = scene, one_of(coordinates, COORDINATES, "coordinates")
        self.disturbance_input = flag(disturbance_input, "disturbance_input")
        if self.coordinates == "chart" and (reason := without_chart(scene)):
            raise SceneError(f'{scene.title}{reason}; use coordinates="frame"')
        for d in scene.disturbances:
            if d.accelerates:
                refuse_rest(scene, int(d.contact), d.start, d.stop)
        n = len(scene.contacts)
        self.n_w = 6 * n if scene.disturbances or disturbance_input else 0
        self.forms = self._forms()
        turns = {stretch.start for i in range(n) for stretch in scene.way(i)[1:]}
        self.corners = frozenset(turns.union(*map(self._rests, range(n))))
        self.edges = tuple(sorted({*scene.window_edges, *self.corners}))
        self.state_slices = consecutive(sum(form.sizes) for form in self.forms)
        self.held_slices = consecutive(
            form.n_held + bool(contact.legs) * (1 + form.n_profile)
            for form, contact in zip(self.forms, scene.contacts)
        )
        law = (scene.gain.value, *scene.profile.coefficients)
        numbers = [law, *((*surface.parameters, surface.size) for surface in scene.surfaces)]
        self._number_slices = consecutive(map(len, numbers))
        self.parameters = np.concatenate(numbers)
        self.x0, self.held0 = self.place(0.0, [c.start() for c in scene.contacts])
        self._functions: dict[tuple[str, ...], ca.Function] = {}

    def __reduce__(self) -> tuple:
        """Pickle and copy the arguments; the system is made again."""
        return SceneSystem, (self.scene, self.coordinates, self.disturbance_input)

    def _forms(self) -> list[Form]:
        scene, chart = self.scene, self.coordinates == "chart"
        far, law = 1e3 * scene.duration, scene.gain.row  # integrators may go beyond the horizon
        growths = tuple(scene.profile.growths(0.0, far) if law.cancels_growth else ())
        forms = []
        for i, contact in enumerate(scene.contacts):
            slots = {d.slot for d in scene.disturbances if d.contact == i}
            d1, d2, offset = (self.disturbance_input or slot in slots for slot in range(len(SLOTS)))
            tip = not chart and in_space(contact.finger, d1)
            body = not chart and in_space(scene.object, d2 or offset)
            forced = not chart and (d1 or d2 or (law.cancels_growth and bool(contact.legs)))
            n_profile = max(len(stretch.profile.coefficients) for stretch in scene.way(i))
            grown = () if contact.legs else growths
            forms.append(Form(self.coordinates, forced, (tip, body), law, n_profile, grown))
        return forms

    def _rests(self, contact: int) -> set[float]:
        """Times > 0 at which sigma = 0, so that an infinite lam sets a V that is a state to 0."""
        if not (self.forms[contact].forced and self.scene.gain.row.cancels_growth):
            return set()
        return {
            leg.start + zero
            for leg in self.scene.way(contact)
            for zero in leg.profile.zeros(leg.stop - leg.start)
            if leg.start + zero > 0
        }

    @cached_property
    def parameter_names(self) -> list[str]:
        """Names of p, such as ``gain.eta``, ``profile[0]``, ``contacts[0].finger.radius``."""
        scene = self.scene
        names = [f"gain.{scene.gain.parameter}"]
        names += [f"profile[{k}]" for k in range(len(scene.profile.coefficients))]
        owners = ["object", *(f"contacts[{i}].finger" for i in range(len(scene.contacts)))]
        for owner, surface in zip(owners, scene.surfaces):
            names += [f"{owner}.{name}" for name in (*surface.parameter_names(), "size")]
        return names

    # --- functions -------------------------------------------------------------------------------

    @cached_property
    def _symbols(self) -> dict[str, ca.SX]:
        sizes = (1, len(self.x0), self.n_w, len(self.held0), len(self.parameters))
        return {name: ca.SX.sym(name, size) for name, size in zip(INPUTS, sizes)}

    @cached_property
    def _expressions(self) -> dict[str, ca.SX]:
        """Every output as an expression of the symbols."""
        t, x, w, held, p = self._symbols.values()
        law, obj, *fingers = (p[s] for s in self._number_slices)
        scene, signs = self.scene, []
        by_name: dict[str, list[ca.SX]] = {}
        for i, (contact, form) in enumerate(zip(scene.contacts, self.forms)):
            disturbed = [d for d in scene.disturbances if d.contact == i]
            acts = w[6 * i : 6 * i + 6] if self.disturbance_input or disturbed else ca.SX.zeros(6)
            function = contact_function(contact.finger, scene.object, form)
            own_t, own_held, own_law = t, held[self.held_slices[i]], law
            if contact.legs:
                own_held, began, profile = ca.vertsplit(
                    own_held, [0, form.n_held, form.n_held + 1, own_held.numel()]
                )
                own_t, own_law = t - began, ca.vertcat(law[0], profile)
            carried = x[self.state_slices[i]], acts, own_held
            values = function(own_t, *carried, own_law, fingers[i], obj)
            for name, value in zip(function.name_out(), values):
                by_name.setdefault(name, []).append(value)
            signs.append(_sign(ca.vertsplit(own_law[1:]), own_t))
        outputs = {name: ca.vertcat(*values) for name, values in by_name.items()}
        rate = outputs["derivatives"]  # if it is NaN, so is the guard; a minimum would hide it
        outputs["guard"] = ca.mmin(ca.vertcat(*signs)) - TINY * ca.sumsqr(rate)
        outputs["clearance"] = ca.mmin(outputs["regularity"])
        return outputs

    def function(self, *outputs: str) -> ca.Function:
        """The CasADi function (t, x, w, held, p) -> outputs, one vector each.

        Parameters
        ----------
        outputs : str
            "derivatives" (n_x); "guard" (1), negative or NaN where the derivatives must not be used
            because sigma < 0 or one of them is not finite; "clearance" (1), the least regularity.
            For each contact: "state" (9), u1 v1 u1' v1' u2 v2 u2' v2' psi with object rate offsets
            in u2' v2', in frame coordinates in the chart's principal range; "slip" (2) in E2, m/s;
            "twist" (6), V_OF_O; "acceleration" (6), its time derivative; "pose" (12), the rotation
            from F to O column by column, then the origin of F in O; "contact_point" (6), on the
            finger in F, on the object in O; "normal" (3), of the object, outward, in O, and its
            time derivative "normal_rate" (3); "slip_acceleration" (2), as `Plan.acceleration`;
            "carried" (4), W_1 and V along the moving frames, in charts along E1 and E2;
            "regularity" (2), distance of finger and object from their charts' singularities.

        Raises
        ------
        SceneError
            An unknown output.
        """
        with making_symbols():
            values = [self._expression(name) for name in outputs]
            if outputs not in self._functions:
                dense = [ca.densify(value) for value in ca.cse(values)]
                inputs, name = list(self._symbols.values()), "scene_" + "_".join(outputs)
                made = ca.Function(name, inputs, dense, list(INPUTS), list(outputs))
                self._functions[outputs] = made
        return self._functions[outputs]

    def jacobian(self, output: str) -> ca.Function:
        """The CasADi function (t, x, w, held, p) -> an output of :meth:`function` and its slopes.

        The slopes are its partial derivatives, a column each, by t, x, w and held.

        Raises
        ------
        SceneError
            An unknown output.
        """
        slopes = f"{output}_slopes"
        with making_symbols():
            if slopes not in self._expressions:
                *varied, _ = self._symbols.values()
                along = ca.vertcat(*varied)
                self._expressions[slopes] = ca.jacobian(self._expression(output), along)
            return self.function(output, slopes)

    def _expression(self, output: str) -> ca.SX:
        with making_symbols():
            known = self._expressions
        return known[one_of(output, known, f"{self.scene.title}: output")]

    def depends(self, output: str) -> set[str]:
        """The inputs among t, x, w, held, p that an output of :meth:`function` depends on."""
        value, symbols = self._expression(output), self._symbols
        return {name for name in INPUTS if ca.depends_on(value, symbols[name])}

    def evaluate(
        self,
        output: str,
        t: float,
        x: ArrayLike,
        w: ArrayLike | None = None,
        held: ArrayLike | None = None,
    ) -> Array:
        """One output of :meth:`function` as numbers, at time t [s]: (n,).

        Defaults: w of the scene's disturbances at t, and ``held0``.

        Raises
        ------
        SceneError
            An unknown output, or arrays of other lengths than (n_x,), (n_w,), (n_held,).
        """
        t, function = self._time(t), self.function(output)
        arrays = (
            self._numbers("x", x, len(self.x0)),
            self._numbers("w", self.window_values(t) if w is None else w, self.n_w),
            self._numbers("held", self.held0 if held is None else held, len(self.held0)),
        )
        return function(t, *arrays, self.parameters).full().ravel()

    def _time(self, t: ArrayLike) -> float:
        what, remedy = f"{self.scene.title}: t", "a time in seconds"
        return float(shaped_array(t, what, (), remedy=remedy))

    def _numbers(self, name: str, value: ArrayLike, count: int) -> Array:
        return shaped_array(value, f"{self.scene.title}: {name}", (count,))

    # --- windows and starts ----------------------------------------------------------------------

    @property
    def windows(self) -> list[tuple[Disturbance, slice]]:
        """The scene's disturbances and their places in w."""
        first = [6 * int(d.contact) + 2 * d.slot for d in self.scene.disturbances]
        return [(d, slice(k, k + 2)) for d, k in zip(self.scene.disturbances, first)]

    def window_values(self, t: float) -> Array:
        """w of the scene's disturbances on the interval that begins at t: (n_w,)."""
        return acting(self.scene, t).ravel()[: self.n_w]

    def place(self, t: float, starts: Sequence[Any]) -> tuple[Array, Array]:
        """x and held of contacts that start at time t: (n_x,), (n_held,).

        ``starts``: a `Start` for each contact, or in frame coordinates :meth:`Plan.moments`.

        Raises
        ------
        SceneError
            Moments in chart coordinates.
        """
        if self.coordinates == "chart" and any(isinstance(start, Moment) for start in starts):
            raise SceneError(
                f"{self.scene.title}: moments of a plan are states in frames, not in charts; use "
                'coordinates="frame", or from_states(t, plan.states(t))'
            )
        x, held = list[float](), list[float]()
        for i, (contact, form, start) in enumerate(zip(self.scene.contacts, self.forms, starts)):
            leg = self.leg_numbers(i, t)
            began, *profile = leg if len(leg) else (0.0, *self.scene.profile.coefficients)
            bodies, sigma = (contact.finger, self.scene.object), polynomial(profile, t - began)
            if form.coordinates == "chart":
                x += _chart_state(bodies, start, sigma)
                continue
            x += _frames(bodies, start, form.in_space)
            carried = self.carried(start, sigma)
            x += carried if form.forced else []
            held += [*([] if form.forced else [*carried, t - began]), *leg]
        return np.array(x), np.array(held)

    def carried(self, start: Any, sigma: float) -> list[float]:
        """W_1 and V of a contact that starts at this sigma, m/s, along its moving frames."""
        w1 = rotated(math.cos(start.angle), math.sin(start.angle), start.finger_velocity)
        if isinstance(start, Moment):
            return [*w1, *start.slip]
        if self.scene.gain.row.cancels_growth and not sigma > 0:  # lam is infinite: no slip
            return [*w1, 0.0, 0.0]
        point = np.array([[0, *w1, *start.object_velocity]]).T  # psi is 0 between frames
        return [*w1, *run(START, point, ())[-2:, 0].tolist()]

    def leg_numbers(self, contact: int, t: float) -> Array:
        """Start and profile of the leg that a contact is on just after t; empty without legs."""
        if not self.scene.contacts[contact].legs:
            return np.zeros(0)
        *_, leg = (leg for leg in self.scene.way(contact) if leg.start <= max(t, 0.0))
        c = leg.profile.coefficients
        return np.array([leg.start, *c, *[0.0] * (self.forms[contact].n_profile - len(c))])

    def turned(self, t: float, x: Array, held: Array, carried: Array) -> tuple[Array, Array]:
        """x and held after the corners at time t: (n_x,), (n_held,).

        Parameters
        ----------
        t : float
            One of `corners`. A contact whose held numbers are already those after it is unchanged.
        x, held : (n_x,), (n_held,)
            Their values before the corners; arrays of any number type, such as AutoDiffXd.
        carried : (4 n_contacts,)
            The output "carried" there.
        """
        x, held = np.array(x), np.array(held)
        for i, form in enumerate(self.forms):
            for now in self.scene.way(i)[1:]:
                part, (c, s) = self.held_slices[i], now.turn
                if now.start != t or held[part][form.n_held] == t:
                    continue
                w, u, *v = carried[4 * i : 4 * i + 4]
                if self.scene.gain.row.cancels_growth and not now.profile.coefficients[0]:
                    v = [0.0, 0.0]  # as in `place`
                after = [*rotated(c, s, (w, u)), *v]
                if form.forced:
                    x[self.state_slices[i]][-4:] = after
                since = [] if form.forced else [*after, 0.0]
                held[part] = [*since, *self.leg_numbers(i, t)]
            if t in self._rests(i):
                x[self.state_slices[i]][-2:] = 0.0
        return x, held

    def from_states(
        self,
        t: float,
        state: ArrayLike,
        w: ArrayLike | None = None,
        chosen: Sequence[bool] | None = None,
    ) -> tuple[Array, Array]:
        """x and held from measured chart states: (n_x,), (n_held,).

        Parameters
        ----------
        t : float
            s, with sigma(t) > 0.
        state : (n_contacts, 9) or (9 n_contacts,)
            u1 v1 u1' v1' u2 v2 u2' v2' psi, object rate offsets included in u2' v2'.
        w : (n_w,), optional
            The disturbances that act; default: the scene's.
        chosen : (n_contacts,), optional
            Whether each contact is measured, default all; the others start as the scene says.

        Raises
        ------
        SceneError
            A wrong shape, NaN, sigma(t) <= 0, or a point outside its chart.
        """
        n, rows = len(self.scene.contacts), shaped_array(state, f"{self.scene.title}: state")
        if rows.shape not in ((n, 9), (1, n, 9), (9 * n,)):
            where = f"{self.scene.title}, restart"
            raise SceneError(f"{where}: state has shape {rows.shape}; give {(n, 9)}")
        t = self._time(t)
        w = self._numbers("w", self.window_values(t) if w is None else w, self.n_w)
        offsets = w.reshape(-1, 6)[:, 4:] if self.n_w else np.zeros((n, 2))
        starts = [
            measured_start(self.scene, i, t, row, offset)
            if chosen is None or chosen[i]
            else self.scene.contacts[i].start()
            for i, (row, offset) in enumerate(zip(rows.reshape(n, 9), offsets))
        ]
        return self.place(t, starts)


def without_chart(scene: Scene) -> str:
    """Why chart equations cannot describe a scene, to be put after its title; empty if they can."""
    for i, contact in enumerate(scene.contacts):
        if contact.legs:
            return (
                f", {scene.contact_title(i)}: legs = {len(contact.legs)}: the chart equations have "
                "a path's direction only in its rates u', v', which are zero at a corner"
            )
        for surface in (contact.finger, scene.object):
            if not surface.has_chart:
                why = "has no explicit chart for the chart equations"
                return f", {scene.contact_title(i)}: {surface!r} {why}"
    zeros = scene.profile.zeros(scene.duration)
    if zeros:
        return (
            f": the chart equations divide by sigma, which is zero at t = {zeros[0]:g} s; "
            "moving frames, the default, do not"
        )
    return ""


def _sign(profile: list[ca.SX], t: ca.SX) -> ca.SX:
    """1, or -1 where sigma < 0 beyond rounding."""
    rounding = 1e-14 * polynomial([ca.fabs(c) for c in profile], ca.fabs(t))
    return ca.copysign(1, polynomial(profile, t) + rounding)


def consecutive(sizes: Iterable[int]) -> list[slice]:
    """The slices of parts of these sizes that follow each other."""
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(a, b) for a, b in zip(ends, ends[1:])]


def _chart_state(bodies: Sequence[Surface], start: Start, sigma: float) -> list[float]:
    """u, v, u', v' on finger and object, and psi, of a contact that starts."""
    x = list[float]()
    places = start.finger_at, start.object_at
    for body, at, w in zip(bodies, places, (start.finger_velocity, start.object_velocity)):
        x += [*at, *np.linalg.solve(body.metric_root(*at), sigma * np.array(w))]
    return [*x, start.angle]


def _frames(bodies: Sequence[Surface], start: Any, spaces: Sequence[bool]) -> list[float]:
    """The moving frames of finger and object, x, p or u, v, theta, of a contact that starts."""
    x = list[float]()
    known = (start.finger_frame, start.object_frame) if isinstance(start, Moment) else ((), ())
    turns = -start.angle, 0.0  # psi = -theta_1 - theta_2
    places = start.finger_at, start.object_at
    for body, at, frame, turn, space in zip(bodies, places, known, turns, spaces):
        if not space:
            x += [*at[:2], sum(at[2:], turn)]  # the place of a Moment is u, v, theta
            continue
        if frame:
            point, first = np.split(np.array(frame), 2)
            axes = np.stack([first, run_in_space(body, "second", np.vstack(frame))[:, 0]], axis=1)
        else:
            point, axes = body.point_and_frame(*at)
        x += [*point, *(axes[:, :2] @ [math.cos(turn), math.sin(turn)])]
    return x


# --- on the engine -------------------------------------------------------------------------------


@functools.lru_cache(maxsize=128)
def system_table(system: SceneSystem, *outputs: str) -> tuple[Table, list[int]]:
    """The engine's table (t, x, w, held | p) -> outputs, and the index at which each one ends."""
    with making_symbols():
        values = [ca.densify(system._expression(name)) for name in outputs]
        *point, p = system._symbols.values()
        flat = ca.Function("flat", [ca.vertcat(*point), p], [ca.vertcat(*values)])
    return Table(flat), np.cumsum([value.numel() for value in values]).tolist()


class SystemMachine(Machine):
    """A scene's system for integrators that evaluate it often; its `point` is t, x, w and held.

    `parts` are views of its `results`, one for each output.
    """

    def __init__(self, system: SceneSystem, *outputs: str):
        table, ends = system_table(system, *outputs)
        super().__init__(table, system.parameters)
        self.parts = np.split(self.results, ends[:-1])
