"""Run times of competitors in one process, interleaved, with their spread."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

BURST = 0.01  # [s] that one sample lasts at least, so that the clock's own cost is lost in it
SLOW = 0.2  # [s]: what takes longer is sampled twice only


@dataclass(frozen=True)
class Timing:
    """Seconds a call: median, least and greatest of the samples."""

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{1e6 * self.median:.1f} us ({1e6 * self.low:.1f} to {1e6 * self.high:.1f})"


def once(job: Callable[[], object]) -> float:
    """Seconds of a single call."""
    begin = time.perf_counter()
    job()
    return time.perf_counter() - begin


def interleaved(
    jobs: dict[str, Callable[[], object]], repeats: int = 9, burst: float = BURST
) -> dict[str, Timing]:
    """Time jobs in turns, so that a slow spell of the machine meets all of them.

    Parameters
    ----------
    jobs : what to call, by name; every job is called twice before its time counts
    repeats : samples of each job
    burst : s, least length of a sample
    """
    counts = {}
    for name, job in jobs.items():
        job()
        counts[name] = max(1, round(burst / max(once(job), 1e-9)))
    samples: dict[str, list[float]] = {name: [] for name in jobs}
    gc.collect()
    gc.disable()
    try:
        for turn in range(repeats):
            for name, job in jobs.items():
                if turn >= 2 and samples[name][0] > SLOW:
                    continue
                count = counts[name]
                begin = time.perf_counter()
                for _ in range(count):
                    job()
                samples[name].append((time.perf_counter() - begin) / count)
    finally:
        gc.enable()
    return {
        name: Timing(statistics.median(found), min(found), max(found))
        for name, found in samples.items()
    }
