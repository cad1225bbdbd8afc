"""Other integrators on the same motion: heyoka, CasADi's CVODES, scipy.

A `Method` builds a solver for one tolerance (just-in-time compilation happens there, outside every
time) and the solver then integrates one contact from an initial state.

References: Biscani & Izzo, MNRAS 504, 2021 (heyoka, Taylor series); Hindmarsh et al., ACM TOMS 31,
2005 (CVODES); Andersson et al., Math. Prog. Comp. 11, 2019 (CasADi); Virtanen et al., Nature
Methods 17, 2020 (scipy).
"""

from __future__ import annotations

import importlib.util
import os
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import contact_system as cs
from contact_system.equations import chart_equations
from contact_system.kernels import find_compiler

from .problems import metric

Solver = Callable[[np.ndarray, float], np.ndarray]
"""(initial state (9,), eta) -> states at the grid's times (n, 9)."""
FINEST = 3e-16
"""CVODES refuses relative tolerances below the rounding unit. Of stiff slip it reaches errors of
1e-12 only here, 10 to 30 times sooner than any other peer."""


@dataclass(frozen=True)
class Method:
    """A peer on the paper's chart equations of a sphere rolling on an object, gain law `path`.

    Attributes
    ----------
    name : str
    tolerances : loosest first
    build : callable
        tolerance -> Solver.
    limit : float
        Longest run, s.
    """

    name: str
    tolerances: tuple[float, ...]
    build: Callable[[float], Solver]
    limit: float = 20.0


def installed(package: str) -> bool:
    """Whether a package can be imported."""
    return importlib.util.find_spec(package) is not None


def decades(first: int, last: int) -> tuple[float, ...]:
    """1e-first ... 1e-last."""
    return tuple(10.0**-k for k in range(first, last + 1))


# --- heyoka ------------------------------------------------------------------------------------

HEYOKA = (*decades(3, 15), 2.3e-16)
"""A tolerance sets the order of the series; the floor is the rounding unit 2.2e-16."""


def heyoka_method(scene: cs.Scene, grid: np.ndarray, slip: bool = True) -> Method:
    """Taylor series on the chart equations, written by hand; ``slip``: with the feedback."""
    equations = _heyoka_equations(scene, slip)

    def build(tolerance: float) -> Solver:
        import heyoka as hy

        solver = hy.taylor_adaptive(equations, [1.0] * 9, tol=tolerance, pars=[0.0] if slip else [])

        def solve(state: np.ndarray, eta: float) -> np.ndarray:
            solver.time = 0.0
            solver.state[:] = state
            if slip:
                solver.pars[0] = eta
            return solver.propagate_grid(grid)[-1]

        return solve

    return Method("heyoka", HEYOKA, build)


def _heyoka_equations(scene: cs.Scene, slip: bool) -> list[tuple[Any, Any]]:
    """Theory section 2, state order u1 v1 u1' v1' u2 v2 u2' v2' psi; par[0] is eta."""
    import heyoka as hy

    names = ("u1", "v1", "a1", "b1", "u2", "v2", "a2", "b2", "psi")
    u1, v1, a1, b1, u2, v2, a2, b2, psi = state = hy.make_vars(*names)
    sigma, slope = 0.0, 0.0
    for k, c in reversed(list(enumerate(scene.profile.coefficients))):
        sigma = sigma * hy.time + c
        slope = slope * hy.time + k * c if k else slope
    growth = slope / sigma
    tip = metric(scene.contacts[0].finger, hy, u1, v1, a1, b1)
    body = metric(scene.object, hy, u2, v2, a2, b2)
    accelerations = [growth * a1 + tip.bend[0], growth * b1 + tip.bend[1]]
    object_accelerations = [growth * a2 + body.bend[0], growth * b2 + body.bend[1]]
    if slip:
        lam = hy.par[0] * sigma**2
        x, y = tip.lame[0] * a1, tip.lame[1] * b1
        cos, sin = hy.cos(psi), hy.sin(psi)
        object_accelerations[0] += lam * ((cos * x - sin * y) / body.lame[0] - a2)
        object_accelerations[1] += lam * ((-sin * x - cos * y) / body.lame[1] - b2)
    right = [a1, b1, *accelerations, a2, b2, *object_accelerations, tip.spin + body.spin]
    return list(zip(state, right, strict=True))


def heyoka_great_circles(
    radii: Sequence[float], lengths: np.ndarray, tolerance: float
) -> Callable[[np.ndarray], np.ndarray]:
    """Both contact points of rolling spheres in Cartesian form, x" = -|x'|^2/r^2 x in arc length.

    Parameters
    ----------
    radii : finger and object, m
    lengths : (n,), arc lengths of the output, m

    Returns
    -------
    callable
        (12,), point and path velocity of finger and object -> points (n, 2, 3), m.
    """
    import heyoka as hy

    symbols = hy.make_vars(*(f"x{i}" for i in range(12)))
    equations = []
    for k, r in enumerate(radii):
        x, p = symbols[6 * k : 6 * k + 3], symbols[6 * k + 3 : 6 * k + 6]
        square = (p[0] ** 2 + p[1] ** 2 + p[2] ** 2) / r**2
        equations += [(x[i], p[i]) for i in range(3)] + [(p[i], -square * x[i]) for i in range(3)]
    solver = hy.taylor_adaptive(equations, [1.0] * 12, tol=tolerance)

    def solve(start: np.ndarray) -> np.ndarray:
        solver.time = 0.0
        solver.state[:] = start
        return solver.propagate_grid(lengths)[-1].reshape(-1, 2, 6)[:, :, :3]

    return solve


# --- CasADi's CVODES ---------------------------------------------------------------------------


def cvodes_methods(scene: cs.Scene, grid: np.ndarray) -> list[Method]:
    """Adams and BDF on the symbolic chart equations, as C where there is a compiler."""
    finger, obj = scene.contacts[0].finger, scene.object
    t, state, eta = ca.SX.sym("t"), ca.SX.sym("state", 9), ca.SX.sym("eta")
    powers = enumerate(scene.profile.coefficients)
    terms = [(c * t**k, k * c * t ** max(k - 1, 0)) for k, c in powers]
    sigma, slope = sum(a for a, _ in terms), sum(b for _, b in terms)
    point = ca.vertcat(state, slope / sigma, eta * sigma**2, ca.SX.zeros(6))
    numbers = ca.DM([*finger.parameters, *obj.parameters])
    rate = chart_equations(finger, obj).function(point, numbers)
    problem = {"x": state, "t": t, "p": eta, "ode": rate}

    def method(family: str) -> Method:
        def build(tolerance: float) -> Solver:
            options: dict[str, Any] = {
                "linear_multistep_method": family, "reltol": tolerance,
                "abstol": 0.1 * tolerance, "max_num_steps": 100_000, "show_eval_warnings": False,
            }  # fmt: skip
            if find_compiler():
                options |= {"jit": True, "compiler": "shell", "jit_cleanup": False}
                options["jit_options"] = {"flags": ["-O3"], "verbose": False, "cleanup": False}
            solver = _in_scratch_folder(
                lambda: ca.integrator("peer", "cvodes", problem, 0.0, list(grid), options)
            )
            return lambda y, value: solver(x0=y, p=value)["xf"].full().T

        return Method(f"CVODES {family}", (*decades(7, 15), FINEST), build)

    return [method("adams"), method("bdf")]


def _in_scratch_folder(make: Callable[[], Any]) -> Any:
    """CasADi writes its C files into the working folder; loaded, they are not needed any more."""
    home = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            return make()
        finally:
            os.chdir(home)


# --- scipy -------------------------------------------------------------------------------------


def scipy_methods(scene: cs.Scene, grid: np.ndarray, limit: float) -> list[Method]:
    """scipy's solvers with the chart equations in CasADi's virtual machine.

    Raises (when solving)
    ---------------------
    TimeoutError
        A run takes longer than twice ``limit``, s.
    """
    from scipy.integrate import solve_ivp

    finger, obj = scene.contacts[0].finger, scene.object
    machine = chart_equations(finger, obj).machine(1)
    numbers = [*finger.parameters, *obj.parameters]
    c, x, y, run = machine.c, machine.x[0], machine.y[0], machine.run
    profile = scene.profile

    def method(name: str) -> Method:
        def build(tolerance: float) -> Solver:
            def solve(start: np.ndarray, eta: float) -> np.ndarray:
                c[0], x[9:] = numbers, 0.0
                deadline = time.perf_counter() + 2 * limit

                def rate(t: float, state: np.ndarray) -> np.ndarray:
                    if time.perf_counter() > deadline:
                        raise TimeoutError(f"{name}: longer than {limit:g} s")
                    sigma = profile(t)
                    x[:9], x[9], x[10] = state, profile.rate(t) / sigma, eta * sigma * sigma
                    run()
                    return y.copy()

                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    found = solve_ivp(
                        rate, (0.0, grid[-1]), start, name, grid,
                        rtol=tolerance, atol=0.1 * tolerance,
                    )  # fmt: skip
                if not found.success:
                    raise ArithmeticError(f"{name}: {found.message}")
                return found.y.T

            return solve

        # rtol below 100 rounding units is raised to it
        return Method(f"scipy {name}", (1e-8, 1e-11, 2.3e-14), build, limit)

    return [method(name) for name in ("DOP853", "LSODA", "Radau", "BDF")]
