"""Motion of the ONNX graph in closed loop with 32-bit and 8-bit weights: is it equally good?

    python benchmarks/engine_weights.py [--model FILE] [--seconds 20]

A walk and a run straight ahead, and cartwheels as recorded, from the same starts, with the same controls and
the same noise. Drifting apart is to be expected; speeds, heights and sliding of the feet should agree. Jerk
tells of trembling.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import print_table

from motionkit.arrays import Array
from motionkit.control.opening import Shown, last_poses
from motionkit.control.plan import plan_types
from motionkit.control.planned_controls import plan_controls
from motionkit.control.script import TypePart
from motionkit.export.onnx_export import WEIGHTS, OnnxStep, build_graph
from motionkit.features.control import TRAJECTORY_OFFSETS, Controls
from motionkit.features.layout import FEATURE_COUNT
from motionkit.inference.rollout import Noise
from motionkit.inference.start import type_start
from motionkit.metrics.foot_sliding import average_foot_sliding
from motionkit.metrics.smoothness import mean_jerk
from motionkit.models.bundled import open_model
from motionkit.models.model import MotionModel
from motionkit.motion.floor import floor_height, foot_positions

ASKED = {"walking": 130.0, "running": 300.0, "cartwheel": None}  # cm/s straight ahead; None: as recorded


def signals(model: MotionModel, kind: str, speed: float | None, frames: int) -> Controls:
    """The controls of each frame."""
    seen = type_start(model, kind, 1).features[0]
    plan = plan_types(model, [TypePart(kind, frames / model.fps)], Shown(last_poses(model, seen)))
    recorded = plan_controls(model, plan)
    if speed is None:
        return recorded
    ahead = np.zeros((len(TRAJECTORY_OFFSETS), 2), np.float32)
    ahead[:, 1] = speed / model.fps * np.array(TRAJECTORY_OFFSETS)
    facing = np.tile(np.float32([0.0, 1.0]), (len(TRAJECTORY_OFFSETS), 1))
    way = np.tile(np.concatenate([ahead, facing]).reshape(1, -1), (frames, 1))
    return replace(Controls.of_types(recorded.type_weights), trajectory=way).with_mask(1.0)


def roll(model: MotionModel, path: Path, kind: str, asked: Controls) -> Array:
    """Return joint positions (T, 23, 3) in cm of the graph in closed loop."""
    graph = OnnxStep(path)
    start = type_start(model, kind, 1)
    graph.values["type_weights"][0, model.type_id(kind)] = 1.0
    graph.values["phase"][:], graph.values["slip_correction"][:] = -1.0, 1.0
    poses, contacts = model.scaling.normalize(start.features)[0], start.contacts[0]
    for t in range(len(poses)):
        graph.values["pose"][:], graph.values["contacts"][:] = poses[t], contacts[t]
        if t + 1 < len(poses):
            graph.step()
    graph.values["ground"][:] = 0.0
    random = np.random.default_rng(0)
    noise, settings = np.zeros((2, 1, FEATURE_COUNT)), Noise()
    keeps, takes, keeps_too, takes_too = settings.filters
    out = []
    for frame in range(len(asked.phase)):
        noise[0] = keeps * noise[0] + takes * random.standard_normal(noise[0].shape)
        noise[1] = keeps_too * noise[1] + takes_too * noise[0]
        graph.values["noise"][:] = settings.temperature * model.types[kind].preset.noise_scale * noise[1]
        for name, values in vars(asked).items():
            if name != "type_weights":
                graph.values[name][:] = values[frame]
        out.append(graph.step()["positions"][0].copy())
    return np.stack(out)


def measures(positions: Array, fps: float) -> list[str]:
    """Return speed, foot sliding, heights and jerk, formatted."""
    feet = foot_positions(positions)
    heights = positions[..., 1]
    return [
        f"{np.linalg.norm(np.diff(positions, axis=0), axis=-1).mean() * fps:.1f}",
        f"{average_foot_sliding(feet, floor_height(feet)).value:.3f}",
        f"{heights[:, 0].mean():.1f}",
        f"{heights.min():.1f}",
        f"{heights.max():.1f}",
        f"{mean_jerk(positions).value:.0f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", type=Path, help="a model file; the bundled model by default")
    parser.add_argument("--seconds", type=float, default=20.0, help="seconds of each type")
    arguments = parser.parse_args()
    model = open_model(arguments.model)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        paths = {weights: Path(folder) / f"{weights}.onnx" for weights in WEIGHTS}
        for weights, path in paths.items():
            path.write_bytes(build_graph(model, weights=weights).SerializeToString())
        for kind, speed in ASKED.items():
            asked = signals(model, kind, speed, round(arguments.seconds * model.fps))
            for weights, path in paths.items():
                rows.append([f"{kind}, {weights}", *measures(roll(model, path, kind, asked), model.fps)])
    header = [
        "type, weights",
        "joint speed cm/s",
        "AFS cm/frame",
        "hips cm",
        "lowest cm",
        "highest cm",
        "jerk m/s^3",
    ]
    print_table("motion of the graph in closed loop", header, rows)


if __name__ == "__main__":
    main()
