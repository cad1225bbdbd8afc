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

SLOW = 0.2  # [s]: calls that take longer are sampled only twice


@dataclass(frozen=True)
class Job:
    """A call to time; ``make`` gives its argument, such as a new scene, outside the time."""

    call: Callable[[Any], Any]
    make: Callable[[], Any] = lambda: None


def sample(job: Job, count: int = 1) -> float:
    """Processor time of a call, s: the mean of ``count`` calls, each with a new argument."""
    items = [job.make() for _ in range(count)]
    call = job.call
    begin = time.process_time()
    for item in items:
        call(item)
    return (time.process_time() - begin) / count


def interleaved(jobs: dict[Any, Job], repeats: int = 9, burst: float = 0.01) -> dict[Any, float]:
    """Processor time of a call of each job, s: the median of samples that are taken in turns.

    So a slow spell of the machine meets all jobs. Each job is called before it is timed. A sample
    lasts at least ``burst`` s, so that reading the clock does not count.
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
    """Run a Python program in a new process; returns the JSON that it prints."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=ROOT, env=kept, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout)


def in_new_processes(count: int, code: str, *arguments: str) -> dict[str, Any]:
    """Medians of the numbers that a program prints in ``count`` new processes.

    A run before them does not count, as it loads files into the machine's memory. Values that are
    not numbers are those of the last run.
    """
    runs = [in_new_process(code, *arguments) for _ in range(count + 1)][1:]
    return {
        key: statistics.median(run[key] for run in runs) if isinstance(value, float) else value
        for key, value in runs[-1].items()
    }
