"""Foot locking for whole motions: feet stay in place during contacts, by two-bone IK with eased transitions.

Works on the canonical joints. While a foot is in contact, its toe is locked to one place on the floor; the knee
bends to reach it, and the hips move down where the leg is too short.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array, cross, lower_median, normalized
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_between, quat_inverse, quat_multiply, quat_normalize, quat_rotate
from motionkit.motion.skeleton import JOINT_NAMES

EASE_FRAMES = 8
MIN_LOCK_FRAMES = 4
# A contact begins above the first probability and ends below the second; the hysteresis avoids flicker.
CONTACT_ON, CONTACT_OFF = 0.6, 0.4
MAX_SLIDE = 16.0  # cm; a foot that slides further during a contact is released
MAX_REACH = 0.999  # share of the length of the straight leg
TOE_HEIGHT = 2.5  # cm; lowest height of a toe (standing toes are recorded at 1.8 to 3.6)
# A toe that moves along the ground is lifted: by this factor times its movement per frame, up to this many cm. A
# quarter of recorded toes are lower, at any speed.
CLEARANCE, MAX_CLEARANCE = 2.7, 5.0
LIFT_FRAMES = 2  # a foot is lifted this many frames early, and begins to rise as many frames before that


@dataclass(frozen=True)
class _Leg:
    hip: int
    knee: int
    ankle: int
    toe: int
    contacts: tuple[int, int]


def _leg(side: str, contacts: tuple[int, int]) -> _Leg:
    hip, knee, ankle, toe = (JOINT_NAMES.index(side + n) for n in ("UpLeg", "Leg", "Foot", "ToeBase"))
    return _Leg(hip, knee, ankle, toe, contacts)


LEGS = (_leg("Left", (0, 1)), _leg("Right", (2, 3)))


def lock_feet(motion: Motion, contacts: Array) -> Motion:
    """Lock the feet of a motion while they touch the floor.

    Args:
        motion: T frames on the canonical joints, in cm, the floor at height zero.
        contacts: (T, 4) labels or probabilities: left foot, left toe, right foot, right toe.

    Returns:
        The motion with changed leg rotations and root positions.
    """
    if len(motion) < 2:
        return motion
    _, positions = motion_kinematics(motion)
    shifts = [_toe_shifts(positions[:, leg.toe], contacts[:, list(leg.contacts)]) for leg in LEGS]
    targets = [positions[:, leg.ankle] + shift for leg, shift in zip(LEGS, shifts, strict=True)]
    motion = _lower_hips(motion, positions, targets)
    for leg, target in zip(LEGS, targets, strict=True):
        # Twice: the plane of a nearly straight leg is known only after it is bent.
        motion = _reach(_reach(motion, leg, target), leg, target)
    return motion


def locked_spans(contacts: Array) -> list[tuple[int, int]]:
    """Spans (start, end) of frames in contact, from probabilities (T, 2) of ankle and toe."""
    level = contacts.max(axis=-1).tolist()
    spans, start = [], None
    for t, value in enumerate([*level, 0.0]):
        if start is None and value > CONTACT_ON:
            start = t
        elif start is not None and value < CONTACT_OFF:
            if t - start >= MIN_LOCK_FRAMES:
                spans.append((start, t))
            start = None
    return spans


def _still_spans(toe: Array, spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Split spans where the foot slides further than MAX_SLIDE; a new lock begins there.

    EASE_FRAMES before the split are left out, so that the foot does not jump.
    """
    out = []
    for start, end in spans:
        first = start
        for t in range(start, end):
            if float(np.linalg.norm((toe[t] - toe[first])[[0, 2]])) > MAX_SLIDE:
                out.append((first, t - EASE_FRAMES))
                first = t
        out.append((first, end))
    return [(start, end) for start, end in out if end > start]


def _toe_shifts(toe: Array, contacts: Array) -> Array:
    """The shift (T, 3) of the foot in each frame: full while locked, fading out before and after."""
    frames = len(toe)
    pulls, strength = np.zeros((frames, 3), np.float64), np.zeros((frames, 1), np.float64)
    weights = np.zeros((frames, 1), np.float64)
    for start, end in _still_spans(toe, locked_spans(contacts)):
        lock = lower_median(toe[start:end], axis=0)
        shift = np.zeros_like(pulls)
        shift[start:end] = lock - toe[start:end]
        # Outside the lock, the shift at its edge fades out.
        shift[:start], shift[end:] = shift[start].copy(), shift[end - 1].copy()
        distance = np.zeros(frames, np.float64)
        distance[:start] = np.arange(start, 0, -1)
        distance[end:] = np.arange(1, frames - end + 1)
        x = np.clip(1.0 - distance / EASE_FRAMES, 0.0, 1.0)
        share = (x * x * (3.0 - 2.0 * x))[:, None]
        # Frames between two near locks blend both; within a lock only that lock has weight.
        weight = share / (1.0 - share + 1e-9)
        pulls, weights = pulls + weight * shift, weights + weight
        strength = np.maximum(strength, share)
    total = (strength * pulls / np.maximum(weights, 1e-12)).astype(toe.dtype)
    total[:, 1] += _lift(toe + total)
    return total


def _lift(toe: Array) -> Array:
    """The lift (T,) that keeps a toe (T, 3) off a floor that it moves along.

    At the ends of a lock the toe comes down and leaves the floor, as in a step.
    """
    way = np.linalg.norm(np.diff(toe[:, [0, 2]], axis=0), axis=-1)
    # The larger of the movements to and from a frame.
    way = np.maximum(np.pad(way, (1, 0)), np.pad(way, (0, 1)))
    least = TOE_HEIGHT + np.minimum(CLEARANCE * way, MAX_CLEARANCE)
    missing = np.maximum(least - toe[:, 1], 0.0)
    return _eased_most(missing, missing[:, None], LIFT_FRAMES)[:, 0]


def _eased_most(size: Array, values: Array, half: int) -> Array:
    """Replace each of values (T, k) by the one of largest size (T,) within `half` frames, then smooth as widely.

    The smoothed values are thus never smaller than needed.
    """
    kernel = np.hanning(2 * half + 3)[1:-1]
    kernel = (kernel / kernel.sum()).astype(values.dtype)
    around = sliding_window_view(np.pad(size, half, constant_values=-1.0), 2 * half + 1)
    largest = values[around.argmax(axis=-1) + np.arange(len(size)) - half]
    padded = np.pad(largest, ((half, half), (0, 0)), mode="edge")
    return sliding_window_view(padded, 2 * half + 1, axis=0) @ kernel


def _lower_hips(motion: Motion, positions: Array, targets: list[Array]) -> Motion:
    """Move the root smoothly towards feet that the legs cannot reach."""
    need = np.zeros_like(motion.root_positions)
    for leg, target in zip(LEGS, targets, strict=True):
        lengths = np.linalg.norm(motion.skeleton.offsets[[leg.knee, leg.ankle]], axis=-1).sum()
        reach = target - positions[:, leg.hip]
        distance = np.linalg.norm(reach, axis=-1, keepdims=True)
        missing = np.maximum(distance - MAX_REACH * lengths, 0.0)
        already = np.linalg.norm(positions[:, leg.ankle] - positions[:, leg.hip], axis=-1, keepdims=True)
        # A leg that was straight before stays straight; the hips only move by what the lock adds.
        missing = np.minimum(missing, np.maximum(distance - already, 0.0))
        move = reach / np.maximum(distance, 1e-6) * missing
        need = np.where(missing > np.linalg.norm(need, axis=-1, keepdims=True), move, need)
    eased = _eased_most(np.linalg.norm(need, axis=-1), need, EASE_FRAMES)
    return replace(motion, root_positions=motion.root_positions + eased)


def _reach(motion: Motion, leg: _Leg, target: Array) -> Motion:
    """Bend one leg so that its ankle reaches target (T, 3); the foot keeps its world orientation."""
    rotations, positions = motion_kinematics(motion)
    hip, knee, ankle = (positions[:, j] for j in (leg.hip, leg.knee, leg.ankle))
    thigh, shin = np.linalg.norm(knee - hip, axis=-1), np.linalg.norm(ankle - knee, axis=-1)
    reach = np.linalg.norm(target - hip, axis=-1)
    reach = np.minimum(np.maximum(reach, np.abs(thigh - shin) + 0.5), (thigh + shin) * MAX_REACH)
    # Frames already at the target do not change, even those with a fully straight leg.
    still = np.linalg.norm(target - ankle, axis=-1, keepdims=True) < 1e-3
    bend_now = _interior_angle(thigh, shin, np.linalg.norm(ankle - hip, axis=-1))
    bend_then = _interior_angle(thigh, shin, reach)
    axis = cross(hip - knee, ankle - knee)
    # A straight leg has no plane; its knee bends about the thigh's sideways axis.
    sideways = quat_rotate(
        rotations[:, leg.hip], np.broadcast_to(np.array([1.0, 0.0, 0.0], np.float32), axis.shape)
    )
    flat = np.linalg.norm(axis, axis=-1, keepdims=True) < 1e-2 * (thigh * shin)[:, None]
    axis = normalized(np.where(flat, -sideways, axis))
    opened = _about(axis, bend_then - bend_now)
    new_ankle = knee + quat_rotate(opened, ankle - knee)
    swing = quat_between(new_ankle - hip, target - hip)
    thigh_turn = quat_multiply(swing, rotations[:, leg.hip])
    shin_turn = quat_multiply(swing, quat_multiply(opened, rotations[:, leg.knee]))
    parent = motion.skeleton.parents[leg.hip]
    local = motion.local_rotations.copy()
    new = {
        leg.hip: quat_multiply(quat_inverse(rotations[:, parent]), thigh_turn),
        leg.knee: quat_multiply(quat_inverse(thigh_turn), shin_turn),
        leg.ankle: quat_multiply(quat_inverse(shin_turn), rotations[:, leg.ankle]),
    }
    for joint, turn in new.items():
        local[:, joint] = np.where(still, local[:, joint], quat_normalize(turn))
    return replace(motion, local_rotations=local)


def _interior_angle(a: Array, b: Array, opposite: Array) -> Array:
    """The angle (T,) in radians between sides a and b of a triangle."""
    return np.arccos(np.clip((a * a + b * b - opposite * opposite) / (2 * a * b), -1.0, 1.0))


def _about(axis: Array, angle: Array) -> Array:
    """Rotations (T, 4) by angles (T,) in radians about unit axes (T, 3)."""
    half = 0.5 * angle[:, None]
    return np.concatenate([np.cos(half), np.sin(half) * axis], axis=-1)
