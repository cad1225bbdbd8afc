"""Importers other than fmpy get the same numbers out of an FMU."""

from __future__ import annotations

import numpy as np
import pytest

import contact_system as cs

pytest.importorskip("fmpy")

from fmu_hosts.importers import (
    casadi_function,
    kernel_jacobian,
    with_ecos,
    with_fmpy,
    with_libcosim,
)
from fmu_hosts.native import Fmu, Unavailable, difference

from fmu_export import export_fmu, variable_table

VERSIONS = ("2.0", "3.0")
STEP = 2.0**-5  # ecos adds steps up; sums of this one are exact


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder, known = tmp_path_factory.mktemp("importers"), {}

    def get(version):
        if version not in known:
            path = export_fmu(cs.load_scene("K4"), folder / f"K4_{version}.fmu", version)
            known[version] = Fmu.unpacked(path, folder / version)
        return known[version]

    return get


@pytest.mark.parametrize(
    ("run", "version"),
    [(with_ecos, "2.0"), (with_ecos, "3.0"), (with_libcosim, "2.0")],
    ids=["ecos, FMI 2", "ecos, FMI 3", "libcosim, FMI 2"],
)
def test_other_importers_find_the_trajectory_that_fmpy_finds(run, version, exported):
    fmu = exported(version)
    scalars = [v for v in fmu.outputs if not v.dimensions]
    names = [v.name for v in scalars]
    try:
        found = run(fmu, names, STEP, 128)
    except Unavailable as error:
        pytest.skip(str(error))
    assert difference(scalars, found, with_fmpy(fmu, names, STEP, 128)) < 1e-12


@pytest.fixture(params=[(v, r) for v in VERSIONS for r in ("ode", "y")], ids=" ".join)
def imported(request, exported, tmp_path):
    """CasADi's function of a scene, a point off anything special, the exact Jacobian there."""
    version, result = request.param
    fmu = exported(version)
    scene = cs.load_scene("K4")
    table = variable_table(scene)
    function, arguments, results = casadi_function(fmu, result, tmp_path)
    columns, rows = ([table[n].reference for n in names] for names in (arguments, results))
    values = table.start_values
    values[columns] += 0.1 * np.random.default_rng(1).standard_normal(len(columns))
    exact = kernel_jacobian(scene, values)[np.ix_(rows, columns)]
    return function, values[columns], exact


def split(function, x):
    return np.split(x, [function.size1_in(0)])


def test_the_jacobian_in_casadi_is_that_of_the_kernels(imported):
    function, x, exact = imported
    parts = function.jacobian()(*split(function, x), function(*split(function, x)))
    found = np.hstack([part.full() for part in parts])
    assert np.abs(found - exact).max() < 1e-12 * np.abs(exact).max()


def test_the_jacobian_in_casadi_agrees_with_central_differences(imported):
    function, x, exact = imported
    columns = []
    for step in 1e-6 * np.eye(len(x)):
        after, before = (function(*split(function, x + s)).full() for s in (step, -step))
        columns.append((after - before).ravel() / 2e-6)
    assert np.abs(np.stack(columns, axis=1) - exact).max() < 1e-6 * np.abs(exact).max()


def test_adjoints_in_casadi_are_those_of_the_kernels(imported):
    function, x, exact = imported
    seed = np.random.default_rng(2).standard_normal(len(exact))
    value = function(*split(function, x))
    parts = function.reverse(1)(*split(function, x), value, seed)
    found = np.concatenate([part.full().ravel() for part in parts])
    assert np.abs(found - seed @ exact).max() < 1e-12 * np.abs(exact).max()
