"""Trajectories that carry the speed of one type over into the next, because a body cannot change its speed at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls, future_trajectory

# Acceleration of a transition in cm/s^2. Strides add as much again; recorded gaits stay below the sum in 99.9 % of
# their frames (measured).
CHANGE = 350.0
LEAST = 60.0  # cm/s; the network makes smaller changes of speed by itself; chosen
CORRECTED = 0.15  # largest change of a recorded trajectory's distances, as a share; chosen
SPAN = 10  # frames over which a speed is measured; chosen


def forward_speeds(ground: Array, fps: float) -> Array:
    """Speeds (T,) in cm/s in the direction of the heading, over SPAN frames around each.

    Args:
        ground: (T, 3) root x, z (cm) and heading (radians).
    """
    ahead = np.stack([np.sin(ground[:, 2]), np.cos(ground[:, 2])], axis=-1)
    return (_velocities(ground, fps) * ahead).sum(axis=-1)


def ground_speeds(ground: Array, fps: float) -> Array:
    """Speeds (T,) in cm/s in any direction, over SPAN frames around each; ground as for forward_speeds."""
    return np.linalg.norm(_velocities(ground, fps), axis=-1)


def speeds_ahead(ground: Array, fps: float) -> Array:
    """Straight-line speeds (T,) in cm/s over the second after each frame; in the last second, over that second."""
    last = len(ground) - 1
    second = min(round(fps), last)
    begins = np.minimum(np.arange(last + 1), last - second)
    moved = ground[begins + second, :2] - ground[begins, :2]
    return np.linalg.norm(moved, axis=-1) * (fps / max(second, 1))


def _velocities(ground: Array, fps: float) -> Array:
    last = len(ground) - 1
    frames = np.arange(last + 1)
    before, after = np.maximum(frames - SPAN // 2, 0), np.minimum(frames + SPAN // 2, last)
    moved = ground[after, :2] - ground[before, :2]
    return moved * (fps / np.maximum(after - before, 1))[:, None]


def trajectory_speed(trajectory: Array, fps: float) -> float:
    """Mean straight-line speed in cm/s from the present place to the last place of a trajectory (24,)."""
    count = 2 * len(TRAJECTORY_OFFSETS)
    return float(np.linalg.norm(trajectory[count - 2 : count])) * fps / TRAJECTORY_OFFSETS[-1]


def at_speed(controls: Controls, speed: float, fps: float, where: Array) -> Controls:
    """Change the distances of trajectories (T, 24) to those at a speed in cm/s, in the frames that where (T,) marks."""
    places = controls.trajectory[:, : 2 * len(TRAJECTORY_OFFSETS)].reshape(-1, len(TRAJECTORY_OFFSETS), 2)
    distances = np.array(TRAJECTORY_OFFSETS, np.float32) * np.float32(speed / fps)
    factors = distances / np.maximum(np.linalg.norm(places, axis=-1), 1e-6)
    factors = np.where(where[:, None], np.clip(factors, 1.0 - CORRECTED, 1.0 + CORRECTED), 1.0)[..., None]
    trajectory = controls.trajectory.copy()
    trajectory[:, : 2 * len(TRAJECTORY_OFFSETS)] = (places * factors).reshape(len(trajectory), -1)
    return replace(controls, trajectory=trajectory)


def carried_speeds(speeds: Array, before: float, fps: float, change: float = CHANGE) -> Array:
    """Speeds (N,) that change from `before` at a rate of change cm/s^2, for N frames until they reach speeds (T,)."""
    step = change / fps
    down = before > speeds[0]
    ramp = before + (-step if down else step) * np.arange(1, len(speeds) + 1)
    met = ramp <= speeds if down else ramp >= speeds
    return ramp[: int(met.argmax()) if met.any() else len(ramp)]


def carried_over(
    controls: Controls, ground: Array, before: float, fps: float, change: float = CHANGE
) -> Controls:
    """Change the first trajectories of controls (T, ...) so that the body keeps its speed `before` (cm/s) at first.

    Args:
        ground: (T', 3) ground path of the recording shown with them, from the same frame on.
        change: rate of the change of speed in cm/s^2.
    """
    speeds = forward_speeds(ground, fps)
    if abs(before - float(speeds[0])) < LEAST:
        return controls
    ramp = carried_speeds(speeds, before, fps, change)
    count = min(len(ramp), len(controls.phase))
    if not count:
        return controls
    more = np.concatenate([[0.0], np.cumsum(ramp - speeds[: len(ramp)]) / fps])  # cm further than recorded
    frames = np.arange(count)
    ends = np.minimum(frames[:, None] + np.array(TRAJECTORY_OFFSETS), len(ramp))
    trajectory = future_trajectory(ground, frames)
    trajectory[:, 1 : 2 * len(TRAJECTORY_OFFSETS) : 2] += (more[ends] - more[frames][:, None]).astype(
        np.float32
    )
    trajectories, masks = controls.trajectory.copy(), controls.trajectory_mask.copy()
    trajectories[:count], masks[:count] = trajectory, 1.0
    return replace(controls, trajectory=trajectories, trajectory_mask=masks)
