"""C sources to shared libraries, and everything into one .fmu file."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import platform
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import fmpy

from contact_system.checks import a_path, items_of, make_folder
from contact_system.engine.binding import LIBRARY
from contact_system.errors import ContactSystemError
from contact_system.writing import writing

FMI_HEADERS = Path(fmpy.__file__).parent / "c-code"

# name -> (folder in FMI 2, folder in FMI 3, suffix, target of ziglang)
PLATFORMS = {
    "x86_64-linux": ("linux64", "x86_64-linux", ".so", "x86_64-linux-gnu.2.17"),
    "aarch64-linux": ("aarch64-linux", "aarch64-linux", ".so", "aarch64-linux-gnu.2.17"),
    "x86_64-windows": ("win64", "x86_64-windows", ".dll", "x86_64-windows-gnu"),
    "x86_64-darwin": ("darwin64", "x86_64-darwin", ".dylib", "x86_64-macos.11.0"),
    "aarch64-darwin": ("aarch64-darwin", "aarch64-darwin", ".dylib", "aarch64-macos.11.0"),
}

# Contraction to fused operations would make platforms differ in the last digits.
FLAGS = (
    *("-std=gnu99", "-O3", "-fvisibility=hidden", "-ffp-contract=off"),
    *("-fno-math-errno", "-fno-trapping-math", "-fopenmp-simd"),
)
ENGINE, C_FOLDER = LIBRARY.parent, Path(__file__).parent / "c"
LINK_FLAGS = ("-shared", "-s")


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


def _platform(target: str) -> tuple[str, str, str, str]:
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


# --- compiler and cache --------------------------------------------------------------------------


@functools.cache
def find_compiler() -> tuple[str, ...] | None:
    """The command of a C compiler: ``$CC``, cc, gcc, clang, or the ziglang package; else None."""
    named = os.environ.get("CC", "").split()
    for name, *options in [*([named] if named else []), ["cc"], ["gcc"], ["clang"]]:
        path = shutil.which(name)
        if path:
            return (path, *options)
    try:
        import ziglang  # noqa: F401
    except ImportError:
        return None
    return (sys.executable, "-m", "ziglang", "cc")


# Where users' caches are: the variable that names the folder, and what it is below their homes.
_CACHES = {"win32": ("LOCALAPPDATA", "AppData", "Local"), "darwin": ("", "Library", "Caches")}
_REMEDY = "set CONTACT_SYSTEM_CACHE to a folder that can be written to"


def cache_folder() -> Path:
    """Where built libraries are kept: ``$CONTACT_SYSTEM_CACHE`` or the user's cache folder.

    Raises
    ------
    ContactSystemError
        The user has no home folder, as some users of containers.
    """
    chosen = os.environ.get("CONTACT_SYSTEM_CACHE")
    if chosen:
        return Path(chosen).absolute()  # a bare file name would be sought among the system's
    variable, *below = _CACHES.get(sys.platform, ("XDG_CACHE_HOME", ".cache"))
    base = Path(os.environ.get(variable, ""))
    if not base.is_absolute():  # XDG has it ignored then
        try:
            base = Path.home().joinpath(*below)
        except RuntimeError:
            raise ContactSystemError(f"this user has no home folder; {_REMEDY}") from None
    return base / "contact_system"


@contextlib.contextmanager
def _cache_room() -> Iterator[Path]:
    """A folder in the cache's, for the time in which a file is made that goes there."""
    folder = make_folder(cache_folder(), _REMEDY)
    folder.chmod(0o700)
    try:
        with tempfile.TemporaryDirectory(dir=folder) as room:
            yield Path(room)
    except OSError as error:
        raise ContactSystemError(f"cache folder '{folder}': {error}; {_REMEDY}") from None


def headers(fmi_version: str) -> dict[str, str]:
    """Name -> text of FMI's own headers, which fmpy brings."""
    names = {
        "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
        "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
    }[fmi_version]
    return {name: (FMI_HEADERS / name).read_text("utf-8") for name in names}


def _kept(key: str, make: Callable[[Path], Path]) -> bytes:
    """A library that was built before under this key, or that is made now in a folder.

    It is kept beside its digest; one that does not fit that, as after a full disk, is made again.
    """
    folder, name = cache_folder(), hashlib.sha256(key.encode()).hexdigest()[:24]
    file, digest = (folder / f"{name}{end}" for end in (".fmulib", ".sha256"))
    _refuse_open(folder)
    with contextlib.suppress(OSError):
        found = file.read_bytes()
        if hashlib.sha256(found).hexdigest() == digest.read_text():
            return found
    with _cache_room() as room:
        built = make(room)
        found = built.read_bytes()
        (room / "digest").write_text(hashlib.sha256(found).hexdigest())
        os.replace(room / "digest", digest)
        os.replace(built, file)  # atomic: a second process never sees half a file
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


def engine(target: str, name: str) -> bytes:
    """The engine with its FMI layer for a platform: that of every FMU.

    This machine's was built when the package was installed; others are built by ziglang and kept.

    Raises
    ------
    ContactSystemError
        An unknown platform, no ziglang, or a cache folder that cannot be written to, or by others.
    """
    if target == "native":
        native_platform()
        return _named(LIBRARY.read_bytes(), LIBRARY.name, name)
    folders = (ENGINE, ENGINE / "generated", C_FOLDER)
    texts = [
        p.read_text("utf-8")
        for f in folders
        for p in sorted(f.glob("*.[chi]*"))
        if p.suffix != ".py"
    ]
    command = [*_command(OWN_NAME, target), f"-I{ENGINE}", "-DVARIANT=baseline"]
    suffix = _platform(target)[2]
    units = [ENGINE / "engine.c", ENGINE / "dispatch.c", C_FOLDER / "fmi2.c", C_FOLDER / "fmi3.c"]

    def make(room: Path) -> Path:
        built = room / f"{OWN_NAME}{suffix}"
        _run([*command, *map(str, units), "-o", built.name, "-lm"], room)
        return built

    return _named(_kept("\0".join([*command, *texts]), make), OWN_NAME + suffix, name)


OWN_NAME = "contact_engine".ljust(110, "_")


def _named(library: bytes, own: str, name: str) -> bytes:
    """A library under another name, which a Windows one carries: programs look for that one."""
    if not own.endswith(".dll"):
        return library
    return library.replace(f"{own}\0".encode(), f"{name}.dll\0".encode().ljust(len(own) + 1, b"\0"))


def library(sources: Mapping[str, str], identifier: str, target: str) -> bytes:
    """The shared library of some sources for one platform; built once, kept in the cache.

    Parameters
    ----------
    sources : mapping
        File name -> text, headers included.
    identifier : str
        Model identifier.
    target : str
        A key of `PLATFORMS`, or "native".

    Raises
    ------
    ContactSystemError
        An unknown platform, no compiler, one that refuses, or a cache folder that cannot be
        written to, or by others.
    """
    command = _command(identifier, target)

    def make(room: Path) -> Path:
        for file, content in sources.items():
            (room / file).write_text(content, "utf-8")
        # A Windows library carries the name it is linked under, and programs look for that one.
        built = room / f"{identifier}{_platform(target)[2]}"
        names = sorted(file for file in sources if file.endswith(".c"))
        _run([*command, *names, "-o", built.name, "-lm"], room)
        return built

    return _kept(
        "\0".join([identifier, *command, *(f"{k}\0{sources[k]}" for k in sorted(sources))]), make
    )


def _run(command: Sequence[str], folder: Path) -> None:
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace")
    if run.returncode:
        raise ContactSystemError(f"{' '.join(command)} failed:\n{run.stderr[-2000:]}")


def _command(name: str, target: str) -> list[str]:
    """The compiler and its flags for a platform."""
    host = native_platform() if target == "native" else None
    _, _, suffix, triple = _platform(target)
    link = LINK_FLAGS[: 1 if suffix == ".dylib" else 2]
    flags = [*FLAGS, *link] + ["-fPIC"] * (suffix != ".dll")
    if suffix == ".so":
        flags.append("-Wl,-Bsymbolic")  # its own engine, whatever another FMU exports
    if suffix == ".dylib":
        flags.append(f"-Wl,-install_name,@rpath/{name}{suffix}")
    compiler = find_compiler()
    if host and compiler is not None:
        return [*compiler, *flags]
    try:
        import ziglang  # noqa: F401
    except ImportError:
        raise ContactSystemError(
            f"no compiler for {host or target}: `pip install ziglang`, which compiles for all "
            "platforms; for this machine alone any C compiler will do (cc, gcc, clang, or set CC)"
        ) from None
    return [sys.executable, "-m", "ziglang", "cc", "-target", triple, *flags]


def library_place(name: str, target: str, fmi_version: str) -> str:
    """Where a platform's library lies inside the FMU."""
    folder2, folder3, suffix, _ = _platform(target)
    return f"binaries/{folder2 if fmi_version == '2.0' else folder3}/{name}{suffix}"


def target(path: str | os.PathLike) -> Path:
    """The path of a file to write.

    Raises
    ------
    ContactSystemError
        It is none, or a folder, a device or a pipe, or lies in something that is no folder.
    """
    path = a_path(path)
    try:
        if path.is_dir():
            raise ContactSystemError(f"'{path}' is a folder; name the file to write in it")
        if path.exists() and not path.is_file():
            raise ContactSystemError(
                f"'{path}' is a device or a pipe, which a file would replace; name a file"
            )
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ContactSystemError(f"no file can be written to '{path}': {error}") from None
    return path


def write_fmu(
    path: Path,
    files: Mapping[str, bytes],
    moment: Sequence[int],
    check: Callable[[str], Sequence[str]] = lambda half: (),
) -> None:
    """Write a zip file whose bytes depend on the files and the moment (y, m, d, h, min, s) only.

    ``check`` says what is wrong with the file; one that is wrong replaces nothing.

    Raises
    ------
    ContactSystemError
        What ``check`` says, or why the file cannot be written.
    """
    # zip knows the years 1980 to 2107 only
    stamp = min(max(tuple(moment), (1980, 1, 1, 0, 0, 0)), (2107, 12, 31, 23, 59, 58))
    with writing(path) as file:
        data = _zipped(files, stamp)
        file.write(data)
        file.flush()
        if Path(file.name).read_bytes() != data:  # a full disk does not always tell
            raise ContactSystemError(f"{path}: what was written cannot be read back; write again")
        if problems := check(file.name):
            raise ContactSystemError(f"{path}: fmpy's validation says: " + "; ".join(problems))


@functools.lru_cache(maxsize=64)
def _deflated(data: bytes) -> tuple[int, bytes]:
    """Checksum and compressed bytes; most of an FMU is the same in all."""
    packer = zlib.compressobj(6, zlib.DEFLATED, -15)
    return zlib.crc32(data), packer.compress(data) + packer.flush()


def _zipped(files: Mapping[str, bytes], moment: Sequence[int]) -> bytes:
    """A zip file by names: zipfile cannot be given what is compressed already."""
    year, month, day, hour, minute, second = moment
    stamp = (hour << 11 | minute << 5 | second // 2, (year - 1980) << 9 | month << 5 | day)
    at, parts, entries = 0, [], []
    for name in sorted(files):
        crc, data = _deflated(files[name])
        word = name.encode()
        # version 2.0, names in UTF-8, deflated
        said = struct.pack("<HHHHHIII", 20, 0x800, 8, *stamp, crc, len(data), len(files[name]))
        said += struct.pack("<HH", len(word), 0)
        parts.append(b"PK\3\4" + said + word + data)
        tail = struct.pack("<HHHII", 0, 0, 0, 0o100644 << 16, at)
        entries.append(b"PK\1\2" + struct.pack("<H", 3 << 8 | 20) + said + tail + word)
        at += 30 + len(word) + len(data)
    count, directory = len(entries), b"".join(entries)
    end = struct.pack("<HHHHIIH", 0, 0, count, count, len(directory), at, 0)
    return b"".join([*parts, directory, b"PK\5\6", end])
