"""The page: a picture, sliders, the plot of slip.

All windows of the browser share one state. Callbacks of viser only store requests; the thread that
called :meth:`Explorer.run` plans and draws the latest one.
"""

from __future__ import annotations

import contextlib
import io
import re
import socket
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import viser

from ..errors import ContactSystemError
from ..files import make_folder
from ..plan import Plan, plan
from ..plots import DECADES
from ..plots.style import colour_of
from ..scene import NO_CLAIMS, Scene, save_scene
from ..steering import Goal, reach
from ..terminal import tell
from ..theory.gain import LAWS
from .picture import Picture
from .sliders import Place, Slider, adjusted, sliders_of

HOST = "127.0.0.1"  # this machine only, as the page can write files
FRAME = 1 / 30  # s, between frames of an animation


class Explorer:
    """A scene in the browser, at a port; 0: any free one. The button *Save scene* writes `file`.

    Raises a ContactSystemError for a scene that cannot be planned, or a port that is in use.
    """

    def __init__(self, scene: Scene, file: Path, port: int):
        self.base, self.file = scene, file
        self.moved: dict[Place, Any] = {}
        self.goals: dict[int, Goal] = {}
        self.wake, self.stale, self.playing = threading.Event(), False, False
        self.clicked: tuple[np.ndarray, ...] = ()
        self.now = scene.duration
        first = plan(scene)
        _require_free(port)
        with contextlib.redirect_stdout(io.StringIO()):  # viser's own greeting
            self.server = viser.ViserServer(HOST, port, scene.name or "contact_system", False)
        self.address = f"http://{HOST}:{self.server.get_port()}"
        self._add_controls()
        self.picture = Picture(self.server, first, self._clicked)
        self._show(first)
        self.picture.look()

    def run(self) -> None:
        """Print the address, and serve until Ctrl-C."""
        try:
            tell(f"{self.base.title} at {self.address}; Ctrl-C ends it")
            last = time.monotonic()
            while True:
                self.wake.wait(FRAME if self.playing else 0.5)
                self.wake.clear()
                elapsed, last = time.monotonic() - last, time.monotonic()
                self.step(elapsed)
        finally:
            self.close()

    def ask(self, values: Mapping[Place, Any]) -> None:
        """Request the scene with these values in these places; the next step draws it."""
        self.moved |= values
        self.stale = True
        self.wake.set()

    def step(self, elapsed: float) -> None:
        """Handle requests, and advance a running animation by `elapsed` seconds."""
        try:
            if self.clicked:
                self._click(*self.clicked)
            elif self.stale:
                self._plan_again()
        except ContactSystemError as error:
            self.said.content = f"**Refused, so the picture stays:** {_plain(error)}"
        if self.playing:
            span = self.picture.plan.end - self.picture.plan.start
            self.now = (self.now + elapsed) % span
            self.clock.value = round(self.now, 4)  # type: ignore[misc]
        if self.picture.drawn != self.now:
            self.picture.draw(self.now)
        self.server.flush()

    def close(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    # --- controls ------------------------------------------------------------------------------

    def _add_controls(self) -> None:
        gui, scene = self.server.gui, self.base
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()  # beside the picture, which else is partly behind it
        self.said = gui.add_markdown(_plain(scene.description))
        self.slip = gui.add_uplot(
            (np.zeros(2),) * (1 + len(scene.contacts)),  # until there is a plan
            ({"label": "time"}, *map(self._slip_style, range(len(scene.contacts)))),
            scales={"x": {"time": False}},
            legend={"show": False},
            title="log10 of slip [m/s] over time [s]",
            aspect=1.8,
            padding=(8, 24, 0, 0),  # room for the topmost number
        )
        self.play = gui.add_button("Play")
        self.clock = gui.add_slider("time [s]", 0.0, scene.duration, 1e-3, scene.duration)
        self.finger = gui.add_dropdown(
            "a click sends", [f"{i}: {scene.contact_name(i)}" for i in range(len(scene.contacts))]
        )
        self.forget = gui.add_button("Forget goals", disabled=True)
        self.save = gui.add_button("Save scene")
        self.law = gui.add_dropdown("gain law", tuple(LAWS), initial_value=scene.gain.law)
        value, place = scene.gain.value, ("gain", "value")
        most = 4 * value or 100.0
        self.gain = self._slider(Slider("", self._parameter(), 0.0, most, value, (place,)))
        folders: dict[str, Any] = {}
        self.idle: list[Any] = []  # folders of what a route to a goal leaves out
        for slider in sliders_of(scene):
            if slider.folder not in folders:
                first = slider.folder in ("profile", "shapes")
                folders[slider.folder] = gui.add_folder(slider.folder, expand_by_default=first)
                if slider.places[0][0] in ("profile", "disturbances"):
                    self.idle.append(folders[slider.folder])
            with folders[slider.folder]:
                self._slider(slider)
        self._add_handlers()

    def _add_handlers(self) -> None:
        """What the controls do."""

        @self.law.on_update
        async def _(_: Any) -> None:
            self.gain.label = self._parameter()
            self.ask({("gain", "law"): self.law.value})

        @self.play.on_click
        async def _(_: Any) -> None:
            self.playing = not self.playing
            self.play.label = "Pause" if self.playing else "Play"
            self.wake.set()

        @self.clock.on_update
        async def _(event: Any) -> None:
            if event.client is not None:
                self.now = self.clock.value
                self.wake.set()

        @self.forget.on_click
        async def _(_: Any) -> None:
            self.goals.clear()
            self.ask({})

        @self.save.on_click
        def _(_: Any) -> None:
            self._save()

    def _slider(self, slider: Slider) -> Any:
        """A slider in the page. It shows a rounded value; until it is moved, and again when it is
        moved back to its first place, the scene has its exact value."""
        span = slider.high - slider.low
        step = 10.0 ** np.floor(np.log10(span / 200))
        low, high = (round(x / step) * step for x in (slider.low, slider.high))
        value = float(np.clip(round(slider.value / step) * step, low, high))
        low, high, value, step = (float(f"{x:.9g}") for x in (low, high, value, step))
        handle = self.server.gui.add_slider(slider.label, low, high, step, value)

        @handle.on_update
        async def _(_: Any) -> None:
            now = slider.value if handle.value == value else handle.value
            self.ask({place: slider.made(now) for place in slider.places})

        return handle

    def _parameter(self) -> str:
        law = LAWS[self.law.value]
        return f"{law.parameter} [{law.unit}]"

    def _slip_style(self, contact: int) -> Any:
        style = {"stroke": colour_of(contact), "width": 2, "points": {"show": False}}
        return {"label": str(contact), **style}

    # --- requests ------------------------------------------------------------------------------

    def _requested(self) -> tuple[Scene, str]:
        """The scene with the values of the sliders and the legs to the goals, and a text on it."""
        scene = adjusted(self.base, dict(self.moved))
        if not self.goals:
            return scene, scene.description
        goals = [self.goals.get(i) for i in range(len(scene.contacts))]
        left = " Fingers without a goal rest." if None in goals else ""
        left += " Disturbances are left out." if scene.disturbances else ""
        route = reach(scene.replace(disturbances=()), goals)
        legs = sum(leg.length != 0 for own in route.legs for leg in own)
        text = f"{legs} leg{'s' * (legs > 1)}, {route.length:.3g} m in all, to the goal."
        return route.scene, text + left

    def _plan_again(self) -> None:
        """Plan and draw the requested scene."""
        self.stale = False
        scene, text = self._requested()
        planned = plan(scene)
        with self.server.atomic():  # otherwise the browser may draw twice
            self._show(planned)
            self.said.content, self.forget.disabled = _plain(text), not self.goals
            for folder in self.idle:
                folder.visible = not self.goals

    def _show(self, planned: Plan) -> None:
        """Draw a plan, and its slip."""
        self.picture.show(planned, self.goals)
        self.picture.draw(self.now)
        slip = self.picture.slip
        least = max(slip.max() * 10.0**-DECADES, 1e-16)
        self.slip.data = self.picture.t, *np.log10(np.maximum(slip, least)).T
        self.law.disabled = self.gain.disabled = not slip.any()

    def _clicked(self, *ray: np.ndarray) -> None:
        self.clicked = ray
        self.wake.set()

    def _click(self, origin: np.ndarray, direction: np.ndarray) -> None:
        """Make the point where a ray meets the object the goal of the chosen finger."""
        self.clicked = ()
        if (at := self.picture.met(origin, direction)) is None:
            return
        before, i = dict(self.goals), int(self.finger.value.partition(":")[0])
        self.goals[i] = Goal(object_at=at)
        try:
            self._plan_again()
        except ContactSystemError:
            self.goals = before
            raise

    def _save(self) -> None:
        try:
            make_folder(self.file.parent, "name another one with --out")
            moved = self.picture.plan.scene.replace(name=self.file.stem, **NO_CLAIMS)
            save_scene(moved, self.file)
        except ContactSystemError as error:
            self.said.content = f"**Not saved:** {_plain(error)}"
        else:
            self.said.content = f"Wrote {_plain(self.file)}"


def _plain(text: object) -> str:
    """Text for Markdown that shows as it stands: one from a scene could load a picture."""
    return re.sub(r"([!-/:-@[-`{-~])", r"\\\1", str(text))


def _require_free(port: int) -> None:
    try:
        socket.create_server((HOST, port)).close()
    except OSError as error:
        raise ContactSystemError(
            f"port {port}: {error.strerror}; give another one with --port, or 0 for any"
        ) from None
