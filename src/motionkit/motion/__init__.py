"""BVH file in, Skeleton and Motion out, and back: rotations, kinematics, retargeting, mirroring."""
