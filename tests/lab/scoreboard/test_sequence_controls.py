"""The controls of a recorded sequence: where it lies on the ground, from what was given on."""

from __future__ import annotations

import numpy as np
import pytest

from motionkit.control.character_start import last_poses
from motionkit.control.recording_choice import frames_behind
from motionkit.data.dataset import ClipData, Dataset
from motionkit.features.control import TRAJECTORY_OFFSETS, future_trajectory
from motionkit.lab.scoreboard.reconstruction import SequenceControls
from motionkit.models.model import MotionModel
from motionkit.motion.rotations import rotate_ground


def data_of(dataset: Dataset, kind: str) -> ClipData:
    """The recording that has most of a type."""
    number = dataset.types.index(kind)
    read = [dataset.read(clip) for clip in dataset.clips if not clip.mirrored]
    return max(read, key=lambda data: int((data.types == number).sum()))


def test_a_body_beside_the_sequence_is_asked_back(tiny_model: MotionModel, dataset: Dataset) -> None:
    data = data_of(dataset, "walking")
    ask = SequenceControls(tiny_model, dataset.types, data, 30)
    here = data.ground[40:41]
    on_it = ask(10, here)
    np.testing.assert_allclose(on_it.trajectory, future_trajectory(data.ground, np.array([40])), atol=1e-4)
    beside = here + np.array([[50.0, 0.0, 0.3]], np.float32)
    back = ask(10, beside).trajectory[0, :12].reshape(6, 2)
    on_ground = rotate_ground(beside[0, 2], back) + beside[0, :2]
    np.testing.assert_allclose(on_ground, data.ground[40 + np.array(TRAJECTORY_OFFSETS), :2], atol=1e-2)
    assert on_it.trajectory_mask.all()


def test_what_was_given_of_a_performance_is_not_shown_again(
    tiny_model: MotionModel, dataset: Dataset
) -> None:
    (clip, *_) = tiny_model.types["cartwheel"].reference_clips
    middle = len(clip) // 2
    near = clip.poses[middle - np.array([0, 5, 15, 30]).clip(max=middle)]
    assert frames_behind(tiny_model, "cartwheel", near) == middle
    assert frames_behind(tiny_model, "cartwheel", clip.poses[[0, 0, 0, 0]]) == 0
    assert frames_behind(tiny_model, "walking", near) == frames_behind(tiny_model, "no type", near) == 0


def test_the_last_frame_is_asked_for_again_after_the_end(tiny_model: MotionModel, dataset: Dataset) -> None:
    data = data_of(dataset, "walking")
    ask = SequenceControls(tiny_model, dataset.types, data, 30)
    late = ask(len(data.types) + 100, data.ground[-1:])
    np.testing.assert_allclose(
        late.trajectory, future_trajectory(data.ground, np.array([len(data.types) - 1])), atol=1e-4
    )
    assert late.type_weights[0, tiny_model.type_id("walking")] == pytest.approx(1.0)
    assert last_poses(tiny_model, data.features[:30]).shape == (4, 24)
