"""Round trip of real CMU clips through the features: nothing may be lost."""

from pathlib import Path

import bvhio
import numpy as np
import pytest

from motionkit.data.cleaning import clean
from motionkit.features.decode import decode_motion
from motionkit.features.encode import encode_motion
from motionkit.features.layout import LAYOUTS, feature_layout
from motionkit.motion.bvh import bvh_to_motion, read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import resample
from motionkit.motion.rotations import quat_angle
from motionkit.rig.retarget import retarget_file

SAMPLE = Path(__file__).parents[2] / "examples" / "data"
# One clip of each type of the sample: cartwheel, running, walking, jumping, walking backwards.
CLIPS = ("49_06", "127_08", "35_01", "16_05", "06_06")


@pytest.fixture(params=CLIPS)
def clip(request):
    motion, _ = retarget_file(SAMPLE / f"{request.param}.bvh")
    return resample(clean(motion)[0], 60.0)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_bvh_to_features_to_bvh(clip, layout, tmp_path):
    encoded = encode_motion(clip, layout=layout)
    decoded = decode_motion(encoded.features, clip.skeleton, clip.fps, encoded.ground[0], layout=layout)
    write_bvh(tmp_path / "out.bvh", decoded)
    back = bvh_to_motion(read_bvh(tmp_path / "out.bvh"))
    _, before = motion_kinematics(clip)
    _, after = motion_kinematics(back)
    assert float(np.linalg.norm(before - after, axis=-1).max()) < 0.05  # cm
    turned = quat_angle(clip.local_rotations.astype(np.float64), back.local_rotations.astype(np.float64))
    assert float(np.rad2deg(turned.max())) < 0.05


def test_heading_does_not_flip(clip):
    steps = np.abs(np.diff(encode_motion(clip).ground[:, 2]))
    assert float(steps.max()) < 0.15  # radians per frame; a flip would be near pi


def test_root_rotation_has_no_jump_in_a_cartwheel():
    motion, _ = retarget_file(SAMPLE / "49_06.bvh")
    motion = resample(clean(motion)[0], 60.0)
    largest = {}
    for layout in LAYOUTS:
        block = feature_layout(layout).blocks["root_rotation"]
        steps = np.diff(encode_motion(motion, layout=layout).features[:, block], axis=0)
        largest[layout] = float(np.linalg.norm(steps, axis=-1).max())
    assert largest["sixd-root-1"] < 0.3
    assert largest["expmap-root-1"] > 3.0  # the reason for the other layout


def test_bvhio_agrees_on_joint_positions():
    path = SAMPLE / "127_08.bvh"
    bvh = read_bvh(path)
    _, positions = motion_kinematics(bvh_to_motion(bvh))
    oracle = bvhio.readAsHierarchy(str(path))
    for frame in (0, len(positions) // 2, len(positions) - 1):
        oracle.loadPose(frame)
        for joint, _, _ in oracle.layout():
            mine = positions[frame, bvh.skeleton.index(joint.Name)]
            assert np.allclose(mine, np.array(joint.PositionWorld), atol=1e-3)
