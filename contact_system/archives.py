"""Zip archives from anywhere, read safely: errors name damaged, hostile and too large ones."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .checks import require_regular, within
from .errors import ContactSystemError


class _Guarded(io.BufferedReader):
    """A file that limits the size of the table of contents, which zipfile reads at once."""

    opening = True

    def read(self, size: int | None = -1, /) -> bytes:
        if self.opening and size is not None:
            within("ARCHIVE_DIRECTORY", size, "bytes of the table of contents", ContactSystemError)
        return super().read(size)


@contextmanager
def opened(path: str | os.PathLike[str], what: str) -> Iterator[zipfile.ZipFile]:
    """The archive, for reading; `what` says in errors which file is expected.

    Raises
    ------
    ContactSystemError
        No regular file, or no archive; also for what is found damaged or encrypted while reading.
    """
    try:
        require_regular(path)
        with _Guarded(io.FileIO(path)) as file, zipfile.ZipFile(file) as archive:
            file.opening = False
            yield archive
    except ContactSystemError as error:
        text = str(error)
        raise ContactSystemError(text if str(path) in text else f"{path}: {text}") from None
    except OSError as error:
        why = error.strerror or error
        raise ContactSystemError(f"{path} cannot be read: {why}; give {what}") from error
    except Exception as error:  # zipfile, zlib and codecs raise a dozen kinds
        why = str(error) or type(error).__name__
        raise ContactSystemError(f"{path}: not {what}, or damaged: {why}; give another") from error


def unpack(archive: zipfile.ZipFile, folder: Path, limit: str) -> None:
    """Unpack all members into an empty folder; refuse names that lead outside."""
    members = archive.infolist()
    total = sum(m.file_size for m in members)
    within(limit, total, "bytes when unpacked", ContactSystemError)
    names = [m.orig_filename for m in members]  # filename is cut at a NUL
    files = {name for name in names if not name.endswith("/")}
    for m, name in zip(members, names):
        parts = name.removesuffix("/").split("/")
        folders = {"/".join(parts[:k]) for k in range(1, len(parts) + name.endswith("/"))}
        if any(c in name for c in "\\:\0") or not {"", ".", ".."}.isdisjoint(parts):
            problem = "is no path inside it, with forward slashes"
        elif m.flag_bits & 1:
            problem = "is encrypted"
        elif clash := files & folders:
            problem = f"lies in '{clash.pop()}', which is a file"
        else:
            continue
        raise ContactSystemError(f"'{name}' in it {problem}; pack it again")
    contents = {(name, m.CRC, m.file_size) for m, name in zip(members, names) if name in files}
    if len(contents) > len(files):  # the same one twice does no harm
        raise ContactSystemError("a file is in it twice, and not the same; pack it again")
    archive.extractall(folder)
