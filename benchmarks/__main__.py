"""``python -m benchmarks [PART] [--only NAME] [--full]``.

Prints one line a bar and writes results/benchmarks/*.json. The exit code is 1 if an accuracy bar is
missed or cannot be measured for another reason than a peer that is not installed; the other parts
are a report.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys

from .report import THREADS, collect, surroundings, write

PARTS = (
    "accuracy", "speed", "work_precision", "scale", "drake_planner", "drake_plant",
    "drake_station", "fmu",
)  # fmt: skip
"""Modules of this package; each has SECTIONS, name -> function of ``full`` that yields bars."""


def main(arguments: list[str] | None = None) -> int:
    """Run what was asked for; returns the exit code."""
    for name in THREADS:  # before numpy is imported: one thread for every competitor
        os.environ[name] = "1"
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("part", nargs="?", choices=PARTS, help="one part only")
    parser.add_argument("--only", metavar="NAME", help="one section, or all that contain it")
    parser.add_argument(
        "--full", action="store_true", help="give every peer 20 s a run instead of 1 s"
    )
    options = parser.parse_args(arguments)
    about = surroundings()
    print(f"{about['machine']['processor']}, Python {about['python']}, one thread")
    failed = False
    for name in [options.part] if options.part else PARTS:
        try:
            sections = importlib.import_module(f".{name}", __package__).SECTIONS
        except ImportError as error:
            if options.part:
                raise
            print(f"\n{name}: left out, {error}")
            continue
        only = options.only or ""
        chosen = {k: run for k, run in sections.items() if k == only or only not in sections}
        chosen = {k: run for k, run in chosen.items() if only in k}
        if not chosen:
            continue
        print(f"\n{name}: {', '.join(chosen)}")
        bars = collect(bar for run in chosen.values() for bar in run(options.full))
        path = write("-".join([name, *only.split()]), bars)
        print(f"written: {path.parent.parent.name}/{path.parent.name}/{path.name}")
        failed |= name == "accuracy" and any(bar.met is False for bar in bars)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
