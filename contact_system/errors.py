"""What can be wrong with a scene, a surface or a contact, each under its own name."""


class ContactSystemError(ValueError):
    """Base of every error this package raises on purpose; the text says what to change."""


class SceneError(ContactSystemError):
    """A scene, or a file that describes one, holds a value that cannot be planned."""


class SurfaceError(ContactSystemError):
    """A surface is given wrongly, or is asked for something it does not have."""


class ChartSingularity(ContactSystemError):
    """The chart has no contact frame at this point, such as a pole or an umbilic."""


class ConformalContact(ContactSystemError):
    """Two surfaces share their curvature at the contact: the twist leaves its motion open."""
