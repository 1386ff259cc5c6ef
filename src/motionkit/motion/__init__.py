"""Rotations, skeletons, motions, BVH text, kinematics, mirror images."""
