"""Arrays that frame_kernel.c reads and writes around the network; rows are characters.

They must not move in memory: the kernel keeps their addresses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motionkit.arrays import Floats
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.inference.foot_lock import FootLock
from motionkit.motion.skeleton import JOINT_COUNT
from motionkit.rig.soles import MOST_POINTS, LiveSoles


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
class SoleArrays:
    """Soles of N characters; parts are left foot, left toes, right foot, right toes.

    Attributes:
        points: (N, 4, MOST_POINTS, 3) in cm, as in rig/soles.py.
        counts: (N, 4) points of each part; a character without a mesh has none.
        floor: (N,) height of the floor in cm.
        rise: (N, 2) shift of the ankles upwards.
        bend: (N, 2) turn of the toes upwards, in radians.
        drop: (N,) shift of the hips downwards.
    """

    points: Floats
    counts: NDArray[np.int64]
    floor: Floats
    rise: Floats
    bend: Floats
    drop: Floats

    @classmethod
    def of(cls, count: int) -> SoleArrays:
        """Characters without soles."""
        shapes = ((count,), (count, 2), (count, 2), (count,))
        points, counts = np.zeros((count, 4, MOST_POINTS, 3), np.float32), np.zeros((count, 4), np.int64)
        return cls(points, counts, *(np.zeros(shape, np.float32) for shape in shapes))

    def put(self, index: int, soles: LiveSoles | None) -> None:
        """Give one character other soles, or none, and forget its past."""
        for array in vars(self).values():
            array[index] = 0
        if soles is None:
            return
        self.floor[index] = soles.floor
        parts = (soles.left.foot, soles.left.toe, soles.right.foot, soles.right.toe)
        for part, points in enumerate(parts):
            self.points[index, part, : len(points)] = points
            self.counts[index, part] = len(points)


@dataclass(frozen=True, eq=False)
class BodyArrays:
    """The bodies of N characters.

    Attributes:
        offsets: (N, 23, 3) bones in cm.
        scale: (N,) size relative to the canonical body.
        rise: (N,) rise of the root (height_correction.py), in cm of the canonical body.
        soles: of characters with a mesh.
        feet: foot-lock state; None for no foot locking, and soles that nothing plants.
    """

    offsets: Floats
    scale: Floats
    rise: Floats
    soles: SoleArrays
    feet: FootLock | None

    @classmethod
    def of(cls, count: int, feet: bool = True) -> BodyArrays:
        """Bodies of scale 1 whose offsets are still zero."""
        offsets = np.zeros((count, JOINT_COUNT, 3), np.float32)
        rise, locks = np.zeros(count, np.float32), FootLock(count) if feet else None
        return cls(offsets, np.ones(count, np.float32), rise, SoleArrays.of(count), locks)

    def put(self, index: int, offsets: Floats, scale: float, soles: LiveSoles | None = None) -> None:
        """Give one character another body with offsets (23, 3), and forget its past."""
        self.offsets[index], self.scale[index], self.rise[index] = offsets, scale, 0.0
        self.soles.put(index, soles)
        if self.feet is not None:
            self.feet.reset(index)
