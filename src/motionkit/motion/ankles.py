"""The range of the ankle, and feet beyond it: rolled over about their own length, or bent back.

Optical capture exchanges or loses the markers of a foot, above all in flips. Then the ankle turns over, often for the
rest of the clip, while the toe joint stays nearly in place. docs/dataset.md has the measurements.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, normalized, spans
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    quat_about,
    quat_continuous,
    quat_multiply,
    quat_rotate,
    quat_slerp,
)
from motionkit.motion.skeleton import JOINT_NAMES

Foot = tuple[int, int]  # ankle and toe joint
FEET = tuple(
    (JOINT_NAMES.index(f"{side}Foot"), JOINT_NAMES.index(f"{side}ToeBase")) for side in ("Left", "Right")
)


@dataclass(frozen=True)
class Ankles:
    """How far the line from ankle to toes rolls and bends from the rest pose. Angles are in radians.

    Of 381,000 feet in CMU clips 99.6 % roll by less than 30 degrees, and .4 % by more than 140; 214 lie between.
    """

    # A recorded foot that rolls by `roll` is turned over if it rolls by `turned` in the same stretch: retargeted feet
    # of good captures roll by up to 126 degrees.
    roll: float = math.radians(90.0)
    turned: float = math.radians(140.0)
    # A drawn foot rolls less and less beyond the first angle, and not at all beyond the second. Retargeted feet of some
    # rigs roll by 35 degrees on average, which a model of theirs learns.
    usual_roll: float = math.radians(60.0)
    most_roll: float = math.radians(120.0)
    usual_bend: float = math.radians(80.0)  # pointed feet of dancers bend by 80 to 95
    bend: float = math.radians(98.0)  # a foot that bends further is bent back
    seconds: float = 0.25  # longest stretch that is bridged; what happens in a longer one is not known
    margin: float = 0.08  # s before and after it that are bridged too: there the foot is on its way


ANKLES = Ankles()


def repair_ankles(
    motion: Motion, canonical: Motion | None = None, feet: Sequence[Foot | None] = FEET
) -> tuple[Motion, list[tuple[int, str]]]:
    """A recorded motion with feet turned back that are beyond the range of the ankle.

    A foot that is turned over turns back by half a turn about its length. One that is bent back for up to 0.25 s is
    interpolated.

    Args:
        motion: T frames of any rig.
        canonical: the same frames on the canonical joints, by default the motion itself. Its rest pose is known.
        feet: ankle and toe joint of the left and right foot of the motion; None for one that is left as it is.

    Returns:
        The motion, and the repaired frames and joints.
    """
    known = canonical or motion
    rotations = motion.local_rotations.copy()
    repaired: list[tuple[int, str]] = []
    for foot, (ankle, toe) in zip(feet, FEET, strict=True):
        if foot is None:
            continue
        roll, bend = _angles(known.local_rotations[:, ankle], normalized(known.skeleton.offsets[toe]))
        over = _turned_over(roll)
        half_turn = np.concatenate([[0.0], normalized(motion.skeleton.offsets[foot[1]])])
        rotations[over, foot[0]] = quat_multiply(rotations[over, foot[0]], half_turn)
        roll = np.where(over, roll - math.pi * np.sign(roll), roll)
        for first, end in _bent_spans(roll, bend, motion.fps):
            rotations[first:end, foot[0]] = _bridge(rotations[:, foot[0]], first, end)
            over[first:end] = True
        repaired += [(frame, motion.skeleton.names[foot[0]]) for frame in np.flatnonzero(over).tolist()]
    if not repaired:
        return motion, []
    return replace(motion, local_rotations=quat_continuous(rotations)), repaired


def ankles_in_range(motion: Motion) -> Motion:
    """A drawn motion (T frames on the canonical joints) whose feet stay within the range of the ankle.

    A network that has learnt from feet that were turned over draws all angles on the way there. Feet that are bent
    back are interpolated as in repair_ankles; then those that are rolled over roll back.
    """
    rotations = motion.local_rotations.copy()
    for ankle, toe in FEET:
        length = normalized(motion.skeleton.offsets[toe])
        for first, end in _bent_spans(*_angles(rotations[:, ankle], length), motion.fps):
            rotations[first:end, ankle] = _bridge(rotations[:, ankle], first, end)
        rotations[:, ankle] = rolled_back(rotations[:, ankle], length)
    if np.array_equal(rotations, motion.local_rotations):
        return motion
    return replace(motion, local_rotations=quat_continuous(rotations))


def rolled_back(turns: Array, length: Array) -> Array:
    """Rotations (T, 4) of feet of which those that are rolled over are rolled back about the unit vector length (3,).

    It needs no other frames; roll_back of inference/foot_kernel.c does the same.
    """
    roll, _ = _angles(turns, length)
    size = np.abs(roll)
    left = (
        np.clip((ANKLES.most_roll - size) / (ANKLES.most_roll - ANKLES.usual_roll), 0.0, 1.0)
        * ANKLES.usual_roll
    )
    turned = quat_multiply(turns, quat_about(length, np.sign(roll) * (left - size)).astype(turns.dtype))
    return np.where((size > ANKLES.usual_roll)[:, None], turned, turns)


def _bridge(turns: Array, first: int, end: int) -> Array:
    """Rotations (N, 4) at even steps between turns (T, 4) before frame `first` and in frame `end`."""
    ends = np.broadcast_to(turns[[first - 1, end], None], (2, end - first, 4))
    return quat_slerp(ends[0], ends[1], np.arange(1, end - first + 1) / (end - first + 1))


def _angles(turns: Array, length: Array) -> tuple[Array, Array]:
    """Roll (T,) of a foot about its length, -pi to pi, and the angle (T,) by which the length bends.

    turns are its rotations (T, 4) from the rest pose, length is the unit vector (3,) from ankle to toe.
    """
    roll = 2.0 * np.arctan2(turns[:, 1:] @ length, turns[:, 0])
    bend = np.arccos(
        np.clip(quat_rotate(turns, np.broadcast_to(length, (len(turns), 3))) @ length, -1.0, 1.0)
    )
    return (roll + math.pi) % (2.0 * math.pi) - math.pi, bend


def _turned_over(roll: Array) -> Array:
    """Flags (T,) of frames in which a foot with this roll (T,) is turned over."""
    over = np.abs(roll) > ANKLES.roll
    for first, end in spans(over):
        over[first:end] = np.abs(roll[first:end]).max() > ANKLES.turned
    return over


def _bent_spans(roll: Array, bend: Array, fps: float) -> list[tuple[int, int]]:
    """First frame and end (exclusive) of each stretch in which a foot is bent back, between frames of a sound foot."""
    off = (np.abs(roll) > ANKLES.usual_roll) | (bend > ANKLES.usual_bend)
    short = [span for span in spans(off) if span[1] - span[0] <= ANKLES.seconds * fps]
    wide = np.zeros_like(off)
    for first, end in short:
        if bend[first:end].max() > ANKLES.bend:
            wide[max(first - round(ANKLES.margin * fps), 0) : end + round(ANKLES.margin * fps)] = True
    return [(first, end) for first, end in spans(wide) if first > 0 and end < len(off)]
