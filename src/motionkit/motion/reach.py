"""Whole-body inverse kinematics of one pose: joints reach points, by damped least squares.

Limbs turn most, the spine turns a little, and the root moves too if it may.
"""

from __future__ import annotations

import numpy as np

from motionkit.arrays import Array, cross
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.rotations import expmap_to_quat, quat_inverse, quat_multiply, quat_normalize
from motionkit.motion.skeleton import Skeleton

ITERATIONS = 60
DAMPING = 4.0  # cm of error that cost as much as a turn of one radian at weight 1
STIFF = ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "LeftShoulder", "RightShoulder")
STIFF_WEIGHT = 0.15  # weight of the stiff joints; limbs have 1
ROOT_WEIGHT = 3.0  # cm of root movement that cost as much as a turn of one radian at weight 1
NEAR = 0.01  # cm; error at which the iterations end


def reach(
    rotations: Array, root: Array, skeleton: Skeleton, targets: dict[int, Array], root_moves: bool = True
) -> tuple[Array, Array, float]:
    """Find a pose near a given one in which joints are at their points.

    Args:
        rotations: (J, 4) local rotations.
        root: (3,) position of the root, cm.
        skeleton: the skeleton, in cm.
        targets: joint index to its point (3,) in the world, cm.
        root_moves: whether the root may move along the ground.

    Returns:
        Local rotations (J, 4), the root (3,), and the largest distance left, cm.
    """
    turns, place = rotations.astype(np.float64), root.astype(np.float64)
    weights = np.array([STIFF_WEIGHT if name in STIFF else 1.0 for name in skeleton.names])
    weights[0] = 0.0  # the body keeps its heading
    goal = np.concatenate([targets[joint] for joint in targets]).astype(np.float64)
    for _ in range(ITERATIONS):
        world, at = forward_kinematics(turns, place, skeleton.offsets.astype(np.float64), skeleton.parents)
        missing = goal - np.concatenate([at[joint] for joint in targets])
        if float(np.abs(missing).max()) < NEAR:
            break
        slopes, columns = _slopes(at, skeleton, list(targets), weights, root_moves)
        # Short steps while far away, because the linear model fails for turns of more than half a radian.
        error = missing * min(1.0, 15.0 / max(float(np.linalg.norm(missing)), 1e-9))
        damping = (DAMPING if float(np.linalg.norm(missing)) > 5.0 else 0.5) ** 2 * np.eye(len(slopes))
        step = slopes.T @ np.linalg.solve(slopes @ slopes.T + damping, error)
        for number, joint in enumerate(columns):
            turn = expmap_to_quat(weights[joint] * step[3 * number : 3 * number + 3])
            parent = skeleton.parents[joint]
            above = world[parent] if parent >= 0 else np.array([1.0, 0.0, 0.0, 0.0])
            inner = quat_multiply(quat_inverse(above), quat_multiply(turn, above))
            turns[joint] = quat_normalize(quat_multiply(inner, turns[joint]))
        if root_moves:
            place = place + ROOT_WEIGHT * np.array([step[-2], 0.0, step[-1]])
    _, at = forward_kinematics(turns, place, skeleton.offsets.astype(np.float64), skeleton.parents)
    left = max(float(np.linalg.norm(targets[joint] - at[joint])) for joint in targets)
    return turns.astype(rotations.dtype), place.astype(root.dtype), left


def _slopes(
    at: Array, skeleton: Skeleton, joints: list[int], weights: Array, root_moves: bool
) -> tuple[Array, list[int]]:
    """The Jacobian of the joints' positions (3 N rows) for turns about world axes, and the joints that turn."""
    above = {joint: set(skeleton.path(joint)[:-1]) for joint in joints}
    columns = sorted(joint for joint in set().union(*above.values()) if weights[joint] > 0.0)
    slopes = np.zeros((3 * len(joints), 3 * len(columns) + (2 if root_moves else 0)))
    axes = np.eye(3)
    for row, joint in enumerate(joints):
        for number, turning in enumerate(columns):
            if turning in above[joint]:
                arm = np.broadcast_to(at[joint] - at[turning], (3, 3))
                slopes[3 * row : 3 * row + 3, 3 * number : 3 * number + 3] = (
                    weights[turning] * cross(axes, arm).T
                )
        if root_moves:
            slopes[3 * row, -2] = slopes[3 * row + 2, -1] = ROOT_WEIGHT
    return slopes, columns
