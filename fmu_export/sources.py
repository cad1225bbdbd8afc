"""FMUs of sources: the engine, the FMI layer and the scene as C, by GCC or Clang."""

from __future__ import annotations

import functools
import re

from .build import texts
from .data import as_c

_INCLUDE = re.compile(r'(#include "\w+)\.c"')
UNITS = ("fmu.c", "kernel.c")
SHARED = (
    *("engine_baseline", "contact_engine", "contact_surface", "contact_table", "contact_layout"),
    *("builtin_surfaces", "n_builtin_surfaces", "contact_tables"),
)
"""What the engine shows to others; several models may be linked into one program."""


@functools.cache
def _texts(layer: str) -> dict[str, str]:
    """What FMUs of one version of FMI have in common, under the names that it has there."""
    other = {"2": "3", "3": "2"}[layer]
    skipped = ("resource.c", f"fmi{other}.c")
    files = {file.name: text for file, text in texts().items() if file.name not in skipped}
    return {_part(name): text.replace('"generated/', '"') for name, text in files.items()}


def _part(name: str) -> str:
    """Importers may compile every .c that they find; what is included is none."""
    return name.removesuffix(".c") + ".inc" * name.endswith(".c")


def c_sources(data: bytes, identifier: str, fmi_version: str) -> dict[str, str]:
    """File name -> text of everything; `UNITS` are compiled, and include the rest.

    data: of `data.scene_data`; identifier: the model's.
    """
    layer = fmi_version[0]
    names = "".join(f"#define {name} {identifier}_{name}\n" for name in SHARED)
    prefix = f"#define FMI2_FUNCTION_PREFIX {identifier}_\n" if layer == "2" else ""
    engine = '#include "engine.c"\n#include "dispatch.c"\n'
    units = {
        "kernel.c": f"#define VARIANT baseline\n{names}{engine}",
        "fmu.c": f'#define SCENE_INSIDE\n{prefix}{names}#include "fmi{layer}.c"\n',
    }
    found = _texts(layer) | {"scene.inc": as_c(data)} | units
    return {name: _INCLUDE.sub(r'\1.inc"', text) for name, text in found.items()}
