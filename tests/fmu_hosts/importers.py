"""Importers other than fmpy: ecos, libcosim (both run co-simulations) and CasADi (derivatives).

Each function takes an unpacked FMU and skips nothing: a tool that is missing raises `Unavailable`.
"""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np

from .native import Fmu, Unavailable

NANOSECOND = 1e-9


def with_fmpy(fmu: Fmu, names: Sequence[str], step: float, count: int) -> np.ndarray:
    """Scalar variables at communication points 1 to count, by fmpy: (count, n_names)."""
    result = fmpy.simulate_fmu(
        str(fmu.folder),
        model_description=fmu.description,
        fmi_type="CoSimulation",
        output=list(names),
        step_size=step,
        output_interval=step,
        stop_time=count * step,
    )
    return np.stack([result[name] for name in names], axis=1)[1:]


def with_ecos(fmu: Fmu, names: Sequence[str], step: float, count: int) -> np.ndarray:
    """The same by ecos (FMI 2 and 3; of FMI 3 it reads scalars only)."""
    try:
        from ecospy.EcosSimulation import EcosSimulation
        from ecospy.EcosSimulationStructure import EcosSimulationStructure
    except ImportError:
        raise Unavailable("ecospy is not installed") from None
    except OSError as error:
        raise Unavailable(f"ecospy does not load, on Debian it needs libtbb12: {error}") from None
    with EcosSimulationStructure() as structure:
        structure.add_model("planner", fmu.path)
        with EcosSimulation(structure=structure, step_size=step) as simulation:
            simulation.init()
            rows = []
            for _ in range(count):
                simulation.step()
                rows.append([simulation.get_real(f"planner::{name}") for name in names])
            simulation.terminate()
    return np.array(rows)


def with_libcosim(fmu: Fmu, names: Sequence[str], step: float, count: int) -> np.ndarray:
    """The same by libcosim (FMI 2; version 0.0.6 of its Python package crashes on any FMI 3)."""
    try:
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
        from libcosimpy.CosimObserver import CosimObserver
        from libcosimpy.CosimSlave import CosimLocalSlave
    except ImportError:
        raise Unavailable("libcosimpy is not installed") from None
    log_output_level(CosimLogLevel.ERROR)
    by_name = {v.name: v.valueReference for v in fmu.description.modelVariables}
    references = [by_name[name] for name in names]
    execution = CosimExecution.from_step_size(round(step / NANOSECOND))
    slave = CosimLocalSlave(str(fmu.path), "planner")
    index = execution.add_local_slave(slave)
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    rows = []
    for _ in range(count):
        assert execution.step()
        rows.append(observer.last_real_values(index, references))
    return np.array(rows)


# --- CasADi --------------------------------------------------------------------------------------


def casadi_function(
    fmu: Fmu, result: str, folder: Path
) -> tuple[ca.Function, list[str], list[str]]:
    """CasADi's import of an FMU for Model Exchange, in a new folder.

    The function of states and inputs, names of (states then inputs), names of results: "ode",
    derivatives, or "y", outputs; CasADi wants no variable twice, and some are both. It (3.8) knows
    no arrays of FMI 3, and is shown a model description without them.
    """
    shown = fmu.folder
    if fmu.version == "3.0":
        shown = shutil.copytree(fmu.folder, folder / "without_arrays", dirs_exist_ok=True)
        _leave_out_arrays(shown / "modelDescription.xml")
    builder = ca.DaeBuilder("fmu", str(shown), {"debug": False})
    states, inputs = builder.x(), builder.u()
    results = [f"der({name})" for name in states] if result == "ode" else builder.y()
    return builder.create("f", ["x", "u"], [result]), [*states, *inputs], results


def _leave_out_arrays(path: Path) -> None:
    tree = ET.parse(path)
    root = tree.getroot()
    variables, structure = root.find("ModelVariables"), root.find("ModelStructure")
    assert variables is not None and structure is not None
    arrays = [v for v in variables if v.find("Dimension") is not None]
    left_out = {v.attrib["valueReference"] for v in arrays}
    for v in arrays:
        variables.remove(v)
    for unknown in list(structure):
        if unknown.attrib["valueReference"] in left_out:
            structure.remove(unknown)
            continue
        known = unknown.attrib["dependencies"].split()
        unknown.set("dependencies", " ".join(r for r in known if r not in left_out))
    tree.write(path)
