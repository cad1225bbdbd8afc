"""What the first plan in a process costs; numbers are medians over new processes."""

from __future__ import annotations

from collections.abc import Iterator

from .report import Bar, Sections
from .timing import in_new_process, in_new_processes

SCENES = ("K1", "K2", "K4", "D1", "bowl")
USERS = ("implicit", "chart")  # surfaces that a user gives by an equation, or by a chart
HEAVY = ("casadi", "scipy", "matplotlib")

PLAN = """
import json, sys, time
import numpy as np
import contact_system as cs

scene = cs.load_scene(sys.argv[1])
t = np.linspace(0.0, scene.duration, 400)
begin = time.perf_counter()
plan = cs.plan(scene)
planned = time.perf_counter()
plan.points(t)
located = time.perf_counter()
plan.evaluate(t, "states", "slip", "pose", "twist")
everything = time.perf_counter()
times = {"plan": planned - begin, "points": located - begin, "all": everything - begin}
print(json.dumps({**times, "modules": list(sys.modules)}))
"""

IMPORT = """
import json, sys, time
import numpy
begin = time.perf_counter()
import contact_system
print(json.dumps({"s": time.perf_counter() - begin}))
"""

PASSED = """
import json, os, sys
import contact_system as cs

home = os.path.dirname(cs.__file__)
calls, files = 0, set()

def count(frame, event, argument):
    global calls
    file = frame.f_code.co_filename
    if event == "call" and file.startswith(home):
        calls += 1
        files.add(os.path.relpath(file, home))

scene = cs.load_scene("K2")
t = [scene.duration * k / 400 for k in range(401)]
sys.setprofile(count)
cs.plan(scene).points(t)
sys.setprofile(None)
print(json.dumps({"calls": calls, "files": sorted(files)}))
"""


def plans(full: bool) -> Iterator[Bar]:
    """The first plan in a process and its points at 400 times, also on users' surfaces."""
    heavy = set()
    for name in (*SCENES, *USERS):
        found = in_new_processes(15 if full else 5, PLAN, name)
        note = f"plan alone {1e3 * found['plan']:.3g} ms"
        limit = 80.0 if name in USERS else 1.0
        what = f"first plan and 400 points, {name}"
        yield Bar(what, limit, 1e3 * found["points"], "ms", note=note)
        if name in SCENES:
            heavy |= set(HEAVY) & set(found["modules"])
        if name == "K4":
            what = "the same and states, slip, pose, twist, K4"
            yield Bar(what, 2.0, 1e3 * found["all"], "ms")
    note = ", ".join(sorted(heavy)) or f"none of {', '.join(HEAVY)}"
    yield Bar("heavy packages that plans of bundled scenes load", 0, len(heavy), note=note)


def imports(full: bool) -> Iterator[Bar]:
    """Import of the package beyond numpy's."""
    found = in_new_processes(15 if full else 7, IMPORT)
    yield Bar("import contact_system, over numpy's", 60.0, 1e3 * found["s"], "ms")


def passed(full: bool) -> Iterator[Bar]:
    """How many Python files and calls of the package the first plan of K2 and its points use."""
    found = in_new_process(PASSED)
    files = found["files"]
    yield Bar("Python files that K2's first plan and points pass", 8, len(files))
    yield Bar("calls of ours in them", 120, found["calls"])


SECTIONS: Sections = {"plans": plans, "imports": imports, "passed": passed}
