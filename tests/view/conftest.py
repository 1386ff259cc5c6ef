"""A real browser for the tests of pages."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NoReturn

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PATIENCE = 150_000  # ms; the browser draws in software here, on a machine that may be slow and busy
# Software rendering: test machines have no graphics card.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]


def _lacking(what: str) -> NoReturn:
    """Skip, or fail where the tests of pages must run (.ci/run says so)."""
    if os.environ.get("MOTIONKIT_BROWSER_TESTS") == "required":
        pytest.fail(f"{what}, and MOTIONKIT_BROWSER_TESTS=required")
    pytest.skip(f"{what}; apt-get install chromium, pip install playwright")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Headless Chromium, one for each module of tests."""
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        _lacking("no Chromium is installed")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        _lacking("playwright is not installed")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def open_page(browser: Browser) -> Iterator[Callable[..., Page]]:
    """A function that opens an address in a fresh context, waits until the page is ready, and gives it.

    At the end it sees that no page has logged an error.
    """
    contexts = []
    faults: list[str] = []

    def start(address: str, width: int = 800, height: int = 560, **options: Any) -> Page:
        # playwright waits for conditions with eval, which the pages' own policy forbids.
        context = browser.new_context(viewport={"width": width, "height": height}, bypass_csp=True, **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
        page.goto(address)
        page.wait_for_selector("html[data-ready]", state="attached")
        return page

    yield start
    for context in contexts:
        context.close()
    assert not faults, faults


def drawn(page: Page) -> None:
    """Return once what the page was told before is on the screen, however long a picture takes."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
