"""What a network is worth on held-out clips, in a few numbers that seeds can be paired by: likelihood and errors.

All networks see the same windows, and roll out from the same frames with the same random numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from motionkit.arrays import Array, Floats
from motionkit.data.dataset import Dataset
from motionkit.features.decode import decode_rotations, integrate_ground, root_height
from motionkit.features.layout import FEATURE_COUNT, FeatureLayout
from motionkit.inference.start import INIT_FRAMES
from motionkit.lab.held_out import INITIAL, HeldOut, decoded, held_out
from motionkit.lab.paper.batched_rollouts import recorded, roll_out
from motionkit.lab.statistics import rounded
from motionkit.metrics.body_movement import euler_movement
from motionkit.models.network import PartTransformer
from motionkit.models.predictor import NextFrame, Predictor, stacked
from motionkit.motion.kinematics import forward_kinematics
from motionkit.motion.skeleton import PARENTS
from motionkit.training.losses import gaussian_loss

WINDOW = 160  # frames
STRIDE = (
    WINDOW - INIT_FRAMES
)  # every frame is predicted once, from the paper's receptive field where the clip has it
FEWEST = INITIAL[-1]  # frames before the first one that is predicted
TOGETHER = 16  # windows per product
HORIZONS = {"0.25": 15, "0.5": 30, "1": 60}  # frames of an open-loop roll-out by seconds
MOST_STARTS = 24  # most starts of open-loop roll-outs


def held_out_errors(
    network: Predictor,
    dataset: Dataset,
    device: torch.device | str = "cpu",
    seed: int = 0,
    labelled: bool = False,
) -> dict[str, Any]:
    """Return errors and likelihood of a network on the test clips of its dataset.

    Returns:
        "frames", how many are predicted from recorded ones, one by one. "nll" and "nll-trajectory", their negative
        log-likelihood per frame, of networks that predict Gaussians. "error", the RMS error by block of features in
        normalised units; "copy" and "extrapolation", the same for repeating the last frame and the last step.
        "starts", the number of roll-outs of a second with recorded controls. "open-loop", by "mean" and by "sample",
        after each of HORIZONS the distance of joints under the root ("mpjpe-1") and of the root over the ground
        ("root-1") in cm. "bm", the body movement of these roll-outs in degrees per frame, and "recorded".
    """
    network.eval()
    one_by_one = _teacher_forced(network, dataset, torch.device(device))
    return one_by_one | _open_loop(network, dataset, torch.device(device), seed, labelled)


# ---- from recorded frames, one by one ----


def _teacher_forced(network: Predictor, dataset: Dataset, device: torch.device) -> dict[str, Any]:
    blocks = _blocks(dataset.layout)
    totals: dict[str, float] = {}
    squares = {
        method: torch.zeros(FEATURE_COUNT, dtype=torch.float64)
        for method in ("error", "copy", "extrapolation")
    }
    paths = dict.fromkeys(squares, 0.0)
    count = 0
    for arrays in _windows(dataset, network.config.controls):
        x, path, contacts, controls, mask = (each.to(device) for each in arrays)
        made = _predicted(network, x[:, 1:-1], contacts, controls)
        guesses = {"error": (made.mean, made.trajectory_mean)}
        guesses["copy"] = (x[:, 1:-1], path[:, 1:-1])
        guesses["extrapolation"] = (2.0 * x[:, 1:-1] - x[:, :-2], 2.0 * path[:, 1:-1] - path[:, :-2])
        for method, (guess, path_guess) in guesses.items():
            off = ((guess - x[:, 2:]).square() * mask[..., None]).double()
            squares[method] += off.sum((0, 1)).cpu()
            if path_guess is not None:
                paths[method] += float(((path_guess - path[:, 2:]).square().mean(-1) * mask).double().sum())
        for name, value in _likelihoods(made, x[:, 2:], path[:, 2:], mask).items():
            totals[name] = totals.get(name, 0.0) + value * mask.numel()
        count += int(mask.sum())
        has_path = made.trajectory_mean is not None
    errors = {
        method: {name: _root(float(each[columns].mean()), count) for name, columns in blocks.items()}
        | ({"trajectory": _root(paths[method], count)} if has_path or method != "error" else {})
        for method, each in squares.items()
    }
    return {"frames": count, **{name: _number(total / count) for name, total in totals.items()}, **errors}


def _root(total: float, count: int) -> float | None:
    return _number((total / count) ** 0.5)


def _number(value: float) -> float | None:
    """A rounded value; None where a network predicts numbers that are not finite."""
    return rounded(value, 5) if np.isfinite(value) else None


def _blocks(layout: FeatureLayout) -> dict[str, list[int]]:
    """Columns by what they hold; those of the root are apart."""
    root = layout.joint_columns(0)
    names = {
        "rotations": ("joint_rotations",),
        "positions": ("joint_positions",),
        "velocities": ("joint_angular_velocities", "joint_velocities"),
    }
    found = {
        name: [i for i, column in enumerate(layout.columns) if column.block in blocks and i not in root]
        for name, blocks in names.items()
    }
    return found | {"root": root}


def _windows(dataset: Dataset, kind: str) -> Iterator[list[Tensor]]:
    """Yield the windows of all test clips, some at a time; each frame after the first FEWEST is predicted once.

    They are features and trajectories of WINDOW frames and of those beside them, contacts, controls, and a mask (B, T)
    of the frames whose successor is predicted.
    """
    cut: list[tuple[Array, ...]] = []
    for clip in dataset.select("test"):
        whole, last = recorded(dataset, clip, dataset.read(clip), kind), clip.frames - 1
        for first in range(0, last, STRIDE):
            known = first + INIT_FRAMES + 1 if first else FEWEST  # the first frame that counts
            if known <= last:
                places = np.arange(first - 1, first + WINDOW + 1)
                mask = ((places[2:] >= known) & (places[2:] <= last)).astype(np.float32)
                at = np.clip(places, 0, last)
                rest = (whole.contacts[at[1:-1]], whole.controls[at[1:-1]], mask)
                cut.append((whole.x[at], whole.trajectory[at], *rest))
    for begin in range(0, len(cut), TOGETHER):
        yield [torch.from_numpy(np.stack(each)) for each in zip(*cut[begin : begin + TOGETHER], strict=True)]


@torch.inference_mode()
def _predicted(network: Predictor, x: Tensor, contacts: Tensor, controls: Tensor) -> NextFrame:
    """The predictions for all frames of windows, from recorded ones: at once by part transformers, else one by one."""
    if isinstance(network, PartTransformer):
        return network(x, contacts, controls)
    stream = network.stream(len(x))
    stream.reset(WINDOW)  # all are given, so that each is looked at
    return stacked([stream.step(x[:, t], contacts[:, t], controls[:, t]) for t in range(WINDOW)])


def _likelihoods(made: NextFrame, targets: Tensor, path: Tensor, mask: Tensor) -> dict[str, float]:
    """Negative log-likelihoods of the Gaussians that are predicted; a sigma that is always the same predicts none."""
    pairs = {
        "nll": (made.mean, made.log_sigma, targets),
        "nll-trajectory": (made.trajectory_mean, getattr(made, "trajectory_log_sigma", None), path),
    }
    return {
        name: float(gaussian_loss(mean.double(), log_sigma.double(), target.double(), mask))
        for name, (mean, log_sigma, target) in pairs.items()
        if mean is not None and log_sigma is not None and float(log_sigma.max() - log_sigma.min()) > 0.0
    }


# ---- from its own frames ----


def open_loop_starts(dataset: Dataset) -> list[HeldOut]:
    """Return stretches of a second in all test clips, one after another, spread evenly if there are many."""
    second = max(HORIZONS.values())
    out = []
    for sequence in held_out(dataset, second):
        first = sequence.initial if sequence.clip.frames >= sequence.initial + second else FEWEST
        places = range(first, sequence.clip.frames - second + 1, second)
        out += [replace(sequence, initial=place, frames=second) for place in places]
    return [
        out[i]
        for i in np.unique(np.linspace(0, len(out) - 1, min(len(out), MOST_STARTS)).round().astype(int))
    ]


def _open_loop(
    network: Predictor, dataset: Dataset, device: torch.device, seed: int, labelled: bool
) -> dict[str, Any]:
    starts = open_loop_starts(dataset)
    if not starts:
        return {"starts": 0, "open-loop": {"mean": {}, "sample": {}}, "bm": {}}
    draws: list[int | None] = [None] * len(starts)
    draws += [seed * 1009 + number for number in range(len(starts))]
    made = roll_out(network, dataset, [*starts, *starts], draws, device, labelled)
    methods = {"mean": made[: len(starts)], "sample": made[len(starts) :]}
    truth = [each.data.features[each.initial : each.initial + each.frames] for each in starts]
    distances = {method: _distances(dataset, starts, frames, truth) for method, frames in methods.items()}
    moved = {
        method: _number(
            float(np.mean([_movement(dataset, *pair) for pair in zip(starts, frames, strict=True)]))
        )
        for method, frames in {**methods, "recorded": truth}.items()
    }
    return {"starts": len(starts), "open-loop": distances, "bm": moved}


def _movement(dataset: Dataset, start: HeldOut, features: Floats) -> float:
    return float(euler_movement(decoded(dataset, start, features).local_rotations).sum(-1).mean())


def _distances(
    dataset: Dataset, starts: Sequence[HeldOut], made: Sequence[Floats], truth: Sequence[Floats]
) -> dict[str, float | None]:
    """Mean distances in cm after each horizon: of the joints, with the root at its place, and of the root."""
    (poses, grounds), (true_poses, true_grounds) = (_places(dataset, starts, each) for each in (made, truth))
    out: dict[str, float | None] = {}
    for name, frame in HORIZONS.items():
        apart = np.linalg.norm(poses[:, frame - 1] - true_poses[:, frame - 1], axis=-1)
        distance = np.linalg.norm(grounds[:, frame - 1] - true_grounds[:, frame - 1], axis=-1)
        out |= {
            f"mpjpe-{name}": _number(float(apart.mean())),
            f"root-{name}": _number(float(distance.mean())),
        }
    return out


def _places(dataset: Dataset, starts: Sequence[HeldOut], features: Sequence[Floats]) -> tuple[Array, Array]:
    """Joints (N, T, 23, 3) under the root, in the heading frame, and the root (N, T, 3) in the world, in cm."""
    layout = dataset.layout.version
    last = np.stack([each.data.features[each.initial - 1] for each in starts])
    together = np.stack(features)
    origin = np.stack([each.data.ground[each.initial - 1] for each in starts])
    ground = integrate_ground(np.concatenate([last[:, None], together], axis=1), origin, dataset.fps, layout)[
        :, 1:
    ]
    rotations = decode_rotations(together, dataset.reference_rotations, layout)
    bones = np.stack([dataset.bodies[each.clip.body] for each in starts])[:, None]
    _, poses = forward_kinematics(rotations, np.zeros((*together.shape[:2], 3), np.float32), bones, PARENTS)
    height = root_height(together, layout)
    return poses, np.stack([ground[..., 0], height, ground[..., 1]], axis=-1)


# ---- by its controls ----


def control_derivatives(network: Predictor, dataset: Dataset, sequence: HeldOut) -> dict[str, float]:
    """Return the gain of the predicted trajectory on the trajectory fed in, and on the features fed in.

    Of part transformers only; other networks return nothing. Paper section 5.5, "Where and how to input the control
    signals", explains by it why a fed-back trajectory does not explode: derivatives of the output by the controls
    around 150 exploded within a few frames, those around 4 did not. The norm is not given there; here it is the largest
    singular value of the Jacobian at the last frame of a window, in normalised units.
    """
    if not isinstance(network, PartTransformer):
        return {}
    device = network.aggregate.weight.device
    whole = recorded(dataset, sequence.clip, sequence.data, network.config.controls)
    features, contacts, controls = (
        torch.tensor(each[None, : sequence.initial], device=device)
        for each in (whole.x, whole.contacts, whole.controls)
    )
    features.requires_grad_()
    controls.requires_grad_()
    with torch.backends.cudnn.flags(enabled=False):  # recurrent layers have no gradients in evaluation mode
        made = network(features, contacts, controls).trajectory_mean[0, -1]
        rows = [torch.autograd.grad(value, (features, controls), retain_graph=True) for value in made]
    by_features = torch.stack([row[0][0, -1] for row in rows])
    by_trajectory = torch.stack([row[1][0, -1, network.trajectory_columns] for row in rows])
    return {
        name: rounded(torch.linalg.matrix_norm(matrix, 2).item())
        for name, matrix in (("trajectory", by_trajectory), ("features", by_features))
    }
