"""Root-height correction: bodies are raised to where a frame says their feet are, and only those that need it."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.features.control import Controls
from motionkit.features.decode import root_height
from motionkit.features.layout import FEATURE_COUNT
from motionkit.inference import height_correction
from motionkit.inference.character import CharacterStream
from motionkit.inference.frame_kernel import rises
from motionkit.inference.noise import Noise
from motionkit.inference.rollout import Rollout, rollout_motion
from motionkit.inference.slip_correction import foot_columns
from motionkit.models.bundled import load_bundled_model
from motionkit.motion.floor import foot_positions
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_COUNT, STANDING_HEIGHTS
from oracle.height_correction import follow

MODEL = load_bundled_model()
LAYOUT = MODEL.config.layout


COLUMNS = foot_columns(LAYOUT)[:, 1]


def risen(*feet: tuple[float, float], frames: int = 1) -> float:
    """How far a body is raised in its last frame, whose feet are said and shown to be so far above where they stand.

    Each pair lasts for some frames; the right toe is lowest.
    """
    features = np.zeros((len(feet), FEATURE_COUNT), np.float32)
    heights = np.full((len(feet), JOINT_COUNT), 90.0, np.float32)
    features[:, COLUMNS] = heights[:, list(FOOT_JOINTS)] = np.array(STANDING_HEIGHTS) + 60.0
    for row, (said, shown) in enumerate(feet):
        features[row, COLUMNS[3]] = STANDING_HEIGHTS[3] + said
        heights[row, FOOT_JOINTS[3]] = STANDING_HEIGHTS[3] + shown
    return float(rises(LAYOUT, features.repeat(frames, 0), heights.repeat(frames, 0))[-1])


def test_a_body_is_raised_by_what_its_feet_miss_bit_by_bit() -> None:
    expected = 2.0 * height_correction.PACE / (1.0 + (2.0 / height_correction.DOUBT) ** 2)
    assert risen((0.0, -2.0)) == pytest.approx(expected, rel=1e-5)
    assert risen((0.0, -2.0), frames=300) == pytest.approx(2.0, abs=1e-3)
    # Where nothing is missing any more it comes back down.
    assert risen((0.0, -2.0), (0.0, 0.0), frames=300) == pytest.approx(0.0, abs=1e-3)


def test_feet_that_are_shown_higher_than_said_are_left_there() -> None:
    assert risen((-3.0, 0.0)) == 0.0


def test_feet_in_the_air_tell_nothing() -> None:
    assert risen((14.0, 12.0)) == 0.0


def test_what_is_far_off_is_hardly_believed() -> None:
    assert 0.0 < risen((40.0, 0.0)) < 0.3 * risen((4.0, 0.0))


def test_what_is_deeper_than_feet_are_is_raised_whatever_is_said() -> None:
    too_deep = 12.0 - height_correction.DEEPEST
    slowly = height_correction.PACE * too_deep / (1.0 + (too_deep / height_correction.DOUBT) ** 2)
    expected = slowly + height_correction.LIFT * (too_deep - slowly)
    assert risen((-12.0, -12.0)) == pytest.approx(expected)
    assert risen((-12.0, -12.0), frames=61) == pytest.approx(too_deep, abs=0.01)
    assert risen((-height_correction.DEEPEST, -height_correction.DEEPEST)) == 0.0


def test_it_is_what_numpy_gives() -> None:
    draw = np.random.default_rng(0)
    features = draw.normal(0.0, 8.0, (500, FEATURE_COUNT)).astype(np.float32)
    heights = draw.normal(8.0, 6.0, (500, JOINT_COUNT)).astype(np.float32)
    state = np.zeros(1, np.float32)
    rows = zip(features, heights, strict=True)
    expected = [follow(LAYOUT, state, f[None], h[None])[0].copy() for f, h in rows]
    assert np.allclose(rises(LAYOUT, features, heights), expected, rtol=1e-6, atol=1e-6)


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
        features.append(stream.state.frame.features.copy())
        ground.append(stream.state.ground)
    contacts = np.zeros((1, frames, 4), np.float32)
    return Rollout(np.stack(features, 1), contacts, np.stack(ground, 1)), positions


def test_whole_motions_are_raised_as_live_characters_are() -> None:
    rollout, positions = rolled()
    motion = rollout_motion(MODEL, rollout, 0, MODEL.character("default"))
    assert np.allclose(motion_kinematics(motion)[1], np.stack(positions), atol=0.01)
    low = rollout.features[0][:, COLUMNS] - np.array(STANDING_HEIGHTS)
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
