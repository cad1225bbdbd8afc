"""Other libraries on the same motion: general integrators, and geographiclib.

A `Peer` builds a solver for one problem and one tolerance; just-in-time compilation and everything
else that a second run would not repeat happens there, and is told apart.

References: Biscani & Izzo, MNRAS 504, 2021 (heyoka, Taylor series); Hindmarsh et al., ACM TOMS 31,
2005 (CVODES); Andersson et al., Math. Prog. Comp. 11, 2019 (CasADi, which calls it); Virtanen et
al., Nature Methods 17, 2020 (scipy); Karney, J. Geodesy 87, 2013 (geographiclib).
"""

from __future__ import annotations

import functools
import importlib.util
import itertools
import math
import shutil
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import contact_system as cs

from .accuracy import spheroid_point
from .problems import Ode, Problem

Array = np.ndarray
Solver = Callable[[], Any]
"""What the peer finds at the problem's times: one array of states (n, n_states) a contact."""
FINEST = 3e-16
"""CVODES refuses relative tolerances below the rounding unit. Of stiff slip it reaches errors of
1e-12 only here, 10 to 30 times sooner than any other peer."""
HEYOKA = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 2.3e-16)
"""A tolerance sets the order of the series."""


@dataclass(frozen=True)
class Peer:
    """A library's method on one form of the equations."""

    name: str
    tolerances: tuple[float, ...]  # loosest first
    build: Callable[[float, float], Solver] | None  # of a tolerance and the longest run, s
    points: Callable[[Any], Array]  # of what is found: (n, n_contacts, n_bodies, 3), m; not timed


def missing() -> dict[str, str]:
    """Peers that are not installed: name -> reason."""
    packages = ("heyoka", "geographiclib")
    absent = (package for package in packages if not importlib.util.find_spec(package))
    return dict.fromkeys(absent, "not installed")


def decades(first: int, last: int) -> tuple[float, ...]:
    """1e-first ... 1e-last."""
    return tuple(10.0**-k for k in range(first, last + 1))


def heyokas(problem: Problem) -> Iterator[Peer]:
    """heyoka on every form of the equations."""
    if "heyoka" not in missing():
        for form, ode in problem.forms.items():
            name = f"heyoka, {form}" if len(problem.forms) > 1 else "heyoka"
            yield Peer(name, HEYOKA, functools.partial(_heyoka, ode), ode.all_points)


def peers(problem: Problem, full: bool) -> Iterator[Peer]:
    """All that are installed; ``full``: every decade of tolerance."""
    yield from heyokas(problem)
    some = decades(3, 15) if full else (1e-4, 1e-7, 1e-9, 1e-11, 1e-13)
    lowest = (*(t for t in some if t > 3e-14), 2.3e-14)  # scipy takes none below
    # The form in space is regular everywhere and has no trigonometry: the others' better choice.
    ode = problem.forms.get("space") or problem.forms["chart"]
    for method in ("adams", "bdf"):
        build = functools.partial(_cvodes, ode, method)
        yield Peer(f"CVODES {method}", (*some, 1e-15, FINEST), build, ode.all_points)
    for method in ("RK45", "DOP853", "LSODA", "Radau", "BDF"):
        build = functools.partial(_scipy, ode, method)
        yield Peer(f"scipy {method}", lowest, build, ode.all_points)
    if problem.name == "geodesic spheroid" and "geographiclib" not in missing():
        yield _geographiclib(problem)


def _solver(ode: Ode, advance: Callable[[int, Array], Array], limit: float) -> Solver:
    """Chains the pieces of all contacts; ``advance``: (piece, state) -> states (n, n_states).

    It raises TimeoutError where a piece is begun later than ``limit`` s after the start.
    """

    def solve() -> list[Array]:
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


def _once(make: Callable[..., Any]) -> Callable[..., Any]:
    """Keep what is made for an Ode's right-hand side and other arguments: it takes long."""
    known: dict[Any, Any] = {}

    def get(ode: Ode, *others: Any) -> Any:
        if (ode.key, *others) not in known:
            known[ode.key, *others] = make(ode, *others)
        return known[ode.key, *others]

    return get


def _heyoka(ode: Ode, tolerance: float, limit: float) -> Solver:
    solver = _heyoka_compiled(ode, tolerance)

    def advance(k: int, state: Array) -> Array:
        piece = ode.pieces[k]
        solver.time, solver.state[:] = piece.times[0], state
        if len(piece.parameters):
            solver.pars[:] = piece.parameters
        return solver.propagate_grid(piece.times)[-1]

    return _solver(ode, advance, limit)


@_once
def _heyoka_compiled(ode: Ode, tolerance: float) -> Any:
    import heyoka as hy

    states, parameters = ode.starts.shape[1], len(ode.pieces[0].parameters)
    x = hy.make_vars(*(f"x{i:02d}" for i in range(states)))
    right = ode.rates(hy, hy.time, x, [hy.par[i] for i in range(parameters)])
    given = {"tol": tolerance, "pars": [0.0] * parameters}
    return hy.taylor_adaptive(list(zip(x, right)), [1.0] * states, **given)


_NUMBER = itertools.count()


@_once
def _function(ode: Ode) -> ca.Function:
    """(t, state, parameters) -> state', with its Jacobian, as C where there is a compiler."""
    name = f"peer{next(_NUMBER)}"
    t, x = ca.SX.sym("t"), ca.SX.sym("x", ode.starts.shape[1])
    p = ca.SX.sym("p", len(ode.pieces[0].parameters))
    right = ca.vertcat(*ode.rates(ca, t, ca.vertsplit(x), ca.vertsplit(p) if p.numel() else []))
    plain = ca.Function(name, [t, x, p], [right], ["t", "x", "p"], ["f"])
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        return plain
    with tempfile.TemporaryDirectory() as folder:  # loaded, the files are not needed any more
        code, library = ca.CodeGenerator(f"{name}.c"), f"{folder}/{name}.so"
        for each in (plain, plain.jacobian()):
            code.add(each)
        source = code.generate(f"{folder}/")
        command = [compiler, "-O3", "-fPIC", "-shared", source, "-o", library, "-lm"]
        subprocess.run(command, check=True, capture_output=True)
        return ca.external(name, library)


def _cvodes(ode: Ode, family: str, tolerance: float, limit: float) -> Solver:
    function = _function(ode)
    t, x = ca.MX.sym("t"), ca.MX.sym("x", ode.starts.shape[1])
    p = ca.MX.sym("p", len(ode.pieces[0].parameters))
    problem = {"x": x, "t": t, "p": p, "ode": function(t, x, p)}
    options = {
        "linear_multistep_method": family,
        "reltol": tolerance,
        "abstol": 0.1 * tolerance,
        "max_num_steps": 100_000,
        "show_eval_warnings": False,
    }
    solvers = [
        ca.integrator("peer", "cvodes", problem, piece.times[0], list(piece.times[1:]), options)
        for piece in ode.pieces
    ]

    def advance(k: int, state: Array) -> Array:
        found = solvers[k](x0=state, p=ode.pieces[k].parameters)["xf"].full().T
        return np.concatenate([state[None], found])

    return _solver(ode, advance, limit)


def _scipy(ode: Ode, name: str, tolerance: float, limit: float) -> Solver:
    from scipy.integrate import solve_ivp

    function = _function(ode)
    n, count = ode.starts.shape[1], len(ode.pieces[0].parameters)
    now, x, p, y = np.zeros(1), np.zeros(n), np.zeros(count), np.zeros(n)
    buffer, run = function.buffer()
    for i, array in enumerate((now, x, p)):
        if array.size:
            buffer.set_arg(i, memoryview(array))
    buffer.set_res(0, memoryview(y))
    deadline = 0.0

    def rate(t: float, state: Array, kept: Any = (buffer, function)) -> Array:
        if time.perf_counter() > deadline:
            raise TimeoutError(f"longer than {limit:g} s")
        now[0], x[:] = t, state
        run()
        return y.copy()

    def advance(k: int, state: Array) -> Array:
        nonlocal deadline
        piece, deadline = ode.pieces[k], time.perf_counter() + limit
        p[:] = piece.parameters
        span, bounds = piece.times[[0, -1]], {"rtol": tolerance, "atol": 0.1 * tolerance}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = solve_ivp(rate, span, state, name, piece.times, **bounds)
        if not found.success:
            raise ArithmeticError(found.message)
        return found.y.T

    return _solver(ode, advance, limit)


def _geographiclib(problem: Problem) -> Peer:
    """Latitudes and longitudes on an oblate body."""
    from geographiclib.geodesic import Geodesic

    scene = problem.make()
    obj, contact = scene.object, scene.contacts[0]
    assert isinstance(obj, cs.Ellipsoid) and obj.a == obj.b
    f, (turn, reduced) = 1.0 - obj.c / obj.a, contact.object_at
    latitude = math.degrees(math.atan2(math.sin(reduced), (1.0 - f) * math.cos(reduced)))
    azimuth = math.degrees(math.atan2(*contact.object_velocity))
    earth, wanted = Geodesic(obj.a, f), Geodesic.LATITUDE | Geodesic.LONGITUDE

    def solve() -> list[dict[str, float]]:
        line = earth.Line(latitude, math.degrees(turn), azimuth, wanted | Geodesic.DISTANCE_IN)
        return [line.Position(s, wanted) for s in problem.times]

    def points(ends: list[dict[str, float]]) -> Array:
        found = [obj.a * spheroid_point(f, end["lat2"], end["lon2"]) for end in ends]
        return np.array(found)[:, None, None]

    return Peer("geographiclib", (0.0,), lambda tolerance, limit: solve, points)
