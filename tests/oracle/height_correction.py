"""Root-height correction in numpy, in place of rises and raise_body of frame_kernel.c."""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Floats
from motionkit.inference.height_correction import DEEPEST, DOUBT, LIFT, PACE, REACH
from motionkit.inference.slip_correction import foot_columns
from motionkit.motion.skeleton import FOOT_JOINTS, STANDING_HEIGHTS

STANDING = np.array(STANDING_HEIGHTS, np.float32)


def follow(layout: str, rise: Floats, features: Floats, heights: Floats) -> Floats:
    """How far to raise each body (N,) in this frame, in cm of the canonical body: rise (N,) is changed in place.

    Args:
        features: (N, 276) unnormalised.
        heights: (N, 23) of all joints by forward kinematics, not raised, in cm of the canonical body.
    """
    said = np.maximum((features[:, foot_columns(layout)[:, 1]] - STANDING).min(axis=1), -DEEPEST)
    shown = (heights[:, list(FOOT_JOINTS)] - STANDING).min(axis=1)
    missing = np.maximum(said - shown, 0.0)
    low = 1.0 - np.clip(shown / REACH, 0.0, 1.0)
    pace = PACE * low / (1.0 + np.square(missing / DOUBT))
    rise += pace * (missing - rise)
    rise += LIFT * np.maximum(-DEEPEST - shown - rise, 0.0)
    return rise
