"""The one way in which the three packages write files: whole, or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import SceneError


@contextmanager
def writing(path: Path, place: str = "") -> Iterator[BinaryIO]:
    """A file to write to, which takes the place of the one at ``path`` if all goes well.

    Until then it stands beside that one, under a name that ends in ``.part``; where the process is
    killed, it stays there, and whoever finds it may remove it. It is on the disk before the old one
    goes. A symbolic link stays one, and what it leads to is replaced. Permissions are those of a
    new file, by the umask, and not the old one's.

    Parameters
    ----------
    path : Path
    place : str
        What the error begins with.

    Raises
    ------
    SceneError
        Why the file cannot be written; what was there stays, as it does after any other error.
    """
    own = Path(os.path.realpath(path))
    part = own.with_name(f"{own.name[:40]}.{os.urandom(4).hex()}.part")  # two may write one file
    try:
        if own.exists() and not own.is_file():  # /dev/null, which root can replace
            raise OSError("it is a folder, a device or a pipe")
        with part.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, own)
        with suppress(OSError):  # of a folder only some systems know how
            _flush_folder(own.parent)
    except OSError as error:
        raise SceneError(
            f"{place}'{path}' cannot be written: {error.strerror or error}; give a path in a "
            "folder that is there and can be written to"
        ) from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _flush_folder(folder: Path) -> None:
    opened = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)
