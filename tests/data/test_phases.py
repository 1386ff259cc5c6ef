"""Phases: which types have one, and its values."""

import math

import numpy as np

from motionkit.arrays import Array
from motionkit.data.phases import NO_PHASE, PhaseRule, mirror_phases, phase_rules, phase_track, turns_over
from motionkit.features.encode import encode_motion
from motionkit.features.layout import DEFAULT_LAYOUT, feature_layout
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_identity
from motionkit.motion.skeleton import FOOT_JOINTS, JOINT_NAMES, canonical_skeleton


def rolled(degrees: float, frames: int = 40) -> Array:
    """Features of a body that rolls about Z to an angle and back."""
    rotations = quat_identity((frames, 23))
    half = 0.5 * math.radians(degrees) * np.sin(np.linspace(0, math.pi, frames, dtype=np.float32))
    rotations[:, 0, 0], rotations[:, 0, 3] = np.cos(half), np.sin(half)
    root = np.broadcast_to(np.array([0.0, 95.0, 0.0], np.float32), (frames, 3))
    return encode_motion(Motion(canonical_skeleton(), rotations, root, 60.0)).features


def test_turns_over_needs_the_hips_upside_down():
    assert turns_over(rolled(180.0), DEFAULT_LAYOUT)
    assert not turns_over(rolled(60.0), DEFAULT_LAYOUT)


def test_types_that_mostly_turn_over_have_a_phase():
    clips = [
        (rolled(170.0, 40), np.zeros(40, np.int16)),
        (rolled(170.0, 60), np.zeros(60, np.int16)),
        (rolled(30.0, 50), np.ones(50, np.int16)),
    ]
    assert phase_rules(clips, DEFAULT_LAYOUT) == {0: PhaseRule("", 50.0)}


def test_phase_runs_through_each_stretch():
    types = np.array([1, 1, 0, 0, 0, 0, 1, 0, 0])
    features = rolled(30.0, len(types))
    track = phase_track(features, types, {0: PhaseRule("", 4.0)}, DEFAULT_LAYOUT)
    assert np.allclose(track, [NO_PHASE, NO_PHASE, 0, 0.25, 0.5, 0.75, NO_PHASE, 0, 0.5])
    assert np.all(phase_track(features, types, {}, DEFAULT_LAYOUT) == NO_PHASE)


def strikes(right: bool, count: int = 2, hop: bool = False) -> Array:
    """Features of a standing body that, count times, lifts a foot to the hips or hops with both feet."""
    frames = 90 * count
    height = np.array([0.5 * (1 - math.cos(2 * math.pi * (t % 90 - 20) / 50)) if 20 < t % 90 < 70 else 0.0
                           for t in range(frames)], np.float32)  # fmt: skip
    rotations, root = quat_identity((frames, 23)), np.tile(np.float32([0.0, 95.0, 0.0]), (frames, 1))
    if hop:
        root[:, 1] += 30.0 * height
    else:
        leg = JOINT_NAMES.index("RightUpLeg" if right else "LeftUpLeg")
        rotations[:, leg, 0], rotations[:, leg, 1] = np.cos(0.9 * height), -np.sin(0.9 * height)
    return encode_motion(Motion(canonical_skeleton(), rotations, root, 60.0)).features


def test_kicks_run_through_the_half_of_their_side():
    for right in (False, True):
        features = strikes(right)
        types = np.zeros(len(features), np.int16)
        rules = phase_rules([(features, types)], DEFAULT_LAYOUT)
        assert rules[0].event == "kick" and rules[0].sided
        track = phase_track(features, types, rules, DEFAULT_LAYOUT)
        shown = track[track >= 0]
        assert 0.3 < len(shown) / len(track) < 0.9
        assert (shown.min(), shown.max() > 0.45) == ((0.5, True) if right else (0.0, True))
        assert (shown.max() < 0.5) != right
        mirrored = mirror_phases(track, np.ones(len(track), bool))
        there = mirrored[mirrored >= 0]
        assert np.array_equal(mirrored >= 0, track >= 0)
        assert (there.max() < 0.5) == right


def test_jumps_have_one_phase_each():
    features = strikes(False, 3, hop=True)
    rules = phase_rules([(features, np.zeros(len(features), np.int16))], DEFAULT_LAYOUT)
    assert rules[0].event == "jump" and not rules[0].sided
    track = phase_track(features, np.zeros(len(features), np.int16), rules, DEFAULT_LAYOUT)
    assert int((np.diff(track) < -0.5).sum()) == 3


def test_one_who_hardly_moves_has_no_phase():
    assert phase_rules([(rolled(20.0), np.zeros(40, np.int16))], DEFAULT_LAYOUT) == {}


def test_strides_of_a_run_are_no_jumps() -> None:
    """A clip of one stride, the loop of a run, was taken for a jump, so that no velocity steered it."""
    features = strikes(right=False, count=1, hop=True)
    ahead = [
        i
        for i, column in enumerate(feature_layout(DEFAULT_LAYOUT).columns)
        if column.block == "joint_positions" and column.component == 2 and column.joint in FOOT_JOINTS[:2]
    ]
    clips = [
        (features, np.zeros(len(features), np.int16)),
        (features.copy(), np.ones(len(features), np.int16)),
    ]
    clips[1][0][:, ahead] += 60.0
    assert [rule.event for rule in phase_rules(clips, DEFAULT_LAYOUT).values()] == ["jump"]
