"""The explorer: from a slider to a new picture, from import to the page that is served."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import contact_system as cs

from .chromium import PROGRAM, Chromium
from .report import Bar, Sections
from .timing import in_new_processes

SERVED = """
import json, time
begin = time.perf_counter()
from pathlib import Path
from urllib.request import urlopen
import contact_system as cs
from contact_system.explorer.page import Explorer
explorer = Explorer(cs.load_scene("K4"), Path("unused"), port=0)
urlopen(explorer.address).read()
print(json.dumps({"s": time.perf_counter() - begin}))
explorer.close()
"""

LIMITS = {"K4": 50.0, "implicit": 100.0}
"""ms, by scene."""

PRESS = """(async () => {
  const now = () => new Promise(done => setTimeout(done, 0));
  const {uplots, rendererInfo} = window.__viserTestpoints;
  const gl = window.__viserMutable.canvas.getContext("webgl2");
  const chart = Object.values(uplots)[0].chart, before = chart.data;
  const thumb = document.querySelectorAll("[role=slider]")[1];
  const key = {key: "ArrowRight", bubbles: true};
  const begin = performance.now();
  thumb.dispatchEvent(new KeyboardEvent("keydown", key));
  while (chart.data === before) await now();
  const frame = rendererInfo.render.frame;
  while (rendererInfo.render.frame === frame) await now();
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  return performance.now() - begin;
})()"""
"""Press a key on the slider of the gain; ms until the plot has new data (and a frame with the old
picture is drawn, as viser reads messages when a frame begins) and the next frame is done."""

EMPTY = """(() => {
  const {scene} = window.__viserMutable;
  scene.traverse(node => { if (node.isMesh || node.isLine) node.visible = false; });
})()"""
"""Hide all objects: the time that an empty picture takes is the browser's, not the page's."""


def served(full: bool) -> Iterator[Bar]:
    """Time from import to page in new processes, with the packages' files in the system's cache."""
    found = in_new_processes(7 if full else 3, SERVED)
    yield Bar("import to page served, K4", 2.0, found["s"], "s")


def browser(full: bool) -> Iterator[Bar]:
    """From a key on the gain's slider to the frame, in headless Chromium with software WebGL."""
    from contact_system.explorer.page import Explorer

    if PROGRAM is None:
        yield Bar("slider to new picture", None, None, note="left out: no Chromium")
        return
    for name, limit in LIMITS.items():
        explorer = Explorer(cs.load_scene(name), Path("unused"), port=0)
        threading.Thread(target=explorer.run, daemon=True).start()
        with Chromium(explorer.address) as page:
            page.wait("Object.keys(window.__viserTestpoints?.uplots ?? {}).length")
            time.sleep(5)  # until the first pictures are there
            picture = _pressed(page, 40 if full else 15)
            page.run(EMPTY)
            empty = _pressed(page, 40 if full else 15)
        explorer.close()
        note = f"software WebGL; an empty picture {empty:.3g}"
        yield Bar(f"slider to new picture, {name}", limit, picture, "ms", note=note)


def _pressed(page: Chromium, times: int) -> float:
    """Median time of a press, ms."""
    found = []
    for _ in range(times):
        found.append(page.run(PRESS))
        time.sleep(0.6)  # viser draws some more pictures
    return statistics.median(found)


SECTIONS: Sections = {"served": served, "browser": browser}
