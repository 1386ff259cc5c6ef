"""HeightCorrection: bodies are raised to where a frame says their feet are, and only those that need it."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.features.control import Controls
from motionkit.features.decode import root_height
from motionkit.features.layout import FEATURE_COUNT
from motionkit.inference import height_correction
from motionkit.inference.character import CharacterStream
from motionkit.inference.height_correction import HeightCorrection
from motionkit.inference.noise import Noise
from motionkit.inference.rollout import Rollout, rollout_motion
from motionkit.metrics.ground import foot_positions
from motionkit.models.bundled import load_bundled_model
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_COUNT, STANDING_HEIGHTS

MODEL = load_bundled_model()
LAYOUT = MODEL.config.layout


def frame(said: float, shown: float) -> tuple[np.ndarray, np.ndarray]:
    """Features and heights of one body whose feet are so far above where they stand; the right toe is lowest."""
    follower = HeightCorrection(LAYOUT, 1)
    features = np.zeros((1, FEATURE_COUNT), np.float32)
    heights = np.full((1, JOINT_COUNT), 90.0, np.float32)
    features[0, follower.columns] = np.array(STANDING_HEIGHTS) + 60.0
    heights[0, list(FOOT_JOINTS)] = np.array(STANDING_HEIGHTS) + 60.0
    features[0, follower.columns[3]] = STANDING_HEIGHTS[3] + said
    heights[0, FOOT_JOINTS[3]] = STANDING_HEIGHTS[3] + shown
    return features, heights


def test_a_body_is_raised_by_what_its_feet_miss_bit_by_bit() -> None:
    follower = HeightCorrection(LAYOUT, 1)
    features, heights = frame(0.0, -2.0)
    first = float(follower.follow(features, heights)[0])
    assert first == pytest.approx(
        2.0 * height_correction.PACE / (1.0 + (2.0 / height_correction.DOUBT) ** 2), rel=1e-5
    )
    for _ in range(300):
        last = float(follower.follow(features, heights)[0])
    assert last == pytest.approx(2.0, abs=1e-3)
    # Where nothing is missing any more it comes back down.
    for _ in range(300):
        last = float(follower.follow(*frame(0.0, 0.0))[0])
    assert last == pytest.approx(0.0, abs=1e-3)


def test_feet_that_are_shown_higher_than_said_are_left_there() -> None:
    assert HeightCorrection(LAYOUT, 1).follow(*frame(-3.0, 0.0))[0] == 0.0


def test_feet_in_the_air_tell_nothing() -> None:
    assert HeightCorrection(LAYOUT, 1).follow(*frame(14.0, 12.0))[0] == 0.0


def test_what_is_far_off_is_hardly_believed() -> None:
    near, far = (float(HeightCorrection(LAYOUT, 1).follow(*frame(depth, 0.0))[0]) for depth in (4.0, 40.0))
    assert 0.0 < far < 0.3 * near


def test_what_is_deeper_than_feet_are_is_raised_whatever_is_said() -> None:
    follower, sunk = HeightCorrection(LAYOUT, 1), frame(-12.0, -12.0)
    too_deep = 12.0 - height_correction.DEEPEST
    slowly = height_correction.PACE * too_deep / (1.0 + (too_deep / height_correction.DOUBT) ** 2)
    assert follower.follow(*sunk)[0] == pytest.approx(slowly + height_correction.LIFT * (too_deep - slowly))
    for _ in range(60):
        follower.follow(*sunk)
    assert float(follower.rise[0]) == pytest.approx(too_deep, abs=0.01)
    assert (
        HeightCorrection(LAYOUT, 1).follow(*frame(-height_correction.DEEPEST, -height_correction.DEEPEST))[0]
        == 0.0
    )


def rolled(frames: int = 120) -> tuple[Rollout, list[Array]]:
    """A dance, and where a live character without foot locks has its joints in each of its frames."""
    stream = CharacterStream(MODEL, noise=Noise("mean"), ik=False)
    stream.reset(0, type="dance-indian")
    weights = np.zeros((1, len(MODEL.types)), np.float32)
    weights[0, MODEL.type_id("dance-indian")] = 1.0
    asked = Controls.of_types(weights)
    features, ground, positions = [], [], []
    for _ in range(frames):
        positions.append(stream.step(asked).positions[0])
        features.append(stream.state._features.copy())
        ground.append(stream.state.ground)
    contacts = np.zeros((1, frames, 4), np.float32)
    return Rollout(np.stack(features, 1), contacts, np.stack(ground, 1)), positions


def test_whole_motions_are_raised_as_live_characters_are() -> None:
    rollout, positions = rolled()
    motion = rollout_motion(MODEL, rollout, 0, MODEL.character("default"))
    assert np.allclose(motion_kinematics(motion)[1], np.stack(positions), atol=0.01)
    low = rollout.features[0][:, HeightCorrection(LAYOUT, 1).columns] - np.array(STANDING_HEIGHTS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(height_correction, "PACE", 0.0)
        sunk = rollout_motion(MODEL, rollout, 0, MODEL.character("default"))

    def missing(motion: Motion) -> Array:
        feet = foot_positions(motion_kinematics(motion)[1])[..., 1] - np.array(STANDING_HEIGHTS)
        return low.min(axis=-1) - feet.min(axis=-1)

    assert float(np.maximum(missing(motion), 0.0).mean()) < 0.8 * float(np.maximum(missing(sunk), 0.0).mean())


def test_recorded_motion_stays_where_it_is() -> None:
    for kind in MODEL.types:
        seed = MODEL.types[kind].start_poses[0]
        rollout = Rollout(seed.features[None], seed.contacts[None], seed.ground[None])
        motion = rollout_motion(MODEL, rollout, 0, MODEL.character("default"))
        rise = motion.root_positions[:, 1] - root_height(seed.features, LAYOUT)
        # Some recordings were made on a floor that their feet sink into.
        feet = (
            foot_positions(motion_kinematics(motion)[1])[..., 1] - rise[:, None] - np.array(STANDING_HEIGHTS)
        )
        too_deep = max(0.0, -float(feet.min()) - height_correction.DEEPEST)
        assert float(np.abs(rise).max()) < 0.1 + too_deep
