"""The command ``contact-system drake``: simulate a scene with contact physics, and report on it."""

from __future__ import annotations

import argparse
import math
import tomllib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contact_system import SceneError, load_scene
from contact_system.cli import file_name, results_folder, written
from contact_system.measures import REJECTED
from contact_system.terminal import Progress, paragraph, table, tell

# Drake takes a second to import, so functions import what needs it: `contact-system --help` is fast
if TYPE_CHECKING:
    from .hand_kinematics import Chains
    from .measures import ContactReport, HandReport
    from .simulation import HandResult, SimulationResult

TICKS = 1000  # of the progress bar


def register(commands: Any) -> None:
    """Add the command to an argparse parser's subparsers (see :mod:`contact_system.cli`)."""
    parser = commands.add_parser("drake", help="simulate a scene in Drake, with contact physics")
    parser.add_argument("scene", metavar="SCENE", help="name of a bundled scene, or a TOML file")
    out = "folder for the results; default results/NAME"
    parser.add_argument("--out", type=Path, metavar="DIR", help=out)
    until = "stop after so many seconds instead of the scene's duration"
    parser.add_argument("--until", type=float, metavar="T", help=until)
    change = "any key of the scene's [drake] table for this run, such as drake.friction=0.3"
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=change)
    parser.add_argument("--no-recording", action="store_true", help="write no film")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate a scene, print tables, and write files; returns the exit code."""
    from .config import StationConfig
    from .plots import plot
    from .simulation import simulate

    scene = load_scene(args.scene)
    config = StationConfig.from_scene(scene, **dict(map(_setting, args.set)))
    stem = results_folder(args, scene) / f"{file_name(scene)}-drake"
    recording = None if args.no_recording else stem.with_name(f"{stem.name}.html")
    duration = scene.duration if args.until is None else args.until
    with Progress(TICKS, "building") as progress:

        def advance(t: float) -> None:
            progress.name = f"simulating, t = {t:.2f} s of {duration:g} s"
            progress.done = int(TICKS * min(1.0, t / duration))

        result = simulate(scene, config, duration, progress=advance, recording=recording)
        opened = None
        # pushes are compared with those of the open loop, in a table that hands do not have
        if config.pushes and config.closed_loop and config.hand is None:
            opened = simulate(scene, config.opened(), duration, progress=advance)
    try:
        tell(*_printed(result, opened))
    finally:  # logs are written also if nothing can be printed
        tell(*written(stem, result.save, partial(plot, result, opened=opened)))
    if recording is not None:
        tell(f"wrote {recording}")
    return 0


def _setting(text: str) -> tuple[str, Any]:
    """The key and the value in ``drake.friction=0.3``; the value as in TOML, or a word."""
    key, equals, value = text.partition("=")
    table, _, name = key.strip().partition(".")
    if not equals or table != "drake" or not name:
        raise SceneError(f"--set {text}: write it like drake.friction=0.3")
    for read in (lambda: tomllib.loads(f"value = {value}")["value"], lambda: float(value)):
        with suppress(ValueError):  # TOML takes 0.3, but not .3
            return name, read()
    return name, value.strip()


# --- what is printed ---------------------------------------------------------------------------


def _printed(result: SimulationResult, opened: SimulationResult | None) -> Iterable[str]:
    from .measures import EDGE, SATURATED, contact_table
    from .simulation import HandResult

    scene, config = result.scene, result.config
    yield paragraph(f"{scene.name or 'scene'}: {scene.description}".rstrip(": "))
    steps = f"step {config.time_step:g} s" if config.time_step else "continuous plant"
    yield paragraph(
        f"{config.contact_model} contact, {steps}: "
        f"{result.t[-1] - result.t[0]:g} s simulated in {result.wall_time:.1f} s, "
        f"{(result.t[-1] - result.t[0]) / result.wall_time:.2f} times real time; "
        f"built in {result.build_time:.1f} s"
    )
    yield ""
    if isinstance(result, HandResult):
        yield from _hand(result)
        return
    reports = contact_table(result)
    yield from _forces(reports)
    yield from _explained(
        f"Normal force: excluding {EDGE:g} s after the start and around a disturbance's edges. "
        "Peak over mu N: with the normal force of the same moment. Friction and slip in rolling, "
        "distance from the planned contact point: before any disturbance."
    )
    yield paragraph(" ".join(_happened(result, reports)))
    yield ""
    if any(r.disturbed for r in reports):
        yield from _rejections(reports)
        yield from _explained(
            "Of each contact, its last disturbance that is over. "
            "Recovery: time from the disturbance's end until slip stays below "
            f"{REJECTED:.0%} of its mean while disturbed, or below its greatest before, where that "
            "is more. Saturated: part of the disturbance with friction above "
            f"{SATURATED:.0%} of mu N. Held: friction stayed below its limit in it, so there was "
            "no slip to reject. Not kept: another finger came off, or the object falls."
        )
    elif scene.disturbances:
        yield from _explained(
            "No disturbance is over by the end, so that no rejection is measured."
        )
    if not scene.disturbances or any(r.disturbed for r in reports):
        yield from _paper(result, reports)
    if result.config.pushes:
        yield from _pushes(result, opened)


def _explained(text: str) -> Iterable[str]:
    return (paragraph(text), "")


def _happened(result: SimulationResult, reports: Sequence[ContactReport]) -> Iterable[str]:
    """What happened to the object and to contacts, so far as the table does not show it."""
    from .measures import LATELY, object_report

    found = object_report(result)
    yield f"The object moved by {found.moved:.3g} m and turned by {math.degrees(found.turned):.3g}"
    yield "degrees."
    if found.falls:
        time = min(LATELY, result.t[-1])
        yield f"It falls: {max(found.carried, 0.0):.0%} of its weight is carried"
        yield f"in the last {time:g} s,"
        yield "though forces balance it." if result.config.balances else "and nothing balances it."
    elif not math.isnan(found.carried):
        yield "Its weight is carried by the fingers."
    if result.config.balances:
        planned, used = (part["friction_used"] for part in (result.planned, result.measured))
        most = np.nanmax(used, initial=0.0)
        yield f"Balancing forces use at most {planned.max():.0%} of the friction cones as planned,"
        yield f"{most:.0%} as measured."
    for r in reports:
        if r.time_off:
            yield f"{r.name} was off the object for {r.time_off:.3g} s."
        if r.astray:
            yield f"{r.name} is astray: up to {r.distance:.3g} m from where it is planned,"
            yield f"on a path of {r.path:.3g} m."
    if slips := [r for r in reports if r.plan_slip_time]:
        time, most = (
            max(getattr(r, key) for r in slips) for key in ("plan_slip_time", "planned_slip")
        )
        yield f"The plan itself slips at {', '.join(r.name for r in slips)}, for {time:.3g} s and"
        yield f"by {most:.2g} m/s at most, which is not counted as rolling."


def _forces(reports: Sequence[ContactReport]) -> Iterable[str]:
    field = partial(_of_each, reports)
    return _table(
        ("contact", "", field("name"), "s"),
        ("normal force", "N", field("normal_mean"), ".4f"),
        ("normal std", "N", field("normal_deviation"), ".4f"),
        ("off object", "s", field("time_off"), ".3f"),
        ("peak friction", "N", field("friction_peak"), ".3f"),
        ("over mu N", "", field("friction_ratio"), ".3f"),
        ("in rolling", "N", field("rolling_friction"), ".3f"),
        ("slip over speed", "", field("rolling_slip"), ".1e"),
        ("distance", "mm", 1e3 * field("distance"), ".3f"),
    )


def _rejections(reports: Sequence[ContactReport]) -> Iterable[str]:
    field = partial(_of_each, [r for r in reports if r.disturbed])
    return _table(
        ("contact", "", field("name"), "s"),
        ("slip disturbed", "m/s", field("disturbed_slip"), ".2e"),
        ("greatest before", "m/s", field("slip_before"), ".2e"),
        ("saturated", "", field("saturated"), ".0%"),
        ("recovery", "s", field("recovery"), ".3f"),
        ("paper", "s", field("reported"), "g"),
        ("verdict", "", field("verdict"), "s"),
    )


def _of_each(reports: Sequence[Any], key: str) -> NDArray[Any]:
    return np.array([getattr(report, key) for report in reports])


def _table(*columns: tuple[str, str, Iterable[Any], str]) -> Iterable[str]:
    """A table of columns, each a name, a unit, values and their format."""
    head = [(name, unit) for name, unit, _, _ in columns]
    cells = [[_cell(form, x) for x in values] for _, _, values, form in columns]
    return (*table(head, list(zip(*cells))), "")


def _cell(form: str, value: Any) -> str:
    if value == math.inf:
        return "not seen"
    return "-" if value != value else format(value, form)


def _hand(result: HandResult) -> Iterable[str]:
    from .measures import angles_between, durations, hand_report

    report, plan, scene = hand_report(result), result.plan, result.scene
    force = np.average(result.measured["normal_force"], axis=0, weights=durations(result))
    spin = np.abs(np.trapezoid(plan.spin, plan.t, axis=0))
    yield from _table(
        ("finger", "", [scene.contact_name(i) for i in range(len(force))], "s"),
        ("normal force", "N", force, ".3f"),
        ("cone planned", "", report.cones_planned, ".1%"),
        ("cone measured", "", report.cones, ".1%"),
        ("slip", "mm", 1e3 * report.slipped, ".3f"),
        ("off object", "s", report.time_off, ".3f"),
        ("spin", "degrees", np.degrees(spin), ".1f"),
    )
    goal = math.degrees(angles_between(*plan.object_pose[[0, -1]]))
    yield paragraph(
        f"The object is to turn by {goal:.3g} degrees. At the end it is "
        f"{1e3 * report.off[-1]:.3g} mm and {math.degrees(report.turned_off[-1]):.3g} degrees from "
        "where it is to be then; on the way it was off its path by "
        f"{1e3 * report.off.max():.3g} mm and "
        f"{math.degrees(report.turned_off.max()):.3g} degrees at most."
    )
    yield paragraph(_of_joints(plan.chains, report))
    yield ""
    yield from _explained(
        "Cone: part of the friction cone that is used, measured outside pushes and 0.1 s after. "
        "Slip: summed. Spin: how far the plan turns the finger about the normal, which point "
        "contact does not resist."
    )


def _of_joints(chains: Chains, report: HandReport) -> str:
    k, j = int(np.argmax(report.torque_share)), int(np.argmin(report.room / chains.unit))
    torques = f"{report.torque_share[k]:.0%} of the limit at most, at {chains.names[k]}"
    if not np.isfinite(chains.effort).any():
        torques = "without limits, as the model has no actuators"
    near = f"{math.degrees(report.room[j]):.3g} degrees"
    if chains.slides[j]:
        near = f"{1e3 * report.room[j]:.3g} mm"
    return f"Torques: {torques}. Joints: {chains.names[j]} comes to {near} from a limit."


def _pushes(result: SimulationResult, opened: SimulationResult | None) -> Iterable[str]:
    """What pushes did, with the loop closed, if it is, and open."""
    from .measures import push_table

    loops = {"closed" if result.config.closed_loop else "open": push_table(result)}
    if opened is not None:
        loops["open"] = push_table(opened)
    rows = [(loop, r) for reports in zip(*loops.values()) for loop, r in zip(loops, reports)]
    if not rows:
        yield from _explained("No push has begun by the end.")
        return
    reports = [r for _, r in rows]
    field = partial(_of_each, reports)
    yield from _table(
        ("push on", "", [r.push.on for r in reports], "s"),
        ("from", "s", [r.push.start for r in reports], "g"),
        ("for", "s", [r.push.stop - r.push.start for r in reports], ".3g"),
        ("force", "N", [math.hypot(*r.push.force) for r in reports], ".3g"),
        ("loop", "", [loop for loop, _ in rows], "s"),
        ("slip", "mm", 1e3 * field("slip"), ".3f"),
        ("off", "ms", 1e3 * field("time_off"), ".3f"),
        ("farthest", "mm", 1e3 * field("farthest"), ".3f"),
        ("left", "mm", 1e3 * field("left"), ".3f"),
    )
    yield from _explained(
        "Slip: summed while the finger touches, until the next push begins. Farthest, left: of the "
        "contact point from the one planned at first, at most and when the next push begins. Of a "
        "push on the object: of the worst contact."
    )


def _paper(result: SimulationResult, reports: Sequence[ContactReport]) -> Iterable[str]:
    """What the paper reports, to compare with the verdicts."""
    paper = result.scene.paper
    if "reports" not in paper:
        return
    yield paragraph(f"The paper reports: {paper['reports']}.")
    if "lateral_force" in paper:
        names = ", ".join(r.name for r in reports if r.saturated > 0)
        happens = f"saturates at {names}" if names else "does not saturate"
        peak = max(r.friction_peak for r in reports)
        yield paragraph(
            f"Tangential force {happens}; its peak is {peak:.3f} N, the paper's limit "
            f"{paper['lateral_force']:g} N."
        )
    yield ""
