"""Colours, markers and labels common to all pictures."""

from __future__ import annotations

from typing import Any

from ..scene import Scene

COLOURS = ("#1f5fa8", "#12876f", "#e08e0b", "#7a4fa3", "#3aa0d8", "#8a6a3b", "#5b7083")
DISTURBED = "#d1274b"
RECOVERY = "#12876f"
INK = "#2b2f36"
GREY = "#5a6370"
# Lists, as matplotlib 3.8 takes a tuple of two as a colour and its opacity.
BODY = ["#8f9aa6", "#f3f5f7"]  # a surface turned away from the light, and towards it
HOLLOW = ["#6d7884", "#b9c2cb"]  # the same for its back

STYLE: dict[str, Any] = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 11,
    "legend.fontsize": 10,
    "axes.edgecolor": INK,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "mathtext.fontset": "dejavusans",
}
DOTS: Any = {"linestyle": "none", "marker": "o", "markersize": 4.5}
DOTS |= {"markerfacecolor": "white", "markeredgecolor": INK}
NUMBER: Any = {"linestyle": "none", "marker": "$1$", "markersize": 7, "color": COLOURS[0]}


def shortened(text: str, width: int) -> str:
    """The text in one line, cut to the width with an ellipsis; dollar signs are escaped."""
    text = " ".join(text.split())
    text = text if len(text) <= width else text[: width - 1].rstrip() + "…"
    return text.replace("$", r"\$")


def colour_of(contact: int) -> str:
    """The colour of a contact in all pictures."""
    return COLOURS[contact % len(COLOURS)]


def number_of(scene: Scene, contact: int) -> str:
    """The number at the end of a contact's name, such as "finger 1", or its index."""
    name = scene.contact_name(contact)
    number = name[len(name.rstrip("0123456789")) :]
    return number if 0 < len(number) < 10 else str(contact)
