"""The libraries of FMUs: the engine with FMI around it, for each platform."""

from __future__ import annotations

import functools
import importlib.util
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from contact_system.checks import items_of
from contact_system.engine.binding import LIBRARY
from contact_system.errors import ContactSystemError


class Platform(NamedTuple):
    """Folders in FMI 2 and FMI 3, a library's suffix, ziglang's name of the target, its flags."""

    folder_2: str
    folder_3: str
    suffix: str
    target: str
    flags: tuple[str, ...]


_LINUX = (
    "-shared",
    "-s",
    "-fPIC",
    "-Wl,-Bsymbolic",
)  # its own engine, whatever another FMU exports
_WINDOWS = ("-shared", "-s")
_MAC = ("-shared", "-fPIC", "-Wl,-install_name,@rpath/contact_engine.dylib")
_WASM = (
    *("-mexec-model=reactor", "-s", "-msimd128", "-Wl,--export-dynamic"),
    *("-Wl,--export=malloc", "-Wl,--export=free"),
    # longjmp, by exceptions as WebAssembly has them now
    *("-mexception-handling", "-mllvm", "-wasm-enable-sjlj"),
    *("-mllvm", "-wasm-use-legacy-eh=false"),
)
PLATFORMS = {
    "x86_64-linux": Platform("linux64", "x86_64-linux", ".so", "x86_64-linux-gnu.2.17", _LINUX),
    "aarch64-linux": Platform(*("aarch64-linux",) * 2, ".so", "aarch64-linux-gnu.2.17", _LINUX),
    "x86_64-windows": Platform("win64", "x86_64-windows", ".dll", "x86_64-windows-gnu", _WINDOWS),
    "x86_64-darwin": Platform("darwin64", "x86_64-darwin", ".dylib", "x86_64-macos.11.0", _MAC),
    "aarch64-darwin": Platform(*("aarch64-darwin",) * 2, ".dylib", "aarch64-macos.11.0", _MAC),
    "wasm32": Platform(*("wasm32-wasi",) * 2, ".wasm", "wasm32-wasi", _WASM),
}

# Contraction to fused operations would make platforms differ in the last digits.
FLAGS = (
    *("-std=gnu99", "-O3", "-fvisibility=hidden", "-ffp-contract=off", "-DVARIANT=baseline"),
    *("-fno-math-errno", "-fno-trapping-math", "-fopenmp-simd", "-Wno-pass-failed"),
)
ENGINE, C_FOLDER = LIBRARY.parent, Path(__file__).parent / "c"
UNITS = (ENGINE / "engine.c", ENGINE / "dispatch.c", C_FOLDER / "fmi2.c", C_FOLDER / "fmi3.c")


def native_platform() -> str:
    """The name of this machine's platform in `PLATFORMS`."""
    machine = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
    system = {"linux": "linux", "win32": "windows", "darwin": "darwin"}
    found = f"{machine.get(platform.machine().lower())}-{system.get(sys.platform)}"
    if found not in PLATFORMS:
        raise ContactSystemError(
            f"this machine ({platform.machine()}, {sys.platform}) is none of the platforms FMUs "
            f"are built for here; name one of {', '.join(PLATFORMS)}"
        )
    return found


def _platform(target: str) -> Platform:
    """The row of `PLATFORMS`."""
    if target != "native" and target not in PLATFORMS:
        known = ", ".join(["native", *PLATFORMS])
        raise ContactSystemError(f"platform {target!r} is unknown; use one of {known}")
    return PLATFORMS[native_platform() if target == "native" else target]


def chosen(platforms: Iterable[str]) -> tuple[str, ...]:
    """The platforms asked for; or an error that says what they are instead."""
    found = items_of(platforms)
    if not found:
        raise ContactSystemError(
            f'platforms = {platforms!r}: give a list of at least one, such as ("native",)'
        )
    return found


def library_place(name: str, target: str, fmi_version: str) -> str:
    """Where a platform's library lies inside the FMU."""
    row = _platform(target)
    return f"binaries/{row.folder_2 if fmi_version == '2.0' else row.folder_3}/{name}{row.suffix}"


def library(target: str, name: str) -> bytes:
    """The engine with its FMI layer for a platform, under a model's name.

    This machine's was built when the package was installed; others are built by ziglang, which
    keeps what it has built.

    Raises
    ------
    ContactSystemError
        An unknown platform, no ziglang, or what ziglang says is wrong.
    """
    row = _platform(target)
    if target == "native":
        return LIBRARY.read_bytes()
    # A Windows library carries its name, and programs that are linked with it look for that one.
    own, given = (f"{stem}.dll".encode() for stem in (LONG_NAME, name))
    found = _built(row)
    return found.replace(own, given.ljust(len(own), b"\0")) if row.suffix == ".dll" else found


LONG_NAME = "contact_engine".ljust(110, "_")
"""Longer than a model's."""


@functools.cache
def _built(row: Platform) -> bytes:
    if not importlib.util.find_spec("ziglang"):
        raise ContactSystemError(
            f"no compiler for {row.target}: `pip install ziglang`, which compiles for all platforms"
        )
    command = [sys.executable, "-m", "ziglang", "cc", "-target", row.target, *FLAGS, *row.flags]
    command += [f"-I{ENGINE}", *map(str, UNITS), "-o", f"{LONG_NAME}{row.suffix}", "-lm"]
    with tempfile.TemporaryDirectory(prefix="contact-system-") as room:
        run = subprocess.run(command, cwd=room, capture_output=True, text=True, errors="replace")
        if run.returncode:
            raise ContactSystemError(f"{' '.join(command)} failed:\n{run.stderr[-2000:]}")
        return (Path(room) / command[-2]).read_bytes()


@functools.cache
def texts() -> dict[Path, str]:
    """The C of the engine and its FMI layer, by file."""
    folders = (ENGINE, ENGINE / "generated", C_FOLDER)
    files = [file for folder in folders for file in sorted(folder.glob("*.[chi]*"))]
    return {file: file.read_text("utf-8") for file in files}
