"""The command ``contact-system fmu``: a scene as a Functional Mock-up Unit."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from contact_system import ContactSystemError, load_scene
from contact_system.cli import file_name
from contact_system.terminal import Progress, tell

from .build import PLATFORMS
from .description import INTERFACES, VERSIONS
from .export import export_fmu
from .reference import check_fmu
from .variables import MEASUREMENTS


def register(commands: Any) -> None:
    """Add the command to an argparse parser's subparsers (see :mod:`contact_system.cli`)."""
    parser = commands.add_parser("fmu", help="write a scene as an FMU, for FMI 2.0 or 3.0")
    parser.add_argument("scene", metavar="SCENE", help="name of a bundled scene, or a TOML file")
    parser.add_argument("-o", "--out", type=Path, metavar="FILE", help="default NAME.fmu")
    parser.add_argument(
        "--fmi", choices=VERSIONS, default="2.0", help="version of FMI; default %(default)s"
    )
    parser.add_argument(
        "--interfaces",
        nargs="+",
        choices=INTERFACES,
        default=INTERFACES,
        metavar="INTERFACE",
        help=f"one or more of {', '.join(INTERFACES)}; default both",
    )
    parser.add_argument(
        "--platforms",
        nargs="+",
        default=["native"],
        metavar="PLATFORM",
        help=f"native (default), or one or more of {', '.join(PLATFORMS)}, built by ziglang",
    )
    parser.add_argument("--arrays", action="store_true", help="FMI 3: vectors, not scalars")
    parser.add_argument(
        "--measured",
        choices=MEASUREMENTS,
        default="nothing",
        help="add inputs for measured states, or pose and twist, from which contacts go on",
    )
    parser.add_argument(
        "--check", action="store_true", help="run the file against the results inside it"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Export, say what was written; returns the exit code."""
    scene, began = load_scene(args.scene), time.monotonic()
    if args.check and "CoSimulation" not in args.interfaces:
        raise ContactSystemError("--check runs Co-Simulation: add it to --interfaces")
    path = args.out or Path(f"{file_name(scene)}.fmu")
    with Progress(1 + len(args.platforms), "writing the sources") as progress:
        chosen = (args.fmi, args.interfaces, args.platforms, progress.step)
        export_fmu(scene, path, *chosen, args.arrays, args.measured)
    if args.check:
        tell(f"{path} is within {check_fmu(path):.1e} of its reference results")
    tell(
        f"wrote {path}: {path.stat().st_size / 1000:.0f} kB, FMI {args.fmi}, "
        f"{' and '.join(args.interfaces)}, for {', '.join(args.platforms)}; "
        f"{time.monotonic() - began:.1f} s"
    )
    return 0
