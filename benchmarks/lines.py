"""Lines of each package, with comments."""

from __future__ import annotations

from collections.abc import Iterator

from .report import ROOT, Bar, Sections

LIMITS = {
    "contact_system": 9500,
    "fmu_export": 4200,
    "drake_plant": 4800,
    "benchmarks": 5000,
    "tests": 13500,
}


def lines(full: bool) -> Iterator[Bar]:
    """Lines of Python and C; of tests only Python, without the FMU hosts in C."""
    for folder, limit in LIMITS.items():
        endings = (".py",) if folder == "tests" else (".py", ".c", ".h")
        files = [file for file in (ROOT / folder).rglob("*") if file.suffix in endings]
        count = sum(len(file.read_text("utf-8").splitlines()) for file in files)
        yield Bar(f"lines of {folder}, {' '.join(endings)}", limit, count)


SECTIONS: Sections = {"lines": lines}
