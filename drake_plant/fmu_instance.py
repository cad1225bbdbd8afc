"""One FMU in this process, FMI 2.0 or 3.0: its life and its states."""

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

from contact_system.archives import opened
from contact_system.checks import Array, a_path, did_you_mean, within
from contact_system.errors import ContactSystemError

from .fmu_contents import PortVariables, carried, library_of, read_description, size_of

Names = str | Sequence[str]
Given = Iterable[tuple[PortVariables, Array]]

SLACK = 1e-6
"""By how much of a step the Context's time and the FMU's may differ."""
WARNING, FATAL = 1, 4  # statuses, the same in FMI 2 and 3


_CALLBACKS: list[Any] = []
_LOG: ContextVar[collections.deque[tuple[int, str]] | None] = ContextVar("log", default=None)
"""Where a thread's messages go while an instance is called."""


def _note(*said: Any) -> None:
    """What an FMU says; FMI 2 has an instance's name before the status.

    Of FMI 2 fmpy hands all messages of a process to the logger that it was given last, also those
    of other FMUs after that logger's instance is gone; so it is one function, and stays.
    """
    status, _, message = said[-3:]
    if (log := _LOG.get()) is not None:
        log.append((status, (message or b"").decode(errors="replace").strip()))
    elif len(said) == 5 and status >= WARNING:  # of another FMU, as fmpy does by itself
        printLogMessage(*said)


@dataclass(frozen=True, eq=False, slots=True)
class Moment:
    """What the Context holds of an FMU: when it is, its outputs, and how to go back there.

    It never changes, so clones of a Context share it; the FMU's copy of its state is given back
    with the last of them.
    """

    _instance: Instance
    time: float
    stepped: bool
    ends: bool  # whether the FMU has asked to end the simulation
    values: list[Array]

    def __deepcopy__(self, memo: Any) -> Moment:
        return self

    def __del__(self) -> None:
        self._instance.forget(id(self))


class Instance:
    """One FMU in this process, from a file or folder, until it is freed."""

    def __init__(self, fmu: str | os.PathLike[str], name: str | None):
        self._fmu: Any = None
        self._at: Moment | None = None  # where the FMU is
        self._running = False
        self._turn = threading.RLock()  # FMI allows no calls of one FMU at the same time
        self._states: dict[int, c_void_p] = {}  # the FMU's own copies, by the Moment's id
        self._log: collections.deque[tuple[int, str]] = collections.deque(maxlen=20)
        self._made_folder: str | None = None
        self._path = path = a_path(fmu, "FmuSystem: fmu")
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            self._folder = self._unpacked(path)
            self.description = read_description(path, self._folder)
            self.version = int(self.description.fmiVersion[0])
            if self.description.coSimulation.canBeInstantiatedOnlyOncePerProcess and path.is_dir():
                self._made_folder = tempfile.mkdtemp(prefix="fmu-")  # with a library of its own
                shutil.copytree(path, self._made_folder, dirs_exist_ok=True)
                self._folder = Path(self._made_folder)
            self._library = library_of(path, self._folder, self.description)
            # whether the FMU can go back to where it was
            self.keeps_states = self.description.coSimulation.canGetAndSetFMUstate
            self.name = name or self.description.modelName
            undo.pop_all()

    def _unpacked(self, path: Path) -> Path:
        if path.is_dir():
            return path.resolve()
        if not path.exists():
            raise ContactSystemError(f"there is no {path}: give an FMU or its folder")
        self._made_folder = tempfile.mkdtemp(prefix="fmu-")
        with opened(path, "an FMU") as archive:
            total = sum(member.file_size for member in archive.infolist())
            within("FMU_BYTES", total, "bytes when unpacked", ContactSystemError)
            archive.extractall(self._made_folder)  # inside of it, whatever the names
        return Path(self._made_folder)

    # --- variables

    def select(self, names: Names | None, causality: str) -> PortVariables:
        """The variables of a port, by names of variables or of structures, which stand for all
        their variables of the causality, "input" or "output"; None stands for all there are."""
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
        """Say what initialization sets, and what is read after it and each step."""
        known = {v.name: v for v in self.description.modelVariables}
        for name, value in start_values.items():
            if name not in known:
                self._refuse_name(name, known)
            self._check_start(known[name], value)
        arrays = {k: v for k, v in start_values.items() if isinstance(v, (list, np.ndarray))}
        rows = {k: np.array(v, object).ravel() for k, v in arrays.items()}  # fmpy wants no matrix
        self._start_values, self._outputs = {**start_values, **rows}, outputs

    def _check_start(self, variable: Any, value: Any) -> None:
        """Refuse what fmpy would cut, or refuse without a name; it checks text and units."""
        if isinstance(value, (str, tuple)) or not carried(variable):
            return
        given, size = np.ravel(value), size_of(variable)
        if given.dtype == object and all(isinstance(x, int) for x in given):
            given = given.astype(float)
        problem: str | None = f"{variable.name} = {value!r}: give {size} of type {variable.type}"
        if variable.causality == "structuralParameter":
            problem = f"{variable.name} is a structural parameter; export the FMU with its value"
        elif given.dtype.kind in "biuf" and len(given) == size:
            problem = PortVariables([variable], self.version).check(given)
        if problem:
            raise ContactSystemError(f"{self.name}, start_values: {problem}")

    # --- life

    def begin(self, time: float, given: Given = ()) -> Moment:
        """Initialize at a time, with the inputs then."""
        with self._turn, self._doing("initialization", time):
            self._renew(time)
            fmu = self._fmu
            if self.version == 2:
                fmu.setupExperiment(startTime=time)
            given_first = dict(self._start_values)
            left = apply_start_values(fmu, self.description, given_first, settable_in_instantiated)
            fmu.enterInitializationMode(**{} if self.version == 2 else {"startTime": time})
            later = settable_in_initialization_mode
            if left := apply_start_values(fmu, self.description, dict(left), later):
                raise ContactSystemError(
                    f"{self.name}: {', '.join(left)} cannot be set at the start; only inputs, "
                    "parameters and variables with initial='exact' or 'approx' can"
                )
            for block, values in given:
                block.write(fmu, values)
            fmu.exitInitializationMode()
            self._running = True
            return self._here(time, stepped=False)

    def step(self, moment: Moment, given: Given, step: float) -> Moment:
        """From a moment to the next, with the inputs during it."""
        time, ends = moment.time, False
        with self._turn, self._doing(f"a step of {step:.6g} s", time):
            self._go_to(moment)
            for block, values in given:
                block.write(self._fmu, values)
            self._at = None  # until the step has succeeded
            try:
                done = self._fmu.doStep(time, step, not self.keeps_states)
            except FMICallException as error:
                ends = self._asks_to_end(error, time)
                if not ends:
                    raise
            else:
                if self.version == 3:
                    _, ends, early, last = done
                    if early and not ends and last < time + (1 - SLACK) * step:
                        raise FMICallException("fmi3DoStep, early return,", 2)
            # As Drake counts its samples: without a sum of rounding errors.
            return self._here(round(time / step + 1) * step, stepped=True, ends=ends)

    def _asks_to_end(self, error: FMICallException, time: float) -> bool:
        """Whether an FMU of FMI 2 has discarded what is left of a step from `time` on to end the
        simulation; one that cannot even begin the step has a reason to be told."""
        if self.version != 2 or error.status != fmi2Discard:
            return False
        ends = False
        with contextlib.suppress(FMICallException):
            ends = self._fmu.getBooleanStatus(fmi2Terminated)
            return ends and self._fmu.getRealStatus(fmi2LastSuccessfulTime) > time
        return ends

    def _here(self, time: float, stepped: bool, ends: bool = False) -> Moment:
        """The moment at which the FMU is."""
        values = [block.read(self._fmu) for block in self._outputs]
        self._at = moment = Moment(self, time, stepped, ends, values)
        if self.keeps_states:
            self._states[id(moment)] = self._fmu.getFMUState()
        return moment

    def _go_to(self, moment: Moment) -> None:
        """Bring the FMU back to a moment, if it is not there."""
        if self._at is moment:
            return
        state = self._states.get(id(moment))
        if state is None:
            why = "it has been reloaded since"
            if not self.keeps_states:
                now = "has failed" if self._at is None else f"is at t = {self._at.time:.6g} s"
                why = f"it {now}, and has no way back (canGetAndSetFMUstate is not true)"
            raise ContactSystemError(
                f"{self.name}: the FMU cannot go to this Context's t = {moment.time:.6g} s: {why}. "
                "Step one Context at a time, only forward, and begin again with a default Context "
                "and Simulator.Initialize(); or make an FmuSystem for each Context"
            )
        with self._doing("return to an earlier state", moment.time):
            self._fmu.setFMUState(state)
        self._at, self._running = moment, True

    def forget(self, moment: int) -> None:
        """Give back the FMU's copy of its state, by the Moment's id."""
        with self._turn:
            state = self._states.pop(moment, None)
            if state is not None:
                with contextlib.suppress(FMICallException):
                    self._fmu.freeFMUState(state)

    def _renew(self, time: float) -> None:
        """An instance that nothing was done to."""
        self._at, self._running = None, False
        if self._fmu is not None:
            try:
                self._fmu.reset()
                return
            except FMICallException:  # many tools leave it out
                self._free()
        with (
            self._doing(f"loading {self._path}", time),
            contextlib.chdir(os.getcwd()),
        ):  # fmpy may leave it
            fmu = fmpy.instantiate_fmu(
                str(self._folder),
                self.description,
                "CoSimulation",
                debug_logging=True,  # and not by category: some tools give errors none, or another
                logger=_note,
                library_path=str(self._library),
            )
        self._fmu = fmu
        if self.version == 2:
            _CALLBACKS[:] = [fmu.callbacks]

    @contextlib.contextmanager
    def _doing(self, what: str, time: float) -> Iterator[None]:
        """Errors of FMI calls inside, in words."""
        self._log.clear()
        outside = _LOG.set(self._log)
        try:
            yield
        except ContactSystemError:
            raise
        except Exception as error:  # fmpy raises bare ones when it loads
            self._at, self._running = None, False
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
        fmu, self._fmu, self._at = self._fmu, None, None
        if fmu is not None:
            if self._running:
                with contextlib.suppress(FMICallException):
                    fmu.terminate()
            fmu.freeInstance()
        self._running = False

    def close(self) -> None:
        """Terminate, free, unload, remove what was unpacked."""
        self._free()
        if self._made_folder is not None:
            shutil.rmtree(self._made_folder, ignore_errors=True)
