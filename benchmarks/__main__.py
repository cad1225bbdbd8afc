"""``python -m benchmarks [PART] [--only NAME] [--full]``.

Without PART, the whole bench in its quick form, within five to eight minutes on two cores: what is
not timed first, two parts side by side; then what is timed, alone. What takes long is left out and
named; it belongs to ``python -m benchmarks PART`` and to ``--full``.

Prints one line a bar and writes results/benchmarks/*.json. The exit code is 1 if a bar of accuracy
or of stress is missed or cannot be measured for another reason than a peer that is not installed,
or if a figure has become slower (regression); the other parts are a report.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import traceback
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context

from .report import (
    THREADS,
    Bar,
    Sections,
    collect,
    quietly,
    sections_of,
    surroundings,
    write,
)

PARTS = (
    "accuracy", "stress", "speed", "work_precision", "skip", "scale", "drake_planner",
    "drake_plant", "drake_station", "fmu", "regression",
)  # fmt: skip
"""Modules of this package; each has SECTIONS, name -> function of ``full`` that yields bars."""

SHARING: dict[str, tuple[str, ...] | None] = {
    "fmu": ("validation", "cosimulation", "model_exchange", "slave", "importers", "fuzz",
            "endurance"),
    "stress": ("cases",),
    "drake_station": ("rolling", "forces", "recovery"),
    "drake_plant": ("spheres", "shapes"),
    "accuracy": None,
    "drake_planner": ("exact", "orders", "scalars", "refusals"),
    "scale": ("exact", "memory"),
}  # fmt: skip
"""Sections without times, which may share the machine, longest part first; None: all of a part."""

LONG: dict[str, tuple[str, ...]] = {
    "speed": ("slip", "many", "eta"), "drake_plant": ("building",),
    "drake_station": ("forces", "recovery", "speed", "memory"),
    "fmu": ("importers", "platforms", "package", "fuzz", "endurance"), "scale": ("dask",),
    "skip": ("drake", "kernels"),
    "work_precision": ("geodesic sphere", "geodesic cylinder", "geodesic torus",
                       "geodesic spheroid", "slip sphere-sphere 1e0", "slip sphere-sphere 1e3",
                       "slip sphere-sphere 1e5", "slip sphere-sphere 1e7",
                       "slip sphere-ellipsoid 1e0", "slip sphere-ellipsoid 1e5", "disturbed K2",
                       "readme"),
}  # fmt: skip
"""Sections that the quick form of the whole leaves out."""

BINDING = ("accuracy", "stress", "regression")
"""Parts whose missed bars make the exit code 1."""


def main(arguments: list[str] | None = None) -> int:
    """Run what was asked for; returns the exit code."""
    for name in THREADS:  # before numpy is imported: one thread for every competitor
        os.environ[name] = "1"
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("part", nargs="?", choices=PARTS, help="one part only, all of it")
    parser.add_argument(
        "--only", metavar="NAME", default="", help="one section, or all that contain it"
    )
    parser.add_argument(
        "--full", action="store_true", help="all sections, more points, 20 s for a run of a peer"
    )
    options = parser.parse_args(arguments)
    chosen = {}
    if options.part or options.only:
        for name in [options.part] if options.part else PARTS:
            chosen[name] = _chosen(name, options.only, bool(options.part))
        if not any(chosen.values()):
            told = f"no section is called {options.only!r} or contains it"
            if options.part:
                told += f"; {options.part}: {', '.join(sections_of(options.part))}"
            parser.error(told)
    about = surroundings()
    print(f"{about['machine']['processor']}, Python {about['python']}, one thread")
    if chosen:
        failed = [_part(*part, options.only, options.full) for part in chosen.items()]
        return int(any(failed))
    return int(_whole(options.full))


def _chosen(name: str, only: str, asked: bool) -> Sections:
    """The section of a part that is called so or, where none is, those that contain it."""
    try:
        sections = sections_of(name)
    except ImportError as error:
        if asked:
            sys.exit(f'{name} cannot run: {error}; pip install ".[bench]" in a clone')
        print(f"\n{name}: left out, {error}")
        return {}
    if only in sections:
        return {only: sections[only]}
    return {k: run for k, run in sections.items() if only in k}


def _part(name: str, chosen: Sections, only: str, full: bool) -> bool:
    """Run some sections of a part; returns whether it failed."""
    if not chosen:
        return False
    print(f"\n{name}: {', '.join(chosen)}")
    bars = collect(bar for run in chosen.values() for bar in run(full))
    _write("-".join([name, *only.split()]), bars)
    return _missed(name, bars)


def _write(name: str, bars: Iterable[Bar]) -> None:
    path = write(name, bars)
    print(f"written: {path.parent.parent.name}/{path.parent.name}/{path.name}")


def _missed(name: str, bars: Iterable[Bar]) -> bool:
    return name in BINDING and any(bar.met is False for bar in bars)


# --- the whole bench -----------------------------------------------------------------------------


def _whole(full: bool) -> bool:
    """All parts, what is not timed side by side; returns whether one failed."""
    begin = time.perf_counter()
    found: dict[str, list[Bar]] = {}
    failed = False
    with ProcessPoolExecutor(2, get_context("spawn"), max_tasks_per_child=1) as pool:
        # Not of this module, which has another name in a new process.
        runs = {
            pool.submit(quietly, name, _without_long(name, chosen, full), full): name
            for name, chosen in SHARING.items()
        }
        for run in as_completed(runs):
            name = runs[run]
            try:
                bars, spent = run.result()
            except Exception as error:  # one part that stops is a finding, not the end of all
                failed |= _stopped(name, error)
                continue
            print(f"\n{name}, side by side with another part ({spent:.0f} s)")
            found[name] = collect(bars)
    for name in PARTS:
        try:
            failed |= _timed(name, found.get(name, []), full)
        except Exception as error:
            failed |= _stopped(name, error)
    print(f"\nthe whole bench took {time.perf_counter() - begin:.0f} s")
    if not full:
        left = "; ".join(f"{name} --only {only}" for name, all_ in LONG.items() for only in all_)
        print(f"left to python -m benchmarks with: {left}; or to --full")
    return failed


def _without_long(name: str, chosen: Sequence[str] | None, full: bool) -> list[str] | None:
    """Those that this form of the bench runs; None: all."""
    if chosen is None:
        return None
    return [key for key in chosen if full or key not in LONG.get(name, ())]


def _timed(name: str, known: list[Bar], full: bool) -> bool:
    """The sections of a part that want the machine for themselves; returns whether it failed."""
    sharing = SHARING.get(name, ())
    left_out = () if full else LONG.get(name, ())
    chosen = {}
    if sharing is not None:
        sections = sections_of(name)
        chosen = {k: v for k, v in sections.items() if k not in sharing and k not in left_out}
    bars = list(known)
    if chosen:
        print(f"\n{name}: {', '.join(chosen)}")
        begin = time.perf_counter()
        bars += collect(bar for run in chosen.values() for bar in run(full))
        print(f"{name} took {time.perf_counter() - begin:.0f} s")
    if bars:
        _write(name, bars)
    return _missed(name, bars)


def _stopped(name: str, error: Exception) -> bool:
    """Tell why a part ended early; a package that is not installed is no failure."""
    if isinstance(error, ImportError):
        print(f"\n{name}: left out, {error}")
        return False
    print(f"\n{name}: stopped")
    traceback.print_exception(error)
    return True


if __name__ == "__main__":
    sys.exit(main())
