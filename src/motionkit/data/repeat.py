"""Types with a few seconds of recordings, such as one cycle of a walk, repeated so that there is enough to learn from.

A type is to go on for as long as it is asked for, and reference poses look half a second ahead. A recording shorter
than a training window shows neither. Its end is therefore joined to its beginning where the two are most alike, or to
that of its mirror image, because a single step is half a cycle.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.data.splice import Piece, cut_piece, join_cost, join_pieces
from motionkit.features.encode import encode_motion
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_continuous

FEW_SECONDS = 2.5  # types with less in all are repeated; of longer ones the joins do more harm than good
REPEATED_SECONDS = 10.0  # length of a repeated recording
LEAST_FRAMES = 24  # of a recording that can be repeated; shorter ones show no cycle
LEAST_CYCLE = 0.5  # share of the recording that a cycle has at least
LONGEST_DECAY = 20  # frames over which the difference at a join decays
MIRROR_GAIN = 0.7  # a mirror image follows where it fits so much better


def repeat_short_types(dataset: Dataset) -> tuple[str, ...]:
    """Replace the training recordings of types that have few by repeated ones, in memory.

    Strikes, jumps and performances have a phase and are left as they are: they happen once.

    Returns:
        The names of these types.
    """
    stretches: dict[int, list[tuple[Clip, int, int]]] = defaultdict(list)
    recorded: dict[int, dict[int, int]] = defaultdict(dict)  # frames by first row: a mirror image adds none
    for clip, start, end, kind in dataset.stretches():
        stretches[kind].append((clip, start, end))
        recorded[kind][clip.start + start] = end - start
    made: list[ClipData] = []
    bodies: list[int] = []
    replaced: set[Clip] = set()
    names = []
    for kind, found in stretches.items():
        name = dataset.types[kind]
        long_enough = [each for each in found if each[2] - each[1] >= LEAST_FRAMES]
        seconds = sum(recorded[kind].values()) / dataset.fps
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
    """A stretch of one type over and over for REPEATED_SECONDS, in turn with its mirror image if that fits better."""
    kind = int(dataset.clip_types(clip)[start])
    piece = cut_piece(dataset, clip, start, end)
    i, j, cost = _best_cycle(piece, piece)
    cycle = [piece]
    if dataset.mirrored_type_ids[kind] == kind:
        mirrored = cut_piece(dataset, replace(clip, mirrored=not clip.mirrored), start, end)
        other_i, other_j, other_cost = _best_cycle(piece, mirrored)
        if other_cost < MIRROR_GAIN * cost:
            i, j, cycle = other_i, other_j, [mirrored, piece]
    motion = _repeated(piece, cycle, i, j, round(REPEATED_SECONDS * dataset.fps))
    encoded = encode_motion(motion, dataset.reference_rotations, dataset.layout.version)
    kinds = np.full(len(motion), kind, np.int64)
    return ClipData.plain(encoded.features, encoded.contacts, encoded.ground, kinds)


def _best_cycle(a: Piece, b: Piece) -> tuple[int, int, float]:
    """The frame of a after which b goes on from the frame after j, and the cost of this join.

    A cycle that leaves out much of a recording costs more.
    """
    frames = len(a.motion)
    ends, starts = np.arange(frames // 2, frames - 1), np.arange(1, frames // 2)
    cost = join_cost(a, b, ends, starts)
    length = (ends[:, None] - starts) / frames
    cost = np.where(length < LEAST_CYCLE, np.inf, cost / np.maximum(length, LEAST_CYCLE))
    best = int(cost.argmin())
    return int(ends[best // len(starts)]), int(starts[best % len(starts)]), float(cost.flat[best])


def _repeated(first: Piece, cycle: list[Piece], i: int, j: int, frames: int) -> Motion:
    """Frames 0 to i of a piece, then j + 1 to i of those of a cycle in turn, each where the one before has ended."""
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
