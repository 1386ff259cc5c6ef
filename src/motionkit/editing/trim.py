"""Where a clip moves."""

from __future__ import annotations

import numpy as np

from motionkit.errors import MotionkitError
from motionkit.motion.motion import Motion
from motionkit.rig.upright import Upright

MOVES = 15.0  # cm/s of the joint that moves most, above which a body moves; a standing body sways by less
MARGIN = 0.25  # s kept before and after the movement


def moving_frames(motion: Motion) -> tuple[int, int]:
    """First frame and end of what moves, with a margin; raises MotionkitError if nothing does."""
    positions = Upright.of(motion).positions.astype(np.float64)
    if len(positions) < 2:
        raise MotionkitError("one frame does not move")
    fast = np.linalg.norm(np.diff(positions, axis=0), axis=-1).max(axis=1) * motion.fps > MOVES
    if not fast.any():
        raise MotionkitError("the clip does not move")
    moves = np.flatnonzero(fast)
    margin = round(MARGIN * motion.fps)
    return max(0, int(moves[0]) - margin), min(len(positions), int(moves[-1]) + 2 + margin)
