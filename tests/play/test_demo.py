"""The folder of `motionkit demo`, served as files are, in a real browser: what it makes against numpy, and its page."""

from __future__ import annotations

import base64
import functools
import gzip
import http.server
import math
import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import motionkit as mk
from motionkit.arrays import Array, Floats
from motionkit.control.drive import Driver, Wish
from motionkit.control.path import PathPart, make_path
from motionkit.control.recording_choice import drawn_evenly
from motionkit.errors import ModelError, MotionkitError
from motionkit.inference.character import CharacterStream, model_first_type
from motionkit.inference.step_arrays import TILE
from motionkit.inference.step_kernel import StepProgram
from motionkit.inference.step_weights import ModuleWeights, StepWeights, pack
from motionkit.models.bundled import load_bundled_model
from motionkit.models.config import Variant
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.play.demo import write_demo
from oracle.characters import pose_in_numpy
from oracle.step import numpy_step
from view.conftest import PATIENCE, drawn

if TYPE_CHECKING:
    from playwright.sync_api import Page

FRAMES = 600
START = "motionkit.own?.root && motionkit.link.world.frame > 5"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the bundled model."""
    folder = tmp_path_factory.mktemp("demo") / "site"
    write_demo(folder, load_bundled_model())
    return folder


class _Handler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    """Where the folder is served, by what `python -m http.server` runs."""
    handler = functools.partial(_Handler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def visit(address: str, open_page: Callable) -> Callable[..., Page]:
    """A function that opens the page, or an address of it, and draws no more once its character is shown."""

    def start(where: str = "", **options: Any) -> Page:
        page = open_page(where or address, 720, 500, **options)
        page.wait_for_function(START, timeout=PATIENCE)
        page.evaluate("motionkit.stage.renderer.render = () => {}")
        return page

    return start


@pytest.fixture(scope="module")
def page(visit: Callable[..., Page]) -> Page:
    """One page for tests that leave it as they like."""
    return visit()


# ---- the same motion ----


class _Stored(StepProgram):
    """The weights as 16 bits hold them, map by map in the order of the kernel."""

    def __init__(self, weights: StepWeights) -> None:
        self.read: list[Floats] = []
        super().__init__(weights, small=True)

    def _map(self, weight: Floats, bias: Floats | None) -> tuple[Array, Any]:
        tiles, words = super()._map(weight, bias)
        scale = self.kept[-1 if bias is None else -2].reshape(-1, 1, TILE)
        low, high = (tiles << 16).astype(np.float32), tiles.astype(np.float32)
        whole = np.concatenate([low, high], axis=-1) * scale
        self.read.append(whole.swapaxes(0, 1).reshape(len(weight), -1)[:, : weight.shape[1]])
        return tiles, words


def stored_weights(weights: StepWeights) -> StepWeights:
    """What the 16 bits of the file hold of a network, for numpy."""
    read = iter(_Stored(weights).read)
    heads, width = weights.config.heads, weights.config.width
    turn = np.arange(width).reshape(heads, -1).T.ravel()
    three = np.argsort(np.concatenate([turn, width + turn, 2 * width + turn]))

    def module(whole: ModuleWeights) -> ModuleWeights:
        out = {
            n: getattr(whole, n).copy() for n in "embed controls layer_controls qkv out inner outer".split()
        }
        for part in range(len(whole.embed)):
            for name in ("embed", "controls", "layer_controls"):
                out[name][part] = next(read)
            for layer in range(weights.config.layers):
                out["qkv"][layer, part] = next(read)[:, three]
                out["out"][layer, part] = next(read)[np.argsort(turn)]
                out["inner"][layer, part], out["outer"][layer, part] = next(read), next(read)
        return replace(whole, **out)

    shallow, deep = module(weights.shallow), module(weights.deep)
    return replace(
        weights,
        shallow=shallow,
        deep=deep,
        head=next(read),
        contact_shallow=next(read),
        contact=next(read),
    )


PATH = [{"points": [[0, 0], [60, 90], [0, 190], [-90, 150]], "type": "walking"}]
# A stop within a walk, a dance that finds its way among recordings, a cartwheel, a run at a speed.
TYPES_ON_A_PATH = [
    {"points": [[0, 0], [30, 80]], "type": "walking", "stop": 0.6},
    {"points": [[40, 150]], "type": "walking"},
    {"points": [[0, 210], [-60, 230]], "type": "dance-salsa"},
    {"points": [[-90, 280], [-90, 480]], "type": "cartwheel"},
    {"points": [[0, 900]], "type": "running", "speed": 250},
]
# Frame, and what is asked for from then on.
THERE_AND_BACK = [
    {"points": [[0.0, 0.0], [0.0, 300.0], [0.0, 0.0]], "type": "walking", "stop": 1.0},
    {"points": [[0.0, -300.0]], "type": "cartwheel"},
]
ASKED: dict[str, list[tuple[int, str, Any]]] = {
    "wishes": [
        (0, "path", PATH),
        (170, "wish", {"velocity": [210, -180], "facing": None, "type": None}),
        (240, "perform", ["cartwheel", 7]),
        (380, "wish", {"velocity": None, "facing": None, "type": "dance-salsa"}),
        (460, "perform", ["punching", 3]),
        (560, "wish", {"velocity": [0, 0], "facing": 1.5, "type": None}),
    ],
    "starts": [
        (0, "wish", {"velocity": [0, 0], "facing": None, "type": None}),
        (60, "wish", {"velocity": [90, 90], "facing": None, "type": None}),
        (190, "wish", {"velocity": [0, 0], "facing": None, "type": None}),
        (290, "wish", {"velocity": [0, -100], "facing": 0, "type": None}),
        (400, "wish", {"velocity": [0, 0], "facing": None, "type": None}),
        (480, "wish", {"velocity": [-120, 300], "facing": None, "type": None}),
    ],
    "types on a path": [
        (20, "path", TYPES_ON_A_PATH),
        (520, "wish", {"velocity": [60, -40], "facing": None, "type": "dance-indian"}),
    ],
    "there and back": [(20, "path", THERE_AND_BACK)],
}
IN_THE_PAGE = """([noise, asked, frames, choice]) => {
  const { world } = motionkit.link, { body, driver } = world.characters.values().next().value;
  const numbers = new Float32Array(Uint8Array.from(atob(noise), (letter) => letter.charCodeAt(0)).buffer);
  let at = 0;
  const one = new body.constructor(world.kernel, 19, (out) => out.set(numbers.subarray(at, (at += out.length))));
  one.start([0, 0, 0]);
  const wishes = new driver.constructor(world.model, choice), out = [];
  for (let frame = 0; frame < frames; frame++) {
    for (const [when, what, how] of asked) {
      if (when !== frame) continue;
      if (what === "path") wishes.follow(how);
      else if (what === "wish") wishes.set(how);
      else wishes.perform(...how);
    }
    one.step(wishes.controls(frame, one.ground));
    out.push(...one.positions);
  }
  return out;
}"""


def made_in_numpy(noise: Floats, asked: list[tuple[int, str, Any]], choice: int) -> Array:
    """Joint positions (T, 23, 3) of what is asked of a Driver, in numpy alone."""
    model = load_bundled_model()
    stream = CharacterStream(model, 1)
    pose_in_numpy(stream)
    stream.state.network = numpy_step(stored_weights(pack(model.network)), 1)
    rows = iter(noise)
    stream.state.noise_state._draw = lambda out: np.copyto(out, next(rows))  # type: ignore[method-assign]
    kind = model_first_type(model)
    start = stream.model.types[kind].start_poses[0]
    stream.state.start(start.features[None], start.contacts[None], stream._weights(kind))
    driver, places = Driver(model, kind, choice=choice), []
    for frame in range(FRAMES):
        for _, what, how in (each for each in asked if each[0] == frame):
            if what == "path":
                parts = [PathPart(**{**part, "points": np.array(part["points"])}) for part in how]
                driver.set_wish(Wish(path=make_path(parts)))
            elif what == "wish":
                velocity = None if how["velocity"] is None else tuple(how["velocity"])
                driver.set_wish(Wish(velocity, how["facing"], how["type"]))
            else:
                driver.perform(how[0], choice=how[1])
        places.append(stream.step(driver(frame, stream.ground)).positions[0])
    return np.stack(places)


@pytest.mark.parametrize(
    ("asked", "choice", "seed"),
    [("wishes", 0, 8), ("starts", 3, 4), ("types on a path", 5, 1), ("there and back", 2, 4)],
)
def test_the_page_makes_the_motion_of_numpy(page: Page, asked: str, choice: int, seed: int) -> None:
    noise = np.random.default_rng(seed).standard_normal((FRAMES + 1, 276), np.float32)
    words = base64.b64encode(noise.astype("<f4").tobytes()).decode()
    told = [words, [list(each) for each in ASKED[asked]], FRAMES, choice]
    made = np.array(page.evaluate(IN_THE_PAGE, told)).reshape(FRAMES, 23, 3)
    expected = made_in_numpy(noise, ASKED[asked], choice)
    apart = np.linalg.norm(made - expected, axis=-1).max(axis=-1)
    assert np.ptp(expected[:, 0], axis=0).max() > 300.0, "it goes somewhere"
    assert apart.max() < 1e-3, f"{apart.max()} cm, first at frame {np.flatnonzero(apart > 1e-3)[0]}"


def test_python_draws_the_same_clips(page: Page) -> None:
    import random

    draws = page.evaluate(
        """(seed) => {
          const player = motionkit.link.world.characters.values().next().value.driver.player;
          const random = new player.random.constructor(seed), some = Array.from({ length: 900 }, (_, n) => n);
          Object.assign(player, { choice: seed, draws: 0 });
          const places = some.slice(0, 50).map(() => player.place([5, 1, 90, 40]));
          return [random.random(), random.sample(some, 200), random.sample(some, 24),
                  random.sample(some.slice(0, 30), 24), random.below(1), places];
        }""",
        12345,
    )
    expected = random.Random(12345)
    assert draws == [
        expected.random(), expected.sample(range(900), 200), expected.sample(range(900), 24),
        expected.sample(range(30), 24), expected._randbelow(1),
        [drawn_evenly([5, 1, 90, 40], 12345, number) for number in range(1, 51)],
    ]  # fmt: skip


def test_the_noise_of_the_page_is_normal(page: Page) -> None:
    drawn_numbers = page.evaluate(
        "() => { const out = new Float32Array(40000); "
        "motionkit.link.world.characters.values().next().value.body.normals(out); return Array.from(out); }"
    )
    numbers = np.array(drawn_numbers)
    assert abs(numbers.mean()) < 0.02 and abs(numbers.std() - 1.0) < 0.02
    assert abs((np.abs(numbers) < 1.0).mean() - 0.6827) < 0.01
    assert abs(np.corrcoef(numbers[:-1], numbers[1:])[0, 1]) < 0.02


# ---- the folder ----


def test_the_folder_is_small(folder: Path) -> None:
    files = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert set(files) == {"index.html", "model.bin", "motionkit.wasm", "sw.js", "three-LICENSE.txt"}
    assert sum(map(len, files.values())) < 12e6
    assert sum(len(gzip.compress(data, 6)) for data in files.values()) < 9e6
    assert not re.search(rb"""(src|href)=["']?https?:""", files["index.html"])


def test_a_file_in_the_way_is_said_and_kept(tmp_path: Path) -> None:
    (tmp_path / "site").write_text("mine", "utf-8")
    with pytest.raises(MotionkitError, match="site: is a file, expected a folder"):
        write_demo(tmp_path / "site", load_bundled_model())
    assert (tmp_path / "site").read_text("utf-8") == "mine"


def test_a_network_that_the_kernels_cannot_run_writes_nothing(tmp_path: Path) -> None:
    model = load_bundled_model()
    config = replace(model.config, variant=Variant(position="sinusoidal"))
    network = replace(model.network, config=config)
    with pytest.raises(ModelError, match="cannot be packed"):
        write_demo(tmp_path / "site", replace(model, network=network))
    assert not (tmp_path / "site").exists()


# ---- the page ----


def root(page: Page) -> tuple[float, float]:
    """x, z of the first character in metres, in the newest frame."""
    x, _, z = page.evaluate("Array.from(motionkit.newest.characters.get(1).root)")
    return x / 100, z / 100


def wait_frames(page: Page, frames: int) -> None:
    """Wait until so many frames have been made."""
    now = page.evaluate("motionkit.link.world.frame")
    page.wait_for_function(f"motionkit.link.world.frame >= {now + frames}", timeout=PATIENCE)


def test_somebody_walks_until_steered_and_a_link_does_it_again(visit: Callable[..., Page]) -> None:
    page = visit()
    wait_frames(page, 100)
    assert math.hypot(*root(page)) > 0.5, "walks by itself"
    page.keyboard.down("w")
    page.wait_for_function("motionkit.sent.velocity[0] || motionkit.sent.velocity[1]", timeout=PATIENCE)
    page.locator("#types button", has_text="cartwheel").click()
    page.wait_for_function("motionkit.newest.characters.get(1).performing", timeout=PATIENCE)
    wait_frames(page, 60)
    page.keyboard.up("w")
    page.wait_for_function("!motionkit.sent.velocity[0] && !motionkit.sent.velocity[1]", timeout=PATIENCE)
    page.get_by_role("button", name="Copy link").click()
    page.wait_for_function("location.hash.startsWith('#do=')", timeout=PATIENCE)
    track = """([address, frames]) => {
      const { world } = motionkit.link, again = new world.constructor(world.kernel, world.seed), places = [];
      for (let frame = 0, at = 0; frame < frames; frame++) {
        for (; at < world.done.length && world.done[at][0] === frame; at++) again.obey(world.done[at][1]);
        places.push(...again.step().shown.get(1).root);
      }
      return places;
    }"""
    frames = page.evaluate("motionkit.link.world.done.at(-1)[0]") + 30
    place = page.url
    expected = page.evaluate(track, [place, frames])
    page.close()
    again = visit(place)
    again.wait_for_function(f"motionkit.link.world.frame >= {frames}", timeout=PATIENCE)
    assert again.evaluate("motionkit.link.replays") is False
    assert again.evaluate(track, [place, frames]) == expected
    assert len(again.evaluate("motionkit.link.world.done")) >= 4
    again.close()


def test_a_damaged_link_is_told(visit: Callable[..., Page], address: str) -> None:
    page = visit(f"{address}#do=abc")
    assert "damaged" in page.locator("#hint").inner_text()
    assert "damaged" not in visit().locator("#hint").inner_text()


def test_another_link_in_the_same_tab_is_done(visit: Callable[..., Page], address: str) -> None:
    page = visit()
    with page.expect_navigation():
        page.evaluate("location.hash = 'do=def'")
    page.wait_for_function(START, timeout=PATIENCE)
    assert "damaged" in page.locator("#hint").inner_text()


def test_a_drawn_path_is_followed(visit: Callable[..., Page]) -> None:
    page = visit(reduced_motion="reduce")
    wait_frames(page, 30)
    assert math.hypot(*root(page)) < 0.3, "stands where motion is to be reduced"
    page.evaluate("motionkit.followPath([[0, 0.2], [0.5, 1.2], [0.2, 2.2]])")
    page.wait_for_function("motionkit.newest.characters.get(1).following", timeout=PATIENCE)
    page.wait_for_function("!motionkit.newest.characters.get(1).following", timeout=PATIENCE)
    assert math.dist(root(page), (0.2, 2.2)) < 0.5
    page.close()


def test_a_path_has_a_type_and_stops(page: Page) -> None:
    places, shown = page.evaluate(
        """() => {
          const { world } = motionkit.link, again = new world.constructor(world.kernel, 3), places = [], shown = [];
          again.obey({ do: "path", points: [[0, 60], [0, 260], [0, 460]], type: "dance-salsa", speed: 80, stops: [[1, 1.5]] });
          for (let frame = 0; frame < 900; frame++) {
            const one = again.step().shown.get(1);
            places.push([one.root[0], one.root[2]]);
            shown.push(again.model.types[one.type].name);
          }
          return [places, shown];
        }"""  # noqa: E501
    )
    track = np.array(places)
    speeds = 6.0 * np.linalg.norm(track[10:] - track[:-10], axis=1)  # cm/s, over a sixth of a second
    still = (speeds < 20.0) & (np.linalg.norm(track[:-10] - [0, 260], axis=1) < 40.0)
    assert still.sum() > 45, "it stands where the path stops"
    assert np.linalg.norm(track[-1] - [0, 460]) < 60.0 and shown[-1] == "idle"
    assert shown.count("dance-salsa") > 200


def test_the_hand_rests_where_a_drawn_path_is_to_stop(page: Page) -> None:
    page.evaluate("motionkit.stage.look(motionkit.stage.controls.target.clone(), 0.5, 1.0, 7)")
    page.keyboard.press("p")
    page.get_by_label("Type on the path").select_option("running")
    box = page.locator("#scene").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.55
    page.mouse.move(x, y)
    page.mouse.down()
    for n in range(1, 7):
        page.mouse.move(x - 14 * n, y - 4 * n)
    page.wait_for_function("motionkit.ribbon.children.length > 0", timeout=PATIENCE)
    page.mouse.move(x - 120, y + 20)
    page.mouse.move(x - 140, y + 40)
    page.mouse.up()
    page.keyboard.press("p")
    asked = page.evaluate("motionkit.link.world.done.findLast(([, asked]) => asked.do === 'path')[1]")
    assert asked["type"] == "running"
    assert all(0 < number < len(asked["points"]) and seconds == 2 for number, seconds in asked["stops"])
    assert asked["stops"]


def test_who_is_removed_while_recording_leaves_its_file(visit: Callable[..., Page], tmp_path: Path) -> None:
    page = visit()
    page.evaluate("motionkit.add()")
    page.wait_for_function("motionkit.mine.length === 2", timeout=PATIENCE)
    page.evaluate("motionkit.record()")
    page.wait_for_function("motionkit.told.get(motionkit.chosen).recording", timeout=PATIENCE)
    wait_frames(page, 30)
    began = page.evaluate("motionkit.recordedFrom")
    chosen = page.evaluate("motionkit.chosen")
    page.keyboard.press("Tab")
    page.wait_for_function(
        f"motionkit.chosen !== {chosen} && motionkit.recordedFrom === null", timeout=PATIENCE
    )
    page.keyboard.press("Tab")
    page.wait_for_function(f"motionkit.recordedFrom === {began}", timeout=PATIENCE)
    with page.expect_download(timeout=PATIENCE * 1000) as made:
        page.get_by_role("button", name=f"Remove character {chosen}").click()
    made.value.save_as(tmp_path / "a.bvh")
    assert len(read_bvh(tmp_path / "a.bvh").values) >= 30
    page.wait_for_function("motionkit.mine.length === 1", timeout=PATIENCE)
    page.close()


def test_arrow_keys_move_a_slider_that_has_the_focus(visit: Callable[..., Page]) -> None:
    page = visit()
    page.locator("input[type=range]").focus()
    before = page.evaluate("motionkit.noise.value")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("motionkit.noise.value") > before
    page.close()


def test_a_recording_is_the_motion_that_was_shown(page: Page, tmp_path: Path) -> None:
    with page.expect_download(timeout=PATIENCE) as download:
        page.evaluate("motionkit.record()")
        wait_frames(page, 40)
        page.evaluate(
            "() => { const { body } = motionkit.link.world.characters.values().next().value; "
            "motionkit.kept = Array.from(body.positions); motionkit.record(); }"
        )
    motion = bvh_to_motion(read_bvh(download.value.path()))
    _, positions = motion_kinematics(motion)
    kept = np.array(page.evaluate("motionkit.kept")).reshape(23, 3)
    assert len(motion) >= 40 and abs(motion.fps - 60.0) < 0.01
    names = load_bundled_model().character("default").names
    order = [motion.skeleton.names.index(name) for name in names]
    assert np.linalg.norm(positions[-1, order] - kept, axis=-1).max() < 0.01
    with page.expect_download(timeout=PATIENCE) as download:
        page.locator("#hint a", has_text="as GLB").click()
    file = Path(download.value.path()).rename(tmp_path / "recording.glb")
    skinned = mk.read(file)
    _, positions = motion_kinematics(skinned)
    order = [skinned.skeleton.names.index(name) for name in names]
    assert len(skinned) == len(motion)
    assert np.linalg.norm(positions[-1, order] - kept, axis=-1).max() < 0.01


def test_a_link_that_says_nonsense_changes_nothing(page: Page) -> None:
    told = page.evaluate(
        """() => {
          const { world } = motionkit.link, before = world.done.length;
          return [
            [{ do: "wish", velocity: "fast" }, "velocity"],
            [{ do: "wish", velocity: [0, null], facing: 0 }, "velocity"],
            [{ do: "wish", velocity: null, facing: null, type: "flying" }, "flying"],
            [{ do: "perform" }, "motion type"],
            [{ do: "path", points: [[0, 0], [1e12, 0]] }, "500 m"],
            [{ do: "path", points: [[0, 0], ["x", 0]] }, "points"],
            [{ do: "path", points: [[0, 0], [0, 90]], type: "flying" }, "flying"],
            [{ do: "path", points: [[0, 0], [0, 90]], speed: -1 }, "speed"],
            [{ do: "path", points: [[0, 0], [0, 90]], stops: [[2, 1]] }, "stops"],
            [{ do: "path", points: [[0, 0], [0, 90]], stops: [[1, 0]] }, "stops"],
            [{ do: "noise", temperature: NaN }, "temperature"], [{ do: "leave" }, "cannot do leave"],
            [{ do: "reset", character: 99 }, "no character 99"],
          ].filter(([asked, said]) => {
            try {
              world.obey(asked);
            } catch (error) {
              return !error.message.includes(said) || world.done.length !== before;
            }
            return true;
          });
        }"""
    )
    assert told == []
    wait_frames(page, 5)
    page.evaluate("history.replaceState(null, '', '#do=AAAA')")
    page.reload()
    page.wait_for_function(START, timeout=PATIENCE)
    page.evaluate("motionkit.stage.renderer.render = () => {}")


def test_twenty_characters_and_no_more(visit: Callable[..., Page]) -> None:
    page = visit()
    for _ in range(20):
        page.evaluate("motionkit.add()")
    page.wait_for_function("motionkit.newest.characters.size === 20", timeout=PATIENCE)
    assert "room for 20 characters" in page.locator("#hint").inner_text()
    wait_frames(page, 10)
    places = page.evaluate("[...motionkit.newest.characters.values()].map(({ root }) => Array.from(root))")
    assert len({tuple(np.round(place, 2)) for place in places}) == 20
    page.close()


def test_it_works_without_a_network_after_the_first_visit(visit: Callable[..., Page], address: str) -> None:
    page = visit()
    asked: list[str] = []
    page.context.on("request", lambda request: asked.append(request.url))
    page.evaluate("() => navigator.serviceWorker.ready.then((there) => there.active.state)")
    page.wait_for_function("() => caches.keys().then((names) => names.length === 1)", timeout=PATIENCE)
    page.context.set_offline(True)
    page.reload()
    page.wait_for_function(START, timeout=PATIENCE)
    assert asked and all(url.startswith(address) or url.startswith("data:") for url in asked)
    page.close()


def test_a_phone_shows_the_body_beside_the_sheet_of_types(open_page: Callable, address: str) -> None:
    page = open_page(address, 400, 800, has_touch=True)
    page.wait_for_function(START, timeout=PATIENCE)
    page.get_by_role("button", name="Types").tap()
    drawn(page)
    sheet, scene = page.locator("#types").bounding_box(), page.locator("#scene").bounding_box()
    assert sheet and scene and sheet["y"] >= scene["y"] + scene["height"] - 1
    assert scene["height"] > 380
    page.close()


def test_everything_has_a_name_for_screen_readers(page: Page) -> None:
    nameless = page.evaluate(
        """[...document.querySelectorAll("button, select, input, [role=img]")]
          .filter((node) => !(node.getAttribute("aria-label") || node.labels?.length || node.textContent.trim()))
          .map((node) => node.outerHTML)"""
    )
    assert nameless == []
    page.keyboard.press("Shift")
    page.keyboard.press("?")
    assert page.locator("#help").evaluate("(dialog) => dialog.open")
    page.keyboard.press("Escape")
    assert not page.locator("#help").evaluate("(dialog) => dialog.open")
