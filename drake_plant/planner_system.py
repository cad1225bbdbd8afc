"""The planner of a scene as a LeafSystem: contact_system's equations, integrated by Drake."""

from __future__ import annotations

import bisect
import functools
import math
from functools import partial
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression
from pydrake.systems.framework import LeafSystem, LeafSystem_, SystemScalarConverter

from contact_system import Plan, Scene
from contact_system.checks import Array, finite_number
from contact_system.errors import SceneError
from contact_system.planning.starts import on_branch

from .config import LOOK
from .lifetimes import NO_DICTIONARY, array_entry, weakly
from .plan_check import (
    CLEARANCE,
    LOOKS,
    TOLERANCE,
    exact_plan,
    refuse,
    refuse_drift,
    refuse_singularity,
)
from .planner_base import PlannerBase, scene_system
from .scalars import evaluate_scalars
from .scratch import PerThread, Scratch

NEARBY = 10 * CLEARANCE
"""Where the distance from a chart's singularity is watched more closely."""
AS_SCENE, AS_STATE, DISTURBED = 1.0, 2.0, 3.0
"""Contacts follow the scene's plan, that from a state, or what is on the disturbance port."""
RESTING = 1e-3
"""Of the greatest sigma, up to which a contact is at rest, or almost."""


class _Convertible(PlannerBase):
    """A planner with other scalars, as TemplateSystem has it for classes without a signature of
    their own."""

    __slots__ = NO_DICTIONARY

    def ToAutoDiffXd(self) -> Any:
        return self._Converted(AutoDiffXd)

    def ToSymbolic(self) -> Any:
        return self._Converted(Expression)

    def _Converted(self, T: type) -> Any:
        made = _convert(T, self)
        made._HandlePostConstructionScalarConversion[self.T](self)
        return made


# --- floats ---------------------------------------------------------------------------------------


class ContactPlanner(_Convertible, LeafSystem):
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
    - `normal` (3n): the object's outward unit normal at the contact, in O; `normal_rate` (3n) is
      its time derivative.
    - `pose`: list of RigidTransform X_OF.
    - `motion` (36n): all that a :class:`FingertipDriver` takes, contact by contact: X_OF, the
      rotation by columns (9) and the position (3), then twist, acceleration, contact points, normal
      and its rate.
    - `restarts` (n): how often each contact's plan began anew.

    The continuous state is x of :class:`contact_system.SceneSystem`, and starts as the scene says.
    What the scene's windows add follows from the time, at an edge what acts after it; events just
    before the edges and at them keep integrators from stepping across one. In frame coordinates a
    discrete state has ``held`` where the planner restarts or contacts have legs; events at corners
    turn it. The last one of a planner that restarts counts the restarts.

    States of :meth:`contact_system.SceneSystem.from_states` can be started from in chart
    coordinates. In frame coordinates W_1 and V of contacts that nothing accelerates are no
    states: the scene's own are used, so that a simulation must start where the scene does,
    unless the planner restarts and that discrete state is set to ``held`` as well.

    The planner takes the measured state as its own every `restart_period` seconds; with a
    `restart_distance` that of contacts which are further from the planned point on the object,
    looked at every `restart_period` or 0.01 s. Contacts whose measured state is not finite keep
    their plan; so do those almost at rest, whose rates have no direction.

    A planner may be shared by threads that have a Context each.

    AutoDiffXd and Expression are supported. ``FirstOrderTaylorApproximation`` linearizes a planner;
    ``Linearize`` takes contacts, which move, only with ``equilibrium_check_tolerance=inf``. They
    and ``DiscreteTimeApproximation`` need a planner without restarts, whose states are continuous
    alone; for others Drake ends the process.
    ``DirectCollocation`` evaluates systems at one time, and so is right only where sigma is
    constant. In frame coordinates Drake takes hours to evaluate the symbolic acceleration,
    whose tree has 1e10 nodes; derivatives and the rest take up to seconds.

    Parameters
    ----------
    scene : Scene
    coordinates : "chart" or "frame", optional
        Of the states, as ``help(contact_system.system)`` explains. By default charts, or frames
        where the scene has legs, sigma = 0 or a surface without a chart.
    disturbance_input : bool
    restart_period : float, optional
        s. A discrete plant's state between two steps is that of the next one:
        with one, give a multiple of its time step.
    restart_distance : float, optional
        m, 0 or more.
    tolerance : float
        In a simulation contact points may be so far off the exact plan, per metre of path and of
        the greater body's size; default 1.5e-6. No plan is known, and nothing compared, while the
        disturbance port is not zero, or where a simulation begins at a rest or a pole other than
        the scene's start; after a disturbance the plan is that from the state which it left.

    Raises
    ------
    SceneError
        No scene, or one that cannot be written in these coordinates; a restart_period that is
        not above 0, a restart_distance < 0, a flag that is neither True nor False; in a simulation:
        sigma < 0, a derivative or output that is not finite, steps that are too long for the
        integrator.
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
            period = period or LOOK
        self._fastest = scene.speeds(np.linspace(0.0, scene.duration, 101)).max(axis=0)
        self._options = dict(
            coordinates=system.coordinates,
            disturbance_input=disturbance_input,
            restart_period=restart_period,
            restart_distance=restart_distance,
            tolerance=tolerance,
        )
        self._Declare(system, system.x0, period)
        self._scratches = PerThread(partial(Scratch, system), {})
        self._exact = functools.lru_cache(maxsize=16)(partial(exact_plan, scene))
        size = 4 + 9 * len(scene.contacts)
        _, self._begun = array_entry(self._CalcBegun, (size,), {self.nothing_ticket()})
        self.DeclareInitializationPublishEvent(weakly(self._Begin))
        self.DeclarePerStepPublishEvent(weakly(self._Watch))

    def Evaluate(self, context: Any, *outputs: str) -> Array:
        found = super().Evaluate(context, *outputs)
        if not np.isfinite(found).all():
            refuse(self.system, *self._scratches.own.given)
        return found

    # --- what is refused at the end of a step -----------------------------------------------------

    def _Watch(self, context: Any) -> None:
        """Look at ends of steps alone: a trial step that error control takes back may go anywhere.

        The last derivatives of a step tell whether its end is near a singular point.
        """
        own, t = self._scratches.own, context.get_time()
        if not own.clearance[0] > NEARBY:
            if not self._Parts(context, "clearance")[0][0] > CLEARANCE:
                refuse_singularity(self.system, *own.given)
        begun, port = self._begun(context), self._disturbance
        if begun[0] and port is not None and port.HasValue(context):
            if port.Eval(context).any():
                begun[0] = DISTURBED
                return
            if begun[0] == DISTURBED:
                begun[2:4] = t
                self._Follow(context, self._Parts(context, "state")[0])
        if t < begun[3]:
            return
        begun[3] = t + min(t - begun[2], self.system.scene.duration / LOOKS)
        plan = self._Exact(context)
        if plan is not None:
            points = self._Parts(context, "contact_point")[0]
            refuse_drift(self.system.scene, plan, t, points, self._tolerance)

    def _CalcBegun(self, context: Any) -> Array:
        """What is followed, and from when on; when the simulation began, and when it is compared
        with the plan next; the state that it followed from. Zeros: no simulation has begun."""
        return np.zeros(4 + 9 * len(self.system.scene.contacts))

    def _Begin(self, context: Any) -> None:
        """From now on contacts are compared with the plan from the state that a Context has."""
        own, system = self._Load(context, ("derivatives",)), self.system
        t, scene = own.t[0], system.scene
        as_at_0 = (*own.x, *own.held) == (*system.x0, *system.held0)

        def made_for(time: float) -> Array:
            if system.coordinates == "chart":
                return scene.speeds(time)
            return np.hstack([system.leg_numbers(i, time) for i in range(len(scene.contacts))])

        if as_at_0 and (made_for(t) != made_for(0.0)).any():
            raise SceneError(
                f"{scene.title}: the simulation begins at t = {t:g} s with the state of t = 0 s: "
                "set the time to 0, which SetDefaultContext leaves alone, or the state of its "
                "start by SceneSystem.from_states, or give a PlanSource"
            )
        self._begun(context)[2:4] = t
        state = None if t == 0.0 and as_at_0 else self._Parts(context, "state")[0]
        self._Follow(context, state)

    def _Follow(self, context: Any, state: Array | None) -> None:
        """Compare from now on with the plan from this state, or with that of the scene."""
        begun = self._begun(context)
        begun[:2] = AS_SCENE if state is None else AS_STATE, context.get_time()
        if state is not None:
            begun[4:] = state

    def _Exact(self, context: Any) -> Plan | None:
        """The plan from where contacts began, where it is known now."""
        begun, t = self._begun(context), context.get_time()
        if begun[0] not in (AS_SCENE, AS_STATE):  # not initialized, or disturbed
            return None
        state = begun[4:].tobytes() if begun[0] == AS_STATE else b""
        plan = self._exact(float(begun[1]), state, max(t, self.system.scene.duration))
        return plan if plan is not None and plan.start <= t <= plan.end else None

    # --- what Drake calls ----------------------------------------------------------------------

    def _Load(self, context: Any, outputs: tuple[str, ...]) -> Scratch:
        own = self._scratches.own
        time, x = own.written
        time[0] = t = context.get_time()
        x[:] = context.get_continuous_state_vector().value()
        after, before = own.same
        if after < t < before:
            return own
        own.w[:] = self._Acting(context, *outputs)
        if self._held is not None:
            own.held[:] = context.get_discrete_state(self._held).value()
        if self._held is self._disturbance is None:
            edges = (-math.inf, *self.system.edges, math.inf)
            k = bisect.bisect_left(edges, t)
            own.same = (t, t) if t in edges else (edges[k - 1], edges[k])
        return own

    def _Parts(self, context: Any, *outputs: str) -> list[Array]:
        return self._Load(context, outputs).evaluate(*outputs)

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        run, guard, rate = self._Load(context, ("derivatives",)).rates
        run()
        if not guard[0] > 0.0:
            refuse(self.system, *self._scratches.own.given)
        derivatives.SetFromVector(rate)

    def _Restart(self, context: Any, state: Any) -> None:
        """Take over the measured state of the contacts that ask for it."""
        system, limit = self.system, self._distance
        rows = self._measured.Eval(context).reshape(-1, 9)
        moves = system.scene.speeds(context.get_time()) > RESTING * self._fastest
        chosen = np.isfinite(rows).all(axis=1) & moves
        if not chosen.any():
            return
        planned, own = self._Parts(context, "state")[0].reshape(-1, 9), self._scratches.own
        rows = on_branch(system.scene, np.where(chosen[:, None], rows, planned), planned)
        x, held = system.from_states(context.get_time(), rows, own.w, chosen)
        if limit is not None:
            now = context.get_time(), x, own.w, held
            there = system.evaluate("contact_point", *now)
            apart = there - self._Parts(context, "contact_point")[0]
            chosen &= np.linalg.norm(apart.reshape(-1, 6)[:, 3:], axis=1) > limit
        if not chosen.any():
            return
        # Drift of the others is still what they are off the plan that they began with.
        plan = None if chosen.all() else self._Exact(context)
        for i in np.flatnonzero(chosen):
            states, kept = system.state_slices[i], system.held_slices[i]
            own.x[states], own.held[kept] = x[states], held[kept]
        follow = own.evaluate("state")[0].reshape(-1, 9)
        if plan is not None:
            follow[~chosen] = plan.states(context.get_time())[0][~chosen]
        self._Follow(context, follow.ravel())
        state.get_mutable_continuous_state().SetFromVector(own.x)
        restarts = state.get_mutable_discrete_state(self._restarts)
        restarts.SetFromVector(restarts.value() + chosen)
        if self._held is not None:
            state.get_mutable_discrete_state(self._held).SetFromVector(own.held)


# --- other scalars --------------------------------------------------------------------------------


@functools.cache
def _scalar_planner(T: type) -> type:
    """The class of planners whose numbers are AutoDiffXd or Expression."""
    Base: Any = LeafSystem_[T]

    class ScalarPlanner(_Convertible, Base):
        __slots__ = NO_DICTIONARY

        def __init__(self, other: PlannerBase):
            Base.__init__(self, converter=_converter())
            self.T, self._options, system = T, other._options, other.system
            self._Declare(system, system.x0, other._period)

        def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
            derivatives.SetFromVector(self._Parts(context, "derivatives")[0])

        def _Parts(self, context: Any, *outputs: str) -> list[Array]:
            system, (x, held) = self.system, self._StateAndHeld(context)
            w = self._Acting(context, *outputs)
            arguments = [[context.get_time()], x, w, held, system.parameters]
            return [evaluate_scalars(system.function(name), arguments, T) for name in outputs]

    ScalarPlanner.__name__ = ScalarPlanner.__qualname__ = f"ContactPlanner_[{T.__name__}]"
    return ScalarPlanner


def _convert(T: type, other: PlannerBase) -> PlannerBase:
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
