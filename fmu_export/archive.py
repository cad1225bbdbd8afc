"""Everything into one .fmu or .ssp file, which is checked once it is written."""

from __future__ import annotations

import functools
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fmpy.model_description import ValidationError, read_model_description

from contact_system.checks import a_path, make_folder
from contact_system.errors import ContactSystemError
from contact_system.writing import writing


def target(path: str | os.PathLike) -> Path:
    """The path of a file to write, in a folder that is there."""
    path = a_path(path)
    make_folder(path.parent, "name a file in a folder that you may write to")
    return path


def write_fmu(
    path: Path,
    files: Mapping[str, bytes],
    moment: Sequence[int],
    check: Callable[[str], Sequence[str]] = lambda half: (),
) -> None:
    """Write a zip file whose bytes depend on the files and the moment (y, m, d, h, min, s) only.

    ``check`` says what is wrong with the file; one that is wrong replaces nothing.
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
    packer = zlib.compressobj(5, zlib.DEFLATED, -15)  # 6 takes twice as long for 2 % less
    return zlib.crc32(data), packer.compress(data) + packer.flush()


def _zipped(files: Mapping[str, bytes], moment: Sequence[int]) -> bytes:
    """A zip file by names: zipfile cannot be given what is compressed already."""
    year, month, day, hour, minute, second = moment
    stamp = (hour << 11 | minute << 5 | second // 2, (year - 1980) << 9 | month << 5 | day)
    at, parts, entries, names = 0, [], [], sorted(files)
    with ThreadPoolExecutor() as pool:  # zlib lets others run
        deflated = list(pool.map(_deflated, map(files.__getitem__, names)))
    for name, (crc, data) in zip(names, deflated):
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


def problems_of(filename: str) -> list[str]:
    """What is wrong with an FMU: an empty library, or what fmpy's validation says of
    modelDescription.xml, names apart, on whose grammar it spends nearly all its time."""
    with zipfile.ZipFile(filename) as archive:
        empty = [f"{f.filename} is empty" for f in archive.filelist if not f.file_size]
    if empty:
        return empty
    try:
        read_model_description(filename, validate=True, validate_model_structure=True)
    except ValidationError as error:
        return list(error.problems)
    return []
