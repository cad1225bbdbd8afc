"""Command line: ``contact-system scenes | run | ...``, and commands of other packages.

A package adds a command by an entry point in the group ``contact_system.commands``, named like the
command. It loads to a function ``register(subparsers)``, which adds an argparse parser whose
default ``run`` is a function of the parsed arguments that returns the exit code. Such packages are
imported only for their command or for the help.

Exit codes: 0; 2 after a user's error, with one line on stderr; 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import io
import math
import sys
import tomllib
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from . import __version__, plots
from .checks import known_keys, naming
from .errors import ContactSystemError, SceneError
from .files import make_folder
from .measures import REJECTED, Rejection, great_circle_distance, is_dynamic, overlaps, rejections
from .plan import METHODS, Plan, plan
from .scene import Scene, bundled_scenes, load_scene, save_scene
from .scene.files import fields_of, refuse_degrees
from .steering import Goal, reach
from .terminal import Progress, paragraph, table, tell
from .theory.gain import LAWS, Gain

PROGRAM = "contact-system"
GROUP = "contact_system.commands"

Plans = dict[Plan, list[Rejection]]
"""Plans of one scene under different gain laws, each with the rejection of slip per contact."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program with these arguments, or those of the process; returns its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    if isinstance(sys.stdout, io.TextIOWrapper):  # names of scenes may be in any script
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        args = _parser(words).parse_args(words)
        return args.run(args)
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted", file=sys.stderr)
        return 130  # the shells' convention
    except (ContactSystemError, OSError) as error:
        print(f"{PROGRAM}: error: {error}", file=sys.stderr)
        return 2


def _parser(words: Sequence[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=PROGRAM, description="Plan the contact curves of fingers that roll on an object."
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    scene, planned, method, results = _common()
    scenes = commands.add_parser("scenes", help="list the bundled scenes")
    scenes.set_defaults(run=_scenes)

    text = "plan a scene, measure its slip, write and draw results"
    run = commands.add_parser("run", help=text, parents=[scene, planned, method, results])
    run.set_defaults(run=_run)

    text = "how the planner computes each interval, and why"
    explain = commands.add_parser("explain", help=text, parents=[scene, planned, method])
    explain.set_defaults(run=_explain)

    text = "find legs that take a scene's contacts to goals"
    steer = commands.add_parser("reach", help=text, parents=[scene, planned, results])
    text = 'a goal, such as "object_at = [2, 1]"; one --to for each contact, "" for one at rest'
    steer.add_argument("--to", action="append", required=True, metavar="GOAL", help=text)
    text = "seconds to search for a shorter route; default %(default)g"
    steer.add_argument("--seconds", type=float, default=0.0, metavar="X", help=text)
    steer.set_defaults(run=_reach)

    text = "a scene in the browser, with sliders"
    show = commands.add_parser("explore", help=text, parents=[scene])
    text = "port of the page; 0: any that is free; default %(default)d"
    show.add_argument("--port", type=_port, default=8080, metavar="N", help=text)
    text = "folder for scenes that are saved; default results/NAME"
    show.add_argument("--out", type=Path, metavar="DIR", help=text)
    show.set_defaults(run=_explore)

    if not words or words[0] not in (*commands.choices, "--version"):
        _add_foreign(commands, words)
    return parser


def _gain_parameters() -> Iterable[str]:
    return dict.fromkeys(law.parameter for law in LAWS.values())


def _common() -> list[argparse.ArgumentParser]:
    """Parsers of arguments that commands share: scene; gain and tolerance; method; results."""
    scene, planned, method, results = (argparse.ArgumentParser(add_help=False) for _ in range(4))
    scene.add_argument("scene", metavar="SCENE", help="name of a bundled scene, or a TOML file")
    planned.add_argument("--gain", choices=tuple(LAWS), help="gain law instead of the scene's")
    number = planned.add_mutually_exclusive_group()
    for name in _gain_parameters():
        laws = " or ".join(key for key, law in LAWS.items() if law.parameter == name)
        text = f"{name}, for the gain law {laws}; default: the number of the scene's own law"
        number.add_argument(f"--{name}", type=float, metavar="X", help=text)
    text = "error of contact points over the body's size; default %(default)g"
    planned.add_argument("--tolerance", type=float, default=1e-12, metavar="X", help=text)
    text = "auto: the cheapest exact way; chart: the paper's equations by scipy"
    method.add_argument("--method", choices=METHODS, default="auto", help=text)
    method.add_argument("--compiled", action="store_true", help=argparse.SUPPRESS)  # ignored
    text = "folder for the results; default results/NAME"
    results.add_argument("--out", type=Path, metavar="DIR", help=text)
    results.add_argument("--no-plots", action="store_true", help="draw no pictures")
    return [scene, planned, method, results]


def _add_foreign(commands: Any, words: Sequence[str]) -> None:
    """Add the requested command of another package; for the help, add all of them.

    The help says in one line why a command cannot be imported; requesting it raises that error.
    """
    points = entry_points(group=GROUP)
    for point in [p for p in points if words and p.name == words[0]] or points:
        try:
            point.load()(commands)
        except Exception as error:  # importing another package may raise anything
            reason = str(error).partition("\n")[0] or type(error).__name__
            remedy = f'; pip install "contact-system[{point.name}]"'
            hint = f"unavailable: {reason}{'' if 'pip install' in reason else remedy}"
            if words and words[0] == point.name:
                raise ContactSystemError(f"the command '{point.name}' is {hint}") from None
            if point.name not in commands.choices:
                commands.add_parser(point.name, help=hint.replace("%", "%%"))


# --- commands ----------------------------------------------------------------------------------


def _scenes(args: argparse.Namespace) -> int:
    scenes = bundled_scenes()
    width = max(map(len, scenes))
    tell(*(f"{name:{width}}  {description}" for name, description in scenes.items()))
    return 0


def _contraction(scene: Scene) -> list[str]:
    """An empty line and where slip shrinks under the scene's profile; none if all have legs."""
    legs_alone = all(contact.legs for contact in scene.contacts)
    return [] if legs_alone else ["", paragraph(str(scene.contraction()))]


def _explain(args: argparse.Namespace) -> int:
    scene = _scene_of(args)
    with Progress(1, "planning"):
        planned = plan(scene, args.tolerance, args.method)
    lines = (paragraph(line, "    ") for line in planned.explain().splitlines())
    tell(*lines, *_contraction(scene))
    return 0


def _run(args: argparse.Namespace) -> int:
    scene = _scene_of(args)
    with Progress(2, "planning") as progress:
        planned = plan(scene, args.tolerance, args.method)
        plans = {planned: rejections(planned)}
        progress.step("planning under another gain law")
        # the printed gain law misses the paper's reported times: show the one that may give them
        if scene.gain.law == "path" and any(r.as_reported is False for r in plans[planned]):
            scene = scene.replace(gain=Gain.time(scene.gain.value))
            other = plan(scene, args.tolerance, args.method)
            plans[other] = rejections(other)
    tell(*_report(plans))
    _write(args, results_folder(args, scene) / file_name(scene), *plans)
    return 0


def _reach(args: argparse.Namespace) -> int:
    scene = _scene_of(args)
    goals = [_goal(text) for text in args.to]
    for text, goal, contact in zip(args.to, goals, scene.contacts):
        with naming(f'--to "{text}"'):
            if goal is not None:
                refuse_degrees(goal, scene.object, contact.finger)
    name = f"{file_name(scene)}-reached"
    with Progress(2, "looking for legs") as progress:
        route = reach(scene, goals, seconds=args.seconds)
        progress.step("planning")
        planned = plan(route.scene.replace(name=name), args.tolerance)
    off = f"{route.residual:.1e} (in sizes, rad) off"
    tell(f"{scene.title}: {route.length:.6g} m in all, which end {off}")
    for i, legs in enumerate(route.legs):
        for k, leg in enumerate(legs):
            where = f"{scene.contact_name(i)}, leg {k + 1}"
            tell(f"{where}: direction {leg.direction:.9g} rad, length {leg.length:.9g} m")
    stem = results_folder(args, scene) / name
    save_scene(planned.scene, f"{stem}.toml")
    tell(f"wrote {stem}.toml")
    _write(args, stem, planned)
    return 0


def _explore(args: argparse.Namespace) -> int:
    scene = load_scene(args.scene)
    from .explorer.page import Explorer  # needs viser

    folder = args.out or Path("results") / file_name(scene)
    Explorer(scene, folder / f"{file_name(scene)}-explored.toml", args.port).run()
    return 0


def _port(text: str) -> int:
    if not (text.isdecimal() and int(text) < 65536):
        raise argparse.ArgumentTypeError(f"'{text}': give a number from 0 to 65535")
    return int(text)


def _goal(text: str) -> Goal | None:
    """A goal from the text of an inline table of TOML, with numbers as in a scene file."""
    with naming(f'--to "{text}"'):
        try:
            table = tomllib.loads(f"goal = {{ {text} }}")["goal"]
        except tomllib.TOMLDecodeError as error:
            raise SceneError(f'{error}; write it like "object_at = [2, 1]"') from None
        known_keys(table, Goal.__dataclass_fields__)
        return Goal(**fields_of(table)) if table else None


def _scene_of(args: argparse.Namespace) -> Scene:
    scene = load_scene(args.scene)
    law = args.gain or scene.gain.law
    taken, value = LAWS[law].parameter, scene.gain.value
    for name in _gain_parameters():
        number = getattr(args, name)
        if number is not None and name != taken:
            raise SceneError(
                f"{scene.title}: --{name} {number:g}: the gain law '{law}' takes {taken}; "
                f"give --{taken}, or another law with --gain"
            )
        value = value if number is None else number
    return scene.replace(gain=Gain(law, value))


def results_folder(args: argparse.Namespace, scene: Scene) -> Path:
    """The folder of --out, or results/NAME; made if it is missing."""
    folder = args.out or Path("results") / file_name(scene)
    return make_folder(folder, "name another one with --out")


def file_name(scene: Scene) -> str:
    """The scene's name made into a name for files, short enough for any file system."""
    name = "".join(c if c.isalnum() or c in "-_." else "-" for c in scene.name)
    name = name.encode()[:100].decode(errors="ignore").strip(".-")
    return name or "scene"


def _write(args: argparse.Namespace, stem: Path, shown: Plan, other: Plan | None = None) -> None:
    """Write and draw the results; print a line for each file, and one if times are left out."""
    times = shown.sample_times()
    regular = shown.regular_times(times)
    singular = np.setdiff1d(times, regular).tolist()
    lines = []
    if singular:
        which = f"{len(singular)} sample times from t = {singular[0]!r} to {singular[-1]!r} s"
        which = which if len(singular) > 1 else f"t = {singular[0]!r} s"
        lines = [f"left out of the files: {which}; at a pole or an umbilic there are no states"]
    draw = None if args.no_plots else partial(plots.plot, shown, other=other)
    tell(*lines, *written(stem, partial(shown.save, times=regular), draw))


def written(
    stem: Path, save: Callable[[Path], None], draw: Callable[[Path], None] | None
) -> list[str]:
    """Save results as .npz and .csv, and draw a .png; returns a line for each file."""
    lines = []
    with Progress(3, "writing") as progress:
        for suffix, following in ((".npz", "writing"), (".csv", "drawing")):
            path = stem.with_name(stem.name + suffix)
            save(path)
            lines.append(f"wrote {path}")
            progress.step(following)
        if draw is not None:
            path = stem.with_name(stem.name + ".png")
            try:
                draw(path)
                lines.append(f"wrote {path}")
            except plots.MissingMatplotlib as error:
                lines.append(f"no picture: {error}")
    return lines


# --- report ------------------------------------------------------------------------------------


def _report(plans: Plans) -> Iterable[str]:
    planned = next(iter(plans))
    scene = planned.scene
    yield paragraph(f"{scene.name or 'scene'}: {scene.description}".rstrip(": "))
    yield ""
    if any(r.peak > 0 for found in plans.values() for r in found):
        yield from _slip_table(plans)
        yield paragraph(
            "From: the end of the contact's last disturbance, or the start. Below "
            f"{REJECTED:.0%}: time from then until slip stays below {REJECTED:.0%} of its value "
            "then, or of its peak where it is zero then."
        )
        verdict = [paragraph(text) for text in _verdict(plans, scene)]
        yield from ("", *verdict, *_contraction(scene)[not verdict :])
    else:
        yield "No slip: every contact rolls or rests throughout."
    yield from (*_great_circles(planned), *map(paragraph, overlaps(planned)), "")


def _slip_table(plans: Plans) -> Iterable[str]:
    """Slip of every contact, a table for each law."""
    head = [("contact", ""), ("start", "m/s"), ("peak", "m/s"), ("at", "s"), ("end", "m/s")]
    head += [("from", "s"), (f"below {REJECTED:.0%}", "s"), ("paper", "s"), ("as reported", "")]
    if not any(r.reported > 0 for found in plans.values() for r in found):  # no paper's scene
        head = head[:-2]
    for planned, found in plans.items():
        yield f"gain {plots.gain_text(planned.scene.gain)}:"
        rows = [_slip_row(planned, r)[: len(head)] for r in found]
        yield from (*table(head, rows), "")


def _slip_row(planned: Plan, r: Rejection) -> tuple[str, ...]:
    start = r.start if r.start > 1e-16 * r.peak else 0.0  # less is rounding
    slip = f"{start:.3e}", f"{r.peak:.3e}", f"{r.peak_time:.3f}", f"{r.end:.3e}"
    timing = ("-", "-", "-", "-")
    if not math.isnan(r.time):
        taken = f"{r.time:.4f}" if math.isfinite(r.time) else f"> {planned.end - r.since:g}"
        reported = "-" if math.isnan(r.reported) else f"{r.reported:g}"
        answer = {True: "yes", False: "no", None: "-"}[r.as_reported]
        timing = f"{r.since:g}", taken, reported, answer
    return planned.scene.contact_name(r.contact), *slip, *timing


def _verdict(plans: Plans, scene: Scene) -> Iterable[str]:
    """What the paper reports, and whether the gain laws reproduce it."""
    if "reports" not in scene.paper:
        return
    yield f"The paper reports: {scene.paper['reports']}."
    if is_dynamic(scene):
        yield (
            "That is a dynamic simulation. A plan has no contact physics: slip by an object rate "
            "offset ends together with the offset, so there is no time to compare."
        )
        return
    for planned, found in plans.items():
        slipping = [r for r in found if not math.isnan(r.time)]
        if not slipping:
            continue
        compared = any(r.as_reported is not None for r in slipping)
        same = all(r.as_reported if compared else math.isfinite(r.time) for r in slipping)
        gain = planned.scene.gain
        yield (
            f"Gain law '{gain.law}' with {gain.parameter} = {gain.value:g} "
            f"{'reproduces' if same else 'does not reproduce'} that{' time' * compared}."
        )


def _great_circles(plan: Plan) -> Iterable[str]:
    """How far the curves of fingers with imposed rolling are from great circles."""
    for i, contact in enumerate(plan.scene.contacts):
        if contact.follows and contact.finger.chart.great_circles:
            points = plan.points(plan.sample_times())[:, i, 0]
            distance = float(np.abs(great_circle_distance(points)).max())
            yield paragraph(
                f"{plan.scene.contact_name(i)}: its curve stays within {distance:.1e} m of a great "
                f"circle's plane, {distance / contact.finger.size:.1e} of the radius."
            )
