"""Errors of the package."""

from . import limits


def printable(text: str) -> str:
    """The text with control characters escaped, as it may quote a file from anywhere."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)


class ContactSystemError(ValueError):
    """Base class of the package's errors; the text says what to change.

    Control characters are escaped, and the middle of a text longer than `limits.MESSAGE` is left
    out.
    """

    def __init__(self, text: object = ""):
        text = printable(str(text))
        over = len(text) - limits.MESSAGE
        if over > 0:
            gap, half = f" [... {over + 40} characters ...] ", (limits.MESSAGE - 40) // 2
            text = text[:half] + gap + text[-half:]
        super().__init__(text)


class SceneError(ContactSystemError):
    """A scene, or a file that describes one, holds a value that cannot be planned."""


class SurfaceError(ContactSystemError):
    """A surface has wrong arguments, or lacks what it is asked for."""


class ChartSingularity(ContactSystemError):
    """The chart has no contact frame at this point, such as a pole or an umbilic."""


class ConformalContact(ContactSystemError):
    """The surfaces have the same curvature at the contact: the twist does not fix its motion."""
