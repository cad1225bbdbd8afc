"""Other libraries on the same motion: the integrators that were fastest somewhere.

A `Peer` builds a solver for one problem and one tolerance. Just-in-time compilation, and all else
that a second run would not repeat, happens there and is not timed. CVODES by Adams' methods,
geographiclib and scipy's RK45, DOP853, LSODA, Radau and BDF were measured too; none of them was the
fastest at any error of any problem.

References: Biscani & Izzo, MNRAS 504, 2021 (heyoka, Taylor series); Hindmarsh et al., ACM TOMS 31,
2005 (CVODES); Andersson et al., Math. Prog. Comp. 11, 2019 (CasADi, which calls it).
"""

from __future__ import annotations

import functools
import importlib.util
import itertools
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from .problems import Ode, Problem

Array = np.ndarray
Solver = Callable[[], Any]
"""Returns the states at the problem's times: for each contact an array (n, n_states)."""
FINEST = 3e-16
"""CVODES refuses relative tolerances below the rounding unit. Under stiff slip it reaches an error
of 1e-12 only with this one, but then sooner than any other peer."""
HEYOKA = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 2.3e-16)
"""Tolerances of heyoka, which determine the order of the series."""


@dataclass(frozen=True)
class Peer:
    """A library's method on one form of the equations."""

    name: str
    tolerances: tuple[float, ...]  # loosest first
    build: Callable[[float], Solver] | None  # makes the solver for a tolerance; None: our planner
    points: Callable[[Any], Array]  # result -> (n, n_contacts, n_bodies, 3), m; not timed


def decades(first: int, last: int) -> tuple[float, ...]:
    """1e-first ... 1e-last."""
    return tuple(10.0**-k for k in range(first, last + 1))


def heyokas(problem: Problem) -> Iterator[Peer]:
    """heyoka on every form of the equations."""
    if importlib.util.find_spec("heyoka"):
        for form, ode in problem.forms.items():
            name = f"heyoka, {form}" if len(problem.forms) > 1 else "heyoka"
            yield Peer(name, HEYOKA, functools.partial(_heyoka, ode), ode.all_points)


def peers(problem: Problem, full: bool) -> Iterator[Peer]:
    """All peers that are installed; ``full``: with every decade of tolerance."""
    yield from heyokas(problem)
    some = decades(3, 14) if full else (1e-4, 1e-7, 1e-9, 1e-11, 1e-13)
    # The form in space is regular everywhere and has no trigonometry: the better choice.
    ode = problem.forms.get("space") or problem.forms["chart"]
    yield Peer("CVODES", (*some, 1e-15, FINEST), functools.partial(_cvodes, ode), ode.all_points)


def _solver(ode: Ode, advance: Callable[[int, Array], Array]) -> Solver:
    """Solves piece by piece for all contacts; ``advance``: (piece, state) -> (n, n_states)."""

    def solve() -> list[Array]:
        columns = []
        for state in ode.starts:
            rows = [state[None]]
            for k in range(len(ode.pieces)):
                rows.append(advance(k, rows[-1][-1])[1:])
            columns.append(np.concatenate(rows))
        return columns

    return solve


def _heyoka(ode: Ode, tolerance: float) -> Solver:
    import heyoka as hy

    states, parameters = ode.starts.shape[1], len(ode.pieces[0].parameters)
    x = hy.make_vars(*(f"x{i:02d}" for i in range(states)))
    right = ode.rates(hy, hy.time, x, [hy.par[i] for i in range(parameters)])
    given = {"tol": tolerance, "pars": [0.0] * parameters}
    solver = hy.taylor_adaptive(list(zip(x, right)), [1.0] * states, **given)

    def advance(k: int, state: Array) -> Array:
        piece = ode.pieces[k]
        solver.time, solver.state[:] = piece.times[0], state
        if len(piece.parameters):
            solver.pars[:] = piece.parameters
        return solver.propagate_grid(piece.times)[-1]

    return _solver(ode, advance)


_NUMBER = itertools.count()


@functools.cache
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
    with tempfile.TemporaryDirectory() as folder:  # not needed once the library is loaded
        code, library = ca.CodeGenerator(f"{name}.c"), f"{folder}/{name}.so"
        for each in (plain, plain.jacobian()):
            code.add(each)
        source = code.generate(f"{folder}/")
        command = [compiler, "-O3", "-fPIC", "-shared", source, "-o", library, "-lm"]
        subprocess.run(command, check=True, capture_output=True)
        return ca.external(name, library)


def _cvodes(ode: Ode, tolerance: float) -> Solver:
    function = _function(ode)
    t, x = ca.MX.sym("t"), ca.MX.sym("x", ode.starts.shape[1])
    p = ca.MX.sym("p", len(ode.pieces[0].parameters))
    problem = {"x": x, "t": t, "p": p, "ode": function(t, x, p)}
    options = {
        "linear_multistep_method": "bdf",
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

    return _solver(ode, advance)
