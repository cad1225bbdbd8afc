"""Builds the engine: the C in contact_system/engine becomes one library inside the package.

    pip install .                         compiles the engine on the way
    python setup.py build_ext --inplace   the engine alone, where it lies, in seconds
    python setup.py wheels                wheels of all PLATFORMS, into dist/

The compiler is $CC, cc, gcc or clang; where none works, and for other platforms, that of the
ziglang package, which pip fetches then. $CONTACT_SYSTEM_CFLAGS adds flags. For the C:

- engine.c is compiled once for each of VARIANTS, with -DVARIANT=baseline or v3 and the
  instructions of that variant; on processors other than x86-64 only as baseline. It includes the
  other files by itself and defines one symbol that others see, `const engine_t engine_<VARIANT>`.
- dispatch.c, which holds the tables, is compiled once, as baseline. It learns by -DHAVE_V3 whether
  there are two variants, and chooses when the library is used.
- fmu_export/c/fmi2.c and fmi3.c, which include the rest of that folder, are the functions of FMI:
  the library is the binary of every FMU too. With -ftrapping-math they meet NaN quietly: importers
  may trap invalid operations.
- Only what is marked EXPORT is seen from outside. At run time there are libc and libm alone.
- Products and sums are not contracted, so that a table and its twin give the same bits.
- ziglang's compiler has a sin, an exp and so on of its own, less exact than libm's. Whatever needs
  its library (__builtin_cpu_supports, divisions of __int128) draws in all of it.
"""

from __future__ import annotations

import functools
import os
import platform
import runpy
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from setuptools import Extension, build_meta, setup
from setuptools.build_meta import *  # noqa: F403  pyproject.toml names this file as build back end
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

ENGINE = Path("contact_system", "engine")
FMI = Path("fmu_export", "c")
ZIGLANG = "ziglang>=0.17,<1"

SAID = runpy.run_path(str(ENGINE / "platforms.py"))
PLATFORMS = {p.wheel: p.target for p in SAID["PLATFORMS"].values() if p.wheel}
FLAGS = (*SAID["FLAGS"], "-fPIC")
EXTRA = shlex.split(os.environ.get("CONTACT_SYSTEM_CFLAGS", ""))

# Variant -> flags, of which the first that the compiler knows are taken: those of gcc and clang,
# ziglang's, those of compilers that know no levels of x86-64. Without any there is no such variant.
# That for processors older than 2013 is compiled in half the time, and up to 1.8 times as slow.
# One for AVX-512 took 3 to 8 % less on an Intel Xeon, and nothing less on an AMD EPYC.
# gcc 12 fuses x y - z w beside x y + z w even with -ffp-contract=off, hence -mno-fma.
# gcc unrolls loops over 4 vectors when it peels, 6 % of the time of K4; clang would warn of it.
_AVX2 = ("-mavx2", "-mbmi", "-mbmi2", "-mlzcnt")
_PEELING = ("-fpeel-loops", "-Wno-ignored-optimization-argument")
VARIANTS = {
    "v3": (("-march=x86-64-v3", "-mno-fma", *_PEELING), ("-march=x86_64_v3",), _AVX2),
    "baseline": (("-march=x86-64", "-O1"), ("-march=x86_64", "-O1"), ("-O1",)),
}


def this_platform() -> str:
    """The platform of wheels for this Python."""
    if sys.platform == "darwin":  # of this processor alone, whatever this Python was built for
        return f"macosx_11_0_{platform.machine()}"
    return sysconfig.get_platform().replace("-", "_").replace(".", "_")


PLATFORM = os.environ.get("CONTACT_SYSTEM_PLATFORM") or this_platform()
LIBRARY = ENGINE / f"_engine{ {'mac': '.dylib', 'win': '.dll'}.get(PLATFORM[:3], '.so') }"
LINKING = [
    "-lm",
    *(flag for flag in SAID["shared"](LIBRARY.suffix) if "-g" not in EXTRA or flag != "-s"),
]


def works(*command: str) -> bool:
    """Whether a compiler can be run and takes these flags."""
    with tempfile.TemporaryDirectory() as room:
        source = Path(room, "trial.c")
        source.write_text("#include <math.h>\ndouble f(double x) { return sin(x); }\n")
        words = [*command, str(source), "-o", str(Path(room, "trial"))]
        return subprocess.run(words, capture_output=True).returncode == 0


@functools.cache
def system_compiler() -> tuple[str, ...]:
    """This system's compiler; empty if none works, or if we build for another platform."""
    if PLATFORM != this_platform():
        return ()
    # Not gcc on Windows: it stores vectors of 32 bytes on a stack aligned to 16.
    names = ["clang"] if sys.platform == "win32" else ["cc", "gcc", "clang"]
    mac = ["-arch", platform.machine(), "-mmacosx-version-min=11.0"] * (sys.platform == "darwin")
    for name in (os.environ.get("CC", ""), *names):
        words = (*shlex.split(name), *mac)
        if name and shutil.which(words[0]) and works(*words, *FLAGS, *LINKING):
            return words
    return ()


def compiler() -> tuple[str, ...]:
    """The system's compiler, or ziglang's."""
    if system_compiler():
        return system_compiler()
    try:
        import ziglang
    except ImportError:
        raise SystemExit("no C compiler: install gcc or clang, or `pip install ziglang`") from None
    os.environ.setdefault("ZIG_GLOBAL_CACHE_DIR", str(Path("build", "zig").absolute()))
    program = Path(ziglang.__file__).with_name("zig.exe" if os.name == "nt" else "zig")
    # Left to itself it would compile for the very processor that it runs on.
    target = ("-target", PLATFORMS[PLATFORM]) if PLATFORM in PLATFORMS else ("-mcpu=baseline",)
    return (str(program), "cc", *target)


def get_requires_for_build_wheel(config_settings=None):
    """What pip has to fetch: a compiler only where there is none."""
    asked = build_meta.get_requires_for_build_wheel(config_settings)
    return asked if system_compiler() else [*asked, ZIGLANG]


get_requires_for_build_editable = get_requires_for_build_wheel


def run(*command: str) -> None:
    """Run a compiler and pass on what it says."""
    ran = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    print(ran.stdout, end="", file=sys.stderr)
    if ran.returncode:
        raise SystemExit(f"{shlex.join(command)} failed")


def build_library(library: Path, room: Path) -> None:
    """Compile all at once, and link."""
    command = (*compiler(), *FLAGS, *EXTRA)

    def known(choices: tuple[tuple[str, ...], ...]) -> tuple[str, ...] | None:
        return next((flags for flags in choices if works(*compiler(), *flags, "-c")), None)

    def compiled(source: Path, name: str, *flags: str) -> str:
        made = str(room / f"{name}.o")
        run(*command, *flags, f"-I{ENGINE}", "-c", str(source), "-o", made)
        return made

    for folder in (room, library.parent):
        folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        wanted = VARIANTS if PLATFORM.endswith(("x86_64", "amd64")) else {"baseline": ((),)}
        found = zip(wanted, pool.map(known, wanted.values()))
        have = {name: flags for name, flags in found if flags is not None}
        engine = ENGINE / "engine.c"
        jobs = [(engine, f"engine_{k}", f"-DVARIANT={k}", *have[k]) for k in have]
        told = [f"-DHAVE_{name.upper()}" for name in have]
        jobs.append((ENGINE / "dispatch.c", "dispatch", *told, *have["baseline"]))
        quiet = (*have["baseline"], "-ftrapping-math")
        jobs += [(FMI / f"{k}.c", k, *quiet) for k in ("fmi2", "fmi3")]
        objects = list(pool.map(lambda job: compiled(*job), jobs))
    run(*command, *objects, "-o", str(room / library.name), *LINKING)
    shutil.copy(room / library.name, library.with_suffix(".part"))
    os.replace(library.with_suffix(".part"), library)  # programs that use the old one keep it
    print(f"{library}: {', '.join(have)} by {shlex.join(compiler())}", file=sys.stderr)


class BuildEngine(build_ext):
    """The library in the place of a Python extension."""

    def get_ext_filename(self, fullname: str) -> str:
        return str(LIBRARY)

    def run(self) -> None:
        build_library(Path("" if self.inplace else self.build_lib, LIBRARY), Path(self.build_temp))


class Wheel(bdist_wheel):
    """One for all Pythons of a platform."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", PLATFORM


class Wheels(bdist_wheel):
    """Wheels of all PLATFORMS."""

    def run(self) -> None:
        for os.environ["CONTACT_SYSTEM_PLATFORM"] in PLATFORMS:
            with tempfile.TemporaryDirectory() as room:
                steps = ["build", "-b", room, "bdist_wheel", "--skip-build", "-d", self.dist_dir]
                subprocess.run([sys.executable, "-Wignore", __file__, "-q", *steps], check=True)


if __name__ == "__main__":  # as it is for setuptools too
    setup(
        cmdclass={"build_ext": BuildEngine, "bdist_wheel": Wheel, "wheels": Wheels},
        ext_modules=[Extension("contact_system.engine._engine", [str(ENGINE / "engine.c")])],
    )
