"""Script time of a picture of the viewer page, and pictures a second, of 1 and 20 figures in headless Chromium.

    python benchmarks/pages.py [--figures 1 20] [--pictures 120]

Script time is what the page's own code takes on its thread: poses, camera, labels, timeline, and telling WebGL what to
draw. Without a graphics card the drawing itself is software in another process, and decides the pictures a second.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

from common import SAMPLE_FOLDER, print_table
from playwright.sync_api import Browser, sync_playwright

from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.view.figure_data import MotionView
from motionkit.view.viewer import write_viewer

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
BUDGET = 1000 / 60  # ms a picture may take at 60 a second
PATIENCE = 300_000  # ms

MEASURE = """async (pictures) => {
  const { stage, timeline } = motionkit, scripts = [];
  motionkit.play(false);
  const began = performance.now();
  for (let n = 0; n < pictures; n++) {
    const started = performance.now();
    motionkit.seek((n / 60) % timeline.seconds);
    stage.invalidate();
    stage.draw();
    scripts.push(performance.now() - started);
    await new Promise((done) => requestAnimationFrame(done));
  }
  return { scripts, rate: (1000 * pictures) / (performance.now() - began) };
}"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figures", type=int, nargs="+", default=[1, 20])
    parser.add_argument("--pictures", type=int, default=120)
    arguments = parser.parse_args()
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    rows = []
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        for count in arguments.figures:
            median, late, rate = measured(browser, Path(folder), count, arguments.pictures)
            share = f"{median / BUDGET:.2f}"
            rows.append([f"{count}", f"{median:.2f}", f"{late:.2f}", share, f"{rate:.0f}"])
        browser.close()
    header = ["figures", "script ms, median", "95 %", "share of 1/60 s", "pictures/s, drawn in software"]
    print_table("pictures of the viewer page, 1280 x 720", header, rows)


def measured(browser: Browser, folder: Path, count: int, pictures: int) -> tuple[float, float, float]:
    """Median and 95th percentile of the script time in ms, and pictures a second."""
    motion = bvh_to_motion(read_bvh(SAMPLE_FOLDER / "16_05.bvh"))
    page_file = folder / f"{count}.html"
    write_viewer(page_file, [MotionView(f"{n + 1}", motion) for n in range(count)])
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    page.set_default_timeout(PATIENCE)
    page.goto(page_file.as_uri())
    page.wait_for_selector("html[data-ready]", state="attached")
    told = page.evaluate(MEASURE, pictures)
    page.close()
    scripts = sorted(told["scripts"])
    return scripts[len(scripts) // 2], scripts[int(0.95 * len(scripts))], told["rate"]


if __name__ == "__main__":
    main()
