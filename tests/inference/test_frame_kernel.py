"""The compiled frame against numpy: the same frame from the same state, frame after frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.errors import MotionkitError
from motionkit.features.control import Controls
from motionkit.features.layout import LAYOUTS, feature_layout
from motionkit.inference import frame_kernel
from motionkit.inference.character import CharacterStream
from motionkit.inference.frame_arrays import BodyArrays
from motionkit.inference.frame_kernel import PoseKernel
from motionkit.inference.noise import Noise
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.motion.rotations import quat_normalize
from motionkit.native import load_library
from oracle.characters import pose_in_numpy
from oracle.pose import NumpyPose

CLOSE = 1e-4  # cm


def asked(model: MotionModel, count: int, frame: int) -> Controls:
    weights = np.eye(len(model.types), dtype=np.float32)[np.arange(count) % len(model.types)]
    trajectory = np.tile(np.linspace(-40.0, 40.0, 24, dtype=np.float32), (count, 1))
    phase = np.full(count, (frame % 70) / 70.0, np.float32)
    asked = replace(Controls.of_types(weights), trajectory=trajectory, phase=phase)
    return asked.with_mask(float(frame % 90 < 45))


def take_state(mine: CharacterStream, its: CharacterStream) -> None:
    """Put one stream where another is, but for their generators and the network's memory."""
    assert mine.body.feet is not None and its.body.feet is not None
    for target, source in (
        (vars(mine.state.frame), vars(its.state.frame)),
        (vars(mine.body), vars(its.body)),
        (mine.body.feet.arrays, its.body.feet.arrays),
    ):
        for name, values in source.items():
            if isinstance(values, np.ndarray):
                target[name][:] = values


@pytest.mark.parametrize("noise", [Noise(), Noise("sample", 0.3)], ids=str)
def test_feet_are_locked_alike_from_the_same_state(noise: Noise) -> None:
    """A closed loop would carry the last bits on, by as much as the machine makes of them."""
    bundled = load_bundled_model()
    tall = {**bundled.characters, "tall": 1.2 * bundled.characters["default"]}
    model = replace(bundled, characters=tall)
    ours, theirs = (CharacterStream(model, 3, noise, 3, True, ("default", "tall")) for _ in range(2))
    pose_in_numpy(theirs)
    apart, alike, locked = [], [], 0
    for frame in range(300):
        if frame == 150:
            for stream in (ours, theirs):
                stream.reset(1, "tall", place=(20.0, -30.0, 2.0))
        take_state(ours, theirs)
        a, b = (stream.step(asked(model, 3, frame)) for stream in (ours, theirs))
        assert np.allclose(a.contacts, b.contacts, rtol=0.0, atol=1e-5)
        assert np.abs((a.rotations * b.rotations).sum(-1)).min() > 1.0 - 1e-6
        apart.append(np.abs(a.positions - b.positions).max(axis=(1, 2)))
        feet, others = ours.body.feet, theirs.body.feet
        assert feet is not None and others is not None
        alike.append(feet.plants.locked == others.plants.locked)
        locked += int(feet.plants.locked.sum())
    distances = np.stack(apart)
    # Where a leg is stretched out flat, the height of its hip is a root of nearly zero, which keeps few digits.
    assert (distances < CLOSE).astype(np.float32).mean() > 0.85 and distances.max() < 2e-2
    assert np.mean(alike) > 0.999, "a foot at the threshold may fall to either side"
    assert locked > 50, "feet were locked"


@pytest.mark.parametrize("layout", LAYOUTS)
def test_poses_feet_and_floors_of_every_kind(layout: str) -> None:
    """Random bodies, any side up, with feet in and out of contact and below the floor."""
    count, rng = 200, np.random.default_rng(0)
    reference_rotations = rng.standard_normal((23, 4)).astype(np.float32)
    reference_rotations = quat_normalize(reference_rotations)
    features = rng.normal(0.0, 0.7, (count, 276)).astype(np.float32)
    features[:, feature_layout(layout).blocks["joint_positions"].start] += 60.0
    ground = rng.normal(0.0, 30.0, (count, 3)).astype(np.float32)
    bodies = BodyArrays.of(count), BodyArrays.of(count)
    for body in bodies:
        body.offsets[:] = np.random.default_rng(1).normal(0.0, 15.0, (count, 23, 3))
        body.scale[:] = np.random.default_rng(2).uniform(0.5, 1.5, count)
    kernel = PoseKernel(layout, reference_rotations, bodies[0])
    oracle = NumpyPose(layout, reference_rotations, bodies[1])
    feet = bodies[0].feet, bodies[1].feet
    assert feet[0] is not None and feet[1] is not None
    apart = []
    for frame in range(20):
        contacts = rng.uniform(0.3, 0.7, (count, 4)).astype(np.float32)
        features[:, 9:] += rng.normal(0.0, 0.02, (count, 267)).astype(np.float32)
        ground[:, 0] += 1.0
        ours = kernel.pose(features, contacts, ground)
        rotations, root, positions = oracle.pose(features, contacts, ground)
        apart.append(np.abs(ours[2] - positions).max(axis=(1, 2)))
        assert np.mean(np.abs((ours[0] * rotations).sum(-1)) > 1.0 - 1e-5, axis=0).min() > 0.9  # each joint
        assert np.array_equal(feet[0].plants.locked, feet[1].plants.locked)
        assert np.median(np.abs(bodies[0].rise - bodies[1].rise)) < 1e-5
        assert np.median(np.abs(ours[1] - root)) < 1e-5
        assert frame > 0 or feet[0].plants.locked.any()
    assert np.mean(np.array(apart) < 1e-3) > 0.95
    assert bodies[0].rise.max() > 0.5


@pytest.mark.parametrize(
    ("name", "version_name", "more", "fault"),
    [
        ("_frame_kernel", "frame_kernel_version", 1, "is of another version"),
        ("_frame_kernel", "no_such_function", 0, "is of another version"),
        ("_no_such_kernel", "frame_kernel_version", 0, "is missing"),
    ],
)
def test_a_library_that_does_not_fit_is_one_line(name: str, version_name: str, more: int, fault: str) -> None:
    folder = Path(frame_kernel.__file__).resolve().parent
    assert load_library(folder / "_frame_kernel", "frame_kernel_version", frame_kernel.VERSION)
    with pytest.raises(MotionkitError, match=rf"{name}\S+ {fault}.*: install motionkit anew"):
        load_library(folder / name, version_name, frame_kernel.VERSION + more)
