from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model_changes import with_preset
from motionkit.control.script import parse_types
from motionkit.control.synthesize import SynthesisOptions, on_character, synthesize
from motionkit.errors import ControlError, MotionkitError
from motionkit.features.control import Controls
from motionkit.features.decode import decode_motion
from motionkit.inference.noise import Noise
from motionkit.inference.rollout import RolloutState
from motionkit.inference.start import clip_start, type_start
from motionkit.inference.step import NetworkStep
from motionkit.models.model import MotionModel
from motionkit.models.motion_type import MotionKind
from motionkit.motion.bvh import bvh_to_motion, read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import leg_length

PARTS = parse_types("walking:0.6,cartwheel:0.4")


def made(model: MotionModel, ik: bool = False, **options) -> list[Motion]:
    return [s.motion for s in synthesize(model, PARTS, SynthesisOptions(ik=ik, **options)).motions]


def same(a: Motion, b: Motion) -> bool:
    return np.array_equal(a.local_rotations, b.local_rotations) and np.array_equal(
        a.root_positions, b.root_positions
    )


def test_length_rate_and_joints(tiny_model: MotionModel) -> None:
    seen: list[int] = []
    result = synthesize(tiny_model, PARTS, progress=seen.append)
    motion = result.motions[0].motion
    assert (len(motion), motion.fps, len(motion.skeleton)) == (60, 60.0, 23)
    assert result.motions[0].contacts.shape == (60, 4) and result.frames == 60
    assert np.isfinite(motion.local_rotations).all() and np.isfinite(motion.root_positions).all()
    assert seen == list(range(1, 61))


@pytest.mark.parametrize("kind", ["mean", "sample", "correlated"])
def test_the_same_seed_writes_the_same_file(tiny_model: MotionModel, tmp_path: Path, kind: str) -> None:
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        write_bvh(tmp_path / name, made(tiny_model, seed=seed, noise=Noise(kind))[0])
    a, b, c = ((tmp_path / name).read_bytes() for name in "abc")
    assert a == b
    assert a != c, "the seed draws the noise and picks the recordings that guide"


def test_the_mean_without_references_depends_on_the_start_pose_alone(tiny_model: MotionModel) -> None:
    free = replace(tiny_model, uses_references=False)
    parts = parse_types("running:0.5")
    starts = len(tiny_model.types["running"].start_poses)
    seeds = (3, 3 + starts)  # start poses are taken in turn
    both = [synthesize(free, parts, SynthesisOptions(seed=s, noise=Noise("mean"))).motions[0] for s in seeds]
    assert same(both[0].motion, both[1].motion)


def test_global_random_numbers_play_no_part(tiny_model: MotionModel) -> None:
    np.random.seed(1)
    first = made(tiny_model)[0]
    np.random.seed(2)
    assert same(first, made(tiny_model)[0])


def test_temperature_zero_is_the_mean(tiny_model: MotionModel) -> None:
    mean = made(tiny_model, noise=Noise("mean"))[0]
    assert same(mean, made(tiny_model, noise=Noise("sample", temperature=0.0))[0])
    assert not same(mean, made(tiny_model, noise=Noise("sample", temperature=1.0))[0])


def drawn_noise(state: RolloutState, frames: int) -> np.ndarray:
    """The noise (T, 276) of the coming frames, in standard deviations."""
    made = []
    for _ in range(frames):
        state.network.log_sigma[:] = 0.0
        state.drawing.draw(state.network)
        made.append(state.drawing.drawn_noise[0].copy())
    return np.stack(made)


def test_correlated_noise_follows_itself_and_keeps_its_size(tiny_model: MotionModel) -> None:
    state = RolloutState(tiny_model, 1, Noise("correlated", 0.5, 0.95, 0.8), 0)
    state.noise_state.start()
    draws = drawn_noise(state, 400)
    assert float(draws.std()) == pytest.approx(0.5, rel=0.1)
    neighbours = (draws[1:] * draws[:-1]).mean() / np.square(draws).mean()
    assert float(neighbours) == pytest.approx((0.95 + 0.8) / (1.0 + 0.95 * 0.8), abs=0.003)
    white = RolloutState(tiny_model, 1, Noise("sample", 0.5), 0)
    draws = drawn_noise(white, 400)
    assert abs(float((draws[1:] * draws[:-1]).mean() / np.square(draws).mean())) < 0.02


def test_unknown_noise() -> None:
    with pytest.raises(
        ControlError, match="noise 'pink' is unknown, expected one of mean, sample, correlated"
    ):
        Noise("pink")


def test_unknown_types_and_characters(tiny_model: MotionModel) -> None:
    with pytest.raises(ControlError, match="did you mean 'walking'"):
        synthesize(tiny_model, parse_types("walkin"))
    with pytest.raises(ControlError, match="unknown character 'giant'"):
        synthesize(tiny_model, PARTS, SynthesisOptions(character="giant"))
    with pytest.raises(ControlError, match="at least 1 motion"):
        synthesize(tiny_model, PARTS, SynthesisOptions(count=0))


def test_several_at_once_differ_and_each_equals_its_own_stream(tiny_model: MotionModel) -> None:
    motions = made(tiny_model, count=3)
    assert len(motions) == 3
    assert not same(motions[0], motions[1]) and not same(motions[1], motions[2])


def test_another_rate(tiny_model: MotionModel) -> None:
    whole, half = made(tiny_model)[0], made(tiny_model, fps=30.0)[0]
    assert (half.fps, len(half)) == (30.0, 30)
    assert np.allclose(half.root_positions, whole.root_positions[::2], atol=1e-4)
    assert len(made(tiny_model, fps=144.0)[0]) == int(59 * 144 / 60) + 1


def test_another_character_turns_the_same_joints(tiny_model: MotionModel) -> None:
    tall = {**tiny_model.characters, "tall": 1.2 * tiny_model.characters["default"]}
    model = replace(tiny_model, characters=tall)
    small, large = made(model)[0], made(model, character="tall")[0]
    assert np.array_equal(small.local_rotations, large.local_rotations)
    assert leg_length(large.skeleton) == pytest.approx(1.2 * leg_length(small.skeleton))
    assert np.allclose(large.root_positions, 1.2 * small.root_positions, rtol=1e-5)


def test_on_character_keeps_feet_on_the_floor(tiny_model: MotionModel) -> None:
    motion = made(tiny_model)[0]
    larger = on_character(motion, motion.skeleton.scaled(1.3))
    heights = motion_kinematics(larger)[1][..., 1] - 1.3 * motion_kinematics(motion)[1][..., 1]
    assert np.abs(heights).max() < 1e-3


def test_foot_locks_move_feet_only(tiny_model: MotionModel) -> None:
    plain, locked = made(tiny_model, ik=False)[0], made(tiny_model, ik=True)[0]
    upper = [plain.skeleton.index(n) for n in ("Spine", "LeftArm", "RightHand", "Head")]
    assert np.array_equal(plain.local_rotations[:, upper], locked.local_rotations[:, upper])


# ---- where it starts ----


def test_all_start_from_the_first_start_pose(tiny_model: MotionModel) -> None:
    poses = tiny_model.types["walking"].start_poses
    assert len(poses) > 1
    start = type_start(tiny_model, "walking", 2)
    assert all(np.array_equal(features, poses[0].features) for features in start.features)


def test_a_type_without_seeds(tiny_model: MotionModel) -> None:
    with pytest.raises(ControlError, match="no frames to start 'walking' from"):
        type_start(tiny_model.with_types({"walking": {"start_poses": ()}}), "walking", 1)


def test_start_frames_are_the_clips(tiny_model: MotionModel, clips_folder: Path) -> None:
    start = clip_start(tiny_model, clips_folder / "walk_02.bvh", 2)
    assert start.features.shape == (2, 87, 276) and start.contacts.shape == (2, 87, 4)
    motion = bvh_to_motion(read_bvh(clips_folder / "walk_02.bvh"))
    back = decode_motion(
        start.features[0],
        motion.skeleton,
        60.0,
        None,
        tiny_model.reference_rotations,
        tiny_model.config.layout,
    )
    assert np.allclose(back.root_positions[:, 1], motion.root_positions[:87, 1], atol=0.01)


def test_the_first_frame_goes_on_from_the_start(tiny_model: MotionModel, clips_folder: Path) -> None:
    """One step from the last frame of the clip: the pose is near it, in place as in posture."""
    clip = clips_folder / "idle_01.bvh"
    model = tiny_model
    motion = synthesize(
        model, parse_types("idle:0.1"), SynthesisOptions(ik=False, init=clip, noise=Noise("mean"))
    ).motions
    first = motion_kinematics(motion[0].motion)[1][0]
    last = motion_kinematics(bvh_to_motion(read_bvh(clip)))[1][86]
    assert float(np.linalg.norm((first[0] - last[0])[[0, 2]])) < 5.0


def test_another_clip_another_motion(tiny_model: MotionModel, clips_folder: Path) -> None:
    a = made(tiny_model, init=clips_folder / "walk_02.bvh")[0]
    b = made(tiny_model, init=clips_folder / "wheel_01.bvh")[0]
    assert not same(a, b) and not same(a, made(tiny_model)[0])


def test_a_start_that_is_no_clip(tiny_model: MotionModel, tmp_path: Path, clips_folder: Path) -> None:
    (tmp_path / "bad.bvh").write_text("HIERARCHY")
    with pytest.raises(MotionkitError, match=r"bad\.bvh"):
        made(tiny_model, init=tmp_path / "bad.bvh")
    write_bvh(tmp_path / "one.bvh", bvh_to_motion(read_bvh(clips_folder / "idle_01.bvh")).cut(0, 1))
    with pytest.raises(ControlError, match=r"one\.bvh: expected at least 2 frames"):
        made(tiny_model, init=tmp_path / "one.bvh")


def test_written_motion_is_what_was_rolled_out(tiny_model: MotionModel, tmp_path: Path) -> None:
    motion = made(tiny_model)[0]
    write_bvh(tmp_path / "out.bvh", motion)
    back = bvh_to_motion(read_bvh(tmp_path / "out.bvh"))
    assert back.fps == 60.0 and back.skeleton.names == motion.skeleton.names
    assert np.linalg.norm(motion_kinematics(motion)[1] - motion_kinematics(back)[1], axis=-1).max() < 0.01


# ---- crowds ----


def test_a_crowd_takes_plans_and_bodies_in_turn(tiny_model: MotionModel) -> None:
    tall = {**tiny_model.characters, "tall": 1.2 * tiny_model.characters["default"]}
    model = replace(tiny_model, characters=tall)
    plans = [parse_types("walking:0.5"), parse_types("idle:0.3,cartwheel:0.4")]
    options = SynthesisOptions(ik=False, count=5, character="default,tall,default", noise=Noise("mean"))
    made = synthesize(model, plans, options).motions
    assert [len(one.motion) for one in made] == [30, 42, 30, 42, 30]
    assert [one.types[0].type for one in made] == ["walking", "idle", "walking", "idle", "walking"]
    sizes = [leg_length(one.motion.skeleton) / leg_length(model.character("default")) for one in made]
    assert sizes == pytest.approx([1.0, 1.2, 1.0, 1.0, 1.2])
    alone = synthesize(model, plans[0], SynthesisOptions(ik=False, noise=Noise("mean"))).motions[0].motion
    assert np.allclose(alone.root_positions, made[0].motion.root_positions, atol=1e-2)
    # The second of them makes the choice of the second.
    alone = (
        synthesize(model, plans[1], SynthesisOptions(ik=False, seed=1, noise=Noise("mean"))).motions[0].motion
    )
    assert np.allclose(1.2 * alone.root_positions, made[1].motion.root_positions, atol=1e-2)


def test_a_network_is_packed_once(tiny_model: MotionModel) -> None:
    first, again = (RolloutState(tiny_model, 1, Noise("mean")) for _ in range(2))
    assert isinstance(first.network, NetworkStep) and isinstance(again.network, NetworkStep)
    assert first.network.kernel is again.network.kernel, "one copy for all characters"
    arrays = tiny_model.network.arrays
    arrays = arrays | {"aggregate.bias": arrays["aggregate.bias"] + 1.0}
    network = replace(tiny_model.network, arrays=arrays)
    other = RolloutState(replace(tiny_model, network=network), 1, Noise("mean"))
    assert isinstance(other.network, NetworkStep)
    assert (
        other.network.kernel.weights.head_bias[:276] - first.network.kernel.weights.head_bias[:276]
    ).min() > 0.9


def test_a_type_takes_its_share_of_the_noise(tiny_model: MotionModel) -> None:
    """With no share the draw is the mean, with twice the share it is twice as far from it."""
    seed = tiny_model.types["walking"].start_poses[0]
    weights = np.eye(len(tiny_model.types), dtype=np.float32)[[tiny_model.type_id("walking")]]
    asked = Controls.of_types(weights)
    made = []
    for share in (0.0, 1.0, 2.0):
        model = with_preset(tiny_model, noise_scale=share, velocity_blend=0.0, slip_correction=0.0)
        state = RolloutState(model, 1, Noise("sample"), seed=5)
        state.start(seed.features[None], seed.contacts[None], weights)
        state.step(asked)
        made.append(state.frame.x.copy())
    apart = [abs(each - made[0]).max() for each in made[1:]]
    assert apart[0] > 0.01 and apart[1] == pytest.approx(2.0 * apart[0], rel=1e-2)


def test_feet_hold_the_root_of_all_but_standing_bodies(tiny_model: MotionModel) -> None:
    weights = np.eye(len(tiny_model.types), dtype=np.float32)
    stand, walk = tiny_model.type_id("idle"), tiny_model.type_id("walking")
    assert tiny_model.kind("idle") is MotionKind.STANCE
    mixed = 0.25 * weights[stand] + 0.75 * weights[walk]
    assert tiny_model.root_hold(np.stack([weights[stand], weights[walk], mixed])).tolist() == [0.0, 1.0, 0.75]
