"""Repairs capture artefacts: T-poses at the ends, pops, flipped limbs and feet, and wrong floor heights.

A pop is a joint or root that jumps away for a few frames and returns. Every detector compares a frame with its
neighbours. Kicks, flips and cartwheels are fast for many frames in a row, so they pass unchanged. At leaps
clips are cut. docs/dataset.md has the measurements behind the constants.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array, lower_median, normalized
from motionkit.motion.ankles import repair_ankles
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

# Upper, middle and end joint of a leg or arm. In a flipped leg, hip and ankle stay in place, but knee and toes point
# to the other side for some frames.
Limb = tuple[int, int, int]
LIMBS: tuple[Limb, ...] = tuple(
    (JOINT_NAMES.index(side + upper), JOINT_NAMES.index(side + middle), JOINT_NAMES.index(side + end))
    for side in ("Left", "Right")
    for upper, middle, end in (("UpLeg", "Leg", "Foot"), ("Arm", "ForeArm", "Hand"))
)


@dataclass(frozen=True)
class Breaks:
    """Thresholds for cutting frames off the ends of a clip: frozen frames, T-poses, and breaks.

    A break is one step from frame to frame that is far larger than the steps after it. Angles are in radians, distances
    in cm, for steps at 60 fps; they grow at lower rates.
    """

    # Seconds from the ends within which breaks of the whole body, and of single joints, are searched. T-poses and the
    # blends out of them last up to half a second. Larger values cut motion that begins fast.
    window_seconds: float = 0.5
    edge_seconds: float = 0.1
    # Mean angle to the rest pose below which the first frame is a T-pose. Measured: T-poses have 4.8 to 6.7 degrees,
    # real motion at least 11.5.
    rest_angle: float = math.radians(10.0)
    # A blend out of a T-pose ends where a step falls below this multiple of the later median step. Smaller values cut
    # more of a calm beginning.
    blend_ratio: float = 2.0
    # Steps below which a body is frozen. Larger values would count a body that only breathes.
    frozen_angle: float = math.radians(0.01)
    frozen_distance: float = 1e-3
    # Smallest step of a break: mean over all joints, root, single joint. Measured on 76 clips labelled as badly
    # begun: all are found, with one false alarm. Smaller values cut fast starts.
    body: float = math.radians(6.0)
    root: float = 8.0
    joint: float = math.radians(30.0)
    # A break is this many times larger than each of the next `look_ahead` steps. Smaller values cut kicks.
    ratio: float = 3.5
    look_ahead: int = 8
    held: int = 2  # most frames at an end in which a joint is held where nothing is cut


@dataclass(frozen=True)
class Pops:
    """Thresholds for pops: a joint or the root jumps away and back, and is interpolated. Angles are in radians.

    Measured on CMU clips (docs/dataset.md): a single frame that is off by 8 degrees is never real, and the fastest
    steps of kicks and flips have fast neighbours. Smaller values would flatten kicks, larger ones leave glitches.
    """

    jump: float = math.radians(8.0)  # smallest jump away and back, for pops of one or two frames
    ratio: float = 3.0  # smallest ratio of the jump to the steps around it, and to those after interpolation
    # The same for longer pops, which look more like real motion.
    long_jump: float = math.radians(30.0)
    long_ratio: float = 4.0
    long_seconds: float = 0.034  # longest pop: 4 frames at 120 fps; at 30 fps toes of a run roll in 2 frames
    neighbours: int = 4  # steps before and after that are compared with the jump
    away: float = 0.7  # share of the jump by which each frame of a pop is off the interpolation
    root_jump: float = 1.2  # smallest distance in cm of the root from the middle of its neighbours
    root_ratio: float = 4.0  # smallest ratio of this distance to the largest one in frames nearby


@dataclass(frozen=True)
class Flips:
    """Thresholds for knees and elbows on the wrong side. Measured on 24 flips of CMU subject 05 (docs/dataset.md)."""

    jump: float = math.radians(40.0)  # smallest jump of upper and end joint; smaller values count fast swings
    seconds: float = 0.25  # longest flip; a longer one may be real
    # Largest difference between the good frames around a flip, as a share of the jump. With larger values, a real turn
    # with a pause would be undone.
    back: float = 0.5


BREAKS, POPS, FLIPS = Breaks(), Pops(), Flips()
JUMP_LEFT = math.radians(60.0)  # a remaining step above this gets a note; 15 of 248 CMU clips have one
MOST_JUMPS_LISTED = 20  # notes per clip


@dataclass(frozen=True)
class CleaningReport:
    """Changes made to one motion.

    Attributes:
        lead_in: frames cut at the start (T-pose, the blend out of it, bad first frames).
        pops: (source frame, joint) of every repaired frame; "root position" for the root's position.
            A flipped limb is listed under its thigh or upper arm.
        notes: artefacts that were found but not repaired.
    """

    lead_in: int
    lead_out: int
    pops: tuple[tuple[int, str], ...]
    floor_shift: float
    notes: tuple[str, ...]


def clean(motion: Motion) -> tuple[Motion, CleaningReport]:
    """Return the repaired motion of the 23 canonical joints, in cm, at its own frame rate, and a report.

    At least two frames are kept. In a motion of one or two frames, only the floor height is corrected.
    """
    cut, pops = repair(motion)  # first, so that a pop near an end is not taken for a break
    start, end = _good_span(cut)
    if end - start < len(motion):
        cut, pops = repair(motion.cut(start, end))
    shift, floor_notes = floor_shift(cut)
    notes = floor_notes + _jumps_left(cut, start)
    up = np.array([0.0, shift, 0.0], cut.root_positions.dtype)
    report = CleaningReport(
        start, len(motion) - end, tuple(sorted({(t + start, name) for t, name in pops})), shift, notes
    )
    return replace(cut, root_positions=cut.root_positions + up), report


def repair(
    motion: Motion,
    limbs: Sequence[Limb] = LIMBS,
    repair_feet: Callable[[Motion], tuple[Motion, list[tuple[int, str]]]] = repair_ankles,
) -> tuple[Motion, list[tuple[int, str]]]:
    """The motion of any rig in cm, Y up, without flips, pops and feet out of range, and the repaired frames and joints.

    Args:
        motion: T frames.
        limbs: upper, middle and end joint of each leg and arm; those of the canonical skeleton by default.
        repair_feet: repairs feet beyond the range of the ankle; those of the canonical skeleton by default. They come
            last, because the jumps of a foot tell a flipped leg.
    """
    unflipped, flips = _repair_flips(motion, limbs)
    repaired, pops = _repair_pops(unflipped)
    in_range, feet = repair_feet(repaired)
    return in_range, flips + pops + feet


def hold_ends(motion: Motion) -> tuple[Motion, list[tuple[int, str]]]:
    """The motion with joints held that leap in its first or last frames, and these frames and joints.

    clean cuts such frames off; here the clip keeps its length.
    """
    if len(motion) < BREAKS.look_ahead:
        return motion, []
    rotations, names = motion.local_rotations.copy(), motion.skeleton.names
    held: list[tuple[int, str]] = []
    for step in (1, -1):
        inwards = rotations[::step]  # a view
        breaks = _breaks(
            _angle(inwards[:-1], inwards[1:]), max(1.0, 60.0 / motion.fps) * BREAKS.joint, BREAKS.held
        )
        for joint in np.flatnonzero(breaks.any(axis=0)).tolist():
            count = _last_true(breaks[:, joint])
            inwards[:count, joint] = inwards[count, joint]
            frames = range(count) if step > 0 else range(len(motion) - count, len(motion))
            held += [(frame, names[joint]) for frame in frames]
    return (replace(motion, local_rotations=quat_continuous(rotations)), held) if held else (motion, [])


def _steps(motion: Motion) -> tuple[Array, Array]:
    """Angles (T - 1, J) between frames in radians, and root distances (T - 1) in cm."""
    rotations, places = motion.local_rotations, motion.root_positions
    return _angle(rotations[:-1], rotations[1:]), np.linalg.norm(places[1:] - places[:-1], axis=-1)


def _angle(a: Array, b: Array) -> Array:
    """Angles (...) between rotations (..., 4), from their chord, which is fast and exact for small angles too."""
    same = (a * b).sum(axis=-1, keepdims=True) >= 0
    squared = (np.where(same, a - b, a + b) ** 2).sum(axis=-1)
    return 4.0 * np.arcsin(np.minimum(0.5 * np.sqrt(squared), 1.0))


def _good_span(motion: Motion) -> tuple[int, int]:
    """First frame to keep, and the end (exclusive)."""
    if len(motion) < 3:
        return 0, len(motion)
    angles, distances = _steps(motion)
    start = max(_bad_start(angles, distances, motion.fps), _rest_pose_blend(motion, angles))
    end = len(motion) - _tail(np.flip(angles, 0), np.flip(distances, 0), motion.fps)
    return (start, end) if end - start >= 2 else (0, len(motion))


def _bad_start(angles: Array, distances: Array, fps: float) -> int:
    """Number of frames to cut at the start, from the steps (T - 1, J) and (T - 1)."""
    half = len(angles) // 2
    edge = min(max(3, round(BREAKS.edge_seconds * fps)), half)
    window = min(round(BREAKS.window_seconds * fps), half)
    coarse = max(1.0, 60.0 / fps)  # a step covers more time at a lower rate
    body = angles.mean(axis=1)
    bad = max(
        _last_true(_breaks(body, coarse * BREAKS.body, window)),
        _last_true(_breaks(distances, coarse * BREAKS.root, window)),
        _edge_breaks(angles, edge, coarse),
    )
    return bad + _frozen(angles[bad:], distances[bad:])


def _rest_pose_blend(motion: Motion, angles: Array) -> int:
    """Number of frames that blend out of the rest pose, from the steps (T - 1, J); 0 if there is no blend."""
    first = motion.local_rotations[0, 1:]
    if float(_angle(first, quat_identity((1,), first.dtype)).mean()) > BREAKS.rest_angle:
        return 0
    body = angles.mean(axis=1)
    later = body[
        round(BREAKS.edge_seconds * motion.fps) : round(
            (BREAKS.edge_seconds + BREAKS.window_seconds) * motion.fps
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
    root = _breaks(distances, coarse * BREAKS.root, edge)
    tail = max(_last_true(root), _edge_breaks(angles, edge, coarse))
    return tail + _frozen(angles[tail:], distances[tail:])


def _edge_breaks(angles: Array, edge: int, coarse: float) -> int:
    """Number of frames before the last break of a single joint within the first steps (T - 1, J)."""
    joints = _breaks(angles, coarse * BREAKS.joint, edge)
    joints[2:, list(TOES)] = False  # toes jitter, so only the two outermost steps count
    return _last_true(np.asarray(joints.any(axis=1)))


def _breaks(steps: Array, least: float, window: int) -> Array:
    """Flags (window, ...): whether each of the first steps far exceeds the BREAKS.look_ahead steps after it."""
    ahead = np.concatenate([steps, np.broadcast_to(steps[-1:], (BREAKS.look_ahead, *steps.shape[1:]))])
    following = sliding_window_view(ahead[1:], BREAKS.look_ahead, axis=0)[:window].max(axis=-1)
    return (steps[:window] > least) & (steps[:window] > BREAKS.ratio * following)


def _frozen(angles: Array, distances: Array) -> int:
    """Number of steps at the start without movement; 0 if the whole motion has none."""
    still = (angles.max(axis=1) < BREAKS.frozen_angle) & (distances < BREAKS.frozen_distance)
    moving = np.flatnonzero(~still)
    return int(moving[0]) if len(moving) else 0


def _last_true(flags: Array) -> int:
    """Index after the last true flag; 0 without one."""
    found = np.flatnonzero(flags)
    return int(found[-1]) + 1 if len(found) else 0


def _repair_pops(motion: Motion) -> tuple[Motion, list[tuple[int, str]]]:
    """The motion with its pops interpolated, and their frames and joints."""
    rotations, places = motion.local_rotations.copy(), motion.root_positions.copy()
    # In frames: at a low rate, toes that roll off in a run are away for two frames.
    longest = max(1, round(POPS.long_seconds * motion.fps))
    coarse = max(1.0, 60.0 / motion.fps)
    steps = _angle(rotations[:-1], rotations[1:])
    repaired: list[tuple[int, str]] = []
    for span in range(1, min(longest, len(motion) - 2) + 1):
        pops = _joint_pops(rotations, steps, span, coarse)
        for frame, joint in pops:
            rotations[frame : frame + span, joint] = _bridge(
                rotations[frame - 1, joint], rotations[frame + span, joint], span
            )
            repaired.extend((frame + i, motion.skeleton.names[joint]) for i in range(span))
        if pops:
            steps = _angle(rotations[:-1], rotations[1:])
    for frame in _root_pops(places):
        places[frame] = 0.5 * (places[frame - 1] + places[frame + 1])
        repaired.append((frame, "root position"))
    if not repaired:
        return motion, []
    out = replace(motion, local_rotations=quat_continuous(rotations), root_positions=places)
    return out, sorted(set(repaired))


def _joint_pops(rotations: Array, steps: Array, span: int, coarse: float) -> list[tuple[int, int]]:
    """First frame and joint of every pop of `span` frames in rotations (T, J, 4) with steps (T - 1, J).

    The steps away and back must far exceed the steps around them and the steps left after interpolation. A fast swing
    fails this test, because its neighbours are fast too. coarse scales the smallest jump for lower frame rates.
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


def _repair_flips(motion: Motion, limbs: Sequence[Limb]) -> tuple[Motion, list[tuple[int, str]]]:
    """Repair flipped knees and elbows; returns the motion and the repaired frames and upper joints.

    The limb turns about the line from its upper to its end joint, which both stay in place. The angle comes from
    interpolating the upper joint between the good frames around. The end joint's rotation is interpolated too.
    """
    rotations = motion.local_rotations.copy()
    repaired: list[tuple[int, str]] = []
    for upper, middle, end in limbs:
        for first, last in _flipped_spans(rotations[:, upper], rotations[:, end], motion.fps):
            span, count = slice(first, last + 1), last + 1 - first
            target = _bridge(rotations[first - 1, upper], rotations[last + 1, upper], count)
            reach = motion.skeleton.offsets[middle] + quat_rotate(
                rotations[span, middle], motion.skeleton.offsets[end]
            )
            line = normalized(quat_rotate(rotations[span, upper], reach))
            swing = _twist(quat_multiply(target, quat_inverse(rotations[span, upper])), line)
            rotations[span, upper] = quat_multiply(swing, rotations[span, upper])
            rotations[span, end] = _bridge(rotations[first - 1, end], rotations[last + 1, end], count)
            repaired.extend((frame, motion.skeleton.names[upper]) for frame in range(first, last + 1))
    if not repaired:
        return motion, []
    return replace(motion, local_rotations=quat_continuous(rotations)), repaired


def _flipped_spans(upper: Array, end: Array, fps: float) -> list[tuple[int, int]]:
    """First and last frame of each flip of a limb, from the rotations (T, 4) of its upper and end joint."""
    jumps = (_angle(upper[:-1], upper[1:]) > FLIPS.jump) & (_angle(end[:-1], end[1:]) > FLIPS.jump)
    events = np.flatnonzero(jumps).tolist()
    spans: list[tuple[int, int]] = []
    for away, back in pairwise(events):
        overlaps = bool(spans) and away < spans[-1][1] + 1
        if overlaps or back - away > FLIPS.seconds * fps:
            continue
        ends_apart = float(_angle(upper[away], upper[back + 1]))
        jump = float(_angle(upper[away], upper[away + 1]))
        if ends_apart < FLIPS.back * jump:
            spans.append((away + 1, back))
    return spans


def _bridge(before: Array, after: Array, count: int) -> Array:
    """Rotations (count, 4) at even steps between two rotations (4,)."""
    fractions = np.arange(1, count + 1, dtype=before.dtype) / (count + 1)
    return quat_slerp(np.broadcast_to(before, (count, 4)), np.broadcast_to(after, (count, 4)), fractions)


def _twist(rotations: Array, axes: Array) -> Array:
    """The twist (..., 4) of rotations (..., 4) about unit axes (..., 3)."""
    along = (rotations[..., 1:] * axes).sum(axis=-1, keepdims=True)
    part = np.concatenate([rotations[..., :1], along * axes], axis=-1)
    # Half a turn about a perpendicular axis has no defined twist; use the identity.
    none = np.linalg.norm(part, axis=-1, keepdims=True) < 1e-6
    return quat_normalize(np.where(none, quat_identity(dtype=part.dtype), part))


def _root_pops(places: Array) -> list[int]:
    """Frames whose position (T, 3) is much further from the middle of its neighbours than in frames nearby."""
    if len(places) < 2 * POPS.neighbours:
        return []
    residual = np.zeros(len(places), places.dtype)
    residual[1:-1] = np.linalg.norm(places[1:-1] - 0.5 * (places[:-2] + places[2:]), axis=-1)
    found = []
    for frame in np.flatnonzero(residual > POPS.root_jump).tolist():
        # The two neighbours of a pop show half its size, so they are left out.
        nearby = np.concatenate(
            [residual[max(0, frame - 6) : max(0, frame - 1)], residual[frame + 2 : frame + 7]]
        )
        # A jump without return gives two equal residuals side by side.
        beside = max(float(residual[frame - 1]), float(residual[frame + 1]))
        level = max(0.1, float(nearby.max())) if len(nearby) else math.inf
        if residual[frame] > max(1.4 * beside, POPS.root_ratio * level):
            found.append(frame)
    return found


def _jumps_left(motion: Motion, start: int) -> tuple[str, ...]:
    """Notes on jumps without return, which interpolation cannot repair."""
    if len(motion) < 3:
        return ()
    angles, _ = _steps(motion)
    frames, joints = np.nonzero(angles > max(1.0, 60.0 / motion.fps) * JUMP_LEFT)
    listed = tuple(
        f"jump of {math.degrees(float(angles[t, j])):.0f} degrees left in {JOINT_NAMES[j]} "
        f"at frame {int(t) + 1 + start}"
        for t, j in zip(frames[:MOST_JUMPS_LISTED].tolist(), joints[:MOST_JUMPS_LISTED].tolist(), strict=True)
    )
    more = len(frames) - len(listed)
    return (*listed, f"{more} more jumps left") if more else listed


# ---- leaps: a joint jumps and does not return, which cannot be repaired ----

# A joint leaps if its step relative to the root at 60 fps, or that of the root itself, exceeds LEAP_DISTANCE (cm), and
# LEAP_RATIO times the median of the steps around it. The fastest feet in CMU flips move 16 to 23 cm per frame.
LEAP_DISTANCE = 25.0
LEAP_RATIO = 2.2
# cm per frame of the root (600 m/s); a larger step is a leap whatever is around it: it would dominate the scaling of
# the features.
ROOT_LEAP = 1000.0
_REACH = 4  # steps on each side of a step; the nearest one is left out of the comparison


def find_leaps(global_positions: Array) -> list[int]:
    """Frames t that follow a leap: between t - 1 and t the root jumps, or a joint relative to the root.

    Positions are (T, 23, 3) in cm at 60 fps.
    """
    relative = global_positions - global_positions[:, :1]
    relative[:, 0] = global_positions[:, 0]
    steps = np.linalg.norm(np.diff(relative, axis=0), axis=-1)  # step t leads from frame t to t + 1
    if len(steps) < 2 * _REACH + 1:
        return []
    padded = np.pad(steps, ((_REACH, _REACH), (0, 0)), mode="edge")
    windows = sliding_window_view(padded, 2 * _REACH + 1, axis=0)
    around = lower_median(np.concatenate([windows[..., : _REACH - 1], windows[..., _REACH + 2 :]], -1), -1)
    leaps = (steps > LEAP_DISTANCE) & (steps > LEAP_RATIO * around)
    lost = steps[:, 0] > ROOT_LEAP
    return (np.flatnonzero(leaps.any(axis=-1) | lost) + 1).tolist()


def cut_at_leaps(start: int, end: int, leaps: list[int]) -> list[tuple[int, int]]:
    """The stretches between leaps of frames start to end (exclusive), without the frames next to a leap."""
    out = []
    for leap in sorted(leaps):
        if start <= leap <= end:
            out.append((start, min(end, leap - 1)))
            start = leap + 1
    out.append((start, end))
    return [(a, b) for a, b in out if b - a >= 2]
