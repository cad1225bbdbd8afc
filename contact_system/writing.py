"""Files are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import SceneError


@contextmanager
def writing(path: Path, place: str = "") -> Iterator[BinaryIO]:
    """A new file, open for writing; at the end it replaces the one at ``path``.

    Until then it is in the same folder and its name ends in ``.part``; if the process is killed it
    stays there and may be removed. It is flushed to the disk before it replaces the old file. If
    the path is a symbolic link, its target is replaced. Permissions follow the umask.

    Raises a SceneError that begins with ``place`` and says why the file cannot be written; the old
    file stays, as it does after any other error.
    """
    target = Path(os.path.realpath(path))
    # a random name, as two threads or processes may write the same file
    part = target.with_name(f"{target.name[:40]}.{os.urandom(4).hex()}.part")
    try:
        if target.exists() and not target.is_file():  # root could even replace /dev/null
            raise OSError("it is a folder, a device or a pipe")
        with part.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, target)
    except OSError as error:
        raise SceneError(
            f"{place}'{path}' cannot be written: {error.strerror or error}; give a path in a "
            "folder that is there and can be written to"
        ) from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
