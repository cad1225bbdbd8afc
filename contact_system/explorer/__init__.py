"""A scene in the browser, with sliders: ``contact-system explore``."""

from ..errors import ContactSystemError

try:
    import viser  # noqa: F401
except ImportError as error:
    raise ContactSystemError(
        f'the explorer needs viser: pip install "contact-system[explore]" ({error})'
    ) from None
