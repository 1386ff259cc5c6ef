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
from motionkit.motion.floor import TOES, floor_shift
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_continuous,
    quat_identity,
    quat_inverse,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_slerp,
)
from motionkit.motion.skeleton import JOINT_NAMES

# Upper, middle and end joint of a leg or arm, which flips where hip and ankle stay, but knee and toes jump to the
# other side of the line between them and return some frames later.
Limb = tuple[int, int, int]
LIMBS: tuple[Limb, ...] = tuple(
    (JOINT_NAMES.index(side + upper), JOINT_NAMES.index(side + middle), JOINT_NAMES.index(side + end))
    for side in ("Left", "Right")
    for upper, middle, end in (("UpLeg", "Leg", "Foot"), ("Arm", "ForeArm", "Hand"))
)


@dataclass(frozen=True)
class Breaks:
    """When frames at an end are cut off: the body stands still, or leaps and does not go on as it leapt.

    Seconds, radians and cm; steps are those from frame to frame at 60 fps, and larger at a lower rate.
    """

    # How far from the ends leaps of the whole body and of single joints count. Chosen: T-poses and their blends are
    # within half a second, and what a joint does after a tenth is motion. Longer ones cut motion that begins fast.
    lead_seconds: float = 0.5
    edge_seconds: float = 0.1
    # Mean angle to the rest pose of a first frame that is a T-pose. Measured: these are at 4.8 to 6.7 degrees, no
    # frame of real motion is within 11.5.
    rest_angle: float = math.radians(10.0)
    # Blends out of a T-pose end where the step falls to so many times the median that follows. Chosen; with less,
    # more of the calm beginning goes.
    blend_ratio: float = 2.0
    # Steps below which a body is frozen. Chosen; with more, a body that only breathes would count.
    frozen_angle: float = math.radians(0.01)
    frozen_distance: float = 1e-3
    # Steps that may be leaps: all joints on average, the root, one joint near the ends. Measured on 76 clips that
    # labels say begin badly: all are found, and one besides. With less, fast starts are cut.
    body: float = math.radians(6.0)
    root: float = 8.0
    joint: float = math.radians(30.0)
    # A leap is so many times any of the next `look_ahead` steps. Measured likewise: with less, kicks are cut.
    ratio: float = 3.5
    look_ahead: int = 8


@dataclass(frozen=True)
class Pops:
    """When a joint, or the root's place, jumps away and back and is bridged. Radians, cm, seconds and ratios.

    Measured on CMU clips (docs/cleaning.md): single frames off by 8 degrees are no motion, kicks and flips have fast
    steps beside their fastest ones. Smaller jumps or ratios would flatten these, larger ones leave glitches.
    """

    jump: float = math.radians(8.0)  # least jump away and back, of one or two frames
    ratio: float = 3.0  # times the steps around, and the gap that bridging leaves
    # The same of longer pops, which motion comes nearer to.
    long_jump: float = math.radians(30.0)
    long_ratio: float = 4.0
    long_seconds: float = 0.034  # of the longest: four frames at 120 fps; toes roll in a run in two at 30
    neighbours: int = 4  # steps before and after that count as around
    away: float = 0.7  # of the jump, by which all frames of the pop are off the bridge
    root_jump: float = 1.2  # distance of the root from the line of its neighbours
    root_ratio: float = 4.0  # times the distances nearby


@dataclass(frozen=True)
class Flips:
    """When a knee or elbow is on the wrong side. Measured on CMU subject 05, 24 flips in 8 clips (docs/cleaning.md)."""

    jump: float = math.radians(40.0)  # of thigh and foot, away and back; with less, fast swings would count
    seconds: float = 0.25  # of the longest; what stays longer may be meant
    # Share of the jump that the good frames around may be apart: with more, turns that happen to pause are undone.
    back: float = 0.5


BREAKS, POPS, FLIPS = Breaks(), Pops(), Flips()
JUMP_LEFT = math.radians(60.0)  # a step that is noted, if it is left; 15 of 248 CMU clips have such
MOST_JUMPS_TOLD = 20


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
    """Angles (...) between rotations (..., 4), from the chord of the difference: exact for small ones too, and fast."""
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
    edge = min(max(3, round(BREAKS.edge_seconds * fps)), half)
    window = min(round(BREAKS.lead_seconds * fps), half)
    coarse = max(1.0, 60.0 / fps)  # real steps are larger at lower frame rates
    body = angles.mean(axis=1)
    lead = max(
        _last_true(_breaks(body, coarse * BREAKS.body, window)),
        _last_true(_breaks(distances, coarse * BREAKS.root, window)),
        _edge_breaks(angles, edge, coarse),
    )
    return lead + _frozen(angles[lead:], distances[lead:])


def _rest_pose_blend(motion: Motion, angles: Array) -> int:
    """Number of frames that blend out of the rest pose, from the steps (T - 1, J); 0 if there is no blend."""
    first = motion.local_rotations[0, 1:]
    if float(_angle(first, quat_identity((1,), first.dtype)).mean()) > BREAKS.rest_angle:
        return 0
    body = angles.mean(axis=1)
    later = body[
        round(BREAKS.edge_seconds * motion.fps) : round(
            (BREAKS.edge_seconds + BREAKS.lead_seconds) * motion.fps
        )
    ]
    if not len(later):
        return 0
    calm = np.flatnonzero(body <= BREAKS.blend_ratio * lower_median(later))
    return int(calm[0]) if len(calm) else 0


def _tail(angles: Array, distances: Array, fps: float) -> int:
    """Number of frames to cut at the end, from the steps in reverse order."""
    edge = min(max(3, round(BREAKS.edge_seconds * fps)), len(angles) // 2)
    coarse = max(1.0, 60.0 / fps)
    tail = max(_last_true(_breaks(distances, coarse * BREAKS.root, edge)), _edge_breaks(angles, edge, coarse))
    return tail + _frozen(angles[tail:], distances[tail:])


def _edge_breaks(angles: Array, edge: int, coarse: float) -> int:
    """Number of frames before the last break of a joint within the first steps (T - 1, J)."""
    joints = _breaks(angles, coarse * BREAKS.joint, edge)
    joints[2:, list(TOES)] = False  # toes jitter; cut only the outermost frames for them
    return _last_true(joints.any(axis=1))


def _breaks(steps: Array, least: float, window: int) -> Array:
    """Which of the first steps (window, ...) far exceed the BREAKS.look_ahead steps that follow."""
    ahead = np.concatenate([steps, np.broadcast_to(steps[-1:], (BREAKS.look_ahead, *steps.shape[1:]))])
    following = sliding_window_view(ahead[1:], BREAKS.look_ahead, axis=0)[:window].max(axis=-1)
    return (steps[:window] > least) & (steps[:window] > BREAKS.ratio * following)


def _frozen(angles: Array, distances: Array) -> int:
    """Number of steps at the start without any movement; 0 if nothing ever moves."""
    still = (angles.max(axis=1) < BREAKS.frozen_angle) & (distances < BREAKS.frozen_distance)
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
    longest = max(1, round(POPS.long_seconds * motion.fps))
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
    least, ratio = (POPS.jump, POPS.ratio) if span <= 2 else (POPS.long_jump, POPS.long_ratio)
    jump = np.minimum(steps[: len(steps) - span], steps[span:])
    frames, joints = np.nonzero(jump > coarse * least)
    if not len(frames):
        return []
    before, after = rotations[frames, joints], rotations[frames + span + 1, joints]
    around = np.zeros(len(frames), steps.dtype)
    for near in range(1, POPS.neighbours + 1):
        around = np.maximum(around, _step_at(steps, frames - near, joints))
        around = np.maximum(around, _step_at(steps, frames + span + near, joints))
    around = np.maximum(around, _angle(before, after) / (span + 1))
    jump = jump[frames, joints]
    away = np.stack(
        [
            _angle(
                rotations[frames + i, joints],
                quat_slerp(before, after, np.full_like(jump, i / (span + 1))),
            )
            for i in range(1, span + 1)
        ]
    ).min(axis=0)
    found = (jump > ratio * np.maximum(around, math.radians(1.0))) & (away > POPS.away * jump)
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
    jumps = (_angle(upper[:-1], upper[1:]) > FLIPS.jump) & (_angle(end[:-1], end[1:]) > FLIPS.jump)
    events = np.flatnonzero(jumps).tolist()
    spans: list[tuple[int, int]] = []
    for away, back in pairwise(events):
        taken = bool(spans) and away < spans[-1][1] + 1
        if taken or back - away > FLIPS.seconds * fps:
            continue
        ends_apart = float(_angle(upper[away], upper[back + 1]))
        jump = float(_angle(upper[away], upper[away + 1]))
        if ends_apart < FLIPS.back * jump:
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
    if len(places) < 2 * POPS.neighbours:
        return []
    residual = np.zeros(len(places), places.dtype)
    residual[1:-1] = np.linalg.norm(places[1:-1] - 0.5 * (places[:-2] + places[2:]), axis=-1)
    found = []
    for frame in np.flatnonzero(residual > POPS.root_jump).tolist():
        # A pop shows at half its size in its two neighbours, so they do not count as nearby.
        nearby = np.concatenate(
            [residual[max(0, frame - 6) : max(0, frame - 1)], residual[frame + 2 : frame + 7]]
        )
        # A jump without a return gives two equal residuals side by side.
        beside = max(float(residual[frame - 1]), float(residual[frame + 1]))
        level = max(0.1, float(nearby.max())) if len(nearby) else math.inf
        if residual[frame] > max(1.4 * beside, POPS.root_ratio * level):
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
