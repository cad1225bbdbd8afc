"""Kernels: three engines, one value; building and its cache; what an import loads."""

from __future__ import annotations

import ctypes
import math
import os
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import SURFACES, one_contact

import contact_system as cs
from contact_system import kernels, panels
from contact_system.equations import chart_equations
from contact_system.errors import ContactSystemError
from contact_system.kernels import Kernel, find_compiler, replay

SX = ca.SX
ROOT = Path(cs.__file__).parents[1]
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

ONE = {  # CasADi's function, numpy's, where it is defined
    "exp": (ca.exp, np.exp, (-1, 1)), "log": (ca.log, np.log, (0.1, 2)),
    "sqrt": (ca.sqrt, np.sqrt, (0.1, 2)), "sin": (ca.sin, np.sin, (-9, 9)),
    "cos": (ca.cos, np.cos, (-9, 9)), "tan": (ca.tan, np.tan, (-1.2, 1.2)),
    "asin": (ca.asin, np.arcsin, (-0.9, 0.9)), "acos": (ca.acos, np.arccos, (-0.9, 0.9)),
    "atan": (ca.atan, np.arctan, (-3, 3)), "sinh": (ca.sinh, np.sinh, (-2, 2)),
    "cosh": (ca.cosh, np.cosh, (-2, 2)), "tanh": (ca.tanh, np.tanh, (-2, 2)),
    "asinh": (ca.asinh, np.arcsinh, (-2, 2)), "acosh": (ca.acosh, np.arccosh, (1.2, 3)),
    "atanh": (ca.atanh, np.arctanh, (-0.9, 0.9)), "log1p": (ca.log1p, np.log1p, (-0.5, 2)),
    "expm1": (ca.expm1, np.expm1, (-1, 1)), "fabs": (ca.fabs, np.abs, (-2, 2)),
    "sign": (ca.sign, np.sign, (-2, 2)), "floor": (ca.floor, np.floor, (-3, 3)),
    "ceil": (ca.ceil, np.ceil, (-3, 3)), "square": (lambda x: x * x, np.square, (-2, 2)),
    "inverse": (lambda x: 1 / x, np.reciprocal, (0.5, 2)),
    "minus": (lambda x: -x, np.negative, (-2, 2)),
    "twice": (lambda x: 2 * x, lambda x: 2 * x, (-2, 2)),
    "power": (lambda x: x**1.7, lambda x: x**1.7, (0.1, 2)),
    "not": (lambda x: ca.logic_not(x > 0), lambda x: 1.0 * (x <= 0), (-2, 2)),
}  # fmt: skip
TWO = {
    "add": (lambda x, y: x + y,) * 2, "subtract": (lambda x, y: x - y,) * 2,
    "multiply": (lambda x, y: x * y,) * 2, "divide": (lambda x, y: x / y,) * 2,
    "power": (lambda x, y: ca.fabs(x) ** y, lambda x, y: np.abs(x) ** y),
    "atan2": (ca.atan2, np.arctan2), "hypot": (ca.hypot, np.hypot), "fmin": (ca.fmin, np.minimum),
    "fmax": (ca.fmax, np.maximum), "copysign": (ca.copysign, np.copysign),
    "fmod": (ca.fmod, np.vectorize(math.fmod)),
    "less": (lambda x, y: x < y, lambda x, y: 1.0 * (x < y)),
    "less or equal": (lambda x, y: x <= y, lambda x, y: 1.0 * (x <= y)),
    "equal": (lambda x, y: ca.eq(ca.sign(x), ca.sign(y)), lambda x, y: 1.0 * (x * y > 0)),
    "not equal": (lambda x, y: ca.ne(ca.sign(x), ca.sign(y)), lambda x, y: 1.0 * (x * y < 0)),
    "and": (lambda x, y: ca.logic_and(x > 0, y > 0), lambda x, y: 1.0 * ((x > 0) & (y > 0))),
    "or": (lambda x, y: ca.logic_or(x > 0, y > 0), lambda x, y: 1.0 * ((x > 0) | (y > 0))),
    "if else": (lambda x, y: ca.if_else(x > y, x, 3 * y), lambda x, y: np.where(x > y, x, 3 * y)),
}  # fmt: skip


def evaluate(kernel: Kernel, points: np.ndarray, constants: np.ndarray) -> dict[str, np.ndarray]:
    """Every engine's results at (bodies, n_point, n) points: (bodies, n_result, n) each."""
    n_bodies, n = len(constants), points.shape[2]
    engines = {"numpy": False} | ({"compiled": True} if find_compiler() is not None else {})
    results = {}
    for name, compiled in engines.items():
        results[name] = np.full((n_bodies, kernel.n_result, n), np.nan)
        kernel(points, constants, results[name], compiled=compiled)
    machine = kernel.machine(n)
    machine_result = np.empty((n_bodies, kernel.n_result, n))
    for b in range(n_bodies):
        machine.x[:], machine.c[:] = points[b % len(points)].T, constants[b]
        machine.run()
        machine_result[b] = machine.y.T
    return results | {"machine": machine_result}


# --- the engines


def test_every_operation_is_numpys_in_every_engine():
    x, y, c = SX.sym("x", len(ONE)), SX.sym("y", 2), SX.sym("c")
    made = [f(x[i]) for i, (f, _, _) in enumerate(ONE.values())]
    made += [f(y[0], y[1]) for f, _ in TWO.values()] + [f(y[0], c) for f, _ in TWO.values()]
    kernel = Kernel("operations", ca.vertcat(x, y), c, ca.vertcat(*made))
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0.2, 2, (2, 50)) * rng.choice([-1, 1], (2, 50))
    points = np.array([*(rng.uniform(*span, 50) for _, _, span in ONE.values()), a, b])
    expected = np.array([f(v) for (_, f, _), v in zip(ONE.values(), points)]
                        + [f(a, b) for _, f in TWO.values()]
                        + [f(a, 0.7 + 0 * a) for _, f in TWO.values()])  # fmt: skip
    for name, values in evaluate(kernel, points[None], np.array([[0.7]])).items():
        assert values[0] == pytest.approx(expected, rel=2e-15, abs=1e-15), name


def test_what_divides_many_numbers_is_inverted_once():
    x, c = SX.sym("x", 5), SX.sym("c", 2)
    parts = [x[0] / x[2], x[1] / x[2], 1 / x[2]]
    parts += [x[0] / c[0], x[1] / c[0]]
    parts += [x[3] / x[4], c[0] / c[1]]  # nothing to save
    kernel = Kernel("quotients", x, c, ca.vertcat(*parts))
    assert kernel.loop_source.count(" / ") == 4
    assert kernel.loop_source.count("1.0 / ") == 2
    random = np.random.default_rng(0)
    points, constants = random.uniform(0.2, 2, (1, 5, 40)), random.uniform(0.2, 2, (3, 2))
    values = evaluate(kernel, points, constants)
    for engine, found in values.items():
        assert found == pytest.approx(values["machine"], rel=4e-16), engine


@pytest.mark.parametrize("name", SURFACES)
def test_engines_agree_on_a_surfaces_geometry(name):
    surface, (u, v) = SURFACES[name]
    q, x, p = SX.sym("q", 2), SX.sym("x", 3), SX.sym("p", len(surface.parameters))
    parts = []
    if surface.has_chart:
        shape = surface.geometry_expr(p, q[0], q[1])
        parts += [shape.point, shape.frame, shape.metric_root, *shape.christoffel,
                  shape.curvature_form, shape.torsion_form]  # fmt: skip
    if surface.ambient:
        parts += [*surface.frame_expr(p, x), *surface.coordinates_expr(p, x)]
        parts += [surface.implicit_expr(p, x)]
    result = ca.vertcat(*(ca.vec(ca.densify(SX(part))) for part in parts))
    kernel = Kernel("geometry", ca.vertcat(q, x), p, result)
    around = np.random.default_rng(1).uniform(-0.05, 0.05, (2, 40)) * min(1.0, 10 * surface.size)
    at = np.array([[u], [v]]) + around
    points = np.vstack([at, surface.point(*at).T])[None]
    values = evaluate(kernel, points, np.array([surface.parameters]))
    size = np.maximum(1.0, np.abs(values["machine"]))
    for engine in values:
        assert (np.abs(values[engine] - values["machine"]) / size).max() <= 1e-14, engine


@pytest.mark.parametrize(
    "finger, obj",
    [("sphere", "sphere"), ("sphere", "ellipsoid"), ("torus", "bumps"), ("cylinder", "one sheet")],
)
def test_engines_agree_on_the_chart_equations(finger, obj):
    bodies = SURFACES[finger], SURFACES[obj]
    kernel = chart_equations(bodies[0][0], bodies[1][0])
    points = np.random.default_rng(2).normal(size=(1, 17, 40))
    for row, (_, at) in zip((0, 4), bodies):
        points[0, row : row + 2] = np.array(at)[:, None] + 0.01 * points[0, row : row + 2]
    constants = np.array([[*bodies[0][0].parameters, *bodies[1][0].parameters]])
    values = evaluate(kernel, points, constants)
    size = np.maximum(1.0, np.abs(values["machine"]))
    for engine in values:
        assert (np.abs(values[engine] - values["machine"]) / size).max() <= 1e-14, engine


def area_kernel() -> Kernel:
    x, c = SX.sym("x", 2), SX.sym("c")
    return Kernel("area", x, c, ca.vertcat(c * x[0] * x[1], x[0] - x[1], SX(4.0), c))


def test_bodies_keep_their_own_points_and_constants():
    points = np.arange(12.0).reshape(3, 2, 2)
    constants = np.array([[1.0], [10.0], [100.0]])
    x, y = points[:, 0], points[:, 1]
    rows = [constants * x * y, x - y, np.full((3, 2), 4.0), np.repeat(constants, 2, axis=1)]
    expected = np.stack(rows, axis=1)
    for name, values in evaluate(area_kernel(), points, constants).items():
        assert values == pytest.approx(expected, abs=0), name


def test_bodies_may_share_their_points():
    points, constants = np.arange(6.0).reshape(1, 2, 3), np.array([[1.0], [10.0]])
    expected = constants * points[0, 0] * points[0, 1]
    for name, values in evaluate(area_kernel(), points, constants).items():
        assert values[:, 0] == pytest.approx(expected, abs=0), name


def test_kernel_that_only_passes_values_on_can_be_called_again():
    x, c = SX.sym("x", 2), SX.sym("c")
    kernel = Kernel("passing", x, c, ca.vertcat(x, c, SX(1.0)))
    points, constants = np.arange(6.0).reshape(1, 2, 3), np.array([[7.0]])
    for _ in range(2):
        for name, values in evaluate(kernel, points, constants).items():
            assert values[0, :, 1] == pytest.approx([1.0, 4.0, 7.0, 1.0], abs=0), name


def test_number_of_points_may_change_from_call_to_call():
    kernel = area_kernel()
    for n in (3, 500, 1, 3):
        points = np.random.default_rng(n).normal(size=(2, 2, n))
        constants = np.array([[2.0], [3.0]])
        for name, values in evaluate(kernel, points, constants).items():
            assert values[:, 0] == pytest.approx(constants * points[:, 0] * points[:, 1]), name


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=needs_compiler)])
def test_points_need_not_be_contiguous(compiled):
    points = np.arange(24.0).reshape(1, 4, 6)[:, ::2, ::2]
    out = np.empty((1, 4, 3))
    area_kernel()(points, np.array([[2.0]]), out, compiled=compiled)
    assert out[0, 0] == pytest.approx(2.0 * points[0, 0] * points[0, 1])


def test_replay_works_for_any_scalar_type():
    x = SX.sym("x", 2)
    function = ca.Function("f", [x], [x[0] * x[1] + ca.sin(x[0])])
    names = {ca.OP_MUL: "*", ca.OP_ADD: "+", ca.OP_SIN: "sin"}

    def write(op, operands):
        if len(operands) == 1:
            return f"{names[op]}({operands[0]})"
        return f"({operands[0]} {names[op]} {operands[1]})"

    ((text,),) = replay(function, [["a", "b"]], write, str)
    assert eval(text, {"a": 0.3, "b": 2.0, "sin": np.sin}) == pytest.approx(0.6 + np.sin(0.3))


def test_operation_without_a_form_is_named_with_what_to_write_instead():
    x = SX.sym("x")
    kernel = Kernel("odd", x, SX.sym("c", 0), ca.erf(x))
    message = "operation OP_ERF of CasADi has no numpy form here; write the surface with"
    with pytest.raises(ContactSystemError, match=message):
        kernel(np.ones((1, 1, 1)), np.empty((1, 0)), np.empty((1, 1, 1)), compiled=False)


# --- finding and building


@pytest.fixture
def fresh_cache(monkeypatch, tmp_path):
    """An empty cache folder, and compilers looked for anew before and after."""
    monkeypatch.setenv("CONTACT_SYSTEM_CACHE", str(tmp_path / "cache"))
    find_compiler.cache_clear()
    yield tmp_path / "cache"
    monkeypatch.undo()
    find_compiler.cache_clear()


def test_missing_compiler_is_said_with_the_remedy(monkeypatch, fresh_cache):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setitem(sys.modules, "ziglang", None)
    assert find_compiler() is None
    assert not area_kernel().built
    with pytest.raises(ContactSystemError, match="no C compiler found: install one .*set CC"):
        area_kernel()(np.ones((1, 2, 3)), np.ones((1, 1)), np.empty((1, 4, 3)), compiled=True)
    out = np.empty((1, 4, 3))
    area_kernel()(np.ones((1, 2, 3)), np.ones((1, 1)), out, compiled=None)  # numpy's turn
    assert out[0, 0] == pytest.approx(1.0)


def test_missing_compiler_does_not_hinder_a_plan(monkeypatch, fresh_cache):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setitem(sys.modules, "ziglang", None)
    plan = cs.plan(one_contact())
    assert np.isfinite(plan.states([0.0, 0.5, 1.0])).all()


@needs_compiler
def test_compiler_named_by_cc_comes_first(monkeypatch, tmp_path, fresh_cache):
    wrapper = tmp_path / "mycc"
    monkeypatch.setenv("CC", " ")  # whoever runs the tests may have named one
    find_compiler.cache_clear()
    real = " ".join(find_compiler())
    find_compiler.cache_clear()
    wrapper.write_text(f'#!/bin/sh\nexec {real} "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", f"{wrapper} -DFROM_CC")
    assert find_compiler() == (str(wrapper), "-DFROM_CC")
    find_compiler.cache_clear()
    monkeypatch.setenv("CC", " ")
    assert " ".join(find_compiler()) == real


@needs_compiler
@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")
def test_a_compiler_that_knows_no_width_builds_too(monkeypatch, tmp_path, fresh_cache):
    wrapper, real = tmp_path / "gcc7", " ".join(find_compiler())
    find_compiler.cache_clear()
    wrapper.write_text(
        '#!/bin/sh\ncase "$*" in *-mprefer-vector-width*) echo unrecognized >&2; exit 1;; esac\n'
        f'exec {real} "$@"\n'
    )
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", str(wrapper))
    out = np.empty((1, 4, 3))
    area_kernel()(np.ones((1, 2, 3)), np.ones((1, 1)), out, compiled=True)
    assert out[0, 0] == pytest.approx(1.0)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")
def test_failing_compiler_is_quoted(monkeypatch, tmp_path, fresh_cache):
    wrapper = tmp_path / "badcc"
    wrapper.write_text("#!/bin/sh\nprintf 'out of ink in caf\\351' >&2\nexit 1\n")
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", str(wrapper))
    with pytest.raises(ContactSystemError, match="badcc(.|\n)*failed(.|\n)*out of ink in caf"):
        area_kernel()(np.ones((1, 2, 3)), np.ones((1, 1)), np.empty((1, 4, 3)), compiled=True)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")
def test_a_library_that_cannot_be_loaded_does_not_stay(monkeypatch, tmp_path, fresh_cache):
    wrapper = tmp_path / "othercc"  # for another machine, as it were
    wrapper.write_text('#!/bin/sh\nwhile [ "$1" != -o ]; do shift; done\necho odd > "$2"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", str(wrapper))
    arguments = np.ones((1, 2, 3)), np.ones((1, 1)), np.empty((1, 4, 3))
    with pytest.raises(ContactSystemError, match="built cannot be loaded.*noexec.*set CC"):
        area_kernel()(*arguments, compiled=True)
    assert not list(fresh_cache.iterdir())
    area_kernel()(*arguments, compiled=None)


@needs_compiler
def test_kernel_is_built_once_and_found_again(fresh_cache):
    kernel = area_kernel()
    assert not area_kernel().built
    kernel(np.ones((1, 2, 3)), np.ones((1, 1)), np.empty((1, 4, 3)), compiled=True)
    (library,) = fresh_cache.iterdir()  # and no half-made files beside it
    stamp = library.stat().st_mtime_ns
    again = area_kernel()
    assert again.built
    again(np.ones((1, 2, 3)), np.ones((1, 1)), np.empty((1, 4, 3)), compiled=True)
    assert library.stat().st_mtime_ns == stamp


@needs_compiler
@pytest.mark.parametrize("part", [0.0, 0.3, 0.99])
@pytest.mark.parametrize("compiled", [None, True])
def test_a_library_that_is_cut_short_is_built_again(monkeypatch, fresh_cache, part, compiled):
    arguments = np.ones((1, 2, 3)), np.ones((1, 1))
    area_kernel()(*arguments, np.empty((1, 4, 3)), compiled=True)
    (library,) = fresh_cache.iterdir()
    whole, other = library.read_bytes(), fresh_cache / "other"  # not yet loaded by that name
    monkeypatch.setenv("CONTACT_SYSTEM_CACHE", str(other))
    other.mkdir()
    (other / library.name).write_bytes(whole[: int(part * len(whole))])
    out = np.empty((1, 4, 3))
    area_kernel()(*arguments, out, compiled=compiled)
    assert out[0, 0] == pytest.approx(1.0)
    assert (other / library.name).stat().st_size >= len(whole)


def python(code: str, **environment: str) -> subprocess.Popen:
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)} | environment
    command = [sys.executable, "-c", textwrap.dedent(code)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=environment, stdout=pipe, stderr=pipe, text=True)


@needs_compiler
def test_radii_are_no_part_of_a_compiled_kernel(tmp_path):
    # Kernels are specialised by structure, so another radius builds nothing.
    code = """
        import os, contact_system as cs
        for radius in (0.04, 0.05):
            contact = cs.Contact(finger=cs.Sphere(radius), object_at=(1.1, 0.4),
                                 object_velocity="rest")
            scene = cs.Scene(object=cs.Sphere(2 * radius), contacts=[contact],
                             profile=cs.Profile([radius]), duration=0.2)
            cs.plan(scene, compiled=True).states([0.0, 0.1])
            print(len(os.listdir(os.environ["CONTACT_SYSTEM_CACHE"])))
    """
    run = python(code, CONTACT_SYSTEM_CACHE=str(tmp_path))
    out, errors = run.communicate(timeout=120)
    assert run.returncode == 0, errors
    first, second = map(int, out.split())
    assert first == second > 0


@needs_compiler
def test_the_cache_may_be_the_folder_at_hand(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CONTACT_SYSTEM_CACHE", ".")
    assert kernels.compiled_library("int answer(void) { return 42; }").answer() == 42


@needs_compiler
def test_two_processes_that_build_at_once_do_not_clash(tmp_path):
    code = """
        import contact_system as cs
        scene = cs.Scene(object=cs.Sphere(0.1), contacts=[cs.Contact(
            finger=cs.Sphere(0.04), object_at=(1.1, 0.4), object_velocity="rest")],
            profile=cs.Profile([0.2]), duration=0.2)
        print(repr(cs.plan(scene, compiled=True).points(0.2).tolist()))
    """
    runs = [python(code, CONTACT_SYSTEM_CACHE=str(tmp_path)) for _ in range(2)]
    (first, errors), (second, more_errors) = (run.communicate(timeout=120) for run in runs)
    assert [run.returncode for run in runs] == [0, 0], errors + more_errors
    assert first == second and "[" in first
    assert {path.suffix for path in tmp_path.iterdir()} == {Path(kernels.library_path("")).suffix}


@needs_compiler
def test_a_cache_that_cannot_be_written_to_is_named(tmp_path, monkeypatch):
    (tmp_path / "taken").touch()
    monkeypatch.setenv("CONTACT_SYSTEM_CACHE", str(tmp_path / "taken"))
    with pytest.raises(cs.ContactSystemError, match="taken': .*; set CONTACT_SYSTEM_CA"):
        kernels.compiled_library("double one = 1.0;")


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="they keep caches elsewhere")
@pytest.mark.parametrize("named", [None, "", "relative"])
def test_the_cache_is_below_the_home_unless_another_place_is_named(monkeypatch, tmp_path, named):
    monkeypatch.delenv("CONTACT_SYSTEM_CACHE")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if named is not None:
        monkeypatch.setenv("XDG_CACHE_HOME", named)
    assert kernels.cache_folder() == tmp_path / ".cache" / "contact_system"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "named"))
    assert kernels.cache_folder() == tmp_path / "named" / "contact_system"


@needs_compiler
def test_a_user_without_a_home_plans_and_is_told_where_kernels_may_be_kept(monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    for variable in ("CONTACT_SYSTEM_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    assert not kernels.is_built("double two = 2.0;")
    with pytest.raises(cs.ContactSystemError, match="no home folder; set CONTACT_SYSTEM_CACHE"):
        kernels.compiled_library("double two = 2.0;")


@needs_compiler
def test_a_cache_that_cannot_be_looked_into_is_as_an_empty_one(tmp_path, monkeypatch):
    # A name too long for any disk: folders of other users are not locked to root.
    monkeypatch.setenv("CONTACT_SYSTEM_CACHE", str(tmp_path / ("cache" * 60)))
    assert not kernels.is_built("double three = 3.0;")
    with pytest.raises(cs.ContactSystemError, match="no folder .*; set CONTACT_SYSTEM_CACHE"):
        kernels.compiled_library("double three = 3.0;")


@needs_compiler
def test_structures_lie_in_memory_as_those_of_c():
    every = ctypes.Structure.__subclasses__()
    structures = [s for s in every if s.__module__.startswith("contact_system.")]
    expected = {}
    for structure in structures:
        name = re.match(r"``(\w+)`` of c/", structure.__doc__)[1]
        expected[f"sizeof({name})"] = ctypes.sizeof(structure)
        for field, _ in structure._fields_:
            place = getattr(structure, field)
            expected[f"offsetof({name}, {field})"] = place.offset
            expected[f"sizeof((({name} *)0)->{field})"] = place.size
    parts = ", ".join(f"(long)({text})" for text in expected)
    source = f"{panels._program_source()}\n#include <stddef.h>\nlong layout[] = {{{parts}}};\n"
    found = (ctypes.c_long * len(expected)).in_dll(kernels.compiled_library(source), "layout")
    assert dict(zip(expected, found)) == expected
    assert len(structures) >= 11


def test_offsets_of_rows_stay_where_they_are_while_a_call_reads_them():
    for stride in range(1, 5000):  # as for so many numbers of times
        at = [kernels.row_offsets(rows, stride) for rows in ((0, 1, 2), (0, 2, 4))]
        first, second = ((ctypes.c_long * 3).from_address(a)[:] for a in at)
        assert first == [0, stride, 2 * stride] and second == [0, 2 * stride, 4 * stride]


def test_import_loads_nothing_that_is_not_needed():
    code = """
        import sys
        import contact_system as cs
        plan = cs.plan(cs.load_scene("K4"), compiled=False)
        plan.states([0.0, 1.0]), plan.explain()
        heavy = ("pydrake", "fmpy", "matplotlib", "scipy.integrate", "drake_plant", "fmu_export",
                 "contact_system.plots", "contact_system.cli")
        print([name for name in heavy if name in sys.modules])
    """
    run = python(code)
    out, errors = run.communicate(timeout=120)
    assert run.returncode == 0, errors
    assert out.strip() == "[]"
