"""Users' characters on the pages: the demo's own mapping against Python's, what files are refused, and downloads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from motionkit.export.formats import read_clip
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.play.frames import CharacterState
from motionkit.play.on_rig import LiveRig, with_rig
from motionkit.rig.on_rig import read_rig
from motionkit.rig.rig import Rig
from play.test_demo import address, folder, visit  # noqa: F401
from rig.test_character import parts
from rig.test_gltf_rig import character, two_below_one
from synthetic_characters import CHARACTERS, posed, skinned, toon
from view.conftest import drawn

pytestmark = pytest.mark.thorough

if TYPE_CHECKING:
    from playwright.sync_api import Page


@pytest.fixture(scope="module")
def page(visit: Callable[..., Page]) -> Page:  # noqa: F811
    """The demo."""
    return visit()


def give(page: Page, name: str, data: bytes) -> str:
    """Choose a file by the page's button; returns what the page then says."""
    page.evaluate("document.querySelector('#hint').replaceChildren()")
    page.set_input_files("input[type=file]", {"name": name, "mimeType": "model/gltf-binary", "buffer": data})
    said = "() => { const t = document.querySelector('#hint').textContent; return /^.+: |stays on/.test(t) && t; }"
    return str(page.wait_for_function(said).json_value())


DATA = """name => {
  const { hero, kernel } = motionkit.link.bodies[name];
  return { ...hero, ...kernel, offsets: [...kernel.offsets] };
}"""


@pytest.mark.parametrize("key", CHARACTERS)
def test_the_demo_maps_a_character_as_python_does(page: Page, tmp_path: Path, key: str) -> None:
    data = skinned(CHARACTERS[key]())
    path = tmp_path / f"{key}.{'vrm' if key.startswith('vrm') else 'glb'}"
    path.write_bytes(data)
    assert "stays on this machine" in give(page, path.name, data)
    found, rig = page.evaluate(DATA, path.name), read_rig(path)
    wanted = LiveRig(rig).page_character()
    assert [drive[:2] for drive in found["drives"]] == [drive[:2] for drive in wanted["drives"]]
    turns, others = (np.array([drive[2:] for drive in one["drives"]]) for one in (found, wanted))
    assert np.abs((turns * others).sum(-1)).min() > 1.0 - 1e-6
    assert found["moves"] == wanted["moves"]
    for name in ("raised", "lift", "scale"):
        assert found[name] == pytest.approx(wanted[name], rel=1e-5, abs=2e-5), name
    model = with_rig(load_bundled_model(), rig)
    offsets, soles = model.characters[rig.name], model.soles.get(rig.name)
    assert (soles is None) == (not found["soles"])
    if soles is not None:
        assert found["floor"] == pytest.approx(soles.floor, abs=2e-3)
        for one, other in zip(found["soles"][::2], (soles.left, soles.right), strict=True):
            assert np.ptp(np.array(one), axis=0) == pytest.approx(np.ptp(other.foot, axis=0), abs=2e-3)
    assert np.abs(np.array(found["offsets"]).reshape(-1, 3) - offsets).max() < 2e-3
    assert len(found["twists"]) == len(wanted["twists"]) == (2 if key == "twists" else 0)
    for one, other in zip(*(sorted(data["twists"], key=str) for data in (found, wanted)), strict=True):
        assert (one["node"], one["taken"]) == (other["node"], other["taken"])
        axes = [np.array([data["axis"], *(share[2:] for share in data["shares"])]) for data in (one, other)]
        assert np.allclose(*axes, atol=1e-5)
        assert [s[:2] for s in one["shares"]] == [pytest.approx(s[:2], abs=1e-5) for s in other["shares"]]


def test_the_demo_moves_a_posed_character_from_its_bind_pose(page: Page, tmp_path: Path) -> None:
    found = []
    for name, change in (("rest.glb", id), ("posed.glb", posed)):
        data = skinned(character(), change)
        assert "stays on this machine" in give(page, name, data)
        found.append(page.evaluate(DATA, name))
    (tmp_path / "posed.glb").write_bytes(data)
    wanted = LiveRig(read_rig(tmp_path / "posed.glb")).page_character()
    for one in (found[0], wanted):
        turns, others = (np.array([drive[2:] for drive in each["drives"]]) for each in (found[1], one))
        assert np.abs((turns * others).sum(-1)).min() > 1.0 - 1e-6
        assert found[1]["lift"] == pytest.approx(one["lift"], abs=2e-5)


def renamed(value: dict[str, Any]) -> None:
    value["nodes"][2 + JOINT_NAMES.index("LeftUpLeg")]["name"] = "tail"


def circular(value: dict[str, Any]) -> None:
    value["nodes"][5]["children"] = [4]
    del value["nodes"][3]["children"]


def bare(value: dict[str, Any]) -> None:
    value.update(nodes=[{"mesh": 0}], skins=[], scenes=[{"nodes": [0]}])


def unseen(value: dict[str, Any]) -> None:
    del value["meshes"], value["nodes"][-1]["mesh"]


def loose(value: dict[str, Any]) -> None:
    del value["skins"], value["nodes"][-1]["skin"]


def apart(value: dict[str, Any]) -> None:
    value["nodes"].append({"name": ["no", "text"]})
    value["skins"][0]["joints"].append(len(value["nodes"]) - 1)


def two(value: dict[str, Any]) -> None:
    two_below_one(value)
    value["nodes"][-2]["skin"] = 1


FAULTS: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "no skeleton": (bare, "no skeleton"),
    "no mesh": (unseen, "no meshes"),
    "circle": (circular, "circle"),
    "no skin": (loose, "no skin binds its meshes"),
    "joint without node": (lambda value: value["skins"][0]["joints"].append(99), "no nodes of the file"),
    "no node": (lambda value: value["nodes"].append(None), "no lists of objects"),
    "two trees": (apart, "in two trees"),
    "two": (two, "two skeletons"),
    "no leg": (renamed, "looked for a side (left, right, L, R) with thigh"),
    "elsewhere": (lambda value: value["buffers"][0].update(uri="hero.bin"), "another file"),
    "draco": (lambda value: value.update(extensionsRequired=["KHR_draco_mesh_compression"]), "without"),
}


def refused(page: Page, data: bytes) -> str:
    """What the page says of a file, after which all is as before."""
    state = "[motionkit.facts.get(1).body, Object.keys(motionkit.link.bodies).length]"
    before = page.evaluate(state)
    line = give(page, "my.glb", data)
    assert line.startswith("my.glb: ") and "\n" not in line and len(line) < 600
    assert page.evaluate(state) == before
    return line


@pytest.mark.parametrize("fault", FAULTS)
def test_a_file_that_cannot_move_is_one_line(page: Page, fault: str) -> None:
    change, said = FAULTS[fault]
    assert said in refused(page, skinned(character(), change))


def test_files_that_are_no_whole_glb_are_one_line(page: Page) -> None:
    assert "no binary glTF" in refused(page, b"solid cube, and no glTF at all")
    assert "in the middle of a chunk" in refused(page, skinned(character())[:900])


def live_places(rig: Rig, root: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """The joints (J, 3) of a rig in cm that clients of `play` are told, for a live character of 23 joints."""
    none, turns = np.zeros((4,), np.float32), rotations.reshape(-1, 4)
    one = CharacterState(1, 0, 0, False, None, False, none, 0.0, root, turns, np.zeros((23, 3), np.float32))
    pose = LiveRig(rig).pose(one)
    turns, local = (np.array(pose[name], np.float32)[None] for name in ("rotations", "positions"))
    return motion_kinematics(Motion(rig.skeleton, turns, local[:, 0], 60.0, local))[1][0] * rig.scale


@pytest.mark.parametrize("key", ["plain", "vrm0", "vrm1", "heels on root", "belt on root"])
def test_a_recording_is_the_file_with_one_animation_more(page: Page, tmp_path: Path, key: str) -> None:
    name = f"{key}-hero.{'vrm' if key.startswith('vrm') else 'glb'}"
    source = skinned(CHARACTERS[key]())
    (tmp_path / name).write_bytes(source)
    give(page, name, source)
    page.wait_for_function("name => motionkit.own?.figure.hero && motionkit.own.body === name", arg=name)
    hair = "[...motionkit.own.figure.hero.nodes.find((node) => node.name === 'hair')?.quaternion ?? []].slice(0, 4)"
    before = page.evaluate(hair)
    page.evaluate("motionkit.record()")
    page.evaluate("motionkit.perform('cartwheel')")
    page.wait_for_function("motionkit.link.world.characters.get(1).recorded.length > 90")
    assert (page.evaluate(hair) != before) == key.startswith("vrm")  # the spring bone of an avatar swings
    kept = page.evaluate(
        "motionkit.link.world.characters.get(1).recorded.map((one) => [[...one.root], [...one.rotations]])"
    )
    with page.expect_download() as download:
        page.evaluate("motionkit.record()")
    written = tmp_path / f"written-{name}"
    download.value.save_as(written)
    (_, old, binary), (_, new, longer) = parts(tmp_path / name), parts(written)
    assert longer.startswith(binary)
    assert {key: new[key] for key in old if key not in ("accessors", "bufferViews", "buffers")} == {
        key: old[key] for key in old if key not in ("accessors", "bufferViews", "buffers")
    }
    assert new["accessors"][: len(old["accessors"])] == old["accessors"]
    (animation,) = new["animations"]
    assert {channel["target"]["path"] for channel in animation["channels"]} == {"rotation", "translation"}
    motion, rig = read_clip(written).motion, read_rig(written)
    assert len(motion) >= len(kept) > 90
    wanted = [
        live_places(rig, np.array(root, np.float32), np.array(turns, np.float32)) for root, turns in kept
    ]
    assert np.abs(motion_kinematics(motion)[1][: len(kept)] - wanted).max() < 0.1


def test_a_toon_avatar_with_tangents_is_drawn(open_page: Callable[..., Page], address: str) -> None:  # noqa: F811
    page, said = open_page(address, 320, 240), list[str]()
    page.on("console", lambda message: said.append(message.text))
    page.wait_for_function("window.motionkit?.own?.root")
    give(page, "hero.vrm", skinned(CHARACTERS["vrm1"](), toon))
    page.wait_for_function("motionkit.own?.figure.hero && motionkit.own.figure.visible")
    drawn(page)
    page.close()
    assert not said, said


@pytest.mark.parametrize("key", ["plain", "twists", "vrm0", "heels on root"])
def test_play_shows_the_character_where_json_clients_get_it(
    serve: Callable, open_page: Callable[..., Page], tiny_model: MotionModel, tmp_path: Path, key: str
) -> None:
    path = tmp_path / "hero.glb"
    path.write_bytes(skinned(CHARACTERS[key]()))
    rig = read_rig(path)
    running = serve(model=with_rig(tiny_model, rig), body=rig.name, rig=rig)
    page = open_page(running.addresses.url)
    page.wait_for_function("motionkit.own?.figure.hero && motionkit.own.figure.visible")
    nodes = [rig.character.nodes[joint] for joint in range(len(rig.skeleton))] if rig.character else []
    shown = page.evaluate(
        """(nodes) => {
          const { figure, pose, rig, now } = motionkit.own;
          figure.setPose(pose.set(rig, now.rotations, 0, now.root.map((cm) => cm / 100), 0));
          figure.hero.updateWorldMatrix(true, true);
          const places = nodes.map((node) => [...figure.hero.nodes[node].matrixWorld.elements].slice(12, 15));
          return { root: [...now.root], rotations: [...now.rotations], places };
        }""",
        nodes,
    )
    places = live_places(rig, *(np.array(shown[name], np.float32) for name in ("root", "rotations")))
    page.close()  # before the server is gone
    assert np.abs(np.array(shown["places"]) - places / 100.0).max() < 1e-3
