"""BVH files to Skeleton and Motion and back: rotations, kinematics, retargeting, mirroring, foot IK."""
