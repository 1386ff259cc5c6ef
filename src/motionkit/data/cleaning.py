"""Repairs capture artefacts: T-pose lead-ins, pops, flipped knees and wrong floor heights.

Takes a canonical motion and returns the repaired motion and a report. Every detector compares a frame with its
neighbours, so that kicks, flips and cartwheels, which are fast for several frames in a row, are left alone.
docs/dataset.md has the measurements behind the constants.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array, lower_median, normalized
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_angle,
    quat_continuous,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_slerp,
)
from motionkit.motion.skeleton import JOINT_NAMES, STANDING_HEIGHTS

# Height in cm of the toe joint (ball of the foot) above the floor while the foot stands: the median over the CMU
# subjects with a level floor.
TOE_HEIGHT = STANDING_HEIGHTS[1]

TOES = (JOINT_NAMES.index("LeftToeBase"), JOINT_NAMES.index("RightToeBase"))

# Breaks: a jump of the whole body, or of one joint, that the following frames do not continue.
LEAD_SECONDS = 0.5
EDGE_SECONDS = 0.1
# No dance or walk comes this close to the rest pose (mean over the joints); T-poses are at 5 to 7 degrees.
REST_ANGLE = math.radians(10.0)
BLEND_RATIO = 2.0
FROZEN_ANGLE = math.radians(0.01)
FROZEN_DISTANCE = 1e-3
BODY_BREAK = math.radians(3.0)
FAR_BODY_BREAK = math.radians(6.0)
ROOT_BREAK = 8.0
JOINT_BREAK = math.radians(30.0)
BREAK_RATIO = 3.5
LOOK_AHEAD = 8

# Pops: a joint jumps away and back. Longer pops need a larger jump to count.
POP_JUMP = math.radians(8.0)
LONG_POP_JUMP = math.radians(30.0)
POP_RATIO = 3.0
LONG_POP_RATIO = 4.0
LONG_POP_SECONDS = 0.034
NEIGHBOURS = 4
ROOT_POP = 1.2
ROOT_POP_RATIO = 4.0
JUMP_LEFT = math.radians(60.0)

# Flips: hip and ankle stay, but knee and toes jump to the other side of the line between them and return some frames
# later. A limb is (upper, middle, end).
Limb = tuple[int, int, int]
LIMBS: tuple[Limb, ...] = tuple(
    (JOINT_NAMES.index(side + upper), JOINT_NAMES.index(side + middle), JOINT_NAMES.index(side + end))
    for side in ("Left", "Right")
    for upper, middle, end in (("UpLeg", "Leg", "Foot"), ("Arm", "ForeArm", "Hand"))
)
FLIP_JUMP = math.radians(40.0)
FLIP_FULL = math.radians(150.0)
FLIP_SECONDS = 0.25
FLIP_TURN = math.radians(75.0)

MOST_JUMPS_TOLD = 20

# Stance: toes slower than this, in the lowest well-filled band of heights.
STANCE_SPEED = 20.0
STANCE_BAND = 6.0
STANCE_SHARE = 0.75
STEP_DOWN = 8.0
STEP_SHARE = 0.1


@dataclass(frozen=True)
class CleaningReport:
    """Changes made to one motion.

    Attributes:
        lead_in: frames cut at the start (T-pose, the blend out of it, bad first frames).
        lead_out: frames cut at the end.
        pops: (source frame, joint) of every repaired frame; "root position" means the root's place.
            A flipped limb is listed under its thigh or upper arm.
        floor_shift: cm added to the root height.
        notes: artefacts that were found but not repaired.
    """

    lead_in: int
    lead_out: int
    pops: tuple[tuple[int, str], ...]
    floor_shift: float
    notes: tuple[str, ...]


def clean(motion: Motion) -> tuple[Motion, CleaningReport]:
    """Repair a motion of the 23 canonical joints, in cm, at its own frame rate.

    At least two frames are kept; for a motion of one or two frames only the floor is set.

    Returns:
        The repaired motion and a report.
    """
    cut, pops = mend(motion)  # first, so that a pop near an end is not mistaken for a break
    start, end = _good_span(cut)
    if end - start < len(motion):
        cut, pops = mend(motion.cut(start, end))
    shift, floor_notes = floor_shift(cut)
    notes = floor_notes + _jumps_left(cut, start)
    up = np.array([0.0, shift, 0.0], cut.root_positions.dtype)
    report = CleaningReport(
        start, len(motion) - end, tuple(sorted({(t + start, name) for t, name in pops})), shift, notes
    )
    return replace(cut, root_positions=cut.root_positions + up), report


def mend(motion: Motion, limbs: Sequence[Limb] = LIMBS) -> tuple[Motion, list[tuple[int, str]]]:
    """The motion without flips and pops, and the repaired frames and joints.

    Args:
        motion: of any rig, in cm with Y up.
        limbs: upper, middle and end joint of the legs and arms; those of the canonical skeleton by default.
    """
    unflipped, flips = _mend_flips(motion, limbs)
    mended, pops = _mend_pops(unflipped)
    return mended, flips + pops


def _steps(motion: Motion) -> tuple[Array, Array]:
    """Angles (T - 1, J) between frames in radians, and root distances (T - 1) in cm."""
    rotations, places = motion.local_rotations, motion.root_positions
    return _angle(rotations[:-1], rotations[1:]), np.linalg.norm(places[1:] - places[:-1], axis=-1)


def _angle(a: Array, b: Array) -> Array:
    """quat_angle from the chord of the difference, which is exact for small angles too."""
    same = (a * b).sum(axis=-1, keepdims=True) >= 0
    squared = (np.where(same, a - b, a + b) ** 2).sum(axis=-1)
    return 4.0 * np.arcsin(np.minimum(0.5 * np.sqrt(squared), 1.0))


def _good_span(motion: Motion) -> tuple[int, int]:
    """First frame to keep, and the end (exclusive)."""
    if len(motion) < 3:
        return 0, len(motion)
    angles, distances = _steps(motion)
    start = max(_lead(angles, distances, motion.fps), _rest_pose_blend(motion, angles))
    end = len(motion) - _tail(np.flip(angles, 0), np.flip(distances, 0), motion.fps)
    return (start, end) if end - start >= 2 else (0, len(motion))


def _lead(angles: Array, distances: Array, fps: float) -> int:
    """Number of frames to cut at the start, from the steps (T - 1, J) and (T - 1)."""
    half = len(angles) // 2
    edge = min(max(3, round(EDGE_SECONDS * fps)), half)
    window = min(round(LEAD_SECONDS * fps), half)
    coarse = max(1.0, 60.0 / fps)  # real steps are larger at lower frame rates
    body = angles.mean(axis=1)
    lead = max(
        _last_true(_breaks(body, coarse * FAR_BODY_BREAK, window)),
        _last_true(_breaks(distances, coarse * ROOT_BREAK, window)),
        _edge_breaks(angles, edge, coarse),
    )
    return lead + _frozen(angles[lead:], distances[lead:])


def _rest_pose_blend(motion: Motion, angles: Array) -> int:
    """Number of frames that blend out of the rest pose, from the steps (T - 1, J); 0 if there is no blend."""
    first = motion.local_rotations[0, 1:]
    if float(_angle(first, quat_identity((1,), first.dtype)).mean()) > REST_ANGLE:
        return 0
    body = angles.mean(axis=1)
    later = body[round(EDGE_SECONDS * motion.fps) : round((EDGE_SECONDS + LEAD_SECONDS) * motion.fps)]
    if not len(later):
        return 0
    calm = np.flatnonzero(body <= BLEND_RATIO * lower_median(later))
    return int(calm[0]) if len(calm) else 0


def _tail(angles: Array, distances: Array, fps: float) -> int:
    """Number of frames to cut at the end, from the steps in reverse order."""
    edge = min(max(3, round(EDGE_SECONDS * fps)), len(angles) // 2)
    coarse = max(1.0, 60.0 / fps)
    tail = max(_last_true(_breaks(distances, coarse * ROOT_BREAK, edge)), _edge_breaks(angles, edge, coarse))
    return tail + _frozen(angles[tail:], distances[tail:])


def _edge_breaks(angles: Array, edge: int, coarse: float) -> int:
    """Number of frames before the last break of the body or of a joint, within the first steps (T - 1, J)."""
    body = _breaks(angles.mean(axis=1), coarse * BODY_BREAK, edge)
    joints = _breaks(angles, coarse * JOINT_BREAK, edge)
    joints[2:, list(TOES)] = False  # toes jitter; cut only the outermost frames for them
    return _last_true(body | joints.any(axis=1))


def _breaks(steps: Array, least: float, window: int) -> Array:
    """Which of the first steps (window, ...) far exceed the LOOK_AHEAD steps that follow."""
    ahead = np.concatenate([steps, np.broadcast_to(steps[-1:], (LOOK_AHEAD, *steps.shape[1:]))])
    following = sliding_window_view(ahead[1:], LOOK_AHEAD, axis=0)[:window].max(axis=-1)
    return (steps[:window] > least) & (steps[:window] > BREAK_RATIO * following)


def _frozen(angles: Array, distances: Array) -> int:
    """Number of steps at the start without any movement; 0 if nothing ever moves."""
    still = (angles.max(axis=1) < FROZEN_ANGLE) & (distances < FROZEN_DISTANCE)
    moving = np.flatnonzero(~still)
    return int(moving[0]) if len(moving) else 0


def _last_true(flags: Array) -> int:
    """One more than the index of the last true flag, 0 if there is none."""
    found = np.flatnonzero(flags)
    return int(found[-1]) + 1 if len(found) else 0


def _mend_pops(motion: Motion) -> tuple[Motion, list[tuple[int, str]]]:
    """The motion with short pops bridged, and their frames and joints."""
    rotations, places = motion.local_rotations.copy(), motion.root_positions.copy()
    # At a low frame rate, two frames away and back are real motion: toes roll off that fast in a run.
    longest = max(1, round(LONG_POP_SECONDS * motion.fps))
    coarse = max(1.0, 60.0 / motion.fps)
    steps = _angle(rotations[:-1], rotations[1:])
    mended: list[tuple[int, str]] = []
    for span in range(1, min(longest, len(motion) - 2) + 1):
        pops = _joint_pops(rotations, steps, span, coarse)
        for frame, joint in pops:
            rotations[frame : frame + span, joint] = _bridge(
                rotations[frame - 1, joint], rotations[frame + span, joint], span
            )
            mended.extend((frame + i, motion.skeleton.names[joint]) for i in range(span))
        if pops:
            steps = _angle(rotations[:-1], rotations[1:])
    for frame in _root_pops(places):
        places[frame] = 0.5 * (places[frame - 1] + places[frame + 1])
        mended.append((frame, "root position"))
    if not mended:
        return motion, []
    out = replace(motion, local_rotations=quat_continuous(rotations), root_positions=places)
    return out, sorted(set(mended))


def _joint_pops(rotations: Array, steps: Array, span: int, coarse: float) -> list[tuple[int, int]]:
    """First frame and joint of every pop of `span` frames in rotations (T, J, 4) with steps (T - 1, J).

    The steps out and back must far exceed the steps before and after, and the steps that remain after
    interpolation. This separates a pop from a fast swing, whose neighbours are fast too. The smallest jump is
    multiplied by coarse, because real steps are larger at lower frame rates.
    """
    least, ratio = (POP_JUMP, POP_RATIO) if span <= 2 else (LONG_POP_JUMP, LONG_POP_RATIO)
    jump = np.minimum(steps[: len(steps) - span], steps[span:])
    frames, joints = np.nonzero(jump > coarse * least)
    if not len(frames):
        return []
    before, after = rotations[frames, joints], rotations[frames + span + 1, joints]
    around = np.zeros(len(frames), steps.dtype)
    for near in range(1, NEIGHBOURS + 1):
        around = np.maximum(around, _step_at(steps, frames - near, joints))
        around = np.maximum(around, _step_at(steps, frames + span + near, joints))
    around = np.maximum(around, _angle(before, after) / (span + 1))
    jump = jump[frames, joints]
    away = np.stack(
        [
            quat_angle(
                rotations[frames + i, joints],
                quat_slerp(before, after, np.full_like(jump, i / (span + 1))),
            )
            for i in range(1, span + 1)
        ]
    ).min(axis=0)
    found = (jump > ratio * np.maximum(around, math.radians(1.0))) & (away > 0.7 * jump)
    return [(int(t) + 1, int(j)) for t, j in zip(frames[found], joints[found], strict=True)]


def _step_at(steps: Array, frames: Array, joints: Array) -> Array:
    """Steps at these frames and joints; zero beyond the ends."""
    inside = (frames >= 0) & (frames < len(steps))
    return np.where(inside, steps[np.clip(frames, 0, len(steps) - 1), joints], np.float32(0.0))


def _mend_flips(motion: Motion, limbs: Sequence[Limb]) -> tuple[Motion, list[tuple[int, str]]]:
    """Repair flipped knees and elbows; returns the motion and the repaired frames and upper joints.

    The limb is rotated about the line from its first to its last joint, which both stay in place, to the
    interpolation between the good frames around it; the end joint is interpolated too.
    """
    rotations = motion.local_rotations.copy()
    mended: list[tuple[int, str]] = []
    for upper, middle, end in limbs:
        for first, last in _flipped_spans(rotations[:, upper], rotations[:, end], motion.fps):
            span, count = slice(first, last + 1), last + 1 - first
            wanted = _bridge(rotations[first - 1, upper], rotations[last + 1, upper], count)
            reach = motion.skeleton.offsets[middle] + quat_rotate(
                rotations[span, middle], motion.skeleton.offsets[end]
            )
            line = normalized(quat_rotate(rotations[span, upper], reach))
            swing = _twist(quat_multiply(wanted, quat_inverse(rotations[span, upper])), line)
            rotations[span, upper] = quat_multiply(swing, rotations[span, upper])
            rotations[span, end] = _bridge(rotations[first - 1, end], rotations[last + 1, end], count)
            mended.extend((frame, motion.skeleton.names[upper]) for frame in range(first, last + 1))
    if not mended:
        return motion, []
    return replace(motion, local_rotations=quat_continuous(rotations)), mended


def _flipped_spans(upper: Array, end: Array, fps: float) -> list[tuple[int, int]]:
    """First and last frame of every short span in which a limb (T, 4), (T, 4) is on the wrong side."""
    jumps = (_angle(upper[:-1], upper[1:]) > FLIP_JUMP) & (_angle(end[:-1], end[1:]) > FLIP_JUMP)
    events = np.flatnonzero(jumps).tolist()
    spans: list[tuple[int, int]] = []
    for away, back in pairwise(events):
        taken = bool(spans) and away < spans[-1][1] + 1
        if taken or back - away > FLIP_SECONDS * fps:
            continue
        ends_apart = float(_angle(upper[away], upper[back + 1]))
        jump = float(_angle(upper[away], upper[away + 1]))
        if ends_apart < FLIP_TURN * min(1.0, jump / FLIP_FULL):
            spans.append((away + 1, back))
    return spans


def _bridge(before: Array, after: Array, count: int) -> Array:
    """Rotations (count, 4) interpolated evenly between two (4,)."""
    fractions = np.arange(1, count + 1, dtype=before.dtype) / (count + 1)
    return quat_slerp(np.broadcast_to(before, (count, 4)), np.broadcast_to(after, (count, 4)), fractions)


def _twist(rotations: Array, axes: Array) -> Array:
    """The part (..., 4) of rotations (..., 4) that turns about unit axes (..., 3)."""
    along = (rotations[..., 1:] * axes).sum(axis=-1, keepdims=True)
    part = np.concatenate([rotations[..., :1], along * axes], axis=-1)
    # Half a turn about a perpendicular axis has no such part; use the identity.
    none = np.linalg.norm(part, axis=-1, keepdims=True) < 1e-6
    return quat_normalize(np.where(none, quat_identity(dtype=part.dtype), part))


def _root_pops(places: Array) -> list[int]:
    """Frames whose place (T, 3) deviates from the line of its neighbours far more than nearby frames do."""
    if len(places) < 2 * NEIGHBOURS:
        return []
    residual = np.zeros(len(places), places.dtype)
    residual[1:-1] = np.linalg.norm(places[1:-1] - 0.5 * (places[:-2] + places[2:]), axis=-1)
    found = []
    for frame in np.flatnonzero(residual > ROOT_POP).tolist():
        # A pop shows at half its size in its two neighbours, so they do not count as nearby.
        nearby = np.concatenate(
            [residual[max(0, frame - 6) : max(0, frame - 1)], residual[frame + 2 : frame + 7]]
        )
        # A jump without a return gives two equal residuals side by side.
        beside = max(float(residual[frame - 1]), float(residual[frame + 1]))
        level = max(0.1, float(nearby.max())) if len(nearby) else math.inf
        if residual[frame] > max(1.4 * beside, ROOT_POP_RATIO * level):
            found.append(frame)
    return found


def _jumps_left(motion: Motion, start: int) -> tuple[str, ...]:
    """Notes on jumps without a return, which cannot be interpolated."""
    if len(motion) < 3:
        return ()
    angles, _ = _steps(motion)
    frames, joints = np.nonzero(angles > max(1.0, 60.0 / motion.fps) * JUMP_LEFT)
    told = tuple(
        f"jump of {math.degrees(float(angles[t, j])):.0f} degrees left in {JOINT_NAMES[j]} "
        f"at frame {int(t) + 1 + start}"
        for t, j in zip(frames[:MOST_JUMPS_TOLD].tolist(), joints[:MOST_JUMPS_TOLD].tolist(), strict=True)
    )
    more = len(frames) - len(told)
    return (*told, f"{more} more jumps left") if more else told


def floor_shift(motion: Motion) -> tuple[float, tuple[str, ...]]:
    """cm to add to the root height so that standing toes are at TOE_HEIGHT, and notes."""
    legs = max(TOES) + 1  # hips and legs come first
    skeleton = motion.skeleton
    _, positions = forward_kinematics(
        motion.local_rotations[:, :legs],
        motion.root_positions,
        skeleton.offsets[:legs],
        skeleton.parents[:legs],
    )
    toes = positions[:, list(TOES)]
    heights = toes[..., 1]
    slow = heights[standing_toes(toes, motion.fps)]
    if len(slow) < 5:
        lowest = float(np.quantile(heights, 0.02))
        return TOE_HEIGHT - lowest, ("no stance found; floor set from the lowest toe",)
    return TOE_HEIGHT - _lowest_band(slow), ()


def standing_toes(toes: Array, fps: float) -> Array:
    """Flags (T, ...): whether toes (T, ..., 3), in cm, stand still."""
    still: Array = _speeds(toes, fps) < STANCE_SPEED
    return still


def _speeds(places: Array, fps: float) -> Array:
    """Speeds (T, ...) in cm/s of places (T, ..., 3), by central differences where possible."""
    if len(places) < 2:
        return np.zeros(places.shape[:-1], places.dtype)
    steps = (places[1:] - places[:-1]) * fps
    both = 0.5 * (steps[1:] + steps[:-1])
    return np.linalg.norm(np.concatenate([steps[:1], both, steps[-1:]]), axis=-1)


def _lowest_band(heights: Array) -> float:
    """Median of heights (N,) within the lowest band that is nearly as full as the fullest band.

    Feet held still in the air (a raised leg, a handstand) are above it, stray frames below it. If many heights are a
    whole step lower, the band was a platform, and the lower ones are the floor.
    """
    ordered = np.sort(heights)
    counts = np.searchsorted(ordered, ordered + STANCE_BAND, side="right") - np.arange(len(ordered))
    first = int(np.flatnonzero(counts >= STANCE_SHARE * counts.max())[0])
    below = ordered[ordered < ordered[first] - STEP_DOWN]
    if len(below) >= max(5, STEP_SHARE * len(heights)):
        return _lowest_band(below)
    return float(lower_median(ordered[first : first + int(counts[first])]))
