from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import motionkit as mk
from motionkit.arrays import Array
from motionkit.motion.bvh import BvhFile, motion_to_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_NAMES, Skeleton, canonical_skeleton
from motionkit.rig.planting import plant_feet
from motionkit.rig.retarget import retarget


@pytest.fixture(scope="module")
def walk() -> Motion:
    """A walk on a body with wide hips and long feet, which stand as firmly as those of a canonical body."""
    offsets = canonical_skeleton().offsets.copy()
    for side in ("Left", "Right"):
        offsets[JOINT_NAMES.index(f"{side}UpLeg")] *= 1.7
        offsets[JOINT_NAMES.index(f"{side}ToeBase")] *= 1.4
    made = mk.synthesize("walking:2", seed=1).motion
    return plant_feet(replace(made, skeleton=canonical_skeleton(offsets)), "ToeBase", joints(made, "ToeBase"))


def joints(motion: Motion, part: str) -> Array:
    """Places (T, 2, 3) of the left and right joint."""
    _, positions = motion_kinematics(motion)
    return positions[:, [JOINT_NAMES.index(side + part) for side in ("Left", "Right")]]


def without_toes(bvh: BvhFile) -> BvhFile:
    """The file without its toe joints."""
    keep = [j for j, name in enumerate(bvh.skeleton.names) if not name.endswith("ToeBase")]
    new = {joint: index for index, joint in enumerate(keep)}
    parents = tuple(new.get(bvh.skeleton.parents[j], -1) for j in keep)
    skeleton = Skeleton(tuple(bvh.skeleton.names[j] for j in keep), parents, bvh.skeleton.offsets[keep])
    columns = bvh.columns()
    values = bvh.values[:, [c for j in keep for c in columns[j]]]
    return BvhFile(skeleton, tuple(bvh.channels[j] for j in keep), values, bvh.frame_time)


@pytest.mark.parametrize("part", ["ToeBase", "Foot"])
def test_planted_feet_go_where_those_of_the_source_go(walk: Motion, part: str) -> None:
    bvh = motion_to_bvh(walk)
    bvh = bvh if part == "ToeBase" else without_toes(bvh)
    plain, report = retarget(bvh, scale=1.0)
    planted, _ = retarget(bvh, scale=1.0, plant=True)
    source = joints(walk, part) * report.root_scale
    ground = [0, 2]
    off = np.linalg.norm((joints(plain, part) - source)[..., ground], axis=-1)
    left = np.linalg.norm((joints(planted, part) - source)[..., ground], axis=-1)
    assert off.mean() > 2.0 and left.mean() < 0.2
    # Heights, upper bodies and the root are those of the plain retargeting.
    assert np.abs((joints(planted, part) - joints(plain, part))[..., 1]).mean() < 0.3
    assert np.array_equal(planted.root_positions, plain.root_positions)
    spine = JOINT_NAMES.index("Spine1")
    assert np.allclose(
        np.abs((planted.local_rotations * plain.local_rotations)[:, spine].sum(-1)), 1.0, atol=1e-6
    )


def test_planted_feet_slide_no_more_than_those_of_the_source(walk: Motion) -> None:
    bvh = motion_to_bvh(walk)
    source = joints(walk, "ToeBase")
    steps = np.linalg.norm(np.diff(source[..., [0, 2]], axis=0), axis=-1) * walk.fps
    stands = steps < 15.0

    def sliding(plant: bool) -> float:
        toes = joints(retarget(bvh, scale=1.0, plant=plant)[0], "ToeBase")
        return float((np.linalg.norm(np.diff(toes[..., [0, 2]], axis=0), axis=-1) * walk.fps)[stands].mean())

    recorded = float(steps[stands].mean())
    assert stands.mean() > 0.3
    assert sliding(True) < 1.1 * recorded and sliding(False) > 1.5 * recorded


def test_a_body_of_canonical_proportions_stays_as_it_is() -> None:
    motion = mk.synthesize("walking:1", seed=1).motion
    plain, _ = retarget(motion_to_bvh(motion), scale=1.0)
    planted, _ = retarget(motion_to_bvh(motion), scale=1.0, plant=True)
    assert np.allclose(joints(planted, "ToeBase"), joints(plain, "ToeBase"), atol=0.05)
