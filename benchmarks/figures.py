"""Pictures of the work-precision diagrams."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from .curves import Outcome, Run

COLOURS = {
    "heyoka": "tab:blue", "CVODES": "tab:green", "scipy": "tab:gray", "scikit-sundae": "tab:olive",
    "diffrax": "tab:purple", "geomstats": "tab:brown", "geographiclib": "tab:brown",
    "ours, compiled": "crimson", "ours, virtual": "tab:orange", "ours, FMU": "black",
    "ours, Drake": "tab:cyan", "ours, method": "tab:pink",
}  # fmt: skip
MARKERS = "osv^Dx+P*"


def diagram(outcome: Outcome, file: Path) -> None:
    """Write one problem's diagram with every method."""
    figure, axes = _pyplot().subplots(figsize=(9.0, 5.5), layout="constrained")
    _draw(axes, outcome, {name: name for name in outcome.curves})
    axes.legend(fontsize="x-small", ncols=1, loc="center left", bbox_to_anchor=(1.0, 0.5))
    _save(figure, file)


def overview(outcomes: list[Outcome], file: Path, columns: int = 4) -> None:
    """Write one picture of some problems: our plans and the best of each library."""
    columns = min(columns, len(outcomes))
    rows = math.ceil(len(outcomes) / columns)
    figure, axes = _pyplot().subplots(
        rows, columns, figsize=(3.2 * columns, 2.6 * rows), layout="constrained", squeeze=False
    )
    named: dict[str, Any] = {}
    for axis, outcome in zip(axes.flat, outcomes):
        merged = _merged(outcome)
        _draw(axis, merged, {name: name for name in merged.curves}, label=False)
        named |= dict(zip(*axis.get_legend_handles_labels()[::-1]))
    for axis in axes.flat[len(outcomes) :]:
        axis.set_visible(False)
    figure.supxlabel("greatest distance of a contact point, of the body's size")
    figure.supylabel("run time [s]")
    figure.legend(
        named.values(), named.keys(), loc="outside upper center", ncols=min(6, 2 * columns)
    )
    _save(figure, file)


def _merged(outcome: Outcome) -> Outcome:
    """One curve a library, of its best runs."""
    curves: dict[str, list[Run]] = {}
    for name, runs in outcome.curves.items():
        if not name.endswith("new scene") and not name.startswith("ours, method"):
            key = " ".join(name.split()[: 2 if name.startswith("ours") else 1]).rstrip(",")
            curves.setdefault(key, []).extend(runs)
    for runs in curves.values():
        runs.sort(key=lambda run: run.time.median)
        best = math.inf
        for run in list(runs):
            if run.error >= best:
                runs.remove(run)
            best = min(best, run.error)
    return type(outcome)(outcome.name, curves)


def _draw(axes: Any, outcome: Outcome, labels: dict[str, str], label: bool = True) -> None:
    for k, (name, runs) in enumerate(outcome.curves.items()):
        errors = [max(run.error, 1e-17) for run in runs]
        times = [run.time.median for run in runs]
        spread = [
            [run.time.median - run.time.low for run in runs],
            [run.time.high - run.time.median for run in runs],
        ]
        own = name.startswith("ours")
        axes.errorbar(
            errors, times, spread, label=labels[name], marker=MARKERS[k % len(MARKERS)],
            markersize=3.5, linewidth=1.8 if own else 0.9,
            linestyle="--" if name.endswith("new scene") else "-", color=_colour(name),
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.invert_xaxis()
    axes.grid(alpha=0.3)
    axes.set_title(outcome.name, fontsize="medium" if label else "small")
    if label:
        axes.set_xlabel("greatest distance of a contact point, of the body's size")
        axes.set_ylabel("run time [s]")


def _colour(name: str) -> str:
    return next((colour for key, colour in COLOURS.items() if name.startswith(key)), "tab:gray")


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot

    return matplotlib.pyplot


def _save(figure: Any, file: Path) -> None:
    from PIL import Image  # matplotlib needs it

    figure.savefig(file, dpi=110)
    _pyplot().close(figure)
    with Image.open(file) as picture:  # 64 colours: a quarter of the size
        few = picture.convert("RGB").quantize(64)
    few.save(file, optimize=True)
