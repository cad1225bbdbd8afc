"""Processes and load: forks, exits and Ctrl-C at random times; memory; the bits of eight threads.

A try of the first kind is a process of its own with a time limit; it ends right, or hangs, crashes
or fails.
"""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator

from .report import ROOT, Bar, Sections
from .timing import in_new_process

LIMIT = 20.0  # s

WORK = """
import hashlib, itertools, os, random, signal, sys, threading, time
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
import contact_system  # Python's own locks of a module that is being imported outlast a fork
start_planning()
time.sleep(float(sys.argv[1]))
child = multiprocessing.get_context("fork").Process(target=lambda: print(*all_answers()))
child.start()
child.join(15.0)
if child.is_alive():
    child.kill()
    os.kill(os.getpid(), signal.SIGALRM)  # the hang of a child is one of this process
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
    time.sleep(5.0)
    sys.exit("Ctrl-C was lost")
except KeyboardInterrupt:
    print(first())
"""

IMPORT = """
print("ready", flush=True)
try:
    import contact_system
except BaseException:
    pass  # Python itself may make another error of it, or lose it
signal.signal(signal.SIGINT, signal.SIG_IGN)
print(*all_answers())
"""

GROWTH = """
import json
from benchmarks.timing import memory

makes, warm, count = [globals()[name] for name in sys.argv[1].split()], *map(int, sys.argv[2:])
scenes = [make(0.2) for make in makes] if makes[0] is bundled else None
for k in range(warm + count):
    if k == warm:
        before = memory()
    which = k % len(makes)
    answer(scenes[which] if scenes else makes[which](0.2 + 1e-7 * k))
print(json.dumps(memory() - before))
"""

TOGETHER = """
import json
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

expected, until = all_answers(), time.monotonic() + float(sys.argv[1])

def check(seed):
    found = Counter()
    while time.monotonic() < until:
        found.update(map(str.__eq__, all_answers(), expected))
    return found

with ThreadPoolExecutor(8) as pool:
    found = sum(pool.map(check, range(8)), Counter())
print(json.dumps([found[True], found[False]]))
"""


def ended(program: str, *arguments: str, interrupt: float | None = None) -> tuple[str, str]:
    """How a program ends, with Ctrl-C so many seconds after it is ready: in a word, and its text.

    The word is "right", "hang", "crash" or "error".
    """
    command = [sys.executable, "-c", WORK + program, *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            if interrupt is not None:
                process.stdout.readline()  # type: ignore[union-attr]
                time.sleep(interrupt)
                process.send_signal(signal.SIGINT)
            out, told = process.communicate(timeout=LIMIT)
        except subprocess.TimeoutExpired:
            process.kill()
            return "hang", ""
    code = process.returncode
    if code < 0:
        return "hang" if code == -signal.SIGALRM else "crash", told
    return ("error", told) if code or (told and interrupt is None) else ("right", out)


def _tried(
    name: str, count: int, program: str, *arguments: str, within: float, ctrl_c: bool = False
) -> Bar:
    """A bar of tries that did not end right, or not with the same bits as an unhurried one."""
    rng, found, first = random.Random(1), Counter[str](), ""
    outs = Counter[str]()
    for _ in range(count):
        moment = rng.uniform(0.0, within)
        when = (*arguments, *([] if ctrl_c else [str(moment)]))
        how, text = ended(program, *when, interrupt=moment if ctrl_c else None)
        found[how] += 1
        if how == "right":
            outs[text] += 1
        else:
            first = first or f"; {how}: {text.strip()[-300:]}"
    wrong = found.total() - max(outs.values(), default=0)
    note = ", ".join(f"{n} {how}" for how, n in found.items()) + first
    return Bar(f"{name}, {count} tries: not right", 0, wrong, note=note)


def forks(full: bool) -> Iterator[Bar]:
    """A fork while four threads plan for the first time; the child plans."""
    yield _tried("fork while 4 threads plan", 30, FORK, within=0.8)


def exits(full: bool) -> Iterator[Bar]:
    """The end of a process in which four daemon threads plan."""
    yield _tried("exit while 4 daemon threads plan", 15, EXIT, within=0.8)


def interrupts(full: bool) -> Iterator[Bar]:
    """Ctrl-C in a first plan: Python stops, and the next plan is right."""
    count = 100 if full else 30
    for kind, within in (("bundled", 0.004), ("user", 0.3), ("chart", 0.3)):
        name = f"Ctrl-C in a first plan, {kind}"
        yield _tried(name, count, CTRL_C, kind, within=within, ctrl_c=True)
    yield _tried("Ctrl-C in import, then a plan", count, IMPORT, within=0.1, ctrl_c=True)


def growth(full: bool) -> Iterator[Bar]:
    """Memory of a process over many plans, and over formulas each of which is new."""
    plans, formulas = (100_000, 10_000) if full else (10_000, 500)
    for what, makes, warm, count in (
        ("plans", "bundled user chart", 3000, plans),
        ("new formulas", "user chart", 500, formulas),
    ):
        grown = in_new_process(WORK + GROWTH, makes, str(warm), str(count))
        note = f"after {warm}"
        yield Bar(f"growth of memory over {count} {what}", 20.0, grown, "MB", note=note)


def threads(full: bool) -> Iterator[Bar]:
    """Eight threads plan the same scenes again and again; every answer as one thread gives it."""
    seconds = 60 if full else 10
    same, other = in_new_process(WORK + TOGETHER, str(seconds))
    name = f"8 threads for {seconds} s: other bits than of one thread"
    yield Bar(name, 0, other, note=f"of {same + other} plans")


SECTIONS: Sections = {
    "forks": forks,
    "exits": exits,
    "interrupts": interrupts,
    "growth": growth,
    "threads": threads,
}
