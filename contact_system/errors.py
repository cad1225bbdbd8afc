"""What can be wrong with a scene, a surface or a contact, each under its own name."""

from . import limits


class ContactSystemError(ValueError):
    """Base of every error this package raises on purpose; the text says what to change.

    What it echoes may come from a stranger's file: control characters are shown as escapes, and of
    more than `limits.MESSAGE` characters the middle is left out.
    """

    def __init__(self, text: object = ""):
        super().__init__(_clipped(str(text)))


def _clipped(text: str) -> str:
    if not text.isprintable():
        text = "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)
    over = len(text) - limits.MESSAGE
    if over <= 0:
        return text
    gap, half = f" [... {over + 40} characters ...] ", (limits.MESSAGE - 40) // 2
    return text[:half] + gap + text[-half:]


class SceneError(ContactSystemError):
    """A scene, or a file that describes one, holds a value that cannot be planned."""


class SurfaceError(ContactSystemError):
    """A surface is given wrongly, or is asked for something it does not have."""


class ChartSingularity(ContactSystemError):
    """The chart has no contact frame at this point, such as a pole or an umbilic."""


class ConformalContact(ContactSystemError):
    """Two surfaces share their curvature at the contact: the twist leaves its motion open."""
