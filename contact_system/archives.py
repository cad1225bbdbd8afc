"""Opens zip archives, with clear errors for damaged files and for files that are no archive."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager

from .checks import require_regular
from .errors import ContactSystemError


@contextmanager
def opened(path: str | os.PathLike[str], what: str) -> Iterator[zipfile.ZipFile]:
    """The archive, for reading; `what` says in errors which file is expected.

    Raises a ContactSystemError if the path is no regular file or no archive, and if a member read
    inside the ``with`` block is damaged or encrypted.
    """
    try:
        require_regular(path)
        with zipfile.ZipFile(path) as archive:
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
