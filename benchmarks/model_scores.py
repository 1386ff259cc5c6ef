"""What a model does when left to itself, for every type, against the real motion of a dataset.

    python benchmarks/model_scores.py MODEL DATASET [--seeds 5] [--seconds 8] [--noise correlated:0.3]

Prints Markdown tables; the model card quotes them. The baseline of every ratio is the recorded motion.
"""

from __future__ import annotations

import argparse
from collections import defaultdict

import torch

from motionkit.data.dataset import Dataset
from motionkit.models.checkpoint import MotionModel, load_model
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.skeleton import JOINT_NAMES
from motionkit.synthesis.plan import parse_types
from motionkit.synthesis.rollout import Noise
from motionkit.synthesis.synthesize import SynthesisOptions, synthesize
from motionkit.training.scores import score_rollouts

FLIPS = ("cartwheel", "backflip", "handspring", "side-somersault", "dive-roll", "w-kicking")


def type_table(model: MotionModel, dataset: Dataset, seeds: int, seconds: float, noise: Noise) -> None:
    """Mean scores per type over seeds."""
    sums: dict[str, list] = defaultdict(list)
    for seed in range(seeds):
        for score in score_rollouts(model, dataset, int(seconds * model.fps), seed=seed, noise=noise):
            sums[score.type].append(score)
    print(
        f"{seconds:g} s from each type's own start, {seeds} seeds, no trajectory, no foot locking, noise {noise}\n"
    )
    print("| type | joint speed / real | distance to a real pose, cm | toe slide / real | root height, cm |")
    print("|---|---|---|---|---|")
    for kind, scores in sums.items():
        means = [
            sum(getattr(s, f) for s in scores) / len(scores)
            for f in ("joint_speed", "pose_distance", "slide")
        ]
        low, high = min(s.height[0] for s in scores), max(s.height[1] for s in scores)
        print(f"| {kind} | {means[0]:.2f} | {means[1]:.1f} | {means[2]:.2f} | {low:.0f} to {high:.0f} |")


def flip_table(model: MotionModel, seeds: int, noise: Noise) -> None:
    """How often a flip asked for after a run or a walk turns the body over: the head below the hips."""
    print("\n| asked for | head below hips | and up again |")
    print("|---|---|---|")
    head, hips = JOINT_NAMES.index("Head"), 0
    for kind in FLIPS:
        if kind not in model.types:
            continue
        for before in ("running", "walking"):
            options = SynthesisOptions(count=seeds, seed=0, noise=noise)
            parts = parse_types(f"{before}:3,{kind},{before}:2", None, model.phase_seconds)
            over = back = 0
            for made in synthesize(model, parts, options).motions:
                _, positions = motion_kinematics(made.motion)
                below = positions[:, head, 1] < positions[:, hips, 1]
                over += bool(below.any())
                back += bool(below.any()) and bool((~below[-60:]).all())
            print(f"| {before}, {kind} | {over} of {seeds} | {back} of {seeds} |")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model")
    parser.add_argument("dataset")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--noise", default="correlated:0.3", help="kind:temperature")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    kind, _, temperature = arguments.noise.partition(":")
    noise = Noise(kind, float(temperature or 0.3))
    model, dataset = load_model(arguments.model), Dataset(arguments.dataset)
    type_table(model, dataset, arguments.seeds, arguments.seconds, noise)
    flip_table(model, 4 * arguments.seeds, noise)


if __name__ == "__main__":
    main()
