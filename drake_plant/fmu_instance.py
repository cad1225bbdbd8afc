"""An instance of an FMU, FMI 2.0 or 3.0: from loading to freeing, and its saved states."""

from __future__ import annotations

import collections
import contextlib
import os
import shutil
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from ctypes import c_void_p
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException, printLogMessage
from fmpy.fmi2 import fmi2Discard, fmi2LastSuccessfulTime, fmi2Terminated
from fmpy.simulation import (
    apply_start_values,
    settable_in_initialization_mode,
    settable_in_instantiated,
)

from contact_system.checks import Array, did_you_mean
from contact_system.errors import ContactSystemError
from contact_system.files import a_path, opened

from .fmu_contents import PortVariables, carried, library_of, read_description, size_of

Names = str | Sequence[str]
Given = Iterable[tuple[PortVariables, Array]]  # of each input port: its variables, and values

WARNING, FATAL = 1, 4  # statuses, the same in FMI 2 and 3

_CALLBACKS: list[Any] = []
"""Of the FMI 2 instance made last, kept alive: fmpy logs through them for all FMUs of FMI 2."""
_LOG: ContextVar[collections.deque[tuple[int, str]] | None] = ContextVar("log", default=None)
"""Where messages of FMUs go while this thread calls an instance."""


def _log_message(*said: Any) -> None:
    """Log a message of an FMU; arguments end with status, category and message.

    With FMI 2, which has five arguments, fmpy hands all messages of the process to the logger that
    it was given last, also those of other FMUs. So there is one logger, which is never freed.
    """
    status, _, message = said[-3:]
    if (log := _LOG.get()) is not None:
        log.append((status, (message or b"").decode(errors="replace").strip()))
    elif len(said) == 5 and status >= WARNING:  # of an FMU that is no Instance's; fmpy prints it
        printLogMessage(*said)


@dataclass(frozen=True, eq=False, slots=True)
class Moment:
    """What a Context holds of an FMU: its time, its outputs and, by its id, its saved state.

    It never changes, so clones of a Context share it. The saved state is freed with the last one.
    """

    _instance: Instance
    time: float
    stepped: bool  # False: just initialized
    ends: bool  # whether the FMU has asked to end the simulation
    values: list[Array]

    def __deepcopy__(self, memo: Any) -> Moment:
        return self

    def __del__(self) -> None:
        self._instance.forget(id(self))


class Instance:
    """An instance of an FMU that is read from a file or folder."""

    def __init__(self, fmu: str | os.PathLike[str], name: str | None):
        self._fmu: Any = None
        self._at: Moment | None = None  # where the FMU is; None: not known, or not initialized
        self._turn = threading.RLock()  # FMI allows one call of an instance at a time
        self._states: dict[int, c_void_p] = {}  # saved by the FMU, by the Moment's id
        self._log: collections.deque[tuple[int, str]] = collections.deque(maxlen=20)
        self._path = path = a_path(fmu, "FmuSystem: fmu")
        with contextlib.ExitStack() as made:
            folder = tempfile.TemporaryDirectory(prefix="fmu-", ignore_cleanup_errors=True)
            self._folder = Path(made.enter_context(folder))
            if not path.is_dir():
                with opened(path, "an FMU") as archive:
                    archive.extractall(self._folder)  # never outside of it, whatever names it has
            self.description = read_description(path, path if path.is_dir() else self._folder)
            self.version = int(self.description.fmiVersion[0])
            if path.is_dir():  # a copy, so that each system has a library of its own
                shutil.copytree(path, self._folder, dirs_exist_ok=True)
            self._library = library_of(path, self._folder, self.description)
            self._keeps_states = self.description.coSimulation.canGetAndSetFMUstate
            self.name = name or self.description.modelName
            made.callback(self._free)
            self.close = made.pop_all().close  # terminate, free, unload, remove what was unpacked

    # --- variables

    def select(self, names: Names | None, causality: str) -> PortVariables:
        """The variables of a port, by names of variables or of structures; a structure stands for
        all its variables of the causality, "input" or "output", and None for all of the FMU."""
        pool = [v for v in self.description.modelVariables if carried(v)]
        known = {v.name: v for v in pool if causality == "output" or v.causality == causality}
        usual = [v for v in pool if v.causality == causality]
        if names is None:
            return PortVariables(usual, self.version)
        listed = [names] if isinstance(names, str) else names
        found: list[Any] = []
        for name in map(str, listed):
            inside = [v for v in usual if v.name.startswith((f"{name}.", f"{name}["))]
            if name not in known and not inside:
                self._refuse_name(name, known, f"numeric {causality} ")
            found.extend([known[name]] if name in known else inside)
        return PortVariables(found, self.version)

    def _refuse_name(self, name: str, known: Iterable[str], what: str = "") -> None:
        hint = did_you_mean(name, known) or "; see modelDescription.xml"
        raise ContactSystemError(f"{self.name} has no {what}variable {name!r}{hint}")

    def prepare(self, start_values: Mapping[str, Any], outputs: list[PortVariables]) -> None:
        """Set what :meth:`begin` sets at the start, and what is read then and after each step."""
        self._outputs, self._start_values = outputs, dict(start_values)
        known = {v.name: v for v in self.description.modelVariables}
        for name, value in start_values.items():
            if name not in known:
                self._refuse_name(name, known)
            self._check_start(known[name], value)
            if isinstance(value, (list, np.ndarray)):  # fmpy takes a matrix only as one row
                self._start_values[name] = np.array(value, object).ravel()

    def _check_start(self, variable: Any, value: Any) -> None:
        """Refuse a value that fmpy would truncate, or refuse without naming the variable. It checks
        texts, and tuples of a value and its unit, itself."""
        if isinstance(value, (str, tuple)) or not carried(variable):
            return
        given, size = np.ravel(value), size_of(variable)
        problem: str | None = f"{variable.name} = {value!r}: give {size} of type {variable.type}"
        if variable.causality == "structuralParameter":
            problem = f"{variable.name} is a structural parameter; export the FMU with its value"
        elif given.dtype.kind in "biuf" and len(given) == size:
            problem = PortVariables([variable], self.version).check(given)
        if problem:
            raise ContactSystemError(f"{self.name}, start_values: {problem}")

    # --- life

    def begin(self, time: float, given: Given = ()) -> Moment:
        """Initialize the FMU at a time, with the inputs at that time."""
        with self._turn, self._doing("initialization", time):
            self._renew(time)
            fmu = self._fmu
            if self.version == 2:
                fmu.setupExperiment(startTime=time)
            left, description = self._start_values, self.description
            left = apply_start_values(fmu, description, left, settable_in_instantiated)
            fmu.enterInitializationMode(**{} if self.version == 2 else {"startTime": time})
            left = apply_start_values(fmu, description, left, settable_in_initialization_mode)
            if left:
                raise ContactSystemError(
                    f"{self.name}: {', '.join(left)} cannot be set at the start; only inputs, "
                    "parameters and variables with initial='exact' or 'approx' can"
                )
            for block, values in given:
                block.write(fmu, values)
            fmu.exitInitializationMode()
            return self._here(time, stepped=False)

    def step(self, moment: Moment, given: Given, step: float) -> Moment:
        """One step from a moment on, with inputs that are constant during it."""
        time, ends = moment.time, False
        with self._turn, self._doing(f"a step of {step:.6g} s", time):
            self._go_to(moment)
            for block, values in given:
                block.write(self._fmu, values)
            self._at = None  # until the step has succeeded
            try:
                done = self._fmu.doStep(time, step, not self._keeps_states)
            except FMICallException as error:
                if not (ends := self._asks_to_end(error, time)):
                    raise
            else:
                if self.version == 3:
                    _, ends, early, _ = done
                    if early and not ends:
                        raise FMICallException("fmi3DoStep, early return,", 2)
            # A multiple of the step, as Drake's own samples: a sum would add up rounding errors.
            return self._here(round(time / step + 1) * step, stepped=True, ends=ends)

    def _asks_to_end(self, error: FMICallException, time: float) -> bool:
        """Whether an FMU of FMI 2 has discarded the rest of a step that began at `time` in order to
        end the simulation. If it has not advanced at all, its message shall be raised instead."""
        ends = False
        if self.version == 2 and error.status == fmi2Discard:
            with contextlib.suppress(FMICallException):
                ends = self._fmu.getBooleanStatus(fmi2Terminated)
                ends = ends and self._fmu.getRealStatus(fmi2LastSuccessfulTime) > time
        return ends

    def _here(self, time: float, stepped: bool, ends: bool = False) -> Moment:
        """A Moment of the FMU's present state."""
        values = [block.read(self._fmu) for block in self._outputs]
        self._at = moment = Moment(self, time, stepped, ends, values)
        if self._keeps_states:
            self._states[id(moment)] = self._fmu.getFMUState()
        return moment

    def _go_to(self, moment: Moment) -> None:
        """Bring the FMU to the state of a moment, unless it is there."""
        if self._at is moment:
            return
        state = self._states.get(id(moment))
        if state is None:
            now = "has failed" if self._at is None else f"is at t = {self._at.time:.6g} s"
            raise ContactSystemError(
                f"{self.name}: the FMU cannot go to this Context's t = {moment.time:.6g} s: it "
                f"{now}, and has no way back (it keeps states only with canGetAndSetFMUstate, and "
                "until it is reloaded). Step one Context at a time, only forward, and begin again "
                "with a default Context and Simulator.Initialize(); or make an FmuSystem for each "
                "Context"
            )
        with self._doing("return to an earlier state", moment.time):
            self._fmu.setFMUState(state)
        self._at = moment

    def forget(self, moment: int) -> None:
        """Free the state that the FMU saved for the Moment with this id."""
        with self._turn:
            state = self._states.pop(moment, None)
            if state is not None:
                with contextlib.suppress(FMICallException):
                    self._fmu.freeFMUState(state)

    def _renew(self, time: float) -> None:
        """Reset the FMU, or instantiate it if it is new or cannot be reset."""
        self._at = None
        if self._fmu is not None:
            try:
                self._fmu.reset()
                return
            except FMICallException:  # FMUs of many tools have no reset
                self._free()
        # fmpy changes the working folder, and stays there if loading fails
        with self._doing(f"loading {self._path}", time), contextlib.chdir(os.getcwd()):
            fmu = fmpy.instantiate_fmu(
                str(self._folder),
                self.description,
                "CoSimulation",
                debug_logging=True,  # all categories: some tools log errors under another
                logger=_log_message,
                library_path=str(self._library),
            )
        self._fmu = fmu
        if self.version == 2:
            _CALLBACKS[:] = [fmu.callbacks]

    @contextlib.contextmanager
    def _doing(self, what: str, time: float) -> Iterator[None]:
        """Raise errors of FMI calls inside as ContactSystemErrors, with what the FMU logged."""
        self._log.clear()
        outside = _LOG.set(self._log)
        try:
            yield
        except ContactSystemError:
            raise
        except Exception as error:  # fmpy raises errors of this class itself when it loads
            self._at = None
            if getattr(error, "status", None) == FATAL:  # FMI allows no further call
                self._fmu, self._states = None, {}
            said = [text for status, text in self._log if status >= WARNING]
            said = (said or [text for _, text in self._log])[-1:]
            raise ContactSystemError(
                f"{self.name}: {what} failed at t = {time:.6g} s: {error}"
                + "".join(f" It says: {text}" for text in said)
            ) from error
        finally:
            _LOG.reset(outside)

    def _free(self) -> None:
        for moment in list(self._states):
            self.forget(moment)
        fmu, at = self._fmu, self._at
        self._fmu = self._at = None
        if fmu is not None:
            if at is not None:  # FMI allows it only after initialization
                with contextlib.suppress(FMICallException):
                    fmu.terminate()
            fmu.freeInstance()
