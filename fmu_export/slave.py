"""The planner as an FMI slave in this process: what fmpy runs, without a compiler or an FMU.

`PlannerSlave2` and `PlannerSlave3` have the variables of the exported FMU (:mod:`.variables`) and
the methods of fmpy's slave classes; an unmodified ``fmpy.simulate_fmu`` runs them::

    with in_process(scene, "3.0") as slave:
        result = fmpy.simulate_fmu(**slave, output_interval=1e-3)

Thin over :mod:`.stepping`, which does the work. Statuses and log categories are those of the FMU;
an error is fmpy's FMICallException, and its text is the log line.
"""

from __future__ import annotations

import contextlib
import logging
import math
import re
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2DoStepStatus, fmi2LastSuccessfulTime, fmi2Terminated
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import read_model_description

from contact_system.checks import a_path, flag, function_or_none, make_folder
from contact_system.errors import ChartSingularity, ContactSystemError, SceneError
from contact_system.kept import kept
from contact_system.scene import Scene
from contact_system.writing import writing

from .description import (
    LOG_CATEGORIES,
    check_choice,
    instantiation_token,
    model_description,
    model_identifier,
)
from .model import INFINITE
from .stepping import Block, Memory, MotionEnds, StateRefused, digest, memory_of, state_bytes
from .variables import Table, variable_table

OK, WARNING, DISCARD, ERROR = range(4)  # as in FMI 2 and 3
CREATED, INITIALIZATION, STEP, EVENT, TERMINATED, BROKEN, FREED = (
    "instantiated",
    "initialization mode",
    "step mode",
    "event mode",
    "terminated",
    "after a failed step",
    "freed",
)
_RUNNING = (INITIALIZATION, STEP, EVENT, TERMINATED, BROKEN)
_ANY = (CREATED, *_RUNNING)
SLACK = 1e-9  # how far an importer's time may be from the slave's own; fmpy's own bar

# What a slave in this process does not do, of what `.description` declares.
_ABSENT = (
    "canInterpolateInputs",
    "providesIntermediateUpdate",
    "canReturnEarlyAfterIntermediateUpdate",
    "intermediateUpdate",
)

_KNOWN = ("independent", "exact", "input", "fixed", "tunable")

Logger = Callable[[int, str, str], None]
"""Takes a status, a category of `LOG_CATEGORIES` and a text."""


def write_description(scene: Scene, folder: Path | str, fmi_version: str = "2.0") -> Path:
    """Write the only file that an importer wants to see: modelDescription.xml.

    Parameters
    ----------
    scene : Scene
    folder : path
        Made where it is missing.
    fmi_version : "2.0" or "3.0"

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    ContactSystemError
        A scene that no importer can step, or an unknown version.
    """
    text = model_description(variable_table(scene), fmi_version, ("CoSimulation",))
    path = a_path(folder, "folder") / "modelDescription.xml"
    make_folder(path.parent, "give another folder")
    with writing(path) as file:
        file.write(re.sub(f' (?:{"|".join(_ABSENT)})="true"', "", text).encode())
    return path


@contextlib.contextmanager
def in_process(scene: Scene, fmi_version: str = "2.0", **given: Any) -> Iterator[dict[str, Any]]:
    """What ``fmpy.simulate_fmu`` needs to run a scene in this process, as keyword arguments.

    Parameters
    ----------
    scene : Scene
    fmi_version : "2.0" or "3.0"
    given
        Further arguments of `PlannerSlave2` or `PlannerSlave3`.

    Raises
    ------
    ContactSystemError
        A scene that no importer can step, or an unknown version.
    """
    check_choice(fmi_version, ("CoSimulation",))
    kind = PlannerSlave2 if fmi_version == "2.0" else PlannerSlave3
    with tempfile.TemporaryDirectory(prefix="contact-system-") as folder:
        write_description(scene, folder, fmi_version)
        yield {
            "filename": folder,
            "model_description": read_model_description(folder, validate=True),
            "fmu_instance": kind(scene, **given),
            "fmi_type": "CoSimulation",
        }


@dataclass
class FmuState:
    """What ``getFMUState`` hands out; to be freed or forgotten."""

    memory: Memory | None
    model: bytes


class _Slave:
    """What both versions of FMI share; mixed in before fmpy's class.

    Parameters
    ----------
    scene : Scene
    name : str
        The instance's name, for log lines.
    logger : callable, optional
        See `Logger`; by default the logger "fmu_export" of `logging`.

    Raises
    ------
    SceneError
        A scene that no importer can step, or an option of the wrong kind.
    """

    _version: str
    _lowest = 0
    _first_phase = STEP
    _readable: tuple[str, ...] = _RUNNING

    def __init__(self, scene: Scene, name: str = "", logger: Logger | None = None):
        if not isinstance(name, str):
            raise SceneError(f"name = {name!r:.80}: give a text")
        logger = function_or_none(logger, "logger", "a function of a status, a category and a text")
        self.scene, self.block = scene, Block(scene, CREATED)
        self.modelIdentifier = model_identifier(self.block.table)
        self.instanceName = name or self.modelIdentifier
        self.component = id(self)
        self.fmiCallLogger = None
        self._logger, self._logged = logger or _log, set(LOG_CATEGORIES)
        self._kinds, self._least = _kinds(self.block.table)
        self._last_status = OK

    @property
    def time(self) -> float:
        """The communication point, s."""
        return self.block.now.time

    @kept
    def guid(self) -> str:
        """The GUID or instantiation token of the description."""
        text = model_description(self.block.table, self._version, ("CoSimulation",))
        return instantiation_token(text)

    @kept
    def _model(self) -> bytes:
        """Tells states of different scenes from each other."""
        return digest(self.guid.encode())

    # --- telling

    def _call(self, function: str, *args: Any, **_: Any) -> Any:
        """Where those of fmpy's methods end that mean nothing here."""
        self._refuse(
            function[len("fmi2") :],
            ERROR,
            "this slave does not have it; see the flags in modelDescription.xml, and the types of "
            "its variables, which are all real",
        )

    def _refuse(self, function: str, status: int, text: str) -> NoReturn:
        """Log and raise."""
        function = f"fmi{self._version[0]}{function}"
        text = f"{self.instanceName}: {function}: {text}"
        self._tell(status, "logStatusDiscard" if status == DISCARD else "logStatusError", text)
        self._last_status = status
        error = FMICallException(function=function, status=status)
        error.args = (f"{error.args[0]} {text}",)
        raise error

    def _tell(self, status: int, category: str, text: str) -> None:
        if status == ERROR or category in self._logged:  # as the compiled FMU, fmi.h
            self._logger(status, category, text)

    def _require(self, function: str, *phases: str) -> None:
        """Refuse a call out of order (FMI 2.0.4, section 4.2.4; FMI 3.0.2, section 4.2)."""
        phase = self.block.now.phase
        if phase not in phases:
            text = f"not allowed in the state '{phase}', only in: {', '.join(phases)}"
            text += "; reset, or set an FMU state" if phase in (TERMINATED, BROKEN) else ""
            self._refuse(function, ERROR, text)

    def setDebugLogging(self, loggingOn: bool, categories: Sequence[str] = ()) -> None:
        """Choose which log lines are written; without categories all."""
        for category in categories:
            if category not in LOG_CATEGORIES:
                known = ", ".join(LOG_CATEGORIES)
                text = f"category {category!r} is unknown; use {known}"
                self._refuse("SetDebugLogging", ERROR, text)
        self._logged = set(categories or LOG_CATEGORIES) if loggingOn else set()

    def getVersion(self) -> str:
        """The version of FMI."""
        return self._version

    # --- life

    def instantiate(self, visible: bool = False, loggingOn: bool = True, **_: Any) -> None:
        """Begin again. A slave is there once it is made; this is for importers that insist."""
        self.block.reset()
        self._logged = set(LOG_CATEGORIES) if loggingOn else set()

    def freeInstance(self) -> None:
        """The end: every later call is refused."""
        self.block.now.phase = FREED
        self.block.take(self.block.now)  # what was evaluated ahead is forgotten

    def reset(self) -> None:
        """Back to where the scene starts, also after an error."""
        self._require("Reset", *_ANY)
        self.block.reset()

    def terminate(self) -> None:
        """The simulation is over; values can still be read."""
        self._require("Terminate", STEP, EVENT)
        self.block.now.phase = TERMINATED

    def _announce(self, function: str, startTime: float, stopTime: float | None) -> None:
        self._require(function, CREATED)
        now, stop = self.block.now, math.inf if stopTime is None else stopTime
        numbers = isinstance(startTime, Real) and isinstance(stop, Real)
        if not numbers or not 0 <= startTime < math.inf or not stop >= startTime:
            text = f"startTime = {startTime!r}, stopTime = {stopTime!r}: give 0 <= startTime <= "
            self._refuse(function, ERROR, text + "stopTime; the profile counts from t = 0")
        now.time, now.stop = float(startTime), float(stop)

    def exitInitializationMode(self) -> None:
        """Plan from the start values."""
        self._require("ExitInitializationMode", INITIALIZATION)
        try:
            self.block.start()
        except ContactSystemError as error:
            self._refuse("ExitInitializationMode", ERROR, str(error))
        self.block.now.phase = self._first_phase

    # --- values

    def _get(self, function: str, key: tuple[int, ...], asked: Sequence[int]) -> list[float]:
        self._require(function, *self._readable)
        for reference in key:
            self._require_known(function, reference)
            if self.block.now.phase == CREATED and self._kinds[reference] == "calculated":
                text = "is calculated and has no start value; ask from initialization on"
                self._refuse(function, ERROR, f"{self._name(reference)} {text}")
        try:
            values = self.block.values_of(key)
            self._require_values(function, key, values)
            self.block.remember(asked, key)  # what was refused is refused again
        except ChartSingularity as error:
            self._refuse(function, DISCARD, str(error))
        except ContactSystemError as error:  # from planning on under new inputs
            self._refuse(function, ERROR, str(error))
        return values

    def _require_values(self, function: str, key: Sequence[int], values: Sequence[float]) -> None:
        for reference, value in zip(key, values):
            if abs(value) <= INFINITE:
                continue
            if not math.isfinite(value) or self.block.rests():
                beyond = self.block.now.plan is None
                text = f"{self._name(reference)} has no value at t = {self.time:.17g} s"
                if self.block.rests():
                    text += ": sigma is zero, and an acceleration cannot act on a path that rests; "
                    text += "accelerate while sigma > 0, or disturb the object's rates"
                else:
                    text += ", at or beyond a " if beyond else ", at a "
                    text += "singular point of a chart (a pole or an umbilic); "
                    text += "start elsewhere" if beyond else "ask a moment later"
                self._refuse(function, DISCARD, text)

    def _set(self, function: str, key: Sequence[int], values: Sequence[float]) -> None:
        """Set all, or refuse all."""
        self._require(function, CREATED, INITIALIZATION, STEP, EVENT)
        if len(key) != len(values):
            text = f"{len(values)} values for {len(key)} elements; give one per element"
            self._refuse(function, ERROR, text)
        for reference, value in zip(key, values):
            self._check(function, reference, value)
        for reference, value in zip(key, values):
            self.block.change(reference, float(value))

    def _check(self, function: str, reference: int, value: float) -> None:
        self._require_known(function, reference)
        kind = self._kinds[reference]
        at_first = self.block.now.phase in (CREATED, INITIALIZATION)
        if kind in ("calculated", "independent") or (kind in ("fixed", "exact") and not at_first):
            text = "cannot be set, it is calculated; disturb the motion by the inputs"
            if kind == "fixed":
                text = "is fixed; set it before initialization ends, or reset first"
            elif kind == "exact":
                text = "is a start value; set it before initialization ends, or use the inputs"
            self._refuse(function, ERROR, f"{self._name(reference)} {text}")
        if kind == "tunable" and self._first_phase == EVENT and self.block.now.phase == STEP:
            text = "is tunable in event mode only, since event mode is used"
            self._refuse(function, ERROR, f"{self._name(reference)} {text}")
        if not math.isfinite(value):
            text = f"{self._name(reference)} = {value!r} is refused; give a finite number"
            self._refuse(function, DISCARD, text)
        if value < self._least.get(reference, value):
            least = self._least[reference]
            text = f"{self._name(reference)} = {value!r} is refused; give {least:g} or more"
            self._refuse(function, DISCARD, text)

    def _require_known(self, function: str, reference: int) -> None:
        if not self._lowest <= reference < len(self._kinds):
            self._refuse_unknown(function, reference)

    def _refuse_unknown(self, function: str, reference: int) -> NoReturn:
        text = f"value reference {reference!r} is unknown; see modelDescription.xml"
        self._refuse(function, ERROR, text)

    def _name(self, reference: int) -> str:
        rows = self.block.table.rows
        row = next(r for r in reversed(rows) if r.reference <= reference)
        return row.elements[reference - row.reference] if row.elements else row.name

    # --- stepping

    def _advance(self, now: float, step: float, target: float) -> None:
        """To the target, which is now + step or before it."""
        memory = self.block.now
        near = SLACK * now if now > 1.0 else SLACK
        if (
            memory.phase != STEP
            or not 0.0 < step < math.inf
            or not abs(now - memory.time) <= near
            or not now + step <= memory.stop + near
        ):
            self._refuse_step(now, step)
        try:
            self.block.advance(target)
        except MotionEnds as error:
            self._refuse("DoStep", DISCARD, str(error))
        except ContactSystemError as error:
            memory.phase = BROKEN  # as the compiled FMU, component.c
            self._refuse("DoStep", ERROR, str(error))

    def _refuse_step(self, now: float, step: float) -> NoReturn:
        self._require("DoStep", STEP)
        memory = self.block.now
        if not 0.0 < step < math.inf:
            text = f"communicationStepSize = {step!r} s: give a positive number; to go back, set "
            text += "an FMU state obtained earlier"
        elif not abs(now - memory.time) <= SLACK * max(1.0, now):
            text = f"currentCommunicationPoint = {now!r} s, but this instance is at t = "
            text += f"{memory.time!r} s; step from there, or set an FMU state of that time"
        else:
            text = f"t = {now + step!r} s is past stopTime = {memory.stop!r} s; give a later one, "
            text += "or none"
        self._refuse("DoStep", ERROR, text)

    # --- states

    def getFMUState(self) -> FmuState:
        """All that this instance knows, to go back to."""
        self._require("GetFMUState", *_ANY)
        return FmuState(self.block.now.copied(), self._model)

    def setFMUState(self, state: FmuState) -> None:
        """Go back, or go where another instance of the same scene was."""
        self._require("SetFMUState", *_ANY)
        memory = self._memory_in("SetFMUState", state).copied()
        if self._first_phase == STEP:  # this instance has no event mode
            memory.phase = STEP if memory.phase == EVENT else memory.phase
            memory.pending = False
        self.block.take(memory)

    def freeFMUState(self, state: FmuState | None) -> None:
        """Forget a state; None is nothing to forget."""
        if state is not None:
            self._memory_in("FreeFMUState", state)
            state.memory = None

    def serializeFMUState(self, state: FmuState) -> bytes:
        """A state as bytes, for another process."""
        return state_bytes(self._memory_in("SerializeFMUState", state), self._model)

    def deserializeFMUState(self, serializedState: bytes, state: Any = None) -> FmuState:
        """A state from its bytes; the instance stays where it is."""
        try:
            memory = memory_of(bytes(memoryview(serializedState)), self.block, self._model)
        except (StateRefused, TypeError) as error:  # the latter of what are no bytes
            self._refuse("DeserializeFMUState", ERROR, f"the state is refused: {error}")
        return FmuState(memory, self._model)

    def _memory_in(self, function: str, state: FmuState) -> Memory:
        if not isinstance(state, FmuState) or state.memory is None:
            text = "there is no such state; use one that getFMUState gave and nobody has freed"
            self._refuse(function, ERROR, text)
        if state.model != self._model:
            self._refuse(function, ERROR, "the state is refused: it belongs to another scene")
        return state.memory

    # --- derivatives

    def _product(
        self,
        function: str,
        unknowns: Sequence[int],
        knowns: Sequence[int],
        seed: Sequence[float],
        adjoint: bool = False,
    ) -> list[float]:
        """The Jacobian of unknowns by knowns, or its transpose, times a seed."""
        self._require(function, *_RUNNING)
        for references, kinds in ((unknowns, ("calculated", "exact")), (knowns, _KNOWN)):
            for reference in references:
                self._require_known(function, reference)
                if self._kinds[reference] not in kinds:
                    word = "an unknown" if references is unknowns else "a known"
                    text = f"{self._name(reference)} is not {word} of the model's equations"
                    self._refuse(function, ERROR, text)
        seeded, asked = (unknowns, knowns) if adjoint else (knowns, unknowns)
        if len(seed) != len(seeded):
            self._refuse(function, ERROR, f"{len(seed)} seeds for {len(seeded)} elements")
        given = np.zeros(len(self._kinds))
        given[list(seeded)] = seed
        grown = given.copy()
        try:
            jacobians = self.block.jacobians()
        except ChartSingularity as error:
            self._refuse(function, DISCARD, str(error))
        except ContactSystemError as error:  # as values are refused
            self._refuse(function, ERROR, str(error))
        for matrix, rows, columns in jacobians:
            if not adjoint:
                grown[rows] = matrix @ given[columns]
            elif given[rows].any():
                grown[columns] += given[rows] @ matrix
        values = grown[list(asked)].tolist()
        self._require_values(function, asked, values)
        return values


def _log(status: int, category: str, text: str) -> None:
    level = (logging.INFO, logging.WARNING, logging.WARNING, logging.ERROR)[status]
    logging.getLogger("fmu_export").log(level, "%s: %s", category, text)


def _kinds(table: Table) -> tuple[list[str], dict[int, float]]:
    """What each reference is, and the least value of parameters that have one."""
    kinds: list[str] = []
    least: dict[int, float] = {}
    for v in table.rows:
        if v.minimum is not None:
            least[v.reference] = v.minimum
        kinds += [v.kind] * v.size
    return kinds, least


class PlannerSlave2(_Slave, FMU2Slave):
    """A scene as fmpy's slave for FMI 2.0 Co-Simulation.

    Parameters
    ----------
    scene : Scene
    name : str
        The instance's name, for log lines.
    logger : callable, optional
        See `Logger`; by default the logger "fmu_export" of `logging`.

    Raises
    ------
    SceneError
        A scene that no importer can step, or an option of the wrong kind.
    """

    _version = "2.0"
    _lowest = 1  # time is no variable of FMI 2
    _stopped = False

    def getTypesPlatform(self) -> str:
        """Of the FMI 2.0 headers."""
        return "default"

    def setupExperiment(
        self, tolerance: float | None = None, startTime: float = 0.0, stopTime: float | None = None
    ) -> None:
        """Announce times, s. Plans are better than any tolerance asked for."""
        self._announce("SetupExperiment", startTime, stopTime)

    def enterInitializationMode(self) -> None:
        """Begin initialization."""
        self._require("EnterInitializationMode", CREATED)
        self.block.now.phase = INITIALIZATION

    def getReal(self, vr: Sequence[int]) -> list[float]:
        """Values of scalars."""
        block, vr = self.block, [*vr]
        if vr == block.asked and block.is_ahead():
            return [*block.rows[block.row]]
        return self._get("GetReal", tuple(vr), vr)

    def setReal(self, vr: Sequence[int], value: Sequence[float]) -> None:
        """Set scalars, all or none."""
        self._set("SetReal", list(vr), list(value))

    def fmi2SetReal(self, c: Any, vr: Any, nvr: int, value: Any) -> int:
        """As `setReal`, from C arrays: what fmpy's inputs call."""
        self._set("SetReal", vr[:nvr], value[:nvr])
        return OK

    def fmi2GetReal(self, c: Any, vr: Any, nvr: int, value: Any) -> int:
        """As `getReal`, into a C array."""
        value[:nvr] = self.getReal(vr[:nvr])
        return OK

    def doStep(
        self,
        currentCommunicationPoint: float,
        communicationStepSize: float,
        noSetFMUStatePriorToCurrentPoint: bool = True,
    ) -> None:
        """Step to the next communication point, exactly."""
        self._stopped = True  # unless the step is made
        target = currentCommunicationPoint + communicationStepSize
        self._advance(currentCommunicationPoint, communicationStepSize, target)
        self._stopped, self._last_status = False, OK

    def getStatus(self, kind: int) -> int:
        """Of the last step; only fmi2DoStepStatus is known."""
        if kind != fmi2DoStepStatus:
            self._refuse("GetStatus", DISCARD, "only fmi2DoStepStatus is known")
        return self._last_status

    def getRealStatus(self, kind: int) -> float:
        """The last successful time, s."""
        if kind != fmi2LastSuccessfulTime:
            self._refuse("GetRealStatus", DISCARD, "only fmi2LastSuccessfulTime is known")
        return self.time

    def getBooleanStatus(self, kind: int) -> bool:
        """Whether the motion cannot go on."""
        if kind != fmi2Terminated:
            self._refuse("GetBooleanStatus", DISCARD, "only fmi2Terminated is known")
        return self._stopped

    def getDirectionalDerivative(
        self, vUnknown_ref: Sequence[int], vKnown_ref: Sequence[int], dvKnown: Sequence[float]
    ) -> list[float]:
        """Exact derivatives of some unknowns along a direction in some knowns."""
        return self._product("GetDirectionalDerivative", vUnknown_ref, vKnown_ref, dvKnown)

    getFMUstate = _Slave.getFMUState
    setFMUstate = _Slave.setFMUState
    freeFMUstate = _Slave.freeFMUState
    serializeFMUstate = _Slave.serializeFMUState
    deSerializeFMUstate = _Slave.deserializeFMUState


class PlannerSlave3(_Slave, FMU3Slave):
    """A scene as fmpy's slave for FMI 3.0 Co-Simulation.

    Parameters
    ----------
    scene, name, logger
        As for `PlannerSlave2`.
    event_mode : bool
        The importer handles events: steps tell of the edges of disturbance windows.
    early_return : bool
        With event mode: a step ends at such an edge.
    """

    _version = "3.0"
    _readable = _ANY  # start values at once

    def __init__(
        self,
        scene: Scene,
        name: str = "",
        logger: Logger | None = None,
        event_mode: bool = False,
        early_return: bool = False,
    ):
        super().__init__(scene, name, logger)
        self._use(flag(event_mode, "event_mode"), flag(early_return, "early_return"))
        self._sizes = {v.reference: v.size for v in self.block.table.rows}
        self._elements: dict[tuple[int, ...], tuple[int, ...]] = {}

    def _use(self, event_mode: bool, early_return: bool) -> None:
        self._events, self._early = event_mode, event_mode and early_return
        self._first_phase = EVENT if event_mode else STEP

    def instantiate(
        self,
        visible: bool = False,
        loggingOn: bool = True,
        eventModeUsed: bool = False,
        earlyReturnAllowed: bool = False,
        **_: Any,
    ) -> None:
        """Begin again, with or without event mode and early return."""
        super().instantiate(visible, loggingOn)
        self._use(eventModeUsed, earlyReturnAllowed)

    def enterInitializationMode(
        self, tolerance: float | None = None, startTime: float = 0.0, stopTime: float | None = None
    ) -> None:
        """Announce times, s, and begin initialization."""
        self._announce("EnterInitializationMode", startTime, stopTime)
        self.block.now.phase = INITIALIZATION

    def _elements_of(self, function: str, vr: Sequence[int]) -> tuple[int, ...]:
        """References of the elements of some variables."""
        key = tuple(vr)
        if key not in self._elements:
            for reference in key:
                if reference not in self._sizes:
                    self._refuse_unknown(function, reference)
            spans = (range(r, r + self._sizes[r]) for r in key)
            self._elements[key] = tuple(element for span in spans for element in span)
        return self._elements[key]

    def getFloat64(self, vr: Sequence[int], nValues: int | None = None) -> list[float]:
        """Values of variables, arrays row by row."""
        block, vr = self.block, [*vr]
        if vr == block.asked and block.is_ahead():
            values = [*block.rows[block.row]]
        else:
            values = self._get("GetFloat64", self._elements_of("GetFloat64", vr), vr)
        if nValues is not None and nValues != len(values):
            text = f"nValues = {nValues}; these variables have {len(values)} elements"
            self._refuse("GetFloat64", ERROR, text)
        return values

    def setFloat64(self, vr: Sequence[int], values: Sequence[float]) -> None:
        """Set variables, all or none; arrays row by row."""
        self._set("SetFloat64", self._elements_of("SetFloat64", vr), list(values))

    def fmi3SetFloat64(self, instance: Any, vr: Any, n: int, values: Any, n_values: int) -> int:
        """As `setFloat64`, from C arrays: what fmpy's inputs call."""
        self.setFloat64(vr[:n], values[:n_values])
        return OK

    def fmi3GetFloat64(self, instance: Any, vr: Any, n: int, values: Any, n_values: int) -> int:
        """As `getFloat64`, into a C array."""
        values[:n_values] = self.getFloat64(vr[:n], n_values)
        return OK

    def doStep(
        self,
        currentCommunicationPoint: float,
        communicationStepSize: float,
        noSetFMUStatePriorToCurrentPoint: bool = True,
    ) -> tuple[bool, bool, bool, float]:
        """Step to the next communication point, or to the edge of a window before it.

        Returns
        -------
        event, terminate, early_return, last_time : bool, bool, bool, float
        """
        target = currentCommunicationPoint + communicationStepSize
        event = early = False
        if self._events:
            edge, reached = self.block.next_edge(), self.block.snapped(target)
            early = self._early and edge < reached
            event = early or (edge <= reached and reached in self.block.edges)
            target = edge if early else target
        self._advance(currentCommunicationPoint, communicationStepSize, target)
        self.block.hold(event)
        if event:
            text = f"{self.instanceName}: edge of a disturbance window at t = {self.time!r} s"
            self._tell(OK, "logEvents", text)
        return event, False, early, target

    def enterEventMode(self) -> None:
        """Handle events: values are those after the edge from here on, and inputs may change."""
        self._require_events("EnterEventMode", STEP)
        self.block.now.phase = EVENT
        self.block.hold(False)

    def _require_events(self, function: str, phase: str) -> None:
        if not self._events:
            text = "event mode was not asked for; make the slave with event_mode=True"
            self._refuse(function, ERROR, text)
        self._require(function, phase)

    def updateDiscreteStates(self) -> tuple[bool, bool, bool, bool, bool, float]:
        """There are no discrete states; tells when the next window begins or ends, s."""
        self._require_events("UpdateDiscreteStates", EVENT)
        edge = self.block.next_edge()
        known = edge < math.inf
        return False, False, False, False, known, edge if known else 0.0

    def enterStepMode(self) -> None:
        """Go on stepping."""
        self._require_events("EnterStepMode", EVENT)
        self.block.now.phase = STEP

    def getDirectionalDerivative(
        self,
        unknowns: Sequence[int],
        knowns: Sequence[int],
        seed: Sequence[float],
        nSensitivity: int | None = None,
    ) -> list[float]:
        """Exact derivatives of some unknowns along a direction in some knowns."""
        return self._of_elements("GetDirectionalDerivative", unknowns, knowns, seed, nSensitivity)

    def getAdjointDerivative(
        self,
        unknowns: Sequence[int],
        knowns: Sequence[int],
        seed: Sequence[float],
        nSensitivity: int | None = None,
    ) -> list[float]:
        """Exact derivatives of a combination of unknowns by some knowns."""
        return self._of_elements("GetAdjointDerivative", unknowns, knowns, seed, nSensitivity, True)

    def _of_elements(
        self,
        function: str,
        unknowns: Sequence[int],
        knowns: Sequence[int],
        seed: Sequence[float],
        count: int | None,
        adjoint: bool = False,
    ) -> list[float]:
        rows, columns = (self._elements_of(function, vr) for vr in (unknowns, knowns))
        has = len(columns if adjoint else rows)
        if count is not None and count != has:
            text = f"nSensitivity = {count}; these variables have {has} elements"
            self._refuse(function, ERROR, text)
        return self._product(function, rows, columns, seed, adjoint)
