"""Makes transitions that no recording contains, by joining the end of one clip to the start of another.

The clips are joined where their poses are closest. The second clip is moved and turned so that its root continues from
the first one's. The differences in pose and velocity at the join decay over the following frames (inertialization,
Bollo 2018). Foot locking keeps planted feet from sliding meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from motionkit.arrays import Array, lerp
from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.features.encode import encode_motion
from motionkit.finish.feet import clear_toes, contacts_around, lock_feet
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
        data: of the dataset; features and contacts are those of the clip, wherever the piece is moved.
        positions, velocities: (T, 23, 3) of the joints in each frame's heading frame, in cm and cm/s.
    """

    motion: Motion
    data: ClipData
    positions: Array
    velocities: Array

    def cut(self, end: int) -> Piece:
        """The frames before end."""
        return Piece(
            self.motion.cut(0, end), self.data.cut(0, end), self.positions[:end], self.velocities[:end]
        )


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
        b = _after_pause(b, pause, a.data.reference[-1])
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
    # Reference poses are not blended: they are what is requested, not what the body can follow at once.
    kept = a.data.cut(a_start, i + 1).followed_by(b.data.cut(j + 1, b_end))
    join = i + 1 - a_start
    contacts = contacts_around(kept.contacts, join, min(join + decay, len(kept.contacts)), dataset.fps)
    motion = clear_toes(lock_feet(motion, contacts))
    encoded = encode_motion(motion, dataset.reference_rotations, dataset.layout.version)
    return replace(kept, features=encoded.features, contacts=encoded.contacts, ground=encoded.ground)


def _after_pause(piece: Piece, pause: int, reference: Array) -> Piece:
    """A piece with pause + 2 frames added at its start, in which the body speeds up from standing.

    The root accelerates evenly. Root height and joints start from nearly the first pose. The reference poses change
    linearly from the given ones (72,) to the piece's first.
    """
    added = pause + 2
    to_come = np.arange(added, 0, -1, dtype=np.float32)  # frames left until the piece's first
    share = np.clip((added - 1 - to_come) / pause, 0.0, None)
    motion = piece.motion
    # Distance to the first frame, in units of the first frame's step. `ahead` is for the root on the ground. `back` is
    # for height and joints, which leave the first pose and return to it.
    ahead = np.append(np.cumsum(share[:0:-1])[::-1], 0.0)[:, None] + 1.0
    back = decay_curves(to_come, float(pause))[1]

    def led(values: Array) -> Array:
        return np.concatenate([np.repeat(values[:1], added, axis=0), values])

    rotations, root = led(motion.local_rotations), led(motion.root_positions)
    data = ClipData(*map(led, vars(piece.data).values()))
    turn = quat_to_expmap(quat_multiply(motion.local_rotations[1], quat_inverse(motion.local_rotations[0])))
    rotations[:added] = quat_multiply(expmap_to_quat(-back[:, None, None] * turn), rotations[:added])
    first, second = piece.data.ground[:2, :2]
    root[:added, [0, 2]] = data.ground[:added, :2] = first - ahead * (second - first)
    root[:added, 1] -= back * (motion.root_positions[1, 1] - motion.root_positions[0, 1])
    data.phases[:added] = -1.0
    data.reference[:added] = lerp(reference, piece.data.reference[0], share[:, None])
    led_motion = Motion(motion.skeleton, rotations, root, motion.fps)
    return Piece(led_motion, data, led(piece.positions), led(piece.velocities))


def cut_piece(dataset: Dataset, clip: Clip, start: int, end: int) -> Piece:
    """Frames start to end (exclusive) of a clip, as a piece."""
    data = dataset.read(clip, start, end)
    motion = dataset.motion(clip, data)
    _, positions = motion_kinematics(motion)
    origin = np.stack([data.ground[:, 0], np.zeros(len(motion), np.float32), data.ground[:, 1]], axis=-1)
    turn = quat_from_yaw(-data.ground[:, 2])[:, None]
    velocities = np.diff(positions, axis=0, prepend=positions[:1]) * dataset.fps
    velocities[0] = velocities[1]
    places = quat_rotate(turn, positions - origin[:, None])
    return Piece(motion, data, places, quat_rotate(turn, velocities))


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
    before, after = a.data.ground[i], b.data.ground[j]
    turn = before[2] - after[2]
    rest = b.data.cut(j + 1, len(b.motion))
    path = rotate_ground(turn, rest.ground[:, :2] - after[:2]) + before[:2]
    ground = np.concatenate([path, rest.ground[:, 2:] + turn], axis=1)
    moved = continued(a.motion, i, b.motion, j, turn, decay)
    return Piece(moved, replace(rest, ground=ground), b.positions[j + 1 :], b.velocities[j + 1 :])
