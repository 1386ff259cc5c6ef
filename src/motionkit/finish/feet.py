"""Foot locking for whole motions: feet stay in place during contacts, by two-bone IK with eased transitions.

Works on the canonical joints. During a contact the toe stays in one place at standing height; the knee bends to reach
it, and the hips come down where the leg is too short. The C kernels lock the feet of live characters frame by frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array, length, lower_median, peak_smoothed, smoothstep
from motionkit.motion.contacts import CONTACT_HEIGHTS
from motionkit.motion.frame_rate import RATE, frames_at
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.leg_ik import (
    ANKLES,
    HIPS,
    KNEES,
    LEG_JOINTS,
    LOCK,
    TOE,
    TOES,
    knees_backwards,
    lowest_free,
    move_feet,
    pitched_feet,
)
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_normalize, quat_to_matrix
from motionkit.motion.skeleton import FOOT_JOINTS

Span = tuple[int, int]  # first frame, and the frame after the last

# Frames count at 60 fps, as in LOCK; _frames converts them to other rates.
MIN_LOCK_FRAMES = 4  # shorter contacts are ignored
LIFT_FRAMES = 3  # a toe that is too low reaches its height this many frames early, after a rise of as many
# Longest step in frames, and the speed (cm per frame) below which a foot is at rest. A step ends with the foot at rest.
LONGEST_STEP, STEP_REST = 32, 0.2
FLOOR_FADE = 6.0  # cm above CONTACT_HEIGHTS over which a predicted contact fades out


def lock_feet(motion: Motion, contacts: Array) -> Motion:
    """Lock the feet of a motion during contacts.

    Args:
        motion: T frames on the canonical joints, in cm, the floor at height zero.
        contacts: (T, 4) labels or probabilities: left foot, left toe, right foot, right toe. They count only near the
            floor: a network may predict a contact while the body is still upside down, and a lock would pull the foot
            down.

    Returns:
        The motion with changed leg rotations and root positions.
    """
    if len(motion) < 2:
        return motion
    turns, positions = motion_kinematics(motion)
    touching = contacts * _near_floor(positions)
    left, steps = _toe_shifts(positions[:, TOES[0]], touching[:, :2], motion.fps, [])
    right, _ = _toe_shifts(positions[:, TOES[1]], touching[:, 2:], motion.fps, steps)
    shifts = np.stack([left, right], axis=1)
    return _moved(motion, turns, positions, shifts)


def clear_toes(motion: Motion, standing: Sequence[float] = (TOE.standing, TOE.standing)) -> Motion:
    """Raise toes that move lower over the floor than recorded ones do, as after a correction of the root height.

    Args:
        motion: T frames on the canonical joints, in cm, the floor at height zero; a single frame stays as it is.
        standing: heights in cm of the left and right toe joint when the foot stands.
    """
    if len(motion) < 2:
        return motion
    turns, positions = motion_kinematics(motion)
    toes = positions[:, TOES].astype(np.float64)
    shifts = np.zeros_like(positions[:, TOES])
    for side in range(2):
        heights = toes[:, side, 1] + (TOE.standing - standing[side])
        shifts[:, side, 1] = _cleared(toes[:, side, ::2], heights, motion.fps)
    return _moved(motion, turns, positions, shifts)


def _cleared(place: Array, height: Array, fps: float) -> Array:
    """Smooth rise (T,) in cm of a toe at places (T, 2) and heights (T,) to the least height of a free toe."""
    strides = length(np.diff(place, axis=0, prepend=2.0 * place[:1] - place[1:2]))
    missing = np.maximum(lowest_free(strides * (fps / RATE)) - height, 0.0)
    return peak_smoothed(missing, missing[:, None], frames_at(LIFT_FRAMES, fps))[:, 0]


def _moved(motion: Motion, turns: Array, positions: Array, shifts: Array) -> Motion:
    """The motion with its toes shifted by (T, 2, 3), from its world rotations and positions."""
    backwards = knees_backwards(positions, quat_to_matrix(turns[:, HIPS]))
    moved = (length(shifts) > LOCK.least_change).any(axis=1) | backwards.any(axis=1)
    if not moved.any():
        return motion
    pitch, ankle_shifts = pitched_feet(positions, shifts)
    drop = hip_drop(motion, positions, ankle_shifts)
    rotations, positions = motion.local_rotations.copy(), positions + drop[:, None]
    moved |= (drop != 0.0).any(axis=1)
    turned, world = rotations[moved], quat_to_matrix(turns[moved])
    move_feet(turned, positions[moved], world, pitch[moved], (ankle_shifts - drop[:, None])[moved])
    legs = LEG_JOINTS[:3].ravel()
    turned[:, legs] = quat_normalize(turned[:, legs])
    rotations[moved] = turned
    return replace(motion, local_rotations=rotations, root_positions=motion.root_positions + drop)


def _near_floor(positions: Array) -> Array:
    """Weights (T, 4) of contacts by height: 1 at contact height or below, 0 at FLOOR_FADE above it."""
    heights = positions[:, list(FOOT_JOINTS), 1]
    return np.clip(1.0 - (heights - np.array(CONTACT_HEIGHTS)) / FLOOR_FADE, 0.0, 1.0).astype(positions.dtype)


def locked_spans(contacts: Array, fps: float = RATE) -> list[Span]:
    """Spans (start, end) of frames in contact, from probabilities (T, n) of the joints of a foot."""
    level = contacts.max(axis=-1).tolist()
    spans, start = [], None
    for t, value in enumerate([*level, 0.0]):
        if start is None and value > LOCK.contact_on:
            start = t
        elif start is not None and value < LOCK.contact_off:
            if t - start >= frames_at(MIN_LOCK_FRAMES, fps):
                spans.append((start, t))
            start = None
    return spans


def contacts_around(contacts: Array, start: int, end: int, fps: float) -> Array:
    """Contacts (T, 4) that overlap frames start to end; all others are zero, so that recorded frames stay unlocked."""
    out = np.zeros_like(contacts)
    for foot in (slice(0, 2), slice(2, 4)):
        for first, last in locked_spans(contacts[:, foot], fps):
            if first < end and start < last:
                out[first:last, foot] = contacts[first:last, foot]
    return out


def _still_spans(
    place: Array, spans: list[Span], fps: float, other_steps: list[Span]
) -> tuple[list[Span], list[Span]]:
    """Split contact spans with a step wherever the foot, at places (T, 2), slides further than max_slide.

    A step ends with the foot at rest, if that happens within LONGEST_STEP. A foot that slides fast stands as long as
    it steps.

    Args:
        other_steps: steps of the other foot; this one stands during them if it can.

    Returns:
        Spans in which the foot stands, and its steps.
    """
    step, longest = frames_at(LOCK.step_frames, fps), frames_at(LONGEST_STEP, fps)
    rests = np.flatnonzero(np.append(length(np.diff(place, axis=0)) < STEP_REST * RATE / fps, True))
    out, steps = [], []
    for start, end in spans:
        first = start
        while (far := length(place[first:end] - place[first]) > LOCK.max_slide).any():
            slid = first + int(far.argmax())
            lifts = max(slid - step // 2, (first + slid) // 2)
            waits = max((b for a, b in other_steps if a < slid + step and lifts < b), default=lifts)
            if waits < end and length(place[waits] - place[first]) < LOCK.max_wait * LOCK.max_slide:
                lifts = max(lifts, waits)
            lands = max(slid, lifts + step // 2)
            rest = int(rests[min(int(np.searchsorted(rests, lands)), len(rests) - 1)])
            lands = min(rest if lands <= rest < lifts + longest else max(lands, lifts + step), end)
            out.append((first, lifts))
            steps.append((lifts, lands))
            first = lands
            if first >= end:
                break
        out.append((first, end))
    return [(start, end) for start, end in out if end > start], steps


def _toe_shifts(toe: Array, contacts: Array, fps: float, other_steps: list[Span]) -> tuple[Array, list[Span]]:
    """Shifts (T, 3) that bring a toe (T, 3) to its locked place and height, and the steps of its foot.

    Args:
        other_steps: steps of the other foot.
    """
    place, height = toe[:, [0, 2]].astype(np.float64), toe[:, 1:2].astype(np.float64)
    ease = frames_at(LOCK.ease_frames, fps)
    touching = locked_spans(contacts, fps)
    spans, steps = _still_spans(place, touching, fps, other_steps)
    holds = [lower_median(place[start:end]) - place[start:end] for start, end in spans]
    over_ground = faded(holds, spans, (len(toe), 2), ease)
    # Contacts of the toe alone set its height: a heel may touch first.
    spans = locked_spans(contacts[:, 1:], fps)
    standing = np.clip(height, TOE.standing - TOE.slack, TOE.standing + TOE.slack) - height
    upwards = faded([standing[start:end] for start, end in spans], spans, (len(toe), 1), ease)
    upwards += _raised_steps(place + over_ground, steps, frames_at(LOCK.step_frames, fps))
    return np.insert(over_ground, 1, upwards[:, 0], axis=1).astype(toe.dtype), steps


def _raised_steps(place: Array, steps: list[Span], whole: int) -> Array:
    """Rise (T, 1) in cm of a toe at places (T, 2) during its steps.

    A longer step rises higher; a step of fewer than `whole` frames rises less.
    """
    out = np.zeros((len(place), 1))
    for start, end in steps:
        far = float(length(place[min(end, len(place) - 1)] - place[start]))
        share = (np.arange(start, end) - start + 0.5) / (end - start)
        height = LOCK.step_height * min(far / LOCK.max_slide, 1.0) * min((end - start) / whole, 1.0)
        out[start:end, 0] = height * np.sin(np.pi * share)
    return out


def faded(shifts: list[Array], spans: list[Span], shape: tuple[int, int], ease: int) -> Array:
    """Spread shifts (n, k) of some spans over all frames (T, k); they fade out over `ease` frames.

    Frames between two near spans blend both. Within a span only its own shift counts.
    """
    pulls, weights, strength = np.zeros(shape), np.zeros((shape[0], 1)), np.zeros((shape[0], 1))
    for shift, (start, end) in zip(shifts, spans, strict=True):
        around = slice(max(0, start - ease), min(shape[0], end + ease))
        before, after = start - around.start, around.stop - end
        whole = np.pad(shift, ((before, after), (0, 0)), mode="edge")
        parts = [_easing(before, ease)[::-1], np.ones(end - start), _easing(after, ease)]
        share = np.concatenate(parts)[:, None]
        weight = share / (1.0 - share + 1e-9)
        pulls[around] += weight * whole
        weights[around] += weight
        strength[around] = np.maximum(strength[around], share)
    return strength * pulls / np.maximum(weights, 1e-12)


def _easing(frames: int, ease: int) -> Array:
    """The first `frames` values of a share that falls from 1 to 0 in `ease` frames."""
    return smoothstep(1.0 - np.arange(1, frames + 1) / ease)


def hip_drop(motion: Motion, positions: Array, shifts: Array) -> Array:
    """How far the root moves (T, 3), smoothly, towards ankles that the legs do not reach.

    Without it a leg that is stretched while its foot is held snaps back: one leap of a knee in 460 roll-outs.
    """
    need = np.zeros_like(motion.root_positions)
    for side in range(2):
        hip, ankle = positions[:, HIPS[side]], positions[:, ANKLES[side]]
        whole = np.linalg.norm(motion.skeleton.offsets[[KNEES[side], ANKLES[side]]], axis=-1).sum()
        reach = ankle + shifts[:, side] - hip
        distance = length(reach)
        # A leg that was straight before stays straight; the hips only move by what the lock adds.
        missing = np.maximum(distance - np.maximum(LOCK.max_reach * whole, length(ankle - hip)), 0.0)
        move = reach / np.maximum(distance, 1e-6)[:, None] * missing[:, None]
        need = np.where((missing > length(need))[:, None], move, need)
    return peak_smoothed(length(need), need, frames_at(LOCK.ease_frames, motion.fps))
