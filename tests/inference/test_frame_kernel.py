"""The compiled frame against numpy: the same frame from the same state, frame after frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.features.control import Controls
from motionkit.features.layout import LAYOUTS, feature_layout
from motionkit.inference.character import CharacterStream
from motionkit.inference.foot_lock import FootLock
from motionkit.inference.frame_kernel import PoseKernel, frame_library
from motionkit.inference.height_correction import HeightCorrection
from motionkit.inference.pose import BodyKinematics, PoseDecoder
from motionkit.inference.rollout import Noise
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.native import load_library

pytestmark = pytest.mark.skipif(
    frame_library() is None, reason="motionkit was installed without its C kernels"
)
CLOSE = 1e-4  # cm


def asked(model: MotionModel, count: int, frame: int) -> Controls:
    weights = np.eye(len(model.types), dtype=np.float32)[np.arange(count) % len(model.types)]
    trajectory = np.tile(np.linspace(-40.0, 40.0, 24, dtype=np.float32), (count, 1))
    phase = np.full(count, (frame % 70) / 70.0, np.float32)
    asked = replace(Controls.of_types(weights), trajectory=trajectory, phase=phase)
    return asked.with_mask(float(frame % 90 < 45))


def take_state(mine: CharacterStream, its: CharacterStream) -> None:
    """Put one stream where another is, but for their generators and the network's memory."""
    for a, b in (
        (mine.state, its.state),
        (mine.feet, its.feet),
        (mine.height_correction, its.height_correction),
    ):
        for name, values in vars(b).items():
            if isinstance(values, np.ndarray):
                getattr(a, name)[:] = values


@pytest.mark.parametrize("noise", [Noise(), Noise("sample", 0.3)], ids=str)
def test_feet_are_locked_alike_from_the_same_state(noise: Noise) -> None:
    """A closed loop would carry the last bits on, by as much as the machine makes of them."""
    bundled = load_bundled_model()
    tall = {**bundled.characters, "tall": 1.2 * bundled.characters["default"]}
    model = replace(bundled, characters=tall)
    ours, theirs = (
        CharacterStream(model, 3, noise, 3, True, ("default", "tall"), compiled=compiled)
        for compiled in (True, False)
    )
    assert ours.feet is not None and theirs.feet is not None
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
        alike.append(ours.feet.locked == theirs.feet.locked)
        locked += int(ours.feet.locked.sum())
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
    decoder = PoseDecoder(
        layout, reference_rotations / np.linalg.norm(reference_rotations, axis=1, keepdims=True)
    )
    offsets = rng.normal(0.0, 15.0, (count, 23, 3)).astype(np.float32)
    scale = rng.uniform(0.5, 1.5, count).astype(np.float32)
    features = rng.normal(0.0, 0.7, (count, 276)).astype(np.float32)
    features[:, feature_layout(layout).blocks["joint_positions"].start] += 60.0
    ground = rng.normal(0.0, 30.0, (count, 3)).astype(np.float32)
    library = frame_library()
    assert library is not None
    feet = FootLock(count), FootLock(count)
    height_corrections = HeightCorrection(layout, count), HeightCorrection(layout, count)
    kernel = PoseKernel(library, decoder, offsets, scale, height_corrections[0], feet[0])
    body = BodyKinematics(offsets)
    apart = []
    for frame in range(20):
        contacts = rng.uniform(0.3, 0.7, (count, 4)).astype(np.float32)
        features[:, 9:] += rng.normal(0.0, 0.02, (count, 267)).astype(np.float32)
        ground[:, 0] += 1.0
        ours = kernel.pose(features, contacts, ground)
        rotations, root = decoder.decode(features, ground)
        root *= scale[:, None]
        world = body.forward(rotations, root)
        height_corrections[1].apply(features, root, world, scale)
        positions = feet[1].apply(rotations, root, world, contacts, scale)
        apart.append(np.abs(ours[2] - positions).max(axis=(1, 2)))
        assert np.median(np.abs(ours[0] - rotations)) < 1e-6
        assert np.array_equal(feet[0].locked, feet[1].locked)
        assert np.median(np.abs(height_corrections[0].rise - height_corrections[1].rise)) < 1e-5
        assert np.median(np.abs(ours[1] - root)) < 1e-5
        assert frame > 0 or feet[0].locked.any()
    assert np.mean(np.array(apart) < 1e-3) > 0.95
    assert height_corrections[0].rise.max() > 0.5


def test_a_library_of_another_version_is_not_used() -> None:
    import motionkit.inference.frame_kernel as module

    path = Path(module.__file__).resolve().parent / "_frame_kernel"
    assert load_library(path, "frame_kernel_version", module.VERSION) is not None
    assert load_library(path, "frame_kernel_version", module.VERSION + 1) is None
    assert load_library(path, "no_such_function", 1) is None
    assert load_library(path.with_name("_no_such_kernel"), "frame_kernel_version", 1) is None
