"""Read any BVH file, retarget it to the 23 joints, and print its facts.

python examples/01_read_and_inspect_bvh.py examples/data/35_01.bvh
"""

from __future__ import annotations

import argparse
from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.motion.bvh import read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.rig.retarget import retarget


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    arguments = parser.parse_args()

    # The content of the file: its own joints, channels and units, angles in degrees.
    bvh = read_bvh(arguments.file)
    frames, channels = bvh.values.shape
    print(f"{len(bvh.skeleton)} joints, {channels} channels, {frames} frames at {bvh.fps:g} fps")
    for name, parent in zip(bvh.skeleton.names, bvh.skeleton.parents, strict=True):
        above = bvh.skeleton.names[parent] if parent >= 0 else "the world"
        print(f"  {name} under {above}")

    # The motion in motionkit: 23 joints, centimetres, radians.
    motion, report = retarget(bvh)
    print(f"1 unit is {report.scale:.4g} cm ({report.scale_source}); leg length {report.leg_length:.1f} cm")
    print(f"joints without a source: {', '.join(report.missing) or 'none'}")
    _, positions = motion_kinematics(motion)
    head = positions[:, motion.skeleton.index("Head"), 1]
    print(f"{motion.seconds:.2f} s; the head is between {head.min():.0f} and {head.max():.0f} cm high")


if __name__ == "__main__":
    try:
        main()
    except MotionkitError as error:
        raise SystemExit(f"error: {error}") from None
