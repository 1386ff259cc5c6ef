"""The page of `motionkit demo` in headless Chromium: sizes, loading, and the time of a picture of 1 and 20 characters.

    python benchmarks/demo.py [--characters 1 20] [--pictures 100]

Script time is what the page's own code takes on its thread for a picture: the model's frames, poses, camera, and
telling WebGL what to draw, here a small picture. It is processor time, which other load on the machine does not count
into; without a graphics card the drawing itself is software in another process. Loading is from a file server on this
machine: until the page has a character in motion, in a browser that has never been there.
"""

from __future__ import annotations

import argparse
import functools
import gzip
import http.server
import shutil
import sys
import tempfile
import threading
from pathlib import Path

from common import print_table
from pages import BUDGET, FLAGS, PATIENCE
from playwright.sync_api import Browser, CDPSession, Page, sync_playwright

from motionkit.models.bundled import load_bundled_model
from motionkit.play.demo import write_demo

LOADS = 5
WARM_UP = 30  # pictures until the browser has compiled what it runs often
MOVES = (
    "window.motionkit?.own?.root && motionkit.stage.frames > 0 && motionkit.link.world.frame > 1 && "
    "performance.now()"
)
# The page's own loop is stopped: every picture is asked for here, a sixtieth of a second after the last.
CROWD = """async (characters) => {
  window.requestAnimationFrame = () => 0;
  while (motionkit.link.world.characters.size < characters) motionkit.add();
  await new Promise((done) => setTimeout(done, 500));
  motionkit.stage.sharpness = 0.05;
  motionkit.stage.resize();
  window.now = performance.now() + 1000;
  window.picture = () => motionkit.tick((now += 1000 / 60), now);
}"""
PICTURES = """async (pictures) => {
  for (let n = 0; n < pictures; n++) {
    picture();
    if (n % 10 === 9) await new Promise((done) => setTimeout(done));
  }
}"""


class _Server(http.server.ThreadingHTTPServer):
    """A server that says nothing of browsers that end before an answer does."""

    def handle_error(self, request: object, client_address: object) -> None:
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--characters", type=int, nargs="+", default=[1, 20])
    parser.add_argument("--pictures", type=int, default=100)
    arguments = parser.parse_args()
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        sizes = write_demo(folder, load_bundled_model())
        packed = {name: len(gzip.compress((Path(folder) / name).read_bytes(), 6)) for name in sizes}
        rows = [[name, f"{size / 1e6:.2f}", f"{packed[name] / 1e6:.2f}"] for name, size in sizes.items()]
        rows.append(["all", f"{sum(sizes.values()) / 1e6:.2f}", f"{sum(packed.values()) / 1e6:.2f}"])
        print_table("the folder, MB", ["file", "as it is", "gzip -6"], rows)
        handler = functools.partial(_Quiet, directory=folder)
        with _Server(("127.0.0.1", 0), handler) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            address = f"http://127.0.0.1:{server.server_port}/"
            browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
            measure(browser, address, arguments.characters, arguments.pictures)
            browser.close()
            server.shutdown()


def measure(browser: Browser, address: str, characters: list[int], pictures: int) -> None:
    """Print how long the page takes to load, and its pictures."""
    loads = [loaded(*visited(browser, address)) for _ in range(LOADS)]
    walls, processors = (sorted(column) for column in zip(*loads, strict=True))
    rows = [
        [name, *(f"{values[n]:.2f}" for n in (0, LOADS // 2, -1))]
        for name, values in (("by the clock", walls), ("processor time of the page", processors))
    ]
    print_table(f"until somebody moves, {LOADS} first visits, s", ["", "least", "median", "most"], rows)
    rows = []
    for count in characters:
        page, told = visited(browser, address)
        page.wait_for_function(MOVES)
        page.evaluate(CROWD, count)
        page.evaluate(PICTURES, WARM_UP)
        before = seconds(told, "TaskDuration")
        page.evaluate(PICTURES, pictures)
        script = 1e3 * (seconds(told, "TaskDuration") - before) / pictures
        page.evaluate("() => { motionkit.stage.renderer.render = motionkit.tick = () => {}; }")
        before = seconds(told, "TaskDuration")
        page.evaluate(
            "(frames) => { for (let n = 0; n < frames; n++) motionkit.link.world.step(); }", pictures
        )
        model = 1e3 * (seconds(told, "TaskDuration") - before) / pictures
        page.context.close()
        rows.append([f"{count}", f"{script:.2f}", f"{model:.2f}", f"{script / BUDGET:.2f}"])
    header = ["characters", "script ms", "of it the model", "share of 1/60 s"]
    print_table("processor time of a picture on the page's thread, 1280 x 720", header, rows)


def visited(browser: Browser, address: str) -> tuple[Page, CDPSession]:
    """The page, in a browser that has kept nothing, and who tells its processor time."""
    page = browser.new_context(viewport={"width": 1280, "height": 720}, bypass_csp=True).new_page()
    page.set_default_timeout(PATIENCE)
    told = page.context.new_cdp_session(page)
    told.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.goto(address, wait_until="commit")
    return page, told


def loaded(page: Page, told: CDPSession) -> tuple[float, float]:
    """Seconds from the visit until somebody moves: by the clock, and of the page's process."""
    passed = page.wait_for_function(MOVES).json_value()
    processor = seconds(told, "ProcessTime")
    page.context.close()
    return 1e-3 * float(passed), processor


def seconds(told: CDPSession, name: str) -> float:
    """One of the times that the browser counts for a page."""
    return next(row["value"] for row in told.send("Performance.getMetrics")["metrics"] if row["name"] == name)


if __name__ == "__main__":
    main()
