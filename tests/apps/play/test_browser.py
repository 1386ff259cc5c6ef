"""The page of `motionkit play` in a real browser against the real server and the bundled model."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from motionkit.motion.bvh import bvh_to_motion, read_bvh

if TYPE_CHECKING:
    from playwright.sync_api import Page

PATIENCE = 50_000  # ms; the browser draws in software here, on a machine that may be busy


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """Where `motionkit play` serves its page, in a process of its own."""
    words = [sys.executable, "-m", "motionkit", "play", "--port", "0", "--no-open", "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None and server.stderr is not None
        yield json.loads(server.stdout.readline())["url"]
        server.terminate()
        assert server.stderr.read().strip().endswith("stopped")
    assert server.returncode == 0


@pytest.fixture(scope="module")
def join(address: str, open_page: Callable) -> Callable[..., Page]:
    """A function that opens the page and waits until its character stands there."""

    def start() -> Page:
        page = open_page(address, 520, 380)
        page.wait_for_function("motionkit.own?.root", timeout=PATIENCE)
        return page

    return start


@pytest.fixture(scope="module")
def joined(join: Callable[..., Page]) -> Page:
    """A page of the session."""
    return join()


@pytest.fixture
def page(joined: Page) -> Page:
    """The same, its character standing where it was first put."""
    joined.evaluate("motionkit.commands.Backspace()")
    wait_frames(joined, 20)
    return joined


def wait_frames(page: Page, frames: int) -> None:
    """Let the session go on for so many frames."""
    now = page.evaluate("motionkit.newest.number")
    page.wait_for_function(f"motionkit.newest.number >= {now + frames}", timeout=PATIENCE)


def place(page: Page) -> tuple[float, float]:
    """x, z of one's own character in metres, in the newest frame."""
    root = page.evaluate("Array.from(motionkit.newest.characters.get(motionkit.chosen).root)")
    return root[0] / 100, root[2] / 100


def camera_way(page: Page) -> tuple[float, float]:
    """The direction the camera looks in, on the ground."""
    x, z = page.evaluate(
        "(({camera, controls}) => [controls.target.x - camera.position.x, controls.target.z - camera.position.z])"
        "(motionkit.stage)"
    )
    return x / math.hypot(x, z), z / math.hypot(x, z)


def test_w_goes_where_the_camera_looks_and_release_stops(page: Page) -> None:
    start, ahead = place(page), camera_way(page)
    page.keyboard.down("w")
    wait_frames(page, 150)
    end = place(page)
    page.keyboard.up("w")
    moved = end[0] - start[0], end[1] - start[1]
    assert moved[0] * ahead[0] + moved[1] * ahead[1] > 1.0, "two seconds of walking"
    assert abs(moved[0] * ahead[1] - moved[1] * ahead[0]) < 0.8, "and hardly to a side"
    wait_frames(page, 120)
    stopped = place(page)
    wait_frames(page, 60)
    assert math.dist(stopped, place(page)) < 0.15


def test_what_is_left_on_the_screen_is_left_in_the_world(page: Page) -> None:
    start, ahead = place(page), camera_way(page)
    page.keyboard.down("ArrowLeft")
    wait_frames(page, 120)
    end = place(page)
    page.keyboard.up("ArrowLeft")
    left = ahead[1], -ahead[0]  # +X is to the left of one who looks along +Z
    assert (end[0] - start[0]) * left[0] + (end[1] - start[1]) * left[1] > 0.5


def test_shift_is_faster(page: Page) -> None:
    page.keyboard.down("Shift")
    page.keyboard.down("w")
    page.wait_for_function("motionkit.sent && Math.hypot(...motionkit.sent.velocity) > 200", timeout=PATIENCE)
    page.keyboard.up("Shift")
    page.wait_for_function("Math.hypot(...motionkit.sent.velocity) < 200", timeout=PATIENCE)
    page.keyboard.up("w")
    page.wait_for_function("Math.hypot(...motionkit.sent.velocity) === 0", timeout=PATIENCE)


def test_the_cartwheel_key_brings_the_head_below_the_hips(page: Page) -> None:
    page.evaluate(
        """() => {
          motionkit.lowest = 9;
          const pose = motionkit.own.pose.constructor, own = motionkit.own, spare = new pose(own.rig.count);
          const frame = motionkit.link.listeners.frame;
          motionkit.link.listeners.frame = (one, at) => {
            const now = one.characters.get(motionkit.chosen);
            if (now) spare.set(own.rig, now.rotations, 0, now.root.map((v) => v / 100), 0);
            motionkit.lowest = Math.min(motionkit.lowest, spare.places[14 * 3 + 1] - spare.places[1]);
            frame(one, at);
          };
        }"""
    )
    wait_frames(page, 10)
    assert page.evaluate("motionkit.lowest") > 0.3, "it stands"
    page.keyboard.press("c")
    page.wait_for_function("motionkit.lowest < -0.1", timeout=PATIENCE)
    assert page.evaluate("motionkit.responses.length") > 0, "the response was measured"


def test_a_drawn_path_is_followed(page: Page) -> None:
    page.evaluate("motionkit.stage.look(motionkit.stage.controls.target.clone(), 0.5, 1.0, 7)")
    wait_frames(page, 5)
    page.keyboard.press("p")
    box = page.locator("#scene").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.55
    page.mouse.move(x, y)
    page.mouse.down()
    for n in range(1, 13):
        page.mouse.move(x - 14 * n, y - 4 * n)
    points = page.evaluate("Array.from(motionkit.ribbon.geometry.attributes.position.array)")
    page.mouse.up()
    page.keyboard.press("p")
    assert page.evaluate("motionkit.pathOf === motionkit.chosen")
    middle = [
        ((points[i] + points[i + 3]) / 2, (points[i + 2] + points[i + 5]) / 2)
        for i in range(0, len(points), 6)
    ]
    assert math.dist(middle[0], middle[-1]) > 1.0
    track = []
    for _ in range(60):
        wait_frames(page, 12)
        track.append(place(page))
        if page.evaluate("motionkit.pathOf === null"):
            break
    assert page.evaluate("motionkit.pathOf === null"), "it arrived"
    assert math.dist(track[-1], middle[-1]) < 0.6
    near = [min(math.dist(point, step) for step in track) for point in middle]
    assert max(near) < 0.6, "it came by every point"


def test_a_recording_is_downloaded_and_is_a_motion(page: Page, tmp_path: Path) -> None:
    page.keyboard.press("o")
    page.wait_for_function("motionkit.told.get(motionkit.chosen).recording", timeout=PATIENCE)
    wait_frames(page, 45)
    with page.expect_download(timeout=PATIENCE) as download:
        page.keyboard.press("o")
    file = tmp_path / "recording.bvh"
    download.value.save_as(file)
    motion = bvh_to_motion(read_bvh(file))
    assert len(motion.skeleton) == 23 and len(motion) >= 45 and motion.fps == 60


def test_two_clients_see_each_other_and_steer_their_own(page: Page, join: Callable[..., Page]) -> None:
    other = join()
    page.wait_for_function("motionkit.characters.size === 2", timeout=PATIENCE)
    mine, theirs = (p.evaluate("motionkit.chosen") for p in (page, other))
    assert mine != theirs and other.evaluate("motionkit.mine") == [theirs]
    before = place(page)
    other.keyboard.down("w")
    wait_frames(other, 90)
    other.keyboard.up("w")
    assert math.dist(before, place(page)) < 0.3
    other.close()
    page.wait_for_function("motionkit.characters.size === 1", timeout=PATIENCE)


def test_characters_bodies_and_noise(page: Page) -> None:
    page.keyboard.press("n")
    page.wait_for_function("motionkit.mine.length === 2 && motionkit.characters.size === 2", timeout=PATIENCE)
    first, second = page.evaluate("motionkit.mine")
    page.keyboard.press("Tab")
    assert page.evaluate("motionkit.chosen") == second
    name = page.evaluate("motionkit.hello.bodies[1].name")
    page.get_by_label("Body").select_option(name)
    page.wait_for_function(
        f"motionkit.characters.get({second})?.body === {json.dumps(name)}", timeout=PATIENCE
    )
    page.get_by_label("Noise").fill("0.8")
    page.wait_for_function(f"motionkit.told.get({second}).temperature === 0.8", timeout=PATIENCE)
    page.get_by_role("button", name=f"Remove character {second}").dispatch_event("click")
    page.wait_for_function(
        f"motionkit.chosen === {first} && motionkit.characters.size === 1", timeout=PATIENCE
    )


def test_garbage_from_the_server_does_no_harm(page: Page) -> None:
    page.evaluate(
        """() => {
          const take = (data) => motionkit.link.socket.onmessage({ data });
          for (const size of [0, 3, 24, 420, 1000]) {
            take(crypto.getRandomValues(new Uint8Array(size)).buffer);
            take(new Uint8Array(size).buffer);
          }
          take(JSON.stringify({ event: "of a later version", fields: [1, 2] }));
          take(JSON.stringify({ event: "arrived", character: 999 }));
        }"""
    )
    wait_frames(page, 10)
    assert page.evaluate("motionkit.own.figure.visible")


def test_the_page_says_when_the_machine_falls_behind(page: Page) -> None:
    said = {"event": "pace", "behind": True, "fps": 41.3, "step_ms": 22.0}
    page.evaluate("(event) => motionkit.link.listeners.event(event)", said)
    assert "falls behind" in page.locator("#pace").inner_text()
    assert "of 60 frames a second" in page.locator("#pace").inner_text()
    page.evaluate("(event) => motionkit.link.listeners.event(event)", said | {"behind": False})
    assert page.locator("#pace").is_hidden()


def test_it_measures(page: Page) -> None:
    wait_frames(page, 30)
    page.wait_for_function("document.querySelectorAll('#figures b').length === 5", timeout=PATIENCE)
    words = page.locator("#figures").inner_text()
    assert all(name in words for name in ("step", "frames made", "frames drawn", "network", "response"))


def test_a_lost_connection_is_told_and_found_again(page: Page) -> None:
    page.evaluate("motionkit.link.socket.send('no request')")
    page.wait_for_function("!document.getElementById('notice').hidden", timeout=PATIENCE)
    assert "lost" in page.locator("#notice").inner_text()
    page.wait_for_function(
        "document.getElementById('notice').hidden && motionkit.own?.root", timeout=PATIENCE
    )
    wait_frames(page, 5)
