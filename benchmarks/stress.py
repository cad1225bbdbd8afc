"""Stress: many cases at the edge of what can be computed; each is right, refused or a failure.

A case plans a scene and judges the plan by exact laws. Cases run in a worker process under a
watchdog, so that a hang or a crash of the process is counted, and does not end the bench.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import multiprocessing
import os
import random
import re
import time
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import contact_system as cs
from contact_system.scene.files import scene_from_toml, scene_text

from .report import ROOT, Bar, Sections
from .stress_laws import NAN, Meter, Verdict, refusal, run
from .stress_scenes import ETAS, LAWS, MADE, OF_USERS, PROFILES, SHAPES, Draw, draw_trial

FAILURES = ("silent", "crash", "hang")


@dataclass(frozen=True)
class Family:
    """Cases of one kind. A case depends on its index alone, so any process can run it any time."""

    name: str
    count: int  # of cases without --full: indices 0 to count - 1
    run: Callable[[int], Verdict]  # may raise: use `judged`


def judged(case: Callable[[], Verdict]) -> Verdict:
    """The verdict of a case; an exception gives one too."""
    try:
        return case()
    except cs.ContactSystemError as error:
        return refusal(str(error))
    except Exception as error:
        return Verdict("crash", message=f"{type(error).__name__}: {error}")


def grid(
    name: str,
    /,
    repeats: int,
    cases: Sequence[dict[str, Any]] = ({},),
    always: dict[str, Any] | None = None,
    **axes: Sequence[Any],
) -> Family:
    """All combinations of some choices of `draw_trial`; each repeat draws all others anew.

    ``cases`` is the first axis, each item of which makes several choices at once. ``axes`` are
    further axes: for the name of a choice, its values. ``always`` holds choices of all cases.
    """
    lengths = [len(cases), *map(len, axes.values())]
    key = zlib.crc32(name.encode())

    def one(index: int) -> Verdict:
        first, *others = np.unravel_index(index % math.prod(lengths), lengths)
        drawn = {choice: axes[choice][i] for choice, i in zip(axes, others)}
        return run(draw_trial(Draw(key, index), **cases[first] | drawn | (always or {})))

    return Family(name, repeats * math.prod(lengths), one)


BUILT_IN, USERS = ([f.__name__ for f in made] for made in (MADE, OF_USERS))
MISSES = (0.0, *(10.0**-k for k in range(15, -1, -1)))
HARD = ("oblate", "prolate", "equal axes", "plain", "needle", "pancake", "nearly a sphere")
POLES = [
    {"kind": "sphere"},
    *({"kind": "ellipsoid", "shape": shape} for shape in HARD),
    {"kind": "implicit_ellipsoid"},
]
"""Bodies with poles or umbilics."""


def _poles() -> list[dict[str, Any]]:
    """Every kind of pole, passed on the object or the finger at every angle of `MISSES`."""
    cases = []
    always = {"profile": "constant", "windows": 0, "turns": 4.0}
    for what, side, miss in itertools.product(POLES, ("object", "finger"), MISSES):
        other = {"object": "finger", "finger": "object"}[side]
        shape = {"shape": what["shape"]} if "shape" in what else {}
        cases.append({side: what["kind"], other: "sphere", "pole": (side, miss)} | always | shape)
    return cases


def _bowls() -> list[dict[str, Any]]:
    """Fingers of the same form as their bowl, smaller by a part of the radius."""
    return [
        {"object": kind, "finger": kind, "ratio": 1.0 - less}
        for kind in ("sphere", "cylinder", "torus", "ellipsoid", "plane")
        for less in (0.0, *(10.0**-k for k in range(16, 0, -1)), 0.5)
    ]


# --- mutated files --------------------------------------------------------------------------------

NUMBER = re.compile(r"(?<![\w.\"-])-?\d+(?:\.\d+)?(?:e-?\d+)?")
BUNDLED = tuple(cs.bundled_scenes())


def _mutated(index: int) -> Verdict:
    """A bundled scene's file with one to three changes, which is planned or refused by name."""
    rng = random.Random(index)
    name = rng.choice(BUNDLED)
    text, file = scene_text(name)[0], f"mutated {name}.toml"
    for _ in range(rng.choice((1, 1, 2, 3))):
        text = rng.choice((*[_other_number] * 8, _other_lines, _other_sections))(rng, text)

    try:
        scene = scene_from_toml(text, file)
    except cs.ContactSystemError as error:
        return Verdict("refused" if file in str(error) else "crash", message=str(error))
    return _sound(cs.plan(scene))


def _other_number(rng: random.Random, text: str) -> str:
    found = list(NUMBER.finditer(text))
    if not found:
        return text
    match = rng.choice(found)
    x = float(match[0])
    scaled = [x * 10 ** rng.uniform(-k, k) for k in (1, 3, 10, 20)]
    value = rng.choice((*scaled, *scaled, -x, 0.0, 10 ** rng.uniform(-300, 300)))
    return f"{text[: match.start()]}{value!r}{text[match.end() :]}"


def _other_lines(rng: random.Random, text: str) -> str:
    """Leave a line out, or write it twice."""
    lines = text.splitlines()
    k = rng.randrange(len(lines))
    lines[k : k + 1] = [lines[k]] * rng.choice((0, 2))
    return "\n".join(lines)


def _other_sections(rng: random.Random, text: str) -> str:
    """Exchange two sections."""
    parts = re.split(r"^(?=\[)", text, flags=re.MULTILINE)
    i, j = rng.randrange(len(parts)), rng.randrange(len(parts))
    parts[i], parts[j] = parts[j], parts[i]
    return "".join(parts)


def _sound(plan: cs.Plan) -> Verdict:
    """Right if all results are finite and every point is on its surface."""
    t, meter = np.linspace(plan.start, plan.end, 50), Meter()
    for name, values in plan.evaluate(t, "points", "slip_speed", "pose", "twist").items():
        meter.see(f"finite {name}", np.where(np.isfinite(values), 0.0, math.inf), 1.0)
    points = plan.points(t)
    for i, contact in enumerate(plan.scene.contacts):
        for k, surface in enumerate((contact.finger, plan.scene.object)):
            if surface.has_implicit:
                x = points[:, i, k]
                bound = 10 * plan.tolerance * (surface.size + np.linalg.norm(x, axis=1))
                meter.see(f"contact {i}: on {surface!r}", _distance(surface, x), bound)
    return meter.verdict()


def _distance(surface: cs.Surface, points: np.ndarray) -> np.ndarray:
    """How far points (n, 3) are off a surface, by its level function, m."""
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", len(surface.numbers))
    level, gradient, _ = surface.level_geometry(p[1:], x)
    away = ca.Function("away", [x, p], [level / ca.norm_2(gradient)])
    return away(points.T, surface.numbers).full()[0]


# --- all families --------------------------------------------------------------------------------

SLIPS = {"slip": 1, "windows": 0}
QUIET, SIGMAS = {"windows": 0}, list(PROFILES)
TURNS = [2 * math.pi * 10.0**k for k in range(6)]
LONG = ({"object": "torus"}, {"object": "ellipsoid", "shape": "plain"}, {"object": "chart_torus"})
LONGEST = {"finger": "plane", "windows": 0, "most": 7e5, "ratio": 10.0}
SIDES = [{"shape": s, side: "ellipsoid"} for s in SHAPES for side in ("object", "finger")]
RATIOS = [10 ** (k / 2) for k in range(-12, 13)]
RESTING = {"windows": 0, "most": 2e6}
FLAT = BUILT_IN[:3]
TIGHT = [10.0**-k for k in range(3, 16)]
TURNING = [{"turns": turns} | body for turns in TURNS for body in LONG]
FAMILIES = {
    family.name: family
    for family in (
        grid("eta and gain law", 3, always=SLIPS, eta=ETAS, law=LAWS, object=BUILT_IN),
        grid("profile", 1, always=SLIPS, profile=SIGMAS, law=LAWS, object=BUILT_IN, eta=ETAS[3::3]),
        grid("poles and umbilics", 3, cases=_poles(), slip=[0, 1]),
        grid("radius ratio", 6, always=QUIET, ratio=RATIOS, object=BUILT_IN),
        grid("ellipsoids", 6, cases=SIDES, windows=[0, 0, 0, 1], inside=[False, True]),
        grid("conforming bowls", 10, _bowls(), QUIET | {"bowl": True}),
        grid("revolutions", 3, always=RESTING, turns=TURNS, object=FLAT, finger=FLAT),
        grid("revolutions, integrated", 1, cases=TURNING, always=LONGEST),
        grid("tolerance", 8, always=QUIET, tolerance=TIGHT, object=BUILT_IN, slip=[0, 1]),
        grid("disturbances", 100, windows=[1, 2, 3]),
        grid("surfaces of users", 12, object=USERS, finger=USERS, slip=[0, 1]),
        Family("mutated files", 1000, _mutated),
        grid("everything", 11_500),
    )
}


# --- running them --------------------------------------------------------------------------------

LIMIT = 600.0 if "ASAN_OPTIONS" in os.environ else 60.0
"""s after which a case counts as a hang, a worker's imports included; sanitizers take ten times as
long."""


class Record(NamedTuple):
    """The verdict of one case of a family."""

    family: str
    index: int
    verdict: Verdict


def _work(link: Connection, todo: list[tuple[str, int]]) -> None:
    """Run cases in a worker, one after the other, and send their verdicts."""
    for name, index in todo:
        link.send(judged(partial(FAMILIES[name].run, index)))


def search(chosen: list[tuple[Family, range]]) -> Iterator[Record]:
    """Run cases in a worker; when a case ends it or hangs, a new worker runs those after it."""
    todo = deque((family.name, index) for family, indices in chosen for index in indices)
    context, lost = multiprocessing.get_context("spawn"), 0
    while todo:
        link, other = context.Pipe()
        process = context.Process(target=_work, args=(other, list(todo)), daemon=True)
        process.start()
        other.close()
        with contextlib.suppress(EOFError, ConnectionError):
            while todo and (answered := link.poll(LIMIT)):
                verdict = link.recv()
                yield Record(*todo.popleft(), verdict)
        process.join(5 if answered else 0)
        process.kill()
        process.join()
        if todo:
            ended = f"the process ended with {process.exitcode}"
            text = ended if answered else f"over {LIMIT:g} s"
            verdict = Verdict("crash" if answered else "hang", message=text)
            yield Record(*todo.popleft(), verdict)
            if (lost := lost + 1) > 100:
                raise RuntimeError(f"100 processes have ended; the last: {text}")


def cases(full: bool) -> Iterator[Bar]:
    """All cases; ``full``: ten times as many, with indices that earlier runs did not have."""
    first, more = (1000 * int(time.time()), 10) if full else (0, 1)
    chosen = [(f, range(first, first + more * f.count)) for f in FAMILIES.values()]
    records: list[Record] = []
    for family, group in itertools.groupby(search(chosen), lambda record: record.family):
        records += (found := list(group))
        failures = [record for record in found if record.verdict.outcome in FAILURES]
        for _, index, v in failures[:10]:
            print(f"{v.outcome}: error {v.error:.3g}, bound {v.bound:.3g}: {v.message}")
            print(f"  benchmarks.stress.FAMILIES[{family!r}].run({index}) repeats it")
        count = Counter(record.verdict.outcome for record in found)
        note = ", ".join(f"{number} {outcome}" for outcome, number in sorted(count.items()))
        name = f"{family}, {len(found)} cases: wrong, crash or hang"
        yield Bar(name, 0, len(failures), note=note)
    count = Counter(record.verdict.outcome for record in records)
    note = f"{count['right']} right, {count['refused']} refused"
    yield Bar("cases in all", 20_000, len(records), least=True, note=note)
    right = [r.verdict for r in records if r.verdict.outcome == "right"]
    worst = max((v.error / v.bound for v in right), default=NAN)
    yield Bar("greatest error over its bound, right cases", 1.0, worst)
    from .figures import outcomes  # needs matplotlib

    outcomes(records, ROOT / "docs" / "stress.png")


SECTIONS: Sections = {"cases": cases}
