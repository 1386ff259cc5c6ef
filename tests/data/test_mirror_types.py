"""Types whose mirror images are other types, by names and by motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motionkit.data.dataset import Dataset
from motionkit.data.mirror_types import EVERY, mirrored_types, type_poses
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.errors import DatasetError
from motionkit.features.encode import encode_motion
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout
from motionkit.motion.bvh import write_bvh
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import JOINT_COUNT
from motionkit.rig.mirror import mirror_motion
from synthetic_motions import make_jump, make_walk


def poses(**motions: Motion) -> dict[str, np.ndarray]:
    found = {}
    for kind, motion in motions.items():
        found |= type_poses(motion, [(0, len(motion), kind)])
    return found


def test_hops_on_either_leg_are_twins_whatever_their_names() -> None:
    shown = poses(
        eins=make_jump(150, side=1.0), zwei=make_jump(140, side=-1.0, phase=0.5), gehen=make_walk(200)
    )
    assert mirrored_types(tuple(shown), shown) == {"eins": "zwei", "zwei": "eins", "gehen": "gehen"}
    del shown["zwei"]
    assert mirrored_types(tuple(shown), shown) == {"eins": "eins", "gehen": "gehen"}


def test_names_come_first() -> None:
    shown = poses(kickL=make_jump(150, side=1.0), other=make_jump(140, side=-1.0))
    assert mirrored_types(tuple(shown), shown) == {"kickL": "kickR", "other": "other"}


def test_types_that_look_the_same_from_both_sides_are_their_own() -> None:
    walk = make_walk(200, turn=0.0)
    shown = poses(a=walk, b=mirror_motion(walk))
    assert mirrored_types(tuple(shown), shown) == {"a": "a", "b": "b"}


def test_the_frames_of_each_stretch_count() -> None:
    motion = make_walk(100)
    found = type_poses(motion, [(0, 40, "a"), (40, 90, "b"), (90, 100, "a")])
    assert (len(found["a"]), len(found["b"])) == (5 + 1, 7)


def test_poses_are_those_of_the_whole_motion() -> None:
    motion = make_walk(200)
    whole = encode_motion(motion, quat_identity((JOINT_COUNT,)), DEFAULT_LAYOUT).features
    found = type_poses(motion, [(0, 200, "a")])["a"]
    wanted = whole[::EVERY, feature_layout(DEFAULT_LAYOUT).blocks["joint_positions"]]
    apart = np.linalg.norm((found - wanted)[:, 1:].reshape(len(found), -1, 3), axis=-1)
    assert apart.mean() < 0.1, "cm"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("twins")
    for kind, side in (("tritt_1", 1.0), ("tritt_2", -1.0)):
        (out / "in" / kind).mkdir(parents=True)
        for number in range(2):
            write_bvh(out / "in" / kind / f"{number}.bvh", make_jump(150, side=side, phase=float(number)))
    preprocess([out / "in"], out / "dataset", PreprocessOptions(jobs=1))
    return out / "dataset"


def test_mirrored_clips_count_for_the_other_type(folder: Path) -> None:
    dataset = Dataset(folder)
    assert dataset.mirrored_type_ids.tolist() == [1, 0]
    twin = next(clip for clip in dataset.clips if clip.mirrored)
    assert dataset.types[dataset.clip_types(twin)[0]] != twin.name.split("/")[-2]


def test_a_twin_that_is_no_type_is_refused(folder: Path, tmp_path: Path) -> None:
    text = (folder / "manifest.json").read_text()
    assert '"mirrored_types": {"tritt_1": "tritt_2"' in text
    for file in folder.iterdir():
        (tmp_path / file.name).symlink_to(file)
    (tmp_path / "manifest.json").unlink()
    (tmp_path / "manifest.json").write_text(text.replace('{"tritt_1": "tritt_2"', '{"tritt_1": "hieb"'))
    with pytest.raises(DatasetError, match="mirrored_types"):
        Dataset(tmp_path)


def test_a_word_of_one_side_may_have_two_of_the_other() -> None:
    for right in ("droit", "droite"):
        types = ("coup-gauche", f"coup-{right}")
        assert mirrored_types(types, {}) == dict(zip(types, reversed(types), strict=True))
