from __future__ import annotations

import math

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.data.dataset import ClipData, mirror_clip
from motionkit.errors import SkeletonError
from motionkit.features.decode import decode_motion, integrate_ground
from motionkit.features.encode import EncodedMotion, encode_motion, relative_expmaps
from motionkit.features.layout import LAYOUTS, feature_layout
from motionkit.features.reference import REFERENCE_COUNT
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, mean_rotation, quat_angle, quat_identity
from motionkit.motion.skeleton import MIRROR_JOINTS, Skeleton
from motionkit.rig.mirror import mirror_motion
from synthetic_motions import make_cartwheel, make_dance, make_jump, make_walk, placed

MOTIONS = {
    "walk": lambda: make_walk(240, turn=0.7),
    "cartwheel": lambda: make_cartwheel(200, yaw=2.0),
    "cartwheel the other way": lambda: make_cartwheel(200, yaw=-3.0, side=-1.0),
    "two cartwheels": lambda: make_cartwheel(260, turns=2.0),
    "dance through pi": lambda: make_dance(300),
    "hop": lambda: make_jump(120),
}


def mirrored_reference_rotations(motion: Motion) -> Array:
    """Mean rotations of a motion and its mirror image, as preprocess makes them."""
    quats = motion.local_rotations.astype(np.float64)
    moment = np.einsum("tja,tjb->jab", quats, quats)
    flip = np.diag(np.array([1.0, 1.0, -1.0, -1.0], np.float64))
    return mean_rotation(moment + flip @ moment[list(MIRROR_JOINTS)] @ flip).astype(np.float32)


def there_and_back(motion: Motion, reference_rotations: Array | None, layout: str) -> Motion:
    encoded = encode_motion(motion, reference_rotations, layout)
    return decode_motion(
        encoded.features, motion.skeleton, motion.fps, encoded.ground[0], reference_rotations, layout
    )


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("with_references", [False, True])
@pytest.mark.parametrize("name", MOTIONS)
def test_round_trip(name: str, with_references: bool, layout: str) -> None:
    motion = MOTIONS[name]()
    reference_rotations = mirrored_reference_rotations(motion) if with_references else None
    back = there_and_back(motion, reference_rotations, layout)
    degrees = np.rad2deg(
        quat_angle(motion.local_rotations.astype(np.float64), back.local_rotations.astype(np.float64))
    )
    assert degrees.max() < 0.01
    distance = np.linalg.norm(motion_kinematics(motion)[1] - motion_kinematics(back)[1], axis=-1)
    assert distance.max() < 0.01


@pytest.mark.parametrize("layout", LAYOUTS)
def test_round_trip_far_from_the_origin_and_at_another_rate(layout: str) -> None:
    motion = placed(make_walk(200, fps=30.0), 2.0, (800.0, -600.0))
    back = there_and_back(motion, None, layout)
    distance = np.linalg.norm(motion_kinematics(motion)[1] - motion_kinematics(back)[1], axis=-1)
    assert distance.max() < 0.01


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", ["walk", "cartwheel"])
def test_features_do_not_tell_place_or_heading(name: str, layout: str) -> None:
    motion = MOTIONS[name]()
    here = encode_motion(motion, layout=layout)
    there = encode_motion(placed(motion, 2.2, (250.0, -130.0)), layout=layout)
    # Positions lose about 1e-5 of 250 cm in float32; times 60 for velocities.
    velocities = [n for n in feature_layout(layout).blocks if "velocit" in n]
    for block, columns in feature_layout(layout).blocks.items():
        tolerance = 2e-2 if block in velocities else 1e-3
        assert np.abs(here.features[:, columns] - there.features[:, columns]).max() < tolerance, block
    assert np.array_equal(here.contacts, there.contacts)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", MOTIONS)
def test_mirror_in_features_is_the_mirror_of_the_motion(name: str, layout: str) -> None:
    motion = MOTIONS[name]()
    reference_rotations = mirrored_reference_rotations(motion)
    encoded = encode_motion(motion, reference_rotations, layout)
    data = as_clip(encoded)
    mirrored = mirror_clip(data, feature_layout(layout), np.array([0]), np.array([False]))
    truth = encode_motion(mirror_motion(motion), reference_rotations, layout)
    assert np.abs(mirrored.features - truth.features).max() < 5e-3
    assert np.array_equal(mirrored.contacts, truth.contacts)
    assert np.abs(mirrored.ground[:, :2] - truth.ground[:, :2]).max() < 1e-3
    turn = np.remainder(mirrored.ground[:, 2] - truth.ground[:, 2] + math.pi, 2 * math.pi) - math.pi
    assert np.abs(turn).max() < 1e-4


def as_clip(encoded: EncodedMotion) -> ClipData:
    types = np.zeros(len(encoded.features), np.int64)
    none = np.full((len(types),), -1.0, np.float32)
    return ClipData(
        encoded.features,
        encoded.contacts,
        encoded.ground,
        types,
        none,
        np.zeros((len(types), REFERENCE_COUNT), np.float32),
    )


def test_mirroring_a_clip_twice_gives_it_back() -> None:
    data = as_clip(encode_motion(make_walk(60)))
    layout = feature_layout()
    swap, sided = np.array([0]), np.array([True])
    once = mirror_clip(data, layout, swap, sided)
    twice = mirror_clip(once, layout, swap, sided)
    assert not np.array_equal(once.features, data.features)
    for name in ("features", "contacts", "ground", "types", "phases"):
        assert np.array_equal(getattr(twice, name), getattr(data, name))


def turning(end: float) -> tuple[Array, Array]:
    """Exponential maps (300, 1, 3) of a joint that turns from rest to an angle, and as the features write them."""
    track = np.zeros((300, 1, 3), np.float64)
    track[:, 0, 2] = np.linspace(0.0, end, 300)
    return track, relative_expmaps(expmap_to_quat(track), quat_identity((1,), np.float64))


def test_rotations_followed_through_pi_do_not_jump() -> None:
    track, maps = turning(1.35 * math.pi)
    assert np.allclose(maps, track, atol=1e-6)


def test_rotations_beyond_the_fold_are_written_the_short_way_round() -> None:
    _, maps = turning(2 * math.pi)
    assert np.linalg.norm(maps, axis=-1).max() < 1.41 * math.pi
    assert np.linalg.norm(maps[-1]) < 1e-6, "a full turn and none are one pose"


def test_velocities_are_backward_differences_in_the_heading_frame() -> None:
    motion = placed(make_walk(60, speed=120.0, turn=0.0), 1.2)
    encoded = encode_motion(motion)
    step = encoded.features[1:, feature_layout().blocks["root_xz_velocity"]]
    assert np.allclose(step[:, 1], np.full((59,), 120.0, np.float32), atol=0.5)
    assert np.abs(step[:, 0]).max() < 12.0  # the heading sways by 0.1 rad around the path
    assert np.array_equal(encoded.features[0, 0], encoded.features[1, 0]), (
        "the first frame repeats the second"
    )


def test_root_height_is_that_of_the_hips() -> None:
    motion = make_walk(60)
    back = decode_motion(encode_motion(motion).features, motion.skeleton, 60.0)
    assert np.allclose(back.root_positions[:, 1], motion.root_positions[:, 1], atol=1e-4)
    assert np.array_equal(back.root_positions[0, [0, 2]], np.zeros(2, np.float32)), (
        "the origin, facing +Z by default"
    )


def test_ground_track_of_a_known_walk() -> None:
    features = np.zeros((61, 276), np.float32)
    features[:, 0] = math.pi / 2  # a quarter turn per second
    features[:, 2] = 100.0  # moves forward at 100 cm/s
    ground = integrate_ground(features, np.array([10.0, 20.0, 0.0], np.float32), 60.0)
    assert ground.shape == (61, 3)
    assert float(ground[-1, 2]) == pytest.approx(math.pi / 2)
    radius = 100.0 / (math.pi / 2)
    assert float(ground[-1, 0]) == pytest.approx(10.0 + radius, abs=1.0)
    assert float(ground[-1, 1]) == pytest.approx(20.0 + radius, abs=1.0)


def test_other_joints_or_too_few_frames_are_refused() -> None:
    motion = make_walk(4)
    with pytest.raises(SkeletonError, match="at least 2 frames"):
        encode_motion(motion.cut(0, 1))
    names = ("Pelvis", *motion.skeleton.names[1:])
    other = Skeleton(names, motion.skeleton.parents, motion.skeleton.offsets)
    with pytest.raises(SkeletonError, match="23 canonical joints"):
        encode_motion(Motion(other, motion.local_rotations, motion.root_positions, 60.0))
