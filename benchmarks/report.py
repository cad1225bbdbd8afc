"""One measured number against its bar; the parts that measure; printed table and JSON file."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parents[1] / "results" / "benchmarks"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
PACKAGES = ("numpy", "scipy", "casadi", "heyoka", "geographiclib", "mpmath")
WIDTHS = (66, 11, 11)


@dataclass(frozen=True)
class Bar:
    """A measured number and the limit it is held to.

    Attributes
    ----------
    name : str
    limit : float or None
        In ``unit``; None: no bar, the number is only reported.
    measured : float or None
        None: not measured; ``note`` says why.
    unit : str
        Printed behind both numbers.
    least : bool
        True: ``measured`` must be at least ``limit``; False: at most.
    note : str
        One line printed behind the verdict.
    holds : bool
        Whether the bar's other condition holds; ``note`` says which it is.
    detail : dict
        What stands behind the number, for the JSON file.
    """

    name: str
    limit: float | None
    measured: float | None
    unit: str = ""
    least: bool = False
    note: str = ""
    holds: bool = True
    detail: dict[str, Any] = field(default_factory=dict)

    @property
    def met(self) -> bool | None:
        """Whether the bar is met (NaN meets none); None without a measurement or without a bar."""
        if self.measured is None or self.limit is None:
            return None
        reached = self.measured >= self.limit if self.least else self.measured <= self.limit
        return bool(reached and self.holds)

    @property
    def verdict(self) -> str:
        """ "yes", or "NO by" the factor that is missing, or "-"."""
        if self.measured is None or self.limit is None:
            return "-"
        if self.met:
            return "yes"
        small, large = sorted((self.limit, self.measured))
        if small <= 0:
            return "NO"
        missing = large / small
        failed = self.measured < self.limit if self.least else self.measured > self.limit
        return f"NO by {missing:.3g} x" if failed else "NO, see note"

    def row(self) -> str:
        """The bar as a line of the table."""
        sign = ">=" if self.least else "<="
        unit = f" {self.unit}" if self.unit else ""
        shown = "-" if self.measured is None else f"{self.measured:.2e}"
        if self.measured is not None and 1e-2 <= abs(self.measured) < 1e4:
            shown = f"{self.measured:.3g}"
        bar = "reported" if self.limit is None else f"{sign} {self.limit:g}{unit}"
        cells = (self.name, bar, f"{shown}{unit}")
        padded = "  ".join(f"{cell:{width}s}" for cell, width in zip(cells, WIDTHS, strict=True))
        return f"{padded}  {self.verdict:14s} {self.note}".rstrip()


Sections = dict[str, Callable[[bool], Iterator[Bar]]]
"""Name of a section -> function of ``full`` that measures and yields its bars."""


def header() -> str:
    """Head of the table."""
    cells = ("what", "bar", "measured")
    padded = "  ".join(f"{cell:{width}s}" for cell, width in zip(cells, WIDTHS, strict=True))
    return f"{padded}  met"


def collect(bars: Iterable[Bar]) -> list[Bar]:
    """Print each bar as soon as it is measured; return all."""
    print(header(), flush=True)
    kept = []
    for bar in bars:
        print(bar.row(), flush=True)
        kept.append(bar)
    return kept


def sections_of(name: str) -> Sections:
    """Sections of a part, which is a module of this package."""
    return importlib.import_module(f".{name}", __package__).SECTIONS


def quietly(name: str, chosen: Sequence[str] | None, full: bool) -> tuple[list[Bar], float]:
    """Bars of some sections of a part (None: of all), and what they took, s; prints nothing."""
    begin = time.perf_counter()
    sections = sections_of(name)
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        bars = [bar for key in chosen or sections for bar in sections[key](full)]
    return bars, time.perf_counter() - begin


def write(name: str, bars: Iterable[Bar]) -> Path:
    """Write ``results/benchmarks/<name>.json`` in the checkout; returns its path."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    path = RESULTS / f"{name}.json"
    rows = [{**asdict(bar), "met": bar.met} for bar in bars]
    path.write_text(json.dumps({**surroundings(), "bars": rows}, indent=1, default=float) + "\n")
    return path


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, a line a row."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def surroundings() -> dict[str, Any]:
    """Date, machine, versions and thread settings of this run."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "processor": _processor(),
            "cores": os.cpu_count(),
            "system": platform.system(),
            "load": os.getloadavg() if hasattr(os, "getloadavg") else None,
        },  # fmt: skip
        "python": sys.version.split()[0],
        "versions": {name: _version(name) for name in PACKAGES},
        "threads": {name: os.environ.get(name, "not set") for name in THREADS},
    }


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
