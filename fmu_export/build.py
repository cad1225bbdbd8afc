"""The code of an FMU, the engine with its FMI layer: libraries of each platform, and C sources."""

from __future__ import annotations

import functools
import importlib.util
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from fmpy import platform_tuple

from contact_system.engine.binding import LIBRARY
from contact_system.engine.platforms import FLAGS, PLATFORMS, shared
from contact_system.errors import ContactSystemError

from .data import as_c

_WASM = (
    *("-mexec-model=reactor", "-s", "-msimd128", "-Wl,--export-dynamic"),
    *("-Wl,--export=malloc", "-Wl,--export=free"),
    # longjmp, by WebAssembly's exceptions in their standard form
    *("-mexception-handling", "-mllvm", "-wasm-enable-sjlj"),
    *("-mllvm", "-wasm-use-legacy-eh=false"),
)
NATIVE = {"native": PLATFORMS[platform_tuple]} if platform_tuple in PLATFORMS else {}
TARGETS = NATIVE | PLATFORMS
ENGINE, C_FOLDER = LIBRARY.parent, Path(__file__).parent / "c"
UNITS = (ENGINE / "engine.c", ENGINE / "dispatch.c", C_FOLDER / "fmi2.c", C_FOLDER / "fmi3.c")


def library_place(name: str, target: str, fmi_version: str) -> str:
    """Where a platform's library lies inside the FMU."""
    row = TARGETS[target]
    return f"binaries/{row.folder_2 if fmi_version == '2.0' else row.folder_3}/{name}{row.suffix}"


def library(target: str, name: str) -> bytes:
    """The engine with its FMI layer for a platform, under a model's name.

    This machine's was built when the package was installed; others are built by ziglang, which
    keeps what it has compiled in ``$ZIG_GLOBAL_CACHE_DIR`` or ``~/.cache/zig``.
    """
    row = TARGETS[target]
    if target == "native":
        return LIBRARY.read_bytes()
    if not importlib.util.find_spec("ziglang"):
        raise ContactSystemError(
            f"no compiler for {target}: `pip install ziglang`, which compiles for all platforms"
        )
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", row.target]
    linked = _WASM if row.suffix == ".wasm" else shared(row.suffix)
    command = [*compiler, *FLAGS, "-DVARIANT=baseline", *linked]
    command += [f"-I{ENGINE}", *map(str, UNITS)]
    with tempfile.TemporaryDirectory(prefix="contact-system-") as folder:
        # a Windows library contains its name, by which programs linked with it look for it
        built = Path(folder, f"{name}{row.suffix}")
        command += ["-o", built.name, "-lm"]
        run = subprocess.run(command, cwd=folder, capture_output=True)
        if run.returncode:
            said = run.stderr[-2000:].decode(errors="replace")
            raise ContactSystemError(f"{' '.join(command)} failed:\n{said}")
        return built.read_bytes()


SOURCES = ("fmu.c", "kernel.c")
SHARED = (
    *("engine_baseline", "contact_engine", "contact_layout"),
    *("builtin_surfaces", "n_builtin_surfaces", "contact_tables"),
)
"""External names of the engine, which get a prefix: programs may link several models."""


@functools.cache
def _texts(layer: str) -> dict[str, str]:
    """File name -> text of what all FMUs of one version of FMI share. What is included is renamed
    to .inc, as importers may compile every .c file that they find."""
    other = {"2": "3", "3": "2"}[layer]
    folders, found = (ENGINE, ENGINE / "generated", C_FOLDER), {}
    for file in (file for folder in folders for file in sorted(folder.glob("*.[chi]*"))):
        if file.name not in ("resource.c", f"fmi{other}.c"):
            name = file.name.removesuffix(".c") + ".inc" * (file.suffix == ".c")
            text = file.read_text("utf-8").replace('"generated/', '"')
            found[name] = re.sub(r'(#include "\w+)\.c"', r'\1.inc"', text)
    return found


def c_sources(data: bytes, identifier: str, fmi_version: str) -> dict[str, str]:
    """File name -> text of all sources; `SOURCES` are compiled, and include the rest.

    data: of `data.scene_data`; identifier: the model's.
    """
    layer = fmi_version[0]
    names = "".join(f"#define {name} {identifier}_{name}\n" for name in SHARED)
    prefix = f"#define FMI2_FUNCTION_PREFIX {identifier}_\n" if layer == "2" else ""
    engine = '#include "engine.inc"\n#include "dispatch.inc"\n'
    units = {
        "kernel.c": f"#define VARIANT baseline\n{names}{engine}",
        "fmu.c": f'#define SCENE_INSIDE\n{prefix}{names}#include "fmi{layer}.inc"\n',
    }
    return _texts(layer) | {"scene.inc": as_c(data)} | units
