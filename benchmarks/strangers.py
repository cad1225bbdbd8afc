"""Files from strangers: each is right or refused by name, soon and in little memory.

Hostile scene files, saved plans and FMUs (`stranger_files`); saved plans with bits turned, cut, or
with other restart data; bundled scenes mutated. Cases run in a process of their own under a
watchdog, as those of `stress` do.
"""

from __future__ import annotations

import contextlib
import json
import random
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import contact_system as cs
from contact_system.scene.files import scene_from_toml, scene_text

from . import stress
from .report import Bar, Section, Sections
from .stranger_files import (
    Make,
    fmu_files,
    pack,
    plan_files,
    saved,
    scene_files,
    text_of,
    with_texts,
    writer,
)
from .verdicts import FAILURES, NAN, Case, Family, Verdict

MEMORY = 500e6  # B
SCENES = tuple(cs.bundled_scenes())
NUMBER = re.compile(r"(?<![\w.\"-])-?\d+(?:\.\d+)?(?:e-?\d+)?")


def families() -> dict[str, Family]:
    """All families by name."""
    scenes, plans = scene_files(), plan_files()
    found = [
        Family("scene files", len(scenes), lambda k: _hostile(scenes, k, cs.load_scene, ".toml")),
        Family("saved plans", len(plans), lambda k: _hostile(plans, k, cs.load, ".npz")),
        Family("bits turned", 3000, _flipped),
        Family("truncations", 400, _cut),
        Family("restart data", 100, _edited),
        Family("mutations", 1000, _mutated),
    ]
    with contextlib.suppress(ImportError):
        from drake_plant import FmuSystem

        fmus, load = fmu_files(), partial(FmuSystem, step=0.1)
        found.append(Family("FMUs", len(fmus), lambda k: _hostile(fmus, k, load, ".fmu")))
    return {family.name: family for family in found}


def _hostile(files: dict[str, Make], index: int, load: Callable[[Path], Any], ending: str) -> Case:
    """Right: refused by the file's name, in little memory."""
    name, make = list(files.items())[index]

    def call() -> Verdict:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"hostile{ending}")
            path = make(path) or path
            with _little_memory():
                try:
                    load(path)
                except cs.ContactSystemError as error:
                    return _refused(error, path.name)
        return Verdict("silent", NAN, NAN, f"{name}: taken")

    return Case(name, call)


def _refused(error: cs.ContactSystemError, name: str) -> Verdict:
    """Only an error that names the file is a refusal."""
    return Verdict("refused" if name in str(error) else "crash", NAN, NAN, str(error))


@contextlib.contextmanager
def _little_memory() -> Iterator[None]:
    """No more than `MEMORY` beyond what the process has; nothing where that cannot be set."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (ImportError, OSError):
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    most = int(pages * resource.getpagesize() + MEMORY)
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


# --- damage to saved plans -----------------------------------------------------------------------


def _loaded(name: str, write: Make, kind: str) -> Case:
    """Right: refused by name, or the plan that was saved."""

    def call() -> Verdict:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "damaged.npz")
            write(path)
            try:
                plan = cs.load(path)
                t = np.linspace(plan.start, plan.end, 5)
                points = plan.points(t)
            except cs.ContactSystemError as error:
                return _refused(error, "damaged.npz")
        if not np.isfinite(points).all():
            return Verdict("silent", NAN, NAN, f"{name}: NaN")
        error = 0.0 if kind == "edited" else np.abs(points - _points(kind)).max()
        return Verdict("right" if error == 0 else "silent", error, 0.0, name)

    return Case(name, call)


@cache
def _points(kind: str) -> np.ndarray:
    plan = cs.load(_whole(kind))
    return plan.points(np.linspace(plan.start, plan.end, 5))


@cache
def _whole(kind: str) -> Path:
    path = Path(tempfile.mkdtemp(), "plan.npz")
    pack(path, saved(kind))
    return path


KINDS = ("begun", "restarted", "continued")


def _flipped(index: int) -> Case:
    kind, rng = KINDS[index % 3], random.Random(index)
    data = bytearray(_whole(kind).read_bytes())
    bit = rng.randrange(8 * len(data))
    data[bit // 8] ^= 1 << bit % 8
    return _loaded(f"{kind}, bit {bit}", writer(bytes(data)), kind)


def _cut(index: int) -> Case:
    kind = KINDS[index % 3]
    data = _whole(kind).read_bytes()
    length = random.Random(index).randrange(len(data))
    return _loaded(f"{kind}, {length} bytes", writer(data[:length]), kind)


def _edited(index: int) -> Case:
    """Restart data with a value changed, and the digest that fits."""
    kind, rng = KINDS[1 + index % 2], random.Random(index)
    head = json.loads(text_of(kind, "plan"))
    one = rng.choice(head["starts"])
    key = rng.choice(list(one))
    values = (NAN, 1e308, -1e99, 1e30, 1e9, 0, 1e-300, None, "x", [], True)
    value: Any = rng.choice(values)
    if rng.random() < 0.2:
        del one[key]
    elif isinstance(one[key], list) and one[key] and rng.random() < 0.8:
        one[key][rng.randrange(len(one[key]))] = value
    else:
        one[key] = value
    name = f"{kind}: {key}, {value!r}"
    return _loaded(name, lambda path: with_texts(path, kind, plan=json.dumps(head)), "edited")


# --- mutated scenes ------------------------------------------------------------------------------


def _mutated(index: int) -> Case:
    rng = random.Random(index)
    name = rng.choice(SCENES)
    text = scene_text(name)[0]
    for _ in range(rng.choice((1, 1, 2, 3))):
        text = rng.choice((*[_other_number] * 8, _other_lines, _other_sections))(rng, text)

    def call() -> Verdict:
        try:
            return _judged(cs.plan(scene_from_toml(text, f"mutated {name}.toml")))
        except cs.ContactSystemError as error:
            return _refused(error, "")

    return Case(f"{name}\n{text}", call)


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
    lines = text.splitlines()
    k = rng.randrange(len(lines))
    lines[k : k + 1] = [lines[k]] * rng.choice((0, 2))
    return "\n".join(lines)


def _other_sections(rng: random.Random, text: str) -> str:
    parts = re.split(r"^(?=\[)", text, flags=re.MULTILINE)
    i, j = rng.randrange(len(parts)), rng.randrange(len(parts))
    if rng.random() < 0.5:  # their heads alone
        heads = [parts[k].partition("\n")[::2] for k in (i, j)]
        parts[i], parts[j] = heads[1][0] + "\n" + heads[0][1], heads[0][0] + "\n" + heads[1][1]
    else:
        parts[i], parts[j] = parts[j], parts[i]
    return "".join(parts)


def _judged(plan: cs.Plan) -> Verdict:
    """Right where all is finite and every point is on its surface."""
    t = np.linspace(plan.start, plan.end, 50)
    results = plan.evaluate(t, "points", "slip_speed", "pose", "twist")
    with contextlib.suppress(cs.ChartSingularity):
        results |= plan.evaluate(t, "states")
    for name, values in results.items():
        if not np.isfinite(values).all():
            return Verdict("silent", NAN, NAN, f"{name}: NaN or infinite")
    worst = Verdict("right", 0.0, 1.0)
    for i, contact in enumerate(plan.scene.contacts):
        for k, surface in enumerate((contact.finger, plan.scene.object)):
            if not surface.has_implicit:
                continue
            x = results["points"][:, i, k]
            off = np.abs(surface.point(*surface.coordinates(x)) - x).max()
            bound = 10 * plan.tolerance * (surface.size + np.abs(x).max())
            if off > bound and isinstance(surface, cs.Ellipsoid):  # charts of flat ones amplify
                axes = np.array([surface.a, surface.b, surface.c])
                level, slope = (
                    ((x / axes) ** 2).sum(-1) - 1,
                    2 * np.linalg.norm(x / axes**2, axis=-1),
                )
                off = np.abs(level / slope).max()
            if not off / bound <= worst.error / worst.bound:
                outcome = "right" if off <= bound else "silent"
                worst = Verdict(outcome, float(off), bound, f"contact {i}: off {surface!r}")
    return worst


# --- sections ------------------------------------------------------------------------------------


def _section(limit: float, *names: str, full: int = 1) -> Section:
    """Bars of families: cases that end otherwise than right or refused within `limit` s each."""

    def section(thorough: bool) -> Iterator[Bar]:
        known = families()
        if missing := set(names) - set(known):
            raise ImportError(f"{', '.join(missing)} need drake_plant and fmu_export")
        chosen = [(known[n], range(known[n].count * (full if thorough else 1))) for n in names]
        records = []
        for record in stress.search(chosen, __name__, limit):
            records.append(record)
            if record.verdict.outcome in FAILURES:
                print(f"{record.family} {record.index}: {record.verdict}"[:400], flush=True)
        for name in names:
            count = Counter(r.verdict.outcome for r in records if r.family == name)
            slowest = max(r.seconds for r in records if r.family == name)
            note = f"{count.total()} cases, {count['refused']} refused, slowest {slowest:.2g} s"
            yield Bar(f"{name}: over {limit:g} s", 0, count["hang"], note=note)
            yield Bar(f"{name}: silently wrong, or taken", 0, count["silent"])
            yield Bar(f"{name}: raw errors, crashes", 0, count["crash"])

    return section


SECTIONS: Sections = {
    "files": _section(2.0, "scene files", "saved plans"),
    "fmus": _section(2.0, "FMUs"),
    "damage": _section(2.0, "bits turned", "truncations", "restart data"),
    "mutations": _section(12.0, "mutations", full=5),
}
