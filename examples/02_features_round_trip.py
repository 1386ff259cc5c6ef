"""Encode a motion as 276 features per frame, decode it, and print the error.

python examples/02_features_round_trip.py examples/data/49_06.bvh
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from motionkit.data.cleaning import clean
from motionkit.features.decode import decode_motion
from motionkit.features.encode import encode_motion
from motionkit.features.layout import LAYOUTS, feature_layout
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion, resample
from motionkit.motion.rotations import quat_angle
from motionkit.rig.retarget import retarget_file


def print_round_trip(motion: Motion, layout: str) -> None:
    """Print the error of one layout of the features, and the largest step of its root rotation."""
    encoded = encode_motion(motion, layout=layout)
    decoded = decode_motion(encoded.features, motion.skeleton, motion.fps, encoded.ground[0], layout=layout)
    distance = np.linalg.norm(motion_kinematics(decoded)[1] - motion_kinematics(motion)[1], axis=-1).max()
    turn = quat_angle(
        decoded.local_rotations.astype(np.float64), motion.local_rotations.astype(np.float64)
    ).max()
    root = encoded.features[:, feature_layout(layout).blocks["root_rotation"]]
    leap = np.linalg.norm(np.diff(root, axis=0), axis=-1).max()
    print(f"{layout}: joints within {distance:.5f} cm, rotations within {np.rad2deg(turn):.5f} degrees")
    print(f"  largest step of the root rotation from frame to frame: {leap:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    arguments = parser.parse_args()

    motion, _ = retarget_file(arguments.file)
    motion, _ = clean(motion)
    motion = resample(motion, 60.0)
    for layout in LAYOUTS:
        print_round_trip(motion, layout)
    contacts = encode_motion(motion).contacts.mean(axis=0)
    for name, share in zip(("left foot", "left toe", "right foot", "right toe"), contacts, strict=True):
        print(f"{name} on the floor: {100 * share:.0f} % of the frames")


if __name__ == "__main__":
    main()
