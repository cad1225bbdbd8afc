"""Peers of the work-precision diagrams: general integrators and geodesic libraries.

A `Peer` builds a solver for one initial value problem and one tolerance; just-in-time compilation
and everything else that a second run would not repeat happens there, and is told apart.

References: Biscani & Izzo, MNRAS 504, 2021 (heyoka, Taylor series); Hindmarsh et al., ACM TOMS 31,
2005 (CVODES, also behind scikit-sundae); Andersson et al., Math. Prog. Comp. 11, 2019 (CasADi);
Virtanen et al., Nature Methods 17, 2020 (scipy); Kidger, PhD thesis, Oxford 2021 (diffrax); Miolane
et al., JMLR 21, 2020 (geomstats); Karney, J. Geodesy 87, 2013 (geographiclib).
"""

from __future__ import annotations

import functools
import itertools
import math
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

import contact_system as cs
from contact_system.kernels import find_compiler

from .peers import FINEST, decades, installed
from .problems import Ode, Problem

Solver = Callable[[], Any]
"""What the peer finds at the problem's times: one array of states (n, n_states) a contact."""


@dataclass(frozen=True)
class Peer:
    """A library's method on one form of the equations.

    Attributes
    ----------
    name : str
    tolerances : loosest first
    build : callable
        (tolerance, longest run in s) -> Solver.
    points : callable
        What the solver finds -> (n, n_contacts, n_bodies, 3), m; outside the times.
    """

    name: str
    tolerances: tuple[float, ...]
    build: Callable[[float, float], Solver]
    points: Callable[[Any], np.ndarray]


def missing() -> dict[str, str]:
    """Peers that are not installed: name -> reason."""
    packages = {
        "heyoka": "heyoka", "diffrax": "diffrax", "scikit-sundae": "sksundae",
        "geomstats": "geomstats", "geographiclib": "geographiclib",
    }  # fmt: skip
    return {
        name: "not installed" for name, package in packages.items()
        if not installed(package)
    }  # fmt: skip


def versions() -> dict[str, str]:
    """Of the peers and what they run on, those that ``report`` does not record."""
    found = {}
    for package in ("diffrax", "jax", "scikit-sundae", "geomstats", "FMPy", "drake"):
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def peers(problem: Problem, full: bool) -> Iterator[Peer]:
    """All that are installed; ``full``: every decade of tolerance."""
    absent = missing()
    every = decades(3, 15)
    some = every if full else (1e-4, 1e-7, 1e-9, 1e-11, 1e-13)
    tight = every[1:] if full else (*some, 1e-15)
    for form, ode in problem.forms.items():
        label = f", {form}" if len(problem.forms) > 1 else ""
        if "heyoka" not in absent:
            orders = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 2.3e-16)
            yield Peer(f"heyoka{label}", orders, functools.partial(_heyoka, ode), ode.all_points)
    # The form in space is regular everywhere and has no trigonometry: the others' better choice.
    ode = problem.forms.get("space") or problem.forms["chart"]
    for family in ("adams", "bdf"):
        build = functools.partial(_cvodes, ode, family)
        yield Peer(f"CVODES {family}", (*tight, FINEST), build, ode.all_points)
    for name in ("RK45", "DOP853", "LSODA", "Radau", "BDF"):
        build = functools.partial(_scipy, ode, name)
        # rtol below 100 rounding units is raised to it.
        lowest = (*(t for t in some if t > 3e-14), 2.3e-14)
        yield Peer(f"scipy {name}", lowest, build, ode.all_points)
    if "scikit-sundae" not in absent:
        for family in ("Adams", "BDF"):
            build = functools.partial(_sundae, ode, family)
            yield Peer(f"scikit-sundae {family}", (*tight, FINEST), build, ode.all_points)
    if full and "diffrax" not in absent:  # to compile takes it 2 s a problem
        # The implicit method compiles for 4 s a problem and reaches none of the small errors.
        for name in ("Dopri8", "Kvaerno5"):
            build = functools.partial(_diffrax, ode, name)
            yield Peer(f"diffrax {name}", some, build, ode.all_points)
    if problem.name == "geodesic sphere" and "geomstats" not in absent:
        yield Peer("geomstats", (0.0,), functools.partial(_geomstats, problem), np.asarray)
    if problem.name == "geodesic spheroid" and "geographiclib" not in absent:
        yield Peer("geographiclib", (0.0,), functools.partial(_geographiclib, problem), np.asarray)


def _solver(ode: Ode, advance: Callable[[int, np.ndarray], np.ndarray], limit: float) -> Solver:
    """Chains the pieces of all contacts; ``advance``: (piece, state) -> states (n, n_states).

    Raises (when solving)
    ---------------------
    TimeoutError
        A piece is begun later than ``limit`` s after the start.
    """

    def solve() -> list[np.ndarray]:
        begin, columns = time.perf_counter(), []
        for state in ode.starts:
            rows = [state[None]]
            for k in range(len(ode.pieces)):
                if time.perf_counter() - begin > limit:
                    raise TimeoutError(f"longer than {limit:g} s")
                rows.append(advance(k, rows[-1][-1])[1:])
            columns.append(np.concatenate(rows))
        return columns

    return solve


# --- heyoka ------------------------------------------------------------------------------------


def _heyoka(ode: Ode, tolerance: float, limit: float) -> Solver:
    solver = _heyoka_compiled(ode.key, ode.rates, ode.starts.shape[1],
                              len(ode.pieces[0].parameters), tolerance)  # fmt: skip

    def advance(k: int, state: np.ndarray) -> np.ndarray:
        piece = ode.pieces[k]
        solver.time, solver.state[:] = piece.times[0], state
        if len(piece.parameters):
            solver.pars[:] = piece.parameters
        return solver.propagate_grid(piece.times)[-1]

    return _solver(ode, advance, limit)


_COMPILED: dict[Any, Any] = {}


def _heyoka_compiled(key: str, rates: Any, states: int, parameters: int, tolerance: float) -> Any:
    import heyoka as hy

    if (key, tolerance) not in _COMPILED:
        x = hy.make_vars(*(f"x{i:02d}" for i in range(states)))
        right = rates(hy, hy.time, x, [hy.par[i] for i in range(parameters)])
        _COMPILED[key, tolerance] = hy.taylor_adaptive(
            list(zip(x, right)), [1.0] * states, tol=tolerance, pars=[0.0] * parameters
        )
    return _COMPILED[key, tolerance]


# --- CasADi's CVODES, scipy and scikit-sundae on one compiled right-hand side ------------------

_NUMBER = itertools.count()


def _function(ode: Ode) -> ca.Function:
    """(t, state, parameters) -> state', with its Jacobian, as C where there is a compiler."""
    if ("C", ode.key) not in _COMPILED:
        _COMPILED["C", ode.key] = _compiled_function(ode)
    return _COMPILED["C", ode.key]


def _compiled_function(ode: Ode) -> ca.Function:
    name = f"peer{next(_NUMBER)}"
    t, x = ca.SX.sym("t"), ca.SX.sym("x", ode.starts.shape[1])
    p = ca.SX.sym("p", len(ode.pieces[0].parameters))
    right = ca.vertcat(*ode.rates(ca, t, ca.vertsplit(x), ca.vertsplit(p) if p.numel() else []))
    plain = ca.Function(name, [t, x, p], [right], ["t", "x", "p"], ["f"])
    compiler = find_compiler()
    if not compiler:
        return plain
    with tempfile.TemporaryDirectory() as folder:  # loaded, the files are not needed any more
        code, library = ca.CodeGenerator(f"{name}.c"), f"{folder}/{name}.so"
        for each in (plain, plain.jacobian()):
            code.add(each)
        source = code.generate(f"{folder}/")
        command = [*compiler, "-O3", "-fPIC", "-shared", source, "-o", library, "-lm"]
        subprocess.run(command, check=True, capture_output=True)
        return ca.external(name, library)


def _evaluator(ode: Ode) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Any]:
    """t, state, parameters, state' as arrays, and the call that fills the last."""
    function = _function(ode)
    n, count = ode.starts.shape[1], len(ode.pieces[0].parameters)
    t, x, p, y = np.zeros(1), np.zeros(n), np.zeros(count), np.zeros(n)
    buffer, run = function.buffer()
    for i, array in enumerate((t, x, p)):
        if array.size:
            buffer.set_arg(i, memoryview(array))
    buffer.set_res(0, memoryview(y))
    _COMPILED["buffer", id(buffer)] = buffer, function  # what ``run`` only points to
    return t, x, p, y, run


def _cvodes(ode: Ode, family: str, tolerance: float, limit: float) -> Solver:
    function = _function(ode)
    t, x = ca.MX.sym("t"), ca.MX.sym("x", ode.starts.shape[1])
    p = ca.MX.sym("p", len(ode.pieces[0].parameters))
    problem = {"x": x, "t": t, "p": p, "ode": function(t, x, p)}
    options = {
        "linear_multistep_method": family, "reltol": tolerance, "abstol": 0.1 * tolerance,
        "max_num_steps": 100_000, "show_eval_warnings": False,
    }  # fmt: skip
    solvers = [
        ca.integrator("peer", "cvodes", problem, piece.times[0], list(piece.times[1:]), options)
        for piece in ode.pieces
    ]

    def advance(k: int, state: np.ndarray) -> np.ndarray:
        found = solvers[k](x0=state, p=ode.pieces[k].parameters)["xf"].full().T
        return np.concatenate([state[None], found])

    return _solver(ode, advance, limit)


def _scipy(ode: Ode, name: str, tolerance: float, limit: float) -> Solver:
    from scipy.integrate import solve_ivp

    now, x, p, y, run = _evaluator(ode)
    deadline = 0.0

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        if time.perf_counter() > deadline:
            raise TimeoutError(f"longer than {limit:g} s")
        now[0], x[:] = t, state
        run()
        return y.copy()

    def advance(k: int, state: np.ndarray) -> np.ndarray:
        nonlocal deadline
        piece, deadline = ode.pieces[k], time.perf_counter() + limit
        p[:] = piece.parameters
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = solve_ivp(
                rate, (piece.times[0], piece.times[-1]), state, name, piece.times,
                rtol=tolerance, atol=0.1 * tolerance,
            )  # fmt: skip
        if not found.success:
            raise ArithmeticError(found.message)
        return found.y.T

    return _solver(ode, advance, limit)


def _sundae(ode: Ode, family: str, tolerance: float, limit: float) -> Solver:
    from sksundae.cvode import CVODE

    now, x, p, y, run = _evaluator(ode)

    def rate(t: float, state: np.ndarray, out: np.ndarray) -> None:
        now[0], x[:] = t, state
        run()
        out[:] = y

    bounds = {"rtol": tolerance, "atol": 0.1 * tolerance, "max_num_steps": 100_000}
    solver = CVODE(rate, method=family, **bounds)

    def advance(k: int, state: np.ndarray) -> np.ndarray:
        p[:] = ode.pieces[k].parameters
        found = solver.solve(ode.pieces[k].times, state)
        if not found.success:
            raise ArithmeticError(found.message)
        return found.y

    return _solver(ode, advance, limit)


# --- diffrax -----------------------------------------------------------------------------------

LONGEST = 4_000
"""Steps of diffrax, which allots them before it begins."""


def _diffrax(ode: Ode, name: str, tolerance: float, limit: float) -> Solver:
    run = _diffrax_compiled(ode.key, ode.rates, name)
    for piece in {len(piece.times): piece for piece in ode.pieces}.values():  # compiles
        run(ode.starts[0], piece.times, piece.parameters, 1e-2)

    def advance(k: int, state: np.ndarray) -> np.ndarray:
        piece = ode.pieces[k]
        states, fine = run(state, piece.times, piece.parameters, tolerance)
        if not fine:
            raise ArithmeticError(f"no solution within {LONGEST} steps")
        return np.asarray(states)

    return _solver(ode, advance, limit)


def _diffrax_compiled(key: str, rates: Any, name: str) -> Any:
    """(state, times, parameters, tolerance) -> states, whether it succeeded."""
    if ("diffrax", key, name) in _COMPILED:
        return _COMPILED["diffrax", key, name]
    import diffrax
    import jax

    jax.config.update("jax_enable_x64", True)
    module = SimpleNamespace(sin=jax.numpy.sin, cos=jax.numpy.cos, sqrt=jax.numpy.sqrt)

    def right(t: Any, x: Any, p: Any) -> Any:
        return jax.numpy.stack(rates(module, t, x, p))

    @jax.jit
    def run(state: Any, times: Any, parameters: Any, tolerance: Any) -> Any:
        control = diffrax.PIDController(rtol=tolerance, atol=0.1 * tolerance)
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(right), getattr(diffrax, name)(), times[0], times[-1], None, state,
            parameters, saveat=diffrax.SaveAt(ts=times), stepsize_controller=control,
            max_steps=LONGEST, throw=False, adjoint=diffrax.DirectAdjoint(),
        )  # fmt: skip
        return found.ys, found.result == diffrax.RESULTS.successful

    _COMPILED["diffrax", key, name] = run
    return run


# --- libraries of geodesics --------------------------------------------------------------------


def _geomstats(problem: Problem, tolerance: float, limit: float) -> Solver:
    from geomstats.geometry.hypersphere import Hypersphere

    ode, radius = problem.forms["space"], problem.sizes[0]
    metric = Hypersphere(2).metric
    point, velocity = ode.starts[0, :3] / radius, ode.starts[0, 3:] / radius

    def solve() -> np.ndarray:
        path = metric.geodesic(initial_point=point, initial_tangent_vec=velocity)
        return radius * path(problem.times)[:, None, None]

    return solve


def _geographiclib(problem: Problem, tolerance: float, limit: float) -> Solver:
    from geographiclib.geodesic import Geodesic

    scene = problem.make()
    obj, contact = scene.object, scene.contacts[0]
    assert isinstance(obj, cs.Ellipsoid) and obj.a == obj.b
    f, (turn, reduced) = 1.0 - obj.c / obj.a, contact.object_at
    latitude = math.degrees(math.atan2(math.sin(reduced), (1.0 - f) * math.cos(reduced)))
    azimuth = math.degrees(math.atan2(*contact.object_velocity))
    earth, wanted = Geodesic(obj.a, f), Geodesic.LATITUDE | Geodesic.LONGITUDE

    def solve() -> np.ndarray:
        line = earth.Line(latitude, math.degrees(turn), azimuth, wanted | Geodesic.DISTANCE_IN)
        ends = [line.Position(s, wanted) for s in problem.times]
        degrees = np.array([(e["lat2"], e["lon2"]) for e in ends])
        (phi, around) = np.radians(degrees).T
        beta = np.arctan2((1.0 - f) * np.sin(phi), np.cos(phi))
        x, y = np.cos(beta) * np.cos(around), np.cos(beta) * np.sin(around)
        points = np.stack([obj.a * x, obj.a * y, obj.c * np.sin(beta)], axis=1)
        return points[:, None, None]

    return solve
