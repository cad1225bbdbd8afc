"""``python -m benchmarks [PART ...] [--only SECTION] [--full]``.

Without PART, the table of bars of speed, accuracy, robustness and size, in ten minutes.

Every line is a number, the bar that it is held to and whether that is met. The exit code is 1 if a
bar of accuracy or stress is missed; the others depend on the machine.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
from collections.abc import Iterator

from .report import THREADS, Bar, Section, Sections, header, surroundings

TABLE = ("first", "fresh", "many", "work_precision", "accuracy", "stress", "lines")
PARTS = (*TABLE, "drake", "hands", "truth", "fmu", "steering", "explorer")
"""Modules of this package; each has SECTIONS, name -> function of ``full`` that yields bars."""
BINDING = ("accuracy", "stress")
"""Parts whose missed bars make the exit code 1."""


def main(arguments: list[str] | None = None) -> int:
    """Run what was asked for; returns the exit code."""
    for name in THREADS:  # before numpy is imported: one thread for every competitor
        os.environ[name] = "1"
    text = __doc__.partition("\n\n")[2]  # argparse writes the usage itself
    parser = argparse.ArgumentParser("python -m benchmarks", description=text)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--only", metavar="SECTION", default="", help="sections that contain it")
    parser.add_argument("--full", action="store_true", help="more points, runs and random cases")
    options = parser.parse_args(arguments)
    if unknown := set(options.parts) - set(PARTS):
        parser.error(f"no part is called {', '.join(sorted(unknown))}; use {', '.join(PARTS)}")
    chosen = {part: _chosen(part, options.only) for part in options.parts or TABLE}
    if not any(chosen.values()):
        known = "; ".join(f"{part}: {', '.join(_sections(part))}" for part in chosen)
        parser.error(f"no section is called {options.only!r} or contains it; {known}")
    print(surroundings())
    missed = False
    for part, sections in chosen.items():
        print(f"\n{part}: {', '.join(sections)}\n{header()}", flush=True)
        begin = time.perf_counter()
        for name, section in sections.items():
            for bar in _run(name, section, options.full):
                print(bar.row(), flush=True)
                missed |= bar.met is False and part in BINDING
        print(f"{part} took {time.perf_counter() - begin:.0f} s")
    return int(missed)


def _sections(part: str) -> Sections:
    try:
        return importlib.import_module(f".{part}", __package__).SECTIONS
    except ImportError as error:
        sys.exit(f'{part} cannot run: {error}; pip install -e ".[bench]" in a clone')


def _chosen(part: str, only: str) -> Sections:
    """The section that is called so or, where none is, those that contain it."""
    known = _sections(part)
    wanted = [only] if only in known else [name for name in known if only in name]
    return {name: known[name] for name in wanted}


def _run(name: str, section: Section, full: bool) -> Iterator[Bar]:
    """Bars of a section, or why it is left out."""
    try:
        yield from section(full)
    except ImportError as error:
        yield Bar(name, None, None, note=f'left out: {error}; pip install -e ".[bench]"')


if __name__ == "__main__":
    sys.exit(main())
