"""Structural similarity (SSIM) of joint rotations over time."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from motionkit.arrays import Array
from motionkit.errors import MotionkitError
from motionkit.features.heading import heading_angles
from motionkit.metrics.value import MetricSettings, MetricValue, need
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_from_yaw, quat_inverse, quat_multiply, quat_to_expmap

_BLOCK = 500  # windows compared at once


def joint_expmaps(motion: Motion) -> Array:
    """Exponential maps (T, 69) in radians of the 23 joint rotations of a canonical motion.

    The root's rotation is relative to its heading, as in the paper, so place and facing do not matter.
    """
    local = motion.local_rotations.astype(np.float64)
    yaw = heading_angles(motion_kinematics(motion)[1].astype(np.float64), motion.fps)
    root = quat_multiply(quat_inverse(quat_from_yaw(yaw)), local[:, 0])
    expmaps = quat_to_expmap(np.concatenate([root[:, None], local[:, 1:]], axis=1))
    return expmaps.reshape(len(expmaps), -1)


def expmaps_like(generated: Array, reference: Array) -> Array:
    """Return the exponential maps (T, 69) of generated that are nearest to those of reference, frame by frame.

    A rotation has two maps shorter than a full turn, v and v - 2 pi v/|v|. Near half a turn, such as a body's in a
    cartwheel, a small difference decides which of them is the shorter one.
    """
    made, real = (each.reshape(len(each), -1, 3) for each in (generated, reference))
    angles = np.linalg.norm(made, axis=-1, keepdims=True)
    other = made - 2.0 * np.pi * made / np.maximum(angles, 1e-9)
    nearer = ((other - real) ** 2).sum(-1, keepdims=True) < ((made - real) ** 2).sum(-1, keepdims=True)
    return np.where(nearer, other, made).reshape(generated.shape)


def expmap_pair(motion: Motion, truth: Motion) -> tuple[Array, Array]:
    """Return the exponential maps (T, 69) of two motions of one length, those of the first like those of the second."""
    maps = joint_expmaps(truth)
    return expmaps_like(joint_expmaps(motion), maps), maps


def structural_similarity(
    generated: Array, reference: Array, kind: str = "window", settings: MetricSettings | None = None
) -> MetricValue:
    """Mean SSIM over sliding windows; 1 for equal sequences.

    The paper's equation lacks the factor 2 of the covariance term. Without it equal sequences would not reach the 1.0
    of the paper's own tables. The original (Wang et al. 2004) has the factor, and so has this function.

    Args:
        generated, reference: (T, C) channels over time, such as those of joint_expmaps.
        kind: "window" takes all channels of a window as one set of samples (id ssim-window); "channel" takes each
            channel of a window by itself and averages (id ssim-channel).
        settings: window length and the constants K1 and K2.

    Raises:
        MotionkitError: shapes differ, the sequences are not longer than a window, the reference is constant, or
            the kind is unknown.
    """
    settings = settings or MetricSettings()
    if kind not in ("window", "channel"):
        raise MotionkitError(f"unknown kind of SSIM {kind!r}, expected 'window' or 'channel'")
    if generated.shape != reference.shape or generated.ndim != 2:
        raise MotionkitError(
            f"SSIM needs two equal shapes (T, C), found {tuple(generated.shape)} and {tuple(reference.shape)}"
        )
    need(len(reference), settings.ssim_window + 1, "SSIM needs")
    generated, reference = generated.astype(np.float64), reference.astype(np.float64)
    lowest = reference.min()
    spread = float(reference.max() - lowest)
    if spread < 1e-9:
        raise MotionkitError("SSIM is undefined: the ground truth is constant")
    c1, c2 = ((k * spread) ** 2 for k in (settings.ssim_k1, settings.ssim_k2))
    made, real = (
        sliding_window_view(each - lowest, settings.ssim_window, axis=0) for each in (generated, reference)
    )
    index = np.concatenate([
        _window_index(_samples(made[rows], kind), _samples(real[rows], kind), c1, c2)
        for rows in (slice(first, first + _BLOCK) for first in range(0, len(made), _BLOCK))
    ])  # fmt: skip
    parameters: dict[str, float | str] = {
        "window": float(settings.ssim_window),
        "k1": settings.ssim_k1,
        "k2": settings.ssim_k2,
        "range": spread,
    }
    return MetricValue(f"ssim-{kind}", float(index.mean()), "", parameters)


def _samples(windows: Array, kind: str) -> Array:
    """Windows (windows, C, length) with samples on the last axis: as they are by channel, else in one row."""
    return windows if kind == "channel" else windows.reshape(len(windows), -1)


def _window_index(a: Array, b: Array, c1: float, c2: float) -> Array:
    """SSIM of a and b over their last axis, with population moments."""
    mean_a, mean_b = a.mean(-1), b.mean(-1)
    a, b = a - mean_a[..., None], b - mean_b[..., None]
    covariance = (a * b).mean(-1)
    luminance = (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1)
    return luminance * (2 * covariance + c2) / ((a * a).mean(-1) + (b * b).mean(-1) + c2)
