"""HeightCorrection: a body whose rotations put its feet lower than the frame says they are is raised.

A frame says twice how high its feet are: by their positions, and by the rotations that lead to them. What the network
does not know of a bent leg it draws as its mean, which is a straighter leg and so a longer one: in squats, strikes and
landings rotations put the feet up to a hand's breadth under the floor, positions do not. The root is raised by what is
missing, slowly, while feet are low, and the less the more it is: so far apart are only whirls, whose positions are no
better. What is deeper under the floor than recorded feet are is raised faster, whatever positions say. Nothing of it
goes back into the network. frame_kernel.c and export/onnx_body.py do the same.
"""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array, Floats
from motionkit.inference.slip_correction import foot_columns
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.skeleton import FOOT_JOINTS, STANDING_HEIGHTS, Skeleton

REACH = 10.0  # cm above the floor from which on feet tell nothing
PACE = 0.05  # share of what is missing that the root is raised by in a frame
DOUBT = 4.0  # Gap (cm) at which the correction halves
# cm that a foot may be lower than where it stands, and the share of the rest that the root is raised by in a frame
DEEPEST, LIFT = 5.0, 0.2
_FEET = np.array(FOOT_JOINTS)
_STANDING = np.array(STANDING_HEIGHTS, np.float32)


class HeightCorrection:
    """How far each of N characters is raised, frame by frame."""

    def __init__(self, layout: str, count: int) -> None:
        self.columns = foot_columns(layout)[:, 1]
        self.rise = np.zeros(count, np.float32)

    def follow(self, features: Floats, heights: Floats) -> Floats:
        """How far to raise each body (N,) in this frame, in cm of the canonical body.

        Args:
            features: (N, 276) unnormalised.
            heights: (N, 23) of all joints by forward kinematics, not raised, in cm of the canonical body.
        """
        said = np.maximum((features[:, self.columns] - _STANDING).min(axis=1), -DEEPEST)
        shown = (heights[:, _FEET] - _STANDING).min(axis=1)
        missing = np.maximum(said - shown, 0.0)
        low = 1.0 - np.clip(shown / REACH, 0.0, 1.0)
        pace = PACE * low / (1.0 + np.square(missing / DOUBT))
        self.rise += pace * (missing - self.rise)
        self.rise += LIFT * np.maximum(-DEEPEST - shown - self.rise, 0.0)
        return self.rise

    def apply(self, features: Floats, root_positions: Floats, world: Floats, scale: Floats) -> None:
        """Raise the bodies of a frame: changes root_positions (N, 3) and their world transforms (N, 23, 4, 4) in place.

        Args:
            features: (N, 276) unnormalised.
            scale: (N,) size of each character against the canonical body.
        """
        rise = scale * self.follow(features, world[..., 1, 3] / scale[:, None])
        root_positions[:, 1] += rise
        world[..., 1, 3] += rise[:, None]


def raised(features: Array, rotations: Array, roots: Array, skeleton: Skeleton, layout: str) -> Array:
    """Root positions (B, T, 3) of whole motions, raised frame by frame.

    Args:
        features: (B, T, 276) unnormalised.
        rotations: (B, T, 23, 4) local.
        roots: (B, T, 3) in cm, the floor at height zero.
        skeleton: with the proportions of the canonical one.
    """
    _, positions = forward_kinematics(
        rotations, roots, skeleton.offsets.astype(roots.dtype), skeleton.parents
    )
    heights, drawn = positions[..., 1].astype(np.float32), features
    height_correction = HeightCorrection(layout, len(features))
    rises = [height_correction.follow(drawn[:, t], heights[:, t]).copy() for t in range(features.shape[1])]
    out = roots.copy()
    out[..., 1] += np.stack(rises, axis=1)
    return out
