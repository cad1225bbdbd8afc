"""The planner of a scene as a LeafSystem: contact_system's equations, integrated by Drake."""

from __future__ import annotations

import bisect
import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pydrake.math as drake_math
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform_, RotationMatrix_
from pydrake.symbolic import Expression, Formula, if_then_else
from pydrake.systems.framework import BasicVector_, LeafSystem_, ValueProducer
from pydrake.systems.scalar_conversion import TemplateSystem

from contact_system import Scene, SceneSystem
from contact_system.errors import ChartSingularity, ContactSystemError, SceneError
from contact_system.kernels import compiled_library, find_compiler, library_path, replay

from .invariants import (
    Limits,
    Progress,
    has_invariants,
    limits_of,
    no_limits,
    pace_function,
    refuse_pace,
    stiffness,
)
from .lifetimes import NO_DICTIONARY, weakly

CLEARANCE = 0.01
"""Distance from a chart's singularity, as a fraction of the body's size, that is refused."""
NEARBY = 10 * CLEARANCE
"""Where the distance is watched more closely."""
LOOK = 0.01
"""How often the measured slip is looked at where no period is given, s."""
EARLY = 1e-9
"""How much before its time a restart happens, s."""
ONCE = 1e9
"""Period of an event that happens once, s."""
PORTS = {"state": 9, "slip": 2, "twist": 6, "acceleration": 6, "contact_point": 6, "normal": 3}

Array = np.ndarray


# --- numbers: a CasADi function between fixed buffers ---------------------------------------------


class Machine:
    """A CasADi function that reads and writes the same arrays at every :attr:`run`.

    Parameters
    ----------
    function : casadi.Function
    arguments : arrays that it reads
    compiled : bool or None
        None: as compiled C where it can be built here, or was built before, else in CasADi's
        virtual machine; True: as compiled C, or an error; False: in the virtual machine.
    """

    def __init__(self, function: ca.Function, arguments: Sequence[Array], compiled: bool | None):
        function = _compiled(function, compiled)
        self._buffer, self.run = function.buffer()
        self.results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        for i, array in enumerate(arguments):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore
        for i, array in enumerate(self.results):
            self._buffer.set_res(i, memoryview(array))  # type: ignore


def _compiled(function: ca.Function, compiled: bool | None) -> ca.Function:
    if compiled is False or (compiled is None and find_compiler() is None):
        return function
    generator = ca.CodeGenerator(function.name())
    generator.add(function)
    source = generator.dump()
    try:
        compiled_library(source)
    except (ContactSystemError, OSError):  # a compiler without headers, a cache nobody may write
        if compiled:
            raise
        return function
    return _external(function.name(), str(library_path(source)))


_external = functools.lru_cache(maxsize=64)(ca.external)
# Python systems with ports are never freed (seen in Drake 1.51), so what is large is shared.
_scene_system = functools.lru_cache(maxsize=16)(SceneSystem)
_pace = functools.lru_cache(maxsize=16)(pace_function)


# --- Drake's other scalars: the same instructions, replayed ---------------------------------------


def _where(condition: Any, value: Any, otherwise: Any) -> Any:
    if isinstance(condition, Formula):
        return if_then_else(condition, Expression(0.0) + value, Expression(0.0) + otherwise)
    return value if condition else otherwise


def _power(base: Any, exponent: Any) -> Any:
    if isinstance(exponent, (float, Expression)):
        return drake_math.pow(base, exponent)
    return drake_math.exp(exponent * drake_math.log(base))


_OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_NEG: operator.neg,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: 2.0 * a,
    ca.OP_INV: lambda a: 1.0 / a,
    ca.OP_EXP: drake_math.exp,
    ca.OP_LOG: drake_math.log,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SQRT: drake_math.sqrt,
    ca.OP_SIN: drake_math.sin,
    ca.OP_COS: drake_math.cos,
    ca.OP_TAN: drake_math.tan,
    ca.OP_ASIN: drake_math.asin,
    ca.OP_ACOS: drake_math.acos,
    ca.OP_ATAN: drake_math.atan,
    ca.OP_ATAN2: drake_math.atan2,
    ca.OP_HYPOT: lambda a, b: drake_math.sqrt(a * a + b * b),
    ca.OP_SINH: drake_math.sinh,
    ca.OP_COSH: drake_math.cosh,
    ca.OP_TANH: drake_math.tanh,
    ca.OP_ASINH: lambda a: drake_math.log(a + drake_math.sqrt(a * a + 1.0)),
    ca.OP_ACOSH: lambda a: drake_math.log(a + drake_math.sqrt(a * a - 1.0)),
    ca.OP_ATANH: lambda a: 0.5 * drake_math.log((1.0 + a) / (1.0 - a)),
    ca.OP_LOG1P: lambda a: drake_math.log(1.0 + a),
    ca.OP_EXPM1: lambda a: drake_math.exp(a) - 1.0,
    ca.OP_FABS: drake_math.abs,
    ca.OP_FMIN: drake_math.min,
    ca.OP_FMAX: drake_math.max,
    ca.OP_COPYSIGN: lambda a, b: _where(b >= 0.0, drake_math.abs(a), -drake_math.abs(a)),
    ca.OP_SIGN: lambda a: _where(a > 0.0, 1.0, _where(a < 0.0, -1.0, 0.0)),
    ca.OP_FLOOR: drake_math.floor,
    ca.OP_CEIL: drake_math.ceil,
    # a condition is a number again, as it is for CasADi
    ca.OP_LT: lambda a, b: _where(a < b, 1.0, 0.0),
    ca.OP_LE: lambda a, b: _where(a <= b, 1.0, 0.0),
    ca.OP_EQ: lambda a, b: _where(a == b, 1.0, 0.0),
    ca.OP_NE: lambda a, b: _where(a != b, 1.0, 0.0),
    ca.OP_NOT: lambda a: _where(a == 0.0, 1.0, 0.0),
    ca.OP_AND: lambda a, b: _where(a != 0.0, _where(b != 0.0, 1.0, 0.0), 0.0),
    ca.OP_OR: lambda a, b: _where(a != 0.0, 1.0, _where(b != 0.0, 1.0, 0.0)),
    ca.OP_IF_ELSE_ZERO: lambda a, b: _where(a != 0.0, b, 0.0),
}


def evaluate_scalars(function: ca.Function, arguments: Sequence[Any], T: type) -> Array:
    """The first output of a CasADi function of Drake's AutoDiffXd or Expression: (n,) of T."""
    (values, *_) = replay(function, arguments, lambda op, operands: _OPERATIONS[op](*operands))
    return np.array([v if isinstance(v, T) else T(v) for v in values])


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
        f"scene '{scene.name}', contact {i}, {('finger', 'object')[side]}: at t = {time:.6g} s the "
        f"contact is {values[i, side]:.2g} sizes from a singular point of the chart of "
        f"{surface!r} ({where}): less than {CLEARANCE:g}, or beyond it; {remedy}"
    )


def _refuse(system: SceneSystem, t: Array, x: Array, w: Array, held: Array) -> None:
    """The error of numbers that must not be integrated."""
    scene, time = system.scene, float(t[0])
    sigma = scene.profile(time)
    if sigma < 0:
        raise SceneError(
            f"scene '{scene.name}': sigma = {sigma:.6g} m/s at t = {time:.6g} s is negative; the "
            f"scene runs from 0 to {scene.duration:g} s: simulate no further, or lengthen it"
        )
    for i, part in enumerate(system.state_slices):
        for name, value in (("state", x[part]), ("disturbance", w[6 * i : 6 * i + 6])):
            if not np.isfinite(value).all():
                raise SceneError(
                    f"scene '{scene.name}', contact {i}: the {name} at t = {time:.6g} s is "
                    f"{value.tolist()}; it must be finite. Check what sets it"
                )
    if not system.evaluate("clearance", time, x, w, held)[0] > CLEARANCE:
        _refuse_singularity(system, t, x, w, held)
    rates = system.evaluate("derivatives", time, x, w, held)
    worst = [float(np.abs(rates[part]).max()) for part in system.state_slices]
    i = int(np.argmax(worst))  # of NaNs the first
    raise ChartSingularity(
        f"scene '{scene.name}', contact {i}: at t = {time:.6g} s (sigma = {sigma:.6g} m/s) "
        f"derivatives are as great as {worst[i]:.3g}: the contact is at a pole, an acceleration "
        "acts while sigma = 0, or the steps are too long for the integrator. Move the contact, "
        "raise sigma, or take smaller steps"
    )


# --- the system -----------------------------------------------------------------------------------


def _define(T: type) -> type:
    Base: Any = LeafSystem_[T]

    class ContactPlanner(Base):
        """Plans how contacts of a scene move, by the equations of contact_system.

        .. pydrake_system::

            name: ContactPlanner
            input_ports:
            - disturbance (with disturbance_input)
            - measured_state (with restart_period or restart_slip)
            output_ports:
            - state
            - slip
            - twist
            - acceleration
            - pose
            - contact_point
            - normal

        For n contacts, in SI units and radians; F_i is the frame of finger i, O of the object, each
        the frame of the body's surface:

        - `disturbance` (6n): acceleration of the finger, acceleration of the object, object rate
          offset, chart components, two numbers each; added to the scene's windows. Zero where the
          port is not connected.
        - `measured_state` (9n): as `state`.
        - `state` (9n): u1 v1 u1' v1' u2 v2 u2' v2' psi of each contact (eq. `contrac`), object rate
          offsets included. In frame coordinates angles are those of the chart's principal range,
          and on a triaxial ellipsoid either of the two ways to write a point.
        - `slip` (2n): v_rel in E2 (eq. `netrelvel`).
        - `twist` (6n): V_OF_O, the finger's angular velocity and its origin's velocity in O.
        - `acceleration` (6n): the time derivative of the twist's components.
        - `pose`: list of RigidTransform X_OF.
        - `contact_point` (6n): the contact on the finger, in F, and on the object, in O.
        - `normal` (3n): the object's outward unit normal at the contact, in O.

        The continuous state is that of :class:`contact_system.SceneSystem`: u1 v1 u1' v1' u2 v2 u2'
        v2' psi a contact for ``coordinates="chart"``; moving frames without poles and, but for
        accelerated contacts, without the stiffness of lam for ``coordinates="frame"``. It starts as
        the scene says. Where the scene has windows a discrete state holds what acts now (6n);
        events at the edges change it, so that no integrator steps across one. Where the planner
        restarts and coordinates are frames, a second one holds W_1, V and its time.

        The planner takes the measured state as its own every `restart_period` seconds, and that of
        contacts whose measured slip is above `restart_slip`, looked at every `restart_period` or
        0.01 s. Contacts whose measured state is not finite keep their plan.

        AutoDiffXd and Expression are supported. ``Linearize`` needs a planner without discrete
        state, that is a scene without windows. In frame coordinates Drake takes hours to evaluate
        the symbolic acceleration, whose tree has 1e10 nodes; derivatives and the rest take up to
        seconds.

        Parameters
        ----------
        scene : Scene
        coordinates : "chart" or "frame"
        disturbance_input : bool
        restart_period : float, optional
            s.
        restart_slip : float, optional
            m/s.
        compiled : bool, optional
            None: compiled kernels where a C compiler or the ziglang package is found, else CasADi's
            virtual machine. The kernel of the derivatives is built here, that of an output when it
            is first asked for, and each is kept in the cache of :mod:`contact_system.kernels`: 0.1
            to 0.5 s for three contacts, once. True: compiled, or an error; False: none. Other
            scalars compile nothing.

        Raises
        ------
        SceneError
            The scene cannot be written in these coordinates; in a simulation: sigma < 0, or a
            derivative that is not finite.
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
            restart_slip: float | None = None,
            compiled: bool | None = None,
            converter: Any = None,
        ) -> None:
            Base.__init__(self, converter=converter)
            self._options = dict(
                coordinates=coordinates, disturbance_input=disturbance_input,
                restart_period=restart_period, restart_slip=restart_slip, compiled=compiled,
            )  # fmt: skip
            self._slip_limit, self._compiled = restart_slip, compiled
            self.system = system = _scene_system(scene, coordinates, disturbance_input)
            n = len(scene.contacts)
            self.DeclareContinuousState(_vector(system.x0, T))
            self._window: Any = None
            self._held: Any = None
            self._disturbance: Any = None
            self._measured: Any = None
            if system.edges:
                self._window = self.DeclareDiscreteState(_vector(system.window_values(0.0), T))
                self._DeclareEdges()
            if disturbance_input:
                self._disturbance = self.DeclareVectorInputPort("disturbance", 6 * n)
            if restart_period is not None or restart_slip is not None:
                self._DeclareRestart(n, restart_period)
            self._DeclareOutputs(n)
            if T is float:
                self._DeclareBuffers()

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
            period = LOOK if period is None else period
            # A little early: 3 * 0.1 s comes after 300 * 1 ms in floating point, and a discrete
            # plant that has stepped already would be measured a step ahead of the planner.
            first = period - EARLY
            self.DeclarePeriodicUnrestrictedUpdateEvent(period, first, weakly(self._Restart))

        def _DeclareOutputs(self, n: int) -> None:
            for name, size in PORTS.items():
                self.DeclareVectorOutputPort(
                    name, size * n, weakly(self._CalcVector, name),
                    prerequisites_of_calc=self._Prerequisites(name),
                )  # fmt: skip
            self.DeclareAbstractOutputPort(
                "pose", Value[list[RigidTransform_[T]]], weakly(self._CalcPose),
                prerequisites_of_calc=self._Prerequisites("pose"),
            )  # fmt: skip

        def _Prerequisites(self, output: str) -> set:
            """What an output depends on, from the sparsity of its kernel."""
            inputs = self.system.depends(output)
            tickets = {"t": self.time_ticket(), "x": self.xc_ticket(), "w": self.time_ticket()}
            found = {ticket for name, ticket in tickets.items() if name in inputs}
            for name, group in (("w", self._window), ("held", self._held)):
                if name in inputs and group is not None:
                    found.add(self.discrete_state_ticket(group))
            if "w" in inputs and self._disturbance is not None:
                found.add(self.input_port_ticket(self._disturbance.get_index()))
            return found or {self.nothing_ticket()}

        # --- floats ----------------------------------------------------------------------------

        def _DeclareBuffers(self) -> None:
            """Scratch that the machines share; the state itself stays in the Context."""
            system = self.system
            self._t, self._x, self._w = np.zeros(1), system.x0.copy(), np.zeros(system.n_w)
            self._h = system.held0.copy()
            self._loaded = (self._t, self._x, self._w, self._h)
            # Between these times what was loaded besides time and state stays as it is.
            changes = not (self._window is self._held is self._disturbance is None)
            self._same = (0.0, 0.0) if changes else (-math.inf, math.inf)
            self._machines: dict[tuple[str, ...], Machine] = {}
            self._limits: Any = no_limits(system) if has_invariants(system) else None
            machine = self._HotMachine()
            rate, guard, clearance, *pace = machine.results
            self._hot = (self._t.data, self._x.data, machine.run, guard.data, rate)
            if "x" in system.depends("clearance"):
                self._DeclareWatch(clearance.data)
            if self._limits is not None:
                self._DeclarePace(pace[0].data)

        def _HotMachine(self) -> Machine:
            if self._limits is None:
                return self._Machine("derivatives", "guard", "clearance")
            given = (*self._loaded, self.system.parameters, self._limits)
            self._machines["pace",] = Machine(_pace(self.system), given, self._compiled)
            return self._machines["pace",]

        def _DeclareWatch(self, clearance: memoryview) -> None:
            """Refuse a step that ends near a singular point.

            Not in the derivatives, because a trial step that error control takes back may go there;
            but the last of them tells whether the end of the step is worth a look.
            """
            check = weakly(self._CheckClearance)

            def watch(context: Any) -> None:
                if not clearance[0] > NEARBY:
                    check(context)

            self.DeclarePerStepPublishEvent(watch)

        def _DeclarePace(self, excess: memoryview) -> None:
            """Refuse a step that ends faster, or with more slip, than any exact motion has.

            Whether the end is worth a look is told by the last derivatives, but not of steps that
            are long for the gain: they may multiply slip by a thousand.
            """
            producer = ValueProducer(lambda: AbstractValue.Make([None]), lambda _, value: None)
            entry = self.DeclareCacheEntry("limits", producer, {self.nothing_ticket()})
            self._kept_limits = entry.cache_index()
            self.DeclareInitializationPublishEvent(weakly(self._SetLimits))
            check, lam, before = weakly(self._CheckPace), stiffness(self.system), np.zeros(1).data
            progress = Progress(self.system.scene)

            def watch(context: Any) -> None:
                t = context.get_time()
                if not excess[0] <= 0.0 or (t - before[0]) * lam > 1.0:
                    check(context)
                before[0] = t
                progress.step(t)

            self.DeclarePerStepPublishEvent(watch)

        def _Kept(self, context: Any) -> list[Limits | None]:
            """The limits of the simulation that a context belongs to; changed in place."""
            return self.get_cache_entry(self._kept_limits).Eval(context)

        def _Paces(self, context: Any) -> list[Array]:
            """Speed and slip of each contact over sigma."""
            self._Load(context)
            machine = self._machines["pace",]
            machine.run()
            return machine.results[4:]

        def _SetLimits(self, context: Any) -> None:
            self._KeepLimits(context, *self._Paces(context))

        def _KeepLimits(self, context: Any, speed: Array, slip: Array) -> None:
            limits = self._Kept(context)[0] = limits_of(self.system, speed, slip)
            self._limits[:] = limits.near()

        def _CheckPace(self, context: Any) -> None:
            (limits,) = self._Kept(context)
            if limits is None:  # nobody has initialized this one
                return
            self._limits[:] = limits.near()
            refuse_pace(self.system, context.get_time(), limits, *self._Paces(context))

        def _CheckClearance(self, context: Any) -> None:
            if not self._Numbers(context, "clearance")[0] > CLEARANCE:
                _refuse_singularity(self.system, *self._loaded)

        def _Machine(self, *outputs: str) -> Machine:
            if outputs not in self._machines:
                self._machines[outputs] = Machine(
                    self.system.function(*outputs),
                    (*self._loaded, self.system.parameters),
                    self._compiled,
                )
            return self._machines[outputs]

        def _Load(self, context: Any) -> None:
            time, x, *_ = self._hot
            time[0] = t = context.get_time()
            x[:] = context.get_continuous_state_vector().CopyToVector()
            after, before = self._same
            if not after < t < before:
                self._LoadRest(context, t)

        def _LoadRest(self, context: Any, t: float) -> None:
            """What the windows add at t, the disturbance port, and held numbers.

            At the edges the discrete state says what the windows add; between them it repeats what
            the scene says, and reading it would take 1 us.
            """
            edges = self.system.edges
            if t in edges:
                self._w[:] = context.get_discrete_state(self._window).value()
            else:
                self._w[:] = self.system.window_values(t)
            if self._disturbance is not None and self._disturbance.HasValue(context):
                self._w += self._disturbance.Eval(context)
            if self._held is not None:
                self._h[:] = context.get_discrete_state(self._held).value()
            if self._held is self._disturbance is None:
                k = bisect.bisect(edges, t)
                after, before = ((-math.inf, *edges)[k], (*edges, math.inf)[k])
                self._same = (t, t) if t in edges else (after, before)

        def _Numbers(self, context: Any, output: str) -> Array:
            machine = self._Machine(output)
            self._Load(context)
            machine.run()
            return machine.results[0]

        # --- other scalars ---------------------------------------------------------------------

        def _Scalars(self, context: Any, output: str) -> Array:
            system = self.system
            w = np.array([T(0.0)] * system.n_w)
            if self._window is not None:
                w = context.get_discrete_state(self._window).CopyToVector().ravel()
            if self._disturbance is not None and self._disturbance.HasValue(context):
                w = w + self._disturbance.Eval(context).ravel()
            held = system.held0
            if self._held is not None:
                held = context.get_discrete_state(self._held).CopyToVector().ravel()
            x = context.get_continuous_state_vector().CopyToVector().ravel()
            arguments = [[context.get_time()], x, w, held, system.parameters]
            return evaluate_scalars(system.function(output), arguments, T)

        # --- what Drake calls ------------------------------------------------------------------

        def _CalcRates(self, context: Any, derivatives: Any) -> None:
            time, x, run, guard, rate = self._hot  # the lines of _Load: a call takes 0.2 us
            time[0] = t = context.get_time()
            x[:] = context.get_continuous_state_vector().CopyToVector()
            after, before = self._same
            if not after < t < before:
                self._LoadRest(context, t)
            run()
            if not guard[0] > 0.0:
                _refuse(self.system, *self._loaded)
            derivatives.SetFromVector(rate)

        def _CalcScalarRates(self, context: Any, derivatives: Any) -> None:
            derivatives.SetFromVector(self._Scalars(context, "derivatives"))

        DoCalcTimeDerivatives = _CalcRates if T is float else _CalcScalarRates

        def _CalcVector(self, output: str, context: Any, vector: Any) -> None:
            values = self._Evaluate(context, output)
            if T is float and not math.isfinite(values.sum()):
                _refuse(self.system, *self._loaded)
            vector.SetFromVector(values)

        def _CalcPose(self, context: Any, value: Any) -> None:
            rows = self._Evaluate(context, "pose").reshape(-1, 12)
            value.set_value(
                [
                    RigidTransform_[T](RotationMatrix_[T](row[:9].reshape(3, 3).T), row[9:])
                    for row in rows
                ]
            )

        _Evaluate = _Numbers if T is float else _Scalars

        def _SetWindow(self, context: Any, state: Any) -> None:
            time = context.get_time()
            now = time if T is float else _value(time)
            values = _scalars(self.system.window_values(now), T)
            state.get_mutable_discrete_state(self._window).SetFromVector(values)

        def _Restart(self, context: Any, state: Any) -> None:
            """Take over the measured state of the contacts that ask for it."""
            if T is not float:
                raise TypeError("ContactPlanner restarts with T = float only; simulate that one")
            system, limit = self.system, self._slip_limit
            rows = self._measured.Eval(context).reshape(-1, 9)
            chosen = np.isfinite(rows).all(axis=1)
            if not chosen.any():
                return
            planned = self._Numbers(context, "state").reshape(-1, 9)
            x, held = system.from_states(
                context.get_time(), np.where(chosen[:, None], rows, planned), self._w
            )
            if limit is not None:
                slip = system.evaluate("slip", context.get_time(), x, self._w, held)
                chosen &= np.hypot(*slip.reshape(-1, 2).T) > limit
            for i in np.flatnonzero(chosen):
                own, kept = system.state_slices[i], system.held_slices[i]
                self._x[own], self._h[kept] = x[own], held[kept]
            if self._limits is not None:
                machine = self._machines["pace",]
                machine.run()  # what is loaded is the state that is set here
                self._KeepLimits(context, *machine.results[4:])
            state.get_mutable_continuous_state().SetFromVector(self._x)
            if self._held is not None:
                state.get_mutable_discrete_state(self._held).SetFromVector(self._h)

    return ContactPlanner


def _scalars(values: Array, T: type) -> Array:
    return values if T is float else np.array([T(v) for v in values], dtype=object)


def _vector(values: Array, T: type) -> Any:
    return BasicVector_[T](_scalars(values, T))


def _value(time: Any) -> float:
    return time.value() if hasattr(time, "value") else time.Evaluate()


@TemplateSystem.define("ContactPlanner_")
def ContactPlanner_(T):
    return _define(T)


ContactPlanner = ContactPlanner_[None]
