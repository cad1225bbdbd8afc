"""Run times: jobs in one process in turns, programs in processes of their own."""

from __future__ import annotations

import gc
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .report import ROOT

SLOW = 0.2  # [s]: what takes longer is sampled twice only


@dataclass(frozen=True)
class Job:
    """What is timed: a call with an item that is made outside the time, such as a new scene."""

    call: Callable[[Any], Any]
    make: Callable[[], Any] = lambda: None


def sample(job: Job, count: int = 1) -> float:
    """Seconds of the processor a call, over ``count`` calls with an item each."""
    items = [job.make() for _ in range(count)]
    call = job.call
    begin = time.process_time()
    for item in items:
        call(item)
    return (time.process_time() - begin) / count


def interleaved(jobs: dict[Any, Job], repeats: int = 9, burst: float = 0.01) -> dict[Any, float]:
    """Seconds a call of each job, in turns, so that a slow spell of the machine meets all of them.

    The median of samples; every job is called before its time counts. A sample lasts ``burst`` s at
    least, so that the clock's own cost is lost in it.
    """
    counts = {}
    for name, job in jobs.items():
        now = sample(job)
        if now < SLOW:
            now = min(sample(job) for _ in range(3))
        counts[name] = max(1, round(burst / max(now, 1e-9)))
    samples: dict[Any, list[float]] = {name: [] for name in jobs}
    gc.collect()
    gc.freeze()  # collections between samples then cost next to nothing
    gc.disable()
    try:
        for turn in range(repeats):
            for name, job in jobs.items():
                if turn < 2 or samples[name][0] < SLOW:
                    gc.collect()
                    samples[name].append(sample(job, counts[name]))
    finally:
        gc.enable()
        gc.unfreeze()
    return {name: statistics.median(found) for name, found in samples.items()}


def in_new_process(code: str, *arguments: str) -> Any:
    """What a Python program prints as JSON in a process of its own."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=ROOT, env=kept, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout)


def in_new_processes(count: int, code: str, *arguments: str) -> dict[str, Any]:
    """Medians of the numbers that a program prints, each time in another process.

    The first run counts for nothing: it brings files into the machine's memory. What is no number
    is that of the last run.
    """
    runs = [in_new_process(code, *arguments) for _ in range(count + 1)][1:]
    return {
        key: statistics.median(run[key] for run in runs) if isinstance(value, float) else value
        for key, value in runs[-1].items()
    }
