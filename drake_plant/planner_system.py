"""The planner of a scene as a LeafSystem: contact_system's equations, integrated by Drake."""

from __future__ import annotations

import bisect
import functools
import math
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform_, RotationMatrix_
from pydrake.systems.framework import BasicVector_, LeafSystem_, ValueProducer
from pydrake.systems.scalar_conversion import TemplateSystem

from contact_system import Scene, SceneSystem
from contact_system.checks import finite_number, flag
from contact_system.errors import ChartSingularity, SceneError
from contact_system.scene import DISTURBANCE_KINDS, refuse_rest
from contact_system.starts import on_branch

from .invariants import (
    MOST,
    Limits,
    has_invariants,
    no_limits,
    pushes,
    refuse_pace,
    stands,
    stiffness,
)
from .lifetimes import NO_DICTIONARY, weakly
from .scalars import evaluate_scalars, select
from .scratch import Scratch, Scratches

CLEARANCE = 0.01
"""Distance from a chart's singularity, as a fraction of the body's size, that is refused."""
NEARBY = 10 * CLEARANCE
"""Where the distance is watched more closely."""
LOOK = 0.01
"""How often the distance from the plan is looked at where no period is given, s."""
EARLY = 1e-9
"""How much before its time a restart happens, s."""
OTHERS = 257
"""Every so many steps limits are taken from the Context, as another simulation may have had its
turn in this thread; odd, so that each of two comes to it."""
ONCE = 1e9
"""Period of an event that happens once, s."""
PORTS = {"state": 9, "slip": 2, "twist": 6, "acceleration": 6, "contact_point": 6, "normal": 3}

Array = np.ndarray

# What is derived from a scene is large: planners of the same one share it.
_shared_system = functools.lru_cache(maxsize=16)(SceneSystem)


def _scene_system(*options: Any) -> SceneSystem:
    try:
        hash(options)
    except TypeError:  # a list in the place of a scene or a word: it says which
        return SceneSystem(*options)
    return _shared_system(*options)


# --- refusals -------------------------------------------------------------------------------------


def _refuse_singularity(system: SceneSystem, t: Array, x: Array, w: Array, held: Array) -> None:
    """The error of the contact that is nearest to a singular point of its chart."""
    scene, time = system.scene, float(t[0])
    values = system.evaluate("regularity", time, x, w, held).reshape(-1, 2)
    i, side = divmod(int(np.argmin(values)), 2)
    surface = scene.object if side else scene.contacts[i].finger
    where = surface.chart.singular_at or "pole"
    remedy = 'use ContactPlanner(scene, coordinates="frame"), which has no such points'
    remedy += ", or smaller steps if the motion does not lead there"
    if system.coordinates == "frame":
        remedy = "move the contact away from that point, or turn the body's axes"
    raise ChartSingularity(
        f"{scene.title}, contact {i}, {('finger', 'object')[side]}: at t = {time:.6g} s the "
        f"contact is {values[i, side]:.2g} of the body's size from a singular point of the chart "
        f"of {surface!r} ({where}): less than {CLEARANCE:g}, or beyond it; {remedy}"
    )


def _refuse(system: SceneSystem, t: Array, x: Array, w: Array, held: Array) -> None:
    """The error of numbers that must not be integrated."""
    scene, time = system.scene, float(t[0])
    sigma = scene.profile(time)
    if sigma < 0:
        raise SceneError(
            f"{scene.title}: sigma = {sigma:.6g} m/s at t = {time:.6g} s is negative; the "
            f"scene runs from 0 to {scene.duration:g} s: simulate no further, or change the profile"
        )
    for i, part in enumerate(system.state_slices):
        for name, value in (("state", x[part]), ("disturbance", w[6 * i : 6 * i + 6])):
            if not np.isfinite(value).all():
                raise SceneError(
                    f"{scene.title}, contact {i}: the {name} at t = {time:.6g} s is "
                    f"{value.tolist()}; it must be finite. Check what sets it"
                )
    for i in range(len(w) // 6):
        if w[6 * i : 6 * i + 4].any():
            refuse_rest(scene, i, time, time)
    if not system.evaluate("clearance", time, x, w, held)[0] > CLEARANCE:
        _refuse_singularity(system, t, x, w, held)
    rates = system.evaluate("derivatives", time, x, w, held)
    worst = [float(np.abs(rates[part]).max()) for part in system.state_slices]
    i = int(np.argmax(worst))  # of NaNs the first
    raise ChartSingularity(
        f"{scene.title}, contact {i}: at t = {time:.6g} s (sigma = {sigma:.6g} m/s) "
        f"derivatives are as large as {worst[i]:.3g}: the contact is at a pole, an acceleration "
        "acts while sigma = 0, or the steps are too long for the integrator. Move the contact, "
        "raise sigma, or take smaller steps"
    )


def _check_restart(scene: Scene, period: Any, distance: Any) -> None:
    least, what = max(EARLY, scene.duration / MOST), f"{scene.title}: restart_"
    if period is not None and finite_number(period, f"{what}period", "above 0") < least:
        raise SceneError(
            f"{what}period = {period!r}: give a time in s, at least {least:.2g} s, with which the "
            "scene's end is reached, or None"
        )
    if distance is not None:
        finite_number(distance, f"{what}distance", "not below 0")


# --- the system -----------------------------------------------------------------------------------


def _define(T: type) -> type:
    Base: Any = LeafSystem_[T]

    class ContactPlanner(Base):
        """Plans how contacts of a scene move, by the equations of contact_system.

        .. pydrake_system::

            name: ContactPlanner
            input_ports:
            - disturbance (with disturbance_input)
            - measured_state (with restart_period or restart_distance)
            output_ports:
            - state
            - slip
            - twist
            - acceleration
            - contact_point
            - normal
            - pose
            - restarts (with restart_period or restart_distance)

        For n contacts, in SI units and radians; F_i is the frame of finger i, O of the object, each
        the frame of the body's surface:

        - `disturbance` (6n): acceleration of the finger, acceleration of the object, object rate
          offset, chart components, two numbers each; added to the scene's windows. Zero where the
          port is not connected. A contact whose rolling is imposed is disturbed as a planned one.
          Components are those of the coordinates that `state` starts with: a place on a triaxial
          ellipsoid that a scene gives outside the principal range is written the other way, and
          its windows with it, but not what is on the port.
        - `measured_state` (9n): as `state`, or in principal values: where a chart covers its
          surface twice, they are turned to the planner's side, so that disturbances act as before.
        - `state` (9n): u1 v1 u1' v1' u2 v2 u2' v2' psi of each contact (eq. `contrac`), object rate
          offsets included. In frame coordinates angles are those of the chart's principal range,
          and on a triaxial ellipsoid either of the two ways to write a point.
        - `slip` (2n): v_rel in E2 (eq. `netrelvel`). With the other way to write a point E2 is
          turned by half a turn: in frame coordinates on a triaxial ellipsoid both components may
          have the other sign than in :meth:`contact_system.Plan.slip`, as u2' v2' may.
        - `twist` (6n): V_OF_O, the finger's angular velocity and its origin's velocity in O.
        - `acceleration` (6n): the time derivative of the twist's components.
        - `contact_point` (6n): the contact on the finger, in F, and on the object, in O.
        - `normal` (3n): the object's outward unit normal at the contact, in O.
        - `pose`: list of RigidTransform X_OF.
        - `restarts` (n): how often each contact's plan began anew.

        The continuous state is that of :class:`contact_system.SceneSystem`: u1 v1 u1' v1' u2 v2 u2'
        v2' psi a contact for ``coordinates="chart"``; moving frames without poles and, but for
        accelerated contacts, without the stiffness of lam for ``coordinates="frame"``. It starts as
        the scene says. What the scene's windows add follows from the time; where there are any, a
        discrete state (1) holds when an edge was last passed, so that at an edge itself it is known
        which side acts; events at the edges set it, and no integrator steps across one. Where the
        planner restarts and coordinates are frames, another one holds W_1, V and its time. The last
        one of a planner that restarts counts the restarts.

        States of :meth:`contact_system.SceneSystem.from_states` can be started from in chart
        coordinates. In frame coordinates W_1 and V of contacts that nothing accelerates are no
        states: the scene's own are used, so that a simulation must start where the scene does,
        unless the planner restarts and that discrete state is set to ``held`` as well.

        The planner takes the measured state as its own every `restart_period` seconds; with a
        `restart_distance` that of contacts which are further from the planned point on the object,
        looked at every `restart_period` or 0.01 s. Contacts whose measured state is not finite keep
        their plan. `restarts` tells what follows the plan to take no difference across a restart.

        A planner may be shared by threads that have a Context each.

        AutoDiffXd and Expression are supported. ``Linearize`` and ``DiscreteTimeApproximation``
        need a planner without discrete state: of a scene without windows,
        ``scene.replace(disturbances=[])``, and without restarts; for others Drake ends the process.
        ``DirectCollocation`` evaluates systems at one time, and so is right only where sigma is
        constant. In frame coordinates Drake takes hours to evaluate the symbolic acceleration,
        whose tree has 1e10 nodes; derivatives and the rest take up to seconds.

        Parameters
        ----------
        scene : Scene
        coordinates : "chart" or "frame"
        disturbance_input : bool
        restart_period : float, optional
            s, at least 5e-8 of the scene's duration and 1e-9 s. A discrete plant's state between
            two steps is that of the next one: with one, give a multiple of its time step.
        restart_distance : float, optional
            m, 0 or more.
        compiled : bool, optional
            Accepted and ignored: nothing is compiled when it runs.

        Raises
        ------
        SceneError
            No scene, or one that cannot be written in these coordinates; a restart_period that is
            too short, a restart_distance < 0, a flag that is neither True nor False; in a
            simulation: sigma < 0, a derivative or output that is not finite, steps that are too
            long for the integrator.
        ChartSingularity
            In a simulation: a contact has come to a pole or an umbilic of its chart.
        """

        __slots__ = NO_DICTIONARY

        def _construct(
            self,
            scene: Scene,
            coordinates: str = "chart",
            *,
            disturbance_input: bool = False,
            restart_period: float | None = None,
            restart_distance: float | None = None,
            compiled: bool | None = None,
            converter: Any = None,
        ) -> None:
            Base.__init__(self, converter=converter)
            flag(compiled, "compiled", none=True)
            self._options = dict(
                coordinates=coordinates,
                disturbance_input=disturbance_input,
                restart_period=restart_period,
                restart_distance=restart_distance,
            )
            self.system = system = _scene_system(scene, coordinates, disturbance_input)
            _check_restart(scene, restart_period, restart_distance)
            self._distance = restart_distance
            n = len(scene.contacts)
            self.DeclareContinuousState(_vector(system.x0, T))
            self._window: Any = None
            self._held: Any = None
            self._disturbance: Any = None
            self._measured: Any = None
            self._restarts: Any = None
            self._fed_through = {"derivatives"}
            if system.edges:
                self._window = self.DeclareDiscreteState(_vector(np.zeros(1), T))
                self._DeclareEdges()
            if disturbance_input:
                self._disturbance = self.DeclareVectorInputPort("disturbance", 6 * n)
            if restart_period is not None or restart_distance is not None:
                self._DeclareRestart(n, restart_period)
            self._DeclareOutputs(n)
            if T is float:
                self._scratches = Scratches(system, {})
                self._DeclareWatch()

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            ContactPlanner._construct(
                self, other.system.scene, converter=converter, **other._options
            )

        # --- declarations ----------------------------------------------------------------------

        def _DeclareEdges(self) -> None:
            self.DeclareInitializationUnrestrictedUpdateEvent(weakly(self._SetWindow))
            for edge in self.system.edges:
                self.DeclarePeriodicUnrestrictedUpdateEvent(ONCE, edge, weakly(self._SetWindow))

        def _DeclareRestart(self, n: int, period: float | None) -> None:
            self._measured = self.DeclareVectorInputPort("measured_state", 9 * n)
            if len(self.system.held0):
                self._held = self.DeclareDiscreteState(_vector(self.system.held0, T))
            self._restarts = self.DeclareDiscreteState(_vector(np.zeros(n), T))
            self.DeclareStateOutputPort("restarts", self._restarts)
            period = LOOK if period is None else period
            # A little early: 3 * 0.1 s comes after 300 * 1 ms in floating point, and a discrete
            # plant that has stepped already would be measured a step ahead of the planner.
            first = period - EARLY
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, first, weakly(self._Restart))

        def _DeclareOutputs(self, n: int) -> None:
            for name, size in PORTS.items():
                calc = weakly(self._CalcVector, name)
                self.DeclareVectorOutputPort(name, size * n, calc, self._Prerequisites(name))
            kind, calc = Value[list[RigidTransform_[T]]], weakly(self._CalcPose)
            self.DeclareAbstractOutputPort("pose", kind, calc, self._Prerequisites("pose"))

        def _Prerequisites(self, output: str) -> set:
            """What an output depends on, from the sparsity of its function."""
            inputs = self.system.depends(output)
            if "w" in inputs:
                self._fed_through.add(output)
            tickets = {"t": self.time_ticket(), "x": self.xc_ticket(), "w": self.time_ticket()}
            found = {ticket for name, ticket in tickets.items() if name in inputs}
            for name, group in (("w", self._window), ("held", self._held)):
                if name in inputs and group is not None:
                    found.add(self.discrete_state_ticket(group))
            if "w" in inputs and self._disturbance is not None:
                found.add(self.input_port_ticket(self._disturbance.get_index()))
            return found or {self.nothing_ticket()}

        # --- what disturbs, for every scalar ---------------------------------------------------

        def _Windows(self, context: Any) -> Array:
            """What the windows add: (n_w,).

            At an edge itself the discrete state says whether it has been passed: a step that ends
            there is still under what acted before.
            """
            w = _scalars(np.zeros(self.system.n_w), T)
            if self._window is None:
                return w
            t = context.get_time()
            passed = context.get_discrete_state(self._window).GetAtIndex(0)

            def is_past(edge: float) -> Any:
                decided = select(passed >= edge, 1.0, 0.0)
                return select(t > edge, 1.0, select(t == edge, decided, 0.0))

            for d, rows in self.system.windows:
                acts = is_past(d.start) - is_past(d.stop)
                for k, value in enumerate(d.value, rows.start):
                    w[k] += acts * value
            return w

        def _Disturbance(self, context: Any, output: str) -> Array | None:
            """What the disturbance port adds, (n_w,), or None.

            An output without feedthrough does not ask the port, which may depend on it.
            """
            port = self._disturbance
            if port is None or output not in self._fed_through or not port.HasValue(context):
                return None
            return port.Eval(context).ravel()

        # --- floats ----------------------------------------------------------------------------

        def _DeclareWatch(self) -> None:
            """Refuse a step that ends near a singular point, too fast, or with too much slip.

            Not in the derivatives, because a trial step that error control takes back may go there;
            but the last of them tells whether the end of the step is worth a look. Steps that are
            long for the gain always are: they may multiply slip by a thousand.
            """
            system, scratches = self.system, self._scratches
            clears, paced = "x" in system.depends("clearance"), has_invariants(system)
            look, check, lam = weakly(self._CheckClearance), weakly(self._CheckPace), 0.0
            crawls, watched = weakly(self._RefuseCrawl), paced or system.disturbance_input
            if paced:
                self._KeepLimitsInContext()
                lam = stiffness(system)

            def watch(context: Any) -> None:
                own = scratches.own
                if clears and not own.clearance[0] > NEARBY:
                    look(context)
                if not watched:
                    return
                t, steps = context.get_time(), own.steps
                if paced:
                    long = not 0.0 < (t - steps.last) * lam <= 1.0
                    if long or steps.count % OTHERS == 0 or not own.excess[0] <= 0.0:
                        check(context)
                wrong = steps.step(t)
                if wrong:
                    crawls(context, wrong)

            if clears or watched:
                self.DeclarePerStepPublishEvent(watch)

        def _KeepLimitsInContext(self) -> None:
            # Numbers, 0 until they are kept: Drake copies Contexts without Python's lock when it
            # evaluates batches, and a Python object in one would end the process.
            start = BasicVector_[float](np.zeros(1 + 4 * len(self.system.scene.contacts)))
            producer = ValueProducer(lambda: AbstractValue.Make(start), lambda _, value: None)
            entry = self.DeclareCacheEntry("limits", producer, {self.nothing_ticket()})
            self._kept_limits, self._pushes = entry.cache_index(), pushes(self.system)
            self.DeclareInitializationPublishEvent(weakly(self._SetLimits))

        def _CheckClearance(self, context: Any) -> None:
            if not self._Numbers(context, "clearance")[0] > CLEARANCE:
                _refuse_singularity(self.system, *self._scratches.own.given)

        def _RefuseCrawl(self, context: Any, wrong: str) -> None:
            remedy = "use a smaller eta, or fixed steps of an implicit scheme"
            if self.system.coordinates == "chart":
                remedy += ', or ContactPlanner(scene, coordinates="frame"), which is less stiff'
            added = self._Disturbance(context, "derivatives")
            if added is not None:
                k = int(np.argmax(np.abs(added)))
                remedy += (
                    f", or less on the input port 'disturbance', whose element {k} (contact "
                    f"{k // 6}, {DISTURBANCE_KINDS[k % 6 // 2].kind}) is {added[k]:.6g}"
                )
            raise SceneError(wrong + remedy)

        def _Kept(self, context: Any) -> Limits | None:
            """The limits of the simulation that a Context belongs to, if it was initialized."""
            kept, *numbers = self.get_cache_entry(self._kept_limits).Eval(context).value()
            if not kept:
                return None
            rows = np.reshape(numbers, (4, -1))
            return Limits(rows[0], rows[1], rows[2:].T, self._pushes)

        def _Keep(self, context: Any, limits: Limits) -> None:
            rows = np.vstack([limits.speed, limits.slip, limits.stretch.T])
            kept = self.get_cache_entry(self._kept_limits).Eval(context)
            kept.SetFromVector([1.0, *rows.ravel()])
            self._scratches.own.limits[:] = limits.near()

        def _SetLimits(self, context: Any) -> None:
            self._Load(context)
            self._KeepLimits(context)

        def _KeepLimits(self, context: Any) -> None:
            """From now on speed and slip are compared with those of what is loaded."""
            own = self._scratches.own
            own.run_pace()
            speed, slip, stretch = own.paces
            self._Keep(context, Limits(speed, slip, stretch.reshape(-1, 2), self._pushes))

        def _CheckPace(self, context: Any) -> None:
            kept, own = self._Kept(context), self._scratches.own
            if kept is None:  # nobody has initialized this one
                own.limits[:] = no_limits(self.system)
                return
            self._Load(context)
            if not np.isfinite(own.x).all():
                _refuse(self.system, *own.given)
            own.run_pace()
            speed, slip, stretch = own.paces
            limits, t = kept.widened(stretch.reshape(-1, 2)), context.get_time()
            if limits.unknown and not stands(self.system.scene, t):
                limits = limits.begun(speed, slip)
            self._Keep(context, limits)
            refuse_pace(self.system, t, limits, speed, slip)

        def _Load(self, context: Any, output: str = "derivatives") -> None:
            own = self._scratches.own
            own.t[0] = t = context.get_time()
            own.x[:] = context.get_continuous_state().CopyToVector()
            after, before = own.same
            if not after < t < before:
                self._LoadRest(context, own, t, output)

        def _LoadRest(self, context: Any, own: Scratch, t: float, output: str) -> None:
            """What the windows and the disturbance port add at t, and held numbers."""
            added = self._Disturbance(context, output)
            own.w[:] = self._Windows(context)
            if added is not None:
                own.w += added
            if self._held is not None:
                own.held[:] = context.get_discrete_state(self._held).value()
            if self._held is self._disturbance is None:
                edges = (-math.inf, *self.system.edges, math.inf)
                k = bisect.bisect_left(edges, t)
                own.same = (t, t) if t in edges else (edges[k - 1], edges[k])

        def _Numbers(self, context: Any, output: str) -> Array:
            self._Load(context, output)
            return self._scratches.own.evaluate(output)

        # --- other scalars ---------------------------------------------------------------------

        def _Scalars(self, context: Any, output: str) -> Array:
            system, w, held = self.system, self._Windows(context), self.system.held0
            added = self._Disturbance(context, output)
            if added is not None:
                w = np.array([a + b for a, b in zip(w, added)])  # numpy warns of branches
            if self._held is not None:
                held = context.get_discrete_state(self._held).CopyToVector().ravel()
            x = context.get_continuous_state_vector().CopyToVector().ravel()
            arguments = [[context.get_time()], x, w, held, system.parameters]
            return evaluate_scalars(system.function(output), arguments, T)

        # --- what Drake calls ------------------------------------------------------------------

        def _CalcRates(self, context: Any, derivatives: Any) -> None:
            own = self._scratches.own
            time, x, run, guard, rate = own.hot  # the lines of _Load: a call takes 0.2 us
            time[0] = t = context.get_time()
            x[:] = context.get_continuous_state().CopyToVector()
            after, before = own.same
            if not after < t < before:
                self._LoadRest(context, own, t, "derivatives")
            run()
            if not guard[0] > 0.0:
                _refuse(self.system, *own.given)
            derivatives.SetFromVector(rate)

        def _CalcScalarRates(self, context: Any, derivatives: Any) -> None:
            derivatives.SetFromVector(self._Scalars(context, "derivatives"))

        DoCalcTimeDerivatives = _CalcRates if T is float else _CalcScalarRates

        def _CalcVector(self, output: str, context: Any, vector: Any) -> None:
            vector.SetFromVector(self._Evaluate(context, output))

        def _CalcPose(self, context: Any, value: Any) -> None:
            rows = self._Evaluate(context, "pose").reshape(-1, 12)
            value.set_value(
                [
                    RigidTransform_[T](RotationMatrix_[T](row[:9].reshape(3, 3).T), row[9:])
                    for row in rows
                ]
            )

        def _Finite(self, context: Any, output: str) -> Array:
            values = self._Numbers(context, output)
            if not math.isfinite(values.sum()):
                _refuse(self.system, *self._scratches.own.given)
            return values

        _Evaluate = _Finite if T is float else _Scalars

        def _SetWindow(self, context: Any, state: Any) -> None:
            state.get_mutable_discrete_state(self._window).SetAtIndex(0, context.get_time())

        def _Restart(self, context: Any, state: Any) -> None:
            """Take over the measured state of the contacts that ask for it."""
            if T is not float:
                raise TypeError("ContactPlanner restarts with T = float only; simulate that one")
            system, limit = self.system, self._distance
            rows = self._measured.Eval(context).reshape(-1, 9)
            chosen = np.isfinite(rows).all(axis=1)
            if not chosen.any():
                return
            planned, own = self._Numbers(context, "state").reshape(-1, 9), self._scratches.own
            rows = on_branch(system.scene, np.where(chosen[:, None], rows, planned), planned)
            x, held = system.from_states(context.get_time(), rows, own.w)
            if limit is not None:
                now = context.get_time(), x, own.w, held
                there = system.evaluate("contact_point", *now)
                apart = there - self._Numbers(context, "contact_point")
                chosen &= np.linalg.norm(apart.reshape(-1, 6)[:, 3:], axis=1) > limit
            for i in np.flatnonzero(chosen):
                states, kept = system.state_slices[i], system.held_slices[i]
                own.x[states], own.held[kept] = x[states], held[kept]
            if has_invariants(system):
                self._KeepLimits(context)  # what is loaded is the state that is set
            state.get_mutable_continuous_state().SetFromVector(own.x)
            restarts = state.get_mutable_discrete_state(self._restarts)
            restarts.SetFromVector(restarts.value() + chosen)
            if self._held is not None:
                state.get_mutable_discrete_state(self._held).SetFromVector(own.held)

    return ContactPlanner


def _scalars(values: Array, T: type) -> Array:
    return values if T is float else np.array([T(v) for v in values], dtype=object)


def _vector(values: Array, T: type) -> Any:
    return BasicVector_[T](_scalars(values, T))


@TemplateSystem.define("ContactPlanner_")
def ContactPlanner_(T):
    return _define(T)


ContactPlanner = ContactPlanner_[None]
