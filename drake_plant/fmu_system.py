"""Any co-simulation FMU, FMI 2.0 or 3.0, as a Drake system."""

from __future__ import annotations

import math
import os
import weakref
from collections.abc import Mapping
from typing import Any

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, LeafSystem, State

from contact_system.checks import finite_number
from contact_system.errors import ContactSystemError

try:
    import fmpy  # noqa: F401
except ImportError as error:
    raise ImportError('FmuSystem needs fmpy: pip install "contact-system[fmu]"') from error

from .fmu_contents import PortVariables
from .fmu_instance import Given, Instance, Moment, Names
from .lifetimes import NO_DICTIONARY, weakly

SLACK = 1e-6
"""Greatest difference of the Context's time and the FMU's, as a part of a step."""


class FmuSystem(LeafSystem):
    """A co-simulation FMU, FMI 2.0 or 3.0, stepped with a fixed period.

    .. pydrake_system::

        name: FmuSystem
        input_ports:
        - u (or the keys of inputs)
        output_ports:
        - y (or the keys of outputs)

    All ports are vectors. By default `u` holds the FMU's inputs and `y` its outputs, each in the
    order of modelDescription.xml, arrays (FMI 3) row by row. Integers, booleans (0 or 1) and
    enumerations are carried as numbers; strings, binaries and clocks are left out. Values are in
    the units of the description.

    As with Drake's own discrete systems, the update at t = k `step` samples the inputs, and steps
    the FMU to t + `step`, whose values the outputs then have: read at t = k `step`, before the next
    update, they are those of that time. They change in discrete updates, so that other systems
    that are updated at the same time, in whichever way, see the old values. The FMU samples its
    inputs itself: a ZeroOrderHold before them would delay them by a `step`. Inputs that are not
    connected keep their start values.

    Initialization gives the FMU the inputs and the Context's time, which has to be 0 or a positive
    multiple of `step`. Inputs from another FMU then have the values before its own initialization:
    where that matters, give both FMUs start values. A default Context is at t = 0 s.

    The FMU's state is an abstract state and the outputs are discrete states, so that a Context can
    be cloned and simulated again from where it is. This needs an FMU with canGetAndSetFMUstate;
    another FMU steps one Context only, and only forward, and a second Context is refused. Threads
    that share the system take turns.

    When the FMU asks to end the simulation within a step, the update returns
    EventStatus.ReachedTermination and Simulator.AdvanceTo ends there. When the system is freed, so
    is the FMU, and the folder that it was unpacked or copied to is removed.

    Parameters
    ----------
    fmu : path
        An .fmu file, or a folder that one was unpacked in.
    step : float
        Communication step, s.
    inputs, outputs : str, sequence of str, or mapping of port names to those, optional
        The variables of `u` and `y`, or of ports with other names. The name of a structure stands
        for all inputs or outputs in it: ``"contact[1].slip"`` for ``contact[1].slip.x`` and
        ``contact[1].slip.y``. Any variable may be an output.
    start_values : mapping, optional
        Values of parameters, except structural ones, and of others that initialization may set.
    instance_name : str, optional
        By default the model's name. Error messages begin with it.

    Attributes
    ----------
    input_names, output_names : dict
        Port name -> the names of its elements, such as ``("x[1]", "x[2]", "on")``.

    Raises
    ------
    ContactSystemError
        The FMU has no co-simulation or no library for this platform, a variable is unknown, a value
        cannot be set. In a simulation: an input is not a number, a call of the FMU fails, the FMU
        cannot return to a Context's state.
    ImportError
        fmpy is not installed.
    """

    __slots__ = NO_DICTIONARY

    def __init__(
        self,
        fmu: str | os.PathLike[str],
        *,
        step: float,
        inputs: Names | Mapping[str, Names] | None = None,
        outputs: Names | Mapping[str, Names] | None = None,
        start_values: Mapping[str, Any] | None = None,
        instance_name: str | None = None,
    ):
        super().__init__()
        self._step = finite_number(step, "step", "above 0", ContactSystemError)
        self._instance = instance = Instance(fmu, instance_name)
        weakref.finalize(self, instance.close)
        read = _blocks(instance, "input", inputs, "u")
        held = _blocks(instance, "output", outputs, "y")
        self.input_names = {port: block.names for port, block in read.items()}
        self.output_names = {port: block.names for port, block in held.items()}
        self._inputs = [(self.DeclareVectorInputPort(k, len(b.names)), b) for k, b in read.items()]
        instance.prepare({} if start_values is None else start_values, list(held.values()))
        start = instance.begin(0.0)
        self._moment = self.DeclareAbstractState(AbstractValue.Make(start))
        for port, values in zip(held, start.values):
            self.DeclareStateOutputPort(port, self.DeclareDiscreteState(values))
        self.DeclareInitializationUnrestrictedUpdateEvent(weakly(self._Begin))
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._step, 0.0, weakly(self._Step))
        # The outputs change in a discrete update only. Drake makes those after unrestricted ones,
        # and in them another system must not yet see the outputs a step ahead.
        self.DeclarePeriodicDiscreteUpdateEvent(self._step, 0.0, weakly(self._Hold))

    def _Moment(self, context: Context) -> Moment:
        return context.get_abstract_state().get_value(self._moment).get_value()

    def _Given(self, context: Context) -> Given:
        """Values of the input ports that are connected."""
        for port, block in self._inputs:
            if port.HasValue(context):
                values = port.Eval(context)
                problem = block.check(values)
                if problem:
                    raise ContactSystemError(
                        f"{self._instance.name}, input port '{port.get_name()}' at t = "
                        f"{context.get_time():.6g} s: {problem}; check what it is connected to"
                    )
                yield block, values

    def _Begin(self, context: Context, state: State) -> None:
        """Initialize the FMU, unless the Context comes from a simulation, which then goes on."""
        time, moment, step = context.get_time(), self._Moment(context), self._step
        if moment.stepped:
            if not -SLACK <= (moment.time - time) / step <= 1 + SLACK:
                self._RefuseTime(time, moment)
            return
        on_step = math.isfinite(time) and abs(time - round(time / step) * step) <= SLACK * step
        if not on_step or time < 0:  # Drake has no samples before 0
            raise ContactSystemError(
                f"{self._instance.name}: t = {time!r} s is not 0 or a positive multiple of the "
                f"step of {step:g} s, and updates come only then: set the time to one of these"
            )
        moment = self._instance.begin(time, list(self._Given(context)))
        state.get_mutable_abstract_state().get_mutable_value(self._moment).set_value(moment)
        for i, values in enumerate(moment.values):
            state.get_mutable_discrete_state(i).get_mutable_value()[:] = values

    def _Step(self, context: Context, state: State) -> EventStatus:
        time, moment = context.get_time(), self._Moment(context)
        if not moment.ends:
            ahead = (moment.time - time) / self._step
            if abs(ahead - 1) < SLACK:  # an earlier Simulator did this update, then stopped
                return EventStatus.DidNothing()
            if abs(ahead) > SLACK:
                self._RefuseTime(time, moment)
            moment = self._instance.step(moment, list(self._Given(context)), self._step)
            state.get_mutable_abstract_state().get_mutable_value(self._moment).set_value(moment)
        if moment.ends:  # the FMU is not stepped again, even if a simulation goes on
            return EventStatus.ReachedTermination(self, f"{self._instance.name} asks to end here")
        return EventStatus.Succeeded()

    def _Hold(self, context: Context, held: DiscreteValues) -> None:
        for i, values in enumerate(self._Moment(context).values):
            held.get_mutable_value(i)[:] = values

    def _RefuseTime(self, time: float, moment: Moment) -> None:
        raise ContactSystemError(
            f"{self._instance.name}: the Context's time is {time:.6g} s and its FMU is at "
            f"{moment.time:.6g} s: initialize a new Simulator, or one with a default Context, and "
            "do not change the time afterwards"
        )


def _blocks(
    instance: Instance, causality: str, chosen: Names | Mapping[str, Names] | None, usual: str
) -> dict[str, PortVariables]:
    """Port name -> its variables, for the ports that have any."""
    ports = chosen if isinstance(chosen, Mapping) else {usual: chosen}
    found = {str(port): instance.select(names, causality) for port, names in ports.items()}
    return {port: block for port, block in found.items() if block.names}
