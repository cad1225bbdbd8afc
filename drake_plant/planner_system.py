"""The planner of a scene as a LeafSystem: contact_system's equations, integrated by Drake."""

from __future__ import annotations

import bisect
import functools
import math
from functools import partial, partialmethod
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression
from pydrake.systems.framework import BasicVector_, LeafSystem, LeafSystem_, SystemScalarConverter

from contact_system import Plan, Scene, SceneSystem
from contact_system.checks import Array, finite_number
from contact_system.errors import SceneError
from contact_system.planning.starts import on_branch

from .config import CHECK_PERIOD
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plan_check import (
    CLEARANCE,
    COMPARISONS,
    TOLERANCE,
    exact_plan,
    refuse,
    refuse_drift,
    refuse_singularity,
)
from .planner_base import EARLY, FOREVER, PORTS, PlannerBase, scene_system
from .scalars import evaluate_derivatives, evaluate_symbols, select
from .tables import Scratch, per_thread

NEARBY = 10 * CLEARANCE
"""The end of a step is examined if its last derivatives were nearer than this to a singularity."""
SINCE, BEGAN, DUE, HEADER = range(4)  # places in `ContactPlanner._followed`
RESTING = 1e-3
"""A contact up to this part of its greatest sigma counts as at rest."""


class _Planner(PlannerBase):
    """States and events of a planner, for any scalar T. `_convert` converts it to other scalars:
    pydrake's TemplateSystem demands that all constructors take the same arguments."""

    __slots__ = NO_DICTIONARY

    _held: Any = None  # None: this planner has no such state or port
    _disturbance: Any = None

    def _Declare(self, system: SceneSystem, period: float | None) -> None:
        """Declare states, ports and events; period: of restarts, s."""
        n, self._period, self._fed_through = len(system.scene.contacts), period, {"derivatives"}
        self.DeclareContinuousState(BasicVector_[self.T](system.x0))
        if len(system.held0) and (system.corners or period is not None):
            self._held = self.DeclareDiscreteState(BasicVector_[self.T](system.held0))
        for edge in system.corners:
            self.DeclarePeriodicUnrestrictedUpdateEvent(FOREVER, edge, weakly(self._Turn, edge))
        if system.disturbance_input:
            self._disturbance = self.DeclareVectorInputPort("disturbance", 6 * n)
            self._fed_through |= {name for name in PORTS if "w" in system.depends(name)}
        if period is not None:
            self._measured = self.DeclareVectorInputPort("measured_state", 9 * n)
            self._restarts = self.DeclareDiscreteState(BasicVector_[self.T](np.zeros(n)))
            # A little early: in floating point 3 * 0.1 s is after 300 * 1 ms. A discrete plant
            # would have made its step by then, and its state would be ahead of the planner's.
            first, restart = period - EARLY, weakly(self._Restart)
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, first, restart)
        self._DeclareOutputs(system)
        if period is not None:
            self.DeclareStateOutputPort("restarts", self._restarts)

    def _Prerequisites(self, *outputs: str) -> set:
        found = {self.time_ticket(), self.all_state_ticket()}
        if not self._fed_through.isdisjoint(outputs):
            found.add(self.input_port_ticket(self._disturbance.get_index()))
        return found

    def _Restart(self, context: Any, state: Any) -> None:
        raise TypeError("a ContactPlanner restarts with T = float only: simulate that one")

    def _Turn(self, edge: float, context: Any, state: Any) -> None:
        """At a corner contacts turn to their next legs; at a rest their slip is dropped."""
        x, held = self._StateAndHeld(context)
        x, held = self.system.turned(edge, x, held, self._Parts(context, "carried")[0])
        state.get_mutable_continuous_state().SetFromVector(x)
        if self._held is not None:
            state.get_mutable_discrete_state(self._held).SetFromVector(held)

    def _StateAndHeld(self, context: Any) -> tuple[Array, Array]:
        x, held = context.get_continuous_state_vector(), self.system.held0
        if self._held is not None:
            held = context.get_discrete_state(self._held).CopyToVector().ravel()
        return x.CopyToVector().ravel(), held

    def _Acting(self, context: Any, *outputs: str) -> list[Any]:
        """The disturbances that act now, from windows and the port, (n_w,).

        For outputs without feedthrough the port is not evaluated, as it may depend on them.
        """
        t, port = context.get_time(), self._disturbance
        w: list[Any] = [0.0] * self.system.n_w
        for d, rows in self.system.windows:
            acts = select(t >= d.start, 1.0, 0.0) - select(t >= d.stop, 1.0, 0.0)
            for k, value in enumerate(d.value, rows.start):
                w[k] += acts * value
        fed = port is not None and not self._fed_through.isdisjoint(outputs)
        if fed and port.HasValue(context):
            return [a + b for a, b in zip(w, port.Eval(context).ravel().tolist())]
        return w

    def _Converted(self, T: type) -> Any:
        made = _convert(T, self)
        made._HandlePostConstructionScalarConversion[self.T](self)
        return made

    ToAutoDiffXd = partialmethod(_Converted, AutoDiffXd)
    ToSymbolic = partialmethod(_Converted, Expression)


# --- floats ---------------------------------------------------------------------------------------


class ContactPlanner(_Planner, LeafSystem):
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
        - normal_rate
        - motion
        - pose
        - restarts (with restart_period or restart_distance)

    For n contacts, in SI units and radians; F_i is the frame of finger i, O of the object, each
    the frame of the body's surface:

    - `disturbance` (6n): acceleration of the finger, acceleration of the object, object rate
      offset, chart components, two numbers each; added to the scene's windows. Zero where the
      port is not connected. It disturbs a contact with imposed rolling like any other.
      Components are those of the coordinates that `state` starts with. On a triaxial ellipsoid
      a start outside the principal range is rewritten in it, and the scene's windows with it;
      numbers on the port are not.
    - `measured_state` (9n): as `state`, or in principal values: where a chart covers its
      surface twice, they are rewritten on the planner's branch, where disturbances are given.
    - `state` (9n): u1 v1 u1' v1' u2 v2 u2' v2' psi of each contact (eq. `contrac`), object rate
      offsets included. In frame coordinates angles are in the chart's principal range, and
      on a triaxial ellipsoid on either branch of the chart.
    - `slip` (2n): v_rel in E2 (eq. `netrelvel`). On the other branch E2 is turned by pi: in
      frame coordinates on a triaxial ellipsoid both components may have the opposite sign of
      those of :meth:`contact_system.Plan.slip`, as u2' v2' may.
    - `twist` (6n): V_OF_O, the finger's angular velocity and its origin's velocity in O.
    - `acceleration` (6n): the time derivative of the twist's components.
    - `contact_point` (6n): the contact on the finger, in F, and on the object, in O.
    - `normal` (3n): the object's outward unit normal at the contact, in O; `normal_rate` (3n) is
      its time derivative.
    - `pose`: list of RigidTransform X_OF.
    - `motion` (36n): all that a :class:`FingertipDriver` takes, contact by contact: X_OF, the
      rotation by columns (9) and the position (3), then twist, acceleration, contact points, normal
      and its rate.
    - `restarts` (n): how often each contact has been restarted.

    The continuous state is x of :class:`contact_system.SceneSystem`, and starts as the scene says.
    The scene's windows act by the time alone; at an edge what comes after it acts. Events just
    before each edge and at it keep integrators from stepping across one. In frame coordinates a
    discrete state has ``held`` if the planner restarts or contacts have legs; events at corners
    update it. A planner that restarts has another discrete state last, the count of restarts.

    In chart coordinates a simulation can start from states of
    :meth:`contact_system.SceneSystem.from_states`. In frame coordinates W_1 and V of contacts that
    nothing accelerates are not in the continuous state, but constants of the scene: a simulation
    must start where the scene does, unless the planner restarts and ``held`` is set as well.

    Every `restart_period` seconds the planner takes the measured state as its own. With a
    `restart_distance` it does so only for contacts that are further than this from their planned
    point on the object, and checks every `restart_period`, or 0.01 s. Contacts whose measured state
    is not finite, or that are almost at rest, so that rates have no direction, keep their plan.

    A planner may be shared by threads that have a Context each.

    AutoDiffXd and Expression are supported. ``FirstOrderTaylorApproximation`` linearizes a planner;
    ``Linearize`` does so only with ``equilibrium_check_tolerance=inf``, as contacts move. Both,
    and ``DiscreteTimeApproximation``, need a planner whose states are all continuous, without
    restarts and legs: for another one Drake ends the process.
    ``DirectCollocation`` evaluates systems at one fixed time, so it is right only where sigma is
    constant. In frame coordinates Drake takes hours to evaluate the symbolic acceleration,
    whose tree has 1e10 nodes; derivatives and other outputs take up to seconds.

    Parameters
    ----------
    scene : Scene
    coordinates : "chart" or "frame", optional
        Of the states, as ``help(contact_system.system)`` explains. Default: "chart", or "frame" if
        the scene has legs, sigma = 0 at some time, or a surface without a chart.
    disturbance_input : bool
    restart_period : float, optional
        s. With a discrete plant give a multiple of its time step, as its state between two steps
        is that of the next one already.
    restart_distance : float, optional
        m, 0 or more.
    tolerance : float
        How far contact points may be off the exact plan in a simulation, per metre of path and of
        the greater body's size; default 1.5e-6. While the disturbance port is not zero there is no
        plan to compare with, nor if a simulation begins at a rest or a pole other than the scene's
        start. After a disturbance the plan from the state that it left is compared.

    Raises
    ------
    SceneError
        Not a scene, or one that these coordinates cannot describe; a restart_period that is not
        above 0, a restart_distance < 0, a flag that is neither True nor False. In a simulation:
        sigma < 0, a derivative or output that is not finite, steps too long for the integrator.
    ChartSingularity
        In a simulation: a contact has come to a pole or an umbilic of its chart.
    """

    __slots__ = NO_DICTIONARY

    def __init__(
        self,
        scene: Scene,
        coordinates: str | None = None,
        *,
        disturbance_input: bool = False,
        restart_period: float | None = None,
        restart_distance: float | None = None,
        tolerance: float = TOLERANCE,
    ):
        LeafSystem.__init__(self, converter=_converter())
        system = scene_system(scene, coordinates, disturbance_input)
        self._tolerance = finite_number(tolerance, f"{scene.title}: tolerance", "above 0")
        self._distance, period = restart_distance, restart_period
        if period is not None:
            finite_number(period, f"{scene.title}: restart_period", "above 0")
        if restart_distance is not None:
            finite_number(restart_distance, f"{scene.title}: restart_distance", "not below 0")
            period = period or CHECK_PERIOD
        self._fastest = scene.speeds(np.linspace(0.0, scene.duration, 101)).max(axis=0)
        self._options = dict(
            coordinates=system.coordinates,
            disturbance_input=disturbance_input,
            restart_period=restart_period,
            restart_distance=restart_distance,
            tolerance=tolerance,
        )
        self._Declare(system, period)
        self._scratch = per_thread(partial(Scratch, system))
        self._exact = functools.lru_cache(maxsize=16)(partial(exact_plan, scene))
        size = HEADER + 9 * len(scene.contacts)
        _, self._followed = array_entry(self._CalcFollowed, (size,), {self.nothing_ticket()})
        self.DeclareInitializationPublishEvent(weakly(self._Begin))
        self.DeclarePerStepPublishEvent(weakly(self._Watch))

    def Evaluate(self, context: Any, *outputs: str) -> Array:
        found = super().Evaluate(context, *outputs)
        if not np.isfinite(found).all():
            refuse(self.system, *self._scratch().arguments)
        return found

    # --- what is refused at the end of a step -----------------------------------------------------

    def _Watch(self, context: Any) -> None:
        """Refuse singular points and drift, but only at ends of steps: trial steps, which error
        control may reject, may go anywhere. The end is examined for singular points if the last
        derivatives were computed near one.
        """
        scratch, t = self._scratch(), context.get_time()
        if not scratch.clearance[0] > NEARBY:
            if not self._Parts(context, "clearance")[0][0] > CLEARANCE:
                refuse_singularity(self.system, *scratch.arguments)
        followed, port = self._followed(context), self._disturbance
        if port is not None and port.HasValue(context):
            if port.Eval(context).any():
                followed[DUE] = math.inf
            elif followed[DUE] == math.inf:
                followed[[BEGAN, DUE]] = t
                self._Follow(context, self._Parts(context, "state")[0])
        if t < followed[DUE]:
            return
        followed[DUE] = t + min(t - followed[BEGAN], self.system.scene.duration / COMPARISONS)
        plan = self._Exact(context)
        if plan is not None:
            points = self._Parts(context, "contact_point")[0]
            refuse_drift(self.system.scene, plan, t, points, self._tolerance)

    def _CalcFollowed(self, context: Any) -> Array:
        """What contacts are compared with: since when they follow the present plan; when comparing
        began; when it is due next, inf before a simulation and while the port disturbs contacts;
        the state in which the plan starts, inf for that of the scene."""
        return np.full(HEADER + 9 * len(self.system.scene.contacts), math.inf)

    def _Begin(self, context: Any) -> None:
        """Start to compare contacts with the plan from the state that the Context has."""
        scratch, system = self._Load(context, ("derivatives",)), self.system
        t, scene = scratch.t[0], system.scene
        as_at_0 = (*scratch.x, *scratch.held) == (*system.x0, *system.held0)

        def in_state(time: float) -> Array:  # what a state contains of the scene at a time
            if system.coordinates == "chart":
                return scene.speeds(time)
            return np.hstack([system.leg_numbers(i, time) for i in range(len(scene.contacts))])

        if as_at_0 and (in_state(t) != in_state(0.0)).any():
            raise SceneError(
                f"{scene.title}: the simulation begins at t = {t:g} s with the state of t = 0 s: "
                "set the time to 0 (SetDefaultContext leaves it as it was), or the state of that "
                "time by SceneSystem.from_states, or use a PlanSource"
            )
        self._followed(context)[[BEGAN, DUE]] = t
        state = math.inf if t == 0.0 and as_at_0 else self._Parts(context, "state")[0]
        self._Follow(context, state)

    def _Follow(self, context: Any, state: Array | float) -> None:
        """Compare from now on with the plan from this state, or, if inf, with that of the scene."""
        followed = self._followed(context)
        followed[SINCE], followed[HEADER:] = context.get_time(), state

    def _Exact(self, context: Any) -> Plan | None:
        """The plan that contacts follow; None while there is none, or where it does not exist."""
        followed, t = self._followed(context), context.get_time()
        if followed[DUE] == math.inf:
            return None
        state = b"" if followed[HEADER] == math.inf else followed[HEADER:].tobytes()
        plan = self._exact(float(followed[SINCE]), state, max(t, self.system.scene.duration))
        return plan if plan is not None and plan.start <= t <= plan.end else None

    # --- what Drake calls ----------------------------------------------------------------------

    def _Load(self, context: Any, outputs: tuple[str, ...]) -> Scratch:
        scratch = self._scratch()
        time, x = scratch.written
        time[0] = t = context.get_time()
        x[:] = context.get_continuous_state_vector().value()
        after, before = scratch.w_valid
        if after <= t < before:
            return scratch
        scratch.w[:] = self._Acting(context, *outputs)
        if self._held is not None:
            scratch.held[:] = context.get_discrete_state(self._held).value()
        if self._held is self._disturbance is None:
            edges = (-math.inf, *self.system.edges, math.inf)
            k = bisect.bisect_right(edges, t)
            scratch.w_valid = edges[k - 1], edges[k]
        return scratch

    def _Parts(self, context: Any, *outputs: str) -> list[Array]:
        return self._Load(context, outputs).evaluate(*outputs)

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        run, guard, rate = self._Load(context, ("derivatives",)).rates
        run()
        if not guard[0] > 0.0:
            refuse(self.system, *self._scratch().arguments)
        derivatives.SetFromVector(rate)

    def _Restart(self, context: Any, state: Any) -> None:
        """Take over the measured states of the contacts that are to restart."""
        system, limit, t = self.system, self._distance, context.get_time()
        rows = self._measured.Eval(context).reshape(-1, 9)
        moves = system.scene.speeds(t) > RESTING * self._fastest
        chosen = np.isfinite(rows).all(axis=1) & moves
        planned, scratch = self._Parts(context, "state")[0].reshape(-1, 9), self._scratch()
        rows = on_branch(system.scene, np.where(chosen[:, None], rows, planned), planned)
        x, held = system.from_states(t, rows, scratch.w, chosen)
        if limit is not None:
            there = system.evaluate("contact_point", t, x, scratch.w, held)
            apart = there - self._Parts(context, "contact_point")[0]
            chosen &= np.linalg.norm(apart.reshape(-1, 6)[:, 3:], axis=1) > limit
        if not chosen.any():
            return
        # Contacts that do not restart go on to be compared with the plan that they follow now.
        plan = None if chosen.all() else self._Exact(context)
        for i in np.flatnonzero(chosen):
            states, kept = system.state_slices[i], system.held_slices[i]
            scratch.x[states], scratch.held[kept] = x[states], held[kept]
        follow = scratch.evaluate("state")[0].reshape(-1, 9)
        if plan is not None:
            follow[~chosen] = plan.states(t)[0][~chosen]
        self._Follow(context, follow.ravel())
        state.get_mutable_continuous_state().SetFromVector(scratch.x)
        restarts = state.get_mutable_discrete_state(self._restarts)
        restarts.SetFromVector(restarts.value() + chosen)
        if self._held is not None:
            state.get_mutable_discrete_state(self._held).SetFromVector(scratch.held)


# --- other scalars --------------------------------------------------------------------------------


@functools.cache
def _scalar_planner(T: type) -> type:
    """The class of planners for T, AutoDiffXd or Expression."""
    Base: Any = LeafSystem_[T]

    class ScalarPlanner(_Planner, Base):
        __slots__ = NO_DICTIONARY

        def __init__(self, other: _Planner):
            Base.__init__(self, converter=_converter())
            self.T, self._options, system = T, other._options, other.system
            self._Declare(system, other._period)

        def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
            derivatives.SetFromVector(self._Parts(context, "derivatives")[0])

        def _Parts(self, context: Any, *outputs: str) -> list[Array]:
            system, (x, held) = self.system, self._StateAndHeld(context)
            w = self._Acting(context, *outputs)
            arguments = [[context.get_time()], x, w, held, system.parameters]
            if T is Expression:
                return [evaluate_symbols(system.function(name), arguments) for name in outputs]
            return [evaluate_derivatives(system.jacobian(name), arguments) for name in outputs]

    ScalarPlanner.__name__ = ScalarPlanner.__qualname__ = f"ContactPlanner_[{T.__name__}]"
    return ScalarPlanner


def _convert(T: type, other: _Planner) -> _Planner:
    if T is float:
        made: Any = ContactPlanner(other.system.scene, **other._options)
    else:
        made = _scalar_planner(T)(other)
    made.set_name(other.get_name())
    return made


@functools.cache
def _converter() -> SystemScalarConverter:
    converter = SystemScalarConverter()
    for T, U in SystemScalarConverter.SupportedConversionPairs:
        converter._AddConstructor[T, U](partial(_convert, T))
    return converter
