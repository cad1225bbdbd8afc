"""Run times of competitors in one process, interleaved, with their spread."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

BURST = 0.01  # [s] that one sample lasts at least, so that the clock's own cost is lost in it
SLOW = 0.2  # [s]: what takes longer is sampled twice only


@dataclass(frozen=True)
class Job:
    """What is timed.

    Attributes
    ----------
    call : callable
        Takes one item.
    make : callable
        Makes an item, outside the time. A scene keeps what was found out about it when it was
        planned first, so a scene that is to be planned afresh is made anew for every call.
    """

    call: Callable[[Any], Any]
    make: Callable[[], Any] = lambda: None


@dataclass(frozen=True)
class Timing:
    """Seconds a call: median, least and greatest of the samples."""

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{1e6 * self.median:.4g} us ({1e6 * self.low:.4g} to {1e6 * self.high:.4g})"


def sample(job: Job, count: int = 1) -> float:
    """Seconds a call, over ``count`` calls."""
    items = [job.make() for _ in range(count)]
    call = job.call
    begin = time.perf_counter()
    for item in items:
        call(item)
    return (time.perf_counter() - begin) / count


def least(job: Job, tries: int = 5) -> float:
    """Least of a few single calls, s; slow ones are called once."""
    first = sample(job)
    return first if first > SLOW else min(first, *(sample(job) for _ in range(tries - 1)))


def interleaved(jobs: dict[str, Job], repeats: int = 9, burst: float = BURST) -> dict[str, Timing]:
    """Time jobs in turns, so that a slow spell of the machine meets all of them.

    Parameters
    ----------
    jobs : by name; every job is called before its time counts
    repeats : samples of each job
    burst : s, least length of a sample
    """
    counts = {}
    for name, job in jobs.items():
        for _ in range(3):  # two may compile: a plan in full, and what the next of its kind need
            now = sample(job)
            if now < SLOW:
                now = min(sample(job) for _ in range(3))
                break
        counts[name] = max(1, round(burst / max(now, 1e-9)))
    samples: dict[str, list[float]] = {name: [] for name in jobs}
    gc.disable()
    try:
        for turn in range(repeats):
            for name, job in jobs.items():
                if turn >= 2 and samples[name][0] > SLOW:
                    continue
                gc.collect()
                samples[name].append(sample(job, counts[name]))
    finally:
        gc.enable()
    return {
        name: Timing(statistics.median(found), min(found), max(found))
        for name, found in samples.items()
    }


def resident() -> float:
    """Memory of this process, MB; its peak where the system does not tell more."""
    import resource  # Windows has none

    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * resource.getpagesize() / 1e6
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
