"""What is promised about files: whole or untouched, whatever happens while they are written."""

from __future__ import annotations

import contextlib
import os

import numpy as np
import pytest
from conftest import one_contact

import contact_system as cs
from benchmarks import faults
from contact_system import plots

resource = pytest.importorskip("resource", reason="needs limits of file sizes, and kill -9")

PLAN = cs.plan(one_contact())
SAVES = {
    "scene.toml": lambda path: cs.save_scene(PLAN.scene, path),
    "plan.npz": PLAN.save,
    "plan.csv": PLAN.save,
    "picture.png": lambda path: plots.plot_slip(PLAN, path, dpi=20),
    "picture.pdf": lambda path: plots.plot_slip(PLAN, path, dpi=20),
}


@contextlib.contextmanager
def disk_with(size: int):
    """No file may be longer than so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("name", SAVES)
def test_a_save_on_a_full_disk_says_so_and_leaves_what_was_there(name, tmp_path):
    file = tmp_path / name
    for old in ([], [file]):
        for size in (0, 100):
            with disk_with(size), pytest.raises(cs.ContactSystemError, match=f"{name}' cannot be"):
                SAVES[name](file)
            assert list(tmp_path.iterdir()) == old
        SAVES[name](file)
    assert file.stat().st_size > 100


def test_files_have_the_permissions_of_new_ones_and_links_stay(tmp_path):
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


@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_a_killed_sweep_takes_its_workers_with_it_and_goes_on_where_it_stopped(method, tmp_path):
    outlived, right, kept = faults.killed(tmp_path, method, lambda: any(tmp_path.glob("*.npz")))
    assert right and kept > 0 and not outlived


def test_sweeps_at_work_in_one_folder_leave_each_other_alone(tmp_path):
    assert faults.together(tmp_path) == 0


def test_a_table_that_is_whole_but_another_one_is_made_again(tmp_path):
    first = cs.sweep(faults.family(0, 2), folder=tmp_path, chunk=1).table
    one, two = sorted(tmp_path.iterdir())
    two.write_bytes(one.read_bytes())
    with np.load(one) as data:
        changed = {name: data[name] for name in data.files}
    changed["table"]["slip_end"] += 1.0
    np.savez(one, **changed)
    assert np.array_equal(cs.sweep(faults.family(0, 2), folder=tmp_path, chunk=1).table, first)
