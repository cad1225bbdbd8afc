"""Files are whole or untouched, whatever happens while they are written (docs/promises.md)."""

from __future__ import annotations

import contextlib
import itertools
import os
import subprocess
import sys
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from conftest import one_contact

import contact_system as cs
from contact_system import plots

resource = pytest.importorskip("resource", reason="needs limits of file sizes, and kill -9")

PLAN = cs.plan(one_contact())
SAVES = {
    "scene.toml": lambda path: cs.save_scene(PLAN.scene, path),
    "plan.npz": PLAN.save,
    "plan.csv": PLAN.save,
    "picture.png": lambda path: plots.plot_slip(PLAN, path, dpi=20),
}


@contextlib.contextmanager
def full_disk(size: int):
    """No file can be longer than so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("name", SAVES)
def test_a_save_on_a_full_disk_says_so_and_leaves_what_was_there(name, tmp_path):
    file, place = tmp_path / name, "" if "png" in name else "scene 'sphere on sphere': "
    words = f"^{place}'.*{name}' cannot be written: .*; give a path in a folder"
    for old in ([], [file]):
        for size in (0, 100):
            with full_disk(size), pytest.raises(cs.ContactSystemError, match=words):
                SAVES[name](file)
            assert list(tmp_path.iterdir()) == old
        SAVES[name](file)
    assert file.stat().st_size > 100


def test_saving_through_a_link_keeps_it_and_gives_the_umasks_permissions(tmp_path):
    real, link = tmp_path / "real.toml", tmp_path / "link.toml"
    link.symlink_to(real)
    before = os.umask(0o027)
    try:
        cs.save_scene(PLAN.scene, link)
    finally:
        os.umask(before)
    assert link.is_symlink() and real.stat().st_mode & 0o777 == 0o640
    assert cs.load_scene(real) == PLAN.scene


def test_a_pipe_is_not_replaced_by_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")  # as /dev/null, which root can replace
    with pytest.raises(cs.ContactSystemError, match="pipe.csv' cannot be written: it is a folder"):
        PLAN.save(tmp_path / "pipe.csv")
    assert (tmp_path / "pipe.csv").is_fifo()


def test_a_process_killed_while_it_saves_leaves_the_old_or_the_new_file(tmp_path):
    file, context, rng = tmp_path / "plan.npz", get_context("fork"), np.random.default_rng(1)
    plans, versions = (PLAN, cs.plan(cs.load_scene("K2"))), []
    for plan in plans:
        begin = time.perf_counter()
        plan.save(file)
        spent = time.perf_counter() - begin
        versions.append(file.read_bytes())

    def save_on(ready):
        for plan in itertools.cycle(plans):
            plan.save(file)
            ready.set()

    for _ in range(20):
        ready = context.Event()
        child = context.Process(target=save_on, args=(ready,))
        child.start()
        ready.wait()
        time.sleep(rng.uniform(0, 4 * spent))
        child.kill()
        child.join()
        assert file.read_bytes() in versions


# --- sweeps ------------------------------------------------------------------------------------

SWEEP = """
import hashlib, sys, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import contact_system as cs

def slowly(plan):
    time.sleep(0.03)
    return {"end": plan.states(plan.end)[0]}

if __name__ == "__main__":
    folder, first, method = sys.argv[1:]
    scenes = [cs.load_scene("C1").replace(duration=1 + 1e-3 * (int(first) + k)) for k in range(60)]
    with ProcessPoolExecutor(3, get_context(method)) as pool:
        table = cs.sweep(scenes, slowly, pool, folder=folder, chunk=2).table
    print(hashlib.sha256(table.tobytes()).hexdigest())
"""
"""A sweep of 30 files; prints a digest of its table."""


@pytest.fixture
def begin_sweep(tmp_path):
    """A function that begins that sweep: folder, number of its first scene, method -> process."""
    script, root = tmp_path / "sweep.py", str(Path(__file__).parents[1])
    script.write_text(SWEEP)
    paths = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])

    def begin(folder, first=0, method="fork"):
        words = [sys.executable, script, tmp_path / folder, str(first), method]
        how = {"start_new_session": True, "stdout": subprocess.PIPE, "text": True}
        return subprocess.Popen(words, env={**os.environ, "PYTHONPATH": paths}, **how)

    return begin


def digest(process: subprocess.Popen) -> str:
    told, _ = process.communicate()
    assert process.returncode == 0
    return told


def wait_until(reached) -> None:
    end = time.monotonic() + 60
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.02)


def gone(group: int) -> bool:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, 0)
        return False
    return True


@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_a_killed_sweep_takes_its_workers_with_it_and_goes_on_where_it_stopped(
    method, begin_sweep, tmp_path
):
    child = begin_sweep("killed", method=method)
    wait_until(lambda: any((tmp_path / "killed").glob("*.npz")))
    child.kill()
    child.communicate()
    wait_until(lambda: gone(child.pid))
    kept = {file: file.stat().st_mtime_ns for file in (tmp_path / "killed").glob("*.npz")}
    assert 0 < len(kept) < 30
    assert digest(begin_sweep("killed")) == digest(begin_sweep("whole"))
    assert all(file.stat().st_mtime_ns == when for file, when in kept.items())


def test_three_sweeps_at_once_in_one_folder_give_what_each_gives_alone(begin_sweep, tmp_path):
    found = [digest(each) for each in [begin_sweep("shared", first) for first in (0, 1000, 0)]]
    assert found == [digest(begin_sweep(f"alone {first}", first)) for first in (0, 1000, 0)]
    assert len(list((tmp_path / "shared").glob("*.npz"))) == 60
