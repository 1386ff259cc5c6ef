"""Motion files of every format, read back by our own reader, by the standard library and by numpy."""

from __future__ import annotations

import csv
import json
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import MotionkitError, SkeletonError
from motionkit.export.clip import Clip, check_numbers, rig_clip
from motionkit.export.figure import Figure, make_figure, skin_weights
from motionkit.export.formats import WRITERS, check_ending, read_clip, read_motion, write_motion
from motionkit.export.tables import contacts, frame_types
from motionkit.export.usda import joint_paths
from motionkit.export.vrma import BONES, humanoid_motion
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_angle, quat_to_matrix
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton
from motionkit.rig.gltf import GltfDocument, GltfFile
from motionkit.rig.on_rig import read_rig
from synthetic_motions import make_walk

CMU = Path(__file__).resolve().parents[2] / "examples" / "data" / "16_45.bvh"

# A .vrm takes an avatar, FBX needs Blender (tests/rig/test_fbx.py).
FORMATS = [ending for ending in WRITERS if ending not in (".vrm", ".fbx")]


@pytest.fixture(scope="module")
def walk() -> Motion:
    return make_walk(40)


@pytest.fixture(scope="module")
def cmu() -> Motion:
    return bvh_to_motion(read_bvh(CMU)).cut(0, 60)


@pytest.fixture
def six_channels(walk: Motion) -> Motion:
    """A walk whose hand slides along the forearm."""
    local = np.tile(walk.skeleton.offsets, (len(walk), 1, 1))
    local[:, JOINT_NAMES.index("LeftHand"), 0] += np.linspace(0.0, 5.0, len(walk), dtype=np.float32)
    return replace(walk, local_positions=local)


def positions(motion: Motion) -> np.ndarray:
    return motion_kinematics(motion)[1]


def test_a_glb_read_back_is_the_same_motion(walk: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.glb", walk)
    back = read_motion(tmp_path / "a.glb")
    assert back.skeleton.same_hierarchy(walk.skeleton) and back.fps == walk.fps and len(back) == len(walk)
    assert np.abs(positions(back) - positions(walk)).max() < 1e-3
    assert float(quat_angle(back.local_rotations, walk.local_rotations).max()) < 1e-3
    for joint, end in walk.skeleton.end_sites.items():
        assert back.skeleton.end_sites[joint] == pytest.approx(end, abs=1e-4)


def test_the_units_of_other_rigs_become_metres(cmu: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.glb", cmu)
    back = read_motion(tmp_path / "a.glb")
    assert back.skeleton.same_hierarchy(cmu.skeleton) and back.fps == 120
    assert np.abs(positions(back) - positions(cmu) * 2.54 / 0.45).max() < 1e-2


@pytest.mark.parametrize("ending", [".glb", ".usda"])
def test_the_rest_pose_stands_on_the_floor_wherever_the_root_is(
    walk: Motion, tmp_path: Path, ending: str
) -> None:
    """The OFFSET of a root is no part of the body: once more to BVH and back gives the same rest pose."""
    offsets = walk.skeleton.offsets.copy()
    offsets[0] = (20.0, 90.0, 0.0)
    moved = replace(walk, skeleton=replace(walk.skeleton, offsets=offsets))
    assert make_figure(moved).rest == pytest.approx(make_figure(walk).rest, abs=1e-6)
    for name, motion in (("a", walk), ("b", moved)):
        write_motion(tmp_path / f"{name}{ending}", Clip(motion, "walk"))
    assert (tmp_path / f"a{ending}").read_bytes() == (tmp_path / f"b{ending}").read_bytes()


def test_rounds_of_glb_and_bvh_keep_the_rest_pose(walk: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "0.glb", walk)
    for number in range(2):
        write_motion(tmp_path / f"{number}.bvh", read_motion(tmp_path / f"{number}.glb"))
        write_motion(tmp_path / f"{number + 1}.glb", read_motion(tmp_path / f"{number}.bvh"))
    first, last = (read_motion(tmp_path / f"{number}.glb") for number in (0, 2))
    assert last.skeleton.offsets == pytest.approx(first.skeleton.offsets, abs=1e-3)


def test_joints_that_translate_keep_doing_so(six_channels: Motion, tmp_path: Path) -> None:
    for ending in (".glb", ".bvh"):
        write_motion(tmp_path / f"a{ending}", six_channels)
        back = read_motion(tmp_path / f"a{ending}")
        assert np.abs(positions(back) - positions(six_channels)).max() < 1e-2
    assert (tmp_path / "a.bvh").read_text().count("CHANNELS 6") == 2
    animation = GltfFile(tmp_path / "a.glb").items("animations")[0]
    assert sum(channel["target"]["path"] == "translation" for channel in animation["channels"]) == 2


def test_all_joints_are_in_the_skin_and_bind_to_the_mesh(cmu: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.glb", cmu)
    file = GltfFile(tmp_path / "a.glb")
    (skin,) = file.items("skins")
    names = [file.items("nodes")[joint]["name"] for joint in skin["joints"]]
    assert names == list(cmu.skeleton.names)
    inverse = file.array(skin["inverseBindMatrices"], 16).reshape(-1, 4, 4).transpose(0, 2, 1)
    figure = make_figure(cmu)
    assert inverse == pytest.approx(figure.inverse_binds, abs=1e-5)
    # The nodes are the rest pose, the soles on the floor.
    nodes = [file.items("nodes")[joint] for joint in skin["joints"]]
    at = np.tile(np.eye(4), (len(names), 1, 1))
    for joint, parent in enumerate(cmu.skeleton.parents):
        x, y, z, w = nodes[joint]["rotation"]
        at[joint, :3, :3] = quat_to_matrix(np.array([w, x, y, z]))
        at[joint, :3, 3] = nodes[joint]["translation"]
        at[joint] = at[max(parent, 0)] @ at[joint] if joint else at[joint]
    assert lowest(figure, at) == pytest.approx(0.0, abs=1e-4)
    assert lowest(figure, figure.binds) == pytest.approx(0.0, abs=1e-4), (
        "which Blender takes for the rest pose"
    )
    # Y points along the bones.
    for joint, end in (("LeftUpLeg", "LeftLeg"), ("RightForeArm", "RightHand"), ("Spine1", "Neck1")):
        here, there = (at[names.index(name)] for name in (joint, end))
        way = there[:3, 3] - here[:3, 3]
        assert here[:3, 1] @ way / np.linalg.norm(way) > 0.98


def lowest(figure: Figure, joints: np.ndarray) -> float:
    """Height of the lowest point of the body with the joints at global matrices (J, 4, 4)."""
    return float(figure.surface.posed((joints @ figure.inverse_binds)[:, :3])[:, 1].min())


def test_a_skin_moves_points_as_the_viewer_does(walk: Motion) -> None:
    figure = make_figure(walk)
    joints, weights = skin_weights(figure.surface)
    assert weights.sum(axis=1) == pytest.approx(1.0, abs=1e-6)
    assert not joints[weights == 0.0].any() and (weights >= 0.0).all()
    for one, other in combinations(range(4), 2):
        assert not ((joints[:, one] == joints[:, other]) & (weights[:, [one, other]] > 0.0).all(axis=1)).any()
    rotations, places = motion_kinematics(figure.motion)
    now = np.tile(np.eye(4), (len(walk.skeleton), 1, 1))
    now[:, :3, :3], now[:, :3, 3] = quat_to_matrix(rotations[20]), places[20]
    moves = now @ figure.inverse_binds
    whole = np.concatenate([figure.surface.points, np.ones((len(joints), 1))], axis=1)
    skinned = np.einsum("vk,vkij,vj->vi", weights, moves[joints], whole)[:, :3]
    assert skinned == pytest.approx(figure.surface.posed(moves[:, :3]), abs=2e-4)


def test_normals_point_outwards(walk: Motion) -> None:
    figure = make_figure(walk)
    surface, normals = figure.surface, figure.normals
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    corners = surface.points[surface.triangles]
    faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    along = (faces[:, None] * normals[surface.triangles]).sum(axis=-1)
    assert (along > 0.0).mean() > 0.98  # lids and ears fold


def test_the_layout_of_a_binary_file(walk: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.glb", Clip(walk, "ein Gang", [("walking", 0.5)]))
    data = (tmp_path / "a.glb").read_bytes()
    magic, version, size = struct.unpack_from("<4sII", data)
    assert (magic, version, size) == (b"glTF", 2, len(data))
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and length % 4 == 0
    value = json.loads(data[20 : 20 + length])
    assert value["animations"][0]["name"] == "ein Gang"
    assert value["animations"][0]["extras"] == {"fps": 60.0, "types": [["walking", 0.5]]}
    assert value["buffers"] == [{"byteLength": len(data) - 28 - length}]
    for view in value["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= value["buffers"][0]["byteLength"]


def test_a_vrm_animation_is_a_t_pose_on_the_floor(walk: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.vrma", walk)
    file = GltfFile(tmp_path / "a.vrma")
    about = file.json["extensions"]["VRMC_vrm_animation"]
    assert about["specVersion"] == "1.0" and file.json["extensionsUsed"] == ["VRMC_vrm_animation"]
    bones = {bone: value["node"] for bone, value in about["humanoid"]["humanBones"].items()}
    assert set(bones) == set(BONES.values()) and len(bones) == 22
    nodes = file.items("nodes")
    assert not any("rotation" in node or "scale" in node for node in nodes)
    above = {child: i for i, node in enumerate(nodes) for child in node.get("children", [])}

    def place(bone: str) -> np.ndarray:
        at, node = np.zeros(3), bones[bone]
        while node is not None:
            at, node = at + nodes[node]["translation"], above.get(node)
        return at

    for side, sign in (("left", 1.0), ("right", -1.0)):
        leg = place(f"{side}Foot") - place(f"{side}UpperLeg")
        assert leg / np.linalg.norm(leg) == pytest.approx([0.0, -1.0, 0.0], abs=1e-3)
        arm = place(f"{side}Hand") - place(f"{side}UpperArm")
        assert arm / np.linalg.norm(arm) == pytest.approx([sign, 0.0, 0.0], abs=1e-3)
        toes = place(f"{side}Toes") - place(f"{side}Foot")
        assert toes[2] > 0.1 and 0.09 < place(f"{side}Foot")[1] < 0.12
    animation = file.items("animations")[0]
    moving = [c["target"]["node"] for c in animation["channels"] if c["target"]["path"] == "translation"]
    assert moving == [bones["hips"]]


def test_a_humanoid_moves_as_the_canonical_body(walk: Motion) -> None:
    made = humanoid_motion(walk)
    at, then = positions(walk) / 100.0, positions(made)
    for joint, name in enumerate(made.skeleton.names):
        # The head is as far from the neck as in the rest pose: Neck1, which bends in between, is left out.
        near = 0.02 if name == "Head" else 1e-5
        assert np.abs(at[:, JOINT_NAMES.index(name)] - then[:, joint]).max() < near, name


def test_usd_text(cmu: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.usda", cmu)
    text = (tmp_path / "a.usda").read_text()
    assert text.startswith("#usda 1.0\n") and text.count("{") == text.count("}")
    for name in ("translations", "rotations", "scales"):
        block = text.split(f"{name}.timeSamples = {{")[1].split("}")[0]
        assert re.findall(r"^ +(\d+): ", block, re.MULTILINE) == [str(t) for t in range(60)]
    joints = json.loads(text.split("uniform token[] joints = ")[1].split("\n")[0])
    assert joints == joint_paths(cmu.skeleton) and len(joints) == len(cmu.skeleton)


def test_usd_names_are_valid_and_differ() -> None:
    skeleton = Skeleton(("mixamorig:Hips", "mixamorig Hips", "3 é", ""), (-1, 0, 1, 1), np.zeros((4, 3)))
    paths = joint_paths(skeleton)
    names = [path.rsplit("/", 1)[-1] for path in paths]
    assert len(set(names)) == 4 and all(re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII) for name in names)
    assert paths[2].startswith(f"{paths[1]}/") and paths[1].startswith(f"{paths[0]}/")


def test_arrays_and_tables_agree(cmu: Motion, tmp_path: Path) -> None:
    clip = Clip(cmu, "run", [("running", 0.2), ("walking", 0.2)])
    write_motion(tmp_path / "a.npz", clip)
    write_motion(tmp_path / "a.csv", clip)
    arrays = np.load(tmp_path / "a.npz")
    assert arrays["joints"].tolist() == list(cmu.skeleton.names) and arrays["fps"] == 120
    assert np.abs(arrays["positions"] - positions(cmu) * 2.54 / 0.45).max() < 1e-2
    assert arrays["types"].tolist() == ["running"] * 24 + ["walking"] * 36
    assert arrays["contacts"].shape == (60, 4) and 0 < arrays["contacts"].mean() < 1
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 60 and rows[59]["seconds"] == f"{59 / 120:.9g}"
    for joint, name in enumerate(cmu.skeleton.names):
        table = [[float(row[f"{name}_{axis}"]) for axis in "xyz"] for row in rows]
        assert table == pytest.approx(arrays["positions"][:, joint], rel=1e-4, abs=1e-3)
        quats = [[float(row[f"{name}_q{axis}"]) for axis in "wxyz"] for row in rows]
        assert quats == pytest.approx(arrays["rotations"][:, joint], abs=1e-4)
    feet = [[int(row[f"{name}_contact"]) for name in arrays["contact_joints"]] for row in rows]
    assert (feet == arrays["contacts"]).all() and rows[0]["type"] == "running"


@pytest.mark.parametrize("ending", FORMATS)
def test_a_single_joint(make_motion: Callable[..., Motion], tmp_path: Path, ending: str) -> None:
    one = make_motion(5, skeleton=Skeleton(("Ball",), (-1,), np.zeros((1, 3), np.float32), {}))
    if ending == ".vrma":
        with pytest.raises(SkeletonError):
            write_motion(tmp_path / "a.vrma", one)
    else:
        write_motion(tmp_path / f"a{ending}", one)


def test_usd_has_names_that_its_paths_cannot(make_motion: Callable[..., Motion], tmp_path: Path) -> None:
    offsets = np.array([[0, 0, 0], [0, 10, 0]], np.float32)
    write_motion(
        tmp_path / "a.usda",
        make_motion(2, skeleton=Skeleton(("腰", "左足"), (-1, 0), offsets, {1: (0, 9, 0)})),
    )
    assert 'uniform token[] jointNames = ["腰", "左足"]' in (tmp_path / "a.usda").read_text("utf-8")


def test_rigs_that_are_not_human(make_motion: Callable[..., Motion], tmp_path: Path) -> None:
    """A crane: three joints that nothing names; written everywhere but as an animation of a humanoid."""
    offsets = np.array([[0, 0, 0], [0, 60, 0], [0, 80, 10]], np.float32)
    crane = make_motion(20, skeleton=Skeleton(("Base", "Boom", "Hook"), (-1, 0, 1), offsets, {2: (0, 9, 0)}))
    for ending in FORMATS:
        if ending == ".vrma":
            with pytest.raises(SkeletonError):
                write_motion(tmp_path / "a.vrma", crane)
            continue
        write_motion(tmp_path / f"a{ending}", crane)
    assert not (tmp_path / "a.vrma").exists()
    assert np.load(tmp_path / "a.npz")["contacts"].shape == (0, 4)
    back = read_motion(tmp_path / "a.glb")
    assert float(quat_angle(back.local_rotations, crane.local_rotations).max()) < 1e-3


@pytest.mark.parametrize("ending", FORMATS)
def test_one_frame_and_upper_case(walk: Motion, tmp_path: Path, ending: str) -> None:
    write_motion(tmp_path / f"A{ending.upper()}", walk.cut(3, 4))
    assert [path.name for path in tmp_path.iterdir()] == [f"A{ending.upper()}"]


@pytest.mark.parametrize("ending", FORMATS)
@pytest.mark.parametrize("broken", ["rotation", "position", "rate", "empty"])
def test_a_broken_motion_leaves_no_file(walk: Motion, tmp_path: Path, ending: str, broken: str) -> None:
    rotations, roots = walk.local_rotations.copy(), walk.root_positions.copy()
    rotations[3, 4] = np.nan if broken == "rotation" else rotations[3, 4]
    roots[3, 1] = np.inf if broken == "position" else roots[3, 1]
    motion = replace(
        walk, local_rotations=rotations, root_positions=roots, fps=0.0 if broken == "rate" else 60.0
    )
    with pytest.raises(MotionkitError, match="not written") as fault:
        write_motion(tmp_path / f"a{ending}", motion.cut(0, 0) if broken == "empty" else motion)
    assert "\n" not in str(fault.value) and not list(tmp_path.iterdir())


def changed(path: Path, change: Callable[[dict], object], data: bytes = b"") -> Path:
    """The file with its JSON changed, written beside it."""
    file = GltfFile(path)
    change(file.json)
    document = GltfDocument(file.json, bytearray(data or file.data))
    target = path.with_name("changed.glb")
    document.write(target)
    return target


def test_stepped_keys_hold_from_their_own_frame_on(walk: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.glb", replace(walk, fps=30.0))

    def step(value: dict) -> None:
        for sampler in value["animations"][0]["samplers"]:
            sampler["interpolation"] = "STEP"

    stepped, linear = (read_motion(path) for path in (changed(tmp_path / "a.glb", step), tmp_path / "a.glb"))
    assert np.abs(stepped.root_positions - linear.root_positions).max() < 1e-2
    assert float(quat_angle(stepped.local_rotations, linear.local_rotations).max()) < 1e-3


@pytest.mark.parametrize("whole", [24, 30, 60, 120])
def test_the_rates_of_ntsc_video_are_kept(cmu: Motion, tmp_path: Path, whole: int) -> None:
    rate = whole * 1000 / 1001
    write_motion(tmp_path / "a.bvh", replace(cmu, fps=rate))
    for source, target in (("a.bvh", "b.glb"), ("b.glb", "c.bvh")):
        write_motion(tmp_path / target, read_motion(tmp_path / source))
        assert read_motion(tmp_path / target).fps == pytest.approx(rate, rel=1e-9)


def loop_nodes(value: dict) -> None:
    value["nodes"][4]["children"] = [1]


def swap(value: dict, name: str, wrong: object) -> None:
    value["animations"][0]["channels"][3][name] = wrong


FAULTS: list[tuple[Callable[[dict], object], str]] = [
    (lambda v: v.pop("animations"), "has no animation"),
    (
        lambda v: v["animations"].append(v["animations"][0] | {"name": "b\nc"}),
        r"choose one with --clip: a \(.*b.nc",
    ),
    (lambda v: v["animations"][0].update(channels=True), "no list of objects"),
    (lambda v: v["animations"][0].update(samplers="all"), "no list of objects"),
    (lambda v: v["animations"][0].update(channels=[]), "moves no joint"),
    (lambda v: swap(v, "target", "hand"), "no target"),
    (lambda v: swap(v, "sampler", True), "no target, or a sampler"),
    (lambda v: swap(v, "sampler", 999), "a sampler that does not exist"),
    (lambda v: v["animations"][0]["channels"][3]["target"].update(node=1), "two channels"),
    (lambda v: v["animations"][0]["channels"][3]["target"].update(node="1"), r"nodes\[1\]"),
    (lambda v: v["animations"][0]["samplers"][3].update(interpolation=[1]), "interpolation"),
    (lambda v: v["nodes"][2].update(translation=[0, "x", 0]), "expected 3 numbers"),
    (lambda v: v["nodes"][2].update(rotation=[0, 0, 0, 0]), "length zero"),
    (lambda v: v["nodes"][2].update(scale=[-1, 1, 1]), "mirrored or flat"),
    (lambda v: v["skins"][0].update(joints=[0, 99]), "expected node numbers below"),
    (lambda v: v["skins"][0].update(joints="all"), "expected node numbers below"),
    (lambda v: v["accessors"][-1].update(count=10**9), "beyond the buffer"),
    (lambda v: v["accessors"][-1].update(componentType=5122), "no floats or normalized"),
    (lambda v: v["accessors"][-1].update(componentType=[5126]), "no floats or normalized"),
    (lambda v: v["accessors"][-1].update(sparse=[1]), "sparse without"),
    (lambda v: v["accessors"][-1].update(bufferView=10**6), "bufferViews"),
    (
        lambda v: v["animations"][0]["samplers"][2].update(input=v["animations"][0]["samplers"][2]["output"]),
        "expected",
    ),
    (lambda v: v.update(nodes=3), "no list of objects"),
    (loop_nodes, "two parents|circle"),
]


@pytest.mark.parametrize(("change", "said"), FAULTS, ids=[said for _, said in FAULTS])
def test_what_a_glb_may_not_hold(
    walk: Motion, tmp_path: Path, change: Callable[[dict], object], said: str
) -> None:
    write_motion(tmp_path / "a.glb", walk)
    with pytest.raises(MotionkitError, match=said) as fault:
        read_motion(changed(tmp_path / "a.glb", change))
    assert "changed.glb: " in str(fault.value) and "\n" not in str(fault.value)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "no binary glTF"),
        (b"HIERARCHY ROOT Hips and more", "no binary glTF"),
        (struct.pack("<4sIIII", b"glTF", 1, 20, 0, 0), "is glTF 1"),
        (struct.pack("<4sIII4s", b"glTF", 2, 20, 100, b"JSON"), "middle of a chunk"),
        (struct.pack("<4sIII4s", b"glTF", 2, 20, 0, b"BIN\0"), "no JSON chunk"),
        (struct.pack("<4sIII4s", b"glTF", 2, 24, 4, b"JSON") + b"[1] ", "is no object"),
        (struct.pack("<4sIII4s", b"glTF", 2, 24, 4, b"JSON") + b"\xff\xff\xff\xff", "not UTF-8"),
    ],
)
def test_what_is_no_glb(tmp_path: Path, data: bytes, said: str) -> None:
    (tmp_path / "a.glb").write_bytes(data)
    with pytest.raises(MotionkitError, match=said):
        read_motion(tmp_path / "a.glb")


def test_cut_and_damaged_files_are_faults_of_one_line(walk: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.glb", walk.cut(0, 4))
    data = (tmp_path / "a.glb").read_bytes()
    random = np.random.default_rng(0)
    length = struct.unpack_from("<I", data, 12)[0]
    for number in range(150):
        wrong = bytearray(data)
        for _ in range(random.integers(1, 4)):
            wrong[random.integers(12, 20 + length)] = random.integers(32, 127)
        broken = bytes(wrong) if number % 3 else data[: random.integers(0, len(data))]
        (tmp_path / "b.glb").write_bytes(broken)
        try:
            read_motion(tmp_path / "b.glb")
        except MotionkitError as fault:
            assert "\n" not in str(fault)


def test_rest_poses_with_rotations_are_straightened(walk: Motion, tmp_path: Path) -> None:
    """Other programs give bones a rest rotation: all nodes turned about X, children counter-turned."""
    write_motion(tmp_path / "a.glb", walk)
    half = np.sqrt(0.5)

    def turn(value: dict) -> None:
        root = value["skins"][0]["joints"][0]
        value["nodes"].append({"name": "Armature", "rotation": [half, 0, 0, half], "children": [root]})
        value["scenes"][0]["nodes"][0] = len(value["nodes"]) - 1

    back = read_motion(changed(tmp_path / "a.glb", turn))
    assert back.skeleton.names == walk.skeleton.names
    turned = positions(back)
    at = positions(walk)
    assert np.stack([turned[..., 0], turned[..., 2], -turned[..., 1]], -1) == pytest.approx(
        np.stack([at[..., 0], at[..., 1], at[..., 2]], -1), abs=1e-2
    )


@pytest.mark.parametrize("ending", WRITERS)
def test_only_fbx_asks_for_another_program(ending: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr("motionkit.rig.fbx.check_writes", asked.append)
    check_ending(f"a{ending}")
    assert asked == ["a.fbx"] * (ending == ".fbx")


@pytest.mark.parametrize("name", ["a.gltf", "a.txt", "a", "a.usd", "a.vrm"])
def test_endings_that_are_not_written(walk: Motion, tmp_path: Path, name: str) -> None:
    with pytest.raises(MotionkitError) as fault:
        write_motion(tmp_path / name, walk)
    assert "\n" not in str(fault.value) and not list(tmp_path.iterdir())
    assert (".glb" in str(fault.value)) or (".usda" in str(fault.value)) or (".vrma" in str(fault.value))


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("ending", FORMATS)
@pytest.mark.parametrize("joint", ["LeftForeArm", "LeftLeg", "Neck", "LeftArm", "Spine", "LeftFoot"])
@pytest.mark.parametrize("length", [0.0, 3e4, 1e6])
def test_bones_of_any_length_give_finite_numbers_or_one_line(
    walk: Motion, tmp_path: Path, ending: str, joint: str, length: float
) -> None:
    offsets = walk.skeleton.offsets.copy()
    offsets[JOINT_NAMES.index(joint)] = (0.0, length, 0.0)
    motion = replace(walk, skeleton=replace(walk.skeleton, offsets=offsets)).cut(0, 3)
    path = tmp_path / f"a{ending}"
    try:
        write_motion(path, motion)
    except SkeletonError as error:
        assert "\n" not in str(error) and not path.exists()
        return
    if ending in (".bvh", ".glb"):
        assert np.isfinite(positions(read_motion(path))).all()
    elif ending != ".npz" and ending != ".vrma":
        assert not re.search(r"\b(nan|inf)\b", path.read_text(), re.IGNORECASE)


def test_every_array_of_a_glb_begins_at_a_multiple_of_four() -> None:
    """As glTF demands of floats, also after arrays of an odd number of short integers."""
    document = GltfDocument()
    for _ in range(2):
        document.accessor(np.zeros(3, np.uint16), "SCALAR")
        document.accessor(np.zeros((2, 3), np.float32), "VEC3")
    offsets = [view["byteOffset"] for view in document.json["bufferViews"]]
    assert offsets == [0, 8, 32, 40]


# ---- channels of a source, heights, and rigs that are not human ----

TURNS, MOVES = ("Zrotation", "Xrotation", "Yrotation"), ("Xposition", "Yposition", "Zposition")


@pytest.mark.parametrize(
    ("hand", "others", "kept"),
    [
        (MOVES + TURNS, TURNS, True),
        (TURNS, TURNS, False),  # the hand moves
        (MOVES + TURNS, TURNS[:2], False),
        (MOVES[:2] + TURNS, TURNS, False),
    ],
)
def test_channels_are_kept_that_hold_the_motion(
    six_channels: Motion, hand: tuple[str, ...], others: tuple[str, ...], kept: bool
) -> None:
    channels = [MOVES + TURNS if not joint else others for joint in range(len(JOINT_NAMES))]
    channels[JOINT_NAMES.index("LeftHand")] = hand
    clip = Clip(six_channels, "clip", channels=tuple(channels))
    assert (clip.with_motion(six_channels).channels is not None) == kept


@pytest.mark.parametrize(
    ("change", "kept"),
    [("none", (True, True)), ("rest", (True, False)), ("names", (False, False))],
)
def test_the_text_of_a_source_is_kept_with_its_rest_pose(change: str, kept: tuple[bool, bool]) -> None:
    """Its channels, and its hierarchy, also where the rest pose differs by less than a thousandth."""
    clip = read_clip(CMU)
    skeleton, rig = clip.motion.skeleton, read_rig(CMU)
    skeleton = {
        "none": skeleton,
        "rest": replace(skeleton, offsets=skeleton.offsets * np.float32(1.0005)),
        "names": replace(skeleton, names=tuple(f"{name}_" for name in skeleton.names)),
    }[change]
    clip = replace(clip, hierarchy="text")
    edited = clip.with_motion(replace(clip.motion, skeleton=skeleton))
    assert (edited.channels is not None, edited.hierarchy is not None) == kept
    if change != "names":
        assert (rig_clip(edited.motion, rig, "a").hierarchy is not None) == kept[1]


@pytest.mark.parametrize(
    ("character", "types", "name"),
    [
        (True, ("walking", "idle", "walking"), "walking-idle"),
        (True, (), "clip"),
        (False, ("walking",), "clip"),
    ],
)
def test_an_animation_of_a_character_is_called_by_its_types(
    walk: Motion, tmp_path: Path, character: bool, types: tuple[str, ...], name: str
) -> None:
    write_motion(tmp_path / "a.glb", walk)
    rig = read_rig(tmp_path / "a.glb")
    rig = rig if character else replace(rig, character=None)
    assert rig_clip(walk, rig, "clip", [(kind, 1.0) for kind in types]).name == name


@pytest.mark.parametrize(
    ("values", "fits"),
    [
        ({"root": 1e7}, True), ({"root": -1.001e7}, False), ({"end": 1.001e7}, False), ({"bone": 1.001e7}, False),
        ({"turn": 1.009}, True), ({"turn": 1.011}, False), ({"turn": 0.991}, True), ({"turn": 0.989}, False),
        ({"fps": np.inf}, False), ({"fps": 0.001}, True),
    ],
)  # fmt: skip
def test_the_largest_numbers_of_a_file(make_motion: Callable[..., Motion], values: dict, fits: bool) -> None:
    offsets = np.float32([[0, 0, 0], [0, 60, 0], [0, values.get("bone", 80), 10]])
    ends = {2: (0.0, values.get("end", 9.0), 0.0)}
    motion = make_motion(3, skeleton=Skeleton(("Base", "Boom", "Hook"), (-1, 0, 1), offsets, ends))
    roots = np.full((3, 3), values.get("root", 0.0))
    turns = motion.local_rotations * np.float32(values.get("turn", 1.0))
    motion = replace(motion, root_positions=roots, local_rotations=turns, fps=values.get("fps", 30.0))
    if fits:
        check_numbers("a", motion)
    else:
        with pytest.raises(MotionkitError, match="a: not written"):
            check_numbers("a", motion)


@pytest.mark.parametrize(
    ("types", "labels"),
    [
        ((), [""] * 6),
        ((("a", 0.1),), ["a"] * 6),
        ((("a", 0.1), ("b", 9.0)), ["a"] * 3 + ["b"] * 3),
        ((("a", 0.05), ("b", 0.05), ("c", 0.05)), ["a", "a", "b", "c", "c", "c"]),
    ],
)
def test_every_frame_has_a_type(walk: Motion, types: tuple, labels: list[str]) -> None:
    """Of the time that has passed, rounded once; the last one goes on."""
    assert frame_types(Clip(replace(walk.cut(0, 6), fps=30.0), types=types)) == labels


def test_contacts_do_not_depend_on_the_floor(walk: Motion) -> None:
    raised = replace(walk, root_positions=walk.root_positions + np.float32([0.0, 30.0, 0.0]))
    assert contacts(walk).any() and np.array_equal(contacts(raised), contacts(walk))


def test_a_table_of_a_rig_that_is_not_human_has_empty_contacts(tmp_path: Path) -> None:
    turned = np.tile(np.float32([1.0, 0.0, 0.0, 0.0]), (2, 2, 1))
    skeleton = Skeleton(("Base", "Arm"), (-1, 0), np.float32([[0.0, 0.0, 0.0], [0.0, 10.0, 0.0]]))
    write_motion(tmp_path / "a.csv", Motion(skeleton, turned, np.zeros((2, 3), np.float32), 30.0))
    rows = list(csv.DictReader((tmp_path / "a.csv").open()))
    assert len(rows) == 2 and all(None not in row and None not in row.values() for row in rows)
    assert {row[name] for row in rows for name in row if name.endswith("_contact")} == {""}


def test_spine_and_thighs_hang_from_the_hips_in_a_vrma(walk: Motion, tmp_path: Path) -> None:
    write_motion(tmp_path / "a.vrma", walk)
    document = GltfFile(tmp_path / "a.vrma").json
    bones = document["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]
    children = set(document["nodes"][bones["hips"]["node"]]["children"])
    assert {bones[name]["node"] for name in ("spine", "leftUpperLeg", "rightUpperLeg")} == children


@pytest.mark.parametrize(("frames", "types"), [
    ([1], ["walking"] * 4), ([1, 1], ["walking", *["running"] * 3]), ([9], ["walking"] * 4), ([], [""] * 4),
])  # fmt: skip
def test_a_table_names_the_type_of_every_frame(frames: list[int], types: list[str]) -> None:
    kinds = [(kind, count / 60.0) for kind, count in zip(("walking", "running"), frames, strict=False)]
    assert frame_types(Clip(make_walk(4), "a", kinds)) == types


@pytest.mark.parametrize(("share", "kept"), [(0.0, True), (0.5, True), (2.0, False)])
def test_a_rig_keeps_its_text_if_its_bones_are_as_they_were(share: float, kept: bool) -> None:
    rig = read_rig(CMU)
    offsets = rig.skeleton.offsets.astype(np.float64)
    offsets[3, 1] += share * 1e-5 * rig.leg
    still = np.zeros((2, len(offsets), 4), np.float32)
    still[..., 0] = 1.0
    motion = Motion(replace(rig.skeleton, offsets=offsets), still, np.zeros((2, 3), np.float32), 60.0)
    assert rig.hierarchy and (rig_clip(motion, rig, "a").hierarchy == rig.hierarchy) == kept
