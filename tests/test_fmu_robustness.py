"""FMUs in C programs: random calls under sanitizers, traps, memory, threads.

`python -m benchmarks fmu --only fuzz`, or `endurance`, does the same at length.
"""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("fmpy")

from fmu_hosts import EVERYTHING
from fmu_hosts.native import Fmu, Program, Unavailable

from fmu_export import export_fmu


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def fmu(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("robust")
    path = export_fmu(EVERYTHING, folder / "everything.fmu", request.param, measured="pose")
    return Fmu.unpacked(path, folder / "everything")


def program(name, fmu, **options):
    try:
        return Program(name, fmu, **options)
    except Unavailable as error:
        pytest.skip(str(error))


def test_random_calls_and_damaged_state_bytes_are_answered_or_refused_without_a_crash(fmu):
    calls, accepted, *_ = (
        program("fuzz", fmu, sanitized=True).run(100, 100, 1, *fmu.model_arguments()).split()
    )
    assert int(calls) > 2_000
    assert int(accepted) > 0.2 * int(calls), "hardly any call was legal"


def test_steps_raise_no_floating_point_exception(fmu):
    found = program("trajectory", fmu).table(0.01, 90, *fmu.model_arguments())
    assert len(found) == 91 and np.isfinite(found).all()


def test_steps_allocate_no_memory(fmu):
    found = program("endurance", fmu).table("memory", 1e-2, 100, 100, *fmu.model_arguments())
    inside, heap, process = found[0]  # allocations in steps; growth of heap and of process
    assert inside == 0 and heap < 1000 and process < 64_000, (
        "less than a byte a run, a page at most"
    )


def test_instances_in_two_threads_give_the_same_bits_as_one_alone(fmu):
    found = program("endurance", fmu).table("threads", 5e-3, 200, 64, *fmu.model_arguments())
    assert found.tolist() == [[0]]
