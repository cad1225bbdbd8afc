"""The paper's chart equations (theory section 2): the kernel, and plans that obey it."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from conftest import SURFACES, derivative, one_contact

import contact_system as cs
from contact_system.equations import chart_equations
from contact_system.errors import SceneError, SurfaceError
from contact_system.kernels import replay

R1, R2 = 0.04, 0.1
CHARTED = [name for name in SURFACES if SURFACES[name][0].has_chart]
WINDOW = (0.3, 0.6)
DISTURBANCES = {
    "finger acceleration": cs.FingerAcceleration(0, *WINDOW, (0.5, -0.8)),
    "object acceleration": cs.ObjectAcceleration(0, *WINDOW, (0.7, 0.6)),
    "object rate offset": cs.ObjectRateOffset(0, *WINDOW, (0.4, -0.3)),
}


def sphere_on_sphere(q, growth, lam, d1=(0, 0), d2=(0, 0), offset=(0, 0), m=np):
    """Eqs. `timegeodesic`, `contrac` (errata: u'^2) for radii R1, R2, written out by hand.

    Gamma^1_22 = -sin u cos u, Gamma^2_12 = cot u, M = diag(r, r sin u), T = (0, cot u / r).
    """
    u1, _, du1, dv1, u2, _, du2, dv2, psi = q
    mu, mv = du2 + offset[0], dv2 + offset[1]  # the contact point's own rates
    ax, ay = R1 * du1, R1 * m.sin(u1) * dv1
    rolled_x = m.cos(psi) * ax - m.sin(psi) * ay
    rolled_y = -m.sin(psi) * ax - m.cos(psi) * ay
    cot_2 = m.cos(u2) / m.sin(u2)
    return [
        du1,
        dv1,
        growth * du1 + m.sin(u1) * m.cos(u1) * dv1**2 + d1[0],
        growth * dv1 - 2 * m.cos(u1) / m.sin(u1) * du1 * dv1 + d1[1],
        mu,
        mv,
        growth * du2 + m.sin(u2) * m.cos(u2) * mv * dv2 + lam * (rolled_x / R2 - du2) + d2[0],
        growth * dv2
        - cot_2 * (mu * dv2 + mv * du2)
        + lam * (rolled_y / (R2 * m.sin(u2)) - dv2)
        + d2[1],
        m.cos(u1) * dv1 + m.cos(u2) * mv,
    ]


def kernel_values(finger: cs.Surface, obj: cs.Surface, points: np.ndarray) -> np.ndarray:
    """The kernel at (n, 17) points: (n, 9)."""
    kernel = chart_equations(finger, obj)
    out = np.empty((1, 9, len(points)))
    constants = np.array([[*finger.parameters, *obj.parameters]])
    kernel(np.ascontiguousarray(points.T[None]), constants, out)
    return out[0].T


def random_points(count: int) -> np.ndarray:
    """States off the poles, growth, lam, d1, d2, offset: (n, 17)."""
    points = np.random.default_rng(3).normal(size=(count, 17))
    points[:, [0, 4]] = np.random.default_rng(4).uniform(0.4, 2.7, (count, 2))
    return points


# --- the kernel


def test_kernel_is_the_papers_equations_on_spheres():
    points = random_points(300)
    expected = np.array(
        [sphere_on_sphere(x[:9], x[9], x[10], x[11:13], x[13:15], x[15:17]) for x in points]
    )
    values = kernel_values(cs.Sphere(R1), cs.Sphere(R2), points)
    assert values == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_kernel_replayed_with_mpmath_is_the_papers_equations_to_its_precision():
    operations = {
        "OP_ADD": lambda a, b: a + b, "OP_SUB": lambda a, b: a - b, "OP_MUL": lambda a, b: a * b,
        "OP_DIV": lambda a, b: a / b, "OP_NEG": lambda a: -a, "OP_SQ": lambda a: a * a,
        "OP_TWICE": lambda a: 2 * a, "OP_INV": lambda a: 1 / a, "OP_SQRT": mp.sqrt,
        "OP_SIN": mp.sin, "OP_COS": mp.cos, "OP_FABS": abs, "OP_ASSIGN": lambda a: a,
    }  # fmt: skip
    import casadi as ca

    by_code = {getattr(ca, name): f for name, f in operations.items()}
    function = chart_equations(cs.Sphere(R1), cs.Sphere(R2)).function
    point = random_points(1)[0]
    with mp.workdps(40):
        exact = [mp.mpf(x) for x in point]
        (values,) = replay(
            function, [exact, [mp.mpf(R1), mp.mpf(R2)]], lambda op, w: by_code[op](*w), mp.mpf
        )
        expected = sphere_on_sphere(exact[:9], exact[9], exact[10], exact[11:13], exact[13:15],
                                    exact[15:17], m=_Exact)  # fmt: skip
        assert max(abs(a - b) for a, b in zip(values, expected)) < mp.mpf(10) ** -36
    floats = kernel_values(cs.Sphere(R1), cs.Sphere(R2), point[None])[0]
    assert floats == pytest.approx([float(x) for x in values], rel=1e-13, abs=1e-13)


class _Exact:
    """mpmath numbers for `sphere_on_sphere`; its radii are the doubles R1 and R2."""

    sin, cos = staticmethod(mp.sin), staticmethod(mp.cos)


def test_kernel_refuses_a_surface_without_a_chart():
    with pytest.raises(SurfaceError, match="no explicit chart"):
        chart_equations(cs.Sphere(R1), SURFACES["rounded cube"][0])


# --- plans obey the equations


def assert_states_obey_the_equations(plan: cs.Plan, times: np.ndarray) -> None:
    """d/dt of a plan's states against the kernel, at times of one interval each."""
    (contact,), obj = plan.scene.contacts, plan.scene.object
    states, sigma = plan.states(times)[:, 0], plan.scene.profile(times)
    points = np.zeros((len(times), 17))
    points[:, :9] = states
    points[:, 9] = plan.scene.profile.rate(times) / sigma
    gain = plan.scene.gain
    points[:, 10] = gain.value * (sigma**2 if gain.law == "path" else 1.0)
    for d in plan.scene.disturbances:
        inside = (d.start <= times) & (times < d.stop)
        first = {"finger acceleration": 11, "object acceleration": 13, "object rate offset": 15}
        points[inside, first[d.kind] : first[d.kind] + 2] += d.value
    points[:, 6:8] -= points[:, 15:17]  # states hold the point's rates, the equations their own
    expected = kernel_values(contact.finger, obj, points)
    rate = derivative(lambda t: plan.states(t)[:, 0], times)
    scale = np.maximum(1.0, np.abs(expected).max(0))
    assert rate / scale == pytest.approx(expected / scale, abs=1e-9)


@pytest.mark.parametrize("gain", [cs.Gain.path(80.0), cs.Gain.time(4.0)])
@pytest.mark.parametrize("obj", CHARTED)
def test_states_obey_the_chart_equations(obj, gain):
    scene = one_contact(obj, gain=gain, profile=(0.2, 0.1))
    assert_states_obey_the_equations(cs.plan(scene), np.linspace(0.05, 0.95, 19))


@pytest.mark.parametrize("finger", CHARTED)
def test_states_obey_the_chart_equations_for_every_finger(finger):
    scene = one_contact("ellipsoid", finger, profile=(0.2, 0.1))
    assert_states_obey_the_equations(cs.plan(scene), np.linspace(0.05, 0.95, 19))


@pytest.mark.parametrize("kinds", [*([kind] for kind in DISTURBANCES), list(DISTURBANCES)],
                         ids=[*DISTURBANCES, "all"])  # fmt: skip
@pytest.mark.parametrize("obj", CHARTED)
def test_states_obey_the_chart_equations_under_disturbances(obj, kinds):
    scene = one_contact(obj, "sphere", profile=(0.2, 0.1),
                        disturbances=[DISTURBANCES[kind] for kind in kinds])  # fmt: skip
    times = np.array([0.1, 0.2, 0.29, 0.31, 0.4, 0.5, 0.59, 0.61, 0.7, 0.9])
    assert_states_obey_the_equations(cs.plan(scene), times)


@pytest.mark.parametrize("finger", ["plane", "cylinder", "ellipsoid", "torus", "bumps"])
def test_states_obey_the_chart_equations_while_the_finger_is_pushed(finger):
    scene = one_contact("ellipsoid", finger, profile=(0.2, 0.1),
                        disturbances=[DISTURBANCES["finger acceleration"]])  # fmt: skip
    times = np.array([0.2, 0.29, 0.31, 0.4, 0.59, 0.61, 0.9])
    assert_states_obey_the_equations(cs.plan(scene), times)


def test_states_obey_the_chart_equations_beyond_the_ellipsoids_seam():
    # On the second cover f_u and f_v have turned by pi: the disturbance's components with them.
    scene = one_contact("ellipsoid", object_at=(0.9, 1.3), finger_velocity=(0.1, 0.99), angle=np.pi,
                        object_velocity="rolling", profile=(0.4, 0.1), duration=2.0,
                        disturbances=[cs.ObjectAcceleration(0, 1.0, 1.5, (0.7, 0.6)),
                                      cs.ObjectRateOffset(0, 1.2, 1.5, (0.4, -0.3))])  # fmt: skip
    plan = cs.plan(scene)
    times = np.array([0.9, 0.99, 1.01, 1.1, 1.19, 1.21, 1.4, 1.49, 1.51, 1.9])
    assert np.abs(plan.states(times)[:, 0, 5]).max() > np.pi / 2  # it did cross the seam
    assert_states_obey_the_equations(plan, times)


# --- the same scenes, integrated as chart equations


@pytest.mark.parametrize(
    "obj, finger",
    [("sphere", "sphere"), ("ellipsoid", "sphere"), ("torus", "ellipsoid"), ("bumps", "cylinder")],
)
def test_method_chart_agrees_with_the_default_to_its_tolerance(obj, finger):
    scene = one_contact(obj, finger, profile=(0.2, 0.1), disturbances=list(DISTURBANCES.values()))
    t = np.linspace(0.0, 1.0, 31)
    default, chart = cs.plan(scene), cs.plan(scene, method="chart", tolerance=1e-9)
    assert "chart equations by DOP853" in chart.explain()
    for ask in ("states", "points", "slip", "pose", "twist", "acceleration"):
        expected = getattr(default, ask)(t)
        bar = 1e-7 * np.abs(expected).max()
        assert getattr(chart, ask)(t) == pytest.approx(expected, abs=bar), ask


@pytest.mark.parametrize("solver", ["RK45", "Radau", "BDF", "LSODA"])
def test_method_chart_takes_any_of_scipys_solvers(solver):
    scene = one_contact(profile=(0.2, 0.1), duration=0.3)
    t = np.linspace(0.0, 0.3, 7)
    chart = cs.plan(scene, method="chart", tolerance=1e-6, solver=solver)
    assert chart.points(t) == pytest.approx(cs.plan(scene).points(t), abs=1e-4 * 0.1)


def test_method_chart_refuses_what_its_equations_cannot_state():
    with pytest.raises(SceneError, match="sigma, which is zero at t = 0 s"):
        cs.plan(one_contact(profile=(0.0, 0.3)), method="chart")
    with pytest.raises(SceneError, match="scene 'C2', contact 0: imposed rolling"):
        cs.plan(cs.load_scene("C2"), method="chart")
    with pytest.raises(SceneError, match="scene '.*cube', contact 0: .* no explicit chart"):
        cs.plan(one_contact("rounded cube"), method="chart")
    with pytest.raises(SceneError, match="use one of RK23"):
        cs.plan(one_contact(), method="chart", solver="Euler")
    with pytest.raises(SceneError, match="solver = None: use one of RK23"):
        cs.plan(one_contact(), solver=None)  # it would be kept, and be told of too late
