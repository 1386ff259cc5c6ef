"""Cleaning: artefacts put into smooth motions are found and repaired, and real fast motion is left alone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motionkit.arrays import Array, normalized
from motionkit.data.cleaning import clean
from motionkit.motion.floor import TOE_HEIGHT, TOES
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_angle,
    quat_from_yaw,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_rotate,
    quat_slerp,
)
from motionkit.motion.skeleton import JOINT_NAMES, canonical_skeleton

KNEE, THIGH, FOOT = (JOINT_NAMES.index(name) for name in ("LeftLeg", "LeftUpLeg", "LeftFoot"))
HAND = JOINT_NAMES.index("RightHand")


def turned(motion: Motion, frame: int, joint: int, degrees: float) -> Motion:
    """The motion with one joint of one frame rotated about an arbitrary axis."""
    axis = normalized(np.array([0.4, -0.8, 0.3], np.float32))
    rotations = motion.local_rotations.copy()
    rotations[frame, joint] = quat_multiply(
        rotations[frame, joint], expmap_to_quat(math.radians(degrees) * axis)
    )
    return replace(motion, local_rotations=rotations)


def angle_between(a: Motion, b: Motion) -> Array:
    """Angles (T, J) in degrees between two motions."""
    return np.rad2deg(quat_angle(a.local_rotations, b.local_rotations))


def standing(frames: int = 200, fps: float = 60.0, toe_height: float = TOE_HEIGHT) -> Motion:
    """A standing body that only breathes, with its toe joints at this height."""
    skeleton = canonical_skeleton()
    rotations = quat_identity((frames, 23))
    sway = 0.02 * np.sin(np.arange(frames) / fps)
    rotations[:, JOINT_NAMES.index("Spine")] = expmap_to_quat(np.stack([sway, 0 * sway, 0 * sway], axis=-1))
    rotations[:, [JOINT_NAMES.index("LeftArm")]] = expmap_to_quat(np.array([0.0, 0.0, -1.2], np.float32))
    rotations[:, [JOINT_NAMES.index("RightArm")]] = expmap_to_quat(np.array([0.0, 0.0, 1.2], np.float32))
    root = np.zeros((frames, 3), np.float32)
    root[:, 1] = toe_height - skeleton.rest_positions()[TOES[0], 1]
    return Motion(skeleton, rotations, root, fps)


def lifted(motion: Motion, height: Array) -> Motion:
    """The motion with heights (T) added to the root."""
    up = np.zeros_like(motion.root_positions)
    up[:, 1] = height
    return replace(motion, root_positions=motion.root_positions + up)


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
@pytest.mark.parametrize("seed", range(4))
def test_smooth_motion_only_gets_its_floor(make_motion: Callable[..., Motion], fps: float, seed: int) -> None:
    motion = make_motion(frames=300, fps=fps, seed=seed)
    out, report = clean(motion)
    assert (report.lead_in, report.lead_out, report.pops) == (0, 0, ())
    assert np.array_equal(out.local_rotations, motion.local_rotations) and out.fps == fps
    shift = (out.root_positions - motion.root_positions)[:, 1]
    assert shift.std() < 1e-4 and shift.mean() == pytest.approx(report.floor_shift, abs=1e-3)


@pytest.mark.parametrize("held", [1, 2, 9])
def test_rest_pose_before_the_motion_is_cut(make_motion: Callable[..., Motion], held: int) -> None:
    motion = make_motion(frames=200, fps=120)
    rest = np.concatenate([quat_identity((held, 23)), motion.local_rotations])
    place = np.concatenate([np.broadcast_to(motion.root_positions[:1], (held, 3)), motion.root_positions])
    out, report = clean(replace(motion, local_rotations=rest, root_positions=place))
    assert report.lead_in == held and report.lead_out == 0 and report.pops == ()
    assert np.array_equal(out.local_rotations, motion.local_rotations)


def test_rest_pose_far_from_the_motion(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=200, fps=120)
    rotations = np.concatenate([quat_identity((4, 23)), motion.local_rotations])
    places = np.concatenate(
        [np.zeros((4, 3), np.float32), motion.root_positions + np.array([200.0, 0.0, 0.0], np.float32)]
    )
    _, report = clean(replace(motion, local_rotations=rotations, root_positions=places))
    assert report.lead_in == 4


def test_blend_out_of_the_rest_pose_is_cut(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=300, fps=60)
    rotations = motion.local_rotations.copy()
    for frame in range(5):
        share = np.full((23,), frame / 5)
        rotations[frame] = quat_slerp(quat_identity((23,)), rotations[frame], share)
    _, report = clean(replace(motion, local_rotations=rotations))
    assert report.lead_in == 5


def test_motion_that_truly_starts_near_the_rest_pose_is_kept(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=240, fps=60, swing=0.1)
    ease = np.minimum(np.arange(240) / 120, 1.0)
    rotations = quat_slerp(
        quat_identity((240, 23)), motion.local_rotations, np.broadcast_to(ease[:, None], (240, 23))
    )
    _, report = clean(replace(motion, local_rotations=rotations))
    assert report.lead_in == 0


def test_frozen_frames_at_both_ends_are_cut(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=150, fps=120)

    def held(values: Array) -> Array:
        return np.concatenate(
            [
                np.broadcast_to(values[:1], (6, *values.shape[1:])),
                values,
                np.broadcast_to(values[-1:], (3, *values.shape[1:])),
            ]
        )

    _, report = clean(
        replace(
            motion,
            local_rotations=held(motion.local_rotations),
            root_positions=held(motion.root_positions),
        )
    )
    assert (report.lead_in, report.lead_out) == (6, 3)


def test_bad_first_and_last_frames_are_cut(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=150, fps=120)
    broken = turned(turned(turned(motion, 0, HAND, 70), 1, HAND, 70), 149, HAND, 60)
    out, report = clean(broken)
    assert (report.lead_in, report.lead_out, report.pops) == (2, 1, ())
    assert np.array_equal(out.local_rotations, motion.local_rotations[2:149])


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
@pytest.mark.parametrize("joint", [0, KNEE, HAND, TOES[1]])
@pytest.mark.parametrize("degrees", [25.0, 90.0, 179.0])
def test_a_pop_is_mended_on_its_joint_only(
    make_motion: Callable[..., Motion], fps: float, joint: int, degrees: float
) -> None:
    motion = make_motion(frames=200, fps=fps, swing=0.25)
    out, report = clean(turned(motion, 77, joint, degrees))
    assert report.pops == ((77, JOINT_NAMES[joint]),)
    error = angle_between(out, motion)
    assert error[77, joint] < 1.5
    error[77, joint] = 0
    assert error.max() < 0.1


def test_a_pop_of_two_frames_and_pops_side_by_side(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=200, fps=120, swing=0.25)
    broken = turned(turned(motion, 60, KNEE, 50), 61, KNEE, 55)
    broken = turned(turned(broken, 60, HAND, 40), 140, HAND, 40)
    out, report = clean(broken)
    assert report.pops == ((60, "LeftLeg"), (60, "RightHand"), (61, "LeftLeg"), (140, "RightHand"))
    assert angle_between(out, motion).max() < 1.0


def test_frames_are_counted_in_the_source(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=200, fps=120, swing=0.25)
    broken = turned(motion, 50, KNEE, 60)
    rest = np.concatenate([quat_identity((3, 23)), broken.local_rotations])
    place = np.concatenate([np.broadcast_to(motion.root_positions[:1], (3, 3)), motion.root_positions])
    _, report = clean(replace(motion, local_rotations=rest, root_positions=place))
    assert report.lead_in == 3 and report.pops == ((53, "LeftLeg"),)


def test_a_pop_of_the_root_is_mended(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=200, fps=120)
    places = motion.root_positions.copy()
    places[90] += np.array([3.0, 8.0, -2.0], np.float32)
    out, report = clean(replace(motion, root_positions=places))
    assert report.pops == ((90, "root position"),)
    shift = np.array([0.0, report.floor_shift, 0.0], np.float32)
    assert np.abs(out.root_positions - shift - motion.root_positions).max() < 0.1


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_kicks_spins_and_flips_are_left_alone(make_motion: Callable[..., Motion], fps: float) -> None:
    """A kick of 0.3 s over 120 degrees, a back flip in 0.6 s, a punch of 0.2 s: all faster than most pops."""
    motion = make_motion(frames=int(4 * fps), fps=fps, swing=0.1)
    seconds = np.arange(len(motion)) / fps

    def bump(middle: float, width: float) -> Array:
        return np.exp(-(((seconds - middle) / width) ** 2))

    def about(angle: Array, axis: int) -> Array:
        expmap = np.zeros((len(motion), 3), np.float32)
        expmap[:, axis] = angle
        return expmap_to_quat(expmap)

    rotations = motion.local_rotations.copy()
    kick, punch = 2.1 * bump(1.0, 0.1), 1.6 * bump(1.5, 0.07)
    flip = 2 * math.pi / (1.0 + np.exp((2.6 - seconds) / 0.07))
    rotations[:, THIGH] = quat_multiply(about(-kick, 0), rotations[:, THIGH])
    rotations[:, KNEE] = quat_multiply(about(1.3 * bump(0.9, 0.1), 0), rotations[:, KNEE])
    rotations[:, HAND - 1] = quat_multiply(about(punch, 1), rotations[:, HAND - 1])
    rotations[:, 0] = quat_multiply(about(-flip, 0), rotations[:, 0])
    jump = lifted(replace(motion, local_rotations=rotations), 60 * bump(2.6, 0.3))
    out, report = clean(jump)
    assert (report.lead_in, report.lead_out, report.pops, report.notes[1:]) == (0, 0, (), ())
    assert np.array_equal(out.local_rotations, jump.local_rotations)


@pytest.mark.parametrize("length", [1, 3, 20])
def test_a_knee_on_its_wrong_side_comes_back(make_motion: Callable[..., Motion], length: int) -> None:
    """Hip and ankle stay; knee and foot are rotated by half a turn about the line between them."""
    motion = make_motion(frames=200, fps=120, swing=0.2)
    rotations = motion.local_rotations.copy()
    rotations[:, KNEE] = expmap_to_quat(np.array([0.7, 0.0, 0.0], np.float32))
    motion = replace(motion, local_rotations=rotations)
    offsets = motion.skeleton.offsets
    span = slice(80, 80 + length)
    reach = offsets[KNEE] + quat_rotate(rotations[span, KNEE], offsets[FOOT])
    line = normalized(quat_rotate(rotations[span, THIGH], reach))
    broken = rotations.copy()
    broken[span, THIGH] = quat_multiply(expmap_to_quat(math.pi * line), rotations[span, THIGH])
    broken[span, FOOT] = quat_multiply(
        expmap_to_quat(np.array([0.0, 1.5, 0.0], np.float32)), rotations[span, FOOT]
    )
    out, report = clean(replace(motion, local_rotations=broken))
    assert {frame for frame, _ in report.pops} == set(range(80, 80 + length))
    _, places = motion_kinematics(out)
    _, truth = motion_kinematics(motion)
    truth[..., 1] += report.floor_shift
    assert np.linalg.norm(places[:, FOOT] - truth[:, FOOT], axis=-1).max() < 0.5
    assert np.linalg.norm(places[:, KNEE] - truth[:, KNEE], axis=-1).max() < 2.0


def test_a_jump_that_never_comes_back_is_noted(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=200, fps=120)
    broken = motion
    for frame in range(100, 200):
        broken = turned(broken, frame, HAND, 100)
    out, report = clean(broken)
    assert report.pops == () and len(out) == 200
    assert any("RightHand at frame 100" in note for note in report.notes)


@pytest.mark.parametrize("height", [-6.0, 0.0, 3.5, 40.0])
def test_floor_of_somebody_standing(height: float) -> None:
    out, report = clean(standing(toe_height=height))
    assert report.floor_shift == pytest.approx(TOE_HEIGHT - height, abs=0.05)
    _, places = motion_kinematics(out)
    assert np.median(places[:, list(TOES), 1]) == pytest.approx(TOE_HEIGHT, abs=0.05)


def test_floor_under_jumps_and_a_handstand() -> None:
    motion = standing(frames=600)
    seconds = np.arange(600) / 60
    jumping = lifted(motion, 50 * np.maximum(np.sin(2 * math.pi * seconds), 0))
    assert abs(clean(jumping)[1].floor_shift) < 0.3
    upside_down = motion.local_rotations.copy()
    upside_down[250:450, 0] = expmap_to_quat(np.array([math.pi, 0.0, 0.0], np.float32))
    ease = np.linspace(0, 1, 50, dtype=np.float32)[:, None]
    upside_down[200:250, 0] = expmap_to_quat(ease * np.array([math.pi, 0.0, 0.0], np.float32))
    upside_down[450:500, 0] = expmap_to_quat((1 - ease) * np.array([math.pi, 0.0, 0.0], np.float32))
    assert abs(clean(replace(motion, local_rotations=upside_down))[1].floor_shift) < 0.3


def test_floor_below_a_platform_and_past_stray_frames() -> None:
    motion = standing(frames=400)
    climb = np.zeros(400, np.float32)
    climb[100:] = 30.0
    climb[90:100] = np.linspace(0, 30, 10, dtype=np.float32)
    assert abs(clean(lifted(motion, climb))[1].floor_shift) < 0.3
    sinking = np.zeros(400, np.float32)
    sinking[200:210] = -5.0
    assert abs(clean(lifted(motion, sinking))[1].floor_shift) < 0.3


def test_floor_of_a_leg_held_up(make_motion: Callable[..., Motion]) -> None:
    motion = standing(frames=300)
    rotations = motion.local_rotations.copy()
    rotations[:, THIGH] = expmap_to_quat(np.array([-1.4, 0.0, 0.0], np.float32))
    assert abs(clean(replace(motion, local_rotations=rotations))[1].floor_shift) < 0.1


def test_a_clip_without_stance_says_so(make_motion: Callable[..., Motion]) -> None:
    flying = lifted(standing(frames=60), np.linspace(0, 400, 60, dtype=np.float32))
    _, report = clean(flying)
    assert any("no stance" in note for note in report.notes)


def test_place_and_heading_do_not_matter(make_motion: Callable[..., Motion]) -> None:
    motion = turned(make_motion(frames=200, fps=120, swing=0.25), 77, KNEE, 60)
    turn = quat_from_yaw(np.array(2.0, np.float32))
    rotations = motion.local_rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    places = quat_rotate(turn, motion.root_positions) + np.array([300.0, 0.0, -50.0], np.float32)
    one, first = clean(motion)
    two, second = clean(replace(motion, local_rotations=rotations, root_positions=places))
    assert first.pops == second.pops and first.lead_in == second.lead_in
    assert first.floor_shift == pytest.approx(second.floor_shift, abs=0.05)
    back = quat_multiply(quat_inverse(turn), two.local_rotations[:, 0])
    assert quat_angle(back, one.local_rotations[:, 0]).max() < 2e-3


def test_cleaning_twice_changes_nothing_more(make_motion: Callable[..., Motion]) -> None:
    motion = turned(make_motion(frames=200, fps=120, swing=0.25), 77, KNEE, 60)
    once, _ = clean(motion)
    twice, report = clean(once)
    assert (report.lead_in, report.lead_out, report.pops) == (0, 0, ())
    assert abs(report.floor_shift) < 1e-3 and len(twice) == len(once)


@pytest.mark.parametrize("frames", [1, 2, 3, 5, 8])
def test_very_short_motions(make_motion: Callable[..., Motion], frames: int) -> None:
    out, report = clean(make_motion(frames=frames))
    assert len(out) == frames and np.isfinite(out.root_positions).all() and math.isfinite(report.floor_shift)


def test_nothing_moves_at_all() -> None:
    still = standing(frames=50)
    frozen = replace(still, local_rotations=np.broadcast_to(still.local_rotations[:1], (50, 23, 4)))
    out, report = clean(frozen)
    assert len(out) == 50 and report.lead_in == 0


def test_the_input_is_left_as_it_was(make_motion: Callable[..., Motion]) -> None:
    motion = turned(make_motion(frames=100), 40, KNEE, 60)
    rotations, places = motion.local_rotations.copy(), motion.root_positions.copy()
    clean(motion)
    assert np.array_equal(motion.local_rotations, rotations) and np.array_equal(motion.root_positions, places)


def test_speed(make_motion: Callable[..., Motion]) -> None:
    motion = make_motion(frames=5000, fps=120)
    clean(motion)
    start = time.process_time()
    clean(motion)
    assert time.process_time() - start < 2.0  # about 0.1 s
