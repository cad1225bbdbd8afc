"""One measured number against its bar, as a line of the printed table."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).parents[1]
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
WIDTHS = (66, 11, 11)


@dataclass(frozen=True)
class Bar:
    """A measured number and the limit it is held to."""

    name: str
    limit: float | None  # in ``unit``; None: no bar, the number is only reported
    measured: float | None  # None: not measured; ``note`` says why
    unit: str = ""
    least: bool = False  # ``measured`` must be at least ``limit``, not at most
    note: str = ""
    holds: bool = True  # False: a second condition fails, which ``note`` tells

    @property
    def met(self) -> bool | None:
        """Whether the bar is met (NaN meets none); None without a measurement or without a bar."""
        if self.measured is None or self.limit is None:
            return None
        reached = self.measured >= self.limit if self.least else self.measured <= self.limit
        return bool(reached and self.holds)

    @property
    def verdict(self) -> str:
        """ "met", or "MISSED by" the factor that is missing, or "-"."""
        if self.measured is None or self.limit is None:
            return "-"
        if self.met:
            return "met"
        small, large = sorted((self.limit, self.measured))
        failed = self.measured < self.limit if self.least else self.measured > self.limit
        if not failed:
            return "MISSED, see note"
        return f"MISSED by {large / small:.3g} x" if small > 0 else "MISSED"

    def row(self) -> str:
        """The bar as a line of the table."""
        sign = ">=" if self.least else "<="
        unit = f" {self.unit}" if self.unit else ""
        shown = "-" if self.measured is None else f"{self.measured:.2e}"
        if self.measured is not None and 1e-2 <= abs(self.measured) < 1e4:
            shown = f"{self.measured:.3g}"
        bar = "reported" if self.limit is None else f"{sign} {self.limit:g}{unit}"
        line = _line((self.name, bar, f"{shown}{unit}"))
        return f"{line}  {self.verdict:18s} {self.note}".rstrip()


Section = Callable[[bool], Iterator[Bar]]
"""Measures and yields bars; takes ``full``."""
Sections = dict[str, Section]


def header() -> str:
    """Head of the table."""
    return f"{_line(('what', 'bar', 'measured'))}  verdict"


def _line(cells: Iterable[str]) -> str:
    return "  ".join(f"{cell:{width}s}" for cell, width in zip(cells, WIDTHS, strict=True))


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, a line for each row."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def surroundings() -> str:
    """Date and machine."""
    return f"{datetime.now(UTC):%Y-%m-%d}, {_processor()}, one thread."


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor())
