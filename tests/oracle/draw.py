"""Drawing a frame in numpy, in place of draw_frames of frame_kernel.c.

Functions are in double precision, so that they give to the last digit what C gives.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats, normalized
from motionkit.features.layout import feature_layout
from motionkit.inference.frame_draw import FrameDraw
from motionkit.inference.frame_kernel import DrawArrays
from motionkit.inference.noise import Noise, NoiseState
from motionkit.inference.slip_correction import FLOOR, LIMIT, REACHES, STIFFNESS, foot_columns
from motionkit.motion.leg_ik import FOOT_SHARES, foot_weights

Doubles = NDArray[np.float64]


class NumpyDraw(FrameDraw):
    """FrameDraw by numpy."""

    def bind(self, arrays: DrawArrays) -> Callable[[], None]:
        """What draws a frame from the arrays."""
        return lambda: draw(arrays, self.noise)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # who uses the frame looks at it
def draw(arrays: DrawArrays, noise: Noise) -> None:
    """Draw the next frame of all characters in place."""
    made, space, presets, frame = arrays.prediction, arrays.space, arrays.presets, arrays.frame
    x, ground, fps = frame.x, frame.ground, np.float32(space.fps)
    layout = feature_layout(space.layout)
    onwards = x + (x - frame.before)
    frame.before[:] = x
    if noise.kind == "mean":
        x[:] = made.mean
    else:
        x[:] = np.exp(made.log_sigma, dtype=np.float64)
        x *= next_noise(arrays.noise, noise)
        x += made.mean
    onwards -= x
    x += onwards * (presets.velocity_blend * space.blended)
    frame.contacts[:] = 1.0 / (1.0 + np.exp(-made.contact_logits, dtype=np.float64))
    features = np.multiply(x, space.std, out=frame.features)
    features += space.mean
    if layout.root_is_sixd:
        keep_rotation(arrays, layout.blocks["root_rotation"])
    if presets.slip_correction.any():
        hold_ground(arrays)
    yaw, xz = layout.blocks["root_yaw_velocity"].start, layout.blocks["root_xz_velocity"]
    ground[:, 2] += features[:, yaw] / fps
    sine, cosine = (f(ground[:, 2], dtype=np.float64).astype(np.float32) for f in (np.sin, np.cos))
    velocity = features[:, xz] / fps
    ground[:, 0] += cosine * velocity[:, 0] + sine * velocity[:, 1]
    ground[:, 1] += cosine * velocity[:, 1] - sine * velocity[:, 0]


def next_noise(state: NoiseState, noise: Noise) -> Floats:
    """Noise (B, 276) of the coming frame, through both filters."""
    fresh, (rho, rho_share, smoothing, smoothing_share) = state.fresh, noise.filters
    for filtered, keeps, takes in (
        (state.first, rho, rho_share),
        (state.second, smoothing, smoothing_share),
    ):
        filtered *= np.float32(keeps)
        filtered += fresh * np.float32(takes)
        fresh = filtered
    return fresh * np.float32(noise.temperature)


def keep_rotation(arrays: DrawArrays, root: slice) -> None:
    """Make the two columns of the root's rotation orthonormal (Gram-Schmidt), as all recorded ones are."""
    space, frame = arrays.space, arrays.frame
    columns = frame.features[:, root].astype(np.float64)
    first = normalized(columns[:, :3], 1e-8)
    second = columns[:, 3:] - (first * columns[:, 3:]).sum(-1, keepdims=True) * first
    frame.features[:, root] = np.concatenate([first, normalized(second, 1e-8)], axis=1)
    frame.x[:, root] = (frame.features[:, root] - space.mean[root]) / space.std[root]


def hold_ground(arrays: DrawArrays) -> None:
    """Take out of the root's velocities, in part, what feet on the ground would slide."""
    space, frame, fps = arrays.space, arrays.frame, np.float32(arrays.space.fps)
    feet, blocks = foot_columns(space.layout), feature_layout(space.layout).blocks
    yaw, xz = blocks["root_yaw_velocity"], blocks["root_xz_velocity"]
    features = frame.features
    before = frame.before[:, feet] * space.std[feet] + space.mean[feet]
    turn, step = features[:, yaw.start] / fps, features[:, xz] / fps
    angle, move = standing_move(features[:, feet], before, turn, step)
    share = arrays.presets.slip_correction.astype(np.float64) * space.fps
    moved = (np.concatenate([angle[:, None], move], axis=1) * share).astype(np.float32)
    for columns, by in ((yaw, moved[:, :1]), (xz, moved[:, 1:])):
        features[:, columns] += by
        frame.x[:, columns] += by / space.std[columns]


def standing_move(feet: Floats, before: Floats, turn: Floats, step: Floats) -> tuple[Doubles, Doubles]:
    """What to add to the turn (B,) and the step (B, 2) of the root, so that feet on the ground stay there.

    In double precision, so that it gives what frame_kernel.c gives.

    Args:
        feet, before: (B, 4, 3) foot joints of a frame and of the one before, each in its heading frame, cm.
        turn: (B,) of the heading since then, radians.
        step: (B, 2) of the root along x and z of the later heading frame, cm.
    """
    (x, y, z), (x_before, _, z_before) = (np.moveaxis(a.astype(np.float64), -1, 0) for a in (feet, before))
    sine, cosine = (f(turn.astype(np.float64))[:, None] for f in (np.sin, np.cos))
    # How far each has moved over the ground, and how a turn of the body would move it.
    move_x = x + step[:, :1].astype(np.float64) - (cosine * x_before - sine * z_before)
    move_z = z + step[:, 1:].astype(np.float64) - (cosine * z_before + sine * x_before)
    low = 1.0 - np.clip((y - FLOOR) / np.array(REACHES), 0.0, 1.0)
    weight, holds = foot_weights(np.array(FOOT_SHARES) * low, np.sqrt(move_x * move_x + move_z * move_z))
    mean_x, mean_z, arm_x, arm_z = ((weight * v).sum(axis=1) for v in (move_x, move_z, z, -x))
    off_x, off_z = move_x - mean_x[:, None], move_z - mean_z[:, None]
    about_x, about_z = z - arm_x[:, None], -x - arm_z[:, None]
    turned = (weight * (off_x * about_x + off_z * about_z)).sum(axis=1)
    spread = (weight * (about_x * about_x + about_z * about_z)).sum(axis=1)
    angle = -turned / (spread + STIFFNESS)
    back_x, back_z = -mean_x - angle * arm_x, -mean_z - angle * arm_z
    holds = holds / (1.0 + np.sqrt(back_x * back_x + back_z * back_z) / LIMIT)
    return holds * angle, np.stack([holds * back_x, holds * back_z], axis=1)
