"""Arrays that frame_kernel.c reads and writes around the network; rows are characters.

They must not move in memory: the kernel keeps their addresses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motionkit.arrays import Floats
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.foot_lock import FootLock
from motionkit.motion.skeleton import JOINT_COUNT


@dataclass(frozen=True, eq=False)
class FrameArrays:
    """The present frame of B characters.

    Attributes:
        x: (B, 276) normalised; before: (B, 276) the frame before.
        contacts: (B, 4) probabilities.
        features: (B, 276) unnormalised.
        ground: (B, 3) root x, z (cm) and heading (radians).
    """

    x: Floats
    before: Floats
    contacts: Floats
    features: Floats
    ground: Floats

    @classmethod
    def of(cls, batch: int) -> FrameArrays:
        """Zeros."""
        sizes = (FEATURE_COUNT, FEATURE_COUNT, CONTACT_COUNT, FEATURE_COUNT, 3)
        return cls(*(np.zeros((batch, size), np.float32) for size in sizes))

    def adopt(self, index: int, other: FrameArrays) -> None:
        """Replace one character by the only character of other arrays."""
        for mine, its in zip(vars(self).values(), vars(other).values(), strict=True):
            mine[index] = its[0]


@dataclass(frozen=True, eq=False)
class PresetArrays:
    """Sampling presets of B characters, by their types; all (B, 1).

    Attributes:
        log_noise_scale: logarithm of the factor on standard deviations.
        velocity_blend: share of the last frame's velocity that is kept.
        slip_correction: share of foot sliding to subtract from the root's velocity.
    """

    log_noise_scale: Floats
    velocity_blend: Floats
    slip_correction: Floats

    @classmethod
    def of(cls, batch: int) -> PresetArrays:
        """Zeros."""
        return cls(*(np.zeros((batch, 1), np.float32) for _ in range(3)))


@dataclass(frozen=True, eq=False)
class BodyArrays:
    """The bodies of N characters.

    Attributes:
        offsets: (N, 23, 3) bones in cm.
        scale: (N,) size relative to the canonical body.
        rise: (N,) rise of the root (height_correction.py), in cm of the canonical body.
        feet: foot-lock state; None for no foot locking.
    """

    offsets: Floats
    scale: Floats
    rise: Floats
    feet: FootLock | None

    @classmethod
    def of(cls, count: int, feet: bool = True) -> BodyArrays:
        """Bodies of scale 1 whose offsets are still zero."""
        offsets = np.zeros((count, JOINT_COUNT, 3), np.float32)
        rise, locks = np.zeros(count, np.float32), FootLock(count) if feet else None
        return cls(offsets, np.ones(count, np.float32), rise, locks)

    def put(self, index: int, offsets: Floats, scale: float) -> None:
        """Give one character another body with offsets (23, 3), and forget its past."""
        self.offsets[index], self.scale[index], self.rise[index] = offsets, scale, 0.0
        if self.feet is not None:
            self.feet.reset(index)
