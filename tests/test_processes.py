"""Forks, exits and Ctrl-C while plans are made, growth of memory, unusual environments.

Each program runs in a process of its own with a time limit.
"""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import time

import pytest
from conftest import ROOT

WORK = """
import hashlib, itertools, os, pathlib, random, signal, sys, threading, time
import numpy as np

OUTPUTS = ("points", "states", "slip", "twist")

def user(number):
    import contact_system as cs
    level = f"(x/0.3)**2 + (y/{number!r})**2 + (z/0.1)**2 - 1"
    finger = cs.Contact(cs.Sphere(0.04), (1.2, 0.4), object_velocity="rest")
    bodies = {"object": cs.ImplicitSurface(level, size=0.3), "contacts": [finger]}
    return cs.Scene(**bodies, duration=1.0, profile=cs.Profile([0.1]), gain=cs.Gain.path(100.0))

def chart(number):
    import contact_system as cs
    hollow = cs.ParametricSurface(lambda u, v: (u, v, np.cos(number * u) * np.sin(v)), size=0.5)
    return user(0.2).replace(object=hollow)

def bundled(number):
    import contact_system as cs
    return cs.load_scene("K4")

def answer(scene):
    import contact_system as cs
    found = cs.plan(scene).evaluate(np.linspace(0.0, scene.duration, 50), *OUTPUTS)
    return hashlib.sha256(b"".join(found[name].tobytes() for name in OUTPUTS)).hexdigest()

def all_answers():
    return [answer(make(0.2)) for make in (bundled, user, chart)]

def plan_on(seed):
    for k in itertools.count(seed, 4):
        for make in (bundled, user, chart):
            answer(make(0.2 + 1e-7 * k))

def start_planning():
    for seed in range(4):
        threading.Thread(target=plan_on, args=(seed,), daemon=True).start()
"""

FORK = """
import multiprocessing
import contact_system  # before: a fork while a module is being imported keeps Python's lock of it
start_planning()
time.sleep(float(sys.argv[1]))
child = multiprocessing.get_context("fork").Process(target=lambda: print(*all_answers()))
child.start()
child.join(40.0)
if child.is_alive():
    child.kill()
    os.kill(os.getpid(), signal.SIGALRM)  # so that the test sees the child's hang
sys.stdout.flush()
os._exit(child.exitcode and 1)
"""

EXIT = """
start_planning()
time.sleep(float(sys.argv[1]))
"""

CTRL_C = """
import contact_system
def first():
    return answer(globals()[sys.argv[1]](0.2))

try:
    print("ready", flush=True)
    first()
    time.sleep(30.0)
    sys.exit("Ctrl-C was lost")
except KeyboardInterrupt:
    print(first())
"""

IMPORT = """
print("ready", flush=True)
try:
    import contact_system
except BaseException:
    pass  # Python itself may turn Ctrl-C into another error, or lose it
signal.signal(signal.SIGINT, signal.SIG_IGN)
print(*all_answers())
"""

ENDLESS = """
import contact_system as cs

def endless(x):
    while True:
        os.kill(os.getpid(), signal.SIGINT)

def losing(x):  # as CasADi does at times
    try:
        endless(x)
    except KeyboardInterrupt:
        return x[0] ** 2 + x[1] ** 2 + x[2] ** 2 - 1

for function in (endless, losing):
    try:
        sys.exit(f"{cs.ImplicitSurface(function)} lost Ctrl-C")
    except KeyboardInterrupt:
        pass
print(*all_answers())
"""

GROWTH = """
import resource

def peak():
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit

make, warm, count = globals()[sys.argv[1]], *map(int, sys.argv[2:])
for k in range(warm + count):
    if k == warm:
        before = peak()
    answer(make(0.2 + 1e-7 * k))
sys.exit(f"{peak() - before} MB" if peak() - before > 3 else 0)
"""


def ended(program: str, *arguments: str, interrupt: float | None = None) -> tuple[str, str]:
    """How a program ends, "right", "hang", "crash" or "error", and what it printed.

    ``interrupt``: it gets Ctrl-C so many seconds after it has printed that it is ready.
    """
    command = [sys.executable, "-c", WORK + program, *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            if interrupt is not None:
                process.stdout.readline()  # type: ignore[union-attr]
                time.sleep(interrupt)
                process.send_signal(signal.SIGINT)
            out, told = process.communicate(timeout=60.0)
        except subprocess.TimeoutExpired:
            process.kill()
            return "hang", ""
    code = process.returncode
    if code < 0:
        return "hang" if code == -signal.SIGALRM else "crash", told
    return ("error", told) if code or (told and interrupt is None) else ("right", out)


@functools.cache
def undisturbed(answer: str) -> tuple[str, str]:
    """How a program ends that prints this answer and gets no Ctrl-C."""
    return ended(f"print({answer})")


needs_signals = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no forks")
@pytest.mark.parametrize("seconds", ["0.05", "0.5"])
@pytest.mark.parametrize("program", [FORK, EXIT], ids=["fork", "exit"])
def test_a_process_may_be_forked_and_may_end_while_its_threads_plan(program, seconds):
    assert ended(program, seconds)[0] == "right"


@needs_signals
@pytest.mark.parametrize(
    ("kind", "seconds"),
    [("bundled", 0.001), ("user", 0.005), ("user", 0.05), ("chart", 0.02), ("chart", 0.1)],
)
def test_ctrl_c_stops_a_first_plan_and_the_next_is_right(kind, seconds):
    assert ended(CTRL_C, kind, interrupt=seconds) == undisturbed(f"answer({kind}(0.2))")


@needs_signals
@pytest.mark.parametrize(
    ("program", "seconds"),
    [(ENDLESS, None), (IMPORT, 0.01), (IMPORT, 0.04)],
    ids=["a user's endless function", "early in import", "late in import"],
)
def test_after_ctrl_c_plans_are_right(program, seconds):
    assert ended(program, interrupt=seconds) == undisturbed("*all_answers()")


@needs_signals
@pytest.mark.parametrize(("kind", "warm", "count"), [("bundled", 300, 500), ("user", 60, 60)])
def test_memory_does_not_grow_with_plans_or_formulas(kind, warm, count):
    assert ended(GROWTH, kind, str(warm), str(count)) == ("right", "")


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
def test_plans_are_made_saved_and_read_in_unusual_environments(tmp_path, options, environment):
    kept = {name: os.environ[name] for name in ("PATH", "PYTHONPATH") if name in os.environ}
    if sys.platform == "win32":  # without it no process starts
        kept["SYSTEMROOT"] = os.environ["SYSTEMROOT"]
    command = [sys.executable, *options, "-c", WORK + SAVED]
    done = subprocess.run(
        command, check=False, timeout=60, cwd=tmp_path, env=kept | environment, capture_output=True
    )
    assert (done.returncode, done.stderr) == (0, b"")
