"""Reference results inside an FMU, from the exact plan, with which a run of it is compared.

They are where layered standards put their files (FMI 3.0.2, section 2.5.1.5), with the manifest of
FMI-LS-REF.
"""

from __future__ import annotations

import os
from pathlib import Path

import fmpy
import numpy as np

from contact_system.errors import ContactSystemError
from contact_system.files import opened
from contact_system.plan import plan
from contact_system.scene import Scene

FOLDER = "extra/org.fmi-standard.fmi-ls-ref/"
RESULTS_FILE = f"{FOLDER}reference.csv"
BAR = 1e-10  # for `check_fmu`
ROWS = 51  # times, from the beginning to the end of the scene
RESULTS = {"points": ("finger.point", "object.point"), "twist": ("twist.angular", "twist.linear")}
"""Results of `Plan.evaluate` that exist at poles too -> the variables of a contact."""


def reference_files(scene: Scene) -> dict[str, bytes]:
    """File name inside the FMU -> bytes."""
    times = np.linspace(0.0, scene.duration, ROWS)
    if scene.duration in scene.window_edges:  # an FMU gives values after an edge, a plan before
        times = times[:-1]
    found = plan(scene, 1e-14).evaluate(times, *RESULTS)
    names, columns = ["time"], [times]
    for i in range(len(scene.contacts)):
        for result, variables in RESULTS.items():
            values = found[result][:, i].reshape(len(times), -1)
            names += [f"contact[{i + 1}].{v}.{axis}" for v in variables for axis in "xyz"]
            columns += [*values.T]
    rows = [names, *(map(repr, row) for row in np.transpose(columns).tolist())]
    text = "".join(f"{','.join(row)}\n" for row in rows)
    manifest = Path(__file__).with_name("fmi-ls-manifest.xml")
    return {f"{FOLDER}{manifest.name}": manifest.read_bytes(), RESULTS_FILE: text.encode()}


def check_fmu(path: str | os.PathLike[str]) -> float:
    """Run an FMU's Co-Simulation by fmpy against the reference results inside it.

    Parameters
    ----------
    path : path

    Returns
    -------
    float
        The greatest difference, as a fraction of the greatest value of its variable.

    Raises
    ------
    ContactSystemError
        The difference is greater than 1e-10, or there are no reference results.
    """
    with opened(path, "an FMU with reference results") as archive:
        text = archive.read(RESULTS_FILE).decode()
    names, *rows = (line.split(",") for line in text.splitlines())
    wanted = np.array(rows, dtype=float)
    known = {v.name for v in fmpy.read_model_description(str(path)).modelVariables}
    # an array's name is without .x, .y, .z
    output = {n if n in known else n.rpartition(".")[0]: None for n in names[1:]}
    times = {"stop_time": wanted[-1, 0], "output_interval": wanted[1, 0]}
    try:
        result = fmpy.simulate_fmu(str(path), fmi_type="CoSimulation", output=[*output], **times)
    except Exception as error:  # fmpy raises plain Exceptions
        raise ContactSystemError(f"{path}: Co-Simulation cannot be run here: {error}") from error
    found = np.hstack([result[name].reshape(len(result), -1) for name in ("time", *output)])
    if found.shape != wanted.shape:
        raise ContactSystemError(f"{path}: {len(found)} rows came out instead of {len(wanted)}")
    sizes = np.maximum(np.abs(wanted).max(axis=0), 1e-3)
    worst = float((np.abs(found - wanted) / sizes).max())
    if not worst <= BAR:
        raise ContactSystemError(
            f"{path}: off its reference results by {worst:.2g}, more than {BAR:g}"
        )
    return worst
