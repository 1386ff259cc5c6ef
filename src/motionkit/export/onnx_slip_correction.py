"""The root-slip correction as ONNX nodes, as in inference/slip_correction.py."""

from __future__ import annotations

import numpy as np

from motionkit.export.onnx_graph import Graph
from motionkit.features.layout import FEATURE_COUNT, feature_layout
from motionkit.inference import slip_correction
from motionkit.models.model import MotionModel
from motionkit.motion.leg_ik import FOOT_SHARES, HOLD


def hold_ground(g: Graph, model: MotionModel, drawn: str) -> str:
    """Write the corrected sampled pose (1, 276) as present_pose, and return its name."""
    blocks = feature_layout(model.config.layout).blocks
    yaw, xz = blocks["root_yaw_velocity"].start, blocks["root_xz_velocity"].start
    slip_corrections = model.presets("slip_correction")[:, None]
    share = g.add("MatMul", "type_weights", slip_corrections * np.float32(model.fps))
    share = g.add("Mul", share, "slip_correction")
    by = g.add("Mul", _standing_move(g, model, drawn, (yaw, xz)), share)
    # The correction subtracts from the turn and adds to the step.
    columns = np.zeros((3, FEATURE_COUNT), np.float32)
    columns[[0, 1, 2], [yaw, xz, xz + 1]] = -1.0, 1.0, 1.0
    std = model.scaling.std
    return g.add("Gemm", by, columns / std, drawn, out="present_pose")


def _standing_move(g: Graph, model: MotionModel, drawn: str, velocities: tuple[int, int]) -> str:
    """Write the correction (1, 3): what to subtract from the root's turn and to add to its step."""
    x, y, z = slip_correction.foot_columns(model.config.layout).T
    yaw, xz = velocities
    mean, std = model.scaling.mean, model.scaling.std
    reaches, shares = np.array(slip_correction.REACHES), np.array(FOOT_SHARES)
    # All linear functions of the frame at once: foot positions x and z without the turn; their lever arms, z and -x;
    # height terms of the feet; the turn, and the turn plus a quarter turn.
    of_frame, plus = np.zeros((FEATURE_COUNT, 22)), np.zeros(22)
    feet = np.arange(4)
    of_frame[x, feet] = of_frame[z, 4 + feet] = of_frame[z, 8 + feet] = 1.0
    of_frame[x, 12 + feet] = -1.0
    of_frame[xz, :4] = of_frame[xz + 1, 4:8] = of_frame[yaw, 20:] = 1.0 / model.fps
    of_frame[y, 16 + feet], plus[16:20] = -shares / reaches, shares * (1.0 + slip_correction.FLOOR / reaches)
    plus[21] = 0.5 * np.pi
    unscaled = g.add("Gemm", drawn, std[:, None] * of_frame, mean @ of_frame + plus)
    here, low, turns = g.split(unscaled, [16, 4, 2], axis=1)
    # Previous foot positions in the current heading frame: sine and cosine times x, z, z and x.
    factors = np.zeros((2, 16))
    factors[0, 4:8], factors[0, 12:], factors[1, :4], factors[1, 8:12] = -1.0, 1.0, 1.0, 1.0
    at = np.concatenate([x, z, z, x])
    of_pose = np.zeros((FEATURE_COUNT, 16))
    of_pose[at, np.arange(16)] = std[at]
    before = g.add("Gemm", "pose", of_pose, mean[at])
    turned = g.add("Mul", before, g.add("MatMul", g.add("Sin", turns), factors))
    away = np.zeros((16, 16))
    away[:8, :4] = away[8:, 4:8] = -np.concatenate([np.eye(4), np.eye(4)])
    # Rows: moves along x and z, then lever arms along x and z. Columns: foot joints.
    both = g.reshape(g.add("Gemm", turned, away, here), 4, 4)
    # The weight of each foot joint.
    low = g.add("Min", g.add("Max", low, np.float32(0.0)), shares)
    moves = g.add("Mul", both, np.array([[1.0], [1.0], [0.0], [0.0]]))
    moved = g.add("ReduceL2", moves, axes=[0], keepdims=1)
    weight = g.add("Div", low, g.add("Add", moved, np.float32(HOLD.ease)))
    weight = g.add("Div", weight, g.add("Gemm", weight, np.ones((4, 4)), np.full(4, 1e-9)))
    means = g.add("Gemm", both, weight, transB=1)
    off = g.add("Sub", both, means)
    shared = g.add("Gemm", g.add("Mul", off, weight), off, transB=1)
    # The turn of all feet about their common centre, and their distance from it.
    of_shared = np.zeros((16, 2))
    of_shared[[2, 7], 0] = of_shared[[10, 15], 1] = 1.0
    turn = g.add("Gemm", g.reshape(shared, 1, 16), of_shared, np.array([0.0, slip_correction.STIFFNESS]))
    angle = g.add("Div", *g.split(turn, [1, 1], axis=1))
    by = g.add("Concat", g.constant([[-1.0]]), angle, axis=1)
    step = g.add("MatMul", by, g.reshape(means, 2, 2))
    holds = g.add("Min", g.add("MatMul", low, np.full((4, 1), 1.0 / HOLD.enough)), np.float32(1.0))
    size = g.add("ReduceL2", step, axes=[1], keepdims=1)
    holds = g.add("Div", holds, g.add("Gemm", size, np.full((1, 1), 1.0 / slip_correction.LIMIT), np.ones(1)))
    return g.add("Mul", g.add("Concat", angle, step, axis=1), holds)
