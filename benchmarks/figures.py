"""Pictures: time over error in panels, and how cases of stress end."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Curve = tuple[Sequence[float], Sequence[float]]
"""Errors and times."""
SHARED = {"marker": "o", "markersize": 3.5, "linewidth": 0.9}


def overview(
    panels: dict[str, dict[str, Curve]],
    styles: dict[str, dict[str, Any]],
    file: Path,
    across: str,
    up: str,
    columns: int,
) -> None:
    """Write a picture with a panel for each title: curves by name, time over error."""
    from matplotlib.figure import Figure
    from PIL import Image  # matplotlib needs it

    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(3.1 * columns, 2.65 * rows + 0.8), layout="constrained")
    grid = figure.subplots(rows, columns, sharey=True, squeeze=False)
    named: dict[str, Any] = {}
    for axes, (title, curves) in zip(grid.flat, panels.items()):
        for name, (errors, times) in curves.items():
            axes.loglog(errors, times, label=name, **SHARED | styles[name])
        axes.invert_xaxis()
        axes.grid(alpha=0.3)
        axes.set_title(title, fontsize="small")
        named |= dict(zip(*axes.get_legend_handles_labels()[::-1]))
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    figure.supxlabel(across)
    figure.supylabel(up)
    place = {"loc": "outside upper center", "ncols": 4, "fontsize": "small"}
    figure.legend(named.values(), named.keys(), **place)
    figure.savefig(file, dpi=110)
    with Image.open(file) as picture:  # a quarter of the size; median cut would mix colours
        few = picture.convert("RGB").quantize(64, Image.Quantize.FASTOCTREE)
    few.save(file, optimize=True)


COLOURS = {"right": "tab:green", "refused": "tab:gray", "silent": "crimson"}
COLOURS |= {"crash": "tab:orange", "hang": "tab:purple"}


def outcomes(records: Sequence[Any], file: Path) -> None:
    """Draw how cases of stress ended, by family, and the errors of right ones over their bounds."""
    from matplotlib.figure import Figure

    families = list(dict.fromkeys(record.family for record in records))[::-1]
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[3, 2])
    before = [0] * len(families)
    for outcome, colour in COLOURS.items():
        count = Counter(r.family for r in records if r.verdict.outcome == outcome)
        lengths = [count[family] for family in families]
        label = f"{outcome}: {count.total()}"
        left.barh(families, lengths, left=before, color=colour, label=label)
        before = [a + b for a, b in zip(before, lengths)]
    left.set_xlabel("cases")
    left.legend(fontsize="small")
    verdicts = [r.verdict for r in records if r.verdict.outcome == "right"]
    part = [math.log10(max(v.error / v.bound, 1e-6)) for v in verdicts]
    right.hist(part, bins=60, color=COLOURS["right"])
    right.set_xlabel("error of right cases over its bound, log10")
    right.axvline(0, color="black", linewidth=0.8)
    figure.savefig(file, dpi=100)
