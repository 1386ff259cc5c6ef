"""Grip as ONNX nodes: feet on the ground hold the root, as synthesis/grip.py has it."""

from __future__ import annotations

import numpy as np

from motionkit.apps.onnx_graph import Graph
from motionkit.features.layout import FEATURE_COUNT, feature_layout
from motionkit.models.checkpoint import MotionModel
from motionkit.synthesis import grip


def hold_ground(g: Graph, model: MotionModel, features: str, pose: str) -> str:
    """Nodes from drawn features (1, 276), unnormalised, and pose (1, 276) to those with the way that feet allow.

    Writes present_pose and answers the features.
    """
    blocks = feature_layout(model.config.layout).blocks
    yaw, xz = blocks["root_yaw_velocity"].start, blocks["root_xz_velocity"].start
    grips = np.array([[model.grip.get(kind, 0.0)] for kind in model.types], np.float32)
    share = g.add("Mul", g.add("MatMul", "type_weights", grips), np.float32(model.fps))
    by = g.add("Mul", _standing_move(g, model, features, (yaw, xz)), share)
    columns = np.zeros((3, FEATURE_COUNT), np.float32)
    columns[[0, 1, 2], [yaw, xz, xz + 1]] = 1.0
    std = model.scaling.std.numpy()
    g.add("Gemm", by, columns / std, pose, out="present_pose")
    return g.add("Gemm", by, columns, features, out="features")


def _standing_move(g: Graph, model: MotionModel, features: str, velocities: tuple[int, int]) -> str:
    """What to add to turn and step of the root (1, 3). Rows of what is (2, 4) are x and z, columns foot joints."""
    x, y, z = grip.foot_columns(model.config.layout).T
    yaw, xz = velocities
    mean, std = model.scaling.mean.numpy(), model.scaling.std.numpy()
    # Where the feet were, turned into the heading frame of now: sine and cosine times x, z, z and x.
    turn = g.gather(features, [yaw], axis=1)
    sines = g.add("Sin", g.add("Gemm", turn, [[1 / model.fps] * 2], [0.0, 0.5 * np.pi]))
    ones = np.ones(4, np.float32)
    factors = np.zeros((2, 16), np.float32)
    factors[0, 4:8], factors[0, 12:], factors[1, :4], factors[1, 8:12] = -ones, ones, ones, ones
    at = np.concatenate([x, z, z, x])
    before = g.add("Add", g.add("Mul", g.gather("pose", at, axis=1), std[at]), mean[at])
    turned = g.add("Mul", before, g.add("MatMul", sines, factors))
    sums = np.kron(np.eye(2), np.concatenate([np.eye(4), np.eye(4)]))
    went = g.add("Mul", g.gather(features, [xz] * 4 + [xz + 1] * 4, axis=1), np.float32(1 / model.fps))
    here = g.add("Add", g.gather(features, np.concatenate([x, z]), axis=1), went)
    moves = g.reshape(g.add("Sub", here, g.add("MatMul", turned, sums)), 2, 4)
    arms = g.gather(features, np.stack([z, x]), axis=1)  # (1, 2, 4)
    arms = g.add("Mul", g.reshape(arms, 2, 4), [[1.0], [-1.0]])
    # How much each holds.
    reaches = np.array(grip.REACHES)
    low = g.add("Mul", g.gather(features, y, axis=1), -1.0 / reaches)
    low = g.add("Clip", g.add("Add", low, 1.0 + grip.FLOOR / reaches), np.float32(0.0), np.float32(1.0))
    low = g.add("Mul", low, np.array(grip.SHARES))
    size = g.add("Add", g.add("ReduceL2", moves, axes=[0], keepdims=1), np.float32(grip.EASE))
    weight = g.add("Div", low, size)
    weight = g.add("Div", weight, g.add("Add", _sum(g, weight), np.float32(1e-9)))
    both = g.add("Concat", moves, arms, axis=0)
    means = g.add("MatMul", both, g.reshape(weight, 4, 1))
    off, about = g.split(g.add("Sub", both, means), [2, 2], axis=0)
    weighted = g.add("Mul", about, weight)
    stiff = g.add("Add", _sum(g, g.add("Mul", weighted, about)), np.float32(grip.STIFFNESS))
    angle = g.add("Neg", g.add("Div", _sum(g, g.add("Mul", weighted, off)), stiff))
    mean_move, mean_arm = g.split(g.reshape(means, 1, 4), [2, 2], axis=1)
    step = g.add("Neg", g.add("Add", mean_move, g.add("Mul", angle, mean_arm)))
    holds = g.add("Min", g.add("Mul", _sum(g, low), np.float32(1.0 / grip.ENOUGH)), np.float32(1.0))
    far = g.add("Mul", g.add("ReduceL2", step, axes=[1], keepdims=1), np.float32(1.0 / grip.LIMIT))
    holds = g.add("Div", holds, g.add("Add", far, np.float32(1.0)))
    return g.add("Mul", g.add("Concat", angle, step, axis=1), holds)


def _sum(g: Graph, value: str) -> str:
    """The sum (1, 1) over both dimensions of a matrix."""
    return g.add("ReduceSum", value, g.constant([0, 1], np.int64), keepdims=1)
