"""Builds the engine: the C in contact_system/engine becomes one library inside the package.

    pip install .                         compiles the engine and installs the package
    python setup.py build_ext --inplace   compiles the engine alone, into the clone, in seconds
    python setup.py wheels                makes wheels of all PLATFORMS in dist/

The compiler is $CC, cc, gcc or clang. Where none works, and for other platforms, it is that of the
ziglang package, which pip then downloads. $CONTACT_SYSTEM_CFLAGS adds flags. For the C:

- engine.c is compiled once for each of VARIANTS, with -DVARIANT=baseline or v3 and the
  instructions of that variant; on processors other than x86-64 only as baseline. It includes the
  other C files and defines one symbol that others see, `const engine_t engine_<VARIANT>`.
- dispatch.c, which holds the tables, is compiled once, as baseline. -DHAVE_V3 tells it that there
  are two variants; it chooses between them when the library is first used.
- fmu_export/c/fmi2.c and fmi3.c, which include the rest of that folder, are the functions of FMI:
  the library is the binary of every FMU too. They are compiled with -ftrapping-math so that
  comparisons with NaN raise no exception: importers may trap invalid operations.
- Only what is marked EXPORT is visible outside. At run time the library needs libc and libm alone.
- Products and sums are not contracted, so that a table and its twin give the same bits.
- ziglang's compiler has its own sin, exp and so on, less exact than libm's. To use anything of its
  library (__builtin_cpu_supports, divisions of __int128) links all of it.
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

DEFINED = runpy.run_path(str(ENGINE / "platforms.py"))
PLATFORMS = {p.wheel: p.target for p in DEFINED["PLATFORMS"].values() if p.wheel}
FLAGS = (*DEFINED["FLAGS"], "-fPIC")
EXTRA = shlex.split(os.environ.get("CONTACT_SYSTEM_CFLAGS", ""))

# Variant -> choices of flags, of which the first that the compiler accepts is used: that of gcc and
# clang, of ziglang, of compilers without levels of x86-64. If it accepts none, there is no variant.
# The baseline, for processors older than 2013, compiles in half the time, and is up to 1.8 times as
# slow. A variant for AVX-512 saved 3 to 8 % of the time on an Intel Xeon, and none on an AMD EPYC.
# gcc 12 fuses x y - z w beside x y + z w even with -ffp-contract=off, hence -mno-fma.
# -fpeel-loops lets gcc unroll loops over 4 vectors: 6 % less time for K4. clang would warn of it.
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
    *(flag for flag in DEFINED["shared"](LIBRARY.suffix) if "-g" not in EXTRA or flag != "-s"),
]


def works(*command: str) -> bool:
    """Whether a compiler can be run and takes these flags."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "trial.c")
        source.write_text("#include <math.h>\ndouble f(double x) { return sin(x); }\n")
        words = [*command, str(source), "-o", str(Path(folder, "trial"))]
        return subprocess.run(words, capture_output=True).returncode == 0


@functools.cache
def system_compiler() -> tuple[str, ...]:
    """This system's compiler; empty if none works, or if the build is for another platform."""
    if PLATFORM != this_platform():
        return ()
    # gcc is left out on Windows: it stores vectors of 32 bytes on a stack aligned to 16.
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
    # By default it would compile for the very processor that it runs on.
    target = ("-target", PLATFORMS[PLATFORM]) if PLATFORM in PLATFORMS else ("-mcpu=baseline",)
    return (str(program), "cc", *target)


def get_requires_for_build_wheel(config_settings=None):
    """What pip must download for a build: also a compiler where this system has none."""
    return [] if system_compiler() else [ZIGLANG]


get_requires_for_build_editable = get_requires_for_build_wheel


def build_wheel(*arguments, **options):
    """A wheel without the files of an older version, which its build left in this folder."""
    for folder in Path("build").glob("lib.*"):
        shutil.rmtree(folder)
    return build_meta.build_wheel(*arguments, **options)


def run(*command: str) -> None:
    """Run a compiler and print its output; exit if it fails."""
    ran = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    print(ran.stdout, end="", file=sys.stderr)
    if ran.returncode:
        raise SystemExit(f"{shlex.join(command)} failed")


def build_library(library: Path, temporary: Path) -> None:
    """Compile all C files in parallel, and link them to the library."""
    command = (*compiler(), *FLAGS, *EXTRA)

    def accepted(choices: tuple[tuple[str, ...], ...]) -> tuple[str, ...] | None:
        return next((flags for flags in choices if works(*compiler(), *flags, "-c")), None)

    def compiled(source: Path, name: str, *flags: str) -> str:
        made = str(temporary / f"{name}.o")
        run(*command, *flags, f"-I{ENGINE}", "-c", str(source), "-o", made)
        return made

    for folder in (temporary, library.parent):
        folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        wanted = VARIANTS if PLATFORM.endswith(("x86_64", "amd64")) else {"baseline": ((),)}
        found = zip(wanted, pool.map(accepted, wanted.values()))
        variants = {name: flags for name, flags in found if flags is not None}
        engine, baseline = ENGINE / "engine.c", variants["baseline"]
        jobs = [(engine, f"engine_{k}", f"-DVARIANT={k}", *variants[k]) for k in variants]
        have = [f"-DHAVE_{name.upper()}" for name in variants]
        jobs.append((ENGINE / "dispatch.c", "dispatch", *have, *baseline))
        jobs += [(FMI / f"{k}.c", k, *baseline, "-ftrapping-math") for k in ("fmi2", "fmi3")]
        objects = list(pool.map(lambda job: compiled(*job), jobs))
    run(*command, *objects, "-o", str(temporary / library.name), *LINKING)
    shutil.copy(temporary / library.name, library.with_suffix(".part"))
    os.replace(library.with_suffix(".part"), library)  # programs that use the old one keep it
    print(f"{library}: {', '.join(variants)} by {shlex.join(compiler())}", file=sys.stderr)


class BuildEngine(build_ext):
    """Builds the library where setuptools expects a Python extension."""

    def get_ext_filename(self, fullname: str) -> str:
        return str(LIBRARY)

    def run(self) -> None:
        build_library(Path("" if self.inplace else self.build_lib, LIBRARY), Path(self.build_temp))


class Wheel(bdist_wheel):
    """One wheel for all versions of Python on a platform."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", PLATFORM


class Wheels(bdist_wheel):
    """Wheels of all PLATFORMS."""

    def run(self) -> None:
        for os.environ["CONTACT_SYSTEM_PLATFORM"] in PLATFORMS:
            with tempfile.TemporaryDirectory() as folder:
                steps = ["build", "-b", folder, "bdist_wheel", "--skip-build", "-d", self.dist_dir]
                subprocess.run([sys.executable, "-Wignore", __file__, "-q", *steps], check=True)


if __name__ == "__main__":  # so setuptools runs it too; pip imports it as the build back end
    setup(
        cmdclass={"build_ext": BuildEngine, "bdist_wheel": Wheel, "wheels": Wheels},
        ext_modules=[Extension("contact_system.engine._engine", [str(ENGINE / "engine.c")])],
    )
