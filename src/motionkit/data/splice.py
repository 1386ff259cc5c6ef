"""Transitions no recording holds: the end of one clip joined to the start of another.

The join is made where the two poses are closest; the second clip is moved and turned so that its root
goes on where the first one's was, and what differs in pose and velocity at the join dies away over
the following frames (inertialisation, after Bollo 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from motionkit.data.dataset import Clip, ClipData, Dataset
from motionkit.features.decode import decode_motion
from motionkit.features.encode import encode_motion
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
SEARCH = 24  # frames at the end of the first and the start of the second in which the join is sought


@dataclass(frozen=True, eq=False)
class _Piece:
    motion: Motion
    ground: Tensor
    positions: Tensor  # (T, 23, 3) in the heading frame of each frame
    velocities: Tensor
    types: Tensor
    phases: Tensor
    guide: Tensor


def splice_clips(
    dataset: Dataset,
    first: tuple[Clip, int, int],
    second: tuple[Clip, int, int],
    decay: int,
    generator: torch.Generator,
) -> ClipData:
    """The end of one stretch joined to the start of another, as a clip of its own.

    Args:
        first, second: (clip, start, end) stretches of one type each.
        decay: frames over which the difference at the join dies away.
        generator: picks among the best joins.
    """
    clip, start, end = first
    a = _piece(dataset, clip, max(start, end - TAIL - SEARCH), end)
    clip, start, end = second
    b = _piece(dataset, clip, start, min(end, start + HEAD + SEARCH))
    i, j = _best_join(a, b, generator)
    a_start, b_end = max(0, i - TAIL), min(len(b.motion), j + HEAD)
    joined = _join(a, b, i, j, decay)
    motion = Motion(
        a.motion.skeleton,
        quat_continuous(torch.cat([a.motion.local_rotations[a_start : i + 1], joined[0][: b_end - j - 1]])),
        torch.cat([a.motion.root_positions[a_start : i + 1], joined[1][: b_end - j - 1]]),
        dataset.fps,
    )
    encoded = encode_motion(motion, dataset.references, dataset.layout.version)
    types = torch.cat([a.types[a_start : i + 1], b.types[j + 1 : b_end]])
    phases = torch.cat([a.phases[a_start : i + 1], b.phases[j + 1 : b_end]])
    # The guide is not blended: it is to be the one that is asked for, not the one that can be obeyed at once.
    guide = torch.cat([a.guide[a_start : i + 1], b.guide[j + 1 : b_end]])
    return ClipData(encoded.features, encoded.contacts, encoded.ground, types, phases, guide)


def _piece(dataset: Dataset, clip: Clip, start: int, end: int) -> _Piece:
    data = dataset.read(clip, start, end)
    motion = decode_motion(
        data.features,
        dataset.skeleton(clip),
        dataset.fps,
        data.ground[0],
        dataset.references,
        dataset.layout.version,
    )
    _, positions = motion_kinematics(motion)
    origin = torch.stack([data.ground[:, 0], torch.zeros(len(motion)), data.ground[:, 1]], dim=-1)
    turn = quat_from_yaw(-data.ground[:, 2])[:, None]
    velocities = torch.diff(positions, dim=0, prepend=positions[:1]) * dataset.fps
    velocities[0] = velocities[1]
    return _Piece(
        motion,
        data.ground,
        quat_rotate(turn, positions - origin[:, None]),
        quat_rotate(turn, velocities),
        data.types,
        data.phases,
        data.guide,
    )


def _best_join(a: _Piece, b: _Piece, generator: torch.Generator) -> tuple[int, int]:
    """Frames (i of a, j of b) with near poses and velocities: one of the three best pairs."""
    ends = (
        torch.arange(max(8, len(a.motion) - SEARCH), len(a.motion) - 2)
        if len(a.motion) > 12
        else torch.tensor([len(a.motion) - 2])
    )
    starts = torch.arange(1, max(2, min(SEARCH, len(b.motion) - 8)))
    # Velocities count as the distance they cover in a tenth of a second.
    pa = torch.cat([a.positions[ends].flatten(1), 0.1 * a.velocities[ends].flatten(1)], dim=-1)
    pb = torch.cat([b.positions[starts].flatten(1), 0.1 * b.velocities[starts].flatten(1)], dim=-1)
    cost = torch.cdist(pa, pb).flatten()
    best = cost.topk(min(3, len(cost)), largest=False).indices
    pick = int(best[torch.randint(len(best), (), generator=generator)])
    return int(ends[pick // len(starts)]), int(starts[pick % len(starts)])


def _join(a: _Piece, b: _Piece, i: int, j: int, decay: int) -> tuple[Tensor, Tensor]:
    """Frames j + 1 onwards of b, carried on from frame i of a: rotations (T, 23, 4), root positions (T, 3)."""
    turn = a.ground[i, 2] - b.ground[j, 2]
    yaw = quat_from_yaw(turn)
    rotations = b.motion.local_rotations.clone()
    rotations[:, 0] = quat_multiply(yaw, rotations[:, 0])
    root = b.motion.root_positions.clone()
    root[:, [0, 2]] = (
        rotate_ground(turn, root[:, [0, 2]] - root[j, [0, 2]]) + a.motion.root_positions[i, [0, 2]]
    )

    frames = len(b.motion) - j - 1
    time = torch.arange(1, frames + 1, dtype=torch.float32)
    offset_weight, velocity_weight = _decay_curves(time, float(decay))
    here, there = a.motion.local_rotations[i], rotations[j]
    offset = quat_to_expmap(quat_multiply(here, quat_inverse(there)))
    speed_a = quat_to_expmap(quat_multiply(here, quat_inverse(a.motion.local_rotations[i - 1])))
    speed_b = quat_to_expmap(quat_multiply(there, quat_inverse(rotations[j - 1])))
    correction = offset_weight[:, None, None] * offset + velocity_weight[:, None, None] * (speed_a - speed_b)
    rotations_out = quat_multiply(expmap_to_quat(correction), rotations[j + 1 :])

    root_offset = a.motion.root_positions[i] - root[j]
    root_speed = (a.motion.root_positions[i] - a.motion.root_positions[i - 1]) - (root[j] - root[j - 1])
    root_out = root[j + 1 :] + offset_weight[:, None] * root_offset + velocity_weight[:, None] * root_speed
    return rotations_out, root_out


def _decay_curves(time: Tensor, decay: float) -> tuple[Tensor, Tensor]:
    """Weights of the offset and of the velocity difference (T,): one at the join, gone with both slopes after decay."""
    x = (time / decay).clamp(max=1.0)
    offset = 1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    velocity = decay * (x - x**3 * (6.0 - 8.0 * x + 3.0 * x**2))
    return offset, velocity
