"""Makes transitions that no recording contains, by joining the end of one clip to the start of another.

The clips are joined where their poses are closest. The second clip is moved and turned so that its root continues from
the first one's. The differences in pose and velocity at the join decay over the following frames (inertialization,
Bollo 2018). Foot locking keeps planted feet from sliding meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.features.encode import encode_motion
from motionkit.finish.feet import contacts_around, lock_feet
from motionkit.motion.inertialize import continued, decay_curves
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import (
    expmap_to_quat,
    quat_continuous,
    quat_from_yaw,
    quat_inverse,
    quat_multiply,
    quat_rotate,
    quat_to_expmap,
    rotate_ground,
)

TAIL = 64  # frames kept of the first clip before the join
HEAD = 150  # frames kept of the second clip after it
SEARCH = 24  # frames at the end of the first and the start of the second clip in which the join is searched


@dataclass(frozen=True, eq=False)
class Piece:
    """A stretch of a clip, prepared for joining.

    Attributes:
        motion: its T frames in the world.
        ground: (T, 3) root x, z (cm) and heading (radians).
        positions, velocities: (T, 23, 3) of the joints in each frame's heading frame, in cm and cm/s.
        contacts, types, phases, reference: as in ClipData.
    """

    motion: Motion
    ground: Array
    positions: Array
    velocities: Array
    contacts: Array
    types: Array
    phases: Array
    reference: Array

    def cut(self, end: int) -> Piece:
        """The frames before end."""
        arrays = {name: value[:end] for name, value in vars(self).items() if name != "motion"}
        return Piece(self.motion.cut(0, end), **arrays)


def splice_clips(
    dataset: Dataset,
    first: tuple[Clip, int, int],
    second: tuple[Clip, int, int],
    decay: int,
    pick: Callable[[int], int],
    pause: int = 0,
) -> ClipData:
    """Join the end of one stretch to the start of another.

    Args:
        first, second: (clip, start, end) stretches, each of one type.
        decay: frames over which the difference at the join decays; ignored with a pause, over which it then decays.
        pick: returns a random number below its argument, to choose among the best joins.
        pause: frames between the two stretches, in which the body moves from one to the other. Reference poses pause
            like this between two performances.
    """
    clip, start, end = first
    a = cut_piece(dataset, clip, max(start, end - TAIL - SEARCH), end)
    clip, start, end = second
    b = cut_piece(dataset, clip, start, min(end, start + HEAD + SEARCH))
    if pause:
        b = _after_pause(b, pause, a.reference[-1])
        i, j, decay = len(a.motion) - 1, 1, pause
    else:
        i, j = _best_join(a, b, pick)
    a_start, b_end = max(0, i - TAIL), min(len(b.motion), j + HEAD)
    joined = join_pieces(a, b, i, j, decay).motion
    motion = Motion(
        a.motion.skeleton,
        quat_continuous(
            np.concatenate(
                [a.motion.local_rotations[a_start : i + 1], joined.local_rotations[: b_end - j - 1]]
            )
        ),
        np.concatenate([a.motion.root_positions[a_start : i + 1], joined.root_positions[: b_end - j - 1]]),
        dataset.fps,
    )
    contacts = np.concatenate([a.contacts[a_start : i + 1], b.contacts[j + 1 : b_end]])
    join = i + 1 - a_start
    motion = lock_feet(motion, contacts_around(contacts, join, min(join + decay, len(contacts)), dataset.fps))
    encoded = encode_motion(motion, dataset.reference_rotations, dataset.layout.version)
    types = np.concatenate([a.types[a_start : i + 1], b.types[j + 1 : b_end]])
    phases = np.concatenate([a.phases[a_start : i + 1], b.phases[j + 1 : b_end]])
    # Reference poses are not blended: they are what is asked for, not what the body can follow at once.
    reference = np.concatenate([a.reference[a_start : i + 1], b.reference[j + 1 : b_end]])
    return ClipData(encoded.features, encoded.contacts, encoded.ground, types, phases, reference)


def _after_pause(piece: Piece, pause: int, reference: Array) -> Piece:
    """A piece with pause + 2 frames added at its start, in which the body speeds up from standing.

    The root accelerates evenly. Root height and joints start from nearly the first pose. The reference poses change
    linearly from the given ones (72,) to the piece's first.
    """
    held = pause + 2
    to_come = np.arange(held, 0, -1, dtype=np.float32)  # frames left until the piece's first
    share = np.clip((held - 1 - to_come) / pause, 0.0, None)
    motion = piece.motion
    # Distance to the first frame, in units of the first frame's step. `ahead` is for the root on the ground. `back` is
    # for height and joints, which leave the first pose and return to it.
    ahead = np.append(np.cumsum(share[:0:-1])[::-1], 0.0)[:, None] + 1.0
    back = decay_curves(to_come, float(pause))[1]

    def led(values: Array) -> Array:
        return np.concatenate([np.repeat(values[:1], held, axis=0), values])

    rotations, root, ground = led(motion.local_rotations), led(motion.root_positions), led(piece.ground)
    turn = quat_to_expmap(quat_multiply(motion.local_rotations[1], quat_inverse(motion.local_rotations[0])))
    rotations[:held] = quat_multiply(expmap_to_quat(-back[:, None, None] * turn), rotations[:held])
    way = piece.ground[0, :2] - ahead * (piece.ground[1, :2] - piece.ground[0, :2])
    root[:held, [0, 2]], ground[:held, :2] = way, way
    root[:held, 1] -= back * (motion.root_positions[1, 1] - motion.root_positions[0, 1])
    phases, shown = led(piece.phases), led(piece.reference)
    phases[:held] = -1.0
    shown[:held] = lerp(reference, piece.reference[0], share[:, None])
    return Piece(
        Motion(motion.skeleton, rotations, root, motion.fps),
        ground,
        led(piece.positions),
        led(piece.velocities),
        led(piece.contacts),
        led(piece.types),
        phases,
        shown,
    )


def cut_piece(dataset: Dataset, clip: Clip, start: int, end: int) -> Piece:
    """Frames start to end (exclusive) of a clip, as a piece."""
    data = dataset.read(clip, start, end)
    motion = dataset.motion(clip, data)
    _, positions = motion_kinematics(motion)
    origin = np.stack([data.ground[:, 0], np.zeros(len(motion), np.float32), data.ground[:, 1]], axis=-1)
    turn = quat_from_yaw(-data.ground[:, 2])[:, None]
    velocities = np.diff(positions, axis=0, prepend=positions[:1]) * dataset.fps
    velocities[0] = velocities[1]
    return Piece(
        motion,
        data.ground,
        quat_rotate(turn, positions - origin[:, None]),
        quat_rotate(turn, velocities),
        data.contacts,
        data.types,
        data.phases,
        data.reference,
    )


def _best_join(a: Piece, b: Piece, pick: Callable[[int], int]) -> tuple[int, int]:
    """Frames (i of a, j of b) with similar poses and velocities, picked from the three best pairs."""
    ends = (
        np.arange(max(8, len(a.motion) - SEARCH), len(a.motion) - 2)
        if len(a.motion) > 12
        else np.array([len(a.motion) - 2])
    )
    starts = np.arange(1, max(2, min(SEARCH, len(b.motion) - 8)))
    cost = join_cost(a, b, ends, starts).reshape(-1)
    best = np.argsort(cost, kind="stable")[:3]
    chosen = int(best[pick(len(best))])
    return int(ends[chosen // len(starts)]), int(starts[chosen % len(starts)])


def join_cost(a: Piece, b: Piece, ends: Array, starts: Array) -> Array:
    """Distances (E, S) in cm of poses and velocities between frames ends (E,) of a and frames starts (S,) of b."""
    # A velocity counts as the distance it covers in 0.1 s.
    before, after = (
        np.concatenate([piece.positions[frames], 0.1 * piece.velocities[frames]], axis=1).reshape(
            len(frames), -1
        )
        for piece, frames in ((a, ends), (b, starts))
    )
    return np.linalg.norm(before[:, None] - after, axis=-1)


def join_pieces(a: Piece, b: Piece, i: int, j: int, decay: int) -> Piece:
    """Frames j + 1 onwards of b, moved and turned so that they continue frame i of a.

    The difference in pose and velocity at the join decays over `decay` frames.
    """
    turn = a.ground[i, 2] - b.ground[j, 2]
    way = rotate_ground(turn, b.ground[j + 1 :, :2] - b.ground[j, :2]) + a.ground[i, :2]
    return Piece(
        continued(a.motion, i, b.motion, j, turn, decay),
        np.concatenate([way, b.ground[j + 1 :, 2:] + turn], axis=1),
        b.positions[j + 1 :],
        b.velocities[j + 1 :],
        b.contacts[j + 1 :],
        b.types[j + 1 :],
        b.phases[j + 1 :],
        b.reference[j + 1 :],
    )
