"""A scene in the browser, with sliders: ``contact-system explore``."""
