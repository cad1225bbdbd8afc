"""Importers other than fmpy get the same numbers out of an FMU."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import derivative

import contact_system as cs

pytest.importorskip("fmpy")

from fmu_hosts.blocks import exported
from fmu_hosts.importers import casadi_function, with_ecos, with_fmpy, with_libcosim
from fmu_hosts.native import Unavailable, difference

from fmu_export import variable_table

VERSIONS, K4 = ("2.0", "3.0"), cs.load_scene("K4")
STEP = 2.0**-5  # ecos adds steps up; sums of this one are exact


@pytest.mark.parametrize(
    ("run", "version"),
    [(with_ecos, "2.0"), (with_ecos, "3.0"), (with_libcosim, "2.0")],
    ids=["ecos, FMI 2", "ecos, FMI 3", "libcosim, FMI 2"],
)
def test_other_importers_find_the_trajectory_that_fmpy_finds(run, version):
    fmu = exported(K4, version)
    scalars = [v for v in fmu.outputs if not v.dimensions]
    names = [v.name for v in scalars]
    try:
        found = run(fmu, names, STEP, 128)
    except Unavailable as error:
        pytest.skip(str(error))
    assert difference(scalars, found, with_fmpy(fmu, names, STEP, 128)) < 1e-12


@pytest.fixture(params=[(v, r) for v in VERSIONS for r in ("ode", "y")], ids=" ".join)
def imported(request, tmp_path):
    """CasADi's function of a scene, a point off anything special, its Jacobian there."""
    version, result = request.param
    table = variable_table(K4)
    function, arguments, _ = casadi_function(exported(K4, version), result, tmp_path)
    columns = [table[n].reference for n in arguments]
    x = table.start_values[columns] + 0.1 * np.random.default_rng(1).standard_normal(len(columns))
    parts = function.jacobian()(*split(function, x), function(*split(function, x)))
    return function, x, np.hstack([part.full() for part in parts])


def split(function, x):
    return np.split(x, [function.size1_in(0)])


def test_the_jacobian_in_casadi_agrees_with_central_differences(imported):
    function, x, jacobian = imported
    moved = lambda h: function(*split(function, x + h)).full().ravel()  # noqa: E731
    columns = [
        derivative(lambda t, e=e: np.array([moved(s * e) for s in t]), np.zeros(1), 1e-2)[0]
        for e in np.eye(len(x))
    ]
    assert np.abs(np.stack(columns, axis=1) - jacobian).max() < 1e-9 * np.abs(jacobian).max()


def test_adjoints_in_casadi_are_the_transpose(imported):
    function, x, jacobian = imported
    seed = np.random.default_rng(2).standard_normal(len(jacobian))
    value = function(*split(function, x))
    parts = function.reverse(1)(*split(function, x), value, seed)
    found = np.concatenate([part.full().ravel() for part in parts])
    assert np.abs(found - seed @ jacobian).max() < 1e-12 * np.abs(jacobian).max()
