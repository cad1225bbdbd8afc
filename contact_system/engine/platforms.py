"""Platforms and flags of the C compiler. It imports nothing of ours: setup.py reads it too."""

from typing import NamedTuple


class Platform(NamedTuple):
    """Folders in FMI 2 and 3, a library's suffix, and the target's names in ziglang and wheels."""

    folder_2: str
    folder_3: str
    suffix: str
    target: str
    wheel: str = ""


LINUX, MAC = "x86_64-linux-gnu.2.17", "x86_64-macos.11.0"
ARM_LINUX, ARM_MAC = (name.replace("x86_64", "aarch64") for name in (LINUX, MAC))
PLATFORMS = {
    "x86_64-linux": Platform("linux64", "x86_64-linux", ".so", LINUX, "manylinux_2_17_x86_64"),
    "aarch64-linux": Platform(*("aarch64-linux",) * 2, ".so", ARM_LINUX, "manylinux_2_17_aarch64"),
    "x86_64-windows": Platform(
        "win64", "x86_64-windows", ".dll", "x86_64-windows-gnu", "win_amd64"
    ),
    "x86_64-darwin": Platform("darwin64", "x86_64-darwin", ".dylib", MAC, "macosx_11_0_x86_64"),
    "aarch64-darwin": Platform(*("aarch64-darwin",) * 2, ".dylib", ARM_MAC, "macosx_11_0_arm64"),
    "wasm32": Platform(*("wasm32-wasi",) * 2, ".wasm", "wasm32-wasi"),
}
# Contraction to fused operations would make platforms differ in the last digits.
# clang warns of loops that it cannot vectorize with the baseline's -O1.
FLAGS = (
    *("-std=gnu99", "-O2", "-fvisibility=hidden", "-fopenmp-simd"),
    *("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-Wno-pass-failed"),
)


def shared(suffix: str) -> tuple[str, ...]:
    """Linker flags of a shared library that uses its own symbols, not those of another FMU."""
    name = "-Wl,-install_name,@rpath/contact_engine.dylib" if suffix == ".dylib" else "-s"
    return ("-fPIC", "-shared", *["-Wl,-Bsymbolic"] * (suffix == ".so"), name)
