"""The table of bars, of speed, accuracy, robustness and size: ``python -m benchmarks bars``."""

from __future__ import annotations

from collections.abc import Iterator

from . import accuracy, first, fresh, many, stress, work_precision
from .report import ROOT, Bar, Sections

LINES = {
    "contact_system": (9500, ("*.py", "*.c", "*.h")),
    "benchmarks": (5000, ("*.py",)),
    "tests": (13500, ("*.py",)),
}


def lines(full: bool) -> Iterator[Bar]:
    """Lines of each package, with comments."""
    for folder, (limit, patterns) in LINES.items():
        files = [file for pattern in patterns for file in (ROOT / folder).rglob(pattern)]
        count = sum(len(file.read_text("utf-8").splitlines()) for file in files)
        yield Bar(f"lines of {folder}, {' '.join(patterns)}", limit, count)


SECTIONS: Sections = {
    f"{part.__name__.split('.')[-1]}: {name}": section
    for part in (first, fresh, many, work_precision, accuracy)
    for name, section in part.SECTIONS.items()
    if name != "page"
}
SECTIONS |= {f"stress: {name}": section for name, section in stress.SECTIONS.items()}
SECTIONS["lines"] = lines

QUICK: Sections = {
    name: section
    for name, section in SECTIONS.items()
    if not name.startswith(("work_precision: ", "stress: "))
    or name.removeprefix("work_precision: ") in (*work_precision.QUICK, "summary")
}
"""What is run where no part is named: four problems, and every eleventh case of stress."""
QUICK |= {"stress: sample": stress.sample}
