"""Many simulations as in docs/drake.md, on two processes and on one core."""

from __future__ import annotations

import os
import resource
import signal
import statistics
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import contact_system as cs
from drake_plant import outcome

from .report import Bar, Sections

RUNS = 200


def d1(k: int) -> cs.Scene:
    """D1 for a second in point contact, its window early, with other friction and offsets."""
    scene = cs.load_scene("D1")
    offset = cs.ObjectRateOffset(contact=0, start=0.3, stop=0.6, value=(0.1 * (k % 20), 0.5))
    drake = scene.drake | {"contact_model": "point", "friction": 0.1 + 0.05 * (k // 20)}
    return scene.replace(name=f"D1 {k}", duration=1.0, disturbances=[offset], drake=drake)


def sweep(full: bool) -> Iterator[Bar]:
    """Simulations on two processes, one of which is killed half-way, and on one core."""

    def alone(first: int) -> tuple[float, float]:
        begin, busy = time.perf_counter(), time.process_time()
        cs.sweep(map(d1, range(first, RUNS, 20)), outcome, each=True)
        part = RUNS / len(range(first, RUNS, 20))
        return part * (time.perf_counter() - begin), part * (time.process_time() - busy)

    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(2) as pool:
        killer = threading.Thread(target=_kill_one, args=(pool, Path(folder), RUNS // 2))
        one = [alone(3)]
        killer.start()
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        found = cs.sweep(map(d1, range(RUNS)), outcome, pool, each=True, folder=folder)
        two = time.perf_counter() - begin
        killer.join()
        one.append(alone(13))
        table, failures = found.table, found.failures
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    verdicts = Counter(table["verdict"][table["contact"] == 0].tolist())
    lost = RUNS - len(set(table["scene"].tolist())) + len(failures)
    note = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    yield Bar(f"{RUNS} runs of D1, a worker killed half-way: missing", 0, lost, note=note)
    busy = after.ru_utime - before.ru_utime
    wall, cpu = (statistics.mean(spent) for spent in zip(*one))
    note = f"{wall:.0f} s over {two:.0f} s; by processor time {2 * cpu / busy:.2f} x: the workers "
    note += f"had {busy / two:.2f} of two cores"
    yield Bar("the same, two processes over one core", 1.8, wall / two, "x", True, note)


def _kill_one(pool: ProcessPoolExecutor, folder: Path, half: int) -> None:
    """Kill a worker once half of the results are there."""
    while len(list(folder.glob("*.npz"))) < half:
        time.sleep(0.05)
    os.kill(next(iter(pool._processes)), signal.SIGKILL)


SECTIONS: Sections = {"sweep": sweep}
