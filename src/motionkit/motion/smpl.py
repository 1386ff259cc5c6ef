"""Poses of SMPL, SMPL-H and SMPL-X bodies, as AMASS gives them out: turns of joints and places, without the body.

Its joints are about those of the mean neutral body of SMPL (Loper et al., SMPL: A Skinned Multi-Person Linear Model,
2015). They were not read from the model, which is not free; docs/sources.md says how near they are. Betas, which say
how a body differs from the mean, need it and are not used.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motionkit.arrays import Array
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import expmap_to_quat, quat_continuous
from motionkit.motion.skeleton import Skeleton

# Name, parent and place in metres; Y up, facing +Z.
_JOINTS: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("Pelvis", "", (-0.002, -0.223, 0.028)),
    ("L_Hip", "Pelvis", (0.068, -0.315, 0.021)),
    ("R_Hip", "Pelvis", (-0.069, -0.314, 0.024)),
    ("Spine1", "Pelvis", (-0.004, -0.114, 0.002)),
    ("L_Knee", "L_Hip", (0.102, -0.690, 0.017)),
    ("R_Knee", "R_Hip", (-0.108, -0.696, 0.015)),
    ("Spine2", "Spine1", (0.001, 0.021, 0.003)),
    ("L_Ankle", "L_Knee", (0.088, -1.088, -0.027)),
    ("R_Ankle", "R_Knee", (-0.092, -1.095, -0.027)),
    ("Spine3", "Spine2", (0.003, 0.074, 0.028)),
    ("L_Foot", "L_Ankle", (0.115, -1.144, 0.093)),
    ("R_Foot", "R_Ankle", (-0.117, -1.143, 0.096)),
    ("Neck", "Spine3", (0.000, 0.288, -0.015)),
    ("L_Collar", "Spine3", (0.081, 0.195, -0.006)),
    ("R_Collar", "Spine3", (-0.079, 0.193, -0.011)),
    ("Head", "Neck", (0.005, 0.353, 0.037)),
    ("L_Shoulder", "L_Collar", (0.172, 0.226, -0.015)),
    ("R_Shoulder", "R_Collar", (-0.175, 0.225, -0.020)),
    ("L_Elbow", "L_Shoulder", (0.432, 0.213, -0.042)),
    ("R_Elbow", "R_Shoulder", (-0.429, 0.212, -0.041)),
    ("L_Wrist", "L_Elbow", (0.681, 0.222, -0.044)),
    ("R_Wrist", "R_Elbow", (-0.684, 0.220, -0.047)),
    ("L_Hand", "L_Wrist", (0.765, 0.214, -0.059)),
    ("R_Hand", "R_Wrist", (-0.769, 0.213, -0.057)),
)
BODY = 22  # joints that all of these bodies begin with; SMPL has the hands besides, the others have fingers
# Numbers of a pose by what it is of.
WIDTHS = {3 * 24: "SMPL", 3 * 52: "SMPL-H", 3 * 55: "SMPL-X", 3 * BODY: "SMPL's body"}


def smpl_skeleton(hands: bool) -> Skeleton:
    """The joints in metres, with the hands of SMPL or with these as the ends of the wrists."""
    count = len(_JOINTS) if hands else BODY
    names = [name for name, _, _ in _JOINTS]
    parents = [names.index(parent) if parent else -1 for _, parent, _ in _JOINTS]
    places = np.array([place for _, _, place in _JOINTS])
    offsets = places - np.where(np.array(parents)[:, None] >= 0, places[parents], 0.0)
    ends = {parents[j]: (*offsets[j].tolist(),) for j in range(count, len(_JOINTS))}
    return Skeleton(
        tuple(names[:count]), tuple(parents[:count]), offsets[:count].astype(np.float32), ends, cm=100.0
    )


def smpl_motion(poses: Array, places: Array, fps: float, up: str | None = None) -> Motion:
    """The motion, in metres, of poses (T, W) as exponential maps, W one of WIDTHS, and places (T, 3) of the body.

    up is the axis that points up, if it is known.
    """
    skeleton = replace(smpl_skeleton(hands=WIDTHS[poses.shape[1]] == "SMPL"), up=up)
    turns = poses.reshape(len(poses), -1, 3)[:, : len(skeleton)].astype(np.float64)
    return Motion(
        skeleton,
        quat_continuous(expmap_to_quat(turns)).astype(np.float32),
        (places + skeleton.offsets[0]).astype(np.float32),
        fps,
    )
