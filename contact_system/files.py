"""Files: paths are checked, files written whole or not at all, archives opened."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from .errors import ContactSystemError, SceneError

if TYPE_CHECKING:
    from zipfile import ZipFile

NOT_REGULAR = "it is a folder, a device or a pipe"


def a_path(value: Any, what: str = "path", endings: Sequence[str] = ()) -> Path:
    """The value as a Path; raises a SceneError if it names no file, or has another ending."""
    try:
        path = os.fsdecode(value)
        os.fsencode(path)
    except (TypeError, UnicodeError):
        raise SceneError(f"{what} = {value!r:.80}: give a path that can name a file") from None
    found = Path(path)
    if endings and found.suffix not in endings:
        raise SceneError(f"{path}: unknown ending {found.suffix!r}; use {' or '.join(endings)}")
    return found


def make_folder(path: Path, remedy: str) -> Path:
    """The folder, made if it is missing; raises a ContactSystemError with the remedy."""
    try:
        a_path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ContactSystemError(f"no folder '{path}': {error.strerror}; {remedy}") from None
    return path


def require_regular(path: str | os.PathLike[str]) -> None:
    """Raise a SceneError for a folder, a device or a pipe, which may never end.

    Raises an OSError if there is no file, a ValueError if the path is not a valid one.
    """
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise SceneError(f"'{path}' cannot be read: {NOT_REGULAR}; give a regular file")


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
            raise OSError(NOT_REGULAR)
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


@contextmanager
def opened(path: str | os.PathLike[str], what: str) -> Iterator[ZipFile]:
    """The archive, for reading; `what` says in errors which file is expected.

    Raises a ContactSystemError if the path is no regular file or no archive, and if a member read
    inside the ``with`` block is damaged or encrypted.
    """
    from zipfile import ZipFile  # slow to import

    try:
        require_regular(path)
        with ZipFile(path) as archive:
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
