"""A training step with block attention against plain attention under a full mask, same weights.

    python benchmarks/training_step.py [--batch 16] [--window 96] [--threads 1] [--bfloat16]

Everything but the attention is the same code, including losses and optimizer. The predictions of both are compared
before the timing.
"""

from __future__ import annotations

import argparse
import copy
import math
from collections.abc import Callable
from dataclasses import replace

import torch
from common import print_table, time_in_turn
from torch import Tensor, nn

from motionkit.features.control import TRAJECTORY_COUNT, ControlLayout
from motionkit.features.encode import identity_reference_rotations
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.models.attention import LocalAttention
from motionkit.models.consistency import ConsistencyModules
from motionkit.models.network import PartTransformer
from motionkit.models.presets import PRESETS, preset
from motionkit.motion.skeleton import canonical_skeleton
from motionkit.training.losses import Batch, FeatureSpace, total_loss, training_losses

TYPES = tuple(f"type-{i}" for i in range(21))
LOSS_SCALE = 1.0 / FEATURE_COUNT


class PlainAttention(nn.Module):
    """Attention of all frames to all frames, with a mask for frames outside the window."""

    def __init__(self, local: LocalAttention) -> None:
        super().__init__()
        self.heads, self.window = local.heads, local.window
        self.qkv, self.out, self.offset_bias = local.qkv, local.out, local.offset_bias

    def forward(self, x_PBTD: Tensor, residual: Tensor) -> Tensor:
        P, B, T, D = x_PBTD.shape
        E = D // self.heads
        q, k, v = self.qkv(x_PBTD).reshape(P, B, T, 3, self.heads, E).permute(3, 0, 1, 4, 2, 5)
        scores = q @ k.transpose(-1, -2) / math.sqrt(E) + self.mask(T)
        mixed = torch.softmax(scores, dim=-1) @ v
        return self.out(mixed.transpose(2, 3).reshape(P, B, T, D), residual)

    def mask(self, frames: int) -> Tensor:
        """Return an additive mask, broadcastable to (P, B, H, T, T)."""
        distance = torch.arange(frames)[:, None] - torch.arange(frames)[None, :]
        inside = (distance >= 0) & (distance < self.window)
        mask = torch.where(inside, 0.0, -torch.inf)
        if self.offset_bias is None:
            return mask
        return mask + self.offset_bias[:, None, :, distance.clamp(0, self.window - 1)]


def with_plain_attention(network: PartTransformer) -> PartTransformer:
    """Return a copy of a network with the same weights and plain attention."""
    plain = copy.deepcopy(network)
    for module in (plain.shallow, plain.deep):
        for layer in module.layers:
            layer.attention = PlainAttention(layer.attention)
    return plain


def random_batch(batch: int, frames: int) -> Batch:
    """Return windows of random numbers, which do not affect the time."""
    generator = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> Tensor:
        return torch.randn(batch, frames, *shape, generator=generator)

    return Batch(
        normal(FEATURE_COUNT),
        normal(FEATURE_COUNT),
        (normal(CONTACT_COUNT) > 0).float(),
        (normal(CONTACT_COUNT) > 0).float(),
        normal(ControlLayout(TYPES).size),
        normal(TRAJECTORY_COUNT),
        torch.from_numpy(canonical_skeleton().offsets).expand(batch, -1, -1),
        torch.ones(batch, frames),
    )


def training_step(network: PartTransformer, batch: Batch, bfloat16: bool) -> Callable[[], None]:
    """Return a training step: forward, six losses, backward, AdamW."""
    network.train()
    modules = ConsistencyModules(network)
    optimizer = torch.optim.AdamW([*network.parameters(), *modules.parameters()], lr=1e-4)
    reference_rotations = torch.from_numpy(identity_reference_rotations())
    space = FeatureSpace(
        torch.zeros(FEATURE_COUNT),
        torch.ones(FEATURE_COUNT),
        reference_rotations,
        network.config.layout,
        60.0,
    )

    def step() -> None:
        with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
            prediction = network(batch.inputs, batch.contacts, batch.controls)
        prediction = replace(prediction, shallow=prediction.shallow.float(), deep=prediction.deep.float())
        terms = training_losses(network, modules, prediction, batch, space)
        optimizer.zero_grad(set_to_none=True)
        (total_loss(terms) * LOSS_SCALE).backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()

    return step


def largest_difference(a: PartTransformer, b: PartTransformer, batch: Batch) -> float:
    """Return the largest difference between the predicted means of two networks, without dropout."""
    with torch.no_grad():
        means = [n.eval()(batch.inputs, batch.contacts, batch.controls).mean for n in (a, b)]
    return float((means[0] - means[1]).abs().max())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", default="tptn", choices=list(PRESETS))
    parser.add_argument("--batch", type=int, default=16, help="windows per step")
    parser.add_argument("--window", type=int, default=96, help="frames per window")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1, help="torch threads")
    parser.add_argument(
        "--bfloat16", action="store_true", help="also time bfloat16, which is slow where it is emulated"
    )
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(0)
    network = PartTransformer(preset(arguments.preset), ControlLayout(TYPES).size)
    with torch.no_grad():  # an untrained head is zero and hides the layers before it
        for parameter in network.parameters():
            parameter.add_(0.02 * torch.randn_like(parameter))
    plain = with_plain_attention(network)
    batch = random_batch(arguments.batch, arguments.window)
    difference = largest_difference(network, plain, batch)
    steps = {
        "full mask, float32": training_step(plain, batch, False),
        "blocks, float32": training_step(network, batch, False),
    }
    if arguments.bfloat16:
        steps["blocks, bfloat16"] = training_step(copy.deepcopy(network), batch, True)
    seconds = time_in_turn(list(steps.values()), arguments.repeats)
    frames = arguments.batch * arguments.window
    rows = [
        [name, f"{1000 * s:.0f}", f"{frames / s:.0f}", f"{seconds[0] / s:.2f}"]
        for name, s in zip(steps, seconds, strict=True)
    ]
    title = f"{arguments.preset}, {arguments.batch} windows of {arguments.window} frames"
    print_table(title, ["attention", "ms per step (median)", "frames per second", "speed-up"], rows)
    print(f"predictions of both attentions differ by at most {difference:.1e} (normalised units, float32)")
    ratios = [f"{seconds[0] / s:.2f} {name}" for name, s in zip(steps, seconds, strict=True)][1:]
    print(f"ratio: {'; '.join(ratios)}, against the full mask")


if __name__ == "__main__":
    main()
