"""Processes: forks while threads plan, Ctrl-C while a formula is read, odd surroundings."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from benchmarks.processes import CTRL_C, FORK, WORK, ended

ENDLESS = """
import contact_system as cs

def endless(x):
    while True:
        os.kill(os.getpid(), signal.SIGINT)

try:
    cs.ImplicitSurface(endless)
except KeyboardInterrupt:
    print(*all_answers())
"""

windows = pytest.mark.skipif(sys.platform == "win32", reason="a signal ends a process on Windows")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no forks")
def test_a_process_may_be_forked_while_threads_plan():
    assert ended(FORK, "0.5")[0] == "right"


@windows
def test_ctrl_c_stops_a_users_endless_function_and_the_next_plan_is_right():
    assert ended(ENDLESS) == ended("print(*all_answers())")


@windows
@pytest.mark.parametrize("seconds", [0.005, 0.05])
def test_ctrl_c_stops_the_first_plan_of_a_formula_and_the_next_is_right(seconds):
    assert ended(CTRL_C, "user", interrupt=seconds) == ended("print(answer(user(0.2)))")


SAVED = """
import contact_system as cs
with __import__("tempfile").TemporaryDirectory(dir=".") as folder:
    made = cs.plan(bundled(0.2))
    made.save(f"{folder}/plan.npz", [0.0])
    again = cs.load(f"{folder}/plan.npz").states([0.0, 1.0])
sys.exit((again != made.states([0.0, 1.0])).any() or not all_answers())
"""


@pytest.mark.parametrize(
    ("options", "environment"),
    [
        ([], {"LC_ALL": "C"}),
        ([], {"LC_ALL": "C", "HOME": "/nowhere", "TMPDIR": "/nowhere"}),
        (["-O"], {}),
        (["-W", "error"], {}),
    ],
    ids=["no HOME, no TMPDIR", "wrong ones", "-O", "-W error"],
)
def test_plans_are_made_saved_and_read_in_odd_surroundings(tmp_path, options, environment):
    kept = {name: os.environ[name] for name in ("PATH", "PYTHONPATH") if name in os.environ}
    if sys.platform == "win32":  # a process without it does not start
        kept["SYSTEMROOT"] = os.environ["SYSTEMROOT"]
    command = [sys.executable, *options, "-c", WORK + SAVED]
    done = subprocess.run(
        command, check=False, timeout=60, cwd=tmp_path, env=kept | environment, capture_output=True
    )
    assert (done.returncode, done.stderr) == (0, b"")
