"""Importers of FMUs: each steps or integrates a file and gives values of variables.

A function takes an unpacked FMU, names of variables, a step size and a number of steps, and gives
the values after each step, (count, n_names). A tool that is missing raises `Unavailable`.
"""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import fmpy
import numpy as np
from scipy.integrate import solve_ivp

import contact_system as cs

from .native import Fmu, Unavailable

STEPPING, INTEGRATING = (
    ("fmpy", "ecos", "libcosim", "container", "fmuloader"),
    ("fmpy", "fmuloader", "casadi"),
)
STEP = 2.0**-5  # ecos adds steps up; sums of this one are exact
NANOSECOND = 1e-9
Names = Sequence[str]


def _import(module: str, package: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        raise Unavailable(f"{package} is not installed") from None
    except OSError as error:
        raise Unavailable(f"{package} does not load: {error}") from None


def references_of(fmu: Fmu, names: Names) -> list[int]:
    found = {v.name: v.valueReference for v in fmu.description.modelVariables}
    return [found[name] for name in names]


def _by_fmpy(file: Path, names: Names, step: float, count: int, **options: Any) -> np.ndarray:
    given = {"output": list(names), "output_interval": step, "stop_time": count * step} | options
    result = fmpy.simulate_fmu(str(file), **given)
    return np.stack([result[name] for name in names], axis=1)[1:]


def off_plan(
    run: Callable[..., np.ndarray], fmu: Fmu, scene: cs.Scene, count: int, step: float = STEP
) -> float:
    """Greatest difference of points and slip from the plan's, over the greatest of each."""
    contacts, plan = range(len(scene.contacts)), cs.plan(scene, 1e-14)
    t, worst = np.minimum(step * np.arange(1, count + 1), scene.duration), 0.0
    wanted = {"slip": plan.slip(t)}
    wanted |= {f"{s}.point": plan.points(t)[:, :, k] for k, s in enumerate(("finger", "object"))}
    names = {
        q: [f"contact[{i + 1}].{q}.{axis}" for i in contacts for axis in "xyz"[: x.shape[2]]]
        for q, x in wanted.items()
    }
    found = run(fmu, sum(names.values(), []), step, count)
    for quantity, values in wanted.items():
        columns, found = np.split(found, [len(names[quantity])], axis=1)
        off = np.abs(columns - values.reshape(count, -1)).max()
        worst = max(worst, off / np.abs(values).max())
    return worst


# --- Co-Simulation -------------------------------------------------------------------------------


def fmpy_steps(fmu: Fmu, names: Names, step: float, count: int) -> np.ndarray:
    return _by_fmpy(fmu.path, names, step, count, fmi_type="CoSimulation", step_size=step)


def ecos_steps(fmu: Fmu, names: Names, step: float, count: int) -> np.ndarray:
    """On Debian ecos needs libtbb12."""
    run = _import("ecospy.EcosSimulation", "ecospy").EcosSimulation
    structure = _import("ecospy.EcosSimulationStructure", "ecospy").EcosSimulationStructure
    with structure() as system:
        system.add_model("planner", fmu.path)
        with run(structure=system, step_size=step) as simulation:
            simulation.init()
            rows = []
            for _ in range(count):
                simulation.step()
                rows.append([simulation.get_real(f"planner::{name}") for name in names])
            simulation.terminate()
    return np.array(rows)


def libcosim_steps(fmu: Fmu, names: Names, step: float, count: int) -> np.ndarray:
    if fmu.version == "3.0":
        # libcosim reports "Unsupported FMI version", then libcosimpy uses a null pointer
        raise Unavailable("libcosim takes FMI 1 and FMI 2 only")
    part = lambda name: _import(f"libcosimpy.{name}", "libcosimpy")  # noqa: E731
    part("CosimLogging").log_output_level(part("CosimLogging").CosimLogLevel.ERROR)
    execution = part("CosimExecution").CosimExecution.from_step_size(round(step / NANOSECOND))
    index = execution.add_local_slave(part("CosimSlave").CosimLocalSlave(str(fmu.path), "planner"))
    observer = part("CosimObserver").CosimObserver.create_last_value()
    execution.add_observer(observer)
    rows, references = [], references_of(fmu, names)
    for _ in range(count):
        assert execution.step()
        rows.append(observer.last_real_values(index, references))
    return np.array(rows)


def container_steps(fmu: Fmu, names: Names, step: float, count: int) -> np.ndarray:
    """In a container FMU of fmu-manipulation-toolbox, of the same FMI version, by fmpy."""
    assembly = _import("fmu_manipulation_toolbox.assembly", "fmu-manipulation-toolbox")
    node = assembly.AssemblyNode("container.fmu", step_size=step)
    node.add_fmu(fmu.path.name)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / fmu.path.name).write_bytes(fmu.path.read_bytes())
        node.make_fmu(Path(folder), fmi_version=int(fmu.version[0]))
        return fmpy_steps(
            Fmu.unpacked(Path(folder) / node.name, Path(folder) / "x"), names, step, count
        )


def fmuloader_steps(fmu: Fmu, names: Names, step: float, count: int) -> np.ndarray:
    one, read = _loaded(fmu, "CoSimulation")
    rows, references = [], references_of(fmu, names)
    for k in range(count):
        one.do_step(k * step, step)
        rows.append(read(references))
    return np.array(rows)


def _loaded(fmu: Fmu, interface: str) -> tuple[Any, Callable]:
    """An initialized instance of fmuloader, and its function that reads values."""
    version, name = fmu.version[0], fmu.description.coSimulation.modelIdentifier
    library = _import(f"fmuloader.fmi{version}", "fmuloader")
    one = getattr(library, f"Fmi{version}Slave")(fmu.folder, model_identifier=name)
    if version == "2":
        kind = {"CoSimulation": "CO_SIMULATION", "ModelExchange": "MODEL_EXCHANGE"}[interface]
        one.instantiate("planner", library.Fmi2Type[kind], guid=fmu.token)
        one.setup_experiment()
    else:
        kind = {"CoSimulation": "co_simulation", "ModelExchange": "model_exchange"}[interface]
        getattr(one, f"instantiate_{kind}")("planner", instantiation_token=fmu.token)
    one.enter_initialization_mode()
    one.exit_initialization_mode()
    return one, one.get_real if version == "2" else one.get_float64


class _Wasm:
    """The FMU's library for wasm32 in wasmtime, for which the FMU's folder is the root folder."""

    def __init__(self, fmu: Fmu):
        w = _import("wasmtime", "wasmtime")
        config = w.Config()
        config.wasm_exceptions = True
        engine = w.Engine(config)
        linker, self.store, wasi = w.Linker(engine), w.Store(engine), w.WasiConfig()
        linker.define_wasi()
        wasi.preopen_dir(str(fmu.folder), "/")
        self.store.set_wasi(wasi)
        module = w.Module.from_file(engine, str(fmu.library("wasm32")))
        self.found = linker.instantiate(self.store, module).exports(self.store)
        self.call("_initialize")

    def call(self, name: str, *arguments: float) -> Any:
        return self.found[name](self.store, *arguments)

    def put(self, data: bytes) -> int:
        """Copy data into the library's memory; its address there."""
        at = self.call("malloc", len(data))
        self.found["memory"].write(self.store, data, at)
        return at

    def numbers(self, at: int, count: int) -> np.ndarray:
        return np.frombuffer(self.found["memory"].read(self.store, at, at + 8 * count))


def wasm_steps(fmu: Fmu, names: Names, step: float, count: int) -> np.ndarray:
    """By wasmtime; the FMU is one of FMI 3 with a library for wasm32."""
    host, n, rows = _Wasm(fmu), len(names), []
    texts = (host.put(text.encode() + b"\0") for text in ("planner", fmu.token, "/resources/"))
    one = host.call("fmi3InstantiateCoSimulation", *texts, *(0,) * 9)
    assert host.call("fmi3EnterInitializationMode", one, 0, 0.0, 0.0, 0, 0.0) == 0
    assert host.call("fmi3ExitInitializationMode", one) == 0
    references = host.put(np.array(references_of(fmu, names), "<u4").tobytes())
    results, values = host.put(bytes(32)), host.put(bytes(8 * n))
    flags = (results, results + 4, results + 8, results + 16)
    for k in range(count):
        assert host.call("fmi3DoStep", one, k * step, step, 1, *flags) == 0
        assert host.call("fmi3GetFloat64", one, references, n, values, n) == 0
        rows.append(host.numbers(values, n))
    return np.array(rows)


# --- Model Exchange ----------------------------------------------------------------------------


def fmpy_integrates(fmu: Fmu, names: Names, step: float, count: int) -> np.ndarray:
    given = {"fmi_type": "ModelExchange", "solver": "CVode"}
    return _by_fmpy(fmu.path, names, step, count, record_events=False, **given)


def fmuloader_integrates(fmu: Fmu, names: Names, step: float, count: int) -> np.ndarray:
    """By scipy, from each time event to the next."""
    one, read = _loaded(fmu, "ModelExchange")
    n, rows, references = len(fmu.description.derivatives), [], references_of(fmu, names)
    rates = one.get_derivatives if fmu.version == "2.0" else one.get_continuous_state_derivatives

    def update() -> float:
        """Update discrete states; the time of the next event."""
        if fmu.version == "2.0":
            found = one.new_discrete_states()
            one.enter_continuous_time_mode()
            return found.nextEventTime if found.nextEventTimeDefined else np.inf
        found = one.update_discrete_states()
        one.enter_continuous_time_mode()
        return found.next_event_time if found.next_event_time_defined else np.inf

    def derivatives(t: float, x: np.ndarray) -> np.ndarray:
        one.set_time(t)
        one.set_continuous_states(list(x))
        return np.array(rates(n))

    event, t = update(), 0.0
    x = np.array(one.get_continuous_states(n))
    for k in range(count):
        while t < (k + 1) * step:
            stop = min(event, (k + 1) * step)
            x = solve_ivp(derivatives, (t, stop), x, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
            derivatives(t := stop, x)  # sets time and states
            if t == event:
                one.enter_event_mode()
                event = update()
        rows.append(read(references))
    return np.array(rows)


def casadi_function(fmu: Fmu, arguments: Names, result: str) -> tuple[ca.Function, ca.DaeBuilder]:
    """CasADi's function from some of "t", "x" and "u" to a result, and its model builder."""
    builder = ca.DaeBuilder("fmu", str(fmu.folder), {"debug": False})
    return builder.create("f", [*arguments], [result]), builder


def casadi_integrates(fmu: Fmu, names: Names, step: float, count: int) -> np.ndarray:
    """By CasADi's CVODES. It knows no events, so this is for models without windows."""
    rates, builder = casadi_function(fmu, ["t", "x", "u"], "ode")
    results, _ = casadi_function(fmu, ["t", "x", "u"], "y")
    t, x, u = ca.MX.sym("t"), ca.MX.sym("x", rates.size1_in(1)), np.zeros(rates.size1_in(2))
    grid = step * np.arange(1, count + 1)
    tolerance = float(fmu.description.defaultExperiment.tolerance)
    options = {"reltol": tolerance, "abstol": 0.1 * tolerance, "max_num_steps": 100_000}
    system = {"t": t, "x": x, "ode": rates(t, x, u)}
    start = builder.start(builder.x())
    found = ca.integrator("sim", "cvodes", system, 0.0, grid, options)(x0=start)["xf"].full()
    columns = [builder.y().index(name) for name in names]
    rows = [results(t, x, u).full().ravel()[columns] for t, x in zip(grid, found.T)]
    return np.array(rows)
