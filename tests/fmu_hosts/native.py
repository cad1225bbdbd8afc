"""Compile the C programs of this folder against an FMU, for any platform, and run them here.

`trajectory` and `endurance` are linked with the library inside the FMU; `fuzz` is compiled together
with the sources inside the FMU, under AddressSanitizer and UndefinedBehaviorSanitizer.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Model, FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Model, FMU3Slave, fmi3LogMessageCallback
from fmpy.model_description import ModelDescription, ModelVariable

from fmu_export.build import PLATFORMS, library_place

HERE, FMI_HEADERS = Path(__file__).parent, Path(fmpy.__file__).parent / "c-code"
FLAGS = ("-std=gnu11", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wno-unused-function")
SANITIZERS = (
    "-fsanitize=address,undefined",
    "-fsanitize=float-cast-overflow",
    "-fno-sanitize-recover=all",
    "-fno-omit-frame-pointer",
    "-g",
)
SYSROOT = Path("/usr/aarch64-linux-gnu")  # of Debian's libc6-arm64-cross


@functools.cache
def find_compiler() -> tuple[str, ...] | None:
    """The command of this machine's C compiler, else of ziglang, as a list; None without both."""
    for command in (os.environ.get("CC", "").split(), ["cc"], ["gcc"], ["clang"]):
        if command and shutil.which(command[0]):
            return tuple(command)
    if importlib.util.find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang", "cc")
    return None


class Unavailable(Exception):
    """A tool is not on this machine; the message says which."""


@dataclass(frozen=True)
class Fmu:
    """An FMU: its file, the folder it was unpacked to, its description."""

    path: Path
    folder: Path
    description: ModelDescription

    @classmethod
    def unpacked(cls, path: Path, folder: Path) -> Fmu:
        """The FMU of a file, unpacked into a new folder."""
        found = Path(fmpy.extract(str(path), str(folder)))
        return cls(Path(path), found, fmpy.read_model_description(str(found)))

    @property
    def version(self) -> str:
        return "2.0" if self.description.fmiVersion == "2.0" else "3.0"

    @property
    def token(self) -> str:
        """GUID (FMI 2) or instantiation token (FMI 3)."""
        read = self.description
        return read.guid if self.version == "2.0" else read.instantiationToken

    def instance(
        self,
        log: Callable[[int, str, str], None] | None = None,
        interface: str = "CoSimulation",
        name: str = "one",
        **options: Any,
    ) -> Any:
        """An instance in fmpy, not initialized; ``options`` are those of its ``instantiate``.

        ``log`` takes status, category and text of what it logs.
        """
        kind = {
            ("2.0", "CoSimulation"): FMU2Slave,
            ("2.0", "ModelExchange"): FMU2Model,
            ("3.0", "CoSimulation"): FMU3Slave,
            ("3.0", "ModelExchange"): FMU3Model,
        }[self.version, interface]
        made = kind(
            guid=self.token,
            unzipDirectory=str(self.folder),
            instanceName=name,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
        )
        if log is not None:

            def log_line(*arguments: Any) -> None:
                status, category, text = arguments[-3:]  # in FMI 2 after environment and name
                log(status, category.decode(), text.decode())

            if self.version == "2.0":
                made.kept = fmi2CallbackFunctions(logger=fmi2CallbackLoggerTYPE(log_line))
                options = {"callbacks": made.kept, "loggingOn": True} | options
            else:
                made.kept = fmi3LogMessageCallback(log_line)
                options = {"logMessage": made.kept, "loggingOn": True} | options
        made.instantiate(**options)
        return made

    def library(self, target: str) -> Path:
        """Where the FMU's library for a platform is."""
        name = self.description.coSimulation.modelIdentifier
        return self.folder / library_place(name, target, self.version)

    @property
    def outputs(self) -> list[ModelVariable]:
        return [v for v in self.description.modelVariables if v.causality == "output"]

    def model_arguments(self, variables: Sequence[ModelVariable] = ()) -> list[str]:
        """TOKEN N_VALUES REFERENCE... for the programs; of all variables by default."""
        chosen = variables or self.description.modelVariables
        total = sum(map(size, chosen))
        return [self.token, str(total), *(str(v.valueReference) for v in chosen)]


def size(variable: ModelVariable) -> int:
    """Number of values."""
    return int(np.prod([int(d.start) for d in variable.dimensions], dtype=int))


def difference(variables: Sequence[ModelVariable], found: np.ndarray, wanted: np.ndarray) -> float:
    """Greatest difference of two trajectories, over the greatest of the quantity or 1e-3.

    Elements of a vector are one quantity, also in FMI 2, where they are variables.

    Parameters
    ----------
    variables : what the columns are
    found, wanted : (n_times, n_values)
    """
    stems = [re.sub(r"(\.\w+|\[\d,\d\])\)?$", "", v.name) for v in variables]
    names = [v.name if v.dimensions else stem for v, stem in zip(variables, stems)]
    column = np.repeat(names, [size(v) for v in variables])
    worst = 0.0
    for name in set(names):
        off = np.abs(found - wanted)[:, column == name].max()
        worst = max(worst, off / max(np.abs(wanted[:, column == name]).max(), 1e-3))
    return worst


class Program:
    """A program of this folder, compiled for a target, that this machine can run.

    Raises
    ------
    Unavailable
        No compiler for the target, no sanitizers, or nothing that runs the target's programs.
    """

    def __init__(self, name: str, fmu: Fmu, target: str = "native", sanitized: bool = False):
        self._kept = tempfile.TemporaryDirectory(prefix="fmu-host-")
        self.folder, self.fmu = Path(self._kept.name), fmu
        self.target = fmpy.platform_tuple if target == "native" else target
        if name == "endurance" and platform.libc_ver()[0] != "glibc":
            raise Unavailable("allocations are counted with glibc only")
        self._runner, self._environment = _runner(self.target)
        flags = [*FLAGS, f"-DFMI_VERSION={fmu.version[0]}", f"-I{HERE}", f"-I{FMI_HEADERS}"]
        windows = PLATFORMS[self.target].suffix == ".dll"
        self._file = self.folder / (f"{name}.exe" if windows else name)
        sources, link = [HERE / f"{name}.c"], ["-lm", *([] if windows else ["-lpthread"])]
        if sanitized:
            compiler = sanitizing_compiler()
            sources += sorted((fmu.folder / "sources").glob("*.c"))
            flags += ["-O0", *SANITIZERS, f"-I{fmu.folder / 'sources'}"]
        else:
            compiler = _compiler(self.target)
            # given without a folder, so that the program looks for the library beside itself
            link.append(Path(shutil.copy(fmu.library(self.target), self.folder)).name)
            # -s as the library was linked: otherwise ziglang builds its C library once more
            link += ["-s"] if windows else ["-Wl,-rpath,$ORIGIN"]
        compiled, objects = [*compiler, *flags], [f"{file.stem}.o" for file in sources]
        commands = [[*compiled, "-c", str(c), "-o", o] for c, o in zip(sources, objects)]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(self._call, commands))
        self._call([*compiled, *objects, "-o", self._file.name, *link])

    def _call(self, command: Sequence[str]) -> None:
        run = subprocess.run(command, cwd=self.folder, capture_output=True, text=True)
        assert run.returncode == 0, f"{' '.join(command)}\n{run.stderr}"

    def run(self, *arguments: object, timeout: float = 600.0) -> str:
        """What the program prints; AssertionError with what it wrote to stderr if it fails."""
        command = [*self._runner, str(self._file), *map(str, arguments)]
        environment = os.environ | self._environment | {"FMU_FOLDER": str(self.fmu.folder)}
        run = subprocess.run(
            command, capture_output=True, text=True, env=environment, timeout=timeout
        )
        assert run.returncode == 0, f"exit code {run.returncode}\n{run.stderr[-6000:]}"
        return run.stdout

    def table(self, *arguments: object) -> np.ndarray:
        """The numbers that the program prints, a row for each line."""
        return np.array([line.split() for line in self.run(*arguments).splitlines()], dtype=float)


def _compiler(target: str) -> tuple[str, ...]:
    compiler = find_compiler()
    if target == fmpy.platform_tuple:
        if compiler is None:
            raise Unavailable("no C compiler")
        return compiler
    if not importlib.util.find_spec("ziglang"):
        raise Unavailable("no compiler for other platforms: ziglang is not installed")
    return (sys.executable, "-m", "ziglang", "cc", "-target", PLATFORMS[target].target)


def _runner(target: str) -> tuple[list[str], dict[str, str]]:
    """The command that runs programs of a platform here, and its environment variables."""
    if target == fmpy.platform_tuple:
        return [], {}
    if target == "x86_64-windows":
        wine = (
            shutil.which("wine64") or shutil.which("wine") or shutil.which("/usr/lib/wine/wine64")
        )
        if wine is None:
            raise Unavailable("Windows programs need wine: apt-get install wine64")
        return [wine], {"WINEPREFIX": _wine_folder().name, "WINEDEBUG": "-all"}
    if target == "aarch64-linux":
        qemu = shutil.which("qemu-aarch64") or shutil.which("qemu-aarch64-static")
        if qemu is None:
            raise Unavailable("aarch64 programs need qemu: apt-get install qemu-user")
        if not SYSROOT.exists():
            raise Unavailable(
                "aarch64 programs need an aarch64 C library: apt-get install libc6-arm64-cross"
            )
        return [qemu, "-L", str(SYSROOT)], {}
    raise Unavailable(f"nothing here runs programs for {target}")


@functools.cache
def _wine_folder() -> tempfile.TemporaryDirectory:
    """Where wine keeps its Windows, which takes seconds to set up."""
    return tempfile.TemporaryDirectory(prefix="fmu-wine-", ignore_cleanup_errors=True)


@functools.cache
def sanitizing_compiler() -> tuple[str, ...]:
    """A compiler whose sanitizers work.

    Raises
    ------
    Unavailable
        There is none.
    """
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "probe.c"
        source.write_text("int main(void) { return 0; }\n")
        for name in ("gcc", "clang", "cc"):
            path, program = shutil.which(name), str(Path(folder) / "probe")
            if path is None:
                continue
            command = [path, *SANITIZERS, str(source), "-o", program]
            if not subprocess.run(command, capture_output=True).returncode:
                if not subprocess.run([program], capture_output=True).returncode:
                    return (path,)
    raise Unavailable("no compiler here has AddressSanitizer and UndefinedBehaviorSanitizer")
