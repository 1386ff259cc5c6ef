"""One frame at a time with the streaming network, against recomputing its 87 frames at every step.

    python benchmarks/synthesis.py [--characters 1 64] [--steps 300] [--threads 1]

The weights are random: time does not depend on them. Both ways are fed the same frames, and their
predictions compared.
"""

from __future__ import annotations

import argparse
import time

import torch
from common import percentiles, print_table
from torch import Tensor

from motionkit.features.control import ControlLayout
from motionkit.features.layout import CONTACT_COUNT, FEATURE_COUNT
from motionkit.models.network import PartTransformer
from motionkit.models.presets import PRESETS, preset
from motionkit.synthesis.stream import NetworkStream

TYPES = tuple(f"type-{i}" for i in range(21))
Frame = tuple[Tensor, ...]  # features, contacts, controls of all characters


class WindowRecompute:
    """The plain way: the last 87 frames through the whole network, of which the last prediction counts."""

    def __init__(self, network: PartTransformer, batch: int) -> None:
        self.network = network
        sizes = (FEATURE_COUNT, CONTACT_COUNT, network.control_size)
        self.past = [torch.zeros(batch, 0, size) for size in sizes]

    def append(self, *frame: Tensor) -> None:
        """Take in a frame (B, ...) of features, contacts and controls."""
        length = self.network.config.receptive_field
        self.past = [
            torch.cat([past, new[:, None]], dim=1)[:, -length:]
            for past, new in zip(self.past, frame, strict=True)
        ]

    @torch.inference_mode()
    def step(self, *frame: Tensor) -> Tensor:
        """Take in a frame and predict the mean (B, 276) of the next."""
        self.append(*frame)
        return self.network(*self.past).mean[:, -1]


class Streaming:
    """The same by the streaming network."""

    def __init__(self, network: PartTransformer, batch: int) -> None:
        self.stream = NetworkStream(network, batch)

    def append(self, *frame: Tensor) -> None:
        """Take in a frame (B, ...) of features, contacts and controls."""
        self.stream.step(*frame)

    def step(self, *frame: Tensor) -> Tensor:
        """Take in a frame and predict the mean (B, 276) of the next."""
        return self.stream.step(*frame).mean


def run(
    way: WindowRecompute | Streaming, frames: list[Frame], fill: int, limit: float
) -> tuple[list[float], list[Tensor]]:
    """Seconds and predictions of the steps after the first fill frames, until a limit in seconds is passed."""
    for frame in frames[:fill]:
        way.append(*frame)
    seconds: list[float] = []
    predictions = []
    for frame in frames[fill:]:
        began = time.perf_counter()
        predictions.append(way.step(*frame))
        seconds.append(time.perf_counter() - began)
        if sum(seconds) > limit:
            break
    return seconds, predictions


def random_frames(network: PartTransformer, batch: int, count: int) -> list[Frame]:
    """Normalised frames, contacts and controls."""
    generator = torch.Generator().manual_seed(0)
    sizes = (FEATURE_COUNT, CONTACT_COUNT, network.control_size)
    drawn = [torch.randn(count, batch, size, generator=generator) for size in sizes]
    return list(zip(*drawn, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", default="tptn", choices=[n for n in PRESETS if n != "tptn-paper"])
    parser.add_argument("--characters", type=int, nargs="+", default=[1, 64])
    parser.add_argument("--steps", type=int, default=300, help="timed steps of each way")
    parser.add_argument("--seconds", type=float, default=30.0, help="stop a way early after so long")
    parser.add_argument("--threads", type=int, default=1, help="torch threads")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(0)
    network = PartTransformer(preset(arguments.preset), ControlLayout(TYPES).size).eval()
    fill = network.config.receptive_field  # before that the window is short, and recomputing cheap
    rows, ratios, largest = [], [], 0.0
    for count in arguments.characters:
        frames = random_frames(network, count, fill + arguments.steps)
        ways: dict[str, WindowRecompute | Streaming] = {
            "recompute the window": WindowRecompute(network, count),
            "stream": Streaming(network, count),
        }
        results = [run(way, frames, fill, arguments.seconds) for way in ways.values()]
        for name, (seconds, _) in zip(ways, results, strict=True):
            p50, p95, p99 = percentiles(seconds)
            times = [f"{1000 * p:.2f}" for p in (p50, p95, p99, p50 / count)]
            rows.append([f"{name}, {count}", str(len(seconds)), f"{1 / p50:.1f}", *times])
        medians = [percentiles(seconds)[0] for seconds, _ in results]
        ratios.append(f"{medians[0] / medians[1]:.1f} for {count}")
        pairs = zip(results[0][1], results[1][1], strict=False)  # the slow way may have stopped early
        largest = max(largest, *(float((a - b).abs().max()) for a, b in pairs))
    header = ["way, characters", "steps", "steps per s", "p50 ms", "p95 ms", "p99 ms", "p50 ms per character"]
    print_table(f"{arguments.preset}, after {fill} frames", header, rows)
    print(f"predictions of both ways differ by at most {largest:.1e} (normalised units)")
    print(f"ratio (p50): {', '.join(ratios)}")


if __name__ == "__main__":
    main()
