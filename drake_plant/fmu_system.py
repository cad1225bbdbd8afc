"""Any co-simulation FMU, FMI 2.0 or 3.0, as a Drake system."""

from __future__ import annotations

import collections
import contextlib
import itertools
import math
import os
import re
import shutil
import struct
import tempfile
import threading
import weakref
from collections.abc import Iterable, Iterator, Mapping, Sequence
from ctypes import c_void_p
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, LeafSystem, State

from contact_system.archives import opened, unpack
from contact_system.checks import did_you_mean, finite_number, require_regular, within
from contact_system.errors import ContactSystemError

from .lifetimes import NO_DICTIONARY, weakly

try:
    import fmpy
except ImportError as error:
    raise ImportError('FmuSystem needs fmpy: pip install "contact-system[fmu]"') from error

from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Discard, fmi2LastSuccessfulTime, fmi2Terminated
from fmpy.simulation import settable_in_initialization_mode, settable_in_instantiated

Array = np.ndarray
Names = str | Sequence[str]
Given = Iterable[tuple["PortVariables", Array]]

SLACK = 1e-6
"""By how much of a step the Context's time and the FMU's may differ."""
WARNING, FATAL = 1, 4  # statuses, the same in FMI 2 and 3
# FMI type -> numpy's, for what a vector port can carry.
KINDS: dict[str, Any] = {"Real": np.float64, "Integer": np.int32, "Boolean": np.bool_}
KINDS |= {"Float32": np.float32, "Float64": np.float64}
KINDS |= {"Int8": np.int8, "Int16": np.int16, "Int32": np.int32, "Int64": np.int64}
KINDS |= {"UInt8": np.uint8, "UInt16": np.uint16, "UInt32": np.uint32, "UInt64": np.uint64}
TEXTS = {"String": str, "Binary": bytes}  # what start values may be besides


# --- variables -----------------------------------------------------------------------------------


class PortVariables:
    """The variables of one port, read or written by one call for each FMI type.

    Parameters
    ----------
    variables : list of fmpy's ModelVariable
    version : 2 or 3

    Attributes
    ----------
    names : tuple of str
        Of the elements, ``x[2]`` for an element of an array.
    """

    def __init__(self, variables: Sequence[Any], version: int):
        self.names = tuple(itertools.chain.from_iterable(map(_element_names, variables)))
        self._calls: list[tuple[str, list[int], Array]] = []
        first = np.cumsum([0, *(_size(v) for v in variables)])
        for kind in dict.fromkeys(_kind(v, version) for v in variables):
            some = [i for i, v in enumerate(variables) if _kind(v, version) == kind]
            rows = np.concatenate([np.arange(first[i], first[i + 1]) for i in some])
            self._calls.append((kind, [variables[i].valueReference for i in some], rows))
        self._version = version

    def read(self, fmu: Any) -> Array:
        """Values of all elements: (n,)."""
        values = np.empty(len(self.names))
        for kind, references, rows in self._calls:
            sizes = () if self._version == 2 else (len(rows),)
            values[rows] = getattr(fmu, f"get{kind}")(references, *sizes)
        return values

    def write(self, fmu: Any, values: Array) -> None:
        """Set all elements; values: (n,), as :meth:`check` lets through."""
        for kind, references, rows in self._calls:
            getattr(fmu, f"set{kind}")(references, values[rows].astype(KINDS[kind]).tolist())

    def check(self, values: Array) -> str | None:
        """What the variables cannot take, in words."""
        for kind, _, rows in self._calls:
            given = values[rows]
            with np.errstate(invalid="ignore", over="ignore"):
                cast = given.astype(KINDS[kind])
            fine = cast == given if kind != "Float32" else np.isfinite(cast) | np.isinf(given)
            if not fine.all():
                row = rows[~fine][0]
                what = f"not of type {kind}" if values[row] == values[row] else "not a number"
                return f"element {row}, {self.names[row]} = {values[row]:.17g}, is {what}"
        return None


def _kind(variable: Any, version: int) -> str:
    """The FMI type whose functions get and set a variable."""
    if variable.type == "Enumeration":
        return "Integer" if version == 2 else "Int64"
    return variable.type


def _size(variable: Any) -> int:
    return math.prod(variable.shape or ())


def _element_names(variable: Any) -> list[str]:
    """Names of a variable's elements, row by row, counted from 1 as FMI does."""
    if not variable.shape:
        return [variable.name]
    indices = itertools.product(*(range(1, n + 1) for n in variable.shape))
    return [f"{variable.name}[{','.join(map(str, index))}]" for index in indices]


def _carried(variable: Any) -> bool:
    """Whether a vector port can carry a variable."""
    return variable.type == "Enumeration" or variable.type in KINDS


# --- files ---------------------------------------------------------------------------------------


def _read_description(fmu: Path, folder: Path) -> Any:
    """Of an FMU that FmuSystem can run; or an error that says why it cannot."""
    try:
        xml = folder / "modelDescription.xml"
        require_regular(xml)
        within("DESCRIPTION_BYTES", xml.stat().st_size, "bytes", ContactSystemError)
        description = fmpy.read_model_description(str(folder), validate=False)
        _require_sane(description)
    except Exception as error:  # fmpy raises bare ones
        raise ContactSystemError(
            f"{fmu}: its modelDescription.xml is not one of FMI 2 or 3: {type(error).__name__}: "
            f"{error}; export it again"
        ) from error
    if not description.fmiVersion.startswith(("2.", "3.")):
        raise ContactSystemError(
            f"{fmu} is of FMI {description.fmiVersion}; FmuSystem runs 2.0 and 3.0: "
            "export it again as one of them"
        )
    if description.coSimulation is None:
        raise ContactSystemError(
            f"{fmu} has no co-simulation interface, and FmuSystem has no solver for others: "
            "export it again with co-simulation"
        )
    return description


def _require_sane(description: Any) -> None:
    """What is used of a description and fmpy takes as it is."""
    for v in description.modelVariables:
        if not v.name or min(v.shape or (0,)) < 0:
            raise ContactSystemError(f"variable {v.name!r} has shape {v.shape}")
    elements = sum(map(_size, description.modelVariables))
    within("FMU_ELEMENTS", elements, "elements of all its variables", ContactSystemError)
    if description.coSimulation is not None:
        name = description.coSimulation.modelIdentifier
        if not re.fullmatch(r"[A-Za-z_]\w{0,199}", str(name), re.ASCII):  # it names a file
            raise ContactSystemError(f"modelIdentifier = {name!r} is no plain word, as C has them")


def _require_whole(fmu: Path, library: Path) -> None:
    """Refuse a library of Linux that is cut: to load it would end the process."""
    with open(library, "rb") as file:
        head = file.read(64)
        if len(head) < 64 or head[:6] != b"\x7fELF\2\1":  # what loads it names what it is not
            return
        programs, sections = struct.unpack_from("<QQ", head, 32)
        sizes = struct.unpack_from("<4H", head, 54)  # of an entry of each, how many
        file.seek(min(programs, 1 << 40))
        rows = file.read(sizes[0] * sizes[1])
    ends = [programs + sizes[0] * sizes[1], sections + sizes[2] * sizes[3]]
    for k in range(0, len(rows) - 39, max(sizes[0], 1)):
        ends.append(sum(struct.unpack_from("<Q16xQ", rows, k + 8)))
    if max(ends) > library.stat().st_size:
        raise ContactSystemError(
            f"{fmu}: its library {library.name} is cut, of {library.stat().st_size} bytes where "
            f"{max(ends)} belong; export it again"
        )


def _library(fmu: Path, folder: Path, description: Any) -> Path:
    """The shared library for this machine."""
    name = description.coSimulation.modelIdentifier + fmpy.sharedLibraryExtension
    places = [fmpy.platform_tuple]
    if description.fmiVersion.startswith("2."):  # has names of its own for the older machines
        places.append(fmpy.platform)
    for place in places:
        path = folder / "binaries" / place / name
        if path.is_file():
            _require_whole(fmu, path)
            return path
    there = ", ".join(sorted(p.parent.name for p in folder.glob("binaries/*/*"))) or "none"
    remedy = "export it again for this machine"
    if any(folder.glob("sources/*.c")):
        remedy += f", or compile its sources here: python -m fmpy compile {fmu}"
    raise ContactSystemError(
        f"{fmu} has no binaries/{' or '.join(places)}/{name}; platforms that it has: {there}; "
        + remedy
    )


# --- the FMU -------------------------------------------------------------------------------------


class Moment:
    """What the Context holds of an FMU: when it is, its outputs, and how to go back there.

    It never changes, so clones of a Context share it; the FMU's copy of its state is given back
    with the last of them.
    """

    __slots__ = ("_instance", "time", "stepped", "values", "key")

    def __init__(
        self, instance: Instance, time: float, stepped: bool, values: list[Array], key: int | None
    ):
        self._instance, self.time, self.stepped = instance, time, stepped
        self.values, self.key = values, key

    def __deepcopy__(self, memo: Any) -> Moment:
        return self

    def __del__(self) -> None:
        self._instance.forget(self.key)


class Instance:
    """One FMU in this process: unpacked, loaded, initialized, stepped, freed.

    Parameters
    ----------
    fmu : path
        An .fmu file, or a folder that one was unpacked to.
    name : str or None
        By default the model's.

    Raises
    ------
    ContactSystemError
        No FMU of FMI 2 or 3 with co-simulation for this platform.
    """

    def __init__(self, fmu: str | os.PathLike, name: str | None):
        self._fmu: Any = None
        self._at: Moment | None = None  # where the FMU is
        self._running = False
        self._turn = threading.RLock()  # FMI allows no calls of one FMU at the same time
        self._states: dict[int, c_void_p] = {}  # the FMU's own copies of its state
        self._keys = itertools.count()
        self._log: collections.deque[tuple[int, str]] = collections.deque(maxlen=20)
        self._start_values: list[tuple[Any, list[Any]]] = []  # variables of fmpy's, elements
        self._outputs: list[PortVariables] = []
        self._made_folder: str | None = None
        if not isinstance(fmu, (str, os.PathLike)):
            raise ContactSystemError(f"fmu = {fmu!r:.80}: give the path of an FMU or its folder")
        if name is not None and not isinstance(name, str):
            raise ContactSystemError(f"instance_name = {name!r}: give a text, or None")
        self._path = path = Path(fmu)
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            self._folder = self._unpacked(path)
            self.description = _read_description(path, self._folder)
            self.version = int(self.description.fmiVersion[0])
            self._library = _library(path, self._folder, self.description)
            self.name = name or self.description.modelName
            undo.pop_all()

    def _unpacked(self, path: Path) -> Path:
        if path.is_dir():
            return path.resolve()
        if not path.exists():
            raise ContactSystemError(f"there is no {path}: give an FMU or its folder")
        self._made_folder = tempfile.mkdtemp(prefix="fmu-")
        with opened(path, "an FMU") as archive:
            unpack(archive, Path(self._made_folder), "FMU_BYTES")
        return Path(self._made_folder)

    @property
    def keeps_states(self) -> bool:
        """Whether the FMU can go back to where it was."""
        return self.description.coSimulation.canGetAndSetFMUstate

    # --- variables

    def select(self, names: Names | None, causality: str) -> PortVariables:
        """The variables of a port.

        Parameters
        ----------
        names : str, sequence of str or None
            Of variables, or of structures, which stand for all their variables of the causality.
            None: all of it.
        causality : "input" or "output"
        """
        every = self.description.modelVariables
        pool = [v for v in every if v.causality == causality and _carried(v)]
        if names is None:
            return PortVariables(pool, self.version)
        listed = [names] if isinstance(names, str) else names
        if not isinstance(listed, Iterable):
            raise ContactSystemError(
                f"{self.name}: {causality}s = {names!r}: give names of variables, or a mapping of "
                "port names to those"
            )
        by_name = {v.name: v for v in every}
        found: list[Any] = []
        for name in map(str, listed):
            inside = [v for v in pool if v.name.startswith((f"{name}.", f"{name}["))]
            if name not in by_name and not inside:
                known = by_name if causality == "output" else [v.name for v in pool]
                self._refuse_name(name, known, f"{causality} ")
            found.extend([by_name[name]] if name in by_name else inside)
        for v in found:
            if not _carried(v) or (causality == "input" and v.causality != "input"):
                raise ContactSystemError(
                    f"{self.name}: {v.name}, {v.causality} of type {v.type}, cannot be on an "
                    f"{causality} port: leave it out"
                )
        return PortVariables(found, self.version)

    def _refuse_name(self, name: str, known: Iterable[str], what: str = "") -> None:
        hint = did_you_mean(name, known) or "; see modelDescription.xml"
        raise ContactSystemError(f"{self.name} has no {what}variable {name!r}{hint}")

    def prepare(self, start_values: Mapping[str, Any], outputs: list[PortVariables]) -> None:
        """Say what initialization sets, and what is read after it and each step."""
        if not isinstance(start_values, Mapping):
            raise ContactSystemError(
                f"{self.name}: start_values = {start_values!r}: give a mapping of names to values"
            )
        variables = {v.name: v for v in self.description.modelVariables}
        for name, value in start_values.items():
            if name not in variables:
                self._refuse_name(name, variables)
            self._start_values.append((variables[name], self._start_value(variables[name], value)))
        self._outputs = outputs

    def _start_value(self, variable: Any, value: Any) -> list[Any]:
        """As fmpy's setters take it."""
        block, kind = PortVariables([variable], self.version), _kind(variable, self.version)
        problem: str | None = f"{variable.name} = {value!r} is not of type {variable.type}"
        try:
            array = np.array(value, dtype=object)
        except ValueError:  # arrays of several shapes
            raise ContactSystemError(f"{self.name}: start value: {problem}") from None
        given, shape = array.ravel().tolist(), tuple(variable.shape or ())
        if array.ndim > 1 and array.shape != shape:  # such as a transposed matrix
            problem = f"{variable.name} has shape {shape}, not {array.shape}"
        elif len(given) != len(block.names):
            problem = f"{variable.name} has {len(block.names)} elements, not {len(given)}"
        elif kind in TEXTS:
            problem = None if all(isinstance(v, TEXTS[kind]) for v in given) else problem
        elif not _carried(variable):
            return given
        elif issubclass(KINDS[kind], np.integer):  # no floats, which have 53 bits
            with contextlib.suppress(TypeError, ValueError, OverflowError):
                whole, info = [int(v) for v in given], np.iinfo(KINDS[kind])
                if whole == given and all(info.min <= v <= info.max for v in whole):
                    return whole
        else:
            with contextlib.suppress(TypeError, ValueError, OverflowError):
                values = np.array([0 + v for v in given], dtype=float)  # no texts
                problem = block.check(values)
                if not problem:
                    return values.astype(KINDS[kind]).tolist()
        if problem:
            raise ContactSystemError(f"{self.name}: start value: {problem}")
        return given

    # --- life

    def begin(self, time: float, given: Given = ()) -> Moment:
        """Initialize.

        Parameters
        ----------
        time : float
            s.
        given : pairs of a PortVariables and values
            Inputs at that time.
        """
        later = [v for v in self._start_values if not settable_in_instantiated(v[0])]
        wrong = [v.name for v, _ in later if not settable_in_initialization_mode(v)]
        wrong += [v.name for v, _ in self._start_values if v.causality == "structuralParameter"]
        if wrong:
            raise ContactSystemError(
                f"{self.name}: {', '.join(wrong)} cannot be set at the start; only inputs, "
                "parameters and variables with initial='exact' or 'approx' can"
            )
        with self._turn, self._doing("initialization", time):
            self._renew(time)
            fmu = self._fmu
            if self.version == 2:
                fmu.setupExperiment(startTime=time)
            self._set([v for v in self._start_values if v not in later])
            fmu.enterInitializationMode(**{} if self.version == 2 else {"startTime": time})
            self._set(later)
            for block, values in given:
                block.write(fmu, values)
            fmu.exitInitializationMode()
            self._running = True
            return self._here(time, stepped=False)

    def _set(self, start_values: Iterable[tuple[Any, list[Any]]]) -> None:
        for variable, values in start_values:
            kind = _kind(variable, self.version)
            getattr(self._fmu, f"set{kind}")([variable.valueReference], values)

    def step(self, moment: Moment, given: Given, step: float) -> tuple[Moment, bool]:
        """From a moment to the next; also whether the FMU wants to end the simulation.

        Parameters
        ----------
        moment : Moment
        given : pairs of a PortVariables and values
            Inputs during the step.
        step : float
            s.
        """
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
            return self._here(round(time / step + 1) * step, stepped=True), ends

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

    def _here(self, time: float, stepped: bool) -> Moment:
        """The moment at which the FMU is."""
        values = [block.read(self._fmu) for block in self._outputs]
        key = None
        if self.keeps_states:
            key = next(self._keys)
            self._states[key] = self._fmu.getFMUState()
        self._at = moment = Moment(self, time, stepped, values, key)
        return moment

    def _go_to(self, moment: Moment) -> None:
        """Bring the FMU back to a moment, if it is not there."""
        if self._at is moment:
            return
        state = None if moment.key is None else self._states.get(moment.key)
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

    def forget(self, key: int | None) -> None:
        """Give back the FMU's copy of its state."""
        with self._turn:
            state = None if key is None else self._states.pop(key, None)
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
                debug_logging=True,
                logger=self._note,
                library_path=str(self._library),
            )
        self._fmu = fmu
        categories = [category.name for category in self.description.logCategories]
        status = [name for name in categories if name.startswith("logStatus")]
        if status:  # and not what it says about each step
            with contextlib.suppress(FMICallException):
                fmu.setDebugLogging(True, status)

    def _note(self, *said: Any) -> None:
        """What the FMU says; FMI 2 has an instance's name before the status."""
        status, _, message = said[-3:]
        self._log.append((status, (message or b"").decode(errors="replace").strip()))

    @contextlib.contextmanager
    def _doing(self, what: str, time: float) -> Iterator[None]:
        """Errors of FMI calls inside, in words."""
        self._log.clear()
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

    def _free(self) -> None:
        for key in list(self._states):
            self.forget(key)
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


# --- the system ----------------------------------------------------------------------------------


class FmuSystem(LeafSystem):
    """A co-simulation FMU, FMI 2.0 or 3.0, stepped at a fixed period.

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

    As with Drake's own discrete systems, an update at t = k `step` samples the inputs, and what the
    FMU says of t + `step` is on the outputs until then: whoever looks at t = k `step` sees what the
    FMU says of that time. The outputs change in discrete updates, so that systems updated at the
    same time, in whichever way, see the values before it. The FMU samples its inputs itself: a
    ZeroOrderHold before them would delay by a `step`. Inputs that are not connected keep their
    start values.

    Initialization gives the FMU the Context's time, which has to be a multiple of `step`, and the
    inputs. A default Context is at t = 0 s.

    The FMU's state is an abstract state, the outputs are discrete ones, so that Contexts can be
    cloned, put aside and gone back to. This needs an FMU with canGetAndSetFMUstate. Any other can
    step one Context at a time and only forward; a second one is refused. Threads that share the
    system take turns.

    The FMU is freed, and what was unpacked of it removed, with the system.

    Parameters
    ----------
    fmu : path
        An .fmu file, or a folder that one was unpacked to.
    step : float
        Communication step, s.
    inputs, outputs : str, sequence of str, or mapping of port names to those, optional
        Variables of `u` and `y`, or of ports of other names. A name is that of a variable, or of a
        structure, which stands for all inputs or outputs in it: ``"contact[1].slip"`` for
        ``contact[1].slip.x`` and ``contact[1].slip.y``. An output may be any variable.
    start_values : mapping, optional
        Of parameters, and whatever else may be set before initialization.
    instance_name : str, optional
        By default the model's; messages begin with it.

    Attributes
    ----------
    input_names, output_names : dict
        Port name -> the variable of each element, such as ``("x[1]", "x[2]", "on")``.

    Raises
    ------
    ContactSystemError
        An FMU without co-simulation or without a library for this platform, an unknown variable, a
        value that cannot be set. In a simulation: an input that is not a number, a call that the
        FMU refuses, a Context that the FMU cannot return to.
    ImportError
        fmpy is not installed.

    Notes
    -----
    When the FMU asks to end the simulation within a step, the update returns
    EventStatus.ReachedTermination and Simulator.AdvanceTo ends there.
    """

    __slots__ = NO_DICTIONARY

    def __init__(
        self,
        fmu: str | os.PathLike,
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
        # The outputs follow in a discrete update, because those come after unrestricted ones: a
        # discrete system downstream would see them a step ahead.
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
        """Initialize, but for a Context that comes out of a simulation: that one goes on."""
        time, moment, step = context.get_time(), self._Moment(context), self._step
        if moment.stepped:
            if not -SLACK <= (moment.time - time) / step <= 1 + SLACK:
                self._RefuseTime(time, moment)
            return
        if not math.isfinite(time) or abs(time - round(time / step) * step) > SLACK * step:
            raise ContactSystemError(
                f"{self._instance.name}: t = {time!r} s is not a multiple of the step of {step:g} "
                "s, so that no update would come at the start: set the Context's time to one"
            )
        moment = self._instance.begin(time, list(self._Given(context)))
        state.get_mutable_abstract_state().get_mutable_value(self._moment).set_value(moment)
        for i, values in enumerate(moment.values):
            state.get_mutable_discrete_state(i).get_mutable_value()[:] = values

    def _Step(self, context: Context, state: State) -> EventStatus:
        time, moment = context.get_time(), self._Moment(context)
        ahead = (moment.time - time) / self._step
        if abs(ahead - 1) < SLACK:  # a Simulator before this one did this update and stopped here
            return EventStatus.DidNothing()
        if abs(ahead) > SLACK:
            self._RefuseTime(time, moment)
        moment, ends = self._instance.step(moment, list(self._Given(context)), self._step)
        state.get_mutable_abstract_state().get_mutable_value(self._moment).set_value(moment)
        if ends:
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
    """Port name -> its variables; a port without variables is left out."""
    ports = chosen if isinstance(chosen, Mapping) else {usual: chosen}
    for port in ports:
        if not isinstance(port, str) or not port:  # Drake ends the process for the latter
            raise ContactSystemError(
                f"{instance.name}: {port!r}, a key of {causality}s, is no port name: give a text"
            )
    found = {port: instance.select(names, causality) for port, names in ports.items()}
    given: dict[str, str] = {}
    for port, name in ((k, n) for k in found for n in found[k].names if causality == "input"):
        if name in given:  # the last one would be what the FMU sees
            raise ContactSystemError(
                f"{instance.name}: input variable '{name}' would be set twice, by the input port "
                f"'{given[name]}' and by '{port}': name it once"
            )
        given[name] = port
    return {port: block for port, block in found.items() if block.names}
