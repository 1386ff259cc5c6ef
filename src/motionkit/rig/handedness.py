"""Left and right of a body, judged by its shoulders and by where its toes point."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from motionkit.arrays import Array, cross, length, normalized

# Mean cosine between the left-right axes of hips and shoulders, or between feet and the way ahead, below which left
# and right are exchanged.
OPPOSED = -0.5
_STRAIGHT = 0.8  # legs are straight if feet are further below the hips than this share of the leg length


def handedness(places: Mapping[str, int], positions: Array) -> tuple[float, float | None]:
    """Mean cosines between the left-right axes of hips and shoulders, and between feet and the way ahead of the hips.

    The second is None without toes, or if no pose has straight legs: the toes of a kneeling body point backwards.

    Args:
        places: canonical name to joint, with the limbs at least.
        positions: (T, J, 3) of the joints, in any unit and up axis.
    """
    hips, arms = (_pair(places, positions, part) for part in ("UpLeg", "Arm"))
    across = normalized(hips[0] - hips[1])
    agree = float((across * normalized(arms[0] - arms[1])).sum(-1).mean())
    if not all(f"{side}{part}" in places for side in ("Left", "Right") for part in ("Foot", "ToeBase")):
        return agree, None
    up = normalized(arms[0] + arms[1] - hips[0] - hips[1])
    knees, feet, toes = (_pair(places, positions, part) for part in ("Leg", "Foot", "ToeBase"))
    legs = sum(length(knees[i] - hips[i]) + length(feet[i] - knees[i]) for i in (0, 1))
    straight = ((hips[0] + hips[1] - feet[0] - feet[1]) * up).sum(-1) > _STRAIGHT * legs
    if not bool(straight.any()):
        return agree, None
    direction = normalized(toes[0] + toes[1] - feet[0] - feet[1])
    level = direction - (direction * up).sum(-1, keepdims=True) * up  # short if the toes lie under the ankles
    return agree, float((level * normalized(cross(across, up))).sum(-1)[straight].mean())


def _pair(places: Mapping[str, int], positions: Array, part: str) -> Array:
    """Positions (2, T, 3) of the left and the right joint of a part."""
    return np.stack([positions[:, places[f"{side}{part}"]] for side in ("Left", "Right")])
