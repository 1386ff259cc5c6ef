"""What a network is worth on held-out clips, in a few numbers that seeds can be paired by: likelihood and errors.

All networks see the same windows, and roll out from the same frames with the same random numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
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
from motionkit.lab.paper.batched_rollouts import Recorded, recorded, roll_out
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
MOST_STARTS = 24  # of open-loop roll-outs


@dataclass(frozen=True, eq=False)
class _Windows:
    """Windows of clips, padded with zeros; attributes as of Recorded, (B, T, ...), with the frames after them.

    Attributes:
        mask: (B, T) 1 for frames whose successor is predicted.
    """

    x: Tensor
    contacts: Tensor
    controls: Tensor
    targets: Tensor
    before: Tensor
    given: Tensor
    next_given: Tensor
    given_before: Tensor
    mask: Tensor


def held_out_errors(
    network: Predictor,
    dataset: Dataset,
    device: torch.device | str = "cpu",
    seed: int = 0,
    labelled: bool = False,
) -> dict[str, Any]:
    """Return errors and likelihood of a network on the test clips of its dataset.

    Args:
        network: on the device; it is left in evaluation mode.
        seed: of the sampled roll-outs.
        labelled: as of roll_out.

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
        way: torch.zeros(FEATURE_COUNT, dtype=torch.float64) for way in ("error", "copy", "extrapolation")
    }
    paths = dict.fromkeys(squares, 0.0)
    count = 0
    for windows in _windows(dataset, network.config.controls):
        w = _Windows(*(each.to(device) for each in vars(windows).values()))
        made, rows = _predicted(network, w), int(w.mask.sum())
        guesses = {"error": made.mean, "copy": w.x, "extrapolation": 2.0 * w.x - w.before}
        ways = {
            "error": made.trajectory_mean,
            "copy": w.given,
            "extrapolation": 2.0 * w.given - w.given_before,
        }
        for way, guess in guesses.items():
            off = ((guess - w.targets).square() * w.mask[..., None]).double()
            squares[way] += off.sum((0, 1)).cpu()
            path = ways[way]
            if path is not None:
                paths[way] += float(((path - w.next_given).square().mean(-1) * w.mask).double().sum())
        for name, value in _likelihoods(made, w).items():
            totals[name] = totals.get(name, 0.0) + value * w.mask.numel()
        count += rows
        has_path = made.trajectory_mean is not None
    errors = {
        way: {name: _root(float(each[columns].mean()), count) for name, columns in blocks.items()}
        | ({"trajectory": _root(paths[way], count)} if has_path or way != "error" else {})
        for way, each in squares.items()
    }
    return {"frames": count, **{name: _number(total / count) for name, total in totals.items()}, **errors}


def _root(total: float, count: int) -> float | None:
    return _number((total / count) ** 0.5)


def _number(value: float) -> float | None:
    """A rounded value; None where a network predicts numbers that are not finite."""
    return rounded(value, 5) if np.isfinite(value) else None


def _blocks(layout: FeatureLayout) -> dict[str, list[int]]:
    """Columns by what they hold; those of the root are apart."""
    own = layout.joint_columns(0)
    names = {
        "rotations": ("joint_rotations",),
        "positions": ("joint_positions",),
        "velocities": ("joint_angular_velocities", "joint_velocities"),
    }
    found = {
        name: [i for i, column in enumerate(layout.columns) if column.block in blocks and i not in own]
        for name, blocks in names.items()
    }
    return found | {"root": own}


def _windows(dataset: Dataset, kind: str) -> Iterator[_Windows]:
    """Yield the windows of all test clips, some at a time; each frame after the first FEWEST is predicted once."""
    cut: list[tuple[Array, ...]] = []
    for clip in dataset.select("test"):
        whole = recorded(dataset, clip, dataset.read(clip), kind)
        for first in range(0, clip.frames - 1, STRIDE):
            known = first + INIT_FRAMES + 1 if first else FEWEST  # the first frame that counts
            if known < clip.frames:
                cut.append(_window(whole, first, known))
    for at in range(0, len(cut), TOGETHER):
        arrays = zip(*cut[at : at + TOGETHER], strict=True)
        yield _Windows(*(torch.from_numpy(np.stack(each)) for each in arrays))


def _window(whole: Recorded, first: int, known: int) -> tuple[Array, ...]:
    """The arrays of _Windows for one window; frames from `known` on are predicted."""
    last = len(whole.x) - 1
    frames = np.minimum(np.arange(first, first + WINDOW), last)
    after, before = np.minimum(frames + 1, last), np.maximum(frames - 1, 0)
    inside = np.arange(first, first + WINDOW) + 1
    mask = ((inside >= known) & (inside <= last)).astype(np.float32)
    x, path = whole.x, whole.trajectory
    given = (x[frames], whole.contacts[frames], whole.controls[frames])
    return (*given, x[after], x[before], path[frames], path[after], path[before], mask)


@torch.inference_mode()
def _predicted(network: Predictor, w: _Windows) -> NextFrame:
    """The predictions for all frames of windows: at once by part transformers, else frame by frame."""
    if isinstance(network, PartTransformer):
        return network(w.x, w.contacts, w.controls)
    stream = network.stream(len(w.x))
    made = [stream.step(w.x[:, t], w.contacts[:, t], w.controls[:, t]) for t in range(WINDOW)]
    return stacked(made)


def _likelihoods(made: NextFrame, w: _Windows) -> dict[str, float]:
    """Negative log-likelihoods of the Gaussians that are predicted; a sigma that is always the same predicts none."""
    pairs = {
        "nll": (made.mean, made.log_sigma, w.targets),
        "nll-trajectory": (made.trajectory_mean, getattr(made, "trajectory_log_sigma", None), w.next_given),
    }
    return {
        name: float(gaussian_loss(mean.double(), log_sigma.double(), target.double(), w.mask))
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
    ways = {"mean": made[: len(starts)], "sample": made[len(starts) :]}
    truth = [each.data.features[each.initial : each.initial + each.frames] for each in starts]
    distances = {way: _distances(dataset, starts, frames, truth) for way, frames in ways.items()}
    moved = {
        way: _number(float(np.mean([_movement(dataset, *pair) for pair in zip(starts, frames, strict=True)])))
        for way, frames in {**ways, "recorded": truth}.items()
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
        way = np.linalg.norm(grounds[:, frame - 1] - true_grounds[:, frame - 1], axis=-1)
        out |= {
            f"mpjpe-{name}": _number(float(apart.mean())),
            f"root-{name}": _number(float(way.mean())),
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
