"""Standing poses by name, the T-pose and the A-pose, as rotations from the canonical rest pose."""

from __future__ import annotations

import math

import numpy as np

from motionkit.arrays import Array
from motionkit.motion.rotations import quat_between, quat_identity
from motionkit.motion.skeleton import JOINT_NAMES, canonical_skeleton
from motionkit.rig.rest_pose import SIDES, quat_from_roll

ARMS = {"tpose": 0.0, "apose": 45.0}  # degrees of the arms below the shoulders, by the name of the pose
_DOWN = np.array([0.0, -1.0, 0.0], np.float32)


def standing_turns(name: str = "tpose") -> Array:
    """Global rotations (23, 4) from the canonical rest pose to one of ARMS, with vertical legs and flat feet."""
    turns = quat_identity((len(JOINT_NAMES),))
    rest = canonical_skeleton().offsets
    for side, sign in zip(SIDES, (-1.0, 1.0), strict=True):
        parts = {"UpLeg": quat_between(rest[JOINT_NAMES.index(f"{side}Leg")], _DOWN)}
        parts["Arm"] = quat_from_roll(np.array(sign * math.radians(ARMS[name]), np.float32))
        for top, below in (("UpLeg", ("Leg", "Foot", "ToeBase")), ("Arm", ("ForeArm", "Hand"))):
            for part in (top, *below):
                turns[JOINT_NAMES.index(side + part)] = parts[top]
    return turns
