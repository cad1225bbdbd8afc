"""Faults: processes that are killed and disks that are full while files are written.

A child saves one version of a file over another, again and again, until it is killed at a random
moment; another one may write fewer bytes each time than the file has. Then each file must be one
of the two versions, byte for byte. Needs fork and limits of file sizes: Linux or macOS.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

import contact_system as cs
from contact_system.cli import main

from .many import scene
from .report import ROOT, Bar, Sections

ALONE = 10.0  # s that workers of a killed sweep may live on

Save = Callable[[Path, int], object]
"""Writes version 0 or 1 of a kind's files into a folder."""
Versions = list[dict[str, bytes]]
"""Names and contents of a folder's files, in both versions."""


# --- what writes -------------------------------------------------------------------------------


def _scene() -> Save:
    scenes = [scene(k, 50) for k in range(2)]
    return lambda folder, k: cs.save_scene(scenes[k], folder / "scene.toml")


def _plan() -> Save:
    plans = [cs.plan(scene(k, 3)) for k in range(2)]

    def save(folder: Path, k: int) -> None:
        plans[k].save(folder / "plan.npz")
        plans[k].save(folder / "plan.csv")

    return save


def _run() -> Save:
    from contact_system.plots import plot_slip

    picture = cs.plan(cs.load_scene("C1"))

    def save(folder: Path, k: int) -> None:
        plot_slip(picture, folder / "slip.png", dpi=(20, 30)[k])  # that of the command takes 2 s
        if main(
            ["run", "C1", "--tolerance", ("1e-12", "1e-3")[k], "--no-plots", f"--out={folder}"]
        ):
            raise cs.ContactSystemError("the command was refused")

    return save


def _sweep() -> Save:
    def save(folder: Path, k: int) -> None:
        for file in folder.glob("*.npz"):  # what is there would not be done again
            file.unlink()
        cs.sweep(family(k, 8), folder=folder, chunk=4)

    return save


def _fmu() -> Save:
    from fmu_export import export_fmu

    return lambda folder, k: export_fmu(scene(k), folder / "planner.fmu")


def _film() -> Save:
    from pydrake.systems.framework import DiagramBuilder

    from drake_plant import AddScenePlant, Recording, StationConfig

    builder, known, film = DiagramBuilder(), cs.load_scene("C1"), Recording()
    quick = StationConfig.from_scene(known, contact_model="point")
    film.Add(builder, AddScenePlant(builder, known, quick))
    builder.Build()
    return lambda folder, k: film.Save(folder / "film.html")


KINDS = {"scene": _scene, "plan": _plan, "run": _run, "sweep": _sweep, "FMU": _fmu, "film": _film}


# --- files -------------------------------------------------------------------------------------


def files(full: bool) -> Iterator[Bar]:
    """Kills and full disks, in turns, while files of a kind are saved over good ones."""
    tries = 1000 if full else 100
    os.environ["SOURCE_DATE_EPOCH"] = "1700000000"  # of FMUs: same scene, same bytes
    for kind, make in KINDS.items():
        name = f"{kind}: files destroyed or half, {tries} kills or full disks"
        with tempfile.TemporaryDirectory() as room:
            try:
                yield _tried(name, make, Path(room), tries)
            except ImportError as error:
                yield Bar(name, 0, None, note=f"left out: {error}")


def _tried(name: str, make: Callable[[], Save], folder: Path, tries: int) -> Bar:
    """Half of the tries end in a kill; what is imported and kept here spares children time."""
    with _quiet():
        save, versions, spent = make(), [], 0.0
        for k in (0, 1, 0, 1):
            begin = time.perf_counter()
            save(folder, k)
            spent = time.perf_counter() - begin
            versions.append({file.name: file.read_bytes() for file in folder.iterdir()})
    told: Counter = Counter()
    for _ in range(tries // 2):
        with _child(_saves, make, folder) as (child, link):
            link.recv()
            time.sleep(random.uniform(0.0, 2.0 * spent))
            child.kill()
        told += _judged(folder, versions)
    with _child(_full_disks, make, folder, versions, tries // 2) as (_, link):
        refused, found = link.recv()
    bad = told["bad"] + found["bad"] + found["part"]
    note = f"{refused} saves refused, {told['part']} .part files left by kills"
    return Bar(name, 0, bad, note=note, holds=refused == tries // 2)


@contextlib.contextmanager
def _child(work: Callable, *given: object) -> Iterator[tuple]:
    """A process that does some work, and an end of a pipe to it."""
    context = get_context("fork")
    link, other = context.Pipe()
    process = context.Process(target=work, args=(other, *given), daemon=True)
    process.start()
    other.close()
    try:
        yield process, link
    finally:
        process.kill()
        process.join()
        link.close()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        with contextlib.redirect_stderr(nowhere):
            yield


def _saves(link: Connection, make: Callable[[], Save], folder: Path) -> None:
    """Save until this process is killed."""
    with _quiet():
        save = make()
        link.send("ready")
        for k in itertools.count():
            save(folder, k % 2)


def _full_disks(link: Connection, make: Callable, folder: Path, known: Versions, n: int) -> None:
    """Save where no file may have more than so many bytes; tell how often that was refused."""
    import resource

    save, refused, told = make(), 0, Counter()
    most, (_, hard) = max(map(len, known[0].values())), resource.getrlimit(resource.RLIMIT_FSIZE)
    for k in range(n):
        with _quiet():
            resource.setrlimit(resource.RLIMIT_FSIZE, (random.randrange(most), hard))
            try:
                save(folder, k % 2)
            except cs.ContactSystemError:
                refused += 1
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
        told += _judged(folder, known)
    link.send((refused, told))


def _judged(folder: Path, versions: Versions) -> Counter:
    """Count files that are neither version, or gone, and those that were not finished."""
    told: Counter = Counter()
    found = {file.name: file.read_bytes() for file in folder.iterdir()}
    for name, content in found.items():
        if name.endswith(".part"):
            told["part"] += 1
            (folder / name).unlink()
        elif content not in [version.get(name) for version in versions]:
            told["bad"] += 1
            (folder / name).write_bytes(versions[0][name])
    # those of a sweep differ in their names, and its child removes them
    always = set(versions[0]) & set(versions[1])
    told["bad"] += len(always - set(found))
    return told


# --- sweeps ------------------------------------------------------------------------------------


def family(which: int, count: int = 60) -> list[cs.Scene]:
    """Scenes that no other family has."""
    return [scene(1000 * which + k) for k in range(count)]


def slowly(plan: cs.Plan) -> Mapping[str, np.ndarray]:
    """The end of each contact, after a while."""
    time.sleep(0.03)
    return {"end": plan.states(plan.end)[0]}


SWEEP = """
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import contact_system as cs
from benchmarks.faults import family, slowly

folder, which, method = sys.argv[1:]
with ProcessPoolExecutor(3, get_context(method)) as pool:
    cs.sweep(family(int(which)), slowly, pool, folder=folder, chunk=2)
"""


def sweeps(full: bool) -> Iterator[Bar]:
    """Sweeps killed and resumed; two of them, and one twice, in one folder at a time."""
    tries, lost, orphans, kept, begin = 60 if full else 20, 0, 0, 0.0, time.monotonic
    for k in range(tries):
        with tempfile.TemporaryDirectory() as room:
            until = begin() + random.uniform(0.3, 3.0)
            method = ("spawn", "fork", "forkserver")[k % 3]
            outlived, whole, part = killed(Path(room), method, lambda end=until: begin() > end)
        orphans, lost, kept = orphans + outlived, lost + (not whole), kept + part
    note = f"{kept / tries:.0%} of the chunks kept on average"
    yield Bar(f"sweep killed and resumed, {tries} times: tables or chunks lost", 0, lost, note=note)
    yield Bar(f"the same: sweeps whose workers live {ALONE:g} s longer", 0, orphans)
    tries, lost = tries // 4, 0
    for _ in range(tries):
        with tempfile.TemporaryDirectory() as room:
            lost += together(Path(room))
    yield Bar(f"two sweeps, one of them twice, in one folder, {tries} times: lost", 0, lost)


def killed(folder: Path, method: str, ready: Callable[[], bool]) -> tuple[bool, bool, float]:
    """Kill a sweep when it is ready and resume it.

    Whether its workers live on, whether the table is right, the part of the chunks that was kept.
    """
    child = _started(folder, 0, method)
    while not ready() and child.poll() is None:
        time.sleep(0.01)
    child.kill()
    child.wait()
    return _outlived(child.pid), *_resumed(folder, 0)


def together(folder: Path) -> int:
    """Two sweeps and one of them once more in a folder at a time: how many went wrong."""
    children = [_started(folder, which, "fork") for which in (0, 1, 0)]
    lost = sum(child.wait() != 0 for child in children)
    for which in range(2):
        right, kept = _resumed(folder, which)
        lost += not right or kept < 1
    return lost


def _started(folder: Path, which: int, method: str) -> subprocess.Popen:
    command = [sys.executable, "-c", SWEEP, folder, str(which), method]
    return subprocess.Popen(command, cwd=ROOT, start_new_session=True, stderr=subprocess.DEVNULL)


def _outlived(group: int) -> bool:
    """Whether processes of a group are there after a while; they are no more after that."""
    end = time.monotonic() + ALONE
    with contextlib.suppress(ProcessLookupError):
        while time.monotonic() < end:
            os.killpg(group, 0)
            time.sleep(0.02)
        os.killpg(group, signal.SIGKILL)
        return True
    return False


def _resumed(folder: Path, which: int) -> tuple[bool, float]:
    """Whether a sweep that goes on in a folder is right; what was kept over its chunks."""
    before = {file: file.stat().st_mtime_ns for file in folder.glob("*.npz")}
    table = cs.sweep(family(which), slowly, folder=folder, chunk=2).table
    kept = sum(file.stat().st_mtime_ns == when for file, when in before.items())
    return np.array_equal(table, _expected(which)), 2 * kept / len(table)


@functools.cache
def _expected(which: int) -> np.ndarray:
    return cs.sweep(family(which), slowly, chunk=2).table


SECTIONS: Sections = {"files": files, "sweeps": sweeps}
