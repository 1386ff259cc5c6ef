from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motionkit.arrays import Array
from motionkit.finish.feet import LIFT_FRAMES, MIN_LOCK_FRAMES, clear_toes, lock_feet, locked_spans
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import LOCK, TOE
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_angle
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_NAMES
from synthetic_motions import feet_down, make_idle, make_walk, placed, sliding

LEFT_TOE, RIGHT_TOE = FOOT_JOINTS[1], FOOT_JOINTS[3]
BETWEEN = 0.5 * (LOCK.contact_off + LOCK.contact_on)
LEGS = [JOINT_NAMES.index(s + n) for s in ("Left", "Right") for n in ("UpLeg", "Leg", "Foot")]


def toe_track(motion: Motion, toe: int) -> Array:
    return motion_kinematics(motion)[1][:, toe]


def drift(motion: Motion, toe: int, start: int, end: int) -> float:
    """Largest distance of a toe over the ground from its mean place over some frames, cm."""
    along = toe_track(motion, toe)[start:end, [0, 2]]
    return float(np.linalg.norm(along - along.mean(axis=0), axis=-1).max())


def stands(motion: Motion, toe: int, start: int, end: int) -> bool:
    """Whether a toe is as high as a standing one over some frames, but for those in which it comes and goes."""
    height = toe_track(motion, toe)[start + 2 * LIFT_FRAMES : end - 2 * LIFT_FRAMES, 1]
    return bool((np.abs(height - TOE.standing) < TOE.slack + 0.05).all())


@pytest.mark.parametrize("crouch", [0.0, 0.1, 0.4])
def test_a_locked_foot_of_a_sliding_walk_stays_where_it_is(crouch: float) -> None:
    motion = sliding(crouch=crouch)
    spans_left, spans_right = [(10, 40), (70, 100)], [(40, 70)]
    contacts = feet_down(120, spans_left, spans_right)
    for start, end in spans_left:
        assert 1.0 < drift(motion, LEFT_TOE, start, end) < LOCK.max_slide / 2, (
            "the feet are to slide a little"
        )
    locked = lock_feet(motion, contacts)
    for toe, spans in ((LEFT_TOE, spans_left), (RIGHT_TOE, spans_right)):
        for start, end in spans:
            assert drift(locked, toe, start, end) < 0.1 and stands(locked, toe, start, end)


def test_locks_close_together_all_hold() -> None:
    """Three steps of one foot a few frames apart: the easing of one lock does not disturb another."""
    motion = sliding(100, 20.0)
    spans = [(20, 35), (38, 52), (56, 75)]
    locked = lock_feet(motion, feet_down(100, spans, []))
    for start, end in spans:
        assert drift(locked, LEFT_TOE, start, end) < 0.1
    # Between two locks the foot goes over from one to the other, not beyond.
    steps = np.linalg.norm(np.diff(toe_track(locked, LEFT_TOE), axis=0), axis=-1)
    assert float(steps.max()) < 3.0


def test_a_foot_that_slides_far_takes_new_places_without_jumping() -> None:
    motion = sliding(120, 60.0)
    locked = lock_feet(motion, feet_down(120, [(10, 110)], []))
    steps = np.linalg.norm(np.diff(toe_track(locked, LEFT_TOE), axis=0), axis=-1)
    slides = np.linalg.norm(np.diff(toe_track(motion, LEFT_TOE), axis=0), axis=-1)
    assert float(steps.max()) < 3.0 * float(slides.max())
    assert np.linalg.norm(toe_track(locked, LEFT_TOE) - toe_track(motion, LEFT_TOE), axis=-1).max() < 14.0
    along = np.linalg.norm(np.diff(toe_track(locked, LEFT_TOE)[:, [0, 2]], axis=0), axis=-1)
    assert int((along[10:109] < 0.01).sum()) > 15, "in between it stands"


@pytest.mark.parametrize("crouch", [0.0, 0.4])
def test_both_feet_at_once(crouch: float) -> None:
    motion = sliding(80, 6.0, crouch)
    locked = lock_feet(motion, feet_down(80, [(20, 60)], [(20, 60)]))
    assert drift(locked, LEFT_TOE, 20, 60) < 0.1 and drift(locked, RIGHT_TOE, 20, 60) < 0.1


def test_frames_away_from_a_lock_are_unchanged() -> None:
    motion = sliding(200)
    locked = lock_feet(motion, feet_down(200, [(90, 110)], []))
    near = 3 * LOCK.ease_frames + 1  # the foot eases in and out, the hips a little longer
    away = np.ones(200, bool)
    away[90 - near : 110 + near] = False
    assert int(away.sum()) > 30
    assert np.array_equal(locked.local_rotations[away], motion.local_rotations[away])
    assert np.abs((locked.root_positions - motion.root_positions)[away]).max() < 1e-4


def test_without_contacts_nothing_changes() -> None:
    motion = sliding()
    locked = lock_feet(motion, np.zeros((120, 4), np.float32))
    assert np.array_equal(locked.local_rotations, motion.local_rotations)
    assert np.allclose(locked.root_positions, motion.root_positions)


def test_only_the_legs_turn_and_feet_only_pitch_within_limits() -> None:
    motion = sliding()
    locked = lock_feet(motion, feet_down(120, [(10, 60)], [(50, 100)]))
    others = [j for j in range(23) if j not in LEGS]
    assert np.array_equal(locked.local_rotations[:, others], motion.local_rotations[:, others])
    before, after = motion_kinematics(motion)[0], motion_kinematics(locked)[0]
    for ankle in (FOOT_JOINTS[0], FOOT_JOINTS[2]):
        assert quat_angle(before[:, ankle], after[:, ankle]).max() < TOE.max_pitch + 2e-3


def test_bones_keep_their_lengths() -> None:
    motion = sliding()
    locked = lock_feet(motion, feet_down(120, [(10, 60)], [(50, 100)]))
    positions = motion_kinematics(locked)[1]
    parents = motion.skeleton.parents
    for joint in range(1, 23):
        length = np.linalg.norm(positions[:, joint] - positions[:, parents[joint]], axis=-1)
        assert np.allclose(length, np.linalg.norm(motion.skeleton.offsets[joint]), atol=1e-3)
    norms = np.linalg.norm(locked.local_rotations, axis=-1)
    assert np.allclose(norms, np.ones_like(norms), atol=1e-5)


def test_knees_bend_forward_when_the_hips_come_down() -> None:
    """A lock with the hips 6 cm lower: both knees bend forward, neither backward nor sideways."""
    motion = make_idle(60)
    root = motion.root_positions.copy()
    root[20:40, 1] -= 6.0
    lowered = replace(motion, root_positions=root)
    locked = lock_feet(lowered, feet_down(60, [(0, 60)], [(0, 60)]))
    assert stands(locked, LEFT_TOE, 20, 40)
    positions = motion_kinematics(locked)[1][30]
    for side in ("Left", "Right"):
        hip, knee, ankle = (positions[JOINT_NAMES.index(side + n)] for n in ("UpLeg", "Leg", "Foot"))
        assert float(knee[2]) > float(max(hip[2], ankle[2])), "a knee bends forward"


def test_motion_stays_smooth_at_the_edges_of_a_lock() -> None:
    motion = sliding(120, 15.0)
    locked = lock_feet(motion, feet_down(120, [(40, 70)], []))
    before = np.linalg.norm(np.diff(motion_kinematics(motion)[1], n=2, axis=0), axis=-1).max()
    after = np.linalg.norm(np.diff(motion_kinematics(locked)[1], n=2, axis=0), axis=-1).max()
    assert float(after) < float(before) + 0.8


def test_no_toe_stays_under_the_floor() -> None:
    motion = make_idle(40)
    motion = replace(motion, root_positions=motion.root_positions - np.array([0.0, 6.0, 0.0], np.float32))
    assert float(toe_track(motion, LEFT_TOE)[:, 1].min()) < 0
    raised = clear_toes(motion)
    for toe in (LEFT_TOE, RIGHT_TOE):
        assert float(toe_track(raised, toe)[:, 1].min()) > TOE.lowest - 0.1


def test_a_swinging_toe_clears_the_floor_where_the_body_came_down() -> None:
    motion = make_walk(120)
    motion = replace(motion, root_positions=motion.root_positions - np.array([0.0, 4.0, 0.0], np.float32))
    heights, swings = {}, {}
    for name, shown in (("before", motion), ("after", clear_toes(motion))):
        toe = toe_track(shown, LEFT_TOE)
        swings[name] = np.linalg.norm(np.diff(toe[:, [0, 2]], axis=0), axis=-1) > TOE.fast
        heights[name] = float(toe[1:][swings[name], 1].min())
    assert heights["before"] < TOE.swing - 2.0 < TOE.swing - 0.1 < heights["after"]


def test_turned_and_placed_motions_lock_alike() -> None:
    motion, contacts = sliding(), feet_down(120, [(20, 60)], [(60, 100)])
    there = lock_feet(placed(motion, 1.3, (100.0, -50.0)), contacts)
    here = placed(lock_feet(motion, contacts), 1.3, (100.0, -50.0))
    assert np.abs(motion_kinematics(here)[1] - motion_kinematics(there)[1]).max() < 0.05


@pytest.mark.parametrize(
    ("level", "spans"),
    [
        ([0.0] * 3 + [1.0] * 6 + [0.0] * 3, [(3, 9)]),
        ([1.0] * 12, [(0, 12)]),
        ([BETWEEN] * 12, []),  # never sure enough to begin
        ([1.0] + [BETWEEN] * 11, [(0, 12)]),  # but sure enough to go on
        ([1.0] * (MIN_LOCK_FRAMES - 1) + [0.0] * 9, []),
        ([1.0] * 5 + [0.0] + [1.0] * 6, [(0, 5), (6, 12)]),
        ([0.0] * 12, []),
    ],
)
def test_locked_spans(level: list[float], spans: list[tuple[int, int]]) -> None:
    assert locked_spans(np.array([[v, 0.0] for v in level], np.float32)) == spans
    assert locked_spans(np.array([[0.0, v] for v in level], np.float32)) == spans


def test_a_foot_in_the_air_is_not_held_whatever_is_predicted() -> None:
    motion = make_idle(60)
    motion = replace(motion, root_positions=motion.root_positions + np.array([0.0, 30.0, 0.0], np.float32))
    locked = lock_feet(motion, np.ones((60, 4), np.float32))
    assert np.array_equal(locked.local_rotations, motion.local_rotations)


def test_a_single_frame_comes_back() -> None:
    motion = make_idle(5).cut(0, 1)
    assert lock_feet(motion, np.ones((1, 4), np.float32)) is motion
    assert clear_toes(motion) is motion


def test_a_toe_in_contact_stands_as_high_as_a_standing_one() -> None:
    for height in (-2.0, 6.0):
        motion = make_idle(60)
        raised = motion.root_positions + np.array([0.0, height, 0.0], np.float32)
        raised[:, 1] -= float(toe_track(motion, LEFT_TOE)[0, 1])
        motion = replace(motion, root_positions=raised)
        locked = lock_feet(motion, feet_down(60, [(20, 40)], [(20, 40)]))
        assert stands(locked, LEFT_TOE, 20, 40)
        assert float(np.abs(np.diff(toe_track(locked, LEFT_TOE)[:, 1])).max()) < 2.0, "not at once"


@pytest.mark.parametrize("fps", [24.0, 120.0, 240.0])
def test_feet_are_held_and_let_go_in_the_same_time_at_any_rate(fps: float) -> None:
    def locked(rate: float) -> Array:
        frames = round(2.0 * rate)
        motion = make_walk(frames, rate, speed=10.0, turn=0.0, swing=0.08, cadence=0.3, crouch=0.4)
        spans = [(round(a * rate), round(b * rate)) for a, b in ((0.25, 0.75), (1.25, 1.75))]
        return toe_track(lock_feet(motion, feet_down(frames, spans, [])), LEFT_TOE)

    step = max(1, round(fps / 60.0))
    mine, usual = locked(fps)[::step], locked(60.0)
    at = np.arange(len(mine)) * step / fps * 60.0
    there = np.stack([np.interp(at, np.arange(len(usual)), usual[:, axis]) for axis in (0, 2)], axis=-1)
    apart = np.linalg.norm(mine[:, [0, 2]] - there, axis=-1)
    assert float(apart.mean()) < 0.25 and float(apart.max()) < (0.7 if fps > 60.0 else 1.5)
    raw = toe_track(make_walk(120, speed=10.0, turn=0.0, swing=0.08, cadence=0.3, crouch=0.4), LEFT_TOE)
    assert float(np.linalg.norm((usual - raw)[:, [0, 2]], axis=-1).max()) > 1.0


def test_a_foot_that_has_slid_too_far_takes_its_new_place_by_a_step() -> None:
    """A slow slide of 44 cm in one contact: the toe stands, goes up and ahead, and stands again."""
    motion = sliding(120, 24.0)
    locked = lock_feet(motion, feet_down(120, [(5, 115)], []))
    track = toe_track(locked, LEFT_TOE)
    steps = np.linalg.norm(np.diff(track[:, [0, 2]], axis=0), axis=-1)
    moving = np.flatnonzero(steps[5:112] > 0.05) + 5
    assert 4 < len(moving) < 40 and steps[5:112].sum() > 8.0, "one step or two"
    standing = np.setdiff1d(np.arange(12, 108), np.arange(moving.min() - 3, moving.max() + 4))
    highest = float(track[moving, 1].max())
    assert highest > float(track[standing, 1].max()) + 2.0
    assert (track[standing, 1] < TOE.standing + TOE.slack + 0.1).all()


def test_feet_step_one_after_the_other() -> None:
    motion = sliding(120, 24.0)
    locked = lock_feet(motion, feet_down(120, [(5, 115)], [(5, 115)]))
    going = [
        np.linalg.norm(np.diff(toe_track(locked, toe)[:, [0, 2]], axis=0), axis=-1)[8:110] > 0.1
        for toe in (LEFT_TOE, RIGHT_TOE)
    ]
    assert going[0].sum() > 10 and going[1].sum() > 10
    assert (going[0] & going[1]).sum() <= 1, "one lands in the frame in which the other lifts"
