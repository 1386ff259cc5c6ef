"""Characters that were saved in a pose: their rest pose is the one that their skin is bound in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.export.clip import rig_clip
from motionkit.export.formats import read_clip, write_motion
from motionkit.finish.on_rig import on_rig
from motionkit.motion.kinematics import motion_kinematics
from motionkit.rig.character import Character, read_character
from motionkit.rig.on_rig import read_rig
from rig.test_character import parts, worlds, write
from rig.test_read_glb import TURNS, Maker, plain
from synthetic_characters import posed
from synthetic_motions import make_walk


def saved(
    folder: Path, name: str, space: Array, in_pose: bool, scales: dict[str, list[float]] | None = None
) -> Character:
    """A character with a skin bound where it stands, in a space of the mesh; and posed or scaled afterwards."""
    maker = Maker()
    tree = read_character(maker.write(folder / "unbound.glb")).tree
    (skin,) = maker.value["skins"]
    binds = np.stack([np.linalg.inv(tree.world[joint]) @ space for joint in skin["joints"]])
    columns = binds.swapaxes(1, 2).astype("<f4")
    skin["inverseBindMatrices"] = maker.accessor(len(binds), "MAT4", bufferView=maker.view(columns.tobytes()))
    if in_pose:
        posed(maker.value)
    for node in maker.value["nodes"]:
        if node.get("name") in (scales or {}):
            node["scale"] = scales[node["name"]]
    maker.clip("turn", plain(maker))
    return read_character(maker.write(folder / name))


@pytest.mark.parametrize("space", [np.eye(4), np.diag([0.01, 0.01, 0.01, 1.0])], ids=["scene", "armature"])
def test_a_posed_character_moves_as_if_it_were_at_rest(tmp_path: Path, space: Array) -> None:
    rest, other = (saved(tmp_path, f"{name}.glb", space, name == "posed") for name in ("rest", "posed"))
    assert other.posed and not rest.posed
    assert np.abs(other.skeleton.offsets - rest.skeleton.offsets).max() < 1e-5
    for name in ("rest", "posed"):
        rig = read_rig(tmp_path / f"{name}.glb")
        write_motion(tmp_path / f"{name}-walk.glb", rig_clip(on_rig(make_walk(60), rig), rig, "walk"))
    made = [worlds(tmp_path / f"{name}-walk.glb") for name in ("rest", "posed")]
    assert max(np.abs(made[0][node] - made[1][node]).max() for node in made[0]) < 1e-5
    clips = [read_clip(tmp_path / f"{name}-walk.glb", "walk").motion for name in ("rest", "posed")]
    apart = [motion_kinematics(clip)[1] for clip in clips]
    assert np.abs(apart[0] - apart[1]).max() < 1e-3


def test_joints_without_keys_stay_in_the_pose_of_the_file(tmp_path: Path) -> None:
    character = saved(tmp_path, "posed.glb", np.eye(4), in_pose=True)
    motion = read_clip(tmp_path / "posed.glb", "turn").motion
    shown, places = worlds(tmp_path / "posed.glb"), motion_kinematics(motion)[1] / 100.0
    assert len(motion) == len(TURNS)
    for joint, name in enumerate(character.skeleton.names):
        assert np.abs(places[:, joint] - shown[name][:, :3, 3]).max() < 1e-4, name


def test_bones_that_were_scaled_after_binding_are_the_body_to_move(tmp_path: Path) -> None:
    """As by sliders for proportions. Animations keep the scale, so legs as bound would sink into the floor."""
    usual = saved(tmp_path, "usual.glb", np.eye(4), in_pose=False)
    scales = {f"{side}UpLeg": [1.3, 1.3, 1.3] for side in ("Left", "Right")}
    long = saved(tmp_path, "long.glb", np.eye(4), in_pose=False, scales=scales)
    knee, ankle = (usual.skeleton.names.index(f"Left{part}") for part in ("Leg", "Foot"))
    assert not long.posed
    for joint in (knee, ankle):
        assert np.allclose(long.skeleton.offsets[joint], 1.3 * usual.skeleton.offsets[joint], atol=1e-5)
    rig = read_rig(tmp_path / "long.glb")
    walk = on_rig(make_walk(60), rig)
    write_motion(tmp_path / "walk.glb", rig_clip(walk, rig, "walk"))
    shown, places = worlds(tmp_path / "walk.glb"), motion_kinematics(walk)[1]
    for joint in (knee, ankle):
        apart = shown[usual.skeleton.names[joint]][:, :3, 3] - places[:, joint]
        assert np.abs(apart).max() < 1e-4


def test_matrices_that_cannot_be_inverted_are_no_pose(tmp_path: Path) -> None:
    assert not saved(tmp_path, "flat.glb", np.diag([1.0, 1.0, 0.0, 1.0]), in_pose=True).posed


def test_a_prop_hidden_by_a_scale_of_zero_is_no_part_of_the_body(tmp_path: Path) -> None:
    seen = saved(tmp_path, "seen.glb", np.eye(4), True)
    _, value, data = parts(tmp_path / "seen.glb")
    hand = next(i for i, node in enumerate(value["nodes"]) if node.get("name") == "RightHand")
    value["nodes"] += [
        {"name": "Weapon", "scale": [0, 0, 0], "children": [len(value["nodes"]) + 1]},
        {"name": "Tip"},
    ]
    value["nodes"][hand].setdefault("children", []).append(len(value["nodes"]) - 2)
    write(tmp_path / "hidden.glb", value, data)
    hidden = read_character(tmp_path / "hidden.glb")
    assert hidden.posed and np.array_equal(hidden.skeleton.offsets, seen.skeleton.offsets)
