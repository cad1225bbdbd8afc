"""The command ``contact-system drake``: simulate a scene with contact physics, measure, draw."""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from contact_system import load_scene
from contact_system.cli import Progress, file_name, paragraph, results_folder, table
from contact_system.measures import REJECTED
from contact_system.plots import MissingMatplotlib
from contact_system.scene_files import scene_to_toml
from contact_system.system import COORDINATES

from . import plots
from .measures import EDGE, SATURATED, ContactReport, contact_table
from .plant import CHOICES
from .station import SimulationResult, StationConfig, simulate

TICKS = 1000  # of the progress bar


def register(commands: Any) -> None:
    """Add the command to an argparse parser's subparsers (see :mod:`contact_system.cli`)."""
    parser = commands.add_parser("drake", help="simulate a scene in Drake, with contact physics")
    parser.add_argument("scene", metavar="SCENE", help="name of a bundled scene, or a TOML file")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results; default "
                        "results/NAME")  # fmt: skip
    parser.add_argument("--until", type=float, metavar="T", help="stop after so many seconds "
                        "instead of the scene's duration")  # fmt: skip
    parser.add_argument("--contact", choices=CHOICES["contact_model"], help="contact model "
                        "instead of the scene's")  # fmt: skip
    parser.add_argument("--object", choices=CHOICES["object"], help="how the object "
                        "moves, instead of as the scene says")  # fmt: skip
    parser.add_argument("--time-step", type=float, metavar="H", help="of the plant, s")
    parser.add_argument("--coordinates", choices=COORDINATES, help="what the planner "
                        "integrates: the paper's chart equations, or moving frames")  # fmt: skip
    parser.add_argument("--no-recording", action="store_true", help="write no Meshcat recording")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, tell, write; returns the exit code."""
    scene = load_scene(args.scene)
    wished = {"contact_model": args.contact, "object": args.object, "time_step": args.time_step,
              "coordinates": args.coordinates}  # fmt: skip
    config = StationConfig.from_scene(scene, **{k: v for k, v in wished.items() if v is not None})
    stem = results_folder(args, scene) / f"{file_name(scene)}-drake"
    recording = None if args.no_recording else stem.with_suffix(".html")
    duration = scene.duration if args.until is None else args.until
    with Progress(TICKS, "building") as progress:

        def advance(t: float) -> None:
            progress.name = f"simulating, t = {t:.2f} s of {duration:g} s"
            progress.done = int(TICKS * min(1.0, t / duration))

        result = simulate(scene, config, duration, progress=advance, recording=recording)
    print("\n".join(_told(result, contact_table(result))))
    with Progress(3, "writing") as progress:
        for line in _written(result, stem, progress):
            print(line)
    if recording is not None:
        print(f"wrote {recording}")
    return 0


def _written(result: SimulationResult, stem: Path, progress: Progress) -> Iterable[str]:
    """Write logs and picture; yields a line for each file, and for what is left out."""
    for suffix, write in ((".npz", save_npz), (".csv", save_csv)):
        write(result, stem.with_suffix(suffix))
        yield f"wrote {stem.with_suffix(suffix)}"
        progress.step("drawing" if suffix == ".csv" else "writing")
    try:
        plots.plot(result, stem.with_suffix(".png"))
        yield f"wrote {stem.with_suffix('.png')}"
    except MissingMatplotlib as error:
        yield f"no picture: {error}"


def save_npz(result: SimulationResult, path: Path) -> None:
    """Write the scene (as TOML text) and all logs: ``planned_slip``, ``measured_slip``, ..."""
    logs: dict[str, Any] = {
        f"{kind}_{name}": values
        for kind, table in (("planned", result.planned), ("measured", result.measured))
        for name, values in table.items()
    }
    logs |= {"t": result.t, "object_pose": result.object_pose}
    np.savez_compressed(path, scene=np.array(scene_to_toml(result.scene)), **logs)


def save_csv(result: SimulationResult, path: Path) -> None:
    """Write forces, slip and contact points, one line a time and contact."""
    head = ["t [s]", "contact", "normal force [N]", "tangential force x [N]",
            "tangential force y [N]", "slip x [m/s]", "slip y [m/s]", "planned slip x [m/s]",
            "planned slip y [m/s]", *(f"contact point {w} [m]" for w in "xyz"),
            *(f"planned contact point {w} [m]" for w in "xyz")]  # fmt: skip
    seen, wanted = result.measured, result.planned
    columns = np.concatenate(
        [seen["normal_force"][:, :, None], seen["tangential_force"], seen["slip"], wanted["slip"],
         seen["contact_point"], wanted["contact_point"]], axis=2,
    )  # fmt: skip
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        for t, contacts in zip(result.t.tolist(), columns.tolist()):
            writer.writerows([repr(t), i, *map(repr, row)] for i, row in enumerate(contacts))


# --- telling -----------------------------------------------------------------------------------


def _told(result: SimulationResult, reports: Sequence[ContactReport]) -> Iterable[str]:
    scene, plant = result.scene, result.config.plant
    yield f"{scene.name or 'scene'}: {scene.description}".rstrip(": ")
    yield (
        f"{plant.contact_model} contact, step {plant.time_step:g} s: "
        f"{result.t[-1] - result.t[0]:g} s simulated in {result.wall_time:.1f} s, "
        f"{(result.t[-1] - result.t[0]) / result.wall_time:.2f} times real time; "
        f"built in {result.build_time:.1f} s"
    )
    yield ""
    yield from _forces(reports)
    yield from _explained(
        f"Normal force: excluding {EDGE:g} s after the start and around a disturbance's edges. "
        "Peak over mu N: with the normal force of the same moment. Friction and slip in rolling, "
        "distance from the planned contact point: before any disturbance."
    )
    if any(not math.isnan(r.recovery) for r in reports):
        yield from _rejections(reports)
        yield from _explained(
            "Recovery: time from the disturbance's end until slip stays below "
            f"{REJECTED:.0%} of its mean while disturbed, or below its greatest before, where that "
            "is more; to rolling: or below what undisturbed contacts have at the same speed. "
            f"Saturated: part of the disturbance with friction above {SATURATED:.0%} of mu N."
        )
        yield from (*map(paragraph, _verdict(result, reports)), "")


def _explained(text: str) -> Iterable[str]:
    return (paragraph(text), "")


def _forces(reports: Sequence[ContactReport]) -> Iterable[str]:
    head = (("contact", ""), ("normal force", "N"), ("deviation", "N"), ("peak friction", "N"),
            ("over mu N", ""), ("in rolling", "N"), ("slip/speed", ""),
            ("distance", "mm"))  # fmt: skip
    measured = [
        (r.name, r.normal_mean, r.normal_deviation, r.friction_peak, r.friction_ratio,
         r.rolling_friction, r.rolling_slip, 1e3 * r.distance)
        for r in reports
    ]  # fmt: skip
    forms = (".4f", ".4f", ".3f", ".3f", ".3f", ".1e", ".3f")
    rows = [
        (name, *("-" if math.isnan(x) else format(x, form) for x, form in zip(values, forms)))
        for name, *values in measured
    ]
    return (*table(head, rows, 1), "")


def _rejections(reports: Sequence[ContactReport]) -> Iterable[str]:
    head = (("contact", ""), ("slip disturbed", "m/s"), ("greatest before", "m/s"),
            ("saturated", ""), ("recovery", "s"), ("to rolling", "s"), ("paper", "s"),
            ("as reported", ""))  # fmt: skip
    rows = []
    for r in reports:
        if math.isnan(r.recovery):
            continue
        taken = [
            f"{x:.3f}" if math.isfinite(x) else "not in time" for x in (r.recovery, r.settling)
        ]
        reported = "-" if math.isnan(r.reported) else f"{r.reported:g}"
        answer = {True: "yes", False: "no", None: "-"}[r.as_reported]
        rows.append((r.name, f"{r.disturbed_slip:.2e}", f"{r.slip_before:.2e}",
                     f"{r.saturated:.0%}", *taken, reported, answer))  # fmt: skip
    return (*table(head, rows, 1), "")


def _verdict(result: SimulationResult, reports: Sequence[ContactReport]) -> Iterable[str]:
    """What the paper reports, and whether contact physics gives it."""
    paper = result.scene.paper
    if "reports" not in paper:
        return
    yield f"The paper reports: {paper['reports']}."
    disturbed = [r for r in reports if not math.isnan(r.recovery)]
    timed = not math.isnan(disturbed[0].reported)
    recovered = all(r.as_reported if timed else math.isfinite(r.recovery) for r in disturbed)
    yield f"Here slip {'is' if recovered else 'is not'} rejected{' within that time' * timed}."
    if not recovered and all(r.settling <= r.reported for r in disturbed):
        yield (
            f"It is down to that of undisturbed rolling after "
            f"{max(r.settling for r in disturbed):.3f} s. Rolling itself slips in proportion to "
            "its speed, by the facets of the meshes and the length of the steps, and comes above "
            "the level compared with as the speed grows."
        )
    if "lateral_force" in paper:
        names = ", ".join(r.name for r in disturbed if r.saturates)
        peak = max(r.friction_peak for r in reports)
        happens = f"saturates at {names}" if names else "does not saturate"
        yield (
            f"Tangential force {happens}; its peak is {peak:.3f} N, the paper's limit "
            f"{paper['lateral_force']:g} N."
        )
