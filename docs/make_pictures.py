"""Writes the pictures of the pages in docs: viewer.png, live.png, phone.png, demo.png and demo-phone.png.

They are taken in headless Chromium.

    python docs/make_pictures.py      # needs chromium, playwright, Pillow and the extra "play"

The machine may be without a graphics card; then Chromium draws in software.
"""

from __future__ import annotations

import functools
import http.server
import io
import json
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

DOCS = Path(__file__).resolve().parent
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
COLORS = 160  # of a picture's palette, which keeps it small


def main() -> None:
    """Make all pictures."""
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        _viewer(browser, Path(folder))
        _live(browser)
        _demo(browser, Path(folder) / "site")
        browser.close()


def _viewer(browser: Browser, folder: Path) -> None:
    words = "synthesize --types walking:3,cartwheel:2,dance-salsa:3 -o mix.bvh --view".split()
    subprocess.run([sys.executable, "-m", "motionkit", *words], check=True, cwd=folder, env=_quiet())
    made = next(folder.glob("*.html")).as_uri()
    pictures = []
    for seconds, scheme in ((1.0, "light"), (4.35, "dark")):
        page = _page(browser, made, 1000, 680, scheme)
        page.evaluate(f"motionkit.play(false); motionkit.seek({seconds}, true)")
        pictures.append(_shot(page))
    _save("viewer.png", pictures)


def _live(browser: Browser) -> None:
    words = [sys.executable, "-m", "motionkit", "play", "--port", "0", "--no-open", "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            address = json.loads(server.stdout.readline())["url"]
            phones = [_phone(browser, address, scheme) for scheme in ("light", "dark")]
            _save("phone.png", phones)
            page = _page(browser, address, 1280, 760, "dark")
            page.wait_for_function("motionkit.own?.root && motionkit.stage.frames > 5")
            page.keyboard.press("c")
            page.wait_for_function("motionkit.own.now.performing")
            page.wait_for_timeout(1300)
            _save("live.png", [_shot(page)])
        finally:
            server.terminate()


def _demo(browser: Browser, folder: Path) -> None:
    subprocess.run([sys.executable, "-m", "motionkit", "demo", "-o", str(folder)], check=True, env=_quiet())
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/"
        pictures = []
        for scheme in ("light", "dark"):
            page = _page(browser, address, 1280, 760, scheme)
            page.wait_for_function("motionkit.own?.root && motionkit.link.world.frame > 400")
            if scheme == "dark":
                page.keyboard.press("c")
                page.wait_for_function("motionkit.own.now.performing")
                page.wait_for_timeout(1300)
            pictures.append(_shot(page))
        _save("demo.png", pictures)
        _save("demo-phone.png", [_phone(browser, address, scheme) for scheme in ("light", "dark")])
        server.shutdown()


def _phone(browser: Browser, address: str, scheme: str) -> Image.Image:
    page = _page(browser, address, 400, 760, scheme, has_touch=True, is_mobile=True)
    page.wait_for_function("motionkit.own?.root && motionkit.stage.frames > 5")
    if scheme == "light":
        page.get_by_role("button", name="Types", exact=True).tap()
        page.get_by_role("button", name="dance-salsa").tap()
    else:
        session = page.context.new_cdp_session(page)
        for kind, y in (("touchStart", 670), ("touchMove", 620)):
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": 90, "y": y}]})
    page.wait_for_timeout(2500)
    return _shot(page)


def _page(browser: Browser, address: str, width: int, height: int, scheme: Any, **options: Any) -> Page:
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme, bypass_csp=True, **options
    )
    page = context.new_page()
    page.set_default_timeout(150_000)
    page.goto(address)
    page.wait_for_selector("html[data-ready]", state="attached")
    page.add_style_tag(
        content="#pace, #figures { display: none !important }"
    )  # of a busy machine without a graphics card
    return page


def _shot(page: Page) -> Image.Image:
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    page.context.close()
    return picture


def _save(name: str, pictures: list[Image.Image]) -> None:
    """Pictures side by side, of few colours."""
    whole = Image.new("RGB", (sum(one.width for one in pictures), pictures[0].height))
    left = 0
    for one in pictures:
        whole.paste(one, (left, 0))
        left += one.width
    whole.quantize(COLORS, dither=Image.Dither.NONE).save(DOCS / name, optimize=True)
    print(f"{name}: {(DOCS / name).stat().st_size // 1000} kB")


def _quiet() -> dict[str, str]:
    """The environment of commands that must open no browser."""
    import os

    return {**os.environ, "CI": "1"}


if __name__ == "__main__":
    main()
