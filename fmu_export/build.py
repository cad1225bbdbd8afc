"""The libraries of FMUs: the engine with FMI around it, for each platform."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

from contact_system.checks import items_of, make_folder
from contact_system.engine.binding import LIBRARY
from contact_system.engine.platforms import FLAGS, PLATFORMS, Platform, shared
from contact_system.errors import ContactSystemError

_WASM = (
    *("-mexec-model=reactor", "-s", "-msimd128", "-Wl,--export-dynamic"),
    *("-Wl,--export=malloc", "-Wl,--export=free"),
    # longjmp, by exceptions as WebAssembly has them now
    *("-mexception-handling", "-mllvm", "-wasm-enable-sjlj"),
    *("-mllvm", "-wasm-use-legacy-eh=false"),
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

    This machine's was built when the package was installed; others are built by ziglang and kept.
    """
    row = _platform(target)
    if target == "native":
        return LIBRARY.read_bytes()
    if not importlib.util.find_spec("ziglang"):
        raise ContactSystemError(
            f"no compiler for {target}: `pip install ziglang`, which compiles for all platforms"
        )
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", row.target]
    linked = _WASM if row.suffix == ".wasm" else shared(row.suffix)
    command = [*compiler, *FLAGS, "-DVARIANT=baseline", "-Wno-pass-failed", *linked]
    command += [f"-I{ENGINE}", *map(str, UNITS)]

    def make(room: Path) -> Path:
        built = room / f"{LONG_NAME}{row.suffix}"
        run = subprocess.run(
            [*command, "-o", built.name, "-lm"],
            cwd=room,
            capture_output=True,
            text=True,
            errors="replace",
        )
        if run.returncode:
            raise ContactSystemError(f"{' '.join(command)} failed:\n{run.stderr[-2000:]}")
        return built

    found = _kept("\0".join([*command, *texts().values()]), make)
    # A Windows library carries its name, and programs that are linked with it look for that one.
    own, given = (f"{stem}.dll".encode() for stem in (LONG_NAME, name))
    return found.replace(own, given.ljust(len(own), b"\0")) if row.suffix == ".dll" else found


LONG_NAME = "contact_engine".ljust(110, "_")
"""Longer than a model's."""


@functools.cache
def texts() -> dict[Path, str]:
    """The C of the engine and its FMI layer, by file."""
    folders = (ENGINE, ENGINE / "generated", C_FOLDER)
    files = [file for folder in folders for file in sorted(folder.glob("*.[chi]*"))]
    return {file: file.read_text("utf-8") for file in files}


# --- the cache -----------------------------------------------------------------------------------

_REMEDY = "set CONTACT_SYSTEM_CACHE to a folder that can be written to"


def cache_folder() -> Path:
    """``$CONTACT_SYSTEM_CACHE``, or ``~/.cache/contact_system``."""
    chosen = os.environ.get("CONTACT_SYSTEM_CACHE")
    try:
        return Path(chosen).absolute() if chosen else Path.home() / ".cache" / "contact_system"
    except RuntimeError:  # as some users of containers
        raise ContactSystemError(f"this user has no home folder; {_REMEDY}") from None


def _kept(key: str, make: Callable[[Path], Path]) -> bytes:
    """A library that was built before under this key, or that is made now in a folder.

    It is kept behind its digest; one that does not fit that, as after a full disk, is made again.
    """
    folder = cache_folder()
    file = folder / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.fmulib"
    _refuse_open(folder)
    with contextlib.suppress(OSError):
        digest, found = (kept := file.read_bytes())[:32], kept[32:]
        if hashlib.sha256(found).digest() == digest:
            return found
    make_folder(folder, _REMEDY).chmod(0o700)
    try:
        with tempfile.TemporaryDirectory(dir=folder) as room:
            found = make(Path(room)).read_bytes()
            (part := Path(room, "part")).write_bytes(hashlib.sha256(found).digest() + found)
            os.replace(part, file)  # atomic: a second process never sees half a file
    except OSError as error:
        raise ContactSystemError(f"cache folder '{folder}': {error}; {_REMEDY}") from None
    return found


def _refuse_open(folder: Path) -> None:
    """Refuse a folder in which others may put libraries."""
    try:
        found = folder.stat()
    except OSError:
        return  # it is made for this user alone
    if os.name == "posix" and (found.st_mode & 0o022 or found.st_uid != os.getuid()):
        raise ContactSystemError(
            f"cache folder '{folder}' can be written to by others, who might put libraries there; "
            f"`chmod go-w '{folder}'`, or {_REMEDY}"
        )
