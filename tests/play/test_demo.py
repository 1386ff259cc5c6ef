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
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import motionkit as mk
from motionkit.arrays import Array, Floats
from motionkit.control.reference_player import ReferencePlayer
from motionkit.errors import ModelError, MotionkitError
from motionkit.export.onnx_export import every_control
from motionkit.export.page_tracks import type_tracks
from motionkit.features.control import Controls
from motionkit.inference.character import CharacterStream, model_first_type
from motionkit.inference.step_arrays import TILE
from motionkit.inference.step_kernel import StepProgram
from motionkit.inference.step_weights import ModuleWeights, StepWeights, pack
from motionkit.metrics.body import body_of
from motionkit.metrics.detectors import DETECTORS, detection_windows
from motionkit.models.bundled import load_bundled_model
from motionkit.models.config import Variant
from motionkit.models.motion_type import MotionKind
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.play.demo import write_demo
from motionkit.rig.gltf import GltfFile
from oracle.characters import pose_in_numpy
from oracle.step import numpy_step
from view.conftest import PATIENCE, drawn

pytestmark = pytest.mark.thorough

if TYPE_CHECKING:
    from playwright.sync_api import Page

FRAMES = 300
START = "window.motionkit?.own?.root && motionkit.link.world.frame > 5"


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


STATE = ("x", "before", "contacts", "ground")  # of a frame, as x, before, contacts and place of the page's
IN_THE_PAGE = """([noise, states, asked]) => {
  const { world } = motionkit.link, { body } = world.characters.values().next().value;
  const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
  const [numbers, led] = [floats(noise), floats(states)], out = [];
  let [at, from] = [0, 0];
  const one = new body.constructor(world.kernel, 19, (out) => out.set(numbers.subarray(at, (at += out.length))));
  one.start([0, 0, 0]);
  one.soles.counts.fill(0n); // numpy knows none
  for (const controls of asked) {
    for (const values of [one.x, one.before, one.contacts, one.place]) values.set(led.subarray(from, (from += values.length)));
    one.step(controls);
    out.push(...one.x, ...one.contacts, ...one.positions);
  }
  return out;
}"""  # noqa: E501


def for_the_page(asked: Controls) -> dict[str, Any]:
    """Controls of one character as the page's are."""
    return {
        "weights": asked.type_weights[0].tolist(),
        "trajectory": asked.trajectory[0].tolist() if asked.trajectory_mask[0] else None,
        "phase": float(asked.phase[0]),
        "reference": asked.reference[0].tolist(),
        "gain": float(asked.reference_gain[0]),
        "slip": float(asked.slip_correction[0]),
    }


def in_numpy(noise: Floats, script: list[Controls]) -> tuple[Array, Array]:
    """State (T, N) before each frame of a script, and what is made (T, 276 + 4 + 69), in numpy alone."""
    model = load_bundled_model()
    stream = CharacterStream(model, 1)
    pose_in_numpy(stream)
    stream.state.network = numpy_step(stored_weights(pack(model.network)), 1)
    rows = iter(noise)
    stream.state.noise_state._draw = lambda out: np.copyto(out, next(rows))  # type: ignore[method-assign]
    kind = model_first_type(model)
    start = stream.model.types[kind].start_poses[0]
    stream.state.start(start.features[None], start.contacts[None], model.type_weights(kind)[None])
    states, frames = [], []
    for asked in script:
        states.append(np.concatenate([getattr(stream.state.frame, name)[0] for name in STATE]))
        shown = stream.step(asked)
        parts = (stream.state.frame.x[0], shown.contacts[0], shown.positions[0].ravel())
        frames.append(np.concatenate(parts))
    return np.stack(states), np.stack(frames)


def as_text(numbers: Array) -> str:
    """The bytes of numbers for the page."""
    return base64.b64encode(numbers.astype("<f4").tobytes()).decode()


def test_the_page_makes_the_frames_of_numpy(page: Page) -> None:
    """Each from the frame that numpy has made before it: a closed loop carries the last bits on."""
    noise = np.random.default_rng(8).standard_normal((FRAMES + 1, 276), np.float32)
    script = every_control(load_bundled_model(), FRAMES)
    states, expected = in_numpy(noise, script)
    made = page.evaluate(IN_THE_PAGE, [as_text(noise), as_text(states), [*map(for_the_page, script)]])
    apart = np.abs(np.array(made).reshape(FRAMES, -1) - expected)
    assert np.ptp(expected[:, 280], axis=0) > 100.0, "it goes somewhere"
    assert apart[:, :280].max() < 3e-5
    # Where a leg is stretched out flat, the height of its hip is a root of nearly zero, which keeps few digits.
    places = apart[:, 280:].max(axis=1)
    assert np.mean(places < 1e-3) > 0.95 and places.max() < 0.02


def test_a_track_is_what_a_reference_player_shows(page: Page) -> None:
    """Poses, phases and where recordings go, to the steps that the file keeps; at its end a track leads back."""
    model = load_bundled_model()
    shown = page.evaluate(
        """(name) => {
          const { player, model } = motionkit.link.world.characters.values().next().value.driver;
          const one = new player.constructor(model, 1), type = model.types.findIndex((type) => type.name === name);
          one.begin(type);
          const frames = Array.from({ length: one.track.frames + 1 }, () => one.next());
          return frames.map(({ reference, phase, trajectory }) => [...reference, phase, ...trajectory]);
        }""",
        "cartwheel",
    )
    made, player = np.array(shown), ReferencePlayer(model, 1)
    player.begin("cartwheel")
    asked = player.play(60)
    expected = np.concatenate([asked.reference, asked.phase[:, None], asked.trajectory], axis=1)
    apart = np.abs(made[:60] - expected)
    assert apart[:, :73].max() < 1e-3 and apart[:, 73:].max() < 0.2
    assert np.array_equal(made[-1], made[0])
    assert np.abs(np.diff(made[:, :72], axis=0)).max() < 1.5 * np.abs(np.diff(asked.reference, axis=0)).max()


def test_every_type_with_recordings_has_tracks_and_seeds_differ() -> None:
    model = load_bundled_model()
    for name, kind in model.types.items():
        tracks = type_tracks(model, name)
        assert bool(tracks) == (bool(kind.reference_clips) and kind.kind is not MotionKind.STANCE)
        poses = {track.poses[:60].tobytes() for track in tracks}
        assert len(poses) >= min(len(tracks), 2)
        assert all(bool(track.performance) == kind.kind.phased for track in tracks)


@pytest.mark.parametrize("kind", ["cartwheel", "backflip", "punching", "running"])
def test_the_page_shows_what_is_asked_for(page: Page, kind: str) -> None:
    """The detectors of evaluation find it in what seeds of the page make."""
    model = load_bundled_model()
    speed = 300.0 if kind == "running" else 0.0
    made = page.evaluate(
        """([kind, speed]) => [3, 11, 25].map((seed) => {
          const { world } = motionkit.link, again = new world.constructor(world.kernel, seed), frames = [];
          for (let frame = 0; frame < 200; frame++) {
            if (frame === 20 && speed) again.obey({ do: "wish", velocity: [0, speed], facing: null, type: kind });
            else if (frame === 20) again.obey({ do: "perform", type: kind });
            const one = again.step().shown.get(1);
            frames.push([...one.root, ...one.rotations]);
          }
          return frames;
        })""",
        [kind, speed],
    )
    for frames in np.array(made, np.float32):
        rotations = frames[20:, 3:].reshape(-1, 23, 4)
        body = body_of(Motion(model.character("default"), rotations, frames[20:, :3], model.fps))
        windows = detection_windows(body, min(DETECTORS[kind].window, 2.0))
        assert any(DETECTORS[kind].shows(window) for window in windows)


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


def test_a_model_that_makes_no_motion_writes_nothing(tmp_path: Path) -> None:
    model = load_bundled_model()
    arrays = {name: np.full_like(array, 1e11) for name, array in model.network.arrays.items()}
    with pytest.raises(ModelError, match="the roll-out failed"):
        write_demo(tmp_path / "site", replace(model, network=replace(model.network, arrays=arrays)))
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


def test_somebody_stands_while_the_model_loads(visit: Callable[..., Page], address: str) -> None:
    """Before the model has come, the page says what it loads and shows the figure; the same one then moves."""
    page, held = visit(service_workers="block"), []
    page.route("**/model.bin", lambda route: held.append(route))
    page.goto(address, wait_until="commit")
    page.wait_for_function("window.motionkit?.standing?.visible", timeout=PATIENCE)
    assert "Loading" in page.locator("#notice").inner_text() and not page.evaluate("motionkit.hello")
    page.evaluate("void (motionkit.shown = motionkit.standing)")
    held[0].continue_()
    page.wait_for_function("motionkit.own?.figure === motionkit.shown && " + START, timeout=PATIENCE)
    page.wait_for_function("document.getElementById('notice').hidden", timeout=PATIENCE)
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


def test_a_path_of_another_type_begins_with_a_blend(page: Page) -> None:
    """And first steps end where another type is shown, so that a return to the gait does not go on with them."""
    weights, left = page.evaluate(
        """() => {
          const { world } = motionkit.link, again = new world.constructor(world.kernel, 3), weights = [];
          const path = (type) => ({ do: "path", points: [[0, 60], [0, 460]], type, speed: 80, stops: [] });
          const { driver } = again.characters.values().next().value;
          const salsa = again.model.types.findIndex((type) => type.name === "dance-salsa");
          again.obey(path("walking"));
          for (let frame = 0; frame < 60; frame++) again.step();
          again.obey(path("dance-salsa"));
          for (let frame = 0; frame < 30; frame++) { again.step(); weights.push(driver.weights[salsa]); }
          const steps = driver.firstSteps;
          steps.begin(0, 100);
          steps.reference(1, {});
          return [weights, steps.left];
        }"""
    )
    assert 0.0 < weights[0] < 0.2 and weights[-1] == 1.0 and np.diff(weights).max() < 0.2
    assert left == 0


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
    page.wait_for_function("motionkit.stroke.children.length > 0", timeout=PATIENCE)
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
    page.wait_for_function("motionkit.facts.get(motionkit.chosen).recording", timeout=PATIENCE)
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


def test_a_body_stays_while_it_is_recorded_and_a_path_goes_with_its_character(
    visit: Callable[..., Page],
) -> None:
    page = visit()
    page.evaluate("motionkit.link.bodies.other = motionkit.link.bodies.default")
    page.evaluate("motionkit.record()")
    page.wait_for_function("motionkit.facts.get(motionkit.chosen).recording", timeout=PATIENCE)
    page.evaluate("motionkit.said = []; motionkit.say = (...words) => motionkit.said.push(words.join(''))")
    page.evaluate("motionkit.link.ask('body', { character: motionkit.chosen, body: 'other' })")
    assert "cannot change during a recording" in " ".join(page.evaluate("motionkit.said"))
    assert page.evaluate("motionkit.link.world.characters.get(motionkit.chosen).worn") == "default"
    page.evaluate("for (let n = 0; n < 19; n++) motionkit.link.ask('add', {})")
    page.evaluate("motionkit.link.ask('add', { body: 'other' })")
    assert "there is room for 20" in " ".join(page.evaluate("motionkit.said"))
    worn = page.evaluate("[...motionkit.link.world.characters.values()].map(({ worn }) => worn)")
    assert worn == ["default"] * 20
    removed = page.evaluate("motionkit.mine[1]")
    page.evaluate(f"motionkit.paths.set({removed}, null)")  # the first has one of its own
    page.evaluate(f"motionkit.link.ask('remove', {{ character: {removed} }})")
    page.wait_for_function(f"!motionkit.paths.has({removed})", timeout=PATIENCE)
    page.close()


def test_who_is_steered_next_goes_on_as_it_was(visit: Callable[..., Page]) -> None:
    page = visit()
    page.evaluate("motionkit.add()")
    page.wait_for_function("motionkit.mine.length === 2", timeout=PATIENCE)
    page.evaluate("motionkit.perform('balance')")
    page.wait_for_function("motionkit.sent?.type === 'balance'", timeout=PATIENCE)
    before = page.evaluate("motionkit.link.world.done.length")
    page.evaluate("motionkit.link.ask('remove', { character: motionkit.chosen })")
    page.wait_for_function("motionkit.mine.length === 1", timeout=PATIENCE)
    assert page.evaluate("motionkit.mode") is None
    wait_frames(page, 30)
    assert page.evaluate("motionkit.link.world.done.length") == before + 1, "no wish by the page itself"
    page.close()


def test_who_gets_another_body_begins_anew(visit: Callable[..., Page]) -> None:
    page = visit()
    page.evaluate("motionkit.link.bodies.other = motionkit.link.bodies.default; motionkit.offer('default')")
    page.evaluate("motionkit.perform('balance')")
    page.wait_for_function("motionkit.sent?.type === 'balance'", timeout=PATIENCE)
    page.evaluate("motionkit.watch(); motionkit.offer('other')")
    page.wait_for_function("motionkit.facts.get(motionkit.chosen).body === 'other'", timeout=PATIENCE)
    assert page.evaluate("[motionkit.mode, motionkit.paths.size]") == [None, 0]
    pressed = "document.querySelectorAll('#types [aria-pressed=true]').length"
    assert page.evaluate(pressed) == 0
    page.evaluate("motionkit.record()")
    page.wait_for_function("motionkit.facts.get(motionkit.chosen).recording", timeout=PATIENCE)
    page.evaluate("motionkit.offer('default')")  # makes the tools anew
    assert page.locator("#tools .recording .dot").count() == 1
    page.close()


@pytest.mark.parametrize("key", ["Backspace", "Escape"])
def test_one_finger_draws_and_a_key_ends_it(visit: Callable[..., Page], key: str) -> None:
    page = visit()
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.evaluate("motionkit.stage.look(motionkit.stage.controls.target, 0, 1.2, 8)")
    page.keyboard.press("p")
    page.mouse.move(300, 250)
    page.mouse.down()
    page.mouse.move(340, 260, steps=4)
    assert page.evaluate("motionkit.stroke !== null")
    page.evaluate(
        """() => { for (const [type, x] of [["pointerdown", 500], ["pointermove", 520], ["pointerup", 520]])
        document.getElementById("scene").dispatchEvent(new PointerEvent(type, { pointerId: 77, clientX: x,
        clientY: 300, button: 0, bubbles: true })); }"""
    )
    page.mouse.move(400, 280, steps=4)
    page.keyboard.press(key)
    page.mouse.move(420, 290, steps=4)
    page.mouse.up()
    assert page.evaluate("motionkit.stroke") is None and not faults
    assert not any(request["do"] == "path" for _, request in page.evaluate("motionkit.link.world.done"))
    page.close()


def test_each_character_keeps_its_path(visit: Callable[..., Page]) -> None:
    page = visit()
    page.evaluate("motionkit.stage.look(motionkit.stage.controls.target, 0, 1.2, 8)")
    page.keyboard.press("p")
    draw(page)
    shown = "motionkit.paths.get(1)?.parent === motionkit.stage.scene"
    assert page.evaluate(shown)
    page.keyboard.press("n")
    page.wait_for_function("motionkit.mine.length === 2", timeout=PATIENCE)
    page.keyboard.press("Tab")
    assert page.evaluate("motionkit.chosen") == 2
    draw(page)
    assert page.evaluate(shown) and page.evaluate("motionkit.paths.size") == 2
    page.keyboard.press("Tab")
    asked = page.evaluate("motionkit.link.world.done.length")
    page.keyboard.press("v")
    page.mouse.click(500, 300)  # too short for a path
    wait_frames(page, 10)
    assert page.evaluate("motionkit.link.world.done.length") == asked and page.evaluate(shown)
    page.close()


def draw(page: Page) -> None:
    page.mouse.move(300, 250)
    page.mouse.down()
    page.mouse.move(480, 280, steps=9)
    page.mouse.up()


def test_a_click_on_the_list_outlives_events(visit: Callable[..., Page]) -> None:
    page = visit()
    box = page.get_by_role("button", name="Add a character").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()
    page.evaluate("motionkit.link.ask('noise', { character: 1, kind: 'correlated', temperature: 0.3 })")
    assert page.evaluate("motionkit.noise.value") == "0.3"
    page.mouse.up()
    page.wait_for_function("motionkit.mine.length === 2", timeout=PATIENCE)
    page.close()


def test_the_page_works_where_nothing_can_be_kept(open_page: Callable, address: str) -> None:
    page = open_page(address, 720, 500, service_workers="block")
    page.wait_for_function(START, timeout=PATIENCE)
    page.evaluate("() => { Object.defineProperty(navigator, 'clipboard', { value: undefined }); }")
    page.get_by_role("button", name="Copy link").click()
    page.wait_for_function(
        "document.getElementById('hint').innerText.includes('address bar')", timeout=PATIENCE
    )
    assert page.locator("#notice").is_hidden()
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
    mk.write(tmp_path / "python.glb", motion)
    theirs, ours = (
        {node["name"]: node for node in GltfFile(tmp_path / name).json["nodes"] if node.get("name") in names}
        for name in ("recording.glb", "python.glb")
    )
    for name, part in product(names, ("translation", "rotation")):
        assert np.allclose(theirs[name].get(part, 0.0), ours[name][part], atol=1e-4), (name, part)


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
