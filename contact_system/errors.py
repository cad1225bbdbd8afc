"""What can be wrong with a scene, a surface or a contact, and how it is told."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class ContactSystemError(ValueError):
    """Base of every error this package raises on purpose; the text says what to change."""


class SceneError(ContactSystemError):
    """A scene, or a file that describes one, holds a value that cannot be planned."""


class SurfaceError(ContactSystemError):
    """A surface is given wrongly, or is asked for something it does not have."""


class ChartSingularity(ContactSystemError):
    """The chart has no contact frame at this point: a pole or an umbilic."""


class ConformalContact(ContactSystemError):
    """Two surfaces share their curvature at the contact: the twist leaves its motion open."""


@contextmanager
def naming(place: str) -> Iterator[None]:
    """Put the place in front of every error of the package raised inside."""
    try:
        yield
    except ContactSystemError as error:
        raise SceneError(f"{place}: {error}") from None


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """ " (did you mean '...'?)" with the nearest known word, or nothing."""
    by_lower = {k.lower(): k for k in known}
    close = difflib.get_close_matches(str(word).lower(), by_lower, n=1, cutoff=0.5)
    return f" (did you mean '{by_lower[close[0]]}'?)" if close else ""
