"""Processes: forks while threads plan, Ctrl-C while a formula is read, odd surroundings."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PLAN = """
import itertools, os, signal, sys, threading, time
import contact_system as cs

def plan(number):
    surface = cs.ImplicitSurface(f"x**2/0.09 + y**2/{number!r} + z**2/0.01 - 1", size=0.3)
    contact = cs.Contact(cs.Sphere(0.04), (1.2, 0.4), object_velocity="rest")
    scene = cs.Scene(object=surface, contacts=[contact], duration=1.0, profile=cs.Profile([0.1]),
                     gain=cs.Gain.path(100.0))
    return cs.plan(scene).states([0.0, 1.0]).tobytes()
"""

FORK = """
def plan_on(first):
    for k in itertools.count(first, 4):
        plan(0.04 + 1e-7 * k)

for first in range(4):
    threading.Thread(target=plan_on, args=(first,), daemon=True).start()
time.sleep(0.5)
child = os.fork()
expected = plan(0.05)
if child == 0:
    os._exit(0 if expected else 1)
sys.exit(os.waitpid(child, 0)[1])
"""

CTRL_C = """
def press():
    time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGINT)

threading.Thread(target=press, daemon=True).start()
try:
    for k in itertools.count():
        plan(0.04 + 1e-7 * k)
except KeyboardInterrupt:
    sys.exit(plan(0.05) != plan(0.05))
"""

ENDLESS = """
def endless(x):
    while True:
        os.kill(os.getpid(), signal.SIGINT)

try:
    cs.ImplicitSurface(endless)
except KeyboardInterrupt:
    sys.exit(plan(0.04) != plan(0.04))
"""


def _ends_well(program: str) -> bool:
    command = [sys.executable, "-c", PLAN + program]
    return subprocess.run(command, check=False, timeout=60).returncode == 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no forks")
def test_a_process_may_be_forked_while_threads_plan():
    assert _ends_well(FORK)


@pytest.mark.skipif(sys.platform == "win32", reason="os.kill ends a process on Windows")
def test_ctrl_c_stops_a_users_endless_function_and_the_next_plan_is_right():
    assert _ends_well(ENDLESS)


@pytest.mark.skipif(sys.platform == "win32", reason="os.kill ends a process on Windows")
def test_ctrl_c_stops_plans_of_new_formulas():
    assert _ends_well(CTRL_C)


SAVED = """
with __import__("tempfile").TemporaryDirectory(dir=".") as folder:
    made = cs.plan(cs.load_scene("K4"))
    made.save(f"{folder}/plan.npz", [0.0])
    again = cs.load(f"{folder}/plan.npz").states([0.0, 1.0])
sys.exit((again != made.states([0.0, 1.0])).any() or not plan(0.05))
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
    command = [sys.executable, *options, "-c", PLAN + SAVED]
    done = subprocess.run(
        command, check=False, timeout=60, cwd=tmp_path, env=kept | environment, capture_output=True
    )
    assert (done.returncode, done.stderr) == (0, b"")
