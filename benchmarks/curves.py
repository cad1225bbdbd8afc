"""Curves of run time against error, and how they are compared."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from . import ours
from .timing import Timing


@dataclass(frozen=True)
class Run:
    """A method at one tolerance; ``build`` holds the seconds of just-in-time compilation."""

    tolerance: float
    error: float
    time: Timing
    build: float


@dataclass
class Outcome:
    """A problem's curves, and why methods are absent or stop: name -> reason."""

    name: str
    curves: dict[str, list[Run]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    def rivals(self) -> dict[str, list[Run]]:
        """The peers' curves."""
        return {k: v for k, v in self.curves.items() if not k.startswith("ours")}

    def own(self, new: bool) -> list[Run]:
        """The curve of the plan's fastest engine on this machine."""
        name = f"ours, {ours.engine(ours.engines()[-1])}{', new scene' * new}"
        return self.curves.get(name, [])


def time_at(curve: list[Run], error: float, of: str = "median") -> float | None:
    """Seconds to reach an error by the samples' "median" or "low"; None: not reached."""

    def seconds(run: Run) -> float:
        return getattr(run.time, of)

    front: list[Run] = []
    for run in sorted(curve, key=seconds):
        if not front or run.error < front[-1].error:
            front.append(run)  # slower and better than all before
    reached = [run for run in front if run.error <= error]
    if not reached:
        return None
    tight = reached[0]
    looser = [run for run in front if run.error > error]
    if not looser or tight.error <= 0.0:
        return seconds(tight)
    loose = looser[-1]
    share = math.log(loose.error / error) / math.log(loose.error / tight.error)
    logs = math.log(seconds(loose)), math.log(seconds(tight))
    return math.exp((1.0 - share) * logs[0] + share * logs[1])


def fastest(
    curves: dict[str, list[Run]], error: float, of: str = "median"
) -> tuple[str, float] | None:
    """Name and seconds of the peer that reaches an error first."""
    found = {name: time_at(runs, error, of) for name, runs in curves.items()}
    times = {name: t for name, t in found.items() if t is not None}
    return min(times.items(), key=lambda pair: pair[1]) if times else None


@dataclass(frozen=True)
class Ratio:
    """Times faster than the fastest peer at one error.

    Attributes
    ----------
    prepared, new : by medians, of scenes planned before and of new ones
    quiet : by least samples, prepared: what is left of it on a machine with nothing else to do
    rival : the fastest peer
    seconds : ours and the peer's, medians
    """

    prepared: float
    new: float
    quiet: float
    rival: str
    seconds: tuple[float, float]


def ratio(outcome: Outcome, error: float) -> Ratio | str:
    """The comparison, or why there is none."""
    mine, new = (time_at(outcome.own(k), error) for k in (False, True))
    least = time_at(outcome.own(new=False), error, "low")
    rival, other = (fastest(outcome.rivals(), error, of) for of in ("median", "low"))
    if mine is None or new is None or least is None:
        return "ours does not reach this error"
    if rival is None or other is None:
        return "no peer reaches this error"
    name, seconds = rival
    return Ratio(seconds / mine, seconds / new, other[1] / least, name, (mine, seconds))
