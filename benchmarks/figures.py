"""Pictures of the work-precision diagrams and of stress."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .work_precision import Outcome, Run, best

STYLES = {
    "ours": ("crimson", "o"),
    "heyoka": ("tab:blue", "s"),
    "CVODES": ("tab:green", "v"),
}


def overview(outcomes: list[Outcome], file: Path) -> None:
    """Write one picture of some problems: our plans and the best of each library."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from PIL import Image  # matplotlib needs it

    columns = 4
    rows = math.ceil(len(outcomes) / columns)
    size = (3.2 * columns, 2.6 * rows)
    figure, grid = pyplot.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    named: dict[str, Any] = {}
    for axes, outcome in zip(grid.flat, outcomes):
        _draw(axes, outcome)
        named |= dict(zip(*axes.get_legend_handles_labels()[::-1]))
    for axes in grid.flat[len(outcomes) :]:
        axes.set_visible(False)
    figure.supxlabel("greatest distance of a contact point, of the body's size")
    figure.supylabel("run time [s]")
    place = {"loc": "outside upper center", "ncols": min(6, 2 * columns)}
    figure.legend(named.values(), named.keys(), **place)
    figure.savefig(file, dpi=110)
    pyplot.close(figure)
    with Image.open(file) as picture:  # to 64 colours: a quarter of the size
        few = picture.convert("RGB").quantize(64)
    few.save(file, optimize=True)


def _best(outcome: Outcome) -> dict[str, list[Run]]:
    """The best runs of each library."""
    curves: dict[str, list[Run]] = {}
    for name, runs in outcome.curves.items():
        curves.setdefault(name.split()[0].rstrip(","), []).extend(runs)
    return {name: best(curves[name]) for name in STYLES if name in curves}


def _draw(axes: Any, outcome: Outcome) -> None:
    for name, runs in _best(outcome).items():
        errors = [max(run.error, 1e-17) for run in runs]
        times = [run.time.median for run in runs]
        below = [run.time.median - run.time.low for run in runs]
        above = [run.time.high - run.time.median for run in runs]
        (colour, mark), width = STYLES[name], 1.8 if name == "ours" else 0.9
        style = {"color": colour, "marker": mark, "markersize": 3.5, "linewidth": width}
        axes.errorbar(errors, times, [below, above], label=name, **style)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.invert_xaxis()
    axes.grid(alpha=0.3)
    axes.set_title(outcome.name, fontsize="small")


def outcomes(records: Sequence[Any], file: Path) -> None:
    """Write how cases of stress ended, by family, and how near right ones came to their bounds."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    families = list(dict.fromkeys(record.family for record in records))[::-1]
    figure, (left, right) = pyplot.subplots(
        1, 2, figsize=(10, 4.2), layout="constrained", width_ratios=[3, 2]
    )
    ends = dict(zip(("right", "refused", "silent", "crash", "hang"), ENDS))
    before = [0] * len(families)
    for outcome, colour in ends.items():
        count = Counter(r.family for r in records if r.verdict.outcome == outcome)
        lengths = [count[family] for family in families]
        label = f"{outcome}: {count.total()}"
        left.barh(families, lengths, left=before, color=colour, label=label)
        before = [a + b for a, b in zip(before, lengths)]
    left.set_xlabel("cases")
    left.legend(fontsize="small")
    verdicts = [r.verdict for r in records if r.verdict.outcome == "right"]
    part = [math.log10(max(v.error / v.bound, 1e-6)) for v in verdicts]
    right.hist(part, bins=60, color=ENDS[0])
    right.set_xlabel("error of right cases over its bound, log10")
    right.axvline(0, color="black", linewidth=0.8)
    figure.savefig(file, dpi=100)
    pyplot.close(figure)


ENDS = ("tab:green", "tab:gray", "crimson", "tab:orange", "tab:purple")
"""Colours of right, refused, silently wrong, crash and hang."""
