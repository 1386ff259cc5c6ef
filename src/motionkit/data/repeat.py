"""Loops short recordings, such as one cycle of a walk, so that there is enough to learn from.

A recording shorter than a training window does not show how the motion continues, and reference poses look half a
second ahead. So its end is joined to its beginning, where the two are most alike. A recording of one step is half a
cycle; its end is joined to the beginning of its mirror image.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from motionkit.arrays import Array
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.data.splice import Piece, cut_piece, join_cost, join_pieces
from motionkit.features.encode import encode_motion
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_continuous

FEW_SECONDS = 2.5  # types with less motion in all are looped; with more, the joins do more harm than good
REPEATED_SECONDS = 10.0  # length of a looped recording
LEAST_FRAMES = 24  # shortest recording that can be looped; shorter ones show no cycle
LEAST_CYCLE = 0.5  # shortest cycle, as a share of the recording
LONGEST_DECAY = 20  # most frames over which the difference at a join decays
MIRROR_GAIN = 0.7  # the mirror image follows if its join costs less than this share of the other


def repeat_short_types(dataset: Dataset) -> tuple[str, ...]:
    """Replace the training recordings of types with little motion by looped ones, in memory; returns these types.

    Types with a phase are left alone, because a strike, jump or flip happens once.
    """
    stretches: dict[str, list[tuple[Clip, int, int]]] = defaultdict(list)
    # Frames by first row, so that a clip and its mirror image count once.
    recorded: dict[str, dict[int, int]] = defaultdict(dict)
    for clip, start, end, name in dataset.stretches():
        stretches[name].append((clip, start, end))
        recorded[name][clip.start + start] = end - start
    made: list[ClipData] = []
    bodies: list[int] = []
    replaced: set[Clip] = set()
    names = []
    for name, found in stretches.items():
        long_enough = [each for each in found if each[2] - each[1] >= LEAST_FRAMES]
        seconds = sum(recorded[name].values()) / dataset.fps
        if name in dataset.phase_seconds or seconds >= FEW_SECONDS or not long_enough:
            continue
        names.append(name)
        for clip, start, end in long_enough:
            made.append(repeat_stretch(dataset, clip, start, end))
            bodies.append(clip.body)
            if start == 0 and end == clip.frames:
                replaced.add(clip)
    if made:
        dataset.clips = tuple(clip for clip in dataset.clips if clip not in replaced)
        dataset.append((), made, {}, bodies)
    return tuple(names)


def repeat_stretch(dataset: Dataset, clip: Clip, start: int, end: int) -> ClipData:
    """A stretch of one type looped for REPEATED_SECONDS, alternating with its mirror image if that fits better."""
    kind = int(dataset.clip_types(clip)[start])
    piece = cut_piece(dataset, clip, start, end)
    i, j, cost = _best_cycle(piece, piece)
    cycle = [piece]
    if dataset.mirrored_type_ids[kind] == kind:
        mirrored = cut_piece(dataset, dataset.image(clip), start, end)
        other_i, other_j, other_cost = _best_cycle(piece, mirrored)
        if other_cost < MIRROR_GAIN * cost:
            i, j, cycle = other_i, other_j, [mirrored, piece]
    motion = _repeated(piece, cycle, i, j, round(REPEATED_SECONDS * dataset.fps))
    encoded = encode_motion(motion, dataset.reference_rotations, dataset.layout.version)
    kinds = np.full(len(motion), kind, np.int64)
    return ClipData.plain(encoded.features, encoded.contacts, encoded.ground, kinds)


def _best_cycle(a: Piece, b: Piece) -> tuple[int, int, float]:
    """The best join, as (i, j, cost): frame i of a is followed by frame j + 1 of b.

    A join costs more if its cycle leaves out much of the recording.
    """
    frames = len(a.motion)
    ends, starts = np.arange(frames // 2, frames - 1), np.arange(1, frames // 2)
    cost = join_cost(a, b, ends, starts)
    length = (ends[:, None] - starts) / frames
    cost = np.where(length < LEAST_CYCLE, np.inf, cost / np.maximum(length, LEAST_CYCLE))
    best = int(cost.argmin())
    return int(ends[best // len(starts)]), int(starts[best % len(starts)]), float(cost.flat[best])


def _repeated(first: Piece, cycle: list[Piece], i: int, j: int, frames: int) -> Motion:
    """Frames 0 to i of a piece, then frames j + 1 to i of each piece of the cycle in turn, joined end to end."""
    last = first.cut(i + 1)
    rotations, roots = [last.motion.local_rotations], [last.motion.root_positions]
    made = i + 1
    while made < frames:
        piece = cycle[(len(rotations) - 1) % len(cycle)]
        last = join_pieces(last, piece.cut(i + 1), len(last.motion) - 1, j, min(LONGEST_DECAY, i - j))
        rotations.append(last.motion.local_rotations)
        roots.append(last.motion.root_positions)
        made += len(last.motion)
    every: Array = quat_continuous(np.concatenate(rotations)[:frames])
    return Motion(first.motion.skeleton, every, np.concatenate(roots)[:frames], first.motion.fps)


def type_amounts(dataset: Dataset) -> dict[str, tuple[int, float]]:
    """Clips and seconds of training motion for each type; a mirror image counts where it is of another type."""
    size = len(dataset.types)
    recorded: dict[int, Array] = {}  # most frames of each type by first row, of a clip and its mirror image
    for clip in dataset.select("train"):
        frames = np.bincount(dataset.clip_types(clip), minlength=size)
        recorded[clip.start] = np.maximum(recorded.get(clip.start, 0), frames)
    all_frames = np.stack([np.zeros(size, np.int64), *recorded.values()])
    clips, seconds = (all_frames > 0).sum(axis=0), all_frames.sum(axis=0) / dataset.fps
    return dict(zip(dataset.types, zip(clips.tolist(), seconds.tolist(), strict=True), strict=True))


def small_types(dataset: Dataset) -> list[str]:
    """A warning for each type with no training clip, one clip, or only a few seconds."""
    lines, least = [], LEAST_FRAMES / dataset.fps
    longest: dict[str, float] = defaultdict(float)
    for _, start, end, kind in dataset.stretches():
        longest[kind] = max(longest[kind], (end - start) / dataset.fps)
    for kind, (clips, seconds) in type_amounts(dataset).items():
        if clips == 0:
            lines.append(f"{kind!r} has no training clip, only held-out ones; it cannot be learnt")
        elif longest[kind] < least:
            lines.append(
                f"{kind!r} has clips of at most {longest[kind]:.2g} s, expected at least {least:g} s to learn from"
            )
        elif seconds < FEW_SECONDS:
            lines.append(f"{kind!r} has {seconds:.1f} s of motion to learn from; give it more clips")
        elif clips == 1:
            lines.append(f"{kind!r} has one clip, which will be memorized; give it several")
    return lines
