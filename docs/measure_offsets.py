"""Measures the offsets of the canonical skeleton (docs/conventions.md) from CMU files.

python docs/measure_offsets.py FOLDER...

Prints how many subjects were found, and the largest difference to the offsets of the package in cm.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import motionkit as mk
from motionkit.motion.skeleton import JOINT_NAMES, MIRROR_JOINTS, PARENTS

CM_PER_UNIT = 2.54 / 0.45  # of CMU's files


def main(folders: list[str]) -> None:
    """Measure all BVH files below the folders that carry the CMU joint names, one of each subject."""
    bodies = {}
    parents = ["Hips" if parent < 0 else JOINT_NAMES[parent] for parent in PARENTS]
    for path in (path for folder in folders for path in sorted(Path(folder).rglob("*.bvh"))):
        skeleton = mk.read_bvh(path).skeleton
        if set(JOINT_NAMES) <= set(skeleton.names):
            places = dict(zip(skeleton.names, skeleton.rest_positions() * CM_PER_UNIT, strict=True))
            offsets = [
                places[joint] - places[parent] for joint, parent in zip(JOINT_NAMES, parents, strict=True)
            ]
            bodies.setdefault(path.stem.split("_")[0], np.stack(offsets))
    both = np.stack(list(bodies.values()))
    both = np.concatenate([both, both[:, list(MIRROR_JOINTS)] * [-1.0, 1.0, 1.0]])
    difference = np.median(both, axis=0) - mk.canonical_skeleton().offsets
    print(len(bodies), "subjects; largest difference", np.abs(difference).max())


if __name__ == "__main__":
    main(sys.argv[1:])
