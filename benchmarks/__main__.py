"""``python -m benchmarks [PART ...] [--only SECTION] [--full]``.

Without PART, a quick overview within five minutes: the table of bars with four problems of
work_precision and every eleventh case of stress. ``bars`` prints the table whole.

Every line is a number, the bar that it is held to and whether that is met; numbers and what stands
behind them go to results/benchmarks/PART.json. The exit code is 1 if a bar of accuracy or
stress is missed; the others depend on the machine.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
from collections.abc import Iterator

from .report import THREADS, Bar, Section, Sections, header, surroundings, write

PARTS = (
    *("bars", "first", "fresh", "many", "work_precision", "accuracy", "stress"),
    *("drake_planner", "drake_station", "hands", "physics", "truth"),
    *("fmu", "reach", "geodesic", "explorer"),
)
"""Modules of this package; each has SECTIONS, name -> function of ``full`` that yields bars."""
BINDING = ("accuracy", "stress")
"""Parts whose missed bars make the exit code 1."""


def main(arguments: list[str] | None = None) -> int:
    """Run what was asked for; returns the exit code."""
    for name in THREADS:  # before numpy is imported: one thread for every competitor
        os.environ[name] = "1"
    parser = argparse.ArgumentParser("python -m benchmarks", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--only", metavar="SECTION", default="", help="sections that contain it")
    parser.add_argument("--full", action="store_true", help="more points, runs and random cases")
    options = parser.parse_args(arguments)
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"no part is called {', '.join(sorted(unknown))}; use {', '.join(PARTS)}")
    chosen = _chosen(options.parts, options.only)
    if not any(chosen.values()):
        known = "; ".join(f"{part}: {', '.join(_sections(part))}" for part in options.parts)
        parser.error(f"no section is called {options.only!r} or contains it; {known}")
    about = surroundings()
    print(f"{about['processor']}, Python {about['python']}, one thread")
    missed = False
    for part, sections in chosen.items():
        print(f"\n{part}: {', '.join(sections)}\n{header()}", flush=True)
        begin, bars = time.perf_counter(), []
        for name, section in sections.items():
            for bar in _run(name, section, options.full):
                print(bar.row(), flush=True)
                bars.append(bar)
                missed |= bar.met is False and (part in BINDING or name.split(":")[0] in BINDING)
        print(f"{part} took {time.perf_counter() - begin:.0f} s")
        write("-".join([part, *options.only.split()]), bars)
    return int(missed)


def _sections(part: str) -> Sections:
    return importlib.import_module(f".{part}", __package__).SECTIONS


def _chosen(parts: list[str], only: str) -> dict[str, Sections]:
    """Part -> the sections that are called so or, where none is, those that contain it."""
    if not parts:
        from .bars import QUICK

        return {"overview": {name: run for name, run in QUICK.items() if only in name}}
    chosen = {}
    for part in parts:
        try:
            known = _sections(part)
        except ImportError as error:
            sys.exit(f'{part} cannot run: {error}; pip install ".[bench]" in a clone')
        wanted = [only] if only in known else [name for name in known if only in name]
        chosen[part] = {name: known[name] for name in wanted}
    return chosen


def _run(name: str, section: Section, full: bool) -> Iterator[Bar]:
    """Bars of a section, or why it is left out."""
    try:
        yield from section(full)
    except ImportError as error:
        yield Bar(name, None, None, note=f'left out: {error}; pip install ".[bench]" in a clone')


if __name__ == "__main__":
    sys.exit(main())
