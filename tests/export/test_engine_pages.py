"""The programs on the page of engines in docs: in Chromium, Node and Godot, each skipped where it is missing."""

from __future__ import annotations

import re
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from export.test_readers import JS, lacking, node, write_avatar  # noqa: F401
from motionkit.editing.root_motion import with_ground_root
from motionkit.export.formats import write_motion
from play.conftest import Running, serve  # noqa: F401
from synthetic_motions import make_walk
from view.conftest import browser, open_page  # noqa: F401

pytestmark = pytest.mark.formats

PAGE = """<!doctype html><link rel="icon" href="data:,"><script type="module" src="page.js"></script>"""
DOCS = Path(__file__).resolve().parents[2] / "docs"


def program(page: str, name: str) -> str:
    """The block of a page with a title."""
    found = re.search(
        rf"^```\w+ title={re.escape(name)}\n(.*?)^```", (DOCS / page).read_text("utf-8"), re.M | re.S
    )
    assert found, f"{page} has no {name}"
    return found[1]


@pytest.fixture
def site(tmp_path: Path) -> Iterator[str]:
    """A web server of tmp_path; its address."""
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    handler.log_message = lambda *words: None  # type: ignore[attr-defined]
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def bundle(folder: Path, name: str, more: str) -> None:
    """A page of a program of my-engine.md, with a line of code after it."""
    (folder / name).write_text(program("my-engine.md", name) + more)
    esbuild = JS / "node_modules" / ".bin" / "esbuild"
    words = [esbuild, name, "--bundle", "--format=esm", "--outfile=page.js", "--log-level=warning"]
    (folder / "node_modules").symlink_to(JS / "node_modules")
    subprocess.run(words, cwd=folder, check=True, timeout=60)
    (folder / "page.html").write_text(PAGE)


READY = "\ndocument.documentElement.dataset.ready = 1;\n"


def test_three_js_shows_the_figure(
    node: str,  # noqa: F811
    site: str,
    open_page: Callable[..., Any],  # noqa: F811
    tmp_path: Path,
) -> None:
    write_motion(tmp_path / "running-cartwheel.glb", make_walk(90))
    bundle(tmp_path, "glb.js", f"{READY} Object.assign(window, {{ renderer, hips }});")
    page = open_page(f"{site}/page.html", 300, 200)
    page.wait_for_function("renderer.info.render.frame > 3")
    assert page.evaluate("renderer.info.render.triangles") > 5000
    z = page.evaluate("hips.getWorldPosition(hips.position.clone()).z")
    page.wait_for_function(f"Math.abs(hips.getWorldPosition(hips.position.clone()).z - {z}) > 0.01")


def test_a_vrm_avatar_dances(node: str, site: str, open_page: Callable[..., Any], tmp_path: Path) -> None:  # noqa: F811
    write_motion(tmp_path / "salsa.vrma", make_walk(90))
    write_avatar(tmp_path / "avatar.vrm", make_walk(2))
    bundle(tmp_path, "vrma.js", f"{READY} Object.assign(window, {{ vrm, update }});")
    page = open_page(f"{site}/page.html", 300, 200)
    place = "vrm.humanoid.getRawBoneNode('hips').getWorldPosition(vrm.scene.position.clone()).z"
    before = page.evaluate(place)
    page.evaluate("update(1.0)")
    assert abs(page.evaluate(place) - before) > 0.3


def lines_of(words: list[str], folder: Path, count: int) -> list[str]:
    """The first lines of numbers that a program prints, which goes on for ever or is stopped after a minute."""
    client = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert client.stdout is not None
    stop = threading.Timer(60, client.kill)
    stop.start()
    said: list[str] = []
    try:
        for line in client.stdout:
            said.append(line)
            if sum(map(is_numbers, said)) == count:
                break
    finally:
        stop.cancel()
        client.kill()
        client.communicate()
    found = [line for line in said if is_numbers(line)]
    assert len(found) == count, f"{words} printed {''.join(said[-20:])!r}"
    return found


def is_numbers(line: str) -> bool:
    """Whether a line begins as a number or a vector does."""
    return re.match(r"\(|\d", line) is not None


@pytest.fixture
def godot(tmp_path: Path) -> str:
    """Godot 3 without a screen, and a project in tmp_path."""
    path = shutil.which("godot3-server")
    if path is None:
        lacking("Godot is missing: apt-get install godot3-server")
    (tmp_path / "project.godot").write_text("config_version=4\n")
    return path


def live_lines(server: Running, folder: Path, page: str, words: list[str]) -> set[str]:
    """What a page's client, the last of the words, prints of 60 live frames."""
    assert server.addresses.tcp is not None
    text = program(page, words[-1]).replace("8643", str(server.addresses.tcp[1]))
    (folder / words[-1]).write_text(text)
    return set(lines_of(words, folder, 60))


def test_node_reads_live_frames(node: str, serve: Callable[..., Running], tmp_path: Path) -> None:  # noqa: F811
    assert len(live_lines(serve(tcp=0), tmp_path, "my-engine.md", [node, "live.mjs"])) > 50


def test_godot_reads_live_frames(godot: str, serve: Callable[..., Running], tmp_path: Path) -> None:  # noqa: F811
    assert len(live_lines(serve(tcp=0), tmp_path, "my-engine.md", [godot, "--script", "live.gd"])) > 30


def import_files(godot: str, folder: Path) -> None:
    """Let the editor import what lies in a project. Now and then it hangs before, and often afterwards."""
    for _ in range(4):
        words = [godot, "--editor", "--quit"]
        with subprocess.Popen(
            words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as editor:
            end = time.monotonic() + 25
            while editor.poll() is None and not imported(folder) and time.monotonic() < end:
                time.sleep(0.2)
            editor.kill()
        if imported(folder):
            return
    raise AssertionError(f"{godot} did not import the files of {folder}")


def imported(folder: Path) -> bool:
    """Whether the editor has written what it makes of a project's files; the checksum comes last."""
    return any(folder.glob(".import/*.md5"))


def test_godot_takes_root_motion(godot: str, tmp_path: Path) -> None:
    write_motion(tmp_path / "walk-loop.glb", with_ground_root(make_walk(90)))
    (tmp_path / "root_motion.gd").write_text(program("my-engine.md", "root_motion.gd"))
    import_files(godot, tmp_path)
    steps = lines_of([godot, "--script", "root_motion.gd"], tmp_path, 30)
    moved = [float(line.strip("()\n").split(",")[2]) for line in steps]
    speed = float(make_walk(90).root_positions[-1, 2] - make_walk(90).root_positions[0, 2]) / 100 / 89
    assert sum(moved) / 30 == pytest.approx(speed, rel=0.15)
