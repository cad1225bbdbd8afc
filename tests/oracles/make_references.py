"""Reference solutions of high precision: external truth for the tests.

Nothing here imports ``contact_system``. The paper's chart equations (theory section 2: eq.
`contrac` with the errata of docs/errata.md, plus Montana's angle equation) are stated once more in
heyoka expressions and integrated by an adaptive Taylor method in multiple precision arithmetic
(Jorba and Zou, Experimental Mathematics 14, 2005; Biscani and Izzo, MNRAS 504, 2021). E and G of
each chart are written out by hand; slip, found with differences of the chart itself, must follow
the exact law.
Every solution is computed twice: with two tolerances, hence two orders, two step sequences and two
precisions, or, where that is too slow, compared with the development form (theory section 4);
the greatest difference is stored with it and must stay below `AGREEMENT`.

Run ``python tests/oracles/make_references.py [name ...]`` with the names of `MAKERS`; without a
name everything is made, in about 20 minutes. heyoka (multiprecision build) and mpmath are needed.
All inputs are the doubles that a Python user would write; results are decimal strings.
SI units, angles in radians.
"""

from __future__ import annotations

import json
import math
import random
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mpmath as mp
from equations import (
    AGREEMENT,
    AXES,
    PASSES,
    STIFF_PASSES,
    Case,
    Window,
    contact_points,
    development_error,
    geodesic,
    integrate,
    slip,
    slip_law_error,
    start_in_space,
)
from formulas import great_circle, helix

DIGITS = 25


def text(x: mp.mpf) -> str:
    """Decimal text of `DIGITS` significant digits."""
    return mp.nstr(x, DIGITS)


def short(x: mp.mpf) -> float:
    """An error measure rounded to two digits."""
    return float(mp.nstr(x, 2))


def agreed(what: str, difference: mp.mpf) -> float:
    """`short` of a difference that must stay below `AGREEMENT`, or ArithmeticError."""
    if difference > AGREEMENT:
        raise ArithmeticError(f"{what}: {mp.nstr(difference, 3)} exceeds {AGREEMENT}")
    return short(difference)


def sample_times(case: Case, count: int) -> list[float]:
    """`count` equally spaced doubles over the horizon, with the edges of the windows."""
    grid = {k * case.duration / (count - 1) for k in range(count)}
    return sorted(grid | {t for w in case.windows for t in (w.start, w.stop)})


def contact_record(case: Case, times: Sequence[float], stiff: bool) -> dict[str, Any]:
    """Solve one contact, check it and lay it out for the file."""
    begun = time.time()
    name = f"{case.object} {case.law} {case.eta:.3g} at {case.object_at}"
    first, second = STIFF_PASSES if stiff else PASSES
    states = integrate(case, times, *first)
    checks = {"slip_law_error": agreed(f"slip law, {name}", slip_law_error(case, times, states))}
    if not case.windows:
        difference = development_error(case, times, states)
        checks["development_error"] = agreed(f"development, {name}", difference)
    if not stiff:
        other = integrate(case, times, *second)
        difference = max(abs(a - b) for x, y in zip(states, other) for a, b in zip(x, y))
        checks["two_pass_difference"] = agreed(f"two passes, {name}", difference)
    print(f"  {name}: {checks}, {time.time() - begun:.1f} s", flush=True)
    slips = [slip(case, state) for state in states]
    given = ("object_at", "object_velocity", "finger_at", "finger_velocity", "angle")
    return {name: getattr(case, name) for name in given} | {
        "checks": checks,
        "states": [[text(x) for x in state] for state in states],
        "points": [[[text(c) for c in x] for x in contact_points(case, s)] for s in states],
        "slip": [[text(x) if abs(x) > 1e-30 else "0.0" for x in pair] for pair in slips],
    }


def scene_record(cases: Sequence[Case], count: int, stiff: bool = False) -> dict[str, Any]:
    """A scene: cases that differ in the object's contact only."""
    case = cases[0]
    times = sample_times(case, count)
    return {
        "object": {"surface": case.object, "radii": case.radii},
        "finger_radius": case.finger,
        "profile": case.profile,
        "gain": {"law": case.law, "eta": case.eta},
        "duration": case.duration,
        "windows": [vars(w) for w in case.windows],
        "times": times,
        "contacts": [contact_record(c, times, stiff) for c in cases],
    }


ABOUT = (
    "Made by tests/oracles/make_references.py from the paper's chart equations. states: u1 v1 du1 "
    "dv1 u2 v2 du2 dv2 psi; points: on the finger, on the object, each in its body's frame; slip: "
    "in E2, 0 below 1e-30. Absolute error below 1e-28, see checks."
)


def save(name: str, content: dict[str, Any]) -> None:
    """Write one file of the folder and print its size."""
    file = Path(__file__).with_name(f"{name}.json")
    file.write_text(json.dumps(content, separators=(",", ":")).replace("]],", "]],\n") + "\n")
    print(f"{file.name}: {file.stat().st_size / 1e3:.0f} kB", flush=True)


SPHERE_CONTACTS = (
    (math.pi / 6, math.pi / 6),
    (2 * math.pi / 3, math.pi / 6),
    (math.pi / 10, math.pi),
)
ELLIPSOID_CONTACTS = (
    (2 * math.pi / 3, math.pi / 2),
    (-2 * math.pi / 3, -math.pi / 2),
    (math.pi / 6, math.pi / 2),
)
GROWING = (0.001, 0.0, 0.4)
SETTLING = (0.1, 0.2, -0.02)


def paper_scenes(names: Sequence[str], law: str) -> dict[str, Any]:
    """Scenes K1 to K4 of theory section 10 with the given gain law and eta = 100."""
    ball = Case("sphere", (0.1,), 0.04, (0.0, 0.0), "rolling", GROWING, law, 100.0)
    egg = replace(ball, object="ellipsoid", radii=(0.3, 0.2, 0.1))
    scenes = {
        "K1": (replace(ball, object_velocity=(0.0, 0.0)), SPHERE_CONTACTS),
        "K2": (replace(ball, windows=(Window("finger", 0.0, 0.1, (0.1, 0.0)),)), SPHERE_CONTACTS),
        "K3": (
            replace(egg, windows=(Window("finger", 0.1, 0.15, (-0.1, -0.1)),)),
            ELLIPSOID_CONTACTS,
        ),
        "K4": (
            replace(
                egg,
                profile=SETTLING,
                duration=4.0,
                windows=(Window("finger", 1.0, 2.0, (-0.3, -0.3)),),
            ),
            ELLIPSOID_CONTACTS,
        ),
    }
    return {
        name: scene_record([replace(case, object_at=at) for at in contacts], 41)
        for name, (case, contacts) in scenes.items()
        if name in names
    }


def make_k_scenes() -> None:
    """K1 to K4 with the gain law `path`; K1 and K2 with `time` in a file of their own."""
    save("k_scenes", {"about": ABOUT, "scenes": paper_scenes(("K1", "K2", "K3", "K4"), "path")})
    save("k_scenes_time", {"about": ABOUT, "scenes": paper_scenes(("K1", "K2"), "time")})


def make_torus_slip() -> None:
    """One contact on a torus, both bodies disturbed."""
    case = Case(
        "torus",
        (0.1, 0.03),
        0.02,
        (0.3, 0.8),
        (0.3, -0.5),
        (0.02, 0.0, 0.4),
        "time",
        5.0,
        angle=0.4,
        windows=(Window("finger", 0.2, 0.4, (0.5, -0.8)), Window("object", 0.5, 0.6, (0.7, 1.1))),
    )
    save("torus_slip", {"about": ABOUT, "scenes": {"torus": scene_record([case], 11)}})


def slip_case(surface: str, radii: tuple[float, ...]) -> Case:
    """The contact of all scenes with slip."""
    case = Case(surface, radii, 0.04, (0.7, 0.4), (0.2, -0.9), GROWING, "path", 100.0)
    return replace(case, finger_at=(1.1, 0.2), angle=0.3)


def slip_scenes(surface: str, radii: tuple[float, ...]) -> dict[str, Any]:
    """Slip under six gains, up to the stiffness 1e7; the keys name law and gain.

    The two stiffest are integrated once, with `STIFF_PASSES`[0]: their second, independent
    solution is the development form.
    """
    case = slip_case(surface, radii)
    gains = {
        "path 1e2": ("path", 1e2),
        "path 1e4": ("path", 1e4),
        "path peak 1e7": ("path", 1e7 / 0.401**2),
        "time 1e2": ("time", 1e2),
        "time 1e4": ("time", 1e4),
        "time 1e6": ("time", 1e6),
    }
    return {
        name: scene_record([replace(case, law=law, eta=eta)], 11, stiff=eta > 1e5)
        for name, (law, eta) in gains.items()
    }


BODIES = {"sphere": (0.1,), "ellipsoid": AXES}


def make_slip() -> None:
    """Slip on the sphere and on the triaxial ellipsoid from mild to stiff, a file for each."""
    for surface, radii in BODIES.items():
        save(f"{surface}_slip", {"about": ABOUT, "scenes": slip_scenes(surface, radii)})


def make_slip_peaks() -> None:
    """Slip whose greatest eta sigma^2 is 1, 1e3 and 1e5; 1e7 is in the files above."""
    scenes = {}
    for surface, radii in BODIES.items():
        case = slip_case(surface, radii)
        for peak in (1e0, 1e3, 1e5):
            chosen = replace(case, eta=peak / 0.401**2)
            record = scene_record([chosen], 11, stiff=chosen.eta > 1e5)
            scenes[f"{surface} peak {peak:.0e}"] = record
    save("slip_peaks", {"about": ABOUT, "scenes": scenes})


# Geodesics of the triaxial ellipsoid.

LENGTH = 3.0


def jacobi_integral(state: Sequence[mp.mpf]) -> mp.mpf:
    """(b^2-c^2) cos^2 v sin^2 a - (a^2-b^2) sin^2 u cos^2 a, a from the v-line; in m^2.

    From point and direction, with sin^2 u and cos^2 v by the closed inverse chart.
    """
    a2, b2, c2 = squares = [mp.mpf(r) ** 2 for r in AXES]
    x, p = state[:3], state[3:]
    P = sum(squares) - mp.fdot(x, x)
    pairs = (b2 + c2, a2 + c2, a2 + b2)
    Q = a2 * b2 + a2 * c2 + b2 * c2 - mp.fsum(w * c * c for w, c in zip(pairs, x))
    root = mp.sqrt(P * P - 4 * Q)
    l3, l2 = (P + root) / 2, (P - root) / 2
    # The gradient of a confocal coordinate l points along the line on which only l changes.
    gradient = [c / (square - l3) for c, square in zip(x, squares)]
    sin2a = mp.fdot(gradient, p) ** 2 / mp.fdot(gradient, gradient)
    return (b2 - l2) * sin2a - (l3 - b2) * (1 - sin2a)


def geodesic_starts() -> list[tuple[float, float, float]]:
    """190 random (u, v, angle), then 10 aimed at an umbilic but for an offset of the angle."""
    rng = random.Random(20240229)
    a2, b2, c2 = (r * r for r in AXES)
    starts = []
    for i in range(200):
        u, v = rng.uniform(-math.pi, math.pi), rng.uniform(-math.pi / 2, math.pi / 2)
        angle = rng.uniform(-math.pi, math.pi)
        if i >= 190:
            offset = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-10, 1e-12, 0.0)[i - 190]
            ratio = math.sqrt((b2 - c2) / (a2 - b2)) * math.cos(v) / abs(math.sin(u))
            angle = math.copysign(1.0, angle) * (math.atan(ratio) + offset)
        starts.append((u, v, angle))
    return starts


def geodesic_record(start: tuple[float, float, float]) -> dict[str, Any]:
    """One geodesic, computed twice and checked."""
    u, v, angle = start
    state = start_in_space("ellipsoid", AXES, (u, v), (mp.cos(angle), mp.sin(angle)))
    points = (LENGTH / 2, LENGTH)
    found, other = (geodesic(state, points, passed) for passed in PASSES)
    difference = max(abs(a - b) for x, y in zip(found, other) for a, b in zip(x, y))
    integral = jacobi_integral(state)
    drift = max(abs(jacobi_integral(x) - integral) for x in found)
    return {
        "start": start,
        "middle": [text(x) for x in found[0][:3]],
        "end": [text(x) for x in found[1][:3]],
        "end_direction": [text(x) for x in found[1][3:]],
        "jacobi": text(integral),
        "checks": [agreed(f"geodesic {start}", x) for x in (difference, drift)],
    }


def make_ellipsoid_geodesics() -> None:
    """200 geodesics of 3 m on the ellipsoid 0.3/0.2/0.1."""
    about = (
        "Made by tests/oracles/make_references.py, integrating x'' = -(x'.Ax')/|Ax|^2 Ax. start: "
        "u, v, angle of the direction from f_u towards f_v; middle, end: points at s = 1.5 and 3; "
        "jacobi: (b^2-c^2) cos^2 v sin^2 a - (a^2-b^2) sin^2 u cos^2 a, a from the v-line, m^2. "
        "The last 10 are aimed at an umbilic but for an offset. checks: greatest difference of "
        "two passes, greatest drift of Jacobi's integral."
    )
    records = [geodesic_record(start) for start in geodesic_starts()]
    columns = {key: [r[key] for r in records] for key in records[0] if key != "checks"}
    checks = [max(r["checks"][k] for r in records) for k in range(2)]
    named = dict(zip(("two_pass_difference", "jacobi_drift"), checks))
    print(f"  {named}")
    head = {"about": about, "axes": AXES, "length": LENGTH, "checks": named}
    save("ellipsoid_geodesics", head | columns)


# Geodesics of one start on several surfaces, for run time against error.


def geodesic_points(
    surface: str, radii: Sequence[float], at: Any, w: Any, times: Sequence[float], passed: Any
) -> list[list[mp.mpf]]:
    """Points of one geodesic, shape (len(times), 3); ``passed`` as in `PASSES`."""
    if surface in ("sphere", "cylinder"):
        closed = great_circle if surface == "sphere" else helix
        return [closed(radii[0], at, w, t) for t in times]
    start = start_in_space(surface, radii, at, w)
    return [row[:3] for row in geodesic(start, times, passed, surface, radii)]


#: Ten times the body's size at about 1 m/s.
GEODESICS = {
    "sphere": ("sphere", (0.1,), (1.2, 0.3), 1.0),
    "cylinder": ("cylinder", (0.1,), (0.5, 0.02), 1.0),
    "torus": ("torus", (0.1, 0.03), (0.3, 0.8), 1.3),
    "ellipsoid": ("ellipsoid", AXES, (0.7, 0.4), 3.0),
    "spheroid": ("ellipsoid", (1.0, 1.0, 0.99), (0.7, 0.4), 10.0),
}


def make_geodesics() -> None:
    """One geodesic on each of the surfaces, with 41 points."""
    records, w = {}, (0.6, 0.8)
    for name, (surface, radii, at, duration) in GEODESICS.items():
        times = [k * duration / 40 for k in range(41)]
        found, other = (geodesic_points(surface, radii, at, w, times, p) for p in PASSES)
        difference = max(abs(a - b) for x, y in zip(found, other) for a, b in zip(x, y))
        records[name] = {
            "object": {"surface": surface, "radii": radii},
            "at": at,
            "velocity": w,
            "duration": duration,
            "checks": {"two_pass_difference": agreed(f"geodesic, {name}", difference)},
            "times": times,
            "points": [[text(c) for c in x] for x in found],
        }
        print(f"  {name}: {records[name]['checks']}", flush=True)
    about = (
        "Made by tests/oracles/make_references.py. points: of the geodesic that starts at (u, v) = "
        "at with velocity (m/s) along the axes of the chart's frame, at times (s), in m; closed "
        "form on sphere and cylinder. checks: greatest difference of two passes."
    )
    save("geodesics", {"about": about, "geodesics": records})


MAKERS: dict[str, Callable[[], None]] = {
    "k_scenes": make_k_scenes,
    "torus_slip": make_torus_slip,
    "ellipsoid_geodesics": make_ellipsoid_geodesics,
    "slip": make_slip,
    "slip_peaks": make_slip_peaks,
    "geodesics": make_geodesics,
}


def main(names: Sequence[str]) -> None:
    """Make the named references, or all of them."""
    unknown = [name for name in names if name not in MAKERS]
    if unknown:
        raise SystemExit(f"unknown reference {unknown[0]!r}; known: {', '.join(MAKERS)}")
    for name in names or MAKERS:
        print(name)
        MAKERS[name]()


if __name__ == "__main__":
    main(sys.argv[1:])
