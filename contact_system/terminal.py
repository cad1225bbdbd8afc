"""Text for terminals of 80 columns: paragraphs, tables and a progress bar."""

from __future__ import annotations

import os
import sys
import textwrap
import threading
import time
from collections.abc import Iterable, Sequence

from .errors import printable


def tell(*lines: str) -> None:
    """Print lines at once; drop them if the reader of a pipe, such as head, has ended."""
    try:
        # does nothing if sys.stdout was closed and is None
        print(*map(printable, lines), sep="\n", flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def paragraph(text: str, indent: str = "") -> str:
    """The text in lines of 80 characters, which begin with ``indent`` from the second one on."""
    return textwrap.fill(text, 80, break_on_hyphens=False, subsequent_indent=indent)


def table(head: Sequence[tuple[str, str]], rows: Sequence[tuple[str, ...]]) -> Iterable[str]:
    """Lines of a table headed by names, a word a line, and units; the first column flush left."""
    words = [[*name.split(), unit] for name, unit in head]
    tall = max(map(len, words))
    heads = list(zip(*([""] * (tall - len(word)) + word for word in words)))
    widths = [max(map(len, column)) for column in zip(*heads, *rows)]
    for first, *others in (*heads, ["-" * w for w in widths], *rows):
        cells = [f"{c:>{w}}" for c, w in zip(others, widths[1:])]
        yield "  ".join([f"{first:<{widths[0]}}", *cells]).rstrip()


class Progress:
    """A progress bar of named steps on stderr, shown on a terminal only, and after one second."""

    DELAY, WIDTH = 1.0, 24

    def __init__(self, steps: int, name: str):
        self.steps, self.done, self.name, self.stream = steps, 0, name, sys.stderr
        self.began, self.finished = time.monotonic(), threading.Event()

    def step(self, name: str) -> None:
        """One step is done; name the next one."""
        self.done, self.name = self.done + 1, name

    def __enter__(self) -> Progress:
        self.thread = threading.Thread(target=self._draw, daemon=True)
        if self.stream and self.stream.isatty():  # it is None if it was closed
            self.thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.finished.set()
        if self.thread.ident is not None:
            self.thread.join()

    def _draw(self) -> None:
        wait, drawn = self.DELAY, False
        while not self.finished.wait(wait):
            wait, drawn = 0.1, True
            full = self.WIDTH * self.done // self.steps
            bar = "#" * full + "." * (self.WIDTH - full)
            elapsed = time.monotonic() - self.began
            self.stream.write(f"\r\x1b[K[{bar}] {self.name}, {elapsed:.0f} s")
            self.stream.flush()
        if drawn:
            self.stream.write("\r\x1b[K")
            self.stream.flush()
