"""A headless Chromium, driven by its DevTools protocol over a websocket."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any
from urllib.request import urlopen

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PROGRAM = next(filter(None, map(shutil.which, NAMES)), None)
WORDS = ["--headless", "--no-sandbox", "--no-first-run", "--remote-debugging-port=0"]
WORDS += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


class Chromium:
    """A browser with one page of a size in pixels; ``urls`` are those that the page requested."""

    def __init__(self, url: str, size: tuple[int, int] = (1200, 700)):
        from websockets.sync.client import connect

        assert PROGRAM is not None
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        window = f"--window-size={size[0]},{size[1]}"
        words = [PROGRAM, *WORDS, window, f"--user-data-dir={self.folder.name}", "about:blank"]
        self.process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
        file = Path(self.folder.name) / "DevToolsActivePort"
        self.wait(lambda: file.exists() and file.read_text().count("\n"), 30)
        port = file.read_text().split()[0]
        pages = json.load(urlopen(f"http://127.0.0.1:{port}/json"))
        page = next(page for page in pages if page["type"] == "page")
        self.socket = connect(page["webSocketDebuggerUrl"], max_size=None)
        self.count, self.urls, self.errors = 0, [], []
        for domain in ("Network", "Runtime", "Page"):
            self.ask(f"{domain}.enable")
        self.ask("Page.navigate", url=url)

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()
        self.process.terminate()
        self.process.wait()
        self.folder.cleanup()

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """Send the browser a command; returns its answer."""
        self.count += 1
        self.socket.send(json.dumps({"id": self.count, "method": method, "params": params}))
        while True:
            found = json.loads(self.socket.recv(timeout=60))
            if found.get("id") == self.count:
                assert "error" not in found, found
                return found["result"]
            if found["method"] == "Network.requestWillBeSent":
                self.urls.append(found["params"]["request"]["url"])
            elif found["method"] == "Network.webSocketCreated":
                self.urls.append(found["params"]["url"])
            elif found["method"] == "Runtime.exceptionThrown":
                self.errors.append(found["params"]["exceptionDetails"])

    def run(self, script: str) -> Any:
        """The value of an expression in the page, awaited."""
        asked = {"expression": script, "awaitPromise": True, "returnByValue": True}
        found = self.ask("Runtime.evaluate", **asked)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, reached: Any, seconds: float = 20) -> Any:
        """Wait until a function, or a script in the page, gives a true value; returns this."""
        end = time.monotonic() + seconds
        while not (found := self.run(reached) if isinstance(reached, str) else reached()):
            assert time.monotonic() < end, f"waited {seconds} s for {reached}"
            time.sleep(0.1)
        return found

    def click(self, x: float, y: float) -> None:
        """Press and release the left button at a pixel."""
        self.mouse("mouseMoved", x, y, button="none")
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)

    def mouse(self, kind: str, x: float, y: float, button: str = "left") -> None:
        """One event of the mouse."""
        self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=1)

    def picture(self) -> bytes:
        """A screenshot, PNG."""
        return base64.b64decode(self.ask("Page.captureScreenshot")["data"])
