"""The page of `motionkit play` in a real browser against the real server and the bundled model."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image

from motionkit.models.bundled import BUNDLED_MODEL
from motionkit.models.checkpoint import load_model, save_model
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from view.conftest import PATIENCE, drawn

pytestmark = pytest.mark.thorough

if TYPE_CHECKING:
    from playwright.sync_api import Page


@pytest.fixture(scope="module", autouse=True)  # the first to start and the last to stop: pages look for it
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of `motionkit play` in a separate process, with three of the bundled model's bodies."""
    model, file = load_model(BUNDLED_MODEL), tmp_path_factory.mktemp("browser") / "few.safetensors"
    save_model(file, replace(model, characters=dict(list(model.characters.items())[:3])), half=True)
    words = [sys.executable, "-m", "motionkit", "play", "--model", str(file)]
    words += ["--port", "0", "--no-open", "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None and server.stderr is not None
        try:
            yield json.loads(server.stdout.readline())["url"]
            server.terminate()
            assert server.communicate(timeout=PATIENCE / 1000)[1].strip().endswith("stopped")
        finally:
            server.kill()
    assert server.returncode == 0


@pytest.fixture(scope="module")
def join(address: str, open_page: Callable) -> Callable[..., Page]:
    """A function that opens the page and waits until its character stands there.

    Unless it is to be seen, it draws no more then: what software takes to draw, the server would lack.
    """

    def start(seen: bool = False) -> Page:
        page = open_page(address, 720, 500)
        page.wait_for_function("motionkit.own?.root && motionkit.stage.frames > 0", timeout=PATIENCE)
        if not seen:
            page.evaluate("motionkit.stage.renderer.render = () => {}")
        return page

    return start


@pytest.fixture(scope="module")
def joined(join: Callable[..., Page]) -> Iterator[Page]:
    """A page of the session, closed before the server stops, which it would look for in vain."""
    page = join()
    yield page
    page.close()


@pytest.fixture
def page(joined: Page) -> Page:
    """The same page, with its character back at its start place."""
    joined.evaluate(
        """() => new Promise((done) => {
          const { socket } = motionkit.link, stamp = Date.now() + 0.5;
          socket.addEventListener("message", function heard({ data }) {
            if (typeof data !== "string" || JSON.parse(data).stamp !== stamp) return;
            socket.removeEventListener("message", heard);
            done();
          });
          motionkit.commands.Backspace();
          socket.send(JSON.stringify({ do: "ping", stamp })); // answered when all that was asked before is done
        })"""
    )
    wait_frames(joined, 20)
    return joined


def wait_frames(page: Page, frames: int) -> None:
    """Wait for this many frames."""
    now = page.evaluate("motionkit.newest.number")
    page.wait_for_function(f"motionkit.newest.number >= {now + frames}", timeout=PATIENCE)


def place(page: Page) -> tuple[float, float]:
    """x, z of the page's character in metres, in the newest frame."""
    root = page.evaluate("Array.from(motionkit.newest.characters.get(motionkit.chosen).root)")
    return root[0] / 100, root[2] / 100


def camera_way(page: Page) -> tuple[float, float]:
    """The camera's view direction on the ground."""
    x, z = page.evaluate(
        "(({camera, controls}) => [controls.target.x - camera.position.x, controls.target.z - camera.position.z])"
        "(motionkit.stage)"
    )
    return x / math.hypot(x, z), z / math.hypot(x, z)


def test_the_character_is_drawn(join: Callable[..., Page]) -> None:
    page = join(seen=True)

    def colours() -> set[tuple[int, ...]]:
        wait_frames(page, 10)
        drawn(page)
        with Image.open(BytesIO(page.locator("#scene").screenshot(timeout=PATIENCE))) as picture:
            return {colour for _, colour in picture.convert("RGB").getcolors(1 << 20)}

    with_character = colours()
    page.evaluate(
        "motionkit.own.figure.visible = false; motionkit.stage.renderer.shadowMap.needsUpdate = true"
    )
    page.evaluate("motionkit.link.around = () => null")
    bluish = [c for c in with_character - colours() if c[2] > c[0] + 60]
    assert len(bluish) > 20, "a lit body in the colour of one's first character"
    page.close()


def test_w_goes_where_the_camera_looks_and_release_stops(page: Page) -> None:
    start, ahead = place(page), camera_way(page)
    page.keyboard.down("w")
    asked_speed(page, "> 0")
    wait_frames(page, 150)
    end = place(page)
    page.keyboard.up("w")
    asked_speed(page, "=== 0")
    moved = end[0] - start[0], end[1] - start[1]
    assert moved[0] * ahead[0] + moved[1] * ahead[1] > 1.0, "two seconds of walking"
    assert abs(moved[0] * ahead[1] - moved[1] * ahead[0]) < 0.8, "and hardly to a side"
    wait_frames(page, 120)
    stopped = place(page)
    wait_frames(page, 60)
    assert math.dist(stopped, place(page)) < 0.15


PAD = """() => {
  const button = () => ({ pressed: false, touched: false, value: 0 });
  window.pad = {
    id: "pad of a test", index: 1, connected: true, mapping: "standard", timestamp: 0,
    axes: [0, 0, 0, 0], buttons: Array.from({ length: 17 }, button),
  };
  navigator.getGamepads = () => [null, window.pad, null, null];
  const event = new Event("gamepadconnected");
  event.gamepad = window.pad;
  dispatchEvent(event);
}"""


@pytest.fixture
def pad(page: Page) -> Iterator[Callable[..., None]]:
    """A gamepad at the page; the function moves its sticks and holds buttons: pad(axes=[0, -1, 0, 0], buttons=[7])."""
    page.evaluate(PAD)

    def move(axes: Sequence[float] = (0, 0, 0, 0), buttons: Sequence[int] = ()) -> None:
        page.evaluate(
            "([axes, held]) => { pad.axes = axes; pad.buttons.forEach((b, n) => { b.pressed = held.includes(n); }); }",
            [list(axes), list(buttons)],
        )

    yield move
    page.evaluate("window.pad = null")


def asked_speed(page: Page, holds: str) -> None:
    """Wait until the last requested speed in cm/s meets a condition."""
    page.wait_for_function(
        f"motionkit.sent && Math.hypot(...motionkit.sent.velocity) {holds}", timeout=PATIENCE
    )


def test_a_stick_goes_where_the_camera_looks(page: Page, pad: Callable[..., None]) -> None:
    assert "pad of a test" in page.locator("#hint").inner_text()
    start, ahead = place(page), camera_way(page)
    pad(axes=[0.1, -0.1, 0, 0])
    drawn(page)
    asked_speed(page, "=== 0")  # sticks at rest are never quite at 0
    pad(axes=[0, -1, 0, 0])
    asked_speed(page, "> 0")
    wait_frames(page, 120)
    end = place(page)
    pad()
    moved = end[0] - start[0], end[1] - start[1]
    assert moved[0] * ahead[0] + moved[1] * ahead[1] > 0.7
    assert abs(moved[0] * ahead[1] - moved[1] * ahead[0]) < 0.8
    asked_speed(page, "=== 0")


def test_how_far_the_stick_is_pushed_is_how_fast(page: Page, pad: Callable[..., None]) -> None:
    walking, running = (page.evaluate(f"motionkit.speeds.{name}") for name in ("walking", "running"))
    pad(axes=[0.6, 0, 0, 0])
    asked_speed(page, f"> 0.4 * {walking} && Math.hypot(...motionkit.sent.velocity) < 0.6 * {walking}")
    pad(axes=[0.9, 0.9, 0, 0])  # square corners of round sticks
    asked_speed(page, f"> 0.99 * {walking} && Math.hypot(...motionkit.sent.velocity) < 1.01 * {walking}")
    for button in (5, 7):
        pad(axes=[-1, 0, 0, 0], buttons=[button])
        asked_speed(page, f"> 0.99 * {running}")
        pad(axes=[-1, 0, 0, 0])
        asked_speed(page, f"< 1.01 * {walking}")


def test_the_cross_goes_as_the_keys_do(page: Page, pad: Callable[..., None]) -> None:
    for button, key in ((12, "w"), (13, "s"), (14, "a"), (15, "d")):
        pad(buttons=[button])
        asked_speed(page, "> 0")
        by_pad = page.evaluate("motionkit.sent.velocity")
        pad()
        asked_speed(page, "=== 0")
        page.keyboard.down(key)
        asked_speed(page, "> 0")
        assert page.evaluate("motionkit.sent.velocity") == pytest.approx(by_pad, abs=1.0)
        page.keyboard.up(key)
        asked_speed(page, "=== 0")


def test_the_right_stick_looks_around(page: Page, pad: Callable[..., None]) -> None:
    before, height = camera_way(page), page.evaluate("motionkit.stage.camera.position.y")
    pad(axes=[0, 0, 1, 0])
    right = "(({camera, controls}) => [controls.target.x - camera.position.x, controls.target.z - camera.position.z])"
    page.wait_for_function(
        f"(([x, z]) => x * {-before[1]} + z * {before[0]} > 0.3 * Math.hypot(x, z))({right}(motionkit.stage))",
        timeout=PATIENCE,
    )
    pad(axes=[0, 0, 0, 1])
    page.wait_for_function(f"motionkit.stage.camera.position.y > {height + 0.3}", timeout=PATIENCE)
    pad(axes=[0, 0, 0, -1])
    page.wait_for_function(f"motionkit.stage.camera.position.y < {height}", timeout=PATIENCE)
    pad()
    drawn(page)
    still = camera_way(page)
    wait_frames(page, 10)
    assert camera_way(page) == pytest.approx(still, abs=1e-3)


def test_buttons_show_types_once_a_press_and_record(page: Page, pad: Callable[..., None]) -> None:
    page.evaluate(
        """() => {
          window.asked = [];
          const ask = motionkit.link.ask;
          motionkit.link.ask = function (what, fields, ...more) {
            if (what !== "ping") asked.push([what, fields]);
            return ask.call(this, what, fields, ...more);
          };
        }"""
    )
    shown = page.evaluate("Array.from(motionkit.typeButtons.keys())")
    seconds = {t["name"]: t["seconds"] for t in page.evaluate("motionkit.hello.types")}
    pad(buttons=[0])
    page.wait_for_function(f"motionkit.own.now.type === {type_index(page, shown[0])}", timeout=PATIENCE)
    wait_frames(page, 10)
    pad()
    asked = [fields.get("type") for _, fields in page.evaluate("asked")]
    assert asked.count(shown[0]) == 1, "held, it is one press"
    assert seconds[shown[0]] > 0, "performances come first"
    page.wait_for_function("!motionkit.own.now.performing", timeout=PATIENCE)
    pad(buttons=[9])
    page.wait_for_function("motionkit.facts.get(motionkit.chosen).recording", timeout=PATIENCE)
    pad()
    wait_frames(page, 10)
    with page.expect_download(timeout=PATIENCE):
        pad(buttons=[9])
        page.wait_for_function("!motionkit.facts.get(motionkit.chosen).recording", timeout=PATIENCE)
    pad(buttons=[4, 6, 8, 10, 16])
    wait_frames(page, 10)
    asked = [what for what, _ in page.evaluate("asked")]
    assert asked.count("record") == 2 and asked.count("perform") == 1
    page.evaluate("delete motionkit.link.ask")


def type_index(page: Page, name: str) -> int:
    """The number of a type in frames."""
    return [t["name"] for t in page.evaluate("motionkit.hello.types")].index(name)


@pytest.mark.parametrize(
    "fault",
    [
        "pad.mapping = ''; pad.axes = [-1, -1, -1, -1]",  # where triggers lie on axes
        "pad.connected = false; pad.axes = [1, 1, 1, 1]",
        "pad.axes = []; pad.buttons = []",
        "navigator.getGamepads = () => []",
        "document.hasFocus = () => false; pad.axes = [1, 1, 1, 1]",
    ],
)
def test_a_gamepad_that_cannot_steer_does_nothing(page: Page, pad: Callable[..., None], fault: str) -> None:
    looked = camera_way(page)
    page.evaluate(fault)
    drawn(page)
    wait_frames(page, 10)
    asked_speed(page, "=== 0")
    assert camera_way(page) == pytest.approx(looked, abs=1e-3)
    page.evaluate("delete document.hasFocus")


def test_a_pulled_out_gamepad_stops(page: Page, pad: Callable[..., None]) -> None:
    pad(axes=[0, 1, 0, 0])
    asked_speed(page, "> 0")
    page.evaluate("window.pad = null")
    asked_speed(page, "=== 0")


def test_a_hidden_page_lets_go_of_the_keys(page: Page) -> None:
    page.keyboard.down("w")
    asked_speed(page, "> 0")
    page.evaluate(
        """() => {
          window.usual = requestAnimationFrame;
          requestAnimationFrame = (next) => { window.next = next; }; // a hidden page is asked for no pictures
          document.dispatchEvent(new Event("visibilitychange"));
        }"""
    )
    assert page.evaluate("motionkit.sent.velocity") == [0, 0]
    page.keyboard.up("w")
    page.wait_for_function("!!window.next", polling=50, timeout=PATIENCE)
    page.evaluate("requestAnimationFrame = window.usual; requestAnimationFrame(window.next)")


def test_what_is_left_on_the_screen_is_left_in_the_world(page: Page) -> None:
    start, ahead = place(page), camera_way(page)
    page.keyboard.down("ArrowLeft")
    asked_speed(page, "> 0")
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
            motionkit.lowest = Math.min(motionkit.lowest, spare.places[14].y - spare.places[0].y);
            frame(one, at);
          };
        }"""
    )
    wait_frames(page, 10)
    assert page.evaluate("motionkit.lowest") > 0.3, "it stands"
    page.keyboard.press("c")
    page.wait_for_function("motionkit.lowest < -0.1", timeout=PATIENCE)
    page.wait_for_function("motionkit.responses.length > 0", timeout=PATIENCE)  # the response was measured


def test_a_drawn_path_is_followed(page: Page) -> None:
    page.evaluate("motionkit.stage.look(motionkit.stage.controls.target.clone(), 0.5, 1.0, 7)")
    drawn(page)
    page.evaluate(
        """() => {
          motionkit.track = []; // of every frame: a slow page may see few of them between two questions
          const frame = motionkit.link.listeners.frame;
          motionkit.link.listeners.frame = (one, at) => {
            const root = one.characters.get(motionkit.chosen)?.root;
            if (root) motionkit.track.push([root[0] / 100, root[2] / 100]);
            frame(one, at);
          };
        }"""
    )
    page.keyboard.press("p")
    box = page.locator("#scene").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.55
    page.mouse.move(x, y)
    page.mouse.down()
    for n in range(1, 13):
        page.mouse.move(x - 14 * n, y - 4 * n)
    points = page.evaluate("Array.from(motionkit.stroke.geometry.attributes.position.array)")
    page.mouse.up()
    page.keyboard.press("p")
    assert page.evaluate("motionkit.paths.has(motionkit.chosen) && motionkit.stroke === null")
    middle = [
        ((points[i] + points[i + 3]) / 2, (points[i + 2] + points[i + 5]) / 2)
        for i in range(0, len(points), 6)
    ]
    assert math.dist(middle[0], middle[-1]) > 1.0
    page.wait_for_function("motionkit.paths.size === 0", timeout=PATIENCE)  # it arrived
    track = page.evaluate("motionkit.track")
    assert math.dist(track[-1], middle[-1]) < 0.6
    near = [min(math.dist(point, step) for step in track) for point in middle]
    assert max(near) < 0.6, "it came by every point"


def test_a_recording_is_downloaded_and_is_a_motion(page: Page, tmp_path: Path) -> None:
    page.keyboard.press("o")
    page.wait_for_function("motionkit.facts.get(motionkit.chosen).recording", timeout=PATIENCE)
    wait_frames(page, 45)
    with page.expect_download(timeout=PATIENCE) as download:
        page.keyboard.press("o")
    file = tmp_path / "recording.bvh"
    download.value.save_as(file)
    motion = bvh_to_motion(read_bvh(file))
    assert len(motion.skeleton) == 23 and len(motion) >= 45 and motion.fps == 60
    assert "BVH again" in page.locator("#hint").inner_text()


def test_the_page_names_the_format_of_recordings(page: Page) -> None:
    names = page.evaluate(
        """() => {
          const { listeners, hello } = motionkit.link, character = motionkit.chosen;
          const names = ["usda", "bvh"].map((format) => {
            listeners.hello({ ...hello, recording_format: format });
            return motionkit.recordButton.title;
          });
          const url = URL.createObjectURL(new Blob(["glTF"]));
          listeners.event({ event: "recorded", character, url, format: "glb", frames: 1, seconds: 1 });
          const link = document.querySelector("#hint a");
          return [...names, link.textContent, link.download];
        }"""
    )
    assert "download as USDA" in names[0] and "download as BVH" in names[1]
    assert names[2:] == ["GLB again", "motionkit-recording.glb"]


def test_two_clients_see_each_other_and_steer_their_own(page: Page, join: Callable[..., Page]) -> None:
    other = join()
    page.wait_for_function("motionkit.characters.size === 2", timeout=PATIENCE)
    mine, theirs = (p.evaluate("motionkit.chosen") for p in (page, other))
    assert mine != theirs and other.evaluate("motionkit.mine") == [theirs]
    before, theirs_before = place(page), place(other)
    other.keyboard.down("w")
    asked_speed(other, "> 0")
    wait_frames(other, 90)
    other.keyboard.up("w")
    wait_frames(page, 1)
    assert math.dist(before, place(page)) < 0.3 < math.dist(theirs_before, place(other))
    other.close()
    page.wait_for_function("motionkit.characters.size === 1", timeout=PATIENCE)


def test_characters_bodies_and_noise(page: Page) -> None:
    page.keyboard.press("n")
    page.wait_for_function("motionkit.mine.length === 2 && motionkit.characters.size === 2", timeout=PATIENCE)
    first, second = page.evaluate("motionkit.mine")
    page.keyboard.press("Tab")
    assert page.evaluate("motionkit.chosen") == second
    # Where a browser begins depends on what was used last, and from the first or last button on it leaves the page.
    focused = "document.activeElement.closest('button, select, input')?.outerHTML"
    reached: list[str] = []
    for _ in range(12):
        page.keyboard.press("Shift+Tab")
        reached = [*reached, now] if (now := page.evaluate(focused)) else []
        if len(reached) == 3:
            break
    page.keyboard.press("Tab")
    assert len(reached) == 3
    assert page.evaluate(focused) == reached[1] != reached[0], "the buttons are within reach of the keyboard"
    assert page.evaluate("motionkit.chosen") == second
    page.evaluate("document.activeElement.blur()")
    name = page.evaluate("motionkit.hello.bodies[1].name")
    page.get_by_label("Body").select_option(name)
    page.wait_for_function(
        f"motionkit.characters.get({second})?.body === {json.dumps(name)}", timeout=PATIENCE
    )
    page.get_by_label("Noise").fill("0.8")
    page.wait_for_function(f"motionkit.facts.get({second}).temperature === 0.8", timeout=PATIENCE)
    page.get_by_role("button", name=f"Remove character {second}").dispatch_event("click")
    page.wait_for_function(
        f"motionkit.chosen === {first} && motionkit.characters.size === 1", timeout=PATIENCE
    )


def test_who_is_left_stops_or_goes_on_dancing(page: Page) -> None:
    page.keyboard.press("n")
    page.wait_for_function("motionkit.mine.length === 2 && motionkit.characters.size === 2", timeout=PATIENCE)
    page.evaluate(
        """() => {
          motionkit.wishes = [];
          const ask = motionkit.link.ask.bind(motionkit.link);
          motionkit.link.ask = (what, fields, counted) => {
            if (what === "wish") motionkit.wishes.push([fields.character, fields.type, fields.velocity]);
            return ask(what, fields, counted);
          };
        }"""
    )
    first, second = page.evaluate("motionkit.mine")
    page.evaluate("motionkit.perform('dance-salsa')")
    page.wait_for_function("motionkit.sent?.type === 'dance-salsa'", timeout=PATIENCE)
    page.keyboard.press("Tab")
    page.keyboard.down("w")
    page.wait_for_function("motionkit.sent?.velocity?.some(Boolean)", timeout=PATIENCE)
    page.keyboard.press("Tab")
    page.keyboard.up("w")
    assert page.evaluate("motionkit.chosen") == first
    wishes = page.evaluate("motionkit.wishes")
    assert [0, 0] == next(velocity for who, _, velocity in reversed(wishes) if who == second)
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    wait_frames(page, 20)
    assert page.evaluate("motionkit.mode") == "dance-salsa" or any(
        velocity and any(velocity) for who, _, velocity in page.evaluate("motionkit.wishes") if who == first
    ), "it dances until it is steered"


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


def test_the_page_steers_with_the_token_of_its_address(serve: Callable, open_page: Callable) -> None:
    server = serve(host="0.0.0.0")
    port = server.addresses.url.rpartition(":")[2]
    page = open_page(f"http://127.0.0.1:{port}", 320, 240)
    page.wait_for_function("motionkit.own?.root", timeout=PATIENCE)
    page.close()  # it would look in vain for the server, which ends with this test


@pytest.fixture(scope="module")
def phone(address: str, open_page: Callable) -> Iterator[Page]:
    """The page on a phone's screen."""
    page = open_page(address, 400, 760, has_touch=True, is_mobile=True)
    page.wait_for_function("motionkit.own?.root && motionkit.stage.frames > 0", timeout=PATIENCE)
    page.evaluate("motionkit.stage.renderer.render = () => {}")
    yield page
    page.close()


@pytest.fixture
def touch(phone: Page) -> Callable[..., None]:
    """A function that puts fingers on the phone's screen, moves or lifts them: touch("touchMove", (x, y))."""
    session = phone.context.new_cdp_session(phone)

    def send(kind: str, *points: tuple[float, float]) -> None:
        places = [{"x": x, "y": y} for x, y in points]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

    return send


def test_a_thumb_on_the_stick_steers_and_past_its_rim_runs(phone: Page, touch: Callable[..., None]) -> None:
    zone = phone.locator("#stick").bounding_box()
    assert zone is not None
    x, y = zone["x"] + zone["width"] / 2, zone["y"] + zone["height"] / 2
    walking, running = (phone.evaluate(f"motionkit.speeds.{name}") for name in ("walking", "running"))
    start, ahead = place(phone), camera_way(phone)
    touch("touchStart", (x, y))
    touch("touchMove", (x, y - 50))
    asked_speed(phone, f"> 0.9 * {walking} && Math.hypot(...motionkit.sent.velocity) < 1.1 * {walking}")
    touch("touchMove", (x, y - 75))
    asked_speed(phone, f"> 0.99 * {running}")
    wait_frames(phone, 60)
    end = place(phone)
    assert (end[0] - start[0]) * ahead[0] + (end[1] - start[1]) * ahead[1] > 0.5
    touch("touchEnd")
    asked_speed(phone, "=== 0")


def test_types_are_in_a_sheet_beside_the_figure(phone: Page) -> None:
    scene, types = phone.locator("#stage"), phone.locator("#types")
    assert not types.is_visible()
    button = phone.get_by_role("button", name="Types", exact=True)
    button.tap()
    sheet = types.bounding_box()
    phone.wait_for_function(
        f"Math.abs(document.getElementById('stage').getBoundingClientRect().bottom - {sheet['y']}) < 2",
        timeout=PATIENCE,
    )
    assert scene.bounding_box()["height"] > 0.5 * 760, "most of the screen is left to the figure"
    types.get_by_role("button", name="duck").tap()
    kind = type_index(phone, "duck")
    phone.wait_for_function(f"motionkit.own.now.type === {kind}", timeout=PATIENCE)
    assert button.get_attribute("aria-expanded") == "true"
    phone.keyboard.press("Escape")
    assert not types.is_visible() and button.get_attribute("aria-expanded") == "false"


def test_everything_on_a_phone_is_reached(phone: Page) -> None:
    phone.get_by_role("button", name="More", exact=True).tap()
    for name in ("Draw path", "Record", "Start anew", "Theme", "Help"):
        box = phone.get_by_role("button", name=name, exact=True).bounding_box()
        assert box is not None and box["x"] >= 0 and box["x"] + box["width"] <= 400 and box["height"] >= 40
    phone.get_by_role("button", name="Draw path", exact=True).tap()
    assert not phone.locator("#tools").is_visible(), "there is ground to draw on"
    assert phone.evaluate("motionkit.drawing")
    phone.evaluate("motionkit.commands.p()")


def test_the_camera_comes_along_without_jumps(joined: Page) -> None:
    """A target that starts, runs and stops: the camera's speed changes a little at a time."""
    ways = joined.evaluate(
        """() => {
          const Chase = motionkit.chase.constructor, target = motionkit.stage.controls.target.clone();
          const stage = { controls: { target }, follow: (x, y, z) => target.set(x, y, z) };
          const chase = new Chase(stage), ways = [];
          chase.to([0, 0, 0], 0.016);
          for (let n = 0; n < 240; n++) {
            chase.to([Math.min(Math.max(0, n - 30), 120) * 0.05, 0, 0], 1 / 60);
            ways.push(target.x);
          }
          return ways;
        }"""
    )
    speeds = [60 * (b - a) for a, b in pairwise(ways)]
    assert max(abs(b - a) for a, b in pairwise(speeds)) < 0.35, "m/s from picture to picture"
    assert ways[-1] == pytest.approx(6.0, abs=0.01) and max(speeds) < 3.1
