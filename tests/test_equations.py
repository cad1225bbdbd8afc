"""The paper's chart equations (theory section 2) as printed, and plans that obey them."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import RESULTS, SURFACES, WINDOWS, derivative, one_contact

import contact_system as cs

R1, R2 = 0.04, 0.1
CHARTED = [name for name in SURFACES if SURFACES[name][0].has_chart]


def sphere_on_sphere(q, growth, lam, d1, d2, offset):
    """Eqs. `timegeodesic`, `contrac` (errata: u'^2) for radii R1, R2, written out by hand.

    Gamma^1_22 = -sin u cos u, Gamma^2_12 = cot u, M = diag(r, r sin u), T = (0, cot u / r).
    """
    u1, _, du1, dv1, u2, _, du2, dv2, psi = q
    sin, cos = np.sin, np.cos
    mu, mv = du2 + offset[0], dv2 + offset[1]  # the contact point's own rates
    ax, ay = R1 * du1, R1 * sin(u1) * dv1
    rolled_x = cos(psi) * ax - sin(psi) * ay
    rolled_y = -sin(psi) * ax - cos(psi) * ay
    cot_2 = cos(u2) / sin(u2)
    return [
        du1,
        dv1,
        growth * du1 + sin(u1) * cos(u1) * dv1**2 + d1[0],
        growth * dv1 - 2 * cos(u1) / sin(u1) * du1 * dv1 + d1[1],
        mu,
        mv,
        growth * du2 + sin(u2) * cos(u2) * mv * dv2 + lam * (rolled_x / R2 - du2) + d2[0],
        growth * dv2
        - cot_2 * (mu * dv2 + mv * du2)
        + lam * (rolled_y / (R2 * sin(u2)) - dv2)
        + d2[1],
        cos(u1) * dv1 + cos(u2) * mv,
    ]


def test_the_chart_equations_of_two_spheres_are_the_papers():
    rng, profile = np.random.default_rng(3), cs.Profile((0.3, 0.7, 0.2))
    scene = one_contact(cs.Sphere(R2), cs.Sphere(R1), cs.Gain.path(80.0), profile.coefficients)
    system = cs.SceneSystem(scene, "chart", disturbance_input=True)
    for t in rng.uniform(0, 1, 100):
        x, w = rng.normal(size=9), rng.normal(size=6)
        x[[0, 4]] = rng.uniform(0.4, 2.7, 2)  # off the poles
        sigma = profile(t)
        drive = profile.rate(t) / sigma, 80.0 * sigma**2
        expected = sphere_on_sphere(x, *drive, w[:2], w[2:4], w[4:])
        found = system.evaluate("derivatives", t, x, w)
        assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)


# --- plans obey the equations


def assert_states_obey_the_equations(scene: cs.Scene, times: np.ndarray) -> None:
    """d/dt of a plan's states agrees with the equations at times away from windows' edges."""
    plan, system = cs.plan(scene), cs.SceneSystem(scene, "chart")
    states = plan.states(times)[:, 0]
    expected = []
    for t, x in zip(times, states.copy()):
        if system.n_w:  # a plan's rates of the object hold the rate offset, the equations' do not
            x[6:8] -= system.window_values(t)[4:]
        expected.append(system.evaluate("derivatives", t, x))
    rate = derivative(lambda t: plan.states(t)[:, 0], times)
    scale = np.maximum(1.0, np.abs(expected).max(0))
    assert rate / scale == pytest.approx(expected / scale, abs=1e-9)


@pytest.mark.parametrize("pushes", [(), WINDOWS], ids=["calm", "disturbed"])
@pytest.mark.parametrize("surface", CHARTED)
def test_states_obey_the_chart_equations(surface, pushes):
    given = {"profile": (0.2, 0.1), "disturbances": pushes}
    times = np.array([0.1, 0.19, 0.21, 0.29, 0.31, 0.39, 0.41, 0.55, 0.61, 0.79, 0.81, 0.9])
    scene = one_contact(surface, gain=cs.Gain.path(80.0), **given)
    assert_states_obey_the_equations(scene, times)
    assert_states_obey_the_equations(one_contact("ellipsoid", surface, **given), times)


def test_states_obey_the_chart_equations_beyond_the_ellipsoids_seam():
    # On the second cover f_u and f_v have opposite directions, and so has a given disturbance.
    start = {"object_at": (0.9, 1.3), "finger_velocity": (0.1, 0.99), "angle": np.pi}
    start |= {"object_velocity": "rolling", "profile": (0.4, 0.1), "duration": 2.0}
    pushes = [
        cs.ObjectAcceleration(0, 1.0, 1.5, (0.7, 0.6)),
        cs.ObjectRateOffset(0, 1.2, 1.5, (0.4, -0.3)),
    ]
    scene = one_contact("ellipsoid", disturbances=pushes, **start)
    times = np.array([0.9, 0.99, 1.01, 1.1, 1.19, 1.21, 1.4, 1.49, 1.51, 1.9])
    assert np.abs(cs.plan(scene).states(times)[:, 0, 5]).max() > np.pi / 2  # it crosses the seam
    assert_states_obey_the_equations(scene, times)


# --- the same scenes, integrated as chart equations


@pytest.mark.parametrize(
    ("obj", "finger"),
    [("sphere", "sphere"), ("ellipsoid", "sphere"), ("torus", "ellipsoid"), ("bumps", "cylinder")],
)
def test_method_chart_agrees_with_the_default_to_its_tolerance(obj, finger):
    scene = one_contact(obj, finger, profile=(0.2, 0.1), disturbances=WINDOWS)
    t = np.linspace(0.0, 1.0, 31)
    default, chart = cs.plan(scene), cs.plan(scene, method="chart", tolerance=1e-9)
    assert "chart equations by DOP853" in chart.explain()
    for result in RESULTS:
        expected = getattr(default, result)(t)
        bar = 1e-7 * np.abs(expected).max()
        assert getattr(chart, result)(t) == pytest.approx(expected, abs=bar), result


@pytest.mark.parametrize("solver", ["RK45", "Radau", "BDF", "LSODA"])
def test_method_chart_takes_any_of_scipys_solvers(solver):
    scene = one_contact(profile=(0.2, 0.1), duration=0.3)
    t = np.linspace(0.0, 0.3, 7)
    chart = cs.plan(scene, method="chart", tolerance=1e-6, solver=solver)
    assert chart.points(t) == pytest.approx(cs.plan(scene).points(t), abs=1e-4 * 0.1)


@pytest.mark.parametrize(
    ("scene", "given", "words"),
    [
        (one_contact(profile=(0.0, 0.3)), {}, "sigma, which is zero at t = 0 s"),
        (cs.load_scene("C2"), {}, "scene 'C2', contact 0 .finger.: .* cannot impose rolling"),
        (one_contact("rounded cube"), {}, "scene '.*cube', contact 0: .* no explicit chart"),
        (one_contact(), {"solver": "Euler"}, "use one of RK23"),
        # also with the method that does not use it: it is saved with the plan
        (one_contact(), {"solver": None, "method": "auto"}, "solver = None is unknown"),
    ],
)
def test_method_chart_refuses_what_its_equations_cannot_state(scene, given, words):
    with pytest.raises(cs.SceneError, match=words):
        cs.plan(scene, **{"method": "chart", **given})
